"""From process to part: are the errors inside the bound, with coefficients drawn from their σ and a hidden robot?

Run: python -m tests.benchmarks.chain [--robots 10] [--materials 10] [--from SEED]

Robots of the simulator, which shares no code with the package, are measured and identified through files as a user
does. Each then has four draws, one for each program that is converted with `--process`: a slot, a pocket, a contour
and adaptive loops. The truth is made of

- the written text, read by the KRL reader of `tests/oracle/cell_sim.py`, and joint angles of that oracle;
- the force in an exact front (`tests/oracle/front.py`), with coefficients that are not those of the process;
- the simulated robot under it. The force acts at half the depth of the cut; the torque about the spindle is left out.

The error of a cutting target is that of the tip; errors of the geometry without load are left out, as in `truth`.
Prints JSON: the share of cutting targets inside u95 if the six coefficients are drawn

- `each`: independently of each other, `one`: as one factor, both normal with the σ of the material;
- `published`: as one of the other published sets of the alloy;

and the forces then grow by wear of the tool, by 0 to 25 %.

`draws` has one set of coefficients for each robot and program, `all` as many as --materials. One draw moves all targets
of a program at once, so targets are no independent trials. `standard_error` is that of a mean over draws, and for
`all` of one over robots.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import postproc
from postproc import correction, machining
from postproc.identification import Choices, identify_folder
from postproc.jobs import process_forces
from postproc.robot import RobotModel
from samples.paper_study import simulator
from tests.benchmarks import truth
from tests.machining.setting import CELL, gcode, process, read, tool
from tests.machining.test_short_moves import BOX, CASES, DEPTH, FEED, RPM, TEETH, in_box
from tests.oracle import cell_sim, front
from tests.oracle.arm import Arm, abc
from tests.places import SAMPLES

PROGRAMS = ("slot in one", "pocket", "contour", "adaptive of 0.8 mm")
MATERIAL = "al_7075_t6_carbide"
OTHERS = ("al_7075_hss", "al_7075_carbide_2", "al_7075_t6_carbide_3", "al_7075_d25")
KEYS = ("Ktc_N_per_mm2", "Kte_N_per_mm", "Krc_N_per_mm2", "Kre_N_per_mm", "Kac_N_per_mm2", "Kae_N_per_mm")
"""In the order of `front.forces`."""
WEAR = 0.25
"""Largest growth of the forces by wear of the tool."""
LEAST_FORCE = 1.0
"""Targets with a smaller force [N] do not cut."""
MOST = 60
"""Targets of a program that are looked at, evenly."""
(ROW,) = [row for row in truth.ROWS if row.name == "two loads"]
RADIUS = 5.0


def coefficients(name: str) -> np.ndarray:
    entry = machining.table()[name]
    return np.array([getattr(entry, key) for key in KEYS])


def drawn(rng: np.random.Generator, materials: int) -> dict[str, np.ndarray]:
    """Return true coefficients (k, 6) of each kind of draw."""
    stated = coefficients(MATERIAL)
    sigma = 0.01 * machining.table()[MATERIAL].sigma_percent
    each, one = rng.normal(size=(materials, 6)), rng.normal(size=(materials, 1))
    each = stated * np.maximum(1.0 + sigma * each, 0.0)
    one = stated * np.maximum(1.0 + sigma * one, 0.0)
    published = np.array([coefficients(name) for name in rng.permutation(OTHERS)])
    kinds = {"each": each, "one": one, "published": published}
    return {name: values * (1.0 + rng.uniform(0.0, WEAR, (len(values), 1))) for name, values in kinds.items()}


def fronts(points: np.ndarray, motion: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the forces (n, 3, 6) [N] for 1 of each coefficient, at places of motions, axes of the program."""
    exact = front.Path(points, np.arange(len(points) - 1))
    per_tooth = np.full(len(exact.length), FEED / RPM / TEETH)
    rows = list(zip(motion.tolist(), t.tolist(), strict=True))
    units = [front.forces(exact, RADIUS, TEETH, DEPTH, per_tooth, unit, in_box, rows) for unit in np.eye(6)]
    return np.stack(units, axis=-1)


def tried(seed: int, materials: int) -> list[dict[str, Any]]:
    """Return for each program of one robot the shares inside, and the sizes of error and bound [mm]."""
    rng = np.random.default_rng(4000 + seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        true = truth.experiment(ROW, seed, folder)
        identify_folder(folder / "measurements.csv", folder / "experiment.toml", folder / "model", Choices())
        model = postproc.load_robot(str(folder / "model"))
        return [of_program(program, true, model, drawn(rng, materials), folder) for program in PROGRAMS]


def of_program(
    name: str, true: simulator.TrueRobot, model: RobotModel, material: dict[str, np.ndarray], folder: Path
) -> dict[str, Any]:
    make, length = CASES[name]
    points = make(length)
    blocks = [f"X{x:.6f} Y{y:.6f}" for x, y in points[1:]]
    begin = f"G0 X{points[0][0]:.6f} Y{points[0][1]:.6f} Z5"
    text = gcode(begin, f"G1 Z-{DEPTH} F{FEED}", *blocks, "G0 Z50", spindle=f"S{RPM:g} M3")
    (folder / "process.toml").write_text(process(tool(2 * RADIUS, TEETH), BOX, material=f'name = "{MATERIAL}"'))
    source = process_forces.read(folder / "process.toml", CELL)
    result = correction.process(read(folder, text), model, CELL, source)
    assert not result.failed, result.issues
    rows = np.flatnonzero(~result.rapid & (result.motion >= 2))
    rows = rows[:: -(-len(rows) // MOST)]
    by_unit = fronts(points, result.motion[rows] - 2, result.t[rows])
    cuts = np.linalg.norm(by_unit @ coefficients(MATERIAL), axis=1) > LEAST_FORCE
    rows, by_unit = rows[cuts], by_unit[cuts]
    q, nominal_tip, target, base, tip = commanded(result, rows)
    bound = result.bound[rows]
    point = tip - 1e-3 * np.array([0.0, 0.0, DEPTH / 2])
    rest = true.solve(q, np.zeros((len(q), 3)), point=point)
    out: dict[str, Any] = {"targets": len(rows), "u95_mm": 1e3 * float(np.sqrt(np.mean(bound**2)))}
    for kind, values in material.items():
        count = len(values)
        force = np.einsum("nif,kf,ji->knj", by_unit, values, base[:3, :3]).reshape(-1, 3)
        loaded = true.solve(np.tile(q, (count, 1)), force, point=point).reshape(count, -1, 4, 4)
        moved = (loaded - rest)[..., :3, :3] @ tip + (loaded - rest)[..., :3, 3]
        error = np.linalg.norm(nominal_tip + moved - target, axis=2)
        out[kind] = np.mean(error <= bound, axis=1)
        out[f"{kind}_mm"] = 1e3 * np.sqrt(np.mean(error**2, axis=1))
    return out


def commanded(result: correction.Result, rows: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return joint angles (n, 6), tip without load and target (n, 3) [m], all in the root; $BASE (4, 4), tip (3,)."""
    moves = {move["line"]: move for move in cell_sim.read(result.documents[0].text, home=[0, -90, 90, 0, 0, 0])}
    arm = Arm.load(SAMPLES.parent / "robot_models" / "kuka_kr270")
    guess, q, tips = np.radians([0, -70, 110, 0, 50, 0]), [], []
    for line in result.output_line[rows].tolist():
        base, frame = abc(*moves[line]["base"]), abc(*moves[line]["tool"])
        guess = arm.inverse(base @ abc(*moves[line]["frame"]), frame, guess)
        q.append(guess)
        tips.append(arm.nominal_tcp(guess, frame)[:3, 3])
    target = result.nominal.position[rows] @ base[:3, :3].T + base[:3, 3]
    return np.array(q), np.array(tips), target, base, frame[:3, 3]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--materials", type=int, default=10, help="draws of coefficients for each robot and program")
    parser.add_argument("--from", dest="first", type=int, default=0, metavar="SEED", help="first seed")
    given = parser.parse_args()
    found = [tried(seed, given.materials) for seed in range(given.first, given.first + given.robots)]
    every = [each for one in found for each in one]
    weight = np.array([each["targets"] for each in every])
    out: dict[str, Any] = {"draws": len(every), "targets": int(weight.sum())}
    for kind in ("each", "one", "published"):
        mean = np.array([np.mean(each[kind]) for each in every])
        out[kind] = {
            "draws": share(np.array([each[kind][0] for each in every]), weight),
            "all": share(mean, weight),
            "standard_error": {
                "draws": error(np.array([each[kind][0] for each in every]), weight),
                "all": error(mean.reshape(-1, len(PROGRAMS)), weight.reshape(-1, len(PROGRAMS))),
            },
            "by program": {
                name: share(mean[k :: len(PROGRAMS)], weight[k :: len(PROGRAMS)]) for k, name in enumerate(PROGRAMS)
            },
            "error_mm": rms([each[f"{kind}_mm"] for each in every]),
        }
    out["u95_mm"] = rms([each["u95_mm"] for each in every])
    print(json.dumps(out, indent=1))


def share(inside: np.ndarray, weight: np.ndarray) -> float:
    return round(float(np.average(inside, weights=weight)), 3)


def error(inside: np.ndarray, weight: np.ndarray) -> float:
    """Return the standard error of the weighted mean over independent rows (n,) or (n, k)."""
    off = (weight * (inside - np.average(inside, weights=weight))).reshape(len(inside), -1).sum(axis=1)
    return round(float(np.sqrt(np.sum(off**2)) / weight.sum()), 3)


def rms(values: list[Any]) -> float:
    return round(float(np.sqrt(np.mean(np.square(values)))), 3)


if __name__ == "__main__":
    main()
