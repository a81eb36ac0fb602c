"""`postproc identify`: compensator geometry, compliances, geometry of the robot, from measurements."""

from __future__ import annotations

from pathlib import Path

import click

_FILE = click.Path(path_type=Path)


@click.group()
def identify() -> None:
    r"""Identify the robot from measurements; the results go into a model folder that `convert` takes.

    \b
    Example:
      postproc identify compensator markers.csv -o compensator.toml
      postproc identify elastostatics measurements.csv --experiment experiment.toml \
          --compensator compensator.toml -o my_robot
    """


@identify.command()
@click.argument("markers", type=_FILE)
@click.option("-o", "--output", type=_FILE, required=True, help="TOML file to write.")
def compensator(markers: Path, output: Path) -> None:
    r"""Geometry of the gravity compensator: L, a_x, a_y with 95 % intervals (paper, Eq. (6), (7)).

    MARKERS is a CSV file with columns q2,marker,repeat,X,Y,Z: deg, mm, in any frame of the tracker. Marker P1 sits on
    link 2 where the spring is attached, P01, P02, … on the spring, best on opposite sides of its axis.

    \b
    Example:
      postproc identify compensator markers.csv -o compensator.toml
    """
    from postproc.identification import compensator_geometry

    result = compensator_geometry.identify(compensator_geometry.read(markers))
    compensator_geometry.save(output, result, markers.name)
    for name, value, half in zip(("L", "a_x", "a_y"), result.value, result.ci95, strict=True):
        click.echo(f"{name:>4} = {value * 1e3:8.3f} ± {half * 1e3:.3f} mm")
    for warning in result.warnings:
        click.echo(f"warning: {warning}", err=True)
    click.echo(f"written: {output}")
