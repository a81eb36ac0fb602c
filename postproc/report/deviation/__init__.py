"""`report.html` of a program that was converted or predicted: one page, with views that are linked by place."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from msgspec.structs import replace

from postproc.correction import Result
from postproc.report.answers import Remedy
from postproc.report.deviation import sections
from postproc.report.deviation.data import Deviation
from postproc.report.kit import Note, Page, Section
from postproc.report.record import Record
from postproc.report.text import target_count_text

if TYPE_CHECKING:
    from postproc.machining import ProcessForces
    from postproc.report.surface import Surface

SECTIONS: tuple[Callable[[Deviation], Section | None], ...] = (
    sections.verdict_section,
    sections.view3d_section,
    sections.numbers_section,
    sections.surface_section,
    sections.program_section,
    sections.turn_section,
    sections.cut_section,
    sections.histogram_section,
    sections.operations_section,
    sections.feeds_section,
    sections.worst_places_section,
    sections.reversals_section,
    sections.limits_section,
    sections.joints_section,
    sections.model_section,
    sections.issues_section,
    sections.record_section,
    sections.place_section,
)
"""Functions of the sections of the page, in order; a section without content is None."""
ON_PAPER = frozenset({"verdict", "view3d", "numbers", "surface", "operations", "worst", "limits", "record"})
"""The sections that are printed: a record of two sheets."""
_MODES = {
    "convert": "corrected program",
    "nominal": "written without correction",
    "predict": "predicted as programmed, nothing written",
}
_MODE_NOTES = {
    "convert": "“After” is a simulation of the program as written, with its rounded numbers.",
    "nominal": "“After” is a simulation of the program as written: without correction.",
    "predict": "Nothing was corrected or written.",
}


def page(
    result: Result,
    tolerance: float | None = None,
    *,
    surface: Surface | None = None,
    process: ProcessForces | None = None,
    part_tolerance: float | None = None,
    stem: str = "",
    remedies: Sequence[Remedy] = (),
    record: Record | None = None,
) -> Iterator[bytes]:
    """Yield the report of one program as HTML in UTF-8, one file that loads nothing.

    :param result: of one program.
    :param tolerance: largest permitted distance of the tip from the nominal path [m]; None = not stated.
    :param surface: deviations of the surface of the part, see `postproc.report.surface`; None: not computed.
    :param process: forces computed from material and stock; None: the forces have another source.
    :param part_tolerance: largest permitted error of the part [m], 95 %; None = not stated.
    :param stem: beginning of the names of the files that are written with the page, such as ``"part."``.
    :param remedies: measures that would lower the expected error, see `postproc.report.summary.summary`.
    :param record: date, customer and checksums that the page states; None: no record.
    """
    data = Deviation(
        result,
        tolerance,
        surface=surface,
        process=process,
        part_tolerance=part_tolerance,
        stem=stem,
        remedies=tuple(remedies),
        record=record,
    )
    all_sections = (section for section_of in SECTIONS if (section := section_of(data)) is not None)
    sections = tuple(replace(section, printed=section.id in ON_PAPER) for section in all_sections)
    has_views = len(result) > 0  # without targets there is nothing that scripts could show
    content = data.content
    yield from Page(
        kind="Deviation report",
        title=content.program,
        subtitle=f"{result.robot.title or result.robot.name} · {_MODES[result.mode]} · {target_count_text(content)}",
        sections=sections,
        footer=(
            Note(
                "All deviations are predictions of the elastostatic model of the robot under the forces given, not "
                f"measurements, in millimetres. Statistics are along the cutting path. {_MODE_NOTES[result.mode]}"
            ),
        ),
        facts=data.facts() if has_views else None,
        columns=data.columns() if has_views else {},
        scripts=tuple(("postproc.report.deviation", name) for name in _SCRIPTS) if has_views else (),
        record="" if record is None else record.head_line(),
        texts={"source": data.source} if has_views and data.source else {},
    ).render()


_SCRIPTS = ("places", "robot", "along", "histogram", "view3d", "source", "surface", "stock", "place")
