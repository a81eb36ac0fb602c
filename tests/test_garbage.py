"""The garbage collector pauses where a program is read, and runs again afterwards."""

import gc

import pytest

from postproc import garbage


def test_cycles_are_collected_again_behind_the_context_and_after_an_error():
    with garbage.collection_paused():
        assert not gc.isenabled()
        with garbage.collection_paused():
            assert not gc.isenabled()
        assert not gc.isenabled()
    assert gc.isenabled()
    with pytest.raises(ValueError, match="wrong"), garbage.collection_paused():
        raise ValueError("wrong")
    assert gc.isenabled()


def test_a_collector_that_the_caller_stopped_stays_stopped():
    gc.disable()
    try:
        with garbage.collection_paused():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()
