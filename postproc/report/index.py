"""`index.html` of a folder: its programs with verdicts and worst numbers, failed ones first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple
from urllib.parse import quote

from msgspec import Struct

from postproc.correction import Mode
from postproc.report.answers import chance_in_words
from postproc.report.formatting import State, two_digit_text
from postproc.report.kit import Cell, Kind, Note, Notes, Page, Part, Row, Section, Table, Tile, Tiles
from postproc.report.text import number_text, percent_text

_STATES_BY_SEVERITY = ("nothing", "failed", "removed", "no forces", "warning", "ok", "called")
"""States of an entry, the worst first."""
_STATE_WORDS: dict[str, tuple[str, Kind]] = {
    "nothing": ("nothing written", "error"),
    "failed": ("do not run", "error"),
    "removed": ("do not load", "error"),
    "no forces": ("no forces", "warning"),
    "warning": ("look first", "warning"),
    "ok": ("may be run", "good"),
    "called": ("called by others", ""),
}
"""Words and style of each state."""


class Margin(Struct, frozen=True):
    """The smallest distance of a joint from its limits [deg]; None where unknown."""

    min_joint_margin_deg: float | None


class ReportedErrors(Struct, frozen=True):
    """Expected errors on the part without and with correction; None where unknown."""

    uncorrected_mm: float | None
    corrected_mm: float | None
    chance: float | None


class ReportedTolerance(Struct, frozen=True):
    """A tolerance that the user gave, of the "part" or of the "path"."""

    mm: float
    of: str


class ReportedVerdict(Struct, frozen=True):
    """The part of a verdict that the overview shows; the answers are None in reports of earlier versions."""

    state: State
    reasons: list[str]
    headline: str = ""
    better: ReportedErrors | None = None
    tolerance: ReportedTolerance | None = None


class ReportedIssue(Struct, frozen=True):
    """Kind of an issue."""

    kind: str


class ReportEntry(Struct, frozen=True):
    """The part of a `report.json` that the overview shows; earlier versions of postproc may have written it."""

    program: str
    mode: Mode
    targets: int
    compensated_percent: float | None
    max_force_N: float
    limits: Margin
    verdict: ReportedVerdict
    issues: list[ReportedIssue] = []

    @property
    def expected_mm(self) -> tuple[float | None, float | None]:
        """Expected errors on the part (95 %), uncorrected and corrected; None where unknown."""
        better = self.verdict.better
        return (None, None) if better is None else (better.uncorrected_mm, better.corrected_mm)


class Entry(Struct, frozen=True):
    """A program of the folder.

    :param name: file name of the program.
    :param page: file name of its report, in the folder; empty: no report.
    :param content: content of its `report.json`; None: the program was not written.
    :param message: reason why the program was not written.
    :param called: it is a subprogram, which is written with the programs that call it.
    :param is_removed: its file is no longer there: the written program is that of an earlier run.
    """

    name: str
    page: str
    content: ReportEntry | None
    message: str = ""
    called: bool = False
    is_removed: bool = False

    @property
    def state(self) -> str:
        """State of the verdict, or ``"no forces"`` if nothing was corrected for lack of forces.

        Programs that were not written: ``"called"`` for subprograms, else ``"nothing"``. Programs that are no longer
        there: ``"removed"``.
        """
        if self.content is None:
            return "called" if self.called else "nothing"
        if self.is_removed:
            return "removed"
        state = self.content.verdict.state
        return "no forces" if state == "warning" and self.content.max_force_N == 0.0 else state


_ERROR_HEAD = ("Uncorrected, up to (95 %)", "Corrected, up to (95 %)")


def index_page(entries: Sequence[Entry], folder: str) -> bytes:
    """Return the page as HTML in UTF-8: one self-contained file, with links to the reports in its folder.

    :param entries: programs of the folder, in any order.
    :param folder: name of the folder, for the head of the page.
    """
    sorted_entries = sorted(entries, key=_SortKey.of)
    reports = [entry.content for entry in entries if entry.content is not None]
    counts = {state: sum(entry.state == state for entry in entries) for state in _STATE_WORDS}
    tiles = [Tile("Programs", str(len(entries)))]
    tiles += [
        Tile(_STATE_WORDS[state][0], str(count), kind=_STATE_WORDS[state][1])
        for state, count in counts.items()
        if count
    ]
    columns = zip(*(content.expected_mm for content in reports), strict=True)
    # not strict: without reports there are no columns
    tiles += [_error_tile(title, lengths) for title, lengths in zip(_ERROR_HEAD, columns, strict=False)]
    parts: list[Part] = [Tiles(tuple(tiles)), _program_table(sorted_entries, reports)]
    failures = [entry for entry in sorted_entries if entry.state == "nothing"]
    sections = [Section("programs", "Programs", tuple(parts))]
    if failures:
        notes = tuple(Note(f"{entry.name}: {entry.message}") for entry in failures)
        sections.append(Section("failed", "Not written", (Notes(notes, bulleted=True),)))
    footer = Note(
        "Expected errors on the part (95 %) on the cutting path, in millimetres; the chance that correction makes the "
        "part better. A name leads to the report of the program."
    )
    return b"".join(Page("Overview", folder, f"{len(entries)} programs", tuple(sections), (footer,)).render())


def _error_tile(title: str, lengths_mm: Sequence[float | None]) -> Tile:
    """Return the tile of the largest expected error [mm], with the number of programs whose error is unknown (None)."""
    known_lengths = [length for length in lengths_mm if length is not None]
    unknown_count = len(lengths_mm) - len(known_lengths)
    note = f"unknown for {unknown_count} of {len(lengths_mm)}" if unknown_count else ""
    if not known_lengths:
        return Tile(title, "unknown", "", note)
    return Tile(title, two_digit_text(max(known_lengths)), "mm", note)


class _SortKey(NamedTuple):
    """Sorting key of an entry: by state, the worst first; by expected error, the largest first; by name."""

    state_rank: int
    negative_error_mm: float
    name: str

    @classmethod
    def of(cls, entry: Entry) -> _SortKey:
        """Return the key of an entry; an unknown expected error counts as 0 mm."""
        corrected_mm = None if entry.content is None else entry.content.expected_mm[1]
        return cls(_STATES_BY_SEVERITY.index(entry.state), -(corrected_mm or 0.0), entry.name)


def _program_table(entries: Sequence[Entry], reports: Sequence[ReportEntry]) -> Table:
    """Return the table of the programs of a folder, a row for each.

    :param entries: programs, in the order of the rows.
    :param reports: contents of the programs that were written; the note counts their targets.
    """
    head = (
        "Program",
        "Verdict",
        "Why",
        "Targets",
        "Uncorrected (95 %), mm",
        "Corrected (95 %), mm",
        "Better",
        "Tolerance, mm",
        "Compensated",
        "Margin, °",
    )
    rows = tuple(_program_row(entry) for entry in entries)
    targets = sum(content.targets for content in reports)
    note = f"{targets} targets in {len(reports)} programs; largest values of each. Failed ones come first."
    return Table(head, rows, "Programs of the folder", texts=(1, 2), sortable=True, note=note)


def _program_row(entry: Entry) -> Row:
    """Return the row of a program in the table; its numbers are "-" if the program was not written."""
    state_text, kind = _STATE_WORDS[entry.state]
    name, content = Cell(entry.name, href=quote(entry.page)), entry.content
    if content is None:
        return Row((name, Cell(state_text, kind), entry.message if entry.called else "see below", *("-",) * 7))
    better, tolerance = content.verdict.better, content.verdict.tolerance
    reason = "" if entry.state == "ok" else content.verdict.reasons[0]
    return Row(
        (
            name,
            Cell(state_text, kind),
            "the program is no longer there" if entry.is_removed else reason,
            str(content.targets),
            *("unknown" if length is None else two_digit_text(length) for length in content.expected_mm),
            "-" if better is None or better.chance is None else chance_in_words(better.chance),
            "-" if tolerance is None or tolerance.of != "part" else f"{tolerance.mm:g}",
            percent_text(content.compensated_percent),
            number_text(content.limits.min_joint_margin_deg, 1),
        )
    )
