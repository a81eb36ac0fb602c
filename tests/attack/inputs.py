"""Files that are spoilt in every way: each reader reads them or raises one of its own errors, and says nothing else."""

from __future__ import annotations

import random
import re
import tempfile
import traceback
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path

from postproc import cell as cells
from postproc import correction, jobs
from postproc import robot as robots
from postproc.cell import Cell
from postproc.dialects import gcode
from postproc.dialects.text import decode
from postproc.errors import PostprocError
from postproc.forces import read_force_csv
from postproc.program import Program
from postproc.robot import RobotModel
from tests.attack.gcode_generator import Generator
from tests.dialects.gcode_reading import CELL, forward
from tests.kr270 import CELL_TEXT, FOLDER
from tests.places import CELL_FILE

SCRAPS = [
    "9" * 400, "1e300", "-1e300", "1e-300", "nan", "inf", "-", ".", "..", "0", "-0.0", "1" + "0" * 5000, "\0", "\r",
    "\r\r\n", "\ufeff", "é", "١", "\N{FULLWIDTH DIGIT ONE}", "%", "(", ")", "((", ";", "\"", "'", "=", "[", "]",
    "{", "#", "O1", "O", "N", "X", "G", "M", "G1", "G2", "FORCE FX=", "(FORCE FX=1)", "FX=1e999", "P99999", "R1e9",
    "\n", "\n\n", ",", ",,", "_", "true", "[]", "{}", "\x1a", "\x0c", "\u2028", "1_000", "0x1F", "1e5", "G0" * 2000,
    "(" * 3000, "[" * 3000, "X1" * 3000,
]  # fmt: skip
SMALL = "G21 G90\nG0 X10 Y10 Z5 S100 M3\nG1 Z-1 F600\nX20 Y15\nG2 X30 I5\nG0 Z50\nM30\n"
FORCES = "line,Fx,Fy,Fz,Mx,My,Mz,frame,line_end\n4,-110,40.5,200,0,0,1.5,FEED,5\n3,10,20,30,0,0,0,BASE,\n"


VALUES = [
    "0", "-1", "1", "0.5", "1e-9", "-1e-9", "1e-300", "1e3", "-1e3", "1e6", "-1e6", "1e9", "1e18", "1e300", "-1e300",
    "1e308", "90", "180", "-180", "360", "nan", "inf",
]  # fmt: skip


def spoilt(text: str, rng: random.Random) -> bytes:
    """Return a text with other values, or with a few mutations, as bytes that may be no text any more."""
    if rng.random() < 0.4:
        for _ in range(rng.choice([1, 1, 2, 3])):
            found = rng.choice(list(re.finditer(r"(?<![\d.])-?\d+(\.\d*)?(e-?\d+)?(?![\d.])", text)))
            text = text[: found.start()] + rng.choice(VALUES) + text[found.end() :]
        return text.encode()
    for _ in range(rng.choice([1, 1, 2, 3, 6])):
        a, b = sorted(rng.randrange(len(text) + 1) for _ in range(2))
        kind = rng.choice(["insert", "insert", "number", "cut", "end", "swap", "double", "line", "case", "lines"])
        if kind == "insert":
            text = text[:a] + rng.choice(SCRAPS) + text[a:]
        elif kind == "number":
            digits = [n for n, c in enumerate(text) if c.isdigit()]
            at = rng.choice(digits) if digits else 0
            text = text[:at] + rng.choice(SCRAPS[:14]) + text[at + 1 :]
        elif kind == "cut":
            text = text[:a] + text[min(b, a + 40) :]
        elif kind == "end":
            text = text[:b]
        elif kind == "swap" and b > a:
            text = text[:a] + text[b : b + 1] + text[a + 1 : b] + text[a : a + 1] + text[b + 1 :]
        elif kind == "double":
            text = text[:b] + text[a:b] + text[b:]
        elif kind == "case":
            text = text[:a] + text[a:b].swapcase() + text[b:]
        else:
            lines = text.splitlines(keepends=True) or [""]
            at = rng.randrange(len(lines))
            if kind == "line":
                del lines[at]
            else:
                rng.shuffle(lines)
            text = "".join(lines)
    data = text.encode("utf-8", "surrogatepass")
    if rng.random() < 0.1 and data:
        at = rng.randrange(len(data))
        data = data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]
    return data


def _attempt(work: Callable[[], str], data: bytes) -> str:
    """Return what came of it; only errors of the package are allowed, and no warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return work()
        except PostprocError as error:
            return "refused" if str(error).strip() else "refused without a word"
        except Exception as cause:
            raise AssertionError(f"{data!r:.3000}\n{traceback.format_exc()}") from cause


@cache
def _setup() -> tuple[Cell, RobotModel, Program]:
    cell = cells.load(CELL_FILE)
    robot = jobs.load_robot(cell.robot)
    program = correction.read([decode("part.nc", SMALL.encode())], robot, cell, "part", "gcode")
    return cell, robot, program


def _result(program: Program, robot: RobotModel, cell: Cell, rows: object = None) -> str:
    result = correction.process(program, robot, cell, rows)  # type: ignore[arg-type]
    return "blocked" if result.failed else "written"


def spoilt_program(seed: int) -> str:
    """Spoil the text of a G-code program and read it; now and then convert what is accepted."""
    rng = random.Random(seed)
    made = Generator(rng)
    made.program()
    data = spoilt(rng.choice([made.text(1), SMALL]), rng)
    cell, robot, _ = _setup()

    def work() -> str:
        document = decode("part.nc", data)
        if rng.random() < 0.9:
            gcode.read(document, CELL, forward, "part")
            return "read"
        return _result(correction.read([document], robot, cell, "part", "gcode"), robot, cell)

    return _attempt(work, data)


def _from_file(data: bytes, read: Callable[[Path], str]) -> str:
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "input"
        path.write_bytes(data)
        return _attempt(lambda: read(path), data)


def spoilt_forces(seed: int) -> str:
    """Spoil a force file, read it, and convert with what is accepted."""
    cell, robot, program = _setup()
    data = spoilt(FORCES, random.Random(seed))
    return _from_file(data, lambda path: _result(program, robot, cell, read_force_csv(path)))


def spoilt_cell(seed: int) -> str:
    """Spoil a cell file, read it, and convert with what is accepted."""
    _, robot, _ = _setup()
    data = spoilt(CELL_TEXT, random.Random(seed))

    def work(path: Path) -> str:
        cell = cells.load(path)
        return _result(correction.read([decode("part.nc", SMALL.encode())], robot, cell, "part", "gcode"), robot, cell)

    return _from_file(data, work)


def spoilt_model(seed: int) -> str:
    """Spoil a file of a robot model, read it, and convert with what is accepted."""
    rng = random.Random(seed)
    cell, _, _ = _setup()
    victim = rng.choice(["model.toml", "model.toml", "robot.urdf"])
    contents = {name: (FOLDER / name).read_bytes() for name in ("model.toml", "robot.urdf")}
    contents[victim] = data = spoilt(contents[victim].decode(), rng)

    def work(path: Path) -> str:
        robot = robots.load(path)
        return _result(correction.read([decode("part.nc", SMALL.encode())], robot, cell, "part", "gcode"), robot, cell)

    with tempfile.TemporaryDirectory() as name:
        for file, content in contents.items():
            (Path(name) / file).write_bytes(content)
        return _attempt(lambda: work(Path(name)), data)


ATTACKS = (spoilt_program, spoilt_forces, spoilt_cell, spoilt_model)
