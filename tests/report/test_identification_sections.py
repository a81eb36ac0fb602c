"""Sections of the page of an identified model, from a record that is stated here."""

from __future__ import annotations

from types import SimpleNamespace as Record

import pytest

from postproc.identification.record import RESERVATION, Parameter
from postproc.report import identification as page


def parameter(value, ci95, prior=None, unit="mm"):
    return Parameter(value, ci95, unit, ci95 is not None, prior=prior)


PARAMETERS = {
    "one": parameter(10.0, 1.0, 8.0), "two": parameter(-10.0, 5.0), "three": parameter(2.0, 2.0, 4.0),
    "four": parameter(1.0, 3.0), "five": parameter(7.0, None, 7.0), "six": parameter(2.5e5, 1e4, 2.5e5),
}  # fmt: skip
ROWS = [Record(config=3, before_mm=0.5, after_mm=0.0125), Record(config=7, before_mm=0.25, after_mm=0.0)]
RESIDUAL = Record(before_rms_mm=0.4, rms_mm=0.01, per_configuration=ROWS)
DATA = Record(
    verdict=Record(line="usable", refused=False), error_lines=["the model misses 0.01 mm"],
    torque_Nm=[100.4, 2000.0, 900.0, 30.0, 40.0, 5.0], residual=RESIDUAL, parameters=PARAMETERS, not_observable=[],
    warnings=[], assumptions=None, sigma_mm=0.02,
)  # fmt: skip


def changed(**changes):
    return Record(**(vars(DATA) | changes))


@pytest.mark.parametrize(
    ("line", "refused", "shown"),
    [
        ("refused: the model is worse than the prior.", True,
         ("failed", "Not to be trusted.", "The model is worse than the prior.")),
        (f"usable{RESERVATION}two loads differ.", False,
         ("warning", "May be used,", f"within its bound{RESERVATION}two loads differ.")),
        ("usable", False, ("ok", "May be used,", "within its bound.")),
    ],
)  # fmt: skip
def test_the_verdict_is_its_line_with_the_largest_torques(line, refused, shown):
    verdict, notes = page.verdict_section(changed(verdict=Record(line=line, refused=refused))).parts
    assert (verdict.state, verdict.word, verdict.sentence) == shown
    assert [note.text for note in notes.notes] == [
        "The model misses 0.01 mm.",
        "The loads put up to 100, 2000, 900, 30, 40, 5 N·m on A1 … A6: work that puts more is extrapolated.",
    ]
    assert page.verdict_section(changed(verdict=None)) is None
    assert len(page.verdict_section(changed(error_lines=[], torque_Nm=None)).parts) == 1


def test_parameters_are_counted_by_how_well_they_are_known():
    """Of shares .1, .5, 1, 3, none, .04: each limit belongs to the better class."""
    (tiles,) = page.summary_section(DATA).parts
    assert [(tile.value, tile.unit) for tile in tiles.tiles] == [("0.400", "mm"), ("0.010", "mm"), ("4", "of 6")]
    assert tiles.tiles[1].note == "40 times less"
    assert tiles.tiles[2].note == (
        "2 to 10 %; 1 more to 50 %; 1 barely; 1 only together with others; 1 not seen: prior value"
    )
    (tiles,) = page.summary_section(changed(parameters={"one": PARAMETERS["one"]})).parts
    assert tiles.tiles[2].note == "1 to 10 %; 0 more to 50 %"
    assert page.summary_section(changed(residual=None)) is None
    assert page.summary_section(changed(parameters=None)) is None


def test_what_to_know_has_each_finding_once():
    (notes,) = page.findings_section(DATA).parts
    assert [(note.text, note.kind) for note in notes.notes] == [
        ("Every parameter is identifiable; no reading was left out.", "good")
    ]
    hidden = [Record(name="k1", reason="no load turns A1", advice="Tilt the load.")]
    data = changed(
        not_observable=hidden, warnings=["k1 is not observable at all", "k10 is odd"], assumptions=["rigid links"]
    )
    (notes,) = page.findings_section(data).parts
    assert [(note.text, note.kind) for note in notes.notes] == [
        ("k1 is not observable: no load turns A1. Tilt the load. The model keeps the prior value.", ""),
        ("k10 is odd", "warning"), ("Assumed: rigid links.", ""),
    ]  # fmt: skip
    (notes,) = page.findings_section(changed(warnings=["one", "two"])).parts
    assert [note.text for note in notes.notes] == ["one", "two"]


def test_each_configuration_has_its_displacement_and_residual():
    """On a logarithmic scale from 0.01 µm on; one reading has the noise of three coordinates."""
    plot, fold = page.configurations_section(DATA).parts
    span, displaced, residual = plot.traces
    assert (span.x, span.low, span.high) == ([3, 7], [0.0125, 1e-5], [0.5, 0.25])
    assert (displaced.y, residual.y) == (span.high, span.low)
    assert displaced.texts == ["config 3: 0.500 → 0.0125 mm", "config 7: 0.250 → 0.0000 mm"]
    assert plot.marks[0].at == pytest.approx(0.034641016)
    assert [row.cells for row in fold.parts[0].rows] == [("3", "0.500", "0.0125"), ("7", "0.250", "0.0000")]
    assert page.configurations_section(changed(residual=None)) is None


def test_parameters_have_intervals_in_per_cent_and_words():
    plot, table = page.parameters_section(DATA).parts
    assert [tuple(getattr(cell, "text", cell) for cell in row.cells) for row in table.rows] == [
        ("one", "10.0", "± 1", "mm", "well known"), ("two", "-10.0", "± 5", "mm", "roughly known"),
        ("three", "2.0", "± 2", "mm", "barely known"), ("four", "1.0", "± 3", "mm", "only together with others"),
        ("five", "7", "prior", "mm", "not from these readings"), ("six", "0.250", "± 0.01", "10⁶ mm", "well known"),
    ]  # fmt: skip
    assert [row.cells[4].kind for row in table.rows] == ["good", "", "warning", "warning", "warning", "good"]
    prior, interval = plot.traces
    assert (interval.x, interval.y) == (pytest.approx([10.0, 50.0, 100.0, 300.0, 4.0]), [0.0, 1.0, 2.0, 3.0, 5.0])
    assert interval.texts == [
        "one: known to 10 %", "two: known to 50 %", "three: known to 100 %", "four: known to 300 %",
        "six: known to 4 %",
    ]  # fmt: skip
    # priors of 8 for 10 and 4 for 2, and one that is right, at the lower end of the scale
    assert (prior.x, prior.y) == (pytest.approx([20.0, 100.0, 0.1]), [0.0, 2.0, 5.0])
    assert prior.texts[:2] == ["one: prior value off by 20 %", "three: prior value off by 100 %"]
    assert plot.x.range == pytest.approx((0.08, 390.0))
    assert [(mark.at, mark.text) for mark in plot.marks] == [(10.0, "10 %"), (100.0, "100 %")]
    assert page.parameters_section(changed(parameters={})) is None


def test_levels_structures_and_correlations():
    levels = [Record(q2_deg=-70.0, value=0.5, ci95=0.125), Record(q2_deg=-40.0, value=0.25, ci95=None)]
    (plot,) = page.levels_section(Record(k2_levels=levels, k2_curve=[(-90.0, 0.6), (0.0, 0.2)])).parts
    curve, points = plot.traces
    assert (curve.x, curve.y) == ([-90.0, 0.0], [0.6, 0.2])
    assert (points.x, points.y, points.half) == ([-70.0, -40.0], [0.5, 0.25], [0.125, None])
    assert points.texts == ["q2 = -70.0°: 0.5000 ± 0.1250", "q2 = -40.0°: 0.2500 ± 0.0000"]
    assert len(page.levels_section(Record(k2_levels=levels, k2_curve=None)).parts[0].traces) == 1
    assert page.levels_section(Record(k2_levels=[])) is None
    tried = [Record(structure="joints", held_out_sigma2=2.5, active=6, chosen=False),
             Record(structure="links", held_out_sigma2=0.05, active=20, chosen=True)]  # fmt: skip
    (plot,) = page.structures_section(Record(structure=Record(tried=tried, reason="links are soft"))).parts
    (bars,) = plot.traces
    assert (bars.lengths, bars.chosen) == ([2.5, 0.1], [False, True])
    assert bars.texts == ["2.50 σ² · 6 parameters", "0.05 σ² · 20 parameters"]
    assert (plot.note, plot.y.categories) == ("links are soft.", ["joints", "links"])
    assert page.structures_section(Record(structure=None)) is None
    pair = Record(names=["one", "two"], matrix=[[1.0, -0.5], [-0.5, 1.0]])
    (plot,) = page.correlations_section(Record(correlation=pair)).parts
    assert plot.traces[0].values == pair.matrix
    assert page.correlations_section(Record(correlation=Record(names=["one"], matrix=[[1.0]]))) is None
    assert page.correlations_section(Record(correlation=None)) is None


def test_the_geometry_that_was_found_is_shown_with_its_variants():
    variants = {"nominal": Record(held_out_rms_mm=0.5, rms_mm=0.4), "offsets": Record(held_out_rms_mm=0.25, rms_mm=0.2)}
    geometry = Record(variants=variants, chosen="offsets", parameters=PARAMETERS)
    (plot,) = page.geometry_section(Record(geometry=geometry)).parts
    (bars,) = plot.traces
    assert (bars.lengths, bars.chosen) == ([0.5, 0.25], [False, True])
    assert bars.texts == ["0.500 mm (fit 0.400)", "0.250 mm (fit 0.200)"]
    assert len(page.calibration_section(Record(geometry=geometry)).parts) == 2
    assert page.calibration_section(Record(geometry=Record(parameters={}))) is None
    assert page.geometry_section(Record(geometry=None)) is page.calibration_section(Record(geometry=None)) is None
    points = {"P1": {"X": 1.0, "Y": -2.5, "Z": 3.0004}}
    base = dict(zip("XYZABC", (1000.0, 2.0, 3.0, 4.0, 5.0, -6.12345), strict=True))
    table, notes = page.placement_section(Record(points=points, base=base, unloaded_rms_mm=0.04567)).parts
    assert [row.cells for row in table.rows] == [("P1", "1.000", "-2.500", "3.000")]
    assert "X 1000.000, Y 2.000, Z 3.000, A 4.000, B 5.000, C -6.123 (mm, °)" in notes.notes[0].text
    assert "0.046 mm RMS off" in notes.notes[0].text
