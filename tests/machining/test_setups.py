"""Set-ups of a program by the directions of its tool, finer cells within them, and what a process file may say."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from postproc.errors import ForceError
from postproc.machining import process, setups
from postproc.machining.setups import Setup
from postproc.machining.tool_path import Directions
from tests.programs import program

WIDEST = np.radians(35.0)


def tilted(*degrees) -> np.ndarray:
    """Directions tilted about Y by angles."""
    angle = np.radians(degrees)
    return np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=1)


def directions(degrees, cuts, turning=(), inner=()) -> Directions:
    """Tilts at the ends of motions; on motions that turn, tilts at four places between."""
    between = np.array([tilted(*row) for row in inner]).reshape(len(turning), 4, 3).transpose(1, 0, 2)
    return Directions(tilted(*degrees), np.array(cuts, dtype=bool), np.array(turning, dtype=np.int64), between)


def divided(along: Directions) -> list[tuple[list[int], float]]:
    """Motions of each set-up, and the tilt of its map [deg]."""
    made = program([("LIN", 10 * k, 0, 0) for k in range(len(along.end))])
    parts = setups.setups(made, along, WIDEST)
    assert np.sum([part.motions for part in parts], axis=0).tolist() == [1] * len(along.end)
    tilts = [float(np.degrees(np.arctan2(part.frame[0, 2], part.frame[2, 2]))) for part in parts]
    return [(np.flatnonzero(part.motions).tolist(), tilt) for part, tilt in zip(parts, tilts, strict=True)]


def test_cuts_in_another_direction_begin_a_set_up_and_rapid_motions_belong_to_the_one_before():
    ((rows, tilt),) = divided(directions([0, 0, 0, 30, 30, 30.4, 10], [0, 1, 0, 0, 1, 1, 1]))
    assert rows == list(range(7))  # the run of cuts that turns is within the cone about the first map
    assert tilt == pytest.approx(0.0)
    found = divided(directions([0, 0, 0, 40, 40, 40.4, 10], [0, 1, 0, 0, 1, 1, 1]))
    assert [rows for rows, _ in found] == [[0, 1, 2, 3], [4, 5, 6]]
    assert found[1][1] == pytest.approx(25.2, abs=0.5)
    apart = divided(directions([0, 0, 0, 30, 30, 0, 0], [0, 1, 0, 0, 1, 0, 1]))
    assert [rows for rows, _ in apart] == [[0, 1, 2, 3], [4, 5], [6]]
    assert [tilt for _, tilt in apart] == pytest.approx([0.0, 30.0, 0.0])


@pytest.mark.parametrize(("tilt", "count"), [(0.49, 1), (0.51, 2)])
def test_half_a_degree_is_the_same_direction(tilt, count):
    assert len(divided(directions([0, 0, tilt], [1, 0, 1]))) == count


def test_a_run_that_turns_too_far_for_one_map_is_divided_where_the_cone_ends():
    """Cuts from 0° to 120° in steps of 10°: eight of them fit into a cone of 70°, halves are tried after all."""
    tilts = list(range(0, 130, 10))
    found = divided(directions(tilts, [1] * len(tilts)))
    for rows, tilt in found:
        assert max(abs(tilts[row] - tilt) for row in rows) < 35.0
    assert len(found) == 2


def test_what_the_tool_does_within_a_motion_counts():
    inside = directions([0, 0], [1, 1], turning=[1], inner=[(10, 20, 10, 0)])
    ((rows, tilt),) = divided(inside)
    assert rows == [0, 1]
    assert tilt == pytest.approx(10.0, abs=0.3)
    far = directions([0, 0], [1, 1], turning=[1], inner=[(40, 75, 40, 0)])
    with pytest.raises(ForceError, match="the tool turns by more than 70° in one cutting move") as refused:
        divided(far)
    assert "part.nc:2" in str(refused.value)
    rapid = directions([0, 0, 0], [1, 0, 1], turning=[1], inner=[(40, 75, 40, 0)])
    assert len(divided(rapid)) == 1


def test_a_program_without_a_cut_is_refused():
    with pytest.raises(ForceError, match="no cutting move in this program"):
        divided(directions([0, 0], [0, 0]))


@pytest.mark.parametrize("seed", range(4))
def test_the_cone_about_directions_is_the_narrowest(seed):
    """Its angle against that by a minimisation from many starts; 60 steps are within some per cent."""
    rng = np.random.default_rng(seed)
    axes = rng.normal([0, 0, 4.0], 0.8, (12, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    along = Directions(axes, np.ones(12, dtype=bool), np.zeros(0, dtype=np.int64), np.zeros((4, 0, 3)))
    middle = setups._cone_axis(program([("LIN", k, 0, 0) for k in range(12)]), along, 0, np.radians(60.0))

    def angle(point):
        unit = np.append(point, 1.0) / np.hypot(1.0, np.hypot(*point))
        return np.arccos((axes @ unit).min())

    starts = [axes[k, :2] / axes[k, 2] for k in range(0, 12, 4)]
    least = min(minimize(angle, start, method="Nelder-Mead", options={"xatol": 1e-7}).fun for start in starts)
    assert least <= np.arccos((axes @ middle).min()) + 1e-9
    assert np.arccos((axes @ middle).min()) <= 1.06 * least
    assert np.linalg.norm(middle) == pytest.approx(1.0)


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.6, 0, 0.8), (0.95, 0.0, np.sqrt(0.0975))])
def test_the_map_has_its_z_along_the_direction_and_square_right_handed_axes(direction):
    frame = setups._frame(np.array(direction, dtype=float))
    np.testing.assert_allclose(frame[:3, 2], direction, atol=1e-12)
    np.testing.assert_allclose(frame[:3, :3].T @ frame[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    assert not frame[:3, 3].any()
    assert direction != (0, 0, 1) or (frame == np.eye(4)).all()


def test_finer_cells_divide_a_set_up_from_their_first_motion_on_but_for_parts_without_a_cut():
    motions = np.arange(12)
    first, second = Setup(np.eye(4), motions < 6), Setup(2 * np.eye(4), motions >= 6)
    cuts = np.array([0, 1, 1, 0, 0, 1, 0, 0, 0, 1, 1, 1], dtype=bool)
    parts = setups.divide_by_cells([first, second], {3: 2, 8: 3, 10: 2}, cuts)
    assert [(np.flatnonzero(part.motions).tolist(), part.factor) for part in parts] == [
        ([0, 1, 2], 1), ([3, 4, 5], 2), ([6, 7, 8, 9], 3), ([10, 11], 3),
    ]  # fmt: skip
    assert [part.frame[0, 0] for part in parts] == [1.0, 1.0, 2.0, 2.0]
    (whole,) = setups.divide_by_cells([first], {}, cuts)
    assert (np.flatnonzero(whole.motions).tolist(), whole.factor) == ([0, 1, 2, 3, 4, 5], 1)


TOOLS = {
    "flat": ("diameter_mm = 10\nflutes = 3", (0.005, 0.0, 3, False)),
    "ball": ('shape = "ball"\ndiameter_mm = 8\nflutes = 2', (0.004, 0.004, 2, False)),
    "bull": ('shape = "bull"\ndiameter_mm = 12\nflutes = 4\ncorner_radius_mm = 1.5', (0.006, 0.0015, 4, False)),
    "whole": ('shape = "bull"\ndiameter_mm = 12\nflutes = 4\ncorner_radius_mm = 6', (0.006, 0.006, 4, False)),
    "drill": ('shape = "drill"\ndiameter_mm = 6\nflutes = 2', (0.003, 0.0, 2, True)),
}


def loaded(folder, text: str, **options):
    (folder / "process.toml").write_text(text)
    return process.load(folder / "process.toml", **options)


@pytest.mark.parametrize("name", TOOLS)
def test_a_tool_of_a_process_is_a_cutter_in_metres(tmp_path, name):
    table, expected = TOOLS[name]
    cutter = loaded(tmp_path, f"[tools.1]\n{table}", tools_only=True).cutter("1")
    assert (cutter.radius, cutter.corner, cutter.teeth, cutter.drill) == pytest.approx(expected)


def test_a_tool_is_that_of_its_number_else_the_default_else_the_only_one():
    table = process.ToolTable(diameter_mm=10.0, flutes=2)
    one, default = process.Process(tools={"1": table}), process.Process(tools={"1": table, "default": table})
    assert one.tool("1") == one.tool(None) == ("1", table)
    assert one.tool("2") is None
    assert default.tool("1")[0] == "1"
    assert default.tool("2")[0] == default.tool(None)[0] == "default"
    assert process.Process(tools={"tMill": table}).tool("TMILL")[0] == "tMill"
    assert process.Process(tools={"1": table, "2": table}).tool(None) is None


TABLE = "diameter_mm = 10\nflutes = 2"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"[tools.1x]\n{TABLE}", "'1x' is not a tool number"),
        (f"[tools.-1]\n{TABLE}", "'-1' is not a tool number"),
        (f'[tools.1]\n{TABLE}\nshape = "bull"', "a bull tool without a corner radius that fits"),
        (f'[tools.1]\n{TABLE}\nshape = "bull"\ncorner_radius_mm = 5.01', "a bull tool without a corner radius that"),
        (f"[tools.1]\n{TABLE}\ncorner_radius_mm = 1", "corner_radius_mm with shape 'flat'"),
        ("[stock]\nbox = { X = [0, 0], Y = [0, 1], Z = [0, 1] }", "box X: .* is not from smaller to larger"),
        ("[stock]\nbox = { X = [0, 1], Y = [0, 1], Z = [1, 0] }", "box Z: .* is not from smaller to larger"),
        (f"[tools.1]\n{TABLE}", r"neither \[material\] nor \[operations\]"),
    ],
)
def test_a_process_that_cannot_be_is_refused(tmp_path, text, message):
    with pytest.raises(ForceError, match=message):
        loaded(tmp_path, text)


def test_a_box_of_stock_is_in_metres_and_its_cells_are_a_quarter_of_a_millimetre(tmp_path):
    made = loaded(tmp_path, "[stock]\nbox = { X = [1, 2], Y = [3, 4], Z = [5, 6] }\n[operations.1]\nFx = 1.0")
    low, high = process.box_corners(made.stock.box)
    np.testing.assert_allclose([low, high], [[1e-3, 3e-3, 5e-3], [2e-3, 4e-3, 6e-3]])
    assert made.stock.cell == pytest.approx(0.25e-3)
    assert loaded(tmp_path, "[stock]\nresolution_mm = 0.1\n[operations.1]\nFx = 1.0").stock.cell == pytest.approx(1e-4)
    with pytest.raises(ForceError, match=r"no \[material\]"):
        made.law()
