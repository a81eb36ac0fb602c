"""The lines of the cell for what a program of a CAM system does besides moving, and whether the robot waits in them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path

from msgspec.structs import replace

from postproc.cell import Cell
from postproc.decimals import number_text
from postproc.dialects.waits import is_wait
from postproc.errors import Issue
from postproc.program import Event, Motions

_CALL = re.compile(r"([A-Za-z_]\w*)[ \t]*\(")
_CALL_STATEMENT = re.compile(rf"[ \t]*{_CALL.pattern}")
_NO_SUBPROGRAMS = frozenset({"BAS", "IF", "PULSE", "SWITCH", "UNTIL", "WHILE"})
"""Words of KRL before a bracket, and the program of the controller that never waits."""
_UNKNOWN_SUBPROGRAM = (
    "A line of the cell calls {name} behind a cut, and {name}.src is neither next to the program nor in a folder of "
    "[krl] search: it is assumed not to wait. If it waits in material, the corrected tool springs beyond the nominal "
    "place. Add its folder to [krl] search."
)


def lines_of(event: Event, cell: Cell) -> list[str]:
    """Return the lines of the cell for an event, with its value inserted; M4 without lines uses the lines of M3."""
    if event.kind == "m_code":
        return list(cell.m_codes[f"M{number_text(event.value)}"])
    lines: Sequence[str] = getattr(cell.gcode, event.kind) or []
    if event.kind == "spindle_ccw":
        lines = lines or cell.gcode.spindle_on or []
    value = number_text(event.value)
    return [line.replace("{S}", value).replace("{T}", value) for line in lines]


def events_with_waits(
    events: Iterable[Event], motions: Motions, folder: str, cell: Cell
) -> tuple[tuple[Event, ...], tuple[Issue, ...]]:
    """Return events, marked where the robot waits in the lines that the cell has for them, and issues about them.

    It waits in a subprogram of KRL too if the `.src` of its name, or of a subprogram that this calls, has a wait. An
    issue names the first subprogram without a file that is called behind a cut.

    :param folder: folder of the program, which is searched before those of `[krl] search`; empty without one.
    """
    subprograms = _Subprograms(_searched_folders(folder, cell))
    marked_events: list[Event] = []
    unknown_calls: dict[str, Event] = {}
    for event in events:
        lines = [] if event.kind in ("dwell", "stop", "comment") else lines_of(event, cell)
        names = _names_called_in(lines)
        waits = any(map(is_wait, lines)) or any(map(subprograms.waits, names))
        marked_events.append(replace(event, waits=True) if waits else event)
        if event.before > 0 and not waits and not motions.rapid[event.before - 1]:
            for name in names:
                if not subprograms.is_known(name):
                    unknown_calls.setdefault(name, event)
    issues = [
        Issue("info", "unknown-subprogram", _UNKNOWN_SUBPROGRAM.format(name=name), event.line, subject=name)
        for name, event in unknown_calls.items()
    ]
    return tuple(marked_events), tuple(issues[:1])


def called_by_cell(folder: Path, cell: Cell) -> list[Path]:
    """Return the `.src` files of the subprograms that lines of the cell call, directly or not, sorted.

    :param folder: folder of the programs, which is searched before those of `[krl] search`.
    """
    lines_of_key = [cell.gcode.spindle_on, cell.gcode.spindle_ccw, cell.gcode.spindle_off, cell.gcode.coolant_on]
    lines_of_key += [cell.gcode.coolant_off, cell.gcode.tool_change, *cell.m_codes.values()]
    subprograms = _Subprograms(_searched_folders(str(folder), cell))
    for name in _names_called_in([line for lines in lines_of_key for line in lines or ()]):
        subprograms.waits(name)
    return subprograms.read_files()


def _searched_folders(folder: str, cell: Cell) -> list[Path]:
    """Return the folders of subprograms: that of the program, if it has one, then those of `[krl] search`."""
    return [*([Path(folder)] if folder else []), *(Path(cell.folder) / name for name in cell.krl.search)]


def _names_called_in(lines: Iterable[str]) -> list[str]:
    """Return the names, upper case, of the subprograms that lines of the cell call."""
    names = [match[1].upper() for line in lines if (match := _CALL_STATEMENT.match(line))]
    return [name for name in names if name not in _NO_SUBPROGRAMS]


class _Subprograms:
    """Subprograms of KRL, each in the `.src` of its name."""

    def __init__(self, folders: Sequence[Path]) -> None:
        """Keep the folders, which are searched when a subprogram is first needed."""
        self._folders = folders
        self._results: dict[str, bool] = {}

    @cached_property
    def _paths(self) -> dict[str, Path]:
        """Name, upper case → its file; of two the one in the first folder."""
        paths: dict[str, Path] = {}
        for folder in self._folders:
            try:
                files = sorted(path for path in folder.iterdir() if path.suffix.upper() == ".SRC")
            except OSError:
                continue  # without the folder, its subprograms are not known
            for path in files:
                paths.setdefault(path.stem.upper(), path)
        return paths

    def is_known(self, name: str) -> bool:
        """Return whether a subprogram, upper case, has a file."""
        return name in self._paths

    def read_files(self) -> list[Path]:
        """Return the files that `waits` has read, sorted."""
        return sorted(self._paths[name] for name in self._results if name in self._paths)

    def waits(self, name: str) -> bool:
        """Return whether the file of a subprogram, or of one that it calls, has a wait; False without a file.

        :param name: its name, upper case.
        """
        if name not in self._results:
            self._results[name] = False  # for a subprogram that calls itself
            path = self._paths.get(name)
            lines = [line.partition(";")[0] for line in _lines_of_file(path)] if path is not None else []
            self._results[name] = any(map(is_wait, lines)) or any(
                self.waits(callee.upper()) for line in lines for callee in _CALL.findall(line)
            )
        return self._results[name]


def _lines_of_file(path: Path) -> list[str]:
    """Return the lines of a file; none if it cannot be read."""
    try:
        return path.read_bytes().decode("latin-1").splitlines()
    except OSError:
        return []
