"""Types of options for finite numbers, also within a range."""

from __future__ import annotations

import math
from typing import Any

import click


class FiniteFloat(click.types.FloatParamType):
    """Type of a finite number; that of click accepts nan and inf."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number of a text; nan, inf and other texts end the command with a message."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is no number.", param, ctx)
        return number


class FiniteRange(FiniteFloat, click.FloatRange):
    """Type of a finite number within a range."""
