"""Which source states the force of a move; no stated force is left out without an issue."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import forces, toolpath
from postproc.errors import ForceError
from postproc.machining.source import refuse_comments
from tests.programs import program

MOVES = [("PTP", 0, 0, 0), ("LIN", 100, 0, 0), ("LIN", 100, 50, 0), ("LIN", 0, 50, 0), ("RAPID", 0, 50, 20)]
FORCE = (50.0, 0, 0, 0, 0, 0)


def assigned(rows="", notes=(), *, path=None, still=()):
    made = replace(program(MOVES, notes=notes), still=np.array(still, dtype=np.int64))
    table = None
    if rows:
        (path / "f.csv").write_text(f"line,Fx,Fy,Fz,frame\n{rows}")
        table = forces.read_force_csv(path / "f.csv")
    geometry = toolpath.segments(made, np.eye(4))
    load = forces.assign(made, geometry, table, "+Z", 1e-3)
    ends = toolpath.at(made, geometry, np.arange(len(MOVES)), np.ones(len(MOVES)))
    return {issue.kind: issue for issue in load.issues}, load.at(ends)[:, 0].tolist()


def test_a_row_replaces_a_comment_and_the_result_says_where(tmp_path):
    issues, loads = assigned("3,70,0,0,\n", [(2, FORCE)], path=tmp_path)
    assert loads == [0, 50, 70, 50, 0]
    sources, replaced = issues["force-sources"], issues["force-replaced"]
    assert (sources.level, replaced.level, replaced.lines) == ("info", "warning", (3,))
    assert "f.csv on 1 cutting moves, comments of the program on 2;" in sources.message


@pytest.mark.parametrize(("row", "replaced"), [("50.001,0,0,", False), ("50.1,0,0,", True), ("50,0,0,TOOL", True)])
def test_a_row_with_the_force_of_the_comment_replaces_nothing(tmp_path, row, replaced):
    assert ("force-replaced" in assigned(f"3,{row}\n", [(2, FORCE)], path=tmp_path)[0]) is replaced


def test_a_comment_that_switches_the_force_off_is_no_second_source(tmp_path):
    issues, loads = assigned("3,70,0,0,\n", [(2, (0.0,) * 6)], path=tmp_path)
    assert not issues.keys() & {"force-sources", "force-replaced"}
    assert loads == [0, 0, 70, 0, 0]


def test_a_comment_that_holds_on_no_cutting_move_is_a_warning():
    unused = assigned(notes=[(1, FORCE), (2, (9.0, 0, 0, 0, 0, 0)), (5, FORCE)])[0]["force-unused"]
    assert (unused.level, unused.lines, unused.count, unused.source_line) == ("warning", (1, 5), 2, 1)
    assert unused.message.startswith("a force comment that holds on no cutting move: ")
    assert "force-unused" not in assigned(notes=[(1, FORCE), (5, (0.0,) * 6)])[0]
    again = assigned(notes=[(1, (9.0, 0, 0, 0, 0, 0)), (2, FORCE), (5, FORCE)])[0]["force-unused"]
    assert again.lines == (1,), "the force of line 5 acts already, as where branches meet"


def test_a_comment_that_another_force_follows_at_once_is_kept_text_of_the_program():
    issues, loads = assigned(notes=[(2, (9.0, 0, 0, 0, 0, 0)), (2, FORCE)])
    assert "force-unused" not in issues
    assert loads == [0, 50, 50, 50, 0]
    off = assigned(notes=[(2, (9.0, 0, 0, 0, 0, 0)), (2, (0.0,) * 6)])[0]
    assert off["force-unused"].lines == (2,)


@pytest.mark.parametrize(("rows", "lines"), [("3,70,0,0,\n7,5,0,0,\n9,5,0,0,\n", (7, 9)), ("7,0,0,0,\n", None)])
def test_a_row_on_a_move_of_zero_length_is_a_warning(tmp_path, rows, lines):
    still = assigned(rows, path=tmp_path, still=(7, 9))[0].get("force-on-still")
    assert (still.lines if still else None) == lines
    if still:
        message = f"a move of zero length carries no force: its row of {tmp_path / 'f.csv'} is not used"
        assert (still.level, still.message, still.source_line, still.count) == ("warning", message, 7, 2)


@pytest.mark.parametrize(("force", "questioned"), [(0.4, True), (2.9, True), (3.1, False), (400.0, False)])
def test_forces_of_the_size_of_kilonewtons_are_questioned(tmp_path, force, questioned):
    for issues in (assigned(f"3,{force},0,0,\n", path=tmp_path)[0], assigned(notes=[(2, (force, *FORCE[1:]))])[0]):
        issue = issues.get("force-unit")
        assert (issue is not None) is questioned
        assert issue is None or issue.message.startswith(f"the largest force is {force:.2g} N: are these kN?")


def test_forces_of_zero_are_not_questioned(tmp_path):
    assert "force-unit" not in assigned("3,0,0,0,\n", path=tmp_path)[0]


def test_force_comments_in_a_program_with_a_process_are_refused():
    refuse_comments(program(MOVES, notes=[(2, (0.0,) * 6)]), "p.toml")
    with pytest.raises(ForceError, match=r"a force comment, and forces from p\.toml") as caught:
        refuse_comments(program(MOVES, notes=[(1, (0.0,) * 6), (2, FORCE), (4, FORCE)]), "p.toml")
    assert (caught.value.file, caught.value.line) == ("part.nc", 2)
    assert "(lines 2, 4)" in str(caught.value)
    with pytest.raises(ForceError, match=r"\(line 2\)"):
        refuse_comments(program(MOVES, notes=[(2, FORCE)]), "p.toml")
