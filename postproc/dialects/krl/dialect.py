"""KRL as one of the dialects."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from postproc import provenance
from postproc.cell import Cell
from postproc.dialects.krl import write
from postproc.dialects.krl.language.names import fault_of, valid
from postproc.dialects.krl.layout import Layout
from postproc.dialects.krl.read import read_program
from postproc.frames import RAD_PER_DEG, Array
from postproc.program import Document, Program, TargetForces, TargetJoints, Targets, Written

_COMMENT = ";"
_DEF = re.compile(r"(?:\A|(?<=[\r\n]))[ \t]*(?:GLOBAL[ \t]+)?DEF[ \t][^\r\n]*(\r{0,2}\n|\r)", re.IGNORECASE)


class _Writer:
    """Writes KRL: a program read from KRL in its own text, any other as a new one."""

    extension = ".src"
    least_arc = (2e-5, 0.3 * RAD_PER_DEG)
    """Assumed: no limit is published; where all three points nearly coincide their digits decide on the circle."""

    def fault_of(self, name: str) -> str | None:
        """Return why the controller would refuse a name for a program, or None if it would not."""
        return fault_of(name)

    def valid(self, name: str) -> str:
        """Return a name as it stands if the controller accepts it, otherwise one as close to it as possible."""
        return valid(name)

    def write(
        self, program: Program, targets: Targets, joints: TargetJoints, cell: Cell, comments: TargetForces | None
    ) -> Written:
        """Return a program as text, see `write.rewrite` and `write.emit`."""
        del joints  # S and T of the targets say which branch is meant
        if isinstance(program.layout, Layout):
            return write.rewrite(program, targets, comments)
        return write.emit(program, targets, cell, comments)

    def renamed(self, documents: Sequence[Document], name: str) -> tuple[Document, ...]:
        """Return the files of a program under another name."""
        return write.renamed(documents, name)

    def marked(self, documents: Sequence[Document], origin: provenance.Origin) -> tuple[tuple[Document, ...], int]:
        """Return the files with the line that says where they come from: below the first DEF."""
        return provenance.marked(documents, origin, _COMMENT, _DEF)

    def origin(self, documents: Sequence[Document]) -> provenance.Provenance:
        """Return what the files of a program say of where they come from."""
        return provenance.of(documents, _COMMENT)


class Krl:
    """KUKA KRL."""

    name = "krl"
    extensions = (".src",)
    command_decimals = (6, 6, 6, 6, 6, 6)  # the most that programs have
    writer = _Writer()

    def companions(self, path: Path) -> list[Path]:
        """Return the `.dat` files beside a program, letters of any case; the one that belongs to it first."""
        try:
            names = os.listdir(path.parent)  # noqa: PTH208 - a folder may hold thousands of programs
        except OSError:
            return []
        wanted = f"{path.stem}.dat".lower()
        found = [path.with_name(name) for name in names if name.lower() == wanted]
        return sorted(found, key=lambda other: (other.stem != path.stem, other.name))

    def read(self, documents: Sequence[Document], cell: Cell, forward: Callable[[Array], Array], name: str) -> Program:
        """Return a program, see `read.reader`."""
        return read_program(documents, cell, forward, name)


KRL = Krl()
