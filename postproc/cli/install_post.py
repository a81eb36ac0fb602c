"""`postproc install-post`: put the post of a CAM host where the host looks for it."""

from __future__ import annotations

from pathlib import Path

import click

from postproc.cli.options import Choice


@click.command("install-post")
@click.argument("host", type=Choice(["freecad", "robodk"]))
@click.option("--dir", "folder", type=click.Path(path_type=Path), help="Folder of posts; default: the usual one.")
@click.option("--remove", is_flag=True, help="Remove the post instead.")
def install_post(host: str, folder: Path | None, remove: bool) -> None:
    """Install a post in the folder of FreeCAD or RoboDK.

    Prints the written files. The post runs the postproc that installed it, independent of the Python of the host.
    Installed from WSL into a Windows folder, it runs postproc through wsl.

    \b
    Examples:
      postproc install-post freecad
      postproc install-post robodk --dir C:/RoboDK/Posts
      postproc install-post freecad --remove
    """  # noqa: D301 - click: keep these lines as they are
    from postproc import hosts

    if remove:
        paths = hosts.remove_post(host, folder)
        click.echo("\n".join(f"removed {path}" for path in paths) or f"there is no post of postproc for {host}")
        return
    click.echo("\n".join(f"written {path}" for path in hosts.install_post(host, folder)))
    click.echo(hosts.HOSTS[host].use)
