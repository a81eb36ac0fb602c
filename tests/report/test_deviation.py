"""The page of a program, as text: what a browser makes of it is tested in `tests/pages`."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import cell
from postproc.chunks import Runs
from postproc.correction import read
from postproc.elastostatics import Reversals
from postproc.errors import Issue
from postproc.frames import rotation_from_vector
from postproc.poses import Poses
from postproc.program import CIRC, Document, Event
from postproc.report import page, summary
from postproc.report.deviation import data as places
from postproc.report.path import drawn_path, operation_starts, operations
from tests import fabricated
from tests.html_page import ReadPage, read_page
from tests.kr270 import CELL_TEXT, ROBOT

_SECTIONS = {"verdict", "numbers", "view3d", "along", "histogram", "worst", "place", "issues", "operations", "model"}


def _read(result, tolerance=1e-5) -> ReadPage:
    return read_page(b"".join(page(result, tolerance)))


@pytest.mark.parametrize("mode", ["convert", "nominal", "predict"])
@pytest.mark.parametrize("count", [0, 1, 2, 30])
def test_page_is_well_formed_and_loads_nothing(mode, count):
    read = _read(fabricated.result(count, mode))
    assert {"verdict", "issues", "model"} <= set(read.ids)
    assert count < 2 or set(read.ids) >= _SECTIONS


def test_a_page_that_loads_something_would_be_noticed():
    content = b"".join(page(fabricated.result(3), 1e-5))
    for more in (b'<img src="https://example.com/a.png">', b'<link href="a.css">', b"<p>"):
        with pytest.raises(AssertionError):
            read_page(content.replace(b"<main", more + b"<main"))


def test_program_and_messages_are_escaped():
    read = _read(fabricated.result())
    assert "cutting moves <without> a force" in read.text("issues")
    base = fabricated.result(5)
    named = replace(base.program, documents=(replace(base.program.documents[0], name="</script><b>.nc"),))
    assert "</script><b>.nc" in _read(fabricated.with_changes(base, program=named)).text()


def test_the_table_says_what_the_report_says():
    result = fabricated.result()
    text = _read(result).text("numbers")
    assert "Maximum 1.5 0.0002 7500" in text
    content = summary(result, 1e-5)
    assert f"RMS {content.before.rms_mm:.1f} {content.after.rms_mm:.4f}" in text


def test_what_the_model_leaves_and_what_is_to_be_expected_stand_apart():
    base = fabricated.result()
    assert "Expected error on the part unknown" in _read(base).text("numbers")
    bounded = fabricated.with_changes(base, bound=np.where(base.rapid, 9.0, 1.23e-4))
    text = _read(bounded).text("numbers")
    assert "What the model leaves, largest 0.0002 mm" in text
    assert "Expected error on the part, up to 0.13 mm 95 %; at targets 0.12 mm" in text
    assert "from published values, A2 assumed, not measured on this robot" in text


def test_every_place_has_the_numbers_of_its_target():
    result = fabricated.result(50)
    at = _read(result).columns()
    assert at["source_line"].tolist() == result.source_line.tolist()
    assert at["output_line"].tolist() == result.output_line.tolist()
    for name, exact in (
        ("before", result.before * 1e3),
        ("after", result.after * 1e3),
        ("bZ", result.deviation_before[:, 2] * 1e3),
        ("cZ", result.printed[:, 2] - result.nominal[:, 2, 3] * 1e3),
        ("X", result.nominal[:, 0, 3] * 1e3),
        ("Fz", result.wrench[:, 2]),
        ("A2", np.degrees(result.q[:, 1])),
    ):
        np.testing.assert_allclose(at[name], exact, rtol=2e-7, atol=1e-6, err_msg=name)


def test_axes_of_the_feed_lie_along_across_and_normal():
    base = fabricated.result(30)
    off = np.tile([1e-4, 2e-4, -3e-4], (30, 1))
    at = _read(fabricated.with_changes(base, deviation_before=off)).columns()
    way = np.diff(base.nominal[:, :3, 3], axis=0)
    for row in (5, 22, 25):  # to +X, to −X: the tool points down, so that the spindle is along +Z
        sign = np.sign(way[row - 1, 0])
        assert at["b_along"][row] == pytest.approx(0.1 * sign)
        assert at["b_across"][row] == pytest.approx(0.2 * sign)
        assert at["b_normal"][row] == pytest.approx(-0.3)


def test_axes_of_the_feed_are_known_on_steps_shorter_than_a_millimetre():
    """Every step of a finishing program is short; the axes are those of the same path at a thousandth of its size."""
    base = fabricated.result(30)
    off = np.tile([1e-4, 2e-4, -3e-4], (30, 1))
    small = base.nominal[:].copy()
    small[:, :3, 3] *= 1e-3
    large, little = (
        _read(fabricated.with_changes(base, deviation_before=off, nominal=nominal)).columns()
        for nominal in (base.nominal, Poses.of(small))
    )
    for name in ("b_along", "b_across", "b_normal"):
        np.testing.assert_allclose(little[name][[5, 22, 25]], large[name][[5, 22, 25]], rtol=1e-6)


def test_all_reversals_with_lost_motion_are_marked_and_no_others():
    base = fabricated.result(30)
    row = np.arange(1, 29)
    step = np.where(row % 4 == 0, 0.0, 1e-5 * row)
    turned = Reversals(row=row, previous_row=row - 1, joint=row % 6, step=step)
    marks = _read(replace(base, reversals=turned)).facts["reversals"]
    assert marks == [[int(k), f"A{k % 6 + 1}"] for k in row[step > 0.0]]
    without = replace(base, reversals=replace(turned, step=np.zeros(28)))
    assert _read(without).facts["reversals"] == []


def test_length_and_time_run_along_the_path():
    result = fabricated.result(30)
    at = _read(result).columns()
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(result.nominal[:, :3, 3], axis=0), axis=1))])
    np.testing.assert_allclose(at["length"], length * 1e3, rtol=1e-6)
    np.testing.assert_allclose(at["time"], length / 0.02, rtol=1e-6)


def test_a_turn_at_the_stated_speed_takes_its_time():
    """2° about z of the tool at 10 °/s are 0.2 s on each piece; where the way at 20 mm/s takes longer, it counts."""
    base = fabricated.result(30)
    turned = base.nominal[:].copy()
    turned[:, :3, :3] = turned[:, :3, :3] @ rotation_from_vector(np.radians(2.0) * np.arange(30)[:, None] * [0, 0, 1.0])
    length = np.linalg.norm(np.diff(base.nominal[:, :3, 3], axis=0), axis=1)
    count = len(base.program.motions)
    for limit, seconds in ((10.0, np.maximum(0.2, length / 0.02)), (1e4, length / 0.02)):
        speeds = Runs.of(np.tile([np.radians(limit), np.inf, np.inf], (count, 1)))
        result = fabricated.with_changes(
            base, nominal=Poses.of(turned), program=replace(base.program, turn_speeds=speeds)
        )
        at = _read(result).columns()
        np.testing.assert_allclose(np.diff(at["time"]), seconds, rtol=1e-5)
        is_moved = length > 0.0
        np.testing.assert_allclose(at["speed"][1:][is_moved], 1e3 * (length / seconds)[is_moved], rtol=1e-5)


@pytest.mark.parametrize("worst", [31_234, 199_999, 1])
def test_thinning_never_hides_the_worst_and_bounds_the_size(worst):
    base = fabricated.result(200_000)
    noise = np.abs(1.0 + 0.5 * np.random.default_rng(1).standard_normal(200_000))
    before, after = np.minimum(base.before * noise, 4e-3), np.where(base.rapid, 0.0, 2e-7 * noise)
    before[worst], after[worst + (worst == 1) - 1] = 5e-3, 5e-6
    result = fabricated.with_changes(base, before=before, after=after)
    content = b"".join(page(result, 1e-5))
    assert len(content) < 20_000_000
    read = read_page(content)
    at = read.columns()
    assert len(at["before"]) <= places.MAX_PLACES
    assert at["before"].max() == np.float32(5.0)
    assert at["source_line"][at["before"].argmax()] == result.source_line[worst]
    assert at["after"].max() == np.float32(5e-3)
    assert read.facts["worst"]["before"] == at["before"].argmax()
    assert sum(read.facts["histograms"]["before"]["percent"]) == pytest.approx(100.0)
    assert len(read.columns("drawn")["x"]) <= 2 * places.MAX_PLACES


@pytest.mark.parametrize("measure", ["before", "after", "printed", "wrench", "bound"])
def test_thinning_keeps_the_target_with_the_largest_value_of_each_measure(monkeypatch, measure):
    monkeypatch.setattr(places, "MAX_PLACES", 30)
    base = fabricated.with_changes(fabricated.result(200), bound=np.full(200, 1e-5))
    values = np.array(getattr(base, measure)[:])
    values[57] += {"printed": 9.0, "wrench": 900.0}.get(measure, 9e-3)  # mm, N, m
    result = fabricated.with_changes(base, **{measure: Runs.of(values) if measure == "wrench" else values})
    rows = places.page_rows(result, np.array([111]))
    assert len(rows) <= 30
    assert {0, 57, 111, 199} <= set(rows.tolist())


def test_the_deflection_of_holder_spindle_and_tool_is_stated_if_they_are_not_rigid():
    base = fabricated.result(30)
    text = "Deflection of holder, spindle and tool, up to"
    assert text not in _read(base).text()
    by_tool = fabricated.down(np.where(np.arange(30) == 7, 0.1234e-3, 1e-6))
    assert f"{text} 0.123 mm" in _read(replace(base, deflection_by_tool=by_tool)).text()


def test_a_page_does_not_depend_on_where_the_chunks_end(monkeypatch):
    result = fabricated.result(50)
    monkeypatch.setattr(places, "MAX_PLACES", 20)
    whole = b"".join(page(result, 1e-5))
    monkeypatch.setattr("postproc.chunks.ROWS", 7)
    assert b"".join(page(result, 1e-5)) == whole


def test_the_worst_lines_are_listed_once_each_the_worst_first():
    result = fabricated.result(300)
    rows = [row for row in _read(result).rows if row["in"] == "worst"]
    lines = [int(row["data-source-line"]) for row in rows]
    assert len(set(lines)) == len(lines) >= 12
    assert lines[0] == result.source_line[np.argmax(result.before)]
    at = _read(result).columns()
    assert [at["source_line"][int(row["data-place"])] for row in rows] == lines


def test_values_of_the_model_are_told_with_their_sources_assumed_ones_flagged():
    text = _read(fabricated.result()).text("model")
    assert "compliance A2 0.302 µrad/(N·m) (σ 25 %) assumed" in text
    assert "compliance A1 0.623 µrad/(N·m) (σ 40 %) stated" in text


def test_joint_near_its_limit_is_marked_and_doubtful():
    near = fabricated.with_changes(fabricated.result(), joint_margin=np.radians([100.0, 3.2, 50, 50, 50, 50]))
    assert b'<span class="warning">3.2</span>' in b"".join(page(near))
    assert "A2 comes within 3.2° of a limit" in _read(near).text("verdict")


def test_two_bases_are_shown_in_the_robot_root():
    base = fabricated.result(10)
    two = replace(base.program, bases=np.stack([np.eye(4), np.eye(4)]))
    assert _read(fabricated.with_changes(base, program=two)).facts["frame"] == "robot root"


def test_arcs_are_drawn_as_arcs_and_counted_by_their_length():
    base = fabricated.result(3)
    end = base.nominal[:]
    end[0, :3, 3], end[1, :3, 3], end[2, :3, 3] = [0.01, 0, 0], [-0.01, 0, 0.002], [0.01, 0, 0.004]
    motions = replace(
        base.program.motions,
        kind=np.array([0, CIRC, CIRC]),
        centre=np.zeros((3, 3)),
        normal=np.tile([0.0, 0.0, 1.0], (3, 1)),
        sweep=np.array([np.nan, np.pi, np.pi]),
    )
    result = fabricated.with_changes(base, nominal=Poses.of(end), program=replace(base.program, motions=motions))
    position, row = drawn_path(result)
    assert np.hypot(position[:, 0], position[:, 1]) == pytest.approx(0.01)
    assert np.all(np.diff(position[:, 2]) > 0.0)
    assert position[np.flatnonzero(np.diff(row, append=3))] == pytest.approx(end[:, :3, 3])
    length = np.linalg.norm(np.diff(position, axis=0), axis=1).sum()
    assert length == pytest.approx(2.0 * np.hypot(np.pi * 0.01, 0.002), rel=2e-3)
    read = _read(result)
    assert read.columns()["length"][-1] == pytest.approx(length * 1e3)
    assert len(read.columns("drawn")["x"]) == len(position)


def test_no_noise_is_plotted_where_there_was_nothing_to_correct():
    noise = np.random.default_rng(1).uniform(0.0, 1e-13, 100)
    quiet = fabricated.with_changes(fabricated.result(), before=noise, after=noise, wrench=np.zeros((100, 6)))
    read = _read(quiet)
    assert "Nothing to correct" in read.text("numbers")
    assert not {"view3d", "along", "histogram", "worst"} & set(read.ids)


def test_operations_begin_at_comments_and_at_changes_of_the_tool():
    base = fabricated.result(100)
    events = (
        Event(0, "comment", 1, text="FACING"),
        Event(30, "tool_change", 32, value=4.0),
        Event(30, "comment", 32, text="POCKET"),
        Event(60, "comment", 62, text="FINISH"),
        Event(100, "comment", 102, text="END"),
    )
    result = fabricated.with_changes(base, program=replace(base.program, events=events))
    found = operations(result)
    assert [(each.name, each.tool, each.first, each.last) for each in found] == [
        ("FACING", 0, 0, 29),  # no tool is named yet
        ("POCKET", 4, 30, 59),
        ("FINISH", 4, 60, 99),
    ]
    assert sum(each.cutting for each in found) == np.count_nonzero(~result.rapid)
    assert max(each.before.largest for each in found) == pytest.approx(1.5e-3, rel=1e-3)
    assert "POCKET T4" in _read(result).text("operations")


def test_an_issue_is_told_with_all_its_lines():
    issue = Issue("warning", "no-force", "no force", 3, count=7, lines=(3, 4, 5, 9, 20, 21, 22))
    text = _read(fabricated.with_changes(fabricated.result(), issues=(issue,))).text("issues")
    assert "warning no force 3–5, 9, 20–22 7" in text


_MOVES_TO_HOME = """%
(ROUGH)
G91 G28 Z0
G90
T1 M6
G0 X60 Y50 Z50
G1 Z1 F600
X70
G0 Z50
(FINISH)
G91 G28 Z0
G90
T2 M6
G0 X60 Y50 Z5
G1 Z0 F600
X70
T3 M6
G1 X60
G0 Z50
M30
"""


@pytest.mark.parametrize("machine", ["clearance_Z = 200.0", "home = [0, -90, 90, 0, 30, 0]"])
def test_a_comment_before_a_move_to_home_and_a_tool_change_names_what_is_cut_with_that_tool(tmp_path, machine):
    """The third operation has no comment of its own: it is called by its tool."""
    (tmp_path / "cell.toml").write_text(f"{CELL_TEXT}\n[machine]\n{machine}\n", encoding="utf-8")
    setup = cell.load(tmp_path / "cell.toml")
    program = read([Document("part.nc", _MOVES_TO_HOME)], ROBOT, setup, "part", "gcode")
    cutting = np.flatnonzero(~program.motions.rapid)
    starts = operation_starts(program, np.arange(len(program.motions)))
    last = np.array(sorted(starts))[np.searchsorted(sorted(starts), cutting, side="right") - 1]
    assert [starts[row] for row in last.tolist()] == [("ROUGH", 1)] * 2 + [("FINISH", 2)] * 2 + [("T3", 3)]


def test_of_many_targets_every_row_of_a_table_leads_to_its_own_line():
    """Thinning keeps what tables name: worst places close to each other, operations, issues."""
    base = fabricated.result(50_000)
    before = base.before.copy()
    before[20_000:20_024] = np.linspace(5e-3, 4e-3, 24)
    events = tuple(Event(row, "comment", row + 3, text=f"POCKET {row}") for row in (0, 12_347, 33_331))
    issues = tuple(Issue("warning", "near", "look here", row + 3) for row in (7, 20_011, 41_113, 49_998))
    program = replace(base.program, events=events)
    read = _read(fabricated.with_changes(base, before=before, program=program, issues=issues))
    line = read.columns()["source_line"]
    rows = [row for row in read.rows if row["data-place"] is not None]
    assert {row["in"] for row in rows} >= {"worst", "operations", "issues"}
    assert len(line) < 50_000
    for row in rows:
        wanted = int(row["data-source-line"])
        found = line[int(row["data-place"])]
        assert found == wanted or (row["in"] == "operations" and abs(found - wanted) <= 1)  # it may begin with a rapid


def test_bars_of_the_histogram_are_shares_of_the_path():
    base = fabricated.result()
    off = np.arange(100) == 60
    changes = {"before": np.where(off, 2e-3, 1e-3), "cut_length": np.where(off, 0.95, base.cut_length)}
    bars = read_page(b"".join(page(fabricated.with_changes(base, **changes), 1e-5))).facts["histograms"]["before"]
    assert bars["percent"][-1] == pytest.approx(50.0)
    assert bars["percent"][30] == pytest.approx(50.0)  # 1 mm begins the 31st of 60 bars up to 2 mm
