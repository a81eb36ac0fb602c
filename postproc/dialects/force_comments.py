"""Force comments of a written program: their text, and which targets need one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from postproc import decimals
from postproc.decimals import Bytes, Number, Part, without_negative_zero
from postproc.frames import Array
from postproc.program import FORCE_FRAMES, PTP, Bools, ForceNote, Ints, TargetForces

_NAMES = (b"FX", b"FY", b"FZ", b"MX", b"MY", b"MZ")
_DECIMALS = np.array([3, 3, 3, 4, 4, 4])
"""A millinewton moves the tool of a robot by some nanometres."""
_BASE = FORCE_FRAMES.index("BASE")


def round_wrenches(wrench: Array) -> Array:
    """Return wrenches (n, 6) rounded to the decimals of a comment."""
    scale = 10.0**_DECIMALS
    return without_negative_zero(np.rint(wrench * scale) / scale)


def needs_comment(forces: TargetForces, kind: Ints, note: Ints, notes: Sequence[ForceNote], start: float) -> Bools:
    """Return which targets (K,) need a comment: the force differs from the force that holds before the target.

    That force is stated by the nearest comment before the target: one of the program's own `notes`, or a new comment.

    :param kind: (K,) kinds of the targets; PTP targets need no comment, and do not change the force that holds.
    :param note: (K,) index in `notes` of the last note before each target; −1 before the first note.
    :param start: frame code and components before the first comment: 0 = no force; NaN = unknown, so that the first
        target needs a comment.
    """
    states = np.array([(FORCE_FRAMES.index(comment.frame), *comment.wrench) for comment in notes]).reshape(-1, 7)
    # TOOL and FEED axes turn with the path: NaN differs from everything, so that the target after such a note has a
    # comment. Without a load the frame does not matter
    states[:, 0] = np.where(states[:, 1:].any(axis=1) & (states[:, 0] != _BASE), np.nan, _BASE)

    def rounded_states(row: Ints) -> Array:
        """Return frame and wrench (n, 7) of targets (n,), as comments would state them."""
        return np.column_stack([forces.frame[row], round_wrenches(forces.wrench[row])])

    row = np.flatnonzero(kind != PTP)
    state = rounded_states(row)  # code of the frame, then the wrench
    state_before = np.concatenate([np.full((1, state.shape[1]), start), state])[:-1]
    # the program has a note between this target and the one before
    has_note_before = np.diff(note[row], prepend=-1) != 0
    state_before[has_note_before] = states[note[row[has_note_before]]]
    # both are rounded: different values differ by one unit of the last decimal or more; NaN needs a comment
    tolerance = [0.0, *(0.6 * 0.1**_DECIMALS)]
    needs_comment = np.zeros(len(kind), dtype=np.bool_)
    needs_comment[row] = ~(np.abs(state - state_before) <= tolerance).all(axis=1)
    return needs_comment


def columns(comment: bytes, forces: TargetForces, rows: Ints, is_needed: Bools) -> list[Part]:
    """Return the comments of targets, as columns of text (n rows).

    The comment is ``FORCE OFF`` without a load; moments are given only if one of them is not 0.

    :param comment: prefix of a comment, such as ``;``.
    :param rows: (n,) targets, as rows of `forces`.
    :param is_needed: (n,) False for targets that get no comment: their row stays empty.
    """
    wrench, frame = round_wrenches(forces.wrench[rows]), forces.frame[rows]
    has_load = is_needed & wrench.any(axis=1)
    has_moment = has_load & wrench[:, 3:].any(axis=1)
    parts: list[Part] = [
        text_in_rows(comment + b"FORCE OFF", is_needed & ~has_load),
        text_in_rows(comment + b"FORCE", has_load),
    ]
    # three forces, then three moments
    for name, values, decimal_places, is_given in zip(
        _NAMES, wrench.T, _DECIMALS.tolist(), (has_load,) * 3 + (has_moment,) * 3, strict=True
    ):
        parts += [
            text_in_rows(b" " + name + b"=", is_given),
            Number.of(np.where(is_given, values, np.nan), decimal_places),
        ]
    for code, label in enumerate(FORCE_FRAMES):
        if code != _BASE:  # the default, which is not written
            parts.append(text_in_rows(f" FRAME={label}".encode(), has_load & (frame == code)))
    return parts


def texts(comment: bytes, forces: TargetForces, rows: Ints) -> list[str]:
    """Return the comments of targets (n,), given as rows of `forces`.

    :param comment: prefix of a comment, such as ``;``.
    """
    if not len(rows):
        return []
    return decimals.lines([*columns(comment, forces, rows, np.ones(len(rows), np.bool_)), b"\n"]).decode().splitlines()


def text_in_rows(text: bytes, rows: Bools) -> Bytes:
    """Return a column (n, length) with the text in `rows`, which are True; the other rows are empty (zeros)."""
    return np.where(rows[:, None], np.frombuffer(text, dtype=np.uint8), np.uint8(0)).astype(np.uint8)
