"""A robot to be planned for: experiment files, test poses, and the criterion by code that is not the package's."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from postproc.identification.readings import read_experiment
from postproc.plan import Options, milling, plan_measurements
from postproc.plan.site import site_of
from tests.kr270 import CELL, FOLDER, ROBOT
from tests.oracle.arm import Arm as Oracle

ORACLE = Oracle.load(FOLDER)
LOAD_POINT = [0.210, -0.060, 0.180]
POINTS = {"P1": [0.118, 0.021, 0.262], "P2": [-0.077, 0.104, 0.255], "P3": [-0.049, -0.121, 0.301]}
SIGMA = 0.03e-3

BASIC = """robot = "kuka_kr270"
sigma_mm = 0.03

[load_point]
X = 210
Y = -60
Z = 180

[points.P1]
X = 118
Y = 21
Z = 262

[points.P2]
X = -77
Y = 104
Z = 255

[points.P3]
X = -49
Y = -121
Z = 301
"""
RIG = "\n[rig]\nmass_kg = 275\nmax_angle_deg = 30\n"
AROUND = """
[tracker]
X = 4200
Y = -2500
Z = 1300

[[boxes]]
name = "table"
X = 1900
Z = 350
A = 20
size = [900, 1200, 700]
"""


def experiment(folder: Path, text: str = BASIC + RIG + AROUND) -> Path:
    path = folder / "experiment.toml"
    path.write_text(text, encoding="utf-8")
    return path


def site(folder: Path, text: str = BASIC + RIG + AROUND, margin: float = 5.0):
    path = experiment(folder, text)
    return site_of(ROBOT, read_experiment(path), folder, CELL.start_joints, np.radians(margin))


@lru_cache
def job(seed: int = 0, count: int = 300):
    """Test poses along a fabricated milling job; other seeds are other parts elsewhere, under other forces."""
    from samples.paper_study.simulator import milling_job

    q, force = milling_job(np.random.default_rng(seed), count=count)
    wrench = np.zeros((len(q), 6))
    wrench[:, :3] = force
    return milling.poses_under_load(ROBOT, q, CELL.tool.pose(), wrench, weight=np.ones(len(q)), source=f"job {seed}")


def quick(folder: Path, *, tests=None, text: str = BASIC + RIG + AROUND, data=None, **options):
    chosen = {
        "starts": 1,
        "comparisons": False,
        "configurations": 8,
        "levels": 4,
        "test_poses": 8,
        "rounds": 3,
    } | options
    place = site(folder, text)
    return plan_measurements(place, job() if tests is None else tests, Options(**chosen), data)


# ---- the criterion again: forward kinematics and equilibrium of tests/oracle, derivatives by differences ----


def in_flange(point):
    pose = np.eye(4)
    pose[:3, 3] = point
    return pose


def differences(fun, at, h=1e-6):
    columns = []
    for i in range(len(at)):
        step = np.zeros(len(at))
        step[i] = h
        columns.append((fun(at + step) - fun(at - step)) / (2 * h))
    return np.stack(columns, axis=-1)


def regressor(q, force, load_point, points):
    """∂(points)/∂(k1…k6) of a chain of joint springs: columns J_i (J_iᵀF), by differences of the oracle's positions."""
    spots = np.column_stack([np.array([load_point, *points]), np.ones(1 + len(points))])
    moved = differences(lambda x: (ORACLE.frames(x)[-1] @ spots.T)[:3].T, q)  # (1 + P, 3, 6)
    torque = moved[0].T @ force
    return np.vstack([moved[1:][row] * torque for row in range(len(points))])


def oracle_k2(q2, compliance, comp):
    """k2 at q2 with the compensator: second difference of the spring energy."""
    h = 1e-4
    energy = [ORACLE.spring_energy(q2 + i * h) for i in (-1, 0, 1)] if comp else [0.0, 0.0, 0.0]
    return 1.0 / (1.0 / compliance + (energy[0] - 2 * energy[1] + energy[2]) / h**2)


def normal_matrices(q, force, keep=range(6)):
    rows = [regressor(a, f, LOAD_POINT, POINTS.values())[:, list(keep)] for a, f in zip(q, force, strict=True)]
    return np.array([r.T @ r for r in rows])


_SEEN = {}


def milling_regressors(tests):
    """A₀ (T, 3, 6) at the tool tip, by differences."""
    if id(tests) not in _SEEN:
        _SEEN[id(tests)] = tests, _milling_regressors(tests)
    return _SEEN[id(tests)][1]


def _milling_regressors(tests):
    tool = CELL.tool.pose()[:3, 3]
    return np.array([regressor(q, w[:3], tool, [tool]) for q, w in zip(tests.q, tests.wrench, strict=True)])


def pooled(q, force, tests, variance):
    return pooled_of(normal_matrices(q, force), q[:, 1], tests, variance)


def pooled_of(information, q2, tests, variance):
    """Pooled criterion with K_c at its prior: Eq. (8) for the extended set, K⁰_θ2 the mean over the levels [m²]."""
    k0 = 1.0 / ORACLE.stiffness[1]
    comp = ORACLE.comp is not None
    levels = np.unique(np.round(q2, 7))
    group = np.searchsorted(levels, np.round(q2, 7))
    size = 5 + len(levels)
    total = np.zeros((size, size))
    for one, g in zip(information, group, strict=True):
        where = [0, 5 + g, 1, 2, 3, 4]
        total[np.ix_(where, where)] += one
    scale = np.full(size, 1e-6)
    covariance = variance * np.linalg.inv(total * np.outer(scale, scale)) * np.outer(scale, scale)
    k_levels = np.array([oracle_k2(level, k0, comp) for level in levels])
    value = 0.0
    for a, pose, weight in zip(milling_regressors(tests), tests.q, tests.weight, strict=True):
        here = oracle_k2(pose[1], k0, comp)
        # δK⁰ = mean over levels of −δk/k²; δk(q2) = −k(q2)² δK⁰
        share = here**2 / k_levels**2 / len(levels)
        row = np.zeros((3, size))
        row[:, [0, 1, 2, 3, 4]] = a[:, [0, 2, 3, 4, 5]]
        row[:, 5:] = a[:, [1]] * share
        value += weight * np.trace(row @ covariance @ row.T)
    return value


def grouped(q, force, tests, variance):
    return grouped_of(normal_matrices(q, force), q[:, 1], tests, variance)


def grouped_of(information, q2, tests, variance):
    """The second Eq. (10) as printed [m²]."""
    levels = np.unique(np.round(q2, 7))
    a = milling_regressors(tests)
    value = 0.0
    for level in levels:
        total = information[np.abs(q2 - level) < 1e-6].sum(axis=0) * 1e-12
        inverse = np.linalg.inv(total) * 1e-12
        value += variance * sum(w * np.trace(x @ inverse @ x.T) for w, x in zip(tests.weight, a, strict=True))
    return value


def read_plan(text: str):
    rows = [line.split(",") for line in text.splitlines()[1:]]
    values = np.array(rows, dtype=float)
    return np.radians(values[:, 1:7]), values[:, 7:]
