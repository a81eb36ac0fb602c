"""Answers of a user as text: what `init` and `start` take from options, questions and files, as checked values.

Each function returns the value of a text, and raises an `InputError` with what to write instead.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from msgspec import Struct

from postproc.cell import Box, IndexedAxis, Rotary, lines_fault, m_code_fault, motion_fault
from postproc.errors import InputError, ModelError, choices
from postproc.machining.material import table
from postproc.machining.process import StockTable
from postproc.robot import find

Numbers = tuple[float, ...]
BY_HAND, NO_LINES = "hand", "none"
"""Tool changes: the program stops, or does nothing; anything else is a line of the cell."""
_AXES = "XYZ"
_FRAME_LENGTHS = (3, 6)
"""X, Y, Z alone, or with A, B, C: of four or five numbers one was left out."""


def numbers(text: str) -> Numbers:
    """Return the numbers of a text that are separated by commas or semicolons; none of an empty text.

    :raises InputError: a word is no number.
    """
    try:
        values = tuple(float(word) for word in text.replace(";", ",").split(",") if word.strip())
    except ValueError:
        raise InputError(f"{text!r}: give numbers with commas between, such as 1500,-200,700") from None
    return values


def _finite_numbers(values: Numbers, text: str) -> Numbers:
    """Check that numbers are finite, and return them.

    :param text: the text of the numbers, for the message.
    :raises InputError: a number is not finite.
    """
    if not all(map(math.isfinite, values)):
        raise InputError(f"{text!r}: give finite numbers")
    return values


def number(text: str) -> float:
    """Return the finite number in a text.

    :raises InputError: the text is no finite number.
    """
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{text!r} is not a number") from None
    if not math.isfinite(value):
        raise InputError(f"{text!r}: give a finite number")
    return value


def frame(text: str) -> Numbers | int:
    """Return the numbers of a frame, X, Y, Z[, A, B, C], or the number of a frame of the controller.

    A single whole number is the number of a frame. The count of numbers is not checked.

    :raises InputError: a word is no number.
    """
    return int(text) if text.strip().isdecimal() else numbers(text)


def full_frame(text: str) -> Numbers | int:
    """Return a frame as `frame` does, with three or six finite numbers.

    :raises InputError: the text has another form.
    """
    value = frame(text)
    if not isinstance(value, int) and len(value) not in _FRAME_LENGTHS:
        raise InputError(f"{text!r}: {len(value)} numbers", advice="Give X,Y,Z or X,Y,Z,A,B,C in mm and degrees.")
    return value if isinstance(value, int) else _finite_numbers(value, text)


def stated_frame(text: str) -> Numbers:
    """Return X, Y, Z or X, Y, Z, A, B, C of a frame; the number of a frame of the controller is refused.

    :raises InputError: the text has another form.
    """
    value = full_frame(text)
    if isinstance(value, int):
        raise InputError(f"{text!r}: one number", advice="Give X,Y,Z or X,Y,Z,A,B,C in mm and degrees.")
    return value


def numbered_frames(texts: Sequence[str]) -> dict[int, Numbers]:
    """Return frames by number from texts such as ``3=1500,0,700``.

    :raises InputError: a text has another form, or a frame is given twice.
    """
    frames: dict[int, Numbers] = {}
    for text in texts:
        name, _, words = text.partition("=")
        if not name.strip().isdecimal() or int(name) == 0:
            raise InputError(f"{text!r}: give the number of the frame and the frame, such as 3=1500,0,700")
        _add_frame(frames, int(name), stated_frame(words), f"frame {int(name)}")
    return frames


def _add_frame(frames: dict[Any, Numbers], key: Any, value: Numbers, name: str) -> None:
    """Add a frame to `frames`; an equal frame may be given twice.

    :param key: number or code of the frame; `name`: its name for messages.
    :raises InputError: `frames` has a different frame under this key.
    """
    if (first_value := frames.setdefault(key, value)) != value:
        first, second = (",".join(f"{word:g}" for word in words) for words in (first_value, value))
        raise InputError(f"{name} is given twice, {first} and {second}: leave one of them out")


def tools(texts: Sequence[str]) -> dict[int, Numbers]:
    """Return $TOOL by T number from texts such as ``1=0,0,412.5`` or ``1=412.5``, which is its Z.

    :raises InputError: a text has another form, or a tool is given twice.
    """
    frames: dict[int, Numbers] = {}
    for text in texts:
        name, equals, words = text.partition("=")
        values = numbers(words)
        name = name.strip().upper().removeprefix("T")
        if not equals or not name.isdecimal() or len(values) not in (1, *_FRAME_LENGTHS):
            raise InputError(f"{text!r}: give the number of the tool and its $TOOL, such as 1=0,0,412.5")
        _add_frame(frames, int(name), (0.0, 0.0, *values) if len(values) == 1 else values, f"tool {int(name)}")
    return frames


def work_offsets(texts: Sequence[str]) -> dict[str, Numbers]:
    """Return frames in $BASE by the code of the work offset from texts such as ``G55=300,0,0``.

    :raises InputError: a text has another form, or an offset is given twice.
    """
    offsets: dict[str, Numbers] = {}
    for text in texts:
        name, _, words = text.partition("=")
        values = numbers(words)
        code = name.strip().upper()
        # 4 numbers: X, Y, Z, A
        if not re.fullmatch(r"G5[4-9]|G59\.[1-3]", code) or len(values) not in (4, *_FRAME_LENGTHS):
            raise InputError(f"{text!r}: give G54 to G59.3 and its frame in $BASE, such as G55=300,0,0")
        _add_frame(offsets, code, values, code)
    return offsets


def m_codes(texts: Sequence[str]) -> list[str]:
    """Return M codes from texts such as ``M31`` or ``31``.

    :raises InputError: a text is no M code, or is one that the cell cannot state.
    """
    codes = []
    for text in texts:
        name = text.strip().upper().removeprefix("M")
        if not (name.isascii() and name.isdecimal()):
            raise InputError(f"{text!r}: give an M code, such as M31")
        codes.append(f"M{int(name)}")
        if fault := m_code_fault(codes[-1]):
            raise InputError(f"{text!r}: {fault.problem}. {fault.advice}")
    return codes


def line(text: str) -> str:
    """Check a line of the robot's language, and return it.

    :raises InputError: a bracket or string is not closed, or the line moves the robot.
    """
    if fault := lines_fault([text]) or motion_fault([text]):
        raise InputError(fault)
    return text


def switch(text: str) -> tuple[list[str], list[str]]:
    """Return the lines that switch on, and the lines that switch off, from the text "ON|OFF"; no lines for "hand".

    :raises InputError: the text has another form.
    """
    if text.strip() == BY_HAND:
        return [], []
    lines = [line(part.strip()) for part in text.split("|")]
    if len(lines) != 2 or not all(lines):
        raise InputError(f"{text!r}: give both lines with | between, such as $OUT[1]=TRUE|$OUT[1]=FALSE, or hand")
    return [lines[0]], [lines[1]]


def tolerance(text: str) -> float | None:
    """Return a tolerance [mm] above 0; None for an empty answer.

    :raises InputError: the text is no number, or not above 0.
    """
    if not text.strip():
        return None
    if not (length := number(text)) > 0.0:
        raise InputError(f"{text!r}: give a length above 0")
    return length


def payload(text: str) -> Numbers | None:
    """Return mass [kg] and centre X, Y, Z in the flange frame [mm] of a payload; None for an empty answer.

    With the mass alone, the centre is zero.

    :raises InputError: the text has another form, or the mass is not above zero.
    """
    if not text.strip():
        return None
    values = _finite_numbers(numbers(text), text)
    if len(values) not in (1, 4) or not values[0] > 0.0:
        raise InputError(
            f"{text!r}: give a mass above 0 in kg, and its centre in the flange frame in mm, such as 28,0,0,140"
        )
    return (*values, 0.0, 0.0, 0.0)[:4]


def robot(text: str) -> str:
    """Check that a robot model exists, and return its text: name of a shipped robot, or path of a model folder.

    :raises InputError: there is no such model.
    """
    try:
        find(text)
    except ModelError as cause:
        raise InputError(cause.problem, advice=cause.advice) from None
    return text


def choice_parser(*values: str) -> Any:
    """Return a function that checks that a text is one of some words, and returns it without blanks around it.

    The returned function raises `InputError` for another text.

    :param values: the words.
    """

    def parse(text: str) -> str:
        """Return the word of a text.

        :raises InputError: the text is none of the words.
        """
        word = text.strip()
        if word not in values:
            raise InputError(f"{text!r}: no such answer", advice=f"Give {' or '.join(values)}.")
        return word

    return parse


def place(text: str) -> Numbers:
    """Return X, Y, Z [mm] of a point.

    :raises InputError: the text has another form.
    """
    values = numbers(text)
    if len(values) != len(_AXES):
        raise InputError(f"{text!r}: {len(values)} numbers", advice="Give X,Y,Z in mm.")
    return _finite_numbers(values, text)


def points(texts: Sequence[str]) -> dict[str, Numbers]:
    """Return points in $BASE [mm] by rotary axis from texts such as ``A=0,0,-120``.

    :raises InputError: a text has another form, or an axis is given twice.
    """
    axis_points: dict[str, Numbers] = {}
    for text in texts:
        name, _, words = text.partition("=")
        letter = name.strip().upper()
        if letter not in ("A", "B", "C"):
            raise InputError(f"{text!r}: give the axis and its point, such as A=0,0,-120")
        _add_frame(axis_points, letter, place(words), letter)
    return axis_points


def material(text: str) -> str:
    """Return the name of a material without blanks around it.

    :raises InputError: the name is not in the table of materials.
    """
    name = text.strip()
    names = list(table())
    if name not in names:
        raise InputError(f"no material {name!r}", advice=choices(name, names, "Materials"))
    return name


class CutterShape(Struct, frozen=True):
    """Shape, diameter and corner radius of a cutter [mm]."""

    shape: Literal["flat", "ball", "bull", "drill"]
    diameter_mm: float
    corner_radius_mm: float = 0.0


_SHAPES = ("flat", "ball", "bull", "drill")


def cutter(text: str) -> CutterShape:
    """Return a cutter from ``flat,12``, ``ball,6``, ``bull,12,1`` (diameter, corner radius) or ``drill,8``.

    :raises InputError: the text has another form, a length is not above zero, or the corner radius exceeds the radius.
    """
    words = text.replace(",", " ").split()
    advice = (
        "Give shape and diameter in mm: flat,12 or ball,6 or drill,8; of a bull tool its corner radius too: bull,12,1."
    )
    if not words or words[0] not in _SHAPES or len(words) != (3 if words[0] == "bull" else 2):
        raise InputError(f"{text!r}: no cutter", advice=advice)
    lengths = [number(word) for word in words[1:]]  # diameter; bull: and corner radius
    if min(lengths) <= 0.0 or (len(lengths) == 2 and 2.0 * lengths[1] > lengths[0]):
        raise InputError(f"{text!r}: no lengths of a cutter", advice=advice)
    return CutterShape(words[0], *lengths)  # type: ignore[arg-type]


def flutes(text: str) -> int:
    """Return a number of cutting edges, 1 to 100.

    :raises InputError: the text is no such number.
    """
    word = text.strip()
    if not word.isdecimal() or not 1 <= int(word) <= 100:
        raise InputError(f"{text!r}: give the number of cutting edges, such as 3")
    return int(word)


def speed(text: str) -> float:
    """Return a spindle speed above 0 [1/min].

    :raises InputError: the text is no number above 0.
    """
    if not (value := number(text)) > 0.0:
        raise InputError(f"{text!r}: give the spindle speed in 1/min, such as 12000")
    return value


_SPAN = re.compile(r"\s*([XYZ])\s*=\s*([-+.\deE]+)\s*:\s*([-+.\deE]+)\s*", re.IGNORECASE)


def stock(text: str) -> StockTable:
    """Return a stock: a box from ``X=0:100,Y=0:80,Z=-20:0`` ($BASE, mm), or a mesh from the path of a file.

    :raises InputError: the text is neither.
    """
    parts = [_SPAN.fullmatch(part) for part in text.split(",")]
    if len(parts) == len(_AXES) and all(parts):
        spans = {part[1].upper(): (number(part[2]), number(part[3])) for part in parts if part is not None}
        if set(spans) == set(_AXES) and all(low < high for low, high in spans.values()):
            return StockTable(box=Box(**spans))
        raise InputError(f"{text!r}: no box", advice="Give the smaller number first: X=0:100,Y=0:80,Z=-20:0.")
    if Path(text).is_file():
        return StockTable(file=text)
    raise InputError(
        f"{text!r}: neither a box nor a file", advice="Give X=0:100,Y=0:80,Z=-20:0 in $BASE, or the path of an STL."
    )


def box_text(box: Box) -> str:
    """Return a box as the text that `stock` reads."""
    return ",".join(f"{axis}={getattr(box, axis)[0]:g}:{getattr(box, axis)[1]:g}" for axis in _AXES)


def rotary_axes(text: str) -> list[str]:
    """Return the letters of one or two rotary axes, from the part outwards, from ``CB`` or ``C,B``.

    :raises InputError: the text has other letters, a letter twice, or more than two.
    """
    letters = [letter for letter in text.upper() if letter.isalpha()]
    if not 1 <= len(letters) <= 2 or len(set(letters)) != len(letters) or set(letters) - set("ABC"):
        raise InputError(f"{text!r}: no rotary axes", advice="Give one or two of A, B, C, from the part outwards: C,B.")
    return letters


def rotary(axes: Sequence[str], kind: str, points: Mapping[str, Numbers]) -> Rotary:
    """Return the rotary axes of a cell.

    :param axes: letters from the part outwards; A, B, C turn about X, Y, Z.
    :param kind: ``"tcp"`` or ``"indexed"``.
    :param points: letter of each indexed axis → a point of the axis in $BASE [mm]; other axes have none.
    """
    directions = {letter: tuple(float(letter == name) for name in "ABC") for letter in axes}
    places = {letter: IndexedAxis(points[letter], directions[letter]) for letter in axes if letter in points}  # type: ignore[arg-type]
    return Rotary(axes=list(axes), kind=kind, **places)  # type: ignore[arg-type]
