"""Motions that are taken while the trace is recorded are those of a second run along the complete trace."""

import tempfile
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from postproc.dialects import krl
from postproc.dialects.krl.read import flow, main_routine
from postproc.errors import PostprocError
from tests.attack.krl import MOST_STEPS, moved, read_job
from tests.attack.krl_generator import Generator
from tests.attack.krl_snippets import Snippets
from tests.attack.krl_states import States
from tests.benchmarks.krl_bodies import BODIES, corrected_targets, files, read_texts

_EXECUTION = main_routine._execution


def in_two_runs(start, *, collects):
    """The trace alone, so that the statements run once more."""
    execution, _ = _EXECUTION(start, collects=collects)
    return execution, None


def outcome(read_program, write):
    """All that a program is read as, and written."""
    try:
        program = read_program()
    except PostprocError as error:
        return str(error)
    m, layout = program.motions, program.layout
    columns = [m.kind, m.line, m.target, m.joints, m.feed, m.blend, m.status, m.turn, m.base, m.tool, layout.numbers]
    found = [np.nan_to_num(column, nan=-1e9).tolist() for column in (*columns, *program.bases, *program.tools)]
    said = [str(issue) for issue in program.issues], [str(place) for place in program.unresolved]
    try:
        written = write(program)
    except PostprocError as error:
        return found, said, str(error)
    texts = [(document.name, document.text) for document in written.documents]
    return found, said, texts, written.output_line.tolist(), [str(issue) for issue in written.issues]


def both(read_program, write):
    """The outcome of one run and of two, and whether one was enough."""
    is_single = []

    def counted(start, *, collects):
        execution, collected = _EXECUTION(start, collects=collects)
        is_single.append(collected is not None)
        return execution, collected

    with patch.object(main_routine, "_execution", counted):
        single = outcome(read_program, write)
    with patch.object(main_routine, "_execution", in_two_runs):
        return single, outcome(read_program, write), is_single[:1] == [True]


def written_with(seed):
    return lambda program: krl.rewrite(program, moved(program, np.random.default_rng(seed)))


@pytest.mark.parametrize("name", BODIES)
def test_bodies_are_read_the_same_in_one_run(name):
    texts = files(name, 200)
    single, double, _ = both(
        lambda: read_texts(texts), lambda program: krl.rewrite(program, corrected_targets(program))
    )
    assert single == double


@pytest.mark.parametrize("name", ["CUT(I)", "CUT(PP[I])", "IF … $OUT", "XT=PP[I]", "GOP({X …})"])
def test_calls_and_conditions_need_one_run_only(name):
    """Bodies that are read as columns need none."""
    texts = files(name, 20)
    assert both(lambda: read_texts(texts), lambda program: krl.rewrite(program, corrected_targets(program)))[2]


@pytest.mark.parametrize("kind", ["mixed", "harder", "states", "snippets"])
def test_random_programs_are_read_the_same_in_one_run(kind):
    single_runs = 0
    for seed in range(25):
        rng = np.random.default_rng(seed)
        if kind == "snippets":
            texts = Snippets(rng, keep=False).programs()
        else:
            generator = States if kind == "states" else Generator
            texts = generator(rng, more=True, mixed=True, keep=False, harder=kind == "harder").programs()
        limits = patch.multiple(flow, MOST_TRACED=MOST_STEPS, MOST_STATEMENTS=MOST_STEPS)
        with limits, tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            single, double, is_single = both(lambda: read_job(texts, folder), written_with(seed))  # noqa: B023
        assert single == double, seed
        single_runs += is_single
    assert single_runs > 0
