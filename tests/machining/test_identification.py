"""Cutting coefficients identified from cuts that were simulated tooth by tooth."""

from __future__ import annotations

import csv
import tomllib

import numpy as np
import pytest

from postproc import machining
from postproc.errors import ForceError
from postproc.machining import identification
from postproc.machining.process import ToolTable
from tests.commands import printed
from tests.machining.setting import AL7075, CELL, ROBOT, gcode, process, tool
from tests.oracle.teeth import Teeth

TRUE = np.array([AL7075[k] for k in (0, 2, 4, 1, 3, 5)])
"""In the order of `identification.NAMES`."""
RADIUS, TEETH, DEPTH, RPM = 5.0, 4, 3.0, 6000.0
IDENTIFIED_TOOL = ToolTable(diameter_mm=2 * RADIUS, flutes=TEETH)
FEEDS = (0.02, 0.04, 0.06, 0.08, 0.10)


def cut(mode, width, chip, depth=DEPTH):
    """Mean force (3,) [N] and power [W] of a tool that is turned tooth by tooth along x."""
    teeth = Teeth(RADIUS, 0.0, TEETH, AL7075).side(depth, discs=1)

    def material(point):
        across = point[:, 1]
        if mode == "slot":
            return np.ones(len(point), dtype=bool)
        return across > RADIUS - width if mode == "up" else across < width - RADIUS

    wrench = teeth.wrench((0, 0, 0), (1, 0, 0), chip, material, steps=3600)
    return wrench[:3], wrench[5] * 1e-3 * RPM * 2 * np.pi / 60


PUBLISHED_FEEDS = (0.025, 0.05, 0.075, 0.1, 0.125)
PUBLISHED = np.array(
    [(-39.8, 63.0, 55.7), (-60.1, 107.1, 70.9), (-71.6, 137.7, 82.6), (-76.7, 171.3, 85.2), (-78.5, 210.7, 83.5)]
)
"""Mean forces [N] over 100 turns in slots at `PUBLISHED_FEEDS` [mm per tooth], FEED axes: an end mill of 25 mm with 2
teeth, 3 mm deep, 6000/min. Means of the Kistler readings that github.com/leekunhwee/ForceCalculation publishes."""

SLOTS = [("slot", np.nan, chip, *cut("slot", None, chip)) for chip in FEEDS]
SIDES = [(mode, 2.5, chip, *cut(mode, 2.5, chip)) for mode in ("up", "down") for chip in (0.03, 0.09)]


def readings(cuts, rng=None, noise=3.0, sigma=3.0, forces=True, power=False):
    mode, width, chip, force, watt = zip(*cuts, strict=True)
    force, watt = np.array(force), np.array(watt)
    if rng is not None:
        force = force + rng.normal(0.0, noise, force.shape)
        watt = watt + rng.normal(0.0, 5.0, watt.shape)
    n, nothing = len(cuts), np.full(len(cuts), np.nan)
    return identification.CutReadings(
        list(mode), np.full(n, DEPTH), np.array(width), np.full(n, RPM), np.array(chip) * RPM * TEETH,
        force if forces else np.full((n, 3), np.nan), watt if power else nothing,
        nothing if sigma is None else np.full(n, sigma), np.arange(n) + 2.0,
    )  # fmt: skip


def identified(*given, prior=None, **options):
    return identification.identify(readings(*given, **options), IDENTIFIED_TOOL, prior, "measured.csv")


def of_published():
    """The published slots as readings, without a stated noise."""
    n, nothing = len(PUBLISHED_FEEDS), np.full(len(PUBLISHED_FEEDS), np.nan)
    return identification.CutReadings(
        ["slot"] * n, np.full(n, 3.0), nothing, np.full(n, 6000.0), np.array(PUBLISHED_FEEDS) * 6000.0 * 2,
        PUBLISHED, nothing, nothing, np.arange(n) + 2.0,
    )  # fmt: skip


def left_out_of_lines():
    """Errors (5, 3) [N] of the published mean forces, each feed by straight lines over the feed through the others."""
    feed = np.array(PUBLISHED_FEEDS)
    out = np.zeros_like(PUBLISHED)
    for k in range(len(feed)):
        others = np.arange(len(feed)) != k
        out[k] = [np.polyval(np.polyfit(feed[others], of[others], 1), feed[k]) for of in PUBLISHED.T]
    return out - PUBLISHED


def predicted(value, mode, width, chip):
    row = identification.equations(readings([(mode, width, chip, np.zeros(3), 0.0)]), IDENTIFIED_TOOL)
    return row[0, :3] @ value


@pytest.mark.parametrize("cuts", [SLOTS, SIDES, [*SLOTS, *SIDES]], ids=["slots", "sides", "both"])
def test_without_noise_the_coefficients_are_found(cuts):
    found = identified(cuts)
    np.testing.assert_allclose(found.value, TRUE, rtol=2e-3, atol=0.02)
    assert found.residual < 0.2
    if cuts is not SIDES:
        assert found.cross_validation_error < 2e-3
    else:  # without one of two feeds the other cannot separate edge and cut
        assert np.isnan(found.cross_validation_error)


def test_exact_readings_do_not_give_intervals_of_nothing():
    """Forces that were computed with six coefficients, as a user may copy them: no sensor is that exact."""
    exact = [(mode, width, chip, predicted(TRUE, mode, width, chip), 0.0) for mode, width, chip, *_ in [*SLOTS, *SIDES]]
    found = identified(exact, sigma=None)
    assert any("scatter less than any sensor" in text for text in found.warnings)
    assert (found.half_width > 1e-4 * np.abs(TRUE)).all()
    table = tomllib.loads(identification.as_toml(found, IDENTIFIED_TOOL, "measured.csv").decode())["material"]
    assert np.diag(table["covariance"]).min() > 1e-9
    size = np.sqrt(np.diag(table["covariance"]))
    correlation = np.abs(table["covariance"] / np.outer(size, size))
    assert not correlation[(correlation < 1e-6)].any()
    assert table["residual_N"] == 0.0
    real = identification.identify(of_published(), ToolTable(diameter_mm=25, flutes=2), None, "published.csv")
    assert not any("scatter less" in text for text in real.warnings)


def test_published_slots_are_fitted_and_a_feed_left_out_is_predicted():
    """A slot's mean forces are straight lines over the feed: fitted here by numpy, without the package."""
    found = identification.identify(of_published(), ToolTable(diameter_mm=25, flutes=2), None, "published.csv")
    np.testing.assert_allclose(found.value, (959, 251, 146, 15.8, 19.4, 18.2), rtol=0.005)
    off = left_out_of_lines()
    assert found.cross_validation_error == pytest.approx(np.sqrt(np.sum(off**2) / np.sum(PUBLISHED**2)), rel=1e-3)
    assert found.cross_validation_error < 0.1


def test_narrow_intervals_need_no_warning():
    assert identified(SLOTS, sigma=0.1).warnings == ()


def test_a_power_counts_as_much_as_a_force_that_tells_as_much_of_the_tangential_coefficients():
    """Mean force across the feed and power of a full slot: N·a·(c/4·Ktc + Kte/π) and ω·R·N·a·(c/π·Ktc + Kte/2)."""
    found = identified(SLOTS, power=True)
    omega, chip = 2 * np.pi * RPM / 60, np.array(FEEDS)
    watt_per_newton = omega * RADIUS * 1e-3 * np.hypot(chip / np.pi, 0.5) / np.hypot(chip / 4, 1 / np.pi)
    np.testing.assert_allclose(found.sigma[found.component < 3], 3.0)
    np.testing.assert_allclose(found.sigma[found.component == 3], 3.0 * watt_per_newton, rtol=1e-6)


def test_an_unseen_cut_is_predicted_within_three_percent():
    rng, errors = np.random.default_rng(5), []
    for mode, width, chip in (("down", 4.0, 0.07), ("up", 1.0, 0.1), ("slot", np.nan, 0.12)):
        expected = cut(mode, width, chip)[0]
        for _ in range(20):
            value = identified(SLOTS, rng).value
            errors.append(np.linalg.norm(predicted(value, mode, width, chip) - expected) / np.linalg.norm(expected))
    assert np.sqrt(np.mean(np.square(errors))) < 0.03
    assert np.quantile(errors, 0.9) < 0.03


@pytest.mark.parametrize("sigma", [3.0, None], ids=["sigma stated", "sigma from the residual"])
def test_intervals_hold_95_times_of_100(sigma):
    rng, inside = np.random.default_rng(2), []
    for _ in range(300):
        found = identified(SLOTS, rng, sigma=sigma)
        inside.append(np.abs(found.value - TRUE) <= found.half_width)
    assert 0.93 < np.mean(inside) < 0.985


def test_one_feed_cannot_separate_edge_and_cut():
    with pytest.raises(ForceError, match=r"one feed per tooth .* cannot be separated"):
        identified([SLOTS[1], SLOTS[1], SLOTS[1]])


def test_a_force_across_alone_leaves_some_coefficients_open():
    one = readings(SLOTS)
    one.force[:, [0, 2]] = np.nan
    with pytest.raises(ForceError, match="no reading depends on Krc, Kac, Kre, Kae"):
        identification.identify(one, IDENTIFIED_TOOL, None, "measured.csv")


def test_the_sigma_of_forces_from_power_counts_the_coefficients_that_power_does_not_depend_on():
    """Mean forces of slots by coefficients drawn from the covariance, by hand: −N·a·(c/4·Krc + Kre/π) and so on."""
    ktc, krc, kac, kte, kre, kae = TRUE
    prior = machining.Entry(
        Ktc_N_per_mm2=ktc, Krc_N_per_mm2=krc, Kac_N_per_mm2=kac, Kte_N_per_mm=kte, Kre_N_per_mm=kre, Kae_N_per_mm=kae,
        sigma_percent=40.0,
    )  # fmt: skip
    found = identified(SLOTS, forces=False, power=True, prior=prior)
    drawn = np.random.default_rng(5).multivariate_normal(found.value, found.covariance, 20_000)
    chip = np.array(FEEDS)[:, None]

    def slot_forces(coefficient):
        """Fx, Fy, Fz (3, n, k) [N] of n feeds by k sets of coefficients (k, 6)."""
        ktc, krc, kac, kte, kre, kae = coefficient.T
        x, y = -(chip / 4 * krc + kre / np.pi), chip / 4 * ktc + kte / np.pi
        return TEETH * DEPTH * np.array([x, y, chip / np.pi * kac + kae / 2])

    force = slot_forces(found.value[None])
    spread = np.sqrt(np.sum(np.mean((slot_forces(drawn) - force) ** 2, axis=2)) / np.sum(force**2))
    assert found.sigma_percent == pytest.approx(100 * spread, rel=0.03)
    assert found.sigma_percent > 8.0
    assert identified(SLOTS).sigma_percent == 2.0


def test_power_gives_the_tangential_coefficients_and_the_rest_is_from_the_process():
    prior = machining.table()["al_6082_t6_carbide"]
    found = identified(SLOTS, forces=False, power=True, prior=prior)
    np.testing.assert_allclose(found.value[[0, 3]], TRUE[[0, 3]], rtol=1e-3)
    np.testing.assert_allclose(found.value[[1, 2, 4, 5]], [99.0, 273.0, 10.0, 2.8])
    assert found.identified.tolist() == [True, False, False, True, False, False]
    assert "taken from [material] of the process" in found.warnings[0]
    with pytest.raises(ForceError, match="no reading depends on Krc"):
        identified(SLOTS, forces=False, power=True)


def test_m4_mirrors_the_force_across():
    mirrored = readings(SLOTS)
    mirrored.force[:, 1] *= -1.0
    left = ToolTable(diameter_mm=10, flutes=TEETH, spindle="M4")
    np.testing.assert_allclose(identification.identify(mirrored, left, None, "").value, TRUE, rtol=2e-3, atol=0.02)


def test_readings_worse_than_stated_widen_the_intervals():
    rng = np.random.default_rng(1)
    wide, narrow = identified(SLOTS, rng, noise=15.0), identified(SLOTS, rng)
    assert (wide.half_width > 1.5 * narrow.half_width).all()
    assert any("times as much as sigma_N" in text for text in wide.warnings)


def written(path, cuts, **columns):
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["mode", "ap_mm", "ae_mm", "rpm", "feed_mm_per_min", "Fx", "Fy", "Fz", "sigma_N"])
        for mode, width, chip, force, _ in cuts:
            ae = "" if mode == "slot" else f"{width}"
            out.writerow([mode, DEPTH, ae, RPM, chip * RPM * TEETH, *(f"{value:.3f}" for value in force), 3])


def test_from_readings_to_a_process(tmp_path):
    """What is written is a material that a process takes by its file, and forces computed with it are the measured."""
    written(tmp_path / "cuts.csv", [*SLOTS, *SIDES])
    (tmp_path / "tool.toml").write_text(f"[tools.1]\n{tool(10, 4)}")
    made = ("identify", "forces", tmp_path / "cuts.csv", "--process", tmp_path / "tool.toml", "-o", tmp_path / "m.toml")
    assert "Ktc 767" in printed(*made)
    material = tomllib.loads((tmp_path / "m.toml").read_text())["material"]
    assert set(material["ci95"]) == set(identification.NAMES)
    assert np.array(material["covariance"]).shape == (6, 6)
    page = (tmp_path / "m.html").read_text()
    assert 'id="fit-Fx"' in page
    printed(*made)  # its own file is replaced
    (tmp_path / "process.toml").write_text(
        process(tool(10, 4), ((0, 100), (-40, 40), (-20, 0)), material='file = "m.toml"')
    )
    law = machining.load(tmp_path / "process.toml").law()
    np.testing.assert_allclose(np.array(law.cutting) / 1e6, TRUE[:3], rtol=2e-3)
    assert law.sigma == pytest.approx(0.02)


def test_proposed_cuts_are_a_program_of_the_process(tmp_path):
    box = ((0, 100), (0, 100), (-20, 0))
    (tmp_path / "process.toml").write_text(process(tool(10, 4), box))
    arguments = ("--process", tmp_path / "process.toml", "-o", tmp_path / "part.nc")
    printed("identify", "forces", "--propose", *arguments)
    printed("identify", "forces", "--propose", *arguments, code=1)
    import postproc

    program = postproc.read_program(tmp_path / "part.nc", ROBOT, CELL)
    assert len(np.unique(program.motions.feed[~program.motions.rapid].round(6))) == 6
    rows = list(csv.DictReader((tmp_path / "part.csv").read_text().splitlines()))
    assert [row["mode"] for row in rows] == ["slot"] * 5
    with (tmp_path / "part.csv").open("w", newline="") as file:
        out = csv.DictWriter(file, rows[0])
        out.writeheader()
        for row in rows:
            chip = float(row["feed_mm_per_min"]) / float(row["rpm"]) / TEETH
            force = cut("slot", None, chip, float(row["ap_mm"]))[0]
            out.writerow(row | dict(zip(("Fx", "Fy", "Fz"), force, strict=True)) | {"sigma_N": 3})
    assert "Ktc 76" in printed("identify", "forces", tmp_path / "part.csv", *arguments[:2], "-o", tmp_path / "m.toml")


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ("side,3,,6000,900,1,2,3", "unknown mode 'side'"),
        ("up,3,,6000,900,1,2,3", "without ae_mm"),
        ("slot,3,,0,900,1,2,3", "larger than 0"),
    ],
)
def test_rows_that_cannot_be_used(tmp_path, row, told):
    (tmp_path / "cuts.csv").write_text(f"mode,ap_mm,ae_mm,rpm,feed_mm_per_min,Fx,Fy,Fz\n{row}\n")
    with pytest.raises(ForceError, match=told):
        identification.read(tmp_path / "cuts.csv")


def test_a_ball_is_refused(tmp_path):
    (tmp_path / "process.toml").write_text(process(tool(10, 2, "ball"), ((0, 9), (0, 9), (-9, 0))))
    with pytest.raises(ForceError, match="is a ball tool"):
        identification.tool_of(machining.load(tmp_path / "process.toml"), "1")


def test_the_tool_of_a_measurement_may_have_a_name(tmp_path):
    text = process(tool(10, 2), ((0, 9), (0, 9), (-9, 0)))
    (tmp_path / "process.toml").write_text(text.replace("[tools.1]", f"[tools.2]\n{tool(20, 4)}\n[tools.tMill]"))
    assert identification.tool_of(machining.load(tmp_path / "process.toml"), "TMILL")[1].diameter_mm == 10.0


def test_the_program_of_a_slot_makes_the_force_of_the_equations(tmp_path):
    """The same frame and signs as `postproc forces`."""
    from tests.machining.setting import forces, line_of, on_line

    text = gcode("G0 X-10 Y0 Z5", "G1 Z-3 F2400", "X110 F1440")
    program, found = forces(tmp_path, text, process(tool(10, 4), ((0, 100), (-40, 40), (-20, 0))))
    own = on_line(program, found, line_of(text, "X110 F1440"), 0.5)[:3]
    np.testing.assert_allclose(predicted(TRUE, "slot", np.nan, 0.06), own, rtol=1e-3)


def test_fewer_readings_than_coefficients_are_refused():
    """Two forces along the feed tell four coefficients no more than two combinations of them."""
    few = readings([SLOTS[0], SLOTS[-1]])
    few.force[:, 1:] = np.nan
    few.force[1, 1] = SLOTS[-1][3][1]
    with pytest.raises(ForceError, match="these readings do not separate Ktc, Kte"):
        identification.identify(few, IDENTIFIED_TOOL, None, "measured.csv")
