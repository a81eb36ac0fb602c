import json
import tomllib

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from postproc.compensator import Compensator
from postproc.errors import InputError, MeasurementError
from postproc.identification import compensator_geometry as cg
from postproc.jobs.identification_files import identify_compensator
from tests.commands import run

TRUE = np.array([0.18472, 0.68593, 0.12330])
PAPER_Q2 = np.radians([0.0, -30.0, -60.0, -90.0, -120.0, -140.0])


def readings(q2=PAPER_Q2, sigma=0.03e-3, repeats=3, markers=4, seed=0, true=TRUE):
    """Mechanism built from Eq. (3)'s triangle; tracker tilted at random."""
    rng = np.random.default_rng(seed)
    L, ax, ay = true
    p1 = L * np.c_[np.cos(q2), np.sin(q2), 0 * q2]
    p0 = -np.array([ax, ay, 0.0])
    spring = p1 - p0
    np.testing.assert_allclose(np.linalg.norm(spring, axis=1), Compensator(1.0, 0.1, L, ax, ay).length(q2), rtol=1e-12)
    turn = np.arctan2(spring[:, 1], spring[:, 0])
    beta, radius = [0.5, 1.9, 0.5 + np.pi, 1.9 + np.pi], [0.15, 0.12, 0.15, 0.12]
    bodies = [
        p0 + np.c_[r * np.cos(b + turn), r * np.sin(b + turn), 0.03 * j + 0 * turn]
        for j, (b, r) in enumerate(zip(beta, radius, strict=True))
    ]
    axes, shift = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-3, 3, 3)
    clean = np.array([p1, *bodies[:markers]]) @ axes.T + shift
    raw = clean[:, :, None] + rng.normal(0.0, sigma, (*clean.shape[:2], repeats, 3))
    mean = raw.mean(axis=2)
    scatter = float(((raw - mean[:, :, None]) ** 2).sum())
    names = tuple(f"P0{j + 1}" for j in range(markers))
    count = np.full(mean.shape[:2], float(repeats))
    dof = 3 * (repeats - 1) * count.size
    return cg.MarkerReadings(q2, names, mean[0], mean[1:], count[0], count[1:], scatter, dof), raw


def write(path, q2, raw, names):
    rows = ["q2,marker,repeat,X,Y,Z"]
    for name, marker in zip(names, raw, strict=True):
        for angle, repeated in zip(np.degrees(q2), marker, strict=True):
            for r, (x, y, z) in enumerate(repeated * 1e3):
                rows.append(f"{angle:g},{name},{r + 1},{x:.4f},{y:.4f},{z:.4f}")
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("markers", [1, 2, 4])
def test_noise_free_readings_give_the_true_geometry_in_any_tracker_frame(markers):
    for seed in range(3):
        exact, _ = readings(sigma=0.0, markers=markers, seed=seed)
        np.testing.assert_allclose(cg.identify(exact).lengths, TRUE, atol=1e-9)


@pytest.mark.parametrize(("markers", "repeats"), [(4, 3), (2, 1)])
def test_95_percent_intervals_cover_the_truth_in_95_percent_of_120_runs(markers, repeats):
    results = [cg.identify(readings(seed=s, markers=markers, repeats=repeats)[0]) for s in range(120)]
    inside = np.array([np.abs(r.lengths - TRUE) <= r.ci95 for r in results]).mean(axis=0)
    assert np.all((inside > 0.89) & (inside < 0.995)), inside  # 120 runs: ±4 %
    assert np.mean([r.sigma for r in results]) == pytest.approx(0.03e-3, rel=0.05)


def with_errors_of_angles(seed, size=0.1e-3):
    """Return readings whose markers share an error at each angle, as of a device that drifts, and the noise of repeats.

    :param size: standard deviation of one coordinate [m].
    """
    exact, _ = readings(seed=seed)
    errors = np.random.default_rng(1000 + seed).normal(0.0, size, (1 + len(exact.p0), len(exact.q2), 3))
    return msgspec.structs.replace(exact, p1=exact.p1 + errors[0], p0=exact.p0 + errors[1:])


def test_intervals_contain_errors_that_the_repeats_share():
    results = [cg.identify(with_errors_of_angles(seed)) for seed in range(120)]
    inside = np.array([np.abs(r.lengths - TRUE) <= r.ci95 for r in results]).mean(axis=0)
    assert np.all((inside > 0.89) & (inside < 0.995)), inside  # 120 runs: ±4 %
    # a reading: its own noise and, three times in three repeats, the error of its angle
    assert np.mean([r.sigma for r in results]) == pytest.approx(np.hypot(0.03e-3, np.sqrt(3) * 0.1e-3), rel=0.05)


def test_a_tracker_that_was_moved_between_the_angles_is_a_warning_with_both_scatters():
    exact, _ = readings(sigma=0.02e-3)
    moved = np.degrees(exact.q2) < -75.0
    shift = np.array([0.8e-3, 0.5e-3, 0.0]) * moved[:, None]
    (warning,) = cg.identify(msgspec.structs.replace(exact, p1=exact.p1 + shift, p0=exact.p0 + shift)).warnings
    scatter = float(warning.split("scatter by ")[1].split(" mm")[0])
    assert scatter == pytest.approx(0.02, rel=0.1)  # of some 90 degrees of freedom
    assert "Check that the tracker was not moved between the angles" in warning
    false_alarms = sum(bool(cg.identify(readings(seed=seed)[0]).warnings) for seed in range(100))
    assert false_alarms <= 1  # 0.1 are expected


def test_a_single_marker_still_gives_an_estimate_and_says_how_poor_it_is():
    result = cg.identify(readings(markers=1, repeats=1)[0])
    assert np.all(np.abs(result.lengths - TRUE) < 2.0 * result.ci95)
    assert result.ci95[0] < 0.1e-3 < 2e-3 < result.ci95[1]


def test_paper_q2_set_determines_a_ten_times_less_sharply_than_L():
    result = cg.identify(readings()[0])
    assert np.degrees(result.turn) == pytest.approx(13.2, abs=0.1)
    assert result.ci95[1] / result.ci95[0] > 4.0


def test_file_round_trip_writes_values_with_intervals(tmp_path):
    exact, raw = readings()
    path = write(tmp_path / "c.csv", PAPER_Q2, raw, ("P1", *exact.markers))
    result = cg.identify(cg.read(path))
    np.testing.assert_allclose(result.lengths, cg.identify(exact).lengths, atol=1e-7)
    cg.save(tmp_path / "out.toml", result, "c.csv")
    content = tomllib.loads((tmp_path / "out.toml").read_text())
    for key, value, ci in zip(("L_mm", "a_x_mm", "a_y_mm"), result.lengths, result.ci95, strict=True):
        assert content[key]["value"] == pytest.approx(value * 1e3, abs=1e-5)
        assert content[key]["ci95"] == pytest.approx(ci * 1e3, abs=1e-5)


def test_an_outlier_among_repeats_is_left_out_and_named(tmp_path):
    exact, raw = readings()
    raw[2, 3, 1] += [0.0, 3e-3, 0.0]
    result = cg.identify(cg.read(write(tmp_path / "c.csv", PAPER_Q2, raw, ("P1", *exact.markers))))
    assert np.all(np.abs(result.lengths - TRUE) < 2.5 * result.ci95)
    assert any("P02 at q2 = -90°" in w and "left out" in w for w in result.warnings)


def test_swapped_marker_names_are_an_error_that_names_the_marker(tmp_path):
    exact, raw = readings()
    raw[[1, 2], 4] = raw[[2, 1], 4]
    with pytest.raises(MeasurementError, match=r"at q2 = -120° .*The names of P01 and P02 are swapped"):
        cg.identify(cg.read(write(tmp_path / "c.csv", PAPER_Q2, raw, ("P1", *exact.markers))))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.replace("-120,P02", "-120,P09"), "no reading of marker P02 at q2 = -120"),
        (lambda t: "\n".join(r for r in t.splitlines() if ",P1," not in r), "no readings of marker P1"),
        (lambda t: t.replace("P03", "Q3"), "unknown marker 'Q3'"),
        (lambda t: t.replace(",Z\n", ",Z,W\n", 1), "unknown column 'W'"),
        (lambda t: t + "-30,P1,4,1,nan,3\n", "not a finite number"),
        (lambda t: t + t.splitlines()[1] + "\n", "repeat is given twice"),
        (lambda t: "\n".join(r for r in t.splitlines() if r[0] == "q" or r.startswith(("0,", "-30,"))), "2 angles q2"),
    ],
)
def test_bad_marker_files_say_what_is_wrong(tmp_path, change, message):
    exact, raw = readings()
    path = write(tmp_path / "c.csv", PAPER_Q2, raw, ("P1", *exact.markers))
    path.write_text(change(path.read_text()))
    with pytest.raises(MeasurementError, match=message):
        cg.read(path)


def test_angles_in_radians_are_recognised(tmp_path):
    exact, raw = readings()
    path = write(tmp_path / "c.csv", np.radians(PAPER_Q2), raw, ("P1", *exact.markers))
    with pytest.raises(MeasurementError, match="look like radians"):
        cg.read(path)


@pytest.mark.parametrize(
    ("angles", "words"),
    [
        ([-6.28, 0.0, 1.0], "all q2 lie between -6.28 and 1: these look like radians"),
        ([-6.29, 0.0, 20.0], None),
        ([0.0, 6.0], "2 angles q2 over 6°: too few for a circle"),
        ([], "0 angles q2 over 0°: too few for a circle"),
        ([-100.0, -98.0, -90.1], "3 angles q2 over 9.9°: too few for a circle"),
        ([-100.0, -98.0, -89.9], None),
    ],
)
def test_three_angles_over_ten_degrees_are_a_circle_unless_all_are_within_a_turn_in_radians(angles, words):
    if words is None:
        cg._check_angles(np.array(angles), "c.csv")
        return
    with pytest.raises(MeasurementError) as refused:
        cg._check_angles(np.array(angles), "c.csv")
    assert (refused.value.problem, refused.value.file) == (words, "c.csv")


def test_metres_are_recognised(tmp_path):
    exact, raw = readings()
    path = write(tmp_path / "c.csv", PAPER_Q2, raw, ("P1", *exact.markers))
    text = path.read_text().splitlines()  # all digits: `write` rounds to those of millimetres
    rows = [row.rsplit(",", 3)[0] for row in text[1:]]
    numbers = [f"{x:.7f},{y:.7f},{z:.7f}" for marker in raw for repeated in marker for x, y, z in repeated]
    path.write_text("\n".join([text[0], *(f"{row},{xyz}" for row, xyz in zip(rows, numbers, strict=True)), ""]))
    with pytest.raises(MeasurementError, match="look like metres"):
        identify_compensator(path, tmp_path / "compensator.toml")
    assert not (tmp_path / "compensator.toml").exists()


@pytest.mark.parametrize("factor", [0.05, 20.0])
def test_a_size_that_the_next_command_would_refuse_is_refused(factor):
    """L of 9 mm, and of 3.7 m."""
    exact, _ = readings(sigma=0.0, true=factor * TRUE)
    with pytest.raises(MeasurementError, match="no robot has such a compensator"):
        cg.identify(exact)
    assert cg.identify(readings(sigma=0.0, true=0.1 * TRUE)[0]).lengths[0] == pytest.approx(0.1 * TRUE[0])


def test_the_readings_are_never_overwritten(tmp_path):
    markers = tmp_path / "markers.csv"
    markers.write_text("q2,marker,repeat,X,Y,Z\n")
    with pytest.raises(InputError, match="this input would be overwritten"):
        identify_compensator(markers, tmp_path / "MARKERS.csv", overwrite=True)
    assert markers.read_text() == "q2,marker,repeat,X,Y,Z\n"


def test_json_is_what_is_written(tmp_path):
    exact, raw = readings()
    path = write(tmp_path / "c.csv", PAPER_Q2, raw, ("P1", *exact.markers))
    done = run("identify", "compensator", path, "-o", tmp_path / "out.toml", "--json")
    shown, content = json.loads(done.stdout), tomllib.loads((tmp_path / "out.toml").read_text())
    assert shown.keys() == content.keys()
    assert shown["L_mm"]["value"] == pytest.approx(content["L_mm"]["value"], rel=1e-9)


def simulated(beta, sigma, runs, q2=PAPER_Q2, radius=0.15, seed=0):
    """Estimates of many runs from positions by complex numbers, in the axes of the mechanism, one reading each."""
    rng = np.random.default_rng(seed)
    L, ax, ay = TRUE
    pivot = -(ax + 1j * ay)
    p1 = L * np.exp(1j * q2)
    body = np.exp(1j * np.angle(p1 - pivot))
    points = np.stack([p1, *(pivot + radius * np.exp(1j * b) * body for b in beta)])
    exact = np.stack([points.real, points.imag, 0 * points.real], axis=-1)
    noisy = exact + rng.normal(0.0, sigma, (runs, *exact.shape))
    return exact, cg.geometry(q2, noisy[:, 0], noisy[:, 1:]) - TRUE


@pytest.mark.parametrize("beta", [[0.0, 0.3, 0.6, 0.9], [0.0, np.pi / 2]])
def test_the_bias_of_eq_7_is_the_mean_error_of_simulated_readings(beta):
    sigma, runs = 0.3e-3, 40_000
    exact, error = simulated(beta, sigma, runs)
    bias = -cg.pivot_bias(exact[1:], np.full((len(beta), len(PAPER_Q2)), sigma**2))[:2]
    standard_error = error[:, 1:].std(axis=0) / np.sqrt(runs)
    assert np.all(np.abs(error[:, 1:].mean(axis=0) - bias) < 3.5 * standard_error + 0.05 * np.abs(bias))
    assert np.linalg.norm(bias) > 8.0 * np.linalg.norm(standard_error)  # else nothing is compared


def test_markers_that_fulfil_the_paper_condition_leave_no_bias():
    for beta in ([0.5, 1.9, 0.5 + np.pi, 1.9 + np.pi], cg.even_angles(3)):
        exact, _ = simulated(beta, 0.0, 1)
        assert np.abs(cg.pivot_bias(exact[1:], np.full((len(beta), 6), 1e-8))).max() < 1e-12


@pytest.mark.parametrize("beta", [[0.5, 1.9, 0.5 + np.pi, 1.9 + np.pi], [0.0, 0.6], [0.0, np.pi]])
def test_the_expected_covariance_is_that_of_simulated_readings(beta):
    _, error = simulated(beta, 0.03e-3, 4000)
    expected = cg.expected_covariance(TRUE, PAPER_Q2, np.full(len(beta), 0.15), np.array(beta), 0.03e-3**2)
    # standard deviation of a standard deviation over 4000 runs: 1.1 %
    np.testing.assert_allclose(error.std(axis=0), np.sqrt(np.diag(expected)), rtol=0.06)


def test_the_places_of_the_markers_are_found_from_the_readings():
    markers = cg.identify(readings()[0]).markers
    np.testing.assert_allclose(markers.radius, [0.15, 0.12, 0.15, 0.12], atol=1e-3)
    np.testing.assert_allclose(markers.angle, [0.5, 1.9, 0.5 - np.pi, 1.9 - np.pi], atol=1e-2)
    assert np.linalg.norm(markers.sums) < 1e-3
    assert markers.imbalance < 2e-3


def test_markers_on_one_side_are_told_their_condition_its_bias_and_the_intervals_of_spread_ones():
    one_sided = cg.identify(readings(markers=2)[0])
    expected = 0.15 * np.exp(0.5j) + 0.12 * np.exp(1.9j)
    np.testing.assert_allclose(one_sided.markers.sums, [expected.real, expected.imag], atol=2e-3)
    assert one_sided.markers.imbalance == pytest.approx(abs(expected) / 0.27, abs=0.01)
    text = "\n".join(cg.text_lines(one_sided))
    assert f"Σ R cos β = {one_sided.markers.sums[0] * 1e3:.1f} mm" in text
    assert f"a_x ± {one_sided.markers.ci95_even[1] * 1e3:.3f} mm" in text


def test_intervals_of_evenly_spread_markers_are_those_that_such_readings_give():
    close, _ = simulated([0.0, 0.5, 1.0], 0.0, 1)
    even, _ = simulated(cg.even_angles(3), 0.0, 1)
    count = np.ones((4, 6))
    found = [
        cg.identify(cg.MarkerReadings(PAPER_Q2, ("P01", "P02", "P03"), e[0], e[1:], count[0], count[1:], 1e-7, 100))
        for e in (close, even)
    ]
    np.testing.assert_allclose(found[0].markers.ci95_even, found[1].ci95, rtol=1e-3)
    assert found[0].ci95[1] > 1.5 * found[1].ci95[1]


def test_a_bias_as_large_as_the_noise_widens_the_intervals():
    exact, _ = readings(markers=1, sigma=0.0)
    noisy = msgspec.structs.replace(exact, scatter=exact.scatter_dof * (0.1e-3) ** 2)
    result = cg.identify(noisy)
    variance = np.full(exact.count_p0.shape, result.sigma**2) / exact.count_p0
    noise = cg.noise_covariance(PAPER_Q2, exact.p1, exact.p0, result.sigma**2 / exact.count_p1, variance)
    grown = np.diag(result.covariance) - np.diag(noise)
    np.testing.assert_allclose(grown, result.markers.bias**2, rtol=1e-6, atol=1e-16)
    assert result.markers.bias[1] ** 2 > 0.01 * noise[1, 1]


def test_the_bias_holds_every_term_on_a_wide_arc_of_few_points():
    """One marker at four angles: the leverage of each point is a half, so no term of the bias is small."""
    angle, sigma, runs = np.radians([0.0, 40.0, 75.0, 120.0]), 1e-3, 80_000
    exact = 0.15 * np.c_[np.cos(angle), np.sin(angle), 0 * angle][None]
    noise = np.random.default_rng(8).normal(0.0, sigma, (runs, *exact.shape)) * [1.0, 1.0, 0.0]
    found = 0.5 * (cg.swivel_axis(exact + noise)[0] + cg.swivel_axis(exact - noise)[0])  # without the first order
    bias = cg.pivot_bias(exact, np.full((1, 4), sigma**2))
    assert np.linalg.norm(found.std(axis=0)) / np.sqrt(runs) < 0.025 * np.linalg.norm(bias)
    assert np.linalg.norm(found.mean(axis=0) - bias) < 0.08 * np.linalg.norm(bias)


def test_the_result_is_the_same_in_any_tracker_frame():
    exact, _ = readings(markers=2, sigma=0.2e-3)
    turn, shift = Rotation.from_rotvec([0.4, -1.0, 0.7]).as_matrix(), np.array([2.0, -1.0, 0.5])
    moved = msgspec.structs.replace(exact, p1=exact.p1 @ turn.T + shift, p0=exact.p0 @ turn.T + shift)
    one, other = cg.identify(exact), cg.identify(moved)
    np.testing.assert_allclose(other.lengths, one.lengths, rtol=0, atol=1e-10)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-6)
    np.testing.assert_allclose(other.markers.bias, one.markers.bias, rtol=1e-6)
    assert one.markers.bias[0] == 0.0
    assert np.abs(one.markers.bias[1:]).min() > 1e-6
    for name in ("radius", "angle", "ci95_even"):
        np.testing.assert_allclose(getattr(other.markers, name), getattr(one.markers, name), rtol=1e-6)
    assert (one.dof, other.sigma) == (exact.scatter_dof + 18 - 7 + 24 - 4 - 4, pytest.approx(one.sigma, rel=1e-9))


def test_everything_in_the_file_is_in_millimetres_and_degrees(tmp_path):
    result = cg.identify(readings(markers=2)[0])
    cg.save(tmp_path / "out.toml", result, "c.csv")
    content, markers = tomllib.loads((tmp_path / "out.toml").read_text()), result.markers
    for key, value in (
        ("sigma_mm", result.sigma * 1e3), ("turn_deg", np.degrees(result.turn)), ("source", "c.csv"),
        ("covariance_mm2", result.covariance * 1e6), ("warnings", list(result.warnings)),
    ):  # fmt: skip
        assert content[key] == value if key in ("source", "warnings") else np.allclose(content[key], value, rtol=1e-6)
    for key, value in (
        ("R_mm", markers.radius * 1e3), ("beta_deg", np.degrees(markers.angle)), ("bias_mm", markers.bias * 1e3),
        ("sum_R_cos_beta_mm", np.sum(markers.radius * np.cos(markers.angle)) * 1e3),
        ("sum_R_sin_beta_mm", np.sum(markers.radius * np.sin(markers.angle)) * 1e3),
        ("imbalance", markers.imbalance), ("ci95_even_mm", markers.ci95_even * 1e3),
    ):  # fmt: skip
        np.testing.assert_allclose(content["markers"][key], value, rtol=1e-6, err_msg=key)
    np.testing.assert_allclose(cg.load(tmp_path / "out.toml"), result.lengths, rtol=1e-9)
    text = "\n".join(cg.text_lines(result))
    assert f"would give {markers.radius.sum() * 1e3:.1f} mm" in text
    assert f"a_x {markers.bias[1] * 1e3:.4f} mm, a_y {markers.bias[2] * 1e3:.4f} mm, contained" in text
    assert f"   L = {result.lengths[0] * 1e3:8.3f} ± {result.ci95[0] * 1e3:.3f} mm" in text


@pytest.mark.parametrize(("span", "refused"), [(9.9, True), (10.1, False)])
def test_angles_over_less_than_ten_degrees_are_too_few_for_a_circle(tmp_path, span, refused):
    q2 = np.radians(np.linspace(-40.0, -40.0 - span, 4))
    exact, raw = readings(q2=q2, sigma=0.0)
    path = write(tmp_path / "c.csv", q2, raw, ("P1", *exact.markers))
    if refused:
        with pytest.raises(MeasurementError, match=r"4 angles q2 over 9\.9°: too few for a circle"):
            cg.read(path)
    else:
        assert len(cg.read(path).q2) == 4


def spread(tmp_path, points):
    """Readings whose repeats deviate by ±0.1 mm; those of some points (marker, angle) by offsets (n, 3) [mm]."""
    exact, _ = readings(sigma=0.0)
    mean = np.array([exact.p1, *exact.p0])
    rows = ["q2,marker,repeat,X,Y,Z"]
    for k, name in enumerate(("P1", *exact.markers)):
        for a, q2 in enumerate(np.degrees(PAPER_Q2)):
            for r, offset in enumerate(points.get((k, a), 0.1 * np.array([[-1, -1, -1], [0, 0, 0], [1, 1, 1]]))):
                x, y, z = mean[k, a] * 1e3 + offset
                rows.append(f"{q2:g},{name},{r + 1},{x:.9f},{y:.9f},{z:.9f}")
    (tmp_path / "c.csv").write_text("\n".join(rows) + "\n")
    return cg.read(tmp_path / "c.csv")


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("by", "out"), [(0.99, False), (1.01, True)])
def test_a_repeat_farther_from_the_others_than_nine_standard_deviations_is_left_out(tmp_path, axis, by, out):
    """The median deviation of the outer two of three repeats, 0.1 mm here, is 0.9 standard deviations."""
    offsets = np.zeros((3, 3))
    offsets[2, axis] = by * 9.0 * 0.1 / 0.9
    found = spread(tmp_path, {(2, 3): offsets})
    assert found.count_p0[1, 3] == 3 - out
    assert found.count_p0.sum() + found.count_p1.sum() == 5 * 6 * 3 - out
    expected = (
        f"line {1 + 2 * 18 + 3 * 3 + 3}: marker P02 at q2 = -90° is {by:.2f} mm from its other repeats: left out",
    )
    assert found.warnings == (expected if out else ())


def test_no_repeat_is_left_out_where_the_others_do_not_outvote_it(tmp_path):
    far = {
        (1, 0): np.array([[0.0, 0, 0], [5.0, 0, 0]]),
        (2, 1): np.array([[0.0, 0, 0], [0, 0, 0.1], [5, 0, 0], [5, 0, 0.1]]),
    }
    found = spread(tmp_path, far)
    assert found.warnings == ()
    assert (found.count_p0[0, 0], found.count_p0[1, 1]) == (2, 4)
    assert found.scatter == pytest.approx((28 * 6 * 0.1**2 + 12.5 + 25.0 + 0.01) * 1e-6, rel=1e-6)
    assert found.scatter_dof == 28 * 6 + 3 + 9


@pytest.mark.parametrize(("by", "refused"), [(1.99e-3, False), (2.01e-3, True)])
def test_a_marker_more_than_two_millimetres_off_its_circle_is_refused(by, refused):
    """All markers move together along the normal, as no circle does, and keep their distances."""
    exact, _ = readings(sigma=0.0)
    _, axes, _ = cg.joint_circle(exact.q2, exact.p1)
    flat = (exact.p0 @ axes[:, :2]).sum(axis=0)
    _, _, rest = np.linalg.svd(np.column_stack([np.ones(6), flat]).T)
    pattern = rest[-1] / np.abs(rest[-1]).max()  # no plane follows it
    wrong = msgspec.structs.replace(exact, p0=exact.p0 + by * pattern[:, None] * axes[:, 2])
    if not refused:
        cg.identify(wrong)
        return
    angle = np.degrees(PAPER_Q2[np.argmax(np.abs(pattern))])
    with pytest.raises(MeasurementError, match=rf"up to 2\.0 mm off its circle \(at q2 = {angle:g}°\)"):
        cg.identify(wrong)


@pytest.mark.parametrize(("by", "refused"), [(1.9e-3, False), (2.1e-3, True)])
def test_markers_that_change_their_distance_by_more_than_two_millimetres_are_refused(by, refused):
    exact, _ = readings(sigma=0.0, markers=3)
    p0 = exact.p0.copy()
    away = p0[1, 2] - p0[0, 2]
    p0[1, 2] += by * away / np.linalg.norm(away)
    wrong = msgspec.structs.replace(exact, p0=p0)
    if not refused:
        cg.identify(wrong)
        return
    with pytest.raises(MeasurementError, match=r"at q2 = -60° .* distances \(2\.1 mm\)\. Measure this angle again"):
        cg.identify(wrong)


def test_intervals_wider_than_a_twentieth_of_the_distance_are_a_warning():
    """Of a compensator that hardly turned, under more and more noise."""
    q2, limit = np.radians([-60.0, -64.0, -68.0, -72.0]), 0.05 * np.hypot(TRUE[1], TRUE[2])
    told = {}
    for sigma in np.geomspace(0.2e-3, 0.45e-3, 25):
        found = cg.identify(readings(q2, sigma=sigma)[0])
        told[found.ci95.max() / limit] = any("the compensator turned by only" in text for text in found.warnings)
    assert (
        max(share for share, warned in told.items() if not warned)
        < 1.0
        < min(s for s, warned in told.items() if warned)
    )
    assert any(0.8 < share < 1.0 for share in told)
    assert any(1.0 < share < 1.25 for share in told)


def test_repeats_of_evenly_spread_markers_narrow_their_intervals_as_they_narrow_those_measured():
    """Four readings of each of even markers: the intervals of even markers are the markers' own."""
    exact, _ = simulated(cg.even_angles(3), 0.0, 1)
    count = np.full((4, 6), 4.0)
    found = cg.identify(
        cg.MarkerReadings(PAPER_Q2, ("P01", "P02", "P03"), exact[0], exact[1:], count[0], count[1:], 1e-7, 100)
    )
    np.testing.assert_allclose(found.markers.ci95_even, found.ci95, rtol=1e-3)


@pytest.mark.parametrize(("ax", "ay", "check"), [
    (0.68, 0.12, ""), (0.62, 0.19, ""), (0.56, 0.19, "the zero of q2"), (0.67, -0.14, "the sign of q2"),
    (-0.69, 0.12, "the zero of q2"),
])  # fmt: skip
def test_a_pivot_far_from_that_of_the_robot_model_is_a_doubt(ax, ay, check):
    stated = Compensator(1.2e5, 0.458, 0.185, 0.686, 0.123)
    doubt = cg.pivot_doubt(Compensator(0.0, 0.0, 0.19, ax, ay), stated)
    assert bool(doubt) == bool(check)
    if check:
        assert f"comes out at ({ax * 1e3:.0f}, {ay * 1e3:.0f}) mm, and the robot model has it at (686, 123) mm" in doubt
        assert f": check {check}" in doubt
    assert cg.pivot_doubt(stated, None) == ""
