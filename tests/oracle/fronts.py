"""Mean milling forces along a path in space, exact in geometry: no map, no cells, no grouping of moves.

A point of the cutter's surface is in material if it is in the stock and outside of all that the cutter swept before:
capsules for a ball, the swept solid for flat and bull-nose cutters; dense poses for a tool that turns while it moves.
Each point of the surface that moves outwards makes the force of the linear edge-force model, averaged over a turn.
Shares no code with the package. Units: mm, N, N·mm. The tool turns clockwise seen from the spindle (M3).
"""

from __future__ import annotations

import math

import numpy as np

SLACK = 1e-6
"""A point that is inside of the swept solid by less counts as being on it [mm]."""
_BLOCK = 48
"""Moves with which points are compared at a time, nearest first."""


class Cutter:
    """A cylinder with a rounded corner, mm; and its surface as points of equal steps."""

    def __init__(self, radius, corner, teeth, step=0.06, top=None):
        """Divide the surface, up to a height `top` above the tip, into patches of about `step` [mm].

        Points are staggered from angle to angle, so that they do not meet the edge of the material in rows.
        """
        self.radius, self.corner, self.teeth = radius, corner, teeth
        flat, quarter, parts = radius - corner, 0.5 * math.pi * corner, []
        side = 0.0 if top is None else max(0.0, top - corner)
        for start, length in ((0.0, flat), (flat, quarter), (flat + quarter, side)):
            count = math.ceil(length / step)
            parts += [(start + (k + 0.5) * length / count, length / count) for k in range(count)]
        columns = []  # place along the edge from the axis, length of edge and share of a turn, angle
        for middle, length in parts:
            count = max(16, math.ceil(2.0 * math.pi * min(middle, radius) / step))
            row = np.arange(count)
            stagger = (row * 0.618034 + len(columns) * 0.381966) % 1.0 - 0.5
            angle = (row + 0.5) * 2.0 * math.pi / count
            columns.append(np.stack([middle + stagger * length, np.full(count, length / count), angle]))
        place, self.weight, angle = np.concatenate(columns, axis=1)
        kappa = np.clip((place - flat) / corner, 0.0, 0.5 * math.pi) if corner > 0.0 else (place > flat) * 0.5 * math.pi
        distance = np.minimum(place, flat) + corner * np.sin(kappa)
        height = corner * (1.0 - np.cos(kappa)) + np.maximum(place - flat - quarter, 0.0)
        self.area = 2.0 * math.pi * distance * self.weight
        zero, sine, cosine = 0.0 * angle, np.sin(angle), np.cos(angle)
        self.point = np.stack([distance * sine, distance * cosine, height], axis=-1)
        self.normal = np.stack([np.sin(kappa) * sine, np.sin(kappa) * cosine, -np.cos(kappa)], axis=-1)
        self.moves = np.stack([cosine, -sine, zero], axis=-1)
        self.upwards = np.stack([np.cos(kappa) * sine, np.cos(kappa) * cosine, np.sin(kappa)], axis=-1)
        self.face = kappa < 1e-9

    def height(self, distance):
        """Height of the lower side above the tip at a distance from the axis; infinite beyond the radius."""
        over = np.clip(distance - (self.radius - self.corner), 0.0, self.corner)
        return np.where(
            distance < self.radius, self.corner - np.sqrt(np.maximum(self.corner**2 - over**2, 0.0)), np.inf
        )

    def swept(self, point, begin, end):
        """Whether points (n, 3) are inside of what each of the moves (k, 3) sweeps with an upright tool: (n, k)."""
        chord = end - begin
        run = np.hypot(chord[:, 0], chord[:, 1])
        unit = np.where(run[:, None] > 1e-12, chord[:, :2] / np.maximum(run, 1e-12)[:, None], [1.0, 0.0])
        x, y = (point[:, None, k] - begin[:, k] for k in (0, 1))
        along, aside = x * unit[:, 0] + y * unit[:, 1], x * unit[:, 1] - y * unit[:, 0]
        reach = self.radius - SLACK
        meets = (np.abs(aside) < reach) & (along > -reach) & (along < run + reach)
        row, move = np.nonzero(meets)  # few of all pairs: the others are outside of the cylinder
        off, chord, run, lift = point[row] - begin[move], chord[move], run[move], chord[move, 2]
        along, aside = along[row, move], aside[row, move]
        half = np.sqrt(reach**2 - aside**2)
        share = 1.0 / np.maximum(run, 1e-12)
        low, high = np.maximum((along - half) * share, 0.0), np.minimum((along + half) * share, 1.0)
        still = run <= 1e-12  # straight up or down
        over = np.where(still, np.abs(along) < half, low < high)
        low, high = np.where(still, 0.0, low), np.where(still, 1.0, high)
        lowest = np.minimum(low * lift, high * lift)
        inside = over & (off[:, 2] > lowest + self.corner + SLACK)  # of the cylinder above the corner
        if self.corner >= self.radius - 1e-9:
            centre = off - (0.0, 0.0, self.corner)
            square = np.maximum((chord * chord).sum(axis=1), 1e-24)
            place = np.clip(np.einsum("ni,ni->n", centre, chord) / square, 0.0, 1.0)
            away = centre - place[:, None] * chord
            inside |= np.einsum("ni,ni->n", away, away) < reach**2
        elif self.corner > 0.0:
            open_pairs = np.flatnonzero(over & ~inside & (off[:, 2] > lowest + SLACK))
            low, high, along, aside, run, lift, height = (
                values[open_pairs] for values in (low, high, along, aside, run, lift, off[:, 2])
            )
            for _ in range(40):  # the height of the tool over the point is convex in the place
                third = (high - low) / 3.0
                a, b = low + third, high - third
                less = self._over(a, along, aside, run, lift) < self._over(b, along, aside, run, lift)
                low, high = np.where(less, low, a), np.where(less, b, high)
            inside[open_pairs] = height > self._over(0.5 * (low + high), along, aside, run, lift) + SLACK
        meets[row, move] = inside
        return meets

    def _over(self, place, along, aside, run, lift):
        distance = np.minimum(np.hypot(aside, along - place * run), self.radius - 1e-12)
        return place * lift + self.height(distance)

    def inside(self, point, tip, axes):
        """Whether points (n, 3) are inside of the tool at poses (k): tips (k, 3), axes as columns (k, 3, 3): (n, k)."""
        axis, middle = axes[:, :, 2], tip.mean(axis=0)  # from the middle, so that few digits are lost
        point, tip = point - middle, tip - middle
        height = point @ axis.T - np.einsum("ki,ki->k", tip, axis)
        square = (point**2).sum(axis=1)[:, None] - 2.0 * point @ tip.T + (tip**2).sum(axis=1)
        distance = np.sqrt(np.maximum(square - height**2, 0.0))
        return height > self.height(distance + SLACK) + SLACK


def force(cutter, velocity, inside, k, axes=None, rubbing=1.0):
    """Mean wrench about the tip (6,) [N, N·mm] of the points in material.

    :param velocity: of the points (n, 3) relative to the stock, per tooth [mm].
    :param rubbing: share of the rubbing of the end face that counts.
    """
    ktc, kte, krc, kre, kac, kae = k
    point, normal, moves, upwards = cutter.point, cutter.normal, cutter.moves, cutter.upwards
    if axes is not None:
        point, normal, moves, upwards = (each @ axes.T for each in (point, normal, moves, upwards))
    point, normal, moves, upwards = (each[inside] for each in (point, normal, moves, upwards))
    chip = np.einsum("ni,ni->n", velocity[inside], normal)
    rub = np.where(cutter.face[inside], rubbing, 1.0)
    out = -(ktc * chip + kte * rub)[:, None] * moves - (krc * chip + kre * rub)[:, None] * normal
    out += (kac * chip + kae * rub)[:, None] * upwards
    out *= (cutter.weight[inside] * cutter.teeth)[:, None]
    return np.concatenate([out.sum(axis=0), np.cross(point, out).sum(axis=0)])


def forces(cutter, begin, end, places, per_tooth, k, in_stock):
    """Return mean wrenches (m, 6) in the axes of the stock, about the tip, at places (move, share) of an upright tool,
    and the area of its front in material (m,) [mm²].

    :param begin: (n, 3) and end: of the moves of the tip, in order, without gaps in what cuts.
    :param per_tooth: feed per tooth (n,) of each move.
    :param in_stock: of points (n, 3): is there material before the first move?
    """
    out, area = np.zeros((len(places), 6)), np.zeros(len(places))
    for row, (move, share) in enumerate(places):
        chord = end[move] - begin[move]
        tip, heading = begin[move] + share * chord, chord / np.linalg.norm(chord)
        point = tip + cutter.point
        inside = cutter.normal @ heading > 1e-9
        inside[inside] = in_stock(point[inside] - SLACK * np.array([0.0, 0.0, 1.0]))
        if not inside.any():
            continue
        first = np.vstack([begin[:move], begin[move]])
        last = np.vstack([end[:move], tip])
        inside[inside] = ~_cut(cutter, point[inside], tip, first, last)
        area[row] = cutter.area[inside].sum()
        velocity = np.broadcast_to(per_tooth[move] * heading, point.shape)
        out[row] = force(cutter, velocity, inside, k, rubbing=max(-heading[2], 0.0))
    return out, area


def _cut(cutter, point, tip, begin, end):
    """Which points are inside of what was swept before: nearest moves first."""
    chord = end - begin
    square = np.maximum((chord[:, :2] ** 2).sum(axis=1), 1e-24)
    share = np.clip(((tip - begin)[:, :2] * chord[:, :2]).sum(axis=1) / square, 0.0, 1.0)
    away = np.linalg.norm((begin + share[:, None] * chord - tip)[:, :2], axis=1)
    order = np.argsort(away, kind="stable")
    order = order[away[order] < 2.0 * cutter.radius]
    cut = np.zeros(len(point), dtype=bool)
    for first in range(0, len(order), _BLOCK):
        rows, left = order[first : first + _BLOCK], np.flatnonzero(~cut)
        if not len(left):
            break
        cut[left] = cutter.swept(point[left], begin[rows], end[rows]).any(axis=1)
    return cut


def turning_forces(cutter, tip, axes, places, feed, k, in_stock):
    """Return mean wrenches (m, 6) about the tip in the axes of the stock, of a tool that may turn while it moves.

    :param tip: (n, 3) positions of the tip in order, and axes: (n, 3, 3) of the tool as columns, close together.
    :param places: rows of poses; the tool moves there as from the pose before to the one after.
    :param feed: feed per tooth (n,) of the tip.
    """
    out = np.zeros((len(places), 6))
    for row, place in enumerate(places):
        step = np.linalg.norm(tip[place + 1] - tip[place - 1])
        world = [tip[each] + cutter.point @ axes[each].T for each in (place - 1, place + 1)]
        velocity = (world[1] - world[0]) * (feed[place] / step)
        point, normal = tip[place] + cutter.point @ axes[place].T, cutter.normal @ axes[place].T
        inside = np.einsum("ni,ni->n", velocity, normal) > 1e-9
        inside[inside] = in_stock(point[inside])
        left = np.flatnonzero(inside)
        if not len(left):
            continue
        middle = point[left].mean(axis=0)
        extent = np.linalg.norm(point[left] - middle, axis=1).max(initial=0.0)
        away = np.linalg.norm(np.cross(tip[:place] - middle, axes[:place, :, 2]), axis=1)  # from the axes
        near = np.flatnonzero(away < cutter.radius + extent)
        order = near[np.argsort(np.linalg.norm(tip[near] - tip[place], axis=1), kind="stable")]
        for first in range(0, len(order), _BLOCK):
            if not len(left):
                break
            rows = order[first : first + _BLOCK]
            left = left[~cutter.inside(point[left], tip[rows], axes[rows]).any(axis=1)]
        inside[:] = False
        inside[left] = True
        descent = -(tip[place + 1] - tip[place - 1]) @ axes[place][:, 2] / step
        out[row] = force(cutter, velocity, inside, k, axes[place], max(descent, 0.0))
    return out
