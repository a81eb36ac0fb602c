r"""RAPID modules of programs that were read from G-code or APT.

Decisions where RAPID leaves a choice:

- Targets are written as numbers in the instructions; tools, work objects, speeds and zones are LOCAL data.
- The first move goes to joint angles (MoveAbsJ). Rapid approaches in joint interpolation are MoveJ, everything else is
  MoveL or MoveC. ``ConfJ\On`` makes MoveJ arrive on the branch of its target; with ``ConfL\Off`` MoveL and
  MoveC keep their branch, which their targets state too.
- ``CirPathMode\ObjectFrame``: along circles, orientations are interpolated in the work object, as in the computation.
- The robot stops in a fine point before lines of the cell, dwells and stops, so that these run at that point.
- The zone of a move is a circle of the approximation distance around its end, for position and orientation alike.
"""

from __future__ import annotations

import re
from pathlib import PurePath

import numpy as np

from postproc.cell import Cell
from postproc.decimals import Number, Part, lines, number_text, without_negative_zero
from postproc.dialects import force_comments
from postproc.dialects.force_comments import text_in_rows
from postproc.dialects.new_program import NewProgram, Words, check_name
from postproc.dialects.rapid import language
from postproc.dialects.rapid.language import (
    BEGIN,
    END,
    NO_EXTERNAL_AXES,
    PREFIX,
    abb_from_joints,
    configuration,
    fault_of,
    quaternions,
    valid_name,
)
from postproc.errors import CellError, Issue, group_issues
from postproc.frames import MM_PER_M, Array
from postproc.program import (
    CIRC,
    LIN,
    PTP,
    Document,
    Ints,
    Program,
    TargetForces,
    TargetJoints,
    Targets,
    WrittenProgram,
    constant,
)
from postproc.version import VERSION

DECLARATION = re.compile(
    r"LOCAL (?:PERS|CONST) (tooldata|wobjdata|speeddata|zonedata) ([A-Za-z]\w*):=(\[[^;]*\]);", re.ASCII
)
_LARGEST_COORDINATE = 1e6
"""Largest coordinate of a frame [mm] (assumed)."""


def _joint_motion(joints: Array) -> str:
    """Return the MoveAbsJ to joint angles (6,) [rad], KUKA signs, with the first tool and work object."""
    angles = ",".join(f"{angle:.5f}" for angle in without_negative_zero(abb_from_joints(joints)).tolist())
    return f"MoveAbsJ [[{angles}],{NO_EXTERNAL_AXES}],speed_0,fine,tool_0\\WObj:=wobj_0;"


WORDS = Words(comment="!", dwell="WaitTime {};", halt="Stop;", axis_motion=_joint_motion, encoding="ascii")
_INSTRUCTIONS = {LIN: b"MoveL ", CIRC: b"MoveC ", PTP: b"MoveJ "}
_MILLIMETRES, _QUATERNION = 4, 8
"""Decimals of positions (0.1 µm) and quaternions: 1e-8 is 0.02 µm at a lever of 1 m."""
_REORIENTATION, _EXTERNAL = 500.0, "5000,1000"
"""Further numbers of speeddata, as in predefined ones: rotation [deg/s], external axes [mm/s, deg/s]."""
_NO_LOAD = "[0.001,[0,0,0.001],[1,0,0,0],0,0,0]"
"""The load of tool0."""
_SPEED_DECIMALS = 3
"""Decimals of speeds [mm/s]: a micrometre a second."""


def write(
    program: Program, targets: Targets, joints: TargetJoints, cell: Cell, comment_forces: TargetForces | None
) -> WrittenProgram:
    """Return a program read from G-code as RAPID.

    :param joints: joint angles at the targets, which decide on their configurations.
    :param comment_forces: forces to be written as comments, on lines before their targets; None: no force comments.
    :returns: one document, ``NAME.mod``, CR LF.
    :raises ProgramError: the name is not valid in RAPID; a move has no feed, or a feed that would be printed as 0.
    :raises CellError: a line of the cell is not RAPID, or moves the robot.
    """
    check_name(program, "RAPID", fault_of, valid_name)
    return _NewModule(program, targets, joints, cell, comment_forces).write()


class _NewModule:
    """Prints all targets in bulk, and between them the lines that `NewProgram` collects.

    :ivar zone_index: (K,) index of the zone of each target; 0: fine.
    :ivar speed_index: (K,) index of the speed of each target; 0: that of MoveJ.
    """

    def __init__(
        self, program: Program, targets: Targets, joints: TargetJoints, cell: Cell, comment_forces: TargetForces | None
    ) -> None:
        self.program, self.targets, self.joints, self.cell = program, targets, joints, cell
        self.comment_forces = comment_forces
        self.new_program = NewProgram(program, targets, cell, WORDS)

    def write(self) -> WrittenProgram:
        """Return the written module.

        :raises CellError: a line of the cell is not allowed.
        """
        new, program = self.new_program, self.program
        for _ in new.frame_changes():
            pass  # each move names its frames, but the robot must stop before them: the iteration adds these stops
        new.add_events()
        self._check_and_indent_cell_lines()
        # distinct distances, sorted: the first is 0, because the last target is a stop
        zones, self.zone_index = np.unique(new.approximation_distances(), return_inverse=True)
        speeds = self._speeds()
        self._add_force_comments()
        head = self._head_lines(zones, speeds)
        text, output_line = new.text_and_lines(
            head, self._move_lines, [*(f"    {line}" for line in END), "  ENDPROC", "ENDMODULE"]
        )
        limit = self.cell.output.lines_per_file
        if limit and text.count("\n") > limit:
            message = f"The module has more than {limit} lines: lines_per_file divides only KRL."
            new.issues.append(Issue("warning", "long-file", message))
        document = Document(f"{program.name}.mod", text, "ascii")
        return WrittenProgram((document,), output_line, "rapid", group_issues(new.issues))

    def _check_and_indent_cell_lines(self) -> None:
        """Check the lines of the cell, and indent them in `lines_before` of their targets.

        :raises CellError: a line is not RAPID, or moves the robot.
        """
        for target, cell_lines in self.new_program.lines_before.items():
            for line in cell_lines:
                fault = language.line_fault(line)
                if fault is not None:
                    raise CellError(
                        f"a line of [gcode] is not allowed in a RAPID program: {line!r}: {fault}",
                        advice='Write it as RAPID in the cell, for example spindle_on = ["SetDO doSpindle,1;"].',
                    )
            self.new_program.lines_before[target] = [f"    {line}" for line in cell_lines]

    def _speeds(self) -> Array:
        """Return the distinct speeds (S, 2) [mm/s, deg/s], that of MoveJ first; fill `speed_index`."""
        path, millionths = self.new_program.path_speeds()
        # from 1e-6 m/s to mm/s, rounded to the decimals that are printed
        tcp_speeds = np.rint(millionths * 10.0 ** (_SPEED_DECIMALS - 3)) / 10.0**_SPEED_DECIMALS
        turns = np.nan_to_num(self.new_program.turning_speeds()[path], nan=_REORIENTATION)
        values, index = np.unique(np.stack([tcp_speeds, turns], axis=1), axis=0, return_inverse=True)
        self.speed_index = np.zeros(len(self.targets), dtype=np.int64)
        self.speed_index[path] = index.reshape(-1) + 1
        return np.concatenate([[[self.cell.gcode.rapid_m_per_s * MM_PER_M, _REORIENTATION]], values])

    def _add_force_comments(self) -> None:
        """Add force comments to `lines_before` of the targets that need one."""
        if self.comment_forces is None:
            return
        no_note = constant(-1, len(self.targets))
        # a new program has no notes; NaN: the first path target needs a comment
        needs_comment = force_comments.needs_comment(
            self.comment_forces, self.targets.kind, note=no_note, notes=(), start=np.nan
        )
        targets = np.flatnonzero(needs_comment)
        comments = force_comments.texts(b"!", self.comment_forces, targets)
        for target, comment in zip(targets.tolist(), comments, strict=True):
            self.new_program.lines_before[target].append(f"    {comment}")

    def _head_lines(self, zones: Array, speeds: Array) -> list[str]:
        """Return the lines from MODULE to the move to the start position.

        :param zones: (Z,) approximation distances [m]; the first is 0 and needs no zonedata.
        :param speeds: (S, 2) speeds of TCP and rotation [mm/s, deg/s].
        """
        program, cell = self.program, self.cell
        start = ",".join(f"{angle:.5f}" for angle in without_negative_zero(abb_from_joints(cell.start_joints)).tolist())
        base, tool = self.new_program.frames_of_target(0)
        load = self._loaddata()
        return [
            f"MODULE {PREFIX}{program.name}",
            f"  ! generated by postproc {VERSION} from {WORDS.printable(program.documents[0].name)}",
            f"  ! {self.new_program.target_description()}, robot {WORDS.printable(PurePath(cell.robot).name)}",
            *(
                f"  LOCAL PERS tooldata tool_{row}:=[TRUE,{_pose_text(pose)},{load}];"
                for row, pose in enumerate(program.tools)
            ),
            *(
                f'  LOCAL PERS wobjdata wobj_{row}:=[FALSE,TRUE,"",{_pose_text(pose)},[[0,0,0],[1,0,0,0]]];'
                for row, pose in enumerate(program.bases)
            ),
            *(
                f"  LOCAL CONST speeddata speed_{row}:=[{number_text(speed)},{number_text(turning)},{_EXTERNAL}];"
                for row, (speed, turning) in enumerate(speeds.tolist())
            ),
            *(
                f"  LOCAL CONST zonedata zone_{row}:={_zonedata(zone)};"
                for row, zone in enumerate(zones.tolist())
                if row
            ),
            f"  PROC {program.name}()",
            *(f"    {line}" for line in BEGIN),
            f"    MoveAbsJ [[{start}],{NO_EXTERNAL_AXES}],speed_0,fine,tool_{tool}\\WObj:=wobj_{base};",
        ]

    def _loaddata(self) -> str:
        """Return the loaddata of the tools: the payload of the cell; without one, that of tool0, and a warning."""
        payload = self.cell.payload
        if payload.mass_kg > 0.0:
            centre = ",".join(number_text(value) for value in (payload.X, payload.Y, payload.Z))
            return f"[{number_text(payload.mass_kg)},[{centre}],[1,0,0,0],0,0,0]"
        message = (
            "The tool data have no load, because the cell has no [payload]. Set the load in the controller before the "
            "program runs, for example with LoadIdentify."
        )
        self.new_program.issues.append(Issue("warning", "tool-load", message))
        return _NO_LOAD

    def _move_lines(self, kind: int, k: Ints) -> bytes:
        """Return the move instructions of targets as text, one line for each.

        :param kind: `LIN`, `CIRC` or `PTP`.
        :param k: (n,) the targets, all of this kind.
        """
        motions, motion = self.program.motions, self.targets.motion[k]
        target = [b",", *_bracketed_columns(quaternions(self.targets.pose[k, :3, :3]), _QUATERNION)]
        axis_configuration = configuration(self.joints.q[k], self.joints.status[k])
        target += [
            b",",
            *_bracketed_columns(axis_configuration.astype(np.float64), 0),
            f",{NO_EXTERNAL_AXES}]".encode(),
        ]
        end = [b"[", *_bracketed_columns(self.targets.pose.position[k] * MM_PER_M, _MILLIMETRES), *target]
        via: list[Part] = []
        if kind == CIRC:
            via = [b"[", *_bracketed_columns(self.targets.via[k] * MM_PER_M, _MILLIMETRES), *target, b","]
        stops = self.zone_index[k] == 0
        return lines(
            [
                b"    " + _INSTRUCTIONS[kind],
                *via,
                *end,
                b",speed_",
                Number.of(self.speed_index[k].astype(np.float64), 0),
                text_in_rows(b",fine", stops),
                text_in_rows(b",zone_", ~stops),
                Number.of(np.where(stops, np.nan, self.zone_index[k]), 0),
                b",tool_",
                Number.of(motions.tool[motion].astype(np.float64), 0),
                b"\\WObj:=wobj_",
                Number.of(motions.base[motion].astype(np.float64), 0),
                b";\r\n",
            ]
        )


def _bracketed_columns(values: Array, decimals: int) -> list[Part]:
    """Return ``[…,…]`` of numbers (n, c) as columns of text that are printed side by side."""
    parts: list[Part] = []
    for column in values.T:
        parts += [b"," if parts else b"[", Number.of(column, decimals)]
    return [*parts, b"]"]


def _pose_text(pose: Array) -> str:
    """Return a pose (4, 4) [m] as an aggregate of RAPID: position [mm] and quaternion."""
    position = ",".join(number_text(value) for value in (pose[:3, 3] * MM_PER_M).tolist())
    orientation = ",".join(
        f"{without_negative_zero(value):.{_QUATERNION}f}" for value in quaternions(pose[None, :3, :3])[0].tolist()
    )
    return f"[[{position}],[{orientation}]]"


def _zonedata(distance: float) -> str:
    """Return zonedata of an approximation distance [m].

    Orientation and external axes have the same zone as the path; zones of angles [deg] are a tenth of it [mm], as in
    predefined zonedata.
    """
    mm = number_text(distance * MM_PER_M)
    tenth = number_text(0.1 * distance * MM_PER_M)
    return f"[FALSE,{mm},{mm},{mm},{tenth},{mm},{tenth}]"
