"""Random RAPID modules: what the package reads and corrects is what a controller of its own executes."""

from __future__ import annotations

import pytest

from tests.attack import rapid
from tests.attack.driver import Wrong
from tests.attack.rapid import Generator, check_correction, check_reading, compare, executed


@pytest.mark.parametrize("seed", range(60))
def test_a_random_module_is_read_as_the_controller_executes_it(seed):
    check_reading(Generator(seed).module())


@pytest.mark.parametrize("seed", range(1000, 1012))
def test_a_random_module_is_corrected(seed):
    rapid.attack(seed)


def test_the_modules_are_corrected_and_have_all_forms():
    texts = [Generator(seed).module() for seed in range(60)]
    for form in (
        "RelTool(",
        "Offs(",
        "FOR i",
        "IF bOn",
        "MoveC",
        "PERS robtarget",
        "FRAME=TOOL",
        "\\V:=",
        "\\Z:=",
        "{i}",
    ):
        assert any(form in text for text in texts), form
    assert rapid.attack(1001) == "corrected"


def test_a_number_that_is_wrong_would_be_noticed(monkeypatch):
    text = Generator(1001).module()
    program = check_reading(text)
    right = rapid.wrench
    monkeypatch.setattr(rapid, "wrench", lambda motion: 1.05 * right(motion))
    with pytest.raises(Wrong):
        check_correction(text, program)


def test_a_motion_that_is_left_out_would_be_noticed():
    text = Generator(1001).module()
    motions = executed(text)
    with pytest.raises(Wrong):
        compare(motions[:-1], motions)
