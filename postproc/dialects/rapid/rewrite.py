r"""A RAPID module with corrected targets: all other text is unchanged to the byte.

- Numbers of a target are replaced in the instruction, or in the CONST or VAR that it names, if all moves to these data
  get the same target and nothing else names the data. Otherwise the target is written as numbers in the move.
- Inserted targets are lines before the move, with its speed, tool, work object and zone. If the move stops, they have
  zone z0, so that the robot does not stop at them.
- The configuration of a target follows the joints if a correction moves an axis into another quadrant.
- A duration (``\T``) becomes a speed (``\V``) if the path is divided or corrected.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from itertools import accumulate, pairwise
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
from postproc.dialects.rapid.values import NOT_CONNECTED
from postproc.dialects.text import line_spans
from postproc.errors import Issue
from postproc.frames import MM_PER_M, Array
from postproc.program import CIRC, LIN, PTP, Ints, Program, TargetForces, TargetJoints, Targets, WrittenProgram

_MILLIMETRES, _QUATERNION, _MOST_DECIMALS = 4, 8, 9
"""Smallest numbers of decimals of positions and quaternions, as in new modules; largest number that numbers keep."""
_SPEED_DECIMALS = 6
"""Decimals of speeds [mm/s]; trailing zeros are left out (assumed)."""
_QUADRANT_MARGIN = 3.0
"""A stated quadrant may differ by one if the axis is closer than this to the border of the quadrant [deg] (assumed)."""
_NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?")
_LINE_INSTRUCTIONS = {"MOVEC": "MoveL", "MOVECDO": "MoveLDO", "MOVECSYNC": "MoveLSync", "TRIGGC": "TriggL"}
_MOVE_INSTRUCTIONS = {LIN: "MoveL", CIRC: "MoveC", PTP: "MoveJ"}


class Edit(Struct, frozen=True, order=True):
    """The replacement of ``text[start:stop]`` by another text.

    :ivar targets: (target, offset in the new text) for each inserted target whose line is in the new text.
    """

    start: int
    stop: int
    text: str
    targets: tuple[tuple[int, int], ...] = ()


def rewrite(
    program: Program, targets: Targets, joints: TargetJoints, comment_forces: TargetForces | None
) -> WrittenProgram:
    """Return a program read from RAPID with other targets.

    :param joints: joint angles at the targets, which decide on their configurations.
    :param comment_forces: forces that comments must state for the targets; None leaves the comments unchanged.
    :returns: the module, and the 1-based line of each target.
    :raises TypeError: the program was not read from RAPID.
    """
    if not isinstance(program.layout, Layout):
        raise TypeError("the program was not read from RAPID")
    return _Rewriter(program, program.layout, targets, joints, comment_forces).write()


class _SharedData(NamedTuple):
    """Data that moves name as their target, with a correction.

    :ivar target: the target of a move that names the data.
    :ivar edits: edits of the declaration that give the data the corrected target.
    :ivar text: the corrected target as text.
    """

    target: Target
    edits: list[Edit]
    text: str


class _Rewriter:
    """Collects the edits of one program with M moves and K targets.

    :ivar motion_of_target: (K,) move of each target, ascending.
    :ivar is_last: (K,) True for the target at the end of its move; the others are inserted.
    :ivar position: (K, 3) positions of the targets [mm].
    :ivar quaternion: (K, 4) orientations of the targets.
    :ivar degrees: (K, 6) ABB's joint angles at the targets [deg].
    :ivar configuration: (K, 4) cf1, cf4, cf6, cfx at the targets.
    :ivar lowered_moves: moves whose feed was lowered.
    :ivar shared: offset of a literal → data with this literal that moves name.
    :ivar data_arguments: offset of an argument that names data → the argument.
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
        self.motion_of_target = np.asarray(targets.motion, dtype=np.int64)
        self.is_last = np.append(self.motion_of_target[1:] != self.motion_of_target[:-1], True)[
            : len(self.motion_of_target)
        ]
        self.issues: list[Issue] = []
        self.edits: list[Edit] = []
        self.starts, self.stops = line_spans(self.text)
        pose = targets.pose.take(np.arange(len(self.motion_of_target)))
        self.position = pose.position * MM_PER_M
        self.quaternion = quaternions(pose.rotation)
        q = np.asarray(joints.q[np.arange(len(self.motion_of_target))])
        self.degrees = abb_from_joints(q)
        self.configuration = configuration(q, np.asarray(joints.status[np.arange(len(self.motion_of_target))]))
        self.lowered_moves = self._find_lowered_moves()
        self.shared: dict[int, _SharedData] = {}
        self.data_arguments: dict[int, Expression] = {}

    def _find_lowered_moves(self) -> set[int]:
        """Return the moves whose feed was lowered after the program was read."""
        feed_as_read = self.program.feed_as_read
        if feed_as_read is None:  # no feed was changed
            return set()
        return set(np.flatnonzero(self.program.motions.feed < feed_as_read).tolist())

    def write(self) -> WrittenProgram:
        """Make all edits of the module, and return it with the 1-based line of each target."""
        document = self.program.documents[0]
        forces = self._missing_force_comments()
        is_divided = np.bincount(self.motion_of_target, minlength=len(self.moves)) > 1  # it has inserted targets
        is_corrected = ~self.targets.keep & self.is_last
        # first target of each move: motions of targets ascend
        begin = np.searchsorted(self.motion_of_target, np.arange(len(self.moves)))
        # the move before is corrected
        start_differs = np.append(False, np.isin(np.arange(len(self.moves)), self.motion_of_target[is_corrected])[:-1])
        uses: dict[int, list[tuple[int, str]]] = {}  # uses of named targets: filled by `_rewrite_point`
        for k in np.flatnonzero(self.is_last).tolist():
            row = int(self.motion_of_target[k])
            if is_divided[row] or k in forces:
                self._add_lines(row, range(int(begin[row]), k), k, forces)
            # a stated duration is that of the path as it was; its speed holds for any path
            needs_speed = self.moves[row].duration > 0.0 and (
                is_divided[row] or is_corrected[k] or bool(start_differs[row])
            )
            if needs_speed or row in self.lowered_moves:
                self._set_speed(row)
            if is_corrected[k]:
                self._change_end(row, k, uses)
            elif self.moves[row].kind == CIRC and self.targets.kind[k] == LIN:  # its end keeps the numbers of the text
                self._straighten(self.moves[row])
        self._rewrite_shared_data(uses)
        if not self.edits:
            line = self._line_of_moves()
            return WrittenProgram((document,), line, dialect="rapid", issues=tuple(self.issues))
        text, line = self._edited_text()
        return WrittenProgram((replace(document, text=text),), line, dialect="rapid", issues=tuple(self.issues))

    def _line_of_moves(self) -> Ints:
        """Return the line (K,) of each target in a module without edits: the line of its move."""
        return np.asarray(self.program.motions.line[self.motion_of_target], dtype=np.int64)

    # --- lines before a move

    def _missing_force_comments(self) -> dict[int, str]:
        """Return the force comments that the program lacks: target → comment; empty without `comment_forces`."""
        if self.comment_forces is None:
            return {}
        note_motions = np.array([note.before for note in self.program.notes], dtype=np.int64)
        is_trailing = np.array([comment.is_trailing for comment in self.layout.notes], dtype=np.int64)
        # a comment in the line of a move applies to the end of the move, but not to the targets inserted before it:
        # keys are 2 · move for comments and inserted targets before the move, 2 · move + 1 for the line of the move
        target_keys = 2 * self.motion_of_target + self.is_last
        note_keys = 2 * note_motions + is_trailing
        # the last comment that applies to each target; −1: none
        note = np.searchsorted(note_keys, target_keys, side="right") - 1
        needs_comment = force_comments.needs_comment(
            self.comment_forces,
            self.targets.kind,
            note,
            self.program.notes,
            start=0.0,  # no force acts before the first comment
        )
        needs_comment[self._first_path_targets_of_runs(note_keys, target_keys)] = True
        targets = np.flatnonzero(needs_comment)
        return dict(zip(targets.tolist(), force_comments.texts(b"!", self.comment_forces, targets), strict=True))

    def _first_path_targets_of_runs(self, note_keys: Ints, target_keys: Ints) -> list[int]:
        """Return the first straight or circular target of each further run, unless the run has a comment before it.

        Several procedures may be the program, each as a run of its own. The force of the run before does not hold in
        the next one.

        :param note_keys: place of each force comment among the moves: 2 · move before the move, 2 · move + 1 in its
            line; `target_keys`: (K,) the same of the targets.
        """
        if self.program.after is None:  # one run
            return []
        # runs begin at the start of the program: no move is before their first
        begins = np.append(np.flatnonzero(self.program.after[1:] < 0) + 1, len(self.moves))
        targets: list[int] = []
        for begin, end in pairwise(begins.tolist()):
            is_in_run = (self.motion_of_target >= begin) & (self.motion_of_target < end)
            path_targets = np.flatnonzero(is_in_run & (self.targets.kind != PTP))
            if not len(path_targets):
                continue
            has_comment = (note_keys > 2 * begin + 1) & (note_keys <= target_keys[path_targets[0]])
            if not has_comment.any():
                targets.append(int(path_targets[0]))
        return targets

    def _add_lines(self, row: int, inserted_rows: range, k: int, forces: dict[int, str]) -> None:
        """Add the lines of inserted targets and of force comments before a move.

        An error is added to `issues` if targets are inserted into a move that switches an output before its end.

        :param row: the move.
        :param inserted_rows: targets before its end.
        :param k: target at its end.
        :param forces: target → force comment.
        """
        start = self.moves[row].statement.start
        # index of the last line that begins at or before the statement
        line = int(np.searchsorted(self.starts, start, side="right")) - 1
        text_before = self.text[self.starts[line] : start]  # on the line of the statement
        indent = text_before[: len(text_before) - len(text_before.lstrip())]
        end = self._line_end(line)
        pieces: list[str] = []
        targets: list[tuple[int, int]] = []  # target → offset of its line in the new text
        length = 0  # of the new text so far

        def add(text: str) -> None:
            """Add a line behind the lines so far."""
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
        has_triggers = MOVES[self.moves[row].statement.name].count_before_zone > 0
        if inserted_rows and has_triggers:
            message = (
                "Targets must be inserted into this move, which switches at a distance from its end: that would not be "
                "kept right. Use MoveL and SetDO, or raise tolerance_mm so that no targets are needed."
            )
            self.issues.append(Issue("error", "trigger", message, int(self.program.motions.line[row])))
        if text_before.strip():  # another statement is in the line
            pieces[:0] = [f"{end}{indent}"]
            targets = [(target, offset + len(pieces[0])) for target, offset in targets]
        if pieces:
            self.edits.append(Edit(start, start, "".join(pieces), tuple(targets)))

    def _replace_comment(self, row: int, text: str) -> bool:
        """Replace the force comment behind move `row` on its line; return whether it has one."""
        for note, comment in zip(self.program.notes, self.layout.notes, strict=True):
            if comment.is_trailing and note.before == row:
                self.edits.append(Edit(comment.start, comment.stop, text))
                return True
        return False

    def _line_end(self, line: int) -> str:
        """Return the line end of line `line`, from 0; a line feed if the text ends without one."""
        following = int(self.starts[line + 1]) if line + 1 < len(self.starts) else len(self.text)
        return self.text[int(self.stops[line]) : following] or "\n"

    def _inserted_statement(self, row: int, k: int) -> str:
        """Return the statement of inserted target `k`: MoveL, MoveC or MoveJ with the arguments of its move.

        :param row: the move to which the target belongs.
        """
        move = self.moves[row]
        form = MOVES[move.statement.name]
        kind = int(self.targets.kind[k])
        positional_arguments = [argument for argument in move.statement.arguments if not argument.name]
        tail = positional_arguments[form.target_count :]  # behind the targets: speed, triggers, zone, tool
        zone_index = 1 + form.count_before_zone
        speed, zone, tool = (self._text_of(tail[index]) for index in (0, zone_index, zone_index + 1))
        options = {argument.name: self._text_of(argument) for argument in move.statement.arguments if argument.name}
        if (value := self._new_speed(row)) is not None:
            options.pop("T", None)
            options["V"] = f"\\V:={value}"
        # the move stops exactly, but not its inserted targets; if the program declares z0 itself, its zone is not known
        if move.zone == 0.0 and self.targets.blend[k] > 0.0 and "Z0" not in self.layout.declared_names:
            zone = "z0"
            options.pop("INPOS", None)
            options.pop("Z", None)
        points = [self._target_text(move.target.numbers, self.position[k], k)]
        if kind == CIRC:
            points.insert(0, self._target_text(move.target.numbers, self.targets.via[k] * MM_PER_M, k))

        def option(*names: str) -> str:
            """Return the text of the first of these optional arguments that the statement has; empty if it has none."""
            return next((options[name] for name in names if name in options), "")

        concurrent = f"{option('CONC')}," if "CONC" in options else ""
        return (
            f"{_MOVE_INSTRUCTIONS[kind]} {concurrent}{','.join(points)},{speed}{option('V', 'T')},"
            f"{zone}{option('Z')}{option('INPOS')},{tool}{option('WOBJ')}{option('TLOAD')};"
        )

    def _text_of(self, argument: Argument) -> str:
        """Return an argument as it is written in the module."""
        return self.text[argument.start : argument.stop]

    def _new_speed(self, row: int) -> str | None:
        """Return the new speed of a move [mm/s] as text; None if its feed was not lowered and it has no duration.

        The factor of VelSet, which applies to this speed too, is removed.
        """
        move = self.moves[row]
        if row not in self.lowered_moves and not move.duration > 0.0:
            return None
        feed = float(self.program.motions.feed[row]) * MM_PER_M / move.setting.speed_share
        return f"{feed:.{_SPEED_DECIMALS}f}".rstrip("0").rstrip(".")

    def _set_speed(self, row: int) -> None:
        r"""Write a new speed (``\V``) into a move, in place of ``\T`` or ``\V`` if it has one; nothing for MoveJ."""
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
        speed = positional_arguments[MOVES[move.statement.name].target_count]
        self.edits.append(Edit(speed.stop, speed.stop, f"\\V:={value}"))

    # --- the end of a move

    def _change_end(self, row: int, k: int, uses: dict[int, list[tuple[int, str]]]) -> None:
        """Write the corrected end of a move; a circle that becomes a line gets another instruction.

        :param row: the move.
        :param k: target at its end.
        :param uses: uses of named targets, which `_rewrite_point` fills.
        """
        move = self.moves[row]
        is_circle = int(self.targets.kind[k]) == CIRC
        if move.via is not None and not is_circle:
            self._straighten(move)
        if move.via is not None and is_circle:
            self._rewrite_point(move.via, self.targets.via[k] * MM_PER_M, None, k, uses)
        self._rewrite_point(move.target, self.position[k], self.quaternion[k], k, uses)

    def _straighten(self, move: Move) -> None:
        """Replace a circle by a line: another instruction, without the point on the circle; nothing for other moves."""
        statement = move.statement
        if move.via is None:
            return
        self.edits.append(
            Edit(statement.start, statement.start + len(statement.name), _LINE_INSTRUCTIONS[statement.name])
        )
        self.edits.append(Edit(move.via.expression.start, move.target.expression.start, ""))

    def _rewrite_point(
        self,
        target: Target,
        position: Array,
        quaternion: Array | None,
        k: int,
        uses: dict[int, list[tuple[int, str]]],
    ) -> None:
        """Write a corrected point.

        Literal in the move: its numbers are replaced. CONST or VAR: the use is added to `uses`, and `shared` and
        `data_arguments` are filled. PERS and calculated points: the argument is replaced by numbers.

        :param target: the point as read.
        :param position: (3,) its new position [mm].
        :param quaternion: (4,) its new orientation; None for the point on a circle, whose orientation has no effect.
        :param k: the new target.
        :param uses: offset of the literal of named data → (offset of the argument, new target as text) for each use.
        """
        literal, expression = target.literal, target.expression
        if literal is not None and target.data is None:
            self.edits += self._literal_edits(literal, target, position, quaternion, k)
            return
        target_text = self._target_text(target.numbers, position, k, quaternion)
        # PERS keep their values beyond the program: they are not edited
        if literal is None or target.data is None or target.data.kind == "PERS":
            self.edits.append(Edit(expression.start, expression.stop, target_text))
            return
        edits = self._literal_edits(literal, target, position, quaternion, k)
        self.shared.setdefault(literal.start, _SharedData(target, edits=edits, text=target_text))
        uses.setdefault(literal.start, []).append((expression.start, target_text))
        self.data_arguments[expression.start] = expression

    def _rewrite_shared_data(self, uses: dict[int, list[tuple[int, str]]]) -> None:
        """Edit the declarations of named data, or write their targets as numbers into the moves.

        The declaration is edited if all moves that name the data get the same target, and if nothing else names them.

        :param uses: offset of the literal of named data → (offset of the argument, new target as text) for each use.
        """
        if not uses:
            return
        mentions = Counter(re.findall(r"[^\W\d]\w*", self.text.upper()))  # name → number of its occurrences in the text
        arguments: dict[int, set[int]] = {}  # offset of a literal → offsets of the arguments that name its data
        name_counts: Counter[str] = Counter()  # name of data → number of arguments of moves that name them
        counted_arguments: set[int] = set()
        for move in self.moves:
            for target in (move.via, move.target):
                if target is not None and target.data is not None and target.literal is not None:
                    arguments.setdefault(target.literal.start, set()).add(target.expression.start)
                    if target.expression.start not in counted_arguments:
                        counted_arguments.add(target.expression.start)
                        name_counts[target.data.name] += 1
        for start, texts in uses.items():
            shared_data = self.shared[start]
            assert shared_data.target.data is not None  # `_rewrite_point` adds targets with data only
            data_name = shared_data.target.data.name
            has_one_text = len(texts) == len(arguments[start]) and all(text == shared_data.text for _, text in texts)
            has_no_other_use = mentions[data_name] == 1 + name_counts[data_name]  # 1 is the declaration
            if has_one_text and has_no_other_use:
                self.edits += shared_data.edits
            else:
                for argument_start, text in texts:
                    expression = self.data_arguments[argument_start]
                    self.edits.append(Edit(expression.start, expression.stop, text))

    def _literal_edits(
        self, literal: Expression, target: Target, position: Array, quaternion: Array | None, k: int
    ) -> list[Edit]:
        """Return the edits of the numbers in the literal of a target.

        If the numbers cannot be edited one by one, the result is one edit of the whole literal.

        :param target: the target as read.
        :param position: (3,) new position [mm].
        :param quaternion: (4,) new orientation; None: the orientation is unchanged.
        :param k: the new target.
        """
        spans = self._spans(literal)  # of x, y, z, q1…q4, cf1, cf4, cf6, cfx …
        conf = self._configuration(target.numbers, k)
        conf_differs = quaternion is not None and conf != target.numbers[7:11]
        if spans is None or (conf_differs and len(spans) < 11):  # 11: the configuration has spans too
            return [Edit(literal.start, literal.stop, self._target_text(target.numbers, position, k, quaternion))]
        edits: list[Edit] = []
        for column, value in enumerate(position.tolist()):
            edits.append(self._number_edit(spans[column], value, _MILLIMETRES))
        if quaternion is not None:
            # q and −q are one orientation: the sign of the text is kept
            signed_quaternion = quaternion if float(quaternion @ np.array(target.numbers[3:7])) >= 0.0 else -quaternion
            for column, value in enumerate(signed_quaternion.tolist(), 3):
                edits.append(self._number_edit(spans[column], value, _QUATERNION))
            for column, number in enumerate(conf, 7):
                if conf_differs and number != target.numbers[column]:
                    edits.append(Edit(*spans[column], str(number)))
        return edits

    def _spans(self, literal: Expression) -> list[tuple[int, int]] | None:
        """Return the spans of the numbers in the literal of a target, in order.

        17 spans for a literal of numbers. For other literals 11, or 7 if the configuration is no list of numbers. None
        if position or orientation is no list of numbers, or the literal has another form.
        """
        if literal.kind == "numbers":
            return [match.span() for match in _NUMBER.finditer(self.text, literal.start, literal.stop)]
        spans: list[tuple[int, int]] = []
        for component, size in zip(literal.items, (3, 4), strict=False):  # position, orientation
            items = component.items
            if component.kind != "list" or len(items) != size or any(item.kind != "number" for item in items):
                return None
            spans += [(item.start, item.stop) for item in items]
        if len(literal.items) != 4:
            return None
        conf = literal.items[2]
        if conf.kind == "list" and len(conf.items) == 4 and all(item.kind == "number" for item in conf.items):
            return spans + [(item.start, item.stop) for item in conf.items]
        return spans

    def _number_edit(self, span: tuple[int, int], value: float, min_decimals: int) -> Edit:
        """Return the edit of a number; it keeps its number of decimals, from `min_decimals` to `_MOST_DECIMALS`."""
        mantissa = self.text[slice(*span)].upper().partition("E")[0]
        decimals = min(max(len(mantissa.partition(".")[2]), min_decimals), _MOST_DECIMALS)
        return Edit(*span, decimal_text(value, decimals))

    def _target_text(self, numbers: Sequence[float], position: Array, k: int, quaternion: Array | None = None) -> str:
        """Return a robtarget as text of its 17 numbers, with the external axes of the target as read.

        :param numbers: 17 numbers of the target as read.
        :param position: (3,) new position [mm].
        :param k: the new target, which decides on the configuration.
        :param quaternion: (4,) new orientation; None: that of the new target.
        """
        quaternion = self.quaternion[k] if quaternion is None else quaternion
        conf = self._configuration(numbers, k)
        axes = ["9E+09" if abs(value) >= NOT_CONNECTED else f"{value:g}" for value in numbers[11:17]]
        return (
            f"[[{','.join(decimal_text(value, _MILLIMETRES) for value in position.tolist())}],"
            f"[{','.join(decimal_text(value, _QUATERNION) for value in quaternion.tolist())}],"
            f"[{','.join(map(str, conf))}],[{','.join(axes)}]]"
        )

    def _configuration(self, numbers: Sequence[float], k: int) -> list[int]:
        r"""Return cf1, cf4, cf6, cfx to be written for target `k`.

        If the stated configuration agrees with the joints at the end of the move, except for whole turns, cf1, cf4 and
        cf6 follow the joints at `k` with the same turns, and cfx is kept. Otherwise the stated configuration is kept:
        moves with ``ConfL\Off`` ignore it.

        :param numbers: 17 numbers of the target as read.
        """
        programmed_conf = [int(value) for value in numbers[7:11]]
        # last target of the move of target `k`
        end = int(np.searchsorted(self.motion_of_target, self.motion_of_target[k], side="right")) - 1
        quadrant_offsets = [programmed_conf[axis] - int(self.configuration[end, axis]) for axis in range(3)]
        degrees = self.degrees[end, [0, 3, 5]]
        for axis, quadrant_offset in enumerate(quadrant_offsets):
            nearest = quadrant_offset - 4 * round(quadrant_offset / 4)  # without whole turns, of four quadrants
            border_distance = abs(degrees[axis] - 90.0 * round(degrees[axis] / 90.0))
            if nearest and not (abs(nearest) == 1 and border_distance < _QUADRANT_MARGIN):
                return programmed_conf
            quadrant_offsets[axis] = quadrant_offset - nearest
        return [*(int(self.configuration[k, axis]) + quadrant_offsets[axis] for axis in range(3)), programmed_conf[3]]

    def _edited_text(self) -> tuple[str, Ints]:
        """Return the text with all edits, and the 1-based line (K,) of each target.

        The line of an inserted target is in the new text of its edit. The last target of a move is on the line where
        the statement of the move begins.
        """
        edits = sorted(set(self.edits), key=lambda edit: (edit.start, edit.stop))  # they do not overlap
        pieces: list[str] = []
        position = 0
        for edit in edits:
            pieces += [self.text[position : edit.start], edit.text]
            position = edit.stop
        pieces.append(self.text[position:])
        text = "".join(pieces)
        piece_offsets = list(accumulate((len(piece) for piece in pieces), initial=0))
        edit_offsets = piece_offsets[1::2]  # pieces alternate: old text, new text of an edit
        # offsets of the targets in the new text
        offset = np.zeros(len(self.motion_of_target), dtype=np.int64)
        for edit, edit_offset in zip(edits, edit_offsets, strict=False):
            for k, offset_in_edit in edit.targets:
                offset[k] = edit_offset + offset_in_edit
        ends = np.flatnonzero(self.is_last)
        statement_start = np.array(
            [self.moves[row].statement.start for row in self.motion_of_target[ends].tolist()], dtype=np.int64
        )
        edits_before = np.searchsorted([edit.stop for edit in edits], statement_start, side="right")
        # growth of the text by the first edits
        added_lengths = np.cumsum([0, *(len(edit.text) - (edit.stop - edit.start) for edit in edits)])
        offset[ends] = statement_start + added_lengths[edits_before]
        return text, np.searchsorted(line_spans(text)[0], offset, side="right")
