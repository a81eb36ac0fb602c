"""Loops and routines around motions cost the same for each point, however many there are."""

import pytest

from postproc.dialects.krl.write.rewrite import rewrite
from tests.benchmarks.krl_bodies import BODIES, corrected_targets, files, read_texts
from tests.effort import calls

LINEAR = 1.02
"""Calls of functions a point among 400 over those among 200: growth with the number of points would be 2."""


@pytest.mark.parametrize("name", [name for name in BODIES if name not in ("lines", "SUB( ) of 100")])
def test_a_point_costs_the_same_among_many(name):
    def work(count):
        texts = files(name, count)
        program = read_texts(texts)
        assert len(program.motions) == count + 1
        wanted = corrected_targets(program)
        return calls(lambda: read_texts(texts)) + calls(lambda: rewrite(program, wanted))

    work(20)  # what is imported or compiled at the first time does not count
    few, more, most = work(100), work(200), work(400)
    assert (most - more) / 200 < LINEAR * (more - few) / 100
