"""What stands in an output folder: whose files are there, and which are of an earlier run.

`report.json` names the files that were written with it and the SHA-256 of each. A file that is not named there, or was
changed since, is not ours to replace; nor is one without such a report, but for a program that says the same itself.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from postproc import provenance, report
from postproc.batch.inputs import read_documents
from postproc.batch.job import Job
from postproc.errors import InputError, ProgramError
from postproc.pipeline import Mode
from postproc.report import FileEntry, Summary

_SHOWN = 5
"""Of many files, so many are named."""


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
    inputs = {_key(path) for job in jobs for path in job.reads()} | {_key(cell)}
    for job in jobs:
        _protect(inputs, job, job.writes(mode))
    if not overwrite:
        _refuse([job.output / name for job in jobs for name in _strange(job, job.writes(mode), mode)])


def check_more(job: Job, names: Sequence[str], mode: Mode, *, overwrite: bool) -> None:
    """Look again when the names of the files to be written are known; see `check`."""
    _protect({_key(path) for path in job.reads()}, job, names)
    if not overwrite:
        foreseen = job.writes(mode)
        more = [name for name in names if name not in foreseen]
        _refuse([job.output / name for name in _strange(job, more, mode)])


def _protect(inputs: set[str], job: Job, names: Iterable[str]) -> None:
    for path in (job.output / name for name in names):
        if _key(path) in inputs:
            advice = "Nothing was written. Choose another output folder with -o."
            raise InputError("this input would be overwritten", file=str(path), advice=advice)


def _refuse(strange: Sequence[Path]) -> None:
    if strange:
        raise InputError(
            f"not written by postproc, or changed since: {_listed(strange)}",
            advice="Nothing was written. Choose another folder with -o, or replace what is there with --overwrite.",
        )


def recorded(
    contents: Mapping[str, bytes | Iterable[bytes]], name: str, content: Summary
) -> dict[str, bytes | Iterable[bytes]]:
    """Return contents for `files.write_whole`, and behind them the report, which names them.

    :param contents: file name → content.
    :param name: of the report.
    :param content: of the report; its ``files`` are filled in while the others are written.
    """
    written: list[FileEntry] = []
    content["files"] = written

    def digested(name: str, pieces: Iterable[bytes]) -> Iterator[bytes]:
        digest = hashlib.sha256()
        for piece in pieces:
            digest.update(piece)
            yield piece
        written.append({"name": name, "sha256": digest.hexdigest()})

    def last() -> Iterator[bytes]:
        yield report.to_json(content)

    made = {n: digested(n, [c] if isinstance(c, bytes) else c) for n, c in contents.items()}
    return {**made, name: last()}


def set_aside(job: Job, mode: Mode) -> str:
    """Rename what an earlier run wrote for a program that failed now, so that nobody takes it for this one's.

    :returns: a sentence for the user; empty if there was nothing.
    """
    there = _there(job, job.writes(mode))
    inputs = {_key(path) for path in job.reads()}
    if not there or _strange(job, there, mode) or any(_key(job.output / name) in inputs for name in there):
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
    there = [job.output / name for job in jobs for name in _there(job, job.writes(mode)[:1])]
    return f"Of an earlier run, not of this one: {_listed(there)}." if there else ""


def _there(job: Job, names: Iterable[str]) -> list[str]:
    return [name for name in names if (job.output / name).exists()]


def _strange(job: Job, names: Iterable[str], mode: Mode) -> list[str]:
    """Return which of the files that are there are not as postproc wrote them."""
    report = job.report(mode)
    record = _record(job.output / report)
    if record is None:
        return [name for name in _there(job, names) if name not in _marked(job, mode)]
    return [name for name in _there(job, names) if name != report and record.get(name) != _digest(job.output / name)]


def _marked(job: Job, mode: Mode) -> list[str]:
    """Return the files of a program that says itself that it is as it was written, though its report is gone."""
    program = job.output / job.writes(mode)[0]
    if mode == "predict" or not program.is_file():
        return []
    try:
        documents = read_documents(program, "krl")
    except ProgramError:
        return []
    return [document.name for document in documents] if provenance.of(documents).state == "intact" else []


def _record(path: Path) -> dict[str, str] | None:
    """Return what a report says was written with it; None if it is none of ours."""
    try:
        return {entry["name"]: entry["sha256"] for entry in json.loads(path.read_bytes())["files"]}
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file; empty if it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""


def _unused(path: Path) -> Path:
    """Return a name for an old file: with ``.old`` behind it, or ``.old2`` …"""
    number = 2
    target = path.with_name(f"{path.name}.old")
    while target.exists():
        target = path.with_name(f"{path.name}.old{number}")
        number += 1
    return target


def _listed(paths: Sequence[Path]) -> str:
    more = f" and {len(paths) - _SHOWN} more" if len(paths) > _SHOWN else ""
    return ", ".join(str(path) for path in paths[:_SHOWN]) + more


def _key(path: Path) -> str:
    return str(path.resolve()).lower()
