"""The simulator is an oracle only if it is right: its solution must be stationary, and agree with the package."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import elastostatics, robot
from samples.paper_study import simulator


@pytest.mark.parametrize(("gear", "links"), [("linear", "begin"), ("cubic", "beam"), ("cubic", "end")])
def test_the_energy_is_stationary_at_the_solution(gear, links):
    rng = np.random.default_rng(5)
    true = simulator.hard(rng, gear=gear, links=links, base=True)
    q, f = simulator.plan(rng, 4)
    true.solve(q, f)
    y, h = true.y, 1e-6
    for i in range(true.size):
        step = np.zeros(true.size)
        step[i] = h
        slope = (true.energy(q, y + step, f) - true.energy(q, y - step, f)) / (2 * h)
        assert np.abs(slope).max() < 1e-3  # N·m or N, of up to 5000 in balance
    step = np.random.default_rng(0).normal(0, 1e-4, y.shape)
    assert np.all(true.energy(q, y + step, f) > true.energy(q, y, f))


def test_link_springs_of_the_package_agree_with_the_simulator():
    """2.7 kN, springs in all six directions at every link and under the base: within 0.1 µm of 5 mm."""
    rng = np.random.default_rng(7)
    true = simulator.hard(rng, gear="linear", links="begin", base=True, geometry=0.0, feel_rest=False)
    q, f = simulator.plan(rng, 20)
    prior = robot.load(robot.find("kuka_kr270"))
    springs = [robot.LinkSpring(link, axis) for link in ("base", *robot.JOINTS) for axis in robot.LINK_AXES[:6]]
    chain, actuated, rows = robot.elastic_chain(prior.actual, springs)
    true.masses = simulator.MASSES
    compliance = np.zeros(chain.nv)
    compliance[list(actuated)] = 1 / true.gear.k
    compliance[rows] = np.concatenate([np.diag(true.links[link]) for link in range(7)])
    law = replace(prior.compensator, stiffness=true.comp[0])
    model = replace(
        prior, actual=chain, loaded=chain, actuated=actuated, stiffness=np.diag(1 / compliance), compensator=law,
        link_springs=tuple(springs),
    )  # fmt: skip
    tool = np.eye(4)
    tool[:3, 3] = simulator.LOAD_POINT
    found = elastostatics.deflect(model, q, tool, np.c_[f, 0 * f])
    loaded, rest = true.solve(q, f), true.solve(q, 0 * f)
    tip = loaded @ tool - rest @ tool
    np.testing.assert_allclose(found.twist[:, :3], tip[:, :3, 3], atol=1e-7)
    assert np.linalg.norm(tip[:, :3, 3], axis=1).max() > 2e-3
