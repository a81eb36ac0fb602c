"""What cannot be used is told: what is wrong, where, and what to do."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from msgspec.structs import replace

from postproc.cell import Rotary, Tool
from postproc.errors import ForceError
from postproc.machining import stock
from postproc.report import process_forces
from tests.commands import printed
from tests.kr270 import CELL
from tests.machining.setting import forces, gcode, process, tool
from tests.places import CELL_FILE

BOX = ((0, 100), (-40, 40), (-20, 0))
SLOT = ("G0 X-10 Y0 Z5", "G1 Z-3 F2400", "X110")


def refused(folder, text, process_text=None, **options):
    with pytest.raises(ForceError) as caught:
        forces(folder, text, process_text or process(tool(10, 4), BOX, 1.0), **options)
    return str(caught.value)


def test_stock_elsewhere(tmp_path):
    told = refused(tmp_path, gcode(*SLOT), process(tool(10, 4), ((500, 600), (0, 80), (-20, 0)), 1.0))
    assert "never touches the stock" in told
    assert "the stock within X 500 … 600, Y 0 … 80, top Z 0 mm" in told


def test_the_extents_of_a_stock_are_those_of_its_box_whatever_is_rounded():
    for low, high, cell in itertools.product((-7.0, -5.0, 0.1), (70.0, 80.0), (0.25, 0.3, 0.5)):
        corners = np.array([[low, -30.0, -20.0], [high, 60.0, 0.0]]) * 1e-3
        bounds = np.array(stock.from_box(*corners, cell * 1e-3).material_bounds) * 1e3
        assert np.abs(bounds - [low, high, -30.0, 60.0]).max() < cell * (1.0 - 1e-6)


def test_no_speed(tmp_path):
    assert "part.nc:3: the spindle is started without a speed" in refused(tmp_path, gcode(*SLOT, spindle="M3"))


def test_no_spindle(tmp_path):
    assert "the spindle is never started" in refused(tmp_path, gcode(*SLOT, spindle="(none)"))


@pytest.mark.parametrize("command", ["forces", "convert"])
def test_an_error_of_the_process_names_the_program_by_its_path(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    Path("jobs").mkdir()
    Path("jobs/part.nc").write_text(gcode(*SLOT, spindle="M3"))
    Path("process.toml").write_text(process(tool(10, 4), BOX, 1.0))
    output = {"forces": "part.csv", "convert": "out"}[command]
    message = printed(command, "jobs/part.nc", "--process", "process.toml", "-o", output, code=1, cell=CELL_FILE)
    assert "Error: jobs/part.nc:3: the spindle is started without a speed" in message.replace("\\", "/")


def test_spindle_off_while_cutting(tmp_path):
    told = refused(tmp_path, gcode(*SLOT[:2], "X50", "M5", "X110"))
    assert "part.nc:8: the tool moves through material while the spindle is off" in told


def test_spindle_off_on_all_cuts_of_one_direction(tmp_path):
    """The first tool cuts tilted; after its change to the second nothing starts the spindle, which cuts upright."""
    five_axes = replace(
        CELL, rotary=Rotary(axes=["C", "B"], kind="tcp"), tools={"1": Tool(Z=300.0), "2": Tool(Z=330.0)}
    )
    tilted = ("G0 B30 C0", "X-20 Y10 Z40", "G1 X20 Z-2 F600", "G0 Z40", "M5", "T2 M6", "G0 B0", "X50", "G1 Z-5")
    tools = process(tool(10, 4), BOX, 1.0).replace("[stock]", f"[tools.2]\n{tool(10, 2, 'ball')}\n[stock]")
    told = refused(tmp_path, gcode(*tilted), tools, cell=five_axes)
    assert "part.nc:12: the tool moves through material while the spindle is off. Start the spindle" in told


def test_the_spindle_is_stopped_before_all_cuts(tmp_path):
    told = refused(tmp_path, gcode("M5", *SLOT))
    assert "part.nc:6: the cuts begin with the spindle off: line 4 stops it. Stop it behind the cuts." in told


@pytest.mark.parametrize(("feed", "is_asked"), [(1900, False), (2100, True)])
def test_a_feed_of_more_than_a_tenth_of_the_tool_for_each_tooth_is_asked_about(tmp_path, feed, is_asked):
    rpm, flutes = 1000, 2
    text = gcode("G0 X-10 Y0 Z5", f"G1 Z-1 F{feed}", "X110", spindle=f"S{rpm} M3")
    _, found = forces(tmp_path, text, process(tool(10, flutes), BOX, 1.0))
    said = [issue.message for issue in found.issues if issue.kind == "chip-load"]
    assert [f"{feed / rpm / flutes:.3g} mm per tooth with a tool of 10 mm" in message for message in said] == [
        True
    ] * is_asked


def test_fast_moves_in_air_are_not_asked_about(tmp_path):
    """The slot is cut at 0.05 mm per tooth; the tool comes down and leaves beside the stock at 10 mm per tooth."""
    text = gcode("G0 X-20 Y0 Z50", "G1 Z-1 F20000", "X120 F100", "Z50 F20000", spindle="S1000 M3")
    _, loads = forces(tmp_path, text, process(tool(10, 2), BOX, 1.0))
    assert loads.removed_volume == pytest.approx(100e-3 * 10e-3 * 1e-3, rel=0.02)
    assert "chip-load" not in {issue.kind for issue in loads.issues}


@pytest.mark.parametrize("shape", ["drill", "flat"])
def test_a_tap_has_no_computed_force(tmp_path, shape):
    """A drill makes two holes, an M8 tap threads one of them: the holes keep their force, the tap has none."""
    holes = ("G0 X20 Y0 Z20", "G81 Z-9 R2 F300", "X40", "G80")
    tap = ("T2 M6", "S500 M3", "G84 X20 Z-8 R2 F625", "G80")
    tools = process(tool(6.8, 2, "drill"), BOX, 0.5).replace("[stock]", f"[tools.2]\n{tool(8, 3, shape)}\n[stock]")
    lines = replace(CELL.gcode, spindle_ccw=["$OUT[2]=TRUE"])
    cell = replace(CELL, tools={"1": Tool(Z=300.0), "2": Tool(Z=300.0)}, gcode=lines)
    drilled, holes_alone = forces(tmp_path, gcode(*holes, spindle="S2000 M3"), tools, cell=cell)
    _, threaded = forces(tmp_path, gcode(*holes, *tap, spindle="S2000 M3"), tools, cell=cell)
    thrust = np.abs(threaded.cuts.wrench[:, 2])
    is_tap = threaded.cuts.motion >= len(drilled.motions)
    assert is_tap.any()
    assert thrust[is_tap].max() == 0.0
    assert threaded.power[len(drilled.motions) :].max() == 0.0
    np.testing.assert_array_equal(thrust[~is_tap], np.abs(holes_alone.cuts.wrench[:, 2]))
    (warning,) = [issue for issue in threaded.issues if issue.kind == "tap-force"]
    assert (warning.level, warning.source_line) == ("warning", gcode(*holes, *tap).splitlines().index(tap[2]) + 1)
    assert "[operations.T2]" in warning.message
    assert {"drilled-by-mill", "little-cut"}.isdisjoint(issue.kind for issue in threaded.issues)


def test_a_tool_that_is_not_described(tmp_path):
    told = refused(tmp_path, gcode(*SLOT).replace("T1 M6", "T7 M6"))
    assert "part.nc:5: tool T7 is not in" in told
    assert "Give [tools.7]; found: [tools.1]" in told


def test_no_tool_number_takes_the_only_tool_but_not_one_of_two(tmp_path):
    text = gcode(*SLOT).replace("T1 M6\n", "")
    forces(tmp_path, text, process(tool(10, 4), BOX, 1.0))
    two = process(tool(10, 4), BOX, 1.0).replace("[stock]", "[tools.2]\n" + tool(8, 2) + "[stock]")
    assert "no tool number" in refused(tmp_path, text, two)
    forces(tmp_path, text, two.replace("[tools.2]", "[tools.default]"))
    for change in ("M6", "T0 M6"):  # neither names one
        named = gcode(*SLOT).replace("T1 M6", change)
        forces(tmp_path, named, process(tool(10, 4), BOX, 1.0))
        assert "no tool number" in refused(tmp_path, named, two)


def mesh_process(name):
    return process(tool(10, 4), BOX, 1.0).partition("[stock]")[0] + f'[stock]\nfile = "{name}"\nresolution_mm = 1.0\n'


def block(scale=1.0):
    return trimesh.creation.box(bounds=np.array([[0, -40, -20], [100, 40, 0]]) * scale)


def test_a_mesh_gives_what_the_box_gives(tmp_path):
    block().export(tmp_path / "stock.stl")
    _, one = forces(tmp_path, gcode(*SLOT), mesh_process("stock.stl"))
    _, other = forces(tmp_path, gcode(*SLOT), process(tool(10, 4), BOX, 1.0))
    assert one.removed_volume == pytest.approx(other.removed_volume, rel=1e-3)


def test_place_of_a_mesh_in_base_is_the_translation_of_its_frame_and_its_turn(tmp_path):
    """The mesh is that of the box in another frame, whose X is along Y of $BASE."""
    mesh = trimesh.creation.box(bounds=np.array([[-40, -90, -120], [40, 10, -100]]))
    mesh.export(tmp_path / "stock.stl")
    place = "place = { X = 10.0, Y = 0.0, Z = 100.0, A = 90.0 }\n"
    text = gcode("G0 X-10 Y36 Z5", "G1 Z-3 F2400", "X110")
    _, placed = forces(tmp_path, text, mesh_process("stock.stl") + place)
    _, box = forces(tmp_path, text, process(tool(10, 4), BOX, 1.0))
    np.testing.assert_allclose(placed.cuts.wrench.max(axis=0), box.cuts.wrench.max(axis=0), rtol=2e-3, atol=0.1)
    assert placed.removed_volume == pytest.approx(box.removed_volume, rel=1e-3)


def test_open_mesh(tmp_path):
    mesh = block()
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    mesh.export(tmp_path / "stock.stl")
    assert "the mesh of the stock is not closed" in refused(tmp_path, gcode(*SLOT), mesh_process("stock.stl"))


def test_a_mesh_in_inches(tmp_path):
    block(1 / 25.4).export(tmp_path / "stock.stl")
    far = gcode("G0 X10 Y20 Z5", "G1 Z-3 F2400", "X90")
    assert "is one of them in inches?" in refused(tmp_path, far, mesh_process("stock.stl"))


def test_a_program_in_inches_that_meets_stock_in_mm_is_told(tmp_path):
    around = ("G0 X0 Y-40 Z5", "G1 Z-3 F100", "X100", "Y40", "X0", "Y-40")
    text, inches = gcode(*around), gcode(*around).replace("G21", "G20")
    assert "stock-scale" not in {
        issue.kind for issue in forces(tmp_path, text, process(tool(10, 4), BOX, 1.0))[1].issues
    }
    _, found = forces(tmp_path, inches, process(tool(300, 4), BOX, 1.0))
    (issue,) = (issue for issue in found.issues if issue.kind == "stock-scale")
    assert "25 times as large as the stock" in issue.message
    assert "an inch is 25.4 mm" in issue.message


@pytest.mark.parametrize(("end", "share"), [(4800, 0.7), (900, None)])
def test_a_program_that_cuts_nearly_nothing_is_told_how_much(tmp_path, end, share):
    """15 mm along X from the rim on, some 20 along Y, then air; rapid moves do not count."""
    text = gcode("G0 X-800 Y20 Z5", "X-10", "G1 Z-3 F2400", "X10", "Y200", f"X{end}", "G0 Z50")
    _, found = forces(tmp_path, text, process(tool(10, 4), BOX, 1.0))
    said = [issue.message for issue in found.issues if issue.kind == "little-cut"]
    assert bool(said) == (share is not None)
    if said:
        percent, cut, whole = re.match(r"(\S+) % of the path at feed cuts: (\S+) of (\S+) mm", said[0]).groups()
        assert float(percent) == pytest.approx(share, abs=0.1)
        assert float(cut) == pytest.approx(35, abs=3)
        assert float(whole) == pytest.approx(8 + 20 + 180 + 4790, abs=1)


@pytest.mark.parametrize(("limit", "exceeded"), [(0.99, True), (1.01, False)])
def test_a_cut_that_takes_more_than_the_spindle_has(tmp_path, limit, exceeded):
    text = gcode("G0 X-20 Y20 Z5", "G1 Z-3 F2400", "X90")
    _, free = forces(tmp_path, text, process(tool(10, 4), BOX, 1.0))
    kilowatts = float(free.cuts.power.max()) * 1e-3
    assert "spindle-power" not in {issue.kind for issue in free.issues}
    spindle = f"[spindle]\npower_kW = {limit * kilowatts!r}\n"
    _, found = forces(tmp_path, text, process(tool(10, 4), BOX, 1.0) + spindle)
    said = [issue for issue in found.issues if issue.kind == "spindle-power"]
    assert bool(said) == exceeded
    if exceeded:
        assert f"takes {kilowatts:.2g} kW" in said[0].message
        assert text.split("\n")[said[0].source_line - 1].startswith("X90")


def test_a_mesh_that_is_25_times_too_large(tmp_path):
    mesh = trimesh.creation.box(bounds=np.array([[0, 0, 0], [6, 4, 20]]) * 25.4)
    mesh.export(tmp_path / "stock.stl")
    text = gcode("G0 X10 Y20 Z700", "Z25", "G1 Z17 F2400", "X90")
    _, found = forces(tmp_path, text, mesh_process("stock.stl"))
    assert {issue.kind for issue in found.issues} == {"deep-cut", "rapid-in-material"}
    assert "an inch is 25.4 mm" in next(i.message for i in found.issues if i.kind == "deep-cut")


def test_no_such_mesh_and_no_mesh(tmp_path):
    assert "no such file" in refused(tmp_path, gcode(*SLOT), mesh_process("none.stl"))
    (tmp_path / "bad.stl").write_text("this is no mesh")
    assert "bad.stl" in refused(tmp_path, gcode(*SLOT), mesh_process("bad.stl"))


def test_a_rapid_move_through_material_is_told_with_its_line(tmp_path):
    text = gcode(*SLOT, "G0 Y20", "Z5")
    _, found = forces(tmp_path, gcode(*SLOT, "G0 Z5", "X0", "Z-3"), process(tool(10, 4), BOX, 0.5))
    assert found.issues == ()
    _, found = forces(tmp_path, text.replace("X110", "X50"), process(tool(10, 4), BOX, 0.5))
    (issue,) = found.issues
    assert (issue.kind, issue.source_line, issue.count) == ("rapid-in-material", 7, 1)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("diameter_mm", "diametre_mm"), "unknown key 'diametre_mm' in [tools.1]"),
        (("al_7075_t6_carbide", "unobtainium"), "no material 'unobtainium'"),
        (('name = "al_7075_t6_carbide"', "mc = 0.3"), "[material] does not say how it cuts"),
        (
            ('name = "al_7075_t6_carbide"', 'name = "al_7075_t6_carbide"\nKrc_N_per_mm2 = 0.0'),
            "[material] name = 'al_7075_t6_carbide' has coefficients of its own in the table of materials. "
            "Remove Krc_N_per_mm2, or call the material otherwise.",
        ),
        (
            ('name = "al_7075_t6_carbide"', 'name = "ours"\nKtc_N_per_mm2 = 700.0\nmc = 0.27'),
            "[material] has coefficients of two cutting laws. Remove mc, or Ktc_N_per_mm2.",
        ),
        (("[tools.1]", "[tools.-1]"), "'-1' is not a tool number"),
        (("[tools.1]", "[tools.T1]"), "tool T1 is not in"),
        (("X = [0.0, 100.0]", "X = [100.0, 0.0]"), "is not from smaller to larger"),
        (("resolution_mm = 1.0", "resolution_mm = 0.001"), "Give [stock] resolution_mm"),
        (
            ('shape = "flat"', 'shape = "endmill"'),
            "tools.1.shape: no such value: 'endmill'. Valid values: 'ball', 'bull', 'drill', 'flat'.",
        ),
        (('shape = "flat"', 'shape = "bull"'), "a bull tool without a corner radius"),
        (('shape = "flat"', 'shape = "flat"\ncorner_radius_mm = 1.0'), "corner_radius_mm with shape 'flat'"),
    ],
)
def test_a_process_that_cannot_be_used(tmp_path, change, told):
    assert told in refused(tmp_path, gcode(*SLOT), process(tool(10, 4), BOX, 1.0).replace(*change))


@pytest.mark.parametrize(
    ("key", "value", "is_usual"),
    [
        ("Ktc", "0.8", False),
        ("kc11", "0.8", False),
        ("Ktc", "3.0", True),
        ("Ktc", "0.0", True),
        ("kc11", "700.0", True),
    ],
)
def test_a_coefficient_in_kn_is_asked_about(tmp_path, key, value, is_usual):
    coefficients = f"{key}_N_per_mm2 = {value}" + ("\nmc = 0.25" if key == "kc11" else "\nKte_N_per_mm = 1.0")
    text = process(tool(10, 4), BOX, 1.0).replace('name = "al_7075_t6_carbide"', coefficients)
    _, path_forces = forces(tmp_path, gcode(*SLOT), text)
    warnings = [issue.message for issue in path_forces.issues if issue.kind == "material"]
    asked = (
        f"[material] {key}_N_per_mm2 = 0.8: below 1 N/mm² it is that of no solid material that one mills. Is it in kN"
    )
    assert is_usual or warnings[0].startswith(asked)
    assert len(warnings) == (not is_usual)


HOLES = ("G0 X20 Y20 Z30", "G98 G83 X20 Y20 Z-12 R2 Q5 F200", "X40 Z-6", "G80")


def test_drills_have_depth_feed_force_and_torque(tmp_path):
    """Deepest hole 12 mm below the surface although it is pecked; torque of a full edge, thrust 0.65 kc fn D/2."""
    program, found = forces(tmp_path, gcode(*HOLES), process(tool(8, 2, "drill"), BOX))
    (summary,) = process_forces.summary(program, found, 0).tools
    assert summary.max_depth_mm == pytest.approx(12.0, abs=0.02)
    chip = 200 / 6000 / 2
    thrust, torque = 0.65 * 2 * 4.0 * (767.01 * chip + 27.7), 2 * 4.0**2 * (767.01 * chip + 27.7) / 2 / 1e3
    assert summary.max_feed_force_N == pytest.approx(thrust, rel=0.02)
    assert summary.max_torque_Nm == pytest.approx(torque, rel=0.02)
    assert summary.max_width_mm == pytest.approx(8.0, abs=0.001)
    text = process_forces.as_text(process_forces.summary(program, found, 0))
    assert "drilled up to 12 mm deep, feed force up to" in text
    kinds = {issue.kind for issue in found.issues}
    assert ("drill-thrust" in kinds, "drilled-by-mill" in kinds) == (True, False)


@pytest.mark.parametrize(("shape", "depth"), [("flat", 2.0), ("ball", 6.0), ("bull", 3.0)])
def test_the_width_of_a_slot_is_the_diameter(tmp_path, shape, depth):
    text = gcode("G0 X-10 Y0 Z5", f"G1 Z-{depth} F2400", "X110")
    program, found = forces(tmp_path, text, process(tool(8, 2, shape, 1.0), BOX))
    (summary,) = process_forces.summary(program, found, 0).tools
    assert summary.max_width_mm == pytest.approx(8.0, abs=0.001)


def test_a_drilling_cycle_with_a_milling_tool_is_named(tmp_path):
    _, found = forces(tmp_path, gcode(*HOLES), process(tool(8, 2), BOX))
    (issue,) = [issue for issue in found.issues if issue.kind == "drilled-by-mill"]
    assert "drill-thrust" not in {each.kind for each in found.issues}  # its end face cuts to the middle
    assert (issue.source_line, "G83" in HOLES[1]) == (5, True)
    _, found = forces(tmp_path, gcode("G0 X20 Y20 Z30", "G1 Z-5 F200", "G0 Z30"), process(tool(8, 2), BOX))
    assert "drilled-by-mill" not in {issue.kind for issue in found.issues}
