"""`postproc app`."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("folder", type=click.Path(path_type=Path), default=".")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port of 127.0.0.1; default: one that is free.")
@click.option("--no-open", is_flag=True, help="Print the address, and do not open a browser.")
@click.pass_context
def app(ctx: click.Context, /, folder: Path, port: int, no_open: bool) -> None:
    """Open a window in the browser: programs and results.

    FOLDER has the programs; results are in its folder corrected/. The window is for this machine only, by an address
    with a secret that is new at each start. A program that arrives in the folder is corrected by itself, as soon as
    the cell and its process are there; a switch on the page turns that off. Each page shows the command that does the
    same. Ctrl-C ends the window, and stops what runs; results that are written stay whole.

    \b
    Examples:
      postproc app
      postproc app parts
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.app.server import Window

    with Window(folder, port) as window:
        click.echo(f"The window is at\n  {window.access.address}\nKeep this address to yourself. Ctrl-C ends it.")
        if not no_open:
            click.launch(window.access.address)
        window.automatic.start()
        try:
            window.serve_forever()
        except KeyboardInterrupt as cause:
            click.echo("ended.")
            ctx.exit(128 + getattr(cause, "number", 2))
        finally:
            window.automatic.stop()
            window.runs.stop_all()
