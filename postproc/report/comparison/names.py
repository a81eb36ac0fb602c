"""What the files of two programs are called: by their folders too, where their names do not tell them apart."""

from __future__ import annotations

from pathlib import Path

from msgspec import Struct

from postproc.comparison import Comparison
from postproc.program import Ints, Program


class Names(Struct, frozen=True):
    """What the files of a program are called.

    :param main: the main file.
    :param prefix: before the names of files: empty, or folders with a slash behind.
    :param several: whether its motions stand in several files.
    """

    main: str
    prefix: str
    several: bool

    def place(self, where: tuple[str, int]) -> str:
        """Return a file and its line as messages name them."""
        return f"{self.prefix}{where[0]}:{where[1]}"

    def line(self, where: tuple[str, int]) -> str:
        """Return a line as tables name it: with its file where there are several."""
        return self.place(where) if self.several else str(where[1])


def names_of(found: Comparison) -> tuple[Names, Names]:
    """Return what the files of both programs are called."""
    programs = found.nominal, found.corrected
    files = [{document.name.lower() for document in program.documents} for program in programs]
    prefixes = _apart(*(program.documents[0].folder for program in programs)) if files[0] & files[1] else ("", "")
    one, other = (
        Names(prefix + program.documents[0].name, prefix, _several(program, told))
        for program, prefix, told in zip(programs, prefixes, found.pair.T, strict=True)
    )
    return one, other


def _several(program: Program, rows: Ints) -> bool:
    places = program.places(rows)
    return bool(len(places.file)) and bool((places.file != places.file[0]).any())


def _apart(one: str, other: str) -> tuple[str, str]:
    """Return the ends of two folders that tell them apart, with a slash behind; empty if they are one folder."""
    folders = [Path(folder).resolve().parts for folder in (one, other)]
    if folders[0] == folders[1]:
        return "", ""
    last = next(n for n in range(1, max(map(len, folders)) + 1) if folders[0][-n:] != folders[1][-n:])
    first, second = ("/".join(part.strip("/\\") for part in folder[-last:]) + "/" for folder in folders)
    return first, second
