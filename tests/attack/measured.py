"""How many faults of the reader of KRL the random programs find.

    python -m tests.attack.measured [--faults 40] [--programs 2000] [--seed 0]

Faults are planted into the modules that follow a program, one at a time, as mutation runs plant them. The random
programs of `tests.attack.krl`, of all kinds, are then tried until one of them shows the fault. A fault is *wrong* where
a program is read or written as the controller does not execute it, or ends in an internal error; it is *seen* where
programs are refused that were accepted, or the other way round. A fault that no program shows is listed.

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
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
READER = ROOT / "postproc" / "dialects" / "krl" / "read"
MODULES = [
    *("bas", "calls", "conditions", "data_lists", "effects", "flow", "frames", "interpreter", "known", "main_routine"),
    *("motion_reader", "path_settings", "plain_settings", "rounds", "run", "settings", "spline_blocks", "state"),
    *("tracing", "unresolved", "variables"),
]
KINDS = (0, 1_000_000, 100_000_000, 125_000_000, 150_000_000, 175_000_000, 325_000_000, 375_000_000)
"""First seeds of the kinds of programs, see `tests.attack.krl`."""


def seeds(programs):
    """Seeds of random programs, of all kinds in turn."""
    return [KINDS[number % len(KINDS)] + 20_000 + number // len(KINDS) for number in range(programs)]


def outcomes(programs, usual=None):
    """What each random program comes to; up to the first that is wrong.

    :param usual: what they come to without a fault.
    """
    from tests.attack.krl import Wrong, attack  # the fault may be in what this imports

    found = []
    for number, seed in enumerate(seeds(programs)):
        try:
            found.append(attack(seed))
        except Wrong as cause:
            found.append("wrong")
            if usual is not None and usual[number] != "wrong":
                print(str(cause)[:300], file=sys.stderr)
                break
    return found


def run(root, programs, usual=None):
    """What the programs come to with the package in a folder; None if it ended otherwise."""
    environment = os.environ | {"PYTHONPATH": str(root), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "tests.attack.measured", "--programs", str(programs), "--outcomes"]
    limit = 60 + programs  # a fault may make a loop that does not end
    try:
        done = subprocess.run(
            command,
            cwd=root,
            env=environment,
            input=json.dumps(usual),
            capture_output=True,
            text=True,
            timeout=limit,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None
    return json.loads(done.stdout) if done.returncode == 0 else None


def planted(seed, faults):
    """Faults drawn from those that can be planted."""
    from tests.mutation.mutants import compiles, mutants_of

    every = [mutant for name in MODULES for mutant in mutants_of(READER / f"{name}.py", ROOT)]
    every = [mutant for mutant in every if mutant.in_function]
    chosen = (every[index] for index in np.random.default_rng(seed).permutation(len(every)))
    compiling = (mutant for mutant in chosen if compiles(mutant.text((ROOT / mutant.file).read_bytes())))
    return list(itertools.islice(compiling, faults))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faults", type=int, default=40)
    parser.add_argument("--programs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--outcomes", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.outcomes:
        print(json.dumps(outcomes(arguments.programs, json.load(sys.stdin))))
        return
    counts = {"wrong": 0, "seen": 0, "not found": 0}
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        for folder in ("postproc", "tests", "robot_models"):
            shutil.copytree(ROOT / folder, root / folder, ignore=shutil.ignore_patterns("__pycache__"))
        usual = run(root, arguments.programs)
        for mutant in planted(arguments.seed, arguments.faults):
            path = root / mutant.file
            source = path.read_bytes()
            path.write_bytes(mutant.text(source))
            found = run(root, arguments.programs, usual)
            path.write_bytes(source)
            if found is None or (found[-1] == "wrong" and len(found) < len(usual)):
                outcome, after = "wrong", 0 if found is None else len(found)
            else:
                other = [number for number, (a, b) in enumerate(zip(found, usual, strict=False)) if a != b]
                outcome, after = ("seen", other[0] + 1) if other else ("not found", 0)
            counts[outcome] += 1
            print(f"{outcome:10} {after:5} {mutant.file}:{mutant.line} {mutant.kind}: {mutant.before} → {mutant.after}",
                  flush=True)  # fmt: skip
    total = sum(counts.values())
    print(f"{total} faults, {arguments.programs} programs: " + ", ".join(f"{n} {what}" for what, n in counts.items()))


if __name__ == "__main__":
    main()
