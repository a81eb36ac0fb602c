"""A KRL program under another name: files, DEF and DEFDAT, and the calls of its parts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePath

from msgspec.structs import replace

from postproc.dialects.krl.language.names import MAX_LENGTH, unused
from postproc.dialects.krl.language.parts import MAIN, beyond, called
from postproc.dialects.krl.language.tokens import NAME
from postproc.program import Document

_HEAD = re.compile(r"((?:\A|(?<=[\r\n]))[ \t]*(?:GLOBAL[ \t]+)?(?:DEF|DEFDAT)[ \t]+)[A-Za-z_$][\w$]*", re.IGNORECASE)
_PUBLIC = re.compile(r"^[ \t]*(?:DECL[ \t]+)?GLOBAL\b[^;\r\n]*", re.IGNORECASE | re.MULTILINE)


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
    known = {document.name.lower(): document for document in documents}
    more = beyond(documents[0], lambda name: known.get(name.lower()))
    parts = [*(call for call, _ in calls), *(PurePath(document.name).stem for document in more)]
    stems = {f"{old}{MAIN}": f"{new}{MAIN}"} | {part: f"{new}{part[len(old) :]}" for part in parts}
    spelt = {one.lower(): other for one, other in stems.items()}
    family = [document for document in documents if PurePath(document.name).stem.lower() in spelt]
    inside = re.compile(rf"\b(?:{'|'.join(map(re.escape, stems))})(?=[ \t]*\([ \t]*\)|[ \t]*[\r\n])", re.IGNORECASE)
    public = _public_names(family, old, new)
    out = []
    for document in documents:
        if document not in family:
            out.append(document)
            continue
        text = inside.sub(lambda match: spelt[match[0].lower()], document.text)
        if public:
            text = NAME.sub(lambda match: public.get(match[0].upper(), match[0]), text)
        out.append(_renamed(replace(document, text=text), spelt[PurePath(document.name).stem.lower()]))
    return tuple(out)


def _public_names(documents: Sequence[Document], old: str, new: str) -> dict[str, str]:
    """Return new names for GLOBAL ones, upper case, that begin with the name of their program."""
    found: dict[str, str] = {}
    lines = (line for document in documents for line in _PUBLIC.findall(document.text))
    for name in (word for line in lines for word in NAME.findall(line)):
        if name.upper().startswith(f"{old}_".upper()) and name.upper() not in found:
            fresh = f"{new}{name[len(old) :]}"[:MAX_LENGTH]
            taken = {other.upper() for other in found.values()}
            found[name.upper()] = unused(fresh, taken) if fresh.upper() in taken else fresh
    return found


def with_name(text: str, name: str) -> str:
    """Return the text of a file with another name behind its first DEF or DEFDAT."""
    return _HEAD.sub(lambda match: match[1] + name, text, count=1)


def _renamed(document: Document, name: str) -> Document:
    return replace(document, name=f"{name}{PurePath(document.name).suffix}", text=with_name(document.text, name))
