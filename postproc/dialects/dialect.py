"""What the rest of the package asks of a program format: how it is found, read, written and marked."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

from postproc.cell import Cell
from postproc.frames import Array
from postproc.program import Document, Program, TargetForces, TargetJoints, Targets, Written
from postproc.provenance import Origin, Provenance


class Writer(Protocol):
    """Programs as text of one dialect."""

    @property
    def extension(self) -> str:
        """Of the main file that is written, with its point."""
        ...

    @property
    def approximation(self) -> str:
        """What users of the controller call its approximate positioning."""
        ...

    @property
    def least_arc(self) -> tuple[float, float]:
        """Of an arc that the controller takes: how far its other points are from its start [m], and the angle [rad]
        between them as seen from there. What is less is written as a line.
        """
        ...

    def fault_of(self, name: str) -> str | None:
        """Return why the controller would refuse a name for a program, or None if it would not."""
        ...

    def valid(self, name: str) -> str:
        """Return a name as it stands if the controller accepts it, otherwise one as close to it as possible."""
        ...

    def write(
        self, program: Program, targets: Targets, joints: TargetJoints, cell: Cell, comments: TargetForces | None
    ) -> Written:
        """Return a program as text: one that has its text (`Program.layout`) as it was, with other numbers.

        :param targets: what is to be commanded.
        :param joints: joint angles there.
        :param comments: forces that comments must give to the targets, or None.
        :raises ProgramError: it cannot be written.
        """
        ...

    def renamed(self, documents: Sequence[Document], name: str) -> tuple[Document, ...]:
        """Return the files of a program under another name; all else stays to the byte."""
        ...

    def marked(self, documents: Sequence[Document], origin: Origin) -> tuple[tuple[Document, ...], int]:
        """Return the files with the line that says where they come from, see `provenance.marked`."""
        ...

    def origin(self, documents: Sequence[Document]) -> Provenance:
        """Return what the files of a program say of where they come from."""
        ...


class Dialect(Protocol):
    """One program format. An object of it stands in `registry`, or is an entry point of another package."""

    @property
    def name(self) -> str:
        """What it is called in options, in `Program.dialect` and in messages: lower case."""
        ...

    @property
    def extensions(self) -> tuple[str, ...]:
        """Of main files, with their point, lower case."""
        ...

    @property
    def command_decimals(self) -> tuple[int, ...]:
        """Decimals of X, Y, Z [mm], A, B, C [deg] of commanded poses, as targets.csv has them."""
        ...

    @property
    def writer(self) -> Writer | None:
        """What writes programs of this dialect; None if it is only read."""
        ...

    def companions(self, path: Path) -> list[Path]:
        """Return the files beside a main file that are read with it, in the order in which they are read."""
        ...

    def read(self, documents: Sequence[Document], cell: Cell, forward: Callable[[Array], Array], name: str) -> Program:
        """Return the program that some files hold.

        :param documents: the main file first.
        :param cell: frames, settings, and where the robot stands first.
        :param forward: (6,) joints [rad] → (4, 4) flange in the robot root [m], by the controller's nominal geometry.
        :param name: of the program.
        :raises ProgramError: it is not understood; the message names file, line, text and what to do.
        """
        ...


@runtime_checkable
class Calling(Protocol):
    """What a dialect has besides if its programs call others by the names of their files."""

    def callers(self, paths: Sequence[Path]) -> dict[Path, list[Path]]:
        """Return which of some files are but called by others of them, and by which."""
        ...

    def moving(self, paths: Sequence[Path], cell: Cell) -> dict[Path, set[Path]]:
        """Return the files with motions that each of some programs of one folder may call, one through the other."""
        ...

    def with_own_copies(
        self,
        documents: Sequence[Document],
        unchanged: Sequence[bytes],
        stems: Sequence[str],
        program: str,
        taken: Collection[str],
    ) -> tuple[tuple[Document, ...], dict[str, str]] | None:
        """Return the files of a program with other names for some of its subprograms; None if that is not possible.

        :param documents: files of the program and of its subprograms, the main file first.
        :param unchanged: contents of files that are written with them and must stay as they are.
        :param stems: names of the files to be renamed, without extension.
        :param program: name of the program, which becomes a part of the new names.
        :param taken: names of other files, without extension, lower case.
        :returns: the files, and new file name → old file name.
        """
        ...
