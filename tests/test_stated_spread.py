"""`sigma_percent` of a model: the bound of robots that were not measured."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import elastostatics, files, robot
from postproc.elastostatics.uncertainty import length_bound
from postproc.errors import ModelError
from postproc.robot.folder import assemble
from postproc.robot.model_file import CovarianceTable, ModelFile

FOLDERS = robot.shipped_models()
_SCALED = "scaled from another robot's values, not measured on this robot"
_BASIS = {
    "kuka_kr270": "from published values, A2 assumed, not measured on this robot",
    "kuka_kr500_r2830": "from published values, not measured on this robot",
    "kuka_kr16_2": "assumed, not measured on this robot",
}
KR270 = FOLDERS["kuka_kr270"]
CONTENT = files.read_toml(KR270 / "model.toml", ModelFile, ModelError)
CHAIN = robot.load(KR270).nominal


def _with(content: ModelFile) -> robot.RobotModel:
    return assemble("arm", content, CHAIN)


def _variances(model: robot.RobotModel) -> dict[str, float]:
    names = [parameter.name for parameter in model.covariance.parameters]
    return dict(zip(names, np.diag(model.covariance.matrix).tolist(), strict=True))


@pytest.mark.parametrize("name", FOLDERS)
def test_a_shipped_robot_states_the_spread_of_each_compliance_and_has_a_bound(name):
    tables = tomllib.loads((FOLDERS[name] / "model.toml").read_text())
    springs = [*tables["joints"].values(), *([tables["compensator"]] if "compensator" in tables else [])]
    assert all(20.0 <= spring["sigma_percent"] <= 40.0 and spring["source"] for spring in springs)
    assumed = [joint for joint in tables["joints"].values() if "no published value" in joint["source"]]
    assert all(joint["sigma_percent"] == 40.0 and joint["assumed"] for joint in assumed)
    model = robot.load(FOLDERS[name])
    assert model.basis == _BASIS.get(name, _SCALED)
    q, wrench = np.radians([[10.0, -70.0, 100.0, 20.0, 50.0, 0.0]]), np.array([[300.0, -200.0, 400.0, 0.0, 0.0, 0.0]])
    tool = np.eye(4)
    tool[2, 3] = 0.35
    moved = np.linalg.norm(elastostatics.deflect(model, q, tool, wrench).twist[0, :3])
    bound = elastostatics.position_bound(model, q, tool, wrench)[0]
    assert 0.2 * moved < bound < 0.8 * moved


def test_variances_are_those_of_the_stated_spread_each_by_itself():
    model = robot.load(KR270)
    wanted = {f"k{i}": (s * k) ** 2 for i, s, k in ((1, 0.4, 0.623), (2, 0.25, 0.302), (6, 0.4, 2.074))}
    found = _variances(model)
    assert {name: found[name] for name in wanted} == pytest.approx(wanted)
    assert found["K_c"] == pytest.approx(0.48e5**2)
    assert np.count_nonzero(model.covariance.matrix) == 7


def test_what_was_measured_counts_instead_of_the_stated_spread():
    table = CovarianceTable(["k3", "k1"], [[4e-6, 1e-6], [1e-6, 9e-6]])
    model = _with(replace(CONTENT, covariance=table))
    found = _variances(model)
    assert (found["k3"], found["k1"]) == (4e-6, 9e-6)
    assert found["k2"] == pytest.approx((0.25 * 0.302) ** 2)
    assert model.covariance.matrix[0, 1] == 1e-6
    assert model.basis == "measured on this robot, but for k2, k4, k5, k6, K_c: from published values, A2 assumed"
    both = _with(replace(CONTENT, covariance=CovarianceTable(["s_0"], [[25.0]])))
    assert "K_c" not in _variances(both)


def test_a_model_without_any_statement_has_no_bound():
    joints = {name: replace(spring, sigma_percent=None) for name, spring in CONTENT.joints.items()}
    without = replace(CONTENT, joints=joints, compensator=replace(CONTENT.compensator, sigma_percent=None))
    model = _with(without)
    assert model.covariance is None
    assert model.basis == ""


@pytest.mark.parametrize(("median", "share"), [(False, 0.95), (True, 0.93)])
def test_the_bound_covers_compliances_that_are_log_normal(median, share):
    """As docs/reference says of 40 %: the deflection of one joint in proportion to its compliance."""
    spread = 0.4
    log_spread = np.sqrt(np.log(1.0 + spread**2))
    centre = 0.0 if median else -0.5 * log_spread**2
    drawn = np.exp(centre + log_spread * np.random.default_rng(4).normal(size=200_000))
    bound = length_bound(np.diag([spread**2, 0.0, 0.0])[None])[0]
    assert bound == pytest.approx(0.78, abs=0.01)
    assert np.mean(np.abs(drawn - 1.0) <= bound) == pytest.approx(share, abs=0.01)


def test_the_lower_triangle_of_a_covariance_is_the_whole_matrix():
    whole = np.array([[4e-6, 1e-6, -2e-6], [1e-6, 9e-6, 3e-7], [-2e-6, 3e-7, 16e-6]])
    names = ["k3", "k1", "k2"]
    models = [
        _with(replace(CONTENT, covariance=table))
        for table in (CovarianceTable(names, whole.tolist()), CovarianceTable.of(names, whole))
    ]
    np.testing.assert_array_equal(models[0].covariance.matrix, models[1].covariance.matrix)
    assert CovarianceTable.of(names, whole).matrix[1] == [1e-6, 9e-6]
    for rows in ([[4e-6], [1e-6, 9e-6]], [[4e-6], [1e-6], [1e-6, 1e-6, 1e-6]], [[4e-6, 0.0]] * 3):
        assert CovarianceTable(names, rows).square is None


def test_lists_of_numbers_are_one_line_of_toml():
    content = {"rows": [[1.5, -2e-7], [3.0, 4.0]], "words": ["a [\n1,\n2]", "b"], "one": [0.25]}
    text = files.toml(content, "of numbers").decode()
    assert "[1.5, -2e-07]" in text
    assert "[0.25]" in text
    assert tomllib.loads(text) == content
