"""The loop of all random attacks: one seed after another, and a count of what came of them.

`python -m tests.attack.NAME --minutes 60 [--seed 0]` tries seeds for an hour. With `--count` they are the same on every
machine, however fast it is.
"""

from __future__ import annotations

import argparse
import gc
import time
import traceback
from collections import Counter
from collections.abc import Callable
from itertools import count


class Wrong(AssertionError):
    """The package does not do what the oracle does."""


def parser(description: str | None) -> argparse.ArgumentParser:
    """Return a parser with the options that all attacks have."""
    options = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    options.add_argument("--minutes", type=float, default=1.0)
    options.add_argument("--count", type=int, help="try so many seeds instead")
    options.add_argument("--seed", type=int, default=0, help="the first one")
    options.add_argument("--keep-going", action="store_true", help="count what is wrong instead of ending")
    return options


def try_seeds(options: argparse.Namespace, *attacks: Callable[[int], str]) -> int:
    """Try seeds, print those that are wrong, and count the outcomes; return the exit code, 1 if any was wrong.

    :param options: see `parser`.
    :param attacks: seed → what came of it in some words; an exception, `Wrong` or another, is a fault of the package.
    """
    gc.freeze()  # what was imported stays
    outcomes: Counter[str] = Counter()
    start, process_start = time.monotonic(), time.process_time()
    seed = options.seed
    try:
        for seed in count(options.seed):
            has_time = time.monotonic() - start < 60.0 * options.minutes
            if not has_time if options.count is None else seed - options.seed >= options.count:
                break
            for attack in attacks:
                outcomes[_outcome(attack, seed, has_name=len(attacks) > 1)] += 1
            if outcomes["WRONG"] and not options.keep_going:
                break
    except KeyboardInterrupt:
        pass
    processor_time = 1e3 * (time.process_time() - process_start) / max(outcomes.total(), 1)
    print(f"seeds {options.seed} to {seed - 1}, {processor_time:.1f} ms of processor time each")
    for outcome, number in outcomes.most_common():
        print(f"{number:8} {outcome}")
    return int(outcomes["WRONG"] > 0)


def _outcome(attack: Callable[[int], str], seed: int, *, has_name: bool) -> str:
    """Return what came of a seed, `WRONG` for an exception, which is printed."""
    name = getattr(attack, "__name__", "attack")
    try:
        return f"{name}: {attack(seed)}" if has_name else attack(seed)
    except Wrong as cause:
        print(f"--- {name}, seed {seed}: {cause}", flush=True)
    except Exception:
        print(f"--- {name}, seed {seed}: {traceback.format_exc()}", flush=True)
    return "WRONG"
