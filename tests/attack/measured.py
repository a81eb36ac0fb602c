"""How many faults of the reader of KRL the random programs find.

    python -m tests.attack.measured [--faults 40] [--programs 600] [--seed 0]

Faults are planted into the modules that follow a program, one at a time, as mutation runs plant them, and random
programs of all kinds are read (`tests.attack.krl`). A program that is read otherwise than without the fault is tried
against the controller, until one shows it. A fault is

- *wrong*: a program is read or written as the controller does not execute it, or ends in an internal error;
- *seen*: programs are refused that were accepted, or the other way round;
- *a message*: a refusal or a warning has another text, and no program differs otherwise;
- *not found*: the programs that differ, if any, are read and written as the controller executes them;
- *not executed*: no program gets to the statement.

Modules that word messages, look for files, limit the cost, or report what the next run does are left out, and so are
statements of other modules that only count what has run (`LIMITS`). `tests.attack.krl` does not compare circles,
orientation control, force comments, and the poses at which branches meet: faults there are judged by other tests.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import io
import itertools
import multiprocessing
import pickle
import re
import resource
import signal
import sys
import tempfile
import types
from collections import Counter, defaultdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from postproc.dialects.krl.language.routines import Routine
from postproc.errors import Issue, PostprocError
from tests.attack import krl
from tests.mutation.mutants import compiles, mutants_of
from tests.places import ROOT

READER = ROOT / "postproc" / "dialects" / "krl" / "read"
MODULES = [
    *(
        "bas",
        "calls",
        "conditions",
        "counter",
        "data_lists",
        "effects",
        "flow",
        "frames",
        "interpreter",
        "known",
        "main_routine",
    ),
    *("motion_reader", "path_settings", "plain_settings", "rounds", "run", "settings", "spline_blocks", "state"),
    *("tracing", "unresolved", "variables"),
]
LIMITS = re.compile(
    r"\b_?MOST_(?!SETTINGS)|\b_count\(|\b_check_least\(|\b_least\.writes\(|\b_traced \+= |\+ minimum >|\.steps \+="
)
"""Statements that limit how much is followed: a fault there changes how long a program may be, not what it does."""
SEEN, MOST = 10, 60
"""A fault is seen after so many programs with another outcome; after so many that differ no more are tried."""
SECONDS, MEMORY = 5.0, 6 << 30
"""A reading that takes more processor time, or more bytes, does not end."""


class Reading(NamedTuple):
    """What a program is read as: a digest of all that is kept of it but texts for the user, and these texts."""

    digest: str
    texts: str


class Endless(BaseException):
    """A program was not read within `SECONDS`."""


def seed_of(number):
    """Seed of a random program: programs of all kinds follow in turn."""
    return krl.seed_in_turn(number) + 20_000


def reading(seed):
    """`Reading` of the program of a seed; an internal error is a message too."""
    files = krl.files_of(seed, np.random.default_rng(seed))
    with krl.limited(), tempfile.TemporaryDirectory(dir=krl._MEMORY) as name:
        try:
            program = krl.read_job(files, Path(name), keep=seed >= krl.KEPT, initmov=krl.initmov_of(seed))
        except PostprocError as error:
            return Reading("refused", str(error).replace(name, ""))
        except Exception as error:
            return Reading("error", repr(error))
    texts = [program.issues, program.unresolved]
    program = replace(
        program,
        issues=tuple(Issue(issue.level, issue.kind, "", _checked_line(issue)) for issue in program.issues),
        unresolved=tuple(replace(motion, why="") for motion in program.unresolved),
    )
    digest = hashlib.sha256(_pickled(program).replace(name.encode(), b"")).hexdigest()
    return Reading(digest, str(texts).replace(name, ""))


class _Pickler(pickle.Pickler):
    """Pickles sets in an order that does not depend on where their elements are in memory."""

    def persistent_id(self, item):
        """Return what a set holds; None for anything else."""
        if not isinstance(item, set | frozenset):
            return None
        return sorted(f"{one.name}:{one.first}" if isinstance(one, Routine) else repr(one) for one in item)


def _pickled(program):
    """Return the bytes of all that is kept of a program."""
    buffer = io.BytesIO()
    _Pickler(buffer).dump(program)
    return buffer.getvalue()


def _checked_line(issue):
    """Line of an issue if `tests.attack.krl` asks for it; what other issues say is text."""
    return issue.source_line if issue.kind == "motions-elsewhere" else None


def executed_lines(seeds):
    """``"module:line"`` of the reader → numbers of the programs that execute it."""
    names = {str(READER / f"{name}.py"): name for name in MODULES}
    executed, lines = defaultdict(list), set()

    def entered(frame, event, _):
        name = names.get(frame.f_code.co_filename)
        if name is None:
            return None

        def line_reached(frame, event, _):
            lines.add((name, frame.f_lineno))
            return line_reached

        return line_reached

    for number, seed in enumerate(seeds):
        lines.clear()
        sys.settrace(entered)
        try:
            reading(seed)
        finally:
            sys.settrace(None)
        for name, line in lines:
            executed[f"{name}:{line}"].append(number)
    return executed


def outcome_of(seed):
    """What `tests.attack.krl` says of a program; the reason where it is wrong."""
    try:
        return krl.attack(seed), ""
    except krl.Wrong as cause:
        return "wrong", str(cause)


def plant(mutant):
    """Replace the code of the functions of a module, wherever they are used, by that of the file with a fault.

    :raises ValueError: a function would use other variables of the functions around it.
    """
    path = ROOT / mutant.file
    faulty = compile(mutant.text(path.read_bytes()), str(path), "exec", dont_inherit=True)
    codes, waiting = {}, [faulty]
    while waiting:
        code = waiting.pop()
        codes[code.co_qualname, code.co_firstlineno] = code
        waiting += [inner for inner in code.co_consts if isinstance(inner, types.CodeType)]
    gc.unfreeze()  # pytest freezes what it has collected, and `gc.get_objects` leaves that out
    objects = gc.get_objects()
    for function in objects:
        if isinstance(function, types.FunctionType) and function.__code__.co_filename == str(path):
            place = function.__code__.co_qualname, function.__code__.co_firstlineno
            function.__code__ = codes.get(place, function.__code__)
    for cached in objects:
        if type(cached).__name__ == "_lru_cache_wrapper":
            cached.cache_clear()


def judged(mutant, numbers, usual):
    """Outcome of a fault, number of a program that shows it (-1: none), how many are read otherwise, and why.

    :param numbers: of the programs that execute its statement.
    :param usual: `Reading` and outcome of each program without a fault.
    """
    plant(mutant)
    different, worded, seen = 0, -1, []
    for number in numbers:
        seed = seed_of(number)
        signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS)
        try:
            text = reading(seed)
            if text == usual[number][0] or usual[number][1] == "wrong":
                continue
            if text.digest == usual[number][0].digest:
                worded = number
                continue
            different += 1
            outcome, reason = outcome_of(seed)
        except (Endless, MemoryError) as error:
            return "wrong", number, different, repr(error)
        finally:
            signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        if outcome == "wrong":
            return "wrong", number, different, reason
        if outcome != usual[number][1]:
            seen.append(number)
        if len(seen) == SEEN or different == MOST:
            break
    if seen:
        return "seen", seen[0], different, ""
    if worded >= 0 and not different:
        return "a message", worded, 0, ""
    return "not found", -1, different, ""


def _judge(connection, *arguments):
    """Send what `judged` returns; to be run in a process of its own, since the fault stays planted."""

    def ended(*_):
        raise Endless

    signal.signal(signal.SIGVTALRM, ended)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    try:
        connection.send(judged(*arguments))
    except ValueError as error:
        connection.send(("not planted", -1, 0, str(error)))
    except RecursionError as error:
        connection.send(("wrong", -1, 0, repr(error)))


def judgement(mutant, numbers, usual):
    """Return `judged` of a fault, from a copy of this process."""
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_judge, args=(sender, mutant, numbers, usual))
    process.start()
    sender.close()
    try:
        return receiver.recv()
    except EOFError:
        return "wrong", -1, 0, "the process ended"
    finally:
        process.join()


def planted(seed, faults):
    """Faults drawn from those that can be planted."""
    every = [mutant for name in MODULES for mutant in mutants_of(READER / f"{name}.py", ROOT)]
    every = [mutant for mutant in every if mutant.in_function and not LIMITS.search(mutant.before)]
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
    parser.add_argument("--programs", type=int, default=600)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reasons", action="store_true", help="print why a program is wrong, with its files")
    arguments = parser.parse_args()
    krl._CHECKED = (2**62, 2**62)  # the grammar sees no fault of the reader
    seeds = [seed_of(number) for number in range(arguments.programs)]
    usual = [(reading(seed), outcome_of(seed)[0]) for seed in seeds]
    executed = executed_lines(seeds)
    outcomes = Counter(outcome for _, outcome in usual)
    print(f"{len(seeds)} programs: " + ", ".join(f"{n} {outcome}" for outcome, n in outcomes.most_common()), flush=True)
    counts = Counter()
    for mutant in planted(arguments.seed, arguments.faults):
        numbers = programs_of(mutant, executed)
        outcome, number, different, reason = (
            judgement(mutant, numbers, usual) if numbers else ("not executed", -1, 0, "")
        )
        counts[outcome] += 1
        print(f"{outcome:12} {number:4} of {len(numbers):4}, {different:2} differ: {mutant.file}:{mutant.line} "
              f"{mutant.kind}: {mutant.before} → {mutant.after}", flush=True)  # fmt: skip
        if arguments.reasons and reason:
            print(reason)
    print(f"{counts.total()} faults: " + ", ".join(f"{n} {outcome}" for outcome, n in counts.items()))


if __name__ == "__main__":
    main()
