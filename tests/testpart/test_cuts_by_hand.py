"""The moves of a feature as a person writes them down, where surfaces may be made, and what the choice assumes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import kinematics
from postproc.errors import MeasurementError, PlanError
from postproc.kinematics.forward import GRAVITY
from postproc.testpart import cut, design, features
from postproc.testpart import fit as fitting
from postproc.testpart.cut import States, Surfaces
from postproc.testpart.features import Cutting, Feature, Kind
from postproc.testpart.prior import Prior
from postproc.testpart.probing import ProbedSurfaces
from tests.testpart import trial
from tests.testpart.test_by_formula import COUNT, READINGS, causes, prediction

CUTTING = Cutting(0.01, 6000.0, 0.018, 1, -0.002, 0.0005)
ROBOT_IN_CELL = trial.RobotInCell.of(trial.ROBOT, trial.CELL)
PRIOR = Prior.of(ROBOT_IN_CELL.robot, 0.1)

GROOVE = [  # u, v, w [mm], share of the feed, surface
    (16, 0, 5, 0, ""), (16, 0, 0.2, 0.5, ""), (0, 0, -1.5, 0.5, ""), (16, 0, -3, 0.5, ""), (0, 0, -3, 1, ""),
    (-16, 0, -3, 1, "groove"), (-16, 0, 5, 0, ""),
]  # fmt: skip


def trimming(step, low, high, depth, is_last):
    """Into the trimmed half in its middle, along its left wall to the middle of the groove, and back on the right."""
    return [
        (16, step / 2, 5, 0, ""), (16, step / 2, -depth, 0.5, ""), (16, high, -depth, 0.5, ""),
        (0, high, -depth, 1, "trim left" if is_last else ""), (0, low, -depth, 0.5, ""),
        (16, low, -depth, 1, "trim right" if is_last else ""), (16, low, 5, 0, ""),
    ]  # fmt: skip


@pytest.mark.parametrize("side", [0, 1, -1])
def test_a_feature_is_cut_by_these_moves(side):
    """A tool of 10 mm, 3 mm deep, steps of 4 mm; trimming takes 0.5, 0.6 mm off walls, 0.2, 0.25 off floors."""
    step = 4.0 * side
    widening = [
        (16, 0, 5, 0, ""), (16, 0, -3, 0.5, ""), (16, step, -3, 0.5, ""), (0, step, -3, 1, ""),
        (-16, step, -3, 1, "step"), (-16, step, 5, 0, ""),
    ]  # fmt: skip
    low, high = min(step, 0.0), max(step, 0.0)
    expected = [
        *GROOVE, *(widening if side else []), *trimming(step, low - 0.5, high + 0.5, 3.2, is_last=False),
        *trimming(step, low - 0.6, high + 0.6, 3.25, is_last=True),
    ]  # fmt: skip
    moves = features.passes(Kind(3e-3, side), CUTTING)
    np.testing.assert_allclose(1e3 * np.array([move.end for move in moves]), [row[:3] for row in expected], atol=1e-9)
    assert [(move.feed_share, move.name) for move in moves] == [row[3:] for row in expected]


@pytest.mark.parametrize("side", [0, 1, -1])
def test_the_probed_points_of_a_feature_are_these(side):
    """Half way along each half; walls at half the depth, floors of steps where only one of their passes cuts."""
    step = 4.0 * side
    low, high = min(step, 0.0), max(step, 0.0)
    left, right, up = (0, -1, 0), (0, 1, 0), (0, 0, 1)
    expected = [
        ("left", "step" if side > 0 else "groove", (-8, high + 5, -1.5), left),
        ("right", "step" if side < 0 else "groove", (-8, low - 5, -1.5), right),
        ("floor", "groove", (-8, -3 * side, -3), up),
        *([("step_floor", "step", (-8, step + 3 * side, -3), up)] if side else []),
        ("ref_left", "trim left", (8, high + 5.6, -1.5), left),
        ("ref_right", "trim right", (8, low - 5.6, -1.5), right),
        ("ref_floor", "trim right", (8, low - 0.6, -3.25), up),
    ]  # fmt: skip
    points = features.probes(Kind(3e-3, side), CUTTING)
    assert [(point.name, point.made_by, point.normal) for point in points] == [(*row[:2], row[3]) for row in expected]
    np.testing.assert_allclose(
        1e3 * np.array([point.point for point in points]), [row[2] for row in expected], atol=1e-9
    )


def test_the_text_of_a_groove_is_its_moves_turned_and_moved_to_its_place():
    """At 90° u is Y of the block, v is −X; the top is at −2 mm. The second feature begins at the same height."""
    place = Feature(Kind(3e-3, 0), 0.05, 0.06, 0.5 * np.pi)
    part = features.program([place, replace(place, x=0.1)], CUTTING)
    lines = part.text.splitlines()
    begin = lines.index("(F01: groove, depth 3 mm, 90 deg)")
    moves = [*GROOVE, *trimming(0, -0.5, 0.5, 3.2, is_last=False), *trimming(0, -0.6, 0.6, 3.25, is_last=True)]
    for x, first, is_second in ((50.0, begin + 1, False), (100.0, begin + 2 + len(moves), True)):
        for k, (u, v, w, feed, _) in enumerate(moves):
            place = f"X{x - v + 0.0:.4f} Y{60.0 + u:.4f}" + ("" if is_second and k == 0 else f" Z{w - 2.0:.4f}")
            assert lines[first + k] == (f"G1 {place} F{1080.0 * feed:.1f}" if feed else f"G0 {place}")
    assert lines[begin + 2 * (1 + len(moves)) :] == ["G0 Z18.0000", "M5", "M30"]
    assert part.features == 2
    np.testing.assert_allclose(part.t[:3], [0.5, 0.5, 0.5])
    np.testing.assert_allclose(part.point[0], [0.045, 0.052, -0.0035], atol=1e-12)
    np.testing.assert_allclose(part.normal[:3], [[1, 0, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-12)
    assert [lines[line - 1][:3] for line in part.line] == ["G1 "] * len(part.line)


LINE = "G21 G90 G17 G94\nT1 M6\nG0 X0 Y0 Z10\nG1 Z0 F600\nG1 X40\nG0 Z10\n"
RADIUS = 5e-3


def probed(points, normals, line=5, t=0.5, mass=None):
    count = len(points)
    return ProbedSurfaces(
        tuple(f"F{k:02d}.left" for k in range(1, count + 1)), np.full(count, line), np.full(count, t),
        1e-3 * np.array(points, dtype=float), np.array(normals, dtype=float), np.zeros(count),
        np.zeros(count) if mass is None else np.array(mass, dtype=float), ("",) * count, np.full(count, -1),
        np.arange(2, 2 + count), "probed.csv",
    )  # fmt: skip


def surfaces(*points, **fields):
    program = design.read_text(LINE, ROBOT_IN_CELL)
    return cut.surfaces(program, ROBOT_IN_CELL, probed(*zip(*points, strict=True), **fields), RADIUS)


WALL, FLOOR = (0, -1, 0), (0, 0, 1)
TILTED_WALL, TILTED_FLOOR = (0, -np.cos(0.009), np.sin(0.009)), (0, np.sin(0.14), np.cos(0.14))
MADE = {
    "a wall": ((20, 5, 3), WALL, 1), "its lowest point": ((20, 5, -0.049), WALL, 1),
    "the other wall": ((20, -5, 3), (0, 1, 0), 1),
    "a wall 0.049 mm away": ((20, 5.049, 3), WALL, 1), "a wall 0.049 mm in": ((20, 4.951, 3), WALL, 1),
    "a floor": ((20, 0, 0), FLOOR, 0), "its edge": ((20, 5.049, 0), FLOOR, 0),
    "a floor 0.049 mm up": ((20, 2, 0.049), FLOOR, 0),
    "a floor 0.049 mm down": ((20, 2, -0.049), FLOOR, 0), "a floor of 8°": ((20, 0, 0), TILTED_FLOOR, 0),
    "a wall half a degree from the tool": ((20, 5, 3), TILTED_WALL, 1),
}  # fmt: skip
NOT_MADE = {
    "a wall 0.051 mm away": ((20, 5.051, 3), WALL), "a wall 0.051 mm in": ((20, 4.949, 3), WALL),
    "a wall of the other side": ((20, 5, 3), (0, 1, 0)), "a wall below the tool": ((20, 5, -0.051), WALL),
    "a wall of another place": ((22, 5, 3), WALL), "a floor 0.051 mm up": ((20, 2, 0.051), FLOOR),
    "a floor 0.051 mm down": ((20, 2, -0.051), FLOOR), "a floor beyond the rim": ((20, 5.051, 0), FLOOR),
    "a ceiling": ((20, 0, 0), (0, 0, -1)), "a slope": ((20, 0, 0), (0, 0.6, 0.8)),
    "a floor of 9°": ((20, 0, 0), (0, np.sin(0.16), np.cos(0.16))),
    "a wall 0.6° from the tool": ((20, 5, 3), (0, -np.cos(0.011), np.sin(0.011))),
}  # fmt: skip


@pytest.mark.parametrize("kind", MADE)
def test_a_surface_that_the_tool_makes_is_found(kind):
    point, normal, wall = MADE[kind]
    found = surfaces((point, normal))
    assert found.is_wall.tolist() == [wall]
    assert found.t.tolist() == [0.5]
    assert not found.weight_wrench.any()
    np.testing.assert_allclose(found.point[0], 1e-3 * np.array(point))


@pytest.mark.parametrize("kind", NOT_MADE)
def test_a_surface_that_the_tool_does_not_make_is_refused_with_its_row(kind):
    point, normal = NOT_MADE[kind]
    with pytest.raises(MeasurementError, match=r"F02\.left: the tool makes no surface with this normal") as refused:
        surfaces(((20, 5, 3), WALL), (point, normal))
    assert refused.value.line == 3
    assert refused.value.advice


def test_a_gauge_reads_anywhere_at_the_end_of_a_rapid_move_and_its_weight_is_known():
    """Mass times gravity, down; a displacement d and a rotation r move the point at the lever l by d + r × l."""
    found = surfaces(((30, 7, 90), (0, 0, -1)), line=6, t=1.0, mass=[80.0])
    np.testing.assert_allclose(found.weight_wrench, [[0, 0, -GRAVITY * 80.0, 0, 0, 0]])
    assert found.is_wall.tolist() == [False]
    twist = np.array([1e-4, 2e-4, -3e-4, 2e-3, -1e-3, 5e-4])
    lever = 1e-3 * np.array([-10.0, 7.0, 80.0])  # the tip is at (40, 0, 10)
    np.testing.assert_allclose(found.deviation(twist[None])[0], -(twist[:3] + np.cross(twist[3:], lever))[2], rtol=1e-9)


@pytest.mark.parametrize(("line", "mass", "word"), [(6, None, "cutting"), (9, None, "cutting"), (5, [80.0], "rapid")])
def test_a_line_that_is_no_such_move_is_refused(line, mass, word):
    with pytest.raises(MeasurementError, match=f"line {line} of the program is not one {word} move") as refused:
        surfaces(((20, 5, 3), WALL), line=line, mass=mass)
    assert (refused.value.line, refused.value.file) == (2, "probed.csv")


def test_forces_of_the_choice_are_those_in_a_block_around_the_row_of_features(tmp_path):
    """A row at 40 mm, two half lengths of 16 mm on each side, 5 mm deeper than the deepest."""
    (tmp_path / "process.toml").write_text(trial.process_text(((0, 300), (0, 200), (-40, 0)), 0.5))
    process = trial.machining.load(tmp_path / "process.toml")
    source = design._source([Kind(3e-3, 0), Kind(1.5e-3, 1), Kind(2e-3, -1)], CUTTING, process, ROBOT_IN_CELL)
    box = source.process.stock.box
    for span, expected in ((box.X, (-32, 32)), (box.Y, (-40, 120)), (box.Z, (-10, -2))):
        assert span == pytest.approx(expected)
    assert source.process.stock.resolution_mm == 0.5


@pytest.mark.parametrize(("thickness", "is_refused"), [(5.16, True), (5.18, False)])
def test_a_block_has_two_millimetres_below_the_deepest_cut(tmp_path, monkeypatch, thickness, is_refused):
    """Grooves of 3 mm; trimming takes 0.4 times 0.3 mm and 0.05 mm more off their floors."""
    (tmp_path / "process.toml").write_text(trial.process_text(((0, 300), (0, 200), (-40, 0)), 0.5))
    process = trial.machining.load(tmp_path / "process.toml")
    monkeypatch.setattr(design, "loads", lambda kinds, *rest: pytest.fail(f"{len(kinds)} kinds"))
    box = trial.Box((0.0, 300.0), (0.0, 200.0), (-thickness, 0.0))
    with pytest.raises(
        PlanError if is_refused else pytest.fail.Exception, match=r"too thin for grooves of 3 mm|6 kinds"
    ):
        design.candidates(
            PRIOR, (ROBOT_IN_CELL,), process, replace(CUTTING, trim=3e-4), depth=3e-3, box=box, sigma=5e-6
        )


class LinearStates(SimpleNamespace):
    """States that deflect linearly in their unknowns."""

    def derivatives(self, place, robot, order, scale):
        return self.deflection, self.by_parameter, self.by_scale

    def twist_by_lift(self, place, robot, scale, twist):
        return self.by_height


def test_the_information_of_a_feature_is_that_of_its_readings_about_all_unknowns():
    """Two features of three points: a regression of each reading on the unknowns with the noise of its causes."""
    rng = np.random.default_rng(12)
    count, size = 3, len(PRIOR.sigma)
    rows = 2 * count
    states = LinearStates(
        deflection=1e-4 * rng.normal(size=(rows, 6)), by_parameter=rng.normal(size=(rows, 6, len(PRIOR.order))),
        by_scale=1e-4 * rng.normal(size=(rows, 6)), by_height=0.1 * rng.normal(size=(rows, 6)),
    )  # fmt: skip
    weight = np.repeat(rng.normal(size=(rows, 1, 6)), 2, axis=1)
    wall, none = np.array([1, 1, 0, 1, 0, 0], dtype=bool), np.zeros(rows)
    where = Surfaces(none.astype(int), none, weight, wall, np.zeros((rows, 6)), np.zeros((rows, 3)))
    normal, arm = rng.normal(size=(rows, 3)), 0.1 * rng.normal(size=(rows, 3))
    survey, points = design._Survey(PRIOR, CUTTING, 5e-6), design._ProbedPoints(where, arm, normal, count)
    information, deflection = design._information(survey, ROBOT_IN_CELL, states, points)
    np.testing.assert_allclose(deflection, np.linalg.norm(states.by_scale[:, :3], axis=1).reshape(2, count))
    for k in range(2):
        columns, noise = np.zeros((count, size + 8)), np.zeros((count, count))
        lifted, seen = np.zeros(count), np.zeros((count, 3))
        for i in range(count):
            n = k * count + i
            at = weight[n, 0]
            lifted[i] = at @ states.by_height[n]
            seen[i] = normal[n] + lifted[i] * np.array([0, 0, 1])
            columns[i, : size - 1] = at @ states.by_parameter[n] @ PRIOR.by_file * PRIOR.sigma[:-1]
            columns[i, size - 1] = 0.1 * (at @ states.by_scale[n])
            columns[i, size] = 5e-5 * wall[n]
            columns[i, size + 1 : size + 4] = 1e-2 * seen[i]
            columns[i, size + 4 : size + 7] = 1e-1 * np.cross(arm[n], seen[i])
            columns[i, size + 7] = 2e-5 * lifted[i]
            noise[i, i] = 5e-6**2 + (0.005 * deflection[k, i]) ** 2
        noise += 1e-4**2 * seen @ seen.T + 2e-5**2 * np.outer(lifted, lifted)
        expected = columns.T @ np.linalg.inv(noise) @ columns
        np.testing.assert_allclose(information[k], expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


def test_the_states_of_places_are_those_of_the_robot_at_them_and_those_out_of_reach_are_left_out():
    """Two places a feature; the second feature is beyond the arm. Wrenches are turned into root axes, at the tip."""
    tips = np.array([[0.05, 0.06, 0.01], [0.06, 0.06, 0.01], [9.0, 0.0, 0.0], [9.01, 0.0, 0.0]])
    rng = np.random.default_rng(4)
    wrench, by_lift = 100.0 * rng.normal(size=(4, 6)), rng.normal(size=(4, 6))
    states, reachable, rotation = design._states(ROBOT_IN_CELL, tips, wrench, by_lift, cutting=CUTTING, count=2)
    assert reachable.tolist() == [True, False]
    base = ROBOT_IN_CELL.cell.base.pose()
    np.testing.assert_allclose(rotation, np.broadcast_to(base[:3, :3], (4, 3, 3)), atol=1e-12)
    assert len(states.q) == 2
    root = kinematics.tcp(ROBOT_IN_CELL.robot.nominal, states.q, states.tool)[0]
    np.testing.assert_allclose(root[:, :3, 3], tips[:2] @ base[:3, :3].T + base[:3, 3], atol=1e-6)
    np.testing.assert_allclose(states.pose, root, atol=1e-6)
    for turned, given in ((states.wrench, wrench), (states.by_lift, by_lift)):
        np.testing.assert_allclose(turned[:, :3], given[:2, :3] @ base[:3, :3].T, atol=1e-9)
        np.testing.assert_allclose(turned[:, 3:], given[:2, 3:] @ base[:3, :3].T, atol=1e-9)
    assert not states.weight_wrench.any()
    assert not states.lift.any()


def test_features_with_a_place_beyond_a_joint_limit_are_left_out():
    """Two places a feature: the limit of one joint is between the places of the second feature."""
    tips = np.array([[0.05, 0.06, 0.01], [0.06, 0.06, 0.01], [0.05, 0.10, 0.01], [0.06, 0.12, 0.01]])
    none = np.zeros((4, 6))
    states, reached, _ = design._states(ROBOT_IN_CELL, tips, none, none, cutting=CUTTING, count=2)
    assert reached.tolist() == [True, True]
    q = states.q[:, 0]  # of the base joint
    order = np.argsort(q)
    assert order[0] == 3 or order[-1] == 3
    lower, upper = ROBOT_IN_CELL.robot.lower.copy(), ROBOT_IN_CELL.robot.upper.copy()
    if order[-1] == 3:
        upper[0] = 0.5 * (q[order[-1]] + q[order[-2]])
    else:
        lower[0] = 0.5 * (q[order[0]] + q[order[1]])
    robot = replace(ROBOT_IN_CELL.robot, lower=lower, upper=upper)
    narrow, reached, _ = design._states(replace(ROBOT_IN_CELL, robot=robot), tips, none, none, cutting=CUTTING, count=2)
    assert reached.tolist() == [True, False]
    np.testing.assert_allclose(narrow.q, states.q[:2], atol=1e-12)


def test_the_information_of_a_gauge_is_that_of_the_sag_under_its_weight():
    """One gauge in each of two placements, by differences of the sag at the places; the forces do not count."""
    places, mass = np.array([[0.05, 0.06, 0.1], [0.2, 0.1, 0.1]]), 80.0
    found = design.gauge_information(PRIOR, (ROBOT_IN_CELL, ROBOT_IN_CELL), CUTTING, mass, places, 5e-6)
    size = len(PRIOR.parameters)
    assert found.shape == (size + 16, size + 16)
    none = np.zeros((2, 6))
    states, _, _ = design._states(ROBOT_IN_CELL, places, none, none, cutting=CUTTING, count=1)
    weight = np.zeros((2, 6))
    weight[:, 2] = -9.80665 * mass
    hanging = replace(states, weight_wrench=weight)

    def sag(z):
        return -hanging.twist(ROBOT_IN_CELL, PRIOR.robot_with_change(z), 1.0)[:, 2]

    slopes = np.zeros((2, size))
    for k in range(size):
        step = np.zeros(size)
        step[k] = 1e-2 * PRIOR.values[k]
        slopes[:, k] = (sag(step) - sag(-step)) / (2.0 * step[k]) * PRIOR.sigma[k]
    noise = 5e-6**2 + (0.005 * sag(np.zeros(size))) ** 2
    expected = np.zeros_like(found)
    expected[:size, :size] = 2.0 * (slopes / noise[:, None]).T @ slopes
    np.testing.assert_allclose(found, expected, rtol=2e-2, atol=1e-3 * np.abs(expected).max())
    assert not design.gauge_information(PRIOR, (ROBOT_IN_CELL,), CUTTING, mass, np.zeros((0, 3)), 5e-6).any()
    with pytest.raises(PlanError, match="does not reach the places of the weight"):
        design.gauge_information(PRIOR, (ROBOT_IN_CELL,), CUTTING, mass, places + 9.0, 5e-6)


def test_a_fit_has_the_loads_torques_and_predictions_of_its_end():
    """The position of the part that is most probable, given what remains, is added to what the model predicts."""
    rng = np.random.default_rng(21)
    local, before = prediction(), prediction(9)
    q = np.radians(rng.uniform(-40, 40, (COUNT, 6)) + np.array([0, -70, 110, 0, 50, 0]))
    pose, wrench = np.tile(np.eye(4), (COUNT, 1, 1)), 100.0 * rng.normal(size=(COUNT, 6))
    states = States(q, pose, pose, wrench, np.zeros((COUNT, 6)), np.zeros(COUNT), np.zeros((COUNT, 6)))
    whole = np.diag([4e-2, 9e-2, 0.01])
    estimate = fitting._Estimate(
        READINGS, np.arange(COUNT), (), np.ones(3, dtype=bool), states, np.array([0.1, -0.2]), 1.2, 0.01, local
    )
    given = SimpleNamespace(covariance=whole, robot=ROBOT_IN_CELL.robot)
    found = fitting._fit_at_end(given, estimate, before, ("F01", "F02"))
    single = causes(local.by_lift)
    light = np.array([0, 0, 0, 1, 1, 0, 0, 0]) * 0.15 * local.displacement
    noise = single.T @ single + np.diag(5e-6**2 + (0.01 * local.displacement) ** 2 + light**2)
    part = single.T @ single @ np.linalg.inv(noise)
    deviation = READINGS.probed.deviation
    np.testing.assert_allclose(found.prediction, local.value + part @ (deviation - local.value), rtol=1e-6, atol=1e-12)
    remaining = deviation - before.value
    np.testing.assert_allclose(found.prior_prediction, before.value + part @ remaining, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found.prior_error, remaining)
    np.testing.assert_allclose(found.load, 1.2 * np.linalg.norm(wrench[:, :3], axis=1))
    step = 1e-6
    torque = np.zeros((COUNT, 6))
    for joint in range(6):
        ahead, behind = (
            kinematics.tcp(given.robot.nominal, q + sign * step * np.eye(6)[joint], pose)[0] for sign in (1, -1)
        )
        shift = (ahead[:, :3, 3] - behind[:, :3, 3]) / (2 * step)
        turn = (ahead[:, :3, :3] - behind[:, :3, :3]) / (2 * step) @ np.swapaxes(ahead[:, :3, :3], 1, 2)
        rotation = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        torque[:, joint] = np.sum(wrench[:, :3] * shift + wrench[:, 3:] * rotation, axis=1)
    np.testing.assert_allclose(found.torque, 1.2 * np.abs(torque).max(axis=0), rtol=1e-4)
    assert found.exchanged_pair == ("F01", "F02")
    assert (found.scale, found.gamma, found.z.tolist()) == (1.2, 0.01, [0.1, -0.2])


def states_of(value, count=2):
    """States with a wrench that tells them apart."""
    pose, none = np.tile(np.eye(4), (count, 1, 1)), np.zeros((count, 6))
    return States(none, pose, pose, np.full((count, 6), float(value)), none, np.zeros(count), none)


def test_forces_are_those_of_the_tool_deflected_as_by_the_round_before(monkeypatch):
    """Each program is cut rigid and lifted by 0.1 mm first; then once a round, by robot, scale and lift of the call."""
    calls = []

    def cut_of(program, place, source, where):
        calls.append((program, source))
        number = len(calls)
        return SimpleNamespace(
            surface_states=states_of(10 * number), lift_displacement=lambda height: ("lifted", height),
            shift=lambda place, robot, scale, lift: (number, place, robot, scale, lift),
        )  # fmt: skip

    def part(name):
        points = np.array([[1.0, 0, 0], [2.0, 0, 0]])
        return cut.ClampedProgram(
            name,
            f"cell of {name}",
            SimpleNamespace(shift_tip=lambda shift: ("by", shift)),
            SimpleNamespace(point=points),
        )

    monkeypatch.setattr(cut, "cut", cut_of)
    parts = [part("a"), part("b")]
    forces = cut.CutForces(parts)
    first = forces("robot", 1.0)
    assert [program for program, _ in calls] == ["a", "a", "b", "b"]
    assert [calls[k][1] for k in (1, 3)] == [("by", ("lifted", 1e-4))] * 2
    np.testing.assert_allclose(first.wrench[:, 0], [10, 10, 30, 30])
    np.testing.assert_allclose(first.by_lift, np.full((4, 6), 10.0 / 1e-4))
    assert not first.lift.any()
    lifts = [lambda points: 1e-3 * points[:, 0], lambda points: -1e-3 * points[:, 0]]
    second = forces("changed", 1.2, lifts)
    assert calls[4:] == [
        ("a", ("by", (1, "cell of a", "changed", 1.2, lifts[0]))),
        ("b", ("by", (3, "cell of b", "changed", 1.2, lifts[1]))),
    ]
    np.testing.assert_allclose(second.wrench[:, 0], [50, 50, 60, 60])
    np.testing.assert_allclose(second.lift, [1e-3, 2e-3, -1e-3, -2e-3])
    np.testing.assert_allclose(second.by_lift, first.by_lift)
    forces("again", 1.0, lifts)
    assert [source[1][0] for _, source in calls[6:]] == [5, 6]


def test_the_tip_moves_by_its_deflection_and_by_the_lift_along_z_of_the_base(monkeypatch):
    """The block is turned by 90° about X of the root: its Z is −Y there."""
    base = np.eye(4)
    base[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    program = design.read_text(LINE, ROBOT_IN_CELL)
    program = replace(program, bases=base[None])
    count, none = 3, np.zeros(3)
    tip = np.array([[0.1, 0, 0], [0.2, 0, 0], [0.3, 0, 0]])
    motion = np.array([1, 1, 2])
    whole = cut.Cut(states_of(0), states_of(0, count), motion, none, tip, program)
    twist = np.arange(18.0).reshape(3, 6) * 1e-5
    monkeypatch.setattr(States, "twist", lambda self, place, robot, scale: scale * twist)
    moved = whole.shift(None, None, 1.5, lambda points: 1e-2 * points[:, 0])
    expected = 1.5 * twist[:, :3] + np.array([[0, -1e-3, 0], [0, -2e-3, 0], [0, -3e-3, 0]])
    np.testing.assert_allclose(moved.offset, expected, atol=1e-12)
    np.testing.assert_allclose(whole.lift_displacement(2e-3).offset, [[0, -2e-3, 0]] * 3, atol=1e-12)
    assert moved.motion.tolist() == [1, 1, 2]
