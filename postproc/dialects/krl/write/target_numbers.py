"""Targets as the numbers that will be printed, and the components that the text must have."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from msgspec import Struct

from postproc.decimals import decimal_text, without_negative_zero
from postproc.dialects.krl.language.positions import CARTESIAN, LARGEST_B
from postproc.dialects.krl.language.values import Number
from postproc.dialects.krl.layout import FREE, IGNORE, ORIENTATIONS, Layout, Offsets
from postproc.frames import MM_PER_M, Array, any_column
from postproc.program import Bools, Ints, Targets

DECIMALS = np.array([4, 4, 4, 5, 5, 5])
"""Smallest number of decimals of X, Y, Z [mm] and A, B, C [deg]: 0.1 µm and, at a lever of 1 m, 0.2 µm."""
MOST_DECIMALS = 9
"""Largest number of decimals that numbers of the program keep: a picometre."""
_UPRIGHT_TOLERANCE = 1e-6
"""B closer than this to ±90° [deg] counts as ±90°: any choice of A then turns the tool by less than 1e-7 rad."""
_NUMBER_TOLERANCE = 1e-9
"""Numbers closer than this [mm, deg] are printed as the same text."""


class TargetNumbers(Struct, frozen=True, eq=False):
    """K targets as the text will command them.

    :param numbers: (K, 6) X, Y, Z [mm], A, B, C [deg]: rounded as printed; for kept targets, the numbers of the text.
    :param decimals: (K, 6) decimals to print.
    :param least_decimals: (K, 6) decimals to print even if they are zeros.
    :param is_printed: (K, 6) True where a number is printed. Kept target: components that the text lacks and must get.
        Changed target: these, and the components that the text has.
    :param via: (K, 3) auxiliary points [mm], rounded to 4 decimals; NaN for other motions than circles.
    :param is_changed: (K,) True where the text of the target changes.
    :param start_differs: (M,) True where the motion begins at another point than in the input.
    :param is_free: (M,) True where a motion under another `$ORI_TYPE` needs #VAR to reach its orientation.
    :param drops_via_orientation: (M,) True for SCIRC whose auxiliary orientation must not count.
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

    def texts(self, target: int, columns: Iterable[int]) -> dict[str, str]:
        """Return numbers of a target as printed: component → text.

        :param columns: indices in X, Y, Z, A, B, C of the numbers to return.
        """
        numbers, decimals, min_decimals = (
            self.numbers[target].tolist(),
            self.decimals[target].tolist(),
            self.least_decimals[target].tolist(),
        )
        return {
            CARTESIAN[column]: fixed_point(numbers[column], decimals[column], min_decimals[column])
            for column in columns
        }

    def via_texts(self, target: int) -> dict[str, str]:
        """Return X, Y, Z of the auxiliary point of a target as printed: component → text; empty without a point."""
        via = self.via[target].tolist()
        return {} if np.isnan(via).any() else {name: f"{value:.4f}" for name, value in zip("XYZ", via, strict=True)}


def target_numbers(layout: Layout, targets: Targets) -> TargetNumbers:
    """Return the numbers to print for the targets of a program.

    :param layout: text of its M motions.
    :param targets: K commanded targets.
    """
    motion = targets.motion
    # the last target of each motion is written in its statement; the others are inserted lines
    is_last = np.append(motion[1:] != motion[:-1], True) if len(motion) else np.zeros(0, dtype=np.bool_)
    keep = targets.keep & is_last  # only a statement can keep its numbers
    exact_numbers = targets.pose.xyzabc(slice(None))
    exact_numbers[:, 3:] = _nearest_angles(exact_numbers[:, 3:], layout.numbers[motion, 3:])
    decimals = np.maximum(DECIMALS, np.minimum(_input_decimals(layout)[motion], MOST_DECIMALS))
    numbers = np.where(keep[:, None], layout.numbers[motion], _round_values(exact_numbers, decimals))

    end_differs = any_column(np.abs(numbers - layout.numbers[motion]) > _NUMBER_TOLERANCE)
    start_differs = _starts_at_changed_end(motion[is_last], end_differs[is_last], layout)
    is_free = _needs_free_orientation(layout, targets, numbers, is_last)
    gets_component = _added_components(layout, motion, numbers, is_free)
    return TargetNumbers(
        numbers=numbers,
        decimals=np.where(keep[:, None], MOST_DECIMALS, decimals).astype(np.int8),
        least_decimals=np.where(keep[:, None], DECIMALS, decimals).astype(np.int8),
        is_printed=np.where(keep[:, None], gets_component, ~layout.is_missing[motion] | gets_component),
        via=_round_values(targets.via * MM_PER_M, DECIMALS[:3]),
        is_changed=~keep | any_column(gets_component),
        start_differs=start_differs,
        is_free=is_free,
        drops_via_orientation=_loses_auxiliary_orientation(layout, start_differs, targets),
    )


def _added_components(layout: Layout, motion: Ints, numbers: Array, is_free: Bools) -> Bools:
    """Return whether a component (K, 6) of a target is missing in the text of its motion and must be added.

    The controller takes a missing component from the target before; it must be added if this is another number.

    :param motion: (K,) motions of the targets.
    :param numbers: (K, 6) X, Y, Z [mm], A, B, C [deg] to be commanded.
    :param is_free: (M,) True for motions that get ``$ORI_TYPE=#VAR``, so that their A, B, C count.
    """
    previous = np.concatenate([numbers[:1], numbers[:-1]])  # numbers of the target before
    is_first = np.append(True, motion[1:] != motion[:-1])[: len(motion)]  # of its motion; empty without targets
    follows_joints = is_first & layout.starts_from_joints[motion]
    # behind joint angles, missing components are those of the unchanged robot position
    previous[follows_joints] = layout.numbers[motion[follows_joints]]
    is_added = layout.is_missing[motion] & (np.abs(numbers - previous) > _NUMBER_TOLERANCE)
    lacks_orientation = layout.ignores_orientation | any_column(layout.is_missing[:, 3:])
    is_added[:, 3:] |= (is_free & lacks_orientation)[motion, None]
    # only some angles are given: beyond B = ±90° the controller may keep the others from the second set of A, B, C
    is_kept = layout.is_missing[motion, 3:] & ~is_added[:, 3:]
    is_mixed = any_column(is_kept) & ~is_kept.all(axis=1) & (np.abs(previous[:, 4]) > LARGEST_B)
    is_added[:, 3:] |= is_kept & is_mixed[:, None]
    return np.asarray(is_added)


def _needs_free_orientation(layout: Layout, targets: Targets, numbers: Array, is_last: Bools) -> Bools:
    """Return whether a motion (M,) under another `$ORI_TYPE` than #VAR needs #VAR to reach its orientation.

    Under #CONSTANT, #IGNORE and #JOINT the controller does not turn the tool to A, B, C as it does under #VAR.

    :param numbers: (K, 6) X, Y, Z [mm], A, B, C [deg] to be commanded.
    :param is_last: (K,) True for the last target of each motion.
    """
    motion, keeps_text = targets.motion, targets.keep & is_last
    orientation_differs = any_column(np.abs(numbers - layout.numbers[motion])[:, 3:] > _NUMBER_TOLERANCE)
    is_free = _starts_at_changed_end(motion[is_last], orientation_differs[is_last], layout)
    is_free[motion[orientation_differs | (layout.turns_with_path[motion] & ~keeps_text)]] = True
    # under #IGNORE the controller chooses the orientation at the end, at which the next motion begins
    ignores_angles = layout.orientation == ORIENTATIONS.index(IGNORE)
    is_free[:-1] |= ignores_angles[:-1] & is_free[1:]
    is_free &= layout.orientation != ORIENTATIONS.index(FREE)
    return is_free


def _loses_auxiliary_orientation(layout: Layout, start_differs: Bools, targets: Targets) -> Bools:
    """Return whether a motion (M,) is a corrected or divided circle whose auxiliary A, B, C must not count.

    They are orientations along the circle as it was programmed.

    :param start_differs: (M,) True for motions that begin at another point than in the input.
    """
    is_corrected = start_differs.copy()
    is_corrected[targets.motion[~targets.keep]] = True
    return np.asarray(is_corrected & layout.drops_via_orientation)


def _starts_at_changed_end(motion: Ints, end_differs: Bools, layout: Layout) -> Bools:
    """Return whether a motion (M,) begins at the changed end of the motion before it.

    Motions that follow joint angles begin at an unchanged position.

    :param motion: (n,) motions with targets.
    :param end_differs: (n,) True where the end of the motion has changed.
    """
    start_differs = np.zeros(len(layout.trace_row), dtype=np.bool_)
    next_motion = motion + 1
    has_next = next_motion < len(start_differs)
    start_differs[next_motion[has_next]] = end_differs[has_next]
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
    """Return values (n, c) without negative zeros, rounded to numbers of decimals: (c,) or (n, c)."""
    scale = 10.0**decimals
    return without_negative_zero(np.rint(values * scale) / scale)


def _nearest_angles(abc: Array, reference: Array) -> Array:
    """Return A, B, C (K, 3) [deg] of orientations, chosen as close as possible to reference angles.

    (A, B, C) and (A + 180°, 180° − B, C + 180°) are the same orientation, and each angle may change by 360°. At
    B = ±90° only A ∓ C is determined, so that A can be that of the reference. An angle beyond ±180° is returned only if
    the reference angle is beyond ±180°.

    :param abc: (K, 3) A, B, C of the orientations [deg].
    :param reference: (K, 3) reference angles [deg].
    """
    a, b, c = abc.T
    is_upright = np.abs(np.abs(b) - 90.0) < _UPRIGHT_TOLERANCE
    turn = np.where(is_upright, reference[:, 0] - a, 0.0)
    a, c = a + turn, c + np.sign(b) * turn
    first_triple, second_triple = (
        triple + 360.0 * np.rint((reference - triple) / 360.0)
        for triple in (np.stack([a, b, c], axis=1), np.stack([a + 180.0, 180.0 - b, c + 180.0], axis=1))
    )
    first_distance, second_distance = (
        ((triple - reference) ** 2).sum(axis=1) for triple in (first_triple, second_triple)
    )
    is_second_nearer = first_distance > second_distance + _NUMBER_TOLERANCE
    nearest_triple = np.where(is_second_nearer[:, None], second_triple, first_triple)
    is_out_of_range = (np.abs(nearest_triple) > 180.0) & (np.abs(reference) <= 180.0)
    return np.asarray(np.where(is_out_of_range, nearest_triple - 360.0 * np.sign(nearest_triple), nearest_triple))


def _input_decimals(layout: Layout) -> Ints:
    """Return the number of decimals (M, 6) of X … C of M motions in the input; 0 where the text has no number."""
    trace, spans = layout.execution.trace, layout.spans(slice(None), slice(6))
    for elements in layout.elements:
        spans[elements.row] = -1  # offsets in another file: handled below
    decimals = np.zeros(spans.shape[:2], dtype=np.int64)
    file = trace.file[layout.trace_row - 1]
    for index, source in enumerate(trace.sources):
        decimals[file == index] = _decimals_in(source.text, spans[file == index])
    for elements in layout.elements:
        decimals[elements.row] = _decimals_in(elements.source.text, layout.spans(elements.row, slice(6)))
    for motion, move in layout.statements.items():
        aggregate = move.end.position.aggregate
        if aggregate is not None and not move.end.position.is_axis:
            for column, name in enumerate(CARTESIAN):
                item = aggregate.items.get(name)
                if isinstance(item, Number):
                    mantissa = aggregate.source.text[item.start : item.stop].upper().partition("E")[0]
                    decimals[motion, column] = len(mantissa.partition(".")[2])
    return decimals


def _decimals_in(text: str, spans: Offsets) -> Ints:
    """Return the number of decimals (…) of the numbers at spans (…, 2) of a text; 0 where the span is −1."""
    codes = np.frombuffer(text.encode("ascii", "replace"), dtype=np.uint8)
    start, stop = spans[..., 0].astype(np.int64), spans[..., 1].astype(np.int64)
    point = _next_offsets(codes == ord("."), start)
    is_exponent = (codes == ord("e")) | (codes == ord("E"))
    digits_end = np.minimum(_next_offsets(is_exponent, start), stop)
    return np.where((start >= 0) & (point < stop), digits_end - point - 1, 0)


def _next_offsets(is_sought: Bools, offsets: Ints) -> Ints:
    """Return the offset of the first sought character at or behind each offset; T if there is none.

    :param is_sought: (T,) True for the sought characters of a text.
    :param offsets: offsets in the text; the result has their shape.
    """
    # T at the end is the result for offsets behind the last sought character
    sought_offsets = np.append(np.flatnonzero(is_sought), len(is_sought))
    return sought_offsets[np.searchsorted(sought_offsets, offsets)]
