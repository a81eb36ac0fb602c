"""A mutation run: which mutants the tests of a package see."""

from __future__ import annotations

import itertools
import json
import os
import queue
import random
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tests.mutation.mutants import Mutant, compiles, mutants_of

IGNORED = shutil.ignore_patterns(
    ".*", "*.egg-info", "build", "dist", "corrected", "out", "tests-out"
)  # what git ignores too


class Found(NamedTuple):
    """What became of a mutant.

    :param outcome: "killed", "time" (killed by the time limit), "survived", "unseen" (no test executes the line) or
        "accepted" (listed as equal in effect).
    """

    mutant: Mutant
    outcome: str
    seconds: float


class MutationError(Exception):
    """The run can say nothing, and why."""


def sources_and_tests(package: str, root: Path) -> tuple[list[Path], list[str]]:
    """Return the source files of a package or module (``elastostatics``, ``elastostatics.springs``) and its tests.

    :raises MutationError: there is no such package, or no tests are listed for it.
    """
    place = root / "postproc" / package.replace(".", "/")
    files = sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]
    if not files or not files[0].exists():
        raise MutationError(f"no package or module postproc.{package}")
    listed = tomllib.loads((root / "tests/mutation/packages.toml").read_text())
    try:
        return files, listed[package.split(".")[0]]
    except KeyError:
        raise MutationError(
            f"tests/mutation/packages.toml names no tests for {package.split('.')[0]}: add a line there"
        ) from None


def accepted(root: Path, mutants: Sequence[Mutant]) -> set[Mutant]:
    """Return which mutants are listed in accepted.toml.

    :raises MutationError: an entry of the files of these mutants is of none of them, or has no reason.
    """
    listed = tomllib.loads((root / "tests/mutation/accepted.toml").read_text()).get("mutant", [])
    files, found, stale = {m.file for m in mutants}, set(), []
    for entry in listed:
        wanted = [entry["mutation"]] if isinstance(entry["mutation"], str) else entry["mutation"]
        if entry["file"] not in files:  # of another package
            if not (root / entry["file"]).exists():
                stale.append(entry)
            continue
        of_line = [m for m in mutants if (m.file, m.before) == (entry["file"], entry["line"])]
        if not entry["reason"].strip() or not set(wanted) <= {m.after for m in of_line}:
            stale.append(entry)
        found |= {m for m in of_line if m.after in wanted}
    if stale:
        lines = "\n".join(f"  {entry['file']}: {entry['line']}  =>  {entry['mutation']}" for entry in stale)
        raise MutationError(f"accepted.toml lists what no longer is a mutant; remove or renew it:\n{lines}")
    return found


def run(
    root: Path,
    files: Sequence[Path],
    tests: Sequence[str],
    *,
    seed: int = 1,
    most: int | None = None,
    workers: int = 2,
    equal: Callable[[list[Mutant]], set[Mutant]] = lambda _: set(),
    say: Callable[[str], None] = lambda _: None,
) -> list[Found]:
    """Plant mutants one by one and run the tests that execute them, until one fails.

    :param root: of the repository; it is copied, and stays as it is.
    :param most: how many mutants of all are taken, by chance; the same for the same seed.
    :param equal: returns the mutants that are accepted: they are not run.
    :returns: one row for each mutant taken, in the order of the text.
    :raises MutationError: tests fail without a fault.
    """
    every = [mutant for path in files for mutant in mutants_of(path, root)]
    taken = chosen(root, every, seed, most)
    spared = equal(every)
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        copies = [Path(folder, str(number)) for number in range(workers)]
        for copy in copies:
            shutil.copytree(root, copy, ignore=IGNORED)
        say(f"{len(taken)} of {len(every)} mutants; tests without a fault …")
        start = time.monotonic()
        recorded = _record(copies[0], [path.relative_to(root).as_posix() for path in files], tests)
        say(f"{len(recorded['tests'])} tests, {time.monotonic() - start:.0f} s")
        for copy in copies[1:]:  # with what was compiled
            shutil.rmtree(copy)
            shutil.copytree(copies[0], copy)
        waiting: queue.SimpleQueue[Mutant] = queue.SimpleQueue()
        for mutant in taken:
            if mutant not in spared:
                waiting.put(mutant)
        found = [Found(mutant, "accepted", 0.0) for mutant in taken if mutant in spared]
        failures: list[BaseException] = []

        def work(copy: Path) -> None:
            try:
                _work(
                    copy, recorded, waiting, lambda one: (found.append(one), say(_line_of(one, len(found), len(taken))))
                )
            except BaseException as error:
                failures.append(error)

        threads = [threading.Thread(target=work, args=(copy,)) for copy in copies]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if failures:
            raise failures[0]
    return sorted(found, key=lambda one: taken.index(one.mutant))


def chosen(root: Path, mutants: Sequence[Mutant], seed: int, most: int | None) -> list[Mutant]:
    """Return at most so many of the mutants that compile, the same ones for the same seed, in the order of the text."""
    places = random.Random(seed).sample(range(len(mutants)), len(mutants))
    compiling = (place for place in places if compiles(mutants[place].text((root / mutants[place].file).read_bytes())))
    return [mutants[place] for place in sorted(itertools.islice(compiling, most))]


def _line_of(one: Found, number: int, count: int) -> str:
    sign = {"killed": ".", "time": "t", "accepted": "="}.get(one.outcome)
    place = f"{one.mutant.file}:{one.mutant.line}"
    return sign or f"[{number}/{count}] {one.outcome} {place}: {one.mutant.before}  =>  {one.mutant.after}"


def _environment(copy: Path) -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(copy), "OMP_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}


def _record(copy: Path, files: Sequence[str], tests: Sequence[str]) -> dict[str, Any]:
    out = copy.parent / "recorded.json"
    done = subprocess.run(
        [sys.executable, "-m", "tests.mutation.recording", str(out), str(len(files)), *files, *tests],
        cwd=copy, env=_environment(copy), stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
    )  # fmt: skip
    recorded = json.loads(out.read_text()) if out.exists() else {"code": 1, "failed": []}
    if recorded["code"] != 0:
        raise MutationError(
            f"the tests fail without a fault: {recorded['failed']}\n{done.stdout[-3000:]}{done.stderr[-2000:]}"
        )
    return recorded


def _work(copy: Path, recorded: dict, waiting: queue.SimpleQueue[Mutant], tell: Callable[[Found], object]) -> None:
    """Take mutants until none is left."""
    log = copy.parent / f"{copy.name}.log"
    with subprocess.Popen(
        [sys.executable, "-m", "tests.mutation.worker"], cwd=copy, env=_environment(copy), text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    ) as process:  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(recorded["imported"]) + "\n")
        while True:
            try:
                mutant = waiting.get_nowait()
            except queue.Empty:
                break
            names = concerned(mutant, recorded["tests"])
            if not names:
                tell(Found(mutant, "unseen", 0.0))
                continue
            source = (copy / mutant.file).read_bytes()
            for compiled in (copy / mutant.file).parent.glob(f"__pycache__/{Path(mutant.file).stem}.*"):
                compiled.unlink()
            seconds = {name: recorded["tests"][name]["seconds"] for name in names}
            request = {
                "file": mutant.file, "text": mutant.text(source).decode(), "batches": batches(seconds),
                "seconds": seconds, "log": str(log),
            }  # fmt: skip
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
            answer = process.stdout.readline()
            if not answer:
                raise MutationError("a worker process ended")
            told = json.loads(answer)
            if told.get("code", 1) not in (0, 1) and not re.search(
                "ERROR collecting|while loading conftest", log.read_text()
            ):
                raise MutationError(f"pytest ended with {told['code']}: {log.read_text()[-3000:]}")
            tell(Found(mutant, told["outcome"], told["seconds"]))
        process.stdin.close()


def concerned(mutant: Mutant, tests: dict[str, dict]) -> list[str]:
    """Return the tests that execute the statement; all that execute any of its file if it is executed at import."""
    first, last = mutant.lines
    return [
        name for name, test in tests.items()
        if any(not mutant.in_function or first <= line <= last for line in test["lines"].get(mutant.file, ()))
    ]  # fmt: skip


def batches(seconds: dict[str, float]) -> list[list[str]]:
    """Return the tests as calls of pytest, quick ones first; a call has tests of one file, which share fixtures."""
    groups: dict[tuple[int, str], list[str]] = defaultdict(list)
    for name, took in sorted(seconds.items(), key=lambda item: item[1]):
        groups[sum(took > limit for limit in (0.3, 3.0)), name.split("::")[0]].append(name)
    ordered = sorted(groups.items(), key=lambda item: (item[0][0], sum(seconds[name] for name in item[1])))
    return [names for _, names in ordered]
