"""Constraints of random poses capsule by capsule: frames of another arm, distances by dense points on both axes."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.plan import constraints, search
from postproc.plan.sensitivity import direction
from tests.plan import setting
from tests.plan.setting import AROUND, BASIC, RIG

DENSE = np.linspace(0.0, 1.0, 61)
UNSURE = 5e-3
"""Distances [m] that dense points leave open."""


@pytest.fixture(scope="module")
def poses(tmp_path_factory):
    """A site, and poses with their loads: many of them in the way of something."""
    text = BASIC.replace("Z = 262\n", "Z = 262\nnormal = [0, 0, 1]\n").replace(
        "Z = 255\n", "Z = 255\nnormal = [1, 0, 1]\n"
    )
    site = setting.site(tmp_path_factory.mktemp("site"), text + RIG + AROUND)
    q, tilt = search.draw_poses(site, 60, np.random.default_rng(6))
    return site, q, tilt


def parts_of(site, angles, tilt):
    """Capsules (name, start, end, radius) of arm, tool and load."""
    frames = setting.ORACLE.frames(angles)
    joints, flange = [f[:3, 3] for f in frames], frames[6]
    along = frames[3][:3, :3] @ setting.ORACLE.axes[3]
    foot = joints[3] + along * ((joints[2] - joints[3]) @ along)
    corners = [np.zeros(3), joints[1], joints[2], foot, joints[4], flange[:3, 3]]
    names = ["column", "link 2", "elbow", "forearm", "hand"]
    arm = [(n, a, b, r) for n, a, b, r in zip(names, corners[:-1], corners[1:], site.radius, strict=True)]
    ends = [(flange @ [*point, 1.0])[:3] for point in (setting.LOAD_POINT, *setting.POINTS.values())]
    tool = [("tool", flange[:3, 3], end, site.tool_radius) for end in ends]
    if tilt is None:
        return arm, tool, [], ends
    low = ends[0] + direction(tilt[None])[0] * site.rig.rope
    load = [("rope", ends[0], low, 0.01), ("weight", low, low, site.rig.weight_radius)]
    return arm, tool, load if site.rig.weight_radius > 0.0 else load[:1], ends


def gap(one, other):
    """Distance of the axes of two capsules."""
    a, b = (start + DENSE[:, None] * (end - start) for _, start, end, _ in (one, other))
    return float(np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=2).min()))


def meeting(arm, tool, load):
    """Pairs that could meet: the front half of the forearm, and the forearm less its round end."""
    column, link, elbow, forearm, hand = arm
    name, start, end, radius = forearm
    front = (name, 0.5 * (start + end), end, radius)
    length = np.linalg.norm(end - start)
    short = (name, start, start + (1.0 - min(0.5, radius / length)) * (end - start), radius)
    pairs = [(part, other) for part in (column, link) for other in (front, hand, *tool)]
    pairs += [(elbow, other) for other in (hand, *tool)] + [(short, other) for other in tool]
    return pairs, [(part, other) for part in (column, link, elbow, short) for other in load]


def compare(name, allowed, margins):
    """Compare a constraint with how far poses are from it [m]; positive where it allows them."""
    is_sure = np.abs(margins) > UNSURE
    np.testing.assert_array_equal(allowed[is_sure], np.array(margins)[is_sure] > 0.0, err_msg=name)
    assert is_sure.mean() > 0.75


def test_the_floor_is_kept_by_all_parts_but_the_column(poses):
    site, q, tilt = poses
    margins = []
    for angles, lean in zip(q, tilt, strict=True):
        arm, tool, load, _ = parts_of(site, angles, lean)
        lows = [min(a[2], b[2]) - r for _, a, b, r in (*arm[1:], *tool, *load)]
        margins.append(min(lows) - site.floor - site.clearance)
    compare("floor", ~constraints.failures(site, q, tilt)["floor"], np.array(margins))


@pytest.mark.parametrize("part", ["column", "link 2", "elbow", "forearm"])
def test_parts_keep_the_clearance_or_four_fifths_of_their_gap_in_the_straight_arm(poses, part):
    site, q, tilt = poses
    straight, _ = meeting(*parts_of(site, np.zeros(6), None)[:3])
    least = [min(one[3] + other[3] + site.clearance, 0.8 * gap(one, other)) for one, other in straight]
    margins = []
    for angles, lean in zip(q, tilt, strict=True):
        near, loaded = meeting(*parts_of(site, angles, lean)[:3])
        gaps = [gap(*pair) - need for pair, need in zip(near, least, strict=True) if pair[0][0] == part]
        gaps += [gap(one, other) - one[3] - other[3] - site.clearance for one, other in loaded if one[0] == part]
        margins.append(min(gaps))
    name = f"tool, load and arm against the robot's {part}"
    compare(name, ~constraints.failures(site, q, tilt)[name], np.array(margins))


def test_boxes_are_kept_by_all_parts_but_the_column(poses):
    site, q, tilt = poses
    turn = np.radians(20.0)
    axes = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    margins = []
    for angles, lean in zip(q, tilt, strict=True):
        arm, tool, load, _ = parts_of(site, angles, lean)
        gaps = []
        for _, start, end, radius in (*arm[1:], *tool, *load):
            local = np.abs((start + DENSE[:, None] * (end - start) - [1.9, 0.0, 0.35]) @ axes.T) - [0.45, 0.6, 0.35]
            gaps.append(np.linalg.norm(np.maximum(local, 0.0), axis=1).min() - radius - site.clearance)
        margins.append(min(gaps))
    name = site.obstacles[0].name
    allowed = ~constraints.failures(site, q, tilt)[name]
    margins = np.array(margins)
    is_sure = np.abs(margins) > 0.02  # points along the parts are some centimetres apart
    np.testing.assert_array_equal(allowed[is_sure], margins[is_sure] > 0.0)
    assert 0 < allowed.sum() < len(allowed)


@pytest.mark.parametrize(("row", "name"), [(0, "P1"), (1, "P2")])
def test_markers_with_a_normal_look_at_the_tracker_within_their_acceptance(poses, row, name):
    site, q, tilt = poses
    normal = np.array([[0.0, 0, 1], [1, 0, 1]][row])
    margins = []
    for angles in q:
        flange = setting.ORACLE.frames(angles)[6]
        look = np.array([4.2, -2.5, 1.3]) - (flange @ [*setting.POINTS[name], 1.0])[:3]
        axis = flange[:3, :3] @ normal
        angle = np.arccos(axis @ look / np.linalg.norm(axis) / np.linalg.norm(look))
        margins.append(site.acceptance - angle)
    failures = constraints.failures(site, q, tilt)
    compare(name, ~failures[f"acceptance angle of marker {name}"], np.array(margins))
    assert "acceptance angle of marker P3" not in failures


def test_without_a_tracker_neither_sight_nor_acceptance_is_a_constraint(poses):
    site, q, tilt = poses
    names = set(constraints.failures(replace(site, tracker=None), q, tilt))
    assert not any(name.startswith(("line of sight", "acceptance")) for name in names)
    assert set(constraints.failures(site, q, tilt)) - names == {
        "acceptance angle of marker P1", "acceptance angle of marker P2",
        *(f"line of sight to marker P{number}" for number in (1, 2, 3)),
    }  # fmt: skip


@pytest.mark.parametrize("marker", [0, 1, 2])
def test_a_line_of_sight_passes_all_parts_that_do_not_contain_the_marker(poses, marker):
    site, q, tilt = poses
    name = list(setting.POINTS)[marker]
    turn = np.radians(20.0)
    axes = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    margins = []
    for angles, lean in zip(q, tilt, strict=True):
        arm, _, load, ends = parts_of(site, angles, lean)
        spot, eye = ends[1 + marker], np.array([4.2, -2.5, 1.3])
        sight = ("sight", eye, spot, 0.0)
        gaps = [np.inf]
        for part in (*arm, *load):
            contains = gap(("marker", spot, spot, 0.0), part) - part[3]
            gaps.append(max(gap(sight, part) - part[3], -contains))
        dense = eye + np.linspace(0.0, 1.0, 401)[:, None] * (spot - eye)
        in_box = (np.abs((dense - [1.9, 0.0, 0.35]) @ axes.T) - [0.45, 0.6, 0.35]).max(axis=1).min()
        margins.append(min(*gaps, in_box))
    text = f"line of sight to marker {name}"
    allowed, margins = ~constraints.failures(site, q, tilt)[text], np.array(margins)
    is_sure = np.abs(margins) > 4e-2  # dense points of the line of sight are 80 mm apart
    np.testing.assert_array_equal(allowed[is_sure], margins[is_sure] > 0.0)
    assert 0 < allowed.sum() < len(allowed)


def test_feasible_poses_break_none_of_the_constraints(poses):
    site, q, tilt = poses
    failures = constraints.failures(site, q, tilt)
    broken = np.any(list(failures.values()), axis=0) | (np.linalg.norm(tilt, axis=1) > site.rig.largest_tilt + 1e-9)
    assert (constraints.are_feasible(site, q, tilt) == ~broken).all()
    unloaded = {
        name: rows for name, rows in constraints.failures(site, q, tilt).items() if name.startswith("joint limits")
    }
    passable = constraints.are_passable(site, q)
    assert (passable >= constraints.are_feasible(site, q, tilt)).all()
    assert not (passable & unloaded["joint limits"]).any()
