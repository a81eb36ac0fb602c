"""Orientation under `$ORI_TYPE` and `$CIRC_TYPE`, against a controller that shares no code with the package."""

import re

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from postproc import cell as cells
from postproc import correction, robot, toolpath
from postproc.dialects import krl
from postproc.errors import ProgramError
from postproc.program import CIRC, LIN
from tests.correction.simulated import check_targets, rows_of, simulator
from tests.corrections import read_files
from tests.dialects.krl_programs import CELL, body, check_commands, forward, read, targets
from tests.dialects.test_krl_rewriting import keep_unmoved, up
from tests.oracle import cell_sim
from tests.oracle.arm import abc
from tests.places import CELL_FILE

FULL = "LIN {X 0,Y 0,Z 0,A 10,B 20,C 170}"
FRAMES = ("$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}", "$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}")
ARCS = (
    "CIRC {X 50,Y 50,Z 0},{X 100,Y 0,Z 0,A 80,B 5,C 150} C_DIS",
    "CIRC {X 120,Y -20,Z 5},{X 100,Y -40,Z 10,A -40,B 30,C 170}",
    "LIN {X 60,Y -40,Z 10,A -30,B 25,C 160} C_DIS",
)
MODES = [(kind, circle) for kind in ("#VAR", "#CONSTANT") for circle in ("#BASE", "#PATH")]


def simulated(text, shares):
    """Poses (moves, shares, 4, 4) of a program that begins at its first target, by the oracle."""
    moves, out, stand = cell_sim.read(text), [], None
    for move in moves:
        begin = abc(*move["frame"]) if stand is None else stand
        out.append([cell_sim.Cell.between(move, begin, share) for share in shares])
        stand = cell_sim.Cell.between(move, begin, 1.0)
    return np.array(out)


def path_of(program, shares):
    """The same of a program as it was read."""
    motion = np.repeat(np.arange(len(program.motions)), len(shares))
    t = np.tile(np.array(shares), len(program.motions))
    path = toolpath.segments(program, forward(CELL.start_joints))
    return toolpath.at(program, path, motion, t).pose[:].reshape(len(program.motions), len(shares), 4, 4)


@pytest.mark.parametrize(("kind", "circle"), MODES)
@pytest.mark.parametrize("bulk", [True, False])
def test_the_orientation_is_led_as_the_controller_leads_it(kind, circle, bulk):
    text = body(*FRAMES, FULL, f"$ORI_TYPE={kind}", f"$circ_type = {circle.lower()}", *ARCS)
    shares = (0.2, 0.5, 0.9, 1.0)
    program = read(text, bulk=bulk)
    np.testing.assert_allclose(path_of(program, shares)[1:], simulated(text, shares)[1:], rtol=0, atol=1e-12)


def test_a_constant_orientation_stays_while_base_and_tool_change():
    lines = ("$ORI_TYPE=#CONSTANT", "$BASE={X 1400,Y 0,Z 650,A 30,B 10,C -20}", "LIN {X 5,Y 6,Z 7,A 1,B 2,C 3}")
    program = read(body(*FRAMES, FULL, *lines, "$TOOL={X 5,Y 0,Z 300,A 0,B 45,C 0}", "LIN {X 8,Y 6,Z 7,A 1,B 2,C 3}"))
    m = program.motions
    flange = program.bases[m.base] @ m.target @ np.linalg.inv(program.tools[m.tool])
    np.testing.assert_allclose(flange[1:, :3, :3], flange[[0, 0], :3, :3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(m.target[2, :3, 3], [0.008, 0.006, 0.007], atol=1e-12)


def test_the_next_motion_starts_with_the_orientation_that_was_kept():
    program = read(body(FULL, "$ORI_TYPE=#CONSTANT", "LIN {X 9,A 90}", "$ORI_TYPE=#VAR", "LIN {X 20,A 50,B 20,C 170}"))
    half = path_of(program, (0.5,))[:, 0, :3, :3]
    wanted = abc(0, 0, 0, 30, 20, 170)[:3, :3]  # A turns about Z of the base: half of the way is half of A
    np.testing.assert_allclose(half[2], wanted, atol=1e-12)
    assert program.layout.ignores_orientation.tolist() == [False, True, False]


@pytest.mark.parametrize("angle", [60.0, 360.0, -90.0, 500.0])
def test_a_circle_with_ca_takes_a_constant_orientation_along(angle):
    start = "LIN {X 0,Y 0,Z 0,A 10,B 20,C 170}"
    circle = f"SCIRC {{X 50,Y -50,Z 0}},{{X 100,Y 0,Z 0,A 5,B 5,C 5}},CA {angle} WITH $CIRC_TYPE=#PATH"
    program = read(body(start, "$ORI_TYPE=#CONSTANT", circle, "LIN {X 5,Y 6,Z 7}"))
    turn = Rotation.from_euler("z", angle, degrees=True).as_matrix()  # it runs counter-clockwise seen from above
    wanted = turn @ abc(0, 0, 0, 10, 20, 170)[:3, :3]
    np.testing.assert_allclose(program.motions.target[1:, :3, :3], [wanted, wanted], atol=1e-12)


def test_a_circle_with_ca_that_ends_at_its_end_point_may_turn_the_tool():
    for circle in ("#BASE", "#PATH"):
        lines = (FULL, f"$CIRC_TYPE={circle}", "CIRC {X 50,Y 50,Z 0},{X 100,Y 0,Z 0,A 40,B 20,C 170}")
        one, other = read(body(*lines)), read(body(*lines[:2], f"{lines[2]},CA=180"))
        np.testing.assert_allclose(path_of(one, (0.3, 1.0)), path_of(other, (0.3, 1.0)), atol=1e-12)


def test_inline_forms_name_the_modes_by_their_data():
    data = "DEFDAT part\nDECL LDAT LCPDAT1={VEL 2.0,ACC 100.0,ORI_TYP #CONSTANT,CIRC_TYP #PATH}\nENDDAT\n"
    circle = "SCIRC {X 50,Y 50,Z 0},{X 100,Y 0,Z 0,A 1,B 2,C 3} WITH $ORI_TYPE=SORI_TYP(LCPDAT1), "
    program = read(body(FULL, f"{circle}$CIRC_TYPE=SCIRC_TYP(LCPDAT1), $CIRC_MODE=SCIRC_M(LCPDAT1)"), data)
    assert program.turns_with_path.tolist() == [False, True]
    assert program.layout.orientation.tolist() == [0, 1]


@pytest.mark.parametrize("circle", ["#BASE", "#PATH"])
@pytest.mark.parametrize(("word", "short"), [("SCIRC", 100.0), ("SCIRC", 80.0), ("CIRC", 100.0)])
def test_scirc_goes_by_the_auxiliary_point_which_way_the_tool_turns(word, short, circle):
    def lines(auxiliary, end):
        return (
            "LIN {X 0,Y 0,Z 0,A 0,B 0,C 180}",
            f"$CIRC_TYPE={circle}",
            f"{word} {{X 50,Y -50,Z 0,A {auxiliary},B 0,C 180}},{{X 100,Y 0,Z 0,A {end},B 0,C 180}}",
        )

    # the path itself turns by 90° up to the auxiliary point and by 180° up to the end, counter-clockwise
    along = (90.0, 180.0) if circle == "#PATH" else (0.0, 0.0)
    near, far = along[0] + 0.5 * short + 40.0, along[0] + 0.5 * short + 180.0 + 40.0
    end = along[1] + short
    path = path_of(read(body(*lines(near, end))), (0.5,))[1, 0, :3, :3]
    np.testing.assert_allclose(path, abc(0, 0, 0, along[0] + 0.5 * short, 0, 180)[:3, :3], atol=1e-12)
    if word == "CIRC":
        assert len(read(body(*lines(far, end))).motions) == 2
        return
    for data, point in ((None, "{X 50,Y -50,Z 0,A %g,B 0,C 180}"), ("DEFDAT part\nFRAME XM={%s}\nENDDAT\n", "XM")):
        text, numbers = lines(far, end), f"X 50,Y -50,Z 0,A {far:g},B 0,C 180"
        arc = f"scirc {point % far if data is None else point},{text[2].split('},')[1]}"
        with pytest.raises(ProgramError, match="closer to the longer way round"):
            read(body(*text[:2], arc), data and data % numbers)


CHOICES = [  # A, B, C at start, auxiliary point and end; whether the shorter way comes closer
    ((180, 0, 180), (90, 0, 180), (170, 0, 180), False),
    ((0, 0, 180), (120, 0, 180), (90, 0, 180), False),
    ((180, 0, 180), (180, -80, 180), (180, 10, 180), False),
    ((0, 0, 180), (-1, 0, 180), (90, 0, 180), False),
    ((0, 0, 180), (91, 0, 180), (90, 0, 180), False),
    ((0, 0, 180), (0, 0, 180), (90, 0, 180), True),
    ((0, 0, 180), (90.005, 0, 180), (90, 0, 180), True),
    ((0, 0, 180), (1, 0, 180), (90, 0, 180), True),
    ((0, 0, 180), (45, 30, 170), (90, 0, 180), True),
    ((0, 0, 180), (0, 0, 180), (0, 0, 180), True),
]


def comes_closer(start, auxiliary, end):
    """Whether the shorter way does, of orientations every 0.02° on both; None where that does not tell."""
    one, via, other = (Rotation.from_euler("ZYX", angles, degrees=True) for angles in (start, auxiliary, end))
    turn = (other * one.inv()).as_rotvec()
    size = np.linalg.norm(turn)
    if size == 0.0:
        return True
    places = np.linspace(size - 2.0 * np.pi, size, 18001)
    apart = np.degrees((Rotation.from_rotvec(np.outer(places, turn / size)) * one * via.inv()).magnitude())
    short, long = apart[places >= -1e-9].min(), apart[places <= 1e-9].min()
    if short < 0.02 or abs(short - long) < 0.03:
        return None
    return short < long


def test_scirc_turns_by_the_way_that_comes_closer_anywhere_on_it():
    rng = np.random.default_rng(5)
    drawn = [tuple(angles) for angles in rng.uniform((-180, -80, -180), (180, 80, 180), (90, 3)).round(3).tolist()]
    groups = [drawn[i : i + 3] for i in range(0, len(drawn), 3)]
    seen = set()
    for start, auxiliary, end, *expected in [*CHOICES, *groups]:
        closer = known = comes_closer(start, auxiliary, end)
        if expected:
            (closer,) = expected
            assert known in (None, closer)
        seen.add(known)
        points = ["A {:.3f},B {:.3f},C {:.3f}".format(*angles) for angles in (start, auxiliary, end)]
        lines = (
            f"LIN {{X 0,Y 0,Z 0,{points[0]}}}",
            f"SCIRC {{X 50,Y -50,Z 0,{points[1]}}},{{X 100,Y 0,Z 0,{points[2]}}}",
        )
        if closer is False:
            with pytest.raises(ProgramError, match="closer to the longer way round"):
                read(body(*lines))
        elif closer:
            assert len(read(body(*lines)).motions) == 2
    assert seen == {None, True, False}


HALF = "{X 50,Y -50,Z 0,A %g,B 0,C 180},{X 100,Y 0,Z 0,A %g,B 0,C 180}"
MODE = "$CIRC_MODE.AUX_PT.ORI"
LEADING = [  # the circle turns by 100°, half of it up to the auxiliary point
    (f"WITH {MODE}=#INTERPOLATE", 50, None),
    (f"WITH {MODE}=#INTERPOLATE", 50.005, None),
    (f"WITH {MODE}=#INTERPOLATE", 51, "not on the way"),
    (f"with {MODE.lower()} = #interpolate c_spl", 51, "not on the way"),
    ("WITH $CIRC_MODE={AUX_PT {ORI #INTERPOLATE},TARGET_PT {ORI #EXTRAPOLATE}}", 51, "not on the way"),
    ("WITH $CIRC_MODE.AUX_PT={ORI #INTERPOLATE,E1 #IGNORE}", 51, "not on the way"),
    ("WITH $CIRC_MODE=SCIRC_M(LTHROUGH)", 51, "not on the way"),
    ("WITH $CIRC_MODE=SCIRC_M(LUSUAL)", 51, None),
    ("WITH $CIRC_MODE=SCIRC_M(LUSUAL)", 231, "closer to the longer way"),
    ("WITH $CIRC_MODE=SCIRC_M(LBARE)", 51, None),
    ("WITH $CIRC_MODE=SCIRC_M(LNONE)", 51, f"{MODE} is not known: LNONE has no value"),
    ("WITH $CIRC_MODE=SCIRC_M(LNONE)", 50, None),
    (f"WITH {MODE}=WAY", 51, f"{MODE} is not known: WAY has no value"),
    (f"WITH {MODE}=#EXTRAPOLATE", 51, f"{MODE} is not known: there is no #EXTRAPOLATE"),
    (f"WITH {MODE}=#IGNORE", 51, None),
    (f"WITH {MODE}=#IGNORE", 231, None),
    (f"WITH {MODE}=#INTERPOLATE, {MODE}=#IGNORE", 231, None),
    ("WITH $CIRC_MODE.TARGET_PT.ORI=#INTERPOLATE", 51, None),
    ("WITH $CIRC_MODE.TARGET_PT.ORI=#INTERPOLATE", 231, "closer to the longer way"),
    ("", 51, None),
]


@pytest.mark.parametrize(("behind", "auxiliary", "refused"), LEADING)
@pytest.mark.parametrize("where", ["in the line", "in the data"])
def test_scirc_heeds_the_auxiliary_point_as_circ_mode_says(behind, auxiliary, refused, where):
    data = """DEFDAT part
DECL LDAT LTHROUGH={VEL 2.0,ORI_TYP #VAR,CB {AUX_PT {ORI #INTERPOLATE,E1 #CONSIDER},TARGET_PT {ORI #INTERPOLATE}}}
DECL LDAT LUSUAL={VEL 2.0,ORI_TYP #VAR,CB {AUX_PT {ORI #CONSIDER,E1 #CONSIDER},TARGET_PT {ORI #INTERPOLATE}}}
DECL LDAT LBARE={VEL 2.0,ORI_TYP #VAR}
FRAME XM={X 50,Y -50,Z 0,A %g,B 0,C 180}
ENDDAT
"""
    points = HALF % (auxiliary, 100) if where == "in the line" else f"XM,{(HALF % (0, 100)).split('},')[1]}"
    lines = "LIN {X 0,Y 0,Z 0,A 0,B 0,C 180}", f"SCIRC {points} {behind}"
    if refused is None:
        path = path_of(read(body(*lines), data % auxiliary), (0.5,))[1, 0, :3, :3]
        np.testing.assert_allclose(path, abc(0, 0, 0, 50, 0, 180)[:3, :3], atol=1e-12)
    else:
        with pytest.raises(ProgramError, match=re.escape(refused)) as told:
            read(body(*lines), data % auxiliary)
        assert told.value.line == 5


def test_circ_disregards_the_auxiliary_orientation_and_ignore_does_too():
    start, through = "LIN {X 0,Y 0,Z 0,A 0,B 0,C 180}", f"WITH {MODE}=#INTERPOLATE"
    assert len(read(body(start, f"CIRC {HALF % (200, 100)}")).motions) == 2
    assert len(read(body(start, "$ORI_TYPE=#IGNORE", f"SCIRC {HALF % (200, 0)} {through}")).motions) == 2
    with pytest.raises(ProgramError, match="not on the way"):
        read(body(start, f"SCIRC {HALF % (30, 0)} {through}"))
    with pytest.raises(ProgramError, match="not on the way"):  # A, B, C that are missing are those of the start
        read(body(start, f"SCIRC {{X 50,Y -50,Z 0}},{{X 100,Y 0,Z 0,A 100,B 0,C 180}} {through}"))
    read(body(start, f"SCIRC {{X 50,Y -50,Z 0}},{{X 100,Y 0,Z 0}} {through}"))


def test_e1_that_carries_the_robot_is_not_led_through_the_auxiliary_point():
    lines = "PTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0,E1 0}", FULL, "SCIRC {X 50,Y -50,Z 0},{X 100,Y 0,Z 0}"
    rail = msgspec.structs.replace(CELL, external_axes={"E1": cells.ExternalAxis((0.0, 1.0, 0.0))})
    mode = "WITH $CIRC_MODE.AUX_PT.E1=%s"
    assert len(read(body(*lines[:2], f"{lines[2]} {mode % '#CONSIDER'}"), cell=rail).motions) == 3
    read(body(*lines[:2], f"{lines[2]} {mode % '#INTERPOLATE'}"))
    with pytest.raises(ProgramError, match="E1, which carries the robot, is led through"):
        read(body(*lines[:2], f"{lines[2]} {mode % '#INTERPOLATE'}"), cell=rail)


@pytest.mark.parametrize(("turn", "word", "refused"), [(5, "SLIN", True), (0.4, "SLIN", False), (5, "LIN", False)])
@pytest.mark.parametrize("mode", ["#ON", "#OFF", "CHOSEN"])
def test_the_controller_must_not_choose_to_lead_the_orientation_by_the_wrist(turn, word, refused, mode):
    end = f"{word} {{X 30,A {10 + turn},B 20,C 170}}"
    programs = [
        (FULL, f"$SPL_ORI_JOINT_AUTO={mode}", end),
        ("DECL SW_ONOFF CHOSEN", FULL, "$spl_ori_joint_auto = #ON", end),
    ]
    if word == "SLIN":
        programs.append((FULL, f"{end} WITH $SPL_ORI_JOINT_AUTO={mode}"))
        programs.append((f"$SPL_ORI_JOINT_AUTO={mode}", "BAS(#INITMOV,0)", FULL, end))
        programs.append((f"IF $IN[1] THEN\r\n$SPL_ORI_JOINT_AUTO={mode}\r\nENDIF", FULL, end))
    for lines in programs:
        if refused and "#OFF" not in "".join(lines):
            with pytest.raises(ProgramError, match="SPL_ORI_JOINT_AUTO"):
                read(body(*lines))
        else:
            assert len(read(body(*lines)).motions) == 2


@pytest.mark.parametrize("name", ["$TECH[1]", "$tech_c[2]", "$SPL_TECH[1]"])
def test_a_motion_that_is_superposed_on_the_path_is_refused(name):
    read(body(FULL, f"{name}.MODE=#OFF", f"{name}.CLASS=#PATH"))
    with pytest.raises(ProgramError, match="superposes a motion on the path"):
        read(body(FULL, f"{name}.MODE=#CYCLE"))
    with pytest.raises(ProgramError, match="in WITH is not understood"):
        read(body(FULL, f"SLIN {{X 30}} WITH {name}.MODE=#CYCLE"))


# --- writing -----------------------------------------------------------------------------------------------------


def rewritten_lines(lines, turned=(), raised=(), data=None, pieces=None, end="\r\n"):
    """Lines of a program in which some motions are turned by 0.05° and raised by 1 mm, checked by reading."""
    program = read(body(*lines, end=end), data)
    count = len(program.motions)
    shift = up(program, *raised, by=1.0)
    turn = np.zeros(count)
    turn[list(turned)] = 1e-3
    wanted = targets(program, shift, turn, pieces=pieces)
    wanted = keep_unmoved(program, wanted, shift, turn)
    written = krl.rewrite(program, wanted)
    assert {issue.kind for issue in written.issues} <= {"relative-made-absolute", "point-duplicated"}
    check_commands(program, wanted, written, approximated=False)
    return [document.text.split(end) for document in written.documents]


def test_corrected_motions_are_freed_and_the_one_behind_them_comes_back():
    lines = ("  $ORI_TYPE=#CONSTANT", *(f"  LIN {{X {x},Y 2,Z 3,A 10,B 20,C 170}} C_DIS" for x in range(1, 7)))
    (src,) = rewritten_lines((FULL, *lines), turned=(2, 3))
    assert [line.split("{")[0].strip() for line in src[4:14]] == [
        "$ORI_TYPE=#CONSTANT",
        "LIN",
        "$ORI_TYPE=#VAR",
        "LIN",
        "LIN",
        "LIN",
        "$ORI_TYPE=#CONSTANT",
        "LIN",
        "LIN",
        "END",
    ]
    assert src[6] == "  $ORI_TYPE=#VAR"
    assert src[9:13] == [lines[4], "  $ORI_TYPE=#CONSTANT", *lines[5:]]


def test_a_target_whose_angles_were_ignored_gets_the_ones_that_were_meant():
    (src,) = rewritten_lines((FULL, "$ORI_TYPE=#CONSTANT", "LIN {X 5,A 80}", "lin {x 9,a 44}"), turned=(1,))
    assert src[7] == "lin {x 9,a 10.00000,b 20.00000,c 170.00000}"


@pytest.mark.parametrize("kind", ["#JOINT", "#IGNORE"])
def test_an_orientation_that_stays_is_freed_to_be_corrected(kind):
    still = [f"LIN {{X {x},Y 2,Z 3,A 10,B 20,C 170}}" for x in range(5)]
    lines = (still[0], f"$ORI_TYPE={kind}", *still[1:4], f"S{still[4]}", "$ORI_TYPE=#VAR", FULL)
    (src,) = rewritten_lines(lines, turned=(2,))
    around = ["LIN", "$ORI_TYPE=#VAR", "LIN", "LIN", f"$ORI_TYPE={kind}"]
    if kind == "#IGNORE":  # the controller chooses the orientation at its target, where the next one starts
        around = [around[1], around[0], *around[2:]]
    assert [line.split("{")[0].strip() for line in src[5:10]] == around
    (src,) = rewritten_lines(lines, turned=(4,))
    assert next(line for line in src if line.startswith("SLIN")).endswith("} WITH $ORI_TYPE=#VAR")
    assert ("$ORI_TYPE=#VAR" in src[:8]) == (kind == "#IGNORE")


def test_a_position_alone_is_corrected_without_freeing():
    (src,) = rewritten_lines((FULL, "$ORI_TYPE=#CONSTANT", "LIN {X 5,A 80}", "LIN {X 9}"), raised=(1, 2))
    assert not any("#VAR" in line for line in src)


def test_spline_motions_are_freed_by_with():
    lines = (
        "SPLINE WITH $ORI_TYPE=#CONSTANT",
        "SLIN {X 5,A 80}",
        "SCIRC {X 9,Y 4,Z 0},{X 13,Y 0,Z 0} WITH $ORI_TYPE=SORI_TYP(LCPDAT1),$VEL.CP=0.1",
        "SLIN {X 30} WITH $VEL.CP=0.2",
        "SLIN {X 40}",
        "SPL {X 50} ;last",
        "ENDSPLINE",
    )
    data = "DEFDAT part\nDECL LDAT LCPDAT1={VEL 2.0,ACC 100.0,ORI_TYP #CONSTANT,CIRC_TYP #PATH}\nENDDAT\n"
    src, _ = rewritten_lines((FULL, *lines), turned=(1, 2, 5), raised=(1, 2), data=data, pieces={1: [0.5]})
    assert src[5].endswith("} WITH $ORI_TYPE=#VAR")
    assert src[6].endswith("} WITH $ORI_TYPE=#VAR")
    assert src[7].endswith("} WITH $ORI_TYPE=#VAR,$VEL.CP=0.1")
    assert src[8] == "SLIN {X 30,Z 0.0000,A 10.00000,B 20.00000,C 170.00000} WITH $ORI_TYPE=#VAR, $VEL.CP=0.2"
    assert src[9] == "SLIN {X 40}"
    assert src[10].endswith("} WITH $ORI_TYPE=#VAR ;last")


@pytest.mark.parametrize("end", ["\r\n", "\n"])
def test_named_relative_and_divided_motions_are_freed(end):
    data = "DEFDAT part\nDECL E6POS XP1={X 5,Y 0,Z 0,A 1,B 2,C 3,S 2,T 10}\nENDDAT\n"
    lines = (FULL, "$ORI_TYPE=#CONSTANT", "LIN XP1 C_DIS", ";FORCE OFF", "LIN_REL {Y 30}", "CIRC {X 9,Y 40},{X 5,Y 50}")
    rewritten_lines(lines, turned=(1, 2, 3), raised=(1,), data=data, pieces={2: [0.3, 0.6], 3: [0.5]}, end=end)


def test_a_loop_of_corrected_rounds_stays_a_loop():
    loop = ("FOR I=1 TO 3", "LIN {X 5} C_DIS", "LIN {X 0} C_DIS", "ENDFOR")
    program = read(body("INT I", FULL, "$ORI_TYPE=#CONSTANT", *loop, "LIN {X 30}").replace("INT I\r\n", ""))
    turn = np.full(len(program.motions), 1e-3)
    written = krl.rewrite(program, targets(program, turn=turn))
    text = written.documents[0].text
    assert text.count("LIN ") == 4
    assert text.count("#VAR") == text.count("#CONSTANT") - 1 == 2


def test_programs_that_need_no_correction_come_back_to_the_byte():
    for kind, circle in MODES:
        program = read(body(*FRAMES, FULL, f"$ORI_TYPE={kind}", f"$CIRC_TYPE={circle}", *ARCS))
        written = krl.rewrite(program, targets(program, keep=True))
        assert written.documents[0].text == program.documents[0].text


@pytest.mark.parametrize(("kind", "circle"), MODES)
def test_corrected_programs_hold_the_tool_where_it_was_in_the_cell(kind, circle):
    arcs = (
        "CIRC {X 3.75,Y 16.9,Z 0},{X 17,Y 32.8,Z 0,A 160,B 5,C 175} C_DIS",
        "CIRC {X 34,Y 39,Z 1},{X 50,Y 36,Z 0,A 140,B 8,C 170}",
        "LIN {X 70,Y 30,Z 5,A 150,B 5,C 165} C_DIS",
        ";FORCE OFF",
        "LIN {X 40,Y -60,Z 10,A 165,B 5,C 165}",
    )
    modes = (f"$ORI_TYPE={kind}", f"$CIRC_TYPE={circle}")
    force = ";FORCE FX=-110 FY=190 FZ=130"
    text = body(*FRAMES, "$VEL.CP=0.05", "LIN {X 0,Y 0,Z 0,A 180,B 0,C 180}", *modes, force, *arcs)
    cell = cells.load(CELL_FILE)
    model = robot.load(robot.find(cell.robot))
    program = read_files({"part.src": text}, cell, model)
    result = correction.process(program, model, cell)
    assert not result.failed, result.issues
    moves = cell_sim.read(result.documents[0].text)
    check_targets(result, simulator("cell_kr270.toml"), moves, 1)
    again = krl.read_program(result.documents, cell, forward, "part")
    assert (again.motions.kind == CIRC).sum() >= 3
    nominal = np.array([abc(*(row[name] for name in "XYZABC"))[:3, :3] for row in rows_of(result)])
    off = np.degrees(Rotation.from_matrix(nominal.transpose(0, 2, 1) @ again.motions.target[:, :3, :3]).magnitude())
    assert 0.001 < off.max() < 0.2  # the correction of the orientation


BEFORE = "LIN {X 0,Y 0,Z 0,A 0,B 0,C 180}"
ROUND = "SCIRC {X 50,Y -50,Z 0%s},{X 100,Y 0,Z 0,A %g,B 0,C 180}"
IGNORED = f"{MODE}=#IGNORE"


@pytest.mark.parametrize(
    ("auxiliary", "end", "behind", "written"),
    [
        (",A 0,B 0,C 180", 0, f" WITH {MODE}=#INTERPOLATE", f" WITH {IGNORED}"),
        (",A 0,B 0,C 180", 0, " WITH $CIRC_MODE=SCIRC_M(L) C_SPL", f" WITH $CIRC_MODE=SCIRC_M(L), {IGNORED} C_SPL"),
        ("", 0, f" WITH $VEL.CP=0.1, {MODE}=#INTERPOLATE ;x", f" WITH $VEL.CP=0.1, {IGNORED} ;x"),
        (",A 100,B 0,C 180", 0, " c_spl", f" WITH {IGNORED} c_spl"),
        (",A 100,B 0,C 180", 0, " C_DIS C_DIS", f" WITH {IGNORED} C_DIS C_DIS"),
        (",A 17,B 0,C 180", 170, "", f" WITH {IGNORED}"),
        (",A 70,B 0,C 180", 75, " C_SPL", f" WITH {IGNORED} C_SPL"),
        (",A 100,B 0,C 180", 0, f" WITH {IGNORED}", f" WITH {IGNORED}"),
        ("", 100, " C_SPL", " C_SPL"),
    ],
)
@pytest.mark.parametrize("pieces", [None, {1: [0.3, 0.6, 0.9]}])
def test_an_auxiliary_orientation_does_not_lead_a_corrected_circle_elsewhere(auxiliary, end, behind, written, pieces):
    data = "DEFDAT part\nDECL LDAT L={VEL 2.0,CB {AUX_PT {ORI #INTERPOLATE}}}\nENDDAT\n"
    src, _ = rewritten_lines(
        (BEFORE, ROUND % (auxiliary, end) + behind), turned=(1,), raised=(1,), data=data, pieces=pieces
    )
    arcs = [line for line in src if line.startswith("SCIRC")]
    assert len(arcs) == (1 if pieces is None else 4)
    tails = [line.partition("},{")[2].partition("}")[2] for line in arcs]
    assert tails[-1] == written
    assert {re.sub("(?i) c_spl$", "", tail) for tail in tails[:-1]} <= {re.sub("(?i) c_spl$| ;x$", "", written)}


def test_a_circle_whose_start_is_corrected_does_not_heed_its_auxiliary_orientation():
    (src,) = rewritten_lines((BEFORE, ROUND % (",A 100,B 0,C 180", 0)), turned=(0,))
    assert src[4].endswith(f"}} WITH {IGNORED}")
    (src,) = rewritten_lines((BEFORE, "LIN {X 5}", "LIN {X 0}", ROUND % (",A 100,B 0,C 180", 0)), turned=(1,))
    assert src[6] == ROUND % (",A 100,B 0,C 180", 0)


@pytest.mark.parametrize("behind", ["$CIRC_TYPE=#BASE", "$CIRC_MODE=SCIRC_M(L)", f"{MODE}=#IGNORE,$CIRC_TYPE=#BASE"])
def test_lines_in_place_of_a_scirc_set_nothing_that_only_circles_have(behind):
    data = "DEFDAT part\nDECL LDAT L={VEL 2.0,CB {AUX_PT {ORI #INTERPOLATE}}}\nENDDAT\n"
    for before, left in (("", ""), ("$VEL.CP=0.1,", " WITH $VEL.CP=0.1")):
        program = read(body(BEFORE, f"{ROUND % ('', 0)} WITH {before}{behind} C_SPL ;x"), data)
        lines = targets(program, up(program, 1, by=1.0), np.zeros(2), pieces={1: [0.1, 0.5]})
        arc = lines.motion == 1
        lines = msgspec.structs.replace(lines, kind=np.where(arc, LIN, lines.kind), via=np.full_like(lines.via, np.nan))
        src = krl.rewrite(program, lines).documents[0].text.splitlines()
        assert [line.partition("}")[2] for line in src if line.startswith("SLIN")] == [f"{left} C_SPL"] * 2 + [
            f"{left} C_SPL ;x"
        ]
