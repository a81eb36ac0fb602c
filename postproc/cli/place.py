"""`postproc place`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from postproc.cli import options
from postproc.cli.ranges import FiniteRange
from postproc.progress import show

_PATH = click.Path(path_type=Path)


@click.command()
@click.argument("programs", nargs=-1, required=True)
@click.option("--cell", type=_PATH, required=True, help="Cell file: robot, today's base, tool.")
@click.option("--forces", type=_PATH, help="File of cutting forces, or a folder with NAME.csv for each program.")
@click.option("--process", type=_PATH, help="Compute the forces from material, tools and stock: process.toml.")
@click.option("--region", help="Bounds: X=1200:2000,Y=-600:600,Z=500:900,A=-90:90 (mm, deg); E1 too.")
@click.option("--margin-deg", type=FiniteRange(0, 60), default=5.0, show_default=True, help="To joint limits, in deg.")
@click.option(
    "--clearance-mm",
    type=FiniteRange(0, 1000),
    help="Between bodies of [collision]; default: clearance_mm of the cell.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@options.overwrite
@click.option("-o", "--output", type=_PATH, default=Path(), help="Folder to write into.")
def place(as_json: bool, **request: Any) -> None:
    """Find where the part should be.

    PROGRAMS are files, folders or patterns; all are to be driven at one place. Places in the region of $BASE are judged
    by reach, joint limits, singular poses, joint speeds, collisions (if the cell has [collision]) and the expected
    error under the forces. Writes place.json, place.csv (every place that was tried), place.html (map) and place.toml
    (the [base] of the best place). The exit code is 1 if no place can be driven.

    \b
    Examples:
      postproc place part.nc --cell cell.toml --forces part.forces.csv -o place
      postproc place op1.nc op2.nc --cell cell.toml --region X=1200:2000,Y=-600:600,A=-90:90 -o place
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.jobs.place_files import PlaceRequest, make_place
    from postproc.report import placement

    if request["forces"] is not None and request["process"] is not None:
        raise click.UsageError("Give --forces or --process, not both.")
    with show("places") as progress:
        files = make_place(PlaceRequest(**request), progress)
    if as_json:
        click.echo((request["output"] / "place.json").read_text(encoding="utf-8"), nl=False)
    else:
        click.echo(placement.as_text(files.summary))
        click.echo("written: " + ", ".join(str(path) for path in files.written_files))
    if files.summary.best is None:
        sys.exit(1)
