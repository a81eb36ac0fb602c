"""The warning that a program changes data which its next run uses."""

from __future__ import annotations

from collections.abc import Mapping

from postproc.errors import Issue, first_of

_MOST_NAMES = 10
"""Most names in one message."""


def changed_data_issue(change_places: Mapping[str, str], line: int) -> Issue:
    """Return the warning that the next run of a program moves differently from a line on.

    :param change_places: variable that keeps its value from run to run → the place that changes it, as text.
    :param line: first line of the program at which the next run differs, or cannot be followed.
    """
    names = first_of([f"{name} ({place})" for name, place in change_places.items()], _MOST_NAMES)
    message = (
        f"The program changes data that stay changed: {names}. The next run begins with the changed "
        "values and moves differently from this line on: the output holds for a run that begins with the values in "
        "the files. Set them at the beginning of the program."
    )
    return Issue("warning", "changed-data", message, line, subject=", ".join(list(change_places)[:_MOST_NAMES]))
