"""Ways to run a case: the command line, or KRL read and rewritten by the library; what came of it as files."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.cli import main
from postproc.dialects import krl
from postproc.dialects.krl.write import split_files
from postproc.dialects.text import decode
from postproc.errors import PostprocError
from postproc.report.kit.page import library
from tests.attack import krl as attack
from tests.dialects.krl_programs import forward, targets
from tests.frozen.case import Case

SECONDS = 60
"""A step that takes longer is ended, and its outcome is that."""


class _TooLong(BaseException):
    pass


def run(case: Case) -> Case:
    """Return a case with the outputs of this version."""
    outputs: dict[str, bytes] = {}
    home = Path.cwd()
    with tempfile.TemporaryDirectory(prefix="frozen") as place:
        folder = Path(place).resolve() / "case"
        folder.mkdir()
        for name, data in case.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        os.chdir(folder)
        try:
            for number, (way, *arguments) in enumerate(case.steps):
                for name, text in _limited(WAYS[way], arguments).items():
                    outputs[f"{number}/{name}"] = text.replace(str(folder), ".").encode("utf-8", "surrogateescape")
            for path in sorted(folder.rglob("*")):
                name = path.relative_to(folder).as_posix()
                if path.is_file() and case.files.get(name) != path.read_bytes():
                    text = path.read_bytes().replace(str(folder).encode(), b".")
                    outputs[f"files/{name}"] = text.replace(library(), b"") if path.suffix == ".html" else text
        finally:
            os.chdir(home)
    return Case(case.name, case.files, case.steps, outputs)


def _limited(way: Callable[..., dict[str, str]], arguments: list[str]) -> dict[str, str]:
    """Return what a way gives; what it raises, or that it takes too long, is its exit code."""

    def ended(*_: object) -> None:
        raise _TooLong

    before = signal.signal(signal.SIGALRM, ended)
    signal.alarm(SECONDS)
    try:
        return way(*arguments)
    except _TooLong:
        return {"exit": f"takes more than {SECONDS} s\n"}
    except Exception as cause:
        return {"exit": f"fails: {type(cause).__name__}: {cause}\n"}
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def command(*arguments: str) -> dict[str, str]:
    """Run the command line in this process."""
    out, err = io.StringIO(), io.StringIO()
    code: object = 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(list(arguments), prog_name="postproc")
        except SystemExit as end:
            code = end.code
    return {"exit": f"{code or 0}\n", "stdout": out.getvalue(), "messages": err.getvalue()}


def krl_moved(cell: str, *names: str) -> dict[str, str]:
    """Read KRL, and write it with its own targets, with others, and in several files.

    :param cell: JSON file of the cell.
    :param names: its documents; others of the folder may be called.
    """
    here = msgspec.json.decode(Path(cell).read_bytes(), type=Cell)
    here = replace(here, folder=str(Path.cwd()))
    found: dict[str, str] = {}
    try:
        documents = [replace(decode(Path(n).name, Path(n).read_bytes()), folder=str(Path(n).parent)) for n in names]
        program = krl.read_program(documents, here, forward, Path(names[0]).stem)
    except PostprocError as error:
        return {"exit": "refused\n", "messages": f"{error}\n"}
    found["program.json"] = _json(program)
    for name, wanted in (
        ("same", lambda: targets(program, keep=True)),
        ("moved", lambda: attack.moved(program, np.random.default_rng(len(documents[0].text)))),
    ):
        try:
            written = krl.rewrite(program, wanted())
        except PostprocError as error:
            found[f"{name}.messages"] = f"{error}\n"
            continue
        found |= {f"{name}/{document.name}": document.text for document in written.documents}
        found[f"{name}.json"] = _json(written)
        try:
            lines = max(12, documents[0].text.count("\n") // 3)
            divided = split_files(Path(names[0]).stem, program.documents, written, lines)
        except PostprocError as error:
            found[f"{name}.divided.messages"] = f"{error}\n"
            continue
        found |= {f"{name}.divided/{document.name}": document.text for document in divided.documents}
    return found | {"exit": "read\n"}


def _json(value: object) -> str:
    """Return a structure as JSON, one item a line; texts of programs and what a writer keeps for itself left out."""
    return json.dumps(_plain(value), indent=0, sort_keys=True, default=str) + "\n"


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return [" ".join(map(repr, np.ravel(row).tolist())) for row in value]
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, msgspec.Struct):
        return {name: _plain(part) for name, part in _fields(value)}
    if isinstance(value, dict):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    if isinstance(value, (set, frozenset)):
        return sorted(str(_plain(part)) for part in value)
    if isinstance(value, Exception):
        return str(value)
    return value if isinstance(value, (str, int, float, bool, type(None))) else type(value).__name__


def _fields(value: msgspec.Struct) -> Iterator[tuple[str, object]]:
    for name in value.__struct_fields__:
        if name not in ("layout", "documents", "text"):
            yield name, getattr(value, name)


WAYS: dict[str, Callable[..., dict[str, str]]] = {"postproc": command, "krl": krl_moved}
