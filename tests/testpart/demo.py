"""The probed test part of the demo: made by simulators that share no code with the package.

    python -m tests.testpart.demo        write samples/demo/testpart

The robot is that of the tracker readings of the demo (`samples/paper_study/simulator.py`), its arm that of
`tests.oracle.whole_arm`. It mills `testpart.nc` into a block whose top is 0.15 mm lower than in the program. The probe
has a noise of 5 µm; forces are 8 % larger than computed.
"""

from __future__ import annotations

import msgspec
import numpy as np
from click.testing import CliRunner

from postproc import robot as robots
from postproc.cli import main as postproc
from postproc.robot.model_file import JointSpring
from samples.paper_study import simulator
from tests.oracle.arm import Arm
from tests.oracle.whole_arm import WholeArm
from tests.places import ROOT
from tests.testpart import trial
from tests.testpart.machine import Machine

FOLDER = ROOT / "samples" / "demo"
BASE, TOOL, START = (1600, -100, 750, 0), (0, 0, 350), [0, -80, 105, 0, 65, 0]
SCALE, RADIUS, TOP = 1.08, 5.012, (-0.15, 3e-4, -2e-4)
SEEDS = {"probed.csv": 1, "probed_later.csv": 2}
"""The part, and the same one after some months: another block, another noise."""


def arm() -> WholeArm:
    """The robot of the demo."""
    true, model = simulator.paper_like(np.random.default_rng(1)), trial.content()
    joints = {
        name: JointSpring(source="truth", compliance_urad_per_Nm=1e6 / stiffness)
        for name, stiffness in zip(trial.JOINTS, true.gear.k, strict=True)
    }
    spring = msgspec.structs.replace(
        model.compensator, stiffness_N_per_m=true.comp[0], free_length_mm=1e3 * true.comp[1]
    )
    urdf = (robots.find("kuka_kr270") / "robot.urdf").read_text()
    return WholeArm(urdf, msgspec.structs.replace(model, joints=joints, compensator=spring))


def probed(program: str, table: str, seed: int) -> str:
    """Mill and probe the part; return the table filled in."""
    rng = np.random.default_rng(seed)
    cutter = Machine(
        arm(), Arm.load(robots.find("kuka_kr270")), START, BASE, TOOL, 180.0,
        tuple(SCALE * k for k in trial.AL7075), RADIUS, 3, TOP,
    )  # fmt: skip
    return cutter.probed(program, table, rng)


def main() -> None:
    """Choose the part of the demo, mill and probe it."""
    folder = FOLDER / "testpart"
    given = ("--cell", str(FOLDER / "cell.toml"), "--process", str(FOLDER / "process.toml"))
    options = ("--features", "8", "--depth", "3", "--overwrite", "-o", str(folder))
    print(CliRunner().invoke(postproc, ["testpart", *given, *options], catch_exceptions=False).output)
    program, table = ((folder / name).read_text() for name in ("testpart.nc", "probing.csv"))
    for name, seed in SEEDS.items():
        (folder / name).write_text(probed(program, table, seed), encoding="utf-8")
    for path in folder.iterdir():
        if path.name not in ("testpart.nc", "testpart.process.toml", *SEEDS):
            path.unlink()


if __name__ == "__main__":
    main()
