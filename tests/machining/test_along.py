"""Forces along motions: continuous, in any axes the same, the same by file as in memory."""

from __future__ import annotations

import json

import numpy as np
import pytest

from postproc import forces as force_sources
from postproc import machining, toolpath
from postproc.errors import ForceError
from postproc.machining import cutting
from postproc.under_load import RobotInCell
from tests.commands import run
from tests.machining.setting import CELL, ROBOT, forces, gcode, process, read, tool
from tests.places import SAMPLES

BOX = ((0, 100), (-40, 40), (-20, 0))
WAYS = (
    "G0 X-10 Y0 Z5", "G1 Z-3 F2400", "X30", "Y20", "G3 X50 Y0 I0 J-20", "G2 X70 Y-20 I0 J-20", "G1 X90 Y-10 Z-1", "Z-4",
    "Y15", "X110", "G0 Z5",
)  # fmt: skip


def path_forces(program, source):
    place = RobotInCell.of(ROBOT, CELL)
    path = toolpath.segments(program, place.start_flange)
    return path, force_sources.assign(program, path, source, place.spindle, place.ramp)


def at(program, path, found, share):
    motion = np.arange(len(program.motions))
    return found.at(toolpath.at(program, path, motion, np.full(len(motion), share)))


@pytest.fixture
def computed(tmp_path):
    program = read(tmp_path, gcode(*WAYS))
    (tmp_path / "process.toml").write_text(process(tool(10, 4), BOX, 0.5))
    return program, machining.load(tmp_path / "process.toml"), tmp_path


def test_forces_have_no_steps(computed):
    program, given, _ = computed
    place = RobotInCell.of(ROBOT, CELL)
    path, found = path_forces(program, machining.ProcessSource(given, place.spindle))
    cutting = np.flatnonzero(~program.motions.rapid[1:] & ~program.motions.rapid[:-1]) + 1
    begin, end = at(program, path, found, 1e-9), at(program, path, found, 1.0)
    assert np.abs(end).max() > 300.0
    np.testing.assert_allclose(begin[cutting], end[cutting - 1], atol=0.1)


def test_what_is_written_is_what_is_in_memory_and_base_axes_are_the_same(computed):
    program, given, folder = computed
    place = RobotInCell.of(ROBOT, CELL)
    path, found = path_forces(program, machining.ProcessSource(given, place.spindle))
    for option in ([], ["--base"]):
        run(
            *("forces", str(folder / "part.nc"), "--cell", str(SAMPLES / "cell_kr270.toml"), *option),
            *("--process", str(folder / "process.toml"), "-o", str(folder / "f.csv")),
        )
        _, other = path_forces(program, force_sources.read(folder / "f.csv"))
        bound = 1e-2 if not option else 6.0  # in $BASE axes a force that turns on an arc is linear between places
        for share in (0.2, 0.5, 0.77, 1.0):
            np.testing.assert_allclose(at(program, path, found, share), at(program, path, other, share), atol=bound)


@pytest.mark.parametrize("cycle", ["G81 X20 Y20 Z-5 R2", "G82 X20 Y20 Z-5 R2 P0.5", "G83 X20 Y20 Z-5 R2 Q2"])
def test_forces_of_drilling_cycles_give_no_warning_when_they_are_read_again(tmp_path, cycle):
    (tmp_path / "part.nc").write_text(gcode("G0 X10 Y20 Z20", f"G99 {cycle} F600", "X40", "G80", "G0 Z20"))
    (tmp_path / "process.toml").write_text(process(tool(8, 2, "drill"), BOX, 0.5))
    cell = ("--cell", str(SAMPLES / "cell_kr270.toml"))
    made = ("forces", str(tmp_path / "part.nc"), "--process", str(tmp_path / "process.toml"))
    for command in (
        (*made, *cell, "-o", str(tmp_path / "f.csv")),
        ("convert", str(tmp_path / "part.nc"), "--forces", str(tmp_path / "f.csv"), *cell, "-o", str(tmp_path / "out")),
    ):
        run(*command)
    content = json.loads((tmp_path / "out" / "part.report.json").read_text())
    assert content["max_force_N"] > 100.0
    warnings = [issue["kind"] for issue in content["issues"] if issue["level"] != "info"]
    assert not warnings


def test_standard_deviations_are_those_of_the_material(tmp_path, monkeypatch):
    """Of published sets 33 %, and by wear anything from 0 to 25 % more force; or what the user states.

    95 % of tools drawn so are inside 1.96 standard deviations, though wear only adds.
    """
    monkeypatch.setattr(cutting, "CELL_ERROR_SHARE", 0.0)  # without that by the cells of the map
    monkeypatch.setattr(cutting, "WALL_ERROR", 0.0)
    _, found = forces(tmp_path, gcode(*WAYS), process(tool(10, 4), BOX, 0.5))
    rng = np.random.default_rng(7)
    error = (1.0 + 0.33 * rng.normal(size=1_000_000)) * (1.0 + 0.25 * rng.uniform(size=1_000_000)) - 1.0
    share = np.quantile(np.abs(error), 0.95) / 1.96
    np.testing.assert_allclose(found.knots.sigma, share * np.abs(found.knots.wrench), rtol=5e-3)
    np.testing.assert_allclose(found.knots.factor, share, rtol=5e-3)
    text = process(tool(10, 4), BOX, 0.5).replace("[tools.1]", "sigma_percent = 40\n[tools.1]")
    _, found = forces(tmp_path, gcode(*WAYS), text)
    np.testing.assert_allclose(found.knots.sigma, 0.40 * np.abs(found.knots.wrench))
    (tmp_path / "material.toml").write_text("[material]\nKtc_N_per_mm2 = 700\nKac_N_per_mm2 = 9\nsigma_percent = 10\n")
    _, found = forces(tmp_path, gcode(*WAYS), process(tool(10, 4), BOX, 0.5, 'file = "material.toml"'))
    np.testing.assert_allclose(found.knots.sigma, 0.10 * np.abs(found.knots.wrench))


def test_a_material_without_axial_coefficients_has_a_wide_axial_force(tmp_path):
    """Measured axial forces are 40 to 90 % of the force across the feed: they lie within the bound."""
    text = gcode("G0 X-10 Y0 Z5", "G1 Z-3 F2400", "X110 (here)")
    for material in ("kc11_N_per_mm2 = 641.0\nmc = 0.27", 'name = "al_6061_t6_carbide"'):
        _, found = forces(tmp_path, text, process(tool(10, 4), BOX, 0.5, material))
        row = int(np.argmax(np.abs(found.knots.wrench[:, 1])))
        across, axial = found.knots.wrench[row, :2], found.knots.sigma[row, 2]
        assert found.knots.wrench[row, 2] == 0.0
        assert 0.9 * abs(across[1]) < 1.96 * axial < 2.0 * np.linalg.norm(across)
        assert "no-axial-force" in {issue.kind for issue in found.issues}
    _, found = forces(tmp_path, text, process(tool(10, 4), BOX, 0.5))
    assert "no-axial-force" not in {issue.kind for issue in found.issues}


@pytest.mark.parametrize(("feed", "length"), [(2400, 0.05), (4800, 0.1), (600, 0.02)])
def test_a_force_changes_at_the_start_of_a_motion_over_half_the_feed_per_tooth(tmp_path, feed, length):
    """Of four teeth at 6000 1/min; and over 0.02 mm at least."""
    text = gcode("G0 X30 Y0 Z5", "G1 Z-3 F300", f"X70 F{feed}")
    program, found = forces(tmp_path, text, process(tool(10, 4), BOX, 0.5))
    (motion,) = np.flatnonzero(program.motions.line == 6)
    t = found.knots.t[found.knots.motion == motion]
    assert t[0] == 0.0
    assert 40.0 * t[1] == pytest.approx(length, rel=1e-6)


def test_forces_by_operation(tmp_path):
    text = gcode(
        "(begin operation: Contour 2)", "G0 X0 Y0 Z5", "G1 Z-3 F2400", "X20", "(finish operation: Contour 2)", "X30",
        "N120 X40", "T3 M6", "X50",
    )  # fmt: skip
    program = read(tmp_path, text)
    (tmp_path / "process.toml").write_text(
        '[operations."contour 2"]\nFx = -110\nsigma_percent = 10\n[operations.N120]\nFy = 5\nframe = "BASE"\n'
        "[operations.T3]\nFz = 30\n"
    )
    own = machining.operation_knots(program, machining.load(tmp_path / "process.toml"))
    lines = program.motions.line[own.motion].tolist()
    assert lines == [6, 7, 10, 12]
    np.testing.assert_allclose(own.wrench[:, :3], [[-110, 0, 0], [-110, 0, 0], [0, 5, 0], [0, 0, 30]])
    assert own.frame.tolist() == [2, 2, 0, 2]
    assert own.sigma[0, 0] == pytest.approx(11.0)
    assert own.factor[0] == pytest.approx(0.1)


def test_a_comment_that_reads_like_a_tool_or_a_block_begins_neither(tmp_path):
    text = gcode("G0 X0 Y0 Z5", "(T3)", "G1 Z-3 F2400", "(N120)", "X30", "T3 M6", "G1 X40", "N120 X50")
    program = read(tmp_path, text)
    (tmp_path / "process.toml").write_text("[operations.T3]\nFz = 30\n[operations.N120]\nFy = 5\n")
    own = machining.operation_knots(program, machining.load(tmp_path / "process.toml"))
    ways = [text.splitlines()[line - 1] for line in program.motions.line[own.motion].tolist()]
    assert dict(zip(ways, own.wrench[:, 1:3].tolist(), strict=True)) == {"G1 X40": [0, 30], "N120 X50": [5, 0]}


def test_operations_and_subprograms(tmp_path):
    one = ("G0 X0 Y0 Z5", "(rough)", "G1 Z-3 F2400", "M98 P1", "X30", "M98 P1")
    below = "O1\nY9\nY0\nM99\n"
    (tmp_path / "process.toml").write_text("[operations.rough]\nFx = -110\n")
    process = machining.load(tmp_path / "process.toml")
    whole = read(tmp_path, gcode(*one) + below)
    assert machining.operation_knots(whole, process).wrench[:, 0].tolist() == [-110.0] * 6
    (tmp_path / "process.toml").write_text("[operations.rough]\nFx = -110\n[operations.finish]\nFx = -20\n")
    two = read(tmp_path, gcode(*one[:4], "(finish)", *one[4:]) + below)
    own = machining.operation_knots(two, machining.load(tmp_path / "process.toml"))
    assert own.wrench[:, 0].tolist() == [-110.0] * 3 + [-20.0] * 3


def test_a_comment_before_a_tool_change_names_the_operation_after_it(tmp_path):
    """The order of Fusion; a comment that speaks of finishing ends nothing, and N words and tools still count."""
    text = "\n".join((
        "(1001)", "(T1 D=10. CR=0. - ZMIN=-5. - flat end mill)", "G21 G90", "(2D Adaptive1)", "T1 M6", "S6000 M3",
        "G0 X0 Y0 Z5", "G1 Z-3 F2400", "(finish with 0.2 mm left)", "X20", "G0 Z5",
        "(2D Contour2)", "T2 M6", "S6000 M3", "G0 X0 Y0", "G1 Z-3 F900", "X30", "G0 Z5", "(Chamfer1)", "G1 X40",
        "M30", "",
    ))  # fmt: skip
    program = read(tmp_path, text)
    table = '[operations."2D Adaptive1"]\nFx = -300\n[operations."2D Contour2"]\nFx = -20\n[operations.T2]\nFx = -7\n'
    (tmp_path / "process.toml").write_text(table)
    own = machining.operation_knots(program, machining.load(tmp_path / "process.toml"))
    assert dict(zip(program.motions.line[own.motion].tolist(), own.wrench[:, 0].tolist(), strict=True)) == {
        8: -300.0, 10: -300.0, 16: -20.0, 17: -20.0, 20: -7.0,
    }  # fmt: skip


FRAMES = "$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}", "$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}", "$VEL.CP=0.02"
DRIVES = "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}"


def in_krl(name, y):
    """A cut of two straight motions after a retract, under a comment."""
    places = [f"{{X {x},Y {y},Z {z},A 180,B 0,C 180}}" for x, z in ((60, 30), (60, 0), (90, 0), (90, 30))]
    return f"; {name}", *(f"{word} {place}" for word, place in zip(("PTP", "LIN", "LIN", "PTP"), places, strict=True))


def in_gcode(y):
    return f"G0 X60 Y{y} Z30", "G1 Z0 F900", "X90", "G0 Z30"


@pytest.fixture
def driven(tmp_path):
    """Forces Fx by line of a program, and the messages, of a table of operations."""

    def of(name, lines, table):
        program = read(tmp_path, "\n".join((*lines, "")), name)
        (tmp_path / "process.toml").write_text(table)
        own = machining.operation_knots(program, machining.load(tmp_path / "process.toml"))
        return dict(zip(program.motions.line[own.motion].tolist(), own.wrench[:, 0].tolist(), strict=True)), own.issues

    return of


NAMES = ("FINISH", "Finish pass", "Finishing", "END MILL SLOT", "SECOND")
ROUGH = "[operations.ROUGH]\nFx = 400\n"


@pytest.mark.parametrize("name", NAMES)
def test_an_operation_after_a_retract_ends_the_one_before_whatever_its_name(driven, name):
    lines = ("DEF min()", *FRAMES, DRIVES, *in_krl("ROUGH", 40), *in_krl(name, 60), "END")
    assert driven("min.src", lines, ROUGH) == ({8: 400.0, 9: 400.0}, ())
    lines = ("G21 G90", "(ROUGH)", "T1 M6", "S6000 M3", *in_gcode(40), f"({name})", *in_gcode(60), "M30")
    assert driven("part.nc", lines, ROUGH) == ({6: 400.0, 7: 400.0}, ())


@pytest.mark.parametrize("name", [*NAMES, "pass 2", ""])
@pytest.mark.parametrize("tool", [1, 3])
@pytest.mark.parametrize("after", [False, True])
def test_a_tool_change_ends_an_operation_also_without_a_name_and_for_the_same_tool(driven, name, tool, after):
    change = [f"T{tool} M6", "S6000 M3", f"({name})"]
    change = change if after else [change[2], *change[:2]]
    lines = ["G21 G90", "(ROUGH)", "T1 M6", "S6000 M3", *in_gcode(40), *change, *in_gcode(60), "M30"]
    assert driven("part.nc", lines, ROUGH) == ({6: 400.0, 7: 400.0}, ())
    own = ROUGH + "[operations.T3]\nFx = 7\n"
    if tool == 3:
        assert driven("part.nc", lines, own)[0] == {6: 400.0, 7: 400.0, 13: 7.0, 14: 7.0}
    if name in NAMES:
        assert driven("part.nc", lines, f"{ROUGH}[operations.'{name}']\nFx = -9\n")[0] == {
            6: 400.0, 7: 400.0, 13: -9.0, 14: -9.0,
        }  # fmt: skip


def test_a_move_to_the_tool_changer_does_not_end_the_operation_that_is_named_before_it(driven):
    lines = ["G21 G90", "(ROUGH)", "G0 X0 Y0 Z90", "T1 M6", "S6000 M3", *in_gcode(40), "M30"]
    assert driven("part.nc", lines, ROUGH)[0] == {7: 400.0, 8: 400.0}
    lines = ["G21 G90", "(ROUGH)", "T1 M6", "(SLOT)", "T2 M6", "S6000 M3", *in_gcode(40), "M30"]
    assert driven("part.nc", lines, ROUGH)[0] == {}
    assert driven("part.nc", lines, ROUGH + "[operations.SLOT]\nFx = 5\n")[0] == {8: 5.0, 9: 5.0}


def test_another_tool_of_a_robot_program_ends_an_operation(driven):
    other = "$TOOL={X 0,Y 0,Z 300,A 0,B 0,C 0}"
    lines = ("DEF min()", *FRAMES, DRIVES, *in_krl("ROUGH", 40), other, *in_krl("pass 2", 60), "END")
    assert driven("min.src", lines, ROUGH)[0] == {8: 400.0, 9: 400.0}


def test_comments_within_an_operation_end_nothing_and_a_note_lists_them(driven):
    inside = ("(finish with 0.2 mm left)", "X70", "(END CUT)", "X75", "(End mill side)", "X80", "(SLOT)", "X85")
    lines = ("G21 G90", "(ROUGH)", "T1 M6", "S6000 M3", *in_gcode(40)[:2], *inside, "G0 Z30", "M30")
    found, issues = driven("part.nc", lines, ROUGH)
    assert found == dict.fromkeys((6, 8, 10, 12, 14), 400.0)
    assert [(issue.level, issue.source_line, issue.count) for issue in issues] == [("info", 7, 3)]
    listed = "'finish with 0.2 mm left' (line 7), 'End mill side' (line 11), 'SLOT' (line 13)"
    assert f"goes on after the comment {listed}" in issues[0].message
    lines = ("G21 G90", "(ROUGH)", "T1 M6", "S6000 M3", *in_gcode(40), "(pass 2)", *in_gcode(60), "M30")
    found, issues = driven("part.nc", lines, ROUGH)
    assert found == dict.fromkeys((6, 7, 11, 12), 400.0)
    assert "after the comment 'pass 2' (line 9)" in issues[0].message
    assert driven("part.nc", lines, "[operations.T1]\nFx = 5\n") == (dict.fromkeys((6, 7, 11, 12), 5.0), ())


def test_a_force_by_hand_replaces_computed_ones_in_its_operation_only(tmp_path):
    cut = "G0 X-10 Y0 Z5", "G1 Z-3 F2400", "X30", "G0 Z5"
    last = "G0 X-10 Y20 Z5", "G1 Z-3 F2400", "X30", "G0 Z5"
    text = gcode("(DRILL1)", "T1 M6", "S6000 M3", *cut, "(FINISH)", "T3 M6", "S6000 M3", *last)
    program = read(tmp_path, text)
    two = process(tool(10, 4), BOX, 0.5) + f"[tools.3]\n{tool(10, 4, 'ball')}"
    place = RobotInCell.of(ROBOT, CELL)
    path = toolpath.segments(program, place.start_flange)
    found = []
    for table in (two, two + "[operations.DRILL1]\nFz = 500\n"):
        (tmp_path / "process.toml").write_text(table)
        found.append(machining.ProcessSource(machining.load(tmp_path / "process.toml"), place.spindle))
    computed, given = (source.along(program, path) for source in found)
    own = program.motions.line[given.motion] < text.splitlines().index("(FINISH)") + 1
    np.testing.assert_array_equal(given.wrench[own], [[0, 0, 500, 0, 0, 0]] * 2)
    rest = program.motions.line[computed.motion] > text.splitlines().index("(FINISH)")
    np.testing.assert_array_equal(given.wrench[~own], computed.wrench[rest])
    assert np.abs(computed.wrench[rest]).max() > 100.0
    assert given.law_forces.motion.tolist() == np.unique(computed.motion[rest]).tolist()


def test_an_operation_that_is_not_there(tmp_path):
    program = read(tmp_path, gcode("(2D Pocket1)", *WAYS, "(Contour 2)", *WAYS))
    (tmp_path / "process.toml").write_text('[operations."2D pocket"]\nFx = -110\n')
    with pytest.raises(ForceError, match="no comment, tool or block") as caught:
        machining.operation_knots(program, machining.load(tmp_path / "process.toml"))
    assert "Did you mean '2D Pocket1'? Operations found: '2D Pocket1', 'Contour 2'." in str(caught.value)
