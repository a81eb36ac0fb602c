"""The comparison of collected cutter-location files and RAPID modules: what differs is noticed."""

from __future__ import annotations

from pathlib import Path

import pytest

from postproc.dialects import apt
from postproc.dialects.text import decode
from tests.attack.collected import SHOP, outcome_of
from tests.attack.collected_cam import difference
from tests.dialects.gcode_reading import forward
from tests.dialects.test_rapid_reading import ROBODK

APT = """UNITS/MM
LOADTL/1
SPINDL/900,RPM,CLW
RAPID
GOTO/10,0,9 $$ above
FEDRAT/600,MMPM
GOTO/10,0,0
CIRCLE/0,0,0,0,0,1,10
GOTO/0,10,0
GOTO/0,10,9
CYCLE/DRILL,DEPTH,5,MMPM,90,CLEAR,2
GOTO/20,10,4
CYCLE/OFF
RAPID
GOTO/0,0,50
FINI
"""
CHANGES = {
    "a place": ("GOTO/0,10,9\n", "GOTO/0,11,9\n", "is no target"),
    "a unit": ("UNITS/MM", "UNITS/INCHES", "is no target"),
    "a centre": ("CIRCLE/0,0,0", "CIRCLE/0,1,0", "no CIRCLE is about the centre"),
    "a hole": ("GOTO/20,10,4", "GOTO/21,10,4", "no target below the hole"),
}


def test_files_of_all_formats_are_counted(tmp_path: Path) -> None:
    for name, text, expected in (
        ("part.apt", APT, ("APT", "same")),
        ("part.ncl.1", APT.replace("FINI", "TRACUT/1\nFINI"), ("APT", "refused")),
        ("Part.mod", ROBODK, ("RAPID", "same")),
        ("part.nc", "G21 G90\nG0 X0 Y0 Z5\nG1 X9 F90\nM2\n", ("read", "same")),
    ):
        (tmp_path / name).write_text(text, newline="")
        bare, outcome = outcome_of(tmp_path / name)
        assert (bare, outcome.word) == expected


@pytest.mark.parametrize(("old", "new", "said"), CHANGES.values(), ids=CHANGES)
def test_what_differs_is_noticed(old: str, new: str, said: str) -> None:
    program = apt.read(decode("part.apt", APT.encode()), SHOP, forward, "part")
    assert difference(program, APT) == ""
    assert old in APT
    assert said in difference(program, APT.replace(old, new))


def test_a_target_that_the_file_does_not_have_is_noticed() -> None:
    text = APT[: APT.index("CYCLE")] + "FINI\n"
    program = apt.read(decode("part.apt", text.encode()), SHOP, forward, "part")
    assert difference(program, text) == ""
    assert "are not in the file" in difference(program, text.replace("GOTO/0,10,0\n", ""))
