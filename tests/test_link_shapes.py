"""Shapes of the links: what `robots add` copies lies where the URDF puts it, for pages and for collisions."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from postproc import robot
from postproc.errors import ModelError
from postproc.files import read_toml
from postproc.identification import model_folder, record
from postproc.jobs.first_steps import add_robot
from postproc.robot import shapes
from postproc.robot.model_file import ModelFile
from postproc.robot.shapes import LinkShape
from tests.commands import invoke
from tests.kr270 import ROBOT
from tests.robot_urdfs import ros_urdf

pytestmark = pytest.mark.usefixtures("work_folder")

SIGNS = (-1, 1, -1, 1, -1, 1)
ZERO = np.radians([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
LINKS = ("base_link", *(f"link_{number}" for number in range(1, 7)))


def boxes(rng) -> list[trimesh.Trimesh]:
    return [
        trimesh.creation.box(rng.uniform(0.1, 0.4, 3), trimesh.transformations.random_rotation_matrix(rng.random(3)))
        for _ in LINKS
    ]


def with_shapes(text: str, write, rng) -> tuple[str, list[np.ndarray]]:
    """Add to each link what `write(number)` says, at a random place, and return these places."""
    places = []
    for number, link in enumerate(LINKS):
        angles, xyz = rng.uniform(-1, 1, 3), rng.uniform(-0.3, 0.3, 3)
        places.append(pin.SE3(pin.rpy.rpyToMatrix(*angles), xyz).homogeneous)
        origin = f'<origin xyz="{" ".join(map(str, xyz))}" rpy="{" ".join(map(str, angles))}"/>'
        shape = write(number).replace("ORIGIN", origin)
        text = re.sub(rf'<link name="{link}"/>', f'<link name="{link}"></link>', text)
        text = text.replace(f'<link name="{link}">', f'<link name="{link}">{shape}')
    return text, places


def meshes_in_a_package(rng, suffix: str, scale: float = 1.0):
    """Write boxes into arm_support/meshes, and the URDF into arm_support/urdf."""
    Path("arm_support/meshes").mkdir(parents=True)
    Path("arm_support/urdf").mkdir()
    Path("arm_support/package.xml").write_text("<package><name>arm_support</name></package>")
    own = boxes(rng)
    for number, mesh in enumerate(own):
        mesh.copy().apply_scale(scale).export(f"arm_support/meshes/{number}.{suffix}")
    factor = f"{1 / scale} " * 3
    text, places = with_shapes(
        ros_urdf(ROBOT, SIGNS, rng, zero=ZERO),
        lambda number: (
            f'<visual>ORIGIN<geometry><mesh filename="package://arm_support/meshes/{number}.{suffix}" '
            f'scale="{factor.strip()}"/></geometry></visual>'
        ),
        rng,
    )
    path = Path("arm_support/urdf/arm.urdf")
    path.write_text(text)
    return path, own, places


def in_root(model: robot.RobotModel, surfaces, q) -> list[np.ndarray]:
    """Corners of surfaces in the root, sorted, by the model's own chain."""
    frames = model.nominal.joint_frames(np.array([q]))[0][0]
    out = []
    for each in surfaces:
        pose = np.eye(4)
        if each.carrier >= 0:
            pose = frames[each.carrier].copy()
            pose[:3, :3] = pose[:3, :3] @ pin.exp3(q[each.carrier] * model.nominal.axis[each.carrier])
        out.append(ordered(each.transform(pose).points))
    return out


def ordered(points) -> np.ndarray:
    points = np.unique(np.round(points, 5), axis=0)
    return points[np.lexsort(points.T)]


def by_pinocchio(path: Path, own, places, q) -> list[np.ndarray]:
    """The same by Pinocchio from the URDF as it was given, in its frame `base`."""
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    pin.framesForwardKinematics(model, data, (q - ZERO) * SIGNS)
    pose = {name: data.oMf[model.getFrameId(name, pin.BODY)] for name in ("base", *LINKS)}
    out = []
    for link, mesh, place in zip(LINKS, own, places, strict=True):
        of = (pose["base"].inverse() * pose[link]).homogeneous @ place
        out.append(ordered(np.asarray(mesh.vertices) @ of[:3, :3].T + of[:3, 3]))
    return out


@pytest.mark.parametrize(("suffix", "scale"), [("stl", 1000.0), ("obj", 1.0), ("dae", 1.0)])
def test_links_are_where_pinocchio_puts_them(suffix, scale):
    if suffix == "dae":
        pytest.importorskip("collada")
    rng = np.random.default_rng(4)
    path, own, places = meshes_in_a_package(rng, suffix, scale)
    added = add_robot(path, "mine")
    model = robot.load(added.folder)
    q = rng.uniform(model.lower, model.upper)
    expected = by_pinocchio(path, own, places, q)
    for drawn in (True, False):
        surfaces, problems = model.link_shapes(for_drawing=drawn)
        assert problems == []
        assert [each.carrier for each in surfaces] == list(range(-1, 6))
        for one, other in zip(in_root(model, surfaces, q), expected, strict=True):
            np.testing.assert_allclose(one, other, atol=1e-4)
    assert any("7 links: 84 triangles; " in note for note in added.notes), added.notes


def test_a_wrong_place_would_be_noticed():
    rng = np.random.default_rng(4)
    path, own, places = meshes_in_a_package(rng, "stl")
    model = robot.load(add_robot(path, "mine").folder)
    q = rng.uniform(model.lower, model.upper)
    places[3] = places[3] @ pin.SE3(np.eye(3), np.array([1e-3, 0, 0])).homogeneous
    ours, expected = in_root(model, model.link_shapes(for_drawing=True)[0], q), by_pinocchio(path, own, places, q)
    off = [np.abs(one - other).max() for one, other in zip(ours, expected, strict=True)]
    assert off[3] > 2e-4
    assert max(off[:3] + off[4:]) < 1e-4


def test_primitives_and_collision_shapes():
    rng = np.random.default_rng(5)
    text, _ = with_shapes(
        ros_urdf(ROBOT, SIGNS, rng),
        lambda number: (
            "<collision>ORIGIN<geometry>"
            + ('<cylinder radius="0.1" length="0.5"/>', '<sphere radius="0.2"/>', '<box size="1 2 3"/>')[number % 3]
            + "</geometry></collision>"
        ),
        rng,
    )
    Path("arm.urdf").write_text(text)
    surfaces, _ = robot.load(add_robot(Path("arm.urdf"), "mine").folder).link_shapes(for_drawing=False)
    volumes = [trimesh.Trimesh(each.points, each.faces).volume for each in surfaces]
    exact = [np.pi * 0.01 * 0.5, 4 / 3 * np.pi * 0.008, 6.0]
    np.testing.assert_allclose(volumes, [exact[number % 3] for number in range(7)], rtol=0.01)


def test_meshes_that_are_not_there_are_a_remark():
    path, _, _ = meshes_in_a_package(np.random.default_rng(6), "stl")
    for mesh in Path("arm_support/meshes").iterdir():
        if mesh.stem != "3":
            mesh.unlink()
    done = invoke("robots", "add", path, "--name", "mine", catch_exceptions=False)
    assert done.exit_code == 0
    (note,) = [line for line in done.output.splitlines() if "left out" in line]
    assert note.startswith("note: 6 shapes are left out: package://arm_support/meshes/")
    assert "/5.stl" in note
    assert ": there is no such file; looked for " in note
    model = robot.load("mine")
    assert [each.carrier for each in model.link_shapes(for_drawing=True)[0]] == [2]


def test_an_arm_without_shapes_says_so():
    Path("arm.urdf").write_text(ros_urdf(ROBOT, SIGNS))
    assert any("solids of revolution" in note for note in add_robot(Path("arm.urdf"), "mine").notes)


def test_a_fine_mesh_is_simplified_within_the_distance_stated():
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=0.4)
    surface = LinkShape(0, np.asarray(sphere.vertices), np.asarray(sphere.faces))
    kept, moved = shapes.simplify(surface, 4000)
    assert 1500 < len(kept.faces) <= 4000
    assert 0.0 < moved < 0.04
    radius = np.linalg.norm(kept.points, axis=1)
    assert np.abs(radius - 0.4).max() <= moved + 1e-9
    assert trimesh.Trimesh(kept.points, kept.faces).volume == pytest.approx(sphere.volume, rel=0.02)


def test_what_is_simple_stays_as_it_is():
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    surface = LinkShape(0, np.asarray(box.vertices), np.asarray(box.faces))
    kept, moved = shapes.simplify(surface, 4000)
    assert kept is surface
    assert moved == 0.0


def test_an_identified_model_keeps_the_shapes():
    path, _, _ = meshes_in_a_package(np.random.default_rng(7), "stl")
    prior = add_robot(path, "mine").folder
    data = record.IdentificationRecord(
        method="serial", robot="mine", sigma_mm=0.01, base={}, points={}, unloaded_rms_mm=0.0, outliers=[], warnings=[]
    )
    model_folder.write(Path("found"), read_toml(prior / "model.toml", ModelFile, ModelError), data, prior)
    surfaces, problems = robot.load("found").link_shapes(for_drawing=True)
    assert len(surfaces) == 7
    assert problems == []
