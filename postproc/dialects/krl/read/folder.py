"""The folders of a program: their files, the routines in them by name, and the files that a program needs to run.

A controller knows a module as a whole: a name that is nowhere stops it, even in a routine that is not called. Files of
the controller's own (``$config.dat``), submit programs, and the folders that the cell names, which belong to the
controller too, are not copied. Nor is a `.dat` of which only GLOBAL variables are used, if its `.src` moves the robot:
it would replace the corrected points of that program on the controller. Correction changes no GLOBAL point.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from functools import cache, cached_property, lru_cache
from pathlib import Path, PurePath

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.dialects.krl.language import scan
from postproc.dialects.krl.language.declarations import declared_names
from postproc.dialects.krl.language.names import PURE, RESERVED, STANDARD
from postproc.dialects.krl.language.routines import Callee, Module, Routine, routines
from postproc.dialects.krl.language.source import OTHER_FILE, Source
from postproc.dialects.krl.language.tokens import NAME, occurrences
from postproc.dialects.krl.read import plain_lines
from postproc.dialects.text import decode
from postproc.errors import ProgramError, combined_error
from postproc.program import Document, NeededFile

_LARGEST_FILE = 20_000_000
"""Bytes of the largest file that is searched."""
_CONTROLLER_NAMES = PURE | STANDARD | RESERVED | {"BAS"}
"""Names of functions and programs of the controller, which are not searched for."""


class FolderFiles:
    """The `.src`, `.dat` and `.sub` files of some folders; of files with one name, that of the first folder counts.

    :param documents: files that replace files of the same name in the folders.
    """

    def __init__(self, folders: Sequence[Path], documents: Sequence[Document] = ()) -> None:
        """Keep the folders, which are searched when a file is first needed."""
        self._folders = folders
        self._documents = {document.name.upper(): document for document in documents}

    @cached_property
    def paths(self) -> dict[str, Path]:
        """File name, upper case → path, of all files."""
        by_name: dict[str, Path] = {}
        for path in _program_files(self._folders):
            by_name.setdefault(path.name.upper(), path)
        for name, document in self._documents.items():
            by_name.setdefault(name, Path(document.folder) / document.name)
        return by_name

    @cached_property
    def _routine_paths(self) -> dict[str, Path]:
        """Name of a GLOBAL routine, upper case → path of its `.src`; all `.src` files are searched for them."""
        by_routine: dict[str, Path] = {}
        for path in (path for name, path in self.paths.items() if name.endswith(".SRC")):
            for name in self.names_in(path, scan.global_routines):
                by_routine.setdefault(name, path)
        return by_routine

    def called_files(self, code: str, own_routines: Set[str] = frozenset()) -> set[Path]:
        """Return the `.src` files whose routines some code may call: files of the called names, or GLOBAL routines.

        :param code: code without comments.
        :param own_routines: names, upper case, of the routines in the file of the code: they hide those of other files.
        """
        return self.files_of_routines(scan.called_names(code) - own_routines)

    def files_of_routines(self, names: Set[str]) -> set[Path]:
        """Return the `.src` files of routines, given by their names in upper case; those of the controller count not.

        A routine is in the file of its name, or else a GLOBAL routine of another file.
        """
        paths = {name: self.paths.get(f"{name}.SRC") for name in names - _CONTROLLER_NAMES}
        files = {self._routine_paths.get(name) if path is None else path for name, path in paths.items()}
        return {path for path in files if path is not None}

    def called_code(self, code: str) -> Iterator[str]:
        """Yield the given code without comments, then the code of all files that it calls, directly or not.

        Files that cannot be read are left out.
        """
        unread_texts, visited_paths = [code], set[Path]()
        while unread_texts:
            code = scan.code_without_comments(unread_texts.pop())
            yield code
            new_paths = sorted(self.called_files(code) - visited_paths)
            visited_paths.update(new_paths)
            for path in new_paths:
                with suppress(ProgramError):  # reported where a routine of the file is called
                    unread_texts.append(self.source(path).text)

    def source(self, path: Path) -> Source:
        """Return a file with its lines.

        :raises ProgramError: the file cannot be read.
        """
        document = self._documents.get(path.name.upper())
        if document is not None:
            return Source.of(document, OTHER_FILE)
        try:
            return Source.of(replace(decode(path.name, path.read_bytes()), folder=str(path.parent)), OTHER_FILE)
        except OSError as cause:
            raise ProgramError(
                f"cannot be read ({cause.strerror})", file=str(path), advice="Check its path, and that you may read it."
            ) from cause

    def names_in(self, path: Path, find_names: Callable[[str], frozenset[str]]) -> frozenset[str]:
        """Return the names that a function of `language.scan` finds in a file.

        :param find_names: that function: text of the file → names, upper case.
        :returns: empty if the file cannot be read, or is too large.
        """
        document = self._documents.get(path.name.upper())
        if document is not None:
            return find_names(document.text)
        try:
            stat = path.stat()
        except OSError:
            return frozenset()
        if stat.st_size > _LARGEST_FILE:
            return frozenset()
        return _names_in(path, find_names, stat.st_mtime_ns, stat.st_size)  # stored as long as the file is unchanged


def called_files_with_motion(paths: Sequence[Path], search: Sequence[Path]) -> dict[Path, set[Path]]:
    """Return program → files with motions that it may call, directly or not, for programs of one folder.

    :param paths: the programs.
    :param search: folders that are searched after the folder of the programs.
    """
    files = FolderFiles([paths[0].parent, *search])

    @cache
    def code_of(path: Path) -> str:
        """Return the code of a file without comments; empty if it cannot be read."""
        try:
            return scan.code_without_comments(decode(path.name, path.read_bytes()).text)
        except (OSError, ProgramError):  # reported when the program is read
            return ""

    @cache
    def callees_of(path: Path) -> set[Path]:
        """Return the files that a file calls itself."""
        return files.called_files(code_of(path))

    moving_files: dict[Path, set[Path]] = {}
    for path in paths:
        callees: set[Path] = set()
        new_callees = callees_of(path)
        while new_callees:
            callees |= new_callees
            new_callees = set().union(*map(callees_of, new_callees)) - callees
        moving_files[path] = {callee for callee in callees if scan.has_motion(code_of(callee))}
    return moving_files


def searched_files(paths: Sequence[Path], search: Sequence[Path]) -> dict[Path, list[Path]]:
    """Return program → files that its reading may need, sorted, for programs of one folder.

    They are the files that it may call, directly or not, their data lists, other data lists with GLOBAL variables that
    these files name, and the submit programs.

    :param paths: the programs.
    :param search: folders that are searched after the folder of the programs.
    """
    files = FolderFiles([paths[0].parent, *search])
    submit_programs = {path for name, path in files.paths.items() if name.endswith(".SUB")}
    data_names = {
        path: names
        for file, path in files.paths.items()
        if file.endswith(".DAT") and (names := _present_names_in(path, scan.global_variables))
    }

    @cache
    def next_files(path: Path) -> set[Path]:
        """Return the files that a file may call, and the data lists that it may need."""
        data_lists = {f"{path.stem}.DAT", *(f"{stem}.DAT" for stem in _present_names_in(path, _imported_stems))}
        next_paths = {data for name in data_lists if (data := files.paths.get(name.upper())) is not None}
        next_paths |= files.files_of_routines(_present_names_in(path, _called_names))
        if data_names:
            words = _present_names_in(path, _words)
            next_paths |= {data for data, names in data_names.items() if not words.isdisjoint(names)}
        return next_paths

    files_of_program: dict[Path, list[Path]] = {}
    for program in paths:
        needed_paths, unread_paths = {program}, {program}
        while unread_paths:
            unread_paths = set().union(*map(next_files, unread_paths)) - needed_paths
            needed_paths |= unread_paths
        files_of_program[program] = sorted((needed_paths | submit_programs) - {program})
    return files_of_program


def _called_names(text: str) -> frozenset[str]:
    """Return the names, upper case, that a file may call."""
    return frozenset(scan.called_names(scan.code_without_comments(text)))


def _words(text: str) -> frozenset[str]:
    """Return the names, upper case, in the code of a file."""
    return frozenset(name.upper() for name in NAME.findall(scan.code_without_comments(text)))


def _imported_stems(text: str) -> frozenset[str]:
    """Return the names, upper case, of the data lists from which a file imports variables."""
    return frozenset(scan.imported_files(text))


def _present_names_in(path: Path, find_names: Callable[[str], frozenset[str]]) -> frozenset[str]:
    """Return the names that a function finds in a file as it is now; empty if the file cannot be read."""
    try:
        status = path.stat()
    except OSError:
        return frozenset()
    return _names_in(path, find_names, status.st_mtime_ns, status.st_size)


def _program_files(folders: Sequence[Path]) -> Iterator[Path]:
    """Yield the `.src`, `.dat` and `.sub` files of folders, sorted within each folder; unreadable folders have none."""
    for folder in folders:
        try:
            yield from sorted(path for path in folder.iterdir() if path.suffix.upper() in (".SRC", ".DAT", ".SUB"))
        except OSError:
            continue


def names_called_in(path: Path) -> set[str]:
    """Return the names, upper case, that a file calls; empty if it cannot be read or is too large."""
    try:
        text = path.read_bytes().decode("latin-1") if path.stat().st_size <= _LARGEST_FILE else ""
    except OSError:
        return set()
    return scan.called_names(scan.code_without_comments(text))


@lru_cache(maxsize=4096)
def _names_in(path: Path, find_names: Callable[[str], frozenset[str]], mtime: int, size: int) -> frozenset[str]:
    """Return the names that a function of `language.scan` finds in a file; empty if the file cannot be read.

    :param find_names: that function.
    :param mtime: time of the last change [ns]; like `size` [bytes] only part of the key of the cache, so that a changed
        file is read again.
    """
    del mtime, size
    try:
        return find_names(path.read_bytes().decode("latin-1"))
    except OSError:
        return frozenset()


class Library:
    """Finds the routines that a program calls.

    :param program: the file of the program, which is searched first.
    :param files: the files of the folders, which are searched next.
    :ivar faults: name of a routine → why its file cannot be read.
    """

    def __init__(self, program: Module, files: FolderFiles) -> None:
        """Begin without files: each is read when a routine in it is first needed."""
        self.program, self.files = program, files
        self.faults: dict[str, str] = {}
        self._modules: dict[Path, Module | None] = {}
        self._callees: dict[str, Callee | None] = {}

    def find_callee(self, name: str, caller: Module) -> Callee | None:
        """Return the routine that a name means in a module, with the module of the routine; None if it is in no file.

        :param name: name of the routine, upper case.
        :param caller: the module that calls it; its own routines come first.
        """
        routine = caller.routines.get(name)
        if routine is not None:
            return Callee(caller, routine)
        if name not in self._callees:
            self._callees[name] = self._find_routine(name)
        return self._callees[name]

    def submit_programs(self) -> Iterator[Module]:
        """Yield the submit programs (`.sub`), which run concurrently with the program; unreadable ones are left out."""
        for file, path in self.files.paths.items():
            if file.endswith(".SUB") and (module := self._module(path)) is not None:
                yield module

    def called_routines(self) -> Iterator[Callee]:
        """Yield the routines that `find_callee` has returned, without those in the module of their caller."""
        yield from (callee for callee in self._callees.values() if callee is not None)

    def read_modules(self) -> Iterator[Module]:
        """Yield the files that have been read, the program itself left out."""
        yield from (module for module in self._modules.values() if module is not None)

    def program_names(self) -> frozenset[str]:
        """Return the names of the programs of all folders, upper case."""
        return frozenset(path.stem.upper() for path in self.files.paths.values() if path.suffix.upper() != ".DAT")

    def program_and_routine_names(self) -> frozenset[str]:
        """Return the names of the programs and GLOBAL routines of all folders, upper case."""
        paths = (path for path in self.files.paths.values() if path.suffix.upper() != ".DAT")
        return self.program_names().union(*(self.files.names_in(path, scan.global_routines) for path in paths))

    def programs_calling(self, routines: Collection[Routine]) -> Mapping[str, tuple[str, ...]]:
        """Return the programs of the folders that call some routines, without the programs that were read.

        :returns: name of the file of each routine → names of the programs that call a routine of it, sorted; an empty
            tuple if none does.
        """
        read_files = {module.source.document.name.upper() for module in (self.program, *self.read_modules())}
        unread_paths = [
            path for file, path in self.files.paths.items() if not file.endswith(".DAT") and file not in read_files
        ]
        call_names = {path: names_called_in(path) for path in unread_paths}
        user_names: dict[str, tuple[str, ...]] = {}
        for routine in sorted(routines, key=lambda routine: routine.first):
            file = routine.source.document.name
            users = {path.name for path, names in call_names.items() if routine.name in names}
            user_names[file] = tuple(sorted({*user_names.get(file, ()), *users}))
        return user_names

    def programs_setting(self, names: Set[str]) -> dict[str, tuple[str, ...]]:
        """Return the programs of the folders that set some GLOBAL variables, without the programs that were read.

        :param names: names of the variables, upper case.
        :returns: variable → names of the programs that set it, sorted; variables that no program sets are left out.
        """
        read_files = {module.source.document.name.upper() for module in (self.program, *self.read_modules())}
        writer_names: dict[str, list[str]] = {}
        for file, path in self.files.paths.items() if names else ():
            if file.endswith(".SRC") and file not in read_files and path.stem.upper() not in _CONTROLLER_NAMES:
                for name in names & self.files.names_in(path, scan.assigned_variables):
                    writer_names.setdefault(name, []).append(path.name)
        return {name: tuple(sorted(writer_names[name])) for name in sorted(writer_names)}

    def _find_routine(self, name: str) -> Callee | None:
        """Return a routine by its name, upper case, with its file, as other files see it; None if it is in no file.

        GLOBAL routines of the program and its main routine come first, then the file of that name, then GLOBAL routines
        of other files.
        """
        program_routine = self.program.routines.get(name)
        if program_routine is not None and (program_routine.is_global or name == self.program.name):
            return Callee(self.program, program_routine)
        path = self.files.paths.get(f"{name}.SRC")
        if path is not None:
            module = self._module(path, name)
            routine = module.main_routine(name) if module is not None else None
            if module is not None and routine is not None:
                return Callee(module, routine)
        for file, path in self.files.paths.items():
            if file.endswith(".SRC") and name in self.files.names_in(path, scan.global_routines):
                module = self._module(path, name)
                if module is not None and name in module.routines:
                    return Callee(module, module.routines[name])
        return None

    def _module(self, path: Path, name: str = "") -> Module | None:
        """Return the routines of a file, which is read once; None if it cannot be read.

        :param name: the routine that is looked for, if any; `faults` gets the reason under this name.
        """
        if path not in self._modules:
            self._modules[path] = None
            try:
                source = self.files.source(path)
                self._modules[path] = module_of(source, self._data_source(path))
            except ProgramError as cause:
                self.faults[name] = str(cause)
        return self._modules[path]

    def _data_source(self, path: Path) -> Source | None:
        """Return the `.dat` in the folder of a `.src` with its name; None if there is none, or it cannot be read."""
        data = self.files.paths.get(f"{path.stem.upper()}.DAT")
        if data is None or data.parent != path.parent:
            return None
        try:
            return self.files.source(data)
        except ProgramError:
            return None  # the variables that it declares have no values then


def module_of(source: Source, data: Source | None = None) -> Module:
    """Return the routines of a file.

    :param data: the `.dat` of the file; None without one.
    :raises ProgramError: a DEF has no END, or a motion is outside of DEF … END.
    """
    motion_lines = np.concatenate([columns.trace_row for columns in plain_lines.scan(source)])
    is_other_line = np.ones(len(source.starts), dtype=np.bool_)
    is_other_line[motion_lines - 1] = False
    by_name, faults = routines(source, (np.flatnonzero(is_other_line) + 1).tolist(), motion_lines)
    if faults:
        raise combined_error(faults)
    return Module(source, by_name, data)


def find_needed_files(
    documents: Sequence[Document], code: Iterable[Code], files: FolderFiles, moving_files: Collection[str]
) -> tuple[NeededFile, ...]:
    """Return the files that a program needs from its folder to run, sorted by name.

    :param documents: the files of the program, which are written themselves; the main file first.
    :param code: all code of its `.src` files that may name other files; it is not read if the folder has no other
        files.
    :param files: the files of the folders.
    :param moving_files: names, upper case, of the files with routines that the program calls and that move the robot.
    """
    folder = Path(documents[0].folder)
    own_names = {document.name.upper() for document in documents}
    siblings = {
        name: path
        for name, path in files.paths.items()
        if path.parent == folder and name not in own_names and name[0] != "$" and not name.endswith(".SUB")
    }
    if not documents[0].folder or not siblings:
        return ()
    links = _Links(siblings, files)
    data_texts = (document.text for document in documents if PurePath(document.name).suffix.upper() == ".DAT")
    for routine_code in code:
        links.follow_code(routine_code)
    for text in data_texts:
        links.follow_data_list(text)
    return tuple(links.needed_file(name, moving_files) for name in sorted(links.called_files | links.used_data))


def text_of_lines(source: Source, lines: Iterable[int]) -> str:
    """Return the text of some lines of a file, given by their numbers from 1."""
    return "\n".join(source.text[source.starts[line - 1] : source.stops[line - 1]] for line in lines)


class Code(Struct, frozen=True):
    """The code of a routine.

    :param text: the lines of the routine.
    :param names: names, upper case, of variables that the routine or the `.dat` of its file declares: they hide GLOBAL
        variables.
    :param routines: names, upper case, of the routines in its file: they hide routines of other files.
    """

    text: str
    names: frozenset[str]
    routines: frozenset[str]


def codes_of(module: Module) -> Iterator[Code]:
    """Yield the code of each routine of a file, without its plain motions, which name no other files."""
    # names that its `.dat` declares for the file itself, and GLOBAL names
    module_names = frozenset() if module.data is None else frozenset().union(*declared_names(module.data))
    routine_names = frozenset(module.routines)
    for routine in module.routines.values():
        yield Code(
            text_of_lines(routine.source, routine.other_lines), module_names | routine.local_names, routine_names
        )


class _Links:
    """Finds the files that code needs, directly or through other files.

    :ivar called_files: names, upper case, of files with called routines, and of the data lists of these files.
    :ivar used_data: names of data lists of which variables are used.
    :ivar importing_data: names of data lists from which other data lists import variables.
    :ivar named_variables: names of the GLOBAL variables that code names.
    :ivar variables: GLOBAL variable → names of the data lists that declare it.
    """

    def __init__(self, siblings: dict[str, Path], files: FolderFiles) -> None:
        """Begin without files; find the data lists in which GLOBAL variables are declared.

        :param siblings: file name, upper case → path, of the other files in the folder of the program.
        """
        self.siblings, self.files = siblings, files
        self.called_files: set[str] = set()
        self.used_data: set[str] = set()
        self.named_variables: set[str] = set()
        self.importing_data: set[str] = set()
        self.variables: dict[str, set[str]] = {}
        for name, path in siblings.items():
            for variable in files.names_in(path, scan.global_variables) if name.endswith(".DAT") else ():
                self.variables.setdefault(variable, set()).add(name)

    def follow_code(self, code: Code) -> None:
        """Note the files whose routines or variables some code names, and the files that these need in turn."""
        text = scan.code_without_comments(code.text)
        for path in sorted(self.files.called_files(text, code.routines)):
            name = f"{path.stem.upper()}.SRC"
            # files in other folders, which the cell names, are on the controller already
            if name in self.siblings and name not in self.called_files:
                self.called_files.add(name)
                self._follow_file(name)
        if self.variables:
            names = {occurrence.name for occurrence in occurrences(text, 0, len(text))}
            variable_names = (names & self.variables.keys()) - code.names
            self.named_variables |= variable_names
            for name in sorted(variable_names):
                self._note_data(self.variables[name])

    def follow_data_list(self, text: str) -> None:
        """Note the data lists from which a data list, given by its text, imports variables."""
        data_names = {name for stem in scan.imported_files(text) if (name := f"{stem}.DAT") in self.siblings}
        self.importing_data |= data_names
        self._note_data(data_names)

    def needed_file(self, name: str, moving_files: Collection[str]) -> NeededFile:
        """Return a noted file as a `NeededFile`.

        :param name: name of the file, upper case.
        :param moving_files: names of the files with routines that the program calls and that move the robot.
        """
        path, source = self.siblings[name], self.siblings.get(f"{PurePath(name).stem}.SRC")
        if name in self.called_files:
            uncorrected = name.endswith(".SRC") and scan.has_motion(scan.code_without_comments(self._text(path)))
            return NeededFile(str(path), moves=name in moving_files, uncorrected=uncorrected)
        if source is None or not self._moves(source):
            return NeededFile(str(path), moves=False)
        # a data list of a program that moves the robot: which GLOBAL variables of it are used
        variables = tuple(sorted(variable for variable in self.named_variables if name in self.variables[variable]))
        variables = () if name in self.importing_data else variables  # imported ones need not be GLOBAL
        return NeededFile(str(path), moves=False, program=source.name, variables=variables)

    def _note_data(self, names: Collection[str]) -> None:
        """Note data lists of which variables are used, and the data lists from which these import variables."""
        for name in sorted(set(names) - self.used_data):
            self.used_data.add(name)
            self.follow_data_list(self._text(self.siblings[name]))

    def _follow_file(self, name: str) -> None:
        """Note the `.dat` of a called file, and all files that the `.src` or the `.dat` names.

        :param name: name of the `.src`, upper case.
        """
        data = self.siblings.get(f"{PurePath(name).stem}.DAT")
        if data is not None:
            self.called_files.add(data.name.upper())
            self.follow_data_list(self._text(data))
        try:
            module = module_of(
                self.files.source(self.siblings[name]), None if data is None else self.files.source(data)
            )
        except ProgramError:  # a file with errors: its text as a whole
            self.follow_code(Code(self._text(self.siblings[name]), names=frozenset(), routines=frozenset()))
            return
        for code in codes_of(module):
            self.follow_code(code)

    def _moves(self, path: Path) -> bool:
        """Return whether a file, or one that it calls, moves the robot."""
        return any(map(scan.has_motion, self.files.called_code(self._text(path))))

    def _text(self, path: Path) -> str:
        """Return the text of a file; empty if it cannot be read: the file is listed without what it calls."""
        try:
            return self.files.source(path).text
        except ProgramError:
            return ""
