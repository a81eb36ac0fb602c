"""`postproc convert` and `postproc predict`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from postproc.cli.options import complete_files, conversion_options, pop_file_options, shared_options
from postproc.cli.outcomes import work
from postproc.cli.piping import convert_piped, is_piped

if TYPE_CHECKING:
    from postproc.jobs import Job
    from postproc.jobs.workers import Cluster

_PATH = click.Path(path_type=Path)


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
    **options: Any,
) -> None:
    """Write corrected KRL and a report for each PROGRAM.

    PROGRAM is a file, a folder or a pattern such as "parts/*.nc". G-code: .nc .ngc .tap .cnc .gcode .mpf .ptp; APT:
    .apt .aptsource .cls .clsf .cl .clf .ncl .cldata; KRL: .src, with its .dat. For part.nc this writes part.src,
    part.report.json, part.targets.csv and part.report.html, all or none of them. An input is never overwritten; a file
    that was not written by postproc, or was changed since, with --overwrite only. A name that KRL does not allow is
    made valid (1001.nc: P1001.src). If a program can no longer be converted, its files of an earlier run are renamed to
    part.src.old and so on. PROGRAM - is stdin, with --dialect; the written program then goes to stdout, as with -o -.

    \b
    Examples:
      postproc convert samples/pocket.nc --cell samples/cell_kr270.toml -o out
      postproc convert samples/freeform.nc --cell samples/cell_kr270.toml --forces samples/freeform.forces.csv
      postproc convert samples/plate.nc --cell samples/cell_kr270.toml --process samples/plate.process.toml
      postproc convert "parts/*.nc" --cell cell.toml --forces forces/ --jobs 4
      postproc convert samples/pocket.nc --cell samples/cell_irb6700.toml --to rapid -o out_abb
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.jobs import Settings, find_jobs

    cluster = _cluster(
        options.pop("scheduler"), (options.pop("tls_ca"), options.pop("tls_cert"), options.pop("tls_key"))
    )
    if cluster is not None and jobs > 1:
        raise click.UsageError("--jobs and --scheduler exclude each other.")
    if options["forces"] is not None and len(programs) > 1 and options["forces"].is_file():
        raise click.UsageError(
            "--forces FILE goes with one program: its line numbers belong to one. Give a folder that holds NAME.csv "
            "for each program, or write the forces into the programs as comments."
        )
    if is_piped(programs, options["output"]) and len(programs) == 1:
        if as_json or cluster is not None:
            raise click.UsageError("--json and --scheduler do not go with -.")
        files = pop_file_options(options)
        settings = Settings(mode="nominal" if nominal else "convert", **options)
        ctx.exit(convert_piped(programs[0], settings, files, name).code)
    programs_to_do = find_jobs(programs, name=name, **pop_file_options(options))
    _check_part(options, programs_to_do)
    if name is not None and (fault := programs_to_do[0].writer.fault_of(name)) is not None:
        raise click.BadParameter(f"the controller does not accept {name!r}: {fault}.", param_hint="--name")
    settings = Settings(mode="nominal" if nominal else "convert", **options)
    work(ctx, programs_to_do, settings, as_json=as_json, workers=jobs, cluster=cluster)


def _check_part(options: dict[str, Any], jobs: Sequence[Job]) -> None:
    """Check that the mesh of a part is given with one program only; called subprograms do not count.

    :raises click.UsageError: there are several programs.
    """
    if options["part"] is not None and sum(not job.callers for job in jobs) > 1:
        raise click.UsageError("--part goes with one program.")


def _cluster(scheduler: str | None, certificates: tuple[Path | None, Path | None, Path | None]) -> Cluster | None:
    """Return the Dask cluster that the options name; None without a scheduler.

    :param scheduler: address of the scheduler.
    :param certificates: files of authority, certificate and key; None: not given.
    :raises click.UsageError: a certificate is given without a scheduler.
    """
    if scheduler is not None:
        from postproc.jobs.workers import Cluster

        ca, certificate, key = certificates
        return Cluster(scheduler, ca=ca, certificate=certificate, key=key)
    if any(certificates):
        raise click.UsageError("--tls-ca, --tls-cert and --tls-key go with --scheduler tls://…")
    return None


@click.command()
@click.argument("program", shell_complete=complete_files)
@shared_options
@click.pass_context
def predict(ctx: click.Context, /, program: str, as_json: bool, **options: Any) -> None:
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

    programs_to_do = find_jobs([program], **pop_file_options(options))
    if sum(not job.callers for job in programs_to_do) > 1:
        raise click.UsageError(f"predict takes one program; {program} names {len(programs_to_do)}.")
    _check_part(options, programs_to_do)
    work(ctx, programs_to_do, Settings(mode="predict", **options), as_json=as_json)
