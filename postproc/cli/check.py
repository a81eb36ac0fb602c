"""`postproc check`: does the cell agree with the robot?"""

from __future__ import annotations

from pathlib import Path

import click

from postproc.cli.options import complete_files
from postproc.cli.ranges import FiniteRange

_PATH = click.Path(path_type=Path)


@click.group()
def check() -> None:
    """Check the cell against the robot.

    \b
    Example:
      postproc check frames points.csv --cell cell.toml
    """  # noqa: D301 - click: keep these lines as they are


@check.command()
@click.argument("points", type=_PATH, shell_complete=complete_files)
@click.option("--cell", type=_PATH, required=True, help="Cell file: robot, base, tool.")
@click.option(
    "--sigma",
    "sigma_mm",
    type=FiniteRange(1e-3, 100),
    default=0.5,
    show_default=True,
    help="Standard deviation of a coordinate, mm: touch, and accuracy of the robot (assumed).",
)
@click.pass_context
def frames(ctx: click.Context, /, points: Path, cell: Path, sigma_mm: float) -> None:
    """Say which frame is off, by touched points.

    POINTS is a CSV with the columns point, X, Y, Z, A1 … A6: three or more points of the part in $BASE (mm), and the
    joint angles (deg) that the controller shows while the tip touches them. Touch one of them with the tool turned
    and one with it tilted, so that $TOOL and $BASE can be told apart. The exit code is 3 if a frame is off or the
    points do not show it.

    \b
    Example:
      postproc check frames points.csv --cell cell.toml
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.jobs.frame_check import as_text, check_frames

    result = check_frames(points, cell, sigma_mm)
    click.echo(as_text(result, sigma_mm))
    ctx.exit(0 if result.suspect == "none" else 3)
