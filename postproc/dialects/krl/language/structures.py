"""Control structures: which lines a FOR, an IF, a SWITCH … holds."""

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

_DEEPEST = 100
"""Beyond any program; deeper structures are beyond Python's limit of recursion."""
LOOPS = frozenset({"FOR", "WHILE", "LOOP", "REPEAT"})
_CLOSING = {closing: opening for opening, closing in OPENING.items()} | {"UNTIL": "REPEAT"}
_DIVIDERS = {"ELSE": "IF", "CASE": "SWITCH", "DEFAULT": "SWITCH"}
_CONTROL = OPENING.keys() | {"REPEAT", "EXIT"} | _CLOSING.keys() | _DIVIDERS.keys()


class Part(Struct, frozen=True, eq=False):
    """The statements that follow IF, ELSE, CASE, DEFAULT or the head of a loop.

    :param head: line of that word.
    :param end: line of the word that ends them: the next ELSE, CASE or DEFAULT, or the closing word.
    :param nodes: its statements.
    """

    head: int
    end: int
    nodes: tuple[Node, ...]


class Block(Struct, frozen=True, eq=False):
    """A control structure.

    :param word: FOR, WHILE, LOOP, REPEAT, IF or SWITCH.
    :param first: its first line.
    :param last: line of the word that closes it.
    :param parts: one for a loop; one or two for IF; for SWITCH the lines before the first CASE, then each CASE.
    """

    word: str
    first: int
    last: int
    parts: tuple[Part, ...]

    def shifted(self, shift: int) -> Block:
        """Return the control structure on other lines: `shift` is added to the number of each."""
        parts = (
            Part(part.head + shift, part.end + shift, tuple(_shifted(node, shift) for node in part.nodes))
            for part in self.parts
        )
        return Block(self.word, self.first + shift, self.last + shift, tuple(parts))

    def lines(self) -> Iterator[int]:
        """Yield the lines of its statements and its own, in order."""
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

    :ivar first: its first line.
    :ivar parts: its finished parts.
    :ivar head: line of the word that began the part that is open; `nodes` its statements so far.
    """

    word: str
    first: int
    parts: list[Part]
    head: int
    nodes: list[Node]

    def divide(self, line: int) -> None:
        """End the part that is open at a line with ELSE, CASE, DEFAULT or the closing word, and begin the next one."""
        self.parts.append(Part(self.head, line, tuple(self.nodes)))
        self.head, self.nodes = line, []


def nodes_of(source: Source | Trace, lines: Sequence[int]) -> tuple[Node, ...]:
    """Return the statements and control structures on some lines of a file, or rows of a trace, in order.

    In a structure that is not closed, each line is a statement. So is a line that closes or divides a structure that is
    not open.

    :raises ProgramError: structures are nested too deeply.
    """
    if len(lines) == 1:
        return (lines[0],)
    nodes: list[Node] = []
    open_structures: list[_OpenStructure] = []  # the innermost last
    for line in lines:
        word = _control_word(source, line)
        innermost = open_structures[-1] if open_structures else None
        if word in OPENING or word == "REPEAT":
            open_structures.append(_OpenStructure(word, line, [], line, []))
            if len(open_structures) > _DEEPEST:
                problem = f"more than {_DEEPEST} control structures are nested"
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
        first = open_structures[0].first
        nodes += [line for line in lines if line >= first]
    return tuple(nodes)


def _control_word(source: Source | Trace, line: int) -> str:
    """Return the first word, upper case, of a line or row; empty for many that belong to no control structure."""
    if isinstance(source, Trace):
        if source.is_count.item(line - 1):
            return ""
        source, line = source.place(line)
    node = source.statements.get(line)
    if isinstance(node, Statement) and node.word not in _CONTROL:
        return ""  # it has been parsed, as nearly all have
    return word_at(source.text, *source.code_span(line))


def is_outside(source: Source | Trace, lines: Sequence[int], line_numbers: Ints) -> Bools:
    """Return which lines of a file, or rows of a trace, are outside of all control structures (n,).

    :param lines: lines that open and close these structures, others among them.
    :param line_numbers: (n,) the lines in question.
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
    return np.asarray(np.searchsorted(begin_lines, line_numbers) == np.searchsorted(end_lines, line_numbers))


def simple_head(source: Source, block: Block) -> For | None:
    """Return the head of a FOR that counts in a whole variable; None for another loop, or if it cannot be read."""
    head = statement(source, block.first)
    if not isinstance(head, For) or head.bounds is None or head.counter is None:
        return None
    return head if head.counter.indices is None and head.counter.field is None else None


def bounds_name(head: For, names: Set[str]) -> bool:
    """Return whether the bounds or the step of a FOR name one of some variables, upper case."""
    values = walk(bound for bound in head.bounds or () if bound is not None)
    return any(isinstance(value, Reference) and value.name in names for value in values)


def checked_nodes(source: Source, nodes: tuple[Node, ...]) -> tuple[Node, ...]:
    """Return statements and control structures unchanged, once their lines have been checked.

    :raises ProgramError: a line of a control structure has a text behind it that would not be read, or lacks something.
    """
    if errors := list(islice(_structure_errors(source, nodes, in_loop=False), MAX_ERRORS + 1)):
        raise combined_error(errors)
    return nodes


def check_closed(source: Source, nodes: tuple[Node, ...]) -> None:
    """Refuse a control structure of a routine that is not closed.

    :raises ProgramError: for the first one.
    """
    for node in nodes:
        if isinstance(node, Block):
            continue
        word = _control_word(source, node)
        if word in OPENING or word == "REPEAT":
            raise source.line_error(f"{word} is not closed", node, "Check that the file is complete.")


def _structure_errors(source: Source, nodes: Sequence[Node], *, in_loop: bool) -> Iterator[ProgramError]:
    """Yield the errors in control structures.

    :param in_loop: whether they are in a loop, which EXIT may leave.
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
    """Return the problem with a line of a control structure, and the advice; None if it has none."""
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
    if any(
        word in MOTION_WORDS and source.text[span.stop : span.stop + 1] in (" ", "\t") for word, span in following_words
    ):
        return f"a motion follows {node.word}", own_line_advice
    return None
