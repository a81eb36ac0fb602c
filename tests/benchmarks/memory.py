"""Peak memory and time of whole `convert` runs, by the number of targets.

Run: python -m tests.benchmarks.memory [--targets N …]
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from tests.benchmarks import programs
from tests.benchmarks.convert import cost_of_convert


def main() -> None:
    """Print the largest resident memory [MiB], and processor time [s], of finishing passes of straight blocks."""
    options = argparse.ArgumentParser()
    options.add_argument("--targets", type=int, nargs="*", default=[1_000, 100_000, 300_000, 1_000_000])
    print(f"{'targets':>9}{'MiB':>8}{'s':>8}{'B each':>9}", flush=True)
    before: tuple[float, int] | None = None
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "part.nc"
        for count in options.parse_args().targets:
            path.write_text(programs.lines(count, programs.LINES["modal lines"]), encoding="utf-8")
            used, targets = cost_of_convert(path)
            each = "" if before is None else f"{(used.memory - before[0]) * 2**20 / (targets - before[1]):9.0f}"
            print(f"{targets:>9}{used.memory:>8.0f}{used.seconds:>8.1f}{each}", flush=True)
            before = (used.memory, targets)


if __name__ == "__main__":
    main()
