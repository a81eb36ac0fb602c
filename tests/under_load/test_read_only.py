"""What is handed on cannot be changed behind the back of those who hold it, whatever dialect it came from."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.under_load import MotionsUnderLoad, PathUnderLoad, RobotInCell
from tests.corrections import read_files
from tests.kr270 import CELL, ROBOT
from tests.places import SAMPLES

FILES = {"gcode": ("pocket.nc",), "krl": ("inline.src", "inline.dat")}


def arrays(record, where=""):
    for field in type(record).__match_args__:
        value, name = getattr(record, field), f"{where}.{field}"
        if isinstance(value, np.ndarray):
            yield name, value
        elif hasattr(type(value), "__match_args__"):
            yield from arrays(value, name)


@pytest.fixture(params=FILES)
def sample_program(request):
    return read_files({name: (SAMPLES / name).read_bytes() for name in FILES[request.param]})


def test_a_program_that_was_read_is_read_only(sample_program):
    found = dict(arrays(sample_program))
    assert {".motions.target.position", ".bases", ".tools"} <= set(found)
    assert [name for name, value in found.items() if value.flags.writeable] == []
    with pytest.raises(ValueError, match="read-only"):
        sample_program.motions.feed[0] = 1.0


def test_a_path_under_load_is_read_only_with_all_that_it_holds(sample_program):
    motions = MotionsUnderLoad.of(sample_program, RobotInCell.of(ROBOT, CELL), None)
    path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
    found = {name: value for name, value in arrays(path) if ".robot_in_cell." not in name}
    assert {
        ".wrench.values",
        ".joints.q",
        ".sample.pose.position",
        ".motions.forces.wrench.values",
        ".arcs.number",
    } <= set(found)
    assert [name for name, value in found.items() if value.flags.writeable] == []
