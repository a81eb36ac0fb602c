from __future__ import annotations

import json

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.errors import Issue
from postproc.files import json_bytes
from postproc.report import summary
from postproc.report.summary import Ratios
from postproc.report.surface import Surface
from tests import fabricated


def test_keys_are_those_of_the_contract():
    content = json.loads(json_bytes(summary(fabricated.result())))
    assert {
        "program", "robot", "targets", "inserted_targets", "before", "after", "improvement", "compensated_percent",
        "max_correction_mm", "limits", "issues",
    } <= set(content)  # fmt: skip
    assert set(content["before"]) == set(content["after"]) == {"max_mm", "rms_mm", "mean_mm", "p95_mm"}
    assert set(content["improvement"]) == {"max", "rms"}
    assert {"min_joint_margin_deg", "min_singular_value"} <= set(content["limits"])
    assert set(content["issues"][0]) == {"level", "kind", "message", "source_line", "count"}


def test_numbers_are_along_the_cutting_path_in_mm():
    base = fabricated.result()
    count = np.where(base.rapid, 0, 1 + np.arange(100) % 4)
    soft_tool = fabricated.down(0.3 * base.before)
    result = replace(base, cut_length=0.01 * count, bound=0.5 * base.before, deflection_by_tool=soft_tool)
    # each target as often as its length
    repeated = np.repeat(result.before * 1e3, count)
    content = summary(result)
    assert content.before.max_mm == pytest.approx(repeated.max())
    assert content.before.rms_mm == pytest.approx(np.sqrt(np.mean(repeated**2)))
    assert content.before.rms_mm != pytest.approx(np.sqrt(np.mean((1e3 * base.before[~base.rapid]) ** 2)), rel=1e-3)
    assert content.before.mean_mm == pytest.approx(repeated.mean())
    assert content.before.p95_mm == pytest.approx(np.percentile(repeated, 95, method="inverted_cdf"))
    assert content.u95.rms_mm == pytest.approx(0.5 * content.before.rms_mm)
    assert content.tool_deflection.rms_mm == pytest.approx(0.3 * content.before.rms_mm)
    assert content.improvement.max == pytest.approx(repeated.max() / 2e-4)
    assert content.compensated_percent == pytest.approx(100 * (1 - 2e-4 / content.before.rms_mm))
    assert content.max_correction_mm == pytest.approx(1.5)
    assert content.limits.min_joint_margin_deg == pytest.approx(40.0)
    assert content.max_force_N == pytest.approx(np.abs(result.wrench[:, 2]).max())


def test_inserted_targets_are_those_within_a_motion():
    base = fabricated.result(10)
    t = base.t.copy()
    t[[2, 5]] = 0.5
    assert summary(fabricated.with_changes(base, t=t)).inserted_targets == 2


def test_improvement_is_null_where_nothing_remains_and_share_is_null_where_nothing_was():
    base = fabricated.result()
    assert summary(fabricated.with_changes(base, after=np.zeros(100))).improvement == Ratios(max=None, rms=None)
    nothing = fabricated.with_changes(base, before=np.zeros(100), after=np.zeros(100))
    assert summary(nothing).compensated_percent is None
    rounding = fabricated.with_changes(base, after=np.full(100, 0.9e-7))
    assert summary(rounding).improvement == Ratios(max=None, rms=None)
    assert summary(fabricated.with_changes(base, after=np.full(100, 1.1e-7))).improvement.rms > 1000


def test_text_is_valid_json_whatever_is_unknown():
    unknown = fabricated.with_changes(
        fabricated.result(0),
        joint_margin=np.full(6, np.nan),
        singular_value=np.nan,
        path_deviation=np.inf,
        largest_correction=np.nan,
        issues=(Issue("error", "unreachable", "out of reach", 7),),
    )
    text = json_bytes(summary(unknown, 1e-5)).decode()
    content = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
    assert content["between_max_mm"] is None
    assert content["limits"]["min_joint_margin_deg"] is None
    assert content["tolerance_held"] is False


@pytest.mark.parametrize(("tolerance", "held"), [(1e-5, True), (1e-6, False), (None, None)])
def test_tolerance_is_compared_with_the_path_between_targets_too(tolerance, held):
    assert summary(fabricated.result(), tolerance).tolerance_held is held


def test_nan_in_json_is_an_error():
    with pytest.raises(ValueError, match="not JSON compliant"):
        json_bytes({"a": float("nan")})


def test_material_left_is_that_on_half_of_the_area_and_not_of_the_facets():
    """Forty slivers with nothing left, as of a fillet, and one large facet with 0.3 mm."""
    corners = np.zeros((41, 3, 3))
    corners[:, 1, 0] = np.where(np.arange(41) == 40, 0.1, 1e-3)
    corners[:, 2, 1] = 0.01
    zero, row = np.zeros(41), np.zeros(41, dtype=np.int64)
    programmed = np.where(np.arange(41) == 40, 3e-4, 0.0)
    normal = np.tile([0.0, 0.0, 1.0], (41, 1))
    part = Surface(corners, normal, zero, zero, None, row, programmed, row - 1)
    assert summary(fabricated.result(), surface=part).surface.left_mm == pytest.approx(0.3)
    no_tool = replace(part, row=row - 1)
    assert summary(fabricated.result(), surface=no_tool).surface.left_mm is None
