"""The surface that a tool leaves where its passes overlap: at each facet the deepest pass counts.

A line through the centre of a facet along its outward normal enters the tool, a convex body, at one place. The part
remains up to the lowest entry of all samples of the path. With the tip moved by its deviation the entry is that of the
deflected tool: a pass that deflects into the part counts wherever its tool reaches, not only where it is the nearest.

The distance of a point at the height z over the tip and at ρ from the axis from a tool of radius R and corner radius r
is √(max(ρ − R + r, 0)² + max(r − z, 0)²) − r outside. Along a line it is convex: Newton's method from the side of the
part approaches the entry without passing it, so that each of its values is a lower bound.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.chunks import ragged_range
from postproc.frames import Array, norm
from postproc.machining.tool import Cutter
from postproc.program import Bools, Ints
from postproc.report.surface.contact import LENGTH_IN_RADII, WALL_SINE, contact_tolerance, is_touching, touching_tips
from postproc.report.surface.path import CutPath

_CHUNK_FACETS = 128
"""Number of facets that are computed at once: their pairs stay small in memory (assumed)."""
_SEED_COUNT = 12
"""Number of samples next to the contact that give the first bound: more only shorten the search."""
_SPREAD_FACTOR = 1.5
"""Factor by which a tool touches farther from a facet on a convex surface of its radius than on a plane (assumed)."""
_STEEP_COSINE = 0.3
"""Cosine of normal and axis below which a facet is also cut by the side of a ball (assumed)."""
_MOST_NEWTON_STEPS = 60
"""Limit of Newton steps to the surface of the tool (assumed): lines that graze it converge slowly."""
_LEAST_APPROACH_RATE = -1e-6
"""Derivative of the distance along a line above which the line misses the tool (assumed)."""
_ENTRY_TOLERANCE = 1e-9
"""Distance from the tool up to which a line is at its surface [m]."""


class RemainingSurface(Struct, frozen=True, eq=False):
    """Surfaces that the path of one tool leaves at n facets, along their normals; infinite where it does not touch.

    :param programmed: (n,) entry into the tool without deviation [m].
    :param deflected: (2, n) entry into the deflected tool [m]: without correction, and with the program as written.
    :param row: (n,) row of the result at the end of the piece of path that leaves the surface with the program as
        written; −1 where the tool touches nothing.
    :param share: (n,) share of that piece from its start to the place.
    """

    programmed: Array
    deflected: Array
    row: Ints
    share: Array


def remaining_surface(path: CutPath, centre: Array, normal: Array, cutter: Cutter) -> RemainingSurface:
    """Return the surfaces that the path of a tool leaves at n facets.

    :param centre: (n, 3) centres of the facets [m], `normal` (n, 3) their outward normals.
    """
    # without correction (0), and with the program as written (1)
    largest_deviations = [float(norm(deviation).max(initial=0.0)) for deviation in path.deviation]
    # sorted by the centre of the corner radius; cells of a quarter of the tool's radius (assumed)
    grid = _Grid.of(path.point + cutter.corner * path.axis, 0.25 * cutter.radius)
    parts = []
    for first in range(0, len(centre), _CHUNK_FACETS):
        rows = slice(first, first + _CHUNK_FACETS)
        _, nearest = path.tree.query(centre[rows])
        facets = _Facets.of(centre[rows], normal[rows], path.axis[nearest], cutter)
        highest, offset = _surface_bounds(path, facets, cutter)
        # deviations move the tool of a facet, and those that compete with it, by the largest one each
        low, high = _search_boxes(facets, cutter, highest + 2.0 * max(largest_deviations), offset)
        pairs = _Pairs(*grid.points_in_boxes(low, high))
        parts.append(_lowest_entries(path, facets, cutter, pairs, highest, largest_deviations))
    return RemainingSurface(
        np.concatenate([part.programmed for part in parts]),
        np.concatenate([part.deflected for part in parts], axis=1),
        np.concatenate([part.row for part in parts]),
        np.concatenate([part.share for part in parts]),
    )


class _Facets(NamedTuple):
    """Facets to be cut; all (n, 3).

    :param centre: centres [m].
    :param normal: outward normals.
    :param axis: unit vectors from tip to spindle at the nearest sample of the path.
    :param tip: tips [m] of a tool with this axis that touches the facet.
    """

    centre: Array
    normal: Array
    axis: Array
    tip: Array

    @classmethod
    def of(cls, centre: Array, normal: Array, axis: Array, cutter: Cutter) -> _Facets:
        """Return facets with the tips at which a tool touches them; parameters as of the fields."""
        return cls(centre, normal, axis, touching_tips(axis, centre, normal, cutter))


class _Pairs(NamedTuple):
    """Pairs of a facet and of a sample of the path that may cut it: their indices (P,)."""

    facet: Ints
    sample: Ints

    def take(self, is_chosen: Bools) -> _Pairs:
        """Return the pairs where `is_chosen` (P,) is True."""
        return _Pairs(self.facet[is_chosen], self.sample[is_chosen])


class _Contacts(NamedTuple):
    """The m facets that the tool touches without deviation.

    :param facet: (m,) indices of the facets.
    :param entry: (m,) lowest entry into the tool at each of these facets [m].
    :param sample: (m,) sample of the path of this entry.
    """

    facet: Ints
    entry: Array
    sample: Ints


class _DeflectedEntries(NamedTuple):
    """Entries into the deflected tool at m contacts [m]; row and share (m,) as of `RemainingSurface`."""

    entry: Array
    row: Ints
    share: Array


def _lowest_entries(
    path: CutPath, facets: _Facets, cutter: Cutter, pairs: _Pairs, highest: Array, largest_deviations: list[float]
) -> RemainingSurface:
    """Return the surfaces at n facets: the lowest entries into tools at samples that are paired with them.

    An entry is the height over the facet at which its normal enters a tool.

    :param pairs: facets, and samples that may cut them.
    :param highest: (n,) upper bound of the programmed surface [m].
    :param largest_deviations: largest deviation of the tip [m] without correction (0), and with the program as written
        (1).
    """
    count, limit = len(facets.centre), contact_tolerance(cutter)
    tip, _ = _tips(path, facets, pairs, None)
    line = _Line.of(tip, path.axis[pairs.sample], facets, pairs.facet)
    # deviations move the tool of a facet, and those that compete with it, by the largest one each
    gap = highest + 2.0 * max(largest_deviations)
    # _first_entry lowers its limit in place
    nominal = _first_entry(line, pairs.facet, -limit, gap.copy(), cutter)
    low_pairs = np.flatnonzero(nominal.lower_bound <= gap[pairs.facet])
    facet = pairs.facet[low_pairs]
    touches = is_touching(tip[low_pairs] - facets.tip[facet], facets.axis[facet], facets.normal[facet], cutter)
    is_touched = (np.bincount(facet[touches], minlength=count) > 0) & (nominal.height <= limit)
    touched_facets = np.flatnonzero(is_touched)
    contacts = _Contacts(touched_facets, nominal.height[touched_facets], pairs.sample[nominal.line[touched_facets]])
    deflected, row, share = np.full((2, count), np.inf), np.full(count, -1), np.zeros(count)
    for case, deviation in enumerate(largest_deviations):
        gap = highest + 2.0 * deviation
        near_pairs = pairs.take(is_touched[pairs.facet] & (nominal.lower_bound <= gap[pairs.facet]))
        entries = _deflected_entries(
            path, facets, cutter, near_pairs, contacts, case=case, start=-limit - 2.0 * deviation, gap=gap
        )
        deflected[case, touched_facets] = entries.entry
    row[touched_facets], share[touched_facets] = entries.row, entries.share  # of the last case: the program as written
    return RemainingSurface(np.where(is_touched, nominal.height, np.inf), deflected, row, share)


def _deflected_entries(
    path: CutPath,
    facets: _Facets,
    cutter: Cutter,
    pairs: _Pairs,
    contacts: _Contacts,
    *,
    case: int,
    start: float,
    gap: Array,
) -> _DeflectedEntries:
    """Return the lowest entries into the deflected tool at contacts.

    :param pairs: facets, and samples that may cut them.
    :param contacts: facets that the tool touches without deviation.
    :param case: 0 without correction, 1 with the program as written.
    :param start: s at which the lines begin [m].
    :param gap: (n,) largest entry that counts [m]; lowered in place.
    """
    tip, sample_shares = _tips(path, facets, pairs, case)
    line = _Line.of(tip, path.axis[pairs.sample], facets, pairs.facet)
    entries = _first_entry(line, pairs.facet, start, gap, cutter)
    is_hit = np.isfinite(entries.height[contacts.facet])  # False: the deflected tool misses the line
    hit_facets = contacts.facet[is_hit]
    hit_pairs = entries.line[hit_facets]
    hit_sample = pairs.sample[hit_pairs]
    # The surface moves by no more than the tool. Entries along the normal would move more at a sharp edge: a pass
    # beside it removes all material on the normal, and a normal that misses the tool keeps all material.
    highest_entry = contacts.entry + norm(path.deviation[case, contacts.sample])
    lowest_entry = contacts.entry[is_hit] - norm(path.deviation[case, hit_sample])
    entry, row, share = highest_entry.copy(), path.row[contacts.sample], path.share[contacts.sample]
    entry[is_hit] = np.clip(entries.height[hit_facets], lowest_entry, highest_entry[is_hit])
    row[is_hit] = path.row[hit_sample]
    share[is_hit] = path.share[hit_sample] + sample_shares[hit_pairs] * path.share_step[hit_sample]
    return _DeflectedEntries(entry, row, share)


def _tips(path: CutPath, facets: _Facets, pairs: _Pairs, case: int | None) -> tuple[Array, Array]:
    """Return the tips (P, 3) on the steps of samples that are nearest to the place of contact [m], and their shares.

    The shares (P,) are the places along the steps, −0.5 … 0.5.

    :param case: 0 with the deviation without correction, 1 with that of the program as written; None: no deviation.
    """
    sample = pairs.sample
    point, step = path.point[sample], path.step[sample]
    if case is None:
        sample_shares = path.step_share(facets.tip[pairs.facet] - point, step)
        return point + sample_shares[:, None] * step, sample_shares
    point = point + path.deviation[case, sample]
    sample_shares = path.step_share(facets.tip[pairs.facet] - point, step)
    return point + sample_shares[:, None] * (step + path.deviation_step[case, sample]), sample_shares


class _Line(NamedTuple):
    """P lines c + s·n relative to tools with their tip at the origin; all (P,).

    :param square: square of the distance of c from the tip [m²].
    :param normal_distance: distance of c from the tip along n [m].
    :param height: height of c over the tip along the axis [m].
    :param up: cosine between n and the axis.
    """

    square: Array
    normal_distance: Array
    height: Array
    up: Array

    @classmethod
    def of(cls, tip: Array, axis: Array, facets: _Facets, facet: Ints) -> _Line:
        """Return the lines through the centres of facets, along their normals.

        :param tip: (P, 3) tips of the tools [m].
        :param axis: (P, 3) unit vectors from tip to spindle.
        :param facet: (P,) index of the facet of each line.
        """
        normal, c = facets.normal[facet], facets.centre[facet] - tip
        return cls(*(np.einsum("ni,ni->n", a, b) for a, b in ((c, c), (c, normal), (c, axis), (normal, axis))))

    def take(self, rows: Bools | Ints) -> _Line:
        """Return the lines of some rows."""
        return _Line(self.square[rows], self.normal_distance[rows], self.height[rows], self.up[rows])

    def distance(self, s: Array, cutter: Cutter) -> tuple[Array, Array]:
        """Return the distances (P,) [m] from the tool at s (P,) [m], 0 and below inside, and their derivatives by s.

        By the formula of the module docstring, along c + s·n. 1e-300: no division by zero on the axis and inside.
        """
        height = self.height + s * self.up
        projection = self.normal_distance + s
        lateral = np.sqrt(np.maximum(self.square + s * (self.normal_distance + projection) - height**2, 0.0))
        outward = np.maximum(lateral - (cutter.radius - cutter.corner), 0.0)
        depth_below_corner = np.maximum(cutter.corner - height, 0.0)
        corner_distance = np.hypot(outward, depth_below_corner)
        rate = outward * (projection - height * self.up) / np.maximum(lateral, 1e-300) - depth_below_corner * self.up
        return corner_distance - cutter.corner, rate / np.maximum(corner_distance, 1e-300)


class _Entries(NamedTuple):
    """Lowest entries of P lines into tools, at n facets.

    :param height: (n,) lowest entry at each facet [m]; infinite if no line enters a tool below the limit.
    :param line: (n,) index of the line of this entry; −1 without an entry.
    :param lower_bound: (P,) lower bound of the entry of each line [m]; infinite if it begins in the tool or does not
        approach it.
    """

    height: Array
    line: Ints
    lower_bound: Array


def _first_entry(line: _Line, facet: Ints, start: float, limit: Array, cutter: Cutter) -> _Entries:
    """Return the lowest entries of lines into tools.

    Newton's method on all lines at once; a line ends when it enters, passes its limit, or no longer approaches.

    :param facet: (P,) facet of each line.
    :param start: s at which all lines begin [m].
    :param limit: (n,) largest entry that counts [m]; lowered in place to the lowest entry found, which ends other
        lines.
    """
    distance, slope = line.distance(np.full(len(facet), start), cutter)
    approaches = (distance > 0.0) & (slope < _LEAST_APPROACH_RATE)
    s = np.where(approaches, start - distance / np.where(approaches, slope, -1.0), np.inf)
    lower_bound = s.copy()
    active, rows = np.flatnonzero(s <= limit[facet]), list[Ints]()
    for _ in range(_MOST_NEWTON_STEPS):
        distance, slope = line.take(active).distance(s[active], cutter)
        is_entered = np.abs(distance) <= _ENTRY_TOLERANCE
        entered_rows = active[is_entered]
        rows.append(entered_rows)
        np.minimum.at(limit, facet[entered_rows], s[entered_rows])
        is_approaching = ~is_entered & (distance > 0.0) & (slope < _LEAST_APPROACH_RATE)
        active, distance, slope = active[is_approaching], distance[is_approaching], slope[is_approaching]
        s[active] -= distance / slope
        active = active[s[active] <= limit[facet[active]]]
        if not len(active):
            break
    entry, best, entered_rows = np.full(len(limit), np.inf), np.full(len(limit), -1), np.concatenate(rows)
    # reversed: the lowest entry of each facet is assigned last
    order = entered_rows[np.lexsort((s[entered_rows], facet[entered_rows]))][::-1]
    entry[facet[order]], best[facet[order]] = s[order], order
    return _Entries(entry, best, lower_bound)


def _surface_bounds(path: CutPath, facets: _Facets, cutter: Cutter) -> tuple[Array, Array]:
    """Return an upper bound of the programmed surface above facets, by the samples next to the place of contact.

    :returns: (n,) bound [m]; (n,) distance of the nearest sample from the place of contact [m].
    """
    distance, index = path.tree.query(facets.tip, k=min(_SEED_COUNT, len(path.point)))
    index = index.reshape(len(facets.tip), -1)
    facet = np.repeat(np.arange(len(index)), index.shape[1])
    pairs = _Pairs(facet, index.ravel())
    tip, _ = _tips(path, facets, pairs, None)
    limit = np.full(len(index), contact_tolerance(cutter))
    line = _Line.of(tip, path.axis[pairs.sample], facets, facet)
    entry, _, _ = _first_entry(line, facet, -contact_tolerance(cutter), limit.copy(), cutter)
    return np.maximum(np.minimum(entry, limit), 0.0) + _ENTRY_TOLERANCE, distance.reshape(len(index), -1)[:, 0]


def _search_boxes(facets: _Facets, cutter: Cutter, gap: Array, offset: Array) -> tuple[Array, Array]:
    """Return boxes, low and high corners (n, 3) [m], with the corner centres of all tools that may matter for facets.

    These are the tools that enter the normal of a facet up to a gap above it. An empty box has a high corner of −∞.

    :param gap: (n,) largest entry above the facets [m].
    :param offset: (n,) distance of the nearest sample from the place of contact [m].
    """
    centre, normal, axis, _ = facets
    cosine = np.einsum("ni,ni->n", normal, axis)  # between normal and spindle
    limit = contact_tolerance(cutter)
    # boxes may be too large, not too small: 1.1, 0.1 and 1.5 below are margins for the spacing of samples (assumed)
    # on a plane a tool of radius R enters up to the gap h within √(2Rh) of the contact: the height of a chord
    spread = _SPREAD_FACTOR * np.sqrt(2.0 * cutter.radius * gap) + gap + np.minimum(offset, 1.5 * limit)
    low, high = (centre + cutter.radius * normal + sign * spread[:, None] for sign in (-1.0, 1.0))
    is_wall = cosine**2 <= 1.0 - WALL_SINE**2
    is_ball = cutter.corner >= cutter.radius
    by_side = cosine < _STEEP_COSINE if is_ball else np.ones(len(cosine), dtype=bool)
    reach = np.minimum(LENGTH_IN_RADII * cutter.radius, cutter.corner + (gap + limit) / np.maximum(cosine, 1e-6))
    middle = np.where(is_wall[:, None], centre + cutter.radius * normal, centre)
    lateral = np.where(is_wall, spread + limit, 1.1 * cutter.radius + gap)
    half = lateral[:, None] * np.sqrt(np.maximum(1.0 - axis**2, 0.0)) + 0.1 * cutter.radius
    ends = np.stack([cutter.corner - limit - reach, cutter.corner + gap])[..., None] * axis
    low = np.where(by_side[:, None], middle - half + ends.min(axis=0), low)
    high = np.where(by_side[:, None], middle + half + ends.max(axis=0), high)
    out_of_reach = ~by_side & (offset > 1.5 * limit)  # no sample is close enough to count as touching
    return low, np.where(out_of_reach[:, None], -np.inf, high)


class _Grid(Struct, frozen=True, eq=False):
    """Points in cubic cells, sorted by cell.

    :param order: (S,) points by cell, and cell_number: (S,) the number of the cell of each, ascending.
    :param corner: (3,) of the first cell [m]; size: of a cell [m]; shape: (3,) number of cells.
    """

    order: Ints
    cell_number: Ints
    corner: Array
    size: float
    shape: Ints

    @classmethod
    def of(cls, point: Array, size: float) -> _Grid:
        """Sort points (n, 3) into cubic cells of a size [m]."""
        corner = point.min(axis=0)
        cell = np.floor((point - corner) / size).astype(np.int64)
        shape = cell.max(axis=0) + 1
        cell_number = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]  # z varies fastest
        order = np.argsort(cell_number, kind="stable")
        return cls(order, cell_number[order], corner, size, shape)

    def points_in_boxes(self, low: Array, high: Array) -> tuple[Ints, Ints]:
        """Return box and point (P,) of the points in the cells that boxes (n, 3) touch."""
        first = np.maximum(np.floor((low - self.corner) / self.size), 0.0).astype(np.int64)
        last = np.clip(np.floor((high - self.corner) / self.size), -1.0, self.shape - 1.0).astype(np.int64)
        size = np.maximum(last - first + 1, 0)
        columns = np.where(size[:, 2] > 0, size[:, 0] * size[:, 1], 0)
        box = np.repeat(np.arange(len(low)), columns)
        # a column of cells along z has consecutive numbers: one search at each end of it finds all its points
        column = ragged_range(columns)
        x, y = first[box, 0] + column // size[box, 1], first[box, 1] + column % size[box, 1]
        lowest_cell = (x * self.shape[1] + y) * self.shape[2]  # number of the cell at z = 0 of each column
        begin = np.searchsorted(self.cell_number, lowest_cell + first[box, 2])
        count = np.searchsorted(self.cell_number, lowest_cell + last[box, 2], side="right") - begin
        return np.repeat(box, count), self.order[np.repeat(begin, count) + ragged_range(count)]
