"""KRL in, KRL out: the same text with other numbers, and inserted targets on lines of their own.

What does not change stays to the byte. Decisions, where KUKA leaves a choice:

- Inserted targets stand directly before the motion's line, or before the TRIGGERs that belong to it; they repeat its
  approximation and its WITH (frames and speed of the motion stand there).
- A relative target that is corrected, or whose predecessor is, becomes an absolute one.
- CA is dropped when a circle is corrected: its end point is then where the arc ends.
- A point used by several motions with different corrections gets a new name beside the old one in the `.dat`; where
  that is not possible (array elements, points assigned in the `.src`, chains of frames) numbers take its place.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from postproc.dialects.krl.geometry import same_orientation
from postproc.dialects.krl.layout import Layout
from postproc.dialects.krl.moves import Move, Operand
from postproc.dialects.krl.points import Points, Use, mentions
from postproc.dialects.krl.source import Source
from postproc.dialects.krl.splice import Edits
from postproc.dialects.krl.statements import Statements, edits, written
from postproc.dialects.krl.wanted import wanted
from postproc.errors import Issue, group_issues
from postproc.program import CIRC, LIN, PTP, Bools, Ints, Program, Targets, Written


def rewrite(program: Program, targets: Targets) -> Written:
    """Return a KRL program with other targets.

    :param program: as `read` returned it.
    :param targets: what is to be commanded; axis targets have no rows.
    :returns: the documents of the program. Reading them gives the targets, rounded to 0.1 µm and 1e-5°, in order.
    :raises ValueError: the program was not read from KRL; a number is too large to be written.
    """
    layout = program.layout
    if not isinstance(layout, Layout):
        raise ValueError("only a program read from KRL can be rewritten")  # noqa: TRY004
    return _Rewriter(program, layout, targets).written()


class _Rewriter:
    """Collects the edits of all documents."""

    def __init__(self, program: Program, layout: Layout, targets: Targets) -> None:
        self.program, self.layout, self.targets = program, layout, targets
        self.sources = [Source.of(document, index) for index, document in enumerate(program.documents)]
        self.source, self.text = self.sources[0], self.sources[0].text
        self.edits = [Edits() for _ in self.sources]
        self.issues: list[Issue] = []
        self.row = targets.motion
        self.last = np.append(self.row[1:] != self.row[:-1], True) if len(self.row) else np.zeros(0, dtype=np.bool_)

    def written(self) -> Written:
        """Make all edits and return the documents."""
        last, keep = self.last, self.targets.keep
        if (last & keep).all():
            return Written(self.program.documents, self.program.motions.line[self.row])
        self.wanted = wanted(self.program.motions, self.layout, self.targets, self.text)
        self.statements = Statements(self.source, self.layout, self.targets, self.wanted)
        special = np.zeros(len(self.program.motions), dtype=np.bool_)
        special[list(self.layout.moves)] = True
        plain = last & ~special[self.row]
        self._replace_numbers(np.flatnonzero(plain & ~keep))
        for k in np.flatnonzero(plain & (self._added() | self._bits())).tolist():
            self._complete(int(self.row[k]), k)
        if self.layout.moves:
            self._special()
        output_line = self._insert()
        self._check_orientation()
        documents = tuple(
            replace(document, text=changes.applied(document.text)) if changes else document
            for document, changes in zip(self.program.documents, self.edits, strict=True)
        )
        return Written(documents, output_line, group_issues(self.issues))

    def _added(self) -> Bools:
        """Return which targets get components that their text lacks, (K,)."""
        return np.asarray((self.wanted.written & self.layout.missing[self.row]).any(axis=1))

    def _bits(self) -> Bools:
        """Return which targets may get another S or T, (K,)."""
        given = (self.targets.status >= 0) | (self.targets.turn >= 0)
        return np.asarray(given & (self.targets.kind == PTP) & ~self.targets.keep)

    def _replace_numbers(self, k: Ints) -> None:
        """Replace the numbers that stand in plain lines, all at once."""
        spans = self.layout.spans[self.row[k], :6].astype(np.int64)
        there = spans[:, :, 0] >= 0
        self.edits[0].add_numbers(
            spans[:, :, 0][there], spans[:, :, 1][there], self.wanted.numbers[k][there], self.wanted.decimals[k][there]
        )

    def _complete(self, row: int, k: int) -> None:
        """Add components to a plain line, and change its S and T; its other numbers are replaced already."""
        literal = self.statements.literal(row)
        if literal is not None:
            texts = self.statements.texts(k, literal)
            rest = {name: text for name, text in texts.items() if name in "ST" or name not in literal.places}
            for piece in edits(literal, rest):
                self.edits[0].add(*piece)

    def _special(self) -> None:
        """Change statements that are not plain lines."""
        moves = self.layout.moves
        named = any(move.end.name or (move.via and move.via.name) for move in moves.values())
        plain = np.delete(self.program.motions.line, list(moves)).tolist()
        points = Points(self.sources, self.layout, self.edits, mentions(self.source, plain) if named else Counter())
        for k in np.flatnonzero(self.last).tolist():
            row = int(self.row[k])
            if row in moves:
                self._statement(row, k, moves[row], points)
        points.settle()
        self.issues += points.issues

    def _statement(self, row: int, k: int, move: Move, points: Points) -> None:
        """Change one statement, or note that it uses named points as they are."""
        split = k > 0 and bool(self.row[k - 1] == row)
        straight = move.kind == CIRC and bool(self.targets.kind[k] == LIN)
        depends = bool(move.relative) or move.angle is not None
        moved = bool(move.relative) and bool(self.wanted.moved[row])
        forced = straight or (split and (depends or move.kind == CIRC)) or moved
        changed = forced or bool(self.wanted.changed[k])
        if changed and (move.relative or straight):
            self.edits[0].add(*self.statements.rewritten(row, k, move))
            if move.relative:
                self._tell("relative-made-absolute", "A relative target is written as an absolute one.", move.line)
            return
        if changed and move.angle is not None:
            self.edits[0].add(move.end.stop, move.tail, "")
            self._tell("angle-dropped", "CA is dropped: the end point is written as where the arc ends.", move.line)
        statements = self.statements
        whole = statements.whole(k, move.end)
        self._point(
            move.line, move.end, statements.end_texts(k, move.end, copy=forced) if changed else None, whole, points
        )
        if move.via is not None:
            via = self.wanted.via_texts(k)
            self._point(move.line, move.via, (via or None) if changed else None, written(via), points)

    def _point(self, line: int, operand: Operand, texts: Mapping[str, str] | None, whole: str, points: Points) -> None:
        """Change the numbers of a point where they stand in the statement; note the use of any other point."""
        literal = self.statements.inline(operand)
        if literal is None:
            points.use(Use(line, operand, texts, whole))
        elif texts:
            for piece in edits(literal, texts):
                self.edits[0].add(*piece)

    def _insert(self) -> Ints:
        """Put inserted targets on lines of their own; return the line of every target, (K,)."""
        motions, layout = self.program.motions, self.layout
        inserted = ~self.last
        number = np.bincount(self.row[inserted], minlength=len(motions))
        earlier = np.cumsum(number) - number
        within = np.arange(len(self.row)) - np.searchsorted(self.row, self.row)
        before = layout.before[self.row] + within
        line = np.where(inserted, before, motions.line[self.row] + number[self.row]) + earlier[self.row]
        for k in np.flatnonzero(inserted).tolist():
            row = int(self.row[k])
            offset = int(self.source.starts[layout.before[row] - 1])
            self.edits[0].add(offset, offset, self.statements.inserted(row, k))
        self._tell_triggers(number)
        return np.asarray(line)

    def _tell_triggers(self, number: Ints) -> None:
        """Tell where inserted targets come between a TRIGGER and what it refers to."""
        motions, layout = self.program.motions, self.layout
        for row in np.flatnonzero((layout.before < motions.line) & (number > 0)).tolist():
            message = "A TRIGGER now refers to the last piece of its motion, which was divided by inserted targets."
            self._tell("trigger", message, int(layout.before[row]))
        for trigger in layout.loose_triggers:
            if number[np.searchsorted(motions.line, trigger)] > 0:
                message = "A TRIGGER now refers to a target inserted before its motion: check where it switches."
                self.issues.append(Issue("warning", "trigger-moved", message, trigger))

    def _check_orientation(self) -> None:
        """Refuse corrections of the orientation that the controller would ignore."""
        rows = np.flatnonzero(self.layout.constant[self.row] & ~self.targets.keep)
        nominal = self.program.motions.target[self.row[rows], :3, :3]
        ignored = rows[~same_orientation(self.targets.pose[rows, :3, :3], nominal)]
        if len(ignored):
            message = "The corrected orientation would be ignored under $ORI_TYPE=#CONSTANT: set $ORI_TYPE=#VAR."
            line = int(self.program.motions.line[self.row[ignored[0]]])
            self.issues.append(Issue("error", "constant-orientation", message, line, count=len(ignored)))

    def _tell(self, kind: str, message: str, line: int) -> None:
        self.issues.append(Issue("info", kind, message, line))
