"""The same motions of the flange under the same forces, written in other frames: nothing but those may change."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from postproc.cell import ExternalAxis
from postproc.comparison import compare
from tests.comparison.test_named import CELL, ROBOT
from tests.corrections import read_files

COMPONENTS = ("FX", "FY", "FZ", "MX", "MY", "MZ")
FORCE = np.array([-150.0, 100.0, 120.0, 6.0, -9.0, 4.0])
BASE, TOOL = (1500.0, -200.0, 700.0, 0.0, 0.0, 0.0), (0.0, 0.0, 350.0, 0.0, 0.0, 0.0)
MOVES = [
    ("LIN", (0, 0, 0)), ("LIN", (40, 0, 1)), ("LIN", (40, 30, 2)), ("CIRC", (60, 50, 2), (80, 30, 2)),
    ("LIN", (80, 0, 4)), ("LIN", (60, -10, 4)), ("PTP", (100, 0, 40)), ("LIN", (100, 40, 0)), ("LIN", (100, 80, 3)),
    ("LIN", (140, 80, 3)),
]  # fmt: skip
OTHER = [
    ("LIN", (0.1, 0, 0)), ("LIN", (20, 0.3, 0.6)), ("LIN", (40.2, -0.3, 1.1)), ("LIN", (40.1, 30.1, 2)),
    ("CIRC", (60, 50.6, 2), (80.1, 30, 2)), ("LIN", (79.5, 0, 4.3)), ("LIN", (60, -10, 4.2)), ("PTP", (100, 0.4, 40)),
    ("LIN", (100, 40.2, 0.3)), ("LIN", (140, 80.5, 3)),
]  # fmt: skip
TURN = {4: (0.2, 0, 0), 5: (0, 0.4, -0.1)}


def pose(frame):
    out = np.eye(4)
    out[:3, 3], out[:3, :3] = frame[:3], Rotation.from_euler("ZYX", frame[3:], degrees=True).as_matrix()
    return out


def written(name, moves, base, tool, e1, turn=()):
    """The flange goes where the tool of `TOOL` goes in `BASE`."""
    into = np.linalg.inv(pose(base)) @ pose(BASE)
    change = np.linalg.inv(pose(TOOL)) @ pose(tool)

    def target(place, k, row):
        there = pose((*place, *(np.array([180.0, 0.0, 180.0]) + np.array(dict(turn).get(row, (0, 0, 0))))))
        there = into @ there @ change
        angles = Rotation.from_matrix(there[:3, :3]).as_euler("ZYX", degrees=True)
        values = zip("XYZABC", (*there[:3, 3], *angles), strict=True)
        return ",".join(f"{axis} {value:.9f}" for axis, value in values if k or axis in "XYZ")

    force = FORCE.reshape(2, 3) @ into[:3, :3].T
    lines = [
        "DEF part( )", "$VEL.CP=0.05",
        *(f"${name}={{{','.join(f'{axis} {value:.9f}' for axis, value in zip('XYZABC', frame, strict=True))}}}"
          for name, frame in (("BASE", base), ("TOOL", tool))),
        "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0" + (",E1 0}" if e1 else "}"),
        "; FORCE " + " ".join(f"{k}={v:.9f}" for k, v in zip(COMPONENTS, force.ravel(), strict=True)),
    ]  # fmt: skip
    for row, (kind, *places) in enumerate(moves):
        values = [target(place, k == len(places) - 1, row) for k, place in enumerate(places)]
        more = (",S 2,T 2" if kind == "PTP" else "") + (f",E1 {30.0 * row:.3f}" if e1 else "")
        lines.append(
            f"{kind} " + ",".join(f"{{{v}{more if k == len(values) - 1 else ''}}}" for k, v in enumerate(values))
        )
    return "\n".join([*lines, "END", ""])


@cache
def compared(base, tool, e1, forces=True):
    cell = replace(CELL, external_axes={"E1": ExternalAxis(direction=(0.0, 1.0, 0.0))}) if e1 else CELL
    texts = written("ONE", MOVES, base, tool, e1), written("OTHER", OTHER, base, tool, e1, tuple(TURN.items()))
    if not forces:
        texts = tuple("\n".join(line for line in text.split("\n") if "FORCE" not in line) for text in texts)
    programs = (read_files({"P.src": text}, cell) for text in texts)
    return compare(*programs, ROBOT, cell)


TURNED_BASE = (1450.0, -150.0, 650.0, 30.0, -20.0, 10.0)
TURNED_TOOL = (0.0, 0.0, 350.0, 25.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("base", "tool", "e1", "forces"),
    [
        (TURNED_BASE, TOOL, False, True),
        (TURNED_BASE, TOOL, False, False),
        (TURNED_BASE, TURNED_TOOL, True, True),
    ],
)
def test_another_base_turns_what_is_in_its_axes_and_changes_nothing_else(base, tool, e1, forces):
    one, other = compared(BASE, tool, e1, forces), compared(base, tool, e1, forces)
    into = pose(base)[:3, :3].T
    names = ["rotation", "path_distance", "passing_distance", "missing_distance", "distance"]
    pairs = [(name, getattr(one, name), getattr(other, name)) for name in names]
    pairs.append(("offset", one.offset @ into.T, other.offset))
    for name in ("pair", "inserted_rows", "passed_rows", "only_nominal", "additional_rows", "rapid"):
        assert getattr(one, name).tolist() == getattr(other, name).tolist(), name
    if forces:
        for name in ("nominal", "corrected_deviation"):
            pairs.append((name, getattr(one.cuts, name) @ into.T, getattr(other.cuts, name)))
        wrench = (one.cuts.wrench.reshape(-1, 2, 3) @ into.T).reshape(-1, 6)
        pairs.append(("wrench", wrench, other.cuts.wrench))
        for name in ("rotation", "row", "t", "nominal_distance", "corrected_distance", "path_rotation", "length"):
            pairs.append((name, getattr(one.cuts, name), getattr(other.cuts, name)))
        assert np.linalg.norm(one.cuts.nominal, axis=1).max() > 2e-4
    for name, mine, theirs in pairs:
        np.testing.assert_allclose(theirs, mine, rtol=0, atol=3e-6 if name == "wrench" else 2e-8, err_msg=name)
    assert [(d.kind, d.level, d.count) for d in one.differences] == [
        (d.kind, d.level, d.count) for d in other.differences
    ]
    kinds = {d.kind for d in one.differences}
    assert {"orientation", "between", "only-nominal"} <= kinds or forces, kinds
    assert (len(one.inserted_rows), len(one.only_nominal)) == (1, 1)


def test_offsets_are_those_of_the_commands_in_every_frame():
    """Number by number; the tool is turned by what is written, whatever the frames."""
    found = compared(TURNED_BASE, TOOL, False)
    into = pose(TURNED_BASE)[:3, :3].T
    partner = {0: 0, 1: 2, 2: 3, 3: 4, 4: 5, 5: 6, 6: 7, 7: 8, 9: 9}
    expected = [np.subtract(OTHER[b][-1], MOVES[a][-1]) / 1e3 for a, b in partner.items()]
    np.testing.assert_allclose(found.offset, np.array(expected) @ into.T, atol=1e-9)
    turns = {}
    for row, turn in TURN.items():
        one, other = (
            Rotation.from_euler("ZYX", np.add([180.0, 0.0, 180.0], by), degrees=True) for by in ((0, 0, 0), turn)
        )
        turns[row] = (one.inv() * other).magnitude()
    np.testing.assert_allclose(found.rotation, [turns.get(b, 0.0) for b in partner.values()], atol=1e-9)
