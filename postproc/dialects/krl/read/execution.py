"""Statements in the order in which they run: what they set, and what is no longer known behind them.

A routine that is called is run too, statement by statement, so that what it sets is known exactly. Where it is not
certain that something runs, or how often (branches, loops, parts of expressions), all that it may write is no longer
known; what interrupts, triggers and cyclic statements write may change at any time from their declaration on.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from postproc.dialects.krl.language.expressions import Aggregate, Call, Reference, Value, operand, parse
from postproc.dialects.krl.language.names import DECLARING, OPENING, PURE, STANDARD, TYPES, WITHOUT_MOTION
from postproc.dialects.krl.language.routines import Module, Routine
from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.language.statements import (
    MOTION_WORDS,
    SPLINES,
    assignment,
    calls,
    declares,
    reference_of,
    sole_call,
    word_at,
)
from postproc.dialects.krl.read.effects import CYCLIC, IMPORTED, Analysis, Effects
from postproc.dialects.krl.read.library import Library
from postproc.dialects.krl.read.scopes import Scopes
from postproc.dialects.krl.read.settings import FIELDS, RELEVANT, Settings, State
from postproc.dialects.krl.read.variables import NOTHING, Known, Scope, Unknown
from postproc.errors import Issue, ProgramError

_CLOSING = {closing: opening for opening, closing in OPENING.items()} | {"UNTIL": "REPEAT"}
_ASYNCHRONOUS = frozenset({"ASYPTP", "ASYCONT", "ASYSTOP", "ASYCANCEL"})
_CONDITIONS = frozenset({"FOR", "IF", "WHILE", "UNTIL", "SWITCH"})
_FOR = re.compile(r"FOR[ \t]+([A-Za-z_$][\w$]*)", re.I | re.A)
_LABEL = re.compile(r"[ \t]*:[ \t]*$")
_MOST_STATEMENTS = 200_000
"""So many statements of called routines are run; those of later calls count as uncertain."""
_DEEPEST = 20
LOOP_ADVICE = "Motions in loops, branches and interrupts cannot be corrected one by one; write them out in order."
_SETTING_ADVICE = "Set $BASE, $TOOL and speeds outside of loops, branches and interrupts."


@dataclass(slots=True, eq=False)
class Level:
    """A routine that runs.

    :ivar open: control structures that are open: word and line.
    :ivar returned: line of a RETURN; 0 before.
    :ivar result: what a function returns.
    """

    module: Module
    routine: Routine
    scope: Scope
    open: list[tuple[str, int]] = field(default_factory=list)
    returned: int = 0
    result: Known = NOTHING


class Execution:
    """Runs the statements of a program, and of what it calls.

    :ivar line: of the main routine, where the run is.
    :ivar blocked: (first line, last line, word): control structures of the main routine, where no motion may stand.
    :ivar triggers: lines of TRIGGER statements of the main routine.
    :ivar moved: (line, reason): behind such a line it is not known where the robot stands.
    :ivar understood: offsets of names in the main routine whose use is followed.
    :ivar absent: calls of programs that are in no file: name as spelled, and line.
    :ivar reached: routines of the program itself that it calls.
    :ivar issues: what the user should know.
    """

    def __init__(self, library: Library, main: Routine, settings: Settings) -> None:
        self.library, self.main, self.settings = library, main, settings
        self.source, self.variables = main.source, settings.variables
        self.line = 0
        self.blocked: list[tuple[int, int, str]] = []
        self.triggers: list[int] = []
        self.moved: list[tuple[int, ProgramError]] = []
        self.understood: set[int] = set()
        self.absent: list[tuple[str, int]] = []
        self.reached: set[Routine] = set()
        self.issues: list[Issue] = []
        self._scopes = Scopes(library.program, main, self.variables)
        self.analysis = Analysis(library, self._scopes.of)
        self.level = Level(library.program, main, Scope())
        self._stack: list[Routine] = [main]
        self._steps = self._calls = 0
        self._resumable = False

    def motion(self, at: Place, word: str, start: int, stop: int) -> None:
        """Take a motion of the main routine."""
        raise NotImplementedError

    # --- statements ---------------------------------------------------------------------------------------------

    @property
    def _in_main(self) -> bool:
        return self.level.routine is self.main and len(self._stack) == 1

    @property
    def _certain(self) -> bool:
        return not self.level.open

    def statement(self, at: Place) -> None:
        """Run one statement.

        :raises ProgramError: it is not understood, or it changes motion in a way that is not modelled.
        """
        text = at.source.text
        start, stop = at.source.code_span(at.line)
        word = word_at(text, start, stop)
        if word == "GLOBAL":
            rest = text[start + len(word) : stop].lstrip()
            start, word = stop - len(rest), word_at(rest, 0, len(rest))
        if word in MOTION_WORDS:
            if self._in_main:
                self.motion(at, word, start, stop)
        elif not self._control(at, word):
            self._other(at, word, start, stop)

    def _control(self, at: Place, word: str) -> bool:
        """Follow control structures; return whether the statement was one."""
        level = self.level
        if word in OPENING or word == "REPEAT":
            level.open.append((word, at.line))
        elif word in _CLOSING:
            if not level.open or level.open[-1][0] != _CLOSING[word]:
                raise at.error(f"{word} without {_CLOSING[word]}")
            opener, opened = level.open.pop()
            if not level.open and self._in_main:
                self.blocked.append((opened, at.line, opener))
        elif word == "GOTO":
            raise at.error("GOTO changes the order of motions", LOOP_ADVICE)
        elif word == "RETURN":
            self._return(at)
        elif word in SPLINES and self._in_main:
            raise at.error(f"{word}: spline blocks are not supported", "Write the path with LIN, CIRC, SLIN or SCIRC.")
        elif word in _ASYNCHRONOUS:
            raise at.error(f"{word} moves external axes", "Only fixed external axes are supported.")
        else:
            return False
        if word in _CONDITIONS:
            self._condition(at, word)
        return True

    def _return(self, at: Place) -> None:
        if not self._certain:
            return
        level = self.level
        start, stop = at.source.code_span(at.line)
        start += len("RETURN")
        if at.source.text[start:stop].strip():
            level.result = self._value(at, start, stop)
        level.returned = level.returned or at.line

    def _condition(self, at: Place, word: str) -> None:
        start, stop = at.source.code_span(at.line)
        for call in calls(at.source, start, stop):
            self.call(at, call, certain=False)
        if word == "FOR" and (match := _FOR.match(at.source.text, start, stop)):
            self.variables.forget(self._stored(match[1]), str(at))

    def _other(self, at: Place, word: str, start: int, stop: int) -> None:
        """Follow what neither moves nor controls: settings, assignments, declarations, calls."""
        text = at.source.text
        if word == "BAS":
            self._bas(at, start, stop)
        elif word in ("INTERRUPT", "TRIGGER"):
            if word == "TRIGGER" and self._in_main:
                self.triggers.append(at.line)
            self._event(at, word, start, stop)
        elif match := CYCLIC.match(text, start, stop):
            self._cyclic(at, self._stored(match[1]))
        elif match := IMPORTED.match(text, start, stop):
            self._cyclic(at, self._stored(match[1]))
            self._cyclic(at, match[2].upper())
        elif word in DECLARING:
            return
        elif word == "DECL" or word in TYPES:
            self._declare(at, start, stop)
        elif word in WITHOUT_MOTION:
            for call in calls(at.source, start, stop):
                self.call(at, call, certain=False)
        else:
            self._assignment_or_call(at, start, stop)

    def _declare(self, at: Place, start: int, stop: int) -> None:
        names = self.variables.declare(at.source, start, stop)
        if self._in_main:
            self.understood.update(one.at for one in names)

    def _bas(self, at: Place, start: int, stop: int) -> None:
        call, _ = operand(at.source, start, stop)
        if not isinstance(call, Call) or not call.arguments:
            raise at.error("BAS is not understood", "Write BAS(#COMMAND,value).")
        self._set(at, self.settings.bas(at, call))

    def _set(self, at: Place, state: State) -> None:
        """Put a state into force, or into doubt where it is not certain that it comes into force."""
        if self._certain:
            self.settings.change(self.line, state)
        else:
            word, opened = self.level.open[-1]
            problem = f"what motions depend on is changed inside {word} (line {opened})"
            self.settings.may_become(self.line, state, at.error(problem, _SETTING_ADVICE))

    def _assignment_or_call(self, at: Place, start: int, stop: int) -> None:
        found = assignment(at.source, start, stop)
        if found is not None:
            self._assign(at, *found, stop)
            return
        target, position = operand(at.source, start, stop)
        if isinstance(target, Call) and position == stop:
            for inner in calls(at.source, start + len(target.name), stop):
                self.call(at, inner, certain=False)
            self.call(at, target, certain=self._certain)
        elif isinstance(target, Reference) and _LABEL.match(at.source.text, position, stop):
            return
        elif declares(at.source.text, start, stop):
            self._declare(at, start, stop)
        else:
            raise at.error("the statement is not understood", "Check its spelling.")

    def _assign(self, at: Place, target: Reference, start: int, stop: int) -> None:
        for call in calls(at.source, target.start, target.stop):
            self.call(at, call, certain=False)
        name = target.name
        if name in RELEVANT:
            self._set_to(at, target, start, stop)
            return
        value = self._value(at, start, stop)
        if name.startswith("$") and name != "$H_POS":
            return
        if target.field is None and self._in_main:
            self.understood.add(target.start)
        key = self.variables.key_of(at.source, target)
        if not self._certain or key is None or target.element == "":
            self.variables.forget(self._stored(name), str(at))
        elif target.field is not None:
            self.variables.set_field(key, target.field, value, str(at))
        elif value != NOTHING or name != "$H_POS":
            self.variables.set(key, value, str(at))

    def _set_to(self, at: Place, target: Reference, start: int, stop: int) -> None:
        """Follow an assignment to a variable of the controller that motions depend on."""
        value: Value | Known
        value, end = parse(at.source, start, stop)
        if at.source.text[end:stop].strip():
            raise at.error(f"{at.source.text[end:stop].strip()!r} is not understood")
        if "(" in at.source.text[start:stop]:
            known = self._value(at, start, stop)
            if isinstance(value, Call) and known != NOTHING:
                value = known
        self._set(at, self.settings.assigned(self.settings.state, at, target, value))

    def _value(self, at: Place, start: int, stop: int) -> Known:
        """Return what an expression is now; run the functions in it."""
        if "(" in at.source.text[start:stop]:
            call = sole_call(at.source, start, stop)
            for inner in calls(at.source, (call.start + len(call.name)) if call else start, stop):
                self.call(at, inner, certain=False)
            if call is not None:
                return self.call(at, call, certain=self._certain)
        value, end = parse(at.source, start, stop)
        if at.source.text[end:stop].strip():
            return Unknown(str(at))
        known = self.variables.evaluate(at.source, value)
        if isinstance(known, Aggregate) and not (isinstance(value, Aggregate) and self._in_main):
            return replace(known, computed=True)  # the text of its numbers belongs to another variable
        if known == NOTHING and not (isinstance(value, Reference) and value.name[0] != "$"):
            return Unknown(str(at))
        return known

    # --- calls --------------------------------------------------------------------------------------------------

    def call(self, at: Place, call: Call, *, certain: bool) -> Known:
        """Follow a call; return what a function gives."""
        found = self.library.find(call.name, self.level.module)
        if found is None:
            self._absent(at, call)
            return NOTHING
        effects = self.analysis.of(*found)
        self._notice(at, call.name, effects)
        self._check_motion(at, call, effects)
        if found[0] is self.library.program:
            self.reached |= {found[1]}
        if certain and not effects.jumps and not self._resumable:
            result = self._run(at, call, *found, effects)
            if result is not None:
                return result
        self._forget_arguments(at, call, found[1])
        self._perhaps(at, call.name, effects)
        return NOTHING

    def _absent(self, at: Place, call: Call) -> None:
        """Follow a call of what is in no file: it writes its arguments at most."""
        if call.name in PURE:
            return
        if call.name not in STANDARD:
            self.absent.append((call.spelt(at.source), self.line))
        self._forget_arguments(at, call, None)

    def _notice(self, at: Place, what: str, effects: Effects) -> None:
        """Note what is in no file, and what may happen at any time from now on.

        :raises ProgramError: that are frames or speeds.
        """
        self.absent += [(name, self.line) for name in effects.absent.values()]
        self._resumable |= effects.resumes
        relevant = sorted(RELEVANT.intersection(effects.anytime))
        if relevant:
            problem = f"{what} changes what motions depend on at any time: {', '.join(relevant)}"
            raise at.error(f"{problem} ({effects.anytime[relevant[0]]})", _SETTING_ADVICE)
        self.may_change(effects.anytime, what)

    def _forget_arguments(self, at: Place, call: Call, routine: Routine | None) -> None:
        for _, reference in self._by_reference(at, call, routine):
            if reference.name in FIELDS:
                problem = f"{reference.name} is given to {call.name}, which may change it"
                self.settings.make_uncertain(self.line, [FIELDS[reference.name]], at.error(problem, _SETTING_ADVICE))
            elif reference.name[0] != "$":
                self.variables.forget(self._stored(reference.name), str(at))

    def _by_reference(self, at: Place, call: Call, routine: Routine | None) -> list[tuple[int, Reference]]:
        """Return the arguments that a routine may write: variables given for a parameter without ``:IN``."""
        found = []
        for index, span in enumerate(call.arguments):
            by_value = routine is not None and index < len(routine.parameters) and routine.parameters[index].by_value
            reference = None if by_value else reference_of(at.source, span)
            if reference is not None:
                found.append((index, reference))
        return found

    def _perhaps(self, at: Place, name: str, effects: Effects) -> None:
        """Forget all that something may write that runs at an unknown time, or unknown times."""
        for written, place in effects.writes.items():
            if written in RELEVANT:
                problem = f"{name} may change {written} ({place})"
                affected = [FIELDS[written]] if written in FIELDS else ["base", "tool"]
                self.settings.make_uncertain(self.line, affected, at.error(problem, _SETTING_ADVICE))
            else:
                self.variables.forget(written, str(place))

    def _check_motion(self, at: Place, call: Call, effects: Effects) -> None:
        """Refuse motions in routines of the program itself; behind those of another file the robot is elsewhere."""
        place = effects.motion
        if place is None or not self._in_main:
            return
        problem = f"{call.name} is called, which moves the robot ({place})"
        if place.source is self.source:
            raise at.error(problem, "Put the motions of subprograms in place of their calls.")
        advice = "Begin behind the call with a PTP to joint angles, all of A1 … A6."
        if self.level.open:
            raise at.error(f"{problem} inside {self.level.open[-1][0]}", advice)
        self.moved.append((self.line, at.error(f"{problem}: where the next motion begins is not known", advice)))
        message = f"{call.name}() moves the robot ({place}): its motions are not corrected here."
        self.issues.append(Issue("warning", "motions-elsewhere", message, self.line, subject=call.name))

    def _run(self, at: Place, call: Call, module: Module, routine: Routine, effects: Effects) -> Known | None:
        """Run a routine; None if that cannot be done exactly."""
        if routine in self._stack or len(self._stack) > _DEEPEST or self._steps > _MOST_STATEMENTS:
            return None
        written = self._by_reference(at, call, routine)
        roots = [self._stored(reference.name) for _, reference in written]
        if len(set(roots)) < len(roots) or any(root in effects.writes or root in RELEVANT for root in roots):
            return None  # one variable under two names
        if any(reference.element == "" for _, reference in written) or len(call.arguments) > len(routine.parameters):
            return None
        self._calls += 1
        scope = self._scopes.of_call(module, routine, self._calls)
        variables, caller, caller_scope = self.variables, self.level, self.variables.scope
        given: dict[int, Known] = {}
        for index, (start, stop) in enumerate(call.arguments):
            given[index] = self._value(at, start, stop) if at.source.text[start:stop].strip() else NOTHING
        for index, parameter in enumerate(routine.parameters):
            variables.put(scope.stored(parameter.name), given.get(index, NOTHING))
        level = self.level = Level(module, routine, scope)
        self._stack.append(routine)
        variables.scope = scope
        try:
            self._lines(level)
        except ProgramError:
            return None
        finally:
            self._stack.pop()
            self.level, variables.scope = caller, caller_scope
        for index, reference in written:
            if index >= len(routine.parameters):
                continue
            value = variables.value(scope.stored(routine.parameters[index].name))
            if value is given[index] or value is None:
                continue
            key = variables.key_of(at.source, reference)
            if key is None:
                variables.forget(self._stored(reference.name), str(at))
            elif reference.field is not None:
                variables.set_field(key, reference.field, value, str(at))
            else:
                variables.set(key, value, str(at))
        return level.result if level.result != NOTHING else Unknown(str(at))

    def _lines(self, level: Level) -> None:
        for line in level.routine.lines:
            self._steps += 1
            self.statement(Place(level.routine.source, line))
            if level.returned:
                return

    def _stored(self, name: str) -> str:
        return self.variables.scope.stored(name.upper())

    def _event(self, at: Place, word: str, start: int, stop: int) -> None:
        """Note what an INTERRUPT or a TRIGGER may change from now on."""
        effects = self.analysis.of_action(self.level.module, self.level.routine, at.line, start, stop)
        if effects.motion is not None:
            raise at.error(f"{word} moves the robot ({effects.motion})", LOOP_ADVICE)
        self._notice(at, f"{word} in {at}", effects)

    def may_change(self, names: Mapping[str, Place], what: str) -> None:
        """Note that names may have another value at any time."""
        for name, place in names.items():
            self.variables.changing.setdefault(name, Unknown(f"by {what}, {place}"))

    def _cyclic(self, at: Place, name: str) -> None:
        self.variables.changing.setdefault(name, Unknown(str(at)))
