from __future__ import annotations

import contextlib
import csv
import functools
import json
import math
import signal
from itertools import pairwise

import numpy as np
import pytest

from postproc.dialects import krl
from postproc.dialects.text import decode
from postproc.kinematics import tcp
from postproc.plan import search
from tests.commands import invoke
from tests.html_page import read_page
from tests.places import CELL_FILE, SAMPLES
from tests.plan import setting
from tests.plan.setting import AROUND, BASIC, RIG
from tests.plan.test_directions import simulated

POSES = """A1,A2,A3,A4,A5,A6,Fx,Fy,Fz
0,-70,110,0,50,0,100,50,300
10,-60,100,10,50,0,0,80,-200
-10,-75,105,0,60,0,90,0,250
"""
QUICK = ("--configurations", "6", "--q2-levels", "3", "--test-poses", "6")


def plan(folder, *arguments, text=BASIC + RIG + AROUND):
    setting.experiment(folder, text)
    (folder / "tests.csv").write_text(POSES)
    common = ["plan", "--experiment", str(folder / "experiment.toml"), "--cell", str(CELL_FILE)]
    return invoke(*common, *arguments, "-o", folder / "out" / "plan.csv")


def briefly(task, seed, *_, rounds):
    """Search from one start."""
    return search.improve(task, seed, 1, 1, rounds)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("postproc.plan.search.SIZE_FACTORS", (0.5, 1.0, 2.0))  # three sizes of six
        patch.setattr("postproc.plan.planning.improve", functools.partial(briefly, rounds=8))
        result = plan(folder, "--program", str(SAMPLES / "pocket.nc"), str(SAMPLES / "inline.src"), *QUICK)
    assert result.exit_code == 0, result.output
    return folder / "out", result


def test_the_csv_has_the_columns_units_and_number_of_the_contract(written):
    rows = list(csv.DictReader((written[0] / "plan.csv").read_text().splitlines()))
    assert list(rows[0]) == ["config", "A1", "A2", "A3", "A4", "A5", "A6", "Fx", "Fy", "Fz"]
    assert [row["config"] for row in rows] == ["1", "2", "3", "4", "5", "6"]
    assert len({row["A2"] for row in rows}) == 3
    force = np.array([[float(row[name]) for name in ("Fx", "Fy", "Fz")] for row in rows])
    assert np.abs(np.linalg.norm(force, axis=1) - 275 * 9.81).max() < 0.2
    assert np.degrees(np.arccos(-force[:, 2] / np.linalg.norm(force, axis=1))).max() <= 30.01
    assert "-0.000" not in (written[0] / "plan.csv").read_text()


def test_the_krl_program_visits_the_poses_of_the_csv_and_waits_for_two_loads_at_each(written):
    document = decode("plan.src", (written[0] / "plan.src").read_bytes())
    forward = lambda q: tcp(setting.ROBOT.nominal, q[None], np.eye(4))[0][0]  # noqa: E731
    motions = krl.read_program([document], setting.CELL, forward, "plan").motions
    q, _ = setting.read_plan((written[0] / "plan.csv").read_text())
    start = setting.CELL.start_joints
    halts = [line for line in document.text.splitlines() if line.startswith("HALT ;measure")]
    assert len(halts) == 3 * len(q)
    lines = document.text.splitlines()
    before_halt = [number for number in motions.line if lines[number].startswith("HALT")]  # `line` counts from 1
    visited = motions.joints[np.isin(motions.line, before_halt)]
    assert np.abs(visited - q).max() < 1e-6
    assert np.abs(motions.joints[[0, -1]] - start).max() < 1e-6
    assert document.text.startswith("&ACCESS RVP\r\n")


def test_the_summary_says_what_to_expect(written):
    content = json.loads((written[0] / "plan.json").read_text())
    second = content["second_load"]
    assert 0.1 <= second["share"] <= 0.4
    assert second["N"] == pytest.approx(second["share"] * 275 * 9.81, rel=1e-4)
    assert f"{second['N']:.0f} N, in the same direction" in written[1].output
    low, high = content["expected"]["interval95_mm"]
    assert low < content["expected"]["rms_mm"] < high < content["uncompensated"]["rms_mm"]
    assert content["random"]["plans"] == 200
    assert content["random"]["gain_over_best"] > 1.0
    assert content["serial_approach"]["gain"] > 1.0
    sizes = content["sizes"]
    assert 6 in [size["configurations"] for size in sizes]
    assert all(a["rms_mm"] > b["rms_mm"] for a, b in pairwise(sizes))
    assert "expected error after compensation" in written[1].output
    assert "K_c" in written[1].output


def test_torques_stand_in_the_json_and_on_the_terminal(written):
    """By the simulator's own chain."""
    q, force = setting.read_plan((written[0] / "plan.csv").read_text())
    torque = simulated(q, force)
    shown = json.loads((written[0] / "plan.json").read_text())["torques"]
    for joint, entry in enumerate(shown):
        assert entry["joint"] == f"A{joint + 1}"
        assert entry["negative_Nm"] == pytest.approx(min(torque[:, joint].min(), 0.0), abs=0.5)
        assert entry["positive_Nm"] == pytest.approx(max(torque[:, joint].max(), 0.0), abs=0.5)
        assert entry["negative_poses"] >= 2
        assert entry["positive_poses"] >= 2
        text = f"A{joint + 1} {entry['negative_Nm']:.0f} … {entry['positive_Nm']:.0f}"
        assert text in written[1].output


def test_the_page_is_self_contained_and_draws_every_pose(written):
    read = read_page((written[0] / "plan.html").read_bytes())
    assert set(read.ids) >= {"expected", "poses", "angles", "comparison", "sizes", "tests", "parameters"}
    (poses,) = [plot for plot in read.plots if plot["steps"]]
    pulls = [trace for trace in poses["traces"] if trace["name"] == "pull of the load"]
    assert len(pulls) == 6
    assert len(poses["steps"]) == 1 + 6
    rows = list(csv.reader((written[0] / "plan.csv").read_text(encoding="utf-8").splitlines()))
    for number, row in enumerate(rows[1:], 1):
        assert " ".join([str(number), *row[1:]]) in read.text("angles")


def test_the_plan_can_be_measured_and_identified_by_its_own_files(written, tmp_path):
    """Poses of the CSV through the simulator into `identify`: all compliances come out."""
    from postproc.identification.procedure import identify
    from postproc.identification.readings import read, read_experiment
    from samples.paper_study import simulator
    from tests.plan.monte_carlo import true_robot

    q, force = setting.read_plan((written[0] / "plan.csv").read_text())
    _, raw = simulator.measure(true_robot(), q, force, np.random.default_rng(0))
    simulator.write(tmp_path, q, force, raw)
    data = read(tmp_path / "measurements.csv", read_experiment(tmp_path / "experiment.toml"))
    found = identify(setting.ROBOT, data, depth="joints")
    assert np.abs(found.robot().compliance / setting.ROBOT.compliance - 1)[:5].max() < 0.03


@pytest.mark.parametrize(
    ("arguments", "text", "problem"),
    [
        (("--poses", "tests.csv", "--q2-levels", "9", "--configurations", "6"), BASIC + RIG, "9 levels of q2 for 6"),
        (("--poses", "tests.csv"), BASIC, r"the experiment has no [rig]"),
        (("--poses", "tests.csv"), BASIC + RIG + "[floor]\nZ = 4000\n", "what blocks is: floor"),
        (("--poses", "tests.csv"), BASIC + RIG + "[tracker]\nX = 1\nY = 2\nQ = 3\n", "Valid keys: X, Y, Z"),
        (("--poses", "tests.csv"), BASIC + RIG + "[[boxes]]\nX = 1\n", "size"),
        (("--poses", "tests.csv"), BASIC + RIG + "[[meshes]]\nfile = 'no.stl'\n", "no.stl: no such file"),
        (("--poses", "absent.csv"), BASIC + RIG, "no such file"),
        (("--program", str(SAMPLES / "freeform.nc")), BASIC + RIG, "no cutting move of this program carries a force"),
        (("--poses", "tests.csv"), BASIC.replace("kr270", "kr16_2") + RIG, "an arm of other dimensions"),
    ],
)
def test_bad_input_is_a_message_with_exit_code_1_and_nothing_is_written(
    tmp_path, monkeypatch, arguments, text, problem
):
    monkeypatch.chdir(tmp_path)
    result = plan(tmp_path, *arguments, text=text)
    assert result.exit_code == 1, result.output
    assert problem in result.output
    assert not (tmp_path / "out").exists()


def test_wrong_usage_is_exit_code_2(tmp_path):
    assert plan(tmp_path).exit_code == 2
    both = plan(tmp_path, "--program", str(SAMPLES / "pocket.nc"), "--poses", str(tmp_path / "tests.csv"))
    assert both.exit_code == 2
    assert "either --program" in both.output


def test_an_input_is_never_overwritten(tmp_path):
    setting.experiment(tmp_path)
    (tmp_path / "plan.csv").write_text(POSES)
    arguments = ["plan", "--experiment", str(tmp_path / "experiment.toml"), "--cell", str(CELL_FILE)]
    arguments += ["--poses", str(tmp_path / "plan.csv"), "-o", str(tmp_path / "plan.csv"), *QUICK]
    result = invoke(*arguments)
    assert result.exit_code == 1
    assert "would be overwritten" in result.output
    assert (tmp_path / "plan.csv").read_text() == POSES


def test_a_rig_that_cannot_show_a_parameter_is_told_before_anyone_measures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("postproc.plan.planning.criterion_by_number", lambda *_: ())  # the fixture has those
    monkeypatch.setattr("postproc.plan.planning.improve", functools.partial(briefly, rounds=1))
    result = plan(tmp_path, "--poses", "tests.csv", *QUICK, text=BASIC + "\n[rig]\nmass_kg = 275\n")
    assert result.exit_code == 0, result.output
    assert "warning: k1 is not observable with this rig" in result.output
    assert "expected error after compensation, but for that by k1, which this rig does not show: " in result.output
    page = (tmp_path / "out" / "plan.html").read_text(encoding="utf-8")
    assert "k1 is not observable" in page


def test_ctrl_c_writes_the_best_plan_so_far(tmp_path, monkeypatch):
    @contextlib.contextmanager
    def stopping():
        def tell(stage, share, best):
            if stage == "searching" and math.isfinite(best):
                signal.raise_signal(signal.SIGINT)

        yield tell

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("postproc.cli.plan._progress_display", stopping)
    result = plan(tmp_path, "--poses", "tests.csv", *QUICK)
    assert result.exit_code == 0, result.output
    assert "interrupted: this is the best plan so far" in result.output
    assert len((tmp_path / "out" / "plan.csv").read_text().splitlines()) == 7
    assert json.loads((tmp_path / "out" / "plan.json").read_text())["interrupted"] is True
