"""What of a program is read in bulk: plain motions, and plain assignments to system variables."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.read import plain_lines, plain_settings
from postproc.dialects.krl.read.motion_columns import MotionColumns, none
from postproc.dialects.krl.read.plain_settings import PlainSettings, no_settings
from postproc.program import Bools, Ints


class Plain(Struct, frozen=True):
    """Plain lines of a text.

    :ivar motions: in parts.
    :ivar settings: assignments.
    """

    motions: list[MotionColumns]
    settings: PlainSettings

    @property
    def moving(self) -> Ints:
        """(P,) 1-based lines of the motions."""
        return np.concatenate([rows.line for rows in self.motions])

    def others(self, count: int) -> Bools:
        """Return which of the lines 1 … count are neither (count,)."""
        out = np.ones(count, dtype=np.bool_)
        out[self.moving - 1] = False
        out[self.settings.line - 1] = False
        return out


def plain_of(source: Source, *, bulk: bool = True) -> Plain:
    """Return the plain lines of a text; not `bulk`: none, so that all are read one by one."""
    return Plain(plain_lines.scan(source), plain_settings.scan(source)) if bulk else Plain([none()], no_settings())
