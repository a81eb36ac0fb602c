"""Verdicts of `identify` on simulated measurements of all kinds, beside what their models do to parts.

Run: python -m tests.benchmarks.verdict_truth [ROBOTS] [--from SEED] [--jobs N] [--file RESULTS.jsonl] [--only PART]

Measured are the rows of `tests.benchmarks.truth`, and rows that are worse than anybody should measure: few poses, weak
loads, much noise or friction, loads and payloads that are not as stated. The truth of a model is judged at 200 poses
all over the workspace, clear of floor and column, under 600 N in random directions:

- better: the share of these poses at which correction lowers the error;
- inside: the share at which the error is inside u95.

A verdict is against the truth if a model may be used and makes parts worse at more than half of the poses, or is
refused and makes them better there with a bound that holds in 90 %. A model that may be used and whose bound does not
hold is counted apart, and so are measurements whose files state a load or a payload that is not the true one: no
reading shows that. With `--file` results are added to a file, and those that it has are not computed again.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from postproc import elastostatics, robot
from postproc.errors import PostprocError
from postproc.identification import Choices, identify_folder
from samples.paper_study import harness, simulator
from tests.benchmarks import truth
from tests.benchmarks.truth import PAYLOAD, ROWS, Row

POOR = (
    Row("3 poses", poses=3),
    Row("5 poses", poses=5),
    Row("8 poses", poses=8),
    Row("8 poses, one load level", poses=8, levels=(1.0,)),
    Row("12 poses, varied", truth.VARIED, poses=12),
    Row("weak loads: 135 N", levels=(0.05,)),
    Row("weak loads: 54 N", levels=(0.02,)),
    Row("noise of 0.3 mm", sigma=0.3e-3),
    Row("noise of 1 mm, 10 poses", sigma=1e-3, poses=10),
    Row("friction of 0.1 mrad", friction=0.1e-3),
    Row("friction of 0.3 mrad", friction=0.3e-3),
    Row("friction of 1 mrad, 10 poses", friction=1e-3, poses=10),
    Row("noise of 0.3 mm common to a state", common=0.3e-3),
    Row("noise of 2 mm common to a state, 10 poses", common=2e-3, poses=10),
    Row("compliance by the pose, ±50 %", by_pose=0.5),
    Row("wrist coupled by 80 %", coupled=0.8),
    Row("load wrong by 10 %, not stated", load_off=0.1),
    Row("load wrong by 40 %, not stated", load_off=0.4),
    Row("load point off by 50 mm, not stated", point_error=50e-3),
    Row("load point off by 200 mm, not stated", point_error=200e-3, poses=10),
    Row("payload stated, there is none", more=PAYLOAD),
)
FALSE_FILES = ("not stated", "there is none")
"""Parts of the names of rows whose files do not say what was done."""
POSES = 200
FORCE = 600.0
HELD = 0.9


def workspace(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return joint angles (200, 6) [rad] clear of floor and column, and forces (200, 3) [N] in random directions."""
    rng = np.random.default_rng(23000 + seed)
    bare = simulator.paper_like(np.random.default_rng(0))
    q = rng.uniform(harness.PRIOR.lower, harness.PRIOR.upper, (12 * POSES, 6))
    flange = bare.flange(bare.frames(bare.commanded(q)))
    tip = flange[:, :3, 3] + flange[:, :3, :3] @ harness.TOOL[:3, 3]
    reach = np.hypot(tip[:, 0], tip[:, 1])
    clear = np.flatnonzero((tip[:, 2] > 0.0) & (reach > 0.8))[:POSES]
    assert len(clear) == POSES
    force = rng.normal(size=(POSES, 3))
    return q[clear], FORCE * force / np.linalg.norm(force, axis=1)[:, None]


def trial(row: Row, seed: int) -> dict[str, Any]:
    """Identify one robot, and compare verdict and model with the truth."""
    content: dict[str, Any] = {"row": row.name, "seed": seed}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        true = truth.experiment(row, seed, folder)
        files = (folder / "measurements.csv", folder / "experiment.toml", folder / "model")
        try:
            done = identify_folder(*files, Choices(geometry=row.geometry))
        except PostprocError as error:
            return content | {"verdict": "no model", "why": str(error)}
        model = robot.load(folder / "model")
    q, force = workspace(seed)
    wrench = np.c_[force, 0.0 * force]
    deflection = harness.true_deflection(true, q, force)
    error = np.linalg.norm(deflection - truth.predicted(model, q, wrench), axis=1)
    bound = elastostatics.position_bound(model, q, harness.TOOL, wrench)
    before = np.linalg.norm(deflection, axis=1)
    verdict = done.data.verdict
    return content | {
        "verdict": "refused" if verdict.refused else "may be used",
        "why": verdict.line if verdict.refused else "",
        "better": float(np.mean(error < before)),
        "inside": float(np.mean(error <= bound)),
        "factor": float(np.sqrt(np.sum(before**2) / np.sum(error**2))),
        "levels": [
            [level.load_N, level.deflection_mm, level.bound_mm, level.worst_share, level.chance]
            for level in done.data.workspace
        ],
    }


def against(result: dict[str, Any]) -> bool:
    """Return whether a verdict is against the truth."""
    if result["verdict"] == "may be used":
        return bool(result["better"] < 0.5)
    return bool(result["verdict"] == "refused" and result["better"] >= 0.5 and result["inside"] >= HELD)


def print_table(results: list[dict[str, Any]]) -> None:
    """Print how many measurements there are of each verdict and truth."""
    is_false = [any(part in result["row"] for part in FALSE_FILES) for result in results]
    for title, some in (
        ("as the files say", [result for result, false in zip(results, is_false, strict=True) if not false]),
        ("with false files", [result for result, false in zip(results, is_false, strict=True) if false]),
    ):
        print(f"\n{len(some)} measurements {title}, of {len({result['row'] for result in some})} kinds")
        _print_part(some)


def _print_part(results: list[dict[str, Any]]) -> None:
    print(f"{'':14}{'better':>10}{'better, bound':>15}{'worse':>8}{'against':>10}")
    print(f"{'verdict':14}{'':>10}{'too small':>15}{'':>8}{'the truth':>10}")
    for verdict in ("may be used", "refused"):
        judged = [result for result in results if result["verdict"] == verdict]
        kinds = Counter(
            "worse" if result["better"] < 0.5 else "held" if result["inside"] >= HELD else "too small"
            for result in judged
        )
        wrong = sum(against(result) for result in judged)
        print(f"{verdict:14}{kinds['held']:10d}{kinds['too small']:15d}{kinds['worse']:8d}{wrong:10d}")
    print(f"{'no model':14}{sum(result['verdict'] == 'no model' for result in results):10d}")
    for result in results:
        if result["verdict"] == "no model":
            print(f"  no model: {result['row']}, seed {result['seed']}: {result['why'][:150]}")
        elif against(result) or (result["verdict"] == "may be used" and result["inside"] < HELD):
            numbers = f"better at {result['better']:.2f}, inside {result['inside']:.2f}, factor {result['factor']:.1f}"
            print(f"  {result['verdict']}: {result['row']}, seed {result['seed']}: {numbers} {result['why'][:100]}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robots", nargs="?", type=int, default=4, help="robots of each row")
    parser.add_argument("--from", dest="first", type=int, default=0, metavar="SEED", help="first seed")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--file", type=Path, help="JSON lines of results")
    parser.add_argument("--only", default="", help="part of the names of the rows to run")
    options = parser.parse_args()
    results = []
    if options.file is not None and options.file.exists():
        results = [json.loads(line) for line in options.file.read_text(encoding="utf-8").splitlines()]
    done = {(result["row"], result["seed"]) for result in results}
    seeds = range(options.first, options.first + options.robots)
    tasks = [(row, seed) for seed in seeds for row in (*POOR, *ROWS) if options.only in row.name]
    tasks = [(row, seed) for row, seed in tasks if (row.name, seed) not in done]
    with ProcessPoolExecutor(options.jobs) as pool:
        for result in pool.map(trial, *zip(*tasks, strict=True)) if tasks else ():
            results.append(result)
            if options.file is not None:
                with options.file.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(result) + "\n")
    print_table(results)


if __name__ == "__main__":
    main()
