"""What stands in an output folder: whose files are there (`files.records`), and which are of an earlier run."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

from postproc.correction import Mode
from postproc.dialects import registry
from postproc.errors import InputError, ProgramError
from postproc.files import foreign, foreign_single, listed, noted, recorded, refuse
from postproc.jobs import overview
from postproc.jobs.inputs import read_documents
from postproc.jobs.job import Job
from postproc.jobs.shared_files import COPIED, copied_by_others, of_others, to_come, unused

_BESIDE = (".surface.ply", ".surface.glb", ".stock.glb", ".forces.csv")
"""Files that only some runs write."""


def check(jobs: Sequence[Job], cell: Path, mode: Mode, *, overwrite: bool) -> None:
    """Look at all output folders before anything is written.

    :param cell: cell file, protected like every input.
    :param overwrite: whether files that postproc did not write may be replaced.
    :raises InputError: two programs would be written to one file (names that differ in case are one), an input would
        be overwritten, or a file that postproc did not write.
    """
    taken: dict[tuple[str, str], Path] = {}
    for job in jobs:
        first = taken.setdefault((_key(job.output), job.stem.lower()), job.program)
        if first is not job.program:
            raise InputError(
                f"{first} and {job.program} would both be written as {job.output / job.stem}.*",
                advice="Nothing was written. Rename one, or convert them one by one with different -o folders.",
            )
    inputs = [cell, *(path for job in jobs for path in job.reads())]
    names: dict[Path, list[str]] = {}
    for job in jobs:
        names.setdefault(job.output, []).extend(job.writes(mode))
    overviews = overview.folders(jobs, mode)
    for folder in overviews:
        names[folder].append(overview.NAME)
    for folder, written in names.items():
        protect(inputs, folder, written)
    if not overwrite:
        found = [path for job in jobs for path in _foreign(job, job.writes(mode), mode)]
        refuse(found + [path for folder in overviews for path in foreign_single(folder / overview.NAME)])


def check_more(job: Job, names: Sequence[str], mode: Mode, *, overwrite: bool, same: Collection[str] = ()) -> None:
    """Look again when the names of the files to be written are known; see `check`.

    :param same: those that stand there as they would be written.
    """
    protect(job.reads(), job.output, names)
    foreseen = job.writes(mode)
    more = [name for name in names if name not in foreseen]
    for name in more:
        other = next((other for other in job.others if _of_one_family(name, other)), None)
        if other is not None:
            raise InputError(
                f"{job.program} writes {name} too, which may be of {other}, which is also written in this run",
                advice="Rename one, or convert them one by one with different -o folders.",
            )
    if not overwrite:
        found = _foreign(job, [name for name in more if name not in same], mode)
        stale = to_come(job) if found else []
        refuse([path for path in found if all(foreign(job.output, [path.name], record) for record in stale)])


def obsolete(job: Job, names: Iterable[str], mode: Mode, *, overwrite: bool) -> list[str]:
    """Return the files of an earlier run that this one does not write: its program had more parts or none, or it was
    made with a mesh of the part, a process or a file of forces.

    :param names: of the files to be written.
    :raises InputError: one of them was changed since, and must not be removed.
    """
    kept = {name.lower() for name in names}
    inputs = {_key(path) for path in job.reads()}
    programs = () if mode == "predict" else (job.writer.extension, *(path.suffix.lower() for path in job.reads()))
    endings = (*programs, *_BESIDE)
    record = job.output / job.report(mode)
    known, copied = recorded(record), noted(record, COPIED)
    left = [
        name
        for name in _there(job, known)
        if name.lower() not in kept
        and (name.lower().endswith(endings) or name in copied)
        and _key(job.output / name) not in inputs
    ]
    shared = of_others(job, left, mode)
    left = [name for name in left if name not in shared]
    if not overwrite:
        refuse(foreign(job.output, left, job.report(mode)))
    return left


def protect(inputs: Iterable[Path], folder: Path, names: Iterable[str]) -> None:
    """Refuse to write over what is read; names that differ in case are one.

    :param inputs: files that are read.
    :param folder: that is written into.
    :param names: of the files to be written.
    :raises InputError: one of them is an input.
    """
    read = {_key(path) for path in inputs}
    for path in (folder / name for name in names):
        if _key(path) in read:
            advice = "Nothing was written. Choose another place with -o."
            raise InputError("this input would be overwritten", file=str(path), advice=advice)


def set_aside(job: Job, mode: Mode) -> str:
    """Rename what an earlier run wrote for a program that failed now, so that nobody takes it for this one's.

    :returns: a sentence for the user; empty if there was nothing.
    """
    there = _there(job, _of_run(job, mode))
    shared = of_others(job, there, mode)
    changed = _foreign(job, [name for name in there if name not in shared], mode)
    changed += [
        path
        for name, other in shared.items()
        for path in _foreign(job, [name], mode)
        if foreign(job.output, [path.name], f"{other}.report.json")
    ]
    there = [name for name in there if name not in shared]
    inputs = {_key(path) for path in job.reads()}
    if not there:
        return ""
    if changed or any(_key(job.output / name) in inputs for name in there):
        return left([job], mode)
    try:
        for path in (job.output / name for name in there):
            path.rename(unused(path))
    except OSError:
        return left([job], mode)
    others = ", and its reports likewise" if len(there) > 1 else ""
    return f"{job.output / there[0]} is of an earlier run: renamed to {there[0]}.old{others}."


def left(jobs: Iterable[Job], mode: Mode) -> str:
    """Return a sentence on programs that stand in the output folders and are not of this run; empty if none do."""
    there = [job.output / name for job in jobs for name in _there(job, job.mains(mode))]
    return f"There before, not of this run: {listed(there)}." if there else ""


def _of_one_family(name: str, other: str) -> bool:
    """Return whether a file may be one of those of a divided program."""
    stem = Path(name).stem.lower()
    return stem.startswith(other) and (stem[len(other) :] in ("", "main") or stem[len(other) :].isdecimal())


def _there(job: Job, names: Iterable[str]) -> list[str]:
    return [name for name in names if (job.output / name).exists()]


def _of_run(job: Job, mode: Mode) -> list[str]:
    """Return the names of the files that a run may write, and those that an earlier one has written."""
    foreseen = job.writes(mode)
    return list(dict.fromkeys([*job.mains(mode), *foreseen, *recorded(job.output / job.report(mode))]))


def _foreign(job: Job, names: Iterable[str], mode: Mode) -> list[Path]:
    """Return which of the files that are there are not as postproc wrote them."""
    found = foreign(job.output, names, job.report(mode))
    found = [path for path in found if not copied_by_others(job, path, mode)]
    return [path for path in found if path.name not in _marked(job, mode)] if found else []


def _marked(job: Job, mode: Mode) -> list[str]:
    """Return the files of a program that says itself that it is as it was written, though its report is gone."""
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
