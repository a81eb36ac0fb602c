"""The report is one page that loads nothing; it shows what is in identification.json."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest

from postproc.identification import identify_folder
from postproc.report.identification import page
from samples.paper_study import simulator


class Balanced(HTMLParser):
    """Counts that every element is closed."""

    VOID = frozenset({"meta", "path", "circle", "rect", "br", "i"})

    def __init__(self):
        super().__init__()
        self.open = []

    def handle_starttag(self, tag, attrs):
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag


@pytest.mark.parametrize("kind", ["paper", "hard"])
def test_report_shows_every_configuration_and_parameter_and_loads_nothing(tmp_path, kind):
    rng = np.random.default_rng(703)
    true = simulator.paper_like(rng) if kind == "paper" else simulator.hard(rng, gear="linear")
    q, f = simulator.plan(rng, 15 if kind == "paper" else 30, tilt=50.0)
    _, raw = simulator.measure(true, q, f, rng)
    simulator.write(tmp_path, q, f, raw)
    done = identify_folder(tmp_path / "measurements.csv", tmp_path / "experiment.toml", tmp_path / "model", render=page)
    text = (tmp_path / "model" / "report.html").read_text(encoding="utf-8")
    parser = Balanced()
    parser.feed(text)
    assert parser.open == []
    assert not re.search(r"(src|href)=|url\(|<script", text)
    assert "nan" not in text.lower().replace("nanum", "")
    for row in done.data["residual"]["per_configuration"]:
        assert f"config {row['config']:g}: {row['before_mm']:.3f}" in text
    for name in done.data["parameters"]:
        assert name.partition("@")[0] in text
    for entry in done.data["not_observable"]:
        assert f"{entry['name']} is not observable" in text
    assert ("Structures tried" in text) == (kind == "hard")
