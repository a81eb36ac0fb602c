"""A program as far as it has run: where it is, and what has been met on the way."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.course import Occasion
from postproc.dialects.krl.language.routines import Module, Routine
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.structures import Node, checked, nodes_of
from postproc.dialects.krl.read.effects import Analysis
from postproc.dialects.krl.read.known import NOTHING, Known, Scope, Unknown, Unread
from postproc.dialects.krl.read.library import Library
from postproc.dialects.krl.read.scopes import Scopes
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.state import State
from postproc.errors import Issue, ProgramError

SETTING_ADVICE = "Set $BASE, $TOOL, speeds and modes outside of loops, branches and interrupts."


class Level(Struct, eq=False):
    """A routine that runs.

    :ivar traced: True where its motions are those of the program: the main routine, and what it calls in its course.
    :ivar open: control structures of which it is not known what runs in them: word and line.
    :ivar loops: loops that are followed, one in the other.
    :ivar left: True behind EXIT.
    :ivar jump: line of a GOTO whose label has not been found yet; 0 for none.
    :ivar returned: line of a RETURN; 0 before.
    :ivar result: what a function returns.
    """

    module: Module
    routine: Routine
    scope: Scope
    traced: bool = False
    open: list[tuple[str, int]] = []
    loops: int = 0
    left: bool = False
    jump: int = 0
    returned: int = 0
    result: Known = NOTHING

    @property
    def broken_off(self) -> bool:
        """Whether what stands behind does not run next: RETURN, EXIT, GOTO."""
        return bool(self.returned or self.left or self.jump)


class Apart(Struct, frozen=True, eq=False):
    """A call of a routine of another file whose motions are not those of the program.

    :param line: of the course; behind it it is not known where the robot stands.
    :param reason: why a motion must not begin there.
    :param name: of the routine, as it is spelled; `routine` itself, in `module`.
    :param cause: why it is not followed.
    """

    line: int
    reason: ProgramError
    name: str
    module: Module
    routine: Routine
    cause: ProgramError


class _Fork(Struct, eq=False):
    """Where branches divide.

    :ivar values: of all variables there; `state` what is in force.
    :ivar ends: the same where branches end.
    """

    values: tuple[dict[str, Known | Unread], dict[str, Unknown]]
    state: State
    begun: bool = False
    ends: list[tuple[tuple[dict[str, Known | Unread], dict[str, Unknown]], State]] = []


class Run:
    """What is shared by all that follows a program.

    :ivar routine: the main routine.
    :ivar source: the course of the program, see `course`.
    :ivar line: of the course, where the run is.
    :ivar level: the routine that runs.
    :ivar stack: it, and those that called it.
    :ivar steps: statements of called routines that have run.
    :ivar calls: calls that have been run.
    :ivar resumable: True where RESUME may break off what is running.
    :ivar resumed: RESUME that goes back to the program, or to where it is not known; None if there is none.
    :ivar triggers: lines of TRIGGER statements of the main routine.
    :ivar moved: calls behind which it is not known where the robot stands.
    :ivar unfollowed: routines reached by calls that move the robot and are not followed.
    :ivar unforced: line → reason: behind such a line it is not known which force acts.
    :ivar understood: offsets of names in the main routine whose use is followed.
    :ivar absent: calls of programs that are in no file: name as spelled, and line.
    :ivar reached: routines of the program itself that it calls.
    :ivar issues: what the user should know.
    :ivar unresolved: (line, reason): motions of the course that stay as they are, where `keep`s that.
    :ivar elsewhere: routines of other files whose motions are not those of the program, and occasions on which branches
        are not followed; and why.
    """

    def __init__(self, library: Library, routine: Routine, settings: Settings, source: Source | None = None) -> None:
        self.library, self.routine, self.settings = library, routine, settings
        self.source, self.variables = source or routine.source, settings.variables
        self.scopes = Scopes(library.program, routine, self.variables)
        self.analysis = Analysis(library, self.scopes.of)
        self.line = 0
        self.level = Level(library.program, routine, Scope(), traced=True)
        self.stack: list[Routine] = [routine]
        self.steps = self.calls = 0
        self.resumable = False
        self.resumed: Place | None = None
        self.triggers: list[int] = []
        self.moved: list[Apart] = []
        self.unfollowed: set[Routine] = set()
        self.unforced: dict[int, str] = {}
        self.understood: set[int] = set()
        self.absent: list[tuple[str, int]] = []
        self.reached: set[Routine] = set()
        self.issues: list[Issue] = []
        self.keep = settings.cell.krl.keep_unresolved
        self.unresolved: list[tuple[int, ProgramError]] = []
        self.elsewhere: Mapping[Routine | Occasion, ProgramError] = {}
        self._forks: list[_Fork] = []
        self._nodes: dict[Routine, tuple[Node, ...]] = {}

    def nodes(self, routine: Routine) -> tuple[Node, ...]:
        """Return the statements and control structures of a routine.

        :raises ProgramError: these are not as they must be.
        """
        if routine not in self._nodes:
            self._nodes[routine] = checked(routine.source, nodes_of(routine.source, routine.lines))
        return self._nodes[routine]

    @property
    def here(self) -> int:
        """Line of the program's own `.src` that stands for where the run is."""
        return int(self.source.shown(np.array([self.line]))[0])

    def fork(self) -> None:
        """Come to branches of which one runs."""
        self._forks.append(_Fork(self.variables.as_now(), self.settings.state))

    def branch(self) -> None:
        """Begin with one of them."""
        fork = self._forks[-1]
        if fork.begun:
            fork.ends.append((self.variables.as_now(), self.settings.state))
        fork.begun = True
        self.variables.as_then(fork.values)
        self.settings.change(self.line, fork.state)

    def join(self, at: Place, *, complete: bool) -> None:
        """Go on where the branches meet; what they leave in different ways is not known."""
        fork = self._forks.pop()
        for values, state in [*fork.ends, *([] if complete else [(fork.values, fork.state)])]:
            self.variables.meet(values, str(at))
            problem = "what motions depend on differs behind the branches that meet here"
            self.settings.may_become(self.line, state, at.error(problem, SETTING_ADVICE))

    def standing(self) -> tuple[Level, int, Scope, int, bool, int]:
        """Return in which routine the run is, for `stand`."""
        level = self.level
        return level, len(self.stack), self.variables.scope, level.loops, level.left, len(self._forks)

    def stand(self, where: tuple[Level, int, Scope, int, bool, int]) -> None:
        """Run in that routine again."""
        self.level, depth, self.variables.scope, self.level.loops, self.level.left, forks = where
        del self.stack[depth:], self._forks[forks:]
        self.level.open.clear()
        self.level.jump = 0

    def marks(self) -> tuple[int, ...]:
        """Return how much is noted, for `back_to`."""
        return len(self.triggers), len(self.moved), len(self.absent), len(self.issues)

    def back_to(self, marks: tuple[int, ...]) -> None:
        """Forget what was noted since, to follow the same statements in another way."""
        triggers, moved, absent, issues = marks
        del self.triggers[triggers:], self.moved[moved:], self.absent[absent:], self.issues[issues:]

    @property
    def in_main(self) -> bool:
        """Whether what runs is in the course of the program: the main routine, or what stands in place of its call."""
        return self.level.traced

    @property
    def certain(self) -> bool:
        """Whether what follows runs once, and now: no control structure is open."""
        return not self.level.open

    def stored(self, name: str) -> str:
        """Return under which name a variable of the routine that runs is stored."""
        return self.variables.scope.stored(name.upper())

    def may_change(self, names: Mapping[str, Place], what: str) -> None:
        """Note that names may have another value at any time."""
        for name, place in names.items():
            where = what if what.endswith(f"in {place}") else f"{what}, {place}"
            self.variables.changing.setdefault(name, Unknown(f"by {where}"))

    def changes_always(self, at: Place, name: str) -> None:
        """Note that a name, as it is stored, has another value again and again."""
        self.variables.changing.setdefault(name, Unknown(str(at)))
