"""Files that several programs of an output folder need: subprograms, which are corrected, and what stays as it is."""

from __future__ import annotations

import contextlib
import glob
import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

from msgspec.structs import replace

from postproc import provenance
from postproc.cell import Cell
from postproc.correction import Mode
from postproc.dialects import registry
from postproc.dialects.dialect import Calling
from postproc.dialects.text import decode
from postproc.errors import InputError, ProgramError
from postproc.files import foreign, noted, recorded
from postproc.jobs.job import Job
from postproc.program import Document, Needed

COPIED = "copied"
"""Key of a report: files that were written as they are, and in which nothing is called that moves."""


def copies(job: Job, needed: Sequence[Needed], written: Collection[str], mode: Mode) -> dict[str, bytes]:
    """Return the files that a program needs as they are, and that must be written for it: name → content.

    A file that is another program of this run is left to that one. So is one that stands there as it was corrected for
    another program, from this very file: what does not move is the same in it.

    :param written: names of the files that are written anyway.
    """
    taken = {name.lower() for name in written}
    found: dict[str, bytes] = {}
    for each in needed:
        path = Path(each.path)
        if path.name.lower() in taken or path.stem.lower() in job.others:
            continue
        if path.parent.resolve() == job.output.resolve():
            continue
        group = [Path(other.path) for other in needed if Path(other.path).stem.lower() == path.stem.lower()]
        if each.moves or not _made_from(job, group, mode):
            found[path.name] = path.read_bytes()
    return found


def _made_from(job: Job, paths: Sequence[Path], mode: Mode) -> bool:
    """Return whether files stand in the folder as they were corrected for another program, from just these."""
    paths = sorted(paths, key=lambda path: path.suffix.lower() != job.writer.extension)
    there = [job.output / path.name for path in paths]
    known = of_others(job, [path.name for path in paths], mode)
    if len(known) < len(paths):
        return False
    try:
        said = job.writer.origin([decode(there[0].name, there[0].read_bytes())])
        source = provenance.digest(path.read_bytes() for path in paths)
    except (OSError, ProgramError):
        return False
    records = [job.output / f"{program}.report.json" for program in known.values()]
    intact = not any(foreign(job.output, [p.name], r.name) for p, r in zip(there, records, strict=True))
    return intact and said.sums.get("source") == source


def check_shared(
    job: Job,
    contents: Mapping[str, bytes],
    called: Sequence[str],
    copied: Collection[str],
    documents: Sequence[Document],
    mode: Mode,
) -> dict[str, bytes | None]:
    """Refuse to replace what was written for another program, which needs it too: it would move by what is not its own.

    :param contents: files of the program as it was read, of its subprograms, and copies: name → content.
    :param called: those of its subprograms; `copied` those that are written as they are.
    :param documents: as they were read.
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
    asked = [name for name in differ if name in called or name in copied or name not in own]
    before = {document.name: document.to_bytes() for document in documents if asked}
    spared = [name for name in asked if name not in copied and there[name] == before.get(name)]
    others = of_others(job, asked, mode, but=to_come(job) if asked else (), spared=spared)
    for name, other in others.items():
        other_one = "stays as it is" if name in copied else "is corrected otherwise"
        raise InputError(
            f"this file was written for {other}, which calls it too, and {other_one} for {job.stem}",
            file=str(job.output / name),
            advice="Nothing was written. Write this program into another folder with -o, or give each of the programs "
            f"a {name} of its own.",
        )
    return {name: there.get(name) for name in (*called, *copied)}


def of_others(
    job: Job, names: Collection[str], mode: Mode, but: Collection[str] = (), spared: Collection[str] = ()
) -> dict[str, str]:
    """Return which of some files were written for other programs too, and for which; `but` some reports tell.

    One of the program's own name may be: it is a subprogram of the other.

    :param spared: files that do not count where they were but copied.
    """
    found: dict[str, str] = {}
    for record in _other_reports(job, mode) if names else ():
        if record.name not in but:
            program = record.name.removesuffix(".report.json")
            told = recorded(record).keys() & set(names) - found.keys()
            if told and spared:
                told -= set(spared) & set(noted(record, COPIED))
            found |= dict.fromkeys(told, program)
    return found


def copied_by_others(job: Job, path: Path, mode: Mode) -> bool:
    """Return whether a file stands there as another program needs it, and as it was read."""
    records = (record for record in _other_reports(job, mode) if path.name in noted(record, COPIED))
    return any(not foreign(job.output, [path.name], record.name) for record in records)


def _other_reports(job: Job, mode: Mode) -> Iterator[Path]:
    for record in sorted(job.output.glob("*.report.json")):
        if record.name != job.report(mode):
            yield record


def lines(jobs: Sequence[Job], cell: Cell) -> list[list[Job]]:
    """Return jobs in lines: those of one line may correct one file in common, and come one after the other.

    Of programs that come from different folders into one, any may.
    """
    places: dict[tuple[Path, str], list[Job]] = {}
    for job in jobs:
        places.setdefault((job.output.resolve(), job.dialect), []).append(job)
    line_of = {job.program: [job] for job in jobs}
    for (_, dialect), there in places.items():
        kind = registry.by_name(dialect)
        if len(there) == 1 or not isinstance(kind, Calling):
            continue
        paths = [job.program for job in there]
        one_folder = len({path.parent.resolve() for path in paths}) == 1
        shared = kind.moving(paths, cell) if one_folder else {path: {there[0].output} for path in paths}
        first: dict[Path, Job] = {}
        for job in there:
            for path in shared[job.program]:
                one, other = line_of[first.setdefault(path, job).program], line_of[job.program]
                if one is not other:
                    one += other
                    line_of |= dict.fromkeys((each.program for each in other), one)
    unique = {id(line): line for line in line_of.values()}
    order = {job.program: number for number, job in enumerate(jobs)}
    return [sorted(line, key=lambda job: order[job.program]) for line in unique.values()]


def with_earlier(jobs: Sequence[Job], mode: Mode) -> list[Job]:
    """Return jobs that know which reports of programs of their run stand in their folders before it."""
    found: dict[Path, dict[str, int]] = {}
    for job in jobs if len(jobs) > 1 else ():
        written = _written_at(job.output / job.report(mode))
        if written is not None:
            found.setdefault(job.output, {})[job.report(mode)] = written
    return [replace(job, earlier=found.get(job.output, {})) for job in jobs]


def to_come(job: Job) -> list[str]:
    """Return the reports in its folder that programs of this run have yet to write anew."""
    return [name for name, written in job.earlier.items() if _written_at(job.output / name) == written]


@contextlib.contextmanager
def retiring(job: Job, names: Collection[str], mode: Mode) -> Iterator[None]:
    """Rename programs of this run that stand from before it with files that are replaced now: they come anew.

    What fails meanwhile brings them back. Its own ones, which others have renamed, go when it is written.

    :param names: of the files that are replaced.
    """
    known = recorded(job.output / job.report(mode)) if job.earlier else {}
    renamed = list(_retired(job, names, mode))
    try:
        yield
    except BaseException:
        for path, old in renamed:
            _put_back(path, old)
        raise
    for name in job.mains(mode) if known else ():
        for old in job.output.glob(f"{glob.escape(name)}.old*") if name in known else ():
            if hashlib.sha256(old.read_bytes()).hexdigest() == known[name]:
                old.unlink(missing_ok=True)


def _retired(job: Job, names: Collection[str], mode: Mode) -> Iterator[tuple[Path, Path]]:
    for name in to_come(job) if names else ():
        record = job.output / name
        known = recorded(record)
        if name == job.report(mode) or known.keys().isdisjoint(names):
            continue
        stem, end = name.removesuffix(".report.json"), job.writer.extension
        for path in (job.output / main for main in (f"{stem}{end}", f"{stem}Main{end}") if main in known):
            with contextlib.suppress(OSError):
                old = path.rename(unused(path))
                if _written_at(record) != job.earlier[name]:
                    _put_back(path, old)  # another process has written it anew in this moment
                else:
                    yield path, old


def _put_back(path: Path, old: Path) -> None:
    """Bring a renamed file back, unless it was written anew since."""
    with contextlib.suppress(OSError):
        if path.exists():
            old.unlink()
        else:
            old.rename(path)


def _written_at(path: Path) -> int | None:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return None


def unused(path: Path) -> Path:
    """Return a name for an old file: with ``.old`` behind it, or ``.old2`` …"""
    number = 2
    target = path.with_name(f"{path.name}.old")
    while target.exists():
        target = path.with_name(f"{path.name}.old{number}")
        number += 1
    return target
