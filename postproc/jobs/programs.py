"""Programs to work on: jobs for files, folders and patterns, the settings of a run, and its outcomes."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from postproc import cell as cells
from postproc import robot as robots
from postproc.cell import Cell
from postproc.correction import Mode
from postproc.dialects import Writer, registry
from postproc.dialects.dialect import Calling, Dialect
from postproc.dialects.text import decode
from postproc.errors import ForceError, InputError, Issue, OptionError, ProgramError
from postproc.files import StagedFiles, read_bytes, resolve
from postproc.forces.sources import extensions
from postproc.program import FORCE_COMMENT, Document
from postproc.report import Summary
from postproc.robot import RobotModel

PROCESS = ".toml"
"""Extension that distinguishes a process from other files of forces."""


class Job(Struct, frozen=True):
    """One program to work on.

    :param program: file of the program.
    :param dialect: name of the format to read it in.
    :param output: folder to write into.
    :param forces: CSV file with its forces, or process.toml from which they are computed; None: neither.
    :param name: name of the written program and its other files; None: the name of `program`.
    :param to: name of the format to write; None: `dialect` if postproc writes it, else KRL.
    :param is_named_by_user: True if the user named the file itself; False if only its folder or a pattern.
    :param callers: programs of the run that call this program; it is then corrected with them, not by itself.
    :param same_stock: other programs of the run with the same process: each is computed from the whole stock.
    """

    program: Path
    dialect: str
    output: Path
    forces: Path | None = None
    name: str | None = None
    to: str | None = None
    is_named_by_user: bool = True
    callers: tuple[Path, ...] = ()
    same_stock: tuple[Job, ...] = ()

    @property
    def reader(self) -> Dialect:
        """Dialect that reads the program."""
        return registry.dialect_of_name(self.dialect)

    @property
    def written_dialect(self) -> str:
        """Name of the format in which the program is written."""
        return registry.written_in(self.dialect, self.to)[0]

    @property
    def keeps_text(self) -> bool:
        """Whether the program is written with its own text and other numbers, see `Program.keeps_text`."""
        return self.written_dialect == self.dialect

    @property
    def stem(self) -> str:
        """Name of the written files, without extension."""
        return self.program.stem if self.name is None else self.name

    @property
    def process(self) -> Path | None:
        """The process.toml from which its forces are computed; None: they are not computed."""
        return self.forces if self.forces is not None and self.forces.suffix.lower() == PROCESS else None

    def input_files(self) -> list[Path]:
        """Return the files that are read for this program, without the cell."""
        companions = self.reader.companions(self.program)
        return [self.program, *companions, *([] if self.forces is None else [self.forces])]

    def report_name(self, mode: Mode) -> str:
        """Return the name of the report that says what was written (`report.json`)."""
        name = registry.program_name(self.program)
        return f"{name}.predict.report.json" if mode == "predict" else f"{self.stem}.report.json"

    def output_names(self, mode: Mode) -> list[str]:
        """Return the names of the files that may be written: programs, then reports."""
        report = self.report_name(mode).removesuffix("report.json")
        reports = [f"{report}{kind}" for kind in ("report.json", "targets.csv", "report.html")]
        if self.process is not None:
            reports.append(f"{report}stock.glb")
        if mode == "predict":
            return reports
        if self.forces is not None:
            reports.insert(1, f"{report}forces.csv")
        if self.keeps_text:
            files = [self.program, *self.reader.companions(self.program)]
            if self.name is not None:
                files = [path.with_stem(self.name) for path in files if path.stem.lower() == self.program.stem.lower()]
            return [*(path.name for path in files), *reports]
        return [f"{self.stem}{self.writer.extension}", *reports]

    def main_file_names(self, mode: Mode) -> list[str]:
        """Return the names that the main file may have: its planned name, and NAMEMain if the program is divided."""
        main_file = Path(self.output_names(mode)[0])
        return [main_file.name, *([f"{main_file.stem}Main{main_file.suffix}"] if mode != "predict" else [])]

    @property
    def writer(self) -> Writer:
        """Writer of the language in which the program is written."""
        return registry.written_in(self.dialect, self.to)[1]


def is_utf8(name: str) -> bool:
    """Return whether the name of a file is valid UTF-8; Python decodes invalid bytes to surrogates."""
    return not any("\ud800" <= letter <= "\udfff" for letter in name)


def check_utf8(path: Path) -> None:
    """Check that the name of a program is valid UTF-8.

    :raises InputError: it is not valid.
    """
    if not is_utf8(path.name):
        raise InputError("its name is not UTF-8", file=str(path), advice="Rename the file.")


def find_jobs(
    inputs: Sequence[str],
    *,
    dialect: str | None = None,
    forces: Path | None = None,
    output: Path | None = None,
    name: str | None = None,
    to: str | None = None,
) -> list[Job]:
    """Return a job for each program that files, folders and glob patterns name: sorted, each once.

    A program that other programs call, and that the user did not name itself, has `Job.callers`.

    :param inputs: files, folders, patterns. Of a folder or pattern, files with a known extension are taken; with a
        `dialect`, all files that a pattern matches. Of several versions of a file (Creo) the newest is taken.
    :param dialect: format in which all programs are read; None: by the extension.
    :param forces: CSV file (for one program), process.toml (for all), or a folder with NAME.csv or NAME.forces.csv for
        each program; None: programs have no file of forces.
    :param output: folder to write into; None: a folder `corrected` next to each program.
    :param name: name of the written program, if there is only one; None: the name of the file, changed to a valid name
        if the program is written in another dialect.
    :param to: dialect to write; None: that of the program if postproc writes it, else KRL.
    :raises InputError: an input names no program of a known format, the program cannot be written in the dialect, a
        name is given for several programs, or the name of a file that the user named is not UTF-8.
    """
    programs = _unique_paths(path for name in inputs for path in _expand(name, dialect))
    programs = _leave_out_parts(programs, {resolve(Path(name)) for name in inputs}, dialect)
    callers = _callers([path for path in programs if str(path) not in inputs], programs, dialect)
    main_programs = [path for path in programs if path not in callers]
    file_of_program = _force_files(main_programs, forces)
    if name is not None and len(main_programs) > 1:
        raise OptionError(f"one name for {len(main_programs)} programs", advice="Give --name with one program.")
    jobs = []
    for path in programs:
        if str(path) in inputs:
            check_utf8(path)
        folder = path.parent / "corrected" if output is None else output
        read_dialect = registry.dialect_of_file(path, dialect).name
        written_dialect, writer = registry.written_in(read_dialect, to)
        output_name = name
        if name is None and written_dialect != read_dialect:
            output_name = writer.valid_name(registry.program_name(path))
        jobs.append(
            Job(
                program=path,
                dialect=read_dialect,
                output=folder,
                forces=file_of_program.get(path),
                name=output_name,
                to=to,
                is_named_by_user=str(path) in inputs,
                callers=tuple(callers.get(path, ())),
            )
        )
    return jobs


def read_documents(path: Path, dialect: str) -> list[Document]:
    """Return the files of a program as they are read: the main file, and its companions, such as the `.dat` of KRL.

    :param dialect: name of its format.
    :raises ProgramError: a file cannot be read, is empty or binary.
    """
    paths = [path, *registry.dialect_of_name(dialect).companions(path)]
    return [replace(decode(file.name, read_bytes(file, ProgramError)), folder=str(file.parent)) for file in paths]


def _expand(name: str, dialect: str | None) -> Iterator[Path]:
    """Yield the programs of a folder, a pattern or a file name, sorted. A file name is yielded as it is.

    :param dialect: see `find_jobs`.
    :raises InputError: the folder or pattern has no programs.
    """
    path = Path(name)
    extensions = registry.extensions() if path.is_dir() or glob.has_magic(name) else {}
    if path.is_dir():
        files = [file for file in path.iterdir() if file.is_file() and registry.has_known_extension(file)]
        if not files:
            raise InputError("no program in this folder", file=name, advice=f"Looked for {' '.join(extensions)}.")
        yield from registry.newest_versions(sorted(files))
    elif not path.exists() and glob.has_magic(name):
        matches = [Path(match) for match in glob.glob(name, recursive=True)]  # noqa: PTH207 - also absolute patterns
        files = [file for file in matches if file.is_file() and (dialect or registry.has_known_extension(file))]
        if not files:
            raise InputError("the pattern matches no program", file=name, advice=f"Looked for {' '.join(extensions)}.")
        yield from registry.newest_versions(sorted(files))
    else:
        yield path


def _leave_out_parts(programs: list[Path], input_paths: set[Path], dialect: str | None) -> list[Path]:
    """Return programs without the companion files of other programs, such as a ``.dat``, unless the user named them.

    :param input_paths: files that the user named; `dialect`: see `find_jobs`.
    """
    parts = set()
    for path in programs if len(programs) > 1 else ():
        name = dialect or (registry.dialect_of_file(path).name if path.suffix else None)
        if name is not None:
            parts |= {resolve(companion) for companion in registry.dialect_of_name(name).companions(path)}
    return [path for path in programs if resolve(path) in input_paths or resolve(path) not in parts]


def _callers(unnamed: Sequence[Path], programs: Sequence[Path], dialect: str | None) -> dict[Path, list[Path]]:
    """Return the callers of programs that other programs call: program → its callers.

    Only programs of one folder and one format are searched for calls of each other.

    :param unnamed: programs that the user did not name; only they are returned.
    :param programs: all programs; `dialect`: see `find_jobs`.
    """
    folders: dict[tuple[Path, str], list[Path]] = {}
    for path in programs if len(programs) > 1 else ():
        folders.setdefault((path.parent, dialect or path.suffix.lower()), []).append(path)
    callers_of: dict[Path, list[Path]] = {}
    for paths in folders.values():
        reader = registry.dialect_of_file(paths[0], dialect)
        if len(paths) > 1 and isinstance(reader, Calling):
            callers_of |= reader.callers(paths)
    return {path: callers for path, callers in callers_of.items() if path in unnamed}


def _unique_paths(paths: Iterable[Path]) -> list[Path]:
    """Return paths without those that lead to the file of an earlier path."""
    by_location: dict[Path, Path] = {}
    for path in paths:
        by_location.setdefault(resolve(path), path)
    return list(by_location.values())


def _force_files(programs: Sequence[Path], forces: Path | None) -> dict[Path, Path | None]:
    """Return the force file of each program; None: the program has none.

    :param forces: a file for all programs, or a folder with a file for each program; None: no program has one.
    :raises ForceError: a table of forces is given for several programs, the folder has no file for any program, or
        several for one.
    """
    if forces is None:
        return dict.fromkeys(programs)
    if not forces.is_dir():
        if len(programs) > 1 and forces.suffix.lower() != PROCESS:
            raise ForceError(
                f"one force file for {len(programs)} programs",
                file=str(forces),
                advice="Its line numbers belong to one program. Give a folder that holds NAME.csv (or NAME.forces.csv) "
                "for each program, or write the forces into the programs as comments.",
            )
        return dict.fromkeys(programs, forces)
    files = force_files(forces)
    file_of_program = {program: force_file(program, files) for program in programs}
    if not any(file_of_program.values()):
        name = registry.program_name(programs[0])
        raise ForceError(
            "no force file for any of the programs in this folder",
            file=str(forces),
            advice=f"Looked for {name} and {name}.forces with {', '.join(extensions())} first.",
        )
    return file_of_program


def force_files(folder: Path) -> dict[str, list[Path]]:
    """Return the force files of a folder, NAME.csv and NAME.forces.csv, by name of the program in lower case."""
    files: dict[str, list[Path]] = {}
    endings = extensions()
    for file in sorted(folder.iterdir()):
        if file.suffix.lower() in endings and file.is_file():
            files.setdefault(file.stem.lower().removesuffix(".forces"), []).append(file)
    return files


def force_file(program: Path, files: Mapping[str, Sequence[Path]]) -> Path | None:
    """Return the force file of a program; None if there is none.

    :param files: name of each program → its force files, see `force_files`.
    :raises ForceError: the program has several.
    """
    named_files = files.get(registry.program_name(program).lower(), ())
    candidates = [file for file in named_files if resolve(file) != resolve(program)]
    if len(candidates) > 1:
        raise ForceError(
            f"{len(candidates)} force files for {program.name}: {' and '.join(file.name for file in candidates)}",
            file=str(candidates[0].parent),
            advice="Leave one of them there.",
        )
    return candidates[0] if candidates else None


def process_of(program: Path, output: Path, common: Path | None = None) -> Path | None:
    """Return the process file of a program; None if it has none.

    The first that exists counts: NAME.process.toml in the folder of the results, the process file `common`,
    process.toml in the folder of the results. The last is not used for a program that states its forces in comments.
    `watch` and the window use this rule.

    :param program: path of the program.
    :param output: folder of the results.
    :param common: process file that is stated for all programs; None: none is stated.
    """
    process_file = output / f"{registry.program_name(program)}.process.toml"
    shared_file = output / "process.toml"
    if process_file.is_file():
        return process_file
    if common is not None or not shared_file.is_file():
        return common
    return None if states_forces(program) else shared_file


_FORCE = re.compile(  # FORCE at the start of a comment: after ;, (, !, $$ or in PPRINT of a cutter-location file
    rb"(?:(?:[;(!]|\$\$)[ \t]*|\bPPRINT[^\r\n]{0,80}?)(FORCE\b[^\r\n]*)", re.IGNORECASE
)


def states_forces(program: Path) -> bool:
    """Return whether the text of a program seems to have force comments; False if the file cannot be read."""
    try:
        comments = (match[1].decode("latin-1") for match in _FORCE.finditer(program.read_bytes()))
        return any(FORCE_COMMENT.match(comment) for comment in comments)
    except OSError:
        return False


GOOD, FAILED, EXCEEDED = 0, 1, 3
"""Exit codes of one program: it was converted, nothing was written, the verdict is "failed"."""


class Settings(Struct, frozen=True):
    """Options for every program of a run.

    :param cell: cell file.
    :param mode: see `correction.process`.
    :param tolerance_mm: tolerance of the path; None: that of the cell. If the written program exceeds it, the exit code
        is `EXCEEDED`.
    :param part_tolerance_mm: allowed error of the part (95 %); None: that of the cell.
    :param lines_per_file: largest number of lines of a written file; None: that of the cell.
    :param linearize_arcs: write arcs as lines.
    :param keep_unresolved: leave motions of KRL as they are that only the running robot knows.
    :param part: mesh of the part, for the deviations along its surface; None: they are not computed.
    :param overwrite: replace files that postproc did not write.
    """

    cell: Path
    mode: Mode = "convert"
    tolerance_mm: float | None = None
    part_tolerance_mm: float | None = None
    lines_per_file: int | None = None
    linearize_arcs: bool = False
    keep_unresolved: bool = False
    overwrite: bool = False
    part: Path | None = None


class Outcome(Struct, frozen=True):
    """Result of the conversion of one program, also if nothing was written.

    :param program: path of the program as the user named it.
    :param code: 0 good, 1 nothing was written, 3 the verdict is "failed", see `postproc.report.answers`.
    :param summary: content of `report.json`; None: nothing was written. With code 0, nothing had to be written.
    :param message: why nothing was written, if `issues` do not state it.
    :param issues: problems of the program, if it was read but not written.
    :param written_files: files written.
    :param copied_files: written files that the program needs, and that are as they were read.
    :param earlier_remark: a sentence on the results of an earlier run, if this run has none.
    :param traceback: traceback of a fault of postproc; empty: there was none.
    :param staged_files: files that are complete and not in their places yet, see `output_plan`.
    :param shared_files: names of staged files that other programs may need too.
    :param read: files that were read.
    :param keeps_old_files: whether the results of an earlier run stay although this run has none: the program was
        converted, but its files could not be written.
    """

    program: str
    code: int
    summary: Summary | None = None
    message: str = ""
    issues: tuple[Issue, ...] = ()
    written_files: tuple[str, ...] = ()
    copied_files: tuple[str, ...] = ()
    earlier_remark: str = ""
    traceback: str = ""
    staged_files: StagedFiles | None = None
    shared_files: tuple[str, ...] = ()
    read: tuple[str, ...] = ()
    keeps_old_files: bool = False

    @property
    def is_skipped(self) -> bool:
        """Whether nothing had to be written: the program is a subprogram, converted with the programs that call it."""
        return self.summary is None and self.code == GOOD


def load_setup(settings: Settings) -> tuple[Cell, RobotModel]:
    """Return the cell of the settings, and its robot.

    :raises CellError: the cell is unusable.
    :raises ModelError: the robot model is unusable.
    """
    cell = apply_settings(cells.load(settings.cell), settings)
    return cell, load_robot(cell.robot, cell.folder)


def apply_settings(cell: Cell, settings: Settings) -> Cell:
    """Return a cell with the values that the settings of a run replace."""
    output_values = {name: getattr(settings, name) for name in ("tolerance_mm", "lines_per_file")}
    output_values = {name: value for name, value in output_values.items() if value is not None}
    if output_values:
        cell = msgspec.structs.replace(cell, output=msgspec.structs.replace(cell.output, **output_values))
    if settings.part_tolerance_mm is not None:
        part = msgspec.structs.replace(cell.part, tolerance_mm=settings.part_tolerance_mm)
        cell = msgspec.structs.replace(cell, part=part)
    if settings.keep_unresolved:
        cell = msgspec.structs.replace(cell, krl=msgspec.structs.replace(cell.krl, keep_unresolved=True))
    return cell


def load_robot(name: str, relative_to: str | Path = ".") -> RobotModel:
    """Read a robot model.

    :param name: name of a shipped robot (`postproc robots` lists them), or path of a model folder.
    :param relative_to: folder from which the path is relative; for the robot of a cell, `cell.folder`.
    :raises ModelError: there is no such model, or it is unusable.
    """
    return robots.load(robots.find(name, Path(relative_to)))
