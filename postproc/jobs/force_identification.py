"""`postproc identify forces`: from measured mean forces to a file of cutting coefficients and its page."""

from __future__ import annotations

from pathlib import Path

from postproc import machining
from postproc.errors import ForceError
from postproc.files import foreign_single, refuse, write_whole
from postproc.jobs.output_plan import protect
from postproc.machining import identification
from postproc.machining.identification import IdentifiedMaterial
from postproc.report.material import material_page


def identify_forces(
    measured: Path, process: Path, output: Path, tool: int | None, *, overwrite: bool = False
) -> tuple[IdentifiedMaterial, list[Path]]:
    """Identify cutting coefficients, and write them as TOML with a page of the same name.

    :param measured: CSV file of readings.
    :param process: process.toml with the tool.
    :param tool: number of the tool; None: the only one.
    :raises PostprocError: the readings are unusable, or the file must not be replaced.
    """
    page = output.with_suffix(".html")
    protect([measured, process], output.parent, [output.name, page.name])
    if not overwrite:
        refuse(foreign_single(output))
    given = machining.load(process, tools_only=True)
    _, entry = identification.tool_of(given, tool)
    readings = identification.read(measured)
    found = identification.identify(readings, entry, given.material, str(measured))
    contents = {
        output.name: identification.as_toml(found, entry, measured.name),
        page.name: material_page(found, readings, measured.name),
    }
    return found, write_whole(output.parent, contents)


def propose_cuts(process: Path, output: Path, tool: int | None, *, overwrite: bool = False) -> list[Path]:
    """Write test cuts as G-code, and the CSV file to fill in next to it.

    :raises PostprocError: the process has no such tool, or a file must not be replaced.
    """
    given = machining.load(process, tools_only=True)
    key, entry = identification.tool_of(given, tool)
    table = output.with_suffix(".csv")
    protect([process], output.parent, [output.name, table.name])
    there = [path for path in (output, table) if path.exists()]
    if there and not overwrite:
        raise ForceError("this file exists", file=str(there[0]), advice="Give another name, or --overwrite.")
    program, rows = identification.proposal(given, key, entry)
    return write_whole(output.parent, {output.name: program, table.name: rows})
