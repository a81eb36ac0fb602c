"""Whole `convert` of large programs, in one process, against what other software needs for the same file.

Run: python -m tests.benchmarks.convert [--blocks N] [--only WORD …] [--slope]

Everything is a ratio within one run on one machine, of processor time (user and system), so that other work on the
machine matters little:

- programs (see `programs.py`): to pygcode merely parsing the file, line by line; KRL to the same pass in G-code, a
  program with subprograms and cycles to its lines as they are executed; a FOR over the points of an array also to the
  same points as plain KRL lines;
- peak memory: to 300 MiB and 2 KiB a target;
- the budget: µs a target by stage (see `budget.py`);
- a peer's job file (see `peer.py`), seconds a target;
- start-up: 100 blocks to importing numpy, pinocchio and click;
- `--slope`: 10⁶ targets to ten times 10⁵.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from tests.benchmarks import programs
from tests.benchmarks.budget import ORDER
from tests.places import CELL_FILE, ROOT

PARSE = "import sys\nfrom pygcode import Line\nfor text in open(sys.argv[1]):\n    Line(text.rstrip('\\n'))"
POSTPROC = "from postproc.cli import main; main()"
IMPORTS = "import numpy, pinocchio, click"
_PEER_BLOCKS = 3000
_PAIRS = 5
"""So often each program is parsed and converted, in turn; the pair in the middle is printed: no machine is steady."""


@dataclass(frozen=True, slots=True)
class Cost:
    """What a process took: processor time [s], peak memory [MiB], what it wrote to stderr."""

    seconds: float
    memory: float
    said: str


def cost(*command: str) -> Cost:
    """Run a command of Python to its end; modules are compiled once, as they are where the package is installed."""
    compiled = {"PYTHONPYCACHEPREFIX": str(Path(tempfile.gettempdir()) / "postproc-benchmark")}
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | compiled
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(
            [sys.executable, *command], stdout=subprocess.DEVNULL, stderr=said, cwd=ROOT, env=environment
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        text = said.read().decode()
    if process.returncode not in (0, 3):
        raise SystemExit(f"{' '.join(command)}: exit code {process.returncode}\n{text}")
    return Cost(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, text)


def cost_of_convert(path: Path) -> tuple[Cost, int]:
    """Convert a program as users do, into a new folder; return what it took and the number of targets."""
    out = path.parent / "out"
    shutil.rmtree(out, ignore_errors=True)
    done = cost("-c", POSTPROC, "convert", str(path), "--cell", str(CELL_FILE), "-o", str(out))
    return done, json.loads((out / f"{path.stem}.report.json").read_bytes())["targets"]


def budget(path: Path) -> dict[str, float]:
    """Return where the processor's time of a `convert` goes, seconds by stage."""
    done = cost("-m", "tests.benchmarks.budget", str(path), "--cell", str(CELL_FILE), "-o", str(path.parent / "out"))
    stages: dict[str, float] = json.loads(done.said.splitlines()[-1])
    return stages


def measured(name: str, path: Path, parsed: Path) -> None:
    """Print ratio (of the pair in the middle), memory and budget of one program; `parsed` is what pygcode parses."""
    pairs = [(cost("-c", PARSE, str(parsed)).seconds, *cost_of_convert(path)) for _ in range(_PAIRS)]
    alone, whole, targets = sorted(pairs, key=lambda pair: pair[1].seconds / pair[0])[_PAIRS // 2]
    stages = budget(path)
    allowed = 300 + targets * 2 / 1024
    print(
        f"{name:<18}{targets:>9}{whole.seconds:>9.2f}{1e6 * whole.seconds / targets:>9.1f}{alone:>9.2f}"
        f"{whole.seconds / alone:>8.2f}{whole.memory:>9.0f}{whole.memory / allowed:>8.2f}",
        flush=True,
    )
    each = "  ".join(f"{stage} {1e6 * stages[stage] / targets:.2f}" for stage in ORDER if stage != "start")
    print(f"    µs a target: {each}; start {stages['start']:.2f} s", flush=True)


def main() -> None:
    """Print the ratios."""
    options = argparse.ArgumentParser()
    options.add_argument("--blocks", type=int, default=50_000)
    options.add_argument("--only", nargs="*", default=[], help="names of programs, or peer, start")
    options.add_argument("--slope", action="store_true", help="10⁶ targets too: 1 GiB, some minutes")
    given = options.parse_args()
    blocks = given.blocks

    def wanted(name: str) -> bool:
        return not given.only or any(word in name for word in given.only)

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        texts = {name: programs.lines(blocks, form) for name, form in programs.LINES.items()}
        texts |= {"half circles": programs.half_circles(blocks), "arcs and lines": programs.rounded_corners(blocks)}
        print(
            f"{blocks} blocks each; s of processor time; ratio to pygcode's parsing; MiB, ratio to 300 + 2 KiB/target"
        )
        print(f"{'program':<18}{'targets':>9}{'s':>9}{'µs each':>9}{'pygcode':>9}{'ratio':>8}{'memory':>9}{'ratio':>8}")
        path = folder / "part.nc"
        path.write_text(programs.lines(100, programs.LINES["lines"]), encoding="utf-8")
        cost_of_convert(path)  # compiles what is imported
        for name, text in texts.items():
            if wanted(name):
                path.write_text(text, encoding="utf-8")
                measured(name, path, path)
        if wanted("calls and cycles"):
            text, written = programs.calls(blocks)
            (folder / "executed.nc").write_text(written, encoding="utf-8")
            path.write_text(text, encoding="utf-8")
            measured("calls and cycles", path, folder / "executed.nc")
        if wanted("KRL"):
            path.write_text(texts["numbered lines"], encoding="utf-8")
            (folder / "part.src").write_text(programs.krl(blocks), encoding="utf-8", newline="")
            measured("KRL", folder / "part.src", path)
        if wanted("loop"):
            path.write_text(texts["numbered lines"], encoding="utf-8")
            for ending, text in zip(("src", "dat"), programs.krl_loop(blocks), strict=True):
                (folder / f"part.{ending}").write_text(text, encoding="utf-8", newline="")
            measured("KRL, loop", folder / "part.src", path)
            (folder / "lines.src").write_text(programs.krl(blocks), encoding="utf-8", newline="")
            pairs = [
                [cost_of_convert(folder / name)[0].seconds for name in ("part.src", "lines.src")] for _ in range(_PAIRS)
            ]
            ratio = sorted(loop / lines for loop, lines in pairs)[_PAIRS // 2]
            print(f"    a loop to the same points as plain lines: {ratio:.2f} (2 allowed)")
            (folder / "part.dat").unlink()
        if wanted("peer"):
            path.write_text(programs.lines(_PEER_BLOCKS, programs.LINES["lines"]), encoding="utf-8")
            peer = cost("-m", "tests.benchmarks.peer", str(path), str(folder / "peer.src"))
            path.write_text(programs.lines(10 * _PEER_BLOCKS, programs.LINES["lines"]), encoding="utf-8")
            ours, targets = cost_of_convert(path)
            peers, own = peer.seconds / _PEER_BLOCKS, ours.seconds / targets
            print(f"a peer's job file: {1e6 * peers:.0f} µs a target, ours {1e6 * own:.1f}: ratio {own / peers:.3f}")
        if wanted("start"):
            path.write_text(programs.lines(100, programs.LINES["lines"]), encoding="utf-8")
            small = min(cost_of_convert(path)[0].seconds for _ in range(3))
            imports = min(cost("-c", IMPORTS).seconds for _ in range(3))
            shown = min(cost("-c", POSTPROC, "--help").seconds for _ in range(3))
            click = min(cost("-c", "import click").seconds for _ in range(3))
            ratio = f"ratio {small / imports:.2f} (2 allowed)"
            print(f"convert of 100 blocks {small:.2f} s, {IMPORTS} {imports:.2f} s: {ratio}")
            print(f"postproc --help {shown:.2f} s, import click {click:.2f} s: ratio {shown / click:.2f}")
        if given.slope:
            each = {}
            for count in (100_000, 1_000_000):
                path.write_text(programs.lines(count, programs.LINES["modal lines"]), encoding="utf-8")
                done, targets = cost_of_convert(path)
                each[count] = done.seconds / targets
                print(
                    f"{targets} targets: {done.seconds:.1f} s, {1e6 * each[count]:.1f} µs each, {done.memory:.0f} MiB"
                )
            print(f"slope: {each[1_000_000] / each[100_000]:.2f}")


if __name__ == "__main__":
    main()
