"""Errors that tell of all that is wrong with an input, and issues in groups."""

import pickle

import pytest

from postproc.errors import MAX_ERRORS, Issue, ProgramError, combined_error, did_you_mean, group_issues


def _error(line: int, file: str = "part.nc") -> ProgramError:
    return ProgramError(f"odd word {line}", file=file, line=line, text=f"G9{line}", advice="Remove it.")


def test_errors_of_a_file_are_told_together_in_order_of_lines() -> None:
    error = combined_error([_error(7), _error(3), _error(5)])
    assert (error.problem, error.line) == ("odd word 3", 3)
    assert str(error).splitlines() == [f"part.nc:{n}: odd word {n}. Text: 'G9{n}'. Remove it." for n in (3, 5, 7)]


def test_errors_of_the_first_file_come_first() -> None:
    error = combined_error([_error(7, "part.src"), _error(3, "part.dat"), _error(5, "part.src")])
    assert [(e.file, e.line) for e in (error, *error.further_errors)] == [
        ("part.src", 5),
        ("part.src", 7),
        ("part.dat", 3),
    ]


def test_equal_errors_are_printed_once() -> None:
    assert str(combined_error([_error(7), _error(3), _error(7)])) == str(combined_error([_error(3), _error(7)]))
    assert str(combined_error([_error(7), _error(7)])) == str(_error(7))


def test_one_error_stays_what_it_is() -> None:
    error = _error(3)
    assert combined_error([error]) is error


def test_no_more_than_the_first_errors_are_shown() -> None:
    exactly, more = (
        combined_error([_error(n) for n in range(MAX_ERRORS)]),
        combined_error([_error(n) for n in range(MAX_ERRORS + 5)]),
    )
    assert len(str(exactly).splitlines()) == MAX_ERRORS
    assert len(str(more).splitlines()) == MAX_ERRORS + 1
    assert str(more).splitlines()[-1] == f"There are more errors: these are the first {MAX_ERRORS}."


def test_errors_survive_a_process_pool_and_a_change_of_the_file_name() -> None:
    error = pickle.loads(pickle.dumps(combined_error([_error(3), _error(5), _error(1, "part.dat")])))
    moved = error.with_file("part.nc", "jobs/part.nc")
    assert isinstance(moved, ProgramError)
    assert [(e.file, e.line) for e in (moved, *moved.further_errors)] == [
        ("jobs/part.nc", 3),
        ("jobs/part.nc", 5),
        ("part.dat", 1),
    ]


def test_issues_about_different_names_are_not_grouped() -> None:
    issues = [
        Issue("warning", "call", "A() is not there", 3, subject="A"),
        Issue("warning", "call", "B() is not there", 4, subject="B"),
        Issue("warning", "call", "A() is not there", 5, subject="A"),
    ]
    assert [(issue.message[0], issue.source_line, issue.count) for issue in group_issues(issues)] == [
        ("A", 3, 2),
        ("B", 4, 1),
    ]


def test_a_grouped_issue_has_the_lines_of_all() -> None:
    issues = [Issue("info", "a", "m", 9, lines=(9, 12)), Issue("info", "a", "m", 4), Issue("info", "a", "m", 12)]
    (one,) = group_issues(issues)
    assert (one.source_line, one.count, one.lines) == (9, 3, (4, 9, 12))


@pytest.mark.parametrize(
    ("name", "valid", "question"),
    [
        ("kr270", ["kuka_kr16_2", "kuka_kr270"], "Did you mean `kuka_kr270`?"),
        ("KUKA_KR720", ["kuka_kr16_2", "kuka_kr270"], "Did you mean `kuka_kr270`?"),
        ("tolerence_mm", ["lines_per_file", "tolerance_mm"], "Did you mean `tolerance_mm`?"),
        ("fanuc", ["gcode", "krl", "rapid"], ""),
        ("x", ["axis"], ""),
    ],
)
def test_the_nearest_valid_name_is_offered(name, valid, question):
    assert did_you_mean(name, valid) == question
