"""Tables of probed points, the surfaces of a deflected tool, the time of a feature, and the prior of a model."""

from __future__ import annotations

import re

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.errors import MeasurementError
from postproc.robot import JointCompliance
from postproc.testpart import cut, features, probing
from postproc.testpart.cut import Surfaces
from postproc.testpart.features import Cutting, Feature, FirstNumbers, Kind, Placement
from postproc.testpart.prior import Prior
from tests.testpart import trial

PROBING_HEADER = "feature,source_line,t,X,Y,Z,nx,ny,nz,deviation_mm,mass_kg"


def row(name, deviation="0.1", normal=(0.6, -0.8, 0.0), mass="", line=12):
    n = ",".join(str(value) for value in normal)
    return f"{name},{line},0.25,10,-20,30,{n},{deviation},{mass}"


def table(*more, count=6):
    return "\n".join([PROBING_HEADER, *(row(f"F{k:02d}.left", 0.1 * k) for k in range(1, count + 1)), *more, ""])


def read_probing(folder, text):
    path = folder / "probing.csv"
    path.write_text(text)
    return probing.read(path)


def test_probed_points_are_the_rows_with_a_deviation_in_metres(tmp_path):
    """Points of the top are kept apart; a weight is that of its row alone."""
    found = read_probing(tmp_path, table(
        row("F07.left", ""), row("W01.gauge", -0.25, (0.0, 0.0, -1.0), 80.5), row("T01.top", 0.03, (0, 0, 1), line=0),
        row("T02.top", "", (0, 0, 1)),
    ))  # fmt: skip
    assert found.name == (*(f"F{k:02d}.left" for k in range(1, 7)), "W01.gauge")
    assert len(found) == 7
    assert found.line.tolist() == [12] * 7
    assert found.t.tolist() == [0.25] * 7
    np.testing.assert_allclose(found.point, [[0.01, -0.02, 0.03]] * 7)
    np.testing.assert_allclose(found.normal, [[0.6, -0.8, 0.0]] * 6 + [[0.0, 0.0, -1.0]])
    np.testing.assert_allclose(found.deviation, [1e-4, 2e-4, 3e-4, 4e-4, 5e-4, 6e-4, -2.5e-4])
    assert found.mass.tolist() == [0.0] * 6 + [80.5]
    assert (found.program, found.base.tolist()) == (("",) * 7, [-1] * 7)
    assert found.row.tolist() == [2, 3, 4, 5, 6, 7, 9]
    assert found.file == str(tmp_path / "probing.csv")
    top = found.touch_off
    assert (top.name, top.base.tolist()) == (("T01.top",), [-1])
    np.testing.assert_allclose((*top.point[0], top.deviation[0]), [0.01, -0.02, 0.03, 3e-5])
    kept = found.take(np.array([5, 1]))
    assert (kept.name, kept.row.tolist(), kept.program) == (("F06.left", "F02.left"), [7, 3], ("", ""))
    assert found.group.tolist() == list(range(7))


@pytest.mark.parametrize(
    ("mass", "is_refused"), [("0", False), ("500", False), ("500.1", True), ("-0.1", True), ("", False)]
)
def test_a_mass_is_that_of_a_weight(tmp_path, mass, is_refused):
    text = table(row("W01.gauge", 0.2, (0, 0, -1), mass))
    if not is_refused:
        assert read_probing(tmp_path, text).mass[-1] == float(mass or 0.0)
        return
    with pytest.raises(MeasurementError, match="mass_kg is not between 0 and 500") as refused:
        read_probing(tmp_path, text)
    assert refused.value.line == 8


@pytest.mark.parametrize(("length", "is_refused"), [(1.0009, False), (1.0011, True), (0.9991, False), (0.9989, True)])
def test_a_normal_has_length_one_to_a_thousandth_and_is_made_exact(tmp_path, length, is_refused):
    """Of rows without a deviation it does not matter."""
    text = table(row("F07.right", "", (9, 9, 9)), row("F08.left", 0.2, (0.0, 0.6 * length, -0.8 * length)))
    if not is_refused:
        np.testing.assert_allclose(read_probing(tmp_path, text).normal[-1], [0.0, 0.6, -0.8], atol=1e-12)
        return
    with pytest.raises(MeasurementError, match="is no unit vector") as refused:
        read_probing(tmp_path, text)
    assert refused.value.line == 9


@pytest.mark.parametrize(
    ("normal", "mass", "is_refused"),
    [
        ((0.0, 0.04, 0.9992), "", False),
        ((0.05, 0.0, 0.99875), "", True),
        ((0, 0, -1), "", True),
        ((0, 0, 1), "5", True),
    ],
)
def test_a_point_of_the_top_is_probed_along_z_without_a_weight(tmp_path, normal, mass, is_refused):
    text = table(row("T01.top", 0.0, (0, 0, 1)), row("T02.top", 0.0, normal, mass))
    if not is_refused:
        assert read_probing(tmp_path, text).touch_off.name == ("T01.top", "T02.top")
        return
    with pytest.raises(MeasurementError, match=r"T02\.top is no point of the top") as refused:
        read_probing(tmp_path, text)
    assert refused.value.line == 9


def test_fewer_than_six_points_are_too_few_and_are_counted_without_the_top(tmp_path):
    more = (row("F06.left", ""), row("F07.left", ""), row("T01.top", 0.0, (0, 0, 1)))
    with pytest.raises(MeasurementError, match="5 of 7 points have a deviation"):
        read_probing(tmp_path, table(*more, count=5))
    assert len(read_probing(tmp_path, table(count=6))) == 6


@pytest.mark.parametrize(("base", "is_refused"), [("2", False), ("-1", False), ("", False), ("1.5", True)])
def test_placements_are_whole_numbers_next_to_their_programs(tmp_path, base, is_refused):
    rows = table().splitlines()
    text = "\n".join([f"{rows[0]},program,base", *(f"{line},testpart_2.nc,{base}" for line in rows[1:]), ""])
    if is_refused:
        with pytest.raises(MeasurementError, match="do not name program and placement"):
            read_probing(tmp_path, text)
        return
    found = read_probing(tmp_path, text)
    assert found.base.tolist() == [int(base or -1)] * 6
    assert found.program == ("testpart_2.nc",) * 6
    one_alone = "\n".join([f"{rows[0]},base", *(f"{line},{base}" for line in rows[1:]), ""])
    with pytest.raises(MeasurementError, match="do not name program and placement"):
        read_probing(tmp_path, one_alone)


def test_a_table_of_probed_points_is_known_by_its_head(tmp_path):
    for text, is_table in ((table(), True), ("line,Fx,Fy\n1,2,3\n", False), ("a\ndeviation_mm\n", False)):
        (tmp_path / "file.csv").write_text(text)
        assert probing.is_probing_table(tmp_path / "file.csv") == is_table
    (tmp_path / "file.csv").write_bytes(b"\xff\xfe\xfa deviation_mm")
    assert not probing.is_probing_table(tmp_path / "file.csv")
    assert not probing.is_probing_table(tmp_path / "missing.csv")


CUTTING = Cutting(0.01, 6000.0, 0.018, 1, -0.002, 0.0005)
GROOVE, DOWN, UP = Kind(3e-3, 0), Kind(3e-3, 1), Kind(2.5e-3, -1)


@pytest.mark.parametrize("mass", [0.0, 75.0])
@pytest.mark.parametrize("placements", [("",), ("", "2")])
def test_the_table_to_fill_in_has_each_point_with_its_place(tmp_path, mass, placements):
    """As it is read after the deviations were filled in."""
    low, high = np.zeros(3), np.array([0.2, 0.15, 0.0])
    hung = features.hanging_places(low, high, CUTTING.top) if mass else None
    touches = np.array([[0.01, 0.02, -0.002], [0.19, 0.02, -0.002], [0.1, 0.14, -0.002]])
    parts = {
        Placement(name): features.program(
            [Feature(DOWN, 0.05, 0.06, 0.3), Feature(GROOVE, 0.12, 0.1, -2.0)], CUTTING, mass, hung, touches=touches
        )
        for name in placements
    }
    text = probing.table(parts).decode()
    head, *rows = text.splitlines()
    names = ["feature", *(["program", "base"] if len(placements) > 1 else []), *PROBING_HEADER.split(",")[1:-1]]
    assert head.split(",") == names + ["mass_kg"] * bool(mass)
    at = names.index("deviation_mm")
    filled = [head] + [
        ",".join(["0.125" if k == at else cell for k, cell in enumerate(line.split(","))]) for line in rows
    ]
    found = read_probing(tmp_path, "\n".join([*filled, ""]))
    tops = 3 * len(placements)
    assert len(found) == len(rows) - tops == sum(len(part.feature) for part in parts.values()) - tops
    assert len(found.touch_off.name) == tops
    first = next(iter(parts.values()))
    cut_rows = [k for k, name in enumerate(first.feature) if not name.endswith(".top")]
    count = len(cut_rows)
    assert found.name[:count] == tuple(first.feature[k] for k in cut_rows)
    np.testing.assert_allclose(found.point[:count], first.point[cut_rows], atol=1e-7)
    np.testing.assert_allclose(found.normal[:count], first.normal[cut_rows], atol=1e-8)
    np.testing.assert_allclose(found.t[:count], first.t[cut_rows], atol=1e-6)
    assert found.line[:count].tolist() == first.line[cut_rows].tolist()
    assert found.mass[:count].tolist() == first.mass[cut_rows].tolist()
    assert set(found.mass[found.mass > 0.0]) == ({mass} if mass else set())
    if len(placements) > 1:
        assert found.base.tolist() == [-1] * count + [2] * count
        assert found.program == ("testpart.nc",) * count + ("testpart_2.nc",) * count


def motions_of(text):
    """Ends [m], rapid or not, and feeds [m/s] of the moves of a program, by the number of their line."""
    place, moves = np.zeros(3), {}
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.startswith(("G0 ", "G1 ")):
            continue
        begin = place.copy()
        for axis, value in re.findall(r"([XYZ])(-?[\d.]+)", line):
            place["XYZ".index(axis)] = 1e-3 * float(value)
        feed = re.search(r"F([\d.]+)", line)
        moves[number] = begin, place.copy(), None if feed is None else float(feed.group(1)) / 60e3
    return moves


@pytest.mark.parametrize("kind", [GROOVE, DOWN, UP])
def test_the_time_of_a_feature_is_that_of_its_moves(kind):
    """By feeds and lengths in the text; rapid moves at 0.1 m/s. The way to its first place does not count."""
    part = features.program([Feature(kind, 0.05, 0.06, 0.4)], CUTTING)
    moves = list(motions_of(part.text).values())[1:-1]  # not the way there, and up at the end
    total = sum(np.linalg.norm(end - begin) / (feed or 0.1) for begin, end, feed in moves)
    assert features.seconds(kind, CUTTING) == pytest.approx(total, rel=1e-3)


@pytest.mark.parametrize("kind", [GROOVE, DOWN, UP])
def test_each_probed_point_is_on_the_surface_that_its_move_leaves(kind):
    """A wall is a radius beside the tool, a floor below it; nothing that is cut later reaches deeper there."""
    angle = 0.7
    part = features.program([Feature(kind, 0.05, 0.06, angle)], CUTTING)
    moves = motions_of(part.text)
    cutting = {number: move for number, move in moves.items() if move[2] is not None}
    up = np.array([0.0, 0.0, 1.0])
    u = np.array([np.cos(angle), np.sin(angle), 0.0])
    for name, line, t, point, normal in zip(part.feature, part.line, part.t, part.point, part.normal, strict=True):
        begin, end, feed = cutting[line]
        assert feed == pytest.approx(CUTTING.feed, rel=1e-4)
        tip = begin + t * (end - begin)
        lever = point - tip
        assert abs(lever @ u) < 1e-6
        if name.endswith("floor"):
            np.testing.assert_allclose(normal, up, atol=1e-12)
            assert abs(lever @ up) < 1e-7
            assert np.linalg.norm(lever) < 0.5 * CUTTING.diameter
        else:
            np.testing.assert_allclose(lever - (lever @ up) * up, -0.5 * CUTTING.diameter * normal, atol=1e-6)
            assert 0.3 * kind.depth < lever @ up < 0.7 * kind.depth
        inside = point + 1e-5 * normal  # in the air that the tool has left, and material behind it
        behind = point - 1e-5 * normal
        assert _is_cut(cutting, inside)
        assert not _is_cut(cutting, behind)


def _is_cut(moves, point):
    """Whether a tool with a flat end passes a point on one of the moves."""
    for begin, end, _ in moves.values():
        steps = begin + np.linspace(0.0, 1.0, 4001)[:, None] * (end - begin)
        is_beside = np.linalg.norm(steps[:, :2] - point[:2], axis=1) < 0.5 * CUTTING.diameter
        if (is_beside & (steps[:, 2] < point[2])).any():
            return True
    return False


def test_the_loaded_half_of_a_feature_is_cut_at_full_width_and_the_other_half_is_trimmed():
    """Two trimming passes: the first takes off the trim, the second a tenth of a millimetre more."""
    assert CUTTING.trims == ((0.0005, 0.0002), (pytest.approx(0.0006), pytest.approx(0.00025)))
    for kind in (GROOVE, DOWN, UP):
        step = 0.004 * kind.side
        points = {probe.name: probe.point for probe in features.probes(kind, CUTTING)}
        assert points["left"][:2] == pytest.approx((-0.008, 0.005 + max(step, 0.0)))
        assert points["right"][:2] == pytest.approx((-0.008, -0.005 + min(step, 0.0)))
        assert points["ref_left"][:2] == pytest.approx((0.008, 0.0056 + max(step, 0.0)))
        assert points["ref_right"][:2] == pytest.approx((0.008, -0.0056 + min(step, 0.0)))
        assert points["floor"][2] == -kind.depth
        assert points["ref_floor"][2] == pytest.approx(-kind.depth - 0.00025)
        assert ("step_floor" in points) == bool(kind.side)
        assert kind.title == {0: "groove", 1: "step, down-milling", -1: "step, up-milling"}[kind.side]
    assert features.half_length(0.01) == pytest.approx(0.016)


def test_weights_hang_over_a_diagonal_of_the_block():
    places = features.hanging_places(np.array([0.1, 0.2, -0.05]), np.array([0.3, 0.6, 0.0]), 0.002)
    np.testing.assert_allclose(places, [[0.12, 0.24, 0.202], [0.2, 0.4, 0.202], [0.28, 0.56, 0.202]])


def test_deviations_are_those_of_a_rigid_tool_that_is_displaced_and_turned():
    """A wall point moves with the tool; of the rim of the end face the lowest point over a place makes its floor."""
    rng = np.random.default_rng(3)
    radius, travel, axis = 5e-3, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    normal = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    lever = np.array([[0.0, radius, 1.5e-3], [0.0, -radius, 1.5e-3], [0.0, 3e-3, 0.0], [0.0, 0.0, 0.0]])
    weight = cut.twist_derivatives(normal, lever, np.tile(axis, (4, 1)), np.tile(travel, (4, 1)), radius)
    none = np.zeros(4)
    where = Surfaces(none.astype(int), none, weight, none.astype(bool), np.zeros((4, 6)), lever)
    for _ in range(10):
        twist = 1e-4 * rng.normal(size=6)
        value, slopes = where.deviation(np.tile(twist, (4, 1)))
        for k in range(2):
            moved = twist[:3] + np.cross(twist[3:], lever[k])
            assert value[k] == pytest.approx(normal[k] @ moved)
        for k, lateral in ((2, 3e-3), (3, 0.0)):
            angles = np.linspace(-np.pi, np.pi, 40001)
            rim = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), 0.0 * angles])
            heights = (twist[:3] + np.cross(twist[3:], rim))[:, 2]
            over = np.abs(rim[:, 1] - lateral) < 1e-6
            assert value[k] == pytest.approx(heights[over].min(), abs=1e-9)
        np.testing.assert_allclose(np.einsum("nk,k->n", slopes, twist), value, atol=1e-15)


def test_weights_turn_with_their_axes():
    rng = np.random.default_rng(5)
    rotation = np.linalg.qr(rng.normal(size=(3, 3, 3)))[0]
    weight, twist = rng.normal(size=(3, 2, 6)), rng.normal(size=6)
    turned = cut.rotated_derivatives(rotation, weight)
    for n in range(3):
        moved = np.concatenate([rotation[n] @ twist[:3], rotation[n] @ twist[3:]])
        np.testing.assert_allclose(turned[n] @ moved, weight[n] @ twist)


PRIOR = Prior.of(trial.RobotInCell.of(trial.ROBOT, trial.CELL).robot, 0.1)


def test_a_prior_has_the_spread_of_the_model_and_of_the_forces():
    size = len(PRIOR.parameters)
    matrix = trial.ROBOT.covariance.matrix
    np.testing.assert_allclose(PRIOR.covariance[:size, :size], matrix)
    np.testing.assert_allclose(PRIOR.sigma, [*np.sqrt(np.diag(matrix)), 0.1])
    assert (PRIOR.covariance[size, :size] == 0.0).all()
    np.testing.assert_allclose(PRIOR.drift, [*(0.3 * PRIOR.values), 0.0])
    wide = PRIOR.widen()
    np.testing.assert_allclose(wide.covariance, PRIOR.covariance + np.diag([*(0.3 * PRIOR.values) ** 2, 0.0]))
    certain = replace(PRIOR, covariance=np.diag([0.0, *np.diag(PRIOR.covariance)[1:]]))
    assert certain.drift[0] == 0.0
    with pytest.raises(MeasurementError, match="does not state how certain its values are"):
        Prior.of(replace(trial.ROBOT, covariance=None), 0.1)


def test_a_changed_robot_has_the_changed_compliances_but_never_less_than_a_fiftieth():
    z = np.zeros(len(PRIOR.parameters))
    z[0], z[1] = 0.4 * PRIOR.values[0], -0.99 * PRIOR.values[1]
    robot = PRIOR.robot_with_change(z)
    for k, parameter in enumerate(PRIOR.parameters):
        if not isinstance(parameter, JointCompliance):
            continue
        factor = {0: 1.4, 1: 0.02}.get(k, 1.0)
        assert robot.value(parameter) == pytest.approx(factor * PRIOR.robot.value(parameter))


def test_the_program_names_to_the_operator_what_is_touched_probed_and_hung():
    touches = np.array([[0.01, 0.02, -0.002], [0.19, 0.02, -0.002], [0.1, 0.1405, -0.002]])
    part = features.program(
        [Feature(DOWN, 0.05, 0.06, 0.3)], CUTTING, 80.0, np.array([[0.02, 0.03, 0.2], [0.1, 0.1, 0.2]]),
        touches=touches, first=FirstNumbers(4, 3, 2), placement_title="[base_data.2]",
    )  # fmt: skip
    lines = part.text.splitlines()
    assert lines[1:6] == [
        "(The block is at [base_data.2])",
        "(Before cutting touch the top of the block with the tool: it is at Z-2 of the base)",
        *(f"({name}: X{x:g} Y{y:g} Z-2, left uncut, to be probed with the features)"
          for name, x, y in (("T02", 10, 20), ("T03", 190, 20), ("T04", 100, 140.5))),
    ]  # fmt: skip
    assert lines[6:9] == ["G21 G90 G17 G94", "T1 M6", "S6000 M3"]
    assert f"(F04: step, down-milling, depth 3 mm, {np.degrees(0.3):g} deg)" in lines
    hung = [k for k, line in enumerate(lines) if line.startswith("(W")]
    assert [lines[k] for k in hung] == [
        f"({name}: set the gauge to 0, hang 80 kg on the tool, read)" for name in ("W03", "W04")
    ]
    assert lines[hung[0] + 1 :] == [
        "G0 Z200.0000", "G0 X20.0000 Y30.0000", "M0", lines[hung[1]], "G0 X100.0000 Y100.0000", "M0", "M30",
    ]  # fmt: skip
    assert lines[hung[0] - 2 : hung[0]] == ["G0 Z18.0000", "M5"]  # four times the clearance above the top
    gauges = [k for k, name in enumerate(part.feature) if name.startswith("W")]
    assert [part.feature[k] for k in gauges] == ["W03.gauge", "W04.gauge"]
    assert [lines[part.line[k] - 1] for k in gauges] == ["G0 X20.0000 Y30.0000", "G0 X100.0000 Y100.0000"]
    assert part.normal[gauges].tolist() == [[0.0, 0.0, -1.0]] * 2
    tops = [k for k, name in enumerate(part.feature) if name.endswith(".top")]
    assert [(part.feature[k], part.line[k], part.t[k]) for k in tops] == [(f"T0{n}.top", 0, 0.0) for n in (2, 3, 4)]
    np.testing.assert_allclose(part.point[tops], touches)
    plain = features.program([], CUTTING)
    assert (plain.features, plain.feature, plain.point.shape) == (0, (), (0, 3))
    assert "touch" not in plain.text.partition("\n")[2]
