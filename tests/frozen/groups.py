"""Groups of cases: samples, programs of the tests, and seeds of each generator."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np

from tests.attack import carried, gcode_generator, inputs, krl, krl_generator, krl_jobs
from tests.frozen.case import Case
from tests.places import ROOT, SAMPLES

_RECORDED = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "tests" / "dialects").glob("test_krl_*.py"))
"""Tests whose KRL programs are cases."""
_CUTS = """\
mode,ap_mm,ae_mm,rpm,feed_mm_per_min,Fx,Fy,Fz,sigma_N
slot,2.4,,3900,280.8,-72,118,41,3
slot,2.4,,3900,561.6,-101,187,58,3
slot,2.4,,3900,842.4,-127,251,70,3
slot,1.2,,3900,561.6,-54,90,31,3
slot,1.2,,3900,842.4,-66,122,38,3
"""
"""Mean forces of slots, made up."""


def sample_files(*more: str) -> dict[str, bytes]:
    """Return files of the samples by their names."""
    return {name: (SAMPLES / name).read_bytes() for name in more}


def samples(_: int) -> Iterator[Case]:
    """Every sample by every command that takes it."""
    jobs = [
        ("pocket.nc", "cell_kr270.toml", ()),
        ("pocket.nc", "cell_kr16.toml", ()),
        ("pocket.nc", "cell_irb6700.toml", ("--to", "rapid")),
        ("pocket.nc", "cell_kr270.toml", ("--nominal",)),
        ("pocket.nc", "cell_kr270.toml", ("--linearize-arcs", "--lines-per-file", "200")),
        ("freeform.nc", "cell_kr270.toml", ("--forces", "freeform.forces.csv")),
        ("plate.nc", "cell_kr270.toml", ("--process", "plate.process.toml")),
        ("inline.src", "cell_kr270.toml", ()),
        ("long_lin.src", "cell_kr16.toml", ("--forces", "long_lin.forces.csv")),
    ]
    for program, cell, options in jobs:
        name = "-".join([Path(program).stem, Path(cell).stem, *(o.strip("-") for o in options)]).replace("/", "_")
        more = [o for o in options if (SAMPLES / o).is_file()]
        data = ["inline.dat"] if program == "inline.src" else []
        files = sample_files(program, cell, *more, *data)
        if "plate.process.toml" in more:
            files |= sample_files("plate.blank.stl")
        out = f"out/{Path(program).stem}" + (".mod" if "rapid" in options else ".src")
        steps = [("postproc", "convert", program, "--cell", cell, *options, "-o", "out", "--json")]
        inputs_ = [o for o in options if o in ("--forces", "--process") or o in more]
        steps.append(("postproc", "predict", program, "--cell", cell, *inputs_, "-o", "predicted", "--json"))
        steps.append(("postproc", "compare", program, out, "--cell", cell, "-o", "compared"))
        if "--process" in options:
            steps.append(("postproc", "forces", program, "--cell", cell, *inputs_, "-o", "forces"))
        yield Case(name, files, tuple(steps))


def models(_: int) -> Iterator[Case]:
    """Readings of a simulated robot: plans, identification, validation; the place of a part; test cuts."""
    with tempfile.TemporaryDirectory() as place:
        command = [sys.executable, str(SAMPLES / "paper_study" / "simulator.py"), place]
        subprocess.run(command, check=True, capture_output=True)
        made = {path.name: path.read_bytes() for path in Path(place).iterdir()}
    experiment = ("--experiment", "experiment.toml")
    files = made | sample_files("cell_kr270.toml", "pocket.nc")
    milled = ("--cell", "cell_kr270.toml", "--program", "pocket.nc")
    identified = ("postproc", "identify", "elastostatics", "measurements.csv", *experiment, "-o", "my_robot")
    validated = ("postproc", "identify", "validate", "my_robot", "validation.csv", *experiment, *milled)
    yield Case("identify", files, (identified, validated))
    rig = made["experiment.toml"] + b"\n[rig]\nmass_kg = 275\nmax_angle_deg = 30\n"
    few = ("--configurations", "6", "--q2-levels", "3", "--test-poses", "5")
    planned = ("postproc", "plan", "poses", *experiment, *milled, *few, "-o", "plan.csv", "--json")
    yield Case("plan", files | {"experiment.toml": rig}, (planned,))
    region = ("--region", "X=1500:1700,A=-30:30")
    placed = ("postproc", "place", "pocket.nc", "--cell", "cell_kr270.toml", *region, "-o", "place")
    yield Case("place", files, (placed,))
    process = ("--process", "plate.process.toml")
    proposed = ("postproc", "identify", "forces", "--propose", *process, "-o", "testcuts.nc")
    fitted = ("postproc", "identify", "forces", "readings.csv", *process, "-o", "material.toml")
    files = sample_files("plate.process.toml", "plate.blank.stl") | {"readings.csv": _CUTS.encode()}
    yield Case("forces", files, (proposed, fitted))


def collection(_: int) -> Iterator[Case]:
    """G-code as CAM systems write it."""
    for path in sorted([*(ROOT / "tests/dialects/collection").iterdir(), *(ROOT / "tests/dialects/posts").iterdir()]):
        program = path.name if path.suffix in (".nc", ".ngc", ".tap", ".cnc", ".gcode", ".mpf") else f"{path.name}.nc"
        files = {program: path.read_bytes(), "cell.toml": _wide_cell("cell_kr270.toml")}
        yield Case(path.name, files, (("postproc", "convert", program, "--cell", "cell.toml", "-o", "out", "--json"),))


def gcode(seeds: int) -> Iterator[Case]:
    """Random jobs in G-code with forces; they are written as KRL and predicted as written."""
    for seed in range(seeds):
        cell = ("cell_kr270.toml", "cell_kr16.toml")[seed % 2]
        files = {"part.nc": carried.Writer([1, seed]).gcode().encode(), "cell.toml": _wide_cell(cell)}
        yield Case(f"{seed:05d}", files, _converted("part.nc"))


def gcode_modes(seeds: int) -> Iterator[Case]:
    """Random G-code of `tests.attack.gcode`, a third of it spoilt."""
    for seed in range(seeds):
        rng = random.Random(seed)
        made = gcode_generator.Generator(rng)
        made.program()
        data = inputs.spoilt(made.text(1), rng) if seed % 3 == 2 else made.text(1).encode()
        files = {"part.nc": data, "cell.toml": _wide_cell("cell_kr270.toml")}
        step = ("postproc", "convert", "part.nc", "--cell", "cell.toml", "-o", "out", "--json")
        yield Case(f"{seed:05d}", files, (step,))


def rapid(seeds: int) -> Iterator[Case]:
    """Random jobs in G-code that are written as RAPID."""
    for seed in range(seeds):
        files = {"part.nc": carried.Writer([2, seed]).gcode().encode(), "cell.toml": _wide_cell("cell_irb6700.toml")}
        steps = (
            ("postproc", "convert", "part.nc", "--cell", "cell.toml", "--to", "rapid", "-o", "out", "--json"),
            ("postproc", "predict", "out/part.mod", "--cell", "cell.toml", "-o", "predicted", "--json"),
        )
        yield Case(f"{seed:05d}", files, steps)


def krl_lines(seeds: int) -> Iterator[Case]:
    """Random KRL without loops and calls; it is corrected and predicted as written."""
    for seed in range(seeds):
        text = carried.Writer([3, seed]).krl()
        files = {"part.src": text.encode(), "part.dat": carried.START_DAT.encode(), "cell.toml": _wide_cell()}
        yield Case(f"{seed:05d}", files, _converted("part.src"))


def krl_jobs_(seeds: int) -> Iterator[Case]:
    """Random KRL with loops, calls, branches and forces; some with motions that stay, some in several files."""
    for seed in range(seeds):
        rng = np.random.default_rng([4, seed])
        keep = seed % 3 == 0
        job = krl_jobs.Job(rng, keep=keep, unknown=bool(rng.random() < 0.6), forces=bool(rng.random() < 0.85))
        files = {name: text.encode() for name, text in job.files.items()} | {"cell.toml": _wide_cell()}
        options = (["--keep-unresolved"] if keep else []) + (["--lines-per-file", "25"] if seed % 4 == 1 else [])
        yield Case(f"{seed:05d}", files, _converted("part.src", *options))


def krl_random(seeds: int) -> Iterator[Case]:
    """Random KRL of every kind, read and rewritten; every fourth program is damaged."""
    cell = msgspec.json.encode(krl.cell("."))
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        files = krl_generator.Generator(rng).programs()
        if seed % 4 == 3:
            for _ in range(int(rng.integers(1, 4))):
                text = files["part.src"]
                at, other = (int(n) for n in rng.integers(len(text) + 1, size=2))
                piece = [krl.PIECES[int(rng.integers(len(krl.PIECES)))], text[other : other + 40], ""][seed // 4 % 3]
                files["part.src"] = text[:at] + piece + text[at + (5 if seed % 8 == 3 else 0) :] or " "
        data = {name: text.encode() for name, text in files.items()} | {"cell.json": cell}
        yield Case(f"{seed:05d}", data, (("krl", "cell.json", "part.src", "part.dat"),))


def krl_combined(seeds: int) -> Iterator[Case]:
    """Random KRL that combines features, read and rewritten; every other program with motions that stay."""
    for seed in range(seeds):
        keep = seed % 2 == 1
        rng = np.random.default_rng(seed + (krl.KEPT if keep else krl.MIXED))
        files = krl_generator.Generator(rng, more=True, mixed=True, keep=keep).programs()
        cell = msgspec.json.encode(krl.cell(".", keep=keep))
        data = {name: text.encode() for name, text in files.items()} | {"cell.json": cell}
        yield Case(f"{seed:05d}", data, (("krl", "cell.json", "part.src", "part.dat"),))


def krl_tests(_: int) -> Iterator[Case]:
    """KRL programs that the tests read, recorded while they run."""
    with tempfile.TemporaryDirectory() as place:
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "2", "-p", "tests.frozen.recording", *_RECORDED]
        environment = os.environ | {"FROZEN_RECORDS": place, "CI": "1"}
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"the tests fail, so that their programs are not known:\n{done.stdout[-2000:]}")
        for folder in sorted(Path(place).iterdir()):
            names = msgspec.json.decode((folder / "names.json").read_bytes(), type=list[str])
            files = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
            files.pop("names.json")
            yield Case(folder.name, files, (("krl", "cell.json", *names),))


def _converted(program: str, *options: str) -> tuple[tuple[str, ...], ...]:
    """Return the steps: convert, and predict what is written."""
    return (
        ("postproc", "convert", program, "--cell", "cell.toml", *options, "-o", "out", "--json"),
        ("postproc", "predict", "out/part.src", "--cell", "cell.toml", "-o", "predicted", "--json"),
    )


def _wide_cell(name: str = "cell_kr270.toml") -> bytes:
    """Return a cell of the samples that allows larger corrections."""
    text = (SAMPLES / name).read_text(encoding="utf-8")
    head, _, tail = text.partition("max_correction_mm = ")
    return (f"{head}max_correction_mm = 40.0{tail.partition(chr(10))[1]}{tail.partition(chr(10))[2]}").encode()


GROUPS: dict[str, Callable[[int], Iterator[Case]]] = {
    "samples": samples,
    "models": models,
    "collection": collection,
    "gcode": gcode,
    "gcode-modes": gcode_modes,
    "rapid": rapid,
    "krl-lines": krl_lines,
    "krl-jobs": krl_jobs_,
    "krl-random": krl_random,
    "krl-combined": krl_combined,
    "krl-tests": krl_tests,
}
QUICK = {"krl-random": 400, "krl-combined": 200, "krl-tests": 500, "krl-jobs": 25, "krl-lines": 25}
"""Cases of a group that `--quick` runs; of others 12."""
