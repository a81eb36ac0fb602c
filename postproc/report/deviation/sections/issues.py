"""The issues with all their lines."""

from itertools import groupby

import numpy as np

from postproc.errors import Issue
from postproc.report.deviation.content import Deviation
from postproc.report.kit import Cell, Kind, Note, Notes, Row, Section, Table

_MOST = 2000
_KINDS: dict[str, Kind] = {"error": "error", "warning": "warning", "info": "soft"}


def section(told: Deviation) -> Section:
    """Return a table of the issues."""
    issues = told.result.issues
    if not issues:
        return Section("issues", "Issues", (Notes((Note("None beside what the verdict says.", "soft"),)),))
    rows = tuple(
        Row(
            (
                Cell(issue.level, _KINDS[issue.level]),
                issue.message,
                Cell(_ranges(issue), sort=issue.source_line),
                str(issue.count),
            ),
            _place(told, issue),
            issue.source_line,
        )
        for issue in issues
    )
    return Section("issues", "Issues", (Table(("Level", "What", "Lines", "Places"), rows, "Issues", texts=(1, 2)),))


def _place(told: Deviation, issue: Issue) -> int | None:
    """Return the place of the first target on the line of an issue, or None."""
    rows = np.flatnonzero(told.result.source_line == issue.source_line)
    return told.places.of(int(rows[0])) if len(rows) else None


def _ranges(issue: Issue) -> str:
    """Return all lines of an issue, runs of them as ranges; of very many the first."""
    if not issue.lines:
        return "-" if issue.source_line is None else str(issue.source_line)
    runs = [[line for _, line in run] for _, run in groupby(enumerate(issue.lines), lambda entry: entry[1] - entry[0])]
    texts = [str(run[0]) if len(run) == 1 else f"{run[0]}–{run[-1]}" for run in runs[:_MOST]]
    return ", ".join(texts) + (f" and {len(runs) - _MOST} more" if len(runs) > _MOST else "")
