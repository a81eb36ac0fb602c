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
from postproc.dialects.krl.language.routines import Module, Routine
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.tokens import occurrences
from postproc.dialects.krl.language.tree import (
    Assignment,
    CallStatement,
    Cyclic,
    Declaration,
    Event,
    Faulty,
    For,
    Goto,
    Imported,
    Motion,
    Outside,
    Spline,
    Statement,
)
from postproc.dialects.krl.language.values import Call, Reference, Value, writable
from postproc.dialects.krl.read.bas import BAS_SETS, command_of
from postproc.dialects.krl.read.comments import noted_lines
from postproc.dialects.krl.read.folder import Library
from postproc.dialects.krl.read.known import Scope
from postproc.dialects.krl.read.motion_reader import asks_position, from_here, stays
from postproc.errors import ProgramError

_CLOSING = frozenset({*OPENING.values(), "UNTIL"})
_STOPPED = frozenset({"$AXIS_RET", "$POS_RET"})
"""Where the robot left its path when it was stopped by an interrupt (KUKA, System Variables)."""
_RAPID = ("PTP", "SPTP")
_COMPONENT = {"$VEL": "CP", "$APO": "CDIS"}
"""System variables of which but one component matters, and which."""


class Effects(Struct, eq=False):
    """Side effects.

    :ivar writes: names, as they are stored, that may get another value while it runs, and where.
    :ivar anytime: names that may get another value at any time afterwards: by interrupts, triggers, cyclic statements.
    :ivar motion: where the robot moves; None if it does not.
    :ivar interrupting: where a GLOBAL interrupt moves the robot that it declares; None if none does.
    :ivar back: motion back to the point at which an interrupt stopped the robot.
    :ivar force: place of a force comment; None if there is none.
    :ivar absent: called programs that are in no file, by name: as they are spelled.
    :ivar jumps: GOTO or RESUME, so that it may not run line by line; None if there is none.
    :ivar resumes: RESUME that may break off the running routine; None if there is none.
    :ivar parameter: where a parameter without :IN is written; None if none is.
    :ivar lasting: where such a parameter, and so the variable given for it, is said to change at any time from then on.
    """

    writes: dict[str, Place] = {}
    anytime: dict[str, Place] = {}
    motion: Place | None = None
    interrupting: Place | None = None
    back: Place | None = None
    force: Place | None = None
    absent: dict[str, str] = {}
    jumps: Place | None = None
    resumes: Place | None = None
    parameter: Place | None = None
    lasting: Place | None = None

    def add(self, other: Effects) -> None:
        """Add the effects of a called routine."""
        for name, place in other.writes.items():
            self.writes.setdefault(name, place)
        for name, place in other.anytime.items():
            self.anytime.setdefault(name, place)
        self.force = self.force or other.force
        self._add_rest(other)

    def add_action(self, other: Effects) -> None:
        """Add the effects of an interrupt or a trigger."""
        for name, place in (other.writes | other.anytime).items():
            self.anytime.setdefault(name, place)
        self._add_rest(other)

    def _add_rest(self, other: Effects) -> None:
        self.absent = other.absent | self.absent
        self.motion = self.motion or other.motion
        self.back = self.back or other.back
        self.resumes = self.resumes or other.resumes


Called = tuple[Module, Routine]


class _Direct(Struct, eq=False):
    """Effects of a routine itself, and its calls; the same for the actions that it declares."""

    now: Effects = field(default_factory=Effects)
    called: list[Called] = []
    later: Effects = field(default_factory=Effects)
    called_later: list[Called] = []
    public: list[_Direct] = []
    """For each GLOBAL interrupt its action alone."""


class Analysis:
    """Finds the effects of routines, each once.

    :param scope_of: scope of the non-local names of a routine.
    """

    def __init__(self, library: Library, scope_of: Callable[[Module, Routine], Scope]) -> None:
        self.library, self.scope_of = library, scope_of
        self._direct: dict[Routine, _Direct] = {}
        self._all: dict[Routine, Effects] = {}
        self._noted: dict[Source, tuple[int, ...]] = {}
        self._names: dict[Routine, frozenset[str]] = {}

    def of(self, module: Module, routine: Routine) -> Effects:
        """Return the effects of a routine, including all that it calls."""
        if routine not in self._all:
            now = self._of_routine(module, routine).now
            total = Effects(jumps=now.jumps, parameter=now.parameter)
            for reached in self._reached([(module, routine)]):
                direct = self._of_routine(*reached)
                total.add(direct.now)
                self._add_later(total, direct)
                for event in direct.public:
                    action = Effects()
                    self._add_later(action, event)
                    total.interrupting = total.interrupting or action.motion
            total.motion = total.motion or total.back
            self._all[routine] = total
        return self._all[routine]

    def reached(self, module: Module, routine: Routine) -> set[Routine]:
        """Return the routine and all routines that it may call, directly or not, also by interrupts and triggers."""
        return {other for _, other in self._reached([(module, routine)])}

    def names(self, module: Module, routine: Routine) -> frozenset[str]:
        """Return the names, as they are stored, of all variables in the code of a routine and of all that it calls."""
        found: set[str] = set()
        for where in self._reached([(module, routine)]):
            if where[1] not in self._names:
                source, scope = where[1].source, self.scope_of(*where)
                spans = [source.code_span(line) for line in where[1].lines]
                words = {one.name for span in spans for one in occurrences(source.text, *span)}
                self._names[where[1]] = frozenset(scope.stored(word) for word in words - where[1].local)
            found |= self._names[where[1]]
        return frozenset(found)

    def cuts(self, module: Module, routine: Routine) -> bool:
        """Return whether a routine, or one that it calls, moves by other than PTP, which carries no force."""
        for _, reached in self._reached([(module, routine)]):
            for line in (*reached.plain.tolist(), *reached.lines):
                here = statement(reached.source, line)
                if isinstance(here, Motion | Spline) and not here.word.startswith(_RAPID):
                    return True
        return False

    def from_here(self, module: Module, routine: Routine) -> Place | None:
        """Return the statement of a routine, or of one that it calls, whose target depends on where the robot is when
        the routine begins; None if a complete target precedes all of these.
        """
        return self._from_here(module, routine, set())[0]

    def _from_here(self, module: Module, routine: Routine, seen: set[Routine]) -> tuple[Place | None, bool]:
        """Return that statement, and whether the routine surely moves to a complete target."""
        seen.add(routine)
        depth = 0
        for line in sorted([*routine.plain.tolist(), *routine.others]):
            here, complete = statement(routine.source, line), False
            depth += (here.word in OPENING or here.word == "REPEAT") - (here.word in _CLOSING)
            if isinstance(here, Motion) and stays(here):
                continue
            if asks_position(here) or (isinstance(here, Motion) and from_here(here)):
                return Place(routine.source, line), False
            if isinstance(here, Motion):
                complete = True
            called = self.library.find(here.call.name, module) if isinstance(here, CallStatement) else None
            if called is not None and called[1] not in seen:
                place, complete = self._from_here(*called, seen)
                if place is not None:
                    return place, False
            if complete and not depth:
                return None, True
        return None, False

    def noted(self, source: Source) -> tuple[int, ...]:
        """Return the lines of a file with force comments."""
        if source not in self._noted:
            self._noted[source] = noted_lines(source)
        return self._noted[source]

    def of_action(self, module: Module, routine: Routine, place: Place, event: Event, scope: Scope) -> Effects:
        """Return the effects of an interrupt or a trigger in a routine that runs, on its own variables too.

        Motions back to where an interrupt has stopped the robot leave its path as it is: they are not among them.
        """
        direct, total = _Direct(), Effects()
        _Statement(self, module, routine, place, direct.later, direct.called_later, scope).read_event(event)
        self._add_later(total, direct)
        return total

    def _add_later(self, total: Effects, direct: _Direct) -> None:
        total.add_action(direct.later)
        total.lasting = total.lasting or direct.later.parameter
        for reached in self._reached(direct.called_later):
            other = self._of_routine(*reached)
            total.add_action(other.now)
            total.add_action(other.later)
            total.lasting = total.lasting or other.later.parameter

    def _reached(self, first: list[Called]) -> Iterator[Called]:
        """Yield routines and all that they call, the actions that they declare included."""
        waiting = list(first)
        seen = {routine for _, routine in waiting}
        while waiting:
            reached = waiting.pop()
            yield reached
            direct = self._of_routine(*reached)
            for following in (*direct.called, *direct.called_later):
                if following[1] not in seen:
                    seen.add(following[1])
                    waiting.append(following)

    def _of_routine(self, module: Module, routine: Routine) -> _Direct:
        known = self._direct.get(routine)
        if known is None:
            known = self._direct[routine] = _Direct()
            if routine.motion:
                known.now.motion = Place(routine.source, routine.motion)
            noted = self.noted(routine.source)
            if (first := bisect_right(noted, routine.first)) < bisect_left(noted, routine.last):
                known.now.force = Place(routine.source, noted[first])
            for line in routine.lines:
                here, place = statement(routine.source, line), Place(routine.source, line)
                if isinstance(here, Goto) or here.word == "RESUME":
                    known.now.jumps = known.now.jumps or place
                if here.word == "RESUME":
                    known.now.resumes = known.now.resumes or place
                self._read(known, here, (module, routine), place)
        return known

    def _read(self, direct: _Direct, here: Statement, where: Called, place: Place) -> None:
        """Note the effects of one statement."""
        later = _Statement(self, *where, place, direct.later, direct.called_later)
        if isinstance(here, Event):
            later.read_event(here)
            if here.public:
                alone = _Direct()
                _Statement(self, *where, place, alone.later, alone.called_later).read_event(here)
                direct.public.append(alone)
        elif isinstance(here, Cyclic):
            later.writes(here.name)
        elif isinstance(here, Imported):
            later.writes(here.name)
            direct.later.writes.setdefault(here.original, place)
        else:
            _Statement(self, *where, place, direct.now, direct.called).read(here)


class _Statement(Struct, eq=False):
    """Notes the effects of one statement."""

    analysis: Analysis
    module: Module
    routine: Routine
    place: Place
    effects: Effects
    called: list[Called]
    running: Scope | None = None

    def read_event(self, event: Event) -> None:
        """Note the effects of an INTERRUPT or a TRIGGER: its action, and functions in condition, PATH and DELAY."""
        self._calls(() if event.code is None else (event.code,))
        if event.action is not None:
            self.read(event.action)

    def read(self, here: Statement) -> None:
        """Note the effects of a statement; a statement that cannot be read has none."""
        if isinstance(here, Declaration | Outside | Imported | Faulty):
            return
        if here.word == "BAS":
            command = command_of(self.place.source, here.call) if isinstance(here, CallStatement) else ""
            for name in BAS_SETS.get(command, ()):
                self.effects.writes.setdefault(name, self.place)
            return
        if isinstance(here, Motion) and _leads_back(here):
            self.effects.back = self.effects.back or self.place
        elif isinstance(here, Motion | Spline):
            self.effects.motion = self.effects.motion or self.place
        elif isinstance(here, For) and here.name:
            self.writes(here.name)
        elif isinstance(here, Assignment):
            component = _COMPONENT.get(here.target.name)
            if component is None or here.target.field in (None, component):
                self.writes(here.target.name)
        self._calls(here.values)

    def _calls(self, values: Iterable[Value]) -> None:
        try:
            for call in calls(values):
                self._called(call)
        except ProgramError:
            return

    def writes(self, name: str) -> None:
        """Note that a variable may get another value."""
        name = name.upper()
        if self.running is not None:
            self.effects.writes.setdefault(self.running.stored(name), self.place)
        elif name not in self.routine.local:
            scope = self.analysis.scope_of(self.module, self.routine)
            self.effects.writes.setdefault(scope.stored(name), self.place)
        elif any(parameter.name == name and not parameter.by_value for parameter in self.routine.parameters):
            self.effects.parameter = self.effects.parameter or self.place

    def _called(self, call: Call) -> None:
        found = self.analysis.library.find(call.name, self.module)
        parameters = found[1].parameters if found else ()
        for index, argument in enumerate(call.arguments):
            by_value = index < len(parameters) and parameters[index].by_value
            reference = None if by_value else writable(argument)
            if reference is not None:
                self.writes(reference.name)
        if found is not None:
            self.called.append(found)
        elif call.name not in STANDARD:
            self.effects.absent.setdefault(call.name, call.spelt(self.place.source))


def _leads_back(motion: Motion) -> bool:
    """Return whether a motion only returns to the point at which an interrupt stopped the robot."""
    target, tail = motion.end, motion.tail
    if not isinstance(target, Reference) or target.field is not None or target.name not in _STOPPED:
        return False
    return motion.via is None and not motion.frame and tail.start == tail.behind == tail.stop and not tail.error
