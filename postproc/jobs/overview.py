"""`index.html` of an output folder: what stands in it, of this run and of earlier ones."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from postproc.correction import Mode
from postproc.files import foreign_single, sealed, write_whole
from postproc.jobs.job import Job
from postproc.jobs.outcome import Outcome
from postproc.report.index import Entry, index_page
from postproc.report.summary import Summary

NAME = "index.html"
_REPORT = ".report.json"
_HEAD = b"<!-- Overview by postproc.\n-->\n"


def folders(jobs: Sequence[Job], mode: Mode) -> list[Path]:
    """Return the folders that get an overview: those of several programs, and those that have one already."""
    if mode == "predict":
        return []
    count: dict[Path, int] = {}
    for job in jobs:
        count[job.output] = count.get(job.output, 0) + (not job.callers)
    return [folder for folder, many in count.items() if many > 1 or _is_ours(folder / NAME)]


def write(jobs: Sequence[Job], outcomes: Sequence[Outcome], mode: Mode) -> list[Path]:
    """Write the overviews.

    :param outcomes: of the jobs, in any order.
    :returns: the files written.
    :raises InputError: one cannot be written.
    """
    known = {outcome.program: outcome for outcome in outcomes}
    written: list[Path] = []
    for folder in folders(jobs, mode):
        nothing = [known[str(job.program)] for job in jobs if job.output == folder and str(job.program) in known]
        entries = [
            Entry(Path(outcome.program).name, "", None, _why(outcome), called=outcome.skipped)
            for outcome in nothing
            if outcome.summary is None
        ]
        entries += [entry for path in sorted(folder.glob(f"*{_REPORT}")) if (entry := _entry(path)) is not None]
        content = sealed(_HEAD + index_page(entries, folder.resolve().name))
        written += write_whole(folder, {NAME: content})
    return written


def _is_ours(path: Path) -> bool:
    return path.is_file() and not foreign_single(path)


def _why(outcome: Outcome) -> str:
    return outcome.message or "; ".join(issue.message for issue in outcome.issues if issue.level == "error")


def _entry(path: Path) -> Entry | None:
    """Return what a report says; None if it is none of a program that was written."""
    try:
        content: Summary = json.loads(path.read_bytes())
        if content["mode"] == "predict" or content["verdict"]["state"] not in ("ok", "warning", "failed"):
            return None
        return Entry(content["program"], path.name.removesuffix(_REPORT) + ".report.html", content)
    except (OSError, ValueError, KeyError, TypeError):
        return None
