"""Files that several programs of an output folder need: subprograms that they call, and files that stay as read."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path, PurePath

from msgspec import Struct

from postproc import provenance
from postproc.cell import Cell
from postproc.dialects import registry
from postproc.dialects.dialect import Calling
from postproc.dialects.text import decode
from postproc.errors import InputError, ProgramError
from postproc.jobs.programs import Job
from postproc.program import Document, Needed


class Record(Struct, frozen=True):
    """The files that were written for a program, as its report lists them.

    :param program: its name.
    :param at: folder in which they are: the output folder, or one in it if they are not yet in their places.
    :param files: name → SHA-256.
    :param copied: names of those that were written as they were read.
    :param renewed: whether the program is one of this run and not yet converted.
    """

    program: str
    at: Path
    files: Mapping[str, str]
    copied: frozenset[str] = frozenset()
    renewed: bool = False


class Task(Struct, frozen=True):
    """A job, and what its run knows of the output folder.

    :param job: the job.
    :param names: names of the other programs that the run writes there, lower case.
    :param records: files of other programs there.
    :param earlier: names of the files that an earlier run wrote for this program.
    """

    job: Job
    names: frozenset[str] = frozenset()
    records: tuple[Record, ...] = ()
    earlier: frozenset[str] = frozenset()


def copies(task: Task, needed: Sequence[Needed], written: Collection[str]) -> dict[str, bytes]:
    """Return the files that a program needs as they were read, and that are written with it: name → content.

    A file that is another program of this run is left to that program. So is one that was corrected for another
    program, from the same file: routines that do not move are the same in it.

    :param written: names of the files that are written anyway.
    """
    job, taken = task.job, {name.lower() for name in written}
    found: dict[str, bytes] = {}
    for each in needed:
        path = Path(each.path)
        if path.name.lower() in taken or path.stem.lower() in task.names:
            continue
        if path.parent.resolve() == job.output.resolve():
            continue
        group = [Path(other.path) for other in needed if Path(other.path).stem.lower() == path.stem.lower()]
        if each.moves or not _corrected_from(task, group):
            found[path.name] = path.read_bytes()
    return found


def _corrected_from(task: Task, paths: Sequence[Path]) -> bool:
    """Return whether some files were corrected for other programs, and are as they were written."""
    writer = task.job.writer
    paths = sorted(paths, key=lambda path: path.suffix.lower() != writer.extension)
    there: list[bytes] = []
    for path in paths:
        record = next((record for record in task.records if path.name in record.files), None)
        try:
            content = b"" if record is None else (record.at / path.name).read_bytes()
        except OSError:
            return False
        if record is None or provenance.digest([content]) != record.files[path.name]:
            return False
        there.append(content)
    try:
        said = writer.origin([decode(paths[0].name, there[0])])
        return said.sums.get("source") == provenance.digest(path.read_bytes() for path in paths)
    except (OSError, ProgramError):
        return False


def conflicts(
    task: Task, texts: Mapping[str, bytes], called: Sequence[str], copied: Collection[str], read: Sequence[Document]
) -> dict[str, str]:
    """Return which files were written for other programs with another content, and for which programs.

    A program that the run will convert again does not count. Nor does one for which the file was only copied, if it was
    the same file: the corrected one has the same routines that do not move.

    :param texts: files of the program, of its subprograms, and copies: name → content.
    :param called: names of those of its subprograms; `copied` of those that are written as they were read.
    :param read: the documents of the program as they were read.
    :raises InputError: a subprogram is also converted as a program of its own in this run.
    """
    for name in called:
        if PurePath(name).stem.lower() in task.names:
            raise InputError(
                f"{task.job.program} calls {name}, which is also converted as a program of its own in this run",
                advice="Name the main programs instead of their folder, or move the file of the subprogram into a "
                "folder that [krl] search in the cell names.",
            )
    before = {document.name: document.to_bytes() for document in read} if task.records else {}
    found: dict[str, str] = {}
    for record in task.records:
        for name in texts.keys() & record.files.keys() - found.keys() if not record.renewed else ():
            sum_ = record.files[name]
            if sum_ == provenance.digest([texts[name]]):
                continue
            same_source = name in before and sum_ == provenance.digest([before[name]])
            if not (name in record.copied and name not in copied and same_source):
                found[name] = record.program
    return found


def with_own_names(
    task: Task,
    documents: Sequence[Document],
    others: Mapping[str, str],
    called: Sequence[str],
    copied: Mapping[str, bytes],
) -> tuple[tuple[Document, ...], dict[str, str]]:
    """Return the files of a program with its own copies of subprograms that were written differently for others.

    :param documents: files of the program and of its subprograms; `called` names those of the subprograms.
    :param others: files that were written differently, and for which programs, see `conflicts`.
    :param copied: files that are written as they were read: name → content.
    :returns: the files, and the new name of each copy's files → the name as it was read.
    :raises InputError: a copy cannot have a name of its own.
    """
    job, kind = task.job, registry.by_name(task.job.dialect)
    if isinstance(kind, Calling) and set(others) <= set(called):
        taken = {PurePath(name).stem.lower() for record in task.records for name in record.files} | task.names
        taken |= {path.stem.lower() for path in job.output.glob("*") if path.name not in task.earlier}
        stems = sorted({PurePath(name).stem for name in others})
        found = kind.with_own_copies(documents, [*copied.values()], stems, job.stem, taken)
        if found is not None:
            return found
    name, other = next(iter(others.items()))
    how = "stays as it is" if name in copied else "is corrected differently"
    raise InputError(
        f"this file was written for {other}, which calls it too, and {how} for {job.stem}",
        file=str(job.output / name),
        advice="Nothing was written. Write this program into another folder with -o, or give each of the programs "
        f"a {name} of its own.",
    )


def lines(jobs: Sequence[Job], cell: Cell) -> list[list[Job]]:
    """Return jobs in groups: those of a group may correct one file in common, and are converted one after the other.

    :param jobs: of one output folder. If KRL programs come from different folders, they are one group.
    """
    kinds: dict[str, list[Job]] = {}
    for job in jobs:
        kinds.setdefault(job.dialect, []).append(job)
    group_of: dict[Path, list[Job]] = {job.program: [job] for job in jobs}
    for dialect, same in kinds.items():
        kind = registry.by_name(dialect)
        if len(same) == 1 or not isinstance(kind, Calling):
            continue
        paths = [job.program for job in same]
        one_folder = len({path.parent.resolve() for path in paths}) == 1
        moving = kind.moving(paths, cell) if one_folder else {path: {paths[0]} for path in paths}
        first: dict[Path, Job] = {}
        for job in same:
            for path in moving[job.program]:
                group, joined = group_of[first.setdefault(path, job).program], group_of[job.program]
                if group is not joined:
                    group += joined
                    group_of |= dict.fromkeys((each.program for each in joined), group)
    return list({id(group): group for group in group_of.values()}.values())
