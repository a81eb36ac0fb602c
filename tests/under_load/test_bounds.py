"""A path that no arm could drive is refused before any work, with its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from postproc import cell as cells
from postproc import correction, jobs, kinematics, robot, toolpath
from postproc.under_load import bounds
from tests.programs import program

SAMPLES = Path(__file__).parents[2] / "samples"
CELL = cells.load(SAMPLES / "cell_kr270.toml")
ROBOT = jobs.load_robot(CELL.robot)
DOWN = CELL.tool_pose_in_program()
UP = (0.0, 0.0, 1.0)
HEAD = [("PTP", 0, 0, 50), ("LIN", 0, 0, 0)]


@pytest.mark.parametrize(
    ("move", "kind"),
    [
        (("LIN", 9e6, 0, 0), "unreachable"),
        (("LIN", 0, 0, -5000), "unreachable"),
        (("RAPID", 0, -1e5, 0), "unreachable"),
        (("CIRC", 0, 0, 0, 9e5, 0, 0, 360.0, UP), "unreachable"),
        (("CIRC", 1000, 0, 0, 500, 4000, 0, 345.0, UP), "unreachable"),
        (("CIRC", 0, 0, 0, 5, 0, 0, 36e6, UP), "turns"),
        (("CIRC", 0, 0, 100, 5, 0, 0, 361000.0, UP), "turns"),
    ],
)
@pytest.mark.parametrize("mode", ["convert", "predict"])
def test_absurd_moves_are_refused_without_sampling(monkeypatch, move, kind, mode) -> None:
    monkeypatch.setattr(toolpath, "places", lambda *_, **__: pytest.fail("the path is sampled"))
    (issue,) = correction.process(program([*HEAD, move], orientation=DOWN), ROBOT, CELL, mode=mode).issues
    assert (issue.level, issue.kind, issue.source_line) == ("error", kind, 3)


def test_a_path_of_absurd_length_is_refused() -> None:
    there_and_back = [("LIN", 1500.0 * (n % 2), 0, 0) for n in range(30_000)]
    (issue,) = correction.process(program([*HEAD, *there_and_back], orientation=DOWN), ROBOT, CELL).issues
    assert (issue.level, issue.kind) == ("error", "path-length")


def test_flat_arcs_of_large_radius_and_threads_are_fine() -> None:
    flat = program([*HEAD, ("CIRC", 100, 0, 0, 50, -2e6, 0, np.degrees(100 / 2e6), (0, 0, -1))], orientation=DOWN)
    thread = program([*HEAD, ("CIRC", 0, 0, 50, 5, 0, 0, 360.0 * 40, UP)], orientation=DOWN)
    for made in (flat, thread):
        path = toolpath.segments(made, np.eye(4))
        bounds.check_ends(made, ROBOT)
        bounds.check_between(made, ROBOT, path)


@pytest.mark.parametrize("name", sorted(robot.shipped()))
def test_no_pose_within_the_joint_limits_is_beyond_the_reach(name: str) -> None:
    model = jobs.load_robot(name)
    rng = np.random.default_rng(3)
    q = rng.uniform(-np.pi, np.pi, (50_000, 6))
    away = np.linalg.norm(kinematics.tcp(model.nominal, q, np.eye(4))[0][:, :3, 3], axis=1)
    assert 0.8 < away.max() / bounds._reach(model) < 1.0
