"""`postproc plan`: poses and loads to identify the robot by, and readings of the gravity compensator."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from postproc.cli import options
from postproc.cli.ranges import FiniteRange
from postproc.progress import as_lines, line_writer

if TYPE_CHECKING:
    from postproc.plan.planning import Progress

_PATH = click.Path(path_type=Path)


class _PlanGroup(click.Group):
    """A group whose command `poses` is the default: ``plan --experiment …`` is ``plan poses --experiment …``."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse arguments; insert the default command if they begin with an option."""
        if args and args[0].startswith("-") and args[0] not in ctx.help_option_names:
            args = ["poses", *args]
        return super().parse_args(ctx, args)


@click.group(cls=_PlanGroup)
def plan() -> None:
    """Plan what to measure.

    `poses` is the default: `postproc plan --experiment …` is `postproc plan poses --experiment …`.

    \b
    Examples:
      postproc plan --experiment experiment.toml --cell cell.toml --program part.nc -o plan.csv
      postproc plan compensator --experiment experiment.toml -o compensator.csv
    """  # noqa: D301 - click: keep these lines as they are


@plan.command()
@click.option("--experiment", type=_PATH, required=True, help="Experiment file: robot, sigma_mm.")
@click.option("--angles", type=click.IntRange(3, 40), default=6, show_default=True, help="Angles of A2 to measure at.")
@click.option(
    "--markers", type=click.IntRange(1, 20), default=4, show_default=True, help="Markers on the compensator, P01 …"
)
@click.option("--repeats", type=click.IntRange(1, 100), default=3, show_default=True, help="Readings of each marker.")
@click.option("--margin", type=FiniteRange(0, 60), default=5.0, show_default=True, help="To limits of A2, in deg.")
@click.option("--json", "as_json", is_flag=True, help="Print the plan as JSON.")
@options.overwrite
@click.option("-o", "--output", type=_PATH, required=True, help="CSV file to write; .json next to it.")
def compensator(as_json: bool, **request: Any) -> None:
    """Choose angles of A2 and places of the compensator's markers.

    For `identify compensator`: they make the intervals of L, a_x, a_y smallest (trace of the covariance by Eq. (6) and
    (7) of the paper). Writes the CSV file that `identify compensator` reads, one row for each reading, with X, Y, Z to
    be filled in, and a JSON file of the plan. L, a_x, a_y of the robot in the experiment are the prior.

    \b
    Example:
      postproc plan compensator --experiment experiment.toml --angles 8 -o compensator.csv
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.jobs.plan_files import CompensatorRequest, make_compensator_plan
    from postproc.plan.compensator import text_lines

    plan_request = CompensatorRequest(**request)
    if plan_request.output.suffix.lower() != ".csv":
        raise click.BadParameter("give a file that ends in .csv", param_hint="-o")
    files = make_compensator_plan(plan_request)
    if as_json:
        json_file = files.written_files[-1]
        click.echo(json_file.read_text(encoding="utf-8"), nl=False)
        return
    for line in text_lines(files.plan):
        click.echo(line)
    click.echo("written: " + ", ".join(str(path) for path in files.written_files))


@plan.command()
@click.option("--experiment", type=_PATH, required=True, help="How it is measured: experiment.toml with [rig].")
@click.option("--cell", type=_PATH, required=True, help="Cell file of the programs.")
@options.several_programs("What will be milled: files, folders, patterns.")
@click.option(
    "--forces",
    type=_PATH,
    help="File of cutting forces (CSV, or what a package adds), or a folder with NAME.csv … for each program.",
)
@click.option(
    "--poses", type=_PATH, help="Test poses by hand instead: CSV A1…A6,Fx,Fy,Fz[,weight] (deg; N, root axes)."
)
@click.option("--measured", type=_PATH, help="Readings so far; the plan chooses the next ones.")
@click.option("--configurations", type=click.IntRange(1, 200), default=15, show_default=True, help="Poses to measure.")
@click.option("--q2-levels", type=click.IntRange(1, 20), default=5, show_default=True, help="Levels of A2 among them.")
@click.option("--grouped", is_flag=True, help="The criterion as printed: each level of A2 identified alone.")
@click.option(
    "--test-poses",
    type=click.IntRange(1, 500),
    default=20,
    show_default=True,
    help="Poses that represent the programs.",
)
@click.option("--repeats", type=click.IntRange(1, 100), default=3, show_default=True, help="Readings of each point.")
@click.option("--margin", type=FiniteRange(0, 60), default=5.0, show_default=True, help="To joint limits, in deg.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same plan.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
@options.overwrite
@click.option(
    "-o", "--output", type=_PATH, required=True, help="CSV file to write; .src, .html and .json are written next to it."
)
def poses(programs: tuple[str, ...], other_programs: tuple[str, ...], as_json: bool, **request: Any) -> None:
    """Choose poses and loads to identify the robot by.

    The plan makes the error that remains after compensation smallest where the PROGRAMs mill, under their forces. For
    plan.csv this writes plan.csv (config,A1…A6,Fx,Fy,Fz: deg; N, root axes, at the load point; in the order of least
    travel), plan.src (KRL that visits the poses and waits), plan.html (poses drawn, expected accuracy, comparison with
    other plans) and plan.json. Ctrl-C ends the search and writes the best plan so far.

    --program takes several: --program a.nc b.nc. Each counts the same.

    \b
    Examples:
      postproc plan poses --experiment experiment.toml --cell cell.toml --program part.nc -o plan.csv
      postproc plan --experiment experiment.toml --cell cell.toml --program "parts/*.nc" --forces forces/ \\
          --configurations 20 --q2-levels 6 --seed 7 -o plan.csv
      postproc plan --experiment experiment.toml --cell cell.toml --poses tests.csv --grouped -o plan.csv
      postproc plan --experiment experiment.toml --cell cell.toml --program part.nc \\
          --measured measurements.csv --configurations 4 -o next.csv
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.jobs.plan_files import PlanRequest, make_plan
    from postproc.report.plan import plan_lines

    programs += other_programs  # --program a.nc b.nc
    plan_request = PlanRequest(programs=programs, **request)
    if (plan_request.poses is None) == (not programs):
        raise click.UsageError("Give either --program (one or several) or --poses.")
    if plan_request.output.suffix.lower() != ".csv":
        raise click.BadParameter("give a file that ends in .csv", param_hint="-o")
    with _progress_display() as progress:
        files = make_plan(plan_request, progress)
    for warning in files.result.warnings:
        click.echo(f"warning: {warning}", err=True)
    if as_json:
        json_file = files.written_files[-1]
        click.echo(json_file.read_text(encoding="utf-8"), nl=False)
        return
    for line in plan_lines(files.result):
        click.echo(line)
    click.echo("written: " + ", ".join(str(path) for path in files.written_files))


@contextlib.contextmanager
def _progress_display() -> Iterator[Progress | None]:
    """Yield the function that shows the progress of the search; None if stderr is no terminal.

    For the window it prints lines, on a terminal it draws a bar.
    """
    if as_lines():
        show_line = line_writer()
        yield lambda stage, share, _: show_line(stage, share)
        return
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[best]}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("planning", total=1.0, best="")

        def show(stage: str, share: float, best: float) -> None:
            """Draw stage and share of the search, and the smallest error so far [m].

            Infinite or NaN: no error is known yet.
            """
            best_text = f"best so far {best * 1e3:.4g} mm" if math.isfinite(best) else ""
            bar.update(task, description=stage, completed=share, best=best_text)

        yield show
