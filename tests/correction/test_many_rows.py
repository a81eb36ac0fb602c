"""Programs of many targets, whose angles are kept in files between the steps, are corrected to the same bytes."""

from __future__ import annotations

from pathlib import Path

import pytest

from postproc import chunks
from tests.commands import run

SAMPLES = Path(__file__).parent.parent.parent / "samples"
BY_AXES = """DEF axes( )
$BASE={X 1200,Y 0,Z 900,A 0,B 0,C 0}
$TOOL={X 0,Y 0,Z 200,A 0,B 0,C 0}
$VEL.CP=0.05
PTP {A1 0,A2 -90,A3 90,A4 0,A5 45,A6 0}
PTP {X 0,Y 0,Z 300,A 0,B 180,C 0,S 2,T 2}
; FORCE FX=200 FY=-150 FZ=300
LIN {X 100,Y 0,Z 300,A 0,B 180,C 0} C_DIS
LIN {X 100,Y 200,Z 300,A 0,B 170,C 0} C_DIS
; FORCE OFF
PTP {A1 5,A2 -95,A3 95,A4 0,A5 45,A6 180}
PTP {X 0,Y 0,Z 300,A 0,B 180,C 0,S 2,T 34}
; FORCE FX=200 FY=-150 FZ=300
CIRC {X 50,Y 50,Z 300},{X 100,Y 0,Z 300,A 0,B 170,C 0}
END
"""


@pytest.mark.parametrize(
    "arguments",
    [
        (SAMPLES / "pocket.nc", "--cell", SAMPLES / "cell_kr270.toml"),
        (SAMPLES / "freeform.nc", "--cell", SAMPLES / "cell_kr270.toml", "--forces", SAMPLES / "freeform.forces.csv"),
        (SAMPLES / "freeform.nc", "--cell", SAMPLES / "cell_irb6700.toml", "--to", "rapid"),
        (SAMPLES / "inline.src", "--cell", SAMPLES / "cell_kr270.toml"),
        ("axes.src", "--cell", SAMPLES / "cell_kr270.toml"),
    ],
)
def test_the_same_bytes_are_written_as_of_few_rows(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("axes.src").write_text(BY_AXES, encoding="ascii")
    used = []
    for folder, many in (("few", chunks.MANY), ("many", 10)):
        monkeypatch.setattr(chunks, "MANY", many)
        run("convert", *arguments, "-o", folder, code=(0, 3))
        used.append({file.name: file.read_bytes() for file in Path(folder).iterdir() if "report" not in file.name})
    assert any(name.endswith(("src", "mod")) for name in used[0])
    assert used[0] == used[1]
