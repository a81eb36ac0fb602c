"""Targets of programs that keep their text: what stays as it is, and S and T, against loops."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from postproc.correction.targets import _status_and_turn, _unchanged_motions
from postproc.poses import Poses
from postproc.program import CIRC, LIN, PTP
from postproc.toolpath import Toolpath
from tests.kr270 import ROBOT
from tests.programs import program

BOUND = 1e-7
"""A target that is commanded nearer than this to where it was is as it was [m, rad]."""


def path_of(kind, count):
    motion = np.repeat(np.arange(len(kind)), count)
    t = np.concatenate([(np.arange(n) + 1) / n for n in count])
    sample = Toolpath(motion, t, Poses.of(np.tile(np.eye(4), (len(t), 1, 1))), 0 * t)
    made = program([("LIN", 0, 0, 0)] * len(kind))
    made = replace(made, motions=replace(made.motions, kind=kind), layout=object())  # a text that is kept
    return SimpleNamespace(program=made, sample=sample)


def by_loop(kind, motion, moved):
    """Which motions are one target, and which end as their text says."""
    whole, kept, start_moved, before = [], [], False, None
    for k, each in enumerate(kind):
        own = moved[motion == k]
        untouched = not own.any() and not start_moved
        same = untouched and (before is None or kind[k - 1] != CIRC or before) if each == CIRC else not own[-1]
        whole.append(untouched if each == LIN else same)
        kept.append(same)
        start_moved, before = own[-1], same
    return whole, kept


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("axis", range(6))
def test_what_needs_no_correction_stays_as_it_is(seed, axis):
    """A circle is another one if it starts elsewhere, or if the circle does that it follows."""
    rng = np.random.default_rng(seed)
    kind = rng.choice([PTP, LIN, CIRC, CIRC, CIRC], 12)
    path = path_of(kind, rng.integers(1, 4, 12))
    moved = rng.random(len(path.sample)) < 0.12
    twist = np.zeros((len(moved), 6))
    twist[:, axis] = np.where(moved, 1.01, 0.99) * BOUND
    pose = path.sample.pose[:]
    pose[:, :3, 3], pose[:, :3, :3] = twist[:, :3], Rotation.from_rotvec(twist[:, 3:]).as_matrix()
    whole, kept = _unchanged_motions(path, SimpleNamespace(pose=Poses.of(pose)))
    expected = by_loop(kind, path.sample.motion, moved)
    assert (whole.tolist(), kept.tolist()) == tuple(list(map(bool, each)) for each in expected)
    path.program = replace(path.program, layout=None)
    assert not np.any(_unchanged_motions(path, SimpleNamespace(pose=Poses.of(pose))))


def test_status_and_turn_are_given_where_the_program_gives_them_and_its_other_bits_are_kept():
    q = np.radians([[10, -70, 105, 20, 50, 30], [-10, -70, 105, -20, -50, 30], [10, -70, 105, 20, 50, -30.0]])
    own_status, own_turn = np.array([2, 6, 2]), np.array([0b000010, 0b011011, 0b100010])
    motions = SimpleNamespace(kind=np.array([PTP, PTP, LIN, PTP, PTP]), status=np.array([1 + 24, -1, 5, 2, 8]),
                              turn=np.array([-1, 0, 9, 64 + 5, 63]))  # fmt: skip
    made = SimpleNamespace(motions=motions, keeps_text=True)
    status, turn = _status_and_turn(made, ROBOT, np.array([0, 1, 4]), q)
    assert status.tolist() == [2 + 24, -1, 2 + 8]
    assert turn.tolist() == [-1, own_turn[1], own_turn[2]]
    status, turn = _status_and_turn(made, ROBOT, np.array([3, 2, 3]), q)
    assert (turn[0], turn[2]) == (64 + own_turn[0], 64 + own_turn[2])
    made.keeps_text = False
    status, turn = _status_and_turn(made, ROBOT, np.array([0, 2, 4]), q)
    assert status.tolist() == [own_status[0], -1, own_status[2]]
    assert turn.tolist() == [own_turn[0], -1, own_turn[2]]
