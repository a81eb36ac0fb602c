"""Result of executing a cutter-location file: moves, events and faults, in the order of the statements."""

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


class MoveEvent(Struct, frozen=True):
    """An event, see `program.Event`.

    :param before: number of moves before it.
    :param row: row of its statement.
    """

    before: int
    row: int
    kind: EventKind
    value: float = 0.0
    text: str = ""


class MoveRun(Struct, frozen=True, eq=False):
    """n consecutive moves of one kind, feed and tool; an arc is a run of its own.

    :param row: (n,) rows of their statements.
    :param end: (n, 3) ends of the moves [mm].
    :param axis: (n, 3) unit direction from tip to spindle at the ends.
    :param code: `RAPID`, `LINE` or `ARC`.
    :param feed: feed [mm/min].
    :param tool: number of the tool; None before the first tool.
    :param circle: circle of an arc; None for lines.
    :param sweep: angle of an arc [rad]; 0 for lines.
    :param is_joint_motion: True if the robot moves by its joints, not along a path.
    :param is_exact_stop: True if the robot stops at the end.
    :param is_to_home: True if the move leads to [machine] home.
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


class ExecutionResult(Struct, eq=False):
    """Result of the execution of a file: its moves, events, faults and remarks, in order.

    :ivar move_runs: the moves.
    :ivar tools: numbers of the tools, in order of their first use.
    :ivar begins_at_start: True if the first move begins at `[start]` and is at feed.
    :ivar has_units: True if the program states its units.
    :ivar after_end: rows of statements behind the end of the program, which are not executed.
    """

    move_runs: list[MoveRun] = field(default_factory=list)
    events: list[MoveEvent] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    remarks: list[Remark] = field(default_factory=list)
    tools: list[float] = field(default_factory=list)
    begins_at_start: bool = False
    has_units: bool = False
    after_end: tuple[int, ...] = ()
