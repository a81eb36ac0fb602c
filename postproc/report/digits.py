"""Millimetres as text, with the digits that they deserve: two significant ones for bounds and estimates."""

from __future__ import annotations

import math

ROUNDING_MM = 1e-4
"""What rounding the written numbers (X, Y, Z to 1e-4 mm) may leave at a target: below it a factor says nothing."""
_PLACES = 9


def millimetres(value: float) -> str:
    """Return a distance in mm as text, with tenths of a micrometre; what is less is below what the text can say.

    >>> millimetres(8.28), millimetres(0.0), millimetres(0.00008)
    ('8.2800', '0.0000', '<0.0001')
    """
    return "<0.0001" if 0.0 < value < ROUNDING_MM else f"{value:.4f}"


def rounded(value_mm: float) -> str:
    """Return a bound or an estimate in mm as text, with two significant digits, down to 0.0001 mm.

    >>> rounded(0.2752), rounded(0.01234), rounded(12.7), rounded(0.0), rounded(0.0002), rounded(0.00002)
    ('0.28', '0.012', '13', '0', '0.0002', '<0.0001')
    """
    if value_mm == 0.0:
        return "0"
    return "<0.0001" if value_mm < ROUNDING_MM else f"{float(f'{value_mm:.2g}'):.{min(places(value_mm), 4)}f}"


def places(value_mm: float) -> int:
    """Return how many decimals show two significant digits.

    >>> places(0.2752), places(0.0999), places(3.0), places(25.0)
    (2, 2, 1, 0)
    """
    if not (value_mm > 0.0 and math.isfinite(value_mm)):
        return 2
    return max(0, 1 - math.floor(math.log10(float(f"{value_mm:.2g}"))))


def estimate(value_mm: float, u95_mm: float | None) -> str:
    """Return a predicted distance in mm as text: as many decimals as the two digits of its uncertainty have.

    Where the uncertainty is not known two significant digits; a value below the last decimal is shown by its own size.

    >>> estimate(0.5218, 0.2752), estimate(0.5218, 0.0093), estimate(1.0687, None), estimate(0.0042, 0.28)
    ('0.52', '0.5218', '1.1', '0.0042')
    >>> estimate(0.00008, 0.28), estimate(0.0, None)
    ('<0.0001', '0')
    """
    if u95_mm is None or u95_mm < ROUNDING_MM or value_mm < 10.0 ** -places(u95_mm):
        return rounded(value_mm)
    return f"{value_mm:.{places(u95_mm)}f}"


def above(value_mm: float, limit_mm: float) -> str:
    """Return a number that is more than a limit as text, with two digits or as many as it takes to see it.

    >>> above(0.0493, 0.01), above(0.0104, 0.01)
    ('0.049', '0.0104')
    """
    decimals = places(value_mm)
    while decimals < _PLACES and float(f"{value_mm:.{decimals}f}") <= limit_mm:
        decimals += 1
    return f"{value_mm:.{decimals}f}"
