"""The comparison of two versions notices what differs."""

from __future__ import annotations

import pytest

from tests.benchmarks import same_results

CSV = "source_line,t,X_cmd,A_cmd,u95_mm\n7,0.500000000,10.0000,-180.00000,\n8,1.000000000,20.0000,179.99999,\n"
KRL = (
    ";POSTPROC 1 {}\r\nDEF part( )\r\nLIN {{X 10.0000,A -180.00000}} C_DIS\r\nLIN {{X 20.0000,A 179.99999}}\r\nEND\r\n"
)


def folder(place, name, *edits, drop=()):
    made = place / name
    made.mkdir()
    for file, text in (("part.targets.csv", CSV), ("part.src", KRL.format(name))):
        for before, after in edits:
            text = text.replace(before, after)
        if file not in drop:
            (made / file).write_bytes(text.encode())
    return made


def test_the_same_results_are_the_same_whatever_their_line_of_origin(tmp_path):
    found = same_results.differences(folder(tmp_path, "one"), folder(tmp_path, "other"), "part")
    assert found == dict.fromkeys((*CSV.splitlines()[0].split(","), "KRL"), 0.0)


@pytest.mark.parametrize(
    ("edit", "key", "off"),
    [
        (("X 20.0000", "X 20.0001"), "KRL", 1e-4),
        ((",20.0000,", ",20.0003,"), "X_cmd", 3e-4),
        ((",179.99999,\n", ",-179.99999,\n"), "A_cmd", 2e-5),
        (("0.500000000", "0.500000001"), "t", 1e-9),
    ],
)
def test_one_digit_is_noticed_and_a_whole_turn_is_none(tmp_path, edit, key, off):
    found = same_results.differences(folder(tmp_path, "one"), folder(tmp_path, "other", edit), "part")
    assert found.pop(key) == pytest.approx(off, rel=1e-6)
    assert not any(found.values())


@pytest.mark.parametrize(
    ("edit", "drop", "told"),
    [
        ((" C_DIS", ""), (), "the text of the KRL differs"),
        (("8,1.000000000,20.0000,179.99999,\n", ""), (), "2 and 1 targets"),
        (("", ""), ("part.targets.csv",), "written by the first"),
    ],
)
def test_what_cannot_be_compared_is_said(tmp_path, edit, drop, told):
    other = folder(tmp_path, "other", edit, drop=drop)
    assert same_results.differences(folder(tmp_path, "one"), other, "part") == told
