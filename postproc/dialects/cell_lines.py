"""The lines of the cell for what a program of a CAM system does besides moving, and whether the robot waits in them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from msgspec.structs import replace

from postproc.cell import Cell
from postproc.decimals import number_text
from postproc.dialects.waits import is_wait
from postproc.program import Event


def lines_of(event: Event, cell: Cell) -> list[str]:
    """Return the lines of the cell for an event, with its value inserted; M4 without lines uses the lines of M3."""
    if event.kind == "m_code":
        return list(cell.m_codes[f"M{number_text(event.value)}"])
    lines: Sequence[str] = getattr(cell.gcode, event.kind) or []
    if event.kind == "spindle_ccw":
        lines = lines or cell.gcode.spindle_on or []
    value = number_text(event.value)
    return [line.replace("{S}", value).replace("{T}", value) for line in lines]


def with_waits(events: Iterable[Event], cell: Cell) -> Iterator[Event]:
    """Yield events, marked where the robot waits in the lines that the cell has for them.

    What a subprogram does that such a line calls is not known.
    """
    for event in events:
        is_switched = event.kind not in ("dwell", "stop", "comment")
        yield replace(event, waits=True) if is_switched and any(map(is_wait, lines_of(event, cell))) else event
