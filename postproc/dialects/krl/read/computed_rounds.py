"""Loops whose points are computed from the counter: ``LIN {X 90*COS(I),…}``, ``XT=P[I+1]`` and ``LIN XT``.

The rounds of a loop are its iterations. The expressions are evaluated for all rounds at once, each as a column with one
number a round. This holds where no round depends on one before: variables are set before they are used, and all else
has one value throughout. Numbers are those that `Variables` gives one by one, since the operations are the same. Where
a column would hold anything else than numbers, or whole positions, the rounds are followed one by one (`main_routine`),
which always gives the same motions.
"""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from postproc.dialects.krl.execution import PlainBody, PlainRounds
from postproc.dialects.krl.language.motion_statements import MotionStatement, Point
from postproc.dialects.krl.language.names import CIRCLES
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.positions import CARTESIAN, LARGEST_COORDINATE, Position, position_from_aggregate
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.structures import Block, bounds_use_any, simple_head
from postproc.dialects.krl.language.tree import Assignment, For, Motion
from postproc.dialects.krl.language.values import Aggregate, Call, Number, Operation, Reference, Value
from postproc.dialects.krl.read import plain_settings
from postproc.dialects.krl.read.motion_reader import KINDS, MotionReader, has_plain_tail, may_be_point_name
from postproc.dialects.krl.read.run import Run
from postproc.dialects.krl.read.state import MOTION_SETTINGS
from postproc.dialects.krl.read.variables import FUNCTIONS, convert_to_type, operation_result, variable_of
from postproc.errors import ProgramError

FEWEST_ROUNDS = 64
"""Rounds from which on columns are worth a second run of the program."""
_TAGS = ("", "E6POS", "E3POS", "POS", "FRAME")
"""Types of Cartesian positions that may precede an aggregate; empty: none does."""
_OUTPUTS = ("$OUT", "$ANOUT")
_OPERATORS = "+-*/"


def computed_body(source: Source, block: Block) -> PlainBody | None:
    """Return the lines of a FOR that computes points from its counter and moves to them; it may also switch outputs.

    :returns: None if the FOR does anything else, changes its own bounds, or has no motion.
    """
    head, nodes = simple_head(source, block), block.parts[0].nodes
    lines = [node for node in nodes if isinstance(node, int)]
    if head is None or len(lines) < len(nodes):  # other nodes are control structures
        return None
    assigned_names = {
        stmt.target.name for stmt in (statement(source, line) for line in lines) if isinstance(stmt, Assignment)
    }
    if bounds_use_any(head, {*assigned_names, head.name}):  # the bounds may change
        return None
    # names that the round has set up to the present line, and names that it sets later
    motions, assignments, set_names = [], [], set[str]()
    unset_names = {name for name in assigned_names if name[0] != "$"}
    for line in lines:
        stmt = statement(source, line)
        if isinstance(stmt, Assignment) and stmt.target.name[0] == "$":
            if stmt.target.name not in _OUTPUTS or not plain_settings.is_plain(source, line):
                return None
        elif (
            isinstance(stmt, Assignment)
            and _sets_whole_variable(stmt, head.name)
            and _is_computable(stmt.value, unset_names)
        ):
            assignments.append(line)
            set_names.add(stmt.target.name)
            unset_names.discard(stmt.target.name)
        elif isinstance(stmt, Motion) and _leads_to_computed_point(stmt, set_names, unset_names):
            motions.append(line)
        else:
            return None
    if not motions:
        return None
    return PlainBody(motions=(*motions,), settings=(), triggers=(), assignments=(*assignments,), is_computed=True)


def _sets_whole_variable(stmt: Assignment, counter: str) -> bool:
    """Return whether an assignment sets a whole variable, other than the counter and the settings of motions.

    :param counter: name of the counter, upper case.
    """
    target = stmt.target
    return target.indices is None and target.field is None and target.name not in (counter, *MOTION_SETTINGS)


def _is_computable(value: Value, unset_names: set[str]) -> bool:
    """Return whether a value is made of numbers, variables and array elements by arithmetic and by `FUNCTIONS`.

    :param unset_names: variables that the round sets only later: their values are those of the round before, so that a
        value with one of them counts as not computable.
    """
    if isinstance(value, Number):
        return True
    if isinstance(value, Reference):
        is_plain = value.field is None and value.name[0] != "$" and value.name not in unset_names and not value.inner
        indices = value.indices
        return is_plain and (indices is None or (len(indices) == 1 and _is_computable(indices[0], unset_names)))
    if isinstance(value, Operation):
        sides = (value.right,) if value.left is None else (value.left, value.right)
        return value.operator in _OPERATORS and all(_is_computable(side, unset_names) for side in sides)
    if isinstance(value, Call):
        is_function = value.name in FUNCTIONS and len(value.arguments) == (2 if value.name == "ATAN2" else 1)
        return is_function and all(_is_computable(argument, unset_names) for argument in value.arguments)
    return False


def _leads_to_computed_point(stmt: Motion, set_names: set[str], unset_names: set[str]) -> bool:
    """Return whether a motion leads to a variable that the round has set, or to an aggregate of computed numbers.

    Circles, SPL, axis targets and motions with WITH do not count; nor do aggregates of constant numbers alone.

    :param set_names: variables that the round has set before the motion; `unset_names` those that it sets later.
    """
    if stmt.word not in KINDS or stmt.word in (*CIRCLES, "SPL") or stmt.angle is not None or stmt.frame:
        return False
    if not has_plain_tail(stmt):
        return False
    end = stmt.end
    if isinstance(end, Reference):
        is_whole = end.indices is None and end.field is None and not end.is_bracketed
        return is_whole and end.name in set_names and may_be_point_name(end.name)
    if not isinstance(end, Aggregate) or end.tag not in _TAGS or set(end.items) != set(CARTESIAN):
        return False
    values = end.items.values()
    has_computed_number = not all(isinstance(value, Number) for value in values)
    return has_computed_number and all(_is_computable(value, unset_names) for value in values)


class _Column(Struct, frozen=True, eq=False):
    """The numbers of a value, one for each round; `is_integer` is True if they may be INTs."""

    numbers: list[float]
    is_integer: bool


class _NoColumnError(Exception):
    """A value is not known in every round, or has no column of numbers or of positions: rounds are followed singly."""


class _Rounds:
    """The values in all rounds of a loop, one column for each variable.

    :ivar columns: name → numbers, of the counter and of variables that are numbers.
    :ivar positions: name → positions, of variables that are positions.
    :ivar copied_elements: assignments that copy a point: the line, the array element, and the name of the variable that
        gets it.
    """

    def __init__(self, run: Run, rounds: PlainRounds, counter: str) -> None:
        """Begin with the values of the counter alone; `counter` is its name, upper case."""
        self.run, self.count = run, rounds.count
        self.columns = {counter: _Column([float(number) for number in rounds.indices(offset=0)], is_integer=True)}
        self.positions: dict[str, list[Position]] = {}
        self.copied_elements: list[tuple[int, Reference, str]] = []

    def assign(self, line: int, stmt: Assignment) -> None:
        """Set a variable to the values of an assignment, one for each round.

        :param line: line of the assignment in its file.
        :raises _NoColumnError: the values are neither all numbers of one type, nor all complete positions: the rounds
            are then followed one by one.
        """
        name, stored_name = stmt.target.name, self._stored_name(stmt.target.name)
        self.columns.pop(name, None)  # values of an earlier assignment in the round
        self.positions.pop(name, None)
        if isinstance(stmt.value, Reference) and stmt.value.indices is not None:
            values = self._element_values(stmt.value)
            points = [value for value in values if isinstance(value, Aggregate)]
            if len(points) == len(values):  # all elements are points
                self.positions[name] = [_cartesian_position(point) for point in points]
                if any(not point.is_computed for point in points):
                    self.copied_elements.append((line, stmt.value, name))
                return
        column, variable_type = self.column(stmt.value), self.run.variables.types.get(stored_name, "")
        # offsets 0, 0: the numbers are in no text
        self.columns[name] = _as_column(
            [convert_to_type(Number(number, 0, 0, column.is_integer), variable_type) for number in column.numbers]
        )

    def targets(self, end: Value) -> list[Position]:
        """Return the targets of a motion, one for each round.

        :param end: the target as the text gives it.
        :raises _NoColumnError: not all targets are known, or one is out of reach.
        """
        if isinstance(end, Reference):
            if end.name not in self.positions:
                raise _NoColumnError
            positions = self.positions[end.name]
        elif isinstance(end, Aggregate):
            columns = [self.column(end.items[name]).numbers for name in CARTESIAN]
            positions = [Position(values) for values in zip(*columns, strict=True)]
        else:
            raise _NoColumnError
        if not all(position.largest_coordinate <= LARGEST_COORDINATE for position in positions):  # NaN is refused too
            raise _NoColumnError
        return positions

    def column(self, value: Value) -> _Column:
        """Return the values of an expression, one for each round; they equal those of `Variables.evaluate`.

        :raises _NoColumnError: a value is not a number or cannot be computed, or only some of the values are INTs.
        """
        if isinstance(value, Number):
            return _Column([value.value] * self.count, value.is_integer)
        if isinstance(value, Reference):
            return self._variable_column(value)
        if isinstance(value, Operation):
            # −x is 0 − x
            left = _Column([0.0] * self.count, is_integer=True) if value.left is None else self.column(value.left)
            return _operation_column(value.operator, left, self.column(value.right))
        if isinstance(value, Call):
            arguments = [self.column(argument) for argument in value.arguments]
            function = FUNCTIONS[value.name]
            try:
                numbers = [function(*row) for row in zip(*(column.numbers for column in arguments), strict=True)]
            except (ValueError, OverflowError):
                raise _NoColumnError from None
            # all functions but ABS give REALs
            return _Column(numbers, value.name == "ABS" and all(column.is_integer for column in arguments))
        raise _NoColumnError

    def _variable_column(self, reference: Reference) -> _Column:
        """Return the values of a variable or an array element, one for each round.

        :raises _NoColumnError: the values are not known before run time, or are not numbers of one type.
        """
        if reference.indices is not None:
            return _as_column(self._element_values(reference))
        column = self.columns.get(reference.name)
        if column is not None:
            return column
        if reference.name in self.positions:
            raise _NoColumnError
        return _as_column([self.run.variables.value(self._stored_name(reference.name))] * self.count)

    def _element_values(self, reference: Reference) -> Sequence[object]:
        """Return the elements of an array, one for each round; None for an element without a value.

        :param reference: the element, with one index.
        :raises _NoColumnError: an index is not a whole number, or the rounds set a variable with the name of the array.
        """
        variables, name = self.run.variables, self._stored_name(reference.name)
        if reference.indices is None or reference.name in self.columns or reference.name in self.positions:
            raise _NoColumnError
        indices = self.column(reference.indices[0]).numbers
        if any(index != int(index) for index in indices):
            raise _NoColumnError
        return [variables.value(f"{name}[{int(index)}]") for index in indices]

    def _stored_name(self, name: str) -> str:
        """Return the name under which a variable is stored.

        :raises _NoColumnError: the variable may change at any time, is a whole array of the caller, or has a value in
            the cell.
        """
        variables = self.run.variables
        stored_name = self.run.stored_name(name)
        is_in_cell = any(variable_of(key) == stored_name for key in variables.cell_values)
        if name in variables.scope.array_names or stored_name in variables.volatile_values or is_in_cell:
            raise _NoColumnError
        return stored_name


def _as_column(values: Sequence[object]) -> _Column:
    """Return numbers as a column.

    :raises _NoColumnError: a value is not a number, or only some of the values may be INTs.
    """
    numbers = [value for value in values if isinstance(value, Number)]
    if len(numbers) < len(values) or len({number.is_integer for number in numbers}) != 1:
        raise _NoColumnError
    return _Column([number.value for number in numbers], numbers[0].is_integer)


def _operation_column(operator: str, left: _Column, right: _Column) -> _Column:
    """Return the sums, differences, products or quotients of two columns.

    :raises _NoColumnError: a result is not known, as that of a division by 0.
    """
    are_integers = left.is_integer and right.is_integer
    values = [
        operation_result(operator, a, b, are_integers=are_integers)
        for a, b in zip(left.numbers, right.numbers, strict=True)
    ]
    numbers = [value for value in values if isinstance(value, int | float)]
    if len(numbers) < len(values):
        raise _NoColumnError
    return _Column(numbers, are_integers)


def _cartesian_position(aggregate: Aggregate) -> Position:
    """Return the position of an aggregate.

    :raises _NoColumnError: the aggregate is not a complete Cartesian position of known numbers.
    """
    if not aggregate.items.keys() >= set(CARTESIAN) or not all(
        isinstance(value, Number) for value in aggregate.items.values()
    ):
        raise _NoColumnError
    try:
        position = position_from_aggregate(aggregate)
    except ProgramError:
        raise _NoColumnError from None
    if position.is_axis:
        raise _NoColumnError
    return position


def computed_motions(run: Run, reader: MotionReader, rounds: PlainRounds) -> list[MotionStatement] | None:
    """Return the motions of rounds whose points are computed from the counter, in execution order.

    The names that the rounds use, and the points that they copy, are noted in `run`.

    :param run: the program as far as it has run, before the first round; unchanged if None is returned.
    :returns: None if the motions cannot be computed as columns.
    """
    head = statement(rounds.source, rounds.head)
    if not isinstance(head, For) or not run.may_take_rounds_at_once:
        return None
    motions: list[list[MotionStatement]] = []  # of each statement, one for each round
    targets: list[Value] = []
    values = _Rounds(run, rounds, head.name)
    try:
        for line in sorted((*rounds.body.assignments, *rounds.body.motions)):
            stmt = statement(rounds.source, line)
            if isinstance(stmt, Assignment):
                values.assign(line, stmt)
            elif isinstance(stmt, Motion) and stmt.end is not None:
                _, is_approximated = reader.tail_settings(Place(rounds.source, line), KINDS[stmt.word], stmt.tail)
                rows = rounds.rows_of_statement(line).tolist()
                motions.append(_motions_of_statement(stmt, stmt.end, rows, values.targets(stmt.end), is_approximated))
                targets.append(stmt.end)
    except (_NoColumnError, ProgramError):
        return None
    for target in targets:
        run.variables.note_dependence(target)
    _note_followed_names(run, rounds)
    for line, point, name in values.copied_elements:
        run.copies.add((point.name, name))
        _note_followed_name(run, rounds, line, point)
    # from one list for each statement to the order of execution
    return [move for moves_of_round in zip(*motions, strict=True) for move in moves_of_round]


def _note_followed_names(run: Run, rounds: PlainRounds) -> None:
    """Add to `run.followed_names` the variables that the rounds set, and the points that they move to."""
    for line in (*rounds.body.assignments, *rounds.body.motions):
        stmt = statement(rounds.source, line)
        name = stmt.target if isinstance(stmt, Assignment) else stmt.end if isinstance(stmt, Motion) else None
        if isinstance(name, Reference):
            _note_followed_name(run, rounds, line, name)


def _note_followed_name(run: Run, rounds: PlainRounds, line: int, name: Reference) -> None:
    """Add a name on a line of the body to `run.followed_names`, in all rounds."""
    run.followed_names.update([(row, name.start) for row in rounds.rows_of_statement(line).tolist()])


def _motions_of_statement(
    stmt: Motion, end: Value, rows: Sequence[int], targets: Sequence[Position], is_approximated: bool
) -> list[MotionStatement]:
    """Return the motions that one statement of the body makes, one for each of n rounds.

    The statement is PTP, SPTP, LIN or SLIN: computed rounds have no other motions.

    :param end: target of the statement as the text gives it.
    :param rows: (n,) rows of the trace at which the statement runs.
    :param targets: (n,) targets of the motions.
    :param is_approximated: True if the motions do not stop at their targets.
    """
    tail, kind, keyword = stmt.tail, KINDS[stmt.word], (stmt.start, stmt.start + len(stmt.word))
    name = end.name if isinstance(end, Reference) else ""
    points = (Point(position, end.start, end.stop, name) for position in targets)
    return [
        MotionStatement(
            trace_row=row,
            kind=kind,
            keyword=keyword,
            end=point,
            relative_axes="",
            via=None,
            angle=None,
            tail_start=tail.start,
            stop=tail.stop,
            is_approximated=is_approximated,
        )
        for row, point in zip(rows, points, strict=True)
    ]
