"""Verification: the written program is read back by its reader, and its printed numbers move the loaded arm."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc import toolpath
from postproc.chunks import Columns, chunks
from postproc.correction import checks, inspection
from postproc.correction.targets import TargetSelection, corners_of_motions
from postproc.dialects import registry
from postproc.errors import Issue, Level, NotConvergedError, PostprocError, ProgramError
from postproc.forces import BEHIND_STEP
from postproc.frames import MM_PER_M, Array, norm, twist_between
from postproc.poses import largest_differences
from postproc.program import CIRC, Bools, Ints, Modules, Program, Targets, WrittenProgram
from postproc.simulation import DrivenProgram, number_of_places
from postproc.toolpath import Segments
from postproc.under_load import ImpossiblePathError, MotionsUnderLoad, PathUnderLoad, led_by_wrist

_PRECISION = 1e-6
"""Largest rounding of a commanded pose [m, rad] or a speed [m/s] by printing; the text has at least 1e-4 mm, 1e-5° and
1e-3 mm/s."""

_MODULE_GAP = 1e-5
"""Largest gap between the end of a module and the begin of the next [m, rad]: joint angles have 5 decimals."""


class UnusableTextError(PostprocError):
    """The written program must not be released; `issue` says why."""

    def __init__(self, issue: Issue) -> None:
        super().__init__(issue.message)
        self.issue = issue


class ReadBackProgram(Struct, frozen=True, eq=False):
    """A written program of K targets as its text says.

    :param text: as written.
    :param program: as read, without its text.
    :param segments: the geometry of its motions.
    :param row: (K,) motion that ends at each target.
    :param numbers: (K, 6) X, Y, Z, A, B, C of the targets as printed in the text [mm, deg].
    """

    text: WrittenProgram
    program: Program
    segments: Segments
    row: Ints
    numbers: Array


def read_back(path: PathUnderLoad, selection: TargetSelection, text: WrittenProgram) -> ReadBackProgram:
    """Read a written program with the reader of its dialect, and check that it has the chosen targets.

    :raises UnusableTextError: it cannot be read, or has other targets.
    """
    robot_in_cell, targets = path.robot_in_cell, selection.targets
    try:
        reader = registry.dialect_of_name(text.dialect)
        output_program = reader.read(text.documents, robot_in_cell.cell, robot_in_cell.forward, path.program.name)
        output_program = led_by_wrist(output_program, robot_in_cell)
    except ProgramError as cause:
        message = (
            f"the written program cannot be read back ({cause.problem}: {cause.text or ''!r}). If this is a line of "
            f"[gcode] in the cell, write it there in {text.dialect}; else it is a fault of postproc, please report it."
        )
        raise UnusableTextError(Issue("error", "read-back", message, output_line=cause.line)) from cause
    except ImpossiblePathError as cause:
        raise UnusableTextError(cause.issue) from cause
    row = np.flatnonzero(np.isnan(output_program.motions.joints[:, 0]))  # motions without an axis target
    numbers = output_program.numbers_as_written()[row]
    output_program = replace(output_program, documents=(), layout=None)
    mismatch = _mismatch(path.program, targets, output_program, row)
    if mismatch is not None:
        raise UnusableTextError(mismatch)
    if text.modules is not None and (
        module_name := _first_differing_module(path, output_program, row, text.modules, text.dialect)
    ):
        message = (
            f"{module_name} moves differently from the program in one piece: a fault of postproc, please report it"
        )
        raise UnusableTextError(Issue("error", "read-back", message))
    return ReadBackProgram(
        text, output_program, toolpath.segments(output_program, robot_in_cell.start_flange), row, numbers
    )


def _first_differing_module(
    path: PathUnderLoad, undivided_program: Program, row: Ints, modules: Modules, dialect: str
) -> str | None:
    """Return the name of the first module that differs from the program in one piece; None if all are equal.

    Modules are programs that are run one after another in place of one that is too large for the controller. Motions,
    `$BASE` and `$TOOL` must be equal to the last digit. Each module must begin at an exact stop, where the one before
    ends.

    :param undivided_program: the program in one piece, as read.
    :param row: (K,) its motions that end at targets.
    :param modules: the modules that were written for it.
    """
    robot_in_cell, m = path.robot_in_cell, undivided_program.motions
    # the first motion of each further module moves to the last target of the module before
    begins = [0, *(int(row[first_target - 1]) for first_target in modules.first[1:])]
    fields = [name for name in m.__struct_fields__ if name not in ("line", "base", "tool")]
    for document, begin, end in zip(modules.documents, begins, [*begins[1:], len(m) - 1], strict=True):
        try:
            module = registry.dialect_of_name(dialect).read(
                (document,), robot_in_cell.cell, robot_in_cell.forward, "module"
            )
        except ProgramError:
            return document.name
        module_motions, rows = led_by_wrist(module, robot_in_cell).motions, np.arange(begin, end + 1)
        # of the first motion, which comes from [start], only the target is compared, with a tolerance
        pairs = [(getattr(module_motions, name)[1:], getattr(m, name)[rows[1:]]) for name in fields]
        pairs += [
            (module.bases[module_motions.base], undivided_program.bases[m.base[rows]]),
            (module.tools[module_motions.tool], undivided_program.tools[m.tool[rows]]),
        ]
        is_equal = all(np.array_equal(module_column, column, equal_nan=True) for module_column, column in pairs)
        begins_at_end = np.abs(module_motions.target[:1] - m.target[rows[:1]]).max() <= _MODULE_GAP
        if not (is_equal and begins_at_end and m.blend[begin] == 0.0):
            return document.name
    return None


def _other_track_position(program: Program, targets: Targets, output_program: Program, row: Ints) -> Bools:
    """Return at which targets (K,) the linear axis of the program as read back is not where it should be.

    :param row: (K,) motion of the program as read back that ends at each target.
    """
    if program.carriage is None or output_program.carriage is None:  # wrong everywhere if only one has the axis
        return np.full(len(targets), program.carriage is not output_program.carriage)
    carriage = program.carriage.at(targets.motion, targets.t)
    return np.asarray(np.abs(output_program.carriage.at(row) - carriage) > _PRECISION)


def _mismatch(program: Program, targets: Targets, output_program: Program, row: Ints) -> Issue | None:
    """Return an error if the program as read back differs from the one that was to be written, else None.

    :param row: (K,) motion of the program as read back that ends at each target.
    """
    m, nominal = output_program.motions, program.motions
    if len(row) != len(targets):
        return Issue("error", "read-back", f"the written program has {len(row)} targets instead of {len(targets)}")
    differs = (m.kind[row] != targets.kind) | (largest_differences(m.target.take(row), targets.pose) > _PRECISION)
    # frames (f, 4, 4) [m] of both programs, and the row in them that each target (K,) has
    for frames, expected_frames, row_of_target, expected_row in (
        (output_program.bases, program.bases, m.base[row], nominal.base[targets.motion]),
        (output_program.tools, program.tools, m.tool[row], nominal.tool[targets.motion]),
    ):
        frames_differ = np.abs(twist_between(frames[:, None], expected_frames[None])).max(axis=2) > _PRECISION
        differs |= frames_differ[row_of_target, expected_row]
    differs |= np.abs(m.feed[row] - nominal.feed[targets.motion]) > _PRECISION  # of PTP it is NaN, which is not more
    differs |= _other_track_position(program, targets, output_program, row)
    if differs.any():
        first = int(np.argmax(differs))
        line = int(program.motions.line[targets.motion[first]])
        return Issue(
            "error",
            "read-back",
            "the written program reads differently from what was computed: a fault of postproc, please report it",
            source_line=line,
            count=int(differs.sum()),
        )
    return None


_SPEED_SHARE = 0.75
"""Share of a joint's largest speed from which on the written path is examined closely (assumed)."""
_LEAST_TRAVEL = 1e-6
"""Pieces shorter than this [m] have no speed (assumed)."""
_TARGET_TOLERANCE = 1e-6
"""Largest distance of the tip from nominal at a target of a corrected program [m], including rounding."""
_SAFE_SHARE = 0.8
"""Share of the tolerance allowed at the places examined: the error may be slightly larger between them (assumed)."""
_STEEP_CHANGE = 2e-4
"""Runs over which the correction changes by more than this [m] are examined between their ends (assumed)."""
_UNEVEN_SHARE = 0.2
"""Share of the tolerance by which the displacement may vary along a piece of an arc; pieces with more are examined as
often as steep runs, others at middle and end (assumed)."""
_JUMP_LENGTH = 1e-6
"""Length of a piece [m] on which a change of force is a jump: it is not divided further (assumed)."""
_SAME_SAMPLE = 1e-10
"""Places of a motion (t) that are no farther apart are the same (assumed)."""

_STEP_MESSAGE = (
    "the force changes abruptly from the end of the move before to the start of this one: the tool leaves its path by "
    f"up to {{left}} for {BEHIND_STEP * MM_PER_M:g} mm, until the correction follows. Give the same force at the start "
    "of the move (t = 0) as at the end of the one before, or one force without t, which rises over force_ramp_mm."
)
_JUMP_MESSAGE = (
    "the force jumps within this move, as one in FEED axes does where the travel passes the direction of the spindle: "
    "an error of {left} remains (allowed {allowed}), however close the targets. Divide the move there and give each "
    "part its force, or give the force in BASE or TOOL axes."
)
_TARGET_MESSAGE = f"the simulated program misses a target by {{left}} (allowed {_TARGET_TOLERANCE * MM_PER_M:g} mm)"
_PATH_MESSAGE = "the simulated program leaves its path between targets by {left} (allowed {allowed})"


class Exceedances(NamedTuple):
    """Places where the path error uses too much of the tolerance, and more targets may help.

    :param motion: (n,) row of `Motions`.
    :param t: (n,) place on that motion.
    :param distance: (n,) of the tip from the path [m].
    """

    motion: Ints
    t: Array
    distance: Array


class SimulatedPath(Struct, frozen=True, eq=False):
    """Simulated path of the written program.

    :param text: as written.
    :param numbers: (K, 6) X, Y, Z, A, B, C as printed in the text [mm, deg].
    :param deviation: (K, 3) predicted tip minus nominal position at each target, `$BASE` [m].
    :param path_distance: (K,) largest distance from the nominal path on the way to each target [m], where correction
        was possible.
    :param rounding: (K,) how far approximate positioning passes each target [m].
    :param exceedances: places where more targets may help.
    :param issues: why the program must not be released (level error), or what to look at.
    """

    text: WrittenProgram
    numbers: Array
    deviation: Array
    path_distance: Array
    rounding: Array
    exceedances: Exceedances
    issues: tuple[Issue, ...]

    @property
    def largest_path_distance(self) -> float:
        """Largest distance from the nominal path anywhere looked at [m]."""
        return float(self.path_distance.max(initial=0.0))


class _Probes(Columns, frozen=True, eq=False):
    """The n places of the written program at which its path error is computed.

    :param target: (n,) row of the target at the end of the piece.
    :param share: (n,) place on the piece, in (0, 1].
    :param motion: (n,) motion of the nominal program, and `t` (n,) the place on it.
    """

    target: NDArray[np.int32]
    share: Array
    motion: Ints
    t: Array

    @property
    def is_inside(self) -> Bools:
        """(n,) True before the end of the piece."""
        return np.asarray(self.share < 1.0)


def simulate(
    path: PathUnderLoad, selection: TargetSelection, theta: Array, readback: ReadBackProgram, *, is_corrected: bool
) -> SimulatedPath:
    """Simulate a written program against the nominal path of the program it was made from.

    :param selection: what was to be written.
    :param theta: (N, nv) deflections of the springs as computed: where the search for those of the text begins.
    :param readback: the program as written.
    :param is_corrected: the program claims to hold the tolerance.
    :raises UnusableTextError: it cannot be simulated.
    """
    targets, output_motions, tolerance = selection.targets, readback.program.motions, path.robot_in_cell.tolerance
    rounding = corners_of_motions(readback.program, readback.segments, readback.row).rounding(
        output_motions.blend[readback.row]
    )
    probes = _probes(path, selection, readback)
    deviation, distance, near_limit = _deviation(path, selection, theta, readback, probes)
    too_fast = tuple(_joint_speed_issues(path, selection, readback)) if near_limit else ()
    is_behind_step, is_inside_jump, is_judged = _conditions_of_probes(path, targets, probes)
    issues: list[Issue] = []
    if is_corrected:
        issues += _tolerance_issues(
            path,
            probes,
            distance,
            step=is_behind_step,
            jump=is_judged & is_inside_jump,
            smooth=is_judged & ~is_inside_jump,
        )
        if path.program.keeps_text:
            issues += checks.blending_issues(
                path.program, targets.motion, rounding - selection.programmed_rounding, tolerance
            )
    issues += too_fast
    # where further targets may help: not at targets, nor inside a jump, whose piece is too short to be divided
    is_divisible = is_judged & probes.is_inside & ~is_inside_jump
    is_beyond_tolerance = is_divisible & ~(distance <= _SAFE_SHARE * tolerance)
    path_distance = np.zeros(len(targets))
    np.maximum.at(path_distance, probes.target[is_judged], distance[is_judged])
    return SimulatedPath(
        readback.text,
        readback.numbers,
        deviation,
        path_distance,
        rounding,
        Exceedances(probes.motion[is_beyond_tolerance], probes.t[is_beyond_tolerance], distance[is_beyond_tolerance]),
        tuple(issues),
    )


class _Conditions(NamedTuple):
    """By what the tolerance is exceeded at n probes, if it is, and whether it must hold there.

    :param is_behind_step: (n,) True just behind the start of a motion that begins with another force than the one
        before ends with.
    :param is_inside_jump: (n,) True inside a piece that is too short to be divided: the force jumps there.
    :param is_judged: (n,) True where the tolerance must hold.
    """

    is_behind_step: Bools
    is_inside_jump: Bools
    is_judged: Bools


def _conditions_of_probes(path: PathUnderLoad, targets: Targets, probes: _Probes) -> _Conditions:
    """Return which probes are behind a step or inside a jump of the force, and which must hold the tolerance.

    A probe is a place at which the path error is computed; a piece is the path from one target to the next. The others,
    which need not hold it, are inside a piece that begins where no correction was possible, or behind a step.
    """
    m, motion, is_inner = path.program.motions, probes.motion, probes.is_inside
    begin, end = targets.begin(probes.target), targets.t[probes.target]
    is_behind_step = path.motions.forces.is_behind_step(motion, end) & is_inner
    is_inside_jump = (path.motions.segments.length[motion] * (end - begin) < _JUMP_LENGTH) & is_inner
    # [start] and axis targets are not corrected: a motion from there begins as far off as the robot is without a force
    begins_uncorrected = np.append(True, np.isfinite(m.joints[:-1, 0])) & (not path.robot_in_cell.rest_is_nominal)
    is_judged = ~(begins_uncorrected[motion] & is_inner) & ~is_behind_step
    return _Conditions(is_behind_step, is_inside_jump, is_judged)


class _Deviation(NamedTuple):
    """Deviation of the loaded tip from nominal along the written program.

    :param at_targets: (K, 3) at the targets, `$BASE` [m].
    :param distance: (n,) at all probes [m].
    :param near_limit: True if a joint is near its largest speed.
    """

    at_targets: Array
    distance: Array
    near_limit: bool


def _deviation(
    path: PathUnderLoad, selection: TargetSelection, theta: Array, readback: ReadBackProgram, probes: _Probes
) -> _Deviation:
    """Return the deviation of the loaded tip from nominal along the written program.

    :param theta: (N, nv) approximate deflections of the springs at the samples of the path.
    :raises UnusableTextError: a commanded pose is out of reach, or there is no equilibrium.
    """
    errors = _ProbeErrors(path, selection, theta, readback, len(probes.t))
    for part in chunks(len(probes.t)):  # the commanded poses of all probes would be hundreds of megabytes
        chunk = probes.take(part)
        try:
            errors.add(part, chunk)
        except NotConvergedError as cause:
            line = int(path.program.motions.line[chunk.motion[cause.rows[0]]])
            message = f"the written program cannot be simulated: {cause}"
            raise UnusableTextError(Issue("error", "read-back", message, source_line=line)) from None
    return _Deviation(errors.at_targets, errors.distance, errors.near_limit)


class _ProbeErrors:
    """Path errors at the n probes of a written program, which are added part by part, in order.

    :ivar at_targets: (K, 3) deviation from nominal at the targets, `$BASE` [m].
    :ivar distance: (n,) of the loaded tip from nominal at the probes [m].
    :ivar near_limit: True if a joint is near its largest speed on the way to a probe.
    """

    def __init__(
        self, path: PathUnderLoad, selection: TargetSelection, theta: Array, readback: ReadBackProgram, count: int
    ) -> None:
        self._path, self._selection, self._theta, self._readback = path, selection, theta, readback
        self._sample_place = path.sample.motion + path.sample.t
        self._driven_program = DrivenProgram(readback.program, path.robot_in_cell, readback.segments)
        self._last_state: tuple[Array, Array] | None = None  # joint angles and position at the last probe so far
        self.at_targets, self.distance = np.zeros((len(selection.targets), 3)), np.zeros(count)
        self.near_limit = False

    def add(self, rows: slice, probes: _Probes) -> None:
        """Compute the errors at the next probes: places of the written path at which the loaded arm is simulated.

        :param rows: those of these probes among all.
        :raises NotConvergedError: a commanded pose is out of reach, or there is no equilibrium; `rows` are of `probes`.
        """
        path, readback, driven_program = self._path, self._readback, self._driven_program
        target, motion, t, share = probes.target, probes.motion, probes.t, probes.share
        # is_inside: between two targets; the other probes are at targets
        output_motion, is_inside = readback.row[target], probes.is_inside
        sample = self._nominal_samples(target, motion + t, is_inside)
        nominal = toolpath.at(path.program, path.motions.segments, motion, t)
        wrench = toolpath.wrench_in_root(readback.program, output_motion, path.motions.forces.at(nominal))
        pose, q = driven_program.commanded_poses(output_motion, share, path.joints.branch[sample])
        if np.isnan(q).any():
            raise NotConvergedError("a commanded pose is out of reach", np.flatnonzero(np.isnan(q).any(axis=1)))
        displacement = driven_program.carriage_displacement(output_motion, share)
        tip = driven_program.loaded_tip(output_motion, q, wrench, displacement, self._theta[sample])
        error = driven_program.to_base(output_motion, tip) - nominal.pose.position
        self.at_targets[target[~is_inside]] = error[~is_inside]
        self.distance[rows] = norm(error)
        is_fast = self._is_fast(q, pose[:, :3, 3], readback.program.motions.feed[output_motion])
        self.near_limit |= bool(is_fast.any())

    def _nominal_samples(self, target: NDArray[np.int32], place: Array, is_inside: Bools) -> Ints:
        """Return the sample (n,) of the nominal path at each probe: that of its target, inside a piece the next one.

        :param place: (n,) motion + t of the probes.
        """
        sample = self._selection.row[target]
        sample[is_inside] = np.searchsorted(self._sample_place, place[is_inside] - _SAME_SAMPLE)
        return sample

    def _is_fast(self, q: Array, position: Array, feed: Array) -> Bools:
        """Return on the way to which probes (n,) a joint is near its largest speed; keep the last state for later ones.

        :param q: (n, 6) commanded joint angles [rad], `position` (n, 3) commanded positions [m].
        :param feed: (n,) programmed feeds [m/s]; NaN for joint motions, which are never fast.
        """
        last_q, last_position = (q[:1], position[:1]) if self._last_state is None else self._last_state
        self._last_state = q[-1:], position[-1:]
        travel = norm(np.diff(position, axis=0, prepend=last_position))
        speed_limit = self._path.robot_in_cell.robot.speed
        joint_time = (np.abs(np.diff(q, axis=0, prepend=last_q)) / speed_limit).max(axis=1, initial=0.0)
        is_fast = joint_time * np.nan_to_num(feed) > _SPEED_SHARE * travel
        return np.asarray(is_fast & (travel > _LEAST_TRAVEL))


def _probes(path: PathUnderLoad, selection: TargetSelection, readback: ReadBackProgram) -> _Probes:
    """Return the probes: the places of the written path at which the deviation is computed.

    Each piece, from one target to the next, has a probe at its end. Pieces that are long or curved, that turn the tool,
    or along which the force changes, have more; and the more, the more the correction changes along them.
    """
    targets, m = selection.targets, readback.program.motions

    def correction(target: Ints) -> Array:
        """Return the correction (n, 3) of targets (n,), `$BASE` [m]."""
        return targets.pose.position[target] - path.sample.pose.position[selection.row[target]]

    rows = np.arange(len(targets))  # of the piece to each target
    arc_rows = np.flatnonzero((path.program.motions.kind[targets.motion] == CIRC) | (m.kind[readback.row] == CIRC))
    is_curved, is_uneven = np.zeros((2, len(targets)), dtype=np.bool_)
    # the force changes at samples that are no targets: the path may be off there by part of the tolerance
    skips_samples = np.diff(selection.row, prepend=-1) > 1
    is_curved[arc_rows] = True
    limit = _UNEVEN_SHARE * path.robot_in_cell.tolerance
    is_uneven[arc_rows] = _unevenness(path, selection, readback, arc_rows, correction(arc_rows)) > limit

    correction_step = norm(correction(rows) - correction(np.maximum(rows - 1, 0)))
    probe_count = number_of_places(
        m.kind[readback.row],
        readback.segments.travel[readback.row],
        readback.segments.turn[readback.row],
        is_curved=is_curved | skips_samples,
        is_steep=(correction_step > _STEEP_CHANGE) | is_uneven,
    )
    target, share = toolpath.even_places(rows.astype(np.int32), probe_count.astype(np.int32))
    begin, end = targets.begin(target), targets.t[target]
    t = np.where(share == 1.0, end, begin + share * (end - begin))
    return _Probes(target, share, targets.motion[target], t)


def _unevenness(
    path: PathUnderLoad, selection: TargetSelection, readback: ReadBackProgram, arc_rows: Ints, correction: Array
) -> Array:
    """Return how much the displacement of the written path varies along pieces of arcs (n,) [m].

    It is the larger difference of the displacement, at 1/4 and at 3/4 of a piece, from that at its end.

    :param arc_rows: (n,) targets at the ends of the pieces.
    :param correction: (n, 3) displacement there, `$BASE` [m].
    """
    motion, output_motion = selection.targets.motion[arc_rows], readback.row[arc_rows]
    begin, end = selection.targets.begin(arc_rows), selection.targets.t[arc_rows]
    displacements = (
        toolpath.positions(readback.program, readback.segments, output_motion, np.full(len(output_motion), share))
        - toolpath.positions(path.program, path.motions.segments, motion, begin + share * (end - begin))
        for share in (0.25, 0.75)
    )
    at_quarter, at_three_quarters = (norm(displacement - correction) for displacement in displacements)
    return np.maximum(at_quarter, at_three_quarters)


def _tolerance_issues(
    path: PathUnderLoad, probes: _Probes, distance: Array, *, step: Bools, jump: Bools, smooth: Bools
) -> Iterator[Issue]:
    """Yield issues where the tip misses a target or leaves the tolerance between targets.

    :param distance: (n,) of the tip from the path at the probes [m].
    :param step: (n,) probes just after the start of a motion at which the force has a step.
    :param jump: (n,) judged probes in a jump of the force within a motion, `smooth` (n,) the other judged ones.
    """
    is_exceeded = ~(distance <= path.robot_in_cell.tolerance)
    cases: tuple[tuple[Level, str, Bools, str], ...] = (
        ("warning", "force-step", step & is_exceeded, _STEP_MESSAGE),
        ("error", "force-jump", jump & is_exceeded, _JUMP_MESSAGE),
        ("error", "tolerance", ~probes.is_inside & ~(distance <= _TARGET_TOLERANCE), _TARGET_MESSAGE),
        ("error", "tolerance", smooth & is_exceeded, _PATH_MESSAGE),
    )
    for level, kind, is_case, message in cases:
        if is_case.any():
            largest_error = np.nanmax(distance[is_case]) * MM_PER_M
            tolerance_mm = path.robot_in_cell.tolerance * MM_PER_M
            message = message.format(left=f"{largest_error:.4f} mm", allowed=f"{tolerance_mm:g} mm")
            yield path.program.motions.issue(level, kind, message, probes.motion[is_case])


def _joint_speed_issues(path: PathUnderLoad, selection: TargetSelection, readback: ReadBackProgram) -> Iterator[Issue]:
    """Yield issues of joint speeds beyond the limits in the written program, by its samples and places between them.

    The issues name the output line, and the source line of the target there.
    """
    output_program, robot = readback.program, path.robot_in_cell.robot
    motions = MotionsUnderLoad.of(output_program, path.robot_in_cell, None)
    loaded_path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
    speed = inspection.commanded_speed(loaded_path, loaded_path.joints.q, loaded_path.sample.pose.position)
    _, lines = inspection.stretches_to_examine(loaded_path, loaded_path.joints.q, speed)
    issues = list(checks.joint_speed_issues(output_program, robot, loaded_path.sample, speed))
    for places, place_joints, position in inspection.dense_places(
        loaded_path, loaded_path.joints.q, loaded_path.sample.pose.position, lines
    ):
        speed = checks.joint_speed(output_program, places, loaded_path.motions.segments.turn, place_joints, position)
        issues += checks.joint_speed_issues(output_program, robot, places, speed)
    first_of_kind: dict[str, Issue] = {}
    for issue in issues:
        first_of_kind.setdefault(issue.kind, issue)
    for issue in first_of_kind.values():
        target = int(np.argmax(output_program.motions.line[readback.row] == issue.source_line))
        line = int(path.program.motions.line[selection.targets.motion[target]])
        yield replace(issue, output_line=issue.source_line, source_line=line, lines=(line,))
