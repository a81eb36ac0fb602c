"""Named points: corrected in their declaration if all uses have one correction, otherwise copied to new points.

Array elements to which loops move are corrected in bulk; motions that share an element become statements.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from postproc.dialects.krl.execution import Execution
from postproc.dialects.krl.language.expressions import parse_aggregate
from postproc.dialects.krl.language.motion_statements import MotionStatement, Point
from postproc.dialects.krl.language.names import Names
from postproc.dialects.krl.language.positions import position_from_aggregate
from postproc.dialects.krl.language.source import DAT, Place, Source
from postproc.dialects.krl.language.tokens import NAME, names_in, word_at
from postproc.dialects.krl.language.values import Aggregate
from postproc.dialects.krl.layout import Elements, Layout
from postproc.dialects.krl.write.edits import Replacements
from postproc.dialects.krl.write.target_statements import edited_literal, literal_of, replaced_numbers
from postproc.errors import Issue
from postproc.program import Bools, Ints, Motions

Mentions = Mapping[str, Sequence[tuple[int, int]]]
"""Variable, upper case → (row of the trace, offset) of each occurrence of its name in code.

The trace: the lines of a program in execution order; an offset counts in the file of the line."""
_TextPlace = tuple[Source, int, int]
"""Place of an aggregate: file, row of the trace (0 in a data list), and offset in the file."""


class Use(Struct, frozen=True, eq=False):
    """A named point in a statement.

    :param trace_row: 1-based row of the execution trace (line in execution order) with the statement.
    :param operand: the point in the statement.
    :param texts: component → number to be commanded; None if the point is not corrected in this statement.
    :param complete_literal: returns the target as a literal with all components, for statements in which no new point
        can be named.
    """

    trace_row: int
    operand: Point
    texts: Mapping[str, str] | None
    complete_literal: Callable[[], str]


class NamedPoints(Struct, eq=False):
    """Collects the uses of named points and decides where their numbers go.

    A named point is a variable with the numbers of a target, such as XP1 of ``LIN XP1``; they are in its declaration.

    :ivar sources: the files that are written: the `.src` and, if there is one, its `.dat`.
    :ivar replacements: edits of each of these files.
    :ivar mentions: all places at which code names a variable, see `Mentions`.
    :ivar issues: information for the user.
    """

    sources: Sequence[Source]
    layout: Layout
    replacements: Sequence[Replacements]
    mentions: Mentions
    issues: list[Issue] = []
    _uses: dict[_TextPlace, list[Use]] = field(default_factory=lambda: defaultdict(list))
    _names: Names | None = None
    _is_motion_only: dict[str, bool] = {}

    def add_use(self, use: Use) -> None:
        """Store the use of a point in a statement.

        A corrected point that has no name, or whose numbers are computed, is replaced by a literal at once.
        """
        aggregate = use.operand.position.aggregate
        if aggregate is not None and use.operand.name:
            self._uses[_text_place(aggregate)].append(use)
        elif use.texts is not None:
            self._replace_by_literal(use)

    def make_edits(self) -> None:
        """Correct each point: in its declaration if all uses allow it, otherwise by new points or literals.

        A literal is the point written as numbers in the statement: ``{X 1,Y 2,…}``.
        """
        for uses in self._uses.values():
            corrected_uses = [use for use in uses if use.texts is not None]
            aggregate = uses[0].operand.position.aggregate
            if not corrected_uses or aggregate is None:
                continue
            if self._is_correctable_in_declaration(uses, aggregate):
                self._correct_declaration(corrected_uses[0], aggregate)
            else:
                self._declare_new_points(corrected_uses, aggregate)

    def _is_correctable_in_declaration(self, uses: list[Use], aggregate: Aggregate) -> bool:
        """Return whether a point can be corrected in its declaration.

        All uses must have the same correction and the same name, the file of the declaration must be written, and only
        motions may use the point.

        :param uses: all uses of the point.
        :param aggregate: value of the point in its declaration.
        """
        name = uses[0].operand.name
        has_one_correction = all(use.texts == uses[0].texts and use.operand.name == name for use in uses)
        # row > 0: a line of the program assigns it; other files than `sources` are read only
        is_written = aggregate.row > 0 or aggregate.source.index < len(self.sources)
        return has_one_correction and is_written and self._is_used_by_motions_only(name)

    def _is_used_by_motions_only(self, name: str) -> bool:
        """Return whether only motions use the values of a variable; the result is stored."""
        if name not in self._is_motion_only:
            self._is_motion_only[name] = is_used_by_motions_only(name, self.layout, self.mentions)
        return self._is_motion_only[name]

    def _correct_declaration(self, use: Use, aggregate: Aggregate) -> None:
        """Replace the numbers of a point in its declaration by the corrected numbers.

        :param use: any of the corrected uses: all have the same numbers.
        :param aggregate: value of the point in its declaration.
        """
        # a point that a line of the program assigns has a row of the trace, whose edits are the first
        edits = self.replacements[0 if aggregate.row > 0 else aggregate.source.index]
        for piece in replaced_numbers(literal_of(aggregate), use.texts or {}):
            edits.add(*piece, aggregate.row)

    def _declare_new_points(self, uses: list[Use], aggregate: Aggregate) -> None:
        """Declare a new point for each different correction of a point, and use it in the corrected statements.

        Other statements keep the old point. The statement gets a literal in place of a new point if the old point is
        not declared in the `.dat`, is copied, is not a plain name, or if the statement is in another file.

        :param uses: the corrected uses.
        :param aggregate: value of the old point in its declaration.
        """
        names: dict[str, str] = {}  # value of a new point, as literal → its name
        for use in uses:
            source = self.layout.execution.trace.source(use.trace_row)
            text = source.text[use.operand.start : use.operand.stop]
            is_out_of_scope = source is not self.sources[0]  # other files do not see names of this `.dat`
            is_copy = any(use.operand.name in pair for pair in self.layout.copies)
            # row > 0: an assignment in the `.src` gives its value; one source alone: the program has no `.dat`
            is_not_in_data_list = aggregate.row > 0 or aggregate.source.index != DAT or len(self.sources) < 2
            if is_not_in_data_list or is_copy or is_out_of_scope or not NAME.fullmatch(text):
                self._replace_by_literal(use)
                continue
            literal = edited_literal(literal_of(aggregate), replaced_numbers(literal_of(aggregate), use.texts or {}))
            if literal not in names:
                names[literal] = self._declare_point(text, literal, aggregate)
            self.replacements[0].add(use.operand.start, use.operand.stop, names[literal], use.trace_row)
            message = (
                f"{text} is also used otherwise: this motion uses the new point {names[literal]} of the .dat. "
                "The text of an inline form still names the old point."
            )
            self.issues.append(Issue("info", "new-point", message, use.trace_row))

    def _declare_point(self, name: str, literal: str, aggregate: Aggregate) -> str:
        """Declare a new point behind the declaration of an old point; return the new name.

        :param name: name of the old point, as spelled.
        :param literal: value of the new point.
        :param aggregate: value of the old point in its declaration.
        """
        source = aggregate.source
        if self._names is None:
            self._names = Names(set().union(*(names_in(file.text) for file in self.sources)))
        new_name = self._names.unused_name(name)
        line = source.line_at(aggregate.start)
        start, stop = source.starts.item(line - 1), source.stops.item(line - 1)
        next_line_start = source.starts.item(line)  # a line always follows: ENDDAT at least
        old_line, line_end = source.text[start:stop], source.text[stop:next_line_start]
        indent = old_line[: len(old_line) - len(old_line.lstrip())]
        kind = self.layout.types.get(name.upper(), "E6POS")
        new_line = f"{indent}DECL {kind} {new_name}={literal}{line_end}"
        self.replacements[source.index].add(next_line_start, next_line_start, new_line)
        return new_name

    def _replace_by_literal(self, use: Use) -> None:
        """Replace the point in a statement by a literal with the numbers of its target; add an issue."""
        self.replacements[0].add(use.operand.start, use.operand.stop, use.complete_literal(), use.trace_row)
        message = "A point that is computed, or that something else uses too, is replaced by numbers in the statement."
        self.issues.append(Issue("info", "point-replaced", message, use.trace_row))


def mentions(execution: Execution, plain_rows: Ints) -> Mentions:
    """Return the places at which code names each variable: name, upper case → (row of the trace, offset).

    The trace has the lines in execution order. Routines that calls reach which are not followed must stay unchanged.
    They are searched a second time, with row 0: a use that the reader has not followed.

    :param plain_rows: rows of the trace that name no points; they are skipped.
    """
    trace, places = execution.trace, defaultdict[str, list[tuple[int, int]]](list)
    is_left_out = trace.is_counter_row.copy()  # rows that set the counter of a FOR are in no file
    is_left_out[plain_rows - 1] = True
    names: dict[Place, list[tuple[str, int]]] = {}  # of lines that were searched: names and offsets
    for row in (np.flatnonzero(~is_left_out) + 1).tolist():
        place = trace.place(row)
        if place not in names:
            names[place] = _names_on_line(*place)
        for name, offset in names[place]:
            places[name].append((row, offset))
    for routine in execution.unchanged_routines:
        for line in range(routine.first + 1, routine.last):
            for name, offset in _names_on_line(routine.source, line):
                places[name].append((0, offset))
    return places


def _names_on_line(source: Source, line: int) -> list[tuple[str, int]]:
    """Return the names in the code of a line, upper case, and their offsets."""
    return [(match[0].upper(), match.start()) for match in NAME.finditer(source.text, *source.code_span(line))]


def _text_place(aggregate: Aggregate) -> _TextPlace:
    """Return the place of the text of an aggregate: file, row of the trace, offset."""
    return aggregate.source, aggregate.row, aggregate.start


def is_used_by_motions_only(name: str, layout: Layout, mentions: Mentions) -> bool:
    """Return whether only motions use the values of a variable, so that the values may change.

    A variable that anything else uses, such as a computation or a branch, must keep its values. The same must be true
    of all variables that it is copied to or from, and none of them may be GLOBAL.

    :param name: the variable, upper case.
    :param mentions: variable, upper case → places at which code names it.
    """
    names = {name}
    # repeat until no further copies are found
    while copies := {copy for pair in layout.copies if not names.isdisjoint(pair) for copy in pair} - names:
        names |= copies
    places = [place for name in names for place in mentions.get(name, ())]
    # the reader has followed the use at these places: in motions, or in copies
    are_followed = layout.followed_names.issuperset(places)
    return are_followed and names.isdisjoint(layout.global_names)


def editable_layout(
    layout: Layout, motions: Motions, mentions: Mentions, file_count: int, has_one_target: Bools
) -> Layout:
    """Return the layout without array elements (`elements`) whose numbers cannot be edited in their declaration.

    Motions to them become `statements`, whose points `NamedPoints` corrects one by one.

    :param mentions: variable, upper case → places at which code names it.
    :param file_count: number of files that are written: the `.src` and its `.dat`.
    :param has_one_target: (M,) True for motions with a single target, whose text has all components that it needs.
    """
    if not layout.elements:
        return layout
    use_counts = Counter(_literal_places(layout))
    editable_elements, statements, relative_spans = [], dict(layout.statements), layout.relative_spans.copy()
    for elements in layout.elements:  # of one array
        is_array_editable = (
            elements.source.index < file_count  # the file of its declaration is written
            and layout.carriage is None  # the spans of array elements lack E1
            and is_used_by_motions_only(elements.name, layout, mentions)
        )
        is_single_use = np.array([use_counts[place] == 1 for place in _element_places(elements)], np.bool_)
        is_editable = has_one_target[elements.row] & is_single_use & is_array_editable
        editable_elements.append(
            Elements(elements.row[is_editable], elements.literal[is_editable], elements.source, elements.name)
        )
        other_rows, other_literals = elements.row[~is_editable], elements.literal[~is_editable]
        relative_spans[other_rows] = 0  # 0: no number is edited in place
        for row, literal in zip(other_rows.tolist(), other_literals.tolist(), strict=True):
            statements[row] = _statement_of_element(layout, motions, row, elements, literal)
    return replace(
        layout,
        statements=dict(sorted(statements.items())),
        elements=tuple(editable_elements),
        relative_spans=relative_spans,
    )


def _literal_places(layout: Layout) -> Iterator[_TextPlace]:
    """Yield the place of the literal of each point in `statements` and of each of `elements`, once for each use."""
    for move in layout.statements.values():
        for point in (move.end, move.via):
            if point is not None and point.position.aggregate is not None:
                yield _text_place(point.position.aggregate)
    for elements in layout.elements:
        yield from _element_places(elements)


def _element_places(elements: Elements) -> Iterator[_TextPlace]:
    """Yield the place of the literal of each array element."""
    return ((elements.source, 0, start) for start in elements.literal[:, 0].tolist())


def _statement_of_element(
    layout: Layout, motions: Motions, row: int, elements: Elements, literal: Sequence[int]
) -> MotionStatement:
    """Return the statement of motion `row`, whose target is an array element: a plain motion without other points.

    :param elements: the elements of this array that are targets.
    :param literal: span of the aggregate in the declaration of the element.
    """
    start, stop = layout.target[row].tolist()
    tail_start, tail_stop = layout.tail[row].tolist()
    keyword_start = int(layout.keyword[row])
    keyword = word_at(layout.source(row).text, keyword_start, start)  # such as LIN
    position = position_from_aggregate(parse_aggregate(elements.source, *literal))
    return MotionStatement(
        trace_row=int(layout.trace_row[row]),
        kind=int(motions.kind[row]),
        keyword=(keyword_start, keyword_start + len(keyword)),
        end=Point(position, start, stop, elements.name),
        relative_axes="",
        via=None,
        angle=None,
        tail_start=tail_start,
        stop=tail_stop,
        is_approximated=bool(motions.blend[row] > 0.0),
    )
