"""Issues of a program, and calls that must not stay uncorrected under force.

Only forces of comments are known here; those of tables and processes are checked where they are used
(`Program.unfollowed`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from postproc.dialects.krl.language.names import BY_FILE, BY_SENSOR
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.tree import Motion, Return
from postproc.dialects.krl.layout import Layout
from postproc.dialects.krl.read.main_routine import TraceFollower
from postproc.dialects.krl.read.motion_columns import MotionColumns
from postproc.dialects.krl.read.run import Run, UntracedCall
from postproc.dialects.krl.read.state import MotionStates
from postproc.errors import Issue, ProgramError, first_of
from postproc.program import ForceNote, UnfollowedCall

_MOST_NAMES = 10
"""Most names of points in one message."""
_MOST_FILES = 3
"""Most files named for one variable."""


def issues_of(
    follower: TraceFollower, motion_states: MotionStates, columns: MotionColumns, layout: Layout
) -> Iterator[Issue]:
    """Yield the issues about a program that has been followed.

    :param follower: has followed the program.
    :param motion_states: settings in force at the motions of the program.
    :param columns: the motions.
    :raises ProgramError: a called program is known to move the robot by a sensor or along the points of a file.
    """
    yield from _absent_program_warnings(follower)
    yield from _uncalled_routine_warnings(follower)
    yield from _unreachable_motion_warnings(follower)
    yield from _changed_variable_warnings(follower)
    yield from _initial_frame_warnings(follower, motion_states, columns, layout)


def _absent_program_warnings(follower: TraceFollower) -> Iterator[Issue]:
    """Yield a warning for each called program that is in no file: it is assumed not to move the robot.

    :raises ProgramError: one of the programs is known to move the robot by a sensor (`BY_SENSOR`), or along the points
        of a file (`BY_FILE`).
    """
    global_names = sorted(
        follower.run.variables.used_names & follower.run.variables.global_names
    )  # motions depend on them
    points = f", nor the GLOBAL {first_of(global_names, _MOST_NAMES)}" if global_names else ""
    for name, line in follower.run.absent_calls:
        if name.upper() in BY_SENSOR:
            raise follower.run.routine.source.line_error(
                f"{name}() moves the robot by what a sensor says: the path is not known",
                line,
                "Convert the program without the sensor's correction.",
            )
        if name.upper() in BY_FILE:
            raise follower.run.routine.source.line_error(
                f"{name}() moves the robot along the points of a file, which are not in the program",
                line,
                "Convert the G-code or the cutter-location file of the part instead: it becomes KRL with all points.",
            )
        fault = follower.run.library.faults.get(name.upper())
        place_text = f"is in a file that cannot be read ({fault})" if fault else "is in no file that was searched"
        message = (
            f"{name}() {place_text}: it is assumed not to move the robot nor to change $BASE, $TOOL, speeds{points}. "
            "Put its .src next to the program, or name its folder in the cell: [krl] search."
        )
        yield Issue("warning", "external-call", message, line, subject=name.upper())


def _uncalled_routine_warnings(follower: TraceFollower) -> Iterator[Issue]:
    """Yield a warning for each routine of the program that has motions of its own and is not called."""
    program = follower.run.library.program
    for routine in program.routines.values():
        if routine is follower.run.routine or routine in follower.run.called_routines:
            continue
        motion = follower.run.analysis.effects_of(program, routine).motion
        if motion is None or motion.source is not follower.run.routine.source:
            continue
        if not routine.first < motion.line < routine.last:
            continue  # the motion of a routine that it calls: reported for that routine
        message = (
            f"DEF {routine.name} has motions but {follower.run.routine.name} does not call it; "
            "they are left as they are."
        )
        yield Issue("warning", "uncalled-motions", message, motion.line, subject=routine.name)


def _unreachable_motion_warnings(follower: TraceFollower) -> Iterator[Issue]:
    """Yield a warning if motions of the main routine never run because of its RETURN."""
    routine, source, end = follower.run.routine, follower.run.routine.source, follower.run.level.return_line
    if not end or follower.execution.may_run is None or not isinstance(statement(source, end), Return):
        return
    motion_lines = [line for line in routine.other_lines if line > end and isinstance(statement(source, line), Motion)]
    lines = np.sort([*routine.motion_lines[routine.motion_lines > end].tolist(), *motion_lines]).astype(np.int64)
    rows, index = follower.execution.rows_of(source, lines)
    # without lines that run all the same: the RETURN is in a loop
    lines = np.delete(lines, index[follower.execution.may_run[rows - 1]])
    if len(lines):
        message = f"Motions are never reached, because of RETURN (line {end}); they are left as they are."
        yield Issue("warning", "never-reached", message, int(lines[0]), subject=routine.name, count=len(lines))


def _changed_variable_warnings(follower: TraceFollower) -> Iterator[Issue]:
    """Yield a warning if programs that are not called change GLOBAL variables on which motions depend.

    Variables that the program itself changes are left out.
    """
    variables = follower.run.variables
    writers = follower.run.library.programs_setting(
        (variables.used_names & variables.global_names) - variables.change_places.keys()
    )
    if not writers:
        return
    names = first_of([f"{name} ({', '.join(files[:_MOST_FILES])})" for name, files in writers.items()], _MOST_NAMES)
    message = (
        f"Programs that this one does not call change what its motions depend on: {names}. The output "
        "holds for the values in the files. If they run before it, convert the program that calls both."
    )
    yield Issue("warning", "changed-elsewhere", message, subject=", ".join(list(writers)[:_MOST_NAMES]))


def _initial_frame_warnings(
    follower: TraceFollower, motion_states: MotionStates, columns: MotionColumns, layout: Layout
) -> Iterator[Issue]:
    """Yield a warning for `$BASE` and `$TOOL` if they are frames of the cell only because no statement sets them.

    It matters to motions with Cartesian targets, and to statements that read the frame.

    :param motion_states: settings in force at the M motions.
    :param columns: the M motions as they are in the text.
    """
    settings = follower.run.settings
    has_axis_target = np.zeros(len(columns), dtype=np.bool_)  # joint angles: the motion needs no frames
    has_axis_target[[motion for motion, move in layout.statements.items() if move.end.position.is_axis]] = True
    for name, table in (("$BASE", "[base]"), ("$TOOL", "[tool]")):
        is_assumed_in_state = np.array([name in settings.assumed_frames(state) for state in motion_states.states])
        is_assumed = is_assumed_in_state[motion_states.index]  # (M,)
        affected_motions = np.flatnonzero(is_assumed & ~has_axis_target)
        is_read_by_statements = name in settings.frames.names_read_as_assumed
        if not len(affected_motions) and not is_read_by_statements:
            continue
        kuka_frame = "BASE(0), that is $ROBROOT" if name == "$BASE" else "TOOL_DATA[1]"
        message = (
            f"{name} is never set behind BAS(#INITMOV,0): {table} of the cell is assumed, but KUKA's BAS makes it "
            f'{kuka_frame}. Say in the cell which is meant: [krl] initmov = "cell" or "bas".'
        )
        yield Issue(
            "warning",
            "initial-frames",
            message,
            follower.run.trace.reported_line(columns.trace_row.item(affected_motions[0]))
            if len(affected_motions)
            else None,
            subject=name,
            count=len(affected_motions),
        )


_KEEP_ADVICE = "--keep-unresolved leaves motions as they are"


def refuse_routines_with_force_comments(run: Run) -> None:
    """Refuse routines that are not followed, contain force comments and may move under force.

    :raises ProgramError: there is such a routine; the error names the statement that cannot be followed.
    """
    for call in run.untraced_calls:
        force = run.analysis.effects_of(call.module, call.routine).force_comment
        if force is not None and run.analysis.may_carry_force(call.module, call.routine):
            raise _uncorrected_error(run, call, f": it contains a force comment ({force})")


def refuse_routines_under_force(run: Run, notes: Sequence[tuple[int, ForceNote]]) -> None:
    """Refuse untraced routines that may move the tool and are called where a force comment other than zero holds.

    :param notes: force comments of the trace in order, each with its row in the trace.
    :raises ProgramError: there is such a routine; the error names the statement that cannot be followed.
    """
    for call in run.untraced_calls:
        acting_notes = [note for row, note in notes if row < call.row][-1:]  # the last comment before the call
        if acting_notes and any(acting_notes[0].wrench) and run.analysis.may_carry_force(call.module, call.routine):
            raise _uncorrected_error(run, call, ": a force comment holds there")


def unfollowed_calls(run: Run) -> tuple[UnfollowedCall, ...]:
    """Return the calls of routines that are not followed and that may move under force, each with its error."""
    return tuple(
        UnfollowedCall(run.trace.reported_line(call.row), _uncorrected_error(run, call))
        for call in run.untraced_calls
        if run.analysis.may_carry_force(call.module, call.routine)
    )


def _uncorrected_error(run: Run, call: UntracedCall, force_text: str = "") -> ProgramError:
    """Return the error that a called routine would stay uncorrected under force.

    :param call: the call of the routine.
    :param force_text: end of the message, which names the force; empty if the force is not known.
    """
    cause, place = call.cause, run.trace.place(call.row)
    place_text = f"{place.source.document.name}, line {place.line}"
    problem = f"{cause.problem}; {call.name}(), called in {place_text}, would stay uncorrected under force{force_text}"
    advice = cause.advice or ""
    if "--keep-unresolved" not in advice:
        advice = f"{advice} {_KEEP_ADVICE}.".strip()
    return ProgramError(problem, file=cause.file, line=cause.line, text=cause.text, advice=advice)
