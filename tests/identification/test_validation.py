"""What validation assures, and of what: torques covered by readings, shares of jobs, gears that differ by sign."""

import dataclasses
import json

import numpy as np
import pytest

from postproc import elastostatics, robot
from postproc.identification import Choices, identify_folder
from postproc.identification.validation import (
    MIN_CONFIGURATIONS,
    coverage,
    is_inside_coverage,
    job_lines,
    job_share,
    torque_lines,
    validate,
)
from samples.paper_study import harness, simulator
from tests.commands import invoke, run
from tests.places import ROOT

SIGMA = 0.03e-3
CELL, POCKET = ROOT / "samples" / "cell_kr270.toml", ROOT / "samples" / "pocket.nc"


def load_torques(q, force, point):
    """Torques (n, 6) of forces at a point of the flange frame, by the simulator's own chain."""
    bare = simulator.TrueRobot(simulator.Gear("linear", 1 / simulator.PAPER_K, np.ones(6)))
    frames = bare.frames(bare.commanded(q))
    flange = bare.flange(frames)
    return bare.pulled(frames, 5, flange[:, :3, 3] + flange[:, :3, :3] @ point, force)


def rest_torques(true, q):
    x = true.commanded(q)
    return true.position_forces(true.frames(x), x)[:, true.joint_rows]


BACKLASH = 0.3e-3
_A4 = 3


@pytest.fixture(scope="module")
def one_sided(tmp_path_factory):
    """A robot with backlash in A4, identified and validated by readings that press A4 to one flank alone."""
    folder = tmp_path_factory.mktemp("one_sided")
    rng = np.random.default_rng(12)
    backlash = np.zeros(6)
    backlash[_A4] = BACKLASH
    true = dataclasses.replace(
        simulator.paper_like(rng, stiff_compensator=False), backlash=backlash, gears_feel_rest=True
    )
    found_q, found_f = [], []
    while sum(map(len, found_q)) < 60:
        q, f = simulator.plan(rng, 60, tilt=50.0)
        pressed = (load_torques(q, f, simulator.LOAD_POINT)[:, _A4] > 40.0) & (rest_torques(true, q)[:, _A4] > 20.0)
        found_q.append(q[pressed])
        found_f.append(f[pressed])
    q, f = np.concatenate(found_q)[:60], np.concatenate(found_f)[:60]
    levels = (0.2, 1.0)
    for name, rows in (("identify", slice(0, 30)), ("validate", slice(30, 60))):
        raw = simulator.measure(true, q[rows], f[rows], rng, SIGMA, levels=levels)[1]
        simulator.write(folder / name, q[rows], f[rows], raw, SIGMA, levels=levels)
    own = [folder / "identify" / name for name in ("measurements.csv", "experiment.toml")]
    identify_folder(*own, folder / "model", Choices(structure="joints"))
    result = validate(folder / "model", folder / "validate" / "measurements.csv", own[1])
    return folder, true, result


def cuts(true, sign, rng, count=60):
    """Poses and forces of milling at the tool tip, with a torque on A4 of one sign, beyond what the weights put there.

    The torques on the other joints are positive and negative.
    """
    found_q, found_f = [], []
    tip = harness.TOOL[:3, 3]
    while sum(map(len, found_q)) < count:
        q, _ = simulator.plan(rng, 100)
        f = rng.normal(size=(100, 3))
        f *= 1500.0 / np.linalg.norm(f, axis=1, keepdims=True)
        own, rest = load_torques(q, f, tip)[:, _A4], rest_torques(true, q)[:, _A4]
        good = (sign * own > 40.0) & (rest > 20.0) & ((own + rest) * sign > 20.0)
        found_q.append(q[good])
        found_f.append(f[good])
    return np.concatenate(found_q)[:count], np.concatenate(found_f)[:count]


def test_a_job_that_turns_a_gear_over_is_not_assured_by_readings_that_never_do(one_sided):
    folder, true, result = one_sided
    assert result.keeps_bound, result.line
    assert result.covered.largest[_A4, 0] == 0.0
    model, rng = robot.load(folder / "model"), np.random.default_rng(5)
    kept, shares = {}, {}
    for sign in (-1, 1):
        q, f = cuts(true, sign, rng)
        wrench = np.c_[f, 0 * f]
        error = elastostatics.deflect(model, q, harness.TOOL, wrench).twist[:, :3] - harness.true_deflection(true, q, f)
        kept[sign] = np.linalg.norm(error, axis=1) <= elastostatics.position_bound(model, q, harness.TOOL, wrench)
        torque = load_torques(q, f, harness.TOOL[:3, 3])
        shares[sign] = job_share("part.nc", torque, np.full(len(q), 1.0 / len(q)), result.covered)
        if sign > 0:
            kept[sign] = kept[sign][is_inside_coverage(torque, result.covered)]
    assert len(kept[1]) >= 15
    assert kept[1].mean() > 0.8  # nearly as validated
    assert kept[-1].mean() < 0.2  # turned over: the error is that of the backlash
    assert shares[-1].share == 0.0
    assert any("negative torque on A4: no reading has it" in each.reason for each in shares[-1].outside)


def test_validate_says_for_which_share_of_a_job_the_model_holds(one_sided):
    folder, _, _ = one_sided
    readings = [
        str(folder / "validate" / "measurements.csv"),
        "--experiment",
        str(folder / "validate" / "experiment.toml"),
    ]
    command = ["identify", "validate", str(folder / "model"), *readings]
    alone = run(*command)
    assert alone.output.startswith("the model holds for the torques listed below: at ")
    assert "not covered: torques on " in alone.output
    cell = folder / "cell.toml"
    cell.write_text(CELL.read_text().replace('"kuka_kr270"', '"model"'))
    done = run(*command, "--program", POCKET, cell=cell, code=3)
    shares = [line for line in done.output.splitlines() if line.startswith("pocket.nc: ")]
    assert len(shares) == 1
    assert int(shares[0].split()[1].rstrip("%")) < 95
    assert "outside" in done.output
    assert "no reading has it" in done.output


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--cell", "c.toml"], "Give --cell and --program together"),
        (["--program", "p.nc"], "Give --cell and --program together"),
        (["--forces", "f.csv"], "need --cell and --program"),
        (["--cell", "c", "--program", "p", "--forces", "f", "--process", "p.toml"], "exclude each other"),
        (["--cell", "c", "--program", "p", "--process", "p.csv"], "is no .toml file"),
    ],
)
def test_options_of_a_job_go_together(options, message):
    done = invoke("identify", "validate", "m", "r.csv", "--experiment", "e.toml", *options)
    assert done.exit_code == 2
    assert message in done.output


def test_torques_of_the_identification_are_recorded_and_shown(one_sided):
    folder, _, result = one_sided
    data = (np.loadtxt(folder / "identify" / "measurements.csv", delimiter=",", skiprows=1, usecols=range(4, 13)),)
    rows = np.unique(data[0][np.abs(data[0][:, 6:]).max(axis=1) > 0], axis=0)
    torque = load_torques(np.radians(rows[:, :6]), rows[:, 6:], simulator.LOAD_POINT)
    recorded = json.loads((folder / "model" / "identification.json").read_text())["torques"]
    assert [each["joint"] for each in recorded] == ["A1", "A2", "A3", "A4", "A5", "A6"]
    # flange-fixed load point and nominal joint angles: the geometry of the model is that of the simulator
    np.testing.assert_allclose([each["positive_Nm"] for each in recorded], np.maximum(torque.max(axis=0), 0), rtol=1e-3)
    np.testing.assert_allclose([each["negative_Nm"] for each in recorded], np.minimum(torque.min(axis=0), 0), rtol=1e-3)
    a4 = recorded[_A4]
    assert (a4["negative_Nm"], a4["negative_configurations"], a4["positive_configurations"]) == (0.0, 0, 30)
    line = next(line for line in torque_lines(result.covered, result.identified) if line.strip().startswith("A4"))
    assert line.split()[1] == "none"
    assert line.split()[-3:] == ["0", "…", f"{a4['positive_Nm']:.0f}"]


def both_signs(count=10, size=100.0):
    """Torques of so many configurations of each sign, all joints alike, two levels each."""
    torque = np.outer(np.concatenate([np.linspace(0.5, 1.0, count), -np.linspace(0.5, 1.0, count)]), np.full(6, size))
    return np.concatenate([0.2 * torque, torque]), np.tile(np.arange(2 * count), 2)


def shares(covered, *torques):
    return [job_share("p", np.atleast_2d(np.array(each, dtype=float)), np.ones(1), covered) for each in torques]


def test_a_sign_and_a_size_that_readings_had_are_covered_and_others_are_not():
    covered = coverage(*both_signs())
    assert covered.is_covered.all()
    assert covered.least == pytest.approx(0.2 * 0.5 * (1 + 2 * 2 / 9 / 2))  # the fifth smallest of 0.1 … 0.2, in pairs
    fits = np.array([50.0, -99.0, 0.0, 0.5, 20.0, -20.0])
    beyond = np.array([50.0, -101.0, 0.0, 0.5, 20.0, -20.0])
    low = np.full(6, 5.0)
    assert [each.share for each in shares(covered, fits, beyond, low)] == [1.0, 0.0, 0.0]
    assert [each.outside[0].reason for each in shares(covered, beyond, low)] == [
        "negative torque on A2 beyond 100 N·m",
        "all torques below those of the smallest loads",
    ]
    torque, config = both_signs()
    one_sided = coverage(np.where(np.arange(6) == 2, np.abs(torque), torque), config)
    wrong = np.array([50.0, 0.0, -2.0, 0.0, 0.0, 0.0])
    assert not one_sided.is_covered[2, 0]
    (found,) = shares(one_sided, wrong)
    assert (found.share, found.outside[0].reason) == (0.0, "negative torque on A3: no reading has it")
    assert shares(one_sided, -wrong * [-1, 1, 1, 1, 1, 1])[0].share == 1.0


def test_fewer_configurations_than_needed_do_not_cover_a_sign():
    for count in (MIN_CONFIGURATIONS - 1, MIN_CONFIGURATIONS):
        covered = coverage(*both_signs(count))
        (found,) = shares(covered, [50.0, 0, 0, 0, 0, 0])
        assert found.share == float(count == MIN_CONFIGURATIONS)
        if count < MIN_CONFIGURATIONS:
            assert found.outside[0].reason == "positive torque on A1: 4 of 5 configurations needed have it"


def test_the_share_of_a_job_is_that_of_its_path():
    covered = coverage(*both_signs())
    torque = np.array([[50.0] * 6, [150.0] * 6, [5.0] * 6])
    found = job_share("part.nc", torque, np.array([0.6, 0.3, 0.1]), covered)
    assert found.share == pytest.approx(0.6)
    lines = job_lines([found])
    assert lines[0] == "part.nc: 60% of the cutting path is inside these torques"
    assert "  outside 30%: positive torque on A1 beyond 100 N·m" in lines


def test_a_direction_in_which_the_readings_contradict_the_model_is_not_assured():
    """Six of sixty configurations with a negative torque on A1 all fail: the whole passes, the direction does not."""
    from postproc.identification import validation

    torque = np.full((60, 6), 50.0)
    torque[:6, 0] = -50.0
    scaled = np.full((60, 3), 0.5)
    scaled[:6] = 3.0
    ones = np.ones((60, 3))
    found = validation._Displacements(
        is_compared=ones > 0, config=np.arange(60), load=np.full(60, 600.0), displacement=ones,
        prediction_error=ones * 1e-3, bound=ones, noise=ones * 1e-6, error_ratio=scaled, has_bound=True,
    )  # fmt: skip
    (level,) = validation._validated_levels(found)
    assert level.keeps_bound
    covered = validation._checked_coverage(torque, found)
    assert covered.refuted[0].tolist() == [True, False]
    (job,) = shares(covered, [-40.0, 50, 20, 20, 20, 20])
    assert job.share == 0.0
    assert job.outside[0].reason == "negative torque on A1: there the readings contradict the model"
