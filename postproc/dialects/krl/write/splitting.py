"""A long program in several files: `part1.src`, `part2.src` … and `partMain.src`, which calls them one after the other.

Decisions, where KUKA leaves a choice:

- System variables (`$BASE`, `$VEL.CP`, `$APO.CDIS` …) keep their values from file to file: all run in one interpreter.
  Variables declared in the DEF or in the `.dat` are visible in one file only: constants are repeated in each file that
  uses them, and variables that are written are GLOBAL (`shared_names`).
- Routines of the program follow the parts as GLOBAL DEF, in files of the same series that no program calls.
- The advance run goes on over a call, DEF and END, so that a motion with C_DIS before a cut is approximated as before:
  it stops at statements like WAIT, HALT, INTERRUPT DECL and BAS (#INITMOV), none of which is added (KUKA, Expert
  Programming, 'computer advance run': END stops it only in a module that declares an interrupt that is not GLOBAL). All
  initialisation stays in the main program. An interrupt that is declared there is known in all programs that it calls.
- RESUME returns to the routine that declares the interrupt, and would abort a whole part.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import chain, count, pairwise
from pathlib import PurePath

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.dialects.krl.language.declarations import DataLine, data_lines
from postproc.dialects.krl.language.names import MAX_LENGTH, MOTION_WORDS, fault_of
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.parts import MAIN, joined_program, separated_texts
from postproc.dialects.krl.language.routines import Module, routines
from postproc.dialects.krl.language.scan import text_with_name
from postproc.dialects.krl.language.source import DAT, SRC, Source
from postproc.dialects.krl.language.tokens import names_in, word_at
from postproc.dialects.krl.language.tree import Definition
from postproc.dialects.krl.write.division import division_error, find_cut_points, part_bounds
from postproc.dialects.krl.write.edited_rows import line_text
from postproc.dialects.krl.write.shared_names import DividedProgram, Sharing
from postproc.errors import InputError, Issue, ProgramError, combined_error, first_of
from postproc.program import Document, Ints, WrittenProgram


def files_with_data(sources: Sequence[Document], data: Document | None) -> Iterator[Document]:
    """Yield the files of a program: each `.src`, followed by its `.dat` if it needs one.

    The `.dat` of a part has copies of the variables that the part uses. The `.dat` of the main program has all others:
    GLOBAL variables, unused variables and those that the main program uses.

    :param sources: the main program first.
    :param data: the `.dat` of the whole program; None if it has none.
    """
    if data is None:
        yield from sources
        return
    source = Source.of(data, DAT)
    lines = data_lines(source)
    all_texts = {line: line_text(source, line) for line in range(1, len(source.starts) + 1)}
    header = [text for text in all_texts.values() if text[0] == "&"]
    global_lines = {data_line.line for data_line in lines if data_line.is_global}
    main, *parts = sources
    local_lines = [_needed_lines(lines, document) - global_lines for document in parts]
    moved_lines = set().union(*local_lines) - _needed_lines(lines, main)
    yield main
    if any(data_line.names and data_line.line not in moved_lines for data_line in lines):
        text = "".join(text for line, text in all_texts.items() if line not in moved_lines)
        stem = PurePath(main.name).stem
        yield replace(data, name=f"{stem}.dat", text=text_with_name(text, stem))
    for document, part_lines in zip(parts, local_lines, strict=True):
        yield document
        texts = [data_line.text for data_line in lines if data_line.line in part_lines]
        if texts:
            stem = PurePath(document.name).stem
            text = "".join([*header, f"DEFDAT {stem}\r\n", *texts, "ENDDAT\r\n"])
            yield replace(data, name=f"{stem}.dat", text=text)


def _needed_lines(lines: Sequence[DataLine], document: Document) -> set[int]:
    """Return the numbers of the lines of a `.dat` that a file needs.

    The file contains a name that the line declares or initialises, or another needed line contains it.
    """
    lines_of_name: dict[str, list[DataLine]] = {}
    for data_line in lines:
        for name in data_line.names:
            lines_of_name.setdefault(name, []).append(data_line)
    numbers: set[int] = set()
    needed_names = names_in(document.text) & lines_of_name.keys()
    while needed_names:
        new_lines = [data_line for data_line in lines_of_name[needed_names.pop()] if data_line.line not in numbers]
        numbers |= {data_line.line for data_line in new_lines}
        needed_names |= set().union(*(names_in(data_line.text) for data_line in new_lines)) & lines_of_name.keys()
    return numbers


_RESUME_PROBLEM = "RESUME would break off the whole file that runs"
_MOST_NAMES = 5
"""Largest number of names in one message."""
_FRAME_LINE_COUNT = 3
"""Number of lines that are added to each part: DEF, the comment that names its main program, and END."""


def split_files(
    name: str,
    documents: Sequence[Document],
    output: WrittenProgram,
    limit: int,
    used_names: Collection[str] = (),
    resume_place: str = "",
) -> WrittenProgram:
    """Return a written program in several files, if it was read from several or is too long for one.

    :param name: name of the program.
    :param documents: files from which a KRL program was read; empty for a new program.
    :param output: the written program as one text.
    :param limit: largest number of lines of a file; 0: a program in one file is never divided.
    :param used_names: names of other programs and GLOBAL routines, upper case.
    :param resume_place: place, as text, of a RESUME in another file that returns to the program; empty without it.
    :raises ProgramError: the program is too long, and cannot be divided.
    """
    if documents and joined_program(documents) is not None:  # it was read from several files
        return _restore_files(documents, output, limit)
    # line feeds are counted fast; lines may also end with CR alone
    if not limit or (
        output.documents[0].text.count("\n") < limit and len(Source.of(output.documents[0], SRC).starts) <= limit
    ):
        return output
    try:
        if resume_place:
            raise division_error(Source.of(output.documents[0], SRC), f"{_RESUME_PROBLEM}, in {resume_place}", 1)
        return _Splitter(name, output, limit, used_names).write()
    except ProgramError as error:
        raise _error_in_program(error, documents, output.documents[0]) from None


def _error_in_program(error: InputError, documents: Sequence[Document], written: Document) -> ProgramError:
    """Return an error about the written text of a program as one about the program that was read.

    The writer keeps statements other than motions, and their order: of lines with one text, the first that was written
    is the first that was read, and so on. Where their numbers differ, and for new programs, the problem says that the
    line is that of the written program.

    :param documents: files from which a KRL program was read; empty for a new program.
    :param written: the document that the error is about.
    """
    written_lines = _lines_with_text(written, error.text)
    read_lines = next((_lines_with_text(read, error.text) for read in documents if read.name == written.name), [])
    if error.line in written_lines and len(read_lines) == len(written_lines):
        line, problem = read_lines[written_lines.index(error.line)], error.problem
    else:
        line, problem = None, f"{error.problem} (line {error.line} of the written program)"
    further_errors = [_error_in_program(further, documents, written) for further in error.further_errors]
    return ProgramError(
        problem, file=error.file, line=line, text=error.text, advice=error.advice, further_errors=further_errors
    )


def _lines_with_text(document: Document, text: str | None) -> list[int]:
    """Return the 1-based lines of a document that read like a text, blanks around it aside."""
    source = Source.of(document, SRC)
    lines = (document.text[start:stop].strip() for start, stop in zip(source.starts, source.stops, strict=True))
    return [] if text is None else [line for line, line_text in enumerate(lines, 1) if line_text == text.strip()]


def _restore_files(documents: Sequence[Document], output: WrittenProgram, limit: int) -> WrittenProgram:
    """Return a program that was read from several files, joined to one text, in these files; lines stay in their file.

    A file that is longer than `limit` lines (0: no limit) gets a warning.
    """
    whole_program = joined_program(documents)
    if whole_program is None or all(
        new_file.text == old_file.text
        for new_file, old_file in zip(output.documents, whole_program.documents, strict=True)
    ):
        return replace(output, documents=tuple(documents))
    texts = separated_texts(output.documents[0].text)
    document_of = {document.name: document for document in documents}
    sources = [
        replace(document_of[file], text=text) for (file, _), text in zip(whole_program.files, texts, strict=True)
    ]
    longest_file = max(sources, key=lambda document: document.text.count("\n"))
    issues = list(output.issues)
    if limit and longest_file.text.count("\n") > limit:
        message = f"{longest_file.name} has more than {limit} lines: a program in several files keeps its division."
        issues.append(Issue("warning", "long-file", message))
    files = files_with_data(sources, output.documents[1] if len(output.documents) > 1 else None)
    return replace(output, documents=tuple(files), issues=tuple(issues))


class _File(Struct, frozen=True, eq=False):
    """A file of a program that is divided into several.

    :param name: name without extension.
    :param pieces: new lines, with their line ends, and ranges of lines of the undivided program, in order.
    """

    name: str
    pieces: tuple[str | range, ...]


class _Splitter:
    """Divides one program."""

    def __init__(self, name: str, output: WrittenProgram, limit: int, used_names: Collection[str]) -> None:
        """Find the routines of the program, and a prefix for the names of its files.

        :param name: name of the program.
        :param output: the written program as one text.
        :param limit: largest number of lines of a file.
        :param used_names: names of other programs and GLOBAL routines, upper case.
        :raises ProgramError: a DEF has no END, a motion is outside of DEF … END, the program has no DEF, or its DEF has
            parameters.
        """
        self.undivided, self.limit, self.issues = output, limit, list(output.issues)
        self.source = Source.of(output.documents[0], SRC)
        lines = range(1, len(self.source.starts) + 1)
        routine_of, faults = routines(self.source, lines, np.zeros(0, dtype=np.int64))
        if faults:
            raise combined_error(faults)
        main = Module(self.source, routine_of).main_routine(PurePath(output.documents[0].name).stem)
        if main is None:
            raise division_error(self.source, "it has no DEF, END or motion", 1)
        if main.parameters:
            raise division_error(self.source, "its DEF has parameters, which are not known in other files", main.first)
        self.main = main
        self.subroutines = [routine for routine in routine_of.values() if routine is not main]
        program_words = set(_code_names(self.source))
        self.base = self._name_prefix(name, program_words)
        self.used_names = {*program_words, *used_names, *(f"{self.base}{part}".upper() for part in (MAIN, *lines))}
        starts, stops = self.source.starts, self.source.stops
        # the line end of DEF, for new lines (lines count from 1)
        self.line_end = self.source.text[int(stops[main.first - 1]) : int(starts[main.first])]

    def write(self) -> WrittenProgram:
        """Return the program in several files.

        Lines of targets are numbered through all files.

        :raises ProgramError: it cannot be divided.
        """
        for line in chain.from_iterable(routine.statement_lines for routine in (self.main, *self.subroutines)):
            if statement(self.source, line).word == "RESUME":
                raise division_error(self.source, _RESUME_PROBLEM, line)
        files = self._file_contents()
        file_of, number_of = self._line_places(files)
        data = self.undivided.documents[1] if len(self.undivided.documents) > 1 else None
        program = DividedProgram(self.source, data, self.main, self.subroutines, file_of)
        source, data, new_names = Sharing(self.base, program, self.used_names).shared_program()
        self.issues += self._routine_issues(new_names)
        documents = [self._document(file, source) for file in files]
        documents[0] = replace(documents[0], text=text_with_name(documents[0].text, files[0].name))
        return replace(
            self.undivided,
            documents=tuple(files_with_data(documents, data)),
            output_line=number_of[self.undivided.output_line],
            issues=tuple(self.issues),
        )

    def _routine_issues(self, new_names: Mapping[str, str]) -> Iterator[Issue]:
        """Yield the issues about GLOBAL routines: new GLOBAL names, and GLOBAL names that the old file has too.

        :param new_names: routines that become GLOBAL: old name, upper case → new name.
        """
        if new_names:
            names = first_of([f"{old_name} is {new_name}" for old_name, new_name in new_names.items()], _MOST_NAMES)
            message = f"Routines of its own are GLOBAL, for all its files to see them: {names}."
            yield Issue("info", "global-routines", message)
        if former_names := [name for name in self._former_global_names() if name.upper() not in new_names]:
            old_file, names = self.undivided.documents[0].name, first_of(former_names, _MOST_NAMES)
            message = (
                f"These files have GLOBAL routines as {old_file} has ({names}), which they "
                f"replace: remove {old_file} from the controller, where calls could reach its uncorrected routines."
            )
            yield Issue("warning", "global-routines", message)

    def _former_global_names(self) -> Iterator[str]:
        """Yield the names, as spelled, of routines that are GLOBAL in the undivided program."""
        for routine in self.subroutines:
            head = statement(self.source, routine.first)
            if isinstance(head, Definition) and head.is_global:
                yield head.name

    def _file_contents(self) -> list[_File]:
        """Return the files in order: the main program, the parts that it calls, files with routines.

        Parts are the pieces of the main routine that become files of their own.

        Warnings about files that are too long are added to `issues`.

        :raises ProgramError: the program cannot be cut.
        """
        cut_points, blocks = find_cut_points(self.source, self.main), self._routine_blocks()
        first_routine_line = min(routine.first for routine in (self.main, *self.subroutines))
        is_header = [self.source.text[start] == "&" for start in self.source.starts[: first_routine_line - 1].tolist()]
        header = [_one_line(line) for line, is_kept in enumerate(is_header, 1) if is_kept]
        declarations = [_one_line(line) for line in cut_points.declarations]
        extra_lines = len(header) + len(declarations) + _FRAME_LINE_COUNT
        cuts, issues = part_bounds(self.source, self.base, cut_points, self.limit, extra_lines)
        self.issues += issues
        end = f"END{self.line_end}"
        bodies: list[tuple[str | range, ...]] = [(*declarations, range(*pair), end) for pair in pairwise(cuts)]
        # a file with routines begins with an empty DEF of its own name
        bodies += [(end, *group) for group in self._pack_blocks(blocks, self.limit - len(header) - _FRAME_LINE_COUNT)]
        files = [self._main_file(blocks, cuts[0], len(cuts) - 1)]
        for number, body in enumerate(bodies, 1):
            name = f"{self.base}{number}"
            head_lines = [
                f"DEF {name}( ){self.line_end}",
                f";POSTPROC 1 part={number} of={files[0].name}{self.line_end}",
            ]
            files.append(_File(name, (*header, *head_lines, *body)))
        return files

    def _main_file(self, blocks: Sequence[range], first_cut: int, part_count: int) -> _File:
        """Return the main program: its lines up to the first cut, a call of each part, and its END.

        Parts are the pieces of the main routine that become files of their own.

        :param blocks: see `_routine_blocks`.
        :param first_cut: line at which the first part begins.
        :param part_count: number of parts.
        """
        first = min(routine.first for routine in (self.main, *self.subroutines))
        last = max(routine.last for routine in (self.main, *self.subroutines))
        # behind the last routine before the main routine, or at the first DEF
        main_begin = max((block.stop for block in blocks if block.stop <= self.main.first), default=first)
        calls = [f"{self.base}{number}( ){self.line_end}" for number in range(1, part_count + 1)]
        lines_behind_routines = range(last + 1, len(self.source.starts) + 1)
        lines_before_parts = range(1, first), range(main_begin, first_cut)
        return _File(
            name=f"{self.base}{MAIN}",
            pieces=(*lines_before_parts, *calls, _one_line(self.main.last), lines_behind_routines),
        )

    def _routine_blocks(self) -> list[range]:
        """Return the lines of each routine except the main routine, each with the lines before it.

        The lines before a routine begin behind the previous routine; the first routine of the file has none.
        """
        blocks, last_line = [], 0
        for routine in sorted((self.main, *self.subroutines), key=lambda routine: routine.first):
            if routine is not self.main:
                blocks.append(range(last_line + 1 if last_line else routine.first, routine.last + 1))
            last_line = routine.last
        return blocks

    def _pack_blocks(self, blocks: Sequence[range], capacity: int) -> list[list[range]]:
        """Return blocks of lines in groups, one group for each file, in order.

        A block that is larger than a file begins a new file, and a warning is added to `issues`.

        :param capacity: number of lines that a file can contain.
        """
        groups: list[list[range]] = []
        free_lines = 0  # of the last group
        for block in blocks:
            if not groups or len(block) > free_lines:
                groups.append([])
                free_lines = capacity
            if len(block) > capacity:
                message = (
                    f"A routine of the program, at line {block.start}, has {len(block)} lines and is not cut: its file "
                    f"has more than {self.limit} lines. Divide it into several DEF, or raise lines_per_file."
                )
                self.issues.append(Issue("warning", "long-file", message))
            groups[-1].append(block)
            free_lines -= len(block)
        return groups

    def _line_places(self, files: Sequence[_File]) -> tuple[Ints, Ints]:
        """Return the file (L + 1,) of each line of the program, as index in `files`, and the new line number (L + 1,).

        New numbers run through all files. A line that several files contain counts in the first. Lines count from 1;
        element 0 is unused. A line in no file has 0 and 0.
        """
        file_of, number_of = (np.zeros(len(self.source.starts) + 1, dtype=np.int64) for _ in range(2))
        number = 1
        for index, file in enumerate(files):
            for piece in file.pieces:
                if isinstance(piece, range):
                    rows = np.array(piece, dtype=np.int64)
                    is_new = number_of[rows] == 0
                    file_of[rows[is_new]] = index
                    number_of[rows[is_new]] = (number + np.arange(len(rows)))[is_new]
                number += len(piece) if isinstance(piece, range) else 1  # a text is one line
        return file_of, number_of

    def _document(self, file: _File, source: Source) -> Document:
        """Return a file of the divided program; its ranges of lines are taken from `source`."""
        # the end of the text is the start of a line behind the last
        starts, text = np.append(source.starts, len(source.text)), source.text
        pieces = [
            piece if isinstance(piece, str) else text[int(starts[piece.start - 1]) : int(starts[piece.stop - 1])]
            for piece in file.pieces
        ]
        return replace(self.undivided.documents[0], name=f"{file.name}.src", text="".join(pieces))

    def _name_prefix(self, name: str, used_names: Collection[str]) -> str:
        """Return the prefix of the file names: `name`, if necessary shortened and with ``_2``, ``_3`` … behind it.

        The controller accepts the names of all files, and the program uses none of them.

        :param used_names: names in the code of the program, upper case.
        """
        return next(prefix for prefix in self._prefixes(name) if self._is_free_prefix(prefix, used_names))

    def _prefixes(self, name: str) -> Iterator[str]:
        """Yield a name, then the name with ``_2``, ``_3`` … behind it; each is short enough for the names of files."""
        for tail in chain([""], (f"_{number}" for number in count(2))):
            yield name[: MAX_LENGTH - len(MAIN) - len(tail)] + tail

    def _is_free_prefix(self, prefix: str, used_names: Collection[str]) -> bool:
        """Return whether the controller accepts the names of files with a prefix, and none is in `used_names`."""
        file_names = {f"{prefix}{part}".upper() for part in (MAIN, *range(1, len(self.source.starts) + 1))}
        return file_names.isdisjoint(used_names) and not any(fault_of(f"{prefix}{part}") for part in (MAIN, 1))


def _one_line(line: int) -> range:
    """Return the range that contains one line."""
    return range(line, line + 1)


def _code_names(source: Source) -> Iterator[str]:
    """Yield the names, upper case, in the code of a file, except in motions without brackets: they call nothing."""
    for line in range(1, len(source.starts) + 1):
        start, stop = source.code_span(line)
        if word_at(source.text, start, stop) not in MOTION_WORDS or "(" in source.text[start:stop]:
            yield from names_in(source.text, start, stop)
