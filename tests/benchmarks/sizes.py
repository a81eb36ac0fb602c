"""Bytes of written KRL programs, and how many of them are A, B, C that repeat those of the line before.

Run: python -m tests.benchmarks.sizes
"""

from __future__ import annotations

import re
import tempfile
from itertools import pairwise
from pathlib import Path

from tests.benchmarks.convert import POSTPROC, cost
from tests.places import CELL_FILE, ROOT

_ANGLES = re.compile(r"^(?:S?LIN|S?CIRC) .*(,A [^,]+,B [^,]+,C [^,}]+)\}")
_PARTS = {
    "pocket": ("samples/pocket.nc", str(CELL_FILE), ()),
    "freeform": ("samples/freeform.nc", str(CELL_FILE), ("--forces", "samples/freeform.forces.csv")),
    "drilling": ("samples/gallery/drilling.nc", str(CELL_FILE), ("--process", "samples/gallery/drilling.process.toml")),
    "dome, five axes": ("samples/gallery/dome.nc", "samples/gallery/cell_five_axes.toml", ()),
}


def repeated(text: str) -> int:
    """Return the characters of A, B, C that are the same as on the line before."""
    found = [_ANGLES.match(line) for line in text.splitlines()]
    return sum(len(one[1]) for before, one in pairwise(found) if before and one and one[1] == before[1])


def main() -> None:
    """Print both for parts of the gallery, corrected and without correction."""
    print(f"{'part':<18}{'':<12}{'bytes':>10}{'repeated A B C':>16}{'share':>8}")
    for name, (program, cell, more) in _PARTS.items():
        for form, option in (("corrected", ()), ("nominal", ("--nominal",))):
            with tempfile.TemporaryDirectory() as out:
                path = ROOT / program
                cost("-c", POSTPROC, "convert", str(path), "--cell", cell, *more, *option, "-o", out)
                text = (Path(out) / f"{path.stem}.src").read_text(encoding="cp1252")
            same = repeated(text)
            print(f"{name:<18}{form:<12}{len(text):>10}{same:>16}{same / len(text):>8.1%}", flush=True)


if __name__ == "__main__":
    main()
