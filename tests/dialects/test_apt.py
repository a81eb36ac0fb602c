"""Cutter-location files (APT, CLDATA, CLSF): the same path as G-code, and the rules that CAM systems publish."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from postproc.cell import Frame, Machine, Rotary
from postproc.cell import load as load_cell
from postproc.dialects.apt import reader, statements
from postproc.dialects.text import decode
from postproc.errors import InputError, ProgramError
from postproc.program import CIRC, LIN, PTP, Motions, Program
from tests.corrections import correct_files
from tests.dialects.apt_reading import AT_Z9, points, read
from tests.dialects.gcode_reading import CELL, forward
from tests.dialects.gcode_reading import read as read_gcode
from tests.kr270 import ROBOT
from tests.places import CELL_FILE


def same(one: Program, other: Program) -> None:
    """All motions are the same, their lines apart."""
    for name in Motions.__struct_fields__:
        if name != "line":
            np.testing.assert_allclose(
                getattr(one.motions, name), getattr(other.motions, name), rtol=0, atol=2e-9, err_msg=name
            )
    assert [(e.before, e.kind, e.value) for e in one.events if e.kind != "comment"] == [
        (e.before, e.kind, e.value) for e in other.events if e.kind != "comment"
    ]
    assert [(n.wrench, n.frame, n.before) for n in one.notes] == [(n.wrench, n.frame, n.before) for n in other.notes]


class Path3:
    """A random path, written as G-code and as cutter-location data by rules of their own."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        inch = bool(self.random.integers(2))
        self.unit = 25.4 if inch else 1.0
        self.nx = bool(self.random.integers(2))
        self.gcode = [f"{'G20' if inch else 'G21'} G90 G17 G94", "T3 M6", "S9000 M3"]
        self.apt = ["PARTNO RANDOM", f"UNITS/{'INCHES' if inch else 'MM'}", "LOADTL/3", "SPINDL/9000,RPM,CLW"]
        self.place = np.array([5.0, 5.0, 40.0])
        self._rapid()
        for _ in range(30):
            self.random.choice([self._feed, self._rapid, self._line, self._line, self._arc, self._step, self._hole])()
        self.gcode += ["M9", "M2"]
        self.apt += ["COOLNT/OFF", "FINI"]

    def _to(self) -> np.ndarray:
        return np.round(self.random.uniform(-50, 50, 3), 3) + np.array([0, 0, 60])

    def _goto(self, place) -> str:
        text = "GOTO/" + ",".join(f"{value:.4f}" for value in place)
        style = self.random.integers(4)
        if style == 0:
            return text.replace("/", " / ").replace(",", ", ")
        if style == 1:
            return text.replace(",", ",$\n  ", 1) + ",0.,0.,1."
        return text + (",0.0000000,0.0000000,1.0000000" if style == 2 else "")

    def _feed(self) -> None:
        feed = float(self.random.integers(100, 900))
        self.gcode.append(f"F{feed}")
        per = "IPM" if self.unit > 1 else "MMPM"
        self.apt.append(f"FEDRAT/{per},{feed}" if self.nx else f"FEDRAT/ {feed}, {per}")

    def _rapid(self) -> None:
        self._feed()
        self.place = self._to()
        self.gcode.append("G0 X{:.4f} Y{:.4f} Z{:.4f}".format(*self.place))
        self.apt += ["RAPID", self._goto(self.place)]

    def _line(self) -> None:
        if self.random.integers(6) == 0:
            force = "FORCE FX=10 FY=-4 FZ=30 FRAME=FEED"
            self.gcode.append(f"({force})")
            self.apt.append(f"$$ {force}" if self.nx else f"PPRINT/{force}")
        self.place = self._to()
        self.gcode.append("G1 X{:.4f} Y{:.4f} Z{:.4f}".format(*self.place))
        self.apt.append(self._goto(self.place))

    def _step(self) -> None:
        step = np.round(self.random.uniform(-3, 3, 3), 2)
        self.place = self.place + step
        self.gcode.append("G91 G1 X{:.4f} Y{:.4f} Z{:.4f}".format(*step) + "\nG90")
        self.apt.append("GODLTA/{:.4f},{:.4f},{:.4f}".format(*step))

    def _arc(self) -> None:
        plane = int(self.random.integers(3))
        first, second = [(0, 1), (2, 0), (1, 2)][plane]
        clockwise, full = bool(self.random.integers(2)), self.random.integers(4) == 0
        start_angle, radius = self.random.uniform(0, 2 * np.pi), self.random.uniform(3, 30)
        turn = 2 * np.pi if full else self.random.uniform(0.2, 6.0)
        turn = -turn if clockwise else turn
        start = self.place
        centre = start.copy()
        centre[[first, second]] -= radius * np.array([np.cos(start_angle), np.sin(start_angle)])
        centre[[first, second]] = np.round(centre[[first, second]], 3)
        radial = (start - centre)[[first, second]]
        end = start.copy()
        cos, sin = np.cos(turn), np.sin(turn)
        if not full:
            end[first] = centre[first] + cos * radial[0] - sin * radial[1]
            end[second] = centre[second] + sin * radial[0] + cos * radial[1]
        across = 3 - first - second
        end[across] += np.round(self.random.uniform(0, 2), 2) * self.random.integers(2)
        end = np.round(end, 4)
        offset = centre - start
        letters = "".join(f"{'IJK'[axis]}{offset[axis]:.4f} " for axis in (first, second))
        self.gcode.append(
            f"G{17 + plane} G{2 if clockwise else 3} X{end[0]:.4f} Y{end[1]:.4f} Z{end[2]:.4f} {letters}\nG17"
        )
        normal = np.eye(3)[across] * (-1 if clockwise else 1)
        style = 1 if abs(turn) < 0.3 or full else int(self.random.integers(3))
        if style == 2 and end[across] == start[across]:
            tangent = np.cross(normal, start - centre)
            beyond = "ON,2,INTOF" if abs(turn) > np.pi else "ON"
            size = np.hypot(*radial)
            self.apt += [
                "INDIRV/{:.9f},{:.9f},{:.9f}".format(*tangent / np.linalg.norm(tangent)),
                "TLON,GOFWD/ (CIRCLE/ {:.4f}, {:.4f}, {:.4f},$\n".format(*centre)
                + f"  {size:.5f}),{beyond},(LINE/ "
                + "{:.4f},{:.4f},{:.4f},$\n ".format(*centre)
                + "{:.4f},{:.4f},{:.4f})".format(*end),
            ]
        else:
            siemens = normal * (-1 if self.nx else 1)
            values = [*centre, *(siemens + 0.0), np.hypot(*radial)]
            text = "CIRCLE/" + ",".join(f"{value:.6f}" for value in values)
            self.apt += [text + (",0.06,0.5,10.0,0.0" if self.nx else ""), self._goto(end)]
            if not self.nx:
                self.apt.append("PAINT/COLOR,31")  # Creo: what follows at once could belong to the arc
        self.place = end

    def _hole(self) -> None:
        top, aside = self._to() - np.array([0, 0, 40]), np.array([9, 0, 0])
        clear, depth, feed = 3.0, float(self.random.integers(4, 20)), float(self.random.integers(50, 200))
        self.gcode += [
            f"G99 G82 X{top[0]:.4f} Y{top[1]:.4f} Z{top[2] - depth:.4f} R{top[2] + clear:.4f} P0.5 F{feed}",
            f"X{top[0] + 9:.4f}",
            "G80",
        ]
        per = "IPM" if self.unit > 1 else "MMPM"
        self.apt += [
            f"CYCLE / DRILL, DEPTH, {depth}, {per}, {feed}, CLEAR, {clear}, DWELL, 0.5",
            self._goto(top),
            self._goto(top + aside),
            "CYCLE / OFF",
        ]
        self.place = top + aside + np.array([0, 0, clear])
        self._feed()


@pytest.mark.parametrize("seed", range(40))
def test_a_path_gives_the_same_motions_as_in_gcode(seed):
    path = Path3(seed)
    cell = replace(CELL, tools={"3": Frame(Z=412.5)}) if seed % 3 else CELL
    same(read("\n".join(path.apt), cell), read_gcode("\n".join(path.gcode), cell))


def test_a_wrong_direction_of_an_arc_would_be_noticed():
    path = Path3(3)
    text = "\n".join(path.gcode)
    with pytest.raises(AssertionError):
        same(
            read("\n".join(path.apt)),
            read_gcode(text.replace("G2 ", "G9 ").replace("G3 ", "G2 ").replace("G9 ", "G3 ")),
        )


@pytest.mark.parametrize("axes", [["C", "B"], ["A", "C"], ["B", "A"]], ids="".join)
def test_tool_vectors_give_the_same_targets_as_rotary_axes(axes):
    random = np.random.default_rng(7)
    cell = replace(CELL, rotary=Rotary(axes=axes, kind="tcp"))
    gcode, apt = ["G21 G90", f"G0 X0 Y0 Z90 {axes[0]}0 {axes[1]}0"], ["MULTAX/ON", "RAPID", "GOTO/0,0,90,0,0,1"]
    vectors = []
    for n in range(60):
        place, angles = np.round(random.uniform(-80, 80, 3), 3), np.round(random.uniform(-70, 70, 2), 3)
        turned = Rotation.identity()
        for axis, angle in zip(axes, angles, strict=True):
            turned = turned * Rotation.from_euler(
                axis.lower().translate(str.maketrans("abc", "xyz")), angle, degrees=True
            )
        vectors.append(turned.apply([0.0, 0.0, 1.0]))
        code = "G0" if n % 9 == 0 else "G1 F500"
        gcode.append(f"{code} X{place[0]} Y{place[1]} Z{place[2]} {axes[0]}{angles[0]} {axes[1]}{angles[1]}")
        apt += ["RAPID"] if n % 9 == 0 else ["FEDRAT/500,MMPM"]
        apt.append("GOTO/" + ",".join(f"{value:.12f}" for value in [*place, *vectors[-1]]))
    program = read("\n".join(apt))
    same(program, read_gcode("\n".join(gcode), cell))
    np.testing.assert_allclose(-program.motions.target[1:, :3, 2], vectors, atol=1e-9)
    assert program.swivel is None


def test_a_whole_conversion_writes_the_same_targets():
    cell = load_cell(CELL_FILE)
    gcode = """(FORCE FX=-110 FY=-190 FZ=130 FRAME=FEED)
G21 G90
G0 X0 Y0 Z20
G1 Z-2 F800
G1 X120
G3 X120 Y60 I0 J30
G1 X0 Y60
G0 Z20
M2
"""
    apt = """$$ FORCE FX=-110 FY=-190 FZ=130 FRAME=FEED
UNITS/MM
RAPID
GOTO/0,0,20
FEDRAT/800,MMPM
GOTO/0,0,-2
GOTO/120,0,-2
CIRCLE/120,30,-2,0,0,1,30
GOTO/120,60,-2
PAINT/PATH
GOTO/0,60,-2
RAPID
GOTO/0,60,20
FINI
"""
    results = []
    for name, text in (("part.nc", gcode), ("part.apt", apt)):
        results.append(correct_files({name: text}, cell, ROBOT))
    one, other = (result.documents[0].text for result in results)
    moves = [
        [line for line in text.splitlines() if line.startswith(("LIN", "PTP", "CIRC", "$VEL"))] for text in (one, other)
    ]
    assert len(moves[0]) > 10
    assert moves[0] == moves[1]


@pytest.mark.parametrize(
    ("heights", "back"),
    [
        ("RAPTO,3.0,FEDTO,-15.0,RTRCTO,AUTO", 30.0),  # as high as before: G98
        ("CLEAR,3.0,FEDTO,-15.0,RTRCTO,AUTO", 30.0),
        ("RAPTO,3.0,FEDTO,-15.0", None),  # G99
        ("RAPTO,3.0,FEDTO,-15.0,RTRCTO,3.0", None),
    ],
)
def test_holes_of_siemens_nx_are_those_of_gcode(heights, back):
    apt = f"""UNITS/MM
LOAD/TOOL,3,ADJUST,3
SPINDL/RPM,1500,CLW
RAPID
GOTO/0,0,30,0,0,1
CYCLE/DRILL,{heights},MMPM,120.0
GOTO/10,10,0
PAINT/COLOR,31
GOTO/30,10,-2
CYCLE/OFF
RAPID
GOTO/30,10,50
END-OF-PATH
"""
    end = "G98" if back else "G99"
    gcode = f"G21 G90 G94\nT3 M6\nS1500 M3\nG0 X0 Y0 Z30\n{end} G81 X10 Y10 Z-15 R3 F120\nX30 Y10 Z-17 R1\nG80\nG0 Z50"
    program = read(apt)
    same(program, read_gcode(gcode))
    assert points(program)[:, 2].min() == pytest.approx(-17.0)


@pytest.mark.parametrize(
    ("apt", "code"),
    [
        ("CYCLE / DEEP, DEPTH, 15, STEP, 4, MMPM, 120, CLEAR, 3", "G99 G83"),
        ("CYCLE / BRKCHP, DEPTH, 15, STEP, 4, MMPM, 120, CLEAR, 3", "G99 G73"),
        ("CYCLE / DEEP, DEPTH, 15, STEP, 4, MMPM, 120, CLEAR, 3, RETURN, 0", "G98 G83"),
        ("CYCLE/DRILL,DEEP,STEP,4,CLEAR,3,FEDTO,-15,RTRCTO,AUTO,MMPM,120", "G98 G83"),
        ("CYCLE/DRILL,BRKCHP,STEP,4,RAPTO,3,FEDTO,-15,MMPM,120", "G99 G73"),
        ("CYCLE / DRILL, DEPTH, 15, MMPM, 120, CLEAR, 3, RETURN, 0", "G98 G81"),
    ],
)
def test_pecked_holes_and_a_return_to_the_height_before_are_those_of_gcode(apt, code):
    program = read(f"UNITS/MM\nRAPID\nGOTO/0,0,30\n{apt}\nGOTO/10,10,0\nGOTO/30,10,-2\nCYCLE/OFF\nFINI\n")
    peck = " Q4" if code[-2:] != "81" else ""
    same(
        program, read_gcode(f"G21 G90 G94\nG0 X0 Y0 Z30\n{code} X10 Y10 Z-15 R3{peck} F120\nX30 Y10 Z-17 R1\nG80\nM2\n")
    )
    assert (points(program)[:, 2] == 30.0).sum() == (5 if "G98" in code else 2)  # from there, above each hole, and back


CREO = """$$*         Pro/CLfile  Version 12.0
$$-> MFGNO / PART1
PARTNO / PART1
UNITS / MM
$$-> CSYS / {row}, $
           0.0000000000, 1.0000000000, 0.0000000000, 0.0000000000, $
           0.0000000000, 0.0000000000, 1.0000000000, 0.0000000000
RAPID
GOTO / 0.0000000000, 0.0000000000, 9.0000000000
FEDRAT / 200.000000,  MMPM
GOTO / 0.0000000000, 0.0000000000, -3.0000000000
$$-> CUTTER / 12.000000 $
GOTO / 5.0000000000, 0.0000000000, -3.0000000000
$$-> END /
FINI
"""


@pytest.mark.parametrize("end", ["\n", "\r\n", "  \n", "\r"])
def test_the_matrix_in_a_comment_of_creo_is_no_statement(end):
    text = CREO.format(row="1.0000000000, 0.0000000000, 0.0000000000, 0.0000000000").replace("\n", end)
    program = read(text)
    np.testing.assert_allclose(points(program), [[0, 0, 9], [0, 0, -3], [5, 0, -3]])
    assert program.motions.line.tolist() == [9, 11, 13]
    assert [issue.kind for issue in program.issues] == []
    (matrix,) = [event.text for event in program.events if "CSYS" in event.text]
    assert matrix.startswith("-> CSYS / 1.0000000000, 0.0")
    assert matrix.endswith("1.0000000000, 0.0000000000")
    assert "\n" not in matrix
    assert "$" not in matrix


def test_a_sequence_of_creo_with_another_coordinate_system_is_a_warning():
    program = read(CREO.format(row="1.0000000000, 0.0000000000, 0.0000000000, 25.0000000000"))
    (issue,) = program.issues
    assert (issue.level, issue.kind, issue.source_line) == ("warning", "coordinate-system", 5)
    assert "COORDINATE_OUTPUT" in issue.message


# ---- rules of single systems


def arc(text):
    program = read(AT_Z9 + "GOTO/10,0,9\n" + text)
    (n,) = np.flatnonzero(program.motions.kind == CIRC)
    return program.motions.normal[n] * program.motions.sweep[n] / np.pi * 180


def test_creo_turns_right_handed_and_siemens_nx_clockwise():
    np.testing.assert_allclose(arc("CIRCLE/0,0,9,0,0,1,10\nGOTO/0,10,9"), [0, 0, 90], atol=1e-9)
    np.testing.assert_allclose(arc("CIRCLE/0,0,9,0,0,1,10,.06,.5,8,0\nGOTO/0,10,9"), [0, 0, -270], atol=1e-9)
    np.testing.assert_allclose(arc("CIRCLE/0,0,9,0,0,-1,10,.06,.5,8,0\nGOTO/0,10,9"), [0, 0, 90], atol=1e-9)
    np.testing.assert_allclose(arc("MOVARC/0,0,9,0,0,1,10,ANGLE,90\nGOTO/0,10,9"), [0, 0, 90], atol=1e-9)
    np.testing.assert_allclose(arc("MOVARC/0,0,9,0,0,1,10,ANGLE,450\nGOTO/0,10,12"), [0, 0, 450], atol=1e-9)


def test_a_rounded_outline_of_nx_turns_by_quarters():
    """Corners as a CLSF has them: an outline that goes round clockwise, its axes upwards."""
    program = read(
        "FEDRAT/MMPM,500\nRAPID\nGOTO/-5.1250,3.4613,0.0000,0.0000000,0.0000000,1.0000000\n"
        "CIRCLE/-4.2750,3.4613,0.0000,0.0000000,0.0000000,1.0000000,0.8500,0.0600,0.5000,0.0000,0.0000\n"
        "GOTO/-4.2750,4.3113,0.0000\nGOTO/4.8775,4.3113,0.0000\nGOTO/-4.2750,-4.3250,0.0000\n"
        "CIRCLE/-4.2750,-3.4750,0.0000,0.0000000,0.0000000,1.0000000,0.8500,0.0600,0.5000,0.0000,0.0000\n"
        "GOTO/-5.1250,-3.4750,0.0000\nEND-OF-PATH\n"
    )
    sweep = program.motions.sweep[program.motions.kind == CIRC]
    np.testing.assert_allclose(np.rad2deg(sweep), [90.0, 90.0], atol=0.01)


def test_catia_leaves_along_indirv_and_ends_where_the_line_does():
    text = "INDIRV/0,1,0\nTLON,GOFWD/ (CIRCLE/ 0,0,9,$\n 10),ON,(LINE/ 0,0,9,$\n -10,0,9)"
    np.testing.assert_allclose(arc(text), [0, 0, 180], atol=1e-9)
    np.testing.assert_allclose(arc(text.replace("0,1,0", "0,-1,0")), [0, 0, -180], atol=1e-9)
    beyond = "INDIRV/0,1,0\nTLON,GOFWD/(CIRCLE/0,0,9,10),ON,2,INTOF,(LINE/0,0,9,0,-10,9)"
    np.testing.assert_allclose(arc(beyond), [0, 0, 270], atol=1e-9)
    with pytest.raises(ProgramError, match=r"part.apt:7: the arc ends on the other side of its line"):
        arc(beyond.replace("2,INTOF,", ""))


def test_points_that_divide_an_arc_of_creo_belong_to_it():
    angles = np.deg2rad([60, 120, 180])
    goto = "".join(f"GOTO / {10 * np.cos(a):.10f}, {10 * np.sin(a):.10f}, 9.0\n" for a in angles)
    program = read(AT_Z9 + "GOTO/10,0,9\nCIRCLE / 0.0, 0.0, 9.0, $\n0.0, 0.0, 1.0, 10.0\n" + goto + "GOTO/-10,-40,9\n")
    assert program.motions.kind.tolist() == [PTP, LIN, CIRC, CIRC, CIRC, LIN]
    listed = goto.replace("\nGOTO /", ", $\n")
    again = read(AT_Z9 + "GOTO/10,0,9\nCIRCLE / 0.0, 0.0, 9.0, $\n0.0, 0.0, 1.0, 10.0\n" + listed + "GOTO/-10,-40,9\n")
    same(program, again)


def test_a_chord_behind_an_arc_is_not_guessed():
    """A half disc: the straight line back ends on the circle too."""
    text = AT_Z9 + "GOTO/10,0,9\nCIRCLE/0,0,9,0,0,1,10\nGOTO/-10,0,9\nGOTO/10,0,9\n"
    with pytest.raises(ProgramError, match=r"part.apt:8: all GOTO after CIRCLE end on this circle"):
        read(text)
    with pytest.raises(ProgramError, match=r"part.apt:8: all GOTO after CIRCLE end on this circle"):
        read(text.replace("9\nGOTO/10,0,9\n", "9\nGOTO/10,0,9E0\n"))  # not read in bulk
    program = read(text.replace("10\nGOTO/-10,0,9\n", "10\nGOTO/-10,0,9\nPAINT/COLOR,31\n"))
    assert program.motions.kind.tolist() == [PTP, LIN, CIRC, LIN]


def creo_circle(*points: tuple[float, float, float], radius: float = 10.0) -> str:
    gotos = "".join(f"GOTO / {x:.10f}, {y:.10f}, {z:.10f}\n" for x, y, z in points)
    return f"CIRCLE / 0.0, 0.0, 9.0, $\n0.0, 0.0, 1.0, {radius:.10f}\n{gotos}"


def test_a_retract_at_the_end_of_a_full_circle_is_not_of_its_arc():
    program = read(AT_Z9 + "GOTO/10,0,9\n" + creo_circle((0, 10, 9), (0, 10, 12)))
    assert program.motions.kind.tolist() == [PTP, LIN, CIRC, LIN]
    helix = read(AT_Z9 + "GOTO/10,0,9\n" + creo_circle((0, 10, 10), (-10, 0, 11), (0, -10, 12), (10, 0, 13)))
    assert helix.motions.kind.tolist() == [PTP, LIN, CIRC, CIRC, CIRC, CIRC]


def test_a_point_beside_the_circle_is_not_of_an_arc_whose_ends_are_on_it():
    """As in files of Creo: the line behind an arc ends 0.01 mm beside the circle, start and end are on it."""
    program = read(AT_Z9 + "GOTO/10,0,9\n" + creo_circle((0, 10, 9), (-10.01, 0, 9)))
    assert program.motions.kind.tolist() == [PTP, LIN, CIRC, LIN]
    with pytest.raises(ProgramError, match="all GOTO after CIRCLE end on this circle"):
        read(AT_Z9 + "GOTO/10,0,9\n" + creo_circle((0, 10, 9), (-10.0005, 0, 9)))


def test_an_arc_with_one_point_shows_that_the_sequence_does_not_divide_arcs():
    """The wall of a slot leads from one end of a circle to the other, as in a roughing sequence of Creo."""
    wall = "GOTO/0,-10,9\n" + creo_circle((5, -np.sqrt(75.0), 9), (5, np.sqrt(75.0), 9))
    single = "GOTO/10,0,9\n" + creo_circle((-10, 0, 9), (-10, 40, 9))
    head = "$$-> FEATNO / 1\n" + AT_Z9
    program = read(head + single + wall)
    assert program.motions.kind.tolist() == [PTP, LIN, CIRC, LIN, LIN, CIRC, LIN]
    # its end alone shows nothing: points behind another statement might have divided it too
    alone = single.replace("\nGOTO / -10.0000000000, 40", "\nFEDRAT/MMPM,400\nGOTO / -10.0000000000, 40")
    assert "FEDRAT" in alone
    for text in (head + wall, head + single + "$$-> FEATNO / 2\n" + wall, head + alone + wall):
        with pytest.raises(ProgramError, match="all GOTO after CIRCLE end on this circle"):
            read(text)


def test_rapid_holds_for_one_motion_and_the_vector_stays():
    text = AT_Z9 + "GOTO/1,0,9,0,0.6,0.8\nRAPID\nGOTO/2,0,9\nGOTO/3,0,9\n"
    program = read(text)
    assert program.motions.rapid.tolist() == [True, False, True, False]
    np.testing.assert_allclose(-program.motions.target[1:, :3, 2], [[0, 0.6, 0.8]] * 3, atol=1e-12)


def test_three_numbers_of_creo_are_a_direction_along_z():
    head = "$$*          Pro/CLfile  Version 8.0 - 8.0.3.0\n"
    text = AT_Z9 + "GOTO/1,0,9,0,0.6,0.8\nGOTO/2,0,9\nGOTO/3,0,9,0,0.6,0.8\nMULTAX/OFF\nGOTO/4,0,9\n"
    directions = -read(head + text).motions.target[1:, :3, 2]
    np.testing.assert_allclose(directions, [[0, 0.6, 0.8], [0, 0, 1]] * 2, atol=1e-12)


@pytest.mark.parametrize(
    "head", ["$$ CATIA APT VERSION 1.0\n", "$$*CATIA0\n$$ Axis\n$$ 1 0 0 0\n$$ 0 1 0 0\n$$ 0 0 1 0\n"]
)
def test_multax_off_of_catia_keeps_the_direction(head):
    body = "MULTAX/ON\nGOTO/1,0,9,0,0.6,0.8\nMULTAX/OFF\nGOTO/4,0,9\n"
    np.testing.assert_allclose(-read(head + AT_Z9 + body).motions.target[-1, :3, 2], [0, 0.6, 0.8], atol=1e-12)
    with pytest.raises(ProgramError, match=r"part.apt:8: GOTO without a direction behind MULTAX/OFF"):
        read(AT_Z9 + body)
    with pytest.raises(ProgramError, match="GOTO without a direction behind MULTAX/OFF"):
        read(AT_Z9 + body.replace("MULTAX/OFF\n", "MULTAX/OFF\nMULTAX/ON\n"))
    for stated in ("TLAXIS/0,0,1\nGOTO/4,0,9\n", "GOTO/4,0,9,0,0,1\n"):
        program = read(AT_Z9 + body.replace("GOTO/4,0,9\n", stated))
        np.testing.assert_allclose(-program.motions.target[-1, :3, 2], [0, 0, 1], atol=1e-12)


def test_a_machining_axis_system_of_catia_that_changes_is_an_error():
    system = "$$*CATIA0\n$$ Axis\n$$ 1.0 0.0 0.0 0.0\n$$ 0.0 1.0 0.0 0.0\n$$ 0.0 0.0 1.0 {}\n"
    text = system.format("5.0") + AT_Z9 + "GOTO/1,0,9\n" + system.format("{}") + "GOTO/2,0,9\n"
    assert len(read(text.format("5.00000")).motions) == 3
    with pytest.raises(ProgramError, match=r"part.apt:11: the machining axis system changes"):
        read(text.format("6.0"))


CAMPLETE = """MACHIN/
MODE/MILL
PARTNO/'pocket'
CSI_PROGRAM_COMMENT/first
UNITS/MM
MULTAX/OFF
MCS/1.000000000, 0.000000000, 0.000000000, $
0.000000000, 1.000000000, 0.000000000, $
0.000000000, 0.000000000, 1.000000000, $
0.000000, 0.000000, {origin}
CUTTER/10.000000, 0.000000, 0.000000, 0.000000, 0.000000, 0.000000, 50.000000
CSI_SET_FLUTE_LENGTH/20.000000
LOADTL/1, 0, 50.000000, 1
SPINDL/RPM,5000,CLW
COOLNT/FLOOD
ZERO/1
CSI_PATH_TOLERANCE/0.010000
RAPID
GOTO/10.000000, 0.000000, 15.000000
FEDRAT/600.000000, MMPM
GOTO/10.000000, 0.000000, -1.000000
CIRCLE/0.000000, 0.000000, -1.000000, 0.000000000, 0.000000000, -1.000000000, 10.000000, 90.000000, 0.0, 0.0, 0.0
GOTO/0.000000, 10.000000, -1.000000
RAPID
GOTO/0.000000, 10.000000, 15.000000
CYCLE/DRILL, FEDTO, 12.000000, MMPM, 200.000000, CLEAR, 15.000000, RTRCTO, 17.000000, RETURN, 17.000000, RAPTO, 4.000000
GOTO/30.000000, 10.000000, -2.000000
CYCLE/OFF
{more}END
FINI
"""


def test_a_file_of_the_camplete_post_moves_as_the_same_g_code():
    """Counter-clockwise arcs have −z there; depths, RAPTO and RETURN count from the top, CLEAR from zero."""
    code = "G21 G90\nG0 X10 Y0 Z15\nG1 Z-1 F600\nG3 X0 Y10 I-10 J0\nG0 Z15\nG0 X30\nG0 Z2\nG1 Z-14 F200\nG0 Z15\nM2"
    apt, gcode = read(CAMPLETE.format(origin="0.0", more="")), read_gcode(code)
    np.testing.assert_allclose(points(apt), points(gcode), atol=1e-9)
    assert apt.motions.rapid.tolist() == gcode.motions.rapid.tolist()
    np.testing.assert_allclose(apt.motions.feed[~apt.motions.rapid], gcode.motions.feed[~gcode.motions.rapid])
    np.testing.assert_allclose(apt.motions.sweep, gcode.motions.sweep, atol=1e-9)


@pytest.mark.parametrize(
    ("origin", "more", "problem"),
    [
        ("5.0", "", "MCS: the coordinates of this section are in axes of its own"),
        ("0.0", "ZERO/2\n", "ZERO: the work offset changes"),
        ("0.0", "CSI_INSERT_CUSTOM_GCODE/G28 Z0\n", "is for one control and moves the machine"),
    ],
)
def test_what_moves_the_coordinates_of_a_camplete_file_is_an_error(origin, more, problem):
    with pytest.raises(InputError, match=problem):
        read(CAMPLETE.format(origin=origin, more=more))


def test_feeds_in_their_units():
    rates = ["600,MMPM", "IPM,10", "0.1,MMPR", "IPR,0.01", "600", "600,PERMIN", "0.2,PERREV", "0.5,FPM", "0.002,FPR"]
    text = "UNITS/MM\nSPINDL/1000,RPM,CLW\nRAPID\nGOTO/0,0,0\n"
    text += "".join(f"FEDRAT/{rate}\nGOTO/{n},1,0\n" for n, rate in enumerate(rates))
    expected = [600, 254, 100, 254, 600, 600, 200, 152.4, 609.6]
    np.testing.assert_allclose(read(text).motions.feed[1:] * 60e3, expected)


@pytest.mark.parametrize(("unit", "mm"), [("MM", 1.0), ("CM", 10.0), ("INCH", 25.4), ("IN", 25.4), ("INCHES", 25.4)])
def test_places_and_feeds_are_in_the_unit_of_the_file(unit, mm):
    program = read(f"UNITS/{unit}\nFROM/1,2,3,0,0.6,0.8\nFEDRAT/20,PERMIN\nGOTO/1,2,1\nGODLTA/0,1,0\n")
    np.testing.assert_allclose(points(program), np.array([[1, 2, 3], [1, 2, 1], [1, 3, 1]]) * mm, atol=1e-9)
    np.testing.assert_allclose(program.motions.feed[1:] * 60e3, 20.0 * mm)
    np.testing.assert_allclose(-program.motions.target[:, :3, 2], [[0, 0.6, 0.8]] * 3, atol=1e-12)


def test_from_is_where_the_path_begins_and_a_feed_without_it_comes_from_start():
    program = read("FROM/0,0,50\nFEDRAT/100\nGOTO/0,0,9\n")
    assert program.motions.kind.tolist() == [PTP, LIN]
    assert not len(program.unforced)
    program = read("FEDRAT/100\nGOTO/0,0,9\n")
    assert program.motions.kind.tolist() == [LIN]
    assert program.unforced.tolist() == [0]
    assert "from-start" in [issue.kind for issue in program.issues]


def test_rapid_before_a_hole_does_not_hold_behind_the_cycle():
    cycle = "CYCLE/DRILL,DEPTH,5,MMPM,100,CLEAR,3\nRAPID\nGOTO/10,10,0\nCYCLE/OFF\nGOTO/20,10,5\nFINI\n"
    program = read(AT_Z9 + cycle)
    assert not program.motions.rapid[-1]
    assert program.motions.feed[-1] * 60e3 == pytest.approx(600.0)


def test_a_direction_counts_in_numbers_of_any_form():
    plain, other = (read(f"{AT_Z9}GOTO/{x},0,9,0,0.6,0.8\nFINI\n") for x in ("10", "1.0E1"))
    same(plain, other)
    np.testing.assert_allclose(-other.motions.target[-1, :3, 2], [0, 0.6, 0.8], atol=1e-12)


def test_the_end_of_an_arc_may_have_a_direction_in_numbers_of_any_form():
    text = AT_Z9 + "GOTO/10,0,9\nCIRCLE/0,0,9,0,0,1,10\nGOTO/0,{},9,0,0,1\nFINI\n"
    plain, other = (read(text.format(y)) for y in ("10", "1.0E1"))
    same(plain, other)
    assert plain.motions.kind.tolist() == [PTP, LIN, CIRC]


def test_gohome_goes_where_the_cell_says():
    machine = Machine(home=(0.0, -90.0, 90.0, 0.0, 10.0, 0.0), clearance_Z=100.0)
    program = read(AT_Z9 + "GOTO/1,0,9\nGOHOME\nRAPID\nGOTO/5,0,9\nFINI\n", replace(CELL, machine=machine))
    assert program.motions.kind.tolist() == [PTP, LIN, LIN, PTP, PTP, LIN]
    np.testing.assert_allclose(points(program)[[2, 4, 5]], [[1, 0, 100], [5, 0, 100], [5, 0, 9]], atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(program.motions.joints[3]), machine.home, atol=1e-9)


@pytest.mark.parametrize(
    ("value", "kind"), [("ON", "on"), ("FLOOD", "on"), ("MIST,ON", "on"), ("OFF", "off"), ("FLOOD,OFF", "off")]
)
def test_coolant_is_off_where_a_kind_of_it_is(value, kind):
    program = read(f"{AT_Z9}COOLNT/{value}\nGOTO/1,0,9\nEND-OF-PATH\n")
    assert [event.kind for event in program.events] == [f"coolant_{kind}"]


def test_events_and_comments_are_kept():
    program = read(
        "$$ made by hand\nPARTNO LEFT WING $$ aside\nPPRINT/'op 1'\nTOOL PATH/MILL_1,TOOL,D10\nUNITS/MM\n"
        "LOAD/TOOL,2,ADJUST,2\nSPINDL/RPM,3000,CCLW\nCOOLNT/FLOOD\nFEDRAT/MMPM,500\nRAPID\nGOTO/0,0,9\nDELAY/1.5\n"
        "OPSTOP\nAUXFUN/77\nGOTO/1,0,9\nFINI\n",
        replace(CELL, m_codes={"M77": ["HOOK()"]}),
    )
    assert [(e.before, e.kind, e.value, e.text) for e in program.events] == [
        (0, "comment", 0, "made by hand"),
        (0, "comment", 0, "LEFT WING"),
        (0, "comment", 0, "aside"),
        (0, "comment", 0, "op 1"),
        (0, "comment", 0, "PATH/MILL_1,TOOL,D10"),
        (0, "tool_change", 2, ""),
        (0, "spindle_ccw", 3000, ""),
        (0, "coolant_on", 0, ""),
        (1, "dwell", 1.5, ""),
        (1, "stop", 0, ""),
        (1, "m_code", 77, ""),
        (2, "spindle_off", 0, ""),
        (2, "coolant_off", 0, ""),
    ]


def test_m_codes_that_have_a_statement_do_what_it_does():
    program = read(
        f"{AT_Z9}SPINDL/900,RPM,CLW\nGOTO/1,0,9\nINSERT M04\nAUXFUN/8\nINSERT M09\nAUXFUN/1\nAUXFUN/5\nINSERT M077\n"
        "GOTO/2,0,9\nFINI\n",
        replace(CELL, m_codes={"M77": ["HOOK()"]}),
    )
    assert [(event.kind, event.value) for event in program.events if event.kind != "comment"] == [
        ("spindle_on", 900),
        ("spindle_ccw", 900),
        ("coolant_on", 0),
        ("coolant_off", 0),
        ("stop", 0),
        ("spindle_off", 0),
        ("m_code", 77),
    ]


@pytest.mark.parametrize(
    "text",
    [
        "TOOL 5 D10 R1 END MILL",
        "TOOL NAME - D10R1",
        "TOOL 4 TAP M6",
        "MATERIAL AlMg3",
        "(SAFE)",
        "; tool 5",
        "Stock Size X40. Y50. Z60.",
        "MSG ROUGHING",
        "'PART 12'",
    ],
)
def test_inserted_text_that_moves_nothing_is_a_comment(text):
    program = read(f"{AT_Z9}GOTO/1,0,9\nINSERT/{text}\nGOTO/2,0,9\nFINI\n")
    assert [event.kind for event in program.events].count("stop") == 0
    assert text.upper().strip("();' ") in [event.text for event in program.events]


def test_inserted_stop_halts_and_the_word_in_brackets_does_not():
    stops = [
        [event.kind for event in read(f"{AT_Z9}GOTO/1,0,9\nINSERT/{text}\nGOTO/2,0,9\nFINI\n").events].count("stop")
        for text in ("STOP change fixture", "(STOP is not needed)")
    ]
    assert stops == [1, 0]


@pytest.mark.parametrize(
    ("text", "line", "problem"),
    [
        ("GOTO/1,2", 5, "3 or 6 numbers"),
        ("GOTO/1,2,x", 5, "3 or 6 numbers"),
        ("GOTO/1,,2,3", 5, "3 or 6 numbers"),
        ("GOTO/1,2,3,4", 5, "3 or 6 numbers"),
        ("GOTO/1,2,3,1,1,1", 5, "not a direction of length 1"),
        ("GOTO/1,2,1E9", 5, "3 or 6 numbers"),
        ("GOTO/1,2,99999999", 5, "3 or 6 numbers"),
        ("GOTO/1,2,3,0,0,-1", 5, "the tool comes from below, and from above in line 4"),
        ("GODLTA/5", 5, "GODLTA is not supported"),
        ("CIRCLE/0,0,9,0,0,1,10\nGOTO/0,10,9", 6, "the start of the arc is 0.0000 mm from the axis"),
        ("CIRCLE/-10,0,9,0,0,1,10\nGOTO/-10,11,9", 6, "the end of the arc is 11.0000 mm"),
        ("CIRCLE/-10,0,9,0,0,1,10\nFINI", 5, "an arc without a GOTO"),
        ("CIRCLE/-10,0,9,0,0,1,10,.06,.5,9,0,TIMES,0\nGOTO/0,0,9", 5, "TIMES is not a number of turns"),
        ("CIRCLE/-10,0,9,0,0,1,10,TIMES,2\nGOTO/0,0,9", 5, "11 numbers"),
        ("CIRCLE/-10,0,9,10\nGOTO/0,0,9", 5, "7 or 11 numbers"),
        ("MOVARC/-10,0,9,0,0,1,10,ANGLE,80\nGOTO/-10,10,9", 6, "disagrees with its end"),
        ("RAPID\nCIRCLE/-10,0,9,0,0,1,10\nGOTO/-10,10,9", 6, "an arc in rapid"),
        ("TLON,GOFWD/(LINE/0,0,0,1,0,0)", 5, "TLON is not understood"),
        ("INDIRV/1,0,0\nTLON,GOFWD/(CIRCLE/-10,0,9,10),ON,(LINE/-10,0,9,-20,0,9)", 6, "disagree"),
        ("FEDRAT/5,INVERS", 5, "FEDRAT is not understood"),
        ("FEDRAT/0", 5, "not above zero"),
        ("FEDRAT/1,MMPR\nGOTO/1,1,1", 6, "no speed of the spindle"),
        ("UNITS/INCHES", 5, "UNITS change"),
        ("UNITS/FURLONGS", 5, "UNITS is not understood"),
        ("CYCLE/DRILL,10,5,100,MMPM\nGOTO/1,1,1", 5, "CYCLE/DRILL with these values"),
        ("CYCLE/DEEP,DEPTH,10,MMPM,100,CLEAR,3\nGOTO/1,1,1", 5, "CYCLE/DEEP with these values"),
        ("CYCLE/TAP,DEPTH,10,MMPM,100,CLEAR,3\nGOTO/1,1,1", 5, "CYCLE/TAP with these values"),
        ("CYCLE/DEEP,DEPTH,10,STEP,0,MMPM,100,CLEAR,3\nGOTO/1,1,1", 5, "STEP 0 is not a valid depth"),
        ("CYCLE/BRKCHP,DEPTH,10,STEP,.001,MMPM,100,CLEAR,3\nGOTO/1,1,1", 5, "STEP 0.001 is not a valid depth"),
        ("CYCLE/BRKCHP,DEPTH,10,STEP,2,MMPM,100,CLEAR,3,TIMES,2\nGOTO/1,1,1", 5, "CYCLE/BRKCHP with these values"),
        (
            "CYCLE/DRILL,DEEP,CLEAR,3,FEDTO,-9,RTRCTO,AUTO,MMPM,250\nGOTO/1,1,1",
            5,
            "CYCLE/DEEP with these values",
        ),
        ("CYCLE/DRILL,STEP,2,CLEAR,3,FEDTO,-9,MMPM,250\nGOTO/1,1,1", 5, "CYCLE/DRILL with these values"),
        ("CYCLE/DRILL,RAPTO,3,CLEAR,5,FEDTO,-9,MMPM,250\nGOTO/1,1,1", 5, "CYCLE/DRILL with these values"),
        ("CYCLE/DRILL,RAPTO,3,FEDTO,-9,RTRCTO,MANUAL,MMPM,250\nGOTO/1,1,1", 5, "CYCLE/DRILL with these values"),
        ("CYCLE/DRILL,DEPTH,9,CLEAR,3,RTRCTO,AUTO,MMPM,250\nGOTO/1,1,1", 5, "CYCLE/DRILL with these values"),
        ("CYCLE/DRILL,RAPTO,3,FEDTO,0,MMPM,250\nGOTO/1,1,1", 5, "the heights of the cycle contradict"),
        ("CYCLE/DRILL,RAPTO,3,FEDTO,-9,MMPM,250\nGOTO/1,1,1\nLOADTL/2", 7, "the tool changes within a cycle"),
        ("CYCLE/DRILL,RAPTO,3,FEDTO,-9,RTRCTO,2,MMPM,250\nGOTO/1,1,1", 5, "the heights of the cycle contradict"),
        ("CYCLE/DRILL,DEPTH,9,MMPM,100,CLEAR,3\nGOTO/1,1,1,0,.6,.8", 6, "the tool turns in a cycle"),
        ("CUTCOM/LEFT,1", 5, "the radius of the tool is in the control"),
        ("INSERT G28 Z0", 5, "'G28 Z0' is for one control and moves the machine"),
        ("INSERT/(SAFE) G0 Z0", 5, "'(SAFE) G0 Z0' is for one control and moves the machine"),
        ("INSERT/(SAFE) $\nG0 Z0", 5, "INSERT in more than one line"),
        ("INSERT/TOOL CALL 5 Z S2000", 5, "and changes the tool"),
        ("INSERT/TOOL 5 M6", 5, "and changes the tool"),
        ("INSERT/TOOL G53 Z0", 5, "and moves the machine"),
        ("INSERT/STOP M6", 5, "and changes the tool"),
        ("INSERT/G54", 5, "and moves the coordinates"),
        ("INSERT/G4 X2", 5, "and waits"),
        ("INSERT/CYCL CALL", 5, "and calls a program"),
        ("INSERT/TOOLS", 5, "'TOOLS' is for one control"),
        ("AUXFUN/8000", 5, "'M8000' is for one control"),
        ("AUXFUN/6", 5, "LOADTL changes the tool"),
        ("INSERT M03", 5, "SPINDL without one speed"),
        ("TRACUT/1,0,0,5", 5, "TRACUT is not supported"),
        ("TRANS/0,0,5", 5, "TRANS is not supported"),
        ("GOTOO/1,1,1", 5, "unknown statement 'GOTOO'. Text: 'GOTOO/1,1,1'. Did you mean `GOTO`?"),
        ("GOHOME", 5, "GOHOME: where it goes"),
        ("RETRCT", 5, "RETRCT: how high"),
        ("FROM/1,2,3", 5, "FROM at another place"),
        ("FROM/0,0,9,1", 5, "3 or 6 numbers"),
        ("FROM/0,0,9,0,0,1,0", 5, "3 or 6 numbers"),
        ("MSYS/0,0,0,1,0,0,0,1,0\nMSYS/0,0,5,1,0,0,0,1,0", 6, "MSYS changes"),
        ("MODE/TURN", 5, "MODE is not understood"),
        ("RAPID/MODIFY", 5, "RAPID with values"),
        ("SPINDL/100,SFM", 5, "SPINDL with SFM"),
        ("SPINDL/CLW", 5, "SPINDL without one speed"),
        ("SPINDL/100,200,RPM", 5, "SPINDL without one speed"),
        ("LOADTL", 5, "the tool without a number"),
        ("PARTNO X\nGOTO/1,1,1", 6, "ends without FINI"),
        ("DNTCUT", 5, "DNTCUT is not supported"),
        ("$$ FORCE FX=", 5, "force comment cannot be read"),
    ],
)
def test_what_is_not_understood_is_an_error_at_its_line(text, line, problem):
    with pytest.raises(InputError) as caught:
        read(AT_Z9 + text + "\n")
    assert (caught.value.line, problem in str(caught.value)) == (line, True), str(caught.value)


def test_holes_of_a_refused_cycle_are_no_moves_without_a_feed():
    text = "UNITS/MM\nRAPID\nGOTO/0,0,30\nCYCLE/TAP,DEPTH,10,MMPM,100,CLEAR,3\nGOTO/1,1,1\nGOTO/2,1,1\nCYCLE/OFF\n"
    with pytest.raises(ProgramError) as caught:
        read(f"{text}RAPID\nGOTO/0,0,30\nFINI\n")
    assert (caught.value.line, caught.value.further_errors) == (4, ())
    with pytest.raises(ProgramError) as caught:
        read(f"{text}GOTO/5,5,5\nFINI\n")
    assert [(error.line, error.problem) for error in caught.value.further_errors] == [
        (8, "cutting move without a feed")
    ]


@pytest.mark.parametrize(
    ("feed", "problem"),
    [("", "cutting move without a feed"), ("FEDRAT/0.1,MMPR\n", "a feed per turn, but no speed of the spindle")],
)
def test_a_cycle_without_a_feed_is_an_error_at_its_line(feed, problem):
    text = f"UNITS/MM\n{feed}RAPID\nGOTO/0,0,30\nCYCLE/DRILL,DEPTH,10,CLEAR,3\nGOTO/1,1,1\nFINI\n"
    with pytest.raises(ProgramError, match=problem) as caught:
        read(text)
    assert (caught.value.line, caught.value.further_errors) == (text.count("\n", 0, text.index("CYCLE")) + 1, ())


def test_all_errors_are_raised_together_and_a_feed_in_inches_needs_units():
    with pytest.raises(ProgramError) as caught:
        read(AT_Z9 + "FEDRAT/0\nGOTO/1,2\nUNKNOWN\n")
    assert [error.line for error in (caught.value, *caught.value.further_errors)] == [5, 6, 7]
    with pytest.raises(ProgramError, match="a feed in inches, but no UNITS"):
        read("RAPID\nGOTO/0,0,0\nFEDRAT/10,IPM\nGOTO/0,0,1\n")


def test_what_follows_the_end_is_reported():
    program = read(AT_Z9 + "GOTO/1,1,1\nFINI\nGOTO/5,5,5\nRAPID\n")
    assert len(program.motions) == 2
    assert [(issue.kind, issue.lines) for issue in program.issues] == [("after-end", (7, 8))]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "\r\r\n"])
def test_line_ends_a_byte_order_mark_and_lower_case_change_nothing(end):
    text = "units/mm\nfedrat / 500 , mmpm\n\nrapid\n goto / 1. , 2 ,$\n 3\nGOTO/4,5,6 $$ aside\n"
    program = read(b"\xef\xbb\xbf" + text.replace("\n", end).encode())
    np.testing.assert_allclose(points(program), [[1, 2, 3], [4, 5, 6]], atol=1e-9)
    assert program.motions.line.tolist() == [5, 7]


WORDS = st.sampled_from(["0", "1.5", "-2", "+.25", "12.0000000001", "1E1", "", "x", "1.2.3", "--1", "7."])


@settings(deadline=None, max_examples=60)
@given(lines=st.lists(st.lists(WORDS, min_size=2, max_size=7), min_size=1, max_size=8))
def test_plain_points_mean_the_same_in_bulk_and_one_by_one(lines):
    text = AT_Z9 + "".join(f"GOTO/{','.join(words)}\n" for words in lines)
    outcomes = []
    bulk = statements._plain_gotos
    for how in (bulk, lambda chars, ends: (np.zeros(0, dtype=np.int64), np.zeros((0, 6)))):
        statements._plain_gotos = how
        try:
            program = read(text)
            outcomes.append([*(getattr(program.motions, name).tolist() for name in ("line", "kind")), points(program)])
        except InputError as error:
            outcomes.append([str(error), [], np.zeros((0, 3))])
        finally:
            statements._plain_gotos = bulk
    assert outcomes[0][:2] == outcomes[1][:2]
    np.testing.assert_array_equal(outcomes[0][2], outcomes[1][2])


def test_most_points_are_read_in_bulk():
    rows = "".join(f"GOTO/{x},{y},0.5,0.0,0.0,1.0\n" for x, y in itertools.product(range(40), range(50)))
    source = statements.split(decode("part.apt", (AT_Z9 + rows).encode()))
    assert (len(source.goto_rows), len(source.other_rows)) == (2001, 3)


@pytest.mark.parametrize(("name", "kinds"), [("catia_apt.nc", [PTP]), ("nx_clsf.nc", [PTP, LIN])])
def test_files_as_catia_and_nx_write_them(name, kinds):
    document = decode(name, (Path(__file__).parent / "collection" / name).read_bytes())
    program = reader.read(document, CELL, forward, "part")
    assert program.motions.kind.tolist() == kinds
    np.testing.assert_allclose(points(program)[0], [10, 20, {"catia_apt.nc": 30, "nx_clsf.nc": 50}[name]], atol=1e-9)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("GOTO/1,1,1\nFINI", None),
        ("GOTO/1,1,1\nEND\n", None),
        ("GOTO/1,1,1\nEND-OF-PATH\n$$ made by NX\n\n", None),
        ("GOTO/1,1,1\n", 5),
        ("END-OF-PATH\nRAPID\nGOTO/1,1,1", 7),
        ("END-OF-PATH\nGOTO/1,1,1\nGOTO/1,1,12", 7),
        ("END-OF-PATH\nSPINDL/OFF", 6),
    ],
)
def test_a_file_without_an_end_may_be_cut_off(text, line):
    told = [issue for issue in read(AT_Z9 + text).issues if issue.kind == "program-end"]
    assert [(issue.level, issue.source_line) for issue in told] == ([] if line is None else [("warning", line)])


def test_cutcom_by_wear_offsets_has_no_effect_and_is_reported():
    cell = replace(CELL, gcode=replace(CELL.gcode, radius_offsets="wear"))
    program = read(AT_Z9 + "CUTCOM/LEFT,1\nGOTO/1,1,1\nCUTCOM/OFF\nFINI\n", cell)
    assert [issue.kind for issue in program.issues] == ["radius-compensation"]
    assert len(program.motions) == 2


def test_a_point_on_the_first_line_is_a_motion_too():
    with pytest.raises(ProgramError, match=r"part\.apt:1: cutting move without a feed"):
        read("GOTO/0,0,9\nRAPID\nGOTO/0,0,19\n")


def test_an_error_before_the_end_of_an_arc_brings_no_second_one():
    """What the arc would have been is not known: a word between the two is not understood."""
    text = AT_Z9 + "GOTO/10,0,9\nCIRCLE/0,0,9,0,0,1,10\n{}GOTO/5,5,9\nGOTO/20,0,9\n"
    for between, lines in (("UNKNOWN\n", [7]), ("", [7])):  # the end is not on the circle
        with pytest.raises(ProgramError) as caught:
            read(text.format(between))
        assert [error.line for error in (caught.value, *caught.value.further_errors)] == lines


def test_tool_number_zero_is_one_and_a_move_to_where_the_tool_is_is_counted():
    program = read("LOADTL/0\n" + AT_Z9 + "GOTO/1,0,9\nGOTO/1,0,9\nGOTO/2,0,9\nGOTO/2,0,9\n")
    assert [(e.kind, e.value) for e in program.events if e.kind == "tool_change"] == [("tool_change", 0.0)]
    assert [(i.kind, i.source_line, i.count, i.lines) for i in program.issues if i.kind == "null-move"] == [
        ("null-move", 7, 2, (7, 9))
    ]


def test_the_axis_of_an_arc_has_length_1():
    for axis in ("0,0,1.5", "0,0.1,1", "0,0,0.5"):
        with pytest.raises(ProgramError, match="axis of the arc does not have length 1"):
            read(AT_Z9 + f"GOTO/10,0,9\nCIRCLE/0,0,9,{axis},10\nGOTO/0,10,9\n")
    np.testing.assert_allclose(arc("CIRCLE/0,0,9,0,0,0.99999999,10\nGOTO/0,10,9"), [0, 0, 90], atol=1e-4)
