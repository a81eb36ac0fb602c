"""What a cutter-location file makes the machine do: moves, events and faults, in the order of the statements."""

from __future__ import annotations

from typing import NamedTuple

from msgspec import Struct, field

from postproc.dialects.circles import Circle
from postproc.errors import Level
from postproc.frames import Array
from postproc.program import EventKind, Ints

RAPID, LINE, ARC = 0, 1, 2


class Fault(Struct, frozen=True):
    """A fault of a statement: its row, the problem, the advice."""

    row: int
    problem: str
    advice: str | None = None


class Remark(NamedTuple):
    """A remark on a statement for the user; `kind` as in `Issue`."""

    row: int
    level: Level
    kind: str
    message: str


class Happening(Struct, frozen=True):
    """An event: number of moves before it, row of its statement, and `program.Event` in short."""

    before: int
    row: int
    kind: EventKind
    value: float = 0.0
    text: str = ""


class Part(Struct, frozen=True, eq=False):
    """Moves of one kind and feed, n in order.

    :param row: (n,) statements; `end` (n, 3) [mm] and `axis` (n, 3), the unit direction from tip to spindle, there.
    :param code: `RAPID`, `LINE` or `ARC`; `feed` [mm/min].
    :param tool: number of the tool, or None before the first.
    :param circle: of an arc; `sweep` its angle [rad].
    :param is_joint_motion: whether it is one; `is_exact_stop`: whether it stops at its end.
    :param is_to_home: whether it leads to [machine] home.
    """

    row: Ints
    end: Array
    axis: Array
    code: int
    feed: float
    tool: float | None
    circle: Circle | None = None
    sweep: float = 0.0
    is_joint_motion: bool = False
    is_exact_stop: bool = False
    is_to_home: bool = False


class Course(Struct, eq=False):
    """Result of the execution.

    :ivar tools: numbers of the tools, in order of their first use.
    :ivar begins_at_start: whether the first move comes from `[start]` at feed.
    :ivar has_units: whether the program states its units.
    :ivar after_end: rows of statements behind the end, which are not executed.
    """

    parts: list[Part] = field(default_factory=list)
    events: list[Happening] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    remarks: list[Remark] = field(default_factory=list)
    tools: list[float] = field(default_factory=list)
    begins_at_start: bool = False
    has_units: bool = False
    after_end: tuple[int, ...] = ()
