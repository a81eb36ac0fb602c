"""The least number of statements that loops and calls run: too many are refused before they are followed.

Counted are statements that run whatever conditions say, with bounds of FOR that are numbers. Nothing is executed, and
each routine and each control structure is counted once, so that a tree of calls takes no longer than its text.
"""

from __future__ import annotations

from collections.abc import Sequence

from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.routines import Module, Routine
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.structures import Block, Node
from postproc.dialects.krl.language.tree import Assignment, CallStatement, For, Goto, Return
from postproc.dialects.krl.language.values import Call, Number
from postproc.dialects.krl.read.run import Run
from postproc.errors import ProgramError

ENDS_LOOPS = frozenset({"EXIT", "RETURN", "GOTO"})
_MAX_CALL_DEPTH = 25
"""Largest number of calls within each other that are counted; deeper calls are not followed anyway."""


class LeastStatements:
    """Counts statements of a program.

    :param run: the program as far as it has run: its files and what its routines may write.
    """

    def __init__(self, run: Run) -> None:
        """Begin with nothing counted."""
        self.run = run
        self._minimum_of_routine: dict[Routine, int] = {}
        self._minimum_of_round: dict[Block, int] = {}
        self._open_routines: list[Routine] = []  # routines that are being counted, each called by the one before

    def minimum_of_call(self, module: Module, routine: Routine) -> int:
        """Return a lower bound on the number of statements that a call of a routine runs; the result is stored.

        It is 0 for a routine that calls itself or cannot be read, and for calls that are nested too deeply.
        """
        if routine in self._open_routines or len(self._open_routines) > _MAX_CALL_DEPTH:
            return 0
        if routine not in self._minimum_of_routine:
            self._open_routines.append(routine)
            try:
                minimum = self._minimum_of_nodes(routine.source, self.run.nodes(routine), module)
            except ProgramError:
                minimum = 0
            self._minimum_of_routine[routine] = minimum
            self._open_routines.pop()
        return self._minimum_of_routine[routine]

    def minimum_of_round(self, source: Source, block: Block, module: Module) -> int:
        """Return a lower bound on the number of statements that one round of a loop runs, its first line included."""
        if block not in self._minimum_of_round:
            self._minimum_of_round[block] = 1 + self._minimum_of_nodes(source, block.parts[0].nodes, module)
        return self._minimum_of_round[block]

    def may_write_counter(self, source: Source, block: Block, name: str, module: Module) -> bool:
        """Return whether statements of a FOR may write its counter, by assignments, inner FORs or calls.

        True for a call with the name anywhere in its arguments, and for a call of a routine in no file.

        :param name: name of the counter, upper case.
        """
        for line in list(block.lines())[1:]:  # without the FOR itself
            stmt = statement(source, line)
            if isinstance(stmt, Assignment) and stmt.target.name == name:
                return True
            if isinstance(stmt, For) and stmt.name == name:
                return True
            for call in calls(stmt.values):
                callee = self.run.library.find_callee(call.name, module)
                call_text = source.text[call.start : call.stop].upper()
                if name in call_text or callee is None:
                    return True
                # a stored name may begin with the prefix of a module
                if any(variable.endswith(name) for variable in self.run.analysis.effects_of(*callee).writes):
                    return True
        return False

    def _minimum_of_nodes(self, source: Source, nodes: Sequence[Node], module: Module) -> int:
        """Return a lower bound on the number of statements that some nodes run, one after the other.

        Counting stops at the first node that may leave the loop or the routine.
        """
        count = 0
        for node in nodes:
            words = {statement(source, line).word for line in node.lines()} if isinstance(node, Block) else set()
            if not words.isdisjoint(ENDS_LOOPS - {"EXIT"}):
                break
            if isinstance(node, Block):
                count += self._minimum_of_block(source, node, module, has_exit="EXIT" in words)
                continue
            stmt = statement(source, node)
            if isinstance(stmt, Return | Goto) or stmt.word in ENDS_LOOPS:
                break
            call = _call_of_statement(source, node)
            callee = None if call is None else self.run.library.find_callee(call.name, module)
            count += 1 if callee is None else 1 + self.minimum_of_call(*callee)
        return count

    def _minimum_of_block(self, source: Source, block: Block, module: Module, *, has_exit: bool) -> int:
        """Return a lower bound on the number of statements that a control structure runs.

        IF with ELSE: the smaller minimum of its two parts. FOR with numbers as bounds and step: the number of rounds
        times the minimum of one round. All others, and a FOR that may write its counter: 0.

        :param has_exit: True if an EXIT inside the structure may end a FOR early; the bound of a FOR is 0 then.
        """
        if block.word == "IF" and len(block.parts) > 1:
            return min(self._minimum_of_nodes(source, part.nodes, module) for part in block.parts)
        stmt = statement(source, block.first)
        if (
            not isinstance(stmt, For)
            or stmt.bounds is None
            or has_exit
            or self.may_write_counter(source, block, stmt.name, module)
        ):
            return 0
        first, last, step = stmt.bounds
        step = step or Number(1.0, start=0, stop=0, is_integer=True)  # without STEP, FOR counts by 1
        if not (isinstance(first, Number) and isinstance(last, Number) and isinstance(step, Number)) or not step.value:
            return 0
        round_count = max(0, int((last.value - first.value) // step.value) + 1)
        return round_count * self.minimum_of_round(source, block, module) if round_count else 0


def _call_of_statement(source: Source, line: int) -> Call | None:
    """Return the call that is a whole statement, or the whole value of an assignment; None for other statements."""
    stmt = statement(source, line)
    if isinstance(stmt, CallStatement):
        return stmt.call
    return stmt.value if isinstance(stmt, Assignment) and isinstance(stmt.value, Call) else None
