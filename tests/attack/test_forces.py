"""A short attack in every run of the tests; `python -m tests.attack.forces --minutes N` is the long one."""

import pytest

from tests.attack import forces


@pytest.mark.parametrize("seed", range(8))
def test_forces_of_a_random_cut_are_those_of_a_cutter_turned_tooth_by_tooth(seed):
    _, worst, told = forces.try_scene(seed)
    assert worst <= 1.0, told


def test_a_cutter_with_a_tooth_less_would_be_noticed(monkeypatch):
    whole = forces.Scene.process

    def one_less(scene, cell):
        return whole(scene, cell).replace(f"flutes = {scene.cutter.teeth}", f"flutes = {scene.cutter.teeth + 1}")

    monkeypatch.setattr(forces.Scene, "process", one_less)
    assert forces.try_scene(1)[1] > 1.0
