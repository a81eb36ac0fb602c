"""Expected errors of a corrected program target by target, each with its own loads, flanks, rounding and path."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import elastostatics, forces
from postproc.frames import twist_between
from tests.corrections import read_files
from tests.kr270 import CELL, ROBOT

process = importlib.import_module("postproc.correction.process")
TEXT = """G21 G90 G17 G64
G0 X0 Y0 Z20
G1 Z0 F600
G1 X60 F1500
G1 X60 Y40
G3 X40 Y60 I-20 J0
G1 X0 Y0
G0 Z20
"""
ROWS = """line,line_end,Fx,Fy,Fz,Mx,frame,sFx,sFy,sFz,factor_percent
3,4,300,-200,150,4,FEED,60,40,50,0
5,6,-250,220,90,0,BASE,80,70,40,10
7,7,-300,-180,120,0,BASE,0,0,0,0
"""
KRL = """DEF part( )
$APO.CDIS=2
$VEL.CP=0.05
PTP {X 0,Y 0,Z 20,A 180,B 0,C 180}
LIN {X 0,Y 0,Z 0,A 180,B 0,C 180}
LIN {X 60,Y 0,Z 0,A 180,B 0,C 180} C_DIS
LIN {X 60,Y 40,Z 0,A 180,B 0,C 180} C_DIS
LIN {X 0,Y 0,Z 0,A 180,B 0,C 180}
END
"""


@pytest.fixture(scope="module", params=["gcode", "krl", "nominal", "certain"])
def errors(request, tmp_path_factory):
    """Arguments and results of the computation of errors."""
    kind = request.param
    folder = tmp_path_factory.mktemp("forces")
    (folder / "in.csv").write_text(ROWS)
    cell = replace(CELL, tool_compliance=replace(CELL.tool_compliance, X_um_per_N=0.05, Y_um_per_N=0.04))
    rows = forces.read(folder / "in.csv")
    if kind == "certain":
        cell, rows = CELL, replace(rows, sigma=0.0 * rows.sigma, factor=0.0 * rows.factor)
    program = read_files({"part.src" if kind == "krl" else "part.nc": KRL if kind == "krl" else TEXT}, cell)
    calls = []
    original = process._expected_errors

    def recorded(task, draft, deviation, reversals, cut_length):
        outcome = original(task, draft, deviation, reversals, cut_length)
        calls.append((task, draft, deviation, reversals, outcome))
        return calls[-1][-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(process, "_expected_errors", recorded)
        result = process.process(program, ROBOT, cell, rows, "nominal" if kind == "nominal" else "convert")
    assert not result.failed, result.issues
    return kind, *calls[-1], result


def at(draft, k, turning):
    """Sources of error of one target, and the bound."""
    path, sample = draft.path, draft.selection.row[k : k + 1]
    tool = path.robot_in_cell.tool_spring
    pose = path.pose_in_root(sample)
    series = None if tool is None else tool.matrices(pose[:, :3, :3])
    spread = path.motions.forces.spread_in_root(path.sample.take(sample))
    load = draft.q[sample], path.tool(sample), path.wrench_in_root(sample)
    errors = {"force_spread": spread, "in_series": series, "changes_flank": turning}
    sources = elastostatics.sources_of_error(ROBOT, elastostatics.LoadedPlaces.of(*load, **errors))
    return sources, elastostatics.position_bound(ROBOT, *load, **errors)[0]


def test_each_target_has_the_errors_of_its_loads_and_what_its_path_leaves(errors):
    kind, _, draft, deviation, reversals, (bound, expected, issues), result = errors
    targets, simulation = draft.selection.targets, draft.simulation
    motions = draft.path.program.motions
    base = draft.path.program.bases[0][:3, :3]
    without_robot, without_forces, gain = [], [], elastostatics.ChanceOfGain()
    for k in range(len(targets)):
        turning = np.zeros((1, 6), dtype=bool)
        for row, before, joint in zip(reversals.row, reversals.previous_row, reversals.joint, strict=True):
            turning[0, joint] |= k in (row, before)
        sources, expected_bound = at(draft, k, turning)
        left = np.zeros(3) if kind == "nominal" else simulation.deviation[k]
        on_path = 0.0 if kind == "nominal" else simulation.path_distance[k]
        excess = max(on_path - np.linalg.norm(left), 0.0)
        rounding = max(simulation.rounding[k] - draft.selection.programmed_rounding[k], 0.0)
        expectation = elastostatics.expected_errors(sources, base[None] @ deviation[k], base[None] @ left)
        gain.add(
            sources, base[None] @ deviation[k], base[None] @ left, np.array([on_path]), result.cut_length[k : k + 1]
        )
        assert bound[k] == pytest.approx(expected_bound, rel=1e-9)
        if motions.rapid[targets.motion[k]]:
            assert expected.before[k] == expected.after[k] == 0.0
            continue
        before = expectation.before[0] + (0.0 if kind == "krl" else rounding)
        assert expected.before[k] == pytest.approx(before, rel=1e-9)
        assert expected.after[k] == pytest.approx(expectation.after[0] + rounding + excess, rel=1e-9)
        without_robot.append(expectation.with_known_robot[0] + rounding + excess)
        without_forces.append(expectation.with_known_forces[0] + rounding + excess)
    assert expected.with_known_robot == pytest.approx(max(without_robot), rel=1e-9)
    assert expected.with_known_forces == pytest.approx(max(without_forces), rel=1e-9)
    assert expected.chance == pytest.approx(gain.chance, rel=1e-9)
    assert 0.5 < expected.chance <= 1.0
    assert not issues
    assert result.errors is expected
    assert result.bound is bound


def test_the_result_has_the_numbers_of_its_targets(errors):
    kind, _, draft, deviation, _, _, result = errors
    row, targets = draft.selection.row, draft.selection.targets
    path, simulation = draft.path, draft.simulation
    np.testing.assert_array_equal(result.motion, targets.motion)
    np.testing.assert_array_equal(result.t, targets.t)
    np.testing.assert_array_equal(result.q, draft.q[row])
    for k in range(len(row)):
        np.testing.assert_array_equal(result.nominal[k], path.sample.pose[int(row[k])])
        np.testing.assert_array_equal(result.wrench[k], path.wrench[int(row[k])])
        tip = path.tip_in_base(row[[k]], path.joints.q[row[[k]]], path.wrench_in_root(row[[k]]), draft.theta[row[[k]]])
        np.testing.assert_allclose(
            result.deviation_before[k], (tip[0] - path.sample.pose[int(row[k])][:3, 3])[0], atol=1e-12
        )
        if kind != "certain":
            np.testing.assert_allclose(result.deflection_by_tool[k], tip[1][0], atol=1e-12)
    assert (result.deflection_by_tool is None) == (kind == "certain")
    np.testing.assert_array_equal(result.deviation_before, deviation)
    np.testing.assert_array_equal(result.deviation_after, simulation.deviation)
    np.testing.assert_array_equal(result.rounding, simulation.rounding)
    assert result.path_deviation == simulation.path_distance.max()
    moved = [np.linalg.norm(targets.pose[k][:3, 3] - result.nominal[k][:3, 3]) for k in range(len(row))]
    assert result.largest_correction == pytest.approx(max(moved), abs=1e-15)
    assert (result.largest_correction > 1e-4) == (kind != "nominal")
    limits = np.minimum(draft.q - ROBOT.lower, ROBOT.upper - draft.q)
    np.testing.assert_allclose(result.joint_margin, limits.min(axis=0), atol=1e-12)
    assert result.exact_forces == (kind == "certain")
    assert not result.is_stock_known
    assert (result.redundancy_deg is None) == (kind == "krl")
    assert result.programmed_rounding.any() == (kind == "krl")


def test_each_target_stands_for_the_cut_halfway_to_its_neighbours_with_the_same_force(errors):
    *_, draft, _, _, _, result = errors
    path, length = draft.path, draft.path.motions.segments.length
    is_cut = ~result.rapid
    expected = np.zeros(len(result))
    for k in np.flatnonzero(is_cut):
        same_motion = result.motion[k - 1] == result.motion[k]
        piece = length[result.motion[k]] * (result.t[k] - (result.t[k - 1] if same_motion else 0.0))
        same_force = same_motion or (result.wrench[k] == result.wrench[k - 1]).all()
        half = 0.5 * piece if same_force and is_cut[k - 1] else 0.0
        expected[k] += piece - half
        expected[k - 1] += half
    np.testing.assert_allclose(result.cut_length, expected, atol=1.1e-9)
    assert result.cut_length.sum() == pytest.approx(length[~path.program.motions.rapid].sum(), rel=1e-6)


def test_commands_put_the_loaded_tool_on_the_path(errors):
    """The tip at its nominal place, and the commanded pose that of the joint angles by the nominal arm."""
    kind, _, draft, _, _, _, _ = errors
    path, rows = draft.path, draft.selection.row
    tip, _ = path.tip_in_base(rows, draft.q[rows], path.wrench_in_root(rows), draft.theta[rows])
    gap = np.linalg.norm(tip - path.sample.pose[rows, :3, 3], axis=1)
    cuts = ~path.program.motions.rapid[draft.selection.targets.motion]
    assert (gap[cuts].max() < 1e-8) == (kind != "nominal")
    nominal = np.array([path.sample.pose[int(row)] for row in rows])
    changed = np.abs(twist_between(nominal, draft.selection.targets.pose[:])).max(axis=1) > 1e-9
    assert changed[cuts].any() == (kind != "nominal")
