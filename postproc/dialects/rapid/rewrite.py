r"""A RAPID module with other targets: every other byte is kept.

- Numbers of a target are replaced where they stand: in the instruction, or in the CONST or VAR that it names, if all
  moves that use it go to the same place and nothing else names it. Otherwise the move gets its target as numbers.
- Inserted targets are lines before the move, with its speed, tool and work object. They have its zone; where the move
  stops, z0, so that the robot does not stop on the way.
- The configuration of a target follows the joints where a correction moves an axis beyond a quadrant.
- A duration (``\T``) becomes a speed (``\V``) where the path is divided or moved.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.decimals import decimal_text
from postproc.dialects import force_comments
from postproc.dialects.rapid.instructions import MOVES
from postproc.dialects.rapid.language import abb_from_joints, configuration, quaternions
from postproc.dialects.rapid.layout import Layout
from postproc.dialects.rapid.moves import Move, Target
from postproc.dialects.rapid.syntax import Argument, Expression
from postproc.dialects.rapid.values import NONE
from postproc.dialects.text import line_spans
from postproc.errors import Issue
from postproc.frames import MM_PER_M, Array
from postproc.program import CIRC, LIN, PTP, Ints, Program, TargetForces, TargetJoints, Targets, WrittenProgram

_MILLIMETRES, _QUATERNION, _MOST_DECIMALS = 4, 8, 9
"""Least decimals of positions and quaternions, as of new modules, and the most that numbers of the program keep."""
_SPEED_DECIMALS = 6
"""Of speeds [mm/s]; zeros at the end are left out (assumed)."""
_AT_QUADRANT = 3.0
"""A configuration may differ by one quadrant where the axis is that close to its border [deg] (assumed)."""
_NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?")
_STRAIGHT = {"MOVEC": "MoveL", "MOVECDO": "MoveLDO", "MOVECSYNC": "MoveLSync", "TRIGGC": "TriggL"}
_PLAIN = {LIN: "MoveL", CIRC: "MoveC", PTP: "MoveJ"}


class Edit(Struct, frozen=True, order=True):
    """A piece of the text and what replaces it.

    :ivar targets: (k) targets that the new text has as lines, with their offsets in it.
    """

    start: int
    stop: int
    text: str
    targets: tuple[tuple[int, int], ...] = ()


def rewrite(
    program: Program, targets: Targets, joints: TargetJoints, comment_forces: TargetForces | None
) -> WrittenProgram:
    """Return a program read from RAPID with other targets.

    :param joints: joint angles of the targets, which give their configurations.
    :param comment_forces: forces that comments must give to the targets, or None.
    :raises TypeError: the program was not read from RAPID.
    """
    if not isinstance(program.layout, Layout):
        raise TypeError("the program was not read from RAPID")
    return _Rewriter(program, program.layout, targets, joints, comment_forces).write()


class _SharedData(NamedTuple):
    """Data with numbers that moves name, the edits that give it a corrected target, and that target as text."""

    target: Target
    edits: list[Edit]
    text: str


class _Rewriter:
    """Collects the edits of one program with M moves and K targets.

    :ivar row: (K,) move of each target; `last`: (K,) whether the target is the end of its move.
    :ivar place: (K, 3) positions [mm]; `turn`: (K, 4) quaternions of the targets.
    :ivar degrees: (K, 6) ABB's joint angles [deg]; `conf`: (K, 4) cf1, cf4, cf6, cfx.
    :ivar lowered: moves whose feed was lowered.
    """

    def __init__(
        self,
        program: Program,
        layout: Layout,
        targets: Targets,
        joints: TargetJoints,
        comment_forces: TargetForces | None,
    ) -> None:
        self.program, self.layout, self.targets, self.comment_forces = program, layout, targets, comment_forces
        self.text, self.moves = layout.text, layout.moves
        self.row = np.asarray(targets.motion, dtype=np.int64)
        self.last = np.append(self.row[1:] != self.row[:-1], True)[: len(self.row)]
        self.issues: list[Issue] = []
        self.edits: list[Edit] = []
        self.starts, self.stops = line_spans(self.text)
        pose = targets.pose.take(np.arange(len(self.row)))
        self.place = pose.position * MM_PER_M
        self.turn = quaternions(pose.rotation)
        q = np.asarray(joints.q[np.arange(len(self.row))])
        self.degrees = abb_from_joints(q)
        self.conf = configuration(q, np.asarray(joints.status[np.arange(len(self.row))]))
        self.lowered = self._lowered_moves()
        self.shared: dict[int, _SharedData] = {}
        """Data with numbers that moves name, by the offset of the numbers."""
        self.data_arguments: dict[int, Expression] = {}
        """Arguments that name data, by offset."""

    def _lowered_moves(self) -> set[int]:
        """Return the rows of moves whose feed was lowered."""
        as_read = self.program.feed_as_read
        if as_read is None:
            return set()
        return set(np.flatnonzero(self.program.motions.feed < as_read).tolist())

    def write(self) -> WrittenProgram:
        """Make all edits of the module, and return it with the line of each target."""
        document = self.program.documents[0]
        forces = self._forces()
        is_divided = np.bincount(self.row, minlength=len(self.moves)) > 1
        is_corrected = ~self.targets.keep & self.last
        begin = np.searchsorted(self.row, np.arange(len(self.moves)))
        start_differs = np.append(False, np.isin(np.arange(len(self.moves)), self.row[is_corrected])[:-1])
        uses: dict[int, list[tuple[int, str]]] = {}
        for k in np.flatnonzero(self.last).tolist():
            row = int(self.row[k])
            if is_divided[row] or k in forces:
                self._add_lines(row, range(int(begin[row]), k), k, forces)
            needs_speed = self.moves[row].duration > 0.0 and (
                is_divided[row] or is_corrected[k] or bool(start_differs[row])
            )
            if needs_speed or row in self.lowered:
                self._set_speed(row)
            if is_corrected[k]:
                self._change_end(row, k, uses)
            elif self.moves[row].kind == CIRC and self.targets.kind[k] == LIN:
                self._straighten(self.moves[row])
        self._rewrite_shared_data(uses)
        if not self.edits:
            line = self._line_of_moves()
            return WrittenProgram((document,), line, "rapid", tuple(self.issues))
        text, line = self._edited_text()
        return WrittenProgram((replace(document, text=text),), line, "rapid", tuple(self.issues))

    def _line_of_moves(self) -> Ints:
        """Return the line (K,) of the file of each target, in a module without edits."""
        return np.asarray(self.program.motions.line[self.row], dtype=np.int64)

    # --- lines before a move

    def _forces(self) -> dict[int, str]:
        """Return the force comments that targets need beyond those of the program, by rows of the targets."""
        if self.comment_forces is None:
            return {}
        note_motions = np.array([note.before for note in self.program.notes], dtype=np.int64)
        trailing = np.array([comment.trailing for comment in self.layout.notes], dtype=np.int64)
        # a comment in the line of a move counts for its end only: inserted targets are in lines above it
        target_keys = 2 * self.row + self.last
        note = np.searchsorted(2 * note_motions + trailing, target_keys, side="right") - 1
        rows = np.flatnonzero(
            force_comments.needs_comment(self.comment_forces, self.targets.kind, note, self.program.notes, 0.0)
        )
        return dict(zip(rows.tolist(), force_comments.texts(b"!", self.comment_forces, rows), strict=True))

    def _add_lines(self, row: int, inserted_rows: range, k: int, forces: dict[int, str]) -> None:
        """Add the lines of inserted targets and of force comments before a move.

        :param row: the move; `inserted_rows`: rows of the targets before its end; `k`: row of its end.
        :param forces: row of a target → force comment.
        """
        start = self.moves[row].statement.start
        line = int(np.searchsorted(self.starts, start, side="right")) - 1
        lead = self.text[self.starts[line] : start]
        indent = lead[: len(lead) - len(lead.lstrip())]
        end = self._line_end(line)
        pieces: list[str] = []
        targets: list[tuple[int, int]] = []
        length = 0

        def add(text: str) -> None:
            """Add a line behind the others."""
            nonlocal length
            pieces.append(f"{text}{end}{indent}")
            length += len(pieces[-1])

        for target in inserted_rows:
            if target in forces:
                add(forces[target])
            targets.append((target, length))
            add(self._inserted_statement(row, target))
        if k in forces and not self._replace_comment(row, forces[k]):
            add(forces[k])
        if inserted_rows and MOVES[self.moves[row].statement.name].before_zone:
            message = (
                "Targets must be inserted into this move, which switches at a distance from its end: that would not be "
                "kept right. Use MoveL and SetDO, or raise tolerance_mm so that no targets are needed."
            )
            self.issues.append(Issue("error", "trigger", message, int(self.program.motions.line[row])))
        if lead.strip():  # another statement is in the line
            pieces[:0] = [f"{end}{indent}"]
            targets = [(target, offset + len(pieces[0])) for target, offset in targets]
        if pieces:
            self.edits.append(Edit(start, start, "".join(pieces), tuple(targets)))

    def _replace_comment(self, row: int, text: str) -> bool:
        """Put a force comment in place of the one in the line of a move; return whether there is one."""
        for note, comment in zip(self.program.notes, self.layout.notes, strict=True):
            if comment.trailing and note.before == row:
                self.edits.append(Edit(comment.start, comment.stop, text))
                return True
        return False

    def _line_end(self, line: int) -> str:
        """Return the characters that end a line (index from 0); a line feed if it ends with the text."""
        following = int(self.starts[line + 1]) if line + 1 < len(self.starts) else len(self.text)
        return self.text[int(self.stops[line]) : following] or "\n"

    def _inserted_statement(self, row: int, k: int) -> str:
        """Return the statement of an inserted target.

        :param row: the move before whose end it is inserted; `k`: row of the target.
        """
        move = self.moves[row]
        form = MOVES[move.statement.name]
        kind = int(self.targets.kind[k])
        positional_arguments = [argument for argument in move.statement.arguments if not argument.name]
        tail = positional_arguments[form.points :]  # speed, perhaps a trigger, zone, tool
        speed, zone, tool = (self._text_of(tail[index]) for index in (0, 1 + form.before_zone, 2 + form.before_zone))
        options = {argument.name: self._text_of(argument) for argument in move.statement.arguments if argument.name}
        if (value := self._new_speed(row)) is not None:
            options.pop("T", None)
            options["V"] = f"\\V:={value}"
        if move.zone == 0.0 and self.targets.blend[k] > 0.0 and "Z0" not in self.layout.declared:
            zone = "z0"
            options.pop("INPOS", None)
            options.pop("Z", None)
        points = [self._whole(move.target.numbers, self.place[k], k)]
        if kind == CIRC:
            points.insert(0, self._whole(move.target.numbers, self.targets.via[k] * MM_PER_M, k))

        def option(*names: str) -> str:
            """Return the text of the first of some optional arguments that the statement has; empty if none."""
            return next((options[name] for name in names if name in options), "")

        concurrent = f"{option('CONC')}," if "CONC" in options else ""
        return (
            f"{_PLAIN[kind]} {concurrent}{','.join(points)},{speed}{option('V', 'T')},"
            f"{zone}{option('Z')}{option('INPOS')},{tool}{option('WOBJ')}{option('TLOAD')};"
        )

    def _text_of(self, argument: Argument) -> str:
        """Return an argument as it is written."""
        return self.text[argument.start : argument.stop]

    def _new_speed(self, row: int) -> str | None:
        """Return the new speed [mm/s] of a move as text; None if the speed is unchanged."""
        move = self.moves[row]
        if row not in self.lowered and not move.duration > 0.0:
            return None
        feed = float(self.program.motions.feed[row]) * MM_PER_M / move.setting.speed[0]
        return f"{feed:.{_SPEED_DECIMALS}f}".rstrip("0").rstrip(".")

    def _set_speed(self, row: int) -> None:
        """Give a move a speed in place of its duration or its own speed."""
        value = self._new_speed(row)
        move = self.moves[row]
        if value is None or move.kind == PTP:
            return
        options = {argument.name: argument for argument in move.statement.arguments if argument.name}
        for name in ("T", "V"):
            if name in options:
                self.edits.append(Edit(options[name].start, options[name].stop, f"\\V:={value}"))
                return
        positional_arguments = [argument for argument in move.statement.arguments if not argument.name]
        speed = positional_arguments[MOVES[move.statement.name].points]
        self.edits.append(Edit(speed.stop, speed.stop, f"\\V:={value}"))

    # --- the end of a move

    def _change_end(self, row: int, k: int, uses: dict[int, list[tuple[int, str]]]) -> None:
        """Give a move another end.

        :param row: the move; `k`: row of the target at its end; `uses`: see `_rewrite_point`.
        """
        move = self.moves[row]
        is_circle = int(self.targets.kind[k]) == CIRC
        if move.via is not None and not is_circle:
            self._straighten(move)
        if move.via is not None and is_circle:
            self._rewrite_point(move.via, self.targets.via[k] * MM_PER_M, None, k, uses)
        self._rewrite_point(move.target, self.place[k], self.turn[k], k, uses)

    def _straighten(self, move: Move) -> None:
        """Write a line in place of a circle: another instruction, without the point on the circle."""
        statement = move.statement
        if move.via is None:
            return
        self.edits.append(Edit(statement.start, statement.start + len(statement.name), _STRAIGHT[statement.name]))
        self.edits.append(Edit(move.via.expression.start, move.target.expression.start, ""))

    def _rewrite_point(
        self,
        target: Target,
        place: Array,
        turn: Array | None,
        k: int,
        uses: dict[int, list[tuple[int, str]]],
    ) -> None:
        """Replace the numbers of a target in its literal, or write it as numbers in the move.

        :param place: (3,) its new position [mm].
        :param turn: (4,) its new quaternion; None for the point on a circle, whose orientation is of no effect.
        :param k: row of the new target.
        :param uses: gets, for data with a name, the start of the use and the text that replaces it, by its literal.
        """
        literal, expression = target.literal, target.expression
        if literal is not None and target.data is None:
            self.edits += self._literal_edits(literal, target, place, turn, k)
            return
        whole = self._whole(target.numbers, place, k, turn)
        if literal is None or target.data is None or target.data.kind == "PERS":
            self.edits.append(Edit(expression.start, expression.stop, whole))
            return
        edits = self._literal_edits(literal, target, place, turn, k)
        self.shared.setdefault(literal.start, _SharedData(target, edits, whole))
        uses.setdefault(literal.start, []).append((expression.start, whole))
        self.data_arguments[expression.start] = expression

    def _rewrite_shared_data(self, uses: dict[int, list[tuple[int, str]]]) -> None:
        """Change the numbers of data, or write them into the moves that use them.

        Data is changed if all moves that use it get the same target, and if nothing but them names it.

        :param uses: see `_rewrite_point`.
        """
        if not uses:
            return
        mentions = Counter(re.findall(r"[^\W\d]\w*", self.text.upper()))
        arguments: dict[int, set[int]] = {}
        name_counts: Counter[str] = Counter()
        starts: set[int] = set()
        for move in self.moves:
            for target in (move.via, move.target):
                if target is not None and target.data is not None and target.literal is not None:
                    arguments.setdefault(target.literal.start, set()).add(target.expression.start)
                    if target.expression.start not in starts:
                        starts.add(target.expression.start)
                        name_counts[target.data.name] += 1
        for start, texts in uses.items():
            shared_data = self.shared[start]
            assert shared_data.target.data is not None
            data_name = shared_data.target.data.name
            has_one_text = len(texts) == len(arguments[start]) and all(text == shared_data.text for _, text in texts)
            is_only_named_here = mentions[data_name] == 1 + name_counts[data_name]
            if has_one_text and is_only_named_here:
                self.edits += shared_data.edits
            else:
                for argument_start, text in texts:
                    expression = self.data_arguments[argument_start]
                    self.edits.append(Edit(expression.start, expression.stop, text))

    def _literal_edits(
        self, literal: Expression, target: Target, place: Array, turn: Array | None, k: int
    ) -> list[Edit]:
        """Return the edits of the numbers in the literal of a target; one of all of it if they cannot be edited singly.

        :param target: as read.
        :param place: (3,) new position [mm].
        :param turn: (4,) new quaternion; None: the orientation stays.
        :param k: row of the new target.
        """
        spans = self._spans(literal)
        conf = self._configuration(target.numbers, k)
        moved_axis = turn is not None and conf != target.numbers[7:11]
        if spans is None or (moved_axis and len(spans) < 11):
            return [Edit(literal.start, literal.stop, self._whole(target.numbers, place, k, turn))]
        edits: list[Edit] = []
        for column, value in enumerate(place.tolist()):
            edits.append(self._number_edit(spans[column], value, _MILLIMETRES))
        if turn is not None:
            quaternion = turn if float(turn @ np.array(target.numbers[3:7])) >= 0.0 else -turn
            for column, value in enumerate(quaternion.tolist(), 3):
                edits.append(self._number_edit(spans[column], value, _QUATERNION))
            for column, number in enumerate(conf, 7):
                if moved_axis and number != target.numbers[column]:
                    edits.append(Edit(*spans[column], str(number)))
        return edits

    def _spans(self, literal: Expression) -> list[tuple[int, int]] | None:
        """Return the places of the 17 numbers of a target; None if some are no plain numbers."""
        if literal.kind == "numbers":
            return [match.span() for match in _NUMBER.finditer(self.text, literal.start, literal.stop)]
        spans: list[tuple[int, int]] = []
        for part, size in zip(literal.items, (3, 4), strict=False):
            if part.kind != "list" or len(part.items) != size or any(item.kind != "number" for item in part.items):
                return None
            spans += [(item.start, item.stop) for item in part.items]
        if len(literal.items) != 4:
            return None
        conf = literal.items[2]
        if conf.kind == "list" and len(conf.items) == 4 and all(item.kind == "number" for item in conf.items):
            return spans + [(item.start, item.stop) for item in conf.items]
        return spans

    def _number_edit(self, span: tuple[int, int], value: float, min_decimals: int) -> Edit:
        """Return the edit of a number, with the decimals that it has, but no fewer than `min_decimals`."""
        mantissa = self.text[slice(*span)].upper().partition("E")[0]
        decimals = min(max(len(mantissa.partition(".")[2]), min_decimals), _MOST_DECIMALS)
        return Edit(*span, decimal_text(value, decimals))

    def _whole(self, numbers: Sequence[float], place: Array, k: int, turn: Array | None = None) -> str:
        """Return a robtarget as text of its 17 numbers, with the external axes of the target as read.

        :param numbers: 17 numbers of the target as read.
        :param place: (3,) position [mm]; `turn`: (4,) quaternion, None: that of the new target.
        :param k: row of the new target.
        """
        turn = self.turn[k] if turn is None else turn
        conf = self._configuration(numbers, k)
        axes = ["9E+09" if abs(value) >= NONE else f"{value:g}" for value in numbers[11:17]]
        return (
            f"[[{','.join(decimal_text(value, _MILLIMETRES) for value in place.tolist())}],"
            f"[{','.join(decimal_text(value, _QUATERNION) for value in turn.tolist())}],"
            f"[{','.join(map(str, conf))}],[{','.join(axes)}]]"
        )

    def _configuration(self, numbers: Sequence[float], k: int) -> list[int]:
        r"""Return cf1, cf4, cf6, cfx of a new target.

        If the configuration that the program states agrees with the joints at the end of the move, whole turns aside,
        it follows the joints of the new target. Else it is kept as stated: moves with ``ConfL\Off`` ignore it.
        """
        programmed_conf = [int(value) for value in numbers[7:11]]
        end = int(np.searchsorted(self.row, self.row[k], side="right")) - 1
        quadrant_offsets = [programmed_conf[axis] - int(self.conf[end, axis]) for axis in range(3)]
        degrees = self.degrees[end, [0, 3, 5]]
        for axis, quadrant_offset in enumerate(quadrant_offsets):
            nearest = quadrant_offset - 4 * round(quadrant_offset / 4)
            border = abs(degrees[axis] - 90.0 * round(degrees[axis] / 90.0))
            if nearest and not (abs(nearest) == 1 and border < _AT_QUADRANT):
                return programmed_conf
            quadrant_offsets[axis] = quadrant_offset - nearest
        return [*(int(self.conf[k, axis]) + quadrant_offsets[axis] for axis in range(3)), programmed_conf[3]]

    def _edited_text(self) -> tuple[str, Ints]:
        """Return the text with all edits, and the line of every target (K,)."""
        edits = sorted(set(self.edits), key=lambda edit: (edit.start, edit.stop))
        pieces: list[str] = []
        position = 0
        for edit in edits:
            pieces += [self.text[position : edit.start], edit.text]
            position = edit.stop
        pieces.append(self.text[position:])
        text = "".join(pieces)
        begins = list(accumulate((len(piece) for piece in pieces), initial=0))
        offset = np.zeros(len(self.row), dtype=np.int64)
        for number, edit in enumerate(edits):
            for k, text_offset in edit.targets:
                offset[k] = begins[2 * number + 1] + text_offset
        starts = np.array([edit.start for edit in edits])
        stops = np.array([edit.stop for edit in edits])
        ends = np.flatnonzero(self.last)
        statement_start = np.array([self.moves[row].statement.start for row in self.row[ends].tolist()], dtype=np.int64)
        edit_counts = np.searchsorted(stops, statement_start, side="right")  # edits before the statement
        edit_counts = np.minimum(edit_counts, np.searchsorted(starts, statement_start, side="right"))
        added_lengths = np.cumsum([0, *(len(edit.text) - (edit.stop - edit.start) for edit in edits)])
        offset[ends] = statement_start + added_lengths[edit_counts]
        return text, np.searchsorted(line_spans(text)[0], offset, side="right")
