"""Where paths meet: branches not known before run time at their join, a LOOP without EXIT at its start.

A fork is an IF or SWITCH whose branch taken is not known before run time; its branches end at a join. A motion is given
by its index among all motions of the program, in execution order; its row is that in the execution trace, the lines of
the program in the order in which they are executed.

Each branch is corrected from the fork to the join, and the loop as one round that repeats. All that leads to one
motion must end in the same pose; a round must end in the state in which it began, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence, Set
from typing import NamedTuple

import numpy as np

from postproc.dialects.krl.execution import Branch, Execution, Fork, Join, UnrolledLoop
from postproc.dialects.krl.layout import CONSTANT, Layout
from postproc.dialects.krl.read.motions import OrderedMotions, settings_at
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.unresolved import depends_on_start
from postproc.errors import Issue
from postproc.frames import MM_PER_M, Array, inverse
from postproc.program import PTP, SPL, Carriage, FrameColumns, Ints, Motions, Starts, distinct

_POSE_TOLERANCE = 1e-6
"""Poses that differ by less [m, rad] count as equal."""
_BRANCH_ADVICE = (
    "Branches whose condition is not known are corrected if they meet in one pose. Let them, say in "
    "[krl.values] of the cell what the condition asks, or leave them as they are by --keep-unresolved."
)
_PTP_ADVICE = (
    "Give it S and T, or joint angles (PTP to all of A1 … A6), or leave the branches as they are by --keep-unresolved."
)
_START_ADVICE = (
    "Begin there with a LIN to all of X, Y, Z, A, B, C under $ORI_TYPE=#VAR, or leave the branches as they are by "
    "--keep-unresolved."
)
_LOOP_ADVICE = "Begin and end each round of the LOOP in one pose, for example with a PTP to all of A1 … A6."
_SETTING_ADVICE = "Set before the LOOP what its rounds set."


class _Fault(NamedTuple):
    """Why the branches of a fork cannot be corrected.

    :ivar fork: row of the trace with the fork.
    :ivar problem: what is wrong, as text for a message; `advice` says what to do.
    """

    fork: int
    problem: str
    advice: str = _BRANCH_ADVICE


class JoinedEnds(NamedTuple):
    """The ends of the branches that meet at a control-flow join.

    :ivar fork: row of the trace with the IF or SWITCH of these branches.
    :ivar ends: the motions that may be the last before the join, ascending; −1: the start of the program.
    """

    fork: int
    ends: tuple[int, ...]


def joins_before_joint_targets(execution: Execution, sequence: OrderedMotions) -> frozenset[Join]:
    """Return the joins after which every motion that may run next is a PTP to joint angles.

    Branches may end in different poses there, because such a PTP ends in one pose wherever it starts. A join that no
    motion can follow is returned, too.
    """
    successors = _Successors(execution, sequence)
    joins = [(number, step) for number, step in enumerate(successors.steps) if isinstance(step, Join)]
    return frozenset(join for number, join in joins if successors.leads_to_joints(number))


class _Successors:
    """Finds the motions that may follow each fork, branch and join of an execution trace."""

    def __init__(self, execution: Execution, sequence: OrderedMotions) -> None:
        """Store the forks, branches and joins of an execution trace in `steps`, in execution order."""
        self.steps = [step for step in execution.steps if isinstance(step, Fork | Branch | Join)]
        self._execution, self._sequence = execution, sequence
        self._results: dict[int, bool] = {}  # index in `steps` → result of `leads_to_joints`

    def leads_to_joints(self, number: int) -> bool:
        """Return whether every motion that may run next after a step is a PTP to joint angles; the result is stored.

        :param number: index of the step in `steps`.
        """
        if number not in self._results:
            self._results[number] = self._step_leads_to_joints(number)
        return self._results[number]

    def _step_leads_to_joints(self, number: int) -> bool:
        """Return whether every motion that may run next after a step is a PTP to joint angles.

        What follows a step is a motion, or else a fork, the end of a branch, a join or the end of the program.

        :param number: index of the step in `steps`.
        """
        trace_row, step = self._sequence.columns.trace_row, self.steps[number]
        next_step = self.steps[number + 1] if number + 1 < len(self.steps) else None
        motion = int(np.searchsorted(trace_row, step.row, side="right"))  # the first after the step
        is_before_next_step = motion < len(trace_row) and (next_step is None or trace_row[motion] <= next_step.row)
        if is_before_next_step:
            return is_ptp_to_joints(self._sequence, motion)
        if next_step is None:  # the program ends, or its endless LOOP begins anew
            return self._next_round_leads_to_joints()
        if isinstance(next_step, Fork):  # its branches, and what follows them if all may be skipped
            branches, join = self._branches_and_join(number + 1)
            return all(map(self.leads_to_joints, branches if self._is_exhaustive_join(join) else [*branches, join]))
        if isinstance(next_step, Join):
            return self.leads_to_joints(number + 1)
        # the next step begins another branch, which does not run after this one
        _, join = self._branches_and_join(number)
        return self.leads_to_joints(join)

    def _is_exhaustive_join(self, number: int) -> bool:
        """Return whether a step is a join whose branches are exhaustive: one of them always runs, as with ELSE."""
        join = self.steps[number]
        return isinstance(join, Join) and join.is_exhaustive

    def _branches_and_join(self, number: int) -> tuple[list[int], int]:
        """Return the indices in `steps` of the branches after a step, and the index of the join that ends them.

        Branches of nested forks are left out. Without a join the index is that of the last step.

        :param number: index of the step, a fork or one of its branches, in `steps`.
        """
        depth, branches = 0, list[int]()
        for index in range(number + 1, len(self.steps)):
            step = self.steps[index]
            if isinstance(step, Join) and not depth:
                return branches, index
            if isinstance(step, Branch) and not depth:
                branches.append(index)
            depth += isinstance(step, Fork) - isinstance(step, Join)  # number of open nested forks
        return branches, len(self.steps) - 1

    def _next_round_leads_to_joints(self) -> bool:
        """Return whether the LOOP that ends the program begins with a PTP to joint angles.

        It then does not matter where a round ends. False if branches precede the first motion of the LOOP.

        :returns: True if the program does not end in a LOOP: nothing follows its end.
        """
        loop, trace_row = self._execution.endless_loop, self._sequence.columns.trace_row
        if loop is None:
            return True
        motion = int(np.searchsorted(trace_row, loop.first))  # the first motion of the loop
        if motion == len(trace_row) or any(loop.first <= step.row < trace_row[motion] for step in self.steps):
            return False
        return is_ptp_to_joints(self._sequence, motion)


def is_ptp_to_joints(sequence: OrderedMotions, motion: int) -> bool:
    """Return whether a motion is an absolute PTP to six joint angles, which ends in one pose wherever it starts."""
    move = sequence.moves.get(motion)  # None for a plain motion, whose target is X, Y, Z, A, B, C
    return move is not None and not move.relative_axes and move.end.position.is_axis and move.end.position.is_complete


def _first_ambiguous_ptp(sequence: OrderedMotions, motions: slice) -> int | None:
    """Return the first PTP among some motions to a Cartesian target without status or turn; None if there is none.

    Its joint angles depend on the joint angles before it.

    :param motions: the motions, which follow each other.
    """
    for motion in (motions.start + np.flatnonzero(sequence.columns.kind[motions] == PTP)).tolist():
        lacks_status_or_turn = (sequence.columns.posture[motion] < 0).any()  # −1: S or T is missing
        if not is_ptp_to_joints(sequence, motion) and lacks_status_or_turn:
            return int(motion)
    return None


def predecessors_and_joins(
    execution: Execution,
    sequence: OrderedMotions,
    predecessors: Ints | None,
    uncorrected_rows: Sequence[int],
    unchecked_joins: Set[Join],
) -> tuple[Ints | None, list[JoinedEnds]]:
    """Return the motion at whose end each of M motions begins, see `Program.after`, and the ends of branches at joins.

    Joins at which branches may end in different poses are left out.

    :param sequence: the M motions, in the order of the trace.
    :param predecessors: (M,) the motion at whose end each would begin if branches ran one after the other; None: the
        motion before it. Returned unchanged for a trace without branches.
    :param uncorrected_rows: rows of the trace with motions that stay uncorrected.
    :param unchecked_joins: joins at which branches may end in different poses.
    :raises BranchError: an uncorrected motion is in a branch, or a motion in or after a branch depends on more than its
        start pose.
    """
    steps = [step for step in execution.steps if isinstance(step, Fork | Branch | Join)]
    if not steps:
        return predecessors, []
    trace_row = sequence.columns.trace_row
    branch_flow = _branch_flow(steps, trace_row, unchecked_joins)
    branch_predecessors = np.arange(len(trace_row)) - 1 if predecessors is None else predecessors.copy()
    for motion, last_motions in branch_flow.previous_motions.items():
        has_known_start = branch_predecessors[motion] != motion
        if has_known_start:
            # all of them end in one pose, except at an unchecked join
            branch_predecessors[motion] = min(last_motions)
    _refuse_branches(
        execution, _faults_in_branches(execution, sequence, branch_flow.joins, uncorrected_rows, unchecked_joins)
    )
    faults: list[_Fault] = []
    for motion in np.flatnonzero(branch_predecessors != np.arange(len(trace_row)) - 1).tolist():
        has_known_start = branch_predecessors[motion] != motion  # else it is checked in `unresolved`
        if has_known_start and depends_on_start(sequence, motion, arcs=False):
            problem = f"{_start_dependence(sequence, motion)} where branches begin or meet"
            faults.append(_Fault(int(branch_flow.fork_rows[motion]), problem, _START_ADVICE))
    _refuse_branches(execution, faults)
    return branch_predecessors, [ends for join, ends in branch_flow.joins if join not in unchecked_joins]


def _faults_in_branches(
    execution: Execution,
    sequence: OrderedMotions,
    joins: Sequence[tuple[Join, JoinedEnds]],
    uncorrected_rows: Sequence[int],
    unchecked_joins: Set[Join],
) -> list[_Fault]:
    """Return a fault for each join with an uncorrected motion or an ambiguous PTP in one of its branches.

    :param joins: all joins of the trace, with the ends of their branches.
    :param uncorrected_rows: rows of the trace with motions that stay uncorrected.
    :param unchecked_joins: joins at which branches may end in different poses: ambiguous PTPs do no harm there, because
        a PTP to joint angles follows.
    """
    trace_row, faults = sequence.columns.trace_row, list[_Fault]()
    for join, ends in joins:
        if any(ends.fork < row <= join.row for row in uncorrected_rows):
            faults.append(_Fault(ends.fork, "an uncorrected motion is inside a branch"))
            continue
        if join in unchecked_joins:
            continue
        motions_in_branches = slice(*np.searchsorted(trace_row, [ends.fork, join.row], side="right"))
        ptp = _first_ambiguous_ptp(sequence, motions_in_branches)
        if ptp is not None:
            place = execution.trace.place(int(trace_row[ptp]))
            problem = f"a PTP to X, Y, Z without S and T is inside a branch ({place})"
            faults.append(_Fault(ends.fork, problem, _PTP_ADVICE))
    return faults


class _BranchFlow(NamedTuple):
    """The order of M motions at forks, branches and joins.

    A motion is given by its index; −1 is the start of the program.

    :ivar previous_motions: for the first motion of the program, and each motion right after a fork, branch or join: the
        motions that may run last before it.
    :ivar last_motions: motions that may be the last of the program.
    :ivar fork_rows: (M + 1,) for each motion right after a fork, branch or join, and for the end of the program, the
        row of the trace with the fork of that branch or join; 0 for all other motions: rows count from 1.
    :ivar joins: all joins, with the ends of their branches.
    """

    previous_motions: dict[int, frozenset[int]]
    last_motions: frozenset[int]
    fork_rows: Ints
    joins: list[tuple[Join, JoinedEnds]]


class _OpenFork(NamedTuple):
    """A fork whose join has not been reached.

    :ivar row: row of the execution trace with the fork.
    :ivar entries: motions that may be the last before the fork.
    :ivar branch_ends: motions that may be the last of the branches that have ended.
    :ivar has_branch: True once a branch has begun.
    """

    row: int
    entries: frozenset[int]
    branch_ends: frozenset[int]
    has_branch: bool


def _branch_flow(steps: Sequence[Fork | Branch | Join], trace_row: Ints, unchecked_joins: Set[Join]) -> _BranchFlow:
    """Return which of M motions may follow which at forks, branches and joins.

    Each branch begins at the end of the motion before its fork.

    :param steps: forks, branches and joins of the trace, in order; empty for a trace without branches.
    :param trace_row: (M,) rows of the trace with the motions, ascending.
    :param unchecked_joins: joins at which branches may end in different poses. At each other join, all branches end in
        one pose: the last motion that comes first in the trace represents all of them.
    """
    previous_motions: dict[int, frozenset[int]] = {}
    open_forks: list[_OpenFork] = []
    joins: list[tuple[Join, JoinedEnds]] = []
    fork_rows = np.full(len(trace_row) + 1, 0)
    # motions that may be the last before the present step; the first motion after it
    last_motions, next_motion = frozenset({-1}), 0

    def pass_motions(stop: int) -> None:
        """Pass the motions from `next_motion` to `stop` − 1; the first of them follows one of `last_motions`."""
        nonlocal last_motions, next_motion
        if stop > next_motion:
            previous_motions[next_motion] = last_motions
            last_motions, next_motion = frozenset({stop - 1}), stop

    for step in steps:
        pass_motions(int(np.searchsorted(trace_row, step.row, side="right")))  # those up to the row of the step
        fork_rows[next_motion] = open_forks[-1].row if open_forks else step.row
        if isinstance(step, Fork):
            open_forks.append(_OpenFork(step.row, last_motions, frozenset(), has_branch=False))
            continue
        fork_row, entries, branch_ends, has_branch = open_forks.pop()
        if has_branch or isinstance(step, Join):  # a branch ends here
            branch_ends |= last_motions
        if isinstance(step, Branch):
            open_forks.append(_OpenFork(fork_row, entries, branch_ends, has_branch=True))
            last_motions = entries
        else:
            # if all branches may be skipped, the motions before the fork are ends too
            ends = branch_ends if step.is_exhaustive else branch_ends | entries
            joins.append((step, JoinedEnds(fork_row, tuple(sorted(ends)))))
            last_motions = ends if step in unchecked_joins else frozenset({min(ends)})
    pass_motions(len(trace_row))
    return _BranchFlow(previous_motions, last_motions, fork_rows, joins)


def motions_before(
    execution: Execution, trace_row: Ints, uncorrected_rows: Sequence[int], rows: Iterable[int]
) -> Iterator[tuple[int, int]]:
    """Yield for rows of the trace each motion that may be the last before: the row and the motion; −1: none is.

    Behind uncorrected motions nothing is yielded. In a LOOP without EXIT the motions that may end its round are among
    those before its first motion.

    :param trace_row: (M,) rows of the trace with the motions.
    :param uncorrected_rows: rows of the trace with motions that stay uncorrected.
    :param rows: other rows of the trace, ascending.
    """
    steps = [step for step in execution.steps if isinstance(step, Fork | Branch | Join)]
    other_rows, unknown_rows = (np.array(list(numbers), dtype=np.int64) for numbers in (rows, uncorrected_rows))
    moving_rows, loop = np.concatenate([trace_row, unknown_rows]), execution.endless_loop
    passed_rows = other_rows
    if loop is not None and loop.first not in moving_rows:  # a motion on its first row is before all waits in it
        passed_rows = distinct(np.append(other_rows, loop.first))
    all_rows = distinct(np.concatenate([moving_rows, passed_rows]))
    # with all joins unchecked, the end of each branch is kept, not one that stands for all
    branch_flow = _branch_flow(steps, all_rows, frozenset(step for step in steps if isinstance(step, Join)))
    previous_rows = branch_flow.previous_motions
    # the motions that may be the last up to each row of all rows; none up to an uncorrected motion; −1: the start
    last_motions: dict[int, set[int]] = {-1: {-1}} | {
        k: set() for k in np.searchsorted(all_rows, unknown_rows).tolist()
    }

    def pass_rows() -> None:
        """Store the motions that may be the last up to each row without a motion."""
        for index in np.searchsorted(all_rows, passed_rows).tolist():
            motions = set[int]()
            for previous in previous_rows.get(index, {index - 1}):
                if previous not in last_motions:
                    last_motions[previous] = {int(np.searchsorted(trace_row, all_rows[previous]))}
                motions |= last_motions[previous]
            last_motions[index] = motions

    pass_rows()
    if loop is not None:
        first = int(np.searchsorted(all_rows, loop.first))
        previous_rows[first] = previous_rows.get(first, frozenset({first - 1})) | branch_flow.last_motions
        pass_rows()  # once more is enough: a round without motions passes on what it begins with
    for row, index in zip(other_rows.tolist(), np.searchsorted(all_rows, other_rows).tolist(), strict=True):
        yield from ((row, motion) for motion in sorted(last_motions[index]))


def branch_spans(execution: Execution, trace_row: Ints) -> tuple[tuple[int, int], ...]:
    """Return, for each branch with motions, its first motion and the motion after its last; see `Program.branches`.

    :param execution: the execution trace with its forks, branches and joins.
    :param trace_row: (M,) rows of the trace with the motions.
    """
    spans: list[tuple[int, int]] = []
    first_motions: list[int | None] = []  # of the present branch of each open fork; None: no branch has begun
    for step in execution.steps:
        if not isinstance(step, Fork | Branch | Join):
            continue
        next_motion = int(np.searchsorted(trace_row, step.row, side="right"))
        if isinstance(step, Fork):
            first_motions.append(None)
            continue
        # a branch or a join ends the branch before
        first_motion = first_motions.pop()
        if first_motion is not None and next_motion > first_motion:
            spans.append((first_motion, next_motion))
        if isinstance(step, Branch):
            first_motions.append(next_motion)
    return tuple(spans)


def transitions(
    execution: Execution,
    trace_row: Ints,
    predecessors: Ints | None,
    uncorrected_rows: Sequence[int],
    unchecked_joins: Set[Join],
) -> tuple[tuple[int, int], ...]:
    """Return pairs (motion, previous motion): further motions at whose ends a motion may begin.

    See `Program.transitions`. The previous motions that `predecessors` states are left out.

    :param trace_row: (M,) rows of the trace with the motions.
    :param predecessors: (M,) the motion at whose end each begins, see `Program.after`; None: the motion before it.
    :param uncorrected_rows: rows of the trace with motions that stay uncorrected.
    :param unchecked_joins: joins at which branches may end in different poses.
    """
    stated_predecessors = np.arange(len(trace_row)) - 1 if predecessors is None else predecessors
    branch_flow = _branch_flow(
        [step for step in execution.steps if isinstance(step, Fork | Branch | Join)], trace_row, unchecked_joins
    )
    further_transitions = [
        (motion, end)
        for motion, ends in branch_flow.previous_motions.items()
        if stated_predecessors[motion] != motion  # else its start is not known
        for end in sorted(ends)
        if end != stated_predecessors[motion]
    ]
    # behind an uncorrected motion, the round of an endless loop ends in an unknown pose
    is_last_motion_corrected = max(uncorrected_rows, default=0) < max(trace_row, default=0)
    if is_last_motion_corrected:
        further_transitions += _round_transitions(execution, trace_row, stated_predecessors, branch_flow.last_motions)
    return tuple(dict.fromkeys(further_transitions))  # without repetitions


def _round_transitions(
    execution: Execution, trace_row: Ints, predecessors: Ints, ends: Set[int]
) -> Iterator[tuple[int, int]]:
    """Yield pairs: a motion that may begin the second round of an endless loop, and the motion that may precede it.

    With branches, several motions may be the first of a round: all that begin where the first motion of the loop does.
    Nothing is yielded without an endless loop.

    :param trace_row: (M,) rows of the trace with the motions.
    :param predecessors: (M,) the motion at whose end each begins; the motion itself if its start is not known.
    :param ends: motions that may be the last of the first round.
    """
    if (loop := execution.endless_loop) is None:
        return
    first, stop = np.searchsorted(trace_row, [loop.first, loop.stop]).tolist()
    first_motions = first + np.flatnonzero(predecessors[first:stop] == predecessors[first : first + 1])
    has_known_start = predecessors[first_motions] != first_motions
    for motion in first_motions[has_known_start].tolist():
        yield from ((motion, end) for end in sorted(ends) if end != predecessors[motion])


class FramesAndStart(NamedTuple):
    """The frames of a program, and the flange pose at its start.

    :ivar bases: (nb, 4, 4) `$BASE` in the robot root [m].
    :ivar tools: (nt, 4, 4) `$TOOL` in the flange frame [m].
    :ivar start_flange: (4, 4) flange in the robot root at the start [m].
    """

    bases: Array
    tools: Array
    start_flange: Array

    def end_flange(self, motions: Motions, motion: int) -> Array:
        """Return the flange (4, 4) in the robot root [m] at the end of a motion.

        :param motion: index of the motion; −1: the start of the program.
        """
        if motion < 0:
            return self.start_flange
        tool = self.tools[motions.tool[motion]]
        return np.asarray(self.bases[motions.base[motion]] @ motions.target[motion] @ inverse(tool))


def check_joins(
    execution: Execution,
    joins: Sequence[JoinedEnds],
    motions: Motions,
    carriage: Carriage | None,
    path: FramesAndStart,
) -> None:
    """Refuse branches that end in different poses: what follows them could be corrected for one of the poses only.

    :param joins: the joins at which branches must end in one pose.
    :param motions: the M motions of the program.
    :param carriage: the linear axis that carries the robot; None without one.
    :param path: frames of the program and flange at its start.
    :raises BranchError: the ends of the branches of a fork differ.
    """
    faults: list[_Fault] = []
    for fork, ends in joins:
        flanges = [path.end_flange(motions, motion) for motion in ends]
        if any(np.abs(flange - flanges[0]).max() > _POSE_TOLERANCE for flange in flanges[1:]):
            faults.append(_Fault(fork, "the branches end in different places"))
        elif carriage is not None:
            # E1 [m]; the last element, which −1 selects, is the position at the start of the program
            track_positions = np.append(carriage.end, carriage.begin[0])[list(ends)]
            if np.ptp(track_positions) > _POSE_TOLERANCE:
                faults.append(_Fault(fork, "E1 differs between the ends of the branches"))
    _refuse_branches(execution, faults)


def _refuse_branches(execution: Execution, faults: Sequence[_Fault]) -> None:
    """Refuse the branches of some forks; the error states the first fault, and holds the visits to all of these forks.

    :raises BranchError: there are `faults`.
    """
    if not faults:
        return
    fork, problem, advice = faults[0]
    fork_rows = {fault.fork for fault in faults}
    raise execution.branch_error(f"motion in branches whose condition is not known: {problem}", fork, fork_rows, advice)


def _start_dependence(sequence: OrderedMotions, motion: int) -> str:
    """Return why a motion, for which `depends_on_start` holds, depends on its start, as text for a message."""
    kind, move = int(sequence.columns.kind[motion]), sequence.moves.get(motion)
    if kind != PTP and sequence.motion_states.at(motion).orientation == CONSTANT:
        return "$ORI_TYPE=#CONSTANT keeps the orientation"
    if kind == SPL:
        return "there is an SPL"
    if move is not None and move.relative_axes:
        return "there is a relative motion"
    if move is not None and move.angle is not None:
        return "there is a circle with CA"
    return "components are missing"


class EndlessRounds(NamedTuple):
    """The motions of a program that ends in a LOOP without EXIT.

    :ivar loop: the LOOP.
    :ivar first: index of the first motion of a round; `stop` is that after its last. Equal if the LOOP has no motions.
    :ivar motions: all M motions of the program.
    :ivar start: (M + 1) start poses of the motions, and last the start pose of motion `first` in the second round.
    :ivar carriage: the linear axis that carries the robot; None without one.
    """

    loop: UnrolledLoop
    first: int
    stop: int
    motions: Motions
    start: Starts
    carriage: Carriage | None

    def joined_ends(self) -> tuple[tuple[int, int], ...]:
        """Return the motions at whose ends a round may begin: the motion before the LOOP, and the last motion in it.

        They are the only group of the result, see `Program.joins`. −1 is the start of the program.

        :returns: empty if the LOOP has no motions, or if its first motion leads to joint angles: it does not matter
            then where that begins.
        """
        has_motions = self.first < self.stop
        return ((self.first - 1, self.stop - 1),) if has_motions and not self._begins_with_joint_target() else ()

    def _begins_with_joint_target(self) -> bool:
        """Return whether the first motion of a round leads to joint angles: it ends in one pose wherever it starts."""
        return not np.isnan(self.motions.joints[self.first, 0])  # NaN: a Cartesian target

    def pose_difference(self) -> str:
        """Return how the pose after a round differs from the pose before it, as text for a message.

        :returns: empty if the poses are equal, or the first motion leads to joint angles, from wherever it starts.
        """
        carriage, first, last = self.carriage, self.first, self.stop - 1
        if carriage is not None and abs(carriage.end[last] - carriage.begin[first]) > _POSE_TOLERANCE:
            return "with E1 elsewhere than it began"
        if self._begins_with_joint_target():
            return ""
        second_round = len(self.motions)  # index of the start pose of the second round, see `start`
        begin, second_begin = self.start.at(np.array([first, second_round]))
        if np.abs(second_begin[:3] - begin[:3]).max() < _POSE_TOLERANCE:
            return ""
        distance = float(np.linalg.norm(second_begin[:3, 3] - begin[:3, 3]))
        if distance > _POSE_TOLERANCE:
            return f"{MM_PER_M * distance:.3f} mm from where it began"
        return "in another orientation than it began"


def check_endless_loop(execution: Execution, rounds: EndlessRounds, settings: Settings) -> None:
    """Refuse a LOOP without EXIT whose round ends in another pose, or with other settings, than it began.

    One round is corrected and written for all: the second must move as the first does.

    :param settings: the settings of the program, which has been followed.
    :raises ProgramError: the pose or the settings differ.
    """
    loop = rounds.loop
    if rounds.first == rounds.stop:  # no motions
        return
    if problem := rounds.pose_difference():
        raise execution.endless_loop_error(f"its round ends {problem}", _LOOP_ADVICE)
    begin, end = settings_at(settings, np.array([loop.first, loop.stop]))
    has_same_frames = np.array_equal(begin.base, end.base) and np.array_equal(begin.tool, end.tool)
    if begin.state != end.state or not has_same_frames:
        raise execution.endless_loop_error("leaves other frames, speeds or modes than it begins with", _SETTING_ADVICE)


def endless_loop_issue(execution: Execution) -> Issue:
    """Return the issue, of severity "info", that the last LOOP has no EXIT."""
    message = "LOOP has no EXIT: one round is corrected, and is what all rounds do. What follows it is never reached."
    return Issue("info", "endless-loop", message, execution.endless_loop_line)


def endless_rounds(
    loop: UnrolledLoop, layout: Layout, motions: Motions, path: FramesAndStart, predecessors: Ints | None
) -> EndlessRounds:
    """Return the motions of a program that ends in a LOOP without EXIT, with the start poses of two rounds.

    :param motions: the M motions of the program.
    :param path: frames of the program and flange at its start.
    :param predecessors: (M,) the motion at whose end each begins; None: the motion before it.
    """
    count = len(motions)
    first, stop = np.searchsorted(layout.trace_row, [loop.first, loop.stop]).tolist()
    # all motions, and `first` once more, in the second round; any motion in its place if the loop has none
    sequence = np.append(np.arange(count), min(first, count - 1))
    last_of_round = stop - 1
    all_predecessors = np.append(np.arange(count) - 1 if predecessors is None else predecessors, last_of_round)
    start = Starts.of(
        FrameColumns(motions.base[sequence], motions.tool[sequence], path.bases, path.tools),
        lambda indices: motions.target[sequence[indices]],
        path.start_flange,
        all_predecessors,
    )
    return EndlessRounds(loop, first, stop, motions=motions, start=start, carriage=layout.carriage)
