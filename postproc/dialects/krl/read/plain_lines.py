"""Plain motion lines, all at once: ``LIN {X …,Y …,Z …,A …,B …,C …} C_DIS`` a hundred thousand times, and circles.

One regular expression decides which lines are plain: it is the fence. Lines that differ in their numbers only are
decided at once; the numbers are then found and converted by numpy. What the fence leaves out (other orders of
components, names, CA) is read statement by statement (`interpreter`, `motion_reader`), and so could plain lines be:
tests read generated programs, and such with slips, both ways and compare.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from functools import cache

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.chunks import chunks, compact
from postproc.decimals import Bytes, numbers_in, parsed_numbers
from postproc.dialects.krl.language.positions import COLUMNS
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.layout import Offsets
from postproc.dialects.krl.read import plain_settings
from postproc.dialects.krl.read.motion_columns import (
    MotionColumns,
    given,
    merged,
    narrow,
    no_circles,
    none,
    postures,
)
from postproc.dialects.krl.read.plain_settings import PlainSettings, no_settings
from postproc.frames import Array, any_column
from postproc.program import CIRC, LIN, PTP, Bools, Ints

"""Lines read at once: the arrays of more lines do not fit the cache."""
_STRICT = r"[-+]?+(?:[0-9]++(?:\.[0-9]*+)?|\.[0-9]++)(?:[eE][-+]?+[0-9]++)?"
_LOOSE = r"[-+.0-9][-+.0-9eE]*+"
_STRAIGHT = r"[ \t]*+[Ss]?+(?:[Ll][Ii][Nn]|[Pp][Tt][Pp])"
_SEPARATOR = r"[ \t]*+(?:,[ \t]*+(?=[A-Za-z])|(?=\}))"


_CIRCLE = re.compile(r"[ \t]*+[Ss]?+[Cc][Ii][Rr][Cc]")


@cache
def _line_of(number: str, *, circle: bool) -> re.Pattern[str]:
    """Return the expression for a plain LIN or PTP, or a plain CIRC, with a given expression for its numbers."""
    position = [rf"[{name}{name.lower()}][ \t]++{number}" for name in "XYZABC"]
    components = [r"[Ss][ \t]++(?:[12][0-9]|3[01]|[0-9])", r"[Tt][ \t]++(?:[1-5][0-9]|6[0-3]|[0-9])"]
    components += [rf"[Ee]{axis}[ \t]++{number}" for axis in range(1, 7)]
    begin = r"\{[ \t]*+(?:(?i:E6POS|POS|FRAME)[ \t]*+:[ \t]*+)?(?=[XYZABCxyzabc])"
    required_count = 3 if circle else 0
    point = begin + "".join(f"{component}{_SEPARATOR}" for component in position[:required_count])
    point += "".join(f"(?:{component}{_SEPARATOR})?" for component in position[required_count:])
    rest = "".join(f"(?:{component}{_SEPARATOR})?" for component in components) + r"\}"
    prefix = rf"{_CIRCLE.pattern}[ \t]*+{point}\}}[ \t]*+,[ \t]*+" if circle else rf"{_STRAIGHT}[ \t]*+"
    suffix = r"(?:[ \t]++(?i:C_(?:DIS|VEL|ORI|PTP|SPL))){0,2}[ \t]*+(?:;[^\r\n]*+)?\r{0,2}+\n"
    return re.compile(f"{prefix}{point}{rest}{suffix}")


def _is_plain(text: str, begin: int, number: str) -> bool:
    """Return whether a plain line begins there, with a given expression for its numbers."""
    circle = _CIRCLE.match(text, begin) is not None
    return _line_of(number, circle=circle).match(text, begin) is not None


_MARK = 1
_NUMBER = bytes.maketrans(b"\1" + b"0123456789+-.", b"?" + b"\1" * 13)
_LIMITED_COMPONENT = re.compile(rb"[SsTtEe][ \t]*\x01")
"""Components that may have certain values or names only, so that lines with them are decided one by one."""
_COMMENT = re.compile(rb";[^\r\n]*")
_NUMBERS = len(COLUMNS) + 6
"""X … T, and E1 … E6."""
_COLUMN = np.full(256, -1, dtype=np.int64)
_COLUMN[np.frombuffer(b"XYZABCST123456", dtype=np.uint8)] = np.arange(_NUMBERS)
_COLUMN[np.frombuffer(b"xyzabcst", dtype=np.uint8)] = np.arange(8)
_NUMBER_CODES = bytes(byte if byte in b"0123456789+-.eE" else 32 for byte in range(256))
_BLANK = np.zeros(256, dtype=np.bool_)
_BLANK[[9, 10, 13, 32]] = True


def scan(source: Source) -> list[MotionColumns]:
    """Return all plain motions of a document, in consecutive parts."""
    text, starts = source.text, source.starts
    columns = []
    for lines in chunks(len(starts)):
        part_starts = starts[lines]
        begin = int(part_starts[0])
        end = int(starts[lines.stop]) if lines.stop < len(starts) else len(text)
        columns.append(_plain(text[begin:end], part_starts - begin, lines.start, begin))
    return columns


def _plain(text: str, starts: Ints, lines: int, characters: int) -> MotionColumns:
    """Return the plain motions of a piece of text.

    :param starts: offsets of its lines in it.
    :param lines: number of lines before it; `characters` of characters.
    """
    codes = text.encode("ascii", "replace")
    line_indices = _alike(text, codes, starts)
    plain = _scan(codes, starts, line_indices, lines, characters)
    if plain is None:  # something that looks like a number is none, such as 1.2.3
        strict = [index for index in line_indices.tolist() if _is_plain(text, int(starts[index]), _STRICT)]
        plain = _scan(codes, starts, np.array(strict, dtype=np.int64), lines, characters) or none()
    endless = [
        np.isinf(values) for values in (plain.numbers, plain.external, plain.via)
    ]  # 1E999: refused where statements are read
    if any(mask.any() for mask in endless):
        plain = plain.take(~np.logical_or.reduce([any_column(mask) for mask in endless]))
    return plain


def _alike(text: str, codes: bytes, starts: Ints) -> Ints:
    """Return which lines (P,) are plain, if what looks like a number is one."""
    marked_codes = np.frombuffer(codes.translate(_NUMBER), dtype=np.uint8)
    number = marked_codes == _MARK
    number[1:] &= number[:-1].copy()
    number[:1] = False
    forms = marked_codes[~number].tobytes().split(b"\n")  # each number is one mark
    begins = np.append(0, np.flatnonzero(marked_codes == ord("\n")) + 1)
    example = dict(zip(forms, range(len(forms)), strict=True))
    verdicts = {form: _is_plain(text, int(begins[index]), _LOOSE) for form, index in example.items()}
    plain = np.fromiter(map(verdicts.__getitem__, forms), np.bool_, len(forms))
    own_forms = {form for form, good in verdicts.items() if good and _LIMITED_COMPONENT.search(form)}
    if own_forms:
        for index in [index for index, form in enumerate(forms) if form in own_forms]:
            plain[index] = _is_plain(text, int(begins[index]), _LOOSE)
    return np.asarray(np.searchsorted(starts, begins[plain]))


def _scan(codes: bytes, line_starts: Ints, index: Ints, lines: int, characters: int) -> MotionColumns | None:
    """Return the motions of plain lines (P,); None if one of their numbers cannot be read.

    :param lines: number of lines before the text; `characters` of characters.
    """
    if not len(index):
        return none()
    body, begins, shift = _plain_body(codes, line_starts, index)
    shift += characters
    raw = np.frombuffer(body, dtype=np.uint8)
    tokens = _number_tokens(body)
    if tokens is None:
        return None
    numbers, spans, points, (via, via_spans, via_target) = _points(raw, begins, shift, tokens)
    keyword = _skip_blanks(raw, begins, 1)
    letter = raw[keyword + ((raw[keyword] | 32) == ord("s"))] | 32
    ends = np.concatenate([begins[1:], [len(raw)]])
    stop = _skip_blanks(raw, ends - 1, -1) + 1
    ptp = letter == ord("p")
    return MotionColumns(
        line=compact(index + 1 + lines, np.int32),
        kind=compact(np.where(ptp, PTP, np.where(letter == ord("c"), CIRC, LIN)), np.int8),
        numbers=numbers[:, :6].copy(),
        posture=postures(np.nan_to_num(numbers[:, 6:8], nan=-1.0).astype(np.int64)),
        external=given(numbers[:, 8:]),
        within=narrow(np.where(spans < 0, 0, spans - points[:, :1, None] - shift[:, None, None])[:, : len(COLUMNS)]),
        keyword=(keyword + shift).astype(np.int32),
        target=(points + shift[:, None]).astype(np.int32),
        tail=(np.stack([points[:, 1], stop], axis=1) + shift[:, None]).astype(np.int32),
        approximated=_approximated(raw, begins, ptp),
        via=via,
        via_spans=via_spans,
        via_target=via_target,
    )


def _plain_body(codes: bytes, line_starts: Ints, index: Ints) -> tuple[bytes, Ints, Ints]:
    """Return the text of some lines (P,) alone, comments blanked out.

    :returns: the text, the offsets of the lines in it (P,), and what to add on each line (P,) to offsets in it for
        those in all codes.
    """
    line_ends = np.append(line_starts[1:], len(codes))
    length = (line_ends - line_starts)[index]
    begins = np.cumsum(length) - length
    shift = line_starts[index] - begins
    body = codes
    if len(index) < len(line_starts):
        body = np.frombuffer(codes, dtype=np.uint8)[np.repeat(shift, length) + np.arange(length.sum())].tobytes()
    if b";" in body:
        body = _COMMENT.sub(lambda comment: b" " * len(comment[0]), body)
    return body, begins, shift


def _number_tokens(body: bytes) -> tuple[Array, Ints, Ints] | None:
    """Return the numbers (T,) in a text, and where each starts and stops (T,); None if one cannot be read."""
    digits = _digits(body)
    starts, stops = numbers_in(digits)
    values = parsed_numbers(digits, starts, stops)
    if values is None:
        values = _values(digits)
    return None if len(values) != len(starts) else (values, starts, stops)


def _points(
    raw: Bytes, begins: Ints, shift: Ints, tokens: tuple[Array, Ints, Ints]
) -> tuple[Array, Offsets, Ints, tuple[Array, Offsets, Ints]]:
    """Return the targets of plain lines, and the auxiliary points of their circles.

    :param raw: the text of the lines; begins: (P,) their offsets in it.
    :param shift: (P,) what to add for offsets in the document.
    :param tokens: numbers of the text, see `_number_tokens`.
    :returns: numbers of targets (P, 14), NaN where there is none; their offsets in the document (P, 14, 2), −1 where
        there is none; offsets of the targets in the text (P, 2); see `MotionColumns` for the auxiliary points.
    """
    values, starts, stops = tokens
    points = np.stack([np.flatnonzero(raw == ord("{")), np.flatnonzero(raw == ord("}")) + 1], axis=1)
    column = _COLUMN[_before(raw, starts)]
    has_circles = len(points) > len(begins)
    if has_circles:  # auxiliary points have columns of their own, before those of the targets
        line = np.searchsorted(begins, points[:, 0], side="right") - 1
        is_target = np.append(line[1:] != line[:-1], True)
        column += np.repeat(
            np.where(is_target, _NUMBERS, 0), np.diff(np.searchsorted(starts, points[:, 0]), append=len(starts))
        )
    numbers = np.full((len(begins), _NUMBERS * (1 + has_circles)), np.nan)
    spans = np.full((*numbers.shape, 2), -1, dtype=np.int32)
    row, column = _places(column, begins, starts)
    offset, shape = (shift[:, None], (len(begins), -1)) if isinstance(row, slice) else (shift[row], (-1,))
    numbers[row, column] = values.reshape(shape)
    spans[row, column, 0] = starts.reshape(shape) + offset
    spans[row, column, 1] = stops.reshape(shape) + offset
    via, via_spans, via_target = no_circles(len(begins))
    if has_circles:
        via, via_spans = numbers[:, :3].copy(), spans[:, :3].copy()
        numbers, spans = numbers[:, _NUMBERS:], spans[:, _NUMBERS:]
        via_target = via_target.copy()
        via_target[line[~is_target]] = points[~is_target] + shift[line[~is_target], None]
        points = points[is_target]
    return numbers, spans, points, (via, via_spans, via_target)


def _places(column: Ints, begins: Ints, starts: Ints) -> tuple[Ints | slice, Ints]:
    """Return which row and column numbers belong to: (T,) each, or where all lines are alike all rows and (C,)."""
    width, rest = divmod(len(starts), len(begins))
    if rest == 0:
        groups = column.reshape(-1, width)
        if (groups == groups[0]).all():  # columns increase within a line, so that no line reaches into the next group
            return slice(None), groups[0]
    first = np.searchsorted(starts, begins)
    return np.repeat(np.arange(len(begins)), np.diff(first, append=len(starts))), column


def _digits(body: bytes) -> Bytes:
    """Return the text with everything but numbers blanked out."""
    digits = np.frombuffer(bytearray(body.translate(_NUMBER_CODES)), dtype=np.uint8)
    exponent = np.flatnonzero((digits | 32) == ord("e"))
    if len(exponent):  # the E of E1, E6POS and C_VEL is none, and the digit behind it no number
        letters = exponent[(digits[exponent - 1] == ord(" ")) | (digits[exponent - 1] > ord("9"))]
        digits[letters] = digits[letters + 1] = ord(" ")
    return digits


def _values(digits: Bytes) -> Array:
    """Return the numbers in a text of numbers and blanks; none if one of them is no number."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # numpy before 2.4 stops at what it cannot read
        try:
            return np.fromstring(digits.tobytes(), sep=" ")
        except ValueError:
            return np.zeros(0)


def _before(raw: Bytes, position: Ints) -> Ints:
    """Return the characters before each position, blanks skipped."""
    return raw[_skip_blanks(raw, position - 1, -1)].astype(np.int64)


def _skip_blanks(raw: Bytes, position: Ints, step: int) -> Ints:
    """Return the first places from each position on, in the direction of `step`, that hold no blank."""
    blank = _BLANK[raw[position]]
    while blank.any():
        position = position + (step * blank if not blank.all() else step)
        blank = _BLANK[raw[position]]
    return position


def _approximated(raw: Bytes, begins: Ints, ptp: Bools) -> Bools:
    """Return which lines are approximated by `$APO.CDIS`."""
    underscore = np.flatnonzero(raw == ord("_"))
    letter = raw[underscore + 1] | 32
    row = np.searchsorted(begins, underscore, side="right") - 1
    is_approximated = np.zeros(len(begins), dtype=np.bool_)
    is_approximated[row[letter == ord("d")]] = True
    is_approximated[row[(letter == ord("s")) & ~ptp[row]]] = True
    return is_approximated


class PlainLines(Struct, frozen=True):
    """Plain lines of a text.

    :ivar motions: in parts.
    :ivar settings: assignments.
    """

    motions: list[MotionColumns]
    settings: PlainSettings

    @property
    def moving(self) -> Ints:
        """(P,) 1-based lines of the motions."""
        return np.concatenate([rows.line for rows in self.motions])

    def others(self, count: int) -> Bools:
        """Return which of the lines 1 … count are neither (count,)."""
        return not_plain(count, self.moving, self.settings)


def not_plain(count: int, moving: Ints, settings: PlainSettings) -> Bools:
    """Return which of the lines 1 … count are neither plain motions nor plain settings (count,).

    :param moving: (P,) lines of plain motions.
    """
    is_other = np.ones(count, dtype=np.bool_)
    is_other[moving - 1] = False
    is_other[settings.line - 1] = False
    return is_other


def plain_of(source: Source, *, bulk: bool = True) -> PlainLines:
    """Return the plain lines of a text; not `bulk`: none, so that all are read one by one."""
    return PlainLines(scan(source), plain_settings.scan(source)) if bulk else PlainLines([none()], no_settings())


def gathered(trace: Trace, plain_by_source: Mapping[Source, PlainLines], *, bulk: bool = True) -> PlainLines:
    """Return the plain rows of an execution trace, taken from the plain lines of its files: no line is scanned twice.

    :param plain_by_source: plain lines of files that were scanned already.
    :param bulk: see `plain_of`.
    """
    motions, settings = [none()], [no_settings()]
    for number, source in enumerate(trace.sources if bulk else ()):
        plain = plain_by_source.get(source) or plain_of(source)
        rows = np.flatnonzero(trace.file == number)
        lines = trace.line[rows]
        columns = merged([*plain.motions], np.arange(sum(map(len, plain.motions))))
        plain_rows = _numbers_of(columns.line, len(source.starts))[lines - 1]
        indices = np.flatnonzero(plain_rows >= 0)
        motions.append(replace(columns.take(plain_rows[indices]), line=compact(rows[indices] + 1, np.int32)))
        plain_rows = _numbers_of(plain.settings.line, len(source.starts))[lines - 1]
        indices = np.flatnonzero(plain_rows >= 0)
        settings.append(PlainSettings(rows[indices] + 1, plain.settings.values[:, plain_rows[indices]]))
    line = np.concatenate([part.line for part in motions])
    order = np.empty(len(line), dtype=np.int64)
    order[np.argsort(line, kind="stable")] = np.arange(len(line))
    given_line = np.concatenate([part.line for part in settings])
    values = np.concatenate([part.values for part in settings], axis=1)
    in_order = np.argsort(given_line, kind="stable")
    return PlainLines([merged(motions, order)], PlainSettings(given_line[in_order], values[:, in_order]))


def _numbers_of(lines: Ints, count: int) -> Ints:
    """Return which of some 1-based lines each of the lines 1 … count is (count,); −1 for others."""
    numbers = np.full(count, -1, dtype=np.int64)
    numbers[lines - 1] = np.arange(len(lines))
    return numbers
