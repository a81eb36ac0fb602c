"""Many programs: from what the user named to files written, one failure apart from the others."""

from postproc.batch.cluster import Cluster
from postproc.batch.convert import convert_one, load_robot, load_setup, read_program
from postproc.batch.inputs import DIALECTS, dialect_of, find_jobs, read_documents
from postproc.batch.job import Job
from postproc.batch.outcome import Outcome, Settings
from postproc.batch.outputs import left
from postproc.batch.run import convert_all

__all__ = [
    "DIALECTS",
    "Cluster",
    "Job",
    "Outcome",
    "Settings",
    "convert_all",
    "convert_one",
    "dialect_of",
    "find_jobs",
    "left",
    "load_robot",
    "load_setup",
    "read_documents",
    "read_program",
]
