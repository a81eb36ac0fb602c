"""Files beside a program that it needs to run, and that stay as they are: what it calls, and what declares for it.

A controller knows a module as a whole: a name that is nowhere stops it, though it stands in a routine that is not
called. Files of the controller's own (``$config.dat``), submit programs, and the folders that the cell names, which are
the controller's too, stay where they are.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path, PurePath

from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import NAME
from postproc.dialects.krl.read.folder_files import FolderFiles, without_comments
from postproc.dialects.krl.read.shared_data import GLOBAL_VARIABLE
from postproc.errors import ProgramError
from postproc.program import Document, Needed

_IMPORTED = re.compile(r"/R1/(\w+)[ \t]*\.\.", re.IGNORECASE)


def needed(
    documents: Sequence[Document], code: Sequence[str], files: FolderFiles, moving: Collection[str]
) -> tuple[Needed, ...]:
    """Return the files beside a program that it needs, in order of their names.

    :param documents: its files, with those that are written with it; the main one first.
    :param code: of its `.src` files, as far as it may name others.
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
    data = (document.text for document in documents if PurePath(document.name).suffix.upper() == ".DAT")
    found = set().union(*map(links.of_code, code), *map(links.of_data, data))
    new = sorted(found)
    while new:
        name = new.pop()
        with suppress(ProgramError):  # it is needed all the same
            text = files.source(beside[name]).text
            more = (links.of_data(text) if name.endswith(".DAT") else links.of_code(text)) - found
            found |= more
            new += sorted(more)
    return tuple(Needed(str(beside[name]), moves=name in moving) for name in sorted(found))


def code_of(source: Source, lines: Iterable[int]) -> str:
    """Return some lines of a file."""
    return "\n".join(source.text[source.starts[line - 1] : source.stops[line - 1]] for line in lines)


class _Links:
    """Says which files a text names."""

    def __init__(self, beside: dict[str, Path], files: FolderFiles) -> None:
        self.beside, self.files = beside, files
        self.variables: dict[str, set[str]] = {}
        for name, path in beside.items():
            for own in files.declared(path, GLOBAL_VARIABLE) if name.endswith(".DAT") else ():
                self.variables.setdefault(own, set()).add(name)

    def of_code(self, text: str) -> set[str]:
        """Return the names of the files that code names, and of those that belong to them."""
        code = without_comments(text)
        stems = {path.stem.upper() for path in self.files.called(code)}
        if self.variables:
            used = {name.upper() for name in NAME.findall(code)} & self.variables.keys()
            stems |= {PurePath(file).stem for name in used for file in self.variables[name]}
        return set(self._files(stems))

    def of_data(self, text: str) -> set[str]:
        """Return the names of the files from which a data list takes variables, and of those that belong to them."""
        return set(self._files({name.upper() for name in _IMPORTED.findall(text)}))

    def _files(self, stems: Collection[str]) -> Iterator[str]:
        for stem in stems:
            yield from (name for name in (f"{stem}.SRC", f"{stem}.DAT") if name in self.beside)
