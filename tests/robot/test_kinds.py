"""Kinds of parameters: what each is by name, unit and size, its deflection as an integral, and its lines in files."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from scipy.integrate import quad

from postproc import robot
from postproc.robot import parameters
from postproc.robot.model_file import ModelFile, PoseWaveEntry

# Name, heading, place, unit in files and usual size there, and whether it is a candidate that a fit may drop.
WORDS = [
    (robot.JointCompliance("A3"), "k3", "k3", "A3", "urad/(N·m)", 1.0, False),
    (robot.FadingPart("A3", 90.0), "k3@90", "k3, fades beyond 90 N·m", "A3", "urad/(N·m)", 1.0, True),
    (robot.Knee("A3", 90.0), "k3^90", "k3, up to 90 N·m", "A3", "urad/(N·m)", 1.0, True),
    (robot.Backlash("A3", 2.5), "A3.backlash@2.5", "backlash of A3", "A3", "urad", 20.0, True),
    (robot.LostMotion("A3", 2.5), "A3.lost_motion@2.5", "lost motion of A3", "A3", "urad", 20.0, True),
    (robot.GearCoupling("A4", "A6"), "k46", "coupling of A4 and A6", "A4", "urad/(N·m)", 1.0, False),
    (
        robot.PoseWave("A3", (0, 1, -2, 0, 0, 0), "sin"), "k3.sin(A2-2A3)", "k3 over the pose, sin(A2-2A3)", "A3",
        "urad/(N·m)", 1.0, False,
    ),
    (robot.LinkSpring("base", "Z"), "base.Z", "base.Z", "the base", "um/N", 0.01, True),
    (robot.LinkSpring("A2", "RX"), "A2.RX", "A2.RX", "the link of A2", "urad/(N·m)", 1.0, True),
    (robot.LinkSpring("A2", "end_RY"), "A2.end_RY", "A2.end_RY", "the link of A2", "urad/(N·m)", 1.0, True),
    (robot.CompensatorStiffness(), "K_c", "K_c", "the compensator at A2", "N/m", 1e6, False),
    (robot.CompensatorPreload(), "s_0", "s_0", "the compensator at A2", "mm", 1e9, False),
    (robot.LinkMass("A3"), "A3.mass", "mass of the link of A3", "A3", "kg", 100.0, False),
]  # fmt: skip


@pytest.mark.parametrize(("parameter", "name", "title", "place", "unit", "usual", "sparse"), WORDS, ids=lambda v: "")
def test_words_and_usual_size_of_each_kind(parameter, name, title, place, unit, usual, sparse):
    assert (parameter.name, parameter.title, parameter.place, parameter.unit) == (name, title, place, unit)
    assert parameter.usual * parameter.per_si == pytest.approx(usual)
    assert parameter.sparse is sparse
    assert parameter.symbol == ("K_c*s_0" if name == "s_0" else name)


def test_signs_and_torques_of_each_kind_of_spring():
    """Couplings and waves may be negative; lost motion ignores the torque at rest."""
    springs = [parameter for parameter, *_ in WORDS if isinstance(parameter, robot.Spring)]
    kinds = {
        flag: {spring.name for spring in springs if getattr(spring, flag)}
        for flag in ("signed", "with_rest_torque", "is_compliance", "linear")
    }
    names = {spring.name for spring in springs}
    waves = {"k46", "k3.sin(A2-2A3)"}
    links = {"base.Z", "A2.RX", "A2.end_RY"}
    assert kinds == {
        "signed": waves,
        "with_rest_torque": names - {"A3.lost_motion@2.5"},
        "is_compliance": {"k3", "k3@90", "k3^90", *links},
        "linear": {"k3", *links},
    }


# Slope of the deflection by the torque t on the gear, T the torque of the part: docs/reference, [joints].
SLOPES = [
    (robot.JointCompliance("A1"), lambda t, T: 1.0),
    (robot.FadingPart("A1", 70.0), lambda t, T: (1.0 + (t / T) ** 2) ** -0.5),
    (robot.Knee("A1", 70.0), lambda t, T: (1.0 + (t / T) ** 4) ** -1.25),
    (robot.Backlash("A1", 70.0), lambda t, T: np.cosh(t / T) ** -2 / T),
]


@pytest.mark.parametrize(("spring", "slope"), SLOPES, ids=lambda v: type(v).__name__)
@pytest.mark.parametrize("rest", [0.0, 45.0, -130.0])
@pytest.mark.parametrize("torque", [-210.0, -20.0, 33.0, 300.0])
def test_deflection_is_the_integral_of_the_slope_from_the_torque_at_rest(spring, slope, rest, torque):
    deflection, by_torque = spring.effect(np.array([torque]), np.array([rest]))
    expected = quad(slope, rest, rest + torque, args=(70.0,), epsabs=1e-13, epsrel=1e-13)[0]
    assert deflection[0] == pytest.approx(expected, rel=1e-11)
    assert by_torque[0] == pytest.approx(slope(rest + torque, 70.0), rel=1e-12)


def test_lost_motion_begins_at_rest_whatever_the_torque_there():
    deflection, slope = robot.LostMotion("A1", 70.0).effect(np.array([-30.0, 90.0]), np.array([500.0, -40.0]))
    for k, torque in enumerate((-30.0, 90.0)):
        assert deflection[k] == pytest.approx(quad(lambda t: np.cosh(t / 70.0) ** -2 / 70.0, 0.0, torque)[0], rel=1e-11)
        assert slope[k] == pytest.approx(np.cosh(torque / 70.0) ** -2 / 70.0, rel=1e-12)


def test_a_wave_is_a_cosine_or_sine_of_the_sum_of_its_turns():
    q = np.random.default_rng(1).uniform(-3, 3, (6, 5))
    for wave, function in (("cos", np.cos), ("sin", np.sin)):
        expected = [function(2.0 * q[1, n] - q[2, n] + 3.0 * q[5, n]) for n in range(5)]
        np.testing.assert_allclose(robot.PoseWave("A2", (0, 2, -1, 0, 0, 3), wave).factor(q), expected, atol=1e-14)


@pytest.mark.parametrize(
    ("axis", "direction", "slides", "at_end"),
    [
        ("X", (1, 0, 0), True, False), ("Y", (0, 1, 0), True, False), ("Z", (0, 0, 1), True, False),
        ("RX", (1, 0, 0), False, False), ("RY", (0, 1, 0), False, False), ("RZ", (0, 0, 1), False, False),
        ("end_RX", (1, 0, 0), False, True), ("end_RY", (0, 1, 0), False, True), ("end_RZ", (0, 0, 1), False, True),
    ],
)  # fmt: skip
def test_direction_and_end_of_each_spring_of_a_link(axis, direction, slides, at_end):
    spring = robot.LinkSpring("A4", axis)
    assert (tuple(spring.direction), spring.slides, spring.at_end) == (direction, slides, at_end)


def test_tables_of_all_kinds_are_read_back_as_they_were_written():
    """Two joints with two waves of different turns, a negative coupling, and two parts of one gear."""
    entries = {
        "k1": 0.9, "k2": 0.3, "k3": 0.4, "k4": 2.0, "k5": 3.0, "k6": 2.5, "k1@500": 0.1, "k1@90": 0.2, "k2^300": 0.05,
        "A3.backlash@3": 12.0, "A4.lost_motion@5": 7.0, "k45": -0.4, "k46": 0.3, "k3.cos(A2-A3)": 0.06,
        "k3.sin(A2-A3)": -0.02, "k3.sin(2A2)": 0.03,
        "k3.cos(2A2)": 0.05, "k3.cos(3A2)": 0.04, "k2.cos(A1)": -0.01, "base.RZ": 0.2,
        "A2.X": 0.01, "A2.end_RY": 0.3, "K_c": 1.5e5, "s_0": 440.0, "A2.mass": 150.0, "A6.mass": 9.0,
    }  # fmt: skip
    tables = {"name": "all", "joints": {}, "links": {}, "masses": {"source": "test"}}
    tables["compensator"] = {"L_mm": 190.0, "a_x_mm": 600.0, "a_y_mm": 100.0, "source": "test"}
    for name, value in entries.items():
        parameters.parameter_of_name(name).write(tables, value, 0.125, "reading")
    assert tables["joints"]["A1"]["ci95"] == 0.125
    assert {tables[table]["A2"]["source"] for table in ("joints", "links")} == {"reading"}
    assert tables["compensator"]["source"] == "reading"
    assert tables["compensator"]["assumed"] is False
    content = msgspec.convert(tables, ModelFile)
    assert content.joints["A3"].over_pose == [
        PoseWaveEntry((0, 1, -1, 0, 0, 0), 0.06, -0.02), PoseWaveEntry((0, 2, 0, 0, 0, 0), 0.05, 0.03),
        PoseWaveEntry((0, 3, 0, 0, 0, 0), 0.04, None),
    ]  # fmt: skip
    stated = parameters.stated_values(content)
    in_file = {parameter.name: parameter.file_value(stated)[0] for parameter in stated}
    assert in_file == pytest.approx(entries, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "table", "key"),
    [
        ("K_c", "compensator", "stiffness_N_per_m"),
        ("s_0", "compensator", "free_length_mm"),
        ("A3.mass", "masses", "A3_kg"),
    ],
)
def test_a_value_that_a_fit_leaves_below_zero_is_written_as_zero(name, table, key):
    tables = {table: {}}
    parameters.parameter_of_name(name).write(tables, -3.0, 0.0, "test")
    assert tables[table][key] == 0.0


def test_a_compensator_without_a_spring_has_no_free_length():
    for stiffness in (0.0, -1e-9):
        values = {robot.CompensatorStiffness(): stiffness, robot.CompensatorPreload(): 2e4}
        assert robot.CompensatorPreload().file_value(values) == (0.0, {})


@pytest.mark.parametrize("name", ["k4", "k4@90", "k45", "A4.backlash@3", "K_c", "A2.X", "A2.mass"])
def test_values_in_files_are_si_values_in_units_of_the_workshop(name):
    parameter = parameters.parameter_of_name(name)
    factor = {"K_c": 1.0, "A2.mass": 1.0}.get(name, 1e6)
    assert parameter.file_value({parameter: 3e-6}) == (pytest.approx(3e-6 * factor), {parameter: factor})


def test_partners_are_the_values_that_a_number_of_the_file_depends_on():
    partners = {parameter.name: [p.name for p in parameter.partners()] for parameter, *_ in WORDS}
    assert {name: names for name, names in partners.items() if names} == {
        "k3@90": ["k3"], "k3^90": ["k3"], "K_c": ["s_0"], "s_0": ["K_c"],
    }  # fmt: skip
    assert robot.CompensatorSize().partners() == ()
