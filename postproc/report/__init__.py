"""Results as text, JSON, CSV and HTML: pure functions of a result; no file is read or written here."""

from postproc.report.csv_files import FORCE_COLUMNS, TARGET_COLUMNS, forces_by_module, forces_csv, targets_csv
from postproc.report.deviation import page
from postproc.report.summary import Summary, issue_entry, summary
from postproc.report.text import ProgramRow, issue_line, program_text, programs_table

__all__ = [
    "FORCE_COLUMNS",
    "TARGET_COLUMNS",
    "ProgramRow",
    "Summary",
    "forces_by_module",
    "forces_csv",
    "issue_entry",
    "issue_line",
    "page",
    "program_text",
    "programs_table",
    "summary",
    "targets_csv",
]
