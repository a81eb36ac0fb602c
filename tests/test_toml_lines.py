"""Errors in TOML files name the line."""

from __future__ import annotations

import pytest

from postproc import cell
from postproc.errors import CellError
from postproc.files.toml_lines import line_of

CELL_LINES = 'robot = "kuka_kr270"\n[base]\nX = 1500  # [gcode]\n[tool]\nZ = 350\n'


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('[gcode]\n\nmotions = "FOO"', 8),
        ('[gcode]\nrapid_m_per_s = "fast"', 7),
        ("[output]\ntolerance_mm = -1", 7),
        ('[tools.3]\nZ = 1\n[tools.4]\nX = 0\nY = "a"', 10),
        ("[gcode]\n# rapidd = 2\nrapidd = 1", 8),
        ('[work_offsets."G59.1"]\nX = true', 7),
        ('[collision]\nholder = [ { diameter_mm = "x" } ]', 7),
        ("output.tolerance = 1", None),
    ],
)
def test_the_line_of_a_wrong_key_or_value_is_named(tmp_path, text, line):
    path = tmp_path / "cell.toml"
    path.write_text(CELL_LINES.replace("[base]", f"{text}\n[base]") if line is None else CELL_LINES + text)
    with pytest.raises(CellError) as caught:
        cell.load(path)
    assert caught.value.line == (2 if line is None else line)


def test_a_key_that_two_lines_may_give_has_no_line():
    text = "[tools.1]\nZ = 'a'\n[tools.2]\nZ = 2"
    assert line_of(text, "tools[...].Z") is None
    assert line_of(text, "tools.1.Z") == 2
