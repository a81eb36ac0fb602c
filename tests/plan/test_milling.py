from __future__ import annotations

import numpy as np
import pytest

from postproc.errors import PlanError
from postproc.plan import milling
from tests import programs
from tests.oracle.arm import abc
from tests.plan import setting

SQUARE = [("PTP", 0, 0, 50), ("RAPID", 0, 0, 5), ("LIN", 0, 0, -2), ("LIN", 100, 0, -2), ("LIN", 100, 60, -2)]
FORCE = (3, (120.0, -40.0, 300.0, 0.0, 0.0, 0.0))


def test_test_poses_lie_on_the_cutting_moves_under_their_force_in_root_axes():
    turned = abc(1500, -200, 700, a=30)[None]
    program = programs.program(SQUARE, notes=[FORCE], bases=turned)
    tests = milling.from_program(program, setting.ROBOT, setting.CELL)
    force = turned[0, :3, :3] @ FORCE[1][:3]
    whole = np.linalg.norm(tests.wrench[:, :3], axis=1) > 0.999 * np.linalg.norm(force)
    assert np.abs(tests.wrench[whole, :3] - force).max() < 1e-9
    assert whole.mean() > 0.5
    tool = setting.CELL.tool.pose()
    for q in tests.q:
        spot = np.linalg.inv(turned[0]) @ setting.ORACLE.nominal_tcp(q, tool) @ [0, 0, 0, 1]
        assert -0.0021 <= spot[2] <= 0.0051


def test_weights_are_shares_of_the_way_cut():
    program = programs.program(SQUARE, notes=[FORCE])
    tests = milling.from_program(program, setting.ROBOT, setting.CELL)
    assert tests.weight.sum() == pytest.approx(1.0)
    places = np.array(
        [(np.linalg.inv(program.bases[0]) @ setting.ORACLE.nominal_tcp(q, program.tools[0]))[:3, 3] for q in tests.q]
    )
    along_y = places[:, 1] > 1e-6
    assert tests.weight[along_y].sum() == pytest.approx(60 / (7 + 100 + 60), rel=1e-6)


def test_regressor_is_that_of_an_independent_arm():
    tests = setting.job(2).take(np.array([0, 99]))
    expected = setting.milling_regressors(tests)
    assert np.abs(tests.regressor - expected).max() < 1e-6 * np.abs(expected).max()


def test_a_few_poses_stand_for_all():
    tests = setting.job(7, count=2000)
    scale = setting.ROBOT.compliance
    few = milling.representatives(tests, scale, 20, 0)
    assert len(few) <= 20
    assert few.weight.sum() == pytest.approx(1.0)
    all_of_them, those = (t.second_moment * np.outer(scale, scale) for t in (tests, few))
    assert np.abs(all_of_them - those).max() < 0.02 * np.abs(all_of_them).max()
    assert np.trace(all_of_them) == pytest.approx(np.trace(those))


def test_of_clusters_the_pose_nearest_to_the_mean_is_kept_with_the_weight_of_all():
    """Three poses far from each other, each under five sizes of force: the middle one stands for them."""
    q = np.radians([[0, -70, 110, 0, 50, 0], [40, -30, 60, 20, 40, 0], [-60, -110, 130, -30, 70, 0]])
    tool, scale = setting.CELL.tool.pose(), setting.ROBOT.compliance
    alone = milling.poses_under_load(setting.ROBOT, q, tool, np.eye(3, 6), weight=np.ones(3), source="units")
    force = np.eye(3, 6) / np.linalg.norm(alone.regressor * scale, axis=(1, 2))[:, None]  # each counts the same
    size, pose = np.tile([0.98, 0.99, 1.0, 1.01, 1.02], 3), np.repeat(np.arange(3), 5)
    weight = np.array([2.0, 1.0, 3.0])[pose]
    tests = milling.poses_under_load(
        setting.ROBOT, q[pose], tool, force[pose] * size[:, None], weight=weight, source="three"
    )
    for seed in range(6):
        few = milling.representatives(tests, scale, 3, seed)
        order = [int(np.abs(few.q - each).sum(axis=1).argmin()) for each in q]
        np.testing.assert_allclose(few.weight[order], np.array([2.0, 1.0, 3.0]) / 6.0)
        # scaled a little, all by one factor, so that the sum of squares is kept
        factor = few.wrench[order].sum(axis=1) / force.sum(axis=1)
        np.testing.assert_allclose(factor, np.sqrt(np.mean(size**2)), rtol=1e-9)
        np.testing.assert_allclose(
            few.torque[order], factor[0] * tests.torque[2::5], rtol=1e-9, atol=1e-9 * np.abs(tests.torque).max()
        )
        np.testing.assert_allclose(few.deflection[order], factor[0] * tests.deflection[2::5], rtol=1e-9)


def test_poses_with_another_angle_of_a2_stand_for_themselves_though_they_are_loaded_alike():
    """The compliance of A2 depends on that angle, by the compensator."""
    q = np.zeros((40, 6))
    q[:, 1] = np.repeat([-1.5, -0.5], 20)
    same = {"wrench": np.ones((40, 6)), "torque": np.ones((40, 6)), "regressor": np.ones((40, 3, 6))}
    shares = {"weight": np.full(40, 1 / 40), "is_law_force": np.zeros(40, dtype=bool)}
    tests = milling.TestPoses(q=q, deflection=np.ones(40), source="alike", **same, **shares)
    few = milling.representatives(tests, np.ones(6), 2, 0)
    assert sorted(few.q[:, 1]) == [-1.5, -0.5]


@pytest.mark.parametrize("count", [1, 4000, 4001, 8001, 11999, 12001])
def test_of_a_long_path_every_nth_sample_has_the_length_of_those_left_out(count):
    rows, way = 7 + 2 * np.arange(count), np.random.default_rng(count).uniform(0.1, 1.0, count)
    kept, length = milling._thin_rows(rows, way)
    step = -(-count // 4000)
    groups = [range(begin, min(begin + step, count)) for begin in range(0, count, step)]
    assert len(kept) == len(groups) <= 4000
    for row, share, group in zip(kept, length, groups, strict=True):
        assert (row - 7) // 2 == group[min(step // 2, len(group) - 1)]  # in the middle of what it stands for
        assert share == pytest.approx(sum(way[k] for k in group), rel=1e-12)


def test_few_poses_are_left_as_they_are():
    tests = setting.job(7, count=12)
    assert milling.representatives(tests, setting.ROBOT.compliance, 20, 0) is tests


def test_programs_without_force_are_refused_with_advice():
    with pytest.raises(PlanError, match=r"part\.nc: no cutting move .* carries a force\. .*--forces"):
        milling.from_program(programs.program(SQUARE), setting.ROBOT, setting.CELL)


def test_poses_out_of_reach_name_the_line():
    far = [*SQUARE[:3], ("LIN", 3000, 0, -2)]
    with pytest.raises(PlanError, match=r"part\.nc:4: out of reach"):
        milling.from_program(programs.program(far, notes=[FORCE]), setting.ROBOT, setting.CELL)


def write(folder, text):
    path = folder / "tests.csv"
    path.write_text(text)
    return path


def test_test_poses_by_hand_are_read(tmp_path):
    path = write(
        tmp_path, "A1,A2,A3,A4,A5,A6,Fx,Fy,Fz,weight\n0,-70,110,0,50,0,100,0,0,3\n10,-60,100,0,50,0,0,0,-200,1\n"
    )
    tests = milling.from_file(path, setting.ROBOT, setting.CELL)
    assert tests.weight.tolist() == [0.75, 0.25]
    assert tests.wrench[1].tolist() == [0, 0, -200, 0, 0, 0]
    assert np.degrees(tests.q[0]).round(9).tolist() == [0, -70, 110, 0, 50, 0]


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ("", "no test poses"),
        ("0,-70,110,0,50,0,0,0,0,1\n", r"tests\.csv:2: the force is zero"),
        ("0,-70,110,0,50,0,1,0,0,0\n", r"tests\.csv:2: weight must be larger than 0"),
        ("0,-70,nan,0,50,0,1,0,0,1\n", "column A3 is not a finite number"),
    ],
)
def test_bad_test_poses_name_the_row(tmp_path, rows, problem):
    with pytest.raises(PlanError, match=problem):
        milling.from_file(write(tmp_path, "A1,A2,A3,A4,A5,A6,Fx,Fy,Fz,weight\n" + rows), setting.ROBOT, setting.CELL)
