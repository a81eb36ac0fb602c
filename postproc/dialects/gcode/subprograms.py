"""Where subprograms stand: in the file that calls them, in the program, or in another file of its folder.

``O<name> CALL`` is looked for in ``name.ngc``, M98 P100 in ``100.ngc``, ``O100.nc``, ``o0100.nc`` and so on, first with
the extension of the program.
"""

from __future__ import annotations

import re
from pathlib import Path

from msgspec.structs import replace

from postproc.dialects.gcode import words
from postproc.dialects.gcode.blocks import BlockError
from postproc.dialects.gcode.control import Unit
from postproc.dialects.text import decode, line_starts
from postproc.errors import ProgramError

_EXTENSIONS = (".ngc", ".nc", ".tap", ".cnc", ".gcode", ".mpf", ".ptp", ".txt", ".sub", "")


class Library:
    """The files of a program.

    :ivar units: the program, and the files of its folder that it has called, in that order.
    """

    def __init__(self, program: Unit) -> None:
        self.units = [program]
        self._files: dict[str, Path] | None = None

    def find(self, label: str, caller: int, *, own: bool) -> tuple[int, int] | None:
        """Return file and first row of a subprogram; None if there is none of this name.

        :param caller: row of `units` that calls it.
        :param own: whether it is of LinuxCNC's kind.
        :raises BlockError: its file cannot be read.
        """
        for n in dict.fromkeys((caller, 0)):
            place = (self.units[n].subs if own else self.units[n].numbers).get(label)
            if place is not None:
                return n, place + 1
        loaded = self._loaded(label)
        if loaded is None:
            return None
        unit = self.units[loaded]
        place = (unit.subs if own else unit.numbers).get(label, -1)
        if own and place < 0:
            raise BlockError(f"{unit.document.name} has no O<{label}> SUB", None)
        return loaded, place + 1

    def _loaded(self, label: str) -> int | None:
        """Return the file of the folder that a subprogram stands in."""
        for n, unit in enumerate(self.units):
            if n and _stem(unit.document.name) == label:
                return n
        path = self._file(label)
        if path is None:
            return None
        try:
            document = replace(decode(path.name, path.read_bytes()), folder=str(path.parent))
        except OSError as cause:
            raise BlockError(f"subprogram O{label}: {path.name} cannot be read ({cause.strerror})", None) from cause
        except ProgramError as cause:
            raise BlockError(f"subprogram O{label}: {cause.problem}", None) from cause
        unit = Unit.of(document, words.split(document, line_starts(document.text)))
        if unit.faults:
            problem, line = unit.faults[0].problem, unit.faults[0].row + 1
            raise BlockError(f"subprogram O{label}: {path.name}:{line}: {problem}", None)
        self.units.append(unit)
        return len(self.units) - 1

    def _file(self, label: str) -> Path | None:
        main = self.units[0].document
        if self._files is None:
            self._files = {}
            folder = Path(main.folder) if main.folder else None
            for path in sorted(folder.iterdir()) if folder is not None and folder.is_dir() else ():
                if path.name != main.name and path.suffix.lower() in (*_EXTENSIONS, Path(main.name).suffix.lower()):
                    self._files[path.name.lower()] = path
        for extension in dict.fromkeys((Path(main.name).suffix.lower(), *_EXTENSIONS)):
            for name, path in self._files.items():
                if Path(name).suffix == extension and _stem(name) == label and path.is_file():
                    return path
        return None


def _stem(file: str) -> str:
    """Return the label that a file is named by: ``O0100.nc`` → ``100``."""
    stem = Path(file).stem.lower()
    number = re.fullmatch(r"o?(\d+)", stem)
    return stem if number is None else str(int(number[1]))
