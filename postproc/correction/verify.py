"""The written program is read back by our own reader and simulated with the numbers as printed.

Nothing of the computation that made the program is trusted here but the branch of the inverse kinematics: poses come
from the text, joint angles from these poses by the nominal geometry, the tip from the loaded equilibrium.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from postproc import elastostatics, kinematics, toolpath
from postproc.chunks import in_chunks
from postproc.correction import blending, checks
from postproc.correction.root import InRoot
from postproc.dialects import registry
from postproc.errors import Issue, NotConvergedError, ProgramError
from postproc.forces import BEHIND_STEP, PathForces
from postproc.frames import MM_PER_M, Array, largest, norm, twist_between
from postproc.program import CIRC, PTP, Bools, Ints, Motions, Program, Targets, Written
from postproc.toolpath import Segments

_PRINTED = 1e-6
"""What printing may move a commanded pose by [m, rad]; the text has at least 1e-4 mm and 1e-5°."""
_HELD = 1e-6
"""How far from nominal the tip may stand at a target of a corrected program [m], rounding included."""
_SAFE = 0.8
"""Of the tolerance, what the places looked at may use up: it may be a little more between them."""
_LONG = 0.005
"""Runs longer than this [m] are looked at between their ends; on shorter ones the deflection is a straight line."""
_SPACING = 0.010
_TURNED = 0.02
_STEEP = 2e-4
"""Change of the correction over a run [m] from which on it is looked at between its ends."""
_UNEVEN = 0.2
"""Of the tolerance, by how much the written path may be displaced unevenly along a piece of an arc before it is looked
at there as often as on such runs; else at its middle and end."""
_AT_ONCE = 1e-6
"""Length of a piece [m] on which a force that changes jumps: it is divided no more."""
_ON_RAMPS = 4
"""Places looked at on such runs."""


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """What the written program would do.

    :param deviation: (K, 3) predicted tip minus nominal position at each target, `$BASE` [m].
    :param between: largest distance from the nominal path anywhere looked at [m].
    :param printed: (K, 6) X, Y, Z, A, B, C as they stand in the text [mm, deg].
    :param rounding: (K,) how far approximate positioning passes each target [m].
    :param missed: motion (n,), t (n,) and distance (n,) [m] of places where the path uses up too much of the
        tolerance, and more targets may help.
    :param written: the program as read back, its geometry, and the motion (K,) of each target; None if it cannot be
        used.
    :param issues: why the program must not be released (level error), or what to look at.
    """

    deviation: Array
    between: float
    printed: Array
    rounding: Array
    missed: tuple[Ints, Array, Array]
    written: tuple[Program, Segments, Ints] | None
    issues: tuple[Issue, ...]


def simulate(
    program: Program,
    path: Segments,
    load: PathForces,
    targets: Targets,
    ends: Array,
    text: Written,
    place: InRoot,
    sample: Ints,
    theta: Array,
    branch: Ints,
    *,
    corrected: bool,
) -> Simulated:
    """Read a written program back and simulate it against the nominal path of the program it was made from.

    :param program: the nominal program, `path` and `load` its geometry and forces.
    :param targets: what was to be written (K rows).
    :param ends: (K, 3) their nominal positions, `$BASE` [m].
    :param text: the program as written.
    :param place: robot, cell and start.
    :param sample: (K,) which of the N samples of the path each target is.
    :param theta: (N, nv) deflections of the springs as computed: where the search for those of the text begins.
    :param branch: (N,) branch of the inverse kinematics of each.
    :param corrected: the program claims to hold the tolerance.
    """
    try:
        written = registry.by_name(text.dialect).read(text.documents, place.cell, place.forward, program.name)
    except ProgramError as cause:
        message = (
            f"the written program cannot be read back ({cause.problem}: {cause.text or ''!r}). If this is a line of "
            f"[gcode] in the cell, write it there in {text.dialect}; else it is a fault of postproc, please report it."
        )
        return _unusable(targets, Issue("error", "read-back", message, output_line=cause.line))
    m = written.motions
    row = np.flatnonzero(np.isnan(m.joints[:, 0]))
    mismatch = _mismatch(program, targets, written, row)
    if mismatch is not None:
        return _unusable(targets, mismatch)
    printed = written.numbers_as_written()[row]
    written = replace(written, documents=(), layout=None)  # the text is done with: its places fill much memory
    written_path = toolpath.segments(written, place.start_flange)
    correction = targets.pose[:, :3, 3] - ends
    changed = norm(np.diff(correction, axis=0, prepend=correction[:1]))
    begin = np.where(np.concatenate([[True], np.diff(targets.motion) != 0]), 0.0, np.roll(targets.t, 1))
    curved = np.flatnonzero((program.motions.kind[targets.motion] == CIRC) | (m.kind[row] == CIRC))

    def unevenness(of: Ints, begin: Array, end: Array, on: Ints, correction: Array) -> tuple[Array]:
        quarters = (
            toolpath.positions(written, written_path, on, np.full(len(on), share))
            - toolpath.positions(program, path, of, begin + share * (end - begin))
            for share in (0.25, 0.75)
        )
        one, other = (norm(displaced - correction) for displaced in quarters)
        return (np.maximum(one, other),)

    uneven = np.zeros(len(targets))
    (uneven[curved],) = in_chunks(
        unevenness, targets.motion[curved], begin[curved], targets.t[curved], row[curved], correction[curved]
    )
    steep = (changed > _STEEP) | (uneven > _UNEVEN * place.tolerance)
    index, share = _probes(m, row, written_path, curved, steep)
    t = begin[index] + share * (targets.t - begin)[index]
    t = np.where(share == 1.0, targets.t[index], t)
    motion, on = targets.motion[index], row[index]

    def simulated(motion: Ints, t: Array, on: Ints, share: Array, sample: Ints) -> tuple[Array]:
        nominal = toolpath.at(program, path, motion, t)
        wrench = load.at(nominal)
        commanded = toolpath.at(written, written_path, on, share).pose
        q = kinematics.on_branch(place.robot, toolpath.flange_from_tcp(written, on, commanded), branch[sample])
        if np.isnan(q).any():
            raise NotConvergedError("a commanded pose is out of reach", np.flatnonzero(np.isnan(q).any(axis=1)))
        force, tool = place.wrench(written, on, wrench), kinematics.components(place.tool(written, on))
        x = elastostatics.spread(place.robot, q.T)
        tip = elastostatics.solve_equilibrium(place.robot, x, tool, force.T, theta[sample].T).tip.T
        return (place.points_back(written, on, tip) - nominal.pose[:, :3, 3],)

    try:
        (off,) = in_chunks(simulated, motion, t, on, share, sample[index])
    except NotConvergedError as cause:
        line = int(program.motions.line[motion[cause.rows[0]]])
        issue = Issue("error", "read-back", f"the written program cannot be simulated: {cause}", source_line=line)
        return _unusable(targets, issue)
    distance = norm(off)
    after = distance[share == 1.0]
    rounding = blending.of_motions(written, written_path, row).rounding(m.blend[row])
    settled = (share == 1.0) | ~_starts_uncorrected(program, place)[motion]
    step = load.behind_step(motion, targets.t[index]) & (share < 1.0)
    settled &= ~step
    jump = (path.length[motion] * (targets.t - begin)[index] < _AT_ONCE) & (share < 1.0)
    issues: list[Issue] = []
    if corrected:
        issues += _steps(program, place, motion[step], distance[step])
        issues += _not_held(program, place, targets, after, motion, distance, settled, jump)
        if program.keeps_text:
            more = rounding - blending.programmed(program, path, targets.motion)
            issues += checks.blending(program, targets.motion, more, place.tolerance)
    bad = settled & (share < 1.0) & ~(distance <= _SAFE * place.tolerance) & ~jump
    between = float(distance[settled].max(initial=0.0))
    return Simulated(
        off[share == 1.0],
        between,
        printed,
        rounding,
        (motion[bad], t[bad], distance[bad]),
        (written, written_path, row),
        tuple(issues),
    )


def _unusable(targets: Targets, issue: Issue) -> Simulated:
    count = len(targets)
    nowhere = np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0)
    unknown = np.full(count, np.nan)
    return Simulated(np.full((count, 3), np.nan), np.inf, np.full((count, 6), np.nan), unknown, nowhere, None, (issue,))


def _mismatch(program: Program, targets: Targets, written: Program, row: Ints) -> Issue | None:
    """Return an issue if the text does not say what it was to say."""
    m, nominal = written.motions, program.motions
    if len(row) != len(targets):
        return Issue("error", "read-back", f"the written program has {len(row)} targets instead of {len(targets)}")

    def apart(row: Ints, pose: Array) -> tuple[Array]:
        return (largest(twist_between(m.target[row], pose)),)

    wrong = (m.kind[row] != targets.kind) | (in_chunks(apart, row, targets.pose)[0] > _PRINTED)
    for frames, other, used, wanted in (
        (written.bases, program.bases, m.base[row], nominal.base[targets.motion]),
        (written.tools, program.tools, m.tool[row], nominal.tool[targets.motion]),
    ):
        differ = np.abs(twist_between(frames[:, None], other[None])).max(axis=2) > _PRINTED
        wrong |= differ[used, wanted]
    if wrong.any():
        first = int(np.argmax(wrong))
        line = int(program.motions.line[targets.motion[first]])
        return Issue(
            "error",
            "read-back",
            "the written program reads differently from what was computed: a fault of postproc, please report it",
            source_line=line,
            count=int(wrong.sum()),
        )
    return None


def _probes(m: Motions, row: Ints, path: Segments, curved: Ints, steep: Bools) -> tuple[Ints, Array]:
    """Return where to look: target index (n,) and share (n,) in (0, 1] of the run that ends at that target.

    A short straight run of a straight move is followed by the deflection in proportion: its end is enough. Runs that
    are long or turn, and pieces of arcs, are looked at between.

    :param curved: targets on arcs.
    :param steep: (K,) where the correction changes so much over the run that it needs a closer look.
    """
    length, turn = path.length[row], path.turn[row]
    number = np.ones(len(row), dtype=np.int64)
    number[curved] = 2
    wide = (length > _LONG) | (turn > _TURNED)
    number[wide] = np.maximum(2, np.ceil(np.maximum(length[wide] / _SPACING, turn[wide] / _TURNED))).astype(np.int64)
    number[steep] = np.maximum(number[steep], _ON_RAMPS)
    number[m.kind[row] == PTP] = 1
    index = np.repeat(np.arange(len(row)), number)
    inside = np.arange(len(index)) - np.repeat(np.cumsum(number) - number, number) + 1
    return index, inside / number[index]


def _starts_uncorrected(program: Program, place: InRoot) -> Bools:
    """(M,) True for motions that start where no correction was possible: at the start, or at an axis target."""
    axis = np.isfinite(program.motions.joints[:, 0])
    out = np.concatenate([[True], axis[:-1]])
    return np.asarray(out & (not place.rest_is_nominal))


def _steps(program: Program, place: InRoot, motion: Ints, distance: Array) -> Iterator[Issue]:
    """Tell where the force begins with a step: distances (n,) [m] from the path just behind it, on motions (n,)."""
    felt = ~(distance <= place.tolerance)
    if felt.any():
        yield Issue(
            "warning",
            "force-step",
            "the force of this move begins with a step from that at the end of the move before: there the tool leaves "
            f"its path by up to {np.nanmax(distance[felt]) * MM_PER_M:.4f} mm for the {BEHIND_STEP * MM_PER_M:g} mm "
            "over which the correction follows. Let the move begin (t = 0) with the force with which the one before "
            "ends; or give one force without t: it comes up over force_ramp_mm.",
            source_line=int(program.motions.line[motion[int(np.argmax(felt))]]),
            count=len(np.unique(motion[felt])),
        )


def _not_held(
    program: Program,
    place: InRoot,
    targets: Targets,
    after: Array,
    motion: Ints,
    distance: Array,
    settled: Bools,
    jump: Bools,
) -> Iterator[Issue]:
    between = settled & ~(distance <= place.tolerance)
    if (between & jump).any():
        yield Issue(
            "error",
            "force-jump",
            "the force jumps within this move, as one in FEED axes does where the travel passes the direction of the "
            f"spindle: it leaves {np.nanmax(distance[between & jump]) * MM_PER_M:.4f} mm (allowed "
            f"{place.tolerance * MM_PER_M:g} mm), however close the targets. Divide the move there and give each part "
            "its force, or give the force in BASE or TOOL axes.",
            source_line=int(program.motions.line[motion[int(np.argmax(between & jump))]]),
            count=len(np.unique(motion[between & jump])),
        )
    for bad, limit, rows, what in (
        (~(after <= _HELD), _HELD, targets.motion, "at a target"),
        (between & ~jump, place.tolerance, motion, "between targets"),
    ):
        if bad.any():
            values = after if rows is targets.motion else distance
            yield Issue(
                "error",
                "tolerance",
                f"simulating the written program leaves {np.nanmax(values[bad]) * MM_PER_M:.4f} mm {what} "
                f"(allowed {limit * MM_PER_M:g} mm)",
                source_line=int(program.motions.line[rows[int(np.argmax(bad))]]),
                count=int(bad.sum()),
            )
