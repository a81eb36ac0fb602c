"""Structures with priors of physical size: nothing that the readings do not excite is free."""

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import robot
from postproc.errors import MeasurementError, NotConvergedError
from postproc.identification import choice, over_pose
from postproc.identification.choice import Mean, Member, projection
from postproc.identification.fit import FACTORS, LinearEquations, Prior, Regression, learn, prior_of
from postproc.identification.measurement_model import Structure, locate, predict
from postproc.identification.model_folder import require_finite
from postproc.robot.parameters import parameter_of_name
from samples.paper_study import harness, simulator

CONFIGS, ROWS = 30, 6


def equations(rng, design, values):
    """Readings of unit noise."""
    config = np.repeat(np.arange(CONFIGS), ROWS)
    return LinearEquations(design, design @ values + rng.normal(size=len(design)), config, np.ones(len(design)))


def links(count, mean=0.0, size=1.0):
    """Return a prior of springs of one kind."""
    return Prior(np.full(count, mean), np.full(count, size), np.zeros(count, dtype=int), ("link rotation",),
                 np.zeros(count, dtype=bool))  # fmt: skip


def test_the_size_of_each_parameter_is_physical_and_stated_ones_keep_their_spread():
    names = ("A2.RX", "A2.X", "base.end_RY", "k3^73", "k3@700", "A4.backlash@11", "A4.lost_motion@11", "k3", "A2.mass")
    parameters = tuple(parameter_of_name(name) for name in names)
    prior = prior_of(Structure(parameters, harness.PRIOR))
    k = harness.PRIOR.compliance
    assert [prior.kinds[kind] if kind >= 0 else "" for kind in prior.kind_index] == [
        "link rotation", "link translation", "base rotation", "breakpoint", "fading", "backlash", "lost motion",
        "joint", "",
    ]  # fmt: skip
    stated = 0.15 * harness.PRIOR.nominal.mass[1]
    expected = [0.1 * k[1], 1e-8, 0.1 * k[0], 0.1 * k[2], 0.1 * k[2], 2e-5, 2e-5, k[2], stated]
    np.testing.assert_allclose(prior.size, expected)
    np.testing.assert_allclose(prior.mean, [0.0] * 7 + [k[2], harness.PRIOR.nominal.mass[1]])
    np.testing.assert_array_equal(prior.signed, [False] * 8 + [True])


def test_what_no_reading_excites_keeps_the_size_of_its_prior():
    """Two parameters of a gear that all readings see as one: only their sum is determined."""
    rng = np.random.default_rng(3)
    design = rng.normal(size=(CONFIGS * ROWS, 6)) * 10.0
    design[:, 1] = design[:, 0]
    design[:, 5] = 0.0
    regression = learn(equations(rng, design, np.array([1.0, 1.0, 2.0, 0.5, 1.5, 0.0])), links(6), np.arange(6))
    found = equations(rng, design, np.array([1.0, 1.0, 2.0, 0.5, 1.5, 0.0]))
    values, covariance = regression.solve(found), regression.covariance(found)
    assert (np.diag(covariance) <= regression.spread**2 * (1.0 + 1e-12)).all()
    assert covariance[5, 5] == pytest.approx(regression.spread[5] ** 2)
    assert values[5] == 0.0
    assert values[0] + values[1] == pytest.approx(2.0, abs=0.1)
    together = np.array([1.0, 1.0, 0, 0, 0, 0])
    assert together @ covariance @ together < 1e-2 * covariance[0, 0]
    assert covariance[0, 0] == pytest.approx(0.5 * regression.spread[0] ** 2, rel=0.1)


def test_evidence_finds_the_size_of_parameters_and_of_the_noise():
    rng = np.random.default_rng(4)
    sizes, noises = [], []
    for _ in range(20):
        design = rng.normal(size=(CONFIGS * ROWS, 25))
        made = equations(rng, design, np.abs(rng.normal(0.0, 3.0, 25)))
        louder = replace(made, target=design @ np.linalg.lstsq(design, made.target)[0] + 1.5 * rng.normal(size=180))
        found = learn(louder, links(25), np.arange(25))
        sizes.append(found.spread[0])
        noises.append(found.noise)
    assert np.median(sizes) == pytest.approx(3.0, rel=0.25)
    assert np.median(noises) == pytest.approx(1.5**2, rel=0.2)


@pytest.mark.parametrize("kind", FACTORS)
def test_evidence_has_the_slopes_that_its_search_uses(kind):
    """The factors found are a stationary point of the density, computed without any of the code's algebra."""
    rng = np.random.default_rng(6)
    design, wide, mean = rng.normal(size=(CONFIGS * ROWS, 8)), FACTORS[kind], 0.3
    made = equations(rng, design, mean + 4.0 * rng.normal(size=8))
    made = replace(made, target=made.target + 1.2 * rng.normal(size=180))  # louder than stated
    found = learn(made, replace(links(8, mean, 0.5), kinds=(kind,)), np.arange(8))

    def density(log_factor, log_noise):
        covariance = np.exp(log_noise) * np.eye(len(design)) + 0.25 * np.exp(2.0 * log_factor) * design @ design.T
        _, size = np.linalg.slogdet(covariance)
        target = made.target - design @ np.full(8, mean)
        value = -0.5 * (size + target @ np.linalg.solve(covariance, target))
        return value - 0.5 * ((log_factor - wide[0]) / wide[1]) ** 2 - 0.5 * (log_noise / 0.5) ** 2

    here = np.array([np.log(found.spread[0] / 0.5), np.log(found.noise)])
    assert here.min() > 0.1
    assert density(*here) == pytest.approx(found.evidence, abs=1e-6)
    for step in 1e-4 * np.eye(2):
        assert abs(density(*(here + step)) - density(*(here - step))) / 2e-4 < 1e-3  # of some units in each direction


def test_a_wider_structure_without_effect_gains_no_evidence():
    rng = np.random.default_rng(7)
    design = rng.normal(size=(CONFIGS * ROWS, 20))
    made = equations(rng, design, np.r_[np.full(10, 2.0), np.zeros(10)])
    prior = replace(links(20), kind_index=np.repeat([0, 1], 10), kinds=("link rotation", "breakpoint"))
    narrow, wide = (learn(made, prior, np.arange(count)).evidence for count in (10, 20))
    assert wide < narrow + 1.0


def test_the_mean_covers_what_changes_with_noise():
    rng = np.random.default_rng(8)
    design, values = rng.normal(size=(CONFIGS * ROWS, 5)), np.array([3.0, 1.0, 2.0, 0.5, 1.5])
    found, stated = [], []
    for _ in range(60):
        made = equations(rng, design, values)
        regressions = [learn(made, links(5), np.arange(count)) for count in (5, 5)]
        members = tuple(Member(str(i), False, one, made.residual(one.solve(made))) for i, one in enumerate(regressions))
        mean = Mean(Structure((), harness.PRIOR), made, members, np.array([0.3, 0.7]))
        mean = replace(mean, structure=_Sized(5))
        found.append(mean.solve())
        stated.append(np.diag(mean.covariance()))
    assert 0.8 < np.mean(stated) / np.mean(np.var(found, axis=0)) < 1.25, "of 300 squares: ± 16 % by chance"


class _Sized:
    def __init__(self, size):
        self.parameters = (None,) * size


def test_dropped_springs_are_stood_in_for_by_what_imitates_them():
    rng = np.random.default_rng(9)
    design = 5.0 * rng.normal(size=(CONFIGS * ROWS, 4))
    design[:, 3] = 0.5 * design[:, 0] + 0.25 * design[:, 1]
    onto = projection(equations(rng, design, np.ones(4)), np.arange(3), np.ones(4))
    np.testing.assert_allclose(onto[:, :3], np.eye(3))
    np.testing.assert_allclose(onto[:, 3], [0.5, 0.25, 0.0], atol=1e-3)
    silent = design.copy()
    silent[:, 0] *= 1e-9  # a spring that no reading excites does not grow to imitate another
    onto = projection(equations(rng, silent, np.ones(4)), np.array([0]), np.ones(4))
    assert np.abs(onto).max() <= 1.0


def test_a_regression_solves_signed_parameters_freely_and_others_not_below_zero():
    rng = np.random.default_rng(10)
    design = 10.0 * rng.normal(size=(CONFIGS * ROWS, 3))
    made = equations(rng, design, np.array([-1.0, -1.0, 1.0]))
    regression = Regression(np.arange(3), np.zeros(3), np.full(3, 5.0), np.array([False, True, False]), 1.0, 0.0, 3)
    values = regression.solve(made)
    assert values[0] == 0.0
    assert values[1] < -0.9
    step = 1e-5
    influence = regression.influence(made, values)
    moved = replace(made, target=made.target + step * np.arange(len(made.target)))
    np.testing.assert_allclose(
        regression.solve(moved) - values, step * influence @ np.arange(len(made.target)), rtol=1e-3, atol=1e-9
    )


def test_no_number_that_is_not_finite_reaches_a_file():
    for content in ({"joints": {"A3": {"ci95": np.nan}}}, {"rows": [{"joints": {"A3": {"ci95": np.inf}}}]}):
        with pytest.raises(MeasurementError, match=r"model.toml: .*joints.A3.ci95 would be (nan|inf)"):
            require_finite(content, "model.toml")
    require_finite({"joints": {"A3": {"ci95": 1.0, "source": "nan"}}, "rows": [1, None]}, "model.toml")


def test_a_load_without_equilibrium_is_named_by_configuration(tmp_path):
    rng = np.random.default_rng(1)
    true, (q, f) = simulator.paper_like(rng), simulator.plan(rng, 6)
    _, raw = simulator.measure(true, q, f, rng)
    data = harness.load(simulator.write(tmp_path, q, f, raw))
    placement = locate(harness.PRIOR, data)
    structure = Structure(robot.JOINT_COMPLIANCES, harness.PRIOR)
    heavy = replace(data, wrench=np.where(np.arange(12)[:, None] == data.loaded_states[3], 1e4, 1.0) * data.wrench)
    with pytest.raises(NotConvergedError, match="config 4, load 1: "):
        predict(structure, structure.start_values(), heavy, placement)


@pytest.mark.parametrize("compensator", [False, True])
@pytest.mark.parametrize("gears", [(), ("fading",), ("fading", "breakpoint", "backlash"), choice.GEARS])
def test_all_structures_whose_parameters_a_robot_has_are_tried(gears, compensator, monkeypatch):
    """From joint springs alone to all of them together; gears that are not linear bring the sources at rest along."""
    kinds = ["joint", "link", "end", *(["compensator"] if compensator else ["at rest"]), *gears]
    learnt = []
    monkeypatch.setattr(
        choice, "learn", lambda _, __, columns: (learnt.append(columns), SimpleNamespace(evidence=0.0))[1]
    )
    monkeypatch.setattr(choice, "_fold_residuals", lambda *_: np.zeros(CONFIGS * ROWS))
    monkeypatch.setattr(choice, "_stacking_weights", lambda *_: None)
    equations = SimpleNamespace(config_count=CONFIGS)
    mean = choice._mean_of_structures(
        SimpleNamespace(equations=equations, kinds=tuple(kinds), prior=None, structure=None), compensator
    )
    words = {"fading": "stiffen", "breakpoint": "breakpoints", "backlash": "backlash", "lost motion": "lost motion"}
    expected = [
        name for name, _ in choice.candidates(compensator)
        if all(word not in name or kind in gears for kind, word in words.items())
    ]  # fmt: skip
    assert [member.name for member in mean.members] == expected
    richest = "link springs, link ends and base" + (", compensator" if compensator else "")
    if gears == ("fading", "breakpoint", "backlash"):
        assert f"{richest}, gears stiffen, with breakpoints and backlash" in expected
    for member, columns in zip(mean.members, learnt, strict=True):
        used = {kinds[column] for column in columns}
        assert ("joint" in used, "link" in used, "end" in used) == (True, "link" in member.name, "ends" in member.name)
        assert ("at rest" in used) == (not compensator and "gears" in member.name)
        assert {kind for kind in gears if kind in used} == {k for k in gears if words[k] in member.name}


def test_each_arm_is_tried_with_linear_gears_first_and_no_structure_twice():
    names = [name for name, _ in choice.candidates(False)]
    kinds = [frozenset(kinds) for _, kinds in choice.candidates(False)]
    assert len(set(names)) == len(set(kinds)) == len(names) == 2 + 10 + 6
    arms = {"joint springs": {"joint"}, "link springs": {"joint", "link"}}
    arms["link springs, link ends and base"] = {"joint", "link", "end"}
    for arm, of_arm in arms.items():
        own = [
            (name, set(one) - of_arm)
            for name, one in choice.candidates(False)
            if set(one) - set(choice.GEARS) == of_arm
        ]
        assert own[0] == (arm, set())
        assert all(name.startswith(arm) for name, _ in own)
        sizes = [len(gears) for _, gears in own]
        assert sizes[0] == 0
        assert min(sizes[1:]) >= 1
        assert not any({"backlash", "lost motion"} <= gears for _, gears in own)  # one is the other with weights
        assert arm == "joint springs" or max(sizes) == 3


def test_members_count_as_non_linear_by_their_gears():
    assert choice.candidates(True)[0] == ("joint springs, compensator", ("joint", "compensator"))
    assert all(
        ("gears" in name) == (not set(kinds).isdisjoint(choice.GEARS)) for name, kinds in choice.candidates(False)
    )


@pytest.mark.parametrize("shared", [0.0, 0.6])
def test_the_design_effect_is_the_growth_of_the_variance_of_the_values_by_residuals_that_configurations_share(shared):
    rng = np.random.default_rng(12)
    design = np.repeat(rng.normal(size=(120, 2)), ROWS, axis=0)  # of one configuration alike
    config = np.repeat(np.arange(120), ROWS)
    influence = np.linalg.pinv(design)
    values, effects = [], []
    for _ in range(300):
        common = np.repeat(rng.normal(size=120), ROWS)
        residual = np.sqrt(shared) * common + np.sqrt(1.0 - shared) * rng.normal(size=len(design))
        values.append(influence @ residual)
        effects.append(
            choice.design_effect(LinearEquations(design, residual, config, np.ones(len(design))), influence, residual)
        )
    grown = np.trace(np.cov(np.array(values).T)) / np.trace(influence @ influence.T)
    assert np.median(effects) == pytest.approx(grown, rel=0.12)
    assert min(effects) >= 1.0


def test_couplings_waves_and_the_compensator_have_sizes_of_the_joints_and_of_springs():
    """A tenth of the geometric mean of two joints; a tenth of one for all waves together; 10⁶ N/m and 10⁶ N."""
    k = harness.PRIOR.compliance
    wave = robot.PoseWave("A3", (0, 1, 0, 0, 0, 0), "sin")
    parameters = (robot.GearCoupling("A4", "A6"), wave, *robot.COMPENSATOR)
    prior = prior_of(Structure(parameters, harness.PRIOR))
    assert [prior.kinds[kind] for kind in prior.kind_index] == [
        "coupling",
        "A3 over the pose",
        "compensator",
        "compensator",
    ]
    sizes = [0.1 * np.sqrt(k[3] * k[5]), 0.1 * k[2] * over_pose.amplitude_share(wave), 1e6, 1e6]
    np.testing.assert_allclose(prior.size, sizes)
    np.testing.assert_array_equal(prior.mean, 0.0)
    assert prior.signed[:2].tolist() == [True, True]
