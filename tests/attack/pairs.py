"""Random programs converted with and without correction: `compare` must find that each pair belongs together.

python -m tests.attack.pairs --count 40 [--seed 0]

Each program is compared with the corrected one, and so is the nominal one that `convert --nominal` writes: both without
forces and with those that the conversion had. Every verdict must be `ok`; without the forces `compare` may ask
for them.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from postproc.errors import PostprocError
from postproc.jobs import Settings, convert_all, find_jobs
from postproc.jobs.comparison_files import CompareRequest, compare_programs
from tests.attack.driver import Wrong, parser, try_seeds
from tests.comparison.krl_moves import TURNED
from tests.places import CELL_FILE

FRAMES = ("BASE", "FEED", "TOOL")


class Programs:
    """Makes programs and their forces up from one seed."""

    def __init__(self, seed):
        self.rng = np.random.default_rng([seed, 27])

    def pick(self, *options):
        return options[int(self.rng.integers(len(options)))]

    def force(self):
        values = zip(("FX", "FY", "FZ"), self.rng.normal(size=3) * self.pick(50, 200, 400), strict=True)
        return "FORCE " + " ".join(f"{k}={v:.2f}" for k, v in values) + f" FRAME={self.pick(*FRAMES)}"

    def path(self, count):
        """Lines and arcs in a plane: (kind, x, y, i, j), in mm."""
        spot = np.zeros(2)
        for _ in range(count):
            if self.rng.random() < 0.5:
                spot = np.clip(np.round(spot + self.rng.normal(size=2) * self.pick(1, 8, 30), 3), -90, 90)
                yield "G1", *spot, 0.0, 0.0
                continue
            radius, one = self.rng.uniform(1, 30), self.rng.uniform(0, 2 * np.pi)
            two = one if self.rng.random() < 0.2 else self.rng.uniform(0, 2 * np.pi)
            i, j = -radius * np.cos(one), -radius * np.sin(one)
            spot = np.round(spot + np.array([i + radius * np.cos(two), j + radius * np.sin(two)]), 4)
            yield self.pick("G2", "G3"), *spot, i, j

    def gcode(self, comments):
        lines = ["%", "(part)", "G90 G21 G17", self.pick("", "G64 P0.05", "G61"), "S9000 M3 F900", "G0 X0 Y0 Z20"]
        loop = self.rng.random() < 0.25
        if comments:
            lines.append(f"({self.force()})")
        lines.append("G1 Z2")
        body = []
        for kind, x, y, i, j in self.path(int(self.rng.integers(4, 14))):
            if comments and self.rng.random() < 0.3:
                body.append(f"({self.pick(self.force(), self.force(), 'FORCE OFF')})")
            arc = f" I{i:.5f} J{j:.5f}" if kind != "G1" else ""
            down = f" Z{self.rng.uniform(-5, 2):.3f}" if self.rng.random() < 0.15 else ""
            body.append(f"{kind} X{x:.4f} Y{y:.4f}{arc}{down}")
            if self.rng.random() < 0.06:
                body += ["G0 Z20", f"G0 X{x:.4f} Y{y:.4f}", "G1 Z1"]
        if loop:  # a pocket, level by level
            body = ["G1 X0 Y0 Z2", *body]
            body = [line for n in range(3) for line in (f"G1 Z{1 - n}", *body)]
        return "\n".join([*lines, *body, "G0 Z30", "M5", "M2", "%", ""])

    def krl(self, comments):
        lines = [
            "DEF part( )", "DECL INT n", "$VEL.CP=0.05", "$APO.CDIS=0.5",
            "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}", f"LIN {{X 0,Y 0,Z 20,{TURNED}}}",
        ]  # fmt: skip
        if comments:
            lines.append(f"; {self.force()}")
        body, spot = [], np.zeros(2)
        for kind, x, y, _, _ in self.path(int(self.rng.integers(4, 12))):
            new = np.array([x, y])
            if comments and self.rng.random() < 0.3:
                body.append(f"; {self.force()}")
            chord = np.linalg.norm(new - spot)
            if kind == "G1" or chord < 1.0:
                body.append(f"LIN {{X {x:.4f},Y {y:.4f},Z 0,{TURNED}}}{self.pick('', ' C_DIS')}")
            else:
                across = np.array([spot[1] - y, x - spot[0]]) / chord
                via = (spot + new) / 2 + across * chord * self.pick(-0.4, 0.2, 0.5)
                end = self.pick("", ",CA 300" if chord > 5 else "")
                body.append(f"CIRC {{X {via[0]:.4f},Y {via[1]:.4f},Z 0}},{{X {x:.4f},Y {y:.4f},Z 0,{TURNED}}}{end}")
                if end:
                    body.append(f"LIN {{X {x:.4f},Y {y:.4f},Z 0,{TURNED}}}")
            spot = new
        if self.rng.random() < 0.4:
            body = ["FOR n=1 TO 3", f"LIN {{X 0,Y 0,Z 0,{TURNED}}}", *body, "ENDFOR"]
        return "\n".join([*lines, *body, f"LIN {{X 0,Y 0,Z 30,{TURNED}}}", "END", ""])

    def table(self, text):
        """Forces by line, some by place on the line, a step at its start among them."""
        cutting = [
            n for n, line in enumerate(text.splitlines(), 1) if line.startswith(("G1", "G2", "G3", "LIN", "CIRC"))
        ]
        rows = ["line,t,Fx,Fy,Fz,frame"]
        for line in cutting:
            if self.rng.random() < 0.2:
                continue
            frame, places = self.pick(*FRAMES[:2]), [0.0, *np.sort(self.rng.random(2)).round(3), 1.0]
            for t in places if self.rng.random() < 0.7 else [0.0, 1.0]:
                rows.append(f"{line},{t}," + ",".join(f"{f:.2f}" for f in self.rng.normal(size=3) * 150) + f",{frame}")
        return "\n".join([*rows, ""])

    def plain_table(self, text):
        """Forces by line, each of which comes up over the ramp of the cell."""
        cutting = [
            n for n, line in enumerate(text.splitlines(), 1) if line.startswith(("G1", "G2", "G3", "LIN", "CIRC"))
        ]
        rows = ["line,Fx,Fy,Fz,frame"]
        for line in cutting:
            if self.rng.random() < 0.8:
                force = ",".join(f"{f:.2f}" for f in self.rng.normal(size=3) * 150)
                rows.append(f"{line},{force},{self.pick(*FRAMES)}")
        return "\n".join([*rows, ""])


def converted(program, folder, forces, mode):
    """Convert a program; return the outcome."""
    jobs = find_jobs([str(program)], output=folder, forces=forces)
    return next(iter(convert_all(jobs, Settings(CELL_FILE, mode=mode))))


def compared(nominal, corrected, forces, folder):
    """Compare two programs: return exit code, state of the verdict and its reasons."""
    request = CompareRequest(nominal=nominal, corrected=corrected, cell=CELL_FILE, forces=forces, output=folder)
    request_made = compare_programs(request)
    verdict = request_made.summary.verdict
    counts = {name: getattr(request_made.summary, name) for name in ("only_nominal", "only_corrected")}
    return request_made.code, verdict.state, verdict.reasons, counts


def compared_pairs(seed, folder):
    """Convert the program of a seed and compare: return its kind and what the comparisons found, by pair."""
    maker, folder = Programs(seed), Path(folder)
    dialect = maker.pick("gcode", "gcode", "krl")
    loads = maker.pick("comments", "comments", "by place", "by line", "none")
    text = getattr(maker, dialect)(loads == "comments")
    source = folder / ("part.nc" if dialect == "gcode" else "part.src")
    source.write_text(text, encoding="utf-8")
    forces = None
    if loads.startswith("by"):
        forces = folder / "forces.csv"
        forces.write_text(maker.table(text) if loads == "by place" else maker.plain_table(text), encoding="utf-8")
    outcomes = [converted(source, folder / name, forces, mode) for name, mode in (("c", "convert"), ("n", "nominal"))]
    if any(outcome.code for outcome in outcomes):
        return f"{dialect}, {loads}", None
    nominal, corrected = folder / "n" / "part.src", folder / "c" / "part.src"
    carried = folder / "n" / "part.forces.csv"
    if nominal.read_bytes() == source.read_bytes():
        carried = forces or carried
    pairs = {"nominal": (nominal, None), "source": (source, forces)}
    if carried.exists():
        pairs["nominal with forces"] = nominal, carried
    if forces is not None:
        pairs["source without forces"] = source, None
    judgements = {}
    for name, (one, loads_of_one) in pairs.items():
        try:
            judgements[name] = compared(one, corrected, loads_of_one, folder / f"compared {len(judgements)}")
        except PostprocError as cause:
            judgements[name] = 1, "refused", [str(cause)], {}
    return f"{dialect}, {loads}", judgements


def asks_for_forces(pair, why):
    """Whether `compare` has one reason for its doubt alone: it is not given the forces of the nominal program."""
    reasons = [why] if isinstance(why, str) else why
    is_without = pair in ("nominal", "source without forces")
    return is_without and bool(reasons) and all("Give" in reason and "--forces" in reason for reason in reasons)


def attack(seed):
    """Compare the pairs of a seed; return its kind and the number of pairs.

    :raises Wrong: `compare` doubts a pair.
    """
    with tempfile.TemporaryDirectory() as name:
        kind, pairs = compared_pairs(seed, Path(name))
    if pairs is None:
        return "refused by convert"
    doubts = [
        f"{pair}: {state} {why} {counts}"
        for pair, (code, state, why, counts) in pairs.items()
        if any(counts.values()) or ((code, state) != (0, "ok") and not asks_for_forces(pair, why))
    ]
    if doubts:
        raise Wrong("\n".join([kind, *doubts]))
    return f"{kind}: {len(pairs)} pairs"


def main():
    """Compare pairs of random programs, and count."""
    return try_seeds(parser(__doc__).parse_args(), attack)


if __name__ == "__main__":
    raise SystemExit(main())
