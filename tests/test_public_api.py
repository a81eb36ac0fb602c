from __future__ import annotations

import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from msgspec.structs import replace

import postproc
from postproc import kinematics
from tests import fabricated
from tests.places import ROOT


def test_every_public_name_is_there():
    assert sorted(postproc.__all__) == list(postproc.__all__)
    assert [name for name in postproc.__all__ if not callable(getattr(postproc, name))] == []
    assert set(postproc.__all__) <= set(dir(postproc))


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'undo'"):
        _ = postproc.undo


def test_results_and_programs_are_shown_in_a_line_and_as_a_table():
    result = fabricated.result(3)
    assert repr(result).startswith(f"<Result of {result.program.name} on {result.robot.name}: targets 3, before ")
    assert len(repr(result)) < 200
    assert repr(result.program).endswith("motions>")
    table = result._repr_html_()
    assert table.startswith("<table><caption>")
    assert table.count("<tr>") >= 3
    assert "&lt;" in fabricated.with_changes(result, program=replace(result.program, name="a<b"))._repr_html_()


def test_the_guide_to_python_can_be_typed_to_its_end(tmp_path, monkeypatch):
    """But for the plot, whose library is not installed with the package."""
    shutil.copytree(ROOT / "samples", tmp_path / "samples")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "guide" / "python.md").read_text(), re.DOTALL)
    names: dict[str, object] = {}
    for block in blocks:
        if "matplotlib" not in block:
            exec(block, names)
    assert (tmp_path / "out" / "pocket.src").read_bytes() == names["result"].documents[0].to_bytes()
    assert (tmp_path / "out" / "pocket.report.html").stat().st_size > 1_000_000


def test_importing_the_package_imports_nothing_heavy():
    code = "import sys, postproc; print(sorted({'numpy', 'scipy', 'pinocchio', 'msgspec', 'click'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


WITHOUT = """
import sys
from click.testing import CliRunner
from postproc.cli import main

sys.modules["pinocchio"] = None  # an import is an ImportError
for command in ("convert", "predict"):
    arguments = [command, "samples/pocket.nc", "--cell", "samples/cell_kr270.toml", "-o", sys.argv[1]]
    assert CliRunner().invoke(main, arguments).exit_code == 0
print(sorted({"scipy", "trimesh", "distributed", "numpy.ma"} & set(sys.modules)))
"""


def test_convert_and_predict_need_neither_pinocchio_nor_scipy_nor_masked_arrays(tmp_path):
    command = [sys.executable, "-c", WITHOUT, str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"
    assert (tmp_path / "out" / "pocket.src").is_file()


def test_what_needs_pinocchio_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    robot = postproc.load_robot("kuka_kr270")
    with pytest.raises(postproc.PostprocError, match="conda-forge"):
        kinematics.gravity_stiffness(robot.nominal, np.zeros((1, 6)))


def test_ten_lines_correct_a_program():
    cell = postproc.load_cell(ROOT / "samples" / "cell_kr270.toml")
    robot = postproc.load_robot(cell.robot, cell.folder)
    program = postproc.read_program(ROOT / "samples" / "pocket.nc", robot, cell)
    result = postproc.process(program, robot, cell)
    assert result.before.max() > 1e-4
    assert result.after.max() < 1e-6
    assert result.documents[0].name == "pocket.src"
    assert postproc.summary(result).compensated_percent > 99.0
