"""The report is one page that loads nothing; it shows what is in identification.json."""

import numpy as np
import pytest

from postproc.identification import identify_folder
from postproc.identification.record import IdentificationRecord, Parameter, Verdict
from postproc.identification.uncertainty import Judgement
from postproc.report.identification import page, value_texts, verdict_section
from postproc.robot import parameters
from samples.paper_study import simulator
from tests.html_page import read_page


@pytest.mark.parametrize("kind", ["paper", "hard"])
def test_report_shows_every_configuration_and_parameter_and_loads_nothing(tmp_path, kind):
    rng = np.random.default_rng(703)
    true = simulator.paper_like(rng) if kind == "paper" else simulator.hard(rng, gear="linear")
    q, f = simulator.plan(rng, 15 if kind == "paper" else 30, tilt=50.0)
    _, raw = simulator.measure(true, q, f, rng)
    simulator.write(tmp_path, q, f, raw)
    done = identify_folder(tmp_path / "measurements.csv", tmp_path / "experiment.toml", tmp_path / "model", render=page)
    read = read_page((tmp_path / "model" / "report.html").read_bytes())
    assert read.text().startswith("model: identification report ")
    for row in done.data.residual.per_configuration:
        assert f"{row.config:g} {row.before_mm:.3f} {row.after_mm:.4f}" in read.text("configurations")
    for name, entry in done.data.parameters.items():
        parameter = parameters.parameter_of_name(name)
        assert (name if parameter is None else parameter.title) in read.text("parameters")
        if entry.ci95 is not None and entry.ci95 > 0.5 * abs(entry.value):
            word = "only together with others" if entry.ci95 > abs(entry.value) else "barely known"
            told = f"± {entry.ci95:.2g} {entry.unit.replace('urad', 'µrad').replace('um/', 'µm/')} {word}"
            assert told in read.text("parameters")
    assert "within its bound" in read.text("verdict")
    for entry in done.data.not_observable:
        assert f"{entry.name} is not observable" in read.text("to-know")
    assert ("structures" in read.ids) == (kind == "hard")
    assert "correlations" in read.ids


def record_of(judged):
    return IdentificationRecord(
        verdict=judged, method="serial", robot="r", sigma_mm=0.03, base={}, points={}, unloaded_rms_mm=0.1, outliers=[],
        warnings=[],
    )  # fmt: skip


def test_the_page_shows_the_reservation_of_a_verdict():
    text = "4 configurations show little of what the model lacks: measure 5 or more (30 are usual)"
    line = Judgement(distrust="", reservation=text, notes=[]).line
    part = verdict_section(record_of(Verdict(False, line))).parts[0]
    assert part.state == "warning"
    assert part.sentence == f"within its bound, with a reservation: {text}."
    certain = Verdict(False, Judgement(distrust="", reservation="", notes=[]).line)
    part = verdict_section(record_of(certain)).parts[0]
    assert (part.state, part.sentence) == ("ok", "within its bound.")


@pytest.mark.parametrize(
    ("value", "ci95", "shown"),
    [
        (2.34943, 0.3412, ("2.35", "± 0.34", "µrad/(N·m)")),
        (0.00091659, 0.048, ("0.001", "± 0.048", "µrad/(N·m)")),
        (0.0000459, 2.6, ("0.0", "± 2.6", "µrad/(N·m)")),
        (715_312.0, 140_000.0, ("0.72", "± 0.14", "10⁶ µrad/(N·m)")),
        (0.123456, None, ("0.123", "prior", "µrad/(N·m)")),
        (None, None, ("-", "prior", "µrad/(N·m)")),
    ],
)
def test_a_value_has_the_decimals_of_its_interval(value, ci95, shown):
    assert value_texts(Parameter(value, ci95, "urad/(N·m)", True)) == shown
