"""Control structures: the lines of FOR, IF, SWITCH …"""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from itertools import islice

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.names import MOTION_WORDS, OPENING
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import word_at, words_in
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.language.tree import BareWord, For, If, Statement
from postproc.dialects.krl.language.values import Reference, walk
from postproc.errors import MAX_ERRORS, ProgramError, combined_error
from postproc.program import Bools, Ints

_MAX_DEPTH = 100
"""Largest number of nested structures: no program has more, and more would exceed Python's limit of recursion."""
LOOPS = frozenset({"FOR", "WHILE", "LOOP", "REPEAT"})
_CLOSING = {closing: opening for opening, closing in OPENING.items()} | {"UNTIL": "REPEAT"}
_DIVIDERS = {"ELSE": "IF", "CASE": "SWITCH", "DEFAULT": "SWITCH"}
_CONTROL = OPENING.keys() | {"REPEAT", "EXIT"} | _CLOSING.keys() | _DIVIDERS.keys()


class Part(Struct, frozen=True, eq=False):
    """The statements that follow IF, ELSE, CASE, DEFAULT or the head of a loop.

    :param head: line of this word.
    :param end: line of the word that ends the part: the next ELSE, CASE or DEFAULT, or the closing word.
    :param nodes: statements of the part.
    """

    head: int
    end: int
    nodes: tuple[Node, ...]


class Block(Struct, frozen=True, eq=False):
    """A control structure.

    :param word: FOR, WHILE, LOOP, REPEAT, IF or SWITCH.
    :param first: its first line.
    :param last: line of the word that closes it.
    :param parts: loop: one part. IF: one part, two with ELSE. SWITCH: the lines before the first CASE, then one part
        for each CASE and DEFAULT.
    """

    word: str
    first: int
    last: int
    parts: tuple[Part, ...]

    def shifted(self, shift: int) -> Block:
        """Return the control structure with `shift` added to all its lines: from rows of a trace to lines of a file."""
        parts = (
            Part(part.head + shift, part.end + shift, tuple(_shifted(node, shift) for node in part.nodes))
            for part in self.parts
        )
        return Block(self.word, self.first + shift, self.last + shift, tuple(parts))

    def lines(self) -> Iterator[int]:
        """Yield all lines of the structure: heads, statements, nested structures and the closing word, in order."""
        for part in self.parts:
            yield part.head
            for node in part.nodes:
                if isinstance(node, Block):
                    yield from node.lines()
                else:
                    yield node
        yield self.last


Node = int | Block
"""The line of a statement, or a control structure."""


def _shifted(node: Node, shift: int) -> Node:
    """Return a statement, given by its line, or a control structure with `shift` added to its lines."""
    return node.shifted(shift) if isinstance(node, Block) else node + shift


class _OpenStructure(Struct, eq=False):
    """A control structure that is not closed yet.

    :ivar word: FOR, WHILE, LOOP, REPEAT, IF or SWITCH.
    :ivar first: its first line.
    :ivar parts: its finished parts.
    :ivar head: line of the word that began the open part.
    :ivar nodes: statements of the open part so far.
    """

    word: str
    first: int
    parts: list[Part]
    head: int
    nodes: list[Node]

    def divide(self, line: int) -> None:
        """End the open part at a line with ELSE, CASE, DEFAULT or the closing word, and begin the next part."""
        self.parts.append(Part(self.head, line, tuple(self.nodes)))
        self.head, self.nodes = line, []


def nodes_of(source: Source | Trace, lines: Sequence[int]) -> tuple[Node, ...]:
    """Return the statements and control structures on some lines of a file, or rows of a trace, in order.

    A trace: the lines of a program in execution order.

    Each line of a structure that is not closed becomes a plain statement. A closing or dividing word without its
    structure becomes one too.

    :raises ProgramError: structures are nested too deeply.
    """
    if len(lines) == 1:  # no structure is on one line
        return (lines[0],)
    nodes: list[Node] = []
    open_structures: list[_OpenStructure] = []  # the innermost last
    for line in lines:
        word = _control_word(source, line)
        innermost = open_structures[-1] if open_structures else None
        if word in OPENING or word == "REPEAT":
            open_structures.append(_OpenStructure(word, line, [], line, []))
            if len(open_structures) > _MAX_DEPTH:
                problem = f"more than {_MAX_DEPTH} control structures are nested"
                raise source.place(line).error(problem, "Put the inner ones into a subprogram.")
        elif innermost is not None and _CLOSING.get(word) == innermost.word:
            innermost.divide(line)
            open_structures.pop()
            (open_structures[-1].nodes if open_structures else nodes).append(
                Block(innermost.word, innermost.first, line, tuple(innermost.parts))
            )
        elif innermost is not None and _DIVIDERS.get(word) == innermost.word:
            innermost.divide(line)
        else:
            (innermost.nodes if innermost is not None else nodes).append(line)
    if open_structures:
        first = open_structures[0].first  # the outermost structure contains all others that are open
        nodes += [line for line in lines if line >= first]
    return tuple(nodes)


def _control_word(source: Source | Trace, line: int) -> str:
    """Return the word of a control structure with which a line or a row of a trace begins, upper case.

    For speed, the result for other lines is empty or their first word.
    """
    if isinstance(source, Trace):
        if source.is_counter_row.item(line - 1):
            return ""
        source, line = source.place(line)
    node = source.statements.get(line)
    if isinstance(node, Statement) and node.word not in _CONTROL:
        return ""  # it has been parsed, as nearly all lines have
    return word_at(source.text, *source.code_span(line))


def is_outside_structures(source: Source | Trace, lines: Sequence[int], line_numbers: Ints) -> Bools:
    """Return which of n lines of a file, or rows of a trace, are outside of all control structures (n,).

    The first line of a structure counts as outside, its last line as inside.

    :param lines: all lines that open or close structures, ascending; other lines may be among them.
    :param line_numbers: (n,) the lines to decide on.
    """
    begin_lines: list[int] = []
    end_lines: list[int] = []
    depth = 0
    for line in lines:
        word = _control_word(source, line)
        if word in OPENING or word == "REPEAT":
            begin_lines += [] if depth else [line]
            depth += 1
        elif depth and word in _CLOSING:
            depth -= 1
            end_lines += [] if depth else [line]
    # outside: as many outermost structures end before a line as begin before it
    return np.asarray(np.searchsorted(begin_lines, line_numbers) == np.searchsorted(end_lines, line_numbers))


def simple_head(source: Source, block: Block) -> For | None:
    """Return the FOR statement that begins a loop, if its counter is a simple variable.

    None for a counter that is an array element or a component, for another loop, and if FOR cannot be read.
    """
    head = statement(source, block.first)
    if not isinstance(head, For) or head.bounds is None or head.counter is None:
        return None
    return head if head.counter.indices is None and head.counter.field is None else None


def bounds_use_any(head: For, names: Set[str]) -> bool:
    """Return whether the bounds or the step of a FOR use one of the variables `names` (upper case)."""
    values = walk(bound for bound in head.bounds or () if bound is not None)
    return any(isinstance(value, Reference) and value.name in names for value in values)


def checked_nodes(source: Source, nodes: tuple[Node, ...]) -> tuple[Node, ...]:
    """Return statements and control structures unchanged if the lines of the structures have no errors.

    :raises ProgramError: a line of a structure is incomplete, or is followed by text that would not be read; EXIT is
        outside of a loop. All these errors are raised together, up to `MAX_ERRORS`.
    """
    if errors := list(islice(_structure_errors(source, nodes, in_loop=False), MAX_ERRORS + 1)):
        raise combined_error(errors)
    return nodes


def check_closed(source: Source, nodes: tuple[Node, ...]) -> None:
    """Check that all control structures of a routine are closed.

    :param nodes: nodes of the routine; an opening word among them begins a structure that is not closed.
    :raises ProgramError: a structure is not closed; the error is about the first.
    """
    for node in nodes:
        if isinstance(node, Block):
            continue
        word = _control_word(source, node)
        if word in OPENING or word == "REPEAT":
            raise source.line_error(f"{word} is not closed", node, "Check that the file is complete.")


def _structure_errors(source: Source, nodes: Sequence[Node], *, in_loop: bool) -> Iterator[ProgramError]:
    """Yield the errors in the lines of control structures (`_line_fault`), and each EXIT outside of a loop.

    :param in_loop: True if the nodes are inside a loop, so that EXIT is valid.
    """
    for node in nodes:
        if isinstance(node, Block):
            for line in dict.fromkeys((*(part.head for part in node.parts), node.last)):
                fault = _line_fault(source, line)
                if fault is not None:
                    problem, advice = fault
                    yield source.line_error(problem, line, advice)
            for part in node.parts:
                yield from _structure_errors(source, part.nodes, in_loop=in_loop or node.word in LOOPS)
        elif not in_loop and _control_word(source, node) == "EXIT":
            advice = "It leaves LOOP, FOR, WHILE or REPEAT: check where these end."
            yield source.line_error("EXIT outside of a loop", node, advice)


def _line_fault(source: Source, line: int) -> tuple[str, str] | None:
    """Return the problem with a line of a control structure, and the advice; None if the line is correct."""
    node, own_line_advice = statement(source, line), "Write it on a line of its own."
    if isinstance(node, BareWord):
        return (f"{node.extra_text!r} follows {node.word}", own_line_advice) if node.extra_text else None
    if isinstance(node, If):
        if not node.has_then:
            return "IF without THEN", "Write THEN behind the condition, on the same line."
        if node.condition is None:
            return "IF without a condition", "Write it between IF and THEN."
        return (f"{node.extra_text!r} follows THEN", own_line_advice) if node.extra_text else None
    following_words = list(words_in(source.text, node.start + len(node.word), node.stop))
    # without a blank behind it, the word may be the name of a function or an array
    if any(
        word in MOTION_WORDS and source.text[span.stop : span.stop + 1] in (" ", "\t") for word, span in following_words
    ):
        return f"a motion follows {node.word}", own_line_advice
    return None
