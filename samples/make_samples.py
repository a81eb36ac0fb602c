"""Write all samples: `python samples/make_samples.py [FOLDER]`. The same files every time.

pocket.nc            three-axis pocket and a bore with arcs and helices; forces as comments
freeform.nc          ball-nose finishing of a freeform surface, more than 20 000 blocks; freeform.forces.csv
inline.src, .dat     KRL with inline forms and named points, as the teach pendant makes it; forces as comments
long_lin.src         KRL of a CAM post: thousands of LIN with numbers; long_lin.forces.csv
cell_kr270.toml      cell of pocket, freeform and inline
cell_kr16.toml       cell of long_lin and pocket
cell_irb6700.toml    cell of pocket with an ABB arm, for `convert --to rapid`
gallery/             drilled block, dome in five axes, saddle as cutter locations, long plate: for docs/gallery.md
"""

from __future__ import annotations

import cmath
import math
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

Points = NDArray[np.float64]

CELL_KR270 = """\
# Milling on a table in front of a KUKA KR 270-2: spindle along the flange axis, tool tip 350 mm before the flange.
robot = "kuka_kr270"

[base]                          # corner of the part in the robot root, mm and degrees
X = 1500.0
Y = -200.0
Z = 700.0

[tool]
Z = 350.0
axis = "+Z"

[start]
joints = [0, -90, 100, 0, 80, 0]

[output]
tolerance_mm = 0.01
max_correction_mm = 8.0
force_ramp_mm = 1.0

[work_offsets.G54]
X = 0.0

[gcode]
redundancy_deg = 180.0          # keeps A6 near 0
rapid_m_per_s = 0.3
approximation_mm = 0.2
spindle_on = ["$ANOUT[1]={S}/24000.0", "$OUT[1]=TRUE", "WAIT SEC 3.0"]
spindle_off = ["$OUT[1]=FALSE"]
coolant_on = ["$OUT[2]=TRUE"]
coolant_off = ["$OUT[2]=FALSE"]
tool_change = ["; tool {T} by hand", "HALT"]

[base_data.3]                   # for KRL that names its frames by number
X = 1500.0
Y = -200.0
Z = 700.0

[tool_data.2]
Z = 350.0
"""

CELL_KR16 = """\
# A small cell with a KUKA KR 16-2. The tool frame is turned as KUKA likes it: X points along the spindle to the tip.
robot = "kuka_kr16_2"

[base]
X = 850.0
Y = -150.0
Z = 400.0

[tool]
Z = 180.0
B = -90.0
axis = "+X"

[start]
joints = [0, -75, 110, 0, 55, 0]

[output]
tolerance_mm = 0.01
max_correction_mm = 4.0

[gcode]
rapid_m_per_s = 0.3
approximation_mm = 0.2
spindle_on = ["$ANOUT[1]={S}/24000.0", "$OUT[1]=TRUE"]
spindle_off = ["$OUT[1]=FALSE"]
coolant_on = ["$OUT[2]=TRUE"]
coolant_off = ["$OUT[2]=FALSE"]
tool_change = ["; tool {T} by hand", "HALT"]
"""

CELL_IRB6700 = """\
# Milling on a table in front of an ABB IRB 6700-200/2.60, for `convert --to rapid`: spindle along the flange axis, tool
# tip 350 mm before the flange. Joints have the signs that all robots have here; ABB's are J1 = -A1, J2 = A2 + 90,
# J3 = A3 - 90, J4 = -A4, J5 = A5, J6 = -A6: start below is ABB's [0, 10, 20, 0, 60, 0].
robot = "abb_irb6700_200_260"

[base]                          # work object in the base frame of the robot: mm; A, B, C in degrees as KUKA has them
X = 1500.0
Y = -200.0
Z = 700.0

[tool]
Z = 350.0
axis = "+Z"

[start]
joints = [0, -80, 110, 0, 60, 0]

[output]
tolerance_mm = 0.01
max_correction_mm = 8.0

[gcode]                         # lines of RAPID
redundancy_deg = 180.0          # keeps axis 6 near 0
rapid_m_per_s = 0.3
approximation_mm = 0.2
spindle_on = ["SetAO aoSpindle,{S};", "SetDO doSpindle,1;", "WaitTime 3;"]
spindle_off = ["SetDO doSpindle,0;"]
coolant_on = ["SetDO doCoolant,1;"]
coolant_off = ["SetDO doCoolant,0;"]
tool_change = ["! tool {T} by hand", "Stop;"]
"""


def number(value: float) -> str:
    """Three decimals at most, without trailing zeros or a minus zero."""
    text = f"{value:.3f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def word(letter: str, value: float) -> str:
    return letter + number(value)


def pocket() -> str:
    """A pocket of 80 × 60 mm, 10 mm deep, and a bore of 30 mm, with a cutter of 10 mm."""
    out = [
        "%",
        "O1001 (POCKET 80 X 60, BORE 30, ALUMINIUM, CUTTER D10)",
        "G21 G90 G17 G40 G49 G80 G94",
        "T1 M6",
        "S12000 M3",
        "G54",
        "G0 X60 Y50 Z50",
        "M8",
        "Z5",
    ]
    depth, step = 10.0, 2.5
    for level in range(1, round(depth / step) + 1):
        out += _pocket_level(60.0, 50.0, -step * (level - 1), -step * level)
    out += ["(FORCE OFF)", "G0 Z50", "X160 Y50", "Z2"]
    out += ["(FORCE FX=-20 FY=35 FZ=150)", "G1 Z0.5 F300", "X170"]
    for level in range(1, 7):
        depth_now = -2.0 * level
        out.append("(FORCE FX=-95 FY=-160 FZ=120 FRAME=FEED)")
        out.append(f"G2 X170 Y50 {word('Z', depth_now)} I-10 J0 F500")
    out += ["G2 I-10 J0", "(FORCE OFF)", "G0 Z50", "M9", "M5", "M30", "%"]
    return "\n".join(f"N{10 * index} {line}" if line[0] in "GXYZMST" else line for index, line in enumerate(out)) + "\n"


def _pocket_level(x: float, y: float, top: float, bottom: float) -> list[str]:
    """Helical entry from `top` to `bottom`, then rings from the middle out to the wall, climb milling."""
    out = ["(FORCE FX=25 FY=-30 FZ=180 MZ=1.2)", f"G1 {word('X', x + 4)} {word('Y', y)} {word('Z', top + 0.5)} F600"]
    middle = (top + 0.5 + bottom) / 2.0
    out += [f"G3 {word('X', x + 4)} {word('Y', y)} {word('Z', z)} I-4 J0 F400" for z in (middle, bottom)]
    out.append("(FORCE FX=-110 FY=-190 FZ=130 MZ=1.8 FRAME=FEED)")
    for ring, half_y in enumerate((5.0, 10.0, 15.0, 20.0, 25.0)):
        half_x, radius = half_y + 10.0, min(3.0 + ring, 6.0)
        left, right, low, high = x - half_x, x + half_x, y - half_y, y + half_y
        out.append(f"G1 {word('X', x)} {word('Y', low)} F1200")
        out.append(word("X", right - radius))
        for end_x, end_y, i, j, straight in (
            (right, low + radius, 0.0, radius, word("Y", high - radius)),
            (right - radius, high, -radius, 0.0, word("X", left + radius)),
            (left, high - radius, 0.0, -radius, word("Y", low + radius)),
            (left + radius, low, radius, 0.0, word("X", x)),
        ):
            if ring % 2:
                out.append(f"G3 {word('X', end_x)} {word('Y', end_y)} {word('R', radius)}")
            else:
                out.append(f"G3 {word('X', end_x)} {word('Y', end_y)} {word('I', i)} {word('J', j)}")
            out.append(f"G1 {straight}")
    out += ["(FORCE FX=15 FY=10 FZ=60)", f"G1 {word('Z', bottom + 0.5)}", f"{word('X', x)} {word('Y', y)}"]
    return out


def surface() -> trimesh.Trimesh:
    """A freeform surface of 240 × 160 mm as a mesh: waves and two hills."""
    x, y = np.meshgrid(np.arange(0.0, 240.1, 2.5), np.arange(0.0, 160.1, 2.5), indexing="ij")
    z = 6.0 * np.sin(x / 34.0) * np.cos(y / 41.0)
    z += 14.0 * np.exp(-(((x - 70.0) / 38.0) ** 2) - ((y - 60.0) / 30.0) ** 2)
    z += 10.0 * np.exp(-(((x - 180.0) / 32.0) ** 2) - ((y - 110.0) / 36.0) ** 2)
    rows, columns = x.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return trimesh.Trimesh(np.stack([x, y, z], -1).reshape(-1, 3), faces, process=False)


def finishing_passes(mesh: trimesh.Trimesh, radius: float, spacing: float) -> list[Points]:
    """Tip positions of a ball-nose tool: sections of the surface offset by its radius with planes along X."""
    centres = trimesh.Trimesh(mesh.vertices + radius * mesh.vertex_normals, mesh.faces, process=False)
    low, high = centres.bounds
    passes = []
    for y in np.arange(low[1] + 1.0, high[1] - 1.0, spacing):
        crossings = trimesh.intersections.mesh_plane(centres, [0.0, 1.0, 0.0], [0.0, y, 0.0]).reshape(-1, 3)
        crossings = crossings[np.argsort(crossings[:, 0], kind="stable")]
        apart = np.concatenate([[True], np.diff(crossings[:, 0]) > 0.05])
        tip = crossings[apart] - [0.0, 0.0, radius]
        passes.append(tip if len(passes) % 2 == 0 else tip[::-1])
    return passes


def freeform() -> tuple[str, str]:
    """The finishing program and its forces; forces follow the slope, one row for some twenty blocks."""
    passes = finishing_passes(surface(), radius=6.0, spacing=1.4)
    lines = ["%", "(FREEFORM FINISHING, BALL NOSE D12)", "G21 G90 G17 G94", "S18000 M3"]
    rows = ["line,Fx,Fy,Fz,frame,line_end"]
    x, y, z = passes[0][0]
    lines += [f"G0 {word('X', x)} {word('Y', y)} Z60", f"{word('Z', z + 3.0)}", f"G1 {word('Z', z)} F600"]
    rows.append(f"{len(lines)},8,-5,60,BASE,{len(lines)}")
    passes[0] = passes[0][1:]
    feed = " F3000"
    for one in passes:
        first = len(lines) + 1
        lines.append(f"{word('X', one[0][0])} {word('Y', one[0][1])} {word('Z', one[0][2])}{feed}")
        feed = ""
        lines += [f"{word('X', px)} {word('Z', pz)}" for px, _, pz in one[1:]]
        for begin in range(0, len(one), 24):
            part = one[begin : begin + 24]
            slope = math.atan2(part[-1][2] - part[0][2], abs(part[-1][0] - part[0][0])) if len(part) > 1 else 0.0
            fx, fy, fz = -45.0 - 60.0 * math.sin(slope), 80.0, 95.0 - 70.0 * math.sin(slope)
            rows.append(f"{first + begin},{fx:.1f},{fy:.1f},{fz:.1f},FEED,{first + begin + len(part) - 1}")
    lines += ["G0 Z60", "M5", "M30", "%"]
    return "\n".join(lines) + "\n", "\n".join(rows) + "\n"


def inline() -> tuple[str, str]:
    """A program of inline forms around a frame, as the teach pendant makes it, and its data list."""
    corners = [
        (60.0, 40.0, 30.0),
        (60.0, 40.0, 0.0),
        (260.0, 40.0, 0.0),
        (260.0, 200.0, 0.0),
        (60.0, 200.0, 0.0),
        (60.0, 40.0, 0.0),
        (60.0, 40.0, 30.0),
    ]
    forces = {2: "FX=10 FZ=120", 3: "FX=-160 FY=220 FZ=90 FRAME=FEED", 7: ""}
    src = [
        "&ACCESS RVP",
        "&REL 7",
        "&PARAM EDITMASK = *",
        "&PARAM TEMPLATE = C:\\KRC\\Roboter\\Template\\vorgabe",
        "DEF inline( )",
        ";FOLD INI;%{PE}",
        "  ;FOLD BASISTECH INI",
        "    BAS (#INITMOV,0 )",
        "  ;ENDFOLD (BASISTECH INI)",
        "  ;FOLD USER INI",
        "    ;Make your modifications here",
        "",
        "  ;ENDFOLD (USER INI)",
        ";ENDFOLD (INI)",
        "",
        *_form(
            "PTP HOME", "Vel= 20 % DEFAULT", ["PDAT_ACT=PDEFAULT", "FDAT_ACT=FHOME", "BAS(#PTP_PARAMS,20)"], "PTP XHOME"
        ),
    ]
    dat = [
        "&ACCESS RVP",
        "&REL 7",
        "DEFDAT  inline",
        ";FOLD EXTERNAL DECLARATIONS;%{PE}%MKUKATPBASIS,%CEXT,%VCOMMON,%P",
        ";FOLD BASISTECH EXT;%{PE}%MKUKATPBASIS,%CEXT,%VEXT,%P",
        "EXT  BAS (BAS_COMMAND  :IN,REAL  :IN )",
        "DECL INT SUCCESS",
        ";ENDFOLD (BASISTECH EXT)",
        ";ENDFOLD (EXTERNAL DECLARATIONS)",
        "",
    ]
    for index, (x, y, z) in enumerate(corners, 1):
        if index in forces:
            src.append(f"; FORCE {forces[index]}" if forces[index] else "; FORCE OFF")
        speed = 0.2 if index == 1 else 0.02
        kind = "PTP" if index == 1 else "LIN"
        act = (
            [f"PDAT_ACT=PPDAT{index}", f"FDAT_ACT=FP{index}", "BAS(#PTP_PARAMS,20)"]
            if kind == "PTP"
            else [f"LDAT_ACT=LCPDAT{index}", f"FDAT_ACT=FP{index}", f"BAS(#CP_PARAMS,{speed:g})"]
        )
        shown = "Vel=20 % PDAT1" if kind == "PTP" else f"Vel={speed:g} m/s CPDAT{index}"
        src += _form(f"{kind} P{index}", f"{shown} Tool[2]:Spindle Base[3]:Table", act, f"{kind} XP{index}")
        dat.append(
            f"DECL E6POS XP{index}={{X {x:.6f},Y {y:.6f},Z {z:.6f},A 175.000000,B 2.000000,C 178.000000,"
            f"S 2,T 10,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}}"
        )
        dat.append(f'DECL FDAT FP{index}={{TOOL_NO 2,BASE_NO 3,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}}')
        if kind == "PTP":
            dat.append(f"DECL PDAT PPDAT{index}={{VEL 20.0000,ACC 100.000,APO_DIST 100.000,APO_MODE #CPTP}}")
        else:
            dat.append(
                f"DECL LDAT LCPDAT{index}={{VEL {speed:.5f},ACC 100.000,APO_DIST 100.000,APO_FAC 50.0000,"
                "AXIS_VEL 100.000,AXIS_ACC 100.000,ORI_TYP #VAR,CIRC_TYP #BASE,JERK_FAC 50.0000}"
            )
    src += [
        *_form(
            "PTP HOME", "Vel= 20 % DEFAULT", ["PDAT_ACT=PDEFAULT", "FDAT_ACT=FHOME", "BAS(#PTP_PARAMS,20)"], "PTP XHOME"
        ),
        "END",
    ]
    dat += ["", "ENDDAT"]
    return "\r\n".join(src) + "\r\n", "\r\n".join(dat) + "\r\n"


def _form(name: str, parameters: str, act: list[str], motion: str) -> list[str]:
    kind, point = name.split()
    return [
        f";FOLD {name} {parameters};%{{PE}}%R 8.3.38,%MKUKATPBASIS,%CMOVE,%V{kind},%P 1:{kind}, 2:{point}, 3:",
        "$BWDSTART=FALSE",
        *act,
        motion,
        ";ENDFOLD",
        "",
    ]


def long_lin() -> tuple[str, str]:
    """Thousands of LIN as a CAM post writes them: a spiral on a shallow dome, frames as literals."""
    head = [
        "&ACCESS RVP",
        "DEF long_lin( )",
        "BAS(#INITMOV,0)",
        "$BASE={X 850.0,Y -150.0,Z 400.0,A 0.0,B 0.0,C 0.0}",
        "$TOOL={X 0.0,Y 0.0,Z 180.0,A 0.0,B -90.0,C 0.0}",
        "$VEL.CP=0.2",
        "$APO.CDIS=0.1",
        "PTP {A1 0.0,A2 -75.0,A3 110.0,A4 0.0,A5 55.0,A6 0.0}",
    ]
    count, turns, outer = 6000, 30, 90.0
    out = list(head)
    rows = ["line,Fx,Fy,Fz,line_end"]
    for index in range(count):
        share = index / (count - 1)
        angle = 2.0 * math.pi * turns * share
        radius = outer * (1.0 - share) + 2.0
        x, y = 110.0 + radius * math.cos(angle), 130.0 + radius * math.sin(angle)
        z = 12.0 * (1.0 - (radius / outer) ** 2)
        if index == 0:
            out += [f"LIN {{X {x:.3f},Y {y:.3f},Z {z + 20.0:.3f},A 0.0,B 90.0,C 0.0}}", "$VEL.CP=0.03"]
        if index % 20 == 0:
            push = 40.0 + 15.0 * math.sin(7.0 * share)
            first = len(out) + 1
            rows.append(
                f"{first},{push * math.sin(angle):.1f},{-push * math.cos(angle):.1f},{35.0 + 20.0 * share:.1f},"
                f"{first + min(20, count - index) - 1}"
            )
        out.append(f"LIN {{X {x:.3f},Y {y:.3f},Z {z:.3f},A 0.0,B 90.0,C 0.0}} C_DIS")
    out += ["$VEL.CP=0.2", f"LIN {{X {x:.3f},Y {y:.3f},Z {z + 30.0:.3f},A 0.0,B 90.0,C 0.0}}"]
    rows.append(f"{len(out)},0,0,0,{len(out)}")
    rows.insert(1, f"{len(head) + 1},0,0,0,{len(head) + 1}")
    out.append("END")
    return "\n".join(out) + "\n", "\n".join(rows) + "\n"


PLATE_PROCESS = """# What makes the forces of plate.nc: aluminium, one cutter of 12 mm, and a blank with a slanted edge.
[material]
name = "al_6082_t6_carbide"

[tools.1]
shape = "flat"
diameter_mm = 12
flutes = 3

[stock]
file = "plate.blank.stl"        # closed, mm, in $BASE
resolution_mm = 0.5
"""


def plate() -> tuple[str, str, str]:
    """A pocket and a contour as FreeCAD writes them, without a word of forces; the blank and the part as STL."""
    out = [
        "(Exported by FreeCAD)", "(Post Processor: linuxcnc_post)", "(begin preamble)", "G17 G54 G40 G49 G80 G90",
        "G21",
        "(begin operation: TC: Endmill 12 mm)", "M5", "M6 T1", "G43 H1", "M3 S9000",
        "(finish operation: TC: Endmill 12 mm)", "(begin operation: Pocket)", "G0 X55.000 Y40.000 Z30.000",
        "G0 X55.000 Y40.000 Z2.000",
    ]  # fmt: skip
    depth = 0.0
    for level in (-3.0, -6.0):
        out.append(f"G1 X58.000 Y40.000 Z{depth:.3f} F1200.000")
        for _ in range(3):
            depth = depth + (level - 0.0 if level == -3.0 else -3.0) / 3.0
            out.append(f"G3 X58.000 Y40.000 Z{depth:.3f} I-3.000 J0.000 F600.000")
        depth = level
        for step in range(1, 5):
            x, y = 3.0 + 5.5 * step, 3.0 + 3.5 * step
            out += [
                f"G1 X{55 + x:.3f} Y{40 + y:.3f} F1500.000", f"G1 X{55 - x:.3f} Y{40 + y:.3f}",
                f"G1 X{55 - x:.3f} Y{40 - y:.3f}", f"G1 X{55 + x:.3f} Y{40 - y:.3f}", f"G1 X{55 + x:.3f} Y{40 + y:.3f}",
            ]  # fmt: skip
        out += ["G0 Z2.000", "G0 X58.000 Y40.000"]
    out += ["(finish operation: Pocket)", "(begin operation: Contour)", "G0 X-10.000 Y-4.000", "G0 Z-8.000"]
    out += [
        "G1 X2.000 Y2.000 F1200.000", "G1 X98.000 Y2.000", "G3 X108.000 Y12.000 I0.000 J10.000", "G1 X108.000 Y68.000",
        "G3 X98.000 Y78.000 I-10.000 J0.000", "G1 X12.000 Y78.000", "G3 X2.000 Y68.000 I0.000 J-10.000",
        "G1 X2.000 Y-8.000", "G0 Z30.000", "(finish operation: Contour)", "(begin postamble)", "M5", "M2",
    ]  # fmt: skip
    outline = [(0.0, 0.0), (110.0, 0.0), (110.0, 68.0), (98.0, 80.0), (0.0, 80.0)]
    pocket = [
        point
        for x, y, begin in ((80.0, 57.0, 0.0), (30.0, 57.0, 90.0), (30.0, 23.0, 180.0), (80.0, 23.0, 270.0))
        for point in _arc(x, y, 6.0 / math.cos(math.radians(7.5)), begin, 6)
    ]
    boss = [(8.0, 8.0)]
    for x, y, begin in ((98.0, 12.0, -90.0), (98.0, 68.0, 0.0), (12.0, 68.0, 90.0)):
        boss += _arc(x, y, 4.0, begin, 4)
    rings = [(pocket, -6.0), (pocket, 0.0), (boss, 0.0), (boss, -8.0), (outline, -8.0), (outline, -14.0)]
    return "\n".join(out) + "\n", _prism("blank", outline, -14.0, 0.0), _rings("plate", (55.0, 40.0), rings)


def _arc(x: float, y: float, radius: float, begin: float, count: int) -> list[tuple[float, float]]:
    """Return the ends of equal pieces of a quarter of a circle from an angle [deg] on."""
    angles = [math.radians(begin + 90.0 * k / count) for k in range(count + 1)]
    return [(x + radius * math.cos(angle), y + radius * math.sin(angle)) for angle in angles]


def _rings(name: str, centre: tuple[float, float], rings: list[tuple[list[tuple[float, float]], float]]) -> str:
    """Return the body between horizontal outlines, from the lid of the first to the lid of the last, as STL text.

    Every outline is seen from `centre` without hidden parts; all get corners in the directions of all corners.
    """
    middle = complex(*centre)
    directions = sorted({round(cmath.phase(complex(*p) - middle), 9) for outline, _ in rings for p in outline})
    circles = []
    for outline, z in rings:
        corners = [complex(*p) - middle for p in outline]
        circle = []
        for angle in directions:
            ray = cmath.rect(1.0, angle)
            ahead = []
            for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
                a, b = a / ray, b / ray  # the ray is the real axis now
                if min(a.imag, b.imag) <= 1e-7 and max(a.imag, b.imag) >= -1e-7 and abs(a.imag - b.imag) > 1e-7:
                    ahead.append((a.real * b.imag - b.real * a.imag) / (b.imag - a.imag))
            point = middle + max(ahead) * ray
            circle.append((point.real, point.imag, z))
        circles.append(circle)
    lids = [[(*centre, z)] * len(directions) for z in (rings[0][1], rings[-1][1])]
    circles = [lids[0], *circles, lids[1]]
    lines = [f"solid {name}"]
    for inner, outer in pairwise(circles):
        for k in range(len(directions)):
            after = (k + 1) % len(directions)
            a, b, c, d = inner[k], outer[k], outer[after], inner[after]
            for corners_of in ((a, b, c), (a, c, d)):
                if len(set(corners_of)) < 3:
                    continue
                lines += ["facet normal 0 0 0", "outer loop"]
                lines += [
                    "vertex " + " ".join(f"{round(value, 4) + 0.0:.4f}" for value in corner) for corner in corners_of
                ]
                lines += ["endloop", "endfacet"]
    return "\n".join([*lines, f"endsolid {name}", ""])


DRILLING = """%
(DRILLED BLOCK, 15 HOLES D8)
G21 G90 G17 G94
T1 M6
S4000 M3
G54
G0 X15 Y15 Z20
(CYCLE 1)
G98 G83 X15 Y15 Z-24 R2 Q6 F400
#1=1
O100 WHILE [#1 LT 15]
  X[15 + 20 * [#1 MOD 5]] Y[15 + 25 * FIX[#1 / 5]]
  #1=[#1 + 1]
O100 ENDWHILE
G80
G0 Z50
M5
M2
%
"""

DRILLING_PROCESS = """# Forces of drilling.nc: a carbide drill in aluminium.
[material]
name = "al_7075_t6_carbide"

[tools.1]
shape = "drill"
diameter_mm = 8
flutes = 2

[stock]
box = { X = [0, 110], Y = [0, 80], Z = [-30, 0] }
resolution_mm = 0.5
"""

LONG_PLATE_PROCESS = """# Forces of long_plate.nc: an end mill in an aluminium plate of 1.6 m.
[material]
name = "al_6082_t6_carbide"
sigma_percent = 25              # assumed here: a test cut in your material states it; published: 33, with wear 40

[tools.1]
diameter_mm = 16
flutes = 3

[stock]
box = { X = [0, 300], Y = [-600, 1000], Z = [-12, 0] }
resolution_mm = 1.0
"""


def long_plate() -> str:
    """Four long slots and the outline of a plate of 1.6 m."""
    out = [
        "%", "(LONG PLATE, SLOTS AND OUTLINE)", "G21 G90 G17 G94", "T1 M6", "S10000 M3", "G54", "G0 X0 Y-540 Z20",
        "(SLOTS)",
    ]  # fmt: skip
    for column in range(4):
        x = 60.0 + 60.0 * column
        out += [f"G0 X{x:.0f} Y-540", "Z2", "G1 Z-4 F600", "Y940 F1800", "G0 Z20"]
    out += ["(OUTLINE)", "G0 X-2 Y-620", "Z-6"]
    out += ["G1 Y990 F1800", "G2 X10 Y1002 I12 J0", "G1 X290", "G2 X302 Y990 I0 J-12", "G1 Y-590"]
    out += ["G2 X290 Y-602 I-12 J0", "G1 X-20", "G0 Z50", "M5", "M2", "%"]
    return "\n".join(out) + "\n"


def dome() -> str:
    """A spherical cap, finished in rings by a tool that stays normal to it: five axes."""
    radius = 120.0
    out = ["%", "(DOME, FIVE AXES)", "G21 G90 G17 G94", "S14000 M3", "G0 X170 Y100 Z40 B0 C0", "G43.4 H1"]
    for ring in range(8):
        tilt = math.radians(34.0 - 3.5 * ring)
        for step in range(25):
            turn = 2.0 * math.pi * (ring + step / 24)  # C goes on, so that the tool does not whirl between two rings
            x, y = radius * math.sin(tilt) * math.cos(turn), radius * math.sin(tilt) * math.sin(turn)
            z = radius * (math.cos(tilt) - 1.0)
            words = f"X{100 + x:.3f} Y{100 + y:.3f} Z{z:.3f} B{math.degrees(tilt):.3f} C{math.degrees(turn):.3f}"
            if ring == step == 0:
                above = words.replace(f"Z{z:.3f}", "Z20")
                out += [f"G0 {above}", "(FORCE FX=0 FY=0 FZ=-60 FRAME=TOOL)"]
                out += [f"G1 {words} F600"]
                out += ["(FORCE FX=-35 FY=-60 FZ=90 FRAME=FEED)"]
            else:
                out.append(f"G1 {words} F1200" if step == 1 else words)
    out += ["(FORCE OFF)", "G0 Z40", "G49", "M5", "M2", "%"]
    return "\n".join(out) + "\n"


def saddle() -> str:
    """A saddle, finished in rows by a tool that stays normal to it: cutter locations as Creo writes them."""
    out = ["$$ SADDLE, FIVE AXES BY TOOL VECTOR", "PARTNO / SADDLE", "UNITS / MM", "LOADTL / 1", "MULTAX / ON"]
    out += [
        "SPINDL / RPM, 14000.000000, CLW",
        "RAPID",
        "GOTO / -10.0000, -10.0000, 60.0000, 0.000000, 0.000000, 1.000000",
    ]
    rows, steps, bend = 16, 41, 12.0
    for row in range(rows):
        for step in range(steps):
            u = 2.0 * step / (steps - 1) - 1.0
            u, v = (u, 2.0 * row / (rows - 1) - 1.0) if row % 2 == 0 else (-u, 2.0 * row / (rows - 1) - 1.0)
            x, y, z = 80.0 + 80.0 * u, 60.0 + 60.0 * v, bend * (u * u - v * v) - 20.0
            i, j = -2.0 * bend * u / 80.0, 2.0 * bend * v / 60.0  # minus the slopes of the surface
            length = math.sqrt(i * i + j * j + 1.0)
            i, j, k = i / length, j / length, 1.0 / length
            vector = f"{i:.6f}, {j:.6f}, {k:.6f}"
            if row == step == 0:
                above = f"{x + 50.0 * i:.4f}, {y + 50.0 * j:.4f}, {z + 50.0 * k:.4f}, {vector}"
                out += ["RAPID", f"GOTO / {above}", "$$ FORCE FX=0 FY=0 FZ=-60 FRAME=TOOL", "FEDRAT / 600.000000, MMPM"]
            out.append(f"GOTO / {x:.4f}, {y:.4f}, {z:.4f}, {vector}")
            if row == step == 0:
                out += ["$$ FORCE FX=-35 FY=-60 FZ=90 FRAME=FEED", "FEDRAT / 1500.000000, MMPM"]
    out += ["$$ FORCE OFF", "RAPID", f"GOTO / {x + 60.0 * i:.4f}, {y + 60.0 * j:.4f}, {z + 60.0 * k:.4f}, {vector}"]
    return "\n".join([*out, "SPINDL / OFF", "FINI"]) + "\n"


CELL_FIVE_AXES = (
    CELL_KR270
    + """
[rotary]                        # five axes: C carries B
axes = ["C", "B"]
kind = "tcp"                    # X, Y, Z are the tool tip in the part
tcp_on = ["G43.4"]
tcp_off = ["G49"]
"""
)


def _prism(name: str, outline: list[tuple[float, float]], bottom: float, top: float) -> str:
    """Return a convex prism as STL text."""
    faces = []
    for k in range(1, len(outline) - 1):
        a, b, c = outline[0], outline[k], outline[k + 1]
        faces.append(((0, 0, 1), [(*p, top) for p in (a, b, c)]))
        faces.append(((0, 0, -1), [(*p, bottom) for p in (a, c, b)]))
    for (ax, ay), (bx, by) in zip(outline, [*outline[1:], outline[0]], strict=True):
        length = math.hypot(bx - ax, by - ay)
        normal = ((by - ay) / length, (ax - bx) / length, 0)
        faces.append((normal, [(ax, ay, bottom), (bx, by, bottom), (bx, by, top)]))
        faces.append((normal, [(ax, ay, bottom), (bx, by, top), (ax, ay, top)]))
    lines = [f"solid {name}"]
    for normal, corners in faces:
        lines += ["  facet normal " + " ".join(f"{value:.6f}" for value in normal), "    outer loop"]
        lines += ["      vertex " + " ".join(f"{value:.3f}" for value in corner) for corner in corners]
        lines += ["    endloop", "  endfacet"]
    return "\n".join([*lines, f"endsolid {name}"]) + "\n"


def make() -> dict[str, str]:
    """Return all samples: file name → content."""
    freeform_program, freeform_forces = freeform()
    inline_src, inline_dat = inline()
    long_program, long_forces = long_lin()
    plate_program, plate_blank, plate_part = plate()
    return {
        "cell_kr270.toml": CELL_KR270,
        "cell_kr16.toml": CELL_KR16,
        "cell_irb6700.toml": CELL_IRB6700,
        "pocket.nc": pocket(),
        "freeform.nc": freeform_program,
        "freeform.forces.csv": freeform_forces,
        "plate.nc": plate_program,
        "plate.blank.stl": plate_blank,
        "plate.stl": plate_part,
        "plate.process.toml": PLATE_PROCESS,
        "inline.src": inline_src,
        "inline.dat": inline_dat,
        "long_lin.src": long_program,
        "long_lin.forces.csv": long_forces,
        "gallery/drilling.nc": DRILLING,
        "gallery/drilling.process.toml": DRILLING_PROCESS,
        "gallery/dome.nc": dome(),
        "gallery/cell_five_axes.toml": CELL_FIVE_AXES,
        "gallery/saddle.apt": saddle(),
        "gallery/long_plate.nc": long_plate(),
        "gallery/long_plate.process.toml": LONG_PLATE_PROCESS,
    }


def main(folder: Path) -> None:
    (folder / "gallery").mkdir(parents=True, exist_ok=True)
    for name, text in make().items():
        (folder / name).write_bytes(text.encode())
        print(f"{name}: {text.count(chr(10))} lines")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
