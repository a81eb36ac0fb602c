"""The map of turns of a program with two tools, joint interpolations and E1, against loops over single samples."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.cell import ExternalAxis
from postproc.placement import turn_map
from postproc.placement.samples import PathSamples
from postproc.placement.turn_map import Blocks
from postproc.under_load import RobotInCell
from tests.oracle.arm import Arm
from tests.placement.by_sample import SampleBySample
from tests.placement.setting import cell, read_with_robot
from tests.places import ROOT

PROGRAM = """DEF part()
$BASE={X 1500,Y -100,Z 700,A 20,B 0,C 0}
$TOOL={X 350,Y 0,Z 200,A 0,B 0,C 0}
$VEL.CP=0.05
PTP {A1 0,A2 -90,A3 110,A4 0,A5 60,A6 0,E1 0}
;FORCE FX=-110 FY=-190 FZ=130 MX=2 FRAME=BASE
LIN {X 0,Y 0,Z 60,A 180,B 0,C 180,E1 0}
LIN {X 60,Y 0,Z 0,A 180,B 0,C 180,E1 50}
LIN {X 60,Y 45,Z 0,A 175,B 0,C 170,E1 50}
PTP {X 60,Y 45,Z 50,A 180,B 0,C 180,E1 80}
PTP {A1 5,A2 -85,A3 105,A4 3,A5 60,A6 10,E1 80}
$TOOL={X 350,Y 0,Z 240,A 0,B 0,C 0}
LIN {X 60,Y 90,Z 0,A 180,B 0,C 180,E1 80}
;FORCE FX=50 FY=-90 FZ=200 FRAME=TOOL
LIN {X 150,Y 90,Z 0,A 180,B 0,C 180,E1 80}
LIN {X 155,Y 90,Z 0,A 180,B 0,C 180,E1 80}
END
"""
BEHIND = """G21 G90
(FORCE FX=-110 FY=-190 FZ=130 FRAME=BASE)
G0 X-1500 Y-60 Z60
G1 Z0 F600
G1 Y80 F2000
G1 X-4000
"""
"""Across the line behind the robot, where A1 must go round, and out of reach."""


def samples_of(text, dialect):
    own = cell(base=(0.0, 0.0, 700.0))
    if dialect == "krl":
        own = replace(own, external_axes={"E1": ExternalAxis(direction=(0.0, 2.0, 0.0))})
    program, model = read_with_robot(text, own, dialect)
    return PathSamples.of(program, RobotInCell.of(model, own), None)


class Touching:
    """Bodies that come too close where a formula of the joint angles says so; samples that are asked for."""

    def __init__(self):
        self.rows = set()

    def is_hit_along_path(self, q, rows, breaks, *, between_samples):
        assert not between_samples
        assert len(q) == len(rows) == len(breaks)
        self.rows |= set(rows.tolist())
        return touches(q)


def touches(q):
    return np.sin(40.0 * np.nan_to_num(q).sum(axis=-1)) > 0.7


@pytest.fixture(scope="module", params=["krl", "gcode", "one turn"])
def maps(request):
    """A map in chunks of some bins, and the samples one by one at each of its turns."""
    samples = samples_of(*((BEHIND, "gcode") if request.param == "gcode" else (PROGRAM, "krl")))
    blocks, branch = Blocks.of(samples), turn_map.branch_of_start(samples)
    rng = np.random.default_rng(3)
    base = rng.uniform(-0.2, 0.2, len(samples)) * (request.param != "gcode")
    offset = np.radians([170.0] if request.param == "one turn" else [140.0, 160.0, 180.0])
    if request.param == "gcode":
        offset = np.radians([150.0, 180.0])
    bodies = Touching()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(turn_map, "SAMPLES_AT_ONCE", 1 if request.param == "one turn" else 9)
        patch.setattr(turn_map, "MOST_POSES", 10)
        evaluated = turn_map.evaluate(samples, blocks, branch, base, offset, bodies)
    singles = [SampleBySample(samples, branch, base + turn) for turn in offset]
    for single in singles:
        single.tool_lines = (15, 16) if request.param != "gcode" else ()
    bins = [range(*span) for span in zip(blocks.first, [*blocks.first[1:], len(samples)], strict=True)]
    return evaluated, singles, bins, bodies


def cells(evaluated, singles, bins):
    return [(k, j, rows, single) for j, single in enumerate(singles) for k, rows in enumerate(bins)]


def test_margins_of_a_bin_are_the_least_of_its_samples(maps):
    evaluated, singles, bins, _ = maps
    seen = set()
    for k, j, rows, single in cells(evaluated, singles, bins):
        expected = np.min([single.margins(i) for i in rows], axis=0)
        if any(single.flips(i) and not single.is_interpolated(i) for i in rows):
            expected[0] = np.nan if np.isnan(expected[0]) else -1.0
            seen.add("flip")
        seen |= {"reached"} if np.isfinite(expected[0]) else {"not reached"}
        margin = evaluated.margin
        found = [values[k, j] for values in (margin.joint, margin.wrist, margin.elbow, margin.shoulder)]
        np.testing.assert_allclose(found, expected, atol=1e-9)
    assert len(singles) == 2 or "flip" not in seen
    assert len(singles) != 2 or seen == {"flip", "reached", "not reached"}


def test_speeds_steps_and_winding_of_a_bin_are_those_from_sample_to_sample(maps):
    evaluated, singles, bins, _ = maps
    for k, j, rows, single in cells(evaluated, singles, bins):
        changes = np.array([np.zeros(6) if single.is_interpolated(i) else single.change(i) for i in rows])
        speeds = [0.0 if single.is_interpolated(i) else single.speed(i) for i in rows]
        assert evaluated.speed[k, j] == pytest.approx(max(speeds), abs=1e-9)
        assert evaluated.jump[k, j] == pytest.approx(np.abs(changes).max(), abs=1e-9)
        np.testing.assert_allclose(evaluated.q[k, j], single.q[rows[-1]], atol=1e-9)
        for column, joint in enumerate((3, 5)):
            way = np.cumsum(changes[:, joint])
            expected = [way[-1], min(0.0, way.min()), max(0.0, way.max())]
            np.testing.assert_allclose(evaluated.winding[k, j, column], expected, atol=1e-9)


def test_the_rate_of_a_turn_is_the_larger_one_to_the_turns_next_to_it(maps):
    evaluated, singles, bins, _ = maps
    limits = singles[0].robot.speed
    for k, j, rows, single in cells(evaluated, singles, bins):
        rates = []
        for beside in (singles[n] for n in (j - 1, j + 1) if 0 <= n < len(singles)):
            gap = (beside.q[rows[-1]] - single.q[rows[-1]] + np.pi) % (2 * np.pi) - np.pi
            rates.append(float(np.max(np.abs(gap) / limits)) / (evaluated.offset[1] - evaluated.offset[0]))
        known = [rate for rate in rates if np.isfinite(rate)] or [np.nan if rates else 0.0]
        assert evaluated.rate[k, j] == pytest.approx(max(known), rel=1e-9, nan_ok=True)


def test_errors_of_a_bin_are_those_of_its_middle_sample(maps):
    """The deflection of some by the arm of another code."""
    evaluated, singles, bins, _ = maps
    arm = Arm.load(ROOT / "robot_models" / "kuka_kr270")
    for k, j, rows, single in cells(evaluated, singles, bins):
        middle = rows[0] + (len(rows) - 1) // 2
        u95, deflection = single.errors(middle)
        assert evaluated.u95[k, j] == pytest.approx(u95, rel=1e-9, nan_ok=True)
        assert evaluated.deflection[k, j] == pytest.approx(deflection, rel=1e-9, nan_ok=True)
        if (k + j) % 11 == 0 and single.is_cut(middle) and np.isfinite(deflection):
            tip = arm.loaded_tcp(single.q[middle], single.tool(middle), single.wrench(middle))[:3, 3]
            assert deflection == pytest.approx(np.linalg.norm(tip - single.pose(middle)[:3, 3]), rel=1e-5)


def test_a_bin_is_hit_if_bodies_touch_at_one_of_the_samples_that_are_looked_at(maps):
    """About ten samples of the path, evenly, and the last one of each bin."""
    evaluated, singles, bins, bodies = maps
    count = len(singles[0].q)
    assert bodies.rows == set(range(0, count, count // 10)) | {rows[-1] for rows in bins}
    for k, j, rows, single in cells(evaluated, singles, bins):
        assert evaluated.hit[k, j] == any(touches(single.q[i]) for i in rows if i in bodies.rows)
