"""Loops and routines around motions, against the same points as plain lines.

Run: python -m tests.benchmarks.krl_bodies [--points 8000 60000] [--only NAME …] [--whole]

Each body moves to the same points. Printed are processor time a point for reading, writing with a correction of its own
for each point, and reading back, and the ratio of their sum to that of plain lines in the same process. `--whole`: the
ratio of whole `convert` runs, without the time that one with 100 points takes.
"""

from __future__ import annotations

import argparse
import gc
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from postproc.dialects import krl
from postproc.dialects.krl.read import read_program
from postproc.program import Document, Program, Targets
from tests.benchmarks.convert import cost_of_convert
from tests.dialects.krl_programs import CELL, forward, targets

_UNDER_FORCE = (
    "DEF part( )\r\nDECL FRAME XT\r\nBAS (#INITMOV,0 )\r\n$VEL.CP=0.05\r\n;FORCE FX=60 FY=-40 FZ=90\r\n"
    "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}\r\n"
)
_BY_NUMBER = "DEF CUT(K:IN)\r\nDECL INT K\r\nLIN PP[K] C_DIS\r\nEND\r\n"
_BY_POINT = "DEF CUT(P:IN)\r\nDECL E6POS P\r\nLIN P C_DIS\r\nEND\r\n"
_LENGTH = 100
"""Motions of the routine that is called again and again."""
_TURN = 0.7
"""Angle between points on a helix [deg]."""


def _point(n: int) -> str:
    x, y = 90.0 * np.cos(np.radians(n * _TURN)), 90.0 * np.sin(np.radians(n * _TURN))
    return f"{{X {x:.3f},Y {y:.3f},Z {1.0 + 0.001 * n:.3f},A 0,B 0,C 180}}"


def _loop(*lines: str) -> Callable[[int], list[str]]:
    return lambda count: [f"FOR I=1 TO {count}", *lines, "ENDFOR"]


def _each(form: str) -> Callable[[int], list[str]]:
    return lambda count: [form.format(_point(n)) for n in range(1, count + 1)]


def _routine(_: int) -> str:
    return "".join(["DEF SUB( )\r\n", *(f"LIN {_point(n)} C_DIS\r\n" for n in range(1, _LENGTH + 1)), "END\r\n"])


_COMPUTED = f"LIN {{X 90*COS(I*{_TURN}),Y 90*SIN(I*{_TURN}),Z 1+0.001*I,A 0,B 0,C 180}} C_DIS"
BODIES: dict[str, tuple[Callable[[int], list[str]], Callable[[int], str]]] = {
    "lines": (_each("LIN {} C_DIS"), lambda _: ""),
    "LIN PP[I]": (_loop("LIN PP[I] C_DIS"), lambda _: ""),
    "LIN {X 90*COS(I*…)}": (_loop(_COMPUTED), lambda _: ""),
    "XT=PP[I]": (_loop("XT=PP[I]", "LIN XT C_DIS"), lambda _: ""),
    "PP[I+1]": (_loop("LIN PP[I+1] C_DIS"), lambda _: ""),
    "$VEL.CP=V[I]": (_loop("$VEL.CP=V[I]", "LIN PP[I] C_DIS"), lambda _: ""),
    "PP[I].A=180": (_loop("PP[I].A=180", "LIN PP[I] C_DIS"), lambda _: ""),
    "IF … $OUT": (_loop("IF PP[I].Z>0 THEN", "LIN PP[I] C_DIS", "$OUT[1]=TRUE", "ENDIF"), lambda _: ""),
    "CUT(I)": (_loop("CUT(I)"), lambda _: _BY_NUMBER),
    "TRIGGER": (_loop("TRIGGER WHEN DISTANCE=1 DELAY=0 DO $OUT[2]=TRUE", "LIN PP[I] C_DIS"), lambda _: ""),
    "CUT(PP[I])": (_loop("CUT(PP[I])"), lambda _: _BY_POINT),
    "GOP({X …})": (_each("CUT({})"), lambda _: _BY_POINT),
    "SUB( ) of 100": (lambda count: ["SUB( )"] * (count // _LENGTH), _routine),
}
"""Name → lines of the main routine for a number of points, and other routines."""


def files(name: str, count: int) -> dict[str, str]:
    """Return a program with a body, by the names of its files."""
    lines, routines = BODIES[name]
    data = [f"DEFDAT part\r\nDECL INT I\r\nDECL REAL V[{count}]\r\nDECL E6POS PP[{count + 1}]\r\n"]
    data += [f"V[{n}]={0.05 + n % 5 / 100:g}\r\n" for n in range(1, count + 1)]
    data += [f"PP[{n}]={_point(n)}\r\n" for n in range(1, count + 2)]
    source = _UNDER_FORCE + "".join(f"{line}\r\n" for line in lines(count)) + "END\r\n" + routines(count)
    return {"part.src": source, "part.dat": "".join([*data, "ENDDAT\r\n"])}


def read_texts(texts: dict[str, str]) -> Program:
    """Read a program."""
    return read_program([Document(name, text) for name, text in texts.items()], CELL, forward, "part")


def corrected_targets(program: Program) -> Targets:
    """Return targets with a correction of their own for each motion."""
    shift = np.random.default_rng(0).uniform(-1e-3, 1e-3, (len(program.motions), 3))
    return targets(program, shift)


def _seconds(work: Callable[[], object]) -> float:
    gc.collect()
    begin = time.process_time()
    work()
    return time.process_time() - begin


def costs(name: str, count: int) -> tuple[float, float, float]:
    """Return the processor time of reading, writing and reading back [s]."""
    texts = files(name, count)
    program = read_texts(texts)
    wanted = corrected_targets(program)
    written = {document.name: document.text for document in krl.rewrite(program, wanted).documents}
    return (
        _seconds(lambda: read_texts(texts)),
        _seconds(lambda: krl.rewrite(program, wanted)),
        _seconds(lambda: read_texts(written)),
    )


def whole(name: str, count: int) -> float:
    """Return the processor time of a `convert` [s]."""
    with tempfile.TemporaryDirectory() as place:
        for file, text in files(name, count).items():
            (Path(place) / file).write_text(text, encoding="utf-8", newline="")
        return cost_of_convert(Path(place) / "part.src")[0].seconds


def main() -> None:
    """Print the ratios."""
    options = argparse.ArgumentParser()
    options.add_argument("--points", type=int, nargs="*", default=[8_000, 60_000])
    options.add_argument("--only", nargs="*", default=list(BODIES), help="names of bodies")
    options.add_argument("--whole", action="store_true")
    given = options.parse_args()
    start = min(whole("lines", 100) for _ in range(2)) if given.whole else 0.0  # the first run compiles modules
    costs("lines", 500)
    print(f"{'body':<22}{'points':>8}{'read':>8}{'write':>8}{'again':>8} µs a point, ratio{'  convert':>9}")
    for count in given.points:
        plain, converted = costs("lines", count), whole("lines", count) - start if given.whole else 0.0
        for name in dict.fromkeys(("lines", *given.only)):
            cost = plain if name == "lines" else costs(name, count)
            columns = "".join(f"{1e6 * seconds / count:>8.1f}" for seconds in cost)
            ratio = f"{sum(cost) / sum(plain):>18.1f}"
            if given.whole:
                ratio += f"{(whole(name, count) - start) / converted:>9.1f}"
            print(f"{name:<22}{count:>8}{columns}{ratio}", flush=True)


if __name__ == "__main__":
    main()
