"""The plan of a run: which files it will write, which of earlier runs go, and which programs wait for others.

`OutputPlan` is made before work begins, from the list of programs and from what is in the output folders. It alone
looks at the files of other programs, and puts files in their places: programs are converted into folders of their own
(`files.stage`), in any process and on any machine, and the plan decides what these replace, and when.
Its process has locked the output folders from the plan to the last replacement (`files.locked`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path, PurePath

from msgspec import Struct
from msgspec.structs import replace

from postproc import files
from postproc.cell import Cell
from postproc.correction import Mode
from postproc.dialects import registry
from postproc.dialects.dialect import Calling
from postproc.errors import InputError, PostprocError, ProgramError
from postproc.files import foreign, foreign_single, listed, noted, recorded, refuse
from postproc.jobs.programs import Job, read_documents
from postproc.jobs.settings import FAILED, Outcome, Settings
from postproc.jobs.shared_files import Record, Task, lines
from postproc.provenance import digest

OVERVIEW = "index.html"
"""File that lists the programs of an output folder."""
_REPORTS = (".report.html", ".targets.csv", ".forces.csv", ".ply", ".glb")
"""Endings of files that no two programs have in common."""
COPIED = "copied"
"""Key of a report: files that were written as they were read, and in which nothing is called that moves."""


class _Complete(Struct, frozen=True, eq=False):
    """A converted program whose files are not in their places yet.

    :param obsolete: names of files of an earlier run that go.
    :param partners: reports of programs of this run whose earlier results need a file that is replaced: they are
        replaced, or set aside, together with this one.
    """

    task: Task
    outcome: Outcome
    obsolete: tuple[str, ...]
    partners: frozenset[str]


class OutputPlan:
    """What a run writes.

    :param jobs: programs; those that are only called by others are left to these.
    :param settings: of the run.
    :raises InputError: two programs would be written to one file (names that differ in case are one), an input would
        be overwritten, or a file that postproc did not write.
    """

    def __init__(self, jobs: Sequence[Job], settings: Settings) -> None:
        self.jobs = [job for job in jobs if not job.callers]
        self._mode, self._overwrite = settings.mode, settings.overwrite
        self.overviews = [] if self._mode == "predict" else _overviews(self.jobs)
        self._folders = {job.output: _Folder(job.output, self._mode) for job in self.jobs}
        for job in self.jobs:
            self._folders[job.output].add(job)
        self._check(settings.cell)
        self._lines = deque([job] for job in self.jobs)
        self._later: dict[Path, deque[Job]] = {}
        self._complete: list[_Complete] = []

    def divide(self, cell: Cell) -> None:
        """Find which programs may correct one file in common: they will be converted one after the other."""
        if self._mode != "predict":
            groups = [lines(folder.jobs, cell) for folder in self._folders.values()]
            order = {job.program: number for number, job in enumerate(self.jobs)}
            found = [sorted(group, key=lambda job: order[job.program]) for each in groups for group in each]
            self._lines = deque(sorted(found, key=lambda group: order[group[0].program]))

    def ready(self) -> Iterable[Task]:
        """Yield tasks that may begin now; the others follow when those before them are `finished`."""
        while self._lines:
            job, *later = self._lines.popleft()
            self._later[job.program] = deque(later)
            yield self._folders[job.output].task(job)

    def finished(self, task: Task, outcome: Outcome) -> list[Outcome]:
        """Take in what came of a task; put files in their places as soon as those that belong together are complete.

        :returns: final outcomes, of this task and of tasks that waited for it.
        """
        later = self._later.pop(task.job.program)
        if later:
            self._lines.appendleft(list(later))
        folder = self._folders[task.job.output]
        folder.converted(task.job)
        final: list[Outcome] = []
        if outcome.staged is None:
            final.append(self._failed(task.job, outcome))
        else:
            try:
                self._complete.append(self._checked(task, outcome))
                folder.written(task.job, outcome)
            except InputError as cause:
                files.discard(outcome.staged)
                final.append(self._failed(task.job, Outcome(outcome.program, FAILED, message=str(cause))))
        for group in self._groups():
            final += self._replaced(group)
        return final

    def _check(self, cell: Path) -> None:
        """Raise for clashes that are known from the names."""
        taken: dict[tuple[str, str], Path] = {}
        for job in self.jobs:
            first = taken.setdefault((_key(job.output), job.stem.lower()), job.program)
            if first is not job.program:
                raise InputError(
                    f"{first} and {job.program} would both be written as {job.output / job.stem}.*",
                    advice="Nothing was written. Rename one, or convert them one by one with different -o folders.",
                )
        inputs = [cell, *(path for job in self.jobs for path in job.reads())]
        names: dict[Path, list[str]] = {}
        for job in self.jobs:
            names.setdefault(job.output, []).extend(job.writes(self._mode))
        for folder in self.overviews:
            names[folder].append(OVERVIEW)
        for folder, written in names.items():
            protect(inputs, folder, written)
        if not self._overwrite:
            found = [path for job in self.jobs for path in self._not_ours(job, job.writes(self._mode))]
            refuse(found + [path for folder in self.overviews for path in foreign_single(folder / OVERVIEW)])

    def _checked(self, task: Task, outcome: Outcome) -> _Complete:
        """Return a converted program with what its files replace.

        :raises InputError: they must not replace it.
        """
        job, mode, folder = task.job, self._mode, self._folders[task.job.output]
        assert outcome.staged is not None
        assert outcome.summary is not None
        names = outcome.staged.names
        protect([*job.reads(), *map(Path, outcome.read)], job.output, names)
        foreseen = job.writes(mode)
        more = [name for name in names if name not in foreseen]
        for name in more:
            other = next((other for other in task.names if _of_divided(name, other)), None)
            if other is not None:
                raise InputError(
                    f"{job.program} also writes {name}, which may be a file of {other}, which is also written in this "
                    "run",
                    advice="Rename one, or convert them one by one with different -o folders.",
                )
        sums = {entry["name"]: entry["sha256"] for entry in outcome.summary["files"]}
        changed = [name for name in outcome.shared if _sum(job.output / name) not in ("", sums[name])]
        if not self._overwrite:
            found = self._not_ours(job, [name for name in more if name not in outcome.shared or name in changed])
            refuse([p for p in found if not folder.others_wrote(job, p, only_pending=p.name not in outcome.shared)])
        kept = {name.lower() for name in names}
        inputs = {_key(path) for path in job.reads()}
        obsolete = [
            name
            for name in _there(job, recorded(job.output / job.report(mode)))
            if name.lower() not in kept and PurePath(name).name == name and _key(job.output / name) not in inputs
        ]
        obsolete = [name for name in obsolete if not folder.owners(job, name)]
        if not self._overwrite:
            refuse(foreign(job.output, obsolete, job.report(mode)))
        partners = folder.needing(changed) - {job.report(mode)} if changed else frozenset()
        return _Complete(task, outcome, tuple(obsolete), partners)

    def _groups(self) -> list[list[_Complete]]:
        """Return, and take away, programs whose files belong together and are all complete."""
        waiting, ready, later = self._complete, [], []
        while waiting:
            group = [waiting[0]]
            for each in group:  # grows
                group += [other for other in waiting if other not in group and self._belong_together(each, other)]
            waiting = [each for each in waiting if each not in group]
            if any(self._folders[each.task.job.output].waits(each.partners) for each in group):
                later += group
            else:
                ready.append(group)
        self._complete = later
        return ready

    def _belong_together(self, one: _Complete, other: _Complete) -> bool:
        reports = [each.task.job.report(self._mode) for each in (one, other)]
        same_folder = one.task.job.output == other.task.job.output
        return same_folder and (reports[1] in one.partners or reports[0] in other.partners)

    def _replaced(self, group: Sequence[_Complete]) -> list[Outcome]:
        """Move the staged files of programs to their places together; return the outcomes."""
        folder = group[0].task.job.output
        staged = [each.outcome.staged for each in group if each.outcome.staged is not None]
        written = {name for each in staged for name in each.names}
        obsolete = [name for each in group for name in each.obsolete if name not in written]
        try:
            files.replace(folder, staged, obsolete)
        except PostprocError as cause:
            failed = [Outcome(each.outcome.program, FAILED, message=str(cause), keeps_earlier=True) for each in group]
            return [self._failed(each.task.job, outcome) for each, outcome in zip(group, failed, strict=True)]
        for each in group:
            self._folders[folder].in_place(each.task.job)
        return [
            replace(
                each.outcome,
                staged=None,
                written=tuple(str(folder / name) for name in each.outcome.staged.names),
            )
            for each in group
            if each.outcome.staged is not None
        ]

    def _not_ours(self, job: Job, names: Iterable[str]) -> list[Path]:
        """Return which of the files that are there are not as postproc wrote them."""
        folder = self._folders[job.output]
        found = [path for path in foreign(job.output, names, job.report(self._mode)) if not folder.copied(job, path)]
        return [path for path in found if path.name not in _marked(job, self._mode)] if found else []

    def _failed(self, job: Job, outcome: Outcome) -> Outcome:
        """Return the outcome of a program of which nothing was written, with what becomes of its earlier results."""
        if outcome.skipped:
            return outcome
        return replace(outcome, earlier=left([job], self._mode) if outcome.keeps_earlier else self._set_aside(job))

    def _set_aside(self, job: Job) -> str:
        """Rename what an earlier run wrote for a program that failed now, so that nobody takes it for this run's.

        :returns: a sentence for the user; empty if there was nothing.
        """
        mode, folder = self._mode, self._folders[job.output]
        there = _there(job, _of_run(job, mode))
        owners = {name: folder.owners(job, name) for name in there}
        own = [name for name in there if not owners[name]]
        changed = self._not_ours(job, own)
        changed += [
            path
            for name, others in owners.items()
            if others
            for path in self._not_ours(job, [name])
            if not folder.others_wrote(job, path)
        ]
        if not own:
            return ""
        inputs = {_key(path) for path in job.reads()}
        if changed or any(_key(job.output / name) in inputs for name in own):
            return left([job], mode)
        try:
            for path in (job.output / name for name in own):
                path.rename(_unused(path))
        except OSError:
            return left([job], mode)
        others = ", and its reports likewise" if len(own) > 1 else ""
        return f"{job.output / own[0]} is of an earlier run: renamed to {own[0]}.old{others}."


class _Folder:
    """An output folder: the records in it before the run, and what the run has added."""

    def __init__(self, path: Path, mode: Mode) -> None:
        self.jobs: list[Job] = []
        self._path, self._mode = path, mode
        self._pending: set[str] = set()
        self._new: dict[str, Record] = {}

    def add(self, job: Job) -> None:
        """Take in a job of the run."""
        self.jobs.append(job)
        self._pending.add(job.report(self._mode))

    @cached_property
    def _names(self) -> frozenset[str]:
        return frozenset(job.stem.lower() for job in self.jobs)

    @cached_property
    def _earlier(self) -> dict[str, Record]:
        """The records in the folder by the names of their reports; of their files those that are still there."""
        found: dict[str, Record] = {}
        there = {path.name for path in self._path.glob("*")}
        for path in sorted(self._path.glob("*.report.json")):
            named = {name: sum_ for name, sum_ in recorded(path).items() if name in there}
            program = path.name.removesuffix(".report.json")
            found[path.name] = Record(program, self._path, named, frozenset(noted(path, COPIED)))
        return found

    def _records(self) -> dict[str, Record]:
        """The records as they will be when what is complete is in its place."""
        return self._earlier | self._new

    def task(self, job: Job) -> Task:
        """Return a task of the run, with the other records if the program may have files in common with them."""
        names = self._names - {job.stem.lower()}
        if self._mode == "predict" or not _may_share(job):
            return Task(job, names)
        records = [
            Record(
                record.program,
                record.at,
                {name: sum_ for name, sum_ in record.files.items() if not name.endswith(_REPORTS)},
                record.copied,
                report in self._pending,
            )
            for report, record in self._records().items()
            if report != job.report(self._mode)
        ]
        own = self._earlier.get(job.report(self._mode))
        earlier = frozenset[str]() if own is None else frozenset(own.files)
        return Task(job, names, tuple(record for record in records if record.files), earlier)

    def converted(self, job: Job) -> None:
        """Note that a job has been done."""
        self._pending.discard(job.report(self._mode))

    def written(self, job: Job, outcome: Outcome) -> None:
        """Note the files of a converted program."""
        assert outcome.staged is not None
        assert outcome.summary is not None
        sums = {entry["name"]: entry["sha256"] for entry in outcome.summary["files"]}
        copied = frozenset(outcome.summary.get("copied", ()))
        self._new[job.report(self._mode)] = Record(job.stem, outcome.staged.path / "new", sums, copied)

    def in_place(self, job: Job) -> None:
        """Note that the files of a converted program are in their places."""
        report = job.report(self._mode)
        self._new[report] = replace(self._new[report], at=self._path)

    def waits(self, reports: Iterable[str]) -> bool:
        """Return whether one of some programs is yet to be converted."""
        return not self._pending.isdisjoint(reports)

    def needing(self, names: Sequence[str]) -> frozenset[str]:
        """Return the reports of programs of the run, yet to be converted, whose earlier results need a file."""
        return frozenset(
            report
            for report in self._pending
            if report in self._earlier and not self._earlier[report].files.keys().isdisjoint(names)
        )

    def owners(self, job: Job, name: str, *, only_pending: bool = False) -> list[Record]:
        """Return the records of other programs that list a file; of those only that are yet to be converted."""
        own = job.report(self._mode)
        return [
            record
            for report, record in self._records().items()
            if report != own and name in record.files and (not only_pending or report in self._pending)
        ]

    def others_wrote(self, job: Job, path: Path, *, only_pending: bool = False) -> bool:
        """Return whether a file is as it was written for another program."""
        owners = self.owners(job, path.name, only_pending=only_pending)
        return bool(owners) and _sum(path) in {record.files[path.name] for record in owners}

    def copied(self, job: Job, path: Path) -> bool:
        """Return whether a file is as another program needs it, and as it was read for that program."""
        return any(
            path.name in record.copied and record.files[path.name] == _sum(path)
            for record in self.owners(job, path.name)
        )


def protect(inputs: Iterable[Path], folder: Path, names: Iterable[str]) -> None:
    """Raise an `InputError` if an output would overwrite an input; case of names is ignored.

    :param inputs: files that are read.
    :param folder: folder that is written into.
    :param names: names of the files to be written.
    :raises InputError: one of them is an input.
    """
    read = {_key(path) for path in inputs}
    for path in (folder / name for name in names):
        if _key(path) in read:
            advice = "Nothing was written. Choose another place with -o."
            raise InputError("this input would be overwritten", file=str(path), advice=advice)


def left(jobs: Iterable[Job], mode: Mode) -> str:
    """Return a sentence on programs in the output folders that are not of this run; empty if there are none."""
    there = [job.output / name for job in jobs for name in _there(job, job.mains(mode))]
    return f"There before, not of this run: {listed(there)}." if there else ""


def _overviews(jobs: Sequence[Job]) -> list[Path]:
    """Return the folders that get an overview: those of several programs, and those that have one already."""
    count: dict[Path, int] = {}
    for job in jobs:
        count[job.output] = count.get(job.output, 0) + 1
    return [folder for folder, many in count.items() if many > 1 or _has_overview(folder)]


def _has_overview(folder: Path) -> bool:
    return (folder / OVERVIEW).is_file() and not foreign_single(folder / OVERVIEW)


def _may_share(job: Job) -> bool:
    """Return whether a program may call files, or need files, that it does not consist of."""
    if not (job.keeps_text and isinstance(registry.by_name(job.dialect), Calling)):
        return False
    own = {_key(path) for path in job.reads()}
    return any(_key(path) not in own for path in job.program.parent.glob("*") if path.is_file())


def _of_divided(name: str, other: str) -> bool:
    """Return whether a file may be one of those of a divided program."""
    stem = PurePath(name).stem.lower()
    return stem.startswith(other) and (stem[len(other) :] in ("", "main") or stem[len(other) :].isdecimal())


def _there(job: Job, names: Iterable[str]) -> list[str]:
    return [name for name in names if (job.output / name).exists()]


def _of_run(job: Job, mode: Mode) -> list[str]:
    """Return the names of the files that a run may write, and those that an earlier one has written."""
    foreseen = job.writes(mode)
    return list(dict.fromkeys([*job.mains(mode), *foreseen, *recorded(job.output / job.report(mode))]))


def _marked(job: Job, mode: Mode) -> list[str]:
    """Return the files of a program that states itself that it is as it was written, although its report is gone."""
    program = next((job.output / name for name in _there(job, job.mains(mode))), None)
    if mode == "predict" or program is None or not program.is_file():
        return []
    try:
        documents = read_documents(program, registry.written_in(job.dialect, job.to)[0])
    except ProgramError:
        return []
    return [document.name for document in documents] if job.writer.origin(documents).state == "intact" else []


def _key(path: Path) -> str:
    return str(path.resolve()).lower()


def _sum(path: Path) -> str:
    """Return the SHA-256 of a file; empty if it cannot be read."""
    try:
        return digest([path.read_bytes()])
    except OSError:
        return ""


def _unused(path: Path) -> Path:
    """Return a name for an old file: with ``.old`` appended, or ``.old2`` …"""
    number = 2
    target = path.with_name(f"{path.name}.old")
    while target.exists():
        target = path.with_name(f"{path.name}.old{number}")
        number += 1
    return target
