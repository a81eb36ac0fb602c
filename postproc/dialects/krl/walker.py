"""The statements of a program in the order in which they run: which move the robot, and what is in force when they do.

A routine that is called is run too, statement by statement, so that what it sets is known exactly. Where it is not
certain that something runs, or how often (branches, loops, parts of expressions), all that it may write is no longer
known; what interrupts, triggers and cyclic statements write may change at any time from their declaration on.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from postproc.dialects.krl.declarations import declared_names
from postproc.dialects.krl.effects import ACTION, CYCLIC, Analysis, Effects
from postproc.dialects.krl.library import Library
from postproc.dialects.krl.moves import MoveReader
from postproc.dialects.krl.names import DECLARING, NAME, OPENING, PURE, STANDARD, TYPES, WITHOUT_MOTION, fault_of
from postproc.dialects.krl.routines import (
    MOTION_WORDS,
    SPLINES,
    Module,
    Routine,
    assignment,
    calls,
    declares,
    reference_of,
    sole_call,
    word_at,
)
from postproc.dialects.krl.rows import Collector
from postproc.dialects.krl.settings import FIELDS, RELEVANT, Settings, State
from postproc.dialects.krl.source import Place
from postproc.dialects.krl.syntax import Aggregate, Call, Reference, Value, operand, parse
from postproc.dialects.krl.variables import NOTHING, Known, Scope, Unknown
from postproc.errors import MOST, Issue, ProgramError, together

_CLOSING = {closing: opening for opening, closing in OPENING.items()} | {"UNTIL": "REPEAT"}
_ASYNCHRONOUS = frozenset({"ASYPTP", "ASYCONT", "ASYSTOP", "ASYCANCEL"})
_CONDITIONS = frozenset({"FOR", "IF", "WHILE", "UNTIL", "SWITCH"})
_FOR = re.compile(r"FOR[ \t]+([A-Za-z_$][\w$]*)", re.I | re.A)
_SIGNAL = re.compile(r"SIGNAL[ \t]+([A-Za-z_$][\w$]*)", re.I | re.A)
_LABEL = re.compile(r"[ \t]*:[ \t]*$")
_MOST_STATEMENTS = 200_000
"""So many statements of called routines are run; those of later calls count as uncertain."""
_DEEPEST = 20
_LOOP_ADVICE = "Motions in loops, branches and interrupts cannot be corrected one by one; write them out in order."
_SETTING_ADVICE = "Set $BASE, $TOOL and speeds outside of loops, branches and interrupts."


@dataclass(slots=True, eq=False)
class _Frame:
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


class Walker:
    """Follows a program through the lines that the bulk path did not read.

    :ivar moves: motions of the main routine, in order.
    :ivar blocked: (first line, last line, word): control structures of the main routine, where no motion may stand.
    :ivar still: lines of motions to where the robot is already.
    :ivar triggers: lines of TRIGGER statements of the main routine.
    :ivar moved: (line, reason): behind such a line it is not known where the robot stands.
    :ivar understood: offsets of names in the main routine whose use is followed.
    :ivar absent: called programs that are in no file: name and line of each call.
    :ivar reached: routines of the program itself that it calls.
    :ivar issues: what the user should know.
    """

    def __init__(self, library: Library, main: Routine, settings: Settings, reader: MoveReader) -> None:
        self.library, self.main, self.settings, self.reader = library, main, settings, reader
        self.source, self.variables = main.source, settings.variables
        self.moves = Collector()
        self.still: list[int] = []
        self.blocked: list[tuple[int, int, str]] = []
        self.triggers: list[int] = []
        self.moved: list[tuple[int, ProgramError]] = []
        self.understood: set[int] = set()
        self.absent: list[tuple[str, int]] = []
        self.reached: set[Routine] = set()
        self.issues: list[Issue] = []
        self.analysis = Analysis(library, self._scope)
        self.line = 0
        self._frame = _Frame(library.program, main, Scope())
        self._stack: list[Routine] = [main]
        self._steps = self._calls = 0
        self._resumable = False
        self._modules: dict[Module, Scope] = {}
        self._refused: set[int] = set()

    # --- the main routine ---------------------------------------------------------------------------------------

    def walk(self, faults: Sequence[ProgramError]) -> None:
        """Follow the main routine.

        :param faults: what is wrong with the bounds of routines.
        :raises ProgramError: something that changes motion is not understood; all such lines together.
        """
        fault = fault_of(self.main.name)
        if fault:
            raise self.source.line_error(f"{self.main.name} is not a valid name: {fault}", self.main.first)
        for module in self.library.submit():
            for routine in module.routines.values():
                self._may_change(self.analysis.of(module, routine), f"the submit program {module.name}")
        errors = list(faults)
        broken: set[str] = set()
        for line in self.main.lines:
            self.line = line
            try:
                self._statement(Place(self.source, line))
            except ProgramError as cause:
                names = [name.upper() for name in NAME.findall(self.source.text, *self.source.code_span(line))]
                if broken.isdisjoint(names):
                    errors.append(cause)
                broken.update(name for name in names[:1] if name not in FIELDS and name not in MOTION_WORDS)
                if len(errors) > MOST:
                    break
        if self._frame.open and not errors:
            word, opened = self._frame.open[-1]
            errors.append(self.source.line_error(f"{word} is not closed", opened, "Check that the file is complete."))
        if errors:
            raise together({(error.line, error.problem): error for error in reversed(errors)}.values())
        if self._frame.returned:
            self.blocked.append((self._frame.returned, self.main.last, "RETURN"))

    def misplaced(self, line: int, opener: str, opened: int) -> ProgramError:
        """Return the error for a motion inside a control structure or behind RETURN."""
        if opener == "RETURN":
            return self.source.line_error(f"the motion is never reached: RETURN in line {opened}", line)
        return self.source.line_error(f"motion inside {opener} (line {opened})", line, _LOOP_ADVICE)

    def only_comments(self, first: int, last: int) -> bool:
        """Return whether the lines first … last hold nothing but comments and other TRIGGERs."""
        for line in range(first, last + 1):
            start, stop = self.source.code_span(line)
            if start < stop and line not in self.triggers:
                return False
        return True

    # --- statements ---------------------------------------------------------------------------------------------

    @property
    def _in_main(self) -> bool:
        return self._frame.routine is self.main and len(self._stack) == 1

    @property
    def _certain(self) -> bool:
        return not self._frame.open

    def _statement(self, at: Place) -> None:
        text = at.source.text
        start, stop = at.source.code_span(at.line)
        word = word_at(text, start, stop)
        if word == "GLOBAL":
            rest = text[start + len(word) : stop].lstrip()
            start, word = stop - len(rest), word_at(rest, 0, len(rest))
        if word in MOTION_WORDS:
            if self._in_main:
                self._motion(at, word, start, stop)
        elif not self._control(at, word):
            self._other(at, word, start, stop)

    def _motion(self, at: Place, word: str, start: int, stop: int) -> None:
        frame = self._frame
        opener, opened = frame.open[-1] if frame.open else ("RETURN", frame.returned)
        if opened:
            if opened not in self._refused:
                self._refused.add(opened)
                raise self.misplaced(at.line, opener, opened)
            return
        for call in calls(at.source, start, stop):
            self._call(at, call, certain=False)
        move, names = self.reader.read(at, word, start, stop)
        self.understood.update(names)
        if move is None:
            self.still.append(at.line)
        else:
            self.moves.add(move)

    def _control(self, at: Place, word: str) -> bool:
        """Follow control structures; return whether the statement was one."""
        frame = self._frame
        if word in OPENING or word == "REPEAT":
            frame.open.append((word, at.line))
        elif word in _CLOSING:
            if not frame.open or frame.open[-1][0] != _CLOSING[word]:
                raise at.error(f"{word} without {_CLOSING[word]}")
            opener, opened = frame.open.pop()
            if not frame.open and self._in_main:
                self.blocked.append((opened, at.line, opener))
        elif word == "GOTO":
            raise at.error("GOTO changes the order of motions", _LOOP_ADVICE)
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
        frame = self._frame
        start, stop = at.source.code_span(at.line)
        start += len("RETURN")
        if at.source.text[start:stop].strip():
            frame.result = self._value(at, start, stop)
        frame.returned = frame.returned or at.line

    def _condition(self, at: Place, word: str) -> None:
        start, stop = at.source.code_span(at.line)
        for call in calls(at.source, start, stop):
            self._call(at, call, certain=False)
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
            if action := ACTION.search(text, start, stop):
                self._action(at, word, action.end(), stop)
        elif match := CYCLIC.match(text, start, stop) or _SIGNAL.match(text, start, stop):
            self._cyclic(at, match[1])
        elif word in DECLARING:
            return
        elif word == "DECL" or word in TYPES:
            self._declare(at, start, stop)
        elif word in WITHOUT_MOTION:
            for call in calls(at.source, start, stop):
                self._call(at, call, certain=False)
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
            word, opened = self._frame.open[-1]
            problem = f"what motions depend on is changed inside {word} (line {opened})"
            self.settings.perhaps(self.line, state, at.error(problem, _SETTING_ADVICE))

    def _assignment_or_call(self, at: Place, start: int, stop: int) -> None:
        found = assignment(at.source, start, stop)
        if found is not None:
            self._assign(at, *found, stop)
            return
        target, position = operand(at.source, start, stop)
        if isinstance(target, Call) and position == stop:
            for inner in calls(at.source, start + len(target.name), stop):
                self._call(at, inner, certain=False)
            self._call(at, target, certain=self._certain)
        elif isinstance(target, Reference) and _LABEL.match(at.source.text, position, stop):
            return
        elif declares(at.source.text, start, stop):
            self._declare(at, start, stop)
        else:
            raise at.error("the statement is not understood", "Check its spelling.")

    def _assign(self, at: Place, target: Reference, start: int, stop: int) -> None:
        for call in calls(at.source, target.start, target.stop):
            self._call(at, call, certain=False)
        value = self._value(at, start, stop)
        name = target.name
        if name in RELEVANT:
            self._set(at, self.settings.assigned(self.settings.state, at, target, self._given(at, start, stop, value)))
            return
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

    def _given(self, at: Place, start: int, stop: int, value: Known) -> Value | Known:
        """Return a value for what it is assigned to: as it stands in the text where that says more."""
        if sole_call(at.source, start, stop) and value != NOTHING:
            return value
        return parse(at.source, start, stop)[0]

    def _value(self, at: Place, start: int, stop: int) -> Known:
        """Return what an expression is now; run the functions in it."""
        call = sole_call(at.source, start, stop)
        for inner in calls(at.source, (call.start + len(call.name)) if call else start, stop):
            self._call(at, inner, certain=False)
        if call is not None:
            return self._call(at, call, certain=self._certain)
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

    def _call(self, at: Place, call: Call, *, certain: bool) -> Known:
        """Follow a call; return what a function gives."""
        found = self.library.find(call.name, self._frame.module)
        if found is None:
            self._absent(at, call)
            return NOTHING
        effects = self.analysis.of(*found)
        self._told(effects)
        self._check_motion(at, call, found, effects)
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
            self.absent.append((call.name, self.line))
        self._forget_arguments(at, call, None)

    def _told(self, effects: Effects) -> None:
        self.absent += [(name, self.line) for name in effects.absent]

    def _forget_arguments(self, at: Place, call: Call, routine: Routine | None) -> None:
        for index, reference in self._by_reference(at, call, routine):
            del index
            if reference.name in FIELDS:
                problem = f"{reference.name} is given to {call.name}, which may change it"
                self.settings.doubt(self.line, [FIELDS[reference.name]], at.error(problem, _SETTING_ADVICE))
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
                doubted = [FIELDS[written]] if written in FIELDS else ["base", "tool"]
                self.settings.doubt(self.line, doubted, at.error(problem, _SETTING_ADVICE))
            else:
                self.variables.forget(written, str(place))

    def _check_motion(self, at: Place, call: Call, found: tuple[Module, Routine], effects: Effects) -> None:
        """Refuse motions in routines of the program itself; behind those of another file the robot is elsewhere."""
        place = effects.motion
        if place is None or not self._in_main:
            return
        problem = f"{call.name} is called, which moves the robot ({place})"
        if place.source is self.source:
            raise at.error(problem, "Put the motions of subprograms in place of their calls.")
        advice = "Begin behind the call with a PTP to joint angles, all of A1 … A6."
        if self._frame.open:
            raise at.error(f"{problem} inside {self._frame.open[-1][0]}", advice)
        del found
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
        scope = self._local_scope(module, routine)
        variables, caller, caller_scope = self.variables, self._frame, self.variables.scope
        given: dict[int, Known] = {}
        for index, (start, stop) in enumerate(call.arguments):
            given[index] = self._value(at, start, stop) if at.source.text[start:stop].strip() else NOTHING
        for index, parameter in enumerate(routine.parameters):
            variables.put(scope.stored(parameter.name), given.get(index, NOTHING))
        frame = self._frame = _Frame(module, routine, scope)
        self._stack.append(routine)
        variables.scope = scope
        try:
            self._lines(frame)
        except ProgramError:
            return None
        finally:
            self._stack.pop()
            self._frame, variables.scope = caller, caller_scope
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
        return frame.result if frame.result != NOTHING else Unknown(str(at))

    def _lines(self, frame: _Frame) -> None:
        for line in frame.routine.lines:
            self._steps += 1
            self._statement(Place(frame.routine.source, line))
            if frame.returned:
                return

    # --- names --------------------------------------------------------------------------------------------------

    def _stored(self, name: str) -> str:
        return self.variables.scope.stored(name.upper())

    def _scope(self, module: Module, routine: Routine) -> Scope:
        """Return which variables the names of a routine mean that are not its own."""
        if routine is self.main:
            return Scope()
        if module is self.library.program:
            return Scope(own=self.main.local - routine.local, prefix=f"{module.name}/")
        if module not in self._modules:
            self._modules[module] = self._module_scope(module)
        return self._modules[module]

    def _module_scope(self, module: Module) -> Scope:
        """Return the scope of another file, its data read."""
        variables = self.variables
        hidden = frozenset(variables.types) - variables.public | self.main.local
        own, public = declared_names(module.data) if module.data is not None else (frozenset(), frozenset())
        scope = Scope(own=(hidden | own) - public - _SYSTEM_DATA, prefix=f"{module.name}/")
        if module.data is not None:
            before, variables.scope = variables.scope, scope
            try:
                variables.read_data(module.data, fill=True)
            except ProgramError:
                pass
            finally:
                variables.scope = before
        return scope

    def _local_scope(self, module: Module, routine: Routine) -> Scope:
        scope = self._scope(module, routine)
        return replace(scope, local={name: f"{name}@{self._calls}" for name in routine.local})

    # --- what may happen at any time ----------------------------------------------------------------------------

    def _action(self, at: Place, word: str, start: int, stop: int) -> None:
        """Note what an INTERRUPT or a TRIGGER may change from now on."""
        frame = self._frame
        effects = self.analysis.of_statement(frame.module, frame.routine, at.line, start, stop)
        self._told(effects)
        if effects.motion is not None:
            raise at.error(f"{word} moves the robot ({effects.motion})", _LOOP_ADVICE)
        self._resumable |= effects.resumes
        relevant = sorted(RELEVANT.intersection(effects.writes))
        if relevant:
            raise at.error(f"{word} changes what motions depend on: {', '.join(relevant)}", _SETTING_ADVICE)
        self._may_change(effects, f"{word} in {at}")

    def _may_change(self, effects: Effects, what: str) -> None:
        for name in effects.writes:
            self.variables.changing.setdefault(name, Unknown(f"by {what}"))

    def _cyclic(self, at: Place, name: str) -> None:
        self.variables.changing.setdefault(self._stored(name), Unknown(str(at)))


_SYSTEM_DATA = frozenset({"BASE_DATA", "TOOL_DATA", "FDAT_ACT", "LDAT_ACT", "PDAT_ACT"})
