"""`postproc plan`."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from postproc.cell import Cell
    from postproc.plan.milling import TestPoses
    from postproc.plan.planning import Progress
    from postproc.robot import RobotModel

_PATH = click.Path(path_type=Path)


@click.command()
@click.option("--experiment", type=_PATH, required=True, help="How it is measured: experiment.toml with [rig].")
@click.option("--cell", type=_PATH, required=True, help="Cell file of the programs.")
@click.option(
    "--program", "programs", multiple=True, metavar="PROGRAM...", help="What will be milled: files, folders, patterns."
)
@click.argument("more", nargs=-1, metavar="[PROGRAM]...")
@click.option("--forces", type=_PATH, help="CSV file of cutting forces, or a folder with NAME.csv for each program.")
@click.option(
    "--poses", type=_PATH, help="Test poses by hand instead: CSV A1…A6,Fx,Fy,Fz[,weight] (deg; N, root axes)."
)
@click.option("--measured", type=_PATH, help="What was measured so far; the plan says what to measure next.")
@click.option("--configurations", type=click.IntRange(1, 200), default=15, show_default=True, help="Poses to measure.")
@click.option("--q2-levels", type=click.IntRange(1, 20), default=5, show_default=True, help="Levels of A2 among them.")
@click.option("--grouped", is_flag=True, help="The criterion as printed: each level of A2 identified alone.")
@click.option(
    "--test-poses", type=click.IntRange(1, 500), default=20, show_default=True, help="Poses that stand for all."
)
@click.option("--repeats", type=click.IntRange(1, 100), default=3, show_default=True, help="Readings of each point.")
@click.option("--margin", type=click.FloatRange(0, 60), default=5.0, show_default=True, help="To joint limits, in deg.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same plan.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
@click.option("--overwrite", is_flag=True, help="Replace files that postproc did not write, or not as they are.")
@click.option("-o", "--output", type=_PATH, required=True, help="CSV file to write; .src, .html and .json beside it.")
def plan(
    experiment: Path,
    cell: Path,
    programs: tuple[str, ...],
    more: tuple[str, ...],
    forces: Path | None,
    poses: Path | None,
    measured: Path | None,
    configurations: int,
    q2_levels: int,
    grouped: bool,
    test_poses: int,
    repeats: int,
    margin: float,
    seed: int,
    as_json: bool,
    overwrite: bool,
    output: Path,
) -> None:
    """Choose poses and loads whose measurement identifies the robot best for the work at hand.

    The plan makes the error that remains after compensation smallest where the PROGRAMs mill, under their forces. For
    plan.csv this writes plan.csv (config,A1…A6,Fx,Fy,Fz: deg; N, root axes, at the load point; in the order of least
    travel), plan.src (KRL that visits the poses and waits), plan.html (poses drawn, expected accuracy, comparison with
    other plans) and plan.json. Ctrl-C ends the search and writes the best plan so far.

    --program takes several: --program a.nc b.nc. Each counts the same.

    \b
    Examples:
      postproc plan --experiment experiment.toml --cell cell.toml --program part.nc -o plan.csv
      postproc plan --experiment experiment.toml --cell cell.toml --program "parts/*.nc" --forces forces/ \\
          --configurations 20 --q2-levels 6 --seed 7 -o plan.csv
      postproc plan --experiment experiment.toml --cell cell.toml --poses tests.csv --grouped -o plan.csv
      postproc plan --experiment experiment.toml --cell cell.toml --program part.nc \\
          --measured measurements.csv --configurations 4 -o next.csv
    """  # noqa: D301 - click: keep these lines as they are
    from postproc import cell as cells
    from postproc import interrupts
    from postproc import robot as robots
    from postproc.dialects.krl.language.names import valid
    from postproc.files import foreign, refuse, with_record, write_whole
    from postproc.frames import RAD_PER_DEG
    from postproc.identification.experiment import read_experiment
    from postproc.identification.readings import read
    from postproc.plan import Options, plan_measurements
    from postproc.plan.krl_program import krl_program
    from postproc.plan.site import site_of
    from postproc.report.plan import plan_page
    from postproc.report.plan_data import plan_csv, plan_json

    programs += more  # --program a.nc b.nc
    if (poses is None) == (not programs):
        raise click.UsageError("Give either --program (one or several) or --poses.")
    if output.suffix.lower() != ".csv":
        raise click.BadParameter("give a file that ends in .csv", param_hint="-o")
    setup = read_experiment(experiment)
    place = cells.load(cell)
    model = robots.load(robots.find(setup.robot, experiment.parent))
    _check_same_robot(model, robots.load(robots.find(place.robot, cell.parent)))
    site = site_of(model, setup, experiment.parent, margin * RAD_PER_DEG)
    tests = _test_poses(programs, forces, poses, model, place)
    data = None if measured is None else read(measured, setup)
    names = csv, src, html, record = (
        output.name,
        f"{valid(output.stem)}.src",
        f"{output.stem}.html",
        f"{output.stem}.json",
    )
    _protect(output.parent, names, [experiment, cell, *filter(None, (forces, poses, measured)), *map(Path, programs)])
    if not overwrite:
        refuse(foreign(output.parent, names, record))
    options = Options(configurations, q2_levels, seed, grouped, test_poses, repeats)
    with interrupts.ending_a_search(), _shown() as progress:
        result = plan_measurements(site, setup.sigma, tests, place, options, data, progress)
    contents: dict[str, bytes | Iterable[bytes]] = {
        csv: plan_csv(result),
        src: krl_program(result, place, PurePath(src).stem).to_bytes(),
        html: plan_page(result, output.stem),
    }
    written = write_whole(output.parent, with_record(contents, record, lambda files: plan_json(result, files)))
    for warning in result.warnings:
        click.echo(f"warning: {warning}", err=True)
    if as_json:
        click.echo((output.parent / record).read_text(encoding="utf-8"), nl=False)
        return
    from postproc.report.plan_data import plan_lines

    for line in plan_lines(result):
        click.echo(line)
    click.echo("written: " + ", ".join(str(path) for path in written))


def _test_poses(
    programs: tuple[str, ...], forces: Path | None, poses: Path | None, model: RobotModel, cell: Cell
) -> TestPoses:
    from postproc.correction.process import read
    from postproc.forces import read_force_csv
    from postproc.jobs.inputs import find_jobs, read_documents
    from postproc.plan import milling

    if poses is not None:
        return milling.from_file(poses, model, cell)
    parts = []
    for job in find_jobs(programs, forces=forces):
        program = read(read_documents(job.program, job.dialect), model, cell, job.program.stem, job.dialect)
        rows = None if job.forces is None else read_force_csv(job.forces)
        parts.append(milling.from_program(program, model, cell, rows))
    return milling.joined(parts)


def _check_same_robot(measured: RobotModel, milling: RobotModel) -> None:
    """Experiment and cell may name different models (priors, identified ones), but of one arm."""
    from postproc.errors import InputError

    one, other = measured.nominal, milling.nominal
    if abs(one.placement - other.placement).max() > 1e-6 or abs(one.axis - other.axis).max() > 1e-6:
        raise InputError(
            f"the experiment is with robot {measured.name}, the cell has {milling.name}, an arm of other dimensions",
            advice="Plan the measurements for the robot that mills.",
        )


def _protect(folder: Path, names: Iterable[str], inputs: list[Path]) -> None:
    """No input may be overwritten."""
    from postproc.errors import InputError

    taken = {str(path.resolve()).lower() for path in inputs}
    for name in names:
        target = folder / name
        if str(target.resolve()).lower() in taken:
            raise InputError("this input would be overwritten", file=str(target), advice="Choose another -o.")


@contextlib.contextmanager
def _shown() -> Iterator[Progress | None]:
    """Show progress on a terminal; none when the output goes elsewhere."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[best]}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("planning", total=1.0, best="")

        def tell(stage: str, share: float, best: float) -> None:
            shown = f"best so far {best * 1e3:.4g} mm" if math.isfinite(best) else ""
            bar.update(task, description=stage, completed=share, best=shown)

        yield tell
