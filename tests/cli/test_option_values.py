"""Values of options that no command takes are wrong usage: exit code 2, whatever layer finds them."""

from __future__ import annotations

import pytest

from tests.commands import CELL_OPTION, run
from tests.places import ROOT

POCKET, FREEFORM = ROOT / "samples" / "pocket.nc", ROOT / "samples" / "freeform.nc"
ROBOT_OPTION = ("--robot", "kuka_kr270")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("place", POCKET, *CELL_OPTION, "--region", "X=nan:1000"), "not AXIS=LOW:HIGH"),
        (("place", POCKET, *CELL_OPTION, "--region", "X=9:1"), "9 is larger than 1"),
        (("place", POCKET, *CELL_OPTION, "--region", "Q=1:9"), "no axis 'Q'"),
        (("place", POCKET, *CELL_OPTION, "--region", "E1=0:100"), "the cell has no [external_axes.E1]"),
        (
            ("init", "cell.toml", *ROBOT_OPTION, "--base", "1500,0", "--tool", "0,0,350"),
            "$BASE: 2 numbers. Give 3 to 6.",
        ),
        (("init", "cell.toml", *ROBOT_OPTION, "--base", "1500,0,nan", "--tool", "0,0,350"), "Give finite numbers."),
        (("init", "cell.toml", *ROBOT_OPTION, "--base", "3", "--tool", "0,0,350"), "--config-dat"),
        (("convert", POCKET, FREEFORM, *CELL_OPTION, "--name", "x"), "one name for 2 programs"),
        (("convert", POCKET, *CELL_OPTION, "--tolerance", "nan"), "nan is no number"),
        (("convert", POCKET, *CELL_OPTION, "--part-tolerance", "inf"), "inf is no number"),
        (("convert", POCKET, *CELL_OPTION, "--part-tolerance", "0"), "0.0 is not in the range x>0."),
    ],
)
def test_a_value_that_no_option_takes_is_wrong_usage(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert message in run(*arguments, code=2).output
    assert list(tmp_path.iterdir()) == []
