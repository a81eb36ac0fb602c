"""What each command does: files in, files out, whole or not at all.

`runs` converts or predicts programs: `programs` finds them, `output_plan` says which files are written, `conversion`
makes them, in this process or in `workers`. Other jobs have a module of their own, such as `plan_files` and
`identification_files`; they are imported from there: what they need is loaded with them only.
"""

from postproc.jobs.output_plan import leftover_note, removed_programs_note
from postproc.jobs.programs import Job, Outcome, Settings, find_jobs, load_robot, load_setup, read_documents
from postproc.jobs.runs import convert_all
from postproc.jobs.started_program import read_program

__all__ = [
    "Job",
    "Outcome",
    "Settings",
    "convert_all",
    "find_jobs",
    "leftover_note",
    "load_robot",
    "load_setup",
    "read_documents",
    "read_program",
    "removed_programs_note",
]
