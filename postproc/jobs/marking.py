"""A written program is marked with what it was made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from msgspec.structs import replace

from postproc import provenance
from postproc import robot as robots
from postproc.cell import Cell
from postproc.correction import Result
from postproc.jobs.programs import Job
from postproc.jobs.settings import Settings
from postproc.program import Document
from postproc.version import VERSION

_OPTIONS = ("tolerance_mm", "lines_per_file", "linearize_arcs", "keep_unresolved")
"""Settings that a written program depends on in addition to its files."""


def options_of(settings: Settings) -> dict[str, str]:
    """Return the settings that were given, as a written program says them."""
    given = {name: getattr(settings, name) for name in _OPTIONS}
    given = {name: value for name, value in given.items() if value is not None and value is not False}
    return {name: repr(value) if isinstance(value, float) else f"{value:d}" for name, value in given.items()}


def marked(
    result: Result, job: Job, settings: Settings, cell: Cell, own_names: Mapping[str, str] | None = None
) -> Result:
    """Return a result whose program states where it comes from; one that is unchanged to the byte states nothing new.

    :param own_names: names of copies of subprograms → names as they were read.
    """
    source = [document.to_bytes() for document in result.program.documents]
    if not result.documents or [document.to_bytes() for document in result.documents] == source:
        return result
    mode: Literal["corrected", "nominal"] = "nominal" if settings.mode == "nominal" else "corrected"
    origin = origin_of(result.program.documents, settings.cell, cell, job.forces, mode)
    origin = replace(origin, options=options_of(settings))
    documents, moved = job.writer.marked(_subprograms_marked(result, job, origin, own_names or {}), origin)
    line = result.output_line
    return replace(result, documents=documents, output_line=line + (line >= moved) if moved else line)


def subprograms(result: Result, job: Job, own_names: Mapping[str, str]) -> list[str]:
    """Return the names of the files that are written with a program because it calls routines in them."""
    own = {path.name for path in job.reads()}
    called = {document.name for document in result.program.documents} - own
    return [document.name for document in result.documents if own_names.get(document.name, document.name) in called]


def _subprograms_marked(
    result: Result, job: Job, origin: provenance.Origin, own_names: Mapping[str, str]
) -> list[Document]:
    """Return the files of a program; those of subprograms that differ from what was read state their own origin.

    It does not depend on the program that calls them: two programs may be given the same file.
    """
    before = {document.name: document for document in result.program.documents}
    after = {document.name: document for document in result.documents}

    def read(name: str) -> Document:
        return before[own_names.get(name, name)]

    for name in subprograms(result, job, own_names):
        files = [other for other in after if Path(other).stem.lower() == Path(name).stem.lower()]
        files.sort(key=lambda other: other != name)
        if Path(name).suffix.lower() == job.writer.extension and any(after[n].text != read(n).text for n in files):
            source = provenance.digest(read(other).to_bytes() for other in files)
            own, _ = job.writer.marked(
                [after[other] for other in files], replace(origin, source=source, forces="-", options={})
            )
            after[name] = own[0]
    return list(after.values())


def origin_of(
    source: Sequence[Document], path: Path, cell: Cell, forces: Path | None, mode: Literal["corrected", "nominal"]
) -> provenance.Origin:
    """Return what is said of a program that is made from a source now.

    :param path: cell file, `cell` its content.
    :param forces: CSV file, or None.
    """
    folder = robots.find(cell.robot, Path(cell.folder))
    return provenance.Origin(
        version=VERSION,
        mode=mode,
        source=provenance.digest(document.to_bytes() for document in source),
        cell=provenance.digest([path.read_bytes()]),
        model=provenance.digest((folder / name).read_bytes() for name in ("robot.urdf", "model.toml")),
        forces="-" if forces is None else provenance.digest([forces.read_bytes()]),
    )
