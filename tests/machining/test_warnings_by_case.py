"""Warnings and errors of cuts, case by case with numbers made up, at their limits; and which coefficients are open."""

from __future__ import annotations

import importlib
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import toolpath
from postproc.errors import ForceError
from postproc.machining import identification, profiles, resolution, source
from postproc.machining import sweep as sweep_module
from postproc.machining.process import ToolTable
from postproc.machining.remaining import Guard, ToolPart
from postproc.machining.sweep import Cuts, Sweep
from postproc.machining.tool_path import StraightSegments
from postproc.program import PTP
from tests.machining.setting import forces, gcode, process, tool
from tests.programs import program

estimate = importlib.import_module("postproc.machining.estimate")
MADE = program([("RAPID", 0, 0, 50)] + [("LIN", 10 * k, 0, 0) for k in range(5)] + [("RAPID", 50, 0, 50)])
"""Seven motions on lines 1 to 7."""


def cuts(motion, **columns):
    """Stations with a force, of motions; other columns as given."""
    count = len(motion)
    zero = {name: np.zeros(count) for name in Cuts.__struct_fields__}
    wrench = np.tile([100.0, 0, 0, 0, 0, 0], (count, 1))
    values = zero | {
        "motion": np.array(motion), "wrench": wrench, "deviation": 0.1 * wrench,
        "is_axial": np.zeros(count, dtype=bool), "torque": np.ones(count), "power": np.full(count, 200.0),
    }  # fmt: skip
    return Cuts(**(values | {name: np.asarray(value) for name, value in columns.items()}))


def test_cuts_beyond_the_power_of_the_spindle_are_counted_by_line():
    found = cuts([1, 2, 2, 3], power=[900.0, 1100.0, 1500.0, 1001.0])
    lines = MADE.motions.line
    assert estimate._power_warnings(found, lines, None) == []
    assert estimate._power_warnings(found, lines, 1.5) == []
    (issue,) = estimate._power_warnings(found, lines, 1.0)
    assert (issue.level, issue.kind, issue.source_line, issue.count) == ("warning", "spindle-power", 3, 2)
    assert issue.message.startswith("the cut takes 1.5 kW, more than the 1 kW of")


def test_depths_that_no_cutter_reaches_name_the_deepest():
    found = cuts([1, 2, 2, 3], depth=[0.039, 0.041, 0.05, 0.3])
    limit = np.array([0.04, 0.04, 0.04, np.inf])
    (issue,) = estimate._deep_cut_warnings(MADE.motions.line, found, limit)
    assert (issue.level, issue.kind, issue.source_line, issue.count) == ("warning", "deep-cut", 3, 2)
    assert issue.message.startswith("a depth of cut of 50 mm, more than 4 diameters")
    assert list(estimate._deep_cut_warnings(MADE.motions.line, found, np.full(4, np.inf))) == []


def test_the_thrust_of_drills_is_noted_once_with_its_lines():
    found = cuts([1, 2, 2, 3])
    assert list(estimate._drill_thrust_notes(MADE.motions.line, found, np.zeros(4, dtype=bool))) == []
    drills = np.array([False, True, True, True])
    (issue,) = estimate._drill_thrust_notes(MADE.motions.line, found, drills)
    assert (issue.level, issue.kind, issue.source_line, issue.count) == ("info", "drill-thrust", 3, 2)


def tool_states(keys=("1", "2"), tool=(0, 0, 0, 1, 1, 1, 1), rpm=6000.0, number=(1, 2)):
    return SimpleNamespace(
        keys=list(keys), tool=np.array(tool), rpm=np.full(7, rpm), number=np.array(number)[np.array(tool)]
    )


TOOLS = {"1": ToolTable(diameter_mm=10.0, flutes=2), "2": ToolTable(diameter_mm=20.0, flutes=4, shape="drill")}
PROCESS = SimpleNamespace(tools=TOOLS, path="process.toml", spindle=SimpleNamespace(power_kW=None))


@pytest.mark.parametrize(("feed", "count"), [(0.199, 0), (0.202, 2), (0.4, 2)])
def test_a_feed_per_tooth_of_a_tenth_of_the_tool_is_questioned(feed, count):
    """200 mm/s of two teeth at 6000/min are 1 mm per tooth; drills and stations in air do not count."""
    made = replace(MADE, motions=replace(MADE.motions, feed=np.full(7, feed)))
    wrench = np.tile([100.0, 0, 0, 0, 0, 0], (5, 1))
    wrench[[1, 4]] = 0.0
    found = cuts([1, 1, 2, 4, 2], wrench=wrench)
    issues = list(estimate._chip_load_issues(made, found, tool_states(), PROCESS))
    assert [issue.count for issue in issues] == [count] * (count > 0)
    for issue in issues:
        assert (issue.level, issue.kind, issue.source_line) == ("warning", "chip-load", 2)
        assert issue.message.startswith(f"{5.0 * feed:.3g} mm per tooth with a tool of 10 mm")


def test_a_cut_with_the_spindle_off_is_an_error_of_each_line():
    with pytest.raises(ForceError, match="moves through material while the spindle is off") as refused:
        estimate._refuse_stopped_spindle(MADE, {3, 1})
    text = str(refused.value)
    assert ":2:" in text
    assert ":4:" in text


@pytest.mark.parametrize(("gain", "removed", "left", "is_named"), [
    (0.9e-5, 1e-6, 1e-2, False),  # a fifth of what is noise of such a map, whatever was removed
    (5.1e-6, 1e-6, 1e-2, True), (4.9e-6, 1e-6, 1e-2, False),  # 5e-4 of what is left
    (0.051, 1.0, 10.0, True), (0.049, 1.0, 10.0, False),  # 5 % of what was removed
    (0.021, 1.0, 1.0, True), (0.019, 1.0, 1.0, False),  # 2 % of what is left
])  # fmt: skip
def test_cuts_that_count_as_material_again_are_named_by_their_share(gain, removed, left, is_named):
    if (gain, left) == (0.9e-5, 1e-2):
        left = 1.0
    issues = estimate._hidden_cut_issues(gain, removed, left)
    assert [issue.kind for issue in issues] == ["hidden-cuts"] * is_named
    if issues:
        assert f"now: {100 * min(gain / removed, 1.0):.0f} % of it counts as material again" in issues[0].message


@pytest.mark.parametrize(("volume", "is_named"), [(0.981, False), (0.979, True), (1.5, False)])
def test_hollows_of_the_stock_are_named_beyond_two_percent(volume, is_named):
    issues = estimate._hollow_stock_issues(1.0, volume)
    assert [issue.kind for issue in issues] == ["hollow-stock"] * is_named
    if issues:
        assert "(2 % more than the volume of the mesh)" in issues[0].message


def test_a_cutter_of_another_diameter_is_an_error_of_the_tools_that_cut():
    tools = tool_states(tool=(1, 0, 0, 0, 0, 0, 1))
    for diameter, is_other in ((0.01, False), (0.0100009, False), (0.0100011, True), (0.02, True)):
        guard = Guard([], 0.0, cutter=diameter)
        issues = list(estimate._cutter_mismatch_issues(MADE, tools, PROCESS, guard))
        assert [issue.kind for issue in issues] == ["other-cutter"] * is_other
        if is_other:
            assert "but tools.1 of the process has 10 mm:" in issues[0].message
            assert f"a cutter of {1e3 * diameter:g} mm" in issues[0].message
    assert list(estimate._cutter_mismatch_issues(MADE, tools, PROCESS, None)) == []
    assert list(estimate._cutter_mismatch_issues(MADE, tools, PROCESS, Guard([], 0.0))) == []


def test_what_touches_the_stock_without_cutting_is_an_error_of_each_part():
    guard = Guard([ToolPart("shank", 0.01, 0.02), ToolPart("holder", 0.03, 0.05), ToolPart("spindle", 0.1, 0.2)], 0.002)
    guard.close_distances = {("holder", 4): 0.0012, ("shank", 2): 0.0, ("holder", 1): 0.0012, ("holder", 3): 0.0015}
    issues = list(estimate._collision_issues(MADE, {6: 0.003, 0: 0.003}, guard))
    assert [issue.subject for issue in issues] == ["cutter, stock", "shank, stock", "holder, stock"]
    cutter, shank, holder = issues
    assert "collision: cutter goes 3 mm deep into the stock in a rapid move. Retract" in cutter.message
    assert (cutter.source_line, cutter.lines, cutter.count) == (1, (1, 7), 2)
    assert "shank touches the stock that is left here; [collision] asks for 2 mm" in shank.message
    assert "holder comes within 1.2 mm of the stock" in holder.message
    assert (holder.source_line, holder.lines, holder.count) == (2, (2, 4, 5), 3)
    assert list(estimate._collision_issues(MADE, {}, None)) == []
    (alone,) = estimate._collision_issues(MADE, {6: 0.0021, 0: 0.001}, None)
    assert (alone.kind, alone.count) == ("rapid-in-material", 2)
    assert "(line 1, 7), 2.1 mm deep" in alone.message


def test_lines_of_many_rapid_moves_are_abbreviated():
    many = program([("RAPID", k, 0, 0) for k in range(8)])
    for count, words in ((5, "(line 1, 2, 3, 4, 5),"), (6, "(line 1, 2, 3, 4, 5 …),")):
        (issue,) = estimate._collision_issues(many, dict.fromkeys(range(count), 0.001), None)
        assert words in issue.message
        assert issue.count == count


def test_advice_on_rapid_moves_depends_on_how_they_move():
    kind = MADE.motions.kind.copy()
    kind[[0, 6]] = PTP
    joints = replace(MADE, motions=replace(MADE.motions, kind=kind))
    first = estimate._rapid_advice(joints, np.array([0, 6]))
    assert first.startswith("On the way from [start] to the first target all axes move at once")
    assert estimate._rapid_advice(replace(joints, layout="krl"), np.array([0])).startswith("All axes move at once on a")
    assert estimate._rapid_advice(joints, np.array([3, 6])).startswith("All axes move at once on a PTP")
    assert estimate._rapid_advice(joints, np.array([3, 4])).startswith("Retract, or cut here first. If another program")
    assert "state the stock that it leaves: [stock] file" in estimate._rapid_advice(MADE, np.array([0]))


def test_a_longer_tool_is_named_where_the_rapid_move_begins_with_it():
    tools = np.tile(np.eye(4), (2, 1, 1))
    tools[0, 2, 3], tools[1, :3, 3] = 0.2, (0.0, 0.09, 0.22)
    made = replace(MADE, tools=tools, motions=replace(MADE.motions, tool=np.array([0, 0, 1, 1, 0, 0, 1])))
    longer = 1e3 * (np.hypot(0.09, 0.22) - 0.2)
    for motion in (2, 6):
        words = f". The new tool is {longer:.4g} mm longer: retract further before the tool change"
        assert estimate._tool_length_advice(made, motion) == words
    for motion in (0, 1, 3, 4):
        assert estimate._tool_length_advice(made, motion) == ""


def test_drilling_cycles_of_mills_are_lines_that_move_rapidly_and_cut_along_the_spindle():
    lines = MADE.motions.line.copy()
    lines[5] = lines[6]  # the last cut and the rapid move after it are one cycle
    made = replace(MADE, motions=replace(MADE.motions, line=lines))
    is_axial = np.array([True, True, True, False])
    found = cuts([2, 5, 5, 5], is_axial=is_axial, torque=[1.0, 1.0, 0.0, 1.0])
    none = np.zeros(4, dtype=bool)
    (issue,) = estimate._mill_drilling_issues(made, found, none)
    assert (issue.level, issue.kind, issue.lines) == ("warning", "drilled-by-mill", (7,))
    assert estimate._mill_drilling_issues(made, found, is_axial) == []
    assert estimate._mill_drilling_issues(replace(made, layout="krl"), found, none) == []
    assert estimate._mill_drilling_issues(MADE, found, none) == []
    assert estimate._mill_drilling_issues(made, replace(found, torque=np.zeros(4)), none) == []


@pytest.mark.parametrize(
    ("kinds", "lines", "texts", "expected"),
    [
        (("RAPID", "LIN", "RAPID"), (5, 5, 5), {}, True),
        (("RAPID", "LIN", "LIN"), (5, 5, 5), {}, True),
        (("LIN", "LIN", "LIN"), (5, 5, 5), {}, False),  # no rapid move
        (("RAPID", "LIN", "RAPID", "LIN"), (5, 5, 6, 5), {}, False),  # another line within it
        (("RAPID", "LIN", "LIN"), (4, 5, 5), {}, False),
    ],
)
def test_a_line_is_a_drilling_cycle_if_its_moves_follow_each_other_and_one_is_rapid(kinds, lines, texts, expected):
    made = program([(kind, 0, 0, -k) for k, kind in enumerate(kinds)])
    made = replace(made, motions=replace(made.motions, line=np.array(lines)))
    path = toolpath.segments(made, np.eye(4))
    moves = np.flatnonzero([kind == "LIN" and line == 5 for kind, line in zip(kinds, lines, strict=True)])
    assert profiles._is_drilling_cycle(made, path, 2, moves, "G81 Z-5 R2") is expected
    assert profiles._is_drilling_cycle(made, path, 0, moves, "G81 Z-5 R2") is False
    assert profiles._is_drilling_cycle(made, path, 2, moves, "M98 P100") is False


def straight(begin, end, motion=None, cutting=None):
    begin, end = np.array(begin, dtype=float), np.array(end, dtype=float)
    count = len(begin)
    no = np.zeros(count, dtype=bool)
    return StraightSegments(
        np.arange(count) if motion is None else np.array(motion), np.zeros(count), np.ones(count), begin, end,
        end - begin, end - begin, ~no if cutting is None else np.array(cutting), no, no,
    )  # fmt: skip


@pytest.mark.parametrize(("size", "is_named"), [((0.49, 0.51), False), ((0.51, 0.49), False), ((0.51, 0.52), True)])
def test_a_path_five_times_as_large_as_the_stock_in_both_directions_is_questioned(size, is_named):
    """Rapid moves do not count, whatever they reach."""
    steps = straight(
        [[0, 0, 0], [0.1, 0.05, 0], [0, 0, 0]], [[size[0], 0.05, 0], [0.2, size[1], 0], [9, 9, 0]],
        cutting=[True, True, False],
    )  # fmt: skip
    issues = estimate._scale_issues(steps, (-0.05, 0.05, 0.0, 0.1, 0.0))
    assert [issue.kind for issue in issues] == ["stock-scale"] * is_named
    if issues:
        assert "the path is 5 times as large as the stock" in issues[0].message


def test_runs_of_cuts_beside_the_stock_are_named_as_a_whole():
    """A run between rapid moves that never comes near, and is longer than twice the margin."""
    made = program([
        (kind, 0, 0, 0) for kind in ("RAPID", "LIN", "LIN", "RAPID", "LIN", "RAPID", "LIN", "LIN")
    ])  # fmt: skip
    far, near = [0.3, 0.3, 0.0], [0.05, 0.05, 0.0]
    begin = [far, far, far, far, far, far, far, near]
    end = [far, [0.3, 0.315, 0], [0.3, 0.306, 0], far, [0.3, 0.319, 0.2], far, near, near]
    steps = straight(begin, end)
    bounds = (0.0, 0.1, 0.0, 0.1, 0.0)
    (issue,) = estimate._beside_stock_issues(made, steps, bounds, 0.01)
    assert (issue.level, issue.kind, issue.lines) == ("warning", "beside-stock", (2, 3))  # 15 and 6 mm; 19 is too short
    assert "within X 0 … 100, Y 0 … 100 mm" in issue.message
    assert estimate._beside_stock_issues(made, steps, bounds, 0.011) == []
    assert estimate._beside_stock_issues(replace(made, layout="krl"), steps, bounds, 0.01) == []


@pytest.mark.parametrize(
    ("size", "words"),
    [
        (2.54, "smaller by about 25.4"), (0.004, "larger by about 25.4"), (0.2, None), (30.0, None),
        (0.1 * 25.4 * 0.31, "smaller"),
    ],
)  # fmt: skip
def test_a_tool_that_never_touches_the_stock_is_told_where_both_are_and_whether_one_is_in_inches(size, words):
    steps = straight([[0, 0, 0.01], [5, 5, 5]], [[size, 0.5 * size, -0.002], [6, 6, 6]], cutting=[True, False])
    error = estimate._no_contact_error(steps, (1.0, 1.1, 2.0, 2.05, -0.3), PROCESS, None)
    text = str(error)
    assert f"X 0 … {1e3 * size:.4g}, Y 0 … {500 * size:.4g}, Z -2 … 10 mm" in text
    assert "the stock within X 1000 … 1100, Y 2000 … 2050, top Z -300 mm" in text
    assert ("in inches" in text) == (words is not None)
    assert words is None or f"The stock is {words}" in text
    assert error.file == "process.toml"


def test_taps_have_no_force_and_are_named_with_their_operation(monkeypatch):
    tools = tool_states(number=(0, 7))
    monkeypatch.setattr(estimate, "tapping_motions", lambda made, states: np.array([2, 4]))
    found = cuts([1, 2, 2, 4], is_axial=[True, True, False, True], torque=[3.0, 3, 3, 3])
    free = estimate._without_taps(found, MADE, tools)
    assert (free.wrench[:, 0] > 0.0).tolist() == [True, False, True, False]
    assert (free.deviation[:, 0] > 0.0).tolist() == [True, False, True, False]
    assert (free.torque.tolist(), (free.power > 0.0).tolist()) == ([3.0, 0.0, 3.0, 0.0], [True, False, True, False])
    (issue,) = estimate._tap_issues(MADE, found, tools)
    assert (issue.level, issue.kind, issue.lines) == ("warning", "tap-force", (3, 5))
    assert "in [operations] of the process" in issue.message
    (numbered,) = estimate._tap_issues(MADE, replace(found, motion=np.array([1, 1, 1, 4])), tools)
    assert "in [operations.T7] of the process" in numbered.message
    monkeypatch.setattr(estimate, "tapping_motions", lambda made, states: np.zeros(0, dtype=int))
    assert estimate._without_taps(found, MADE, tools) is found
    assert list(estimate._tap_issues(MADE, found, tools)) == []


def event(kind, line, value=0.0, before=0):
    return SimpleNamespace(kind=kind, line=line, value=value, before=before)


@pytest.mark.parametrize(
    ("events", "line", "words"),
    [
        ([], 2, "the spindle is never started"),
        ([event("spindle_on", 9)], 9, "the spindle is started without a speed"),
        ([event("spindle_ccw", 9, 500.0), event("spindle_off", 11, before=1)], 2, "line 11 stops it"),
        ([event("spindle_on", 9, 500.0), event("spindle_off", 11, before=2)], 9, "started without a speed"),
    ],
)
def test_cuts_without_a_spindle_speed_are_refused_with_the_line_to_look_at(events, line, words):
    made = replace(MADE, events=tuple(events))
    steps = straight(np.zeros((2, 3)), np.ones((2, 3)), motion=[1, 0], cutting=[True, False])
    with pytest.raises(ForceError, match=words) as refused:
        estimate._check_spindle_speed(made, steps, tool_states(rpm=0.0))
    assert refused.value.line == line
    with pytest.raises(ForceError, match=r"speed is not known\. Give rpm in \[tools\.n\] of the process file\.$"):
        estimate._check_spindle_speed(replace(MADE, layout=SimpleNamespace()), steps, tool_states(rpm=0.0))
    estimate._check_spindle_speed(made, steps, tool_states())
    rapid = straight(np.zeros((1, 3)), np.ones((1, 3)), motion=[0], cutting=[False])
    estimate._check_spindle_speed(made, rapid, tool_states(rpm=0.0))


@pytest.mark.parametrize("count", [4, 12])
def test_coefficients_in_a_combination_that_no_reading_has_are_named(count):
    """Whether there are fewer readings than coefficients or more of them."""
    rng = np.random.default_rng(1)
    excited = np.array([True, True, True, True, False, True])
    predictor = rng.normal(size=(count, 6)) * [1.0, 50.0, 1.0, 1e-3, 0.0, 1.0]
    chip = np.linspace(0.02, 0.1, count)
    if count > 5:
        identification._check_separable(chip, predictor, np.ones(count), excited, "cuts.csv")
        predictor[:, 3] = 1e-4 * predictor[:, 1]  # the second and the fourth in one proportion
        with pytest.raises(ForceError, match="do not separate Krc, Kte"):
            identification._check_separable(chip, predictor, np.ones(count), excited, "cuts.csv")
        return
    with pytest.raises(ForceError, match="do not separate Ktc, Krc, Kac, Kte, Kae"):
        identification._check_separable(chip, predictor, np.ones(count), excited, "cuts.csv")


def test_feeds_within_a_small_range_cannot_separate_edge_and_cut():
    predictor = np.random.default_rng(2).normal(size=(8, 6))
    every = np.ones(6, dtype=bool)
    least = identification._LEAST_RANGE
    for factor, is_refused in ((0.99, True), (1.01, False)):
        chip = np.linspace(0.05, 0.05 * least * factor, 8)
        if is_refused:
            with pytest.raises(ForceError, match="one feed per tooth"):
                identification._check_separable(chip, predictor, np.ones(8), every, "cuts.csv")
        else:
            identification._check_separable(chip, predictor, np.ones(8), every, "cuts.csv")


def test_a_weighted_fit_has_the_normal_equations_and_their_covariance():
    rng = np.random.default_rng(3)
    predictor = rng.normal(size=(20, 4)) * [1.0, 1e4, 1e-5, 3.0]
    readout, sigma = rng.normal(size=20), rng.uniform(0.5, 2.0, 20)
    value, covariance = identification._fit(predictor, readout, sigma)
    weight = np.diag(sigma**-2.0)
    normal = predictor.T @ weight @ predictor
    np.testing.assert_allclose(covariance, np.linalg.inv(normal), rtol=1e-6)
    np.testing.assert_allclose(value, np.linalg.solve(normal, predictor.T @ weight @ readout), rtol=1e-6)


def test_the_error_at_each_feed_is_that_by_the_coefficients_from_all_others():
    rng = np.random.default_rng(4)
    predictor = rng.normal(size=(24, 3))
    chip = np.repeat([0.02, 0.04, 0.06], 8)
    readout, sigma = 10.0 + rng.normal(size=24), rng.uniform(0.5, 2.0, 24)
    part = readout - 1.0
    total = 0.0
    for value in (0.02, 0.04, 0.06):
        own = chip == value
        weight = np.diag(sigma[~own] ** -2.0)
        matrix = predictor[~own]
        found = np.linalg.solve(matrix.T @ weight @ matrix, matrix.T @ weight @ part[~own])
        total += (((predictor[own] @ found - part[own]) / sigma[own]) ** 2).sum()
    expected = np.sqrt(total / ((readout / sigma) ** 2).sum())
    assert identification._cross_validation_error(predictor, part, readout, sigma, chip) == pytest.approx(expected)
    same = np.full(24, 0.05)
    assert np.isnan(identification._cross_validation_error(predictor, part, readout, sigma, same))
    few = np.where(np.arange(24) < 22, 0.05, 0.06)
    assert np.isnan(identification._cross_validation_error(predictor, part, readout, sigma, few))


def test_columns_of_very_different_size_are_separate_coefficients():
    """Their units do not count, only their directions."""
    predictor = np.random.default_rng(5).normal(size=(12, 6)) * [1.0, 1e9, 1e-7, 1.0, 1e-3, 1.0]
    chip = np.linspace(0.02, 0.1, 12)
    identification._check_separable(chip, predictor, np.ones(12), np.ones(6, dtype=bool), "cuts.csv")


LAW = SimpleNamespace(warning=None, unknown_axial=0.0)


@pytest.mark.parametrize(("depth", "is_named"), [(0.0399, False), (0.0401, True)])
def test_cuts_deeper_than_four_diameters_are_named_but_not_those_of_drills_and_in_air(monkeypatch, depth, is_named):
    """Tools of 10 mm and a drill of 20 mm."""
    monkeypatch.setattr(estimate, "tapping_motions", lambda made, states: np.zeros(0, dtype=int))
    wrench = np.tile([100.0, 0, 0, 0, 0, 0], (3, 1))
    wrench[2] = 0.0
    found = cuts([1, 4, 2], wrench=wrench, depth=[depth, 0.3, 0.3])
    issues = list(estimate._cut_issues(MADE, LAW, found, tool_states(), PROCESS))
    assert [issue.kind for issue in issues] == ["drill-thrust"] + ["deep-cut"] * is_named
    if is_named:
        assert issues[1].source_line == 2


def test_limits_of_the_material_are_said_first(monkeypatch):
    monkeypatch.setattr(estimate, "tapping_motions", lambda made, states: np.zeros(0, dtype=int))
    law = SimpleNamespace(warning="a guess", unknown_axial=0.4)
    issues = list(estimate._cut_issues(MADE, law, cuts([1]), tool_states(), PROCESS))
    assert [(issue.level, issue.kind) for issue in issues] == [("warning", "material"), ("info", "no-axial-force")]
    assert issues[0].message == "a guess"
    assert "the bound includes 40 % of it" in issues[1].message
    drilled = estimate._cut_issues(MADE, law, cuts([4]), tool_states(), PROCESS)
    assert "no-axial-force" not in [issue.kind for issue in drilled]


@pytest.mark.parametrize("seed", range(20))
def test_passes_are_thin_from_the_first_on_whose_rest_of_the_operation_is_thin_too(monkeypatch, seed):
    """Operations and tools divide the passes; shares are roots of sums of squares."""
    rng = np.random.default_rng(seed)
    made = program([("RAPID", 0, 0, 0), ("LIN", 0, 0, 0), ("LIN", 0, 0, 0)] * 9)
    begins = np.sort(rng.choice(np.arange(1, 9), 2, replace=False)) * 3
    monkeypatch.setattr(
        resolution, "operations", lambda given, *, at_retracts: [SimpleNamespace(first=int(k)) for k in (0, *begins)]
    )
    tool_of_pass = (np.arange(9) >= rng.integers(1, 9)).astype(int)
    tools = SimpleNamespace(tool=np.repeat(tool_of_pass, 3))
    force = rng.uniform(1.0, 2.0, (9, 3))
    share = rng.choice([0.02, 0.05, 0.06, 0.2], 9, p=[0.4, 0.2, 0.2, 0.2])
    by_cells = np.stack([(share[:, None] ** 2 * force), force], axis=2)
    by_cells[:, 0] = 0.0
    level_share = rng.choice([0.3, 1.0], 9)  # deviation without steep parts, over the one with them
    columns = by_cells[..., 0], level_share[:, None] ** 2 * by_cells[..., 0], by_cells[..., 1]
    error, gentle_error, squares = (column.reshape(-1) for column in columns)
    sums = resolution.CellErrors(error, gentle_error, 0.05**2 * squares, squares)
    found = resolution.thin_passes(made, tools, sums)
    limits = sorted({0, 9, *(begins // 3).tolist(), *(np.flatnonzero(np.diff(tool_of_pass)) + 1).tolist()})
    expected = []
    for low, high in itertools.pairwise(limits):
        for k in range(low, high):
            own, rest = (by_cells[rows, 1:].reshape(-1, 2).sum(axis=0) for rows in ([k], range(k, high)))
            if np.sqrt(own[0] / own[1]) > 0.055 and np.sqrt(rest[0] / rest[1]) > 0.055:
                level = (level_share[k:high, None] ** 2 * by_cells[k:high, 1:, 0]).sum()
                is_steep = bool(np.sqrt(level / rest[1]) <= 0.055)
                expected.append((3 * k + 1, int(tool_of_pass[k]), is_steep, float(np.sqrt(rest[0] / rest[1]))))
                break
    assert [(thin.first, thin.tool, thin.is_steep) for thin in found] == [entry[:3] for entry in expected]
    np.testing.assert_allclose([thin.force_share for thin in found], [entry[3] for entry in expected])
    np.testing.assert_allclose([thin.excess for thin in found], [entry[3] / 0.05 for entry in expected])


def test_a_program_without_cuts_has_no_thin_passes():
    made = program([("RAPID", 0, 0, 0)] * 3)
    assert resolution.thin_passes(made, SimpleNamespace(tool=np.zeros(3, dtype=int)), no_errors(3)) == []


def no_errors(count):
    return resolution.CellErrors(*np.zeros((4, count)))


def swept(**fields):
    tools = SimpleNamespace(rpm=np.full(7, 6000.0), hand=np.array([1, 1, 1, -1, 1, 1, 1]), tool=np.zeros(7, dtype=int))
    columns = dict.fromkeys(("process", "poses", "feed", "swing"))
    columns["law"] = SimpleNamespace(sigma=0.4, covariance=None)
    stock = SimpleNamespace(cell=0.01)
    return Sweep(stock=stock, tools=tools, cell_error_sums=no_errors(7), **(columns | fields))


def test_the_deepest_place_of_turning_rapid_moves_through_material_is_kept(monkeypatch):
    """A segment is looked at about every cell, and at some places at least."""
    sweep_ = swept(poses=SimpleNamespace(tips_and_axes=lambda motion, t: (motion, t)))
    seen = []
    depths = iter([0.002, 0.003, 0.001, 0.0])

    def depth(stock, cutter, motion, t):
        seen.append((motion.tolist(), t))
        return next(depths)

    monkeypatch.setattr(sweep_module, "depth_inside", depth)
    monkeypatch.setattr(Sweep, "_cutter", lambda self, number: "cutter")
    steps = straight(np.zeros((4, 3)), [[0.2, 0, 0], [0, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], motion=[3, 5, 5, 6])
    steps = replace(steps, first=np.array([0.0, 0.0, 0.5, 0.0]), last=np.array([1.0, 0.5, 1.0, 1.0]))
    sweep_._record_turning_rapids(steps, 0, 4)
    assert sweep_.collisions == {3: 0.002, 5: 0.003}
    least = sweep_module._FEWEST_PLACES
    counts = [max(least, 20), least, max(least, 10), max(least, 10)]
    for (motion, t), count, (first, last) in zip(
        seen, counts, ((0.0, 1.0), (0.0, 0.5), (0.5, 1.0), (0.0, 1.0)), strict=True
    ):
        np.testing.assert_allclose(t, np.linspace(first, last, count + 1))
        assert len(motion) == count + 1


def test_stations_in_air_have_no_angles_and_no_size_of_cut():
    sweep_ = swept()
    loads = SimpleNamespace(wrench=np.ones((2, 6)), deviation=np.full((2, 6), 0.1))
    stations = np.array([2, 3]), np.array([0.1, 0.2]), np.array([False, True])
    found = sweep_._cuts_of_loads(None, stations, loads, np.zeros((2, 4)), 0.5)
    assert not sweep_.has_contact
    for name in ("torque", "power", "depth", "width", "rate"):
        assert getattr(found, name).tolist() == [0.0, 0.0]
    assert np.isnan(found.enter).all()
    assert np.isnan(found.leave).all()
    np.testing.assert_array_equal(found.wrench, [[1.0] * 6, [1, -1, 1, -1, 1, -1]])  # M4 turns the other way
    assert found.is_axial.tolist() == [False, True]


def test_the_depth_of_a_hole_is_that_of_a_drill_and_power_is_torque_times_speed(monkeypatch):
    sizes = np.array([0.1, 0.2]), np.array([0.3, 0.4]), np.array([0.5, 0.6]), np.array([0.7, 0.8])
    monkeypatch.setattr(sweep_module, "_engagement_sizes", lambda turn, given: sizes)
    wrench = np.array([[3.0, 4.0, 0.0, 0.0, 0.0, 2.0], [0.0, 0.0, 12.0, 0.0, 0.0, -2.0]])
    loads = SimpleNamespace(
        wrench=wrench, deviation=np.zeros((2, 6)), cell_error_share=np.array([0.1, 0.2]),
        gentle_error_share=np.array([0.05, 0.1]), removal=np.array([1e-9, 2e-9]),
    )  # fmt: skip
    stations = np.array([2, 3]), np.array([0.1, 0.2]), np.array([False, True])
    for is_drill in (False, True):
        sweep_ = swept()
        turn = SimpleNamespace(drill=is_drill, teeth=3)
        given = replace_wrench(loads)
        found = sweep_._cuts_of_loads(turn, stations, given, np.array([[1.0, 0.0], [0.0, 0.0]]), 0.05)
        assert sweep_.has_contact
        assert found.depth.tolist() == ([0.05, 0.0] if is_drill else [0.5, 0.6])
        assert (found.enter[0], found.leave[1], found.width[0]) == (0.1, 0.4, 0.7)
        assert found.torque.tolist() == [2.0, -2.0]
        np.testing.assert_allclose(found.power, [400 * np.pi, -400 * np.pi])
        np.testing.assert_allclose(found.rate, [3e-7, 6e-7])
        sums = sweep_.cell_error_sums
        np.testing.assert_allclose(sums.error[[2, 3]], [0.01 * 25, 0.04 * 144])
        np.testing.assert_allclose(sums.gentle_error[[2, 3]], [0.0025 * 25, 0.01 * 144])
        np.testing.assert_allclose(sums.force[[2, 3]], [25, 144])


def replace_wrench(loads):
    """The same loads with a wrench of its own, which is changed in place."""
    return SimpleNamespace(**(vars(loads) | {"wrench": loads.wrench.copy()}))


def test_the_stock_over_time_is_kept_for_a_guard_only(tmp_path):
    text = gcode("G0 X-15 Y3 Z5", "G1 Z-2 F600", "X60 F2400", "G0 Z5")
    table = process(tool(16, 3), ((0, 40), (-10, 20), (-10, 0)), 1.0)
    assert forces(tmp_path, text, table)[1].over_time is None
    assert forces(tmp_path, text, table, guard=Guard([], 0.0))[1].over_time is not None


def test_force_comments_next_to_a_process_are_refused_with_their_lines():
    notes = program([("LIN", 0, 0, 0), ("LIN", 9, 0, 0)], notes=[(2, (0.0,) * 6), (4, (1.0, 0, 0, 0, 0, 0))])
    with pytest.raises(ForceError, match=r"a force comment, and forces from process\.toml") as refused:
        source.refuse_comments(notes, "process.toml")
    assert refused.value.line == 4
    source.refuse_comments(replace(notes, notes=notes.notes[:1]), "process.toml")
