"""A plan of measurements as CSV, KRL, JSON, lines, tables and plots, from numbers that are stated here."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.plan import Options
from postproc.plan.criterion import Directions
from postproc.plan.search import Plan
from postproc.report import plan
from tests.kr270 import CELL


class TestPoses(SimpleNamespace):
    """Two test poses."""

    __test__ = False

    def __len__(self):
        return len(self.weight)


Q = np.radians([[10.0, -70.0, 100.0, -0.0, 50.0, 1.0], [20.0, -40.0, 90.0, 30.0, 60.0, 2.0]])
FORCE = np.array([[100.0, -0.0, -800.0], [0.0, 200.0, -700.0]])
TORQUE = np.array([[100.0, -900.0, 30.0, 0.0, -60.0, 5.0], [-250.0, -700.0, 40.0, 0.0, 80.0, 7.0]])
WORK = np.array([[120.0, 130.0], [800.0, 0.0], [50.0, 60.0], [0.0, 20.0], [70.0, 90.0], [1.0, 2.0]])
DIRECTIONS = Directions(np.zeros((6, 2), dtype=int), np.tile([200.0, 50.0], (6, 1)), np.zeros((6, 2)), WORK)
ACCURACY = SimpleNamespace(
    rms=0.0123e-3, interval=(0.009e-3, 0.021e-3), poses=np.array([0.01e-3, 0.0345e-3]),
    parameters=[SimpleNamespace(symbol="k1"), SimpleNamespace(symbol="k2"), SimpleNamespace(symbol="k3")],
    relative_half_widths=np.array([0.05, 0.5, 12.0]),
)  # fmt: skip
RESULT = SimpleNamespace(
    options=Options(seed=7), robot="kuka_kr270", site=SimpleNamespace(rig=SimpleNamespace(force=900.0)),
    tests=TestPoses(weight=np.array([0.2, 0.8]), deflection=np.array([3e-3, 1e-3]), source="part.nc",
                    wrench=np.array([[30.0, 40.0, 0.0, 9.0, 9.0, 9.0], [0.0, 0.0, 70.0, 0.0, 0.0, 0.0]])),
    moment_error=0.0123,
    plan=Plan(Q, np.zeros((2, 2)), np.array([0, 1]), Q[:, 1], 4e-10), force=FORCE, second_load=0.25,
    torque=TORQUE, directions=DIRECTIONS, accuracy=ACCURACY, unobservable=(), initial_accuracy=None, random=np.zeros(0),
    serial=None, sizes=(), seconds=12.5, via=(np.zeros((0, 6)), Q[:1] / 2.0), blocked=np.array([], dtype=int),
    compensator_free=False, warnings=("mind the cable",), interrupted=False,
)  # fmt: skip
RANDOM = np.array([9e-10, 1.6e-9, 3.6e-9])
SERIAL = replace(RESULT.plan, value=2.5e-9)
SIZES = tuple(
    SimpleNamespace(configurations=n, value=value, random=random)
    for n, value, random in ((1, 16e-10, 100e-10), (2, 4e-10, 9e-10), (4, 1e-10, 4e-10))
)


def changed(**changes):
    return SimpleNamespace(**(vars(RESULT) | changes))


def test_the_csv_has_angles_in_degrees_and_the_whole_load():
    assert plan.plan_csv(RESULT).decode().splitlines()[1:] == [
        "1,10.000,-70.000,100.000,0.000,50.000,1.000,100.0,0.0,-800.0",
        "2,20.000,-40.000,90.000,30.000,60.000,2.000,0.0,200.0,-700.0",
    ]


def test_the_program_names_both_loads_ways_around_and_a_way_that_is_blocked():
    """The second load is a share of the first, in its direction."""
    text = plan.krl_program(changed(blocked=np.array([1])), CELL, "measure").text
    lines = text.splitlines()
    assert [line for line in lines if line.startswith((";configuration", ";second load"))] == [
        ";configuration 1: load Fx 100.0 Fy 0.0 Fz -800.0 N, root axes, at the load point",
        ";second load Fx 25.0 Fy 0.0 Fz -200.0 N",
        ";configuration 2: load Fx 0.0 Fy 200.0 Fz -700.0 N, root axes, at the load point",
        ";second load Fx 0.0 Fy 50.0 Fz -175.0 N",
    ]
    motions = [line for line in lines if line.startswith("PTP")]
    assert len(motions) == 5  # the start, two poses, a way around to the second one, the start
    assert motions[0] == motions[-1]
    (around,) = [k for k, line in enumerate(motions) if line.endswith(";on the way, the straight one is blocked")]
    assert around == 2
    assert "A1 5.000,A2 -35.000,A3 50.000" in motions[2]
    blocked = lines.index(";THE WAY TO THE NEXT POSE IS BLOCKED: stop here, jog the robot there")
    assert lines[blocked + 1] == "HALT"
    assert lines.index(motions[2]) < blocked < lines.index(motions[3])
    assert "IS BLOCKED" not in plan.krl_program(RESULT, CELL, "measure").text


def test_the_summary_has_the_units_of_its_names():
    content = plan.plan_summary(RESULT)
    assert (content["robot"], content["configurations"], content["seed"]) == ("kuka_kr270", 2, 7)
    assert content["q2_levels_deg"] == [-70.0, -40.0]
    assert content["second_load"] == {"share": 0.25, "N": 225.0}
    assert content["criterion"] == {"kind": "pooled", "rms_mm": pytest.approx(0.02)}
    assert content["expected"]["rms_mm"] == pytest.approx(0.0123)
    assert content["expected"]["interval95_mm"] == pytest.approx([0.009, 0.021])
    assert content["expected"]["worst_test_pose_mm"] == pytest.approx(0.0345)
    assert content["uncompensated"] == {"rms_mm": pytest.approx(np.sqrt(0.2 * 9 + 0.8)), "max_mm": pytest.approx(3.0)}
    assert content["parameters"] == [
        {"name": "k1", "ci95_percent": 5.0}, {"name": "k2", "ci95_percent": 50.0},
        {"name": "k3", "ci95_percent": 1200.0},
    ]  # fmt: skip
    assert content["torques"][:2] == [
        {"joint": "A1", "negative_Nm": -250.0, "positive_Nm": 100.0, "negative_poses": 1, "positive_poses": 1,
         "work_negative_Nm": -120.0, "work_positive_Nm": 130.0},
        {"joint": "A2", "negative_Nm": -900.0, "positive_Nm": 0.0, "negative_poses": 2, "positive_poses": 0,
         "work_negative_Nm": -800.0, "work_positive_Nm": 0.0},
    ]  # fmt: skip
    assert content["test_poses"] == {"count": 2, "source": "part.nc"}
    assert (content["travel_s"], content["interrupted"], content["warnings"]) == (12.5, False, ["mind the cable"])
    assert not {"random", "serial_approach", "sizes", "measured_so_far"} & set(content)
    assert plan.plan_summary(changed(options=Options(grouped=True)))["criterion"]["kind"] == "grouped"
    for rms, shown in ((0.5e-3, 0.5), (np.inf, None)):
        assert plan.plan_summary(changed(initial_accuracy=SimpleNamespace(rms=rms)))["measured_so_far"] == {
            "rms_mm": shown
        }


def test_other_plans_are_compared_by_the_roots_of_their_criteria():
    content = plan.plan_summary(changed(random=RANDOM, serial=SERIAL, sizes=SIZES))
    assert content["random"] == pytest.approx(
        {"plans": 3, "best_rms_mm": 0.03, "median_rms_mm": 0.04, "gain_over_best": 1.5, "gain_over_median": 2.0}
    )
    assert content["serial_approach"] == pytest.approx({"rms_mm": 0.05, "gain": 2.5})
    assert content["sizes"] == [
        pytest.approx({"configurations": n, "rms_mm": root, "random_median_rms_mm": random})
        for n, root, random in ((1, 0.04, 0.1), (2, 0.02, 0.03), (4, 0.01, 0.02))
    ]


def test_lines_to_print_say_what_to_expect():
    assert plan.plan_lines(RESULT) == [
        "2 poses, A2 at -70.0, -40.0°; 2 test poses from part.nc",
        "each under two loads: 900 N as planned, and 25% of it, 225 N, in the same direction: as near to the work as "
        "the readings allow",
        "torques of the loads: A1 -250 … 100, A2 -900 … 0, A3 0 … 40, A4 0 … 0, A5 -60 … 80, A6 0 … 7 N·m",
        "expected error after compensation: 0.0123 mm RMS (95 %: 0.009 … 0.021); without compensation: 1.61 mm",
    ]
    lines = plan.plan_lines(
        changed(
            random=RANDOM,
            serial=SERIAL,
            interrupted=True,
            initial_accuracy=SimpleNamespace(rms=0.5e-3),
            unobservable=("k1", "k4"),
        )
    )
    assert "compensation, but for that by k1 and k4, which this rig does not show: 0.0123 mm" in lines[3]
    assert lines[4:] == [
        "with what was measured so far alone: 0.5 mm RMS",
        "criterion 0.02 mm; 3 random plans: best 0.03, median 0.04 mm (2.00 × the plan's)",
        "semi-intuitive plan of the serial approach: 0.05 mm (2.50 × the plan's)",
        "interrupted: this is the best plan so far",
    ]
    unknown = plan.plan_lines(changed(initial_accuracy=SimpleNamespace(rms=np.inf)))
    assert unknown[4] == "with what was measured so far alone: unknown, it does not determine every parameter"


def cells(section):
    return [[getattr(cell, "text", cell) for cell in row.cells] for row in section.parts[0].rows]


def kinds(section):
    return [[getattr(cell, "kind", "") for cell in row.cells] for row in section.parts[0].rows]


def test_tiles_and_warnings_of_the_page():
    assert plan.warnings_section(changed(warnings=())) is None
    assert [note.text for note in plan.warnings_section(RESULT).parts[0].notes] == ["mind the cable."]
    tiles = [(tile.value, tile.unit) for tile in plan.expected_section(changed(random=RANDOM)).parts[0].tiles]
    assert tiles == [("0.0123", "mm"), ("1.61", "mm"), ("2.00", "×"), ("12", "s")]
    assert plan.expected_section(RESULT).parts[0].tiles[0].note == "95 %: 0.009 … 0.021 mm"
    assert len(plan.expected_section(RESULT).parts[0].tiles) == 3


def test_tables_of_the_page_have_poses_test_poses_parameters_and_torques():
    assert cells(plan.angles_section(RESULT))[0] == [
        "1", "10.000", "-70.000", "100.000", "0.000", "50.000", "1.000", "100.0", "0.0", "-800.0",
    ]  # fmt: skip
    tests = plan.tests_section(RESULT)  # the largest share of the work first
    assert cells(tests) == [["1", "80.0", "70", "1.000", "0.0345"], ["2", "20.0", "50", "3.000", "0.01"]]
    assert "agrees to 1.2 %" in tests.parts[0].note
    parameters = plan.parameters_section(RESULT)
    assert cells(parameters) == [["k1", "± 5 %"], ["k2", "± 50 %"], ["k3", "± unbounded"]]
    assert [row[1] for row in kinds(parameters)] == ["good", "warning", "warning"]
    torques = plan.torques_section(RESULT)
    assert cells(torques)[:2] == [
        ["A1", "-250 (1)", "100 (1)", "-120 … 130"], ["A2", "-900 (2)", "0 (0)", "-800 … 0"],
    ]  # fmt: skip
    assert [row[1:3] for row in kinds(torques)][:2] == [["good", "good"], ["good", "warning"]]


def test_plots_of_the_page_compare_with_other_plans_and_sizes():
    """The axis of the sizes ends at four times the best plans where random ones are hopeless, with a margin of 5 %."""
    assert plan.comparison_section(RESULT) is None
    assert plan.sizes_section(changed(sizes=SIZES[:1])) is None
    many = np.concatenate([np.full(199, 9e-10), [1.0]])
    (plot,) = plan.comparison_section(changed(random=many, serial=SERIAL)).parts
    (bars,) = plot.traces
    assert sum(bars.heights) == 200
    assert (bars.edges[0], bars.edges[-1]) == (0.0, pytest.approx(1.05 * 0.05))
    assert plot.x.range == (0.0, bars.edges[-1])
    assert [(mark.at, mark.text) for mark in plot.marks] == [
        (pytest.approx(0.02), "this plan 0.02"), (pytest.approx(0.03), "median of random plans 0.03"),
        (pytest.approx(0.05), "semi-intuitive plan 0.05"),
    ]  # fmt: skip
    best = "The best of 200 random plans has 0.03 mm, this one 0.02 mm"
    assert plot.note.startswith(f"{best}, the semi-intuitive plan of the serial approach 0.05 mm.")
    (plot,) = plan.comparison_section(changed(random=many)).parts
    assert plot.note.startswith(f"{best}. ")
    assert len(plot.marks) == 2
    assert plot.traces[0].edges[-1] == pytest.approx(1.05 * 0.03)
    for sizes, top in ((SIZES, 0.1), (tuple(replace_random(size, 1.0) for size in SIZES), 0.16)):
        (plot,) = plan.sizes_section(changed(sizes=sizes)).parts
        random, found, here = plot.traces
        assert random.x == found.x == [1.0, 2.0, 4.0]
        assert found.y == pytest.approx([0.04, 0.02, 0.01])
        assert (here.x, here.y) == ([2.0], [pytest.approx(0.02)])
        assert plot.y.range == (0.0, pytest.approx(1.05 * top))
    (plot,) = plan.sizes_section(changed(sizes=SIZES)).parts
    assert plot.traces[0].y == pytest.approx([0.1, 0.03, 0.02])


def replace_random(size, value):
    return SimpleNamespace(**(vars(size) | {"random": value}))


def test_the_head_of_the_page_names_load_levels_and_state():
    text = "kuka_kr270 · 2 poses on 2 levels of q2 · load 900 N · test poses from part.nc"
    assert plan._subtitle(RESULT) == text
    unfinished = changed(interrupted=True, initial_accuracy=SimpleNamespace(rms=1.0))
    assert plan._subtitle(unfinished) == (
        text.replace("poses on", "poses in addition to those measured on")
        + " · search interrupted: the best plan so far"
    )
