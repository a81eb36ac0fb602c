"""RoboDK post: KUKA KRL for KRC4, corrected for the deflection of the robot under cutting forces, by way of `postproc`.

Put where RoboDK looks for posts by ``postproc install-post robodk``. RoboDK calls the methods of `RobotPost` one by one
and `ProgSave` at the end. What they say is written as plain KRL, which `ProgSave` hands to ``postproc convert``;
nothing is computed here. Frames, tools and joint angles are RoboDK's own; robot model and tolerances are those of a
cell file: the one that POSTPROC_CELL names, else cell.toml in the folder of the programs, or its parent.
"""

from __future__ import annotations

import csv
import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

sys.path.insert(0, str(Path(__file__).resolve().parent))
from postproc_host import Block, Converted, HostError, convert
from postproc_host.safe_text import one_line, string_content

del sys.path[0]

_CALL = re.compile(r"\s*(\w+)\s*\(\s*\)")
_MOTION = re.compile(r"\s*(S?(PTP|LIN|CIRC)(_REL)?\b|SPLINE\b)", re.IGNORECASE)
_AXES = ("A1", "A2", "A3", "A4", "A5", "A6", "E1", "E2", "E3", "E4", "E5", "E6")


class RobotPost:
    """What RoboDK calls while it generates programs.

    Poses are matrices of `robodk.robomath` in mm; joints are in degrees, then external axes in mm or degrees.
    """

    PROG_EXT = "src"
    INCLUDE_SUB_PROGRAMS = True
    MAX_LINES_X_PROG = 0
    """Of more lines a program is divided into files; 0: as the cell file says. RoboDK may set it."""

    def __init__(self, robotpost: str = "", robotname: str = "", robot_axes: int = 6, **kwargs: Any) -> None:
        self.robot = robotname
        self.axes = robot_axes
        self.station_names: dict[str, str] = {}  # name in KRL, in lower case → name in the station
        self.programs: dict[str, list[Block]] = {}
        self.joints: dict[str, dict[int, list[float]]] = {}
        self.name = ""
        self.blended = False
        self.MAX_LINES_X_PROG = _line_limit(kwargs.get("lines_x_prog"), self.MAX_LINES_X_PROG)
        self.PROG_FILES: list[str] = []
        self.LOG = ""

    def ProgStart(self, progname: str) -> None:
        """Begin a program; RoboDK may begin several before it saves.

        :raises HostError: the controller would take its name for that of another one of them.
        """
        self.name = self._krl_name(progname)
        self.programs[self.name] = []
        self.joints[self.name] = {}
        self._add_line(f"DEF {self.name}()")

    def ProgFinish(self, progname: str) -> None:
        """End the program."""
        self._add_line("END")

    def ProgSave(self, folder: str, progname: str, ask_user: bool = False, show_result: Any = False) -> None:
        """Correct all programs by postproc and write them; programs without motion are written as they are.

        :raises HostError: a program cannot be converted; nothing is written of it.
        """
        target = Path(_chosen_folder(folder, progname) if ask_user or not Path(folder).is_dir() else folder)
        cell = _cell_file(target)
        flags = [("--cell", str(cell))]
        if self.MAX_LINES_X_PROG:
            flags.append(("--lines-per-file", str(self.MAX_LINES_X_PROG)))
        files: dict[str, list[Path]] = {}
        names: dict[str, str] = {}  # name of a program in lower case → name of its file, which calls must use
        try:
            for name in _callees_first(self.programs):
                blocks = [_with_written_name(block, names) for block in self.programs[name]]
                if any(_MOTION.match(block.text) for block in blocks):
                    conversion = convert(blocks, target, name, "src", flags)
                    _compare_postures(conversion, self.joints[name])
                    files[name] = [path for path in conversion.files if path.suffix.lower() in (".src", ".dat")]
                    names[name.lower()] = files[name][0].stem
                    lines = "\n".join([f"{name}:", *conversion.verdict, *conversion.warnings])
                    self.addlog(lines)
                    if conversion.state == "failed":  # it may be driven, but should not be: no line among others
                        _show(lines)
                else:
                    path = target / f"{name}.src"
                    path.write_text("".join(f"{block.text}\r\n" for block in blocks), encoding="utf-8", newline="")
                    files[name] = [path]
        except HostError as cause:
            _show(f"{name}: nothing is written.\n{cause}")
            raise
        paths = [path for name in self.programs for path in files[name]]
        self.PROG_FILES = [str(path) for path in paths]
        for path in paths:
            print(f"SAVED: {path}\n")
        if show_result and paths:
            _open(paths[0], show_result)

    def ProgSendRobot(self, robot_ip: str, remote_path: str, ftp_user: str, ftp_pass: str) -> None:
        """Send the saved programs to the controller, by RoboDK's own means."""
        from robodk.robofileio import UploadFTP

        UploadFTP(self.PROG_FILES, robot_ip, remote_path, ftp_user, ftp_pass)

    def MoveJ(self, pose: Any, joints: Sequence[float], conf_RLF: Any = None) -> None:
        """Move the joints to a target."""
        self._add_line(f"PTP {{{','.join(_axis_texts(joints))}}}", "MoveJ")

    def MoveL(self, pose: Any, joints: Sequence[float], conf_RLF: Any = None) -> None:
        """Move in a straight line."""
        self._add_line(f"LIN {{{_pose_text(pose, joints)}}}{self._approximation()}", "MoveL", joints)

    def MoveC(
        self,
        pose1: Any,
        joints1: Sequence[float],
        pose2: Any,
        joints2: Sequence[float],
        conf_RLF_1: Any = None,
        conf_RLF_2: Any = None,
    ) -> None:
        """Move along the arc through two targets."""
        self._add_line(
            f"CIRC {{{_pose_text(pose1, joints1)}}},{{{_pose_text(pose2, joints2)}}}{self._approximation()}",
            "MoveC",
            joints2,
        )

    def setFrame(self, pose: Any, frame_id: int | None = None, frame_name: str | None = None) -> None:
        """Set the frame that the following targets are in, in the base of the robot."""
        self._add_line(f"; frame {one_line(str(frame_name or frame_id))}")
        self._add_line(f"$BASE={{{_pose_text(pose)}}}", "setFrame")

    def setTool(self, pose: Any, tool_id: int | None = None, tool_name: str | None = None) -> None:
        """Set the frame of the tool in that of the flange."""
        self._add_line(f"; tool {one_line(str(tool_name or tool_id))}")
        self._add_line(f"$TOOL={{{_pose_text(pose)}}}", "setTool")

    def Pause(self, time_ms: float) -> None:
        """Wait; a negative time waits for the operator."""
        self._add_line("HALT" if time_ms < 0 else f"WAIT SEC {time_ms / 1000.0:.3f}")

    def setSpeed(self, speed_mms: float) -> None:
        """Set the speed of the tool, in mm/s."""
        self._add_line(f"$VEL.CP={speed_mms / 1000.0:.6f}", "setSpeed")

    def setAcceleration(self, accel_mmss: float) -> None:
        """Set the acceleration of the tool, in mm/s²."""
        self._add_line(f"$ACC.CP={accel_mmss / 1000.0:.6f}")

    def setSpeedJoints(self, speed_degs: float) -> None:
        """Set the speed of the joints, in deg/s: KRL needs a share of the maximum, which RoboDK does not state."""
        self.addlog(f"Speed of the joints ({speed_degs:g} deg/s) is left to the controller.")

    def setAccelerationJoints(self, accel_degss: float) -> None:
        """Set the acceleration of the joints, see `setSpeedJoints`."""
        self.addlog(f"Acceleration of the joints ({accel_degss:g} deg/s2) is left to the controller.")

    def setZoneData(self, zone_mm: float) -> None:
        """Set how far corners may be rounded, in mm; negative: exact stops."""
        self.blended = zone_mm >= 0.0
        if self.blended:
            self._add_line(f"$APO.CDIS={zone_mm:.3f}", "setZoneData")

    def setDO(self, io_var: str | int, io_value: Any) -> None:
        """Set a digital output."""
        self._add_line(f"{_signal_text('OUT', io_var)}={_truth_text(io_value)}", "setDO")

    def setAO(self, io_var: str | int, io_value: float) -> None:
        """Set an analogue output."""
        self._add_line(f"{_signal_text('ANOUT', io_var)}={_operand_text(io_value)}", "setAO")

    def waitDI(self, io_var: str | int, io_value: Any, timeout_ms: float = -1) -> None:
        """Wait for a digital input."""
        if timeout_ms >= 0:
            self.addlog("waitDI: KRL waits without a time limit.")
        self._add_line(f"WAIT FOR {_signal_text('IN', io_var)}=={_truth_text(io_value)}")

    def RunCode(self, code: str, is_function_call: bool = False) -> None:
        """Call a program, or insert lines of KRL.

        :raises HostError: the controller would take the called program for another one.
        """
        if not is_function_call:
            self._add_code(code, "RunCode")
            return
        name, bracket, arguments = code.partition("(")
        callee = self._krl_name(name.strip() if bracket else name)
        self._add_line(f"{callee}({one_line(arguments)}" if bracket else f"{callee}()", "RunCode")

    def RunMessage(self, message: str, iscomment: bool = False) -> None:
        """Show a message, or insert a comment."""
        self._add_line(f"; {one_line(message)}" if iscomment else f'MsgNotify("{string_content(message)}")')

    def addline(self, newline: str) -> None:
        """Insert lines of KRL."""
        self._add_code(newline, "addline")

    def addlog(self, newline: str) -> None:
        """Note what the user should know."""
        self.LOG = f"{self.LOG}{newline}\n" if newline else self.LOG

    def _krl_name(self, name: str) -> str:
        """Return the name that a program of the station has in KRL.

        :raises HostError: it has no name, or another program has the same one in KRL.
        """
        if not name.strip():
            subject = f"A call in program {self.name}" if self.name else "A program"
            _refuse(f"{subject} has no name of a program: enter it in the station.")
        krl_name = _allowed_name(name)
        first_name = self.station_names.setdefault(krl_name.lower(), name)
        if first_name != name:
            _refuse(
                f"The programs {one_line(first_name)!r} and {one_line(name)!r} would both be {krl_name} in KRL: names "
                "have at most 24 letters, digits and _ there, and case does not count. Rename one of them in the "
                "station."
            )
        return krl_name

    def _approximation(self) -> str:
        """Return the end of a path motion: approximation by distance, or nothing for an exact stop."""
        return " C_DIS" if self.blended else ""

    def _add_code(self, text: str, origin: str) -> None:
        """Add the lines of a text to the program; `origin`: method of the post that got it."""
        for line in re.split("[\r\n]+", text.strip("\r\n")):
            self._add_line(line, origin)

    def _add_line(self, text: str, origin: str = "", joints: Any = ()) -> None:
        """Add a line to the program, with its place in the station.

        :param origin: method of the post that adds it; empty: not named.
        :param joints: A1 to A6 of the host [deg] at the end of the motion; empty: not compared.
        """
        lines = self.programs[self.name]
        if len(joints):
            self.joints[self.name][len(lines) + 1] = _numbers(joints)
        lines.append(Block(text, f"program {self.name}, line {len(lines) + 1}" + f" ({origin})" * bool(origin)))


def _allowed_name(name: str) -> str:
    """Return a name that KRL allows."""
    valid = re.sub("[^A-Za-z0-9_]", "_", name)[:24]
    return valid if re.match("[A-Za-z]", valid) else f"P{valid}"[:24]


def _line_limit(lines: Any, default: int) -> int:
    """Return RoboDK's limit of lines; the default where it has none, or one so large that none is meant."""
    return int(lines) if lines and 0 < lines < 1e6 else default


def _callees_first(programs: dict[str, list[Block]]) -> list[str]:
    """Return the names of programs, each behind those that it calls."""
    order: list[str] = []
    by_call = {name.lower(): name for name in programs}

    def add(name: str, call_chain: tuple[str, ...]) -> None:
        """Add a program behind those that it calls; one that calls itself, by others too, is added once."""
        if name in order or name in call_chain:
            return
        for block in programs[name]:
            match = _CALL.match(block.text)
            if match and match[1].lower() in by_call:
                add(by_call[match[1].lower()], (*call_chain, name))
        order.append(name)

    for name in programs:
        add(name, ())
    return order


def _with_written_name(block: Block, names: dict[str, str]) -> Block:
    """Return a line in which a called program has the name of its written file; other lines as they are.

    :param names: called name in lower case → name of the written file, without extension.
    """
    match = _CALL.match(block.text)
    if match is None or match[1].lower() not in names:
        return block
    return block._replace(text=names[match[1].lower()] + block.text[match.end(1) :])


def _pose_text(pose: Any, joints: Sequence[float] = ()) -> str:
    """Return a pose as KRL has it, with the external axes of `joints`."""
    from robodk.robomath import Pose_2_KUKA

    numbers = Pose_2_KUKA(pose)
    parts = [f"{axis} {number:.{4 if axis in 'XYZ' else 5}f}" for axis, number in zip("XYZABC", numbers)]
    return ",".join([*parts, *_axis_texts(joints)[6:]])


def _axis_texts(joints: Sequence[float]) -> list[str]:
    """Return the joints [deg], then the external axes, as KRL has them, such as ``A1 12.50000``."""
    return [f"{axis} {float(value):.5f}" for axis, value in zip(_AXES, _numbers(joints))]


def _numbers(joints: Any) -> list[float]:
    """Return the joints of RoboDK, which gives a list or a matrix of one column, as numbers."""
    return [float(value) for value in (joints.list() if hasattr(joints, "list") else joints)]


def _compare_postures(conversion: Converted, joints: dict[int, list[float]]) -> None:
    """Delete results whose postures are not those of RoboDK: from the cell's [start] the arm takes another branch.

    Joint angles that differ by more than 1° are another branch: corrections are far smaller.

    :param joints: line of the program → A1 to A6 of RoboDK [deg] at the end of its motion.
    :raises HostError: the files are deleted; the message says which line differs, and what to do.
    """
    table = next(path for path in conversion.files if path.name.endswith(".targets.csv"))
    with table.open(encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(stream):
            station_angles = joints.get(int(row["source_line"]))
            is_inserted = float(row["t"]) < 1.0  # within its motion, of which RoboDK knows the end only
            if station_angles is None or is_inserted:
                continue
            angles = [float(row[axis]) for axis in _AXES[:6]]
            largest_difference = max(abs(angle - station) for angle, station in zip(angles, station_angles))
            if largest_difference > 1.0:
                for path in conversion.files:
                    path.unlink()
                raise HostError(
                    f"Line {row['source_line']}: RoboDK has the robot at A1-A6 {_angles_text(station_angles)}, but "
                    f"from [start] of the cell it arrives with {_angles_text(angles)}. Begin the program with a MoveJ, "
                    "or state the joint angles before its first motion under [start]."
                )


def _angles_text(joints: list[float]) -> str:
    """Return the first six joint angles [deg] as text."""
    return ", ".join(f"{value:.1f}" for value in joints[:6])


def _signal_text(kind: str, signal: str | int) -> str:
    """Return a signal as KRL has it, such as ``$OUT[3]``; a name stays as it is. `kind`: IN, OUT or ANOUT."""
    text = str(signal).strip()
    return f"${kind}[{text}]" if text.isdigit() else _operand_text(text)


def _truth_text(value: Any) -> str:
    """Return TRUE or FALSE; a text is the name of a KRL variable."""
    return _operand_text(value) if isinstance(value, str) else "TRUE" if value else "FALSE"


def _operand_text(value: Any) -> str:
    """Return a number, or the name of a KRL variable or signal.

    :raises HostError: it is neither.
    """
    text = str(value).strip()
    if not re.fullmatch(r"[\w$.+-]+(\[\d+\])?", text, re.ASCII):
        raise HostError(f"{text!r} is neither a number nor the name of a signal: correct it in the station.")
    return text


def _cell_file(folder: Path) -> Path:
    """Return the cell file: that of the variable POSTPROC_CELL, else cell.toml in a folder or in its parent.

    :param folder: of the written programs.
    :raises HostError: there is none; the message says where it was looked for.
    """
    variable = os.environ.get("POSTPROC_CELL")
    places = [Path(variable)] if variable else [folder / "cell.toml", folder.parent / "cell.toml"]
    for path in places:
        if path.is_file():
            return path.resolve()
    raise HostError(
        f"There is no cell file: {' and '.join(str(path) for path in places)} do not exist. Make one with "
        "'postproc init', and put it there or name it in the environment variable POSTPROC_CELL."
    )


def _chosen_folder(folder: str, name: str) -> str:
    """Return the folder to write into, which the user chooses.

    :param folder: in which the dialog begins; `name`: of the program.
    :raises HostError: the user chose none.
    """
    from robodk.robodialogs import getSaveFolder

    answer = getSaveFolder(folder, f"Save {name} and its report in...")
    if not answer:
        raise HostError("No folder was chosen: nothing is written.")
    return str(answer)


def _refuse(message: str) -> None:
    """Show a message and raise it.

    :raises HostError: always.
    """
    _show(f"Nothing is written.\n{message}")
    raise HostError(message)


def _show(message: str) -> None:
    """Show a message where the user of RoboDK looks."""
    print(message, file=sys.stderr)
    if "ROBODK_API_PORT" in os.environ:
        from robodk.robodialogs import ShowMessage

        ShowMessage(message, "KUKA, corrected")


def _open(path: Path, viewer: Any) -> None:
    """Open a program in the editor that RoboDK names, else as the system does."""
    import subprocess

    if isinstance(viewer, (str, list)):
        subprocess.Popen([*([viewer] if isinstance(viewer, str) else viewer), str(path)])
    elif hasattr(os, "startfile"):
        os.startfile(path)
