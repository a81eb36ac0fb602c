"""One program in several files: `part1.src`, `part2.src` … called one after the other by `partMain.src`.

Such files are read, corrected and written as one text. Lines that only divide the program (headers, DEF, END, calls)
become comments in the joined text: a mark precedes them. So the joined text has all lines of the files, and can be
separated again to the byte.

Routines that all parts call are in further files of the series, `part4.src` …, that no program calls. A comment in each
names the program; its first routine, which has the name of the file, is empty.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import PurePath

from msgspec import Struct
from msgspec.structs import replace

from postproc.dialects.krl.language import scan
from postproc.dialects.krl.language.declarations import DataLine, data_lines
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import DAT, SRC, Source
from postproc.dialects.krl.language.tokens import FORCE, skip_sign
from postproc.dialects.krl.language.tree import CallStatement, Definition
from postproc.errors import ProgramError
from postproc.program import Document, UnresolvedMotion

MAIN = "Main"
"""End of the name of the main program, which calls the others."""
_DIVISION_MARK, _FILE_MARK, _UNENDED_MARK = ";\x01", ";\x02", ";\x03"
"""Marks in the joined text: before lines that only divide it, before the first line of each file but the main file, and
before a last line without line end. They begin with ``;``, so that KRL takes the rest of their line for a comment.
"""
_ADDED_END = "END ;\x04\r\n"
"""END of the joined text, if no files with routines follow the parts: the END of each part is a comment."""
_DIGITS = "0123456789"
_UNENDED_LINE = re.compile(f"{_UNENDED_MARK}([^\r\n]*)\n")
_PART_OF = re.compile(r"^;POSTPROC[ \t]+\d+[ \t]+part=\d+[ \t]+of=([\w$]+)[ \t]*\r?$", re.MULTILINE | re.ASCII)


class JoinedProgram(Struct, frozen=True, eq=False):
    """A program in several files as one text.

    :param documents: the joined `.src`, and one joined `.dat` if any of the files has a `.dat`.
    :param files: name of each `.src`, and the number of its first line in the joined text.
    """

    documents: tuple[Document, ...]
    files: tuple[tuple[str, int], ...]

    def original_line(self, file: str, line: int) -> tuple[str, int]:
        """Return the file and the line from which a line comes: a line of the joined text, or of another file.

        Lines of other files are returned unchanged.
        """
        if file != self.documents[0].name:
            return file, line
        name, first = next((name, first) for name, first in reversed(self.files) if first <= line)
        return name, line + 1 - first

    def motion_in_file(self, motion: UnresolvedMotion) -> UnresolvedMotion:
        """Return an uncorrected motion with the file and the line from which its line of the joined text comes."""
        file, line = self.original_line(motion.file, motion.line)
        return replace(motion, file=file, line=line)

    def error_in_file(self, error: ProgramError) -> ProgramError:
        """Return an error with the file and the line from which its line of the joined text comes.

        `further_errors` are changed in the same way. Errors in other files keep their file and line.
        """
        file, line = error.file, error.line
        if line is not None and file is not None:
            file, line = self.original_line(file, line)
        mark_characters = "".join((_DIVISION_MARK, _FILE_MARK, _UNENDED_MARK))  # before lines of the joined text
        text = None if error.text is None else error.text.lstrip(mark_characters)
        later_errors = [
            self.error_in_file(later_error)
            for later_error in error.further_errors
            if isinstance(later_error, ProgramError)
        ]
        return ProgramError(
            error.problem, file=file, line=line, text=text, advice=error.advice, further_errors=later_errors
        )


def called_parts(main: Document) -> list[tuple[str, int]]:
    """Return the parts of a program in several files: those that its main program calls one after the other at its end.

    :returns: name of each part, as the call spells it, and line of the call, in order. Empty if the file is not the
        main program of several files: its calls must name ``part1``, ``part2`` … without a gap.
    """
    stem = PurePath(main.name).stem
    if not stem.lower().endswith(MAIN.lower()) or len(stem) == len(MAIN):
        return []
    source = Source.of(main, SRC)
    calls: list[tuple[str, int]] = []
    has_end = False
    base_name = stem[: -len(MAIN)].lower()
    for line in range(len(source.starts), 0, -1):  # from the end: END, and the calls before it
        node = statement(source, line)
        callee = node.call.spelling(source) if isinstance(node, CallStatement) and not node.call.arguments else ""
        # digits are stripped from both names, as the name of the program may end with digits too
        if has_end and callee and callee.lower().rstrip(_DIGITS) == base_name.rstrip(_DIGITS):
            calls.append((callee, line))
        elif not has_end and _is_end(source, line):
            has_end = True
        elif node.start < node.stop:  # other code: calls before it do not call parts
            break
    calls.reverse()
    expected_names = [f"{base_name}{number}" for number in range(1, len(calls) + 1)]
    return calls if [name.lower() for name, _ in calls] == expected_names else []


def files_of_routines(main: Document, find_file: Callable[[str], Document | None]) -> list[Document]:
    """Return the files with the routines of a program in several files: those whose numbers follow those of its parts.

    With ``part1.src`` to ``part3.src``, which the main program calls, these are ``part4.src`` and so on, as long as a
    comment in them names the main program. Empty if the program is in one file.

    :param main: the main program.
    :param find_file: returns a file by its name; None if there is no such file.
    """
    files: list[Document] = []
    stem, calls = PurePath(main.name).stem, called_parts(main)
    while calls:
        document = find_file(f"{stem[: -len(MAIN)]}{len(calls) + len(files) + 1}.src")
        main_name = None if document is None else stated_main_program(document)
        if document is None or main_name is None or main_name.lower() != stem.lower():
            break
        files.append(document)
    return files


def stated_main_program(document: Document) -> str | None:
    """Return the main program that a comment such as ``;POSTPROC 1 part=2 of=partMain`` names; None without it."""
    main_name = _PART_OF.search(document.text)
    return None if main_name is None else main_name[1]


def joined_program(documents: Sequence[Document]) -> JoinedProgram | None:
    """Return the files of a program in several files as one text; None if none of the parts is in `documents`.

    None too for a program in one file. The parts are ``part1.src``, ``part2.src`` …, which ``partMain.src`` calls.

    :param documents: the main program first, the other files in any order.
    :raises ProgramError: some of the parts are missing, or a file cannot be a part of a program.
    """
    main, *other_files = documents
    calls = called_parts(main)
    document_of = {document.name.lower(): document for document in other_files}
    absent_calls = [(name, line) for name, line in calls if f"{name}.src".lower() not in document_of]
    if len(absent_calls) == len(calls):
        return None
    if absent_calls:
        (name, line), advice = absent_calls[0], "Put all files of the program next to it."
        raise Source.of(main, SRC).line_error(f"{name}.src is not there", line, advice)
    parts = [document_of[f"{name}.src".lower()] for name, _ in calls]
    routine_files = files_of_routines(main, lambda name: document_of.get(name.lower()))
    texts = [
        _main_text(main, [line for _, line in calls]),
        *(_part_text(part) for part in parts[:-1]),
        _part_text(parts[-1], keeps_end=bool(routine_files)),
        *(_part_text(file, has_routines=True) for file in routine_files),
        "" if routine_files else _ADDED_END,
    ]
    sources = (main, *parts, *routine_files)
    stems = [PurePath(document.name).stem.lower() for document in sources]
    data = [document_of[f"{stem}.dat"] for stem in stems if f"{stem}.dat" in document_of]
    whole_documents = (replace(main, text="".join(texts)), *([_joined_data(main, data)] if data else []))
    return JoinedProgram(whole_documents, tuple(_files_with_first_lines(sources)))


def _files_with_first_lines(documents: Sequence[Document]) -> Iterator[tuple[str, int]]:
    """Yield the name of each file, and the number, from 1, of its first line in the joined text."""
    first = 1
    for document in documents:
        yield document.name, first
        first += len(Source.of(document, SRC).starts)  # number of lines


def separated_texts(text: str) -> list[str]:
    """Return the texts of the files from which a text was joined, the main file first.

    Marks and END that `joined_program` added are removed.
    """
    pieces = text.removesuffix(_ADDED_END).split(_FILE_MARK)
    return [_UNENDED_LINE.sub(r"\1", piece).replace(_DIVISION_MARK, "") for piece in pieces]


def _main_text(main: Document, calls: Sequence[int]) -> str:
    """Return the text of the main program for the joined text: its calls of the parts and its END are comments.

    The texts of the parts follow it, and an END behind the last of them.

    :param calls: lines of these calls, ascending.
    :raises ProgramError: a force comment follows the first of the calls, and would precede all parts in the joined
        text; the file has other routines; DEF has parameters.
    """
    source = Source.of(main, SRC)
    _def_line(source)  # the line is not needed: raises if there are other routines or parameters
    for line in range(calls[0], len(source.starts) + 1):
        if FORCE.match(source.text[source.starts[line - 1] : source.stops[line - 1]].strip()):
            advice = "Write it into the program that is called."
            raise source.line_error("a force comment between the calls of the parts", line, advice)
    end = max(line for line in range(calls[-1], len(source.starts) + 1) if _is_end(source, line))
    return _marked_text(source, [*calls, end])


def _part_text(part: Document, *, keeps_end: bool = False, has_routines: bool = False) -> str:
    """Return the text of a part, with a mark of its beginning, and with header, DEF and END as comments.

    :param keeps_end: True for the last part before files with routines: its END stays, and ends the whole program.
    :param has_routines: True for a file with routines: they follow the first END, which is that of its empty DEF.
    :raises ProgramError: the file has no END, its DEF has parameters, or a part has several DEF.
    """
    source = Source.of(part, SRC)
    begin = _def_line(source, has_routines=has_routines)
    text = source.text
    header = [line for line in range(1, begin) if text[source.starts[line - 1]] == "&"]  # such as &ACCESS
    end_lines = (line for line in range(begin, len(source.starts) + 1) if _is_end(source, line))
    end = next(end_lines, None) if has_routines else max(end_lines, default=None)
    if end is None:
        raise source.line_error("DEF has no END", begin, "Check that the file was transferred completely.")
    return _FILE_MARK + _marked_text(source, [*header, begin, *([] if keeps_end else [end])])


def _def_line(source: Source, *, has_routines: bool = False) -> int:
    """Return the line of the DEF of a file.

    :param has_routines: True if the file may have several DEF: the line of the first is returned.
    :raises ProgramError: the file has no DEF, has several without `has_routines`, or DEF has parameters.
    """
    def_lines = [source.line_at(routine.start) for routine in scan.routines(source.text)][: 1 if has_routines else None]
    if len(def_lines) != 1 or not _has_no_parameters(source, def_lines[0]):
        problem = f"a program in several files has one DEF without parameters in each, and here are {len(def_lines)}"
        raise source.line_error(problem, def_lines[-1] if def_lines else 1, "Join the files by hand.")
    return def_lines[0]


def _has_no_parameters(source: Source, line: int) -> bool:
    """Return whether a line is a DEF with empty brackets."""
    node = statement(source, line)
    if not isinstance(node, Definition) or node.word != "DEF" or node.parameters:
        return False
    return skip_sign(source.text, node.name_start + len(node.name), node.stop, "(") >= 0


def _is_end(source: Source, line: int) -> bool:
    """Return whether the code of a line is END."""
    return source.text[slice(*source.code_span(line))].upper() == "END"


def _marked_text(source: Source, lines: Sequence[int]) -> str:
    """Return the text of a file in which some lines are comments: ``;`` and a control character precede each.

    `separated_texts` finds these marks and removes them. A last line without line end gets a mark of its own and a line
    end, so that another file can follow.

    :param lines: lines that become comments, 1-based, ascending.
    :raises ProgramError: the text contains a mark already, so that it could not be restored.
    """
    if any(mark in source.text for mark in (_DIVISION_MARK, _FILE_MARK, _UNENDED_MARK)):
        raise ProgramError(
            "control characters in the program",
            file=source.document.name,
            advice="Remove them: a program is plain text.",
        )
    pieces, copied_to = [], 0
    for line in lines:
        start = int(source.starts[line - 1])
        pieces += [source.text[copied_to:start], _DIVISION_MARK]
        copied_to = start
    pieces.append(source.text[copied_to:])
    text = "".join(pieces)
    if source.stops[-1] == len(source.text):  # the last line has no line end
        start = text.rfind("\n") + 1 if "\n" in text else text.rfind("\r") + 1
        text = f"{text[:start]}{_UNENDED_MARK}{text[start:]}\n"
    return text


def _joined_data(main: Document, data: Sequence[Document]) -> Document:
    """Return the data lists of all files as one `.dat`; a declaration that several files have is in it once.

    :param data: the `.dat` of the files, in their order.
    :raises ProgramError: two files declare or initialise one name differently.
    """
    lines: dict[str, str] = {}  # declaration, or file and number of another line → text of the line
    texts_of_name: dict[str, list[str]] = {}
    for document in data:
        lines_of_name: dict[str, list[DataLine]] = {}
        for line in data_lines(Source.of(document, DAT)):
            for name in line.names:
                lines_of_name.setdefault(name, []).append(line)
            # equal declarations have one key; lines without a declaration, such as comments, are all kept
            key = line.text.strip() if line.names else f"{document.name}:{line.line}"
            lines.setdefault(key, line.text)
        for name, name_lines in lines_of_name.items():
            texts = [line.text.strip() for line in name_lines]
            if texts_of_name.setdefault(name, texts) != texts:  # an earlier file has other lines with the name
                problem = f"{name} has another value than in the file before"
                advice = "Give it another name: the parts are corrected as one program."
                raise ProgramError(
                    problem, file=document.name, line=name_lines[0].line, text=name_lines[0].text, advice=advice
                )
    end = "\r\n"
    text = "".join([f"DEFDAT {PurePath(main.name).stem}{end}", *lines.values(), f"ENDDAT{end}"])
    return replace(data[0], name=f"{PurePath(main.name).stem}.dat", text=text)
