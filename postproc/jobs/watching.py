"""`postproc watch`: programs of a folder are converted as they arrive or change.

The folder is scanned, and only scans decide, so that nothing is missed if a notification is lost, as on network drives.
The library watchfiles, if it is installed, only shortens the time to the next scan. A program is converted
once it has not changed for `QUIET` and can be opened. What has been converted is in a file of the output folder, with
the sums of the contents, and of the cell and the other files that all programs are converted with: after a change of
these all are converted again. After a crash the reports say what has been converted. The overview lists all programs,
also those that could not be. `server` shows it on this machine: it listens on 127.0.0.1 and only reads the folder.
"""

from __future__ import annotations

import glob
import json
import os
import tempfile
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatch
from functools import lru_cache, partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Event
from typing import Any, NamedTuple

import msgspec
from msgspec.structs import replace

from postproc import cell as cells
from postproc import files, provenance
from postproc.cell import Cell
from postproc.dialects import registry
from postproc.errors import InputError, PostprocError
from postproc.jobs import inputs
from postproc.jobs.called_files import CalledFiles
from postproc.jobs.conversion import options_of, origin_of
from postproc.jobs.output_plan import (
    OVERVIEW,
    leftover_note,
    removal_note,
    removed_results,
    same_names,
    shared_name_problem,
)
from postproc.jobs.programs import (
    FAILED,
    GOOD,
    PROCESS,
    Job,
    Outcome,
    Settings,
    find_jobs,
    force_file,
    force_files,
    is_utf8,
    process_of,
    read_documents,
    states_forces,
)
from postproc.jobs.runs import convert_all, failure_reason, write_overview
from postproc.report import index
from postproc.version import VERSION

QUIET = 1.0
"""Time for which a file must not have changed [s]."""
SCAN = 0.5
"""Time between two scans [s] (assumed)."""
STATE = ".postproc-watch.json"


class FileStamp(NamedTuple):
    """Name, size [bytes] and time of change [ns] of a file; the size is −1 if it is missing."""

    name: str
    size: int
    changed_ns: int

    @classmethod
    def of(cls, path: Path) -> FileStamp:
        """Return the stamp of a file.

        :raises OSError: the file does not exist, or cannot be reached.
        """
        status = path.stat()
        return cls(path.name, status.st_size, status.st_mtime_ns)


Signature = tuple[FileStamp, ...]
"""Names, sizes and times of the files of a program: while they are equal, the files have not changed."""


class _InputState(NamedTuple):
    """Files of a program before its conversion.

    :param signature: names, sizes and times of the files.
    :param digest: SHA-256 of their contents; None: a file could not be opened.
    """

    signature: Signature
    digest: str | None


class Entry(msgspec.Struct, frozen=True):
    """A program that has been converted, or could not be converted.

    :param sum: SHA-256 of the contents of its files.
    :param code: exit code of the conversion.
    :param setup: checksum of the set-up of all programs, see `_Watcher.setup`.
    :param reason: why nothing was written; empty: the program was converted.
    """

    sum: str
    code: int
    setup: str = ""
    reason: str = ""


def watch(
    folder: Path,
    output: Path,
    settings: Settings,
    options: Mapping[str, Any],
    *,
    pattern: str | None = None,
    workers: int = 1,
    say: Callable[[str], None] = lambda _: None,
    stop: Event | None = None,
) -> Iterator[tuple[Outcome, Job]]:
    """Convert programs of a folder as they arrive or change, until `stop` is set; return an iterator of the outcomes.

    :param folder: folder of the programs; `output`: folder to write into.
    :param options: further arguments of `find_jobs`: dialect, forces, to.
    :param pattern: pattern of the names of the programs, such as ``*.prg``; None: all files with a known extension.
    :param workers: number of local processes.
    :param say: called with a sentence for the user, such as that a folder is missing or a file locked.
    :param stop: event that ends the watch; None: it never ends.
    :raises InputError: the folder does not exist at the beginning, or is the folder of the results.
    :raises PostprocError: the cell or the robot is unusable.
    """
    if not folder.is_dir():
        raise InputError("no such folder", file=str(folder), advice="Give the folder into which programs are written.")
    if output.resolve() == folder.resolve():
        problem = "results in the folder that is watched would be taken for programs that arrive"
        raise InputError(problem, file=str(output), advice="Give another folder with -o.")
    watcher = _Watcher(folder, output, settings, options, workers, say, pattern)
    return _outcomes(watcher, Event() if stop is None else stop)


def _outcomes(watcher: _Watcher, stop: Event) -> Iterator[tuple[Outcome, Job]]:
    """Yield outcomes of the programs that arrive in the folder, until `stop` is set."""
    pause = _pause(watcher.folder, stop)
    while not stop.is_set():
        ready = watcher.scan(time.monotonic())
        if ready:
            yield from watcher.convert(ready)
        pause()


def _pause(folder: Path, stop: Event) -> Callable[[], object]:
    """Return a function that waits until something may have changed in a folder, for `SCAN` at most.

    Without the library watchfiles it always waits for `SCAN`. `stop` ends the wait.
    """
    try:
        from watchfiles import watch as changes
    except ImportError:
        return lambda: stop.wait(SCAN)

    def wait() -> None:
        """Wait until something in the folder changes, or a scan is due."""
        start = time.monotonic()
        try:
            # times in ms; changes within 200 ms are one notification
            options = {"yield_on_timeout": True, "recursive": False, "rust_timeout": int(1e3 * SCAN), "debounce": 200}
            next(changes(folder, stop_event=stop, raise_interrupt=True, **options), None)
        except (OSError, RuntimeError):  # the folder is gone, or the system has no notifications left
            stop.wait(SCAN)
        # wait a fifth of `SCAN` at least, so that many changes do not cause scan after scan
        stop.wait(max(0.0, 0.2 * SCAN - (time.monotonic() - start)))

    return wait


def _file_status(path: Path) -> tuple[int, int]:
    """Return size [bytes] and time of change [ns] of a file; zeros if it does not exist."""
    try:
        status = path.stat()
    except OSError:
        return 0, 0
    return status.st_size, status.st_mtime_ns


def _files_of_process(path: Path, status: os.stat_result) -> list[Path]:
    """Return the process file and the files that it names, as far as they exist.

    The process file is read again when its status has changed.
    """
    return [file for file in _read_process(path, status.st_size, status.st_mtime_ns) if file.is_file()]


@lru_cache(1024)
def _read_process(path: Path, size: int, time_ns: int) -> tuple[Path, ...]:
    """Return the process file and the files that it names; size and time are only keys of the cache."""
    return tuple(inputs.force_inputs(path))


class _Watcher:
    """State of the programs of a folder.

    :ivar code: checksum of the code of the package.
    :ivar setup: checksum of the set-up of all programs: code, options, cell, robot, process and other common files;
        empty before the files were read.
    :ivar setup_paths: the files of the set-up; `setup_status`: size and time of each at the last scan.
    :ivar setup_since: monotonic time of the last change of these files [s].
    :ivar is_setup_read: whether `setup` was computed after this change.
    :ivar cell: the cell; None: it is unusable.
    :ivar called_files: files that the programs may call, from scan to scan.
    :ivar same_named: programs that were refused because they would be written under one name.
    :ivar force_folder: folder of forces; None: there is none.
    :ivar force_files: files in the folder of forces at the last scan, see `programs.force_files`.
    :ivar plain_options: arguments of `find_jobs` without the folder of forces.
    :ivar last_changes: program → its signature, and the monotonic time of the last change [s].
    :ivar finished: program → signature with which it was converted, or refused.
    :ivar entries: content of the state file: name of the program → entry.
    :ivar listing: programs of the folder at the last scan that had none to convert; `listing_since`: monotonic time
        since which they are the same [s]; `is_listing_reported`: whether programs that are no longer there were named.
    :ivar removed: reports of programs that are no longer there and were named.
    :ivar reported: sentences that were passed to `say` and are not repeated.
    """

    def __init__(
        self,
        folder: Path,
        output: Path,
        settings: Settings,
        options: Mapping[str, Any],
        workers: int,
        say: Callable[[str], None],
        pattern: str | None = None,
    ) -> None:
        self.folder, self.output, self.settings, self.options = folder, output, settings, options
        self.pattern = pattern
        force_path: Path | None = options.get("forces")
        self.force_folder = force_path if force_path is not None and force_path.is_dir() else None
        self.plain_options = {**options, "forces": None if self.force_folder else force_path}
        self.force_files: dict[str, list[Path]] = {}
        self.workers, self.say = workers, say
        self.last_changes: dict[Path, tuple[Signature, float]] = {}
        self.finished: dict[Path, Signature] = {}
        self.entries = self._read_entries()
        self.reported: set[str] = set()
        self.same_named: set[Path] = set()
        self.code, self.setup = inputs.code_sum(), ""
        self.setup_paths: list[Path] = []
        self.setup_status: tuple[tuple[int, int], ...] = ()
        self.setup_since, self.is_setup_read = 0.0, False
        self.cell: Cell | None = None
        self.called_files = CalledFiles(folder, options.get("dialect"))
        self.listing: frozenset[Path] = frozenset()
        self.listing_since, self.is_listing_reported = -QUIET, False
        self.removed: frozenset[Path] = frozenset()

    def scan(self, time_s: float) -> list[Path]:
        """Return the programs to convert: they are new or have changed, and can be read.

        The files of the program, those that it may call, and those of the set-up must not have changed for `QUIET`.
        None is returned while a folder cannot be read or the output folder cannot be written; a sentence says so once.

        :param time_s: monotonic time [s].
        """
        is_setup_quiet = self._is_setup_quiet(time_s)
        try:
            self.force_files = {} if self.force_folder is None else force_files(self.force_folder)
            programs = self._programs()
            self.called_files.update(programs, self.cell)
            signatures = {path: self._signature(path) for path in programs}
        except OSError as cause:
            self._report_new(f"{cause.filename or self.folder} cannot be read at present. Waiting for it.")
            return []
        folders = (self.force_folder, *self.called_files.folders)
        self.reported -= {f"{folder} cannot be read at present. Waiting for it." for folder in folders}
        self._forget_removed(signatures)
        ready = []
        for path, signature in sorted(signatures.items()):
            if signature is None or self.finished.get(path) == signature:
                continue
            last_signature, change_time = self.last_changes.get(path, (None, time_s))
            if last_signature != signature:
                self.last_changes[path] = (signature, time_s)
            elif time_s - change_time >= QUIET and not self._waits_for_forces(path) and self._is_new(path, signature):
                ready.append(path)
        if not ready:
            self._report_removed(frozenset(signatures), time_s)
        return ready if is_setup_quiet and ready and self._can_write() else []

    def _forget_removed(self, programs: Collection[Path]) -> None:
        """Remove the state of programs that are no longer in the folder; of all programs if the state file is missing.

        Programs that had the name of a removed one are tried again.
        """
        if self.entries and not (self.output / STATE).is_file():
            self.entries = {}
            self.finished.clear()
        for removed_path in self.last_changes.keys() - set(programs):
            self.last_changes.pop(removed_path)
            self.finished.pop(removed_path, None)
            if removed_path in self.same_named:
                self._retry_same_named()

    def _report_removed(self, programs: frozenset[Path], time_s: float) -> None:
        """Name the results of programs that are no longer in the folder, here and in the overview.

        That is done at the start, and once the programs of the folder have been others for `QUIET`, because an editor
        may remove a file that it replaces.

        :param programs: programs of the folder; `time_s`: monotonic time [s].
        """
        if programs != self.listing:
            self.listing, self.listing_since, self.is_listing_reported = programs, time_s, False
        if self.is_listing_reported or time_s - self.listing_since < QUIET or not self.output.is_dir():
            return
        self.is_listing_reported = True
        removed = removed_results(self.output, [self.folder])
        note = removal_note({report: removed[report] for report in removed if report not in self.removed})
        if note:
            self.say(note)
        if removed.keys() != self.removed:
            self.removed = frozenset(removed)
            self._write_overview()

    def _retry_same_named(self) -> None:
        """Remove the results of programs that were refused for a shared name: the next scan tries them again."""
        for path in self.same_named:
            self.finished.pop(path, None)
            self.entries.pop(path.name, None)
        self.same_named.clear()

    def _can_write(self) -> bool:
        """Return whether the output folder can be written at present; if not, report it once."""
        waiting = f"{self.output} cannot be written at present. Waiting for it."
        try:
            self.output.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.output):
                self.reported.discard(waiting)
                return True
        except OSError:
            self._report_new(waiting)
            return False

    def _is_setup_quiet(self, time_s: float) -> bool:
        """Return whether the files of the set-up have not changed for `QUIET` and are read; read them if they are due.

        :param time_s: monotonic time [s].
        """
        if tuple(map(_file_status, self.setup_paths)) != self.setup_status or not self.setup:
            self.setup_paths = self._read_setup_paths()
            self.setup_status = tuple(map(_file_status, self.setup_paths))
            self.setup_since, self.is_setup_read = time_s, False
        if self.is_setup_read:
            return True
        if self.setup and time_s - self.setup_since < QUIET:
            return False
        return self._read_setup()

    def _read_setup(self) -> bool:
        """Compute the checksum `setup` of the files that all programs share; return whether all could be read.

        If `setup` has changed, all programs are converted again.
        """
        option_texts = {
            **options_of(self.settings),
            **{name: str(value) for name, value in sorted(self.options.items())},
        }
        try:
            contents = [path.read_bytes() for path in self.setup_paths if path.is_file()]
        except OSError:
            return False
        # at the first reading: the set-ups of an earlier watch, from the state file
        last_setups = {self.setup} if self.setup else {entry.setup for entry in self.entries.values()}
        self.is_setup_read = True
        self.setup = provenance.digest([self.code.encode(), json.dumps(option_texts).encode(), *contents])
        if last_setups - {self.setup}:
            self.say("The cell, a file used with it, an option or postproc has changed: all are converted again.")
            self.finished.clear()
        return True

    def _read_setup_paths(self) -> list[Path]:
        """Read `cell`; return the files of the set-up: cell, robot, part, common forces.

        If the cell is unusable, the cell file alone is returned of its files.
        """
        settings = self.settings
        paths = [settings.cell, *([] if settings.part is None else [settings.part])]
        self.cell = None
        try:
            self.cell = cells.load(settings.cell)
            paths += [*inputs.cell_inputs(settings.cell, self.cell)[1:], *inputs.robot_inputs(self.cell)]
        except PostprocError:
            pass
        forces: Path | None = self.plain_options["forces"]
        if forces is not None:
            paths += inputs.force_inputs(forces)
        return paths

    def convert(self, ready: Sequence[Path]) -> Iterator[tuple[Outcome, Job]]:
        """Convert programs; yield each outcome, and record it as soon as its files are written.

        If an error concerns the whole run, the programs are converted one by one, so that only those fail that cause
        it. At the end the overview is written.
        """
        states: dict[Path, _InputState] = {}
        for path in ready:
            signature, _ = self.last_changes[path]
            states[path] = _InputState(signature, self._program_digest(path))
        jobs: list[Job] = []
        try:
            jobs = self._jobs(ready)
            yield from self._convert_jobs(jobs, states)
        except PostprocError as cause:
            if len(ready) == 1:  # the error is that of this program
                remark = leftover_note(jobs or self._jobs_without_forces(ready[0]), self.settings.mode)
                failure = Outcome(str(ready[0]), FAILED, message=str(cause), earlier_remark=remark)
                self._record(ready[0], failure, states[ready[0]])
                self._write_overview()
                yield failure, Job(ready[0], "", self.output)
                return
            for path in ready:
                if self.finished.get(path) != states[path].signature:
                    yield from self.convert([path])
        for path in ready:  # programs without an outcome were converted with their callers
            if self.finished.get(path) != states[path].signature:
                self._record(path, Outcome(str(path), GOOD), states[path])
        self._write_overview()

    def _write_overview(self) -> None:
        """Write the overview of the output folder, with the programs that could not be converted.

        If it cannot be written, or would replace a file that postproc did not write, a sentence says so once.
        """
        if files.find_foreign_file(self.output / OVERVIEW) and not self.settings.overwrite:
            self._report_new(f"{self.output / OVERVIEW} was not written by postproc: there is no overview.")
            return
        failures = [
            index.Entry(name, page="", content=None, message=entry.reason)
            for name, entry in self.entries.items()
            if entry.reason and (self.folder / name).is_file()
        ]
        try:
            write_overview(self.output, failures, removed_results(self.output, [self.folder]))
        except InputError as cause:
            self._report_new(str(cause))

    def _convert_jobs(self, jobs: Sequence[Job], states: Mapping[Path, _InputState]) -> Iterator[tuple[Outcome, Job]]:
        """Convert jobs; yield each outcome, and record it with the state of its inputs before the conversion.

        :param states: program → its files before the conversion; other programs are not recorded.
        """
        by_name = {str(job.program): job for job in jobs}
        for outcome in convert_all(jobs, self.settings, workers=self.workers, waiting=self.say):
            job = by_name[outcome.program]
            if job.program in states:
                self._record(job.program, outcome, states[job.program])
            yield outcome, job

    def _jobs(self, ready: Sequence[Path]) -> list[Job]:
        """Return the jobs of programs; a program that others call is replaced by its callers.

        :raises InputError: one of the programs and another program of the folder would be written under one name.
        """
        options = {"output": self.output, **self.plain_options}
        try:
            all_jobs = find_jobs([self._input_name()], **options)
        except PostprocError:  # another program of the folder cannot be read yet
            all_jobs = find_jobs([str(path) for path in ready], **options)
        programs = set(ready)
        for job in all_jobs:
            if job.program in programs:
                programs |= set(job.callers)
        for pair in same_names(job for job in all_jobs if not job.callers):
            if not programs.isdisjoint(job.program for job in pair):
                self.same_named |= {job.program for job in pair}
                raise InputError(shared_name_problem(*pair), advice="Nothing was written. Rename one of them.")
        return self._find_forces(job for job in all_jobs if job.program in programs and not job.callers)

    def _input_name(self) -> str:
        """Return what is watched as `find_jobs` takes it: the folder, or a pattern in it."""
        folder = str(self.folder)
        return folder if self.pattern is None else str(Path(glob.escape(folder), self.pattern))

    def _jobs_without_forces(self, program: Path) -> list[Job]:
        """Return the job of a program without its file of forces; an empty list if that fails too."""
        try:
            return find_jobs([str(program)], output=self.output, **self.plain_options)
        except PostprocError:
            return []

    def _find_forces(self, jobs: Iterable[Job]) -> list[Job]:
        """Return jobs with their files of forces; if the folder of forces lacks a file, the job names that file."""
        folder = self.force_folder
        if folder is not None:
            return [replace(job, forces=self._forces_of(job.program, folder)) for job in jobs]
        return [replace(job, forces=self._process_of(job.program) or job.forces) for job in jobs]

    def _process_of(self, program: Path) -> Path | None:
        """Return the process file of a program, see `programs.process_of`.

        None: it has none, or forces are stated in a table or a folder for all programs.
        """
        common: Path | None = self.plain_options["forces"]
        is_process = common is None or common.suffix.lower() == PROCESS
        return process_of(program, self.output, common) if is_process and self.force_folder is None else None

    def _forces_of(self, program: Path, folder: Path) -> Path | None:
        """Return the file with the forces of a program; None if its comments state them.

        A program without either has NAME.csv in the folder, which does not exist.

        :param folder: folder of forces.
        :raises ForceError: the program has several files of forces.
        """
        file = force_file(program, self.force_files)
        return file if file is not None or states_forces(program) else folder / f"{registry.program_name(program)}.csv"

    def _waits_for_forces(self, path: Path) -> bool:
        """Return whether a program waits for its forces: they are missing, and nothing has been written for it yet.

        A program that was written loses its result if its forces are removed: it is tried again, and fails.
        """
        name = registry.program_name(path)
        if not self.force_files or name.lower() in self.force_files or states_forces(path):
            return False
        if (self.output / f"{name}.report.json").is_file():
            return False
        self._report_new(f"{path} waits for its forces: {name}.csv or {name}.forces.csv in {self.force_folder}.")
        return True

    def _programs(self) -> list[Path]:
        """Return the programs of the folder; report names that are not UTF-8 once."""
        takes_any_extension = self.pattern is not None and self.options.get("dialect") is not None
        programs = []
        for path in self.folder.iterdir():
            is_program = takes_any_extension or registry.has_known_extension(path)
            is_program = is_program and fnmatch(path.name, self.pattern or "*")
            if is_program and not path.name.startswith((".", "~")) and path.is_file():
                if is_utf8(path.name):
                    programs.append(path)
                else:
                    self._report_new(f"{path}: its name is not UTF-8. Rename the file.")
        return registry.newest_versions(programs)

    def _input_files(self, path: Path) -> list[Path]:
        """Return the files that a program is read from: its own, its companions, those that it calls, and its forces.

        Forces that are common to all programs belong to the set-up, and are left out.
        """
        companions = registry.dialect_of_file(path, self.options.get("dialect")).companions(path)
        process = self._process_of(path)
        is_common = process is None or process == self.plain_options["forces"]
        process_files = [] if process is None or is_common else _files_of_process(process, process.stat())
        forces = self.force_files.get(registry.program_name(path).lower(), ())
        return [path, *companions, *self.called_files.files_of(path), *forces, *process_files]

    def _signature(self, path: Path) -> Signature | None:
        """Return names, sizes and times of the files of a program; None if one of them does not exist any more."""
        try:
            return tuple(map(FileStamp.of, self._input_files(path)))
        except FileNotFoundError:
            return None

    def _program_digest(self, path: Path) -> str | None:
        """Return the SHA-256 of the files of a program; None, with a remark to the user, if one cannot be opened."""
        try:
            return provenance.digest(file.read_bytes() for file in self._input_files(path))
        except OSError:
            self._report_new(f"{path} cannot be opened at present, another program may be writing it. Waiting for it.")
            return None

    def _is_new(self, path: Path, signature: Signature) -> bool:
        """Return whether a program differs from the version that was converted; if not, record it as finished.

        A program that cannot be opened at present counts as not new.

        :param signature: signature of the program in this scan.
        """
        digest = self._program_digest(path)
        if digest is None:
            return False
        entry = self.entries.get(path.name)
        is_converted = self._is_written(path) if entry is None else (entry.sum, entry.setup) == (digest, self.setup)
        if is_converted:
            self.finished[path] = signature
        return not is_converted

    def _is_written(self, path: Path) -> bool:
        """Return whether the output folder has the program as the present inputs and options make it.

        The line of origin shows that, a comment in the written program with the checksums of its inputs. With the mesh
        of a part, or files that the program may call, False is returned, because the line of origin need not depend on
        them. False also if a file is missing or cannot be read.
        """
        if self.settings.part is not None or self.called_files.files_of(path):
            return False
        try:
            (job,) = self._find_forces(find_jobs([str(path)], output=self.output, **self.plain_options))
            report = json.loads((self.output / job.report_name("convert")).read_bytes())
            main = next(self.output / name for name in job.main_file_names("convert") if (self.output / name).is_file())
            origin = job.writer.origin(read_documents(main, job.written_dialect))
            expected = (self._expected_sums(path, job), options_of(self.settings), "corrected", VERSION)
            is_same = (origin.sums, origin.options, origin.mode, origin.version) == expected
            return is_same and report["program"] == path.name
        # the output is what any version or program may have left: if in doubt, the program is converted
        except (PostprocError, OSError, ValueError, KeyError, TypeError, StopIteration):
            return False

    def _expected_sums(self, path: Path, job: Job) -> dict[str, str]:
        """Return the checksums of the present inputs of a program, as `sums` of a line of origin has them.

        :raises PostprocError: an input cannot be read.
        """
        cell = cells.load(self.settings.cell)
        origin = origin_of(read_documents(path, job.dialect), self.settings.cell, cell, job.forces, "corrected")
        return {"source": origin.source, "cell": origin.cell, "model": origin.model, "forces": origin.forces}

    def _record(self, path: Path, outcome: Outcome, state: _InputState) -> None:
        """Record in the state file that a program has been converted, or could not be converted.

        :param state: its files before the conversion. If one could not be opened, no entry is written, so that the
            program is converted again after a restart.
        """
        self.finished[path] = state.signature
        if state.digest is not None:
            fault = failure_reason(outcome) if outcome.summary is None and outcome.code == FAILED else ""
            self.entries[path.name] = Entry(sum=state.digest, code=outcome.code, setup=self.setup, reason=fault)
            files.write_whole(self.output, {STATE: msgspec.json.encode(self.entries)})

    def _read_entries(self) -> dict[str, Entry]:
        """Return the entries of the state file; none if it does not exist or cannot be read."""
        try:
            return msgspec.json.decode((self.output / STATE).read_bytes(), type=dict[str, Entry])
        except (OSError, msgspec.MsgspecError):
            return {}

    def _report_new(self, sentence: str) -> None:
        """Pass a sentence to `say`, unless it was passed before."""
        if sentence not in self.reported:
            self.reported.add(sentence)
            self.say(sentence)


_RELOAD_S = 2
"""Time after which an open page is loaded again [s]."""
_EMPTY_OVERVIEW = b"<!DOCTYPE html><title>postproc</title><p>No program has been converted yet."
_SERVED_FILES = (".html", ".json", ".csv", ".glb", ".src", ".dat", ".mod")


def server(folder: Path, port: int) -> ThreadingHTTPServer:
    """Return a server of a folder, bound to 127.0.0.1.

    :param port: number of the port; 0: any free port.
    :raises PostprocError: the port is in use.
    """
    try:
        return ThreadingHTTPServer(("127.0.0.1", port), partial(_Overview, directory=str(folder)))
    except OSError as cause:
        raise PostprocError(
            f"port {port} of 127.0.0.1 cannot be used ({cause.strerror}). Give another --port."
        ) from cause


class _Overview(SimpleHTTPRequestHandler):
    """Server of the files of a folder, whose overview reloads itself.

    Requests under the name of another host are refused, against DNS rebinding.
    """

    def do_GET(self) -> None:
        """Send a file of the folder.

        A missing overview is replaced by an empty page. Files in subfolders and with other extensions are not sent.
        """
        host = (self.headers.get("Host") or "").rpartition(":")[0]
        path = self.path.partition("?")[0]
        if host not in ("127.0.0.1", "localhost"):
            self.send_error(403)
        elif path in ("/", "/index.html") and not (Path(self.directory) / "index.html").is_file():
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(_EMPTY_OVERVIEW)))
            self.end_headers()
            self.wfile.write(_EMPTY_OVERVIEW)
        elif path != "/" and (path.count("/") > 1 or not path.lower().endswith(_SERVED_FILES)):
            self.send_error(404)
        else:
            super().do_GET()

    def do_HEAD(self) -> None:
        """Refuse the request: browsers do not need it."""
        self.send_error(405)

    def end_headers(self) -> None:
        """Add headers that let the overview reload itself, and that forbid caches."""
        if self.path.partition("?")[0] in ("/", "/index.html"):
            self.send_header("Refresh", str(_RELOAD_S))
        self.send_header("Cache-Control", "no-store")
        super().end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: the terminal shows the programs."""
