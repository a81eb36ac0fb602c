"""What of the prior is in the model folder: meshes that robot.urdf names, and its compensator."""

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import astuple, replace

from postproc import robot
from postproc.compensator import Compensator
from postproc.elastostatics import sensitivity
from postproc.identification import model_folder, record, uncertainty
from postproc.identification.joint_springs import Levels
from postproc.robot.model_file import CompensatorEntry, Masses
from postproc.robot.parameters import parameter_of_name
from samples.paper_study import harness

MESH = '<visual><geometry><mesh filename="{}"/></geometry></visual>'


def test_meshes_next_to_the_urdf_are_copied_with_it_and_no_others(tmp_path):
    source, prior = robot.find("kuka_kr270"), tmp_path / "prior"
    (prior / "more").mkdir(parents=True)
    urdf = (source / "robot.urdf").read_text(encoding="utf-8")
    names = ("arm.stl", "absent.stl", "more/hand.stl")
    shapes = "".join(MESH.format(name) for name in names)
    at = urdf.index("</link>", urdf.index('<link name="A2"') if '<link name="A2"' in urdf else 0)
    (prior / "robot.urdf").write_text(urdf[:at] + shapes + urdf[at:], encoding="utf-8")
    (prior / "model.toml").write_bytes((source / "model.toml").read_bytes())
    for name in ("arm.stl", "other.stl", "more/hand.stl"):
        (prior / name).write_bytes(b"solid of " + name.encode())
    content = model_folder.read_prior(prior, None, "")
    data = record.IdentificationRecord(
        method="none", robot="x", sigma_mm=0.03, base={}, points={}, unloaded_rms_mm=0.0, outliers=[], warnings=[]
    )
    model_folder.write(tmp_path / "new", content, data, prior)
    written = {path.name for path in (tmp_path / "new").iterdir()}
    assert written == {"model.toml", "robot.urdf", "identification.json", "arm.stl"}
    assert (tmp_path / "new/arm.stl").read_bytes() == b"solid of arm.stl"


LAW = Compensator(stiffness=1.2e5, free_length=0.458, L=0.18472, ax=0.68593, ay=0.1233)
OLD = CompensatorEntry(
    source="drawing", assumed=True, L_mm=180.0, a_x_mm=680.0, a_y_mm=120.0, stiffness_N_per_m=1.2e5,
    free_length_mm=458.0, sigma_percent=7.0, spread_percent=11.0, geometry_source="old",
)  # fmt: skip
FOUND = {"stiffness_N_per_m": 2e5, "free_length_mm": 400.0, "source": "identified", "assumed": False}


@pytest.mark.parametrize(
    ("law", "old", "identified", "expected"),
    [
        (None, None, {}, None),
        (None, OLD, {}, None),  # a serial model has none
        (LAW, None, {}, None),  # geometry by markers alone: without a spring there is no compensator
        (LAW, None, FOUND, (2e5, 400.0, None, 15.0, "markers", "identified")),
        (LAW, OLD, {}, (1.2e5, 458.0, 7.0, 11.0, "markers", "prior, not observable in r.csv: drawing")),
        (LAW, OLD, FOUND, (2e5, 400.0, None, 11.0, "markers", "identified")),
    ],
)
def test_a_compensator_has_the_spring_that_was_identified_or_the_prior_one(law, old, identified, expected):
    result = SimpleNamespace(fit=SimpleNamespace(structure=SimpleNamespace(prior=SimpleNamespace(compensator=law))))
    found = model_folder._compensator_entry(result, SimpleNamespace(compensator=old), identified, "r.csv", "markers")
    if expected is None:
        assert found is None
        return
    assert (found.L_mm, found.a_x_mm, found.a_y_mm) == pytest.approx((184.72, 685.93, 123.3))
    assert expected == (
        found.stiffness_N_per_m, found.free_length_mm, found.sigma_percent, found.spread_percent, found.geometry_source,
        found.source,
    )  # fmt: skip
    without = model_folder._compensator_entry(result, SimpleNamespace(compensator=old), identified, "r.csv", None)
    assert without.geometry_source == ("" if old is None else "old")


def test_most_of_a_bound_is_that_of_the_joint_whose_parameters_together_have_most_of_it():
    """A3 has two of 40 % and 15 %, A2 one of 45 %."""
    names, parts = ("k2", "k3", "k3@700"), np.array([0.45, 0.15, 0.40])
    parameters = tuple(parameter_of_name(name) for name in names)
    model = harness.PRIOR.with_values(dict(zip(parameters, (2e-7, 3e-7, 2e-7), strict=True)))
    q, wrench = np.radians([10.0, -70.0, 110.0, 0.0, 50.0, 0.0]), np.array([300.0, -200.0, 900.0, 0.0, 0.0, 0.0])
    known = replace(model, covariance=robot.Covariance(parameters, np.eye(3)), discrepancy=None)
    slopes = sensitivity(known, q[None], harness.TOOL, wrench[None])[0]
    matrix = np.diag(1e-10 * parts / np.sum(slopes**2, axis=0))
    told = uncertainty._main_cause(
        replace(known, covariance=robot.Covariance(parameters, matrix)), q, harness.TOOL, wrench, 2e-5
    )
    assert told == f"most of it comes from A3, whose readings do not determine {parameters[2].title}"


def test_levels_of_the_second_joint_are_written_in_degrees_and_microradians_with_two_sided_intervals():
    """2 and 3 µrad/N·m, standard deviations 0.1 µrad/N·m and unknown: 1.96 standard deviations are 95 %."""
    levels = Levels(np.radians([-90.0, -30.0]), np.array([2e-6, 3e-6]), np.diag([1e-14, np.inf]))
    first, second = model_folder._level_records(levels)
    assert astuple(first) == pytest.approx((-90.0, 2.0, 0.19600), rel=1e-4)
    assert astuple(second)[:2] == pytest.approx((-30.0, 3.0))
    assert second.ci95 is None


def test_the_summary_tells_the_residual():
    residual = record.Residual(0.0312, 0.0944, 0.8125, 1.0, 50, [])
    data = record.IdentificationRecord(
        method="none", robot="x", sigma_mm=0.03, base={}, points={}, unloaded_rms_mm=0.0, outliers=[], warnings=[],
        residual=residual,
    )  # fmt: skip
    shown = "residual 0.031 mm RMS, 0.094 mm max; displacements 0.812 mm RMS"
    assert shown in model_folder.summary(data)
    assert "residual" not in model_folder.summary(replace(data, residual=None))


def test_masses_that_were_fitted_name_what_they_are_about():
    prior = Masses(source="weighed", assumed=False)
    for old, expected in ((prior, "r.csv, about weighed"), (None, "r.csv, about robot.urdf")):
        found = model_folder._masses(old, {"A3_kg": 120.0}, "r.csv")
        assert (found.source, found.A3_kg, found.assumed) == (expected, 120.0, old is None)
        assert model_folder._masses(old, {}, "r.csv") is old
