"""TRIGGER statements and what they refer to.

A TRIGGER refers to the motion that follows it: to its start (``DISTANCE=0``, ``PATH=… ONSTART``) or to its end
(``DISTANCE=1``, ``PATH=…``), and switches within it. ``CONST_VEL`` and ``STOP WHEN PATH`` of spline motions refer
to it in the same way, and may count beyond it: they stay before its first or its last piece (KUKA, KSS 8.x, 'spline
motion').
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msgspec import Struct

from postproc.dialects.krl.language import tree
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import number
from postproc.frames import M_PER_MM, Array

_S_PER_MS = 1e-3


class Trigger(Struct, frozen=True):
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


def triggers(source: Source, found: Sequence[tuple[int, int, bool]], length: Array) -> Iterator[Trigger]:
    """Return TRIGGER statements of a `.src`.

    :param found: line, row of the motion that follows, and whether it is attached, of each.
    :param length: (n,) of these motions [m].
    """
    text = source.text
    for (line, row, attached), metres in zip(found, length.tolist(), strict=True):
        here = statement(source, line)
        if isinstance(here, tree.Timed):
            yield Trigger(line, row, attached, here.from_start, 0.0, None, 0.0, metres)
            continue
        offset = delay = float("nan")
        from_start, path = False, None
        if isinstance(here, tree.Trigger) and here.value is not None and here.delay is not None:
            value, delay = number(here.value.of(text)), _S_PER_MS * number(here.delay.of(text))
            from_start = here.from_start or (here.distance and value == 0.0)
            if not here.distance:
                offset, path = value * M_PER_MM, (here.value.start, here.value.stop)
            elif value in (0.0, 1.0):
                offset = 0.0
        yield Trigger(line, row, attached, from_start, offset, path, delay, metres)
