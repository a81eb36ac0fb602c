"""Verdict of a validation: levels of load, limits of the share inside the bound, factor, and the table shown."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import robot
from postproc.identification import joint_springs, validation
from postproc.identification.validation import ValidatedLevel, Validation, coverage, share_limits, table


def validated_level(inside, limits, error_ratio=0.9):
    return ValidatedLevel(
        load=600.0, measured=1e-3, prediction_error=70e-6, noise=70e-6, standard_error=1e-10, inside=inside,
        limits=limits,
        error_ratio=error_ratio,
        bound=3e-5, configurations=15,
    )  # fmt: skip


def test_limits_of_a_share_are_those_of_independent_displacements_and_wider_where_configurations_are_alike():
    # one displacement a configuration: Clopper and Pearson's, by sums of binomial probabilities
    inside = np.array([1.0] * 26 + [0.0] * 4)
    low, high = share_limits(inside, np.ones(30), 0.05)
    tail = [sum(math.comb(30, n) * p**n * (1 - p) ** (30 - n) for n in ns) for p, ns in (
        (low, range(26, 31)), (high, range(27)))]  # fmt: skip
    assert tail == pytest.approx([0.05, 0.05], abs=0.01)
    # three displacements a configuration that are all inside or all outside tell no more than one
    assert share_limits(3 * inside, np.full(30, 3.0), 0.05) == pytest.approx((low, high), abs=0.02)
    # and if each is by itself, as many as there are
    mixed = np.array([3.0] * 18 + [2.0] * 12)
    alone = share_limits(mixed, np.full(30, 3.0), 0.05)
    assert alone[1] - alone[0] < 0.75 * (high - low)
    assert share_limits(np.full(15, 3.0), np.full(15, 3.0), 0.05) == pytest.approx((0.05 ** (1 / 15), 1.0))
    assert share_limits(np.array([3.0]), np.array([3.0]), 0.05) == (0.0, 1.0)


@pytest.mark.parametrize("count", [5, 10, 40])
def test_one_of_some_displacements_is_enough_for_a_lower_limit_and_none_is_not(count):
    """That it happens at all has the chance 1 − (1 − p)ⁿ; that all are inside pⁿ. By the scatter n counts as n − 1."""
    one = np.zeros(count)
    one[2] = 1.0
    low, _ = share_limits(one, np.ones(count), 0.05)
    assert 0.5 < low / (1.0 - 0.95 ** (1.0 / count)) < 1.0
    low, high = share_limits(np.zeros(count), np.ones(count), 0.05)
    assert (low, high) == (0.0, pytest.approx(1.0 - 0.05 ** (1.0 / count)))
    _, high = share_limits(1.0 - one, np.ones(count), 0.05)
    assert 0.5 < (1.0 - high) / (1.0 - 0.95 ** (1.0 / count)) < 1.0


def test_two_configurations_have_limits_and_one_has_none():
    assert share_limits(np.ones(2), np.ones(2), 0.05) == (pytest.approx(np.sqrt(0.05)), 1.0)
    assert share_limits(np.ones(1), np.ones(1), 0.05) == (0.0, 1.0)


def test_a_bound_that_holds_is_seldom_refuted_and_one_that_does_not_is():
    rng = np.random.default_rng(2)
    refuted = {}
    for share in (0.95, 0.6):
        # all points of a configuration together, as its own error makes them
        found = [share_limits(3.0 * (rng.random(15) < share), np.full(15, 3.0), 0.05) for _ in range(1000)]
        refuted[share] = np.mean([high < 0.95 for _, high in found])
    assert refuted[0.95] < 0.07, "5 % are meant"
    assert refuted[0.6] > 0.9


def test_the_verdict_says_what_the_readings_tell():
    told = {
        "holds": ((0.97, (0.8, 1.0)), (1.0, (0.78, 1.0))),
        "can not tell": ((0.97, (0.8, 1.0)), (0.87, (0.6, 0.98))),
        "too few": ((1.0, (0.3, 1.0)),),
        "narrow": ((0.97, (0.8, 1.0)), (0.6, (0.4, 0.8), 1.6)),
        "wrong": ((0.1, (0.0, 0.3), 7.0),),
    }
    line = {}
    for name, found in told.items():
        covered = coverage(np.zeros((0, 6)), np.zeros(0, dtype=np.int64))
        result = Validation(tuple(validated_level(*each) for each in found), covered, (), ())
        assert result.holds == (name == "holds")
        line[name] = result.line
    assert line["holds"].startswith("the model holds for the torques listed below: at 600 N 97%")
    for name in ("can not tell", "too few"):
        assert line[name].startswith("IT IS NOT KNOWN whether the model holds")
    share = "87% of the displacements of 15 configurations are inside its bound, so the share of all is 60% to 98%"
    assert share in line["can not tell"]
    for name in ("narrow", "wrong"):
        assert line[name].startswith("THE MODEL DOES NOT HOLD: at 600 N")
    assert "use 1.6 times u95" in line["narrow"]
    assert "payload" not in line["narrow"]
    assert "reach 7.0 times the bound" in line["wrong"]


def test_a_model_without_a_bound_holds_for_nothing():
    covered = coverage(np.zeros((0, 6)), np.zeros(0, dtype=np.int64))
    result = Validation((validated_level(float("nan"), (0.0, 1.0)),), covered, (), ())
    assert not result.holds
    assert result.line.startswith("the model states no bound")


def test_a_factor_is_no_division_by_noise():
    covered = coverage(np.zeros((0, 6)), np.zeros(0, dtype=np.int64))
    level = validated_level(1.0, (0.8, 1.0))
    assert not level.exceeds_noise
    assert level.factor == pytest.approx(1e-3 / np.sqrt(2e-10))
    clear = replace(level, prediction_error=np.hypot(70e-6, 50e-6))
    assert clear.exceeds_noise
    assert clear.factor == pytest.approx(1e-3 / 50e-6)
    assert "> 70.7" in table(Validation((level,), covered, (), ()))
    assert "> " not in table(Validation((clear,), covered, (), ()))


def compared(seed):
    """Twelve configurations under three loads at two points; some are not seen, one load not at all."""
    rng = np.random.default_rng(seed)
    config, load = np.tile(np.arange(12), 3), np.repeat([300.0, 900.0, 2700.0], 12) * rng.uniform(0.97, 1.03, 36)
    seen = rng.random((36, 2)) < 0.9
    seen[5] = False
    left, bound = rng.rayleigh(20e-6, (36, 2)), rng.uniform(20e-6, 60e-6, (36, 2))
    noise = rng.uniform(1e-6, 9e-6, (36, 2)) ** 2
    return validation._Displacements(
        is_compared=seen, config=config, load=load, displacement=rng.rayleigh(1e-3, (36, 2)), prediction_error=left,
        bound=bound, noise=noise, error_ratio=left / np.sqrt(bound**2 + 4.0 * noise), has_bound=True,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
def test_the_numbers_of_each_level_are_those_of_its_states_by_loops(seed):
    found = compared(seed)
    result = validation._validated_levels(found)
    assert len(result) == 3
    for index, level in enumerate(result):
        states = [k for k in range(12 * index, 12 * index + 12) if found.is_compared[k].any()]
        places = [(k, p) for k in states for p in range(2) if found.is_compared[k, p]]

        def mean(values, places=places):
            return math.fsum(values[place] for place in places) / len(places)

        assert level.load == pytest.approx(np.median([found.load[k] for k in states]))
        for name in ("displacement", "prediction_error", "bound"):
            own = level.measured if name == "displacement" else getattr(level, name)
            assert own == pytest.approx(math.sqrt(mean(getattr(found, name) ** 2))), name
        assert level.noise == pytest.approx(math.sqrt(mean(found.noise)))
        assert level.inside == pytest.approx(mean((found.error_ratio <= 1.0).astype(float)))
        assert level.error_ratio == pytest.approx(np.quantile([found.error_ratio[place] for place in places], 0.95))
        squares = [
            np.mean([found.prediction_error[k, p] ** 2 for p in range(2) if found.is_compared[k, p]]) for k in states
        ]
        spread = math.sqrt(sum((one - np.mean(squares)) ** 2 for one in squares) / (len(squares) - 1))
        assert level.standard_error == pytest.approx(spread / math.sqrt(len(squares)))
        # a level is kept or not by itself; for refusing, a twentieth of doubt is shared by the levels
        good = [sum(found.is_compared[k, p] and found.error_ratio[k, p] <= 1.0 for p in range(2)) for k in states]
        there = [int(found.is_compared[k].sum()) for k in states]
        counts = np.array(good, float), np.array(there, float)
        assert level.limits == (share_limits(*counts, 0.05)[0], share_limits(*counts, 0.05 / 3)[1])
        assert level.configurations == len({found.config[k] for k in states})


def test_a_level_of_one_configuration_and_a_model_without_a_bound_leave_all_open():
    found = compared(0)
    (alone,) = validation._validated_levels(
        replace(found, is_compared=found.is_compared & (np.arange(36) == 7)[:, None])
    )
    assert (alone.standard_error, alone.limits) == (np.inf, (0.0, 1.0))
    for level in validation._validated_levels(replace(found, has_bound=False)):
        assert np.isnan(level.inside)
        assert np.isnan(level.error_ratio)
        assert level.limits == (0.0, 1.0)


def test_the_table_has_a_line_for_each_level_in_millimetres():
    covered = coverage(np.zeros((0, 6)), np.zeros(0, dtype=np.int64))
    one = ValidatedLevel(
        load=540.4, measured=1.2344e-3, prediction_error=0.0512e-3, noise=0.0104e-3, standard_error=1e-12, inside=0.96,
        limits=(0.9, 0.99),
        error_ratio=0.9, bound=0.0621e-3, configurations=10,
    )  # fmt: skip
    other = replace(one, load=2700.0, inside=float("nan"), limits=(0.0, 1.0), prediction_error=0.0104e-3)
    lines = table(Validation((one, other), covered, (), ())).splitlines()
    assert lines[1].split() == [
        "load", "N", "measured", "mm", "left", "mm", "noise", "mm", "bound", "mm", "factor", "inside", "of", "all",
    ]  # fmt: skip
    # 1.2344 / √(0.0512² − 0.0104²) = 24.6; noise hides the other: 1.2344 / √(2·10⁻⁶) would be the least
    assert lines[2].split() == ["540", "1.234", "0.051", "0.010", "0.062", "24.6", "96%", "90%", "to", "99%"]
    assert lines[3].split()[:5] == ["2700", "1.234", "0.010", "0.010", "0.062"]
    assert lines[3].split()[5] == ">"
    assert lines[3].split()[-2:] == ["–", "–"]
    assert len({line.rindex(word) for line, word in zip(lines[1:3], ("all", "99%"), strict=True)}) == 1


@pytest.mark.parametrize(
    ("stiffness", "half", "free_length", "levels", "reason"),
    [
        (1e5, 1e3, 0.45, 5, None),
        (-1e5, 1e3, 0.45, 5, "which no spring has"),
        (1e5, 1e3, 50.0, 5, "which no spring has"),  # 50 m long
        (1e5, 1e3, -0.1, 5, "which no spring has"),
        (1e5, 4.9e4, 0.45, 5, None),
        (1e5, 5.1e4, 0.45, 5, "too small against the noise"),
        (1e5, 1e3, 0.45, 3, None),
        (1e5, 1e3, 0.45, 2, "there are 2 levels of q2"),
    ],
)
def test_why_a_compensator_is_not_observable(stiffness, half, free_length, levels, reason):
    kind, preload = robot.CompensatorStiffness(), robot.CompensatorPreload()
    fit = SimpleNamespace(
        structure=SimpleNamespace(parameters=(kind, preload)), values=np.array([stiffness, stiffness * free_length]),
        ci95=np.array([half, half]), parameter_values={kind: stiffness, preload: stiffness * free_length},
    )  # fmt: skip
    data = SimpleNamespace(q=np.outer(np.repeat(np.arange(levels), 4) * -0.4, np.eye(6)[1]))
    found = joint_springs._unobservable_compensator(fit, data, 1.0, False)
    assert (found is None) == (reason is None)
    assert reason is None or reason in found.reason
