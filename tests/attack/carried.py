"""Random programs corrected, and predicted as written: the same forces, the tool in its place, corners as promised.

python -m tests.attack.carried --minutes 60 [--seed 0]
"""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import numpy as np

from postproc import correction, forces, report
from postproc.errors import PostprocError
from tests.attack.driver import parser, try_seeds
from tests.cells import sample
from tests.corrections import read_back, read_files

START_DAT = (
    "DEFDAT part\nDECL E6POS XS={X 0,Y 0,Z 50,A 180,B 0,C 180}\nDECL E6POS XT={X 10,Y 5,Z 30,A 180,B 0,C 180}\n"
    "DECL FRAME FR={X 3,Y -2,Z 1,A 2,B 0,C 0}\nENDDAT\n"
)
RAPID = ("PTP XS", "SPTP XT", "PTP XT C_PTP")
MICROMETRE = 1e-6


class Writer:
    """Makes programs up from one seed."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)

    def pick(self, *options):
        return options[int(self.rng.integers(len(options)))]

    def number(self, value):
        return f"{value:.{self.rng.integers(1, 5)}f}"

    def step(self):
        return self.rng.normal(size=3) * self.pick(0.5, 5, 30)

    def force(self, opening, closing):
        if self.rng.random() < 0.2:
            return f"{opening}FORCE OFF{closing}"
        values = dict(zip(("FX", "FY", "FZ"), self.rng.normal(size=3) * 200, strict=True))
        values |= {"MX": self.rng.normal() * 5} if self.rng.random() < 0.3 else {}
        told = " ".join(f"{name}={self.number(value)}" for name, value in values.items())
        return f"{opening}FORCE {told}{self.pick('', ' FRAME=FEED', ' FRAME=TOOL', ' FRAME=BASE')}{closing}"

    def gcode(self):
        lines = ["G90 G21 G17", self.pick("", "", "", "G61", "G64 P0.2", "G64 P0.01"), "S1000 F600", "G0 X0 Y0 Z20"]
        lines.append("G1 X1 Z5")
        x, y = 1.0, 0.0
        for _ in range(self.rng.integers(3, 14)):
            kind = self.rng.random()
            if kind < 0.35:
                lines.append(self.force("(", ")"))
            elif kind < 0.75:
                x, y = (round(float(v), 3) for v in np.clip(np.array([x, y]) + self.step()[:2], -80, 80))
                down = f" Z{self.number(self.rng.uniform(-10, 10))}" if self.rng.random() < 0.3 else ""
                lines.append(f"{self.pick('G1', 'G1', 'G1', 'G0')} X{x} Y{y}{down}")
            else:
                radius = abs(self.rng.normal()) * self.pick(0.5, 5, 20) + 0.2
                one, two = self.rng.uniform(0.0, 2 * np.pi, 2)
                i, j = -radius * np.cos(one), -radius * np.sin(one)
                x, y = round(x + i + radius * np.cos(two), 5), round(y + j + radius * np.sin(two), 5)
                lines.append(f"{self.pick('G2', 'G3')} X{x} Y{y} I{i:.5f} J{j:.5f}")
        return "\n".join([*lines, "M2", ""])

    def krl(self):
        apo = f"$APO.CDIS={self.number(self.rng.uniform(0.1, 3))}"
        lines = ["DEF part( )", "$VEL.CP=0.05", self.pick(apo, ""), "PTP XS"]
        spot, turn = np.zeros(3), "A 180,B 0,C 180"
        for _ in range(self.rng.integers(3, 14)):
            kind, tail = self.rng.random(), self.pick("", " C_DIS", " C_DIS")
            tail += self.pick("", "", "", " " + self.force(";", ""), " ; note")
            if kind < 0.25:
                lines.append(self.force(";", ""))
            elif kind < 0.35:
                lines.append(f"TRIGGER WHEN {self.pick('DISTANCE=0', 'DISTANCE=1', 'PATH=-2')} DELAY=0 DO $OUT[1]=TRUE")
            elif kind < 0.45:
                lines.append(self.pick(*RAPID, "PTP FR:XT", "LIN XT", "LIN FR:XT C_DIS"))
            elif kind < 0.55:
                lines.append(f"LIN_REL {{Z {self.number(self.step()[0])},X {self.number(self.step()[1])}}}{tail}")
            elif kind < 0.85:
                spot = np.clip(spot + self.step(), -60, 60)
                if self.rng.random() < 0.15:
                    turn = f"A {self.number(180 + self.rng.normal() * 8)},B {self.number(self.rng.normal() * 4)},C 180"
                lines.append(f"LIN {{{self.xyz(spot)},{turn}}}{tail}")
            else:
                via = np.add(spot, [self.rng.uniform(1, 20), self.rng.uniform(5, 20), 0.0])
                lines.append(f"LIN {{{self.xyz(spot)},{turn}}}")
                spot = np.add(spot, [self.rng.uniform(21, 40), 0.0, self.rng.normal()])
                angle = self.pick("", "", "", ",CA 200", ",CA 400.5", ",CA -90")
                lines.append(f"CIRC {{{self.xyz(via)}}},{{{self.xyz(spot)}}}{angle}{tail}")
        return "\n".join([*lines, "END", ""])

    @staticmethod
    def xyz(spot):
        return f"X {spot[0]:.4f},Y {spot[1]:.4f},Z {spot[2]:.4f}"


def csv_of(writer, program, folder):
    """A CSV file of forces for some lines of a program, or None."""
    lines = np.unique(program.motions.line[~program.motions.rapid])
    lines = lines[writer.rng.random(len(lines)) < 0.8]
    if writer.rng.random() < 0.7 or not len(lines):
        return None
    rows = ["line,Fx,Fy,Fz,frame"]
    for line in lines.tolist():
        force = map(writer.number, writer.rng.normal(size=3) * 200)
        rows.append(",".join([str(line), *force, writer.pick("BASE", "TOOL")]))
    return rows_of(folder, "\n".join([*rows, ""]).encode())


def rows_of(folder, content):
    path = Path(folder) / "forces.csv"
    path.write_bytes(content)
    return forces.read_force_csv(path)


def try_program(seed):
    """Correct one program and predict what was written; return what came of it.

    :raises AssertionError: forces, tool, corners, triggers, rapid moves or lines are not what they should be.
    """
    writer = Writer(seed)
    dialect = writer.pick("gcode", "krl")
    cell, robot = sample("cell_kr270.toml" if dialect == "krl" else writer.pick("cell_kr270.toml", "cell_kr16.toml"))
    files = {"part.nc": writer.gcode()} if dialect == "gcode" else {"part.src": writer.krl(), "part.dat": START_DAT}
    text = next(iter(files.values()))
    with tempfile.TemporaryDirectory() as folder:
        try:
            program = read_files(files, cell, robot)
            result = correction.process(program, robot, cell, csv_of(writer, program, folder))
        except PostprocError:
            return "refused"
        if result.failed:
            assert not {issue.kind for issue in result.issues} & {"read-back", "tolerance"}, (text, result.issues)
            return "refused"
        carried = report.forces_csv(result)
        rows = None if carried is None else rows_of(folder, carried)
        back = correction.process(read_back(result, cell, robot), robot, cell, rows, "predict")
    ends = back.t == 1.0
    tip = back.nominal[ends, :3, 3] + back.deflection[ends]
    assert np.linalg.norm(tip - result.nominal[:, :3, 3], axis=1).max() < MICROMETRE, text
    lines = result.documents[0].text.splitlines()
    assert all(re.match(r"S?(?:LIN|PTP|CIRC)(?:_REL)?\b", lines[n - 1]) for n in result.output_line.tolist()), text
    if dialect == "gcode":
        limit = np.where(result.t == 1.0, program.motions.rounding[result.motion], 0.2 * cell.tolerance)
        assert (result.rounding <= limit + 2e-8).all(), text
    else:
        old = text.splitlines()
        assert sum("TRIGGER" in line for line in old) == sum("TRIGGER" in line for line in lines), text
        assert all(old.count(rapid) == lines.count(rapid) for rapid in RAPID), text
    return "carried by a file" if rows is not None else "carried by comments" if program.notes else "without forces"


def main() -> int:
    """Try programs, and count what came of them."""
    options = parser(__doc__).parse_args()
    return try_seeds(options, try_program)


if __name__ == "__main__":
    raise SystemExit(main())
