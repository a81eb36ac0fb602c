"""Overrides that a program sets: forces of a process are those at the feeds that it states."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from postproc.dialects.text import decode
from postproc.machining.override import override_issues


@pytest.mark.parametrize(
    ("dialect", "text", "line"),
    [
        ("krl", "DEF a()\n$OV_PRO=50\nEND\n", 2),
        ("krl", "DEF a()\n  $ov_pro = SLOW ; for the cut\nEND\n", 2),
        ("krl", "DEF a()\nTRIGGER WHEN DISTANCE=0 DELAY=0 DO $OV_PRO=20\nEND\n", 2),
        ("krl", "DEF a()\n$OV_PRO=100\nIF $OV_PRO==50 THEN\nENDIF\n;$OV_PRO=50\n$OV_PRO=30\nEND\n", 6),
        ("krl", "DEF a()\n$OV_APPL=50\nEND\n", 2),
        ("krl", "DEF a()\n$OV_PRO=100\n$RED_VEL = 30\nEND\n", 3),
        ("krl", "DEF a()\n$OV_PRO=100\nEND\n", None),
        ("krl", "DEF a()\n; set $OV_PRO=50 by hand\nEND\n", None),
        ("rapid", "MODULE a\nPROC main()\nSpeedRefresh 50;\nENDPROC\nENDMODULE\n", 3),
        ("rapid", "MODULE a\n! SpeedRefresh 50;\nPROC main()\nSpeedRefresh 100;\nENDPROC\nENDMODULE\n", None),
        ("gcode", "M48\nG1 X1\n", None),
    ],
)
def test_an_override_other_than_100_is_told(dialect, text, line):
    program = SimpleNamespace(dialect=dialect, documents=(decode("a", text.encode()),))
    issues = list(override_issues(program))
    assert [issue.level for issue in issues] == ["warning"] * (line is not None)
    assert all(f"in line {line} of a: forces are those at 100 %" in issue.message for issue in issues)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("DEF a()\nSPLINE\nTIME_BLOCK START\nSLIN P1\nTIME_BLOCK END=7.5\nENDSPLINE\nEND\n", 5),
        ("DEF a()\nSPLINE\nSLIN P1\n; TIME_BLOCK END=7.5\nENDSPLINE\nEND\n", None),
    ],
)
def test_a_spline_block_with_a_time_has_another_feed(text, line):
    program = SimpleNamespace(dialect="krl", documents=(decode("a", text.encode()),))
    issues = list(override_issues(program))
    assert [issue.level for issue in issues] == ["warning"] * (line is not None)
    assert all(f"in line {line} of a: forces are those at $VEL.CP" in issue.message for issue in issues)
