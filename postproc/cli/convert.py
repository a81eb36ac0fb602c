"""`postproc convert` and `postproc predict`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from postproc.batch import Job, Outcome, Settings

_PATH = click.Path(path_type=Path)
_DIALECT = click.Choice(["gcode", "krl"])
_Command = TypeVar("_Command", bound=Callable[..., Any])


def _shared(command: _Command) -> _Command:
    """Add the options that convert and predict share."""
    for option in (
        click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON."),
        click.option("--dialect", type=_DIALECT, help="How to read the input; by default the extension says it."),
        click.option(
            "-o", "--output", type=_PATH, help="Folder to write into; default: corrected/ beside the program."
        ),
        click.option(
            "--forces", type=_PATH, help="CSV file of cutting forces, or a folder with NAME.csv for each program."
        ),
        click.option("--cell", type=_PATH, required=True, help="Cell file: robot, base, tool, tolerances."),
    ):
        command = option(command)
    return command


def _finite(_ctx: click.Context, _param: click.Parameter, value: float | None) -> float | None:
    if value is not None and not (math.isfinite(value) and value > 0.0):
        raise click.BadParameter("give a length in mm, larger than 0")
    return value


@click.command()
@click.argument("programs", nargs=-1, required=True, metavar="PROGRAM...")
@_shared
@click.option("--nominal", is_flag=True, help="Write the KRL without correction, to compare against.")
@click.option(
    "--tolerance",
    type=float,
    callback=_finite,
    metavar="MM",
    help="What the predicted path may leave the nominal one by; replaces tolerance_mm of the cell.",
)
@click.option("--linearize-arcs", is_flag=True, help="Write arcs as lines.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Programs at the same time.")
@click.option("--scheduler", metavar="ADDRESS", help="Work on a Dask cluster, e.g. tcp://10.0.0.5:8786.")
@click.pass_context
def convert(
    ctx: click.Context,
    programs: tuple[str, ...],
    cell: Path,
    forces: Path | None,
    output: Path | None,
    dialect: str | None,
    nominal: bool,
    tolerance: float | None,
    linearize_arcs: bool,
    jobs: int,
    scheduler: str | None,
    as_json: bool,
) -> None:
    """Write corrected KRL and a report for each PROGRAM.

    PROGRAM is a file, a folder or a pattern such as "parts/*.nc". G-code: .nc .ngc .tap .cnc .gcode .mpf .ptp; KRL:
    .src, with the .dat beside it. For part.nc this writes part.src, part.report.json, part.targets.csv and
    part.report.html, all or none of them; an input is never overwritten.

    \b
    Examples:
      postproc convert samples/pocket.nc --cell samples/cell_kr270.toml -o out
      postproc convert samples/freeform.nc --cell samples/cell_kr270.toml --forces samples/freeform.forces.csv
      postproc convert "parts/*.nc" --cell cell.toml --forces forces/ --jobs 4
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.batch import Settings, find_jobs

    if scheduler is not None and jobs > 1:
        raise click.UsageError("--jobs and --scheduler exclude each other.")
    if forces is not None and len(programs) > 1 and forces.is_file():
        raise click.UsageError(
            "--forces FILE goes with one program: its line numbers belong to one. Give a folder that holds NAME.csv "
            "for each program, or write the forces into the programs as comments."
        )
    found = find_jobs(programs, dialect=dialect, forces=forces, output=output, cell=cell)
    settings = Settings(cell, "nominal" if nominal else "convert", tolerance, linearize_arcs)
    outcomes = _worked(ctx, found, settings, workers=jobs, scheduler=scheduler)
    _report(outcomes, found, as_json=as_json)
    ctx.exit(_worst(outcomes))


@click.command()
@click.argument("program")
@_shared
@click.pass_context
def predict(
    ctx: click.Context,
    program: str,
    cell: Path,
    forces: Path | None,
    output: Path | None,
    dialect: str | None,
    as_json: bool,
) -> None:
    """Predict how far the tool leaves the path of PROGRAM as it stands; nothing is corrected.

    Writes NAME.report.json, NAME.targets.csv and NAME.report.html.

    \b
    Example:
      postproc predict samples/pocket.nc --cell samples/cell_kr270.toml -o out
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.batch import Settings, find_jobs

    found = find_jobs([program], dialect=dialect, forces=forces, output=output, cell=cell, writes_programs=False)
    if len(found) > 1:
        raise click.UsageError(f"predict takes one program; {program} names {len(found)}.")
    outcomes = _worked(ctx, found, Settings(cell, "predict"))
    _report(outcomes, found, as_json=as_json)
    ctx.exit(_worst(outcomes))


def _worked(
    ctx: click.Context,
    jobs: Sequence[Job],
    settings: Settings,
    *,
    workers: int = 1,
    scheduler: str | None = None,
) -> list[Outcome]:
    """Return the outcomes in the order of the jobs; an interrupt ends the command and says what is there."""
    from postproc.batch import convert_all

    known: dict[str, Outcome] = {}
    outcomes = convert_all(jobs, settings, workers=workers, scheduler=scheduler)
    try:
        for outcome in _with_progress(outcomes, len(jobs)):
            known[outcome.program] = outcome
    except KeyboardInterrupt:
        done = [outcome for outcome in known.values() if outcome.written]
        rest = "of the others nothing is" if scheduler is None else "the cluster may still finish those it has begun"
        click.echo(f"Interrupted: {len(done)} of {len(jobs)} programs are written, and whole; {rest}.", err=True)
        ctx.exit(130)
    return [known[str(job.program)] for job in jobs]


def _with_progress(outcomes: Iterable[Outcome], count: int) -> Iterator[Outcome]:
    """Pass outcomes on; on a terminal show how far the work is, on stderr."""
    import sys

    if not sys.stderr.isatty():
        yield from outcomes
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("programs", total=count)
        for outcome in outcomes:
            progress.update(task, advance=1, description=Path(outcome.program).name)
            yield outcome


def _report(outcomes: Sequence[Outcome], jobs: Sequence[Job], *, as_json: bool) -> None:
    """Print what came of the programs: summary on stdout, what failed on stderr."""
    from postproc import report
    from postproc.report import issue_entry, issue_line

    for outcome in outcomes:
        if outcome.message:
            click.echo(f"Error: {outcome.message}", err=True)
        for issue in outcome.issues:
            click.echo(issue_line(issue_entry(issue), outcome.program), err=True)
        if outcome.issues:
            click.echo(f"Error: {outcome.program}: nothing is written.", err=True)
    if as_json:
        content = {"exit_code": _worst(outcomes), "programs": [_as_entry(outcome) for outcome in outcomes]}
        click.echo(report.to_json(content).decode(), nl=False)
    elif len(outcomes) == 1 and outcomes[0].summary is not None:
        click.echo(report.of_one(outcomes[0].summary))
        names = ", ".join(Path(path).name for path in outcomes[0].written)
        click.echo(f"written to {jobs[0].output}: {names}")
    elif len(outcomes) > 1:
        click.echo(report.of_many([(outcome.program, outcome.summary, _word(outcome)) for outcome in outcomes]))


def _as_entry(outcome: Outcome) -> dict[str, object]:
    from postproc.report import issue_entry

    entry: dict[str, object] = {"program": outcome.program, "exit_code": outcome.code}
    if outcome.summary is not None:
        entry |= {**outcome.summary, "program": outcome.program}
    else:
        entry |= {"error": outcome.message, "issues": [issue_entry(issue) for issue in outcome.issues]}
    return {**entry, "written": list(outcome.written)}


def _word(outcome: Outcome) -> str:
    if outcome.summary is None:
        return "FAILED"
    warnings = sum(issue["level"] == "warning" for issue in outcome.summary["issues"])
    word = "tolerance exceeded" if outcome.code else "written"
    return word + (f", {warnings} warning{'s' if warnings > 1 else ''}" if warnings else "")


def _worst(outcomes: Iterable[Outcome]) -> int:
    """Return the exit code for all: a failure is worse than an exceeded tolerance."""
    codes = {outcome.code for outcome in outcomes}
    return 1 if 1 in codes else max(codes, default=0)
