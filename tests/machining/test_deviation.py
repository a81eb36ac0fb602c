"""Standard deviations of computed forces: covariance of identified coefficients, rubbing of the end face on ramps."""

from __future__ import annotations

import math

import numpy as np
import pytest

from postproc.errors import ForceError
from postproc.machining import cutting
from tests.machining.setting import AL7075, forces, gcode, line_of, process, tool

BOX = ((0, 100), (-40, 40), (-20, 0))
KEYS = ("Ktc_N_per_mm2", "Krc_N_per_mm2", "Kac_N_per_mm2", "Kte_N_per_mm", "Kre_N_per_mm", "Kae_N_per_mm")
VALUES = np.array([AL7075[k] for k in (0, 2, 4, 1, 3, 5)])


@pytest.fixture
def exact_map(monkeypatch):
    """Standard deviations without that by the cells of the map."""
    monkeypatch.setattr(cutting, "CELL_ERROR_SHARE", 0.0)
    monkeypatch.setattr(cutting, "WALL_ERROR", 0.0)


def six(values):
    return "\n".join(f"{key} = {value!r}" for key, value in zip(KEYS, values.tolist(), strict=True))


def knots(folder, text, cutter, material, line, **options):
    program, found = forces(folder, text, process(cutter, BOX, 0.5, material), **options)
    (motion,) = np.flatnonzero(program.motions.line == line)
    rows = found.knots.motion == motion
    return found.knots.t[rows], found.knots.wrench[rows], found.knots.sigma[rows]


@pytest.mark.parametrize("base_axes", [False, True])
@pytest.mark.parametrize("cutter", [tool(10, 4), tool(10, 4, "ball")], ids=["flat", "ball"])
def test_the_covariance_of_identified_coefficients_is_that_of_the_forces(exact_map, tmp_path, cutter, base_axes):
    """Against differences of forces with coefficients that differ: forces are linear in them."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6)) * (0.1 * VALUES + 0.5)[:, None]
    covariance = root @ root.T
    rows = ", ".join(str(row) for row in covariance.tolist())
    (tmp_path / "material.toml").write_text(f"[material]\n{six(VALUES)}\nsigma_percent = 10.0\ncovariance = [{rows}]\n")
    block = "X90 (here)"
    text = gcode("G0 X-10 Y-38.2 Z5", "G1 Z-3 F2400", block)
    line = line_of(text, block)
    options = {"base_axes": base_axes}
    t, wrench, sigma = knots(tmp_path, text, cutter, 'file = "material.toml"', line, **options)
    middle = int(np.argmin(np.abs(t - 0.6)))
    each = []
    for k in range(6):
        other = VALUES.copy()
        other[k] += 1.0
        t_, wrench_, _ = knots(tmp_path, text, cutter, six(other), line, **options)
        at = np.array([np.interp(t[middle], t_, column) for column in wrench_.T])
        each.append(at - wrench[middle])
    expected = np.sqrt(np.einsum("ki,kl,li->i", each, covariance, each))
    np.testing.assert_allclose(sigma[middle, :3], expected[:3], rtol=0.03, atol=0.03)
    np.testing.assert_allclose(sigma[middle, 3:], expected[3:], rtol=0.03, atol=1e-3)


@pytest.mark.parametrize(
    "covariance",
    ["[[1.0]]", str([[1.0] * 6] * 5), str((-np.eye(6)).tolist()), str((np.eye(6) + np.eye(6, k=1)).tolist())],
    ids=["small", "five rows", "negative", "not symmetric"],
)
def test_what_is_no_covariance_is_refused(tmp_path, covariance):
    (tmp_path / "material.toml").write_text(f"[material]\n{six(VALUES)}\ncovariance = {covariance}\n")
    with pytest.raises(ForceError, match="no covariance of six coefficients"):
        knots(tmp_path, gcode("G0 X-10 Y0 Z5", "G1 Z-3 F2400", "X90"), tool(10, 4), 'file = "material.toml"', 6)


def test_rubbing_of_the_end_face_on_a_ramp_is_within_the_bound(tmp_path):
    """From the share of the sine of the slope to all of the face, which presses with N R Kre along the spindle."""
    block = "X90 Z-4 (here)"
    text = gcode("G0 X10 Y0 Z5", "G1 Z0 F2400", block)
    material = six(VALUES) + "\nsigma_percent = 0.0"
    t, wrench, sigma = knots(tmp_path, text, tool(10, 4), material, line_of(text, block))
    middle = int(np.argmin(np.abs(t - 0.5)))
    sine = 4 / math.hypot(80, 4)
    whole = 4 * 5.0 * AL7075[3]
    least, most = wrench[middle, 2], wrench[middle, 2] + (1.0 - sine) * whole
    assert sigma[middle, 2] == pytest.approx((most - least) / math.sqrt(3.0), rel=0.01)
    assert wrench[middle, 2] + 1.96 * sigma[middle, 2] >= most


def test_level_cuts_and_plunges_have_no_such_range(exact_map, tmp_path):
    text = gcode("G0 X10 Y0 Z5", "G1 Z-3 F600 (down)", "X90 F2400 (level)")
    material = six(VALUES) + "\nsigma_percent = 0.0"
    for block in ("G1 Z-3 F600 (down)", "X90 F2400 (level)"):
        _, wrench, sigma = knots(tmp_path, text, tool(10, 4), material, line_of(text, block))
        assert np.abs(wrench).max() > 10.0
        assert sigma[1:].max() == 0.0


# Ff and FT, FM of Machinery's Handbook, 31st ed., p. 1153, Tables 8 and 9, SI units: by feed, by diameter
FEED_FACTOR = {0.05: 0.091, 0.15: 0.219, 0.3: 0.382}
THRUST_FACTOR, TORQUE_FACTOR = {3.2: 2.54, 8.0: 5.28, 16.0: 9.19}, {3.2: 8.12, 8.0: 42.22, 16.0: 147.0}


def handbook(diameter, feed, a, b, j):
    """Torque [N·mm] and thrust [N] of p. 1152 for Kd = 7000 and W = 1; A, B, J of Table 7 for the chisel edge."""
    k, f = 7000.0, FEED_FACTOR[feed]
    thrust = 0.05 * k * f * THRUST_FACTOR[diameter] * b + 0.007 * k * diameter**2 * j
    return 25e-6 * k * f * TORQUE_FACTOR[diameter] * a * 1e3, thrust


def tungaloy(diameter, feed, k=1.01):
    return 10.0 * k * diameter**2 * (0.630 + 16.84 * feed), 570.0 * k * diameter * feed**0.85


PUBLISHED = {
    "Mitsubishi, Drilling forces": (10.0, 0.3, (15e3, 2500.0)),
    "Machinery's Handbook, standard point, 3.2 mm": (3.2, 0.05, handbook(3.2, 0.05, 1.085, 1.355, 0.030)),
    "Machinery's Handbook, standard point, 8 mm": (8.0, 0.15, handbook(8.0, 0.15, 1.085, 1.355, 0.030)),
    "Machinery's Handbook, standard point, 16 mm": (16.0, 0.3, handbook(16.0, 0.3, 1.085, 1.355, 0.030)),
    "Machinery's Handbook, split point, 8 mm": (8.0, 0.15, handbook(8.0, 0.15, 1.0, 1.1, 0.001)),
    "Tungaloy general catalogue 2020-2021, p. L068": (8.0, 0.15, tungaloy(8.0, 0.15)),
}


@pytest.mark.parametrize(("diameter", "feed", "published"), PUBLISHED.values(), ids=PUBLISHED)
def test_published_thrusts_of_drills_are_inside_the_bound(tmp_path, diameter, feed, published):
    """With the kc of the torque that is published with them, and without any other uncertainty."""
    torque, thrust = published
    material = f"Ktc_N_per_mm2 = {8.0 * torque / (feed * diameter**2)}\nsigma_percent = 0.0"
    block = f"G1 Z-12 F{1000 * feed} (here)"
    text = gcode("G0 X50 Y0 Z5", block, spindle="S1000 M3")
    t, wrench, sigma = knots(tmp_path, text, tool(diameter, 2, "drill"), material, line_of(text, block))
    middle = int(np.argmin(np.abs(t - 0.8)))
    assert wrench[middle, 5] == pytest.approx(1e-3 * torque, rel=0.01)
    assert wrench[middle, 2] == pytest.approx(thrust, rel=0.6)
    assert abs(wrench[middle, 2] - thrust) < 1.96 * sigma[middle, 2]
    assert 1.96 * sigma[middle, 2] < 0.45 * wrench[middle, 2]
    assert not sigma[middle, [0, 1, 3, 4, 5]].any()


def test_the_deviation_by_cells_is_its_own_and_a_coarse_map_gets_a_warning(tmp_path):
    """A ball 0.05 mm deep: with four times as many cells half of it; with the advised cells no warning.

    The material cuts so hard that the error is more than 2 N.
    """
    text = gcode("G0 X-10 Y0 Z5", "G1 Z-0.05 F2400", "X110 (here)")
    share, advice = [], ""
    material = "Ktc_N_per_mm2 = 40e3\nKrc_N_per_mm2 = 1e4\nKac_N_per_mm2 = 1e4\nsigma_percent = 0.0"
    for cell in (0.25, 0.125):
        _, found = forces(tmp_path, text, process(tool(6, 2, "ball"), BOX, cell, material))
        row = int(np.argmax(found.knots.wrench[:, 2]))
        share.append(np.linalg.norm(found.knots.sigma[row, :3]) / np.linalg.norm(found.knots.wrench[row, :3]))
        assert not found.knots.factor.any()
        (issue,) = [issue.message for issue in found.issues if issue.kind == "coarse-stock"] or [""]
        advice = advice or issue
    area = 0.5 * math.pi * 2 * 3.0 * 0.05  # half a cap of the ball
    assert share[0] == pytest.approx(0.2 * 0.25 / math.sqrt(area), rel=0.15)
    assert share[1] == pytest.approx(0.5 * share[0], rel=0.1)
    finer = float(advice.split("resolution_mm = ")[1].split(",")[0])
    _, found = forces(tmp_path, text, process(tool(6, 2, "ball"), BOX, finer, material))
    assert "coarse-stock" not in {issue.kind for issue in found.issues}
