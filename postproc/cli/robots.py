"""`postproc robots`: list the robot models, show one with the source of each number, add one."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from postproc.cli.options import complete_robots

_PATH = click.Path(path_type=Path)


class _Robots(click.Group):
    """Group whose default command is `show`: `robots NAME` is `robots show NAME`."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return name, command and remaining arguments, as click does.

        A first word that is no command is the name of a robot: ``robots NAME`` is ``robots show NAME``.
        """
        if args[0] not in self.commands:
            args = ["show", *args]
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Return the names of robots and of commands that begin with `incomplete`."""
        return [*complete_robots(ctx, None, incomplete), *super().shell_complete(ctx, incomplete)]


@click.group(cls=_Robots, invoke_without_command=True, subcommand_metavar="[NAME] | COMMAND [ARGS]...")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
@click.pass_context
def robots(ctx: click.Context, /, as_json: bool) -> None:
    """List the robot models, show one, or add one.

    NAME is the name of a shipped robot or the path of a model folder.

    \b
    Examples:
      postproc robots
      postproc robots kuka_kr270
      postproc robots my_robot/ --json
    """  # noqa: D301 - click: keep these lines as they are
    if ctx.invoked_subcommand is not None:
        return
    from postproc import robot
    from postproc.cli.terminal import display

    models = {name: robot.load(folder) for name, folder in robot.shipped_models().items()}
    if as_json:
        click.echo(json.dumps({name: model.title for name, model in models.items()}, indent=2))
        return
    rows = []
    for name, model in models.items():
        count = sum(entry.assumed for entry in model.sources)
        rows.append((name, model.title, f"{count} of {len(model.sources)} assumed"))
    click.echo(display().table(("name", "robot", "values"), rows))


@robots.command()
@click.argument("name", shell_complete=complete_robots)
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def show(name: str, as_json: bool) -> None:
    """Show a robot model with the source of each value.

    \b
    Example:
      postproc robots show kuka_kr270
    """  # noqa: D301 - click: keep these lines as they are
    from postproc import robot
    from postproc.cli.terminal import display

    model = robot.load(robot.find(name))
    if as_json:
        values = [
            {"name": entry.name, "value": entry.value, "source": entry.source, "assumed": entry.assumed}
            for entry in model.sources
        ]
        content = {"name": model.name, "title": model.title, "values": values}
        click.echo(json.dumps(content, indent=2, ensure_ascii=False))
        return
    click.echo(f"{model.title} ({model.name})\n")
    rows = [(entry.name, entry.value, "ASSUMED" if entry.assumed else "", entry.source) for entry in model.sources]
    click.echo(display().table(("", "value", "", "source"), rows))
    click.echo("\n" + click.wrap_text(f"{robot.WITH_LINKS}.", shutil.get_terminal_size().columns))


@robots.command()
@click.argument("urdf", type=_PATH)
@click.option("--name", help="Name of the robot in reports; default: the name in the URDF.")
@click.option("-o", "--output", type=_PATH, metavar="DIR", help="Model folder to write; default: NAME.")
@click.option("--overwrite", is_flag=True, help="Replace an existing model.")
def add(urdf: Path, name: str | None, output: Path | None, overwrite: bool) -> None:
    """Make a model folder from the URDF of a KUKA arm.

    Joints may have any names, signs and zero positions (joint_1, joint_a1 …): they become A1 to A6 as KUKA counts them.
    `base` or base_link is the root, tool0 or flange the flange. Geometry, limits, speeds and masses are taken over;
    compliances are assumed by the size of the arm and marked as assumed. Meshes of the links are copied, simplified for
    the pages. Expand a xacro first.

    \b
    Example:
      postproc robots add kr120_r2700_2.urdf --name my_kr120
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.jobs.first_steps import add_robot

    model = add_robot(urdf, name, output, overwrite=overwrite)
    for note in model.notes:
        click.echo(f"note: {note}", err=True)
    click.echo(f'written: {model.folder}. In a cell: robot = "{model.folder.as_posix()}"')
