"""Signals are heard where nothing can be left half-done, and held back elsewhere."""

# ruff: noqa: PT012 - what is raised at the end of a block comes from the block

from __future__ import annotations

import os
import signal
import threading

import pytest

from postproc import interrupts

pytestmark = pytest.mark.skipif(os.name != "posix", reason="sends POSIX signals")


def interrupt() -> None:
    signal.raise_signal(signal.SIGINT)


@pytest.fixture(autouse=True)
def nothing_stays():
    yield
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with interrupts.defer():
        assert not interrupts.is_pending()


def test_what_is_held_back_is_raised_at_the_end():
    done = []
    with pytest.raises(interrupts.Interrupt) as caught, interrupts.defer():
        interrupt()
        done.append(interrupts.is_pending())
    assert done == [True]
    assert caught.value.number == signal.SIGINT
    assert isinstance(caught.value, KeyboardInterrupt)


def test_what_came_before_is_heard_at_once():
    done = []
    with pytest.raises(KeyboardInterrupt), interrupts.defer():
        interrupt()
        with interrupts.allow():
            done.append("computed")
    assert done == []


def test_a_second_one_does_not_disturb_the_cleaning_up():
    done = []
    with pytest.raises(KeyboardInterrupt), interrupts.defer(), interrupts.allow():
        try:
            interrupt()
        finally:
            interrupt()
            done.append("cleaned up")
    assert done == ["cleaned up"]


def test_one_that_got_lost_in_a_destructor_is_raised_when_the_work_is_left():
    done = []
    with pytest.raises(KeyboardInterrupt), interrupts.defer():
        with interrupts.allow():
            try:
                interrupt()
            except BaseException:  # as Python does where it cannot raise
                done.append("lost")
        done.append("written")
    assert done == ["lost"]


def test_one_that_became_another_exception_is_an_interrupt_again():
    with pytest.raises(KeyboardInterrupt), interrupts.defer(), interrupts.allow():
        try:
            interrupt()
        except KeyboardInterrupt:
            raise RuntimeError("Error calling __set_name__") from None


def test_inside_what_is_heard_files_may_be_held_back_again():
    done = []
    with pytest.raises(KeyboardInterrupt), interrupts.defer(), interrupts.allow():
        with interrupts.defer():
            interrupt()
            done.append("whole")
        done.append("computed")
    assert done == ["whole"]


def test_other_threads_neither_hear_nor_hold():
    seen = []

    def work():
        with interrupts.defer(), interrupts.allow():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.default_int_handler]


def test_signals_that_the_caller_handles_are_left_to_it():
    came = []
    before = signal.signal(signal.SIGINT, lambda *_: came.append(1))
    try:
        with interrupts.defer():
            interrupt()
            assert not interrupts.is_pending()
    finally:
        signal.signal(signal.SIGINT, before)
    assert came == [1]
