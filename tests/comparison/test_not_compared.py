"""Motions that compare cannot compare are named, in both programs."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest

from tests import commands
from tests.comparison.krl_moves import TURNED, line_of
from tests.places import CELL_FILE

JOB = """DEF job( )
BAS (#INITMOV,0 )
$VEL.CP=0.05
$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}
$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}
PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}
;FORCE FX=-150 FY=100 FZ=120
LIN {X 0,Y 0,Z 0,A 180,B 0,C 180}
LIN {X 60,Y 0,Z 0,A 180,B 0,C 180}
LIN $POS_ACT:{Z 5}
LIN {X 60,Y 40,Z 0,A 180,B 0,C 180}
WHILE $IN[3]
LIN {X 80,Y 40,Z 0,A 180,B 0,C 180}
ENDWHILE
LIN {X 100,Y 40,Z 0,A 180,B 0,C 180}
END
"""


@pytest.fixture(autouse=True)
def input_files(work_folder):
    Path("nominal").mkdir()
    Path("nominal/job.src").write_text(JOB)


run = partial(commands.printed, cell=CELL_FILE)
comparison = partial(commands.comparison, "nominal/job.src", "corrected/job.src", cell=CELL_FILE)


def line_of_file(path, part):
    return line_of(Path(path).read_text(), part)


def test_motions_that_stay_as_they_are_are_named_with_both_lines():
    assert "--keep-unresolved" in run("compare", "nominal/job.src", "nominal/job.src", "-o", "found", code=1)
    run("convert", "nominal/job.src", "-o", "corrected", "--keep-unresolved")
    content = comparison("--keep-unresolved")
    told = [issue for issue in content["issues"] if issue["kind"] == "not-compared"]
    for text in ("LIN $POS_ACT", "LIN {X 80"):
        (issue,) = [issue for issue in told if text in issue["message"]]
        for side in ("source", "corrected"):
            assert issue[f"{side}_line"] == line_of_file(issue[f"{side}_file"], text)
        where = f"nominal/job.src:{issue['source_line']} and corrected/job.src:{issue['corrected_line']}: not compared"
        assert any(reason.startswith(where) for reason in content["verdict"]["reasons"])
    behind = [issue for issue in told if "the way to this target" in issue["message"]]
    assert [issue["source_line"] for issue in behind] == [line_of_file("nominal/job.src", "LIN {X 60,Y 40")]
    assert content["verdict"]["state"] == "warning"
    assert content["differences"]["not_compared"] == 4
    assert (content["only_nominal"], content["only_corrected"]) == (0, 0)


def test_the_key_of_the_cell_tells_them_as_the_option_does():
    Path("cell.toml").write_text(CELL_FILE.read_text(encoding="utf-8") + "\n[krl]\nkeep_unresolved = true\n")
    run("convert", "nominal/job.src", "-o", "corrected", cell="cell.toml")
    assert comparison(cell="cell.toml")["differences"]["not_compared"] == 4


@pytest.mark.parametrize(
    ("before", "after"), [("{Z 5}", "{Z 4}"), ("LIN $POS_ACT:{Z 5}\n", ""), ("X 80,Y 40", "X 80,Y 41")]
)
def test_one_that_was_changed_must_not_be_run(before, after):
    run("convert", "nominal/job.src", "-o", "corrected", "--keep-unresolved")
    path = Path("corrected/job.src")
    lines = [line for line in path.read_text().splitlines(keepends=True) if "POSTPROC" not in line]
    path.write_text("".join(lines).replace(before, after))
    content = comparison("--keep-unresolved", code=3)
    assert content["verdict"]["state"] == "failed"
    (issue,) = [issue for issue in content["issues"] if issue["kind"] == "unresolved-differs"]
    assert issue["source_line"] == line_of_file("nominal/job.src", before.strip())


def test_in_a_divided_program_they_are_named_by_their_file():
    text = JOB.replace(
        "LIN $POS_ACT", "".join(f"LIN {{X {60 + n},Y 0,Z 0,{TURNED}}}\n" for n in range(30)) + "LIN $POS_ACT"
    )
    Path("nominal/job.src").write_text(text)
    run("convert", "nominal/job.src", "-o", "corrected", "--keep-unresolved", "--lines-per-file", "12")
    arguments = ("nominal/job.src", "corrected/jobMain.src", "-o", "found", "--json", "--keep-unresolved")
    content = json.loads(run("compare", *arguments))
    (issue,) = [issue for issue in content["issues"] if "LIN $POS_ACT" in issue["message"]]
    assert issue["corrected_file"] not in ("jobMain.src", "job1.src")
    assert issue["corrected_line"] == line_of_file(Path("corrected") / issue["corrected_file"], "LIN $POS_ACT")


def test_a_call_of_a_program_that_is_nowhere_is_told_where_one_program_alone_makes_it():
    Path("nominal/job.src").write_text(JOB[: JOB.index("LIN $POS")] + "SPINDLE_ON( )\nEND\n")
    Path("corrected").mkdir()
    Path("corrected/job.src").write_text(JOB[: JOB.index("LIN $POS")] + "SPINDLE_ON( )\nEND\n")
    assert comparison(code=3)["issues"] == []
    Path("corrected/job.src").write_text(JOB[: JOB.index("LIN $POS")] + "END\n")
    (issue,) = comparison(code=3)["issues"]
    assert (issue["kind"], issue["source_line"], issue["corrected_line"]) == ("not-compared", 10, None)


FED = JOB.replace("DEF job( )\n", "DEF job( )\nDECL E6POS q\nDECL INT i\n").replace(
    "LIN $POS_ACT:{Z 5}\n", "FOR i=1 TO 2\nLIN_REL {Y 5}\nENDFOR\nq=$POS_ACT\nq.Z=q.Z+5\nLIN q\n"
)


@pytest.mark.parametrize(
    ("before", "after", "motion"),
    [
        ("", "", None),
        ("Z+5", "Z+50", "LIN q"),
        ("q.Z=q.Z+5\n", "", "LIN q"),
        ("LIN q", "q.X=q.X-5\nLIN q", "LIN q"),
        ("q.Z=q.Z+5\n", "q.Z=q.Z+5\n; a comment\n\n$VEL.CP=0.04\n", None),  # no statements
        ("q.Z=q.Z+5\n", "q.Z=q.Z+50\n; a comment\n", "LIN q"),
        ("WHILE $IN[3]", "WHILE NOT $IN[3]", "LIN {X 80"),
    ],
)
def test_statements_that_feed_or_guard_one_must_be_the_same(before, after, motion):
    Path("nominal/job.src").write_text(FED)
    run("convert", "nominal/job.src", "-o", "corrected", "--keep-unresolved")
    path = Path("corrected/job.src")
    lines = [line for line in path.read_text().splitlines(keepends=True) if "POSTPROC" not in line]
    path.write_text("".join(lines).replace(before, after, 1))
    content = comparison("--keep-unresolved", code=0 if motion is None else 3)
    told = [issue for issue in content["issues"] if issue["kind"] == "unresolved-differs"]
    assert [issue["corrected_line"] for issue in told] == ([] if motion is None else [line_of_file(path, motion)])
