"""What is to be done with several programs, and what came of each."""

from __future__ import annotations

from pathlib import Path

from msgspec import Struct

from postproc.correction import Mode
from postproc.errors import Issue
from postproc.report import Summary

GOOD, FAILED, EXCEEDED = 0, 1, 3
"""Exit codes of one program."""


class Settings(Struct, frozen=True):
    """What is to be done with every program.

    :param cell: cell file.
    :param mode: see `correction.process`.
    :param tolerance_mm: replaces that of the cell; what the written program exceeds it by is told by the exit code.
    :param part_tolerance_mm: what the part may be off, 95 %; replaces that of the cell.
    :param lines_per_file: replaces that of the cell.
    :param linearize_arcs: write arcs as lines.
    :param keep_unresolved: leave motions of KRL as they are that only the running robot knows.
    :param part: mesh of the part, whose surface is looked at; None = none.
    :param overwrite: replace files that postproc did not write.
    """

    cell: Path
    mode: Mode = "convert"
    tolerance_mm: float | None = None
    part_tolerance_mm: float | None = None
    lines_per_file: int | None = None
    linearize_arcs: bool = False
    keep_unresolved: bool = False
    overwrite: bool = False
    part: Path | None = None


class Outcome(Struct, frozen=True):
    """What came of one program.

    :param program: its file as the user named it.
    :param code: 0 good, 1 nothing was written, 3 written, but the verdict is "failed": a stated tolerance is exceeded,
        or the expected error is larger than what is corrected.
    :param summary: content of `report.json`; None if nothing was written, with code 0 where nothing was to be.
    :param message: why nothing was written, where that is not told by `issues`.
    :param issues: what stands against the program, where it was read but not written.
    :param written: files written.
    :param copied: those of them that it needs, and that are as they were.
    :param earlier: what became of the results of an earlier run, where there are none of this one.
    :param traceback: of a fault of postproc.
    """

    program: str
    code: int
    summary: Summary | None = None
    message: str = ""
    issues: tuple[Issue, ...] = ()
    written: tuple[str, ...] = ()
    copied: tuple[str, ...] = ()
    earlier: str = ""
    traceback: str = ""

    @property
    def skipped(self) -> bool:
        """Whether nothing was to be written: a subprogram, which is converted with the programs that call it."""
        return self.summary is None and self.code == GOOD
