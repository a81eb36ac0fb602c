"""Programs whose moves run more than once, as text in which each move runs once.

A corrected target is valid for one execution of a statement. A statement that moves in several rounds of a loop, or in
several calls of a routine, would need several targets. So such a loop is written out round by round, and a routine gets
a copy for each further call. Loops and routines without moves, or that run once, are unchanged.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np
from msgspec import Struct

from postproc.dialects.rapid.effects import called_names
from postproc.dialects.rapid.execution import ExecutedProgram, Execution, RapidError
from postproc.dialects.rapid.instructions import MOVES
from postproc.dialects.rapid.loaded import LoadedModules
from postproc.dialects.rapid.next_run import ChangedData, changed_data
from postproc.dialects.rapid.procedures import follow
from postproc.dialects.rapid.syntax import (
    Instruction,
    Loop,
    Module,
    Parser,
    Routine,
    Statement,
    all_statements,
    modules,
)
from postproc.dialects.rapid.values import Value
from postproc.dialects.text import line_spans
from postproc.program import Ints

_MOST_CHARACTERS = 60_000_000
"""Largest number of characters of an expanded module: a million motions of 60 characters."""
_MOST_PASSES = 300
"""Largest number of passes of expansion; beyond it, loops and calls are nested too deeply (assumed)."""
_DIVIDE = "Divide the program, or convert the G-code or APT of this part."


class ExpandedProgram(Struct, frozen=True, eq=False):
    """A program in which each statement that moves runs once.

    :ivar text: text of the expanded program.
    :ivar modules: its modules, parsed.
    :ivar executed: result of its execution.
    :ivar line: (L,) 1-based line of the file from which each line of the text comes.
    :ivar loop_lines: lines, in the file, of loops that were written out.
    :ivar copied_names: names of routines that were copied.
    :ivar changed_data: for each procedure whose next run moves differently, the data; offsets are those in the file.
    """

    text: str
    modules: tuple[Module, ...]
    executed: ExecutedProgram
    line: Ints
    loop_lines: tuple[int, ...]
    copied_names: tuple[str, ...]
    changed_data: tuple[ChangedData, ...]


def expand(
    text: str,
    procedures_of: Callable[[Sequence[Module]], list[Routine]],
    cell_value: Callable[[str, str], Value | None],
    without_effect: Sequence[str],
    loaded: LoadedModules,
    start_numbers: Sequence[float],
) -> ExpandedProgram:
    """Return a program, executed, in which each statement that moves runs once.

    :param text: text of the file.
    :param procedures_of: returns the procedures that are the program, of its modules.
    :param cell_value: returns the value of a tool or work object of the cell by its name and type; None if it has none.
    :param without_effect: names of routines of other files that change no data and move nothing.
    :param loaded: modules of other files, whose data are read, but whose routines are not executed.
    :param start_numbers: the start of the program as the 12 numbers of a jointtarget.
    :raises RapidSyntaxError: the text is not RAPID.
    :raises RapidError: the program cannot be followed, or is too long when expanded; with its line in the file.
    """
    line = np.arange(len(line_spans(text)[0])) + 1  # of the file, for each line of `text`
    loop_lines: list[int] = []
    copied_names: list[str] = []
    next_run_data: tuple[ChangedData, ...] = ()
    for pass_number in range(_MOST_PASSES):  # each expands some loops or one routine, and executes the new text
        program_modules = modules(text)
        entries = procedures_of(program_modules)
        if pass_number == 0:
            loaded = loaded.seen_from(program_modules)
        try:
            executions = [Execution(program_modules, entry, cell_value, without_effect, loaded) for entry in entries]
            executed = follow(executions, start_numbers)
            if pass_number == 0 and not executed.errors:
                next_run_data = tuple(data for data in map(changed_data, executions) if data is not None)
            changes = _first_changes(text, program_modules, executed)
        except RapidError as cause:
            raise cause.set_line(_line_at(text, line, cause.start)) from None
        if not changes:
            return ExpandedProgram(
                text,
                program_modules,
                executed,
                line=line,
                loop_lines=tuple(loop_lines),
                copied_names=tuple(copied_names),
                changed_data=next_run_data,
            )
        for change in changes:
            if change.copied_name:
                copied_names.append(change.copied_name)
            elif change.is_loop:
                loop_lines.append(_line_at(text, line, change.start))
        entry_start = entries[0].start
        entry_line = _line_at(text, line, entry_start)
        text, line = _apply_changes(text, line, changes)
        if len(text) > _MOST_CHARACTERS:
            problem = "the loops of the program are too long to be written out"
            raise RapidError(problem, entry_start, _DIVIDE).set_line(entry_line)
    problem = "the loops and calls of the program are nested too deeply"
    raise RapidError(problem, entry_start, _DIVIDE).set_line(entry_line)


def _line_at(text: str, line: Ints, start: int) -> int:
    """Return the line of the file from which the character at offset `start` of a text comes.

    :param line: (L,) line of the file for each line of the text.
    """
    # the last line that begins at or before the offset
    return int(line[np.searchsorted(line_spans(text)[0], start, side="right") - 1])


class _Change(Struct, frozen=True):
    """A change of a text: ``text[start:stop]`` is replaced by pieces of text.

    :ivar pieces: (origin, piece) in order; the origin is the offset in the old text from which the piece is copied, −1
        for a new piece.
    :ivar copied_name: name of the routine, if the change inserts copies of it; otherwise empty.
    :ivar is_loop: True if the change writes a loop out.
    """

    start: int
    stop: int
    pieces: tuple[tuple[int, str], ...]
    copied_name: str = ""
    is_loop: bool = False


def _first_changes(text: str, program_modules: Sequence[Module], execution: ExecutedProgram) -> list[_Change]:
    """Return the changes of the next pass of expansion; empty if no more are needed.

    None are needed if each statement that moves runs once, and may be corrected for all who run it. A routine that
    routines call which are not followed stays as it is for them, and gets a copy for each call that is followed. Loops
    whose statement runs once and that have several rounds are written out next; of nested loops, the outermost. Without
    such loops, one routine that several statements call, each once, gets a copy for each further call.

    :param text: the present text.
    :param execution: result of its execution.
    :raises RapidError: a routine to be copied is called by its name as text, or a statement runs more than once for
        another reason.
    """
    shared_names = _shared_routines(program_modules, execution)
    for name, calls in execution.calls.items():
        if name in shared_names and len({call.start for call in calls}) == len(calls):
            return _copies(text, program_modules, name, calls, kept_count=0)  # all calls get a copy
    move_counts: dict[int, int] = {}  # offset of a statement → number of its moves
    for move in execution.moves:
        move_counts[move.statement.start] = move_counts.get(move.statement.start, 0) + 1
    if max(move_counts.values(), default=0) <= 1:
        return []
    # loops that run once, with the values of their variable in all rounds; loops of a single round need no change
    single_runs = [
        (loop, values)
        for (loop, values), *further_runs in execution.rounds.values()
        if not further_runs and len(values) > 1
    ]
    outermost = [
        (loop, values)
        for loop, values in single_runs
        if not any(outer.start < loop.start and loop.stop <= outer.stop for outer, _ in single_runs)
    ]
    if outermost:
        return [_unroll(text, loop, values) for loop, values in outermost]
    for name, calls in execution.calls.items():
        call_starts = {call.start for call in calls}
        if len(calls) > 1 and len(call_starts) == len(calls):
            return _copies(text, program_modules, name, calls, kept_count=1)  # the first call keeps the routine
    start = next(start for start, count in move_counts.items() if count > 1)
    raise RapidError("a loop or routine with moves runs more than once", start, "Write its moves one by one.")


def _shared_routines(program_modules: Sequence[Module], execution: ExecutedProgram) -> set[str]:
    """Return the names of followed routines with motions that routines call which are not followed.

    They must stay as they are for those callers. Handlers are not followed either. Routines whose only motions are to
    joint angles stay as they are in any case, and are left out.
    """
    routines = [routine for module in program_modules for routine in module.routines]
    called_elsewhere: set[str] = set()
    for routine in routines:
        called_elsewhere |= called_names(routine.handler)
        if routine.name not in execution.followed_names:
            called_elsewhere |= called_names(routine.body)
    return {
        routine.name
        for routine in routines
        if routine.name in called_elsewhere and any(_may_be_changed(item, execution) for item in routine.body)
    }


def _may_be_changed(statement: Statement, execution: ExecutedProgram) -> bool:
    """Return whether a statement, or one inside it, may be written anew: a move to a robtarget, a loop or a call."""
    return any(
        isinstance(item, Loop)
        or (
            isinstance(item, Instruction)
            and (item.name in execution.calls or (item.name in MOVES and not MOVES[item.name].takes_joints))
        )
        for item in all_statements((statement,))
    )


def _copies(
    text: str, program_modules: Sequence[Module], name: str, calls: Sequence[Instruction], *, kept_count: int
) -> list[_Change]:
    """Return the changes that insert a copy of a routine below it for each call but the first, and rename these calls.

    :param name: name of the routine, upper case.
    :param calls: its calls; each is another statement.
    :param kept_count: number of first calls that stay, 0 or 1.
    :raises RapidError: a call has the name of the routine as text.
    """
    routines = {routine.name: routine for module in program_modules for routine in module.routines}
    routine = routines[name]
    name_start, name_stop = routine.name_span
    changes: list[_Change] = []
    pieces: list[tuple[int, str]] = []
    for number, call in enumerate(sorted(calls, key=lambda call: call.start)[kept_count:], 2):
        copy_name = _free_name(text[name_start:name_stop], number, routines)
        word = re.compile(r'%[ \t]*"[^"]*"[ \t]*%|\w+').match(text, call.start)
        if word is None or word[0].startswith("%"):
            problem = f"{name} needs a copy for this call, and is called by its name as text"
            raise RapidError(problem, call.start, f"Call it as {name};")
        changes.append(_Change(word.start(), word.end(), pieces=((-1, copy_name),)))
        # −1: new text
        pieces += [(-1, _line_end(text)), (routine.start, text[routine.start : name_start]), (-1, copy_name)]
        pieces.append((name_stop, text[name_stop : routine.stop]))
    changes.append(_Change(routine.stop, routine.stop, pieces=tuple(pieces), copied_name=name))
    return changes


def _free_name(name: str, number: int, routines: dict[str, Routine]) -> str:
    """Return a new name for a copy of a routine, of at most 32 characters as RAPID allows.

    :param name: name of the routine, which is shortened to make room for the number.
    :param number: number of the copy.
    :param routines: name, upper case → routine: names in use.
    """
    copy = f"{name[:28]}_{number}"  # a number of up to three digits
    while copy.upper() in routines:
        copy = f"{copy[:30]}c"
    return copy


def _line_end(text: str) -> str:
    """Return the first line end of a text; a line feed if it has none."""
    match = re.search(r"\r\n|\n|\r", text)
    return match[0] if match else "\n"


def _unroll(text: str, loop: Loop, values: Sequence[float]) -> _Change:
    """Return the change that writes a loop out: for each round, a comment with the round, and the body.

    :param values: value of the variable of FOR in each round, which replaces its name; for WHILE, one value per round.
    :raises RapidError: a second loop inside FOR has a variable of the same name.
    """
    begin, end = loop.body_span
    body = text[begin:end]
    first_line_end = re.match(r"[ \t]*(?:![^\r\n]*)?(\r\n|\n|\r)", body)  # the end of the line of DO
    offset = first_line_end.end() if first_line_end else 0
    last_blanks = re.search(r"[ \t]*\Z", body[offset:])  # before ENDFOR or ENDWHILE
    body_stop = offset + last_blanks.start() if last_blanks else len(body)
    indent = re.search(r"[ \t]*\Z", text[: loop.start])
    variable_spans = _variable_spans(text, loop) if loop.name else []
    pieces: list[tuple[int, str]] = []  # origin in the text, −1 for new text; and the piece
    end_of_line = _line_end(text)
    ends_line = body[:body_stop].endswith(("\n", "\r"))
    variable = text[loop.start :].split(maxsplit=2)[1]  # as spelled after FOR
    for number, value in enumerate(values, 1):
        label = f"{variable} = {value:g}" if loop.name else f"round {number}"
        prefix = ""
        if number > 1 and indent:
            prefix = ("" if ends_line else end_of_line) + indent[0]
        pieces.append((-1, f"{prefix}! {label}{end_of_line}"))
        position = begin + offset
        for start, stop in variable_spans:
            pieces += [(position, text[position:start]), (-1, f"{value:.9g}" if value >= 0 else f"({value:.9g})")]
            position = stop
        pieces.append((position, text[position : begin + body_stop]))
    if ends_line and indent:
        pieces.append((-1, f"{indent[0]}! end"))
    return _Change(loop.start, loop.stop, pieces=tuple(pieces), is_loop=True)


def _variable_spans(text: str, loop: Loop) -> list[tuple[int, int]]:
    """Return the spans (start, stop) of the variable of FOR in its body, ascending.

    :raises RapidError: a second loop inside has a variable of the same name.
    """
    begin, end = loop.body_span
    spans: list[tuple[int, int]] = []
    parser, previous_word = Parser(text, begin), ""
    while parser.kind != "end" and parser.start < end:
        # components and options of that name are no variable
        if parser.kind == "name" and parser.word == loop.name and previous_word not in (".", "\\"):
            if previous_word == "FOR":
                raise RapidError(f"{loop.name} is the variable of two loops", loop.start, "Give them two names.")
            spans.append((parser.start, parser.stop))
        previous_word = parser.word
        parser.step()
    return spans


def _first_characters(text: str) -> Ints:
    """Return the offset (L,) of the first character of each line that is no blank; of an empty line, its beginning.

    This character decides from which line of the file a line comes: new blanks before copied text do not count.
    """
    offsets = []
    for start, stop in zip(*(bounds.tolist() for bounds in line_spans(text)), strict=True):
        line = text[start:stop]
        offsets.append(start + len(line) - len(line.lstrip()) if line.strip() else start)
    return np.array(offsets, dtype=np.int64)


def _apply_changes(text: str, line: Ints, changes: Sequence[_Change]) -> tuple[str, Ints]:
    """Return the text with changes, and the line of the file (L',) from which each of its lines comes.

    New lines come from the line at which their change begins.

    :param line: (L,) line of the file for each line of the old text.
    :param changes: changes that do not overlap.
    """
    pieces: list[tuple[int, str]] = []  # offset of its origin, or −1 − start of the change for new text; and the text
    position = 0
    for change in sorted(changes, key=lambda change: (change.start, change.stop)):
        pieces.append((position, text[position : change.start]))
        pieces += [(origin if origin >= 0 else -1 - change.start, piece) for origin, piece in change.pieces]
        position = change.stop
    pieces.append((position, text[position:]))
    new_text = "".join(piece for _, piece in pieces)
    piece_begins = np.cumsum([0, *(len(piece) for _, piece in pieces)])[:-1]
    origins = np.array([origin for origin, _ in pieces])
    first_character = _first_characters(new_text)
    piece = np.searchsorted(piece_begins, first_character, side="right") - 1  # the piece that contains it
    offset = first_character - piece_begins[piece]
    old_offset = np.where(origins[piece] >= 0, origins[piece] + offset, -1 - origins[piece])
    # the last old line that begins at or before the origin
    old_row = np.searchsorted(line_spans(text)[0], old_offset, side="right") - 1
    return new_text, line[old_row]
