"""Interface of a program format: recognising, reading, writing and marking programs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

from msgspec import Struct

from postproc.cell import Cell
from postproc.dialects.cell_lines import called_by_cell
from postproc.frames import Array
from postproc.program import Document, Program, TargetForces, TargetJoints, Targets, WrittenProgram
from postproc.provenance import Origin, Provenance


class Writer(Protocol):
    """Programs as text of one dialect."""

    @property
    def extension(self) -> str:
        """Extension of the written main file, with its point."""
        ...

    @property
    def approximation(self) -> str:
        """The controller's term for approximate positioning."""
        ...

    @property
    def least_arc(self) -> tuple[float, float]:
        """Smallest arc that the controller accepts: two limits. Smaller arcs are written as lines.

        First, the distance of auxiliary point and end from the start [m]. Second, the angle at the start between the
        directions to auxiliary point and end [rad].
        """
        ...

    def fault_of(self, name: str) -> str | None:
        """Return the reason why the controller refuses a program name, or None if it is valid."""
        ...

    def valid_name(self, name: str) -> str:
        """Return the name itself if the controller accepts it, otherwise a valid name as close as possible."""
        ...

    def write(
        self, program: Program, targets: Targets, joints: TargetJoints, cell: Cell, comments: TargetForces | None
    ) -> WrittenProgram:
        """Return a program as text. A program with a `layout` keeps its own text with other numbers.

        :param targets: targets to be commanded.
        :param joints: joint angles at the targets.
        :param comments: forces at the targets, to be written as comments; None: no force comments.
        :raises ProgramError: it cannot be written.
        """
        ...

    def rename(self, documents: Sequence[Document], name: str) -> tuple[Document, ...]:
        """Return the files of a program under another name; everything else is unchanged to the byte."""
        ...

    def mark(self, documents: Sequence[Document], origin: Origin) -> tuple[tuple[Document, ...], int]:
        """Return the files with the line that states their origin, see `provenance.mark`.

        :returns: the files, and the 1-based line of the main file from which on its lines have moved down by one; 0 if
            no line has moved.
        """
        ...

    def origin(self, documents: Sequence[Document]) -> Provenance:
        """Return the origin that the files of a program state."""
        ...


class Dialect(Protocol):
    """One program format. Its object is in `registry`, or is an entry point of another package."""

    @property
    def name(self) -> str:
        """Name in options, in `Program.dialect` and in messages: lower case."""
        ...

    @property
    def extensions(self) -> tuple[str, ...]:
        """Extensions of main files, with their point, lower case."""
        ...

    @property
    def command_decimals(self) -> tuple[int, ...]:
        """Decimals of X, Y, Z [mm], A, B, C [deg] of commanded poses, as targets.csv has them."""
        ...

    @property
    def writer(self) -> Writer | None:
        """Writer of programs of this dialect; None if it is only read."""
        ...

    def companions(self, path: Path) -> list[Path]:
        """Return the files that are read with a main file, in reading order."""
        ...

    def read(
        self, documents: Sequence[Document], cell: Cell, forward_kinematics: Callable[[Array], Array], name: str
    ) -> Program:
        """Return the program that the files contain.

        :param documents: the main file first, then its companions.
        :param cell: frames, settings and start position of the robot.
        :param forward_kinematics: (6,) joints [rad] → (4, 4) flange in the robot root [m], by the nominal geometry
            of the controller.
        :param name: name of the program.
        :raises ProgramError: the program cannot be interpreted; the message gives file, line, text and advice.
        """
        ...


@runtime_checkable
class WithNumberedFrames(Protocol):
    """Additional interface of a dialect whose programs name frames of the controller by number."""

    def numbered_frames(self, documents: Sequence[Document]) -> tuple[str, ...]:
        """Return the tables of the cell that state frames which a program may name, such as ``"base_data.3"``."""
        ...


@runtime_checkable
class WithCalledFiles(Protocol):
    """Additional interface of a dialect that reads more files than a program and its companions."""

    def called_files(self, paths: Sequence[Path], cell: Cell) -> dict[Path, list[Path]]:
        """Return the files that each program may call, and those of which it may take values: program → files.

        If a call depends on values, all files that it may mean count. Files that do not exist are left out.

        :param paths: programs of one folder.
        """
        ...


class Survey(Struct, frozen=True):
    """What the text of a CAM program shows before it is read: the basis for the questions of `start` and `init`.

    :param comments: 1-based line and text of each comment.
    :param tool_changes: line and tool number of each change, in order of lines.
    :param work_offsets: codes of work offsets other than the first, such as ``"G55"``.
    :param m_codes: M codes that only the machine knows, such as ``"M31"``.
    :param rotary: letters of the rotary axes that have words.
    :param tip_controlled: True if the program switches tool-centre-point control on.
    :param switches: devices that the program switches on: ``"spindle"``, ``"coolant"``.
    :param inches: True if its lengths are in inches.
    """

    comments: tuple[tuple[int, str], ...] = ()
    tool_changes: tuple[tuple[int, int], ...] = ()
    work_offsets: tuple[str, ...] = ()
    m_codes: tuple[str, ...] = ()
    rotary: tuple[str, ...] = ()
    tip_controlled: bool = False
    switches: frozenset[str] = frozenset()
    inches: bool = False


class CamFormat(Struct, frozen=True):
    """A dialect of CAM systems: a program is one file, and is read only.

    :param reader: reads the file of a program; its parameters are those of `read` after the file.
    :param survey: reads what `Survey` states, without a cell; None: the dialect has no survey.
    :param subprograms: returns the files of subprograms that programs of one folder may call; None: there are none.
    :param command_decimals: decimals of X … C in robot programs made from programs of this dialect.
    """

    name: str
    extensions: tuple[str, ...]
    reader: Callable[[Document, Cell, Callable[[Array], Array], str], Program]
    command_decimals: tuple[int, ...] = (4, 4, 4, 5, 5, 5)
    writer: None = None
    survey: Callable[[Document], Survey] | None = None
    subprograms: Callable[[Sequence[Path]], dict[Path, list[Path]]] | None = None

    def companions(self, path: Path) -> list[Path]:
        """Return no other files: a program is one file."""
        del path
        return []

    def called_files(self, paths: Sequence[Path], cell: Cell) -> dict[Path, list[Path]]:
        """Return the files of subprograms that each program, or a line of the cell, may call: program → files.

        :param paths: programs of one folder.
        """
        cell_files = called_by_cell(paths[0].parent, cell)
        subprograms = {} if self.subprograms is None else self.subprograms(paths)
        return {path: [*subprograms.get(path, ()), *cell_files] for path in paths}

    def read(
        self, documents: Sequence[Document], cell: Cell, forward_kinematics: Callable[[Array], Array], name: str
    ) -> Program:
        """Return the program that a file contains.

        :param documents: the only file of the program, since `companions` names no others.
        :param cell: frames, settings and start position of the robot.
        :param forward_kinematics: (6,) joints [rad] → (4, 4) flange in the robot root [m], by the nominal geometry
            of the controller.
        :param name: name of the program.
        :raises ProgramError: the program cannot be interpreted; the message gives file, line, text and advice.
        """
        main_document = documents[0]
        return self.reader(main_document, cell, forward_kinematics, name)


class OtherFiles(NamedTuple):
    """Files of other programs in an output folder, whose names a copy of a subprogram must not have.

    :ivar names: names of the files, without extension, lower case.
    :ivar contents: contents of their subprograms, which may define names that all files see.
    """

    names: Collection[str] = ()
    contents: Sequence[bytes] = ()


class SubprogramCopies(NamedTuple):
    """A program whose subprograms have other names.

    :ivar documents: its files, the main file first.
    :ivar file_names: new file name → old file name.
    :ivar routine_names: old name, upper case → new name, of further routines in the renamed files that all files see.
    """

    documents: tuple[Document, ...]
    file_names: dict[str, str]
    routine_names: dict[str, str]


@runtime_checkable
class Calling(Protocol):
    """Additional interface of a dialect whose programs call others by file name."""

    def callers(self, paths: Sequence[Path]) -> dict[Path, list[Path]]:
        """Return the files that are only run by calls of other files in `paths`: file → files that call it."""
        ...

    def moving(self, paths: Sequence[Path], cell: Cell) -> dict[Path, set[Path]]:
        """Return the files with motions that each program may call, directly or indirectly: program → called files."""
        ...

    def copy_subprograms(
        self,
        documents: Sequence[Document],
        unchanged: Sequence[bytes],
        stems: Sequence[str],
        program: str,
        other_files: OtherFiles,
    ) -> SubprogramCopies | str:
        """Return the files of a program with other names for some of its subprograms.

        :param documents: files of the program and of its subprograms, the main file first.
        :param unchanged: contents of files that are written with them and must not change.
        :param stems: names of the files to be renamed, without extension.
        :param program: name of the program, which becomes a part of the new names.
        :param other_files: files of other programs.
        :returns: the reason if that is not possible.
        """
        ...
