"""Forces against published values and closed forms, energy against the volume removed, the map against trimesh."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from postproc.machining import material, stock, stock_mesh, table
from tests.machining.setting import AL7075, forces, gcode, line_of, on_line, process, tool

BOX = ((0, 100), (-40, 40), (-20, 0))
WHOLE = ((-50, 50), (-40, 40), (-20, 0))


def altintas(teeth, depth, chip, k, begin, end):
    """Average milling forces between two angles (Altintas, Manufacturing Automation, 2nd ed., Eq. 2.31)."""
    ktc, kte, krc, kre, kac, kae = k

    def at(phi):
        c2, s2, c, s = math.cos(2 * phi), math.sin(2 * phi), math.cos(phi), math.sin(phi)
        x = chip / 4 * (ktc * c2 - krc * (2 * phi - s2)) + (-kte * s + kre * c)
        y = chip / 4 * (ktc * (2 * phi - s2) + krc * c2) - (kte * c + kre * s)
        return np.array([x, y, -kac * chip * c + kae * phi]) * teeth * depth / (2 * math.pi)

    return at(end) - at(begin)


def test_the_published_slot_to_three_digits(tmp_path):
    """Four teeth, 3 mm deep, 0.1 mm a tooth, Al 7075-T6, carbide: (−152, 336, 89) N."""
    text = gcode("G0 X-10 Y0 Z5", "G1 Z-3 F2400", "X110 (here)")
    program, found = forces(tmp_path, text, process(tool(10, 4), BOX))
    wrench = on_line(program, found, line_of(text, "X110 (here)"), 0.5)
    np.testing.assert_allclose(wrench[:3], (-152, 336, 89), atol=0.5)
    np.testing.assert_allclose(wrench[:3], altintas(4, 3, 0.1, AL7075, 0, math.pi), rtol=1e-3)


@pytest.mark.parametrize("sense", ["G2", "G3"])
@pytest.mark.parametrize(("wider", "resolution", "error"), [(0.3, 0.25, 0.05), (0.75, 0.25, 0.05), (0.75, 0.1, 0.02)])
def test_a_hole_that_is_hardly_wider_than_the_tool(tmp_path, sense, wider, resolution, error):
    """On the first half of a circle about a plunge the wall of that hole crosses the edge at a very small angle."""
    radius, depth, feed = 6.0, 1.5, 1200.0
    circle = f"{sense} I{-wider}"
    text = gcode("G0 X0 Y0 Z5", f"G1 Z{-depth} F{feed}", f"X{wider}", circle)
    program, found = forces(tmp_path, text, process(tool(2 * radius, 4), WHOLE, resolution))
    (motion,) = np.flatnonzero(program.motions.line == line_of(text, circle))
    rows = (found.cuts.motion == motion) & (found.cuts.t > 0.15) & (found.cuts.t < 0.45)
    beyond = math.asin(0.5 * wider / radius)  # the circles of tool and hole cross so far beyond the heading
    left = sense == "G2"  # the solid is on this side
    begin, end = (0.0, 0.5 * math.pi + beyond) if left else (0.5 * math.pi - beyond, math.pi)
    expected = altintas(4, depth, feed / 6000 / 4, AL7075, begin, end)
    difference = found.cuts.wrench[rows, :3].mean(axis=0) - expected
    assert np.linalg.norm(difference) < error * np.linalg.norm(expected)


@pytest.mark.parametrize(("name", "entry"), [(n, e) for n, e in table().items() if e.Ktc_N_per_mm2 is not None])
def test_every_linear_material_in_a_slot(tmp_path, name, entry):
    text = gcode("G0 X-10 Y0 Z5", "G1 Z-3 F2400", "X110 (here)")
    program, found = forces(tmp_path, text, process(tool(10, 4), BOX, 0.5, f'name = "{name}"'))
    keys = ("Ktc_N_per_mm2", "Kte_N_per_mm", "Krc_N_per_mm2", "Kre_N_per_mm", "Kac_N_per_mm2", "Kae_N_per_mm")
    k = [getattr(entry, key) or 0.0 for key in keys]
    wrench = on_line(program, found, line_of(text, "X110 (here)"), 0.5)
    expected = altintas(4, 3, 0.1, k, 0, math.pi)
    np.testing.assert_allclose(wrench[:3], expected, rtol=2e-3, atol=1e-3 * np.linalg.norm(expected))


def test_every_material_names_its_source_and_its_uncertainty():
    entries = table()
    assert all(entry.source and entry.title and entry.sigma_percent for entry in entries.values())
    assert entries["cfrp"].warning
    for word in ("Aluminium", "Steel", "Stainless", "Titanium", "Brass", "Plywood", "MDF", "foam", "Carbon"):
        assert any(word in entry.title for entry in entries.values()), word


@pytest.mark.parametrize("feed", [60.0, 300.0])
def test_plunge_is_torque_and_thrust_of_drilling(tmp_path, feed):
    text = gcode("G0 X50 Y0 Z5", f"G1 Z-10 F{feed} (here)")
    program, found = forces(tmp_path, text, process(tool(10, 4), BOX))
    wrench = on_line(program, found, line_of(text, f"G1 Z-10 F{feed} (here)"), 0.9)
    chip = feed / 6000 / 4
    assert wrench[2] == pytest.approx(4 * 5 * (AL7075[2] * chip + AL7075[3]), rel=1e-3)
    assert wrench[5] == pytest.approx(4 * 25 / 2 * (AL7075[0] * chip + AL7075[1]) * 1e-3, rel=1e-3)
    assert np.abs(wrench[[0, 1]]).max() < 1e-3 * wrench[2]


def energy(program, found):
    """Work of the spindle [J] along the path: power is linear between the places given."""
    total = 0.0
    m = program.motions
    begin = np.concatenate([[[0.0, 0, 0]], m.target[:-1, :3, 3]])
    for motion in np.unique(found.cuts.motion).tolist():
        rows = found.cuts.motion == motion
        length = np.linalg.norm(m.target[motion, :3, 3] - begin[motion])
        if m.kind[motion] == 1:
            length = m.sweep[motion] * np.linalg.norm(begin[motion] - m.centre[motion])
        t = np.concatenate([[0.0], found.cuts.t[rows], [1.0]])
        power = found.cuts.power[rows]
        power = np.concatenate([power[:1], power, power[-1:]])
        total += np.trapezoid(power, t) * length / m.feed[motion]
    return total


POCKET = (
    "G0 X50 Y0 Z5", "G1 Z0 F1200", "X60 Z-2", "X40", "X60", "G1 X65 Y12", "X35", "Y-12", "X65", "Y12",
    "G3 X57 Y20 I-8 J0", "G1 X30", "Y-20", "X72", "Y20",
)  # fmt: skip


@pytest.mark.parametrize("shape", ["flat", "ball", "bull"])
def test_energy_is_specific_energy_times_volume(tmp_path, shape):
    """Without rubbing, Ktc is the work per volume: within 1 %. The volume is the one missing from the map."""
    material = "Ktc_N_per_mm2 = 800.0\nKrc_N_per_mm2 = 200.0"
    program, found = forces(tmp_path, gcode(*POCKET), process(tool(10, 3, shape, 2.0), BOX, 0.25, material=material))
    assert energy(program, found) == pytest.approx(800e6 * found.removed_volume, rel=0.01)


def test_energy_that_leaves_out_a_way_would_be_noticed(tmp_path):
    material = "Ktc_N_per_mm2 = 800.0\nKrc_N_per_mm2 = 200.0"
    program, found = forces(tmp_path, gcode(*POCKET), process(tool(10, 3), BOX, 0.5, material=material))
    longest = int(np.argmax(np.bincount(found.cuts.motion)))
    found.cuts.power[found.cuts.motion == longest] = 0.0
    assert energy(program, found) != pytest.approx(800e6 * found.removed_volume, rel=0.01)


def test_volume_of_a_mesh_is_that_of_trimesh():
    for shape in (
        trimesh.creation.icosphere(subdivisions=4, radius=20.0),
        trimesh.creation.box((31.3, 17.7, 9.9), trimesh.transformations.rotation_matrix(0.3, (0, 0, 1))),
        trimesh.creation.cylinder(11.0, 20.0, sections=96),
    ):
        mapped = stock.from_mesh(shape.vertices * 1e-3, np.asarray(shape.faces), 0.25e-3)
        assert mapped.volume() == pytest.approx(shape.volume * 1e-9, rel=2e-3)


def test_the_mesh_of_a_box_has_its_corners():
    low, high = np.array([0.01, -0.02, -0.003]), np.array([0.03, 0.01, 0.004])
    vertices, faces, _ = stock_mesh.mesh_of(stock.from_box(low, high, 1e-3))
    assert set(vertices[:, 2].round(9)) == {low[2], high[2]}
    np.testing.assert_allclose([vertices.min(axis=0), vertices.max(axis=0)], [low, high], atol=1e-9)
    assert stock.as_trimesh(vertices, faces).volume == pytest.approx(20 * 30 * 7, rel=1e-6)


def test_removed_volume_and_what_is_left_are_those_of_trimesh(tmp_path):
    """A slot with round ends, 3 mm deep; what is left is a closed mesh."""
    text = gcode("G0 X30 Y0 Z5", "G1 Z-3 F300", "X70")
    _, found = forces(tmp_path, text, process(tool(10, 4), BOX))
    assert found.removed_volume == pytest.approx((math.pi * 25 + 400) * 3e-9, rel=2e-3)
    vertices, faces, _ = found.mesh()
    mesh = trimesh.Trimesh(vertices * 1e3, faces)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(100 * 80 * 20 - (math.pi * 25 + 400) * 3, rel=1e-3)


# Power constants [kW per cm³/s] and feed factors of Machinery's Handbook, sharp tools, as a public extract quotes them
POWER = {
    "steel_mild": 1.69, "steel_c45": 1.97, "steel_low_alloy": 2.40, "stainless_austenitic": 1.97, "al_wrought": 0.90,
    "cast_iron_gjl_250": 1.15, "ti_6al_4v": 1.77, "ti_6al_4v_carbide": 1.77, "al_6082_t6_carbide": 0.90,
}  # fmt: skip
FEED_FACTOR = {0.05: 1.40, 0.10: 1.25, 0.20: 1.08}


@pytest.mark.parametrize("name", POWER)
def test_published_power_constants_are_inside_the_deviation_of_the_materials(name):
    """kW per cm³/s are 1000 N/mm²; the deviation is that with wear, as forces have it without a sigma of the user."""
    law = material.law(material.MaterialTable(name=name), "process.toml")
    for feed, factor in FEED_FACTOR.items():
        cut = float(law.chip_factor(np.float32(feed * 1e-3))) * law.cutting[0] + law.edge[0]
        specific = cut / (feed * 1e-3)
        assert abs(1e9 * POWER[name] * factor - specific) < 1.96 * law.sigma * specific


@pytest.mark.parametrize(("rake", "thickness", "share"), [(12.0, 0.05, 0.01), (12.0, 0.1, 0.01)])
def test_the_titanium_set_is_that_of_its_orthogonal_data(rake, thickness, share):
    """Armarego's oblique transformation, 12° rake and 30° helix; the chip thickness matters little."""
    entry = table()["ti_6al_4v_carbide"]
    helix, a = math.radians(30.0), math.radians(rake)
    beta = math.radians(19.1 + 0.29 * rake)
    ratio = (1.755 - 0.028 * rake) * thickness ** (0.331 - 0.0082 * rake)
    phi = math.atan(ratio * math.cos(a) / (1.0 - ratio * math.sin(a)))
    lean = math.hypot(math.cos(phi + beta - a), math.tan(helix) * math.sin(beta))
    size = 613.0 / math.sin(phi) / lean
    expected = (
        size * (math.cos(beta - a) + math.tan(helix) ** 2 * math.sin(beta)),
        size * math.sin(beta - a) / math.cos(helix),
        size * math.tan(helix) * (math.cos(beta - a) - math.sin(beta)),
    )
    given = entry.Ktc_N_per_mm2, entry.Krc_N_per_mm2, entry.Kac_N_per_mm2
    np.testing.assert_allclose(given, expected, rtol=share)


SHORT = ((0, 20), (-10, 10), (-20, 0))


@pytest.mark.parametrize("downhill", [True, False])
@pytest.mark.parametrize("degrees", [3.0, 10.0])
def test_the_volume_of_a_ball_on_a_slope_is_the_analytic_one(tmp_path, degrees, downhill):
    """Its path leaves half a cylinder of its radius, whose axis is tilted: below the axis by √(R² − y²)/cos θ."""
    slope, radius, least = math.tan(math.radians(degrees)), 5.0, 0.5
    ends = [f"X{x} Z{-least - slope * x:.9f}" for x in (-10, 30)][:: 1 if downhill else -1]
    text = gcode(f"G0 {ends[0].split()[0]} Y0 Z10", f"G1 {ends[0].split()[1]} F600", ends[1])
    _, found = forces(tmp_path, text, process(tool(2 * radius, 2, "ball"), SHORT))
    x, y = ((np.arange(4000) + 0.5) / 4000 for _ in range(2))
    x, y = 20.0 * x[:, None], radius * (2.0 * y - 1.0)
    below = np.sqrt(radius**2 - y**2) / math.cos(math.radians(degrees)) - (radius - least - slope * x)
    expected = np.maximum(below, 0.0).mean() * 20.0 * 2.0 * radius
    assert found.removed_volume * 1e9 == pytest.approx(expected, rel=0.005)


@pytest.mark.parametrize("downhill", [True, False])
@pytest.mark.parametrize("degrees", [3.0, 10.0])
def test_the_volume_of_a_ramp_is_the_analytic_one(tmp_path, degrees, downhill):
    """A flat end leaves at each place the depth that its rim reaches √(R² − y²) farther down the ramp."""
    slope, radius, length, least = math.tan(math.radians(degrees)), 5.0, 20.0, 0.5
    ends = [f"X{x} Z{-least - slope * x:.9f}" for x in (-8, 28)][:: 1 if downhill else -1]
    text = gcode(f"G0 {ends[0].split()[0]} Y0 Z10", f"G1 {ends[0].split()[1]} F600", ends[1])
    _, found = forces(tmp_path, text, process(tool(2 * radius, 4), SHORT))
    expected = 2 * radius * length * (least + slope * length / 2) + slope * length * math.pi * radius**2 / 2
    assert found.removed_volume * 1e9 == pytest.approx(expected, rel=0.005)


@pytest.mark.parametrize(
    ("degrees", "width", "least", "largest"), [(20, 0.5, 0.93, 1.03), (20, 1, 0.97, 1.03), (45, 2, 0.96, 1.03)]
)
def test_the_rear_of_an_end_face_on_a_way_down_has_the_force_of_its_segment(tmp_path, degrees, width, least, largest):
    """Down a plane, all of the end face but a segment at its rear is in air: ∫ over it of Ktc h + Kte, … (Altintas).

    A tooth meets the last half of a layer only, so that the force may be a little smaller than that of the segment.
    """
    slope, radius, teeth, per_tooth = math.tan(math.radians(degrees)), 5.0, 3, 0.2 / 3
    x = np.array([-25.0, 25.0])
    corners = [(a, b, c) for a in x for b in (-12.0, 12.0) for c in (-slope * a, -60.0)]
    trimesh.convex.convex_hull(np.array(corners)).export(tmp_path / "plane.stl")
    (z_begin, z_end) = (-slope * (place - radius + width) for place in (-12.0, 12.0))
    text = gcode("G0 X-12 Y0 Z60", f"G0 Z{z_begin:.6f}", f"G1 X12 Z{z_end:.6f} F1200")
    program, found = forces(tmp_path, text, process(tool(2 * radius, teeth), SHORT), stock=tmp_path / "plane.stl")
    number = 2000
    angle, rings = ((np.arange(number) + 0.5) * size / number for size in (2.0 * math.pi, radius))
    # length of edge in the segment at each angle from the feed, counted against the turn of the spindle
    length = (rings[:, None] * np.cos(angle) < width - radius).sum(axis=0) * radius / number
    down = math.sin(math.radians(degrees))
    tangential, radial, axial = (AL7075[k] * per_tooth * down + AL7075[k + 1] * down for k in (0, 2, 4))
    expected = teeth / number * np.array([
        length @ (axial * np.cos(angle) - tangential * np.sin(angle)),
        length @ (axial * np.sin(angle) + tangential * np.cos(angle)),
        length.sum() * radial,
    ])  # fmt: skip
    wrench = on_line(program, found, line_of(text, f"G1 X12 Z{z_end:.6f} F1200"), 0.5)
    direction = expected / np.linalg.norm(expected)
    assert least <= wrench[:3] @ direction / np.linalg.norm(expected) <= largest
    assert np.linalg.norm(wrench[:3] - (wrench[:3] @ direction) * direction) < 0.03 * np.linalg.norm(expected)


def test_a_slot_cut_through_leaves_two_closed_parts(tmp_path):
    text = gcode("G0 X-10 Y0 Z5", "G1 Z-21 F2400", "X110")
    _, found = forces(tmp_path, text, process(tool(10, 4), BOX, 0.5))
    vertices, faces, _ = found.mesh()
    mesh = trimesh.Trimesh(vertices * 1e3, faces)
    assert mesh.is_watertight
    assert len(mesh.split()) == 2
    assert mesh.volume == pytest.approx(100 * 70 * 20, rel=2e-3)


@pytest.mark.parametrize("place", [(140.0, 90.0, 60.0), (-160.0, -130.0, -80.0)])
@pytest.mark.parametrize("shape", ["flat", "ball"])
def test_forces_do_not_depend_on_where_the_part_is(tmp_path, place, shape):
    wrenches = []
    for x, y, z in ((0.0, 0.0, 0.0), place):
        text = gcode(
            f"G0 X{x - 10} Y{y} Z{z + 5}", f"G1 Z{z - 2} F1200", f"X{x + 20} Y{y + 7}", f"X{x + 40} Y{y - 5} Z{z - 3}"
        )
        box = ((x, x + 60), (y - 30, y + 30), (z - 20, z))
        _, found = forces(tmp_path, text, process(tool(10, 3, shape), box, 0.5))
        wrenches.append((found.cuts.t, found.cuts.wrench))
    np.testing.assert_allclose(wrenches[1][0], wrenches[0][0], atol=1e-9)
    size = np.abs(wrenches[0][1][:, :3]).max()
    assert size > 50.0
    np.testing.assert_allclose(wrenches[1][1][:, :3], wrenches[0][1][:, :3], atol=2e-3 * size)
