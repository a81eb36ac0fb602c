"""The place of the part in words, as JSON, CSV and page, from places that are stated here."""

from __future__ import annotations

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.cell import Frame
from postproc.placement.region import Assessment, JudgedPlace, Region, Search
from postproc.report import placement
from tests.html_page import read_page

CELL = SimpleNamespace(robot="kuka_kr270", base=Frame(X=1.0, Y=2.0, Z=3.0, A=4.0, B=0.0, C=-90.0))
REGION = Region((0.0, -100.0, 700.0, -10.0, 0.0), (200.0, 100.0, 700.0, 10.0, 0.0))
TODAY = JudgedPlace((100.0, 20.0, 700.0, 5.0, 0.0), 0, 0.5e-3, 0.25e-3, float(np.radians(30.0)), 0.123456789)
BEST = JudgedPlace((150.0, -10.0, 700.0, 5.04, 0.0), 0, 0.25e-3, 0.125e-3, float(np.radians(40.0)), 0.25)


def search_of(today=TODAY, best=BEST, **changes):
    values = {"trials": (today,), "slice": ((), ()), "slice_place": today.place, "refusals": ()}
    return Search(today, best, **(values | changes))


def summary_of(search, clearance_mm=None, start=None, moved_frames=()):
    return placement.summary(
        search, CELL, ["a.nc", "b.nc"], REGION, margin_deg=5.0, clearance_mm=clearance_mm, start=start,
        moved_frames=list(moved_frames),
    )  # fmt: skip


def sentence_of(today=TODAY, best=BEST, **changes):
    return summary_of(search_of(today, best, **changes)).sentence


def test_the_advice_is_to_move_the_part_by_what_the_places_differ():
    """Without a model's uncertainty the deflection counts; less than a hundredth is no gain, 0.05 mm no move."""
    assert sentence_of() == (
        "Moving the part by X +50 mm, Y -30 mm lowers the expected error (95 %) from up to 0.25 to up to 0.12 mm."
    )
    turned = replace(BEST, place=(100.0, 20.0, 700.2, -10.0, 250.0))
    assert "by Z +0.2 mm, A -15°, E1 +250 mm lowers" in sentence_of(best=turned)
    uncertain = [replace(place, u95=np.nan) for place in (TODAY, BEST)]
    assert sentence_of(*uncertain).endswith("lowers the deflection from up to 0.50 to up to 0.25 mm.")
    converted = [
        replace(TODAY, assessment=Assessment(0.6e-3, 0.4e-3, 0.3e-3, 0.9)),
        replace(BEST, assessment=Assessment(0.6e-3, 0.4e-3, 0.2e-3, 0.9)),
    ]
    assert sentence_of(*converted).endswith("from up to 0.30 to up to 0.20 mm.")
    as_good = "Today's place is as good as any in the region: the expected error (95 %) is up to 0.25 mm."
    assert sentence_of(best=replace(BEST, u95=0.2476e-3)) == as_good
    assert sentence_of(best=replace(BEST, u95=0.2474e-3)) != as_good
    assert sentence_of(best=replace(BEST, place=(100.04, 20.0, 700.0, 5.0, 0.0))) == as_good
    assert sentence_of(best=replace(BEST, place=(100.06, 20.0, 700.0, 5.0, 0.0))) != as_good


def test_a_place_of_today_that_cannot_be_driven_is_left():
    refused = replace(TODAY, reason=2, deflection=np.nan, u95=np.nan)
    start = "Today's place cannot be driven (joint limit): "
    move = f"{start}move the part by X +50 mm, Y -30 mm"
    assert sentence_of(refused) == f"{move}; the expected error (95 %) is then up to 0.12 mm."
    assert sentence_of(refused, replace(BEST, u95=0.0)) == (
        f"{move}. No cutting move carries a force, so the error is not compared: give --forces or --process."
    )
    same = replace(BEST, place=TODAY.place, turn=0.5)
    assert sentence_of(refused, same).startswith(f"{start}the same place with another turn of the tool can be driven; ")
    unconverted = replace(TODAY, assessment=Assessment(problem="line 12 is out of reach"))
    assert sentence_of(unconverted).startswith("Today's place cannot be driven (line 12 is out of reach): move ")
    assert sentence_of(best=replace(BEST, u95=0.0)).startswith("Today's place can be driven. No cutting move")


def test_without_a_place_the_first_refusal_is_the_reason():
    assert sentence_of(best=None) == "No place in the region can be driven."
    refusals = (
        replace(BEST, place=(150.5, 0.0, 700.0, -15.0, 0.0), assessment=Assessment(problem="line 7: joint limit")),
        replace(BEST, place=(1.0, 0.0, 700.0, 5.0, 250.0), assessment=Assessment(problem="other")),
    )
    text = sentence_of(best=None, refusals=refusals)
    assert text.endswith(": 2 that can be by samples of the path were tried further. "
                         "X 150.5, Y 0, Z 700, A -15°: line 7: joint limit.")  # fmt: skip
    text = sentence_of(best=None, refusals=refusals[1:])
    assert "X 1, Y 0, Z 700, A 5°, E1 250: other." in text


TRIALS = (
    TODAY, BEST, JudgedPlace((0.0, 0.0, 700.0, 0.0, 0.0), 1),
    JudgedPlace((10.0, 0.0, 700.00004, 0.0, 0.5), 5, margin=0.25), JudgedPlace((20.0, 0.0, 700.0, 0.0, 0.0), 5),
)  # fmt: skip
LATER = tuple(replace(BEST, assessment=Assessment(problem=text)) for text in "aabbbcdefff")


def test_the_summary_counts_places_by_reason_and_has_the_units_of_its_names():
    best = replace(BEST, turn=float(np.radians(-30.0)), assessment=Assessment(0.6e-3, 0.4e-3, 0.2e-3, 0.97654321))
    content = summary_of(search_of(best=best, trials=TRIALS, refusals=LATER), clearance_mm=12.5)
    assert (content.tried, content.reachable) == (5, 2)
    assert content.refused == {"out of reach": 1, "collision": 2}
    assert content.refused_later == {"a": 2, "b": 3, "c": 1, "d": 1, "e": 1, "f": 3}
    assert content.region == {"X": [0.0, 200.0], "Y": [-100.0, 100.0], "A": [-10.0, 10.0]}
    entry = json.loads(placement.place_json(content, []))["today"]
    assert entry == {
        "X": 100.0, "Y": 20.0, "Z": 700.0, "A": 5.0, "E1": 0.0, "turn_deg": 0.0, "deflection_mm": 0.5,
        "uncorrected_mm": None, "corrected_mm": None, "chance": None, "min_joint_margin_deg": 30.0,
        "min_singular_value": 0.123457, "reachable": True, "reason": None,
    }  # fmt: skip
    entry = json.loads(placement.place_json(content, []))["best"]
    assert (entry["turn_deg"], entry["deflection_mm"], entry["uncorrected_mm"]) == (-30.0, 0.6, 0.4)
    assert (entry["corrected_mm"], entry["chance"]) == (0.2, 0.976543)


def test_the_table_has_a_row_for_each_place_and_nothing_for_what_is_unknown():
    head, *rows = csv.reader(b"".join(placement.places_csv(search_of(trials=TRIALS))).decode().splitlines())
    assert head == [
        "X", "Y", "Z", "A", "E1", "turn_deg", "deflection_mm", "u95_mm", "min_joint_margin_deg", "min_singular_value",
        "reachable", "reason",
    ]  # fmt: skip
    assert rows == [
        ["100.0", "20.0", "700.0", "5.0", "0.0", "0.0", "0.5", "0.25", "30.0", "0.123457", "1", ""],
        ["150.0", "-10.0", "700.0", "5.04", "0.0", "0.0", "0.25", "0.125", "40.0", "0.25", "1", ""],
        ["0.0", "0.0", "700.0", "0.0", "0.0", "0.0", "", "", "", "", "0", "out of reach"],
        ["10.0", "0.0", "700.0", "0.0", "0.5", "0.0", "", "", "14.324", "", "0", "collision"],
        ["20.0", "0.0", "700.0", "0.0", "0.0", "0.0", "", "", "", "", "0", "collision"],
    ]  # fmt: skip


def test_base_of_the_best_place_keeps_what_the_search_keeps():
    """B and C of the cell; frames by number move too."""
    best = replace(BEST, place=(150.12345, -10.0, 700.0, 5.0, 250.0), turn=float(np.radians(-30.0)))
    search = search_of(best=best)
    content = summary_of(search, moved_frames=["base_data.1"])
    frame = ["X = 150.1234", "Y = -10.0000", "Z = 700.0000", "A = 5.0000", "C = -90.0000"]
    move = "[base_data.1] moves with [base]: give BASE_DATA[1] of the controller these numbers too."
    assert placement.base_toml(search, CELL, content).decode().splitlines() == [
        f"# {content.sentence}",
        "# Seen from E1 = 0; E1 is at 250.0 mm, or this much farther than a KRL program has it.",
        "# With the tool turned by -30° about its axis.", f"# {move}", "[base]", *frame, "[base_data.1]", *frame,
    ]  # fmt: skip
    plain = placement.base_toml(search_of(), CELL, summary_of(search_of())).decode().splitlines()
    assert [line for line in plain if line.startswith("#")] == [f"# {sentence_of()}"]


def test_the_result_in_lines_has_both_places_reasons_and_margins():
    best = replace(
        BEST, place=(150.0, -10.0, 700.0, 5.0, 250.0), turn=float(np.radians(30.0)),
        assessment=Assessment(0.6e-3, 0.4e-3, 0.2e-3, 0.9),
    )  # fmt: skip
    search = search_of(best=best, trials=TRIALS, refusals=LATER)
    later = "refused by the whole path or its conversion: "
    assert placement.as_text(summary_of(search, clearance_mm=12.5, start="The start is chosen.")).splitlines()[1:] == [
        "  today: X 100.0 Y 20.0 Z 700.0 A 5.00: deflection up to 0.50 mm, joint margin 30.0°",
        "  best: X 150.0 Y -10.0 Z 700.0 A 5.00 E1 250.0, tool turned by +30°: uncorrected up to 0.40, corrected up to "
        "0.20 mm (95 %), joint margin 40.0°",
        "  5 places tried, 2 can be driven by samples of the path; 1 out of reach, 2 collision",
        f"  {later}3 (b)", f"  {later}3 (f)", f"  {later}2 (a)", f"  {later}1 (c)",
        f"  {later}2 (other reasons, see place.json)", "  The start is chosen.",
        "  kept: 5° to joint limits, 12.5 mm between bodies of [collision]",
        "  Stock is not among these bodies: convert checks it, with --process.",
    ]  # fmt: skip
    refused = placement.as_text(summary_of(search_of(TRIALS[2], None, refusals=LATER[:6]))).splitlines()
    assert refused[1:3] == ["  today: X 0.0 Y 0.0 Z 700.0 A 0.00: out of reach", "  best: none"]
    assert sum(later in line for line in refused) == 3
    assert refused[-2:] == [
        "  kept: 5° to joint limits", "  Collisions do not count in this choice: the cell has no [collision].",
    ]  # fmt: skip
    four = placement.as_text(summary_of(search_of(refusals=LATER[:7])))
    assert four.count(later) == 4
    assert "other reasons" not in four


X, Y, ANGLES, HEIGHTS = (0.0, 50.0, 100.0), (-40.0, 60.0), (-10.0, 0.0, 10.0), (600.0, 700.0, 800.0)


def trial(place, cost=1.0, **changes):
    """A place that can be driven, or with a cost of None one that is out of reach."""
    if cost is None:
        return JudgedPlace(place, 1)
    return JudgedPlace(place, 0, **({"deflection": 9e-3, "u95": 1e-3 * cost, "margin": 0.5} | changes))


SLICE = [(x, y) for x in X for y in Y]
PLANE = tuple(trial((x, y, 700.0, 0.0, 0.0), 1.0 + k if k else None) for k, (x, y) in enumerate(SLICE))
GRID = tuple(trial((50.0, 60.0, z, a, 0.0), 10.0 * n + m) for n, z in enumerate(HEIGHTS) for m, a in enumerate(ANGLES))
HERE = trial((50.0, 60.0, 700.0, 0.0, 0.0), 4.0)
MAPPED = search_of(
    HERE, replace(HERE, place=(100.0, 60.0, 700.0, 0.0, 0.0)), trials=(HERE, *GRID, *PLANE, trial((7.0,) * 5)),
    slice=(X, Y), slice_place=(50.0, 60.0, 700.0, 0.0, 0.0),
)  # fmt: skip


def plots_of(search):
    return read_page(b"".join(placement.page(search, summary_of(search)))).plots


def test_maps_show_the_expected_error_over_two_axes_and_both_places():
    plane, turn = plots_of(MAPPED)
    grid, today, best = plane["traces"]
    assert (grid["x"], grid["y"]) == (list(X), list(Y))
    # the trials are column by column; a refused place has no error
    assert grid["values"] == [[None, 3.0, 5.0], [2.0, 4.0, 6.0]]
    assert grid["reasons"] == [[1, 0, 0], [0, 0, 0]]
    assert grid["title"] == "expected error (95 %), mm"
    assert (today["x"], today["y"], today["hollow"]) == ([50.0], [60.0], True)
    assert (best["x"], best["y"]) == ([100.0], [60.0])
    assert plane["note"] == "Ring: today's place. Dot: the best place, X 100, Y 60, Z 700, A 0°."
    assert (plane["x"]["title"], plane["y"]["title"]) == ("X, mm", "Y, mm")
    grid, today, best = turn["traces"]
    assert (grid["x"], grid["y"]) == (list(ANGLES), list(HEIGHTS))
    # of two places at the same Z and A the first counts: that of today
    assert grid["values"] == [[0.0, 1.0, 2.0], [10.0, 4.0, 12.0], [20.0, 21.0, 22.0]]
    assert (today["x"], today["y"], best["x"], best["y"]) == ([0.0], [700.0], [0.0], [700.0])
    assert (turn["x"]["title"], turn["y"]["title"]) == ("A, °", "Z, mm")
    text = read_page(b"".join(placement.page(MAPPED, summary_of(MAPPED)))).text()
    assert "Map at Z 700, A 0.0°" in text
    assert "Map at X 50, Y 60" in text


@pytest.mark.parametrize(
    ("place", "is_on_map"),
    [
        ((0.0, -40.0, 700.5, -0.5, 0.0), True), ((100.0, 60.0, 699.5, 0.5, 0.5), True),
        ((-1.0, 0.0, 700.0, 0.0, 0.0), False), ((101.0, 0.0, 700.0, 0.0, 0.0), False),
        ((0.0, -41.0, 700.0, 0.0, 0.0), False), ((0.0, 61.0, 700.0, 0.0, 0.0), False),
        ((0.0, 0.0, 700.6, 0.0, 0.0), False), ((0.0, 0.0, 700.0, 0.6, 0.0), False),
        ((0.0, 0.0, 700.0, 0.0, 0.6), False),
    ],
)  # fmt: skip
def test_todays_place_is_marked_on_a_map_in_its_plane_and_between_its_edges(place, is_on_map):
    plane = plots_of(replace(MAPPED, today=trial(place)))[0]
    assert [trace.get("name") == "today" for trace in plane["traces"][1:]] == ([True, False] if is_on_map else [False])
    assert plane["note"].startswith("Ring: today's place." if is_on_map else "Today's place is not on this map: X ")


def test_a_map_needs_a_whole_grid_of_three_angles_and_heights():
    assert len(plots_of(replace(MAPPED, trials=MAPPED.trials[:1] + GRID[1:] + PLANE))) == 1
    assert len(plots_of(replace(MAPPED, trials=GRID[:6] + PLANE))) == 1
    two_angles = tuple(place for place in GRID if place.place[3] < 5.0)
    assert len(plots_of(replace(MAPPED, trials=two_angles + PLANE))) == 1
    assert len(plots_of(replace(MAPPED, slice=((), ())))) == 1
    assert plots_of(replace(MAPPED, best=None, slice=((), ())))[0]["note"] == "Ring: today's place."
    away = trial((50.0, 0.0, 900.0, 0.0, 0.0))  # not in the slice of the map
    assert len(plots_of(replace(MAPPED, trials=(*MAPPED.trials, away)))) == 2
    unknown = [replace(place, u95=np.nan) for place in MAPPED.trials]
    assert plots_of(replace(MAPPED, trials=tuple(unknown)))[0]["traces"][0]["title"] == "deflection, mm"


def test_the_page_has_a_tile_for_each_place_and_the_reasons_of_the_refused_ones():
    search = search_of(best=replace(BEST, turn=float(np.radians(-30.0))), trials=TRIALS, refusals=LATER[:2])
    content = summary_of(search, clearance_mm=12.5, start="The start is chosen.", moved_frames=["base_data.1"])
    read = read_page(b"".join(placement.page(search, content)))
    assert "a.nc, b.nc" in read.text()
    assert "kuka_kr270 · 5 places" in read.text()
    text = read.text("place")
    kind = "expected error (95 %), largest"
    assert f"Today 0.25 mm {kind}; X 100 Y 20 Z 700 A 5.0; joint margin 30.0°" in text
    assert f"Best place 0.12 mm {kind}; X 150 Y -10 Z 700 A 5.0; tool turned by -30°; joint margin 40.0°" in text
    clearance = "Places where bodies of [collision] come closer than 12.5 mm, or touch, are refused."
    for sentence in (content.sentence, clearance, "The start is chosen.", "[base_data.1] moves with [base]", "2 (a)"):
        assert sentence in text
    assert "can be driven by samples of the path 2 out of reach 1 collision 2" in read.text("refused")
    uncertain = search_of(replace(TODAY, u95=np.nan), None)
    text = read_page(b"".join(placement.page(uncertain, summary_of(uncertain)))).text("place")
    assert "Today 0.50 mm deflection, largest; X 100" in text
    assert "Best place - none" in text
    refused = search_of(TRIALS[2])
    assert "Today - out of reach" in read_page(b"".join(placement.page(refused, summary_of(refused)))).text("place")
