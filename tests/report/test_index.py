from __future__ import annotations

import msgspec
import numpy as np
import pytest

from postproc.report import summary
from postproc.report.index import Entry, ReportEntry, index_page
from tests import fabricated
from tests.html_page import read_page


def _entry(name, tolerance=1e-5, **changes):
    content = summary(fabricated.with_changes(fabricated.result(), **changes), tolerance)
    written = msgspec.to_builtins(content) | {"program": f"{name}.nc"}
    return Entry(f"{name}.nc", f"{name}.report.html", msgspec.convert(written, ReportEntry))


def test_programs_in_trouble_come_first_the_worst_of_them_first():
    entries = [
        _entry("fair"),
        _entry("idle", wrench=np.zeros((100, 6))),
        _entry("worse", bound=np.full(100, 2e-4)),
        _entry("broken", 1e-7),
        Entry("gone.nc", "", None, "gone.nc:3: A3 <beyond> its limit"),
        _entry("bad", bound=np.full(100, 5e-4)),
    ]
    read = read_page(index_page(entries, "out"))
    text = read.text("programs")
    places = [text.index(name) for name in ("gone.nc", "broken.nc", "idle.nc", "bad.nc", "worse.nc", "fair.nc")]
    assert places == sorted(places)
    assert "gone.nc: gone.nc:3: A3 <beyond> its limit" in read.text("failed")
    assert "nothing written 1 do not run 1 no forces 1 look first 3" in text
    assert (
        "Uncorrected, up to (95 %) 2.0 mm unknown for 3 of 5 Corrected, up to (95 %) 0.50 mm unknown for 3 of 5" in text
    )
    assert "500 targets in 5 programs" in text


def test_the_overview_shows_both_expected_errors_the_chance_and_the_tolerance():
    entries = [_entry("idle", wrench=np.zeros((100, 6)), bound=np.zeros(100)), _entry("fair", bound=np.full(100, 2e-4))]
    text = read_page(index_page(entries, "out")).text("programs")
    assert " 100 1.5 0.0040 99 % - 99.98 % " in text
    assert " 100 1.7 0.20 99 % - 99.98 % " in text


def test_a_report_of_an_earlier_version_has_no_answers():
    entry = _entry("old", bound=np.full(100, 2e-4))
    old = msgspec.to_builtins(entry.content) | {"verdict": {"state": "ok", "reasons": ["good"]}}
    text = read_page(index_page([Entry("old.nc", "", msgspec.convert(old, ReportEntry))], "out")).text("programs")
    assert " may be run 100 unknown unknown - - 99.98 % " in text


def test_names_lead_to_their_reports():
    content = index_page([_entry("my part")], "out")
    assert b'href="my%20part.report.html">my part.nc</a>' in content
    assert len(content) < 30_000
    with pytest.raises(AssertionError):
        read_page(content.replace(b"my%20part.report.html", b"https://example.com/a.html"))
