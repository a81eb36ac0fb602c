"""A comparison in words and on its page, from numbers that are stated here."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from postproc.report.answers import Drive, Verdict
from postproc.report.comparison.page import _numbers_section, _verdict_section
from postproc.report.comparison.summary import (
    ComparisonSummary,
    CutDistances,
    DistancesBetweenPairs,
    OriginEntry,
    PairEntry,
    PathGap,
    Rotations,
    comparison_text,
    count_text,
)  # fmt: skip
from postproc.report.summary import Distances


def pair(line, mm, file="new.src"):
    return PairEntry("old.nc", line, file, line + 10, mm, 0.0)


CUT = CutDistances(
    "old.nc", 4, "new.src", 14, Distances(0.9, 0.5, 0.4, 0.8), Distances(0.0123, 0.008, 0.007, 0.01)
)  # fmt: skip
CONTENT = ComparisonSummary(
    nominal="old.nc", corrected="new.src", robot="kuka_kr270", pairs=7, inserted=3, splines=0, only_nominal=0,
    passed=0, passed_within_mm=None, only_corrected=0, offset=Distances(1.25, 0.75, 0.5, 1.125),
    rotation=Rotations(0.01234, 0.01),
    between_targets=PathGap(0.0, None, None, None, None), largest=[pair(n, 1.25 / n) for n in range(1, 8)],
    differences={}, cut=None, between=None, tolerance_mm=0.01, operations=[],
    provenance=OriginEntry("unknown", None, None, {}), issues=[],
    verdict=Verdict("warning", "Look at the differences.", ["Drive: look."], Drive("warning", [], []), None, None,
                    ["new.src has other feeds", "line 4 is faster", "old.nc:12 is twice", "part.src:3 is new"], [], []),
)  # fmt: skip
HEAD = "new.src against old.nc  on kuka_kr270: "


def details(**changes):
    """The lines below the table of distances."""
    return comparison_text(replace(CONTENT, **changes)).split("\n\n")[2].splitlines()


def test_the_text_has_offsets_and_the_five_largest_pairs():
    lines = comparison_text(CONTENT).splitlines()
    assert lines[:6] == [
        f"{HEAD}7 pairs, 3 inserted", "Look at the differences.", "  Drive: look.", "  - new.src has other feeds",
        "  - line 4 is faster", "  - old.nc:12 is twice",
    ]  # fmt: skip
    assert [line.split() for line in lines[8:13]] == [
        ["along", "the", "cuts", "[mm]", "offset"], ["max", "1.2500"], ["RMS", "0.7500"], ["mean", "0.5000"],
        ["95", "%", "1.1250"],
    ]  # fmt: skip
    assert len({len(line) for line in lines[8:13]}) == 1  # numbers are aligned right
    first, *pairs = details()
    assert first == "  orientation: 0.0123° at most"
    assert [text.split(" mm between ")[0].strip() for text in pairs] == [
        "1.2500",
        "0.6250",
        "0.4167",
        "0.3125",
        "0.2500",
    ]
    assert "old.nc:1" in pairs[0]
    assert "new.src:11" in pairs[0]
    assert len(details(largest=[pair(1, 0.1), pair(2, 0.0)])) == 2


def test_deviations_of_both_programs_have_columns_where_forces_are_known():
    between = DistancesBetweenPairs(1.5, 0.02, "new.src", 15)
    table = comparison_text(replace(CONTENT, cut=CUT, between=between)).split("\n\n")[1].splitlines()
    assert [line.split()[-3:] for line in table[1:]] == [
        ["1.2500", "0.9000", "0.0123"], ["0.7500", "0.5000", "0.0080"], ["0.5000", "0.4000", "0.0070"],
        ["1.1250", "0.8000", "0.0100"], ["-", "1.5000", "0.0200"],
    ]  # fmt: skip
    assert table[0].endswith("offset  nominal cuts  corrected cuts")
    assert len({len(line) for line in table}) == 1
    page_table = _numbers_section(replace(CONTENT, cut=CUT, between=between)).parts[1]
    assert page_table.head == ("Criterion", "Offset, mm", "Nominal cuts, mm", "Corrected cuts, mm")
    assert [row.cells for row in page_table.rows] == [
        ("Maximum", "1.2500", "0.9000", "0.0123"), ("RMS", "0.7500", "0.5000", "0.0080"),
        ("Mean", "0.5000", "0.4000", "0.0070"), ("95th percentile", "1.1250", "0.8000", "0.0100"),
        ("Maximum between targets, from the path", "-", "1.5000", "0.0200"),
    ]  # fmt: skip
    tiles = {tile.label: (tile.value, tile.unit) for tile in _numbers_section(replace(CONTENT, cut=CUT)).parts[0].tiles}
    assert tiles == {
        "Largest offset": ("1.2500", "mm"), "Largest change of orientation": ("0.0123", "°"),
        "The nominal program cuts, largest": ("0.9000", "mm"), "The corrected one, largest": ("0.0123", "mm"),
    }  # fmt: skip
    assert _numbers_section(CONTENT).parts[1].rows[0].cells == ("Maximum", "1.2500")


def test_the_gap_of_the_paths_has_its_place():
    gap = PathGap(0.125, "old.nc", 4, "new.src", 14)
    text = "  on the way between targets: 0.1250 mm at most, before old.nc:4 and new.src:14"
    assert details(between_targets=gap)[1] == text
    tiles = _numbers_section(replace(CONTENT, between_targets=gap)).parts[0].tiles
    assert [tile.value for tile in tiles if tile.label.startswith("Paths apart")] == ["0.1250"]


@pytest.mark.parametrize(
    ("count", "distance", "text"),
    [
        (1, None, "1 target of the nominal program is not in the corrected one; its path passes it"),
        (2, 0.125, "2 targets of the nominal program are not in the corrected one; its path passes them within 0.1250"),
        (3, 0.0, "3 targets of the nominal program are not in the corrected one; its path passes them within 0.0001"),
    ],
)  # fmt: skip
def test_targets_that_the_path_passes_are_counted(count, distance, text):
    text += " mm" if distance is not None else ""
    changes = {"passed": count, "passed_within_mm": distance, "splines": 4}
    spline = "of splines (4 SPL) the targets are compared, the way between them is not"
    assert details(**changes)[1:3] == [f"  {text}", f"  {spline}"]
    notes = _numbers_section(replace(CONTENT, **changes)).parts[2].notes
    assert [note.text for note in notes] == [f"{text}.", f"O{spline[1:]}."]
    assert len(_numbers_section(CONTENT).parts) == 2


def test_targets_without_a_partner_are_counted():
    assert count_text(replace(CONTENT, only_nominal=2)) == "7 pairs, 3 inserted, 2 missing"
    assert count_text(replace(CONTENT, only_corrected=1)) == "7 pairs, 3 inserted, 1 added"


@pytest.mark.parametrize(
    ("state", "version", "line"),
    [
        ("none", None, "new.src does not say that postproc wrote it"), ("changed", None, None),
        ("intact", "0.1", "new.src was written by postproc 0.1 (convert), unchanged since"),
        ("changed", "0.1", "new.src was written by postproc 0.1 (convert), changed since"),
    ],
)  # fmt: skip
def test_the_origin_of_the_second_program_is_said(state, version, line):
    last = details(provenance=OriginEntry(state, "convert", version, {}), largest=[])[-1]
    assert last.strip() == (line or "orientation: 0.0123° at most")


@pytest.mark.parametrize(("state", "kind"), [("ok", ""), ("warning", ""), ("failed", "error")])
def test_reasons_are_errors_only_of_a_program_that_must_not_run(state, kind):
    """They begin with a capital letter, but for names of files."""
    notes = _verdict_section(replace(CONTENT, verdict=replace(CONTENT.verdict, state=state))).parts[2]
    assert [(note.text, note.kind) for note in notes.notes] == [
        ("new.src has other feeds.", kind), ("Line 4 is faster.", kind), ("old.nc:12 is twice.", kind),
        ("part.src:3 is new.", kind),
    ]  # fmt: skip
    assert len(_verdict_section(replace(CONTENT, verdict=replace(CONTENT.verdict, reasons=[]))).parts) == 2
