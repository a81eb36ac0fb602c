"""A dialect that is only read: one point a line, ``X Y Z [feed]`` in mm and mm/min, comments behind ``#``."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc.errors import ProgramError, combined_error
from postproc.program import LIN, PTP, Motions, Program, parse_force_note

MM = 1e-3
MM_PER_MIN = 1e-3 / 60.0


class Points:
    """What `postproc.dialects.dialect.Dialect` asks of a format."""

    name = "points"
    extensions = (".points",)
    command_decimals = (4, 4, 4, 5, 5, 5)  # of the KRL written from it
    writer = None  # not written: it becomes KRL

    def companions(self, path):
        """No other files belong to a program."""
        return []

    def read(self, documents, cell, forward, name):
        """Return the program: the first point by PTP, the others as LIN."""
        (document,) = documents
        lines, points, feeds, notes, faults = [], [], [], [], []
        for number, text in enumerate(document.text.splitlines(), 1):
            numbers, _, comment = text.partition("#")
            note = parse_force_note(comment, number, document.name)
            if note is not None:
                notes.append(replace(note, before=len(points)))
            if not numbers.strip():
                continue
            point = _numbers(numbers)
            if point is None or len(point) != (4 if points else 3) or (points and point[3] <= 0.0):
                advice = "A line is X Y Z, with a feed from the second point on."
                faults.append(ProgramError("no point", file=document.name, line=number, text=text, advice=advice))
                continue
            lines.append(number)
            points.append(point[:3])
            feeds.append(point[3] if points[1:] else np.nan)
        if faults:
            raise combined_error(faults)
        count = len(points)
        target = np.tile(np.eye(4), (count, 1, 1))
        target[:, :3, :3] = cell.tool_orientation()
        target[:, :3, 3] = np.array(points).reshape(count, 3) * MM
        first = np.arange(count) == 0
        nan, none = np.full(count, np.nan), np.full(count, -1)
        motions = Motions(
            kind=np.where(first, PTP, LIN),
            rapid=first,
            line=np.array(lines),
            target=target,
            joints=np.full((count, 6), np.nan),
            centre=np.full((count, 3), np.nan),
            normal=np.full((count, 3), np.nan),
            sweep=nan,
            feed=np.array(feeds) * MM_PER_MIN,
            base=np.zeros(count, dtype=np.int64),
            tool=np.zeros(count, dtype=np.int64),
            blend=np.full(count, cell.gcode.approximation_mm * MM),
            rounding=np.full(count, cell.gcode.corner_tolerance_mm * MM),
            status=none,
            turn=none,
        )
        return Program(
            name, self.name, (document,), motions, cell.base.pose()[None], cell.tool.pose()[None], notes=tuple(notes)
        )


def _numbers(text):
    """Return the numbers of a line, or None if it has something else."""
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        return None
    return numbers if np.isfinite(numbers).all() else None


POINTS = Points()
