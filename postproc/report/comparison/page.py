"""`part.compare.report.html`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import astuple

from postproc.comparison import Comparison
from postproc.decimals import without_negative_zero
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm, xyzabc_from_pose
from postproc.operations import tool_text
from postproc.program import Ints, distinct
from postproc.report.comparison.summary import (
    ComparisonSummary,
    Names,
    count_text,
    names_of,
    passed_sentence,
    place_text,
    spline_sentence,
)
from postproc.report.formatting import ROUNDING_MM, millimetre_text
from postproc.report.judged import answer_facts, split_headline
from postproc.report.kit import (
    Axis,
    Cell,
    Columns,
    Curve,
    Histogram,
    Kind,
    Lines,
    Mark,
    Note,
    Notes,
    Page,
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

_MOST_GROUPS = 4_000
"""Largest number of groups of pairs, each of which has a point of a curve: more than a screen has pixels."""
_MOST_POINTS = 24_000
"""Largest number of points that are drawn in space (assumed): browsers still turn them quickly."""
_CHORD_ANGLE = np.radians(10.0)
"""Angle of the chords by which an arc is drawn [rad] (assumed)."""
_MOST_WORST_PAIRS = 20
"""Largest number of rows of the table of largest offsets."""
_BINS = 40
"""Bars of the histogram."""
_LEVEL_KINDS: dict[str, Kind] = {"error": "error", "warning": "warning", "info": "soft"}
_FILE_AND_LINE = re.compile(r"\S+:\d+\b")
"""File and line at the beginning of a text: not capitalised."""
_MEASURES = ("Maximum", "RMS", "Mean", "95th percentile")
"""Labels of the fields of `Distances`, in order."""


class Facts(msgspec.Struct, frozen=True):
    """Data that the script of the page reads in addition to the columns.

    :param nominal: display name of the nominal program, `corrected` of the corrected one.
    :param nominal_files: file names of the nominal program, `corrected_files` of the corrected one; empty if all pairs
        are in one file of it.
    :param worst: place of the page with the largest offset.
    """

    nominal: str
    corrected: str
    nominal_files: list[str]
    corrected_files: list[str]
    worst: int


def comparison_page(comparison: Comparison, content: ComparisonSummary) -> Iterator[bytes]:
    """Yield the page of a comparison as HTML in UTF-8, one file that loads nothing."""
    names = names_of(comparison)
    pair_rows = _page_rows(comparison, _linked_rows(comparison, content, names[0]))
    sections = [_verdict_section(content), _numbers_section(content)]
    if len(pair_rows):
        sections += [
            _path_section(comparison, pair_rows),
            _program_plots_section(comparison, content, pair_rows, names[0]),
            _histogram_section(comparison, pair_rows),
            _operations_section(comparison, content, pair_rows, names),
            _worst_pairs_section(comparison, pair_rows, names),
        ]
    sections.append(_issues_section(comparison, content, pair_rows, names[0]))
    if len(pair_rows):
        sections.append(_place_section())
    yield from Page(
        kind="Comparison",
        title=f"{content.corrected} against {content.nominal}",
        subtitle=f"{content.robot} · {count_text(content)}",
        sections=tuple(sections),
        footer=(
            Note(
                "Offsets are from the nominal target to where the second program sends the same tool, in the nominal "
                "$BASE, in millimetres. What a program cuts is a prediction of the elastostatic model under the forces "
                "given. Statistics are along the cutting path, at targets that are in both."
            ),
        ),
        facts=_facts(comparison, content, pair_rows, names) if len(pair_rows) else None,
        columns={"places": _pair_columns(comparison, pair_rows)} if len(pair_rows) else {},
        scripts=(("postproc.report.comparison", "place"),) if len(pair_rows) else (),
    ).render()


def _verdict_section(content: ComparisonSummary) -> Section:
    """Return the section with the verdict: headline, three answers and reasons.

    The answers say whether the corrected program may be driven, is better, and holds the tolerance.
    """
    verdict = content.verdict
    file_names = (content.nominal, content.corrected)
    # a reason begins with a capital letter, unless it begins with the name of a file
    reasons = tuple(
        (text if text.startswith(file_names) or _FILE_AND_LINE.match(text) else text[:1].upper() + text[1:]) + "."
        for text in verdict.reasons
    )
    parts: list[Part] = [Verdict(verdict.state, *split_headline(verdict)), answer_facts(verdict)]
    if reasons:
        kind: Kind = "error" if verdict.state == "failed" else ""
        parts.append(Notes(tuple(Note(text, kind) for text in reasons), "Why", bulleted=True))
    return Section("verdict", "Verdict", tuple(parts))


def _numbers_section(content: ComparisonSummary) -> Section:
    """Return the section with offsets and deviations, and notes on left-out targets and on splines if there are any."""
    parts: list[Part] = [_number_tiles(content), _number_table(content)]
    texts = [passed_sentence(content)] if content.passed else []
    texts += [spline_sentence(content)] if content.splines else []
    if texts:
        parts.append(Notes(tuple(Note(f"{text[:1].upper()}{text[1:]}.") for text in texts)))
    return Section("numbers", "Offsets and deviations, mm", tuple(parts))


def _number_tiles(content: ComparisonSummary) -> Tiles:
    """Return the tiles with the largest offset, rotation, distance of the paths, and deviation of each program.

    The distance of the paths and the deviations are left out if they are unknown.
    """
    tiles = [
        Tile("Largest offset", millimetre_text(content.offset.max_mm), "mm"),
        Tile("Largest change of orientation", f"{content.rotation.max_deg:.4f}", "°"),
    ]
    if content.between_targets.nominal_line is not None:
        tiles.append(
            Tile("Paths apart between targets, largest", millimetre_text(content.between_targets.max_mm), "mm")
        )
    deviations = content.cut  # of the loaded tool by each program; None: no forces are known
    if deviations is not None:
        tiles.append(Tile("The nominal program cuts, largest", millimetre_text(deviations.nominal.max_mm), "mm"))
        tiles.append(Tile("The corrected one, largest", millimetre_text(deviations.corrected.max_mm), "mm"))
    return Tiles(tuple(tiles))


def _number_table(content: ComparisonSummary) -> Table:
    """Return the table of offsets, and of the deviations of both programs where forces are known [mm]."""
    head, distances = ["Criterion", "Offset, mm"], [content.offset]
    if content.cut is not None:
        head += ["Nominal cuts, mm", "Corrected cuts, mm"]
        distances += [content.cut.nominal, content.cut.corrected]
    # a row for each measure, a column for each of the distances
    measures = zip(_MEASURES, *map(astuple, distances), strict=True)
    rows = tuple(Row((label, *map(millimetre_text, values))) for label, *values in measures)
    if content.between is not None:
        largest = (millimetre_text(content.between.nominal_max_mm), millimetre_text(content.between.corrected_max_mm))
        rows += (Row(("Maximum between targets, from the path", "-", *largest)),)
    return Table(tuple(head), rows, "Numbers")


def _page_rows(comparison: Comparison, linked_rows: Ints) -> Ints:
    """Return the pairs (s,) to show, ascending; empty without pairs.

    A pair is a row of `Comparison.pair`: a nominal target and its partner in the corrected program. Consecutive pairs
    are grouped. Of each group the cutting pairs with the largest offset, path distance and deviations
    are shown; also the pairs with the largest offsets of all, and linked ones.

    :param linked_rows: (n,) pairs to which tables lead.
    """
    if not len(comparison.pair):
        return np.zeros(0, dtype=np.int64)
    group_size = -(-len(comparison.pair) // _MOST_GROUPS)  # rounded up
    measures = [comparison.distance, np.nan_to_num(comparison.path_distance)]
    if comparison.cuts is not None:
        measures += [norm(comparison.cuts.nominal), norm(comparison.cuts.corrected_deviation)]
    rows = [_worst_rows(comparison), linked_rows]
    for measure in measures:
        size = np.where(comparison.rapid, -1.0, measure)
        # filled up to whole groups with values below all others, which are never chosen
        groups = np.append(size, np.full(-len(size) % group_size, -2.0)).reshape(-1, group_size)
        rows.append(np.arange(len(groups)) * group_size + groups.argmax(axis=1))
    return distinct(np.concatenate(rows))


def _worst_rows(comparison: Comparison) -> Ints:
    """Return the cutting pairs (n,) with the largest offsets, the largest first, at most `_MOST_WORST_PAIRS`."""
    size = np.where(comparison.rapid, -1.0, comparison.distance)  # negative: not cutting
    order = np.argsort(-size, kind="stable")[:_MOST_WORST_PAIRS]
    return np.asarray(order[size[order] >= 0.0])


def _linked_rows(comparison: Comparison, content: ComparisonSummary, nominal: Names) -> Ints:
    """Return the pairs (n,) to which tables of operations and differences lead: thinning must keep them.

    :param nominal: display names of the files of the nominal program.
    """
    places = [(entry.nominal_file, entry.nominal_line) for entry in content.operations]
    lines = [*places, *((entry.source_file, entry.source_line) for entry in content.issues)]
    rows = (_pair_of(comparison, nominal, file, line) for file, line in lines)
    return np.array([row for row in rows if row is not None], dtype=np.int64)


def _pair_of(comparison: Comparison, names: Names, file: str | None, line: int | None) -> int | None:
    """Return the first pair on a line of the nominal program, else the first pair after the line in that file.

    The last pair of all if there is neither. None without a line, or if there are no pairs.

    :param names: display names of the files of the nominal program.
    :param file: display name of the file.
    """
    if line is None or not len(comparison.pair):
        return None
    places = comparison.nominal.places(comparison.pair[:, 0])
    is_in_file = np.array([names.prefix + name == file for name in places.files])[places.file]
    for is_match in (is_in_file & (places.line == line), is_in_file & (places.line >= line)):
        if is_match.any():
            return int(np.argmax(is_match))  # the first True
    return len(comparison.pair) - 1


def _place_of(comparison: Comparison, pair_rows: Ints, names: Names, file: str | None, line: int | None) -> int | None:
    """Return the place of the page of the pair on a line of the nominal program: its index among the pairs shown.

    None as for `_pair_of`.

    :param pair_rows: (s,) pairs shown, as rows of `Comparison.pair`, ascending; they contain the pair.
    :param names: display names of the files of the nominal program.
    :param file: display name of the file.
    """
    pair = _pair_of(comparison, names, file, line)
    return None if pair is None else int(np.searchsorted(pair_rows, pair))


def _facts(comparison: Comparison, content: ComparisonSummary, pair_rows: Ints, names: Sequence[Names]) -> Facts:
    """Return the facts for the script of the page: names, files and the place of the largest offset.

    :param pair_rows: (s,) pairs shown, as rows of `Comparison.pair`, ascending.
    :param names: display names of the files of both programs.
    """
    size = np.where(comparison.rapid, -1.0, comparison.distance)[pair_rows]  # negative: not cutting
    # places of a single pair: they contain the names of all files of the program
    nominal_files, corrected_files = (
        [name.prefix + file for file in program.places(comparison.pair[:1, k]).files] if name.has_several_files else []
        for k, (program, name) in enumerate(zip((comparison.nominal, comparison.corrected), names, strict=True))
    )
    return Facts(content.nominal, content.corrected, nominal_files, corrected_files, int(np.argmax(size)))


def _pair_columns(comparison: Comparison, pair_rows: Ints) -> Columns:
    """Return the columns of pairs for the script of the page: mm, degrees, N, mm/s.

    :param pair_rows: (s,) pairs shown, as rows of `Comparison.pair`, ascending.
    """
    nominal_places, corrected_places = (
        comparison.nominal.places(comparison.pair[pair_rows, 0]),
        comparison.corrected.places(comparison.pair[pair_rows, 1]),
    )
    # "places" of the page are pairs shown; those of a program are files and lines
    columns = {
        "nominal_file": nominal_places.file,
        "nominal_line": nominal_places.line,
        "corrected_file": corrected_places.file,
        "corrected_line": corrected_places.line,
        "rapid": comparison.rapid[pair_rows],
        "offset": comparison.distance[pair_rows] * MM_PER_M,
        "turned": comparison.rotation[pair_rows] * DEG_PER_RAD,
        "between": comparison.path_distance[pair_rows] * MM_PER_M,
        "nominal_speed": comparison.speeds[pair_rows, 0] * MM_PER_M,
        "corrected_speed": comparison.speeds[pair_rows, 1] * MM_PER_M,
        **dict(zip(("oX", "oY", "oZ"), comparison.offset[pair_rows].T * MM_PER_M, strict=True)),
        **dict(zip("XYZABC", xyzabc_from_pose(comparison.target[pair_rows]).T, strict=True)),
    }
    if comparison.cuts is not None:  # else no forces are known
        columns["force"] = norm(comparison.cuts.wrench[pair_rows, :3])
        columns["nominal_cuts"] = norm(comparison.cuts.nominal[pair_rows]) * MM_PER_M
        columns["corrected_cuts"] = norm(comparison.cuts.corrected_deviation[pair_rows]) * MM_PER_M
    return Columns.of(columns)


def _place_section() -> Section:
    """Return the section with the details of the chosen pair, beside all other sections."""
    label = "Details of the chosen pair: lines, pose, offset, speeds, force, what each program cuts"
    return Section("place", "Place", (View("place", label),), "side")


def _path_section(comparison: Comparison, rows: Ints) -> Section:
    """Return the section with both paths in space, offsets exaggerated to about a tenth of the extent of the path.

    :param rows: (s,) pairs shown, as rows of `Comparison.pair`, ascending.
    """
    path = _drawn_path(comparison, rows)
    extent = float(np.ptp(path.point, axis=0).max())
    largest_offset = float(norm(path.offset).max())
    is_offset_shown = largest_offset * MM_PER_M > ROUNDING_MM and extent > 0.0
    factor = _round_scale(0.1 * extent / largest_offset) if is_offset_shown else 1.0
    larger = f", offsets {factor:g} times larger" if factor > 1.0 else ""
    traces = [
        _path_line(path.point, "nominal", "before", path.place),
        _path_line(path.point + factor * path.offset, f"corrected{larger}", "after", path.place),
    ]
    thinning_note = (
        ""
        if len(rows) == len(comparison.pair)
        else f" {len(rows)} of {len(comparison.pair)} pairs; the largest are among them."
    )
    plot = Plot(
        label="Both paths in space; offsets of the corrected one are exaggerated. Arrow keys turn, N and P step.",
        unit="mm",
        traces=[*traces],
        height=480,
        note="Drag or arrow keys turn, wheel or + − zoom, a click chooses a place; N, P: next, previous place."
        + thinning_note,
    )
    return Section("view3d", f"Both paths{larger}", (plot,))


def _round_scale(factor: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20 … that does not exceed a factor; at least 1."""
    power = 10.0 ** np.floor(np.log10(factor))
    return max(1.0, float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= factor)))


class _DrawnPath(NamedTuple):
    """Points of both paths as they are drawn.

    :param point: (n, 3) points of the nominal path [m].
    :param offset: (n, 3) vectors from these points to the corrected path [m].
    :param place: (n,) index among the pairs shown to which each point leads.
    """

    point: Array
    offset: Array
    place: Ints


def _drawn_path(comparison: Comparison, rows: Ints) -> _DrawnPath:
    """Return points of the nominal path and offsets of the corrected path.

    Between consecutive pairs both paths are followed: arcs are drawn as arcs.

    :param rows: (s,) pairs shown, as rows of `Comparison.pair`, ascending.
    """
    if comparison.curves is None:
        return _DrawnPath(comparison.target[rows, :3, 3], comparison.offset[rows], np.arange(len(rows)))
    # number of chords by which the path to each pair is drawn: one where the path is unknown, or where the pair before
    # it is not shown
    chord_count = np.where(np.isnan(comparison.path_distance[rows]), 1, comparison.curves.parts(_CHORD_ANGLE)[rows])
    is_after_shown_pair = np.diff(rows, prepend=-2) == 1
    chord_count = np.where(is_after_shown_pair, np.minimum(chord_count, max(1, _MOST_POINTS // len(rows))), 1)
    place = np.repeat(np.arange(len(rows)), chord_count)
    # the parameter u of both paths is i at pair i: a chord of the path to it ends at i minus the share that is left
    remaining_chords = np.cumsum(chord_count)[place] - 1 - np.arange(len(place))
    u = rows[place] - remaining_chords / chord_count[place]
    nominal_point, corrected_point = comparison.target[rows[place], :3, 3], comparison.pose[rows[place], :3, 3]
    inner = np.flatnonzero(remaining_chords)  # points between pairs
    if len(inner):
        nominal_point[inner], corrected_point[inner] = comparison.curves.at(u[inner])
    return _DrawnPath(nominal_point, corrected_point - nominal_point, place)


def _path_line(points: Array, name: str, colour: Colour, place: Ints) -> Lines:
    """Return points (n, 3) [m] as a line in space, in mm.

    :param place: (n,) index among the pairs shown to which a click on each point leads.
    """
    x, y, z = (points * MM_PER_M).T.tolist()
    return Lines(x, y, z, name, colour, places=place.tolist())


def _program_plots_section(comparison: Comparison, content: ComparisonSummary, rows: Ints, nominal: Names) -> Section:
    """Return the section with offsets and, where forces are known, deviations along the program.

    :param rows: (s,) pairs shown, as rows of `Comparison.pair`, ascending.
    :param nominal: display names of the files of the nominal program.
    """

    def curve(values: Array, name: str, colour: Colour) -> Curve:
        """Return values (s,) [m] as a curve in mm over the number of the pair."""
        # not over the line of the program: lines go back where a program repeats some
        return Curve((rows + 1.0).tolist(), (values * MM_PER_M).tolist(), name, colour, places=[*range(len(rows))])

    x_axis = Axis(title=f"pair of targets, in the order of {nominal.main_file}")
    offset_x, offset_y, offset_z = comparison.offset[rows].T
    curves = [curve(offset_x, "X", "correction"), curve(offset_y, "Y", "force"), curve(offset_z, "Z", "ink")]
    parts: list[Part] = [
        Plot(label="Offset in X, Y, Z along the program", traces=[*curves], x=x_axis, y=Axis(title="offset, mm"))
    ]
    if comparison.cuts is not None:
        deviations = [
            curve(norm(comparison.cuts.nominal[rows]), "nominal", "before"),
            curve(norm(comparison.cuts.corrected_deviation[rows]), "corrected", "after"),
        ]
        parts.append(
            Plot(
                label="What each program cuts along the path",
                traces=[*deviations],
                x=x_axis,
                y=Axis(title="deviation, mm"),
                marks=[Mark(content.tolerance_mm, "tolerance", "warning", level=True)],
            )
        )
    return Section("along", "Along the program", tuple(parts))


def _histogram_section(comparison: Comparison, pair_rows: Ints) -> Section:
    """Return the section with the histogram of the offset [mm] over the length of the cutting path.

    A click on a bar leads to the shown pair with the largest offset in it.

    :param pair_rows: (s,) pairs shown, as rows of `Comparison.pair`, ascending.
    """
    cutting, total = ~comparison.rapid, float(comparison.cut_length.sum())
    percent = 100.0 * comparison.cut_length[cutting] / (total or 1.0)
    heights, edges = np.histogram(comparison.distance[cutting] * MM_PER_M, bins=_BINS, weights=percent)
    size = np.where(comparison.rapid, -1.0, comparison.distance)[pair_rows] * MM_PER_M  # negative: not cutting
    by_size = np.argsort(size)
    # index in `by_size` of the largest shown pair up to the upper edge of each bar; −1: no pair
    largest_of_bar = np.searchsorted(size[by_size], edges[1:], side="right") - 1
    places = [
        int(by_size[k]) if k >= 0 and size[by_size[k]] >= lower_edge else None
        for k, lower_edge in zip(largest_of_bar, edges[:-1], strict=True)
    ]
    bars = Histogram(edges.tolist(), heights.tolist(), "offset", places)
    plot = Plot(
        label="Histogram of the offset along the cutting path",
        traces=[bars],
        x=Axis(title="offset, mm"),
        y=Axis(title="cutting path, %"),
    )
    return Section("histogram", "Distribution of the offset", (plot,))


def _operations_section(
    comparison: Comparison, content: ComparisonSummary, pair_rows: Ints, names: Sequence[Names]
) -> Section:
    """Return the section with the largest values of each operation of the nominal program.

    :param pair_rows: (s,) pairs shown, as rows of `Comparison.pair`, ascending.
    :param names: display names of the files of both programs.
    """
    head = ["Operation", "Tool", "First line", "Cutting targets", "Offset, mm"]
    head += ["Nominal cuts, mm", "Corrected cuts, mm"] if content.cut is not None else []
    rows = []
    for number, operation in enumerate(content.operations, 1):
        cut = operation.cut
        cells = [
            operation.name or f"operation {number}",
            tool_text(comparison.nominal, operation.tool) or "-",
            names[0].line_text((operation.nominal_file, operation.nominal_line)),
            str(operation.pairs),
            millimetre_text(operation.offset.max_mm),
            *([millimetre_text(cut.nominal.max_mm), millimetre_text(cut.corrected.max_mm)] if cut is not None else []),
        ]
        place = _place_of(comparison, pair_rows, names[0], operation.nominal_file, operation.nominal_line)
        rows.append(Row(tuple(cells), place, operation.nominal_line))
    table = Table(
        tuple(head), tuple(rows), "Operations, largest values", texts=(1,), sortable=True, note="Largest values."
    )
    return Section("operations", "Operations and tools", (table,))


def _worst_pairs_section(comparison: Comparison, pair_rows: Ints, names: Sequence[Names]) -> Section:
    """Return the section with the table of the cutting pairs with the largest offsets.

    :param pair_rows: (s,) pairs shown, as rows of `Comparison.pair`, ascending; they contain those of the table.
    :param names: display names of the files of both programs.
    """
    head = [
        *(f"Line of {name.main_file}" for name in names),
        "Offset, mm",
        "X, mm",
        "Y, mm",
        "Z, mm",
        "Turned, °",
        "On the way there, mm",
    ]
    head += ["Nominal cuts, mm", "Corrected cuts, mm"] if comparison.cuts is not None else []
    cuts = () if comparison.cuts is None else (comparison.cuts.nominal, comparison.cuts.corrected_deviation)
    rows = []
    worst = _worst_rows(comparison)
    nominal_places = comparison.nominal.places(comparison.pair[worst, 0])
    corrected_places = comparison.corrected.places(comparison.pair[worst, 1])
    for k, row in enumerate(worst.tolist()):
        cells = [names[0].line_text(nominal_places.of(k)), names[1].line_text(corrected_places.of(k))]
        cells.append(millimetre_text(float(comparison.distance[row]) * MM_PER_M))
        cells += [f"{value:.4f}" for value in without_negative_zero(comparison.offset[row] * MM_PER_M)]
        cells.append(f"{np.degrees(comparison.rotation[row]):.4f}")
        path_distance = float(comparison.path_distance[row])
        cells.append("-" if np.isnan(path_distance) else millimetre_text(path_distance * MM_PER_M))
        cells += [millimetre_text(float(norm(deviation[row])) * MM_PER_M) for deviation in cuts]
        rows.append(Row(tuple(cells), int(np.searchsorted(pair_rows, row)), int(nominal_places.line[k])))
    return Section("worst", "Largest offsets", (Table(tuple(head), tuple(rows), "Largest offsets", sortable=True),))


def _issues_section(comparison: Comparison, content: ComparisonSummary, pair_rows: Ints, names: Names) -> Section:
    """Return the section with the differences that are not of positions; a row leads to the pair at its line.

    :param pair_rows: (s,) pairs shown, as rows of `Comparison.pair`, ascending.
    :param names: display names of the files of the nominal program.
    """
    if not content.issues:
        return Section("issues", "Differences besides positions", (Notes((Note("None.", "good"),)),))
    rows = tuple(
        Row(
            (
                Cell(issue.level, _LEVEL_KINDS[issue.level]),
                issue.message,
                place_text(issue) or "-",
                str(issue.count),
            ),
            _place_of(comparison, pair_rows, names, issue.source_file, issue.source_line),
            issue.source_line,
        )
        for issue in content.issues
    )
    head = ("Level", "What", "Where first", "Places")
    return Section("issues", "Differences besides positions", (Table(head, rows, "Differences", texts=(1, 2)),))
