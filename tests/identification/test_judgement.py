"""Verdict, reservations, notes and reasons of an identification, from fits and choices whose numbers are stated."""

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from postproc import elastostatics, robot
from postproc.identification import compensator_geometry, joint_springs, moved_device, procedure, uncertainty
from postproc.identification.compensator_geometry import MarkerPlacement
from postproc.identification.fit import Fit, linearise
from postproc.identification.measurement_model import (
    Placement,
    Structure,
    base_frame,
    locate,
    measured_displacements,
    point_table,
    visible_points,
)
from postproc.identification.uncertainty import Workspace, WorkspaceLevel, judge
from postproc.robot import JOINT_COMPLIANCES
from samples.paper_study import harness
from tests.identification.test_joint_springs import ARM, LOADED_TIP, POINTS, SPRINGS, forces, placed, posed, readings

FINE = Workspace((WorkspaceLevel(500.0, 1e-3, 1e-4, 0.1, 1.0),), 400.0, "", (0.0,) * 6)


def fit_of(data, values=SPRINGS, sigma=0.02, covariance=None, chi2=None, off=0.0, parameters=JOINT_COMPLIANCES):
    """A fit with these values, a relative uncertainty of them, χ² and residual [m] of each component."""
    rows = 3 * len(data.loaded_states) * len(data.points)
    spread = np.diag((sigma * np.asarray(values)) ** 2) if covariance is None else covariance
    dof = max(rows - len(values), 1)
    return Fit(
        Structure(tuple(parameters), harness.PRIOR), np.asarray(values, dtype=float), spread,
        np.full((len(data.loaded_states), len(data.points), 3), off), float(dof if chi2 is None else chi2), dof,
        np.zeros((rows, len(values))), np.zeros(rows),
    )  # fmt: skip


def choice_of(fit, held_out=1.0, held=(), off=0.0):
    return SimpleNamespace(
        fit=fit, held_out=np.full(3, held_out), left_out=fit.residual + off, held_by_prior=tuple(held)
    )


@pytest.mark.parametrize(
    ("points", "loads", "needed"),
    [
        # least squares need two numbers a parameter: 12; a configuration has 3, 5 or 6 of them for each direction
        (1, 1, 4), (2, 1, 3), (3, 1, 3), (1, 2, 3), (1, "parallel", 4),
    ],
)  # fmt: skip
def test_least_squares_need_two_numbers_a_parameter_and_three_configurations(points, loads, needed):
    for count in (needed - 1, needed):
        data = readings(forces(count, 500.0), count=count, points=POINTS[:points])
        if loads != 1:
            data = twice_loaded(data, parallel=loads == "parallel")
        verdict = judge(data, fit_of(data), None, FINE, 1.0)
        assert bool(verdict.distrust) == (count < needed)
        assert (f"needs {needed} configurations at least" in verdict.distrust) == (count < needed)
    # structures with priors need what shows a scatter
    few = readings(forces(2, 500.0), count=2, points=POINTS[:points])
    verdict = judge(few, fit_of(few), choice_of(fit_of(few)), FINE, 1.0)
    assert "2 configurations were measured" in verdict.distrust
    assert "needs 3 configurations" in verdict.distrust
    assert verdict.line == f"NOT TO BE TRUSTED: {verdict.distrust}"
    three = readings(forces(3, 500.0), count=3, points=POINTS[:points])
    assert judge(three, fit_of(three), choice_of(fit_of(three)), FINE, 1.0).distrust == ""


def twice_loaded(data, parallel):
    """The same configurations under a second load: in the direction of the first, or in another."""
    configs = len(data.q)
    state_config = np.concatenate([data.state_config, np.arange(configs)])
    first = data.wrench[data.loaded_states]
    second = 0.5 * first if parallel else np.roll(first, 1, axis=1) * [1, 1, 1, 0, 0, 0] + [0, 90.0, 0, 0, 0, 0]
    rows = np.flatnonzero(np.isin(data.state, data.loaded_states))
    new_state = 2 * configs + data.state_config[data.state[rows]]
    return replace(
        data, state_config=state_config, load=np.append(data.load, np.full(configs, 2.0)),
        wrench=np.vstack([data.wrench, second]), state=np.append(data.state, new_state),
        **{
            name: np.concatenate([getattr(data, name), getattr(data, name)[rows]])
            for name in ("point", "repeat", "position", "line", "used")
        },
    )  # fmt: skip


@pytest.mark.parametrize(("count", "with_reservation"), [(4, True), (5, False)])
def test_fewer_than_five_configurations_are_a_reservation(count, with_reservation):
    data = readings(forces(count, 500.0), count=count)
    verdict = judge(data, fit_of(data), None, FINE, 1.0)
    assert verdict.distrust == ""
    assert (verdict.reservation == "") != with_reservation
    if with_reservation:
        assert verdict.reservation.startswith("4 configurations show little of what the model lacks: measure 5 or more")
        assert verdict.line.startswith("the model may be used, within its bound, with a reservation: 4 conf")
    else:
        assert verdict.line == "the model may be used, within its bound"


def test_a_model_without_equilibrium_is_refused_with_its_pose():
    data = readings(forces(6, 500.0), count=6)
    none = Workspace((), 400.0, "the springs have no equilibrium under 300 N", tuple(np.radians([1, 2, 3, 4, 5, 6.4])))
    verdict = judge(data, fit_of(data), None, none, 1.0)
    assert verdict.distrust == "at A1 … A6 = 1, 2, 3, 4, 5, 6° the springs have no equilibrium under 300 N"
    assert none.line == f"workspace: {verdict.distrust}"


@pytest.mark.parametrize(
    ("sigma", "ratio", "limit"),
    [
        (0.25, 2.45, ""), (0.25, 2.55, "2.5"), (0.25, 0.41, ""), (0.25, 0.39, "2.5"),  # sets differ by 50 %
        (0.8, 3.35, ""), (0.8, 3.45, "3.4"),  # the robot states more
    ],
)  # fmt: skip
def test_a_robot_unlike_all_of_its_kind_gets_a_reservation(sigma, ratio, limit):
    data = readings(forces(6, 500.0), count=6)
    size = sigma * 1e6 * harness.PRIOR.compliance
    prior = replace(harness.PRIOR, covariance=robot.Covariance(JOINT_COMPLIANCES, np.diag(size**2)))
    fit = fit_of(data)
    verdict = judge(data, replace(fit, structure=replace(fit.structure, prior=prior)), None, FINE, ratio)
    assert verdict.distrust == ""
    assert ("times as far" in verdict.reservation) == (limit != "")
    if limit:
        assert f"all points move {ratio:.2g} times as far as kuka_kr270" in verdict.line
        assert f"differ by a factor of {limit} at most: check the scale and the unit of the forces" in verdict.line


@pytest.mark.parametrize("by_choice", [False, True])
@pytest.mark.parametrize(
    ("share", "square_error", "doubtful"),
    [(0.29, 9.0, False), (0.31, 9.0, True), (0.31, 3.9, False), (0.31, 4.1, True)],
)
def test_a_model_that_leaves_a_third_of_the_displacements_beyond_noise_doubts_the_set_up(
    by_choice, share, square_error, doubtful
):
    data = readings(forces(6, 500.0), count=6)
    data = replace(data, used=~((data.state == 3) & (data.point == 1)))
    moved = measured_displacements(data, placed(data))
    size = np.sqrt(np.mean([np.sum(moved[n, p] ** 2) for n in range(6) for p in range(4) if (n, p) != (1, 1)]))
    off = share * size / np.sqrt(3.0)
    dof = 3 * 6 * 4 - 6
    if by_choice:  # configurations left out count, not the fit
        fit = fit_of(data)
        verdict = judge(data, fit, choice_of(fit, square_error, off=off), FINE, 1.0)
    else:
        verdict = judge(data, fit_of(data, chi2=square_error * dof, off=off), None, FINE, 1.0)
    message = f"the model is off by {share * size * 1e3:.2g} mm RMS of displacements of {size * 1e3:.2g} mm"
    assert (message in verdict.reservation) == doubtful
    assert bool(verdict.reservation) == doubtful
    beyond = any("the mean square error is" in note for note in verdict.notes)
    assert beyond == (square_error > 4.0)
    if beyond:
        basis = "on configurations left out" if by_choice else "on the readings"
        assert verdict.notes[0].startswith(f"{basis} the mean square error is {square_error:.1f} σ² (noise alone: 1)")


def test_notes_name_what_readings_leave_open():
    data = readings(forces(6, 500.0) * 0.0 + [0, 0, -400.0, 0, 0, 0], count=6)
    parameters = (
        *JOINT_COMPLIANCES,
        robot.Backlash("A4", 30.0),
        robot.LostMotion("A5", 30.0),
        robot.Backlash("A3", 9.0),
    )
    values = [*SPRINGS[:3], 0.0, *SPRINGS[4:], 30e-6, 40e-6, 30e-6]
    sigma = np.array([*(0.02 * SPRINGS), 10e-6, 5e-6, 20e-6])
    fit = fit_of(data, values, covariance=np.diag(sigma**2), parameters=parameters)
    links = [robot.LinkSpring("A2", axis) for axis in robot.LINK_AXES[:6]] + [robot.LinkSpring("A3", "X")]
    held = [links[0], robot.LinkMass("A3"), *links[1:], JOINT_COMPLIANCES[5], robot.Knee("A3", 50.0)]
    judged = judge(data, fit, choice_of(fit, held=held), FINE, 1.0).notes
    assert judged[0].startswith("one level of loads (400 N): gears that stiffen")
    names = ", ".join(link.name for link in links[:6])
    kinds = f"link springs {names} and 1 more; masses {held[1].name}; joints k6; breakpoints {held[-1].name} ("
    assert judged[1].startswith(f"not identified, held by a prior of physical size, which counts in the bound: {kinds}")
    assert judged[2] == "A4 has no compliance of its own: springs of the links take its place"
    # 1.96 σ: A3's could be none
    assert judged[3:] == ["looks like 0.030 mrad of backlash or friction in A4",
                          "looks like 0.040 mrad of backlash or friction in A5"]  # fmt: skip
    two = twice_loaded(readings(forces(6, 500.0), count=6), parallel=True)
    plain = fit_of(two)
    assert judge(two, plain, choice_of(plain), FINE, 1.0).notes == []
    tiny = fit_of(data, [9e-6], sigma=0.1, parameters=(robot.Backlash("A4", 30.0),))  # below 10 µrad
    assert judge(data, tiny, None, FINE, 1.0).notes == []


def levels(*rows):
    return tuple(WorkspaceLevel(load, 1e-3, worst * 1e-3, worst, chance) for load, worst, chance in rows)


def test_the_workspace_counts_loads_that_were_measured():
    space = Workspace(levels((50.0, 3.0, 0.6), (100.0, 1.1, 0.7), (400.0, 0.4, 0.9), (900.0, 0.5, 0.99)), 400.0,
                      "most of it comes from A3", tuple(np.radians([10, 20, 30, 40, 50, 60])))  # fmt: skip
    assert [level.load for level in space.measured_levels] == [400.0, 900.0]
    assert space.worst_level.load == 900.0
    assert space.line == (
        "bound over deflection in the workspace: below 0.5 in 95 % of the poses from 400 N to 900 N; at 100 N and "
        "below the bound can exceed the deflection"
    )
    assert elastostatics.UNCERTAIN_CHANCE > 0.8
    doubt = replace(space, levels=levels((50.0, 3.0, 0.6), (400.0, 0.9, 0.8), (900.0, 1.2, 0.7)))
    assert doubt.reservation == (
        "under 900 N there are poses where correction makes the part better with a chance of 70 % only; under 900 N "
        "the bound is up to 1.2 times the deflection (A1 … A6 = 10, 20, 30, 40, 50, 60°): most of it comes from A3"
    )
    assert "can exceed" in replace(space, levels=levels((300.0, 1.1, 1.0), (500.0, 0.9, 1.0))).line
    for narrow in (levels((400.0, 0.9, 1.0), (900.0, 1.2, 1.0)), levels((300.0, 1.0, 1.0), (900.0, 1.0, 1.0))):
        assert "can exceed" not in replace(space, levels=narrow).line
    beyond = replace(space, least_load=1000.0)  # no level is that large: the largest counts
    assert [level.load for level in beyond.measured_levels] == [900.0]


def test_the_cause_of_a_wide_bound_is_the_joint_with_the_largest_variance_there():
    """By differences of the arm: the displacement of the tool by each compliance, its variance summed over axes."""
    q = posed(5, 1)[0]
    wrench = np.array([200.0, -300.0, 500.0, 0, 0, 0])
    torque = ARM.gradient(lambda x: wrench[:3] @ ARM.tcp(x, LOADED_TIP)[:3, 3], q)
    slopes = np.array([ARM.gradient(lambda x, a=a: ARM.tcp(x, LOADED_TIP)[a, 3], q) for a in range(3)]) * torque
    for joint in range(5):
        # the joint gives a little more than all others together
        sigma = np.full(6, 1e-9) / np.linalg.norm(slopes, axis=0)
        sigma[joint] *= 1.1
        share = np.sum((slopes * sigma) ** 2, axis=0)
        assert np.argmax(share) == joint
        model = replace(
            harness.PRIOR, covariance=robot.Covariance(JOINT_COMPLIANCES, np.diag((1e6 * sigma) ** 2)),
            discrepancy=None,
        )  # fmt: skip
        cause = uncertainty._main_cause(model, q, LOADED_TIP, wrench, 1e-3)
        assert cause == (
            f"most of it comes from A{joint + 1}, whose readings do not determine {JOINT_COMPLIANCES[joint].title}"
        )
    for off, named in ((0.49e-3, False), (0.51e-3, True)):
        model = replace(model, discrepancy=robot.Discrepancy(np.array([100.0, 900.0]), np.array([off, off])))
        cause = uncertainty._main_cause(model, q, LOADED_TIP, wrench, 1e-3)
        assert cause.startswith("the unmodelled error is 0.510 of 1.000 mm") == named


def test_parameters_belong_to_their_joint_or_link():
    assert uncertainty._joint_name(robot.LinkSpring("base", "end_RX")) == "base"
    assert uncertainty._joint_name(JOINT_COMPLIANCES[4]) == "A5"
    assert uncertainty._joint_name(robot.CompensatorStiffness()) == "A2"


@pytest.mark.parametrize(("correlation", "named"), [(0.85, False), (0.95, True), (-0.95, True)])
def test_a_joint_that_can_hardly_be_separated_from_another_names_it(correlation, named):
    data = readings(forces(8, 500.0), count=8)
    sigma = 0.02 * SPRINGS
    sigma[1] = 0.6 * SPRINGS[1]
    covariance = np.diag(sigma**2)
    covariance[1, 2] = covariance[2, 1] = correlation * sigma[1] * sigma[2]
    (entry,) = joint_springs.unobservable_parameters(fit_of(data, covariance=covariance), data)
    assert entry.parameter == JOINT_COMPLIANCES[1]
    half = 1.96 * 0.6 * 0.2
    assert entry.reason.startswith(f"its 95 % interval is ± {half:.2g} µrad/(N·m) for a value of 0.2")
    other = f"hardly be separated from {JOINT_COMPLIANCES[2].symbol} (correlation {correlation:.2f})"
    assert (other in entry.reason) == ("separated" in entry.reason) == named
    assert entry.advice == "Measure configurations that put more torque on A2 alone."
    covariance[1, 1] = np.inf
    covariance[1, 2] = covariance[2, 1] = 0.0
    (entry,) = joint_springs.unobservable_parameters(fit_of(data, covariance=covariance), data)
    assert entry.reason == "the configurations do not determine it"


@pytest.mark.parametrize(
    ("half", "chi2", "with_misfit", "open_joints"),
    [
        # half of 0.5 of the larger of value and prior is the limit; a misfit from twice the noise on widens it
        (0.49, 1.0, False, []), (0.51, 1.0, False, [3]), (0.49, 1.9, False, []), (0.3, 4.0, False, [3]),
        (0.24, 4.0, False, []), (0.3, 4.0, True, []),
    ],
)  # fmt: skip
def test_a_joint_is_open_from_half_its_size_on(half, chi2, with_misfit, open_joints):
    data = readings(forces(8, 500.0), count=8)
    prior = harness.PRIOR.compliance[list(harness.PRIOR.actuated)]
    for value in (0.5 * prior[3], 2.0 * prior[3]):
        values = SPRINGS.copy()
        values[3] = value
        sigma = 0.02 * values
        sigma[3] = half * max(value, prior[3]) / 1.96
        fit = fit_of(data, values, covariance=np.diag(sigma**2))
        fit = replace(fit, chi2=chi2 * fit.dof)
        entries = joint_springs.unobservable_parameters(fit, data, covariance_has_misfit=with_misfit)
        assert [JOINT_COMPLIANCES.index(entry.parameter) for entry in entries] == open_joints


def test_open_joints_are_listed_worst_first_and_a_negative_value_is_open():
    data = readings(forces(8, 500.0), count=8)
    values, sigma = SPRINGS.copy(), 0.02 * SPRINGS
    values[0] = -values[0]
    sigma[4], sigma[3] = 4e-6, 3e-6
    entries = joint_springs.unobservable_parameters(fit_of(data, values, covariance=np.diag(sigma**2)), data)
    assert [entry.parameter for entry in entries] == [JOINT_COMPLIANCES[joint] for joint in (4, 3, 0)]


@pytest.mark.parametrize("hidden_state", [None, 2, 3])
def test_distances_by_configuration_are_roots_of_mean_squares_by_loops(hidden_state):
    """A point that has no reading without load (state 2) or with a load (3) does not count in configuration 1."""
    data = twice_loaded(readings(forces(5, 500.0), count=5), parallel=False)
    data = replace(data, position=data.position + np.random.default_rng(1).normal(0.0, 3e-5, data.position.shape))
    data = replace(data, used=~((data.state == hidden_state) & (data.point == 1)))
    left = np.random.default_rng(2).normal(0.0, 1e-5, (10, 4, 3)) * visible_points(data)
    result = SimpleNamespace(data=data, placement=placed(data), fit=SimpleNamespace(residual=left))
    before, after = procedure.rms_distances(result)
    for config in range(5):
        squares, residuals = [], []
        for row, state in enumerate(np.flatnonzero(data.load > 0.0)):
            if data.state_config[state] != config:
                continue
            for point in range(4):
                if point == 1 and hidden_state in (state, 2 * config):
                    continue
                places = [
                    data.position[(data.state == at) & (data.point == point)].mean(axis=0) for at in (state, 2 * config)
                ]
                squares.append(np.sum((places[0] - places[1]) ** 2))
                residuals.append(np.sum(left[row, point] ** 2))
        assert len(squares) == 8 - (config == 1 and hidden_state is not None) * (2 if hidden_state == 2 else 1)
        assert before[config] == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-6)
        assert after[config] == pytest.approx(np.sqrt(np.mean(residuals)))


def test_the_movement_of_a_device_is_that_of_the_middle_of_the_points():
    """A device far off that turns by a milliradian about an axis at the robot's root."""
    rng = np.random.default_rng(4)
    count, turn = 30, np.array([0.4e-3, -0.3e-3, 1.1e-3])
    device = np.eye(4)
    device[:3, :3] = Rotation.from_euler("xyz", [20, -35, 140], degrees=True).as_matrix()
    device[:3, 3] = [1.2, -3.4, 0.8]
    data = readings(forces(count, 500.0), count=count, device=device)
    data = replace(data, position=data.position + rng.normal(0.0, 2e-5, data.position.shape))
    rows = data.state_config[data.state] >= 17
    position = data.position.copy()
    position[rows] += np.cross(turn, position[rows] - device[:3, 3])
    data = replace(data, position=position)
    tips = np.array([ARM.tcp(angles, np.eye(4)) for angles in data.q])
    middle = np.mean([flange[:3, :3] @ POINTS.mean(axis=0) + flange[:3, 3] for flange in tips], axis=0)
    size = np.linalg.norm(np.cross(turn, device[:3, :3] @ middle))
    (warning,) = moved_device.moved_device(harness.PRIOR, data, locate(harness.PRIOR, data))
    assert warning.startswith("from config 18 on the measuring device seems to have moved by ")
    stated = float(warning.split(" by ")[1].split(" mm")[0])
    assert size > 0.5e-3
    assert stated == pytest.approx(1e3 * size, abs=0.1)


@pytest.mark.parametrize("hidden", [False, True])
@pytest.mark.parametrize("factor", [1.0, 20.0])
def test_gross_readings_weigh_less_than_others_however_large_the_residuals_are(hidden, factor):
    """Weights of Huber are relative to the usual residual: all of them times a number keep the weights."""
    data = readings(forces(6, 50.0), count=6)
    if hidden:
        data = replace(data, used=~((data.state == 5) & (data.point == 2)))
    shift = np.random.default_rng(5).normal(0.0, 1e-5, (12, 4, 3))
    shift[::2] = 0.0
    shift[7, 1] = [2e-4, 0.0, 0.0]
    data = replace(data, position=data.position + factor * shift[data.state, data.point])
    structure = Structure(JOINT_COMPLIANCES, harness.PRIOR)
    weight = linearise(structure, SPRINGS, data, placed(data)).weight.reshape(6, 4, 3)
    distance = np.linalg.norm(shift[1::2], axis=2)
    seen = np.ones((6, 4), dtype=bool)
    seen[2, 2] = not hidden
    usual = np.median(distance[seen]) / np.sqrt(2.366)  # the median of χ² of three degrees of freedom
    expected = np.minimum(1.0, 3.5 * usual / distance)
    np.testing.assert_allclose(weight[seen], np.repeat(expected[seen][:, None], 3, axis=1), rtol=0.05)
    assert weight[3, 1, 0] < 0.3
    assert np.count_nonzero(weight[seen] < 1.0) == 3


def test_a_placement_states_the_rms_of_the_points_that_were_read():
    residual = np.zeros((2, 2, 3))
    residual[0, 0], residual[1, 1] = [3e-4, 0.0, 4e-4], [0.0, 1e-4, 0.0]
    assert Placement(np.eye(4), POINTS[:2], np.eye(12), residual).rms == pytest.approx(np.sqrt((25 + 1) / 2) * 1e-4)


def test_a_wrong_load_cell_makes_springs_softer_compensators_stiffer_and_masses_as_they_are():
    """All loads 2 % too large (95 %) shift the values together: by outer products of their signed shares."""
    parameters = (JOINT_COMPLIANCES[2], robot.CompensatorStiffness(), robot.Backlash("A4", 30.0), robot.LinkMass("A3"))
    values = np.array([3e-7, 8e4, 2e-5, 300.0])
    data = readings(forces(6, 500.0), count=6)
    fit = fit_of(data, values, covariance=np.diag((0.01 * values) ** 2), parameters=parameters)
    for error in (0.02, 0.0):
        wider = uncertainty.add_stated_errors(fit, replace(data, load_error=error), placed(data), None)
        shift = error / 1.959964 * values * [1.0, -1.0, 0.0, 0.0]
        np.testing.assert_allclose(wider.covariance, fit.covariance + np.outer(shift, shift), rtol=1e-9)


@pytest.mark.parametrize(
    ("even", "advice"), [(0.81, "plan compensator"), (0.79, "Spread the markers evenly around P0")]
)
def test_spreading_markers_is_advised_where_it_narrows_the_intervals_by_a_fifth(even, advice):
    """Of a_x and a_y together; that of L does not count."""
    ci95 = np.array([1.0, 4e-3, 3e-3])
    ci95_even = np.array([9.0, 3e-3 * even, 4e-3 * even])
    markers = MarkerPlacement(("P01",), np.array([0.1]), np.zeros(1), np.zeros(3), ci95_even)
    text = compensator_geometry._remedy(markers, ci95)
    assert advice in text
    if "Spread" in advice:
        assert f"a_x ± {3.0 * even:.1f} mm, a_y ± {4.0 * even:.1f} mm with as many readings" in text


def test_frames_and_points_are_written_in_millimetres_and_degrees():
    root = np.eye(4)
    root[:3, :3] = Rotation.from_euler("ZYX", [30.0, -20.0, 10.0], degrees=True).as_matrix()
    root[:3, 3] = [1.2, -3.4, 0.8]
    placement = Placement(root, POINTS[:2], np.eye(12), np.zeros((1, 2, 3)))
    frame = {"X": 1200.0, "Y": -3400.0, "Z": 800.0, "A": 30.0, "B": -20.0, "C": 10.0}
    assert base_frame(placement) == pytest.approx(frame)
    found = point_table(placement, ("P1", "P2"))
    assert found["P1"] == pytest.approx({"X": 0.0, "Y": 0.0, "Z": 120.0})
    assert found["P2"] == pytest.approx({"X": 300.0, "Y": 0.0, "Z": 50.0})


@pytest.mark.parametrize(("size", "named"), [(0.19e-3, False), (0.21e-3, True)])
def test_a_device_that_moved_by_less_than_a_fifth_of_a_millimetre_is_not_named(size, named):
    count = 30
    data = readings(forces(count, 500.0), count=count)
    rng = np.random.default_rng(6)
    data = replace(data, position=data.position + rng.normal(0.0, 1e-6, data.position.shape))
    rows = data.state_config[data.state] >= 11
    data = replace(data, position=data.position + np.where(rows[:, None], size * np.array([0.0, 0.6, 0.8]), 0.0))
    found = moved_device.moved_device(harness.PRIOR, data, locate(harness.PRIOR, data))
    assert bool(found) == named
    assert not named or found[0].startswith("from config 12 on")
