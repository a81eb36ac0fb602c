"""`postproc convert` and `postproc predict`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from postproc.cli.options import complete_files, overwrite
from postproc.cli.outcomes import work

if TYPE_CHECKING:
    from postproc.jobs import Job
    from postproc.jobs.workers import Cluster

_PATH = click.Path(path_type=Path)
_Command = TypeVar("_Command", bound=Callable[..., Any])


def _dialect(_ctx: click.Context, _param: click.Parameter, value: str | None) -> str | None:
    from postproc.dialects import registry
    from postproc.errors import InputError

    try:
        return None if value is None else registry.by_name(value).name
    except InputError as cause:
        raise click.BadParameter(str(cause)) from None


def _finite(_ctx: click.Context, _param: click.Parameter, value: float | None) -> float | None:
    if value is not None and not (math.isfinite(value) and value > 0.0):
        raise click.BadParameter("give a length in mm, larger than 0")
    return value


def shared_options(command: _Command) -> _Command:
    """Add the options that convert and predict share."""
    for option in (
        overwrite,
        click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON."),
        click.option(
            "--dialect",
            metavar="NAME",
            callback=_dialect,
            help="Format of the input: apt, gcode, krl or rapid; default: by the extension.",
        ),
        click.option(
            "-o",
            "--output",
            type=_PATH,
            help="Folder to write into; default: corrected/ in the folder of the program.",
        ),
        click.option(
            "--keep-unresolved",
            is_flag=True,
            help="Leave KRL motions unchanged whose targets, or whether they run, are only known at run time.",
        ),
        click.option(
            "--part-tolerance",
            "part_tolerance_mm",
            type=float,
            callback=_finite,
            metavar="MM",
            help="What the part may be off (95 %), by which the verdict judges; replaces tolerance_mm of [part].",
        ),
        click.option("--part", type=_PATH, help="Mesh of the part (STL …, mm, $BASE): shows what its surface will be."),
        click.option(
            "--forces",
            type=_PATH,
            help="File of cutting forces (CSV, or what a package adds), or a folder with NAME.csv … for each program.",
        ),
        click.option(
            "--process", type=_PATH, help="Material, tools and stock, from which the forces are computed: process.toml."
        ),
        click.option("--cell", type=_PATH, required=True, help="Cell file: robot, base, tool, tolerances."),
    ):
        command = option(command)
    return command


def conversion_options(command: _Command) -> _Command:
    """Add the options that convert and watch share."""
    for option in (
        click.option("--linearize-arcs", is_flag=True, help="Write arcs as lines."),
        click.option(
            "--to", metavar="NAME", callback=_dialect, help="Language to write G-code in: krl (default) or rapid."
        ),
        click.option(
            "--lines-per-file",
            type=click.IntRange(min=0),
            metavar="N",
            help="Divide KRL of more lines, 0: never; replaces lines_per_file of the cell.",
        ),
        click.option(
            "--tolerance",
            "tolerance_mm",
            type=float,
            callback=_finite,
            metavar="MM",
            help="What the predicted path may leave the nominal one by; replaces tolerance_mm of the cell.",
        ),
    ):
        command = option(command)
    return shared_options(command)


@click.command()
@click.argument("programs", nargs=-1, required=True, metavar="PROGRAM...", shell_complete=complete_files)
@conversion_options
@click.option("--nominal", is_flag=True, help="Write the KRL without correction, to compare against.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Programs at the same time.")
@click.option("--name", metavar="NAME", help="Name of the written program, for one PROGRAM.")
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Work on a Dask cluster, e.g. tls://10.0.0.5:8786. A scheduler and its workers execute whatever anybody sends "
    "them: use tcp:// on a trusted network only, tls:// elsewhere.",
)
@click.option("--tls-ca", type=_PATH, help="For tls://: the authority's certificate; default: Dask's configuration.")
@click.option("--tls-cert", type=_PATH, help="For tls://: certificate to show.")
@click.option("--tls-key", type=_PATH, help="For tls://: key of the certificate.")
@click.pass_context
def convert(
    ctx: click.Context,
    /,
    programs: tuple[str, ...],
    jobs: int,
    nominal: bool,
    name: str | None,
    as_json: bool,
    **more: Any,
) -> None:
    """Write corrected KRL and a report for each PROGRAM.

    PROGRAM is a file, a folder or a pattern such as "parts/*.nc". G-code: .nc .ngc .tap .cnc .gcode .mpf .ptp; APT:
    .apt .aptsource .cls .clsf .cl .clf .ncl .cldata; KRL: .src, with its .dat. For part.nc this writes part.src,
    part.report.json, part.targets.csv and part.report.html, all or none of them. An input is never overwritten; a file
    that was not written by postproc, or was changed since, with --overwrite only. A name that KRL does not allow is
    made valid (1001.nc: P1001.src). If a program can no longer be converted, its files of an earlier run are renamed to
    part.src.old and so on.

    \b
    Examples:
      postproc convert samples/pocket.nc --cell samples/cell_kr270.toml -o out
      postproc convert samples/freeform.nc --cell samples/cell_kr270.toml --forces samples/freeform.forces.csv
      postproc convert samples/plate.nc --cell samples/cell_kr270.toml --process samples/plate.process.toml
      postproc convert "parts/*.nc" --cell cell.toml --forces forces/ --jobs 4
      postproc convert samples/pocket.nc --cell samples/cell_irb6700.toml --to rapid -o out_abb
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.jobs import Settings, find_jobs

    cluster = _cluster(more.pop("scheduler"), *(more.pop(f"tls_{file}") for file in ("ca", "cert", "key")))
    if cluster is not None and jobs > 1:
        raise click.UsageError("--jobs and --scheduler exclude each other.")
    if more["forces"] is not None and len(programs) > 1 and more["forces"].is_file():
        raise click.UsageError(
            "--forces FILE goes with one program: its line numbers belong to one. Give a folder that holds NAME.csv "
            "for each program, or write the forces into the programs as comments."
        )
    found = find_jobs(programs, name=name, **of_files(more))
    _check_part(more, found)
    if name is not None and (fault := found[0].writer.fault_of(name)) is not None:
        raise click.BadParameter(f"the controller does not accept {name!r}: {fault}.", param_hint="--name")
    settings = Settings(mode="nominal" if nominal else "convert", **more)
    work(ctx, found, settings, as_json=as_json, workers=jobs, cluster=cluster)


def of_files(options: dict[str, Any]) -> dict[str, Any]:
    """Move the options of `find_jobs` (dialect, target language, forces, output) out of the options of a run.

    The process file becomes the force file. All other options stay: they are the settings.
    """
    process = options.pop("process")
    if process is not None:
        if options["forces"] is not None:
            raise click.UsageError("--forces and --process exclude each other.")
        if process.suffix.lower() != ".toml":
            raise click.BadParameter(f"{process} is no .toml file.", param_hint="--process")
        options["forces"] = process
    return {name: options.pop(name) for name in ("dialect", "to", "forces", "output") if name in options}


def _check_part(options: dict[str, Any], jobs: Sequence[Job]) -> None:
    if options["part"] is not None and sum(not job.callers for job in jobs) > 1:
        raise click.UsageError("--part goes with one program.")


def _cluster(scheduler: str | None, *certificates: Path | None) -> Cluster | None:
    if scheduler is not None:
        from postproc.jobs.workers import Cluster

        return Cluster(scheduler, *certificates)
    if any(certificates):
        raise click.UsageError("--tls-ca, --tls-cert and --tls-key go with --scheduler tls://…")
    return None


@click.command()
@click.argument("program", shell_complete=complete_files)
@shared_options
@click.pass_context
def predict(ctx: click.Context, /, program: str, as_json: bool, **more: Any) -> None:
    """Predict how far the tool leaves the path of PROGRAM.

    Nothing is corrected. For part.nc this writes part.predict.report.json,
    part.predict.targets.csv and part.predict.report.html. With --process, force and deflection are iterated: the tool
    cuts at its deflected position.

    \b
    Examples:
      postproc predict samples/pocket.nc --cell samples/cell_kr270.toml -o out
      postproc predict samples/plate.nc --cell samples/cell_kr270.toml --process samples/plate.process.toml
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.jobs import Settings, find_jobs

    found = find_jobs([program], **of_files(more))
    if sum(not job.callers for job in found) > 1:
        raise click.UsageError(f"predict takes one program; {program} names {len(found)}.")
    _check_part(more, found)
    work(ctx, found, Settings(mode="predict", **more), as_json=as_json)
