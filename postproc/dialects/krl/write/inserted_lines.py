"""Lines added to a `.src` and lines moved within it, and the line on which every motion then stands."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.write.replacements import Replacements
from postproc.program import Ints


class InsertedLines(Struct, eq=False):
    """Collects lines that come in, in order, and lines that go. Line numbers are 1-based and those of the input."""

    source: Source
    replacements: Replacements
    _at: list[int] = []
    _target: list[int] = []
    _removed: list[int] = []

    def add(self, at: int, text: str, target: int = -1) -> None:
        """Put a text with its line end before a line, behind what was put there already.

        :param target: row of the target that stands on it; −1 if there is none.
        """
        offset = int(self.source.starts[at - 1])
        self.replacements.add(offset, offset, text)
        self._at.append(at)
        self._target.append(target)

    def behind(self, line: int, text: str) -> None:
        """Put a text without line end on a line of its own behind a line, before what is put before the next."""
        stop = int(self.source.stops[line - 1])
        self.replacements.add(stop, stop, self.source.text[stop : self.source.starts[line]] + text)
        self._at.append(line + 1)
        self._target.append(-1)

    def move(self, line: int, at: int, text: str) -> None:
        """Take a line away and put a text, in its place, before another."""
        self.replacements.add(int(self.source.starts[line - 1]), int(self.source.starts[line]), "")
        self._removed.append(line)
        self.add(at, text)

    def numbers(self, line: Ints) -> Ints:
        """Return the lines of targets (K,) in the written text: of those added, and of those that stood on a `line`."""
        at, target = np.array(self._at, dtype=np.int64), np.array(self._target, dtype=np.int64)
        order = np.argsort(at, kind="stable")
        at, target = at[order], target[order]
        removed = np.sort(np.array(self._removed, dtype=np.int64))
        out = line + np.searchsorted(at, line, side="right") - np.searchsorted(removed, line)
        own = np.flatnonzero(target >= 0)
        out[target[own]] = at[own] + own - np.searchsorted(removed, at[own])
        return np.asarray(out)
