"""Declarations of a `.dat`, a `$config.dat` or a `.src`, and their initial values; GLOBAL variables of other files."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Set
from contextlib import suppress

from msgspec import Struct
from msgspec.structs import replace

from postproc.dialects.krl.language import scan
from postproc.dialects.krl.language.declarations import DeclaredName, declared_in, structure
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.tokens import DECLARATION, ELEMENT, INDEX, NAME, NEXT_INITIAL_VALUE
from postproc.dialects.krl.language.tree import Declaration, Import
from postproc.dialects.krl.read.folder import FolderFiles
from postproc.dialects.krl.read.known import UnknownValue, UnparsedValue, stored_originals
from postproc.dialects.krl.read.variables import FRAME_ARRAYS, Variables, variable_of
from postproc.errors import ProgramError


def read_data(
    variables: Variables,
    source: Source,
    *,
    fills_gaps: bool = False,
    is_global: bool = False,
    wanted_names: Set[str] | None = None,
) -> None:
    """Store the types and values of the variables that a `.dat` declares.

    :param source: the `.dat`.
    :param fills_gaps: True to store only what is missing: values of names without a value, and types of names without
        a type.
    :param is_global: True if all variables are GLOBAL, as those of the `$config.dat`.
    :param wanted_names: names of the variables to store, upper case; None: all.
    :raises ProgramError: DEFDAT or ENDDAT is missing.
    :raises CellError: the file contradicts another source of BASE_DATA or TOOL_DATA.
    """
    _DataReader(variables, source, fills_gaps, is_global, wanted_names).read()


class _DataReader(Struct, frozen=True, eq=False):
    """Reads a `.dat`; see `read_data`."""

    variables: Variables
    source: Source
    fills_gaps: bool
    is_global: bool
    wanted_names: Set[str] | None

    def read(self) -> None:
        """Store what all lines up to ENDDAT declare.

        :raises ProgramError: DEFDAT or ENDDAT is missing.
        :raises CellError: the file contradicts another source of BASE_DATA or TOOL_DATA.
        """
        source, text = self.source, self.source.text
        has_defdat = has_enddat = False
        takes_all = self.wanted_names is None and not self.fills_gaps  # else `_note_line` selects the names
        for line, (start, stop) in enumerate(zip(source.starts.tolist(), source.stops.tolist(), strict=True), 1):
            while start < stop and text[start] in " \t\r":
                start += 1
            if takes_all and (element := ELEMENT.match(text, start, stop)):  # most lines of long data lists
                self._note_element(element, line, stop)
                continue
            if text[start : start + 1] in ("", ";", "&", "\r"):  # empty lines, comments, and headers such as &ACCESS
                continue
            word = text[start : start + len("DEFDAT")].upper()  # the words below all have six letters
            if word == "DEFDAT":
                has_defdat = True
            elif word == "ENDDAT":
                has_enddat = True
                break
            elif word == "IMPORT":
                if self.wanted_names is None:  # else only some GLOBAL variables are wanted
                    _note_import(self.variables, Place(source, line))
            else:
                self._note_line(line, start, stop)
        if not has_defdat or not has_enddat:
            raise source.line_error(
                f"{'ENDDAT' if has_defdat else 'DEFDAT'} is missing",
                len(source.starts),
                "Check that the file is complete and that it is the .dat of this program.",
            )

    def _note_element(self, element: re.Match[str], line: int, stop: int) -> None:
        """Store the value of a line such as ``P[3]={X 1,…}``; it is parsed when it is needed.

        :param element: match of `ELEMENT` on the line, which ends where the value begins.
        :param line: the line, from 1.
        :param stop: offset of the end of the line.
        :raises CellError: the cell or another file gives another frame for this element of BASE_DATA or TOOL_DATA.
        """
        name = self.variables.scope.stored_name(element["name"].upper())
        self._store(f"{name}[{int(element['index'])}]", UnparsedValue(self.source, element.end(), stop), line)

    def _store(self, key: str, value: UnparsedValue, line: int) -> None:
        """Store a value, unless only missing ones are stored and there is one.

        A frame of BASE_DATA or TOOL_DATA is compared with those of the cell and of other files first.

        :param key: stored name of the variable or the array element.
        :param line: line with the value, from 1.
        :raises CellError: the cell or another file gives another frame.
        """
        variables, name = self.variables, variable_of(key)
        if name in FRAME_ARRAYS:
            variables.note_frame(key, value, f"{self.source.document.name}, line {line}")
        if not (self.fills_gaps and key in variables):
            variables.persistent_names.add(name)  # variables of data lists keep their values from run to run
            variables.put(key, value)

    def _note_line(self, line: int, start: int, stop: int) -> None:
        """Store what a line declares; values are parsed when they are needed. A line without a declaration is ignored.

        :param line: the line, from 1.
        :param start: offset at which the code of the line begins; `stop` is the offset of the end of the line.
        :raises CellError: the cell or another file gives another frame for an element of BASE_DATA or TOOL_DATA.
        """
        variables, source = self.variables, self.source
        match = DECLARATION.match(source.text, start, stop)
        if not match:
            return
        if match["equals"] and not NEXT_INITIAL_VALUE.search(source.text, match.end(), stop):
            declarators = [next(declared_in(source, start, match.end()))]  # one: its long value need not be searched
        else:
            start, stop = source.code_span(line)
            declarators = list(declared_in(source, start, stop))
        for declarator in declarators:
            if self.wanted_names is not None and declarator.name not in self.wanted_names:
                continue
            is_global = declarator.is_global or self.is_global
            key = _note_declaration(variables, replace(declarator, is_global=is_global), fills_gaps=self.fills_gaps)
            # STRUC declares a type with its members
            if declarator.kind == "STRUC" and (named_structure := structure(source, *source.code_span(line))):
                variables.structures.setdefault(named_structure.name, named_structure.members)
            if declarator.value_start >= 0:  # it has an initial value
                self._store(key, UnparsedValue(source, declarator.value_start, stop), line)


def _note_import(variables: Variables, place: Place) -> None:
    """Note that an IMPORT gives a variable of another `.dat` a second name: both names may change at any time.

    :param place: file and line of the IMPORT; nothing is noted if it cannot be read.
    """
    stmt = statement(place.source, place.line)
    if isinstance(stmt, Import):
        for name in (variables.scope.stored_name(stmt.name), *stored_originals(stmt)):
            variables.volatile_values.setdefault(name, UnknownValue(str(place)))


def declare_variables(
    variables: Variables, source: Source, declaration: Declaration, row: int
) -> tuple[DeclaredName, ...]:
    """Store the types, structures and initial values of a declaration in a `.src`, and return the declared names.

    :param row: row of the execution trace with the declaration; 0 if it is not in the trace.
    """
    if declaration.structure is not None:
        variables.structures[declaration.structure.name] = declaration.structure.members
    for declarator in declaration.names:
        key = _note_declaration(variables, declarator)
        if declarator.value_start >= 0:
            variables.put(key, UnparsedValue(source, declarator.value_start, declaration.stop, row))
    return declaration.names


def _note_declaration(variables: Variables, declarator: DeclaredName, *, fills_gaps: bool = False) -> str:
    """Store the type of a declared name and whether it is GLOBAL; return the key under which its value is stored.

    The key has the indices if the declaration sets one array element, as in ``DECL E6POS P[3]={…}``.

    :param declarator: the name; without a type if the line only initialises it.
    :param fills_gaps: True to keep a type that is stored already.
    """
    name = variables.scope.stored_name(declarator.name)
    has_type_of_call = declarator.name in variables.scope.local_names  # the call may have set the type of a parameter
    if declarator.kind and not ((fills_gaps or has_type_of_call) and name in variables.types):
        variables.types[name] = declarator.kind
        if declarator.is_global:
            variables.global_names.add(name)
        if name not in variables.persistent_names:  # variables of data lists keep their present values
            variables.take_cell_values(name)  # converts values to the type
    if declarator.bounds is None:
        return name
    indices = [part.strip() for part in declarator.bounds.strip("[] \t").split(",")]
    if not all(INDEX.fullmatch(index) for index in indices):  # an index is missing, or is no number
        return name
    return f"{name}[{','.join(str(int(index)) for index in indices)}]"


def read_shared(
    variables: Variables, code: str, own_names: Collection[str], files: FolderFiles, local_names: Set[str] = frozenset()
) -> None:
    """Store the GLOBAL variables that a program uses from other `.dat` files.

    The value of a variable that several of these files declare is not known. A file with an error is left out.

    :param code: all code of the program that may contain names; the code of called files is read in addition.
    :param own_names: names of the files of the program itself.
    :param files: the folders to search.
    :param local_names: names that the main routine declares: they hide GLOBAL variables.
    :raises CellError: one of the files contradicts another source of BASE_DATA or TOOL_DATA.
    """
    own_file_names = {name.upper() for name in own_names}
    other_paths = [path for name, path in files.paths.items() if name.endswith(".DAT") and name not in own_file_names]
    global_names = {path: files.names_in(path, scan.global_variables) for path in other_paths}
    if not any(global_names.values()):
        return
    declaration_counts = Counter(name for names in global_names.values() for name in names)
    used_names = set().union(*(NAME.findall(text) for text in files.called_code(code)))
    # used variables, and types of variables (STRUC), that no file read so far declares
    missing_names = ({name.upper() for name in used_names} | set(variables.types.values())) - variables.types.keys()
    unique_names = {name for name in missing_names - local_names if declaration_counts[name] == 1}
    for name in (name for name in missing_names - local_names if declaration_counts[name] > 1):
        file_names = ", ".join(sorted(path.name for path, names in global_names.items() if name in names))
        variables.put(name, UnknownValue(reason=f"it is GLOBAL in more than one .dat: {file_names}"))
    for path, names in global_names.items():
        if not unique_names.isdisjoint(names):
            with suppress(ProgramError):  # a motion that needs one of its variables reports that it has no value
                read_data(variables, files.source(path), fills_gaps=True, wanted_names=unique_names)
