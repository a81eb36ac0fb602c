"""What several files of a divided program use: routines and variables become GLOBAL, under names that are its own.

GLOBAL names are seen by all programs of a controller, so that each begins with the name of the program. What the
program never writes (points, say) needs none of that: each file has it in its own `.dat`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from msgspec import Struct, field
from msgspec.structs import replace

from postproc.dialects.krl.language.declarations import DataLine, Declared, data_lines, declared
from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.names import DECLARING, MAX_LENGTH, unused
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.parts import MAIN
from postproc.dialects.krl.language.routines import Routine
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import NAME, after_blanks, after_word, key_word, occurrences, word_at
from postproc.dialects.krl.language.tree import Assignment, Cyclic, Declaration, Definition, Event, For
from postproc.dialects.krl.write.division import ADVICE, undivided
from postproc.dialects.krl.write.edits import Replacements
from postproc.errors import ProgramError
from postproc.program import Document, Ints


class _Variables(Struct, frozen=True, eq=False):
    """Variables that are declared in one place: the DEF of the main routine, or the `.dat`.

    :ivar users: name → files that use it, by number.
    :ivar written: name → line that may write it.
    """

    users: dict[str, set[int]] = field(default_factory=dict)
    written: dict[str, int] = field(default_factory=dict)

    def shared(self, *, always: bool) -> set[str]:
        """Return the names that several files use; not `always`: and that the program may write."""
        return {name for name, files in self.users.items() if len(files) > 1 and (always or name in self.written)}


class Sharing:
    """Finds what the files of a divided program share, and edits both texts so that all of them see it.

    :param base: what GLOBAL names begin with.
    :param others: its own routines, which get files of their own.
    :param file: (L + 1,) number of the file that will contain each line of the program.
    :param taken: names, upper case, that are used already; the new ones join them.
    """

    def __init__(
        self,
        base: str,
        source: Source,
        data: Document | None,
        main: Routine,
        others: Sequence[Routine],
        file: Ints,
        taken: set[str],
    ) -> None:
        self.base, self.source, self.main, self.others, self.file, self.taken = base, source, main, others, file, taken
        self.data = None if data is None else Source.of(data, 1)
        self.lines = [] if self.data is None else [one for one in data_lines(self.data) if not one.public]
        self.stated = {one.line: list(_stated(self.data, one)) for one in self.lines if self.data is not None}
        self.own, self.kept = _Variables(), _Variables()
        self.declared = [(line, one) for line in main.lines for one in self._declared_on(line)]
        constant = {line for line, _ in self.declared if self._is_constant(line)}
        self.local = {one.name for line, one in self.declared if line not in constant}
        self.hidden = {one.name for line, one in self.declared if line in constant}
        self.hidden |= {parameter.name for parameter in main.parameters}

    def done(self) -> tuple[Source, Document | None, dict[str, str]]:
        """Return the program, with as many lines, its `.dat`, and the new name of each routine by its name, upper case.

        :raises ProgramError: a variable has a type that other files do not see.
        """
        self._look()
        own = _together(self.own.shared(always=True), self._by_line(self.declared))
        stated = [(line, one) for line, names in self.stated.items() for one in names]
        kept = _together(self.kept.shared(always=False), self._by_line(stated))
        self._check_types(own, {one.name: one for _, one in stated if one.name in kept and one.kind})
        moved = {name: self._fresh(name) for name in sorted(own)}
        public = {name: self._fresh(name) for name in sorted(kept)}
        routines = {one.name: self._fresh(one.name) for one in self.others if not one.public}
        if not moved and not public and not self.others:
            return self.source, None if self.data is None else self.data.document, {}
        edits = Replacements()
        declarations = self._move(moved, edits)
        self._rename(moved, public, routines, edits)
        source = Source.of(replace(self.source.document, text=edits.applied(self.source.text)), 0)
        return source, self._data(public, declarations), routines

    # --- shared names ----------------------------------------------------------------------------------------------

    def _look(self) -> None:
        """Note which files use which variables."""
        kept = {one.name for names in self.stated.values() for one in names}
        variables = kept | self.local
        if not variables:
            return
        declaring = {line for line, _ in self.declared}
        for routine in (self.main, *self.others):
            for line in range(routine.first + 1, routine.last):
                start, stop = self.source.code_span(line)
                names = variables & {word.upper() for word in NAME.findall(self.source.text, start, stop)}
                if not names or (routine is self.main and line in declaring):
                    continue
                names &= {one.name for one in occurrences(self.source.text, start, stop)}
                written = self._written_in(line)
                for name in names:
                    known = self._meant(name, routine, kept)
                    if known is not None:
                        known.users.setdefault(name, set()).add(int(self.file[line]))
                        if name in written:
                            known.written.setdefault(name, line)

    def _meant(self, name: str, routine: Routine, kept: Collection[str]) -> _Variables | None:
        """Return to what a name in a routine belongs; None if it is none of what may be shared."""
        if routine is self.main and name in self.local:
            return self.own
        hidden = self.hidden if routine is self.main else routine.local
        return self.kept if name in kept and name not in hidden else None

    def _written_in(self, line: int) -> set[str]:
        """Return the names that a statement may write: by assignment, as argument of a call, as counter of a FOR.

        Statements that act at another time (TRIGGER, INTERRUPT, ANIN, DIGIN) may write every name in them.
        """
        source, here = self.source, statement(self.source, line)
        if isinstance(here, For):
            return {here.name}
        if isinstance(here, Event) or (isinstance(here, Cyclic) and here.word != "SIGNAL"):
            return {name.upper() for name in NAME.findall(source.text, here.start, here.stop)}
        names = {here.target.name} if isinstance(here, Assignment) else set()
        for call in calls(here.values):
            if call.name != "BAS":
                given = next((one.parameters for one in self.others if one.name == call.name), ())
                open_ = [a for k, a in enumerate(call.arguments) if not (k < len(given) and given[k].by_value)]
                names |= {name.upper() for one in open_ for name in NAME.findall(source.text, one.start, one.stop)}
        return names

    def _check_types(self, own: Collection[str], kept: Mapping[str, Declared]) -> None:
        """Refuse variables and parameters of types that are declared for this program alone."""
        types = set() if self.data is None else set(_types(self.data))
        if not types:
            return
        for line, one in self.declared:
            if one.name in own and one.kind in types:
                raise self._unseen(one.name, one.kind, line)
        for name, one in kept.items():
            if one.kind in types:
                raise self._unseen(name, one.kind, self.kept.written[name])
        for routine in self.others:
            head = statement(self.source, routine.first)
            result = {head.result} if isinstance(head, Definition) and head.result else set[str]()
            given = {parameter.name for parameter in routine.parameters}
            kinds = {one.kind for line in routine.lines for one in self._declared_on(line) if one.name in given}
            for kind in types.intersection(kinds | result):
                raise self._unseen(f"what {routine.name} takes or gives", kind, routine.first)

    def _unseen(self, what: str, kind: str, line: int) -> ProgramError:
        problem = f"{what} is used in several of the files, and its type {kind} is not GLOBAL"
        return undivided(self.source, problem, line, f"Declare {kind} in the $config.dat, or: {ADVICE}")

    # --- declarations --------------------------------------------------------------------------------------------

    def _declared_on(self, line: int) -> list[Declared]:
        """Return the variables that a line of the program declares."""
        here = statement(self.source, line)
        return list(here.names) if isinstance(here, Declaration) and not here.public and here.word != "STRUC" else []

    def _is_constant(self, line: int) -> bool:
        here = statement(self.source, line)
        return isinstance(here, Declaration) and here.constant

    @staticmethod
    def _by_line(stated: Iterable[tuple[int, Declared]]) -> list[set[str]]:
        lines: dict[int, set[str]] = {}
        for line, one in stated:
            lines.setdefault(line, set()).add(one.name)
        return list(lines.values())

    # --- edits -------------------------------------------------------------------------------------------------------

    def _fresh(self, name: str) -> str:
        """Return a GLOBAL name for a name, upper case."""
        found = f"{self.base}_{self._spelt(name)}"[:MAX_LENGTH]
        if found.upper() in self.taken:
            found = unused(found, self.taken)
        self.taken.add(found.upper())
        return found

    def _spelt(self, name: str) -> str:
        """Return a name as the program spells it first."""
        found = (match[0] for match in NAME.finditer(self.source.text) if match[0].upper() == name)
        return next(found, name)

    def _move(self, moved: Mapping[str, str], edits: Replacements) -> list[str]:
        """Take declarations out of the main routine; return them as written in a `.dat`."""
        found = []
        for line in dict.fromkeys(line for line, one in self.declared if one.name in moved):
            start, stop = self.source.code_span(line)
            text = self.source.text[start:stop]
            edits.add(start, stop, f"; {text}: GLOBAL in the .dat of {self.base}{MAIN}")
            pieces = Replacements()
            for one in occurrences(text, 0, len(text)):
                if one.name in moved:
                    pieces.add(one.start, one.stop, moved[one.name])
            found.append(_public(pieces.applied(text)))
        return found

    def _rename(
        self, moved: Mapping[str, str], public: Mapping[str, str], routines: Mapping[str, str], edits: Replacements
    ) -> None:
        """Rename the new GLOBAL variables, wherever the program uses it."""
        text, gone = self.source.text, {line for line, one in self.declared if one.name in moved}
        for routine in (self.main, *self.others):
            hidden = self.hidden if routine is self.main else routine.local
            names = {name: new for name, new in public.items() if name not in hidden}
            names |= moved if routine is self.main else {}
            either = names.keys() | routines.keys()
            for line in range(routine.first, routine.last):
                start, stop = self.source.code_span(line)
                if line in gone or either.isdisjoint(word.upper() for word in NAME.findall(text, start, stop)):
                    continue
                for one in occurrences(text, start, stop):
                    called = one.called or line == routine.first
                    new = routines.get(one.name) if called else names.get(one.name)
                    if new is not None:
                        edits.add(one.start, one.stop, new)
            if routine in self.others and not routine.public:
                start, _ = self.source.code_span(routine.first)
                edits.add(start, start, "GLOBAL ")

    def _data(self, public: Mapping[str, str], declarations: Sequence[str]) -> Document | None:
        """Return the `.dat` with the new GLOBAL variables."""
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
        for one in self.lines:
            if not public.keys().isdisjoint(one.names):
                start, stop = self.data.code_span(one.line)
                new = text[start:stop]
                pieces = Replacements()
                for name in occurrences(new, 0, len(new)):
                    if name.name in public:
                        pieces.add(name.start, name.stop, public[name.name])
                new = pieces.applied(new)
                edits.add(start, stop, _public(new) if any(stated.kind for stated in self.stated[one.line]) else new)
        return replace(self.data.document, text=edits.applied(text))


def _stated(data: Source, one: DataLine) -> Iterator[Declared]:
    """Yield the variables that a line of a `.dat` declares or gives a value to."""
    start, stop = data.code_span(one.line)
    if word_at(data.text, start, stop) not in DECLARING:
        yield from declared(data, start, stop)


def _types(data: Source) -> Iterator[str]:
    """Yield the names of the types that a `.dat` declares."""
    for line in range(1, len(data.starts) + 1):
        start, stop = data.code_span(line)
        if (behind := after_word(data.text, start, stop, "STRUC", "ENUM")) >= 0:
            yield word_at(data.text, after_blanks(data.text, behind, stop), stop)


def _public(declaration: str) -> str:
    """Return a declaration as one of GLOBAL variables."""
    behind = after_word(declaration, 0, len(declaration), "DECL")
    return f"DECL GLOBAL {declaration[max(behind, 0) :].lstrip()}"


def _together(names: set[str], lines: Sequence[set[str]]) -> set[str]:
    """Return names with those that are declared on one line with them."""
    while more := set().union(*(line for line in lines if line & names)) - names:
        names = names | more
    return names
