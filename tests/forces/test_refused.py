"""What forces cannot be used for, and which places lie just behind a step."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import forces, toolpath
from postproc.errors import MAX_ERRORS, ForceError, ProgramError
from postproc.forces import Knots
from postproc.poses import Poses
from postproc.program import SPL
from tests.programs import program

MOVES = [("PTP", 0, 0, 10), ("LIN", 40, 0, 10), ("LIN", 40, 0, 0), ("LIN", 0, 0, 0), ("LIN", 0, 30, 0)]
BASE, FEED = 0, 2


class Given:
    name = "given"

    def __init__(self, knots):
        self.knots = knots

    def along(self, _program, _path):
        return self.knots


def put_on(made, knots):
    return forces.assign(made, toolpath.segments(made, np.eye(4)), Given(knots), "+Z", 1e-3)


def whole(motion, wrench, frame, sigma=(0.0,) * 6):
    n = len(motion)
    return Knots.throughout(
        np.array(motion), np.tile(np.array(wrench, float), (n, 1)), np.full(n, frame), np.tile(sigma, (n, 1))
    )


def test_places_behind_a_step_lie_within_one_and_a_half_times_its_length():
    made = program(MOVES)
    knots = Knots.along(np.array([1, 1, 4, 4]), np.array([0.0, 1.0] * 2), np.ones((4, 6)), np.zeros(4, dtype=int))
    load = put_on(made, knots.with_fallback(whole([2, 3], [5.0] * 6, BASE)))
    length = load.axes.path.length
    motion = np.array([1, 1, 4, 4, 3])
    t = np.array([1.4e-5, 1.6e-5, 1.4e-5, 1.6e-5, 1.4e-5]) / length[motion]
    assert load.is_behind_step(motion, t).tolist() == [True, False, True, False, False]


@pytest.mark.parametrize("count", [1, 3, MAX_ERRORS + 4])
def test_moves_along_the_spindle_and_from_the_start_name_their_lines(count):
    rows = list(range(1, count + 1))
    made = program([("LIN", 0, 0, 10.0 - k) for k in range(count + 1)])
    made = replace(made, motions=replace(made.motions, rapid=np.arange(count + 1) == 0))
    drill = put_on(made, whole(rows, [0.0, 0, 5, 0, 0, 1], FEED))
    assert (drill.frame[1:] == FEED).all()
    start = replace(made, unforced=np.arange(count + 1), motions=replace(made.motions, line=made.motions.line + 4))
    x, y = 1e3 * (np.array([0.0, 0.0]) - [1.5, -0.2])  # under the tool at [start]: the first move is along it too
    target = made.motions.target[:]
    target[:, :2, 3] = np.array([x, y]) / 1e3
    plunge = replace(made, motions=replace(made.motions, target=Poses.of(target)))
    for refused, frame, words, first in (
        (plunge, FEED, "on a move along the spindle", 2), (start, BASE, r"on a move from \[start\]", 6),
    ):  # fmt: skip
        with pytest.raises(ForceError, match=words) as caught:
            put_on(refused, whole(rows, [1.0, 0, 0, 0, 0, 0], frame))
        assert (caught.value.file, caught.value.line) == ("part.nc", first)
        assert [each.line for each in caught.value.further_errors] == [
            row + first - 1 for row in rows[1 : MAX_ERRORS + 1]
        ]


@pytest.mark.parametrize("count", [1, 3, MAX_ERRORS + 4])
def test_feed_forces_on_splines_name_their_lines(count):
    made = program([("PTP", 0, 0, 10), *[("LIN", 10.0 * k, 0, 10) for k in range(1, count + 1)]])
    made = replace(made, motions=replace(made.motions, kind=np.array([2] + [SPL] * count)))
    rows = list(range(1, count + 1))
    with pytest.raises(ForceError, match="a piece of a spline") as caught:
        put_on(made, whole(rows, [1.0, 0, 0, 0, 0, 0], FEED))
    assert (caught.value.file, caught.value.line) == ("part.nc", 2)
    assert [each.line for each in caught.value.further_errors] == [row + 1 for row in rows[1 : MAX_ERRORS + 1]]
    put_on(made, whole(rows, [1.0, 0, 0, 0, 0, 0], BASE))
    put_on(made, whole(rows, [0.0] * 6, FEED))


@pytest.mark.parametrize("column", range(6))
@pytest.mark.parametrize("of", ["wrench", "sigma"])
def test_only_what_acts_across_the_spindle_needs_a_direction_of_travel(column, of):
    """The third move is a plunge; the force, or its deviation, has one component."""
    acts = np.eye(6)[column] * 4.0
    knots = whole([2], acts if of == "wrench" else np.zeros(6), FEED, acts if of == "sigma" else np.zeros(6))
    told = [issue for issue in put_on(program(MOVES), knots).issues if issue.kind == "feed-direction"]
    assert [(issue.source_line, issue.count) for issue in told] == ([] if column in (2, 5) else [(3, 1)])


@pytest.mark.parametrize("motion", [0, 1])
def test_a_place_outside_a_motion_names_its_line(motion):
    knots = Knots.along(np.array([motion]), np.array([1.5]), np.ones((1, 6)), np.zeros(1, dtype=int))
    with pytest.raises(ForceError, match="outside a motion") as caught:
        put_on(program(MOVES), knots)
    assert caught.value.line == motion + 1


@pytest.mark.parametrize("value", [1e6, 1.0001e6])
@pytest.mark.parametrize("of", ["wrench", "sigma"])
def test_the_largest_force_is_a_million_newtons(value, of):
    knots = replace(whole([1], np.ones(6), BASE), **{of: np.full((1, 6), value)})
    if value <= 1e6:
        put_on(program(MOVES), knots)
    else:
        with pytest.raises(ForceError, match="that is not finite"):
            put_on(program(MOVES), knots)


@pytest.mark.parametrize(
    ("rows", "refused"),
    [("3,5,1", True), ("2,3,1", True), ("3,3,1", True), ("2,5,0", False), ("4,5,1", False), ("1,2,1", False)],
)
def test_a_force_on_a_call_that_is_not_followed_is_refused(tmp_path, rows, refused):
    call = SimpleNamespace(line=3, error=ProgramError("a routine that cuts is not followed", file="part.nc", line=3))
    made = replace(program(MOVES), unfollowed=(call,))
    first, last, force = rows.split(",")
    (tmp_path / "f.csv").write_text(f"line,line_end,Fx,Fy,Fz\n{first},{last},{force},0,0\n")
    table = forces.read(tmp_path / "f.csv")
    path = toolpath.segments(made, np.eye(4))
    if refused:
        with pytest.raises(ProgramError, match="not followed"):
            table.along(made, path)
    else:
        assert len(table.along(made, path)) > 0


def test_as_many_errors_of_a_kind_as_are_shown_and_one_more_are_kept(tmp_path):
    rows = "".join(f"{line},0,0,1e9\n" for line in range(1, MAX_ERRORS + 10))
    (tmp_path / "f.csv").write_text("line,Fx,Fy,Fz\n" + rows)
    with pytest.raises(ForceError) as caught:
        forces.read(tmp_path / "f.csv")
    assert [each.line for each in (caught.value, *caught.value.further_errors)] == list(range(2, MAX_ERRORS + 3))


@pytest.mark.parametrize(
    ("lines", "listed"),
    [
        ([70], ""),
        ([70, 80], ", nor on 80: 2 rows of 4"),
        ([70, 80, 81, 82, 83, 84], ", nor on 80, 81, 82, 83, 84: 6 rows of 8"),
        ([70, 80, 81, 82, 83, 84, 85], ", nor on 80, 81, 82, 83, 84, …: 7 rows of 9"),
    ],
)
def test_rows_that_name_lines_without_a_motion_are_listed(tmp_path, lines, listed):
    rows = "".join(f"{line},1,0,0\n" for line in [2, *lines, 3])
    (tmp_path / "f.csv").write_text("line,Fx,Fy,Fz\n" + rows)
    made = program(MOVES)
    with pytest.raises(ForceError) as caught:
        forces.read(tmp_path / "f.csv").along(made, toolpath.segments(made, np.eye(4)))
    assert caught.value.problem == f"no motion starts on line 70 of part.nc{listed}"
    assert caught.value.line == 3
