"""Sections of the page of a program."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec.structs import astuple

from postproc import placement
from postproc.correction import statistics
from postproc.errors import Issue, first_of
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm
from postproc.operations import tool_text
from postproc.placement import FREE, NO_CLEARANCE, REASONS, Turn
from postproc.program import Ints, distinct
from postproc.report.deviation.data import Deviation, correction
from postproc.report.feed import duration_text, feed_sentences
from postproc.report.formatting import ROUNDING_MM, estimate_text, millimetre_text, two_digit_text
from postproc.report.judged import answer_facts, as_sentence, split_headline
from postproc.report.kit import (
    Axis,
    Cell,
    Curve,
    Facts,
    Fold,
    Kind,
    Map,
    Note,
    Notes,
    Part,
    Plot,
    Row,
    Section,
    Table,
    Tile,
    Tiles,
    Verdict,
    View,
)
from postproc.report.kit.parts import Colour
from postproc.report.summary import OnSurface
from postproc.report.text import factor_text, number_text, percent_text
from postproc.report.verdict import CUT_MM, LEFT_MM, NARROW_DEG
from postproc.robot import JOINTS, WITH_LINKS

if TYPE_CHECKING:
    from postproc.machining import ProcessForces
    from postproc.machining.sweep import Cuts
    from postproc.report.surface import Surface


def verdict_section(data: Deviation) -> Section:
    """Return the section of the verdict: headline, three answers, reasons, what holds, and the assumptions."""
    verdict = data.content.verdict
    parts: list[Part] = [Verdict(verdict.state, *split_headline(verdict)), answer_facts(verdict)]
    if verdict.state != "ok":
        kind: Kind = "error" if verdict.state == "failed" else ""
        parts.append(Notes(tuple(Note(as_sentence(text), kind) for text in verdict.reasons), "Why", bulleted=True))
    passed_checks = Notes(tuple(Note(as_sentence(text)) for text in verdict.holds), "What holds", bulleted=True)
    assumption_notes = tuple(Note(as_sentence(text)) for text in verdict.assumes)
    assumptions = Notes(assumption_notes, "Under these assumptions", bulleted=True)
    if verdict.holds:
        parts.append(Fold("What holds, and under which assumptions", (passed_checks, assumptions)))
    else:
        parts.append(Fold("Under which assumptions", (assumptions,)))
    return Section("verdict", "Verdict", tuple(parts))


_MEASURES = ("Maximum", "RMS", "Mean", "95th percentile")
"""Labels of the fields of `summary.Distances`, in order."""


def numbers_section(data: Deviation) -> Section | None:
    """Return the section with deviations before and after, the expected error, and the improvement [mm].

    None without targets; the section has only a sentence if there is nothing to correct.
    """
    content = data.content
    if not content.targets:
        return None
    if data.uncorrected_reason is not None:
        return Section("numbers", "Deviation of the tool tip", (Notes((Note(data.uncorrected_reason, "good"),)),))
    uncorrected, prediction, bound = content.before, content.after, content.u95
    u95 = None if bound is None else bound.max_mm
    rms = estimate_text(uncorrected.rms_mm, u95)
    tiles = [Tile("As programmed, largest", estimate_text(uncorrected.max_mm, u95), "mm", f"RMS {rms} mm")]
    if data.is_compared:
        note = f"RMS {estimate_text(prediction.rms_mm, u95)} mm; a statement about the model, not about the part"
        tiles.append(Tile("What the model leaves, largest", estimate_text(prediction.max_mm, u95), "mm", note))
    if bound is None:
        note = "the robot model states no uncertainty: identify the robot from measurements"
        tiles.append(Tile("Expected error on the part", "unknown", "", note, "warning"))
    else:
        note = (
            f"95 %; at targets {two_digit_text(bound.max_mm)} mm, RMS {two_digit_text(bound.rms_mm)} mm; {bound.basis}"
        )
        expected_mm = bound.max_mm if content.part.expected_mm is None else content.part.expected_mm
        tiles.append(Tile("Expected error on the part, up to", two_digit_text(expected_mm), "mm", note))
    parts: list[Part] = [Tiles(tuple(tiles)), _deviation_table(data)]
    share = content.compensated_percent
    if content.mode == "convert" and share is not None:
        parts.append(Notes((Note(f"Compensated {percent_text(share)} of the predicted deviation (RMS)."),)))
    return Section("numbers", "Deviation of the tool tip, mm", tuple(parts))


def _deviation_table(data: Deviation) -> Table:
    """Return the table of predicted deviations [mm] before and after compensation.

    It has one column if no program was written, or if only rounding remains after compensation.
    """
    content = data.content
    u95 = None if content.u95 is None else content.u95.max_mm
    measures = zip(_MEASURES, astuple(content.before), strict=True)
    rows = tuple(Row((label, estimate_text(value, u95))) for label, value in measures)
    if not data.is_compared:
        return Table(("Criterion", "Predicted, mm"), rows, "Predicted deviation")
    if content.after.max_mm < ROUNDING_MM:
        return Table(
            ("Criterion", "Before compensation, mm"),
            rows,
            "Deviation before compensation",
            note=f"{_ONLY_ROUNDING_NOTE} {_TABLE_NOTE}",
        )
    table_rows = tuple(
        Row((label, estimate_text(before_mm, u95), estimate_text(after_mm, u95), factor_text(before_mm, after_mm)))
        for label, before_mm, after_mm in zip(_MEASURES, astuple(content.before), astuple(content.after), strict=True)
    )
    head = ("Criterion", "Before compensation, mm", "After compensation, mm", "Improvement factor")
    note = f"{_TABLE_NOTE} “To rounding”: what remains is the rounding of the text."
    return Table(head, table_rows, "Deviation before and after compensation", note=note)


_ONLY_ROUNDING_NOTE = (
    "After compensation only the rounding of the written numbers remains: below 0.0001 mm at each target."
)
_TABLE_NOTE = "Along the cutting path, at its targets, as the model predicts it."


_VIEW_LABEL = (
    "The nominal path in space, coloured by a value. Drag or use the arrow keys to turn it, the wheel or + and − to "
    "come nearer; a click or N and P choose a place, W the worst one. The table of the worst places says the same in "
    "numbers."
)


def view3d_section(data: Deviation) -> Section | None:
    """Return the section with the 3D view of path and deviation; None if there is nothing to correct."""
    if not len(data.result) or data.uncorrected_reason is not None:
        return None
    hint = (
        "Drag or arrow keys turn, wheel or + − zoom, a click chooses a place; N, P: next, previous place, W: the worst."
    )
    note = "Grey: rapid moves, as far as they are near the part. The overlay is enlarged; the path itself is not."
    parts: list[Part] = [View("view3d", _VIEW_LABEL, note, hint)]
    if data.source:
        parts.append(View("source", _SOURCE_LABEL, hint="A click on a line shows its place; the arrow keys step."))
    return Section("view3d", "The path in space", tuple(parts))


_SOURCE_LABEL = "The text of the program; lines with targets lead to their place. Arrow up and down step along them."


def surface_section(data: Deviation) -> Section | None:
    """Return the section of the surface: largest deviations along its normal [mm], and gouges beyond the tolerance.

    None without a surface; a note alone if no tool reaches the part.
    """
    surface, measures = data.surface, data.content.surface
    if surface is None or measures is None:
        return None
    if not surface.is_reached.any():
        text = "No tool reaches the part: check that its mesh is in mm and in its frame, and the shapes of the tools."
        return Section("surface", "Surface of the part", (Notes((Note(text, "warning"),)),))
    deviation = surface.after if data.is_compared else surface.before
    words = "with the program as written" if data.is_compared else "as programmed"
    share = measures.reached_percent
    tiles = Tiles(
        (
            _programmed_tile(measures, data),
            *_deflection_tiles(data, surface),
            Tile("Of the surface reached", f"{share:.0f}", "%", f"no tool reaches {100.0 - share:.0f} %"),
        )
    )
    label = "The part, coloured by the deviation along its outward normal; the table below lists the gouges"
    note = "Below 0 the tool gouges, above it leaves material. Grey: no tool reaches it. Before and after are "
    view = View("surface", label, f"{note}deviations from the programmed path.")
    return Section("surface", "Surface of the part", (tiles, view, *_gouge_parts(data, deviation, words)))


_DEFLECTION_NOTE = "from the programmed path"


def _deflection_tiles(data: Deviation, surface: Surface) -> list[Tile]:
    """Return the tiles of the largest gouges and of the most material left before and after, and of the bound.

    Empty if no tool touches a facet. Deviations of the surface below 0 are gouges, above 0 material that is left.
    """
    is_touched = surface.is_touched  # facets next to which a tool passes: others have no deviation
    if not is_touched.any():
        return []
    deviation_before_correction, corrected_deviation = surface.before[is_touched], surface.after[is_touched]
    tiles = [
        _depth_tile("Gouged before, at most", -deviation_before_correction.min(), _DEFLECTION_NOTE),
        _depth_tile("Left before, at most", deviation_before_correction.max(), _DEFLECTION_NOTE),
    ]
    if data.is_compared:
        tiles.append(_depth_tile("Gouged after, at most", -corrected_deviation.min(), "as the model predicts it"))
        tiles.append(_depth_tile("Left after, at most", corrected_deviation.max()))
    if surface.bound is not None:
        bound_mm = surface.bound[is_touched].max() * MM_PER_M
        tiles.append(Tile("Expected error (95 %), up to", two_digit_text(bound_mm), "mm"))
    return tiles


def _programmed_tile(measures: OnSurface, data: Deviation) -> Tile:
    """Return the tile on the programmed path and the mesh of the part: it cuts in, leaves material, or neither.

    Depths up to the tolerance of the part do not count; without it, up to that of the path; else up to `CUT_MM`.
    """
    # largest depth of the path in the part, and median height of the material that it leaves (None: unknown)
    label, cut_mm, left_mm = "Programmed path cuts into the part", measures.cut_into_mm, measures.left_mm
    limit_mm = data.content.part.tolerance_mm or data.content.tolerance_mm or CUT_MM
    if cut_mm > limit_mm:
        note = f"line {measures.source_line}: is the mesh in place, and the finished part?"
        return Tile(label, two_digit_text(cut_mm), "mm", note, "warning")
    if left_mm is not None and left_mm > max(limit_mm, LEFT_MM):
        return Tile(
            "Programmed path leaves", two_digit_text(left_mm), "mm", "on half of what the tools touch", "warning"
        )
    return Tile(label, "nowhere", "", f"by more than {limit_mm:g} mm")


def _depth_tile(label: str, depth: float, note: str = "") -> Tile:
    """Return the tile of a depth below the surface or a height above it [m]; "nothing" unless it is positive."""
    if depth <= 0.0:
        return Tile(label, "nothing", "", note)
    return Tile(label, millimetre_text(float(depth) * MM_PER_M), "mm", note)


def _gouge_parts(data: Deviation, deviation: Array, words: str) -> list[Part]:
    """Return the table of the lines that gouge by more than the tolerance, or a note that no line does.

    Empty without a surface or a tolerance of the path.

    :param deviation: (F,) deviation of each facet along its normal [m], negative: gouged.
    :param words: words for the note on the program that makes these deviations.
    """
    surface, tolerance = data.surface, data.tolerance
    if surface is None or tolerance is None:
        return []
    if not len(data.gouges):
        text = f"The deflection makes no gouge deeper than {tolerance * MM_PER_M:g} mm {words}."
        return [Notes((Note(text, ""),))]
    centre = surface.corners.mean(axis=1) * MM_PER_M
    rows = []
    for facet in data.gouges.tolist():
        row = int(surface.row[facet])
        cells = [str(data.result.source_line[row]), f"{-deviation[facet] * MM_PER_M:.4f}"]
        cells += [f"{value:.2f}" for value in centre[facet]]
        rows.append(Row(tuple(cells), data.places.place_of_row(row), int(data.result.source_line[row])))
    head = ("Source line", "Depth, mm", "X, mm", "Y, mm", "Z, mm")
    note = f"Deeper than {tolerance * MM_PER_M:g} mm {words}, by deflection; the deepest place of each line."
    return [Table(head, tuple(rows), "Gouges beyond the tolerance", sortable=True, note=note)]


_ALONG_LABEL = (
    "Plots over the length of the path or over time: deviation before and after, its parts along axes and feed, force, "
    "correction, margins, speed. Left and right arrow keys move the chosen place; the same numbers are in targets.csv."
)


def program_section(data: Deviation) -> Section | None:
    """Return the section with the plots over the length of the path; None if there is nothing to correct."""
    if not len(data.result) or data.uncorrected_reason is not None:
        return None
    note = (
        "Gaps are rapid moves; dotted: a joint changes the direction of its torque. Drag to look closer, double click "
        "to see all again; left and right arrow keys step. Along, across, normal: along the feed, square to feed and "
        "spindle, along the spindle. Time is without accelerations."
    )
    return Section("along", "Along the path", (View("along", _ALONG_LABEL, note),))


_CURVE_POINTS = 600
"""Points of a thinned curve: the largest and the smallest value of each group of points."""
_MOST_CURVE_POINTS = 10 * _CURVE_POINTS
"""Largest number of points of a curve together with the ends of its runs (assumed)."""
_PLACE_TOLERANCE = 1e-9
"""Share of a motion: a station that is less than this behind a target is at the target, but for rounding."""
_CM3_PER_MIN_OF_M3_PER_S = 1e6 * 60.0
_CM3_PER_M3 = 1e6


def cut_section(data: Deviation) -> Section | None:
    """Return the section of the cut: plots of the engagement over the path, and a view of the remaining stock.

    None without forces from a process.
    """
    process = data.process
    if process is None or not len(data.result) or not len(process.cuts.t):
        return None
    label = "The remaining stock, coloured by depth below its top; turned by mouse, touch and arrow keys"
    note = f"The remaining stock in $BASE, coloured by depth below its top. The file is {data.stem}stock.glb."
    tiles, plots = _cut_tiles(process), _cut_plots(data, process.cuts)
    return Section("cut", "The cut", (tiles, *plots, View("stock", label, note)))


def _cut_plots(data: Deviation, cuts: Cuts) -> list[Plot]:
    """Return the plots of the engagement over the length of the path: depth and width, angles, removal rate, power.

    :param cuts: engagement of the tool in the stock at stations: places on motions at which it was computed.
    """
    stations = _stations_in_contact(cuts)
    # t is in [0, 1]: motion + t increases along the program, for targets and for stations
    target_place, station_place = data.result.motion + data.result.t, stations.motion + stations.t
    # of each station the target that follows it, or is at it; then the place of the page at or after that target
    row = np.searchsorted(target_place, station_place - _PLACE_TOLERANCE)
    place = np.minimum(np.searchsorted(data.places.row, row), len(data.places.row) - 1)
    length_mm = np.interp(station_place, target_place, data.places.path_length) * MM_PER_M

    def curve(values: Array, name: str, colour: Colour) -> Curve:
        """Return the values of the cuts at the stations as a curve."""
        return _curve_with_gaps(length_mm, values[stations.row], stations.run, place, name, colour)

    def plot(label: str, unit: str, *curves: Curve) -> Plot:
        """Return the plot of one or two curves in a unit."""
        return Plot(
            label=f"{label}, {unit}, along the path. Left and right arrow keys step.",
            traces=[*curves],
            x=Axis(title="length of the path, mm"),
            y=Axis(title=f"{label.lower()}, {unit}"),
            height=220,
        )

    depth = curve(cuts.depth * MM_PER_M, "depth", "before")
    width = curve(cuts.width * MM_PER_M, "width", "after")
    entry = curve(cuts.enter * DEG_PER_RAD, "entry", "before")
    leave = curve(cuts.leave * DEG_PER_RAD, "exit", "after")
    return [
        plot("Depth and width of cut", "mm", depth, width),
        plot("Angles of engagement", "°", entry, leave),
        plot("Removal rate", "cm³/min", curve(cuts.rate * _CM3_PER_MIN_OF_M3_PER_S, "removal rate", "before")),
        plot("Power", "W", curve(cuts.power, "power", "before")),
    ]


def _curve_with_gaps(x: Array, y: Array, run: Ints, place: Ints, name: str, colour: Colour) -> Curve:
    """Return a curve through points x, y (n,), thinned, with gaps where nothing is cut.

    :param run: (n,) number of the run of each point: a run is without a gap.
    :param place: (n,) place of the page to which each point leads.
    """
    shown_rows = _drawn_rows(y, run)
    # a NaN before the first point of each further run
    gaps = np.flatnonzero(np.diff(run[shown_rows])) + 1
    x_values, y_values = (np.insert(values[shown_rows].astype(float), gaps, np.nan).tolist() for values in (x, y))
    places = np.insert(place[shown_rows], gaps, place[shown_rows][gaps]).tolist()
    return Curve(x_values, y_values, name, colour, places=places)


def _cut_tiles(process: ProcessForces) -> Tiles:
    """Return the tiles of the cut: its largest values, and the removed volume."""
    cuts = process.cuts
    return Tiles(
        (
            Tile("Depth of cut, up to", f"{np.nanmax(cuts.depth) * MM_PER_M:.2f}", "mm"),
            Tile("Width of cut, up to", f"{np.nanmax(cuts.width) * MM_PER_M:.2f}", "mm"),
            Tile("Removed, up to", f"{np.nanmax(cuts.rate) * _CM3_PER_MIN_OF_M3_PER_S:.1f}", "cm³/min"),
            Tile(
                "Removed in all",
                f"{process.removed_volume * _CM3_PER_M3:.1f}",
                "cm³",
                f"left {process.stock.volume() * _CM3_PER_M3:.1f} cm³",
            ),
        )
    )


class _ContactStations(NamedTuple):
    """The n stations in contact with the stock, along the program.

    :param run: (n,) number of the run of each station: consecutive stations in contact without a gap.
    :param row: (n,) row of the cuts.
    :param motion: (n,) row of `Motions`.
    :param t: (n,) place on the motion, in [0, 1].
    """

    run: Ints
    row: Ints
    motion: Ints
    t: Array


def _stations_in_contact(cuts: Cuts) -> _ContactStations:
    """Return the stations in contact with the stock: places on motions at which the engagement was computed.

    A motion with a single station has the same engagement all along: the station is returned at both of its ends.
    """
    order = np.lexsort((cuts.t, cuts.motion))
    _, motion_index, station_count = np.unique(cuts.motion[order], return_inverse=True, return_counts=True)
    # a motion with one station has it twice here: at t = 0 and at t = 1
    copies = np.where(station_count[motion_index] == 1, 2, 1)
    rows, is_copied = np.repeat(order, copies), np.repeat(copies == 2, copies)
    is_second = np.append(False, rows[1:] == rows[:-1])
    motion = cuts.motion[rows]
    t = np.where(is_copied, np.where(is_second, 1.0, 0.0), cuts.t[rows])
    is_contact = cuts.rate[rows] > 0.0
    # a gap: a motion without a station, or a station without contact, between a station and the one before it
    starts_run = np.append(0, (np.diff(motion) > 1) | ~is_contact[1:] | ~is_contact[:-1])
    run = np.cumsum(starts_run)
    return _ContactStations(run[is_contact], rows[is_contact], motion[is_contact], t[is_contact])


def _drawn_rows(values: Array, run: Ints) -> Ints:
    """Return the rows of values (n,) that are drawn: of each group the smallest and the largest, and ends of runs.

    All rows if there are at most `_CURVE_POINTS` values.

    :param run: (n,) number of the run of each value, ascending.
    """
    group_size = -(-2 * len(values) // _CURVE_POINTS)  # rounded up
    if group_size <= 2:
        return np.arange(len(values))
    finite_values = np.nan_to_num(values)
    # filled up with the last value to whole groups, which leaves their extremes as they are
    filling = np.full(-len(finite_values) % group_size, finite_values[-1])
    groups = np.append(finite_values, filling).reshape(-1, group_size)
    group_begins = np.arange(len(groups)) * group_size
    run_begins = np.flatnonzero(np.diff(run, prepend=-1, append=-1))  # and, last, the number of values
    extremes = [group_begins + groups.argmin(axis=1), group_begins + groups.argmax(axis=1)]
    rows = np.concatenate([*extremes, run_begins, run_begins - 1])
    rows = distinct(np.clip(rows, 0, len(values) - 1))
    # many short runs: then only some of the rows
    return rows if len(rows) <= _MOST_CURVE_POINTS else rows[:: -(-len(rows) // _MOST_CURVE_POINTS)]


def histogram_section(data: Deviation) -> Section | None:
    """Return the section of the histogram of the deviation; None if there is nothing to correct.

    The script of the page draws it from `Facts.histograms`.
    """
    if not len(data.result) or data.uncorrected_reason is not None:
        return None
    label = (
        "Histogram of the deviation along the cutting path, before and after; a click on a bar chooses its worst place."
    )
    note = "All of the cutting path; each plot has its own scale. A click on a bar chooses the worst place in it."
    return Section("histogram", "Distribution of the deviation", (View("histogram", label, note),))


def operations_section(data: Deviation) -> Section | None:
    """Return the section with the table of the operations, largest values of each; None without operations."""
    if not data.operations:
        return None
    # deviations after correction are shown only if they are more than rounding of the text
    rows, has_after = [], data.is_compared and data.content.after.max_mm >= ROUNDING_MM
    for number, operation in enumerate(data.operations, 1):
        u95 = None if operation.bound is None else operation.bound.largest * MM_PER_M
        cells = [
            operation.name or f"operation {number}",
            tool_text(data.result.program, operation.tool) or "-",
            str(operation.line),
            str(operation.cutting),
            f"{operation.force:.0f}",
            estimate_text(operation.before.largest * MM_PER_M, u95),
        ]
        if has_after:
            cells.append(estimate_text(operation.after.largest * MM_PER_M, u95))
        if u95 is not None:
            cells.append(two_digit_text(u95))
        rows.append(Row(tuple(cells), data.places.place_of_row(operation.first), operation.line))
    head = [
        "Operation",
        "Tool",
        "First line",
        "Cutting targets",
        "Force, N",
        "Before, mm" if data.is_compared else "Predicted, mm",
    ]
    head += ["After, mm"] if has_after else []
    head += ["On the part (95 %), mm"] if data.result.bound is not None else []
    table = Table(
        tuple(head),
        tuple(rows),
        "Operations and tools, largest values",
        texts=(1,),
        sortable=True,
        note="Largest values." + (f" {_ONLY_ROUNDING_NOTE}" if data.is_compared and not has_after else ""),
    )
    return Section("operations", "Operations and tools", (table,))


def feeds_section(data: Deviation) -> Section | None:
    """Return the section on feeds that were lowered to hold the tolerance; None if feeds are as programmed."""
    feed = data.content.feed
    if feed is None:
        return None
    rows = [
        Row(
            (
                operation.name,
                tool_text(data.result.program, operation.tool) or "-",
                duration_text(operation.time_before_s),
                duration_text(operation.time_after_s),
                str(operation.lowered_moves),
                number_text(operation.lowest_feed_mm_per_min, 0),
            )
        )
        for operation in feed.operations
    ]
    head = ("Operation", "Tool", "Time before", "Time after", "Moves slowed", "Lowest feed, mm/min")
    note = "Time of cutting moves: lengths divided by feeds, without the accelerations of the controller."
    table = Table(head, tuple(rows), "Cutting time by operation at programmed and written feeds", texts=(1,), note=note)
    notes = Notes(tuple(Note(as_sentence(text)) for text in feed_sentences(feed, 20)))
    return Section("feeds", "Feeds that hold the tolerance", (notes, table))


def worst_places_section(data: Deviation) -> Section | None:
    """Return the section with the table of the worst place of each of the worst lines, before and after [mm].

    None if there is nothing to correct.
    """
    result = data.result
    if not len(result) or data.uncorrected_reason is not None:
        return None
    # deviations after correction are shown only if they are more than rounding of the text
    has_after = data.is_compared and data.content.after.max_mm >= ROUNDING_MM
    measures = [result.before] + ([result.after] if has_after else [])
    rows = data.worst_rows
    force, correction_mm = result.force[rows], norm(correction(result, rows)) * MM_PER_M
    head = ["Source line", "Output line", "On the move", "Before, mm" if data.is_compared else "Predicted, mm"]
    head += ["After, mm"] if has_after else []
    head += [] if result.bound is None else ["On the part (95 %), mm"]
    head += ["Force, N"] + (["Correction, mm"] if data.is_compared else [])
    table_rows = []
    for index, row in enumerate(rows.tolist()):
        cells = [str(result.source_line[row]), str(result.output_line[row]), f"{result.t[row]:.3f}"]
        u95 = None if result.bound is None else float(result.bound[row]) * MM_PER_M
        cells += [estimate_text(float(measure[row]) * MM_PER_M, u95) for measure in measures]
        cells += [] if u95 is None else [two_digit_text(u95)]
        cells += [f"{force[index]:.0f}"] + (
            [estimate_text(float(correction_mm[index]), u95)] if data.is_compared else []
        )
        table_rows.append(Row(tuple(cells), data.places.place_of_row(row), int(result.source_line[row])))
    table = Table(tuple(head), tuple(table_rows), "The worst places, one for each line of the program", sortable=True)
    return Section("worst", "Worst places", (table,))


def reversals_section(data: Deviation) -> Section | None:
    """Return the section with the table of the largest reversals; a note alone if the model states no lost motion.

    None if no torque changes its direction on a cut.
    """
    entries = data.content.reversals
    if not entries:
        return None
    if not any(entry.lost_motion_mm for entry in entries):
        joints = ", ".join(sorted({entry.joint for entry in entries}))
        text = (
            f"The torque of {joints} changes its direction while the tool cuts. The tool steps there by the lost "
            "motion of these gears. The robot model states none, and no plot marks the places."
        )
        return Section("reversals", "Reversals", (Notes((Note(text),)),))
    rows = tuple(
        Row((entry.joint, str(entry.source_line), two_digit_text(entry.lost_motion_mm)), place, entry.source_line)
        for entry, (place, _) in zip(entries, data.reversals(), strict=True)
    )
    note = (
        "The step is corrected as the model has it; where exactly the gear turns over is not known and counts in u95."
    )
    table = Table(
        ("Joint", "Source line", "Step of the tool, mm"), rows, "Largest steps by lost motion", sortable=True, note=note
    )
    return Section("reversals", "Reversals", (table,))


_TOLERANCE_CELLS: dict[bool | None, tuple[str, Kind]] = {
    None: ("held but for approximation", "warning"),
    True: ("held", "good"),
    False: ("exceeded", "error"),
}
"""Text and style of a tolerance by `Summary.tolerance_held`; None: only the approximation of corners exceeds it."""


def limits_section(data: Deviation) -> Section | None:
    """Return the section with tolerance, correction, margins to limits of the robot, and the smallest clearance.

    None without targets.
    """
    content = data.content
    if not content.targets:
        return None
    path_max_mm = content.between_max_mm
    rows: list[tuple[str, Cell | str]] = [
        ("Deviation between targets too, at most", f"{'-' if path_max_mm is None else millimetre_text(path_max_mm)} mm")
    ]
    if content.tolerance_mm is not None:
        text, kind = _TOLERANCE_CELLS[content.tolerance_held]
        rows.append(("Tolerance", Cell(f"{content.tolerance_mm:g} mm: {text}", kind)))
    blending = content.blending
    if blending.source_line is not None:
        corner_text = f"{number_text(blending.max_mm, 3)} mm, line {blending.source_line}"
        rows.append((f"{blending.by[:1].upper()}{blending.by[1:]} rounds corners by up to", corner_text))
    if content.mode == "convert":
        rows.append(("Largest correction", f"{number_text(content.max_correction_mm, 3)} mm"))
    if content.tool_deflection is not None:
        deflection_text = f"{number_text(content.tool_deflection.max_mm, 3)} mm"
        rows.append(("Deflection of holder, spindle and tool, up to", deflection_text))
    rows.append(("Largest force", f"{content.max_force_N:.0f} N"))
    limits = content.limits
    rows.append(("Smallest joint margin", f"{number_text(limits.min_joint_margin_deg, 1)}°"))
    rows.append(("Smallest singular value of the Jacobian", f"{number_text(limits.min_singular_value, 3)} m/rad"))
    clearance = content.collision
    if clearance is not None and clearance.min_clearance_mm is not None:
        bodies = " and ".join(clearance.bodies)
        text = f"{number_text(clearance.min_clearance_mm, 1)} mm, {bodies}, line {clearance.source_line}"
        rows.append(("Smallest clearance", text))
    return Section("limits", "Tolerance and limits", (Facts(tuple(rows)),), "half")


def joints_section(data: Deviation) -> Section | None:
    """Return the section with the range of each joint, its limits and its margin [deg]; None without targets."""
    result = data.result
    if not len(result):
        return None
    rows = []
    for index, name in enumerate(JOINTS):
        angle, margin = result.q[:, index] * DEG_PER_RAD, float(result.joint_margin[index]) * DEG_PER_RAD
        text = number_text(margin if np.isfinite(margin) else None, 1)
        # z in a format: no "-0"
        limits = (f"{limit * DEG_PER_RAD:z.0f}" for limit in (result.robot.lower[index], result.robot.upper[index]))
        margin_cell = Cell(text, "warning" if margin < NARROW_DEG else "")
        rows.append(Row((name, f"{angle.min():z.1f}", f"{angle.max():z.1f}", " … ".join(limits), margin_cell)))
    head = ("Joint", "From, °", "To, °", "Limits, °", "Margin, °")
    return Section("joints", "Joints", (Table(head, tuple(rows), "Range of the joints and their margins"),), "half")


def model_section(data: Deviation) -> Section:
    """Return the section with the values of the model and their sources; assumed values are marked."""
    robot = data.result.robot
    rows = tuple(
        Row((entry.name, entry.value, Cell("assumed", "warning") if entry.assumed else "stated", entry.source))
        for entry in robot.sources
    )
    table = Table(("Value", "", "", "Source"), rows, "Values of the robot model and their sources", texts=(1, 2, 3))
    parts: list[Part] = [Notes((Note(robot.title or robot.name),)), table, Notes((Note(f"{WITH_LINKS}."),))]
    if robot.covariance is None:
        text = (
            "The model states no covariance of its parameters: identify the robot to learn what to expect on the part."
        )
        parts.append(Notes((Note(text, "warning"),)))
    else:
        names = ", ".join(parameter.symbol for parameter in robot.covariance.parameters)
        parts.append(
            Notes((Note(f"The expected error on the part counts the uncertainty of {names}: {robot.basis}."),))
        )
    return Section("model", "Robot model", tuple(parts))


_MOST_LINE_RANGES = 2000
"""Largest number of line ranges of an issue that a page lists."""
_LEVEL_KINDS: dict[str, Kind] = {"error": "error", "warning": "warning", "info": "soft"}


def issues_section(data: Deviation) -> Section:
    """Return the section with the table of the issues; a note without issues."""
    issues = data.result.issues
    if not issues:
        return Section("issues", "Issues", (Notes((Note("None besides those of the verdict.", "soft"),)),))
    rows = tuple(
        Row(
            (
                Cell(issue.level, _LEVEL_KINDS[issue.level]),
                issue.message,
                Cell(_line_ranges(issue), sort=issue.source_line),
                str(issue.count),
            ),
            None if (row := data.first_row_of_issue(issue)) is None else data.places.place_of_row(row),
            issue.source_line,
        )
        for issue in issues
    )
    return Section("issues", "Issues", (Table(("Level", "What", "Lines", "Places"), rows, "Issues", texts=(1, 2)),))


def _line_ranges(issue: Issue) -> str:
    """Return the lines of an issue as text, consecutive lines as a range; at most `_MOST_LINE_RANGES` ranges."""
    if not issue.lines:
        return "-" if issue.source_line is None else str(issue.source_line)
    # in a run of consecutive lines, line − index is the same
    numbered_lines = enumerate(issue.lines)
    runs = [[line for _, line in run] for _, run in groupby(numbered_lines, lambda entry: entry[1] - entry[0])]
    texts = [str(run[0]) if len(run) == 1 else f"{run[0]}–{run[-1]}" for run in runs]
    return first_of(texts, _MOST_LINE_RANGES)


def place_section(data: Deviation) -> Section | None:
    """Return the section with the details of the chosen place, beside all other sections; None without targets."""
    if not len(data.result):
        return None
    label = "Details of the chosen place: lines, pose, joints, force, deviation, correction"
    return Section("place", "Place", (View("place", label),), "side")


_MAP_COLUMNS = 400
"""Largest number of columns of the map along the path."""
_LEAST_COLOURED_ERROR = 1e-9
"""Expected errors below this [m] are nothing to colour by: the joint margin is shown."""


def turn_section(data: Deviation) -> Section | None:
    """Return the section with the map of the turn about the tool axis and the chosen turn.

    None if postproc did not choose the turn.
    """
    tool_turn = data.result.turn
    if tool_turn is None:
        return None
    turns = placement.bin_turns(tool_turn)  # (K,) chosen turn at each row of the map [rad]
    # a block is a stretch of the path that is turned alike; a row of the map is at a share of its block, 1 at the end
    blocks = tool_turn.map.blocks
    # length of the path up to each row of the map [m]
    metres = np.cumsum(blocks.length)[blocks.block] - blocks.length[blocks.block] * (1.0 - blocks.share)
    degrees = (tool_turn.map.offset + tool_turn.constant) * DEG_PER_RAD
    line = _wrap_to_map((turns + tool_turn.constant) * DEG_PER_RAD, degrees)
    curve = Curve(metres.tolist(), line.tolist(), "chosen turn", "warning")
    plot = Plot(
        label="Map of the path by the turn of the tool about its axis, with the chosen line.",
        traces=[_turn_map(tool_turn, metres, degrees), curve],
        x=Axis(title="along the path, m"),
        # with a margin of 2.5° beyond the first and the last angle of the map
        y=Axis(title="turn about the tool axis, °", range=(float(degrees[0]) - 2.5, float(degrees[-1]) + 2.5)),
        height=420,
        note="Each column is the worst of its piece of the path. Rapid moves count for reach only, not for errors.",
    )
    notes = Notes(tuple(Note(text) for text in _turn_sentences(tool_turn, turns)))
    return Section("turn", "Turn about the tool axis", (plot, notes))


def _turn_map(tool_turn: Turn, metres: Array, degrees: Array) -> Map:
    """Return the picture of the map of the turn, transposed: a column for each piece of the path, a row for each angle.

    It has at most `_MAP_COLUMNS` columns.

    :param metres: (K,) length of the path up to each row of the map of the turn [m].
    :param degrees: (J,) angles of the tool about its axis [deg].
    """
    reasons = tool_turn.map.reasons(tool_turn.keep)
    # rows without travel would be columns without width
    travel_rows = np.flatnonzero(np.diff(metres, prepend=0.0) > 0.0)
    column_count = min(_MAP_COLUMNS, len(travel_rows))
    map_rows = travel_rows[distinct(np.linspace(0, len(travel_rows) - 1, column_count).astype(np.int64))]
    values, title = _map_values(tool_turn)
    cells = np.where(reasons == FREE, values, np.nan)[map_rows].T
    return Map(
        metres[map_rows].tolist(),
        [float(angle) for angle in degrees],
        [[None if np.isnan(cell) else float(cell) for cell in row] for row in cells],
        reasons[map_rows].T.tolist(),
        REASONS,
        title,
    )


def _turn_sentences(tool_turn: Turn, turns: Array) -> list[str]:
    """Return sentences on the chosen turn: its range, the expected error with it, and that clearance was not compared.

    :param turns: (K,) chosen turn [rad] at each row of the map.
    """
    low, high = tool_turn.range_deg()
    mode_text = "one turn for each operation" if tool_turn.mode == "best" else "a turn that changes along the path"
    low_text, high_text = f"{low:.0f}°", f"{high:.0f}°"
    range_text = f"{low_text} everywhere" if low_text == high_text else f"{mode_text}, from {low_text} to {high_text}"
    sentences = [f"Chosen: {range_text}.", *_gain_sentences(tool_turn, turns)]
    return sentences if tool_turn.map.hit is not None else [*sentences, NO_CLEARANCE]


def _map_values(tool_turn: Turn) -> tuple[Array, str]:
    """Return the values (K, J) that colour the map, and their title with the unit.

    Expected errors, or deflections if the model states no uncertainty, NaN for rapid moves. Joint margins if the errors
    are zero.
    """
    error = tool_turn.map.error * MM_PER_M
    if np.nanmax(error, initial=0.0) > _LEAST_COLOURED_ERROR * MM_PER_M:
        cuts = tool_turn.map.blocks.is_at_feed[tool_turn.map.blocks.block]
        error = np.where(cuts[:, None], error, np.nan)
        return error, "expected error (95 %), mm" if np.isfinite(tool_turn.map.u95).any() else "deflection, mm"
    margin = tool_turn.map.margin.joint * DEG_PER_RAD
    return np.where(np.isfinite(margin), margin, np.nan), "joint margin, °"


def _wrap_to_map(angle: Array, degrees: Array) -> Array:
    """Return angles (n,) [deg] within the range of the map; NaN after a jump from one edge of the map to the other.

    :param degrees: angles of the rows of the map [deg], evenly spaced.
    """
    lower_edge = degrees[0] - 0.5 * (degrees[1] - degrees[0])
    line = (angle - lower_edge) % 360.0 + lower_edge
    has_jump = np.abs(np.diff(line)) > 180.0
    line[1:][has_jump] = np.nan
    return np.asarray(line)


def _gain_sentences(tool_turn: Turn, turns: Array) -> list[str]:
    """Return a sentence that compares the expected errors with the chosen turn and with the turn that the cell states.

    Empty if an error on a cut is unknown, or all are zero.

    :param turns: (K,) chosen turn [rad] at each row of the map.
    """
    cut_length = tool_turn.map.blocks.cut_length
    # expected error (K, J) [m] at each row of the map with each of J turns (J,) [rad]
    error, offset = tool_turn.map.error, tool_turn.map.offset
    step = offset[1] - offset[0]
    columns = np.rint((turns - offset[0]) / step).astype(np.int64) % len(offset)  # offsets go round once
    cell_column = int(np.argmin(np.abs(offset)))  # offsets are from the turn that the cell states
    line_error = error[np.arange(len(columns)), columns]
    cut_error = line_error[cut_length > 0.0]
    if not len(cut_error) or not np.isfinite(cut_error).all() or not cut_error.any():
        return []
    rms = two_digit_text(statistics(line_error, cut_length).rms * MM_PER_M)
    if not (tool_turn.map.reasons(tool_turn.keep)[:, cell_column] == FREE).all():
        cell_text = f"the turn that the cell states ({tool_turn.constant * DEG_PER_RAD:g}°) cannot be driven throughout"
    else:
        cell_rms = two_digit_text(statistics(error[:, cell_column], cut_length).rms * MM_PER_M)
        cell_text = f"{cell_rms} mm with {tool_turn.constant * DEG_PER_RAD:g}°"
    return [f"Expected error along this line {rms} mm RMS; {cell_text}."]


def record_section(data: Deviation) -> Section | None:
    """Return the section with date, version, customer, and the SHA-256 of the inputs; None without a record."""
    if data.record is None:
        return None
    return Section(
        "record", "Record", (Facts(tuple((name, Cell(value)) for name, value in data.record.rows())),), "half"
    )
