"""Many identifications from a plan's measurements with fresh noise: what accuracy after compensation do they reach?

Readings come from samples/paper_study/simulator.py (nonlinear equilibrium, tilted tracker), the identification is the
package's, the errors are those of predicted against true tool positions at the test poses.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc import elastostatics
from postproc.errors import PostprocError
from postproc.identification.procedure import identify
from postproc.identification.readings import read, read_experiment
from samples.paper_study import simulator
from tests.plan import setting


def true_robot(compensator=None):
    """The robot that the planner believes in, or one with a stiff compensator: (K_c, s_0)."""
    k = 1.0 / np.diag(setting.ROBOT.stiffness)
    spring = setting.ROBOT.compensator
    stiffness, free = compensator or (spring.stiffness, spring.free_length)
    law = (stiffness, free, spring.L, spring.ax, spring.ay)
    return simulator.TrueRobot(
        simulator.Gear("linear", 1.0 / k, np.ones(6)), comp=law, masses=simulator.MASSES.copy(), gears_feel_rest=False
    )


def deflections(true, tests, tool):
    """True displacements (T, 3) of the tool tip."""
    out = []
    for force in (tests.wrench[:, :3], 0 * tests.wrench[:, :3]):
        flange = true.solve(tests.q, force, point=tool)
        out.append(flange[:, :3, 3] + flange[:, :3, :3] @ tool)
    return out[0] - out[1]


def errors(folder, result, runs, seed=0, prior=None, true=None):
    """RMS error over the test poses (runs,) [m]; and how many identifications failed."""
    prior = setting.ROBOT if prior is None else prior
    true = true_robot() if true is None else true
    rng = np.random.default_rng(seed)
    repeats = result.options.repeats
    exact, raw = simulator.measure(true, result.plan.q, result.force, rng, setting.SIGMA, repeats)
    simulator.write(folder, result.plan.q, result.force, raw)
    data = read(folder / "measurements.csv", read_experiment(folder / "experiment.toml"))
    exact = np.repeat(exact[:, :, None], repeats, axis=2).reshape(-1, 3)  # config, load, repeat, point: as written
    tool = setting.CELL.tool.pose()
    wanted = deflections(true, result.tests, tool[:3, 3])
    found, failed = [], 0
    for _ in range(runs):
        fresh = replace(data, position=exact + rng.normal(0, setting.SIGMA, exact.shape))
        try:
            robot = identify(prior, fresh, depth="joints").robot()
        except PostprocError:
            failed += 1
            continue
        state = elastostatics.deflect(robot, result.tests.q, tool, result.tests.wrench)
        left = (state.pose - state.unloaded_pose)[:, :3, 3] - wanted
        found.append(np.sqrt(result.tests.weight @ np.sum(left**2, axis=1)))
    return np.array(found), failed
