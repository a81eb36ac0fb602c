"""From columns of words to motions: lines to moves, arcs, and all of them in `$BASE`.

Rows are lines of the program as executed. Lengths are mm in the program frame until the last step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct

from postproc.cell import Rotary
from postproc.dialects.gcode.added import approached, chords
from postproc.dialects.gcode.arcs import SAME_MM, Arcs, ArcWords, read_arcs
from postproc.dialects.gcode.blocks import Fault
from postproc.dialects.gcode.cycles import CycleEvent
from postproc.dialects.gcode.line_states import LineStates, in_force, line_states_of
from postproc.dialects.gcode.mistakes import faults_of
from postproc.dialects.gcode.modes import Modes
from postproc.dialects.gcode.rotary import check_turning, swivel_of, turned
from postproc.dialects.gcode.tool_positions import Moves, Setting, moves_of
from postproc.errors import Level
from postproc.frames import M_PER_MM, Array, norm
from postproc.program import CIRC, LIN, PTP, Bools, Ints, Motions, Swivel, distinct

CHORD = 0.1
"""Share of the tolerance that chords may take."""
_STILL = 1e-9
"""A tool that turns by less than this [rad] does not turn."""
_S_PER_MIN = 60.0


class Speeds(Struct, frozen=True):
    """What the cell says of speeds and corners.

    :param rapid: speed of G0 [m/s].
    :param approximation: approximation distance [m].
    :param rounding: what approximation may round corners by [m], unless the program says it (G64 P).
    :param home: (6,) joint angles of [machine] home [rad], or NaN.
    :param chord: what chords of an arc along which rotary axes turn may leave it by [mm].
    """

    rapid: float
    approximation: float
    rounding: float
    home: Array
    chord: float


class Path(Struct, frozen=True, eq=False):
    """The motions of a program, and what was noticed.

    :param motions: see `Motions`; their lines are rows + 1.
    :param swivel: see `Program`.
    :param row: (M,) row that makes each motion, never decreasing.
    :param still: (n,) rows of moves that are not in `motions`, ascending: they go nowhere, or are held back.
    :param held_back: (n,) those of them that are rapid moves before the position is known.
    :param done: what happens in cycles: the motion that it precedes, row, what.
    :param told: row, level, kind and message of what the user should know.
    """

    motions: Motions
    swivel: Swivel | None
    row: Ints
    still: Ints
    held_back: Ints
    done: Sequence[tuple[int, int, CycleEvent]]
    told: Sequence[tuple[int, Level, str, str]]


def read_path(
    columns: Mapping[str, Array], modes: Modes, setting: Setting, speeds: Speeds, rotary: Rotary | None
) -> Path | list[Fault]:
    """Return the motions of a program, or the reasons why it cannot be read, in order of lines.

    :param columns: words of all lines, see `postproc.dialects.gcode.words.read_plain`.
    :param modes: the other blocks.
    :param setting: what the cell says about frames, `rotary` about axes that turn, `speeds` about the rest.
    """
    rows = line_states_of(columns, modes, rotary)
    moves, held_back, arriving = approached(moves_of(rows, modes, setting), setting)
    circular = np.flatnonzero(moves.code >= 2.0)
    arcs = _arcs(rows, moves, circular)
    faults = faults_of(rows, moves, modes, moves.row[circular], arcs.faults)
    if not faults and rotary is not None:
        faults = check_turning(rows, moves, held_back, setting.axes, " or ".join(rotary.tcp_on))
    if faults:
        return faults
    length = _lengths(moves, circular, arcs)
    moves, count = chords(moves, circular, arcs, speeds.chord)
    held_back, arriving, length = np.repeat(held_back, count), np.repeat(arriving, count), np.repeat(length, count)
    whole = count[circular] == 1
    circular, arcs = np.flatnonzero(moves.code >= 2.0), arcs.of(whole)
    other_tool = np.diff(moves.tool, prepend=moves.tool[:1]) != 0
    turns = turned(moves, setting.axes) > _STILL
    stays = ~turns & (length <= SAME_MM) & (moves.code < 2.0) & ~moves.home & ~other_tool & ~arriving & ~held_back
    kept = np.flatnonzero(~stays & ~held_back)
    free = arriving[kept] | moves.home[kept]
    alone = turns[kept] & (length[kept] <= SAME_MM) & (moves.code[kept] == 1.0) & ~free
    swivel = None if rotary is None else swivel_of(moves, rows, kept, free, alone, setting)
    motions = _motions(rows, moves, (circular, arcs), kept, free, (swivel, alone, length[kept]), modes, setting, speeds)
    done = [(int(np.searchsorted(kept, at)), row, what) for at, row, what in moves.done]
    away = moves.row[held_back]
    still = distinct(np.concatenate([away, moves.row[stays]]))
    return Path(motions, swivel, moves.row[kept], still, distinct(away), done, moves.told)


def _arcs(rows: LineStates, moves: Moves, circular: Ints) -> Arcs:
    row = moves.row[circular]
    return read_arcs(
        ArcWords(
            start=moves.begin[circular],
            end=moves.end[circular],
            given=~np.isnan(rows.xyz[row]),
            offset=rows.ijk[row],
            radius=rows.radius[row],
            turns=rows.turns[row],
            clockwise=moves.code[circular] == 2.0,
            plane=rows.plane[row],
            units=rows.units[row],
            absolute=rows.absolute_centre[row],
        )
    )


def _motions(
    rows: LineStates,
    moves: Moves,
    circles: tuple[Ints, Arcs],
    kept: Ints,
    free: Bools,
    turning: tuple[Swivel | None, Bools, Array],
    modes: Modes,
    setting: Setting,
    speeds: Speeds,
) -> Motions:
    """Return the moves that are kept, in `$BASE`.

    :param free: (M,) True for moves by joint interpolation.
    :param turning: how they turn the tool, which turn it alone (M,), and how long they are (M,) [mm].
    """
    swivel, alone, length = turning
    row, code, home = moves.row[kept], moves.code[kept], moves.home[kept]
    rapid = code == 0.0
    kind = np.where(free, PTP, np.where(code < 2.0, LIN, CIRC))
    nothing = np.broadcast_to(np.nan, (len(kept), 6))  # takes no memory
    centre, normal, sweep = nothing[:, :3], nothing[:, :3], nothing[:, 0]
    target = np.zeros((len(kept), 4, 4))
    target[:, 3, 3] = 1.0
    frames = moves.frames[moves.frame[kept]] if len(moves.frames) > 1 else moves.frames
    if swivel is None:
        target[:, :3, :3] = frames[:, :3, :3] @ setting.orientation
    else:
        target[:, :3, :3] = swivel.of(swivel.end, swivel.frame)
    target[:, :3, 3] = _placed(frames, moves.end[kept])
    is_arc = np.flatnonzero(kind == CIRC)
    if len(is_arc):
        circular, arcs = circles
        at = np.searchsorted(circular, kept[is_arc])
        own = frames[is_arc] if len(frames) > 1 else frames
        centre, normal, sweep = centre.copy(), normal.copy(), sweep.copy()
        centre[is_arc] = _placed(own, arcs.centre[at])
        normal[is_arc] = np.einsum("nij,nj->ni", np.broadcast_to(own[:, :3, :3], (len(at), 3, 3)), arcs.normal[at])
        sweep[is_arc] = arcs.sweep[at]
    joints = nothing
    if home.any() and setting.home is not None:
        joints = nothing.copy()
        joints[home] = speeds.home
        target[home] = setting.home[moves.tool[kept[home]]]
    per_minute = rows.feed[row].copy()
    timed = rows.inverse_time[row] & ~rapid
    per_minute[timed] *= length[timed]
    per_minute[timed & alone] = speeds.rapid * _S_PER_MIN / M_PER_MM  # the tip stays: how fast the tool turns counts
    feed = np.where(rapid, speeds.rapid, per_minute * (M_PER_MM / _S_PER_MIN))
    feed[kind == PTP] = np.nan
    blend = in_force(modes.blends, speeds.approximation, modes.rows)[row]
    blend[moves.bottom[kept]] = 0.0
    limit = in_force(modes.roundings, np.nan, modes.rows)[row]
    unset = np.full(len(kept), -1)
    motions = Motions(
        kind=kind.astype(np.int64),
        rapid=rapid,
        line=row + 1,
        target=target,
        joints=joints,
        centre=centre,
        normal=normal,
        sweep=sweep,
        feed=feed,
        base=np.zeros(len(kept), dtype=np.int64),
        tool=moves.tool[kept],
        blend=blend,
        rounding=np.where(np.isnan(limit), speeds.rounding, limit),
        status=unset,
        turn=unset.copy(),
    )
    for name in Motions.__struct_fields__:
        getattr(motions, name).flags.writeable = False
    return motions


def _lengths(moves: Moves, circular: Ints, arcs: Arcs) -> Array:
    """Return how long moves are (N,) [mm]."""
    out = norm(moves.end - moves.begin)
    if len(circular):
        along = np.einsum("ni,ni->n", moves.end[circular] - moves.begin[circular], arcs.normal)
        out[circular] = np.hypot(norm(moves.begin[circular] - arcs.centre) * arcs.sweep, along)
    return out


def _placed(frames: Array, mm: Array) -> Array:
    """Return points (n, 3) [mm] of program frames, one or (n, 4, 4), in `$BASE` [m]."""
    if len(frames) == 1:
        placed: Array = np.einsum("nj,ij->ni", mm, frames[0, :3, :3] * M_PER_MM) + frames[0, :3, 3]
        return placed
    return np.asarray(np.einsum("nij,nj->ni", frames[:, :3, :3] * M_PER_MM, mm) + frames[:, :3, 3])
