from __future__ import annotations

import csv
import io

import numpy as np

from postproc.frames import xyzabc_from_pose
from postproc.report import TARGET_COLUMNS, targets_csv
from tests import fabricated


def _read(result):
    text = b"".join(targets_csv(result)).decode()
    return list(csv.DictReader(io.StringIO(text))), text


def test_columns_are_those_of_the_contract_in_order():
    assert ",".join(TARGET_COLUMNS) == (
        "output_line,source_line,t,rapid,X,Y,Z,A,B,C,X_cmd,Y_cmd,Z_cmd,A_cmd,B_cmd,C_cmd,Fx,Fy,Fz,Mx,My,Mz,dX,dY,dZ,"
        "before_mm,after_mm,u95_mm,A1,A2,A3,A4,A5,A6"
    )
    _, text = _read(fabricated.result(3))
    assert text.splitlines()[0] == ",".join(TARGET_COLUMNS)
    assert all(line.count(",") == len(TARGET_COLUMNS) - 1 for line in text.splitlines())
    assert text.endswith("\n")
    assert "\r" not in text


def test_every_target_is_a_row_with_its_numbers_in_mm_and_degrees():
    result = fabricated.result(60)
    rows, _ = _read(result)
    assert len(rows) == 60
    values = np.array([[float(row[name]) for name in ("X", "Y", "Z", "A", "B", "C")] for row in rows])
    assert np.abs(values - xyzabc_from_pose(result.nominal[:])).max() < 1e-6
    for name, expected, tolerance in (
        ("output_line", result.output_line, 0.0),
        ("source_line", result.source_line, 0.0),
        ("t", result.t, 1e-9),
        ("rapid", result.rapid, 0.0),
        ("Z_cmd", result.printed[:, 2], 6e-5),
        ("Fz", result.wrench[:, 2], 6e-4),
        ("dZ", result.deflection[:, 2] * 1e3, 6e-7),
        ("before_mm", result.before * 1e3, 6e-7),
        ("after_mm", result.after * 1e3, 6e-7),
        ("A2", np.degrees(result.q[:, 1]), 6e-6),
    ):
        assert np.abs(np.array([float(row[name]) for row in rows]) - expected).max() <= tolerance, name


def test_a_row_is_this_text():
    """Decimals and order are a contract: other programs read the file."""
    base = fabricated.result(3)
    exact = {
        "bound": np.full(3, 1.25e-5),
        "t": np.array([1.0, 1 / 3, 1.0]),
        "q": np.radians(np.full((3, 6), -12.3456789)),
    }
    _, text = _read(fabricated.with_changes(base, **exact))
    assert text.splitlines()[2] == (
        "21,4,0.333333333,0,10.000000,0.000000,0.000000,0.000000,0.000000,180.000000,"
        "10.0000,0.0000,0.8603,0.00000,0.00000,180.00000,0.000,0.000,172.058,0.0000,0.0000,0.0000,"
        "0.000000,0.000000,-0.860292,0.860292,0.000200,0.012500,"
        "-12.34568,-12.34568,-12.34568,-12.34568,-12.34568,-12.34568"
    )


def test_minus_zero_is_never_written():
    base = fabricated.result(10)
    _, text = _read(fabricated.with_changes(base, deflection=np.full((10, 3), -1e-12), q=np.full((10, 6), -1e-12)))
    assert "-0.000000," not in text
    assert "-0.00000\n" not in text


def test_bound_is_empty_without_covariance_and_a_number_with_it():
    base = fabricated.result(4)
    assert {row["u95_mm"] for row in _read(base)[0]} == {""}
    rows, _ = _read(fabricated.with_changes(base, bound=np.full(4, 1.25e-5)))
    assert {row["u95_mm"] for row in rows} == {"0.012500"}


def test_a_result_without_targets_is_a_header_alone():
    assert _read(fabricated.result(0))[1] == ",".join(TARGET_COLUMNS) + "\n"


def test_rows_do_not_depend_on_where_the_chunks_end(monkeypatch):
    result = fabricated.result(50)
    whole = b"".join(targets_csv(result))
    monkeypatch.setattr("postproc.chunks.ROWS", 7)
    assert b"".join(targets_csv(result)) == whole
