"""Chunks worked on here and in a helper process: same results, same order, same errors."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from postproc.errors import NotConvergedError
from postproc.parallel import Shared, helper_process, here


def square(number):
    return number * number


def fails_at_7(number):
    if number == 7:
        raise NotConvergedError("chunk 7", [70, 71])
    return number


def dies_elsewhere(number, home):
    if os.getpid() != home:
        os._exit(1)
    return number


def test_results_come_in_the_order_of_the_chunks():
    with ThreadPoolExecutor(1) as helper:
        for run in (here, Shared(helper)):
            for count in (0, 1, 2, 3, 30):
                assert list(run(square, count, lambda index: (index,))) == [n * n for n in range(count)]
                assert list(run.later(square, count, lambda index: (index,))()) == [n * n for n in range(count)]


def test_a_helper_process_shares_the_work_and_passes_on_errors_with_their_rows():
    with helper_process("postproc.errors", wanted=True) as run:
        assert list(run(square, 40, lambda index: (index,))) == [n * n for n in range(40)]
        with pytest.raises(NotConvergedError, match="chunk 7") as found:
            list(run(fails_at_7, 8, lambda index: (index,)))
    assert found.value.rows == (70, 71)


def test_if_the_helper_dies_its_chunks_are_worked_on_here():
    with helper_process("postproc.errors", wanted=True) as run:
        home = os.getpid()
        for _ in range(2):
            assert list(run(dies_elsewhere, 12, lambda index: (index, home))) == list(range(12))
            assert list(run.later(dies_elsewhere, 12, lambda index: (index, home))()) == list(range(12))


IN_A_PROCESS = """
from postproc.memory import keep_freed
from postproc.parallel import helper_process

if __name__ == "__main__":
    keep_freed()
    with helper_process("postproc.errors", wanted=True) as run:
        print(sum(run(abs, 9, lambda index: (-index,))))
"""


def test_a_process_with_a_helper_ends_without_a_word(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(IN_A_PROCESS, encoding="utf-8")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "36\n", "")
