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
from typing import NamedTuple

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
    ViaPoints,
    compact_if_missing,
    compact_postures,
    merged_motions,
    narrow_integers,
    no_motions,
    no_via_points,
)
from postproc.dialects.krl.read.plain_settings import PlainSettings, no_settings
from postproc.frames import Array, any_column
from postproc.program import CIRC, LIN, PTP, Bools, Ints

# possessive quantifiers (``*+``) never go back, so that a line that is not plain is refused in one pass
_STRICT_NUMBER = r"[-+]?+(?:[0-9]++(?:\.[0-9]*+)?|\.[0-9]++)(?:[eE][-+]?+[0-9]++)?"
_LOOSE_NUMBER = r"[-+.0-9][-+.0-9eE]*+"
_STRAIGHT = r"[ \t]*+[Ss]?+(?:[Ll][Ii][Nn]|[Pp][Tt][Pp])"
_SEPARATOR = r"[ \t]*+(?:,[ \t]*+(?=[A-Za-z])|(?=\}))"


_CIRCLE = re.compile(r"[ \t]*+[Ss]?+[Cc][Ii][Rr][Cc]")


@cache
def _line_pattern(number: str, *, circle: bool) -> re.Pattern[str]:
    """Return the regular expression of a plain LIN or PTP, or of a plain CIRC.

    :param number: expression of its numbers: strict, or loose to accept anything that looks like one.
    """
    position = [rf"[{name}{name.lower()}][ \t]++{number}" for name in "XYZABC"]
    components = [r"[Ss][ \t]++(?:[12][0-9]|3[01]|[0-9])", r"[Tt][ \t]++(?:[1-5][0-9]|6[0-3]|[0-9])"]
    components += [rf"[Ee]{axis}[ \t]++{number}" for axis in range(1, 7)]
    begin = r"\{[ \t]*+(?:(?i:E6POS|POS|FRAME)[ \t]*+:[ \t]*+)?(?=[XYZABCxyzabc])"
    required_count = 3 if circle else 0
    point = begin + "".join(f"{component}{_SEPARATOR}" for component in position[:required_count])
    point += "".join(f"(?:{component}{_SEPARATOR})?" for component in position[required_count:])
    other_components = "".join(f"(?:{component}{_SEPARATOR})?" for component in components) + r"\}"
    prefix = rf"{_CIRCLE.pattern}[ \t]*+{point}\}}[ \t]*+,[ \t]*+" if circle else rf"{_STRAIGHT}[ \t]*+"
    suffix = r"(?:[ \t]++(?i:C_(?:DIS|VEL|ORI|PTP|SPL))){0,2}[ \t]*+(?:;[^\r\n]*+)?\r{0,2}+\n"
    return re.compile(f"{prefix}{point}{other_components}{suffix}")


def _is_plain(text: str, begin: int, number: str) -> bool:
    """Return whether a plain line begins at an offset; `number` is the expression of its numbers."""
    circle = _CIRCLE.match(text, begin) is not None
    return _line_pattern(number, circle=circle).match(text, begin) is not None


_MARK = 1
"""Code that stands for a character of a number where lines are compared by their form."""
_NUMBER = bytes.maketrans(b"\1" + b"0123456789+-.", b"?" + b"\1" * 13)
_LIMITED_COMPONENT = re.compile(rb"[SsTtEe][ \t]*\x01")
"""Components that may have certain values or names only, so that lines with them are decided one by one."""
_COMMENT = re.compile(rb";[^\r\n]*")
_NUMBERS = len(COLUMNS) + 6
"""Numbers of a target: X … T, and E1 … E6."""
_COLUMN = np.full(256, -1, dtype=np.int64)
_COLUMN[np.frombuffer(b"XYZABCST123456", dtype=np.uint8)] = np.arange(_NUMBERS)
_COLUMN[np.frombuffer(b"xyzabcst", dtype=np.uint8)] = np.arange(8)
"""Column of a number by the last character of the name before it, as its code: the digit for E1 … E6."""
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
        columns.append(_plain_motions(text[begin:end], part_starts - begin, lines.start, begin))
    return columns


def _plain_motions(text: str, starts: Ints, lines: int, characters: int) -> MotionColumns:
    """Return the plain motions of a piece of a document.

    :param text: the piece.
    :param starts: offsets of its lines in it.
    :param lines: number of lines before it in the document; `characters` number of characters.
    """
    codes = text.encode("ascii", "replace")
    line_indices = _plain_line_indices(text, codes, starts)
    motions = _motions_of_lines(codes, starts, line_indices, lines, characters)
    if motions is None:  # something that looks like a number is none, such as 1.2.3
        strict_indices = [
            index for index in line_indices.tolist() if _is_plain(text, int(starts[index]), _STRICT_NUMBER)
        ]
        strict_motions = _motions_of_lines(codes, starts, np.array(strict_indices, dtype=np.int64), lines, characters)
        motions = no_motions() if strict_motions is None else strict_motions
    # numbers such as 1E999 are refused where statements are read
    infinite_masks = [np.isinf(values) for values in (motions.numbers, motions.external, motions.via)]
    if any(mask.any() for mask in infinite_masks):
        motions = motions.take(~np.logical_or.reduce([any_column(mask) for mask in infinite_masks]))
    return motions


def _plain_line_indices(text: str, codes: bytes, starts: Ints) -> Ints:
    """Return the indices of lines (P,) that are plain if all that looks like a number is one.

    Lines that differ only in their numbers have one form; one line of each form is examined.

    :param text: as characters, and `codes` as bytes.
    :param starts: offsets of its lines.
    """
    marked_codes = np.frombuffer(codes.translate(_NUMBER), dtype=np.uint8)
    is_number_tail = marked_codes == _MARK
    is_number_tail[1:] &= is_number_tail[:-1].copy()
    is_number_tail[:1] = False
    forms = marked_codes[~is_number_tail].tobytes().split(b"\n")  # each number is one mark
    begins = np.append(0, np.flatnonzero(marked_codes == ord("\n")) + 1)
    line_of_form = dict(zip(forms, range(len(forms)), strict=True))
    verdicts = {form: _is_plain(text, int(begins[index]), _LOOSE_NUMBER) for form, index in line_of_form.items()}
    is_plain_line = np.fromiter(map(verdicts.__getitem__, forms), np.bool_, len(forms))
    limited_forms = {form for form, is_plain in verdicts.items() if is_plain and _LIMITED_COMPONENT.search(form)}
    if limited_forms:
        for index in [index for index, form in enumerate(forms) if form in limited_forms]:
            is_plain_line[index] = _is_plain(text, int(begins[index]), _LOOSE_NUMBER)
    return np.asarray(np.searchsorted(starts, begins[is_plain_line]))


def _motions_of_lines(
    codes: bytes, line_starts: Ints, index: Ints, lines: int, characters: int
) -> MotionColumns | None:
    """Return the motions of P plain lines; None if one of their numbers cannot be read.

    :param codes: text with these and other lines; `line_starts` the offsets of all its lines.
    :param index: (P,) of the plain lines in the text.
    :param lines: number of lines before the text in the document; `characters` number of characters.
    """
    if not len(index):
        return no_motions()
    body, begins, shift = _plain_body(codes, line_starts, index)
    shift += characters
    raw = np.frombuffer(body, dtype=np.uint8)
    tokens = _number_tokens(body)
    if tokens is None:
        return None
    numbers, spans, points, via_points = _points(raw, begins, shift, tokens)
    keyword = _skip_blanks(raw, begins, 1)
    kind = _kinds(raw, keyword)
    ends = np.concatenate([begins[1:], [len(raw)]])
    stop = _skip_blanks(raw, ends - 1, -1) + 1
    target_start = points[:, :1, None] + shift[:, None, None]
    return MotionColumns(
        line=compact(index + 1 + lines, np.int32),
        kind=compact(kind, np.int8),
        numbers=numbers[:, :6].copy(),
        posture=compact_postures(np.nan_to_num(numbers[:, 6:8], nan=-1.0).astype(np.int64)),
        external=compact_if_missing(numbers[:, 8:]),
        relative_spans=narrow_integers(np.where(spans < 0, 0, spans - target_start)[:, : len(COLUMNS)]),
        keyword=(keyword + shift).astype(np.int32),
        target=(points + shift[:, None]).astype(np.int32),
        tail=(np.stack([points[:, 1], stop], axis=1) + shift[:, None]).astype(np.int32),
        approximated=_approximated(raw, begins, kind == PTP),
        via=via_points.numbers,
        via_spans=via_points.spans,
        via_target=via_points.targets,
    )


def _kinds(raw: Bytes, keyword: Ints) -> Ints:
    """Return the kinds of P motions (P,): `LIN`, `CIRC` or `PTP`.

    :param raw: the text of the lines; `keyword` (P,) offsets of the instructions in it.
    """
    is_spline = (raw[keyword] | 32) == ord("s")  # lower case
    letter = raw[keyword + is_spline] | 32  # of LIN, CIRC or PTP, behind the S of splines
    return np.where(letter == ord("p"), PTP, np.where(letter == ord("c"), CIRC, LIN))


class _PlainBody(NamedTuple):
    """The text of P plain lines alone, with comments blanked out.

    :ivar text: of these lines.
    :ivar begins: (P,) offsets of the lines in it.
    :ivar shift: (P,) what to add to offsets on each line to get those in the whole text.
    """

    text: bytes
    begins: Ints
    shift: Ints


def _plain_body(codes: bytes, line_starts: Ints, index: Ints) -> _PlainBody:
    """Return the text of P lines alone.

    :param codes: the whole text; `line_starts` the offsets of all its lines.
    :param index: (P,) of the lines.
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
    return _PlainBody(body, begins, shift)


class _NumberTokens(NamedTuple):
    """The T numbers in a text.

    :ivar values: (T,) the numbers.
    :ivar starts: (T,) their offsets; `stops` (T,) the offsets behind them.
    """

    values: Array
    starts: Ints
    stops: Ints


def _number_tokens(body: bytes) -> _NumberTokens | None:
    """Return the numbers in a text; None if one cannot be read."""
    digits = _digits(body)
    starts, stops = numbers_in(digits)
    values = parsed_numbers(digits, starts, stops)
    if values is None:
        values = _parsed_numbers(digits)
    return None if len(values) != len(starts) else _NumberTokens(values, starts, stops)


class _Points(NamedTuple):
    """The points of P plain lines.

    :ivar numbers: (P, 14) X … T, E1 … E6 of the targets; NaN where there is none.
    :ivar spans: (P, 14, 2) spans of these numbers in the document; −1 where there is none.
    :ivar targets: (P, 2) spans of the targets in the text of the lines, braces included.
    :ivar via_points: auxiliary points of circles.
    """

    numbers: Array
    spans: Offsets
    targets: Ints
    via_points: ViaPoints


def _points(raw: Bytes, begins: Ints, shift: Ints, tokens: _NumberTokens) -> _Points:
    """Return the targets of plain lines, and the auxiliary points of their circles.

    :param raw: the text of the lines.
    :param begins: (P,) their offsets in it; `shift` (P,) what to add for offsets in the document.
    :param tokens: numbers of the text.
    """
    values, starts, stops = tokens
    points = np.stack([np.flatnonzero(raw == ord("{")), np.flatnonzero(raw == ord("}")) + 1], axis=1)
    column = _COLUMN[_characters_before(raw, starts)]
    has_circles = len(points) > len(begins)
    if has_circles:  # auxiliary points have columns of their own, before those of the targets
        line = np.searchsorted(begins, points[:, 0], side="right") - 1
        is_target = np.append(line[1:] != line[:-1], True)  # the last point of its line
        number_count = np.diff(np.searchsorted(starts, points[:, 0]), append=len(starts))  # of each point
        column += np.repeat(np.where(is_target, _NUMBERS, 0), number_count)
    numbers = np.full((len(begins), _NUMBERS * (1 + has_circles)), np.nan)
    spans = np.full((*numbers.shape, 2), -1, dtype=np.int32)
    row, column = _rows_and_columns(column, begins, starts)
    # all rows with the same columns: the numbers are a table with one row for each line
    offset, shape = (shift[:, None], (len(begins), -1)) if isinstance(row, slice) else (shift[row], (-1,))
    numbers[row, column] = values.reshape(shape)
    spans[row, column, 0] = starts.reshape(shape) + offset
    spans[row, column, 1] = stops.reshape(shape) + offset
    via_points = no_via_points(len(begins))
    if has_circles:
        via_targets = via_points.targets.copy()
        via_targets[line[~is_target]] = points[~is_target] + shift[line[~is_target], None]
        via_points = ViaPoints(numbers[:, :3].copy(), spans[:, :3].copy(), via_targets)
        numbers, spans = numbers[:, _NUMBERS:], spans[:, _NUMBERS:]
        points = points[is_target]
    return _Points(numbers, spans, points, via_points)


def _rows_and_columns(column: Ints, begins: Ints, starts: Ints) -> tuple[Ints | slice, Ints]:
    """Return the row (T,) and the column (T,) of each of T numbers in the table of P lines.

    If all lines have the same C columns, the row is a slice of all rows, and the columns are (C,).

    :param column: (T,) column of each number; `starts` (T,) its offset.
    :param begins: (P,) offsets of the lines.
    """
    width, remainder = divmod(len(starts), len(begins))
    if remainder == 0:
        groups = column.reshape(-1, width)
        if (groups == groups[0]).all():  # columns increase within a line, so that no line reaches into the next group
            return slice(None), groups[0]
    first = np.searchsorted(starts, begins)
    return np.repeat(np.arange(len(begins)), np.diff(first, append=len(starts))), column


def _digits(body: bytes) -> Bytes:
    """Return a text as codes, with everything but numbers replaced by blanks."""
    digits = np.frombuffer(bytearray(body.translate(_NUMBER_CODES)), dtype=np.uint8)
    exponent = np.flatnonzero((digits | 32) == ord("e"))
    if len(exponent):  # the E of E1, E6POS and C_VEL is no exponent, and the digit behind it no number
        letters = exponent[(digits[exponent - 1] == ord(" ")) | (digits[exponent - 1] > ord("9"))]
        digits[letters] = digits[letters + 1] = ord(" ")
    return digits


def _parsed_numbers(digits: Bytes) -> Array:
    """Return the numbers in a text of numbers and blanks; an empty array if one of them cannot be read."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # numpy before 2.4 stops at what it cannot read
        try:
            return np.fromstring(digits.tobytes(), sep=" ")
        except ValueError:
            return np.zeros(0)


def _characters_before(raw: Bytes, position: Ints) -> Ints:
    """Return the codes (n,) of the characters before offsets of a text (`position`, (n,)), blanks skipped."""
    return raw[_skip_blanks(raw, position - 1, -1)].astype(np.int64)


def _skip_blanks(raw: Bytes, position: Ints, step: int) -> Ints:
    """Return for each offset of a text (`position`, (n,)) the next one without a blank; `step`: 1 forward, −1 back."""
    is_blank = _BLANK[raw[position]]
    while is_blank.any():
        position = position + (step * is_blank if not is_blank.all() else step)
        is_blank = _BLANK[raw[position]]
    return position


def _approximated(raw: Bytes, begins: Ints, is_ptp: Bools) -> Bools:
    """Return the lines (P,) that are approximated by `$APO.CDIS`: with C_DIS, and for path motions C_SPL.

    :param raw: the text of the lines; `begins` (P,) their offsets in it.
    :param is_ptp: (P,) True for PTP.
    """
    underscore = np.flatnonzero(raw == ord("_"))
    letter = raw[underscore + 1] | 32  # lower case: D of C_DIS, S of C_SPL
    row = np.searchsorted(begins, underscore, side="right") - 1
    is_approximated = np.zeros(len(begins), dtype=np.bool_)
    is_approximated[row[letter == ord("d")]] = True
    is_approximated[row[(letter == ord("s")) & ~is_ptp[row]]] = True
    return is_approximated


class PlainLines(Struct, frozen=True):
    """Plain lines of a file, or plain rows of an execution trace.

    :ivar motions: in parts.
    :ivar settings: assignments to system variables.
    """

    motions: list[MotionColumns]
    settings: PlainSettings

    @property
    def motion_lines(self) -> Ints:
        """(P,) 1-based lines of the motions."""
        return np.concatenate([rows.line for rows in self.motions])

    def is_other(self, count: int) -> Bools:
        """Return which of the lines 1 … count are neither plain motions nor plain settings (count,)."""
        return is_not_plain(count, self.motion_lines, self.settings)


def is_not_plain(count: int, motion_lines: Ints, settings: PlainSettings) -> Bools:
    """Return which of the lines 1 … count are neither plain motions nor plain settings (count,).

    :param motion_lines: (P,) lines of plain motions.
    """
    is_other = np.ones(count, dtype=np.bool_)
    is_other[motion_lines - 1] = False
    is_other[settings.line - 1] = False
    return is_other


def plain_of(source: Source, *, bulk: bool = True) -> PlainLines:
    """Return the plain lines of a file.

    :param bulk: False to find none, so that all lines are read one by one.
    """
    return PlainLines(scan(source), plain_settings.scan(source)) if bulk else PlainLines([no_motions()], no_settings())


def plain_rows_of_trace(trace: Trace, plain_by_source: Mapping[Source, PlainLines], *, bulk: bool = True) -> PlainLines:
    """Return the plain rows of an execution trace, taken from the plain lines of its files.

    :param plain_by_source: plain lines of files that have been scanned, so that none is scanned twice.
    :param bulk: see `plain_of`.
    """
    motions, settings = [no_motions()], [no_settings()]
    for number, source in enumerate(trace.sources if bulk else ()):
        source_lines = plain_by_source.get(source) or plain_of(source)
        rows = np.flatnonzero(trace.file == number)
        lines = trace.line[rows]
        columns = merged_motions([*source_lines.motions], np.arange(sum(map(len, source_lines.motions))))
        motion_indices = _index_of_line(columns.line, len(source.starts))[lines - 1]
        is_motion = motion_indices >= 0
        motions.append(replace(columns.take(motion_indices[is_motion]), line=compact(rows[is_motion] + 1, np.int32)))
        setting_indices = _index_of_line(source_lines.settings.line, len(source.starts))[lines - 1]
        is_setting = setting_indices >= 0
        values = source_lines.settings.values[:, setting_indices[is_setting]]
        settings.append(PlainSettings(rows[is_setting] + 1, values))
    motion_line = np.concatenate([part.line for part in motions])
    places = np.empty(len(motion_line), dtype=np.int64)
    places[np.argsort(motion_line, kind="stable")] = np.arange(len(motion_line))
    setting_line = np.concatenate([part.line for part in settings])
    values = np.concatenate([part.values for part in settings], axis=1)
    order = np.argsort(setting_line, kind="stable")
    return PlainLines([merged_motions(motions, places)], PlainSettings(setting_line[order], values[:, order]))


def _index_of_line(lines: Ints, count: int) -> Ints:
    """Return the index in `lines` of each of the 1-based lines 1 … count (count,); −1 for lines that are not in it."""
    indices = np.full(count, -1, dtype=np.int64)
    indices[lines - 1] = np.arange(len(lines))
    return indices
