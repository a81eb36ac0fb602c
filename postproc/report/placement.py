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
from postproc.report.formatting import two_digit_text
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
_PLANE_TOLERANCE = 0.5
"""Distance of a place from the plane of a map up to which the place is on the map [mm, deg]."""
_NO_BODIES = "Collisions do not count in this choice: the cell has no [collision]."
_NO_STOCK = "Stock is not among these bodies: convert checks it, with --process."
_MOST_LATER_REFUSALS = 4
"""Largest number of reasons why places were refused after sampling that are printed."""
_LEAST_GAIN = 0.01
"""Share of the expected error: a smaller gain does not count."""
_MOVE_TOLERANCE = 0.05
"""Difference of two places on an axis up to which they are equal [mm, deg]: places are printed with one decimal."""
_NO_FORCE_NOTE = "No cutting move carries a force, so the error is not compared: give --forces or --process."


class PlaceEntry(Struct, frozen=True):
    """A place [mm, deg], with errors and margins of the programs there; null if they cannot be driven there.

    `uncorrected_mm`, `corrected_mm` and `chance` are as in `postproc.report.answers`, from a conversion at this place;
    null if the model states no uncertainty.
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
    region: Region,
    *,
    margin_deg: float,
    clearance_mm: float | None,
    start: str | None,
    moved_frames: list[str],
) -> PlaceSummary:
    """Return the result of a search as the content of `place.json`.

    :param programs: names of the programs.
    :param region: region in which places were tried.
    :param margin_deg: smallest permitted distance from the joint limits.
    :param clearance_mm: smallest permitted distance of bodies; None: collisions were not checked.
    :param start: sentence on how the start was chosen; None: the cell states it.
    :param moved_frames: tables of frames by number that move with `[base]`, such as ``"base_data.1"``.
    """
    # number of places by reason; reason 0 is that a place can be driven
    reachable, *refusal_counts = np.bincount(
        [place.reason for place in search.trials], minlength=len(PLACE_REASONS)
    ).tolist()
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
        reachable=reachable,
        refused={name: count for name, count in zip(PLACE_REASONS[1:], refusal_counts, strict=True) if count},
        refused_later=dict(Counter(place.problem for place in search.refusals)),
        moved_frames=moved_frames,
        sentence=_advice_sentence(search),
    )


def _rounded_or_none(value: float | None, decimals: int) -> float | None:
    """Return a number rounded to `decimals`; None for None, NaN and infinity, which JSON does not have."""
    return None if value is None or not np.isfinite(value) else round(value, decimals)


def _rounded_mm_or_none(value: float | None) -> float | None:
    """Return a length [m] in mm, rounded to a nanometre; None for None, NaN and infinity."""
    return None if value is None else _rounded_or_none(value * MM_PER_M, 6)


def _place_entry(place: JudgedPlace) -> PlaceEntry:
    """Return a judged place as an entry of place.json [mm, deg]."""
    # without a conversion at the place only its deflection, by samples of the path, is known
    assessment = Assessment(deflection=place.deflection) if place.assessment is None else place.assessment
    x, y, z, a, e1 = (round(value, 4) for value in place.place)
    return PlaceEntry(
        X=x,
        Y=y,
        Z=z,
        A=a,
        E1=e1,
        turn_deg=round(place.turn * DEG_PER_RAD, 3),
        deflection_mm=_rounded_mm_or_none(assessment.deflection),
        uncorrected_mm=_rounded_mm_or_none(assessment.uncorrected),
        corrected_mm=_rounded_mm_or_none(assessment.corrected),
        chance=_rounded_or_none(assessment.chance, 6),
        min_joint_margin_deg=_rounded_or_none(place.margin * DEG_PER_RAD, 3),
        min_singular_value=_rounded_or_none(place.singular, 6),
        reachable=place.reachable,
        reason=place.problem or None,
    )


def _advice_sentence(search: Search) -> str:
    """Return the advice of the search in a sentence: where to move the part, and what that gains."""
    today, best = search.today, search.best
    if best is None:
        return _no_place_sentence(search)
    move = _move_text(today, best)  # empty: the same place
    # without a stated uncertainty (u95 is NaN) the cost of a place is its deflection, else its expected error [m]
    kind = "deflection" if np.isnan(best.u95) else "expected error (95 %)"
    error = f"up to {_cost_text(best)} mm"
    is_unloaded = best.cost == 0.0  # no cutting move carries a force
    if not today.reachable:
        advice = f"move the part by {move}" if move else "the same place with another turn of the tool can be driven"
        if is_unloaded:
            return f"Today's place cannot be driven ({today.problem}): {advice}. {_NO_FORCE_NOTE}"
        return f"Today's place cannot be driven ({today.problem}): {advice}; the {kind} is then {error}."
    if is_unloaded:
        return f"Today's place can be driven. {_NO_FORCE_NOTE}"
    has_gain = best.stated_cost < (1.0 - _LEAST_GAIN) * today.stated_cost
    if not has_gain or not move:
        return f"Today's place is as good as any in the region: the {kind} is up to {_cost_text(today)} mm."
    return f"Moving the part by {move} lowers the {kind} from up to {_cost_text(today)} to {error}."


def _no_place_sentence(search: Search) -> str:
    """Return the sentence of a search without a best place, with the reason of the first refusal after sampling."""
    if not search.refusals:
        return "No place in the region can be driven."
    refused_place = search.refusals[0]
    return (
        f"No place of the region was found at which the programs can be driven: {len(search.refusals)} that can be "
        f"by samples of the path were tried further. {_coordinate_text(refused_place.place)}: {refused_place.problem}."
    )


def _move_text(start: JudgedPlace, end: JudgedPlace) -> str:
    """Return the differences of two places by axis, for example "X +100 mm, A -15°"; empty for the same place."""
    moves = [
        f"{axis} {end_value - start_value:+.4g}{'' if unit == '°' else ' '}{unit}"
        for axis, unit, start_value, end_value in zip(AXES, _UNITS, start.place, end.place, strict=True)
        if abs(end_value - start_value) > _MOVE_TOLERANCE
    ]
    return ", ".join(moves)


def _cost_text(place: JudgedPlace) -> str:
    """Return the expected error of a place, or without uncertainty its deflection, as text in mm."""
    return two_digit_text(place.stated_cost * MM_PER_M)


def places_csv(search: Search) -> Iterator[bytes]:
    """Yield place.csv: the head, and one row for each place that was tried, in order; unknown values are empty."""
    yield (",".join(_COLUMNS) + "\n").encode()
    for place in search.trials:
        entry = _place_entry(place)
        # all columns but the last two are fields of an entry; u95_mm is in the CSV file alone
        values: list[object] = [
            _rounded_mm_or_none(place.u95) if name == "u95_mm" else getattr(entry, name) for name in _COLUMNS[:-2]
        ]
        values += [int(place.reachable), entry.reason]
        yield (",".join("" if value is None else str(value) for value in values) + "\n").encode()


def base_toml(search: Search, cell: Cell, content: PlaceSummary) -> bytes:
    """Return `[base]` of the best place, and the tables of frames that move with it, as text for the cell file.

    :param search: a search that found a best place.
    """
    best = search.best
    assert best is not None
    x, y, z, a, e1 = best.place
    lines = [f"# {content.sentence}"]
    if e1:
        lines.append(f"# Seen from E1 = 0; E1 is at {e1:.1f} mm, or this much farther than a KRL program has it.")
    if best.turn:
        lines.append(f"# With the tool turned by {best.turn * DEG_PER_RAD:+.0f}° about its axis.")
    lines += [f"# {note}" for note in _frame_notes(content)]
    # the search leaves B and C of the cell as they are
    frame = [f"{axis} = {value:.4f}" for axis, value in zip("XYZA", (x, y, z, a), strict=True)]
    frame += [f"{axis} = {getattr(cell.base, axis):.4f}" for axis in "BC" if getattr(cell.base, axis)]
    for table in ("base", *content.moved_frames):
        lines += [f"[{table}]", *frame]
    return ("\n".join(lines) + "\n").encode()


def place_json(content: PlaceSummary, files: list[FileEntry]) -> bytes:
    """Return the summary as `place.json`.

    :param files: entries of the files written with it.
    """
    return json_bytes(replace(content, files=files))


def as_text(content: PlaceSummary) -> str:
    """Return the result as text for a terminal."""
    refusals = "".join(
        f"{', ' if k else '; '}{count} {name}" for k, (name, count) in enumerate(content.refused.items())
    )
    margins = f"kept: {content.margin_deg:g}° to joint limits"
    if content.clearance_mm is not None:
        margins += f", {content.clearance_mm:g} mm between bodies of [collision]"
    lines = [
        _place_line("today", content.today),
        _place_line("best", content.best),
        f"{content.tried} places tried, {content.reachable} can be driven by samples of the path{refusals}",
        *_later_refusal_lines(content),
        *([] if content.start is None else [content.start]),
        *_frame_notes(content),
        margins,
        _NO_BODIES if content.clearance_mm is None else _NO_STOCK,
    ]
    return "\n".join([content.sentence, *(f"  {line}" for line in lines)])


def _later_refusal_lines(content: PlaceSummary) -> Iterator[str]:
    """Yield lines on places refused by their whole path or by a conversion, the most frequent reason first."""
    reasons = sorted(content.refused_later.items(), key=lambda item: -item[1])
    for reason, count in reasons[:_MOST_LATER_REFUSALS]:
        yield f"refused by the whole path or its conversion: {count} ({reason})"
    if len(reasons) > _MOST_LATER_REFUSALS:
        other_count = sum(count for _, count in reasons[_MOST_LATER_REFUSALS:])
        yield f"refused by the whole path or its conversion: {other_count} (other reasons, see place.json)"


def _frame_notes(content: PlaceSummary) -> Iterator[str]:
    """Yield, for each table of frames by number that moves with `[base]`, what to change at the controller."""
    for table in content.moved_frames:
        name, _, number = table.partition(".")
        yield f"[{table}] moves with [base]: give {name.upper()}[{number}] of the controller these numbers too."


def _place_line(name: str, entry: PlaceEntry | None) -> str:
    """Return a place with its error and margin as one line.

    :param name: "today" or "best".
    :param entry: the place; None: there is no such place, and the line says "none".
    """
    if entry is None:
        return f"{name}: none"
    place = f"X {entry.X:.1f} Y {entry.Y:.1f} Z {entry.Z:.1f} A {entry.A:.2f}"
    place += f" E1 {entry.E1:.1f}" if entry.E1 else ""
    place += f", tool turned by {entry.turn_deg:+.0f}°" if entry.turn_deg else ""
    if not entry.reachable:
        return f"{name}: {place}: {entry.reason}"
    error = f"deflection up to {two_digit_text(entry.deflection_mm or 0.0)} mm"
    if entry.uncorrected_mm is not None and entry.corrected_mm is not None:
        uncorrected_text, corrected_text = two_digit_text(entry.uncorrected_mm), two_digit_text(entry.corrected_mm)
        error = f"uncorrected up to {uncorrected_text}, corrected up to {corrected_text} mm (95 %)"
    return f"{name}: {place}: {error}, joint margin {entry.min_joint_margin_deg:.1f}°"


def page(search: Search, content: PlaceSummary) -> Iterator[bytes]:
    """Yield `place.html` in UTF-8, one file that loads nothing."""
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
    """Return a sentence on the clearance that was required, or that collisions were not checked."""
    clearance_mm = content.clearance_mm
    if clearance_mm is None:
        return _NO_BODIES
    return (
        f"Places where bodies of [collision] come closer than {clearance_mm:g} mm, or touch, are refused. {_NO_STOCK}"
    )


def _place_section(search: Search, content: PlaceSummary) -> Section:
    """Return the section with today's and the best place: the advice, notes, and a tile for each."""
    tiles = Tiles((_place_tile("Today", search.today), _place_tile("Best place", search.best)))
    start_notes = () if content.start is None else (Note(content.start),)
    frame_notes = map(Note, _frame_notes(content))
    later_notes = map(Note, _later_refusal_lines(content))
    notes = Notes((Note(content.sentence), Note(_collision_note(content)), *later_notes, *start_notes, *frame_notes))
    return Section("place", "Where the part should be", (notes, tiles))


def _place_tile(title: str, place: JudgedPlace | None) -> Tile:
    """Return the tile of a place: its expected error, or the reason why it cannot be driven.

    :param place: None: there is no such place.
    """
    if place is None or not place.reachable:
        return Tile(title, "-", "", "none" if place is None else place.problem, "warning")
    x, y, z, a, _ = place.place
    kind = "deflection, largest" if np.isnan(place.u95) else "expected error (95 %), largest"
    turn = f"; tool turned by {place.turn * DEG_PER_RAD:+.0f}°" if place.turn else ""
    place_text = f"X {x:.0f} Y {y:.0f} Z {z:.0f} A {a:.1f}{turn}"
    note = f"{kind}; {place_text}; joint margin {place.margin * DEG_PER_RAD:.1f}°"
    return Tile(title, _cost_text(place), "mm", note)


def _map_sections(search: Search) -> Iterator[Section]:
    """Yield the section with the map in X and Y, and the section with the map in A and Z, through `Search.slice_place`.

    A map is left out unless the search tried a whole grid in its axes.
    """
    # the plane of both maps goes through this place
    slice_x, slice_y, slice_z, slice_a, slice_e1 = search.slice_place
    x, y = search.slice  # coordinates of the grid of the map in X and Y [mm]; empty without a grid
    if len(x):
        title = f"Map at Z {slice_z:.0f}, A {slice_a:.1f}°"
        yield Section("map", title, (_map_plot(search, _slice_rows(search), (0, 1), x, y, title),))
    place_at: dict[tuple[float, float], JudgedPlace] = {}  # (Z, A) → its place; of several trials the first counts
    for trial in search.trials:
        trial_x, trial_y, trial_z, trial_a, trial_e1 = trial.place
        if (trial_x, trial_y, trial_e1) == (slice_x, slice_y, slice_e1):
            place_at.setdefault((trial_z, trial_a), trial)
    heights, angles = sorted({z for z, _ in place_at}), sorted({a for _, a in place_at})
    is_whole_grid = all((z, a) in place_at for z in heights for a in angles)
    if len(heights) > 2 and len(angles) > 2 and is_whole_grid:
        title = f"Map at X {slice_x:.0f}, Y {slice_y:.0f}"
        rows = [[place_at[z, a] for a in angles] for z in heights]
        yield Section("map-turn", title, (_map_plot(search, rows, (3, 2), angles, heights, title),))


def _slice_rows(search: Search) -> list[list[JudgedPlace]]:
    """Return the places of the map in X and Y by row (Y) and column (X).

    The trials of the map are consecutive, column by column. They are found by their first and last corner; if no trials
    match, the last ones are taken.
    """
    x, y = search.slice
    count = len(x) * len(y)
    trials = search.trials[len(search.trials) - count :]
    for begin in range(len(search.trials) - count + 1):
        first_place, last_place = search.trials[begin].place, search.trials[begin + count - 1].place
        if first_place[:2] == (x[0], y[0]) and last_place[:2] == (x[-1], y[-1]):
            trials = search.trials[begin : begin + count]
            break
    return [list(trials[row :: len(y)]) for row in range(len(y))]


def _map_plot(
    search: Search,
    rows: list[list[JudgedPlace]],
    axes: tuple[int, int],
    x: Sequence[float],
    y: Sequence[float],
    title: str,
) -> Plot:
    """Return a map of the expected error over two axes of the place; today's and the best place are marked.

    :param rows: places by row (`y`) and column (`x`).
    :param axes: indices in `AXES` of the horizontal and the vertical axis.
    :param x: values on the horizontal axis [mm, deg], `y` values on the vertical axis.
    """
    horizontal, vertical = axes
    errors_mm = [[place.cost * MM_PER_M if place.reachable else None for place in row] for row in rows]
    reasons = [[place.reason for place in row] for row in rows]
    has_no_bound = all(np.isnan(place.u95) for row in rows for place in row)
    quantity = "deflection, mm" if has_no_bound else "expected error (95 %), mm"
    grid = Map(list(x), list(y), errors_mm, reasons, PLACE_REASONS, quantity)
    marks, notes = [], []
    today, best = search.today.place, None if search.best is None else search.best.place
    if _is_on_map(search, axes, x, y):
        marks.append(Points([today[horizontal]], [today[vertical]], "today", "before", hollow=True))
        notes.append("Ring: today's place.")
    else:
        notes.append(f"Today's place is not on this map: {_coordinate_text(today)}.")
    if best is not None:
        marks.append(Points([best[horizontal]], [best[vertical]], "best", "warning"))
        notes.append(f"Dot: the best place, {_coordinate_text(best)}.")
    return Plot(
        label=f"{title}: expected error by place, and why places are refused.",
        traces=[grid, *marks],
        x=Axis(title=f"{AXES[horizontal]}, {_UNITS[horizontal]}"),
        y=Axis(title=f"{AXES[vertical]}, {_UNITS[vertical]}"),
        height=460,
        note=" ".join(notes),
    )


def _is_on_map(search: Search, axes: tuple[int, int], x: Sequence[float], y: Sequence[float]) -> bool:
    """Return whether today's place is in the plane of a map and between its edges; parameters as of `_map_plot`."""
    place, (horizontal, vertical) = search.today.place, axes
    normal_axes = [k for k in range(len(AXES)) if k not in axes]
    is_in_plane = all(abs(place[k] - search.slice_place[k]) <= _PLANE_TOLERANCE for k in normal_axes)
    return is_in_plane and x[0] <= place[horizontal] <= x[-1] and y[0] <= place[vertical] <= y[-1]


def _coordinate_text(place: Sequence[float]) -> str:
    """Return a place [mm, deg] in words, for example "X 1500, Y 0, Z 700, A 15°"; E1 is left out if it is 0."""
    return ", ".join(
        f"{axis} {value:g}{'' if unit == 'mm' else unit}"
        for axis, unit, value in zip(AXES, _UNITS, place, strict=True)
        if axis != "E1" or value
    )


def _refusal_section(content: PlaceSummary) -> Section:
    """Return the section with the number of places that can be driven, and the numbers of refused places by reason."""
    rows = tuple(Row((name, f"{count}")) for name, count in content.refused.items())
    rows = (Row(("can be driven by samples of the path", f"{content.reachable}")), *rows)
    table = Table(("What", "places"), rows, "Places that were tried")
    return Section("refused", "Places that were tried", (table,))
