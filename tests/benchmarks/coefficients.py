"""Cutting coefficients identified from slots that are simulated tooth by tooth, with noise of 3 N.

Run: python -m tests.benchmarks.coefficients [--draws 300]

Prints JSON: of cuts that were not measured the error of the mean force, relative (RMS and 95 % of draws), and of each
coefficient the share of draws whose 95 % interval holds the true value.
"""

from __future__ import annotations

import argparse
import json

import numpy as np

from postproc.machining.identification import NAMES
from tests.machining.test_identification import SLOTS, TRUE, cut, identified, predicted

UNSEEN = {"down 4 mm": ("down", 4.0, 0.07), "up 1 mm": ("up", 1.0, 0.1), "slot": ("slot", np.nan, 0.12)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=300)
    draws, rng = parser.parse_args().draws, np.random.default_rng(7)
    found = [identified(SLOTS, rng) for _ in range(draws)]
    errors = {}
    for name, unseen in UNSEEN.items():
        expected = cut(*unseen)[0]
        off = np.array([predicted(each.value, *unseen) - expected for each in found])
        error = np.linalg.norm(off, axis=1) / np.linalg.norm(expected)
        errors[name] = {
            "rms": round(float(np.sqrt(np.mean(error**2))), 4),
            "p95": round(float(np.quantile(error, 0.95)), 4),
        }
    inside = np.mean([np.abs(each.value - TRUE) <= each.half for each in found], axis=0)
    share = {name: round(float(of), 3) for name, of in zip(NAMES, inside, strict=True)}
    print(
        json.dumps(
            {"draws": draws, "unseen": errors, "inside": share, "inside all": round(float(inside.mean()), 3)}, indent=1
        )
    )


if __name__ == "__main__":
    main()
