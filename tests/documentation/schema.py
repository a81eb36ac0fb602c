"""The keys that a TOML reader accepts, and those that an example shows: read from the structures themselves."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator

import msgspec

_HEADER = re.compile(r"\[\[?([\w.\-]+)\]\]?")
_KEY = re.compile(r"(\w+) = .*?(?:#\s*\[(?P<default>(?:\[[^\]]*\]|[^\]])*)\].*)?$")
NONE = "none"
REQUIRED = "required"


def plain(kind):
    """Return the structure or table behind `X | None`, lists and the like; None for a plain value."""
    if isinstance(kind, msgspec.inspect.UnionType):
        return next((found for one in kind.types if (found := plain(one)) is not None), None)
    if isinstance(kind, msgspec.inspect.ListType):
        return plain(kind.item_type)
    return kind if isinstance(kind, (msgspec.inspect.StructType, msgspec.inspect.DictType)) else None


def keys(structure) -> dict[tuple[type, str], object]:
    """Return (structure, key) → default as a comment states it, of a structure and of all within it."""
    found = {}
    todo = [msgspec.inspect.type_info(structure)]
    while todo:
        kind = plain(todo.pop())
        if isinstance(kind, msgspec.inspect.DictType):
            todo.append(kind.value_type)
        elif isinstance(kind, msgspec.inspect.StructType):
            for field in kind.fields:
                owner = owner_of(kind.cls, field.encode_name)
                if (owner, field.encode_name) not in found:
                    found[owner, field.encode_name] = None if plain(field.type) else default(field)
                    todo.append(field.type)
    return found


def owner_of(cls: type, key: str) -> type:
    """Return the structure that first declares a key: a tool's X is a frame's X."""
    return next(c for c in reversed(cls.__mro__) if key in getattr(c, "__annotations__", {}))


def default(field: msgspec.inspect.Field) -> object:
    if field.required:
        return REQUIRED
    value = field.default if field.default is not msgspec.NODEFAULT else field.default_factory()
    return NONE if value is None or value in ([], {}) else value


def shown(structure, example: str) -> Iterator[tuple[tuple[type, str], str | None]]:
    """Yield (structure, key) and the default in brackets behind it, for each line of an example that names one."""
    table: list[str] = []
    for line in example.splitlines():
        if header := _HEADER.match(line):
            table = header[1].split(".")
            yield from ((pair, None) for pair in _way(structure, table))
        elif key := _KEY.match(line):
            *_, last = _way(structure, [*table, key[1]])
            yield last, key["default"]


def _way(structure, path: list[str]) -> Iterator[tuple[type, str]]:
    kind = msgspec.inspect.type_info(structure)
    for part in path:
        kind = plain(kind)
        if isinstance(kind, msgspec.inspect.DictType):
            kind = kind.value_type
        else:
            (field,) = (f for f in kind.fields if f.encode_name == part)
            yield owner_of(kind.cls, part), part
            kind = field.type


def as_value(comment: str) -> object:
    """Return the default that a comment states."""
    if comment in (NONE, REQUIRED):
        return comment
    value = tomllib.loads(f"x = {comment}")["x"]
    return tuple(value) if isinstance(value, list) else value
