"""Which kinds of motion each check of a path covers: a fault is planted on each, and what is left out has a reason."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.correction import checks
from postproc.program import LIN, PTP, SPL
from tests.correction.test_each_check import NORMAL, between, near
from tests.kr270 import CELL, ROBOT

NO_SINGULARITY = "axes move by themselves: a singular pose is no obstacle"
OWN_SPEED = "the controller drives the axes at speeds within their limits"
NO_FORCE = "no force acts on it, so nothing is corrected"
WORD = {LIN: "LIN", SPL: "SPL", PTP: "PTP"}
"""Arcs between their ends: `test_closely`. Collisions and material on PTPs and rapid moves: `test_joint_moves`."""
KINDS = {
    "joint_limit_issues": {LIN: "joint-limit-A1", SPL: "joint-limit-A1", PTP: "joint-limit-A1"},
    "singularity_issues": {LIN: "wrist-singularity", SPL: "wrist-singularity", PTP: NO_SINGULARITY},
    "joint_speed_issues": {LIN: "joint-speed-A1", SPL: "joint-speed-A1", PTP: OWN_SPEED},
    "correction_size_issues": {LIN: "correction-size", SPL: "correction-size", PTP: NO_FORCE},
}
"""Check → kind of motion → kind of the issue, or why there is none."""
OF_ONE_PLACE = {
    "start_joint_issues", "first_move_issues", "start_height_issues", "status_and_turn_issues", "posture_issues",
    "joint_issues_at_joins",
    "correction_issues_at_joins", "half_turn_issues", "blending_issues", "torque_warnings",
}  # fmt: skip
"""Checks of the start, of targets and of corners, which hold for any motion that has them."""


def planted(check, kind):
    """Kinds of errors of a program with a fault of this check on its third motion, of this kind."""
    kinds = np.array([PTP, LIN, kind, LIN])
    settings = {"kind": kinds, "rapid": np.array([True, False, kind == PTP, False])}
    first, last, model, cell = NORMAL, near(A1=11.0), ROBOT, CELL
    if check == "joint_limit_issues":
        first, last = near(A1=184.0), near(A1=185.2)
    elif check == "singularity_issues":
        first, last = near(A5=3.0), near(A5=0.1)
    elif check == "joint_speed_issues":
        model = replace(ROBOT, speed=ROBOT.speed * np.where(np.arange(6) == 0, 1e-4, 1.0))
        settings["feed"] = 0.05
    else:
        cell = replace(CELL, output=replace(CELL.output, max_correction_mm=1e-3))
    issues = between(first, last, model=model, cell=cell, **settings).issues
    return {issue.kind for issue in issues if issue.level == "error" and 3 in (issue.lines or (issue.source_line,))}


@pytest.mark.parametrize("kind", [LIN, SPL, PTP], ids=WORD.get)
@pytest.mark.parametrize("check", KINDS)
def test_a_fault_on_each_kind_of_motion_is_found_or_cannot_be(check, kind):
    expected = KINDS[check][kind]
    found = planted(check, kind)
    assert (expected in found) if "-" in expected and " " not in expected else not found, found


def test_every_check_is_listed():
    """A new check must say which kinds of motion it covers."""
    functions = {
        name
        for name, value in inspect.getmembers(checks, inspect.isfunction)
        if value.__module__ == checks.__name__ and not name.startswith("_")
    }
    assert functions - {"joint_speed"} == KINDS.keys() | OF_ONE_PLACE
