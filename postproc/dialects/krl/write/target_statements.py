"""Motion statements with other numbers: in place, and as lines of their own in the style of the line they precede.

A corrected motion under another `$ORI_TYPE` than ``#VAR`` must be led to A, B, C of its own. Under #CONSTANT the
controller keeps the orientation at the start of the motion, under #IGNORE it chooses that of the target, so that a
correction of it, or of the one before, would be ignored; under #JOINT it would turn the tool by the wrist axes. Such
motions get ``$ORI_TYPE=#VAR`` for themselves alone: spline motions by WITH, others by lines around consecutive ones.

The auxiliary point of a SCIRC keeps its A, B, C, which were meant for the whole circle as it was: once the circle is
corrected, or divided, it ignores them (``$CIRC_MODE.AUX_PT.ORI=#IGNORE``). Settings for SCIRC alone are left out where
lines replace the circle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from msgspec import Struct

from postproc.dialects.krl.language.expressions import parse_aggregate
from postproc.dialects.krl.language.motion_statements import Point
from postproc.dialects.krl.language.parser import is_approximated, statement
from postproc.dialects.krl.language.positions import CARTESIAN, COLUMNS, EXTERNAL
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import INTEGER_LITERAL, word_at
from postproc.dialects.krl.language.tree import Assignment, Motion, Tail
from postproc.dialects.krl.language.values import Aggregate
from postproc.dialects.krl.layout import FREE, Layout
from postproc.dialects.krl.write.target_numbers import MOST_DECIMALS, TargetNumbers, fixed_point
from postproc.frames import MM_PER_M
from postproc.program import CIRC, LIN, PTP, Ints, Targets

LED_BY = "$ORI_TYPE="
_FREE = f"{LED_BY}{FREE}"
_AUXILIARY_ORIENTATION = ("$CIRC_MODE", "AUX_PT.ORI")
"""Variable and component that say what A, B, C of the auxiliary point are for."""
_UNHEEDED = "$CIRC_MODE.AUX_PT.ORI=#IGNORE"
_OF_CIRCLES = frozenset({"$CIRC_TYPE", "$CIRC_MODE"})


class Replacement(NamedTuple):
    """A piece of a text to be replaced."""

    start: int
    stop: int
    text: str


class Literal(Struct, frozen=True):
    """An aggregate of numbers in a text.

    :ivar text: the file.
    :ivar places: component → span of its number.
    """

    text: str
    start: int
    stop: int
    places: Mapping[str, tuple[int, int]]


def literal_of(aggregate: Aggregate) -> Literal:
    """Return an aggregate as a literal: its text, and the spans of its numbers."""
    places = {name: (item.start, item.stop) for name, item in aggregate.items.items()}
    return Literal(aggregate.source.text, aggregate.start, aggregate.stop, places)


def replaced_numbers(literal: Literal, texts: Mapping[str, str]) -> list[Replacement]:
    """Return the edits that give a literal other numbers; components that it lacks are added in its style.

    :param texts: component → number as printed.
    """
    places = literal.places
    pieces = [Replacement(*places[name], text) for name, text in texts.items() if name in places]
    absent_names = [name for name in texts if name not in places]
    if absent_names:
        last = max(stop for name, (_, stop) in places.items() if name in CARTESIAN)
        content = literal.text[literal.start : literal.stop]
        comma = content.find(",")
        blank = " " if comma >= 0 and content[comma + 1] == " " else ""
        is_lower_case = content.rpartition(":")[2].islower()
        added_text = "".join(
            f",{blank}{name.lower() if is_lower_case else name} {texts[name]}" for name in absent_names
        )
        pieces.append(Replacement(last, last, added_text))
    return pieces


def edited_literal(literal: Literal, pieces: list[Replacement]) -> str:
    """Return the text of a literal with some pieces replaced."""
    texts, start = [], literal.start
    for piece in sorted(pieces):
        texts += [literal.text[start : piece.start], piece.text]
        start = piece.stop
    return "".join([*texts, literal.text[start : literal.stop]])


def aggregate_text(texts: Mapping[str, str]) -> str:
    """Return a new literal ``{X 1.0,…}``.

    :param texts: component → its number as printed.
    """
    return "{" + ",".join(f"{name} {text}" for name, text in texts.items()) + "}"


class TargetStatements:
    """The motion statements of one program and their targets.

    Methods take the row of a motion and the row `k` of one of its targets.
    """

    def __init__(self, layout: Layout, targets: Targets, numbers: TargetNumbers) -> None:
        """Keep the text of the program, its targets, and their numbers as printed."""
        self.layout, self.targets, self.target_numbers = layout, targets, numbers

    def literal(self, row: int) -> Literal | None:
        """Return the literal of the end point of a motion in its statement; None if it has none, but a name."""
        move = self.layout.statements.get(row)
        if move is not None:
            return None if move.relative_axes else self.inline_literal(move.end)
        spans = self.layout.spans(slice(row, row + 1))[0].tolist()
        places = {name: (start, stop) for name, (start, stop) in zip(COLUMNS, spans, strict=True) if start >= 0}
        start, stop = self.layout.target[row].tolist()
        if self.layout.carriage is not None:
            carriage = parse_aggregate(self.layout.source(row), start, stop).items.get("E1")
            places |= {} if carriage is None else {"E1": (carriage.start, carriage.stop)}
        return Literal(self.layout.source(row).text, start, stop, places)

    def inline_literal(self, operand: Point) -> Literal | None:
        """Return the literal of a point; None if its numbers are not in the statement itself."""
        aggregate = operand.position.aggregate
        return literal_of(aggregate) if aggregate is not None and operand.is_inline else None

    def via_point(self, row: int) -> tuple[tuple[int, int] | None, Literal | None]:
        """Return the text of the auxiliary point of a motion.

        :returns: its span in the statement, None if the motion has no such point; its literal, None if it has none, but
            a name.
        """
        move = self.layout.statements.get(row)
        if move is not None:
            via = move.via
            return ((via.start, via.stop), self.inline_literal(via)) if via is not None else (None, None)
        start, stop = self.layout.via_target[row].tolist()
        if start < 0:
            return None, None
        places = {
            name: (begin, end) for name, (begin, end) in zip("XYZ", self.layout.via_spans[row].tolist(), strict=True)
        }
        return (start, stop), Literal(self.layout.source(row).text, start, stop, places)

    def number_texts(self, k: int, literal: Literal, *, copy: bool = False) -> dict[str, str]:
        """Return the numbers to be written into a literal, by component.

        :param copy: True for a copy of the literal, which needs the unchanged numbers too.
        """
        is_printed = self.target_numbers.is_printed[k]
        columns = [
            column for column in range(6) if is_printed[column] or (copy and CARTESIAN[column] in literal.places)
        ]
        texts = self.target_numbers.texts(k, columns)
        if self.targets.kind[k] == PTP:
            for name, value in (("S", int(self.targets.status[k])), ("T", int(self.targets.turn[k]))):
                if value >= 0 and name in literal.places:
                    texts |= _bits_text(name, value, literal.text[slice(*literal.places[name])])
        if copy and "E1" in literal.places:
            texts |= self._carriage_text(k)
        return texts

    def _carriage_text(self, k: int, *, relative: bool = False) -> dict[str, str]:
        """Return E1 at an inserted target [mm] as text, by component; nothing if the linear axis does not move.

        :param relative: True if the motion gives E1 as a step.
        """
        carriage, row, t = self.layout.carriage, self.targets.motion[k : k + 1], float(self.targets.t[k])
        if carriage is None or (t == 1.0 and not relative) or carriage.travel[row[0]] == 0.0:
            return {}
        return {"E1": fixed_point(float(carriage.at(row, t)[0]) * MM_PER_M, 4, 4)}

    def end_texts(self, k: int, operand: Point, *, copy: bool = False) -> dict[str, str]:
        """Return the numbers to be written for the end point of a statement, by component.

        :param operand: the end point; its numbers may be in the statement, in a declaration or in no text.
        :param copy: see `number_texts`.
        """
        aggregate = operand.position.aggregate
        if aggregate is None:
            return self.target_numbers.texts(k, range(6))
        return self.number_texts(k, literal_of(aggregate), copy=copy)

    def whole_literal(self, k: int, operand: Point | None, *, relative: bool = False) -> str:
        """Return a target as a complete new literal, with external axes and, for a PTP, known S and T.

        :param operand: the end point of the statement; None if there is none.
        :param relative: True if it is relative: its external axes are steps.
        """
        texts = self.target_numbers.texts(k, range(6))
        if operand is None:
            return aggregate_text(texts)
        position = operand.position
        if relative:  # its external axes are steps; those that do not move are kept without a word
            return aggregate_text(texts | self._carriage_text(k, relative=True))
        if self.targets.kind[k] == PTP:
            for name, value, stated_bits in (
                ("S", self.targets.status, position.status),
                ("T", self.targets.turn, position.turn),
            ):
                bits = int(value[k]) if value[k] >= 0 else stated_bits
                if bits >= 0:
                    texts[name] = str(bits)
        for name, axis_position in zip(EXTERNAL, position.external, strict=False):
            if not math.isnan(axis_position):
                texts[name] = fixed_point(axis_position, MOST_DECIMALS, 0)
        return aggregate_text(texts | (self._carriage_text(k) if "E1" in texts else {}))

    def end_text(self, row: int, k: int) -> str:
        """Return the end point of a target as text: the literal of its statement with other numbers, or a new one."""
        literal = self.literal(row)
        if literal is not None:
            return edited_literal(literal, replaced_numbers(literal, self.number_texts(k, literal, copy=True)))
        move = self.layout.statements.get(row)
        return self.whole_literal(k, move.end if move else None, relative=bool(move and move.relative_axes))

    def instruction_text(self, row: int, k: int) -> str:
        """Return the instruction for a target: that of its motion without ``_REL``, or LIN for a piece of an arc."""
        word = self._instruction(row)
        word = word[: -len("_REL")] if word.upper().endswith("_REL") else word
        if self.via_point(row)[0] is not None and self.targets.kind[k] == LIN:
            line = "lin" if word.islower() else "LIN" if word.isupper() else "Lin"
            word = word[:1] + line if word[:1] in "sS" else line
        return word

    def _instruction(self, row: int) -> str:
        """Return the instruction of a motion as spelled, such as ``LIN`` or ``lin_rel``."""
        text, start = self.layout.source(row).text, self.layout.keyword.item(row)
        return text[start : start + len(word_at(text, start, len(text)))]

    def points_text(self, row: int, k: int) -> str:
        """Return the end point of a target as text, for a circle with the auxiliary point before it."""
        end, (span, via) = self.end_text(row, k), self.via_point(row)
        if span is None or self.targets.kind[k] != CIRC:
            return end
        texts = self.target_numbers.via_texts(k)
        first = edited_literal(via, replaced_numbers(via, texts)) if via is not None else aggregate_text(texts)
        return first + self.layout.source(row).text[span[1] : int(self.layout.target[row, 0])] + end

    def statement_text(self, row: int, k: int) -> str:
        """Return the instruction and the points of a target as text, all points as literals."""
        span, _ = self.via_point(row)
        first = span[0] if span is not None else int(self.layout.target[row, 0])
        gap = self.layout.source(row).text[int(self.layout.keyword[row]) + len(self._instruction(row)) : first]
        return self.instruction_text(row, k) + gap + self.points_text(row, k)

    def inserted_line(self, row: int, k: int) -> str:
        """Return the line of an inserted target, with its line end.

        It has the approximation and the WITH of the motion; where the motion stops, it has C_DIS (C_SPL, C_PTP) unless
        the target is to stop too, or the distance is not known. In a spline block it has none. No comment is repeated.
        """
        motion_text = self.statement_text(row, k)
        tail = self.tail_of_target(row, k)
        may_approximate = self.layout.is_distance_known[row] and not self.layout.is_in_spline_block[row]
        if self.targets.blend[k] > 0.0 and may_approximate and not is_approximated(tail):
            tail += " C_SPL" if motion_text[:1] in "sS" else " C_PTP" if self.targets.kind[k] == PTP else " C_DIS"
        return self.indent(row) + motion_text + tail + self.line_end(row)

    def tail_of_target(self, row: int, k: int) -> str:
        """Return the text that follows the points of a target: what its motion has there, changed where it must be."""
        is_free = bool(self.target_numbers.is_free[row]) and self.is_spline(row)
        is_circle = self.via_point(row)[0] is not None and self.is_spline(row)
        is_straightened = is_circle and bool(self.targets.kind[k] == LIN)
        ignores_auxiliary = is_circle and not is_straightened and bool(self.target_numbers.drops_via_orientation[row])
        source, line = self.layout.course.trace.place(self.layout.line.item(row))
        node = statement(source, line) if is_free or is_straightened or ignores_auxiliary else None
        if not isinstance(node, Motion):
            return source.text[slice(*self.layout.tail[row].tolist())]
        return tail_text(source, node.tail, free=is_free, straight=is_straightened, unheeding=ignores_auxiliary)

    def is_spline(self, row: int) -> bool:
        """Return whether a motion is a spline motion: SLIN, SCIRC, SPL."""
        return self.layout.source(row).text[self.layout.keyword.item(row)] in "sS"

    def indent(self, row: int) -> str:
        """Return the text before the instruction on the line of a motion."""
        source, line = self.layout.course.trace.place(self.layout.line.item(row))
        return source.text[source.starts[line - 1] : self.layout.keyword[row]]

    def line_end(self, row: int) -> str:
        """Return the line end of the line of a motion."""
        source, line = self.layout.course.trace.place(self.layout.line.item(row))
        return source.text[source.stops[line - 1] : source.starts[line]]  # it is never the last line: END follows

    def absolute_statement(self, row: int, k: int) -> Replacement:
        """Return the edit that replaces instruction and points of a statement by absolute literals."""
        return Replacement(int(self.layout.keyword[row]), int(self.layout.tail[row, 0]), self.statement_text(row, k))


def tail_text(source: Source, tail: Tail, *, free: bool, straight: bool, unheeding: bool) -> str:
    """Return the text that follows the points of a spline motion.

    :param free: True to set ``$ORI_TYPE=#VAR``.
    :param straight: True for a line in place of a circle: settings of circles are left out.
    :param unheeding: True to ignore A, B, C of the auxiliary point.
    """
    text = source.text
    assignments = [assignment for assignment in tail.assignments if isinstance(assignment, Assignment)]
    begin = text[tail.start : assignments[0].start] if assignments else " WITH "
    settings: list[str] = []  # all but the first with the separator before them
    last = tail.start
    for assignment in assignments:
        separator, last = text[last : assignment.start], assignment.stop
        name, field = assignment.target.name, assignment.target.field
        if straight and name in _OF_CIRCLES:
            continue
        value = text[assignment.value.start : assignment.stop]
        if free and name == "$ORI_TYPE":
            value = FREE
        elif unheeding and (name, field) == _AUXILIARY_ORIENTATION:
            value = "#IGNORE"
        setting = text[assignment.start : assignment.value.start] + value
        settings.append(separator + setting if settings else setting)
    names = {(assignment.target.name, assignment.target.field) for assignment in assignments}
    if free and ("$ORI_TYPE", None) not in names:
        blanks = begin[len(begin.rstrip()) :]  # as between WITH and its first setting
        settings[:1] = [_FREE, *(f",{blanks}{setting}" for setting in settings[:1])]
    if unheeding and _AUXILIARY_ORIENTATION not in names:
        settings.append(f", {_UNHEEDED}" if settings else _UNHEEDED)
    return "".join([begin, *settings] if settings else []) + text[tail.with_stop : tail.stop]


def _bits_text(name: str, value: int, text: str) -> dict[str, str]:
    """Return S or T in the notation of the input, by component; nothing if the text gives that value already."""
    match = INTEGER_LITERAL.fullmatch(text)
    if match and match["binary"]:
        return {} if int(match["binary"], 2) == value else {name: f"'B{value:0{len(match['binary'])}b}'"}
    return {} if text == str(value) else {name: str(value)}


def consecutive_motions(layout: Layout, rows: Ints) -> list[tuple[int, int]]:
    """Return the first and the last motion of each run of motions between which there are only comments.

    :param rows: (n,) the motions, in order.
    """
    run_bounds: list[tuple[int, int]] = []
    for row in rows.tolist():
        if run_bounds and run_bounds[-1][1] == row - 1 and _is_next_line(layout, row):
            run_bounds[-1] = run_bounds[-1][0], row
        else:
            run_bounds.append((row, row))
    return run_bounds


def _is_next_line(layout: Layout, row: int) -> bool:
    """Return whether only comments are between a motion and the one before it, in the same round and routine."""
    trace, previous_row, motion_row = layout.course.trace, int(layout.line[row - 1]), int(layout.line[row])
    (source, first), (second_source, last) = trace.place(previous_row), trace.place(motion_row)
    if source is not second_source or last - first != motion_row - previous_row:
        return False
    return all(start == stop for start, stop in map(source.code_span, range(first + 1, last)))
