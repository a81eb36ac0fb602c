"""Five axes: under load the whole tool frame stands where it should, place and orientation, by the oracle's arm."""

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

import postproc
from postproc import correction
from postproc.cell import Rotary
from tests.correction.simulated import rows_of, simulator, written
from tests.corrections import read_files
from tests.kr270 import CELL
from tests.oracle.arm import abc

MICROMETRE, MICRORADIAN = 1e-6, 1e-6
LINES = [
    "G21 G90 G17",
    "G0 {0}0 {1}0",
    "G0 X0 Y0 Z30",
    "(FORCE FX=140 FY=-90 FZ=180 MX=12 MY=-9 MZ=6)",
    "G1 Z0 F1200",
    "X40 {0}12 {1}15",
    "(FORCE FX=-120 FY=160 FZ=-150 MX=-8 MY=14 MZ=-5 FRAME=TOOL)",
    "X60 Y25 {0}-9 {1}22",
    "G2 X64 Y21 I0 J-4 {0}-7 {1}19",
    "G1 X100 {1}0",
    "(FORCE OFF)",
    "G0 Z40",
    "M30",
]


def nominal(axes, degrees, redundancy):
    """The tool frame: tilted from the program's Z by the shortest way, its Z from the spindle to the tip."""
    turned = Rotation.identity()
    for axis, angle in zip(axes, degrees, strict=True):
        turned = turned * Rotation.from_euler({"A": "x", "B": "y", "C": "z"}[axis], angle, degrees=True)
    up = turned.apply([0.0, 0.0, 1.0])
    across = np.cross([0.0, 0.0, 1.0], up)
    size = np.linalg.norm(across)
    tilt = Rotation.from_rotvec(across / size * np.arctan2(size, up[2]) if size else np.zeros(3))
    return tilt * Rotation.from_euler("z", redundancy, degrees=True) * Rotation.from_euler("x", 180.0, degrees=True)


@pytest.mark.parametrize("axes", [["C", "B"], ["A", "B"]], ids="".join)
def test_the_loaded_tool_stands_in_its_nominal_pose_in_all_six_directions(axes):
    cell = replace(CELL, rotary=Rotary(axes=axes, kind="tcp"))
    robot = postproc.load_robot(cell.robot)
    text = "\n".join(line.format(*axes) for line in LINES)
    program = read_files({"five.nc": text}, cell, robot)
    result = correction.process(program, robot, cell)
    assert not result.failed, result.issues
    sim, moves, rows = simulator("cell_kr270.toml"), written(result), rows_of(result)
    ends = {6: (12, 15), 8: (-9, 22), 9: (-7, 19), 10: (-7, 0)}
    off, turned, uncorrected, seen = [], [], [], set()
    cartesian = [index for index, move in enumerate(moves) if "frame" in move]
    last = {int(row["source_line"]): row for row in rows}
    for index, _, _, q in sim.run(moves):
        if index not in cartesian:
            continue
        row, move = rows[cartesian.index(index)], moves[index]
        target = abc(*(row[name] for name in "XYZABC"))
        line = int(row["source_line"])
        if row is last.get(line) and line in ends:
            own = nominal(axes, ends[line], cell.gcode.redundancy_deg)
            assert (Rotation.from_matrix(target[:3, :3]).inv() * own).magnitude() < MICRORADIAN
            seen.add(line)
        base, tool = abc(*(move["base"] or sim.base)), abc(*(move["tool"] or sim.tool))
        wrench = np.array([row[name] for name in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")])
        root = np.concatenate([base[:3, :3] @ wrench[:3], base[:3, :3] @ wrench[3:]])
        loaded = np.linalg.inv(base) @ sim.arm.loaded_tcp(q, tool, root)
        off.append(np.linalg.norm(loaded[:3, 3] - target[:3, 3]))
        turned.append((Rotation.from_matrix(target[:3, :3]).inv() * Rotation.from_matrix(loaded[:3, :3])).magnitude())
        commanded = abc(*move["frame"])
        uncorrected.append(
            (Rotation.from_matrix(target[:3, :3]).inv() * Rotation.from_matrix(commanded[:3, :3])).magnitude()
        )
    assert seen == set(ends)
    assert max(off) < MICROMETRE
    assert max(turned) < MICRORADIAN
    assert max(uncorrected) > 100 * MICRORADIAN  # what the correction of the orientation takes out
