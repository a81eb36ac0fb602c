"""What the comments of a cutter-location file state: the CAM system that wrote it, and its coordinate systems.

- CATIA writes ``$$*CATIA0``, a line with a name, and three lines of four numbers: the axes and the origin of the
  machining axis system. Coordinates are those of this system. Source: Dassault Systèmes, CATIA V5, "Syntax of
  Generated APT Instructions".
- Creo writes ``$$-> CSYS / …``, the system of an NC sequence; coordinates are those of the machine. Source: PTC,
  Creo NC, "Supported CL Data Commands".
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Sequence
from typing import Literal

import numpy as np

System = Literal["CATIA", "Creo"]
_HEADS: Sequence[tuple[str, System]] = (("CATIA APT", "CATIA"), ("*CATIA0", "CATIA"), ("Pro/CLfile", "Creo"))
_WORDS = re.compile(r"[,/$\s]+")
_CATIA_SYSTEM = "*CATIA0"
_ROWS = 3
"""A coordinate system is three comments, one for each axis."""


def system_of(comments: Sequence[tuple[int, str]]) -> System | None:
    """Return the CAM system that wrote a file, or None if no comment states it."""
    return next((system for _, text in comments for head, system in _HEADS if head in text), None)


def changed_axis_systems(comments: Sequence[tuple[int, str]]) -> list[int]:
    """Return the lines of machining axis systems of CATIA that are not the first one."""
    systems: list[tuple[int, list[list[float] | None]]] = []  # line and axes of each
    for index, (line, text) in enumerate(comments):
        if text.startswith(_CATIA_SYSTEM):
            first_axis = index + 2  # a comment with its name is between
            systems.append((line, [_numbers(axis) for _, axis in comments[first_axis : first_axis + _ROWS]]))
    return [line for line, axes in systems if axes != systems[0][1]]


def sequence_lines(comments: Sequence[tuple[int, str]]) -> list[int]:
    """Return the lines at which NC sequences of Creo begin, sorted: each has parameters of its own."""
    return sorted(line for line, text in comments if text.startswith("-> FEATNO"))


def sequence_at(lines: Sequence[int], line: int) -> int:
    """Return the number of the NC sequence of a line."""
    return bisect_right(lines, line)


def is_moved(comment: str) -> bool:
    """Return whether a comment of Creo states a coordinate system that is not that of the machine."""
    word, _, values = comment.removeprefix("->").partition("/")
    return comment.startswith("->") and word.strip() == "CSYS" and _numbers(values) != np.eye(3, 4).ravel().tolist()


def _numbers(text: str) -> list[float] | None:
    """Return the numbers of a text, or None if it has other words."""
    try:
        return [float(number) for number in _WORDS.split(text) if number]
    except ValueError:
        return None
