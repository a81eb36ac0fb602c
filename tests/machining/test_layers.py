"""Layers of one path: each removes the same material, so each has the forces of the first one, up to its end."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.frames import norm
from tests.machining.setting import forces, gcode, process, tool

BOX = ((-10, 100), (-50, 60), (-20, 0))
DEPTH = 2.0


def layers(folder, angle, shape, depths, *, shorter=0.0):
    """Largest and smallest force [N] on the second half of each line of a slot, which ends in the material."""
    direction = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    blocks = []
    for number, depth in enumerate(depths):
        (x, y), (u, v) = ((length * direction[0], length * direction[1]) for length in (-30, 50 - shorter * number))
        blocks += [f"G0 X{x:.4f} Y{y:.4f} Z20", f"Z{-depth:g}", f"G1 X{u:.4f} Y{v:.4f} F1200", "G0 Z20"]
    program, found = forces(folder, gcode(*blocks), process(tool(12, 3, shape), BOX, 0.5))
    size = norm(found.cuts.wrench[:, :3])
    ends = []
    for motion in np.flatnonzero(~program.motions.rapid):
        rows = (found.cuts.motion == motion) & (found.cuts.t > 0.5)
        ends.append((size[rows].min(), size[rows].max()))
    return np.array(ends)


@pytest.mark.parametrize("angle", [0.0, 17.0, 45.0])
@pytest.mark.parametrize("shorter", [0.0, 0.2, 0.8])
def test_each_layer_of_a_slot_has_the_force_of_the_first_up_to_its_end(tmp_path, angle, shorter):
    """The first one has that of a full slot, of which nothing is cut before; cells are 0.5 mm wide."""
    ends = layers(tmp_path, angle, "flat", DEPTH * np.arange(1, 6), shorter=shorter)
    np.testing.assert_allclose(ends, ends[0, 0], rtol=0.025)


def test_layers_of_a_ball_deeper_than_its_radius_have_one_force(tmp_path):
    """Higher up they follow the walls of the layer before."""
    ends = layers(tmp_path, 0.0, "ball", DEPTH * np.arange(1, 8))
    np.testing.assert_allclose(ends[3:], ends[3:4].repeat(4, axis=0), rtol=0.01)


@pytest.mark.parametrize("angle", [0.0, 17.0])
def test_a_slot_that_is_driven_again_is_in_air_up_to_its_end(tmp_path, angle):
    first, again = layers(tmp_path, angle, "flat", [DEPTH, DEPTH])
    assert first[0] > 100.0
    assert again[1] < 0.02 * first[0]
