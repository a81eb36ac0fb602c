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
    """Return which targets (K,) need a comment: those whose force is not that of the last comment before them.

    :param kind: (K,) PTP targets carry none, and change nothing.
    :param note: (K,) the last of the program's own `notes` at each target, −1 before the first.
    :param start: values before the first of these: 0, or NaN where they are unknown.
    """
    states = np.array([(FORCE_FRAMES.index(comment.frame), *comment.wrench) for comment in notes]).reshape(-1, 7)
    states[:, 0] = np.where(states[:, 1:].any(axis=1) & (states[:, 0] != _BASE), np.nan, _BASE)  # turns with the path

    def rounded_states(row: Ints) -> Array:
        """Return frame and wrench (n, 7) of targets (n,), as comments would state them."""
        return np.column_stack([forces.frame[row], round_wrenches(forces.wrench[row])])

    row = np.flatnonzero(kind != PTP)
    state = rounded_states(row)
    state_before = np.concatenate([np.full((1, state.shape[1]), start), state])[:-1]
    follows_note = np.diff(note[row], prepend=-1) != 0
    state_before[follows_note] = states[note[row[follows_note]]]
    # both are rounded to the last decimal: different ones differ by a unit of it or more
    tolerance = [0.0, *(0.6 * 0.1**_DECIMALS)]
    needs_comment = np.zeros(len(kind), dtype=np.bool_)
    needs_comment[row] = ~(np.abs(state - state_before) <= tolerance).all(axis=1)
    return needs_comment


def columns(comment: bytes, forces: TargetForces, rows: Ints, is_needed: Bools) -> list[Part]:
    """Return the parts of the comments of some targets (n,); nothing where they are not `is_needed` (n,).

    :param comment: what comments begin with.
    """
    wrench, frame = round_wrenches(forces.wrench[rows]), forces.frame[rows]
    acts = is_needed & wrench.any(axis=1)
    turns = acts & wrench[:, 3:].any(axis=1)
    parts: list[Part] = [
        text_in_rows(comment + b"FORCE OFF", is_needed & ~acts),
        text_in_rows(comment + b"FORCE", acts),
    ]
    for name, values, places, is_given in zip(
        _NAMES, wrench.T, _DECIMALS.tolist(), (acts,) * 3 + (turns,) * 3, strict=True
    ):
        parts += [text_in_rows(b" " + name + b"=", is_given), Number.of(np.where(is_given, values, np.nan), places)]
    for code, label in enumerate(FORCE_FRAMES):
        if code != _BASE:
            parts.append(text_in_rows(f" FRAME={label}".encode(), acts & (frame == code)))
    return parts


def texts(comment: bytes, forces: TargetForces, rows: Ints) -> list[str]:
    """Return the comments of some targets."""
    if not len(rows):
        return []
    return decimals.lines([*columns(comment, forces, rows, np.ones(len(rows), np.bool_)), b"\n"]).decode().splitlines()


def text_in_rows(text: bytes, rows: Bools) -> Bytes:
    """Return a text in some rows and nothing in the others."""
    return np.where(rows[:, None], np.frombuffer(text, dtype=np.uint8), np.uint8(0)).astype(np.uint8)
