"""Forces that change along a move: corrected between targets too, and the same in the program as written."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction, forces, report, toolpath
from postproc.robot.model import Covariance
from tests.correction.simulated import rows_of, simulator, written
from tests.correction.test_forces_carried import AT_Z20, check
from tests.corrections import correct_files, read_back, read_files
from tests.kr270 import CELL, ROBOT

TEXT = AT_Z20 + "G1 Z0\nG1 X120\nG3 X120 Y40 I0 J20\nG1 X0\nG0 Z20\nM2\n"
LINE, ARC, BACK = 5, 6, 7
FORCES = (
    f"line,t,Fx,Fy,Fz,frame\n{LINE},0,0,0,0,\n{LINE},0.3,400,-200,150,\n{LINE},0.35,-100,300,150,\n"
    f"{ARC},0,-100,300,150,FEED\n{ARC},0.3,200,400,50,FEED\n{ARC},0.6,-100,400,50,FEED\n{BACK},,300,0,90,FEED\n"
)


def source(tmp_path, text):
    (tmp_path / "in.csv").write_text(text)
    return forces.read(tmp_path / "in.csv")


def on_the_line(t):
    """The force on the straight move, from the rows above by hand."""
    table = np.array([[0, 0, 0, 0], [0.3, 400, -200, 150], [0.35, -100, 300, 150]])
    return np.array([*(np.interp(t, table[:, 0], column) for column in table[:, 1:].T), 0, 0, 0])


def on_the_arc(t):
    """The same on the half circle about (120, 20), from (120, 0), in $BASE axes: x ahead, z up, y to the left."""
    table = np.array([[0, -100, 300, 150], [0.3, 200, 400, 50], [0.6, -100, 400, 50]])
    x, y, z = (np.interp(t, table[:, 0], column) for column in table[:, 1:].T)
    c, s = np.cos(np.pi * t), np.sin(np.pi * t)
    return np.array([c * x - s * y, s * x + c * y, z, 0, 0, 0])


def place(line, t):
    if line == LINE:
        return np.array([120 * t, 0, 0]) / 1000
    return np.array([120 + 20 * np.sin(np.pi * t), 20 - 20 * np.cos(np.pi * t), 0]) / 1000


def test_the_path_is_held_between_targets_by_an_arm_that_shares_no_code(tmp_path):
    result = correct_files({"part.nc": TEXT}, source=source(tmp_path, FORCES))
    sim, moves, rows = simulator("cell_kr270.toml"), written(result), rows_of(result)
    first = len(moves) - len(rows)
    worst, seen = 0.0, 0
    for index, share, _, q in sim.run(moves, (0.2, 0.5, 0.8, 1.0)):
        row, before = rows[index - first], rows[max(index - first - 1, 0)]
        line = int(row["source_line"])
        if line not in (LINE, ARC):
            continue
        begin = before["t"] if before["source_line"] == line else 0.0
        t = begin + share * (row["t"] - begin)
        force = on_the_line(t) if line == LINE else on_the_arc(t)
        off = np.linalg.norm(sim.tip(moves[index], q, force) - place(line, t))
        assert off < 1e-6 or share < 1.0
        worst, seen = max(worst, off), seen + 1
    assert seen > 20
    assert 0.0 < worst <= 0.010e-3


def test_the_forces_of_the_written_program_are_those_it_was_corrected_for(tmp_path):
    check(correct_files({"part.nc": TEXT}, source=source(tmp_path, FORCES)), tmp_path)


def test_what_is_given_for_the_written_program_holds_between_its_targets_too(tmp_path):
    result = correct_files({"part.nc": TEXT}, source=source(tmp_path, FORCES))
    (tmp_path / "in.csv").write_bytes(report.forces_csv(result))
    program = read_back(result)
    path = toolpath.segments(program, program.motions.target[0])
    load = forces.assign(program, path, forces.read(tmp_path / "in.csv"), "+Z", 1e-3)
    begin = np.where(np.diff(result.source_line, prepend=0) == 0, np.roll(result.t, 1), 0.0)
    row = np.searchsorted(program.motions.line, result.output_line)
    for share in (0.01, 0.3, 0.7):
        found = load.at(toolpath.at(program, path, row, np.full(len(row), share)))
        t = begin + share * (result.t - begin)
        # N; a written arc is a slightly different circle, along which the axes of FEED turn a little differently
        for line, expected, within in ((LINE, on_the_line, 2e-3), (ARC, on_the_arc, 1.0)):
            rows = np.flatnonzero(result.source_line == line)
            assert len(rows) > 2
            np.testing.assert_allclose(found[rows], [expected(one) for one in t[rows]], rtol=0, atol=within)


def test_a_step_where_a_move_begins_is_told_and_followed(tmp_path):
    result = correct_files(
        {"part.nc": TEXT}, source=source(tmp_path, f"line,t,Fx,Fy,Fz\n{LINE},0,300,100,50\n{LINE},1,0,0,0\n")
    )
    (issue,) = (issue for issue in result.issues if issue.kind == "force-step")
    assert (issue.level, issue.source_line) == ("warning", LINE)
    behind = result.t[result.source_line == LINE][0]
    assert behind * 120 == pytest.approx(0.01)
    check(result, tmp_path)


def test_a_constant_force_along_a_move_needs_one_row(tmp_path):
    text = f"line,t,Fx,Fy,Fz\n{LINE},0.5,0,0,90\n"
    lines = report.forces_csv(correct_files({"part.nc": TEXT}, source=source(tmp_path, text))).decode().splitlines()
    assert sum(",90.000," in line for line in lines) == 1


def test_the_bound_counts_the_deviation_of_the_forces(tmp_path):
    """Against draws of the force put on an arm that shares no code: 95 % of them move the tip by less."""
    known = replace(ROBOT, covariance=Covariance.of(["k1"], [[1e-12]]))
    text = f"line,t,Fx,Fy,Fz,frame,sFx,sFy,sFz\n{LINE},0,300,-100,150,FEED,20,0,5\n{LINE},1,300,-100,150,FEED,60,30,5\n"
    program = read_files({"part.nc": TEXT}, robot=known)
    result = correction.process(program, known, CELL, source(tmp_path, text))
    (row,) = np.flatnonzero((result.source_line == LINE) & (result.t == 1.0))
    assert not result.bound[result.source_line == BACK][-1]
    sim, moves = simulator("cell_kr270.toml"), written(result)
    move = moves[row + len(moves) - len(result)]
    tips = np.array([sim.tip(move, result.q[row], result.wrench[row] + 0.5 * step) for step in np.eye(6)[:3]])
    back = np.array([sim.tip(move, result.q[row], result.wrench[row] - 0.5 * step) for step in np.eye(6)[:3]])
    draws = np.random.default_rng(95).normal(size=(200_000, 3)) * (60, 30, 5)
    moved = np.linalg.norm(draws @ (tips - back), axis=1)
    assert result.bound[row] == pytest.approx(np.quantile(moved, 0.95), rel=0.03)


@pytest.mark.parametrize("force", ["300,-100,150", "300,300,300", "20,-10,400"])
def test_the_bound_holds_whether_components_share_one_error_or_have_their_own(tmp_path, force):
    """Against draws of 15 % put on an arm that shares no code: one factor, or one for each component."""
    known = replace(ROBOT, covariance=Covariance.of(["k1"], [[1e-12]]))
    text = f"line,Fx,Fy,Fz,frame,sigma_percent\n{LINE},{force},FEED,15\n"
    program = read_files({"part.nc": TEXT}, robot=known)
    result = correction.process(program, known, CELL, source(tmp_path, text))
    (row,) = np.flatnonzero((result.source_line == LINE) & (result.t == 1.0))
    sim, moves = simulator("cell_kr270.toml"), written(result)
    move = moves[row + len(moves) - len(result)]
    each = np.eye(3, 6) * result.wrench[row, :3, None]
    ends = [[sim.tip(move, result.q[row], result.wrench[row] + s * step) for step in each] for s in (0.5, -0.5)]
    slopes = np.subtract(*map(np.array, ends))
    rng = np.random.default_rng(96)
    own = 0.15 * rng.normal(size=(200_000, 3)) @ slopes
    shared = 0.15 * rng.normal(size=(200_000, 1)) * slopes.sum(axis=0)
    own_, shared_ = (np.quantile(np.linalg.norm(moved, axis=1), 0.95) for moved in (own, shared))
    assert result.bound[row] == pytest.approx(max(own_, shared_), rel=0.03)


def test_a_factor_of_the_force_goes_with_the_program(tmp_path):
    text = f"line,line_end,Fx,Fy,Fz,sFx,sFy,sFz,factor_percent\n{LINE},{BACK},300,-100,150,80,40,50,20\n"
    result = correct_files({"part.nc": TEXT}, source=source(tmp_path, text))
    (tmp_path / "out.csv").write_bytes(report.forces_csv(result))
    rows = forces.read(tmp_path / "out.csv")
    assert np.unique(rows.sigma[rows.wrench.any(axis=1)], axis=0).tolist() == [[80, 40, 50, 0, 0, 0]]
    assert set(rows.factor[rows.wrench.any(axis=1)].tolist()) == {0.2}


def test_a_model_that_knows_nothing_of_itself_has_no_bound_but_tells(tmp_path):
    text = f"line,Fx,Fy,Fz,sigma_percent\n{LINE},300,-100,150,15\n"
    unsure = replace(ROBOT, covariance=None)
    program = read_files({"part.nc": TEXT}, robot=unsure)
    result = correction.process(program, unsure, CELL, source(tmp_path, text))
    assert result.bound is None
    assert [issue.level for issue in result.issues if issue.kind == "no-bound"] == ["info"]


def test_deviations_go_with_the_program(tmp_path):
    text = f"line,line_end,Fx,Fy,Fz,sFx,sFz\n{LINE},{BACK},300,-100,150,20,5\n"
    result = correct_files({"part.nc": TEXT}, source=source(tmp_path, text))
    (tmp_path / "out.csv").write_bytes(report.forces_csv(result))
    rows = forces.read(tmp_path / "out.csv")
    assert np.unique(rows.sigma[rows.wrench.any(axis=1)], axis=0).tolist() == [[20, 0, 5, 0, 0, 0]]


TURNING = (
    "DEF part( )\n$VEL.CP=0.005\nPTP {{X 0,Y 0,Z 200,A 180,B 0,C 180}}\n;FORCE FX=300 FY=100 FZ=50 FRAME=FEED\n"
    "LIN {{X 0,Y 0,Z 100,A 180,B 50,C 180}}\nLIN {{X 100,Y {},Z 100,A 180,B 80,C 180}}\n"
    "LIN {{X 200,Y 0,Z 100,A 180,B 100,C 180}}\nEND\n"
)
"""The last LIN turns the tool through the direction in which it travels, or past it."""


def test_a_line_that_turns_the_tool_past_its_travel_holds_the_tolerance_under_a_feed_force(tmp_path):
    result = correct_files({"part.src": TURNING.format(1.0)})
    check(result, tmp_path)
    assert result.path_deviation <= CELL.tolerance
    assert result.documents[0].text.count("FRAME=FEED") > 20  # the force turns with the tool along each piece


def test_a_line_that_turns_the_tool_through_its_travel_is_refused_for_the_jump_of_the_force():
    program = read_files({"part.src": TURNING.format(0.0)})
    issues = [issue for issue in correction.process(program, ROBOT, CELL).issues if issue.level == "error"]
    assert [(issue.kind, issue.source_line) for issue in issues] == [("force-jump", 7)]
