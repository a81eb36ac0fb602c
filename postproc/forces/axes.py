"""Rotate forces from the axes in which they are given into `$BASE` axes, and back."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.forces.feed import feed_axes
from postproc.forces.knots import FEED, TOOL
from postproc.frames import Array
from postproc.program import Ints, Program
from postproc.toolpath import Segments, Toolpath, at


class Axes(Struct, frozen=True, eq=False):
    """The axes of forces along a program.

    Forces are columns (n, 2, 3, m): force and moment, m vectors of each.

    :param program: the program, `path` the geometry of its motions.
    :param spindle: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :param travel: (M, 3) x of `FEED` for motions along the spindle, see `feed.last_travel`; (0, 3) without FEED.
    """

    program: Program
    path: Segments
    spindle: str
    travel: Array

    def into_base(self, columns: Array, frame: Ints, sample: Toolpath) -> Array:
        """Return columns (n, 2, 3, m) in `$BASE` axes that are given in frames (n,) at samples."""
        return self._turned(columns, frame, sample, "nij,nhjm->nhim")

    def out_of_base(self, columns: Array, frame: Ints, sample: Toolpath) -> Array:
        """Return columns (n, 2, 3, m) in frames (n,) at samples that are given in `$BASE` axes."""
        return self._turned(columns, frame, sample, "nji,nhjm->nhim")

    def _turned(self, columns: Array, frame: Ints, sample: Toolpath, product: str) -> Array:
        out = columns.copy()
        for code in (TOOL, FEED):
            rows = np.flatnonzero(frame == code)
            rows = rows[columns[rows].any(axis=(1, 2, 3))]
            if len(rows):
                here = sample.take(rows)
                rotation = here.pose[:, :3, :3]
                if code == FEED:
                    rotation = feed_axes(self.program, self.path, here, self.spindle, self.travel)
                out[rows] = np.einsum(product, rotation, columns[rows])
        return out

    def at_start(self, columns: Array, frame: Ints) -> Array:
        """Return the columns that act at the start of motions: those at the end of the motion before.

        :param columns: (M, 2, 3, m) at the end of each motion.
        :param frame: (M,) frames in which they are given.
        :returns: (M, 2, 3, m) in `$BASE` axes of the motion; zero at the start of the program.
        """
        m, bases = self.program.motions, self.program.bases
        ends = columns.copy()
        rows = np.flatnonzero((frame == TOOL) | (frame == FEED))
        end = at(self.program, self.path, rows, np.ones(len(rows)))
        ends[rows] = self.into_base(columns[rows], frame[rows], end)
        before = np.arange(len(m)) - 1 if self.program.after is None else self.program.after
        out = np.where((before >= 0)[:, None, None, None], ends[before], 0.0)
        changed = np.flatnonzero((before >= 0) & (m.base != m.base[before]))
        turn = np.swapaxes(bases[m.base[changed], :3, :3], 1, 2) @ bases[m.base[before[changed]], :3, :3]
        out[changed] = np.einsum("nij,nhjm->nhim", turn, out[changed])
        return out
