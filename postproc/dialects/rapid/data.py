"""Data of a RAPID module: tools, work objects, speeds and zones, as `write` declares them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from msgspec import Struct, field

from postproc.dialects.rapid.conventions import poses
from postproc.frames import M_PER_MM, Array

DECLARATION = re.compile(
    r"LOCAL (?:PERS|CONST) (tooldata|wobjdata|speeddata|zonedata) ([A-Za-z]\w*):=(\[[^;]*\]);", re.ASCII
)
_FARTHEST = 1e6
"""Largest coordinate of a frame [mm]."""


class Data(Struct, eq=False):
    """What the moves of a module refer to, by name.

    :ivar tools: `$TOOL` in the flange frame (4, 4) [m].
    :ivar bases: `$BASE` in the robot root (4, 4) [m].
    :ivar speeds: of the TCP [m/s].
    :ivar zones: approximation distance [m]; 0 for fine.
    """

    tools: dict[str, Array] = field(default_factory=dict)
    bases: dict[str, Array] = field(default_factory=dict)
    speeds: dict[str, float] = field(default_factory=dict)
    zones: dict[str, float] = field(default_factory=lambda: {"fine": 0.0})

    def declare(self, kind: str, name: str, text: str) -> str | None:
        """Take a declaration; return why it cannot be used, None if it can."""
        try:
            value = json.loads(text.replace("TRUE", "true").replace("FALSE", "false"))
            _READERS[kind](self, name, value)
        except (ValueError, TypeError, LookupError, RecursionError):
            return f"the {kind} is not as postproc writes it"
        return None


def _pose(value: Any) -> Array:
    place, turn = value
    numbers = np.array([*place, *turn], dtype=np.float64)
    norm = float(np.sqrt(numbers[3:] @ numbers[3:])) if numbers.shape == (7,) else 0.0
    if not (np.abs(numbers) < _FARTHEST).all() or abs(norm - 1.0) > 1e-5:
        raise ValueError
    return np.asarray(poses(numbers[None])[0])


def _tool(data: Data, name: str, value: Any) -> None:
    held, frame, _load = value
    if held is not True:
        raise ValueError
    data.tools[name] = _pose(frame)


def _work_object(data: Data, name: str, value: Any) -> None:
    held, fixed, unit, user, frame = value
    if (held, fixed, unit) != (False, True, ""):
        raise ValueError
    data.bases[name] = _pose(user) @ _pose(frame)


def _speed(data: Data, name: str, value: Any) -> None:
    tcp, _turning, _linear, _rotating = (_single(number) for number in value)
    if not 0.0 < tcp < _FARTHEST:
        raise ValueError
    data.speeds[name] = tcp * M_PER_MM


def _zone(data: Data, name: str, value: Any) -> None:
    fine, *distances = value
    path, turning, *_others = (_single(number) for number in distances)
    if fine is not False or len(distances) != 6 or not 0.0 < path <= turning < _FARTHEST:
        raise ValueError
    data.zones[name] = path * M_PER_MM


def _single(number: Any) -> float:
    """Return a number as the controller holds it."""
    if isinstance(number, bool):
        raise TypeError
    return float(np.float32(number))


_READERS: dict[str, Callable[[Data, str, Any], None]] = {
    "tooldata": _tool,
    "wobjdata": _work_object,
    "speeddata": _speed,
    "zonedata": _zone,
}
