"""Motion statements that are read one by one, not in bulk as plain lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from msgspec.structs import replace

from postproc.dialects.krl.language.motion_statements import MotionStatement, Point
from postproc.dialects.krl.language.names import CIRCLES, MAX_LENGTH
from postproc.dialects.krl.language.positions import AXES, CARTESIAN, LARGEST_COORDINATE, NotANumberError, Position
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.tree import Assignment, Motion, Spline, Statement, Tail
from postproc.dialects.krl.language.values import Aggregate, Reference, UnreadableText, Value, walk
from postproc.dialects.krl.read.explanations import why_unknown
from postproc.dialects.krl.read.frames import out_of_reach_error
from postproc.dialects.krl.read.known import NO_VALUE, unresolved_error
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.state import MOTION_SETTINGS, State, fields_used
from postproc.errors import ProgramError
from postproc.program import CIRC, LIN, PTP, SPL

KINDS = {"LIN": LIN, "SLIN": LIN, "PTP": PTP, "SPTP": PTP, "CIRC": CIRC, "SCIRC": CIRC, "SPL": SPL}
_NAMES_WITHOUT_EFFECT = (
    "$LOAD",
    "$ACC",
    "$VEL_AXIS",
    "$VEL_EXTAX",
    "$JERK",
    "$GEAR_JERK",
    "$ECO_LEVEL",
    "$COLLMON",
    "$TORQMON",
    "$SPL_VEL_",
)
"""Beginnings of the names of variables in WITH that change how fast a path is driven, and nothing else."""
ROBOT_POSITIONS = frozenset({"$POS_ACT", "$POS_ACT_MES", "$AXIS_ACT", "$AXIS_ACT_MEAS"})
"""Variables that hold the present robot position (KUKA, System Variables)."""
_HOME_NAMES = frozenset({"XHOME", "HOME", "$H_POS"})
RUN_TIME_ADVICE = (
    "Targets must be known before the program runs: write them as numbers or as points of the .dat, or leave such "
    "motions as they are by --keep-unresolved."
)


def depends_on_position(motion: Motion) -> bool:
    """Return whether the target of a motion, by its text, depends on the robot position before it.

    True if the target is relative, lacks some components, or is computed from that position.
    """
    points = [point for point in (motion.via, motion.end) if isinstance(point, Aggregate)]
    cartesian_names = [point.items.keys() & CARTESIAN for point in points]
    axis_names = [point.items.keys() & AXES for point in points]
    # of the last point alone: an auxiliary point needs no A, B, C
    is_incomplete = any(0 < len(names) < len(CARTESIAN) for names in (*cartesian_names[-1:], *axis_names))
    return is_incomplete or motion.word.endswith("_REL") or reads_robot_position(motion)


def keeps_position(motion: Motion) -> bool:
    """Return whether a motion leads to the present robot position, as ``PTP $POS_ACT`` does.

    False for circles and relative motions.

    :raises ProgramError: its target cannot be read.
    """
    if motion.word in CIRCLES or motion.word not in KINDS:
        return False
    if isinstance(motion.end, UnreadableText):
        raise motion.end.error
    return isinstance(motion.end, Reference) and motion.end.name in ROBOT_POSITIONS and motion.end.field is None


def reads_robot_position(stmt: Statement) -> bool:
    """Return whether a statement reads the present robot position; False if the statement cannot be read."""
    try:
        return any(isinstance(value, Reference) and value.name in ROBOT_POSITIONS for value in walk(stmt.values))
    except ProgramError:
        return False


def has_plain_tail(motion: Motion) -> bool:
    """Return whether no text but approximation (C_DIS …) follows the points of a motion."""
    tail = motion.tail
    return not tail.assignments and tail.unknown_text is None and tail.error is None


def may_be_point_name(name: str) -> bool:
    """Return whether a name, upper case, may name a point: it is no robot position, and not too long."""
    return name not in ROBOT_POSITIONS and len(name) <= MAX_LENGTH


class MotionReading(NamedTuple):
    """A motion that has been read.

    :ivar move: the motion; None if it leads to the present robot position.
    :ivar state: settings in force for the motion.
    :ivar name_offsets: offsets in the file of the names of its points.
    """

    move: MotionStatement | None
    state: State
    name_offsets: list[int]


class MotionReader:
    """Reads motion statements.

    :ivar home_joints: (6,) joint angles of the home position [deg].
    :ivar home_motion_row: row of the trace with the first motion to a home position that is in no file, so that
        `home_joints` are taken; 0 if there is none.
    """

    def __init__(self, settings: Settings, home_joints: tuple[float, ...]) -> None:
        """Keep the settings, and the joint angles of the home position."""
        self.settings, self.variables = settings, settings.variables
        self.home_joints = home_joints
        self.home_motion_row = 0

    def read_motion(self, place: Place, motion: Motion, row: int) -> MotionReading:
        """Return the motion of a statement with the settings in force for it.

        :param row: row of the execution trace with the statement.
        :raises UnresolvedError: the target, or a setting that the motion depends on, is not known before run time.
        :raises ProgramError: the statement is not understood, or a coordinate is out of reach.
        """
        name = motion.word.removesuffix("_REL")
        is_relative = motion.word != name
        # axes of the offset of a relative motion; empty for an absolute one
        kind, relative_axes = KINDS[name], motion.frame or ("#BASE" if is_relative else "")
        name_offsets: list[int] = []
        via = None if motion.via is None else self._point(place, motion.via, name_offsets, row)
        if motion.via is not None and (via is None or motion.end is None):
            raise place.error(
                f"{motion.word} needs an auxiliary point and an end point",
                advice="Write the auxiliary point, a comma and the end point.",
            )
        if keeps_position(motion):
            return MotionReading(None, self.settings.state, name_offsets)
        end = None if motion.end is None else self._point(place, motion.end, name_offsets, row)
        if end is None:
            problem = f"{motion.word}: the target is not known: it is the current robot position"
            raise unresolved_error(place.error(problem, RUN_TIME_ADVICE))
        angle = None if motion.angle is None else self._angle(place, motion.angle)
        state, is_approximated = self.tail_settings(
            place, kind, motion.tail, (motion.end, motion.via), has_axis_target=end.position.is_axis
        )
        self._check_axis_target(place, motion.word, kind, end, via)
        try:
            self.settings.refuse_uncertain(
                state, fields_used(kind, has_axis_target=end.position.is_axis, is_approximated=is_approximated)
            )
        except ProgramError as cause:
            raise unresolved_error(cause) from None
        move = MotionStatement(
            trace_row=row,
            kind=kind,
            keyword=(motion.start, motion.start + len(motion.word)),
            end=end,
            relative_axes=relative_axes,
            via=via,
            angle=angle,
            tail_start=motion.tail.start,
            stop=motion.tail.stop,
            is_approximated=is_approximated,
            frame_span=None if motion.frame_span is None else (motion.frame_span.start, motion.frame_span.stop),
        )
        return MotionReading(move, state, name_offsets)

    def block_state(self, place: Place, spline: Spline) -> State:
        """Return the settings inside a spline block: the present ones, changed by its WITH.

        :param spline: the first line of the block.
        :raises ProgramError: the WITH or the approximation is not understood.
        """
        state, _ = self.tail_settings(place, LIN, spline.tail)
        return replace(state, spline_block=spline.word)

    def _point(self, place: Place, value: Value, name_offsets: list[int], row: int) -> Point | None:
        """Return a point of a motion; None if it is the present robot position.

        :param value: the point as the text gives it.
        :param name_offsets: gets the offset of the name, if the point is a variable.
        :param row: row of the execution trace with the motion.
        :raises UnresolvedError: the point is not known before run time.
        :raises ProgramError: a coordinate is out of reach, or the name is too long.
        """
        source = place.source
        name = ""
        if isinstance(value, Reference):
            self.variables.check_name(source, value)
            if value.name in ROBOT_POSITIONS:
                return None
            name = value.name
            name_offsets.append(value.start)
        self.variables.note_dependence(value)
        try:
            position = self.variables.position(value)
        except NotANumberError as cause:
            raise unresolved_error(self._explained_error(source, value, cause)) from None
        # a home position that is in no file is taken from the cell
        if position is None and name in _HOME_NAMES and self.variables.evaluate(value) == NO_VALUE:
            self.home_motion_row = self.home_motion_row or row
            position = Position(self.home_joints, is_axis=True)
        if position is None:
            reason = why_unknown(self.variables, source, value)
            raise unresolved_error(place.error(f"the target is not known: {reason}", RUN_TIME_ADVICE))
        if position.largest_coordinate > LARGEST_COORDINATE:
            raise out_of_reach_error(place, position.largest_coordinate)
        return Point(position, value.start, value.stop, name)

    def _explained_error(self, source: Source, value: Value, cause: NotANumberError) -> ProgramError:
        """Return the error of a component that is not a number, with the reason why its value is not known.

        :param value: the point; `cause` names its component. If the point is not written there, `cause` is returned.
        """
        item = value.items.get(cause.component) if isinstance(value, Aggregate) else None
        if item is None:
            return cause
        problem = f"{cause.problem}: {why_unknown(self.variables, source, item)}"
        return source.error(problem, item.start, cause.advice)

    def _angle(self, place: Place, value: Value) -> float:
        """Return CA of a circle [deg].

        :raises ProgramError: the angle is unknown, 0, or larger than `LARGEST_COORDINATE`.
        """
        angle = self.variables.number(value)
        if angle is None or not 0.0 < abs(angle) <= LARGEST_COORDINATE:
            raise place.error(
                "the circular angle CA is not a number of degrees other than 0",
                advice="Write an angle in degrees, such as CA 90.",
            )
        return angle

    def _check_axis_target(self, place: Place, word: str, kind: int, end: Point, via: Point | None) -> None:
        """Refuse joint angles as the target or auxiliary point of a motion other than PTP.

        :param word: the instruction, for the message.
        :param kind: LIN, PTP, CIRC or SPL.
        :raises ProgramError: a point is given by joint angles.
        """
        if kind != PTP and (end.position.is_axis or (via and via.position.is_axis)):
            raise place.error(f"{word} to axis angles", "Write a Cartesian target, or use PTP.")

    def _check_independence_of_with(self, place: Place, subject: str, value: Value | None) -> None:
        """Refuse a value that reads a setting of motions, in a motion whose WITH changes settings for itself alone.

        No source says whether the setting is read before or after WITH changes it.

        :param subject: name of the assigned setting, or WITH, for the message.
        :param value: an expression of the motion or of its WITH; None: a point that the motion lacks.
        :raises ProgramError: the value reads a setting.
        """
        variable_names = [part.name for part in walk([] if value is None else [value]) if isinstance(part, Reference)]
        if not MOTION_SETTINGS.isdisjoint(variable_names):
            name = min(MOTION_SETTINGS.intersection(variable_names))
            problem = f"{subject}: whether {name} is the one before WITH or behind it is in no source"
            raise place.error(problem, f"Assign {name} to a variable in a line before, and use that.")

    def tail_settings(
        self,
        place: Place,
        kind: int,
        tail: Tail,
        points: Sequence[Value | None] = (),
        *,
        has_axis_target: bool = False,
    ) -> tuple[State, bool]:
        """Return the settings in force for one motion, changed by its WITH, and whether `$APO.CDIS` applies to it.

        `$APO.CDIS` applies with C_DIS, and with C_SPL to motions other than PTP.

        :param kind: kind of the motion: `LIN`, `CIRC`, `PTP` or `SPL`.
        :param tail: WITH and approximation of the motion.
        :param points: target and auxiliary point of the motion; None for a point that it lacks.
        :param has_axis_target: True for a motion to joint angles, which uses no frame: its `$IPO_MODE` may be unknown,
            as that of FHOME, which is in the `$config.dat`.
        :raises ProgramError: WITH or the approximation is not understood.
        """
        text, state = place.source.text, self.settings.state
        if tail.error is not None:
            raise tail.error
        if tail.unknown_text is not None:
            raise place.error(f"{tail.unknown_text.text_in(text)!r} is not understood", advice="Check its spelling.")
        for item in tail.assignments:
            if not isinstance(item, Assignment):
                raise place.error(f"{text[item.start : item.stop]!r} is not understood", advice="Check its spelling.")
            if has_axis_target and item.target.name == "$IPO_MODE":
                continue
            if item.target.name in MOTION_SETTINGS:
                self._check_independence_of_with(place, item.target.name, item.value)
                state = self.settings.state_after_assignment(state, place, item.target, item.value)
            elif not item.target.name.startswith(_NAMES_WITHOUT_EFFECT):
                raise place.error(f"{item.target.name} in WITH is not understood", advice="Check its spelling.")
        # the points of the motion must not read what its WITH has changed
        if state.without_turn_speeds() != self.settings.state.without_turn_speeds():
            for value in points:
                self._check_independence_of_with(place, "WITH", value)
        uses_distance = "C_DIS" in tail.approximation or ("C_SPL" in tail.approximation and kind != PTP)
        return state, uses_distance
