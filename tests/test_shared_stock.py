"""Programs of one run that cut the same material of one stock."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from msgspec.structs import replace

from postproc.jobs import runs
from postproc.jobs.programs import Job
from tests.commands import run
from tests.machining.setting import gcode, process, tool
from tests.places import SAMPLES

BOX = ((0, 100), (-40, 40), (-20, 0))


def converted(tmp_path, programs):
    """Convert G-code programs with one process; return the warnings of each about shared material."""
    (tmp_path / "ops").mkdir()
    (tmp_path / "process.toml").write_text(process(tool(12, 3), BOX, 1.0))
    for name, text in programs.items():
        (tmp_path / "ops" / name).write_text(text)
    given = ["--cell", str(SAMPLES / "cell_kr270.toml"), "--process", str(tmp_path / "process.toml")]
    run("convert", tmp_path / "ops", *given, "-o", tmp_path / "out", code=(0, 3))
    reports = {path.name.partition(".")[0]: json.loads(path.read_text()) for path in (tmp_path / "out").glob("*.json")}
    return {
        name: [issue for issue in report["issues"] if issue["kind"] == "shared-stock"]
        for name, report in reports.items()
    }


def slot(y, depth=6.0, end=115):
    return gcode(f"G0 X-15 Y{y} Z5", f"G1 Z-{depth} F1200", f"X{end}", "G0 Z5")


def test_programs_that_cut_the_same_material_name_each_other(tmp_path):
    found = converted(tmp_path, {"op1.nc": slot(0), "op2.nc": slot(0.4), "op3.nc": slot(30)})
    assert [len(found[name]) for name in ("op1", "op2", "op3")] == [1, 1, 0]
    (issue,) = found["op2"]
    assert issue["level"] == "warning"
    assert "op1.nc (" in issue["message"]
    assert '[stock] file = "op1.stock.glb"' in issue["message"]


@pytest.mark.parametrize(("shift", "is_shared"), [(12.5, False), (12.0, False), (9.0, True)])
def test_slots_side_by_side_share_no_material(tmp_path, shift, is_shared):
    """Slots that only touch have a few cells in common."""
    found = converted(tmp_path, {"op1.nc": slot(0.3), "op2.nc": slot(0.3 + shift)})
    assert [bool(issues) for issues in found.values()] == [is_shared, is_shared]


def test_of_many_programs_with_one_process_none_is_compared():
    """Each process of a run sweeps all that are compared."""
    base = Job(Path("p.nc"), "gcode", Path("out"), forces=Path("process.toml"))
    alone = Job(Path("q.nc"), "gcode", Path("out"))
    for count, partners in ((2, 1), (40, 39), (41, 0)):
        jobs = [replace(base, program=Path(f"p{n}.nc")) for n in range(count)]
        marked = runs._with_same_stock([*jobs, alone])
        assert [len(job.same_stock) for job in marked] == [partners] * count + [0]


def test_a_deeper_level_of_a_pocket_counts_as_the_material_above_it(tmp_path):
    found = converted(tmp_path, {"op1.nc": slot(0, 3), "op2.nc": slot(0, 6)})
    assert "op1.nc (100 %)" in found["op2"][0]["message"]


def test_forces_that_fail_leave_no_files_of_an_earlier_run_as_new(tmp_path):
    program, process_file = tmp_path / "op1.nc", tmp_path / "process.toml"
    program.write_text(slot(0))
    process_file.write_text(process(tool(12, 3), BOX, 1.0))
    given = [program, "--cell", str(SAMPLES / "cell_kr270.toml"), "--process", str(process_file)]
    outputs = ["-o", tmp_path / "f.csv", "--stock-out", tmp_path / "left.stl"]
    run("forces", *given, *outputs)
    program.write_text(slot(500))
    run("forces", *given, *outputs, code=1)
    assert {path.name for path in tmp_path.iterdir()} >= {"f.csv.old", "f.json.old", "left.stl.old"}
    assert not (tmp_path / "left.stl").exists()
    program.write_text(slot(0))
    run("forces", *given, *outputs)
    (tmp_path / "f.csv").write_text("edited")
    program.write_text(slot(500))
    run("forces", *given, *outputs, code=1)
    assert (tmp_path / "f.csv").read_text() == "edited"
