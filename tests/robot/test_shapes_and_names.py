"""URDF: shapes, masses of links fixed to each other, limits, axes; surfaces made coarser; payloads by name."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.errors import ModelError
from postproc.frames import rotation_from_angles
from postproc.robot import shapes, urdf
from postproc.robot.rating import rated_payload
from postproc.robot.shapes import LinkShape
from tests.kr270 import FOLDER

TEXT = (FOLDER / "robot.urdf").read_text(encoding="utf-8")


def pose(xyz, roll_pitch_yaw) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_from_angles(np.array(roll_pitch_yaw[::-1], dtype=float))
    matrix[:3, 3] = xyz
    return matrix


def with_plate(inertial: str, shape: str = "") -> str:
    """The robot with a plate that is fixed to link_2."""
    return TEXT.replace(
        "</robot>",
        f'<link name="plate">{inertial}{shape}</link><joint name="p" type="fixed"><parent link="link_2"/>'
        '<child link="plate"/><origin xyz="0.1 0.2 0.3" rpy="0.4 0.5 0.6"/></joint></robot>',
    )


PLATE = pose([0.1, 0.2, 0.3], [0.4, 0.5, 0.6])


def test_the_mass_of_a_link_is_that_of_all_that_is_fixed_to_it():
    text = with_plate('<inertial><origin xyz="1 2 3"/><mass value="50"/></inertial>')
    whole, bare = urdf.read(text, "robot.urdf"), urdf.read(TEXT, "robot.urdf")
    np.testing.assert_allclose(whole.mass - bare.mass, [0, 50.0, 0, 0, 0, 0])
    moment = bare.mass[1] * bare.centre[1] + 50.0 * (PLATE @ [1.0, 2.0, 3.0, 1.0])[:3]
    np.testing.assert_allclose(whole.centre[1], moment / whole.mass[1], atol=1e-14)
    np.testing.assert_array_equal(np.delete(whole.centre, 1, 0), np.delete(bare.centre, 1, 0))
    weightless = urdf.read(with_plate('<inertial><mass value="0"/></inertial>'), "robot.urdf")
    np.testing.assert_allclose(weightless.centre, bare.centre, atol=1e-15)
    none = urdf.read(TEXT.replace('<mass value="47.9"/>', '<mass value="0"/>'), "robot.urdf")
    np.testing.assert_array_equal(none.centre[3], 0.0)


def test_shapes_are_listed_with_carrier_place_and_size():
    origin = '<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/>'
    shape = (
        f'<visual>{origin}<geometry><box size="1 2 3"/></geometry></visual>'
        '<visual><geometry><sphere radius="4"/></geometry></visual>'
        f'<collision>{origin}<geometry><cylinder radius="5" length="6"/></geometry></collision>'
        '<collision><geometry><mesh filename="a.stl" scale="7 8 9"/></geometry></collision>'
        '<collision><geometry><mesh filename="b.stl"/></geometry></collision>'
    )
    listed = urdf.geometries(with_plate("", shape), "robot.urdf")
    at = PLATE @ pose([1, 2, 3], [0.1, 0.2, 0.3])
    assert [(g.carrier, g.drawn, g.kind, g.size, g.file, tuple(g.scale)) for g in listed] == [
        (1, True, "box", (1.0, 2.0, 3.0), "", (1.0, 1.0, 1.0)),
        (1, True, "sphere", (4.0,), "", (1.0, 1.0, 1.0)),
        (1, False, "cylinder", (5.0, 6.0), "", (1.0, 1.0, 1.0)),
        (1, False, "mesh", (), "a.stl", (7.0, 8.0, 9.0)),
        (1, False, "mesh", (), "b.stl", (1.0, 1.0, 1.0)),
    ]
    for geometry, place in zip(listed, (at, PLATE, at, PLATE, PLATE), strict=True):
        np.testing.assert_allclose(geometry.pose, place, atol=1e-14)


def test_axes_are_of_unit_length_and_x_if_none_is_stated():
    scaled = urdf.read(TEXT.replace('<axis xyz="0 0 -1"/>', '<axis xyz="0 3e-3 -4e-3"/>'), "robot.urdf")
    np.testing.assert_allclose(scaled.axis[0], [0.0, 0.6, -0.8], atol=1e-15)
    np.testing.assert_array_equal(
        urdf.read(TEXT.replace('<axis xyz="0 0 -1"/>', ""), "robot.urdf").axis[0], [1.0, 0.0, 0.0]
    )


def test_limits_are_lower_upper_speed_and_effort():
    chain = urdf.read(TEXT.replace('<limit lower="', '<limit effort="7" lower="').replace(' effort="0"', ""), "x")
    np.testing.assert_allclose(np.degrees(chain.upper), [185, 0, 155, 350, 125, 350])
    np.testing.assert_array_equal(chain.effort, 7.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<link name="link_3">', "<link>", "a <link> has no name"),
        ('<joint name="A3" type', "<joint type", "a <joint> has no name"),
        ('<mass value="47.9"/>', "<mass/>", "a <mass> has no value"),
        ('<parent link="link_5"/>', "<parent/>", "a <parent> has no link"),
        ('<mass value="47.9"/>', '<mass value="1e10"/>', "not finite, or beyond 1e"),
        ('<mass value="47.9"/>', '<mass value="4 7"/>', "1 number expected"),
        ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 -1e-7"/>', "joint A1 has no axis"),
        ('upper="0"', 'upper="-2.5481807079117214"', "limits of joint A2 are missing or impossible"),
        ('velocity="3.211405823669566"', 'velocity="-3"', "limits of joint A6 are missing or impossible"),
    ],
)
def test_what_is_missing_or_impossible_is_named(old, new, message):
    assert old in TEXT
    with pytest.raises(ModelError, match=message):
        urdf.read(TEXT.replace(old, new, 1), "robot.urdf")


def test_a_mimic_is_refused_with_its_name():
    with pytest.raises(ModelError, match="joint A1 is a mimic of another"):
        urdf.read(TEXT.replace('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 -1"/><mimic joint="A2"/>'), "robot.urdf")


def test_corners_in_one_cell_become_their_mean_and_flat_and_equal_triangles_vanish():
    """Cells of 1 mm. Corners 0 and 1 share one, 2 and 3 another; 4 and 5 are alone."""
    points = 1e-3 * np.array([
        [0.2, 0.2, 0.2], [0.6, 0.4, 0.2], [5.1, 0.5, 0.5], [5.9, 0.5, 0.9], [0.5, 7.5, 0.5], [9.5, 9.5, 9.5],
    ])  # fmt: skip
    faces = np.array([[0, 1, 4], [0, 2, 4], [4, 1, 3], [2, 3, 5], [1, 5, 4]])
    coarse, displacement = shapes.simplify(LinkShape(2, points, faces), 4)
    expected = 1e-3 * np.array([[0.4, 0.3, 0.2], [5.5, 0.5, 0.7], [0.5, 7.5, 0.5], [9.5, 9.5, 9.5]])
    triangles = coarse.points[coarse.faces]
    np.testing.assert_allclose(triangles, expected[np.array([[0, 1, 2], [0, 3, 2]])], atol=1e-12)
    assert len(coarse.points) == 4
    assert coarse.carrier == 2
    assert displacement == pytest.approx(1e-3 * np.hypot(0.4, 0.2))


def test_surfaces_of_one_carrier_become_one_in_the_order_of_the_carriers():
    triangle = np.arange(9.0).reshape(3, 3)
    parts = [LinkShape(c, triangle + 10 * k, np.array([[0, 1, 2]])) for k, c in enumerate((3, -1, 3))]
    base, link = shapes.join_by_carrier(parts)
    assert (base.carrier, link.carrier) == (-1, 3)
    np.testing.assert_array_equal(base.points, triangle + 10)
    np.testing.assert_array_equal(link.points[link.faces], [triangle, triangle + 20])


def test_a_surface_is_moved_by_the_pose_of_its_frame():
    place = pose([1, 2, 3], [0.4, 0.5, 0.6])
    moved = LinkShape(0, np.arange(9.0).reshape(3, 3), np.array([[0, 1, 2]])).transform(place)
    for point, expected in zip(moved.points, np.arange(9.0).reshape(3, 3), strict=True):
        np.testing.assert_allclose(point, place[:3, :3] @ expected + place[:3, 3], atol=1e-14)


@pytest.mark.parametrize(
    ("names", "payload"),
    [
        (("KUKA KR 270-2 (2000 series)",), 270.0),
        (("kr6_r900_2",), 6.0),
        (("KR 210-2 L150",), 150.0),
        (("kuka_kr210l150",), 150.0),
        (("arm", "KR 16"), 16.0),
        (("KR 16", "KR 60"), 16.0),
        (("IRB 6700-200/2.60",), 200.0),
        (("irb6640_180_255_support",), 180.0),
        (("krx", "IRB 120"), None),
        ((), None),
    ],
)
def test_the_payload_is_that_of_the_first_name_that_states_one(names, payload):
    assert rated_payload(*names) == payload


def mesh_of(folder, name: str, height: float) -> None:
    """Write a flat triangle at a height [m]."""
    triangle = LinkShape(0, np.array([[0.0, 0, height], [1, 0, height], [0, 1, height]]), np.array([[0, 1, 2]]))
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(triangle.stl())


def read_one(filename: str, place, scale: str = "1 1 1"):
    """Surfaces and problems of one mesh of link_2 that a URDF at a place names."""
    shape = f'<collision><geometry><mesh filename="{filename}" scale="{scale}"/></geometry></collision>'
    return shapes.read(urdf.geometries(with_plate("", shape), "robot.urdf"), place / "robot.urdf")


@pytest.mark.parametrize(
    ("mesh", "filename"),
    [
        ("ws/arm/urdf/m.stl", "m.stl"),
        ("ws/arm/meshes/m.stl", "../meshes/m.stl"),
        ("ws/arm/meshes/m.stl", "..\\meshes\\m.stl"),
        ("ws/arm/meshes/m.stl", "package://arm/meshes/m.stl"),
        ("ws/arm/meshes/m.stl", "model://arm/meshes/m.stl"),
        ("ws/other/meshes/m.stl", "package://other/meshes/m.stl"),
        ("ws/arm/meshes/m.stl", "package://named/meshes/m.stl"),
    ],
)
def test_a_mesh_is_found_beside_the_urdf_or_in_its_package_or_one_beside_it(tmp_path, mesh, filename):
    """The folder `arm` is the package `named` by its package.xml."""
    mesh_of(tmp_path, mesh, 0.25)
    (tmp_path / "ws" / "arm" / "urdf").mkdir(parents=True, exist_ok=True)
    (tmp_path / "ws" / "arm" / "package.xml").write_text("<package><name> named </name></package>")
    (surface,), problems = read_one(filename, tmp_path / "ws" / "arm" / "urdf", "2 3 4")
    assert problems == []
    assert surface.carrier == 1
    expected = np.array([[0.0, 0, 1], [2, 0, 1], [0, 3, 1]]) @ PLATE[:3, :3].T + PLATE[:3, 3]
    np.testing.assert_allclose(surface.points[surface.faces[0]], expected, atol=1e-7)


def test_a_mesh_that_is_nowhere_is_named_with_three_of_the_places(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    mesh_of(tmp_path, "else/m.stl", 0.0)
    surfaces, (problem,) = read_one("package://arm/m.stl", tmp_path / "a" / "b")
    assert surfaces == []
    places = [str(folder / "arm" / "m.stl") for folder in (tmp_path / "a" / "b", tmp_path / "a", tmp_path)]
    above = len(tmp_path.resolve().parents)
    assert problem == (
        f"package://arm/m.stl: there is no such file; looked for {', '.join(places)}, and {above} more above"
    )
    _, (single,) = read_one("m.stl", tmp_path / "a" / "b")
    assert single.endswith(f"looked for {tmp_path / 'a' / 'b' / 'm.stl'}")


def test_primitives_have_their_size_and_other_kinds_are_no_shapes(tmp_path):
    boxes = (
        '<collision><geometry><box size="0.2 0.4 0.6"/></geometry></collision>'
        '<collision><geometry><sphere radius="0.5"/></geometry></collision>'
        '<collision><geometry><cylinder radius="0.5" length="3"/></geometry></collision>'
        "<collision><geometry><torus/></geometry></collision>"
    )
    text = TEXT.replace('<link name="link_1">', f'<link name="link_1">{boxes}', 1)
    surfaces, problems = shapes.read(urdf.geometries(text, "robot.urdf"), tmp_path / "robot.urdf")
    assert problems == ["torus: is neither a mesh nor a box, cylinder or sphere"]
    for surface, half in zip(surfaces, ([0.1, 0.2, 0.3], [0.5] * 3, [0.5, 0.5, 1.5]), strict=True):
        np.testing.assert_allclose([surface.points.min(axis=0), surface.points.max(axis=0)], [np.negative(half), half])
        assert surface.carrier == 0
