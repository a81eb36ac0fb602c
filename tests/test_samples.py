"""Every sample is made by our own script and does the real job."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

import pytest

from postproc.jobs import Settings, convert_all, find_jobs
from tests.oracle.krl_grammar import check
from tests.places import SAMPLES

_NUMBER = re.compile(r"-?\d+\.?\d*")


def _script():
    return runpy.run_path(str(SAMPLES / "make_samples.py"))


def test_samples_are_what_the_script_writes():
    """Numbers may differ by one in the last place where another processor rounds otherwise."""
    made = _script()["make"]()
    kinds = (".nc", ".apt", ".csv", ".src", ".dat", ".toml", ".stl")
    found = (path for folder in (SAMPLES, SAMPLES / "gallery") for path in folder.iterdir())
    there = {path.relative_to(SAMPLES).as_posix() for path in found if path.suffix in kinds}
    assert there == set(made)
    for name, text in made.items():
        committed = (SAMPLES / name).read_bytes().decode()
        if committed == text:
            continue
        assert _NUMBER.sub("", committed) == _NUMBER.sub("", text), name
        pairs = zip(_NUMBER.findall(committed), _NUMBER.findall(text), strict=True)
        assert all(abs(float(a) - float(b)) <= 0.11 for a, b in pairs), name


def test_sizes_are_those_promised():
    text = {path.name: path.read_text() for path in SAMPLES.iterdir() if path.suffix in (".nc", ".src")}
    assert 200 <= text["pocket.nc"].count("\n") <= 400
    assert text["freeform.nc"].count("\n") >= 20_000
    assert text["long_lin.src"].count("LIN {") >= 5_000
    assert "\r\n" in (SAMPLES / "inline.src").read_bytes().decode()


PLAIN = re.compile(r"LIN \{X -?\d+\.\d+,Y -?\d+\.\d+,Z -?\d+\.\d+,A -?\d+\.\d+,B -?\d+\.\d+,C -?\d+\.\d+\}( C_DIS)?\s*")


def without_most_plain_lines(text):
    """Return a program with every fiftieth of its lines LIN {…} with all six numbers: the grammar is slow."""
    lines = text.splitlines(keepends=True)
    plain = [k for k, line in enumerate(lines) if PLAIN.fullmatch(line)]
    dropped = {k for number, k in enumerate(plain) if number % 50}
    return "".join(line for k, line in enumerate(lines) if k not in dropped)


@pytest.mark.parametrize(
    ("program", "cell", "forces"),
    [
        ("pocket.nc", "cell_kr270.toml", None),
        ("pocket.nc", "cell_kr16.toml", None),
        ("pocket.nc", "cell_irb6700.toml", None),
        ("freeform.nc", "cell_kr270.toml", "freeform.forces.csv"),
        ("inline.src", "cell_kr270.toml", None),
        ("long_lin.src", "cell_kr16.toml", "long_lin.forces.csv"),
    ],
)
def test_sample_is_corrected_within_tolerance_and_far_from_limits(tmp_path, program, cell, forces):
    given = None if forces is None else SAMPLES / forces
    to = "rapid" if "irb" in cell else None
    jobs = find_jobs([str(SAMPLES / program)], output=tmp_path, forces=given, to=to)
    (outcome,) = convert_all(jobs, Settings(SAMPLES / cell))
    assert outcome.code == 0, (outcome.message, outcome.issues)
    for path in (*tmp_path.glob("*.src"), *tmp_path.glob("*.dat")):
        check(path.name, without_most_plain_lines(path.read_bytes().decode("cp1252")))
    content = outcome.summary
    assert content.before.max_mm > 0.1
    assert content.after.max_mm < 0.0011
    assert content.tolerance_held is not False
    assert content.between_max_mm <= content.tolerance_mm
    assert content.blending.max_mm <= max(0.05, content.blending.programmed_max_mm + content.tolerance_mm)
    assert content.limits.min_joint_margin_deg > 10.0
    assert content.limits.min_singular_value > 0.2
    kinds = {issue.kind for issue in content.issues}
    assert kinds <= {"blending", "force-rating", "home-from-cell", "stop-inserted", "tool-load"}
    assert "force-rating" not in {issue.kind for issue in content.issues if issue.level != "info"}


def test_the_gallery_states_what_its_conversions_print(tmp_path):
    """Each row of the table of docs/gallery.md against `convert` of that part, but for the long freeform surface."""
    text = (SAMPLES.parent / "docs" / "gallery.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \[[^]]*\]\(#([\w-]+)\) \| [^|]* \| ([\d.]+) \| ([\d.]+) \|", text, re.M)
    shown = {anchor: (float(before), float(u95)) for anchor, before, u95 in rows}
    parts = {
        "pocket": ("pocket.nc", "cell_kr270.toml", None),
        "drilling": ("gallery/drilling.nc", "cell_kr270.toml", "gallery/drilling.process.toml"),
        "dome-five-axes": ("gallery/dome.nc", "gallery/cell_five_axes.toml", None),
        "saddle-cutter-locations": ("gallery/saddle.apt", "cell_kr270.toml", None),
        "long-plate": ("gallery/long_plate.nc", "cell_kr270.toml", "gallery/long_plate.process.toml"),
    }
    assert set(parts) | {"freeform"} == set(shown)
    for anchor, (program, cell, process) in parts.items():
        forces = None if process is None else SAMPLES / process
        (outcome,) = convert_all(
            find_jobs([str(SAMPLES / program)], output=tmp_path, forces=forces), Settings(SAMPLES / cell)
        )
        assert outcome.code == 0, outcome.message
        report = json.loads((tmp_path / f"{Path(program).stem}.report.json").read_text(encoding="utf-8"))
        assert report["verdict"]["state"] == "ok", anchor
        assert (report["before"]["max_mm"], report["u95"]["max_mm"]) == pytest.approx(shown[anchor], rel=0.05), anchor
