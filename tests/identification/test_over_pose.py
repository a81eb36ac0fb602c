"""Compliances that change over the pose, and coupled wrists: candidates, and identification of simulated robots."""

from dataclasses import replace

import numpy as np
import pytest

from postproc import elastostatics, robot
from postproc.identification import identify_folder, over_pose
from samples.paper_study import harness, simulator
from tests.benchmarks import truth


def test_the_compliance_of_a_joint_varies_by_one_and_the_same_size_at_every_pose():
    """The variance of Σ a·cos + b·sin with independent a, b is Σ share² at any angle: the prior is stationary."""
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (6, 50))
    for joint in robot.JOINT_COMPLIANCES:
        waves = over_pose.waves([joint])
        variance = sum((over_pose.amplitude_share(wave) * wave.factor(q)) ** 2 for wave in waves)
        np.testing.assert_allclose(variance, 1.0, rtol=1e-12)
        assert len({wave.name for wave in waves}) == len(waves)


def test_a_wave_and_its_mirror_image_are_one_candidate():
    for joint in robot.JOINT_COMPLIANCES:
        turns = {wave.turns for wave in over_pose.waves([joint])}
        assert not turns & {tuple(-n for n in each) for each in turns}


def test_only_joints_of_the_wrist_are_coupled():
    names = [coupling.name for coupling in over_pose.couplings(robot.JOINT_COMPLIANCES)]
    assert names == ["k45", "k46", "k56"]
    assert [c.name for c in over_pose.couplings(robot.JOINT_COMPLIANCES[:5])] == ["k45"]


SMALL = truth.Row("test", ({"links": "none", "gear": "linear"},), levels=(0.2, 1.0))


def identified(row, folder):
    """Return the true robot of a row, and the model that is identified from its readings."""
    true = truth.experiment(row, 3, folder)
    identify_folder(folder / "measurements.csv", folder / "experiment.toml", folder / "model")
    return true, robot.load(folder / "model")


def share_left(true, model):
    """Return the RMS error over the RMS deflection on milling jobs, and the share of places inside the bound."""
    moved, error, bound = [], [], []
    for q, f in simulator.milling_jobs(np.random.default_rng(5)):
        wrench = np.c_[f, 0 * f]
        moved.append(harness.true_deflection(true, q, f))
        error.append(np.linalg.norm(moved[-1] - truth.predicted(model, q, wrench), axis=1))
        bound.append(elastostatics.position_bound(model, q, harness.TOOL, wrench))
    error = np.concatenate(error)
    return np.sqrt(np.sum(error**2) / np.sum(np.concatenate(moved) ** 2)), np.mean(error <= np.concatenate(bound))


def test_coupled_wrists_are_identified(tmp_path):
    true, model = identified(replace(SMALL, coupled=0.3), tmp_path)
    values = {parameter.name: value for parameter, value in model.terms}
    for name, pair in (("k45", (3, 4)), ("k46", (3, 5)), ("k56", (4, 5))):
        assert values[name] == pytest.approx(true.coupled[pair], rel=0.1)
    left, inside = share_left(true, model)
    assert left < 1 / 40
    assert inside > 0.9


def test_compliances_over_the_pose_are_identified_and_a_place_far_from_all_readings_has_a_wider_bound(tmp_path):
    true, model = identified(replace(SMALL, by_pose=0.15), tmp_path)
    assert model.over_pose is not None
    left, inside = share_left(true, model)
    assert left < 1 / 20  # constant springs leave a tenth
    assert inside > 0.9
    q, _ = simulator.plan(np.random.default_rng(7003), SMALL.poses, tilt=50.0)
    near, far = q[:5].copy(), q[:5].copy()
    far[:, 1] += np.radians(100.0)
    wrench = np.tile([200.0, 300.0, -400.0, 0.0, 0.0, 0.0], (5, 1))
    share = []
    for place in (near, far):
        moved = np.linalg.norm(elastostatics.deflect(model, place, harness.TOOL, wrench).twist[:, :3], axis=1)
        share.append(elastostatics.position_bound(model, place, harness.TOOL, wrench) / moved)
    assert np.median(share[1]) > 1.5 * np.median(share[0])


@pytest.mark.parametrize("joint", range(6))
def test_waves_turn_up_to_twice_with_their_joint_and_once_with_the_arm(joint):
    """Each wave once, with n or −n; of A2 and A3 three turns together at most."""
    expected = set()
    for own in range(3):
        for second in range(-2, 3):
            for third in range(-2, 3):
                turns = [0] * 6
                turns[1], turns[2] = second, third
                if joint in (1, 2):
                    if own or abs(second) + abs(third) > 3:
                        continue
                else:
                    turns[joint] = own
                    if max(abs(second), abs(third)) > 1:
                        continue
                mirrored = tuple(-n for n in turns)
                if any(turns) and mirrored not in expected:
                    expected.add(tuple(turns))
    found = {wave.turns for wave in over_pose.waves([robot.JOINT_COMPLIANCES[joint]])}
    assert {frozenset((n, tuple(-k for k in n))) for n in found} == {
        frozenset((n, tuple(-k for k in n))) for n in expected
    }
    assert len(found) == len(expected)


@pytest.mark.parametrize("joint", range(6))
def test_waves_of_a_joint_have_the_spectrum_of_a_squared_exponential_over_a2_and_a3(joint):
    """Of length 1 rad: variances exp(−n²/2) of n turns, together one; half of all pairs of n and −n."""
    own = [
        wave
        for wave in over_pose.waves(robot.JOINT_COMPLIANCES)
        if wave.joint == f"A{joint + 1}" and wave.wave == "cos"
    ]
    share = {wave.turns: over_pose.amplitude_share(wave) for wave in own}
    assert len(share) == len(own)
    assert sum(value**2 for value in share.values()) == pytest.approx(1.0)
    first = own[0].turns
    for turns, value in share.items():
        square = {n: n[1] ** 2 + n[2] ** 2 for n in (first, turns)}
        assert value / share[first] == pytest.approx(np.exp(-(square[turns] - square[first]) / 4.0))
        assert tuple(-n for n in turns) not in share
        assert all(n == 0 for axis, n in enumerate(turns) if axis not in (joint, 1, 2))
    if joint in (1, 2):
        assert {abs(n[1]) + abs(n[2]) for n in share} == {1, 2, 3}
        assert len(share) == (5 * 5 - 4 - 1) // 2  # pairs up to 2 turns, without the corners and the mean
    else:
        assert {n[joint] for n in share} == {0, 1, 2}
        assert len(share) == 4 + 2 * 9
