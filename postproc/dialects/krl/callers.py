"""Which files are subprograms of others, by the names in their texts, before any of them is read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from msgspec import Struct

from postproc.dialects.krl.language import scan

_SELECTING = "cell"
"""KUKA's CELL.SRC chooses programs by the number that comes from outside: they are main programs."""


class _File(Struct, frozen=True):
    """What a file has to do with others; names in upper case.

    :param calls: names that are called in it and that it does not declare itself.
    :param gives: names by which others call its routines.
    """

    calls: frozenset[str]
    gives: frozenset[str]


def callers(paths: Sequence[Path]) -> dict[Path, list[Path]]:
    """Return which `.src` files of one folder are only called by others of them, and by which.

    Files that only call each other are not among them. A file of which others call a GLOBAL routine, and whose own main
    routine has statements, is a program of its own.
    """
    files = {path: _file(path) for path in paths}
    calling: dict[str, list[Path]] = {}
    for path, file in files.items():
        for name in file.calls:
            calling.setdefault(name, []).append(path)
    by: dict[Path, list[Path]] = {}
    called: dict[Path, list[Path]] = {path: [] for path in paths}
    for path, file in files.items():
        others = {other for name in file.gives for other in calling.get(name, ())} - {path}
        by[path] = sorted(others)
        for other in others:
            called[other].append(path)
    reached = {path for path in paths if not by[path]}
    waiting = list(reached)
    while waiting:
        found = set(called[waiting.pop()]) - reached
        reached |= found
        waiting += found
    return {path: others for path, others in by.items() if others and path in reached}


def _file(path: Path) -> _File:
    try:
        text = path.read_bytes().decode("latin-1")
    except OSError:
        return _File(frozenset(), frozenset())
    found = list(scan.whole_routines(text))
    name = path.stem.upper()
    gives = {name}
    if all(one.empty for one in found if one.name == name):
        gives |= {one.name for one in found if one.public}
    calls = scan.called(scan.without_comments(text)) if path.stem.lower() != _SELECTING else set[str]()
    return _File(frozenset(calls), frozenset(gives))
