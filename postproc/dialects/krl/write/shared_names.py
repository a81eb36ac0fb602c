"""Routines and variables that several files of a divided program use: they become GLOBAL under new names.

All programs of a controller see GLOBAL names, so that each new name begins with the name of the program. Variables of
the `.dat` that the program never writes, such as points, need not be GLOBAL: each file has a copy in its own `.dat`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from msgspec import Struct, field
from msgspec.structs import replace

from postproc.dialects.krl.language.declarations import DataLine, DeclaredName, data_lines, declared_in
from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.names import DECLARATIONS, MAX_LENGTH, unused_name
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.parts import MAIN
from postproc.dialects.krl.language.routines import Routine
from postproc.dialects.krl.language.source import DAT, SRC, Source
from postproc.dialects.krl.language.tokens import (
    NAME,
    key_word,
    names_in,
    occurrences,
    skip_blanks,
    skip_word,
    word_at,
)
from postproc.dialects.krl.language.tree import Assignment, CyclicInput, Declaration, Definition, Event, For
from postproc.dialects.krl.write.division import ADVICE, division_error
from postproc.dialects.krl.write.edits import Replacements
from postproc.errors import ProgramError
from postproc.program import Document, Ints


class _Variables(Struct, frozen=True, eq=False):
    """Variables that are declared in one place: the DEF of the main routine, or the `.dat`.

    :ivar users: name, upper case → indices of the files that use it.
    :ivar write_lines: name, upper case → first line that may write it.
    """

    users: dict[str, set[int]] = field(default_factory=dict)
    write_lines: dict[str, int] = field(default_factory=dict)

    def shared_names(self, *, includes_unwritten: bool) -> set[str]:
        """Return the names that several files use.

        :param includes_unwritten: False to leave out names that no statement writes.
        """
        return {
            name
            for name, files in self.users.items()
            if len(files) > 1 and (includes_unwritten or name in self.write_lines)
        }


class SharedProgram(NamedTuple):
    """A program whose shared variables and routines are GLOBAL.

    :ivar source: the edited `.src`; it has as many lines as before.
    :ivar data: its `.dat`; None if it has none.
    :ivar routine_names: old name of each routine, upper case → its new name.
    """

    source: Source
    data: Document | None
    routine_names: dict[str, str]


class DividedProgram(NamedTuple):
    """A program, and the file that will contain each of its lines.

    :ivar source: its `.src`.
    :ivar data: its `.dat`; None if it has none.
    :ivar main: its main routine.
    :ivar subroutines: its other routines, which will be in separate files.
    :ivar file: (L + 1,) index of the file that will contain each line of the `.src`, from 1; element 0 is unused.
    """

    source: Source
    data: Document | None
    main: Routine
    subroutines: Sequence[Routine]
    file: Ints


class Sharing:
    """Finds the names that the files of a divided program share, and makes them GLOBAL in `.src` and `.dat`.

    :param base: beginning of the new GLOBAL names.
    :param used_names: names in use, upper case; the new names are added.
    :ivar data_lines: lines of the `.dat` that are not GLOBAL.
    :ivar declarations_of_line: line of the `.dat` → variables that it declares or initialises.
    :ivar main_declarations: (line, variable) for each declaration of the main routine.
    :ivar main_names: variables of the main routine that may be shared, upper case.
    :ivar unshared_names: its constants and parameters, which are never shared.
    """

    def __init__(self, base: str, program: DividedProgram, used_names: set[str]) -> None:
        """Find the declarations of the main routine and of the `.dat`."""
        self.base, self.used_names = base, used_names
        self.source, data, self.main, self.subroutines, self.file = program
        main = self.main
        self.data = None if data is None else Source.of(data, DAT)
        self.data_lines = [] if self.data is None else [item for item in data_lines(self.data) if not item.is_global]
        self.declarations_of_line = {
            item.line: list(_data_declarations(self.data, item)) for item in self.data_lines if self.data is not None
        }
        self.main_variables, self.data_variables = _Variables(), _Variables()
        self.main_declarations = [(line, item) for line in main.statement_lines for item in self._declarations(line)]
        constant_lines = {line for line, _ in self.main_declarations if self._is_constant(line)}
        self.main_names = {item.name for line, item in self.main_declarations if line not in constant_lines}
        self.unshared_names = {item.name for line, item in self.main_declarations if line in constant_lines}
        self.unshared_names |= {parameter.name for parameter in main.parameters}

    def shared_program(self) -> SharedProgram:
        """Return the program with GLOBAL names; unchanged if nothing is shared and there are no subroutines.

        :raises ProgramError: a shared variable has a type that other files do not know.
        """
        self._note_uses()
        # a line that declares several names becomes GLOBAL as a whole
        local_names = _names_with_line_mates(
            self.main_variables.shared_names(includes_unwritten=True), self._names_by_line(self.main_declarations)
        )
        data_names = [(line, item) for line, names in self.declarations_of_line.items() for item in names]
        shared_data = _names_with_line_mates(
            self.data_variables.shared_names(includes_unwritten=False), self._names_by_line(data_names)
        )
        self._check_types(
            local_names, {item.name: item for _, item in data_names if item.name in shared_data and item.kind}
        )
        new_locals = {name: self._global_name(name) for name in sorted(local_names)}
        global_names = {name: self._global_name(name) for name in sorted(shared_data)}
        routines = {item.name: self._global_name(item.name) for item in self.subroutines if not item.is_global}
        if not new_locals and not global_names and not self.subroutines:
            return SharedProgram(self.source, None if self.data is None else self.data.document, {})
        edits = Replacements()
        declarations = self._move_declarations(new_locals, edits)
        self._rename_uses(new_locals, global_names, routines, edits)
        source = Source.of(replace(self.source.document, text=edits.apply(self.source.text)), SRC)
        return SharedProgram(source, self._data_file(global_names, declarations), routines)

    # --- shared names ----------------------------------------------------------------------------------------------

    def _note_uses(self) -> None:
        """Fill `main_variables` and `data_variables` with the files and lines that use and write each variable."""
        data_names = {item.name for names in self.declarations_of_line.values() for item in names}
        variables = data_names | self.main_names
        if not variables:
            return
        declaration_lines = {line for line, _ in self.main_declarations}
        for routine in (self.main, *self.subroutines):
            for line in range(routine.first + 1, routine.last):
                start, stop = self.source.code_span(line)
                names = variables & names_in(self.source.text, start, stop)  # a fast first search
                if not names or self._declares_type(line) or (routine is self.main and line in declaration_lines):
                    continue
                # the exact search: no names in comments, strings, components and constants of ENUMs
                names &= {item.name for item in occurrences(self.source.text, start, stop)}
                written_names = self._written_names(line)
                for name in names:
                    variable_group = self._owning_variables(name, routine, data_names)
                    if variable_group is not None:
                        variable_group.users.setdefault(name, set()).add(int(self.file[line]))
                        if name in written_names:
                            variable_group.write_lines.setdefault(name, line)

    def _owning_variables(self, name: str, routine: Routine, data_names: Collection[str]) -> _Variables | None:
        """Return the variables, of the main routine or of the `.dat`, among which is what a name means in a routine.

        None if the variable is never shared.

        Local variables of subroutines, and constants and parameters of the main routine, are never shared.
        """
        if routine is self.main and name in self.main_names:
            return self.main_variables
        local_names = self.unshared_names if routine is self.main else routine.local_names
        return self.data_variables if name in data_names and name not in local_names else None

    def _written_names(self, line: int) -> set[str]:
        """Return the names, upper case, that the statement on a line may write.

        These are the target of an assignment, arguments of calls without ``:IN``, and the counter of a FOR. TRIGGER,
        INTERRUPT, ANIN and DIGIN act at another time: they may write all names in them.
        """
        source, node = self.source, statement(self.source, line)
        if isinstance(node, For):
            return {node.name}
        if isinstance(node, Event) or (isinstance(node, CyclicInput) and node.word != "SIGNAL"):
            return names_in(source.text, node.start, node.stop)
        names = {node.target.name} if isinstance(node, Assignment) else set()
        for call in calls(node.values):
            if call.name != "BAS":
                parameters = next((item.parameters for item in self.subroutines if item.name == call.name), ())
                writable_arguments = [
                    argument
                    for index, argument in enumerate(call.arguments)
                    if not (index < len(parameters) and parameters[index].by_value)
                ]
                names = names.union(*(names_in(source.text, item.start, item.stop) for item in writable_arguments))
        return names

    def _check_types(self, local_names: Collection[str], data_names: Mapping[str, DeclaredName]) -> None:
        """Check that shared variables and parameters have no type that only the `.dat` of the program declares.

        :param local_names: shared variables of the main routine.
        :param data_names: shared variables of the `.dat`: name → declaration.
        :raises ProgramError: a variable, a parameter or a result has such a type: other files would not know it.
        """
        types = set() if self.data is None else set(_declared_types(self.data))
        if not types:
            return
        for line, item in self.main_declarations:
            if item.name in local_names and item.kind in types:
                raise self._type_error(item.name, item.kind, line)
        for name, item in data_names.items():
            if item.kind in types:
                raise self._type_error(name, item.kind, self.data_variables.write_lines[name])
        for routine in self.subroutines:
            head = statement(self.source, routine.first)
            result = {head.result_type} if isinstance(head, Definition) and head.result_type else set[str]()
            parameter_names = {parameter.name for parameter in routine.parameters}
            kinds = {
                item.kind
                for line in routine.statement_lines
                for item in self._declarations(line)
                if item.name in parameter_names
            }
            for kind in types.intersection(kinds | result):
                raise self._type_error(f"what {routine.name} takes or gives", kind, routine.first)

    def _type_error(self, subject: str, kind: str, line: int) -> ProgramError:
        """Return the error that a shared variable has a type which is not GLOBAL.

        :param subject: subject of the message: the variable.
        :param kind: the type.
        """
        problem = f"{subject} is used in several of the files, and its type {kind} is not GLOBAL"
        return division_error(self.source, problem, line, f"Declare {kind} in the $config.dat, or: {ADVICE}")

    # --- declarations --------------------------------------------------------------------------------------------

    def _declarations(self, line: int) -> list[DeclaredName]:
        """Return the variables that a line of the `.src` declares; empty for GLOBAL declarations and STRUC."""
        node = statement(self.source, line)
        return list(node.names) if isinstance(node, Declaration) and not node.is_global and node.word != "STRUC" else []

    def _is_constant(self, line: int) -> bool:
        """Return whether a line of the `.src` declares constants."""
        node = statement(self.source, line)
        return isinstance(node, Declaration) and node.is_constant

    def _declares_type(self, line: int) -> bool:
        """Return whether a line of the `.src` is STRUC or ENUM: names in it are not variables."""
        return statement(self.source, line).word in ("STRUC", "ENUM")

    @staticmethod
    def _names_by_line(declarations: Iterable[tuple[int, DeclaredName]]) -> list[set[str]]:
        """Return the set of names that each line declares.

        :param declarations: (line, name) for each declared name.
        """
        lines: dict[int, set[str]] = {}
        for line, item in declarations:
            lines.setdefault(line, set()).add(item.name)
        return list(lines.values())

    # --- edits -------------------------------------------------------------------------------------------------------

    def _global_name(self, name: str) -> str:
        """Return a new GLOBAL name for a name (upper case), and add it to `used_names`.

        It is `base`, an underscore and the old name, shortened if necessary.
        """
        new_name = f"{self.base}_{self._spelling(name)}"[:MAX_LENGTH]
        if new_name.upper() in self.used_names:
            new_name = unused_name(new_name, self.used_names)
        self.used_names.add(new_name.upper())
        return new_name

    def _spelling(self, name: str) -> str:
        """Return a name (upper case) as the `.src` spells it at its first occurrence; unchanged if it is not in it."""
        spellings = (match[0] for match in NAME.finditer(self.source.text) if match[0].upper() == name)
        return next(spellings, name)

    def _move_declarations(self, new_names: Mapping[str, str], edits: Replacements) -> list[str]:
        """Replace declarations of the main routine by comments, and return them as lines for a `.dat`.

        :param new_names: old name, upper case → GLOBAL name.
        :param edits: edits of the `.src`; the comments are added.
        """
        declarations = []
        for line in dict.fromkeys(line for line, item in self.main_declarations if item.name in new_names):
            start, stop = self.source.code_span(line)
            text = self.source.text[start:stop]
            edits.add(start, stop, f"; {text}: GLOBAL in the .dat of {self.base}{MAIN}")
            declarations.append(_global_declaration(_renamed_code(text, new_names)))
        return declarations

    def _rename_uses(
        self,
        new_locals: Mapping[str, str],
        new_globals: Mapping[str, str],
        routines: Mapping[str, str],
        edits: Replacements,
    ) -> None:
        """Rename variables and routines that become GLOBAL in the `.src`; write GLOBAL before the DEF of routines.

        Old names are in upper case.

        :param new_locals: variables of the main routine: old name → new name.
        :param new_globals: variables of the `.dat`: old name → new name.
        :param routines: routines: old name → new name.
        :param edits: edits of the `.src`; the new names are added.
        """
        text = self.source.text
        removed_lines = {line for line, item in self.main_declarations if item.name in new_locals}
        for routine in (self.main, *self.subroutines):
            local_names = self.unshared_names if routine is self.main else routine.local_names
            names = {name: new_name for name, new_name in new_globals.items() if name not in local_names}
            names |= new_locals if routine is self.main else {}
            all_names = names.keys() | routines.keys()
            for line in range(routine.first, routine.last):
                start, stop = self.source.code_span(line)
                is_unchanged = line in removed_lines or self._declares_type(line)
                if is_unchanged or all_names.isdisjoint(names_in(text, start, stop)):
                    continue
                for item in occurrences(text, start, stop):
                    is_call = item.is_called or line == routine.first  # or the name of the routine behind DEF
                    new_name = routines.get(item.name) if is_call else names.get(item.name)
                    if new_name is not None:
                        edits.add(item.start, item.stop, new_name)
            if routine in self.subroutines and not routine.is_global:
                start, _ = self.source.code_span(routine.first)
                edits.add(start, start, "GLOBAL ")

    def _data_file(self, new_globals: Mapping[str, str], declarations: Sequence[str]) -> Document | None:
        """Return the `.dat` with new GLOBAL names and further declarations.

        Without a `.dat`, a new one with these declarations is returned, or None if there are none.

        :param new_globals: variables of the `.dat` that become GLOBAL: old name, upper case → new name.
        :param declarations: lines to be added before ENDDAT.
        """
        if self.data is None:
            if not declarations:
                return None
            body = "".join(f"{line}\r\n" for line in declarations)
            text = f"DEFDAT {self.base}{MAIN} PUBLIC\r\n{body}ENDDAT\r\n"
            return replace(self.source.document, name=f"{self.base}.dat", text=text)
        edits, text = Replacements(), self.data.text
        for line in range(1, len(self.data.starts) + 1):
            start, stop = self.data.code_span(line)
            word = word_at(text, start, stop)
            if word == "DEFDAT" and key_word(text, start, stop, "PUBLIC") is None:
                edits.add(stop, stop, " PUBLIC")
            elif word == "ENDDAT":
                edits.add(start, start, "".join(f"{declaration}\r\n" for declaration in declarations))
        for data_line in self.data_lines:
            if not new_globals.keys().isdisjoint(data_line.names):
                start, stop = self.data.code_span(data_line.line)
                new_line = _renamed_code(text[start:stop], new_globals)
                # a line without a type initialises a name that another line declares
                is_declaration = any(item.kind for item in self.declarations_of_line[data_line.line])
                edits.add(start, stop, _global_declaration(new_line) if is_declaration else new_line)
        return replace(self.data.document, text=edits.apply(text))


def _data_declarations(data: Source, data_line: DataLine) -> Iterator[DeclaredName]:
    """Yield the variables that a line of a `.dat` declares or initialises; none for IMPORT, SIGNAL, STRUC and ENUM."""
    start, stop = data.code_span(data_line.line)
    if word_at(data.text, start, stop) not in DECLARATIONS:
        yield from declared_in(data, start, stop)


def _declared_types(data: Source) -> Iterator[str]:
    """Yield the names of the types that a `.dat` declares by STRUC or ENUM."""
    for line in range(1, len(data.starts) + 1):
        start, stop = data.code_span(line)
        if (word_end := skip_word(data.text, start, stop, "STRUC", "ENUM")) >= 0:
            yield word_at(data.text, skip_blanks(data.text, word_end, stop), stop)


def _renamed_code(text: str, new_names: Mapping[str, str]) -> str:
    """Return code with new names for variables.

    :param new_names: old name, upper case → new name.
    """
    edits = Replacements()
    for item in occurrences(text, 0, len(text)):
        if item.name in new_names:
            edits.add(item.start, item.stop, new_names[item.name])
    return edits.apply(text)


def _global_declaration(declaration: str) -> str:
    """Return a declaration with GLOBAL: ``DECL GLOBAL …``."""
    decl_end = skip_word(declaration, 0, len(declaration), "DECL")
    return f"DECL GLOBAL {declaration[max(decl_end, 0) :].lstrip()}"


def _names_with_line_mates(names: set[str], lines: Sequence[set[str]]) -> set[str]:
    """Return names, and all names that share a line of declaration with any of them, directly or over other names.

    :param lines: set of names that each line declares.
    """
    while new_names := set().union(*(line for line in lines if line & names)) - names:
        names = names | new_names
    return names
