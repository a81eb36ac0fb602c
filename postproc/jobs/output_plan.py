"""The plan of a run: files that it will write, files of earlier runs that it retires, and the order of programs.

`OutputPlan` is made before work begins, from the list of programs and from the reports in the output folders. Only the
plan has the files of several programs, and only the plan moves files to their final names. Programs are converted
into folders of their own (`files.stage`), in any process and on any machine. A `Task` hands a program to its process
together with the files of other programs; `needed_copies`, `differing_files` and `copy_subprograms` decide from the
task alone. The plan decides what the staged files replace, and when. Its process has locked the output folders from the
plan to the last replacement (`files.lock`).

Programs may call one subprogram. Its corrected file is shared by the programs for which it is equal. For another
program it is written under a name of its own, and that program calls this copy.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path, PurePath

from msgspec import Struct
from msgspec.structs import replace

from postproc import files
from postproc.cell import Cell
from postproc.correction import Mode
from postproc.dialects import registry
from postproc.dialects.dialect import Calling, OtherFiles, SubprogramCopies
from postproc.dialects.text import decode
from postproc.errors import InputError, Issue, PostprocError, ProgramError
from postproc.files import (
    find_foreign_file,
    find_foreign_files,
    path_list,
    recorded_files,
    recorded_names,
    recorded_text,
    refuse,
)
from postproc.jobs.programs import FAILED, Job, Outcome, Settings, read_documents
from postproc.program import Document, NeededFile
from postproc.provenance import digest

OVERVIEW = "index.html"
"""File that lists the programs of an output folder."""
_REPORTS = (".report.html", ".targets.csv", ".forces.csv", ".ply", ".glb")
"""Endings of files that no two programs have in common."""
COPIED_KEY = "copied"
"""Key of a report: files that were written as they were read, and in which nothing is called that moves."""


class Record(Struct, frozen=True):
    """The files that were written for a program, as its report lists them.

    :param program: name of the program.
    :param folder: the folder that contains the files: the output folder, or a staging folder in it.
    :param files: name of each file → SHA-256.
    :param copied: names of the files that were written as they were read.
    :param is_renewed: whether this run will still convert the program again.
    """

    program: str
    folder: Path
    files: Mapping[str, str]
    copied: frozenset[str] = frozenset()
    is_renewed: bool = False


class Task(Struct, frozen=True):
    """A job, and the files of other programs in its output folder when it begins.

    :param job: the job.
    :param names: names of the other programs that the run writes into the folder, lower case, without extension.
    :param records: files of other programs in the folder; empty if the program cannot share files with them.
    :param used_names: names that a copy of a subprogram must not have, lower case, without extension.
    """

    job: Job
    names: frozenset[str] = frozenset()
    records: tuple[Record, ...] = ()
    used_names: frozenset[str] = frozenset()


def needed_copies(task: Task, needed_files: Sequence[NeededFile], names: Collection[str]) -> dict[str, bytes]:
    """Return the unchanged files that are written with a program because it needs them: name → content.

    A file that is a program of this run itself is omitted, and a file that is in the output folder already. So is a
    file without motions that was written for another program from the same source: its routines are unchanged.

    :param needed_files: files that the program needs; `names`: names of its other files.
    """
    job, names_in_use = task.job, {name.lower() for name in names}
    copies: dict[str, bytes] = {}
    for needed_file in needed_files:
        path = Path(needed_file.path)
        if needed_file.program or path.name.lower() in names_in_use or path.stem.lower() in task.names:
            continue
        if path.parent.resolve() == job.output.resolve():
            continue
        # such as the .src and the .dat of one name
        same_stem = [Path(file.path) for file in needed_files if Path(file.path).stem.lower() == path.stem.lower()]
        if needed_file.moves or not _has_same_sources(task, same_stem):
            copies[path.name] = path.read_bytes()
    return copies


def needed_warnings(
    task: Task, needed_files: Sequence[NeededFile], copies: Collection[str], contents: Mapping[str, bytes]
) -> Iterator[Issue]:
    """Yield warnings of needed files that are written unchanged although they have motions, or that are not written.

    :param needed_files: files that the program needs; `copies`: names of those that are written unchanged.
    :param contents: all files that are written: name → content.
    """
    job = task.job
    for needed_file in needed_files:
        path = Path(needed_file.path)
        if needed_file.uncorrected and path.name in copies:
            message = (
                f"{path.name} is written uncorrected, as it was read, and has motions. Do not load it over a corrected "
                "one."
            )
            yield Issue("warning", "uncorrected-file", message, subject=path.name)
        is_in_folder = path.stem.lower() in task.names or (job.output / path.name).exists()
        if needed_file.program and not is_in_folder and _contains_any_name(needed_file.variables, contents):
            names = ", ".join(needed_file.variables) or "variables"
            message = (
                f"{path.name}, from which {job.stem} takes {names}, is not written: it belongs to "
                f"{needed_file.program}, which moves the robot. The controller needs both: load them too, "
                "corrected or not."
            )
            yield Issue("warning", "data-not-written", message, subject=path.name)


def _contains_any_name(names: Sequence[str], contents: Mapping[str, bytes]) -> bool:
    """Return whether one of some names occurs in the contents, case ignored; True if no name is given.

    :param contents: file name → content.
    """
    all_text = b"\n".join(contents.values()).upper()
    return not names or any(name.upper().encode() in all_text for name in names)


def _has_same_sources(task: Task, paths: Sequence[Path]) -> bool:
    """Return whether files of these names were written for other programs from these sources, and are intact.

    Their line of origin states the checksum of the source. False if a file is missing or cannot be read.

    :param paths: source files of one stem, such as `.src` and `.dat`.
    """
    writer = task.job.writer
    paths = sorted(paths, key=lambda path: path.suffix.lower() != writer.extension)  # the .src first
    main_content, *other_contents = (_intact_content(task.records, path.name) for path in paths)
    if main_content is None or None in other_contents:
        return False
    try:
        origin = writer.origin([decode(paths[0].name, main_content)])
        return origin.sums.get("source") == digest(path.read_bytes() for path in paths)
    except (OSError, ProgramError):
        return False


def _intact_content(records: Sequence[Record], name: str) -> bytes | None:
    """Return the content of a file that was written for a program, by the first record that lists it.

    :returns: None if no record lists the file, it cannot be read, or it was changed after it was written.
    """
    record = next((record for record in records if name in record.files), None)
    if record is None:
        return None
    try:
        content = (record.folder / name).read_bytes()
    except OSError:
        return None
    return content if digest([content]) == record.files[name] else None


def differing_files(
    task: Task,
    texts: Mapping[str, bytes],
    subprograms: Sequence[str],
    copies: Collection[str],
    read: Sequence[Document],
) -> dict[str, str]:
    """Return the files that differ from those written for another program: name → that program.

    Programs that the run will convert again do not count. Nor does a file that was only copied for the other program
    from the same source: its routines without motions are equal in the corrected file.

    :param texts: files of the program, of its subprograms, and unchanged copies: name → content.
    :param subprograms: names of the files of subprograms; `copies`: names of the unchanged copies.
    :param read: the documents of the program as they were read.
    :raises InputError: a subprogram is also converted as a program of its own in this run.
    """
    for name in subprograms:
        if PurePath(name).stem.lower() in task.names:
            raise InputError(
                f"{task.job.program} calls {name}, which is also converted as a program of its own in this run",
                advice="Name the main programs instead of their folder, or move the file of the subprogram into a "
                "folder that [krl] search in the cell names.",
            )
    source_contents = {document.name: document.to_bytes() for document in read} if task.records else {}
    program_of_file: dict[str, str] = {}
    for record in task.records:
        if record.is_renewed:
            continue
        for name in texts.keys() & record.files.keys() - program_of_file.keys():
            file_digest = record.files[name]
            if file_digest == digest([texts[name]]):
                continue
            same_source = name in source_contents and file_digest == digest([source_contents[name]])
            if not (name in record.copied and name not in copies and same_source):
                program_of_file[name] = record.program
    return program_of_file


def copy_subprograms(
    task: Task,
    documents: Sequence[Document],
    program_of_file: Mapping[str, str],
    subprograms: Sequence[str],
    copies: Mapping[str, bytes],
) -> SubprogramCopies:
    """Return the files of a program after subprograms that another program needs different were renamed.

    The calls of the renamed subprograms are changed, too.

    :param documents: files of the program and of its subprograms; `subprograms`: names of the files of subprograms.
    :param program_of_file: files to rename, see `differing_files`.
    :param copies: unchanged files: name → content.
    :raises InputError: a file that differs is not only a subprogram, or cannot have another name.
    """
    job, dialect = task.job, task.job.reader
    reason = ""
    if isinstance(dialect, Calling) and set(program_of_file) <= set(subprograms):
        stems = sorted({PurePath(name).stem for name in program_of_file})
        other_files = OtherFiles(task.used_names, list(_subprograms_of_others(task)))
        renamed_files = dialect.copy_subprograms(documents, [*copies.values()], stems, job.stem, other_files)
        if not isinstance(renamed_files, str):
            return renamed_files
        reason = f". A copy of it for {job.stem} is not possible: {renamed_files}"
    name, owner = next(iter(program_of_file.items()))
    difference = "stays as it is" if name in copies else "is corrected differently"
    raise InputError(
        f"this file was written for {owner}, which needs it too, and {difference} for {job.stem}{reason}",
        file=str(job.output / name),
        advice="Nothing was written. Write this program into another folder with -o, or give each of the programs "
        f"a {name} of its own.",
    )


def _subprograms_of_others(task: Task) -> Iterator[bytes]:
    """Yield the contents of the subprograms that were written for other programs; files that are gone are left out."""
    paths = {
        name: record.folder / name
        for record in task.records
        for name in record.files
        if PurePath(name).suffix == task.job.writer.extension and PurePath(name).stem != record.program
    }
    for path in paths.values():
        with suppress(OSError):
            yield path.read_bytes()


def groups_in_sequence(jobs: Sequence[Job], cell: Cell) -> list[list[Job]]:
    """Return jobs in groups. The jobs of a group may correct a file in common, and are converted in sequence.

    A job that shares no file is a group of its own.

    :param jobs: jobs of one output folder. Programs with calls from different folders are one group for each dialect.
    :param cell: the cell, which states where called programs are looked for.
    """
    jobs_by_dialect: dict[str, list[Job]] = {}
    for job in jobs:
        jobs_by_dialect.setdefault(job.dialect, []).append(job)
    group_of: dict[Path, list[Job]] = {job.program: [job] for job in jobs}
    for name, jobs_of_dialect in jobs_by_dialect.items():
        dialect = registry.dialect_of_name(name)
        if len(jobs_of_dialect) == 1 or not isinstance(dialect, Calling):
            continue
        paths = [job.program for job in jobs_of_dialect]
        is_one_folder = len({path.parent.resolve() for path in paths}) == 1
        # from different folders it is not known which files they share: one file for all joins them to one group
        corrected_files = dialect.moving(paths, cell) if is_one_folder else {path: {paths[0]} for path in paths}
        first_job_of_file: dict[Path, Job] = {}
        for job in jobs_of_dialect:
            for path in corrected_files[job.program]:
                first_job = first_job_of_file.setdefault(path, job)
                group, merged_group = group_of[first_job.program], group_of[job.program]
                if group is not merged_group:
                    group += merged_group
                    group_of |= dict.fromkeys((member.program for member in merged_group), group)
    return list({id(group): group for group in group_of.values()}.values())  # each group once


class _PendingOutput(Struct, frozen=True, eq=False):
    """A converted program whose files are not in their places yet.

    :param obsolete: names of files of an earlier run that are removed.
    :param partners: names of the reports of programs of this run whose earlier results need a file that this program
        replaces. The results of these programs are replaced, or renamed, together with the files of this program.
    """

    task: Task
    outcome: Outcome
    obsolete: tuple[str, ...]
    partners: frozenset[str]


class OutputPlan:
    """The files that a run writes, in all its output folders.

    :param jobs: programs; a program with callers is written with these, and has no outputs of its own.
    :param settings: settings of the run.
    :raises InputError: two programs would be written to one file (case of names is ignored), or a file would be
        overwritten that is an input, that postproc did not write, or that another program calls.
    """

    def __init__(self, jobs: Sequence[Job], settings: Settings) -> None:
        self.jobs = [job for job in jobs if not job.callers]
        self._mode, self._overwrite = settings.mode, settings.overwrite
        self.overviews = [] if self._mode == "predict" else _overviews(self.jobs)
        self._folders = {job.output: _Folder(job.output, self._mode) for job in self.jobs}
        for job in self.jobs:
            self._folders[job.output].add(job)
        self._check(settings.cell)
        self._waiting_groups = deque([job] for job in self.jobs)
        """Groups of jobs that have not begun; the jobs of a group are converted in sequence."""
        self._jobs_in_turn: dict[Path, deque[Job]] = {}
        """Program in work → further jobs of its group."""
        self._pending_outputs: list[_PendingOutput] = []
        """Converted programs whose files wait for those of other programs."""

    def divide(self, cell: Cell) -> None:
        """Group programs that may correct a file in common, so that they wait for each other; keep the order of jobs.

        A prediction writes no programs, so it needs no groups.

        :param cell: the cell, which states where called programs are looked for.
        """
        if self._mode == "predict":
            return
        order = {job.program: number for number, job in enumerate(self.jobs)}
        groups = [group for folder in self._folders.values() for group in groups_in_sequence(folder.jobs, cell)]
        sorted_groups = [sorted(group, key=lambda job: order[job.program]) for group in groups]
        self._waiting_groups = deque(sorted(sorted_groups, key=lambda group: order[group[0].program]))

    def ready(self) -> Iterable[Task]:
        """Yield the tasks that may begin now, and remove them from those that wait.

        The next program of a group waits until the outcome of the program before it is passed to `accept`.
        """
        while self._waiting_groups:
            job, *waiting_jobs = self._waiting_groups.popleft()
            self._jobs_in_turn[job.program] = deque(waiting_jobs)
            yield self._folders[job.output].task(job)

    def accept(self, task: Task, outcome: Outcome) -> list[Outcome]:
        """Accept the outcome of a task; move files to their places as soon as all that belong together are complete.

        A task that fails keeps no files: its earlier results are renamed, see `_retire_results`.

        :returns: final outcomes of this task, and of programs whose files waited for it; empty while its files wait.
        """
        waiting_jobs = self._jobs_in_turn.pop(task.job.program)
        if waiting_jobs:
            self._waiting_groups.appendleft(list(waiting_jobs))
        folder = self._folders[task.job.output]
        folder.record_conversion(task.job)
        final_outcomes: list[Outcome] = []
        if outcome.staged_files is None:
            final_outcomes.append(self._failure(task.job, outcome))
        else:
            try:
                self._pending_outputs.append(self._pending_output(task, outcome))
                folder.record_files(task.job, outcome)
            except InputError as cause:
                files.discard(outcome.staged_files)
                final_outcomes.append(self._failure(task.job, Outcome(outcome.program, FAILED, message=str(cause))))
        for group in self._take_groups():
            final_outcomes += self._replace_files(group)
        return final_outcomes

    def _check(self, cell: Path) -> None:
        """Check the names of the files that the jobs will write.

        :param cell: cell file, an input of all programs.
        :raises InputError: see the class.
        """
        for first, second in same_names(self.jobs):
            raise InputError(
                shared_name_problem(first, second),
                advice="Nothing was written. Rename one, or convert them one by one with different -o folders.",
            )
        inputs = [cell, *(path for job in self.jobs for path in job.input_files())]
        names: dict[Path, list[str]] = {}
        for job in self.jobs:
            names.setdefault(job.output, []).extend(job.output_names(self._mode))
        for folder in self.overviews:
            names[folder].append(OVERVIEW)
        for folder, file_names in names.items():
            protect(inputs, folder, file_names)
        for job in self.jobs:
            self._refuse_called_names(job, job.output_names(self._mode))
        if not self._overwrite:
            foreign_files = [
                path for job in self.jobs for path in self._foreign_files(job, job.output_names(self._mode))
            ]
            refuse(foreign_files + [path for folder in self.overviews for path in find_foreign_file(folder / OVERVIEW)])

    def _refuse_called_names(self, job: Job, names: Iterable[str]) -> None:
        """Check that files to be replaced are not called by a program of an earlier run, which would move differently.

        :param names: names of files that the job writes.
        :raises InputError: a file is called by such a program, which the message names.
        """
        for path in (job.output / name for name in names):
            owner = self._folders[job.output].dependent_record(job, path)
            if owner is not None:
                raise InputError(
                    f"this file was written for {owner.program}, which needs it",
                    file=str(path),
                    advice=f"Nothing was written. Write {job.program} into another folder with -o, or under another "
                    "name with --name.",
                )

    def _pending_output(self, task: Task, outcome: Outcome) -> _PendingOutput:
        """Return a converted program with the earlier files that it removes, and its partners.

        :param outcome: outcome with staged files and summary.
        :raises InputError: a staged file must not replace the file in its place.
        """
        job, mode, folder = task.job, self._mode, self._folders[task.job.output]
        assert outcome.staged_files is not None  # the caller has checked it
        assert outcome.summary is not None
        names = outcome.staged_files.names
        protect([*job.input_files(), *map(Path, outcome.read)], job.output, names)
        planned_names = job.output_names(mode)
        # parts of a divided program, and files of subprograms
        unplanned_names = [name for name in names if name not in planned_names]
        _refuse_names_of_parts(task, unplanned_names)
        self._refuse_called_names(job, [name for name in unplanned_names if name not in outcome.shared_files])
        sums = {entry.name: entry.sha256 for entry in outcome.summary.files or ()}
        # shared files that exist with another content
        changed_names = [
            name for name in outcome.shared_files if _file_digest(job.output / name) not in ("", sums[name])
        ]
        if not self._overwrite:
            unchanged_names = set(outcome.shared_files) - set(changed_names)
            foreign_files = self._foreign_files(job, [name for name in unplanned_names if name not in unchanged_names])
            # a shared file may be from any other program, another file only from a program still to be converted
            refuse(
                [
                    path
                    for path in foreign_files
                    if not folder.is_from_other_program(job, path, only_pending=path.name not in outcome.shared_files)
                ]
            )
        obsolete = [name for name in _obsolete_names(job, mode, names) if not folder.records_of_others(job, name)]
        if not self._overwrite:
            refuse(find_foreign_files(job.output, obsolete, job.report_name(mode)))
        partners = folder.programs_needing(changed_names) - {job.report_name(mode)} if changed_names else frozenset()
        return _PendingOutput(task=task, outcome=outcome, obsolete=tuple(obsolete), partners=partners)

    def _take_groups(self) -> list[list[_PendingOutput]]:
        """Return the groups of programs whose files belong together and are all complete; these are pending no more.

        Groups with a partner that is still to be converted stay.
        """
        programs, complete_groups, incomplete = self._pending_outputs, [], []
        while programs:
            group = [programs[0]]
            for program in group:  # the list grows in the loop until no program has a further partner
                group += [
                    candidate
                    for candidate in programs
                    if candidate not in group and self._share_files(program, candidate)
                ]
            programs = [program for program in programs if program not in group]
            if any(self._folders[program.task.job.output].has_pending(program.partners) for program in group):
                incomplete += group
            else:
                complete_groups.append(group)
        self._pending_outputs = incomplete
        return complete_groups

    def _share_files(self, program_a: _PendingOutput, program_b: _PendingOutput) -> bool:
        """Return whether the files of two programs must be replaced together: one changes a file that both need.

        Such programs are partners; a program lists its partners by the names of their reports.
        """
        if program_a.task.job.output != program_b.task.job.output:
            return False
        report_a, report_b = (program.task.job.report_name(self._mode) for program in (program_a, program_b))
        return report_b in program_a.partners or report_a in program_b.partners

    def _replace_files(self, group: Sequence[_PendingOutput]) -> list[Outcome]:
        """Move the staged files of programs to their places together; return the outcomes.

        If a file cannot be moved, all programs of the group fail, and their earlier files stay.

        :param group: programs of one output folder.
        """
        folder = group[0].task.job.output
        staged_files = [member.outcome.staged_files for member in group if member.outcome.staged_files is not None]
        names = {name for member in staged_files for name in member.names}
        obsolete = [name for member in group for name in member.obsolete if name not in names]
        try:
            files.replace(folder, staged_files, obsolete)
        except PostprocError as cause:
            failures = [
                Outcome(member.outcome.program, FAILED, message=str(cause), keeps_old_files=True) for member in group
            ]
            return [self._failure(member.task.job, outcome) for member, outcome in zip(group, failures, strict=True)]
        for member in group:
            self._folders[folder].record_placement(member.task.job)
        return [
            replace(
                member.outcome,
                staged_files=None,
                written_files=tuple(str(folder / name) for name in member.outcome.staged_files.names),
            )
            for member in group
            if member.outcome.staged_files is not None
        ]

    def _foreign_files(self, job: Job, names: Iterable[str]) -> list[Path]:
        """Return the files of these names that exist, and that postproc did not write or that were changed afterwards.

        Unchanged copies for other programs and intact programs of an earlier run are not among them.
        """
        folder = self._folders[job.output]
        foreign_files = [
            path
            for path in find_foreign_files(job.output, names, job.report_name(self._mode))
            if not folder.is_needed_copy(job, path)
        ]
        return (
            [path for path in foreign_files if path.name not in _intact_program_files(job, self._mode)]
            if foreign_files
            else []
        )

    def _failure(self, job: Job, outcome: Outcome) -> Outcome:
        """Return the outcome of a program that was not written, with a sentence on its earlier results.

        Earlier results are renamed unless the outcome keeps them. A skipped subprogram is returned as it is.
        """
        if outcome.is_skipped:
            return outcome
        return replace(
            outcome,
            earlier_remark=leftover_note([job], self._mode) if outcome.keeps_old_files else self._retire_results(job),
        )

    def _retire_results(self, job: Job) -> str:
        """Rename the earlier results of a program that failed in this run to NAME.old, because they look like new ones.

        Files that another program needs too are not renamed. Nothing is renamed if a result was changed by somebody
        else, if a result is an input of the job, or if a file is locked.

        :returns: a sentence for the user that says which files were renamed, or that earlier results are still there;
            empty if there are no results of this program alone.
        """
        mode, folder = self._mode, self._folders[job.output]
        names = _existing_names(job, _run_files(job, mode))
        own_names = [name for name in names if not folder.records_of_others(job, name)]
        shared_names = [name for name in names if name not in own_names]
        # files that postproc did not write, or that were edited since
        changed_files = self._foreign_files(job, own_names)
        changed_files += [
            path for path in self._foreign_files(job, shared_names) if not folder.is_from_other_program(job, path)
        ]
        if not own_names:
            return ""
        input_keys = {_path_key(path) for path in job.input_files()}
        if changed_files or any(_path_key(job.output / name) in input_keys for name in own_names):
            return leftover_note([job], mode)
        try:
            for path in (job.output / name for name in own_names):
                path.rename(backup_path(path))
        except OSError:
            return leftover_note([job], mode)
        suffix = ", and its reports likewise" if len(own_names) > 1 else ""
        return f"{job.output / own_names[0]} is of an earlier run: renamed to {own_names[0]}.old{suffix}."


class _Folder:
    """An output folder: its records before the run, and the records that the run has added."""

    def __init__(self, path: Path, mode: Mode) -> None:
        self.jobs: list[Job] = []
        self._path, self._mode = path, mode
        self._pending: set[str] = set()
        """Names of the reports of programs that are still to be converted."""
        self._new_records: dict[str, Record] = {}
        """Name of the report of each program that the run has converted → its files."""

    def add(self, job: Job) -> None:
        """Add a job of the run."""
        self.jobs.append(job)
        self._pending.add(job.report_name(self._mode))

    @cached_property
    def _names(self) -> frozenset[str]:
        """Names of the programs that the run writes into the folder, lower case."""
        return frozenset(job.stem.lower() for job in self.jobs)

    @cached_property
    def _earlier_records(self) -> dict[str, Record]:
        """Name of each report in the folder → its record before the run, with the files that still exist."""
        records: dict[str, Record] = {}
        file_names = {path.name for path in self._path.glob("*")}
        for path in sorted(self._path.glob("*.report.json")):
            digests = {name: file_digest for name, file_digest in recorded_files(path).items() if name in file_names}
            program = path.name.removesuffix(".report.json")
            records[path.name] = Record(
                program=program, folder=self._path, files=digests, copied=frozenset(recorded_names(path, COPIED_KEY))
            )
        return records

    def _records(self) -> dict[str, Record]:
        """Return earlier and new records by the names of their reports; a new record replaces an earlier one."""
        return self._earlier_records | self._new_records

    def task(self, job: Job) -> Task:
        """Return the task of a job, with the records of other programs if it may share files with them.

        Reports, tables and pictures are left out of these records, because no programs share them.
        """
        names = self._names - {job.stem.lower()}
        if self._mode == "predict" or not _may_share(job):
            return Task(job, names)
        records = [
            replace(
                record,
                files={name: file_digest for name, file_digest in record.files.items() if not name.endswith(_REPORTS)},
                is_renewed=report in self._pending,
            )
            for report, record in self._records().items()
            if report != job.report_name(self._mode)
        ]
        # a copy of a subprogram may replace files that an earlier run wrote for the job, and no others
        stems_in_use = {PurePath(name).stem.lower() for record in records for name in record.files} | names
        stems_in_use |= {path.stem.lower() for path in self._path.glob("*") if path.name not in self._job_files(job)}
        return Task(job, names, tuple(record for record in records if record.files), frozenset(stems_in_use))

    def _job_files(self, job: Job) -> Mapping[str, str]:
        """Return the files that an earlier run wrote for a job: name → SHA-256."""
        record = self._earlier_records.get(job.report_name(self._mode))
        return {} if record is None else record.files

    def record_conversion(self, job: Job) -> None:
        """Record that a job is not pending any more: it was converted, or it failed."""
        self._pending.discard(job.report_name(self._mode))

    def record_files(self, job: Job, outcome: Outcome) -> None:
        """Record the staged files of a converted program."""
        assert outcome.staged_files is not None  # the caller has checked it
        assert outcome.summary is not None
        sums = {entry.name: entry.sha256 for entry in outcome.summary.files or ()}
        copies = frozenset(outcome.summary.copied or ())
        self._new_records[job.report_name(self._mode)] = Record(
            program=job.stem, folder=outcome.staged_files.path / "new", files=sums, copied=copies
        )

    def record_placement(self, job: Job) -> None:
        """Record that the files of a converted program are in the output folder now."""
        report = job.report_name(self._mode)
        self._new_records[report] = replace(self._new_records[report], folder=self._path)

    def has_pending(self, reports: Iterable[str]) -> bool:
        """Return whether one of some programs is still to be converted.

        :param reports: names of the reports of these programs.
        """
        return not self._pending.isdisjoint(reports)

    def programs_needing(self, names: Sequence[str]) -> frozenset[str]:
        """Return the programs still to be converted whose earlier results contain one of some files.

        :param names: names of the files.
        :returns: names of the reports of these programs.
        """
        return frozenset(
            report
            for report in self._pending
            if report in self._earlier_records and not self._earlier_records[report].files.keys().isdisjoint(names)
        )

    def records_of_others(self, job: Job, name: str, *, only_pending: bool = False) -> list[Record]:
        """Return the records of other programs than that of a job that list a file: it was written for these too.

        :param name: name of the file.
        :param only_pending: only records of programs that are still to be converted.
        """
        own_report = job.report_name(self._mode)
        return [
            record
            for report, record in self._records().items()
            if report != own_report and name in record.files and (not only_pending or report in self._pending)
        ]

    def is_from_other_program(self, job: Job, path: Path, *, only_pending: bool = False) -> bool:
        """Return whether a file is as it was written for another program than that of a job.

        :param only_pending: see `records_of_others`.
        """
        owners = self.records_of_others(job, path.name, only_pending=only_pending)
        return bool(owners) and _file_digest(path) in {record.files[path.name] for record in owners}

    def dependent_record(self, job: Job, path: Path) -> Record | None:
        """Return the record of a program, not to be converted again, that needs a file of the output folder as it is.

        None: no program needs it. None also if an earlier run wrote the file for this job too, or if it is a copy of a
        source of this job, whose routines without motions stay equal.
        """
        pending_records = self.records_of_others(job, path.name, only_pending=True)
        records = [record for record in self.records_of_others(job, path.name) if record not in pending_records]
        file_digest = _file_digest(path) if records else ""
        if not file_digest or self._job_files(job).get(path.name) == file_digest:
            return None
        if job.keeps_text and any(
            source.name == path.name and _file_digest(source) == file_digest for source in job.input_files()
        ):
            return None
        return next((record for record in records if record.files[path.name] == file_digest), None)

    def is_needed_copy(self, job: Job, path: Path) -> bool:
        """Return whether a file is a copy for another program, written as it was read and not changed afterwards."""
        return any(
            path.name in record.copied and record.files[path.name] == _file_digest(path)
            for record in self.records_of_others(job, path.name)
        )


def _refuse_names_of_parts(task: Task, names: Iterable[str]) -> None:
    """Check that files cannot be parts of another program of the run.

    A large program is divided into NAMEMain and NAME1, NAME2 …; how many files it gets is known only afterwards.

    :param names: names of files that the program of the task writes in addition to the planned ones.
    :raises InputError: a file may be such a part.
    """
    for name in names:
        divided_program = next((program for program in task.names if _is_part_name(name, program)), None)
        if divided_program is not None:
            raise InputError(
                f"{task.job.program} also writes {name}, which may be a file of {divided_program}, which is also "
                "written in this run",
                advice="Rename one, or convert them one by one with different -o folders.",
            )


def _obsolete_names(job: Job, mode: Mode, new_names: Iterable[str]) -> list[str]:
    """Return the names of files of an earlier run of a job that this run does not write and does not read.

    :param new_names: names of the files that this run writes.
    """
    lower_names = {name.lower() for name in new_names}
    inputs = {_path_key(path) for path in job.input_files()}
    earlier_names = _existing_names(job, recorded_files(job.output / job.report_name(mode)))
    return [
        name
        for name in earlier_names
        if name.lower() not in lower_names
        and PurePath(name).name == name  # not outside of the output folder
        and _path_key(job.output / name) not in inputs
    ]


def protect(inputs: Iterable[Path], folder: Path, names: Iterable[str]) -> None:
    """Check that no output would overwrite an input; case of names is ignored.

    :param inputs: files that are read.
    :param folder: folder that is written into.
    :param names: names of the files to be written.
    :raises InputError: an output is an input.
    """
    read = {_path_key(path) for path in inputs}
    for path in (folder / name for name in names):
        if _path_key(path) in read:
            advice = "Nothing was written. Choose another place with -o."
            raise InputError("this input would be overwritten", file=str(path), advice=advice)


def leftover_note(jobs: Iterable[Job], mode: Mode) -> str:
    """Return a sentence on programs of earlier runs in the output folders; empty if there are none."""
    programs = [job.output / name for job in jobs for name in _earlier_programs(job, mode)]
    return f"There before, not of this run: {path_list(programs)}." if programs else ""


def removed_programs_note(jobs: Iterable[Job], mode: Mode) -> str:
    """Return a sentence on written programs whose source is no longer in the folders from which the run converts.

    Empty if there are none, in a prediction, and if the user named all programs of the run.
    """
    if mode == "predict":
        return ""
    return removal_note(removed_programs(jobs))


def removed_programs(jobs: Iterable[Job]) -> dict[Path, list[Path]]:
    """Return the results in the output folders of jobs whose source is no longer in the folders of these jobs.

    Programs of the jobs, and folders of which the user named all programs, do not count; for the values see
    `removed_results`.
    """
    jobs = list(jobs)
    folder_jobs = [job for job in jobs if not job.is_named_by_user]
    reports = {job.output / job.report_name("convert") for job in jobs}
    sources = {job.program.parent for job in folder_jobs}
    outputs = sorted({job.output for job in folder_jobs})
    return {
        report: programs for output in outputs for report, programs in removed_results(output, sources, reports).items()
    }


def removed_results(
    output: Path, sources: Iterable[Path], current_reports: Collection[Path] = ()
) -> dict[Path, list[Path]]:
    """Return the results in a folder whose source is no longer there: report → its written programs that exist.

    :param output: folder of the results; `sources`: folders in which the sources may be.
    :param current_reports: reports of programs that are there: these are not read.
    """
    removed: dict[Path, list[Path]] = {}
    for report in sorted(output.glob("*.report.json")):
        if report in current_reports:
            continue
        program = recorded_text(report, "program")
        if any((folder / program).exists() for folder in sources):
            continue
        stem, extensions = report.name.removesuffix(".report.json").lower(), registry.written_extensions()
        removed[report] = [
            output / name
            for name in recorded_files(report)
            if PurePath(name).suffix in extensions and _is_part_name(name, stem) and (output / name).exists()
        ]
    return removed


def removal_note(removed: Mapping[Path, Sequence[Path]]) -> str:
    """Return a sentence on results whose source is no longer there, see `removed_results`; empty if there are none."""
    programs = [program for written_programs in removed.values() for program in written_programs]
    if not programs:
        return ""
    return f"Written by an earlier run from programs that are no longer there: {path_list(programs)}. Do not load them."


def _earlier_programs(job: Job, mode: Mode) -> list[str]:
    """Return the names of existing programs of an earlier run of a job: the main file; without one, the modules."""
    digests = recorded_files(job.output / job.report_name(mode))
    modules = [name for name in digests if name.endswith(job.writer.extension)]
    return _existing_names(job, job.main_file_names(mode)) or _existing_names(job, modules)


def _overviews(jobs: Sequence[Job]) -> list[Path]:
    """Return the folders that get an overview: folders with several programs, or with an overview already."""
    count: dict[Path, int] = {}
    for job in jobs:
        count[job.output] = count.get(job.output, 0) + 1
    return [folder for folder, number in count.items() if number > 1 or _has_overview(folder)]


def _has_overview(folder: Path) -> bool:
    """Return whether a folder has an overview that postproc wrote."""
    return (folder / OVERVIEW).is_file() and not find_foreign_file(folder / OVERVIEW)


def _may_share(job: Job) -> bool:
    """Return whether a program may call or need files of other programs: its folder has further files.

    Only programs with calls whose text is kept can do so.
    """
    if not (job.keeps_text and isinstance(job.reader, Calling)):
        return False
    own_files = {_path_key(path) for path in job.input_files()}
    return any(_path_key(path) not in own_files for path in job.program.parent.glob("*") if path.is_file())


def _is_part_name(name: str, program_stem: str) -> bool:
    """Return whether a file may be a part of a divided program: its stem, or the stem with ``Main`` or a number.

    :param program_stem: name of the program without extension, lower case.
    """
    stem = PurePath(name).stem.lower()
    suffix = stem.removeprefix(program_stem)
    return stem.startswith(program_stem) and (suffix in ("", "main") or suffix.isdecimal())


def _existing_names(job: Job, names: Iterable[str]) -> list[str]:
    """Return the names that exist in the output folder of a job."""
    return [name for name in names if (job.output / name).exists()]


def _run_files(job: Job, mode: Mode) -> list[str]:
    """Return the names of files that this run may write for a job, and that an earlier run has written for it."""
    planned_names = job.output_names(mode)
    return list(
        dict.fromkeys([*job.main_file_names(mode), *planned_names, *recorded_files(job.output / job.report_name(mode))])
    )


def _intact_program_files(job: Job, mode: Mode) -> list[str]:
    """Return the names of the program files of an earlier run that are unchanged, by their line of origin.

    The list is empty in a prediction, and if there is no program, or it cannot be read or was changed.
    """
    program = next((job.output / name for name in _existing_names(job, job.main_file_names(mode))), None)
    if mode == "predict" or program is None or not program.is_file():
        return []
    try:
        documents = read_documents(program, job.written_dialect)
    except ProgramError:
        return []
    return [document.name for document in documents] if job.writer.origin(documents).state == "intact" else []


def shared_name_problem(first: Job, second: Job) -> str:
    """Return the message that two programs would be written under one name, without a full stop."""
    return f"{first.program} and {second.program} would both be written as {second.output / second.stem}.*"


def same_names(jobs: Iterable[Job]) -> Iterator[tuple[Job, Job]]:
    """Yield pairs of jobs that would write files of one name: the first job with this name, and each later one.

    Names are compared without case: controllers and Windows do not tell it apart.
    """
    first_jobs: dict[tuple[str, str], Job] = {}
    for job in jobs:
        first = first_jobs.setdefault((_path_key(job.output), job.stem.lower()), job)
        if first is not job:
            yield first, job


def _path_key(path: Path) -> str:
    """Return a text that is equal for all paths of one file; case of names is ignored."""
    return str(files.resolve(path)).lower()


def _file_digest(path: Path) -> str:
    """Return the SHA-256 of a file; empty if it cannot be read."""
    try:
        return digest([path.read_bytes()])
    except OSError:
        return ""


def backup_path(path: Path) -> Path:
    """Return a path that does not exist yet: the path with ``.old`` appended, or ``.old2``, ``.old3`` …"""
    number = 2
    target = path.with_name(f"{path.name}.old")
    while target.exists():
        target = path.with_name(f"{path.name}.old{number}")
        number += 1
    return target
