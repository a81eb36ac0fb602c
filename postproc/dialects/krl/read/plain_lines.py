"""Plain motion lines, all at once: ``LIN {X …,Y …,Z …,A …,B …,C …} C_DIS`` a hundred thousand times, and circles.

A line is plain if the regular expression `_line_pattern` accepts it. Lines of one form, which differ in their numbers
only, are decided at once; the numbers are then found and converted by numpy. Other lines (other orders of components,
names, CA) are read statement by statement (`interpreter`, `motion_reader`). Plain lines could be read so too: tests
read generated programs, also with errors, both ways and compare.
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
from postproc.decimals import Bytes, parsed_numbers, word_bounds
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
_STRAIGHT_MOTION = r"[ \t]*+[Ss]?+(?:[Ll][Ii][Nn]|[Pp][Tt][Pp])"
_SEPARATOR = r"[ \t]*+(?:,[ \t]*+(?=[A-Za-z])|(?=\}))"


_CIRCLE_PATTERN = re.compile(r"[ \t]*+[Ss]?+[Cc][Ii][Rr][Cc]")


@cache
def _line_pattern(number: str, *, circle: bool) -> re.Pattern[str]:
    """Return the regular expression of a plain LIN or PTP, or of a plain CIRC.

    :param number: expression of the numbers in it: `_STRICT_NUMBER`, or `_LOOSE_NUMBER` to accept also texts that look
        like numbers, such as 1.2.3.
    :param circle: True for CIRC, with an auxiliary point before the target.
    """
    position = [rf"[{name}{name.lower()}][ \t]++{number}" for name in "XYZABC"]
    components = [r"[Ss][ \t]++(?:[12][0-9]|3[01]|[0-9])", r"[Tt][ \t]++(?:[1-5][0-9]|6[0-3]|[0-9])"]
    components += [rf"[Ee]{axis}[ \t]++{number}" for axis in range(1, 7)]
    # an optional type, and at least one of X … C
    begin = r"\{[ \t]*+(?:(?i:E6POS|POS|FRAME)[ \t]*+:[ \t]*+)?(?=[XYZABCxyzabc])"
    required_count = 3 if circle else 0  # X, Y, Z of both points of a circle
    point = begin + "".join(f"{component}{_SEPARATOR}" for component in position[:required_count])
    point += "".join(f"(?:{component}{_SEPARATOR})?" for component in position[required_count:])
    other_components = "".join(f"(?:{component}{_SEPARATOR})?" for component in components) + r"\}"
    prefix = rf"{_CIRCLE_PATTERN.pattern}[ \t]*+{point}\}}[ \t]*+,[ \t]*+" if circle else rf"{_STRAIGHT_MOTION}[ \t]*+"
    # up to two words of approximation, a comment, the end of the line
    suffix = r"(?:[ \t]++(?i:C_(?:DIS|VEL|ORI|PTP|SPL))){0,2}[ \t]*+(?:;[^\r\n]*+)?\r{0,2}+\n"
    return re.compile(f"{prefix}{point}{other_components}{suffix}")


def _is_plain(text: str, begin: int, number: str) -> bool:
    """Return whether a plain line begins at an offset of a text.

    :param number: expression of its numbers, see `_line_pattern`.
    """
    circle = _CIRCLE_PATTERN.match(text, begin) is not None
    return _line_pattern(number, circle=circle).match(text, begin) is not None


_NUMBER_MARK = 1
"""Code that replaces each character of a number, so that lines of one form are equal."""
_MARK_NUMBERS = bytes.maketrans(b"\1" + b"0123456789+-.", b"?" + b"\1" * 13)
_LIMITED_COMPONENT = re.compile(rb"[SsTtEe][ \t]*\x01")
"""Components with a limited range or number in their name (S, T, E1 …): lines with them are decided one by one."""
_COMMENT_PATTERN = re.compile(rb";[^\r\n]*")
_NUMBERS_OF_TARGET = len(COLUMNS) + 6
"""Numbers of a target: X … T, and E1 … E6."""
_COLUMN_OF_CHARACTER = np.full(256, -1, dtype=np.int64)
_COLUMN_OF_CHARACTER[np.frombuffer(b"XYZABCST123456", dtype=np.uint8)] = np.arange(_NUMBERS_OF_TARGET)
_COLUMN_OF_CHARACTER[np.frombuffer(b"xyzabcst", dtype=np.uint8)] = np.arange(8)
"""Column of a number by the last character of the name before it, as its code: the digit for E1 … E6."""
_KEEP_NUMBERS = bytes(byte if byte in b"0123456789+-.eE" else 32 for byte in range(256))
_IS_BLANK = np.zeros(256, dtype=np.bool_)
_IS_BLANK[[9, 10, 13, 32]] = True


def scan(source: Source) -> list[MotionColumns]:
    """Return all plain motions of a file, in consecutive parts."""
    text, starts = source.text, source.starts
    columns = []
    for lines in chunks(len(starts)):
        part_starts = starts[lines]
        begin = int(part_starts[0])
        end = int(starts[lines.stop]) if lines.stop < len(starts) else len(text)
        columns.append(_plain_motions(text[begin:end], part_starts - begin, lines.start, begin))
    return columns


def _plain_motions(text: str, starts: Ints, line_count: int, character_count: int) -> MotionColumns:
    """Return the plain motions of a piece of a file.

    :param text: the piece, which begins with a line.
    :param starts: (n,) offsets in the piece at which its lines begin.
    :param line_count: number of lines of the file before the piece.
    :param character_count: number of characters of the file before the piece.
    """
    codes = text.encode("ascii", "replace")  # one byte for each character: offsets stay
    line_indices = _plain_line_indices(text, codes, starts)
    motions = _motions_of_lines(codes, starts, line_indices, line_count, character_count)
    if motions is None:  # a text that looks like a number is none, such as 1.2.3
        strict_indices = [
            index for index in line_indices.tolist() if _is_plain(text, int(starts[index]), _STRICT_NUMBER)
        ]
        strict_motions = _motions_of_lines(
            codes, starts, np.array(strict_indices, dtype=np.int64), line_count, character_count
        )
        motions = no_motions() if strict_motions is None else strict_motions
    # lines with infinite numbers, such as 1E999, are left to `motion_reader`, which refuses them
    infinite_masks = [np.isinf(values) for values in (motions.numbers, motions.external, motions.via)]
    if any(mask.any() for mask in infinite_masks):
        motions = motions.take(~np.logical_or.reduce([any_column(mask) for mask in infinite_masks]))
    return motions


def _plain_line_indices(text: str, codes: bytes, starts: Ints) -> Ints:
    """Return the indices (P,) of the lines of a text that are plain, if all that looks like a number in them is one.

    The form of a line is its text with each number replaced by one mark. Lines of one form are all plain, or none is:
    one line of each form is matched with the loose `_line_pattern`. Forms with S, T or E1 … E6 are an exception, since
    these have a limited range: all their lines are matched.

    :param text: the text as characters; `codes` the same as bytes.
    :param starts: (n,) offsets at which its lines begin.
    """
    marked_codes = np.frombuffer(codes.translate(_MARK_NUMBERS), dtype=np.uint8)
    # characters of a number behind its first are left out, so that each number is one mark
    is_number = marked_codes == _NUMBER_MARK
    is_number_tail = np.zeros_like(is_number)
    is_number_tail[1:] = is_number[1:] & is_number[:-1]
    forms = marked_codes[~is_number_tail].tobytes().split(b"\n")
    begins = np.append(0, np.flatnonzero(marked_codes == ord("\n")) + 1)  # of the line of each form
    line_of_form = {form: index for index, form in enumerate(forms)}  # the last line of each form
    verdicts = {form: _is_plain(text, int(begins[index]), _LOOSE_NUMBER) for form, index in line_of_form.items()}
    is_plain_line = np.fromiter(map(verdicts.__getitem__, forms), np.bool_, len(forms))
    limited_forms = {form for form, is_plain in verdicts.items() if is_plain and _LIMITED_COMPONENT.search(form)}
    if limited_forms:
        for index in [index for index, form in enumerate(forms) if form in limited_forms]:
            is_plain_line[index] = _is_plain(text, int(begins[index]), _LOOSE_NUMBER)
    return np.asarray(np.searchsorted(starts, begins[is_plain_line]))


def _motions_of_lines(
    codes: bytes, line_starts: Ints, index: Ints, line_count: int, character_count: int
) -> MotionColumns | None:
    """Return the motions of P plain lines; None if one of their numbers cannot be read.

    :param codes: a piece of the file, with these and other lines.
    :param line_starts: (n,) offsets at which the lines of the piece begin.
    :param index: (P,) indices of the plain lines in it.
    :param line_count: number of lines of the file before the piece.
    :param character_count: number of characters of the file before the piece.
    """
    if not len(index):
        return no_motions()
    body, begins, shift = _plain_body(codes, line_starts, index)
    shift += character_count  # now offset in the file minus offset in `body`
    raw = np.frombuffer(body, dtype=np.uint8)
    tokens = _number_tokens(body)
    if tokens is None:
        return None
    numbers, spans, points, via_points = _points_of_lines(raw, begins, shift, tokens)
    keyword = _skip_blanks(raw, begins, 1)
    kind = _kinds(raw, keyword)
    ends = np.concatenate([begins[1:], [len(raw)]])
    stop = _skip_blanks(raw, ends - 1, -1) + 1  # behind the last character that is neither blank nor comment
    target_start = points[:, :1, None] + shift[:, None, None]  # (P, 1, 1), in the file
    return MotionColumns(
        trace_row=compact(index + 1 + line_count, np.int32),
        kind=compact(kind, np.int8),
        # columns of `numbers`: X … C, S and T, E1 … E6
        numbers=numbers[:, :6].copy(),
        posture=compact_postures(np.nan_to_num(numbers[:, 6:8], nan=-1.0).astype(np.int64)),
        external=compact_if_missing(numbers[:, 8:]),
        # from the start of the target; 0 where missing
        relative_spans=narrow_integers(np.where(spans < 0, 0, spans - target_start)[:, : len(COLUMNS)]),
        keyword=(keyword + shift).astype(np.int32),
        target=(points + shift[:, None]).astype(np.int32),
        tail=(np.stack([points[:, 1], stop], axis=1) + shift[:, None]).astype(np.int32),
        approximated=_is_approximated(raw, begins, kind == PTP),
        via=via_points.numbers,
        via_spans=via_points.spans,
        via_target=via_points.targets,
    )


def _kinds(raw: Bytes, keyword: Ints) -> Ints:
    """Return the kinds of P motions (P,): `LIN`, `CIRC` or `PTP`.

    :param raw: the text of the lines as character codes.
    :param keyword: (P,) offsets of the instructions in it.
    """
    is_spline = (raw[keyword] | 32) == ord("s")  # | 32: lower case
    letter = raw[keyword + is_spline] | 32  # first letter of LIN, CIRC or PTP, behind the S of splines
    return np.where(letter == ord("p"), PTP, np.where(letter == ord("c"), CIRC, LIN))


class _PlainBody(NamedTuple):
    """The text of P plain lines alone, with comments blanked out.

    :ivar text: the lines, one after the other.
    :ivar begins: (P,) offsets in `text` at which the lines begin.
    :ivar shift: (P,) offset in the whole text minus offset in `text`, for each line.
    """

    text: bytes
    begins: Ints
    shift: Ints


def _plain_body(codes: bytes, line_starts: Ints, index: Ints) -> _PlainBody:
    """Return the text of P lines of a text alone.

    :param codes: the whole text.
    :param line_starts: (n,) offsets at which its lines begin.
    :param index: (P,) indices of the lines to return.
    """
    line_ends = np.append(line_starts[1:], len(codes))
    length = (line_ends - line_starts)[index]
    begins = np.cumsum(length) - length  # lengths of the lines before
    shift = line_starts[index] - begins
    body = codes
    if len(index) < len(line_starts):  # not all lines are plain: copy the characters of those that are
        body = np.frombuffer(codes, dtype=np.uint8)[np.repeat(shift, length) + np.arange(length.sum())].tobytes()
    if b";" in body:
        body = _COMMENT_PATTERN.sub(lambda comment: b" " * len(comment[0]), body)
    return _PlainBody(body, begins, shift)


class _NumberTokens(NamedTuple):
    """The T numbers in a text.

    :ivar values: (T,) the numbers.
    :ivar starts: (T,) offsets of their first characters.
    :ivar stops: (T,) offsets behind their last characters.
    """

    values: Array
    starts: Ints
    stops: Ints


def _number_tokens(body: bytes) -> _NumberTokens | None:
    """Return the numbers in a text; None if a number cannot be read."""
    number_codes = _codes_of_numbers(body)
    starts, stops = word_bounds(number_codes)
    values = parsed_numbers(number_codes, starts, stops)
    if values is None:  # a number is not plain, as with an exponent
        values = _parsed_numbers(number_codes)
    return None if len(values) != len(starts) else _NumberTokens(values, starts, stops)


class _LinePoints(NamedTuple):
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


def _points_of_lines(raw: Bytes, begins: Ints, shift: Ints, tokens: _NumberTokens) -> _LinePoints:
    """Return the targets of plain lines, and the auxiliary points of their circles.

    :param raw: the text of the lines as codes.
    :param begins: (P,) offsets in it at which the lines begin.
    :param shift: (P,) offset in the file minus offset in the text, for each line.
    :param tokens: the numbers of the text.
    """
    # spans of all points: a line has one point, a circle two
    points = np.stack([np.flatnonzero(raw == ord("{")), np.flatnonzero(raw == ord("}")) + 1], axis=1)
    column = _COLUMN_OF_CHARACTER[_characters_before(raw, tokens.starts)]  # of each number
    via_points = no_via_points(len(begins))
    if len(points) == len(begins):  # no circles
        numbers, spans = _number_table(tokens, column, _NUMBERS_OF_TARGET, begins, shift)
        return _LinePoints(numbers, spans, points, via_points)
    line = np.searchsorted(begins, points[:, 0], side="right") - 1  # index of the line of each point
    is_target = np.append(line[1:] != line[:-1], True)  # the last point of its line
    # numbers of auxiliary points are in the first columns, those of targets behind them
    number_count = np.diff(np.searchsorted(tokens.starts, points[:, 0]), append=len(column))  # of each point
    column += np.repeat(np.where(is_target, _NUMBERS_OF_TARGET, 0), number_count)
    numbers, spans = _number_table(tokens, column, 2 * _NUMBERS_OF_TARGET, begins, shift)
    via_line, via_targets = line[~is_target], via_points.targets.copy()
    via_targets[via_line] = points[~is_target] + shift[via_line, None]
    via_points = ViaPoints(numbers[:, :3].copy(), spans[:, :3].copy(), via_targets)
    return _LinePoints(numbers[:, _NUMBERS_OF_TARGET:], spans[:, _NUMBERS_OF_TARGET:], points[is_target], via_points)


def _number_table(tokens: _NumberTokens, column: Ints, width: int, begins: Ints, shift: Ints) -> tuple[Array, Offsets]:
    """Return the T numbers in P lines as a table (P, width), and their spans in the file (P, width, 2).

    A line without a number for a column has NaN there, and a span of −1.

    :param tokens: the numbers, and their offsets in the text of the lines.
    :param column: (T,) column of each number in the table.
    :param begins: (P,) offsets in the text at which the lines begin.
    :param shift: (P,) offset in the file minus offset in the text, for each line.
    """
    first_token = np.searchsorted(tokens.starts, begins)  # index of the first number of each line
    row = np.repeat(np.arange(len(begins)), np.diff(first_token, append=len(column)))
    numbers = np.full((len(begins), width), np.nan)
    spans = np.full((len(begins), width, 2), -1, dtype=np.int32)
    numbers[row, column] = tokens.values
    spans[row, column, 0] = tokens.starts + shift[row]
    spans[row, column, 1] = tokens.stops + shift[row]
    return numbers, spans


def _codes_of_numbers(body: bytes) -> Bytes:
    """Return a text as codes, with all characters that are not part of a number replaced by blanks."""
    codes = np.frombuffer(bytearray(body.translate(_KEEP_NUMBERS)), dtype=np.uint8)
    letters = np.flatnonzero((codes | 32) == ord("e"))  # | 32: lower case
    # the E of E1, E6POS and C_VEL follows a blank or a letter: it is no exponent, and a digit behind it no number
    if len(letters):
        previous_codes = codes[letters - 1]
        letters_of_names = letters[(previous_codes == ord(" ")) | (previous_codes > ord("9"))]  # > "9": a letter
        codes[letters_of_names] = codes[letters_of_names + 1] = ord(" ")
    return codes


def _parsed_numbers(codes: Bytes) -> Array:
    """Return the numbers in a text of numbers and blanks, up to the first that cannot be read.

    At such a number some versions of numpy stop, and others raise an error: the result is empty then.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # numpy before 2.4 stops at what it cannot read
        try:
            return np.fromstring(codes.tobytes(), sep=" ")
        except ValueError:
            return np.zeros(0)


def _characters_before(raw: Bytes, position: Ints) -> Ints:
    """Return the codes (n,) of the last characters other than blanks before offsets of a text (`position`, (n,))."""
    return raw[_skip_blanks(raw, position - 1, -1)].astype(np.int64)


def _skip_blanks(raw: Bytes, position: Ints, step: int) -> Ints:
    """Return the offset of the next character that is no blank, for each offset of a text (n,).

    :param position: (n,) the offsets; those of other characters than blanks stay.
    :param step: 1: forward; −1: back.
    """
    is_blank = _IS_BLANK[raw[position]]
    while is_blank.any():
        # one step for all is faster, while all of them are blanks
        position = position + (step * is_blank if not is_blank.all() else step)
        is_blank = _IS_BLANK[raw[position]]
    return position


def _is_approximated(raw: Bytes, begins: Ints, is_ptp: Bools) -> Bools:
    """Return which lines (P,) are approximated by `$APO.CDIS`: with C_DIS, and with C_SPL if they are no PTP.

    :param raw: the text of the lines as codes.
    :param begins: (P,) offsets in it at which the lines begin.
    :param is_ptp: (P,) True for PTP.
    """
    underscore = np.flatnonzero(raw == ord("_"))  # plain lines have them in C_DIS, C_SPL, C_VEL … alone
    letter = raw[underscore + 1] | 32  # D of C_DIS, S of C_SPL, as lower case
    row = np.searchsorted(begins, underscore, side="right") - 1  # index of the line
    is_approximated = np.zeros(len(begins), dtype=np.bool_)
    is_approximated[row[letter == ord("d")]] = True
    is_approximated[row[(letter == ord("s")) & ~is_ptp[row]]] = True
    return is_approximated


class PlainLines(Struct, frozen=True):
    """Plain lines of a file, or plain rows of an execution trace.

    :ivar motions: the plain motions, in parts.
    :ivar settings: the plain assignments to system variables.
    """

    motions: list[MotionColumns]
    settings: PlainSettings

    @property
    def motion_lines(self) -> Ints:
        """Lines of the motions (P,), from 1."""
        return np.concatenate([columns.trace_row for columns in self.motions])

    def is_other_line(self, count: int) -> Bools:
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


def plain_lines_of(source: Source, *, bulk: bool = True) -> PlainLines:
    """Return the plain lines of a file.

    :param bulk: False to return none, so that all lines are read one by one.
    """
    return PlainLines(scan(source), plain_settings.scan(source)) if bulk else PlainLines([no_motions()], no_settings())


def plain_rows_of_trace(trace: Trace, plain_by_source: Mapping[Source, PlainLines], *, bulk: bool = True) -> PlainLines:
    """Return the plain rows of an execution trace, in order, taken from the plain lines of its files.

    :param plain_by_source: file → plain lines, for files that have been scanned already.
    :param bulk: see `plain_lines_of`.
    """
    motions, settings = [no_motions()], [no_settings()]
    for number, source in enumerate(trace.sources if bulk else ()):
        source_lines = plain_by_source.get(source) or plain_lines_of(source)
        rows = np.flatnonzero(trace.file == number)  # of this file, from 0
        lines = trace.line[rows]
        columns = merged_motions([*source_lines.motions], np.arange(sum(map(len, source_lines.motions))))
        # for each row the index of its motion, or setting; −1 if it is none
        motion_indices = _index_of_line(columns.trace_row, len(source.starts))[lines - 1]
        is_motion = motion_indices >= 0
        motions.append(
            replace(columns.take(motion_indices[is_motion]), trace_row=compact(rows[is_motion] + 1, np.int32))
        )
        setting_indices = _index_of_line(source_lines.settings.line, len(source.starts))[lines - 1]
        is_setting = setting_indices >= 0
        values = source_lines.settings.values[:, setting_indices[is_setting]]
        settings.append(PlainSettings(rows[is_setting] + 1, values))
    # sort the motions and settings of all files by their rows
    motion_rows = np.concatenate([part.trace_row for part in motions])
    ranks = np.empty(len(motion_rows), dtype=np.int64)  # of each motion by its row, from 0
    ranks[np.argsort(motion_rows, kind="stable")] = np.arange(len(motion_rows))
    setting_rows = np.concatenate([part.line for part in settings])
    values = np.concatenate([part.values for part in settings], axis=1)
    order = np.argsort(setting_rows, kind="stable")
    return PlainLines([merged_motions(motions, ranks)], PlainSettings(setting_rows[order], values[:, order]))


def _index_of_line(lines: Ints, count: int) -> Ints:
    """Return the index in `lines` of each of the lines 1 … count (count,); −1 for lines that are not in it."""
    indices = np.full(count, -1, dtype=np.int64)
    indices[lines - 1] = np.arange(len(lines))
    return indices
