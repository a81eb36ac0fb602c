"""The mean of structures as a fit: its covariances, residuals, table and sentence, and the evidence that decides."""

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.optimize import lsq_linear

from postproc import robot
from postproc.errors import PostprocError
from postproc.identification import choice
from postproc.identification.choice import Mean, Member
from postproc.identification.fit import learn, linearise, prior_of
from postproc.identification.measurement_model import Structure, measured_displacements, predict
from postproc.robot import JOINT_COMPLIANCES
from samples.paper_study import harness
from tests.identification.test_joint_springs import SPRINGS, forces, placed, readings

CONFIGS = 10
LINKS = (robot.LinkSpring("A2", "X"), robot.LinkSpring("A3", "RX"), robot.LinkSpring("A4", "Y"))
WEIGHTS = np.array([0.3, 0.7, 0.0])


@pytest.fixture(scope="module")
def settled():
    """Readings with errors that configurations share, and the mean of two structures among three."""
    rng = np.random.default_rng(21)
    data = readings(forces(CONFIGS, 90.0))  # so light that links hide in the noise
    shared = 1e-5 * rng.normal(size=(2 * CONFIGS, 3))[data.state]
    data = replace(data, position=data.position + shared + rng.normal(0.0, 1e-5, data.position.shape))
    placement = placed(data)
    structure = Structure((*JOINT_COMPLIANCES, *LINKS), harness.PRIOR)
    equations, prior = linearise(structure, np.append(SPRINGS, np.zeros(3)), data, placement), prior_of(structure)
    fold = choice.folds(equations)
    columns = {"joints": np.arange(6), "one link": np.array([6, 0, 1, 2, 3, 4, 5]), "links": np.arange(9)}
    members = tuple(
        Member.of(name, name == "links", equations=equations, prior=prior, columns=own, fold=fold)
        for name, own in columns.items()
    )
    mean = Mean(structure, equations, members, WEIGHTS)
    solution = choice._CandidateEquations(
        structure, ("joint",) * 6 + ("link",) * 3, prior, equations, members[2].regression
    )
    return data, placement, mean, choice._choice_of_mean(mean, solution, data, placement)


def solved(regression, equations, rows=slice(None)):
    """The most probable values (n,) that are not negative: least squares with bounds, prior as further rows."""
    scale = np.sqrt(equations.weight[rows] / regression.noise)
    design = equations.design[rows][:, regression.columns] * scale[:, None] * regression.spread
    target = np.append(equations.target[rows] * scale, regression.mean / regression.spread)
    stacked = np.vstack([design, np.eye(len(regression.columns))])
    return lsq_linear(stacked, target, bounds=(0.0, np.inf), method="bvls", tol=1e-14).x * regression.spread


def whole(values, regression, size=9):
    vector = np.zeros(size)
    vector[regression.columns] = values
    return vector


def test_the_fit_of_a_mean_is_that_of_dense_matrices(settled):
    """Posterior of the mixture; the bound's is twice that by its design effect, and the jackknife of configurations."""
    data, placement, mean, found = settled
    equations = linearise(mean.structure, mean.solve(), data, placement)
    taken = [(0.3, mean.members[0].regression), (0.7, mean.members[1].regression)]

    def mean_values(rows=slice(None)):
        return sum(weight * whole(solved(one, equations, rows), one) for weight, one in taken)

    values = mean_values()
    posterior, spread2, dof = np.zeros((9, 9)), np.zeros(9), 0.0
    influence = np.zeros((9, len(equations.target)))
    for weight, one in taken:
        own = whole(solved(one, equations), one)
        root = equations.weight / one.noise
        design = equations.design[:, one.columns]
        covariance = np.zeros((9, 9))
        covariance[np.ix_(one.columns, one.columns)] = np.linalg.inv(
            (design * root[:, None]).T @ design + np.diag(one.spread**-2.0)
        )
        posterior += weight * (covariance + np.outer(own - values, own - values))
        spread2[one.columns] += weight * one.spread**2
        free = np.array([column for column in one.columns if own[column] > 0.0])
        prior_free = np.array([one.spread[list(one.columns).index(column)] for column in free])
        part = equations.design[:, free]
        gain = np.linalg.inv((part * root[:, None]).T @ part + np.diag(prior_free**-2.0)) @ (part * root[:, None]).T
        influence[free] += weight * gain
        dof += weight * np.trace(part @ gain)
    alone, left = np.empty((CONFIGS, 9)), np.empty_like(equations.target)
    for config in range(CONFIGS):
        rows = equations.config == config
        alone[config] = mean_values(~rows)
        left[rows] = equations.target[rows] - equations.design[rows] @ alone[config]
    deviation = alone - alone.mean(axis=0)
    jackknife = (CONFIGS - 1) / CONFIGS * deviation.T @ deviation
    effect = choice.design_effect(equations, influence, left)
    keep = [0, 1, 2, 3, 4, 5, *([6] if values[6] > 0.0 else [])]
    assert found.fit.structure.parameters == tuple(mean.structure.parameters[index] for index in keep)
    np.testing.assert_allclose(found.fit.values, values[keep], rtol=1e-6)
    onto = choice.projection(equations, np.array(keep), np.sqrt(spread2))
    np.testing.assert_allclose(found.fit.covariance, onto @ posterior @ onto.T, rtol=1e-5, atol=1e-22)
    wider = onto @ (2.0 * effect * posterior + jackknife) @ onto.T
    np.testing.assert_allclose(found.bound_covariance, wider, rtol=1e-4, atol=1e-20)
    assert jackknife[0, 0] > 0.3 * wider[0, 0]
    assert effect > 1.5
    np.testing.assert_allclose(found.influence, onto @ influence, rtol=1e-5, atol=1e-9 * np.abs(influence).max())
    assert found.effective_parameters == pytest.approx(dof, rel=1e-6)
    assert found.fit.dof == round(3 * 4 * CONFIGS - dof)
    # one load, two repeats with and without it: σ²·(1/2 + 1/2)
    np.testing.assert_allclose(found.left_out.ravel(), left * data.sigma, rtol=1e-4, atol=1e-10)
    rows = (left.reshape(CONFIGS, -1) ** 2 * equations.weight.reshape(CONFIGS, -1)).mean(axis=1)
    np.testing.assert_allclose(found.held_out, rows, rtol=1e-4)
    moved, _ = predict(found.fit.structure, values[keep], data, placement)
    residual = measured_displacements(data, placement) - moved
    np.testing.assert_allclose(found.fit.residual, residual, atol=1e-10)
    assert found.fit.chi2 == pytest.approx(np.sum(residual**2) / data.sigma**2, rel=1e-5)
    np.testing.assert_array_equal(found.fit.design, equations.design[:, keep])
    wide = np.sqrt(np.diag(posterior)) > 0.9 * np.sqrt(spread2)
    held = [mean.structure.parameters[index] for index in np.flatnonzero(wide & (spread2 > 0.0))]
    assert list(found.held_by_prior) == held
    assert 0 < len(held) < np.count_nonzero(spread2)
    assert found.evidence == mean.members[2].regression.evidence


def test_each_structure_has_a_row_and_the_sentence_names_those_that_count(settled):
    _, _, mean, found = settled
    equations, members = linearise(mean.structure, mean.solve(), *settled[:2]), mean.members
    assert [(row.name, row.parameters, row.weight) for row in found.candidates] == [
        ("joints", 6, 0.3), ("one link", 7, 0.7), ("links", 9, 0.0),
    ]  # fmt: skip
    assert [row.chosen for row in found.candidates] == [False, True, False]
    squares = [(equations.weight * member.held_out_residual**2).reshape(CONFIGS, -1).mean(axis=1) for member in members]
    together = 0.3 * members[0].held_out_residual + 0.7 * members[1].held_out_residual
    of_mean = (equations.weight * together**2).reshape(CONFIGS, -1).mean(axis=1)
    for row, member, square in zip(found.candidates, members, squares, strict=True):
        values = solved(member.regression, equations)
        left = equations.target - equations.design[:, member.regression.columns] @ values
        assert row.active == np.count_nonzero(values > 1e-15)
        assert row.rms_sigma == pytest.approx(np.sqrt(np.mean(left**2)))
        assert row.held_out == pytest.approx(square.mean())
        assert row.error == pytest.approx(np.std(square - of_mean, ddof=1) / np.sqrt(CONFIGS))
    assert found.reason == (
        f"chosen: 70% one link; 30% joints: cross-validation error {found.held_out.mean():.2f} σ² (noise alone: 1; "
        f"joint springs alone: {found.candidates[0].held_out:.2f} σ²)"
    )


@pytest.mark.parametrize(("gain", "nonlinear_too"), [(2.9, False), (3.1, True)])
def test_gears_that_are_not_linear_need_odds_of_one_in_twenty(gain, nonlinear_too, monkeypatch):
    """A gain of log evidence of ln 20 = 3.0 over the best structure with linear gears."""
    kinds = ("joint", "link", "fading")
    best = {(0, 1): 10.0, (0, 2): 10.0 + gain}  # link springs; joint springs with gears that stiffen

    def learned(_equations, _prior, columns):
        return SimpleNamespace(evidence=best.get(tuple(columns.tolist()), 0.0))

    seen = []
    monkeypatch.setattr(choice, "learn", learned)
    monkeypatch.setattr(choice, "_fold_residuals", lambda *_: np.zeros(1))
    monkeypatch.setattr(choice, "_stacking_weights", lambda _, __, rows: seen.extend(rows.tolist()))
    settled = SimpleNamespace(equations=SimpleNamespace(config_count=9), kinds=kinds, prior=None, structure=None)
    mean = choice._mean_of_structures(settled, compensator=False)
    chosen = {mean.members[index].name for index in seen}
    linear = {"joint springs", "link springs"}
    stiffening = {name + ", gears stiffen" for name in linear}
    assert chosen == (linear | stiffening if nonlinear_too else linear)


@pytest.mark.parametrize(
    ("weights", "with_weights", "with_spring", "expected"),
    [
        # evidence of gears under the load alone, with the weights, with a free compensator; what is taken
        (0.0, 2.9, -9.0, (False, False)),
        (0.0, 3.1, -9.0, (True, False)),
        (0.0, 3.1, 6.0, (True, False)),
        (0.0, 3.1, 6.2, (True, True)),
        (0.0, 2.9, 3.1, (False, True)),
        (None, 0.0, -9.0, (True, False)),  # the first can not be fitted
        (0.0, None, -9.0, (False, False)),  # the second neither
        (0.0, 3.1, None, (True, False)),
    ],
)
def test_richer_models_need_odds_of_one_in_twenty(weights, with_weights, with_spring, expected, monkeypatch):
    tried = []

    def weighed(_robot, _data, _placement, carries_weight, compensator):
        tried.append((carries_weight, compensator))
        evidence = with_spring if compensator else with_weights if carries_weight else weights
        if evidence is None:
            raise PostprocError("no equilibrium")
        return SimpleNamespace(
            full_regression=SimpleNamespace(evidence=evidence),
            structure=SimpleNamespace(carries_weight=carries_weight),
            free=compensator,
        )

    choices_of(monkeypatch, weighed)
    chosen = choice.choose(harness.PRIOR, None, None)
    assert (chosen.settled.structure.carries_weight, chosen.settled.free) == expected
    assert tried == [(False, False), (True, False), (expected[0], True)]


def choices_of(monkeypatch, weighed, is_open=False, has_possible_compensator=True):
    """Let `choose` see the evidence of `weighed` alone."""
    monkeypatch.setattr(choice, "_candidate_equations", weighed)
    monkeypatch.setattr(choice, "can_identify_compensator", lambda *_: True)
    monkeypatch.setattr(choice, "_mean_of_structures", lambda settled, compensator: (settled, compensator))
    monkeypatch.setattr(choice, "_add_couplings_and_waves", lambda mean, settled, *_: (mean, settled))
    monkeypatch.setattr(
        choice, "_choice_of_mean", lambda mean, settled, *_: SimpleNamespace(mean=mean, settled=settled, fit=None)
    )
    monkeypatch.setattr(choice, "has_possible_compensator", lambda _: has_possible_compensator)
    monkeypatch.setattr(choice, "_has_uncertain_compensator", lambda _: is_open)


@pytest.mark.parametrize(
    ("is_open", "has_possible_compensator", "free"), [(False, True, True), (True, True, False), (False, False, False)]
)
def test_a_spring_of_the_compensator_that_is_open_or_cannot_be_built_is_not_taken(
    is_open, has_possible_compensator, free, monkeypatch
):
    def weighed(_robot, _data, _placement, carries_weight, compensator):
        return SimpleNamespace(
            full_regression=SimpleNamespace(evidence=50.0 * compensator), free=compensator,
            structure=SimpleNamespace(carries_weight=carries_weight),
        )  # fmt: skip

    choices_of(monkeypatch, weighed, is_open, has_possible_compensator)
    chosen = choice.choose(harness.PRIOR, None, None)
    assert (chosen.settled.free, chosen.mean[1]) == (free, free)


def test_readings_that_no_structure_fits_are_refused_and_others_need_only_one_that_does(monkeypatch):
    def refused(_robot, _data, _placement, carries_weight, compensator):
        raise PostprocError(f"no equilibrium {carries_weight} {compensator}")

    choices_of(monkeypatch, refused)
    with pytest.raises(PostprocError, match="no equilibrium True False"):
        choice.choose(harness.PRIOR, None, None)
    with pytest.raises(PostprocError, match="no equilibrium False False"):  # weights act at rest in any case
        choice.choose(replace(harness.PRIOR, subtract_reference=False), None, None)


@pytest.mark.parametrize(
    ("gains", "added"),
    [
        ((2.9, 2.9), ()),
        ((3.1, 0.0), (", coupled wrist",)),
        ((2.9, 3.1), (", over the pose",)),
        ((3.1, 6.0), (", coupled wrist",)),
        ((3.1, 6.2), (", coupled wrist", ", coupled wrist, over the pose")),
    ],
)
def test_couplings_and_waves_over_the_pose_need_odds_of_one_in_twenty(settled, gains, added, monkeypatch):
    """Each is compared with the structure that was taken before it, from the one with the most evidence on."""
    data, placement, mean, _ = settled
    wrist = [i for i, joint in enumerate(JOINT_COMPLIANCES) if joint.joint in ("A4", "A5", "A6")]
    assert len(wrist) == 3
    real, evidence = learn, {}

    def learned(equations, prior, columns):
        kinds = {prior.kinds[kind] for kind in prior.kind_index[columns[columns >= 9]]}
        gain = 0.0 if not kinds else gains[0] if kinds == {"coupling"} else gains[1]
        return replace(real(equations, prior, columns), evidence=evidence["base"] + gain)

    evidence["base"] = 40.0
    monkeypatch.setattr(choice, "learn", learned)
    solution = choice._CandidateEquations(
        mean.structure, ("joint",) * 6 + ("link",) * 3, prior_of(mean.structure), mean.equations,
        mean.members[2].regression,
    )  # fmt: skip
    wider, extended = choice._add_couplings_and_waves(mean, solution, data, placement)
    best = max(mean.members[:2], key=lambda member: member.regression.evidence)
    assert [member.name for member in wider.members[3:]] == [best.name + suffix for suffix in added]
    if not added:
        assert (wider, extended) == (mean, solution)
        return
    size = len(wider.structure.parameters)
    couplings = [p for p in wider.structure.parameters if isinstance(p, robot.GearCoupling)]
    waves = [p for p in wider.structure.parameters if isinstance(p, robot.PoseWave)]
    assert len(couplings) == 3
    assert wider.structure.parameters == (*mean.structure.parameters, *couplings, *waves)
    assert extended.kinds[9:] == ("coupling",) * 3 + ("over the pose",) * len(waves)
    assert {member.regression.size for member in wider.members} == {size}
    assert wider.weights[2] == 0.0  # the third had no weight before
    assert wider.weights.sum() == pytest.approx(1.0)
    for member in wider.members[3:]:
        extra = set(member.regression.columns[member.regression.columns >= 9].tolist())
        has_waves, has_couplings = "over the pose" in member.name, "coupled" in member.name
        expected = {*(range(9, 12) if has_couplings else ()), *(range(12, size) if has_waves else ())}
        assert extra == expected
        assert len(member.regression.columns) == len(best.regression.columns) + len(expected)
    assert extended.full_regression is wider.members[-1].regression
