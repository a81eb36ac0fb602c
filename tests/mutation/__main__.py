"""Mutation run of a package: ``python -m tests.mutation PACKAGE``."""

from __future__ import annotations

import argparse
import functools
import json
import sys
import time
from collections import Counter

from tests.mutation.run import MutationError, accepted, run, sources_and_tests
from tests.places import ROOT

LEFT = ("survived", "unseen")


def main() -> int:
    """Print the survivors by line, and how many of all were killed; 1 if one survived."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("package", help="package or module below postproc: elastostatics, elastostatics.springs")
    parser.add_argument("--seed", type=int, default=1, help="which mutants are taken (default 1)")
    parser.add_argument("--most", type=int, help="how many are taken at most (default: all)")
    parser.add_argument(
        "--again", action="store_true", help="only those that survived the last run of this package with this seed"
    )
    parser.add_argument("--minutes", type=float, default=60.0, help="after these no further one is run (default 60)")
    parser.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    options = parser.parse_args()
    start = time.monotonic()

    def say(text: str) -> None:
        print(text, end="" if len(text) == 1 else "\n", flush=True)

    kept = ROOT / ".mutation" / f"{options.package}-{options.seed}.json"
    try:
        files, tests = sources_and_tests(options.package, ROOT)
        before = json.loads(kept.read_text()) if options.again else []
        found = run(
            ROOT, files, tests, seed=options.seed, most=options.most, workers=options.workers, say=say,
            minutes=options.minutes,
            again=[one[:3] for one in before if one[3] in LEFT] if options.again else None,
            equal=functools.partial(accepted, ROOT),
        )  # fmt: skip
    except FileNotFoundError:
        print(f"no run of {options.package} with seed {options.seed}: run it without --again first", file=sys.stderr)
        return 2
    except MutationError as error:
        print(error, file=sys.stderr)
        return 2
    left = [one for one in found if one.outcome in LEFT]
    print("\n\nSurvivors:" if left else "\n")
    for one in left:
        unseen = "  (no test executes it)" if one.outcome == "unseen" else ""
        print(f"{one.mutant.file}:{one.mutant.line}: {one.mutant.kind}{unseen}")
        print(f"  - {one.mutant.before}\n  + {one.mutant.after}")
    rows = [[one.mutant.file, one.mutant.before, one.mutant.after, one.outcome] for one in found]
    if options.again:
        now = {tuple(row[:3]): row[3] for row in rows}
        rows = [[*row[:3], now.get(tuple(row[:3]), "gone") if row[3] in LEFT else row[3], *row[4:]] for row in before]
    else:
        rows = [[*row, row[3]] for row in rows]
    kept.write_text(json.dumps(rows))
    first, last = (Counter(row[column] for row in rows) for column in (4, 3))
    print(f"{last['time']} killed by the time limit; {time.monotonic() - start:.0f} s")
    print("Package, seed, mutants, killed in the first run [%], in the last [%], equal in effect:")
    shares = f"{_killed(first)} | {_killed(last)} | {last['accepted']}"
    print(f"| {options.package} | {options.seed} | {len(rows)} | {shares} |")
    return 1 if left else 0


def _killed(counts: Counter[str]) -> str:
    """Return the share of the mutants that are neither equal in effect nor gone with their line [%]."""
    counted = counts.total() - counts["accepted"] - counts["gone"]
    return f"{100.0 * (counted - sum(counts[name] for name in LEFT)) / max(counted, 1):.1f}"


if __name__ == "__main__":
    sys.exit(main())
