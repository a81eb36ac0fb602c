"""The data of a program in several files: each has a `.dat` with what it uses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import PurePath

from msgspec.structs import replace

from postproc.dialects.krl.language.data_files import DataLine, data_lines
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import NAME
from postproc.dialects.krl.write.renaming import with_name
from postproc.program import Document


def with_data(sources: Sequence[Document], data: Document | None) -> Iterator[Document]:
    """Yield the files of a program, behind each `.src` the `.dat` that it needs.

    :param sources: the main program first.
    :param data: the `.dat` of the whole program. What is GLOBAL or used by no part stays with the main program.
    """
    if data is None:
        yield from sources
        return
    source = Source.of(data, 1)
    lines = data_lines(source)
    header = [_line(source, line) for line in range(1, len(source.starts) + 1) if _line(source, line)[0] == "&"]
    needed = [_needed(lines, document) for document in sources]
    away = set().union(*needed[1:]) - needed[0] - {one.line for one in lines if one.public}
    for index, document in enumerate(sources):
        yield document
        stem = PurePath(document.name).stem
        if index == 0 and any(one.names and one.line not in away for one in lines):
            whole = range(1, len(source.starts) + 1)
            text = "".join(_line(source, line) for line in whole if line not in away)
            yield replace(data, name=f"{stem}.dat", text=with_name(text, stem))
        own = [one.text for one in lines if one.line in needed[index] and not one.public]
        if index and own:
            text = "".join([*header, f"DEFDAT {stem}\r\n", *own, "ENDDAT\r\n"])
            yield replace(data, name=f"{stem}.dat", text=text)


def _needed(lines: Sequence[DataLine], document: Document) -> set[int]:
    """Return the numbers of the lines whose names a file uses, or that the types and values of such lines need."""
    declaring: dict[str, list[DataLine]] = {}
    for one in lines:
        for name in one.names:
            declaring.setdefault(name, []).append(one)
    found: set[int] = set()
    waiting = {word.upper() for word in NAME.findall(document.text)} & declaring.keys()
    while waiting:
        new = [one for one in declaring[waiting.pop()] if one.line not in found]
        found |= {one.line for one in new}
        waiting |= {word.upper() for one in new for word in NAME.findall(one.text)} & declaring.keys()
    return found


def _line(source: Source, line: int) -> str:
    """Return a line with its end."""
    stop = int(source.starts[line]) if line < len(source.starts) else len(source.text)
    return source.text[int(source.starts[line - 1]) : stop]
