"""Mean and peak cutting forces over a turn, of edge that is in material.

Axes: x along the feed, z along the spindle from the tip to the spindle, y = z × x; φ from +y, growing clockwise seen
from the spindle, so that with M3 a tooth enters a slot at φ = 0 on the left. Forces act on the tool. With M4 everything
is mirrored in y.

A piece of edge with its normal n = (sin κ sin φ, sin κ cos φ, −cos κ), length b and chip thickness h = c·n, c being the
feed per tooth, has (Altintas and Lee, "Mechanics and dynamics of ball end milling", J. Manuf. Sci. Eng. 120, 1998;
Engin and Altintas, Int. J. Mach. Tools Manuf. 41, 2001)

    tangential  (Ktc h + Kte) b   along (−cos φ, sin φ, 0)
    radial      (Krc h + Kre) b   along −n
    axial       (Kac h + Kae) b   along (cos κ sin φ, cos κ cos φ, sin κ)

The mean over a turn is N/2π ∫ dφ of this over what is in material; on a cylinder (κ = 90°) that is the average force of
end milling in Altintas, "Manufacturing Automation", 2nd ed., 2012, Eq. (2.31). The end face (κ = 0) cuts where the feed
goes down: on a plunge this is the force of drilling and plunge milling, torque N R² (Ktc c + Kte)/2 and thrust
N R (Krc c + Kre) (Altintas and Ko, CIRP Annals 55, 2006); with Krc = Ktc/2 the thrust is that of drilling tables,
Ff = 0.5 kc fn D/2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from postproc.frames import Array
from postproc.machining.material import CuttingLaw
from postproc.machining.sampling import Engaged
from postproc.machining.stock import Floats
from postproc.machining.tool import BOTTOM, CORNER, SIDE, Cutter, Edge

_HELIX_PARTS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """Angles and pieces of edge of one turn, and what each adds to the wrench.

    :param phi: (K,) angles [rad], the middles of equal parts of the front (half a turn) or of the whole turn.
    :param front: (K, S) and across, down: components of the normal along x, y and −z.
    :param cut: (K·S, 6) wrench about the tip per engaged length and per chip [N/m², N/m]; of the cylinder without what
        the height of the force adds to the moment.
    :param rub: (K·S, 6) the same per engaged length alone [N/m, N].
    :param whole: True for a whole turn.
    """

    edge: Edge
    law: CuttingLaw
    teeth: int
    phi: Array
    front: Floats
    across: Floats
    down: Floats
    cut: Floats
    rub: Floats
    whole: bool

    @classmethod
    def of(cls, edge: Edge, cutter: Cutter, law: CuttingLaw, step: float, *, whole: bool) -> Turn:
        """Divide a turn so that angles are about `step` [m] apart at the rim."""
        half = cutter.teeth * max(int(np.ceil(np.pi * cutter.radius / step / cutter.teeth)), -(-24 // cutter.teeth))
        width = np.pi / half
        phi = (np.arange(2 * half if whole else half) + 0.5) * width
        sine, cosine = np.sin(phi)[:, None], np.cos(phi)[:, None]
        sk, ck = np.sin(edge.kappa)[None], np.cos(edge.kappa)[None]
        ck = np.where(np.abs(ck) < 1e-12, 0.0, ck)
        zero = np.zeros((len(phi), len(edge.kappa)))
        normal = np.stack([sk * sine, sk * cosine, zero - ck], axis=-1)
        tangential = np.stack([zero - cosine, zero + sine, zero], axis=-1)
        along = np.stack([ck * sine, ck * cosine, zero + sk], axis=-1)
        z = edge.low + np.where(edge.part == CORNER, 0.5 * np.where(np.isfinite(edge.rise), edge.rise, 0.0), 0.0)
        z = np.where(edge.part == SIDE, 0.0, z)
        point = np.stack([edge.radius * sine, edge.radius * cosine, zero + z], axis=-1)
        share = cutter.teeth * width / (2.0 * np.pi)

        def wrench(k: tuple[float, float, float]) -> Floats:
            force = k[0] * tangential - k[1] * normal + k[2] * along
            both = np.concatenate([force, np.cross(point, force)], axis=-1) * share
            return np.asarray(both.reshape(-1, 6), dtype=np.float32)

        parts = (normal[..., 0], normal[..., 1], -normal[..., 2])
        front, across, down = (np.asarray(one, dtype=np.float32) for one in parts)
        return cls(
            edge,
            law,
            cutter.teeth,
            np.asarray(phi, dtype=float),
            front,
            across,
            down,
            wrench(law.cutting),
            wrench(law.edge),
            whole,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Loads:
    """What the edge in material of a turn adds up to, at n stations.

    :param wrench: (n, 6) mean force [N] and moment about the tip [N·m] on the tool, in the axes above.
    :param removal: (n,) volume removed in one turn by one tooth [m³].
    """

    wrench: Array
    removal: Array


def chips(turn: Turn, feed: Floats, descent: Floats, other: tuple[Floats, Floats, Floats] | None = None) -> Floats:
    """Return the chip thickness (n, K, S) [m]: feed per tooth along x (n,) and down (n,) [m].

    :param other: another feed direction (x, y, down), (n,) each: where its chips would be none, neither are these.
    """
    chip = feed[:, None, None] * turn.front + descent[:, None, None] * turn.down
    if other is not None:
        x, y, down = (one[:, None, None] for one in other)
        chip[x * turn.front + y * turn.across + down * turn.down <= 0.0] = 0.0
    return np.asarray(np.maximum(chip, 0.0))


def mean(turn: Turn, inside: Engaged, chip: Floats, plunging: Floats) -> Loads:
    """Return mean loads.

    :param chip: (n, K, S) from `chips`.
    :param plunging: (n,) sine of the angle by which the feed goes down, 0 … 1: this share of the rubbing of the end
        face counts. On level cuts published coefficients contain it, on a plunge it acts in full; between, this is
        an assumption.
    """
    n = len(chip)
    cutting = inside.length * turn.law.chip(chip)
    rubbing = inside.length * (chip > 0.0)
    bottom = turn.edge.part == BOTTOM
    if bottom.any():
        rubbing[:, :, bottom] *= plunging[:, None, None]
    wrench = (cutting.reshape(n, -1) @ turn.cut + rubbing.reshape(n, -1) @ turn.rub).astype(float)
    side = np.flatnonzero(turn.edge.part == SIDE)
    if len(side):
        at = slice(int(side[0]), None, len(turn.edge.part))
        thin = chip[:, :, side[0]]
        push = (inside.moment * turn.law.chip(thin)) @ turn.cut[at, :2] + (inside.moment * (thin > 0.0)) @ turn.rub[
            at, :2
        ]
        wrench[:, 3] -= push[:, 1]
        wrench[:, 4] += push[:, 0]
    width = np.float32(turn.phi[1] - turn.phi[0])
    removal = np.einsum("nks,nks,s->n", inside.length, chip, turn.edge.radius.astype(np.float32) * width)
    return Loads(wrench, np.asarray(removal, dtype=float))


def peak(turn: Turn, inside: Engaged, chip: Floats, cutter: Cutter) -> tuple[Array, Array]:
    """Return the largest force [N] and torque [N·m] within a turn, (n,) each, with the helix of the tool."""
    n, angles, pieces = inside.length.shape
    whole = angles if turn.whole else 2 * angles
    width = 2.0 * np.pi / whole
    share = cutter.teeth * width / (2.0 * np.pi)
    columns = [0, 1, 2, 5]
    cut, rub = (one.reshape(angles, pieces, 6)[:, :, columns] / np.float32(share) for one in (turn.cut, turn.rub))
    law, cuts = turn.law.chip(chip), (chip > 0.0).astype(np.float32)
    side = turn.edge.part == SIDE
    total = np.zeros((n, 2 * whole, 4), dtype=np.float32)
    if not side.all():
        length = inside.length[:, :, ~side]
        total[:, :angles] = np.einsum("nks,ksj->nkj", length * law[:, :, ~side], cut[:, ~side])
        total[:, :angles] += np.einsum("nks,ksj->nkj", length * cuts[:, :, ~side], rub[:, ~side])
    if side.any():
        piece = int(np.flatnonzero(side)[0])
        own = law[:, :, piece, None] * cut[:, piece] + cuts[:, :, piece, None] * rub[:, piece]
        length = inside.length[:, :, piece]
        parts = _HELIX_PARTS if cutter.helix > 0.0 else 1
        height = length.max() / parts
        for k in range(parts):
            lag = round((k + 0.5) * height * np.tan(cutter.helix) / cutter.radius / width) % whole
            layer = np.minimum(np.maximum(length - np.float32(k * height), 0.0), height)
            total[:, lag : lag + angles] += layer[..., None] * own
    total = total[:, :whole] + total[:, whole:]
    step = whole // cutter.teeth
    together = total.reshape(n, cutter.teeth, step, 4).sum(axis=1)
    force = np.sqrt((together[..., :3] ** 2).sum(axis=-1)).max(axis=1)
    return np.asarray(force), np.abs(together[..., 3]).max(axis=1)
