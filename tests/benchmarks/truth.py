"""How true identified models and their bounds are.

Run: python -m tests.benchmarks.truth [ROBOTS] [PART OF A ROW'S NAME] [-v] [--from SEED] [--jobs N]

Robots of random seeds are measured by `samples/paper_study/simulator.py`, which shares no code with the package, and
identified through files, as a user's. Two generators draw them: `hard`, and `varied` with masses, link springs and
gears of other kinds and sizes. On milling jobs at 600 N that nobody measured, each row states

- the factor: RMS of what the load does to the tool over RMS of what the model leaves; least and median of the robots;
- the share of places at which the error is inside u95: mean, and of the worst robot;
- the largest bound over the deflection there, of all places of all robots;
- the need: what 95 % of error over bound are below; a bound that could not be smaller has 1;
- u95 over the 95 % quantile of the true error, all robots together, and that quantile;
- how many models `identify` refuses, how many identifications failed, and the processor time.

`--verdicts` also measures each robot in 15 configurations more, validates its model by them, and prints a table of
verdicts and truth: whether 90 % of the places on the jobs are inside u95, and whether the model leaves less than the
load does.

No test: run it with OMP_NUM_THREADS=1 before and after a change of the identification, and put both tables into the
commit. A seed that was used to develop the identification proves nothing: `--from` starts at fresh ones.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from postproc import elastostatics, robot
from postproc.identification import Choices, identify_folder
from postproc.identification.validation import validate
from samples.paper_study import harness, simulator

SIGMA = 0.05e-3
TWO = (0.2, 1.0)
KINDS: tuple[dict[str, Any], ...] = (
    {"gear": "quadratic", "links": "begin"},
    {"gear": "cubic", "links": "begin"},
    {"gear": "settling", "links": "end"},
    {"gear": "three", "links": "begin"},
    {"gear": "quadratic", "links": "begin", "feel_rest": False},
    {"gear": "quadratic", "links": "beam", "scale": 0.5},
    {"gear": "quadratic", "links": "begin", "base": True},
    {"gear": "linear", "links": "begin"},
)
"""Real robots, one kind after the other."""
VARIED: tuple[dict[str, Any], ...] = ({"drawn": "varied"},)
"""Robots of a second generator."""
FITS: tuple[dict[str, Any], ...] = ({"gear": "linear", "links": "begin", "geometry": 1e-5},)


@dataclass(frozen=True)
class Row:
    """A way to measure robots, and what is asked of the models.

    :param levels: shares of 2.7 kN at which each pose is loaded.
    :param knee: gears have two slopes, and change at this share of the largest torque.
    :param backlash: of every gear [rad].
    :param lost_motion: of every gear [rad]: backlash that the load alone turns over.
    :param load_error: the true load is wrong by a factor that spreads so.
    :param load_off: the true load is wrong by just so much, to either side.
    :param point_error: the true load point is off by so much in each direction [m].
    :param payload: on the flange [kg].
    :param coupled: A4 to A6 deflect by each other's torques: share of the geometric mean of their compliances.
    :param by_pose: gears are stiffer and softer by this share over the workspace.
    :param friction: every gear stays off by up to this in every state [rad].
    :param common: noise that all readings of a state share, in each direction [m].
    :param at_rest: (share, share) by which the masses of the links, and the compensator, are not as the prior states.
    :param sigma: noise of a reading in each direction [m], as it is stated too.
    :param more: lines of experiment.toml.
    :param geometry: the geometry is calibrated too.
    :param robots: number of robots; few say little of the worst one and of a quantile.
    :param wants: least of: least and median factor, share inside, that of the worst robot; most of: largest bound over
        deflection, u95 over the quantile of the errors.
    """

    name: str
    kinds: tuple[dict[str, Any], ...] = KINDS
    poses: int = 30
    levels: tuple[float, ...] = TWO
    knee: float = 0.0
    backlash: float = 0.0
    lost_motion: float = 0.0
    load_error: float = 0.0
    load_off: float = 0.0
    point_error: float = 0.0
    payload: float = 0.0
    coupled: float = 0.0
    by_pose: float = 0.0
    friction: float = 0.0
    common: float = 0.0
    at_rest: tuple[float, float] = (0.0, 0.0)
    tails: bool = False
    sigma: float = SIGMA
    more: str = ""
    geometry: bool = False
    robots: int = 8
    wants: dict[str, float] = field(default_factory=dict)


PAYLOAD = "\n[payload]\nmass_kg = 150\nX = -100\nY = 50\nZ = 200\n"
LOAD_2_PERCENT = "load_error_percent = 2\n"
ALL = {"inside": 0.95, "worst": 0.85}
DEFECT = {"inside": 0.95, "worst": 0.9}
"""Of robots that do something that no structure describes exactly."""


def main_rows(label: str, kinds: tuple[dict[str, Any], ...]) -> tuple[Row, ...]:
    """Return the rows that are asked of each generator."""
    return (
        Row(
            f"two loads{label}",
            kinds,
            robots=40,
            wants={"least": 30, "median": 120, "largest": 0.6, "spare": 2.5} | ALL,
        ),
        Row(f"breakpoints at 8 %{label}", kinds, knee=0.08, robots=40, wants={"least": 8} | ALL),
        Row(f"lost motion 0.05 mrad{label}", kinds, lost_motion=0.05e-3, robots=40, wants={"least": 15} | ALL),
        Row(
            f"payload of 150 kg, stated{label}",
            kinds,
            payload=150.0,
            more=PAYLOAD,
            robots=40,
            wants={"least": 30} | ALL,
        ),
        Row(f"geometry too{label}", kinds, geometry=True, robots=40, wants={"least": 40}),
        Row(f"wrist coupled by 30 %{label}", kinds, coupled=0.3, robots=40, wants={"least": 20} | DEFECT),
        Row(f"compliance by the pose, ±15 %{label}", kinds, by_pose=0.15, robots=40, wants={"least": 20} | DEFECT),
        Row(f"compliance by the pose, ±30 %{label}", kinds, by_pose=0.3, robots=40, wants=DEFECT),
        Row(f"friction of 0.03 mrad{label}", kinds, friction=0.03e-3, robots=40, wants=DEFECT),
        Row(f"noise of 0.03 mm common to a state{label}", kinds, common=0.03e-3, robots=40, wants=DEFECT),
        Row(f"payload of 150 kg, not stated{label}", kinds, payload=150.0, robots=40, wants=DEFECT),
    )


ROWS = (
    *main_rows("", KINDS),
    *main_rows(", varied", VARIED),
    Row("one load level", levels=(1.0,), wants={"inside": 0.93}),
    Row("15 poses", poses=15, wants={"inside": 0.93}),
    Row("backlash 0.05 mrad", backlash=0.05e-3, wants={"least": 20, "inside": 0.9}),
    Row(
        "breakpoints, play, payload; three loads",
        levels=(0.2, 0.6, 1.0),
        knee=0.1,
        lost_motion=0.03e-3,
        payload=150.0,
        more=PAYLOAD,
        wants={"inside": 0.9},
    ),
    Row("load wrong within 2 %, stated", load_error=0.02 / 1.96, more=LOAD_2_PERCENT, wants={"inside": 0.9}),
    Row("load wrong by 2 %, stated", load_off=0.02, more=LOAD_2_PERCENT, wants={"inside": 0.9}),
    Row("load point off by 5 mm, stated", point_error=5e-3, more="load_point_sigma_mm = 5\n", wants={"inside": 0.9}),
    Row("masses off by 20 %, K_c by 10 %", at_rest=(0.2, 0.1), wants={"inside": 0.9}),
    Row("heavy tails of the noise", tails=True, wants={"least": 40, "inside": 0.93}),
    Row(
        "the model fits: joint springs",
        kinds=({},),
        poses=15,
        levels=(1.0,),
        robots=40,
        wants={"inside": 0.95, "spare": 2.5},
    ),
    Row("the model fits: springs of links", kinds=FITS, robots=40, wants={"inside": 0.95, "spare": 2.5}),
)


def experiment(row: Row, seed: int, folder: Path) -> simulator.TrueRobot:
    """Measure a robot of a row and write the files of the experiment; return the robot."""
    rng = np.random.default_rng(7000 + seed)
    kind = row.kinds[seed % len(row.kinds)]
    if not kind:
        true = simulator.paper_like(rng)
    elif "drawn" in kind:
        true = getattr(simulator, kind["drawn"])(rng)
    else:
        true = simulator.hard(rng, **kind)
    q, f = simulator.plan(rng, row.poses, tilt=50.0)
    if row.knee:
        bend = row.knee * simulator.largest_torque(q, f) / true.gear.k
        true.gear = simulator.Gear("knee", true.gear.k, bend)
    true.backlash, true.lost_motion = np.full(6, row.backlash), np.full(6, row.lost_motion)
    if any(row.at_rest):
        of_links, of_compensator = row.at_rest
        off = np.random.default_rng(9000 + seed)
        true.masses = simulator.MASSES * (1.0 + of_links * off.choice([-1.0, 1.0], 6) * off.uniform(0.5, 1.0, 6))
        true.comp = (1.2e5 * (1.0 + of_compensator * off.choice([-1.0, 1.0])), *true.comp[1:])
    if row.payload:
        true.payload = (row.payload, np.array([-0.1, 0.05, 0.2]))
    _spoil(true, row, np.random.default_rng(11000 + seed))
    # the robot feels another load, at another place, than the file says
    pull = 1.0 + row.load_error * rng.normal() + row.load_off * (-1.0) ** seed
    point = simulator.LOAD_POINT + row.point_error * rng.normal(size=3)
    felt = Felt(true, pull, point, row.friction, np.random.default_rng(13000 + seed))
    _, raw = simulator.measure(felt, q, f, rng, row.sigma, levels=row.levels, tails=row.tails)
    raw = raw + row.common * felt.rng.normal(size=(*raw.shape[:2], 1, 1, 3))
    simulator.write(folder, q, f, raw, row.sigma, levels=row.levels, more=row.more)
    return true


def _spoil(true: simulator.TrueRobot, row: Row, rng: np.random.Generator) -> None:
    """Give a robot what no joint spring describes."""
    if row.coupled:
        k = true.gear.k
        for first, second in ((3, 4), (3, 5), (4, 5)):
            size = row.coupled * rng.choice([-1.0, 1.0]) / np.sqrt(k[first] * k[second])
            true.coupled[first, second] = true.coupled[second, first] = size
    if row.by_pose:
        turns = np.zeros((6, 6))
        turns[:, 1:3] = rng.uniform(-1.5, 1.5, (6, 2))
        turns += np.diag(rng.choice([0.0, 1.0, 2.0], 6))
        true.by_pose = (row.by_pose * rng.choice([-1.0, 1.0], 6), turns, rng.uniform(0.0, 2.0 * np.pi, 6))


@dataclass
class Felt:
    """A robot under a load that is not what the file says, whose gears stay off by friction."""

    true: simulator.TrueRobot
    pull: float
    point: np.ndarray
    friction: float
    rng: np.random.Generator

    def solve(self, q: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return flange poses (N, 4, 4)."""
        off = self.friction * self.rng.uniform(-1.0, 1.0, q.shape)
        return self.true.solve(q + off, self.pull * force, self.point)


def tried(row: Row, seed: int, validated: bool = False) -> dict[str, Any]:
    """Identify one robot and compare its model with the truth; `validated`: by new readings too."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        true = experiment(row, seed, folder)
        began = time.process_time()
        try:
            files = (folder / "measurements.csv", folder / "experiment.toml", folder / "model")
            done = identify_folder(*files, Choices(geometry=row.geometry))
        except Exception as error:  # a benchmark counts what failed and goes on
            return {"seed": seed, "failed": f"{type(error).__name__}: {error}"}
        used = time.process_time() - began
        model = robot.load(folder / "model")
        checked = validation_of(row, true, seed, folder) if validated else ""
    moved, left, bound = [], [], []
    for q, f in simulator.milling_jobs(np.random.default_rng(seed)):
        wrench = np.c_[f, 0 * f]
        moved.append(harness.true_deflection(true, q, f))
        left.append(moved[-1] - predicted(model, q, wrench))
        bound.append(elastostatics.position_bound(model, q, harness.TOOL, wrench))
    moved, error, bound = np.concatenate(moved), np.linalg.norm(np.concatenate(left), axis=1), np.concatenate(bound)
    return {
        "seed": seed,
        "factor": float(np.sqrt(np.sum(moved**2) / np.sum(error**2))),
        "inside": float(np.mean(error <= bound)),
        "largest": float(np.max(bound / np.linalg.norm(moved, axis=1))),
        "error": error,
        "bound": bound,
        "refused": done.data.verdict.refused,
        "text": done.text,
        "validation": checked,
        "structure": "" if done.data.structure is None else done.data.structure.reason,
        "seconds": used,
    }


def validation_of(row: Row, true: simulator.TrueRobot, seed: int, folder: Path) -> str:
    """Return what `validate` says of the model in a folder by 15 configurations that it was not identified from."""
    rng = np.random.default_rng(17000 + seed)
    q, f = simulator.plan(rng, 15, tilt=50.0)
    felt = Felt(true, 1.0, simulator.LOAD_POINT, row.friction, rng)
    _, raw = simulator.measure(felt, q, f, rng, SIGMA, levels=row.levels)
    raw = raw + row.common * rng.normal(size=(*raw.shape[:2], 1, 1, 3))
    fresh = simulator.write(folder / "fresh", q, f, raw, SIGMA, levels=row.levels, more=row.more)
    result = validate(folder / "model", fresh / "measurements.csv", fresh / "experiment.toml")
    if result.keeps_bound:
        return "holds"
    return "does not hold" if any(level.is_refuted for level in result.levels) else "not known"


def print_verdicts(results: list[dict[str, Any]]) -> None:
    """Print how many robots there are of each verdict and truth."""
    print(f"\n{'verdict':32}{'bound holds':>14}{'bound too small':>17}{'does harm':>11}")
    for kind, name in (("refused", "identify"), ("validation", "validate")):
        for verdict in sorted({str(result[kind]) for result in results}):
            here = [result for result in results if str(result[kind]) == verdict]
            said = {"True": "refused", "False": "may be used"}.get(verdict, verdict)
            holds = sum(result["inside"] >= 0.9 for result in here)
            harm = sum(result["factor"] < 1.0 for result in here)
            print(f"{f'{name}: {said}':32}{holds:14d}{len(here) - holds:17d}{harm:11d}")


def predicted(model: robot.RobotModel, q: np.ndarray, wrench: np.ndarray) -> np.ndarray:
    """Return what the load does to the tool (n, 3) [m] by the model, with the sag at rest taken out."""
    if model.subtract_reference:
        return elastostatics.deflect(model, q, harness.TOOL, wrench).twist[:, :3]
    loaded, rest = (elastostatics.deflect(model, q, harness.TOOL, one).pose for one in (wrench, 0.0 * wrench))
    return loaded[:, :3, 3] - rest[:, :3, 3]


MOST = ("largest", "spare")
"""Wants that are limits from above."""


def line(row: Row, found: list[dict[str, Any]]) -> str:
    """Return a line of the table."""
    good = [one for one in found if "failed" not in one]
    factor, inside = (np.array([one[name] for one in good]) for name in ("factor", "inside"))
    error, bound = (np.concatenate([one[name] for one in good]) for name in ("error", "bound"))
    need = np.quantile(error / bound, 0.95)
    ratio = np.sqrt(np.mean(bound**2)) / np.quantile(error, 0.95)
    seen = {
        "least": factor.min(), "median": np.median(factor), "inside": inside.mean(), "worst": inside.min(),
        "largest": max(one["largest"] for one in good), "spare": 1.0 / need,
    }  # fmt: skip
    missed = [
        f"{key} {'≤' if key in MOST else '≥'} {wanted:g}"
        for key, wanted in row.wants.items()
        if not (seen[key] <= wanted if key in MOST else seen[key] >= wanted)
    ]
    if len(good) < len(found):
        missed.append("none failed")
    return (
        f"{row.name:40}{factor.min():7.0f}{np.median(factor):8.0f}{inside.mean():8.3f}{inside.min():8.2f}"
        f"{seen['largest']:8.2f}{need:7.2f}{ratio:8.2f}{np.quantile(error, 0.95) * 1e6:9.0f}"
        f"{sum(one['refused'] for one in good):8d}{len(found) - len(good):8d}"
        f"{np.median([one['seconds'] for one in good]):8.1f}  {'missed: ' + ', '.join(missed) if missed else 'ok'}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="How true identified models and their bounds are.")
    parser.add_argument(
        "robots", nargs="?", type=int, default=0, help="robots of each row; default: 40, or 8 as it says"
    )
    parser.add_argument("part", nargs="?", default="", help="of the names of the rows to run")
    parser.add_argument("-v", "--verbose", action="store_true", help="a line for each robot")
    parser.add_argument("--from", dest="first", type=int, default=0, metavar="SEED", help="first seed")
    parser.add_argument("--verdicts", action="store_true", help="print verdicts against the truth")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    options = parser.parse_args()
    print(
        f"{options.robots or '8 or 40'} robots a row; seeds from {options.first}\n"
        f"{'':40}{'factor':>7}{'':8}{'inside u95':>12}{'':4}{'largest':>8}{'need':>7}{'u95 to':>8}{'95 % of':>9}"
        f"{'refused':>8}{'failed':>8}{'CPU':>8}\n{'':40}{'least':>7}{'median':>8}{'mean':>8}{'worst':>8}{'bound':>8}"
        f"{'':7}{'error':>8}{'err. µm':>9}{'':16}{'s':>8}",
        flush=True,
    )
    results: list[dict[str, Any]] = []
    with ProcessPoolExecutor(options.jobs) as pool:
        for row in ROWS:
            if options.part in row.name:
                count = options.robots or row.robots
                found = []
                seeds = range(options.first, options.first + count)
                for one in pool.map(tried, [row] * count, seeds, [options.verdicts] * count):
                    found.append(one)
                    if options.verbose:
                        print(_of_robot(one), flush=True)
                print(line(row, found), flush=True)
                results += [result for result in found if "failed" not in result]
    if options.verdicts:
        print_verdicts(results)


def _of_robot(one: dict[str, Any]) -> str:
    if "failed" in one:
        return f"   {one}"
    return (
        f"   {one['seed']:3d} {one['factor']:6.0f} {one['inside']:5.2f} {one['largest']:5.2f} "
        f"{np.quantile(one['error'], 0.95) * 1e6:5.0f} {np.mean(one['bound']) * 1e6:5.0f} µm "
        f"{one['seconds']:5.1f} s {one['structure'][:150]}"
    )


if __name__ == "__main__":
    main()
