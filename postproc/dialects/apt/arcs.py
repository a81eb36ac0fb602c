"""Arcs of a cutter-location file: circles of statements, and arcs between two points of a circle.

- ``CIRCLE/x,y,z,i,j,k,r`` turns right-handed about i, j, k. Source: PTC, Creo NC, "CL Output for Circular
  Interpolation".
- ``CIRCLE/x,y,z,i,j,k`` of SolidWorks CAM turns right-handed about i, j, k; the start gives the radius.
- ``CIRCLE/x,y,z,i,j,k,r,t,f,d,e`` of Siemens NX turns *clockwise* about i, j, k (t, f: tolerances; d, e: the tool).
  ``TIMES,n`` is a helix: the arc to its end and n − 1 further turns. With this reading all helices of CLSF files with
  n = 2 and 3 have ramp angles of 0.40° or 2.00°. Source: the NX documentation of the CLSF Manager, and CLSF files
  with rounded corners.
- ``MOVARC/x,y,z,i,j,k,r,ANGLE,a`` turns right-handed by a [deg]. Source: Autodesk's post "Common ISO 4343 APT".
- ``INDIRV/i,j,k`` and ``TLON,GOFWD/(CIRCLE/x,y,z,r),ON,(LINE/…)`` of CATIA and Creo (APT_FORMAT) turn so that the
  arc leaves its start along i, j, k. The line leads from the centre to the end. ``ON,2,INTOF`` is the end
  beyond half a turn.

The end of an arc is the point of the GOTO that follows, or the end of the line. If heights of start and
end along the axis differ, the arc is a helix.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.dialects.apt.statements import LENGTH_TOLERANCE, NEAR_MM, StatementError, numbers_of, values
from postproc.dialects.circles import Circle, tangent_circle
from postproc.frames import Array, norm

_MOST_TURNS = 10_000
"""Largest number of turns of a helix: more would be kilometres, so that the number means something else."""
_ARC_END_TOLERANCE_MM = 0.1
"""Distance between the end of an arc and the end by its stated angle: more than rounding, less than a turn."""
_CENTRE_TOLERANCE_MM = 1e-3
"""Distance between the centre of a circle and the beginning of its line; files state the same digits."""
ARC_ADVICE = "Let the CAM system write arcs as GOTO statements."
UNKNOWN_START = ("arc before the position is known", "Write a GOTO before it.")


class PendingArc(Struct, frozen=True, eq=False):
    """A circle for the GOTO that follows.

    :param row: row of the statement.
    :param may_have_points: True if more than one point may belong to the arc.
    :param angle: stated angle of the arc [rad]; None if the statement has none.
    :param turns: number of whole turns in addition to the arc to its end.
    """

    row: int
    circle: Circle
    may_have_points: bool = False
    angle: float | None = None
    turns: int = 0

    def sweep(self, start: Array, end: Array) -> float:
        """Return the angle of the arc [rad] from its start (3,) to its end (3,) [mm], with all its whole turns.

        :raises StatementError: start or end is not on the circle, or the stated angle leads to another end.
        """
        for name, point in (("start", start), ("end", end)):
            fault = self.circle.fault_at(point)
            if fault:
                raise StatementError(f"the {name} of the arc is {fault}", "Check centre, radius and direction.")
        sweep = self.circle.sweep(start, end) + 2.0 * np.pi * self.turns
        if self.angle is None:
            return sweep
        # the stated angle is rounded, and may include whole turns: of all angles to the end, the nearest to it
        nearest_sweep = sweep + round((self.angle - sweep) / (2.0 * np.pi)) * 2.0 * np.pi
        end_distance = abs(nearest_sweep - self.angle) * self.circle.radius
        if end_distance > _ARC_END_TOLERANCE_MM or nearest_sweep <= 0.0:  # an arc turns by more than 0
            degrees = f"{np.rad2deg(self.angle):.3f}° stated, {np.rad2deg(sweep):.3f}° to the end"
            raise StatementError(f"the angle of the arc disagrees with its end: {degrees}", ARC_ADVICE)
        return nearest_sweep


def turn_count(count: float | str) -> int:
    """Return the number behind TIMES: turns of a helix, where a part of a turn counts as one.

    :raises StatementError: the value is not a whole number, or out of range.
    """
    if not isinstance(count, float) or count != int(count) or not 1.0 <= count <= _MOST_TURNS:
        raise StatementError("TIMES is not a number of turns", ARC_ADVICE)
    return int(count)


def axis_distance(numbers: Array, point: Array) -> float:
    """Return the distance of a point (3,) from the axis of an arc; all lengths have the same unit.

    :param numbers: (6,) a point of the axis, and its direction.
    """
    axis = numbers[3:6] / np.maximum(norm(numbers[3:6]), LENGTH_TOLERANCE)  # not 0; `circle_of` checks that it is 1
    return float(norm(np.cross(point - numbers[:3], axis)))


def circle_of(numbers: Array, unit: float, *, is_right_hand: bool) -> Circle:
    """Return the circle of a statement in mm.

    :param numbers: (7,) centre, axis, radius, in the unit of the file.
    :param unit: length of a unit of the file [mm].
    :param is_right_hand: True if the arc turns right-handed about the axis, False if left-handed.
    :raises StatementError: the axis does not have length 1.
    """
    axis = numbers[3:6]
    if abs(norm(axis) - 1.0) > LENGTH_TOLERANCE:
        raise StatementError("the axis of the arc does not have length 1", "Check i, j, k.")
    axis = axis / norm(axis) * (1.0 if is_right_hand else -1.0)
    return Circle(numbers[:3] * unit, axis, float(numbers[6]) * unit)


def stated_angle(words: list[float | str]) -> tuple[Array, float]:
    """Return the circle of MOVARC as numbers (7,), centre, axis and radius, and the angle of the arc [rad].

    :param words: values behind ``MOVARC/``.
    :raises StatementError: the values are not those of an arc, or the angle is out of range.
    """
    if len(words) != 9 or words[7] != "ANGLE":  # x, y, z, i, j, k, r, ANGLE, a
        raise StatementError("MOVARC is not understood", "Write MOVARC/x,y,z,i,j,k,r,ANGLE,a.")
    numbers = numbers_of([*words[:7], words[8]], 8)
    if not 0.0 < numbers[7] <= 3600.0:  # up to ten turns
        raise StatementError("the angle of the arc is not above zero", ARC_ADVICE)
    return numbers[:7], float(np.deg2rad(numbers[7]))


def tangent_arc(code: str, direction: Array | None, start: Array | None, unit: float) -> tuple[Circle, Array]:
    """Return circle and end (3,) [mm] of the arc TLON,GOFWD/(CIRCLE/x,y,z,r),ON,(LINE/…).

    :param code: text behind the slash of GOFWD.
    :param direction: (3,) direction of INDIRV, in which the arc leaves its start; None: no INDIRV was read.
    :param start: (3,) start of the arc [mm]; None if it is not known.
    :param unit: length of a unit of the file [mm].
    :raises StatementError: the statement is not understood, or its parts contradict each other.
    """
    flat = code.replace("(", "").replace(")", "").replace("CIRCLE/", "").replace("LINE/", "L,")
    words = values(flat.removeprefix("CANON,"))
    advice = f"Only arcs along INDIRV are read. {ARC_ADVICE}"
    if direction is None or not code.startswith("(CIRCLE/") or "ON" not in words or "L" not in words:
        raise StatementError("TLON is not understood", advice)
    on_index, line_index = words.index("ON"), words.index("L")
    if words[on_index + 1 : line_index] not in ([], [2.0, "INTOF"]):
        raise StatementError("TLON is not understood", advice)
    centre = numbers_of(words[:on_index], 4, 7) * unit
    ends = numbers_of(words[line_index + 1 :], 6) * unit  # both ends of the line
    if start is None:
        raise StatementError(*UNKNOWN_START)
    circle = tangent_circle(start, direction, centre[:3], float(centre[-1]))
    if circle is None or norm(ends[:3] - centre[:3]) > _CENTRE_TOLERANCE_MM:
        raise StatementError("INDIRV, CIRCLE and LINE disagree", ARC_ADVICE)
    is_second_end = words[on_index + 1 : line_index] == [2.0, "INTOF"]
    sweep = circle.sweep(start, ends[3:])
    # the line meets the circle twice: the first end is up to half a turn from the start, the second end beyond.
    # Within a milliradian of half a turn, and for a whole turn, either form is accepted
    if sweep < 2.0 * np.pi and (sweep > np.pi + 1e-6) != is_second_end and abs(sweep - np.pi) > 1e-3:
        raise StatementError("the arc ends on the other side of its line", ARC_ADVICE)
    return circle, ends[3:]


class Compensation(Struct, frozen=True):
    """Cutter compensation that is on, between CUTCOM/LEFT or RIGHT and OFF.

    :param row: row of the statement that switched it on.
    :param side: 1 for LEFT, −1 for RIGHT.
    :param is_centre: True if the path is known to be that of the tool's centre.
    """

    row: int
    side: float
    is_centre: bool

    def shows_centre(self, circle: Circle, tool: Array, cutter_radius: float) -> bool:
        """Return whether an arc proves that the path is that of the tool's centre, and not of the contour.

        If the path were the contour, the control could not follow an arc whose tool is on the inside and larger than
        the arc. Such arcs, as in lead-ins, must be paths of the centre.

        :param tool: (3,) direction from the tip to the spindle.
        :param cutter_radius: radius of the cutter [mm]; NaN if it is not known: the result is False.
        """
        is_inside = self.side * float(circle.axis @ tool) > 0.0
        return is_inside and circle.radius < cutter_radius - NEAR_MM
