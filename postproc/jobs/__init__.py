"""Many programs: from what the user named to files written, one failure apart from the others."""

from postproc.jobs.cluster import Cluster
from postproc.jobs.convert import convert_one, load_robot, load_setup, read_program
from postproc.jobs.inputs import DIALECTS, dialect_of, find_jobs, read_documents
from postproc.jobs.job import Job
from postproc.jobs.outcome import Outcome, Settings
from postproc.jobs.outputs import left
from postproc.jobs.run import convert_all

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
