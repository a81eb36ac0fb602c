"""`[gcode] motions = "SLIN"`: the same targets and speeds as SLIN and SCIRC, executed and loaded by the oracles."""

import re

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import cell as cells
from postproc.correction import process
from postproc.errors import CellError
from tests.attack.krl_interpreter import Controller
from tests.corrections import read_files
from tests.kr270 import CELL, CELL_TEXT, ROBOT
from tests.oracle import krl_grammar
from tests.oracle.arm import abc
from tests.places import ROOT


def written(motions: str, mode: str = "convert"):
    cell = replace(CELL, gcode=replace(CELL.gcode, motions=motions))
    name = ROOT / "samples" / "pocket.nc"
    program = read_files({name.name: name.read_bytes()}, cell)
    result = process(program, ROBOT, cell, mode=mode)
    assert result.documents
    return result.documents[0].text, result


@pytest.fixture(scope="module")
def both():
    return {motions: written(motions) for motions in ("LIN", "SLIN")}


def executed(text: str):
    text = re.sub(r"^\$(ANOUT|OUT).*$", "", text, flags=re.M)  # outputs are not what this is about
    base, tool = CELL.base, CELL.tool
    frames = abc(base.X, base.Y, base.Z), abc(tool.X, tool.Y, tool.Z)
    return Controller({"POCKET.SRC": text}, np.random.default_rng(1), *frames, {}).run("POCKET")


def test_path_motions_are_spline_motions(both):
    text, _ = both["SLIN"]
    assert not re.search(r"^(LIN|CIRC) ", text, re.M)
    assert len(re.findall(r"^SLIN ", text, re.M)) > 100
    assert len(re.findall(r"^SCIRC ", text, re.M)) > 300
    assert "C_DIS" not in text.replace("$APO.CDIS", "")
    assert not re.search(r"^PTP .*C_", text, re.M)
    assert len(re.findall(r" C_SPL", text)) == len(re.findall(r"^(?:LIN|CIRC) .* C_DIS", both["LIN"][0], re.M))
    krl_grammar.check("POCKET.src", text)


def test_executed_it_makes_the_motions_of_LIN(both):
    spline, plain = (executed(both[motions][0]) for motions in ("SLIN", "LIN"))
    assert len(spline) == len(plain) > 500
    for one, other in zip(spline, plain, strict=True):
        assert one.numbers == other.numbers
        assert (one.joints, one.speed) == (other.joints, other.speed)
        np.testing.assert_array_equal(one.base, other.base)


def test_loaded_it_leaves_what_LIN_leaves(both):
    _, spline = both["SLIN"]
    _, plain = both["LIN"]
    np.testing.assert_array_equal(spline.deviation_after, plain.deviation_after)
    np.testing.assert_array_equal(spline.rounding, plain.rounding)
    assert np.abs(spline.deviation_after).max() < 1e-6


def test_a_krc2_has_no_spline_motions(tmp_path):
    text = CELL_TEXT.replace("[gcode]", '[gcode]\nmotions = "SLIN"').replace(
        "[output]", '[output]\ncontroller = "KRC2"'
    )
    (tmp_path / "cell.toml").write_text(text)
    with pytest.raises(CellError, match="a KRC2 has no spline motions"):
        cells.load(tmp_path / "cell.toml")
