"""Motions of KRL programs that are compared: the tool points down, millimetres."""

from __future__ import annotations

TURNED = "A 180,B 0,C 180"
"""Orientation of the tool in `$BASE`."""


def lin(x: float, y: float, z: float = 0.0, more: str = "") -> str:
    """Return a LIN to a point; `more`: further components of its target."""
    return f"LIN {{X {x:.4f},Y {y:.4f},Z {z:.4f},{TURNED}{more}}}"


def circ(via: tuple[float, float], end: tuple[float, float]) -> str:
    """Return a CIRC at Z 0 through an auxiliary point to its end."""
    return f"CIRC {{X {via[0]:.5f},Y {via[1]:.5f},Z 0}},{{X {end[0]:.5f},Y {end[1]:.5f},Z 0,{TURNED}}}"


def line_of(text: str, part: str) -> int:
    """Return the number of the first line that contains a part."""
    return next(number for number, line in enumerate(text.splitlines(), 1) if part in line)
