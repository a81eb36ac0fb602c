"""Whether statements use a value left in a variable by the previous iteration of a loop or the previous run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence, Set

from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.structures import Block, Node
from postproc.dialects.krl.language.tokens import words_in
from postproc.dialects.krl.language.tree import Assignment, For, Statement
from postproc.dialects.krl.language.values import Aggregate
from postproc.dialects.krl.read.bas import data_read
from postproc.dialects.krl.read.run import Run
from postproc.dialects.krl.read.variables import Snapshot

_OUTPUTS = ("$OUT", "$ANOUT")


def carried_variables(run: Run, source: Source, block: Block, start_values: Snapshot) -> list[str]:
    """Return the variables that the iteration which has just run changed, and that the next iteration may use.

    Variables that are used only to compute their own next value are left out, and those that decide nothing but
    outputs and how long the program waits.

    :param block: the loop.
    :param start_values: values of all variables at the start of the iteration.
    """
    uses = Uses(run, source, block.parts[0].nodes)
    changed_names: list[str] = sorted(run.variables.differing_names(start_values))
    names = [name for name in changed_names if uses.may_use(name) and not uses.only_counts(name)]
    motionless_names = uses.motionless_names(names) if names else set[str]()
    return [name for name in names if name not in motionless_names]


class Uses:
    """The variables that some statements use.

    :param nodes: statements and control structures, in order; of statements inside control structures it is not certain
        that they run.
    """

    def __init__(self, run: Run, source: Source, nodes: Sequence[Node]) -> None:
        """Read the words on all lines of the statements."""
        self.run, self.source = run, source
        self._certain_lines = {node if isinstance(node, int) else node.first for node in nodes}
        lines = [line for node in nodes for line in ([node] if isinstance(node, int) else node.lines())]
        self._words_by_line = {line: _words_of_line(source, line) for line in lines}
        self._blocks = {part.head: block for block in _all_blocks(nodes) for part in block.parts}

    def may_use(self, name: str) -> bool:
        """Return whether the statements may use the value that a variable has before them.

        The first statement that names the variable decides: it does not use the value if it surely runs and sets the
        whole variable. A GOTO, a RETURN, or a called routine that names the variable before counts as use.
        """
        for line, words in self._words_by_line.items():
            stmt = statement(self.source, line)
            if self._is_named_in_callees(stmt, name) or "GOTO" in words or "RETURN" in words:
                return True
            if name in words:
                is_set = words.count(name) == 1 and _sets_whole_variable(stmt, name)  # named once: not in its own value
                return not (line in self._certain_lines and is_set)
        return False

    def only_counts(self, name: str) -> bool:
        """Return whether a variable is named only in assignments to itself, and in no called routine."""
        statements = ((statement(self.source, line), name in words) for line, words in self._words_by_line.items())
        return not any(
            self._is_named_in_callees(stmt, name)
            or (has_name and not (isinstance(stmt, Assignment) and stmt.target.name == name))
            for stmt, has_name in statements
        )

    def motionless_names(self, names: Iterable[str]) -> set[str]:
        """Return those of some names, and of outputs, that decide nothing but outputs, waits and values of each other.

        Each statement that names one assigns to one, is a WAIT FOR, or begins an IF or a SWITCH around assignments to
        them alone.
        """
        motionless_names = {*names, *_OUTPUTS}
        while other_names := {name for name in motionless_names if not self._is_motionless(name, motionless_names)}:
            motionless_names -= other_names
        return motionless_names

    def _is_motionless(self, name: str, motionless_names: Set[str]) -> bool:
        """Return whether each statement that names a variable may be one of those of `motionless_names`."""
        for line, words in self._words_by_line.items():
            stmt = statement(self.source, line)
            if self._is_named_in_callees(stmt, name):
                return False
            if name in words and not (
                _assigns_to(stmt, motionless_names)
                or (stmt.word == "WAIT" and not any(calls(stmt.values)))
                or (line in self._blocks and self._only_assigns_to(self._blocks[line], motionless_names))
            ):
                return False
        return True

    def _only_assigns_to(self, block: Block, names: Set[str]) -> bool:
        """Return whether a control structure is an IF or a SWITCH that contains nothing but assignments to some names.

        A condition with a call, and a force comment in it, count as more.
        """
        # plain motions are in no node
        other_lines = [*self.run.level.routine.motion_lines, *self.run.analysis.force_comment_lines(self.source)]
        if block.word not in ("IF", "SWITCH") or any(block.first <= line <= block.last for line in other_lines):
            return False
        return all(
            not any(calls(statement(self.source, part.head).values))
            and all(
                self._only_assigns_to(node, names)
                if isinstance(node, Block)
                else _assigns_to(statement(self.source, node), names)
                for node in part.nodes
            )
            for part in block.parts
        )

    def _is_named_in_callees(self, stmt: Statement, name: str) -> bool:
        """Return whether the routines that a statement calls name a variable."""
        callees = (self.run.library.find_callee(call.name, self.run.level.module) for call in calls(stmt.values))
        return any(name in self.run.analysis.variable_names(*callee) for callee in callees if callee is not None)


def _all_blocks(nodes: Sequence[Node]) -> Iterator[Block]:
    """Yield the control structures among some nodes, and those in them."""
    for node in nodes:
        if isinstance(node, Block):
            yield node
            for part in node.parts:
                yield from _all_blocks(part.nodes)


def _assigns_to(stmt: Statement, names: Set[str]) -> bool:
    """Return whether a statement without a call assigns to one of some names."""
    return isinstance(stmt, Assignment) and stmt.target.name in names and not any(calls(stmt.values))


def _sets_whole_variable(stmt: Statement, name: str) -> bool:
    """Return whether a statement sets a whole variable: an assignment, or a FOR with that counter.

    The assignment of an aggregate does not count: it may lack components, which the variable then keeps.
    """
    target = stmt.counter if isinstance(stmt, For) else None
    if isinstance(stmt, Assignment) and not isinstance(stmt.value, Aggregate):
        target = stmt.target
    return target is not None and target.name == name and target.indices is None and target.field is None


def _words_of_line(source: Source, line: int) -> list[str]:
    """Return the words in the code of a line, upper case, in order; then the data that it reads without naming them."""
    words = [word for word, _ in words_in(source.text, *source.code_span(line))]
    return [*words, *data_read(source, line, words)]
