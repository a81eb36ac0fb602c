"""The written program read back by our own reader, as if somebody else had written it."""

from __future__ import annotations

import gc

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import toolpath
from postproc.chunks import in_chunks
from postproc.correction.targets import Chosen
from postproc.dialects import registry
from postproc.errors import Issue, PostprocError, ProgramError
from postproc.frames import Array, angle_between, largest, twist_between
from postproc.program import Bools, Ints, Program, Targets, Written
from postproc.toolpath import Segments
from postproc.under_load import PathUnderLoad

_PRINTED = 1e-6
"""What printing may move a commanded pose by [m, rad], or change a speed by [m/s]; the text has at least 1e-4 mm,
1e-5° and 1e-3 mm/s."""

LARGE_TEXT = 200_000
"""Characters of a program after whose reading memory is released at once."""


class UnusableTextError(PostprocError):
    """The written program must not be released; `issue` says why."""

    def __init__(self, issue: Issue) -> None:
        super().__init__(issue.message)
        self.issue = issue


class ReadBack(Struct, frozen=True, eq=False):
    """A written program of K targets as its text says.

    :param text: as written.
    :param program: as read, without its text.
    :param segments: the geometry of its motions.
    :param row: (K,) motion that ends at each target.
    :param numbers: (K, 6) X, Y, Z, A, B, C as printed in the text [mm, deg].
    """

    text: Written
    program: Program
    segments: Segments
    row: Ints
    numbers: Array


def read_back(path: PathUnderLoad, chosen: Chosen, text: Written) -> ReadBack:
    """Read a written program, and see that it says what was to be written.

    :raises UnusableTextError: it cannot be read, or says something else.
    """
    setting, targets = path.setting, chosen.targets
    try:
        reader = registry.by_name(text.dialect)
        written = reader.read(text.documents, setting.cell, setting.forward, path.program.name)
    except ProgramError as cause:
        message = (
            f"the written program cannot be read back ({cause.problem}: {cause.text or ''!r}). If this is a line of "
            f"[gcode] in the cell, write it there in {text.dialect}; else it is a fault of postproc, please report it."
        )
        raise UnusableTextError(Issue("error", "read-back", message, output_line=cause.line)) from cause
    row = np.flatnonzero(np.isnan(written.motions.joints[:, 0]))
    mismatch = _mismatch(path.program, targets, written, row)
    if mismatch is not None:
        raise UnusableTextError(mismatch)
    numbers = written.numbers_as_written()[row]
    written = replace(written, documents=(), layout=None)
    if text.size > LARGE_TEXT:
        gc.collect()
    return ReadBack(text, written, toolpath.segments(written, setting.start_flange), row, numbers)


def _carried_elsewhere(program: Program, targets: Targets, written: Program, row: Ints) -> Bools:
    """Return which targets (K,) have the robot carried elsewhere than they were to have."""
    if program.carriage is None or written.carriage is None:
        return np.full(len(targets), program.carriage is not written.carriage)
    wanted = program.carriage.at(targets.motion, targets.t)
    return np.asarray(np.abs(written.carriage.at(row) - wanted) > _PRINTED)


def _mismatch(program: Program, targets: Targets, written: Program, row: Ints) -> Issue | None:
    """Return an issue if the text does not say what it was to say."""
    m, nominal = written.motions, program.motions
    if len(row) != len(targets):
        return Issue("error", "read-back", f"the written program has {len(row)} targets instead of {len(targets)}")

    def apart(row: Ints, pose: Array) -> tuple[Array]:
        read = m.target.take(row, axis=0)
        return (np.maximum(largest(read[:, :3, 3] - pose[:, :3, 3]), angle_between(read[:, :3, :3], pose[:, :3, :3])),)

    wrong = (m.kind[row] != targets.kind) | (in_chunks(apart, row, targets.pose)[0] > _PRINTED)
    for frames, other, used, wanted in (
        (written.bases, program.bases, m.base[row], nominal.base[targets.motion]),
        (written.tools, program.tools, m.tool[row], nominal.tool[targets.motion]),
    ):
        differ = np.abs(twist_between(frames[:, None], other[None])).max(axis=2) > _PRINTED
        wrong |= differ[used, wanted]
    wrong |= np.abs(m.feed[row] - nominal.feed[targets.motion]) > _PRINTED  # of PTP it is NaN, which is not more
    wrong |= _carried_elsewhere(program, targets, written, row)
    if wrong.any():
        first = int(np.argmax(wrong))
        line = int(program.motions.line[targets.motion[first]])
        return Issue(
            "error",
            "read-back",
            "the written program reads differently from what was computed: a fault of postproc, please report it",
            source_line=line,
            count=int(wrong.sum()),
        )
    return None
