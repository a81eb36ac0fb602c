"""Measured cuts with wrong signs, axes and units are refused with their cause; those of real materials are not.

Mean forces are integrals over the turn of a tooth, by the formulas of Altintas, written here.
"""

from __future__ import annotations

import re

import msgspec
import numpy as np
import pytest

from postproc import machining
from postproc.errors import ForceError
from postproc.machining import identification, material
from postproc.machining.material import MaterialTable
from postproc.machining.process import ToolTable
from tests.commands import printed
from tests.machining.setting import process, tool

TOOL_OF_3_FLUTES = ToolTable(diameter_mm=10.0, flutes=3)
CHIPS = (0.02, 0.04, 0.06, 0.08, 0.10)
RPM, DEPTH = 6000.0, 2.0
AL = MaterialTable(
    Ktc_N_per_mm2=900.0,
    Krc_N_per_mm2=300.0,
    Kac_N_per_mm2=180.0,
    Kte_N_per_mm=22.0,
    Kre_N_per_mm=20.0,
    Kae_N_per_mm=3.0,
)
MODES = {"slot": (0.0, np.pi), "up": (0.0, np.pi / 3), "down": (2 * np.pi / 3, np.pi)}
"""Angles of a tooth in the cut: the narrow ones are those of a quarter of the diameter."""


def mean_force(entry, mode, chip, depth=DEPTH):
    """Mean force (3,) [N] on the tool, FEED axes, clockwise: the mean over the angle of a tooth in the cut."""
    begin, end = MODES[mode]
    step = (end - begin) / 4000
    angle = begin + step * (np.arange(4000) + 0.5)
    h = chip * np.sin(angle)
    if entry.kc11_N_per_mm2 is None:
        tangential = entry.Ktc_N_per_mm2 * h + (entry.Kte_N_per_mm or 0.0)
        radial = entry.Krc_N_per_mm2 * h + (entry.Kre_N_per_mm or 0.0)
        axial = (entry.Kac_N_per_mm2 or 0.0) * h + (entry.Kae_N_per_mm or 0.0)
    else:
        tangential = entry.kc11_N_per_mm2 * h ** (1.0 - entry.mc)
        radial_ratio = 0.3 if entry.radial_ratio is None else entry.radial_ratio
        radial, axial = radial_ratio * tangential, (entry.axial_ratio or 0.0) * tangential
    x = -tangential * np.cos(angle) - radial * np.sin(angle)
    y = tangential * np.sin(angle) - radial * np.cos(angle)
    return TOOL_OF_3_FLUTES.flutes * depth / (2 * np.pi) * step * np.array([x.sum(), y.sum(), axial.sum()])


def cuts(entry=AL, modes=("slot",), depth=DEPTH, noise=0.01, seed=0):
    rng = np.random.default_rng(seed)
    rows = [(mode, chip, mean_force(entry, mode, chip, depth)) for mode in modes for chip in CHIPS]
    mode, chip, force = zip(*rows, strict=True)
    force, n = np.array(force), len(rows)
    force = force + noise * np.abs(force).max() * rng.normal(size=force.shape)
    nothing = np.full(n, np.nan)
    return identification.CutReadings(
        list(mode), np.full(n, depth), np.full(n, 2.5), np.full(n, RPM), np.array(chip) * RPM * TOOL_OF_3_FLUTES.flutes,
        force, nothing, nothing, np.arange(n) + 2.0,
    )  # fmt: skip


def changed(readings, **values):
    return msgspec.structs.replace(readings, **values)


def identified(readings, prior=None):
    return identification.identify(readings, TOOL_OF_3_FLUTES, prior, "cuts.csv")


def exchange(force):
    return force[:, [1, 0, 2]]


CAUSES = [
    (lambda force: -force, "on the workpiece", "ON the tool: change the signs of Fx, Fy and Fz"),
    (exchange, "Fx and Fy look exchanged [(]", "exchange the columns"),
    (lambda force: -exchange(force), "Fx and Fy look exchanged, and on the workpiece", "and change the signs"),
    (lambda force: force * [-1.0, 1.0, 1.0], "the sign of Fx looks wrong", "change its sign"),
    (lambda force: force * [1.0, -1.0, 1.0], "the sign of Fy looks wrong", "M4"),
    # what reads F in axes turned by 90 degrees about the spindle: (Fy, -Fx), or the other way round (-Fy, Fx)
    (lambda force: exchange(force) * [1.0, -1.0, 1.0], "turned by 90", "give -Fy of this file as Fx, and Fx as Fy"),
    (lambda force: exchange(force) * [-1.0, 1.0, 1.0], "turned by 90", "give -Fx of this file as Fy, and Fy as Fx"),
]


@pytest.mark.parametrize("modes", [("slot",), ("up",), ("down",), ("slot", "up", "down")], ids="/".join)
@pytest.mark.parametrize(("wrong", "cause", "advice"), CAUSES, ids=[cause for _, cause, _ in CAUSES])
def test_wrong_signs_and_axes_are_refused_with_their_cause(modes, wrong, cause, advice):
    right = cuts(modes=modes, noise=0.002)
    assert identified(right).value[0] == pytest.approx(900.0, rel=0.05)
    if modes == ("up",) and cause == "the sign of Fy looks wrong":
        return  # gives coefficients of a possible material, and fits: see the next test
    with pytest.raises(ForceError, match=cause) as caught:
        identified(changed(right, force=wrong(right.force)))
    assert advice in str(caught.value)
    assert re.search(r"[(]then Ktc (8[5-9]|9[0-4])\d,", str(caught.value))


def test_a_wrong_sign_that_fits_a_possible_material_is_a_warning():
    """Up milling alone: with Fy of the wrong sign Krc is 1.7 times Ktc."""
    right = cuts(modes=("up",), noise=0.002)
    found = identified(changed(right, force=right.force * [1.0, -1.0, 1.0]))
    assert found.value[1] > 1.5 * found.value[0] > 0.0
    assert any("check the axes and signs" in text for text in found.warnings)
    assert not any("check the axes and signs" in text for text in identified(right).warnings)


def test_kilonewtons_are_refused():
    for name in ("al_7075_t6_carbide", "steel_c45", "ti_6al_4v_carbide", "steel_low_alloy"):
        entry = material.table()[name]
        readings = cuts(entry)
        assert identified(readings, MaterialTable(name=name)).value[0] > 0.0
        with pytest.raises(ForceError, match="look like kN"):
            identified(changed(readings, force=1e-3 * readings.force), MaterialTable(name=name))


def test_without_a_material_steel_in_kilonewtons_may_be_foam_and_is_a_warning():
    readings = cuts(material.table()["steel_c45"])
    found = identified(changed(readings, force=1e-3 * readings.force))
    assert found.value[0] > 1.0
    assert any("are these kN" in text for text in found.warnings)
    aluminium = cuts()
    with pytest.raises(ForceError, match="look like kN"):
        identified(changed(aluminium, force=1e-3 * aluminium.force))


def test_feeds_in_metres_per_minute_are_refused():
    right = cuts()
    with pytest.raises(ForceError, match="look like m/min"):
        identified(changed(right, feed=1e-3 * right.feed))


def test_depths_in_metres_are_refused():
    right = cuts()
    with pytest.raises(ForceError, match="no material has that"):
        identified(changed(right, depth=1e-3 * right.depth))


LINEAR_AND_KIENZLE = sorted(material.table())


SLOT, ALL_MODES = ("slot",), ("slot", "up", "down")


@pytest.mark.parametrize(
    ("name", "modes", "depth"),
    [
        (name, modes, depth)
        for number, name in enumerate(LINEAR_AND_KIENZLE)
        for modes, depth in ((SLOT, 2.0 + 6.0 * (number % 2)), (ALL_MODES, 8.0 - 6.0 * (number % 2)))
    ],
)
def test_no_material_of_the_table_is_refused_and_its_file_is_taken(tmp_path, name, modes, depth):
    """With the noise of a common dynamometer, with the material named and without; every second slot is shallow."""
    entry = material.table()[name]
    (tmp_path / "process.toml").write_text(
        process(tool(10, 3), ((0, 100), (-40, 40), (-20, 0)), material='file = "m.toml"')
    )
    for seed, prior in enumerate((MaterialTable(name=name), None)):
        found = identified(cuts(entry, modes, depth, noise=0.01, seed=seed), prior)
        (tmp_path / "m.toml").write_bytes(identification.as_toml(found, TOOL_OF_3_FLUTES, "cuts.csv"))
        assert machining.load(tmp_path / "process.toml").law().cutting[0] == pytest.approx(
            1e6 * found.value[0], rel=1e-5
        )


def test_a_coefficient_that_is_negative_within_its_error_is_taken_as_zero():
    entry = MaterialTable(Ktc_N_per_mm2=900.0, Krc_N_per_mm2=300.0)  # a sharp edge
    seeds = range(8)
    results = [identified(cuts(entry, seed=seed)) for seed in seeds]
    at_zero = [found for found in results if any("taken as 0" in text for text in found.warnings)]
    assert 0 < len(at_zero) <= len(results)
    for found in at_zero:
        assert (found.value[[0, 1, 3, 4]] >= 0.0).all()
        assert (found.value == 0.0).any()
        assert found.value[0] == pytest.approx(900.0, rel=0.1)


def test_nothing_is_written_for_readings_that_are_refused(tmp_path):
    rows = ["mode,ap_mm,ae_mm,rpm,feed_mm_per_min,Fx,Fy,Fz"]
    for chip in CHIPS:
        x, y, z = -mean_force(AL, "slot", chip)
        rows.append(f"slot,{DEPTH},,{RPM},{chip * RPM * 3:g},{x:.3f},{y:.3f},{z:.3f}")
    (tmp_path / "cuts.csv").write_text("\n".join([*rows, ""]))
    (tmp_path / "tool.toml").write_text(f"[tools.1]\n{tool(10, 3)}")
    given = (
        "identify",
        "forces",
        tmp_path / "cuts.csv",
        "--process",
        tmp_path / "tool.toml",
        "-o",
        tmp_path / "m.toml",
    )
    printed(*given, code=1)
    assert not (tmp_path / "m.toml").exists()
