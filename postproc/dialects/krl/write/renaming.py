"""A KRL program under another name: files, DEF and DEFDAT, and the calls of its parts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePath

from postproc.dialects.krl.language.names import MAX_LENGTH
from postproc.dialects.krl.language.parts import MAIN, called
from postproc.program import Document

_HEAD = re.compile(r"((?:\A|(?<=[\r\n]))[ \t]*(?:GLOBAL[ \t]+)?(?:DEF|DEFDAT)[ \t]+)[A-Za-z_$][\w$]*", re.IGNORECASE)


def renamed(documents: Sequence[Document], name: str) -> tuple[Document, ...]:
    """Return the files of a program with another name; all else stays to the byte.

    :param documents: the `.src`, whose first DEF is the program, and its `.dat`; or the files of a divided program.
        Files of other programs keep their names.
    :param name: one that the controller accepts.
    """
    if not documents:
        return ()
    calls = called(documents[0])
    if not calls:
        own = PurePath(documents[0].name).stem.lower()
        return tuple(
            _renamed(document, name) if PurePath(document.name).stem.lower() == own else document
            for document in documents
        )
    old = PurePath(documents[0].name).stem[: -len(MAIN)]
    new = name[: MAX_LENGTH - len(MAIN)]
    names = {f"{old}{MAIN}": f"{new}{MAIN}"} | {call: f"{new}{call[len(old) :]}" for call, _ in calls}
    inside = re.compile(rf"\b(?:{'|'.join(map(re.escape, names))})(?=[ \t]*\([ \t]*\)|[ \t]*[\r\n])", re.IGNORECASE)
    spelt = {one.lower(): other for one, other in names.items()}
    out = []
    for document in documents:
        text = document.text
        if document is documents[0] or f"of={old}{MAIN}" in text:
            text = inside.sub(lambda match: spelt[match[0].lower()], text)
        stem = spelt.get(PurePath(document.name).stem.lower())
        out.append(_renamed(replace(document, text=text), stem) if stem else document)
    return tuple(out)


def with_name(text: str, name: str) -> str:
    """Return the text of a file with another name behind its first DEF or DEFDAT."""
    return _HEAD.sub(lambda match: match[1] + name, text, count=1)


def _renamed(document: Document, name: str) -> Document:
    return replace(document, name=f"{name}{PurePath(document.name).suffix}", text=with_name(document.text, name))
