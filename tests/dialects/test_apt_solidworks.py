"""Cutter-location files as SolidWorks CAM and Siemens NX write them: CSYS, CUTCOM, arcs, helices, cycles, inserts."""

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from postproc.cell import Apt
from postproc.errors import InputError
from postproc.program import CIRC
from tests.dialects.apt_reading import AT_Z9, points, read
from tests.dialects.gcode_reading import CELL
from tests.dialects.gcode_reading import read as read_gcode

LOAD_TOOL = """INSERT/[HOLDER=C40-M10EM2] 10MM CRB 2FL 22 LOC
CUTTER/10.,0,5.,0,0,0,73.
LOAD/TOOL,2
CSI_SET_FLUTE_LENGTH/22.
CSI_SET_EXTENSION_LENGTH/50.
SELECT/TOOL,15
COOLNT/FLOOD
SPINDL/2435,RPM,CLW
"""
OPERATION = """INSERT/Stock Size X240. Y50. Z50.
TRNTYP/WORLD,0,0,0
CSYS/{csys}
RAPID/
GOTO/{start}
FEDRAT/300.,MMPM
"""
IDENTITY = "1.,0,0,0,0,1.,0,0,0,0,1.,0"


def solidworks_program(body: str, csys: str = IDENTITY, start: str = "10.,5.,25.", tool: str = LOAD_TOOL) -> str:
    return "PARTNO/1\nUNIT/MM\n" + tool + OPERATION.format(csys=csys, start=start) + body + "FINI\n"


def test_a_file_of_solidworks_cam_is_read() -> None:
    read_program = read(solidworks_program("GOTO/10.,5.,-1.\nGOTO/40.,5.,-1.\n"))
    np.testing.assert_allclose(points(read_program), [[10, 5, 25], [10, 5, -1], [40, 5, -1]], atol=1e-9)
    comments = [event.text for event in read_program.events if event.kind == "comment"]
    assert "[HOLDER=C40-M10EM2] 10MM CRB 2FL 22 LOC" in comments
    assert "STOCK SIZE X240. Y50. Z50." in comments


def csys_numbers(rotation: np.ndarray, offset: np.ndarray) -> str:
    return ",".join(f"{value:.9f}" for value in np.hstack([rotation, offset[:, None]]).ravel())


def test_copies_of_an_operation_are_where_their_coordinates_say() -> None:
    """CSYS of a nested copy maps it onto the first: applied to the coordinates, all copies would cut one place."""
    seed = np.array([[10.0, 5.0, 25.0], [10.0, 5.0, -1.0], [40.0, 9.0, -1.0]])
    for degrees, shift in ((180.0, [250.0, 60.0, 0.0]), (90.0, [120.0, 30.0, 0.0])):
        turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
        copy = seed @ turn.T + shift
        offset = -turn.T @ np.array(shift)  # seed = turnᵀ·copy + offset: the rows of CSYS are those of turn
        np.testing.assert_allclose(copy @ turn + offset, seed, atol=1e-9)
        text = "".join("GOTO/" + ",".join(f"{value:.6f}" for value in point) + "\n" for point in copy)
        read_program = read(solidworks_program(text, csys_numbers(turn, offset), start="0,0,25."))
        np.testing.assert_allclose(points(read_program)[-2:], copy[-2:], atol=1e-5)


def test_the_third_column_of_csys_is_the_direction_of_the_tool() -> None:
    tilted = Rotation.from_euler("y", -10.0, degrees=True)
    direction = tilted.apply([0.0, 0.0, 1.0])
    vector = ",".join(f"{value:.9f}" for value in direction)
    csys = csys_numbers(tilted.as_matrix(), np.zeros(3))
    body = f"GOTO/10.,5.,20.,{vector}\n" + OPERATION.format(csys=IDENTITY, start="10.,5.,30.") + "GOTO/10.,5.,-1.\n"
    read_program = read(solidworks_program(body, csys, start=f"10.,5.,25.,{vector}"))
    np.testing.assert_allclose(-read_program.motions.target[:2, :3, 2], [direction] * 2, atol=1e-8)
    np.testing.assert_allclose(-read_program.motions.target[2:, :3, 2], [[0, 0, 1]] * 2, atol=1e-8)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            solidworks_program("GOTO/1,2,3\n", "0,0,1.,0,0,1.,0,0,-1.,0,0,0", "10.,5.,25.,1.,0,0"),
            "GOTO without a direction",
        ),
        (solidworks_program("GOTO/1,2,3\n", "2.,0,0,0,0,1.,0,0,0,0,1.,0"), "CSYS has no axes of length 1"),
        (solidworks_program("GOTO/1,2,3\n").replace("TRNTYP/WORLD,0,0,0", "TRNTYP/LOCAL"), "TRNTYP other than WORLD"),
        (
            solidworks_program("GOTO/1,2,3\n", "-1.,0,0,0,0,-1.,0,0,0,0,1.,0").replace("TRNTYP/WORLD,0,0,0\n", ""),
            "CSYS without TRNTYP",
        ),
        (solidworks_program("GOTO/1,2,3\nINSERT/G28 Z0\n"), "is for one control"),
        (solidworks_program("GOTO/1,2,3\nINSERT/L Z100 R0 FMAX M91\n"), "is for one control"),
    ],
)
def test_what_may_move_the_tool_elsewhere_is_an_error(text: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        read(text)


def test_an_arc_of_six_numbers_turns_right_handed_from_the_place_of_the_tool() -> None:
    body = "GOTO/10.,5.,-1.\nCIRCLE/20.,5.,-1.,0,0,1.\nGOTO/20.,-5.,-1.\nCIRCLE/20.,5.,-1.,0,0,-1.\nGOTO/10.,5.,-1.\n"
    motions = read(solidworks_program(body)).motions
    arcs = motions.kind == CIRC
    np.testing.assert_allclose(np.rad2deg(motions.sweep[arcs]), [90.0, 90.0], atol=1e-9)
    np.testing.assert_allclose(motions.normal[arcs], [[0, 0, 1], [0, 0, -1]], atol=1e-12)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_helix_of_several_turns_is_that_of_g_code(turns: int) -> None:
    """NX turns clockwise about i, j, k: about −z it is counter-clockwise from above, G3 with P."""
    text = AT_Z9 + f"GOTO/10,0,0\nCIRCLE/0,0,-3,0,0,-1,10,.06,.5,25,1,TIMES,{turns}\nGOTO/0,-10,-3\nFINI"
    gcode = read_gcode(f"G21 G90\nG0 X0 Y0 Z9\nG1 X10 Z0 F600\nG3 X0 Y-10 Z-3 I-10 J0 P{turns}\nM2")
    sweep = read(text).motions.sweep[-1]
    assert sweep == pytest.approx(gcode.motions.sweep[-1], abs=1e-12)
    assert np.rad2deg(sweep) == pytest.approx(270.0 + 360.0 * (turns - 1), abs=1e-9)


@pytest.mark.parametrize(
    ("cycle", "depths"),
    [
        ("CYCLE/DRILL,FEDTO,12.,MMPM,108.,RAPTO,3.,RTRCTO,25.,DWELL,0", [-12.0]),
        ("CYCLE/DEEP2,FEDTO,12.,1STPECK,5.,SUBPECK,2.,MMPM,80.,RAPTO,3.,RTRCTO,25.", [-2, -4, -6, -8, -10, -12]),
        ("CYCLE/DEEP,FEDTO,12.,INCR,10.,MMPM,80.,RAPTO,3.,RTRCTO,25.", [-7.0, -12.0]),
    ],
)
def test_depths_of_holes_are_below_their_tops(cycle: str, depths: list[float]) -> None:
    for first in ("INIT", "CLEAR"):
        read_program = read(solidworks_program(f"CYCLE/{first}\n{cycle}\nGOTO/10.,5.,4.\nCYCLE/OFF\n"))
        feeds = ~read_program.motions.rapid
        np.testing.assert_allclose(points(read_program)[feeds][:, 2] - 4.0, depths, atol=1e-9)
        assert points(read_program)[-1, 2] == pytest.approx(29.0)


LEAD_IN = (
    "CUTCOM/{side}\nGOTO/10.,5.,-1.\nCIRCLE/{centre},-1.,0,0,{axis}.\nGOTO/{end},-1.\nGOTO/40.,9.,-1.\nCUTCOM/OFF\n"
)


@pytest.mark.parametrize(
    ("side", "centre", "axis", "end", "is_centre"),
    [
        ("LEFT", "12.,5.", "1", "12.,3.", True),  # an inside arc of 2 mm: a contour could not be followed with R 5
        ("RIGHT", "12.,5.", "-1", "12.,7.", True),
        ("LEFT", "16.,5.", "1", "16.,-1.", False),  # of 6 mm: it may be a contour
        ("LEFT", "12.,5.", "-1", "12.,7.", False),  # an outside arc
    ],
)
def test_a_lead_in_smaller_than_the_cutter_shows_the_path_of_the_centre(
    side: str, centre: str, axis: str, end: str, is_centre: bool
) -> None:
    text = solidworks_program(LEAD_IN.format(side=side, centre=centre, axis=axis, end=end))
    wear = replace(CELL, gcode=replace(CELL.gcode, radius_offsets="wear"))
    assert "radius-compensation" in [issue.kind for issue in read(text, wear).issues]
    if is_centre:
        assert "radius-compensation" in [issue.kind for issue in read(text).issues]
        second = LEAD_IN.format(side="LEFT", centre="16.,5.", axis="1", end="16.,-1.")
        with pytest.raises(InputError, match="the radius of the tool is in the control"):
            read(text.replace("FINI", second + "FINI"))  # each pair of CUTCOM is judged alone
    else:
        with pytest.raises(InputError, match="the radius of the tool is in the control"):
            read(text)


def test_gohome_with_a_place_goes_there_in_rapid() -> None:
    motions = read(AT_Z9 + "GOTO/10,0,0\nGOHOME/1,2,30\nFINI").motions
    np.testing.assert_allclose(motions.target[-1, :3, 3] * 1e3, [1, 2, 30], atol=1e-9)
    assert motions.rapid[-1]


def test_a_program_from_below_tilts_the_tool_from_below() -> None:
    text = "UNITS/MM\nRAPID\nGOTO/0,0,-9,0,0,-1\nFEDRAT/300,MMPM\nGOTO/5,0,-9,0.1,0,-0.994987437\nFINI"
    target = read(text).motions.target
    np.testing.assert_allclose(-target[:, :3, 2], [[0, 0, -1], [0.1, 0, -0.994987437]], atol=1e-8)
    turn = Rotation.from_matrix(target[1, :3, :3] @ target[0, :3, :3].T).magnitude()
    assert turn == pytest.approx(np.arcsin(0.1), abs=1e-8)


def test_one_key_of_the_cell_passes_over_all_statements_of_a_shop() -> None:
    text = AT_Z9 + "GOTO/1,2,3\n" + "TLSPEC/1,2\nGOTO/2,2,3\n" * 3 + "FINI"
    with pytest.raises(InputError, match=r'without_effect = \["TLSPEC"\]'):
        read(text)
    assert (
        len(read(text, replace(CELL, apt=Apt(without_effect=["TLSPEC"]))).motions) == 3
    )  # a point given again is no motion
    refused = replace(CELL, apt=Apt(without_effect=["NURBS"]))
    with pytest.raises(InputError, match="NURBS is not supported"):
        read(AT_Z9 + "NURBS/1\nGOTO/1,2,3\nFINI", refused)
