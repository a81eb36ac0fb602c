"""The page of a plan of measurements: what to expect of it, what it is compared with, the poses in space."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from postproc.plan import PlanResult
from postproc.report.kit import Note, Page, Section
from postproc.report.plan import sections
from postproc.report.plan.poses import poses

SECTIONS: tuple[Callable[[PlanResult], Section | None], ...] = (
    sections.expected,
    sections.warnings,
    poses,
    sections.angles,
    sections.comparison,
    sections.sizes,
    sections.tests,
    sections.parameters,
    sections.torques,
)
"""The sections of the page in order. One that has nothing to say returns None."""


def plan_page(result: PlanResult, name: str) -> bytes:
    """Return the page as HTML in UTF-8: one file that loads nothing.

    :param name: of the plan.
    """
    how = (
        "Criterion as printed in the paper: each level of q2 identified alone."
        if result.options.grouped
        else "Criterion: covariance of Eq. (8), shared by the levels; k2 at a test pose from them by Eq. (9), (10)."
    )
    footer = (
        Note(
            f"{how} The expected accuracy is that of an identification which weights all readings by their noise. It "
            "counts the noise of the readings only: what the model does not describe comes on top. "
            f"Seed {result.options.seed}; the same seed and files give the same plan."
        ),
    )
    found = tuple(section for make in SECTIONS if (section := make(result)) is not None)
    return b"".join(Page("Plan of measurements", name, _subtitle(result), found, footer).render())


def _subtitle(result: PlanResult) -> str:
    levels = len(np.unique(result.plan.level))
    stopped = " · search interrupted: the best plan so far" if result.interrupted else ""
    more = " in addition to those measured" if result.before is not None else ""
    return (
        f"{result.robot} · {len(result.plan)} poses{more} on {levels} levels of q2 · "
        f"load {result.site.rig.force:.0f} N · test poses from {result.tests.source}{stopped}"
    )
