"""How two programs differ."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.comparison.curves import Curves
from postproc.errors import Level
from postproc.frames import Array, norm
from postproc.program import SPL, Bools, Ints, Program


class Cuts(Struct, frozen=True, eq=False):
    """Where the tip would stand at the pairs, under the same force, from its nominal position [m].

    :param wrench: (P, 6) at the tip, `$BASE` axes of the nominal program [N, N·m].
    :param nominal: (P, 3) by the nominal program, its `$BASE`.
    :param corrected: (P, 3) by the corrected one.
    :param turned: (P,) by how much the corrected one turns the loaded tool from its nominal orientation [rad].
    :param row: (B,) rows of `corrected.motions` that are looked at between pairs, never decreasing; `t` (B,) where.
        Inserted targets (t = 1) are among them.
    :param between_nominal: (B,) there, how far it would stand from its place on the nominal path by the nominal
        program; `between_corrected` (B,) how far from that path by the corrected one [m].
    :param between_turned: (B,) by how much the corrected one turns the loaded tool there from the nominal path [rad],
        at inserted targets; 0 elsewhere.
    :param share: (B,) where on the nominal motion that is.
    """

    wrench: Array
    nominal: Array
    corrected: Array
    turned: Array
    row: Ints
    t: Array
    between_nominal: Array
    between_corrected: Array
    between_turned: Array
    share: Array


class Difference(Struct, frozen=True):
    """What differs besides offsets, or could not be compared.

    :param level: ``"error"``: the second program must not be run; ``"warning"``: look at it.
    :param kind: short stable name.
    :param message: one sentence for the user.
    :param nominal: file and line of the nominal program where it is first, if it stands there.
    :param corrected: file and line of the second one; likewise.
    :param count: of places.
    """

    level: Level
    kind: str
    message: str
    nominal: tuple[str, int] | None = None
    corrected: tuple[str, int] | None = None
    count: int = 1


class Comparison(Struct, frozen=True, eq=False):
    """The targets of two programs. Row i of the pairs' arrays is the same pair; SI units.

    :param nominal: the first program.
    :param corrected: the second.
    :param robot: name of the robot model.
    :param pair: (P, 2) rows of `nominal.motions` and of `corrected.motions`, in order.
    :param inserted: rows of `corrected.motions` on the path between two pairs.
    :param only_nominal: rows of `nominal.motions` without a partner.
    :param only_corrected: rows of `corrected.motions` without a partner that do not stand on the path.
    :param pose: (P, 4, 4) where the second program commands the nominal program's tool, in the nominal `$BASE` [m].
    :param rotation: (P,) angle between the two orientations [rad].
    :param curves: both paths between the pairs; None for less than two.
    :param between: (P,) how far they are apart at most on the way to each pair from the one before [m]; NaN for the
        first, and where a PTP is between.
    :param cuts: what each would cut, where forces are known.
    :param differences: what differs besides.
    """

    nominal: Program
    corrected: Program
    robot: str
    pair: Ints
    inserted: Ints
    only_nominal: Ints
    only_corrected: Ints
    pose: Array
    rotation: Array
    curves: Curves | None
    between: Array
    cuts: Cuts | None
    differences: tuple[Difference, ...]

    @property
    def nominal_line(self) -> Ints:
        """(P,) line of each pair in the nominal program."""
        return np.asarray(self.nominal.motions.line[self.pair[:, 0]])

    @property
    def corrected_line(self) -> Ints:
        """(P,) line of each pair in the corrected program."""
        return np.asarray(self.corrected.motions.line[self.pair[:, 1]])

    @property
    def rapid(self) -> Bools:
        """(P,) True for moves without cutting force."""
        return np.asarray(self.nominal.motions.rapid[self.pair[:, 0]])

    @property
    def target(self) -> Array:
        """(P, 4, 4) nominal targets, `$BASE` [m]."""
        return np.asarray(self.nominal.motions.target[self.pair[:, 0]])

    @property
    def offset(self) -> Array:
        """(P, 3) from the nominal to the commanded position, nominal `$BASE` [m]."""
        return np.asarray(self.pose[:, :3, 3] - self.target[:, :3, 3])

    @property
    def distance(self) -> Array:
        """(P,) length of the offsets [m]."""
        return norm(self.offset)

    @property
    def speeds(self) -> Array:
        """(P, 2) programmed speeds of both programs [m/s]; NaN where unknown, as for PTP."""
        return np.stack([self.nominal.motions.feed[self.pair[:, 0]], self.corrected.motions.feed[self.pair[:, 1]]], 1)

    @property
    def speed_differs(self) -> Bools:
        """(P,) True where the speeds differ by more than their digits."""
        one, other = self.speeds.T
        return np.asarray(np.abs(one - other) > 1e-3 * np.abs(one) + 1e-6)

    @property
    def spline(self) -> Bools:
        """(P,) True where the way to the target is a piece of a spline in both, which is not compared."""
        one, other = self.nominal.motions.kind[self.pair[:, 0]], self.corrected.motions.kind[self.pair[:, 1]]
        return np.asarray((one == SPL) & (other == SPL))
