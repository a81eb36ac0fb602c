"""What each command does: files in, files out, whole or not at all.

`conversion` takes one program from file to files, `many_programs` many of them, one failure apart from the others.
Other jobs have a file of their own, such as `plan_files` and `identification_files`, and so has a `cluster`; they are
imported from there: what they need is loaded with them only.
"""

from postproc.jobs.conversion import convert_one, read_program
from postproc.jobs.inputs import find_jobs, read_documents
from postproc.jobs.job import Job
from postproc.jobs.many_programs import convert_all
from postproc.jobs.outcome import Outcome, Settings
from postproc.jobs.outputs import left
from postproc.jobs.setup import load_robot, load_setup

__all__ = [
    "Job",
    "Outcome",
    "Settings",
    "convert_all",
    "convert_one",
    "find_jobs",
    "left",
    "load_robot",
    "load_setup",
    "read_documents",
    "read_program",
]
