"""Execution state of a program while it is followed: the present line, what its names mean, the findings so far."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from postproc.dialects.krl.execution import ForkVisit
from postproc.dialects.krl.language.declarations import declared_names
from postproc.dialects.krl.language.names import CONTROLLER_DATA
from postproc.dialects.krl.language.routines import Module, Routine
from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.language.structures import Node, check_closed, checked_nodes, nodes_of
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.language.values import Aggregate, Reference, Value
from postproc.dialects.krl.read.data_lists import read_data
from postproc.dialects.krl.read.effects import Analysis
from postproc.dialects.krl.read.folder import Library
from postproc.dialects.krl.read.known import NO_VALUE, Scope, UnknownValue, VariableValue
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.state import State
from postproc.dialects.krl.read.variables import Snapshot, Variables
from postproc.errors import Issue, ProgramError

SETTING_ADVICE = "Set $BASE, $TOOL, speeds and modes outside of loops, branches and interrupts."


class Scopes:
    """The scopes of routines.

    The scope of another file is made, and its data list read, when one of its routines is first called.

    :param program: the file of the program.
    :param main: the routine that is followed; its names are the stored names.
    """

    def __init__(self, program: Module, main: Routine, variables: Variables) -> None:
        """Begin without scopes."""
        self.program, self.main, self.variables = program, main, variables
        self._modules: dict[Module, Scope] = {}
        self._routines: dict[Routine, Scope] = {}
        self._prefix = f"{program.name}/"  # of names that another routine does not share with the main routine

    def scope_of(self, module: Module, routine: Routine) -> Scope:
        """Return the scope that resolves the names of a routine other than its local names.

        The main routine needs none: its names are the stored names. Other routines of its file do not see its local
        variables. Routines of another file share the scope of that file.
        """
        if routine is self.main:
            return Scope()
        if module is self.program:
            if routine not in self._routines:
                self._routines[routine] = Scope(
                    prefixed_names=self.main.local_names - routine.local_names, prefix=self._prefix
                )
            return self._routines[routine]
        if module not in self._modules:
            self._modules[module] = self._module_scope(module)
        return self._modules[module]

    def scope_of_call(self, module: Module, routine: Routine, number: int, arrays: Mapping[str, str]) -> Scope:
        """Return the scope of one call of a routine; its local variables are stored separately from other calls.

        :param number: number of the call, from 1; it is part of the stored names of the local variables.
        :param arrays: parameter name → stored name of the whole array that the caller gives for it.
        """
        local_names = {name: f"{name}@{number}" for name in routine.local_names}
        if arrays:
            local_names |= arrays
            return replace(self.scope_of(module, routine), local_names=local_names, array_names=frozenset(arrays))
        return replace(self.scope_of(module, routine), local_names=local_names)

    def _module_scope(self, module: Module) -> Scope:
        """Return the scope of the routines in another file, and store the variables of the data list of that file.

        Names that are not GLOBAL get the name of the file as prefix: those of its data list, and those that the main
        program declares, which the other file does not see.
        """
        variables, data = self.variables, module.data
        # names that are declared for the file itself, and GLOBAL names
        data_names, global_names = (frozenset(), frozenset()) if data is None else declared_names(data)
        main_names = (frozenset(variables.types) - variables.global_names) | self.main.local_names
        prefixed_names = (main_names | data_names) - global_names - CONTROLLER_DATA
        scope = Scope(prefixed_names=prefixed_names, prefix=f"{module.name}/")
        if data is not None:
            caller_scope, variables.scope, variables.reads_late_list = variables.scope, scope, True
            with suppress(ProgramError):  # variables of a data list with an error have no values
                read_data(variables, data, fills_gaps=True)
            variables.scope, variables.reads_late_list = caller_scope, False
        return scope


class Level(Struct, eq=False):
    """A routine that has been called and has not ended.

    The execution trace: the lines of the program in the order in which they are executed.

    :ivar is_traced: True if its motions are in the execution trace: the main routine, and inlined routines.
    :ivar open_structures: control structures around the present statement whose branch taken is not known before run
        time: word and line.
    :ivar loop_depth: number of nested loops that are followed.
    :ivar is_left: True after EXIT.
    :ivar jump_line: line of a GOTO that has run and whose label has not been reached; 0 if there is none.
    :ivar return_line: line of the RETURN that has run; 0 if none has.
    :ivar result: value of a function; `NO_VALUE` until RETURN has run.
    """

    module: Module
    routine: Routine
    scope: Scope
    is_traced: bool = False
    open_structures: list[tuple[str, int]] = []
    loop_depth: int = 0
    is_left: bool = False
    jump_line: int = 0
    return_line: int = 0
    result: VariableValue = NO_VALUE

    @property
    def is_broken_off(self) -> bool:
        """Whether the following statement does not run next: after RETURN, EXIT, GOTO."""
        return bool(self.return_line or self.is_left or self.jump_line)


class UntracedCall(Struct, frozen=True, eq=False):
    """A call of a routine of another file whose motions are not in the execution trace.

    :param row: row of the trace with the call; after it the robot position is not known.
    :param reason: the error for a motion that begins there and depends on the robot position.
    :param name: name of the routine, as it is spelled; `routine` is the routine itself, in `module`.
    :param cause: why the call is not followed.
    """

    row: int
    reason: ProgramError
    name: str
    module: Module
    routine: Routine
    cause: ProgramError


class FindingCounts(NamedTuple):
    """Number of findings of each kind, see the lists of the same names in `Run`."""

    triggers: int
    untraced_calls: int
    interruptible_calls: int
    absent_calls: int
    issues: int


class RunPosition(NamedTuple):
    """The routine that runs, and how deep it is in calls, loops and branches.

    :ivar depth: number of routines that run.
    :ivar loop_depth: `Level.loop_depth`; `is_left` is `Level.is_left`.
    :ivar fork_count: number of open forks.
    """

    level: Level
    depth: int
    scope: Scope
    loop_depth: int
    is_left: bool
    fork_count: int


class _Fork(Struct, eq=False):
    """A fork: an IF or SWITCH whose branch taken is not known before run time, so that all branches are followed.

    :ivar values: values of all variables before the branches; `state` the settings in force there.
    :ivar is_begun: True once a branch has begun.
    :ivar ends: values and settings at the end of each branch but the last.
    """

    values: Snapshot
    state: State
    is_begun: bool = False
    ends: list[tuple[Snapshot, State]] = []


class Run:
    """State shared by the classes that follow a program.

    :ivar routine: the main routine.
    :ivar trace: the execution trace; until it is complete, the lines of the `.src`.
    :ivar has_rows: True if `row` is a row of the trace while statements run; False if it is a line of the `.src`.
    :ivar row: the present row of the trace.
    :ivar shift: row of the present statement minus its line in the file, if the statement is traced.
    :ivar recorded_line: line of the program's own `.src` to report for the present row; 0 if the trace is complete: the
        trace has the line then.
    :ivar is_final: False if the statements must run once more when the trace is complete.
    :ivar statement_place: the statement that runs, in the file of its routine; None before the first.
    :ivar level: the routine that runs.
    :ivar stack: the routines that have been called and have not ended, the running routine last.
    :ivar statement_count: number of statements that have run in called routines and in control structures without
        motion.
    :ivar call_count: number of calls that have been run; it names the local variables of each.
    :ivar may_be_broken_off: True if RESUME may break off the running routine.
    :ivar resume_place: RESUME that returns to the program or to an unknown routine; None if there is none.
    :ivar triggers: lines of TRIGGER statements of the main routine.
    :ivar untraced_calls: calls after which the robot position is not known.
    :ivar interruptible_calls: rows of calls that an interrupt may break off, and with them the motion before; each row
        with the error for a motion that depends on its start.
    :ivar unfollowed_routines: routines reached by calls that move the robot and are not followed.
    :ivar position_dependent_calls: rows of calls of unfollowed routines whose first target depends on the robot
        position.
    :ivar unknown_force_reasons: row → reason: after such a row the acting force is not known.
    :ivar followed_names: rows of the trace and offsets of names whose use is followed.
    :ivar copies: pairs of names, upper case: a variable whose point was copied, and the variable that got the copy.
    :ivar absent_calls: calls of programs that are in no file: name as spelled, and line.
    :ivar called_routines: routines of the program's own file that have been called.
    :ivar waiting_calls: rows of the trace that call a routine which waits and is not in the trace.
    :ivar issues: warnings and remarks for the user.
    :ivar keeps_unresolved: the option `--keep-unresolved`.
    :ivar unresolved_motions: (line, reason): motions of the trace that are left uncorrected under that option.
    :ivar obstacles: routines of other files whose motions are not in the trace, and visits to forks whose branches are
        not followed, each with the reason.
    """

    def __init__(self, library: Library, routine: Routine, settings: Settings, trace: Trace, *, has_rows: bool) -> None:
        """Begin before the first statement of the main routine."""
        self.library, self.routine, self.settings = library, routine, settings
        self.trace, self.has_rows, self.variables = trace, has_rows, settings.variables
        self.scopes = Scopes(library.program, routine, self.variables)
        self.analysis = Analysis(library, self.scopes.scope_of)
        self.row = self.shift = self.recorded_line = 0
        self.is_final = True
        self.statement_place: Place | None = None
        self.level = Level(library.program, routine, Scope(), is_traced=True)
        self.stack: list[Routine] = [routine]
        self.statement_count = self.call_count = 0
        self.may_be_broken_off = False
        self.resume_place: Place | None = None
        self.triggers: list[int] = []
        self.untraced_calls: list[UntracedCall] = []
        self.interruptible_calls: list[tuple[int, ProgramError]] = []
        self.unfollowed_routines: set[Routine] = set()
        self.position_dependent_calls: set[int] = set()
        self.unknown_force_reasons: dict[int, str] = {}
        self.followed_names: set[tuple[int, int]] = set()
        self.copies: set[tuple[str, str]] = set()
        self.absent_calls: list[tuple[str, int]] = []
        self.called_routines: set[Routine] = set()
        self.waiting_calls: list[int] = []
        self.issues: list[Issue] = []
        self.keeps_unresolved = settings.cell.krl.keep_unresolved
        self.unresolved_motions: list[tuple[int, ProgramError]] = []
        self.obstacles: Mapping[Routine | ForkVisit, ProgramError] = {}
        self._forks: list[_Fork] = []
        self._nodes: dict[Routine, tuple[Node, ...]] = {}

    def go_to_row(self, row: int) -> Place:
        """Make a row of the execution trace, from 1, the present row; return the file and the line of its statement."""
        place = self.trace.place(row)
        self.row, self.shift = row, row - place.line
        return place

    def with_row(self, aggregate: Aggregate) -> Aggregate:
        """Return an aggregate (``{X 1,Y 2,…}``) of the present statement with its row: its numbers are corrected there.

        Without rows of the trace (`has_rows`) it is returned unchanged.
        """
        return replace(aggregate, row=self.row) if self.has_rows else aggregate

    def note_followed_names(self, *offsets: int) -> None:
        """Add names in the present statement to `followed_names`.

        :param offsets: offsets of the names in the file.
        """
        self.followed_names.update([(self.row, offset) for offset in offsets])

    def note_copy(self, expression: Value, value: VariableValue, name: str) -> None:
        """Add to `copies` that the present statement copies a point to a variable or a parameter.

        A copied point is corrected where its numbers are written, with all motions to its copies. Nothing is added if
        the expression is no variable, or its value is no point whose numbers are in the text.

        :param expression: the assigned expression; `value` is its value from `Calls.evaluate_with_calls`.
        :param name: name of the variable or parameter that gets the value, upper case.
        """
        if isinstance(expression, Reference) and isinstance(value, Aggregate) and not value.is_computed:
            self.note_followed_names(expression.start)
            self.copies.add((expression.name, name))

    def nodes(self, routine: Routine) -> tuple[Node, ...]:
        """Return the statements and control structures of a routine.

        :raises ProgramError: a control structure is not closed properly.
        """
        if routine not in self._nodes:
            nodes = checked_nodes(routine.source, nodes_of(routine.source, routine.statement_lines))
            # unclosed structures of the main routine are reported with its other errors
            if routine is not self.routine:
                check_closed(routine.source, nodes)
            self._nodes[routine] = nodes
        return self._nodes[routine]

    @property
    def reported_line(self) -> int:
        """Line of the program's own `.src` to report for the present line."""
        return self.recorded_line or self.trace.reported_line(self.row)

    def begin_fork(self) -> None:
        """Store the present values and settings, before the branches of a fork are followed one after the other."""
        self._forks.append(_Fork(self.variables.snapshot(), self.settings.state))

    def begin_branch(self) -> None:
        """Begin the next branch of the last fork, with the values and settings at that fork."""
        fork = self._forks[-1]
        if fork.is_begun:  # the present values are those at the end of the branch before
            fork.ends.append((self.variables.snapshot(), self.settings.state))
        fork.is_begun = True
        self.variables.restore(fork.values)
        self.settings.change_state(self.row, fork.state)

    def join_branches(self, place: Place, *, is_exhaustive: bool) -> None:
        """End the last fork: values and settings that differ between its branches become unknown.

        :param place: the line that ends the branches, for messages.
        :param is_exhaustive: True if one of the branches always runs; False if all may be skipped, so that the values
            at the fork count as those of one more branch.
        """
        fork = self._forks.pop()
        # the present values are those at the end of the last branch
        for values, state in [*fork.ends, *([] if is_exhaustive else [(fork.values, fork.state)])]:
            self.variables.merge(values, str(place))
            problem = "what motions depend on differs behind the branches that meet here"
            self.settings.may_become(self.row, state, place.error(problem, SETTING_ADVICE))

    @property
    def is_forked(self) -> bool:
        """Whether a fork is open: it is not known whether the present statement runs."""
        return bool(self._forks)

    def position(self) -> RunPosition:
        """Return the present routine and depth of the run, for `return_to`."""
        level = self.level
        return RunPosition(
            level=level,
            depth=len(self.stack),
            scope=self.variables.scope,
            loop_depth=level.loop_depth,
            is_left=level.is_left,
            fork_count=len(self._forks),
        )

    def return_to(self, position: RunPosition) -> None:
        """Return to the routine and the depth of the run at an earlier `position`, to follow a statement differently.

        Open control structures and a GOTO on its way to its label are given up. Values and settings stay.
        """
        self.level, self.variables.scope = position.level, position.scope
        self.level.loop_depth, self.level.is_left = position.loop_depth, position.is_left
        del self.stack[position.depth :], self._forks[position.fork_count :]
        self.level.open_structures.clear()
        self.level.jump_line = 0

    def finding_counts(self) -> FindingCounts:
        """Return the number of findings of each kind so far, for `drop_findings`."""
        return FindingCounts(
            triggers=len(self.triggers),
            untraced_calls=len(self.untraced_calls),
            interruptible_calls=len(self.interruptible_calls),
            absent_calls=len(self.absent_calls),
            issues=len(self.issues),
        )

    def drop_findings(self, counts: FindingCounts) -> None:
        """Drop all findings since a call of `finding_counts`, to follow the same statements differently."""
        del self.triggers[counts.triggers :], self.untraced_calls[counts.untraced_calls :]
        del self.interruptible_calls[counts.interruptible_calls :]
        del self.absent_calls[counts.absent_calls :], self.issues[counts.issues :]

    @property
    def is_traced(self) -> bool:
        """Whether the lines of the present routine are in the execution trace: the main routine, or an inlined one."""
        return self.level.is_traced

    @property
    def is_certain(self) -> bool:
        """Whether the next statement runs exactly once: no control structure is open."""
        return not self.level.open_structures

    @property
    def may_take_rounds_at_once(self) -> bool:
        """Whether the motions of the next rounds of a loop may be taken at once.

        The frames and all other settings must be known, no control structure or spline block may be open.
        """
        state = self.settings.state
        has_frames = state.base >= 0 and state.tool >= 0  # negative: not known
        return has_frames and not state.uncertain_fields and not state.spline_block and self.is_certain

    def stored_name(self, name: str) -> str:
        """Return the name under which a variable of the running routine is stored."""
        return self.variables.scope.stored_name(name.upper())

    def note_possible_changes(self, names: Mapping[str, Place], cause: str) -> None:
        """Note that variables may get another value at any time from now on; of several causes the first is kept.

        :param names: stored name → the statement that changes the variable.
        :param cause: the interrupt, trigger or routine that runs this statement, for messages.
        """
        for name, place in names.items():
            # a cause may name the place already
            cause_place = cause if cause.endswith(f"in {place}") else f"{cause}, {place}"
            self.variables.volatile_values.setdefault(name, UnknownValue(f"by {cause_place}"))

    def note_cyclic_change(self, place: Place, name: str) -> None:
        """Note that the statement at a place makes a variable change cyclically (ANIN ON …).

        :param name: stored name of the variable.
        """
        self.variables.volatile_values.setdefault(name, UnknownValue(str(place)))
