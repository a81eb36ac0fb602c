"""The written program, as printed, in a cell simulator that shares no code with the package: does it cut the part?

Forces between targets are recomputed here from the rules of the format (ramp of 1 mm), not taken from the package.
"""

from __future__ import annotations

import numpy as np
import pytest

from postproc import cell as cells
from postproc import correction, report, robot
from tests.cells import sample
from tests.correction.simulated import MICROMETRE, check_targets, rows_of, simulator, written
from tests.corrections import correct_files, process_files, read_files
from tests.kr270 import CELL
from tests.places import SAMPLES


def test_pocket_with_arcs_stands_within_a_micrometre_at_every_target():
    data = (SAMPLES / "pocket.nc").read_bytes()
    result = correct_files({"pocket.nc": data})
    assert not result.failed
    check_targets(result, simulator("cell_kr270.toml"), written(result), every=9)


def test_krl_with_inline_forms_and_named_points_stands_within_a_micrometre():
    files = {name: (SAMPLES / name).read_bytes() for name in ("inline.src", "inline.dat")}
    result = correct_files(files)
    assert not result.failed
    home = [0, -90, 100, 0, 80, 0]  # [start] of the cell: the controller's own home position is in no file
    check_targets(result, simulator("cell_kr270.toml"), written(result, home), every=1)


CUTS = """%
G21 G90 G17 G94
G0 X0 Y0 Z30
Z2
(FORCE FX=-80 FY=60 FZ=150)
G1 Z-2 F300
(FORCE FX=-380 FY=250 FZ=300 MX=3 MY=-2 MZ=8)
G1 X220 Y0 F1500
(FORCE FX=200 FY=-350 FZ=150 FRAME=TOOL)
G1 X220 Y160
(FORCE FX=-250 FY=180 FZ=90 FRAME=FEED)
G3 X180 Y200 I-40 J0
G1 X40
G2 X0 Y160 Z-6 R40
(FORCE OFF)
G0 Z30
M30
%
"""
# the same path and forces, written down by hand: corners of each cut in mm, force in $BASE axes (None: FEED)
LINES = [
    ((0, 0, 2), (0, 0, -2), (-80, 60, 150, 0, 0, 0)),
    ((0, 0, -2), (220, 0, -2), (-380, 250, 300, 3, -2, 8)),
]


@pytest.mark.parametrize("cell_file", ["cell_kr270.toml", "cell_kr16.toml"])
def test_between_targets_the_path_is_held_within_the_tolerance(cell_file):
    scale = 1.0 if "270" in cell_file else 0.25
    text = CUTS if scale == 1.0 else _scaled(CUTS, scale)
    result = process_files({"cuts.nc": text}, *sample(cell_file))
    assert not result.failed, result.issues
    sim, moves = simulator(cell_file), written(result)
    rows = check_targets(result, sim, moves, every=2)
    shares = (0.15, 0.5, 0.85, 1.0)
    axis_moves = len(moves) - len(rows)
    worst = 0.0
    for index, share, _, q in sim.run(moves, shares):
        row = rows[index - axis_moves]
        cut = {6: 0, 8: 1}.get(int(row["source_line"]))
        if cut is None or share == 1.0:
            continue
        begin, end, force = LINES[cut]
        before = np.zeros(6) if cut == 0 else scale * np.array(LINES[0][2], dtype=float)
        start_t = (
            rows[index - axis_moves - 1]["t"]
            if row["source_line"] == rows[index - axis_moves - 1]["source_line"]
            else 0.0
        )
        t = start_t + share * (row["t"] - start_t)
        length = np.linalg.norm(np.subtract(end, begin))
        ramp = min(1.0, t * length / 1.0)
        wrench = before + ramp * (scale * np.array(force, dtype=float) - before)
        nominal = (np.array(begin) + t * np.subtract(end, begin)) / 1000
        worst = max(worst, float(np.linalg.norm(sim.tip(moves[index], q, wrench) - nominal)))
    assert 0.0 < worst <= 0.010e-3


def _scaled(text, factor):
    import re

    return re.sub(r"(F[XYZ]|M[XYZ])=(-?[\d.]+)", lambda m: f"{m[1]}={float(m[2]) * factor:g}", text)


def test_feed_force_on_the_arc_is_the_one_the_simulator_derives():
    result = correct_files({"cuts.nc": CUTS})
    arc = [row for row in rows_of(result) if row["source_line"] == 12 and row["t"] > 0.2]
    assert len(arc) >= 2
    for row in arc:
        angle = row["t"] * np.pi / 2  # from +X towards +Y about (180, 160)
        travel = np.array([-np.sin(angle), np.cos(angle)])
        across = np.array([-travel[1], travel[0]])  # z × x, z up along the spindle
        expected = -250 * travel + 180 * across
        np.testing.assert_allclose([row["Fx"], row["Fy"], row["Fz"]], [*expected, 90], atol=1e-3)


def test_zero_force_gives_the_same_krl_byte_for_byte():
    for names in (("inline.src", "inline.dat"), ("long_lin.src",)):
        files = {name: (SAMPLES / name).read_bytes() for name in names}
        quiet = {
            name: b"\n".join(line for line in data.split(b"\n") if b"FORCE" not in line) for name, data in files.items()
        }
        cell = "cell_kr16.toml" if names == ("long_lin.src",) else "cell_kr270.toml"
        result = process_files(quiet, *sample(cell))
        assert not result.failed, result.issues
        assert {d.name: d.to_bytes() for d in result.documents} == quiet


def test_nominal_krl_from_gcode_stands_on_the_nominal_path_without_force():
    result = correct_files({"cuts.nc": CUTS}, mode="nominal")
    sim = simulator("cell_kr270.toml")
    rows, moves = rows_of(result), written(result)
    for index, _, pose, _ in sim.run(moves):
        row = rows[index - (len(moves) - len(rows))]
        np.testing.assert_allclose(pose[:3, 3] * 1000, [row[k] for k in "XYZ"], atol=1e-4)
    assert result.path_deviation > 1e-4


def test_a_force_wrong_by_one_percent_is_seen_by_the_oracle():
    """Proof that the checks above can fail."""
    result = correct_files({"cuts.nc": CUTS})
    sim, moves, rows = simulator("cell_kr270.toml"), written(result), rows_of(result)
    off = []
    for index, _, _, q in sim.run(moves):
        row = rows[index - (len(moves) - len(rows))]
        wrench = 1.01 * np.array([row[k] for k in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")])
        off.append(np.linalg.norm(sim.tip(moves[index], q, wrench) * 1000 - [row[k] for k in "XYZ"]))
    assert max(off) > 2e-3


def test_the_written_program_sets_base_and_tool_of_the_cell():
    result = correct_files({"cuts.nc": CUTS})
    sim = simulator("cell_kr270.toml")
    assert (sim.base, sim.tool) == ((1500, -200, 700, 0, 0, 0), (0, 0, 350, 0, 0, 0))
    assert {(move["base"], move["tool"]) for move in written(result) if "frame" in move} == {(sim.base, sim.tool)}


CORNER = """G21 G90 G17
G0 X10 Y10 Z2
(FORCE FX=0 FY=1 FZ=100 FRAME=BASE)
G1 Z-1 F600
G1 X60 F1500
(FORCE FX=-1500 FY=1800 FZ=300 FRAME=FEED)
G3 X65.5 Y15.5 I0 J5.5
(FORCE OFF)
G0 Z30
M2
"""


@pytest.mark.parametrize("linearize", [False, True])
def test_the_ramp_of_a_feed_force_on_a_small_arc_is_held_between_targets_too(linearize):
    """Travel and force turn while the force grows: the hardest piece of a path."""
    result = correct_files({"corner.nc": CORNER}, linearize_arcs=linearize)
    assert not result.failed, result.issues
    sim, moves, rows = simulator("cell_kr270.toml"), written(result), rows_of(result)
    axis_moves, worst, begin = len(moves) - len(rows), 0.0, 0.0
    for index, share, _, q in sim.run(moves, (0.25, 0.5, 0.75, 1.0)):
        row = rows[index - axis_moves]
        if row["source_line"] != 7:
            continue
        before = rows[index - axis_moves - 1]
        begin = before["t"] if before["source_line"] == 7 else 0.0
        t = begin + share * (row["t"] - begin)
        angle = t * np.pi / 2 - np.pi / 2  # about (60, 15.5), from below
        nominal = np.array([60 + 5.5 * np.cos(angle), 15.5 + 5.5 * np.sin(angle), -1.0]) / 1000
        travel = np.array([-np.sin(angle), np.cos(angle)])
        own = np.array([*(-1500 * travel + 1800 * np.array([-travel[1], travel[0]])), 300.0])
        grown = min(1.0, t * 5.5 * np.pi / 2)
        force = np.array([0.0, 1.0, 100.0]) + grown * (own - [0.0, 1.0, 100.0])
        tip = sim.tip(moves[index], q, np.array([*force, 0.0, 0.0, 0.0]))
        worst = max(worst, float(np.linalg.norm(tip - nominal)))
    assert 0.0 < worst <= 0.010e-3


def test_a_tool_that_gives_way_is_corrected_and_told_apart():
    import msgspec

    soft = msgspec.structs.replace(CELL, tool_compliance=cells.ToolCompliance(X_um_per_N=0.2, Y_um_per_N=0.2))
    model = robot.load(robot.find(CELL.robot))
    text = "G21 G90 G17\nG0 X0 Y0 Z20\n(FORCE FX=300 FZ=100)\nG1 Z0 F600\nG1 X60\nG3 X60 Y40 I0 J20\nG0 Z20\nM2\n"
    program = read_files({"part.nc": text}, soft, model)
    result, rigid = (correction.process(program, model, each) for each in (soft, CELL))
    cutting = ~result.rapid
    np.testing.assert_allclose(result.deflection_by_tool[cutting][:, 0], 60e-6, rtol=1e-3)  # 300 N · 0.2 µm/N
    assert result.after[cutting].max() < MICROMETRE
    assert report.summary(result).tool_deflection.max_mm == pytest.approx(0.06, rel=1e-3)
    assert report.summary(rigid).tool_deflection is None
    end = np.flatnonzero(result.t == 1.0)[-2], np.flatnonzero(rigid.t == 1.0)[-2]
    more = result.deflection[end[0]] - rigid.deflection[end[1]]
    np.testing.assert_allclose(more, result.deflection_by_tool[end[0]], atol=1e-7)
