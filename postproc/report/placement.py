"""The place of the part as JSON, CSV, text, `[base]` and page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.files import FileEntry, json_bytes
from postproc.frames import DEG_PER_RAD, MM_PER_M
from postproc.placement.drive import PLACE_REASONS
from postproc.placement.region import AXES, Assessment, JudgedPlace, Region, Search
from postproc.report.formatting import two_digits
from postproc.report.kit import Axis, Map, Note, Notes, Page, Plot, Points, Row, Section, Table, Tile, Tiles

_COLUMNS = (
    *AXES,
    "turn_deg",
    "deflection_mm",
    "u95_mm",
    "min_joint_margin_deg",
    "min_singular_value",
    "reachable",
    "reason",
)
_UNITS = ("mm", "mm", "mm", "°", "mm")
"""Units of `AXES`."""
_SAME_PLANE = 0.5
"""Distance of a place from the plane of a map within which it is on it [mm, deg]."""
_NO_BODIES = "Collisions do not count in this choice: the cell has no [collision]."
_NO_STOCK = "Stock is not among these bodies: convert checks it, with --process."
_LATER_REFUSALS = 4
"""Reasons of the whole path or of conversions that are printed."""
_SAME_PLACE = 0.01
"""Share of the expected error below which a gain is none."""
_NO_FORCE_NOTE = "No cutting move carries a force, so the error is not compared: give --forces or --process."


class PlaceEntry(Struct, frozen=True):
    """A place [mm, deg] and how the programs are there; null where they cannot be driven.

    `uncorrected_mm`, `corrected_mm` and `chance` are those of `postproc.report.answers`, by a conversion at this place;
    null where the model states no uncertainty.
    """

    X: float
    Y: float
    Z: float
    A: float
    E1: float
    turn_deg: float
    deflection_mm: float | None
    uncorrected_mm: float | None
    corrected_mm: float | None
    chance: float | None
    min_joint_margin_deg: float | None
    min_singular_value: float | None
    reachable: bool
    reason: str | None


class PlaceSummary(Struct, frozen=True, omit_defaults=True, kw_only=True):
    """Content of `place.json`."""

    programs: list[str]
    robot: str
    margin_deg: float
    clearance_mm: float | None
    start: str | None
    region: dict[str, list[float]]
    today: PlaceEntry
    best: PlaceEntry | None
    grid: str
    tried: int
    reachable: int
    refused: dict[str, int]
    refused_later: dict[str, int] = {}
    moved_frames: list[str] = []
    sentence: str
    files: list[FileEntry] | None = None


def summary(
    search: Search,
    cell: Cell,
    programs: Sequence[str],
    margin_deg: float,
    clearance_mm: float | None,
    region: Region,
    start: str | None,
    moved_frames: list[str],
) -> PlaceSummary:
    """Return the result as plain data.

    :param clearance_mm: distance of bodies that was kept; None: they were not compared.
    :param start: how the start was chosen; None: the cell states it.
    :param moved_frames: tables of frames by number that move with `[base]`, such as ``"base_data.1"``.
    """
    reasons = np.bincount([place.reason for place in search.trials], minlength=len(PLACE_REASONS)).tolist()
    return PlaceSummary(
        programs=list(programs),
        robot=cell.robot,
        margin_deg=margin_deg,
        clearance_mm=clearance_mm,
        start=start,
        region={axis: [region.low[k], region.high[k]] for k, axis in enumerate(AXES) if k in region.free},
        today=_place_entry(search.today),
        best=None if search.best is None else _place_entry(search.best),
        grid="place.csv",
        tried=len(search.trials),
        reachable=reasons[0],
        refused={name: count for name, count in zip(PLACE_REASONS[1:], reasons[1:], strict=True) if count},
        refused_later=dict(Counter(place.problem for place in search.refusals)),
        moved_frames=moved_frames,
        sentence=_sentence(search),
    )


def _finite(value: float | None, decimals: int) -> float | None:
    """Return a number with so many decimals; None for None, NaN and infinity, which JSON does not have."""
    return None if value is None or not np.isfinite(value) else round(value, decimals)


def _in_mm(value: float | None) -> float | None:
    """Return a length [m] in mm, to a nanometre; None if it is unknown."""
    return None if value is None else _finite(value * MM_PER_M, 6)


def _place_entry(place: JudgedPlace) -> PlaceEntry:
    """Return a judged place as an entry of place.json [mm, deg]."""
    assessment = Assessment(deflection=place.deflection) if place.assessment is None else place.assessment
    x, y, z, a, e1 = (round(value, 4) for value in place.place)
    return PlaceEntry(
        X=x,
        Y=y,
        Z=z,
        A=a,
        E1=e1,
        turn_deg=round(place.turn * DEG_PER_RAD, 3),
        deflection_mm=_in_mm(assessment.deflection),
        uncorrected_mm=_in_mm(assessment.uncorrected),
        corrected_mm=_in_mm(assessment.corrected),
        chance=_finite(assessment.chance, 6),
        min_joint_margin_deg=_finite(place.margin * DEG_PER_RAD, 3),
        min_singular_value=_finite(place.singular, 6),
        reachable=place.reachable,
        reason=place.problem or None,
    )


def _sentence(search: Search) -> str:
    """Return the advice of the search in one sentence: where to move the part, and the gain."""
    today, best = search.today, search.best
    if best is None and search.refusals:
        place = search.refusals[0]
        return (
            f"No place of the region was found at which the programs can be driven: {len(search.refusals)} that can be "
            f"by samples of the path were tried further. {_coordinates(place.place)}: {place.problem}."
        )
    if best is None:
        return "No place in the region can be driven."
    moves = []
    for axis, unit, today_value, best_value in zip(AXES, _UNITS, today.place, best.place, strict=True):
        if abs(best_value - today_value) > 0.05:
            moves.append(f"{axis} {best_value - today_value:+.4g} {unit}".replace(" °", "°"))
    move = ", ".join(moves)
    kind = "deflection" if np.isnan(best.u95) else "expected error (95 %)"
    error = f"up to {_cost_text(best)} mm"
    is_unloaded = best.cost == 0.0
    if not today.reachable:
        advice = f"move the part by {move}" if moves else "the same place with another turn of the tool can be driven"
        if is_unloaded:
            return f"Today's place cannot be driven ({today.problem}): {advice}. {_NO_FORCE_NOTE}"
        return f"Today's place cannot be driven ({today.problem}): {advice}; the {kind} is then {error}."
    if is_unloaded:
        return f"Today's place can be driven. {_NO_FORCE_NOTE}"
    if best.stated_cost >= (1.0 - _SAME_PLACE) * today.stated_cost or not moves:
        return f"Today's place is as good as any in the region: the {kind} is up to {_cost_text(today)} mm."
    return f"Moving the part by {move} lowers the {kind} from up to {_cost_text(today)} to {error}."


def _cost_text(place: JudgedPlace) -> str:
    """Return the expected error, or the deflection, that is stated of a place [mm] as text."""
    return two_digits(place.stated_cost * MM_PER_M)


def places_csv(search: Search) -> Iterator[bytes]:
    """Yield one row for each place that was tried, in order."""
    yield (",".join(_COLUMNS) + "\n").encode()
    for place in search.trials:
        entry = _place_entry(place)
        values: list[object] = [
            _in_mm(place.u95) if name == "u95_mm" else getattr(entry, name) for name in _COLUMNS[:-2]
        ]
        values += [int(place.reachable), entry.reason]
        yield (",".join("" if value is None else str(value) for value in values) + "\n").encode()


def base_toml(search: Search, cell: Cell, content: PlaceSummary) -> bytes:
    """Return the `[base]` of the best place, and what moves with it, ready to paste."""
    best = search.best
    assert best is not None
    x, y, z, a, e1 = best.place
    lines = [f"# {content.sentence}"]
    if e1:
        lines.append(f"# Seen from E1 = 0; E1 is at {e1:.1f} mm, or this much farther than a KRL program has it.")
    if best.turn:
        lines.append(f"# With the tool turned by {best.turn * DEG_PER_RAD:+.0f}° about its axis.")
    lines += [f"# {note}" for note in _frame_notes(content)]
    frame = [f"{axis} = {value:.4f}" for axis, value in zip("XYZA", (x, y, z, a), strict=True)]
    frame += [f"{axis} = {getattr(cell.base, axis):.4f}" for axis in "BC" if getattr(cell.base, axis)]
    for table in ("base", *content.moved_frames):
        lines += [f"[{table}]", *frame]
    return ("\n".join(lines) + "\n").encode()


def place_json(content: PlaceSummary, files: list[FileEntry]) -> bytes:
    """Return `place.json`."""
    return json_bytes(replace(content, files=files))


def as_text(content: PlaceSummary) -> str:
    """Return the result as text."""
    lines = [content.sentence]
    lines += [_place_line("today", content.today), _place_line("best", content.best)]
    refusals = ", ".join(f"{count} {name}" for name, count in content.refused.items())
    lines.append(
        f"  {content.tried} places tried, {content.reachable} can be driven by samples of the path"
        + (f"; {refusals}" if refusals else "")
    )
    lines += [f"  {note}" for note in _later_refusal_lines(content)]
    lines += [] if content.start is None else [f"  {content.start}"]
    lines += [f"  {note}" for note in _frame_notes(content)]
    margins = f"  kept: {content.margin_deg:g}° to joint limits"
    if content.clearance_mm is not None:
        return "\n".join(
            [*lines, f"{margins}, {content.clearance_mm:g} mm between bodies of [collision]", f"  {_NO_STOCK}"]
        )
    lines += [margins, f"  {_NO_BODIES}"]
    return "\n".join(lines)


def _later_refusal_lines(content: PlaceSummary) -> Iterator[str]:
    """Yield why places were refused by the whole path, or by a conversion there, most frequent reason first."""
    reasons = sorted(content.refused_later.items(), key=lambda item: -item[1])
    for reason, count in reasons[:_LATER_REFUSALS]:
        yield f"refused by the whole path or its conversion: {count} ({reason})"
    if len(reasons) > _LATER_REFUSALS:
        other_count = sum(count for _, count in reasons[_LATER_REFUSALS:])
        yield f"refused by the whole path or its conversion: {other_count} (other reasons, see place.json)"


def _frame_notes(content: PlaceSummary) -> Iterator[str]:
    """Yield what to do with each frame by number that moves with `[base]`."""
    for table in content.moved_frames:
        name, _, number = table.partition(".")
        yield f"[{table}] moves with [base]: give {name.upper()}[{number}] of the controller these numbers too."


def _place_line(name: str, entry: PlaceEntry | None) -> str:
    """Return a place with its error and margin as one line."""
    if entry is None:
        return f"  {name}: none"
    place = f"X {entry.X:.1f} Y {entry.Y:.1f} Z {entry.Z:.1f} A {entry.A:.2f}"
    place += f" E1 {entry.E1:.1f}" if entry.E1 else ""
    place += f", tool turned by {entry.turn_deg:+.0f}°" if entry.turn_deg else ""
    if not entry.reachable:
        return f"  {name}: {place}: {entry.reason}"
    error = f"deflection up to {two_digits(entry.deflection_mm or 0.0)} mm"
    if entry.uncorrected_mm is not None and entry.corrected_mm is not None:
        error = (
            f"uncorrected up to {two_digits(entry.uncorrected_mm)}, corrected up to {two_digits(entry.corrected_mm)} mm"
        )
        error += " (95 %)"
    return f"  {name}: {place}: {error}, joint margin {entry.min_joint_margin_deg:.1f}°"


def page(search: Search, content: PlaceSummary) -> Iterator[bytes]:
    """Yield `place.html`, one file that loads nothing."""
    sections = (_place_section(search, content), *_map_sections(search), _refusal_section(content))
    note = (
        "Expected errors and deflections are predictions of the elastostatic model of the robot under the forces "
        "given, the largest over cuts. Those of today's and the best place are by a conversion there, those of the map "
        f"by samples of the path. {_collision_note(content)}"
    )
    yield from Page(
        kind="Place of the part",
        title=", ".join(content.programs),
        subtitle=f"{content.robot} · {content.tried} places",
        sections=sections,
        footer=(Note(note),),
    ).render()


def _collision_note(content: PlaceSummary) -> str:
    """Return a sentence on the collisions that were, or were not, checked."""
    clearance_mm = content.clearance_mm
    if clearance_mm is None:
        return _NO_BODIES
    return (
        f"Places where bodies of [collision] come closer than {clearance_mm:g} mm, or touch, are refused. {_NO_STOCK}"
    )


def _place_section(search: Search, content: PlaceSummary) -> Section:
    """Return the section with today's and the best place."""
    tiles = []
    for title, place in (("Today", search.today), ("Best place", search.best)):
        if place is None or not place.reachable:
            tiles.append(Tile(title, "-", "", "none" if place is None else place.problem, "warning"))
            continue
        x, y, z, a, _ = place.place
        kind = "deflection, largest" if np.isnan(place.u95) else "expected error (95 %), largest"
        turn = f"; tool turned by {place.turn * DEG_PER_RAD:+.0f}°" if place.turn else ""
        place_text = f"X {x:.0f} Y {y:.0f} Z {z:.0f} A {a:.1f}{turn}"
        note = f"{kind}; {place_text}; joint margin {place.margin * DEG_PER_RAD:.1f}°"
        tiles.append(Tile(title, _cost_text(place), "mm", note))
    start_notes = () if content.start is None else (Note(content.start),)
    frame_notes = map(Note, _frame_notes(content))
    later_notes = map(Note, _later_refusal_lines(content))
    notes = Notes((Note(content.sentence), Note(_collision_note(content)), *later_notes, *start_notes, *frame_notes))
    return Section("place", "Where the part should be", (notes, Tiles(tuple(tiles))))


def _map_sections(search: Search) -> Iterator[Section]:
    """Yield the section with the map in X and Y, and that in A and Z, both through `Search.slice_place`.

    The second is left out unless the search tried a whole grid in A and Z.
    """
    x, y = search.slice
    if len(x):
        # the trials of the map are consecutive, column by column; without a match the last ones are taken
        first = len(search.trials) - len(x) * len(y)
        for first in range(len(search.trials) - len(x) * len(y) + 1):
            if search.trials[first].place[:2] == (x[0], y[0]) and _is_slice(search, first):
                break
        columns = [search.trials[first + i * len(y) : first + (i + 1) * len(y)] for i in range(len(x))]
        rows = [[column[k] for column in columns] for k in range(len(y))]
        title = f"Map at Z {search.slice_place[2]:.0f}, A {search.slice_place[3]:.1f}°"
        yield Section("map", title, (_map_plot(search, rows, (0, 1), tuple(x), tuple(y), title),))
    grid = [
        judged_place
        for judged_place in search.trials
        if judged_place.place[:2] == search.slice_place[:2] and judged_place.place[4] == search.slice_place[4]
    ]
    z, a = (sorted({judged_place.place[k] for judged_place in grid}) for k in (2, 3))
    place_at = {(judged_place.place[2], judged_place.place[3]): judged_place for judged_place in reversed(grid)}
    if len(z) > 2 and len(a) > 2 and all((height, angle) in place_at for height in z for angle in a):
        title = f"Map at X {search.slice_place[0]:.0f}, Y {search.slice_place[1]:.0f}"
        rows = [[place_at[height, angle] for angle in a] for height in z]
        yield Section("map-turn", title, (_map_plot(search, rows, (3, 2), tuple(a), tuple(z), title),))


def _is_slice(search: Search, first: int) -> bool:
    """Return whether the trials from row `first` end, after as many as the map has, at its last corner."""
    x, y = search.slice
    last = first + len(x) * len(y) - 1
    return last < len(search.trials) and search.trials[last].place[:2] == (x[-1], y[-1])


def _map_plot(
    search: Search,
    rows: list[list[JudgedPlace]],
    axes: tuple[int, int],
    x: Sequence[float],
    y: Sequence[float],
    title: str,
) -> Plot:
    """Return a map of the expected error over two axes of the place, with today's and the best one marked.

    :param rows: places by row (`y`) and column (`x`).
    :param axes: indices in `AXES` of the horizontal and the vertical axis, `x` and `y` the values on them [mm, deg].
    """
    values = [
        [judged_place.cost * MM_PER_M if judged_place.reachable else None for judged_place in row] for row in rows
    ]
    quantity = (
        "deflection, mm"
        if all(np.isnan(judged_place.u95) for row in rows for judged_place in row)
        else "expected error (95 %), mm"
    )
    grid = Map(
        list(x),
        list(y),
        values,
        [[judged_place.reason for judged_place in row] for row in rows],
        PLACE_REASONS,
        quantity,
    )
    marks, notes = [], []
    if _is_on_map(search, axes, x, y):
        marks.append(
            Points([search.today.place[axes[0]]], [search.today.place[axes[1]]], "today", "before", hollow=True)
        )
        notes.append("Ring: today's place.")
    else:
        notes.append(f"Today's place is not on this map: {_coordinates(search.today.place)}.")
    if search.best is not None:
        marks.append(Points([search.best.place[axes[0]]], [search.best.place[axes[1]]], "best", "warning"))
        notes.append(f"Dot: the best place, {_coordinates(search.best.place)}.")
    return Plot(
        label=f"{title}: expected error by place, and why places are refused.",
        traces=[grid, *marks],
        x=Axis(title=f"{AXES[axes[0]]}, {_UNITS[axes[0]]}"),
        y=Axis(title=f"{AXES[axes[1]]}, {_UNITS[axes[1]]}"),
        height=460,
        note=" ".join(notes),
    )


def _is_on_map(search: Search, axes: tuple[int, int], x: Sequence[float], y: Sequence[float]) -> bool:
    """Return whether today's place is in the plane of a map and between its edges."""
    place = search.today.place
    other_axes = [k for k in range(len(AXES)) if k not in axes]
    in_plane = all(abs(place[k] - search.slice_place[k]) <= _SAME_PLANE for k in other_axes)
    return in_plane and x[0] <= place[axes[0]] <= x[-1] and y[0] <= place[axes[1]] <= y[-1]


def _coordinates(place: Sequence[float]) -> str:
    """Return a place in words; E1 is left out where it is 0."""
    return ", ".join(
        f"{axis} {value:g}{'' if unit == 'mm' else unit}"
        for axis, unit, value in zip(AXES, _UNITS, place, strict=True)
        if axis != "E1" or value
    )


def _refusal_section(content: PlaceSummary) -> Section:
    """Return the section with the numbers of places that can be driven, and of those refused, by reason."""
    rows = tuple(Row((name, f"{count}")) for name, count in content.refused.items())
    rows = (Row(("can be driven by samples of the path", f"{content.reachable}")), *rows)
    table = Table(("What", "places"), rows, "Places that were tried")
    return Section("refused", "Places that were tried", (table,))
