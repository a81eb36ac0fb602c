"""Execution of a RAPID module: its motions in execution order, with the values of data at that time.

A value is used only if it is certain before the program runs. Loops and conditions are followed if all their values are
known. If the branch taken is not known, no branch may move the robot or change how it moves, and data that a branch
changes become unknown. Data become unknown

- for the whole program if routines change them that are not followed: traps, error handlers, uncalled procedures;
- behind the call of a function that changes them;
- behind the call of a routine of another file, if they are not LOCAL. Such a routine is assumed not to move the robot,
  unless one of its arguments is a target.

What instructions do: ABB, Technical reference manual, RAPID Instructions, Functions and Data types (3HAC16581).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from itertools import zip_longest
from typing import NoReturn, TypeGuard

from msgspec import Struct, field
from msgspec.structs import replace

from postproc.dialects.changed_data import Difference, FollowedRun, later_difference
from postproc.dialects.rapid.effects import BoundArgument, Effects, bound_arguments, called_names, results
from postproc.dialects.rapid.instructions import (
    CONSTANT,
    COUNTING,
    MOVES,
    READING,
    SETTINGS,
    STOPPING,
    is_unfollowed_motion,
)
from postproc.dialects.rapid.loaded import LoadedModules, name_clash, named_like_rapid
from postproc.dialects.rapid.moves import Move, Setting, are_equal, stated_move
from postproc.dialects.rapid.syntax import (
    Assignment,
    Comment,
    Conditional,
    Declaration,
    Expression,
    Instruction,
    Jump,
    Loop,
    Module,
    Parameter,
    Routine,
    Statement,
    all_statements,
    calls,
)
from postproc.dialects.rapid.values import (
    SINGLE_PRECISION_TOLERANCE,
    Scope,
    UnknownValueError,
    Value,
    Variable,
    assign,
    base_name,
    changed_arguments,
    evaluate,
    number,
    predefined_data,
    truth,
)
from postproc.dialects.waits import RAPID_WAITS
from postproc.errors import MAX_ERRORS, PostprocError, first_of
from postproc.program import FORCE_COMMENT, PTP

MOST_STATEMENTS = 3_000_000
"""Largest number of executed statements: three times those of 10⁶ motions; more count as an endless program."""
_MOST_ELEMENTS = 100_000
"""Most elements of an array without initial value that is followed (assumed)."""
_MAX_CALL_DEPTH = 60
"""Largest number of nested calls; more count as endless recursion. Each call needs several frames of Python."""


class RapidError(PostprocError):
    """A statement cannot be followed.

    :ivar start: offset of the statement in the text.
    :ivar line: its line in the file; 0 until `set_line`.
    :ivar advice: what the user can do; may be empty.
    """

    def __init__(self, problem: str, start: int, advice: str = "") -> None:
        super().__init__(problem)
        self.problem, self.start, self.advice, self.line = problem, start, advice, 0

    def set_line(self, line: int) -> RapidError:
        """Set the line of the error, and return the error itself."""
        self.line = line
        return self


_LATE_CALLS = ("%", "CALLBYVAR")
"""Instructions that call a routine whose name is computed at run time."""
_MOVE_SETTINGS = "the settings of moves"
"""Stands for the settings among the names of data that a round changes."""
_MOST_NAMES = 5
"""Most names in one message."""
MOST_ROUNDS = 10_000
"""Largest number of rounds of a loop without moves that are followed (assumed)."""
_KEEP = "Leave it out, or convert the G-code or APT of this part."
_NUMBERS = "Give the data as numbers in this file, or name the module that has them in [rapid] modules of the cell."
_COPIED = (
    "opy the routine to this file, or name its module in [rapid] modules of the cell. If it neither moves the robot "
    "nor changes data of this file, name it in [rapid] without_effect."
)
_FOREIGN = f"C{_COPIED}"
_OPEN_DATA = f"Declare the data LOCAL or CONST, or c{_COPIED}"
_TARGET_FUNCTIONS = ("OFFS", "RELTOOL", "CALCROBT", "CALCJOINTT", "CROBT", "CJOINTT", "MIRPOS", "OROBT")
"""Functions that return a target."""


class EndlessLoop(Struct, frozen=True):
    """A loop without end, of which one round is executed.

    :ivar start: offset of the loop.
    :ivar move_count: number of moves before it.
    :ivar note_count: number of comments before it.
    """

    start: int
    move_count: int
    note_count: int


class RunBegin(Struct, frozen=True):
    """The begin of a run from the start of the program, after another run.

    :ivar start: offset of its procedure.
    :ivar move_count: number of moves before it; the next one is the motion to the start.
    :ivar note_count: number of comments before it.
    """

    start: int
    move_count: int
    note_count: int


class ExecutedProgram(Struct, eq=False):
    """Result of the execution of a program.

    :ivar moves: motions in execution order.
    :ivar notes: each comment with the index in `moves` of the motion in whose line it is, or else of the one that
        follows.
    :ivar waits: offset of each statement at which the robot waits, and the number of moves before it.
    :ivar rounds: offset of a loop with motions → its runs. A run is the loop and, for each round, the value of the
        variable of FOR, or the number of the round of WHILE.
    :ivar calls: name of a routine with motions → its calls, in execution order.
    :ivar unknown_calls: called routines that are in no module: name → (offset of the first call, number of calls).
    :ivar errors: statements that cannot be followed.
    :ivar followed_names: names of the routines that run.
    :ivar cell_data: tools and work objects that are taken from the cell: name → type.
    :ivar endless_loop: the loop without end in which the program stays; None if it ends.
    :ivar begins: begins of further runs, if several procedures are each a run of their own.
    """

    moves: list[Move] = field(default_factory=list)
    notes: list[tuple[Comment, int]] = field(default_factory=list)
    waits: list[tuple[int, int]] = field(default_factory=list)
    rounds: dict[int, list[tuple[Loop, list[float]]]] = field(default_factory=dict)
    calls: dict[str, list[Instruction]] = field(default_factory=dict)
    unknown_calls: dict[str, tuple[int, int]] = field(default_factory=dict)
    errors: list[RapidError] = field(default_factory=list)
    followed_names: set[str] = field(default_factory=set)
    cell_data: dict[str, str] = field(default_factory=dict)
    endless_loop: EndlessLoop | None = None
    begins: list[RunBegin] = field(default_factory=list)


def first_difference(first: ExecutedProgram, later: ExecutedProgram) -> int | None:
    """Return the offset of the first statement at which a later run differs from the first; None if they are equal.

    An error of the later run counts as a difference.
    """
    if later.errors:
        return later.errors[0].start
    for move, later_move in zip_longest(first.moves, later.moves):
        if move is None or later_move is None:  # one of the runs is shorter
            return int((move or later_move).statement.start)
        if not are_equal(move, later_move):
            return int(move.statement.start)
    for note, later_note in zip_longest(first.notes, later.notes):
        if note is None or later_note is None:
            comment, _ = note or later_note
            return int(comment.start)
        (comment, move_index), (later_comment, later_index) = note, later_note
        if (comment.start, move_index) != (later_comment.start, later_index):
            return int(comment.start)
    return None


def setting_after(statement: Instruction, setting: Setting, scope: Scope) -> Setting | None:
    """Return the settings of moves after an instruction: ConfJ, SingArea, CirPathMode or VelSet; ConfL has no effect.

    None if the speeds of VelSet are not known.

    :param setting: settings before it.
    :param scope: data at this time.
    """
    switches = {argument.name for argument in statement.arguments if argument.name}
    match statement.name:
        case "CONFJ":
            return replace(setting, follows_configuration="ON" in switches)
        case "SINGAREA":
            return replace(setting, singularity_mode=next(iter(switches), "OFF"))
        case "CIRPATHMODE":
            return replace(setting, circle_mode=next(iter(switches), "PATHFRAME"))
        case "VELSET":
            try:
                percent, limit = (
                    number(argument.value, scope) for argument in statement.arguments if argument.value is not None
                )
            except (UnknownValueError, ValueError):  # ValueError: not two arguments
                return None
            return replace(setting, speed_share=percent / 100.0, speed_limit=limit)
    return setting


class _Return(Exception):  # noqa: N818 - no error: the end of a routine
    """The routine returns."""


class _End(Exception):  # noqa: N818 - no error
    """The program stays in a loop that does not end: statements behind it never run."""


class Execution:
    """Execution of a program.

    In all methods, `scope` is the scope of the executed routine, and `depth` is the number of calls around it.

    :param modules: modules of the file.
    :param entry: routine that is run.
    :param cell_value: returns the value of a tool or work object of the cell by its name and type; None if it has none.
    :param without_effect: see `Effects`.
    :param loaded: modules of other files, whose data are read, but whose routines are not executed.
    :raises RapidError: two modules declare one name, or a routine is named like an instruction or function of RAPID.
    :ivar data: name → data of the modules, with their present values.
    :ivar result: the moves so far, and further results.
    :ivar setting: settings of moves that are active.
    """

    def __init__(
        self,
        modules: Iterable[Module],
        entry: Routine,
        cell_value: Callable[[str, str], Value | None],
        without_effect: Iterable[str],
        loaded: LoadedModules,
    ) -> None:
        self.modules, self.entry, self.cell_value = tuple(modules), entry, cell_value  # also for `next_run`
        self.without_effect, self.loaded = tuple(without_effect), loaded
        all_modules = (*loaded.modules, *self.modules)
        self.effects = Effects(all_modules, self.without_effect)
        self.routines = {routine.name: routine for module in self.modules for routine in module.routines}
        self.data: dict[str, Variable] = {
            name: Variable(type_, value) for name, (value, type_) in predefined_data().items()
        }
        _check_names(all_modules)
        _check_functions(self.modules)
        self.data |= {name: replace(variable) for name, variable in loaded.data.items()}
        for module in self.modules:
            for declaration in module.data:
                self.data[declaration.name] = _initial_variable(declaration)
        self.result = ExecutedProgram()
        self.setting = Setting()
        self.statement_count = 0
        self._moving: dict[str, bool] = {}
        self._checked_functions: set[str] = set()
        reachable_names = self._reachable_routines(entry)
        for routine in self.effects.routines.values():
            is_followed = routine.name in reachable_names or routine.kind == "FUNC"  # functions count at their calls
            for name in self.effects.changed_by_handler(routine):
                _interrupt_variable(self.data.get(name), f"the handler of {routine.name}")
            if routine.kind == "TRAP":
                for name in self.effects.changed_data_of(routine.name):
                    _interrupt_variable(self.data.get(name), routine.name)
            if not is_followed:  # changes by other files before the start of the program are not known in any case
                for name in self.effects.changed_data_of(routine.name, includes_foreign_changes=False):
                    _forget_variable(self.data.get(name), f"{routine.name} may change it, which is not followed")
        for variable in self.data.values():
            variable.start_run()

    def run(self) -> ExecutedProgram:
        """Execute the program from its entry, and return the result.

        :raises RapidError: a value or branch that motion depends on is not known, or there are too many errors.
        """
        scope = Scope(self.data)
        try:
            self._execute_routine(self.entry, scope, 0)
        except _End:  # in a loop that does not end: the result is complete
            pass
        except RecursionError:
            raise RapidError("calls and loops are nested too deeply", self.entry.start, _KEEP) from None
        return self.result

    def changed_names(self) -> list[str]:
        """Return the names of data whose changes the next run may notice: it uses the value that this run leaves."""
        return [
            name
            for name, variable in self.data.items()
            if variable.is_used
            and (final_data := variable.at_next_run()).is_changed
            and final_data.value != final_data.start_value
        ]

    def next_run(self, unknown_names: Set[str]) -> Execution:
        """Return an execution of the program that begins with the data that this one leaves.

        Data that are unknown from the beginning, such as those of traps, remain unknown.

        :param unknown_names: names of data that are unknown at its beginning.
        """
        execution = Execution(self.modules, self.entry, self.cell_value, self.without_effect, self.loaded)
        for name, variable in self.data.items():
            final_data = variable.at_next_run()
            # also what an earlier run has changed, and this one has not; data with a reason are unknown in all runs
            is_unknown = name in execution.data and execution.data[name].unknown_reason != ""
            if name in execution.data and not final_data.has_declared_value and not is_unknown:
                if name in unknown_names:
                    final_data.forget("an earlier run may have changed it")
                final_data.start_run()
                execution.data[name] = final_data
        return execution

    # --- statements that are not followed

    def _reachable_routines(self, entry: Routine) -> set[str]:
        """Return the names of the entry and of all procedures of the file that it may call, directly or indirectly."""
        names, unvisited_routines = {entry.name}, [entry]
        while unvisited_routines:
            for statement in all_statements(unvisited_routines.pop().body):
                if isinstance(statement, Instruction):
                    name = statement.name.removeprefix("%")
                    if name in self.routines and name not in names:
                        names.add(name)
                        unvisited_routines.append(self.routines[name])
        return names

    def _forget(self, statements: tuple[Statement, ...], reason: str, scope: Scope) -> None:
        """Make data unknown (they have no known value any more) that statements, and routines called there, may change.

        :param reason: reason for the message if the data are used later.
        """
        for name in self.effects.changed_names(statements):
            _forget_variable(scope.find(name), reason)
        for name in called_names(statements):
            self._forget_data_of(name, reason)

    def _forget_results_of_functions(self, statement: Statement, scope: Scope) -> None:
        """Make data unknown that the functions called in a statement may change; count calls of other files.

        :raises RapidError: a function moves the robot, or has a force comment.
        """
        for call in calls(statement):
            function = self.effects.routines.get(call.value)
            if function is not None:
                self._check_function(function, statement)
            elif self.effects.is_foreign(call.value):
                self._list_foreign_call(call.value, statement)
            for name in self.effects.changed_arguments(call.value, call.items):
                _forget_variable(scope.find(name), f"{call.value} may change it")
            self._forget_data_of(call.value, self._change_reason(call.value))

    def _check_function(self, function: Routine, statement: Statement) -> None:
        """Check that a function does not move the robot and has no force comments; the result is stored.

        :param statement: statement that calls it.
        :raises RapidError: it moves the robot, or has a force comment.
        """
        if function.name in self._checked_functions:
            return
        if self._routine_moves(function):
            problem = f"the function {function.name} moves the robot, which is not followed"
            raise RapidError(problem, statement.start, "Write a procedure in its place.")
        if function.name in self.routines:
            self._check_forces(function.body, f"{function.name} is a function")
        self._checked_functions.add(function.name)

    def _check_forces(self, statements: tuple[Statement, ...], reason: str) -> None:
        """Check that statements that are not followed, and the routines that they call, have no force comments.

        :param reason: reason why they are not followed, for the message.
        :raises RapidError: there is a force comment: it is not known whether the force acts.
        """
        blocks, names = [statements], set[str]()
        while blocks:
            block = blocks.pop()
            for statement in all_statements(block):
                if isinstance(statement, Comment) and FORCE_COMMENT.match(statement.text):
                    problem = f"it is not known whether this force acts: {reason}"
                    raise RapidError(problem, statement.start, "Put the comment before the move on which it acts.")
            new_names = (called_names(block) & self.routines.keys()) - names
            names |= new_names
            blocks += [self.routines[name].body for name in new_names]

    def _change_reason(self, name: str) -> str:
        """Return the reason why data are not known that an instruction, function or routine may change by itself."""
        place = ", which is in no module of this file," if self.effects.is_foreign(name) else ""
        return f"{name}{place} may change it"

    def _forget_data_of(self, name: str, reason: str) -> None:
        """Make module data unknown that an instruction, function or routine may change by itself.

        Routines of other files are assumed to leave data as they are from one run to the next.

        :param reason: reason for the message if the data are used later.
        """
        data_names = self.effects.changed_data_of(name)
        if not data_names:
            return
        changed_names = self.effects.changed_data_of(name, includes_foreign_changes=False)
        for data_name in data_names:
            _forget_variable(self.data.get(data_name), reason, by_foreign_call=data_name not in changed_names)

    def _list_foreign_call(self, name: str, statement: Statement) -> None:
        """Count a call of a routine that is in no module of the file; the offset of the first call is kept."""
        start, count = self.result.unknown_calls.get(name, (statement.start, 0))
        self.result.unknown_calls[name] = start, count + 1

    def _is_foreign_move(self, statement: Instruction) -> bool:
        """Return whether an instruction calls a routine of another file with a target, to which it may move."""
        if not self.effects.is_foreign(statement.name.removeprefix("%")):
            return False
        for argument in statement.arguments:
            expression = argument.value
            if expression is None:
                continue
            if expression.kind == "numbers" or (expression.kind == "call" and expression.value in _TARGET_FUNCTIONS):
                return True
            variable = self.data.get(base_name(expression)) if expression.kind in ("name", "index") else None
            if variable is not None and variable.type in ("ROBTARGET", "JOINTTARGET"):
                return True
        return False

    def first_moving_instruction(self, statements: tuple[Statement, ...]) -> Instruction | None:
        """Return the first instruction among statements that moves the robot or changes how it moves; None without one.

        Calls of routines that move, calls by a computed name and calls of other files with a target count. For a
        function that moves, the result is an instruction with its name.
        """
        for statement in all_statements(statements):
            for call in calls(statement):
                function = self.effects.routines.get(call.value)
                if function is not None and self._routine_moves(function):
                    return Instruction(statement.start, statement.stop, function.name, ())
            if not isinstance(statement, Instruction):
                continue
            if statement.name in _LATE_CALLS:
                return statement
            name = statement.name.removeprefix("%")
            routine = self.effects.routines.get(name)
            if routine is None:
                if name in MOVES or name in SETTINGS or is_unfollowed_motion(name) or self._is_foreign_move(statement):
                    return statement
            elif self._routine_moves(routine):
                return statement
        return None

    def _routine_moves(self, routine: Routine) -> bool:
        """Return whether a routine, or a routine that it calls, moves the robot or changes how it moves; stored."""
        has_moves = self._moving.get(routine.name)
        if has_moves is None:
            self._moving[routine.name] = False  # ends the search at recursive calls
            has_moves = self._moving[routine.name] = self.first_moving_instruction(routine.body) is not None
        return has_moves

    # --- statements

    def _execute_routine(self, routine: Routine, scope: Scope, depth: int) -> None:
        """Execute the statements of a routine.

        :param scope: its parameters and data.
        :param depth: number of calls around it.
        :raises RapidError: calls are nested too deeply, or a statement cannot be followed.
        """
        if depth > _MAX_CALL_DEPTH:
            raise RapidError(f"{routine.name} calls itself", routine.start, _KEEP)
        self.result.followed_names.add(routine.name)
        with contextlib.suppress(_Return):
            self._execute_block(routine.body, scope, routine, depth)

    def _execute_block(self, statements: tuple[Statement, ...], scope: Scope, routine: Routine, depth: int) -> None:
        """Execute the statements of a block in order.

        :param routine: the routine that contains them.
        :param depth: number of calls around it.
        :raises RapidError: more than `MOST_STATEMENTS` are executed, or a statement cannot be followed.
        """
        for statement in statements:
            self.statement_count += 1
            if self.statement_count > MOST_STATEMENTS:
                problem = f"the program runs for more than {MOST_STATEMENTS} statements"
                raise RapidError(problem, statement.start, _KEEP)
            self._execute_statement(statement, scope, routine, depth)

    def _execute_statement(self, statement: Statement, scope: Scope, routine: Routine, depth: int) -> None:
        """Execute a statement by its kind.

        :param routine: the routine that contains it.
        :param depth: number of calls around the routine.
        :raises RapidError: the statement cannot be followed.
        :raises _Return: the statement leaves the routine.
        """
        if self.effects.has_functions:
            self._forget_results_of_functions(statement, scope)
        match statement:
            case Instruction():
                self._execute_instruction(statement, scope, depth)
            case Comment():
                self._note_comment(statement)
            case Assignment():
                self._execute_assignment(statement, scope)
            case Declaration():
                self._declare(statement, scope, routine)
            case Conditional():
                self._execute_conditional(statement, scope, routine, depth)
            case Loop():
                self._execute_loop(statement, scope, routine, depth)
            case Jump():
                self._execute_jump(statement, routine, scope)

    def _note_comment(self, comment: Comment) -> None:
        """Add a comment to the notes: with the move in whose line it is, otherwise with the next move."""
        count = len(self.result.moves)
        self.result.notes.append((comment, count - 1 if comment.is_trailing and count else count))

    def _note_wait(self, statement: Instruction, scope: Scope) -> None:
        """Add an instruction at which the robot waits to the waits."""
        # before a wait the force ends: not before WaitTime 0, which takes no time
        if statement.name in RAPID_WAITS and not _takes_no_time(statement, scope):
            self.result.waits.append((statement.start, len(self.result.moves)))

    def _leave(self, routine: Routine, scope: Scope, reason: str) -> NoReturn:
        """Leave a routine without moves if it is not known what runs in it; data that it may change become unknown.

        :param reason: reason why it is not known which statements run.
        :raises RapidError: the routine has a force comment.
        :raises _Return: in all other cases.
        """
        self._check_forces(routine.body, reason)
        self._forget(routine.body, f"{routine.name} may change it, of which it is not known what runs: {reason}", scope)
        raise _Return

    def _execute_jump(self, jump: Jump, routine: Routine, scope: Scope) -> None:
        """Execute RETURN; leave a routine without moves at GOTO; labels and EXIT have no effect.

        :raises _Return: RETURN, or GOTO in a routine without moves.
        :raises RapidError: any other jump, which may skip moves.
        """
        if jump.word == "RETURN":
            raise _Return
        if jump.word in ("EXIT", ":"):
            return
        if jump.word == "GOTO" and not self._routine_moves(routine):
            self._leave(routine, scope, "GOTO skips statements")
        advice = f"Put the moves of the part into a routine without {jump.word}."
        raise RapidError(f"{jump.word} changes the order of execution", jump.start, advice)

    def _declare(self, declaration: Declaration, scope: Scope, routine: Routine) -> None:
        """Add local data to the scope with its initial value, or as unknown."""
        variable = _initial_variable(declaration)
        if declaration.value is not None:
            try:
                variable.value, _ = evaluate(declaration.value, scope)
            except UnknownValueError as cause:
                variable.forget(cause.problem)
        if declaration.name in self.effects.changed_by_handler(routine):
            _interrupt_variable(variable, f"the handler of {routine.name}")
        scope.inner[declaration.name] = variable

    def _execute_assignment(self, statement: Assignment, scope: Scope) -> None:
        """Assign a value to data; they become unknown if the value or the index of the element is not known."""
        variable = scope.find(base_name(statement.target))
        if variable is None:
            return
        with _change_of(variable):
            try:
                value, _ = evaluate(statement.value, scope)
                assign(statement.target, value, scope)
            except (UnknownValueError, ValueError) as cause:
                variable.forget(cause.problem if isinstance(cause, UnknownValueError) else "its place is not known")

    def _execute_conditional(self, statement: Conditional, scope: Scope, routine: Routine, depth: int) -> None:
        """Execute the branch taken; if it is not known, skip it and all further branches.

        Data that they may change become unknown.

        :param routine: the routine that contains the statement.
        :param depth: number of calls around the routine.
        :raises RapidError: the branch taken is not known, and one of the possible branches moves the robot.
        """
        for branch_number, (condition, body) in enumerate(statement.branches):
            try:
                is_taken = condition is None or self._holds(statement, condition, scope)
            except UnknownValueError as cause:
                bodies = tuple(inner for _, block in statement.branches[branch_number:] for inner in block)
                self._skip(bodies, cause.problem, scope, routine)
                return
            if is_taken:
                self._execute_block(body, scope, routine, depth)
                return

    def _holds(self, statement: Conditional, condition: Expression, scope: Scope) -> bool:
        """Return whether the condition of a branch of IF is true, or a value of a CASE equals that of TEST.

        :raises UnknownValueError: a value is not known.
        """
        if statement.subject is None:
            return truth(condition, scope)
        subject, _ = evaluate(statement.subject, scope)
        return any(subject == evaluate(item, scope)[0] for item in condition.items)

    def _skip(self, statements: tuple[Statement, ...], reason: str, scope: Scope, routine: Routine) -> None:
        """Skip statements that may or may not run; data that they may change become unknown.

        :param reason: reason why it is not known whether they run.
        :param routine: the routine that contains them.
        :raises RapidError: they may move the robot, skip moves of the routine, or have a force comment.
        :raises _Return: they may leave the routine, and it has no moves.
        """
        first_move = self.first_moving_instruction(statements)
        if first_move is not None:
            problem = f"it is not known before the program runs whether {first_move.name} is executed: {reason}"
            advice = (
                "Put the moves of the part into procedures without conditions, and name them in [rapid] procedures of "
                "the cell; or give the data a value in the file."
            )
            raise RapidError(problem, first_move.start, advice)
        self._check_forces(statements, reason)
        self._forget(statements, f"it may be changed where it is not known whether: {reason}", scope)
        for statement in all_statements(statements):
            if isinstance(statement, Instruction):
                self._note_wait(statement, scope)
            # a stop of the program or a label skips no moves
            if isinstance(statement, Jump) and statement.word not in (*STOPPING, ":"):
                if statement.word == "RETURN" and routine is self.entry:
                    continue  # the program ends early; the moves before do not change
                if self._routine_moves(routine):
                    problem = f"it is not known whether {statement.word} is executed: {reason}"
                    raise RapidError(problem, statement.start, "Put the moves of the part into a routine without it.")
                self._leave(routine, scope, reason)

    def _execute_loop(self, loop: Loop, scope: Scope, routine: Routine, depth: int) -> None:
        """Execute a loop; add the run of a loop with moves to `result.rounds`.

        :param routine: the routine that contains it.
        :param depth: number of calls around the routine.
        """
        if self.first_moving_instruction(loop.body) is None:
            self._execute_loop_without_moves(loop, scope, routine, depth)
            return
        first = len(self.result.moves)
        execute = self._execute_for if loop.name else self._execute_while  # only FOR has a variable
        values = execute(loop, scope, routine, depth)
        if len(self.result.moves) > first:
            self.result.rounds.setdefault(loop.start, []).append((loop, values))

    def _execute_loop_without_moves(self, loop: Loop, scope: Scope, routine: Routine, depth: int) -> None:
        """Execute a loop without moves if its rounds are known and not too many; otherwise skip it.

        Data that it may change become unknown then.

        :param routine: the routine that contains it.
        :param depth: number of calls around the routine.
        """
        reason = "it is too long"
        try:
            if loop.name:
                values = _loop_values(loop, scope)
                if len(values) <= MOST_ROUNDS:
                    self._follow_rounds(loop, values, scope, routine, depth)
                    return
            elif self._execute_short_while(loop, scope, routine, depth):
                return
        except UnknownValueError as cause:
            reason = cause.problem
        self._skip(loop.body, f"the rounds of a loop are not known: {reason}", scope, routine)

    def _execute_short_while(self, loop: Loop, scope: Scope, routine: Routine, depth: int) -> bool:
        """Execute up to `MOST_ROUNDS` rounds of WHILE; return whether the loop has ended.

        :param routine: the routine that contains it.
        :param depth: number of calls around the routine.
        :raises UnknownValueError: its condition is not known.
        """
        for _ in range(MOST_ROUNDS):
            if not truth(loop.bounds[0], scope):  # the condition of WHILE
                return True
            self._execute_block(loop.body, scope, routine, depth)
            if self.effects.has_functions:
                self._forget_results_of_functions(loop, scope)
        return False

    def _follow_rounds(self, loop: Loop, values: list[float], scope: Scope, routine: Routine, depth: int) -> None:
        """Execute the rounds of FOR; its variable hides local data of the same name until the end.

        :param values: value of the variable in each round.
        :param routine: the routine that contains the loop.
        :param depth: number of calls around the routine.
        """
        outer_variable = scope.inner.get(loop.name)
        for value in values:
            scope.inner[loop.name] = Variable("NUM", value)
            self._execute_block(loop.body, scope, routine, depth)
        scope.inner.pop(loop.name, None)
        if outer_variable is not None:
            scope.inner[loop.name] = outer_variable

    def _execute_for(self, loop: Loop, scope: Scope, routine: Routine, depth: int) -> list[float]:
        """Execute FOR; return the value of its variable in each round.

        :param routine: the routine that contains it.
        :param depth: number of calls around the routine.
        :raises RapidError: its bounds are unknown, or a statement cannot be followed.
        """
        try:
            values = _loop_values(loop, scope)
        except UnknownValueError as cause:
            problem = f"the number of rounds of FOR is not known before the program runs: {cause.problem}"
            raise RapidError(problem, loop.start, "Write its bounds as numbers.") from None
        self._follow_rounds(loop, values, scope, routine, depth)
        return values

    def _execute_while(self, loop: Loop, scope: Scope, routine: Routine, depth: int) -> list[float]:
        """Execute WHILE; return the numbers of its rounds, from 0, as FOR returns the values of its variable.

        ``WHILE TRUE`` never returns: one round is executed, and the program stays in it.

        :param routine: the routine that contains it.
        :param depth: number of calls around the routine.
        :raises RapidError: its condition is unknown, or a statement cannot be followed.
        """
        (condition,) = loop.bounds  # the condition of WHILE is in place of the bounds of FOR
        if condition.kind == "bool" and condition.value:
            self._follow_endless(loop, scope, routine, depth)  # raises
        rounds: list[float] = []
        while True:
            try:
                if not truth(condition, scope):
                    return rounds
            except UnknownValueError as cause:
                problem = f"it is not known before the program runs how often WHILE runs: {cause.problem}"
                advice = "Put the moves of the part into a routine of its own, without the loop."
                raise RapidError(problem, loop.start, advice) from None
            rounds.append(float(len(rounds)))
            self._execute_block(loop.body, scope, routine, depth)
            if self.effects.has_functions:  # a function in the condition may change data
                self._forget_results_of_functions(loop, scope)

    def _follow_endless(self, loop: Loop, scope: Scope, routine: Routine, depth: int) -> None:
        """Execute one round of a loop that does not end, and check that all further rounds are equal to it.

        Statements behind the loop never run.

        :param routine: the routine that contains it.
        :param depth: number of calls around the routine.
        :raises RapidError: a later round differs, or the loop begins with a straight move, whose start differs.
        :raises _End: in all other cases.
        """
        move_count, note_count, wait_count = len(self.result.moves), len(self.result.notes), len(self.result.waits)
        values = {name: variable.value for name, variable in self._data_by_name(scope).items()}
        setting = self.setting
        self._execute_block(loop.body, scope, routine, depth)
        first_round = ExecutedProgram(
            moves=self.result.moves[move_count:],
            notes=[(comment, max(index - move_count, 0)) for comment, index in self.result.notes[note_count:]],
        )
        if first_round.moves and first_round.moves[0].kind != PTP:  # later rounds begin where the body ends
            problem = "a loop without end begins with a straight move, from another place in its second round"
            advice = "Begin its body with MoveAbsJ or MoveJ, or put the moves of the part into a routine of its own."
            raise RapidError(problem, loop.start, advice)
        if not self.result.errors:
            data = self._data_by_name(scope)
            changed_names = {
                name
                for name, item in data.items()
                if not item.has_declared_value and item.value != values.get(name, item.value)
            }
            if self.setting != setting:
                changed_names.add(_MOVE_SETTINGS)
            self._check_later_rounds(loop, scope, routine, depth, first_round, changed_names)
        # waits before the first move of the round: all later rounds wait there behind the last one
        self.result.waits += [
            (start, len(self.result.moves)) for start, count in self.result.waits[wait_count:] if count == move_count
        ]
        self.result.endless_loop = EndlessLoop(loop.start, move_count, note_count)
        raise _End

    def _check_later_rounds(
        self,
        loop: Loop,
        scope: Scope,
        routine: Routine,
        depth: int,
        first_round: ExecutedProgram,
        changed_names: Set[str],
    ) -> None:
        """Check that all rounds of a loop without end are equal to the first; result and data stay as they are.

        :param routine: the routine that contains it.
        :param depth: number of calls around the routine.
        :param first_round: moves and notes of the first round, counted from its beginning.
        :param changed_names: names of data (`_data_by_name`) that the first round has changed.
        :raises RapidError: a later round differs, or cannot be followed.
        """
        data = self._data_by_name(scope)
        result, setting, inner = self.result, self.setting, dict(scope.inner)
        copies = [(variable, replace(variable)) for variable in data.values()]  # as they are behind the first round

        def follow_next_round(unknown_names: frozenset[str]) -> FollowedRun:
            """Execute one more round, and compare it with the first; an error of the second round is raised."""
            for name in unknown_names & data.keys():
                data[name].forget("an earlier round may have changed it")
            for variable in data.values():
                variable.start_run()
            self.result = ExecutedProgram(unknown_calls=dict(result.unknown_calls))
            try:
                self._execute_block(loop.body, scope, routine, depth)
            except _Return:
                return FollowedRun(loop.start)
            except RapidError as cause:
                if not unknown_names:  # the second round, whose data are known
                    raise
                return FollowedRun(cause.start)
            if self.result.errors and not unknown_names:
                raise self.result.errors[0]
            start = first_difference(first_round, self.result)
            if start is None and self.setting != setting:
                start = loop.start
            changed_data = (
                name
                for name, variable in data.items()
                if variable.is_used and variable.is_changed and variable.value != variable.start_value
            )
            return FollowedRun(difference=start, changed_names=frozenset(changed_data))

        difference = later_difference(changed_names, follow_next_round)
        used_names = {name for name, variable in data.items() if variable.is_used}
        self.result, self.setting, scope.inner = result, setting, inner
        for variable, copy in copies:
            variable.copy_from(copy)
        if difference is not None:
            # data that change and are used; settings of moves are no data and are never among the used ones
            names = difference.names & used_names or difference.names
            spellings = {
                name: name if variable.declaration is None else variable.declaration.spelling
                for name, variable in data.items()
            }
            raise _round_error(difference, sorted(spellings.get(name, name) for name in names))

    def _data_by_name(self, scope: Scope) -> dict[str, Variable]:
        """Return all data that a routine, or routines that it calls, may use.

        Module data that are hidden by local data have another name than these.
        """
        hidden_names = self.data.keys() & scope.inner.keys()
        data = {f"{name} of the module" if name in hidden_names else name: item for name, item in self.data.items()}
        return data | scope.inner

    # --- instructions

    def _execute_instruction(self, statement: Instruction, scope: Scope, depth: int) -> None:
        """Execute an instruction: a move, a setting, a call, or an instruction that changes data.

        Instructions that cannot be followed are added to the errors. Data that an instruction may change in an unknown
        way become unknown.

        :param depth: number of calls around the present routine.
        :raises RapidError: there are too many errors, or a called routine cannot be followed.
        """
        name = statement.name.removeprefix("%")
        if statement.name in _LATE_CALLS:
            problem = "the name of the routine that is called here is known at run time only"
            self._refuse(statement, problem, "Call the routine by its name.")
        elif statement.name in MOVES:
            try:
                self.result.moves.append(
                    stated_move(statement, MOVES[statement.name], scope, self.setting, self._frame_of_cell)
                )
            except UnknownValueError as cause:
                self._refuse(statement, cause.problem, _OPEN_DATA if self.result.unknown_calls else _NUMBERS)
        elif name in self.routines and self.routines[name].kind == "PROC":
            self._execute_call(statement, self.routines[name], scope, depth)
        elif name in SETTINGS:
            self._execute_setting(statement, scope)
        elif name in COUNTING:
            self._execute_counting(statement, scope)
        elif is_unfollowed_motion(name):
            self._refuse(statement, f"{name} moves the robot or changes how it moves, which is not followed", _KEEP)
        elif name in self.effects.routines:
            self._call_other_module(statement, self.effects.routines[name], scope)
        elif self._is_foreign_move(statement):
            problem = f"{name} is in no module of this file and takes a target: it may move the robot"
            self._refuse(statement, problem, _FOREIGN)
        else:
            if name == "CONNECT":
                self._check_connect(statement)
            self._note_wait(statement, scope)
            # such instructions of RAPID change only the data of result options; others may change any argument
            is_reading = name in READING or name in CONSTANT
            for argument in results(statement) if is_reading else changed_arguments(statement.arguments):
                _forget_variable(scope.find(base_name(argument)), f"{name} may change it")
            if self.effects.is_foreign(name):
                self._list_foreign_call(name, statement)
            self._forget_data_of(name, self._change_reason(name))

    def _refuse(self, statement: Statement, problem: str, advice: str) -> None:
        """Add an error at a statement to the errors, so that later errors are found too.

        :raises RapidError: there are more than `MAX_ERRORS`; it is the first.
        """
        self.result.errors.append(RapidError(problem, statement.start, advice))
        if len(self.result.errors) > MAX_ERRORS:
            raise self.result.errors[0]

    def _check_connect(self, statement: Instruction) -> None:
        """Add an error if the trap routine of CONNECT moves the robot."""
        value = statement.arguments[0].value
        routine = self.effects.routines.get(value.value) if value is not None else None
        if routine is not None and self._routine_moves(routine):
            problem = f"the interrupt {routine.name} moves the robot at a time that is not known"
            self._refuse(statement, problem, _KEEP)

    def _execute_counting(self, statement: Instruction, scope: Scope) -> None:
        """Execute Incr, Decr, Add or Clear; the data become unknown if the result cannot be calculated.

        Nothing happens if the argument is no declared data.
        """
        target = next(changed_arguments(statement.arguments), None)
        variable = None if target is None else scope.find(base_name(target))
        if target is None or variable is None:
            return
        with _change_of(variable):
            try:
                step = {"INCR": 1.0, "DECR": -1.0}.get(statement.name, 0.0)
                if statement.name == "ADD" and statement.arguments[1].value is not None:
                    step = number(statement.arguments[1].value, scope)
                assign(target, 0.0 if statement.name == "CLEAR" else number(target, scope) + step, scope)
            except (UnknownValueError, ValueError, IndexError):
                variable.forget(f"{statement.name} changes it")

    def _execute_setting(self, statement: Instruction, scope: Scope) -> None:
        """Execute an instruction that changes how moves are executed: ConfJ, SingArea, CirPathMode, VelSet.

        Unknown speeds of VelSet are an error.
        """
        setting = setting_after(statement, self.setting, scope)
        if setting is None:
            self._refuse(statement, "the speeds of VelSet are not known", "Write them as numbers.")
        else:
            self.setting = setting

    def _execute_call(self, statement: Instruction, routine: Routine, scope: Scope, depth: int) -> None:
        """Call a routine: bind its parameters, execute it, and make data unknown that it may have changed otherwise.

        A VAR, PERS or INOUT parameter whose argument is the name of data is these data. For an array element it gets
        the value of the element, or is unknown if the routine may change the array. Behind the call, the array is
        unknown.

        :param routine: the called routine.
        :param depth: number of calls around the calling routine.
        :raises RapidError: the routine cannot be followed.
        """
        callee_scope = Scope(self.data)
        bound_parameters = list(bound_arguments(routine, statement.arguments, scope))
        handler_names = self.effects.changed_by_handler(routine)
        for parameter, expression, is_given in bound_parameters:
            # without an argument: an optional parameter that the call leaves out
            variable = Variable(parameter.type, unknown_reason=f"the call of {routine.name} does not give it")
            if parameter.is_changeable and _is_data_name(expression, scope):
                variable = scope.variable(expression.value)
            elif (
                parameter.is_changeable
                and expression is not None
                and self._may_change_array(routine, parameter, bound_parameters)
            ):
                variable.unknown_reason = f"{routine.name} may change it"
                _forget_variable(scope.find(base_name(expression)), variable.unknown_reason)
            elif expression is not None:
                try:
                    variable.value, _ = evaluate(expression, scope)
                except UnknownValueError as cause:
                    variable.unknown_reason = cause.problem
            if parameter.name in handler_names:
                _interrupt_variable(variable, f"the handler of {routine.name}")
            callee_scope.inner[parameter.name] = variable
            callee_scope.presence[parameter.name] = is_given
        if self._routine_moves(routine):
            self.result.calls.setdefault(routine.name, []).append(statement)
        self._execute_routine(routine, callee_scope, depth + 1)
        for parameter, expression, _ in bound_parameters:
            if parameter.is_changeable and expression is not None and not _is_data_name(expression, scope):
                _forget_variable(scope.find(base_name(expression)), f"{routine.name} may change it")

    def _call_other_module(self, statement: Instruction, routine: Routine, scope: Scope) -> None:
        """Make data unknown that a routine of another loaded module may change; add an error if it moves the robot."""
        if self._routine_moves(routine):
            problem = f"{routine.name} of another file moves the robot or changes how it moves"
            self._refuse(statement, problem, "Copy the routine to this file.")
        reason = f"{routine.name} of another file may change it"
        for name in self.effects.changed_arguments(routine.name, statement.arguments):
            _forget_variable(scope.find(name), reason)
        self._forget_data_of(routine.name, reason)

    def _may_change_array(self, routine: Routine, parameter: Parameter, bound_parameters: list[BoundArgument]) -> bool:
        """Return whether a routine may change the array whose element is the argument of a parameter.

        :param parameter: parameter whose argument is an array element.
        :param bound_parameters: parameters of the routine with their arguments.
        """
        names = [base_name(expression) for _, expression, _ in bound_parameters if expression is not None]
        array_name = next(
            base_name(value) for item, value, _ in bound_parameters if item is parameter and value is not None
        )
        changed_names = {*self.effects.changed_names(routine.body), *self.effects.changed_data_of(routine.name)}
        # the element itself, the array by its name, or another argument that is a part of the array
        return parameter.name in changed_names or array_name in changed_names or names.count(array_name) > 1

    def _frame_of_cell(self, name: str, type_: str) -> Value | None:
        """Return the value of the cell for a tool or work object that no module declares; None if it has none.

        Add a value to `result.cell_data`.
        """
        value = self.cell_value(name, type_)
        if value is not None:
            self.result.cell_data[name] = type_
        return value


def _round_error(difference: Difference, changed_names: Sequence[str]) -> RapidError:
    """Return the error that a later round of a loop without end moves differently.

    :param difference: where it does.
    :param changed_names: data that each round changes for the next, as spelled.
    """
    names = first_of(changed_names, _MOST_NAMES)
    moves = "moves" if difference.is_certain else "may move"
    problem = (
        f"a later round of this loop without end {moves} differently here: each round changes {names} for the next"
    )
    advice = (
        f"Set {names} at the beginning of the round. Or put the moves of the part into a procedure of its own, without "
        "the loop, and name the file like it."
    )
    return RapidError(problem, difference.place, advice)


def _check_names(modules: tuple[Module, ...]) -> None:
    """Check that no two modules declare one name, see `name_clash`.

    :raises RapidError: two modules do.
    """
    clash = name_clash(modules)
    if clash is not None:
        problem = f"{clash.item.name} is declared in two modules, {clash.first_module} and {clash.second_module}"
        raise RapidError(problem, clash.item.start, "Give one of them another name, or convert each module by itself.")


def _check_functions(modules: tuple[Module, ...]) -> None:
    """Check that no routine has the name of a function of RAPID, or of an instruction that is followed.

    :raises RapidError: a routine has such a name.
    """
    routine = named_like_rapid(modules)
    if routine is not None:
        problem = f"{routine.kind} {routine.name} has the name of an instruction or function of RAPID"
        raise RapidError(problem, routine.start, "Give it another name.")


def _interrupt_variable(variable: Variable | None, name: str) -> None:
    """Make data unknown for the whole program: a trap or handler may change them at any time.

    :param variable: the data; None and constants are ignored.
    :param name: name of the trap or handler, for messages.
    """
    if variable is not None and not _is_constant(variable):
        variable.forget(f"{name} may change it")
        variable.interrupt = name


def _loop_values(loop: Loop, scope: Scope) -> list[float]:
    """Return the value of the variable of FOR in each round; empty if the bounds contradict the step.

    :raises UnknownValueError: the bounds are not known, there are too many rounds, or their number depends on rounding.
    """
    begin, end, *stated_step = (number(bound, scope) for bound in loop.bounds)  # FROM, TO and, if stated, STEP
    step = stated_step[0] if stated_step else (1.0 if end >= begin else -1.0)
    if step == 0.0 or (end - begin) * step < 0.0:
        return []
    count = (end - begin) / step  # of steps; may be broken
    if count > MOST_STATEMENTS:
        raise UnknownValueError("there are too many")
    if abs(count - round(count)) < SINGLE_PRECISION_TOLERANCE * max(count, 1.0) and not (
        begin.is_integer() and step.is_integer()
    ):
        raise UnknownValueError("whether there is a last round depends on the rounding of the controller")
    values = [begin]
    while (end - values[-1] - step) * step >= 0.0:  # added up as the controller does
        values.append(values[-1] + step)
    return values


@contextlib.contextmanager
def _change_of(variable: Variable) -> Iterator[None]:
    """Run a block that changes data; ``n := n + 1`` in it is no use of their value at the start of the run.

    The new value depends on that value nevertheless: `is_set` stays False. After ``n := 1`` it is True.
    """
    was_used, variable.is_used = variable.is_used, False
    yield
    depends_on_start = variable.is_used
    variable.is_set = variable.is_set or not depends_on_start
    variable.is_used = was_used


def _forget_variable(variable: Variable | None, reason: str, *, by_foreign_call: bool = False) -> None:
    """Make data unknown; None and constants are ignored.

    :param reason: reason for the message if the data are used later.
    :param by_foreign_call: True if only routines of other files may change them.
    """
    if variable is not None and not _is_constant(variable):
        (variable.forget_by_foreign_call if by_foreign_call else variable.forget)(reason)


def _initial_variable(declaration: Declaration) -> Variable:
    """Return data as they are declared, with the default value of their type if they have no initial value.

    Initial values are evaluated later, when they are first used. Elements of an array of another type are None, unknown
    until they are assigned; so is an array whose dimensions are no numbers.
    """
    has_declared_value = declaration.value is not None
    variable = Variable(declaration.type, declaration=declaration, has_declared_value=has_declared_value)
    sizes = [item.value for item in declaration.dimensions if item.kind == "number"]
    if declaration.value is None and len(sizes) == len(declaration.dimensions):
        value: Value = {"NUM": 0.0, "BOOL": False, "STRING": ""}.get(declaration.type)
        if math.prod(sizes) <= _MOST_ELEMENTS:
            for size in reversed(sizes):
                value = [value] * int(size)  # values are replaced, never changed in place
            variable.value = value
    return variable


def _is_data_name(expression: Expression | None, scope: Scope) -> TypeGuard[Expression]:
    """Return whether an argument is a whole name of declared data, not an element or another expression."""
    return expression is not None and expression.kind == "name" and scope.find(expression.value) is not None


def _is_constant(variable: Variable) -> bool:
    """Return whether data are declared as CONST."""
    return variable.declaration is not None and variable.declaration.kind == "CONST"


def _takes_no_time(wait: Instruction, scope: Scope) -> bool:
    """Return whether a wait only stops the reading ahead: ``WaitTime 0`` and ``WaitUntil TRUE``."""
    values = [argument.value for argument in wait.arguments if argument.value is not None]
    if wait.name == "WAITUNTIL":
        return any(value.kind == "bool" and value.value for value in values)
    if wait.name != "WAITTIME":
        return False
    try:
        return any(number(value, scope) == 0.0 for value in values)
    except (UnknownValueError, ValueError):
        return False
