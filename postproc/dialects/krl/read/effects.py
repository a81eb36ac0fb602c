"""Side effects of routines: names that they may write, motions, calls of missing programs.

A point, an index, a frame or a speed is constant only if nothing that can run before its use writes it. What a routine
may write is found over all that it calls, functions in expressions and parameters by reference included, and over the
actions of the interrupts and triggers that it declares. Nothing is executed: a branch counts as taken.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator

from msgspec import Struct, field

from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.names import OPENING, STANDARD
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.routines import Callee, Module, Routine
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.tokens import occurrences
from postproc.dialects.krl.language.tree import (
    Assignment,
    CallStatement,
    CyclicInput,
    Declaration,
    Event,
    FaultyStatement,
    For,
    Goto,
    IdleDeclaration,
    Import,
    Motion,
    Spline,
    Statement,
)
from postproc.dialects.krl.language.values import Call, Reference, Value, writable_variable
from postproc.dialects.krl.read.bas import BAS_SETS, command_of, data_read
from postproc.dialects.krl.read.comments import force_comment_lines
from postproc.dialects.krl.read.folder import Library
from postproc.dialects.krl.read.known import Scope, stored_originals
from postproc.dialects.krl.read.motion_reader import depends_on_position, keeps_position, reads_robot_position
from postproc.dialects.krl.read.waits import wait_time
from postproc.errors import ProgramError

_CLOSING = frozenset({*OPENING.values(), "UNTIL"})
_RETURN_POSITIONS = frozenset({"$AXIS_RET", "$POS_RET"})
"""Where the robot left its path when it was stopped by an interrupt (KUKA, System Variables)."""
_RAPID_WORDS = ("PTP", "SPTP")
_PATH_COMPONENTS = {"$VEL": "CP", "$APO": "CDIS"}
"""System variables of which one component matters to the path, and which."""
_TURN_SPEEDS = ("ORI1", "ORI2")
"""Components of `$VEL` that limit how fast the tool turns."""


class Effects(Struct, eq=False):
    """Side effects of a routine, a statement or an action: the statement that an interrupt or a trigger runs.

    A place is a file and a line.

    :ivar writes: stored names of variables that may get another value while the code runs → the statement that does it.
    :ivar volatile_writes: stored names of variables that interrupts, triggers and cyclic statements may change at any
        time afterwards → the statement that does it.
    :ivar motion: place of a motion; None if there is none.
    :ivar waits: True if the robot waits, see `waits`.
    :ivar turn_speed_place: place at which `$VEL.ORI1` or `$VEL.ORI2` is set; None if there is none.
    :ivar interrupt_motion: place of a motion in a GLOBAL interrupt that the code declares; None if there is none.
    :ivar return_motion: place of a motion back to where an interrupt stopped the robot; None if there is none.
    :ivar force_comment: place of a force comment; None if there is none.
    :ivar absent_calls: called programs that are in no file: name, upper case → name as the program spells it.
    :ivar jump: place of a GOTO or RESUME, so that the routine may not run line by line; None if there is none.
    :ivar resume: place of a RESUME that may break off the running routine; None if there is none.
    :ivar parameter_write: place at which a parameter without ``:IN`` is written; None if there is none.
    :ivar lasting_write: place from which on a parameter without ``:IN``, and so the variable that the caller gives for
        it, may change at any time; None if there is none.
    """

    writes: dict[str, Place] = {}
    volatile_writes: dict[str, Place] = {}
    motion: Place | None = None
    waits: bool = False
    turn_speed_place: Place | None = None
    interrupt_motion: Place | None = None
    return_motion: Place | None = None
    force_comment: Place | None = None
    absent_calls: dict[str, str] = {}
    jump: Place | None = None
    resume: Place | None = None
    parameter_write: Place | None = None
    lasting_write: Place | None = None

    def add(self, effects: Effects) -> None:
        """Add the effects of a called routine; places that are known already stay.

        `jump` and `parameter_write` are not added: they concern the called routine alone. Effects that last are added
        by `Analysis`.
        """
        for name, place in effects.writes.items():
            self.writes.setdefault(name, place)
        self.force_comment = self.force_comment or effects.force_comment
        self.waits = self.waits or effects.waits
        self._add_common_effects(effects)

    def add_action(self, effects: Effects) -> None:
        """Add the effects of the action of an interrupt or a trigger: what the action writes may change at any time.

        Its force comment is not added: an action runs in parallel to the motions, and its comments are not followed.
        """
        for name, place in effects.writes.items():
            self.volatile_writes.setdefault(name, place)
        self._add_common_effects(effects)

    def _add_common_effects(self, effects: Effects) -> None:
        """Add the effects that count for called routines and actions alike: absent calls, motions, speeds, RESUME."""
        self.absent_calls = effects.absent_calls | self.absent_calls
        self.motion = self.motion or effects.motion
        self.turn_speed_place = self.turn_speed_place or effects.turn_speed_place
        self.return_motion = self.return_motion or effects.return_motion
        self.resume = self.resume or effects.resume


class _DirectEffects(Struct, eq=False):
    """Effects of the statements of a routine, without the effects of the routines that it calls.

    :ivar callees: the routines that it calls.
    :ivar action_effects: effects of the actions of the interrupts, triggers and cyclic statements that it declares.
    :ivar action_callees: the routines that these actions call.
    :ivar global_interrupts: for each GLOBAL interrupt its action alone.
    :ivar has_actions: whether it declares an interrupt, a trigger or a cyclic statement.
    """

    effects: Effects = field(default_factory=Effects)
    callees: list[Callee] = []
    action_effects: Effects = field(default_factory=Effects)
    action_callees: list[Callee] = []
    global_interrupts: list[_DirectEffects] = []
    has_actions: bool = False


class Analysis:
    """Finds the effects of routines; the effects of each routine are found once and stored.

    :param scope_of: returns the scope of the names of a routine that are not local to it.
    """

    def __init__(self, library: Library, scope_of: Callable[[Module, Routine], Scope]) -> None:
        """Begin with empty caches: effects of routines, lines with force comments, stored names of variables."""
        self.library, self.scope_of = library, scope_of
        self._direct_effects_of_routine: dict[Routine, _DirectEffects] = {}
        self._total_effects: dict[Routine, Effects] = {}
        self._force_lines_of_source: dict[Source, tuple[int, ...]] = {}
        self._names_of_routine: dict[Routine, frozenset[str]] = {}

    def effects_of(self, module: Module, routine: Routine) -> Effects:
        """Return the effects of a routine and of all routines that it may call.

        `jump` and `parameter_write` are effects of the routine's own statements alone. The result is stored.
        """
        total = self._total_effects.get(routine)
        if total is not None:
            return total
        local_effects = self._direct_effects(module, routine).effects
        total = Effects(jump=local_effects.jump, parameter_write=local_effects.parameter_write)
        for callee in self._reachable_callees([Callee(module, routine)]):
            direct = self._direct_effects(*callee)
            total.add(direct.effects)
            self._add_action_effects(total, direct)
            for interrupt in direct.global_interrupts:
                action = Effects()
                self._add_action_effects(action, interrupt)
                total.interrupt_motion = total.interrupt_motion or action.motion
        # a motion back to the point of interruption leaves the path unchanged only in the action of an interrupt
        total.motion = total.motion or total.return_motion
        self._total_effects[routine] = total
        return total

    def reachable_routines(self, module: Module, routine: Routine) -> set[Routine]:
        """Return the routine and all routines that it may call, directly or not, also by interrupts and triggers."""
        return {callee for _, callee in self._reachable_callees([Callee(module, routine)])}

    def variable_names(self, module: Module, routine: Routine) -> frozenset[str]:
        """Return the stored names of all variables in the code of a routine and of the routines that it calls.

        Local variables of these routines are left out; words that are no variables are returned as well, and so are
        data that BAS reads there.
        """
        stored_names: set[str] = set()
        for callee in self._reachable_callees([Callee(module, routine)]):
            if callee.routine not in self._names_of_routine:
                source, scope = callee.routine.source, self.scope_of(*callee)
                words: set[str] = set()
                for line in callee.routine.statement_lines:
                    names = {occurrence.name for occurrence in occurrences(source.text, *source.code_span(line))}
                    words.update(names, data_read(source, line, names))
                self._names_of_routine[callee.routine] = frozenset(
                    scope.stored_name(word) for word in words - callee.routine.local_names
                )
            stored_names |= self._names_of_routine[callee.routine]
        return frozenset(stored_names)

    def may_carry_force(self, module: Module, routine: Routine) -> bool:
        """Return whether a routine, or a routine that it calls, has a motion other than PTP; no force acts on PTP."""
        for _, callee in self._reachable_callees([Callee(module, routine)]):
            for line in (*callee.motion_lines.tolist(), *callee.statement_lines):
                stmt = statement(callee.source, line)
                if isinstance(stmt, Motion | Spline) and not stmt.word.startswith(_RAPID_WORDS):
                    return True
        return False

    def first_dependent_place(self, module: Module, routine: Routine) -> Place | None:
        """Return the first statement of a routine whose target depends on where the robot is when the routine begins.

        Routines that it calls are searched too.

        :returns: None if there is no such statement, or a complete target precedes all of them.
        """
        dependent_place, _ = self._first_dependent_place(module, routine, set())
        return dependent_place

    def _first_dependent_place(
        self, module: Module, routine: Routine, checked_routines: set[Routine]
    ) -> tuple[Place | None, bool]:
        """Return the statement of `first_dependent_place`, and whether a complete target certainly precedes any.

        :param checked_routines: routines that are not searched again; `routine` is added.
        :returns: None and True, None and False (neither a statement nor a certain target), or the statement and False.
        """
        checked_routines.add(routine)
        depth = 0  # of control structures: a target inside one may not be reached
        for line in sorted([*routine.motion_lines.tolist(), *routine.other_lines]):
            stmt, is_complete = statement(routine.source, line), False
            if stmt.word in OPENING or stmt.word == "REPEAT":
                depth += 1
            elif stmt.word in _CLOSING:
                depth -= 1
            if isinstance(stmt, Motion) and keeps_position(stmt):  # does not move
                continue
            if reads_robot_position(stmt) or (isinstance(stmt, Motion) and depends_on_position(stmt)):
                return Place(routine.source, line), False
            if isinstance(stmt, Motion):
                is_complete = True
            callee = self.library.find_callee(stmt.call.name, module) if isinstance(stmt, CallStatement) else None
            if callee is not None and callee.routine not in checked_routines:
                place, is_complete = self._first_dependent_place(*callee, checked_routines)
                if place is not None:
                    return place, False
            if is_complete and not depth:
                return None, True
        return None, False

    def force_comment_lines(self, source: Source) -> tuple[int, ...]:
        """Return the lines of a file with force comments, ascending; the result is stored."""
        if source not in self._force_lines_of_source:
            self._force_lines_of_source[source] = force_comment_lines(source)
        return self._force_lines_of_source[source]

    def effects_of_action(self, module: Module, routine: Routine, place: Place, event: Event, scope: Scope) -> Effects:
        """Return the effects of the action of an interrupt or a trigger, also on the local variables of its routine.

        Motions back to where an interrupt stopped the robot do not count as `motion`: they leave its path as it is.

        :param routine: the running routine, which declares the action at `place`.
        :param scope: scope of the running routine.
        """
        direct, total = _DirectEffects(has_actions=True), Effects()
        action = _Statement(
            self, module, routine, place, direct.action_effects, direct.action_callees, running_scope=scope
        )
        action.note_event_effects(event)
        self._add_action_effects(total, direct)
        return total

    def _add_action_effects(self, total: Effects, direct: _DirectEffects) -> None:
        """Add the effects of the actions that a routine declares, and of all routines that these actions call.

        :param total: gets the effects.
        :param direct: effects of the routine that declares the actions.
        """
        if not direct.has_actions:
            return
        total.add_action(direct.action_effects)
        total.lasting_write = total.lasting_write or direct.action_effects.parameter_write
        for callee in self._reachable_callees(direct.action_callees):
            callee_effects = self._direct_effects(*callee)
            total.add_action(callee_effects.effects)
            total.add_action(callee_effects.action_effects)
            total.lasting_write = total.lasting_write or callee_effects.action_effects.parameter_write

    def _reachable_callees(self, roots: list[Callee]) -> Iterator[Callee]:
        """Yield some routines and all routines that they may call, also by interrupts and triggers; each once."""
        unvisited = list(roots)
        queued_routines = {routine for _, routine in unvisited}  # yielded, or in `unvisited`
        while unvisited:
            caller = unvisited.pop()
            yield caller
            direct = self._direct_effects(*caller)
            for callee in (*direct.callees, *direct.action_callees):
                if callee.routine not in queued_routines:
                    queued_routines.add(callee.routine)
                    unvisited.append(callee)

    def _direct_effects(self, module: Module, routine: Routine) -> _DirectEffects:
        """Return the effects of the statements of a routine, without those of called routines; the result is stored."""
        direct = self._direct_effects_of_routine.get(routine)
        if direct is None:
            direct = self._direct_effects_of_routine[routine] = _DirectEffects()
            if routine.first_motion_line:  # plain motions, which are no statements here
                direct.effects.motion = Place(routine.source, routine.first_motion_line)
            comment_lines = self.force_comment_lines(routine.source)
            # comments after the line of DEF and before the line of END
            first, stop = bisect_right(comment_lines, routine.first), bisect_left(comment_lines, routine.last)
            if first < stop:
                direct.effects.force_comment = Place(routine.source, comment_lines[first])
            for line in routine.statement_lines:
                stmt, place = statement(routine.source, line), Place(routine.source, line)
                if isinstance(stmt, Goto) or stmt.word == "RESUME":
                    direct.effects.jump = direct.effects.jump or place
                if stmt.word == "RESUME":
                    direct.effects.resume = direct.effects.resume or place
                self._add_statement_effects(direct, stmt, Callee(module, routine), place)
        return direct

    def _add_statement_effects(self, direct: _DirectEffects, stmt: Statement, owner: Callee, place: Place) -> None:
        """Add the effects of one statement to those of its routine.

        INTERRUPT, TRIGGER, cyclic statements and IMPORT: they are added as the effects of actions.

        :param direct: gets the effects.
        :param owner: the routine that contains the statement, at `place`, and its module.
        """
        if not isinstance(stmt, Event | CyclicInput | Import):
            _Statement(self, *owner, place, direct.effects, direct.callees).note_effects(stmt)
            return
        direct.has_actions = True
        # its effects may occur at any time after the declaration
        later_statement = _Statement(self, *owner, place, direct.action_effects, direct.action_callees)
        if isinstance(stmt, Event):
            later_statement.note_event_effects(stmt)
            if stmt.is_global:
                event_effects = _DirectEffects(has_actions=True)  # the action once more, by itself
                _Statement(
                    self, *owner, place, event_effects.action_effects, event_effects.action_callees
                ).note_event_effects(stmt)
                direct.global_interrupts.append(event_effects)
        elif isinstance(stmt, CyclicInput):
            later_statement.note_write(stmt.name)
        else:
            later_statement.note_write(stmt.name)
            for name in stored_originals(stmt):
                direct.action_effects.writes.setdefault(name, place)


class _Statement(Struct, eq=False):
    """Notes the effects of one statement.

    :param effects: gets the effects of the statement; `callees` gets the routines that it calls.
    :param running_scope: scope of the routine if the routine runs: writes to its local variables are effects then. None
        if it does not run: only writes to other variables are.
    """

    analysis: Analysis
    module: Module
    routine: Routine
    place: Place
    effects: Effects
    callees: list[Callee]
    running_scope: Scope | None = None

    def note_event_effects(self, event: Event) -> None:
        """Note the effects of an INTERRUPT or a TRIGGER: its action, and functions in condition, PATH and DELAY."""
        self._note_calls(() if event.code is None else (event.code,))
        if event.action is not None:
            self.note_effects(event.action)

    def note_effects(self, stmt: Statement) -> None:
        """Note the effects of a statement: writes, motions and calls.

        Declarations and statements that cannot be read have none. BAS writes what its command sets.
        """
        if isinstance(stmt, Declaration | IdleDeclaration | Import | FaultyStatement):
            return
        if stmt.word in ("WAIT", "HALT"):
            self.effects.waits = self.effects.waits or wait_time(self.place.source, self.place.line) != 0.0
        if stmt.word == "BAS":
            command = command_of(self.place.source, stmt.call) if isinstance(stmt, CallStatement) else ""
            for name in BAS_SETS.get(command, ()):
                self.effects.writes.setdefault(name, self.place)
            return
        if isinstance(stmt, Motion) and _is_return_motion(stmt):
            self.effects.return_motion = self.effects.return_motion or self.place
        elif isinstance(stmt, Motion | Spline):
            self.effects.motion = self.effects.motion or self.place
        elif isinstance(stmt, For) and stmt.name:
            self.note_write(stmt.name)
        elif isinstance(stmt, Assignment):
            component = _PATH_COMPONENTS.get(stmt.target.name)  # other components have no effect on the path
            if stmt.target.name == "$VEL" and stmt.target.field in _TURN_SPEEDS:
                self.effects.turn_speed_place = self.effects.turn_speed_place or self.place
            if component is None or stmt.target.field in (None, component):
                self.note_write(stmt.target.name)
        self._note_calls(stmt.values)

    def _note_calls(self, values: Iterable[Value]) -> None:
        """Note the calls in some values; calls behind an expression with unbalanced brackets are not found."""
        try:
            for call in calls(values):
                self._note_call(call)
        except ProgramError:
            return

    def note_write(self, name: str) -> None:
        """Note that the statement may write a variable, if others can see it.

        Others see variables that are not local to the routine, and parameters without ``:IN``. If the routine runs, its
        local variables count too.
        """
        name = name.upper()
        if self.running_scope is not None:
            self.effects.writes.setdefault(self.running_scope.stored_name(name), self.place)
        elif name not in self.routine.local_names:
            scope = self.analysis.scope_of(self.module, self.routine)
            self.effects.writes.setdefault(scope.stored_name(name), self.place)
        elif any(parameter.name == name and not parameter.by_value for parameter in self.routine.parameters):
            self.effects.parameter_write = self.effects.parameter_write or self.place

    def _note_call(self, call: Call) -> None:
        """Note a call: the arguments that it may write, and the called routine.

        A routine that is in no file is added to `Effects.absent_calls`; functions of the controller (`STANDARD`) are
        not.
        """
        callee = self.analysis.library.find_callee(call.name, self.module)
        parameters = callee.routine.parameters if callee else ()
        for index, argument in enumerate(call.arguments):
            by_value = index < len(parameters) and parameters[index].by_value
            reference = None if by_value else writable_variable(argument)
            if reference is not None:
                self.note_write(reference.name)
        if callee is not None:
            self.callees.append(callee)
        elif call.name not in STANDARD:
            self.effects.absent_calls.setdefault(call.name, call.spelling(self.place.source))


def _is_return_motion(motion: Motion) -> bool:
    """Return whether a motion only returns to the point at which an interrupt stopped the robot."""
    target, tail = motion.end, motion.tail
    if not isinstance(target, Reference) or target.field is not None or target.name not in _RETURN_POSITIONS:
        return False
    has_empty_tail = tail.start == tail.with_stop == tail.stop and not tail.error  # neither WITH nor approximation
    return motion.via is None and not motion.frame and has_empty_tail
