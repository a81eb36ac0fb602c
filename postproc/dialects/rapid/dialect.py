"""RAPID as one of the dialects."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from msgspec.structs import replace

from postproc import provenance
from postproc.cell import Cell
from postproc.dialects.rapid import language
from postproc.dialects.rapid.read import Layout, read
from postproc.dialects.rapid.write import write
from postproc.errors import ProgramError
from postproc.frames import RAD_PER_DEG, Array
from postproc.program import Document, Program, TargetForces, TargetJoints, Targets, Written

_COMMENT = "!"
_MODULE = re.compile(r"(?:\A|(?<=[\r\n]))[ \t]*MODULE[ \t][^\r\n]*(\r{0,2}\n|\r)", re.IGNORECASE)
_OWN = re.compile(r"((?:MODULE[ \t]+mod_)|(?:PROC[ \t]+))[A-Za-z]\w*", re.ASCII)


class _Writer:
    """Writes RAPID: new programs only."""

    extension = ".mod"
    approximation = "approximation (zones)"
    least_arc = (1.01e-4, 1.01 * RAD_PER_DEG)
    """Limits of MoveC, 0.1 mm and 1 deg (Technical reference manual, RAPID Instructions), and 1 % for rounding."""

    def fault_of(self, name: str) -> str | None:
        """Return why the controller would refuse a name for a program, or None if it would not."""
        return language.fault_of(name)

    def valid(self, name: str) -> str:
        """Return the name itself if the controller accepts it, otherwise a similar valid one."""
        return language.valid(name)

    def write(
        self, program: Program, targets: Targets, joints: TargetJoints, cell: Cell, comments: TargetForces | None
    ) -> Written:
        """Return a program as text, see `write.write`.

        :raises ProgramError: the program was read from RAPID, which can be predicted but not corrected.
        """
        if isinstance(program.layout, Layout):
            raise ProgramError(
                "a RAPID program cannot be corrected",
                file=program.documents[0].name,
                advice="Convert the G-code that it was made from, or see its deviation by `postproc predict`.",
            )
        return write(program, targets, joints, cell, comments)

    def renamed(self, documents: Sequence[Document], name: str) -> tuple[Document, ...]:
        """Return a program under another name: file, module and procedure."""
        (document,) = documents
        text = _OWN.sub(lambda match: match[1] + name, document.text, count=2)
        return (replace(document, name=f"{name}{Path(document.name).suffix}", text=text),)

    def marked(self, documents: Sequence[Document], origin: provenance.Origin) -> tuple[tuple[Document, ...], int]:
        """Return the file with the line of its provenance, below MODULE."""
        return provenance.marked(documents, origin, _COMMENT, _MODULE)

    def origin(self, documents: Sequence[Document]) -> provenance.Provenance:
        """Return the provenance that a program states."""
        return provenance.of(documents, _COMMENT)


class Rapid:
    """ABB RAPID as this package writes it."""

    name = "rapid"
    extensions = (".mod", ".modx")
    command_decimals = (6, 6, 6, 6, 6, 6)
    writer = _Writer()

    def companions(self, path: Path) -> list[Path]:
        """Return no files: a program is one module."""
        del path
        return []

    def read(self, documents: Sequence[Document], cell: Cell, forward: Callable[[Array], Array], name: str) -> Program:
        """Return a program, see `read.read`."""
        return read(documents[0], cell, forward, name)


RAPID = Rapid()
