"""The routines of a `.src`: where DEF and DEFFCT begin and end, their parameters and the names that are their own."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from pathlib import PurePath

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tree import Declaration, Definition, Motion, Parameter
from postproc.errors import ProgramError
from postproc.program import Ints

_INCOMPLETE = "Check that the file was transferred completely."


class Routine(Struct, frozen=True, eq=False):
    """A DEF or DEFFCT.

    :param source: its file.
    :param name: upper case.
    :param parameters: in order.
    :param public: True for GLOBAL.
    :param first: line of DEF.
    :param last: line of END.
    :param plain: (P,) lines of plain motions between, in order.
    :param settings: lines of plain settings.
    :param others: other lines with code.
    :param local: names that it declares, parameters included.
    :param types: declared type of these by name, upper case; a parameter may have none.
    :param result: type of what a function returns, upper case; empty for DEF.
    """

    source: Source
    name: str
    parameters: tuple[Parameter, ...]
    public: bool
    first: int
    last: int
    plain: Ints
    settings: Sequence[int]
    others: Sequence[int]
    local: frozenset[str]
    types: Mapping[str, str]
    result: str

    @property
    def lines(self) -> Sequence[int]:
        """Lines with code between, plain motions left out."""
        return sorted([*self.others, *self.settings]) if self.settings else self.others

    @property
    def motion(self) -> int:
        """Line of the first plain motion in it; 0 if there is none."""
        return int(self.plain[0]) if len(self.plain) else 0


class Module(Struct, frozen=True, eq=False):
    """A `.src` and its `.dat`.

    :param routines: by name, upper case, in order.
    :param data: the `.dat`, None if there is none.
    """

    source: Source
    routines: dict[str, Routine]
    data: Source | None = None

    @property
    def name(self) -> str:
        """Name of the file without its extension, upper case."""
        return PurePath(self.source.document.name).stem.upper()

    def main(self, name: str) -> Routine | None:
        """Return the routine of a given name, else the first one."""
        return self.routines.get(name.upper(), next(iter(self.routines.values()), None))


class _Begun(Struct, eq=False):
    """A routine that has no END yet."""

    name: str
    line: int
    definition: Definition
    lines: list[int] = []


def routines(
    source: Source, lines: Sequence[int], plain: Ints, settings: Sequence[int] = ()
) -> tuple[dict[str, Routine], list[ProgramError]]:
    """Return the routines of a file, and the errors in their bounds: no END, a motion outside of DEF … END.

    :param lines: 1-based lines that are neither plain motions nor plain settings.
    :param plain: (P,) those that are plain motions, in order.
    :param settings: those that are known to assign something to system variables and to do nothing else, in order.
    """
    found: dict[str, Routine] = {}
    faults: list[ProgramError] = []
    begun: _Begun | None = None
    text = source.text
    for line in lines:
        start, stop = source.code_span(line)
        if start == stop or text[start] == "&":
            continue
        here = statement(source, line)
        if isinstance(here, Definition):
            if begun is not None:
                faults.append(source.line_error(f"DEF {begun.name} (line {begun.line}) has no END", line))
                found.setdefault(begun.name, _ended(source, begun, line, plain, settings))
            begun = _Begun(here.name.upper(), line, here)
        elif here.word in ("END", "ENDFCT") and begun is not None:
            found.setdefault(begun.name, _ended(source, begun, line, plain, settings))
            begun = None
        elif begun is not None:
            begun.lines.append(line)
        elif isinstance(here, Motion):
            faults.append(source.line_error(f"{here.word} is outside of DEF … END", line))
    if begun is not None:
        faults.append(source.line_error(f"DEF {begun.name} has no END", begun.line, _INCOMPLETE))
        found.setdefault(begun.name, _ended(source, begun, len(source.starts) + 1, plain, settings))
    return found, faults


def _ended(source: Source, begun: _Begun, line: int, plain: Ints, settings: Sequence[int]) -> Routine:
    types: dict[str, str] = {}
    for inside in begun.lines:
        here = statement(source, inside)
        if isinstance(here, Declaration) and not here.public and here.word != "STRUC":
            types |= {one.name: one.kind for one in here.names}
    plain = plain[slice(*np.searchsorted(plain, [begun.line, line]).tolist())]
    settings = settings[bisect_left(settings, begun.line) : bisect_left(settings, line)]
    return Routine(
        source,
        begun.name,
        begun.definition.parameters,
        begun.definition.public,
        begun.line,
        line,
        plain,
        settings,
        begun.lines,
        frozenset({parameter.name for parameter in begun.definition.parameters} | types.keys()),
        types,
        begun.definition.result,
    )
