"""The bound where the factor of the forces was identified together with the compliances."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import elastostatics, files, robot
from postproc.errors import ModelError
from postproc.robot.folder import assemble
from postproc.robot.model_file import CovarianceTable, ForcesEntry
from tests.kr270 import CONTENT, FOLDER, STRAIGHT_TOOL

NAMES = ["k1", "k2", "k3", "k4", "k5", "k6"]
LAW = (700.0, 200.0, 50.0, 20.0, 10.0, 1.0, 0.0, 10.0)
ENTRY = ForcesEntry(source="test", cutting_N_per_mm2=LAW[:3], edge_N_per_mm=LAW[3:6], mc=LAW[6], sigma_percent=LAW[7])
Q = np.radians([[0.0, -70.0, 110.0, 0.0, 50.0, 0.0], [20.0, -60.0, 90.0, 10.0, 60.0, 0.0]])
WRENCH = np.array([[300.0, -150.0, 80.0, 0.0, 0.0, 0.0], [-50.0, 250.0, -120.0, 0.0, 0.0, 4.0]])


def model(by_force, variance=0.01):
    """A robot whose compliances are known to 10 % by one factor, whose covariance with that of the forces is given."""
    k = np.array([CONTENT.joints[f"A{i}"].compliance_urad_per_Nm for i in range(1, 7)])
    size = np.append(k, 1.0)
    shape = np.full((7, 7), 0.01)
    shape[-1, :-1] = shape[:-1, -1] = by_force
    shape[-1, -1] = variance
    table = CovarianceTable([*NAMES, "forces"], (shape * np.outer(size, size)).tolist())
    joints = {name: replace(spring, sigma_percent=None) for name, spring in CONTENT.joints.items()}
    content = replace(CONTENT, joints=joints, compensator=None, covariance=table, forces=ENTRY)
    return assemble("arm", content, robot.load(FOLDER).nominal)


def bound(own, scaled):
    spread = 0.1 * np.abs(WRENCH)[:, :, None] * np.eye(6)
    is_proportional = np.array(scaled)
    return elastostatics.position_bound(
        own, Q, STRAIGHT_TOOL, WRENCH, force_spread=spread, is_proportional=is_proportional
    )


def moved(own):
    return np.linalg.norm(elastostatics.deflect(own, Q, STRAIGHT_TOOL, WRENCH).twist[:, :3], axis=1)


def test_what_is_known_of_the_product_alone_is_known_of_the_deflection():
    """A tenth more force on an arm a tenth less compliant: the deflection is the same, to the second order."""
    own = model(-0.01)
    assert (bound(own, [True, True]) < 0.01 * moved(own)).all()
    assert (bound(own, [False, False]) > 0.2 * moved(own)).all()


def test_errors_that_go_together_add_up():
    """One direction, so that 95 % are 1.96 standard deviations: 10 % and 10 % of one sign make 20 %."""
    own = model(0.01)
    np.testing.assert_allclose(bound(own, [True, True]), 1.96 * 0.2 * moved(own), rtol=0.03)
    apart = model(0.0)
    np.testing.assert_allclose(bound(apart, [True, True]), 1.96 * np.sqrt(0.02) * moved(own), rtol=0.03)


def test_rows_count_by_themselves():
    own = model(-0.01)
    both = [bound(own, [k, k]) for k in (False, True)]
    np.testing.assert_allclose(bound(own, [True, False]), [both[1][0], both[0][1]], rtol=1e-9)


def test_a_law_is_the_same_only_if_all_of_its_numbers_are():
    factor = model(0.0).force_factor
    assert factor.is_of(LAW)
    for k in range(8):
        assert not factor.is_of(tuple(value + (1e-3 if i == k else 0.0) for i, value in enumerate(LAW)))
    assert not factor.is_of(())


@pytest.mark.parametrize("table", [CONTENT.covariance, CovarianceTable(["forces"], [[0.01]])])
def test_the_law_and_the_covariance_of_its_factor_belong_together(tmp_path, table):
    content = replace(CONTENT, covariance=table, forces=None if table else ENTRY)
    (tmp_path / "model.toml").write_bytes(files.toml(content, ""))
    (tmp_path / "robot.urdf").write_bytes((FOLDER / "robot.urdf").read_bytes())
    with pytest.raises(ModelError, match="belong together"):
        robot.load(tmp_path)
