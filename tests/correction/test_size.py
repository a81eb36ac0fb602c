"""The size of what is written: no digits that carry nothing, a warning beyond the memory of the controller."""

import json
import re

from tests.commands import run
from tests.kr270 import CELL_TEXT
from tests.places import ROOT


def converted_pocket(tmp_path, *options, more=""):
    cell = tmp_path / "cell.toml"
    cell.write_text(CELL_TEXT.replace("[output]", f"[output]\n{more}"))
    arguments = ["convert", str(ROOT / "samples" / "pocket.nc"), "--cell", str(cell), "-o", str(tmp_path / "out")]
    run(*arguments, "--overwrite", *options)
    return (tmp_path / "out" / "pocket.src").read_bytes(), json.loads(
        (tmp_path / "out" / "pocket.report.json").read_text()
    )


def test_a_program_larger_than_the_memory_of_the_controller_gets_a_warning(tmp_path):
    text, report = converted_pocket(tmp_path, more="program_memory_MB = 0.05")
    assert report["size_bytes"] == len(text) > 60_000
    told = [issue for issue in report["issues"] if issue["kind"] == "program-memory"]
    assert [issue["level"] for issue in told] == ["warning"]
    assert "the program has 0.078" in told[0]["message"]
    limit = len(text) / 1e6 + 1e-3
    _, report = converted_pocket(tmp_path, more=f"program_memory_MB = {limit}")
    assert "program-memory" not in {issue["kind"] for issue in report["issues"]}


def test_targets_have_no_trailing_zeros(tmp_path):
    text, _ = converted_pocket(tmp_path, "--nominal")
    lines = [line for line in text.decode().split("\r\n") if line.startswith(("LIN {", "CIRC {"))]
    assert len(lines) > 100
    assert not [line for line in lines if re.search(r"\.\d*0[,}]|\.[,}]", line)]
    assert [line for line in lines if re.search(r"[X-Z] -?\d+[,}]", line)]
