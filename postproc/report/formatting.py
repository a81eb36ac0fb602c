"""Numbers and tables as text: millimetres with as many digits as their uncertainty leaves."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Literal, Protocol

from postproc.frames import MM_PER_M

State = Literal["ok", "warning", "failed"]
"""State of a verdict."""
ROUNDING_MM = 1e-4
"""Deviation at a target by the rounding of written numbers (X, Y, Z to 1e-4 mm): factors below it mean nothing."""
_MOST_DECIMALS = 9
"""Largest number of decimals of a length [mm]: a picometre."""


def stated_mm(length: float) -> float:
    """Return a length [m] that the user stated in mm, in mm with the digits as stated.

    >>> stated_mm(0.249 * 1e-3), 0.249 * 1e-3 * 1e3
    (0.249, 0.24899999999999997)
    """
    return float(f"{length * MM_PER_M:.12g}")


def millimetre_text(value: float) -> str:
    """Return a distance [mm] as text, to a tenth of a micrometre; "<0.0001" below that.

    >>> millimetre_text(8.28), millimetre_text(0.0), millimetre_text(0.00008)
    ('8.2800', '0.0000', '<0.0001')
    """
    return "<0.0001" if 0.0 < value < ROUNDING_MM else f"{value:.4f}"


def two_digit_text(value_mm: float) -> str:
    """Return a bound or an estimate [mm] as text, with two significant digits but at most four decimals.

    Below 0.0001 mm it is "<0.0001"; 0 is "0".

    >>> two_digit_text(0.2752), two_digit_text(0.01234), two_digit_text(12.7), two_digit_text(0.0)
    ('0.28', '0.012', '13', '0')
    >>> two_digit_text(0.0002), two_digit_text(0.00002)
    ('0.0002', '<0.0001')
    """
    if value_mm == 0.0:
        return "0"
    return (
        "<0.0001" if value_mm < ROUNDING_MM else f"{float(f'{value_mm:.2g}'):.{min(two_digit_decimals(value_mm), 4)}f}"
    )


def two_digit_decimals(value_mm: float) -> int:
    """Return the number of decimals that show two significant digits of a length [mm].

    2 if the length is not positive, infinite or NaN.

    >>> two_digit_decimals(0.2752), two_digit_decimals(0.0999), two_digit_decimals(3.0), two_digit_decimals(25.0)
    (2, 2, 1, 0)
    """
    if not (value_mm > 0.0 and math.isfinite(value_mm)):
        return 2
    return max(0, 1 - math.floor(math.log10(float(f"{value_mm:.2g}"))))


def estimate_text(value_mm: float, u95_mm: float | None) -> str:
    """Return a predicted distance [mm] as text, with the decimals of two significant digits of its uncertainty.

    The distance has two significant digits if its uncertainty is unknown or below 0.0001 mm, or if the distance is
    below the last of these decimals.

    :param u95_mm: uncertainty (95 %) of the distance; None: unknown.

    >>> estimate_text(0.5218, 0.2752), estimate_text(0.5218, 0.0093)
    ('0.52', '0.5218')
    >>> estimate_text(1.0687, None), estimate_text(0.0042, 0.28)
    ('1.1', '0.0042')
    >>> estimate_text(0.00008, 0.28), estimate_text(0.0, None)
    ('<0.0001', '0')
    """
    if u95_mm is None or u95_mm < ROUNDING_MM or value_mm < 10.0 ** -two_digit_decimals(u95_mm):
        return two_digit_text(value_mm)
    return f"{value_mm:.{two_digit_decimals(u95_mm)}f}"


def above_limit_text(value_mm: float, limit_mm: float) -> str:
    """Return a length [mm] as text, with two significant digits, or as many as show that it is above a limit [mm].

    >>> above_limit_text(0.0493, 0.01), above_limit_text(0.0104, 0.01)
    ('0.049', '0.0104')
    """
    decimals = two_digit_decimals(value_mm)
    while decimals < _MOST_DECIMALS and float(f"{value_mm:.{decimals}f}") <= limit_mm:
        decimals += 1
    return f"{value_mm:.{decimals}f}"


class Display(Protocol):
    """An output for summaries."""

    def verdict(self, text: str, state: State) -> str:
        """Return the text of a verdict in the style of its state, such as a colour."""
        ...

    def table(
        self, head: Sequence[str], rows: Sequence[Sequence[str]], right: Collection[int] = (), indent: str = ""
    ) -> str:
        """Return a table.

        :param head: head of each column.
        :param rows: cells of each row, as many as heads.
        :param right: indices of the columns that are aligned right: numbers.
        :param indent: text before each line.
        """
        ...


class PlainFormat:
    """Summaries as plain text; each column of a table is as wide as its widest cell."""

    def verdict(self, text: str, state: State) -> str:
        """Return the text as it is: plain text has no style."""
        del state
        return text

    def table(
        self, head: Sequence[str], rows: Sequence[Sequence[str]], right: Collection[int] = (), indent: str = ""
    ) -> str:
        """Return a table as text; parameters as of `Display.table`.

        >>> print(PlainFormat().table(("axis", "mm"), [("X", "1.5"), ("Y", "-12.0")], right=(1,)))
        axis     mm
        X       1.5
        Y     -12.0
        """
        cells = [tuple(head), *map(tuple, rows)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        return "\n".join(
            indent
            + "  ".join(
                cell.rjust(width) if column in right else cell.ljust(width)
                for column, (cell, width) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in cells
        )


PLAIN = PlainFormat()
