"""A prior whose geometry is a weightless robot's: readings without load hold the sag, which its springs predict."""

import msgspec
import numpy as np
import pytest

from postproc import elastostatics, kinematics, robot
from postproc.elastostatics import balance
from postproc.elastostatics.equilibrium import deflection_at_target
from postproc.identification import identify_folder, model_folder
from postproc.identification.measurement_model import Structure, predict
from postproc.robot.model_file import BacklashEntry, PayloadEntry
from postproc.robot.parameters import parameter_of_name
from samples.paper_study import harness, simulator


def prior(folder, reference="rigid"):
    """The KR 270-2 with another gravity reference."""
    source = robot.find("kuka_kr270")
    folder.mkdir(parents=True)
    (folder / "robot.urdf").write_bytes((source / "robot.urdf").read_bytes())
    text = (source / "model.toml").read_text(encoding="utf-8")
    old = 'reference = "calibrated"'
    assert old in text
    (folder / "model.toml").write_text(text.replace(old, f'reference = "{reference}"'), encoding="utf-8")
    return folder


def weightless(rng):
    k = simulator.PAPER_K * np.exp(rng.uniform(-0.35, 0.35, 6))
    gear = simulator.Gear("linear", 1 / k, np.ones(6))
    return simulator.TrueRobot(gear, masses=simulator.MASSES.copy(), comp=(1.2e5, 0.458, 0.18472, 0.68593, 0.1233))


def test_sag_and_load_are_predicted_to_a_hundredth_of_a_millimetre(tmp_path):
    rng = np.random.default_rng(5)
    true = weightless(rng)
    q, f = simulator.plan(rng, 30, tilt=50.0)
    _, raw = simulator.measure(true, q, f, rng)
    simulator.write(tmp_path, q, f, raw, robot=str(prior(tmp_path / "prior")))
    done = identify_folder(tmp_path / "measurements.csv", tmp_path / "experiment.toml", tmp_path / "model")
    names, found, half = zip(
        *((n, e.value, e.ci95) for n, e in done.data.parameters.items() if n in ("k1", "k2", "k3", "k4", "k5")),
        strict=True,
    )
    expected = [1e6 / true.gear.k[int(name[1]) - 1] for name in names]
    assert np.all(np.abs(np.subtract(found, expected)) < np.maximum(3 * np.array(half), 0.01 * np.array(expected)))
    assert done.result.choice is None
    assert done.result.fit.rms < 1.1 * 0.03e-3 * np.sqrt(2)  # noise of a difference of two means of three
    assert done.result.placement.rms < 1.1 * 0.03e-3  # noise of a mean of three: the sag is explained
    model = robot.load(tmp_path / "model")
    assert not model.subtract_reference
    job, force = simulator.milling_job(rng)
    for load in (0.0 * force, force):
        pose = elastostatics.deflect(model, job, harness.TOOL, np.c_[load, 0 * load]).pose[:, :3, 3]
        tip = true.solve(job, load, point=harness.TOOL[:3, 3]) @ harness.TOOL
        assert np.linalg.norm(pose - tip[:, :3, 3], axis=1).max() < 0.012e-3
    sag = tip[:, :3, 3] - true.flange(true.frames(true.commanded(job)))[:, :3] @ harness.TOOL[:, 3]
    assert np.linalg.norm(sag, axis=1).min() > 0.5e-3


@pytest.mark.parametrize("reference", ["calibrated", "rigid"])
@pytest.mark.parametrize("in_gears", [False, True])
def test_derivatives_of_the_prediction_are_those_by_finite_differences(tmp_path, reference, in_gears):
    rng = np.random.default_rng(8)
    q, f = simulator.plan(rng, 6)
    raw = np.zeros((6, 2, 1, 3, 3))
    data = harness.load(simulator.write(tmp_path, q, f, raw + rng.normal(size=raw.shape)))
    model = robot.load(prior(tmp_path / "prior", reference))
    names = ("k1", "k2", "k3", "k5", "k2@3000", "k5@90.5", "A2.RX", "A3.Y", "A6.end_RZ", "K_c", "s_0")
    structure = Structure(tuple(parameter_of_name(name) for name in names), model, carries_weight=in_gears)
    values = np.array([0.6, 0.2, 0.4, 3.0, 0.1, 0.4, 0.1, 0.02, 0.1, 2e11, 1e11]) * 1e-6
    compare_with_differences(structure, values, data, harness.placed(model, data))


@pytest.mark.parametrize("reference", ["calibrated", "rigid"])
@pytest.mark.parametrize("in_gears", [False, True])
@pytest.mark.parametrize("carried", [0.0, 120.0])
def test_derivatives_by_masses_and_size_of_the_compensator_are_those_by_finite_differences(
    tmp_path, reference, in_gears, carried
):
    rng = np.random.default_rng(9)
    q, f = simulator.plan(rng, 6)
    raw = np.zeros((6, 2, 1, 3, 3))
    data = harness.load(simulator.write(tmp_path, q, f, raw + rng.normal(size=raw.shape)))
    content = model_folder.read_prior(prior(tmp_path / "prior", reference), None, "")
    if carried:
        content = msgspec.structs.replace(content, payload=PayloadEntry(source="", mass_kg=carried, X_mm=100.0))
    model = robot.assemble("carries", content, harness.PRIOR.nominal)
    names = ("k2", "k3", "k2@3000", "k3@1500", "A4.lost_motion@900", "A3.Y", "A3.RX", "A2.mass", "A3.mass", "A6.mass")
    structure = Structure(
        (*(parameter_of_name(name) for name in names), robot.CompensatorSize()), model, carries_weight=in_gears
    )
    values = np.array([0.2, 0.3, 0.1, 0.1, 100.0, 0.02, 0.1, 200e6, 210e6, 15e6, 1.3e11]) * 1e-6
    compare_with_differences(structure, values, data, harness.placed(model, data), share=5e-3, within=1e-4)


def compare_with_differences(structure, values, data, placement, share=1e-3, within=1e-5):
    _, slopes = predict(structure, values, data, placement)
    for index, value in enumerate(values):
        step = np.zeros(len(values))
        step[index] = share * value
        plus, minus = (predict(structure, values + sign * step, data, placement)[0] for sign in (1, -1))
        slope = (plus - minus) / (2 * step[index])
        name = structure.parameters[index].name
        np.testing.assert_allclose(slopes[..., index], slope, atol=within * np.abs(slope).max(), err_msg=name)


@pytest.mark.parametrize("carried", [0.0, 120.0])
def test_lost_motion_is_turned_over_by_the_load_alone_whatever_the_geometry_describes(tmp_path, carried):
    """Springs that were identified with the state at rest in the geometry, and a geometry that is then weightless."""
    rng = np.random.default_rng(12)
    q, force = simulator.milling_job(rng)
    wrench, moved = np.c_[force, 0 * force], {}
    for reference in ("calibrated", "rigid"):
        content = model_folder.read_prior(prior(tmp_path / reference, reference), None, "")
        loose = BacklashEntry(angle_urad=50.0, torque_Nm=60.0)
        joints = {name: msgspec.structs.replace(spring, lost_motion=loose) for name, spring in content.joints.items()}
        content = msgspec.structs.replace(content, joints=joints)
        if carried:
            content = msgspec.structs.replace(content, payload=PayloadEntry(source="", mass_kg=carried, X_mm=100.0))
        model = robot.assemble("loose", content, harness.PRIOR.nominal)
        loaded, rest = (elastostatics.deflect(model, q, harness.TOOL, load * wrench).pose for load in (1.0, 0.0))
        moved[reference] = loaded[:, :3, 3] - rest[:, :3, 3]
        # the inverse problem gives way alike
        found = elastostatics.deflect(model, q, harness.TOOL, wrench)
        x = (elastostatics.coordinates(model, q) + found.theta).T
        state = kinematics.posture(model.loaded, x, kinematics.components(harness.TOOL), weigh=model.has_weight)
        load = np.einsum("ikn,in->kn", state.jacobian(), wrench.T)
        there = deflection_at_target(model, x, load, balance.static_torque(model, x, state))
        np.testing.assert_allclose(there, found.theta.T, atol=1e-8)
    size = np.linalg.norm(moved["calibrated"], axis=1)
    assert np.linalg.norm(moved["rigid"] - moved["calibrated"], axis=1).max() < 0.02 * size.max()
