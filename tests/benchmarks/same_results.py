"""Do two installed versions come to the same numbers? All samples, and random programs on random robots.

Run: python -m tests.benchmarks.same_results BEFORE/bin/postproc AFTER/bin/postproc [--programs 200] [--seed 7]

Both convert the same files. Compared are `targets.csv`, column by column (those that both have), and the written KRL:
the text but for its numbers, and the numbers. Printed is the largest difference of each column, and which programs
differ by more than a digit of what is printed (tip and command: a command that is rounded the other way moves the tip
by as much as its last digit says).
"""

from __future__ import annotations

import argparse
import csv
import re
import subprocess
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np

from tests.attack.carried import START_DAT, Writer
from tests.places import SAMPLES

JOBS = (
    ("pocket.nc", "cell_kr270.toml", None),
    ("pocket.nc", "cell_kr16.toml", None),
    ("freeform.nc", "cell_kr270.toml", "freeform.forces.csv"),
    ("inline.src", "cell_kr270.toml", None),
    ("long_lin.src", "cell_kr16.toml", "long_lin.forces.csv"),
)
"""Program, cell and forces of each sample."""
MODELS = SAMPLES.parent / "robot_models"
_PER_CELL = 10
_NUMBER = re.compile(r"[-+]?\d+\.\d+")
_ANGLES = {"A", "B", "C", "A_cmd", "B_cmd", "C_cmd"}
_DIGIT = 1.001e-6
_COARSER = {"A1": 1e-5, "A2": 1e-5, "A3": 1e-5, "A4": 1e-5, "A5": 1e-5, "A6": 1e-5, "KRL": 1e-4, "after_mm": 1e-4}
_COARSER |= {f"{name}_cmd": 1e-4 for name in "XYZ"} | {f"{name}_cmd": 1e-5 for name in "ABC"}
"""One digit of what is printed where it is more than 1e-6; three decimals of KRL input are told by its text."""


def random_model(rng: np.random.Generator, name: str) -> str:
    """Return model.toml of a robot of the library with more of what a model may have."""
    text = (MODELS / name / "model.toml").read_text(encoding="utf-8")
    if rng.random() < 0.4:
        text = text.replace('reference = "calibrated"', 'reference = "rigid"')
    if rng.random() < 0.4:
        for joint in (*(f"A{k}" for k in range(1, 7)), "flange"):
            values = rng.normal(size=6) * [0.5, 0.5, 0.5, 0.03, 0.03, 0.03]
            names = ("X_mm", "Y_mm", "Z_mm", "RX_deg", "RY_deg", "RZ_deg")
            text += f'\n[geometry.{joint}]\nsource = "made up"\n'
            text += "".join(f"{key} = {value:.4f}\n" for key, value in zip(names, values, strict=True))
    if rng.random() < 0.4:
        for joint in ("base", "A2", "A3", "A5"):
            text += f'\n[links.{joint}]\nsource = "made up"\nX_um_per_N = {rng.uniform(0, 0.02):.4f}\n'
            text += f"RZ_urad_per_Nm = {rng.uniform(0, 0.2):.3f}\nend_RY_urad_per_Nm = {rng.uniform(0, 0.2):.3f}\n"
    if rng.random() < 0.4:
        stiffening = r"\1\nstiffening = [{ torque_Nm = 300.0, compliance_urad_per_Nm = 0.05 }]"
        text = re.sub(r"(\[joints\.A[135]\]\ncompliance_urad_per_Nm = [0-9.]+)", stiffening, text)
    return text


def random_programs(folder: Path, seed: int, count: int) -> list[tuple[Path, list[Path]]]:
    """Write cells, robots and programs into a folder; return cells with their programs."""
    made = []
    for first in range(0, count, _PER_CELL):
        rng = np.random.default_rng([seed, first])
        name, cell = [("kuka_kr270", "cell_kr270.toml"), ("kuka_kr16_2", "cell_kr16.toml")][first // _PER_CELL % 3 == 2]
        place = folder / f"{first:04d}"
        (place / "model").mkdir(parents=True)
        (place / "model" / "robot.urdf").write_bytes((MODELS / name / "robot.urdf").read_bytes())
        (place / "model" / "model.toml").write_text(random_model(rng, name), encoding="utf-8")
        text = (SAMPLES / cell).read_text(encoding="utf-8").replace(f'"{name}"', '"model"')
        text = re.sub(r"max_correction_mm = [\d.]+", "max_correction_mm = 40.0", text)
        if rng.random() < 0.4:
            text += f"\n[payload]\nmass_kg = {rng.uniform(1, 8):.1f}\nX = 20.0\nZ = {rng.uniform(0, 150):.1f}\n"
        (place / "cell.toml").write_text(text, encoding="utf-8")
        programs = []
        for number in range(first, min(first + _PER_CELL, count)):
            writer = Writer([seed, number])
            program = place / f"p{number}.nc"
            if name == "kuka_kr270" and number % 2:
                program = program.with_suffix(".src")
                program.write_text(writer.krl().replace("DEF part", f"DEF {program.stem}"), encoding="utf-8")
                program.with_suffix(".dat").write_text(START_DAT.replace("DEFDAT part", f"DEFDAT {program.stem}"))
            else:
                program.write_text(writer.gcode(), encoding="utf-8")
            programs.append(program)
        made.append((place / "cell.toml", programs))
    return made


def converted(postproc: str, cell: Path, programs: list[Path], forces: Path | None, out: Path) -> None:
    """Let a version convert programs; what it refuses has no files."""
    command = [postproc, "convert", *map(str, programs), "--cell", str(cell), "-o", str(out), "--jobs", "1"]
    command += [] if forces is None else ["--forces", str(forces)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1, 3) or "Traceback" in done.stderr:
        raise SystemExit(f"{' '.join(command)}: exit code {done.returncode}\n{done.stderr}")


def columns(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a file of targets."""
    with path.open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    table = np.array([[float(value or "nan") for value in row] for row in rows]).reshape(len(rows), len(head))
    return dict(zip(head, table.T, strict=True))


def krl(folder: Path, name: str) -> tuple[str, np.ndarray]:
    """Return the written text but for its numbers and the line of its origin, and the numbers."""
    files = sorted(path for path in folder.glob(f"{name}*.*") if path.suffix in (".src", ".dat"))
    text = "\n".join(path.read_bytes().decode() for path in files)
    text = re.sub(r"(?m)^;POSTPROC.*$", "", text)
    return _NUMBER.sub("#", text), np.array([float(number) for number in _NUMBER.findall(text)])


def apart(one: np.ndarray, other: np.ndarray, *, turns: bool) -> float:
    """Return the largest difference; of angles, whole turns do not count."""
    off = np.abs(one - other)
    off = np.where(turns & (off > 359.0), np.abs(off - 360.0), off)
    return float(np.where(np.isnan(one) & np.isnan(other), 0.0, off).max(initial=0.0))


def differences(one: Path, other: Path, name: str) -> dict[str, float] | str:
    """Return the largest difference of each column and of the KRL, or what cannot be compared."""
    csvs = [folder / f"{name}.targets.csv" for folder in (one, other)]
    there = [path.exists() for path in csvs]
    if there != [True, True]:
        return "both refused" if there == [False, False] else f"written by {'the first' if there[0] else 'the second'}"
    before, after = (columns(path) for path in csvs)
    if len(before["t"]) != len(after["t"]):
        return f"{len(before['t'])} and {len(after['t'])} targets"
    found = {key: apart(before[key], after[key], turns=key in _ANGLES) for key in before if key in after}
    texts, numbers = zip(*(krl(folder, name) for folder in (one, other)), strict=True)
    if texts[0] != texts[1]:
        return "the text of the KRL differs"
    return found | {"KRL": apart(*numbers, turns=True)}


def main() -> None:
    """Print how two versions differ."""
    options = argparse.ArgumentParser()
    options.add_argument("before")
    options.add_argument("after")
    options.add_argument("--programs", type=int, default=200)
    options.add_argument("--seed", type=int, default=7)
    given = options.parse_args()
    worst: dict[str, float] = defaultdict(float)
    told: list[str] = []
    count: dict[str, int] = defaultdict(int)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        jobs = [(SAMPLES / cell, [SAMPLES / name], forces and SAMPLES / forces) for name, cell, forces in JOBS]
        jobs += [(cell, programs, None) for cell, programs in random_programs(folder, given.seed, given.programs)]
        for number, (cell, programs, forces) in enumerate(jobs):
            outs = [folder / f"{number}.{which}" for which in ("before", "after")]
            for postproc, out in zip((given.before, given.after), outs, strict=True):
                converted(postproc, cell, programs, forces, out)
            for program in programs:
                found = differences(*outs, program.stem)
                if isinstance(found, str):
                    count[found if found == "both refused" else "not alike"] += 1
                    told += [] if found == "both refused" else [f"{program.name} ({cell.name}): {found}"]
                    continue
                over = {key: off for key, off in found.items() if off > max(_DIGIT, 1.001 * _COARSER.get(key, 0.0))}
                count["more than a digit" if over else "within a digit" if any(found.values()) else "equal"] += 1
                told += [f"{program.name} ({cell.name}): {over}"] if over else []
                for key, off in found.items():
                    worst[key] = max(worst[key], off)
    print("programs:", dict(count))
    print("largest difference:", {key: float(f"{off:.3g}") for key, off in worst.items() if off})
    print(*told, sep="\n")


if __name__ == "__main__":
    main()
