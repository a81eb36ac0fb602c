"""Reports of a comparison of two programs: summary, text, pairs as CSV, page."""

from postproc.report.comparison.page import comparison_page
from postproc.report.comparison.pairs import PAIR_COLUMNS, pairs_csv
from postproc.report.comparison.summary import ComparisonSummary, MadeFrom, comparison_summary
from postproc.report.comparison.text import of_comparison

__all__ = [
    "PAIR_COLUMNS",
    "ComparisonSummary",
    "MadeFrom",
    "comparison_page",
    "comparison_summary",
    "of_comparison",
    "pairs_csv",
]
