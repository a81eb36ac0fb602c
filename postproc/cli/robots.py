"""`postproc robots`: which robots there are, and where each number of one comes from."""

from __future__ import annotations

import json

import click


@click.command()
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def robots(name: str | None, as_json: bool) -> None:
    """List the robot models, or show one with the source of each value.

    NAME is the name of a shipped robot or the path of a model folder.

    \b
    Examples:
      postproc robots
      postproc robots kuka_kr270
      postproc robots my_robot/ --json
    """  # noqa: D301 - click: keep these lines as they are
    from postproc import robot

    if name is None:
        models = {known: robot.load(folder) for known, folder in robot.shipped().items()}
        if as_json:
            click.echo(json.dumps({known: model.title for known, model in models.items()}, indent=2))
            return
        width = max(len(known) for known in models)
        for known, model in models.items():
            assumed = sum(entry.assumed for entry in model.provenance)
            click.echo(f"{known:<{width}}  {model.title} ({assumed} of {len(model.provenance)} values assumed)")
        return
    model = robot.load(robot.find(name))
    if as_json:
        values = [
            {"name": entry.name, "value": entry.value, "source": entry.source, "assumed": entry.assumed}
            for entry in model.provenance
        ]
        click.echo(
            json.dumps({"name": model.name, "title": model.title, "values": values}, indent=2, ensure_ascii=False)
        )
        return
    click.echo(f"{model.title} ({model.name})\n")
    widths = [max(len(entry.name) for entry in model.provenance), max(len(entry.value) for entry in model.provenance)]
    for entry in model.provenance:
        mark = "ASSUMED  " if entry.assumed else "         "
        click.echo(f"  {entry.name:<{widths[0]}}  {entry.value:<{widths[1]}}  {mark}{entry.source}")
