"""Later runs of a program that changes data which stay changed: whether they move like the first run.

A program that changes such data after it has used them is followed once more with the changed values. If it leaves them
changed again, it is followed a third time, with unknown values: a counter may decide on a move in a later run only. If
one of these runs moves differently or cannot be followed, the output holds only for runs that begin with the values in
the files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set

from msgspec import Struct

from postproc.errors import Issue, first_of

_MOST_NAMES = 10
"""Most names in one message."""


class FollowedRun(Struct, frozen=True):
    """A later run of a program, compared with the first.

    :ivar difference: first place, as a line or an offset, at which it moves differently from the first run or cannot be
        followed; None if it moves like the first.
    :ivar changed_names: data that it leaves with other values than it began with, and that a run may use.
    """

    difference: int | None
    changed_names: frozenset[str] = frozenset()


class Difference(Struct, frozen=True):
    """A difference between the first run of a program and a later one.

    :ivar place: first place at which the later run moves differently, or cannot be followed.
    :ivar names: the data with which it does.
    :ivar is_certain: True if the values of the later run are known: it is the second one. Otherwise some later run may
        differ.
    """

    place: int
    names: frozenset[str]
    is_certain: bool


def later_difference(
    changed_names: Set[str], follow_next_run: Callable[[frozenset[str]], FollowedRun]
) -> Difference | None:
    """Return how a later run of a program differs from the first; None if all runs move like the first.

    :param changed_names: data that the first run changes and that the next run may use.
    :param follow_next_run: follows the program once more with the values that the run before has left, but with the
        named data unknown.
    """
    names, unknown_names = frozenset(changed_names), frozenset[str]()
    while names:
        run = follow_next_run(unknown_names)
        if run.difference is not None:
            return Difference(run.difference, unknown_names or names, is_certain=not unknown_names)
        names = run.changed_names - unknown_names
        unknown_names |= names
    return None


def changed_data_issue(change_places: Mapping[str, str], line: int, *, is_certain: bool) -> Issue:
    """Return the warning that a later run of a program moves differently from a line on.

    :param change_places: variable that keeps its value from run to run → the place that changes it, as text.
    :param line: first line of the program at which that run differs, or cannot be followed.
    :param is_certain: see `Difference`.
    """
    names = first_of([f"{name} ({place})" for name, place in change_places.items()], _MOST_NAMES)
    effect = (
        "The next run begins with the changed values and moves differently"
        if is_certain
        else "The next run moves like this one, but a later run may move differently"
    )
    message = (
        f"The program changes data that stay changed: {names}. {effect} from this line on: the output holds for a run "
        "that begins with the values in the files. Set them at the beginning of the program."
    )
    return Issue("warning", "changed-data", message, line, subject=", ".join(list(change_places)[:_MOST_NAMES]))
