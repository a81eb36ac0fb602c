"""Freeze a corpus, or compare with one; see `tests.frozen`."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from tests.frozen import case as cases
from tests.frozen.case import Case
from tests.frozen.comparing import Difference, differences
from tests.frozen.groups import GROUPS, QUICK
from tests.frozen.running import run

_CHUNK = 8


def _all_run(given: Iterable[Case], jobs: int) -> Iterator[Case]:
    """Yield cases with the outputs of this version, in order."""
    with multiprocessing.get_context("spawn").Pool(jobs, maxtasksperchild=2000) as pool:
        yield from pool.imap(run, given, _CHUNK)


def _chosen(path: Path, *, quick: bool, limit: int | None) -> list[str]:
    """Return the names of cases that are run, spread evenly over a group."""
    found = cases.names(path)
    most = limit if limit is not None else QUICK.get(path.stem, 12) if quick else len(found)
    return found if len(found) <= most else [found[n * len(found) // most] for n in range(most)]


def _compare(path: Path, wanted: list[str], jobs: int) -> list[Difference]:
    before = cases.read(path, wanted)
    after = _all_run(cases.read(path, wanted), jobs)
    return [found for a, b in zip(before, after, strict=True) for found in differences(a.name, a.outputs, b.outputs)]


def main() -> int:
    """Run the command; return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.frozen", description=__doc__)
    parser.add_argument("work", choices=["freeze", "compare", "renew"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", metavar="GROUP", help="words in names of groups", default=[""])
    parser.add_argument("--seeds", type=int, default=100, help="of each generator")
    parser.add_argument("--quick", action="store_true", help="a share of each group, about a minute in all")
    parser.add_argument("--cases", type=int, help="of each group, spread evenly")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--show", type=int, default=5, help="differences shown of each kind and group")
    given = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    given.folder.mkdir(parents=True, exist_ok=True)
    total: Counter[str] = Counter()
    count = 0
    for group in [name for name in GROUPS if any(word in name for word in given.only)]:
        path, begin = given.folder / f"{group}.zip", time.monotonic()
        if given.work == "freeze":
            done = cases.write(path, _all_run(GROUPS[group](given.seeds), given.jobs))
        elif not path.exists():
            continue
        elif given.work == "renew":
            done = cases.write(path, _all_run(cases.read(path, cases.names(path)), given.jobs))
        else:
            wanted = _chosen(path, quick=given.quick, limit=given.cases)
            found = _compare(path, wanted, given.jobs)
            done = len(wanted)
            kinds = Counter(one.kind for one in found)
            total += kinds
            for kind in kinds:
                for one in [one for one in found if one.kind == kind][: given.show]:
                    print(f"{group}/{one.case} {one.output}: {one.what}")
        count += done
        print(f"{group}: {done} cases, {time.monotonic() - begin:.0f} s", flush=True)
    if given.work == "compare":
        print(f"{count} cases: " + (", ".join(f"{n} {kind}" for kind, n in total.items()) or "nothing") + " differ")
    return 1 if total else 0


if __name__ == "__main__":
    raise SystemExit(main())
