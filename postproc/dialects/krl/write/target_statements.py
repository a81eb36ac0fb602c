"""Texts of motion statements with corrected numbers: edited in place, or as inserted lines in the style of the motion.

A corrected motion under another `$ORI_TYPE` than ``#VAR`` would not reach its A, B, C. #CONSTANT: the controller keeps
the orientation at the start of the motion. #IGNORE: the controller chooses the orientation at the target. #JOINT: the
wrist axes turn the tool. Such motions get ``$ORI_TYPE=#VAR``: spline motions by WITH, other motions by a line before
and a line behind consecutive motions.

The auxiliary point of a SCIRC keeps A, B, C of the text, which belong to the unchanged circle. If the circle is
corrected or divided, ``$CIRC_MODE.AUX_PT.ORI=#IGNORE`` makes the controller ignore them. Settings for SCIRC are left
out where lines replace the circle.
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
from postproc.dialects.krl.language.tokens import INTEGER_LITERAL, literal_value, literal_with_value, word_at
from postproc.dialects.krl.language.tree import Assignment, Motion, Tail
from postproc.dialects.krl.language.values import Aggregate
from postproc.dialects.krl.layout import FREE, Layout
from postproc.dialects.krl.write.target_numbers import MOST_DECIMALS, TargetNumbers, fixed_point
from postproc.frames import MM_PER_M
from postproc.program import CIRC, LIN, PTP, Ints, Targets

ORIENTATION_SETTING = "$ORI_TYPE="
_FREE_ORIENTATION = f"{ORIENTATION_SETTING}{FREE}"
_AUXILIARY_ORIENTATION = ("$CIRC_MODE", "AUX_PT.ORI")
"""Variable and component that decide how the controller uses A, B, C of the auxiliary point."""
_IGNORED_AUXILIARY = "$CIRC_MODE.AUX_PT.ORI=#IGNORE"
_CIRCLE_VARIABLES = frozenset({"$CIRC_TYPE", "$CIRC_MODE"})


class Replacement(NamedTuple):
    """A piece of a text to be replaced."""

    start: int
    stop: int
    text: str


class Literal(Struct, frozen=True):
    """An aggregate of numbers in a text.

    :ivar text: text of the file.
    :ivar start: offset of ``{``.
    :ivar stop: offset behind ``}``.
    :ivar number_spans: component → span of its number.
    """

    text: str
    start: int
    stop: int
    number_spans: Mapping[str, tuple[int, int]]


def literal_of(aggregate: Aggregate) -> Literal:
    """Return an aggregate as a literal: its text, and the spans of its numbers."""
    number_spans = {name: (item.start, item.stop) for name, item in aggregate.items.items()}
    return Literal(aggregate.source.text, aggregate.start, aggregate.stop, number_spans)


def replaced_numbers(literal: Literal, texts: Mapping[str, str]) -> list[Replacement]:
    """Return the edits that give a literal new numbers.

    Missing components are added behind its last Cartesian component, with its spacing and its case; in front if it has
    none, as ``{E1 25}``.

    :param texts: component → number as printed.
    """
    number_spans = literal.number_spans
    pieces = [Replacement(*number_spans[name], text) for name, text in texts.items() if name in number_spans]
    absent_names = [name for name in texts if name not in number_spans]
    if absent_names:
        last = max((stop for name, (_, stop) in number_spans.items() if name in CARTESIAN), default=None)
        content = literal.text[literal.start : literal.stop]
        comma = content.find(",")
        blank = " " if comma >= 0 and content[comma + 1] == " " else ""
        is_lower_case = content.rpartition(":")[2].islower()  # without the type before the colon
        added = [f"{name.lower() if is_lower_case else name} {texts[name]}" for name in absent_names]
        if last is None:
            first = literal.start + max(content.find("{"), content.find(":")) + 1  # behind the type, if there is one
            pieces.append(Replacement(first, first, "".join(f"{text},{blank}" for text in added)))
        else:
            pieces.append(Replacement(last, last, "".join(f",{blank}{text}" for text in added)))
    return pieces


def edited_literal(literal: Literal, pieces: list[Replacement]) -> str:
    """Return the text of a literal with pieces replaced; offsets of pieces count in the file."""
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

    In all methods, `motion` is the row of a motion, and `target` the row of one of its targets: the last, which is in
    the statement of the motion, or an inserted one.
    """

    def __init__(self, layout: Layout, targets: Targets, numbers: TargetNumbers) -> None:
        """Keep the layout of the program, its targets, and their numbers as printed."""
        self.layout, self.targets, self.target_numbers = layout, targets, numbers

    def literal(self, motion: int) -> Literal | None:
        """Return the literal of the end point of a motion: its numbers in the statement, such as ``{X 1,Y 2}``.

        None for relative motions, and if the statement has a name or a chain as its end point.
        """
        move = self.layout.statements.get(motion)
        if move is not None:
            return None if move.relative_axes else self.inline_literal(move.end)
        spans = self.layout.spans(slice(motion, motion + 1))[0].tolist()
        number_spans = {name: (start, stop) for name, (start, stop) in zip(COLUMNS, spans, strict=True) if start >= 0}
        start, stop = self.layout.target[motion].tolist()
        if self.layout.carriage is not None:
            carriage = parse_aggregate(self.layout.source(motion), start, stop).items.get("E1")
            number_spans |= {} if carriage is None else {"E1": (carriage.start, carriage.stop)}
        return Literal(self.layout.source(motion).text, start, stop, number_spans)

    def inline_literal(self, operand: Point) -> Literal | None:
        """Return the literal of a point; None if its numbers are not in its statement."""
        aggregate = operand.position.aggregate
        return literal_of(aggregate) if aggregate is not None and operand.is_inline else None

    def via_point(self, motion: int) -> tuple[tuple[int, int] | None, Literal | None]:
        """Return the text of the auxiliary point of a motion.

        :returns: span of the point in the statement, None if the motion has no auxiliary point; literal of the point,
            None if the statement has a name or a chain.
        """
        move = self.layout.statements.get(motion)
        if move is not None:
            via = move.via
            return ((via.start, via.stop), self.inline_literal(via)) if via is not None else (None, None)
        start, stop = self.layout.via_target[motion].tolist()
        if start < 0:
            return None, None
        number_spans = {
            name: (begin, end) for name, (begin, end) in zip("XYZ", self.layout.via_spans[motion].tolist(), strict=True)
        }
        return (start, stop), Literal(self.layout.source(motion).text, start, stop, number_spans)

    def number_texts(self, target: int, literal: Literal, *, includes_unchanged: bool = False) -> dict[str, str]:
        """Return the numbers of a target that a literal, such as ``{X 1,Y 2}``, must get: component → text.

        :param includes_unchanged: False: for the literal of the motion itself, which needs the changed numbers. True:
            for a copy of the literal in another line, which needs all numbers.
        """
        is_printed = self.target_numbers.is_printed[target]
        columns = [
            column
            for column in range(6)
            if is_printed[column] or (includes_unchanged and CARTESIAN[column] in literal.number_spans)
        ]
        texts = self.target_numbers.texts(target, columns)
        if self.targets.kind[target] == PTP:
            for name, bits in (("S", int(self.targets.status[target])), ("T", int(self.targets.turn[target]))):
                if bits >= 0 and name in literal.number_spans:  # −1: not known
                    texts |= _bits_text(name, bits, literal.text[slice(*literal.number_spans[name])])
        if includes_unchanged and "E1" in literal.number_spans:
            texts |= self._carriage_text(target)
        return texts

    def _carriage_text(self, target: int, *, relative: bool = False) -> dict[str, str]:
        """Return E1, the position of the linear axis at a target [mm]: ``"E1"`` → text; empty if no new E1 is needed.

        It needs none without a linear axis, if this axis does not move, and at the last target of an absolute motion.

        :param relative: True if the motion is relative: E1 in its text is a step.
        """
        carriage, t = self.layout.carriage, float(self.targets.t[target])  # t: share of the motion
        motions = self.targets.motion[target : target + 1]  # an array with the motion of the target
        if carriage is None or (t == 1.0 and not relative) or carriage.travel[motions[0]] == 0.0:
            return {}
        position = float(carriage.at(motions, t)[0]) * MM_PER_M
        return {"E1": fixed_point(position, decimals=4, min_decimals=4)}

    def end_texts(self, target: int, operand: Point, *, includes_unchanged: bool = False) -> dict[str, str]:
        """Return the numbers to be written for the end point of a statement: component → text.

        All six numbers are returned if the point is computed, so that no text has its numbers.

        :param operand: the end point; its numbers may be in the statement or in a declaration.
        :param includes_unchanged: see `number_texts`.
        """
        aggregate = operand.position.aggregate
        if aggregate is None:
            return self.target_numbers.texts(target, range(6))
        return self.number_texts(target, literal_of(aggregate), includes_unchanged=includes_unchanged)

    def whole_literal(self, target: int, operand: Point | None, *, relative: bool = False) -> str:
        """Return a target as a new literal with all components, external axes and, for PTP, known S and T.

        :param operand: end point of the statement; None: only X, Y, Z, A, B, C are written.
        :param relative: True if the statement is relative: its external axes are steps, of which only E1 is written.
        """
        texts = self.target_numbers.texts(target, range(6))
        if operand is None:
            return aggregate_text(texts)
        position = operand.position
        if relative:  # the stated external axes are steps; the controller keeps external axes that are left out
            return aggregate_text(texts | self._carriage_text(target, relative=True))
        if self.targets.kind[target] == PTP:
            for name, target_bits, stated_bits in (
                ("S", self.targets.status, position.status),
                ("T", self.targets.turn, position.turn),
            ):
                bits = int(target_bits[target]) if target_bits[target] >= 0 else stated_bits
                if bits >= 0:  # −1: not known
                    texts[name] = str(bits)
        for name, axis_position in zip(EXTERNAL, position.external, strict=False):
            if not math.isnan(axis_position):
                texts[name] = fixed_point(axis_position, MOST_DECIMALS, 0)
        return aggregate_text(texts | (self._carriage_text(target) if "E1" in texts else {}))

    def end_text(self, motion: int, target: int) -> str:
        """Return the end point of a target as a literal.

        If the statement of its motion has a literal, a copy of it with the numbers of the target; else a new literal.
        """
        literal = self.literal(motion)
        if literal is not None:
            return edited_literal(
                literal, replaced_numbers(literal, self.number_texts(target, literal, includes_unchanged=True))
            )
        move = self.layout.statements.get(motion)
        return self.whole_literal(target, move.end if move else None, relative=bool(move and move.relative_axes))

    def instruction_text(self, motion: int, target: int) -> str:
        """Return the instruction for a target: that of the motion, without ``_REL``.

        If a line replaces an arc, it is LIN, or SLIN for SCIRC, in the case of the motion's instruction.
        """
        word = self._instruction(motion)
        word = word[: -len("_REL")] if word.upper().endswith("_REL") else word
        via_span, _ = self.via_point(motion)
        if via_span is not None and self.targets.kind[target] == LIN:
            line = "lin" if word.islower() else "LIN" if word.isupper() else "Lin"
            word = word[:1] + line if word[:1] in "sS" else line
        return word

    def _instruction(self, motion: int) -> str:
        """Return the instruction of a motion as spelled, such as ``LIN`` or ``lin_rel``."""
        text, start = self.layout.source(motion).text, self.layout.keyword.item(motion)
        return text[start : start + len(word_at(text, start, len(text)))]

    def points_text(self, motion: int, target: int) -> str:
        """Return the points of a target as literals: the end point, for a circle the auxiliary point before it."""
        end, (span, via) = self.end_text(motion, target), self.via_point(motion)
        if span is None or self.targets.kind[target] != CIRC:
            return end
        texts = self.target_numbers.via_texts(target)
        via_text = edited_literal(via, replaced_numbers(via, texts)) if via is not None else aggregate_text(texts)
        # between the points: the separator of the motion
        return via_text + self.layout.source(motion).text[span[1] : int(self.layout.target[motion, 0])] + end

    def statement_text(self, motion: int, target: int) -> str:
        """Return the instruction and the points of a target as text, all points as literals."""
        via_span, _ = self.via_point(motion)
        points_start = via_span[0] if via_span is not None else int(self.layout.target[motion, 0])
        instruction_stop = int(self.layout.keyword[motion]) + len(self._instruction(motion))
        blanks = self.layout.source(motion).text[instruction_stop:points_start]
        return self.instruction_text(motion, target) + blanks + self.points_text(motion, target)

    def inserted_line(self, motion: int, target: int) -> str:
        """Return the line of an inserted target, with its line end.

        It repeats approximation and WITH of the motion, but no comment. If the motion stops exactly, the line gets
        C_DIS (spline: C_SPL, PTP: C_PTP). It gets none in a spline block, if the distance is not known, and if the
        robot is to stop at the target.
        """
        motion_text = self.statement_text(motion, target)
        tail = self.tail_of_target(motion, target)
        may_approximate = self.layout.is_distance_known[motion] and not self.layout.is_in_spline_block[motion]
        if self.targets.blend[target] > 0.0 and may_approximate and not is_approximated(tail):
            tail += " C_SPL" if motion_text[:1] in "sS" else " C_PTP" if self.targets.kind[target] == PTP else " C_DIS"
        return self.indent(motion) + motion_text + tail + self.line_end(motion)

    def tail_of_target(self, motion: int, target: int) -> str:
        """Return WITH and approximation of a target: those of its motion, for spline motions changed by `tail_text`."""
        is_free = bool(self.target_numbers.is_free[motion]) and self.is_spline(motion)
        via_span, _ = self.via_point(motion)
        is_circle = via_span is not None and self.is_spline(motion)
        is_straightened = is_circle and bool(self.targets.kind[target] == LIN)
        ignores_auxiliary = (
            is_circle and not is_straightened and bool(self.target_numbers.drops_via_orientation[motion])
        )
        source, line = self.layout.execution.trace.place(self.layout.trace_row.item(motion))
        node = statement(source, line) if is_free or is_straightened or ignores_auxiliary else None
        if not isinstance(node, Motion):
            return source.text[slice(*self.layout.tail[motion].tolist())]
        return tail_text(
            source,
            node.tail,
            is_free=is_free,
            is_straightened=is_straightened,
            ignores_auxiliary=ignores_auxiliary,
        )

    def is_spline(self, motion: int) -> bool:
        """Return whether a motion is a spline motion: SLIN, SCIRC, SPL."""
        return self.layout.source(motion).text[self.layout.keyword.item(motion)] in "sS"

    def indent(self, motion: int) -> str:
        """Return the text before the instruction on the line of a motion."""
        source, line = self.layout.execution.trace.place(self.layout.trace_row.item(motion))
        return source.text[source.starts[line - 1] : self.layout.keyword[motion]]

    def line_end(self, motion: int) -> str:
        """Return the line end of the line of a motion."""
        source, line = self.layout.execution.trace.place(self.layout.trace_row.item(motion))
        return source.text[source.stops[line - 1] : source.starts[line]]  # a line always follows: END at least

    def absolute_statement(self, motion: int, target: int) -> Replacement:
        """Return the edit that replaces instruction and points of a motion by absolute literals of a target."""
        return Replacement(
            int(self.layout.keyword[motion]), int(self.layout.tail[motion, 0]), self.statement_text(motion, target)
        )


def tail_text(source: Source, tail: Tail, *, is_free: bool, is_straightened: bool, ignores_auxiliary: bool) -> str:
    """Return WITH and approximation (``WITH $ORI_TYPE=#VAR C_SPL``) of a spline motion, with changed settings.

    :param tail: WITH and approximation in the text of the file.
    :param is_free: True to set ``$ORI_TYPE=#VAR``.
    :param is_straightened: True for a line in place of a circle: settings of circles are left out.
    :param ignores_auxiliary: True to ignore A, B, C of the auxiliary point.
    """
    text = source.text
    assignments = [assignment for assignment in tail.assignments if isinstance(assignment, Assignment)]
    begin = text[tail.start : assignments[0].start] if assignments else " WITH "  # text before the first setting
    settings: list[str] = []  # each, except the first, with the separator before it
    last = tail.start  # offset behind the last assignment
    for assignment in assignments:
        separator, last = text[last : assignment.start], assignment.stop
        name, field = assignment.target.name, assignment.target.field
        if is_straightened and name in _CIRCLE_VARIABLES:
            continue
        value = text[assignment.value.start : assignment.stop]
        if is_free and name == "$ORI_TYPE":
            value = FREE
        elif ignores_auxiliary and (name, field) == _AUXILIARY_ORIENTATION:
            value = "#IGNORE"
        setting = text[assignment.start : assignment.value.start] + value
        settings.append(separator + setting if settings else setting)
    names = {(assignment.target.name, assignment.target.field) for assignment in assignments}
    if is_free and ("$ORI_TYPE", None) not in names:
        blanks = begin[len(begin.rstrip()) :]  # between WITH and its first setting
        settings[:1] = [_FREE_ORIENTATION, *(f",{blanks}{setting}" for setting in settings[:1])]
    if ignores_auxiliary and _AUXILIARY_ORIENTATION not in names:
        settings.append(f", {_IGNORED_AUXILIARY}" if settings else _IGNORED_AUXILIARY)
    return "".join([begin, *settings] if settings else []) + text[tail.with_stop : tail.stop]


def _bits_text(name: str, value: int, text: str) -> dict[str, str]:
    """Return S or T in the notation of the input: component → text; empty if the input has this value already.

    :param name: ``S`` or ``T``.
    :param value: its new value.
    :param text: its text in the input: decimal, binary such as ``'B010'``, or hexadecimal such as ``'H2'``.
    """
    if literal := INTEGER_LITERAL.fullmatch(text):
        return {} if literal_value(literal) == value else {name: literal_with_value(literal, value)}
    return {} if text == str(value) else {name: str(value)}


def consecutive_motions(layout: Layout, rows: Ints) -> list[tuple[int, int]]:
    """Return the first and the last motion of each run of consecutive motions with only comments between them.

    :param rows: (n,) the motions, ascending.
    """
    run_bounds: list[tuple[int, int]] = []
    for motion in rows.tolist():
        if run_bounds and run_bounds[-1][1] == motion - 1 and _is_next_line(layout, motion):
            run_bounds[-1] = run_bounds[-1][0], motion
        else:
            run_bounds.append((motion, motion))
    return run_bounds


def _is_next_line(layout: Layout, motion: int) -> bool:
    """Return whether only comments are between a motion and the motion before it, in the trace and in the file."""
    trace = layout.execution.trace
    previous_row, motion_row = layout.trace_row[motion - 1 : motion + 1].tolist()
    (source, first), (second_source, last) = trace.place(previous_row), trace.place(motion_row)
    if source is not second_source or last - first != motion_row - previous_row:
        return False
    return all(start == stop for start, stop in map(source.code_span, range(first + 1, last)))
