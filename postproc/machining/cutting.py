"""Mean cutting forces over a turn, from the edge in material.

Axes: x along the feed, z along the spindle from the tip to the spindle, y = z × x; φ from +y, growing clockwise seen
from the spindle, so that with M3 a tooth enters a slot at φ = 0 on the left. Forces act on the tool. With M4 everything
is mirrored in y.

A piece of edge with its normal n = (sin κ sin φ, sin κ cos φ, −cos κ), length b and chip thickness h = c·n, c being the
feed per tooth, has (Altintas and Lee, "Mechanics and dynamics of ball end milling", J. Manuf. Sci. Eng. 120, 1998;
Engin and Altintas, Int. J. Mach. Tools Manuf. 41, 2001)

    tangential  (Ktc h + Kte) b   along (−cos φ, sin φ, 0)
    radial      (Krc h + Kre) b   along −n
    axial       (Kac h + Kae) b   along (cos κ sin φ, cos κ cos φ, sin κ)

The mean over a turn is N/2π ∫ dφ of this over the edge in material; on a cylinder (κ = 90°) that is the average force
of end milling in Altintas, "Manufacturing Automation", 2nd ed., 2012, Eq. (2.31). The end face (κ = 0) cuts where the
feed goes down: on a plunge this is the force of drilling and plunge milling, torque N R² (Ktc c + Kte)/2 and thrust
N R (Krc c + Kre) (Altintas and Ko, CIRP Annals 55, 2006); with Krc = Ktc/2 the thrust is that of drilling tables,
Ff = 0.5 kc fn D/2.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.frames import Array
from postproc.machining.sampling import Engaged
from postproc.machining.stock import Floats
from postproc.machining.turn import Turn

_ONE_THREAD = 200_000
"""Products below which OpenBLAS keeps to one thread (its limit is 2^18)."""


class Loads(Struct, frozen=True, eq=False):
    """Sums over the edge in material in a turn, at n stations.

    :param wrench: (n, 6) mean force [N] and moment about the tip [N·m] on the tool, in the axes above.
    :param removal: (n,) volume removed in one turn by one tooth [m³].
    """

    wrench: Array
    removal: Array


def chips(turn: Turn, feed: Floats, descent: Floats, other: tuple[Floats, Floats, Floats] | None = None) -> Floats:
    """Return the chip thickness (n, P) [m]: feed per tooth along x (n,) and down (n,) [m].

    :param other: another feed direction (x, y, down), (n,) each: chips are 0 where this direction would cut none.
    """
    chip = feed[:, None] * turn.front
    chip += descent[:, None] * turn.down
    if other is not None:
        x, y, down = (one[:, None] for one in other)
        chip[x * turn.front + y * turn.across + down * turn.down <= 0.0] = 0.0
    return np.asarray(np.maximum(chip, 0.0, out=chip))


def mean(turn: Turn, inside: Engaged, chip: Floats, plunging: Floats) -> Loads:
    """Return mean loads.

    :param chip: (n, P) from `chips`.
    :param plunging: (n,) sine of the angle by which the feed goes down, 0 … 1: this share of the rubbing of the end
        face counts. On level cuts published coefficients contain it, on a plunge it acts in full; between, this is
        an assumption.
    """
    cutting = inside.length * turn.law.chip(chip)
    rubbing = inside.length * (chip > 0.0)
    rubbing[:, turn.bottom] *= plunging[:, None]
    wrench = (times(cutting, turn.cut) + times(rubbing, turn.rub)).astype(float)
    thin = chip[:, turn.side]
    push = times(inside.moment * turn.law.chip(thin), turn.cut[turn.side, :2])
    push += times(inside.moment * (thin > 0.0), turn.rub[turn.side, :2])
    wrench[:, 3] -= push[:, 1]
    wrench[:, 4] += push[:, 0]
    removal = times(inside.length * chip, (turn.radius * turn.width.astype(np.float32))[:, None])[:, 0]
    return Loads(wrench, np.asarray(removal, dtype=float))


def times(one: Floats, other: Floats) -> Floats:
    """Return the product of matrices (n, P) and (P, k), in blocks small enough for BLAS to use one thread.

    At such sizes threads cost more than they gain, and much more if other processes need the processors too.
    """
    rows = max(1, _ONE_THREAD // max(1, other.size))
    return np.concatenate([one[k : k + rows] @ other for k in range(0, max(1, len(one)), rows)])
