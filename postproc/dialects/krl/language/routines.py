"""The routines of a `.src`: lines of DEF and END, parameters, and names that the routines declare."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.parser import statement, statement_at
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tree import Declaration, Definition, FaultyStatement, Motion, Parameter
from postproc.errors import ProgramError
from postproc.program import Ints

_INCOMPLETE_ADVICE = "Check that the file was transferred completely."


class Routine(Struct, frozen=True, eq=False):
    """A DEF or DEFFCT.

    Lines are 1-based and in order.

    :param source: the file that contains it.
    :param name: upper case.
    :param parameters: in the order of the text.
    :param is_global: True for GLOBAL.
    :param first: line of DEF.
    :param last: line of END.
    :param motion_lines: (P,) lines of plain motions, which are read in bulk.
    :param setting_lines: lines of plain settings, which only assign system variables.
    :param other_lines: the other lines with code.
    :param local_names: names that it declares, and its parameters; upper case.
    :param types: local name → declared type, both upper case; a parameter may have no entry.
    :param result_type: type of the value that a function returns, upper case; empty for DEF.
    """

    source: Source
    name: str
    parameters: tuple[Parameter, ...]
    is_global: bool
    first: int
    last: int
    motion_lines: Ints
    setting_lines: Sequence[int]
    other_lines: Sequence[int]
    local_names: frozenset[str]
    types: Mapping[str, str]
    result_type: str

    @property
    def statement_lines(self) -> Sequence[int]:
        """Lines with code that are not plain motions, ascending."""
        return sorted([*self.other_lines, *self.setting_lines]) if self.setting_lines else self.other_lines

    @property
    def first_motion_line(self) -> int:
        """First line with a plain motion; 0 if there is none."""
        return int(self.motion_lines[0]) if len(self.motion_lines) else 0


class Module(Struct, frozen=True, eq=False):
    """A `.src` and its `.dat`.

    :param source: the `.src`.
    :param routines: name, upper case → routine, in the order of the file.
    :param data: the `.dat`; None if there is none.
    """

    source: Source
    routines: dict[str, Routine]
    data: Source | None = None

    @property
    def name(self) -> str:
        """Name of the file without its extension, upper case."""
        return PurePath(self.source.document.name).stem.upper()

    def main_routine(self, name: str) -> Routine | None:
        """Return the routine with a name, in any case; otherwise the first routine of the file; None if it has none."""
        return self.routines.get(name.upper(), next(iter(self.routines.values()), None))


class Callee(NamedTuple):
    """A called routine, and the file that contains it."""

    module: Module
    routine: Routine


class _OpenRoutine(Struct, eq=False):
    """A routine whose END has not been reached.

    :ivar name: upper case.
    :ivar line: line of its DEF.
    :ivar lines: lines with code behind DEF, without plain motions and plain settings.
    """

    name: str
    line: int
    definition: Definition
    lines: list[int] = []


def routines(
    source: Source, lines: Sequence[int], motion_lines: Ints, settings: Sequence[int] = ()
) -> tuple[dict[str, Routine], list[ProgramError]]:
    """Return the routines of a file (name, upper case → routine), and the errors in their bounds.

    Errors are a DEF without END or that cannot be read, and a motion outside of DEF … END. If two routines have one
    name, the first counts. Plain motions and plain settings are lines of simple form, which are read in bulk.

    :param lines: 1-based lines that are neither plain motions nor plain settings.
    :param motion_lines: (P,) lines of plain motions, ascending.
    :param settings: lines of plain settings, which only assign system variables, ascending.
    """
    routine_of: dict[str, Routine] = {}
    faults: list[ProgramError] = []
    open_routine: _OpenRoutine | None = None

    def end_routine(routine: _OpenRoutine, end_line: int) -> None:
        """Add a routine whose END is on a line to `routine_of`."""
        closed_routine = _closed_routine(source, routine, end_line, motion_lines, settings)
        routine_of.setdefault(routine.name, closed_routine)

    for line in lines:
        start, stop = source.code_span(line)
        if start == stop or source.text[start] == "&":  # an empty line, or one of the header
            continue
        node = statement_at(source, line, start, stop)
        if isinstance(node, Definition):
            if open_routine is not None:
                problem = f"DEF {open_routine.name} (line {open_routine.line}) has no END"
                faults.append(source.line_error(problem, line, advice="Write END before this DEF."))
                end_routine(open_routine, line)
            open_routine = _OpenRoutine(node.name.upper(), line, node)
        elif isinstance(node, FaultyStatement) and node.word in ("DEF", "DEFFCT"):
            faults.append(node.error)
        elif node.word in ("END", "ENDFCT") and open_routine is not None:
            end_routine(open_routine, line)
            open_routine = None
        elif open_routine is not None:
            open_routine.lines.append(line)
        elif isinstance(node, Motion):
            problem = f"{node.word} is outside of DEF … END"
            faults.append(source.line_error(problem, line, advice="Move it into a routine."))
    if open_routine is not None:
        faults.append(source.line_error(f"DEF {open_routine.name} has no END", open_routine.line, _INCOMPLETE_ADVICE))
        end_routine(open_routine, len(source.starts) + 1)
    return routine_of, faults


def _closed_routine(
    source: Source, open_routine: _OpenRoutine, end_line: int, motion_lines: Ints, settings: Sequence[int]
) -> Routine:
    """Return a routine whose END is on a 1-based line, `end_line`.

    Plain motions and plain settings are lines of simple form, which are read in bulk.

    :param motion_lines: (P,) lines of all plain motions of the file, ascending.
    :param settings: lines of all plain settings of the file, ascending.
    """
    types: dict[str, str] = {}  # local name → declared type
    for inner_line in open_routine.lines:
        node = statement(source, inner_line)
        if isinstance(node, Declaration) and not node.is_global and node.word != "STRUC":
            types |= {item.name: item.kind for item in node.names}
    # lines ascend: those between DEF and END
    motion_lines = motion_lines[slice(*np.searchsorted(motion_lines, [open_routine.line, end_line]).tolist())]
    settings = settings[bisect_left(settings, open_routine.line) : bisect_left(settings, end_line)]
    definition = open_routine.definition
    return Routine(
        source=source,
        name=open_routine.name,
        parameters=definition.parameters,
        is_global=definition.is_global,
        first=open_routine.line,
        last=end_line,
        motion_lines=motion_lines,
        setting_lines=settings,
        other_lines=open_routine.lines,
        local_names=frozenset({parameter.name for parameter in definition.parameters} | types.keys()),
        types=types,
        result_type=definition.result_type,
    )
