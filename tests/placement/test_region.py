"""`postproc place`: the best place against brute force, and what it says of places against an arm of another code."""

from __future__ import annotations

import csv
import json
import tomllib
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction, robot
from postproc.cell import Box, Collision, ExternalAxis, Frame, HolderTable, ObstacleTable
from postproc.errors import InputError
from postproc.jobs.place_files import region_of
from postproc.placement import LeastMargins, PathSamples, region
from postproc.placement.region import Region
from postproc.under_load import RobotInCell
from tests.commands import invoke, run
from tests.corrections import read_files
from tests.kr270 import CELL_TEXT
from tests.oracle.arm import Arm, abc
from tests.placement.setting import cell, read_with_robot
from tests.places import CELL_FILE

PART = """G21 G90
(FORCE FX=-110 FY=-190 FZ=130 FRAME=BASE)
G0 X0 Y-100 Z60
G1 Z0 F600
G1 X200 F2000
G1 Y100
G1 X0
G1 Y-100
G0 Z60
"""


def programs(own, text=PART, **options):
    program, model = read_with_robot(text, own)
    samples = PathSamples.of(program, RobotInCell.of(model, own), None)
    return region.Programs([samples], LeastMargins(joint=np.radians(5.0)), **options), program, model


def in_line(name="kuka_kr270", base=(1400.0, 0.0, 600.0)):
    """A cell with its spindle along the flange axis."""
    own = cell(name, base=base, tool=(0.0, 350.0))
    return replace(own, tool=replace(own.tool, axis="+Z"), gcode=replace(own.gcode, redundancy_deg=180.0))


def test_the_best_place_is_within_two_percent_of_a_brute_force_grid():
    """Of an ABB robot: without steps from the best places of grid and slice it would not be."""
    judged, _, _ = programs(in_line("abb_irb6700_200_260"))
    bounds = Region((700.0, -400.0, 600.0, -30.0, 0.0), (2600.0, 400.0, 600.0, 30.0, 0.0))
    found = region.search(judged, bounds)
    sides = [np.linspace(bounds.low[k], bounds.high[k], {0: 9, 1: 5, 2: 1, 3: 3}[k]) for k in range(4)]
    grid = [judged.judge(np.array([*place, 0.0])) for place in product(*sides)]
    assert any(not place.reachable for place in grid)
    assert found.best.cost <= 1.02 * min(place.cost for place in grid)


@pytest.mark.parametrize("name", ["kuka_kr270", "abb_irb6700_200_260"])
def test_a_place_has_the_margin_and_the_deflection_that_an_arm_of_another_code_finds_there(name):
    own = in_line(name)
    judged, _, _ = programs(own)
    place = np.array([1350.0, 150.0, 550.0, 20.0, 0.0])
    found = judged.judge(place, all_samples=True)
    arm = Arm.load(robot.find(name))
    base, tool = abc(*place[:4]), abc(0.0, 0.0, 350.0)
    samples = judged.samples[0]
    model = robot.load(robot.find(name))
    q = np.radians(own.start.joints)
    deflections, margins = [], []
    for k in range(len(samples)):
        q = arm.inverse(base @ samples.sample.pose[k], tool, q)
        margins.append(np.minimum(q - model.lower, model.upper - q).min())
        if samples.is_at_feed[k] and k % 7 == 0:
            wrench = samples.forces.at(samples.sample.take(np.array([k])))[0]
            turned = np.concatenate([base[:3, :3] @ wrench[:3], base[:3, :3] @ wrench[3:]])
            tip = arm.loaded_tcp(q, tool, turned)
            deflections.append(np.linalg.norm(tip[:3, 3] - (base @ samples.sample.pose[k])[:3, 3]))
    assert found.margin == pytest.approx(min(margins), abs=1e-6)
    assert found.deflection == pytest.approx(max(deflections), rel=0.02)


def test_a_place_is_judged_as_a_program_that_is_converted_there():
    own = in_line()
    judged, _, _ = programs(own)
    place = np.array([1250.0, 200.0, 650.0, -15.0, 0.0])
    found = judged.judge(place, all_samples=True)
    there = replace(own, base=Frame(X=1250.0, Y=200.0, Z=650.0, A=-15.0))
    program, model = read_with_robot(PART, there)
    result = correction.process(program, model, there, mode="nominal")
    cuts = ~result.rapid
    assert found.margin == pytest.approx(result.joint_margin.min(), abs=2e-3)
    assert found.u95 == pytest.approx(result.bound[cuts].max(), rel=0.03)
    assert found.deflection == pytest.approx(result.before[cuts].max(), rel=0.03)


def test_a_program_that_moves_the_axis_that_carries_the_robot_is_judged_as_it_is_converted():
    """E1 carries the robot along the cut: A1 hardly turns, while it turns by 8° if E1 stays."""
    text = (
        "DEF part()\n$VEL.CP=0.05\nPTP {{A1 0,A2 -90,A3 110,A4 0,A5 60,A6 0,E1 0}}\n"
        "LIN {{X 0,Y 0,Z 60,A 0,B 0,C 180,E1 0}}\nLIN {{X 0,Y 200,Z 0,A 0,B 0,C 180,E1 {0}}}\nEND\n"
    )
    own = replace(in_line(), external_axes={"E1": ExternalAxis(direction=(0.0, 2.0, 0.0))})
    margins = []
    for e1 in (0, 200):
        program, model = read_with_robot(text.format(e1), own, "krl")
        samples = PathSamples.of(program, RobotInCell.of(model, own), None)
        found = region.Programs([samples], LeastMargins()).judge(
            np.array([1400.0, 0.0, 600.0, 0.0, 0.0]), all_samples=True
        )
        result = correction.process(program, model, own, mode="predict")
        assert found.margin == pytest.approx(result.joint_margin.min(), abs=2e-3)
        margins.append(found.margin)
    assert abs(margins[1] - margins[0]) > 0.01


def test_places_out_of_reach_and_next_to_limits_are_refused_with_their_reason():
    judged, _, _ = programs(in_line())
    assert region.drive.REASONS[judged.judge(np.array([3200.0, 0.0, 600.0, 0.0, 0.0])).reason] == "out of reach"
    near = judged.judge(np.array([600.0, 0.0, 600.0, 0.0, 0.0]))
    assert region.drive.REASONS[near.reason] in ("joint limit", "singular pose")
    assert np.isnan(near.u95)


POST = ObstacleTable(name="post", frame="root", box=Box((1150, 1250), (-60, 60), (0, 900)))
VICE = ObstacleTable(name="vice", box=Box((-60, -20), (-150, 150), (-50, 200)))


def with_bodies(own, *obstacles):
    held = [HolderTable(diameter_mm=20, length_mm=60), HolderTable(diameter_mm=120, length_mm=250)]
    return replace(own, collision=Collision(holder=held, obstacles=list(obstacles)))


@pytest.mark.parametrize("obstacle", [POST, VICE], ids=["in the cell", "on the part"])
def test_a_place_is_refused_for_a_collision_where_convert_refuses_it(obstacle):
    own = with_bodies(in_line(), obstacle)
    seen = set()
    for need, places in ((5.0, [(1300.0, -250.0), (1100.0, 0.0)]), (40.0, [(1500.0, 60.0)])):
        judged, _, _ = programs(own, clearance_mm=need)
        for x, y in places:
            place = np.array([x, y, 650.0, 20.0, 0.0])
            table = replace(own.collision, clearance_mm=need)
            there = replace(own, collision=table, base=Frame(X=x, Y=y, Z=650.0, A=20.0))
            program, model = read_with_robot(PART, there)
            result = correction.process(program, model, there, mode="nominal")
            found = region.drive.REASONS[judged.judge(place, all_samples=True).reason]
            assert (found == "collision") == any(issue.kind == "collision" for issue in result.issues), (x, y, need)
            seen.add(found)
    assert "collision" in seen
    assert obstacle is VICE or "free" in seen


def test_an_axis_that_carries_the_robot_moves_it_by_what_stands_in_the_cell():
    own = replace(with_bodies(in_line(), POST), external_axes={"E1": ExternalAxis(direction=(0.0, 2.0, 0.0))})
    beside = replace(POST, box=Box((1150, 1250), (-360, -240), (0, 900)))
    judged = programs(own, clearance_mm=20.0)[0]
    other = programs(with_bodies(in_line(), beside), clearance_mm=20.0)[0]
    reasons = set()
    for y in (0.0, 300.0, 450.0):
        carried = judged.judge(np.array([1250.0, y, 650.0, 0.0, 300.0]), all_samples=True)
        moved = other.judge(np.array([1250.0, y - 300.0, 650.0, 0.0, 0.0]), all_samples=True)
        assert carried.reason == moved.reason
        reasons.add(region.drive.REASONS[carried.reason])
    assert reasons == {"free", "collision"}


def test_an_axis_that_carries_the_robot_is_as_moving_the_part_the_other_way():
    own = replace(in_line(), external_axes={"E1": ExternalAxis(direction=(0.0, 2.0, 0.0))})
    judged, _, _ = programs(own)
    carried = judged.judge(np.array([1400.0, 0.0, 600.0, 0.0, 300.0]))
    moved = judged.judge(np.array([1400.0, -300.0, 600.0, 0.0, 0.0]))
    assert carried.cost == pytest.approx(moved.cost, rel=1e-9)
    assert carried.deflection == pytest.approx(moved.deflection, rel=1e-6)
    assert carried.margin == pytest.approx(moved.margin, rel=1e-9)


def test_the_part_stays_where_it_is_unless_another_place_saves_two_percent():
    """At the best place as today's, the part stays; in a region without today's place, the best one is taken."""
    bounds = Region((900.0, 0.0, 600.0, 0.0, 0.0), (1700.0, 0.0, 600.0, 0.0, 0.0))
    judged, _, _ = programs(in_line())
    far = region.search(judged, bounds)
    assert far.best.cost < 0.98 * far.today.cost
    x = far.best.place[0]
    near, _, _ = programs(in_line(base=(x + 10.0, 0.0, 600.0)))
    found = region.search(near, bounds)
    assert found.best == found.today
    assert found.today.cost <= 1.02 * far.best.cost
    beyond = region.search(near, Region((x + 11.0, *bounds.low[1:]), bounds.high))
    assert beyond.best.place[0] >= x + 11.0


def test_the_best_place_is_one_that_a_person_sets():
    """Whole millimetres and degrees, though the grid over these bounds has none; what is not free stays."""
    judged, _, _ = programs(in_line())
    bounds = Region((1100.3, -200.7, 600.25, -20.6, 0.0), (1699.6, 200.2, 600.25, 20.3, 0.0))
    place = region.search(judged, bounds).best.place
    assert place[2] == 600.25
    for k in (0, 1, 3):
        assert place[k] == round(place[k]) or place[k] in (bounds.low[k], bounds.high[k])
    assert sum(place[k] == round(place[k]) for k in (0, 1, 3)) >= 2
    np.testing.assert_array_equal(
        bounds.rounded(np.array([1699.9, 0.4, 500.0, -20.9, 3.0])), [1699.6, 0, 600.25, -20.6, 0]
    )


@pytest.fixture
def coarse_slice(monkeypatch):
    """The slice through the best place has 5 by 5 places instead of 15 by 15: a fifth of the time of a search."""
    monkeypatch.setattr(region, "_SLICE_COUNT", 5)


@pytest.mark.usefixtures("coarse_slice")
@pytest.mark.parametrize(
    ("base", "is_on_map"), [((1400.0, 0.0, 600.0), True), ((1400.0, 0.0, 640.0), False), ((2000.0, 0.0, 600.0), False)]
)
def test_a_map_shows_todays_place_only_where_it_is_on_it(tmp_path, base, is_on_map):
    (tmp_path / "part.nc").write_text(PART)
    (tmp_path / "cell.toml").write_text(
        f'robot = "kuka_kr270"\n[base]\nX = {base[0]}\nZ = {base[2]}\n[tool]\nZ = 350\n[start]\n'
        "joints = [0, -90, 110, 0, 60, 0]\n[gcode]\nredundancy_deg = 180\n"
    )
    arguments = [str(tmp_path / "part.nc"), "--cell", str(tmp_path / "cell.toml"), "-o", str(tmp_path / "out")]
    bounds = "X=1200:1500,Y=-100:100,Z=600:600,A=0:0"
    run("place", *arguments, "--region", bounds)
    page = (tmp_path / "out" / "place.html").read_text("utf-8")
    where = f"X {base[0]:g}, Y 0, Z {base[2]:g}, A 0°"
    assert ("Ring: today" in page) == is_on_map
    assert (f"place is not on this map: {where}" in page) == (not is_on_map)
    assert "Dot: the best place, X 1" in page


def test_a_region_keeps_what_it_does_not_name_and_without_one_the_place_may_change_both_ways():
    own = replace(in_line(), base=Frame(X=1000.0, Y=-200.0, Z=700.0, A=30.0))
    assert region_of("X=900:1200, A=-10:10", own) == Region(
        (900.0, -200.0, 700.0, -10.0, 0.0), (1200.0, -200.0, 700.0, 10.0, 0.0)
    )
    assert region_of(None, own) == Region((600.0, -600.0, 500.0, -15.0, 0.0), (1400.0, 200.0, 900.0, 75.0, 0.0))


def test_a_region_that_cannot_be_read_is_refused():
    own = in_line()
    assert region_of("X=1000:1200,A=-10:10", own).free == [0, 3]
    for text in ("X=1200:1000", "Q=1:2", "X=1", "X=a:b", "E1=0:100", "X=1:2,X=3:4"):
        with pytest.raises(InputError):
            region_of(text, own)


def test_a_krl_program_with_a_base_of_its_own_is_refused():
    own = in_line()
    text = "DEF part()\n$BASE={X 900,Y 0,Z 500,A 0,B 0,C 0}\n$VEL.CP=0.05\nPTP {X 0,Y 0,Z 60,A 180,B 0,C 180}\nEND\n"
    model = robot.load(robot.find(own.robot))
    program = read_files({"part.src": text}, own, model)
    with pytest.raises(InputError, match="BASE"):
        region.check_base(program, RobotInCell.of(model, own))


def test_a_krl_program_that_sets_the_numbers_of_the_cell_as_its_base_is_refused(tmp_path, monkeypatch):
    """It would stay where it is when [base] is moved to the place that is found."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cell.toml").write_bytes(CELL_FILE.read_bytes())
    frame = "$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}"
    body = "$VEL.CP=0.05\nPTP {X 0,Y 0,Z 60,A 180,B 0,C 180}\nLIN {X 20}\nEND\n"
    (tmp_path / "own.src").write_text(f"DEF own()\n{frame}\n{body}")
    done = invoke("place", "own.src", "--region", "X=1500:1510", "-o", "out", cell="cell.toml")
    assert (done.exit_code, "$BASE that the program sets itself" in done.output) == (1, True), done.output


NUMBERED = """DEF part()
BAS(#INITMOV,0)
$BASE=BASE_DATA[3]
$TOOL=TOOL_DATA[2]
$VEL.CP=0.05
PTP {X 0,Y 0,Z 60,A 180,B 0,C 180}
;FORCE FX=100 FY=0 FZ=-200
LIN {X 90}
END
"""


@pytest.fixture
def numbered(work_folder, coarse_slice):
    """Folder with a program in BASE_DATA[3], and the text of a cell whose [base_data.3] is its [base]."""
    (work_folder / "part.src").write_text(NUMBERED)
    return CELL_TEXT


def placed(text, program="part.src", code=0):
    """Look for a place with a cell of some text; return what is printed, and place.json."""
    Path("cell.toml").write_text(text)
    done = invoke("place", program, "--region", "X=1300:1600,Y=-300:0", "-o", "out", "--overwrite", cell="cell.toml")
    assert done.exit_code == code, done.output
    return done.output, None if code else json.loads(Path("out/place.json").read_text())


def test_a_frame_by_number_that_is_equal_to_the_base_moves_with_it(numbered):
    """The place is that of the same program in [base]; place.toml has both frames."""
    text, content = placed(numbered)
    assert content["moved_frames"] == ["base_data.3"]
    assert "give BASE_DATA[3] of the controller these numbers too" in text
    toml = tomllib.loads(Path("out/place.toml").read_text())
    assert toml == {"base": toml["base"], "base_data": {"3": toml["base"]}}
    Path("in_base.src").write_text(NUMBERED.replace("$BASE=BASE_DATA[3]\n", "").replace("part()", "in_base()"))
    text, same = placed(numbered, "in_base.src")
    assert "BASE_DATA" not in text
    assert "moved_frames" not in same
    assert set(tomllib.loads(Path("out/place.toml").read_text())) == {"base"}
    for key in ("today", "best", "tried", "reachable"):
        assert content[key] == same[key], key
    assert content["best"]["X"] != content["today"]["X"]


def test_a_frame_that_a_dat_states_too_does_not_move(numbered):
    Path("part.dat").write_text("DEFDAT part\nBASE_DATA[3]={X 1500,Y -200,Z 700,A 0,B 0,C 0}\nENDDAT\n")
    assert "a .dat states a frame by number that is [base] of the cell" in placed(numbered, code=1)[0]


def test_frames_by_number_that_are_others_or_in_config_dat_do_not_move(numbered):
    other = numbered.replace("[base_data.3]", "[base_data.3]\nB = 0.001", 1)
    assert "$BASE that the program sets itself" in placed(other, code=1)[0]
    Path("config.dat").write_text("DEFDAT $CONFIG\nBASE_DATA[3]={X 1500,Y -200,Z 700,A 0,B 0,C 0}\nENDDAT\n")
    assert "(without config_dat)" in placed(f'config_dat = "config.dat"\n{numbered}', code=1)[0]
    Path("part.src").write_text(
        NUMBERED.replace("END\n", "$BASE=BASE_DATA[4]\nLIN {X 80,Y 0,Z 60,A 180,B 0,C 180}\nEND\n")
    )
    both = f"{numbered}\n[base_data.4]\nX = 1500.0\nY = -200.0\nZ = 700.0\n"
    assert placed(both)[1]["moved_frames"] == ["base_data.3", "base_data.4"]
    assert (
        "$BASE that the program sets itself" in placed(both.replace("[base_data.4]", "[base_data.4]\nC = 1"), code=1)[0]
    )


WALL = ObstacleTable(name="wall", frame="root", box=Box((1000, 1200), (-600, -450), (0, 1600)))


def test_a_place_whose_move_from_the_start_collides_is_refused_for_that_where_convert_refuses_it():
    """The arm turns A1 from the start at 0° to the part, and the tool passes through the wall."""
    own = with_bodies(in_line(), WALL)
    reasons = {}
    for y in (-1100.0, 300.0):
        judged, _, _ = programs(own, clearance_mm=5.0)
        place = np.array([900.0, y, 600.0, 0.0, 0.0])
        reasons[y] = [judged.judge(place, all_samples=every).reason for every in (False, True)]
        there = replace(own, base=Frame(X=900.0, Y=y, Z=600.0))
        program, model = read_with_robot(PART, there)
        result = correction.process(program, model, there, mode="nominal")
        assert any("collision" in issue.message for issue in result.issues if issue.level == "error") == (y < 0.0)
    assert reasons == {-1100.0: [region.drive.FIRST_MOVE] * 2, 300.0: [region.drive.FREE] * 2}


def test_after_a_refused_place_its_neighbours_are_skipped_and_the_next_distinct_place_is_converted():
    """Conversions are refused up to X = 1450, where most of the best places are: 6 neighbours are not the end."""
    judged, _, _ = programs(in_line())
    bounds = Region((1100.0, 0.0, 600.0, 0.0, 0.0), (1700.0, 0.0, 600.0, 0.0, 0.0))
    tried = []

    def assess(place, limit=1450.0):
        tried.append(place.place[0])
        return region.Assessment(1e-4, 1e-4, 1e-4, problem="bodies touch" if place.place[0] < limit else "")

    search = region.search(judged, bounds, assess=assess)
    assert search.best is not None
    assert search.best.place[0] >= 1450.0
    refused = [place.place[0] for place in search.refusals]
    assert len(refused) > 1
    assert np.diff(sorted(refused)).min() >= 60.0 - 1.0, "a tenth of the region, and the rounding to whole millimetres"
    search = region.search(judged, bounds, assess=lambda place: assess(place, np.inf))
    assert search.best is None
    assert {place.problem for place in search.refusals} == {"bodies touch"}


def test_a_search_whose_conversions_are_all_refused_does_not_contradict_itself(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "postproc.jobs.place_files._assessment", lambda *_: region.Assessment(problem="part.nc, line 3: bodies touch")
    )
    (tmp_path / "part.nc").write_text(PART)
    command = ("place", tmp_path / "part.nc", "-o", tmp_path / "out", "--region", "X=1400:1500")
    done = run(*command, cell=CELL_FILE, code=1)
    content = json.loads((tmp_path / "out" / "place.json").read_text("utf-8"))
    assert "No place in the region can be driven" not in done.output
    assert "part.nc, line 3: bodies touch" in content["sentence"]
    assert content["refused_later"] == {"part.nc, line 3: bodies touch": sum(content["refused_later"].values())}
    assert f"{content['reachable']} can be driven by samples of the path" in done.output


def test_a_search_without_a_result_removes_the_place_of_an_earlier_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "part.nc").write_text(PART)
    (tmp_path / "cell.toml").write_bytes(CELL_FILE.read_bytes())
    command = ("place", "part.nc", "-o", "out", "--region")
    run(*command, "X=1400:1410", cell="cell.toml")
    assert (tmp_path / "out" / "place.toml").is_file()
    run(*command, "X=5000:5010", cell="cell.toml", code=1)
    assert not (tmp_path / "out" / "place.toml").exists()
    (tmp_path / "out" / "place.toml").write_text("# of somebody else\n")
    run(*command, "X=5000:5010", "--overwrite", cell="cell.toml", code=1)
    assert (tmp_path / "out" / "place.toml").read_text() == "# of somebody else\n"
    (tmp_path / "out" / "place.toml").unlink()
    run(*command, "X=1400:1410", cell="cell.toml")
    assert (tmp_path / "out" / "place.toml").is_file()


def test_the_command_writes_map_table_and_base(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cell_kr270.toml").write_bytes(CELL_FILE.read_bytes())
    (tmp_path / "part.nc").write_text(PART)
    command = "place part.nc --cell cell_kr270.toml --region X=1200:1800,A=-20:20 -o out"
    done = run(*command.split())
    content = json.loads((tmp_path / "out" / "place.json").read_text("utf-8"))
    rows = list(csv.DictReader((tmp_path / "out" / "place.csv").read_text().splitlines()))
    assert content["grid"] == "place.csv"
    assert len(rows) == content["tried"]
    assert {row["reachable"] for row in rows} <= {"0", "1"}
    best = content["best"]
    assert best["reachable"]
    least = min(float(row["u95_mm"]) for row in rows if row["reachable"] == "1")
    assert best["corrected_mm"] <= 1.1 * least, "a conversion adds what samples leave out, such as rounded corners"
    collisions = "Collisions do not count in this choice: the cell has no [collision]"
    assert content["clearance_mm"] is None
    assert collisions in (tmp_path / "out" / "place.html").read_text("utf-8")
    base = (tmp_path / "out" / "place.toml").read_text("utf-8")
    assert f"X = {best['X']:.4f}" in base
    assert collisions in done.output
    again = invoke(*command.split())
    assert again.exit_code == 0


def test_the_command_keeps_a_clearance_and_asks_for_bodies_if_there_are_none(tmp_path):
    (tmp_path / "part.nc").write_text(PART)
    (tmp_path / "bare.toml").write_text(CELL_TEXT)
    box = "[[collision.obstacles]]\nname = 'vice'\nbox = { X = [-80, -40], Y = [-150, 150], Z = [-50, 200] }\n"
    (tmp_path / "cell.toml").write_text(
        f"{CELL_TEXT}\n[collision]\nholder = [ {{ diameter_mm = 20, length_mm = 90 }} ]\n{box}"
    )
    command = ["place", str(tmp_path / "part.nc"), "--region", "X=1400:1450", "-o", str(tmp_path / "out")]
    done = invoke(*command, "--clearance-mm", "10", cell=tmp_path / "bare.toml")
    assert done.exit_code == 1
    assert "the cell has no [collision]" in done.output
    for need, code in (("10", 0), ("45", 1)):
        done = run(*command, "--clearance-mm", need, cell=tmp_path / "cell.toml", code=code)
        assert f"{need} mm between bodies of [collision]" in done.output
        assert "Stock is not among these bodies: convert checks it, with --process." in done.output
        content = json.loads((tmp_path / "out" / "place.json").read_text("utf-8"))
        assert content["clearance_mm"] == float(need)
        assert content["refused"].get("collision", 0) == (0 if code == 0 else content["tried"])
        assert f"closer than {need} mm" in (tmp_path / "out" / "place.html").read_text("utf-8")


@pytest.mark.parametrize(("stated", "turned"), [(180.0, True), (0.0, False)])
def test_the_command_prints_the_turn_of_the_tool_and_keeps_that_of_the_cell_if_no_other_saves_enough(
    tmp_path, stated, turned
):
    """The spindle is across the flange: with a turn of 180° the flange is on the far side of the part."""
    (tmp_path / "part.nc").write_text(PART)
    (tmp_path / "cell.toml").write_text(
        f'robot = "kuka_kr270"\n[base]\nX = 1400\nZ = 600\n[tool]\nX = 350\nZ = 200\naxis = "+X"\n[start]\n'
        f'joints = [0, -90, 110, 0, 60, 0]\n[gcode]\nredundancy = "best"\nredundancy_deg = {stated}\n'
    )
    command = ["place", str(tmp_path / "part.nc"), "--region", "X=1400:1410", "-o", str(tmp_path / "out")]
    done = run(*command, cell=tmp_path / "cell.toml")
    turn = json.loads((tmp_path / "out" / "place.json").read_text("utf-8"))["best"]["turn_deg"]
    assert (turn != 0.0) == turned
    (line,) = [line for line in done.output.splitlines() if line.startswith("  best: ")]
    page = (tmp_path / "out" / "place.html").read_text("utf-8")
    for text, before in ((line, ", "), (page, "; ")):
        assert (f"{before}tool turned by {turn:+.0f}°" in text) == turned
        assert ("tool turned by" in text) == turned


def test_no_place_in_the_region_is_said_and_is_no_success(tmp_path):
    (tmp_path / "part.nc").write_text(PART)
    (tmp_path / "cell.toml").write_bytes(CELL_FILE.read_bytes())
    arguments = [str(tmp_path / "part.nc"), "--cell", str(tmp_path / "cell.toml"), "-o", str(tmp_path / "out")]
    done = invoke("place", *arguments, "--region", "X=4000:5000,Y=-300:300")
    assert done.exit_code == 1
    assert "No place in the region can be driven" in done.output
    content = json.loads((tmp_path / "out" / "place.json").read_text("utf-8"))
    assert content["best"] is None
    assert content["refused"] == {"out of reach": content["tried"]}
    assert not (tmp_path / "out" / "place.toml").exists()


def test_without_forces_no_error_is_claimed(tmp_path):
    (tmp_path / "part.nc").write_text("G21 G90\nG0 X20 Y20 Z20\nG1 Z-3 F600\nX60\nG0 Z20\n")
    (tmp_path / "cell.toml").write_bytes(CELL_FILE.read_bytes())
    arguments = [str(tmp_path / "part.nc"), "--cell", str(tmp_path / "cell.toml"), "-o", str(tmp_path / "out")]
    run("place", *arguments, "--region", "X=1400:1600")
    sentence = json.loads((tmp_path / "out" / "place.json").read_text("utf-8"))["sentence"]
    assert sentence.startswith("Today's place can be driven. No cutting move carries a force")
    assert "--forces" in sentence
