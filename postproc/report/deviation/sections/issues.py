"""The issues with all their lines."""

from postproc.report.deviation.content import Deviation
from postproc.report.kit import Cell, Kind, Note, Notes, Row, Section, Table

_KINDS: dict[str, Kind] = {"error": "error", "warning": "warning", "info": "soft"}


def section(told: Deviation) -> Section:
    """Return a table of the issues."""
    issues = told.result.issues
    if not issues:
        return Section("issues", "Issues", (Notes((Note("None.", "good"),)),))
    rows = tuple(
        Row(
            (
                Cell(issue.level, _KINDS[issue.level]),
                issue.message,
                "-" if issue.source_line is None else str(issue.source_line),
                str(issue.count),
            ),
            source_line=issue.source_line,
        )
        for issue in issues
    )
    return Section("issues", "Issues", (Table(("Level", "What", "Line", "Places"), rows, "Issues", texts=(1,)),))
