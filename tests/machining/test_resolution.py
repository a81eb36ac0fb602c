"""Cells of the map follow tool and depth of cut: passes whose contact is few cells wide get finer ones."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.machining import stock as stocks
from postproc.machining.tool import Cutter
from tests.machining.setting import AL7075, forces, gcode, line_of, process, tool

BOX = ((0, 20), (0, 12), (-20, 0))
BALL = tool(6, 2, "ball")
ROUGH = [f"G0 X-5 Y{y}\nG0 Z-2.95\nG1 X25 F1000\nG0 Z5" for y in range(1, 10)]
FINISH = [f"G0 X-5 Y{y:.1f}\nG0 Z-3\nG1 X25 F1000 (finish {k})\nG0 Z5" for k, y in enumerate(np.arange(1.5, 8.6, 0.5))]


def without_resolution(text):
    return "".join(line for line in text.splitlines(keepends=True) if "resolution_mm" not in line)


HARD = "Ktc_N_per_mm2 = 40e3\nKrc_N_per_mm2 = 1e4\nKac_N_per_mm2 = 1e4\nsigma_percent = 5.0"
"""A material so hard that the error of thin passes by the cells is more than 2 N."""


def cell_of(folder, *blocks, material=HARD):
    text = gcode("G0 Z5", *(line for block in blocks for line in block.splitlines()))
    _, found = forces(folder, text, without_resolution(process(BALL, BOX, material=material)))
    assert "coarse-stock" not in {issue.kind for issue in found.issues}
    return found.stock.cell


def test_a_tool_that_roughs_and_then_finishes_gets_finer_cells_in_the_finishing_passes_alone(tmp_path):
    assert cell_of(tmp_path, *ROUGH) == pytest.approx(0.25e-3)
    assert cell_of(tmp_path, *ROUGH, *FINISH) < 0.2e-3
    assert cell_of(tmp_path, *FINISH[:1]) == pytest.approx(0.25e-3)  # deep: from the top of the block


def test_the_map_is_finer_in_the_thin_passes_only(tmp_path, monkeypatch):
    ranges = []
    run = stocks.refine
    monkeypatch.setattr(
        stocks, "refine", lambda stock, factor: ranges.append((stock.cell, factor)) or run(stock, factor)
    )
    cell = cell_of(tmp_path, *ROUGH, *FINISH)
    assert ranges == [(pytest.approx(0.25e-3), round(0.25e-3 / cell))]


def test_a_program_of_thin_passes_alone_has_one_fine_map(tmp_path):
    skin = [block.replace("Z-3", "Z-0.1") for block in FINISH]
    assert cell_of(tmp_path, *skin) < 0.2e-3


def test_passes_whose_force_hardly_moves_a_robot_keep_their_cells(tmp_path):
    """Aluminium, 0.1 mm deep: the force is known to 10 %, which is less than 2 N."""
    skin = [block.replace("Z-3", "Z-0.1") for block in FINISH]
    aluminium = 'name = "al_7075_t6_carbide"\nsigma_percent = 5.0'
    assert cell_of(tmp_path, *skin, material=aluminium) == pytest.approx(0.25e-3)


def test_a_force_whose_material_is_not_known_keeps_its_cells(tmp_path):
    """The error by the cells is 10 %, that by the material 100 %."""
    skin = [block.replace("Z-3", "Z-0.1") for block in FINISH]
    unknown = HARD.replace("sigma_percent = 5.0", "sigma_percent = 100.0")
    assert cell_of(tmp_path, *skin, material=unknown) == pytest.approx(0.25e-3)


def test_a_resolution_that_is_given_is_kept_and_the_warning_names_the_first_thin_pass(tmp_path):
    text = gcode("G0 Z5", *(line for block in (*ROUGH, *FINISH) for line in block.splitlines()))
    _, found = forces(tmp_path, text, process(BALL, BOX, 0.25, HARD))
    assert found.stock.cell == pytest.approx(0.25e-3)
    (issue,) = [issue for issue in found.issues if issue.kind == "coarse-stock"]
    assert issue.source_line is not None
    assert line_of(text, "G1 X25 F1000") < issue.source_line <= line_of(text, "G1 X25 F1000 (finish 4)")
    assert "resolution_mm" in issue.message


def test_forces_of_roughing_passes_are_not_changed_by_finishing_passes_after_them(tmp_path):
    wrenches = []
    for blocks in (ROUGH, (*ROUGH, *FINISH)):
        text = gcode("G0 Z5", *(line for block in blocks for line in block.splitlines()))
        program, found = forces(tmp_path, text, without_resolution(process(BALL, BOX, material=HARD)))
        rows = np.flatnonzero(~program.motions.rapid)[: len(ROUGH)]
        wrenches.append(found.cuts.wrench[np.isin(found.cuts.motion, rows)])
    np.testing.assert_array_equal(*wrenches)


def test_a_finer_map_has_the_volume_and_the_surface_of_the_grooves(tmp_path):
    """Against the closed form of two grooves of a ball and the ridge between them."""
    radius, cell = 3e-3, 0.25e-3
    stock = stocks.from_box(np.array([0.0, 0.0, -0.01]), np.array([0.02, 0.012, 0.0]), cell)
    begin = np.array([[-0.005, 0.0045, -1e-3], [-0.005, 0.0063, -1e-3]])
    stocks.remove(stock, Cutter(radius, radius, 2), begin, begin + np.array([0.03, 0.0, 0.0]))
    fine = stocks.refine(stock, 3)
    assert fine.cell == pytest.approx(cell / 3)
    assert fine.bounds == pytest.approx(stock.bounds)
    y = fine.y + fine.cell * (np.arange(fine.high.shape[0]) + 0.5)
    low = np.sqrt(np.maximum(radius**2 - np.square(y[:, None] - begin[:, 1]), 0.0)).max(axis=1)
    exact = np.minimum(radius - 1e-3 - low, 0.0)
    inside = np.abs(y - 0.0054) < 2.8e-3  # but for the shoulders, where the block's top begins
    row = fine.high[:, fine.high.shape[1] // 2]
    np.testing.assert_allclose(row[inside], exact[inside], atol=6e-6)  # planes touch a round of 3 mm within 0.18 mm
    assert fine.volume() == pytest.approx(stock.volume(), rel=1e-4)


def test_a_map_that_would_have_too_many_cells_is_not_made_finer():
    from postproc.machining.resolution import ThinPasses, cell_divisors

    thin = [ThinPasses(7, 0, 0.12, 2.4)]
    assert cell_divisors(thin, 100_000, [0]) == {7: 3}
    assert cell_divisors(thin, 2_500_000, [0]) == {7: 2}
    assert cell_divisors(thin, 12_000_000, [0]) == {}


def test_on_steep_surfaces_cells_are_fine_from_the_start_of_the_set_up():
    """A coarse map does not know where a steep surface was before the pass."""
    from postproc.machining.resolution import ThinPasses, cell_divisors

    passes = ((7, 2.4, False), (9, 4.4, True), (30, 2.4, True))
    thin = [ThinPasses(first, 0, 0.3, excess, is_steep=is_steep) for first, excess, is_steep in passes]
    assert cell_divisors(thin, 100_000, [0, 20]) == {7: 3, 0: 5, 20: 3}
    assert cell_divisors([*thin[1:], ThinPasses(12, 0, 0.3, 6.4, is_steep=True)], 100_000, [0]) == {0: 7}


@pytest.mark.parametrize("depth", [2.0, 12.0])
def test_the_stated_error_of_a_thin_layer_on_a_wall_does_not_fall_with_its_depth(tmp_path, depth):
    """A wall is one row of cells, whatever its height. Layers of 0.1 mm beside slots, at angles to the cells."""
    box = ((-40, 40), (-40, 40), (-20, 0))
    errors, stated = [], []
    for angle, offset in ((0.3, 0.1), (0.9, -0.4), (1.9, 0.7), (2.6, 0.3)):
        along, left = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        blocks = []
        for aside in (offset, offset + 0.1):
            begin, end = (aside * left + side * 60.0 * along for side in (-1.0, 1.0))
            blocks += ["G0 Z5", f"G0 X{begin[0]:.5f} Y{begin[1]:.5f}", f"G0 Z{-depth}"]
            blocks.append(f"G1 X{end[0]:.5f} Y{end[1]:.5f} F1200")
        material = 'name = "al_7075_t6_carbide"\nsigma_percent = 0.0'
        _, found = forces(tmp_path, gcode("G0 Z5", *blocks), process(tool(12, 3), box, material=material))
        cuts = found.cuts
        inner = (cuts.motion == cuts.motion.max()) & (np.abs(cuts.t - 0.5) < 0.1)
        errors.append(cuts.wrench[inner, :3] - layer_force(0.1, depth))
        stated.append(cuts.deviation[inner, :3])
    errors, stated = np.concatenate(errors), np.concatenate(stated)
    assert np.sqrt(np.mean(errors**2)) < 1.3 * np.sqrt(np.mean(stated**2))
    assert np.mean(np.abs(errors) < 1.96 * stated) > 0.9


def layer_force(width, depth):
    """Mean force (3,) [N] of up-milling with a D12 of 3 teeth at 1200 mm/min and 6000/min: x along the feed, z up."""
    ktc, kte, krc, kre, kac, kae = AL7075
    phi = (np.arange(4000) + 0.5) / 4000 * np.arccos(1.0 - width / 6.0)
    chip = 1200.0 / 6000.0 / 3.0 * np.sin(phi)
    tangential, radial, axial = ktc * chip + kte, krc * chip + kre, kac * chip + kae
    force = np.stack([
        -tangential * np.cos(phi) - radial * np.sin(phi), tangential * np.sin(phi) - radial * np.cos(phi), axial
    ])  # fmt: skip
    return 3.0 / (2.0 * np.pi) * depth * force.mean(axis=1) * (phi[-1] + 0.5 * (phi[1] - phi[0]))
