"""Plans of the compensator's readings: expected intervals against simulated readings, angles against other choices."""

import json
import re

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.stats import t as student

from postproc import robot
from postproc.errors import PlanError
from postproc.identification import compensator_geometry as cg
from postproc.plan.compensator import CompensatorOptions, expected_intervals, plan_compensator
from tests.commands import invoke
from tests.kr270 import ROBOT
from tests.plan import setting

SIGMA = 0.03e-3
TRUE = np.array([0.18472, 0.68593, 0.12330])  # Table 1
PAPER_Q2 = np.radians([0.0, -30.0, -60.0, -90.0, -120.0, -140.0])


def filled_in(text, rng, sigma=SIGMA, beta=None):
    """Readings for a template, of a mechanism made of complex numbers, in millimetres."""
    L, ax, ay = TRUE * 1e3
    rows = [text.splitlines()[0]]
    for line in text.splitlines()[1:]:
        q2, name, repeat = line.split(",")[:3]
        p1, pivot = L * np.exp(1j * np.radians(float(q2))), -(ax + 1j * ay)
        spring = (p1 - pivot) / abs(p1 - pivot)
        at = p1 if name == "P1" else pivot + 120.0 * spring * np.exp(1j * beta[name])
        xyz = np.array([at.real, 300.0 - at.imag * 0.8, at.imag * 0.6]) + rng.normal(0.0, sigma * 1e3, 3)
        rows.append(f"{q2},{name},{repeat}," + ",".join(f"{v:.5f}" for v in xyz))
    return "\n".join(rows) + "\n"


def planned(folder, *arguments):
    setting.experiment(folder, setting.BASIC)
    command = ["plan", "compensator", "--experiment", str(folder / "experiment.toml"), *arguments]
    return invoke(*command, "-o", folder / "readings.csv")


def test_filled_in_templates_are_identified_with_the_promised_intervals_that_hold(tmp_path):
    done = planned(tmp_path)
    assert done.exit_code == 0, done.output
    plan = json.loads((tmp_path / "readings.json").read_text())
    beta = {marker["name"]: np.radians(marker["beta_deg"]) for marker in plan["markers"]}
    promised = np.array([plan[name]["ci95"] for name in ("L_mm", "a_x_mm", "a_y_mm")])
    template, rng = (tmp_path / "readings.csv").read_text(), np.random.default_rng(4)
    widths, inside = [], []
    for _ in range(60):
        (tmp_path / "filled.csv").write_text(filled_in(template, rng, beta=beta))
        result = cg.identify(cg.read(tmp_path / "filled.csv"))
        widths.append(result.ci95 * 1e3)
        inside.append(np.abs(result.lengths - TRUE) <= promised * 1e-3)
    np.testing.assert_allclose(np.mean(widths, axis=0), promised, rtol=0.03)
    share = np.mean(inside, axis=0)
    assert np.all(share > 0.86), share  # 60 runs of 0.95: ± 5.6 %
    assert np.abs(result.markers.sums).max() < 1e-3
    assert f"a_x ± {promised[1]:.3f} mm, a_y ± {promised[2]:.3f} mm" in done.output


def test_no_angles_at_random_are_better_and_the_papers_are_not():
    plan = plan_compensator(ROBOT, SIGMA, CompensatorOptions())
    cost = lambda ci: float(np.sum(ci**2))  # noqa: E731
    found, rng = cost(plan.ci95), np.random.default_rng(0)
    lower, upper = np.degrees(ROBOT.lower[1]) + 5.0, np.degrees(ROBOT.upper[1]) - 5.0
    assert np.all((np.degrees(plan.q2) >= lower - 1e-9) & (np.degrees(plan.q2) <= upper + 1e-9))
    assert np.diff(np.degrees(plan.q2)).max() <= -10.0 + 1e-9
    tried = 0
    while tried < 200:
        angles = np.sort(rng.integers(np.ceil(lower), np.floor(upper) + 1, 6))
        if np.diff(angles).min() >= 10:
            tried += 1
            other = expected_intervals(TRUE, np.radians(angles.astype(float)), plan.beta, SIGMA, 3)
            assert cost(other) > found * (1.0 - 1e-3)
    # the angles of Table 1, within the same range, with the paper's two opposite pairs
    paper = expected_intervals(TRUE, np.clip(PAPER_Q2, *np.radians([lower, upper])), plan.beta, SIGMA, 3)
    assert cost(paper) > 1.2 * found
    assert paper[1] / paper[0] > 4.0  # Table 1: a_x is ten times less certain than L


@pytest.mark.parametrize("range_of_a2", [(-100.0, -20.0), (-60.0, 0.0)])
def test_no_other_whole_degree_for_one_angle_is_better(range_of_a2):
    """Those at the limits of A2 among them, which are whole degrees here."""
    lower, upper = (np.insert(np.zeros(5), 1, np.radians(limit)) for limit in range_of_a2)
    narrow = replace(ROBOT, lower=lower, upper=upper)
    plan = plan_compensator(narrow, SIGMA, CompensatorOptions(angles=3, margin=0.0))
    cost = lambda q2: float(np.sum(expected_intervals(TRUE, q2, plan.beta, SIGMA, 3) ** 2))  # noqa: E731
    found = cost(plan.q2)
    angles = np.degrees(plan.q2)
    np.testing.assert_allclose(angles, np.round(angles), atol=1e-9)
    assert angles.min() >= range_of_a2[0] - 1e-9
    assert angles.max() <= range_of_a2[1] + 1e-9
    for place in range(3):
        others = np.delete(angles, place)
        for angle in np.arange(range_of_a2[0], range_of_a2[1] + 1.0):
            if np.abs(others - angle).min() >= 10.0 - 1e-9:
                assert cost(np.radians(np.insert(others, place, angle))) > found * (1.0 - 1e-3)


def test_four_markers_are_the_papers_opposite_pairs_a_quarter_turn_apart():
    np.testing.assert_allclose(np.degrees(cg.even_angles(4)), [0.0, 90.0, 180.0, 270.0])
    own = expected_intervals(TRUE, PAPER_Q2, cg.even_angles(4), SIGMA, 3)
    for pair in (20.0, 50.0):  # opposite pairs at another angle: the condition holds, the intervals are wider
        other = np.radians([0.0, pair, 180.0, 180.0 + pair])
        assert np.sum(expected_intervals(TRUE, PAPER_Q2, other, SIGMA, 3) ** 2) > 1.2 * np.sum(own**2)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_no_markers_at_random_are_much_better_than_evenly_spread_ones(count):
    rng = np.random.default_rng(1)
    own = np.sum(expected_intervals(TRUE, PAPER_Q2, cg.even_angles(count), SIGMA, 3) ** 2)
    others = rng.uniform(0.0, 2.0 * np.pi, (100, count))
    best = min(np.sum(expected_intervals(TRUE, PAPER_Q2, beta, SIGMA, 3) ** 2) for beta in others)
    assert best > 0.95 * own


def test_a_robot_without_a_compensator_and_a_range_without_room_are_refused():
    bare = robot.load(robot.find("kuka_kr16_2"))
    with pytest.raises(PlanError, match="has no gravity compensator"):
        plan_compensator(bare, SIGMA, CompensatorOptions())
    with pytest.raises(PlanError, match=r"no room for 20 angles 10° apart"):
        plan_compensator(ROBOT, SIGMA, CompensatorOptions(angles=20))


def test_readings_that_were_filled_in_are_not_replaced_by_a_new_template(tmp_path):
    assert planned(tmp_path, "--angles", "3").exit_code == 0
    text = (tmp_path / "readings.csv").read_text()
    (tmp_path / "readings.csv").write_text(text.replace(",,,", ",1,2,3"))
    again = planned(tmp_path, "--angles", "3")
    assert again.exit_code == 1
    assert (text.count("\n"), text[-1]) == (1 + 3 * 5 * 3, "\n")  # three angles, P1 and four markers, three times
    assert "not written by postproc, or changed since" in again.output
    assert ",1,2,3" in (tmp_path / "readings.csv").read_text()


def test_names_of_more_than_nine_markers_are_those_that_identify_reads(tmp_path, monkeypatch):
    monkeypatch.setattr("postproc.plan.compensator._exchanged_angles", lambda _, __, start, ___: start)  # any angles do
    assert planned(tmp_path, "--angles", "3", "--markers", "11", "--repeats", "1").exit_code == 0
    names = set(re.findall(r"P0\d+", (tmp_path / "readings.csv").read_text()))
    assert len(names) == 11


def test_options_without_a_command_plan_poses():
    done = invoke("plan", cell="x")
    assert done.exit_code == 2
    assert "Usage: main plan poses" in done.output
    assert "Missing option '--experiment'" in done.output


@pytest.mark.parametrize(
    ("m", "k", "repeats", "dof"),
    [(3, 2, 1, (9 - 7) + (12 - 4 - 4)), (3, 2, 2, 6 + 27), (4, 3, 3, (12 - 7) + (24 - 6 - 4) + 2 * 48)],
)
def test_intervals_count_what_the_circles_and_the_repeats_leave(m, k, repeats, dof):
    """Coordinates of P1 and of the markers in their planes, less the unknowns; of each further repeat all three."""
    q2, beta = np.radians(np.linspace(-130.0, -20.0, m)), cg.even_angles(k)
    wide = expected_intervals(TRUE, q2, beta, SIGMA, repeats)
    one = np.sqrt(np.diag(cg.expected_covariance(TRUE, q2, np.full(k, 0.15), beta, SIGMA**2 / repeats)))
    np.testing.assert_allclose(wide / one, student.ppf(0.975, dof), rtol=1e-5)
