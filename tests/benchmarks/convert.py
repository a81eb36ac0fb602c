"""Whole `convert` of one 200 000-block program against pygcode parsing the same file; memory; start-up.

Run: python tests/benchmarks/convert.py [BLOCKS]

Everything is a ratio within one run on one machine. The program is a freeform finishing pass as CAM systems write it,
with blocks as long as `N10 G1 X… Y… Z…`, as `G1 X… Y… Z…` and as modal blocks `X… Y… Z…`.
"""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path

import numpy as np

SAMPLES = Path(__file__).parent.parent.parent / "samples"
CELL = str(SAMPLES / "cell_kr270.toml")
POSTPROC = str(Path(sysconfig.get_path("scripts")) / "postproc")


FORMS = ("N{n} G1 X{:.3f} Y{:.3f} Z{:.3f}", "G1 X{:.3f} Y{:.3f} Z{:.3f}", "X{:.3f} Y{:.3f} Z{:.3f}")


def program(blocks: int, form: str) -> str:
    """A zigzag over a wavy surface, 0.5 mm steps."""
    s = np.arange(blocks) * 0.5
    x, y = np.abs(s % 240 - 120), (s // 120) * 0.1
    z = 3 * np.sin(x / 20) * np.cos(y / 15)
    head = "%\nG21 G90 G17\nS10000 M3\nG0 X0 Y0 Z20\n(FORCE FX=60 FY=-40 FZ=90)\nG1 Z0 F3000\n"
    body = "".join(form.format(*row, n=10 * n) + "\n" for n, row in enumerate(zip(x, y, z, strict=True)))
    return head + body + "G0 Z50\nM5\nM30\n%\n"


def run(*command: str) -> tuple[float, int]:
    """Return seconds and peak memory [KiB] of a command."""
    code = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL);"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code, *command], check=True, capture_output=True, text=True)
    return time.perf_counter() - start, int(done.stdout)


def main() -> None:
    """Print the ratios."""
    blocks = int(sys.argv[1]) if len(sys.argv) > 1 else 200_000
    parse = "import sys\nfrom pygcode import Line\nfor text in open(sys.argv[1]):\n    Line(text.rstrip('\\n'))"
    with tempfile.TemporaryDirectory() as folder:
        for form in FORMS:
            path = Path(folder) / "part.nc"
            path.write_text(program(blocks, form), encoding="utf-8")
            alone, _ = run(sys.executable, "-c", parse, str(path))
            whole, memory = run(POSTPROC, "convert", str(path), "--cell", CELL, "-o", folder + "/out")
            allowed = 400 * 1024 + 2 * blocks
            like = form.split("{:")[0].format(n=10)
            print(f"{blocks} blocks {like}…: convert {whole:.2f} s, pygcode alone {alone:.2f} s, "
                  f"ratio {whole / alone:.2f} (1 allowed)")  # fmt: skip
            print(f"  peak memory {memory / 1024:.0f} MiB, ratio to 400 MiB + 2 KiB a target {memory / allowed:.2f}")
        path.write_text(program(100, FORMS[0]), encoding="utf-8")
        small, _ = run(POSTPROC, "convert", str(path), "--cell", CELL, "-o", folder + "/out")
        print(f"convert of 100 blocks: {small:.2f} s (1.5 allowed)")
    click = min(run(sys.executable, "-c", "import click")[0] for _ in range(5))
    shown = min(run(POSTPROC, "--help")[0] for _ in range(5))
    print(f"postproc --help: {shown / click:.2f} × python -c 'import click' (4 allowed)")


if __name__ == "__main__":
    main()
