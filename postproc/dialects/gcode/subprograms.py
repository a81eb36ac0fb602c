"""The files in which subprograms of a program are: those of its folder that are named after them.

``O<name> CALL`` is searched for in ``name.ngc``, M98 P100 in ``100.ngc``, ``O100.nc``, ``o0100.nc`` and so on, first
with the extension of the program.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path

from postproc.dialects.gcode.expressions import nearest_integer

_EXTENSIONS = (".ngc", ".nc", ".tap", ".cnc", ".gcode", ".mpf", ".ptp", ".txt", ".sub", "")
_CALL = re.compile(rb"CALL|M(?:0*98|[#\[])")
"""A call, or an M code that is computed; the text has no blanks and is in upper case."""
_O_CALL = re.compile(rb"O(?:<([^<>#]+)>|(\d{1,9}))CALL")
_NUMBER = re.compile(rb"\d{1,9}\.?\d*|\.\d+")


class SubprogramFiles:
    """The files of a folder that may contain subprograms of the programs in it.

    :param folder: the folder, which is listed once; one that does not exist has no files.
    """

    def __init__(self, folder: Path) -> None:
        self._paths: dict[tuple[str, str], list[Path]] = {}  # label and extension → files, sorted
        for path in sorted(folder.iterdir()) if folder.is_dir() else ():
            self._paths.setdefault((label_of_file(path.name), path.suffix.lower()), []).append(path)

    def find_file(self, label: str, program: str) -> Path | None:
        """Return the file that is named after a subprogram; None: there is none.

        Of names that differ in case only, the last one is taken.

        :param program: file name of the program, which is no subprogram of itself; its extension is tried first.
        """
        for extension in _extensions_for(program):
            paths = [path for path in self._paths.get((label, extension), ()) if path.name != program]
            files = [path for path in paths if path.name.lower() == paths[0].name.lower() and path.is_file()]
            if files:
                return files[-1]
        return None

    def numbered_files(self, program: str) -> list[Path]:
        """Return all files that are named after a number, without that of the program, which is given by its name."""
        extensions = _extensions_for(program)
        return [
            path
            for (label, extension), paths in self._paths.items()
            if label.isdecimal() and extension in extensions
            for path in paths
            if path.name != program and path.is_file()
        ]


def _extensions_for(program: str) -> tuple[str, ...]:
    """Return the extensions of files with subprograms, in the order in which they are tried: first the program's."""
    return tuple(dict.fromkeys((Path(program).suffix.lower(), *_EXTENSIONS)))


def label_of_file(file: str) -> str:
    """Return the label of the subprogram in a file by its name: ``O0100.nc`` → ``100``."""
    stem = Path(file).stem.lower()
    number = re.fullmatch(r"o?(\d+)", stem)
    return stem if number is None else str(int(number[1]))


def called_files(programs: Sequence[Path]) -> dict[Path, list[Path]]:
    """Return the files that each program of a folder may call, directly or not, sorted: program → files.

    A call of a computed number may mean all files with a number. Files that cannot be read call no others.
    """
    files = SubprogramFiles(programs[0].parent)
    return {program: _called_files(program, files) for program in programs}


def _called_files(program: Path, files: SubprogramFiles) -> list[Path]:
    """Return the files that a program may call, directly or not, sorted."""
    called_paths: set[Path] = set()
    unread_paths = {program}
    while unread_paths:
        labels = frozenset[str | None]().union(*map(_labels_called_in, unread_paths))
        paths = {files.find_file(label, program.name) for label in labels if label is not None}
        paths.update(files.numbered_files(program.name) if None in labels else ())
        unread_paths = {path for path in paths if path is not None} - called_paths
        called_paths |= unread_paths
    return sorted(called_paths)


def _labels_called_in(path: Path) -> frozenset[str | None]:
    """Return the labels of the subprograms that a file may call; None stands for a computed number."""
    try:
        status = path.stat()
        return _labels_in(path, status.st_mtime_ns, status.st_size)
    except OSError:
        return frozenset()


@lru_cache(maxsize=4096)
def _labels_in(path: Path, mtime: int, size: int) -> frozenset[str | None]:
    """Return the labels of the subprograms that a file may call; time [ns] and size are only keys of the cache.

    :raises OSError: it cannot be read.
    """
    del mtime, size
    text = path.read_bytes().translate(None, b" \t").upper().replace(b"\r", b"\n")
    text += b"\n"
    lines = {
        text[text.rfind(b"\n", 0, match.start()) + 1 : text.find(b"\n", match.end())] for match in _CALL.finditer(text)
    }
    return frozenset(label for line in lines for label in _labels_of_call(line))


def _labels_of_call(line: bytes) -> Iterator[str | None]:
    """Yield the labels that a line with calls may mean; None: a computed number.

    All numbers of a line with M98 count, because any of them may be that of the subprogram.
    """
    calls = _O_CALL.findall(line)
    for name, number in calls:
        yield name.decode("latin-1").lower() if name else str(int(number))
    if calls:
        return
    yield from (str(nearest_integer(float(number))) for number in _NUMBER.findall(line))
    if b"#" in line or b"[" in line:
        yield None
