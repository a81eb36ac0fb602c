"""G-code as one of the dialects: read, and written in another one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from postproc.cell import Cell
from postproc.dialects import gcode
from postproc.frames import Array
from postproc.program import Document, Program


class GCode:
    """G-code of milling with three to five axes."""

    name = "gcode"
    extensions = (".nc", ".ngc", ".tap", ".cnc", ".gcode", ".mpf", ".ptp")
    command_decimals = (4, 4, 4, 5, 5, 5)  # those of the robot programs written from it
    writer = None

    def companions(self, path: Path) -> list[Path]:
        """Return no files: a G-code program is one file."""
        del path
        return []

    def read(self, documents: Sequence[Document], cell: Cell, forward: Callable[[Array], Array], name: str) -> Program:
        """Return a program, see `gcode.read`."""
        return gcode.read(documents[0], cell, forward, name)


GCODE = GCode()
