"""Rounds of random loops that are taken or computed at once, against the same rounds one by one.

Run: python -m tests.benchmarks.krl_rounds [PROGRAMS] [--from SEED]

Half of the loops move to points of arrays, half compute their points from the counter; the generators are those of
`tests.dialects.test_krl_plain_rounds` and `tests.dialects.test_krl_computed_rounds`. Each program is read and written
three times: as it is, with rounds that are not taken at once, and with bodies that are not recognised. Prints the seed
of each program that differs, and how many there are.
"""

from __future__ import annotations

import argparse
from types import ModuleType
from unittest.mock import patch

from postproc.dialects.krl.read import flow
from tests.dialects import test_krl_computed_rounds as computed
from tests.dialects import test_krl_plain_rounds as plain


def differs(case: tuple, places: tuple[tuple[ModuleType, str], ...]) -> bool:
    """Return whether a program (lines, points, cell) has another outcome with its rounds one by one."""
    at_once = plain.outcome(*case)
    for place, name in places:
        with patch.object(place, name, lambda *_: None):
            if plain.outcome(*case) != at_once:
                return True
    return False


def main() -> None:
    """Print the seeds of programs that differ."""
    parser = argparse.ArgumentParser(description="Do rounds of loops mean at once what they mean one by one?")
    parser.add_argument("programs", nargs="?", type=int, default=500, help="number of programs of each kind")
    parser.add_argument("--from", dest="first", type=int, default=0, metavar="SEED", help="first seed")
    options = parser.parse_args()
    count = 0
    for seed in range(options.first, options.first + options.programs):
        kinds = {"plain": differs(plain.random_case(seed), plain.ONE_BY_ONE)}
        with patch.object(flow, "FEWEST_ROUNDS", 1):
            kinds["computed"] = differs(computed.random_case(seed), computed.ONE_BY_ONE)
        for kind, is_different in kinds.items():
            if is_different:
                print(f"{kind} {seed} differs", flush=True)
                count += 1
    print(f"{count} of {2 * options.programs} differ")


if __name__ == "__main__":
    main()
