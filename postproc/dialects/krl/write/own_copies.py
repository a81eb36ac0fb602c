"""Subprograms under other names: copies for one program, where other programs have others of the same name."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import PurePath

from msgspec.structs import replace

from postproc.dialects.krl.language.names import MAX_LENGTH, fault_of, unused
from postproc.dialects.krl.language.tokens import NAME
from postproc.program import Document

_PUBLIC = re.compile(r"^[ \t]*(?:DECL[ \t]+)?GLOBAL\b", re.IGNORECASE | re.MULTILINE)
_TOKEN = re.compile(r"\"[^\"\r\n]*\"|;[^\r\n]*|[A-Za-z_$][\w$]*", re.ASCII)
_HEAD = re.compile(r"(?:DEF|DEFDAT|EXT)[ \t]+\Z", re.IGNORECASE)
_PATH = re.compile(r"/R1/\Z", re.IGNORECASE)


def own_copies(
    documents: Sequence[Document],
    unchanged: Sequence[bytes],
    stems: Sequence[str],
    program: str,
    taken: Collection[str],
) -> tuple[tuple[Document, ...], dict[str, str]] | None:
    """Return the files of a program with other names for some of its subprograms, and for those that call them.

    Only names change: of the files, behind DEF, DEFDAT and EXT, before the bracket of a call, and behind ``/R1/``.

    :param documents: files of the program and of its subprograms, the main file first.
    :param unchanged: contents of files that are written with them and must stay as they are.
    :param stems: names of the files to be renamed, without extension.
    :param program: name of the program, which becomes a part of the new names.
    :param taken: names of other files, without extension, lower case.
    :returns: the files, and new file name → old file name. None where a name is used in another way (in a string, as a
        variable), where an unchanged file uses it, or where a file declares something GLOBAL: the controller would know
        that twice.
    """
    main = PurePath(documents[0].name).stem.upper()
    old = {stem.upper() for stem in stems}
    own = {PurePath(document.name).stem.upper() for document in documents}
    while True:  # what calls a copy is another one too
        calling = {
            PurePath(document.name).stem.upper() for document in documents if not old.isdisjoint(_names(document.text))
        }
        if (calling - {main}) <= old:
            break
        old |= calling - {main}
    if main in old or not old <= own or any(not old.isdisjoint(_names(text.decode("latin-1"))) for text in unchanged):
        return None
    used = {name.upper() for name in taken} | own
    used |= {name for document in documents for name in _names(document.text)}
    new: dict[str, str] = {}
    for stem in sorted({PurePath(d.name).stem for d in documents if PurePath(d.name).stem.upper() in old}):
        if stem.upper() not in new:
            wanted = f"{stem}_{program}"
            fits = wanted.upper() not in used and len(wanted) <= MAX_LENGTH
            new[stem.upper()] = wanted if fits else unused(wanted, used)
            used.add(new[stem.upper()].upper())
    if any(fault_of(name) for name in new.values()):
        return None
    out: list[Document] = []
    names: dict[str, str] = {}
    for document in documents:
        path = PurePath(document.name)
        text = _renamed(document.text, new)
        if text is None or (path.stem.upper() in old and _PUBLIC.search(document.text)):
            return None
        name = f"{new[path.stem.upper()]}{path.suffix}" if path.stem.upper() in old else document.name
        if name != document.name:
            names[name] = document.name
        out.append(replace(document, name=name, text=text))
    return tuple(out), names


def _names(text: str) -> set[str]:
    """Return the names in a text, upper case; those in strings too, those in comments not."""
    found: set[str] = set()
    for match in _TOKEN.finditer(text):
        if match[0][0] != ";":
            found.update(name.upper() for name in NAME.findall(match[0]))
    return found


def _renamed(text: str, new: Mapping[str, str]) -> str | None:
    """Return a text with other names for routines; None if one of the names is used in another way."""
    pieces: list[str] = []
    last = 0
    for match in _TOKEN.finditer(text):
        if match[0][0] == '"' and any(name.upper() in new for name in NAME.findall(match[0])):
            return None
        name = new.get(match[0].upper())
        if name is None:
            continue
        before, after = text[max(0, match.start() - 80) : match.start()], text[match.end() : match.end() + 80]
        if not (re.match(r"[ \t]*\(", after) or _HEAD.search(before) or _PATH.search(before)):
            return None
        pieces += [text[last : match.start()], name]
        last = match.end()
    return "".join([*pieces, text[last:]])
