"""Verdicts on the samples, for each shipped robot and several materials, in the cells that `postproc init` writes.

Run: python -m tests.benchmarks.verdict_matrix [--robots kuka_kr270 …] [--materials al_6082_t6_carbide …]

Printed are state, headline and first reason of each program, and how many are red, amber and green.
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
from collections import Counter
from pathlib import Path

from postproc.report.answers import COLOURS
from tests import commands
from tests.places import ROOT, SAMPLES

BASES = {"kuka_kr6_r900_2": "450,-60,150", "kuka_kr16_2": "900,-60,500", "kuka_kr60_3": "1100,-100,600"}
"""`$BASE` of the smaller robots."""
WITH_FORCES = (("pocket.nc", None), ("freeform.nc", "freeform.forces.csv"))
WITH_PROCESS = ("plate.nc", "gallery/drilling.nc", "gallery/long_plate.nc")
MATERIALS = ("al_6082_t6_carbide", "al_7075_t6_carbide")


def cell_of(robot: str, folder: Path) -> Path:
    """Return a cell that `init` writes, its questions answered."""
    path = folder / f"{robot}.toml"
    by_hand = [part for option in ("--tool-change", "--spindle", "--coolant") for part in (option, "hand")]
    tool = "0,0,150" if robot == "kuka_kr6_r900_2" else "0,0,350"
    frames = ["--base", BASES.get(robot, "1500,-200,700"), "--tool", tool]
    payload = ["--payload", "28,0,0,140"] if robot.startswith("abb") else []  # RAPID states the load of the tool
    commands.run("init", path, "--robot", robot, *frames, *by_hand, *payload)
    return path


def jobs(materials: tuple[str, ...], folder: Path):
    """Yield a name, a program and options: forces of the sample, or computed for each material."""
    for program, forces in WITH_FORCES:
        yield program, SAMPLES / program, [] if forces is None else ["--forces", SAMPLES / forces]
    for program in WITH_PROCESS:
        process = (SAMPLES / program).with_suffix(".process.toml")
        for material in materials:
            text = re.sub(r'(?m)^name = ".*?"', f'name = "{material}"', process.read_text(encoding="utf-8"))
            text = re.sub(r'(?m)^file = "(.*?)"', rf'file = "{process.parent}/\1"', text)
            path = folder / f"{process.stem}.{material}.toml"
            path.write_text(text, encoding="utf-8")
            yield f"{program} {material}", SAMPLES / program, ["--process", path]


def main() -> None:
    """Print the verdicts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--robots", nargs="*", default=sorted(path.parent.name for path in ROOT.glob("robot_models/*/model.toml"))
    )
    parser.add_argument("--materials", nargs="*", default=MATERIALS)
    options = parser.parse_args()
    count: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for robot in options.robots:
            cell, to = cell_of(robot, folder), ["--to", "rapid"] if robot.startswith("abb") else []
            for job, program, given in jobs(tuple(options.materials), folder):
                out = folder / robot / job.replace("/", " ")
                done = commands.run("convert", program, *given, *to, "-o", out, code=(0, 1, 3), cell=cell)
                report = out / f"{program.stem}.report.json"
                if done.exit_code == 1 or not report.exists():
                    count["refused"] += 1
                    print(f"{robot:20} {job:45} refused: {' '.join(done.output.split())[:150]}", flush=True)
                    continue
                verdict = json.loads(report.read_text(encoding="utf-8"))["verdict"]
                colour = COLOURS[verdict["state"]]
                count[colour] += 1
                print(f"{robot:20} {job:45} {colour:6} {verdict['headline']}", flush=True)
                if colour != "green":
                    print(f"{'':66} {verdict['reasons'][0][:180]}", flush=True)
    print(dict(count))


if __name__ == "__main__":
    main()
