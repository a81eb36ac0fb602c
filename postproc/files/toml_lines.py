"""Lines of a TOML text: where a key is given, for messages about its value."""

from __future__ import annotations

import re
from collections.abc import Sequence

_HEADER = re.compile(r"\s*\[\[?\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?$")
_UNKNOWN = re.compile(r"unknown (?:table \[(?P<name>[^\]]*)\]|key '(?P<key>[^']*)'(?: in \[(?P<table>[^\]]*)\])?)$")
_PART = re.compile(r"\"[^\"]*\"|'[^']*'|[^.]+")
_ANY_KEY = "*"


def line_of_unknown(text: str, problem: str) -> int | None:
    """Return the line of the key or table that a message calls unknown; None: no such message, or no single line."""
    unknown = _UNKNOWN.match(problem)
    if unknown is None:
        return None
    return line_of(text, unknown["name"] or ".".join(filter(None, (unknown["table"], unknown["key"]))))


def line_of(text: str, key: str) -> int | None:
    """Return the 1-based line of a TOML text that gives a key, if exactly one does; else None.

    :param text: empty: there is none.
    :param key: with its tables, as ``gcode.motions``; indices are left out. ``[...]`` stands for any name or index.
    """
    key_without_indices = re.sub(r"\[\d+\]", "", key).replace("[...]", f".{_ANY_KEY}")
    key_parts = [part.strip("\"'") for part in _PART.findall(key_without_indices)]
    lines_of_key, lines_around_key, table = list[int](), list[int](), list[str]()
    for number, line in enumerate(text.splitlines(), 1):
        if header := _HEADER.match(line):
            path = table = _key_parts(header[1])
        elif "=" in line and not line.lstrip().startswith("#"):
            path = [*table, *_key_parts(line.partition("=")[0])]
        else:
            continue
        if _is_in_line(path, key_parts):
            if len(path) == len(key_parts):
                lines_of_key.append(number)
            elif not header:  # an inline table or list, which has the key in it
                lines_around_key.append(number)
    lines = lines_of_key or lines_around_key
    return lines[0] if len(lines) == 1 else None


def _key_parts(text: str) -> list[str]:
    """Return the parts of a dotted key without quotes."""
    return [part.strip().strip("\"'") for part in _PART.findall(text.strip())]


def _is_in_line(path: Sequence[str], key_parts: Sequence[str]) -> bool:
    """Return whether a line gives a key, or an inline table or list that has the key in it.

    It does if the key of the line is the wanted key or a beginning of it.

    :param path: parts of the key of the line.
    :param key_parts: parts of the wanted key; ``*`` is any part.
    """
    return len(path) <= len(key_parts) and all(
        key_part in (part, _ANY_KEY) for part, key_part in zip(path, key_parts, strict=False)
    )
