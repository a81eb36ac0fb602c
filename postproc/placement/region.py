"""Where the part should be: places in a region of `$BASE`, evaluated for several programs at once.

A coarse grid over the region, a finer slice around its best place, and a compass search from the best places. A place
is refused if a pose of any program is out of reach, too near to a limit or a singular pose, or too fast for a joint, or
if bodies come too close there. Of the others the one with the smallest expected error is best: the largest over the
cuts, which is what a conversion is judged by. Today's place and the best one are assessed by a conversion there.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import kinematics, toolpath
from postproc.cell import Cell, Frame
from postproc.errors import InputError
from postproc.frames import MM_PER_M, Array, inverse, pose_from_xyzabc, product, wrap_angles
from postproc.kinematics import UnreachableError
from postproc.placement import drive
from postproc.placement.bodies import Bodies
from postproc.placement.drive import FREE, LeastMargins, Margins
from postproc.placement.samples import Load, PathSamples
from postproc.program import Bools, Ints, Program, distinct
from postproc.under_load import RobotInCell

AXES = ("X", "Y", "Z", "A", "E1")
"""Coordinates of a place [mm], A [deg]."""
_STATIONS = 120
"""Number of samples of all programs by which a place is judged; the best place is judged by all samples (assumed)."""
_GRID_COUNTS = {"X": 6, "Y": 6, "Z": 4, "A": 5, "E1": 4}
"""Number of places along each axis of the coarse grid: 720 for X, Y, Z and A together."""
_SLICE_COUNT = 15
"""Number of places along each side of the finer slice (assumed)."""
_START_COUNT, _HALVING_COUNT = 4, 5
"""Number of places from which the compass search starts, and number of times that its steps are halved."""
_FRAME_TOLERANCE = 1e-6
"""Entries of frames [m, 1] that differ by less are equal but for rounding."""
_COORDINATE_TOLERANCE = 1e-9
"""Coordinates of places that differ by less [mm, deg] are equal but for rounding."""
_LEAST_GAIN_SHARE = 1e-3
"""Share of the expected error by which a step of the compass search must lower it."""
_SIMILAR_COST = 0.01
"""Places whose expected errors differ by less than this share are alike: the one with more margin is better."""


class Region(Struct, frozen=True):
    """Bounds (low, high) of each of `AXES` [mm, deg]."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    @property
    def free(self) -> list[int]:
        """Rows of `AXES` that may change."""
        return [k for k in range(len(AXES)) if self.high[k] > self.low[k]]

    def clip(self, place: Array) -> Array:
        """Return the nearest place (5,) in the region."""
        return np.clip(place, self.low, self.high)

    def rounded(self, place: Array) -> Array:
        """Return the nearest place (5,) in the region in whole millimetres and degrees, as a person sets it.

        Coordinates that are not free are not rounded.
        """
        rounded_place = place.copy()
        rounded_place[self.free] = np.round(place[self.free])
        return self.clip(rounded_place)


class Assessment(Struct, frozen=True):
    """Results of a conversion of all programs at a place; of several programs the worst counts.

    :param deflection: largest deflection at cutting targets [m].
    :param uncorrected: largest expected error (95 %) of the programs as read [m]; None if the model states none.
    :param corrected: largest expected error (95 %) of the corrected programs [m]; None if the model states none.
    :param chance: probability that the correction makes the part better; None if nothing is corrected.
    :param problem: why a program cannot be converted there; empty if all can.
    """

    deflection: float = np.nan
    uncorrected: float | None = None
    corrected: float | None = None
    chance: float | None = None
    problem: str = ""

    @property
    def cost(self) -> float:
        """Expected error of the corrected programs, or the deflection if the model states none [m]."""
        return self.deflection if self.corrected is None else self.corrected


class JudgedPlace(Struct, frozen=True):
    """A place, and the judgement of the programs there by samples of their paths.

    :param place: X, Y, Z, A, E1 [mm, deg].
    :param reason: index in `drive.PLACE_REASONS`; 0: the programs can be driven.
    :param deflection: largest deflection on cuts [m]; NaN if refused.
    :param u95: largest expected error (95 %) on cuts [m]; NaN if refused or if the model states none.
    :param margin: smallest distance of a joint to its limits [rad]; NaN out of reach.
    :param singular: smallest singular value of the Jacobian; NaN if refused.
    :param turn: turn of the tool about its axis, added to that of the cell [rad].
    :param branch: branch of the inverse kinematics; −1: not known.
    :param assessment: results of a conversion at this place; None: the programs were not converted there.
    """

    place: tuple[float, ...]
    reason: int
    deflection: float = np.nan
    u95: float = np.nan
    margin: float = np.nan
    singular: float = np.nan
    turn: float = 0.0
    branch: int = -1
    assessment: Assessment | None = None

    @property
    def problem(self) -> str:
        """Why the programs cannot be driven or converted; empty if they can."""
        if self.reason != FREE:
            return drive.PLACE_REASONS[self.reason]
        return "" if self.assessment is None else self.assessment.problem

    @property
    def reachable(self) -> bool:
        """Whether the programs can be driven, and converted if this was tried."""
        return not self.problem

    @property
    def cost(self) -> float:
        """Expected error at the samples, or the deflection if the model states none [m]; infinite if refused."""
        if not self.reachable:
            return np.inf
        return self.deflection if np.isnan(self.u95) else self.u95

    @property
    def stated_cost(self) -> float:
        """Cost by the conversion at this place; by samples if the programs were not converted, infinite if refused."""
        return self.cost if self.assessment is None or not self.reachable else self.assessment.cost


class Search(Struct, frozen=True, eq=False):
    """The places that were tried.

    :param today: the place of the cell.
    :param best: the best place; None if all are refused.
    :param trials: all places that were tried; first those of the grid, then those of the finer slice.
    :param slice: X and Y of the finer slice, at the Z, A and E1 of `slice_place`; empty if X or Y is fixed.
    :param slice_place: place that the slice contains.
    :param refusals: places that can be driven by stations, but were refused by all samples or by a conversion.
    """

    today: JudgedPlace
    best: JudgedPlace | None
    trials: tuple[JudgedPlace, ...]
    slice: tuple[tuple[float, ...], tuple[float, ...]]
    slice_place: tuple[float, ...]
    refusals: tuple[JudgedPlace, ...] = ()


class _Stations(Struct, frozen=True, eq=False):
    """Samples of one program by which places are judged.

    :param samples: all samples of the program.
    :param row: (n,) rows of the stations among these, and `before` (n,) rows of the samples before them.
    :param shift: (2n, 3) displacement of the robot by E1 [m]: first at `before`, then at the stations.
    :param branch: (2n,) branches that the program states, in the same order; −1: the branch of the start.
    :param is_at_feed: (n,) True on motions at feed, False on rapid moves.
    :param first_joints: (k, 6) joint targets before the first station [rad].
    """

    samples: PathSamples
    row: Ints
    before: Ints
    shift: Array
    branch: Ints
    is_at_feed: Bools
    first_joints: Array

    @property
    def shift_at_stations(self) -> Array:
        """(n, 3) displacement of the robot by E1 at the stations [m]."""
        return self.shift[len(self.row) :]


class _JointPath(NamedTuple):
    """The joint angles of a program at its stations.

    :param q: (n, 6) joint angles [rad]; NaN out of reach.
    :param reason: first reason in `drive.REASONS` to refuse a station; `FREE`: no station is refused.
    :param margin: smallest distance of a joint to its limits [rad]; NaN if no station is in reach.
    """

    q: Array
    reason: int
    margin: float


class _Errors(NamedTuple):
    """The errors of a program at its stations that cut.

    :param deflection: the largest deflection [m]; NaN without equilibrium.
    :param u95: the largest expected error (95 %) [m]; NaN if the model states none.
    :param singular: the smallest singular value of the Jacobian at all stations.
    """

    deflection: float
    u95: float
    singular: float


class Programs:
    """Several programs in one cell, to be judged at places."""

    def __init__(
        self,
        samples: Sequence[PathSamples],
        keep: LeastMargins,
        *,
        turns: bool = False,
        clearance_mm: float | None = None,
    ) -> None:
        """Choose the stations.

        :param samples: samples of the path of each program.
        :param keep: margins that a place must keep.
        :param turns: whether the tool may be turned about its axis, by the angles `drive.TRIED_TURNS`.
        :param clearance_mm: smallest allowed distance of the bodies of [collision]; None: they are not compared.
        :raises CellError: a body cannot be read.
        """
        self.samples, self.keep = list(samples), keep
        self.robot_in_cell = samples[0].robot_in_cell
        self.robot = self.robot_in_cell.robot
        self.root_in_base = inverse(self.robot_in_cell.cell.base.pose())
        self.turns = drive.TRIED_TURNS if turns else np.zeros(1)
        self.branch = int(kinematics.closed_form(self.robot).branch_of(self.robot_in_cell.cell.start_joints[None])[0])
        self.bodies = None if clearance_mm is None else [Bodies(item, clearance_mm) for item in samples]
        total = sum(len(item) for item in samples)  # stations are in proportion to samples, at least 24 of a program
        self.station_choice = [_stations(item, max(24, _STATIONS * len(item) // total)) for item in samples]
        self.full_stations = [_stations(item, len(item)) for item in samples]

    def judge(self, place: Array, *, all_samples: bool = False) -> JudgedPlace:
        """Return the judgement of a place (5,) [mm, deg] with the best turn of the tool about its axis.

        The tool keeps the turn of the cell if the programs can be driven with it, and no other turn saves enough. If no
        turn can be driven, the judgement with the last reason in the order of `drive.PLACE_REASONS` is returned.

        :param all_samples: judge by every sample of the programs; else by some stations of them.
        """
        best: JudgedPlace | None = None
        cell_turn: JudgedPlace | None = None
        nearest = JudgedPlace(tuple(map(float, place)), drive.REACH)  # of the refused turns, the one refused last
        for turn in self.turns.tolist():
            judgement = self._judge(
                place, turn, self.branch, self.full_stations if all_samples else self.station_choice
            )
            if judgement.reachable:
                best = judgement if best is None or _is_better(judgement, best) else best
                cell_turn = judgement if turn == 0.0 else cell_turn
            elif judgement.reason > nearest.reason or np.isnan(nearest.margin):
                nearest = judgement
        if best is not None and cell_turn is not None and cell_turn.cost <= (1.0 + drive.LEAST_SAVING) * best.cost:
            return cell_turn
        return nearest if best is None else best

    def _judge(self, place: Array, turn: float, branch: int, stations: Sequence[_Stations]) -> JudgedPlace:
        """Return the judgement of a place (5,) [mm, deg]: the first reason to refuse it, or its largest expected error.

        :param turn: turn of the tool about its axis, added to that of the cell [rad].
        :param branch: branch of the inverse kinematics at the start.
        :param stations: stations of each program.
        """
        base_motion, e1_shift = self._motion_to(place)
        coordinates = tuple(map(float, place))
        joint_paths: list[tuple[_Stations, Array]] = []
        margin = np.inf
        for group in stations:
            path = self._joint_path(group, base_motion, e1_shift, turn, branch)
            margin = min(margin, path.margin)
            if path.reason != FREE:
                return JudgedPlace(coordinates, path.reason, margin=path.margin, turn=turn, branch=branch)
            joint_paths.append((group, path.q))
        if self.bodies is not None:
            for bodies, (group, q) in zip(self.bodies, joint_paths, strict=True):
                reason = self._collision_reason(bodies, group, q, base_motion, e1_shift)
                if reason != FREE:
                    return JudgedPlace(coordinates, reason, margin=margin, turn=turn, branch=branch)
        deflection = u95 = 0.0
        singular = np.inf
        for group, q in joint_paths:
            errors = self._errors(group, base_motion, e1_shift, turn, q)
            if not np.isfinite(errors.deflection):
                return JudgedPlace(coordinates, drive.SINGULAR, margin=margin, turn=turn, branch=branch)
            # np.maximum keeps NaN: without a bound for one program there is none for all
            deflection, u95 = max(deflection, errors.deflection), float(np.maximum(u95, errors.u95))
            singular = min(singular, errors.singular)
        return JudgedPlace(coordinates, FREE, deflection, u95, margin, singular, turn, branch)

    def _motion_to(self, place: Array) -> tuple[Array, Array]:
        """Return the motion (4, 4) of the part from its place in the cell and the displacement (3,) by E1 in the root.

        :param place: (5,) X, Y, Z, A and E1 [mm, deg].
        """
        base = self.robot_in_cell.cell.base
        pose = pose_from_xyzabc([*place[:4], base.B, base.C])
        direction = self.robot_in_cell.cell.carriage
        return pose @ self.root_in_base, np.zeros(3) if direction is None else direction * (place[4] / MM_PER_M)

    def _joint_path(
        self, group: _Stations, base_motion: Array, e1_shift: Array, turn: float, branch: int
    ) -> _JointPath:
        """Return the joint angles at stations, and the first reason to refuse one of them.

        Stations are the samples of a program by which a place is judged.

        :param base_motion: (4, 4) motion of `$BASE` that the place makes, root axes [m].
        :param e1_shift: (3,) displacement of the robot by E1 at the place [m].
        :param turn: turn of the tool about its axis [rad].
        :param branch: branch of the inverse kinematics at the start.
        """
        flange = product(base_motion, self._flange(group, turn))
        flange[:, :3, 3] -= group.shift + e1_shift
        states_branch = group.branch >= 0
        branches = np.where(states_branch, group.branch, branch)
        is_one_branch = bool((branches == branches[0]).all())
        # first the n samples before the stations, then the n stations; one branch for all is solved faster
        q = drive.solve(self.robot, kinematics.components(flange), int(branches[0]) if is_one_branch else branches)
        margins, count = drive.margins(self.robot, q), len(group.row)
        step = np.nan_to_num(wrap_angles(q[:, count:] - q[:, :count]))  # to each station from the sample before it
        speed = drive.largest_speed_share(self.robot, step, group.samples.time[group.row])
        # on joint interpolations and rapid moves, whose time is infinite, joints may turn as far as they like
        jump = np.where(np.isfinite(group.samples.time[group.row]), np.abs(step).max(axis=0), 0.0)
        at_stations = Margins(*(getattr(margins, name)[count:] for name in Margins.__struct_fields__))
        reasons = drive.reason(at_stations, speed, jump, self.keep)
        margin = float(np.nanmin(at_stations.joint, initial=np.inf))
        # whole turns can be counted where all samples are stations and no target states joint angles
        if count == len(group.samples) and np.isnan(group.samples.program.motions.joints).all():
            reasons[self._winds_past_limits(q[:, count:])] = drive.LIMIT
        violations = reasons[reasons != FREE]
        return _JointPath(
            q=q[:, count:].T,
            reason=int(violations.min()) if len(violations) else FREE,
            margin=margin if np.isfinite(margin) else np.nan,
        )

    @cache  # noqa: B019 - lives as long as the search
    def _flange(self, group: _Stations, turn: float) -> Array:
        """Return the flanges (2n, 4, 4) before stations and at them, in the root at E1 = 0."""
        rows = np.append(group.before, group.row)
        flange = group.samples.flange(rows, np.full(len(rows), turn))
        flange[:, :3, 3] += group.shift
        return flange

    @cache  # noqa: B019
    def _load(self, group: _Stations, turn: float) -> Load:
        """Return the loads of the stations that cut, in the root at E1 = 0.

        :param turn: turn of the tool about its axis [rad].
        """
        rows = group.row[group.is_at_feed]
        load = group.samples.load(rows, np.full(len(rows), turn))
        load.pose[:, :3, 3] += group.shift_at_stations[group.is_at_feed]
        return load

    def _collision_reason(self, bodies: Bodies, group: _Stations, q: Array, base_motion: Array, e1_shift: Array) -> int:
        """Return the reason to refuse a place if bodies come too close at stations or on the way to them; else `FREE`.

        If the stations are all samples of a program, bodies are compared between them too.

        :param q: (n, 6) joint angles at the stations [rad].
        :param base_motion: (4, 4) motion of `$BASE` that the place makes, root axes [m].
        :param e1_shift: (3,) displacement of the robot by E1 at the place [m].
        """
        count = len(group.row)
        shift = group.shift_at_stations + e1_shift
        if bodies.is_closer(q, group.row, shift, base_motion):
            return drive.COLLISION
        approach = np.concatenate([self.robot_in_cell.cell.start_joints[None], group.first_joints])
        # stations that are not all samples are no path: bodies are compared along the move to the first one only
        path_count = count if count == len(group.samples) else 1
        path = np.concatenate([approach, q[:path_count]])
        rows = np.append(np.full(len(approach), group.row[0]), group.row[:path_count])
        shift = np.concatenate([np.repeat(shift[:1], len(approach), axis=0), shift[:path_count]])
        breaks = np.zeros(len(path), dtype=bool)
        is_hit = bodies.is_hit_along_path(path, rows, breaks, shift, base_motion)
        if is_hit[len(approach) + 1 :].any():
            return drive.COLLISION
        return drive.FIRST_MOVE if is_hit.any() else FREE

    def _winds_past_limits(self, q: Array) -> Bools:
        """Return True for samples (n,) of a whole program at which A4 or A6 has wound past its limits since the start.

        :param q: (6, n) joint angles without whole turns [rad]; NaN where the robot does not reach. A step to or from
            such a sample counts as no turn: the place is refused for it anyway.
        """
        joints = list(drive.WINDING_JOINTS)
        start = self.robot_in_cell.cell.start_joints[joints, None]
        steps = np.nan_to_num(wrap_angles(np.diff(q[joints], axis=1, prepend=start)))
        angle = start + np.cumsum(steps, axis=1)
        low, high = self.robot.lower[joints, None] + self.keep.joint, self.robot.upper[joints, None] - self.keep.joint
        return np.asarray(((angle < low) | (angle > high)).any(axis=0))

    def _errors(self, group: _Stations, base_motion: Array, e1_shift: Array, turn: float, q: Array) -> _Errors:
        """Return the largest errors at stations that cut; 0 if none cuts.

        :param base_motion: (4, 4) motion of `$BASE` that the place makes, root axes [m].
        :param e1_shift: (3,) displacement of the robot by E1 at the place [m].
        :param turn: turn of the tool about its axis [rad].
        :param q: (n, 6) joint angles at the stations [rad].
        """
        cut_rows = np.flatnonzero(group.is_at_feed)
        samples = group.samples
        tool = toolpath.tool_of(samples.program, samples.sample.motion[group.row])
        singular = float(kinematics.smallest_singular_values(self.robot, q, tool).min())
        if not len(cut_rows):
            return _Errors(deflection=0.0, u95=0.0, singular=singular)
        load = self._load(group, turn)
        rotation = base_motion[:3, :3]
        wrench = (load.wrench.reshape(-1, 2, 3) @ rotation.T).reshape(-1, 6)  # force and moment each turn
        spread = load.spread
        if spread is not None:
            spread = (rotation @ spread.reshape(len(spread), 2, 3, -1)).reshape(spread.shape)
        pose = product(base_motion, load.pose)
        pose[:, :3, 3] -= group.shift_at_stations[cut_rows] + e1_shift
        u95, deflection = drive.errors(
            self.robot_in_cell,
            q[cut_rows],
            tool if tool.ndim == 2 else tool[cut_rows],
            Load(wrench, spread, pose, load.is_scaled),
        )
        return _Errors(float(deflection.max()), float(u95.max()), singular)


def _stations(samples: PathSamples, max_count: int) -> _Stations:
    """Return stations of a program: samples evenly along its path, and the samples with the extreme coordinates.

    :param max_count: largest number of even samples.
    """
    m = samples.program.motions
    motion = samples.sample.motion
    cartesian_rows = np.flatnonzero(np.isnan(m.joints[motion, 0]))  # not on moves to joint angles
    position = samples.sample.pose.position[cartesian_rows]
    even_rows = np.linspace(0, len(cartesian_rows) - 1, min(max_count, len(cartesian_rows))).astype(np.int64)
    extreme_rows = np.concatenate([position.argmin(axis=0), position.argmax(axis=0)])
    row = cartesian_rows[distinct(np.append(even_rows, extreme_rows))]
    previous = np.maximum(row - 1, 0)
    pair_rows = np.append(previous, row)
    carriage = samples.program.carriage
    shift = np.zeros((len(pair_rows), 3))
    if carriage is not None:
        shift = carriage.offset(motion[pair_rows], samples.sample.t[pair_rows])
    branch = np.full(len(pair_rows), -1)  # −1: the branch of the start
    if (m.status >= 0).any():
        try:
            joint_path = samples.robot_in_cell.follow(samples.program, motion, samples.sample.t, samples.sample.pose)
            branch = joint_path.branch[pair_rows]
        except UnreachableError:
            pass  # the status of targets cannot be resolved at the place of the cell: the branch of the start is taken
    first_joints = m.joints[: motion[row[0]]]
    return _Stations(samples, row, previous, shift, branch, np.asarray(samples.is_at_feed[row]), first_joints)


def numbers_of_base(cell: Cell) -> tuple[str, ...]:
    """Return the numbers n of `[base_data.n]` that state the same frame as `[base]`: they move with it.

    There are none if the cell names a `$config.dat`: its frames stay as they are.
    """
    if cell.config_dat is not None:
        return ()
    base = cell.base.pose()
    return tuple(n for n, frame in cell.base_data.items() if np.abs(frame.pose() - base).max() < _FRAME_TOLERANCE)


def has_base(program: Program, frame: Frame) -> bool:
    """Return whether a frame is among the `$BASE` of a program."""
    return bool((np.abs(program.bases - frame.pose()).max(axis=(1, 2)) < _FRAME_TOLERANCE).any())


def check_base(program: Program, robot_in_cell: RobotInCell, shifted_program: Program | None = None) -> None:
    """Check that a program is in the `$BASE` of the cell, and moves with it.

    :param shifted_program: the program as it is read with another `[base]`; None: programs of its dialect set no
        frames.
    :raises InputError: the program has frames that do not move with `[base]` of the cell.
    """
    base, m = robot_in_cell.cell.base.pose(), program.motions
    # frames that are equal today are one row of `bases`, also where one of them moves with the cell and another stays
    second_program = program if shifted_program is None else shifted_program
    pairs = np.stack([m.base, second_program.motions.base], axis=1)
    cartesian = np.flatnonzero(~np.isfinite(m.joints[:, 0]))  # joint angles are in no frame
    for row, second_row in np.unique(pairs[cartesian], axis=0).tolist():
        first = cartesian[np.argmax((pairs[cartesian] == (row, second_row)).all(axis=1))]
        shift = np.abs(second_program.bases[second_row] - program.bases[row]).max()
        # a frame that is the same with both `[base]` does not move with it
        stays = shifted_program is not None and shift < _FRAME_TOLERANCE
        if stays or np.abs(program.bases[row] - base).max() > _FRAME_TOLERANCE:
            raise InputError(
                f"line {program.motions.line[first]}: the motions are in a $BASE that the program sets itself: they "
                "would not move with [base] of the cell",
                file=program.documents[0].name,
                advice="Give [base] the numbers of the [base_data.n] that the program uses (without config_dat): it "
                "moves with [base] then. Or remove what sets $BASE and let [base] give it ([krl] initmov).",
            )


def _is_better(place: JudgedPlace, rival: JudgedPlace) -> bool:
    """Return whether a place is better than another: by a smaller error, or by more margin if errors are similar."""
    if (
        place.reachable
        and rival.reachable
        and abs(place.cost - rival.cost) <= _SIMILAR_COST * min(place.cost, rival.cost)
    ):
        return place.margin > rival.margin
    return place.cost < rival.cost


Assess = Callable[[JudgedPlace], Assessment]
"""Converts the programs at a place."""


def search(
    programs: Programs,
    region: Region,
    progress: Callable[[int, int], None] | None = None,
    assess: Assess | None = None,
) -> Search:
    """Return the places tried in a region, and the best of them.

    They are a grid, a finer slice through its best place, and steps from the best places of both. Today's place, the
    [base] of the cell, stays if it is in the region and no other place saves enough.

    :param progress: called with the number of places done and their expected total; None: not called.
    :param assess: converts the programs at today's place and at the best place; None: samples decide.
    """
    cell = programs.robot_in_cell.cell
    e1 = 0.0
    today = programs.judge(np.array([cell.base.X, cell.base.Y, cell.base.Z, cell.base.A, e1]), all_samples=True)
    today = _assess(today, assess)
    lines = _grid_lines(region)
    grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, len(AXES))
    has_slice = {0, 1} <= set(region.free)
    total = len(grid) + (_SLICE_COUNT**2 if has_slice else 0)
    judgements: list[JudgedPlace] = []

    def judged(place: Array) -> JudgedPlace:
        """Return the judgement of a place by stations; append it to the list, and report the progress."""
        judgements.append(programs.judge(place))
        if progress is not None:
            progress(min(len(judgements), total), total)
        return judgements[-1]

    for place in grid:
        judged(place)
    best_of_grid = min(judgements, key=lambda place: place.cost)
    middle = np.array([0.5 * (low + high) for low, high in zip(region.low, region.high, strict=True)])
    slice_centre = np.array(best_of_grid.place) if best_of_grid.reachable else middle
    x = y = np.zeros(0)
    if has_slice:
        x, y = (np.linspace(region.low[k], region.high[k], _SLICE_COUNT) for k in (0, 1))
        for place_x, place_y in itertools.product(x, y):
            judged(np.array([place_x, place_y, *slice_centre[2:]]))
    starts = sorted((place for place in judgements if place.reachable), key=lambda place: place.cost)[:_START_COUNT]
    # half of the steps of the grid; 0 along an axis that is not free
    steps = np.array([0.5 * float(np.diff(line[:2]).sum()) for line in lines])
    for start in starts:
        _compass_search(judged, region, start, steps)
    best, refusals = _best_by_conversion(programs, region, judgements, assess)
    limit = np.inf if best is None else (1.0 + drive.LEAST_SAVING) * best.stated_cost
    if _contains(region, today) and today.reachable and today.stated_cost <= limit:
        best = today
    slice_lines = tuple(x.tolist()), tuple(y.tolist())
    return Search(today, best, tuple(judgements), slice_lines, tuple(slice_centre.tolist()), refusals)


def _grid_lines(region: Region) -> list[Array]:
    """Return the coordinates of the grid along each of the five axes [mm, deg]; an axis that is not free has one."""
    return [
        np.linspace(region.low[k], region.high[k], _GRID_COUNTS[axis])
        if k in region.free
        else np.array([region.low[k]])
        for k, axis in enumerate(AXES)
    ]


def _assess(place: JudgedPlace, assess: Assess | None) -> JudgedPlace:
    """Return a place with the assessment of a conversion there, if the programs can be driven."""
    return place if assess is None or not place.reachable else replace(place, assessment=assess(place))


def _compass_search(judge: Callable[[Array], JudgedPlace], region: Region, start: JudgedPlace, steps: Array) -> None:
    """Move from `start` to better neighbours along the axes as long as there are any; then halve the steps.

    :param judge: judges a place (5,), and records the judgement.
    :param steps: (5,) first steps along each axis [mm, deg].
    """
    best, free = start, region.free
    for _ in range(_HALVING_COUNT):
        is_improving = True
        while is_improving:
            is_improving = False
            for k in free:
                neighbour = _better_neighbour(judge, region, best, k, float(steps[k]))
                if neighbour is not None:
                    best, is_improving = neighbour, True
        steps = 0.5 * steps


def _better_neighbour(
    judge: Callable[[Array], JudgedPlace], region: Region, place: JudgedPlace, k: int, step: float
) -> JudgedPlace | None:
    """Return the first of two neighbours of a place that is clearly better; None if neither is.

    :param judge: judges a place (5,), and records the judgement.
    :param k: row of `AXES` along which the neighbours are.
    :param step: distance of the neighbours, up and down [mm, deg].
    """
    for sign in (1.0, -1.0):
        coordinates = np.array(place.place)
        coordinates[k] += sign * step
        coordinates = region.rounded(coordinates)
        if abs(coordinates[k] - place.place[k]) < _COORDINATE_TOLERANCE:  # at the bound of the region
            continue
        neighbour = judge(coordinates)
        if neighbour.cost < (1.0 - _LEAST_GAIN_SHARE) * place.cost:
            return neighbour
    return None


def _contains(region: Region, place: JudgedPlace) -> bool:
    """Return whether a place is in a region."""
    return bool(np.allclose(region.clip(np.array(place.place)), place.place, rtol=0.0, atol=_COORDINATE_TOLERANCE))


_MAX_CHECKS = 200
"""Largest number of places that are judged by all samples until one can be driven (assumed)."""
_MAX_ASSESSMENTS = 40
"""Largest number of places at which the programs are converted until all can be (assumed)."""
_MAX_EQUAL_PROBLEMS = 8
"""Largest number of places at which the programs are converted if the problem is the same each time: then it does not
depend on the place (assumed)."""
_NEIGHBOURHOOD, _CONVERSION_NEIGHBOURHOOD = 1.0 / 30.0, 1.0 / 10.0
"""Share of the region around a place, along every axis, that is taken to be refused with it: by samples, and by a
conversion, which takes longer (assumed)."""


def _best_by_conversion(
    programs: Programs, region: Region, judgements: Sequence[JudgedPlace], assess: Assess | None
) -> tuple[JudgedPlace | None, tuple[JudgedPlace, ...]]:
    """Return the best place by all samples at which the programs can be converted, and the places refused before it.

    The place is one that was judged by stations, rounded to whole millimetres and degrees as a person sets it.
    Neighbours of a refused place are not tried. None: too many places are refused, see `_MAX_CHECKS`.

    :param judgements: places judged by stations.
    :param assess: converts the programs at a place; None: samples decide.
    """
    reachable = sorted((place for place in judgements if place.reachable), key=lambda place: place.cost)
    similar = [place for place in reachable if place.cost <= (1.0 + _SIMILAR_COST) * reachable[0].cost]
    order = sorted(similar, key=lambda place: -place.margin) + [place for place in reachable if place not in similar]
    span = np.subtract(region.high, region.low)[region.free]
    refusals: list[JudgedPlace] = []
    problems: list[str] = []  # of the places at which the programs were converted
    for place in order:
        if any(_is_neighbour(region, span, place, refusal) for refusal in refusals):
            continue
        judgement = programs.judge(region.rounded(np.array(place.place)), all_samples=True)
        if judgement.reachable:
            judgement = _assess(judgement, assess)
            if judgement.reachable:
                return judgement, tuple(refusals)
            problems.append(judgement.problem)
        refusals.append(judgement)
        is_everywhere = len(problems) >= _MAX_EQUAL_PROBLEMS and len(set(problems)) == 1
        if len(refusals) >= _MAX_CHECKS or len(problems) >= _MAX_ASSESSMENTS or is_everywhere:
            break
    return None, tuple(refusals)


def _is_neighbour(region: Region, span: Array, place: JudgedPlace, refusal: JudgedPlace) -> bool:
    """Return whether a place is so near to a refused one that it is taken for refused too.

    :param span: (k,) extent of the region along the k free axes [mm, deg].
    """
    share = _NEIGHBOURHOOD if refusal.assessment is None else _CONVERSION_NEIGHBOURHOOD
    gap = np.abs(np.subtract(place.place, refusal.place))[region.free]
    return bool((gap < share * span).all())
