"""Execution of a program: its lines in execution order, with numbers in place of expressions.

Subprograms, loops and branches are expanded. The result is a program of plain lines, which is then read like any other;
each of its lines knows its file and line number. Lines without parameters and O-words are copied in runs, so a program
whose subprograms are paths costs little. `structure` reads what the lines with O-words and expressions mean.

A subprogram is in the file that calls it, in the main program, or in another file of the folder, see `subprograms`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.chunks import compact, ragged_range
from postproc.dialects.gcode.expressions import Parameters, nearest_integer
from postproc.dialects.gcode.structure import Block, OWord, ProgramFile, end_words, needs_execution
from postproc.dialects.gcode.subprograms import SubprogramFiles, label_of_file
from postproc.dialects.gcode.words import COMMENT_MARK, EARLY_PERCENT, BlockError, Fault, Source, line_feeds, split
from postproc.dialects.text import decode
from postproc.errors import MAX_ERRORS, ProgramError, SubprogramError
from postproc.program import Document, Ints, constant


class ExecutedProgram(Struct, frozen=True, eq=False):
    """A program in execution order.

    :param source: its lines, each as often as it is executed.
    :param documents: their files, the program first.
    :param document: (L,) index of the file of each line.
    :param line: (L,) its 1-based line number in that file.
    :param main_line: (L,) its line number in the program; for a line of another file, the line number of the call.
    :param faults: why it cannot be executed further; their rows are those of `source`.
    :param after_end: line numbers in the program of lines with coordinates after its end, which are not executed. Empty
        for a program without calls, loops and parameters: `source` has its lines after the end too.
    """

    source: Source
    documents: tuple[Document, ...]
    document: Ints
    line: Ints
    main_line: Ints
    faults: tuple[Fault, ...] = ()
    after_end: tuple[int, ...] = ()


class LineRange(NamedTuple):
    """Consecutive lines of a file that are executed one after the other.

    :param file_index: index of the file.
    :param first: row of the first line; `last`: row after the last line.
    :param main_row: row of the program from which the file was called; −1 for lines of the program itself.
    :param text: the executed words of a single line, if they differ from those of the file.
    """

    file_index: int
    first: int
    last: int
    main_row: int
    text: str | None = None


def joined_program(
    files: Sequence[ProgramFile], line_ranges: Sequence[LineRange], faults: Sequence[Fault], end: int
) -> ExecutedProgram:
    """Return line ranges, given in execution order, as one program.

    :param files: the files of the ranges, the program first.
    :param faults: faults of the program; their rows are those of the joined lines.
    :param end: row of the program at which it ends.
    """
    code = b"\n" + b"".join(_range_texts(files, line_ranges))
    columns = np.array([line_range[:4] for line_range in line_ranges], dtype=np.int64)  # the fields without `text`
    file_index, first, last, main_row = columns.reshape(-1, 4).T
    count = last - first
    row = ragged_range(count, first)
    document, main_row = np.repeat(file_index, count), np.repeat(main_row, count)
    comments, comment_rows = _executed_comments(files, document, row)
    line = row + 1
    after_end = np.setdiff1d(files[0].source.rows_with_coordinates(end), row[document == 0]) + 1
    return ExecutedProgram(
        source=Source(code, line_feeds(code), comments, comment_rows + 1),
        documents=tuple(file.document for file in files),
        document=document,
        line=line,
        main_line=np.where(main_row < 0, line, main_row + 1),  # −1: a line of the program itself
        faults=tuple(faults),
        after_end=tuple(after_end.tolist()),
    )


def _range_texts(files: Sequence[ProgramFile], line_ranges: Sequence[LineRange]) -> Iterator[bytes]:
    """Yield the text of line ranges in execution order."""
    sources = [(file.source.code, file.source.ends.tolist()) for file in files]
    for line_range in line_ranges:
        if line_range.text is not None:
            yield line_range.text.encode("ascii") + b"\n"
        else:
            code, ends = sources[line_range.file_index]
            yield code[ends[line_range.first] + 1 : ends[line_range.last] + 1]


def _executed_comments(files: Sequence[ProgramFile], document: Ints, row: Ints) -> tuple[tuple[str, ...], Ints]:
    """Return the comments (n) of the executed lines, and the index (n,) of the executed line of each.

    :param document: (L,) index of the file of each executed line; `row`: (L,) its row in that file.
    """
    texts: list[str] = []
    executed_rows: list[Ints] = []
    text_indices: list[Ints] = []
    for n, file in enumerate(files):
        rows = np.flatnonzero(document == n)
        comment_rows = file.source.comment_lines - 1
        # comments of each executed row: a range of `comment_rows`, which ascend
        first = np.searchsorted(comment_rows, row[rows], "left")
        count = np.searchsorted(comment_rows, row[rows], "right") - first
        executed_rows.append(np.repeat(rows, count))
        text_indices.append(len(texts) + ragged_range(count, first))
        texts += file.source.comments
    order = np.argsort(np.concatenate(executed_rows), kind="stable")  # comments of one row keep their order
    ordered_indices = np.concatenate(text_indices)[order].tolist()
    return tuple(texts[n] for n in ordered_indices), np.concatenate(executed_rows)[order]


class Library:
    """The files of a program.

    :ivar files: the program, then the files of its folder in the order of their first call.
    """

    def __init__(self, program: ProgramFile) -> None:
        self.files = [program]
        self._folder_files: SubprogramFiles | None = None

    def find_subprogram(self, label: str, caller: int, *, is_linuxcnc_style: bool) -> tuple[int, int] | None:
        """Return the index in `files` of the file of a subprogram, and its first row there; None: no file has it.

        It is searched for in the calling file, in the program, and then in the other files of the folder.

        :param label: name or number of the subprogram.
        :param caller: index of the calling file in `files`.
        :param is_linuxcnc_style: whether it is called by ``O<name> CALL``, not by M98.
        :raises BlockError: its file cannot be read, or has no such SUB.
        """
        for loaded_index in dict.fromkeys((caller, 0)):  # the calling file, then the main one
            loaded_file = self.files[loaded_index]
            label_row = (loaded_file.subs if is_linuxcnc_style else loaded_file.numbered_subs).get(label)
            if label_row is not None:
                return loaded_index, label_row + 1
        file_index = self._load_file(label)
        if file_index is None:
            return None
        file = self.files[file_index]
        label_row = (file.subs if is_linuxcnc_style else file.numbered_subs).get(label)
        if label_row is not None:
            return file_index, label_row + 1
        if is_linuxcnc_style:
            raise BlockError(f"{file.document.name} has no O<{label}> SUB", None)
        return file_index, 0  # a file called by M98 need not state its number: it begins with its first line

    def _load_file(self, label: str) -> int | None:
        """Return the index in `files` of the file of the folder that contains a subprogram; None: there is none.

        A file is read and added to `files` when it is first called.

        :raises BlockError: it cannot be read.
        """
        for n, file in enumerate(self.files):  # 0 is the program itself
            if n and label_of_file(file.document.name) == label:
                return n
        path = self._subprogram_file(label)
        if path is None:
            return None
        try:
            document = replace(decode(path.name, path.read_bytes()), folder=str(path.parent))
        except OSError as cause:
            raise BlockError(f"subprogram O{label}: {path.name} cannot be read ({cause.strerror})", None) from cause
        except ProgramError as cause:
            raise BlockError(f"subprogram O{label}: {cause.problem}", None) from cause
        file = ProgramFile.from_source(document, split(document))
        if file.faults:
            problem, line = file.faults[0].problem, file.faults[0].row + 1
            raise BlockError(f"subprogram O{label}: {path.name}:{line}: {problem}", None)
        self.files.append(file)
        return len(self.files) - 1

    def _subprogram_file(self, label: str) -> Path | None:
        """Return the file of the program's folder that is named after a subprogram, or None.

        The first call lists the folder into `_folder_files`.
        """
        main = self.files[0].document
        if not main.folder:
            return None
        if self._folder_files is None:
            self._folder_files = SubprogramFiles(Path(main.folder))
        return self._folder_files.find_file(label, main.name)


_MOST_NOTABLE_LINES = 2_000_000
"""Limit of executed lines with parameters or O-words, see `ProgramFile.next_notable_row`: more are reported as an
endless loop."""
_MOST_ROWS = 10_000_000
"""Limit of all executed lines: ten times those of a program of 10⁶ motions."""
_MOST_CALL_LEVELS = 10
"""Limit of nested subprogram calls, as in LinuxCNC."""
_CALL = re.compile(r"([PL])([+-]?(?:\d+\.?\d*|\.\d+))|M0*9[89]")
_LOOP_ADVICE = "Is it an endless loop? Check its end condition."


def execute(document: Document) -> ExecutedProgram:
    """Return a program in execution order; one without calls, loops and parameters as it is.

    :raises SubprogramError: the file only defines subprograms.
    """
    source = split(document)
    if not needs_execution(source):
        line = compact(np.arange(1, len(source) + 1), np.int32)  # 32 bits save memory
        return ExecutedProgram(
            source=source,
            documents=(document,),
            document=constant(0, len(source)),
            line=line,
            main_line=line,
        )
    file = ProgramFile.from_source(document, source)
    # with faults of its O-words a file is not known to be a subprogram: its faults are returned instead
    name = None if file.faults else file.defined_subprogram()
    if name is not None:
        raise SubprogramError(
            f"this is a subprogram, {name}",
            file=document.name,
            advice="Convert the program that calls it.",
        )
    return _Execution(file).executed_program()


class _ActiveCall(Struct, frozen=True):
    """A call of a subprogram that has not returned yet.

    :param label: name or number of the subprogram.
    :param is_linuxcnc_style: whether it was called by ``O<name> CALL``, not by M98.
    :param file_index: index of the calling file; `row`: row after the call.
    :param main_row: `_Execution.main_row` of the caller.
    :param repeats: number of further repeats that M98 asks for.
    :param begin: first row of the subprogram, from which it is repeated.
    """

    label: str
    is_linuxcnc_style: bool
    file_index: int
    row: int
    main_row: int
    repeats: int
    begin: int


class _EndError(Exception):
    """The execution stops: the program ends, or a fault leaves open which line is next."""


class _Execution:
    """Execution of a program: the present line, the calls that lead to it, and the line ranges executed so far.

    :ivar file_index: index of the present file in `files`; 0: the program itself. `row`: next row in it.
    :ivar calls: the calls that have not returned yet, the innermost last.
    :ivar main_row: row of the program from which the present subprogram was called; −1 in the program itself.
    :ivar remaining_rounds: rounds that REPEAT loops still have to make, by number of open calls, file and row of the
        loop.
    :ivar row_count: number of executed lines; `notable_count`: number of executed lines with parameters or O-words.
    :ivar faults: faults by file and row.
    :ivar end: row of the program at which it ends.
    """

    def __init__(self, file: ProgramFile) -> None:
        self.end = len(file.source)
        self.library = Library(file)
        self.files = self.library.files
        self.file_index, self.row, self.main_row = 0, 0, -1
        self.parameters = Parameters()
        self.calls: list[_ActiveCall] = []
        self.remaining_rounds: dict[tuple[int, int, int], int] = {}
        self.line_ranges: list[LineRange] = []
        self.row_count = self.notable_count = 0
        self.faults: dict[tuple[int, int], Fault] = {}

    def executed_program(self) -> ExecutedProgram:
        """Execute the program from its first line; return its lines in execution order.

        A program whose O-words have faults is not executed: the result has the faults alone.
        """
        for fault in self.files[0].faults:
            self._add_fault(fault.row, fault.problem, fault.advice)
        try:
            while not self.files[0].faults:
                self._execute_next_line()
        except _EndError:
            pass
        return joined_program(self.files, self.line_ranges, list(self.faults.values()), self.end)

    def _execute_next_line(self) -> None:
        """Copy the plain lines up to the next line with a parameter or an O-word, and execute that line.

        A fault of that line is recorded.

        :raises _EndError: the program ends, or a fault leaves open which line is next.
        """
        file, first = self.files[self.file_index], self.row
        row = file.next_notable_row[first]
        if row > first:
            self._add_rows(first, row)
        if row == len(file.source):  # no such line follows
            if self.calls:
                end = "ENDSUB" if self.calls[-1].is_linuxcnc_style else "M99"
                self._stop(row - 1, f"subprogram O{self.calls[-1].label} does not end with {end}")
            raise _EndError
        self.notable_count += 1
        if self.notable_count > _MOST_NOTABLE_LINES or self.row_count > _MOST_ROWS:
            self._stop(
                row, f"more than {_MOST_NOTABLE_LINES:,} lines with parameters and O-words are executed", _LOOP_ADVICE
            )
        self.row = row + 1
        try:
            line = file.parsed_line(row)
            if isinstance(line, OWord):
                self._execute_o_word(row, line)
            elif isinstance(line, Block):
                self._execute_block(row, line)
            else:
                self._execute_percent(row)
        except BlockError as cause:
            self._add_fault(row, cause.problem, cause.advice)
            if isinstance(file.lines.get(row), OWord) or len(self.faults) > MAX_ERRORS:
                raise _EndError from cause  # where the O-word leads is not known; further faults are not shown

    def _add_rows(self, first: int, last: int, text: str | None = None) -> None:
        """Add rows first … last − 1 of the present file to the executed lines.

        :param text: words of a single row in place of those in the file; None: the words of the file.
        """
        # −1: of a subprogram in the program itself its own lines are shown, not that of the call
        main_row = self.main_row if self.file_index else -1
        self.line_ranges.append(LineRange(self.file_index, first, last, main_row, text))
        self.row_count += last - first

    def _add_fault(self, row: int, problem: str, advice: str | None = None) -> None:
        """Record a fault of a row of the present file, and add an empty line in its place.

        Of each row the first fault counts. The text of the line is recorded too, so that later steps know which words
        are unknown.
        """
        if (self.file_index, row) not in self.faults:
            self.faults[self.file_index, row] = Fault(
                self.row_count, problem, advice, self.files[self.file_index].source.line(row)
            )
        self._add_rows(row, row + 1, "")

    def _stop(self, row: int, problem: str, advice: str | None = None) -> None:
        """Record a fault and end the execution.

        :raises _EndError: always.
        """
        self._add_fault(row, problem, advice)
        raise _EndError

    def _execute_percent(self, row: int) -> None:
        """Execute %: before the first words of a file it opens the file, else it ends the file.

        An opening % has no effect in a subprogram. A closing % in a subprogram leads to the end of its file, where M99
        or ENDSUB is missing.

        :param row: row of the % in the present file.
        :raises _EndError: it ends the program, or coordinates follow it.
        """
        source = self.files[self.file_index].source
        # `COMMENT_MARK` stands for a comment
        has_words_before = bool(source.code[: source.ends[row] + 1].strip(b"\n" + COMMENT_MARK.encode()))
        if has_words_before and self.calls:
            self.row = len(source)
        elif has_words_before and source.has_coordinates_after_percent(row):
            self._stop(row, *EARLY_PERCENT)
        elif not self.calls:
            self._add_rows(row, row + 1)
            if has_words_before:
                raise _EndError

    def _execute_block(self, row: int, line: Block) -> None:
        """Execute a line of words.

        Expressions are replaced by their numbers. M98 calls a subprogram, M99 returns from it. M2 and M30 end the
        program.

        :param row: row of the line in the present file.
        :raises BlockError: a value is not known, or a call is impossible.
        :raises _EndError: the program ends.
        """
        text = line.executed_text(self.parameters)
        end_codes = end_words(text) if "M" in text else {}
        if not end_codes:
            if text:
                self._add_rows(row, row + 1, text)
            return
        if "98" in end_codes or "99" in end_codes:
            words = {match[1]: float(match[2]) for match in _CALL.finditer(text) if match[1]}  # P and L
            text_without_call = _CALL.sub("", text)
            if text_without_call.strip("/"):
                self._add_rows(row, row + 1, text_without_call)
            if "98" in end_codes:
                self._call_by_number(row, words)
            else:
                self._repeat_or_return(words)
            return
        self._add_rows(row, row + 1, text)
        self.end = row if self.file_index == 0 else self.main_row
        raise _EndError

    def _call_by_number(self, row: int, words: dict[str, float]) -> None:
        """Execute M98: call subprogram P, L times; L0 does not call it.

        :param row: line of the call; `words`: its P and L by letter.
        :raises BlockError: P is missing, there is no such subprogram, or calls are nested too deeply.
        """
        if "P" not in words:
            raise BlockError("M98 without P", "Write, for example, M98 P100 L3: subprogram O100, three times.")
        label, times = str(nearest_integer(words["P"])), nearest_integer(words.get("L", 1.0))
        location = self.library.find_subprogram(label, self.file_index, is_linuxcnc_style=False)  # file and row
        if location is None:
            # M98 P30100 calls O100 three times on some Fanuc controls
            advice = "Write M98 P100 L3 for three times." if words["P"] >= 1e4 and "L" not in words else None
            raise BlockError(f"subprogram O{label} is neither in this file nor in its folder", advice)
        if times > 0:
            self._enter_subprogram(location, row, label, is_linuxcnc_style=False, repeats=times - 1)
            self.parameters.enter(None)  # M98 passes no arguments

    def _repeat_or_return(self, words: dict[str, float]) -> None:
        """Execute M99: repeat the subprogram if M98 asks for it, else return from it.

        :param words: P and L of the line by letter.
        :raises BlockError: M99 has P, or is not in a subprogram that M98 called.
        """
        if not self.calls:
            advice = "End a program with M30. If this is a subprogram, convert the program that calls it."
            raise BlockError("M99 in a main program: it would repeat forever", advice)
        if "P" in words:
            raise BlockError("M99 with P", "A return to another line than the call is not supported: write M99 alone.")
        call = self.calls[-1]
        if call.is_linuxcnc_style:
            raise BlockError(f"M99 in O{call.label} SUB", f"End it with O{call.label} ENDSUB.")
        if call.repeats:
            self.calls[-1] = replace(call, repeats=call.repeats - 1)
            self.row = call.begin
            # local names have no value when the subprogram begins again
            self.parameters.leave()
            self.parameters.enter(None)  # M98 passes no arguments
            return
        self._leave_subprogram()

    def _enter_subprogram(
        self, location: tuple[int, int], row: int, label: str, *, is_linuxcnc_style: bool, repeats: int = 0
    ) -> None:
        """Continue in a subprogram.

        :param location: index of its file in `files`, and its first row there.
        :param row: line of the call.
        :param is_linuxcnc_style: whether it is called by ``O<name> CALL``, not by M98.
        :param repeats: how often M98 repeats it after the first time.
        :raises BlockError: calls are nested too deeply.
        """
        if len(self.calls) >= _MOST_CALL_LEVELS - 1:  # the program itself is a level
            advice = "Does a subprogram call itself?"
            raise BlockError(f"subprogram calls are nested more than {_MOST_CALL_LEVELS - 1} levels deep", advice)
        file_index, begin = location
        self.calls.append(
            _ActiveCall(
                label,
                is_linuxcnc_style,
                file_index=self.file_index,
                row=self.row,
                main_row=self.main_row,
                repeats=repeats,
                begin=begin,
            )
        )
        if self.file_index == 0:
            self.main_row = row
        self.file_index, self.row = file_index, begin

    def _leave_subprogram(self) -> None:
        """Return to the caller of a subprogram, and restore its local parameters."""
        call = self.calls.pop()
        self.file_index, self.row, self.main_row = call.file_index, call.row, call.main_row
        self.parameters.leave()

    def _execute_o_word(self, row: int, o_word: OWord) -> None:
        """Execute an O-word of LinuxCNC: set `row` to the line to which a call, a branch or a loop leads.

        :param row: row of the O-word in the present file.
        :raises BlockError: it calls a subprogram that does not exist, or returns outside of one.
        :raises _EndError: its condition may depend on an earlier fault.
        """
        file, keyword = self.files[self.file_index], o_word.keyword
        if self.faults and keyword in ("IF", "ELSEIF", "WHILE", "REPEAT"):
            raise _EndError  # the condition may depend on an earlier fault
        link = file.structure_rows.get(row, (row,))  # rows of the O-words of this structure, first to last
        if keyword == "SUB":
            self.row = link[-1] + 1
        elif keyword in ("ENDSUB", "RETURN"):
            self._return(o_word)
        elif keyword == "CALL":
            self._call(row, o_word)
        elif keyword == "IF":
            self._branch(o_word, link)
        elif keyword in ("ELSEIF", "ELSE", "BREAK"):  # the branch before has been executed: leave the structure
            self.row = link[-1] + 1
        elif keyword == "WHILE" and row == link[0]:  # begin of WHILE … ENDWHILE
            if o_word.values[0](self.parameters) == 0.0:
                self.row = link[-1] + 1
        elif keyword == "WHILE":  # end of DO … WHILE
            if o_word.values[0](self.parameters) != 0.0:
                self.row = link[0] + 1
        elif keyword == "ENDWHILE":
            self.row = link[0]
        elif keyword == "CONTINUE":
            last_line = file.parsed_line(link[-1])
            is_do_loop = isinstance(last_line, OWord) and last_line.keyword == "WHILE"
            self.row = link[-1] if is_do_loop else link[0]  # the row of the condition
        elif keyword in ("REPEAT", "ENDREPEAT"):
            self._repeat(o_word, link)

    def _branch(self, o_word: OWord, link: tuple[int, ...]) -> None:
        """Continue after the first IF, ELSEIF or ELSE whose condition holds; after ENDIF if none does.

        :param link: rows of the O-words of the branch, from IF to ENDIF.
        """
        file = self.files[self.file_index]
        for row in link[:-1]:
            branch = file.parsed_line(row)
            self.row = row + 1
            if not isinstance(branch, OWord) or not branch.values or branch.values[0](self.parameters) != 0.0:
                return
        self.row = link[-1] + 1

    def _repeat(self, o_word: OWord, link: tuple[int, ...]) -> None:
        """Execute REPEAT or ENDREPEAT: count the rounds, and continue in the loop or after its end.

        REPEAT rounds its number half up.

        :param link: rows of REPEAT and ENDREPEAT.
        """
        key = (len(self.calls), self.file_index, link[0])  # a loop runs once more in each call of its subprogram
        if o_word.keyword == "REPEAT":
            self.remaining_rounds[key] = int(np.floor(o_word.values[0](self.parameters) + 0.5))
        else:
            self.remaining_rounds[key] -= 1
        self.row = (link[0] if self.remaining_rounds[key] > 0 else link[-1]) + 1

    def _call(self, row: int, o_word: OWord) -> None:
        """Execute O CALL with its arguments.

        :param row: line of the call.
        :raises BlockError: there is no such subprogram.
        """
        label = o_word.label if isinstance(o_word.label, str) else str(nearest_integer(o_word.label(self.parameters)))
        arguments = [value(self.parameters) for value in o_word.values]
        location = self.library.find_subprogram(label, self.file_index, is_linuxcnc_style=True)
        if location is None:
            raise BlockError(f"subprogram O<{label}> is neither in this file nor in its folder", None)
        self._enter_subprogram(location, row, label, is_linuxcnc_style=True)
        self.parameters.enter(arguments)

    def _return(self, o_word: OWord) -> None:
        """Execute ENDSUB or RETURN, and store the value that it returns in #<_value>, or 0.

        #<_value_returned> is 1 if it returns a value, else 0. The label of RETURN has no meaning.

        :raises BlockError: no subprogram in LinuxCNC style is active, or ENDSUB has the label of another one.
        """
        call = self.calls[-1] if self.calls else None
        if call is None or not call.is_linuxcnc_style or (o_word.keyword == "ENDSUB" and call.label != o_word.label):
            raise BlockError(f"O{o_word.label} {o_word.keyword} outside of O{o_word.label} SUB", None)
        value = o_word.values[0](self.parameters) if o_word.values else 0.0
        self._leave_subprogram()
        self.parameters.put("_value", value)
        self.parameters.put("_value_returned", float(len(o_word.values)))
