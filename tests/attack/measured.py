"""How many faults of the reader of KRL the random programs find.

    python -m tests.attack.measured [--faults 40] [--programs 2000] [--seed 0]

Faults are planted into the modules that follow a program, one at a time, as mutation runs plant them. The random
programs of `tests.attack.krl`, of all kinds, are then tried until one of them shows the fault; only those that execute
the statement of the fault, which a first run without faults notes. A fault is *wrong* where a program is read or
written as the controller does not execute it, or ends in an internal error; it is *seen* where programs are refused
that were accepted, or the other way round. A fault that no program shows is *not found*, and *not executed* where no
program gets to its statement.

Modules that word messages, look for files, limit the cost, or report what the next run does are left out, and so is
what `tests.attack.krl` does not compare: circles, orientation control, and the poses at which branches meet.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

from tests.places import ROOT

READER = ROOT / "postproc" / "dialects" / "krl" / "read"
MODULES = [
    *("bas", "calls", "conditions", "data_lists", "effects", "flow", "frames", "interpreter", "known", "main_routine"),
    *("motion_reader", "path_settings", "plain_settings", "rounds", "run", "settings", "spline_blocks", "state"),
    *("tracing", "unresolved", "variables"),
]
KINDS = (
    *(0, 137_500_000, 1_000_000, 187_500_000, 100_000_000, 337_500_000, 125_000_000, 137_600_000, 150_000_000),
    *(387_500_000, 175_000_000, 187_600_000, 325_000_000, 137_700_000, 375_000_000),
)
"""First seeds of the kinds of programs, see `tests.attack.krl`: every other one is of few statements."""
SEEN = 10
"""After so many programs with another outcome a fault is seen."""


def seed_of(number):
    """Seed of a random program: programs of all kinds follow in turn."""
    return KINDS[number % len(KINDS)] + 20_000 + number // len(KINDS)


def _attack():
    """Return what tries a program, without the grammar, which sees no fault of the reader; and its exception."""
    from tests.attack import krl  # the fault may be in what this imports

    krl._CHECKED = (2**62, 2**62)
    return krl.attack, krl.Wrong


def outcomes(programs):
    """What each program comes to without a fault, and which programs execute each line of the reader.

    :returns: outcomes; ``"module:line"`` → numbers of programs.
    """
    attack, Wrong = _attack()
    lines, names = set(), {str(READER / f"{name}.py"): name for name in MODULES}
    executed = defaultdict(list)

    def entered(frame, event, _):
        name = names.get(frame.f_code.co_filename)
        if name is None:
            return None

        def line_reached(frame, event, _):
            lines.add((name, frame.f_lineno))
            return line_reached

        return line_reached

    results = []
    for number in range(programs):
        lines.clear()
        sys.settrace(entered)
        try:
            results.append(attack(seed_of(number)))
        except Wrong:
            results.append("wrong")
        finally:
            sys.settrace(None)
        for name, line in lines:
            executed[f"{name}:{line}"].append(number)
    return results, executed


def first_difference(numbers, usual):
    """Return outcome and number of the program that shows a fault; ``"not found"`` if none does.

    :param numbers: of the programs that execute its statement.
    :param usual: outcomes without a fault.
    """
    attack, Wrong = _attack()
    seen = []
    for number in numbers:
        if usual[number] == "wrong":
            continue
        try:
            outcome = attack(seed_of(number))
        except Wrong as cause:
            print(str(cause)[:300], file=sys.stderr)
            return "wrong", number
        if outcome != usual[number]:
            seen.append(number)
        if len(seen) == SEEN:
            break
    return ("seen", seen[0]) if seen else ("not found", -1)


def run(root, numbers, usual):
    """Return `first_difference` with the package in a folder; a run that does not end normally is wrong."""
    environment = os.environ | {"PYTHONPATH": str(root), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "tests.attack.measured", "--tried"]
    limit = 120 + len(numbers)  # a fault may make a loop that does not end
    try:
        done = subprocess.run(
            command,
            cwd=root,
            env=environment,
            input=json.dumps([numbers, usual]),
            capture_output=True,
            text=True,
            timeout=limit,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "wrong", -1
    return tuple(json.loads(done.stdout)) if done.returncode == 0 else ("wrong", -1)


def planted(seed, faults):
    """Faults drawn from those that can be planted."""
    from tests.mutation.mutants import compiles, mutants_of

    every = [mutant for name in MODULES for mutant in mutants_of(READER / f"{name}.py", ROOT)]
    every = [mutant for mutant in every if mutant.in_function]
    chosen = (every[index] for index in np.random.default_rng(seed).permutation(len(every)))
    compiling = (mutant for mutant in chosen if compiles(mutant.text((ROOT / mutant.file).read_bytes())))
    return list(itertools.islice(compiling, faults))


def programs_of(mutant, executed):
    """Return the numbers of the programs that execute the statement of a fault."""
    first, last = mutant.lines
    name = Path(mutant.file).stem
    return sorted({number for line in range(first, last + 1) for number in executed.get(f"{name}:{line}", ())})


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faults", type=int, default=40)
    parser.add_argument("--programs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tried", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.tried:
        print(json.dumps(first_difference(*json.load(sys.stdin))))
        return
    usual, executed = outcomes(arguments.programs)
    print(f"{arguments.programs} programs: " + ", ".join(f"{n} {what}" for what, n in Counter(usual).most_common()))
    counts = Counter()
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        for folder in ("postproc", "tests", "robot_models"):
            shutil.copytree(ROOT / folder, root / folder, ignore=shutil.ignore_patterns("__pycache__"))
        for mutant in planted(arguments.seed, arguments.faults):
            path = root / mutant.file
            source = path.read_bytes()
            path.write_bytes(mutant.text(source))
            numbers = programs_of(mutant, executed)
            outcome, number = run(root, numbers, usual) if numbers else ("not executed", -1)
            path.write_bytes(source)
            counts[outcome] += 1
            print(f"{outcome:12} {number:5} of {len(numbers):4} {mutant.file}:{mutant.line} {mutant.kind}: "
                  f"{mutant.before} → {mutant.after}", flush=True)  # fmt: skip
    print(f"{counts.total()} faults: " + ", ".join(f"{n} {what}" for what, n in counts.items()))


if __name__ == "__main__":
    main()
