"""Pieces of a path on which bodies are compared, against loops; the distance that deflected bodies need."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.cell import Collision, Frame, HolderTable
from postproc.placement import bodies as placed
from postproc.placement.bodies import Bodies
from postproc.placement.samples import PathSamples
from postproc.under_load import RobotInCell
from tests.placement.setting import cell, read_with_robot

TEXT = """G21 G90
T1 M6
(FORCE FX=-110 FY=-190 FZ=130 MX=2 FRAME=BASE)
G0 X0 Y0 Z60
G1 Z0 F600
G1 X25 F2000
T2 M6
G1 Y90
G1 X60
(FORCE FX=40 FY=-250 FZ=0 FRAME=BASE)
G1 X140
"""


@pytest.fixture(scope="module")
def compared():
    own = cell(base=(1500.0, 0.0, 700.0), tool_change=[])
    own = replace(
        own,
        tools={"1": Frame(X=350.0, Z=200.0), "2": Frame(X=330.0, Z=200.0)},
        collision=Collision(holder=[HolderTable(diameter_mm=20, length_mm=60)]),
    )
    program, model = read_with_robot(TEXT, own)
    samples = PathSamples.of(program, RobotInCell.of(model, own), None)
    return samples, Bodies(samples, 12.0)


def test_bodies_need_twice_what_the_largest_forces_deflect_in_addition(compared):
    """The largest of each component on the path, by the compliance at the start."""
    samples, bodies = compared
    force, moment = samples.robot_in_cell.tip_compliance(samples.program.tools[0])
    deflection = force * np.sqrt(110.0**2 + 250.0**2 + 130.0**2) + moment * 2.0
    assert bodies.min_distance == pytest.approx(0.012 + 2.0 * deflection, rel=1e-9)


class Recorder:
    """Pieces of a path, and hits where a formula of the joint angles says so."""

    def __init__(self):
        self.pieces = []

    def __call__(self, solids, path, need, shift, *, between_samples):
        self.pieces.append((solids, path, shift, between_samples))
        return np.sin(30.0 * path.sum(axis=1)) > 0.4


@pytest.mark.parametrize("seed", range(6))
def test_pieces_end_at_breaks_at_other_tools_and_where_the_arm_does_not_reach(compared, monkeypatch, seed):
    samples, bodies = compared
    rng = np.random.default_rng(seed)
    rows = np.sort(rng.choice(len(samples), 14, replace=False))
    q = rng.uniform(-3.0, 3.0, (14, 6))
    q[rng.random(14) < 0.2, int(rng.integers(6))] = np.nan
    breaks = rng.random(14) < 0.2
    shift = rng.normal(size=(14, 3)) if seed % 2 else None
    motion = np.eye(4) if seed % 3 else None
    recorder = Recorder()
    monkeypatch.setattr(placed, "hits", recorder)
    found = bodies.is_hit_along_path(q, rows, breaks, shift, motion, between_samples=bool(seed % 2))
    tool = samples.program.motions.tool[samples.sample.motion[rows]]
    expected_hits, pieces = np.zeros(14, dtype=bool), []
    for i in range(14):
        if np.isnan(q[i]).any():
            continue
        continues = i > 0 and not breaks[i] and tool[i] == tool[i - 1] and not np.isnan(q[i - 1]).any()
        if continues:
            change = (q[i] - q[i - 1] + np.pi) % (2.0 * np.pi) - np.pi
            pieces[-1].append((i, pieces[-1][-1][1] + change))
        else:
            pieces.append([(i, q[i])])
        expected_hits[i] = np.sin(30.0 * pieces[-1][-1][1].sum()) > 0.4
    assert len(recorder.pieces) == len(pieces)
    for (solids, path, piece_shift, between), piece in zip(recorder.pieces, pieces, strict=True):
        part = [i for i, _ in piece]
        np.testing.assert_allclose(path, [angles for _, angles in piece], atol=1e-9)
        assert between is bool(seed % 2)
        assert motion is not None or solids is bodies.solids[int(tool[part[0]])]
        assert (piece_shift is None) if shift is None else np.array_equal(piece_shift, shift[part])
    np.testing.assert_array_equal(found, expected_hits)
    assert set(tool) == {1, 2}


@pytest.mark.parametrize("hit_tool", [None, 1, 2])
def test_poses_are_compared_with_the_bodies_of_their_tool(compared, monkeypatch, hit_tool):
    samples, _ = compared
    bodies = Bodies(samples, 12.0)
    q, shift = np.random.default_rng(1).uniform(-1.0, 1.0, (8, 6)), np.random.default_rng(2).normal(size=(8, 3))
    rows = np.linspace(0, len(samples) - 1, 8).astype(int)
    tool = samples.program.motions.tool[samples.sample.motion[rows]]
    calls = []

    class Solids:
        def __init__(self, number):
            self.number = number

        def move_base(self, motion):
            assert motion[0, 3] == 7.0
            return self

        def is_closer(self, frames, need):
            assert need == bodies.min_distance
            np.testing.assert_allclose(
                frames, placed.link_frames(bodies.chain, q[tool == self.number], shift[tool == self.number])
            )
            calls.append(self.number)
            return self.number == hit_tool

    bodies.solids = {number: Solids(number) for number in (1, 2)}
    motion = np.eye(4)
    motion[0, 3] = 7.0
    assert bodies.is_closer(q, rows, shift, motion) == (hit_tool is not None)
    assert calls == ([1] if hit_tool == 1 else [1, 2])
    only_first = np.flatnonzero(tool == 1)
    calls.clear()
    assert bodies.is_closer(q[only_first], rows[only_first], shift[only_first], motion) == (hit_tool == 1)
    assert calls == [1]
