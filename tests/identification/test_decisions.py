"""Decisions of an identification on both sides of their limits: parameters, structure, what is left open."""

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import robot
from postproc.compensator import Compensator
from postproc.errors import MeasurementError
from postproc.identification import choice, joint_springs, procedure
from postproc.identification.fit import Fit
from postproc.identification.joint_springs import UnobservableParameter
from postproc.identification.measurement_model import Structure
from postproc.robot import JOINT_COMPLIANCES, CompensatorPreload, CompensatorStiffness
from samples.paper_study import harness
from tests.identification.test_joint_springs import ARM, LOADED_TIP, SPRINGS, forces, placed, posed, readings
from tests.identification.test_judgement import fit_of

BARE = replace(harness.PRIOR, compensator=None)
SPRING = (CompensatorStiffness(), CompensatorPreload())


def fit_with_spring(data, stiffness, length, half, k2_half=0.02):
    """A fit of joint springs and of a compensator of this stiffness [N/m], free length [m] and 95 % interval."""
    values = np.array([*SPRINGS, stiffness, stiffness * length])
    sigma = np.array([*(0.02 * SPRINGS), half / 1.959964, 1.0])
    sigma[1] = k2_half * harness.PRIOR.compliance[1] / 1.959964
    return fit_of(data, values, covariance=np.diag(sigma**2), parameters=(*JOINT_COMPLIANCES, *SPRING))


def at_levels(angles):
    data = readings(forces(len(angles), 500.0), count=len(angles))
    q = data.q.copy()
    q[:, 1] = np.radians(angles)
    return replace(data, q=q)


FIVE = at_levels([-50.0, -60.0, -70.0, -80.0, -90.0])


@pytest.mark.parametrize(
    ("stiffness", "length", "half", "reason"),
    [
        (8e4, 0.45, 3.9e4, ""),
        (8e4, 0.45, 4.1e4, "its effect on joint 2 is too small against the noise (K_c 8e+04 ± 4.1e+04 N/m)"),
        (-8e4, 0.45, 1e4, "the fit gives K_c -8e+04 N/m, which no spring has"),
        (8e4, 2.9, 1e4, ""),
        (8e4, 3.1, 1e4, "which no spring has"),
        (8e4, -0.1, 1e4, "which no spring has"),
    ],
)
def test_a_compensator_that_is_uncertain_by_half_or_cannot_be_built_is_open(stiffness, length, half, reason):
    entries = joint_springs.unobservable_parameters(fit_with_spring(FIVE, stiffness, length, half), FIVE)
    assert len(entries) == bool(reason)
    if reason:
        assert entries[0].parameter == CompensatorStiffness()
        assert reason in entries[0].reason
    assert joint_springs.has_possible_compensator(fit_with_spring(FIVE, stiffness, length, half)) == (
        "no spring" not in reason
    )


def test_a_compensator_needs_three_levels_and_a_known_second_joint():
    two = at_levels([-50.0, -50.5, -80.0, -80.5, -81.0])
    (entry,) = joint_springs.unobservable_parameters(fit_with_spring(two, 8e4, 0.45, 1e3), two)
    assert entry.reason == "K_theta2_0, K_c and s_0 are three unknowns, and there are 2 levels of q2"
    three = at_levels([-50.0, -50.5, -65.0, -80.5, -81.0])
    assert joint_springs.unobservable_parameters(fit_with_spring(three, 8e4, 0.45, 1e3), three) == []
    entries = joint_springs.unobservable_parameters(fit_with_spring(FIVE, 8e4, 0.45, 1e3, k2_half=0.9), FIVE)
    # without the compensator k2 is determined again, so that comes first
    assert [entry.parameter for entry in entries] == [CompensatorStiffness(), JOINT_COMPLIANCES[1]]
    assert "there are 5 levels" in entries[0].reason


def test_a_fit_without_a_compensator_is_physical():
    assert joint_springs.has_possible_compensator(fit_of(FIVE))


def test_loads_without_a_lever_are_the_reason_before_the_interval_is():
    """Of 2 % of the largest torque on; A1 by vertical loads, A6 by loads on its axis, others by their lever."""
    torque = np.full((4, 6), 1000.0)
    for joint, words in ((0, "vertical"), (2, "has a lever about A3"), (5, "on its axis")):
        small = torque.copy()
        small[:, joint] = -19.0
        entry = joint_springs._unloaded_joint(JOINT_COMPLIANCES[joint], small)
        assert words in entry.reason + entry.advice
        assert f"the loads put at most 19 N·m on A{joint + 1}" in entry.reason
        small[:, joint] = -21.0
        assert joint_springs._unloaded_joint(JOINT_COMPLIANCES[joint], small) is None


def test_joints_without_torque_are_those_below_a_fiftieth_of_the_largest():
    data = readings(forces(5, 500.0), count=5)
    wrench = np.zeros_like(data.wrench)
    wrench[1::2, 2] = -500.0  # vertical: nothing on A1
    data = replace(data, wrench=wrench)
    torque = np.max([np.abs(ARM.gradient(lambda x: -500.0 * ARM.tcp(x, LOADED_TIP)[2, 3], q)) for q in data.q], axis=0)
    expected = [joint for joint in range(6) if torque[joint] < 0.02 * torque.max()]
    assert 0 in expected
    assert [JOINT_COMPLIANCES.index(joint) for joint in joint_springs.unloaded_joints(BARE, data)] == expected


def test_all_candidates_have_their_kind_and_gears_have_torques_of_their_joint():
    """Vertical loads: A1 has none, so that its gear has no parameters of its own."""
    data = readings(forces(6, 500.0), count=6)
    wrench = np.zeros_like(data.wrench)
    wrench[1::2, 2] = -500.0
    data = replace(data, wrench=wrench)
    torque = np.max([np.abs(ARM.gradient(lambda x: -500.0 * ARM.tcp(x, LOADED_TIP)[2, 3], q)) for q in data.q], axis=0)
    loaded = [joint for joint in range(6) if torque[joint] >= 0.02 * torque.max()]
    assert 0 not in loaded
    for carries_weight in (False, True):
        for compensator in (False, True):
            structure, kinds = choice.full_structure(harness.PRIOR, data, carries_weight, compensator)
            of_kind = {
                kind: [p for p, k in zip(structure.parameters, kinds, strict=True) if k == kind] for kind in kinds
            }
            assert of_kind["joint"] == list(JOINT_COMPLIANCES)
            assert structure.carries_weight == carries_weight
            assert of_kind.get("compensator", []) == (list(robot.COMPENSATOR) if compensator else [])
            assert ("lost motion" in of_kind) == carries_weight
            assert ("at rest" in of_kind) == (carries_weight and not compensator)
            for kind, steps in (
                ("fading", (0.2, 0.6, 2.0)), ("breakpoint", (0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28)),
                ("backlash", (0.01,)), ("lost motion", (0.01,)),
            ):  # fmt: skip
                if kind not in of_kind:
                    continue
                names = [f"A{joint + 1}" for joint in loaded for _ in steps]
                assert [parameter.joint for parameter in of_kind[kind]] == names
                at = [step * torque[joint] for joint in loaded for step in steps]
                torques = [parameter.torque for parameter in of_kind[kind]]
                np.testing.assert_allclose(torques, at, rtol=0.06)  # two digits
                assert all(float(f"{value:.2g}") == value for value in torques)
            assert set(of_kind["link"]).isdisjoint(of_kind["end"])
            assert not any(spring.at_end or spring.link == "base" for spring in of_kind["link"])
            assert len(set(structure.parameters)) == len(structure.parameters)
    light = replace(data, wrench=data.wrench * (0.9 / torque[loaded].max()))  # below 1 N·m on every joint
    _, kinds = choice.full_structure(harness.PRIOR, light, True, False)
    assert "fading" not in kinds


def test_sources_of_torque_at_rest_are_uncertain_masses_and_the_compensator():
    sources = list(choice._gravity_parameters(harness.PRIOR))
    assert sources[-1] == robot.CompensatorSize()
    assert {source.joint for source in sources[:-1]} == {f"A{n}" for n in range(2, 7)} - {
        f"A{n}" for n in range(2, 7) if harness.PRIOR.prior_sigma(robot.LinkMass(f"A{n}")) <= 0.0
    }
    assert robot.CompensatorSize() not in list(choice._gravity_parameters(BARE))
    stated = replace(harness.PRIOR, mass_spread=0.0, compensator_spread=0.0)
    assert list(choice._gravity_parameters(stated)) == []


@pytest.mark.parametrize(("angles", "enough"), [([-50.0, -60.0, -60.5], False), ([-50.0, -60.0, -70.0], True)])
def test_a_compensator_is_looked_for_from_three_levels_on(angles, enough):
    data = at_levels(angles)
    assert choice.can_identify_compensator(harness.PRIOR, data) == enough
    assert not choice.can_identify_compensator(BARE, data)


@pytest.mark.parametrize(("half", "is_open"), [(0.49, False), (0.51, True)])
def test_a_spring_is_open_from_half_its_value_on(half, is_open):
    fit = fit_with_spring(FIVE, 8e4, 0.45, half * 8e4)
    assert choice._has_uncertain_compensator(SimpleNamespace(fit=fit)) == is_open
    assert not choice._has_uncertain_compensator(SimpleNamespace(fit=fit_of(FIVE)))


def chi_of(dof, chi2, target=0.0):
    return SimpleNamespace(dof=dof, chi2=chi2, target=np.array([np.sqrt(target)]))


@pytest.mark.parametrize(("deviations", "look"), [(0.99, False), (1.01, True)])
def test_richer_structures_are_looked_at_from_one_standard_deviation_of_the_squares_on(deviations, look):
    """χ² of n degrees of freedom has a standard deviation of √(2n)."""
    assert procedure._has_possible_error(chi_of(98, 98 + deviations * 14.0)) == look


@pytest.mark.parametrize(("share", "hidden"), [(0.99, True), (1.01, False)])
def test_links_of_a_sixteenth_of_the_displacements_are_hidden_below_ten_standard_deviations(share, hidden):
    """Links that add 6 % would add .06² of the squares; noise hides less than ten standard deviations of χ²."""
    assert procedure._would_hide_link_springs(chi_of(50, 50.0, share * 100.0 / 0.06**2)) == hidden


@pytest.mark.parametrize(("gain", "better"), [(2.9, False), (3.1, True)])
def test_a_richer_structure_needs_odds_of_one_in_twenty(gain, better, monkeypatch):
    monkeypatch.setattr(procedure, "evidence_of", lambda *_: 100.0)
    fit = SimpleNamespace(structure=None, values=None)
    assert procedure._has_clear_evidence(SimpleNamespace(evidence=100.0 + gain), fit, None, None) == better


def test_what_a_mean_of_structures_leaves_open_are_joints_without_load_and_the_compensator():
    wrench = forces(6, 500.0)
    wrench[:, :2] = 0.0  # vertical: nothing on A1
    data = replace(readings(wrench, count=6), load_point=np.array([0.4, -0.3, 0.35]))  # with a lever about A6
    earlier = UnobservableParameter(JOINT_COMPLIANCES[0], "said before", "do this")
    gone = UnobservableParameter(JOINT_COMPLIANCES[3], "of a model that was given up", "")

    def left(prior, parameters):
        fit = SimpleNamespace(structure=SimpleNamespace(prior=prior), parameter_values=dict.fromkeys(parameters, 1.0))
        return procedure._undetermined_springs(SimpleNamespace(fit=fit), data, [earlier, gone])

    assert left(BARE, ()) == [earlier]
    assert left(harness.PRIOR, SPRING) == [earlier]
    first, second = left(harness.PRIOR, ())
    assert (first, second.parameter) == (earlier, CompensatorStiffness())
    assert second.reason == "next to link springs its effect on joint 2 is too small"
    _, second = left(harness.PRIOR, (robot.CompensatorSize(),))
    assert second.parameter == CompensatorPreload()
    assert "the torque on the gears at rest shows how strong it is" in second.reason
    fit = SimpleNamespace(structure=SimpleNamespace(prior=BARE), parameter_values={})
    (new,) = procedure._undetermined_springs(SimpleNamespace(fit=fit), data, [])
    assert (new.parameter, new.reason) == (JOINT_COMPLIANCES[0], "the loads put no torque on it")


def test_readings_are_as_many_as_unknowns_at_least():
    data = readings(forces(2, 500.0), count=2, points=np.array([[0.1, 0.0, 0.2]]))
    with pytest.raises(MeasurementError, match="6 loaded coordinates for 6 compliances"):
        joint_springs.fit_joints(BARE, data, placed(data), None)
    three = readings(forces(3, 500.0), count=3, points=np.array([[0.1, 0.0, 0.2]]))
    fit, _ = joint_springs.fit_joints(BARE, three, placed(three), None)
    assert fit.dof == 9 - len(fit.values)


def test_the_extended_set_has_the_compliance_of_joint_2_at_each_level():
    """Readings of a robot whose second joint is another at each level of q2: each is found, with its angle."""
    angles = np.radians([-50.0, -70.0, -90.0])
    wrench, level = forces(9, 300.0), np.arange(9) % 3
    data = readings(wrench, count=9)
    q, k2 = posed(1, 9), np.array([0.2, 0.3, 0.5]) * 1e-6
    q[:, 1] = angles[level]
    position = data.position.copy()
    for n in range(9):
        springs = SPRINGS.copy()
        springs[1] = k2[level[n]]
        torque = ARM.gradient(lambda x, n=n: wrench[n, :3] @ ARM.tcp(x, LOADED_TIP)[:3, 3], q[n])
        for state, x in ((2 * n, q[n]), (2 * n + 1, q[n] + springs * torque)):
            flange = ARM.tcp(x, np.eye(4))
            rows = np.flatnonzero(data.state == state)
            position[rows] = data.guess[data.point[rows]] @ flange[:3, :3].T + flange[:3, 3]
    data = replace(data, q=q, position=position)
    fit, levels = joint_springs.extended_set(harness.PRIOR, data, placed(data))
    order = np.argsort(angles)
    np.testing.assert_allclose(levels.q2, angles[order])
    np.testing.assert_allclose(levels.compliance, k2[order], rtol=5e-3)
    np.testing.assert_allclose(np.delete(fit.values, [1, 2, 3]), np.delete(SPRINGS, 1), rtol=5e-3)
    np.testing.assert_array_equal(levels.covariance, fit.covariance[1:4, 1:4])
    few = data.take_configurations(np.array([0]))
    rows = ("state", "point", "repeat", "position", "line", "used")
    one = replace(few, points=few.points[:2], guess=few.guess[:2], **{n: getattr(few, n)[few.point < 2] for n in rows})
    assert joint_springs.extended_set(harness.PRIOR, one, placed(one)) is None  # 6 coordinates for 6 values


@pytest.mark.parametrize(("growth", "refuted"), [(13.7, False), (13.9, True)])
@pytest.mark.parametrize("misfit", [1.0, 2.5])
def test_the_prior_spring_is_refuted_where_the_squares_grow_as_noise_makes_them_once_in_a_thousand(
    growth, refuted, misfit, monkeypatch
):
    """χ² of two degrees of freedom exceeds 13.8 in one of a thousand; a misfit counts as noise."""
    assert np.exp(-13.8 / 2.0) == pytest.approx(1e-3, rel=0.01)
    fit = fit_with_spring(FIVE, 8e4, 0.45, 1e4)
    fit = replace(fit, chi2=misfit * fit.dof)
    tried = []

    def attempt(structure, *_):
        tried.append(structure.parameters)
        return SimpleNamespace(chi2=fit.chi2 + growth * misfit)

    monkeypatch.setattr(joint_springs, "_attempt", attempt)
    assert joint_springs._refutes_prior_spring(fit, FIVE, placed(FIVE)) == refuted
    assert tried == [tuple(JOINT_COMPLIANCES)]
    unknown = replace(fit, covariance=np.where(np.eye(8) * (np.arange(8) == 6) > 0, np.inf, fit.covariance))
    assert not joint_springs._refutes_prior_spring(unknown, FIVE, placed(FIVE))


def test_a_compensator_of_the_levels_is_where_the_fit_begins(monkeypatch):
    """K⁰_θ2, K_c and s₀·K_c of the two steps of the paper."""
    starts = []

    def attempt(structure, data, placement, values):
        starts.append((structure.parameters, values.copy()))
        return fit_of(FIVE, values, parameters=structure.parameters)

    monkeypatch.setattr(joint_springs, "_attempt", attempt)
    monkeypatch.setattr(joint_springs, "unobservable_parameters", lambda *_: [])
    law = Compensator(stiffness=8e4, free_length=0.45, L=0.184, ax=0.685, ay=0.12)
    prior = replace(harness.PRIOR, compensator=law)
    spring = joint_springs.SpringOfJoint2(np.array([4e6, 9e4, 3e4]), np.eye(3))
    joint_springs.fit_joints(prior, FIVE, placed(FIVE), spring)
    parameters, values = starts[-1]
    assert parameters == (*JOINT_COMPLIANCES, *robot.COMPENSATOR)
    np.testing.assert_allclose(values[[1, 6, 7]], [1 / 4e6, 9e4, 3e4])
    usual = Structure(parameters, prior).start_values()
    np.testing.assert_array_equal(np.delete(values, [1, 6, 7]), np.delete(usual, [1, 6, 7]))
    for start in (None, joint_springs.SpringOfJoint2(np.array([-4e6, 9e4, 3e4]), np.eye(3))):
        joint_springs.fit_joints(prior, FIVE, placed(FIVE), start)
        np.testing.assert_array_equal(starts[-1][1], usual)


def test_open_parameters_are_left_out_one_after_the_other(monkeypatch):
    """Compensator first with both its numbers; joints one by one, until all are known or none is left."""
    told = {
        8: [
            UnobservableParameter(CompensatorStiffness(), "c", ""),
            UnobservableParameter(JOINT_COMPLIANCES[3], "d", ""),
        ],
        6: [UnobservableParameter(JOINT_COMPLIANCES[3], "e", ""), UnobservableParameter(JOINT_COMPLIANCES[5], "f", "")],
        5: [],
    }  # fmt: skip
    tried = []

    def attempt(structure, *_):
        tried.append(structure.parameters)
        return fit_of(FIVE, np.ones(len(structure.parameters)), parameters=structure.parameters)

    monkeypatch.setattr(joint_springs, "_attempt", attempt)
    monkeypatch.setattr(joint_springs, "_refutes_prior_spring", lambda *_: False)
    monkeypatch.setattr(joint_springs, "unobservable_parameters", lambda fit, _: told[len(fit.values)])
    fit, missing = joint_springs.fit_joints(harness.PRIOR, FIVE, placed(FIVE), None)
    assert [entry.reason for entry in missing] == ["c", "e"]
    assert fit.structure.parameters == tuple(np.delete(np.array(JOINT_COMPLIANCES, dtype=object), 3))
    assert [len(parameters) for parameters in tried] == [8, 6, 5]
    # readings that refute the prior's spring: the uncertain one is better than that
    monkeypatch.setattr(joint_springs, "_refutes_prior_spring", lambda *_: True)
    told[7] = [told[8][0]]
    fit, missing = joint_springs.fit_joints(harness.PRIOR, FIVE, placed(FIVE), None)
    assert [entry.reason for entry in missing] == ["d"]
    assert CompensatorStiffness() in fit.structure.parameters
    monkeypatch.setattr(
        joint_springs, "unobservable_parameters",
        lambda fit, _: [UnobservableParameter(fit.structure.parameters[0], "x", "measure")],
    )  # fmt: skip
    with pytest.raises(MeasurementError, match="none of the compliances can be determined"):
        joint_springs.fit_joints(BARE, FIVE, placed(FIVE), None)
    assert isinstance(fit, Fit)


@pytest.mark.parametrize("gross", range(6))
def test_gross_errors_against_the_springs_are_left_out_three_times_at_most(gross, monkeypatch):
    """Each time the springs are chosen again from what is left."""
    chosen = []

    def choose(prior, data, placement):
        chosen.append(data)
        return SimpleNamespace(fit=len(data))

    monkeypatch.setattr(procedure, "choose", choose)
    monkeypatch.setattr(
        procedure.plausibility, "remove_worst_residual",
        lambda data, _, fit: (data[:-1], [f"reading {fit}"]) if fit > 10 - gross else (data, []),
    )  # fmt: skip
    data, found, outliers = procedure._choose_springs(None, "0123456789", None)
    rounds = min(gross, 3)
    assert data == "0123456789"[: 10 - rounds]
    assert found.fit == 10 - rounds
    assert outliers == [f"reading {10 - n}" for n in range(rounds)]
    assert [len(one) for one in chosen] == [10 - n for n in range(rounds + 1)]


@pytest.mark.parametrize("weightless", [True, False])
@pytest.mark.parametrize(
    ("unexplained", "names", "clean_explained", "left_out"),
    [(False, ["x"], True, False), (True, [], True, False), (True, ["x"], False, False), (True, ["x"], True, True)],
)
def test_readings_are_left_out_only_if_the_others_are_then_explained(
    weightless, unexplained, names, clean_explained, left_out, monkeypatch
):
    """The pose without load depends on the springs unless the geometry is a weightless robot's."""
    prior = SimpleNamespace(subtract_reference=weightless)
    explained = {"first": not unexplained, "second": not unexplained, "clean": clean_explained}
    fits, located = iter(["first", "second", "third"]), []

    def joints(_prior, data, placement):
        name = next(fits) if data == "all" else "again"
        return SimpleNamespace(fit=SimpleNamespace(name=name, robot=f"robot of {name}"), placement=placement)

    def locate(robot, data):
        located.append((robot, data))
        return f"placement {len(located)}"

    monkeypatch.setattr(procedure, "_fit_of_joints", joints)
    monkeypatch.setattr(procedure, "locate", locate)
    monkeypatch.setattr(procedure, "_has_unexplained_error", lambda fit: not explained[fit.name])
    clean = SimpleNamespace(name="clean", robot="robot of clean")
    monkeypatch.setattr(procedure, "_remove_outliers", lambda *_: ("fewer", clean, names))
    found, data, placement, left = procedure._fit_joints_and_placement(prior, "all", "placement 0")
    expected = [] if weightless else [("robot of first", "all")]
    if left_out:
        expected.append((prior if weightless else "robot of clean", "fewer"))
        assert (found.fit.name, data, left) == ("again", "fewer", ["x"])
    else:
        assert (found.fit.name, data, left) == ("first" if weightless else "second", "all", [])
    assert located == expected
    assert placement == f"placement {len(expected)}" == found.placement


@pytest.mark.parametrize(
    ("readings_count", "wrong", "explained", "taken"),
    [(100, 5, True, 3), (100, 2, True, 2), (20, 5, True, 1), (100, 5, False, 0), (100, 0, True, 0)],
)
def test_three_of_a_hundred_readings_are_left_out_at_most(readings_count, wrong, explained, taken, monkeypatch):
    """One at least; only if that many residuals explain the misfit; no longer than it is not explained."""
    data = SimpleNamespace(state=np.zeros(readings_count), loaded_states=np.zeros(8), q=np.zeros(4), wrong=wrong)
    limits = []

    def is_explained(_fit, limit):
        limits.append(limit)
        return explained

    monkeypatch.setattr(procedure, "_can_outliers_explain", is_explained)
    monkeypatch.setattr(
        procedure.plausibility, "remove_worst_residual",
        lambda data, _, fit: (SimpleNamespace(**(vars(data) | {"wrong": data.wrong - 1})), [f"{data.wrong}"])
        if data.wrong > 0 else (data, []),
    )  # fmt: skip
    monkeypatch.setattr(
        procedure, "_fit_of_joints", lambda _, data, __: SimpleNamespace(fit=SimpleNamespace(wrong=data.wrong))
    )
    monkeypatch.setattr(procedure, "_has_unexplained_error", lambda fit: fit.wrong > 0)
    first = SimpleNamespace(wrong=wrong)
    left, fit, names = procedure._remove_outliers(None, data, None, first)
    assert names == [str(wrong - n) for n in range(taken)]
    assert (left.wrong, fit.wrong) == (wrong - taken, wrong - taken)
    assert limits == [max(1, readings_count * 3 // 100) * 2]  # of two loads in each configuration


def test_a_compensator_is_open_with_the_second_joint_whatever_else_is_open():
    fit = fit_with_spring(FIVE, 8e4, 0.45, 1e3, k2_half=0.9)
    covariance = fit.covariance.copy()
    covariance[3, 3] = (5.0 * SPRINGS[3]) ** 2
    entries = joint_springs.unobservable_parameters(replace(fit, covariance=covariance), FIVE)
    assert entries[0].parameter == CompensatorStiffness()
    assert {entry.parameter for entry in entries[1:]} == {JOINT_COMPLIANCES[1], JOINT_COMPLIANCES[3]}


@pytest.mark.parametrize(
    ("weightless", "weight", "compensator", "both"),
    [
        (True, True, None, True), (True, False, "law", True), (True, True, "law", True), (True, False, None, False),
        (False, True, "law", False),
    ],
)  # fmt: skip
def test_gears_are_tried_with_and_without_the_weights_where_that_is_another_model(
    weightless, weight, compensator, both, monkeypatch
):
    """The geometry is a weightless robot's, and there is something to carry."""
    prior = SimpleNamespace(subtract_reference=weightless, has_weight=weight, compensator=compensator)
    tried = []

    def weighed(_robot, _data, _placement, carries_weight, compensator):
        tried.append(carries_weight)
        return SimpleNamespace(
            full_regression=SimpleNamespace(evidence=0.0), structure=SimpleNamespace(carries_weight=carries_weight)
        )

    monkeypatch.setattr(choice, "_candidate_equations", weighed)
    monkeypatch.setattr(choice, "can_identify_compensator", lambda *_: False)
    monkeypatch.setattr(choice, "_mean_of_structures", lambda settled, compensator: settled)
    monkeypatch.setattr(choice, "_add_couplings_and_waves", lambda mean, settled, *_: (mean, settled))
    monkeypatch.setattr(choice, "_choice_of_mean", lambda mean, *_: mean)
    assert choice.choose(prior, None, None).structure.carries_weight is False
    assert tried == ([False, True] if both else [False])


@pytest.mark.parametrize("seed", range(4))
def test_springs_that_turn_about_the_line_of_a_joint_are_not_tried(seed):
    """By the lines themselves, in frames that are turned by right angles at random."""
    rng = np.random.default_rng(seed)
    turns = [
        np.linalg.det(m) * m for m in (np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3) for _ in range(6))
    ]
    placement = np.tile(np.eye(4), (6, 1, 1))
    placement[:, :3, :3] = turns
    # some links begin on the axis of the joint at their end
    axis = np.eye(3)[rng.integers(0, 3, 6)] * rng.choice([-1.0, 1.0], (6, 1))
    for joint in range(6):
        along = turns[joint] @ axis[joint]
        placement[joint, :3, 3] = along * 0.4 if rng.random() < 0.5 else rng.uniform(0.1, 0.5, 3)
    frames, pose = [np.eye(4)], np.eye(4)
    for joint in range(6):
        pose = pose @ placement[joint]
        frames.append(pose)
    joints = [(frame[:3, 3], frame[:3, :3] @ axis[n]) for n, frame in enumerate(frames[1:])]

    def is_joint(point, direction):
        return any(
            np.linalg.norm(np.cross(direction, own)) < 1e-9 and np.linalg.norm(np.cross(point - at, own)) < 1e-3
            for at, own in joints
        )

    expected = set()
    for number, link in enumerate(("base", *robot.JOINTS)):
        for n, name in enumerate(("X", "Y", "Z")):
            direction = frames[number][:3, n]
            own = [joints[number - 1]] if number else []
            behind = [joints[number]] if number < 6 else []
            for at, line in (*own, *behind):
                if np.linalg.norm(np.cross(direction, line)) > 1e-9:
                    continue
                if np.linalg.norm(np.cross(frames[number][:3, 3] - at, line)) < 1e-3:
                    expected.add(robot.LinkSpring(link, f"R{name}"))
            for at, line in behind:
                if np.linalg.norm(np.cross(direction, line)) < 1e-9:
                    expected.add(robot.LinkSpring(link, f"end_R{name}"))
                    assert is_joint(at, direction)
    model = SimpleNamespace(nominal=SimpleNamespace(axis=axis, placement=placement))
    assert choice._springs_about_joint_axes(model) == expected
    springs = choice.link_springs(model, with_ends=True)
    assert set(springs).isdisjoint(expected)
    poor = choice.link_springs(model, with_ends=False)
    assert set(poor) == {spring for spring in springs if spring.link != "base" and not spring.at_end}
    assert len(springs) == 7 * len(robot.LINK_AXES) - len(expected)
