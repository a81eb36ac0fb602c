"""`postproc testpart`: a part whose probed surfaces identify the robot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from postproc.cli import options
from postproc.cli.ranges import FiniteRange

_PATH = click.Path(path_type=Path)


@click.command()
@click.option("--cell", type=_PATH, required=True, help="Cell file; its robot is the prior.")
@click.option("--process", type=_PATH, required=True, help="process.toml: material and a flat end mill.")
@click.option("--block", help='Block in $BASE, mm: "X=0:300,Y=0:200,Z=-40:0"; default: [stock] box of the process.')
@click.option(
    "--placement",
    "placements",
    type=click.IntRange(1, 9999),
    multiple=True,
    metavar="N",
    help="Further placement of the block: [base_data.N] of the cell. May be repeated.",
)
@options.several_programs("What will be milled: the part is chosen for it.")
@click.option("--forces", type=_PATH, help="Forces of these programs: a CSV, process.toml, or a folder.")
@click.option(
    "--features", "count", type=click.IntRange(2, 60), default=12, show_default=True, help="Features at most."
)
@click.option("--depth", "depth_mm", type=FiniteRange(0.1, 50), help="Largest depth of cut, mm; default 0.2 diameters.")
@click.option("--feed", "feed_mm_per_min", type=FiniteRange(1, 50_000), help="Feed of full cuts, mm/min.")
@click.option("--tool", type=int, help="Number of the tool; default: the only one.")
@options.probe_sigma
@click.option(
    "--weight",
    "weight_kg",
    type=FiniteRange(0, 500),
    default=0.0,
    help="Weight that will be hung on the tool under a dial gauge, kg.",
)
@click.option("-o", "--output", type=_PATH, required=True, metavar="DIR", help="Folder to write.")
@options.overwrite
@click.option("--json", "as_json", is_flag=True, help="Print testpart.json.")
def testpart(as_json: bool, programs: tuple[str, ...], other_programs: tuple[str, ...], **request: Any) -> None:
    """Make a part to mill and probe: it identifies the robot.

    For shops without a laser tracker. Chooses grooves and steps in the block: places, directions and depths after which
    the least error is expected where you mill. Each has a trimmed half, cut with almost no force: the reference. The
    uncut top has touch-off points, which say how deep the cuts are. Writes testpart.nc, testpart.src (nominal, not
    corrected), probing.csv to fill in, testpart.process.toml, and testpart.html: the drawing, and what each parameter
    will be known to.

    The block is at [base] of the cell. --placement adds other places for it, each with a program of its own and its
    own features: other heights and distances load the joints otherwise.

    --weight adds stops above the block at the end of testpart.nc: hang the weight on the tool there, and read with a
    dial gauge how far the tool moves down. The force is known, so it separates compliances from cutting forces.

    Next: `postproc identify part`.

    \b
    Example:
      postproc testpart --cell cell.toml --process part.process.toml --block "X=0:300,Y=0:200,Z=-40:0" -o testpart
      postproc testpart --cell cell.toml --process part.process.toml --placement 3 -o testpart
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.jobs.testpart_files import TestPartRequest, make_testpart
    from postproc.report.testpart import design_lines

    files = make_testpart(TestPartRequest(programs=programs + other_programs, **request))
    if as_json:
        json_file = files.written_files[-1]
        click.echo(json_file.read_text(encoding="utf-8"), nl=False)
        return
    for line in design_lines(files.design, files.prior, files.cutting, files.parts):
        click.echo(line)
    for text in files.warnings:
        click.echo(f"warning: {text}")
    click.echo("written: " + ", ".join(str(path) for path in files.written_files))
