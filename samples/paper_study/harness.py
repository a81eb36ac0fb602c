"""From readings to the identification without rewriting files for every Monte-Carlo run; and what is left on jobs."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc import elastostatics, robot
from postproc.identification.fit import to_file_units
from postproc.identification.readings import read, read_experiment

PRIOR = robot.load(robot.find("kuka_kr270"))
TOOL = np.eye(4)
TOOL[:3, 3] = [0.0, 0.0, 0.35]


def load(folder):
    experiment = read_experiment(folder / "experiment.toml")
    return read(folder / "measurements.csv", experiment)


def with_readings(data, raw):
    """The same measurements with other noise: raw (m, 2, repeats, p, 3) in the order in which the file is written."""
    return replace(data, position=np.round(raw.reshape(-1, 3) * 1e3, 4) / 1e3)


def true_deflection(true, q, f):
    tip = [pose[:, :3, 3] + pose[:, :3, :3] @ TOOL[:3, 3] for pose in (
        true.solve(q, 0 * f, point=TOOL[:3, 3]), true.solve(q, f, point=TOOL[:3, 3]))]  # fmt: skip
    return tip[1] - tip[0]


def job_factor(true, model, jobs):
    """RMS of what the load does to the tool tip over RMS of what the model leaves, on jobs of angles and forces."""
    seen, left = 0.0, 0.0
    for q, f in jobs:
        moved = true_deflection(true, q, f)
        predicted = elastostatics.deflect(model, q, TOOL, np.c_[f, 0 * f]).twist[:, :3]
        seen, left = seen + np.sum(moved**2), left + np.sum((moved - predicted) ** 2)
    return float(np.sqrt(seen / left))


def share_within_bound(true, result, jobs):
    """Share of samples of jobs whose error of prediction is within the 95 % bound (u95)."""
    from postproc.robot import Covariance

    parameters, _, covariance = to_file_units(result.fit)
    model = replace(result.robot(), covariance=Covariance(parameters, covariance))
    inside = []
    for q, f in jobs:
        wrench = np.c_[f, 0 * f]
        error = elastostatics.deflect(model, q, TOOL, wrench).twist[:, :3] - true_deflection(true, q, f)
        inside.append(np.linalg.norm(error, axis=1) <= elastostatics.position_bound(model, q, TOOL, wrench))
    return float(np.mean(inside))


def placed(model, data):
    """A placement with the points where the experiment guesses them."""
    from postproc.identification.measurement_model import Placement

    size = 6 + 3 * len(data.points)
    return Placement(np.eye(4), data.guess, np.eye(size), np.zeros((len(data.q), len(data.points), 3)))
