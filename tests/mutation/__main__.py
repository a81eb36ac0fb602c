"""Mutation run of a package: ``python -m tests.mutation PACKAGE``."""

from __future__ import annotations

import argparse
import functools
import sys
import time
from collections import Counter
from pathlib import Path

from tests.mutation.run import MutationError, accepted, run, sources_and_tests

ROOT = Path(__file__).parents[2]


def main() -> int:
    """Print the survivors by line, and how many of all were killed; 1 if one survived."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("package", help="package or module below postproc: elastostatics, elastostatics.springs")
    parser.add_argument("--seed", type=int, default=1, help="which mutants are taken (default 1)")
    parser.add_argument("--most", type=int, help="how many are taken at most (default: all)")
    parser.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    options = parser.parse_args()
    start = time.monotonic()

    def say(text: str) -> None:
        print(text, end="" if len(text) == 1 else "\n", flush=True)

    try:
        files, tests = sources_and_tests(options.package, ROOT)
        found = run(
            ROOT, files, tests, seed=options.seed, most=options.most, workers=options.workers,
            equal=functools.partial(accepted, ROOT), say=say,
        )  # fmt: skip
    except MutationError as error:
        print(error, file=sys.stderr)
        return 2
    left = [one for one in found if one.outcome in ("survived", "unseen")]
    print("\n\nSurvivors:" if left else "\n")
    for one in left:
        unseen = "  (no test executes it)" if one.outcome == "unseen" else ""
        print(f"{one.mutant.file}:{one.mutant.line}: {one.mutant.kind}{unseen}")
        print(f"  - {one.mutant.before}\n  + {one.mutant.after}")
    counts = Counter(one.outcome for one in found)
    counted = len(found) - counts["accepted"]
    print(
        f"{options.package}, seed {options.seed}: {counted - len(left)} of {counted} killed"
        f" ({100.0 * (counted - len(left)) / max(counted, 1):.1f} %), {counts['time']} of them by the time limit;"
        f" {counts['accepted']} equal in effect. {time.monotonic() - start:.0f} s"
    )
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
