"""The bound u95 against chance: parameters, forces and discrepancy drawn, the equilibrium solved without linearising.

Run: python -m tests.benchmarks.bound [--runs N]

For some poses of the KR 270 under milling forces the 95 % quantile of the errors of so many runs is printed beside the
bound that `convert` states, and their ratio.
"""

from __future__ import annotations

import argparse

import numpy as np
from msgspec.structs import replace

from postproc import elastostatics, robot
from postproc.robot.model import Discrepancy
from tests.kr270 import ROBOT, SIDE_TOOL

_POSES = 12
_NAMES = ["k1", "k2", "k3", "k4", "k5", "k6", "K_c"]


def against_chance(runs: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return for some poses what 95 % of the errors of so many runs stay below, and the bound (n,) each [m].

    The six compliances are uncertain by 10 to 15 % and correlated, K_c by a quarter; a force by 7 % of its size in any
    direction; the discrepancy is 0.2 mm.
    """
    rng = np.random.default_rng(seed)
    assert ROBOT.compensator is not None
    values = np.append(1e6 / np.diag(ROBOT.stiffness), ROBOT.compensator.stiffness)
    mixed = 0.6 * np.eye(len(values)) + 0.4 * rng.uniform(-1.0, 1.0, (len(values), len(values)))
    sigma = np.append(rng.uniform(0.1, 0.15, 6), 0.25) * values
    factor = sigma[:, None] * mixed / np.linalg.norm(mixed, axis=1)[:, None]
    model = replace(
        ROBOT,
        covariance=robot.Covariance.of(_NAMES, factor @ factor.T),
        discrepancy=Discrepancy(np.array([500.0]), np.array([2e-4])),
    )
    q = np.radians([0, -70, 90, 10, 40, 20]) + rng.uniform(-0.4, 0.4, (_POSES, 6))
    wrench = np.c_[rng.uniform(-600.0, 600.0, (_POSES, 3)), rng.uniform(-10.0, 10.0, (_POSES, 3))]
    spread = np.zeros((_POSES, 6, 6))
    spread[:, range(3), range(3)] = 0.07 * np.linalg.norm(wrench[:, :3], axis=1)[:, None]
    bound = elastostatics.position_bound(model, q, SIDE_TOOL, wrench, force_spread=spread)
    expected = elastostatics.deflect(model, q, SIDE_TOOL, wrench).twist[:, :3]
    off = model.discrepancy.at(wrench) / 2.7955  # 95 % of the lengths of standard normal vectors
    errors = np.empty((runs, _POSES))
    for run in range(runs):
        drawn = values + factor @ rng.normal(size=len(values))
        other = replace(
            model,
            stiffness=np.diag(1e6 / drawn[:6]),
            compensator=replace(ROBOT.compensator, stiffness=float(drawn[6])),
        )
        force = wrench + np.einsum("nij,nj->ni", spread, rng.normal(size=(_POSES, 6)))
        tip = elastostatics.deflect(other, q, SIDE_TOOL, force).twist[:, :3] + off[:, None] * rng.normal(
            size=(_POSES, 3)
        )
        errors[run] = np.linalg.norm(tip - expected, axis=1)
    return np.quantile(errors, 0.95, axis=0), bound


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    found, bound = against_chance(parser.parse_args().runs)
    print("95 % of the runs [mm]  bound [mm]  ratio")
    for one, other in zip(found, bound, strict=True):
        print(f"{one * 1e3:21.4f}  {other * 1e3:10.4f}  {other / one:5.3f}")


if __name__ == "__main__":
    main()
