"""G2 and G3: centre, axis and angle of arcs and helices, by the rules of LinuxCNC.

What LinuxCNC accepts (its `interp_arc.cc`; verified against `rs274` to nine digits):

- the radii at start and end may differ by 2·√2·0.01 mm (0.001 inch), and beyond that by 0.1 % of the larger one, but
  never by more than a hundred times the first value;
- a radius below 0.00127 mm (0.00005 inch) counts as zero; R may be too short by that much;
- an arc that ends where it began is a full circle with I, J, K, and an error with R.

An offset of zero across the plane (K0 in G17, as FreeCAD writes it) is ignored; LinuxCNC refuses it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.errors import MAX_ERRORS
from postproc.frames import MM_PER_INCH, Array
from postproc.program import Bools, Ints

CENTRE_TOLERANCE = {21.0: 0.02 * np.sqrt(2.0), 20.0: 0.002 * np.sqrt(2.0) * MM_PER_INCH}
"""Difference of start and end radius that is always accepted [mm], by the code of the units."""

RADIUS_TOLERANCE_MM = 0.00127
"""A radius may be shorter than half of the chord by this: 0.00005 inch, as in LinuxCNC."""
_LARGEST_DIFFERENCE_SHARE, _MOST_TOLERANCES = 1e-3, 100.0
"""As in LinuxCNC (interp_arc.cc): beyond the tolerance, radii may differ by a thousandth of the larger one, but by
no more than 100 tolerances."""
_TURNS_TOLERANCE = 1e-3
"""P that differs from a whole number by more is refused (assumed)."""
POINT_TOLERANCE_MM = 1e-6
"""Points closer than this are equal: it covers rounding in incremental programs, far below any resolution."""

PLANE_AXES = {17.0: (0, 1, 2), 18.0: (2, 0, 1), 19.0: (1, 2, 0)}
"""First and second axis of the plane, and the axis about which G3 turns right-handed."""


class ArcWords(Struct, frozen=True, eq=False):
    """Words of A arcs as they are programmed, lengths in mm, in the program frame.

    :param start: (A, 3) start of each arc.
    :param end: (A, 3) end of each arc.
    :param is_programmed: (A, 3) True where the line of the arc has X, Y, Z.
    :param offset: (A, 3) I, J, K; NaN where absent.
    :param radius: (A,) R; NaN where absent.
    :param turns: (A,) P, the number of turns; NaN where absent.
    :param is_clockwise: (A,) True for G2.
    :param plane: (A,) 17, 18 or 19.
    :param units: (A,) 20 or 21.
    :param has_absolute_centre: (A,) True where I, J, K are coordinates (G90.1).
    """

    start: Array
    end: Array
    is_programmed: Bools
    offset: Array
    radius: Array
    turns: Array
    is_clockwise: Bools
    plane: Array
    units: Array
    has_absolute_centre: Bools

    def to_plane(self, vectors: Array) -> Array:
        """Return the components (3, A) of vectors (A, 3): along first and second axis of the plane, and across it."""
        arcs = np.arange(len(vectors))
        return np.array([vectors[arcs, axis] for axis in self._axes().T])

    def from_plane(self, first: Array, second: Array, normal: Array) -> Array:
        """Return vectors (A, 3) from components (A,) along first and second axis of the plane, and across it.

        It is the inverse of `to_plane`.
        """
        vectors = np.empty((len(first), 3))
        np.put_along_axis(vectors, self._axes(), np.stack([first, second, normal], axis=1), axis=1)
        return vectors

    def _axes(self) -> Ints:
        """Return the indices (A, 3) of first and second axis of the plane and of the axis across it."""
        axes_of_planes = np.array([PLANE_AXES[17.0], PLANE_AXES[18.0], PLANE_AXES[19.0]])  # row 0 is that of G17
        return axes_of_planes[self.plane.astype(np.int64) - 17]


class ArcFault(Struct, frozen=True):
    """A fault of an arc.

    :param n: index of the arc.
    :param problem: what is wrong; `advice`: what to do, or None.
    :param depends_on_start: whether the fault may vanish with another start of the arc.
    """

    n: int
    problem: str
    advice: str | None
    depends_on_start: bool


class Arcs(Struct, frozen=True, eq=False):
    """Geometry of A arcs, lengths in mm, in the program frame; see `postproc.program.Motions`.

    :param centre: (A, 3) centre at the height of the start.
    :param normal: (A, 3) unit axis.
    :param sweep: (A,) angle about `normal` [rad], > 0.
    :param faults: faults of single arcs; centre, normal and sweep of an arc with a fault are meaningless.
    """

    centre: Array
    normal: Array
    sweep: Array
    faults: tuple[ArcFault, ...]

    def masked_arcs(self, mask: Bools) -> Arcs:
        """Return the arcs that a mask (A,) marks, without faults."""
        return Arcs(self.centre[mask], self.normal[mask], self.sweep[mask], faults=())


def read_arcs(words: ArcWords) -> Arcs:
    """Return the geometry of arcs, and their faults.

    Suffixes 1 and 2 are components along the first and second axis of the plane: s start, e end, o offset, c centre,
    r centre by R, a from the centre to the start, b from the centre to the end.

    The angle from a to b about the axis is atan2(±(a1·b2 − a2·b1), a1·b1 + a2·b2), with − for G2. It is brought into
    the range above 0 up to 2π; P adds P − 1 whole turns to it.
    """
    with np.errstate(invalid="ignore", divide="ignore"):  # words that are absent are NaN
        s1, s2, height = words.to_plane(words.start)
        e1, e2, _ = words.to_plane(words.end)
        o1, o2, normal_offset = words.to_plane(words.offset)
        is_given_by_radius = np.isnan(o1) & np.isnan(o2) & (np.nan_to_num(normal_offset) == 0.0)
        c1, c2 = (
            np.where(words.has_absolute_centre, 0.0, s1) + np.nan_to_num(o1),
            np.where(words.has_absolute_centre, 0.0, s2) + np.nan_to_num(o2),
        )
        r1, r2 = _centre_from_radius(s1, s2, e1, e2, words)
        c1, c2 = np.where(is_given_by_radius, r1, c1), np.where(is_given_by_radius, r2, c2)

        sign = np.where(words.is_clockwise, -1.0, 1.0)
        a1, a2, b1, b2 = s1 - c1, s2 - c2, e1 - c1, e2 - c2
        angle = np.arctan2(sign * (a1 * b2 - a2 * b1), a1 * b1 + a2 * b2)
        chord = np.hypot(e1 - s1, e2 - s2)
        is_full_circle = chord <= POINT_TOLERANCE_MM
        sweep = np.where(is_full_circle, 2.0 * np.pi, np.where(angle > 0.0, angle, angle + 2.0 * np.pi))
        turns = np.nan_to_num(words.turns, nan=1.0)
        sweep = sweep + 2.0 * np.pi * (np.rint(turns) - 1.0)
        zero = np.zeros_like(sign)
        sizes = _ArcSizes(np.hypot(a1, a2), np.hypot(b1, b2), 0.5 * chord)
        faults = _faults(words, is_given_by_radius, is_full_circle, sizes)
    return Arcs(words.from_plane(c1, c2, height), words.from_plane(zero, zero, sign), sweep, faults)


def _centre_from_radius(s1: Array, s2: Array, e1: Array, e2: Array, words: ArcWords) -> tuple[Array, Array]:
    """Return the centres of arcs given by R, as components (A,) along first and second axis of the plane.

    They are left of the chord for G3, right for G2, and on the other side for R < 0. They are NaN where an arc ends
    where it begins, and at the middle of the chord where R is shorter than half of it.

    Half a chord is (d1, d2), of length h. The centre is at its middle plus √(R² − h²)/h · (−d2, d1), times −1 for the
    right side.

    :param s1, s2: (A,) components of the starts; `e1`, `e2`: (A,) of the ends.
    """
    d1, d2 = 0.5 * (e1 - s1), 0.5 * (e2 - s2)
    half_chord = np.hypot(d1, d2)
    radius = np.abs(words.radius)
    distance_to_chord = np.sqrt(np.maximum((radius - half_chord) * (radius + half_chord), 0.0))
    ratio = distance_to_chord / half_chord
    left = np.where(words.is_clockwise, -ratio, ratio) * np.sign(words.radius)  # in half chords; right is negative
    return s1 + d1 - left * d2, s2 + d2 + left * d1


class _ArcSizes(NamedTuple):
    """Radii (A,) of arcs at their starts and at their ends, and half lengths (A,) of their chords [mm]."""

    start_radius: Array
    end_radius: Array
    half_chord: Array


class _Check(NamedTuple):
    """A check of arcs.

    :param is_wrong: (A,) arcs that fail it.
    :param problem: text with the names of sizes in braces, as `_faults` fills them in.
    :param advice: what to do, or None.
    """

    is_wrong: Bools
    problem: str
    advice: str | None = None


_FULL_CIRCLE = "Give a full circle by I, J, K."


def _faults(
    words: ArcWords, is_given_by_radius: Bools, is_full_circle: Bools, sizes: _ArcSizes
) -> tuple[ArcFault, ...]:
    """Return the first fault of each arc that has one.

    Of each kind of fault at most `MAX_ERRORS` + 1 arcs are listed, since no more are shown. Faults of words precede
    faults of sizes.

    :param is_given_by_radius: (A,) arcs given by R.
    :param is_full_circle: (A,) arcs that end where they begin.
    :param sizes: radii and half chords, which problems name.
    """
    faults: dict[int, ArcFault] = {}
    for checks, depends_on_start in (
        (_word_checks(words, is_given_by_radius), False),
        (_size_checks(words, is_given_by_radius, is_full_circle, sizes), True),
    ):
        for check in checks:
            for n in np.flatnonzero(check.is_wrong)[: MAX_ERRORS + 1].tolist():
                r1, r2, half_chord = (float(size[n]) for size in sizes)
                values = {"r1": r1, "r2": r2, "least": half_chord, "radius": abs(words.radius[n])}
                faults.setdefault(n, ArcFault(n, check.problem.format(**values), check.advice, depends_on_start))
    return tuple(faults.values())


def _word_checks(words: ArcWords, is_given_by_radius: Bools) -> Iterator[_Check]:
    """Yield the checks of the words of arcs, which do not depend on where an arc begins.

    :param is_given_by_radius: (A,) arcs given by R.
    """
    has_radius = ~np.isnan(words.radius)
    o1, o2, normal_offset = words.to_plane(words.offset)
    has_end = words.to_plane(words.is_programmed.astype(float))[:2].any(axis=0)
    yield _Check(
        np.nan_to_num(normal_offset) != 0.0,
        "arc with an offset across its plane",
        "G17 takes I and J, G18 I and K, G19 J and K.",
    )
    yield _Check(
        is_given_by_radius & ~has_radius, "arc without I, J, K or R", "If a straight move is meant, write G0 or G1."
    )
    yield _Check(~is_given_by_radius & has_radius, "arc with R and with I, J or K", "Give one or the other.")
    yield _Check(
        ~is_given_by_radius & words.has_absolute_centre & (np.isnan(o1) | np.isnan(o2)),
        "arc with an incomplete absolute centre",
        "With G90.1 both coordinates of the centre are needed.",
    )
    # an arc without P (NaN) passes both checks
    yield _Check(np.abs(np.rint(words.turns) - words.turns) > _TURNS_TOLERANCE, "P of an arc is not a whole number")
    yield _Check(np.rint(words.turns) < 1.0, "P of an arc is below 1")
    yield _Check(is_given_by_radius & ~has_end, "arc with R but without an end point in its plane", _FULL_CIRCLE)


def _size_checks(
    words: ArcWords, is_given_by_radius: Bools, is_full_circle: Bools, sizes: _ArcSizes
) -> Iterator[_Check]:
    """Yield the checks of sizes, which depend on the starts of arcs, by the tolerances of LinuxCNC.

    :param is_given_by_radius: (A,) arcs given by R.
    :param is_full_circle: (A,) arcs that end where they begin.
    :param sizes: radii and half chords of the arcs.
    """
    r1, r2, half_chord = sizes
    difference, larger = np.abs(r1 - r2), np.maximum(r1, r2)
    tolerance = np.where(words.units == 20.0, CENTRE_TOLERANCE[20.0], CENTRE_TOLERANCE[21.0])
    yield _Check(is_given_by_radius & is_full_circle, "arc with R that ends where it begins", _FULL_CIRCLE)
    yield _Check(
        is_given_by_radius & (half_chord - np.abs(words.radius) > RADIUS_TOLERANCE_MM),
        "R too small to reach the end point: {radius:.4f} mm where {least:.4f} mm is the least",
    )
    yield _Check(np.minimum(r1, r2) < RADIUS_TOLERANCE_MM, "arc with radius zero")
    yield _Check(
        ~is_given_by_radius
        & (
            (difference > _MOST_TOLERANCES * tolerance)
            | ((difference > tolerance) & (difference > _LARGEST_DIFFERENCE_SHARE * larger))
        ),
        "radii of the arc disagree: {r1:.4f} mm at the start, {r2:.4f} mm at the end",
        "Check the centre, G90.1/G91.1 and the plane (G17, G18, G19).",
    )
