"""What programs with a process cost: `predict --process` against `convert --process`, and sweeps of large stocks.

Run: python -m tests.benchmarks.process [--only WORD …]

- ratio: processor time (user and system) of whole `predict` over whole `convert` of the same program, in processes of
  their own, each less the time to start: a plate, a drilled block, a surface under a ball cutter;
- 100,000 moves in a stock of 300 × 200 × 50 mm, and 1,000,000: time and peak memory of `postproc forces`.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tests.benchmarks.convert import POSTPROC, Cost, cost
from tests.machining.setting import gcode, process, tool
from tests.places import CELL_FILE

BOX = ((0, 300), (0, 200), (-50, 0))


def surface(moves: int, x0: float, x1: float, rows: int) -> Iterator[str]:
    """A ball cutter over a wavy surface, line by line."""
    for row, y in enumerate(np.linspace(0.0, 200.0, rows).tolist()):
        x = np.linspace(x0, x1, moves // rows)[:: 1 if row % 2 == 0 else -1]
        z = -6 + 3 * np.sin(x / 20) * math.cos(y / 25)
        yield from (f"X{a:.3f} Y{y:.3f} Z{b:.3f}" for a, b in zip(x, z, strict=True))


def hatch(moves: int) -> Iterator[str]:
    """A flat cutter to and fro in short moves, 20 levels."""
    rows, levels = 50, 20
    for level in range(1, levels + 1):
        yield f"G1 Z{-0.9 * level} F1000"
        for row in range(rows):
            x = np.linspace(0, 300, moves // (rows * levels))[:: 1 if row % 2 == 0 else -1]
            yield from (f"X{a:.3f} Y{4 * row:.3f} F3000" for a in x)


def plate() -> Iterator[str]:
    """Three levels of a contour and slots around it."""
    for level in range(1, 13):
        yield "G0 Z5"
        yield "G0 X-15 Y20"
        yield f"G1 Z{-1.0 * level} F1000"
        for row in range(8):
            yield f"G1 X315 Y{20 + 20 * row} F2400"
            yield f"G2 X315 Y{30 + 20 * row} J5" if row % 2 else f"G3 X315 Y{30 + 20 * row} J5"
            yield f"G1 X-15 Y{30 + 20 * row}"
            if row < 7:
                yield f"G1 Y{40 + 20 * row}"


def holes(number: int) -> Iterator[str]:
    """A drilled block: pecks of 6 mm."""
    yield "G98 G83 X5 Y5 Z-24 R2 Q6 F400"
    for k in range(1, number):
        yield f"X{5 + 10 * (k % 29)} Y{5 + 10 * (k // 29)}"
    yield "G80"


def _text(*blocks: str) -> str:
    return gcode("G0 X0 Y0 Z5", "G1 F3000", *blocks, "G0 Z50", spindle="S12000 M3")


RATIOS = {
    "plate": (_text(*plate()), process(tool(16, 3), BOX, 0.5)),
    "drilling": (_text(*holes(500)), process(tool(8, 2, "drill"), BOX, 0.5)),
    "ball surface": (_text(*surface(20_000, 0, 300, 100)), process(tool(10, 4, "ball"), BOX, 0.5)),
}
LONG = {
    "100,000 moves, ball surface": lambda: (
        _text(*surface(100_000, 0, 300, 200)),
        process(tool(10, 4, "ball"), BOX, 0.5),
    ),
    "100,000 moves, hatch": lambda: (_text(*hatch(100_000)), process(tool(10, 4), BOX, 0.5)),
    "1,000,000 moves, ball surface": lambda: (
        _text(*surface(1_000_000, 0, 300, 400)),
        process(tool(10, 4, "ball"), BOX, 0.5),
    ),
    "1,000,000 moves, hatch": lambda: (_text(*hatch(1_000_000)), process(tool(10, 4), BOX, 0.5)),
}


def cost_of_command(folder: Path, command: str, text: str, process_text: str) -> Cost:
    """Run a command on a program with a process."""
    (folder / "part.nc").write_text(text)
    (folder / "process.toml").write_text(process_text)
    out = str(folder / "part.csv") if command == "forces" else str(folder / command)
    given = ["--cell", str(CELL_FILE), "--process", str(folder / "process.toml"), "-o", out]
    return cost("-c", POSTPROC, command, str(folder / "part.nc"), *given)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[], help="cases whose name has one of these words")
    only = parser.parse_args().only

    def wanted(name: str) -> bool:
        return not only or any(word in name for word in only)

    start = cost("-c", "import postproc.cli.convert, postproc.machining, postproc.jobs.process_forces").seconds
    for name, (text, process_text) in RATIOS.items():
        if not wanted(name):
            continue
        with tempfile.TemporaryDirectory() as where:
            folder = Path(where)
            convert, predict = (
                cost_of_command(folder, command, text, process_text) for command in ("convert", "predict")
            )
            report = json.loads((folder / "predict" / "part.predict.report.json").read_bytes())
            (cut,) = [issue["message"] for issue in report["issues"] if issue["kind"] == "real-cut"]
            ratio = (predict.seconds - start) / (convert.seconds - start)
            print(
                f"{name}: convert {convert.seconds - start:.1f} s, predict {predict.seconds - start:.1f} s, "
                f"ratio {ratio:.2f}; {cut}",
                flush=True,
            )
    for name, make in LONG.items():
        if not wanted(name):
            continue
        with tempfile.TemporaryDirectory() as where:
            done = cost_of_command(Path(where), "forces", *make())
            print(f"{name}: {done.seconds:.0f} s, {done.memory:.0f} MiB", flush=True)


if __name__ == "__main__":
    main()
