"""One program in several files: `part1.src`, `part2.src` … called one after the other by `partMain.src`.

Such files are read, corrected and written as one text. The lines that only divide it (headers, DEF, END, calls) are
comments there, with a mark before them, so that every line keeps its place, counted on from file to file, and the text
can be taken apart again to the byte.

Its own routines, which all parts see, are in further files of the series that no program calls: `part4.src` … . A
comment in each names the program; its first routine, which has the name of the file, is empty.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import PurePath

from msgspec import Struct
from msgspec.structs import replace

from postproc.dialects.krl.language import scan
from postproc.dialects.krl.language.declarations import DataLine, data_lines
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import FORCE, after_sign
from postproc.dialects.krl.language.tree import CallStatement, Definition
from postproc.errors import ProgramError
from postproc.program import Document, Unresolved

MAIN = "Main"
"""What the name of the program that calls the others ends with."""
_DIVIDES, _BEGINS, _UNENDED = ";\x01", ";\x02", ";\x03"
"""Before lines that only divide; before the first line of each file but the main one; before a last one without end."""
_END = "END ;\x04\r\n"
"""Added to the joined text if no routines follow its parts: it has no END of its own then."""
_UNENDED_LINE = re.compile(f"{_UNENDED}([^\r\n]*)\n")
_PART_OF = re.compile(r"^;POSTPROC[ \t]+\d+[ \t]+part=\d+[ \t]+of=([\w$]+)[ \t]*\r?$", re.MULTILINE | re.ASCII)


class Joined(Struct, frozen=True, eq=False):
    """A program in several files as one.

    :param documents: its `.src` as one text, and one `.dat` if any of the files has one.
    :param files: name of each `.src` and the number that its first line has in the one text.
    """

    documents: tuple[Document, ...]
    files: tuple[tuple[str, int], ...]

    def place(self, file: str, line: int) -> tuple[str, int]:
        """Return the file, and the line of it, that a line of one of the joined texts comes from."""
        if file != self.documents[0].name:
            return file, line
        name, first = [each for each in self.files if each[1] <= line][-1]
        return name, line + 1 - first

    def placed(self, left: Unresolved) -> Unresolved:
        """Return a motion that stays as it is with its file and its line there."""
        file, line = self.place(left.file, left.line)
        return replace(left, file=file, line=line)

    def located(self, error: ProgramError) -> ProgramError:
        """Return an error with the file and the line of it that it is about."""
        file, line = error.file, error.line
        if line is not None and file is not None:
            file, line = self.place(file, line)
        text = None if error.text is None else error.text.lstrip("".join((_DIVIDES, _BEGINS, _UNENDED)))
        others = [self.located(other) for other in error.further_errors if isinstance(other, ProgramError)]
        return ProgramError(error.problem, file=file, line=line, text=text, advice=error.advice, further_errors=others)


def called(main: Document) -> list[tuple[str, int]]:
    """Return the programs that a main program calls one after the other at its end, and the line of each call.

    :returns: names as they are spelled there; empty if it is no main program of several files.
    """
    stem = PurePath(main.name).stem
    if not stem.lower().endswith(MAIN.lower()) or len(stem) == len(MAIN):
        return []
    source = Source.of(main, 0)
    found: list[tuple[str, int]] = []
    ended = False
    own = stem[: -len(MAIN)].lower().rstrip("0123456789")
    for line in range(len(source.starts), 0, -1):
        here = statement(source, line)
        called_ = here.call.spelt(source) if isinstance(here, CallStatement) and not here.call.arguments else ""
        if ended and called_ and called_.lower().rstrip("0123456789") == own:
            found.append((called_, line))
        elif not ended and _is_end(source, line):
            ended = True
        elif here.start < here.stop:
            break
    found.reverse()
    wanted = [f"{stem[: -len(MAIN)]}{number}".lower() for number in range(1, len(found) + 1)]
    return found if [name.lower() for name, _ in found] == wanted else []


def beyond(main: Document, find: Callable[[str], Document | None]) -> list[Document]:
    """Return the files with routines of a main program of several files, which follow those that it calls.

    :param find: returns a file by its name, None if there is none.
    """
    found: list[Document] = []
    stem, calls = PurePath(main.name).stem, called(main)
    while calls:
        document = find(f"{stem[: -len(MAIN)]}{len(calls) + len(found) + 1}.src")
        says = None if document is None else part_of(document)
        if document is None or says is None or says.lower() != stem.lower():
            break
        found.append(document)
    return found


def part_of(document: Document) -> str | None:
    """Return the main program of which a file says that it is a part; None if it does not."""
    says = _PART_OF.search(document.text)
    return None if says is None else says[1]


def joined(documents: Sequence[Document]) -> Joined | None:
    """Return the files of a program as one; None if it is a program of one file.

    :param documents: the main program first, the others in any order.
    :raises ProgramError: a file is missing, or cannot be one of several.
    """
    main, *others = documents
    calls = called(main)
    known = {document.name.lower(): document for document in others}
    if not calls or not any(f"{name}.src".lower() in known for name, _ in calls):
        return None
    missing = [(name, line) for name, line in calls if f"{name}.src".lower() not in known]
    if missing:
        advice = "Put all files of the program next to it."
        raise Source.of(main, 0).line_error(f"{missing[0][0]}.src is not there", missing[0][1], advice)
    parts = [known[f"{name}.src".lower()] for name, _ in calls]
    more = beyond(main, lambda name: known.get(name.lower()))
    texts = [_main_text(main, [line for _, line in calls]), *(_part_text(part) for part in parts[:-1])]
    texts += [_part_text(parts[-1], ends=bool(more)), *(_part_text(part, several=True) for part in more)]
    first = 1
    files = []
    parts += more
    for document in (main, *parts):
        files.append((document.name, first))
        first += len(Source.of(document, 0).starts)
    stems = [PurePath(document.name).stem.lower() for document in (main, *parts)]
    data = [known[f"{stem}.dat"] for stem in stems if f"{stem}.dat" in known]
    whole = replace(main, text="".join([*texts, *([] if more else [_END])]))
    return Joined((whole, *([_joined_data(main, data)] if data else [])), tuple(files))


def taken_apart(text: str) -> list[str]:
    """Return the texts of the files that one text was joined from, the main one first."""
    pieces = text.removesuffix(_END).split(_BEGINS)
    return [_UNENDED_LINE.sub(r"\1", piece).replace(_DIVIDES, "") for piece in pieces]


def _main_text(main: Document, calls: Sequence[int]) -> str:
    """Return the main program with its calls and its END as comments."""
    source = Source.of(main, 0)
    _only_def(source)
    for line in range(calls[0], len(source.starts) + 1):
        if FORCE.match(source.text[source.starts[line - 1] : source.stops[line - 1]].strip()):
            advice = "Write it into the program that is called."
            raise source.line_error("a force comment between the calls of the parts", line, advice)
    end = max(line for line in range(calls[-1], len(source.starts) + 1) if _is_end(source, line))
    return _with_marks(source, [*calls, end])


def _part_text(part: Document, *, ends: bool = False, several: bool = False) -> str:
    """Return a part with its header, DEF and END as comments.

    :param ends: its END is that of the whole program, and stays.
    :param several: other routines follow its END.
    """
    source = Source.of(part, 0)
    begin = _only_def(source, several=several)
    text = source.text
    header = [line for line in range(1, begin) if text[source.starts[line - 1]] == "&"]
    found = (line for line in range(begin, len(source.starts) + 1) if _is_end(source, line))
    end = next(found, None) if several else max(found, default=None)
    if end is None:
        raise source.line_error("DEF has no END", begin, "Check that the file was transferred completely.")
    return _BEGINS + _with_marks(source, [*header, begin, *([] if ends else [end])])


def _only_def(source: Source, *, several: bool = False) -> int:
    """Return the line of the DEF of a file; of several that of the first."""
    found = [source.line_at(one.start) for one in scan.routines(source.text)][: 1 if several else None]
    if len(found) != 1 or not _has_no_parameters(source, found[0]):
        problem = f"a program in several files has one DEF without parameters in each, and here are {len(found)}"
        raise source.line_error(problem, found[-1] if found else 1, "Join the files by hand.")
    return found[0]


def _has_no_parameters(source: Source, line: int) -> bool:
    """Return whether a line is a DEF with empty brackets."""
    here = statement(source, line)
    if not isinstance(here, Definition) or here.word != "DEF" or here.parameters:
        return False
    return after_sign(source.text, here.at + len(here.name), here.stop, "(") >= 0


def _is_end(source: Source, line: int) -> bool:
    return source.text[slice(*source.code_span(line))].upper() == "END"


def _with_marks(source: Source, lines: Sequence[int]) -> str:
    """Return the text of a file with some of its lines (ascending) as comments, and with an end of its last line."""
    if any(mark in source.text for mark in (_DIVIDES, _BEGINS, _UNENDED)):
        raise ProgramError("control characters in the program", file=source.document.name)
    pieces, done = [], 0
    for line in lines:
        start = int(source.starts[line - 1])
        pieces += [source.text[done:start], _DIVIDES]
        done = start
    pieces.append(source.text[done:])
    text = "".join(pieces)
    if source.stops[-1] == len(source.text):
        start = text.rfind("\n") + 1 if "\n" in text else text.rfind("\r") + 1
        text = f"{text[:start]}{_UNENDED}{text[start:]}\n"
    return text


def _joined_data(main: Document, data: Sequence[Document]) -> Document:
    """Return the data of all files as one, each declaration once.

    :raises ProgramError: one name has different values.
    """
    lines: dict[str, str] = {}
    known: dict[str, list[str]] = {}
    for document in data:
        stated: dict[str, list[DataLine]] = {}
        for line in data_lines(Source.of(document, 1)):
            for name in line.names:
                stated.setdefault(name, []).append(line)
            lines.setdefault(line.text.strip() if line.names else f"{document.name}:{line.line}", line.text)
        for name, own in stated.items():
            texts = [line.text.strip() for line in own]
            if known.setdefault(name, texts) != texts:
                problem = f"{name} has another value than in the file before"
                advice = "Give it another name: the parts are corrected as one program."
                raise ProgramError(problem, file=document.name, line=own[0].line, text=own[0].text, advice=advice)
    end = "\r\n"
    text = "".join([f"DEFDAT {PurePath(main.name).stem}{end}", *lines.values(), f"ENDDAT{end}"])
    return replace(data[0], name=f"{PurePath(main.name).stem}.dat", text=text)
