"""Statements in the order in which they run: what they set, and what is no longer known behind them.

Where it is not certain that something runs, or how often (branches, loops, parts of expressions), all that it may write
is no longer known; what interrupts, triggers and cyclic statements write may change at any time from their declaration
on.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from postproc.dialects.krl.language.expressions import operand, parse
from postproc.dialects.krl.language.names import DECLARING, NAME, OPENING, TYPES, WITHOUT_MOTION
from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.language.statements import (
    MOTION_WORDS,
    REFERRING,
    SPLINES,
    TIMED,
    assignment,
    calls,
    declares,
    word_at,
)
from postproc.dialects.krl.language.structures import LOOPS
from postproc.dialects.krl.language.values import Call, Reference, Value, Word
from postproc.dialects.krl.read.calls import Calls
from postproc.dialects.krl.read.data_lists import declare
from postproc.dialects.krl.read.effects import CYCLIC, IMPORTED
from postproc.dialects.krl.read.inexact import inexact
from postproc.dialects.krl.read.known import NOTHING, Known, Unknown
from postproc.dialects.krl.read.run import SETTING_ADVICE, Run
from postproc.dialects.krl.read.state import RELEVANT, State
from postproc.dialects.krl.read.variables import converted

_CLOSING = {closing: opening for opening, closing in OPENING.items()} | {"UNTIL": "REPEAT"}
_ASYNCHRONOUS = frozenset({"ASYPTP", "ASYCONT", "ASYSTOP", "ASYCANCEL"})
_SUPERPOSED = frozenset({"$TECH", "$TECH_C", "$SPL_TECH", "$SPL_TECH_C"})
"""Function generators, which swing the tool about its path (KUKA, System Variables)."""
_CONDITIONS = frozenset({"FOR", "IF", "WHILE", "UNTIL", "SWITCH"})
_FOR = re.compile(r"FOR[ \t]+([A-Za-z_$][\w$]*)", re.I | re.A)
_LABEL = re.compile(r"[ \t]*:[ \t]*$")
_IN_ORDER = "Motions of interrupts cannot be corrected; write them out in order."
JUMP = "it is not known before the program runs whether GOTO is run, and with it what runs next"
JUMP_ADVICE = (
    "Write LOOP with EXIT, FOR, WHILE or IF around the motions instead, or the motions in order; --keep-unresolved "
    "cannot leave it as it is."
)
LOOP_ADVICE = (
    "Motions in loops and branches are corrected where it is known before the program runs what is executed, and how "
    "often: write them out in order, or leave them as they are by --keep-unresolved."
)


class Interpreter:
    """Runs the statements of a program, and of what it calls.

    :param run: the program as far as it has run.
    :param motion: takes a motion of the program: where it stands, its instruction in upper case, offsets of the
        instruction and behind the code of the line.
    :param called: runs the routine that was called.
    :param entered: goes into a routine that moves, in the course of the program; False where it does not.
    """

    def __init__(
        self,
        run: Run,
        motion: Callable[[Place, str, int, int], None],
        called: Callable[[], None],
        entered: Callable[[Place, Call], bool],
    ) -> None:
        self.run, self._motion, self._entered = run, motion, entered
        self.calls = Calls(run, called)

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
        if word in MOTION_WORDS or word in SPLINES or word == "ENDSPLINE":
            if self.run.in_main:
                self._motion(at, word, start, stop)
        elif not self._control(at, word):
            self._other(at, word, start, stop)

    def _control(self, at: Place, word: str) -> bool:
        """Follow control structures; return whether the statement was one."""
        level = self.run.level
        if word in OPENING or word == "REPEAT":
            level.open.append((word, at.line))
        elif word in _CLOSING:
            if not level.open or level.open[-1][0] != _CLOSING[word]:
                raise at.error(f"{word} without {_CLOSING[word]}")
            level.open.pop()
        elif word == "GOTO":
            raise at.error(JUMP, JUMP_ADVICE)
        elif word == "RETURN":
            self._return(at)
        elif word in TIMED:
            self._timed(at, word)
        elif word in _ASYNCHRONOUS:
            raise at.error(f"{word} moves external axes", "Only fixed external axes are supported.")
        else:
            return False
        if word in _CONDITIONS:
            self._condition(at, word)
        return True

    def _timed(self, at: Place, word: str) -> None:
        """Follow a statement that says how fast spline motions are driven: it stays as it is.

        :raises ProgramError: it is not understood, or stands where none can.
        """
        start, stop = at.source.code_span(at.line)
        if not TIMED[word].fullmatch(at.source.text, start, stop):
            raise at.error("the statement is not understood", "Check its spelling.")
        for call in calls(at.source, start, stop):
            self.calls.call(at, call, certain=False)
        if not self.run.in_main:
            return
        if word != "STOP" and not self.run.settings.state.block:
            raise at.error(f"{word} outside of a spline block", "Write it between SPLINE and ENDSPLINE.")
        if word in REFERRING:
            self.run.triggers.append(at.line)

    def _return(self, at: Place) -> None:
        level = self.run.level
        if not self.run.certain:
            if not level.traced or len(self.run.stack) > 1:
                raise inexact(at, "it is not known whether it returns here")
            return
        start, stop = at.source.code_span(at.line)
        start += len("RETURN")
        if at.source.text[start:stop].strip():
            level.result = converted(self.calls.value(at, start, stop), level.routine.result)
        level.returned = level.returned or at.line

    def _condition(self, at: Place, word: str) -> None:
        start, stop = at.source.code_span(at.line)
        for call in calls(at.source, start, stop):
            self.calls.call(at, call, certain=False)
        if word == "FOR" and (match := _FOR.match(at.source.text, start, stop)):
            self.run.variables.forget(self.run.stored(match[1]), str(at))

    def _other(self, at: Place, word: str, start: int, stop: int) -> None:
        """Follow what neither moves nor controls: settings, assignments, declarations, calls."""
        text = at.source.text
        if word == "BAS":
            self._bas(at, start, stop)
        elif word in ("INTERRUPT", "TRIGGER"):
            if word == "TRIGGER" and self.run.in_main:
                self.run.triggers.append(at.line)
            self._event(at, word, start, stop)
        elif match := CYCLIC.match(text, start, stop):
            self.run.changes_always(at, self.run.stored(match[1]))
        elif match := IMPORTED.match(text, start, stop):
            self.run.changes_always(at, self.run.stored(match[1]))
            self.run.changes_always(at, match[2].upper())
        elif word == "STRUC":
            self._declare(at, start, stop)
        elif word in DECLARING:
            return
        elif word == "EXIT":
            self._exit(at)
        elif word in ("DECL", "CONST") or word in TYPES:
            self._declare(at, start, stop)
        elif word in WITHOUT_MOTION:
            for call in calls(at.source, start, stop):
                self.calls.call(at, call, certain=False)
        else:
            self._assignment_or_call(at, start, stop)

    def _exit(self, at: Place) -> None:
        """Note that a loop that is followed may be left."""
        level = self.run.level
        if level.loops and not any(word in LOOPS for word, _ in level.open):
            raise inexact(at, "it is not known whether the loop is left here")

    def _declare(self, at: Place, start: int, stop: int) -> None:
        names = declare(self.run.variables, at.source, start, stop)
        if self.run.in_main:
            self.run.understood.update(one.at for one in names)

    def _bas(self, at: Place, start: int, stop: int) -> None:
        call, _ = operand(at.source, start, stop)
        if not isinstance(call, Call) or not call.arguments:
            raise at.error("BAS is not understood", "Write BAS(#COMMAND,value).")
        self._set(at, self.run.settings.bas(at, call))

    def _set(self, at: Place, state: State) -> None:
        """Put a state into force, or into doubt where it is not certain that it comes into force."""
        if self.run.certain:
            self.run.settings.change(self.run.line, state)
        else:
            word, opened = self.run.level.open[-1]
            problem = f"what motions depend on is changed inside {word} (line {opened})"
            self.run.settings.may_become(self.run.line, state, at.error(problem, SETTING_ADVICE))

    def _assignment_or_call(self, at: Place, start: int, stop: int) -> None:
        found = assignment(at.source, start, stop)
        if found is not None:
            self._assign(at, *found, stop)
            return
        target, position = operand(at.source, start, stop)
        if isinstance(target, Call) and position == stop:
            for inner in calls(at.source, start + len(target.name), stop):
                self.calls.call(at, inner, certain=False)
            if not self._entered(at, target):
                self.calls.call(at, target, certain=self.run.certain)
        elif isinstance(target, Reference) and _LABEL.match(at.source.text, position, stop):
            return
        elif declares(at.source.text, start, stop):
            self._declare(at, start, stop)
        else:
            raise at.error("the statement is not understood", "Check its spelling.")

    def _assign(self, at: Place, target: Reference, start: int, stop: int) -> None:
        for call in calls(at.source, target.start, target.stop):
            self.calls.call(at, call, certain=False)
        name = target.name
        if name in RELEVANT:
            self._set_to(at, target, start, stop)
            return
        before = self.run.variables.key_of(at.source, target)
        value = self.calls.value(at, start, stop)
        if name in _SUPERPOSED and target.field == "MODE" and not (isinstance(value, Word) and value.text == "#OFF"):
            raise at.error(
                f"{name} superposes a motion on the path", "Only programs that leave it #OFF are understood."
            )
        if name.startswith("$") and name != "$H_POS":
            return
        if target.field is None and self.run.in_main:
            self.run.understood.add(target.start)
        key = self.run.variables.key_of(at.source, target)
        if key != before:
            self.run.variables.forget(self.run.stored(name), self._which_element(at, target, start, stop))
        elif not self.run.certain or key is None or target.element == "":
            self.run.variables.forget(self.run.stored(name), str(at))
        elif target.field is not None:
            self.run.variables.set_field(key, target.field, value, str(at))
        elif value != NOTHING:
            self.run.variables.set(key, value, str(at))
        elif name != "$H_POS":
            given = at.source.text[start:stop].strip()[:80]
            why = "not known" if "(" in given else "in no file of the program"
            self.run.variables.set(key, Unknown(f"{at}: {given} is {why}"), str(at))

    def _which_element(self, at: Place, target: Reference, start: int, stop: int) -> str:
        """Return why it is not known which element an assignment writes: what it calls changes the index.

        KUKA does not say whether the index is evaluated before the value or after it.
        """
        indices = {name.upper() for name in NAME.findall(at.source.text, *target.inside)}
        places = {
            place
            for call in calls(at.source, start, stop)
            for index in indices
            if (place := self.calls.writer(call, self.run.stored(index))) is not None
        }
        changed = ", ".join(sorted(map(str, places))) or "an argument"
        element = at.source.text[target.start : target.stop]
        return f"{at}: which element {element} is, is not known, because the call changes its index: {changed}"

    def _set_to(self, at: Place, target: Reference, start: int, stop: int) -> None:
        """Follow an assignment to a variable of the controller that motions depend on."""
        value: Value | Known
        value, end = parse(at.source, start, stop)
        if at.source.text[end:stop].strip():
            raise at.error(f"{at.source.text[end:stop].strip()!r} is not understood")
        if "(" in at.source.text[start:stop]:
            known = self.calls.value(at, start, stop)
            if isinstance(value, Call) and not isinstance(known, Unknown):
                value = known
        self._set(at, self.run.settings.assigned(self.run.settings.state, at, target, value))

    def _event(self, at: Place, word: str, start: int, stop: int) -> None:
        """Note what an INTERRUPT or a TRIGGER may change from now on."""
        effects = self.run.analysis.of_action(self.run.level.module, self.run.level.routine, at, start, stop)
        if effects.motion is not None:
            raise at.error(f"{word} moves the robot ({effects.motion})", _IN_ORDER)
        self.calls.notice(at, f"{word} in {at}", effects)
        declared = at.source.origin(at.line).source
        public = word_at(at.source.text, *at.source.code_span(at.line)) == "GLOBAL"
        if public or declared is self.run.routine.source:
            self.run.resumed = self.run.resumed or effects.resumes
