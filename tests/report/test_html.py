from __future__ import annotations

import re
from html.parser import HTMLParser

import numpy as np
import pytest

from postproc.report import page
from postproc.report.charts import ticks
from tests import fabricated

_VOID = {"meta", "br", "hr", "img", "input", "link"}


class _Balanced(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loads: list[str] = []

    def handle_starttag(self, tag, attrs):
        if tag not in _VOID:
            self.open.append(tag)
        self.loads += [value for name, value in attrs if name in ("src", "href") and value]
        assert tag not in ("script", "link", "iframe")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_startendtag(self, tag, attrs):
        pass


def _checked(result, tolerance=1e-5) -> str:
    text = page(result, tolerance).decode()
    parser = _Balanced()
    parser.feed(text)
    parser.close()
    assert parser.open == []
    assert parser.loads == []
    assert "nan" not in re.sub(r"<[^>]*>", "", text).lower()
    assert not re.search(r"\b(nan|inf)\b", " ".join(re.findall(r' (?:d|x|y|cx|cy)="([^"]*)"', text)))
    assert "url(" not in text
    assert "http" not in text
    return text


@pytest.mark.parametrize("mode", ["convert", "nominal", "predict"])
@pytest.mark.parametrize("count", [0, 1, 2, 30, 5000])
def test_page_is_well_formed_and_self_contained(mode, count):
    _checked(fabricated.result(count, mode))


def test_program_and_messages_are_escaped():
    text = _checked(fabricated.result())
    assert "&lt;without&gt;" in text
    assert "<without>" not in text


def test_table_shows_before_after_and_improvement():
    text = _checked(fabricated.result())
    assert "<td>1.5000</td><td>0.000200</td><td>7500</td>" in text


def test_largest_deviation_is_marked_with_its_line_and_small_ones_are_in_micrometres():
    text = _checked(fabricated.result())
    assert "1.5 mm, line 16" in text
    assert "0.2 µm, line 4" in text


def test_a_single_peak_among_many_targets_is_still_drawn():
    base = fabricated.result(50_000)
    before = np.full(50_000, 1e-4)
    before[31_234] = 5e-3
    text = _checked(fabricated.with_changes(base, before=before))
    assert f"5 mm, line {31_234 + 3}" in text
    band = re.search(r'class="band before" d="([^"]*)"', text)
    heights = [float(height) for height in re.findall(r"V([\d.]+)", band[1])]
    assert max(heights) - min(heights) > 100


def test_size_stays_below_one_megabyte_for_200_000_targets():
    base = fabricated.result(200_000)
    noise = 1.0 + 0.5 * np.random.default_rng(1).standard_normal(200_000)
    way = base.nominal.copy()
    way[:, 1, 3] %= 0.3
    way[:, 0, 3] += np.random.default_rng(2).standard_normal(200_000) * 1e-3
    assert len(page(fabricated.with_changes(base, before=base.before * np.abs(noise), nominal=way))) < 1_000_000


def test_joint_near_its_limit_is_marked():
    text = _checked(fabricated.with_changes(fabricated.result(), joint_margin=np.radians([100.0, 3.2, 50, 50, 50, 50])))
    assert '<span class="warning">3.2</span>' in text


def test_two_bases_are_shown_in_the_robot_root():
    base = fabricated.result(10)
    from dataclasses import replace

    two = replace(base.program, bases=np.stack([np.eye(4), np.eye(4)]))
    assert "the robot root" in _checked(fabricated.with_changes(base, program=two))


@pytest.mark.parametrize(("low", "high", "count"), [(0.0, 7.3, 4), (0.0, 2e-7, 4), (-3.0, 900.0, 8)])
def test_ticks_are_round_and_within(low, high, count):
    values = ticks(low, high, count)
    assert 2 <= len(values) <= 2 * count + 1
    assert low <= min(values) <= max(values) <= high * (1 + 1e-9)


def test_arcs_are_drawn_as_arcs_and_counted_by_their_length():
    from dataclasses import replace

    from postproc.program import CIRC
    from postproc.report.drawn import drawn_path

    base = fabricated.result(3)
    end = base.nominal.copy()
    end[0, :3, 3], end[1, :3, 3], end[2, :3, 3] = [0.01, 0, 0], [-0.01, 0, 0.002], [0.01, 0, 0.004]
    motions = replace(
        base.program.motions,
        kind=np.array([0, CIRC, CIRC]),
        centre=np.zeros((3, 3)),
        normal=np.tile([0.0, 0.0, 1.0], (3, 1)),
        sweep=np.array([np.nan, np.pi, np.pi]),
    )
    result = fabricated.with_changes(base, nominal=end, program=replace(base.program, motions=motions))
    position, row = drawn_path(result)
    assert np.hypot(position[:, 0], position[:, 1]) == pytest.approx(0.01)
    assert np.all(np.diff(position[:, 2]) > 0.0)
    assert position[np.flatnonzero(np.diff(row, append=3))] == pytest.approx(end[:, :3, 3])
    length = np.linalg.norm(np.diff(position, axis=0), axis=1).sum()
    assert length == pytest.approx(2.0 * np.hypot(np.pi * 0.01, 0.002), rel=2e-3)
    _checked(result)


def test_no_noise_is_plotted_where_there_was_nothing_to_correct() -> None:
    noise = np.random.default_rng(1).uniform(0.0, 1e-13, 100)
    quiet = fabricated.with_changes(fabricated.result(), before=noise, after=noise, wrench=np.zeros((100, 6)))
    text = page(quiet, 1e-5).decode()
    assert "Nothing to correct" in text
    assert "<svg" not in text
    assert "<svg" in page(fabricated.result(), 1e-5).decode()
