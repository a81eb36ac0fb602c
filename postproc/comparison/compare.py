"""Two programs compared: targets paired, offsets, and what each would cut under the same force.

Both are seen by the robot: a target is where the flange is sent, so that programs with different `$BASE` or `$TOOL` may
command the same. Offsets are those of the nominal program's tool, in its `$BASE`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import forces, kinematics, toolpath
from postproc.cell import Cell
from postproc.chunks import in_chunks
from postproc.comparison.curves import SAME_FRAME, Curves
from postproc.comparison.pairing import Track, partners
from postproc.comparison.result import Comparison, Cuts
from postproc.errors import ForceError, Issue, NotConvergedError, ProgramError, group_issues
from postproc.forces import ForceSource, PathForces
from postproc.frames import MM_PER_M, Array, norm, twist_between
from postproc.kinematics import JointPath, UnreachableError
from postproc.program import CIRC, PTP, SPL, Bools, Ints, Program
from postproc.robot import RobotModel
from postproc.toolpath import Segments
from postproc.under_load import RobotInCell

_BESIDE = 3.0
"""How far from the path a target may stand to be one inserted on it, in offsets of its neighbours."""
_OFF_PATH = 1e-4
"""The same where they have none [m]."""
_MOST_MOVED = 200
"""Targets beside the path that are asked whether they were moved: where there are more, another program is meant."""
_SETTLING, _AHEAD = 4, 1e-3
"""Rounds in which the nearest place of the path is found, and the share of it that its direction is taken over."""
_BEYOND = 5e-6
"""By how much more than the tolerance an arc's middle must be off, more than its ends, to be told [m]."""
_SAME_LENGTH = 1e-5
"""So are places of the axis that carries the robot, and approximation distances [m]."""


def compare(
    nominal: Program, corrected: Program, robot: RobotModel, cell: Cell, source: ForceSource | None = None
) -> Comparison:
    """Compare two programs for one part.

    :param nominal: the program as it should be cut.
    :param corrected: the one to be compared with it.
    :param robot: the robot model.
    :param cell: the cell.
    :param source: forces of the nominal program beside its comments. Without either, the comments of the other program
        hold.
    :raises ProgramError: a target is out of reach.
    :raises ForceError: forces that cannot be given to the motions, or that the arm does not hold.
    """
    place = RobotInCell.of(robot, cell)
    one, other = (_Side.of(program, place) for program in (nominal, corrected))
    told_by_nominal = source is not None or bool(nominal.notes)
    wrench, off = np.zeros((len(one.rows), 6)), np.zeros((len(one.rows), 3))
    if told_by_nominal:
        wrench = one.wrench(place, source, one.rows)
        off = _deviation(place, nominal, one.rows, one.joints[one.rows], wrench)
    # where forces are known, the second program is expected to aim as far past its targets as the tool gives way
    partner = partners(one.track(place, -off), other.track(place, np.zeros((len(other.rows), 3))))
    found = _paired(one, other, partner, place)
    wrench, off = wrench[partner >= 0], off[partner >= 0]
    if not told_by_nominal and corrected.notes:
        wrench = other.wrench(place, None, found.pair[:, 1])
        off = _deviation(place, nominal, found.pair[:, 0], one.joints[found.pair[:, 0]], wrench)
    cuts = _cuts(found, place, other, wrench, off) if told_by_nominal or corrected.notes else None
    if cuts is not None and told_by_nominal:
        cuts = _between(found, cuts, place, one, other, source)
    found = replace(found, cuts=cuts)
    return replace(found, issues=group_issues([*_differences(found), *_astray(found)]))


class _Side(Struct, frozen=True, eq=False):
    """One of the programs in its cell.

    :param path: the geometry of its motions.
    :param rows: (n,) motions with a Cartesian target.
    :param joints: (M, 6) joint angles at the ends of the motions [rad].
    :param branch: (M,) the branch of the inverse kinematics that they are on.
    """

    program: Program
    path: Segments
    rows: Ints
    joints: Array
    branch: Ints

    @classmethod
    def of(cls, program: Program, place: RobotInCell) -> _Side:
        m = program.motions
        path = toolpath.segments(program, place.start_flange)
        ends = _ends(program, place)
        return cls(program, path, np.flatnonzero(np.isnan(m.joints[:, 0])), ends.q, ends.branch)

    def track(self, place: RobotInCell, offset: Array) -> Track:
        """Return the Cartesian targets as they stand in the root, displaced by offsets (n, 3) in their `$BASE` [m]."""
        m, rows = self.program.motions, self.rows
        pose = m.target[rows]
        step = np.where(m.kind[rows] == PTP, norm(pose[:, :3, 3] - self.path.begin[rows]), self.path.length[rows])
        pose[:, :3, 3] += offset
        return Track(toolpath.pose_in_root(self.program, rows, pose, None)[:, :3, 3], step, m.kind[rows] == PTP)

    def wrench(self, place: RobotInCell, source: ForceSource | None, motion: Ints) -> Array:
        """Return the wrenches (n, 6) at the ends of motions, root axes."""
        load = forces.along(self.program, self.path, source, place.spindle, place.ramp)
        wrench = load.at(toolpath.at(self.program, self.path, motion, np.ones(len(motion))))
        return toolpath.wrench_in_root(self.program, motion, wrench)


def _paired(one: _Side, other: _Side, partner: Ints, place: RobotInCell) -> Comparison:
    nominal, corrected, has = one.program, other.program, partner >= 0
    pair = np.stack([one.rows[has], other.rows[partner[has]]], axis=1)
    pose, off = _offsets(one, other, pair, place)
    rest = np.setdiff1d(other.rows, pair[:, 1])
    on_path = _on_path(one, other, pair, norm(off[:, :3]), rest, place)
    if (~on_path).any():
        pair = _moved(one, other, pair, off[:, :3], rest[~on_path], place)
        pose, off = _offsets(one, other, pair, place)
        rest = np.setdiff1d(other.rows, pair[:, 1])
        on_path = _on_path(one, other, pair, norm(off[:, :3]), rest, place)
    curves = Curves.of((nominal, one.path), (corrected, other.path), pair)
    return Comparison(
        nominal=nominal,
        corrected=corrected,
        robot=place.robot.name,
        pair=pair,
        inserted=rest[on_path],
        only_nominal=one.rows[~has],
        only_corrected=rest[~on_path],
        pose=pose,
        rotation=norm(off[:, 3:]),
        curves=curves,
        between=np.full(len(pair), np.nan) if curves is None else curves.apart(),
        cuts=None,
        issues=(),
    )


def _offsets(one: _Side, other: _Side, pair: Ints, place: RobotInCell) -> tuple[Array, Array]:
    """Return where the second program sends the nominal tool (P, 4, 4), nominal `$BASE`, and the twists (P, 6)."""
    flange = toolpath.flange_from_tcp(other.program, pair[:, 1], other.program.motions.target[pair[:, 1]], None)
    pose = toolpath.pose_in_base(one.program, pair[:, 0], flange @ toolpath.tool_of(one.program, pair[:, 0]), None)
    return pose, twist_between(one.program.motions.target[pair[:, 0]], pose)


def _moved(one: _Side, other: _Side, pair: Ints, offset: Array, rows: Ints, place: RobotInCell) -> Ints:
    """Return pairs (P, 2) with targets that were moved in the place of their neighbours.

    A target beside the path (`rows`) next to one that has a partner was moved, and not added, if that other one stands
    on the path as inserted ones do, and its offset is like that of neither neighbouring pair.
    """
    pair, distance = pair.copy(), norm(offset)
    change = np.pad(norm(np.diff(offset, axis=0)), 1, constant_values=np.inf)
    odd = np.minimum(change[:-1], change[1:]) > _OFF_PATH
    index = {int(row): place for place, row in enumerate(other.rows.tolist())}
    for row in rows[:_MOST_MOVED].tolist():
        behind = int(np.searchsorted(pair[:, 1], row))
        for k in (behind, behind - 1):
            if not 0 <= k < len(pair) or not odd[k] or abs(index[int(pair[k, 1])] - index[row]) != 1:
                continue
            released, tried, known = pair[k, 1:], pair.copy(), distance.copy()
            tried[k, 1], known[k] = row, 0.0
            if _on_path(one, other, tried, known, released.copy(), place)[0]:
                pair = tried
                break
    return pair


def _frames(program: Program) -> tuple[tuple[Array, Ints], tuple[Array, Ints]]:
    m = program.motions
    return (program.bases, m.base), (program.tools, m.tool)


def _on_path(one: _Side, other: _Side, pair: Ints, distance: Array, rows: Ints, place: RobotInCell) -> Bools:
    """Return which of the second program's targets without partner, `rows` (r,), stand on the nominal path.

    That is: between two pairs that follow one another in the nominal program too, hardly farther from the nominal path
    than the offsets (P,) there.
    """
    out, most = np.full(len(rows), np.inf), np.zeros(len(rows))
    nominal, kind = one.program, other.program.motions.kind
    behind = np.searchsorted(pair[:, 1], rows)
    between = np.flatnonzero((behind > 0) & (behind < len(pair)) & (kind[rows] != PTP))
    behind = behind[between]
    along = np.cumsum(other.path.length)
    here, first, last = (along[motion] for motion in (rows[between], pair[behind - 1, 1], pair[behind, 1]))
    motion = pair[behind, 0]
    length = np.maximum(one.path.length[motion], 1e-12)
    target = toolpath.at(other.program, other.path, rows[between], np.ones(len(between))).pose
    flange = toolpath.flange_from_tcp(other.program, rows[between], target, None)
    spot = toolpath.pose_in_base(nominal, motion, flange @ toolpath.tool_of(nominal, motion), None)[:, :3, 3]
    aside = np.full(len(spot), np.inf)
    in_proportion = (here - first) / np.maximum(last - first, 1e-12)
    # a detour, where the other program has one, is on one side of it only
    for share in (in_proportion, (here - first) / length, 1.0 - (last - here) / length):
        nearest = toolpath.positions(nominal, one.path, motion, np.clip(share, 1e-9, 1.0))
        aside = np.minimum(aside, norm(spot - nearest))
    allowed = _OFF_PATH + _BESIDE * np.maximum(distance[behind - 1], distance[behind])
    follows = (motion - pair[behind - 1, 0] == 1) & (nominal.motions.kind[motion] != PTP)
    out[between], most[between] = np.where(follows, aside, np.inf), allowed
    return np.asarray(out <= most)


def _astray(found: Comparison) -> Iterator[Issue]:
    """Tell moves of the second program whose ends stand on the nominal path, and that leave it between them.

    Such an arc has an auxiliary point that sends the robot elsewhere, which no target shows.
    """
    if not len(found.pair):
        return
    line = found.corrected.motions.line
    allowed = _OFF_PATH + _BESIDE * np.maximum(found.distance, np.roll(found.distance, 1))
    follows = np.diff(found.pair[:, 0], prepend=-2) == 1
    far = follows & (np.nan_to_num(found.between) > allowed)
    bad = np.flatnonzero(far)
    look = " Look at the auxiliary point of its arc."
    if len(bad):
        worst = bad[np.argmax(found.between[bad])]
        arc = CIRC in found.corrected.motions.kind[found.pair[worst - 1, 1] + 1 : found.pair[worst, 1] + 1]
        message = (
            f"line {found.corrected_line[worst]} of the corrected program: it runs "
            f"{found.between[worst] * MM_PER_M:.4f} mm beside the nominal path before this target." + look * arc
        )
        yield _issue(found, "between", message, worst, len(bad))
    if found.cuts is None:
        return
    row, off = (values[len(found.inserted) :] for values in (found.cuts.row, found.cuts.between_corrected))
    pair = np.searchsorted(found.pair[:, 1], row)
    alone = np.flatnonzero(~far[pair])
    if len(alone):
        worst = alone[np.argmax(off[alone])]
        message = (
            f"line {line[row[worst]]} of the corrected program: under the forces given it leaves "
            f"{off[worst] * MM_PER_M:.4f} mm to the nominal path before this target." + look
        )
        lines = int(found.nominal_line[pair[worst]]), int(line[row[worst]])
        yield Issue("warning", "between", message, *lines, count=len(alone))


def _deviation(
    place: RobotInCell,
    program: Program,
    motion: Ints,
    q: Array,
    wrench: Array,
    carried: tuple[Program, Ints] | None = None,
) -> Array:
    """Return how far the loaded tip stands from the targets of motions (n,) [m], `$BASE`.

    :param q: (n, 6) joint angles that the controller holds [rad].
    :param wrench: (n, 6) at the tip, root axes.
    :param carried: the program and its motions (n,) that say where the robot is carried to; None: these.
    """
    by, rows = (program, motion) if carried is None else carried
    stands = np.zeros((len(motion), 3)) if by.carriage is None else by.carriage.offset(rows)

    def off(motion: Ints, q: Array, wrench: Array, stands: Array) -> tuple[Array]:
        tip = place.tip(q, toolpath.tool_of(program, motion), wrench) + stands
        return (toolpath.points_in_base(program, motion, tip, None) - program.motions.target[motion, :3, 3],)

    try:
        return in_chunks(off, motion, q, wrench, stands)[0]
    except NotConvergedError as cause:
        raise _not_held(program, motion, cause) from None


def _not_held(program: Program, motion: Ints, cause: NotConvergedError) -> ForceError:
    line = int(program.motions.line[motion[cause.rows[0]]])
    problem = f"the arm does not hold this force here: {cause}"
    return ForceError(problem, file=program.documents[0].name, line=line)


def _cuts(found: Comparison, place: RobotInCell, other: _Side, wrench: Array, nominal: Array) -> Cuts:
    """Return what both programs cut at the pairs: wrenches (P, 6) in the root, `nominal` (P, 3) found already."""
    first, two = found.pair.T
    corrected = _deviation(place, found.nominal, first, other.joints[two], wrench, (other.program, two))
    rotation = found.nominal.bases[found.nominal.motions.base[first], :3, :3]
    turned = np.einsum("nji,nkj->nki", rotation, wrench.reshape(-1, 2, 3)).reshape(-1, 6)
    return Cuts(turned, nominal, corrected, np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))


def _between(
    found: Comparison, cuts: Cuts, place: RobotInCell, one: _Side, other: _Side, source: ForceSource | None
) -> Cuts:
    """Return the cuts with what the loaded tip would leave at inserted targets, and on arcs that are sent astray.

    Those are told by their middle, where it is farther from the nominal path than the ends by more than the tolerance.
    """
    load = forces.along(one.program, one.path, source, place.spindle, place.ramp)
    row = found.inserted
    inserted = _left(found, place, one, other, load, (row, np.ones(len(row)), other.joints[row]))
    at_end = np.zeros(len(other.program.motions))
    at_end[found.pair[:, 1]], at_end[row] = norm(cuts.corrected), inserted[1]

    arc, half, q = _middles(found, place, other)
    middle = in_chunks(lambda *places: _left(found, place, one, other, load, places), arc, half, q)
    astray = middle[1] > np.maximum(at_end[arc], at_end[arc - 1]) + place.tolerance + _BEYOND
    nominal, corrected = (np.append(ends, off[astray]) for ends, off in zip(inserted, middle, strict=True))
    return replace(cuts, row=np.append(row, arc[astray]), between_nominal=nominal, between_corrected=corrected)


def _middles(found: Comparison, place: RobotInCell, other: _Side) -> tuple[Ints, Array, Array]:
    """Return the middles of the second program's arcs between pairs that follow one another: motion, t, joint angles.

    Left out are arcs in rapid moves or splines of the nominal program, whose path there is not known.
    """
    m, kind = other.program.motions, found.nominal.motions.kind
    arc = np.flatnonzero(m.kind == CIRC)
    behind = np.searchsorted(found.pair[:, 1], arc)
    arc, behind = arc[(behind > 0) & (behind < len(found.pair))], behind[(behind > 0) & (behind < len(found.pair))]
    motion, before = found.pair[behind, 0], found.pair[behind - 1, 0]
    arc = arc[(motion - before == 1) & ~np.isin(kind[motion], (PTP, SPL)) & ~found.rapid[behind]]
    half = np.full(len(arc), 0.5)

    def joints(arc: Ints, half: Array) -> tuple[Array]:
        pose = toolpath.at(other.program, other.path, arc, half).pose
        flange = toolpath.flange_from_tcp(other.program, arc, pose, half)
        return (kinematics.on_branch(place.robot, flange, other.branch[arc]),)

    q = in_chunks(joints, arc, half)[0]
    reached = np.isfinite(q).all(axis=1)
    return arc[reached], half[reached], q[reached]


def _left(
    found: Comparison, place: RobotInCell, one: _Side, other: _Side, load: PathForces, places: tuple[Ints, Array, Array]
) -> tuple[Array, Array]:
    """Return how far from the nominal path the loaded tip would stand between pairs, by both programs (n,) [m].

    The nominal program stands there nearly as the corrected one does: the same deflection, from the path itself.

    :param load: the forces along the nominal program.
    :param places: motions of the second program (n,), t on them (n,), joint angles there (n, 6) [rad].
    """
    row, t, q = places
    behind = np.searchsorted(found.pair[:, 1], row)
    motion = found.pair[behind, 0]
    program, path = found.nominal, one.path
    tool = toolpath.tool_of(program, motion)
    along = np.cumsum(other.path.length)
    first, last = along[found.pair[behind - 1, 1]], along[found.pair[behind, 1]]
    here_along = along[row] - (1.0 - t) * other.path.length[row]
    share = np.clip((here_along - first) / np.maximum(last - first, 1e-12), 1e-9, 1.0)

    stands = np.zeros((len(row), 3)) if other.program.carriage is None else other.program.carriage.offset(row, t)
    unloaded = toolpath.points_in_base(program, motion, place.tip(q, tool, np.zeros((len(row), 6))) + stands, None)
    for _ in range(_SETTLING):
        wrench = load.at(toolpath.at(program, path, motion, share))
        wrench = toolpath.wrench_in_root(program, motion, wrench)
        try:
            moved = toolpath.points_in_base(program, motion, place.tip(q, tool, wrench) + stands, None)
        except NotConvergedError as cause:
            raise _not_held(program, motion, cause) from None
        step = np.minimum(share + _AHEAD, 1.0), np.maximum(share - _AHEAD, 1e-9)
        here, ahead, back = (toolpath.positions(program, path, motion, at) for at in (share, *step))
        tangent = (ahead - back) / (step[0] - step[1])[:, None]
        long = np.maximum(np.einsum("ni,ni->n", tangent, tangent), 1e-24)
        share = np.clip(share + np.einsum("ni,ni->n", moved - here, tangent) / long, 1e-9, 1.0)
    deflection = moved - unloaded
    across = deflection - (np.einsum("ni,ni->n", deflection, tangent) / long)[:, None] * tangent
    return norm(across), norm(moved - toolpath.positions(program, path, motion, share))


def _ends(program: Program, place: RobotInCell) -> JointPath:
    """Return the joint angles at the ends of the motions."""
    m = program.motions
    ptp = np.flatnonzero(m.kind == PTP)

    def flange(rows: Ints) -> Array:
        return toolpath.flange_from_tcp(program, rows, m.target[rows])

    start = place.cell.start_joints
    try:
        return kinematics.follow(place.robot, flange, start, m.kind == PTP, m.joints[ptp], m.status[ptp], m.turn[ptp])
    except UnreachableError as cause:
        line = int(m.line[cause.rows[0]])
        name, problem = program.documents[0].name, "out of reach (on the branch of [start] joints)"
        raise ProgramError(problem, file=name, line=line) from None


def _differences(found: Comparison) -> Iterator[Issue]:
    """Yield what differs besides positions."""
    one, other = found.nominal.motions, found.corrected.motions
    where = np.flatnonzero(found.speed_differs)
    if len(where):
        was, now = found.speeds[where[0]] * MM_PER_M
        message = f"the speed is {now:.4g} mm/s instead of {was:.4g} mm/s."
        yield _issue(found, "speed", message, where[0], len(where))
    where = np.flatnonzero(found.kind_differs)
    if len(where):
        message = "one program moves point to point (PTP) where the other follows a line or an arc."
        yield _issue(found, "kind", message, where[0], len(where))
    yield from _approximation(found)
    yield from _external_axes(found)
    for name, (frames, used), (others, others_used) in zip(
        ("$BASE", "$TOOL"), _frames(found.nominal), _frames(found.corrected), strict=True
    ):
        apart = np.abs(twist_between(frames[:, None], others[None])).max(axis=2) > SAME_FRAME
        where = np.flatnonzero(apart[used[found.pair[:, 0]], others_used[found.pair[:, 1]]])
        if len(where):
            first = where[0]
            off = twist_between(frames[used[found.pair[first, 0]]], others[others_used[found.pair[first, 1]]])
            message = (
                f"{name} differs, by {norm(off[:3]) * MM_PER_M:.4f} mm and {np.degrees(norm(off[3:])):.4f}°: offsets "
                "are those of the tool as it stands in the robot's root."
            )
            yield _issue(found, name.strip("$").lower(), message, first, len(where))
    for rows, program, name in (
        (found.only_nominal, one, "only-nominal"),
        (found.only_corrected, other, "only-corrected"),
    ):
        if len(rows):
            line = int(program.line[rows[0]])
            if name == "only-nominal":
                message = "a target of the nominal program has no partner."
                yield Issue("warning", name, message, source_line=line, count=len(rows))
            else:
                message = f"line {line} of the corrected program: a target without partner, beside the nominal path."
                yield Issue("warning", name, message, output_line=line, count=len(rows))


def _approximation(found: Comparison) -> Iterator[Issue]:
    """Tell targets that are approximated by another distance; what C_DIS comes of G-code is for the writer to say."""
    if not found.nominal.keeps_text:
        return
    was, now = (p.motions.blend[rows] for p, rows in zip((found.nominal, found.corrected), found.pair.T, strict=True))
    where = np.flatnonzero(np.abs(now - was) > _SAME_LENGTH)
    if len(where):
        told = (f"{value * MM_PER_M:.4g} mm" if value > 0.0 else "none" for value in (now[where[0]], was[where[0]]))
        message = f"the approximation before the target ($APO.CDIS, C_DIS) is {' instead of '.join(told)}."
        yield _issue(found, "approximation", message, where[0], len(where))


def _external_axes(found: Comparison) -> Iterator[Issue]:
    """Tell where external axes stand elsewhere; of pairs, where the axis that carries the robot does."""
    one, other = found.nominal.carriage, found.corrected.carriage
    if one is not None and other is not None:
        was, now = (axis.at(rows) for axis, rows in ((one, found.pair[:, 0]), (other, found.pair[:, 1])))
        where = np.flatnonzero(np.abs(now - was) > _SAME_LENGTH)
        if len(where):
            values = " mm instead of ".join(f"{value[where[0]] * MM_PER_M:.4f}" for value in (now, was))
            message = f"E1 is at {values} mm: the robot stands elsewhere, and gives way otherwise, for the same path."
            yield _issue(found, "external-axis", message, where[0], len(where))
    elif (one is None) != (other is None) and found.nominal.keeps_text:
        name = (found.nominal if other is None else found.corrected).documents[0].name
        message = f"E1, which carries the robot, has values in {name} only."
        yield Issue("warning", "external-axis", message, count=len(found.pair))
    standing = [
        {issue.subject: issue for issue in program.issues if issue.kind == "external-axis"}
        for program in (found.nominal, found.corrected)
    ]
    for axis in sorted({*standing[0], *standing[1]}):
        told = [each[axis].message.partition(":")[0] if axis in each else f"{axis} at 0 or unsaid" for each in standing]
        if told[0] != told[1]:
            line = next(each[axis].source_line for each in standing if axis in each)
            message = f"{told[1]} in the corrected program, {told[0]} in the nominal one."
            yield Issue("warning", "external-axis", message, line if axis in standing[0] else None, subject=axis)


def _issue(found: Comparison, kind: str, message: str, pair: int, count: int) -> Issue:
    lines = int(found.nominal_line[pair]), int(found.corrected_line[pair])
    return Issue("warning", kind, message, *lines, count=count)
