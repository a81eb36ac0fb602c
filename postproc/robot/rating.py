"""Payload that the name of an arm states: manufacturers name arms by it."""

from __future__ import annotations

import re

_CLASSES = (
    re.compile(r"kr[ _-]*(\d+)(?:[ _-]*\d)?(?:[ _-]*l[ _-]*(\d+))?(?!\d)", re.IGNORECASE),
    re.compile(r"irb[ _-]*\d{3,4}\w?[ _-]+(\d{1,3})()[ _/]", re.IGNORECASE),
)
"""Names that state the payload [kg]. KUKA: KR 210 R2700, kr120_r2700_2; with a longer arm KR 210-2 L150 (150 kg).
ABB: IRB 6700-200/2.60 (payload and reach)."""

_OVERLOAD = 1.2
"""Load over the rating from which it is questioned, assumed: arms were calibrated with loads just above it."""


def exceeded_rating(mass: float, *names: str) -> float | None:
    """Return the payload [kg] that the names of an arm state, if a load exceeds it by more than `_OVERLOAD`.

    None if the load is smaller, or if no name states a payload.

    :param mass: of the load [kg].
    :param names: see `rated_payload`.
    """
    rating = rated_payload(*names)
    return rating if rating is not None and mass > _OVERLOAD * rating else None


def rated_payload(*names: str) -> float | None:
    """Return the payload [kg] by the first of some names of an arm that states one; None if no name states a payload.

    >>> rated_payload("KUKA KR 210-2 L150"), rated_payload("ABB IRB 6700-200/2.60"), rated_payload("arm")
    (150.0, 200.0, None)
    """
    for name in names:
        for pattern in _CLASSES:
            if match := pattern.search(name):
                return float(match[2] or match[1])  # of the version with a longer arm, else of the class
    return None
