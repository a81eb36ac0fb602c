"""The draw of functions for readers."""

import ast
import shutil
import textwrap

from tests.draw import draw
from tests.places import ROOT


def test_functions_are_whole_and_half_of_them_are_from_the_other_folders(tmp_path, monkeypatch):
    shutil.copytree(ROOT / "postproc" / "kinematics", tmp_path / "repository" / "postproc")
    monkeypatch.setattr("tests.draw.ROOT", tmp_path / "repository")
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        bodies = (f"@property\ndef f{k}(self):\n    a = {k}\n    b = a\n    c = b\n    return c\n" for k in range(9))
        (tmp_path / name / "module.py").write_text("\n".join(bodies) + "\ndef short():\n    return 1\n")
    drawn = draw(7, 21, [tmp_path / "one", tmp_path / "two"])
    assert draw(7, 21, [tmp_path / "one", tmp_path / "two"]) == drawn
    others = [function for function in drawn if function.file.parent.name in ("one", "two")]
    assert len(drawn) == 21
    assert sorted(function.file.parent.name for function in others) == ["one"] * 5 + ["two"] * 5
    assert all(function.text.startswith("@property") for function in others)
    for function in drawn:
        (node,) = ast.parse(textwrap.dedent(function.text)).body
        assert isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        assert function.file.read_text().splitlines()[function.line - 1] == function.text.splitlines()[0]
