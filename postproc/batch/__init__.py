"""Many programs: from what the user named to files written, one failure apart from the others."""

from postproc.batch.convert import convert_one, load_robot, load_setup, read_program
from postproc.batch.inputs import DIALECTS, Job, dialect_of, find_jobs, read_documents
from postproc.batch.outcome import Outcome, Settings
from postproc.batch.run import convert_all

__all__ = [
    "DIALECTS",
    "Job",
    "Outcome",
    "Settings",
    "convert_all",
    "convert_one",
    "dialect_of",
    "find_jobs",
    "load_robot",
    "load_setup",
    "read_documents",
    "read_program",
]
