"""Targets as the numbers that will be printed, and what a text must say for the controller to get them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from msgspec import Struct

from postproc.chunks import in_chunks
from postproc.decimals import decimal_text, without_negative_zero
from postproc.dialects.krl.language.positions import CARTESIAN, LARGEST_B
from postproc.dialects.krl.language.values import Number
from postproc.dialects.krl.layout import FREE, IGNORE, ORIENTATIONS, Layout, Offsets
from postproc.frames import MM_PER_M, Array, any_column
from postproc.program import Bools, Ints, Targets

DECIMALS = np.array([4, 4, 4, 5, 5, 5])
"""Least decimals of X, Y, Z [mm] and A, B, C [deg]: 0.1 µm and, at a lever of 1 m, 0.2 µm."""
MOST_DECIMALS = 9
"""Decimals that numbers of the program may keep: a picometre."""
_UPRIGHT = 1e-6
"""B closer than this to ±90° [deg] is ±90°: choosing A freely then turns the tool by less than 1e-7 rad."""
_EQUAL = 1e-9
"""Numbers closer than this are the same text."""


class TargetNumbers(Struct, frozen=True, eq=False):
    """K targets as text will command them.

    :param numbers: (K, 6) X, Y, Z [mm], A, B, C [deg], rounded as printed; of kept targets as in the text.
    :param decimals: (K, 6) decimals to print.
    :param least_decimals: (K, 6) decimals to print even if they are zeros.
    :param is_printed: (K, 6) True where a number is to be printed: for a changed target the components that its text
        gives, and of the missing ones those that the controller would not get right; for a kept one only the latter.
    :param via: (K, 3) auxiliary points [mm], rounded to 4 decimals; NaN where there are none.
    :param is_changed: (K,) True where the target's text or statement changes.
    :param start_differs: (M,) True where the motion before ends elsewhere than in the input.
    :param is_free: (M,) True where the orientation of a motion under another `$ORI_TYPE` must be led to its own.
    :param drops_via_orientation: (M,) True where the auxiliary orientation of a SCIRC must not count.
    """

    numbers: Array
    decimals: Ints
    least_decimals: Ints
    is_printed: Bools
    via: Array
    is_changed: Bools
    start_differs: Bools
    is_free: Bools
    drops_via_orientation: Bools

    def texts(self, k: int, columns: Iterable[int]) -> dict[str, str]:
        """Return the numbers of target `k` as printed, by component.

        :param columns: which of its six numbers.
        """
        numbers, decimals, min_decimals = (
            self.numbers[k].tolist(),
            self.decimals[k].tolist(),
            self.least_decimals[k].tolist(),
        )
        return {
            CARTESIAN[column]: fixed_point(numbers[column], decimals[column], min_decimals[column])
            for column in columns
        }

    def via_texts(self, k: int) -> dict[str, str]:
        """Return X, Y, Z of the auxiliary point of a target as printed; empty if it has none."""
        via = self.via[k].tolist()
        return {} if np.isnan(via).any() else {name: f"{value:.4f}" for name, value in zip("XYZ", via, strict=True)}


def target_numbers(layout: Layout, targets: Targets) -> TargetNumbers:
    """Return the numbers to print for the targets of a program.

    :param layout: text of its M motions.
    :param targets: K commanded targets.
    """
    row = targets.motion
    is_last = np.append(row[1:] != row[:-1], True) if len(row) else np.zeros(0, dtype=np.bool_)
    keep = targets.keep & is_last
    (exact_numbers,) = in_chunks(lambda rows: (targets.pose.xyzabc(rows),), np.arange(len(row)))
    exact_numbers[:, 3:] = _nearest_angles(exact_numbers[:, 3:], layout.numbers[row, 3:])
    decimals = np.maximum(DECIMALS, np.minimum(_input_decimals(layout)[row], MOST_DECIMALS))
    numbers = np.where(keep[:, None], layout.numbers[row], _round_values(exact_numbers, decimals))

    end_differs = any_column(np.abs(numbers - layout.numbers[row]) > _EQUAL)
    start_differs = _starts_at_changed_end(row[is_last], end_differs[is_last], layout)
    is_free = _freed_motions(layout, targets, numbers, is_last)
    gets_component = _added_components(layout, row, numbers, is_free)
    return TargetNumbers(
        numbers=numbers,
        decimals=np.where(keep[:, None], MOST_DECIMALS, decimals).astype(np.int8),
        least_decimals=np.where(keep[:, None], DECIMALS, decimals).astype(np.int8),
        is_printed=np.where(keep[:, None], gets_component, ~layout.is_missing[row] | gets_component),
        via=_round_values(targets.via * MM_PER_M, DECIMALS[:3]),
        is_changed=~keep | any_column(gets_component),
        start_differs=start_differs,
        is_free=is_free,
        drops_via_orientation=_loses_auxiliary_orientation(layout, start_differs, targets),
    )


def _added_components(layout: Layout, row: Ints, numbers: Array, is_free: Bools) -> Bools:
    """Return which components (K, 6) the text lacks and must get, since the controller would not get them right.

    A controller takes missing components from the target before.

    :param row: (K,) motions of the targets.
    :param numbers: (K, 6) X, Y, Z [mm], A, B, C [deg] to be commanded.
    :param is_free: (M,) see `TargetNumbers`.
    """
    previous = np.concatenate([numbers[:1], numbers[:-1]])
    is_first = np.append(True, row[1:] != row[:-1])[: len(row)]
    follows_joints = is_first & layout.starts_from_joints[row]
    previous[follows_joints] = layout.numbers[row[follows_joints]]
    is_added = layout.is_missing[row] & (np.abs(numbers - previous) > _EQUAL)
    lacks_orientation = layout.ignores_orientation | any_column(layout.is_missing[:, 3:])
    is_added[:, 3:] |= (is_free & lacks_orientation)[row, None]
    # some angles given, others kept: near B = ±90° those that are kept may be of another set of A, B, C
    is_kept = layout.is_missing[row, 3:] & ~is_added[:, 3:]
    is_mixed = any_column(is_kept) & ~is_kept.all(axis=1) & (np.abs(previous[:, 4]) > LARGEST_B)
    is_added[:, 3:] |= is_kept & is_mixed[:, None]
    return np.asarray(is_added)


def _freed_motions(layout: Layout, targets: Targets, numbers: Array, is_last: Bools) -> Bools:
    """Return which motions (M,) under another `$ORI_TYPE` than #VAR must be led to their own orientation.

    :param numbers: (K, 6) X, Y, Z [mm], A, B, C [deg] to be commanded.
    :param is_last: (K,) True for the last target of each motion.
    """
    row, keep = targets.motion, targets.keep & is_last
    orientation_differs = any_column(np.abs(numbers - layout.numbers[row])[:, 3:] > _EQUAL)
    is_free = _starts_at_changed_end(row[is_last], orientation_differs[is_last], layout)
    is_free[row[orientation_differs | (layout.turns_with_path[row] & ~keep)]] = True
    # under #IGNORE the controller must not choose the orientation at which the next motion starts, either
    ignores_angles = layout.orientation == ORIENTATIONS.index(IGNORE)
    is_free[:-1] |= ignores_angles[:-1] & is_free[1:]
    is_free &= layout.orientation != ORIENTATIONS.index(FREE)
    return is_free


def _loses_auxiliary_orientation(layout: Layout, start_differs: Bools, targets: Targets) -> Bools:
    """Return which circles (M,) are corrected or divided, so that A, B, C of their auxiliary points must not count.

    :param start_differs: (M,) motions that begin elsewhere than in the program as read.
    """
    is_other_circle = start_differs.copy()
    is_other_circle[targets.motion[~targets.keep]] = True
    return np.asarray(is_other_circle & layout.drops_via_orientation)


def _starts_at_changed_end(row: Ints, end_differs: Bools, layout: Layout) -> Bools:
    """Return which motions (M,) begin at the changed end of another, and depend on it.

    :param row: (n,) rows of motions; `end_differs` (n,) True where their ends have changed.
    """
    start_differs = np.zeros(len(layout.line), dtype=np.bool_)
    follower = row + 1
    has_follower = follower < len(start_differs)
    start_differs[follower[has_follower]] = end_differs[has_follower]
    return np.asarray(start_differs & ~layout.starts_from_joints)


def fixed_point(number: float, decimals: int, min_decimals: int) -> str:
    """Return a number in fixed-point notation; zeros behind `min_decimals` decimals are left out.

    >>> fixed_point(12.5, 9, 4), fixed_point(-0.0, 4, 4)
    ('12.5000', '0.0000')
    """
    text = decimal_text(number, decimals)
    if decimals > min_decimals:
        integer_part, _, places = text.partition(".")
        places = places.rstrip("0").ljust(min_decimals, "0")
        text = f"{integer_part}.{places}" if places else integer_part
    return text


def _round_values(values: Array, decimals: Ints) -> Array:
    """Return `values` rounded to `decimals`, each to those of its own if there are as many; without negative zeros."""
    scale = 10.0**decimals
    return without_negative_zero(np.rint(values * scale) / scale)


def _nearest_angles(abc: Array, reference: Array) -> Array:
    """Return A, B, C (K, 3) [deg] of the same orientations, as close as possible to those of a reference.

    An orientation has two triples, each modulo 360°. At B = ±90° only A ∓ C is determined, so that A may be any. Angles
    beyond ±180° are returned only if the reference has such.

    :param abc: A, B, C (K, 3) of the orientations; `reference` (K, 3) other triples.
    """
    a, b, c = abc.T
    is_upright = np.abs(np.abs(b) - 90.0) < _UPRIGHT
    turn = np.where(is_upright, reference[:, 0] - a, 0.0)
    a, c = a + turn, c + np.sign(b) * turn
    first_triple, second_triple = (
        triple + 360.0 * np.rint((reference - triple) / 360.0)
        for triple in (np.stack([a, b, c], axis=1), np.stack([a + 180.0, 180.0 - b, c + 180.0], axis=1))
    )
    first_distance, second_distance = (
        ((triple - reference) ** 2).sum(axis=1) for triple in (first_triple, second_triple)
    )
    is_second_nearer = first_distance > second_distance + _EQUAL
    nearest_triple = np.where(is_second_nearer[:, None], second_triple, first_triple)
    is_outside = (np.abs(nearest_triple) > 180.0) & (np.abs(reference) <= 180.0)
    return np.asarray(np.where(is_outside, nearest_triple - 360.0 * np.sign(nearest_triple), nearest_triple))


def _input_decimals(layout: Layout) -> Ints:
    """Return the number of decimals (M, 6) that the numbers of M motions have in the input; 0 where there is none."""
    trace, spans = layout.course.trace, layout.spans(slice(None), slice(6))
    for elements in layout.elements:
        spans[elements.row] = -1  # these are offsets in another file, see below
    decimals = np.zeros(spans.shape[:2], dtype=np.int64)
    file = trace.file[layout.line - 1]
    for index, source in enumerate(trace.sources):
        decimals[file == index] = _decimals_in(source.text, spans[file == index])
    for elements in layout.elements:
        decimals[elements.row] = _decimals_in(elements.source.text, layout.spans(elements.row, slice(6)))
    for row, move in layout.statements.items():
        aggregate = move.end.position.aggregate
        if aggregate is not None and not move.end.position.is_axis:
            for column, name in enumerate(CARTESIAN):
                item = aggregate.items.get(name)
                if isinstance(item, Number):
                    mantissa = aggregate.source.text[item.start : item.stop].upper().partition("E")[0]
                    decimals[row, column] = len(mantissa.partition(".")[2])
    return decimals


def _decimals_in(text: str, spans: Offsets) -> Ints:
    """Return the number of decimals of the numbers at some spans (…, 2) of a text; 0 where the span is −1."""
    codes = np.frombuffer(text.encode("ascii", "replace"), dtype=np.uint8)
    start, stop = spans[..., 0].astype(np.int64), spans[..., 1].astype(np.int64)
    point = _next_offsets(codes == ord("."), start)
    is_exponent = (codes == ord("e")) | (codes == ord("E"))
    digits_end = np.minimum(_next_offsets(is_exponent, start), stop)
    return np.where((start >= 0) & (point < stop), digits_end - point - 1, 0)


def _next_offsets(is_sought: Bools, offsets: Ints) -> Ints:
    """Return the offset of the first sought character of a text at or behind each of some offsets.

    :param is_sought: (T,) for each character of the text.
    :param offsets: any shape; so is the result.
    :returns: T where there is none.
    """
    sought_offsets = np.append(np.flatnonzero(is_sought), len(is_sought))
    return sought_offsets[np.searchsorted(sought_offsets, offsets)]
