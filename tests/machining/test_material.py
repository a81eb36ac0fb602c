"""The cutting law of `[material]` from each of its forms, its deviation with wear, and depths of tools in stock."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.stats import norm

from postproc.errors import ForceError
from postproc.machining import material, resolution
from postproc.machining import stock as stocks
from postproc.machining.leaning import depth_inside
from postproc.machining.material import CuttingLaw, MaterialTable, law, six_numbers
from postproc.machining.resolution import ThinPasses
from postproc.machining.tool import Cutter

NAME = "al_6082_t6_carbide"


def with_wear(sigma: float) -> float:
    """Deviation of the error (1 + e)(1 + w) − 1, w even from 0 to 25 %: half its 95 % interval over 1.96."""

    def outside(half: float) -> float:
        def inside_at(w: float) -> float:
            upper, lower = ((1 + sign * half) / (1 + w) - 1 for sign in (1, -1))
            return norm.cdf(upper, scale=sigma) - norm.cdf(lower, scale=sigma)

        return quad(inside_at, 0.0, 0.25)[0] / 0.25 - 0.95

    return brentq(outside, 0.01, 5.0) / norm.ppf(0.975)


@pytest.mark.parametrize("percent", [10.0, 33.0, 80.0])
def test_published_values_get_the_deviation_of_the_alloy_and_of_wear(percent):
    assert material._spread_with_wear(percent / 100.0) == pytest.approx(with_wear(percent / 100.0), rel=2e-3)


def test_without_a_deviation_of_the_alloy_wear_alone_counts():
    """95 % of growths from 0 to 25 % are within ±23.75 %."""
    assert material._spread_with_wear(0.0) == pytest.approx(0.2375 / norm.ppf(0.975), rel=0.02)


def test_a_material_of_the_table_is_in_si_units_with_its_deviation():
    found = law(MaterialTable(name=NAME), "process.toml")
    assert found.cutting == pytest.approx((631e6, 99e6, 273e6))
    assert found.edge == pytest.approx((13e3, 10e3, 2.8e3))
    assert (found.exponent, found.name, found.unknown_axial, found.covariance) == (0.0, NAME, 0.0, None)
    assert found.sigma == pytest.approx(with_wear(0.33), rel=2e-3)
    numbers, sigma = six_numbers(MaterialTable(name=NAME), "process.toml")
    np.testing.assert_allclose(numbers, [631, 99, 273, 13, 10, 2.8])
    assert sigma == found.sigma
    assert found.numbers == pytest.approx((631, 99, 273, 13, 10, 2.8, 0.0, 100 * sigma))


def test_a_stated_deviation_is_taken_as_it_is():
    assert law(MaterialTable(name=NAME, sigma_percent=12.0), "p").sigma == pytest.approx(0.12)
    assert law(MaterialTable(Ktc_N_per_mm2=700.0, sigma_percent=0.0), "p").sigma == 0.0
    assert law(MaterialTable(Ktc_N_per_mm2=700.0), "p").sigma == pytest.approx(with_wear(0.33), rel=2e-3)


def test_kienzle_numbers_are_shares_of_the_tangential_one():
    found = law(MaterialTable(kc11_N_per_mm2=1500.0, mc=0.25, radial_ratio=0.4, axial_ratio=0.1), "p")
    assert found.cutting == pytest.approx((1500e6, 600e6, 150e6))
    assert (found.edge, found.exponent, found.name) == ((0.0, 0.0, 0.0), 0.25, "given in [material]")
    assert six_numbers(MaterialTable(kc11_N_per_mm2=1500.0, mc=0.25), "p") is None
    thickness = np.array([-1e-4, 0.0, 5e-5, 1e-3, 2e-3], dtype=np.float32)
    expected = [0.0, 0.0, 5e-5 * 0.05**-0.25, 1e-3, 2e-3 * 2.0**-0.25]
    np.testing.assert_allclose(found.chip_factor(thickness), expected, rtol=1e-5)
    assert found.chip_factor(thickness).dtype == np.float32
    linear = CuttingLaw((1.0, 1.0, 1.0), (0.0, 0.0, 0.0), 0.0, 0.1, "x")
    np.testing.assert_allclose(linear.chip_factor(thickness), np.maximum(thickness, 0.0))


def test_what_is_not_stated_of_a_material_is_zero_but_for_a_radial_force_of_three_tenths():
    bare = law(MaterialTable(Ktc_N_per_mm2=700.0), "p")
    assert (bare.cutting[1:], bare.edge) == ((0.0, 0.0), (0.0, 0.0, 0.0))
    kienzle = law(MaterialTable(kc11_N_per_mm2=1000.0, mc=0.2), "p")
    assert kienzle.cutting == pytest.approx((1e9, 0.3e9, 0.0))


@pytest.mark.parametrize(
    ("changes", "unknown"),
    [({}, 0.7), ({"Kac_N_per_mm2": 5.0}, 0.0), ({"Kae_N_per_mm": -5.0}, 0.0)],
)
def test_an_axial_force_that_is_not_stated_is_unknown(changes, unknown):
    found = law(MaterialTable(Ktc_N_per_mm2=700.0, **changes), "p")
    assert found.unknown_axial == unknown
    assert (found.numbers == ()) is (unknown > 0.0)


@pytest.mark.parametrize(("value", "is_warned"), [(0.99, True), (1.0, False), (700.0, False)])
def test_a_coefficient_below_one_is_asked_about(value, is_warned):
    for table in (MaterialTable(Ktc_N_per_mm2=value), MaterialTable(kc11_N_per_mm2=value, mc=0.2)):
        warning = law(table, "p").warning
        assert (warning is not None) is is_warned
        assert not is_warned or f" = {value:g}: below 1 N/mm²" in warning


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (MaterialTable(name="aluminum"), "no material 'aluminum'"),
        (MaterialTable(), "does not say how it cuts"),
        (MaterialTable(Ktc_N_per_mm2=1.0, kc11_N_per_mm2=1.0, mc=0.2), "has coefficients of two cutting laws"),
        (MaterialTable(kc11_N_per_mm2=1.0), "does not say how it cuts"),
        (MaterialTable(Ktc_N_per_mm2=1.0, mc=0.2), "has coefficients of two cutting laws"),
        (MaterialTable(file="m.toml", name=NAME), "file together with values"),
        (MaterialTable(file="m.toml", Ktc_N_per_mm2=1.0), "file together with values"),
        (MaterialTable(file="m.toml", kc11_N_per_mm2=1.0, mc=0.2), "file together with values"),
    ],
)
def test_a_material_that_is_none_or_two_is_refused(table, message):
    with pytest.raises(ForceError, match=message):
        law(table, "process.toml")


def identified(folder, covariance: str, more: str = "") -> str:
    text = "[material]\nKtc_N_per_mm2 = 700.0\nKac_N_per_mm2 = 100.0\nsigma_percent = 10.0\nsource = 'x'\n"
    (folder / "m.toml").write_text(f"{text}{covariance}\n{more}")
    return str(folder / "process.toml")


def matrix(size: int = 6, asymmetry: float = 0.0, first: float = 4.0) -> str:
    values = np.diag([first, 1.0, 1.0, 0.25, 0.25, 0.25])[:size, :size]
    values[0, 3], values[3, 0] = 0.5, 0.5 + asymmetry
    return f"covariance = {values.tolist()}"


def test_identified_coefficients_have_their_covariance_in_si_units(tmp_path):
    found = law(MaterialTable(file="m.toml"), identified(tmp_path, matrix()))
    covariance = np.array(found.covariance)
    np.testing.assert_allclose(np.diag(covariance), [4e12, 1e12, 1e12, 0.25e6, 0.25e6, 0.25e6])
    assert covariance[0, 3] == covariance[3, 0] == pytest.approx(0.5e9)
    assert found.cutting[0] == pytest.approx(700e6)
    stated = law(MaterialTable(file="m.toml", sigma_percent=20.0), identified(tmp_path, matrix()))
    assert (stated.covariance, stated.sigma) == (None, pytest.approx(0.2))
    assert law(MaterialTable(file="m.toml"), identified(tmp_path, "")).covariance is None


@pytest.mark.parametrize("wrong", [matrix(5), matrix(asymmetry=0.1), matrix(first=0.1), "covariance = [[1.0]]"])
def test_a_covariance_that_cannot_be_is_refused(tmp_path, wrong):
    with pytest.raises(ForceError, match="no covariance of six coefficients"):
        law(MaterialTable(file="m.toml"), identified(tmp_path, wrong))


def test_coefficients_that_are_known_in_their_sum_alone_have_a_covariance(tmp_path):
    ones = f"covariance = {np.ones((6, 6)).tolist()}"
    assert np.array(law(MaterialTable(file="m.toml"), identified(tmp_path, ones)).covariance).shape == (6, 6)


@pytest.mark.parametrize("key", ["Kac_N_per_mm2", "Kae_N_per_mm"])
def test_axial_coefficients_may_be_negative_and_no_larger_than_any_material_has(key):
    for value, is_valid in ((-1e5, True), (1e5, True), (-1.01e5, False), (1.01e5, False)):
        if is_valid:
            assert getattr(msgspec.convert({key: value}, MaterialTable), key) == value
            continue
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert({key: value}, MaterialTable)


@pytest.mark.parametrize("more", ["[other]\nKtc_N_per_mm2 = 1.0", ""])
def test_a_file_of_a_material_has_one_of_its_own(tmp_path, more):
    path = identified(tmp_path, "file = 'again.toml'" if not more else "", more)
    with pytest.raises(ForceError, match="no \\[material\\] of its own"):
        law(MaterialTable(file="m.toml"), path)


CELL_SIZE = 0.5e-3
BLOCK = stocks.from_box(np.array([0.0, 0.0, -0.04]), np.array([0.06, 0.06, 0.0]), CELL_SIZE)
MIDDLE = np.array([0.03, 0.03, 0.0])


@pytest.mark.parametrize(
    ("cutter", "reach"),
    [(Cutter(0.01, 0.0, 4), 0.0), (Cutter(0.01, 0.01, 2), CELL_SIZE), (Cutter(0.01, 0.003, 2), CELL_SIZE)],
)
def test_an_upright_tool_is_as_deep_as_its_tip(cutter, reach):
    """A round end is compared smaller by a cell; a flat one is not."""
    up = np.array([[0.0, 0.0, 1.0]])
    for depth in (0.005, 0.012):
        tip = MIDDLE[None] - [0.0, 0.0, depth]
        assert depth_inside(BLOCK, cutter, tip, up) == pytest.approx(depth - reach, abs=1e-4)
    assert depth_inside(BLOCK, cutter, MIDDLE[None] + [0.0, 0.0, 1e-5], up) == 0.0
    assert depth_inside(BLOCK, cutter, np.array([[0.2, 0.03, -0.01]]), up) == 0.0
    several = np.concatenate([MIDDLE[None] + [0, 0, 0.01]] * 130 + [MIDDLE[None] - [0, 0, 0.004]])
    assert depth_inside(BLOCK, cutter, several, np.repeat(up, 131, axis=0)) == pytest.approx(0.004 - reach, abs=1e-4)


@pytest.mark.parametrize("degrees", [20.0, 45.0, 70.0])
@pytest.mark.parametrize("turn", [0.0, 130.0])
def test_the_rim_of_a_leaning_flat_tool_is_deepest(degrees, turn):
    """Its lowest point is r·sin(tilt) below the middle of the end; a cell less of radius, and points around it."""
    tilt, around = np.radians([degrees, turn])
    axis = np.array([[np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.cos(tilt)]])
    tip = MIDDLE[None] - [0.0, 0.0, 0.004]
    expected = 0.004 + (0.01 - CELL_SIZE) * np.sin(tilt)
    found = depth_inside(BLOCK, Cutter(0.01, 0.0, 4), tip, axis)
    assert expected - 2e-4 <= found <= expected + 2e-5
    high = MIDDLE[None] + [0.0, 0.0, 0.01 * np.sin(tilt) + 1e-4]
    assert depth_inside(BLOCK, Cutter(0.01, 0.0, 4), high, axis) == 0.0


def test_the_shank_of_a_lying_tool_is_in_the_block_that_its_end_has_passed():
    """The axis is level, 3 mm over the block, the tip 20 mm beyond it: the cylinder is r − cell − 3 mm deep."""
    axis, tip = np.array([[-1.0, 0.0, 0.0]]), np.array([[0.08, 0.03, 0.003]])
    found = depth_inside(BLOCK, Cutter(0.01, 0.0, 4), tip, axis)
    assert found == pytest.approx(0.01 - CELL_SIZE - 0.003, abs=1e-4)
    away = np.array([[0.08, 0.03, 0.003]])
    assert depth_inside(BLOCK, Cutter(0.01, 0.0, 4), away, -axis) == 0.0


def test_cells_are_divided_by_the_excess_up_to_the_largest_map():
    passes = [ThinPasses(*row) for row in ((3, 0, 0.3, 1.12), (9, 0, 0.3, 2.2), (12, 1, 0.3, 10.0), (20, 1, 0.3, 1.08))]
    assert resolution.cell_divisors(passes, 10_000, [0]) == {3: 2, 9: 3, 12: 10}
    assert resolution.cell_divisors(passes, 3_000_000, [0]) == {3: 2, 9: 2, 12: 2}
    assert resolution.cell_divisors(passes, 12_000_000, [0]) == {}
