"""A written program is marked with what it was made from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from postproc import provenance
from postproc import robot as robots
from postproc.cell import Cell
from postproc.correction import Result
from postproc.jobs.job import Job
from postproc.jobs.outcome import Settings
from postproc.version import VERSION


def marked(result: Result, job: Job, settings: Settings, cell: Cell) -> Result:
    """Return a result whose program says where it comes from; one that came back byte for byte says nothing new."""
    source = [document.to_bytes() for document in result.program.documents]
    if not result.documents or [document.to_bytes() for document in result.documents] == source:
        return result
    folder = robots.find(cell.robot, Path(cell.folder))
    origin = provenance.Origin(
        version=VERSION,
        mode="nominal" if settings.mode == "nominal" else "corrected",
        source=provenance.digest(source),
        cell=provenance.digest([settings.cell.read_bytes()]),
        model=provenance.digest((folder / name).read_bytes() for name in ("robot.urdf", "model.toml")),
        forces="-" if job.forces is None else provenance.digest([job.forces.read_bytes()]),
    )
    documents, moved = job.writer.marked(result.documents, origin)
    line = result.output_line
    return replace(result, documents=documents, output_line=line + (line >= moved) if moved else line)
