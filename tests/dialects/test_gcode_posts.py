"""Programs as the posts of CAM systems print them: converted without an edit by hand."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.cell import Frame, Machine
from postproc.program import CIRC, PTP
from tests.commands import run
from tests.dialects.gcode_reading import CELL, ends, outcome, read
from tests.kr270 import CELL_TEXT

POSTS = Path(__file__).parent / "posts"
HERE = replace(
    CELL,
    machine=Machine(home=(0.0, -90.0, 100.0, 0.0, 20.0, 0.0), clearance_Z=100.0),
    tools={"1": Frame(Z=350.0), "2": Frame(Z=390.0)},
)
CUT = {
    # holes, arcs, journeys home, changes of the tool, lowest point
    "fusion.nc": (2, 5, 1, 2, -12.0),
    "mastercam.nc": (2, 1, 3, 2, -10.0),
    "freecad.ngc": (2, 1, 0, 1, -8.0),
    "solidcam.nc": (2, 2, 2, 1, -3.0),
    "estlcam.nc": (0, 3, 0, 1, -2.0),
    "vcarve.tap": (0, 1, 0, 1, -3.0),
}


@pytest.mark.parametrize("name", CUT)
def test_a_program_as_posts_print_it_is_read_as_it_stands(name: str) -> None:
    data = (POSTS / name).read_bytes()
    program = read(data, HERE)
    m, (_, arcs, journeys, changes, lowest) = program.motions, CUT[name]
    assert np.count_nonzero(m.kind == CIRC) == arcs
    assert np.count_nonzero(np.isfinite(m.joints[:, 0])) == journeys
    assert [event.kind for event in program.events].count("tool_change") == changes
    assert len(set(m.tool.tolist()) - {0}) == changes
    cutting = ~m.rapid
    assert ends(program)[cutting, 2].min() == pytest.approx(lowest)
    assert (m.kind[~m.rapid] != PTP).all()
    assert not [issue for issue in program.issues if issue.level == "error"]
    assert outcome(data.decode(), HERE, bulk=True) == outcome(data.decode(), HERE, bulk=False)
    for spoilt in (data.replace(b"\n", b"\r\n"), b"\xef\xbb\xbf" + data, data.lower()):
        np.testing.assert_allclose(ends(read(spoilt, HERE)), ends(program))


def test_all_of_them_are_converted(tmp_path: Path) -> None:
    text = (
        CELL_TEXT
        + "[machine]\nhome = [0, -90, 100, 0, 20, 0]\nclearance_Z = 100\n[tools.1]\nZ = 350\n[tools.2]\nZ = 390\n"
    )
    (tmp_path / "cell.toml").write_text(text)
    options = ["convert", str(POSTS), "--cell", str(tmp_path / "cell.toml"), "-o", str(tmp_path / "out")]
    run(*options, code=(0, 3))
    assert len(list((tmp_path / "out").glob("*.src"))) == len(CUT)
