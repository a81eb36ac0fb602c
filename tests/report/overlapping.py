"""Jobs drawn at random whose passes overlap, and what they leave by the oracle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from postproc.machining.tool import Cutter
from postproc.report.surface import surface
from tests.oracle import remaining_surface as oracle
from tests.report.setting import result_of

LEFT = 1e-3
"""Window along the normal [m]."""


class Job(NamedTuple):
    """Passes with the number of cutting targets of each, and places and normals of the surface (F, 3) [m]."""

    tool: oracle.Tool
    passes: list
    centre: np.ndarray
    normal: np.ndarray


def _deviation(rng, count, size):
    """A deviation that drifts along a pass, (n, 3) [m]: mostly along z, either way."""
    along = np.linspace(0.0, 1.0, count)[:, None]
    level = rng.uniform(-size, 0.4 * size) * np.array([0.2, 0.2, 1.0])
    wave = rng.uniform(-0.3, 0.3, 3) * size * np.array([0.5, 0.5, 1.0])
    side = rng.uniform(-0.3, 0.3, 3) * size * np.array([1.0, 1.0, 0.0])
    return level + side + wave * np.sin(2 * np.pi * (rng.uniform(0.3, 1.5) * along + rng.uniform()))


def floor(rng, facets):
    """A floor by a flat or bull-nose tool: a roughing level, then the floor, by passes of 40 to 80 % of the width."""
    radius = rng.uniform(2e-3, 6e-3)
    tool = oracle.Tool(radius, rng.choice([0.0, 0.3 * radius]))
    size = 0.03
    passes = []
    for level in (rng.uniform(1e-4, 3e-4), 0.0):
        y = np.arange(0.0, size + 1e-9, rng.uniform(0.4, 0.8) * 2.0 * (radius - tool.corner))
        x = np.linspace(0.0, size, 8)
        for k, at in enumerate(y):
            tip = np.column_stack([x if k % 2 == 0 else x[::-1], np.full(len(x), at), np.full(len(x), level)])
            passes.append(oracle.Pass(tool, tip, _deviation(rng, len(x), 4e-4)))
    place = np.column_stack([rng.uniform(0.1 * size, 0.9 * size, (facets, 2)), np.zeros(facets)])
    return Job(tool, passes, place, np.tile([0.0, 0.0, 1.0], (facets, 1)))


def freeform(rng, facets):
    """A random surface by a ball or bull-nose tool: coarse passes above it, then fine ones on it."""
    radius = rng.uniform(2e-3, 5e-3)
    tool = oracle.Tool(radius, rng.choice([radius, 0.4 * radius]))
    phase, angle = rng.uniform(0, 2 * np.pi, 2), rng.uniform(0, 2 * np.pi, 2)
    wave = 2 * np.pi / rng.uniform(8 * radius, 16 * radius, 2)
    amplitude = 0.15 / wave

    def shape(x, y):
        argument = wave * (np.cos(angle) * x[..., None] + np.sin(angle) * y[..., None]) + phase
        slope = (amplitude * wave * np.cos(argument))[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        gradient = slope.sum(axis=-2)
        normal = np.concatenate([-gradient, np.ones((*x.shape, 1))], axis=-1)
        return (amplitude * np.sin(argument)).sum(axis=-1), normal / np.linalg.norm(normal, axis=-1, keepdims=True)

    size = 0.016
    passes = []
    for allowance, stepover in ((2e-4, 0.5 * radius), (0.0, 0.15 * radius)):
        x = np.linspace(0.0, size, 60)
        for k, at in enumerate(np.arange(0.0, size + 1e-9, stepover)):
            y = np.full(len(x), at)
            z, normal = shape(x, y)
            across = normal * [1.0, 1.0, 0.0]
            across /= np.maximum(np.linalg.norm(across, axis=1), 1e-12)[:, None]
            tip = np.column_stack([x, y, z]) + (tool.corner + allowance) * normal - [0.0, 0.0, tool.corner]
            tip += (tool.radius - tool.corner) * across
            tip = tip if k % 2 == 0 else tip[::-1]
            passes.append(oracle.Pass(tool, tip, _deviation(rng, len(x), 4e-4)))
    x, y = rng.uniform(0.15 * size, 0.85 * size, (2, facets))
    z, normal = shape(x, y)
    return Job(tool, passes, np.column_stack([x, y, z]), normal)


def wall(rng, facets):
    """A wall x = 0 by the side of a flat tool in steps down, with one finishing pass over the whole height."""
    radius = rng.uniform(2e-3, 6e-3)
    tool = oracle.Tool(radius, 0.0)
    passes = []
    step = rng.uniform(6e-4, 1.5e-3)
    for level, allowance in [*((-step * k, 1e-4) for k in range(1, 6)), (-5 * step, 0.0)]:
        y = np.linspace(0.0, 0.03, 9)
        tip = np.column_stack([np.full(9, radius + allowance), y, np.full(9, level)])
        passes.append(oracle.Pass(tool, tip, _deviation(rng, 9, 4e-4)[:, [2, 1, 0]]))
    y, z = rng.uniform(0.004, 0.026, facets), rng.uniform(-4.5 * step, -0.2 * step, facets)
    return Job(tool, passes, np.column_stack([np.zeros(facets), y, z]), np.tile([1.0, 0.0, 0.0], (facets, 1)))


JOBS = {"floor": floor, "freeform": freeform, "wall": wall}


def shown(job):
    """The surface as postproc shows it."""
    points, deviations, rapid = [], [], []
    for _, tip, deviation in job.passes:
        above = tip[[0, -1]] + [0.0, 0.0, 0.05]
        points += [above[:1], tip[:1], tip, above[1:]]  # the first target of a cut is reached by a rapid move
        deviations += [np.zeros((1, 3)), deviation[:1], deviation, np.zeros((1, 3))]
        rapid += [[True, True], np.zeros(len(tip), dtype=bool), [True]]
    made = result_of(np.concatenate(points), np.concatenate(deviations), np.concatenate(rapid))
    across = np.cross(job.normal, [0.3, 0.9, 0.1])
    across /= np.linalg.norm(across, axis=1)[:, None]
    upward = np.cross(job.normal, across)
    corner = 1e-6 * np.stack([across, -0.5 * across + upward, -0.5 * across - upward], axis=1)
    cutter = Cutter(job.tool.radius, job.tool.corner, 2)
    return surface(made, job.centre[:, None] + corner, {0: cutter})


def exact(job, step=2e-5):
    """Changes (F,) of what remains by the deviations, by the oracle; infinite where it is not within `LEFT`."""
    remains = []
    for share in (0.0, 1.0):
        tips = oracle.sampled([one._replace(deviation=share * one.deviation) for one in job.passes], step)
        remains.append([oracle.along_normal(tips, *at, LEFT) for at in zip(job.centre, job.normal, strict=True)])
    nominal, deflected = np.array(remains)
    with np.errstate(invalid="ignore"):
        return np.where(np.isfinite(nominal) & np.isfinite(deflected), deflected - nominal, np.inf)
