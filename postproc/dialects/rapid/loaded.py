"""Modules that the controller has loaded in addition to the program: their data, and changes by their routines.

Their routines are not executed: data that they change are unknown behind their calls, and they must not move the robot.

LOCAL data and routines are known in their module only, where they hide those of other modules (3HAC16580). Since data
and routines are found by their names alone, LOCAL names of these modules, and names that the program hides, get the
module while they are parsed: ``CLEAN of CALIBDATA``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
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
    """Modules in addition to the program.

    :ivar data: name → data of all these modules at the beginning of the program, without LOCAL data.
    :ivar documents: the files of the modules.
    """

    modules: tuple[Module, ...] = ()
    data: dict[str, Variable] = {}
    documents: tuple[Document, ...] = ()

    def seen_from(self, program: Sequence[Module]) -> LoadedModules:
        """Return these modules with other names for data and routines that LOCAL ones of the program hide.

        :param program: the modules of the program. LOCAL names hide others in their own module only: nothing is renamed
            if there are several.
        """
        if len(program) != 1:
            return self
        hidden_names = _local_names(program[0]) & {name for module in self.modules for name in _names(module)}
        if not hidden_names:
            return self
        loaded_modules = _parsed(self.documents, hidden_names)
        return LoadedModules(loaded_modules, _global_data(loaded_modules), self.documents)


def load_modules(cell: Cell) -> LoadedModules:
    """Return the modules that [rapid] of a cell names.

    :raises CellError: a file cannot be read, two modules declare one name, or a routine is named like an instruction or
        function of RAPID.
    :raises ProgramError: a file is not RAPID.
    """
    documents = tuple(_document(Path(cell.folder) / name) for name in cell.rapid.modules)
    loaded_modules = _parsed(documents)
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
    return LoadedModules(loaded_modules, _global_data(loaded_modules), documents)


class NameClash(NamedTuple):
    """A name that two modules declare.

    :ivar item: data or routine of the second module.
    """

    item: Declaration | Routine
    first_module: str
    second_module: str


def name_clash(modules_of_task: Iterable[Module]) -> NameClash | None:
    """Return the first declaration whose name an earlier module declares too; None if all names differ.

    LOCAL names of a program with several modules count too: the data or routine that a name means would depend on the
    module.
    """
    module_of: dict[str, str] = {}
    for module in modules_of_task:
        for item in _items(module):
            first_module = module_of.setdefault(item.name, module.name)
            if first_module != module.name:
                return NameClash(item, first_module, module.name)
    return None


def named_like_rapid(modules_of_task: Iterable[Module]) -> Routine | None:
    """Return the first routine that is named like a followed function or instruction of RAPID; None without one.

    A call of this name would be executed as that of RAPID.
    """
    names = {*MOVES, *SETTINGS, *FOLLOWED_FUNCTIONS, *COUNTING}
    return next((routine for module in modules_of_task for routine in module.routines if routine.name in names), None)


def _items(module: Module) -> tuple[Declaration | Routine, ...]:
    """Return the data and routines of a module."""
    return (*module.data, *module.routines)


def _names(module: Module) -> set[str]:
    """Return the names of the data and routines of a module."""
    return {item.name for item in _items(module)}


def _local_names(module: Module) -> set[str]:
    """Return the names of the LOCAL data and routines of a module."""
    return {item.name for item in _items(module) if item.is_local}


def _parsed(documents: Sequence[Document], hidden_names: Set[str] = frozenset()) -> tuple[Module, ...]:
    """Return the modules of some files, with other names for data and routines that the program does not see.

    These are LOCAL ones of the modules, and those that have the names of LOCAL ones of the program.

    :param hidden_names: names of LOCAL data and routines of the program.
    :raises ProgramError: a file is not valid RAPID.
    """
    parsed_modules = tuple(module for document in documents for module in _modules_of(document, {}))
    # data and routines that are not LOCAL
    hidden = {
        name: f"{name} of {module.name}"
        for module in parsed_modules
        for name in (_names(module) - _local_names(module)) & hidden_names
    }
    local_names = {
        module.name: {name: f"{name} of {module.name}" for name in _local_names(module)} for module in parsed_modules
    }
    if not hidden and not any(local_names.values()):
        return parsed_modules
    renamed = {module_name: hidden | names for module_name, names in local_names.items()}
    return tuple(module for document in documents for module in _modules_of(document, renamed))


def _modules_of(document: Document, renamed: Mapping[str, Mapping[str, str]]) -> tuple[Module, ...]:
    """Return the modules of a file.

    :param renamed: module → name → name that replaces it in this module, all in upper case.
    :raises ProgramError: the file is not valid RAPID.
    """
    try:
        return modules(document.text, renamed)
    except RapidSyntaxError as cause:
        starts, stops = line_spans(document.text)
        row = int((starts <= cause.start).sum()) - 1  # index of the last line that begins at or before the error
        line_text = document.text[starts[row] : stops[row]].strip()
        advice = "Check the file in RobotStudio, or leave it out of [rapid] modules."
        raise ProgramError(cause.problem, file=document.name, line=row + 1, text=line_text, advice=advice) from None


def _document(file: Path) -> Document:
    """Return the text of a module file.

    :raises CellError: the file cannot be read.
    """
    try:
        return decode(file.name, file.read_bytes())
    except OSError as cause:
        problem = f"[rapid] modules: it cannot be read ({cause.strerror})"
        raise CellError(problem, file=str(file), advice="The path is relative to the cell.") from cause


def _global_data(loaded_modules: tuple[Module, ...]) -> dict[str, Variable]:
    """Return the data of modules that are not LOCAL, with their values, or with the reason why a value is not known."""
    declarations = {item.name: item for module in loaded_modules for item in module.data}
    declared = {
        name: Variable(item.type, declaration=item, has_declared_value=item.value is not None)
        for name, item in declarations.items()
    }
    predefined = {name: Variable(type_, value) for name, (value, type_) in predefined_data().items()}
    scope = Scope({**predefined, **declared})
    data: dict[str, Variable] = {}
    for name, item in declarations.items():
        if item.is_local:
            continue
        # without the text of its value: a correction never changes another file
        variable = Variable(item.type, declaration=replace(item, value=None), has_declared_value=True)
        if item.value is None:
            variable.unknown_reason = "its module gives it no value"
        else:
            try:
                variable.value, _ = evaluate(item.value, scope)
            except (UnknownValueError, RecursionError) as cause:
                variable.unknown_reason = (
                    cause.problem if isinstance(cause, UnknownValueError) else "it refers to itself"
                )
        data[name] = variable
    return data
