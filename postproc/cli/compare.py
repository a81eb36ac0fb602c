"""`postproc compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from postproc.cli import options

_PATH = click.Path(path_type=Path)


@click.command()
@click.argument("nominal", type=_PATH)
@click.argument("corrected", type=_PATH)
@click.option("--cell", type=_PATH, required=True, help="Cell file: robot, base, tool, tolerances.")
@click.option(
    "--forces",
    type=_PATH,
    help="File of cutting forces (CSV, or what a package adds), by lines of NOMINAL, or process.toml.",
)
@click.option(
    "--keep-unresolved",
    is_flag=True,
    help="Read KRL with motions that are known at run time only: they are listed as not compared.",
)
@click.option("-o", "--output", type=_PATH, help="Folder to write into; default: corrected/ in the folder of NOMINAL.")
@options.dialect_of_either_program
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
@options.overwrite
@click.pass_context
def compare(ctx: click.Context, /, as_json: bool, **request: Any) -> None:
    """Compare CORRECTED with NOMINAL, target by target.

    Reports the offsets of the targets, and what each program would cut. NOMINAL is G-code or a robot program, CORRECTED
    a robot program: of postproc, of another post-processor, or edited by hand. What each would cut needs forces: from
    --forces, from comments in NOMINAL, or from those in CORRECTED. Reports whether CORRECTED is as postproc wrote it.
    For part.src this writes part.compare.report.json, part.compare.pairs.csv and part.compare.report.html.

    The exit code is 3 when a tolerance is exceeded, when a target of NOMINAL is left out, or when CORRECTED was changed
    since postproc wrote it.

    \b
    Example:
      postproc convert samples/pocket.nc --cell samples/cell_kr270.toml -o out
      postproc compare samples/pocket.nc out/pocket.src --cell samples/cell_kr270.toml -o out
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.cli.terminal import display
    from postproc.jobs.comparison_files import CompareRequest, compare_programs
    from postproc.report.comparison import comparison_text

    comparison = compare_programs(CompareRequest(**request))
    if as_json:
        report = comparison.written_files[-1]  # part.compare.report.json
        click.echo(report.read_text(encoding="utf-8"), nl=False)
    else:
        click.echo(comparison_text(comparison.summary, display()))
        names = ", ".join(path.name for path in comparison.written_files)
        click.echo(f"written to {comparison.written_files[0].parent}: {names}")
    ctx.exit(comparison.code)
