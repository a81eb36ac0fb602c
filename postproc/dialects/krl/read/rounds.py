"""Whether statements use a value left in a variable by the previous iteration of a loop or the previous run."""

from __future__ import annotations

from collections.abc import Sequence

from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.structures import Block, Node
from postproc.dialects.krl.language.tokens import words_in
from postproc.dialects.krl.language.tree import Assignment, For, Statement
from postproc.dialects.krl.language.values import Aggregate
from postproc.dialects.krl.read.run import Run
from postproc.dialects.krl.read.variables import Snapshot


def carried_variables(run: Run, source: Source, block: Block, start_values: Snapshot) -> list[str]:
    """Return the variables that one iteration of a loop changes and the next one may use.

    :param start_values: their values at the start of the iteration.
    """
    statements = Uses(run, source, block.parts[0].nodes)
    names: list[str] = sorted(run.variables.differing_names(start_values))
    return [name for name in names if statements.may_use(name) and not statements.only_counts(name)]


class Uses:
    """The variables that some statements use.

    :param nodes: statements that all run, in order, except those inside control structures.
    """

    def __init__(self, run: Run, source: Source, nodes: Sequence[Node]) -> None:
        """Read the words on all lines of the statements."""
        self.run, self.source = run, source
        self._certain = {node if isinstance(node, int) else node.first for node in nodes}
        lines = [line for node in nodes for line in ([node] if isinstance(node, int) else node.lines())]
        self._words = {line: _words_of_line(source, line) for line in lines}

    def may_use(self, name: str) -> bool:
        """Return whether the statements may use the value that a variable has before them."""
        for line, words in self._words.items():
            stmt = statement(self.source, line)
            if self._is_named_in_callees(stmt, name) or "GOTO" in words or "RETURN" in words:
                return True
            if name in words:
                return not (line in self._certain and words.count(name) == 1 and _sets_whole_variable(stmt, name))
        return False

    def only_counts(self, name: str) -> bool:
        """Return whether a variable is used only in assignments to itself."""
        statements = ((statement(self.source, line), name in words) for line, words in self._words.items())
        return not any(
            self._is_named_in_callees(stmt, name)
            or (has_name and not (isinstance(stmt, Assignment) and stmt.target.name == name))
            for stmt, has_name in statements
        )

    def _is_named_in_callees(self, stmt: Statement, name: str) -> bool:
        """Return whether the routines that a statement calls name a variable."""
        callees = (self.run.library.find_callee(call.name, self.run.level.module) for call in calls(stmt.values))
        return any(name in self.run.analysis.variable_names(*callee) for callee in callees if callee is not None)


def _sets_whole_variable(stmt: Statement, name: str) -> bool:
    """Return whether a statement sets a whole variable.

    An aggregate does not count: it may lack components, which the variable then keeps.
    """
    target = stmt.counter if isinstance(stmt, For) else None
    if isinstance(stmt, Assignment) and not isinstance(stmt.value, Aggregate):
        target = stmt.target
    return target is not None and target.name == name and target.indices is None and target.field is None


def _words_of_line(source: Source, line: int) -> list[str]:
    """Return the words in the code of a line, upper case, in order."""
    return [word.upper() for word, _ in words_in(source.text, *source.code_span(line))]
