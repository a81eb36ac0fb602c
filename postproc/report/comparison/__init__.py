"""Reports of a comparison of two programs: summary, text, pairs as CSV, page."""

from postproc.report.comparison.page import comparison_page
from postproc.report.comparison.summary import (
    PAIR_COLUMNS,
    ComparisonSummary,
    ProgramOrigin,
    comparison_summary,
    comparison_text,
    pairs_csv,
)

__all__ = [
    "PAIR_COLUMNS",
    "ComparisonSummary",
    "ProgramOrigin",
    "comparison_page",
    "comparison_summary",
    "comparison_text",
    "pairs_csv",
]
