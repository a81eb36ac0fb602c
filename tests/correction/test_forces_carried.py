"""Forces travel with a written program: read back, it has at every target the force that it was corrected for."""

from __future__ import annotations

import csv
import io
import re

import numpy as np
import pytest

from postproc import correction, forces, report
from tests.correction.simulated import simulator
from tests.corrections import correct_files, krl_files, read_back
from tests.kr270 import CELL, ROBOT
from tests.oracle import cell_sim

MILLINEWTON = 1e-3


def predicted(result, tmp_path):
    """What `predict` says of the written program, at its own targets."""
    rows = None
    text = report.forces_csv(result)
    if text is not None:
        (tmp_path / "part.forces.csv").write_bytes(text)
        rows = forces.read_force_csv(tmp_path / "part.forces.csv")
    program = read_back(result)
    back = correction.process(program, ROBOT, CELL, rows, "predict")
    assert not back.failed, back.issues
    return back, back.t == 1.0


def check(result, tmp_path):
    """The written program has the same wrench at each target, and so its tip stands where it should."""
    back, ends = predicted(result, tmp_path)
    assert np.count_nonzero(ends) == len(result)
    np.testing.assert_allclose(back.wrench[ends], result.wrench, rtol=0, atol=2 * MILLINEWTON)
    tip = back.nominal[ends, :3, 3] + back.deflection[ends]
    assert np.linalg.norm(tip - result.nominal[:, :3, 3], axis=1).max() < 5e-7
    assert not [issue for issue in back.issues if issue.kind in ("no-force", "force-on-rapid")]
    assert np.abs(result.wrench).max() > 100.0
    return back


def comments(text):
    """The force comment in force at each line of a text, by the rule alone: modal from its line on. BASE only."""
    now, out = np.zeros(6), []
    for line in text.splitlines():
        found = re.search(r";\s*FORCE\s+(.*)", line)
        if found:
            assert "FRAME" not in found[1]
            values = dict(re.findall(r"([FM][XYZ])=(\S+)", found[1]))
            now = np.array([float(values.get(name, 0.0)) for name in ("FX", "FY", "FZ", "MX", "MY", "MZ")])
        out.append(now)
    return out


def check_by_simulator(result):
    """An independent arm under the forces of the text stands at the nominal points of the program read."""
    text = result.documents[0].text
    sim, given = simulator("cell_kr270.toml"), comments(text)
    moves = cell_sim.read(text, "".join(document.text for document in result.documents[1:]))
    spots = iter(result.nominal[:, :3, 3])
    for index, _, _, q in sim.run(moves):
        wrench = given[moves[index]["line"] - 1] if moves[index]["kind"] != "PTP" else np.zeros(6)
        assert np.linalg.norm(sim.tip(moves[index], q, wrench) - next(spots)) < 1e-6
    assert next(spots, None) is None


AT_Z20 = "G90 G21 G17\nS1000 F600\nG0 X0 Y0 Z20\n"
MILLED = (
    "(FORCE FX=300 FY=-50.5 FZ=200 MZ=4)\nG1 Z0\nG1 X30\n(FORCE FX=-120 FZ=80)\nG1 Y30\nG0 Z20\nG0 X60\nG1 Z0\n"
    "(FORCE OFF)\nG1 X90\n(FORCE FY=250)\nG3 X90 Y60 I0 J15\nG1 X30.3\nG1 X30\nM2\n"
)


def test_comments_of_gcode_become_comments_of_krl(tmp_path):
    result = correct_files({"part.nc": AT_Z20 + MILLED})
    check(result, tmp_path)
    check_by_simulator(result)
    assert report.forces_csv(result) is None


@pytest.mark.parametrize("options", [{}, {"linearize_arcs": True}, {"mode": "nominal"}])
def test_feed_forces_are_those_of_the_program_read_however_the_pieces_turn(tmp_path, options):
    text = AT_Z20 + MILLED.replace("G1 Z0", "G1 X2 Z0", 1).replace("FX=300", "FRAME=FEED FX=300").replace(
        "FY=250", "FY=250 FRAME=FEED"
    )
    result = correct_files({"part.nc": text}, **options)
    if options.get("mode") == "nominal":
        back, ends = predicted(result, tmp_path)
        np.testing.assert_allclose(back.wrench[ends], result.wrench, rtol=0, atol=2 * MILLINEWTON)
        np.testing.assert_allclose(back.before[ends], result.before, rtol=0, atol=5e-8)
    else:
        check(result, tmp_path)
    turning = result.documents[0].text.count("FRAME=FEED")
    assert (turning > 2) is (not options.get("linearize_arcs", False))


KRL = (
    "DEF part( )\n$VEL.CP=0.05\nPTP XS\n{0}\nLIN {{X 0,Y 0,Z 0,A 180,B 0,C 180}}\n"
    "TRIGGER WHEN DISTANCE=1 DELAY=0 DO $OUT[1]=TRUE\n"
    "LIN {{X 80,Y 0,Z 0,A 180,B 0,C 180}} C_DIS {1}\n;FORCE OFF\nPTP XS\nLIN {{X 80,Y 20,Z 0,A 180,B 0,C 180}}\n"
    "{2}\nCIRC {{X 100,Y 40,Z 0}},{{X 120,Y 20,Z 0}} C_DIS\n{3}\nLIN {{X 150,Y 20,Z 0,A 160,B 5,C 180}}\nEND\n"
)
START_DAT = "DEFDAT part\nDECL E6POS XS={X 0,Y 0,Z 50,A 180,B 0,C 180}\nENDDAT\n"


def test_comments_of_krl_stay_and_get_those_that_divided_moves_need(tmp_path):
    own = [";FORCE FX=300 FZ=200", ";FORCE FX=-100 ; was 300", ";FORCE FY=400 MX=3", ";FORCE FZ=150"]
    result = correct_files(krl_files(KRL.format(own[0], "; note", own[2], own[3]), START_DAT))
    check(result, tmp_path)
    assert [line for line in result.documents[0].text.splitlines() if line in own or line == ";FORCE OFF"][:2] == [
        own[0],
        ";FORCE OFF",
    ]
    result = correct_files(krl_files(KRL.format(own[0], ";FORCE FX=-100", own[2], own[3]), START_DAT))
    check(result, tmp_path)
    check_by_simulator(result)


def test_feed_and_tool_forces_of_krl(tmp_path):
    own = [
        ";FORCE FX=300 FZ=200 FRAME=FEED",
        ";FORCE FX=-100 FY=200 FRAME=FEED",
        ";FORCE FY=400 MX=3 FRAME=FEED",
        ";FORCE FX=150 FRAME=TOOL",
    ]
    source = KRL.format(*own).replace("LIN {X 0,Y 0,Z 0", "LIN {X 9,Y 0,Z 0")
    result = correct_files(krl_files(source, START_DAT))
    check(result, tmp_path)
    written = result.documents[0].text
    assert "FRAME=TOOL" in written.replace(own[3], "")  # this move turns the tool
    assert own[1] not in written  # on the line of a motion there is room for one comment


def test_nothing_is_added_where_nothing_changes(tmp_path):
    source = KRL.format(";FORCE OFF", ";FORCE FX=0 FRAME=FEED", "; x", "")
    result = correct_files(krl_files(source, START_DAT))
    assert result.documents[0].text == source


@pytest.mark.parametrize("name", ["part.nc", "part.src"])
def test_forces_of_a_csv_come_back_as_a_csv_by_line_of_the_written_program(tmp_path, name):
    files = (
        {name: AT_Z20 + MILLED} if name == "part.nc" else krl_files(KRL.format("", ";FORCE FX=77", "", ""), START_DAT)
    )
    first = 5 if name == "part.nc" else 7
    (tmp_path / "in.csv").write_text(
        f"line,line_end,Fx,Fy,Fz,Mx,frame\n{first},{first},300,0,200,5,BASE\n"
        f"{first + 1},{first + 30},150,-200,0,0,{'FEED' if name == 'part.src' else 'BASE'}\n"
    )
    result = correct_files(files, source=forces.read_force_csv(tmp_path / "in.csv"))
    check(result, tmp_path)
    rows = list(csv.DictReader(io.StringIO(report.forces_csv(result).decode())))
    assert tuple(rows[0]) == report.FORCE_COLUMNS
    assert all(int(row["line"]) <= int(row["line_end"]) for row in rows)
    lines = result.documents[0].text.splitlines()
    assert all(lines[int(row[end]) - 1].startswith(("LIN", "CIRC")) for row in rows for end in ("line", "line_end"))


def test_small_arcs_have_their_force_too(tmp_path):
    """On pieces of a tenth of a millimetre the rounding of the text turns the feed direction."""
    text = f"{AT_Z20}(FORCE FX=400 FY=300 FRAME=FEED)\nG1 Z0 X-5\n" + "".join(
        f"G2 X{x + 0.3:.4f} I0.15 J0\n" for x in np.arange(-5, -2, 0.3)
    )
    check(correct_files({"part.nc": text + "M2\n"}), tmp_path)
