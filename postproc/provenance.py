"""Where a written program comes from: one comment line near its head, and whether the text is still what was written.

;POSTPROC 1 version=0.1.0 mode=corrected text=… source=… cell=… model=… forces=…

It is a comment of the program's dialect, here KRL. 1 is the number of this format. `text` is the SHA-256 of the program
without this line: of its main file, and of the others behind it. The other sums are those of the files that it was made
from; ``-`` where there was none. Options that were given follow, as ``lines_per_file=40``.
Of a program in several files, the others say of which they are a part:

;POSTPROC 1 part=2 of=partMain
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Literal

from msgspec import Struct, field
from msgspec.structs import replace

from postproc.program import Document

FORMAT = 1
"""Version of the line; lines of others are not understood."""
State = Literal["intact", "changed", "none"]
_END = re.compile(r"\r{0,2}\n|\r")
_CONTENT = re.compile(r"\s*(\d+)((?:\s+\w+=\S+)*)\s*")


class Origin(Struct, frozen=True):
    """The version and the inputs from which a program was made; a comment line of the program states them.

    :param version: of postproc.
    :param mode: ``"corrected"`` or ``"nominal"``.
    :param source: SHA-256 of the program as read, of its files one behind the other; `cell`, `model` and `forces`
        likewise; ``"-"`` where there was none.
    :param options: that were given, by name.
    """

    version: str
    mode: Literal["corrected", "nominal"]
    source: str
    cell: str
    model: str
    forces: str = "-"
    options: Mapping[str, str] = field(default_factory=dict)


class Provenance(Struct, frozen=True):
    """The origin that a program states in a comment line, and whether its text is still as written.

    :param state: ``"intact"``: the text is what was written; ``"changed"``: it was edited since, or its line is of
        another format; ``"none"``: it states no origin.
    :param mode: ``"corrected"`` or ``"nominal"``; empty if it is not stated.
    :param version: of postproc; likewise.
    :param line: 1-based line of the statement; 0 if there is none.
    :param sums: `source`, `cell`, `model` and `forces` as in `Origin`, as far as they are stated.
    :param options: the options with which it was written.
    :param part_of: name of the main file of a divided program, if this file is one of its parts; empty: it is not.
    """

    state: State
    mode: str = ""
    version: str = ""
    line: int = 0
    sums: Mapping[str, str] = field(default_factory=dict)
    options: Mapping[str, str] = field(default_factory=dict)
    part_of: str = ""


def digest(contents: Iterable[bytes]) -> str:
    """Return the SHA-256 of some contents, one behind the other, in hexadecimal digits."""
    total = hashlib.sha256()
    for content in contents:
        total.update(content)
    return total.hexdigest()


def digest_of(documents: Iterable[Document]) -> str:
    """Return the SHA-256 of the files of a program, one behind the other, in hexadecimal digits."""
    return digest(piece for document in documents for piece in document.pieces())


def of(documents: Sequence[Document], comment: str) -> Provenance:
    """Return the origin that the files of a program, the main one first, state in their comment line.

    :param comment: what comments begin with: ``;`` in KRL.
    """
    provenance_lines = _provenance_lines(documents[0].text, comment)
    if not provenance_lines:
        return Provenance("none")
    line = _line_at(documents[0].text, provenance_lines[0].start())
    content = _CONTENT.fullmatch(provenance_lines[0][1])
    if content is None or len(provenance_lines) > 1 or int(content[1]) != FORMAT:
        return Provenance("changed", line=line)
    entries = dict(part.split("=", 1) for part in content[2].split())
    if "of" in entries:  # the file is a part of a program in several files
        return Provenance("none", line=line, part_of=entries["of"])
    is_intact = entries.get("text") == _digest_without_line(documents, provenance_lines[0])
    state: State = "intact" if is_intact else "changed"
    sums = {name: value for name, value in entries.items() if name in ("source", "cell", "model", "forces")}
    options = {name: value for name, value in entries.items() if name not in (*sums, "text", "mode", "version")}
    return Provenance(state, entries.get("mode", ""), entries.get("version", ""), line, sums, options)


def mark(
    documents: Sequence[Document], origin: Origin, comment: str, head: re.Pattern[str]
) -> tuple[tuple[Document, ...], int]:
    """Return the files of a program with a line of provenance in the main one, the first file.

    The line replaces that of an earlier run, if there is one. Else it is inserted after a line that matches `head`, or
    at the beginning of the file if none matches.

    :param comment: what comments begin with: ``;`` in KRL.
    :param head: matches a line; its first group is the end of that line.
    :returns: the files, and the 1-based number of the inserted line, from which on lines have moved down by one; 0 if
        the line replaces an earlier one.
    """
    main, *other_documents = documents
    old_lines = _provenance_lines(main.text, comment)
    if old_lines:
        old_line = old_lines[0]
        start, stop, end = old_line.start(), old_line.end(), _line_end(old_line[0])
    else:
        head_line = head.search(main.text)
        start = stop = head_line.end() if head_line else 0
        end = head_line[1] if head_line else "\r\n"
    entries = {
        "version": origin.version,
        "mode": origin.mode,
        "text": digest_of([_cut_line(main, start, stop), *other_documents]),
        "source": origin.source,
        "cell": origin.cell,
        "model": origin.model,
        "forces": origin.forces,
        **origin.options,
    }
    line = f"{comment}POSTPROC {FORMAT} " + " ".join(f"{name}={value}" for name, value in entries.items()) + end
    text = main.text.replace(main.text[:stop], main.text[:start] + line, 1)  # copies a long text only once
    inserted_line = 0 if old_lines else _line_at(main.text, start)
    return (replace(main, text=text), *other_documents), inserted_line


def _provenance_lines(text: str, comment: str) -> list[re.Match[str]]:
    """Return the lines of a text that state the origin of a program, in order; their first group is the content.

    :param comment: what comments begin with: ``;`` in KRL.
    """
    word, line = _patterns(comment)
    lines = []
    for match in word.finditer(text):  # found fast, unlike lines
        start = max(text.rfind(end, 0, match.start()) for end in "\r\n") + 1
        lines.append(line.match(text, start))
    return [match for match in lines if match is not None]


@cache
def _patterns(comment: str) -> tuple[re.Pattern[str], re.Pattern[str]]:
    """Return the expressions for the word that a line of provenance begins with, and for the whole line.

    :param comment: what comments begin with: ``;`` in KRL.
    """
    # the number of the format, or nothing, follows: others may write "Postproc: KRC4" or "Postproc version 3"
    word = rf"{re.escape(comment)}[ \t]*(?i:POSTPROC)(?=[ \t]+\d+\b|[ \t]*[\r\n]|[ \t]*\Z)"
    line = rf"(?:\A|(?<=[\r\n]))[ \t]*{word}([^\r\n]*)(?:\r{{0,2}}\n|\r|\Z)"
    return re.compile(word), re.compile(line)


def _digest_without_line(documents: Sequence[Document], line: re.Match[str]) -> str:
    """Return the SHA-256 of the files of a program, the main one first, without the line that states its origin."""
    return digest_of([_cut_line(documents[0], *line.span()), *documents[1:]])


def _cut_line(document: Document, start: int, stop: int) -> Document:
    """Return a document without the line from `start` to `stop`, offsets in its text."""
    if start == stop:
        return document
    return replace(document, text=document.text[:start] + document.text[stop:])


def _line_at(text: str, offset: int) -> int:
    """Return the 1-based line at an offset in a text."""
    return len(_END.findall(text, 0, offset)) + 1


def _line_end(line: str) -> str:
    """Return the line end of a line; empty if it has none."""
    return line[len(line.rstrip("\r\n")) :]
