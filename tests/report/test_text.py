from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.report import ProgramRow, program_text, programs_table, summary
from tests import fabricated


def test_one_program_is_told_as_a_table_of_before_after_and_improvement():
    assert program_text(summary(fabricated.result(), 1e-5)) == (
        "part.nc  on kuka_kr270: 100 targets\n"
        "Look before you run it.\n"
        "  May it be driven? yes; not checked: collisions (the cell has no [collision]), moves through material (no "
        "stock is known: give --process)\n"
        "  Is it better than uncorrected? not known\n"
        "  Does it hold your tolerance? none is given\n"
        "  - how far the part will be off is unknown: the robot model states no uncertainty of its parameters\n"
        "  - line 12 and 310 more: cutting moves <without> a force: zero force is assumed\n"
        "\n"
        "  deviation [mm]  before   after  improvement\n"
        "  max                1.5  0.0002         7500\n"
        "  RMS                1.1  0.0002         5343\n"
        "  mean               1.0  0.0002         5021\n"
        "  95 %               1.5  0.0002         7480\n"
        "\n"
        "  largest correction 1.5 mm\n"
        "  between targets at most 0.0040 mm (tolerance 0.01 mm, held)\n"
        "  compensated 99.98 %\n"
        "  smallest joint margin 40.0°, smallest singular value 0.210"
    )


def test_a_prediction_has_one_column():
    content = summary(fabricated.with_changes(fabricated.result(mode="predict"), bound=np.full(100, 2e-4), issues=()))
    text = program_text(content)
    assert "predicted" in text
    assert "expected error on the part" not in text  # what is predicted is left on the part, and is not in the bound
    assert "uncertainty of the prediction (95 %): " in text + "".join(content.verdict.reasons)
    assert "improvement" not in text


def test_a_prediction_tells_of_the_places_between_targets():
    base = fabricated.result(10, mode="predict")
    t = base.t.copy()
    t[[2, 5]] = 0.5
    text = program_text(summary(fabricated.with_changes(base, t=t)))
    assert "10 places looked at, 2 of them between its targets" in text
    assert "anywhere on the path at most 1.5 mm" in text


def test_what_is_left_by_rounding_alone_is_no_improvement():
    base = fabricated.result()
    text = program_text(summary(fabricated.with_changes(base, after=np.full(100, 3e-13)), 1e-5))
    assert text.count("to rounding") == 4
    text = program_text(summary(fabricated.with_changes(base, before=base.before * 1e-5), 1e-5))
    assert "to rounding" not in text
    assert "  max             <0.0001  0.0002            -\n" in text
    assert "compensated" not in text


@pytest.mark.parametrize("mode", ["convert", "predict"])
def test_where_there_was_nothing_to_correct_no_noise_is_printed(mode):
    noise = np.random.default_rng(1).uniform(0.0, 1e-13, 100)
    result = fabricated.with_changes(
        fabricated.result(mode=mode), before=noise, after=noise * 0.9, path_deviation=1e-13, wrench=np.zeros((100, 6))
    )
    text = program_text(summary(result, 1e-5))
    assert "Nothing to correct: no cutting move carries a force, the tool follows the programmed path." in text
    assert "improvement" not in text
    assert "compensated" not in text


def test_an_exceeded_tolerance_is_said_aloud():
    assert "tolerance 0.001 mm, EXCEEDED" in program_text(summary(fabricated.result(), 1e-6))


def test_many_programs_are_a_table_with_failures_in_it():
    content = summary(fabricated.with_changes(fabricated.result(), bound=np.full(100, 2e-4)))
    lines = programs_table(
        [ProgramRow("a/part.nc", content, "written"), ProgramRow("b.nc", None, "FAILED")]
    ).splitlines()
    assert lines[0].split("  ")[0] == "program"
    assert lines[1].startswith("a/part.nc")
    assert lines[1].endswith("written")
    assert lines[2].endswith("FAILED")
    assert lines[0].count("[mm]") == 2
    assert lines[3].split() == [
        "all",
        "2,",
        "at",
        "most",
        "100",
        "1.7",
        "0.20",
        *["1", "not", "written,", "1", "to", "be", "looked", "at"],
    ]
    assert lines[4].startswith("  - a/part.nc: ")


def test_in_the_table_a_program_without_forces_does_not_look_like_a_success():
    none = fabricated.with_changes(fabricated.result(), wrench=np.zeros((100, 6)), before=np.zeros(100))
    text = programs_table([ProgramRow(name, summary(none, 1e-5), "written") for name in ("a.nc", "b.nc")])
    assert text.count("no forces") == 3  # one in each row, and their number in the last
    assert "2 no forces" in text
    assert "to be looked at" not in text
    assert "a.nc and 1 more: no cutting move carries a force: nothing is corrected" in text


def _judged(content, state, *reasons):
    return replace(content, verdict=replace(content.verdict, state=state, reasons=list(reasons)))


@pytest.mark.parametrize(("count", "last"), [(8, None), (9, "1 more reason"), (11, "3 more reasons")])
def test_of_many_reasons_eight_are_printed_and_the_others_counted(count, last):
    content = summary(fabricated.result(), 1e-5)
    reasons = [f"reason {k}" for k in range(count)]
    lines = program_text(_judged(content, "warning", *reasons)).splitlines()
    listed = [line for line in lines if line.startswith("  - ")]
    assert listed == [f"  - {text}" for text in reasons[:8]] + ([] if last is None else [f"  - {last}: see the report"])
    rows = [
        ProgramRow(f"{k}.nc", _judged(content, "failed", text, "another"), "done") for k, text in enumerate(reasons)
    ]
    listed = [line for line in programs_table(rows).splitlines() if line.startswith("  - ")]
    assert listed == [f"  - {k}.nc: {text}" for k, text in enumerate(reasons[:8])] + (
        [] if last is None else [f"  - {last}: see the overview"]
    )


def test_subprograms_that_are_written_with_their_callers_do_not_count_as_not_written():
    content = summary(fabricated.result())
    skipped = [ProgramRow(name, None, "skipped: a subprogram", is_skipped=True) for name in ("sub.src", "subs.src")]
    totals = programs_table([ProgramRow("a.src", content, "written"), *skipped]).splitlines()[4]
    assert "2 with callers" in totals
    assert "not written" not in totals
    totals = programs_table([ProgramRow("a.src", content, "written"), ProgramRow("b.src", None, "FAILED"), *skipped])
    assert "1 not written, 2 with callers" in totals.splitlines()[5]


def test_programs_with_the_same_first_reason_share_a_line():
    content = summary(fabricated.result(), 1e-5)
    verdicts = {
        "a.nc": ("failed", "blunt", "late"), "c.nc": ("ok", "all well"), "d.nc": ("failed", "late"),
        "e.nc": ("warning", "blunt"), "f.nc": ("failed", "blunt"),
    }  # fmt: skip
    rows = [ProgramRow(name, _judged(content, *verdict), "") for name, verdict in verdicts.items()]
    table = programs_table([*rows, ProgramRow("b.nc", None, "failed")])
    listed = [line for line in table.splitlines() if line.startswith("  - ")]
    assert listed == ["  - a.nc and 2 more: blunt", "  - d.nc: late"]
