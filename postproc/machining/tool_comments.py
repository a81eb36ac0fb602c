"""Tools and stock as CAM systems state them in comments of a program.

The forms are those of public posts: Fusion and HSMWorks ``(T1 D=16. CR=0. - ZMIN=-5. - flat end mill)``, Mastercam
``( T2 | 6. BALL ENDMILL | H2 )``, FreeCAD ``(TC: Endmill 12 mm)`` before the tool change, Vectric ``(Tool 1: End Mill
{6 mm})`` and ``( Material Size)`` ``( X= 300.0, Y= 450.0, Z= 19.05)``. What a comment does not state is None.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Literal

from msgspec import Struct
from msgspec.structs import replace

from postproc.frames import MM_PER_INCH

Shape = Literal["flat", "ball", "bull", "drill"]

_NUMBER = r"(\d+[ -]\d+/\d+|\d+/\d+|\d+(?:\.\d*)?|\.\d+)"
"""A decimal number, or a fraction of an inch: ``1/2``, ``1-1/4``."""
_UNIT = r"""\s*(mm\b|inch(?:es)?\b|in\b|")?"""
_TOOL = re.compile(r"(?:\btool\s*(?:no\.?|number|#)?|\bT)\s*[-=:#]?\s*(\d{1,4})\b\s*-?", re.IGNORECASE)
# its group 2, the unit, is empty, as in the other forms of a diameter
_APT = re.compile(r"CUTTER/\s*([\d.]+)()(?:\s*,\s*([\d.]+))?", re.IGNORECASE)
_DIAMETERS = (
    _APT,
    re.compile(rf"\bD\s*[=:]\s*{_NUMBER}{_UNIT}", re.IGNORECASE),
    re.compile(rf"\b(?:tool\s+)?dia(?:meter|\.)?(?!\s*off)\s*[-=:]?\s*{_NUMBER}{_UNIT}", re.IGNORECASE),
    re.compile(rf"[{{⌀Ø]\s*{_NUMBER}{_UNIT}", re.IGNORECASE),
    re.compile(
        rf"{_NUMBER}{_UNIT}\s*(?:dia\b|(?:flat|ball|bull|square)?\s*(?:nose)?\s*end\s*mill|drill)", re.IGNORECASE
    ),
    re.compile(rf"(?:mill|drill|cutter|schaftfr\w*)\b\D{{0,12}}?{_NUMBER}{_UNIT}", re.IGNORECASE),
)
"""Where a comment states the diameter of a tool; the surest form first."""
_CORNER = re.compile(rf"\b(?:CR|R|corner(?:\s*radius)?|rad(?:ius)?)\s*[=:.]?\s*{_NUMBER}{_UNIT}", re.IGNORECASE)
_FLUTES = re.compile(
    r"\b(\d{1,2})\s*-?\s*(?:FL|flutes?|teeth)\b|\b(?:flutes?|teeth|Z)\s*=\s*(\d{1,2})(?![\d.])", re.IGNORECASE
)
_SHAPES: tuple[tuple[re.Pattern[str], Shape], ...] = (
    (re.compile(r"\bball\b|kugel", re.IGNORECASE), "ball"),
    (re.compile(r"\bbull|torus", re.IGNORECASE), "bull"),
    (re.compile(r"\bdrill|\bbohrer", re.IGNORECASE), "drill"),
    (re.compile(r"\bflat\b|end\s*mill|\bsquare\b|face\s*mill|schaftfr", re.IGNORECASE), "flat"),
)
_OTHER_SHAPES = re.compile(
    r"\b(?:form|chamfer|taper\w*|v-?bit|dovetail|thread|probe|lollipop|engrav\w*|tap)\b", re.IGNORECASE
)
"""Cutters that a process file cannot describe."""
_STRAIGHT = re.compile(r"\bTAPER\s*=\s*0(?:\.0*)?\s*(?:deg)?(?![\d.])", re.IGNORECASE)
_POINT = re.compile(r"\bTAPER\s*=\s*1\d\d(?:\.\d*)?\s*(?:deg)?", re.IGNORECASE)
"""Point angle of a twist drill [deg], which Fusion calls a taper."""
_CUTTER = re.compile(r"mill|drill|cutter|fr[aä]ser|bohrer", re.IGNORECASE)
_LINES_TO_CHANGE = 8
"""A comment without a tool number belongs to the tool change at most this many lines after it (assumed)."""


class CommentedTool(Struct, frozen=True):
    """A cutter of a program, as its comments state it.

    :param shape: shape of the cutter; None: not stated, or a shape that a process cannot describe.
    :param diameter_mm: None: not stated.
    :param corner_radius_mm: corner radius of a bull tool; 0 for other shapes.
    :param flutes: number of teeth; None: not stated.
    :param text: the comment; empty: there is none.
    """

    shape: Shape | None = None
    diameter_mm: float | None = None
    corner_radius_mm: float = 0.0
    flutes: int | None = None
    text: str = ""


class Comment(Struct, frozen=True):
    """A comment of a program and its 1-based line."""

    line: int
    text: str


def commented_tools(
    comments: Sequence[Comment], changes: Sequence[tuple[int, int]], *, inches: bool
) -> Mapping[int, CommentedTool]:
    """Return T number → cutter that the comments describe.

    The first comment on a tool that states a diameter counts; without any, the last comment that states a shape. A
    comment without a T number belongs to the first tool change within `_LINES_TO_CHANGE` lines after it. Comments that
    state neither a diameter nor a shape do not count.

    :param changes: (line, T number) of tool changes, in order.
    :param inches: lengths without a unit are inches.
    """
    tools: dict[int, CommentedTool] = {}
    for comment in comments:
        match = _TOOL.search(comment.text)
        if match is not None:
            numbers, text = [int(match[1])], comment.text[: match.start()] + " " + comment.text[match.end() :]
        elif _CUTTER.search(comment.text):
            lines = range(comment.line, comment.line + _LINES_TO_CHANGE + 1)
            numbers, text = [number for line, number in changes if line in lines][:1], comment.text
        else:
            continue
        cutter = cutter_of(text, inches=inches)
        for number in numbers:
            if cutter.diameter_mm is not None or cutter.shape is not None:
                earlier_tool = tools.get(number, CommentedTool())
                if earlier_tool.diameter_mm is None:
                    tools[number] = replace(cutter, text=comment.text.strip())
    return tools


def named_text(number: int, text: str) -> str:
    """Return a comment on a tool, with the T number of the tool before it unless it states that number itself.

    >>> named_text(1, "T1 D=16."), named_text(2, "end mill 8 mm")
    ('T1 D=16.', 'T2 end mill 8 mm')
    """
    match = _TOOL.search(text)
    return text if match is not None and int(match[1]) == number else f"T{number} {text}"


def cutter_of(text: str, *, inches: bool) -> CommentedTool:
    """Return the cutter that a text describes.

    :param inches: lengths without a unit are inches.
    :returns: shape, diameter and number of teeth are None if the text does not state them.

    >>> cutter_of("D=16. CR=0. - ZMIN=-5. - flat end mill", inches=False)
    CommentedTool(shape='flat', diameter_mm=16.0, corner_radius_mm=0.0, flutes=None, text='')
    """
    diameter = next((_length_mm(match, inches) for form in _DIAMETERS if (match := form.search(text))), None)
    corner = 0.0 if (match := _CORNER.search(text)) is None else _length_mm(match, inches)
    if (apt := _APT.search(text)) is not None:
        corner = float(apt[3] or 0.0) * (MM_PER_INCH if inches else 1.0)
    shape = next((shape for form, shape in _SHAPES if form.search(text)), None)
    # the point angle of a drill and a taper of 0° are no tapered shape
    if _OTHER_SHAPES.search((_POINT if shape == "drill" else _STRAIGHT).sub("", text)):
        shape = None
    elif diameter is not None and corner and shape in (None, "flat", "bull"):
        shape = "ball" if 2.0 * corner >= diameter else "bull"
    flutes = next((int(count) for match in _FLUTES.finditer(text) for count in match.groups() if count), None)
    if not diameter:  # 0 is no diameter
        diameter = None
    return CommentedTool(shape, diameter, corner if shape == "bull" else 0.0, flutes or None)


def _length_mm(match: re.Match[str], inches: bool) -> float:
    """Return a length that a comment states [mm]; fractions are of an inch.

    :param match: its group 1 is the number, group 2 the unit, if any.
    :param inches: lengths without a unit are inches.
    """
    return round(_number_value(match[1]) * _mm_per_unit(match[2], inches=inches or "/" in match[1]), 6)


def _mm_per_unit(unit: str | None, *, inches: bool) -> float:
    """Return the length of a unit of a comment [mm]: 1 for mm, an inch for any other unit.

    :param unit: None or empty: not stated.
    :param inches: a length without a unit is in inches; else it is in mm.
    """
    if unit:
        return 1.0 if unit.lower() == "mm" else MM_PER_INCH
    return MM_PER_INCH if inches else 1.0


def _number_value(text: str) -> float:
    """Return the value of a number or fraction; 0 for a fraction with the denominator 0.

    >>> _number_value("12.7"), _number_value("3/8"), _number_value("1-1/4")
    (12.7, 0.375, 1.25)
    """
    try:
        return sum(float(Fraction(word)) if "/" in word else float(word) for word in re.split("[ -]", text))
    except ZeroDivisionError:
        return 0.0


_SIZE_TITLE = re.compile(r"material\s+size|stock\s+(?:size|dimensions?)|block\s+size", re.IGNORECASE)
_SIDE = {axis: re.compile(rf"\b{axis}\s*[=:]\s*{_NUMBER}{_UNIT}", re.IGNORECASE) for axis in "XYZ"}
_SIDES = re.compile(
    rf"(?:stock|rohteil\w*|blank)\D{{0,20}}{_NUMBER}\s*[x×]\s*{_NUMBER}\s*[x×]\s*{_NUMBER}{_UNIT}", re.IGNORECASE
)


def stock_size(comments: Iterable[Comment], *, inches: bool) -> tuple[float, float, float] | None:
    """Return the lengths of the stock along X, Y, Z [mm] that comments state; None if they state none.

    There are two forms: "stock 100 x 80 x 20 mm" in one comment; or "material size", and X =, Y =, Z = in one comment
    at most two lines after it.

    :param inches: lengths without a unit are inches.
    """
    title_line = -10  # far above the first line: no title yet
    for comment in comments:
        if sides := _SIDES.search(comment.text):
            factor = _mm_per_unit(sides[4], inches=inches)
            x, y, z = (_number_value(sides[group]) * factor for group in (1, 2, 3))
            return x, y, z
        if _SIZE_TITLE.search(comment.text):
            title_line = comment.line
        matches = [match for side in _SIDE.values() if (match := side.search(comment.text)) is not None]
        if comment.line - title_line <= 2 and len(matches) == len(_SIDE):
            x, y, z = (_length_mm(match, inches) for match in matches)
            return x, y, z
    return None
