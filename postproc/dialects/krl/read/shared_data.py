"""GLOBAL variables of other files: points, frames and numbers that the `.dat` files of a folder declare for all."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from postproc.dialects.krl.language.names import NAME
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.read.data_lists import read_data
from postproc.dialects.krl.read.variables import Variables
from postproc.dialects.text import decode
from postproc.errors import ProgramError

_GLOBAL = re.compile(rb"^[ \t]*(?:DECL[ \t]+GLOBAL|GLOBAL[ \t]+DECL|GLOBAL)[ \t]+\w+[ \t]+(\w+)", re.I | re.M)
_LARGEST = 20_000_000
"""Bytes of the largest file that is searched."""


def read_shared(variables: Variables, text: str, own: Sequence[str], folders: Sequence[Path]) -> None:
    """Take GLOBAL variables that a program uses from other `.dat` files; not those that several of them declare.

    :param text: of the program.
    :param own: names of its files.
    :param folders: where to look.
    """
    mine = {name.upper() for name in own}
    found: dict[str, Path] = {}
    for folder in folders:
        for path in _data_files(folder):
            found.setdefault(path.name.upper(), path)
    declared = {path: _names(path) for name, path in found.items() if name not in mine}
    if not any(declared.values()):
        return
    times = Counter(name for names in declared.values() for name in names)
    known = {name.upper() for name in NAME.findall(text)} - variables.types.keys()
    wanted = {name for name in known if times[name] == 1}
    for path, names in declared.items():
        if not wanted.isdisjoint(names):
            with suppress(ProgramError, OSError):  # they have no values then, and a motion that needs one says so
                read_data(variables, Source.of(decode(path.name, path.read_bytes()), 2), fill=True, only=wanted)


def _data_files(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if path.suffix.upper() == ".DAT")
    except OSError:
        return []


def _names(path: Path) -> frozenset[str]:
    """Return the names of the GLOBAL variables of a file, upper case."""
    try:
        stat = path.stat()
    except OSError:
        return frozenset()
    return _names_in(path, stat.st_mtime_ns, stat.st_size) if stat.st_size <= _LARGEST else frozenset()


@lru_cache(maxsize=4096)
def _names_in(path: Path, modified: int, size: int) -> frozenset[str]:
    del modified, size  # a file that changes is read again
    try:
        return frozenset(name.decode("ascii", "replace").upper() for name in _GLOBAL.findall(path.read_bytes()))
    except OSError:
        return frozenset()
