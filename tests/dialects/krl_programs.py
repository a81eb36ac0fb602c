"""What the tests of KRL share: a cell, a robot, short ways to read and rewrite, and programs made up by hypothesis."""

import numpy as np
from hypothesis import strategies as st

from postproc.cell import Cell, Frame, Krl, Start, Tool
from postproc.dialects import krl
from postproc.dialects.krl.read import read_program as read_documents
from postproc.dialects.text import decode, line_spans
from postproc.frames import pose_from_xyzabc
from postproc.program import CIRC, LIN, Program, Targets, WrittenProgram

CELL = Cell(
    robot="kuka_kr270",
    base=Frame(X=1500.0, Y=-200.0, Z=700.0),
    tool=Tool(Z=350.0),
    start=Start((0.0, -70.0, 110.0, 0.0, 50.0, 0.0)),
    base_data={"3": Frame(X=1200.0, Y=100.0, Z=650.0, A=30.0)},
    tool_data={"2": Tool(X=20.0, Z=280.0, B=90.0)},
    krl=Krl(initmov="cell"),
)
_AXES = (
    ((0, 0, 750), (0, 0, -1)),
    ((350, 0, 0), (0, 1, 0)),
    ((1250, 0, 0), (0, 1, 0)),
    ((0, 0, -55), (-1, 0, 0)),
    ((1100, 0, 0), (0, 1, 0)),
    ((230, 0, 0), (-1, 0, 0)),
)


def forward(joints):
    """Flange of a KR 270-2 in its root, by products of rotations: nothing of it is the package's."""
    pose = np.eye(4)
    for (offset, axis), angle in zip(_AXES, joints, strict=True):
        x, y, z = np.array(axis, dtype=float)
        hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        step = np.eye(4)
        step[:3, 3] = np.array(offset) / 1000.0
        step[:3, :3] = np.eye(3) + np.sin(angle) * hat + (1 - np.cos(angle)) * hat @ hat
        pose = pose @ step
    return pose @ pose_from_xyzabc([0, 0, 0, 0, 90, 0])


def read(source, data=None, cell=CELL, *, bulk=True, name="part"):
    """Read a program from text or bytes."""
    files = [("part.src", source)] + ([("part.dat", data)] if data is not None else [])
    documents = [decode(file, text if isinstance(text, bytes) else text.encode()) for file, text in files]
    return read_documents(documents, cell, forward, name, _bulk=bulk)


def body(*lines, end="\r\n"):
    """A program with these lines behind its initialisation; the first of them is line 4."""
    return end.join(["&ACCESS RVP", "DEF part( )", "BAS (#INITMOV,0 )", *lines, "END", ""])


def numbers(program):
    """X, Y, Z [mm], A, B, C [deg] that the text commands, (M, 6)."""
    return program.layout.numbers


def targets(program: Program, shift=None, turn=None, keep=False, pieces=None, straight=False, bits=None) -> Targets:
    """Targets for a program: ends moved by `shift` (M, 3) [m] and turned by `turn` (M,) [rad] about Z.

    :param pieces: row → places t < 1 of targets to be inserted.
    :param straight: write arcs as lines.
    """
    m = program.motions
    rows, places = [], []
    for row in np.flatnonzero(np.isnan(m.joints[:, 0])).tolist():
        inner = sorted((pieces or {}).get(row, ()))
        rows += [row] * (len(inner) + 1)
        places += [*inner, 1.0]
    rows, t = np.array(rows, dtype=np.int64), np.array(places)
    shift = np.zeros((len(m), 3)) if shift is None else shift
    turn = np.zeros(len(m)) if turn is None else turn
    pose = np.stack([_at(program, row, place) for row, place in zip(rows, t, strict=True)])
    pose = pose @ pose_from_xyzabc(np.stack([0 * t, 0 * t, 0 * t, np.degrees(turn[rows]), 0 * t, 0 * t], axis=1))
    pose[:, :3, 3] += shift[rows] * t[:, None]
    kind = m.kind[rows].copy()
    via = np.full((len(rows), 3), np.nan)
    for k in np.flatnonzero(kind == CIRC).tolist():
        if straight:
            kind[k] = LIN
        else:
            before = t[k - 1] if k and rows[k - 1] == rows[k] else 0.0
            middle = 0.5 * (before + t[k])
            via[k] = _at(program, rows[k], middle)[:3, 3] + shift[rows[k]] * middle
    keep = np.broadcast_to(keep, len(rows)) & (t == 1.0)
    nothing = np.full(len(rows), -1)
    status, turns = bits if bits is not None else (nothing, nothing)
    blend = np.where(t == 1.0, m.blend[rows], 5e-4)
    return Targets(rows, t, kind, pose, via, keep, status, turns, blend)


def _at(program, row, t):
    """The nominal pose on a motion, by formulas of its own."""
    m = program.motions
    pose = m.target[row].copy()
    if t == 1.0:
        return pose
    start = start_of(program, row)
    if m.kind[row] == CIRC:
        angle = m.sweep[row] * t
        x, y, z = m.normal[row]
        hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turn = np.eye(3) + np.sin(angle) * hat + (1 - np.cos(angle)) * hat @ hat
        pose[:3, 3] = m.centre[row] + turn @ (start[:3, 3] - m.centre[row])
    else:
        pose[:3, 3] = start[:3, 3] + t * (pose[:3, 3] - start[:3, 3])
    return pose


def start_of(program, row):
    """Where a motion starts, in its own frames."""
    m, inverse = program.motions, np.linalg.inv
    if row == 0:
        flange = forward(CELL.start_joints)
    else:
        before = program.bases[m.base[row - 1]] @ m.target[row - 1]
        flange = before @ inverse(program.tools[m.tool[row - 1]])
    return inverse(program.bases[m.base[row]]) @ flange @ program.tools[m.tool[row]]


def check_commands(program: Program, wanted: Targets, written: WrittenProgram, *, approximated=True):
    """Reading what was written gives the targets, in order; axis targets, frames and speeds stay.

    Half of the last digit: 0.05 µm, and 0.5e-5° in each of three angles.
    """
    again = krl.read_program(written.documents, CELL, forward, program.name)
    m, old = again.motions, program.motions
    cartesian = np.isnan(m.joints[:, 0])
    if program.dialect == "krl":
        assert np.array_equal(m.joints[~cartesian], old.joints[~np.isnan(old.joints[:, 0])])
    rows = np.flatnonzero(cartesian)
    assert len(rows) == len(wanted)
    np.testing.assert_allclose(m.target[rows, :3, 3], wanted.pose[:, :3, 3], rtol=0, atol=5.1e-8)
    np.testing.assert_allclose(m.target[rows, :3, :3], wanted.pose[:, :3, :3], rtol=0, atol=3 * np.radians(0.51e-5))
    assert np.array_equal(m.kind[rows], wanted.kind)
    assert np.array_equal(m.line[rows], written.output_line)
    was = wanted.motion
    np.testing.assert_allclose(again.bases[m.base[rows]], program.bases[old.base[was]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(again.tools[m.tool[rows]], program.tools[old.tool[was]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(m.feed[rows], old.feed[was], rtol=1e-12)
    last = wanted.t == 1.0
    if program.dialect == "krl":
        assert np.array_equal(m.blend[rows[last]], old.blend[was[last]])
    arcs = np.flatnonzero((wanted.kind == CIRC) & ~wanted.keep)
    centre = m.centre[rows[arcs]]
    for point in (wanted.via[arcs], wanted.pose[arcs, :3, 3]):
        off = np.linalg.norm(point - centre, axis=1) - np.linalg.norm(m.target[rows[arcs], :3, 3] - centre, axis=1)
        np.testing.assert_allclose(off, 0.0, atol=2e-7)
    if not approximated:
        return again
    text = written.documents[0].text.lower()
    starts, stops = (spans[written.output_line[~last] - 1].tolist() for spans in line_spans(text))
    assert all(" c_" in text[start:stop] for start, stop in zip(starts, stops, strict=True))
    return again


_coordinate = st.integers(-4_000_000, 4_000_000).map(lambda n: n / 10_000)
_angle = st.integers(-1_799_999, 1_799_999).map(lambda n: n / 10_000)


@st.composite
def texts_of_numbers(draw, value):
    """A number as programs write it."""
    style = draw(st.integers(0, 5))
    if style == 0:
        return f"{value:.4f}"
    if style == 1:
        return f"{value:.3E}"
    if style == 2:
        return f"{value:+.6f}"
    if style == 3:
        return repr(round(value, 2)).removesuffix("0")
    if style == 4:
        return str(round(value))
    return f"{value:.8f}"


@st.composite
def aggregates(draw, components="XYZABC", extra="", tag=True):
    """A literal with the given components, in one of many styles."""
    blank = draw(st.sampled_from(["", "", " "]))
    lower = draw(st.sampled_from([False, False, False, True]))
    items = []
    for name in components:
        text = draw(texts_of_numbers(draw(_coordinate if name in "XYZ" else _angle)))
        items.append(f"{name.lower() if lower else name} {text}")
    head = draw(st.sampled_from(["", "", "E6POS: ", "POS:"])) if tag else ""
    return "{" + head + f",{blank}".join(items) + extra + "}"


_approximation = st.sampled_from(["", " C_DIS", " C_DIS", " C_Dis", " C_VEL", " C_DIS C_DIS", "  C_ORI"])
_comment = st.sampled_from(["", "", "", " ; N10", ";text with {X 1} and C_DIS", ' ; "quoted"'])
_names = st.sampled_from(["XP1", "XP2", "xp1", "P[1]", "P[2]"])


@st.composite
def _motion(draw):
    kind = draw(st.integers(0, 11))
    indent = draw(st.sampled_from(["", "  ", "\t"]))
    tail = draw(_approximation)
    components = draw(st.sampled_from(["XYZABC"] * 4 + ["XYZ", "XZ", "ABC", "XYZC"]))
    if kind <= 4:
        word = draw(st.sampled_from(["LIN", "LIN", "lin", "Lin", "SLIN"]))
        external = draw(st.sampled_from(["", ",E1 5.0,E2 0", ",S 2,T 10"]))
        text = f"{word} {draw(aggregates(components, external))}{tail}"
    elif kind == 5:
        bits = draw(st.sampled_from([",S 2,T 34", ",S 'B110',T 'B 100010'", ""]))
        text = f"{draw(st.sampled_from(['PTP', 'SPTP']))} {draw(aggregates('XYZABC', bits))}"
        tail = draw(st.sampled_from(["", " C_PTP", " C_PTP C_DIS"]))
        text += tail
    elif kind == 6:
        text = f"LIN {draw(_names)}{tail}"
    elif kind == 7:
        text = f"LIN_REL {draw(aggregates(draw(st.sampled_from(['Z', 'XY'])), tag=False))}"
        text += draw(st.sampled_from(["", " #TOOL"])) + tail
    elif kind == 8:
        text = "PTP {A1 10.0,A2 -80,A3 95.5,A4 0,A5 45,A6 0}"
    elif kind == 9:
        text = f"LIN {draw(_names)}:{draw(aggregates('XYZABC'))}{tail}"
    else:
        via = draw(st.one_of(aggregates("XYZ"), _names))
        end = draw(st.one_of(aggregates("XYZ"), aggregates("XYZ"), _names))
        angle = draw(st.sampled_from(["", "", ",CA 200", ", ca -400.5"])) if end.startswith("{") else ""
        word, comma = draw(st.sampled_from(["CIRC", "circ", "SCIRC"])), draw(st.sampled_from([",", ", "]))
        text = f"{word} {via}{comma}{end}{angle}{tail}"
    return indent + text + draw(_comment)


_other = st.sampled_from(
    [
        "$VEL.CP=0.05",
        "$APO.CDIS=0.8",
        "; comment",
        "",
        "$OUT[1]=TRUE",
        "TRIGGER WHEN DISTANCE=1 DELAY=0 DO $OUT[2]=TRUE",
    ]
)


_any_motion = _motion()


@st.composite
def sources(draw, smallest=1, largest=12):
    """A `.src`, with mixed line ends, that uses `DATA`."""
    motions = st.one_of(_any_motion, _any_motion, _any_motion, _other)
    lines = draw(st.lists(motions, min_size=smallest, max_size=largest))
    ends = draw(st.lists(st.sampled_from(["\r\n", "\n"]), min_size=len(lines), max_size=len(lines)))
    start = "LIN {X 1.5,Y -20.25,Z 300.125,A 10.5,B 20.25,C 170} C_DIS\r\n"
    return "DEF part( )\r\n" + start + "".join(map(str.__add__, lines, ends)) + "END\r\n"


DATA = (
    "DEFDAT part PUBLIC\r\n"
    "DECL E6POS XP1={X 100.25,Y 200.5,Z 300,A 10,B 20,C 170,S 2,T 10,E1 5.0}\r\n"
    "DECL GLOBAL E6POS XP2={X -50.5,Y 20,Z 250.12345678}\n"
    "DECL E6POS P[2]\r\n"
    "P[1]={X 1,Y 2,Z 3,A 4,B 5,C 6}\r\n"
    "P[2]={E6POS: X 11.5, Y -2, Z 33, A 4, B 5, C 6}\r\n"
    "ENDDAT\r\n"
)
