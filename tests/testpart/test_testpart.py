"""A test part from design to model: the part is cut by a simulator that shares no code with the package."""

from __future__ import annotations

import csv
import json

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from postproc import machining, robot
from postproc.cli import main
from postproc.errors import MeasurementError
from postproc.machining import ProcessSource
from postproc.testpart import design, probing
from postproc.testpart.cut import surfaces
from postproc.testpart.fit import Prior, Readings, fit, linearised
from postproc.testpart.job import forces_of
from postproc.testpart.model import agreement
from tests.oracle.whole_arm import WholeArm
from tests.testpart import trial

CELL = str(trial.SAMPLES / "cell_kr270.toml")
BLOCK = ((0, 110), (0, 90), (-30, 0))
FEATURES = 4
SEED = 3


def run(*arguments, code=0):
    done = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert done.exit_code == code, done.output
    return done


CHOICE = []
"""What the part was chosen from, and the part."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("testpart")
    (folder / "process.toml").write_text(trial.process_text(BLOCK, 0.5))
    choose = design.choose

    def heard(*given):
        CHOICE[:] = [given, choose(*given)]
        return CHOICE[1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(design, "choose", heard)
        _write(folder)
    return folder / "out"


def _write(folder):
    run("testpart", "--cell", CELL, "--process", folder / "process.toml", "--features", FEATURES, "--depth", 3,
        "-o", folder / "out")  # fmt: skip


@pytest.fixture(scope="module")
def cut(folder):
    """A robot that differs by 30 %, forces by 10 %: the probed part, and the robot."""
    rng = np.random.default_rng(SEED)
    arm, scale = trial.truth(rng), 1.1
    cutter = trial.machine(arm, scale, 5.008)
    text = cutter.probed((folder / "testpart.nc").read_text(), (folder / "probing.csv").read_text(), rng)
    (folder / "probed.csv").write_text(text)
    return arm, scale


def readings(folder, name):
    program = trial.postproc.read_program(folder / "testpart.nc", trial.ROBOT, trial.CELL)
    setting = trial.RobotInCell.of(trial.ROBOT, trial.CELL)
    read = probing.read(folder / name)
    where = surfaces(program, setting, read, 5e-3)
    source = ProcessSource(machining.load(folder / "testpart.process.toml"), trial.CELL.tool.axis)
    return Readings(read, where, trial.SIGMA), setting, lambda: forces_of(program, setting, source, where)


def identify(folder, *options, code=0):
    return run("identify", "part", folder / "probed.csv", "--cell", CELL, "--process", folder / "testpart.process.toml",
               "--program", folder / "testpart.nc", *options, code=code)  # fmt: skip


def test_the_part_is_in_the_block_and_its_krl_is_marked_as_nominal(folder):
    rows = list(csv.DictReader((folder / "probing.csv").read_text().splitlines()))
    assert {row["feature"].partition(".")[0] for row in rows} == {f"F{k:02d}" for k in range(1, FEATURES + 1)}
    assert {row["deviation_mm"] for row in rows} == {""}
    for axis, (low, high) in zip("XY", BLOCK[:2], strict=True):
        assert all(low < float(row[axis]) < high for row in rows)
    assert "mode=nominal" in (folder / "testpart.src").read_text()
    known = json.loads((folder / "testpart.json").read_text())
    assert known["expected_after_mm"] < 0.2 * known["expected_before_mm"]
    assert known["known_to"]["k6"] > 0.99  # the tool is on the axis of A6


def test_the_model_predicts_the_surfaces_that_the_simulator_cuts(folder):
    """The simulator has the arm of the model: what remains is the map of the stock and the linear end of passes."""
    arm = WholeArm((trial.FOLDER / "robot.urdf").read_text(), trial.content())
    exact = trial.machine(arm).probed((folder / "testpart.nc").read_text(), (folder / "probing.csv").read_text())
    (folder / "exact.csv").write_text(exact)
    given, setting, states = readings(folder, "exact.csv")
    prior = Prior.of(setting.robot, 0.1)
    zero = np.zeros(len(prior.parameters))
    states = states()
    states(setting.robot, 1.0)
    found = linearised(prior, given, states(setting.robot, 1.0), setting, zero, 1.0)
    off = found.value - given.probed.deviation
    assert np.abs(given.probed.deviation).max() > 3e-4
    assert np.sqrt(np.mean(off**2)) < 4e-6
    assert np.abs(off).max() < 1.5e-5


def test_errors_on_other_jobs_are_less_and_inside_the_bound(folder, cut):
    arm, scale = cut
    done = identify(folder, "-o", folder / "my_robot")
    assert "the model may be used" in done.output
    (held,) = [line for line in done.output.splitlines() if "the part does not determine" in line]
    assert "k6" in held
    model = robot.load(folder / "my_robot")
    material = machining.load(_with(folder)).law()
    factor = material.cutting[0] / (trial.AL7075[0] * 1e6)
    q, force = trial.jobs(np.random.default_rng(8), 25)
    true = trial.deflections(arm, q, scale * force)
    before = np.linalg.norm(trial.predicted(trial.ROBOT, q, force) - true, axis=1)
    error = np.linalg.norm(trial.predicted(model, q, factor * force) - true, axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.4 * np.sqrt(np.mean(before**2))
    tool = np.eye(4)
    tool[2, 3] = 0.35
    spread = np.zeros((len(q), 6, 1))
    spread[:, :3, 0] = material.sigma * factor * force
    bound = trial.position_bound(model, q, tool, np.hstack([factor * force, np.zeros((len(q), 3))]), spread)
    assert np.mean(error <= bound) >= 0.9
    assert model.sources[5].value == trial.ROBOT.sources[5].value  # A6 keeps its prior
    assert model.measured.torque[0] > 50.0


def _with(folder):
    """A process that takes the forces as found."""
    text = (folder / "testpart.process.toml").read_text()
    head, _, rest = text.partition("[tools")
    path = folder / "found.process.toml"
    path.write_text('[material]\nfile = "my_robot/material.toml"\n[tools' + rest)
    assert "[material]" in head
    return path


def test_a_gross_error_is_named_and_left_out(folder, cut):
    rows = (folder / "probed.csv").read_text().splitlines()
    fields = rows[4].split(",")
    rows[4] = ",".join([*fields[:-1], f"{float(fields[-1]) + 0.2:.5f}"])
    (folder / "wrong.csv").write_text("\n".join(rows) + "\n")
    given, setting, states = readings(folder, "wrong.csv")
    found, left_out = fit(Prior.of(setting.robot, 0.1), given, setting, states())
    assert left_out == (fields[0],)
    assert found.gamma < 0.02


@pytest.mark.parametrize(
    ("factor", "advice"),
    [(-1.0, "positive where material is left"), (1000.0, "in millimetres?"), (0.0, "hardly any deflection")],
)
def test_deviations_of_another_sign_or_unit_are_named(folder, cut, factor, advice):
    rows = [line.rpartition(",") for line in (folder / "probed.csv").read_text().splitlines()]
    head, body = "".join(rows[0]), [f"{place},{factor * float(value):.5f}" for place, _, value in rows[1:]]
    (folder / "mistaken.csv").write_text("\n".join([head, *body]) + "\n")
    given, setting, states = readings(folder, "mistaken.csv")
    with pytest.raises(MeasurementError, match=r"times what the model predicts") as error:
        fit(Prior.of(setting.robot, 0.1), given, setting, states())
    assert advice in str(error.value)


def test_a_model_that_is_known_well_and_has_drifted_does_not_hold(folder, cut):
    given, setting, states = readings(folder, "probed.csv")
    vague = Prior.of(setting.robot, 0.1)
    sure = msgspec.structs.replace(vague, covariance=vague.covariance * 0.05**2, sigma_scale=0.002)
    found, _ = fit(sure.widened(), given, setting, states())
    compared = agreement(found, sure)
    assert not compared.holds
    assert compared.chi2 > 10 * agreement(found, vague).chi2
    assert identify(folder, "--compare").output.startswith("the model holds")
    given = ("--cell", CELL, "--process", folder / "testpart.process.toml", "--program", folder / "testpart.nc")
    done = run("identify", "validate", "kuka_kr270", folder / "probed.csv", *given)
    assert done.output.startswith("the model holds")


def test_derivatives_are_those_of_finite_differences(folder, cut):
    given, setting, states = readings(folder, "probed.csv")
    prior = Prior.of(setting.robot, 0.1)
    at = states()(setting.robot, 1.0)
    sigma = np.sqrt(np.diag(prior.covariance))
    z = 0.2 * sigma
    slopes = linearised(prior, given, at, setting, z, 1.1).slopes
    for k in range(len(z) + 1):
        step = np.append(sigma, 1.0) * 0.02 * (np.arange(len(z) + 1) == k)
        more, less = (
            linearised(prior, given, at, setting, z + sign * step[:-1], 1.1 + sign * step[-1]).value for sign in (1, -1)
        )
        expected = (more - less) / (2.0 * step[k])
        solved = 1e-9 / step[k]  # what the equilibrium is known to
        np.testing.assert_allclose(slopes[:, k], expected, atol=2e-3 * np.abs(expected).max() + solved)


def test_the_chosen_part_is_better_than_parts_at_random(folder):
    (found, prior, setting, tests, _), chosen = CHOICE
    rng = np.random.default_rng(1)
    others = [design.at_random(found, chosen.seconds, rng) for _ in range(60)]
    assert chosen.after < min(design.evaluated(found, prior, setting, tests, other).after for other in others)


def test_what_the_tool_does_not_make_is_refused(folder):
    rows = [row + "0.0" if k else row for k, row in enumerate((folder / "probing.csv").read_text().splitlines())]
    fields = rows[1].split(",")
    rows[1] = ",".join([*fields[:3], f"{float(fields[3]) + 1.0:.4f}", *fields[4:]])
    (folder / "moved.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(MeasurementError, match="the tool makes no surface") as caught:
        readings(folder, "moved.csv")
    assert caught.value.line == 2
    with pytest.raises(MeasurementError, match="0 of"):
        probing.read(folder / "probing.csv")


def test_only_flat_end_mills_are_taken(tmp_path):
    text = trial.process_text(BLOCK, 0.5).replace("flutes = 3", 'flutes = 3\nshape = "ball"')
    (tmp_path / "process.toml").write_text(text)
    given = ("--cell", CELL, "--process", tmp_path / "process.toml", "-o", tmp_path / "out")
    assert "flat end mill" in run("testpart", *given, code=1).output
