"""A mutation run: which mutants the tests of a package see."""

from __future__ import annotations

import hashlib
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


_MOST_SECONDS = 30.0
"""Processor time of the tests of one mutant [s]."""


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
    names = package.split(".")
    for count in range(len(names), 0, -1):
        if tests := listed.get(".".join(names[:count])):
            return files, tests
    raise MutationError(f"tests/mutation/packages.toml names no tests for {names[0]}: add a line there")


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
    again: Sequence[Sequence[str]] | None = None,
    workers: int = 2,
    minutes: float = 60.0,
    equal: Callable[[list[Mutant]], set[Mutant]] = lambda _: set(),
    say: Callable[[str], None] = lambda _: None,
) -> list[Found]:
    """Plant mutants one by one and run the tests that execute them, until one fails.

    :param root: of the repository; it is copied, and stays as it is.
    :param most: how many mutants of all are taken, by chance; the same for the same seed.
    :param again: mutants to take instead, by file, line before and line after.
    :param minutes: after these no further mutant is run: those that were are a random sample of the ones taken.
    :param equal: returns the mutants that are accepted: they are not run.
    :returns: one row for each mutant taken, in the order of the text.
    :raises MutationError: tests fail without a fault.
    """
    every = [mutant for path in files for mutant in mutants_of(path, root)]
    if again is None:
        taken = chosen(root, every, seed, most)
    else:
        taken = [
            mutant for mutant in every if [mutant.file, mutant.before, mutant.after] in [list(one) for one in again]
        ]
    spared = equal(every)
    found = [Found(mutant, "accepted", 0.0) for mutant in taken if mutant in spared]
    if len(found) == len(taken):
        return found
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        copies = [Path(folder, str(number)) for number in range(workers)]
        for copy in copies:
            shutil.copytree(root, copy, ignore=IGNORED)
        say(f"{len(taken)} of {len(every)} mutants; tests without a fault …")
        start = time.monotonic()
        recorded = _record(root, copies, [path.relative_to(root).as_posix() for path in files], tests)
        say(f"{len(recorded['tests'])} tests, {time.monotonic() - start:.0f} s")
        waiting: queue.SimpleQueue[Mutant] = queue.SimpleQueue()
        for mutant in random.Random(seed).sample(taken, len(taken)):
            if mutant not in spared:
                waiting.put(mutant)
        end = time.monotonic() + 60.0 * minutes
        failures: list[BaseException] = []

        def work(copy: Path) -> None:
            try:
                _work(
                    copy, recorded, waiting, end,
                    lambda one: (found.append(one), say(_line_of(one, len(found), len(taken)))),
                )  # fmt: skip
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
    """Return the environment of a process in a copy; it keeps what it has compiled, or each mutant would compile all.

    The time for that would count as time of the test.
    """
    return os.environ | {
        "PYTHONPATH": str(copy), "OMP_NUM_THREADS": "1", "PYTHONHASHSEED": "0", "PYTHONDONTWRITEBYTECODE": "",
    }  # fmt: skip


def _record(root: Path, copies: Sequence[Path], files: Sequence[str], tests: Sequence[str]) -> dict[str, Any]:
    """Return what the tests execute, and their times; the test files that are new or changed run, half in each copy.

    Recordings are kept in `.mutation`, by the content of the test file and of everything else that tests may read.
    """
    places = [copies[0] / test for test in tests]
    paths = [path for place in places for path in ([place] if place.suffix else place.rglob("test_*.py"))]
    common, kept = _digest(copies[0], files), {}
    for name, path in sorted((path.relative_to(copies[0]).as_posix(), path) for path in paths):
        read = b"".join(one.read_bytes() for one in _with_helpers(path, copies[0]))
        kept[name] = (
            root / ".mutation" / (hashlib.sha256(f"{common} {name}".encode() + read).hexdigest()[:32] + ".json")
        )
    missing = sorted((name for name in kept if not kept[name].exists()), key=lambda name: -(root / name).stat().st_size)
    processes = []
    for number, copy in enumerate(copies):
        if part := missing[number :: len(copies)]:
            out = copy.parent / f"recorded-{number}.json"
            arguments = ["-m", "tests.mutation.recording", str(out), str(len(files)), *files, *part]
            log = (copy.parent / f"recorded-{number}.log").open("w+")
            process = subprocess.Popen(
                [sys.executable, *arguments], cwd=copy, env=_environment(copy), stdin=subprocess.DEVNULL, stdout=log,
                stderr=log,
            )  # fmt: skip
            processes.append((process, part, out, log))
    (root / ".mutation").mkdir(exist_ok=True)
    failed = ""
    for process, part, out, log in processes:
        process.wait()
        log.seek(0)
        recorded = json.loads(out.read_text()) if out.exists() else {"code": 1, "failed": []}
        if recorded["code"] != 0:
            failed += f"{recorded['failed']}, exit code {process.returncode}\n{log.read()[-3000:]}"
        log.close()
        for name in part if recorded["code"] == 0 else []:
            mine = {test: row for test, row in recorded["tests"].items() if test.split("::")[0] == name}
            kept[name].write_text(json.dumps({"tests": mine, "imported": recorded["imported"]}))
    if failed:
        raise MutationError(f"the tests fail without a fault: {failed}")
    found = [json.loads(path.read_text()) for path in kept.values()]
    return {
        "tests": {test: row for one in found for test, row in one["tests"].items()},
        "imported": list(dict.fromkeys(name for one in found for name in one["imported"])),
    }


def _with_helpers(path: Path, copy: Path) -> list[Path]:
    """Return a test file and the test files that it imports from, directly or not."""
    found = [path]
    for each in found:
        text = each.read_text(encoding="utf-8")
        for module in re.findall(r"^from (tests[\w.]*\.test_\w+) import", text, re.MULTILINE):
            other = copy / (module.replace(".", "/") + ".py")
            found += [other] if other not in found and other.exists() else []
    return found


def _digest(copy: Path, files: Sequence[str]) -> str:
    """Return a digest of what all tests may read: package, data and helpers, but no tests."""
    digest = hashlib.sha256("\n".join(files).encode())
    skipped = ("tests/mutation/", "tests/test_", "tests/documentation/")
    for path in sorted(path for path in copy.rglob("*") if path.is_file()):
        name = path.relative_to(copy).as_posix()
        if path.suffix in (".py", ".toml", ".urdf", ".json", ".csv") and not name.startswith(skipped):
            if path.name.startswith("test_"):
                continue
            digest.update(name.encode() + path.read_bytes())
    return digest.hexdigest()


def _work(
    copy: Path, recorded: dict, waiting: queue.SimpleQueue[Mutant], end: float, tell: Callable[[Found], object]
) -> None:
    """Take mutants until none is left, or the time `end` has come."""
    log = copy.parent / f"{copy.name}.log"
    slowest: dict[str, float] = defaultdict(float)  # of each file: another test may have paid for a shared fixture
    for name, test in recorded["tests"].items():
        slowest[name.split("::")[0]] = max(slowest[name.split("::")[0]], test["seconds"])
    with subprocess.Popen(
        [sys.executable, "-m", "tests.mutation.worker"], cwd=copy, env=_environment(copy), text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    ) as process:  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(recorded["imported"]) + "\n")
        while time.monotonic() < end:
            try:
                mutant = waiting.get_nowait()
            except queue.Empty:
                break
            names = quick(concerned(mutant, recorded["tests"]), recorded["tests"])
            if not names:
                tell(Found(mutant, "unseen", 0.0))
                continue
            source = (copy / mutant.file).read_bytes()
            seconds = {name: recorded["tests"][name]["seconds"] for name in names}
            request = {
                "file": mutant.file, "text": mutant.text(source).decode(), "batches": batches(seconds),
                "seconds": {name: slowest[name.split("::")[0]] for name in names}, "log": str(log),
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


def quick(names: list[str], tests: dict[str, dict]) -> list[str]:
    """Return the quickest of some tests, those of half a minute together: a fault that only others see has survived."""
    ordered = sorted(names, key=lambda name: tests[name]["seconds"])
    until = itertools.accumulate(tests[name]["seconds"] for name in ordered)
    return [
        name for at, (name, total) in enumerate(zip(ordered, until, strict=True)) if at == 0 or total <= _MOST_SECONDS
    ]


def batches(seconds: dict[str, float]) -> list[list[str]]:
    """Return the tests as calls of pytest, quick ones first; a call has tests of one file, which share fixtures."""
    groups: dict[tuple[int, str], list[str]] = defaultdict(list)
    for name, took in sorted(seconds.items(), key=lambda item: item[1]):
        groups[sum(took > limit for limit in (0.3, 3.0)), name.split("::")[0]].append(name)
    ordered = sorted(groups.items(), key=lambda item: (item[0][0], sum(seconds[name] for name in item[1])))
    return [names for _, names in ordered]
