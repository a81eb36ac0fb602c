"""Single gross errors: found, named, left out.

First without a model: against the other repeats, and against the distances between points of one rigid body. Then, in a
fit that is good but for a few points, against the model.
"""

from __future__ import annotations

import numpy as np

from postproc.frames import MM_PER_M, Array
from postproc.identification.displacements import whiten, whitening
from postproc.identification.fit import Fit
from postproc.identification.measurements import Measurements
from postproc.identification.placement import Placement
from postproc.program import Ints

_GROSS = 6.0
"""Standard deviations beyond which a reading counts as a gross error."""


def model_free(data: Measurements) -> tuple[Measurements, list[str]]:
    """Leave out readings that contradict their repeats or the rigid body; return the others, and the names of these."""
    found: list[str] = []
    sigma = max(data.sigma, _robust_sigma(data))
    bad: list[int] = []
    for state in range(len(data.load)):
        for point in range(len(data.points)):
            rows = np.flatnonzero((data.state == state) & (data.point == point))
            if len(rows) < 3:
                continue
            off = np.linalg.norm(data.position[rows] - np.median(data.position[rows], axis=0), axis=1)
            wrong = rows[off > _GROSS * 1.5 * sigma]
            if 0 < len(wrong) < 0.5 * len(rows):
                bad += wrong.tolist()
                found += [
                    f"{data.name(int(row))} is {far * MM_PER_M:.2f} mm from its repeats: left out"
                    for row, far in zip(wrong, off[off > _GROSS * 1.5 * sigma], strict=True)
                ]
    data = data.without(bad)
    if len(data.points) >= 3:
        bad, names = _rigid_body(data, sigma)
        data, found = data.without(bad), found + names
    return data, found


def _robust_sigma(data: Measurements) -> float:
    """Return the noise of one coordinate from the repeats, insensitive to outliers [m]."""
    mean, count = data.means()
    many = count[data.state, data.point] >= 2
    if not many.any():
        return 0.0
    left = (data.position - mean[data.state, data.point])[many]
    shrink = np.sqrt(1.0 - 1.0 / np.median(count[count >= 2]))
    return float(np.median(np.abs(left)) / 0.6745 / shrink)


def _rigid_body(data: Measurements, sigma: float) -> tuple[list[int], list[str]]:
    """Find readings whose distances to the other points of their set are wrong while those are right."""
    bad, names = [], []
    sets = []
    for state in range(len(data.load)):
        for repeat in np.unique(data.repeat[data.state == state]):
            rows = np.flatnonzero((data.state == state) & (data.repeat == repeat) & data.used)
            if len(rows) == len(data.points):
                sets.append(rows[np.argsort(data.point[rows])])
    if len(sets) < 3:
        return [], []
    position = data.position[np.array(sets)]
    apart = np.linalg.norm(position[:, :, None] - position[:, None], axis=3)
    off = np.abs(apart - np.median(apart, axis=0))
    limit = _GROSS * np.sqrt(2.0) * sigma
    for rows, here in zip(sets, off, strict=True):
        wrong = (here > limit).sum(axis=1)
        worst = int(np.argmax(here.sum(axis=1)))
        others = np.delete(np.delete(here, worst, axis=0), worst, axis=1)
        if wrong[worst] >= 1 and others.max() <= limit:
            row = int(rows[worst])
            bad.append(row)
            names.append(
                f"{data.name(row)} is {here[worst].max() * MM_PER_M:.2f} mm off in its distance to the other points: "
                "left out"
            )
    return bad, names


def against_model(data: Measurements, placement: Placement, fit: Fit) -> tuple[Measurements, list[str]]:
    """Leave out the reading behind the largest residual of a fit, if it is a gross error.

    A residual is gross if it exceeds six standard deviations and six times what the others usually are. Whether the
    loaded or the unloaded reading is wrong follows from the unloaded one's distance from the geometry.
    """
    white = whiten(whitening(data), fit.residual)
    size = np.linalg.norm(white, axis=2)
    usual = float(np.median(np.abs(white))) / 0.6745
    row, point = np.unravel_index(int(np.argmax(size)), size.shape)
    if size[row, point] <= _GROSS * max(1.0, usual) * 1.3:
        return data, []
    state = int(data.loaded[row])
    config = int(data.state_config[state])
    rest = int(data.unloaded[config])
    expected = placement.residual[:, point] - np.median(placement.residual[:, point], axis=0)
    rest_off = float(np.linalg.norm(expected[config]))
    rest_usual = float(np.median(np.linalg.norm(expected, axis=1)))
    others = np.flatnonzero((data.state_config == config) & (data.load != 0))
    shared = len(others) > 1 and all(
        size[np.flatnonzero(data.loaded == other)[0], point] > _GROSS * max(1.0, usual) for other in others
    )
    gross = float(np.linalg.norm(fit.residual[row, point]))
    culprit = rest if shared or rest_off > max(0.5 * gross, 3.0 * rest_usual) else state
    candidates = np.flatnonzero((data.state == culprit) & (data.point == point) & data.used)
    wrong = _worst_repeat(data, candidates, fit.residual[row, point], placement, culprit == state)
    names = [
        f"{data.name(int(reading))} is {gross * MM_PER_M:.2f} mm from what the model predicts: left out"
        for reading in wrong
    ]
    return data.without([int(reading) for reading in wrong]), names


def _worst_repeat(data: Measurements, rows: Ints, residual: Array, placement: Placement, loaded: bool) -> list[int]:
    """Return the repeats that carry the error: the one that deviates most in its direction, or all if they agree."""
    if len(rows) == 1:
        return [int(rows[0])]
    direction = placement.root_in_device[:3, :3] @ (residual / np.linalg.norm(residual)) * (1.0 if loaded else -1.0)
    along = (data.position[rows] - data.position[rows].mean(axis=0)) @ direction
    if np.ptp(along) > _GROSS * data.sigma:
        return [int(rows[np.argmax(along)])]
    return [int(row) for row in rows]
