"""Checks of readings on both sides of each limit: units, sets, loads, forces and frames."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.errors import MeasurementError
from postproc.files import CsvTable
from postproc.identification import dataset, plausibility
from postproc.identification import readings as files
from postproc.identification.measurement_model import levels_of
from postproc.robot import JOINTS
from samples.paper_study import harness
from tests.identification.test_joint_springs import POINTS, forces, placed, readings
from tests.identification.test_judgement import twice_loaded


def data_of(count=4, seed=1, **kind):
    return readings(forces(count, 400.0), count=count, seed=seed, **kind)


def refusal(check, *arguments):
    """The error of a check, or none."""
    try:
        check(*arguments)
    except MeasurementError as error:
        return error
    return None


@pytest.mark.parametrize(("largest", "count", "refused"), [(6.28, 2, True), (6.29, 2, False), (6.28, 1, False)])
def test_angles_that_are_all_below_one_turn_in_radians_are_no_degrees(largest, count, refused):
    q = np.zeros((count, 6))
    q[0, 3] = -largest
    error = refusal(files._check_units, q, data_of(), "m.csv")
    assert (error is not None) == refused
    if refused:
        assert f"no joint angle is larger than {largest:.3f}" in str(error)


@pytest.mark.parametrize(("span", "refused"), [(0.0099, True), (0.0101, False)])
def test_readings_within_a_centimetre_are_in_metres(span, refused):
    data = data_of()
    position = np.zeros_like(data.position)
    position[5, 1] = span
    error = refusal(files._check_units, np.full((4, 6), 90.0), replace(data, position=position), "m.csv")
    assert (error is not None) == refused
    assert not refused or "all readings lie within 9.9 mm" in str(error)
    assert refusal(files._check_units, np.full((1, 6), 90.0), replace(data, position=position), "m.csv") is None


@pytest.mark.parametrize(("span", "refused"), [(0.199, False), (0.201, True)])
def test_displacements_that_differ_by_a_fifth_of_a_metre_are_positions(span, refused):
    data = data_of()
    position = np.zeros_like(data.position)
    position[7, 2] = -span
    moved = replace(data, position=position, are_displacements=True)
    error = refusal(files._check_units, np.full((4, 6), 90.0), moved, "m.csv")
    assert (error is not None) == refused
    assert not refused or "displacements differ by 201 mm" in str(error)


def test_a_force_without_load_is_refused_with_its_line():
    data = data_of()
    wrench = data.wrench.copy()
    wrench[4, 5] = 0.1
    error = refusal(files._check_complete, replace(data, wrench=wrench), "m.csv", True)
    assert "config 3: load 0 means no load, but there is a force" in str(error)
    assert error.line == 2 + 4 * 8
    assert refusal(files._check_complete, data, "m.csv", True) is None


def test_a_reading_that_is_given_twice_names_both_lines():
    data = data_of()
    twice = data.repeat.copy()
    twice[12] = 1.0  # second repeat of the first point of the second state
    error = refusal(files._check_complete, replace(data, repeat=twice), "m.csv", True)
    assert "config 1, load 1, repeat 1, point P1 is given twice (also line 10)" in str(error)
    assert error.line == 14


def test_configurations_need_states_with_and_without_a_force():
    data = data_of()
    bare = replace(data, load=np.where(np.arange(8) == 4, 2.0, data.load))
    error = refusal(files._check_loads, bare, "m.csv", True)
    assert "config 3: load 2 has no readings without load (load 0)" in str(error)
    assert error.line == 2 + 4 * 8
    alone = replace(
        data, state_config=data.state_config[:7], load=data.load[:7], wrench=data.wrench[:7],
        **{name: getattr(data, name)[:56] for name in ("state", "point", "repeat", "position", "line", "used")},
    )  # fmt: skip
    error = refusal(files._check_loads, alone, "m.csv", True)
    assert "config 4: only readings without load" in str(error)
    assert error.line == 2 + 6 * 8
    assert refusal(files._check_loads, alone, "m.csv", False) is None  # enough for the geometry
    wrench = data.wrench.copy()
    wrench[5] = 0.0
    error = refusal(files._check_loads, replace(data, wrench=wrench), "m.csv", True)
    assert "config 3, load 1: the force is zero" in str(error)
    assert error.line == 2 + 5 * 8
    assert refusal(files._check_loads, replace(data, wrench=wrench), "m.csv", False) is None


@pytest.mark.parametrize(("off", "refused"), [(0.9e-3, False), (1.1e-3, True)])
def test_one_configuration_has_one_set_of_angles(off, refused):
    values = np.tile(np.arange(6.0), (4, 1))
    values[3, 4] += off
    rows = CsvTable({"config": np.array([1.0, 1, 2, 2])}, {}, np.array([2, 3, 4, 5]))
    check = partial(files._check_equal, reference=np.array([0, 0, 2, 2]), names=JOINTS, tolerance=1e-3, path=Path("m"))
    error = refusal(check, rows, values)
    assert (error is not None) == refused
    if refused:
        assert "config 2: A5 is 4.0011 here and 4 at line 4" in str(error)
        assert error.line == 5


def test_repeats_that_lack_a_point_are_listed_five_at_most():
    data = data_of()
    assert files.gaps(data) == []

    def lacking(count):
        missing = {(state, 1.0 + state % 2, state % 3) for state in range(count)}
        keep = np.array([(s, r, p) not in missing for s, r, p in zip(data.state, data.repeat, data.point, strict=True)])
        return replace(
            data,
            **{name: getattr(data, name)[keep] for name in ("state", "point", "repeat", "position", "line", "used")},
        )

    (text,) = files.gaps(lacking(5))
    names = [f"config {1 + s // 2}, load {s % 2}, repeat {1 + s % 2}: P{1 + s % 3}" for s in range(7)]
    assert text == f"points without a reading, the others are used: {'; '.join(names[:5])}"
    (text,) = files.gaps(lacking(7))
    assert text.endswith(f"{names[4]}; and 2 more")


def test_a_reading_is_named_by_line_configuration_load_repeat_and_point():
    data = replace(data_of(), config=np.array([1.0, 2.5, 3.0, 4.0]))
    assert data.name(8 * 3 + 4 + 2) == "line 32: config 2.5, load 1, repeat 2, point P3"


def test_means_and_scatter_are_those_of_the_readings_that_are_used():
    data = data_of()
    rng = np.random.default_rng(1)
    data = replace(data, position=rng.normal(size=data.position.shape), used=rng.random(len(data.state)) < 0.8)
    mean, count = data.means()
    squares, dof = 0.0, 0
    for state in range(8):
        for point in range(4):
            rows = [
                n for n in range(len(data.state)) if (data.state[n], data.point[n]) == (state, point) and data.used[n]
            ]
            assert count[state, point] == len(rows)
            if rows:
                np.testing.assert_allclose(mean[state, point], data.position[rows].mean(axis=0))
                squares += np.sum((data.position[rows] - data.position[rows].mean(axis=0)) ** 2)
                dof += 3 * (len(rows) - 1)
    assert data.scatter() == (pytest.approx(squares), dof)


def test_levels_of_the_second_joint_are_apart_by_two_degrees():
    data = data_of(6)
    q = data.q.copy()
    q[:, 1] = np.radians([-50.0, -48.1, -90.0, -46.2, -44.1, -88.5])
    assert levels_of(replace(data, q=q)).tolist() == [1, 1, 0, 1, 2, 0]


@pytest.mark.parametrize(("factor", "refused"), [(0.97, False), (1.03, True)])
def test_points_that_move_by_ten_centimetres_under_load_are_refused(factor, refused):
    data = data_of()
    position = data.position.copy()
    rows = (data.state == 5) & (data.point == 2)
    rest = data.position[(data.state == 4) & (data.point == 2)].mean(axis=0)
    position[rows] = rest + factor * 0.1 * np.array([0.6, 0.0, 0.8])
    error = refusal(plausibility.check_loads, harness.PRIOR, replace(data, position=position), placed(data))
    moved = error is not None and f"the points moved by {100 * factor:.0f} mm under load" in str(error)
    assert moved == refused
    if refused:
        assert str(error).startswith("m.csv") or "config 3, load 1" in str(error)
        assert error.line == 2 + 5 * 8


def scaled(data, factors):
    """Readings whose displacements are those that the prior predicts, times a factor for each state."""
    springs = harness.PRIOR.compliance[list(harness.PRIOR.actuated)]
    plain = readings(data.wrench[1::2], count=len(data.q), springs=springs)
    position = plain.position.copy()
    for state in range(1, len(data.load), 2):
        for point in range(len(data.points)):
            rows = (plain.state == state) & (plain.point == point)
            rest = plain.position[(plain.state == state - 1) & (plain.point == point)].mean(axis=0)
            position[rows] = rest + factors[state // 2] * (plain.position[rows] - rest)
    return replace(plain, position=position)


@pytest.mark.parametrize(
    ("factor", "outcome"),
    [
        (-1.0, "the points move against the forces"), (0.19, "the forces look like another unit than N"),
        (0.22, "check the scale"), (0.58, "check the scale"), (0.62, ""), (1.65, ""), (1.78, "check the scale"),
        (4.8, "check the scale"), (5.2, "another unit than N"), (6.2, "look like kg"), (15.5, "look like kg"),
        (16.5, "another unit than N"),
    ],
)  # fmt: skip
def test_forces_are_judged_by_how_far_the_points_move_compared_with_the_prior(factor, outcome):
    data = scaled(data_of(6), np.full(6, factor))
    robot = replace(harness.PRIOR, compensator=None)  # the readings are those of springs of joints alone
    if not 0.2 < factor < 5.0:
        with pytest.raises(MeasurementError, match=outcome):
            plausibility.check_loads(robot, data, placed(data))
        return
    notes = plausibility.check_loads(robot, data, placed(data))
    assert len(notes) == (outcome != "")
    if outcome:
        assert f"all points move {factor:.1f} times as far as" in notes[0]


@pytest.mark.parametrize(
    ("factor", "unit"),
    [
        (1.0, ""),
        (0.25, ""),
        (0.18, "another unit"),
        (4.8, ""),
        (5.3, "another unit"),
        (9.8, "kg"),
        (-1.0, "another unit"),
    ],
)
def test_one_load_that_does_not_belong_to_its_displacement_is_named(factor, unit):
    """Its displacement per newton is the largest or the smallest of all, or it is against the force."""
    factors = np.ones(6)
    factors[3] = factor
    data = data_of(6)
    alike = np.repeat(forces(1, 400.0), 12, axis=0) * (np.arange(12)[:, None] % 2)
    data = scaled(replace(data, wrench=alike), factors)
    robot = replace(harness.PRIOR, compensator=None)
    error = refusal(plausibility.check_loads, robot, data, placed(data), " Look at the rig.")
    assert (error is not None) == (unit != "")
    if unit:
        assert "config 4, load 1: displacement and force do not belong together" in str(error)
        assert f"the force looks like {unit}" in str(error)
        assert "Look at the rig." in str(error.advice or error)
        assert error.line == 2 + 7 * 8


@pytest.mark.parametrize(("count", "loads", "points"), [(30, 2, 3), (29, 1, 2)])
def test_a_folder_has_what_is_usual_from_its_number_on(count, loads, points):
    data = readings(forces(count, 400.0), count=count, points=POINTS[:points])
    wrench = data.wrench.copy()
    wrench[1::2] *= 400.0 / np.linalg.norm(wrench[1::2], axis=1, keepdims=True)
    data = replace(data, wrench=wrench)
    if loads == 2:
        data = twice_loaded(data, parallel=True)
    enough = count == 30
    found = dataset._reading_findings(data)
    assert [finding.is_present for finding in found] == [True, enough, enough, False, enough, True, True]
    assert found[2].text.startswith(f"loads of {'200' if loads == 2 else '400'} to 400 N on {loads} levels")


def test_names_of_the_dataset_that_are_empty_are_listed(tmp_path):
    text = 'name = "x"\nlicence = ""\nsource = "y"\nrobot = "r"\nrig = ""\ndevice = "d"\n'
    (tmp_path / "dataset.toml").write_text(text)
    (tmp_path / "LICENSE").mkdir()
    statement, licence = dataset._origin_findings(tmp_path)
    assert (statement.text, statement.is_present, statement.required) == (
        "dataset.toml: licence, rig empty",
        False,
        True,
    )
    assert (licence.is_present, licence.required) == (False, True)
    (tmp_path / "dataset.toml").write_text(text.replace('""', '"z"'))
    statement, _ = dataset._origin_findings(tmp_path)
    assert (statement.text, statement.is_present) == ("dataset.toml: x, z, from y", True)
    (tmp_path / "dataset.toml").write_text("name = 3\n")
    statement, _ = dataset._origin_findings(tmp_path)
    assert (statement.is_present, statement.required) == (False, True)


@pytest.mark.parametrize(
    ("percent", "share"), [("load_error_percent = 2.5\n", 0.025), ("", 0.01), ("load_error_percent = 0\n", 0.0)]
)
def test_a_stated_error_of_the_loads_is_a_share_and_one_per_cent_if_it_is_not_stated(tmp_path, percent, share):
    text = 'robot = "kuka_kr270"\nsigma_mm = 0.04\n' + percent
    text += "[load_point]\nX = 1\nY = 2\nZ = 300\n[points.P1]\nX = 10\nY = -20\nZ = 30\n"
    (tmp_path / "experiment.toml").write_text(text)
    setup = files.read_experiment(tmp_path / "experiment.toml")
    assert setup.load_error == pytest.approx(share)
    assert setup.sigma == pytest.approx(4e-5)
    assert (setup.payload, setup.rig, setup.tracker, setup.boxes, setup.meshes) == (None, None, None, [], [])
    payload = files.Payload(30.0)  # on the flange where its place is not stated
    assert (payload.X, payload.Y, payload.Z) == (0.0, 0.0, 0.0)
    assert setup.angles.to_robot(np.array([[1.0, 2, 3, 4, 5, 6]])).tolist() == [[1, 2, 3, 4, 5, 6]]
    assert (setup.floor.Z, setup.load_point_sigma_mm) == (0.0, 0.0)
    assert len(setup.assumptions) == (percent == "")
    np.testing.assert_allclose(setup.load_point.position(), [1e-3, 2e-3, 0.3])
    np.testing.assert_allclose(setup.points["P1"].position(), [0.01, -0.02, 0.03])
    (tmp_path / "experiment.toml").write_text(text[: text.index("[points")])
    with pytest.raises(MeasurementError, match="points"):
        files.read_experiment(tmp_path / "experiment.toml")
