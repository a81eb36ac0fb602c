"""TRIGGER statements: what they refer to, and where they stand once inserted targets divide their motion.

A TRIGGER refers to the motion that follows it: to its start (``DISTANCE=0``, ``PATH=… ONSTART``) or to its end
(``DISTANCE=1``, ``PATH=…``), and switches within it. When the motion is divided, it must stand before the piece on
which it switches; ``PATH`` is then counted from the start or the end of that piece.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from postproc.dialects.krl.language.expressions import NUMBER_PATTERN
from postproc.dialects.krl.language.source import Source
from postproc.frames import M_PER_MM, MM_PER_M, Array

_WHEN = re.compile(
    r"TRIGGER[ \t]+WHEN[ \t]+(?:(DISTANCE)|PATH)[ \t]*=[ \t]*(.+?)[ \t]*(\bONSTART\b)?[ \t]*\bDELAY[ \t]*=[ \t]*(.+?)"
    r"[ \t]*\bDO\b",
    re.IGNORECASE,
)
_NUMBER = re.compile(NUMBER_PATTERN)
_S_PER_MS = 1e-3
_ROUNDING = 1e-6
"""Places on a path closer than this [m] are one."""


@dataclass(frozen=True, slots=True)
class Trigger:
    """A TRIGGER statement.

    :param line: 1-based line.
    :param row: motion that it refers to.
    :param attached: nothing but comments and other TRIGGERs stand between it and its motion.
    :param from_start: whether its distance counts from the start of the motion, not from the end.
    :param offset: distance along the path [m]; NaN when it is not a number.
    :param path: span of the number of PATH in the text; None for DISTANCE.
    :param delay: DELAY [s]; NaN when it is not a number.
    :param length: of its motion along the path [m].
    """

    line: int
    row: int
    attached: bool
    from_start: bool
    offset: float
    path: tuple[int, int] | None
    delay: float
    length: float

    def piece(self, ends: Array, speed: float) -> tuple[int, float] | None:
        """Return before which piece of its motion it must stand, and its offset there [m]; None if nowhere.

        :param ends: (n,) where the pieces end, as shares of the motion in (0, 1].
        :param speed: of the TCP [m/s].
        """
        end = ends * self.length
        begin = np.concatenate([[0.0], end[:-1]])
        place = self.offset + (0.0 if self.from_start else self.length)
        first, last = min(place, place + self.delay * speed), max(place, place + self.delay * speed)
        behind, before = first > begin - _ROUNDING, last < end + _ROUNDING
        behind[0] = before[-1] = True  # beyond the ends of the motion the controller does what it did
        fits = behind & before
        if self.path is None:
            fits[slice(1, None) if self.from_start else slice(-1)] = False
        if not self.attached:
            fits[1:] = False
        found = np.flatnonzero(fits & np.isfinite(place + self.delay))
        if not len(found):
            return None
        piece = int(found[0 if self.from_start else -1])
        return piece, float(place - (begin if self.from_start else end)[piece])


def triggers(source: Source, found: Sequence[tuple[int, int, bool]], length: Array) -> Iterator[Trigger]:
    """Return TRIGGER statements of a `.src`.

    :param found: line, row of the motion that follows, and whether it is attached, of each.
    :param length: (n,) of these motions [m].
    """
    for (line, row, attached), metres in zip(found, length.tolist(), strict=True):
        match = _WHEN.match(source.text, *source.code_span(line))
        offset = delay = float("nan")
        from_start, path = False, None
        if match:
            value, delay = _number(match[2]), _S_PER_MS * _number(match[4])
            from_start = bool(match[3]) or (bool(match[1]) and value == 0.0)
            if not match[1]:
                offset, path = value * M_PER_MM, match.span(2)
            elif value in (0.0, 1.0):
                offset = 0.0
        yield Trigger(line, row, attached, from_start, offset, path, delay, metres)


def _number(text: str) -> float:
    return float(text) if _NUMBER.fullmatch(text) else float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """The TRIGGERs of one divided motion, and where its inserted targets go.

    :param at: for each inserted target, the 1-based line before which it stands.
    :param moved: for each piece, the TRIGGERs that are to be moved before it.
    :param paths: for TRIGGERs whose PATH changes, what it must say.
    :param lost: those that cannot be kept right.
    """

    at: list[int]
    moved: list[list[Trigger]]
    paths: dict[Trigger, str]
    lost: list[Trigger]


def placed(given: Sequence[Trigger], line: int, ends: Array, speed: float) -> Placed:
    """Return where TRIGGERs and inserted targets of one motion go.

    A TRIGGER stays on its line wherever the inserted targets can stand around it.

    :param given: in order.
    :param line: 1-based line of the motion.
    :param ends: (n,) where the pieces of the motion end, as shares of it.
    :param speed: [m/s].
    """
    out = Placed([line] * (len(ends) - 1), [[] for _ in ends], {}, [])
    earliest = len(ends)
    for trigger in reversed(given):
        found = trigger.piece(ends, speed)
        if found is None:
            out.lost.append(trigger)
            continue
        piece, offset = found
        if trigger.path is not None and abs(offset - trigger.offset) > _ROUNDING:
            out.paths[trigger] = f"{round(offset * MM_PER_M, 3) + 0.0:.3f}".rstrip("0").rstrip(".")
        if piece > earliest:
            out.moved[piece].insert(0, trigger)
            continue
        earliest = piece
        if trigger.attached:
            out.at[:piece] = [trigger.line] * piece
    out.lost.reverse()
    return out
