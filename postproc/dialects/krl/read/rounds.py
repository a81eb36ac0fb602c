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
    """Return the variables that one iteration of a loop changes and the next iteration may use.

    :param start_values: their values when it began, see `Variables.snapshot`.
    """
    statements = Uses(run, source, block.parts[0].nodes)
    names: list[str] = sorted(run.variables.differing(start_values))
    return [name for name in names if statements.uses(name) and not statements.only_counts(name)]


class Uses:
    """The variables that some statements use.

    :param nodes: statements that all run, in order, except those inside control structures.
    """

    def __init__(self, run: Run, source: Source, nodes: Sequence[Node]) -> None:
        self.run, self.source = run, source
        self._certain = {node if isinstance(node, int) else node.first for node in nodes}
        lines = [line for node in nodes for line in ([node] if isinstance(node, int) else node.lines())]
        self._words = {line: _words(source, line) for line in lines}

    def uses(self, name: str) -> bool:
        """Return whether they may use the value that a variable has before them, since they do not set it first."""
        for line, words in self._words.items():
            stmt = statement(self.source, line)
            if self._called(stmt, name) or "GOTO" in words or "RETURN" in words:
                return True
            if name in words:
                return not (line in self._certain and words.count(name) == 1 and _sets(stmt, name))
        return False

    def only_counts(self, name: str) -> bool:
        """Return whether a variable is used only in assignments to itself."""
        statements = ((statement(self.source, line), name in words) for line, words in self._words.items())
        return not any(
            self._called(stmt, name) or (has_name and not (isinstance(stmt, Assignment) and stmt.target.name == name))
            for stmt, has_name in statements
        )

    def _called(self, stmt: Statement, name: str) -> bool:
        """Return whether the code of a routine that a statement calls contains a variable."""
        callees = (self.run.library.find(call.name, self.run.level.module) for call in calls(stmt.values))
        return any(name in self.run.analysis.names(*callee) for callee in callees if callee is not None)


def _sets(stmt: Statement, name: str) -> bool:
    """Return whether a statement gives a whole variable a value: of an aggregate, components may be missing."""
    target = stmt.counter if isinstance(stmt, For) else None
    if isinstance(stmt, Assignment) and not isinstance(stmt.value, Aggregate):
        target = stmt.target
    return target is not None and target.name == name and target.indices is None and target.field is None


def _words(source: Source, line: int) -> list[str]:
    return [word.upper() for word, _ in words_in(source.text, *source.code_span(line))]
