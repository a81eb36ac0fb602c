"""Variables of the controller that are read as values: the present one, or refused. The oracle executes them."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.errors import CellError, ProgramError
from tests.attack.krl import confirmed, read_job
from tests.dialects.krl_programs import CELL, body, read
from tests.krl_texts import HOME

FULL = "LIN {X 10,Y 20,Z 300,A 10,B 20,C 170}"
FRAMES_DAT = """DEFDAT part PUBLIC
DECL FRAME OLD={X 1,Y 2,Z 3,A 0,B 0,C 0}
DECL FRAME HELD={X 1,Y 2,Z 3,A 0,B 0,C 0}
DECL E6POS XP1={X 40,Y 60,Z 10,A 10,B 20,C 170}
DECL INT N=0
DECL REAL V=0.0
ENDDAT
"""
POCKET = """DEF POCKET( )
DECL FRAME BEFORE
BEFORE=$BASE
$BASE=BEFORE:{X 60,Y 60,Z 0,A 45,B 0,C 0}
LIN {X 40,Y 60,Z 10,A 10,B 20,C 170}
LIN {X 60,Y 60,Z 0,A 10,B 20,C 170}
$BASE=BEFORE
END
"""
BY_VALUE = """DEF AT(F:IN)
DECL FRAME F
$BASE=F:{X 5,Y 0,Z 0,A 10,B 0,C 0}
LIN XP1
$BASE=F
END
DEFFCT FRAME SHIFTED(F:IN)
DECL FRAME F
RETURN F:{X 7,Y 0,Z 0,A 0,B 0,C 30}
ENDFCT
"""
READS = {
    "a routine that saves and restores its frame, called twice": ["POCKET( )", "$BASE=BASE_DATA[3]", "POCKET( )", FULL],
    "saved, replaced, restored": ["OLD=$BASE", "$BASE=BASE_DATA[2]", FULL, "$BASE=OLD", FULL],
    "a tool that is restored": ["OLD=$TOOL", "$TOOL=TOOL_DATA[2]", FULL, "$TOOL=OLD", FULL],
    "saved after a number": ["BAS(#BASE,2)", "OLD=$BASE", "BAS(#BASE,3)", "$BASE=OLD", FULL],
    "components": ["$BASE=BASE_DATA[2]", "LIN {X $BASE.X,Y $BASE.Y,Z $TOOL.Z,A 10,B 20,C 170}", FULL],
    "an angle": ["$BASE=BASE_DATA[1]", "XP1.A=$BASE.A", "LIN XP1", FULL],
    "a condition": ["$BASE=BASE_DATA[3]", "IF $BASE.X>1100 THEN", FULL, "ENDIF", "LIN XP1"],
    "a component in a component": ["$BASE.Z=$BASE.Z+25", "$BASE.Z=$BASE.Z+25", FULL],
    "an argument": ["AT($BASE)", "$BASE=BASE_DATA[2]", "AT($BASE)", FULL],
    "an argument of a function": ["$BASE=SHIFTED($BASE)", FULL, "$BASE=SHIFTED($BASE)", FULL],
    "an operand of a target": ["OLD=INV_POS($BASE)", "$BASE=$NULLFRAME", "LIN INV_POS(OLD):XP1", FULL],
    "combined": ["OLD=$BASE", "HELD=OLD:{X 3,Y 4,Z 5,A 6,B 0,C 0}", "$BASE=HELD", "OLD=$BASE", "$BASE=OLD:OLD", FULL],
    "rounds of a loop": ["FOR N=1 TO 3", "$BASE=$BASE:{X 10,Y 0,Z 0,A 5,B 0,C 0}", FULL, "ENDFOR"],
    "a speed that is restored": ["$VEL.CP=0.2", "V=$VEL.CP", "$VEL.CP=0.1", FULL, "$VEL.CP=V", FULL],
    "a speed set by a routine": ["$VEL.CP=0.2", "SLOW( )", FULL],
    "a loop that ends by a component": ["WHILE $BASE.Z<640", "$BASE.Z=$BASE.Z+40.5", FULL, "ENDWHILE", "LIN XP1"],
    "a loop that ends by a tool": ["REPEAT", "$TOOL.Z=$TOOL.Z+20", FULL, "UNTIL $TOOL.Z>290", "LIN XP1"],
    "settings of one spline motion": ["SLIN XP1 WITH $BASE=BASE_DATA[2]", "OLD=$BASE", "$BASE=OLD", FULL],
    "a mode": ["IF $ORI_TYPE==#VAR THEN", FULL, "ENDIF", "IF $IPO_MODE==#TCP THEN", "LIN XP1", "ENDIF", FULL],
    "a distance": ["$APO.CDIS=2.5", "V=$APO.CDIS", "$APO.CDIS=1", FULL + " C_DIS", "$APO.CDIS=V", FULL + " C_DIS"],
    "both ends of a branch": [
        "IF $IN[1] THEN",
        "$OUT[1]=TRUE",
        "ENDIF",
        "OLD=$BASE",
        "$BASE=BASE_DATA[1]",
        "$BASE=OLD",
    ],
}
SLOW = "DEF SLOW( )\nDECL REAL HOW\nHOW=$VEL.CP\n$VEL.CP=HOW*0.5\nLIN XP1\nEND\n"


@pytest.mark.parametrize("lines", READS.values(), ids=READS)
def test_what_is_read_of_the_settings_is_what_is_in_force(tmp_path, lines):
    files = {
        "part.src": body(FULL, *lines, FULL, end="\n") + POCKET + BY_VALUE + SLOW,
        "part.dat": FRAMES_DAT,
    }
    program = read_job(files, tmp_path)
    assert confirmed(program, files, tmp_path, np.random.default_rng(0)) == "accepted"


REFUSED = {
    "a frame that is not known": (["$BASE=BASE_DATA[9]", "OLD=$BASE", "$BASE=OLD", FULL], r"BASE_DATA\[9\] is neither"),
    "an angle beyond half a turn": (["$BASE={X 1,Y 2,Z 3,A 200,B 0,C 0}", "XP1.A=$BASE.A", "LIN XP1"], "in no source"),
    "an angle at 180°": (["OLD=$NULLFRAME:{X 0,Y 0,Z 0,A 180,B 0,C 0}", "XP1.A=OLD.A", "LIN XP1"], "two sets"),
    "an angle beside B 90": (
        ["$BASE={X 1,Y 2,Z 3,A 0,B 90,C 0}", "$BASE.A=5", FULL],
        r"\$BASE is not known",
    ),
    "another in WITH": (["SLIN XP1 WITH $TOOL=$TOOL"], "behind it is in no source"),
    "a target before WITH": (["SLIN $BASE:XP1 WITH $BASE=BASE_DATA[3]"], "behind it is in no source"),
    "the frame of a spline block": (["SPLINE", "SLIN {X $BASE.X,Y 0,Z 0,A 0,B 0,C 0}", "ENDSPLINE"], "spline block"),
    "the number of a frame": (["BAS(#BASE,3)", "N=$ACT_BASE", "FOR N=N TO 4", FULL, "ENDFOR"], "bounds are not known"),
    "a speed that nothing sets": (["V=$VEL.CP", "$VEL.CP=V", FULL], r"\$VEL.CP is computed"),
    "a frame that branches leave": (
        ["IF $IN[1] THEN", "$BASE=BASE_DATA[3]", "ENDIF", "OLD=$BASE", "$BASE=OLD", FULL],
        "changed inside IF",
    ),
    "a frame written cyclically": (["ANIN ON $BASE.X=1.0*$ANIN[1]+0", FULL], "at any time"),
    "a frame that a call may write": (["BY_REF($BASE)", FULL], r"\$BASE is given to BY_REF"),
}


@pytest.mark.parametrize(("lines", "problem"), REFUSED.values(), ids=REFUSED)
def test_what_no_source_states_of_the_settings_is_refused(lines, problem):
    with pytest.raises(ProgramError, match=problem):
        read(body(*lines), FRAMES_DAT)


@pytest.mark.parametrize(
    ("lines", "feeds"),
    [
        (["$VEL.CP=0.2", "WHILE $VEL.CP>0.15", FULL, "$VEL.CP=0.1", "ENDWHILE", FULL], [0.2, 0.1]),
        (["$VEL.CP=0.5", "IF $VEL.CP>0.3 THEN", FULL, "$VEL.CP=0.2", "ENDIF", FULL], [0.5, 0.2]),
        (["$VEL.CP=0.5", FULL, "$VEL.CP=0.2", "IF $VEL.CP>0.3 THEN", FULL, "ENDIF", FULL], [0.5, 0.2]),
        (["$VEL.CP=0.5", "V=$VEL.CP", "IF V>0.3 THEN", "$VEL.CP=0.1", FULL, "ENDIF", "$VEL.CP=V", FULL], [0.1, 0.5]),
    ],
)
def test_the_speed_decides_loops_and_branches_around_motions(lines, feeds, tmp_path):
    files = {"part.src": body(*lines, end="\n"), "part.dat": FRAMES_DAT}
    assert read(body(*lines), FRAMES_DAT).motions.feed.tolist() == feeds
    assert confirmed(read_job(files, tmp_path), files, tmp_path, np.random.default_rng(0)) == "accepted"


def test_behind_more_plain_settings_than_are_followed_the_speed_decides_nothing():
    settings = [f"$VEL.CP=0.{n}" for n in range(1001, 2100)]
    with pytest.raises(ProgramError, match="whose condition is not known"):
        read(body(*settings, "IF $VEL.CP>0.3 THEN", FULL, "ENDIF", "LIN XP1"), FRAMES_DAT)


def test_flags_keep_what_the_program_writes(tmp_path):
    lines = [
        "$FLAG[3]=TRUE",
        "IF $FLAG[3] THEN",
        FULL,
        "ENDIF",
        "$FLAG[3]=FALSE",
        "IF $FLAG[3] THEN",
        "LIN XP1",
        "ENDIF",
    ]
    assert len(read(body(FULL, *lines), FRAMES_DAT).motions) == 2
    with pytest.raises(ProgramError, match="end in different places"):
        read(body(FULL, "IF $FLAG[4] THEN", "LIN XP1", "ENDIF", FULL), FRAMES_DAT)


def test_a_value_of_the_cell_ends_where_the_program_writes_the_variable():
    cell = replace(CELL, krl=replace(CELL.krl, values={"$FLAG[1]": True, "$OV_PRO": 100}))
    asked = ["IF $FLAG[1] THEN", "LIN XP1", "ENDIF"]
    assert len(read(body(FULL, *asked), FRAMES_DAT, cell).motions) == 2
    assert len(read(body(FULL, "$FLAG[1]=FALSE", *asked), FRAMES_DAT, cell).motions) == 1
    with pytest.raises(ProgramError, match="end in different places"):
        read(body(FULL, "$OV_PRO=50", "IF $OV_PRO==100 THEN", "LIN XP1", "ENDIF", FULL), FRAMES_DAT, cell)


@pytest.mark.parametrize("key", ["$BASE.X", "$ACT_BASE", "$POS_ACT.X", "$VEL.CP", "$OUT[3]"])
def test_the_cell_cannot_give_what_the_program_changes(key):
    with pytest.raises(CellError, match="the program changes it"):
        read(body(FULL), FRAMES_DAT, replace(CELL, krl=replace(CELL.krl, values={key: 1.0})))


def test_a_frame_read_in_doubt_is_warned_of():
    cell = replace(CELL, krl=replace(CELL.krl, initmov=None))
    program = read(
        body("OLD=$BASE", "$BASE=BASE_DATA[3]", FULL, "$BASE=OLD", "$TOOL=TOOL_DATA[2]", FULL), FRAMES_DAT, cell
    )
    assert ("initial-frames", "$BASE") in [(issue.kind, issue.subject) for issue in program.issues]


def test_a_loop_without_exit_under_frames_that_are_not_known_runs_by_joint_angles():
    lines = ["$BASE=BASE_DATA[8]", "$TOOL=TOOL_DATA[9]", "LOOP", HOME, HOME.replace("A1 0", "A1 5"), "ENDLOOP"]
    assert len(read(body(*lines), FRAMES_DAT).motions) == 2


def test_a_loop_without_exit_that_leaves_a_frame_that_is_not_known_is_refused():
    lines = ["$BASE=BASE_DATA[3]", "LOOP", HOME, FULL, HOME, "$BASE=BASE_DATA[8]", "ENDLOOP"]
    with pytest.raises(ProgramError, match="leaves other frames"):
        read(body(*lines), FRAMES_DAT)


AWAY = {
    "a relative motion": ["LIN_REL {Z 30}", FULL],
    "a component that is missing": ["LIN {Z 30}", FULL],
    "the position asked for": ["XP1=$POS_ACT", "LIN XP1"],
    "a call": ["BACK()", FULL],
}


@pytest.mark.parametrize("lines", AWAY.values(), ids=AWAY)
def test_a_routine_that_is_not_followed_and_begins_from_the_robot_position_is_said_to_be_moved(tmp_path, lines):
    away = ["DEF AWAY()", *lines, "WHILE $IN[1]", HOME, "ENDWHILE", "END", "DEF BACK()", "LIN_REL {Z 1}", "END", ""]
    files = {"part.src": body(FULL, "AWAY()", HOME, FULL), "part.dat": FRAMES_DAT, "away.src": "\n".join(away)}
    program = read_job(files, tmp_path)
    (message,) = [issue.message for issue in program.issues if issue.kind == "motions-elsewhere"]
    assert "from the robot position (away.src, line " in message
    function = "\n".join(["DEFFCT INT AWAY()", *away[1:-4], "RETURN (1)", "ENDFCT", *away[-4:]])
    files["part.src"] = body(FULL, "N=AWAY()+1", FULL) + function
    kept = read_job(files, tmp_path, keep=True)
    (message,) = [issue.message for issue in kept.issues if issue.kind == "unresolved" and "AWAY()+1" in issue.message]
    assert "the correction of the motion before it moves it too" in message


def test_a_point_that_may_lack_components_is_said_to_move_with_the_motion_before(tmp_path):
    data = FRAMES_DAT.replace("ENDDAT", "DECL E6POS PART={X 1,Y 2,Z 3}\nENDDAT")
    files = {"part.src": body(FULL, "PART={X 5,Y 6}", "LIN PART", FULL), "part.dat": data}
    kept = read_job(files, tmp_path, keep=True)
    (message,) = [issue.message for issue in kept.issues if issue.kind == "unresolved"]
    assert "the correction of the motion before it moves it too" in message


def test_a_routine_that_is_not_followed_and_begins_with_a_complete_target_is_not_said_to_be_moved(tmp_path):
    away = ["DEF AWAY()", "PTP $POS_ACT", FULL, "LIN_REL {Z 30}", "WHILE $IN[1]", HOME, "ENDWHILE", "END", ""]
    files = {"part.src": body(FULL, "AWAY()", HOME, FULL), "part.dat": FRAMES_DAT, "away.src": "\n".join(away)}
    (message,) = [i.message for i in read_job(files, tmp_path).issues if i.kind == "motions-elsewhere"]
    assert "from the robot position" not in message
