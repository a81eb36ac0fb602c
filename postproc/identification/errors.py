"""Errors of identification."""

from __future__ import annotations

from postproc.errors import InputError


class MeasurementError(InputError):
    """Measurements or the description of an experiment are unusable; the advice says what to measure or correct."""
