"""Errors of planning."""

from __future__ import annotations

from postproc.errors import InputError


class PlanError(InputError):
    """No plan is possible: constraints that exclude each other, a load that shows nothing, no forces."""
