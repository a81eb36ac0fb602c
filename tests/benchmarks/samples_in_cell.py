"""The samples as an installed version writes them, in the independent cell simulator: what is cut?

Run: python -m tests.benchmarks.samples_in_cell [POSTPROC] [--every 20]

From `targets.csv` only the wrench and the nominal position are taken; that the tip stands there under it is found by
`tests.oracle`, which shares no code with the package.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
import tomllib
from pathlib import Path

import numpy as np

from tests.benchmarks.same_results import JOBS, MODELS, converted
from tests.oracle import cell_sim
from tests.oracle.arm import Arm
from tests.places import SAMPLES

_SHORT = 200
"""Programs of fewer targets are looked at whole."""


def simulator(cell: Path) -> cell_sim.Cell:
    """Return the cell of a file."""
    raw = tomllib.loads(cell.read_text(encoding="utf-8"))
    base, tool = (tuple(raw[table].get(key, 0.0) for key in "XYZABC") for table in ("base", "tool"))
    return cell_sim.Cell(Arm.load(MODELS / raw["robot"]), raw["start"]["joints"], base, tool)


def deviations(out: Path, name: str, sim: cell_sim.Cell, every: int) -> np.ndarray:
    """Return the distance of the loaded tip from nominal (n,) [mm] at every n-th target of a written program."""
    with (out / f"{name}.targets.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    texts = [path.read_bytes().decode() if path.exists() else "" for path in (out / f"{name}.src", out / f"{name}.dat")]
    moves = cell_sim.read(*texts, np.degrees(sim.start).tolist())
    row = dict(zip((index for index, move in enumerate(moves) if "frame" in move), rows, strict=True))
    every = every if len(rows) > _SHORT else 1
    off = []
    for index, _, _, q in sim.run(moves):
        if int(row[index]["output_line"]) != moves[index]["line"]:
            raise SystemExit(f"{name}: targets.csv names line {row[index]['output_line']} for {moves[index]}")
        if index % every == 0:
            wrench = np.array([float(row[index][key]) for key in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")])
            nominal = np.array([float(row[index][key]) for key in "XYZ"])
            off.append(np.linalg.norm(1000 * sim.tip(moves[index], q, wrench) - nominal))
    return np.array(off)


def main() -> None:
    """Print how far the simulated tip is from nominal in each sample."""
    options = argparse.ArgumentParser()
    options.add_argument("postproc", nargs="?", default=str(Path(sys.executable).parent / "postproc"))
    options.add_argument("--every", type=int, default=20)
    given = options.parse_args()
    for program, cell, forces in JOBS:
        with tempfile.TemporaryDirectory() as place:
            converted(given.postproc, SAMPLES / cell, [SAMPLES / program], forces and SAMPLES / forces, Path(place))
            off = deviations(Path(place), Path(program).stem, simulator(SAMPLES / cell), given.every)
        told = f"largest {off.max():.6f} mm, RMS {np.sqrt(np.mean(off**2)):.6f} mm at {len(off)} targets"
        print(f"{program:<14}{cell:<18}{told}", flush=True)


if __name__ == "__main__":
    main()
