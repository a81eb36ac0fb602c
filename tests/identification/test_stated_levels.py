"""Loads of one level stated wrong are named; gears that stiffen or soften in truth are not taken for them."""

import re

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.frames import norm
from postproc.identification.choice import choose
from postproc.identification.measurement_model import locate
from postproc.identification.procedure import identify
from postproc.identification.stated_levels import doubt_of_levels
from samples.paper_study import harness, simulator


class Softening(simulator.Gear):
    """A gear whose secant stiffness falls by a third as the torque grows."""

    def torque(self, t):
        u = np.abs(t) / (0.2 * self.bend)
        stiffness = self.k * (1.0 - 0.35 * u / (1.0 + u))
        return stiffness * t, stiffness - self.k * 0.35 * u / (1.0 + u) ** 2


def readings(folder, gear, shares=(0.4, 1.0), seed=5, count=15):
    """Readings of an arm whose links deflect too, at shares of 2.7 kN."""
    rng = np.random.default_rng(seed)
    true = simulator.hard(rng, gear="quadratic" if gear == "softening" else gear)
    if gear == "softening":
        true.gear = Softening("softening", true.gear.k, true.gear.bend)
    q, f = simulator.plan(rng, count, tilt=50.0)
    _, raw = simulator.measure(true, q, f, rng, 0.03e-3, levels=shares)
    return harness.load(simulator.write(folder, q, f, raw, levels=shares))


def stated(data, newtons, factor):
    """The readings whose loads near some newtons are stated too large by a factor."""
    load = norm(data.wrench[:, :3])
    wrench = data.wrench.copy()
    wrench[np.abs(load - newtons) < 0.2 * newtons] *= factor
    return replace(data, wrench=wrench)


def judged(data):
    placement = locate(harness.PRIOR, data)
    return doubt_of_levels(choose(harness.PRIOR, data, placement).fit, data, placement)


def factors(text):
    """Factor by newtons as stated."""
    return {int(load): float(factor) for load, factor in re.findall(r"near (\d+) N .*?, ([\d.]+) times", text)}


@pytest.mark.parametrize("gear", ["settling", "softening"])
def test_gears_that_stiffen_or_soften_are_no_wrong_load(tmp_path, gear):
    """Quadratic ones: `test_a_factor_common_to_all_loads_leaves_no_trace`."""
    assert judged(readings(tmp_path, gear)) == ""


@pytest.mark.parametrize(("gear", "factor"), [("linear", 1.15), ("softening", 0.85)])
def test_a_level_stated_wrong_is_named_with_the_load_that_fits(tmp_path, gear, factor):
    """Quadratic gears: `test_the_verdict_states_it`."""
    text = judged(stated(readings(tmp_path, gear), 2700.0, factor))
    # two levels: their ratio is known, and either of them may be wrong
    low, high = pytest.approx(factor, abs=0.03), pytest.approx(1.0 / factor, abs=0.03)
    assert factors(text) == {1080: low, round(2700.0 * factor): high}
    assert text.endswith(": check their scale, mass or pulley")


def test_of_three_levels_the_wrong_one_is_named(tmp_path):
    data = stated(readings(tmp_path, "quadratic", (0.2, 0.6, 1.0), count=20), 1620.0, 0.85)
    assert factors(judged(data)) == {1377: pytest.approx(1.0 / 0.85, abs=0.03)}


@pytest.mark.parametrize("shares", [(0.4, 1.0), (1.0,)])
def test_a_factor_common_to_all_loads_leaves_no_trace(tmp_path, shares):
    data = readings(tmp_path, "quadratic", shares)
    assert judged(replace(data, wrench=1.15 * data.wrench)) == ""


def test_the_verdict_states_it(tmp_path):
    result = identify(harness.PRIOR, stated(readings(tmp_path, "quadratic"), 2700.0, 0.85))
    assert not result.judgement.distrust
    line = result.judgement.line
    assert "with a reservation: the loads near 2295 N (234 kg) fit the others as about 26" in line
    assert factors(line) == {1080: pytest.approx(0.85, abs=0.03), 2295: pytest.approx(1.0 / 0.85, abs=0.03)}
    assert ": check their scale, mass or pulley" in line
