"""Numbers that no robot, load or measuring device has end in a message with key, number and range, at the reading."""

import pytest

from postproc import files
from postproc.errors import MeasurementError
from postproc.identification import compensator_geometry
from postproc.identification.readings import COLUMNS, read, read_experiment
from tests.documentation.pages import block

EXPERIMENT, MEASUREMENTS = block("experiment.toml", "toml"), block("measurements.csv", "csv")


@pytest.mark.parametrize(
    ("line", "number", "message"),
    [
        ("sigma_mm = 0.03", "1e308", r"sigma_mm: Expected `float` <= 100.0, not 1e\+308"),
        ("sigma_mm = 0.03", "1e-308", "sigma_mm: Expected `float` >= 1e-06, not 1e-308"),
        ("load_error_percent = 0.5", "300", "load_error_percent: Expected `float` <= 100.0, not 300"),
        ("X = 210", "1e308", r"load_point.X: Expected `float` <= 10000.0, not 1e\+308"),
        ("mass_kg = 120", "1e308", r"payload.mass_kg: Expected `float` <= 10000.0, not 1e\+308"),
        ("mass_kg = 120", "-5", "payload.mass_kg: Expected `float` > 0.0, not -5"),
        ("Y = -121", "-1e5", r"points.P3.Y: Expected `float` >= -10000.0, not -100000"),
    ],
)
def test_a_number_out_of_range_in_the_experiment_is_named_with_its_key(tmp_path, line, number, message):
    assert EXPERIMENT.count(line) == 1
    (tmp_path / "experiment.toml").write_text(EXPERIMENT.replace(line, f"{line.split(' = ')[0]} = {number}"))
    with pytest.raises(MeasurementError, match=message):
        read_experiment(tmp_path / "experiment.toml")


@pytest.mark.parametrize(
    ("point", "far", "refused"),
    [
        ((0.21, -0.06, 0.18), 301, True), ((0.0, 0.0, 0.0), 301, False), ((0.0, 0.0, 1.1), 301, False),
        ((0.21, -0.06, 0.18), 20, False),
    ],
)  # fmt: skip
def test_a_load_point_in_metres_is_refused(tmp_path, point, far, refused):
    path = tmp_path / "experiment.toml"
    load, points = "".join(f"{axis} = {value}\n" for axis, value in zip("XYZ", point, strict=True)), ""
    for name in ("P1", "P2", "P3"):
        points += f"[points.{name}]\nX = 10\nY = 0\nZ = {far}\n"
    path.write_text(f'robot = "kuka_kr270"\nsigma_mm = 0.03\n[load_point]\n{load}{points}')
    if not refused:
        position = read_experiment(path).load_point.position()
        assert position.tolist() == pytest.approx([value / 1e3 for value in point])
        return
    with pytest.raises(MeasurementError, match="up to 301 mm: X, Y, Z of the load point look like metres") as error:
        read_experiment(path)
    assert r"[load_point] is 0.28 mm from the flange origin" in str(error.value)


def test_whole_numbers_too_large_for_a_float_are_an_error_of_the_file(tmp_path):
    path = tmp_path / "experiment.toml"
    path.write_text(EXPERIMENT.replace("X = 210", f"X = {10**400}"))
    with pytest.raises(MeasurementError, match=r"experiment\.toml"):
        read_experiment(path)


@pytest.mark.parametrize("name", [name for name in COLUMNS if name != "point"])
def test_a_cell_out_of_range_is_named_with_its_line_and_column(tmp_path, name):
    (tmp_path / "experiment.toml").write_text(EXPERIMENT)
    header, first, *rest = MEASUREMENTS.splitlines()
    cells = dict(zip(header.split(","), first.split(","), strict=True)) | {name: "-1e308"}
    (tmp_path / "measurements.csv").write_text("\n".join([header, ",".join(cells.values()), *rest]))
    with pytest.raises(MeasurementError, match=rf"csv:2: column {name} is -1e\+308: expected -\S+ to \d") as caught:
        read(tmp_path / "measurements.csv", read_experiment(tmp_path / "experiment.toml"))
    assert caught.value.further_errors == ()


@pytest.mark.parametrize("name", ["q2", "repeat", "X", "Y", "Z"])
def test_a_cell_out_of_range_of_the_markers_is_named_with_its_line_and_column(tmp_path, name):
    header, first, *rest = block("compensator.csv", "csv").splitlines()
    cells = dict(zip(header.split(","), first.split(","), strict=True)) | {name: "1e308"}
    (tmp_path / "compensator.csv").write_text("\n".join([header, ",".join(cells.values()), *rest]))
    with pytest.raises(MeasurementError, match=rf"csv:2: column {name} is 1e\+308: expected -\S+ to \d"):
        compensator_geometry.read(tmp_path / "compensator.csv")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((184.72, -1e5, 123.3), "a_x_mm.value: Expected `float` >= -5000.0, not -100000.0"),
        ((0.18472, 0.68593, 0.1233), "L_mm.value: Expected `float` >= 10.0, not 0.18472"),
        ((184.72, 0.68593, 0.1233), r"put P0 0\.69692\d mm from joint 2, L_mm is 184\.72: expected more than L_mm"),
    ],
)
def test_an_impossible_compensator_is_refused_with_key_and_number(tmp_path, values, message):
    path = tmp_path / "compensator.toml"
    tables = zip(("L_mm", "a_x_mm", "a_y_mm"), values, strict=True)
    path.write_bytes(files.toml({key: {"value": value, "ci95": 0.1} for key, value in tables}, "compensator"))
    with pytest.raises(MeasurementError, match=message):
        compensator_geometry.load(path)
