"""Comments of a cutter-location file that state the CAM system that wrote it, and its coordinate systems.

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
_AXIS_COUNT = 3
"""Number of comments of a coordinate system: one for each axis."""


def system_of(comments: Sequence[tuple[int, str]]) -> System | None:
    """Return the CAM system that wrote a file; None if no comment states it.

    :param comments: line and text of each comment.
    """
    return next((system for _, text in comments for head, system in _HEADS if head in text), None)


def changed_axis_systems(comments: Sequence[tuple[int, str]]) -> list[int]:
    """Return the lines at which CATIA states a machining axis system that differs from the first one.

    :param comments: line and text of each comment.
    """
    systems: list[tuple[int, list[list[float] | None]]] = []  # line and axes of each
    for index, (line, text) in enumerate(comments):
        if text.startswith(_CATIA_SYSTEM):
            first_axis = index + 2  # behind the comment with its name
            systems.append((line, [_numbers(axis) for _, axis in comments[first_axis : first_axis + _AXIS_COUNT]]))
    return [line for line, axes in systems if axes != systems[0][1]]


def sequence_lines(comments: Sequence[tuple[int, str]]) -> list[int]:
    """Return the lines at which NC sequences of Creo begin, ascending.

    :param comments: line and text of each comment.
    """
    return sorted(line for line, text in comments if text.startswith("-> FEATNO"))


def sequence_at(lines: Sequence[int], line: int) -> int:
    """Return the number of the NC sequence that contains a line; 0 before the first.

    :param lines: see `sequence_lines`.
    """
    return bisect_right(lines, line)


def is_moved(comment: str) -> bool:
    """Return whether a comment of Creo states a coordinate system that differs from that of the machine."""
    word, _, values = comment.removeprefix("->").partition("/")
    return comment.startswith("->") and word.strip() == "CSYS" and _numbers(values) != np.eye(3, 4).ravel().tolist()


def _numbers(text: str) -> list[float] | None:
    """Return the numbers of a text; None if it contains other words."""
    try:
        return [float(number) for number in _WORDS.split(text) if number]
    except ValueError:
        return None
