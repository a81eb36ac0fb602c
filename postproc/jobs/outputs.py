"""What stands in an output folder: whose files are there (`files.records`), and which are of an earlier run."""

from __future__ import annotations

import contextlib
import glob
import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

from msgspec.structs import replace

from postproc.correction import Mode
from postproc.dialects import registry
from postproc.errors import InputError, ProgramError
from postproc.files import foreign, foreign_single, listed, recorded, refuse
from postproc.jobs import overview
from postproc.jobs.inputs import read_documents
from postproc.jobs.job import Job

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
        stale = _stale(job) if found else []
        refuse([path for path in found if all(foreign(job.output, [path.name], record) for record in stale)])


def check_shared(job: Job, contents: Mapping[str, bytes], called: Sequence[str], mode: Mode) -> dict[str, bytes | None]:
    """Refuse to replace what was written for another program, which calls it too: it would move by what is not its own.

    :param contents: files of the program as it was read, and of its subprograms: name → content.
    :param called: those of its subprograms.
    :returns: what stands there of them now; None: nothing.
    :raises InputError: a file of that name and another content was written for another program, or is one of this run.
    """
    for name in called:
        if Path(name).stem.lower() in job.others:
            raise InputError(
                f"{job.program} calls {name}, which is also converted as a program of its own in this run",
                advice=f"Name the main programs instead of their folder, or move {name} into a folder that [krl] "
                "search in the cell names.",
            )
    there = {name: path.read_bytes() for name in contents if (path := job.output / name).exists()}
    own = recorded(job.output / job.report(mode)) if there else {}
    differ = [name for name, content in there.items() if content != contents[name]]
    asked = [name for name in differ if name in called or name not in own]
    others = _of_others(job, asked, mode, but=_stale(job) if asked else ())
    for name, other in others.items():
        raise InputError(
            f"this file was written for {other}, which calls it too, and is corrected otherwise for {job.stem}",
            file=str(job.output / name),
            advice="Nothing was written. Write this program into another folder with -o, or give each of the programs "
            f"a {name} of its own.",
        )
    return {name: there.get(name) for name in called}


def with_earlier(jobs: Sequence[Job], mode: Mode) -> list[Job]:
    """Return jobs that know which reports of programs of their run stand in their folders before it."""
    found: dict[Path, dict[str, int]] = {}
    for job in jobs if len(jobs) > 1 else ():
        written = _written_at(job.output / job.report(mode))
        if written is not None:
            found.setdefault(job.output, {})[job.report(mode)] = written
    return [replace(job, earlier=found.get(job.output, {})) for job in jobs]


def retire(job: Job, names: Collection[str], mode: Mode) -> None:
    """Rename programs of this run that stand from before it with files that are replaced now: they come anew.

    :param names: of the files that are replaced.
    """
    for name in _stale(job) if names else ():
        record = job.output / name
        known = recorded(record)
        if name == job.report(mode) or known.keys().isdisjoint(names):
            continue
        stem, end = name.removesuffix(".report.json"), job.writer.extension
        for path in (job.output / main for main in (f"{stem}{end}", f"{stem}Main{end}") if main in known):
            with contextlib.suppress(OSError):
                old = path.rename(_unused(path))
                if _written_at(record) != job.earlier[name] and not path.exists():
                    old.rename(path)  # another process has written it anew in this moment


def _stale(job: Job) -> list[str]:
    """Return the reports in its folder that programs of this run have yet to write anew."""
    return [name for name, written in job.earlier.items() if _written_at(job.output / name) == written]


def _written_at(path: Path) -> int | None:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return None


def _retired(job: Job, known: Mapping[str, str], mode: Mode) -> list[str]:
    """Return the names of its own programs that `retire` has renamed."""
    return [
        path.name
        for name in _programs(job, mode)
        for path in (job.output.glob(f"{glob.escape(name)}.old*") if name in known and job.earlier else ())
        if hashlib.sha256(path.read_bytes()).hexdigest() == known[name]
    ]


def _of_others(job: Job, names: Collection[str], mode: Mode, but: Collection[str] = ()) -> dict[str, str]:
    """Return which of some files were written for other programs too, and for which; `but` some reports tell.

    One of the program's own name may be: it is a subprogram of the other.
    """
    found: dict[str, str] = {}
    for record in sorted(job.output.glob("*.report.json")) if names else ():
        if record.name != job.report(mode) and record.name not in but:
            program = record.name.removesuffix(".report.json")
            found |= dict.fromkeys(recorded(record).keys() & set(names) - found.keys(), program)
    return found


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
    known = recorded(job.output / job.report(mode))
    left = [
        name
        for name in _there(job, known)
        if name.lower() not in kept and name.lower().endswith(endings) and _key(job.output / name) not in inputs
    ]
    shared = _of_others(job, left, mode)
    left = [name for name in left if name not in shared]
    if not overwrite:
        refuse(foreign(job.output, left, job.report(mode)))
    return [*left, *_retired(job, known, mode)]


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
    shared = _of_others(job, there, mode)
    there = [name for name in there if name not in shared]
    inputs = {_key(path) for path in job.reads()}
    if not there:
        return ""
    if _foreign(job, there, mode) or any(_key(job.output / name) in inputs for name in there):
        return left([job], mode)
    try:
        for path in (job.output / name for name in there):
            path.rename(_unused(path))
    except OSError:
        return left([job], mode)
    others = ", and its reports likewise" if len(there) > 1 else ""
    return f"{job.output / there[0]} is of an earlier run: renamed to {there[0]}.old{others}."


def left(jobs: Iterable[Job], mode: Mode) -> str:
    """Return a sentence on programs that stand in the output folders and are not of this run; empty if none do."""
    there = [job.output / name for job in jobs for name in _there(job, _programs(job, mode))]
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
    return list(dict.fromkeys([*_programs(job, mode), *foreseen, *recorded(job.output / job.report(mode))]))


def _programs(job: Job, mode: Mode) -> list[str]:
    """Return the names that the main file may have, the likelier first."""
    first = Path(job.writes(mode)[0])
    return [first.name, *([f"{first.stem}Main{first.suffix}"] if mode != "predict" else [])]


def _foreign(job: Job, names: Iterable[str], mode: Mode) -> list[Path]:
    """Return which of the files that are there are not as postproc wrote them."""
    found = foreign(job.output, names, job.report(mode))
    return [path for path in found if path.name not in _marked(job, mode)] if found else []


def _marked(job: Job, mode: Mode) -> list[str]:
    """Return the files of a program that says itself that it is as it was written, though its report is gone."""
    program = next((job.output / name for name in _there(job, _programs(job, mode))), None)
    if mode == "predict" or program is None or not program.is_file():
        return []
    try:
        documents = read_documents(program, registry.written_in(job.dialect, job.to)[0])
    except ProgramError:
        return []
    return [document.name for document in documents] if job.writer.origin(documents).state == "intact" else []


def _unused(path: Path) -> Path:
    """Return a name for an old file: with ``.old`` behind it, or ``.old2`` …"""
    number = 2
    target = path.with_name(f"{path.name}.old")
    while target.exists():
        target = path.with_name(f"{path.name}.old{number}")
        number += 1
    return target


def _key(path: Path) -> str:
    return str(path.resolve()).lower()
