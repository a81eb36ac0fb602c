"""Identified cutting coefficients part by part: files read, fits, scatter, test cuts proposed, by hand or by search."""

from __future__ import annotations

import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.errors import ForceError
from postproc.machining import identification
from postproc.machining.identification import IdentifiedMaterial
from postproc.machining.process import ToolTable

HEAD = "mode,ap_mm,ae_mm,rpm,feed_mm_per_min,Fx,Fy,Fz,sigma_N,power_W\n"


def read(folder, *rows):
    (folder / "cuts.csv").write_text(HEAD + "\n".join(rows) + "\n")
    return identification.read(folder / "cuts.csv")


def test_columns_are_read_and_empty_cells_were_not_measured(tmp_path):
    found = read(tmp_path, "slot,3,,6000,900,1,2,3,4,5", "up,2,1.5,3000,600,,-7,,,", "down,1,0.5,2000,100,9,8,7,,60")
    assert list(found.mode) == ["slot", "up", "down"]
    np.testing.assert_array_equal(found.depth, [3, 2, 1])
    np.testing.assert_array_equal(found.width, [np.nan, 1.5, 0.5])
    np.testing.assert_array_equal(found.rpm, [6000, 3000, 2000])
    np.testing.assert_array_equal(found.feed, [900, 600, 100])
    np.testing.assert_array_equal(found.force, [[1, 2, 3], [np.nan, -7, np.nan], [9, 8, 7]])
    np.testing.assert_array_equal(found.sigma, [4, np.nan, np.nan])
    np.testing.assert_array_equal(found.power, [5, np.nan, 60])
    assert found.line.tolist() == [2, 3, 4]


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("slat,3,,6000,900,1,2,3,,", "unknown mode 'slat'"), ("up,3,0,6000,900,1,2,3,,", "mode up without ae_mm"),
        ("down,3,,6000,900,1,2,3,,", "mode down without ae_mm"), ("slot,0,,6000,900,1,2,3,,", "larger than 0"),
        ("slot,3,,-1,900,1,2,3,,", "larger than 0"), ("slot,3,,6000,0,1,2,3,,", "larger than 0"),
        ("slot,3,,6000,900,1,2,3,0,", "sigma_N must be larger than 0"),
    ],
)  # fmt: skip
def test_a_row_out_of_range_is_refused_at_its_line(tmp_path, row, words):
    with pytest.raises(ForceError) as refused:
        read(tmp_path, "slot,3,,6000,900,1,2,3,4,5", row, "slot,0,,1,1,1,1,1,,")
    assert words in refused.value.problem
    assert refused.value.line == 3


def test_a_file_without_rows_is_refused(tmp_path):
    with pytest.raises(ForceError, match="no readings"):
        read(tmp_path)


def system(predictor, readout, sigma=None, has_sigma=True, component=None):
    m = len(readout)
    return identification._Equations(
        np.array(predictor, dtype=float), np.array(readout, dtype=float),
        np.ones(m) if sigma is None else np.array(sigma, dtype=float), np.arange(m),
        np.zeros(m, dtype=int) if component is None else np.array(component), has_sigma,
    )  # fmt: skip


T_975 = {1: 12.706, 3: 3.1824, 10: 2.2281}
"""Quantiles of Student's t, from tables."""


@pytest.mark.parametrize("freedom", T_975)
def test_stated_deviations_hold_unless_the_readings_scatter_more(freedom):
    """The covariance grows with the mean square of the residuals; above 2 there is a warning."""
    spread, sigma = np.array([[4.0, 1.0], [1.0, 9.0]]), np.array([1.0, 2.0])
    for scale, factor, warned in (
        (0.9, 1.0, False),
        (1.9, 1.9 * (T_975[freedom] / 1.96) ** 2, False),
        (2.25, 2.25 * (T_975[freedom] / 1.96) ** 2, True),
    ):
        error = sigma * np.sqrt(0.5 * scale * freedom)
        given = system(np.zeros((2, 6)), [100.0, 50.0], sigma)
        found, warnings = identification._scaled_spread(spread, error, given, freedom)
        np.testing.assert_allclose(found, spread * factor, rtol=1e-4)
        assert len(warnings) == warned
        if warned:
            assert "scatter 1.5 times as much as sigma_N says" in warnings[0]


def test_without_stated_deviations_the_scatter_is_estimated_and_at_least_a_thousandth():
    """Of the root mean square reading: 100 N here, so 0.1 N."""
    spread = np.eye(2)
    given = system(np.zeros((2, 6)), [140.0, 20.0], has_sigma=False)
    for scale, least in ((0.5, False), (0.0101, False), (0.0099, True), (0.0, True)):
        found, warnings = identification._scaled_spread(spread, np.full(2, np.sqrt(1.5 * scale)), given, 3)
        expected = (0.01 if least else scale) * (T_975[3] / 1.96) ** 2
        np.testing.assert_allclose(found, expected * spread, rtol=1e-4)
        assert [w.startswith("the readings scatter less than any sensor") for w in warnings] == [True] * least


def test_a_weighted_fit_is_the_least_sum_of_squares():
    """Against a search around it; its covariance is that of the readings through the linear estimate."""
    rng = np.random.default_rng(3)
    predictor, readout, sigma = rng.normal(size=(9, 3)) * [1, 1e3, 1e-2], rng.normal(size=9), rng.uniform(0.5, 2, 9)
    value, spread = identification._fit(predictor, readout, sigma)

    def total(v):
        return float(np.sum(((predictor @ v - readout) / sigma) ** 2))

    for k, step in enumerate(np.sqrt(np.diag(spread))):
        for sign in (-1.0, 1.0):
            other = value.copy()
            other[k] += sign * 1e-3 * step
            assert total(other) > total(value)
    readings = np.array([identification._fit(predictor, readout + sigma * row, sigma)[0] - value for row in np.eye(9)])
    np.testing.assert_allclose(readings.T @ readings, spread, rtol=1e-8)


def test_a_fit_without_negative_coefficients_is_the_best_on_the_bound():
    """Ktc and Kte are bounded by 0, Kac is not."""
    predictor = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]])
    readout, sigma = np.array([5.0, -3.0, -4.0, 1.0]), np.array([1.0, 0.5, 1.0, 2.0])
    value = identification._positive_fit(predictor, readout, sigma, np.array([0, 3, 2]))
    assert value[1] == 0.0
    free, _ = identification._fit(predictor[:, [0, 2]], readout, sigma)
    np.testing.assert_allclose(value[[0, 2]], free, rtol=1e-6)
    for bounded in (0, 1, 3, 4):
        assert identification._positive_fit(np.eye(1), np.array([-1.0]), np.ones(1), np.array([bounded]))[0] == 0.0
    for free_one in (2, 5):
        assert identification._positive_fit(np.eye(1), np.array([-1.0]), np.ones(1), np.array([free_one]))[0] == -1.0


def test_the_cross_validation_error_leaves_each_feed_out_once():
    """A straight line through two feeds predicts the third: by hand."""
    chip = np.array([1.0, 2.0, 3.0])
    predictor = np.column_stack([np.ones(3), chip])
    part, sigma = np.array([1.0, 2.0, 5.0]), np.array([1.0, 1.0, 2.0])
    errors = [2 * 2 - 5 - 1, (1 + 5) / 2 - 2, 2 * 2 - 1 - 5]
    readout = part + 10.0
    expected = np.sqrt(np.sum((np.array(errors) / sigma) ** 2) / np.sum((readout / sigma) ** 2))
    found = identification._cross_validation_error(predictor, part, readout, sigma, chip)
    assert found == pytest.approx(expected)
    assert np.isnan(identification._cross_validation_error(predictor[:2], part[:2], readout[:2], sigma[:2], chip[:2]))
    assert np.isnan(identification._cross_validation_error(predictor, part, readout, sigma, np.ones(3)))


@pytest.mark.parametrize(("count", "readings", "freedom"), [(6, 7, 1), (2, 5, 3), (3, 3, None), (4, 2, None)])
def test_there_are_more_readings_than_coefficients(count, readings, freedom):
    is_excited = np.arange(6) < count
    given = system(np.zeros((readings, 6)), np.zeros(readings))
    if freedom is None:
        with pytest.raises(ForceError, match=f"{readings} readings for {count} coefficients"):
            identification._degrees_of_freedom(given, is_excited, "cuts.csv")
    else:
        assert identification._degrees_of_freedom(given, is_excited, "cuts.csv") == freedom


def test_intervals_wider_than_their_coefficient_are_warned_of():
    """The whole interval, twice its half width; only of coefficients that readings depend on."""
    estimate = np.array([100.0, 100.0, -100.0, -100.0, 0.0, 10.0])
    half = np.array([49.0, 51.0, 49.0, 51.0, 1.0, 99.0])
    warnings = identification._wide_interval_warnings(estimate, half, np.array([1, 1, 1, 1, 1, 0], dtype=bool))
    assert [w.split(" is known")[0] for w in warnings] == ["Krc", "Kte", "Kre"]
    assert "±51 only (100)" in warnings[0]


def test_the_deviation_of_forces_combines_residuals_and_coefficients():
    """By hand for two readings of 30 N and 40 N: variances 9 + 1 and 16 + 4."""
    predictor = np.zeros((2, 6))
    predictor[0, 0], predictor[1, 3] = 3.0, 2.0
    covariance = np.zeros((6, 6))
    covariance[0, 0], covariance[3, 3] = 1.0, 4.0
    error = np.array([1.0, -2.0])
    given = system(predictor, [30.0, 40.0])
    found = identification._percent_of_readout(given, covariance, error, "cuts.csv")
    assert found == pytest.approx(100.0 * np.sqrt(30.0) / 50.0)
    weighted = system(predictor, [30.0, 40.0], [1.0, 2.0])
    found = identification._percent_of_readout(weighted, covariance, error, "cuts.csv")
    assert found == pytest.approx(100.0 * np.sqrt((10 + 20 / 4) / (900 + 400)))
    identification._percent_of_readout(given, 0 * covariance, np.array([99.8, 0.0]), "cuts.csv")
    with pytest.raises(ForceError, match=r"no coefficients fit these readings.* a sigma of 200 %"):
        identification._percent_of_readout(given, 0 * covariance, np.array([100.2, 0.0]), "cuts.csv")


@pytest.mark.parametrize(("largest", "is_refused"), [(1.29, True), (1.31, False)])
def test_feeds_that_differ_by_less_than_three_tenths_are_one(largest, is_refused):
    chip = 0.1 * np.array([1.0, largest, 1.1])
    predictor = np.column_stack([[1.0, 2.0, 4.0], np.ones(3), *[np.zeros(3)] * 4])
    is_excited = np.array([1, 1, 0, 0, 0, 0], dtype=bool)
    given = chip, predictor, np.ones(3), is_excited, "cuts.csv"
    if is_refused:
        with pytest.raises(ForceError, match=r"one feed per tooth \(0.113 mm\): edge and cut \(Ktc, Krc\)"):
            identification._check_separable(*given)
    else:
        identification._check_separable(*given)


def test_coefficients_of_a_combination_that_no_reading_sees_are_named():
    """The second and the fourth column are in proportion; a small difference between them separates them."""
    rng = np.random.default_rng(1)
    predictor, other = rng.normal(size=(8, 6)) * [1, 1e3, 1, 1e-3, 1, 1], rng.normal(size=8)
    is_excited = np.array([1, 1, 1, 1, 1, 0], dtype=bool)
    for difference, is_refused in ((0.0, True), (1e-8, True), (1e-3, False)):
        predictor[:, 3] = 2e-6 * (predictor[:, 1] + 1e3 * difference * other)
        given = np.array([0.1, 0.2]), predictor, np.full(8, 2.0), is_excited, "cuts.csv"
        if is_refused:
            with pytest.raises(ForceError, match="these readings do not separate Krc, Kte"):
                identification._check_separable(*given)
        else:
            identification._check_separable(*given)


SMALL_BOX = SimpleNamespace(X=(0.0, 30.0), Y=(0.0, 9.0), Z=(0.0, 9.0))
BOX = SimpleNamespace(X=(10.0, 210.0), Y=(-5.0, 95.0), Z=(-30.0, 4.0))


@pytest.mark.parametrize(
    ("box", "diameter", "rpm", "expected"),
    [
        (None, 10.0, None, (4700, -10.0, 10.0, 0.0, 60.0 - 10.0, 2.0, 0.1)),
        (BOX, 10.0, 5000.0, (5000, 0.0, 5.0, 4.0, 70.0, 2.0, 0.1)),
        (SMALL_BOX, 20.0, None, (2300, -20.0, 20.0, 9.0, 34.0, 3.0, 0.125)),
        (None, 1.0, None, (12000, -1.0, 1.0, 0.0, 59.0, 0.2, 0.01)),
    ],
)  # fmt: skip
def test_proposed_test_cuts_are_five_slots_in_the_stock(box, diameter, rpm, expected):
    """Without a stated speed 150 m/min in whole hundreds, 12,000 at most; slots are one and a half diameters apart.

    They begin a diameter before the box and end a fifth of one behind it, or are 60 mm longer than the tool is wide.
    """
    speed, x, y, z, x_end, depth, chip = expected
    tool = ToolTable(diameter_mm=diameter, flutes=3, rpm=rpm)
    process = SimpleNamespace(stock=SimpleNamespace(box=box))
    program, table = identification.proposal(process, "7", tool)
    lines = program.decode().splitlines()
    assert lines[1:5] == ["G21 G90 G17 G94", "T7 M6", f"S{speed} M3", f"G0 Z{z + 20:g}"]
    rows = table.decode().splitlines()
    assert rows[0] == "mode,ap_mm,ae_mm,rpm,feed_mm_per_min,Fx,Fy,Fz,sigma_N"
    for k in range(5):
        share = chip * (k + 1) / 5
        feed = share * speed * 3
        assert lines[5 + 6 * k : 11 + 6 * k] == [
            f"(slot {k + 1}: {share:.3f} mm per tooth)", f"G0 X{x:.3f} Y{y + 1.5 * k * diameter:.3f}",
            f"G0 Z{z + 2:.3f}", f"G1 Z{z - depth:.3f} F1000", f"X{x_end:.3f} F{feed:.1f}", f"G0 Z{z + 20:g}",
        ]  # fmt: skip
        assert rows[1 + k] == f"slot,{depth:g},,{speed:g},{feed:.1f},,,,"
    assert lines[35:] == ["M5", "M30"]
    assert len(rows) == 6
    named = identification.proposal(process, "tMill", tool)[0].decode()
    assert "\nT1 M6\n" in named


def test_the_file_of_a_material_has_rounded_numbers_and_no_correlations_of_rounding():
    covariance = np.diag([4.0, 9.0, 1.0, 1.0, 1.0, 1.0])
    covariance[0, 1] = covariance[1, 0] = 2.0
    covariance[0, 2] = covariance[2, 0] = 1.9e-9
    material = IdentifiedMaterial(
        value=np.array([800.12345678, 200.0, 100.0, 20.0, 10.0, 1.0]), half_width=np.array([1.234567, 2, 3, 4, 5, 6.0]),
        covariance=covariance, identified=np.ones(6, dtype=bool), predictor=np.zeros((0, 6)), measured=np.zeros(0),
        sigma=np.zeros(0), reading=np.array([0, 0, 1, 4]), component=np.zeros(0, dtype=int), residual=1.23456789,
        cross_validation_error=0.1, sigma_percent=2.34567, warnings=(),
    )  # fmt: skip
    text = identification.as_toml(material, ToolTable(diameter_mm=12.5, flutes=3), "cuts.csv").decode()
    for line in (
        "Ktc_N_per_mm2 = 800.123", "sigma_percent = 2.35", "residual_N = 1.235", "Ktc = 1.235",
        'source = "identified from cuts.csv: 3 cuts with a flat tool of 12.5 mm, 3 teeth"',
    ):  # fmt: skip
        assert line in text
    table = tomllib.loads(text)["material"]
    expected = covariance.copy()
    expected[0, 2] = expected[2, 0] = 0.0
    np.testing.assert_allclose(np.array(table["covariance"]), expected)
    without = identification.as_toml(replace(material, residual=float("nan")), ToolTable(diameter_mm=1, flutes=1), "c")
    assert b"residual_N" not in without
