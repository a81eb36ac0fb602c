"""Files beside a program that it needs to run, and that stay as they are: what it calls, and what declares for it.

A controller knows a module as a whole: a name that is nowhere stops it, though it stands in a routine that is not
called. Files of the controller's own (``$config.dat``), submit programs, and the folders that the cell names, which are
the controller's too, stay where they are.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from pathlib import Path, PurePath

from postproc.dialects.krl.language.names import NAME, PURE, RESERVED, STANDARD
from postproc.dialects.krl.read.folder_files import FolderFiles
from postproc.dialects.krl.read.library import GLOBAL_ROUTINE
from postproc.dialects.krl.read.shared_data import GLOBAL_VARIABLE
from postproc.errors import ProgramError
from postproc.program import Document, Needed

_NO_CODE = re.compile(r"\"[^\"\r\n]*\"|;[^\r\n]*")
_CALLING = re.compile(r"(?:\A|(?<=[\r\n]))[^\r\n(]*+\([^\r\n]*")
_CALL = re.compile(r"([A-Za-z_]\w*)[ \t]*\(", re.ASCII)
_OWN = re.compile(r"^[ \t]*(?:GLOBAL[ \t]+)?DEF(?:FCT[ \t]+\w+(?:[ \t]*\[[ ,\t]*\])?)?[ \t]+(\w+)", re.I | re.M)
_IMPORTED = re.compile(r"/R1/(\w+)[ \t]*\.\.", re.IGNORECASE)


def needed(documents: Sequence[Document], files: FolderFiles, moving: Collection[str]) -> tuple[Needed, ...]:
    """Return the files beside a program that it needs, in order of their names.

    :param documents: its files, with those that are written with it; the main one first.
    :param moving: names, upper case, of files with routines that it calls and that move the robot.
    """
    folder = Path(documents[0].folder)
    known = {document.name.upper() for document in documents}
    beside = {
        name: path
        for name, path in files.paths.items()
        if path.parent == folder and name not in known and name[0] != "$" and not name.endswith(".SUB")
    }
    if not documents[0].folder or not beside:
        return ()
    links = _Links(beside, files)
    found: set[str] = set()
    texts = [document.text for document in documents]
    while texts:
        for name in links.of(texts.pop()) - found:
            found.add(name)
            with suppress(ProgramError):  # it is needed all the same
                texts.append(files.source(beside[name]).text)
    return tuple(Needed(str(beside[name]), moves=name in moving) for name in sorted(found))


class _Links:
    """Says which files a text names."""

    def __init__(self, beside: dict[str, Path], files: FolderFiles) -> None:
        self.beside = beside
        self.routines = {PurePath(name).stem: name for name in beside if name.endswith(".SRC")}
        self.variables: dict[str, set[str]] = {}
        for name, path in beside.items():
            if name.endswith(".SRC"):
                for own in files.declared(path, GLOBAL_ROUTINE):
                    self.routines.setdefault(own, name)
            else:
                for own in files.declared(path, GLOBAL_VARIABLE):
                    self.variables.setdefault(own, set()).add(name)

    def of(self, text: str) -> set[str]:
        """Return the names of the files that a text names, and of those that belong to them."""
        calling = _NO_CODE.sub(" ", "\n".join(_CALLING.findall(text)))
        called = {name.upper() for name in _CALL.findall(calling)} - {name.upper() for name in _OWN.findall(calling)}
        called -= PURE | STANDARD | RESERVED
        stems = {PurePath(self.routines[name]).stem for name in called & self.routines.keys()}
        stems |= {name.upper() for name in _IMPORTED.findall(text)}
        if self.variables:
            used = {name.upper() for name in NAME.findall(_NO_CODE.sub(" ", text))} & self.variables.keys()
            stems |= {PurePath(file).stem for name in used for file in self.variables[name]}
        return set(self._files(stems))

    def _files(self, stems: Collection[str]) -> Iterator[str]:
        for stem in stems:
            yield from (name for name in (f"{stem}.SRC", f"{stem}.DAT") if name in self.beside)
