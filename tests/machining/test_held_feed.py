"""`[output] feed = "hold"`: feeds as high as the tolerance of the part allows.

The brute force shares nothing with the search: it converts the program again and again with other F words in its text,
and takes the highest of them for each move.
"""

from __future__ import annotations

import json
import re
from itertools import groupby

import numpy as np
import pytest
from msgspec import Struct
from msgspec.structs import replace

from postproc import correction
from postproc.cell import Part
from postproc.errors import InputError, PostprocError, ProgramError
from postproc.jobs import conversion, process_forces
from postproc.report.feed import feed_sentences, feed_summary
from tests.commands import run
from tests.machining.setting import CELL, ROBOT, gcode, process, read, tool
from tests.places import SAMPLES

BOX = ((0, 200), (-40, 60), (-20, 0))
MOVES = ("X100 Y10", "X180", "Y30", "X215")
PROGRAMMED, LEAST = 2400.0, 300.0
KIENZLE = "kc11_N_per_mm2 = 900\nmc = 0.27\naxial_ratio = 0.2\nsigma_percent = 20"


def text(feed=PROGRAMMED):
    return gcode("G0 X-15 Y3 Z5", f"G1 Z-6 F{PROGRAMMED:g}", f"X60 F{feed:.3f}", *MOVES, "G0 Z5")


def cell(tolerance, least=LEAST, unheld="program"):
    output = replace(CELL.output, feed="hold", min_feed_mm_per_min=least, unheld=unheld)
    return replace(CELL, part=Part(tolerance_mm=tolerance), output=output)


def hold_feed(folder, program, given, material='name = "al_7075_t6_carbide"', more=""):
    (folder / "process.toml").write_text(process(tool(16, 3) + more, BOX, 1.0, material))
    source = process_forces.read(folder / "process.toml", given)
    return process_forces.convert_with_held_feed(program, ROBOT, given, source, linearize_arcs=False, to=None)


def expected(result):
    """Largest expected error of each motion [mm], as the result states it at its targets."""
    out = np.zeros(len(result.program.motions))
    np.maximum.at(out, result.motion, np.where(result.rapid, 0.0, result.expected))
    return out * 1e3


@pytest.mark.parametrize(
    ("tolerance", "material"),
    [(0.6, 'name = "al_7075_t6_carbide"'), (0.6, KIENZLE), (0.42, 'name = "al_7075_t6_carbide"')],
)
def test_brute_force_over_feeds_finds_the_same_time(tmp_path, tolerance, material):
    """With exact stops: the rounding of a corner depends on the feeds of both moves."""
    given = cell(tolerance)
    given = replace(given, gcode=replace(given.gcode, approximation_mm=0.0))
    program = read(tmp_path, text(), cell=given)
    result = hold_feed(tmp_path, program, given, material)
    feeds = np.geomspace(PROGRAMMED, LEAST, 9)
    errors = []
    for feed in feeds:
        tried = read(tmp_path, text(feed), cell=given)
        source = process_forces.read(tmp_path / "process.toml", given)
        errors.append(expected(correction.process(tried, ROBOT, given, source)))
    errors = np.array(errors)
    cutting = np.flatnonzero((errors > 0.05).all(axis=0))
    assert len(cutting) == 5
    best = []
    for motion in cutting:
        own = errors[:, motion]
        # errors are nearly linear in the feed
        best.append(np.interp(-tolerance, -own, feeds) if own[-1] <= tolerance else PROGRAMMED)
    held = result.held_feed
    times = [float(np.sum(held.length[cutting] / np.asarray(f))) for f in (best, held.feed[cutting] * 60e3)]
    assert times[1] == pytest.approx(times[0], rel=0.02)
    np.testing.assert_allclose(held.feed[cutting] * 60e3, best, rtol=0.03)
    np.testing.assert_allclose(held.expected[cutting] * 1e3, expected(result)[cutting], rtol=0, atol=1e-9)
    # between the bound with the rounding of corners, and that with the largest distance of the path everywhere
    left_mm = 1e3 * np.linalg.norm(result.deviation_after, axis=1).max()
    assert left_mm < 1e-3
    least = result.bound + np.maximum(result.rounding - result.programmed_rounding, 0.0)
    cuts = ~result.rapid
    assert (result.expected[cuts] >= least[cuts] - 1e-12).all()
    assert (result.expected[cuts] <= (least + result.path_deviation)[cuts] + 1e-12).all()


def test_with_blended_corners_no_feeds_that_hold_the_tolerance_are_faster(tmp_path):
    """Blending couples the feeds of neighbours: where one move is much slower than the next, the corner between them is
    rounded by more. So the feed at which all moves together hold the tolerance is no limit for a move between others,
    and the brute force varies each feed among the others as they are."""
    given = cell(0.6)
    held = hold_feed(tmp_path, read(tmp_path, text(), cell=given), given, KIENZLE).held_feed
    source = process_forces.read(tmp_path / "process.toml", given)
    cuts = np.flatnonzero(held.is_lowered)
    length, found = held.length[cuts], held.feed[cuts] * 60e3
    assert len(cuts) == 5

    def holds(feeds):
        blocks = [f"{block} F{feed:.3f}" for block, feed in zip(("X60", *MOVES), feeds, strict=True)]
        tried = gcode("G0 X-15 Y3 Z5", f"G1 Z-6 F{PROGRAMMED:g}", *blocks, "G0 Z5")
        return (expected(correction.process(read(tmp_path, tried, cell=given), ROBOT, given, source)) <= 0.6).all()

    assert holds(found)
    for first in range(4):
        for change in ((1.02, 1.0), (1.0, 1.02), (1.02, 1.02), (1.06, 0.97), (0.97, 1.06)):
            feeds = found.copy()
            feeds[first : first + 2] *= change
            assert not holds(feeds) or length @ (1 / feeds) > 0.98 * length @ (1 / found)
    feeds = np.full(5, LEAST)  # from below, one move after the other as fast as the others let it
    for move in (2, 1, 3, 0, 4):
        low, high = LEAST, PROGRAMMED
        while high > 1.02 * low:
            feeds[move] = np.sqrt(low * high)
            low, high = (feeds[move], high) if holds(feeds) else (low, feeds[move])
        feeds[move] = low
    assert length @ (1 / found) < 1.02 * length @ (1 / feeds)


def test_the_written_feeds_are_the_lowered_ones_and_hold_the_tolerance(tmp_path):
    given = cell(0.6)
    result = hold_feed(tmp_path, read(tmp_path, text(), cell=given), given)
    held = result.held_feed
    assert held.is_lowered.sum() == 5
    assert not held.is_exceeded.any()
    assert (expected(result) <= 0.6).all()
    cutting = np.flatnonzero(held.is_lowered)
    written = [float(value) for value in re.findall(r"^\$VEL\.CP=([\d.]+)", result.documents[0].text, re.MULTILINE)]
    np.testing.assert_allclose(written[1:-1] if written[0] > 0.03 else written, held.feed[cutting], atol=1e-9)


def test_a_comparison_takes_the_forces_of_the_feeds_that_are_written(tmp_path):
    """With those of the programmed feeds a good program left the path by 0.05 mm and had targets beside it."""
    lines = SAMPLES.joinpath("cell_kr270.toml").read_text(encoding="utf-8").partition("[collision]")[0]
    lines = lines.replace("[output]", '[output]\nfeed = "hold"')
    (tmp_path / "cell.toml").write_text(f"{lines}\n[part]\ntolerance_mm = 0.3\n", encoding="utf-8")
    (tmp_path / "process.toml").write_text(process(tool(12, 3), ((0, 100), (0, 60), (-20, 0)), 1.0))
    (tmp_path / "part.nc").write_text(gcode("G0 X-10 Y30 Z20", "G0 Z-2", "G1 X110 F2400", "G0 Z20"))
    forces = ("--cell", tmp_path / "cell.toml", "-o", tmp_path / "out")
    run("convert", tmp_path / "part.nc", "--process", tmp_path / "process.toml", *forces)
    report = json.loads((tmp_path / "out" / "part.report.json").read_text(encoding="utf-8"))
    assert report["feed"]["lowered_moves"] >= 1
    written = tmp_path / "out" / "part.src"
    said = run("compare", tmp_path / "part.nc", written, "--forces", tmp_path / "process.toml", *forces).output
    assert "They belong together." in said
    compared = json.loads((tmp_path / "out" / "part.compare.report.json").read_text(encoding="utf-8"))
    assert compared["differences"]["speed"] == report["feed"]["lowered_moves"]
    (lowered,) = (issue for issue in compared["issues"] if issue["kind"] == "speed")
    assert lowered["level"] == "info"
    feed = min(float(value) for value in re.findall(r"^\$VEL\.CP=([\d.]+)", written.read_text(), re.MULTILINE))
    message = f"the conversion has lowered the feed: {1e3 * feed:.4g} mm/s instead of 40 mm/s"
    assert message in lowered["message"]
    assert message in said
    rows = (tmp_path / "out" / "part.compare.pairs.csv").read_text(encoding="utf-8").splitlines()
    column = rows[0].split(",").index("speed_nominal_mm_per_s")
    assert "40.000" in {row.split(",")[column] for row in rows}


def test_without_need_nothing_is_lowered_and_nothing_is_tried(tmp_path):
    given = cell(50.0)
    program = read(tmp_path, text(), cell=given)
    tried = []

    def trial(changed):
        tried.append(changed)
        return correction.process(changed, ROBOT, given, None)

    result = process_forces.hold_tolerance(
        program, np.ones(len(program.motions)), program.motions.feed, given, 0.0, trial
    )
    assert tried == [program]
    np.testing.assert_array_equal(result.held_feed.feed, program.motions.feed)


@pytest.mark.parametrize("unheld", ["program", "lowest"])
def test_a_move_that_no_feed_holds_keeps_its_feed_or_gets_the_least_and_is_named(tmp_path, unheld):
    given = cell(0.2, least=900.0, unheld=unheld)
    result = hold_feed(tmp_path, read(tmp_path, text(), cell=given), given)
    held = result.held_feed
    cutting = np.flatnonzero(np.isfinite(held.without_feed))
    assert len(cutting) == 5
    assert held.is_exceeded[cutting].all()
    np.testing.assert_allclose(held.feed[cutting] * 60e3, PROGRAMMED if unheld == "program" else 900.0)
    lines = result.program.motions.line[cutting]
    summary = feed_summary(result)
    assert {move.source_line for move in summary.missed} >= set(lines.tolist())
    words = {"program": "such moves keep the feed of the program", "lowest": "such moves get the lowest feed"}
    assert any(words[unheld] in sentence for sentence in feed_sentences(summary))
    least = replace(given, output=replace(given.output, feed="program"))
    errors = []
    for feed in (900.0, 60.0, 30.0):
        source = process_forces.read(tmp_path / "process.toml", least)
        errors.append(
            expected(correction.process(read(tmp_path, text(feed), cell=least), ROBOT, least, source))[cutting]
        )
    if unheld == "lowest":
        np.testing.assert_allclose(held.expected[cutting] * 1e3, errors[0], rtol=0.01)
    # without feed only edge forces act: the limit of slow feeds
    np.testing.assert_allclose(held.without_feed[cutting] * 1e3, 2.0 * errors[2] - errors[1], rtol=0.005)


class Fake(Struct):
    """A result whose errors are formulas."""

    program: object
    motion: object
    expected: object
    failed: bool = False
    held_feed: object = None


@pytest.mark.parametrize("seed", range(12))
def test_each_feed_is_that_of_bisection(tmp_path, seed):
    """Errors that bend upwards or downwards with the feed, by laws that the search does not know."""
    given = cell(0.1)
    program = read(tmp_path, text(), cell=given)
    count = len(program.motions)
    rng = np.random.default_rng(seed)
    steady, slope = rng.uniform(0.005, 0.09, count), 10 ** rng.uniform(-1.3, 0.3, count)
    power = rng.choice([0.6, 0.73, 1.0, 1.5, 2.0, 3.0], count)

    def error(feed):
        share = np.nan_to_num(feed) * 60e3 / PROGRAMMED
        return 1e-3 * np.hypot(steady, slope * share**power)

    def trial(changed):
        return Fake(changed, np.arange(count), np.where(changed.motions.rapid, 0.0, error(changed.motions.feed)))

    held = process_forces.hold_tolerance(program, np.ones(count), program.motions.feed, given, 0.0, trial).held_feed
    low, high = np.full(count, LEAST / 60e3), program.motions.feed.copy()
    for _ in range(60):
        middle = 0.5 * (low + high)
        inside = error(middle) <= 1e-4
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    unheld = error(np.full(count, LEAST / 60e3)) > 1e-4
    best = np.where((error(program.motions.feed) <= 1e-4) | unheld, program.motions.feed, low)
    cuts = np.flatnonzero(~program.motions.rapid)
    assert (held.feed[cuts] <= best[cuts] * (1 + 1e-9)).all()
    np.testing.assert_allclose(held.feed[cuts], best[cuts], rtol=0.01)  # `_LARGEST_RESERVE_SHARE`


def test_a_motion_that_its_turn_slows_is_lowered_from_the_speed_of_its_tip(tmp_path):
    """Its error is that of the tip at any higher feed; where that holds the tolerance, the feed stays."""
    given = cell(0.1)
    program = read(tmp_path, text(), cell=given)
    count = len(program.motions)
    cuts = np.flatnonzero(~program.motions.rapid)
    tip_speed = program.motions.feed.copy()
    tip_speed[cuts] *= np.linspace(0.2, 1.0, len(cuts))
    limit = 0.5 * PROGRAMMED / 60e3  # the feed whose error is the tolerance [m/s]

    def trial(changed):
        error = 1e-4 * np.minimum(changed.motions.feed, tip_speed) / limit
        return Fake(changed, np.arange(count), np.where(changed.motions.rapid, 0.0, error))

    held = process_forces.hold_tolerance(program, np.ones(count), tip_speed, given, 0.0, trial).held_feed
    is_within = tip_speed[cuts] <= limit
    assert is_within.any()
    assert not is_within.all()
    np.testing.assert_array_equal(held.feed[cuts[is_within]], program.motions.feed[cuts[is_within]])
    np.testing.assert_allclose(held.feed[cuts[~is_within]], limit, rtol=0.01)  # `_LARGEST_RESERVE_SHARE`


def test_a_feed_below_the_least_stays_as_it_is(tmp_path):
    given = cell(0.2, least=3000.0)
    program = read(tmp_path, text(), cell=given)
    held = hold_feed(tmp_path, program, given).held_feed
    np.testing.assert_array_equal(held.feed, program.motions.feed)
    assert held.is_exceeded.any()


def krl(folder, *lines):
    body = [
        "DEF part( )", "BAS (#INITMOV,0 )", "$VEL.CP=0.3", "$APO.CDIS=0.5", "PTP {X -15,Y 3,Z 5,A 180,B 0,C 180}",
        "$VEL.CP=0.04", "LIN {X -15,Y 3,Z -6}", *lines, "LIN {X 215,Y 30,Z -6}",
        "$VEL.CP=0.3", "LIN {X 215,Y 30,Z 30}", "END", "",
    ]  # fmt: skip
    return read(folder, "\r\n".join(body), "part.src")


CUTS = (
    "LIN {X 60,Y 3,Z -6} C_DIS",
    "LIN {X 100,Y 10,Z -6} C_DIS",
    "; a remark",
    "LIN {X 180,Y 10,Z -6}",
    "LIN {X 180,Y 30,Z -6}",
)
SPINDLE = "rpm = 6000\n"


def test_krl_keeps_its_text_and_gets_the_feeds_between_its_lines(tmp_path):
    given = cell(0.7)
    program = krl(tmp_path, *CUTS)
    result = hold_feed(tmp_path, program, given, more=SPINDLE)
    assert not result.failed, result.issues
    held = result.held_feed
    assert held.is_lowered.sum() == 5
    lines = result.documents[0].text.splitlines()
    kept = [line for line in lines if not line.startswith(("LIN", "$VEL"))]
    assert kept == [line for line in program.documents[0].text.splitlines() if not line.startswith(("LIN", "$VEL"))]
    (tmp_path / "again.src").write_text(result.documents[0].text.replace("part(", "again("))
    again = read(tmp_path, (tmp_path / "again.src").read_text(), "again.src").motions
    in_order = [feed for feed, _ in groupby(np.nan_to_num(again.feed).tolist())]
    np.testing.assert_allclose(in_order, [feed for feed, _ in groupby(np.nan_to_num(held.feed).tolist())], atol=1e-9)


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        (("FOR I=1 TO 2", "LIN {X 60,Y 3,Z -6}", "LIN {X -15,Y 3,Z -6}", "ENDFOR", *CUTS), "loops, branches or calls"),
        (("SPLINE", "SLIN {X 60,Y 3,Z -6}", "SLIN {X 180,Y 10,Z -6}", "ENDSPLINE"), "spline block"),
        (("SLIN {X 60,Y 3,Z -6} WITH $VEL.CP=0.03", *CUTS), "sets its speed itself"),
    ],
)
def test_krl_whose_feeds_cannot_be_changed_is_refused_with_the_reason(tmp_path, lines, why):
    with pytest.raises(ProgramError, match=why):
        hold_feed(tmp_path, krl(tmp_path, *lines), cell(0.3), more=SPINDLE)


def test_what_it_needs_is_named():
    with pytest.raises(InputError, match="without a tolerance of the part"):
        conversion.check_held_feed(CELL, process=True)
    with pytest.raises(InputError, match="without a process"):
        conversion.check_held_feed(cell(0.1), process=False)


def test_forces_by_operation_do_not_say_what_a_feed_changes(tmp_path):
    (tmp_path / "process.toml").write_text("[operations.T1]\nFx = 10.0\n")
    source = process_forces.read(tmp_path / "process.toml", CELL)
    with pytest.raises(PostprocError, match="without \\[material\\]"):
        process_forces.convert_with_held_feed(
            read(tmp_path, text()), ROBOT, cell(0.1), source, linearize_arcs=False, to=None
        )


def test_times_by_operation_are_on_the_terminal_in_json_and_on_the_page(tmp_path):
    more = '\n[part]\ntolerance_mm = 0.35\n[output]\nfeed = "hold"\nunheld = "lowest"\nmin_feed_mm_per_min = 400\n'
    stated = (SAMPLES / "cell_kr270.toml").read_text()
    (tmp_path / "cell.toml").write_text(re.sub(r"\n\[output\]\n", more, stated))
    (tmp_path / "process.toml").write_text(process(tool(16, 3), BOX, 1.0))
    program = text().replace("G0 X-15", "(Slot)\nG0 X-15", 1).replace("X180", "G0 Z5\n(Rim)\nG1 Z-6\nX180", 1)
    (tmp_path / "part.nc").write_text(program)
    given = ["--cell", str(tmp_path / "cell.toml"), "--process", str(tmp_path / "process.toml")]
    made = run("convert", tmp_path / "part.nc", *given, "-o", tmp_path / "out", code=3)
    feed = json.loads((tmp_path / "out" / "part.report.json").read_text())["feed"]
    assert [each["name"] for each in feed["operations"]] == ["Slot", "Rim"]
    for key in ("time_before_s", "time_after_s"):
        assert sum(each[key] for each in feed["operations"]) == pytest.approx(feed[key])
    slot = (11 + 75 + np.hypot(40, 7)) / PROGRAMMED * 60
    assert feed["operations"][0]["time_before_s"] == pytest.approx(slot, rel=1e-6)
    assert feed["time_after_s"] > 1.5 * feed["time_before_s"]
    assert feed["missed_moves"] == len(feed["missed"]) > 0
    for move in feed["missed"]:
        assert move["expected_mm"] > 0.35
        assert 0.0 < move["edge_forces_mm"] < move["expected_mm"]
    page = (tmp_path / "out" / "part.report.html").read_text()
    for shown in (made.output, page):
        assert "moves do not hold 0.35 mm" in shown
        assert "by edge forces at any feed" in shown
        assert "Rim" in shown
