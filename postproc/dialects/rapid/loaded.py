"""Modules that the controller has loaded beside the program: their data, and what their routines change.

Their routines are not run here: what they change is not known from their call on, and they must not move the robot.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.dialects.rapid.instructions import COUNTING, MOVES, SETTINGS
from postproc.dialects.rapid.syntax import Declaration, Module, RapidSyntaxError, Routine, modules
from postproc.dialects.rapid.values import (
    FOLLOWED_FUNCTIONS,
    Scope,
    UnknownValueError,
    Variable,
    evaluate,
    predefined_data,
)
from postproc.dialects.text import decode, line_spans
from postproc.errors import CellError, ProgramError
from postproc.program import Document


class LoadedModules(Struct, frozen=True, eq=False):
    """Modules beside the program.

    :ivar data: of all of them, by name, as when the program begins. LOCAL data are not among them.
    """

    modules: tuple[Module, ...] = ()
    data: dict[str, Variable] = {}


def load_modules(cell: Cell) -> LoadedModules:
    """Return the modules that a cell names.

    :raises CellError: a file cannot be read, or a name in it has another meaning too.
    :raises ProgramError: a file is not RAPID.
    """
    files = [Path(cell.folder) / name for name in cell.rapid.modules]
    loaded_modules = tuple(module for file in files for module in _modules_of(file))
    clash = name_clash(loaded_modules)
    if clash is not None:
        module_names = f"{clash.first_module} and {clash.second_module}"
        advice = "Name those modules only that the controller loads with the program."
        problem = f"[rapid] modules: {clash.item.name} is declared in two of them, {module_names}"
        raise CellError(problem, advice=advice)
    routine = named_like_rapid(loaded_modules)
    if routine is not None:
        problem = f"[rapid] modules: {routine.kind} {routine.name} has the name of an instruction or function of RAPID"
        raise CellError(problem, advice="Leave its module out, or give it another name.")
    return LoadedModules(loaded_modules, _data(loaded_modules))


class NameClash(NamedTuple):
    """Data or a routine whose name another module declares before, and the names of the two modules."""

    item: Declaration | Routine
    first_module: str
    second_module: str


def name_clash(modules_of_task: Iterable[Module]) -> NameClash | None:
    """Return the first declaration whose name an earlier module declares too; None if all names differ.

    A LOCAL name counts too: which one is meant depends on the module.
    """
    module_of: dict[str, str] = {}
    for module in modules_of_task:
        items: tuple[Declaration | Routine, ...] = (*module.data, *module.routines)
        for item in items:
            first_module = module_of.setdefault(item.name, module.name)
            if first_module != module.name:
                return NameClash(item, first_module, module.name)
    return None


def named_like_rapid(modules_of_task: Iterable[Module]) -> Routine | None:
    """Return the first routine with the name of a function of RAPID, or of an instruction that is followed.

    Its name would mean another thing there than on other controllers.
    """
    names = {*MOVES, *SETTINGS, *FOLLOWED_FUNCTIONS, *COUNTING}
    return next((routine for module in modules_of_task for routine in module.routines if routine.name in names), None)


def _modules_of(file: Path) -> tuple[Module, ...]:
    """Return the modules of a file.

    :raises CellError: it cannot be read.
    :raises ProgramError: it is no valid RAPID.
    """
    document = _document(file)
    try:
        return modules(document.text)
    except RapidSyntaxError as cause:
        starts, stops = line_spans(document.text)
        row = int((starts <= cause.start).sum()) - 1  # the last line that begins at the fault or before it
        line_text = document.text[starts[row] : stops[row]].strip()
        advice = "Check the file in RobotStudio, or leave it out of [rapid] modules."
        raise ProgramError(cause.problem, file=file.name, line=row + 1, text=line_text, advice=advice) from None


def _document(file: Path) -> Document:
    """Return the text of a module file.

    :raises CellError: it cannot be read.
    """
    try:
        return decode(file.name, file.read_bytes())
    except OSError as cause:
        problem = f"[rapid] modules: it cannot be read ({cause.strerror})"
        raise CellError(problem, file=str(file), advice="The path is relative to the cell.") from cause


def _data(loaded_modules: tuple[Module, ...]) -> dict[str, Variable]:
    """Return the data of modules with their values; where one is not known, with the reason."""
    declarations = {item.name: item for module in loaded_modules for item in module.data}
    declared = {
        name: Variable(item.type, declaration=item, literal=item.value is not None)
        for name, item in declarations.items()
    }
    predefined = {name: Variable(type_, value) for name, (value, type_) in predefined_data().items()}
    scope = Scope({**predefined, **declared})
    data: dict[str, Variable] = {}
    for name, item in declarations.items():
        if item.local:
            continue
        # without the text of its value: a correction never changes another file
        variable = Variable(item.type, declaration=replace(item, value=None), literal=True)
        if item.value is None:
            variable.why = "its module gives it no value"
        else:
            try:
                variable.value, _ = evaluate(item.value, scope)
            except (UnknownValueError, RecursionError) as cause:
                variable.why = cause.problem if isinstance(cause, UnknownValueError) else "it refers to itself"
        data[name] = variable
    return data
