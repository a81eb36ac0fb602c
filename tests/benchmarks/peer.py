"""The job file that an engineer would write for one part: pygcode, Pinocchio and a loop. To compare with, not to use.

Run: python -m tests.benchmarks.peer PART.nc OUT.src

For each block of lines it solves the inverse kinematics by Newton's method from the joint angles before, takes one
linear step of Eq. (1) (springs of the joints only), and writes KRL. Nothing is checked, inserted or read back.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import numpy as np
import pinocchio as pin
from pygcode import Line

MODEL_FOLDER = Path(__file__).parent.parent.parent / "robot_models" / "kuka_kr270"
BASE = pin.SE3(np.eye(3), np.array([1.5, -0.2, 0.7]))
TOOL_350 = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.35]))
DOWN = np.diag([1.0, -1.0, -1.0])
FORCE = np.array([60.0, -40.0, 90.0, 0.0, 0.0, 0.0])
START = np.deg2rad([0.0, -70.0, 110.0, 0.0, 50.0, 0.0])


def main(part: Path, out: Path) -> None:
    """Correct one program of lines."""
    model = pin.buildModelFromUrdf(str(MODEL_FOLDER / "robot.urdf"))
    data, frame = model.createData(), model.getFrameId("flange")
    joints = tomllib.loads((MODEL_FOLDER / "model.toml").read_text(encoding="utf-8"))["joints"]
    compliance = np.diag([1e-6 * joints[f"A{axis}"]["compliance_urad_per_Nm"] for axis in range(1, 7)])
    q, place = START.copy(), {"X": 0.0, "Y": 0.0, "Z": 0.0}
    with part.open(encoding="utf-8") as blocks, out.open("w", encoding="utf-8", newline="\r\n") as written:
        written.write("DEF PART( )\n$APO.CDIS=0.2\n$VEL.CP=0.05\n")
        for text in blocks:
            words = {word.letter: float(word.value) for word in Line(text.rstrip("\n")).block.words}
            if not place.keys() & words.keys():
                continue
            place.update((letter, words[letter]) for letter in "XYZ" if letter in words)
            target = pin.SE3(DOWN, 1e-3 * np.array([place["X"], place["Y"], place["Z"]]))
            flange = BASE * target * TOOL_350.inverse()
            for _ in range(20):
                pin.computeJointJacobians(model, data, q)
                pin.updateFramePlacement(model, data, frame)
                twist = pin.log6(data.oMf[frame].actInv(flange)).vector
                if np.abs(twist).max() < 1e-9:
                    break
                q = q + np.linalg.solve(pin.getFrameJacobian(model, data, frame, pin.LOCAL), twist)
            jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            lever = data.oMf[frame].rotation @ TOOL_350.translation
            jacobian[:3] -= pin.skew(lever) @ jacobian[3:]
            shift = jacobian @ compliance @ jacobian.T @ FORCE
            turn = pin.exp3(-shift[3:]) @ DOWN
            x, y, z = 1e3 * (target.translation - BASE.rotation.T @ shift[:3])
            c, b, a = np.rad2deg(pin.rpy.matrixToRpy(turn))
            written.write(f"LIN {{X {x:.4f},Y {y:.4f},Z {z:.4f},A {a:.5f},B {b:.5f},C {c:.5f}}} C_DIS\n")
        written.write("END\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
