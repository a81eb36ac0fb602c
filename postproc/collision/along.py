"""Collisions along a path: distances at samples, and a bound on how far bodies move between them.

A distance changes by at most as far as the bodies move against each other. So between two poses at distances d₁ and d₂
it is at least (d₁ + d₂ − L) / 2, with the length L of that motion. Intervals in which this bound is too small are
halved, also between two samples. Source of the idea: Schwarzer, Saha, Latombe, "Adaptive dynamic collision checking for
single and multiple articulated robots in complex environments", IEEE Trans. Robotics 21, 2005.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.collision.bodies import Scene
from postproc.collision.distance import Solids, link_frames
from postproc.frames import Array, norm
from postproc.program import Bools, Ints, distinct

_FIRST_INTERVAL = 64
"""Number of samples in the first intervals (assumed)."""
_DISTANCE_TOLERANCE = 0.25e-3
"""Error of the smallest distance [m] (assumed)."""
_LEAST_MOTION = 0.05e-3
"""Motions between poses that are shorter than this [m] are not halved (assumed)."""


class SmallestDistance(Struct, frozen=True):
    """The smallest distance along a path.

    :param distance: [m]; 0 if bodies touch or overlap.
    :param first: row in `Scene.bodies` of the body that moves, and `second` of the other body.
    :param row: sample at which, or before which, the distance is reached.
    """

    distance: float
    first: int
    second: int
    row: int


class Hits(Struct, frozen=True, eq=False):
    """Pairs of bodies that come too close along a path, and the smallest distance.

    :param closest: smallest distance of all bodies; None without bodies to compare.
    :param row: (h,) samples at which, or before which, two bodies are closer than allowed.
    :param first: (h,) rows in `Scene.bodies` of the bodies that move, and `second` (h,) of the other bodies.
    :param distance: (h,) the smallest computed distance of the two bodies there [m].
    :param calls: number of distances that were computed.
    :param largest_decrease: largest decrease of the distance of a body by its displacement to the commanded path [m].
    """

    closest: SmallestDistance | None
    row: Ints
    first: Ints
    second: Ints
    distance: Array
    calls: int
    largest_decrease: float


def path_hits(
    scene: Scene, q: Array, min_distance: float, shift: Array | None = None, commanded_q: Array | None = None
) -> Hits:
    """Return where bodies come closer than allowed along a path, and the smallest distance.

    Between two samples the joints move in proportion, and so does E1.

    :param q: (n, 6) joint angles [rad].
    :param commanded_q: (n, 6) joint angles that the arm may have instead, or any between [rad]: distances of a body are
        reduced by its largest displacement between the two. None: the arm has the angles `q`.
    :param min_distance: smallest allowed distance [m]; 0: they must not touch.
    :param shift: (n, 3) displacement of the robot from the root by E1 [m]; None: there is no E1.
    """
    return pair_hits(Solids(scene), q, min_distance, shift, commanded_q)


def pair_hits(
    solids: Solids, q: Array, min_distance: float, shift: Array | None = None, commanded_q: Array | None = None
) -> Hits:
    """Return where bodies come closer than allowed along a path, for the pairs of `solids`; see `path_hits`."""
    search = _Search(solids, q, min_distance, shift, needs_minimum=True)
    if commanded_q is not None:
        search.reductions = _largest_displacement(solids, q, commanded_q)
    if len(q):
        for pair in solids.pairs:
            search.search_pair(*pair)
    distances = search.hits
    keys = sorted(distances)
    row, first, second = np.array(keys, dtype=np.int64).reshape(-1, 3).T
    return Hits(
        closest=search.closest,
        row=row,
        first=first,
        second=second,
        distance=np.array([distances[key] for key in keys]),
        calls=solids.calls,
        largest_decrease=float(search.reductions.max(initial=0.0)),
    )


def hits(
    solids: Solids, q: Array, min_distance: float, shift: Array | None = None, *, between_samples: bool = True
) -> Bools:
    """Return True for samples (n,) of a path at which, or before which, two bodies are closer than allowed, or touch.

    :param q: (n, 6) joint angles [rad].
    :param min_distance: smallest allowed distance [m]; 0: they must not touch.
    :param shift: (n, 3) displacement of the robot from the root by E1 [m]; None: there is no E1.
    :param between_samples: compare bodies between samples too; else at the samples only.
    """
    search = _Search(solids, q, min_distance, shift, needs_minimum=False)
    is_hit = np.zeros(len(q), dtype=bool)
    if len(q):
        for first, second in solids.pairs:
            search.search_pair(first, second, between_samples=between_samples)
    is_hit[[row for row, _, _ in search.hits]] = True  # keys: sample, first body, second body
    return is_hit


class _Search:
    """The search along one path, pair by pair; intervals that cannot reach the smallest distance so far are skipped.

    :ivar reductions: (b,) by how much the distances of each body are reduced, as it may have a displacement [m].
    :ivar states: (n, 6 or 9) joint angles [rad], and the displacement by E1 [m] if there is one.
    :ivar frames: (n, 8, 4, 4) frames of the carriers, see `link_frames`.
    :ivar closest: the smallest distance so far; None before the first distance.
    :ivar hits: (row, first body, second body) → smallest distance there [m].
    """

    def __init__(
        self, solids: Solids, q: Array, min_distance: float, shift: Array | None, *, needs_minimum: bool
    ) -> None:
        """Begin without hits.

        :param q: (n, 6) joint angles [rad].
        :param min_distance: smallest allowed distance [m].
        :param shift: (n, 3) displacement of the robot from the root by E1 [m]; None: there is no E1.
        :param needs_minimum: True: find the smallest distance, too; False: only find where bodies are too close.
        """
        self.solids, self.q, self.min_distance, self.needs_minimum = solids, q, min_distance, needs_minimum
        self.reductions = np.zeros(len(solids.bodies))
        self.chain = solids.scene.robot.nominal
        self.states = q if shift is None else np.concatenate([q, shift], axis=1)
        self.frames = self._frames(self.states)
        self.closest: SmallestDistance | None = None
        self._travels: dict[tuple[int, int | None], Array] = {}
        self.hits: dict[tuple[int, int, int], float] = {}

    def search_pair(self, first: int, second: int, *, between_samples: bool = True) -> None:
        """Record in `hits` and `closest` where two bodies are too close, and their smallest distance.

        Intervals of samples are halved, unless a bound shows that nothing in them counts: the bodies cannot approach
        by more than half of their relative travel beyond the distances at both ends.

        :param first: row of the body that moves, and `second` of the other body.
        :param between_samples: compare bodies between samples too; else at the samples only.
        """
        count = len(self.q)
        distance = np.full(count, np.nan)
        ends = distinct(np.append(np.arange(0, count, _FIRST_INTERVAL), count - 1))
        self._measure(first, second, ends, distance)
        if self._distance(first, second, self.frames[:1], solid=True)[0] == 0.0:
            distance[0] = 0.0  # also if one is inside the other: later it cannot get inside without a contact
            self._record_hit(first, second, 0, 0.0)
        open_rows = self._open_rows(first, second, ends, distance)
        if between_samples and len(open_rows):
            self._halve_motions(first, second, open_rows, distance)

    def _open_rows(self, first: int, second: int, ends: Ints, distance: Array) -> Ints:
        """Halve intervals of samples until bounds decide them; return the rows of samples before open motions, sorted.

        A motion between two samples is open if bodies may be closer on it than at its ends.

        :param ends: samples at the ends of the intervals; their distances are known.
        :param distance: (n,) distances of the bodies [m], NaN if not known; computed distances are entered in place.
        """
        length = self._travel(first, second)
        low, high = ends[:-1], ends[1:]
        open_rows = [np.zeros(0, dtype=np.int64)]
        while len(low):
            bound = 0.5 * (distance[low] + distance[high] - (length[high] - length[low]))
            is_open = self._is_open(bound)
            low, high = low[is_open], high[is_open]
            is_step = high - low == 1  # no sample between
            open_rows.append(low[is_step])
            low, high = low[~is_step], high[~is_step]
            middle = (low + high) // 2
            self._measure(first, second, distinct(middle), distance)
            low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
        return np.sort(np.concatenate(open_rows))

    def _travel(self, first: int, second: int) -> Array:
        """Return an upper bound on the relative travel of two bodies from the start to each sample (n,) [m].

        It is computed once for each pair; all fixed bodies count as one, since none of them moves.
        """
        second_body = self.solids.bodies[second]
        key = first, None if second_body.is_fixed else second  # None: any fixed body
        if key not in self._travels:
            steps = motion_bound(self.solids, first, second, self.q, self.frames)
            self._travels[key] = np.append(0.0, np.cumsum(steps))
        return self._travels[key]

    def _distance(self, first: int, second: int, frames: Array, *, solid: bool = False) -> Array:
        """Return the distances (n,) of two bodies [m], reduced by the displacement that each may have; at least 0.

        :param first: row of a body in `Solids.bodies`, and `second` of the other.
        :param frames: (n, 8, 4, 4) frames of the carriers (base, links, flange), see `link_frames`.
        :param solid: True: the distance is 0 also if one body is inside of a mesh. False: only surfaces count.
        """
        reduction = self.reductions[first] + self.reductions[second]
        return np.asarray(np.maximum(self.solids.distance(first, second, frames, solid=solid) - reduction, 0.0))

    def _is_open(self, bound: Array) -> Bools:
        """Return True for lower bounds (n,) of distances [m] that leave open a hit, or a new smallest distance."""
        return np.asarray((bound < self.min_distance) | (bound < self._smallest_distance() - _DISTANCE_TOLERANCE))

    def _smallest_distance(self) -> float:
        """Return the smallest distance so far [m]; ∞ before the first distance, −∞ if the search does not need it."""
        if not self.needs_minimum:
            return -np.inf
        return np.inf if self.closest is None else self.closest.distance

    def _measure(self, first: int, second: int, rows: Ints, distance: Array) -> None:
        """Enter the distances at rows of samples where they are NaN, and record hits and the smallest distance.

        :param first: row of a body in `Solids.bodies`, and `second` of the other.
        :param distance: (n,) distances of the bodies at all samples [m], NaN: not computed yet; changed in place.
        """
        rows = rows[np.isnan(distance[rows])]
        distance[rows] = self._distance(first, second, self.frames[rows])
        # bodies that touch are hits, also if none is required to keep a distance
        is_hit = (distance[rows] < self.min_distance) | (distance[rows] <= 0.0)
        for row in rows[is_hit].tolist():
            self._record_hit(first, second, row, float(distance[row]))
        if len(rows):
            row = int(rows[np.argmin(distance[rows])])
            self._update_closest(first, second, row, float(distance[row]))

    def _update_closest(self, first: int, second: int, row: int, distance: float) -> None:
        """Record a distance [m] of two bodies at a sample if it is the smallest so far."""
        if self.closest is None or distance < self.closest.distance:
            self.closest = SmallestDistance(distance, first, second, row)

    def _record_hit(self, first: int, second: int, row: int, distance: float) -> None:
        """Record a hit, with the smallest distance [m] of two bodies at, or before, a row of samples so far."""
        key = (row, first, second)
        self.hits[key] = min(distance, self.hits.get(key, np.inf))
        self._update_closest(first, second, row, distance)

    def _halve_motions(self, first: int, second: int, rows: Ints, distance: Array) -> None:
        """Halve the motions from some samples to the next ones until bounds decide them, and record hits.

        :param rows: samples at which these motions begin, at least one.
        :param distance: (n,) distances of the bodies at the samples [m].
        """
        begin, end = self.states[rows], self.states[rows + 1]
        begin_distance, end_distance = distance[rows], distance[rows + 1]
        while len(rows):
            # begin and end in turn: every second motion is to be bounded, the others lead to the begin of the next one
            pair = np.stack([begin, end], axis=1).reshape(-1, begin.shape[1])
            length = motion_bound(self.solids, first, second, pair[:, :6], self._frames(pair))[::2]
            bound = 0.5 * (begin_distance + end_distance - length)
            smaller_distance = np.minimum(begin_distance, end_distance)
            is_recorded = (smaller_distance < self.min_distance) | (smaller_distance <= 0.0)  # as a hit at an end
            may_hit = (bound < self.min_distance) & ~is_recorded
            is_open = (may_hit | (bound < self._smallest_distance() - _DISTANCE_TOLERANCE)) & (length > _LEAST_MOTION)
            rows, begin, end = rows[is_open], begin[is_open], end[is_open]
            begin_distance, end_distance = begin_distance[is_open], end_distance[is_open]
            if not len(rows):
                return
            middle = 0.5 * (begin + end)
            middle_distance = self._distance(first, second, self._frames(middle))
            for k in np.flatnonzero((middle_distance < self.min_distance) | (middle_distance <= 0.0)).tolist():
                self._record_hit(first, second, int(rows[k]) + 1, float(middle_distance[k]))
            k = int(np.argmin(middle_distance))
            self._update_closest(first, second, int(rows[k]) + 1, float(middle_distance[k]))
            rows = np.concatenate([rows, rows])
            begin, end = np.concatenate([begin, middle]), np.concatenate([middle, end])
            begin_distance, end_distance = (
                np.concatenate([begin_distance, middle_distance]),
                np.concatenate([middle_distance, end_distance]),
            )

    def _frames(self, states: Array) -> Array:
        """Return the link frames (n, 8, 4, 4) at states (n, 6 or 9): joint angles [rad], displacements by E1 [m]."""
        return link_frames(self.chain, states[:, :6], states[:, 6:] if states.shape[1] > 6 else None)


def motion_bound(solids: Solids, first: int, second: int, q: Array, frames: Array) -> Array:
    """Return an upper bound (n − 1,) on the relative displacement of two bodies between successive poses [m].

    For any pose between two poses, it bounds the sum of the displacements from the first to it and from it to the
    second. The bound is the chord c of the middle of the body, twice the height of the arc over the chord, and the
    rotation times the radius r of the body: c + 2·Δq²·R/8 + Δq·r. If joints move in proportion by Δq in all, no point
    within R of the axes leaves its chord by more than Δq²·R/8.

    :param first: row of the body, and `second` of the body to which its motion is relative.
    :param q: (n, 6) joint angles [rad], and `frames` (n, 8, 4, 4) the link frames there.
    """
    body, reference = solids.bodies[first], solids.bodies[second]
    centre, radius = solids.spheres[first]
    chain = solids.scene.robot.nominal
    moving, reference_frame = solids.frame(first, frames), solids.frame(second, frames)
    point = moving[:, :3, :3] @ centre + moving[:, :3, 3] - reference_frame[:, :3, 3]
    point = np.einsum("nji,nj->ni", reference_frame[:, :3, :3], point)
    # the joints that move the body relative to the reference; carrier −1 is the root
    joints_between = slice(reference.carrier + 1, body.carrier + 1)
    turning = np.abs(np.diff(q, axis=0))[:, joints_between].sum(axis=1)
    links = norm(np.concatenate([chain.placement[:, :3, 3], chain.flange[None, :3, 3]]))
    reach = links[joints_between].sum() + norm(centre[None])[0] + radius
    return np.asarray(norm(np.diff(point, axis=0)) + turning * radius + 0.25 * turning**2 * reach)


_POSES_AT_ONCE = 4096
"""Poses whose link frames are computed at once: 4096 of them are 4 MB."""


def _largest_displacement(solids: Solids, q: Array, commanded_q: Array) -> Array:
    """Return an upper bound on the displacement of each body (b,) between two sets of joint angles (n, 6) [m].

    It is the displacement of the centre of the body's bounding sphere, plus its rotation times the radius. For the
    difference D of two rotation matrices, the chord 2·sin(angle/2) is the Frobenius norm of D over √2; the arc of so
    short a motion is at most `_ARC_RATIO` times as long.
    """
    chain, displacement = solids.scene.robot.nominal, np.zeros(len(solids.bodies))
    for begin in range(0, len(q), _POSES_AT_ONCE):
        start_frames, end_frames = (
            link_frames(chain, angles[begin : begin + _POSES_AT_ONCE]) for angles in (q, commanded_q)
        )
        for row, (body, (centre, radius)) in enumerate(zip(solids.bodies, solids.spheres, strict=True)):
            if not body.is_fixed:
                change = end_frames[:, body.carrier + 1] - start_frames[:, body.carrier + 1]
                turn = np.sqrt(0.5 * (change[:, :3, :3] ** 2).sum(axis=(1, 2)))
                motion = norm(change[:, :3, :3] @ centre + change[:, :3, 3]) + turn * radius
                displacement[row] = max(displacement[row], float(motion.max()))
    return displacement * _ARC_RATIO


_ARC_RATIO = 1.001
"""An arc of a tenth of a radian is longer than its chord by .04 %."""
