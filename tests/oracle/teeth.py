"""Milling tooth by tooth: a cutter turns in small steps, every piece of every tooth is looked at, forces are averaged.

Shares no code with the package. Units: mm, N, N·mm. The cutter turns clockwise seen from the spindle (M3) unless `hand`
is −1. Its teeth are straight; the mean over a turn does not depend on the helix.
"""

from __future__ import annotations

import math

import numpy as np


class Teeth:
    """A cutter, mm, and what the material does to it: six numbers, or (kc1.1, mc, radial ratio)."""

    def __init__(self, radius, corner, teeth, linear=None, kienzle=None, discs=160):
        self.radius, self.corner, self.teeth = radius, corner, teeth
        self.linear, self.kienzle = linear, kienzle
        self.rubbing = 1.0
        self.pieces = []  # (distance from the axis, height above the tip, length of edge, angle of its normal)
        if corner > 0:
            for k in range(discs):
                angle = (k + 0.5) * (math.pi / 2) / discs
                distance = radius - corner + corner * math.sin(angle)
                height = corner - corner * math.cos(angle)
                self.pieces.append((distance, height, corner * (math.pi / 2) / discs, angle))

    def side(self, depth, discs=200):
        """Add the cylinder above the corner, up to a height above the tip."""
        step = (depth - self.corner) / discs
        for k in range(discs):
            self.pieces.append((self.radius, self.corner + (k + 0.5) * step, step, math.pi / 2))
        return self

    def face(self, rubbing, rings=40):
        """Add the end face, of whose rubbing a share counts: it cuts where the feed goes down."""
        for k in range(rings):
            width = (self.radius - self.corner) / rings
            self.pieces.append(((k + 0.5) * width, 1e-6, width, 0.0))
        self.rubbing = rubbing
        return self

    def _force(self, chip, length, kappa):
        """Return tangential, radial and axial force of pieces."""
        if self.kienzle is not None:
            kc, mc, ratio = self.kienzle
            tangential = np.where(chip > 0, kc * np.maximum(chip, 1e-12) ** (1 - mc), 0.0) * length
            return tangential, ratio * tangential, 0.0 * tangential
        ktc, kte, krc, kre, kac, kae = self.linear
        cuts, rub = chip > 0, np.where(kappa > 0, 1.0, self.rubbing)
        return tuple(cuts * (k * chip + e * rub) * length for k, e in ((ktc, kte), (krc, kre), (kac, kae)))

    def mean(self, tip, direction, per_tooth, material, hand=1, steps=1440):
        """Return mean force (3,) in x along the feed, y to its left, z up, and mean torque [N·mm]: see `wrench`."""
        wrench = self.wrench(tip, direction, per_tooth, material, hand, steps)
        return wrench[:3], wrench[5] * hand

    def wrench(self, tip, direction, per_tooth, material, hand=1, steps=1440):
        """Return mean force and moment about the tip (6,) in x along the feed, y to its left, z up [N, N·mm].

        :param tip: where the tip is; `direction` of the feed, a unit vector; `per_tooth` the feed per tooth.
        :param material: of points (n, 3): is there material, other than what this way has cut so far?
        """
        tip, direction = np.asarray(tip, float), np.asarray(direction, float)
        level = math.hypot(direction[0], direction[1])
        ahead = np.array([direction[0] / level, direction[1] / level, 0.0])
        left = np.array([-ahead[1], ahead[0], 0.0])
        distance, height, length, kappa = np.array(self.pieces).T
        turned = 2 * math.pi * (np.arange(steps) + 0.5)[:, None] / steps
        up = np.array([0.0, 0.0, 1.0])
        # each tooth makes the same whole turn through the same material
        out = (np.sin(turned) * ahead + hand * np.cos(turned) * left)[:, None]  # from the axis to the tooth
        moves = np.cos(turned) * ahead - hand * np.sin(turned) * left  # where it goes
        normal = np.sin(kappa)[:, None] * out - np.cos(kappa)[:, None] * up
        chip = per_tooth * normal @ direction
        step, piece = np.nonzero(chip > 0)
        lever = distance[piece, None] * out[step, 0] + height[piece, None] * up
        in_material = material(tip + lever)
        step, piece, lever = step[in_material], piece[in_material], lever[in_material]
        out, moves, normal, kappa = out[step, 0], moves[step], normal[step, piece], kappa[piece]
        tangential, radial, axial = self._force(chip[step, piece], length[piece], kappa)
        upwards = np.cos(kappa)[:, None] * out + np.sin(kappa)[:, None] * up
        force = -tangential[:, None] * moves - radial[:, None] * normal + axial[:, None] * upwards
        total = self.teeth * force.sum(axis=0) / steps
        moment = self.teeth * np.cross(lever, force).sum(axis=0) / steps
        return np.array([each @ axis for each in (total, moment) for axis in (ahead, left, np.array([0, 0, 1.0]))])
