"""The statements of a `.src` in order: which of them move the robot, and what is in force when they do."""

from __future__ import annotations

import re

from postproc.dialects.krl.moves import KINDS, MoveReader
from postproc.dialects.krl.names import NAME, OPENING, TYPES, WITHOUT_MOTION, fault_of, words
from postproc.dialects.krl.rows import Collector
from postproc.dialects.krl.settings import RELEVANT, Settings
from postproc.dialects.krl.source import Source
from postproc.dialects.krl.syntax import Call, Reference, operand, parse
from postproc.dialects.krl.variables import Unknown
from postproc.errors import Issue, ProgramError

_DEF = re.compile(r"(?:GLOBAL[ \t]+)?DEF(?:FCT[ \t]+\w+(?:[ \t]*\[[ ,\t]*\])?)?[ \t]+([^\s(]+)", re.I | re.A)
_MOTION = frozenset(KINDS) | {f"{word}_REL" for word in KINDS}
_CLOSING = {closing: opening for opening, closing in OPENING.items()} | {"UNTIL": "REPEAT"}
_SPLINES = frozenset({"SPLINE", "PTP_SPLINE", "SPL", "SPL_REL"})
_ASYNCHRONOUS = frozenset({"ASYPTP", "ASYCONT", "ASYSTOP", "ASYCANCEL"})
_DO = re.compile(r"\bDO\b[ \t]*", re.I)
_CALL = re.compile(r"([A-Za-z_]\w*)[ \t]*\(", re.A)
_EFFECT = re.compile(r"\$(?:BASE|TOOL|VEL|APO|ORI_TYPE|CIRC_TYPE|IPO_MODE)\b|\bBAS[ \t]*\(", re.I)
_UNDECLARED = re.compile(r"[A-Za-z_]\w*[ \t]+[A-Za-z_$][\w$]*[ \t]*(?:\[[^\]]*\])?[ \t]*(?:[,=].*)?$", re.A)
"""A declaration without DECL: type and name."""
_EQUALS = re.compile(r"[ \t]*=(?!=)")
_LABEL = re.compile(r"[ \t]*:[ \t]*$")
_KNOWN_CALLS = words(
    "IR_STOPM PULSE CWRITE CREAD COPEN CCLOSE CIOCTL SREAD SWRITE CAST_TO CAST_FROM CLEAR STRCLEAR STRCOPY STRADD "
    "DELETE_BACKWARD_BUFFER VARSTATE ERR_CLEAR ERR_RAISE"
)
_LOOP_ADVICE = "Motions in loops, branches and interrupts cannot be corrected one by one; write them out in order."


class Walker:
    """Follows a program through the lines that the bulk path did not read.

    :ivar moves: motions of the main program, in order.
    :ivar main: first and last line of the main program.
    :ivar blocked: (first line, last line, word): control structures and other subprograms, where no motion of the main
        program may stand.
    :ivar still: lines of motions to where the robot is already.
    :ivar triggers: lines of TRIGGER statements of the main program.
    :ivar issues: what the user should know.
    """

    def __init__(self, source: Source, settings: Settings, moves: MoveReader, name: str) -> None:
        self.source, self.settings, self.variables = source, settings, settings.variables
        self.reader, self.name = moves, name
        self.moves = Collector()
        self.still: list[int] = []
        self.blocked: list[tuple[int, int, str]] = []
        self.triggers: list[int] = []
        self.issues: list[Issue] = []
        self.main = (0, 0)
        self._scope: str | None = None
        self._scope_line = 0
        self._main = ""
        self._open: list[tuple[str, int]] = []
        self._calls: list[tuple[int, str, bool]] = []
        self._subs: dict[str, dict[str, int]] = {}
        self._returned = 0

    def walk(self, lines: list[int]) -> None:
        """Follow the given 1-based lines.

        :raises ProgramError: something that changes motion is not understood; the program is not complete.
        """
        text = self.source.text
        starts, stops = self.source.starts.tolist(), self.source.stops.tolist()
        self._main = self._main_name(lines)
        for line in lines:
            start, stop = starts[line - 1], stops[line - 1]
            while start < stop and text[start] in " \t\r":
                start += 1
            if start == stop or text[start] in ";&":
                continue
            start, stop = self.source.code_span(line)
            if start < stop:
                self._statement(line, start, stop)
        if self._scope is not None:
            raise self.source.line_error(
                f"DEF {self._scope} has no END", self._scope_line, "Check that the file was transferred completely."
            )
        if not self._main:
            raise ProgramError(
                "there is no DEF", file=self.source.document.name, line=1, advice="Check that this is a KRL program."
            )

    def _main_name(self, lines: list[int]) -> str:
        """Return the name of the DEF to follow: that of the program, else the first one."""
        first = ""
        for line in lines:
            start, stop = int(self.source.starts[line - 1]), int(self.source.stops[line - 1])
            match = _DEF.match(self.source.text[start:stop].lstrip())
            if match:
                first = first or match[1].upper()
                if match[1].upper() == self.name.upper():
                    return match[1].upper()
        return first

    def _statement(self, line: int, start: int, stop: int) -> None:
        text = self.source.text
        match = NAME.match(text, start, stop)
        word = match[0].upper() if match else ""
        if word in ("DEF", "DEFFCT", "GLOBAL") and (definition := _DEF.match(text, start, stop)):
            self._begin(line, definition[1])
        elif word in ("END", "ENDFCT") and self._scope is not None:
            self._end(line)
        elif word == "GLOBAL":
            rest = text[start + len(word) : stop].lstrip()
            self._statement(line, stop - len(rest), stop)
        elif self._scope is None:
            if word in _MOTION:
                raise self.source.line_error(f"{word} stands outside of DEF … END", line)
        elif self._scope != self._main:
            self._in_subprogram(line, word, start, stop)
        elif word in _MOTION:
            self._motion(line, word, start, stop)
        elif not self._control(line, word):
            self._other(line, word, start, stop)

    def _begin(self, line: int, name: str) -> None:
        if self._scope is not None:
            raise self.source.line_error(f"DEF {self._scope} (line {self._scope_line}) has no END", line)
        self._scope, self._scope_line = name.upper(), line
        if self._scope == self._main:
            fault = fault_of(name)
            if fault:
                raise self.source.line_error(f"{name} is not a valid name: {fault}", line)
        else:
            self._subs[self._scope] = {}

    def _end(self, line: int) -> None:
        if self._scope == self._main:
            if self._open:
                word, opened = self._open[-1]
                raise self.source.line_error(f"{word} is not closed", opened, "Check that the file is complete.")
            self.main = (self._scope_line, line)
            if self._returned:
                self.blocked.append((self._returned, line, "RETURN"))
        else:
            self.blocked.append((self._scope_line, line, f"DEF {self._scope}"))
        self._scope = None

    def _in_subprogram(self, line: int, word: str, start: int, stop: int) -> None:
        sub = self._subs[self._scope or ""]
        code = self.source.text[start:stop]
        if word in _MOTION or word in _SPLINES:
            sub.setdefault("motion", line)
        elif _EFFECT.search(code):
            sub.setdefault("effect", line)
        for name in _CALL.findall(code):
            sub.setdefault(f"call {name.upper()}", line)

    def _motion(self, line: int, word: str, start: int, stop: int) -> None:
        if self._open:
            opener, opened = self._open[-1]
            raise self.misplaced(line, opener, opened)
        if self._returned:
            raise self.misplaced(line, "RETURN", self._returned)
        move = self.reader.read(line, word, start, stop)
        if move is None:
            self.still.append(line)
        else:
            self.moves.add(move)

    def misplaced(self, line: int, opener: str, opened: int) -> ProgramError:
        """Return the error for a motion inside a control structure or behind RETURN."""
        if opener == "RETURN":
            return self.source.line_error(f"the motion is never reached: RETURN in line {opened}", line)
        return self.source.line_error(f"motion inside {opener} (line {opened})", line, _LOOP_ADVICE)

    def _control(self, line: int, word: str) -> bool:
        """Follow control structures; return whether the statement was one."""
        if word in OPENING or word == "REPEAT":
            self._open.append((word, line))
        elif word in _CLOSING:
            if not self._open or self._open[-1][0] != _CLOSING[word]:
                raise self.source.line_error(f"{word} without {_CLOSING[word]}", line)
            opener, opened = self._open.pop()
            if not self._open:
                self.blocked.append((opened, line, opener))
        elif word == "GOTO":
            raise self.source.line_error("GOTO changes the order of motions", line, _LOOP_ADVICE)
        elif word == "RETURN":
            if not self._open:
                self._returned = self._returned or line
        elif word in _SPLINES:
            raise self.source.line_error(
                f"{word}: spline blocks are not supported", line, "Write the path with LIN, CIRC, SLIN or SCIRC."
            )
        elif word in _ASYNCHRONOUS:
            raise self.source.line_error(f"{word} moves external axes", line, "Only fixed external axes are supported.")
        else:
            return False
        if word in ("FOR", "IF", "WHILE", "UNTIL", "SWITCH"):
            self._condition(line, word)
        return True

    def _condition(self, line: int, word: str) -> None:
        start, stop = self.source.code_span(line)
        code = self.source.text[start:stop]
        self._note_calls(line, code, statement=False)
        if word == "FOR" and (match := NAME.search(code, 3)):
            self.variables.forget(match[0].upper(), line)

    def _other(self, line: int, word: str, start: int, stop: int) -> None:
        """Follow what neither moves nor controls: settings, assignments, declarations, calls."""
        text = self.source.text
        if word == "BAS":
            self._bas(line, start, stop)
        elif word in ("INTERRUPT", "TRIGGER"):
            if word == "TRIGGER":
                self.triggers.append(line)
            action = _DO.search(text, start, stop)
            if action and _EFFECT.search(text, action.end(), stop):
                raise self.source.line_error(f"{word} changes what motions depend on", line, _LOOP_ADVICE)
            if action:
                self._note_calls(line, text[action.end() : stop], statement=True)
        elif word == "DECL" or word in TYPES:
            self._declare(start, stop)
        elif word in WITHOUT_MOTION:
            self._note_calls(line, text[start:stop], statement=False)
        else:
            self._assignment_or_call(line, start, stop)

    def _declare(self, start: int, stop: int) -> None:
        names = NAME.findall(self.source.text, start, stop)
        self.variables.declare(self.source, start, stop)
        for name in dict.fromkeys(name.upper() for name in names):
            self.variables.understood[name] += 1

    def _bas(self, line: int, start: int, stop: int) -> None:
        call, _ = operand(self.source, start, stop)
        if not isinstance(call, Call) or not call.arguments:
            raise self.source.line_error("BAS is not understood", line, "Write BAS(#COMMAND,value).")
        initialise = self.source.text[slice(*call.arguments[0])].strip().upper() == "#INITMOV"
        if self._open and not initialise:
            raise self._conditional(line)
        self.settings.change(line, self.settings.bas(line, call))

    def _conditional(self, line: int) -> ProgramError:
        word, opened = self._open[-1]
        return self.source.line_error(
            f"what motions depend on is changed inside {word} (line {opened})",
            line,
            "Set $BASE, $TOOL and speeds outside of loops and branches.",
        )

    def _assignment_or_call(self, line: int, start: int, stop: int) -> None:
        text = self.source.text
        target, position = operand(self.source, start, stop)
        equals = _EQUALS.match(text, position, stop)
        if isinstance(target, Reference) and equals:
            self._assign(line, target, equals.end(), stop)
        elif isinstance(target, Call) and position == stop:
            self._note_calls(line, text[start:stop], statement=True)
            for begin, end in target.arguments:
                for name in NAME.findall(text, begin, end):
                    if self.variables.types.get(name.upper(), "") not in ("", "ENUM"):
                        self.variables.forget(name.upper(), line)
        elif isinstance(target, Reference) and _LABEL.match(text, position, stop):
            return
        elif _UNDECLARED.match(text, start, stop):
            self._declare(start, stop)
        else:
            raise self.source.line_error("the statement is not understood", line, "Check its spelling.")

    def _assign(self, line: int, target: Reference, start: int, stop: int) -> None:
        self._note_calls(line, self.source.text[start:stop], statement=False)
        name = target.name
        if name in RELEVANT:
            if self._open:
                raise self._conditional(line)
            value, _ = parse(self.source, start, stop)
            self.settings.change(line, self.settings.assigned(self.settings.state, line, target, value))
            return
        if name.startswith("$") and name != "$H_POS":
            return
        key = self.variables.key_of(self.source, target)
        if target.field is None:
            self.variables.understood[name] += 1
        if self._open or key is None or target.element == "":
            self.variables.forget(name, line)
            return
        value, _ = parse(self.source, start, stop)
        known = self.variables.evaluate(self.source, value)
        if known == Unknown(0):
            if name == "$H_POS":
                return
            known = Unknown(line)
        if target.field is None:
            self.variables.set(key, known)
        else:
            self.variables.set_field(key, target.field, known, line)

    def only_comments(self, first: int, last: int) -> bool:
        """Return whether the lines first … last hold nothing but comments and other TRIGGERs."""
        for line in range(first, last + 1):
            start, stop = self.source.code_span(line)
            if start < stop and line not in self.triggers:
                return False
        return True

    def _note_calls(self, line: int, code: str, *, statement: bool) -> None:
        """Note which subprograms are called: whether they move the robot is known at the end of the file."""
        if "(" in code:
            for name in _CALL.findall(code):
                self._calls.append((line, name.upper(), statement))
                statement = False

    def check_calls(self, bulk_lines: list[int]) -> None:
        """Refuse calls of subprograms that move the robot; tell about those that are not in the file.

        :param bulk_lines: one line of the bulk path in each subprogram that has any.
        :raises ProgramError: a subprogram of this file with motions, or one that changes frames or speeds, is called.
        """
        for line in bulk_lines:
            for first, last, word in self.blocked:
                if first < line < last and word.startswith("DEF "):
                    self._subs[word[4:]].setdefault("motion", line)
        reached: set[str] = set()
        for line, name, statement in self._calls:
            found = self._reaching(name, set())
            reached |= found
            for sub in sorted(found):
                for what, problem in (("motion", "moves the robot"), ("effect", "changes frames or speeds")):
                    if what in self._subs[sub]:
                        raise self.source.line_error(
                            f"{name} is called, which {problem} (line {self._subs[sub][what]})",
                            line,
                            "Put the motions of subprograms in place of their calls.",
                        )
            if statement and name not in self._subs and name not in _KNOWN_CALLS:
                message = f"{name}() is not in this file; it is assumed not to move the robot nor to change frames."
                self.issues.append(Issue("warning", "external-call", message, line))
        for sub, found_in in self._subs.items():
            if "motion" in found_in and sub not in reached:
                message = f"DEF {sub} has motions but {self._main} does not call it; they are left as they are."
                self.issues.append(Issue("warning", "uncalled-motions", message, found_in["motion"]))

    def _reaching(self, name: str, seen: set[str]) -> set[str]:
        """Return the subprograms of this file that a call reaches."""
        if name in self._subs and name not in seen:
            seen.add(name)
            for key in self._subs[name]:
                if key.startswith("call "):
                    self._reaching(key[5:], seen)
        return seen
