"""Collisions along the path of a program: of arm, tool and obstacles, and of bodies that do not cut with the stock.

The stock before a motion contains all material that is there while the motion runs, and the stock before a group of
motions all that is there during any of them. So a path is compared with the stock at its beginning, and divided only
where that is not enough. The cylinders of the tool were compared while the stock was swept, on motions along which the
tool does not turn; here they are compared on the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import collision, toolpath
from postproc.collision import Body, Hits, Scene, Solids
from postproc.correction.runs import Run, previous_samples, runs
from postproc.errors import Issue
from postproc.forces import StockInTime
from postproc.frames import M_PER_MM, MM_PER_M, Array, norm
from postproc.kinematics import UnreachableError
from postproc.placement.samples import SPINDLE_AXES
from postproc.program import PTP, Bools, Ints, Motions, Program
from postproc.toolpath import Toolpath
from postproc.under_load import ImpossiblePathError, PathUnderLoad, unreachable

_AXIS_SHARE = 1e-4
"""Steps whose cosine of the angle to the tool axis is less than 1 by this at most are along it (assumed)."""
_NO_REDUCTION = 1e-6
"""Motions of bodies by the correction that are smaller [m] are not mentioned (assumed)."""
_SAGITTA = 0.01e-3
"""Arcs are compared by chords that are off by this [m] at most: far below what clearances are asked for (assumed)."""
_ROUNDING = 1e-9
"""An arc whose number of parts exceeds a whole number by less than this has no further part: it is rounding."""
_SMALLEST_MESH = 12e-3
"""Meshes of obstacles and holders whose largest edge is shorter [m] are questioned (assumed): a clamp of 300 mm is so
in inch, a part of 12 m in metres."""
STOCK = "stock"
"""Name of the stock in messages, next to the names of bodies."""
MOST_STOCKS = 200
"""Largest number of stocks that one group of bodies is compared with; pairs undecided by then count as too close
(assumed)."""


class SmallestClearance(Struct, frozen=True, eq=False):
    """The smallest distance of two bodies along a path.

    :param distance: [m]; 0 where they touch; infinite if there is nothing to compare.
    :param bodies: their names.
    :param line: of the motion on which it is reached.
    :param scene: the bodies.
    :param remarks: assumptions, one sentence each.
    """

    distance: float
    bodies: tuple[str, str]
    line: int
    scene: collision.Scene
    remarks: tuple[str, ...] = ()


def path_clearance(path: PathUnderLoad, commanded_q: Array) -> tuple[SmallestClearance | None, list[Issue]]:
    """Return the smallest clearance of arm, tool and obstacles, and an error for each two bodies that come too close.

    Under the cutting forces a corrected arm is on the nominal path, without them on the commanded one. Distances are
    those of the nominal path, from the start of the program on, less the largest motion of each body by the correction:
    a bound for both paths, and for all poses between them.

    :param commanded_q: (N, 6) commanded joint angles at the samples [rad].
    :returns: None if the cell has no [collision].
    :raises CellError: a body cannot be read.
    :raises ImpossiblePathError: an arc leaves the reach of the robot between two samples.
    """
    robot_in_cell, program, stock = path.robot_in_cell, path.program, path.motions.forces.stock
    table = robot_in_cell.cell.collision
    if table is None:
        return None, []
    least_distance = table.clearance_mm * M_PER_MM
    sample, nominal_q, commanded_q = _refine_arcs(path, commanded_q)
    scenes: dict[int, Scene] = {}  # by tool
    smallest: SmallestClearance | None = None
    largest_decrease = 0.0
    close_bodies = _CloseBodies(program.motions, stock)
    for run in runs(program, sample.motion, nominal_q):
        if run.tool not in scenes:
            scenes[run.tool] = collision.Scene.of(robot_in_cell.robot, robot_in_cell.cell, program.tools[run.tool])
        scene = scenes[run.tool]
        states = _states_of_run(path, sample, nominal_q, commanded_q, run)
        hits = collision.path_hits(scene, states.q, least_distance, states.shift, states.commanded_q)
        largest_decrease = max(largest_decrease, hits.largest_decrease)
        clearance = _clearance_of_run(program, scene, states, hits, stock)
        if smallest is None or clearance.distance < smallest.distance:
            smallest = clearance
        first_motion = int(states.motion[0])
        begins_at_start = run.previous < 0 and program.motions.kind[first_motion] == PTP
        # bodies that are too close at the end of the first move too are not so by the choice of [start]
        arrival_pairs = _close_pairs(scene, states.arrival(), stock, least_distance) if begins_at_start else set()
        rapid = program.motions.rapid[states.motion] & ~_retracts(path, sample, run)
        for contact in _contacts(scene, states, hits, rapid, stock, least_distance):
            is_first_move = begins_at_start and contact.motion == first_motion
            close_bodies.add(contact, is_only_on_first_move=is_first_move and contact.names not in arrival_pairs)
    if smallest is None:
        return None, close_bodies.issues()
    remarks = (*smallest.remarks, *_correction_sentence(largest_decrease))
    return replace(smallest, remarks=remarks), [*close_bodies.issues(), *_mesh_questions(smallest.scene)]


def _states_of_run(path: PathUnderLoad, sample: Toolpath, nominal_q: Array, commanded_q: Array, run: Run) -> States:
    """Return the states of the robot at the samples of a run, and before them.

    A run: samples that the robot reaches one after another with one tool.

    :param sample: N samples of the path.
    :param nominal_q: (N, 6) joint angles of the nominal path at the samples [rad].
    :param commanded_q: (N, 6) commanded joint angles there [rad].
    """
    previous_row = slice(run.previous, run.previous + 1)
    begins_at_start = run.previous < 0  # where the program starts
    start = path.robot_in_cell.cell.start_joints[None]
    start_q, start_commanded_q = (
        (start, start) if begins_at_start else (nominal_q[previous_row], commanded_q[previous_row])
    )
    q = np.concatenate([start_q, nominal_q[run.rows]])
    corrected_q = np.concatenate([start_commanded_q, commanded_q[run.rows]])
    is_corrected = not np.array_equal(q, corrected_q)
    return States(
        sample.motion[run.rows], q, corrected_q if is_corrected else None, _e1_displacements(path, sample, run)
    )


def _clearance_of_run(
    program: Program, scene: Scene, states: States, hits: Hits, stock: StockInTime | None
) -> SmallestClearance:
    """Return the smallest clearance of a run: that of its closest two bodies, infinite without bodies to compare.

    :param hits: where bodies come close on the run, and the closest two.
    :param stock: the stock at each move, for the remarks; None: the stock is not known.
    """
    closest_bodies = hits.closest
    remarks = (*scene.remarks, *_stock_sentences(scene, stock))
    if closest_bodies is None:
        return SmallestClearance(np.inf, ("", ""), int(program.motions.line[states.motion[0]]), scene, remarks)
    names = _names(scene.bodies, closest_bodies.first, closest_bodies.second)
    line = int(program.motions.line[states.motion_to(closest_bodies.row)])
    return SmallestClearance(closest_bodies.distance, names, line, scene, remarks)


def _mesh_questions(scene: Scene) -> Iterator[Issue]:
    """Yield a question for each mesh of an obstacle or holder that is too small to be in millimetres."""
    for body in scene.bodies:
        if body.kind != "mesh" or body.role == "arm":
            continue
        size = float(np.ptp(body.points, axis=0).max())
        if size < _SMALLEST_MESH:
            message = (
                f"The mesh of {body.name} is {size * MM_PER_M:.2g} mm large: is it in mm? "
                "Scale one in inch by 25.4, one in metres by 1000."
            )
            yield Issue("warning", "mesh-units", message, subject=body.name)


class _DensePath(NamedTuple):
    """A path with more samples on arcs.

    :param sample: n samples.
    :param q: (n, 6) nominal joint angles [rad].
    :param commanded_q: (n, 6) commanded joint angles [rad].
    """

    sample: Toolpath
    q: Array
    commanded_q: Array


def _refine_arcs(path: PathUnderLoad, commanded_q: Array) -> _DensePath:
    """Return a path with more samples on arcs, so that chords between samples are off by `_SAGITTA` at most.

    Between samples the joints are taken to move in proportion, so that the tip moves nearly along a chord. Arcs without
    force have a sample each 45° or less: with R = 25 mm such a chord is off by 1.9 mm.

    :param commanded_q: (N, 6) commanded joint angles at the samples of the path [rad].
    :raises ImpossiblePathError: an arc leaves the reach of the robot between two samples.
    """
    arcs, sample = path.motions.segments.arcs, path.sample
    motion, t, q = sample.motion, sample.t, path.joints.q
    chord_count = np.zeros(len(path.program.motions))
    # a chord over an angle α has the sagitta R·(1 − cos(α/2)); the count of such chords may be a fraction
    chord_count[arcs.motion] = arcs.sweep / (2.0 * np.arccos(1.0 - np.minimum(_SAGITTA / norm(arcs.radial), 1.0)))
    is_same_motion = np.append(False, motion[1:] == motion[:-1])  # as the sample before
    begin = np.where(is_same_motion, np.roll(t, 1), 0.0)
    parts = np.ceil(chord_count[motion] * (t - begin) - _ROUNDING).astype(np.int64).clip(1)
    if (parts == 1).all():
        return _DensePath(sample, q, commanded_q)
    row, share = toolpath.even_places(np.arange(len(motion)), parts)
    dense_t = np.where(share == 1.0, t[row], begin[row] + share * (t - begin)[row])
    dense = toolpath.at(path.program, path.motions.segments, motion[row], dense_t)
    try:
        dense_q = path.robot_in_cell.follow(path.program, motion[row], dense_t, dense.pose).q
    except UnreachableError as cause:
        raise ImpossiblePathError(unreachable(path.program, motion[row[list(cause.rows)]])) from None
    correction = commanded_q - q  # smooth along an arc: between two samples it is taken to change evenly
    previous_correction = correction[np.maximum(previous_samples(path.program, motion)[row], 0)]
    dense_commanded_q = dense_q + previous_correction + share[:, None] * (correction[row] - previous_correction)
    return _DensePath(dense, dense_q, dense_commanded_q)


def _retracts(path: PathUnderLoad, sample: Toolpath, run: Run) -> Bools:
    """Return which samples (n,) of a run the tool reaches along its axis, away from the part: it leaves its cut.

    :param sample: samples of the whole path.
    """
    pose, rows = sample.pose, run.rows
    previous = np.arange(rows.start, rows.stop) - 1
    previous[0] = max(run.previous, 0)
    step = pose[rows, :3, 3] - pose[previous, :3, 3]
    to_spindle = -pose[rows, :3, :3] @ np.array(SPINDLE_AXES[path.robot_in_cell.spindle])  # (n, 3) unit vectors
    return np.asarray(np.einsum("ni,ni->n", step, to_spindle) >= (1.0 - _AXIS_SHARE) * norm(step))


class _ClosePair(Struct, frozen=True):
    """Two bodies that come too close on some lines.

    :param distance: smallest distance [m]; 0 where they touch.
    :param line: source line on which it is reached.
    :param lines: all source lines on which they are too close.
    :param least_distance: smallest allowed distance [m]; 0: they must not touch.
    :param is_only_on_first_move: True if the smallest distance is on the way from [start], and not at its end.
    """

    distance: float
    line: int
    lines: frozenset[int]
    least_distance: float
    is_only_on_first_move: bool


class _CloseBodies:
    """All bodies that come too close to another one, with their smallest distance and its lines."""

    def __init__(self, motions: Motions, stock: StockInTime | None) -> None:
        self._pairs: dict[tuple[str, str], _ClosePair] = {}
        self._motions = motions
        self._stock_accuracy = None if stock is None else stock.accuracy

    def add(self, contact: Contact, *, is_only_on_first_move: bool) -> None:
        """Add a contact; `is_only_on_first_move`: on the way from [start], and not at its end."""
        line = int(self._motions.line[contact.motion])
        pair = _ClosePair(contact.distance, line, frozenset([line]), contact.least_distance, is_only_on_first_move)
        known_pair = self._pairs.get(contact.names, pair)
        nearest = pair if pair.distance < known_pair.distance else known_pair
        self._pairs[contact.names] = replace(
            nearest, lines=known_pair.lines | pair.lines, least_distance=contact.least_distance
        )

    def issues(self) -> list[Issue]:
        """Return an error for each two bodies."""
        return [
            _issue(names, pair, self._stock_source_and_advice(names, pair.line)) for names, pair in self._pairs.items()
        ]

    def _stock_source_and_advice(self, names: tuple[str, str], line: int) -> tuple[str, str] | None:
        """Return the method behind a distance to the stock, and the advice for a line; None for other bodies."""
        if names[1] != STOCK or self._stock_accuracy is None:
            return None
        bound = f", which is rounded up to cells of {self._stock_accuracy * MM_PER_M:.2g} mm"
        is_at_feed = not self._motions.rapid[self._motions.line == line].all()
        return bound, _CUT_ADVICE if is_at_feed else _RAPID_ADVICE


_CUT_ADVICE = "Use a longer tool, cut here first, tilt the tool less, or correct the bodies in the cell"
_RAPID_ADVICE = "Lift the tool before it moves rapidly, begin elsewhere ([start]), or correct the bodies in the cell"


def _stock_sentences(scene: collision.Scene, stock: StockInTime | None) -> Iterator[str]:
    """Yield sentences on the stock: how it was compared, and how exactly.

    :param stock: the stock at each move; None: it is not known.
    """
    if stock is not None:
        yield (
            "the stock of the process is compared as it is at each move, for arm, meshes and a tool that turns rounded "
            f"up to cells of {stock.accuracy * MM_PER_M:.2g} mm; the smallest clearance does not include it"
        )
    elif not any(body.role == "part" for body in scene.bodies):
        yield "the stock is not checked: there is no process with [material], and no obstacle with part = true"


def _correction_sentence(reduction: float) -> Iterator[str]:
    """Yield a sentence on the reduction of distances [m] for the correction."""
    if reduction > _NO_REDUCTION:
        yield (
            f"distances are reduced by the motion of the bodies due to the correction, {reduction * MM_PER_M:.2g} mm "
            "at most: they are valid with and without the cutting forces"
        )


def _e1_displacements(path: PathUnderLoad, sample: Toolpath, run: Run) -> Array | None:
    """Return the displacements (n + 1, 3) [m] of the robot by E1 before and at the n samples of a run, in the root.

    None without a linear axis.

    :param sample: samples of the whole path.
    """
    carriage = path.program.carriage
    if carriage is None:
        return None
    row = max(run.previous, 0)  # before the program E1 is where its first motion begins
    t = sample.t[row : row + 1] if run.previous >= 0 else np.zeros(1)
    start = carriage.offset(sample.motion[row : row + 1], t)
    return np.concatenate([start, carriage.offset(sample.motion[run.rows], sample.t[run.rows])])


def _names(bodies: Sequence[Body], first: int, second: int) -> tuple[str, str]:
    """Return the names of two bodies, which are rows of `bodies`."""
    return bodies[int(first)].name, bodies[int(second)].name


def _issue(names: tuple[str, str], pair: _ClosePair, stock_source_and_advice: tuple[str, str] | None) -> Issue:
    """Return the error of two bodies that come too close.

    :param stock_source_and_advice: see `_CloseBodies`; None if no body is the stock.
    """
    first, second = names
    verb = "touches or is inside" if pair.distance == 0.0 else f"comes within {pair.distance * MM_PER_M:.2g} mm of"
    demand = (
        f"[collision] asks for {pair.least_distance * MM_PER_M:g} mm"
        if pair.least_distance > 0.0
        else "it may not touch it here"
    )
    advice = "Move the part, turn the tool, or correct the bodies in the cell"
    source, place = "", ""
    if stock_source_and_advice is not None:
        source, advice = stock_source_and_advice
    if pair.is_only_on_first_move:
        place = " on the way from [start] to the first target"
        advice = "Choose [start] joints with the tip above the part, lift the first target, or correct the bodies"
    message = f"collision: {first} {verb} {second}{source}{place}; {demand}. {advice}"
    return Issue("error", "collision", message, pair.line, count=len(pair.lines), subject=f"{first}, {second}")


class States(Struct, frozen=True, eq=False):
    """States of the robot at N samples of a path with one tool, and before them.

    :param motion: (N,) row of `Motions` of each sample.
    :param q: (N + 1, 6) joint angles [rad]; the first row is before the first sample.
    :param commanded_q: (N + 1, 6) those that the arm may have instead [rad], see `collision.path_hits`; None: none.
    :param shift: (N + 1, 3) displacement of the robot by E1 [m]; None if nothing carries it.
    """

    motion: Ints
    q: Array
    commanded_q: Array | None
    shift: Array | None

    def motion_to(self, row: int) -> int:
        """Return the motion (row of `Motions`) on which the robot is in the state of a row of `q`."""
        return int(self.motion[max(row - 1, 0)])

    def arrival(self) -> States:
        """Return the end of the first motion as a path that stays there."""
        # samples are sorted by motion; `q` has one row more than `motion`: row k + 1 is the arm at sample k
        end_row = int(np.searchsorted(self.motion, self.motion[0], side="right"))
        rows = [end_row, end_row]
        commanded_q, shift = (None if values is None else values[rows] for values in (self.commanded_q, self.shift))
        return States(self.motion[:1], self.q[rows], commanded_q, shift)

    def part(self, low: int, high: int) -> States:
        """Return the samples from `low` to `high` (exclusive), and the state before them."""
        rows = slice(low, high + 1)
        commanded_q, shift = (None if values is None else values[rows] for values in (self.commanded_q, self.shift))
        return States(self.motion[low:high], self.q[rows], commanded_q, shift)


def _close_pairs(
    scene: Scene, states: States, stock: StockInTime | None, least_distance: float
) -> set[tuple[str, str]]:
    """Return the names of bodies that come closer than allowed along a path that cuts nothing.

    :param stock: the stock at each move; None: it is not known, and not compared.
    :param least_distance: smallest allowed distance [m].
    """
    hits = collision.path_hits(scene, states.q, least_distance, states.shift, states.commanded_q)
    rapid = np.ones(len(states.motion), dtype=bool)
    return {contact.names for contact in _contacts(scene, states, hits, rapid, stock, least_distance)}


def _contacts(
    scene: Scene, states: States, hits: Hits, rapid: Bools, stock: StockInTime | None, least_distance: float
) -> Iterator[Contact]:
    """Yield the contacts of all bodies along a path: of the scene, of the cutter with parts, and with the stock.

    :param hits: where bodies of the scene come closer than `least_distance` [m].
    :param rapid: (N,) samples on rapid moves along which the tool does not just leave its cut.
    :param stock: the stock at each move; None: it is not known, and not compared.
    """
    yield from _contacts_of_hits(scene.bodies, states, hits, least_distance)
    yield from part_contacts(scene, states, rapid)
    if stock is not None:
        yield from stock_contacts(scene, states, stock, least_distance)


class Contact(Struct, frozen=True):
    """Two bodies that come closer than allowed on a motion.

    :param names: their names.
    :param motion: row of `Motions`.
    :param distance: between them [m]; 0 where they touch.
    :param least_distance: smallest allowed distance [m]; 0: they must not touch.
    """

    names: tuple[str, str]
    motion: int
    distance: float
    least_distance: float


def stock_contacts(scene: Scene, states: States, stock: StockInTime, least_distance: float) -> Iterator[Contact]:
    """Yield the contacts of arm and tool meshes with the stock; on motions that turn the tool, those of the whole tool.

    On other motions the whole tool was compared while the stock was swept. The cutter, which is in the stock where it
    cuts, is compared only on motions that turn it and remove nothing.

    :param states: states of the robot at N samples.
    :param stock: the stock over time.
    :param least_distance: smallest allowed distance [m]; the cutter must not touch.
    """
    moving = [body for body in scene.bodies if not body.is_fixed]
    arm_and_meshes = [body for body in moving if body.role == "arm" or (body.role == "tool" and body.kind == "mesh")]
    tool_shapes = [body for body in moving if body.role == "tool" and body.kind != "mesh"]
    cutters = [collision.inscribed_capsule(body) for body in moving if body.role == "cutter"]
    all_rows = np.ones(len(states.motion), dtype=bool)
    is_turning = ~stock.is_compared[states.motion]
    is_turning_in_air = is_turning & ~stock.removes_material[states.motion]
    nominal_states = replace(states, commanded_q=None)
    for bodies, body_states, body_distance, rows in (
        (arm_and_meshes, states, least_distance, all_rows),
        (tool_shapes, states, least_distance, is_turning),
        (cutters, nominal_states, 0.0, is_turning_in_air),
    ):
        if bodies and rows.any():
            yield from _StockSearch(scene, bodies, body_states, stock, body_distance).contacts(rows)


def part_contacts(scene: Scene, states: States, rapid: Bools) -> Iterator[Contact]:
    """Yield the contacts of the cutter with parts of [collision] on rapid moves, where the tool is on its nominal path.

    :param rapid: (N,) samples on rapid moves along which the tool does not just leave its cut.
    """
    parts = [body for body in scene.bodies if body.role == "part"]
    cutters = [collision.inscribed_capsule(body) for body in scene.bodies if body.role == "cutter"]
    if parts and cutters and rapid.any():
        solids = _solids(scene, cutters, parts)
        for low, high in _stretches(rapid):
            nominal_states = replace(states.part(low, high), commanded_q=None)
            yield from _contacts_of_solids(solids, nominal_states, least_distance=0.0)  # 0: they must not touch


class _StockSearch:
    """Search for bodies that come too close to the stock along a path.

    The stock only shrinks: its shape before a motion contains that before later ones. A path is compared with the stock
    before its first motion, and only the motions that are too close to that with stocks of later motions.

    :ivar stock_count: number of stocks that the bodies were compared with.
    """

    def __init__(
        self, scene: Scene, bodies: Sequence[Body], states: States, stock: StockInTime, least_distance: float
    ) -> None:
        self.scene, self.bodies, self.states, self.stock, self.least_distance = (
            scene,
            bodies,
            states,
            stock,
            least_distance,
        )
        self.solids: Solids | None = None
        self.stock_count = 0

    def contacts(self, samples: Bools) -> Iterator[Contact]:
        """Yield the contacts with the stock at, or before, samples.

        :param samples: (N,) True for those that are searched.
        """
        if not samples.any():
            return
        motion = self.states.motion
        first = int(motion[np.argmax(samples)])
        contacts = self._contacts_with_stock(first, samples)
        is_last_stock = self.stock_count >= MOST_STOCKS  # its contacts count for later motions too
        yield from (contact for contact in contacts if contact.motion == first or is_last_stock)
        # the stock before `first` contains that of later motions: only those that are too close to it remain open; both
        # halves of them are compared with the stock before their own first motion
        later_motions = np.unique([contact.motion for contact in contacts if contact.motion != first])
        if len(later_motions) and not is_last_stock:
            is_open = samples & np.isin(motion, later_motions)
            middle = int(later_motions[len(later_motions) // 2])
            yield from self.contacts(is_open & (motion < middle))
            yield from self.contacts(is_open & (motion >= middle))

    def _contacts_with_stock(self, motion: int, samples: Bools) -> list[Contact]:
        """Return the contacts with the stock as it is before a motion.

        :param samples: (N,) True for samples that are searched, each with the path from the sample before it.
        """
        points, faces = self.stock.mesh(motion)
        self.stock_count += 1
        if not len(points):
            return []
        body = Body(
            name=STOCK,
            carrier=-1,  # the robot root
            role="obstacle",
            kind="mesh",
            size=(),
            pose=np.eye(4),
            points=points,
            faces=faces,
        )
        if self.solids is None:
            self.solids = _solids(self.scene, self.bodies, [body])
        else:
            self.solids = self.solids.replace_last(body)
        solids = self.solids
        return [
            contact
            for low, high in _stretches(samples)
            for contact in _contacts_of_solids(solids, self.states.part(low, high), self.least_distance)
        ]


def _solids(scene: Scene, moving: Sequence[Body], fixed_bodies: Sequence[Body]) -> Solids:
    """Return the solids of moving and fixed bodies, paired where the first one moves with the arm."""
    pairs = [
        (i, len(moving) + j) for i in range(len(moving)) for j in range(len(fixed_bodies)) if moving[i].carrier >= 0
    ]
    return Solids(Scene(scene.robot, (*moving, *fixed_bodies)), pairs)


def _contacts_of_solids(solids: Solids, states: States, least_distance: float) -> Iterator[Contact]:
    """Yield the contacts of solids closer than `least_distance` [m] at, or before, the samples of a path."""
    hits = collision.pair_hits(solids, states.q, least_distance, states.shift, states.commanded_q)
    yield from _contacts_of_hits(solids.bodies, states, hits, least_distance)


def _contacts_of_hits(bodies: Sequence[Body], states: States, hits: Hits, least_distance: float) -> Iterator[Contact]:
    """Yield hits as contacts.

    :param bodies: those whose rows are in the hits.
    :param least_distance: the smallest allowed distance by which they are hits [m].
    """
    for row, first, second, distance in zip(hits.row, hits.first, hits.second, hits.distance, strict=True):
        yield Contact(_names(bodies, first, second), states.motion_to(int(row)), float(distance), least_distance)


def _stretches(rows: Bools) -> Iterator[tuple[int, int]]:
    """Yield the first sample, and the one behind the last, of each run of samples for which `rows` (N,) is True."""
    # places where a run begins or ends, in turn
    changes = np.flatnonzero(np.diff(np.concatenate([[False], rows, [False]])))
    yield from zip(changes[::2].tolist(), changes[1::2].tolist(), strict=True)
