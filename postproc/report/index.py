"""`index.html` of a folder: its programs with verdicts and worst numbers, failed ones first."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import quote

from msgspec import Struct

from postproc.correction import Mode
from postproc.report.formatting import estimate, rounded
from postproc.report.kit import Cell, Kind, Note, Notes, Page, Part, Row, Section, Table, Tile, Tiles
from postproc.report.summary import Judged
from postproc.report.text import number, percent

_STATES = ("nothing", "failed", "no forces", "warning", "ok", "called")
"""The worst first."""
_WORDS: dict[str, tuple[str, Kind]] = {
    "nothing": ("nothing written", "error"),
    "failed": ("do not run", "error"),
    "no forces": ("no forces", "warning"),
    "warning": ("look first", "warning"),
    "ok": ("may be run", "good"),
    "called": ("called by others", ""),
}


class Longest(Struct, frozen=True):
    """The largest of some lengths."""

    max_mm: float


class Margin(Struct, frozen=True):
    """The smallest distance of a joint from its limits; None where unknown."""

    min_joint_margin_deg: float | None


class Reported(Struct, frozen=True):
    """What the overview shows of a `report.json`, also of one that an earlier version wrote."""

    program: str
    mode: Mode
    targets: int
    before: Longest
    after: Longest
    u95: Longest | None
    compensated_percent: float | None
    between_max_mm: float | None
    max_force_N: float
    limits: Margin
    verdict: Judged


class Entry(Struct, frozen=True):
    """A program of the folder.

    :param name: its file.
    :param page: name of its report, in the folder; empty where there is none.
    :param content: from its `report.json`; None if it was not written.
    :param message: why it was not written.
    :param called: it was not to be written by itself.
    """

    name: str
    page: str
    content: Reported | None
    message: str = ""
    called: bool = False

    @property
    def state(self) -> str:
        """The verdict, or ``"nothing"``, ``"called"``, ``"no forces"`` (nothing was corrected for lack of forces)."""
        if self.content is None:
            return "called" if self.called else "nothing"
        state = self.content.verdict.state
        return "no forces" if state == "warning" and self.content.max_force_N == 0.0 else state


def index_page(entries: Sequence[Entry], folder: str) -> bytes:
    """Return the page as HTML in UTF-8: one self-contained file, with links to the reports in its folder.

    :param entries: in any order.
    :param folder: its name.
    """
    ordered = sorted(entries, key=_rank)
    written = [entry.content for entry in entries if entry.content is not None]
    counts = {state: sum(entry.state == state for entry in entries) for state in _WORDS}
    tiles = [Tile("Programs", str(len(entries)))]
    tiles += [Tile(_WORDS[state][0], str(count), kind=_WORDS[state][1]) for state, count in counts.items() if count]
    if written:
        bounds = [content.u95.max_mm for content in written if content.u95 is not None]
        most = max(bounds, default=None)
        before, after = (max(each) for each in zip(*((c.before.max_mm, c.after.max_mm) for c in written), strict=True))
        tiles.append(Tile("Largest deviation before", estimate(before, most), "mm"))
        tiles.append(Tile("After", estimate(after, most), "mm"))
        unknown = len(written) - len(bounds)
        note = f"unknown for {unknown} of {len(written)}" if unknown else ""
        tiles.append(
            Tile("On the part (95 %)", "unknown" if most is None else rounded(most), "mm" if bounds else "", note)
        )
    parts: list[Part] = [Tiles(tuple(tiles)), _table(ordered, written)]
    failed = [entry for entry in ordered if entry.state == "nothing"]
    sections = [Section("programs", "Programs", tuple(parts))]
    if failed:
        notes = tuple(Note(f"{entry.name}: {entry.message}") for entry in failed)
        sections.append(Section("failed", "Not written", (Notes(notes, marked=True),)))
    footer = Note(
        "Deviations are predictions over cutting targets, in millimetres. A name leads to the report of the program."
    )
    return b"".join(Page("Overview", folder, f"{len(entries)} programs", tuple(sections), (footer,)).render())


def _rank(entry: Entry) -> tuple[int, float, str]:
    if entry.content is None:
        return _STATES.index(entry.state), 0.0, entry.name
    bound = entry.content.u95
    worst = entry.content.after.max_mm if bound is None else bound.max_mm
    return _STATES.index(entry.state), -max(worst, entry.content.between_max_mm or 0.0), entry.name


def _table(entries: Sequence[Entry], written: Sequence[Reported]) -> Table:
    head = (
        "Program",
        "Verdict",
        "Why",
        "Targets",
        "Before, mm",
        "After, mm",
        "On the part (95 %), mm",
        "Compensated",
        "Margin, °",
    )
    rows = []
    for entry in entries:
        word, kind = _WORDS[entry.state]
        name = Cell(entry.name, href=quote(entry.page))
        if entry.content is None:
            rows.append(Row((name, Cell(word, kind), entry.message if entry.called else "see below", *("-",) * 6)))
            continue
        content = entry.content
        u95 = None if content.u95 is None else content.u95.max_mm
        rows.append(
            Row(
                (
                    name,
                    Cell(word, kind),
                    content.verdict.reasons[0] if entry.state != "ok" else "",
                    str(content.targets),
                    estimate(content.before.max_mm, u95),
                    estimate(content.after.max_mm, u95),
                    "unknown" if u95 is None else rounded(u95) if u95 > 0.0 else "-",
                    percent(content.compensated_percent),
                    number(content.limits.min_joint_margin_deg, 1),
                )
            )
        )
    targets = sum(content.targets for content in written)
    note = f"{targets} targets in {len(written)} programs; largest values of each. Failed ones come first."
    return Table(head, tuple(rows), "Programs of the folder", texts=(1, 2), sortable=True, note=note)
