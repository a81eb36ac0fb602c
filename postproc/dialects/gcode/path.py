"""From columns of words to motions: modal values carried forward over all lines at once.

Rows are lines of the program. Lengths are mm in the program frame until the last step.

Where the tool stands before the program is no part of it: no coordinate is taken from there. Rapid moves are held back
until X, Y and Z have all been programmed; then one motion goes to all three, on the line that gave the last of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from postproc.dialects.gcode import codes
from postproc.dialects.gcode.arcs import SAME_MM, ArcFault, ArcWords, read_arcs
from postproc.dialects.gcode.blocks import Fault
from postproc.dialects.gcode.modes import MM_PER_UNIT, Modes
from postproc.errors import MOST
from postproc.frames import M_PER_MM, Array, inverse
from postproc.program import CIRC, LIN, PTP, Bools, Ints, Motions

_S_PER_MIN = 60.0


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """What the cell says about a program.

    :param start: (4, 4) pose of the tool frame in `$BASE` when the program starts [m].
    :param tool: (3, 3) orientation of the tool frame in the program frame.
    :param offsets: code of a work offset (54.0 …) → (4, 4) pose of the program frame in `$BASE` [m].
    :param rapid: speed of G0 [m/s].
    :param approximation: approximation distance [m].
    :param rounding: what approximation may round corners by [m], unless the program says it (G64 P).
    """

    start: Array
    tool: Array
    offsets: Mapping[float, Array]
    rapid: float
    approximation: float
    rounding: float


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """The motions of a program, and what was noticed.

    :param motions: see `Motions`; their lines are rows + 1.
    :param row: (M,) row that makes each motion, never decreasing.
    :param still: (n,) rows of moves that are not in `motions`, ascending: they go nowhere, or are held back.
    :param held_back: (n,) those of them that are rapid moves before X, Y and Z have all been programmed.
    """

    motions: Motions
    row: Ints
    still: Ints
    held_back: Ints


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Words and modal state of each line, lengths in mm: XYZ, IJK (L, 3); all else (L,)."""

    xyz: Array
    ijk: Array
    radius: Array
    turns: Array
    motion: Array
    named: Bools
    feed: Array
    plane: Array
    units: Array
    incremental: Bools
    absolute_centre: Bools
    offset: Array
    moving: Bools


def held(values: Array, initial: float) -> Array:
    """Carry the last value forward over NaN; `initial` holds before the first. (L,) → (L,)."""
    last = np.maximum.accumulate(np.where(np.isnan(values), 0, np.arange(1, len(values) + 1)))
    carried: Array = np.concatenate([[initial], values])[last]
    return carried


def in_force(changes: Sequence[tuple[int, float]], initial: float, rows: int) -> Array:
    """Return the value (rows,) in force in each line, of changes (row, value) in order of their rows."""
    at = [0, *(row for row, _ in changes if row < rows), rows]
    values = [initial, *(value for row, value in changes if row < rows)]
    return np.repeat(np.array(values, dtype=float), np.diff(at))


def read_path(columns: Mapping[str, Array], modes: Modes, setting: Setting) -> Path | list[Fault]:
    """Return the motions of a program, or the reasons why it cannot be read, in order of lines.

    :param columns: words of all lines, see `postproc.dialects.gcode.words.read_plain`.
    :param modes: the other blocks.
    :param setting: what the cell says.
    """
    rows = _rows(columns, modes)
    before, after = _positions(rows, setting)
    complete = _complete_from(rows)
    moving = np.flatnonzero(rows.moving)
    held_back, move = moving[moving < complete], moving[moving >= complete]
    circular = moving[rows.motion[moving] >= 2.0]
    arcs = read_arcs(
        ArcWords(
            start=before[circular],
            end=after[circular],
            given=~np.isnan(rows.xyz[circular]),
            offset=rows.ijk[circular],
            radius=rows.radius[circular],
            turns=rows.turns[circular],
            clockwise=rows.motion[circular] == 2.0,
            plane=rows.plane[circular],
            units=rows.units[circular],
            absolute=rows.absolute_centre[circular],
        )
    )
    faults = _faults(rows, complete, modes, circular, arcs.faults)
    if faults:
        return faults

    distance = np.linalg.norm(after[move] - before[move], axis=1)
    stays = (distance <= SAME_MM) & (rows.motion[move] < 2.0)
    stays[:1] &= rows.motion[move[:1]] != 0.0  # the first rapid move turns the tool to the program's orientation
    kept = move[~stays]
    rapid = rows.motion[kept] == 0.0
    kind = np.where(rapid, LIN, np.where(rows.motion[kept] == 1.0, LIN, CIRC))
    kind[:1] = np.where(rapid[:1], PTP, kind[:1])
    nothing = np.broadcast_to(np.nan, (len(kept), 6))  # takes no memory
    centre, normal, sweep = nothing[:, :3], nothing[:, :3], nothing[:, 0]
    if len(circular):
        centre, normal, sweep = centre.copy(), normal.copy(), sweep.copy()
    target = np.zeros((len(kept), 4, 4))
    target[:, 3, 3] = 1.0
    is_arc = kind == CIRC
    for code in sorted(set(rows.offset[kept].tolist())):
        pose = setting.offsets[code]
        here, there = rows.offset[kept] == code, rows.offset[circular] == code
        target[here, :3, :3] = pose[:3, :3] @ setting.tool
        target[here, :3, 3] = _placed(pose, after[kept[here]])
        if len(circular):
            centre[here & is_arc] = _placed(pose, arcs.centre[there])
            normal[here & is_arc] = arcs.normal[there] @ pose[:3, :3].T
            sweep[here & is_arc] = arcs.sweep[there]
    feed = np.where(rapid, setting.rapid, rows.feed[kept] * (M_PER_MM / _S_PER_MIN))
    feed[kind == PTP] = np.nan
    blend = in_force(modes.blends, setting.approximation, modes.rows)[kept]
    limit = in_force(modes.roundings, np.nan, modes.rows)[kept]
    unset = np.full(len(kept), -1)
    motions = Motions(
        kind=kind.astype(np.int64),
        rapid=rapid,
        line=kept + 1,
        target=target,
        joints=nothing,
        centre=centre,
        normal=normal,
        sweep=sweep,
        feed=feed,
        base=np.zeros(len(kept), dtype=np.int64),
        tool=np.zeros(len(kept), dtype=np.int64),
        blend=blend,
        rounding=np.where(np.isnan(limit), setting.rounding, limit),
        status=unset,
        turn=unset.copy(),
    )
    for name in Motions.__slots__:
        getattr(motions, name).flags.writeable = False
    return Path(motions, kept, np.concatenate([held_back, move[stays]]), held_back)


def _placed(pose: Array, mm: Array) -> Array:
    placed: Array = np.einsum("...j,ij->...i", mm, pose[:3, :3] * M_PER_MM) + pose[:3, 3]
    return placed


def _rows(columns: Mapping[str, Array], modes: Modes) -> _Rows:
    count = modes.rows
    state = {group: in_force(modes.changes[group], valid[0], count) for group, valid in codes.GROUPS.items()}
    factor = np.where(state["units"] == 20.0, MM_PER_UNIT[20.0], MM_PER_UNIT[21.0])
    mm = {letter: columns[letter][:count] * factor for letter in "XYZIJKRF"}
    xyz, ijk = np.stack([mm[a] for a in "XYZ"], axis=1), np.stack([mm[a] for a in "IJK"], axis=1)
    code = columns["G"][:count]
    motion = held(code, codes.CANCEL_CYCLE)
    circular = (motion == 2.0) | (motion == 3.0)
    named = ~np.isnan(code) & (code != codes.CANCEL_CYCLE)
    moving = ~np.isnan(xyz).all(axis=1) | (circular & (named | ~np.isnan(ijk).all(axis=1)))
    return _Rows(
        xyz=xyz,
        ijk=ijk,
        radius=mm["R"],
        turns=columns["P"][:count],
        motion=motion,
        named=named,
        feed=held(mm["F"], 0.0),
        plane=state["plane"],
        units=state["units"],
        incremental=state["distance"] == 91.0,
        absolute_centre=state["centre"] == 90.1,
        offset=state["offset"],
        moving=moving,
    )


def _positions(rows: _Rows, setting: Setting) -> tuple[Array, Array]:
    """Return where each line begins and ends, (L, 3) each, in the program frame of its work offset [mm].

    Within a run of lines of one work offset and one distance mode: the last coordinate holds (G90), or they add up in
    order (G91), as a control does it.
    """
    before, after = np.empty_like(rows.xyz), np.empty_like(rows.xyz)
    changed = (np.diff(rows.offset) != 0.0) | (rows.incremental[1:] != rows.incremental[:-1])
    bounds = [0, *(np.flatnonzero(changed) + 1).tolist(), len(rows.xyz)]
    frame = np.eye(4)
    position = setting.start[:3, 3] / M_PER_MM
    in_force_now: float | None = None
    for begin, end in pairwise(bounds):
        if rows.offset[begin] != in_force_now:
            in_force_now = float(rows.offset[begin])
            new = setting.offsets[in_force_now]
            position = _placed(inverse(new) @ frame, position) / M_PER_MM
            frame = new
        for axis in range(3):
            words = rows.xyz[begin:end, axis]
            if rows.incremental[begin]:
                steps = np.concatenate([position[axis : axis + 1], np.where(np.isnan(words), 0.0, words)])
                after[begin:end, axis] = np.cumsum(steps)[1:]
            else:
                after[begin:end, axis] = held(words, position[axis])
        before[begin] = position
        before[begin + 1 : end] = after[begin : end - 1]
        position = after[end - 1]
    return before, after


def _complete_from(rows: _Rows) -> int:
    """Return the first row at whose end X, Y and Z have all been programmed (number of rows: never)."""
    given = ~np.isnan(rows.xyz)
    first = np.where(given.any(axis=0), given.argmax(axis=0), len(given))
    return int(first.max())


def _faults(rows: _Rows, complete: int, modes: Modes, circular_rows: Ints, arcs: Sequence[ArcFault]) -> list[Fault]:
    """Return what is wrong, in order of lines, one fault for each line.

    After a block that could not be read, nothing is said that may only be wrong because of it.
    """
    doubt = _Doubt(rows, modes.faults)
    faults = {fault.row: fault for fault in modes.faults}

    def check(wrong: Bools, problem: str, advice: str | None = None, *, first: bool = False) -> None:
        for row in np.flatnonzero(wrong)[: 1 if first else MOST + 1].tolist():
            faults.setdefault(row, Fault(row, problem, advice))

    count = len(rows.motion)
    line = np.arange(count)
    axes = ~np.isnan(rows.xyz).all(axis=1)
    straight, circular = rows.motion == 1.0, (rows.motion == 2.0) | (rows.motion == 3.0)
    dwelling = np.zeros(count, dtype=bool)
    dwelling[[row for row in modes.dwells if row < count]] = True
    cancelled = axes & (rows.motion == codes.CANCEL_CYCLE) & ~doubt.motion
    check(cancelled, "coordinates without G0, G1, G2 or G3", "Say which motion it is.", first=True)
    stray = ~(np.isnan(rows.ijk).all(axis=1) & np.isnan(rows.radius) & np.isnan(rows.turns))
    check(stray & ~(rows.moving & circular) & ~doubt.motion, "I, J, K, R or P without an arc that uses it")
    check(dwelling & rows.moving & circular, "G4 in one block with an arc", "Write one block for each.")
    no_feed = (rows.named | rows.moving) & (straight | circular) & ~(rows.feed > 0.0) & ~doubt.motion & ~doubt.feed
    check(no_feed, "cutting move without a feed", "Give F.", first=True)
    advice = "Program X, Y and Z in rapid moves (G0, in G90) first: the tool may stand anywhere before."
    early = axes & (line <= complete) & ~doubt.position
    problem = "incremental move before the position is known"
    check(early & rows.incremental, problem, advice, first=True)
    begin = int(np.argmax(axes))
    cutting = early & straight & (begin < complete) & ~doubt.motion  # a first one with X, Y and Z needs nothing before
    check(cutting, "cutting move before the position is known", advice, first=True)
    turning = rows.moving & circular & (line <= complete) & ~doubt.motion & ~doubt.position
    check(turning, "arc before the position is known", advice, first=True)
    elsewhere = early & (rows.offset != rows.offset[begin])
    check(elsewhere, "change of the work offset before the position is known", advice, first=True)
    for fault in arcs:
        row = int(circular_rows[fault.n])
        if not (doubt.motion[row] or (fault.placed and doubt.position[row])):
            faults.setdefault(row, Fault(row, fault.problem, fault.advice))
    return [faults[row] for row in sorted(faults)]


class _Doubt:
    """Where blocks that could not be read leave open what holds; each (L,), True from such a block on.

    :ivar motion: which of G0…G3, until it is named again.
    :ivar position: where the tool stands, until X, Y and Z are given again.
    :ivar feed: whether there is one.
    """

    def __init__(self, rows: _Rows, faults: Sequence[Fault]) -> None:
        count = len(rows.motion)
        line = np.arange(count)

        def latest(at: Array | Bools) -> Ints:
            return np.asarray(np.maximum.accumulate(np.where(at, line, -1)), dtype=np.int64)

        def lost(letters: str) -> Ints:
            at = np.zeros(count, dtype=bool)
            at[[fault.row for fault in faults if set(letters) & set(fault.lost)]] = True
            return latest(at)

        given = [latest(~np.isnan(rows.xyz[:, axis]) & ~rows.incremental) for axis in range(3)]
        before = np.minimum.reduce(given)
        before = (
            np.concatenate([[-1], before[:-1]]) if count else before
        )  # the line itself needs to know where it starts
        self.motion = (lost("G") >= 0) & (latest(rows.named) <= lost("G"))
        self.position = (lost("GXYZIJK") >= 0) & (before <= lost("GXYZIJK"))
        self.feed = lost("F") >= 0
