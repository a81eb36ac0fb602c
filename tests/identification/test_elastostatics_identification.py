"""Identification against a robot that shares no code with it (`simulator`): known truths, unseen seeds."""

import dataclasses
import json

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import elastostatics, robot
from postproc.errors import MeasurementError
from postproc.identification import identify_folder
from postproc.identification.fit import to_file_units
from postproc.identification.measurement_model import locate
from postproc.identification.plausibility import check_loads
from postproc.identification.procedure import identify
from postproc.identification.readings import ASSUMED_LOAD_ERROR
from samples.paper_study import harness, simulator
from tests.commands import invoke

SIGMA = 0.03e-3


def paper_experiment(folder, seed=11, **options):
    rng = np.random.default_rng(seed)
    true = simulator.paper_like(rng, options.pop("stiff_compensator", True))
    q, f = simulator.plan(rng, options.pop("count", 15), **options)
    exact, raw = simulator.measure(true, q, f, rng, SIGMA)
    return true, exact, harness.load(simulator.write(folder, q, f, raw)), raw


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_paper_like_robot_every_k_within_three_intervals_or_one_percent(tmp_path, seed):
    true, _, data, _ = paper_experiment(tmp_path, seed)
    result = identify(harness.PRIOR, data)
    parameters, values, covariance = to_file_units(result.fit)
    assert [parameter.name for parameter in parameters] == ["k1", "k2", "k3", "k4", "k5", "k6", "K_c", "s_0"]
    expected = np.r_[1e6 / true.gear.k, true.comp[0], true.comp[1] * 1e3]
    half = 1.96 * np.sqrt(np.diag(covariance))
    error = np.abs(values - expected)
    assert np.all(error[:6] < np.maximum(3 * half[:6], 0.01 * expected[:6]))
    assert error[6] < 0.25 * expected[6]
    assert result.choice is None
    assert not result.missing
    # the second step of the paper gives the same, a little less sharply
    assert abs(result.spring.values[1] - expected[6]) < 4 * 1.96 * np.sqrt(result.spring.covariance[1, 1])


def test_95_percent_intervals_cover_the_truth_and_leave_no_bias(tmp_path):
    """6 runs here, without an error of the loads; 500 in samples/paper_study."""
    true, exact, *_ = paper_experiment(tmp_path)
    edited(tmp_path / "experiment.toml", lambda text: "load_error_percent = 0\n" + text)
    data = harness.load(tmp_path)
    expected = np.r_[1e6 / true.gear.k, true.comp[0], true.comp[1] * 1e3]
    rng = np.random.default_rng(0)
    scores = []
    for _ in range(6):
        noisy = harness.with_readings(data, simulator.readings(exact, rng, SIGMA, 3))
        _, values, covariance = to_file_units(identify(harness.PRIOR, noisy, depth="joints").fit)
        scores.append((values - expected) / np.sqrt(np.diag(covariance)))
    scores = np.array(scores)
    assert np.mean(np.abs(scores) < 1.96) > 0.88  # 48 intervals
    assert 0.75 < np.sqrt(np.mean(scores**2)) < 1.2  # eight of each run: ±0.1
    assert np.all(np.abs(scores.mean(axis=0)) < 1.63)  # 4 standard errors of a mean of 6


def test_noise_free_readings_show_that_nothing_is_linearised(tmp_path):
    """Eq. (8) alone would be off by 0.2–0.3 % at 2.7 kN."""
    true, exact, data, _ = paper_experiment(tmp_path)
    clean = harness.with_readings(data, np.repeat(exact[:, :, None], 3, axis=2))
    _, values, _ = to_file_units(identify(harness.PRIOR, clean).fit)
    np.testing.assert_allclose(values[:6], 1e6 / true.gear.k, rtol=2e-4)


def test_milling_job_is_corrected_by_100_and_2_4_times_better_than_serial(tmp_path):
    true, _, data, _ = paper_experiment(tmp_path, 21)
    jobs = simulator.milling_jobs(np.random.default_rng(21))
    factor = {
        method: harness.job_factor(true, identify(harness.PRIOR, data, method).robot(), jobs)
        for method in ("enhanced", "serial")
    }
    assert factor["enhanced"] > 100.0
    assert factor["enhanced"] > 2.4 * factor["serial"] > 24.0


def test_serial_chain_without_compensator_is_found_by_both_methods(tmp_path):
    rng = np.random.default_rng(3)
    true = simulator.TrueRobot(simulator.Gear("linear", 1 / simulator.PAPER_K, np.ones(6)))
    q, f = simulator.plan(rng, 15)
    _, raw = simulator.measure(true, q, f, rng, SIGMA)
    data = harness.load(simulator.write(tmp_path, q, f, raw))
    for method in ("serial", "enhanced"):
        _, values, _ = to_file_units(identify(harness.PRIOR, data, method).fit)
        np.testing.assert_allclose(values[:6], simulator.PAPER_K * 1e6, rtol=0.05)


def hard_experiment(folder, **kind):
    """Measure a robot with flexible links into the files of a folder."""
    rng = np.random.default_rng(703)
    true = simulator.hard(rng, **kind)
    q, f = simulator.plan(rng, 30, tilt=50.0)
    _, raw = simulator.measure(true, q, f, rng, 0.05e-3)
    simulator.write(folder, q, f, raw, 0.05e-3)
    return true


def assert_predicted_far_better_than_by_joint_springs(true, result, data):
    joints = identify(harness.PRIOR, data, depth="joints")
    jobs = simulator.milling_jobs(np.random.default_rng(1))
    factor, plain = (harness.job_factor(true, r.robot(), jobs) for r in (result, joints))
    assert factor > 40.0
    assert factor > 2.0 * plain
    assert "link springs" in result.choice.reason
    errors = [candidate.held_out for candidate in result.choice.candidates]
    chosen = next(i for i, candidate in enumerate(result.choice.candidates) if candidate.chosen)
    assert errors[chosen] <= 1.05 * min(errors)


@pytest.mark.parametrize(
    "kind",
    [
        {"gear": "settling", "links": "end", "base": True},
        {"gear": "cubic", "links": "begin", "feel_rest": False},
    ],
)
def test_hard_robot_is_predicted_far_better_than_by_joint_springs(tmp_path, kind):
    true = hard_experiment(tmp_path, **kind)
    data = harness.load(tmp_path)
    assert_predicted_far_better_than_by_joint_springs(true, identify(harness.PRIOR, data), data)


def test_vertical_loads_leave_k1_open_and_the_prior_is_kept(tmp_path):
    _, _, data, _ = paper_experiment(tmp_path, vertical=True)
    result = identify(harness.PRIOR, data)
    assert [entry.name for entry in result.missing if entry.name[0] == "k"] == ["k1"]
    # it counts in the bound with the spread that the prior states
    index = result.fit.structure.parameters.index(robot.JointCompliance("A1"))
    share = np.hypot(0.4, ASSUMED_LOAD_ERROR / 1.96)
    assert np.sqrt(result.fit.covariance[index, index]) == pytest.approx(share * harness.PRIOR.compliance[0], rel=1e-6)
    assert 0.3 < result.workspace.worst_level.bound_ratio < 1.0
    entry = next(entry for entry in result.missing if entry.name == "k1")
    assert "vertical" in entry.reason
    assert "sideways" in entry.advice
    assert result.robot().compliance[0] == harness.PRIOR.compliance[0]


def test_load_on_the_axis_of_a6_leaves_k6_open(tmp_path, monkeypatch):
    monkeypatch.setattr(simulator, "LOAD_POINT", np.array([0.0, 0.0, 0.2]))
    monkeypatch.setattr(simulator.TrueRobot.solve, "__defaults__", (np.array([0.0, 0.0, 0.2]), None, 40))
    _, _, data, _ = paper_experiment(tmp_path)
    result = identify(harness.PRIOR, data)
    assert [entry.name for entry in result.missing] == ["k6"]
    assert "on its axis" in result.missing[0].reason


def test_physically_sized_compensator_is_reported_as_not_observable(tmp_path):
    true, _, data, _ = paper_experiment(tmp_path, stiff_compensator=False)
    result = identify(harness.PRIOR, data)
    assert [entry.name for entry in result.missing] == ["K_c"]
    _, values, _ = to_file_units(result.fit)
    np.testing.assert_allclose(values, 1e6 / true.gear.k, rtol=0.05)


def test_a_gross_outlier_is_left_out_and_named(tmp_path):
    for repeats, row in ((3, "config 7, load 1, repeat 2, point P2"), (1, "config 7, load 1, repeat 1, point P2")):
        true, exact, _, _ = paper_experiment(tmp_path)
        rng = np.random.default_rng(5)
        q, f = simulator.plan(np.random.default_rng(5), 15)
        exact, _ = simulator.measure(true, q, f, rng, SIGMA)
        raw = simulator.readings(exact, rng, SIGMA, repeats)
        raw[6, 1, 1 if repeats == 3 else 0, 1] += [1.2e-3, -0.9e-3, 0.7e-3]
        data = harness.load(simulator.write(tmp_path, q, f, raw))
        result = identify(harness.PRIOR, data)
        assert len(result.left_out) == 1
        assert row in result.left_out[0]
        _, values, covariance = to_file_units(result.fit)
        assert np.all(np.abs(values[:6] - 1e6 / true.gear.k) < 4 * np.sqrt(np.diag(covariance)[:6]) * 1.96)


def test_model_folder_loads_and_bounds_its_prediction(tmp_path):
    true, *_ = paper_experiment(tmp_path)
    setup = tmp_path / "experiment.toml"
    setup.write_text(
        "load_error_percent = 0\n" + setup.read_text(encoding="utf-8"), encoding="utf-8"
    )  # simulated loads
    done = identify_folder(tmp_path / "measurements.csv", tmp_path / "experiment.toml", tmp_path / "model")
    model = robot.load(tmp_path / "model")
    data = json.loads((tmp_path / "model" / "identification.json").read_text(encoding="utf-8"))
    for name in ("k1", "k2", "k3", "k4", "k5", "k6", "K_theta2_0", "K_c", "s_0"):
        assert set(data["parameters"][name]) >= {"value", "ci95", "unit", "observable"}
    assert len(data["k2_levels"]) == 5
    assert data["residual"]["rms_mm"] < 0.06
    np.testing.assert_allclose(
        np.diag(model.stiffness)[:6], 1e6 / np.array([data["parameters"][f"k{i}"]["value"] for i in range(1, 7)])
    )
    q, f = simulator.milling_job(np.random.default_rng(0))
    wrench = np.c_[f, 0 * f]
    error = np.linalg.norm(
        elastostatics.deflect(model, q, harness.TOOL, wrench).twist[:, :3] - harness.true_deflection(true, q, f), axis=1
    )
    bound = elastostatics.position_bound(model, q, harness.TOOL, wrench)
    assert np.mean(error <= bound) > 0.85
    assert bound.max() < 40e-6, "an unmodelled error that one load of 15 configurations cannot exclude counts too"
    assert done.data.parameters["k1"].observable


def test_stiffening_gears_and_links_survive_the_model_folder(tmp_path):
    true = hard_experiment(tmp_path)
    done = identify_folder(tmp_path / "measurements.csv", tmp_path / "experiment.toml", tmp_path / "model")
    assert_predicted_far_better_than_by_joint_springs(true, done.result, harness.load(tmp_path))
    model, own = robot.load(tmp_path / "model"), done.result.robot()
    job, force = simulator.milling_job(np.random.default_rng(0))
    wrench = np.c_[force, 0 * force]
    written, memory = (elastostatics.deflect(m, job, harness.TOOL, wrench).twist for m in (model, own))
    np.testing.assert_allclose(written, memory, atol=2e-9)
    assert elastostatics.position_bound(model, job, harness.TOOL, wrench).max() < 0.2e-3


def edited(path, change):
    path.write_text(change(path.read_text()))


def scaled_forces(rows, factor, config=None):
    out = [rows[0]]
    for row in rows[1:]:
        cells = row.split(",")
        if config is None or cells[0] == config:
            cells[10:13] = [f"{float(c) * factor:.3f}" for c in cells[10:13]]
        out.append(",".join(cells))
    return out


def radians(rows):
    out = [rows[0]]
    for row in rows[1:]:
        cells = row.split(",")
        cells[4:10] = [f"{np.radians(float(c)):.6f}" for c in cells[4:10]]
        out.append(",".join(cells))
    return out


def moved_tracker(rows):
    out = [rows[0]]
    for row in rows[1:]:
        cells = row.split(",")
        if int(cells[0]) > 8:
            x, y, z = (float(c) for c in cells[16:])
            cells[16:] = [f"{-y + 400:.4f}", f"{x - 900:.4f}", f"{z + 100:.4f}"]
        out.append(",".join(cells))
    return out


def swapped(rows):
    return [
        r.replace(",P1,", ",PX,").replace(",P3,", ",P1,").replace(",PX,", ",P3,") if r.startswith("5,1,2,") else r
        for r in rows
    ]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: [x for x in r if ",P3," not in x], "no reading of point P3"),
        (
            lambda r: [
                x
                for x in r
                if not (x.startswith("4,1,") and ",P3," not in x) and not (x.startswith("4,0,") and ",P3," in x)
            ],
            "config 4, load 1: no point has readings with and without this load",
        ),
        (lambda r: [x for x in r if not x.startswith("6,0,")], "config 6: load 1 has no readings without load"),
        (lambda r: [x for x in r if not x.startswith("6,1,")], "config 6: only readings without load"),
        (lambda r: scaled_forces(r, 1 / 9.81), "forces look like kg"),
        (lambda r: scaled_forces(r, 1 / 9.81, "9"), r"config 9, load 1: .* the force looks like kg"),
        (lambda r: scaled_forces(r, -1.0), "against the forces"),
        (radians, "look like radians"),
        (swapped, r"config 5, load 1, repeat 2: .* names P1 and P3 are swapped"),
        (
            lambda r: [*r[:5], r[5].rpartition(",")[0] + ",nan", *r[6:]],
            "measurements.csv:6: column Z is not a finite",
        ),
        (moved_tracker, "readings from config 9 on are in another frame"),
        (lambda r: [x for x in r if x.split(",")[0] in ("config", "1")], "1 configurations of 3 points"),
        (lambda r: [x.replace(",P2,", ",Q2,") for x in r], "unknown point 'Q2'"),
        (lambda r: [*r, r[-1]], "given twice"),
    ],
)
def test_bad_measurements_name_the_row_or_say_what_to_measure(tmp_path, change, message):
    paper_experiment(tmp_path)
    edited(tmp_path / "measurements.csv", lambda text: "\n".join(change(text.splitlines())) + "\n")
    run = invoke(
        "identify",
        "elastostatics",
        tmp_path / "measurements.csv",
        "--experiment",
        tmp_path / "experiment.toml",
        "-o",
        tmp_path / "model",
    )
    assert run.exit_code == 1
    assert "Traceback" not in run.output
    import re

    assert re.search(message, run.output.replace("\n", " ")), run.output
    assert not (tmp_path / "model").exists()


def test_a_load_with_hardly_a_lever_is_none_in_another_unit_but_one_in_kilograms_is(tmp_path):
    """Such a load moves the points by a millimetre, in a direction that soft links and a stiff compensator decide."""
    true = simulator.hard(np.random.default_rng(7), feel_rest=False)
    true.gear.k = 1 / simulator.PAPER_K
    true = dataclasses.replace(
        true, links={link: 0.5 * c for link, c in true.links.items()}, comp=(6e6, 0.458, 0.18472, 0.68593, 0.1233)
    )
    rng = np.random.default_rng(1)
    q, f = simulator.plan(rng, 35, levels=(0, -20, -45, -70, -95, -120, -140))
    _, raw = simulator.measure(true, q, f, rng, 0.03e-3)
    data = harness.load(simulator.write(tmp_path, q, f, raw))
    placement = locate(harness.PRIOR, data)
    check_loads(harness.PRIOR, data, placement)
    for factor in (1 / 9.81, 9.81, -1.0):
        wrench = data.wrench.copy()
        wrench[data.loaded_states[4]] *= factor
        with pytest.raises(MeasurementError, match="config 5, load 1: displacement and force do not belong together"):
            check_loads(harness.PRIOR, replace(data, wrench=wrench), placement)


def test_wrong_angles_of_one_configuration_are_named(tmp_path):
    paper_experiment(tmp_path)
    text = (tmp_path / "measurements.csv").read_text().splitlines()
    rows = [text[0]]
    for row in text[1:]:
        cells = row.split(",")
        if cells[0] == "3":
            cells[4] = str(-float(cells[4]) + 25.0)
        rows.append(",".join(cells))
    (tmp_path / "measurements.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(Exception, match=r"config 3: without load the points are 897\.8 mm from where"):
        identify(harness.PRIOR, harness.load(tmp_path))


def test_commands_have_help_with_an_example():
    for command in ([], ["compensator"], ["elastostatics"]):
        run = invoke("identify", *command, "--help")
        assert run.exit_code == 0
        assert "Example" in run.output
