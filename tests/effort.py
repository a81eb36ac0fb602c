"""What work costs in calls of functions: the same on every machine, however busy, unlike seconds."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any


def calls(work: Callable[[], object]) -> int:
    """Return how many functions are called, of Python and built in, while `work` runs."""
    count = 0

    def tell(_frame: object, event: str, _argument: Any) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(tell)
    try:
        work()
    finally:
        sys.setprofile(before)
    return count


def calls_for_each(make: Callable[[int], Callable[[], object]], few: int = 2000, more: int = 6000) -> float:
    """Return the calls that each thing costs beyond the first `few`; `make` returns the work for so many."""
    make(few // 10)()  # what is imported or compiled at the first time does not count
    return (calls(make(more)) - calls(make(few))) / (more - few)
