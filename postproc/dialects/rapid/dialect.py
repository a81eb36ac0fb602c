"""ABB RAPID as one of the dialects."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path, PurePath

from msgspec.structs import replace

from postproc import provenance
from postproc.cell import Cell
from postproc.dialects.rapid import language
from postproc.dialects.rapid.layout import Layout
from postproc.dialects.rapid.new_module import write
from postproc.dialects.rapid.reader import read
from postproc.dialects.rapid.rewrite import rewrite
from postproc.frames import RAD_PER_DEG, Array
from postproc.program import Document, Program, TargetForces, TargetJoints, Targets, WrittenProgram

_COMMENT = "!"
_MODULE = re.compile(r"(?:\A|(?<=[\r\n]))[ \t]*MODULE[ \t][^\r\n]*(\r{0,2}\n|\r)", re.IGNORECASE)
_HEAD_NAME = re.compile(
    r"(^[ \t]*(?:LOCAL[ \t]+)?(MODULE|PROC)[ \t]+)([A-Za-z]\w*)", re.ASCII | re.IGNORECASE | re.MULTILINE
)


class _Writer:
    """Writes RAPID: a program read from RAPID in its own text, any other as a new module."""

    extension = ".mod"
    approximation = "approximation (zones)"
    least_arc = (1.01e-4, 1.01 * RAD_PER_DEG)
    """Limits of MoveC, 0.1 mm and 1 deg (Technical reference manual, RAPID Instructions), and 1 % for rounding."""

    def fault_of(self, name: str) -> str | None:
        """Return the reason why the controller refuses a program name; None if it accepts the name."""
        return language.fault_of(name)

    def valid_name(self, name: str) -> str:
        """Return the name itself if the controller accepts it, otherwise a similar valid name."""
        return language.valid_name(name)

    def write(
        self, program: Program, targets: Targets, joints: TargetJoints, cell: Cell, comments: TargetForces | None
    ) -> WrittenProgram:
        """Return a program as text, see `Writer.write`.

        A RAPID program keeps its own text, see `rewrite.rewrite`; other programs become a new module, see
        `new_module.write`.
        """
        if isinstance(program.layout, Layout):
            return rewrite(program, targets, joints, comments)
        return write(program, targets, joints, cell, comments)

    def rename(self, documents: Sequence[Document], name: str) -> tuple[Document, ...]:
        """Return a program under another name: the name of the file, and of modules and procedures named like the file.

        Names with `language.PREFIX` before the name of the file keep the prefix.
        """
        (document,) = documents
        path = PurePath(document.name)
        prefixes = {path.stem.upper(): "", f"{language.PREFIX}{path.stem}".upper(): language.PREFIX}

        def renamed(match: re.Match[str]) -> str:
            """Return the head of a module or procedure with the new name; unchanged if not named like the file."""
            prefix = prefixes.get(match[3].upper())
            return match[0] if prefix is None else f"{match[1]}{prefix}{name}"

        text = _HEAD_NAME.sub(renamed, document.text)
        return (replace(document, name=f"{name}{path.suffix}", text=text),)

    def mark(self, documents: Sequence[Document], origin: provenance.Origin) -> tuple[tuple[Document, ...], int]:
        """Return the file with a line below MODULE that states its origin.

        :returns: the file, and the 1-based line from which on its lines have moved down by one; 0 if no line has moved.
        """
        return provenance.mark(documents, origin, _COMMENT, _MODULE)

    def origin(self, documents: Sequence[Document]) -> provenance.Provenance:
        """Return the origin that a program states."""
        return provenance.of(documents, _COMMENT)


class Rapid:
    """ABB RAPID."""

    name = "rapid"
    extensions = (".mod", ".modx")
    command_decimals = (6, 6, 6, 6, 6, 6)
    writer = _Writer()

    def companions(self, path: Path) -> list[Path]:
        """Return no files: a program is one module."""
        del path
        return []

    def read(
        self, documents: Sequence[Document], cell: Cell, forward_kinematics: Callable[[Array], Array], name: str
    ) -> Program:
        """Return a program, see `Dialect.read` and `reader.read`."""
        return read(documents[0], cell, forward_kinematics, name)


RAPID = Rapid()
