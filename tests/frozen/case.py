"""One case of the corpus: files, and what is run with them; and its place in a zip file."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

_CASE = "case.json"


@dataclass(frozen=True, slots=True)
class Case:
    """Files of a folder, and steps that are run in it one after the other.

    :ivar files: name with its folders → content.
    :ivar steps: each a way to run, see `running.WAYS`, and its arguments.
    """

    name: str
    files: dict[str, bytes]
    steps: tuple[tuple[str, ...], ...]
    outputs: dict[str, bytes] = field(default_factory=dict)


def write(path: Path, cases: Iterable[Case]) -> int:
    """Write cases with their outputs into a zip file; return how many."""
    count = 0
    part = path.with_suffix(".part")
    with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=3) as file:
        for case in cases:
            members = {_CASE: json.dumps({"steps": case.steps}).encode()}
            members |= {f"in/{name}": data for name, data in case.files.items()}
            members |= {f"out/{name}": data for name, data in case.outputs.items()}
            for name, data in sorted(members.items()):
                file.writestr(f"{case.name}/{name}", data)
            count += 1
    part.replace(path)
    return count


def names(path: Path) -> list[str]:
    """Return the names of the cases of a zip file, in order."""
    with zipfile.ZipFile(path) as file:
        return [name.removesuffix(f"/{_CASE}") for name in file.namelist() if name.endswith(f"/{_CASE}")]


def read(path: Path, wanted: Iterable[str]) -> Iterator[Case]:
    """Yield cases of a zip file by their names."""
    with zipfile.ZipFile(path) as file:
        members: dict[str, list[str]] = {}
        for name in file.namelist():
            members.setdefault(name.split("/", 1)[0], []).append(name)
        for case in wanted:
            steps = tuple(map(tuple, json.loads(file.read(f"{case}/{_CASE}"))["steps"]))
            found: dict[str, dict[str, bytes]] = {"in": {}, "out": {}}
            for name in members[case]:
                kind, _, rest = name.removeprefix(f"{case}/").partition("/")
                if kind in found:
                    found[kind][rest] = file.read(name)
            yield Case(case, found["in"], steps, found["out"])
