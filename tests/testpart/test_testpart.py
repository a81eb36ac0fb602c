"""A test part from design to model: the part is cut by a simulator that shares no code with the package."""

from __future__ import annotations

import csv
import json
from itertools import combinations

import msgspec
import numpy as np
import pytest

from postproc import correction, machining, robot
from postproc.errors import MeasurementError
from postproc.machining import ProcessSource
from postproc.testpart import design, probing
from postproc.testpart.cut import ClampedProgram, CutForces, surfaces
from postproc.testpart.fit import fit, swapped_features
from postproc.testpart.linear import linearise, noise_covariance, posterior_covariance
from postproc.testpart.model import agreement, summary
from postproc.testpart.prior import Prior
from postproc.testpart.readings import Readings
from tests.commands import run
from tests.oracle.whole_arm import WholeArm
from tests.places import CELL_FILE
from tests.testpart import trial

BLOCK = ((0, 110), (0, 90), (-30, 0))
FEATURES = 4
SEED = 4


TRUE = {}
"""Compliances of the simulated robot, by joint."""
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
    small = "[output]\ndivide_into_modules = true\nprogram_memory_MB = 0.001"  # a test part stays in one program
    (folder / "small.toml").write_text(CELL_FILE.read_text().replace("[output]", small))
    inputs = ["--cell", folder / "small.toml", "--process", folder / "process.toml"]
    run("testpart", *inputs, "--features", FEATURES, "--depth", 3, "-o", folder / "out")


@pytest.fixture(scope="module")
def cut(folder):
    """A robot that differs by 30 %, forces by 10 %: the probed part, and the robot."""
    rng = np.random.default_rng(SEED)
    arm, scale = trial.truth(rng), 1.1
    again = np.random.default_rng(SEED)
    content = trial.content().joints
    TRUE.update({joint: content[joint].compliance_urad_per_Nm * np.exp(0.3 * again.normal()) for joint in trial.JOINTS})
    cutter = trial.machine(arm, scale, 5.008)
    text = cutter.probed((folder / "testpart.nc").read_text(), (folder / "probing.csv").read_text(), rng)
    (folder / "probed.csv").write_text(text)
    return arm, scale


def readings(folder, name):
    program = trial.postproc.read_program(folder / "testpart.nc", trial.ROBOT, trial.CELL)
    robot_in_cell = trial.RobotInCell.of(trial.ROBOT, trial.CELL)
    read = probing.read(folder / name)
    where = surfaces(program, robot_in_cell, read, 5e-3)
    source = ProcessSource(machining.load(folder / "testpart.process.toml"), trial.CELL.tool.axis)
    return (
        Readings.of(read, where, trial.SIGMA),
        robot_in_cell,
        lambda: CutForces([ClampedProgram(program, robot_in_cell, source, where)]),
    )


def identify(folder, *options, code=0):
    given = ("--process", folder / "testpart.process.toml", "--program", folder / "testpart.nc")
    return run("identify", "part", folder / "probed.csv", *given, *options, code=code, cell=CELL_FILE)


@pytest.fixture(scope="module")
def identified(folder, cut):
    """The result of the command that identified the robot from the part."""
    return identify(folder, "-o", folder / "my_robot")


@pytest.fixture(scope="module")
def fitted(folder, cut):
    """Prior, fit and the points left out, of the same part."""
    given, robot_in_cell, states = readings(folder, "probed.csv")
    prior = Prior.of(robot_in_cell.robot, 0.1)
    return prior, *fit(prior, given, robot_in_cell, states())


def test_the_part_is_in_the_block_and_its_krl_is_marked_as_nominal(folder):
    rows = list(csv.DictReader((folder / "probing.csv").read_text().splitlines()))
    names = {f"F{k:02d}" for k in range(1, FEATURES + 1)} | {f"T{k:02d}" for k in range(1, 5)}
    assert {row["feature"].partition(".")[0] for row in rows} == names
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
    given, robot_in_cell, states = readings(folder, "exact.csv")
    prior = Prior.of(robot_in_cell.robot, 0.1)
    zero = np.zeros(len(prior.parameters))
    states = states()
    states(robot_in_cell.robot, 1.0)
    found = linearise(prior, given, states(robot_in_cell.robot, 1.0), robot_in_cell, z=zero, scale=1.0)
    off = found.value - given.probed.deviation
    assert np.abs(given.probed.deviation).max() > 3e-4
    assert np.sqrt(np.mean(off**2)) < 4e-6
    assert np.abs(off).max() < 1.5e-5


def test_errors_on_other_jobs_are_less_and_inside_the_bound(folder, cut, identified):
    arm, scale = cut
    assert "the model may be used" in identified.output
    (held,) = [line for line in identified.output.splitlines() if "the part does not determine" in line]
    assert "k6" in held
    model = robot.load(folder / "my_robot")
    material = machining.load(_with(folder)).law()
    factor = material.cutting[0] / (trial.AL7075[0] * 1e6)
    q, force = trial.jobs(np.random.default_rng(8), 25)
    true = trial.deflections(arm, q, scale * force)
    before = np.linalg.norm(trial.predicted(trial.ROBOT, q, force) - true, axis=1)
    error = np.linalg.norm(trial.predicted(model, q, factor * force) - true, axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.4 * np.sqrt(np.mean(before**2))
    bound = trial.bound(model, material, q, factor * force)
    assert np.mean(error <= bound) >= 0.9
    apart = trial.bound(model, material, q, factor * force, together=False)
    assert (bound < apart).all()
    assert bound.mean() < 0.75 * apart.mean()
    assert model.sources[5].value == trial.ROBOT.sources[5].value  # A6 keeps its prior
    assert model.measured.torque[0] > 50.0


SLOT = """G21 G90 G17 G94
T1 M6
S6000 M3
G0 X20 Y20 Z5
G1 Z-2 F300
G1 X60 F900
G0 Z5
N70 G0 X20 Y50
G1 Z-2 F300
G1 X60 F900
G0 Z5
M30
"""


@pytest.fixture(scope="module")
def found(folder, identified):
    """The cell with the model that was identified from the part."""
    path = folder / "cell.toml"
    path.write_text(CELL_FILE.read_text().replace('robot = "kuka_kr270"', f'robot = "{folder / "my_robot"}"'))
    return path


def test_convert_counts_the_product_only_for_the_forces_that_it_was_identified_with(folder, found):
    (folder / "slot.nc").write_text(SLOT)
    cell = trial.postproc.load_cell(found)
    own = robot.load(folder / "my_robot")
    program = trial.postproc.read_program(folder / "slot.nc", own, cell)

    def expected(more="", of_material=""):
        process = machining.load(_with(folder, more, of_material))
        result = correction.process(program, own, cell, ProcessSource(process, cell.tool.axis), "predict")
        return result.bound

    known, wider = expected(), expected(of_material="sigma_percent = 8.0\n")  # stated, not that of the part
    assert known.max() < 0.85 * wider.max()
    given = expected('[operations.N70]\nFx = -100.0\nFy = 150.0\nsigma_percent = 1.0\nframe = "BASE"\n')
    first = len(known) // 2
    np.testing.assert_allclose(given[:first], known[:first], rtol=1e-6)
    there = given[first:]
    # in the slot, where bounds are smallest: no factor of the material
    assert there[there > 0.0].min() > 1.8 * known[known > 0.0].min()


def _with(folder, more="", of_material=""):
    """A process that takes the forces as found."""
    text = (folder / "testpart.process.toml").read_text()
    head, _, rest = text.partition("[tools")
    path = folder / "found.process.toml"
    path.write_text(f'[material]\nfile = "my_robot/material.toml"\n{of_material}{more}[tools' + rest)
    assert "[material]" in head
    return path


def test_a_gross_error_is_named_and_left_out(folder, cut):
    rows = (folder / "probed.csv").read_text().splitlines()
    row = next(k for k, line in enumerate(rows) if line.startswith("F01.ref_left"))
    fields = rows[row].split(",")
    rows[row] = ",".join([*fields[:-1], f"{float(fields[-1]) + 0.2:.5f}"])
    (folder / "wrong.csv").write_text("\n".join(rows) + "\n")
    given, robot_in_cell, states = readings(folder, "wrong.csv")
    found, left_out = fit(Prior.of(robot_in_cell.robot, 0.1), given, robot_in_cell, states())
    assert left_out == (fields[0],)
    assert found.gamma < 0.02
    verdict = summary(found, left_out).verdict
    assert verdict.refused
    assert f"{fields[0]} contradicts the other points" in verdict.line


def test_features_probed_in_each_others_place_are_named(folder, cut):
    """No pair is named where none was exchanged; each pair that was exchanged is."""
    given, robot_in_cell, states = readings(folder, "probed.csv")
    prior, here = Prior.of(robot_in_cell.robot, 0.1), states()(robot_in_cell.robot, 1.0)
    local = linearise(prior, given, here, robot_in_cell, z=np.zeros(len(prior.parameters)), scale=1.0)
    assert swapped_features(prior, given, local) is None
    rows = {name: row for row, name in enumerate(given.probed.name)}
    features = sorted({name.partition(".")[0] for name in rows})
    named = []
    for pair in combinations(features, 2):
        surfaces_of = [{name.partition(".")[2] for name in rows if name.startswith(f"{each}.")} for each in pair]
        if surfaces_of[0] != surfaces_of[1]:
            continue
        order = np.arange(len(rows))
        for surface in surfaces_of[0]:
            first, second = (rows[f"{each}.{surface}"] for each in pair)
            order[first], order[second] = second, first
        probed = msgspec.structs.replace(given.probed, deviation=given.probed.deviation[order])
        named.append((pair, swapped_features(prior, msgspec.structs.replace(given, probed=probed), local)))
    assert named
    assert all(pair == said for pair, said in named), named


@pytest.mark.parametrize(
    ("factor", "advice"),
    [
        (-1.0, "positive where material is left"), (1000.0, "in millimetres?"), (0.0, "hardly any deflection"),
        (1.0 / 25.4, "Is deviation_mm in inch?"),
    ],
)  # fmt: skip
def test_deviations_of_another_sign_or_unit_are_named(folder, cut, factor, advice):
    rows = [line.rpartition(",") for line in (folder / "probed.csv").read_text().splitlines()]
    head, body = "".join(rows[0]), [f"{place},{factor * float(value):.5f}" for place, _, value in rows[1:]]
    (folder / "mistaken.csv").write_text("\n".join([head, *body]) + "\n")
    given, robot_in_cell, states = readings(folder, "mistaken.csv")
    with pytest.raises(MeasurementError, match=r"times what the model predicts") as error:
        fit(Prior.of(robot_in_cell.robot, 0.1), given, robot_in_cell, states())
    assert advice in str(error.value)


def test_exchanged_sides_of_all_features_are_named(folder, cut):
    rows = [line.rpartition(",") for line in (folder / "probed.csv").read_text().splitlines()]
    value = {row[0].partition(",")[0]: row[2] for row in rows}
    other = {"left": "right", "right": "left"}
    lines = []
    for place, _, stated in rows:
        feature, _, surface = place.partition(",")[0].partition(".")
        lines.append(f"{place},{value.get(f'{feature}.{other.get(surface, surface)}', stated)}")
    (folder / "sides.csv").write_text("\n".join(lines) + "\n")
    given, robot_in_cell, states = readings(folder, "sides.csv")
    with pytest.raises(MeasurementError, match="They fit if left and right of all features are exchanged"):
        fit(Prior.of(robot_in_cell.robot, 0.1), given, robot_in_cell, states())


def test_true_values_are_where_the_covariance_says(cut, fitted):
    """Compliances and scale of the simulated robot: 99.9 % are nearer than this to the values found (χ² of 8)."""
    _, scale = cut
    prior, found, _ = fitted
    true = prior.values.copy()
    for k, parameter in enumerate(prior.parameters):
        if isinstance(parameter, robot.JointCompliance):
            true[k] = TRUE[parameter.joint]
    off = np.append(true - prior.values - found.z, scale - found.scale)
    assert off @ np.linalg.solve(found.covariance, off) < 26.1
    product = np.array([found.covariance[0, 0], found.covariance[0, -1], found.covariance[-1, -1]])
    assert product[1] < -0.5 * np.sqrt(product[0] * product[2])


@pytest.mark.parametrize(("factor", "holds"), [(1.0, True), (1.3, False)])
def test_a_change_of_all_compliances_is_seen_and_none_where_the_robot_is_the_same(folder, found, cut, factor, holds):
    """Forces cannot be told from compliances by one part; by the next one, under the same forces, they can."""
    rng = np.random.default_rng(SEED + 1)
    arm = trial.truth(np.random.default_rng(SEED), drift=dict.fromkeys(trial.JOINTS, factor))
    cutter = trial.machine(arm, cut[1], 5.002)
    text = cutter.probed((folder / "testpart.nc").read_text(), (folder / "probing.csv").read_text(), rng)
    (folder / "again.csv").write_text(text)
    done = run("identify", "part", folder / "again.csv", "--cell", found, "--process", _with(folder),
               "--program", folder / "testpart.nc", "--compare", code=0 if holds else 3)  # fmt: skip
    assert done.output.startswith("the model holds" if holds else "THE MODEL DOES NOT HOLD")
    assert ("deflects otherwise" in done.output) == (not holds)
    assert "not identified with these forces" not in done.output


def test_compare_says_that_it_is_blind_to_a_common_factor_if_the_forces_are_of_another_process(folder, cut):
    done = identify(folder, "--compare")
    assert done.output.startswith("the model holds")
    assert "was not identified with these forces" in done.output
    given = ("--cell", CELL_FILE, "--process", folder / "testpart.process.toml", "--program", folder / "testpart.nc")
    done = run("identify", "validate", "kuka_kr270", folder / "probed.csv", *given)
    assert done.output.startswith("the model holds")


def test_forces_far_from_their_prior_are_a_warning(fitted):
    _, found, left_out = fitted
    for scale, doubt in ((1.29, False), (1.31, True), (0.69, True), (0.71, False)):
        data = summary(msgspec.structs.replace(found, scale=scale), left_out)
        assert any("more than three standard deviations" in text for text in data.warnings) == doubt
        assert not data.verdict.refused
    assert summary(msgspec.structs.replace(found, scale=1.41), left_out).verdict.refused


def test_a_factor_is_never_below_zero(folder, cut):
    """A prior that is sure and far too large: the change is a factor of the compliance, and more than none."""
    given, robot_in_cell, states = readings(folder, "probed.csv")
    prior = Prior.of(robot_in_cell.robot, 0.1)
    less = np.full(len(prior.parameters) + 1, 0.01)
    sure = msgspec.structs.replace(prior, covariance=prior.covariance * np.outer(less, less))
    found, _ = fit(sure.widen(), given, robot_in_cell, states())
    off = msgspec.structs.replace(found, prior_error=-20.0 * found.prior_prediction)
    compared = agreement(off, sure)
    assert not compared.holds
    assert all(change.factor >= 0.02 for change in compared.drifted)
    assert min(change.factor for change in compared.drifted) == 0.02


def test_derivatives_are_those_of_finite_differences(folder, cut):
    given, robot_in_cell, states = readings(folder, "probed.csv")
    prior = Prior.of(robot_in_cell.robot, 0.1)
    at = states()(robot_in_cell.robot, 1.0)
    sigma = prior.sigma[:-1]
    z = 0.2 * sigma
    slopes = linearise(prior, given, at, robot_in_cell, z=z, scale=1.1).slopes
    for k in range(len(z) + 1):
        step = np.append(sigma, 1.0) * 0.02 * (np.arange(len(z) + 1) == k)
        more, less = (
            linearise(prior, given, at, robot_in_cell, z=z + sign * step[:-1], scale=1.1 + sign * step[-1]).value
            for sign in (1, -1)
        )
        expected = (more - less) / (2.0 * step[k])
        solved = 1e-9 / step[k]  # what the equilibrium is known to
        np.testing.assert_allclose(slopes[:, k], expected, atol=2e-3 * np.abs(expected).max() + solved)


def test_the_chosen_part_is_better_than_parts_at_random(folder):
    (found, prior, robot_in_cell, tests, *_), chosen = CHOICE
    rng = np.random.default_rng(1)
    others = [trial.at_random(found, chosen.seconds, rng) for _ in range(60)]
    assert chosen.after < min(design.evaluate(found, prior, robot_in_cell, tests, other).after for other in others)


def test_what_the_tool_does_not_make_is_refused(folder):
    rows = [row + "0.0" if k else row for k, row in enumerate((folder / "probing.csv").read_text().splitlines())]
    row = next(k for k, line in enumerate(rows) if line.startswith("F01.left"))
    fields = rows[row].split(",")
    rows[row] = ",".join([*fields[:3], f"{float(fields[3]) + 1.0:.4f}", *fields[4:]])
    (folder / "moved.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(MeasurementError, match="the tool makes no surface") as caught:
        readings(folder, "moved.csv")
    assert caught.value.line == row + 1
    with pytest.raises(MeasurementError, match="0 of"):
        probing.read(folder / "probing.csv")


def test_only_flat_end_mills_are_taken(tmp_path):
    text = trial.process_text(BLOCK, 0.5).replace("flutes = 3", 'flutes = 3\nshape = "ball"')
    (tmp_path / "process.toml").write_text(text)
    given = ("--cell", CELL_FILE, "--process", tmp_path / "process.toml", "-o", tmp_path / "out")
    assert "flat end mill" in run("testpart", *given, code=1).output


def test_points_of_the_result_are_deviations_with_the_place_of_the_datum(folder, fitted):
    """Measured as in the file of readings; predictions leave what the fit leaves."""
    _, found, left_out = fitted
    rows = list(csv.DictReader((folder / "probed.csv").read_text().splitlines()))
    measured = {row["feature"]: float(row["deviation_mm"]) for row in rows if row["deviation_mm"]}
    points = {point.feature: point for point in summary(found, left_out).points}
    assert set(points) == set(found.readings.probed.name)
    residuals = 1e3 * (found.prediction - found.readings.probed.deviation)
    for name, residual in zip(found.readings.probed.name, residuals, strict=True):
        assert points[name].measured_mm == pytest.approx(measured[name], abs=2e-5)
        assert points[name].after_mm - points[name].measured_mm == pytest.approx(residual, abs=3e-5)


@pytest.mark.parametrize("held", [(), (1,), (0, 3)])
def test_parameters_that_are_held_keep_their_value_and_spread(folder, cut, held):
    """Of all linear estimates that leave them alone, the covariance is the least: by a search over gains."""
    given, robot_in_cell, states = readings(folder, "probed.csv")
    prior = Prior.of(robot_in_cell.robot, 0.1)
    local = linearise(
        prior, given, states()(robot_in_cell.robot, 1.0), robot_in_cell, z=np.zeros(len(prior.parameters)), scale=1.0
    )
    count = local.slopes.shape[1]
    free = ~np.isin(np.arange(count), held)
    whole = np.diag(prior.sigma**2)
    covariance = posterior_covariance(given, local, 0.02, whole, free)
    np.testing.assert_allclose(covariance[~free][:, ~free], whole[~free][:, ~free])
    noise = noise_covariance(given, local, 0.02)

    def with_gain(gain):
        left = np.eye(count) - gain @ local.slopes
        return left @ whole @ left.T + gain @ noise @ gain.T

    spread = local.slopes @ whole
    best = np.where(free[:, None], spread.T @ np.linalg.inv(spread @ local.slopes.T + noise), 0.0)
    np.testing.assert_allclose(covariance, with_gain(best), rtol=1e-6, atol=1e-9 * np.abs(whole).max())
    rng = np.random.default_rng(3)
    for _ in range(5):
        other = best * (1.0 + 0.05 * rng.standard_normal(best.shape))
        assert (np.diag(with_gain(other)) >= np.diag(covariance) * (1.0 - 1e-9)).all()


@pytest.mark.parametrize(("correlation", "is_told"), [(-0.55, False), (-0.65, True), (0.9, False)])
def test_parameters_tied_to_the_forces_are_named_by_their_correlation(fitted, correlation, is_told):
    """Whatever their units and spreads are: the first free parameter, all others independent."""
    _, found, left_out = fitted
    first = int(np.flatnonzero(found.free[:-1])[0])
    sigma = np.sqrt(np.diag(found.covariance))
    covariance = np.diag(sigma**2)
    covariance[first, -1] = covariance[-1, first] = correlation * sigma[first] * sigma[-1]
    warnings = summary(msgspec.structs.replace(found, covariance=covariance), left_out).warnings
    tied = [warning for warning in warnings if "known by their product only" in warning]
    name = found.prior.parameters[first].name
    assert [warning.startswith(f"{name} and the scale") for warning in tied] == [True] * is_told
