"""A program as far as it has run: where it is, and what has been met on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from postproc.dialects.krl.language.routines import Module, Routine
from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.read.effects import Analysis
from postproc.dialects.krl.read.known import NOTHING, Known, Scope, Unknown
from postproc.dialects.krl.read.library import Library
from postproc.dialects.krl.read.scopes import Scopes
from postproc.dialects.krl.read.settings import Settings
from postproc.errors import Issue, ProgramError

SETTING_ADVICE = "Set $BASE, $TOOL and speeds outside of loops, branches and interrupts."


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


class Run:
    """What is shared by all that follows a program.

    :ivar routine: the main routine.
    :ivar line: of the main routine, where the run is.
    :ivar level: the routine that runs.
    :ivar stack: it, and those that called it.
    :ivar steps: statements of called routines that have run.
    :ivar calls: calls that have been run.
    :ivar resumable: True where RESUME may break off what is running.
    :ivar blocked: (first line, last line, word): control structures of the main routine, where no motion may stand.
    :ivar triggers: lines of TRIGGER statements of the main routine.
    :ivar moved: (line, reason): behind such a line it is not known where the robot stands.
    :ivar understood: offsets of names in the main routine whose use is followed.
    :ivar absent: calls of programs that are in no file: name as spelled, and line.
    :ivar reached: routines of the program itself that it calls.
    :ivar issues: what the user should know.
    """

    def __init__(self, library: Library, routine: Routine, settings: Settings) -> None:
        self.library, self.routine, self.settings = library, routine, settings
        self.source, self.variables = routine.source, settings.variables
        self.scopes = Scopes(library.program, routine, self.variables)
        self.analysis = Analysis(library, self.scopes.of)
        self.line = 0
        self.level = Level(library.program, routine, Scope())
        self.stack: list[Routine] = [routine]
        self.steps = self.calls = 0
        self.resumable = False
        self.blocked: list[tuple[int, int, str]] = []
        self.triggers: list[int] = []
        self.moved: list[tuple[int, ProgramError]] = []
        self.understood: set[int] = set()
        self.absent: list[tuple[str, int]] = []
        self.reached: set[Routine] = set()
        self.issues: list[Issue] = []

    @property
    def in_main(self) -> bool:
        """Whether the main routine runs."""
        return self.level.routine is self.routine and len(self.stack) == 1

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
