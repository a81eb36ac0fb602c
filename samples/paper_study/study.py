"""Rebuild Tables 1, 2 and 3 of the paper from synthetic raw data.

    python samples/paper_study/study.py [--robot NAME ...] [--monte-carlo 500] [--hard 4]

The raw data come from `simulator.py`, plain numpy that shares no code with the identification; the
identification reads them from files, as a user's. Seeds are fixed: the numbers in README.md are what this prints.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import harness
import numpy as np
import simulator

from postproc import elastostatics
from postproc.identification import compensator_geometry
from postproc.identification.fit import to_file_units
from postproc.identification.procedure import identify

NAMES = ("k1", "k2", "k3", "k4", "k5", "k6")
PAPER_1 = ((184.72, 0.06), (685.93, 0.70), (123.30, 0.69))
PAPER_2 = {
    "this work": (0.623, None, 0.416, 2.786, 3.483, 2.074),
    "Dumas 2011": (3.798, 0.248, 0.276, 1.975, 2.286, 3.457),
}
PAPER_3 = {"max": (8.28, 1.77, 0.78, 4.6, 10.4), "RMS": (5.90, 1.27, 0.53, 4.6, 11.1)}
STIFF = (6.0e6, 0.458, 0.18472, 0.68593, 0.12330)


def table_1() -> None:
    """Compensator geometry from four markers at the paper's angles, σ 0.05 mm, three repeats, tilted tracker."""
    truth = np.array([184.72, 685.93, 123.30])
    q2 = np.radians([0.0, -30.0, -60.0, -90.0, -120.0, -140.0])

    def markers(rng: np.random.Generator, folder: Path) -> Path:
        length, ax, ay = truth
        p1 = length * np.c_[np.cos(q2), np.sin(q2), 0 * q2]
        p0 = -np.array([ax, ay, 0.0])
        turn = np.arctan2(*(p1 - p0)[:, 1::-1].T)
        bodies = {"P1": p1}
        for index, (radius, beta) in enumerate(((90, 0.4), (80, 2.0), (90, 0.4 + np.pi), (80, 2.0 + np.pi))):
            bodies[f"P0{index + 1}"] = p0 + np.c_[radius * np.cos(beta + turn), radius * np.sin(beta + turn), 0 * turn]
        axis = rng.normal(size=3)
        tracker = simulator.rot(axis / np.linalg.norm(axis), np.array([1.1]))[0]
        rows = ["q2,marker,repeat,X,Y,Z"]
        for name, body in bodies.items():
            for angle, place in zip(np.degrees(q2), body @ tracker.T + [1500, -900, 600], strict=True):
                for repeat in range(3):
                    xyz = place + rng.normal(0, 0.05, 3)
                    rows.append(f"{angle:.0f},{name},{repeat + 1}," + ",".join(f"{v:.4f}" for v in xyz))
        (folder / "markers.csv").write_text("\n".join(rows) + "\n")
        return folder / "markers.csv"

    inside = []
    with tempfile.TemporaryDirectory() as name:
        for seed in range(100):
            found = compensator_geometry.identify(
                compensator_geometry.read(markers(np.random.default_rng(seed), Path(name)))
            )
            inside.append(np.abs(found.lengths * 1e3 - truth) <= found.ci95 * 1e3)
            if seed == 0:
                first = found
    print("\nTable 1. Compensator geometry [mm]")
    print(f"{'':6}{'truth':>10}{'identified':>12}{'CI':>9}{'covered':>10}   paper")
    for index, label in enumerate(("L", "a_x", "a_y")):
        value, half = first.lengths[index] * 1e3, first.ci95[index] * 1e3
        share = np.mean([row[index] for row in inside])
        paper = f"{PAPER_1[index][0]:.2f} ± {PAPER_1[index][1]:.2f}"
        print(f"{label:6}{truth[index]:10.2f}{value:12.2f}{half:9.2f}{share:9.0%}    {paper}")


def robots() -> dict[str, simulator.TrueRobot]:
    """Return the truths: as the paper models it, as in its rig, as real ones are (flexible links, stiffening gears).

    The one of the rig has joints, compensator, links and gears of the real one, but links a quarter as soft and gears
    that stiffen a quarter as much: what joint springs do not describe is small enough for K_c to be seen.
    """
    ideal = simulator.TrueRobot(
        simulator.Gear("linear", 1 / simulator.PAPER_K, np.ones(6)),
        comp=STIFF, masses=simulator.MASSES.copy(), gears_feel_rest=False,
    )  # fmt: skip
    flexible = {}
    for name, share in (("rig", 0.25), ("real", 1.0)):
        true = simulator.hard(np.random.default_rng(7), gear="quadratic", links="begin", feel_rest=False)
        true.gear = simulator.Gear("quadratic", 1 / simulator.PAPER_K, true.gear.bend / share)
        links = {link: share * compliance for link, compliance in true.links.items()}
        flexible[name] = replace(true, links=links, comp=STIFF)
    return {"ideal": ideal, **flexible}


def with_links(true: simulator.TrueRobot) -> np.ndarray:
    """Return the compliance (6,) of each joint and of its link about the same axis [rad/(N·m)]: what k1 … k6 are of."""
    about = [
        axis @ true.links[joint + 1][3:, 3:] @ axis if joint + 1 in true.links else 0.0
        for joint, axis in enumerate(simulator.AXES)
    ]
    return 1 / true.gear.k + np.array(about)


def jacobians(q: np.ndarray) -> np.ndarray:
    """Return (N, 6, 6) Jacobians of the load point: rows position, rotation."""
    bare = simulator.TrueRobot(simulator.Gear("linear", 1 / simulator.PAPER_K, np.ones(6)))
    frames = bare.frames(bare.commanded(q))
    flange = bare.flange(frames)
    tip = flange[:, :3, 3] + flange[:, :3, :3] @ simulator.LOAD_POINT
    linear = np.cross(frames[1], tip - frames[2])
    return np.concatenate([np.moveaxis(linear, 0, 2), np.moveaxis(frames[1], 0, 2)], axis=1)


def industry_plan(rng: np.random.Generator, pool: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Return 15 configurations at 5 levels of q2 that determine a milling pose best: second Eq. (10), by exchange."""
    q, f = simulator.plan(rng, pool)
    test, force = simulator.milling_job(np.random.default_rng(5), 8)
    level = np.round(np.degrees(q[:, 1])).astype(int)
    names = sorted(set(level))
    rows = _regressor(q, f, level, names)
    goal = np.zeros((rows.shape[2], rows.shape[2]))
    for name in names:
        wanted = _regressor(test, force, np.full(len(test), name), names)
        goal += (wanted.transpose(0, 2, 1) @ wanted).sum(axis=0)
    info = rows.transpose(0, 2, 1) @ rows
    chosen = [index for name in names for index in np.flatnonzero(level == name)[:3]]

    def cost(selection: list[int]) -> float:
        return float(np.trace(np.linalg.solve(info[selection].sum(axis=0) + 1e-30 * np.eye(len(goal)), goal)))

    best = cost(chosen)
    for _ in range(2):
        for place in range(len(chosen)):
            for index in np.flatnonzero(level == level[chosen[place]]):
                trial = [*chosen[:place], int(index), *chosen[place + 1 :]]
                value = cost(trial) if len(set(trial)) == len(trial) else np.inf
                if value < best:
                    best, chosen = value, trial
    return q[chosen], f[chosen]


def _regressor(q: np.ndarray, f: np.ndarray, level: np.ndarray, names: list[int]) -> np.ndarray:
    """Return (N, 3, 5 + levels): columns J_j J_jᵀ F of k1, k3…k6 and of k2 at each level, scaled by typical k."""
    j = jacobians(q)
    torque = np.einsum("nij,ni->nj", j[:, :3], f)
    columns = j[:, :3] * (torque * simulator.PAPER_K)[:, None]
    second = np.stack([columns[:, :, 1] * (level == name)[:, None] for name in names], axis=2)
    return np.concatenate([columns[:, :, [0, 2, 3, 4, 5]], second], axis=2)


def dexterous_plan(rng: np.random.Generator, pool: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Return 15 configurations of best dexterity (condition number, length 0.5 m) and nearly vertical loads."""
    q, f = simulator.plan(rng, pool, tilt=15.0)
    scaled = jacobians(q) * np.array([1, 1, 1, 0.5, 0.5, 0.5])[:, None]
    chosen = np.argsort(np.linalg.cond(scaled))[:15]
    return q[chosen], f[chosen]


def tables_2_and_3(label: str, true: simulator.TrueRobot) -> None:
    """Identify by both methods on their own plans; compare on poses that neither has seen."""
    found = {}
    with tempfile.TemporaryDirectory() as name:
        for method, make in (("enhanced", industry_plan), ("serial", dexterous_plan)):
            rng = np.random.default_rng(1)
            q, f = make(rng)
            _, raw = simulator.measure(true, q, f, rng, 0.03e-3)
            data = harness.load(simulator.write(Path(name) / method, q, f, raw))
            found[method] = identify(harness.PRIOR, data, method, "joints")
            if method == "enhanced":
                found["chosen structure"] = identify(harness.PRIOR, data)
                found["serial, plan of the other"] = identify(harness.PRIOR, data, "serial", "joints")
    print(f"\nTable 2. Compliances [µrad/(N·m)], {label} robot")
    print(f"{'':34}" + "".join(f"{n:>9}" for n in NAMES) + "   K_c [N/m]")
    print(f"{'truth':34}" + "".join(f"{v * 1e6:9.3f}" for v in 1 / true.gear.k) + f"   {true.comp[0]:.3g}")
    whole = with_links(true)
    if true.links:
        print(f"{'truth, with the spring of the link':34}" + "".join(f"{v * 1e6:9.3f}" for v in whole))
    for method, row in (("enhanced", "identified, enhanced"), ("serial", "identified, serial (Dumas 2011)")):
        parameters, values, covariance = to_file_units(found[method].fit)
        names = [parameter.name for parameter in parameters]
        half = 1.96 * np.sqrt(np.diag(covariance))
        given = dict(zip(names, values, strict=True))
        extra = f"   {given['K_c']:.3g} ± {half[names.index('K_c')]:.2g}" if "K_c" in given else "   none"
        missing = {entry.name for entry in found[method].missing}
        known = [n for n in NAMES if n in given and n not in missing]
        print(f"{row:34}" + "".join(f"{given[n]:9.3f}" if n in known else f"{'prior':>9}" for n in NAMES) + extra)
        halves = (f"{half[names.index(n)]:9.3f}" if n in known else f"{'':9}" for n in NAMES)
        print(f"{'  95 % interval ±':34}" + "".join(halves))
        off = {
            n: abs(given[n] - v * 1e6) / half[names.index(n)] for n, v in zip(NAMES, whole, strict=True) if n in known
        }
        if "K_c" in given:
            off["K_c"] = abs(given["K_c"] - true.comp[0]) / half[names.index("K_c")]
        missed = ", ".join(f"{n} by {times:.1f}" for n, times in off.items() if times > 1.0)
        print(f"{'  outside, in half widths':34}   {missed or 'none'}")
    for row, printed in PAPER_2.items():
        print(f"{'paper, ' + row:34}" + "".join(f"{'–':>9}" if v is None else f"{v:9.3f}" for v in printed))

    q, f = simulator.plan(np.random.default_rng(99), 60)
    tool = np.eye(4)
    tool[:3, 3] = simulator.LOAD_POINT
    tip = [p[:, :3, 3] + p[:, :3, :3] @ simulator.LOAD_POINT for p in (true.solve(q, 0 * f), true.solve(q, f))]
    moved = (tip[1] - tip[0]) * 1e3
    after = {}
    for method, result in found.items():
        predicted = elastostatics.deflect(result.robot(), q, tool, np.c_[f, 0 * f]).twist[:, :3] * 1e3
        after[method] = np.linalg.norm(moved - predicted, axis=1)
    before = np.linalg.norm(moved, axis=1)
    print(f"\nTable 3. Distance before and after compensation [mm], 60 poses used by neither, {label} robot")
    print("       before  serial enhanced  factors         ratio   paper (same order, no ratio)")
    for criterion, norm in (("max", np.max), ("RMS", lambda v: np.sqrt(np.mean(v**2)))):
        b, s, e = norm(before), norm(after["serial"]), norm(after["enhanced"])
        paper = " ".join(f"{v:g}" for v in PAPER_3[criterion])
        print(f"{criterion:5}{b:8.2f}{s:8.3f}{e:9.3f}{b / s:9.1f}{b / e:7.1f}{s / e:7.1f}   {paper}")
    rms = {method: float(np.sqrt(np.mean(left**2))) for method, left in after.items()}
    own, other, chosen = rms["serial"], rms["serial, plan of the other"], rms["chosen structure"]
    print(
        f"ratio {own / rms['enhanced']:.1f} = {other / rms['enhanced']:.1f} by the method (both on the plan of the "
        f"enhanced: serial {other:.3f} mm) × {own / other:.1f} by the plan"
    )
    print(
        f"with the structure the data support: {chosen:.3f} mm RMS, factor {np.sqrt(np.mean(before**2)) / chosen:.0f}"
    )


def coverage(runs: int) -> None:
    """Print how often the 95 % intervals hold the truth."""
    rng = np.random.default_rng(0)
    true = simulator.paper_like(rng)
    q, f = simulator.plan(rng, 15)
    exact, raw = simulator.measure(true, q, f, rng, 0.03e-3)
    with tempfile.TemporaryDirectory() as name:
        data = harness.load(simulator.write(Path(name), q, f, raw))
    expected = np.r_[1e6 / true.gear.k, true.comp[0], true.comp[1] * 1e3]
    inside, began = [], time.perf_counter()
    for _ in range(runs):
        result = identify(harness.PRIOR, harness.with_readings(data, simulator.readings(exact, rng, 0.03e-3, 3)))
        _, values, covariance = to_file_units(result.fit)
        inside.append(np.abs(values - expected) <= 1.96 * np.sqrt(np.diag(covariance)))
    share = np.mean(inside, axis=0)
    print(f"\nCoverage of the 95 % intervals in {runs} runs ({(time.perf_counter() - began) / runs * 1e3:.0f} ms each)")
    print("  ".join(f"{n} {v:.1%}" for n, v in zip((*NAMES, "K_c", "s_0"), share, strict=True)))


def hard_robots(count: int) -> None:
    """Print factors on milling jobs at 600 N for robots with flexible links and stiffening gears."""
    print("\nHard robots: 30 poses, σ 0.05 mm; factor (RMS) on milling jobs at 600 N; share of errors within u95")
    kinds = {
        "gears quadratic, springs where links begin": {"gear": "quadratic", "links": "begin"},
        "gears cubic, springs where links begin": {"gear": "cubic", "links": "begin"},
        "gears settling, springs where links end": {"gear": "settling", "links": "end"},
        "gears three slopes (harmonic drive)": {"gear": "three", "links": "begin"},
        "gears stiffen with the load alone": {"gear": "quadratic", "links": "begin", "feel_rest": False},
        "beams (Euler, Bernoulli)": {"gear": "quadratic", "links": "beam", "scale": 0.5},
        "flexible base": {"gear": "quadratic", "links": "begin", "base": True},
        "gears linear": {"gear": "linear", "links": "begin"},
    }
    print(f"{'':46}{'joints':>8}{'chosen':>8}{'u95':>6}{'time':>7}")
    for label, kind in kinds.items():
        for seed in range(count):
            rng = np.random.default_rng(900 + seed)
            true = simulator.hard(rng, **kind)
            q, f = simulator.plan(rng, 30, tilt=50.0)
            _, raw = simulator.measure(true, q, f, rng, 0.05e-3)
            with tempfile.TemporaryDirectory() as name:
                data = harness.load(simulator.write(Path(name), q, f, raw, 0.05e-3))
            began = time.process_time()
            result = identify(harness.PRIOR, data)
            used = time.process_time() - began
            joints = identify(harness.PRIOR, data, depth="joints")
            work = simulator.milling_jobs(np.random.default_rng(seed))
            factors = [harness.job_factor(true, r.robot(), work) for r in (joints, result)]
            share = harness.share_within_bound(true, result, work)
            print(f"{label:46}{factors[0]:8.1f}{factors[1]:8.0f}{share:6.0%}{used:6.1f}s", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    truths = robots()
    parser.add_argument("--robot", action="append", choices=truths, help="robot of Tables 2 and 3; all by default")
    parser.add_argument("--monte-carlo", type=int, default=0, metavar="N", help="runs for the coverage of intervals")
    parser.add_argument("--hard", type=int, default=0, metavar="N", help="seeds for each kind of hard robot")
    options = parser.parse_args()
    table_1()
    for label in options.robot or truths:
        tables_2_and_3(label, truths[label])
    if options.monte_carlo:
        coverage(options.monte_carlo)
    if options.hard:
        hard_robots(options.hard)


if __name__ == "__main__":
    main()
