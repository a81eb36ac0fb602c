"""Formats of real measurements: displacements, one point, angles of other controllers, folders to publish."""

import hashlib
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import robot
from postproc.errors import MeasurementError
from postproc.identification import dataset
from postproc.identification.procedure import check_readings, identify
from postproc.identification.readings import read, read_experiment
from samples.paper_study import harness, simulator
from tests.commands import invoke

DATASET = """name = "simulated robot"
licence = "MIT"
source = "samples/paper_study/simulator.py"
robot = "simulated KR 270"
rig = "simulated pull"
device = "simulated tracker, 0.03 mm"
"""


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A folder with readings of one point in 14 configurations; the configurations; true displacements (14, 3) [m]."""
    folder = tmp_path_factory.mktemp("measured")
    rng = np.random.default_rng(4)
    true, (q, f) = simulator.paper_like(rng), simulator.plan(rng, 14)
    points = {"P1": simulator.POINTS["P1"]}
    _, raw = simulator.measure(true, q, f, rng, 1e-6, points=points)
    simulator.write(folder, q, f, raw, 1e-6, points=points)
    at = np.array(points["P1"])
    moved = [true.solve(q, force) for force in (f, 0.0 * f)]
    shift = [pose[:, :3, 3] + pose[:, :3, :3] @ at for pose in moved]
    return folder, q, shift[0] - shift[1]


def changed(folder, path, row, head=""):
    """Copy the experiment with lines at its head, and the rows of its readings after a change; None leaves one out."""
    lines = (folder / "measurements.csv").read_text().splitlines()
    rows = [row(line.split(",")) for line in lines[1:]]
    text = [lines[0], *(",".join(cells) for cells in rows if cells is not None)]
    (path / "measurements.csv").write_text("\n".join(text) + "\n")
    (path / "experiment.toml").write_text(head + (folder / "experiment.toml").read_text())
    return read(path / "measurements.csv", read_experiment(path / "experiment.toml"))


def test_displacements_of_one_point_without_unloaded_readings_give_the_same_springs(measured, tmp_path):
    folder, _, moved = measured

    def row(cells):
        if cells[1] == "0" or cells[2] != "1":
            return None
        return [*cells[:16], *(f"{1e3 * value:.6f}" for value in moved[int(cells[0]) - 1])]

    data = changed(folder, tmp_path, row, 'readings = "displacements"\n')
    by_displacement = identify(harness.PRIOR, data, depth="joints").fit.values
    by_position = identify(harness.PRIOR, harness.load(folder), depth="joints").fit.values
    np.testing.assert_allclose(by_displacement, by_position, rtol=0.01)


def displacements_in_axes(folder, turn_deg, points, axis=(0.0, 0.0, 1.0)):
    """Read displacements of some points of a simulated robot, in axes that are turned about one of the root."""
    rng = np.random.default_rng(5)
    true, (q, f) = simulator.paper_like(rng), simulator.plan(rng, 14)
    places = {name: simulator.POINTS[name] for name in points}
    at_rest, loaded = (true.solve(q, force) for force in (0.0 * f, f))
    turn = simulator.rot(np.array(axis), np.radians([turn_deg]))[0]
    moved = {
        name: (loaded[:, :3] @ [*place, 1.0] - at_rest[:, :3] @ [*place, 1.0]) @ turn.T
        for name, place in places.items()
    }
    raw = np.stack([np.stack([moved[name]] * 2, axis=1) for name in places], axis=2)[:, :, None]
    simulator.write(folder, q, f, raw, 0.03e-3, points=places)
    return changed(folder, folder, lambda cells: None if cells[1] == "0" else cells, 'readings = "displacements"\n')


@pytest.mark.parametrize("turn_deg", [70.0, 180.0])
def test_displacements_in_axes_of_the_device_are_no_motion_of_a_rigid_body(tmp_path, turn_deg):
    right = displacements_in_axes(tmp_path, 0.0, simulator.POINTS)
    assert check_readings(harness.PRIOR, right).outliers == []
    turned = displacements_in_axes(tmp_path, turn_deg, simulator.POINTS)
    with pytest.raises(MeasurementError, match=r"no rigid body. .* must be in the axes of the robot root"):
        check_readings(harness.PRIOR, turned)


def test_a_point_that_moves_as_far_as_it_should_but_elsewhere_is_no_wrong_unit(tmp_path):
    turned = displacements_in_axes(tmp_path, 90.0, ["P1"], axis=(1.0, 0.0, 0.0))
    with pytest.raises(MeasurementError, match=r"times as far as kuka_kr270 would, but in other directions"):
        check_readings(harness.PRIOR, turned)


def test_displacements_with_a_parallelogram_that_is_not_declared_say_what_to_check(measured, tmp_path):
    folder, _, moved = measured

    def row(cells):
        if cells[1] == "0":
            return None
        j3 = float(cells[6]) + float(cells[5])  # of a controller that counts J3 from the horizontal
        return [*cells[:6], f"{j3:.6f}", *cells[7:16], *(f"{1e3 * value:.6f}" for value in moved[int(cells[0]) - 1])]

    head = 'readings = "displacements"\n'
    declared = changed(folder, tmp_path, row, f"{head}angles = {{ A3_per_J2 = -1 }}\n")
    assert check_readings(harness.PRIOR, declared).outliers == []
    with pytest.raises(MeasurementError, match=r"Check \[angles\] too: sign, offset_deg and A3_per_J2"):
        check_readings(harness.PRIOR, changed(folder, tmp_path, row, head))


def test_angles_of_a_controller_with_a_parallelogram_are_read(measured, tmp_path):
    folder, q, _ = measured
    sign, offset = np.array([-1, 1, -1, 1, -1, 1]), np.array([10.0, -90.0, 30.0, 0.0, 5.0, 0.0])

    def row(cells):
        joints = (np.array(cells[4:10], dtype=float) - offset) * sign
        joints[2] -= sign[2] * -1 * joints[1]  # A3 = sign·J3 + offset − J2
        return [*cells[:4], *(f"{value:.6f}" for value in joints), *cells[10:]]

    head = f"angles = {{ sign = {sign.tolist()}, offset_deg = {offset.tolist()}, A3_per_J2 = -1 }}\n"
    data = changed(folder, tmp_path, row, head)
    np.testing.assert_allclose(data.q, q, atol=1e-7)


@pytest.mark.parametrize(
    ("row", "head", "message"),
    [
        (lambda cells: cells, 'readings = "displacements"\n', "load 0 has rows, but X, Y, Z are displacements"),
        (
            lambda cells: None if cells[1] == "0" else cells,
            'readings = "displacements"\n',
            "these look like positions",
        ),
        (lambda cells: cells, "angles = { sign = [1, 1] }\n", "sign needs six numbers"),
    ],
)
def test_formats_that_do_not_belong_together_are_refused(measured, tmp_path, row, head, message):
    with pytest.raises(MeasurementError, match=message):
        changed(measured[0], tmp_path, row, head)


def test_rows_without_x_y_and_z_are_points_that_the_device_did_not_see(measured, tmp_path):
    folder, _, _ = measured

    def row(cells, filled=0):
        return [*cells[:16], *cells[16 : 16 + filled], *[""] * (3 - filled)] if cells[2] == "2" else cells

    without = changed(folder, tmp_path, lambda cells: None if cells[2] == "2" else cells)
    empty = changed(folder, tmp_path, row)
    np.testing.assert_array_equal(empty.position, without.position)
    assert set(empty.repeat) == {1.0, 3.0}
    with pytest.raises(MeasurementError, match=r"measurements.csv:3: Y and Z empty. A reading has X, Y and Z"):
        changed(folder, tmp_path, lambda cells: row(cells, filled=1))
    with pytest.raises(MeasurementError, match="no readings"):
        changed(folder, tmp_path, lambda cells: [*cells[:16], "", "", ""])


def test_forces_are_compared_at_the_points_that_were_read(tmp_path):
    rng = np.random.default_rng(6)
    true, (q, f) = simulator.paper_like(rng), simulator.plan(rng, 8)
    _, raw = simulator.measure(true, q, f, rng, 1e-6)
    simulator.write(tmp_path, q, f, raw, 1e-6)

    def row(cells, force=1.0, seen=lambda config: 1 + config % 3):
        forces = [str(force * float(value)) for value in cells[10:13]]
        return [*cells[:10], *forces, *cells[13:]] if cells[3] == f"P{seen(int(cells[0]))}" else None

    (tmp_path / "trial").mkdir()
    data = changed(tmp_path, tmp_path / "trial", row)
    assert not [note for note in check_readings(harness.PRIOR, data).warnings if "as far as" in note]
    data = changed(tmp_path, tmp_path / "trial", lambda cells: row(cells, force=0.4))
    assert [note for note in check_readings(harness.PRIOR, data).warnings if "as far as" in note]


def published(measured, folder):
    changed(measured[0], folder, lambda cells: cells)
    (folder / "dataset.toml").write_text(DATASET)
    (folder / "LICENSE").write_text("MIT License\n")
    names = sorted(path.name for path in folder.iterdir())
    sums = [f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  ./{name}" for name in names]
    (folder / "SHA256SUMS").write_text("\n".join(sums) + "\n")


def test_a_folder_to_publish_says_what_it_has_and_lacks(measured, tmp_path):
    published(measured, tmp_path)
    run = invoke("identify", "check", tmp_path)
    assert run.exit_code == 0, run.output
    assert "has   SHA256SUMS: right for 4 files" in run.output
    assert "lacks 14 configurations; 30 are usual" in run.output
    assert re.search(r"lacks loads of \d+ to \d+ N on 1 levels", run.output)
    assert "lacks load_error_percent" in run.output
    assert "(required)" not in run.output


def test_each_statement_on_readings_is_one_that_a_folder_has_or_lacks():
    """Numbers of the readings by hand: one point, 14 configurations, one load, three repeats."""
    torque = np.array([100.0, 2000.0, 900.0, 41.0, 300.0, 39.0])
    found = dataset._torque_finding(torque)
    assert found.text == "torques up to 100, 2000, 900, 41, 300, 39 N·m on A1 … A6: A6 hardly loaded"
    assert not found.is_present
    found = dataset._torque_finding(np.maximum(torque, 41.0))
    assert (found.text, found.is_present) == ("torques up to 100, 2000, 900, 41, 300, 41 N·m on A1 … A6", True)


def test_what_readings_have_is_counted(measured, tmp_path):
    data = changed(measured[0], tmp_path, lambda cells: cells)
    found = {finding.text: finding.is_present for finding in dataset._reading_findings(data)}
    force = np.linalg.norm(data.wrench[data.load > 0.0, :3], axis=1)
    assert list(found.values()) == [True, False, False, True, False, True, True]
    texts = list(found)
    assert texts[0] == f"measurements.csv: {14 * 2 * 3} readings of positions, each state and point named"
    assert texts[1] == "14 configurations; 30 are usual"
    assert texts[2].startswith(f"loads of {force.min():.0f} to {force.max():.0f} N on 1 levels; two show")
    assert texts[3] == "3 repeats; 3 show the noise"
    assert texts[4] == "1 points; three show all six directions of a link"
    assert texts[6] == "every repeat has all points"

    def row(cells):
        if cells[1] == "0":
            return None
        return [*cells[:16], "0.1", "0.2", "0.3"] if cells[2] != "3" else None

    data = changed(measured[0], tmp_path, row, 'readings = "displacements"\n')
    found = dataset._reading_findings(data)
    assert [finding.is_present for finding in found] == [True, False, False, False, False, False, True]
    assert "readings of displacements" in found[0].text
    assert "2 repeats; 3 show the noise" in found[3].text


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (lambda cells: cells, "has   readings that agree with"),
        (
            lambda cells: [*cells[:12], str(-float(cells[12])), *cells[13:]],
            "lacks .*the loads fit .* times better if Fx, Fy, Fz of the root are the columns Fx, Fy, -Fz",
        ),
        (
            lambda cells: [*cells[:4], str(float(cells[4]) + 5.0 * (cells[0] == "3")), *cells[5:]],
            "lacks .*config 3: .* An A1 that is 4.99° smaller",
        ),
    ],
)
def test_a_folder_is_checked_against_its_robot(measured, tmp_path, row, message):
    published(measured, tmp_path)
    changed(measured[0], tmp_path, row)
    run = invoke("identify", "check", tmp_path)
    assert re.search(message, run.output), run.output


@pytest.mark.skipif(sys.platform == "win32", reason="the command is one of a POSIX shell")
def test_the_command_for_checksums_makes_right_ones_with_a_folder_of_the_robot(measured, tmp_path):
    published(measured, tmp_path)
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "model.toml").write_text("name = 'X'\n")
    run = invoke("identify", "check", tmp_path)
    assert "lacks SHA256SUMS: none for robot/model.toml; run `" in run.output
    subprocess.run(re.search(r"run `(.+)` in the folder", run.output)[1], shell=True, cwd=tmp_path, check=True)
    sums = tmp_path / "SHA256SUMS"
    sums.write_bytes(sums.read_bytes().replace(b"\n", b"\r\n"))  # as an editor on Windows saves it
    run = invoke("identify", "check", tmp_path)
    assert "has   SHA256SUMS: right for 5 files" in run.output


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda folder: (folder / "LICENSE").unlink(), "lacks LICENSE: text of the licence (required)"),
        (lambda folder: (folder / "LICENSE").write_text("other"), "lacks SHA256SUMS: not those of LICENSE; run"),
        (
            lambda folder: (folder / "SHA256SUMS").write_text("0" * 64 + "  a.csv\n"),
            "none for LICENSE, dataset.toml, experiment.toml, measurements.csv; no such files: a.csv; run",
        ),
        (lambda folder: (folder / "SHA256SUMS").unlink(), "lacks SHA256SUMS: run"),
        (lambda folder: (folder / "dataset.toml").write_text(DATASET.replace('"MIT"', '""')), "licence empty"),
        (
            lambda folder: (folder / "measurements.csv").write_text("config\n1\n"),
            "lacks experiment.toml, measurements.csv",
        ),
    ],
)
def test_what_publishing_requires_is_named_and_has_an_exit_code(measured, tmp_path, change, message):
    published(measured, tmp_path)
    change(tmp_path)
    run = invoke("identify", "check", tmp_path)
    assert run.exit_code == 3, run.output
    assert message in run.output


def test_the_robot_of_a_folder_may_be_in_the_folder(measured, tmp_path):
    published(measured, tmp_path)
    shutil.copytree(robot.find("kuka_kr270"), tmp_path / "arm")
    text = (tmp_path / "experiment.toml").read_text()
    assert 'robot = "kuka_kr270"' in text
    (tmp_path / "experiment.toml").write_text(text.replace('robot = "kuka_kr270"', 'robot = "arm"'))
    findings = dataset.check(tmp_path)
    assert any(finding.is_present and finding.text.startswith("readings that agree with") for finding in findings)


@pytest.mark.parametrize(("stated", "point"), [(None, 0.0), (0.0, 0.0), (2.0, 0.5)])
def test_errors_of_load_and_load_point_are_stated_or_not(measured, stated, point):
    setup = read_experiment(measured[0] / "experiment.toml")
    setup = replace(setup, load_error_percent=stated, load_point_sigma_mm=point)
    load, spot = dataset._setup_findings(setup)
    assert (load.is_present, spot.is_present) == (stated is not None, point > 0.0)
    assert (load.text[:18], spot.text[:19]) == ("load_error_percent", "load_point_sigma_mm")
