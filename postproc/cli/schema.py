"""`postproc schema`: JSON Schemas of the TOML files, for editors."""

from __future__ import annotations

import click

from postproc.cli.options import Choice


@click.command()
@click.argument("name", type=Choice(["cell", "process", "model", "experiment"]), default="cell")
@click.option("--path", "as_path", is_flag=True, help="Print where the file is, instead of its content.")
def schema(name: str, as_path: bool) -> None:
    """Print the JSON Schema of a TOML file.

    NAME is cell (default), process, model or experiment. The schema has descriptions, units, ranges and defaults.
    Editors with TOML support, such as Even Better TOML, complete and check a file whose first line names it:
    #:schema file:///path/cell.schema.json. `postproc init` writes this line.

    \b
    Examples:
      postproc schema cell
      postproc schema process --path
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.jobs.first_steps import schema_file

    file = schema_file(name)
    click.echo(str(file) if as_path else file.read_text(encoding="utf-8").rstrip())
