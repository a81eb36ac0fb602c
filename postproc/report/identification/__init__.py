"""`report.html` of an identification: one page, a pure function of `identification.json`."""

from __future__ import annotations

from collections.abc import Callable

from postproc.identification.record import Identified
from postproc.report.identification import sections
from postproc.report.kit import Note, Page, Section

SECTIONS: tuple[Callable[[Identified], Section | None], ...] = (
    sections.verdict,
    sections.summary,
    sections.to_know,
    sections.configurations,
    sections.parameters,
    sections.levels,
    sections.structures,
    sections.correlations,
    sections.geometry,
    sections.calibrated,
    sections.placement,
)
"""The sections of the page in order. One that has nothing to say returns None."""


def page(told: Identified, name: str) -> bytes:
    """Return the page as HTML in UTF-8: one file that loads nothing.

    :param told: content of `identification.json`.
    :param name: of the model that was written.
    """
    count = "" if told.residual is None else f"{len(told.residual.per_configuration)} configurations · "
    found = tuple(section for make in SECTIONS if (section := make(told)) is not None)
    footer = (
        Note(
            "Intervals are 95 %, from the noise of the readings; what the structure of the model does not describe "
            "comes on top, see the errors on configurations left out."
        ),
    )
    subtitle = f"found from {told.robot}, method {told.method} · {count}noise σ {told.sigma_mm:.3g} mm a coordinate"
    return b"".join(Page("Identification report", name, subtitle, found, footer).render())
