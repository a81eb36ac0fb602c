"""Calibration of the geometry against a robot whose joints stand tenths of a millimetre off, and which sags."""

import json
import tomllib

import msgspec
import numpy as np
import pytest

from postproc import elastostatics, frames, kinematics, robot
from postproc.errors import MeasurementError
from postproc.identification import Choices, calibration, geometry_folder, identify_folder
from postproc.identification.measurement_model import kabsch
from postproc.identification.model_folder import read_prior
from samples.paper_study import harness, simulator
from tests.commands import invoke


def measured(folder, seed=703, **kind):
    rng = np.random.default_rng(seed)
    true = simulator.hard(rng, **kind)
    q, f = simulator.plan(rng, 30, tilt=50.0)
    _, raw = simulator.measure(true, q, f, rng, 0.05e-3)
    simulator.write(folder, q, f, raw, 0.05e-3)
    return true


def at_rest(model, q):
    """Flange without load as the model puts it."""
    if model.subtract_reference:
        return kinematics.tcp(model.actual, elastostatics.coordinates(model, q), np.eye(4))[0]
    return elastostatics.deflect(model, q, np.eye(4), np.zeros((len(q), 6))).pose


def error_elsewhere(true, model, rng):
    """RMS distance [m] of a point on the tool at new configurations, after the best fit of base and tool."""
    q, f = simulator.plan(rng, 40)
    flange = [true.solve(q, 0 * f), at_rest(model, q)]
    # the frames of base and tool are free in a calibration: fit both alternately
    points = [pose[:, None, :3, 3] + np.einsum("nij,pj->npi", pose[:, :3, :3], harness_points()) for pose in flange]
    base = kabsch(points[1].reshape(-1, 3), points[0].reshape(-1, 3))
    tool = np.zeros((3, 3))
    for _ in range(30):
        moved = np.einsum("ij,njk,pk->npi", base[:3, :3], flange[1][:, :3, :3], tool)
        now = points[1] @ base[:3, :3].T + base[:3, 3] + moved
        back = np.einsum("ij,njk->nik", base[:3, :3], flange[1][:, :3, :3])
        tool = tool + np.einsum("nji,npj->npi", back, points[0] - now).mean(axis=0)
        carried = points[1] + np.einsum("njk,pk->npj", flange[1][:, :3, :3], tool)
        base = kabsch(carried.reshape(-1, 3), points[0].reshape(-1, 3))
    left = points[0] - (carried @ base[:3, :3].T + base[:3, 3])
    return float(np.sqrt(np.mean(np.sum(left**2, axis=2))))


def harness_points():
    return np.array(list(simulator.POINTS.values()))


def test_eighteen_displacements_are_left_for_a_six_axis_arm():
    """4·6 + 6 of a complete model, less the frames of base and tool."""
    for name in ("kuka_kr270", "kuka_kr16_2"):
        found = calibration.nonredundant_displacements(robot.load(robot.find(name)).nominal, 3)
        assert len(found) == 18
        assert not any(parameter.joint == "A1" for parameter in found)  # all of A1 is the base's


def test_geometry_and_sag_are_calibrated_to_a_tenth_of_a_millimetre(tmp_path):
    true = measured(tmp_path, gear="linear")
    done = identify_folder(
        tmp_path / "measurements.csv", tmp_path / "experiment.toml", tmp_path / "m", Choices(geometry=True)
    )
    assert "calibrated geometry with sag" in done.data.geometry.chosen
    before = error_elsewhere(true, harness.PRIOR, np.random.default_rng(9))
    after = error_elsewhere(true, robot.load(tmp_path / "m"), np.random.default_rng(9))
    assert before > 1.5e-3
    assert after < 0.25e-3
    # 95 % of errors in space are below 1.6 times their RMS; it is told by 30 configurations, and rather too large
    model = robot.load(tmp_path / "m")
    assert 1.2 * after < model.geometry_error.u95 < 3.0 * after
    inside = (model.geometry_error.lower + model.geometry_error.upper)[None] / 2
    bound = elastostatics.position_bound(model, inside, np.eye(4), np.zeros((1, 6)))
    np.testing.assert_allclose(bound, model.geometry_error.u95, rtol=0.02)


def test_base_and_points_that_are_written_are_those_of_the_calibrated_geometry(tmp_path):
    measured(tmp_path, gear="linear")
    data = identify_folder(
        tmp_path / "measurements.csv", tmp_path / "experiment.toml", tmp_path / "m", Choices(geometry=True)
    ).data
    readings = harness.load(tmp_path)
    flange = at_rest(robot.load(tmp_path / "m"), readings.q)
    base = frames.pose_from_xyzabc(np.array([data.base[axis] for axis in "XYZABC"]))
    points = np.array([[data.points[name][axis] for axis in "XYZ"] for name in readings.points]) * 1e-3
    predicted = np.einsum("ij,njk,pk->npi", base, flange, np.column_stack([points, np.ones(len(points))]))[..., :3]
    distance = np.linalg.norm(predicted - readings.means()[0][readings.unloaded_states], axis=2)
    assert data.unloaded_rms_mm == pytest.approx(1e3 * np.sqrt(np.mean(distance**2)), rel=1e-6)
    assert data.unloaded_rms_mm == data.geometry.variants[data.geometry.chosen].rms_mm


def test_gears_that_turn_further_once_and_twice_a_turn_are_found_and_only_those(tmp_path):
    """Springs, weights and compensator as in the model; five joints displaced, gears as they are, or turning wavily."""
    for size in (0.0, 1.5e-4):
        rng = np.random.default_rng(11)
        true = simulator.TrueRobot(
            simulator.Gear("linear", 1 / simulator.PAPER_K, np.ones(6)),
            masses=simulator.MASSES.copy(),
            comp=(1.2e5, 0.458, 0.18472, 0.68593, 0.1233),
            offsets=np.r_[0, rng.normal(0, 5e-4, 4), 0],
            waves=size * rng.normal(size=(6, 4)),
        )
        q, f = simulator.plan(rng, 40)
        _, raw = simulator.measure(true, q, f, rng, 0.05e-3)
        simulator.write(tmp_path, q, f, raw, 0.05e-3)
        content = read_prior(robot.find("kuka_kr270"), None, "")
        springs = {
            name: msgspec.structs.replace(content.joints[name], compliance_urad_per_Nm=float(k * 1e6))
            for name, k in zip(robot.JOINTS, simulator.PAPER_K, strict=True)
        }
        content = msgspec.structs.replace(content, joints=springs)
        found = calibration.identify_geometry(content, harness.PRIOR.nominal, "x", harness.load(tmp_path))
        variants = {name: held for name, (_, held) in found.rms.items()}
        calibrated = ("calibrated geometry", "calibrated geometry with sag")  # gear terms are sought with these alone
        assert {name for name in variants if name.endswith(", gears")} == {f"{name}, gears" for name in calibrated}
        if size == 0.0:
            assert found.chosen == "calibrated geometry with sag"
            assert not found.content.transmission
            continue
        assert found.chosen == "calibrated geometry with sag, gears"
        assert variants[found.chosen] < 0.3 * variants["calibrated geometry with sag"]
        names = [parameter.name for parameter in found.parameters]
        values, half = (
            np.array([each[names.index(f"{joint}.{term}")] for joint in robot.JOINTS for term in robot.GEAR_TERMS])
            for each in (found.values, found.ci95)
        )
        assert np.mean(np.abs(values - true.waves.ravel()) < half) > 0.85
        model = robot.assemble("x", found.content, harness.PRIOR.nominal)
        assert error_elsewhere(true, model, np.random.default_rng(9)) < 0.05e-3


def test_derivatives_by_waves_of_gears_are_those_by_finite_differences():
    nominal, rng = harness.PRIOR.nominal, np.random.default_rng(0)
    q, points, h = rng.uniform(-2, 2, (7, 6)), harness_points(), 1e-6
    _, columns = calibration._joint_derivatives(nominal, q, points)
    inside = columns.reshape(7, 3, 3, 6, 6)
    for joint in range(6):
        for index, term in enumerate(robot.GEAR_TERMS):
            moved = []
            for sign in (1, -1):
                amplitude = np.zeros((6, 4))
                amplitude[joint, index] = sign * h
                pose = nominal.joint_frames(robot.Transmission(amplitude).actual_angles(q.T).T)[1]
                moved.append(np.einsum("nij,pj->npi", pose[:, :3, :3], points) + pose[:, None, :3, 3])
            slope = (moved[0] - moved[1]).ravel() / (2 * h)
            parameter = calibration.GeometryParameter(robot.JOINTS[joint], term)
            np.testing.assert_allclose(
                calibration._parameter_column(parameter, inside, nominal, q)[:, 0], slope, atol=1e-8
            )


def test_command_writes_a_folder_that_carries_the_geometry(tmp_path):
    measured(tmp_path)
    run = invoke(
        "identify",
        "geometry",
        tmp_path / "measurements.csv",
        "--experiment",
        tmp_path / "experiment.toml",
        "-o",
        tmp_path / "g",
    )
    assert run.exit_code == 0, run.output
    model = robot.load(tmp_path / "g")
    assert not model.geometry_is_nominal
    told = json.loads((tmp_path / "g" / "identification.json").read_text(encoding="utf-8"))["geometry"]["parameters"]
    content = tomllib.loads((tmp_path / "g" / "model.toml").read_text(encoding="utf-8"))
    for name, entry in told.items():
        joint, axis = name.split(".")
        table = content["geometry" if axis[-1] in "XYZ" else "transmission"][joint]
        assert f"{axis} ± {entry['ci95']:.2g} {entry['unit']}" in table["source"]
        assert table[f"{axis}_{entry['unit']}"] == pytest.approx(entry["value"], rel=1e-6)
    data = json.loads((tmp_path / "g" / "identification.json").read_text(encoding="utf-8"))
    variants = data["geometry"]["variants"]
    assert (
        variants[data["geometry"]["chosen"]]["held_out_rms_mm"] < 0.4 * variants["nominal geometry"]["held_out_rms_mm"]
    )
    assert "Geometry: unloaded readings" in (tmp_path / "g" / "report.html").read_text(encoding="utf-8")


def test_of_variants_the_simplest_is_taken_that_is_worse_by_no_more_than_one_standard_error():
    base = np.linspace(1.0, 3.0, 16)
    other = np.where(np.arange(16) % 2, 0.4, -0.4) * np.sqrt(15 / 16)  # standard error 0.1
    for worse, taken in ((0.099, "simple"), (0.101, "rich")):
        found = {"poor": base + 9.0, "simple": base + other + worse, "rich": base, "richest": base}
        assert calibration.simplest_variant(found) == taken
    assert calibration.simplest_variant({"simple": base, "rich": base + 0.1}) == "simple"


def test_an_exact_robot_keeps_its_nominal_geometry(tmp_path):
    rng = np.random.default_rng(5)
    true = simulator.paper_like(rng)
    q, f = simulator.plan(rng, 15)
    _, raw = simulator.measure(true, q, f, rng)
    simulator.write(tmp_path, q, f, raw)
    done = geometry_folder(tmp_path / "measurements.csv", tmp_path / "experiment.toml", tmp_path / "g")
    assert done.data.geometry.chosen == "nominal geometry"
    assert robot.load(tmp_path / "g").geometry_is_nominal


def test_intervals_of_the_geometry_cover_the_truth(tmp_path):
    """Springs known, noise and joint displacements random: the identifiable offsets are inside their intervals."""
    inside = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        true = simulator.TrueRobot(
            simulator.Gear("linear", np.full(6, 1e12), np.ones(6)), offsets=np.r_[0, rng.normal(0, 5e-4, 4), 0]
        )
        q, f = simulator.plan(rng, 30)
        _, raw = simulator.measure(true, q, f, rng, 0.05e-3)
        simulator.write(tmp_path, q, f, raw, 0.05e-3)
        found = calibration.identify_geometry(
            read_prior(robot.find("kuka_kr270"), None, ""), harness.PRIOR.nominal, "x", harness.load(tmp_path)
        )
        assert not found.is_weightless
        names = [parameter.name for parameter in found.parameters]
        for joint, axis, sign in ((1, "RY", 1), (2, "RY", 1), (3, "RX", -1), (4, "RY", 1)):
            index = names.index(f"A{joint + 1}.{axis}")
            inside.append(abs(found.values[index] - sign * true.offsets[joint]) < 1.5 * found.ci95[index])
    assert np.mean(inside) > 0.9


def test_too_few_configurations_are_refused(tmp_path):
    measured(tmp_path)
    path = tmp_path / "measurements.csv"
    rows = path.read_text().splitlines()
    path.write_text("\n".join([rows[0], *(r for r in rows[1:] if int(r.split(",")[0]) <= 4)]) + "\n")
    with pytest.raises(Exception, match="Measure more configurations"):
        geometry_folder(path, tmp_path / "experiment.toml", tmp_path / "g")


def test_a_geometry_beyond_any_arm_is_a_variant_that_is_left_out():
    """Few readings let gear terms run away: such a fit is refused, and the others stand."""
    content = read_prior(robot.find("kuka_kr270"), None, "")
    parameters = (calibration.GeometryParameter("A1", "sin"),)
    with pytest.raises(MeasurementError, match="geometry cannot be found"):
        calibration._add_geometry(content, parameters, np.array([0.02]), "", None)


def test_the_equations_that_configurations_are_left_out_of_have_the_calibration_as_their_solution(tmp_path):
    """Zero for base and points, which are where they were found, and the values found for the joints."""
    measured(tmp_path, gear="linear")
    data = harness.load(tmp_path)
    content = read_prior(robot.find("kuka_kr270"), None, "")
    free = calibration.nonredundant_displacements(harness.PRIOR.nominal, len(data.points))
    solution = calibration._fit_geometry(content, harness.PRIOR.nominal, "x", data, free)
    state = np.linalg.lstsq(solution.design, solution.target, rcond=None)[0]
    known = 6 + 3 * len(data.points)
    half = 1.96 * np.sqrt(np.diag(solution.covariance))
    assert (np.abs(solution.values) > 3.0 * half).any()
    np.testing.assert_allclose(state[:known], 0.0, atol=1e-6)  # m, rad
    np.testing.assert_allclose((state[known:] - solution.values) / half, 0.0, atol=0.01)


def test_a_joint_that_hardly_moved_is_named_and_bounds_the_error_elsewhere(tmp_path):
    """A robot with wavy gears, measured with A1 and the wrist in small ranges and used far from them."""
    rng = np.random.default_rng(3)
    true = simulator.TrueRobot(
        simulator.Gear("linear", np.full(6, 1e12), np.ones(6)),
        offsets=np.r_[0, rng.normal(0, 5e-4, 4), 0],
        waves=2e-4 * rng.normal(size=(6, 4)),
    )
    q, f = simulator.plan(rng, 60)
    q[:, [0, 3, 4, 5]] = q[:1, [0, 3, 4, 5]] + rng.uniform(0, np.radians(2.0), (60, 4))
    _, raw = simulator.measure(true, q, f, rng, 0.05e-3)
    simulator.write(tmp_path, q, f, raw, 0.05e-3)
    done = geometry_folder(tmp_path / "measurements.csv", tmp_path / "experiment.toml", tmp_path / "g")
    warning = [text for text in done.data.warnings if "turned by" in text]
    assert len(warning) == 1
    assert warning[0].startswith("A1 turned by 2°, A4 turned by 2°, A5 turned by 2°, A6 turned by 2° in the readings")
    model = robot.load(tmp_path / "g")
    error = model.geometry_error
    np.testing.assert_allclose([error.lower, error.upper], [q.min(axis=0), q.max(axis=0)], atol=1e-4)
    elsewhere, _ = simulator.plan(rng, 60)
    assert np.median(error.at(elsewhere)) > 8.0 * error.u95
    left = error_at(true, model, q, elsewhere)
    assert np.mean(left > error.u95) > 0.5  # the bound of the readings does not hold there
    assert np.mean(left < error.at(elsewhere)) > 0.95


def error_at(true, model, used, elsewhere):
    """Errors (n,) [m] of a point on the tool, with the base where it fits the configurations used."""
    points = harness_points()[0]
    placed = []
    for q in (used, elsewhere):
        for pose in (true.solve(q, np.zeros((len(q), 3))), at_rest(model, q)):
            placed.append(pose[:, :3, 3] + pose[:, :3, :3] @ points)
    base = kabsch(placed[1], placed[0])
    return np.linalg.norm(placed[2] - (placed[3] @ base[:3, :3].T + base[:3, 3]), axis=1)
