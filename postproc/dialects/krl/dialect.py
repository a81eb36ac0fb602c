"""KRL as one of the dialects."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path, PurePath

from msgspec import Struct
from msgspec.structs import replace

from postproc import provenance
from postproc.cell import Cell
from postproc.dialects.dialect import OtherFiles, SubprogramCopies
from postproc.dialects.krl import write
from postproc.dialects.krl.language import scan
from postproc.dialects.krl.language.names import fault_of, valid_name
from postproc.dialects.krl.language.parts import (
    MAIN,
    JoinedProgram,
    called_parts,
    files_of_routines,
    joined_program,
    stated_main_program,
)
from postproc.dialects.krl.language.scan import DEF_LINE
from postproc.dialects.krl.layout import Layout
from postproc.dialects.krl.read import read_program
from postproc.dialects.krl.read.folder import called_files_with_motion, searched_files
from postproc.dialects.text import decode
from postproc.errors import Issue, ProgramError
from postproc.frames import RAD_PER_DEG, Array
from postproc.program import Document, Program, TargetForces, TargetJoints, Targets, WrittenProgram

_SELECTION_FILE = "cell"
"""KUKA's CELL.SRC starts a program by the number that a PLC sends: the programs that it calls are main programs."""
_COMMENT = ";"
_NUMBERED_FRAME = re.compile(r"\b(BASE|TOOL)_(?:DATA[ \t]*\[[ \t]*|NO[ \t]+)([0-9]{1,3})\b", re.IGNORECASE)
"""``BASE_DATA[3]``, and ``TOOL_NO 2`` of a FDAT."""


def _part_names(path: Path, names: Sequence[str]) -> list[str]:
    """Return the names, without extension, of the further files of a program in several files.

    Such a program is ``partMain.src``, which calls ``part1.src``, ``part2.src`` …; files with its routines have the
    numbers behind. The list is empty for a program in one file, and if a file cannot be read.

    :param names: names of the files in the folder of `path`.
    """
    if not path.stem.lower().endswith(MAIN.lower()):
        return []

    def find_file(name: str) -> Document | None:
        """Return a file next to the program by its name, in letters of any case; None if there is none."""
        file_name = next((file_name for file_name in names if file_name.lower() == name.lower()), None)
        return None if file_name is None else decode(file_name, path.with_name(file_name).read_bytes())

    try:
        main = decode(path.name, path.read_bytes())
        return [
            *(name for name, _ in called_parts(main)),
            *(PurePath(document.name).stem for document in files_of_routines(main, find_file)),
        ]
    except (OSError, ProgramError):
        return []


def _main_program_of(part: Document) -> str | None:
    """Return the name of the main program that a file is a part of; None if it is no part, or a file cannot be read.

    A comment in the part names the main program, or a main program next to it calls the part: ``partMain.src`` calls
    ``part1.src``, ``part2.src`` …
    """
    if (stated_main := stated_main_program(part)) is not None:
        return stated_main
    stem = PurePath(part.name).stem  # of a part: the name of the program and a number
    main_file = f"{stem.rstrip('0123456789')}{MAIN}.src".lower()
    try:
        siblings = sorted(Path(part.folder).iterdir()) if part.folder and stem[-1:].isdigit() else []
        for path in (path for path in siblings if path.name.lower() == main_file):
            calls = [name.lower() for name, _ in called_parts(decode(path.name, path.read_bytes()))]
            return path.stem if stem.lower() in calls else None
    except (OSError, ProgramError):
        return None
    return None


def _long_file_warning(document: Document, limit: int) -> Issue:
    """Return the warning that a file of subprograms, which cannot be divided, has more than `limit` lines."""
    lines = document.text.count("\n")
    message = (
        f"{document.name} has {lines} lines, more than {limit}: files of subprograms are not divided. Divide it into "
        "several, or raise lines_per_file."
    )
    return Issue("warning", "long-file", message, subject=document.name)


class _Writer:
    """Writes KRL: a program read from KRL in its own text, any other as a new one."""

    extension = ".src"
    approximation = "approximation (C_DIS)"
    least_arc = (2e-5, 0.3 * RAD_PER_DEG)
    """Least length [m] and angle [rad] of an arc.

    Assumed: no limit is published. On smaller arcs the rounding of the three points determines the circle."""

    def fault_of(self, name: str) -> str | None:
        """Return the reason why the controller refuses a program name; None if it accepts the name."""
        return fault_of(name)

    def valid_name(self, name: str) -> str:
        """Return a name unchanged if the controller accepts it, otherwise one as close to it as possible."""
        return valid_name(name)

    def write(
        self, program: Program, targets: Targets, joints: TargetJoints, cell: Cell, comments: TargetForces | None
    ) -> WrittenProgram:
        """Return a program as text, see `Writer.write`.

        A KRL program keeps its own text, see `write.rewrite`. Another program is written as a new one, see
        `write.divide_into_modules`. Both are divided into several files if they are long, see `write.split_files`.
        """
        if isinstance(program.layout, Layout):  # it was read from KRL
            return self._rewrite(program, program.layout, targets, cell, comments)
        new_program = write.divide_into_modules(program, targets, joints, cell, comments)
        if new_program.modules is not None:  # larger than the controller's memory: divided already
            return new_program
        return write.split_files(program.name, (), new_program, cell.output.lines_per_file)

    def _rewrite(
        self, program: Program, layout: Layout, targets: Targets, cell: Cell, comments: TargetForces | None
    ) -> WrittenProgram:
        """Return a KRL program with corrected targets; its own files may be divided, files of subprograms are not.

        Files of subprograms may have other callers, which know them by their names.
        """
        limit = cell.output.lines_per_file  # 0: files are never divided
        called_names = {document.name for document in layout.execution.files}
        rewritten = write.rewrite(program, targets, comments)
        own_documents, called_documents = (
            tuple(document for document in rewritten.documents if (document.name in called_names) == is_called)
            for is_called in (False, True)
        )
        output = write.split_files(
            program.name,
            [document for document in program.documents if document.name not in called_names],
            replace(rewritten, documents=own_documents),
            limit,
            layout.execution.used_names,
            layout.resume_place,
        )
        issues = [
            _long_file_warning(document, limit)
            for document in called_documents
            if limit and document.name.lower().endswith(self.extension) and document.text.count("\n") > limit
        ]
        return replace(output, documents=(*output.documents, *called_documents), issues=(*output.issues, *issues))

    def rename(self, documents: Sequence[Document], name: str) -> tuple[Document, ...]:
        """Return the files of a program under another name."""
        return write.rename(documents, name)

    def mark(self, documents: Sequence[Document], origin: provenance.Origin) -> tuple[tuple[Document, ...], int]:
        """Return the files with a line below the first DEF that states their origin.

        :returns: the files, and the 1-based line of the main file from which on its lines have moved down by one; 0 if
            no line has moved.
        """
        return provenance.mark(documents, origin, _COMMENT, DEF_LINE)

    def origin(self, documents: Sequence[Document]) -> provenance.Provenance:
        """Return the origin that the files of a program state."""
        return provenance.of(documents, _COMMENT)


class Krl:
    """KUKA KRL."""

    name = "krl"
    extensions = (".src",)
    command_decimals = (6, 6, 6, 6, 6, 6)  # the most that programs have
    writer = _Writer()

    def companions(self, path: Path) -> list[Path]:
        """Return the other existing files of a program: its `.dat`, and the parts of a program in several files.

        Upper and lower case in names do not count. If several names differ only in case, the file whose name is
        spelled as in the program is returned.
        """
        try:
            names = os.listdir(path.parent)  # noqa: PTH208 - a folder may hold thousands of programs
        except OSError:
            return []
        stems = [path.stem, *_part_names(path, names)]
        # without the first: the .src itself
        file_names = [f"{stem}{end}".lower() for stem in stems for end in (".src", ".dat")][1:]
        path_of: dict[str, Path] = {}
        for name in sorted(names):
            key = name.lower()
            if key in file_names and (key not in path_of or PurePath(name).stem in stems):
                path_of[key] = path.with_name(name)
        return [path_of[key] for key in file_names if key in path_of]

    def numbered_frames(self, documents: Sequence[Document]) -> tuple[str, ...]:
        """Return the keys of the cell, such as ``base_data.3``, for the numbered frames that a program names.

        Comments do not count. Number 0 is `$NULLFRAME` and needs no key.
        """
        frames = {
            (kind.lower(), int(number))
            for document in documents
            for kind, number in _NUMBERED_FRAME.findall(scan.code_without_comments(document.text))
        }
        return tuple(f"{kind}_data.{number}" for kind, number in sorted(frames) if number)

    def callers(self, paths: Sequence[Path]) -> dict[Path, list[Path]]:
        """Return the files of a folder that are only run by calls of the others, see `callers`: file → its callers."""
        return callers(paths)

    def moving(self, paths: Sequence[Path], cell: Cell) -> dict[Path, set[Path]]:
        """Return the files with motions that programs of one folder may call: program → called files."""
        return called_files_with_motion(paths, [Path(cell.folder) / folder for folder in cell.krl.search])

    def called_files(self, paths: Sequence[Path], cell: Cell) -> dict[Path, list[Path]]:
        """Return the files that the reading of each program may need, see `searched_files`: program → files."""
        return searched_files(paths, [Path(cell.folder) / folder for folder in cell.krl.search])

    def copy_subprograms(
        self,
        documents: Sequence[Document],
        unchanged: Sequence[bytes],
        stems: Sequence[str],
        program: str,
        other_files: OtherFiles,
    ) -> SubprogramCopies | str:
        """Return the files of a program with other names for some of its subprograms.

        So several programs in one folder can each have a subprogram of one name that is corrected for them. For the
        parameters see `write.subprogram_copies`.

        :returns: the reason if the names cannot be changed.
        """
        return write.subprogram_copies(documents, unchanged, stems, program, other_files)

    def read(
        self, documents: Sequence[Document], cell: Cell, forward_kinematics: Callable[[Array], Array], name: str
    ) -> Program:
        """Return a program. A program in several files (``partMain.src``, ``part1.src`` …) is read as one text.

        :param documents: the `.src` first, then its companions.
        :param forward_kinematics: (6,) joints [rad] → (4, 4) flange in the robot root [m].
        :param name: name of the program.
        :raises ProgramError: the program is faulty, or moves in a way that cannot be corrected (`read.reader` lists the
            reasons); a file of the program is missing; the main file is only a part of a program and cannot be read
            without the other parts.
        """
        if (whole_program := joined_program(documents)) is not None:
            return _read_joined(whole_program, documents, cell, forward_kinematics, name)
        try:
            return read_program(documents, cell, forward_kinematics, name)
        except ProgramError as cause:
            if (main := _main_program_of(documents[0])) is None:
                raise
            problem = f"this file is a part of {main}, which calls it: without it, {cause.problem}"
            advice = f"Name {main}.src instead."
            raise ProgramError(problem, file=cause.file, line=cause.line, text=cause.text, advice=advice) from None


def _read_joined(
    whole_program: JoinedProgram,
    documents: Sequence[Document],
    cell: Cell,
    forward_kinematics: Callable[[Array], Array],
    main_name: str,
) -> Program:
    """Return a program in several files, read as one text; it is named like the main program without `MAIN`.

    Errors, unresolved motions and the layout name the original files and lines, not those of the joined text.

    :param whole_program: the program as one text.
    :param documents: files of the program and of its subprograms, the main file first.
    :param forward_kinematics: (6,) joints [rad] → (4, 4) flange in the robot root [m].
    :param main_name: name of the main program, with `MAIN`.
    :raises ProgramError: the program is faulty, or moves in a way that cannot be corrected.
    """
    stems = {PurePath(file).stem.lower() for file, _ in whole_program.files}
    subprograms = [document for document in documents if PurePath(document.name).stem.lower() not in stems]
    try:
        program = read_program((*whole_program.documents, *subprograms), cell, forward_kinematics, main_name)
    except ProgramError as cause:
        raise whole_program.error_in_file(cause) from None
    layout = program.layout
    if isinstance(layout, Layout):
        called_files = layout.execution.files  # of the routines whose calls are followed
        called_names = {document.name for document in called_files}
        documents = [*(document for document in documents if document.name not in called_names), *called_files]
        layout = replace(layout, documents=(*whole_program.documents, *called_files), files=whole_program.files)
    return replace(
        program,
        name=PurePath(whole_program.documents[0].name).stem[: -len(MAIN)],
        documents=tuple(documents),
        unresolved=tuple(whole_program.motion_in_file(motion) for motion in program.unresolved),
        # parts are written with the program: only subprograms must be there unchanged
        needed=tuple(file for file in program.needed if Path(file.path).stem.lower() not in stems),
        layout=layout,
    )


KRL = Krl()


class _FileCalls(Struct, frozen=True):
    """Calls from and to a file; names in upper case.

    :param called_names: names that the file calls and does not declare itself.
    :param callable_names: names by which other files call its routines.
    """

    called_names: frozenset[str]
    callable_names: frozenset[str]


def callers(paths: Sequence[Path]) -> dict[Path, list[Path]]:
    """Return the `.src` files of one folder that are subprograms: file → files that call it.

    A file is a subprogram if a main program, directly or indirectly, calls it; main programs are files that no file
    calls. Files that only call each other are therefore left out. A call of a GLOBAL routine of a file counts only if
    the main routine of that file is empty: otherwise the file is a program of its own.
    """
    files = {path: _file_calls(path) for path in paths}
    calling: dict[str, list[Path]] = {}  # name, upper case → files that call it
    for path, file in files.items():
        for name in file.called_names:
            calling.setdefault(name, []).append(path)
    callers_of: dict[Path, list[Path]] = {}
    callees: dict[Path, list[Path]] = {path: [] for path in paths}
    for path, file in files.items():
        calling_paths = {caller for name in file.callable_names for caller in calling.get(name, ())} - {path}
        callers_of[path] = sorted(calling_paths)
        for caller in calling_paths:
            callees[caller].append(path)
    reachable = {path for path in paths if not callers_of[path]}
    unvisited = list(reachable)
    while unvisited:
        new_paths = set(callees[unvisited.pop()]) - reachable
        reachable |= new_paths
        unvisited += new_paths
    return {path: calling_paths for path, calling_paths in callers_of.items() if calling_paths and path in reachable}


def _file_calls(path: Path) -> _FileCalls:
    """Return the names that a file calls, and the names by which others call it; both empty if it cannot be read."""
    try:
        text = path.read_bytes().decode("latin-1")
    except OSError:
        return _FileCalls(frozenset(), frozenset())
    routines = list(scan.whole_routines(text))
    name = path.stem.upper()
    callable_names = {name}
    if all(routine.is_empty for routine in routines if routine.name == name):
        callable_names |= {routine.name for routine in routines if routine.is_global}
    # programs that CELL.SRC calls are main programs: its calls do not count
    is_selection_file = path.stem.lower() == _SELECTION_FILE
    called_names = set[str]() if is_selection_file else scan.called_names(scan.code_without_comments(text))
    return _FileCalls(frozenset(called_names), frozenset(callable_names))
