"""Expected accuracy of plans against 500 identifications each: `python -m tests.benchmarks.plan_accuracy [RUNS]`.

Prints for several jobs and rigs: expected RMS with its 95 % interval, what the identifications reached, their ratio
(within 10 % is asked for), and how many of them lie in the interval.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from postproc.plan import Options, plan_measurements
from tests.plan import monte_carlo, setting
from tests.plan.setting import AROUND, BASIC

RIGS = {"40°": "\n[rig]\nmass_kg = 275\nmax_angle_deg = 40\n", "15°": "\n[rig]\nmass_kg = 275\nmax_angle_deg = 15\n"}
STIFF = (6e6, 0.458)
"""K_c [N/m] that deflections can show, and s_0 [m]; the planner is told so."""
CASES = [(seed, name, None) for seed in (1, 2, 3) for name in RIGS] + [(1, "40°", STIFF)]


def main(runs: int) -> None:
    print(f"{'job':<8}{'rig':<6}{'expected':>10}{'interval':>20}{'reached':>10}{'ratio':>8}{'inside':>9}{'s':>7}  (µm)")
    for seed, name, spring in CASES:
        with tempfile.TemporaryDirectory() as place:
            folder, begin = Path(place), time.perf_counter()
            prior = setting.ROBOT
            if spring is not None:
                prior = replace(
                    prior, compensator=replace(prior.compensator, stiffness=spring[0], free_length=spring[1])
                )
            site = replace(setting.site(folder, BASIC + RIGS[name] + AROUND), robot=prior)
            result = plan_measurements(site, setting.job(seed), Options(comparisons=False))
            found, failed = monte_carlo.errors(folder, result, runs, prior=prior, true=monte_carlo.true_robot(spring))
            reached = np.sqrt(np.mean(found**2))
            low, high = result.accuracy.interval
            inside = np.mean((found > low) & (found < high))
            print(
                f"{seed:<8}{name:<6}{result.accuracy.rms * 1e6:>10.3f}{f'{low * 1e6:.3f} … {high * 1e6:.3f}':>20}"
                f"{reached * 1e6:>10.3f}{reached / result.accuracy.rms:>8.3f}{100 * inside:>8.1f}%"
                f"{time.perf_counter() - begin:>7.0f}"
                + ("  K_c identified" if result.compensator_free else "")
                + (f"  {failed} failed" if failed else ""),
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500)
