"""Collisions along the path of a program: of arm, tool and obstacles, and of bodies that do not cut with the stock.

The stock before a motion contains all material that is there while the motion runs, and the stock before a group of
motions all that is there during any of them. So a path is compared with the stock at its beginning, and divided only
where that is not enough. The cylinders of the tool were compared while the stock was swept, on motions along which the
tool does not turn; here they are compared on the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import collision, toolpath
from postproc.collision import Body, Scene, Solids
from postproc.correction.runs import Run, runs, samples_before
from postproc.errors import Issue
from postproc.forces import StockInTime
from postproc.frames import M_PER_MM, MM_PER_M, Array, norm
from postproc.kinematics import UnreachableError
from postproc.placement.samples import AXIS
from postproc.program import PTP, Bools, Ints, Motions
from postproc.toolpath import Toolpath
from postproc.under_load import ImpossiblePathError, PathUnderLoad, unreachable

_AXIS_SHARE = 1e-4
"""Steps whose cosine of the angle to the tool axis is less than 1 by this at most are along it (assumed)."""
_NO_REDUCTION = 1e-6
"""Corrections that move bodies by less [m] are not worth a word (assumed)."""
_SAGITTA = 0.01e-3
"""Arcs are compared by chords that are off by this [m] at most: far below what clearances are asked for (assumed)."""
_ROUNDING = 1e-9
"""Parts of an arc: a whole number but for rounding is not divided once more."""
_SMALLEST_MESH = 5e-3
"""Meshes of obstacles and holders whose largest edge is shorter [m] are questioned: in metres a part of 5 m has it
(assumed)."""
STOCK = "stock"
_MOST_STOCKS = 200
"""Stocks of one group of bodies that are compared; pairs not decided by then count as too close (assumed)."""


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
    those of the nominal path, from the start of the program on, less by as far as the correction moves each body at
    most: a bound for both paths, and for all poses between them.

    :param commanded_q: (N, 6) commanded joint angles at the samples [rad].
    :returns: None if the cell has no [collision].
    :raises CellError: a body cannot be read.
    """
    robot_in_cell = path.robot_in_cell
    table = robot_in_cell.cell.collision
    if table is None:
        return None, []
    program, need = path.program, table.clearance_mm * M_PER_MM
    sample, path_q, commanded_q = _refine_arcs(path, commanded_q)
    line = program.motions.line[sample.motion]
    smallest: SmallestClearance | None = None
    stock = path.motions.forces.stock
    worst = _SmallestDistance(program.motions, stock)
    scenes: dict[int, Scene] = {}
    largest_decrease = 0.0
    for run in runs(program, sample.motion, path_q):
        rows, first_motion = run.rows, int(sample.motion[run.rows.start])
        if run.tool not in scenes:
            scenes[run.tool] = collision.Scene.of(robot_in_cell.robot, robot_in_cell.cell, program.tools[run.tool])
        scene = scenes[run.tool]
        from_start = run.before < 0 and program.motions.kind[first_motion] == PTP
        start_q = robot_in_cell.cell.start_joints if run.before < 0 else path_q[run.before]
        q = np.concatenate([start_q[None], path_q[rows]])
        command_q = np.concatenate([start_q[None] if run.before < 0 else commanded_q[[run.before]], commanded_q[rows]])
        corrected_q = None if np.array_equal(q, command_q) else command_q
        shift = _shift(path, sample, run)
        distances = collision.path_hits(scene, q, need, shift, corrected_q)
        largest_decrease = max(largest_decrease, distances.largest_decrease)
        lines = np.append(line[rows][:1], line[rows])
        closest_pair = distances.closest
        if smallest is None or (closest_pair is not None and closest_pair.distance < smallest.distance):
            names = ("", "") if closest_pair is None else _names(scene, closest_pair.first, closest_pair.second)
            at = 0 if closest_pair is None else closest_pair.row
            distance = np.inf if closest_pair is None else closest_pair.distance
            remarks = (
                *scene.remarks,
                *_stock_sentences(scene, stock),
            )
            smallest = SmallestClearance(distance, names, int(lines[at]), scene, remarks)
        hits = []
        for row, first, second, distance in zip(
            distances.row, distances.first, distances.second, distances.distance, strict=True
        ):
            begins = from_start and bool(sample.motion[rows][max(int(row) - 1, 0)] == first_motion)
            hits.append((_names(scene, first, second), float(distance), int(lines[row]), need, begins))
        states = States(sample.motion[rows], q, corrected_q, shift)
        arrival = _too_close(scene, states.arrival(), stock, need) if from_start else set()
        for names, distance, at, clearance, begins in hits:
            worst.note(names, distance, at, clearance, begins and names not in arrival)
        contacts = part_contacts(scene, states, program.motions.rapid[states.motion] & ~_retracts(path, sample, run))
        if stock is not None:
            contacts = chain(contacts, stock_contacts(scene, states, stock, need))
        for contact in contacts:
            begins = from_start and contact.motion == first_motion and contact.names not in arrival
            worst.note(contact.names, contact.distance, int(program.motions.line[contact.motion]), contact.need, begins)
    if smallest is None:
        return None, worst.issues()
    remarks = (*smallest.remarks, *_correction_sentence(largest_decrease))
    return replace(smallest, remarks=remarks), [*worst.issues(), *_units(smallest.scene)]


def _units(scene: Scene) -> Iterator[Issue]:
    """Yield a question for each mesh that is too small to be in millimetres."""
    for body in scene.bodies:
        if body.kind != "mesh" or body.of == "arm":
            continue
        size = float(np.ptp(body.points, axis=0).max())
        if size < _SMALLEST_MESH:
            message = (
                f"The mesh of {body.name} is {size * MM_PER_M:.2g} mm large: is it in mm? Scale one in metres by 1000."
            )
            yield Issue("warning", "mesh-units", message, subject=body.name)


def _refine_arcs(path: PathUnderLoad, commanded_q: Array) -> tuple[Toolpath, Array, Array]:
    """Return the samples of a path, their joint angles and the commanded ones (n, 6) [rad], with more on arcs.

    Between samples the joints are taken to move in proportion, so that the tip moves nearly along a chord. Arcs without
    force have a sample each 45° or less: with R = 25 mm such a chord is off by 1.9 mm. Here it is by `_SAGITTA`.

    :param commanded_q: (N, 6) commanded joint angles at the samples of the path [rad].
    :raises ImpossiblePathError: an arc leaves the reach of the robot between two samples.
    """
    arcs, sample = path.motions.segments.arcs, path.sample
    motion, t, q = sample.motion, sample.t, path.joints.q
    turn = np.zeros(len(path.program.motions))
    turn[arcs.motion] = arcs.sweep / (2.0 * np.arccos(1.0 - np.minimum(_SAGITTA / norm(arcs.radial), 1.0)))
    before = np.where(np.append(False, motion[1:] == motion[:-1]), np.roll(t, 1), 0.0)
    parts = np.ceil(turn[motion] * (t - before) - _ROUNDING).astype(np.int64).clip(1)
    if (parts == 1).all():
        return sample, q, commanded_q
    row, share = toolpath.even_places(np.arange(len(motion)), parts)
    places = np.where(share == 1.0, t[row], before[row] + share * (t - before)[row])
    dense = toolpath.at(path.program, path.motions.segments, motion[row], places)
    try:
        dense_q = path.robot_in_cell.follow(path.program, motion[row], places, dense.pose).q
    except UnreachableError as cause:
        raise ImpossiblePathError(unreachable(path.program, motion[row[list(cause.rows)]])) from None
    correction = commanded_q - q  # smooth along an arc: between two samples it is taken to change evenly
    previous = correction[np.maximum(samples_before(path.program, motion)[row], 0)]
    return dense, dense_q, dense_q + previous + share[:, None] * (correction[row] - previous)


def _retracts(path: PathUnderLoad, sample: Toolpath, run: Run) -> Bools:
    """Return at which samples (n,) the tool moves along its own axis, away from the part: it leaves its cut."""
    pose, rows = sample.pose, run.rows
    previous = np.arange(rows.start, rows.stop) - 1
    previous[0] = max(run.before, 0)
    step = pose[rows, :3, 3] - pose[previous, :3, 3]
    up = -pose[rows, :3, :3] @ np.array(AXIS[path.robot_in_cell.spindle])
    return np.asarray(np.einsum("ni,ni->n", step, up) >= (1.0 - _AXIS_SHARE) * norm(step))


class _SmallestDistance:
    """The smallest distance of each two bodies that come too close, and the lines on which they do."""

    def __init__(self, motions: Motions, stock: StockInTime | None) -> None:
        self._of: dict[tuple[str, str], tuple[float, int, set[int], float, bool]] = {}
        self._motions = motions
        self._cell = None if stock is None else stock.accuracy

    def note(self, names: tuple[str, str], distance: float, line: int, need: float, begins: bool) -> None:
        """Note a distance [m] that is smaller than the clearance; `begins`: on the way from [start]."""
        smallest, at, lines, _, first = self._of.get(names, (np.inf, 0, set(), need, begins))
        at, smallest, first = (line, distance, begins) if distance < smallest else (at, smallest, first)
        self._of[names] = smallest, at, lines | {line}, need, first

    def issues(self) -> list[Issue]:
        """Return an error for each two bodies."""
        return [
            _issue(names, *details, self._stock_source_and_advice(names, details[1]))
            for names, details in self._of.items()
        ]

    def _stock_source_and_advice(self, names: tuple[str, str], line: int) -> tuple[str, str] | None:
        """Return the method behind a distance to the stock, and the advice for a line; None for other bodies."""
        if names[1] != STOCK or self._cell is None:
            return None
        bound = f", which is rounded up to cells of {self._cell * MM_PER_M:.2g} mm"
        cuts = not self._motions.rapid[self._motions.line == line].all()
        return bound, _CLEAR_OF_CUT if cuts else _CLEAR_OF_RAPID


_CLEAR_OF_CUT = "Use a longer tool, cut here first, tilt the tool less, or correct the bodies in the cell"
_CLEAR_OF_RAPID = "Lift the tool before it moves rapidly, begin elsewhere ([start]), or correct the bodies in the cell"


def _stock_sentences(scene: collision.Scene, stock: StockInTime | None) -> Iterator[str]:
    """Yield sentences on the stock: how it was compared, and how exactly."""
    if stock is not None:
        yield (
            "the stock of the process is compared as it is at each move, for arm, meshes and a tool that turns rounded "
            f"up to cells of {stock.accuracy * MM_PER_M:.2g} mm; the smallest clearance does not include it"
        )
    elif not any(body.of == "part" for body in scene.bodies):
        yield "the stock is not checked: there is no process with [material], and no obstacle with part = true"


def _correction_sentence(reduction: float) -> Iterator[str]:
    """Yield a sentence on the reduction of distances [m] for the correction."""
    if reduction > _NO_REDUCTION:
        yield (
            f"distances are reduced by the motion of the bodies due to the correction, {reduction * MM_PER_M:.2g} mm "
            "at most: they are valid with and without the cutting forces"
        )


def _shift(path: PathUnderLoad, sample: Toolpath, run: Run) -> Array | None:
    """Return the displacements (n + 1, 3) [m] of the robot by E1 before and at samples; None without a linear axis."""
    carriage = path.program.carriage
    if carriage is None:
        return None
    row = max(run.before, 0)
    t = sample.t[row : row + 1] if run.before >= 0 else np.zeros(1)
    start = carriage.offset(sample.motion[row : row + 1], t)
    return np.concatenate([start, carriage.offset(sample.motion[run.rows], sample.t[run.rows])])


def _names(scene: collision.Scene, first: int, second: int) -> tuple[str, str]:
    return scene.bodies[int(first)].name, scene.bodies[int(second)].name


def _issue(
    names: tuple[str, str],
    distance: float,
    line: int,
    lines: set[int],
    need: float,
    begins: bool,
    to_stock: tuple[str, str] | None,
) -> Issue:
    """Return the error of two bodies.

    :param begins: on the way from [start].
    :param to_stock: see `_SmallestDistance._stock_source_and_advice`.
    """
    first, second = names
    verb = "touches or is inside" if distance == 0.0 else f"comes within {distance * MM_PER_M:.2g} mm of"
    asks = f"[collision] asks for {need * MM_PER_M:g} mm" if need > 0.0 else "it may not touch it here"
    advice = "Move the part, turn the tool, or correct the bodies in the cell"
    bound, place = "", ""
    if to_stock is not None:
        bound, advice = to_stock
    if begins:
        place = " on the way from [start] to the first target"
        advice = "Choose [start] joints with the tip above the part, lift the first target, or correct the bodies"
    message = f"collision: {first} {verb} {second}{bound}{place}; {asks}. {advice}"
    return Issue("error", "collision", message, line, count=len(lines), subject=f"{first}, {second}")


class States(Struct, frozen=True, eq=False):
    """States of the robot at N samples of a path with one tool, and before them.

    :param motion: (N,) row of `Motions`.
    :param q: (N + 1, 6) joint angles [rad]; the first row is before the first sample.
    :param commanded: (N + 1, 6) those that the arm may have instead [rad], see `collision.path_hits`.
    :param shift: (N + 1, 3) how far E1 carries the robot [m]; None if nothing carries it.
    """

    motion: Ints
    q: Array
    commanded: Array | None
    shift: Array | None

    def arrival(self) -> States:
        """Return the end of the first motion as a path that stays there."""
        last = int(np.searchsorted(self.motion, self.motion[0], side="right"))
        stay = [last, last]
        commanded_q, shift = (None if values is None else values[stay] for values in (self.commanded, self.shift))
        return States(self.motion[:1], self.q[stay], commanded_q, shift)

    def part(self, low: int, high: int) -> States:
        """Return the samples from `low` to `high` (exclusive)."""
        part = slice(low, high + 1)
        commanded_q, shift = (None if values is None else values[part] for values in (self.commanded, self.shift))
        return States(self.motion[low:high], self.q[part], commanded_q, shift)


def _too_close(scene: Scene, states: States, stock: StockInTime | None, need: float) -> set[tuple[str, str]]:
    """Return the names of bodies that come closer than allowed along a path that cuts nothing."""
    hits = collision.path_hits(scene, states.q, need, states.shift, states.commanded)
    names = {_names(scene, first, second) for first, second in zip(hits.first, hits.second, strict=True)}
    contacts = part_contacts(scene, states, np.ones(len(states.motion), dtype=bool))
    if stock is not None:
        contacts = chain(contacts, stock_contacts(scene, states, stock, need))
    return names | {contact.names for contact in contacts}


class Contact(Struct, frozen=True):
    """Two bodies that come closer than allowed on a motion; `distance` and `need` [m]."""

    names: tuple[str, str]
    motion: int
    distance: float
    need: float


def stock_contacts(scene: Scene, states: States, stock: StockInTime, need: float) -> Iterator[Contact]:
    """Yield the contacts of arm and tool meshes with the stock; on motions that turn the tool, those of the whole tool.

    :param need: smallest allowed distance [m]; the cutter must not touch.
    """
    moving = [body for body in scene.bodies if not body.is_fixed]
    arm_and_meshes = [body for body in moving if body.of == "arm" or (body.of == "tool" and body.kind == "mesh")]
    tool_shapes = [body for body in moving if body.of == "tool" and body.kind != "mesh"]
    cutters = [collision.inscribed_capsule(body) for body in moving if body.of == "cutter"]
    all_rows = np.ones(len(states.motion), dtype=bool)
    turning = ~stock.is_compared[states.motion]
    passing = turning & ~stock.cuts[states.motion]
    nominal = replace(states, commanded=None)
    for bodies, body_states, own_need, rows in (
        (arm_and_meshes, states, need, all_rows),
        (tool_shapes, states, need, turning),
        (cutters, nominal, 0.0, passing),
    ):
        if bodies and rows.any():
            yield from _Search(scene, bodies, body_states, stock, own_need).contacts(rows)


def part_contacts(scene: Scene, states: States, rapid: Bools) -> Iterator[Contact]:
    """Yield the contacts of the cutter with parts of [collision] on rapid moves, where the tool is on its nominal path.

    :param rapid: (N,) samples on rapid moves along which the tool does not just leave its cut.
    """
    parts = [body for body in scene.bodies if body.of == "part"]
    cutters = [collision.inscribed_capsule(body) for body in scene.bodies if body.of == "cutter"]
    if parts and cutters and rapid.any():
        solids = _solids(scene, cutters, parts)
        for low, high in _stretches(rapid):
            yield from _contacts(solids, replace(states.part(low, high), commanded=None), 0.0)


class _Search:
    """The search of bodies along a path, with the stock of the time."""

    def __init__(self, scene: Scene, bodies: Sequence[Body], states: States, stock: StockInTime, need: float) -> None:
        self.states, self.stock, self.need = states, stock, need
        self.solids: Solids | None = None
        self.scene, self.bodies, self.compared = scene, bodies, 0

    def contacts(self, rows: Bools) -> Iterator[Contact]:
        """Yield the contacts at, or before, samples (N,)."""
        motion = self.states.motion
        left = rows
        while left.any():
            first = int(motion[np.argmax(left)])
            contacts = self._at(first, left)
            certain = [contact for contact in contacts if contact.motion == first or self.compared >= _MOST_STOCKS]
            yield from certain
            later_motions = np.unique([contact.motion for contact in contacts if contact.motion != first])
            if self.compared >= _MOST_STOCKS or not len(later_motions):
                return
            # the stock of `first` is an upper bound for what follows: only motions that are too close to it are open,
            # the first half of them by the stock before them, the others by that in their middle
            middle = int(later_motions[len(later_motions) // 2])
            open_ = left & np.isin(motion, later_motions)
            yield from self.contacts(open_ & (motion < middle))
            left = open_ & (motion >= middle)

    def _at(self, motion: int, rows: Bools) -> list[Contact]:
        """Return the contacts with the stock as it is before a motion, at or before samples (N,)."""
        points, faces = self.stock.mesh(motion)
        self.compared += 1
        if not len(points):
            return []
        body = Body(STOCK, -1, "obstacle", "mesh", (), np.eye(4), points, faces)
        self.solids = (
            _solids(self.scene, self.bodies, [body]) if self.solids is None else self.solids.replace_last(body)
        )
        solids = self.solids
        return [
            contact
            for low, high in _stretches(rows)
            for contact in _contacts(solids, self.states.part(low, high), self.need)
        ]


def _solids(scene: Scene, moving: Sequence[Body], fixed_bodies: Sequence[Body]) -> Solids:
    """Return the solids of moving and fixed bodies, paired where the first one moves with the arm."""
    pairs = [
        (i, len(moving) + j) for i in range(len(moving)) for j in range(len(fixed_bodies)) if moving[i].carrier >= 0
    ]
    return Solids(Scene(scene.robot, (*moving, *fixed_bodies)), pairs)


def _contacts(solids: Solids, states: States, need: float) -> Iterator[Contact]:
    """Yield the contacts of bodies closer than `need` [m] at, or before, the states."""
    hits = collision.pair_hits(solids, states.q, need, states.shift, states.commanded)
    motion = np.append(states.motion[:1], states.motion)
    for row, first, second, distance in zip(hits.row, hits.first, hits.second, hits.distance, strict=True):
        names = solids.bodies[int(first)].name, solids.bodies[int(second)].name
        yield Contact(names, int(motion[row]), float(distance), need)


def _stretches(rows: Bools) -> Iterator[tuple[int, int]]:
    """Yield first and last (exclusive) of the runs of samples (N,)."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], rows, [False]])))
    yield from zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True)
