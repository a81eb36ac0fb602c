"""Data of the page of a program: what its sections show and its scripts read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from msgspec import Struct

from postproc import kinematics, toolpath
from postproc.collision import Body
from postproc.correction import Result
from postproc.dialects.text import line_spans
from postproc.errors import Issue
from postproc.forces.axes import axes_of_travel
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, largest, norm, xyzabc_from_pose
from postproc.program import CIRC, PTP, WRENCH, Bools, Ints, distinct
from postproc.report.answers import Remedy
from postproc.report.kit import Columns
from postproc.report.path import Operation, drawn_path, operations
from postproc.report.record import Record
from postproc.report.summary import Summary, summary
from postproc.report.verdict import nothing_to_correct
from postproc.robot import JOINTS
from postproc.robot.shapes import LinkShape

if TYPE_CHECKING:
    from postproc.machining import ProcessForces
    from postproc.report.surface import Surface

_LEAST_SLOWING = 1.0 + 1e-6
"""A piece of path is slowed by the turn of the tool if it takes longer than at its feed by this factor."""
_BINS = 60
"""Bars of the histogram."""
_STOCK_CELLS = 40_000
"""Cells of the remaining stock that a page shows; larger maps are made coarser."""
_SHARP_EDGE_COSINE = np.cos(np.radians(40.0))
"""Cosine of the angle of two normals: facets that meet at a larger angle have an edge in the picture (assumed)."""
_WORST_LINES = 12
"""Number of lines of the program with the largest values that are listed, for each measure."""
_MOST_GOUGES = 40
"""Largest number of rows of the table of gouges."""
_LONGEST_TEXT = 6_000_000
"""Largest number of characters of a program whose text is in the page: 250 000 lines, a megabyte of the page."""
_LONGEST_LINE = 200
"""Largest number of characters of a line of the program that are shown."""


class Histogram(msgspec.Struct, frozen=True):
    """Shares of the cutting path by deviation: percent of its length between each two of the edges [mm]."""

    edges: list[float]
    percent: list[float]


class Facts(msgspec.Struct, frozen=True):
    """Data that the scripts of the page read in addition to the columns. Lengths mm, angles degrees.

    :param mode: see `postproc.correction.Mode`.
    :param frame: frame of the drawn path: "$BASE", or "robot root" if the program has several bases.
    :param tolerance_mm: stated tolerance of the path; None: not stated.
    :param bounded: the places have expected errors (column `u95`).
    :param worst: places of the largest deviation before and after, by column name.
    :param lower: lower limits of the joints, `upper` their upper limits.
    :param bases: each `$BASE` in the root, 4×4 by rows.
    :param tools: each `$TOOL` in the flange frame, 4×4 by rows.
    :param placement: frame of each joint in the frame of the link before it, 4×4 by rows.
    :param axis: axis of each joint in its frame.
    :param flange: flange in the frame of the last link, 4×4 by rows.
    :param links: links that have meshes, in the order of their points in the columns: number of the link (0 = base),
        number of its points and of its faces.
    :param bodies: tool and obstacles, whose points and faces follow those of the links: number of the link that carries
        the body (0 = base, 7 = flange), number of its points and of its faces.
    :param histograms: histograms of the deviation before and after, by column name.
    :param reversals: place and joint of each step by lost motion, where a torque changes its direction.
    """

    mode: str
    frame: str
    tolerance_mm: float | None
    bounded: bool
    worst: dict[str, int]
    lower: list[float]
    upper: list[float]
    bases: list[list[float]]
    tools: list[list[float]]
    placement: list[list[float]]
    axis: list[list[float]]
    flange: list[float]
    links: list[tuple[int, int, int]]
    bodies: list[tuple[int, int, int]]
    histograms: dict[str, Histogram]
    reversals: list[tuple[int, str]]


class Deviation(Struct, frozen=True, dict=True):
    """A result, and data computed from it that several sections of its page use.

    :param result: result of one program.
    :param tolerance: largest permitted distance of the tip from the nominal path [m]; None = not stated.
    :param surface: deviations of the surface of the part; None: not computed.
    :param process: forces computed from material and stock; None: the forces have another source.
    :param part_tolerance: largest permitted error of the part [m], 95 %; None = not stated.
    :param stem: beginning of the names of the files that are written with the page, such as ``"part."``.
    :param remedies: measures that would lower the expected error, see `postproc.report.summary.summary`.
    :param record: date, customer and checksums that the page states; None: no record.
    """

    result: Result
    tolerance: float | None
    surface: Surface | None = None
    process: ProcessForces | None = None
    part_tolerance: float | None = None
    stem: str = ""
    remedies: tuple[Remedy, ...] = ()
    record: Record | None = None

    @cached_property
    def content(self) -> Summary:
        """Content of `report.json`."""
        return summary(self.result, self.tolerance, self.part_tolerance, self.surface, self.remedies)

    @cached_property
    def uncorrected_reason(self) -> str | None:
        """A sentence that says why there is nothing to correct; None if there is a deviation to correct."""
        return nothing_to_correct(self.content)

    @cached_property
    def source(self) -> str:
        """Text of the program as read, with line feeds between its lines; empty if it is too long for a page.

        Lines are cut off after `_LONGEST_LINE` characters.
        """
        documents = self.result.program.documents
        if not documents or len(documents[0].text) > _LONGEST_TEXT:
            return ""
        text = documents[0].text
        starts, stops = line_spans(text)
        return "\n".join(
            text[start : min(stop, start + _LONGEST_LINE)]
            for start, stop in zip(starts.tolist(), stops.tolist(), strict=True)
        )

    @property
    def is_compared(self) -> bool:
        """True if a program was written, so that deviations before and after can be compared."""
        return self.result.mode != "predict"

    @cached_property
    def places(self) -> ShownTargets:
        """The targets that the page shows; the result must have a target."""
        return shown_targets(self.result, self._linked_rows())

    @cached_property
    def links(self) -> list[LinkShape]:
        """Shapes of the links from the model folder; a link without a readable file is drawn as a simple solid."""
        shapes, _ = self.result.robot.link_shapes(for_drawing=True)
        return shapes

    @cached_property
    def bodies(self) -> list[Body]:
        """Bodies of the cell that were checked for collisions, without the arm."""
        clearance = self.result.clearance
        return [] if clearance is None else [body for body in clearance.scene.bodies if body.role != "arm"]

    @cached_property
    def operations(self) -> list[Operation]:
        """The operations of the program."""
        return operations(self.result)

    @cached_property
    def worst_rows(self) -> Ints:
        """Rows (n,) of the targets in the table of the worst places, sorted by the deviation before, the largest first.

        These are, for each of the deviation before, the deviation after and the bound, the targets with the largest
        values, one for each line of the program, `_WORST_LINES` of them.
        """
        result = self.result
        measures = [result.before, *([result.after] if self.is_compared else [])]
        measures += [] if result.bound is None else [result.bound]
        rows = distinct(
            np.concatenate([_worst_rows(measure, result.rapid, result.source_line) for measure in measures])
        )
        return rows[np.argsort(-result.before[rows], kind="stable")]

    @cached_property
    def gouges(self) -> Ints:
        """Facets (n,) that are gouged by more than the tolerance: the deepest of each source line, the deepest first.

        At most `_MOST_GOUGES`; empty without a surface or a tolerance.
        """
        surface, tolerance = self.surface, self.tolerance
        if surface is None or tolerance is None:
            return np.zeros(0, dtype=np.int64)
        deviation = surface.after if self.is_compared else surface.before
        gouged_facets = np.flatnonzero(deviation < -tolerance)
        deepest_first = gouged_facets[np.argsort(deviation[gouged_facets], kind="stable")]
        # unique returns where each line occurs first: at its deepest facet
        _, first = np.unique(self.result.source_line[surface.row[deepest_first]], return_index=True)
        return deepest_first[np.sort(first)[:_MOST_GOUGES]]

    def first_row_of_issue(self, issue: Issue) -> int | None:
        """Return the row of the first target on the source line of an issue; None if the line has no target."""
        rows = np.flatnonzero(self.result.source_line == issue.source_line)
        return int(rows[0]) if len(rows) else None

    def _linked_rows(self) -> Ints:
        """Return the rows of the result to which tables of the page lead: thinning of the targets must keep them."""
        result = self.result
        issue_rows = [row for issue in result.issues if (row := self.first_row_of_issue(issue)) is not None]
        operation_rows = [operation.first for operation in self.operations]
        rows = [self.worst_rows, np.array([*operation_rows, *issue_rows], dtype=np.int64)]
        if self.surface is not None:
            # targets that cut into the part as programmed: the first is linked if no other row is
            cutting_rows = self.surface.programmed_row[self.surface.programmed_row >= 0]
            rows += [self.surface.row[self.gouges], cutting_rows[:1]]
        if result.reversals is not None:
            rows.append(result.reversals.row[result.largest_reversals])
        return np.concatenate(rows)

    def stock_columns(self) -> dict[str, Columns]:
        """Return the columns of the remaining stock: vertices with their depth below its top [mm], faces, sharp edges.

        Empty without a process.
        """
        if self.process is None:
            return {}
        points, faces, _ = self.process.mesh(_STOCK_CELLS)
        height = points @ self.process.map_in_base[:3, 2]  # along the z axis of the map of the stock
        depth = height.max(initial=-np.inf) - height
        edge = _sharp_edges(points, faces)
        vertex_columns = {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2], "depth": depth}
        return {
            "stock_points": Columns.of({name: values * MM_PER_M for name, values in vertex_columns.items()}),
            "stock_faces": Columns.of(dict(zip("ijk", faces.T, strict=True))),
            "stock_edges": Columns.of({"begin": edge[:, 0], "end": edge[:, 1]}),
        }

    def columns(self) -> dict[str, Columns]:
        """Return the columns of the page by name: places, path, stock, meshes of links and bodies, surface."""
        tables = {"places": self.places.columns, "drawn": self.places.path_columns}
        tables |= self.stock_columns()
        meshes: list[LinkShape | Body] = [*self.links, *self.bodies]
        if meshes:
            points = np.concatenate([mesh.points for mesh in meshes]) * MM_PER_M
            faces = np.concatenate([mesh.faces for mesh in meshes])
            tables["link_points"] = Columns.of(dict(zip("xyz", points.T, strict=True)))
            tables["link_faces"] = Columns.of(dict(zip("ijk", faces.T, strict=True)))
        if self.surface is not None:
            corners = self.surface.corners.reshape(-1, 3) * MM_PER_M
            tables["corners"] = Columns.of(dict(zip("xyz", corners.T, strict=True)))
            tables["facets"] = self._facet_columns(self.surface)
        return tables

    def _facet_columns(self, surface: Surface) -> Columns:
        """Return the deviations of each facet [mm], and the place of the page at which a tool cuts it.

        A place is the index of a target among those that the page shows; −1 without a cut.

        :param surface: the surface of this page, `self.surface`.
        """
        # the target that leaves the surface as written; if no tool touches the facet, the one that cuts into it as
        # programmed; −1: none
        is_untouched = surface.row < 0
        row = np.where(is_untouched, surface.programmed_row, surface.row)
        place = np.minimum(np.searchsorted(self.places.row, row), len(self.places.row) - 1)
        bound = np.full(len(place), np.nan) if surface.bound is None else surface.bound
        values = {"before": surface.before, "after": surface.after, "u95": bound, "programmed": surface.programmed}
        facets = {name: value * MM_PER_M for name, value in values.items()}
        return Columns.of({**facets, "place": np.where(row < 0, -1, place)})

    def facts(self) -> Facts:
        """Return the data that scripts read in addition to the columns."""
        result = self.result
        nominal, program = result.robot.nominal, result.program
        measures = {"before": result.before, "after": result.after} if self.is_compared else {"before": result.before}
        cutting = ~result.rapid
        # −1.0: rapid targets do not count
        worst = {
            name: self.places.place_of_row(int(np.argmax(np.where(cutting, values, -1.0))))
            for name, values in measures.items()
        }
        return Facts(
            mode=result.mode,
            frame="$BASE" if len(program.bases) == 1 else "robot root",
            tolerance_mm=self.content.tolerance_mm,
            bounded=result.bound is not None,
            worst=worst,
            lower=(result.robot.lower * DEG_PER_RAD).tolist(),
            upper=(result.robot.upper * DEG_PER_RAD).tolist(),
            bases=[_pose_entries_mm(base) for base in program.bases],
            tools=[_pose_entries_mm(tool) for tool in program.tools],
            placement=[_pose_entries_mm(joint) for joint in nominal.placement],
            axis=nominal.axis.tolist(),
            flange=_pose_entries_mm(nominal.flange),
            # carriers are numbered from −1, the base
            links=[(mesh.carrier + 1, len(mesh.points), len(mesh.faces)) for mesh in self.links],
            bodies=[(mesh.carrier + 1, len(mesh.points), len(mesh.faces)) for mesh in self.bodies],
            reversals=self.reversal_marks(),
            histograms={name: _histogram(values * MM_PER_M, result.cut_length) for name, values in measures.items()},
        )

    def reversals(self) -> list[tuple[int, str]]:
        """Return place and joint of each of the largest reversals, in the order of their table.

        Empty without reversals.
        """
        return [] if self.result.reversals is None else self._places_and_joints(self.result.largest_reversals)

    def reversal_marks(self) -> list[tuple[int, str]]:
        """Return place and joint of all reversals with lost motion, each place and joint once, in order."""
        reversals = self.result.reversals
        if reversals is None:
            return []
        return list(dict.fromkeys(self._places_and_joints(np.flatnonzero(reversals.step > 0.0))))

    def _places_and_joints(self, index: Ints) -> list[tuple[int, str]]:
        """Return place of the page and name of the joint of reversals; the result must have `reversals`.

        :param index: (n,) indices in the reversals of the result.
        """
        reversals = self.result.reversals
        assert reversals is not None
        rows, joints = reversals.row[index].tolist(), reversals.joint[index].tolist()
        return [(self.places.place_of_row(row), JOINTS[joint]) for row, joint in zip(rows, joints, strict=True)]


def _worst_rows(measure: Array, rapid: Bools, line: Ints) -> Ints:
    """Return the rows (n,) with the largest value of each of the `_WORST_LINES` lines with the largest values.

    :param measure: (K,) value of each target; NaN counts as the largest.
    :param rapid: (K,) True for targets that do not count.
    :param line: (K,) source line of each target.
    """
    value = np.where(rapid, -1.0, np.nan_to_num(measure, nan=np.inf))  # −1: below all others
    # the lines are sought among the largest values only: sorting all of a long program takes longer (400: assumed)
    count = min(len(value), 400 * _WORST_LINES)
    largest_rows = np.argpartition(-value, count - 1)[:count]
    largest_first = largest_rows[np.argsort(-value[largest_rows], kind="stable")]
    # unique returns where each line occurs first: at its largest value
    _, first = np.unique(line[largest_first], return_index=True)
    return np.asarray(largest_first[np.sort(first)[:_WORST_LINES]])


def _sharp_edges(points: Array, faces: Ints) -> Ints:
    """Return the edges (E, 2) of a closed mesh at which two faces meet at a large angle, as rows of its vertices.

    :param points: (V, 3) vertices, `faces` (F, 3) rows of the corners of each face.
    """
    first_corner, second_corner, third_corner = (points[faces[:, k]] for k in range(3))
    normal = np.cross(second_corner - first_corner, third_corner - first_corner)
    # 1e-300 keeps zero out of the denominator
    normal /= np.maximum(norm(normal), 1e-300)[:, None]
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    # each edge of a closed mesh belongs to two faces: sorted, its two rows are next to each other
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    first, second = order[:-1], order[1:]
    same_edge = (edges[first] == edges[second]).all(axis=1)
    first, second = first[same_edge], second[same_edge]
    count = len(faces)  # edges are three blocks of `count` rows: row r is of face r % count
    is_sharp = np.einsum("ei,ei->e", normal[first % count], normal[second % count]) < _SHARP_EDGE_COSINE
    return np.asarray(edges[first[is_sharp]])


def _histogram(values: Array, cut_length: Array) -> Histogram:
    """Return the histogram of values (K,) [mm] on cuts, from 0 to the largest value; up to 1 if all values are 0.

    :param cut_length: (K,) length of the cutting path with which each value counts [m]; 0 of rapid moves.
    """
    is_cut = cut_length > 0.0
    values, percent = values[is_cut], 100.0 * cut_length[is_cut] / (float(cut_length.sum()) or 1.0)
    largest_value = float(values.max(initial=0.0)) or 1.0
    heights, edges = np.histogram(values, bins=_BINS, range=(0.0, largest_value), weights=percent)
    return Histogram(edges.tolist(), heights.tolist())


def _pose_entries_mm(pose: Array) -> list[float]:
    """Return the 16 entries of a pose (4, 4) [m] row by row, its translation in mm."""
    pose_mm = pose.copy()
    pose_mm[:3, 3] *= MM_PER_M
    return [float(value) for value in pose_mm.ravel()]


MAX_PLACES = 40_000
"""Largest number of places of a page, not counting places that its tables lead to.

Of more targets, consecutive ones are grouped: each group keeps its first target and its largest values.
"""
_MOST_POINTS = 80_000
"""Largest number of points that are drawn in space (assumed): browsers still turn them quickly."""
_MOST_DECOMPOSITIONS = 1_000
"""Largest number of places at which the Jacobian is decomposed; between them singular values are interpolated."""


class ShownTargets(Struct, frozen=True, eq=False):
    """The targets that a page shows: P places, a selection of the K targets of the result.

    Row i of `columns` is place i.

    :param row: (P,) row of the result of each place, ascending.
    :param path_length: (K,) length of the path up to each target of the result [m].
    :param columns: the values at each place; millimetres, degrees, newtons.
    :param path_columns: points of the nominal path for the view in space: X, Y, Z [mm], and the place to which each
        leads.
    """

    row: Ints
    path_length: Array
    columns: Columns
    path_columns: Columns

    def place_of_row(self, row: int) -> int:
        """Return the place of a row of the result: the index of that target among those that the page shows.

        If it is not shown, the first place after it, or else the last place.
        """
        return min(int(np.searchsorted(self.row, row)), len(self.row) - 1)


def correction(result: Result, row: Ints) -> Array:
    """Return commanded minus nominal positions (n, 3) of targets [m], `$BASE`; the commanded ones as printed.

    :param row: (n,) rows of the targets in the result.
    """
    return np.asarray(result.printed[row, :3] / MM_PER_M - result.nominal.position[row])


def page_rows(result: Result, linked_rows: Ints) -> Ints:
    """Return the rows (P,) of the result that a page shows, ascending: all if there are at most `MAX_PLACES`.

    Of more targets, consecutive ones are grouped. Each group keeps its first target, and the targets with the largest
    deviation before and after, correction, force and bound.

    :param linked_rows: (n,) rows to which tables lead; they are kept.
    """
    count = len(result)
    if count <= MAX_PLACES:
        return np.arange(count)
    group_count = MAX_PLACES // (5 if result.bound is None else 6)  # a group keeps its first and one for each measure
    begin = distinct(np.linspace(0, count, group_count, endpoint=False).astype(np.int64))
    length = np.diff(begin, append=count)
    rows = [begin, np.array([count - 1]), linked_rows]
    for measure in _measures(result):
        value = np.nan_to_num(measure, nan=np.inf)
        largest_rows = np.flatnonzero(value == np.repeat(np.maximum.reduceat(value, begin), length))
        # of equal largest values of a group the first: where the number of the group changes
        rows.append(largest_rows[np.diff(np.searchsorted(begin, largest_rows, side="right"), prepend=0) != 0])
    return distinct(np.concatenate(rows))


def _measures(result: Result) -> Iterator[Array]:
    """Yield the measures (K,) whose largest values a page shows: deviations, correction [m], force [N], bound [m].

    The bound is left out if the model states no uncertainty.
    """
    yield result.before
    yield result.after
    yield norm(correction(result, np.arange(len(result))))
    yield result.force
    if result.bound is not None:
        yield result.bound


def shown_targets(result: Result, linked_rows: Ints) -> ShownTargets:
    """Return the targets of a result that its page shows: all, or a selection that contains the linked rows.

    :param result: a result with at least one target.
    :param linked_rows: (n,) rows of the result to which tables of the page lead.
    """
    position, target_row = drawn_path(result)
    step = norm(np.diff(position, axis=0, prepend=position[:1]))
    # each target is the last point of its piece
    path_length = np.cumsum(step)[np.flatnonzero(np.diff(target_row, append=len(result)))]
    duration = _durations(result, np.diff(path_length, prepend=0.0))
    row = page_rows(result, linked_rows)
    columns = _place_columns(result, row, path_length, duration)
    return ShownTargets(row, path_length, Columns.of(columns), _path_columns(result, position, target_row, row))


def _place_columns(result: Result, row: Ints, path_length: Array, duration: Array) -> dict[str, Array | Ints | Bools]:
    """Return the columns (P,) of the places of a page by name; millimetres, degrees, newtons, seconds.

    The column `t` is the place on the motion in (0, 1], and `time` the time from the start of the program.

    :param row: (P,) row of the result of each place.
    :param path_length: (K,) length of the path up to each target [m].
    :param duration: (K,) time from the previous target to each target [s].
    """
    m, motion = result.program.motions, result.motion
    correction_mm = correction(result, row) * MM_PER_M
    speed = _speeds(np.diff(path_length, prepend=0.0)[row], m.feed[motion[row]], duration[row])
    columns: dict[str, Array | Ints | Bools] = {
        "source_line": result.source_line[row],
        "output_line": result.output_line[row],
        "base": m.base[motion[row]],
        "tool": m.tool[motion[row]],
        "t": result.t[row],
        "length": path_length[row] * MM_PER_M,
        "time": np.cumsum(duration)[row],
        "speed": speed * MM_PER_M,
        "before": norm(result.deviation_before[row]) * MM_PER_M,
        "after": norm(result.deviation_after[row]) * MM_PER_M,
        "u95": (np.full(len(row), np.nan) if result.bound is None else result.bound[row]) * MM_PER_M,
        "correction": norm(correction_mm),
        "force": norm(result.wrench[row, :3]),
        "singular": _singular_values(result, row),
        "rapid": result.rapid[row],
    }
    return columns | _vector_columns(result, row, correction_mm)


def _vector_columns(result: Result, row: Ints, correction_mm: Array) -> dict[str, Array]:
    """Return the columns (P,) of vectors at the places of a page, by component; millimetres, degrees, newtons.

    A name of a letter and an axis: c is the correction, b the deviation before, a the deviation after, along X, Y or Z
    of `$BASE`. Deviations also have components along, across and normal to the feed, such as `b_along`.

    :param row: (P,) row of the result of each place.
    :param correction_mm: (P, 3) correction at each place, in `$BASE`.
    """
    vectors: list[tuple[Sequence[str], Array]] = [
        ("XYZABC", xyzabc_from_pose(result.nominal[row])),
        (("cX", "cY", "cZ"), correction_mm),
        (WRENCH, result.wrench[row]),
        (JOINTS, result.q[row] * DEG_PER_RAD),
    ]
    axes = _feed_axes(result, row)
    for letter, deviation in (("b", result.deviation_before[row]), ("a", result.deviation_after[row])):
        vectors.append(([f"{letter}{axis}" for axis in "XYZ"], deviation * MM_PER_M))
        feed_names = [f"{letter}_{direction}" for direction in ("along", "across", "normal")]
        vectors.append((feed_names, np.einsum("nij,ni->nj", axes, deviation) * MM_PER_M))
    return {name: values[:, index] for names, values in vectors for index, name in enumerate(names)}


def _speeds(length: Array, feed: Array, seconds: Array) -> Array:
    """Return the speeds (P,) on pieces of path [m/s]: the feed, or less where the turn of the tool takes longer.

    :param length: (P,) lengths of the pieces [m].
    :param feed: (P,) feeds [m/s].
    :param seconds: (P,) times of the pieces [s].
    """
    is_slow = (length > 0.0) & (seconds * feed > length * _LEAST_SLOWING)
    return np.where(is_slow, length / np.where(is_slow, seconds, 1.0), feed)


def _path_columns(result: Result, position: Array, target_row: Ints, row: Ints) -> Columns:
    """Return the points of the nominal path that lead to places [mm], each with its place.

    Of more than `_MOST_POINTS` points the targets alone.

    :param position: (n, 3) points of the path [m].
    :param target_row: (n,) row of the result to which each point leads.
    :param row: (P,) row of the result of each place.
    """
    is_shown = np.isin(target_row, row)
    if np.count_nonzero(is_shown) > _MOST_POINTS:
        is_shown = np.zeros(len(target_row), dtype=bool)
        # each target is the last point of its piece
        is_shown[np.flatnonzero(np.diff(target_row, append=len(result)))[row]] = True
    point = position[is_shown] * MM_PER_M
    return Columns.of(
        {"x": point[:, 0], "y": point[:, 1], "z": point[:, 2], "place": np.searchsorted(row, target_row[is_shown])}
    )


def _durations(result: Result, length: Array) -> Array:
    """Return the time (K,) from the previous target to each target [s].

    Cartesian motions: the time at the feed, or the time to turn the tool at the stated speed if that is longer.
    PTP, and motions without a feed: the time of the slowest joint at its full speed.

    :param length: (K,) length of the path from the previous target to each target [m].
    """
    motions = result.program.motions
    feed, kind = motions.feed[result.motion], motions.kind[result.motion]
    joint_time = largest(np.diff(result.q, axis=0, prepend=result.q[:1]) / result.robot.speed)  # of the slowest joint
    has_feed = (kind != PTP) & (feed > 0.0)
    feed_time = length / np.where(has_feed, feed, 1.0)
    return np.where(has_feed, np.maximum(feed_time, _turn_times(result)), joint_time)


def _turn_times(result: Result) -> Array:
    """Return the least time (K,) to turn the tool from the previous target [s], at the turning speeds of the program.

    0 if the program states no turning speeds, and where `$BASE` or `$TOOL` changes.
    """
    program, motion = result.program, result.motion
    seconds = np.zeros(len(result))
    if program.turn_speeds is None or len(result) == 0:
        return seconds
    base, tool, rotation = program.motions.base[motion], program.motions.tool[motion], result.nominal.rotation
    is_same = (base[1:] == base[:-1]) & (tool[1:] == tool[:-1])
    turning = toolpath.turn_seconds(rotation[:-1], rotation[1:], program.turn_speeds.take(motion[1:]))
    seconds[1:] = np.where(is_same, turning, 0.0)
    return seconds


def _feed_axes(result: Result, row: Ints) -> Array:
    """Return the axes (P, 3, 3) along, across and normal to the feed at targets, as columns in `$BASE`.

    NaN where the tool moves along its spindle or not at all, and where `$BASE` changes.

    :param row: (P,) rows of the targets in the result.
    """
    m, position = result.program.motions, result.nominal.position
    motion, previous = result.motion[row], np.maximum(row - 1, 0)
    travel = position[row] - position[previous]
    is_arc = m.kind[motion] == CIRC
    travel[is_arc] = _arc_tangents(result, row[is_arc], travel[is_arc])
    # divided by its length: axes_of_travel may take short steps, of finishing programs, for no travel
    length = norm(travel)[:, None]
    travel = np.divide(travel, length, out=np.zeros_like(travel), where=length > 0.0)
    axes, is_defined = axes_of_travel(result.nominal[row, :3, :3], travel, result.axis)
    is_defined &= m.base[motion] == m.base[result.motion[previous]]
    axes[~is_defined] = np.nan
    return axes


def _arc_tangents(result: Result, row: Ints, chord: Array) -> Array:
    """Return vectors (n, 3) along the feed at targets on arcs and helices, `$BASE` [m].

    The chord from the previous target would differ in direction by half the angle of the piece.

    :param row: (n,) rows of the targets in the result.
    :param chord: (n, 3) vector from the previous target to each target [m].
    """
    m, motion, previous = result.program.motions, result.motion[row], np.maximum(row - 1, 0)
    normal = m.normal[motion]
    travel_per_radian = np.cross(normal, result.nominal.position[row] - m.centre[motion])  # in the plane of the arc
    rise = np.einsum("ni,ni->n", chord, normal)[:, None] * normal
    is_same_motion = (result.motion[previous] == motion) & (row > 0)
    angle = m.sweep[motion] * (result.t[row] - np.where(is_same_motion, result.t[previous], 0.0))
    return np.asarray(travel_per_radian + rise / np.where(angle > 0.0, angle, 1.0)[:, None])


def _singular_values(result: Result, row: Ints) -> Array:
    """Return the smallest singular value (P,) of the tool's Jacobian, in m/rad and rad/rad.

    Of more than `_MOST_DECOMPOSITIONS` places it is computed at so many and interpolated between these.

    :param row: (P,) row of the result of each place.
    """
    samples = distinct(np.linspace(0, len(row) - 1, min(len(row), _MOST_DECOMPOSITIONS)).astype(np.int64))
    tool = result.program.tools[result.program.motions.tool[result.motion[row[samples]]]]
    values = kinematics.smallest_singular_values(result.robot, result.q[row[samples]], tool)
    return np.interp(np.arange(len(row)), samples, values)
