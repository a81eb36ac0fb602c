"""`postproc watch`."""

from __future__ import annotations

from glob import has_magic
from pathlib import Path
from threading import Event, Thread
from typing import Any

import click

from postproc.cli.options import conversion_options, pop_file_options


@click.command()
@click.argument("folder", type=click.Path(path_type=Path), metavar="FOLDER")
@conversion_options
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Programs at the same time.")
@click.option(
    "--serve", is_flag=True, help="Show the overview of the output folder in a browser, on this machine only."
)
@click.option("--port", type=click.IntRange(0, 65535), default=8350, show_default=True, help="Port of --serve.")
@click.pass_context
def watch(
    ctx: click.Context, /, folder: Path, jobs: int, serve: bool, port: int, as_json: bool, **options_of_command: Any
) -> None:
    """Convert programs as they arrive in FOLDER, until Ctrl-C.

    FOLDER is a folder, or a pattern such as "parts/*.prg": with --dialect its files need no known extension. A program
    is converted when it has not changed for a second. Programs that have been converted before are left as they are,
    also after a restart. Subfolders are not watched. Network drives may be watched. With --serve, http://127.0.0.1:8350
    shows the overview, which reloads itself; other machines cannot open it. With --json each program is one line of
    JSON.

    \b
    Examples:
      postproc watch parts --cell cell.toml
      postproc watch parts --cell cell.toml -o corrected --process process.toml --jobs 2 --serve
      postproc watch "parts/*.prg" --cell cell.toml --dialect rapid
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.cli.outcomes import print_outcome, say
    from postproc.jobs import Settings
    from postproc.jobs.watching import server
    from postproc.jobs.watching import watch as watched

    options = pop_file_options(options_of_command)
    pattern = None
    if has_magic(folder.name) and not folder.is_dir():
        folder, pattern = folder.parent, folder.name
    output = options.pop("output", None) or folder / "corrected"
    stop = Event()
    settings = Settings(mode="convert", **options_of_command)
    outcomes = watched(folder, output, settings, options, pattern=pattern, workers=jobs, say=say, stop=stop)
    if serve:
        page_server = server(output, port)
        Thread(target=page_server.serve_forever, daemon=True).start()
        click.echo(f"overview: http://127.0.0.1:{page_server.server_address[1]}", err=as_json)
    click.echo(
        f"watching {folder if pattern is None else folder / pattern}; results: {output}. Ctrl-C ends it.", err=as_json
    )
    try:
        for outcome, job in outcomes:
            print_outcome(outcome, job, as_json=as_json)
    except KeyboardInterrupt as cause:
        click.echo("ended.", err=as_json)
        ctx.exit(128 + getattr(cause, "number", 2))
