"""A short attack in every run of the tests; `python -m tests.attack.gcode --minutes N` is the long one."""

from __future__ import annotations

import pytest

from tests.attack import gcode, inputs
from tests.oracle.rs274 import needs_rs274


@needs_rs274
def test_random_programs_are_read_as_rs274_reads_them() -> None:
    results = {gcode.try_program(seed) for seed in range(40)}
    assert {"same", "refused by both", "refused here only"} <= results


@pytest.mark.parametrize(
    ("attack", "count"),
    [(inputs.spoilt_program, 40), (inputs.spoilt_forces, 16), (inputs.spoilt_cell, 16), (inputs.spoilt_model, 20)],
)
def test_spoilt_input_is_read_or_refused_and_never_a_traceback(attack, count: int) -> None:
    results = {attack(seed) for seed in range(count)}
    assert "refused" in results
    assert results & {"written", "read"}
    assert "refused without a word" not in results
