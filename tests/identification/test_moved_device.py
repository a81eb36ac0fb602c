"""Real readings: a tracker that moved between poses, repeats that lack a reflector, loads of the wrong size."""

import re

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.errors import MeasurementError
from postproc.identification.measurement_model import locate
from postproc.identification.model_folder import geometry_folder
from postproc.identification.moved_device import moved_device
from postproc.identification.plausibility import check_loads, checked_frames
from postproc.identification.procedure import identify
from postproc.identification.readings import gaps, read, read_experiment
from samples.paper_study import harness, simulator

SIGMA = 0.05e-3


def measured(folder, seed, change, poses=30, ordered=False):
    """Readings of a robot with errors of geometry and links that deflect, after a change of raw [config, load, …]."""
    rng = np.random.default_rng(seed)
    true = simulator.hard(rng)
    q, f = simulator.plan(rng, poses)
    if ordered:  # a smooth error of the geometry along the file is no step
        order = np.argsort(q[:, 1], kind="stable")
        q, f = q[order], f[order]
    _, raw = simulator.measure(true, q, f, rng, SIGMA)
    change(raw)
    return harness.load(simulator.write(folder, q, f, raw, SIGMA))


@pytest.mark.parametrize("seed", range(3))
def test_a_tracker_that_moved_by_a_millimetre_between_two_poses_is_named(tmp_path, seed):
    def change(raw):
        raw[17:] += np.array([0.6e-3, -0.7e-3, 0.4e-3])

    data = measured(tmp_path, seed, change)
    (warning,) = moved_device(harness.PRIOR, data, locate(harness.PRIOR, data))
    match = re.match(r"from config 18 on the measuring device seems to have moved by ([\d.]+) mm", warning)
    assert float(match[1]) == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("poses", [13, 18])
@pytest.mark.parametrize("distance", [0.0, 0.003, 0.016])
def test_a_tracker_that_moved_by_millimetres_is_named_with_few_poses_too(tmp_path, poses, distance):
    def change(raw):
        raw[7:] += distance * np.array([0.6, -0.64, 0.48])

    data = measured(tmp_path, 1, change, poses=poses)
    warnings = moved_device(harness.PRIOR, data, locate(harness.PRIOR, data))
    if distance == 0.0:
        assert warnings == []
        return
    match = re.match(r"from config (\d+) on the measuring device seems to have moved by ([\d.]+) mm", warnings[0])
    assert abs(int(match[1]) - 8) <= 1
    assert float(match[2]) == pytest.approx(1e3 * distance, rel=0.2)


def test_a_joint_without_compliance_is_no_obstacle_to_few_poses(tmp_path):
    data = measured(tmp_path, 1, lambda raw: None, poses=13)
    stiffness = harness.PRIOR.stiffness.copy()
    stiffness[harness.PRIOR.actuated[3], harness.PRIOR.actuated[3]] = np.inf
    rigid = replace(harness.PRIOR, stiffness=stiffness)
    assert rigid.compliance[rigid.actuated[3]] == 0.0
    assert moved_device(rigid, data, locate(harness.PRIOR, data)) == []


def test_angles_noted_half_a_degree_off_leave_more_than_a_calibrated_arm(tmp_path):
    def calibrated(offset_deg):
        rng = np.random.default_rng(2)
        true, (q, f) = simulator.hard(rng), simulator.plan(rng, 30)
        _, raw = simulator.measure(true, q, f, rng, SIGMA)
        q[::2, 4] += np.radians(offset_deg)
        simulator.write(tmp_path, q, f, raw, SIGMA)
        return geometry_folder(*(tmp_path / name for name in ("measurements.csv", "experiment.toml", "model")))

    assert not any("RMS of the readings without load" in text for text in calibrated(0.0).data.warnings)
    (warning,) = (text for text in calibrated(0.5).data.warnings if "RMS of the readings without load" in text)
    assert "check that the noted angles are those of the controller" in warning


@pytest.mark.parametrize("distance", [0.05, 0.07, 0.2])
def test_a_tracker_that_moved_by_centimetres_is_named_at_the_configuration_where_it_moved(tmp_path, distance):
    """By 50 mm: with a configuration on the wrong side both parts are within the limit too."""

    def change(raw):
        raw[15:] += distance * np.array([0.6, -0.64, 0.48])

    data = measured(tmp_path, 0, change)
    with pytest.raises(MeasurementError, match="from config 16 on are in another frame of the measuring device"):
        checked_frames(harness.PRIOR, data)


def test_the_calibration_of_the_geometry_alone_names_it_too(tmp_path):
    def change(raw):
        raw[17:] += np.array([0.6e-3, -0.7e-3, 0.4e-3])

    measured(tmp_path, 0, change)
    written = geometry_folder(*(tmp_path / name for name in ("measurements.csv", "experiment.toml", "model")))
    assert any("from config 18 on the measuring device seems" in text for text in written.data.warnings)


@pytest.mark.parametrize("ordered", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_a_robot_that_was_never_calibrated_is_no_moved_tracker(tmp_path, seed, ordered):
    data = measured(tmp_path, seed, lambda raw: None, ordered=ordered)
    assert moved_device(harness.PRIOR, data, locate(harness.PRIOR, data)) == []


def test_repeats_that_lack_a_reflector_are_used_as_they_are(tmp_path):
    whole = measured(tmp_path, 1, lambda raw: None, poses=8)
    path = tmp_path / "measurements.csv"
    lines = path.read_text().splitlines()
    missing = [line for line in lines if line.startswith(("3,1,2,P2,", "5,0,1,P1,"))]
    path.write_text("\n".join(line for line in lines if line not in missing) + "\n")
    data = read(path, read_experiment(tmp_path / "experiment.toml"))
    assert len(data.state) == len(whole.state) - 2
    assert gaps(whole) == []
    assert gaps(data) == [
        "points without a reading, the others are used: config 3, load 1, repeat 2: P2; config 5, load 0, repeat 1: P1"
    ]
    found = identify(harness.PRIOR, data, depth="joints")
    np.testing.assert_allclose(found.fit.values, identify(harness.PRIOR, whole, depth="joints").fit.values, rtol=0.02)
    assert found.warnings[0] == gaps(data)[0]


@pytest.mark.parametrize(("factor", "doubtful"), [(1.0, False), (2.0, True), (0.45, True)])
def test_loads_that_are_all_wrong_by_a_factor_are_doubted(tmp_path, factor, doubtful):
    rng = np.random.default_rng(2)
    true, (q, f) = simulator.paper_like(rng), simulator.plan(rng, 10)
    true.gear.k = 1.0 / simulator.PAPER_K
    _, raw = simulator.measure(true, q, f, rng, SIGMA)
    data = harness.load(simulator.write(tmp_path, q, f / factor, raw, SIGMA))
    warnings = check_loads(harness.PRIOR, data, locate(harness.PRIOR, data))
    assert len(warnings) == doubtful
    if doubtful:
        assert "check the scale of the forces" in warnings[0]


def test_a_model_from_loads_in_pounds_force_gets_a_reservation(tmp_path):
    """Noise and bound are as small as with loads in newtons: no residual shows a factor of all loads."""
    rng = np.random.default_rng(2)
    true, (q, f) = simulator.paper_like(rng), simulator.plan(rng, 10)
    true.gear.k = 1.0 / simulator.PAPER_K
    _, raw = simulator.measure(true, q, f, rng, SIGMA)
    for factor, is_told in ((1.0, False), (4.448, True)):
        data = harness.load(simulator.write(tmp_path / f"{factor}", q, f / factor, raw, SIGMA))
        for method in ("enhanced", "serial"):
            judgement = identify(harness.PRIOR, data, method).judgement
            assert judgement.distrust == ""
            assert ("all points move 4" in judgement.line) == is_told
