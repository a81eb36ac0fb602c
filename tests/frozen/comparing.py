"""What differs between two outputs of a case: by kind, with the first line that does."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

_NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_ORIGIN = re.compile(rb"(?m)^([;!]POSTPROC .*? )(version=\S+.*)$")
KINDS = {
    "exit": "exit codes",
    "messages": "messages",
    "stdout": "standard output",
    "json": "JSON",
    "csv": "CSV",
    "html": "pages",
}


@dataclass(frozen=True, slots=True)
class Difference:
    """One output that is not the same.

    :ivar kind: exit codes, messages, standard output, JSON, CSV, pages or text.
    """

    case: str
    output: str
    kind: str
    what: str


def kind_of(output: str) -> str:
    """Return the kind of an output by its name."""
    return KINDS.get(output.rpartition("/")[2].rpartition(".")[2], "text")


def differences(case: str, before: dict[str, bytes], after: dict[str, bytes]) -> Iterator[Difference]:
    """Yield the outputs of a case that differ."""
    for name in sorted(before.keys() | after.keys()):
        if before.get(name) != after.get(name):
            what = _what(before.get(name), after.get(name))
            if what:
                yield Difference(case, name, kind_of(name), what)


def _what(before: bytes | None, after: bytes | None) -> str:
    """Return how two outputs differ; empty where only sums and version in the line of the origin do."""
    if before is None or after is None:
        return "only now" if before is None else "no longer"
    one, other = (_ORIGIN.sub(rb"\1", text) for text in (before, after))
    if one == other:
        return ""
    lines = list(zip(one.splitlines(), other.splitlines(), strict=False))
    row = next((n for n, (a, b) in enumerate(lines) if a != b), len(lines))
    shown = [_shown(text.splitlines(), row) for text in (one, other)]
    if _NUMBER.sub(b"#", one) == _NUMBER.sub(b"#", other):
        numbers = zip(_NUMBER.findall(one), _NUMBER.findall(other), strict=True)
        most = max(abs(float(a) - float(b)) for a, b in numbers)
        shown.append(f"numbers differ by up to {most:.3g}")
    return f"line {row + 1}\n    - {shown[0]}\n    + {shown[1]}" + "".join(f"\n    {more}" for more in shown[2:])


def _shown(lines: list[bytes], row: int) -> str:
    return lines[row].decode("utf-8", "replace")[:300] if row < len(lines) else "(end)"
