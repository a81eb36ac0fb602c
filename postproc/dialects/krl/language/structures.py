"""Control structures: which lines a FOR, an IF, a SWITCH … holds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.names import OPENING
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.statements import word_at
from postproc.program import Bools, Ints

LOOPS = frozenset({"FOR", "WHILE", "LOOP", "REPEAT"})
_CLOSING = {closing: opening for opening, closing in OPENING.items()} | {"UNTIL": "REPEAT"}
_DIVIDING = {"ELSE": "IF", "CASE": "SWITCH", "DEFAULT": "SWITCH"}


class Part(Struct, frozen=True, eq=False):
    """What stands behind IF, ELSE, CASE, DEFAULT or the head of a loop.

    :param head: line of that word.
    :param beyond: line of the word behind it.
    :param nodes: its statements.
    """

    head: int
    beyond: int
    nodes: tuple[Node, ...]


class Block(Struct, frozen=True, eq=False):
    """A control structure.

    :param word: FOR, WHILE, LOOP, REPEAT, IF or SWITCH.
    :param first: its first line; `last` that of the word that closes it.
    :param parts: one for a loop; one or two for IF; for SWITCH what stands before the first CASE, then each CASE.
    """

    word: str
    first: int
    last: int
    parts: tuple[Part, ...]

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


class _Open(Struct, eq=False):
    word: str
    first: int
    parts: list[Part]
    head: int
    nodes: list[Node]

    def divide(self, line: int) -> None:
        self.parts.append(Part(self.head, line, tuple(self.nodes)))
        self.head, self.nodes = line, []


def nodes_of(source: Source, lines: Sequence[int]) -> tuple[Node, ...]:
    """Return statements and control structures of some lines, in order.

    Lines whose word closes or divides what is not open stand for themselves, and so do those of what is not closed.
    """
    out: list[Node] = []
    open_: list[_Open] = []
    for line in lines:
        start, stop = source.code_span(line)
        word = word_at(source.text, start, stop)
        here = open_[-1] if open_ else None
        if word in OPENING or word == "REPEAT":
            open_.append(_Open(word, line, [], line, []))
        elif here is not None and _CLOSING.get(word) == here.word:
            here.divide(line)
            open_.pop()
            (open_[-1].nodes if open_ else out).append(Block(here.word, here.first, line, tuple(here.parts)))
        elif here is not None and _DIVIDING.get(word) == here.word:
            here.divide(line)
        else:
            (here.nodes if here is not None else out).append(line)
    if open_:
        first = open_[0].first
        out += [line for line in lines if line >= first]
    return tuple(out)


def outside(source: Source, lines: Sequence[int], others: Ints) -> Bools:
    """Return which of other lines (n,) stand outside of the control structures that some lines open and close."""
    opened: list[int] = []
    closed: list[int] = []
    depth = 0
    for line in lines:
        word = word_at(source.text, *source.code_span(line))
        if word in OPENING or word == "REPEAT":
            opened += [] if depth else [line]
            depth += 1
        elif depth and word in _CLOSING:
            depth -= 1
            closed += [] if depth else [line]
    return np.asarray(np.searchsorted(opened, others) == np.searchsorted(closed, others))
