"""The result of a comparison of two programs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from msgspec import Struct

from postproc import toolpath
from postproc.comparison.paths import Curves
from postproc.errors import Level
from postproc.frames import Array, norm
from postproc.program import SPL, Bools, Ints, Program

TIMES_OFFSET = 3.0
"""A target is on the path within this many times the offsets of the pairs next to it,"""
OFF_PATH = 1e-4
"""and at least within this [m] (assumed)."""


_SPEED_SHARE, _LEAST_SPEED_CHANGE = 1e-3, 1e-6
"""Speeds that differ by less than this share and this [m/s] are equal: texts round them (assumed)."""


class Cuts(Struct, frozen=True, eq=False):
    """Deviations of the loaded tip from the nominal path, by each program under the same force: what each cuts.

    :param wrench: (P, 6) at the tip at each pair, `$BASE` axes of the nominal program [N, N·m].
    :param nominal: (P, 3) tip minus nominal target by the nominal program, its `$BASE` [m].
    :param corrected_deviation: (P, 3) the same by the second program.
    :param rotation: (P,) angle by which the second program turns the loaded tool from its nominal orientation [rad].
    :param row: (B,) rows of `corrected.motions` that are checked between pairs, never decreasing; `t` (B,) where.
        Inserted targets (t = 1) are among them.
    :param nominal_distance: (B,) distance there of the tip from its place on the nominal path by the nominal program
        [m]; `corrected_distance` (B,) distance from that path by the second one.
    :param path_rotation: (B,) angle there by which the second program turns the loaded tool from the nominal path
        [rad], at targets; 0 elsewhere.
    :param length: (B,) arc length of that place on the nominal path [m].
    """

    wrench: Array
    nominal: Array
    corrected_deviation: Array
    rotation: Array
    row: Ints
    t: Array
    nominal_distance: Array
    corrected_distance: Array
    path_rotation: Array
    length: Array


class Difference(Struct, frozen=True):
    """A difference besides offsets, or a place that could not be compared.

    :param level: ``"error"``: do not run the second program; ``"warning"``: check it; ``"info"``: for information.
    :param kind: short stable name.
    :param message: one sentence for the user.
    :param nominal: file and line of the first place in the nominal program, if it has one.
    :param corrected: file and line in the second program; None: the second program has no such place.
    :param count: number of places.
    """

    level: Level
    kind: str
    message: str
    nominal: tuple[str, int] | None = None
    corrected: tuple[str, int] | None = None
    count: int = 1


class Comparison(Struct, frozen=True, eq=False, dict=True):
    """The targets of two programs. Row i of the arrays of pairs is the same pair; SI units.

    :param nominal: the first program.
    :param corrected: the second.
    :param robot: name of the robot model.
    :param pair: (P, 2) rows of `nominal.motions` and of `corrected.motions`, in order.
    :param inserted_rows: rows of `corrected.motions` on the path between two pairs.
    :param passed_rows: rows of `nominal.motions` without a partner that the second path passes; `passing_distance` (n,)
        how near [m], NaN for PTP.
    :param only_nominal: rows of `nominal.motions` that are missing; `missing_distance` (n,) by how much the second path
        misses each [m], NaN for PTP.
    :param additional_rows: rows of `corrected.motions` without a partner that are not on the path.
    :param pose: (P, 4, 4) where the second program commands the nominal program's tool, in the nominal `$BASE` [m].
    :param rotation: (P,) angle between the two orientations [rad].
    :param path_length: (M,) length of the path of each motion of `nominal` [m]; 0 of PTP.
    :param curves: both paths between the pairs; None for less than two.
    :param path_distance: (P,) largest distance of the two paths on the stretch to each pair from the one before, at the
        same share of the stretch [m]; NaN for the first, and where a PTP is between.
    :param cuts: deviations by each program; None without forces.
    :param differences: other differences.
    """

    nominal: Program
    corrected: Program
    robot: str
    pair: Ints
    inserted_rows: Ints
    passed_rows: Ints
    passing_distance: Array
    only_nominal: Ints
    missing_distance: Array
    additional_rows: Ints
    pose: Array
    rotation: Array
    path_length: Array
    curves: Curves | None
    path_distance: Array
    cuts: Cuts | None
    differences: tuple[Difference, ...]

    @property
    def rapid(self) -> Bools:
        """(P,) True for moves without cutting force."""
        return np.asarray(self.nominal.motions.rapid[self.pair[:, 0]])

    @cached_property
    def cut_length(self) -> Array:
        """(P,) length of the nominal cutting path for which each pair stands [m], see `toolpath.cut_lengths`."""
        # True where the force of the pair before goes on; not known without forces: each pair then stands for the path
        # that leads to it
        force_goes_on = np.zeros(len(self.pair), dtype=bool)
        if self.cuts is not None:
            force_goes_on[1:] = (self.cuts.wrench[1:] == self.cuts.wrench[:-1]).all(axis=1)
        motion = self.pair[:, 0]
        motion_ends = np.ones(len(motion))  # place t = 1 on each motion
        return toolpath.cut_lengths(self.nominal.motions, self.path_length, motion, motion_ends, force_goes_on)

    @property
    def target(self) -> Array:
        """(P, 4, 4) nominal targets, `$BASE` [m]."""
        return np.asarray(self.nominal.motions.target[self.pair[:, 0]])

    @property
    def offset(self) -> Array:
        """(P, 3) from the nominal to the commanded position, nominal `$BASE` [m]."""
        return np.asarray(self.pose[:, :3, 3] - self.target[:, :3, 3])

    @property
    def distance(self) -> Array:
        """(P,) length of the offsets [m]."""
        return norm(self.offset)

    @property
    def nominal_feed(self) -> Array:
        """(M,) speeds of the nominal program as its text states them [m/s]; NaN where unknown, as for PTP."""
        return self.nominal.motions.feed if self.nominal.feed_as_read is None else self.nominal.feed_as_read

    @property
    def speeds(self) -> Array:
        """(P, 2) speeds of both programs as their texts state them [m/s]; NaN where unknown, as for PTP."""
        return np.stack([self.nominal_feed[self.pair[:, 0]], self.corrected.motions.feed[self.pair[:, 1]]], 1)

    @property
    def speed_differs(self) -> Bools:
        """(P,) True where the speeds differ by more than rounding; False where one is unknown."""
        nominal_speed, corrected_speed = self.speeds.T
        return np.asarray(
            np.abs(nominal_speed - corrected_speed) > _SPEED_SHARE * np.abs(nominal_speed) + _LEAST_SPEED_CHANGE
        )

    @property
    def spline(self) -> Bools:
        """(P,) True where the stretch to the target is a piece of a spline in both programs: it is not compared."""
        nominal_kind, corrected_kind = (
            self.nominal.motions.kind[self.pair[:, 0]],
            self.corrected.motions.kind[self.pair[:, 1]],
        )
        return np.asarray((nominal_kind == SPL) & (corrected_kind == SPL))


def wrench_in_nominal_base(comparison: Comparison, wrench: Array) -> Array:
    """Return wrenches (P, 6) of the pairs in the axes of the nominal `$BASE` [N, N·m].

    :param wrench: (P, 6) in root axes.
    """
    base_rotation = comparison.nominal.bases[comparison.nominal.motions.base[comparison.pair[:, 0]], :3, :3]
    force_and_moment = wrench.reshape(-1, 2, 3)
    # Rᵀ times each vector: from root axes to those of the base
    return np.asarray(np.einsum("nji,nkj->nki", base_rotation, force_and_moment)).reshape(-1, 6)


def place_of(program: Program, row: int) -> tuple[str, int]:
    """Return the file of motion `row` and its line in it."""
    return program.places(np.array([row])).of(0)


def file_and_line(program: Program, line: int | None) -> tuple[str, int] | None:
    """Return the file and the line in it for a line that an issue of the reader names; None if it names none.

    :param line: line of the whole program, as motions have it; the main file has it if no motion is on it.
    """
    if line is None:
        return None
    rows = np.flatnonzero(program.motions.line == line)
    return place_of(program, rows[0]) if len(rows) else (program.documents[0].name, line)


def first_difference(nominal: Sequence[object], corrected: Sequence[object]) -> int | None:
    """Return the first index at which two sequences differ, the length of the shorter one if it begins the longer.

    None if they are equal.
    """
    if nominal == corrected:
        return None
    pairs = enumerate(zip(nominal, corrected, strict=False))
    return next((k for k, (value, other_value) in pairs if value != other_value), min(len(nominal), len(corrected)))


def difference_at(
    comparison: Comparison, kind: str, message: str, rows: Sequence[int], count: int, level: Level = "warning"
) -> Difference:
    """Return a difference at a motion of each program.

    :param rows: (2,) motion of the nominal and of the second program; −1 where one has none.
    :param count: number of places where the difference is.
    """
    nominal_place, corrected_place = (
        None if row < 0 else place_of(program, row)
        for program, row in zip((comparison.nominal, comparison.corrected), rows, strict=True)
    )
    return Difference(level, kind, message, nominal_place, corrected_place, count)


def pair_warning(comparison: Comparison, kind: str, message: str, pairs: Ints) -> Difference:
    """Return a warning at pairs (n,); the first of them is named."""
    return difference_at(comparison, kind, message, comparison.pair[pairs[0]].tolist(), len(pairs))
