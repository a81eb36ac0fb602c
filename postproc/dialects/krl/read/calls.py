"""Calls: a routine that is called is run too, statement by statement, where that can be done exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from postproc.dialects.krl.language.expressions import parse
from postproc.dialects.krl.language.names import PURE, STANDARD
from postproc.dialects.krl.language.routines import Module, Routine
from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.language.statements import calls, reference_of, sole_call
from postproc.dialects.krl.language.values import Aggregate, Call, Reference
from postproc.dialects.krl.read.effects import Effects
from postproc.dialects.krl.read.known import NOTHING, Known, Unknown
from postproc.dialects.krl.read.run import SETTING_ADVICE, Level, Run
from postproc.dialects.krl.read.state import FIELDS, RELEVANT
from postproc.errors import Issue, ProgramError

_MOST_STATEMENTS = 200_000
"""So many statements of called routines are run; those of later calls count as uncertain."""
_DEEPEST = 20


class Calls:
    """Follows calls, and expressions with calls in them.

    :param run: the program as far as it has run.
    :param statement: runs one statement.
    """

    def __init__(self, run: Run, statement: Callable[[Place], None]) -> None:
        self.run, self._statement = run, statement

    def value(self, at: Place, start: int, stop: int) -> Known:
        """Return what an expression is now; run the functions in it."""
        if "(" in at.source.text[start:stop]:
            call = sole_call(at.source, start, stop)
            for inner in calls(at.source, (call.start + len(call.name)) if call else start, stop):
                self.call(at, inner, certain=False)
            if call is not None:
                return self.call(at, call, certain=self.run.certain)
        value, end = parse(at.source, start, stop)
        if at.source.text[end:stop].strip():
            return Unknown(str(at))
        known = self.run.variables.evaluate(at.source, value)
        if isinstance(known, Aggregate) and not (isinstance(value, Aggregate) and self.run.in_main):
            return replace(known, computed=True)  # the text of its numbers belongs to another variable
        if known == NOTHING and not (isinstance(value, Reference) and value.name[0] != "$"):
            return Unknown(str(at))
        return known

    def call(self, at: Place, call: Call, *, certain: bool) -> Known:
        """Follow a call; return what a function gives."""
        found = self.run.library.find(call.name, self.run.level.module)
        if found is None:
            self._absent(at, call)
            return NOTHING
        effects = self.run.analysis.of(*found)
        self.notice(at, call.name, effects)
        self._check_motion(at, call, effects)
        if found[0] is self.run.library.program:
            self.run.reached |= {found[1]}
        if certain and not effects.jumps and not self.run.resumable:
            result = self._executed(at, call, *found, effects)
            if result is not None:
                return result
        self._forget_arguments(at, call, found[1])
        self._may_have_run(at, call.name, effects)
        return NOTHING

    def _absent(self, at: Place, call: Call) -> None:
        """Follow a call of what is in no file: it writes its arguments at most."""
        if call.name in PURE:
            return
        if call.name not in STANDARD:
            self.run.absent.append((call.spelt(at.source), self.run.line))
        self._forget_arguments(at, call, None)

    def notice(self, at: Place, what: str, effects: Effects) -> None:
        """Note what is in no file, and what may happen at any time from now on.

        :raises ProgramError: that are frames or speeds.
        """
        self.run.absent += [(name, self.run.line) for name in effects.absent.values()]
        self.run.resumable |= effects.resumes
        relevant = sorted(RELEVANT.intersection(effects.anytime))
        if relevant:
            problem = f"{what} changes what motions depend on at any time: {', '.join(relevant)}"
            raise at.error(f"{problem} ({effects.anytime[relevant[0]]})", SETTING_ADVICE)
        self.run.may_change(effects.anytime, what)

    def _forget_arguments(self, at: Place, call: Call, routine: Routine | None) -> None:
        for _, reference in self._by_reference(at, call, routine):
            if reference.name in FIELDS:
                problem = f"{reference.name} is given to {call.name}, which may change it"
                self.run.settings.make_uncertain(
                    self.run.line, [FIELDS[reference.name]], at.error(problem, SETTING_ADVICE)
                )
            elif reference.name[0] != "$":
                self.run.variables.forget(self.run.stored(reference.name), str(at))

    def _by_reference(self, at: Place, call: Call, routine: Routine | None) -> list[tuple[int, Reference]]:
        """Return the arguments that a routine may write: variables given for a parameter without ``:IN``."""
        found = []
        for index, span in enumerate(call.arguments):
            by_value = routine is not None and index < len(routine.parameters) and routine.parameters[index].by_value
            reference = None if by_value else reference_of(at.source, span)
            if reference is not None:
                found.append((index, reference))
        return found

    def _may_have_run(self, at: Place, name: str, effects: Effects) -> None:
        """Forget all that something may write that runs at an unknown time, or unknown times."""
        for written, place in effects.writes.items():
            if written in RELEVANT:
                problem = f"{name} may change {written} ({place})"
                affected = [FIELDS[written]] if written in FIELDS else ["base", "tool"]
                self.run.settings.make_uncertain(self.run.line, affected, at.error(problem, SETTING_ADVICE))
            else:
                self.run.variables.forget(written, str(place))

    def _check_motion(self, at: Place, call: Call, effects: Effects) -> None:
        """Refuse motions in routines of the program itself; behind those of another file the robot is elsewhere."""
        place = effects.motion
        if place is None or not self.run.in_main:
            return
        problem = f"{call.name} is called, which moves the robot ({place})"
        if place.source is self.run.source:
            raise at.error(problem, "Put the motions of subprograms in place of their calls.")
        advice = "Begin behind the call with a PTP to joint angles, all of A1 … A6."
        if self.run.level.open:
            raise at.error(f"{problem} inside {self.run.level.open[-1][0]}", advice)
        self.run.moved.append(
            (self.run.line, at.error(f"{problem}: where the next motion begins is not known", advice))
        )
        message = f"{call.name}() moves the robot ({place}): its motions are not corrected here."
        self.run.issues.append(Issue("warning", "motions-elsewhere", message, self.run.line, subject=call.name))

    def _executed(self, at: Place, call: Call, module: Module, routine: Routine, effects: Effects) -> Known | None:
        """Run a routine; None if that cannot be done exactly."""
        if routine in self.run.stack or len(self.run.stack) > _DEEPEST or self.run.steps > _MOST_STATEMENTS:
            return None
        written = self._by_reference(at, call, routine)
        roots = [self.run.stored(reference.name) for _, reference in written]
        if len(set(roots)) < len(roots) or any(root in effects.writes or root in RELEVANT for root in roots):
            return None  # one variable under two names
        if any(reference.element == "" for _, reference in written) or len(call.arguments) > len(routine.parameters):
            return None
        self.run.calls += 1
        scope = self.run.scopes.of_call(module, routine, self.run.calls)
        variables, caller, caller_scope = self.run.variables, self.run.level, self.run.variables.scope
        given: dict[int, Known] = {}
        for index, (start, stop) in enumerate(call.arguments):
            given[index] = self.value(at, start, stop) if at.source.text[start:stop].strip() else NOTHING
        for index, parameter in enumerate(routine.parameters):
            variables.put(scope.stored(parameter.name), given.get(index, NOTHING))
        level = self.run.level = Level(module, routine, scope)
        self.run.stack.append(routine)
        variables.scope = scope
        try:
            self._lines(level)
        except ProgramError:
            return None
        finally:
            self.run.stack.pop()
            self.run.level, variables.scope = caller, caller_scope
        for index, reference in written:
            if index >= len(routine.parameters):
                continue
            value = variables.value(scope.stored(routine.parameters[index].name))
            if value is given[index] or value is None:
                continue
            key = variables.key_of(at.source, reference)
            if key is None:
                variables.forget(self.run.stored(reference.name), str(at))
            elif reference.field is not None:
                variables.set_field(key, reference.field, value, str(at))
            else:
                variables.set(key, value, str(at))
        return level.result if level.result != NOTHING else Unknown(str(at))

    def _lines(self, level: Level) -> None:
        for line in level.routine.lines:
            self.run.steps += 1
            self._statement(Place(level.routine.source, line))
            if level.returned:
                return
