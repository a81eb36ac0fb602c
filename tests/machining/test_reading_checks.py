"""Plausibility of measured cuts with fits made up: which arrangement of the forces is named, and limits of sizes."""

from __future__ import annotations

import re

import numpy as np
import pytest

from postproc.errors import ForceError
from postproc.machining import reading_checks

USUAL = np.array([800.0, 200.0, 100.0, 20.0, 20.0, 1.0])
SIGMA = np.array([10.0, 10.0, 10.0, 1.0, 1.0, 1.0])
FORCE = np.array([[1.0, 20.0, 300.0], [2.0, 30.0, 400.0]])


def fits(**by_arrangement):
    """A fit by the arrangement of the columns that it is given: "+x+y", "-y+x" …: which column, with which sign."""

    def fit_of(force):
        names = []
        for column in range(2):
            ratio = force[0, column] / FORCE[0, :2]
            which = int(np.argmin(np.abs(np.abs(ratio) - 1.0)))
            names.append(f"{'+' if ratio[which] > 0 else '-'}{'xy'[which]}")
        assert (force[:, 2] == FORCE[:, 2]).all()
        return by_arrangement.get("".join(names).replace("+", "p").replace("-", "m"))

    return fit_of


def fit(value=USUAL, residual=0.01, sigma=SIGMA):
    return reading_checks.Fit(np.array(value, dtype=float), np.array(sigma, dtype=float), residual)


def changed(k, value):
    return [value if n == k else number for n, number in enumerate(USUAL)]


@pytest.mark.parametrize(
    ("k", "value", "is_usual"),
    [
        (0, 100.0, True), (0, 0.0, False), (0, -1.0, False), (1, -29.0, True), (1, -31.0, False), (3, -2.9, True),
        (3, -3.1, False), (4, -2.9, True), (4, -3.1, False), (2, -500.0, True), (5, -500.0, True), (1, 1629.0, True),
        (1, 1631.0, False),
    ],
)  # fmt: skip
def test_coefficients_of_a_material_are_positive_within_three_deviations_and_krc_at_most_twice_ktc(k, value, is_usual):
    """Axial ones may be negative: they may pull the material out."""
    assert reading_checks._is_plausible(fit(changed(k, value))) == is_usual


def test_usual_readings_are_taken_unless_others_fit_five_times_better():
    for residual, is_taken in ((0.0021, True), (0.0019, False)):
        given = fits(pxpy=fit(residual=0.01), pypx=fit(residual=residual))
        if is_taken:
            assert reading_checks.check_signs(FORCE, given, "cuts.csv") == []
        else:
            with pytest.raises(ForceError, match="Fx and Fy look exchanged"):
                reading_checks.check_signs(FORCE, given, "cuts.csv")
    assert reading_checks.check_signs(FORCE, fits(), "cuts.csv") == []  # they do not determine them


def test_a_radial_coefficient_above_the_tangential_one_is_a_warning():
    """Beyond twice its deviation."""
    for value, is_named in ((819.0, False), (820.0, True), (1600.0, True)):
        warnings = reading_checks.check_signs(FORCE, fits(pxpy=fit(changed(1, value))), "cuts.csv")
        assert [warning.startswith(f"Krc {value:.3g} is larger than Ktc 800") for warning in warnings] == [
            True
        ] * is_named


WRONG = fit(changed(0, -800.0))


@pytest.mark.parametrize(
    ("arrangement", "cause"),
    [
        ("mxmy", "they look like forces on the workpiece"), ("mxpy", "the sign of Fx looks wrong"),
        ("pxmy", "the sign of Fy looks wrong"), ("pypx", "Fx and Fy look exchanged"),
        ("mymx", "Fx and Fy look exchanged, and on the workpiece"), ("pymx", "their axes look turned by 90°"),
        ("mypx", "their axes look turned by 90°"),
    ],
)  # fmt: skip
def test_the_arrangement_that_a_material_gives_is_the_cause(arrangement, cause):
    with pytest.raises(ForceError) as refused:
        reading_checks.check_signs(FORCE, fits(pxpy=WRONG, **{arrangement: fit()}), "cuts.csv")
    text = str(refused.value)
    assert f"the forces give Ktc -800, Krc 200, Kte 20, Kre 20: {cause} (then Ktc 800" in text
    if arrangement in ("pymx", "mypx"):
        assert (
            f"give -F{'x' if arrangement == 'pymx' else 'y'} of this file as F{'y' if arrangement == 'pymx' else 'x'}"
            in text
        )


def test_of_two_arrangements_the_one_that_fits_better_or_has_the_smaller_krc_is_named():
    """Alike are residuals up to half as large again; then Krc decides, and then the order."""
    for residual, krc, cause in (
        (0.014, 900.0, "Fx and Fy look exchanged"), (0.016, 900.0, "the sign of Fx looks wrong"),
        (0.014, 200.0, "the sign of Fx looks wrong"),
    ):  # fmt: skip
        given = fits(pxpy=WRONG, mxpy=fit(changed(1, krc)), pypx=fit(residual=residual))
        with pytest.raises(ForceError, match=cause):
            reading_checks.check_signs(FORCE, given, "cuts.csv")
    with pytest.raises(ForceError, match="no material cuts so"):
        reading_checks.check_signs(FORCE, fits(pxpy=WRONG, mxpy=WRONG), "cuts.csv")


@pytest.mark.parametrize(("chip", "is_refused"), [(0.00101, False), (0.00099, True)])
def test_feeds_of_a_ten_thousandth_of_the_tool_are_in_another_unit(chip, is_refused):
    chips = np.array([0.1 * chip, chip])
    if is_refused:
        with pytest.raises(ForceError, match=r"0\.00099 mm, of a tool of 10 mm: these look like m/min"):
            reading_checks.check_feeds(chips, 10.0, "cuts.csv")
    else:
        reading_checks.check_feeds(chips, 10.0, "cuts.csv")


@pytest.mark.parametrize(
    ("k", "value", "unit"), [(0, 2.1e4, "N/mm²"), (2, -2.1e4, "N/mm²"), (3, 2.1e3, "N/mm"), (5, -2.1e3, "N/mm")]
)
def test_coefficients_beyond_any_material_are_refused(k, value, unit):
    with pytest.raises(ForceError, match=re.escape(f"a coefficient of {abs(value):.2g} {unit}: no material has that")):
        reading_checks.check_sizes(np.array(changed(k, value)), FORCE, None, "cuts.csv")
    assert reading_checks.check_sizes(np.array(changed(k, 0.94 * value)), FORCE, None, "cuts.csv") == []


@pytest.mark.parametrize(
    ("tangential", "force", "prior", "outcome"),
    [
        (0.99, 2.9, None, "refused"), (1.01, 2.9, None, "warned"), (9.9, 2.9, None, "warned"),
        (10.1, 2.9, None, "taken"), (0.5, 3.1, None, "taken"), (2.0, 2.9, 2000.0, "refused"),
        (2.0, 2.9, 6000.0, "refused"),
        (2.0, 2.9, 6500.0, "warned"), (2.0, 2.9, 640.0, "refused"), (2.0, 2.9, 620.0, "warned"),
        (2.0, 2.9, 9.0, "taken"), (2.0, 2.9, 11.0, "warned"), (0.5, 2.9, 1.0, "taken"),
        (2.0, 2.9, 0.41, "taken"), (2.0, 2.9, 0.39, "warned"),
        (0.5, np.nan, None, "taken"),
    ],
)  # fmt: skip
def test_small_forces_of_a_soft_material_may_be_kilonewtons(tangential, force, prior, outcome):
    """They are refused below 1 N/mm², or a thousandth of the material stated, within a factor of √10."""
    value, forces = np.array(changed(0, tangential)), np.array([[force, -0.5 * force, np.nan]])
    if outcome == "refused":
        with pytest.raises(ForceError, match="the forces look like kN"):
            reading_checks.check_sizes(value, forces, prior, "cuts.csv")
        return
    warnings = reading_checks.check_sizes(value, forces, prior, "cuts.csv")
    assert ["are these kN" in warning for warning in warnings] == [True] * (outcome == "warned")
