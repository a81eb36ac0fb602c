"""rs274, the stand-alone interpreter of LinuxCNC, as the oracle for G-code: it prints canonical moves."""

import math
import os
import re
import shutil
import subprocess
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from postproc.frames import Array
from postproc.program import CIRC, Program

RS274 = shutil.which("rs274")
needs_rs274 = pytest.mark.skipif(
    RS274 is None and not os.environ.get("CI"),
    reason="rs274 is not installed (Debian package linuxcnc-uspace); in CI it must be",
)


ALL_ZERO: Mapping[int, Array] = defaultdict(lambda: np.eye(4))


MACHINE: Mapping[int, Array] = {}
"""Work offsets are those that the program itself sets, by G10, G52, G92."""


class RejectedError(Exception):
    """rs274 does not accept a program."""


class Move(NamedTuple):
    """A canonical move of rs274, mm in the program frame; `rotation` > 0 is counterclockwise and counts turns.

    `offset` is the number of the work offset (1: G54), `state` what else was switched before: direction and speed of
    the spindle, coolant, sum of dwells [s], number of stops, last tool.
    """

    command: str
    end: Array
    centre: Array | None
    plane: str
    rotation: int
    feed: float
    offset: int
    state: tuple[str, float, bool, float, int, float]
    frame: Array = np.eye(4)
    """(4, 4) the program frame in that of the machine as rs274 reports it: G54 …, G10 R, G92 [mm]."""


def canonical(text: str, variables: str = "", files: Mapping[str, str] = {}, tools: Iterable[int] = ()) -> list[Move]:
    """Run rs274 on a program (that ends with M2) and return its moves.

    :param variables: content of its variable file: a number and its value on each line.
    :param files: further files of the folder, their names and texts.
    :param tools: the tools of its table in addition to 1 to 9, without length and diameter.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        order = sorted({*range(1, 10), *tools})
        (folder / "tool.tbl").write_text("".join(f"T{n} P{n} D0 Z0\n" for n in order))
        (folder / "part.ngc").write_text(text, newline="")
        (folder / "part.var").write_text(variables)
        for other, content in files.items():
            (folder / other).write_text(content)
        result = subprocess.run(
            [RS274 or "rs274", "-g", "-t", "tool.tbl", "-v", "part.var", "part.ngc"],
            cwd=folder,
            env={**os.environ, "HOME": name},  # it keeps a memory map there
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            timeout=600,
        )
    if result.returncode:
        assert result.returncode == 1, result
        raise RejectedError(result.stdout + result.stderr)
    return list(_moves(result.stdout, order))


def accepts(text: str) -> bool:
    """Return whether rs274 accepts a program."""
    try:
        canonical(text)
    except RejectedError:
        return False
    return True


SPINDLE = {"START_SPINDLE_CLOCKWISE": "cw", "START_SPINDLE_COUNTERCLOCKWISE": "ccw", "STOP_SPINDLE_TURNING": ""}


def _moves(output: str, tools: list[int]) -> Iterator[Move]:
    unit, plane, feed, offset, end = 1.0, "XY", 0.0, 1, np.zeros(3)
    origin, shift, turn = np.zeros(3), np.zeros(3), 0.0
    spindle, speed, coolant, dwells, stops, tool = "", 0.0, False, 0.0, 0, 0.0
    for command, arguments in re.findall(r"^ *\d+ N(?:\.+|\d+) *(\w+)\((.*)\)$", output, re.MULTILINE):
        numbers = [float(n) for n in re.findall(r"-?\d+(?:\.\d+)?", arguments)]
        state = (spindle, speed if spindle else 0.0, coolant, dwells, stops, tool)
        if command == "USE_LENGTH_UNITS":
            unit = {"CANON_UNITS_MM": 1.0, "CANON_UNITS_INCHES": 25.4}[arguments]
        elif command == "SELECT_PLANE":
            plane = arguments[-2:]
        elif command == "SET_FEED_RATE":
            feed = numbers[0] * unit
        elif command == "SET_G5X_OFFSET":
            offset, origin = int(numbers[0]), np.array(numbers[1:4]) * unit
        elif command == "SET_G92_OFFSET":
            shift = np.array(numbers[:3]) * unit
        elif command == "SET_XY_ROTATION":
            turn = math.radians(numbers[0])
        elif command in SPINDLE:
            spindle = SPINDLE[command]
        elif command == "SET_SPINDLE_SPEED":
            speed = numbers[1]
        elif command in ("FLOOD_ON", "MIST_ON", "FLOOD_OFF", "MIST_OFF"):
            coolant = command.endswith("ON")
        elif command == "DWELL":
            dwells += numbers[0]
        elif command in ("PROGRAM_STOP", "OPTIONAL_PROGRAM_STOP"):
            stops += 1
        elif command == "CHANGE_TOOL":  # the row of the table
            tool = float(tools[int(numbers[0]) - 1]) if numbers and numbers[0] else 0.0
        elif command in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED"):
            end = np.array(numbers[:3]) * unit
            yield Move(command, end, None, plane, 0, feed, offset, state, _frame(origin, shift, turn))
        elif command == "ARC_FEED":
            start, order = end, {"XY": [0, 1, 2], "XZ": [2, 0, 1], "YZ": [1, 2, 0]}[plane]
            end, centre = np.empty(3), np.empty(3)
            end[order] = np.array([numbers[0], numbers[1], numbers[5]]) * unit
            centre[order] = np.array([numbers[2], numbers[3], start[order[2]] / unit]) * unit
            yield Move(command, end, centre, plane, int(numbers[4]), feed, offset, state, _frame(origin, shift, turn))


def _frame(origin: Array, shift: Array, turn: float) -> Array:
    frame = np.eye(4)
    frame[:2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
    frame[:3, 3] = origin + frame[:3, :3] @ shift
    return frame


def assert_same_moves(
    program: Program,
    expected: list[Move],
    scale: float,
    *,
    digits: float = 1e-6,
    offsets: Mapping[int, Array] = ALL_ZERO,
) -> None:
    """Compare motions with canonical moves of a program whose lengths are `scale` times as long.

    :param digits: by how much positions may differ [mm].
    :param offsets: (4, 4) pose in `$BASE` of the program frame of each work offset, by its number [m]; `MACHINE`: as
        rs274 reports them.
    """

    def in_base(move: Move, point: Array) -> Array:
        if offsets is MACHINE:
            return np.asarray(move.frame[:3, :3] @ point + move.frame[:3, 3])
        pose = offsets[move.offset]
        return np.asarray(pose[:3, :3] @ (point / scale) + pose[:3, 3] * 1e3)

    places = [in_base(move, move.end) for move in expected]
    starts = [np.full(3, np.nan), *places]
    pairs = [
        (start, end, move)
        for n, (start, end, move) in enumerate(zip(starts, places, expected, strict=False))
        if n == 0 or move.command == "ARC_FEED" or np.linalg.norm(end - start) > 2.0 * digits
    ]
    motions = program.motions
    position, rapid, circular = motions.target[:, :3, 3] * 1e3, motions.rapid, motions.kind == CIRC
    if digits > 1e-6:  # moves so short that the oracle's digits do not show them
        steps = np.linalg.norm(np.diff(position, axis=0, prepend=np.inf), axis=1)
        assert len(motions) - int(np.sum((steps < 4.0 * digits) & ~circular)) <= len(pairs) <= len(motions)
        if len(motions) != len(pairs):
            return
    assert len(motions) == len(pairs)
    np.testing.assert_allclose(position, [end for _, end, _ in pairs], rtol=0.0, atol=digits)
    assert rapid.tolist() == [move.command == "STRAIGHT_TRAVERSE" for *_, move in pairs]
    assert circular.tolist() == [move.command == "ARC_FEED" for *_, move in pairs]
    feeds = [move.feed for *_, move in pairs if move.command[-4:] == "FEED"]
    np.testing.assert_allclose(motions.feed[~rapid] * 60e3, feeds, rtol=1e-4 if digits > 1e-6 else 1e-7)
    for n in np.flatnonzero(circular):
        start, end, move = pairs[n]
        assert move.centre is not None
        rotation = (move.frame if offsets is MACHINE else offsets[move.offset])[:3, :3]
        centre = in_base(move, move.centre)
        axes = {"XY": [0, 1], "XZ": [2, 0], "YZ": [1, 2]}[move.plane]
        normal = rotation[:, ({0, 1, 2} - set(axes)).pop()] * math.copysign(1.0, move.rotation)
        np.testing.assert_allclose(motions.normal[n], normal, rtol=0.0, atol=1e-12)
        off = (motions.centre[n] * 1e3 - centre) - normal * ((motions.centre[n] * 1e3 - centre) @ normal)
        assert np.linalg.norm(off) < max(digits, 1e-6) * 10.0
        expected_sweep = _sweep((start - centre) @ rotation, (end - centre) @ rotation, axes, move.rotation, digits)
        radius = float(np.linalg.norm((start - centre) - normal * ((start - centre) @ normal)))
        assert abs(motions.sweep[n] - expected_sweep) < 1e-5 + 20.0 * digits / radius
    assert [*_states(program)] == [move.state for *_, move in pairs]


def _sweep(start: Array, end: Array, axes: list[int], rotation: int, digits: float) -> float:
    """Angle turned, from vectors that begin at the centre."""
    a, b = (math.atan2(p[axes[1]], p[axes[0]]) for p in (start, end))
    turned = (b - a if rotation > 0 else a - b) % (2.0 * math.pi)
    if np.hypot(*(end - start)[axes]) < digits:
        turned = 2.0 * math.pi
    return turned + 2.0 * math.pi * (abs(rotation) - 1)


def _states(program: Program) -> Iterator[tuple[str, float, bool, float, int, float]]:
    """What is switched before each motion, as in `Move.state`."""
    spindle, speed, coolant, dwells, stops, tool = "", 0.0, False, 0.0, 0, 0.0
    events = list(program.events)
    for motion in range(len(program.motions)):
        while events and events[0].before <= motion:
            event = events.pop(0)
            if event.kind in ("spindle_on", "spindle_ccw", "spindle_off"):
                spindle = {"spindle_on": "cw", "spindle_ccw": "ccw", "spindle_off": ""}[event.kind]
                speed = event.value
            elif event.kind in ("coolant_on", "coolant_off"):
                coolant = event.kind == "coolant_on"
            elif event.kind == "dwell":
                dwells += event.value
            elif event.kind == "stop":
                stops += 1
            elif event.kind == "tool_change":
                tool = event.value
        yield spindle, speed if spindle else 0.0, coolant, dwells, stops, tool
