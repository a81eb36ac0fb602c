"""Motion statements with their points known, and the TRIGGERs that refer to them.

A TRIGGER refers to the motion that follows it: to its start (``DISTANCE=0``, ``PATH=… ONSTART``) or to its end
(``DISTANCE=1``, ``PATH=…``), and switches within it. ``CONST_VEL`` and ``STOP WHEN PATH`` of spline motions refer
to it in the same way, and may count beyond it: they stay before its first or its last piece (KUKA, KSS 8.x, 'spline
motion').
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from msgspec import Struct

from postproc.dialects.krl.language import tree
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.positions import Position
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.language.values import Number, Value
from postproc.frames import M_PER_MM, Array


class Point(Struct, frozen=True, eq=False):
    """One point of a motion statement.

    :param position: its numbers, as far as they are given.
    :param start: offset of its text in the file of the statement.
    :param stop: offset behind its text.
    :param name: variable (upper case) that the statement names as the point; empty for a literal or a chain.
    """

    position: Position
    start: int
    stop: int
    name: str = ""

    @property
    def is_inline(self) -> bool:
        """Whether its numbers are in the statement itself."""
        aggregate = self.position.aggregate
        return aggregate is not None and not self.name and aggregate.start == self.start


class MotionStatement(Struct, frozen=True, eq=False):
    """One motion statement.

    :param trace_row: 1-based row of the execution trace (the lines in execution order). Offsets are those of its file.
    :param kind: `LIN`, `CIRC`, `PTP` or `SPL`.
    :param keyword: span of the instruction, with ``_REL``.
    :param end: target.
    :param relative_axes: axes of a ``_REL`` target, ``"#BASE"`` or ``"#TOOL"``; empty for an absolute one.
    :param via: auxiliary point of a circle; None for other motions.
    :param angle: CA [deg]; None without it.
    :param tail_start: offset from which the text applies to inserted targets too: approximation and WITH.
    :param stop: offset behind the code of the line.
    :param is_approximated: True where `$APO.CDIS` applies.
    :param frame_span: span of ``#BASE`` or ``#TOOL`` if it follows the approximation, else None.
    """

    trace_row: int
    kind: int
    keyword: tuple[int, int]
    end: Point
    relative_axes: str
    via: Point | None
    angle: float | None
    tail_start: int
    stop: int
    is_approximated: bool
    frame_span: tuple[int, int] | None = None

    @property
    def is_via_incomplete(self) -> bool:
        """Whether the auxiliary point omits X, Y or Z: the controller keeps the value at the start of the circle."""
        return self.via is not None and any(math.isnan(value) for value in self.via.position.values[:3])

    @property
    def is_plain(self) -> bool:
        """Whether the motion is absolute and has Cartesian points whose numbers are in the line, and no CA.

        Such lines are read in bulk.
        """
        is_inline = self.end.is_inline and (self.via is None or self.via.is_inline)
        return (
            is_inline
            and not self.is_via_incomplete
            and self.angle is None
            and not self.end.position.is_axis
            and not self.relative_axes
        )


_S_PER_MS = 1e-3


class Trigger(Struct, frozen=True):
    """A TRIGGER statement.

    :param trace_row: 1-based row of the execution trace (the lines in execution order).
    :param motion: index of the motion that it refers to.
    :param is_attached: True if only comments and other TRIGGERs are between it and its motion.
    :param is_from_start: True if its distance counts from the start of the motion, False if from the end.
    :param offset: distance along the path [m]; NaN when it is not a number.
    :param path_span: span of the number of PATH in its file; None for DISTANCE.
    :param delay: DELAY [s]; NaN when it is not a number.
    :param length: length of its motion along the path [m].
    """

    trace_row: int
    motion: int
    is_attached: bool
    is_from_start: bool
    offset: float
    path_span: tuple[int, int] | None
    delay: float
    length: float


def triggers(trace: Trace, rows: Sequence[tuple[int, int, bool]], length: Array) -> Iterator[Trigger]:
    """Yield the TRIGGER statements of a program.

    CONST_VEL and STOP WHEN PATH count as triggers at the start or the end of their motion.

    :param trace: the lines of the program in execution order.
    :param rows: for n triggers, the row of the trace, the index of the motion that each refers to, and True if only
        comments and other TRIGGERs are between the two.
    :param length: (n,) lengths of their motions along the path [m].
    """
    for (trace_row, motion, is_attached), path_length in zip(rows, length.tolist(), strict=True):
        node = statement(*trace.place(trace_row))
        switching = _switching_of(node)
        yield Trigger(
            trace_row=trace_row,
            motion=motion,
            is_attached=is_attached,
            is_from_start=switching.is_from_start,
            offset=switching.offset,
            path_span=switching.path_span,
            delay=switching.delay,
            length=path_length,
        )


class _Switching(NamedTuple):
    """Where and when a trigger switches: the fields of `Trigger` that its statement alone decides."""

    is_from_start: bool
    offset: float
    path_span: tuple[int, int] | None
    delay: float


def _switching_of(node: tree.Statement) -> _Switching:
    """Return where and when a trigger switches; distance and delay are NaN if they are not numbers.

    Both are NaN too for a statement that is not understood, and the distance for DISTANCE other than 0 and 1. A motion
    with such a trigger cannot be divided.
    """
    if isinstance(node, tree.SplineTiming):
        return _Switching(node.is_from_start, offset=0.0, path_span=None, delay=0.0)
    if not isinstance(node, tree.Trigger) or node.value is None or node.delay is None:
        return _Switching(is_from_start=False, offset=float("nan"), path_span=None, delay=float("nan"))
    value, delay = _number(node.value), _S_PER_MS * _number(node.delay)
    if not node.is_distance:
        return _Switching(node.is_from_start, value * M_PER_MM, (node.value.start, node.value.stop), delay)
    offset = 0.0 if value in (0.0, 1.0) else float("nan")  # DISTANCE=0 is the start of the motion, 1 its end
    return _Switching(node.is_from_start or value == 0.0, offset, path_span=None, delay=delay)


def _number(value: Value) -> float:
    """Return the value of a number; NaN for any other value."""
    return value.value if isinstance(value, Number) else float("nan")
