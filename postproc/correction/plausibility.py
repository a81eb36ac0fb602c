"""Values of a cell that are possible, and nearly always a mistake: lengths in metres, a load that the arm cannot carry.

They are asked about, not refused: a touch probe on the flange may be short, and a manufacturer may release a load.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from postproc.cell import Cell
from postproc.decimals import without_negative_zero
from postproc.errors import Issue, Level
from postproc.forces.path_forces import PathForces
from postproc.frames import MM_PER_M, MM_PER_MIN, Array, norm
from postproc.kinematics.forward import GRAVITY
from postproc.placement.samples import SPINDLE_AXES
from postproc.program import Ints, Program, distinct
from postproc.robot import RobotModel
from postproc.robot.rating import rated_payload
from postproc.toolpath import retract_motions

_SHORT_TOOL = 0.005
"""A tip nearer to the flange [m] is none of a spindle: 0.35 is a length in metres that is read in millimetres."""
_NEAR_BASE = 0.01
"""A base that is not zero and nearer to the robot root [m] is inside the foot of the arm."""
_LEAST_REMAINDER = 5e-5
"""Displacement of the unloaded tip [m] that is asked about where the frames of the controller contain most of it, and
only the remainder counts: by other touched points than those of the fit, a base is off by twice as much."""
_LEAST_SHIFT = 1e-4
"""Displacement of the unloaded tip [m] that is asked about, assumed: touching with a robot is no more exact."""
_OVERLOAD = 2.0
"""Force over the rated weight from which a program is questioned, assumed: slow arms carry more than at full dynamics,
for which they are rated, and small ones mill with forces above their rating."""
_LONGEST_LEVER = 0.5
"""Moment over force [m] that no cutter has: a face mill of 250 mm has its cutting force at 0.125 m."""
SMALLEST_CUTTING_FEED, LARGEST_CUTTING_FEED = 10.0, 30e3
"""Feeds of cuts [mm/min] that are questioned beyond, assumed: 1.2 is m/min that is read in mm/min."""
_SWITCHING = ("spindle_on", "spindle_ccw", "spindle_off")
"""Kinds of events that switch the spindle."""
_SET_SIGNAL = re.compile(
    r"\s*(?:(\$?\w+(?:\s*\[[^\]]*\])?)\s*=(?!=)|(?:Set[DAG]O|Set|Reset)\s+(?:\\[^,]*,\s*)?(\w+))", re.IGNORECASE
)
"""KRL ``$OUT[1]=TRUE``, RAPID ``SetDO doSpindle,1;``."""
_SAME_LENGTH = 1e-6
"""Tools with lengths that differ by less [m] are equally long (assumed)."""
_CUT_MARGIN = 0.05
"""Width around the cuts [m] in which stock and clamps are (assumed)."""


def setup_questions(program: Program, cell: Cell, robot: RobotModel) -> Iterator[Issue]:
    """Yield a warning for each value of the cell, or frame of the program, to ask about."""
    m = program.motions
    cutting = np.flatnonzero(~m.rapid)
    table = "$TOOL of the program" if program.keeps_text else "[tool] or [tools.n] of the cell"
    for row in distinct(m.tool[cutting]):
        if message := short_tool_question(program.tools[row], table):
            yield m.issue("warning", "short-tool", message, cutting[m.tool[cutting] == row])
    table = "$BASE of the program" if program.keeps_text else "[base] of the cell"
    for row in distinct(m.base[cutting]):
        if message := near_base_question(program.bases[row], table):
            yield m.issue("warning", "near-base", message, cutting[m.base[cutting] == row])
    rating = rated_payload(robot.title, robot.name)
    if rating is not None and cell.payload.mass_kg > rating:
        name = robot.title or robot.name
        message = (
            f"[payload] mass_kg = {cell.payload.mass_kg:g} is more than the {rating:g} kg of {name}: "
            "is it in kg? It counts in addition to what the arm carried when the model was calibrated"
        )
        yield Issue("warning", "payload-rating", message)


def frame_question(program: Program, motion: Ints, shift: Array, causes: Sequence[str], cell: Cell) -> Iterator[Issue]:
    """Yield a question where frames may not hold for the arm at rest, unless the cell says that they do.

    A `$BASE` that is measured by touching the part contains the displacement of the tip there. By a correction that
    takes the frame for exact, the part would be off by as much.

    :param motion: (K,) motion of each target.
    :param shift: (K,) distance of the unloaded tip from its nominal place [m], without what frames of the controller
        contain where the cell says that it measured them.
    :param causes: of that distance, in words.
    """
    is_cut = ~np.asarray(program.motions.rapid)[motion]
    largest_shift = float(shift.max(initial=0.0, where=is_cut))
    limit = _LEAST_REMAINDER if cell.frames == "controller" else _LEAST_SHIFT
    are_frames_exact = cell.frames == "model"  # measured from outside, or corrected by the model
    if are_frames_exact or largest_shift <= limit:
        return
    cause, distance = " and ".join(causes), f"{largest_shift * MM_PER_M:.2g} mm"
    if cell.frames == "controller":
        message = (
            f"the tip without a force is displaced by {cause}, and not alike over the cuts: away from the touched "
            f"points a $BASE that the controller measured is off by some {distance}. To take that out, write "
            'frames = "model" in the cell, and correct its frames by postproc check frames'
        )
    else:
        message = (
            f"without a force the tip is up to {distance} from where the controller has it, by {cause}. A $BASE that "
            "this controller measured contains that, and the correction would move the part by it. Write at the top of "
            'the cell: frames = "controller" if the controller measured [base] with this arm, on the part or near it; '
            'frames = "model" if [base] is of a laser tracker or of postproc check frames'
        )
    yield Issue("warning", "frames-at-rest", message)


def short_tool_question(tool: Array, table: str) -> str:
    """Return the question on a `$TOOL` (4, 4) [m] with its tip at the flange; empty for any other.

    :param table: where it is given, in words for the message.
    """
    length = float(norm(tool[:3, 3]))
    if length >= _SHORT_TOOL:
        return ""
    message = f"the tip of $TOOL ({_position_text(tool)}) is {length * MM_PER_M:.3g} mm from the flange"
    return f"{message}: is Z in mm? {table} is in mm: a tool of 0.35 m has Z = 350"


def near_base_question(base: Array, table: str) -> str:
    """Return the question on a `$BASE` (4, 4) [m] inside the foot of the arm; empty for any other, and for zero.

    :param table: where it is given, in words for the message.
    """
    distance = float(norm(base[:3, 3]))
    if not 0.0 < distance < _NEAR_BASE:
        return ""
    message = f"$BASE ({_position_text(base)}) is {distance * MM_PER_M:.3g} mm from the robot root"
    return f"{message}: are X, Y, Z in mm? {table} is in mm: 1.5 m are 1500"


def force_questions(program: Program, forces: PathForces, cell: Cell, robot: RobotModel) -> Iterator[Issue]:
    """Yield questions on cutting moves with forces: overload, too long a lever, spindle off, a feed in another unit."""
    m = program.motions
    motion = np.repeat(np.arange(len(m)), np.diff(forces.first))  # of each force: a motion may have several
    is_cutting = ~np.asarray(m.rapid)[motion]  # a rapid move begins with the force that ends on it
    wrench = forces.wrench
    size = norm(wrench.values[:, :3])[wrench.run] * is_cutting  # of the force [N]
    moment = norm(wrench.values[:, 3:])[wrench.run] * is_cutting  # [N·m]
    rating = rated_payload(robot.title, robot.name)
    if rating is not None and (too_strong := size > rating * GRAVITY).any():
        name = robot.title or robot.name
        message = (
            f"a force of {size.max():.0f} N: {name} carries {rating:g} kg, which is {rating * GRAVITY:.0f} N. "
            f"{_force_advice(program, forces)}"
        )
        level: Level = "warning" if size.max() > _OVERLOAD * rating * GRAVITY else "info"
        yield m.issue(level, "force-rating", message, distinct(motion[too_strong]))
    if not program.keeps_text:
        yield from _feed_and_spindle_questions(program, cell, distinct(motion[size > 0.0]))
    too_long = moment > np.where(size > 0.0, _LONGEST_LEVER * size, np.inf)
    if too_long.any():
        row = int(np.argmax(np.where(too_long, moment, 0.0)))
        message = (
            f"a moment of {moment[row]:.4g} N·m with a force of {size[row]:.4g} N: a lever of "
            f"{moment[row] / size[row]:.2g} m. Are these N·mm? MX, MY and MZ are read in N·m, about the tip"
        )
        yield m.issue("warning", "moment-unit", message, distinct(motion[too_long]))


def _force_advice(program: Program, forces: PathForces) -> str:
    """Return what to check where a force is larger than the robot carries: a computed one is that of its feed."""
    if forces.law_forces is None:
        return "Are the forces in N? If they are, machine with smaller ones"
    if any(issue.kind == "default-speed" for issue in program.issues):
        return "The force is computed with a speed that is assumed, since $VEL.CP is not set: set it before the cuts"
    return "Check feed, tool and stock of the cut. If they are right, machine with smaller cuts"


def _feed_and_spindle_questions(program: Program, cell: Cell, rows: Ints) -> Iterator[Issue]:
    """Yield a warning where motions that cut have a feed that no cutter has, or the spindle is off.

    :param rows: (n,) motions that cut.
    """
    m = program.motions
    feed = MM_PER_MIN * m.feed[rows]
    unusual = (feed < SMALLEST_CUTTING_FEED) | (feed > LARGEST_CUTTING_FEED)
    if unusual.any():
        message = f"a cut with a feed of {feed[np.argmax(unusual)]:.3g} mm/min: is its unit right?"
        yield m.issue("warning", "feed-unit", message, rows[unusual])
    gcode = cell.gcode
    # spindle_on, spindle_ccw: lines that start the spindle; []: it is started by hand; None: not stated
    if not (gcode.spindle_on or gcode.spindle_ccw):
        is_by_hand = gcode.spindle_on is not None or gcode.spindle_ccw is not None
        if len(rows) and not is_by_hand and not any(event.kind in _SWITCHING for event in program.events):
            codes = f"{' or '.join(cell.m_codes)} starts it, or if " if cell.m_codes else ""
            message = (
                "nothing is known to start the spindle: the program does not. Write spindle_on = [] in [gcode] of the "
                f"cell if {codes}you start it by hand"
            )
            yield m.issue("warning", "spindle-off", message, rows)
        return
    yield from _spindle_questions(program, cell, rows)


def _spindle_questions(program: Program, cell: Cell, rows: Ints) -> Iterator[Issue]:
    """Yield a warning where the spindle is off on motions (n,) that cut, in a cell with lines that switch it."""
    m = program.motions
    effects = {code: _spindle_effect(cell, lines) for code, lines in cell.m_codes.items()}
    kinds = [effects[f"M{event.value:g}"] if event.kind == "m_code" else event.kind for event in program.events]
    switches = [event for event, kind in zip(program.events, kinds, strict=True) if kind in _SWITCHING]
    last_switch = np.searchsorted([event.before for event in switches], rows, side="right") - 1
    is_off_after = [kind == "spindle_off" for kind in kinds if kind in _SWITCHING]  # after each switch
    # before the first switch, `last_switch` is −1, the entry at the end: the spindle is off
    is_off = np.array([*is_off_after, True])[last_switch]
    if is_off.any():
        index = int(last_switch[np.argmax(is_off)])
        cause = f"line {switches[index].line} switches it off" if index >= 0 else "nothing switches it on before"
        message = (
            f"a cut with the spindle off: {cause}. Switch it on in the program, or write spindle_on = [] in [gcode] of "
            "the cell if you start it by hand"
        )
        yield m.issue("warning", "spindle-off", message, rows[is_off])


def _spindle_effect(cell: Cell, lines: Sequence[str]) -> str:
    """Return "spindle_on" or "spindle_off", as lines of `[m_codes]` switch the spindle; empty if they do not.

    Lines switch the spindle if they set a signal that `spindle_on` or `spindle_ccw` of the cell set. The last of them
    decides: it switches the spindle off if it is also in `spindle_off`.
    """
    gcode = cell.gcode
    signals = {
        signal for line in (*(gcode.spindle_on or ()), *(gcode.spindle_ccw or ())) if (signal := _signal_name(line))
    }
    switching = [_compact_line(line) for line in lines if _signal_name(line) in signals]
    if not switching:
        return ""
    return "spindle_off" if switching[-1] in map(_compact_line, gcode.spindle_off or ()) else "spindle_on"


def _signal_name(line: str) -> str:
    """Return the signal that a line of KRL or RAPID sets, upper case; empty for none."""
    match = _SET_SIGNAL.match(line)
    return _compact_line(match[1] or match[2]) if match else ""


def _compact_line(line: str) -> str:
    """Return a line without blanks, upper case."""
    return "".join(line.split()).upper()


def tool_change_warnings(program: Program, axis: str) -> Iterator[Issue]:
    """Yield a warning for each tool change where the tip of a longer tool is mounted among or below the cuts.

    The flange does not move at a tool change, so the new tip is deeper, along the new tool, by the difference of the
    lengths. A tip below the deepest cut is reported anywhere; one below the highest cut only over the cuts, which are
    widened by 50 mm. Retracts at feed, and moves at their height, are no cuts.

    :param axis: of the tool frame, from the spindle to the tip: ``"+Z"`` and so on.
    """
    m = program.motions
    target: Array = m.target[:]
    to_tip = np.array(SPINDLE_AXES[axis])  # (3,) direction from the spindle to the tip, in the tool frame
    cutting = np.flatnonzero(~m.rapid & ~retract_motions(target[:, :3, 3], -(target[:, :3, :3] @ to_tip)))
    changes = 1 + np.flatnonzero((m.tool[1:] != m.tool[:-1]) & (m.base[1:] == m.base[:-1]))
    for row in changes.tolist():
        old_tool, new_tool = program.tools[m.tool[row - 1]], program.tools[m.tool[row]]
        points = target[cutting[m.base[cutting] == m.base[row]], :3, 3]
        # frame of the new tool in $BASE [m], with the flange where the old tool ended its last motion
        tip = target[row - 1] @ np.linalg.solve(old_tool, new_tool)
        down = tip[:3, :3] @ to_tip
        extra_length = float((tip[:3, 3] - target[row - 1, :3, 3]) @ down)
        if extra_length <= _SAME_LENGTH or not len(points):
            continue
        depth = (points - tip[:3, 3]) @ down  # of the cuts below the new tip
        lateral_offset = points - tip[:3, 3] - depth[:, None] * down
        smallest_offset, largest_offset = lateral_offset.min(axis=0), lateral_offset.max(axis=0)
        is_over = (smallest_offset <= _CUT_MARGIN).all() and (largest_offset >= -_CUT_MARGIN).all()
        if depth.max() < 0.0 or (is_over and depth.min() < 0.0):
            message = (
                f"the new tool is {extra_length * MM_PER_M:.4g} mm longer: where it is mounted its tip is at "
                f"{_position_text(tip)} of $BASE, which is {'among' if depth.max() >= 0.0 else 'below all'} the cuts. "
                "Retract further before the tool change"
            )
            yield m.issue("warning", "tool-change-depth", message, np.array([row]))


def _position_text(pose: Array) -> str:
    """Return X, Y, Z of a pose [m] in millimetres, in words."""
    return ", ".join(
        f"{name} {value:.6g}"
        for name, value in zip("XYZ", without_negative_zero((pose[:3, 3] * MM_PER_M).round(4)), strict=True)
    )
