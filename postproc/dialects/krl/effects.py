"""What a routine may do besides returning: names it may write, motions, programs that are not there.

A point, an index, a frame or a speed is constant only if nothing that can run before its use writes it. What a routine
may write is found over all that it calls, functions in expressions and parameters by reference included, and over the
actions of the interrupts and triggers that it declares. Nothing is executed: a branch counts as taken.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from postproc.dialects.krl.library import Library
from postproc.dialects.krl.names import DECLARING, RESERVED, STANDARD
from postproc.dialects.krl.routines import (
    MOTION_WORDS,
    SPLINES,
    Module,
    Routine,
    assignment,
    calls,
    declares,
    reference_of,
    word_at,
)
from postproc.dialects.krl.settings import BAS_SETS, RELEVANT
from postproc.dialects.krl.source import Place
from postproc.dialects.krl.syntax import Call
from postproc.dialects.krl.variables import Scope
from postproc.errors import ProgramError

ACTION = re.compile(r"\bDO\b[ \t]*", re.I)
"""Behind it stands what an INTERRUPT or a TRIGGER does."""
CYCLIC = re.compile(r"(?:ANIN|DIGIN)[ \t]+ON[ \t]+([A-Za-z_$][\w$]*)", re.I | re.A)
"""The name that is written again and again until ANIN OFF."""
_SIGNAL = re.compile(r"SIGNAL[ \t]+([A-Za-z_$][\w$]*)", re.I | re.A)
_FOR = re.compile(r"FOR[ \t]+([A-Za-z_$][\w$]*)", re.I | re.A)
_COMMAND = re.compile(r"BAS[ \t]*\([ \t]*(#\w+)", re.I | re.A)
_COMPONENT = {"$VEL": "CP", "$APO": "CDIS"}
"""System variables of which but one component matters, and which."""


@dataclass(slots=True, eq=False)
class Effects:
    """What may happen.

    :ivar writes: names, as they are stored, that may get another value, and where.
    :ivar motion: where the robot moves; None if it does not.
    :ivar absent: called programs that are in no file, and where.
    :ivar jumps: True where it may not run from its first to its last line: RETURN in a branch, GOTO, RESUME.
    :ivar resumes: True where RESUME may break off what is running.
    """

    writes: dict[str, Place] = field(default_factory=dict)
    motion: Place | None = None
    absent: dict[str, Place] = field(default_factory=dict)
    jumps: bool = False
    resumes: bool = False

    def add(self, other: Effects) -> None:
        """Take what a called routine may do."""
        for name, place in other.writes.items():
            self.writes.setdefault(name, place)
        for name, place in other.absent.items():
            self.absent.setdefault(name, place)
        self.motion = self.motion or other.motion
        self.resumes = self.resumes or other.resumes


class Analysis:
    """Finds the effects of routines, each once.

    :param scope_of: which variables the names of a routine mean; None for its own.
    """

    def __init__(self, library: Library, scope_of: Callable[[Module, Routine], Scope]) -> None:
        self.library, self.scope_of = library, scope_of
        self._direct: dict[Routine, tuple[Effects, list[tuple[Module, Routine]]]] = {}
        self._all: dict[Routine, Effects] = {}

    def of(self, module: Module, routine: Routine) -> Effects:
        """Return what a routine may do, all that it calls included."""
        if routine not in self._all:
            own, _ = self._of_routine(module, routine)
            total = Effects(jumps=own.jumps)
            for reached in self._reached(module, routine):
                total.add(self._of_routine(*reached)[0])
            self._all[routine] = total
        return self._all[routine]

    def of_statement(self, module: Module, routine: Routine, line: int, start: int, stop: int) -> Effects:
        """Return what one statement of a routine may do: the action of an interrupt or a trigger."""
        total = Effects()
        called: list[tuple[Module, Routine]] = []
        _Statement(self, module, routine, Place(routine.source, line), total, called).read(start, stop)
        for reached in called:
            total.add(self.of(*reached))
        return total

    def _reached(self, module: Module, routine: Routine) -> Iterator[tuple[Module, Routine]]:
        seen, waiting = {routine}, [(module, routine)]
        while waiting:
            reached = waiting.pop()
            yield reached
            for following in self._of_routine(*reached)[1]:
                if following[1] not in seen:
                    seen.add(following[1])
                    waiting.append(following)

    def _of_routine(self, module: Module, routine: Routine) -> tuple[Effects, list[tuple[Module, Routine]]]:
        known = self._direct.get(routine)
        if known is None:
            effects = Effects()
            called: list[tuple[Module, Routine]] = []
            if routine.motion:
                effects.motion = Place(routine.source, routine.motion)
            depth = 0
            for line in routine.lines:
                start, stop = routine.source.code_span(line)
                word = word_at(routine.source.text, start, stop)
                depth += (word in _OPENS) - (word in _CLOSES)
                effects.jumps |= word in ("GOTO", "RESUME") or (word == "RETURN" and depth > 0)
                effects.resumes |= word == "RESUME"
                statement = _Statement(self, module, routine, Place(routine.source, line), effects, called)
                statement.read(start, stop)
            known = self._direct[routine] = effects, called
        return known


_OPENS = frozenset({"IF", "FOR", "WHILE", "LOOP", "REPEAT", "SWITCH"})
_CLOSES = frozenset({"ENDIF", "ENDFOR", "ENDWHILE", "ENDLOOP", "UNTIL", "ENDSWITCH"})


@dataclass(slots=True, eq=False)
class _Statement:
    """Notes what one statement may do."""

    analysis: Analysis
    module: Module
    routine: Routine
    place: Place
    effects: Effects
    called: list[tuple[Module, Routine]]

    def read(self, start: int, stop: int) -> None:
        """Note what the statement at a span may do; what cannot be read does nothing that could be noted."""
        source = self.place.source
        text = source.text
        word = word_at(text, start, stop)
        if word in MOTION_WORDS or word in SPLINES:
            self.effects.motion = self.effects.motion or self.place
        elif match := _SIGNAL.match(text, start, stop):
            self._writes(match[1])
        elif word in DECLARING or declares(text, start, stop):
            return
        elif word in ("INTERRUPT", "TRIGGER"):
            if action := ACTION.search(text, start, stop):
                self.read(action.end(), stop)
            return
        elif word == "BAS":
            command = _COMMAND.match(text, start, stop)
            for name in BAS_SETS.get(command[1].upper(), ()) if command else ():
                self.effects.writes.setdefault(name, self.place)
            return
        elif match := CYCLIC.match(text, start, stop) or _FOR.match(text, start, stop):
            self._writes(match[1])
        try:
            self._assigned(start, stop, word)
            for call in calls(source, start, stop):
                self._called(call)
        except ProgramError:
            return

    def _assigned(self, start: int, stop: int, word: str) -> None:
        found = assignment(self.place.source, start, stop) if word not in RESERVED else None
        if found is None:
            return
        target = found[0]
        component = _COMPONENT.get(target.name)
        if component is None or target.field in (None, component):
            self._writes(target.name)

    def _writes(self, name: str) -> None:
        name = name.upper()
        if name not in self.routine.local:
            scope = self.analysis.scope_of(self.module, self.routine)
            self.effects.writes.setdefault(scope.stored(name), self.place)

    def _called(self, call: Call) -> None:
        found = self.analysis.library.find(call.name, self.module)
        parameters = found[1].parameters if found else ()
        for index, span in enumerate(call.arguments):
            by_value = index < len(parameters) and parameters[index].by_value
            reference = None if by_value else reference_of(self.place.source, span)
            if reference is not None and (reference.name[0] != "$" or reference.name in RELEVANT):
                self._writes(reference.name)
        if found is not None:
            self.called.append(found)
        elif call.name not in STANDARD:
            self.effects.absent.setdefault(call.name, self.place)
