"""How many readings are needed, what their scatter shows, and the summary that states it."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import robot
from postproc.errors import MeasurementError
from postproc.identification import calibration, joint_springs, procedure, record
from postproc.identification.model_folder import read_prior, summary
from samples.paper_study import harness, simulator
from tests.identification.test_joint_springs import POINTS, forces, placed, readings


def scattered(scatter, sigma, repeats=31, points=1):
    """Readings of one state, scattered by exactly so much about their mean, of stated noise [m]."""
    data = readings(forces(1), count=1, points=POINTS[:points])
    rows = [(0, r, p) for r in range(repeats) for p in range(points)]
    state, repeat, point = np.array(rows).T
    offset = np.random.default_rng(0).normal(size=(repeats, points, 3))
    offset -= offset.mean(axis=0)
    dof = 3 * points * (repeats - 1)
    offset *= scatter / np.sqrt(np.sum(offset**2) / dof)
    return replace(
        data, state=state, repeat=1.0 + repeat, point=point, position=offset.reshape(-1, 3),
        line=2 + np.arange(len(rows)), used=np.ones(len(rows), dtype=bool), sigma=sigma,
    ), dof  # fmt: skip


@pytest.mark.parametrize(
    ("standard_errors", "replaced", "noted"),
    [(3.9, False, False), (4.1, True, True), (0.0, False, False)],
)
def test_scatter_of_repeats_replaces_the_stated_noise_from_four_standard_errors_on(standard_errors, replaced, noted):
    """Of n degrees of freedom a standard deviation is known to 1/√(2n)."""
    for repeats in (31, 201):
        dof = 3 * (repeats - 1)
        data, own = scattered(2e-5 * (1.0 + standard_errors / np.sqrt(2.0 * dof)), 2e-5, repeats)
        assert own == dof
        used, notes = procedure._readings_with_checked_noise(data)
        assert len(notes) == noted
        if replaced:
            assert used.sigma == pytest.approx(2e-5 * (1.0 + standard_errors / np.sqrt(2.0 * dof)))
            assert notes[0] == f"sigma_mm = 0.02 is stated; the repeats scatter by {used.sigma * 1e3:.3f} mm: used"
        else:
            assert used.sigma == 2e-5


@pytest.mark.parametrize(("standard_errors", "noted"), [(3.9, False), (4.1, True)])
def test_scatter_clearly_below_the_stated_noise_is_noted_and_not_used(standard_errors, noted):
    """A fifth below it is usual, since repeats share what the set-up adds."""
    data, dof = scattered(1.0, 2e-5, 101)
    data = replace(data, position=data.position * 2e-5 * (0.8 - standard_errors / np.sqrt(2.0 * dof)))
    used, notes = procedure._readings_with_checked_noise(data)
    assert used.sigma == 2e-5
    assert len(notes) == noted
    assert not noted or "the stated noise is kept" in notes[0]


@pytest.mark.parametrize(("repeats", "judged"), [(10, False), (11, True)])
def test_scatter_is_judged_from_thirty_degrees_of_freedom_on(repeats, judged):
    data, _ = scattered(1e-4, 2e-5, repeats)
    assert bool(procedure._readings_with_checked_noise(data)[1]) == judged


@pytest.fixture(scope="module")
def unloaded(tmp_path_factory):
    """Readings of ten poses of a robot with displaced joints; the prior's model file."""
    rng = np.random.default_rng(2)
    true = simulator.TrueRobot(
        simulator.Gear("linear", np.full(6, 1e12), np.ones(6)), offsets=np.r_[0, rng.normal(0, 5e-4, 4), 0]
    )
    q, f = simulator.plan(rng, 10)
    _, raw = simulator.measure(true, q, f, rng, 0.05e-3)
    folder = simulator.write(tmp_path_factory.mktemp("unloaded"), q, f, raw, 0.05e-3)
    return harness.load(folder), read_prior(robot.find("kuka_kr270"), None, "")


@pytest.mark.parametrize(
    ("configurations", "refused", "with_gears"),
    [(4, True, False), (5, False, False), (7, False, False), (8, False, True)],
)
def test_a_calibration_needs_ten_coordinates_more_than_unknowns_and_gears_need_their_own(
    unloaded, configurations, refused, with_gears
):
    """Base 6, three points 9, joints 18; gears 24. Each configuration has 9 coordinates."""
    data, content = unloaded
    data = data.take_configurations(np.arange(configurations))
    if refused:
        with pytest.raises(MeasurementError, match="36 coordinates without load for 33 unknowns of base, points and"):
            calibration.identify_geometry(content, harness.PRIOR.nominal, "x", data)
        return
    found = calibration.identify_geometry(content, harness.PRIOR.nominal, "x", data)
    assert any(name.endswith(", gears") for name in found.rms) == with_gears
    assert {"nominal geometry", "nominal geometry with sag", "calibrated geometry"} <= set(found.rms)


def test_the_errors_of_a_geometry_are_without_the_noise_of_their_readings(unloaded):
    """Mean squares of noise and error add; a normal error in space is below 1.614 of its RMS in 95 %."""
    data, _ = unloaded
    rng = np.random.default_rng(1)
    hidden = data.drop([int(np.flatnonzero((data.state == 0) & (data.point == 1) & (data.repeat == 1.0))[0])])
    repeats = len(np.unique(data.repeat))
    noise = np.full(10, 3.0 * data.sigma**2 / repeats)
    noise[0] = 3.0 * data.sigma**2 * np.mean([1 / repeats, 1 / (repeats - 1), 1 / repeats])
    length = np.linalg.norm(rng.normal(size=(100_000, 3)), axis=1)
    factor = np.quantile(length, 0.95) / np.sqrt(3.0)
    found = calibration._error_95(noise + 4e-8, hidden)
    assert found == pytest.approx(factor * 2e-4, rel=0.01)
    squares = 4e-8 + np.tile([1e-8, -1e-8], 5)  # a standard error above the mean, since few show it
    error = np.std(squares, ddof=1) / np.sqrt(10)
    assert calibration._error_95(noise + squares, hidden) == pytest.approx(factor * np.sqrt(4e-8 + error), rel=0.01)
    assert calibration._error_95(0.5 * noise, data) == 0.0


def test_a_point_that_was_not_read_has_no_residual_in_the_serial_method():
    data = readings(forces(10, 500.0))
    hidden = replace(data, used=~((data.state == 3) & (data.point == 1)))
    fit = joint_springs.fit_serial(harness.PRIOR, hidden, placed(hidden))
    assert (fit.residual[1, 1] == 0.0).all()
    assert np.count_nonzero(np.abs(fit.residual).max(axis=2)) == 39


def identified(**parts):
    base = record.IdentificationRecord(
        method="none", robot="x", sigma_mm=0.03, base={}, points={}, unloaded_rms_mm=0.0, outliers=[], warnings=[]
    )
    return replace(base, **parts)


def test_the_summary_has_a_line_for_each_part_and_none_for_those_that_are_missing():
    about = record.ABOUT_THE_PRIOR
    parameters = {
        "k1": record.Parameter(0.31234567, 0.0123, "urad/(N·m)", True, True, 0.3),
        "k2": record.Parameter(0.2, 0.25, "urad/(N·m)", True, False, 0.3),
        "k3": record.Parameter(0.5, None, "urad/(N·m)", False, prior=0.5, source="prior"),
        "A2.mass": record.Parameter(301.0, 9.0, "kg", True, True, 300.0, about),
        "A2.RX": record.Parameter(0.01, 0.02, "urad/(N·m)", True, False, None),
        "A2.RY": record.Parameter(0.01, 0.02, "urad/(N·m)", True, False, None),
    }
    data = identified(
        verdict=record.Verdict(False, "the model may be used"),
        parameters=parameters,
        structure=record.Structure("chosen: 100% joint springs", []),
        discrepancy=[record.CrossValidation(500.0, 0.02, 0.01, 0.005, 0.04)],
        workspace_line="bound over deflection: 0.1",
        torque_Nm=[100.4, 200.0, 300.0, 4.0, 5.0, 6.0],
        assumptions=["all loads are right"],
    )
    lines = summary(data).splitlines()
    assert lines[0] == "the model may be used"
    assert lines[1].split() == ["k1", "=", "0.31235", "±", "0.0123", "urad/(N·m)"]
    assert lines[2].endswith("± 0.25 urad/(N·m)   (not determined: the interval is larger than the value)")
    assert lines[3].strip() == "k3 = 0.5 urad/(N·m)   (prior: not observable)"
    assert lines[4].endswith("kg   (about the prior's 300)")
    assert lines[5].startswith("2 more parameters of links and gears are not determined one by one")
    assert lines[6].endswith(": the intervals are of that sum")
    assert lines[7] == "chosen: 100% joint springs"
    assert "0.04" in lines[8]
    assert lines[9] == "bound over deflection: 0.1"
    assert lines[10].startswith("the loads put up to 100, 200, 300, 4, 5, 6 N·m on A1 … A6")
    assert lines[11] == "assumed: all loads are right"
    assert len(lines) == 12
    assert summary(identified()) == ""
    assert "more parameters" not in summary(identified(parameters={"k1": parameters["k1"]}))
    geometry = record.Geometry(
        {
            "A2.X": record.Parameter(0.12345, 0.02, "mm", True, True),
            "A3.Y": record.Parameter(0.01, 0.02, "mm", True, False),
            "A4.Z": record.Parameter(0.0, 2.0, "mm", False, False),
        },
        True, "calibrated geometry",
        {"nominal geometry": record.Variant(0.5, 0.6), "calibrated geometry": record.Variant(0.1, 0.2)}, 0.3,
    )  # fmt: skip
    lines = summary(identified(geometry=geometry)).splitlines()
    assert [line.strip() for line in lines] == [
        "A2.X =   0.1235 ± 0.02 mm" if "0.1235" in lines[0] else "A2.X =   0.1234 ± 0.02 mm",
        "A3.Y =   0.0100 ± 0.02 mm   (not determined: the interval is larger than the value)",
        "A4.Z =   0.0000 ± 2 mm   (not narrowed by the readings)",
        "nominal geometry: 0.500 mm RMS, 0.600 mm on configurations left out",
        "calibrated geometry: 0.100 mm RMS, 0.200 mm on configurations left out  <- chosen",
        "95 % of the errors of the geometry are below 0.300 mm; that is in the bound",
    ]
