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
    """Return the payload [kg] that names of an arm state if a load on it exceeds this by far; None if not.

    :param mass: of the load [kg].
    """
    rating = rated_payload(*names)
    return rating if rating is not None and mass > _OVERLOAD * rating else None


def rated_payload(*names: str) -> float | None:
    """Return the payload [kg] that the first of these names with a class states; None if none does.

    >>> rated_payload("KUKA KR 210-2 L150"), rated_payload("ABB IRB 6700-200/2.60"), rated_payload("arm")
    (150.0, 200.0, None)
    """
    for name in names:
        for pattern in _CLASSES:
            if match := pattern.search(name):
                return float(match[2] or match[1])
    return None
