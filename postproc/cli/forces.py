"""`postproc forces`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from postproc.cli import options
from postproc.progress import show

_PATH = click.Path(path_type=Path)


@click.command()
@click.argument("program", type=_PATH, required=False)
@click.option("--cell", type=_PATH, help="Cell file: robot, base, tool.")
@click.option("--process", type=_PATH, help="Material, tools and stock: process.toml.")
@click.option("--stock", type=_PATH, help="Closed mesh of the stock (STL …, mm), instead of that of the process.")
@click.option("--stock-out", type=_PATH, help="Also write the remaining stock as a closed mesh (.stl, .glb …).")
@click.option("--base", "base_axes", is_flag=True, help="Forces in $BASE axes, but for arcs; default: FEED.")
@options.dialect
@click.option("--materials", is_flag=True, help="Only list the included materials.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
@options.overwrite
@click.option("-o", "--output", type=_PATH, help="CSV file to write; a .json of that name is written next to it.")
def forces(as_json: bool, materials: bool, **request: Any) -> None:
    """Compute the cutting forces of PROGRAM from its process.

    The process is tool, material and stock. The tool is swept through the stock; where it is in material, its teeth
    make the mean force over a turn. The CSV holds it along each move, with standard deviations, for `convert --forces`.

    \b
    Examples:
      postproc forces part.nc --cell cell.toml --process process.toml -o part.forces.csv
      postproc forces op2.nc --cell cell.toml --process process.toml --stock rest.stl -o op2.forces.csv
      postproc forces --materials
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.files import json_bytes
    from postproc.jobs.process_forces import ForcesRequest, make_forces
    from postproc.machining import table
    from postproc.report import issue_entry, issue_line, process_forces

    if materials:
        click.echo(process_forces.materials(table()))
        return
    for name in ("program", "cell", "process", "output"):
        if request[name] is None:
            raise click.UsageError("Give PROGRAM, --cell, --process and -o (or --materials).")
    force_request = ForcesRequest(**request)
    with show("moves") as progress:
        files = make_forces(force_request, progress)
    for issue in files.issues:
        click.echo(issue_line(issue_entry(issue), str(force_request.program)), err=True)
    if as_json:
        click.echo(json_bytes(files.summary).decode(), nl=False)
    else:
        click.echo(process_forces.as_text(files.summary))
        click.echo(f"written: {', '.join(path.name for path in files.written_files)}")
