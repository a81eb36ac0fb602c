"""Loops over the points of an array: ``LIN P[I+1] C_DIS`` in FOR, a hundred thousand rounds taken as columns.

The body moves, sets speeds and distances of approximation, and switches outputs, by TRIGGER too. Each point is an
element of a data list that is written there as one literal; each speed a number or an element of an array.
Other loops are followed round by round (`main_routine`), and so could these be.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.dialects.krl.execution import PlainBody, PlainRounds
from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.names import CIRCLES, MAX_LENGTH
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.positions import LARGEST_COORDINATE
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.structures import Block, bounds_use_any, simple_head
from postproc.dialects.krl.language.tree import Assignment, For, Motion, Statement, Trigger
from postproc.dialects.krl.language.values import Number, Operation, Reference, Value
from postproc.dialects.krl.layout import Offsets
from postproc.dialects.krl.read import plain_lines, plain_settings
from postproc.dialects.krl.read.motion_columns import MotionColumns, merged_motions
from postproc.dialects.krl.read.motion_reader import KINDS, MotionReader, has_plain_tail, may_be_point_name
from postproc.dialects.krl.read.path_settings import FASTEST
from postproc.dialects.krl.read.plain_settings import NUMBERS, PlainSettings
from postproc.dialects.krl.read.run import Run
from postproc.dialects.krl.read.state import FIELD_OF_SETTING
from postproc.frames import M_PER_MM
from postproc.program import Ints

_LARGEST_OFFSET = 1_000_000
"""Largest k in ``P[I+k]``: sums of INTs stay far from their limits."""
_SETTING_COMPONENTS = {"$VEL": "CP", "$APO": "CDIS"}
"""Settings whose numbers may differ from round to round → the component with that number."""
_OUTPUTS = frozenset({"$OUT", "$ANOUT"})
_MOTION_PREFIX = "LIN "
"""Text put before each point, so that it is read as the line of a motion."""


def plain_body(source: Source, block: Block) -> PlainBody | None:
    """Return the lines of a FOR that only moves to array elements, sets speeds and distances, and switches outputs.

    Elements have an index such as ``I`` or ``I+1``; speeds and approximation distances may be such elements too.
    Assignments of literals, such as ``$VEL.CP=0.1``, are allowed and not returned: they are the same in each round.

    :returns: None if the loop does anything else, or has no motion.
    """
    head = simple_head(source, block)
    # no FOR with a simple variable as counter, or its bounds use the counter
    if head is None or bounds_use_any(head, {head.name}):
        return None
    motions, settings, triggers = [], [], []
    for node in block.parts[0].nodes:
        if isinstance(node, Block):
            return None
        line, stmt = node, statement(source, node)
        if _is_motion_to_element(stmt, head.name):
            motions.append(line)
        elif _sets_from_array(stmt, head.name):
            settings.append(line)
        elif _is_switching_trigger(stmt):
            triggers.append(line)
        elif not plain_settings.is_plain(source, line):
            return None
    return PlainBody(motions=(*motions,), settings=(*settings,), triggers=(*triggers,)) if motions else None


def _sets_from_array(stmt: Statement, counter: str) -> bool:
    """Return whether a statement sets a speed or an approximation distance to an array element: ``$VEL.CP=V[I]``.

    :param counter: name of the counter I, upper case.
    """
    if not isinstance(stmt, Assignment) or not isinstance(stmt.value, Reference):
        return False
    target, value = stmt.target, stmt.value
    is_set = (
        target.indices is None and target.field is not None and _SETTING_COMPONENTS.get(target.name) == target.field
    )
    is_element = value.name[0] != "$" and value.field is None and len(value.name) <= MAX_LENGTH
    return is_set and is_element and _counter_offset(value, counter) is not None


def _is_switching_trigger(stmt: Statement) -> bool:
    """Return whether a statement is a TRIGGER that switches an output, and whose distance and delay are numbers.

    No function may be called in it.
    """
    if not isinstance(stmt, Trigger) or not isinstance(stmt.action, Assignment) or calls(stmt.values):
        return False
    has_numbers = isinstance(stmt.value, Number) and isinstance(stmt.delay, Number)
    return has_numbers and stmt.action.target.name in _OUTPUTS


def _is_motion_to_element(stmt: Statement, counter: str) -> bool:
    """Return whether a statement is a motion to an array element, as ``LIN P[I+1] C_DIS`` is, without WITH.

    Circles and SPL do not count.

    :param counter: name of the counter I, upper case.
    """
    if not isinstance(stmt, Motion) or stmt.word not in KINDS or stmt.word in (*CIRCLES, "SPL"):
        return False
    if stmt.angle is not None or stmt.frame or not has_plain_tail(stmt):
        return False
    end = stmt.end
    if not isinstance(end, Reference) or end.field is not None or not may_be_point_name(end.name):
        return False
    return _counter_offset(end, counter) is not None


def _counter_offset(point: Reference, counter: str) -> int | None:
    """Return k for ``P[I+k]``, −k for ``P[I-k]``, 0 for ``P[I]``; None for any other index.

    :param counter: name of the counter I, upper case.
    """
    index: Value | None = point.indices[0] if point.indices and len(point.indices) == 1 else None
    offset = 0
    if isinstance(index, Operation) and index.operator in "+-" and isinstance(index.right, Number):
        number = index.right
        if not number.is_integer or not 0 <= number.value <= _LARGEST_OFFSET:
            return None
        offset, index = int(number.value) if index.operator == "+" else -int(number.value), index.left
    is_counter = (
        isinstance(index, Reference) and index.name == counter and index.indices is None and index.field is None
    )
    return offset if is_counter else None


class ElementMotions(Struct, frozen=True, eq=False):
    """The motions that one statement of a plain body makes, one each round.

    :param columns: the N motions.
    :param source: the data list that declares the points.
    :param literal: (N, 2) spans of the points in the data list.
    :param name: name of the array, upper case.
    """

    columns: MotionColumns
    source: Source
    literal: Ints
    name: str


def motions_and_settings_of(
    run: Run, reader: MotionReader, rounds: PlainRounds
) -> tuple[list[ElementMotions], PlainSettings] | None:
    """Return the motions that the statements of plain rounds make, and the settings of the rounds.

    :param run: the program as far as it has run, before the first round; the variables that the motions depend on are
        noted in it.
    :returns: the motions of each statement, and the settings; None if the rounds must be followed one by one.
    """
    if not run.may_take_rounds_at_once:
        return None
    motions = []
    for line in rounds.body.motions:
        stmt = statement(rounds.source, line)
        element_motions = _element_motions(run, reader, rounds, line, stmt) if isinstance(stmt, Motion) else None
        if element_motions is None:
            return None
        motions.append(element_motions)
    settings = _settings_of_rounds(run, rounds)
    if settings is None:
        return None
    for line in rounds.body.motions + rounds.body.settings:
        for value in statement(rounds.source, line).values:
            run.variables.note_dependence(value)
    return motions, settings


def _settings_of_rounds(run: Run, rounds: PlainRounds) -> PlainSettings | None:
    """Return the speeds and approximation distances that rounds set, in execution order.

    :returns: None if a number is not known, or not allowed.
    """
    head, setting_rows, values = statement(rounds.source, rounds.head), [], []
    for line in rounds.body.settings:
        stmt = statement(rounds.source, line)
        if not isinstance(stmt, Assignment) or not isinstance(stmt.value, Reference) or not isinstance(head, For):
            return None
        indices = rounds.indices(_counter_offset(stmt.value, head.name) or 0)  # `plain_body` allows no other index
        numbers = run.variables.numbers(run.stored_name(stmt.value.name), indices)
        if numbers is None:
            return None
        field = FIELD_OF_SETTING[stmt.target.name]
        is_allowed = (numbers > 0.0) & (numbers <= FASTEST) if field == "speed" else numbers >= 0.0
        if not is_allowed.all():
            return None
        columns = np.full((len(NUMBERS), len(numbers)), np.nan)
        columns[NUMBERS.index(field)] = numbers if field == "speed" else numbers * M_PER_MM
        setting_rows.append(rounds.rows_of_statement(line))
        values.append(columns)
    if not setting_rows:
        return plain_settings.no_settings()
    rows = np.concatenate(setting_rows)
    order = np.argsort(rows)
    return PlainSettings(rows[order], np.concatenate(values, axis=1)[:, order])


def _element_motions(
    run: Run, reader: MotionReader, rounds: PlainRounds, motion_line: int, motion: Motion
) -> ElementMotions | None:
    """Return the motions of one statement, one for each round.

    :param motion_line: line of the statement in its file.
    :param motion: the statement.
    :returns: None if the points are not all literals of one data list, or a coordinate is out of reach.
    """
    head = statement(rounds.source, rounds.head)
    if not isinstance(motion.end, Reference) or not isinstance(head, For):
        return None
    if motion.end.name in run.variables.scope.array_names:  # a parameter: the array has another name
        return None
    indices = rounds.indices(_counter_offset(motion.end, head.name) or 0)  # `plain_body` allows no other index
    literals = run.variables.data_spans(run.stored_name(motion.end.name), indices)
    points = None if literals is None else _scanned_points(*literals)
    if points is None or (np.abs(points.columns.numbers) > LARGEST_COORDINATE).any():
        return None
    kind = KINDS[motion.word]
    _, is_approximated = reader.tail_settings(Place(rounds.source, motion_line), kind, motion.tail)

    def repeated_offsets(*offsets: int) -> Offsets:
        """Return n offsets that are equal in all rounds as an array (rounds, n)."""
        return np.tile(np.array(offsets, dtype=np.int32), (rounds.count, 1))

    columns = replace(
        points.columns,
        trace_row=rounds.rows_of_statement(motion_line),
        kind=np.full(rounds.count, kind),
        keyword=repeated_offsets(motion.start)[:, 0],
        target=repeated_offsets(motion.end.start, motion.end.stop),
        tail=repeated_offsets(motion.tail.start, motion.tail.stop),
        approximated=np.full(rounds.count, is_approximated),
    )
    return replace(points, columns=columns, name=motion.end.name)


def _scanned_points(source: Source, spans: Sequence[tuple[int, int]]) -> ElementMotions | None:
    """Return points of a data list as if each were the target of a LIN; None if a point is no plain literal.

    :param source: the data list.
    :param spans: spans of the points in it.
    :returns: motions whose `name` is empty: the caller sets it to the name of the array.
    """
    texts = [f"{_MOTION_PREFIX}{source.text[start:stop]}\n" for start, stop in spans]
    text = "".join(texts)
    ends = np.cumsum([len(line) for line in texts])
    starts = np.append(0, ends[:-1])
    lines = Source(replace(source.document, text=text), text, source.index, starts, stops=ends - 1)  # without "\n"
    parts = plain_lines.scan(lines)
    columns = merged_motions(parts, np.arange(sum(map(len, parts))))
    if len(columns) != len(spans):  # not all lines are plain
        return None
    # from offsets in the text of these lines to offsets in the file
    shift = np.array([start for start, _ in spans]) - starts - len(_MOTION_PREFIX)
    return ElementMotions(columns, source, literal=columns.target + shift[:, None], name="")
