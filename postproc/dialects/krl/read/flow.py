"""Loops, branches and calls in execution order.

The execution trace, which is recorded here: the lines of the program in the order in which they are executed, as rows.
A loop around motions is unrolled in it: the lines of each iteration (round) follow each other. A
called routine with motions is inlined. A fork is an IF or SWITCH whose branch taken is not known before run time: all
its branches are in the trace.

A control structure is followed statement by statement if its conditions are known. If they are not known and it holds
no motions, every variable that it may write becomes unknown; if it holds motions, the program is refused.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable

import numpy as np

from postproc.dialects.krl.execution import Branch, Fork, ForkVisit, Join, PlainBody, PlainRounds, UnrolledLoop
from postproc.dialects.krl.language import tree
from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.routines import Module, Routine
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.structures import LOOPS, Block, Node, Part
from postproc.dialects.krl.language.values import Call, Number, Reference, Value
from postproc.dialects.krl.read.computed_rounds import FEWEST_ROUNDS, computed_body
from postproc.dialects.krl.read.conditions import NO_CASE, constant_cases
from postproc.dialects.krl.read.counter import Counter, undecided_error
from postproc.dialects.krl.read.interpreter import LOOP_ADVICE, Interpreter, undecided_jump_message
from postproc.dialects.krl.read.known import UnknownOrderError, VariableValue, shown_name, unknown_order_error
from postproc.dialects.krl.read.least_statements import ENDS_LOOPS, LeastStatements
from postproc.dialects.krl.read.motion_reader import keeps_position
from postproc.dialects.krl.read.plain_rounds import plain_body
from postproc.dialects.krl.read.rounds import carried_variables
from postproc.dialects.krl.read.run import Run
from postproc.dialects.krl.read.tracing import Recorder
from postproc.errors import ProgramError, first_of

MOST_STATEMENTS = 200_000
"""Most statements without motion followed in loops and called routines; later ones count as uncertain.

Whoever reads many random programs may lower this and the next two limits."""
MOST_TRACED = 400_000
"""A trace has at most this many statements more than the file has lines."""
MOST_UNCOUNTED = 60_000
"""Most statements that a loop around motions may run if its number of iterations is not known."""
_CASES_PER_STATEMENT = 4
"""Number of CASEs that count as one statement that runs."""
_MOST_FORKS = 4000
"""Most forks followed whose branch taken is not known before run time."""
_MOST_NAMES = 8
"""Most names of variables in a message."""
_NO_ITERATION = 0
"""Number of the iteration in `Flow._enclosing` for a call, and for a loop before its first iteration."""
_LENGTH_ADVICE = "Divide the program, or give its loops fewer rounds and its subprograms fewer calls."
_JUMP_IN_LOOP_ADVICE = "Write IF around the statements that it skips."
_LABEL_ADVICE = "Write LOOP, WHILE or IF in place of its GOTO, and remove the label."
_FORCE_ADVICE = "Write force comments outside of loops and branches whose conditions are not known."


class Flow:
    """Follows a program statement by statement.

    :param run: the program as far as it has run.
    :param take_motion: takes a motion of the program, or a line that begins or ends a spline block.
    :param note_fault: takes the error of a statement of the program.
    :param recorder: records the execution trace; None if a recorded trace is followed.
    """

    def __init__(
        self,
        run: Run,
        take_motion: Callable[[Place, tree.Statement], None],
        note_fault: Callable[[Place, ProgramError], None],
        recorder: Recorder | None = None,
    ) -> None:
        """Begin before the first statement."""
        self.run, self.recorder, self._note_fault = run, recorder, note_fault
        self.interpreter = Interpreter(run, take_motion, self.run_called_routine, self._inline_call)
        self._moving_blocks: dict[tuple[Block, Module], bool] = {}  # results of `_block_moves`
        self._plain_bodies: dict[Block, PlainBody | None] = {}  # body of a FOR; None if it is not plain
        self._case_tables: dict[Block, dict[float | None, int] | None] = {}  # of a SWITCH, see `constant_cases`
        self._enclosing: list[tuple[Place, int]] = []  # enclosing loops and calls, each with its iteration
        self._traced_count = self._fork_count = 0  # statements of the trace, and forks, that have been followed
        self._motionless_depth = 0  # number of nested control structures without motion that are followed
        self._least_statements = LeastStatements(run)

    def follow(self, source: Source, nodes: tuple[Node, ...], *, ends_routine: bool = False) -> None:
        """Run statements and control structures one by one, up to RETURN, EXIT, or a GOTO to a label not among them.

        :param source: the file.
        :param nodes: statements, given by their lines (from 1), and control structures, in order.
        :param ends_routine: True if the routine ends after the nodes.
        :raises UnknownOrderError: the branch taken is not known before run time.
        """
        level, index = self.run.level, 0
        while index < len(nodes):
            node = nodes[index]
            if isinstance(node, Block):
                # an IF that skips statements is followed together with them
                next_index = self._follow_skip(source, nodes, index, ends_routine=ends_routine)
                if next_index:
                    index = next_index
                    continue
                self._follow_block(source, node)
            else:
                stmt = statement(source, node)
                # a label is followed together with the statements up to the IF that jumps back to it
                if_index = self._follow_back_jump(source, nodes, index, stmt) if isinstance(stmt, tree.Label) else 0
                if if_index:
                    index, node = if_index, nodes[if_index]  # continue behind the IF
                else:
                    self._follow_statement(Place(source, node), stmt)
            index = self._label_index(source, nodes, index) if level.jump_line else index + 1
            if level.is_broken_off:
                # a GOTO has recorded its lines itself
                if self.recorder is not None and level.is_traced and not level.jump_line:
                    self.recorder.record_run_lines(node if isinstance(node, int) else node.last)
                return

    def label_of(self, source: Source, line: int) -> str:
        """Return the label to which a GOTO leads, upper case; empty for other statements."""
        stmt = statement(source, line)
        return stmt.label if isinstance(stmt, tree.Goto) else ""

    def labels(self, source: Source, lines: Iterable[int]) -> set[str]:
        """Return the names of the labels on some lines, upper case."""
        statements = (statement(source, line) for line in lines)
        return {stmt.name for stmt in statements if isinstance(stmt, tree.Label)}

    def _label_index(self, source: Source, nodes: tuple[Node, ...], index: int) -> int:
        """Return the index of the node with the label of a GOTO that has run, and reset `Level.jump_line`.

        :param index: index of the node with the GOTO; labels before it are not searched.
        :returns: the number of nodes if no later node is the label, or no trace is recorded; `jump_line` then stays.
        :raises UnknownOrderError: the GOTO is in a loop around motions.
        """
        level, recorder = self.run.level, self.recorder
        label = self.label_of(source, level.jump_line)
        for number in range(index + 1, len(nodes)):
            line = nodes[number]
            if isinstance(line, int) and recorder is not None and label in self.labels(source, [line]):
                if level.loop_depth:  # corrected rounds may be written one after the other: the label more than once
                    raise unknown_order_error(
                        Place(source, level.jump_line), "GOTO leads to a label in a loop", _JUMP_IN_LOOP_ADVICE
                    )
                level.jump_line = 0
                recorder.record_passed_lines(line - 1, is_executed=False)
                return number
        return len(nodes)

    def run_called_routine(self) -> None:
        """Run the statements of the routine that was called last."""
        routine, level = self.run.level.routine, self.run.level
        if not level.is_traced:
            self._check_statement_count(
                Place(routine.source, routine.first), self._least_statements.minimum_of_call(level.module, routine)
            )
        self.follow(routine.source, self.run.nodes(routine), ends_routine=True)

    def belongs_in_trace(self, source: Source, node: Node) -> bool:
        """Return whether a node belongs in the execution trace: it moves the robot or contains a force comment.

        :param node: a statement, given by its line, or a control structure.
        """
        if isinstance(node, int):
            return self._statement_moves(source, node)
        comment_lines = self.run.analysis.force_comment_lines(source)  # ascending
        has_comment = bisect_left(comment_lines, node.first) < bisect_left(comment_lines, node.last)
        return has_comment or self._block_moves(source, node)

    def _block_moves(self, source: Source, node: Block) -> bool:
        """Return whether a control structure contains a motion, a call of a routine of the trace, or a GOTO.

        The result is stored for each module that calls routines.
        """
        block_and_module = node, self.run.level.module
        if block_and_module not in self._moving_blocks:
            is_in_routine = source is self.run.level.routine.source
            # indices of the plain motions of the routine, which ascend, from the first to the last line
            begin, end = np.searchsorted(self.run.level.routine.motion_lines, [node.first, node.last])
            has_plain_motion = is_in_routine and bool(begin < end)
            self._moving_blocks[block_and_module] = has_plain_motion or any(
                self._statement_moves(source, line) for line in node.lines()
            )
        return self._moving_blocks[block_and_module]

    def _statement_moves(self, source: Source, line: int) -> bool:
        """Return whether a statement belongs in the trace: a motion, a call of a routine of the trace, or a GOTO.

        False for a statement that cannot be read.
        """
        stmt = statement(source, line)
        if isinstance(stmt, (tree.Goto, tree.Spline)):
            return True  # the motions after a GOTO depend on it
        if isinstance(stmt, tree.Motion):
            return not keeps_position(stmt)
        if isinstance(stmt, tree.Event):  # its action does not run here
            return False
        try:
            return any(self.interpreter.calls.traced_callee(call) is not None for call in calls(stmt.values))
        except ProgramError:
            return False

    def set_counter(self, place: Place, counter: Reference, number: int) -> None:
        """Set the counter of a FOR to a number, its value in a round of a recorded trace; note an error of the FOR.

        :param place: file and line of the FOR.
        :raises UnknownOrderError: too many statements have run.
        """
        self._count_statement(place)
        try:
            value = Number(float(number), counter.start, counter.stop, is_integer=True)
            self.interpreter.assign(place, counter, value)
        except UnknownOrderError:
            raise
        except ProgramError as cause:
            self._note_fault(place, cause)

    # --- statements --------------------------------------------------------------------------------------------------

    def _follow_statement(self, place: Place, stmt: tree.Statement) -> None:
        """Follow one statement. EXIT sets `Level.is_left`, GOTO `Level.jump_line`: the next statement does not run.

        :param place: file and line of the statement.
        """
        level, word = self.run.level, stmt.word
        if level.is_traced:
            self._go_to_line(place.line)
        self._count_statement(place)
        # where a recorded trace is followed, the rounds of its loops are rows: an EXIT there ends a round
        follows_recorded_trace = level.is_traced and self.recorder is None
        is_in_followed_loop = bool(level.loop_depth) or follows_recorded_trace
        if word == "EXIT" and is_in_followed_loop:
            level.is_left = True
            return
        if word == "GOTO" and self.recorder is not None and level.is_traced:
            self.recorder.record_run_lines(place.line - 1)
            self.recorder.record_passed_lines(place.line)
            self.run.is_final = False
            level.jump_line = place.line
            return
        self._follow_noting_errors(place, stmt)

    def _go_to_line(self, line: int) -> None:
        """Set `Run.row` to the row of the trace with a line (from 1) of the present routine."""
        run = self.run
        if self.recorder is not None and self.recorder.is_final:
            run.shift, run.recorded_line = self.recorder.shift_and_reported_line(line)
        run.row = line + run.shift

    def _follow_noting_errors(self, place: Place, stmt: tree.Statement) -> None:
        """Follow a statement; in a routine of the trace its error is noted, so that later errors are reported too.

        :param place: file and line of the statement.
        :raises UnknownOrderError: the branch taken is not known before run time.
        :raises ProgramError: the statement has an error, and its routine is not traced.
        """
        try:
            self.interpreter.follow_statement(place, stmt)
        except UnknownOrderError:
            raise
        except ProgramError as cause:
            if not self.run.level.is_traced:
                raise
            self._note_fault(place, cause)

    def _count_statement(self, place: Place) -> None:
        """Count a statement that runs: in `_traced_count` in code with motions, else in `run.statement_count`.

        :param place: file and line of the statement, for the message.
        :raises UnknownOrderError: more statements have run than are followed.
        """
        if self._motionless_depth or not self.run.level.is_traced:
            self.run.statement_count += 1
            if self.run.statement_count > MOST_STATEMENTS:
                raise unknown_order_error(place, "too much runs before")
            return
        self._traced_count += 1
        # the limit is above `MOST_TRACED`: a fast first test
        if self._traced_count > MOST_TRACED and self._traced_count > (limit := self._statement_limit(place.source)):
            problem = f"loops around motions are too long: {limit} statements have run when the program comes here"
            raise unknown_order_error(place, problem, _LENGTH_ADVICE)

    def _statement_limit(self, source: Source) -> int:
        """Return the largest number of statements of the trace: the lines of the file or of the trace, and a margin."""
        return MOST_TRACED + (len(source.starts) if self.recorder is not None else len(self.run.trace))

    def _check_statement_count(self, place: Place, minimum: int) -> None:
        """Refuse code that runs too many statements, before it is followed: to follow it would take too long.

        :param place: the loop or the call that runs the code.
        :param minimum: lower bound on the number of statements that the code runs.
        :raises UnknownOrderError: they and the statements that have run exceed the limit.
        """
        if self._motionless_depth or not self.run.level.is_traced:
            if self.run.statement_count + minimum > MOST_STATEMENTS:
                raise unknown_order_error(place, "too much runs before")
        elif self._traced_count + minimum > self._statement_limit(place.source):
            problem = f"loops and calls around motions are too long: at least {minimum} statements run from here on, "
            problem += f"{self._statement_limit(place.source)} are followed"
            raise unknown_order_error(place, problem, _LENGTH_ADVICE)

    def _inline_call(self, place: Place, call: Call) -> bool:
        """Follow the call of a routine with motions or force comments, as part of the execution trace.

        :param place: file and line of the call.
        :returns: False if the call is not part of the trace: no trace is recorded, the routine has neither motions nor
            force comments, the call may not run, an argument moves the robot, or a routine of the program itself cannot
            be followed and is left uncorrected (`--keep-unresolved`).
        :raises UnknownOrderError: the order of the statements of the routine is not known before run time, and the
            routine is not left uncorrected.
        :raises ProgramError: the call has an effect that cannot be followed.
        """
        run, recorder = self.run, self.recorder
        if recorder is None or not run.level.is_traced or not run.is_certain:
            return False
        callee = self.interpreter.calls.traced_callee(call)
        if callee is None or any(self._call_moves(inner) for inner in calls(call.arguments)):
            return False
        _, routine = callee
        self._check_structure(routine)
        self._check_statement_count(place, self._least_statements.minimum_of_call(*callee))
        undo = self._undo_function(recorder)
        try:
            self._record_call(place, call, recorder, *callee)
        except UnknownOrderError:
            if not run.keeps_unresolved or routine.source is not run.routine.source:
                raise
            undo()
            recorder.may_call_originals = True
            return False
        except ProgramError:
            undo()
            raise
        return True

    def _check_structure(self, routine: Routine) -> None:
        """Refuse a routine with a control structure that is not closed properly: no controller loads it.

        :raises UnknownOrderError: there is one.
        """
        try:
            self.run.nodes(routine)
        except ProgramError as cause:
            place = Place(routine.source, cause.line or routine.first)
            raise unknown_order_error(place, cause.problem, cause.advice, routine) from None

    def _call_moves(self, call: Call) -> bool:
        """Return whether the routine of a call, or a routine that this calls, moves the robot."""
        callee = self.interpreter.calls.traced_callee(call)
        return callee is not None and self.run.analysis.effects_of(*callee).motion is not None

    def _undo_function(self, recorder: Recorder) -> Callable[[], None]:
        """Return a function that restores the present findings, position in the program, trace and open calls.

        Values of variables and settings are not restored: to copy all of them for each call would take too long.
        """
        run, entered_calls = self.run, self.interpreter.calls.entered_calls
        counts, recorder_state, position = run.finding_counts(), recorder.state(), run.position()
        call_count, depth = len(entered_calls), len(self._enclosing)

        def undo() -> None:
            """Restore the findings, the position in the program, the trace and the open calls."""
            run.drop_findings(counts)
            recorder.return_to(recorder_state)
            run.return_to(position)
            del entered_calls[call_count:], self._enclosing[depth:]

        return undo

    def _record_call(self, place: Place, call: Call, recorder: Recorder, module: Module, routine: Routine) -> None:
        """Record the call of a routine with motions, follow the statements of the routine, and return to the caller.

        :param place: file and line of the call.
        :param module: the module of the called routine.
        :raises UnknownOrderError: the call cannot be followed exactly.
        """
        run = self.run
        recorder.record_run_lines(place.line - 1)
        recorder.enter_routine(place, (call.start, call.start + len(call.name)), module, routine)
        self.interpreter.calls.enter_routine(place, call, module, routine)
        level = run.level
        self._enclosing.append((place, _NO_ITERATION))
        self.run_called_routine()
        self._enclosing.pop()
        if not level.return_line:  # it has run to its END
            recorder.record_run_lines(routine.last - 1)
        recorder.record_passed_lines(routine.last - 1, is_executed=False)
        self.interpreter.calls.leave_routine()
        recorder.leave_routine()

    # --- control structures ------------------------------------------------------------------------------------------

    def _follow_block(self, source: Source, block: Block) -> None:
        """Follow a control structure.

        With motions or force comments: exactly, as part of the trace. Without: exactly if that is possible; else all
        variables that it may write become unknown.

        :raises UnknownOrderError: it has motions or force comments, and cannot be followed exactly.
        """
        if self.recorder is not None and self.run.level.is_traced and self.belongs_in_trace(source, block):
            self._follow_and_record(source, block, self.recorder)
            return
        counts, open_structures = self.run.finding_counts(), self.run.level.open_structures
        open_count = len(open_structures)
        self._motionless_depth += 1
        try:
            self._follow_exactly(source, block, recorder=None)
        except UnknownOrderError:
            self.run.drop_findings(counts)
            del open_structures[open_count:]  # an EXIT in an IF ends the round before ENDIF closes it
            self.follow_roughly(source, block)
        finally:
            self._motionless_depth -= 1

    def _follow_and_record(self, source: Source, block: Block, recorder: Recorder) -> None:
        """Follow a control structure with motions or force comments, and record it.

        Under `--keep-unresolved` it is left uncorrected if the branch taken is not known before run time.

        :raises UnknownOrderError: without that option, if the branch taken is not known. If the structure has force
            comments and no motions, the error is about these.
        """
        run = self.run
        if not run.keeps_unresolved:
            try:
                self._follow_exactly(source, block, recorder)
            except UnknownOrderError:
                if self._block_moves(source, block):
                    raise
                problem = (
                    f"a force comment is inside {block.word}, whose condition is not known before the program runs"
                )
                raise unknown_order_error(Place(source, block.first), problem, _FORCE_ADVICE) from None
            return
        undo = self._undo_function(recorder)
        try:
            self._follow_exactly(source, block, recorder)
        except UnknownOrderError as cause:
            undo()
            recorder.record_run_lines(block.first - 1)
            recorder.record_unresolved(block.last, cause)
            self.follow_roughly(source, block)

    def follow_roughly(self, source: Source, block: Block) -> None:
        """Mark all variables that a control structure may write as unknown, for any number of iterations.

        Its lines are followed in order, as statements that may not run. A loop is followed twice: variables that become
        unknown in the first round may make others unknown in the second one.
        """
        lines = list(block.lines())
        self._add_to_count(len(lines))
        counts = self.run.finding_counts()
        for _ in range(2 if block.word in LOOPS else 1):
            self.run.drop_findings(counts)  # those of the first round, which the second finds again
            for line in lines:
                if self.run.level.is_traced:
                    self._go_to_line(line)
                self._follow_noting_errors(Place(source, line), statement(source, line))

    def _follow_exactly(self, source: Source, block: Block, recorder: Recorder | None) -> None:
        """Follow the branch of a control structure that is taken, or the rounds of a loop.

        All branches of an IF or SWITCH are followed if it is recorded and the branch taken is not known.

        :param recorder: records the structure; None for a structure without motions.
        :raises UnknownOrderError: the branch taken or the number of rounds is not known, and not all branches are
            followed.
        """
        if block.word in LOOPS:
            self._follow_loop(source, block, recorder)
            return
        try:
            part_index = self._part_taken(source, block)
        except UnknownOrderError as cause:
            fork_visit = ForkVisit(Place(source, block.first), tuple(self._enclosing))
            if recorder is None or fork_visit in self.run.obstacles:  # branches that could not be corrected before
                raise
            self._follow_branches(source, block, recorder, fork_visit, cause)
            return
        part = block.parts[part_index] if part_index >= 0 else None
        if recorder is not None:
            self._follow_recorded_branch(source, block, part, recorder)
        elif part is not None:
            self.follow(source, part.nodes)

    def _follow_recorded_branch(self, source: Source, block: Block, part: Part | None, recorder: Recorder) -> None:
        """Follow the branch of an IF or SWITCH that is taken, and record all lines of the structure.

        The lines of the branch run. The lines that begin the structure and the branch, and the last line, control
        execution. The others do not run.

        :param part: the branch; None if no branch is taken.
        :raises UnknownOrderError: a statement of the branch cannot be followed exactly.
        """
        recorder.record_run_lines(block.first - 1)
        recorder.record_passed_lines(block.first)
        if part is not None:
            recorder.record_passed_lines(part.head - 1, is_executed=False)
            recorder.record_passed_lines(part.head)
            self.follow(source, part.nodes)
            if not self.run.level.is_broken_off:
                recorder.record_run_lines(part.end - 1)
        recorder.record_passed_lines(block.last - 1, is_executed=False)
        recorder.record_passed_lines(block.last)

    def _follow_branches(
        self, source: Source, block: Block, recorder: Recorder, fork_visit: ForkVisit, cause: UnknownOrderError
    ) -> None:
        """Follow all branches of an IF or SWITCH, since the branch taken is not known; each with the values before it.

        :param fork_visit: file and line of the structure, and the present iteration of each loop around it.
        :param cause: the error that the branch taken is not known.
        :raises UnknownOrderError: a branch is left before its end, a condition calls a function that changes something,
            or there are too many forks.
        """
        run, level = self.run, self.run.level
        heads = [part.head for part in block.parts]
        if any(self._may_have_effects(statement(source, head).values) for head in heads):
            raise cause
        self._fork_count += 1
        if self._fork_count > _MOST_FORKS:
            problem = f"branches whose condition is not known are reached more than {_MOST_FORKS} times"
            raise unknown_order_error(Place(source, block.first), problem, _LENGTH_ADVICE)
        recorder.record_run_lines(block.first - 1)
        recorder.record_passed_lines(block.first)
        recorder.record_division(Fork(0, fork_visit))  # 0, also below: the recorder fills in the row
        run.begin_fork()
        branches = block.parts[1:] if block.word == "SWITCH" else block.parts  # part 0 precedes the first CASE
        for part in branches:
            recorder.record_passed_lines(part.head)
            recorder.record_division(Branch(0))
            run.begin_branch()
            self.follow(source, part.nodes)
            if level.jump_line:
                raise unknown_order_error(
                    Place(source, level.jump_line), *undecided_jump_message(run.variables, Place(source, block.first))
                )
            if level.is_broken_off:  # RETURN or EXIT
                raise cause
            recorder.record_run_lines(part.end - 1)
        recorder.record_passed_lines(block.last)
        is_exhaustive = statement(source, heads[-1]).word in ("ELSE", "DEFAULT")
        recorder.record_division(Join(0, is_exhaustive))
        run.join_branches(Place(source, block.last), is_exhaustive=is_exhaustive)

    def _follow_skip(self, source: Source, nodes: tuple[Node, ...], index: int, *, ends_routine: bool) -> int:
        """Follow an IF that skips statements by GOTO or RETURN, as two branches: the jump and the skipped statements.

        :param index: index of the node with the IF.
        :param ends_routine: True if the routine ends after the nodes.
        :returns: the index of the node after the skipped code; 0 if nothing was followed: the node is no such IF, its
            condition is known, or the two branches cannot be followed and are left as they are (`--keep-unresolved`).
        :raises UnknownOrderError: without that option, if a condition in one of the branches is not known.
        """
        run, block, recorder = self.run, nodes[index], self.recorder
        if recorder is None or not isinstance(block, Block) or not self._may_follow_both_branches(source, block):
            return 0
        part = block.parts[0]
        next_index, end = self._jump_target(source, nodes, index, part.nodes[-1:], ends_routine=ends_routine)
        fork_visit = ForkVisit(Place(source, block.first), tuple(self._enclosing))
        if not next_index or self._is_part_known(source, block) or fork_visit in run.obstacles:
            return 0
        undo = self._undo_function(recorder)
        try:
            recorder.record_run_lines(block.first - 1)
            recorder.record_passed_lines(part.head)
            recorder.record_division(Fork(0, fork_visit))  # 0: the row is filled in
            run.begin_fork()
            # one branch: the statements of the IF up to its jump
            self._follow_branch(source, part.nodes[:-1], recorder, ends_routine=False)
            jump = part.nodes[-1]
            recorder.record_run_lines((jump if isinstance(jump, int) else jump.last) - 1)
            recorder.record_passed_lines(block.last)
            # the other branch: the statements that the jump skips
            skips_to_end = end == run.level.routine.last - 1
            self._follow_branch(source, nodes[index + 1 : next_index], recorder, ends_routine=skips_to_end)
            recorder.record_run_lines(end)
            recorder.record_division(Join(0, is_exhaustive=True))
            run.join_branches(Place(source, block.last), is_exhaustive=True)
        except UnknownOrderError:
            if not run.keeps_unresolved:
                raise
            undo()
            return 0
        return next_index

    def _may_follow_both_branches(self, source: Source, block: Block) -> bool:
        """Return whether both branches of a control structure may be followed: one runs its statements, one skips them.

        True for an IF without ELSE that certainly runs, in a recorded routine but in no loop, and whose condition has
        no side effects.
        """
        level = self.run.level
        if not level.is_traced or level.loop_depth or not self.run.is_certain:
            return False
        condition = statement(source, block.first).values
        return block.word == "IF" and len(block.parts) == 1 and not self._may_have_effects(condition)

    def _is_part_known(self, source: Source, block: Block) -> bool:
        """Return whether it is known which branch of an IF or SWITCH is taken.

        :raises ProgramError: a CASE cannot be read.
        """
        try:
            self._part_taken(source, block)
        except UnknownOrderError:
            return False
        return True

    def _follow_branch(
        self, source: Source, nodes: tuple[Node, ...], recorder: Recorder, *, ends_routine: bool
    ) -> None:
        """Follow one of the branches of an IF that skips statements.

        :param ends_routine: True if the routine ends after the branch.
        :raises UnknownOrderError: the branch is left before its end.
        """
        level = self.run.level
        recorder.record_division(Branch(0))  # 0: the row is filled in
        self.run.begin_branch()
        self.follow(source, nodes, ends_routine=ends_routine)
        if level.is_broken_off:  # by a GOTO or a RETURN
            raise unknown_order_error(
                Place(source, level.jump_line or level.return_line), *undecided_jump_message(self.run.variables, None)
            )

    def _jump_target(
        self, source: Source, nodes: tuple[Node, ...], index: int, jump: tuple[Node, ...], *, ends_routine: bool
    ) -> tuple[int, int]:
        """Return the index of the node after the code that a GOTO or RETURN skips, and the last skipped line.

        GOTO: the code up to its label, which must be one of the later nodes. RETURN without a value: the code up to the
        end of a called routine.

        :param index: index of the node with the IF that jumps.
        :param jump: the last node of this IF; empty if the IF is empty.
        :param ends_routine: True if the routine ends after the nodes.
        :returns: 0 and 0 if the last node is no such jump, or the label is not among the later nodes.
        """
        if not jump or not isinstance(jump[0], int):
            return 0, 0
        stmt = statement(source, jump[0])
        if isinstance(stmt, tree.Return) and stmt.value is None:
            is_skip = ends_routine and len(self.run.stack) > 1
            return (len(nodes), self.run.level.routine.last - 1) if is_skip else (0, 0)  # up to the line before END
        if not isinstance(stmt, tree.Goto):
            return 0, 0
        label = self.label_of(source, jump[0])
        for number in range(index + 1, len(nodes)):
            line = nodes[number]
            if isinstance(line, int) and label in self.labels(source, [line]):
                return number + 1, line
        return 0, 0

    def _may_have_effects(self, values: Iterable[Value]) -> bool:
        """Return whether some expressions contain calls that may do more than give a value."""
        return not all(map(self.run.variables.functions.is_pure, calls(values)))

    def _part_taken(self, source: Source, block: Block) -> int:
        """Return the index of the part of an IF or SWITCH that runs; −1 if none does.

        IF: part 0 is that of THEN, part 1 that of ELSE. SWITCH: part 0 precedes the first CASE.

        :raises UnknownOrderError: the condition, or the value of the SWITCH, is not known before run time, or calls a
            function that changes something.
        :raises ProgramError: a CASE cannot be read.
        """
        place, stmt = Place(source, block.first), statement(source, block.first)
        self.run.statement_place = place
        if isinstance(stmt, tree.If):
            holds = self.run.variables.truth(stmt.condition)
            if holds is None:
                raise undecided_error(self.run, place)
            if holds:
                return 0
            has_else = len(block.parts) > 1
            return 1 if has_else else -1
        if not isinstance(stmt, tree.Switch) or self._may_have_effects(stmt.values):
            raise undecided_error(self.run, place)
        selector = self.run.variables.evaluate(stmt.value)
        self._add_to_count(len(block.parts) // _CASES_PER_STATEMENT)
        if block not in self._case_tables:
            self._case_tables[block] = constant_cases([statement(source, part.head) for part in block.parts[1:]])
        table = self._case_tables[block]
        if isinstance(selector, Number) and selector.is_integer and table is not None:
            case_index = table.get(selector.value, table[None])
            return -1 if case_index == NO_CASE else 1 + case_index  # the table begins with part 1
        return self._chosen_part(source, block, selector)

    def _chosen_part(self, source: Source, block: Block, selector: VariableValue) -> int:
        """Return the index of the part of a SWITCH that runs for a value; −1 if none does.

        Part 0 is the SWITCH itself; each later part begins with CASE or DEFAULT.

        :param selector: value of the SWITCH.
        :raises UnknownOrderError: it is not known before run time whether the value equals that of a CASE.
        :raises ProgramError: a CASE cannot be read.
        """
        for index, part in enumerate(block.parts[1:], 1):
            case = statement(source, part.head)
            if isinstance(case, tree.FaultyStatement):
                raise case.error
            values = case.cases if isinstance(case, tree.Case) else ()
            is_chosen = case.word == "DEFAULT" or self.run.variables.is_chosen_case(selector, values)
            if is_chosen is None:
                raise undecided_error(self.run, Place(source, block.first))
            if is_chosen:
                return index
        return -1

    def _add_to_count(self, count: int) -> None:
        """Add to the number of statements that have run: `_traced_count` in code with motions, else that of `run`.

        Nothing is refused here: the next statement checks the limits.
        """
        if self._motionless_depth or not self.run.level.is_traced:
            self.run.statement_count += count
        else:
            self._traced_count += count

    def _follow_loop(self, source: Source, block: Block, recorder: Recorder | None) -> None:
        """Follow the rounds of a loop, and record them if the loop contains motions or force comments.

        :param recorder: records the trace; None for a loop without them.
        :raises UnknownOrderError: the number of rounds is not known, or too large.
        """
        level = self.run.level
        words = {statement(source, line).word for line in block.lines()}  # first words of the statements
        if block.word == "LOOP" and words.isdisjoint(ENDS_LOOPS):
            self._follow_endless(source, block, recorder)
            return
        counter = Counter(self.run, source, block.first) if block.word == "FOR" else None
        if recorder is not None:
            self._check_comments(source, block)
        name, step = (counter.name, counter.step) if counter is not None else ("", 0)
        if counter is not None and words.isdisjoint(ENDS_LOOPS):
            self._check_rounds(source, block, counter, recorder)
        loop = recorder.begin_loop(block, name, step, has_exit="EXIT" in words) if recorder is not None else None
        level.loop_depth += 1
        depth = len(self._enclosing)
        self._enclosing.append((Place(source, block.first), _NO_ITERATION))
        try:
            if counter is not None and recorder is not None and loop is not None:
                self._record_plain_rounds(source, block, counter, recorder, loop)
            self._follow_rounds(source, block, counter, recorder, loop)
        finally:
            level.loop_depth -= 1
            del self._enclosing[depth:]
        has_ended = counter is not None and not level.is_broken_off
        level.is_left = False
        if recorder is not None and loop is not None:
            recorder.end_loop(loop, block, counter.value() if counter is not None and has_ended else None)

    def _follow_rounds(
        self,
        source: Source,
        block: Block,
        counter: Counter | None,
        recorder: Recorder | None,
        loop: UnrolledLoop | None,
        *,
        back_jump: Block | None = None,
    ) -> None:
        """Follow the rounds of a loop one by one, and record them.

        :param counter: the counter of FOR; None for another loop.
        :param loop: the record of the loop in the trace; None without a recorder.
        :param back_jump: the IF that jumps back to the label on the first line of `block`; None for LOOP, FOR, WHILE
            and REPEAT.
        :raises UnknownOrderError: there are too many rounds, the loop never ends, a condition is not known before run
            time, or a label would be recorded more than once.
        """
        level, head = self.run.level, Place(source, block.first)
        condition_place = head if back_jump is None else Place(source, back_jump.first)
        start_count, depth, iteration = self._traced_count, len(self._enclosing) - 1, 0
        while self._runs_again(source, block, counter):
            self._count_statement(condition_place)
            iteration += 1
            self._enclosing[depth] = head, iteration
            if recorder is not None and iteration == 2:  # one round alone is written once
                self._check_labels(source, block)
            counts_at_begin = self._change_counts()
            if counter is None and self._traced_count - start_count > MOST_UNCOUNTED:
                subject = f"{block.word} has not ended" if back_jump is None else "GOTO still leads back"
                problem = f"{subject} after {MOST_UNCOUNTED} statements"
                raise unknown_order_error(condition_place, problem, "Check its condition, or write FOR instead.")
            if recorder is not None and loop is not None:
                recorder.begin_round(loop, block, counter.value() if counter is not None else None)
            self.follow(source, block.parts[0].nodes)
            is_whole = not level.is_broken_off
            if recorder is not None:
                recorder.end_round(block, is_whole=is_whole)
            if not is_whole or self._ends_after_round(source, block, back_jump):
                break
            if counter is not None:
                counter.advance()
            elif self._change_counts() == counts_at_begin:  # all further rounds would be equal
                problem = (
                    f"{block.word} never ends: no variable of its condition changes from round to round"
                    if back_jump is None
                    else "GOTO always leads back: no variable of its condition changes"
                )
                raise unknown_order_error(condition_place, problem, LOOP_ADVICE)

    def _follow_back_jump(self, source: Source, nodes: tuple[Node, ...], index: int, label: tree.Label) -> int:
        """Follow the rounds between a label and an IF that jumps back to the label.

        :param index: index of the node with the label.
        :returns: the index of the node with the IF; 0 if nothing was followed: there is no such IF, or the rounds are
            left as they are since they cannot be followed (`--keep-unresolved`).
        :raises UnknownOrderError: without that option, if the condition of the IF is not known before run time.
        """
        if_index, recorder = self._back_jump_index(source, nodes, index, label), self.recorder
        if not if_index or recorder is None:
            return 0
        run, undo = self.run, self._undo_function(recorder)
        values, state = run.variables.snapshot(), run.settings.state
        run.is_final = False
        try:
            self._follow_label_rounds(source, nodes[index : if_index + 1], recorder)
        except UnknownOrderError:
            if not run.keeps_unresolved:
                raise
            undo()
            run.variables.restore(values)  # the statements of the first round are followed again, by the caller
            run.settings.change_state(run.row, state)
            return 0
        return if_index

    def _back_jump_index(self, source: Source, nodes: tuple[Node, ...], index: int, label: tree.Label) -> int:
        """Return the index of the IF that does nothing but jump back to a label; 0 if there is none.

        No other GOTO may lead to the label: corrected rounds may be written one after the other, without the label. The
        label must not be in a loop or in a structure that may not run.

        :param index: index of the node with the label.
        """
        level = self.run.level
        if self.recorder is None or not level.is_traced or level.loop_depth or not self.run.is_certain:
            return 0
        jumps = [line for line in level.routine.statement_lines if self.label_of(source, line) == label.name]
        if len(jumps) != 1:
            return 0
        for number, block in enumerate(nodes[index + 1 :], start=index + 1):
            # an IF with one part, which holds the GOTO alone
            if isinstance(block, Block) and block.word == "IF" and [part.nodes for part in block.parts] == [(*jumps,)]:
                return number
        return 0

    def _follow_label_rounds(self, source: Source, nodes: tuple[Node, ...], recorder: Recorder) -> None:
        """Follow the statements between a label and the IF that jumps back to it, as the rounds of a REPEAT.

        :param nodes: the label, the statements, the IF.
        :raises UnknownOrderError: the condition is not known before run time, there are too many rounds, the rounds
            never end, or a label would be recorded more than once.
        """
        level, label_line, back_jump = self.run.level, nodes[0], nodes[-1]
        if not isinstance(label_line, int) or not isinstance(back_jump, Block):  # never so: the label is a line
            return
        # the loop ends with ENDIF, a round on the line before the IF
        loop_block = Block("REPEAT", label_line, back_jump.last, (Part(label_line, back_jump.first, nodes[1:-1]),))
        round_block = Block("REPEAT", label_line, back_jump.first, loop_block.parts)
        self._check_comments(source, loop_block, range(back_jump.first, back_jump.last))
        loop = recorder.begin_loop(loop_block, counter="", step=0, has_exit=False, closing=back_jump.first)
        depth = len(self._enclosing)
        level.loop_depth += 1
        self._enclosing.append((Place(source, label_line), _NO_ITERATION))
        try:
            self._follow_rounds(source, round_block, None, recorder, loop, back_jump=back_jump)
        finally:
            level.loop_depth -= 1
            del self._enclosing[depth:]
        recorder.end_loop(loop, loop_block, None)

    def _ends_after_round(self, source: Source, block: Block, back_jump: Block | None) -> bool:
        """Return whether a loop ends by its condition after a round: REPEAT, or an IF that jumps back to a label.

        False for FOR, WHILE and LOOP, which do not end there.

        :param back_jump: the IF; None for LOOP, FOR, WHILE and REPEAT.
        :raises UnknownOrderError: the condition is not known before run time.
        """
        if back_jump is not None:
            return not self._jumps_back(source, back_jump)
        return block.word == "REPEAT" and self._condition_holds(source, block.last)

    def _jumps_back(self, source: Source, jump: Block) -> bool:
        """Return whether the condition of an IF holds.

        :param jump: the IF, which does nothing but jump back to a label.
        :raises UnknownOrderError: the condition is not known before run time.
        """
        place, head = Place(source, jump.first), statement(source, jump.first)
        self.run.statement_place = place
        holds = self.run.variables.truth(head.condition) if isinstance(head, tree.If) else None
        if holds is None:
            # on the line of the GOTO, before ENDIF
            raise unknown_order_error(Place(source, jump.last - 1), *undecided_jump_message(self.run.variables, place))
        return holds

    def _check_labels(self, source: Source, block: Block) -> None:
        """Refuse labels inside a loop around motions, which begins its second round.

        Corrected rounds may be written one after the other, and a routine cannot have a label twice.

        :param block: the loop. It may also be the lines between a label and an IF that jumps back to it: that label, on
            the first line, does not count, since it is before the rounds.
        :raises UnknownOrderError: there is a label.
        """
        for line in block.lines():
            if line != block.first and isinstance(statement(source, line), tree.Label):
                raise unknown_order_error(Place(source, line), "a label is in a loop around motions", _LABEL_ADVICE)

    def _check_comments(self, source: Source, block: Block, closing: Iterable[int] = ()) -> None:
        """Refuse force comments on the lines that begin and end a loop: it is not clear in which rounds they act.

        :param closing: lines that close the loop in addition to its last line.
        :raises ProgramError: there is a comment.
        """
        comment_lines = self.run.analysis.force_comment_lines(source)  # ascending
        for line in (block.first, *closing, block.last):
            index = bisect_left(comment_lines, line)  # of the first comment on this line or behind it
            if line in comment_lines[index : index + 1]:
                problem = f"a force comment is on the line of {statement(source, line).word}"
                raise Place(source, line).error(problem, "Write it on a line of its own, in the loop or behind it.")

    def _change_counts(self) -> tuple[int, int]:
        """Return how often values of variables, and how often settings of motions, have changed so far."""
        return self.run.variables.change_count, len(self.run.settings.changes)

    def _record_plain_rounds(
        self, source: Source, block: Block, counter: Counter, recorder: Recorder, loop: UnrolledLoop
    ) -> None:
        """Record all rounds of a FOR at once if its body is plain and there are enough of them; else do nothing.

        :param counter: the counter, at its first value; afterwards it has passed its last.
        :param loop: the record of the loop in the trace.
        """
        if block not in self._plain_bodies:
            self._plain_bodies[block] = plain_body(source, block) or computed_body(source, block)
        body, begin, rounds = self._plain_bodies[block], counter.value(), counter.round_count
        statement_count = rounds * (1 + len(block.parts[0].nodes))
        if body is None or not rounds or self._traced_count + statement_count > self._statement_limit(source):
            return
        if body.is_computed and rounds < FEWEST_ROUNDS:
            return
        self._traced_count += statement_count
        plain_rounds = PlainRounds(
            begin=begin,
            step=counter.step,
            first=recorder.row_count + 1,
            count=rounds,
            length=block.last - block.first,  # the assignment to the counter, and the lines between head and ENDFOR
            source=source,
            head=block.first,
            body=body,
        )
        recorder.record_plain_rounds(loop, block, plain_rounds)
        for line in body.triggers:  # what they write may change at any time from now on
            self._follow_noting_errors(Place(source, line), statement(source, line))
        # assignments of the first and the last round are run: the last one leaves the values
        for round_count in (rounds - 1, 1):
            for line in body.assignments:
                self._follow_noting_errors(Place(source, line), statement(source, line))
            counter.skip(round_count)

    def _follow_endless(self, source: Source, block: Block, recorder: Recorder | None) -> None:
        """Follow one iteration of a LOOP without EXIT, in place of all; what is behind it never runs.

        `joins` checks later that the iteration ends in the pose and with the settings with which it began.

        :param recorder: records the trace; None for a LOOP without motions, which is refused.
        :raises UnknownOrderError: the LOOP is in another loop, a branch or a called routine, or an iteration changes a
            variable that the next one may use.
        """
        run, level, place = self.run, self.run.level, Place(source, block.first)
        if recorder is None or level.loop_depth or run.is_forked or not run.is_certain or len(run.stack) > 1:
            raise unknown_order_error(place, "LOOP never ends: there is no EXIT", LOOP_ADVICE)
        self._check_comments(source, block)
        run.is_final = False
        snapshot = run.variables.snapshot()
        loop = recorder.begin_loop(block, counter="", step=0, has_exit=False)
        loop.is_endless = True
        self._enclosing.append((place, 1))  # the first and only iteration
        recorder.begin_round(loop, block, None)
        self.follow(source, block.parts[0].nodes)
        recorder.end_round(block, is_whole=True)
        recorder.end_loop(loop, block, None)
        self._enclosing.pop()
        if names := carried_variables(run, source, block, snapshot):
            # variables of the program before those of the controller
            sorted_names = sorted(names, key=lambda name: (name[0] == "$", name))
            changed_names = first_of([*map(shown_name, sorted_names)], _MOST_NAMES)
            problem = f"LOOP never ends, and its rounds differ: each one changes {changed_names} for the next"
            raise unknown_order_error(place, problem, "Set it at the beginning of each round.")
        level.return_line = block.last

    def _check_rounds(self, source: Source, block: Block, counter: Counter, recorder: Recorder | None) -> None:
        """Refuse a FOR that runs too many iterations or statements, before it is followed.

        :param recorder: records the trace; None for a FOR without motions.
        :raises UnknownOrderError: it runs too many.
        """
        limit = MOST_STATEMENTS if recorder is None else MOST_TRACED + len(source.starts)
        if counter.round_count > limit:
            problem = f"FOR has {counter.round_count} rounds, more than {limit}"
            raise unknown_order_error(Place(source, block.first), problem, "Check its bounds.")
        module = self.run.level.module
        # of nested loops the outermost one is counted, with the rounds of those inside it
        if not self.run.level.loop_depth and not self._least_statements.may_write_counter(
            source, block, counter.statement.name, module
        ):
            minimum = counter.round_count * self._least_statements.minimum_of_round(source, block, module)
            self._check_statement_count(Place(source, block.first), minimum)

    def _runs_again(self, source: Source, block: Block, counter: Counter | None) -> bool:
        """Return whether a loop runs its body once more, by its counter or the condition of WHILE; LOOP, REPEAT: True.

        :param counter: the counter of FOR; None for other loops.
        :raises UnknownOrderError: the counter or the condition is not known before run time.
        """
        if counter is not None:
            return counter.has_next_round()
        return block.word != "WHILE" or self._condition_holds(source, block.first)

    def _condition_holds(self, source: Source, line: int) -> bool:
        """Return whether the condition of WHILE or UNTIL on a line holds.

        :raises UnknownOrderError: the condition is not known before run time.
        """
        stmt, holds = statement(source, line), None
        self.run.statement_place = Place(source, line)
        if isinstance(stmt, tree.While):
            holds = self.run.variables.truth(stmt.condition)
        if holds is None:
            raise undecided_error(self.run, Place(source, line))
        return holds
