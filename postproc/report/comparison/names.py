"""Display names of the files of two programs, with folders if file names alone are ambiguous."""

from __future__ import annotations

from pathlib import Path

from msgspec import Struct

from postproc.comparison import Comparison
from postproc.program import Ints, Program


class Names(Struct, frozen=True):
    """Display names of the files of a program.

    :param main: the main file.
    :param prefix: text before file names: empty, or folders with a trailing slash.
    :param several: True if its motions are in several files.
    """

    main: str
    prefix: str
    several: bool

    def place(self, where: tuple[str, int]) -> str:
        """Return file and line in the form used in messages."""
        return f"{self.prefix}{where[0]}:{where[1]}"

    def line(self, where: tuple[str, int]) -> str:
        """Return a line number for tables, preceded by its file if a program has several."""
        return self.place(where) if self.several else str(where[1])


def names_of(found: Comparison) -> tuple[Names, Names]:
    """Return the display names of the files of both programs."""
    programs = found.nominal, found.corrected
    files = [{document.name.lower() for document in program.documents} for program in programs]
    prefixes = _apart(*(program.documents[0].folder for program in programs)) if files[0] & files[1] else ("", "")
    one, other = (
        Names(prefix + program.documents[0].name, prefix, _several(program, rows))
        for program, prefix, rows in zip(programs, prefixes, found.pair.T, strict=True)
    )
    return one, other


def _several(program: Program, rows: Ints) -> bool:
    places = program.places(rows)
    return bool(len(places.file)) and bool((places.file != places.file[0]).any())


def _apart(one: str, other: str) -> tuple[str, str]:
    """Return the shortest distinct ends of two folders, with a trailing slash; empty if they are the same folder."""
    folders = [Path(folder).resolve().parts for folder in (one, other)]
    if folders[0] == folders[1]:
        return "", ""
    last = next(n for n in range(1, max(map(len, folders)) + 1) if folders[0][-n:] != folders[1][-n:])
    first, second = ("/".join(part.strip("/\\") for part in folder[-last:]) + "/" for folder in folders)
    return first, second
