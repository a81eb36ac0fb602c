"""Cutting coefficients identified from slots that are simulated tooth by tooth, with noise of 3 N.

Run: python -m tests.benchmarks.coefficients [--draws 300]

Prints JSON: of cuts that were not measured the error of the mean force, relative (RMS and 95 % of draws), and of each
coefficient the share of draws whose 95 % interval holds the true value. `published`: of measured slots (Kistler
readings that others published) the error of the mean force at each feed by coefficients from the other feeds, as a
share of the mean force; in all, and of the feeds between others.
"""

from __future__ import annotations

import argparse
import json

import numpy as np

from postproc.machining import identification
from postproc.machining.identification import NAMES
from postproc.machining.process import ToolTable
from tests.machining.test_identification import (
    PUBLISHED,
    PUBLISHED_FEEDS,
    SLOTS,
    TRUE,
    cut,
    identified,
    left_out_of_lines,
    of_published,
    predicted,
)

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
    out = {"draws": draws, "unseen": errors, "inside": share, "inside all": round(float(inside.mean()), 3)}
    print(json.dumps(out | {"published": published()}, indent=1))


def published() -> dict[str, object]:
    """Return errors of the published slots, each feed left out: by `identify`, and of each feed by straight lines."""
    found = identification.identify(of_published(), ToolTable(diameter_mm=25, flutes=2), None, "published.csv")
    off, size = (np.linalg.norm(of, axis=1) for of in (left_out_of_lines(), PUBLISHED))
    between = slice(1, -1)
    return {
        "left out, all feeds": round(found.left_out, 4),
        "left out, feeds between": round(float(np.linalg.norm(off[between]) / np.linalg.norm(size[between])), 4),
        "by feed per tooth": dict(zip(map(str, PUBLISHED_FEEDS), np.round(off / size, 3).tolist(), strict=True)),
        "fitted": dict(zip(NAMES, np.round(found.value, 1).tolist(), strict=True)),
    }


if __name__ == "__main__":
    main()
