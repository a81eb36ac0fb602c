"""A KRL program in its own text with corrected numbers; inserted targets are separate lines.

All other text is unchanged to the byte. Decisions, where KUKA leaves a choice:

- Inserted targets are directly before the line of the motion, or around the TRIGGERs that belong to the motion, so that
  each TRIGGER switches at the same place as before. They repeat approximation and WITH of the motion.
- A relative target becomes an absolute one if it or the target before it is corrected.
- A motion under another `$ORI_TYPE` gets ``$ORI_TYPE=#VAR`` if it or the motion before it is corrected, see
  `target_statements`.
- CA is dropped when a circle is corrected: its end point is then where the arc ends.
- A lowered feed is ``$VEL.CP=…`` on a line before the motion; the feed of the program follows behind it.
- A point used by several motions with different corrections gets a new name next to the old one in the `.dat`; where
  that is not possible (array elements, points assigned in the `.src`, chains of frames) numbers take its place.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import groupby
from operator import attrgetter
from pathlib import PurePath

import numpy as np
from msgspec.structs import replace

from postproc.chunks import chunks
from postproc.decimals import number_text
from postproc.dialects.force_comments import needs_comment, round_wrenches, texts
from postproc.dialects.krl.language.motion_statements import MotionStatement, Trigger
from postproc.dialects.krl.language.parser import is_approximated
from postproc.dialects.krl.language.positions import CARTESIAN
from postproc.dialects.krl.language.source import DAT, Source, comment_start
from postproc.dialects.krl.layout import FREE, ORIENTATIONS, Layout
from postproc.dialects.krl.write.edited_rows import edited_rows
from postproc.dialects.krl.write.edits import InsertedLines, Replacements
from postproc.dialects.krl.write.folding import fold
from postproc.dialects.krl.write.named_points import Mentions, NamedPoints, Use, editable_layout, mentions
from postproc.dialects.krl.write.target_numbers import DECIMALS, target_numbers
from postproc.dialects.krl.write.target_statements import (
    ORIENTATION_SETTING,
    Replacement,
    TargetStatements,
    aggregate_text,
    consecutive_motions,
    replaced_numbers,
)
from postproc.dialects.krl.write.trigger_places import PlacedTriggers, place_triggers
from postproc.errors import Issue, ProgramError, group_issues
from postproc.frames import Array
from postproc.program import CIRC, LIN, PTP, Bools, Document, Ints, Program, TargetForces, Targets, WrittenProgram

_STOP_INSERTED = "The robot stops at an inserted target, as it does at the end of this motion, which has no C_DIS: "
_BLENDED_STOP = f"{_STOP_INSERTED}approximation might round the path there by too much."
_UNKNOWN_DISTANCE = f"{_STOP_INSERTED}$APO.CDIS is not known there, by which approximation would round the path."
_LOST_TRIGGER = (
    "Targets must be inserted into the motion that follows this statement, which cannot be kept right. "
    "Put it directly before the motion, with numbers for DISTANCE, PATH and DELAY that switch on one "
    "piece of it, or raise tolerance_mm so that no targets are needed."
)


def rewrite(program: Program, targets: Targets, comment_forces: TargetForces | None = None) -> WrittenProgram:
    """Return a KRL program with other targets.

    :param program: as `read` returned it.
    :param targets: commanded poses; axis targets have no rows.
    :param comment_forces: forces that comments must state for the targets; None leaves the comments unchanged.
    :returns: the documents of the program. Reading them gives the targets, rounded to 0.1 µm and 1e-5°, in order.
    :raises ProgramError: the feed of a motion was lowered, which its text does not allow.
    :raises ValueError: the program was not read from KRL; a number is too large to be written.
    """
    layout = program.layout
    if not isinstance(layout, Layout):
        raise ValueError("only a program read from KRL can be rewritten")  # noqa: TRY004
    _check_lowered_feeds(program, layout)
    return _Rewriter(program, layout, targets, comment_forces).write()


class _Rewriter:
    """Collects the edits of all documents.

    :ivar motion_of_target: (K,) motion of each target, ascending.
    :ivar is_last: (K,) True for the last target of each motion, which is written in the statement of the motion; the
        other targets are inserted lines.
    :ivar documents: files that are written: for a program in several files, the joined text.
    :ivar sources: the `.src` and, if there is one, its `.dat`.
    :ivar replacements: edits of each of `sources`. Those of the `.src`, the first, belong to rows of the trace: a line
        that runs several times may get several texts.
    :ivar trace: the lines of the program in execution order, with loops unrolled and called routines inlined.
    :ivar comment_rows: rows of the trace with force comments.
    """

    def __init__(self, program: Program, layout: Layout, targets: Targets, comment_forces: TargetForces | None) -> None:
        """Find the files of the program, and the last target of each motion; parameters as for `rewrite`."""
        self.program, self.layout, self.targets, self.comment_forces = program, layout, targets, comment_forces
        self.documents = layout.documents or program.documents
        stem = PurePath(self.documents[0].name).stem.upper()
        # the `.dat` has the name of the program; other documents are files of its subprograms
        data = [document for document in self.documents[1:] if PurePath(document.name).stem.upper() == stem]
        self.trace = layout.execution.trace
        self.sources = [layout.execution.main.source, *(Source.of(document, DAT) for document in data)]
        self.comment_rows = set(layout.notes)
        self.replacements = [Replacements() for _ in self.sources]
        self.issues: list[Issue] = []
        self.motion_of_target = targets.motion
        self.is_last = (
            np.append(self.motion_of_target[1:] != self.motion_of_target[:-1], True)
            if len(self.motion_of_target)
            else np.zeros(0, dtype=np.bool_)
        )

    def write(self) -> WrittenProgram:
        """Make all edits, and return the written program; the documents are unchanged if there is nothing to edit.

        :raises ValueError: a number is too large to be written.
        """
        is_unchanged = bool((self.is_last & self.targets.keep).all())  # each motion has one target: that of its text
        if is_unchanged and not len(_lowered_motions(self.program)):
            return WrittenProgram(self.documents, self.program.motions.line[self.motion_of_target], dialect="krl")
        self.target_numbers = target_numbers(self.layout, self.targets)
        self.mentions = self._mentions_of_points()
        self.layout = editable_layout(
            self.layout, self.program.motions, self.mentions, len(self.sources), self._has_one_target()
        )
        self.statements = TargetStatements(self.layout, self.targets, self.target_numbers)
        self._rewrite_plain_lines()
        self._rewrite_tails()
        if self.layout.statements:
            self._rewrite_statements()
        output_line = self._insert_lines()
        documents, output_line = self._edited_files(output_line)
        return WrittenProgram(documents, output_line, dialect="krl", issues=group_issues(self.issues))

    def _mentions_of_points(self) -> Mentions:
        """Return the places at which code names variables: name → (row of the trace, offset in the line).

        The trace has the lines in execution order. Empty if no motion names a point.
        """
        moves = self.layout.statements  # number of a motion → its statement
        has_names = self.layout.elements or any(
            move.end.name or (move.via and move.via.name) for move in moves.values()
        )
        # lines of all motions that are not in `statements` name no points, except array elements: they are skipped
        rows_without_names = np.delete(self.layout.trace_row, list(moves))
        return mentions(self.layout.execution, rows_without_names) if has_names else {}

    def _is_straightened(self) -> Bools:
        """Return whether a target (K,) is a line in place of a circle of the program."""
        is_circle = self.program.motions.kind[self.motion_of_target] == CIRC
        return np.asarray(~self.targets.keep & is_circle & (self.targets.kind == LIN))

    def _rewrite_plain_lines(self) -> None:
        """Edit the motions that are not in `statements` of the layout: plain lines, and motions to array elements.

        A plain line has all its numbers in the text. A circle that is straightened becomes a line.
        """
        is_statement = np.zeros(len(self.program.motions), dtype=np.bool_)
        is_statement[list(self.layout.statements)] = True
        is_plain, is_straightened = self.is_last & ~is_statement[self.motion_of_target], self._is_straightened()
        for target in np.flatnonzero(is_plain & is_straightened).tolist():
            self._replace_text(
                int(self.motion_of_target[target]),
                self.statements.absolute_statement(int(self.motion_of_target[target]), target),
            )
        is_plain &= ~is_straightened
        self._replace_numbers(np.flatnonzero(is_plain & ~self.targets.keep))
        for target in np.flatnonzero(is_plain & (self._needs_components() | self._may_change_bits())).tolist():
            self._add_components(int(self.motion_of_target[target]), target)

    def _rewrite_tails(self) -> None:
        """Edit approximation and WITH of motions where the correction requires other text."""
        changes_tail = self.target_numbers.is_free | self.target_numbers.drops_via_orientation
        # a tail with WITH is longer than the word; WITH may set variables that apply to circles only
        may_set_circle_mode = np.diff(self.layout.tail[self.motion_of_target])[:, 0] > len(" WITH ")
        is_affected = changes_tail[self.motion_of_target] | (self._is_straightened() & may_set_circle_mode)
        for target in np.flatnonzero(self.is_last & is_affected).tolist():
            motion = int(self.motion_of_target[target])
            start, stop = self.layout.tail[motion].tolist()
            tail = self.statements.tail_of_target(motion, target)
            if tail != self.layout.source(motion).text[start:stop]:
                self._replace_text(motion, Replacement(start, stop, tail))

    def _edited_files(self, trace_lines: Ints) -> tuple[tuple[Document, ...], Ints]:
        """Return the files with all edits, and the lines (K,) of the targets in the `.src`.

        Targets in other files have the line of the call. Issues about rows of the trace (lines in execution order) get
        lines of the `.src`.

        :param trace_lines: (K,) lines of the targets in the corrected trace, with all lines that are inserted into it.
        """
        execution, changes = self.layout.execution, self.replacements[0]
        files = {document.name: document for document in self.documents}
        for source, edits in zip(self.sources[1:], self.replacements[1:], strict=True):
            files[source.document.name] = replace(source.document, text=edits.apply(source.text))
        if execution.is_straight:  # rows of the trace are lines of the `.src`
            main = self.documents[0]
            files[main.name] = replace(main, text=changes.apply(self.sources[0].text))
            return tuple(files.values()), trace_lines
        new_rows = edited_rows(self.trace, changes)
        folded_program = fold(execution, execution.main, new_rows)
        files |= {document.name: document for document in folded_program.documents}
        self.issues = [*map(self._with_reported_line, self.issues), *folded_program.issues]
        trace_row = self.layout.trace_row[self.motion_of_target]  # of the motion of each target
        # lines from the first line that is written for this row to the line of the target
        offset_in_row = trace_lines - (new_rows.begins[trace_row - 1] + 1)
        output_line = folded_program.line[trace_row] + np.where(folded_program.is_in_main[trace_row], offset_in_row, 0)
        return tuple(files.values()), output_line

    def _with_reported_line(self, issue: Issue) -> Issue:
        """Return an issue with the line of the `.src` to report for its row of the trace; unchanged without a row."""
        if issue.source_line is None:
            return issue
        return replace(issue, source_line=self.trace.reported_line(issue.source_line))

    def _has_one_target(self) -> Bools:
        """Return whether a motion (M,) has a single target, whose text has all components that it needs."""
        count = np.bincount(self.motion_of_target, minlength=len(self.program.motions))
        has_one_target = np.asarray(count == 1)
        has_one_target[self.motion_of_target[self._needs_components() | self._may_change_bits()]] = False
        return has_one_target

    def _needs_components(self) -> Bools:
        """Return whether a target (K,) must get components (X … C) that the text of its motion lacks.

        Of kept targets, only such components are printed.
        """
        gets_component = self.target_numbers.is_printed & self.layout.is_missing[self.motion_of_target]
        return np.asarray(gets_component.any(axis=1) | (self.targets.keep & self.target_numbers.is_printed.any(axis=1)))

    def _may_change_bits(self) -> Bools:
        """Return whether a target (K,) may get another status or turn: changed PTP targets with status or turn."""
        has_bits = (self.targets.status >= 0) | (self.targets.turn >= 0)
        return np.asarray(has_bits & (self.targets.kind == PTP) & ~self.targets.keep)

    def _replace_text(self, motion: int, piece: Replacement) -> None:
        """Replace a piece of the line of a motion; a line that runs several times is edited for this run alone."""
        self.replacements[0].add(*piece, self.layout.trace_row.item(motion))

    def _replace_numbers(self, changed_targets: Ints) -> None:
        """Replace the numbers of targets in plain lines and of array elements in data lists, in bulk.

        :param changed_targets: (n,) targets whose numbers change, each in the statement of its motion.
        """
        # file that contains the numbers of each motion, as index in `sources`: 0 is the `.src`
        file = np.zeros(len(self.program.motions), dtype=np.int32)
        for elements in self.layout.elements:
            file[elements.row] = elements.source.index
        for chunk in chunks(len(changed_targets)):  # limits the memory of the offsets
            targets = changed_targets[chunk]
            # (n, 6) offsets of X … C; −1 where the text lacks a component
            starts, stops = np.moveaxis(
                self.layout.spans(self.motion_of_target[targets], slice(6)).astype(np.int64), 2, 0
            )
            numbers, decimals = self.target_numbers.numbers[targets], self.target_numbers.decimals[targets]
            trace_rows = np.broadcast_to(self.layout.trace_row[self.motion_of_target[targets], None], starts.shape)
            for index, replacements in enumerate(self.replacements):
                in_file = (starts >= 0) & (file[self.motion_of_target[targets]] == index)[:, None]
                replacements.add_numbers(
                    starts[in_file], stops[in_file], numbers[in_file], decimals[in_file], trace_rows[in_file]
                )
        self._replace_via_points(changed_targets[self.targets.kind[changed_targets] == CIRC])

    def _replace_via_points(self, circles: Ints) -> None:
        """Replace X, Y, Z of the auxiliary points of circles.

        :param circles: (n,) targets that end these circles.
        """
        # (3 n, 2): X, Y, Z of one circle after those of another
        spans = self.layout.via_spans[self.motion_of_target[circles]].astype(np.int64).reshape(-1, 2)
        decimals = np.tile(DECIMALS[:3], len(circles))
        numbers, rows = (
            self.target_numbers.via[circles].reshape(-1),
            np.repeat(self.layout.trace_row[self.motion_of_target[circles]], 3),
        )
        self.replacements[0].add_numbers(spans[:, 0], spans[:, 1], numbers, decimals, rows)

    def _add_components(self, motion: int, target: int) -> None:
        """Add the components that a target needs to the plain line of its motion, and change its status and turn.

        Nothing is done if the line has no literal: its end point is a name, or relative.

        :param motion: the motion.
        :param target: its last target. If it is changed, `_replace_numbers` has replaced the numbers that are in the
            line.
        """
        literal = self.statements.literal(motion)
        if literal is None:
            return
        texts = self.statements.number_texts(target, literal)  # component → number
        if not self.targets.keep[target]:
            written_names = literal.number_spans.keys() & set(CARTESIAN)
            texts = {name: text for name, text in texts.items() if name not in written_names}
        for piece in replaced_numbers(literal, texts):
            self._replace_text(motion, piece)

    def _rewrite_statements(self) -> None:
        """Edit the statements of motions that are not plain lines, and the declarations of their points."""
        moves = self.layout.statements
        points = NamedPoints(self.sources, self.layout, self.replacements, self.mentions)
        for target in np.flatnonzero(self.is_last).tolist():
            motion = int(self.motion_of_target[target])
            if motion in moves:
                self._rewrite_statement(motion, target, moves[motion], points)
        points.make_edits()
        self.issues += points.issues

    def _rewrite_statement(self, motion: int, target: int, move: MotionStatement, points: NamedPoints) -> None:
        """Edit the statement of a motion; add its uses of named points to `points`.

        Uses that stay as they are count too: they decide whether the declaration of a point may change.

        :param motion: the motion.
        :param target: its last target.
        :param move: its statement.
        :param points: collects the uses of named points.
        """
        becomes_line = move.kind == CIRC and bool(self.targets.kind[target] == LIN)
        needs_all_numbers = becomes_line or self._has_other_path(motion, target, move)
        differs = needs_all_numbers or bool(self.target_numbers.is_changed[target])
        if differs and (move.relative_axes or becomes_line):
            self._make_absolute(motion, target, move)
            return
        if differs and move.angle is not None:
            self._replace_text(motion, Replacement(move.end.stop, move.tail_start, ""))
            message = "CA is dropped: the end point is written as where the arc ends."
            self._report("angle-dropped", message, move.trace_row)
        texts = self.statements.end_texts(target, move.end, includes_unchanged=needs_all_numbers) if differs else None
        end_use = Use(
            trace_row=move.trace_row,
            operand=move.end,
            texts=texts,
            complete_literal=partial(self.statements.whole_literal, target, move.end),
        )
        self._rewrite_point(end_use, points)
        if move.via is not None:
            # empty if the target has no auxiliary point: that of the statement stays
            via_texts = self.target_numbers.via_texts(target)
            via_use = Use(
                trace_row=move.trace_row,
                operand=move.via,
                texts=(via_texts or None) if differs else None,
                complete_literal=partial(aggregate_text, via_texts),
            )
            self._rewrite_point(via_use, points)

    def _has_other_path(self, motion: int, target: int, move: MotionStatement) -> bool:
        """Return whether the unchanged statement would be another path, since its motion begins at another point.

        So it is with relative targets, circles with CA, and auxiliary points that are stated in part: they count from
        the start. The arc of any circle changes if inserted targets divide it.

        :param motion: the motion.
        :param target: its last target.
        """
        is_divided = target > 0 and bool(self.motion_of_target[target - 1] == motion)  # it begins at an inserted target
        depends_on_start = bool(move.relative_axes) or move.angle is not None or move.kind == CIRC
        counts_from_start = bool(move.relative_axes) or move.is_via_incomplete
        return (is_divided and depends_on_start) or (
            counts_from_start and bool(self.target_numbers.start_differs[motion])
        )

    def _make_absolute(self, motion: int, target: int, move: MotionStatement) -> None:
        """Replace instruction and points of the statement of a motion by absolute literals of its last target.

        Add an issue if the statement was a relative motion.
        """
        self._replace_text(motion, self.statements.absolute_statement(motion, target))
        if move.relative_axes:
            if move.frame_span is not None:
                self._replace_text(motion, Replacement(*move.frame_span, ""))
            self._report("relative-made-absolute", "A relative target is written as an absolute one.", move.trace_row)

    def _rewrite_point(self, use: Use, points: NamedPoints) -> None:
        """Edit the numbers of a point in its statement if they are there; otherwise add its use to `points`.

        :param use: the point in its statement.
        :param points: collects the uses of named points.
        """
        literal = self.statements.inline_literal(use.operand)
        if literal is None:
            points.add_use(use)
        elif use.texts:
            for piece in replaced_numbers(literal, use.texts):
                self.replacements[0].add(*piece, use.trace_row)

    def _insert_lines(self) -> Ints:
        """Insert lines for targets, force comments and settings; return the new line (K,) of each target.

        Lines are inserted into the trace: the lines of the program in execution order.
        """
        rows = self.layout.trace_row[self.motion_of_target]  # of the motions of the targets
        lines = InsertedLines(self.trace, self.replacements[0])
        following_row, moved_triggers = self._place_triggers()
        forces = self._missing_force_comments(rows, following_row)
        free_targets, reset_targets = self._free_orientation_spans()
        lowering_feeds, restoring_feeds = self._feed_statements()
        affected_targets = [*moved_triggers, *forces, *free_targets, *reset_targets, *lowering_feeds, *restoring_feeds]
        for target in np.flatnonzero(~self.is_last | np.isin(np.arange(len(rows)), affected_targets)).tolist():
            motion, motion_row = int(self.motion_of_target[target]), int(rows[target])
            next_row = following_row.get(target, motion_row)  # before which its lines are inserted
            indent, line_end = self._indent(target), self.statements.line_end(motion)
            if target in lowering_feeds:
                lines.add(next_row, indent + lowering_feeds[target] + line_end)
            if target in free_targets:
                lines.add(next_row, indent + ORIENTATION_SETTING + FREE + line_end)
            for trigger, text in moved_triggers.get(target, ()):
                lines.move_line(trigger.trace_row, next_row, text)
            if target in forces and not self._replace_comment(target, forces[target]):
                lines.add(next_row, forces[target] + line_end)
            if not self.is_last[target]:  # the last target is in the statement of the motion itself
                self._insert_target(target, next_row, lines)
            if target in reset_targets:
                lines.insert_behind(
                    motion_row, indent + ORIENTATION_SETTING + ORIENTATIONS[self.layout.orientation[motion]]
                )
            if target in restoring_feeds:
                lines.insert_behind(motion_row, indent + restoring_feeds[target])
        return lines.output_lines(rows)

    def _insert_target(self, target: int, next_row: int, lines: InsertedLines) -> None:
        """Insert a target as a motion; add an issue if the robot stops at it.

        :param next_row: row of the trace (line in execution order) before which the new line is inserted.
        :param lines: collects the new line.
        """
        motion = int(self.motion_of_target[target])
        text = self.statements.inserted_line(motion, target)
        lines.add(next_row, text, target)
        # in a spline block the robot passes all targets without stopping
        if not self.layout.is_in_spline_block[motion] and not is_approximated(text):
            reason = _BLENDED_STOP if self.layout.is_distance_known[motion] else _UNKNOWN_DISTANCE
            self._report("stop-inserted", reason, self.layout.trace_row.item(motion))

    def _free_orientation_spans(self) -> tuple[set[int], set[int]]:
        """Return the targets before which `$ORI_TYPE` is set to #VAR, and the targets behind which it is reset.

        A motion needs #VAR if it turns the tool to an orientation that its own `$ORI_TYPE` would not reach. Consecutive
        motions share the two lines. Spline motions have the setting in WITH and are left out.
        """
        rows = np.flatnonzero(self.target_numbers.is_free)
        is_ordinary = [not self.statements.is_spline(motion) for motion in rows.tolist()]
        pairs = consecutive_motions(self.layout, rows[is_ordinary])
        # first and last motions; reshape: there may be no pairs
        first, last = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        # motions of targets ascend: first target of the first motion, and last target of the last motion, of each run
        first_targets = np.searchsorted(self.motion_of_target, first)
        last_targets = np.searchsorted(self.motion_of_target, last, side="right") - 1
        return set(first_targets.tolist()), set(last_targets.tolist())

    def _feed_statements(self) -> tuple[dict[int, str], dict[int, str]]:
        """Return the statements that set lowered feeds, and the statements that restore the feeds.

        Both are empty if no feed was lowered.

        :returns: target → statement before it; target → statement behind it.
        """
        feed, feed_as_read = self.program.motions.feed, self.program.feed_as_read
        rows = _lowered_motions(self.program)
        if feed_as_read is None or not len(rows):
            return {}, {}
        # between two lowered motions on consecutive lines the feed of the program is not restored
        is_continued = (np.diff(rows) == 1) & (np.diff(self.layout.trace_row[rows]) == 1)
        has_same_feed = np.append(False, is_continued & (np.diff(feed[rows]) == 0.0))
        lowering_rows, restoring_rows = rows[~has_same_feed], rows[np.append(~is_continued, True)]
        # motions of targets ascend: first target of each motion, and last target
        first_targets = np.searchsorted(self.motion_of_target, lowering_rows)
        last_targets = np.searchsorted(self.motion_of_target, restoring_rows, side="right") - 1
        return (
            _feed_texts(first_targets, feed[lowering_rows]),
            _feed_texts(last_targets, feed_as_read[restoring_rows]),
        )

    def _indent(self, target: int) -> str:
        """Return the text before the instruction on the line of the motion of a target."""
        return self.statements.indent(int(self.motion_of_target[target]))

    def _missing_force_comments(self, rows: Ints, following_row: Mapping[int, int]) -> dict[int, str]:
        """Return the force comments that the program lacks: target → comment; empty without `comment_forces`.

        :param rows: (K,) rows of the trace (the lines in execution order) with the motions of the targets.
        :param following_row: target → row before which it is inserted, if that is not the row of its motion.
        """
        if self.comment_forces is None:
            return {}
        # comments before `limit_row` apply to the target: a comment on the line of a motion applies to its last
        # target, but not to the targets inserted before it
        limit_row = rows + self.is_last
        limit_row[list(following_row)] = list(following_row.values())
        note = np.searchsorted(self.layout.notes, limit_row) - 1  # the last comment that applies; −1: none
        # start=0.0: no force acts before the first comment
        needs_comments = needs_comment(self.comment_forces, self.targets.kind, note, self.program.notes, start=0.0)
        needs_comments[[*self._targets_behind_releases(note), *self._targets_of_next_round(rows, note)]] = True
        targets = np.flatnonzero(needs_comments)
        return dict(zip(targets.tolist(), texts(b";", self.comment_forces, targets), strict=True))

    def _targets_behind_releases(self, note: Ints) -> list[int]:
        """Return the targets where branches begin or meet that need a comment since the force before was released.

        Where branches begin or meet, the reader adds a note with the force that acts on, which the text need not state.
        But before a wait the written program states force 0. The force must then be stated again behind the wait.

        :param note: (K,) index in `notes` of the last note that applies to each target; −1: none.
        """
        motion, notes, predecessors = self.motion_of_target, self.program.notes, self.program.after
        if predecessors is None or self.comment_forces is None:  # no branches, or no comments to be written
            return []
        last_target = np.full(len(self.program.motions) + 1, -1)  # of each motion; −1 for motions without targets
        last_target[motion[self.is_last]] = np.flatnonzero(self.is_last)
        is_restated = np.array([*(comment.is_restated for comment in notes), False])  # index −1, no note, is the last
        # the first targets of motions to which a note of the reader applies, and not to the target before
        has_new_note, has_new_motion = np.diff(note, prepend=-1) != 0, np.diff(motion, prepend=-1) != 0
        targets = []
        for target in np.flatnonzero(has_new_note & has_new_motion & is_restated[note]).tolist():
            previous = predecessors.item(motion[target])
            while previous >= 0 and self.program.motions.kind[previous] == PTP:  # carries no force, and ends none
                # a motion whose start is not known is its own predecessor
                previous = predecessors.item(previous) if predecessors.item(previous) < previous else -1
            end = int(last_target[previous])  # −1 for `previous` −1 too: the last element
            has_force = end >= 0 and note[end] >= 0 and any(notes[note[end]].wrench)
            if has_force and not self.comment_forces.wrench[end : end + 1].any():
                targets.append(target)
        return targets

    def _targets_of_next_round(self, rows: Ints, note: Ints) -> list[int]:
        """Return the first target under force of a LOOP without EXIT, if another force may be stated as its round ends.

        It needs a comment: its next round would begin under that force.

        :param rows: (K,) rows of the trace (the lines in execution order) with the motions of the targets.
        :param note: (K,) index in `notes` of the last note that applies to each target; −1: none.
        """
        loop, forces = self.layout.execution.endless_loop, self.comment_forces
        if loop is None or forces is None:
            return []
        targets = np.flatnonzero((rows >= loop.first) & (rows < loop.stop) & (self.targets.kind != PTP))
        is_stated = len(targets) > 0 and note[targets[0]] >= 0 and self.layout.notes[note[targets[0]]] >= loop.first
        if not len(targets) or is_stated:
            return []
        wrench, frame = round_wrenches(forces.wrench[targets]), forces.frame[targets]
        is_constant = (wrench == wrench[0]).all() and (frame == frame[0]).all()
        return [] if is_constant else targets[:1].tolist()

    def _replace_comment(self, target: int, text: str) -> bool:
        """Replace the force comment on the line of a target; return whether this was possible.

        False if the line has no force comment, or if the target is an inserted line.

        :param text: the new comment.
        """
        row = int(self.layout.trace_row[self.motion_of_target[target]])  # of the trace: a line in execution order
        if not self.is_last[target] or row not in self.comment_rows:
            return False
        source, line = self.trace.place(row)
        start, stop = source.starts.item(line - 1), source.stops.item(line - 1)
        self._replace_text(
            int(self.motion_of_target[target]), Replacement(comment_start(source.text, start, stop), stop, text)
        )
        return True

    def _place_triggers(self) -> tuple[dict[int, int], dict[int, list[tuple[Trigger, str]]]]:
        """Place TRIGGERs among the targets inserted into their motions; change PATH of those that stay on their line.

        A TRIGGER that would switch at another place becomes an error in `issues`.

        :returns: inserted target → row of the trace (line in execution order) before which it is written; target →
            TRIGGERs that are moved before it, with their text.
        """
        following_row: dict[int, int] = {}
        moved_lines: dict[int, list[tuple[Trigger, str]]] = {}
        for motion, triggers in groupby(self.layout.triggers, attrgetter("motion")):
            first, stop = np.searchsorted(self.motion_of_target, [motion, motion + 1]).tolist()  # targets of the motion
            if stop - first < 2:
                continue  # no target is inserted into it
            speed = float(self.program.motions.feed[motion])
            placed_triggers = place_triggers(
                tuple(triggers), self.layout.trace_row.item(motion), self.targets.t[first:stop], speed
            )
            following_row |= dict(zip(range(first, stop - 1), placed_triggers.target_rows, strict=True))
            for target, moved_triggers in enumerate(placed_triggers.moved_triggers, first):
                if moved_triggers:
                    moved_lines[target] = [
                        (trigger, self._trigger_line(trigger, placed_triggers.path_texts.get(trigger)))
                        for trigger in moved_triggers
                    ]
            self._change_paths(placed_triggers)
            self.issues += [
                Issue("error", "trigger", _LOST_TRIGGER, trigger.trace_row) for trigger in placed_triggers.lost_triggers
            ]
        return following_row, moved_lines

    def _change_paths(self, placed_triggers: PlacedTriggers) -> None:
        """Change PATH of the TRIGGERs that stay on their lines."""
        moved_triggers = {trigger for triggers in placed_triggers.moved_triggers for trigger in triggers}
        for trigger, path in placed_triggers.path_texts.items():
            if trigger not in moved_triggers and trigger.path_span is not None:
                self.replacements[0].add(*trigger.path_span, path, trigger.trace_row)

    def _trigger_line(self, trigger: Trigger, path: str | None) -> str:
        """Return the text of the line of a TRIGGER, with its line end.

        :param path: new number of PATH; None leaves it unchanged.
        """
        source, line = self.trace.place(trigger.trace_row)
        # `starts` counts from 0: starts[line] is the beginning of the next line, at least that of END
        text, start, stop = source.text, source.starts[line - 1], source.starts[line]
        if path is None or trigger.path_span is None:
            return text[start:stop]
        return text[start : trigger.path_span[0]] + path + text[trigger.path_span[1] : stop]

    def _report(self, kind: str, message: str, trace_row: int) -> None:
        """Add information about a row of the trace to `issues`; `_edited_files` replaces the row by a line."""
        self.issues.append(Issue("info", kind, message, trace_row))


def _feed_texts(targets: Ints, feeds: Array) -> dict[int, str]:
    """Return the statements that set feeds (n,) [m/s]: target (n,) → statement."""
    return {
        target: f"$VEL.CP={number_text(feed)}" for target, feed in zip(targets.tolist(), feeds.tolist(), strict=True)
    }


def _lowered_motions(program: Program) -> Ints:
    """Return the motions (n,) whose feed was lowered after the program was read, ascending."""
    feed_as_read = program.feed_as_read
    if feed_as_read is None:  # no feed was changed
        return np.zeros(0, dtype=np.int64)
    return np.flatnonzero(program.motions.feed < feed_as_read)


def _check_lowered_feeds(program: Program, layout: Layout) -> None:
    """Check that a line before the motion can set each lowered feed.

    :raises ProgramError: the program has loops, branches or calls; a motion with a lowered feed is in a spline block,
        or sets its speed by WITH.
    """
    rows = _lowered_motions(program)
    if not len(rows):
        return
    spans = zip(rows.tolist(), layout.tail[rows].tolist(), strict=True)
    tails = [layout.source(motion).text[start:stop].upper() for motion, (start, stop) in spans]
    for is_refused, problem in (
        (
            np.full(len(rows), not layout.execution.is_straight),
            "this program has loops, branches or calls: its lines run more than once or not always",
        ),
        (layout.is_in_spline_block[rows], "the motion is in a spline block"),
        (np.array(["$VEL" in tail for tail in tails]), "the motion sets its speed itself (WITH)"),
    ):
        if is_refused.any():
            raise ProgramError(
                f"the feed cannot be lowered here: {problem}",
                file=program.documents[0].name,
                line=int(program.motions.line[rows[np.argmax(is_refused)]]),
                advice='Convert the G-code of this program instead, or write [output] feed = "program".',
            )
