"""Which files are subprograms of others: found by the names in their texts, before any of them is read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from msgspec import Struct

_CALL = re.compile(rb"([A-Za-z_]\w*)[ \t]*\(")
_ROUTINE = re.compile(
    rb"^[ \t]*(GLOBAL[ \t]+)?DEF(?:FCT[ \t]+\w+(?:[ \t]*\[[ ,\t]*\])?)?[ \t]+(\w+)[^\r\n]*"
    rb"(.*?)^[ \t]*END(?:FCT)?[ \t]*(?:;|\r|\n|\Z)",
    re.I | re.M | re.S,
)
_CODE = re.compile(rb"^[ \t]*[^\s;&]", re.M)
_SELECTING = "cell"
"""KUKA's CELL.SRC chooses programs by the number that comes from outside: they are main programs."""


class _File(Struct, frozen=True):
    """What a file has to do with others; names in upper case.

    :param calls: names that are called in it and that it does not declare itself.
    :param gives: names by which others call what stands in it.
    """

    calls: frozenset[bytes]
    gives: frozenset[bytes]


def callers(paths: Sequence[Path]) -> dict[Path, list[Path]]:
    """Return which `.src` files of one folder are but called by others of them, and by which.

    Files that call each other in a ring are nobody's. A file of which others call a GLOBAL routine, and that has
    something to do by itself, is a program of its own.
    """
    files = {path: _file(path) for path in paths}
    calling: dict[bytes, list[Path]] = {}
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
        text = path.read_bytes()
    except OSError:
        return _File(frozenset(), frozenset())
    found = [(match[2].upper(), bool(match[1]), match[3]) for match in _ROUTINE.finditer(text)]
    name = path.stem.upper().encode()
    gives = {name}
    if not any(_CODE.search(body) for own, _, body in found if own == name):
        gives |= {own for own, public, _ in found if public}
    calls: set[bytes] = set()
    if path.stem.lower() != _SELECTING:
        calls = {match[1].upper() for match in _CALL.finditer(text) if not _commented(text, match.start())}
    return _File(frozenset(calls - {own for own, *_ in found}), frozenset(gives))


def _commented(text: bytes, place: int) -> bool:
    return b";" in text[text.rfind(b"\n", 0, place) + 1 : place]
