"""The lines of a program in the order in which they run: loops written out, called routines in place of their calls.

Reading and correcting work on that text as on a straight program; `write.folding` leads it back to the files.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from msgspec import Struct, field

from postproc.dialects.krl.language.routines import Module, Routine
from postproc.dialects.krl.language.source import Place, Source
from postproc.errors import ProgramError
from postproc.program import Bools, Document


class Lines(Struct, frozen=True):
    """Lines first … last of the course run one after the other."""

    first: int
    last: int


class Kept(Struct, frozen=True):
    """A control structure on lines first … last of the course: what runs in it only the running robot knows."""

    first: int
    last: int
    why: ProgramError


class Occasion(NamedTuple):
    """A place that the course comes to, perhaps one of several times.

    :ivar way: loops around it and calls that lead there, each with its round.
    """

    place: Place
    way: tuple[tuple[Place, int], ...]


class Fork(Struct, frozen=True):
    """Behind a line branches follow of which one runs, and it is not known which."""

    line: int
    occasion: Occasion


class Branch(Struct, frozen=True):
    """Behind a line one of the branches begins."""

    line: int


class Join(Struct, frozen=True):
    """Before the line behind this one branches meet.

    :ivar complete: False where it may be that none of them runs.
    :ivar skipped: True where one of them is what a GOTO or RETURN skips.
    """

    line: int
    complete: bool
    skipped: bool = False


class Enter(Struct, frozen=True):
    """The call on a line of the course: what follows, up to its `Leave`, runs in the routine."""

    line: int
    module: Module
    routine: Routine


class Leave(Struct, frozen=True):
    """The end of the routine that was entered last."""


Step = Lines | Kept | Fork | Branch | Join | Enter | Leave


class Body(Struct, eq=False):
    """Lines first … last − 1 of the course that stand together in a file.

    :ivar parts: what is written out in them, in order.
    """

    first: int
    last: int = 0
    parts: list[Repeated | Called] = []


class Repeated(Struct, eq=False):
    """A loop, written out.

    :ivar opener: text of its first line, with its line end; `closer` that of its last.
    :ivar step: of FOR, each body of which begins with an assignment to its counter; 0 for other loops.
    :ivar left: True where EXIT stands in it.
    :ivar first: first line of the course; `last` the one behind it.
    :ivar bodies: what was run, again and again; none: the loop stands as it is.
    """

    opener: str
    closer: str
    step: int
    left: bool
    first: int
    last: int = 0
    bodies: list[Body] = []


class Called(Struct, eq=False):
    """A routine in place of its call.

    :ivar line: of the course, with the call; `name` the span of the routine's name in it.
    """

    line: int
    name: tuple[int, int]
    routine: Routine
    body: Body


class Course(Struct, frozen=True, eq=False):
    """A program in the order in which it runs.

    :param main: the main routine.
    :param source: the text; that of the `.src` itself where nothing is written out.
    :param steps: what runs, in order.
    :param body: the lines of the main routine.
    :param live: (L,) False for lines that do not run: branches that are not taken; None: all may.
    :param inlined: routines that stand in it, and no longer where they stood.
    :param pinned: those of them that are also reached by a call that is not followed: it must find them as they were.
    :param files: other files than that of the program from which these are, and their data.
    :param taken: names, upper case, of programs and GLOBAL routines of all folders, as far as new names are needed.
    :param users: file of a routine that stands in it → other programs of the folders that name it.
    """

    main: Routine
    source: Source
    steps: tuple[Step, ...]
    body: Body
    live: Bools | None = None
    inlined: frozenset[Routine] = frozenset()
    pinned: frozenset[Routine] = frozenset()
    files: tuple[Document, ...] = ()
    taken: frozenset[str] = frozenset()
    users: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def straight(self) -> bool:
        """Whether it is the `.src` itself."""
        return self.source.origins is None
