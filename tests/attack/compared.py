"""Random programs corrected, and compared with what they were made from: as written, and with one difference planted.

python -m tests.attack.compared --minutes 60 [--seed 0] [--keep-going]

The corrected text does not say where it comes from, as that of another post: nothing but the motions tells. What moves
the tool by less than three times the tolerance is not planted.
"""

from __future__ import annotations

import re
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from postproc import cell as cells
from postproc import correction, toolpath
from postproc.comparison import compare
from postproc.errors import PostprocError
from postproc.frames import M_PER_MM
from postproc.program import CIRC, PTP
from postproc.provenance import Provenance
from postproc.report.comparison import ProgramOrigin, comparison_summary
from tests.attack import carried
from tests.attack.driver import Wrong, parser, try_seeds
from tests.benchmarks import programs
from tests.cells import sample
from tests.comparison.krl_moves import TURNED
from tests.corrections import read_files
from tests.kr270 import CELL_TEXT
from tests.krl_texts import HEAD

LEAST_MM, LEAST_DEG = 0.03, 0.05
NUMBER = r"(?<![\w.$])({name} ?)(-?\d+\.?\d*)"


def splines(rng):
    """A program of lines, spline blocks with SCIRC in them, and arcs."""
    lines, x = [HEAD, f"; FORCE FX={rng.uniform(-200, 200):.1f} FY={rng.uniform(-200, 200):.1f} FZ=120"], 0.0
    lines.append(f"LIN {{X 0.000,Y 0.000,Z 5.000,{TURNED}}}")
    for _ in range(int(rng.integers(2, 5))):
        points = [(x + step, *np.round(rng.uniform(-8, 8, 2), 3)) for step in (6.0, 12.0, 18.0, 24.0)]
        a, b, c, d = (f"{{X {px:.3f},Y {py:.3f},Z {pz:.3f},{TURNED}}}" for px, py, pz in points)
        if rng.random() < 0.6:
            via = a.replace(f",{TURNED}", "")
            lines += ["SPLINE", f"  SCIRC {via},{b}", f"  SLIN {c}", f"  SLIN {d}", "ENDSPLINE"]
        else:
            lines += [f"LIN {a}", f"CIRC {b.replace(f',{TURNED}', '')},{c}", f"LIN {d} C_DIS"]
        x += 24.0
    return "\n".join([*lines, "END", ""])


def on_rail(rng):
    """A program whose robot is carried by E1."""
    lines = [HEAD, f"; FORCE FX={rng.uniform(-200, 200):.1f} FY=90 FZ={rng.uniform(50, 200):.1f}"]
    for n in range(12):
        x, y, z = rng.uniform((0, -60, 0), (80, 60, 20))
        lines.append(f"LIN {{X {x:.3f},Y {y:.3f},Z {z:.3f},{TURNED},E1 {40.0 * n:.1f}}} C_DIS")
    return "\n".join([*lines, "END", ""])


@cache
def rail():
    _, robot = sample("cell_kr270.toml")
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "cell.toml"
        path.write_text(CELL_TEXT + "\n[external_axes.E1]\ndirection = [0, 1, 0]\n", encoding="utf-8")
        return cells.load(path), robot


def job(seed):
    """Return kind, files, cell and robot of a job, and what writes forces for it."""
    writer = carried.Writer(seed)
    rng = writer.rng
    kind = writer.pick("gcode", "krl", "krl", "splines", "rail", "circles", "corners", "lines", "posted")
    cell, robot = rail() if kind == "rail" else sample("cell_kr270.toml")
    count = int(rng.integers(12, 40))
    text = {
        "gcode": writer.gcode,
        "krl": writer.krl,
        "splines": lambda: splines(rng),
        "rail": lambda: on_rail(rng),
        "circles": lambda: programs.half_circles(count),
        "corners": lambda: programs.rounded_corners(count),
        "lines": lambda: programs.lines(count, programs.LINES["modal lines"]),
        "posted": lambda: programs.krl(count),
    }[kind]()
    gcode = kind in ("gcode", "circles", "corners", "lines")
    files = {"part.nc": text} if gcode else {"part.src": text, "part.dat": carried.START_DAT}
    return kind, files, cell, robot, writer


def told(nominal, files, cell, robot, rows):
    """Return the state of the verdict on files against a program, and why."""
    try:
        other = read_files(files, cell, robot)
        found = compare(nominal, other, robot, cell, rows)
    except PostprocError as cause:
        return "refused", [str(cause)]
    limit = cell.output.max_correction_mm * M_PER_MM
    verdict = comparison_summary(found, ProgramOrigin(Provenance("none"), {}), cell.tolerance, limit).verdict
    return verdict.state, verdict.reasons


class Planter:
    """Plants one difference into a corrected text."""

    def __init__(self, rng, text, result):
        self.rng, self.lines, self.result = rng, text.splitlines(keepends=True), result
        m = result.program.motions
        motion = result.motion
        self.cutting = result.output_line[(m.kind[motion] != PTP)]
        self.ends = result.output_line[(m.kind[motion] != PTP) & (result.t == 1.0)]
        self.keeps_text = result.program.keeps_text
        # a target that only divides a line may move along it, or be left out: the tool follows the same path
        segments = toolpath.segments(result.program, np.eye(4))
        divides = np.append(toolpath.continues(result.program, segments)[1:], False)
        self.corners = result.output_line[(m.kind[motion] != PTP) & (result.t == 1.0) & ~divides[motion]]

    def pick(self, values):
        return values[int(self.rng.integers(len(values)))] if len(values) else None

    def written(self, pattern, among=None):
        """Return a line, from 0, that matches."""
        numbers = range(len(self.lines)) if among is None else sorted({int(n) - 1 for n in among})
        return self.pick([n for n in numbers if re.search(pattern, self.lines[n], re.IGNORECASE)])

    def changed(self, number, name, least, begin=0):
        """Change a digit of a number by `least` at least; return the text, or None."""
        line = self.lines[number]
        found = [m for m in re.finditer(NUMBER.format(name=re.escape(name)), line) if m.start() >= begin]
        if not found:
            return None
        match = found[0]
        digits = [k for k, c in enumerate(match[2]) if c.isdigit()]
        for place in self.rng.permutation(digits).tolist():
            for digit in self.rng.permutation(10).tolist():
                new = match[2][:place] + str(digit) + match[2][place + 1 :]
                if least <= abs(float(new) - float(match[2])) <= 400.0:
                    return self.with_line(number, line[: match.start(2)] + new + line[match.end(2) :])
        return None

    def with_line(self, number, line):
        return "".join([*self.lines[:number], line, *self.lines[number + 1 :]])

    def coordinate(self):
        number = self.written(r"^\s*S?(LIN|CIRC)\b.*\{X", self.corners)
        return None if number is None else self.changed(number, self.pick("XYZ"), LEAST_MM, self.target(number))

    def angle(self):
        number = self.written(r"^\s*S?(LIN|CIRC)\b.*\bA -?\d", self.cutting)
        return None if number is None else self.changed(number, self.pick("ABC"), LEAST_DEG, self.target(number))

    def target(self, number):
        return self.lines[number].rfind("{")

    def auxiliary_point(self):
        number = self.written(r"^\s*S?CIRC\b", self.cutting)
        if number is None:
            return None
        line = self.lines[number]
        x, y = (float(value) for value in re.search(r"X (-?[\d.]+),Y (-?[\d.]+)", line).groups())
        row = np.flatnonzero(self.result.output_line == number + 1)[0]
        m, motion = self.result.program.motions, self.result.motion[row]
        centre = m.centre[motion] / M_PER_MM
        out = np.array([x, y]) - centre[:2]
        long = np.linalg.norm(out)
        if m.kind[motion] != CIRC or long < 1.0 or abs(m.normal[motion][2]) < 0.9:
            return None
        x, y = np.array([x, y]) + 0.2 * out / long
        return self.with_line(number, re.sub(r"X -?[\d.]+,Y -?[\d.]+", f"X {x:.4f},Y {y:.4f}", line, count=1))

    def axis_angle(self):
        number = self.written(r"^\s*PTP\b.*\bA1 ")
        known = self.keeps_text and number is not None
        return self.changed(number, self.pick(("A1", "A2", "A3", "A4", "A5", "A6")), LEAST_DEG) if known else None

    def external_axis(self):
        number = self.written(r"\bE1 -?\d", self.ends)
        return None if number is None else self.changed(number, "E1", LEAST_MM)

    def speed(self):
        number = self.written(r"^\s*\$VEL\.CP\s*=")
        if number is None:
            return None
        line = self.lines[number]
        return self.with_line(number, re.sub(r"=\s*([\d.]+)", lambda m: f"={float(m[1]) * 1.1:.6f}", line))

    def approximation(self):
        number = self.written(r"^\s*\$APO\.CDIS\s*=")
        if number is None or not self.keeps_text or self.written(r"\bC_DIS\b", self.ends) is None:
            return None
        line = self.lines[number]
        return self.with_line(number, re.sub(r"=\s*([\d.]+)", lambda m: f"={float(m[1]) + 0.3:.4f}", line))

    def frame(self):
        number = self.written(r"^\s*\$(BASE|TOOL)\s*=\s*\{.*X")
        return None if number is None else self.changed(number, self.pick("XYZABC"), LEAST_DEG)

    def no_approximation(self):
        number = self.written(r"\bC_DIS\b", self.ends)
        if number is None or not self.keeps_text:
            return None
        return self.with_line(number, self.lines[number].replace(" C_DIS", "", 1))

    def joint_move(self):
        number = self.written(r"^\s*LIN \{", self.ends)
        return None if number is None else self.with_line(number, self.lines[number].replace("LIN", "PTP", 1))

    def missing(self):
        number = self.written(r"^\s*S?(LIN|CIRC)\b", self.corners)
        return None if number is None else self.with_line(number, "")

    def twice(self):
        number = self.written(r"^\s*S?LIN\b(?!_REL)", self.ends)
        return None if number is None else self.with_line(number, 2 * self.lines[number])

    def exchanged(self):
        plain = [line.lstrip().startswith("LIN {") for line in self.lines]
        plain = [n for n in range(len(plain) - 1) if plain[n] and plain[n + 1]]
        number = self.pick(plain)
        if number is None:
            return None
        one, other = self.lines[number : number + 2]
        points = [np.array([float(m) for m in re.findall(r"[XYZ] (-?[\d.]+)", line)[:3]]) for line in (one, other)]
        if len(points[0]) < 3 or len(points[1]) < 3 or np.abs(points[1] - points[0]).max() < LEAST_MM:
            return None
        return "".join([*self.lines[:number], other, one, *self.lines[number + 2 :]])

    def force(self):
        number = self.written(r";\s*FORCE.*F[XYZ]=-?\d", self.ends)
        if number is None:
            return None
        match = self.pick(list(re.finditer(r"F[XYZ]=(-?[\d.]+)", self.lines[number])))
        value = float(match[1])
        if abs(value) < 1.0:
            return None
        line = self.lines[number]
        return self.with_line(number, line[: match.start(1)] + f"{-value:.3f}" + line[match.end(1) :])


PLANTS = (
    "coordinate", "coordinate", "angle", "auxiliary_point", "axis_angle", "external_axis", "speed", "approximation",
    "frame", "no_approximation", "joint_move", "missing", "twice", "exchanged", "force",
)  # fmt: skip


def attack(seed):
    """Try the job of a seed: return what came of it.

    :raises Wrong: a planted difference is not told, or one is told where none is.
    """
    kind, files, cell, robot, writer = job(seed)
    with tempfile.TemporaryDirectory() as folder:
        try:
            nominal = read_files(files, cell, robot)
            rows = carried.csv_of(writer, nominal, folder)
            result = correction.process(nominal, robot, cell, rows)
        except PostprocError:
            return "refused"
    if result.failed or not len(result):
        return "refused"
    written = {document.name: document.text for document in result.documents}
    name = result.documents[0].name
    state, stated = told(nominal, written, cell, robot, rows)
    rounded = any(issue.kind == "blending" for issue in result.issues)  # convert warns of it too
    if state != "ok" and not (rounded and state == "warning" and all("cuts the corner" in each for each in stated)):
        raise Wrong(f"seed {seed}, {kind}: nothing was planted, and compare says {state}: {stated}")
    planter = Planter(writer.rng, written[name], result)
    plant = writer.pick(*PLANTS)
    text = getattr(planter, plant)()
    if text is None or text == written[name]:
        return "nothing to plant"
    state, why = told(nominal, written | {name: text}, cell, robot, rows)
    if state == "ok" or why == stated:
        was, now = written[name].splitlines(), text.splitlines()
        lines = [n for n, (a, b) in enumerate(zip(was, now, strict=False), 1) if a != b][:2]
        told_lines = "\n".join(f"{n}: {was[n - 1]}\n{n}: {now[n - 1]}" for n in lines)
        raise Wrong(f"seed {seed}, {kind}: {plant} is not told\n{told_lines}\n{why}")
    return plant


def main() -> int:
    """Try programs, and count what came of them."""
    options = parser(__doc__).parse_args()
    return try_seeds(options, attack)


if __name__ == "__main__":
    raise SystemExit(main())
