"""The edge of a tooth within a turn, as sample points for the engagement."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.frames import Array
from postproc.machining.material import CuttingLaw
from postproc.machining.stock import Floats
from postproc.machining.tool import BOTTOM, CORNER, SIDE, Cutter, Edge

_LEAST = 8
"""Minimum number of sample points in half a turn."""


class Turn(Struct, frozen=True, eq=False):
    """P sample points of the edge of a tooth within a turn, and the contribution of each to the wrench.

    Points are about as far apart on small circles as on the rim; points of one kind of edge are contiguous.

    :param phi: (P,) angles [rad], the middles of parts of the turn that are `width` (P,) wide.
    :param radius: (P,) distance from the axis [m]; low: (P,) height of the lower end of the piece of edge above the
        tip [m]; rise: (P,) its height [m], 0 on the end face, infinite on the cylinder; length: (P,) along it [m].
    :param bottom: slice of the points on the end face, and round, side: of the corner and of the cylinder.
    :param front: (P,) and across, down: components of the normal along x, y and −z.
    :param cut: (P, 6) wrench about the tip per engaged length and per chip [N/m², N/m]; on the cylinder without the
        moment due to the height of the force.
    :param rub: (P, 6) the same per engaged length alone [N/m, N].
    :param tall: (P, A) height of the edge over its length for each of A angles of the turn that the point covers, or 0.
    """

    law: CuttingLaw
    teeth: int
    phi: Array
    width: Array
    radius: Floats
    low: Floats
    rise: Floats
    length: Floats
    bottom: slice
    round: slice
    side: slice
    front: Floats
    across: Floats
    down: Floats
    cut: Floats
    rub: Floats
    tall: Floats

    @classmethod
    def of(cls, edge: Edge, cutter: Cutter, law: CuttingLaw, step: float, descent: float) -> Turn:
        """Divide a turn so that points are about `step` [m] apart.

        :param descent: sine of the steepest downward angle of the feed, < 0 upward: points without a possible chip
            are omitted.
        """
        half = cutter.teeth * max(int(np.ceil(np.pi * cutter.radius / step / cutter.teeth)), -(-24 // cutter.teeth))
        piece, phi, width = [], [], []
        for place, radius in enumerate(edge.radius.tolist()):
            wide = 1
            while half % (2 * wide) == 0 and half // (2 * wide) >= _LEAST and 2 * wide * radius <= cutter.radius:
                wide *= 2
            count = 2 * half // wide
            piece.append(np.full(count, place))
            phi.append((np.arange(count) + 0.5) * (2.0 * np.pi / count))
            width.append(np.full(count, 2.0 * np.pi / count))
        own, angle, wide_ = (np.concatenate(column) for column in (piece, phi, width))
        sine, cosine = np.sin(angle), np.cos(angle)
        sk, ck = np.sin(edge.kappa)[own], np.cos(edge.kappa)[own]
        ck = np.where(np.abs(ck) < 1e-12, 0.0, ck)
        cuts = sk * sine * np.sqrt(1.0 - descent**2) + ck * descent > 1e-9
        if not cuts.any():
            cuts[:] = True
        own, angle, wide_, sine, cosine, sk, ck = (column[cuts] for column in (own, angle, wide_, sine, cosine, sk, ck))
        zero, part, rise = np.zeros(len(own)), edge.part[own], edge.rise[own]
        normal = np.stack([sk * sine, sk * cosine, zero - ck], axis=-1)
        tangential = np.stack([zero - cosine, sine, zero], axis=-1)
        along = np.stack([ck * sine, ck * cosine, sk], axis=-1)
        z = np.where(part == CORNER, edge.low[own] + 0.5 * np.where(np.isfinite(rise), rise, 0.0), 0.0)
        point = np.stack([edge.radius[own] * sine, edge.radius[own] * cosine, z], axis=-1)
        share = (cutter.teeth * wide_ / (2.0 * np.pi))[:, None]

        def wrench(k: tuple[float, float, float]) -> Floats:
            force = k[0] * tangential - k[1] * normal + k[2] * along
            return np.asarray(np.concatenate([force, np.cross(point, force)], axis=-1) * share, dtype=np.float32)

        def single(column: Array) -> Floats:
            return np.ascontiguousarray(column, dtype=np.float32)

        first, second, third, end = np.searchsorted(part, [BOTTOM, CORNER, SIDE, SIDE + 1]).tolist()
        height = (np.where(np.isfinite(rise), rise, 1.0) / edge.length[own])[:, None]
        return cls(
            law, cutter.teeth, angle, wide_, single(edge.radius[own]), single(edge.low[own]), single(rise),
            single(edge.length[own]), slice(first, second), slice(second, third), slice(third, end),
            single(normal[:, 0]), single(normal[:, 1]), single(-normal[:, 2]), wrench(law.cutting), wrench(law.edge),
            single(_covered(angle, wide_, 2 * half) * height),
        )  # fmt: skip


def _covered(phi: Array, width: Array, number: int) -> Floats:
    """Return which of equal parts of a turn are covered (P, number): 1 or 0.

    :param phi: (P,) centre of the covered interval [rad].
    :param width: (P,) its width [rad].
    """
    middle = (np.arange(number) + 0.5) * (2.0 * np.pi / number)
    off = np.abs((middle - phi[:, None] + np.pi) % (2.0 * np.pi) - np.pi)
    return np.asarray(off < 0.5 * width[:, None] - 1e-9, dtype=np.float32)
