"""Motion statements: instruction, points, and what follows them."""

from __future__ import annotations

from msgspec import Struct

from postproc.dialects.krl.language.positions import Position


class Point(Struct, frozen=True, eq=False):
    """One point of a motion statement.

    :param position: its numbers, as far as they are given.
    :param start: offset in the `.src` where its text begins.
    :param stop: offset behind its text.
    :param name: variable (upper case) when it is named by itself, else empty: a literal or a chain.
    """

    position: Position
    start: int
    stop: int
    name: str = ""

    @property
    def inline(self) -> bool:
        """Whether its numbers stand in the statement itself."""
        aggregate = self.position.aggregate
        return aggregate is not None and not self.name and aggregate.start == self.start


class MotionStatement(Struct, frozen=True, eq=False):
    """One motion statement.

    :param line: 1-based line.
    :param kind: `LIN`, `CIRC` or `PTP`.
    :param keyword: span of the instruction, with ``_REL``.
    :param end: target.
    :param relative: ``""``, ``"#BASE"`` or ``"#TOOL"``: axes of a ``_REL`` target.
    :param via: auxiliary point of a CIRC.
    :param angle: CA [deg], or None.
    :param tail: offset from which the text applies to inserted targets too: approximation and WITH.
    :param stop: offset behind the code of the line.
    :param approximated: True where `$APO.CDIS` applies.
    :param behind: span of ``#BASE`` or ``#TOOL`` where it stands behind the approximation.
    """

    line: int
    kind: int
    keyword: tuple[int, int]
    end: Point
    relative: str
    via: Point | None
    angle: float | None
    tail: int
    stop: int
    approximated: bool
    behind: tuple[int, int] | None = None

    @property
    def via_incomplete(self) -> bool:
        """Whether the auxiliary point takes some of X, Y, Z from where the circle begins."""
        return self.via is not None and any(value != value for value in self.via.position.values[:3])

    @property
    def plain(self) -> bool:
        """Whether its points are Cartesian, with their numbers in the line: such lines are read all at once."""
        inline = self.end.inline and (self.via is None or self.via.inline)
        return (
            inline
            and not self.via_incomplete
            and self.angle is None
            and not self.end.position.axis
            and not self.relative
        )
