"""Model folders: every value with its source in words, and files that are refused with what is wrong in them."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from postproc import robot
from postproc.errors import ModelError
from postproc.robot.folder import sourced_values
from postproc.robot.model_file import (
    BacklashEntry,
    CovarianceTable,
    DiscrepancyEntry,
    Displacement,
    ForcesEntry,
    GeometryErrorEntry,
    LinkSprings,
    Masses,
    MeasuredEntry,
    ModelFile,
    PayloadEntry,
    PoseWaveEntry,
    SourcedEntry,
    Stiffening,
    TransmissionEntry,
)
from tests.kr270 import CONTENT, FOLDER

NOMINAL = robot.load(FOLDER).nominal
MODEL, URDF = ((FOLDER / name).read_text(encoding="utf-8") for name in ("model.toml", "robot.urdf"))


def full() -> ModelFile:
    """A model file with each entry, in numbers that differ."""
    joints = dict(CONTENT.joints)
    joints["A4"] = replace(
        joints["A4"],
        ci95=0.1234,
        stiffening=[Stiffening(500.0, 0.25)],
        knees=[Stiffening(90.0, 0.5)],
        backlash=BacklashEntry(12.0, 3.0),
        lost_motion=BacklashEntry(7.0, 2.0),
        over_pose=[PoseWaveEntry((0, 1, 0, 0, 0, 0), 0.1), PoseWaveEntry((0, 2, 0, 0, 0, 0), 0.2)],
        coupling={"A5": -0.4, "A6": 0.3},
    )
    place = {"X_mm": 1.0, "Y_mm": 2.0, "Z_mm": 3.0}
    return replace(
        CONTENT,
        joints=joints,
        payload=PayloadEntry(source="scales", mass_kg=12.5, **place),
        links={
            "A2": LinkSprings(source="reading 1", X_um_per_N=0.1, RY_urad_per_Nm=0.2),
            "base": LinkSprings(source="guess", assumed=True, RX_urad_per_Nm=0.2),
        },
        geometry={"A3": Displacement(source="reading 2", **place, RX_deg=0.4, RY_deg=0.5, RZ_deg=0.6)},
        transmission={
            "A1": TransmissionEntry(source="reading 3", sin_urad=11.0, cos_urad=12.0, sin2_urad=13.0, cos2_urad=14.0)
        },
        discrepancy=DiscrepancyEntry(source="reading 4", load_N=[300.0, 1500.0], u95_mm=[0.05, 0.125]),
        geometry_error=GeometryErrorEntry(
            source="reading 5", u95_mm=0.25, angles_deg={"A2": (-90.0, 10.0), "A1": (-45.0, 45.0)}
        ),
        measured=MeasuredEntry(source="reading 6", configurations=40, torque_Nm=(1.0, 2000.0, 3.0, 4.0, 5.0, 6.0)),
        masses=Masses(source="drawing", A3_kg=180.0),
        speeds=None,
        geometry_nominal=SourcedEntry(source="maker", assumed=True),
    )


def test_each_value_of_a_model_is_stated_with_its_source():
    stated = [(v.name, v.value, v.source[:9], v.assumed) for v in sourced_values(full(), NOMINAL)]
    assert stated == [
        ("compliance A1", "0.623 µrad/(N·m) (σ 40 %)", "Klimchik ", False),
        ("compliance A2", "0.302 µrad/(N·m) (σ 25 %)", "same grou", True),
        ("compliance A3", "0.416 µrad/(N·m) (σ 25 %)", "Klimchik ", False),
        (
            "compliance A4",
            "2.786 ± 0.123 µrad/(N·m) (σ 25 %), of which 0.75 fade with load; backlash 12 µrad; over the pose, 2 waves;"
            " coupled: -0.4 with A5, 0.3 with A6; lost motion 7 µrad",
            "Klimchik ",
            False,
        ),
        ("compliance A5", "3.483 µrad/(N·m) (σ 25 %)", "Klimchik ", False),
        ("compliance A6", "2.074 µrad/(N·m) (σ 40 %)", "Klimchik ", False),
        ("compensator geometry", "L 184.72, a_x 685.93, a_y 123.3 mm", "Klimchik ", False),
        ("compensator spring", "K_c 120000 N/m (σ 40 %), s_0 458 mm", "sized to ", True),
        ("payload when measured", "12.5 kg at 1, 2, 3 mm of the flange", "scales", False),
        ("springs of link A2", "2 directions", "reading 1", False),
        ("springs of link base", "1 directions", "guess", True),
        ("calibrated A3", "1, 2, 3 mm; 0.4, 0.5, 0.6°", "reading 2", False),
        ("transmission A1", "11, 12 µrad once a turn (sin, cos), 13, 14 µrad twice", "reading 3", False),
        ("discrepancy (95 %)", "0.05 mm at 300 N, 0.12 mm at 1500 N", "reading 4", False),
        ("error of the geometry (95 %)", "0.25 mm at A2 -90 to 10°, A1 -45 to 45°; more beyond", "reading 5", False),
        ("measured", "40 configurations, up to 1, 2000, 3, 4, 5, 6 N·m on A1 … A6", "reading 6", False),
        ("link masses", "367.4, 232.1, 180, 47.9, 23.7, 12.2 kg", "drawing", False),
        ("geometry, limits", "robot.urdf", "maker", True),
        ("joint speeds", speeds(), "maker", True),
        ("gravity reference", "calibrated", "model.tom", False),
    ]


def speeds() -> str:
    """Speeds of the URDF in degrees a second, four digits."""
    return ", ".join(f"{float(f'{v:.4g}'):g}" for v in np.rad2deg(NOMINAL.speed)) + " °/s"


def test_values_without_an_entry_are_marked_as_assumed():
    bare = replace(CONTENT, masses=None, geometry_nominal=None, speeds=None, compensator=None)
    stated = {value.name: value for value in sourced_values(bare, NOMINAL)}
    for name in ("link masses", "geometry, limits", "joint speeds"):
        assert (stated[name].source, stated[name].assumed) == ("not stated", True)
    assert "compensator spring" not in stated
    own = replace(CONTENT.compensator, geometry_source="", source="catalogue")
    without = {value.name: value for value in sourced_values(replace(CONTENT, compensator=own), NOMINAL)}
    geometry = without["compensator geometry"]
    assert (geometry.source, geometry.assumed) == ("catalogue", True)
    everywhere = replace(CONTENT, geometry_error=GeometryErrorEntry(source="x", u95_mm=0.25))
    assert {v.name: v.value for v in sourced_values(everywhere, NOMINAL)}["error of the geometry (95 %)"] == "0.25 mm"


def test_numbers_of_a_model_file_are_si_in_the_robot():
    content = full()
    model = robot.assemble("arm", content, NOMINAL)
    np.testing.assert_allclose(model.transmission.amplitude[0], [11e-6, 12e-6, 13e-6, 14e-6])
    assert not model.transmission.amplitude[1:].any()
    np.testing.assert_allclose([model.discrepancy.load, model.discrepancy.u95], [[300.0, 1500.0], [5e-5, 1.25e-4]])
    error = model.geometry_error
    assert error.u95 == pytest.approx(2.5e-4)
    np.testing.assert_allclose(error.lower, np.radians([-45.0, -90.0, *[-np.inf] * 4]))
    np.testing.assert_allclose(error.upper, np.radians([45.0, 10.0, *[np.inf] * 4]))
    far = replace(content.geometry_error, unmeasured_mm=0.5)
    assert robot.assemble("arm", replace(content, geometry_error=far), NOMINAL).geometry_error.unmeasured == 5e-4
    np.testing.assert_array_equal(model.measured.torque, [1.0, 2000.0, 3.0, 4.0, 5.0, 6.0])
    assert model.subtract_reference
    assert not model.carries_weight
    zero = replace(content, transmission={"A1": TransmissionEntry(source="x")}, discrepancy=None, measured=None)
    bare = robot.assemble("arm", zero, NOMINAL)
    assert (bare.transmission, bare.discrepancy, bare.measured) == (None, None, None)


def test_the_covariance_with_the_factor_of_forces_is_taken_by_name():
    """`forces` is between two compliances in the table; A1 has its stated spread, and is not in the table."""
    matrix = np.array([[4.0, 0.5, 0.1], [0.5, 9.0, 0.2], [0.1, 0.2, 16.0]])
    content = replace(
        CONTENT,
        compensator=None,
        joints={
            name: replace(spring, sigma_percent=10.0 if name == "A1" else None)
            for name, spring in CONTENT.joints.items()
        },
        covariance=CovarianceTable(["k3", "forces", "k2"], matrix.tolist()),
        forces=ForcesEntry(
            source="x", cutting_N_per_mm2=(600.0, 200.0, 100.0), edge_N_per_mm=(20.0, 10.0, 5.0), mc=0.25,
            sigma_percent=8.0,
        ),
    )  # fmt: skip
    model = robot.assemble("arm", content, NOMINAL)
    assert [parameter.name for parameter in model.covariance.parameters] == ["k3", "k2", "k1"]
    np.testing.assert_allclose(model.covariance.matrix, [[4.0, 0.1, 0], [0.1, 16.0, 0], [0, 0, 0.0623**2]])
    np.testing.assert_allclose(model.force_factor.covariance, [0.5, 0.2, 0.0, 9.0])
    assert model.force_factor.law == (600.0, 200.0, 100.0, 20.0, 10.0, 5.0, 0.25, 8.0)
    assert [parameter.name for parameter in model.stated_spread] == ["k1"]
    assert model.basis == "measured on this robot, but for k1: from published values"


def test_a_spread_of_a_compensator_without_stiffness_does_not_count():
    none = replace(CONTENT.compensator, stiffness_N_per_m=0.0)
    names = [p.name for p in robot.assemble("arm", replace(CONTENT, compensator=none), NOMINAL).covariance.parameters]
    assert names == ["k1", "k2", "k3", "k4", "k5", "k6"]


REFUSED = [
    ("[joints.A7]\ncompliance_urad_per_Nm = 1.0\nsource = 'x'", "unknown joint 'A7'"),
    ("[geometry.A9]\nsource = 'x'", "unknown joint 'A9'"),
    ("[transmission.flange]\nsource = 'x'", "unknown joint 'flange'"),
    ("[links.flange]\nsource = 'x'", "unknown joint 'flange'"),
    ("[[joints.A6.stiffening]]\ntorque_Nm = 9\ncompliance_urad_per_Nm = 2.08", "sum of the stiffening parts exceeds"),
    ("[joints.A4.coupling]\nA4 = 0.1", "A4 and A4 are no pair of the wrist"),
    ("[joints.A5.coupling]\nA4 = 0.1", "A5 and A4 are no pair of the wrist"),
    ("[joints.A3.coupling]\nA4 = 0.1", "A3 and A4 are no pair of the wrist"),
    ("[[joints.A1.over_pose]]\nturns = [0, 0, 0, 0, 0, 0]\ncos_urad_per_Nm = 0.1", "A1. over_pose: turns are all zero"),
    (
        "[[joints.A1.over_pose]]\nturns = [0, 1, 0, 0, 0, 0]\ncos_urad_per_Nm = 0.1\n"
        "[[joints.A1.over_pose]]\nturns = [0, 1, 0, 0, 0, 0]\nsin_urad_per_Nm = 0.1",
        "two entries have the same turns",
    ),
    ("[geometry_error]\nu95_mm = 0.1\nsource = 'x'\nangles_deg = { A9 = [0, 1] }", "unknown joint 'A9'"),
    ("[geometry_error]\nu95_mm = 0.1\nsource = 'x'\nangles_deg = { A1 = [30, -30] }", "A1 goes from 30 to -30°"),
    *(
        (f"[discrepancy]\nload_N = {loads}\nu95_mm = {errors}\nsource = 'x'", "needs ascending load_N above zero")
        for loads, errors in (("[]", "[]"), ("[1.0]", "[0.1, 0.2]"), ("[0.0]", "[0.1]"), ("[2.0, 2.0]", "[0.1, 0.2]"))
    ),
    ("[covariance]\nparameters = ['k9']\nmatrix = [[1.0]]", "names 'k9', which is no parameter"),
    ("[covariance]\nparameters = ['k1', 'k2']\nmatrix = [[1.0]]", "neither 2×2 nor the lower triangle"),
    ("[covariance]\nparameters = ['A2.RX']\nmatrix = [[1.0]]", "'A2.RX', which the model does not have"),
    ("[covariance]\nparameters = ['forces']\nmatrix = [[1.0]]", "belong together"),
    (
        "[forces]\ncutting_N_per_mm2 = [1, 1, 1]\nedge_N_per_mm = [1, 1, 1]\nsigma_percent = 1\nsource = 'x'",
        "belong together",
    ),
]


def written(folder, text: str):
    (folder / "model.toml").write_text(text, encoding="utf-8")
    (folder / "robot.urdf").write_text(URDF, encoding="utf-8")
    return folder


@pytest.mark.parametrize(("table", "message"), REFUSED, ids=lambda value: value[:40])
def test_a_model_file_that_cannot_be_is_refused(tmp_path, table, message):
    with pytest.raises(ModelError, match=message) as refused:
        robot.load(written(tmp_path, f"{MODEL}\n{table}\n"))
    assert "model.toml" in str(refused.value)


def test_a_joint_without_compliance_is_refused(tmp_path):
    start, end = MODEL.index("[joints.A2]"), MODEL.index("[joints.A3]")
    text = MODEL[:start] + MODEL[end:]
    with pytest.raises(ModelError, match=r"no \[joints.A2\]"):
        robot.load(written(tmp_path, text))


VALID = [
    "[[joints.A6.stiffening]]\ntorque_Nm = 9\ncompliance_urad_per_Nm = 2.074",
    "[joints.A4.coupling]\nA5 = 0.1\nA6 = -0.1\n[joints.A5.coupling]\nA6 = 0.1",
    "[geometry_error]\nu95_mm = 0.1\nsource = 'x'\nangles_deg = { A1 = [30, 30] }",
    "[discrepancy]\nload_N = [0.5, 1.0]\nu95_mm = [0.1, 0.05]\nsource = 'x'",
    "[[joints.A1.over_pose]]\nturns = [0, 1, 0, 0, 0, 0]\ncos_urad_per_Nm = 0.1\n"
    "[[joints.A1.over_pose]]\nturns = [0, -1, 0, 0, 0, 0]\nsin_urad_per_Nm = 0.1",
    "[covariance]\nparameters = ['k1', 'k2']\nmatrix = [[1.0, 0.5], [0.5000004, 1.0]]",
]


@pytest.mark.parametrize("table", VALID, ids=lambda value: value[:40])
def test_a_model_file_at_the_limit_is_read(tmp_path, table):
    model = robot.load(written(tmp_path, f"{MODEL}\n{table}\n"))
    assert model.name == tmp_path.name
    assert model.urdf == str((tmp_path / "robot.urdf").resolve())


def test_an_entry_without_numbers_changes_nothing():
    np.testing.assert_array_equal(
        robot.assemble("arm", replace(CONTENT, geometry={"A2": Displacement(source="x")}), NOMINAL).actual.placement,
        NOMINAL.placement,
    )
    payload = PayloadEntry(source="x", mass_kg=1.0)
    assert (payload.X_mm, payload.Y_mm, payload.Z_mm) == (0.0, 0.0, 0.0)
    assert not any(getattr(TransmissionEntry(source="x"), f"{term}_urad") for term in robot.GEAR_TERMS)
    assert not robot.assemble("arm", replace(CONTENT, links={"A2": LinkSprings(source="x")}), NOMINAL).link_springs
    law = ForcesEntry(source="x", cutting_N_per_mm2=(1.0, 1.0, 1.0), edge_N_per_mm=(1.0, 1.0, 1.0), sigma_percent=1.0)
    assert law.mc == 0.0


@pytest.mark.parametrize(
    ("kind", "key", "least", "largest"),
    [
        (Stiffening, "torque_Nm", 1e-12, 1e12),
        (LinkSprings, "X_um_per_N", 0.0, 1e12),
        (TransmissionEntry, "cos2_urad", -1e4, 1e4),
        (Displacement, "RY_deg", -1e6, 1e6),
    ],
)
def test_numbers_beyond_what_a_value_can_be_are_refused(kind, key, least, largest):
    rest = {"compliance_urad_per_Nm": 1.0} if kind is Stiffening else {"source": "x"}
    for value in (least, largest):
        assert getattr(msgspec.convert(rest | {key: value}, kind), key) == value
    for value in (least - 1e-3 * abs(least) - 1e-13, largest * 1.001):
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert(rest | {key: value}, kind)


def test_a_robot_is_found_by_name_and_by_path(tmp_path):
    assert robot.find("kuka_kr270") == robot.shipped_models()["kuka_kr270"]
    (tmp_path / "models" / "mine").mkdir(parents=True)
    written(tmp_path / "models" / "mine", MODEL)
    assert robot.find("models\\mine", tmp_path) == tmp_path / "models" / "mine"
    with pytest.raises(ModelError, match=r"no robot 'kuka_kr27'\. Did you mean") as refused:
        robot.find("kuka_kr27", tmp_path)
    assert str(refused.value).endswith(f"{', '.join(robot.shipped_models())}.")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ModelError, match="no robot 'empty'"):
        robot.find("empty", tmp_path)
