"""Rotary axes of a G-code program: direction of the tool, and place of the part.

With tool-centre-point control X, Y, Z are the tip in the part. Indexed axes turn the part instead: X, Y, Z are machine
axes, and the tool stays along Z of the machine. A point x of the machine is then at T₁·T₂·x in the part, where Tₖ turns
by the angle of axis k about its place, from the part outwards (ISO 841: a positive angle turns the tool relative to the
part by the right-hand rule). Or the words I, J, K of G0 and G1 are the direction of the tool, as after G43.5 (Fanuc,
tool-centre-point control type 2): the "angles" below are its three components then.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.cell import Rotary
from postproc.dialects.gcode.words import Fault
from postproc.frames import M_PER_MM, RAD_PER_DEG, Array, norm, rotation_from_vector
from postproc.program import Ints, direction

KIND_ADVICE = (
    'Write in [rotary] of the cell kind = "tcp" if X, Y, Z are the tool tip in the part (tool-centre-point control), '
    'or kind = "indexed" and the place of each axis if the part turns and X, Y, Z are machine axes.'
)
_OPPOSITE_COSINE = -0.985
"""Cosine of 170°: beyond it, rounding decides on the plane in which the tool turns."""
_INDEXED_ADVICE = 'Write kind = "tcp" in [rotary] of the cell if X, Y, Z are the tool tip in the part.'


class RotaryAxes(Struct, frozen=True, eq=False):
    """Rotary axes of the machine for which a program was written.

    :param directions: (k, 3) unit vectors with sign, from the part outwards: in the program frame, of indexed axes in
        `$BASE`.
    :param points: (k, 3) points of indexed axes in `$BASE` [m]; None with tool-centre-point control.
    :param upright: (k,) angles with the tool along z, where programs begin [deg]; (0, 0, 1) of directions.
    """

    directions: Array
    points: Array | None
    upright: Array

    @classmethod
    def from_cell(cls, rotary: Rotary | None) -> RotaryAxes:
        """Return the rotary axes of `rotary`, the table of a cell; None: the cell has no axes.

        Directions of the tool count as "angles" without axes, which are (0, 0, 1) where the tool is upright.
        """
        if rotary is None:
            return cls(np.zeros((0, 3)), None, np.zeros(0))
        if rotary.kind == "vector":
            return cls(np.zeros((0, 3)), None, np.array([0.0, 0.0, 1.0]))
        upright = np.zeros(len(rotary.axes))
        signs = np.array(rotary.signs or [1] * len(rotary.axes), dtype=float)[:, None]
        places = [place for place in rotary.places if place is not None]
        if rotary.kind != "indexed":
            return cls(signs * np.eye(3)[["ABC".index(letter) for letter in rotary.axes]], None, upright)
        directions = np.array([place.direction for place in places])
        unit_directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        return cls(signs * unit_directions, np.array([place.point for place in places]) * M_PER_MM, upright)

    @property
    def turns_part(self) -> bool:
        """Whether the axes turn the part, and X, Y, Z are machine axes."""
        return self.points is not None

    def tool_direction(self, degrees: Array) -> Array:
        """Return the unit vectors (n, 3) from the tip to the spindle in the program frame, for angles (n, k) [deg].

        With indexed axes the program frame turns with the part in such a way that the tool is along its Z.
        """
        if self.turns_part:
            return np.broadcast_to([0.0, 0.0, 1.0], (len(degrees), 3))
        return direction(self.directions, degrees * RAD_PER_DEG)

    def part_from_machine(self, degrees: Array) -> Array:
        """Return the pose (4, 4) [m] that maps points of the machine to the part, in `$BASE`, for angles (k,) [deg].

        With tool-centre-point control it is the identity. With indexed axes it is T₁·T₂, see the module.
        """
        pose = np.eye(4)
        if self.points is None:
            return pose
        for axis, point, angle in zip(self.directions, self.points, degrees * RAD_PER_DEG, strict=True):
            turn = np.eye(4)
            turn[:3, :3] = rotation_from_vector(axis * angle)
            turn[:3, 3] = point - turn[:3, :3] @ point
            pose = pose @ turn
        return pose


def kind_faults(rotary: Rotary, words: Array, tcp_on: Ints) -> list[Fault]:
    """Return the faults of a program whose use of rotary axes does not agree with `kind` in [rotary] of the cell.

    :param words: (L, k) words of the rotary axes [deg], or (L, 3) directions of the tool; NaN where absent.
    :param tcp_on: (n,) rows that switch tool-centre-point control on.
    """
    if rotary.kind == "indexed" and len(tcp_on):
        return [Fault(int(tcp_on[0]), "tool-centre-point control, and the rotary axes are indexed", _INDEXED_ADVICE)]
    if rotary.kind == "vector":
        return _direction_faults(words)
    turn_rows = np.flatnonzero(np.nan_to_num(words).any(axis=1))
    if rotary.kind is None and len(turn_rows):
        return [Fault(int(turn_rows[0]), "rotary axes turn, and the cell does not say what X, Y, Z are", KIND_ADVICE)]
    return []


def _direction_faults(words: Array) -> list[Fault]:
    """Return the faults of directions of the tool, at most one for each line.

    Turns of more than 170° are only looked for if all directions are complete and not zero.

    :param words: (L, 3) I, J, K of each line; NaN where absent.
    """
    is_given = ~np.isnan(words)
    rows = np.flatnonzero(is_given.any(axis=1))
    is_partial = ~is_given[rows].all(axis=1)
    advice = "Give all three: controls do not agree on what a missing one means."
    faults = [Fault(int(row), "a direction of the tool without I, J or K", advice) for row in rows[is_partial]]
    rows = rows[~is_partial]
    directions = np.concatenate([[[0.0, 0.0, 1.0]], words[rows]])  # the tool begins upright
    length = norm(directions)
    faults += [Fault(int(row), "I0 J0 K0 is no direction", "Check I, J and K.") for row in rows[length[1:] == 0.0]]
    if faults:
        return sorted(faults, key=lambda fault: fault.row)
    unit_directions = directions / length[:, None]
    is_opposite = (unit_directions[1:] * unit_directions[:-1]).sum(axis=1) < _OPPOSITE_COSINE
    advice = "Let the CAM system write more points where the tool turns."
    return [Fault(int(row), "the tool turns by more than 170° in one line", advice) for row in rows[is_opposite]]
