"""A work zero that was wrongly touched: the program runs too high or too low over the block, or is tilted against it.

The part is cut by a simulator that shares no code with the package: it cuts into a block of another height.
"""

from __future__ import annotations

import csv
import itertools
import re
from functools import cache

import numpy as np
import pytest

from postproc.errors import MeasurementError, PlanError
from postproc.testpart import features, probing
from postproc.testpart.features import Cutting, Feature, Kind
from postproc.testpart.model import summary
from postproc.testpart.readings import top_plane
from tests.commands import run
from tests.places import SAMPLES
from tests.testpart import trial

BLOCK = ((0, 110), (0, 90), (-30, 0))
SEED, SCALE = 4, 1.1
TOO_HIGH, TOO_LOW, TILTED = (-0.63, 0.0, 0.0), (0.4, 0.0, 0.0), (-0.3, 0.002, -0.001)


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    return trial.part(tmp_path_factory.mktemp("touch_off"), box=BLOCK, count=4)


@pytest.fixture(scope="module")
def tables(part):
    """Probed tables by the top of the block, of one robot."""
    texts = {}

    def table(top):
        if top not in texts:
            rng = np.random.default_rng(SEED)
            texts[top] = trial.probed(part, trial.truth(rng), rng, SCALE, top=top).read_text()
        return texts[top]

    return table


def written(part, text, name="table.csv"):
    path = part.folder / name
    path.write_text(text)
    return path


def changed(text, change):
    """Return a table with deviations changed by `change(feature, deviation)`; None leaves the row out."""
    rows = list(csv.reader(text.splitlines()))
    out = [rows[0]]
    for row in rows[1:]:
        value = change(row[0], float(row[-1]))
        if value is not None:
            out.append([*row[:-1], value if isinstance(value, str) else f"{value:.5f}"])
    return "\n".join(",".join(row) for row in [*out, []])


@cache
def job():
    """Return joint angles, forces and true deflections on other jobs."""
    q, force = trial.jobs(np.random.default_rng(8), 25)
    return q, force, trial.deflections(trial.truth(np.random.default_rng(SEED)), q, SCALE * force)


def job_errors(part, found):
    """Return errors and bounds [m] on other jobs, under the forces as found."""
    q, force, true = job()
    error = np.linalg.norm(trial.predicted(found.robot, q, found.scale * force) - true, axis=1)
    model, law = trial.model(found, part.process, part.folder)
    return error, trial.bound(model, law, q, found.scale * force)


@pytest.mark.parametrize("top", [(0.0, 0.0, 0.0), TOO_HIGH, TILTED])
def test_a_wrong_touch_off_is_measured_and_the_bound_holds(part, tables, top):
    found, left_out = trial.identified(part, written(part, tables(top)))
    data = summary(found, left_out)
    assert not data.verdict.refused, data.verdict.line
    (error,) = data.touch_off
    middle = found.lifts[0].origin * 1e3
    lift = -(top[0] + top[1] * middle[0] + top[2] * middle[1])
    assert abs(error.lift_mm - lift) < 1.3 * error.ci95
    assert error.ci95 < 0.15
    assert any("over the block" in text for text in data.warnings) == (abs(lift) > max(0.1, error.ci95))
    off, bound = job_errors(part, found)
    assert np.mean(off <= bound) >= 0.9


def test_without_the_touch_off_the_bound_would_not_hold(part, tables):
    """The same part with touch-off points that say that all is well: what the fit must not believe."""
    text = changed(tables(TOO_HIGH), lambda name, value: value + 0.63 if name.startswith("T") else value)
    found, _left_out = trial.identified(part, written(part, text))
    off, bound = job_errors(part, found)
    assert np.mean(off <= bound) < 0.5


def identified_by_command(part, text, code, *options):
    process = part.folder / "process.toml"
    given = (
        "--cell",
        SAMPLES / "cell_kr270.toml",
        "--process",
        process,
        "--program",
        part.folder / "testpart.nc",
    )
    output = options or ("-o", part.folder / "my_robot", "--overwrite")
    return run("identify", "part", written(part, text), *given, *output, code=code).output


def test_a_program_that_ran_too_high_is_refused_beyond_half_the_flattest_cut(part, tables):
    depth = min(feature.kind.depth for feature in part.chosen.features)
    output = identified_by_command(part, tables((-0.6e3 * depth, 0.0, 0.0)), 3)
    assert "mm too high over the block at [base], more than half of the flattest cut" in output
    assert "touch off again, and cut and probe a new part" in output


def test_one_groove_does_not_show_a_tilt(tmp_path):
    """Across one groove a tilt looks like the deflection; the program ends after F02, whose readings are empty."""
    demo = SAMPLES / "demo"
    table, program, output = tmp_path / "probed.csv", tmp_path / "testpart.nc", tmp_path / "robot"
    begin, _, remaining_features = (demo / "testpart" / "testpart.nc").read_text().partition("(F03")
    program.write_text(begin + remaining_features[remaining_features.rindex("G0 Z20") :])
    text = (demo / "testpart" / "probed.csv").read_text()
    files = ("--process", demo / "testpart" / "testpart.process.toml", "--program", program, "--overwrite")
    for probed, code in ((("T", "F01"), 3), (("T", "F01", "F02"), 0)):
        rows = changed(
            text, lambda name, v, probed=probed: v if name.startswith(probed) else "" if name < "F03" else None
        )
        table.write_text(rows)
        printed = run("identify", "part", table, "--cell", demo / "cell.toml", *files, "-o", output, code=code).output
        refusal = "NOT TO BE TRUSTED: one feature is too few at [base]: how the program is"
        assert printed.startswith(refusal) == (code == 3)
        assert ("probe more features" in printed) == (code == 3)
        assert "is tilted by" not in printed


def test_a_touch_off_error_that_is_counted_is_printed(part, tables):
    output = identified_by_command(part, tables(TOO_LOW), 0)
    assert output.startswith("the model may be used")
    assert "mm too low over the block at [base]" in output
    lift, ci95 = re.search(r"the program ran (0\.\d+) ± (\S+) mm below its height over the uncut top", output).groups()
    assert float(lift) == pytest.approx(TOO_LOW[0], abs=1.3 * float(ci95))
    page = (part.folder / "my_robot" / "report.html").read_text()
    assert "Program over the block" in page
    assert "mm too low over the block at [base]" in page


def test_a_table_without_touch_off_points_is_refused_with_what_to_do(part, tables):
    """As tables of earlier versions are."""
    text = tables((0.0, 0.0, 0.0))
    for kept, count in ((0, "no"), (2, "2")):
        rows = changed(
            text, lambda name, value, kept=kept: None if name.startswith("T") and int(name[2]) > kept else value
        )
        for options in ((), ("--compare",)):
            output = identified_by_command(part, rows, 1, *options)
            assert f"{count} touch-off points" in output
            assert "the depth of its cuts is not known" in output
            assert "add rows: source_line and t 0" in output
    empty = changed(text, lambda name, value: "" if name.startswith("T") else value)
    assert "no touch-off points" in identified_by_command(part, empty, 1)


def test_three_touch_off_points_are_enough_and_a_warning_says_what_they_lack(part, tables):
    text = changed(tables(TOO_LOW), lambda name, value: None if name == "T02.top" else value)
    output = identified_by_command(part, text, 0)
    assert "three touch-off points at [base] cannot be checked against each other" in output


def test_touch_off_points_on_no_plane_are_named(part, tables):
    text = changed(tables((0.0, 0.0, 0.0)), lambda name, value: value + 0.63 * (name == "T03.top"))
    for options in ((), ("--compare",)):
        output = identified_by_command(part, text, 3, *options)
        assert "the touch-off points T01.top, T02.top, T03.top, T04.top are on no plane" in output
        assert output.startswith("NOT DECIDED" if options else "NOT TO BE TRUSTED")


def test_a_tilt_that_no_block_has_is_refused(part, tables):
    """One of three points is wrong: they are on a plane, but on one that is too far off."""
    wrong = {"T02.top": None, "T03.top": 1.2}
    text = changed(
        tables((0.0, 0.0, 0.0)),
        lambda name, value: value + wrong.get(name, 0.0) if wrong.get(name, 0.0) is not None else None,
    )
    assert "mm/m against the uncut top at [base]: probe the touch-off points again" in identified_by_command(
        part, text, 3
    )


def test_two_exchanged_features_are_named_by_the_command_beside_a_wrong_touch_off(part, tables):
    text = tables(TOO_LOW)
    rows = {row[0]: row for row in csv.reader(text.splitlines()[1:])}
    surfaces = {}
    for name in rows:
        if name.startswith("F"):
            surfaces.setdefault(name.partition(".")[0], []).append(name.partition(".")[2])
    pair = next((a, b) for a in surfaces for b in surfaces if a < b and surfaces[a] == surfaces[b])
    exchanged = {f"{a}.{surface}": f"{b}.{surface}" for surface in surfaces[pair[0]] for a, b in (pair, pair[::-1])}
    text = changed(text, lambda name, value: float(rows[exchanged.get(name, name)][-1]))
    output = identified_by_command(part, text, 3, "--compare")  # without it the verdict is in test_verdicts
    assert f"{pair[0]} and {pair[1]} look exchanged" in output.splitlines()[0]


def test_a_feature_that_contradicts_the_others_is_named_when_models_are_compared(part, tables):
    text = changed(tables((0.0, 0.0, 0.0)), lambda name, value: value + 0.3 * (name == "F01.ref_left"))
    output = identified_by_command(part, text, 3, "--compare")
    assert "F01.ref_left contradicts the other points" in output.splitlines()[0]


def test_touch_off_points_of_another_height_or_normal_are_refused(part, tables):
    rows = tables((0.0, 0.0, 0.0)).splitlines()
    number = next(k for k, row in enumerate(rows) if row.startswith("T01"))
    fields = rows[number].split(",")
    for column, value, message in ((5, "2.0", "is at Z 2, the top of the block"), (7, "1.0", "is no point of the top")):
        wrong = [*fields]
        wrong[column] = value
        if column == 7:
            wrong[6:9] = ["0.0", "1.0", "0.0"]
        text = "\n".join([*rows[:number], ",".join(wrong), *rows[number + 1 :], ""])
        assert message in identified_by_command(part, text, 1)


def test_the_plane_of_the_top_is_that_of_least_squares():
    rng = np.random.default_rng(1)
    point = np.column_stack([rng.uniform(0.0, 0.3, (6, 2)), np.zeros(6)])
    deviation = 1e-4 + 1e-3 * point[:, 0] - 2e-3 * point[:, 1] + 2e-5 * rng.normal(size=6)
    touch_off = probing.TouchOff(tuple(f"T{k}.top" for k in range(6)), point, deviation, np.full(6, -1))
    top = top_plane(touch_off, -1, 5e-6, "x")
    expected, residual, *_ = np.linalg.lstsq(np.column_stack([np.ones(6), point[:, :2]]), deviation, rcond=None)
    places = rng.uniform(0.0, 0.3, (4, 3)) * (1, 1, 0)
    up = np.tile([0.0, 0.0, 1.0], (4, 1))
    np.testing.assert_allclose(
        top.deviation(places, up), np.column_stack([np.ones(4), places[:, :2]]) @ expected, atol=1e-12
    )
    variance = 5e-6**2 + 2e-5**2
    assert top.misfit == pytest.approx(np.sqrt(residual[0] / (3 * variance)))
    on_line = point * (1, 0, 0)
    touch_off = probing.TouchOff(touch_off.name, on_line, deviation, np.full(6, -1))
    with pytest.raises(MeasurementError, match="are on one line"):
        top_plane(touch_off, -1, 5e-6, "x")


def test_a_wall_moves_with_a_tilted_top_as_a_rigid_body_does():
    """Against a rotation matrix of the tilt."""
    touch = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.1, 0.0]])
    tilt = 1e-4 * np.array([3.0, -2.0])
    touch_off = probing.TouchOff(("T1", "T2", "T3"), touch, touch[:, :2] @ tilt, np.full(3, -1))
    top = top_plane(touch_off, -1, 5e-6, "x")
    z = np.array([-tilt[0], -tilt[1], 1.0])
    x = np.cross([0.0, 1.0, 0.0], z / np.linalg.norm(z))
    rotation = np.column_stack([x / np.linalg.norm(x), np.zeros(3), z / np.linalg.norm(z)])
    rotation[:, 1] = np.cross(rotation[:, 2], rotation[:, 0])
    origin = touch.mean(axis=0)
    lifted = np.array([0.0, 0.0, origin[:2] @ tilt])
    rng = np.random.default_rng(2)
    points, normals = rng.uniform(-0.1, 0.1, (5, 3)), rng.normal(size=(5, 3))
    moved = (points - origin) @ rotation.T + origin + lifted - points
    np.testing.assert_allclose(top.deviation(points, normals), np.einsum("ni,ni->n", normals, moved), atol=2e-8)


def test_touch_off_places_are_on_the_uncut_top_far_apart():
    cutting = Cutting(0.01, 6000.0, 0.018, 1, 0.002, 0.0005)
    low, high = np.array([0.0, 0.0, -0.03]), np.array([0.11, 0.09, 0.0])
    for seed in range(10):
        rng = np.random.default_rng(seed)
        row = [
            Feature(Kind(0.003, side), *rng.uniform([0.03, 0.03], [0.08, 0.06]), rng.uniform(0.0, 6.3))
            for side in rng.integers(-1, 2, 4).tolist()
        ]
        places = features.touch_off_places(row, cutting, low, high)
        assert len(places) >= 3
        assert (places[:, 2] == cutting.top).all()
        assert ((places[:, :2] > low[:2] + 4e-3) & (places[:, :2] < high[:2] - 4e-3)).all()
        swept = [swept_by(feature, cutting) for feature in row]
        gap = min(np.linalg.norm(places[:, None, :2] - points, axis=2).min() for points in swept)
        assert gap > 0.5 * cutting.diameter + 3e-3
    full = [Feature(Kind(0.003, 0), x, y, 0.0) for x in np.arange(0.0, 0.12, 0.02) for y in np.arange(0.0, 0.1, 0.01)]
    with pytest.raises(PlanError, match="no room for touch-off points"):
        features.touch_off_places(full, cutting, low, high)


def test_touch_off_points_of_a_long_block_are_near_its_four_corners():
    cutting = Cutting(0.01, 6000.0, 0.018, 1, 0.002, 0.0005)
    low, high = np.array([0.01, -0.04, -0.03]), np.array([0.31, 0.06, 0.0])
    places = features.touch_off_places([Feature(Kind(0.003, 0), 0.16, 0.01, 0.3)], cutting, low, high)
    corners = {(round(x, 6), round(y, 6)) for x, y in places[:, :2].tolist()}
    assert corners == {(0.015, -0.035), (0.015, 0.055), (0.303, -0.035), (0.303, 0.055)}


def swept_by(feature, cutting):
    """Points (n, 2) where the axis of the tool passes, in the plane, with the ends of its moves."""
    ends = np.array([move.end for move in features.passes(feature.kind, cutting)])
    points = np.concatenate([a + np.linspace(0.0, 1.0, 60)[:, None] * (b - a) for a, b in itertools.pairwise(ends)])
    c, s = np.cos(feature.angle), np.sin(feature.angle)
    return np.column_stack(
        [feature.x + c * points[:, 0] - s * points[:, 1], feature.y + s * points[:, 0] + c * points[:, 1]]
    )
