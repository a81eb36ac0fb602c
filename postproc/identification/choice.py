"""Springs of a real robot: candidate structures, and the mean of those that the readings support.

Structures are tried from simple to rich: joint springs; compensator; gears whose compliance falls with the load,
smoothly or at breakpoints, and which have backlash or lost motion; springs of the links in six directions; springs
where links end and under the base. Where the gears carry the weights and the compensator's torque at rest, masses and
compensator are parameters too, about the values that the prior states.

Every structure is fitted with priors of physical size (`fit.learn`), and predicts configurations that it was not fitted
to. The result is no single structure but their mean, weighted so that together they have the least cross-validation
error (stacking: Breiman, Machine Learning 24, 1996). So one bad fold does not decide between two that are alike, and as
the model is linear in its parameters the mean is a model of the same kind. Gears that are not linear enter only where
the evidence is for them.

The posterior covariance is that within the structures and between them. The bound uses a wider one: twice the
posterior times its design effect, and the jackknife over configurations. The design effect (Kish, Survey Sampling,
1965) is by how much the residuals of a configuration, which share what the model lacks, make the parameters less
certain than independent residuals of the same size. A parameter error is the same at all places where a robot works: of
robots whose intervals hold in 95 %, one in twenty would be outside its bound at nearly all of them. Doubled, the bound
holds for nearly every robot. The jackknife adds the disagreement of configurations: errors that the readings of one
state share, which the posterior does not contain.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.errors import PostprocError
from postproc.frames import Array
from postproc.identification import over_pose, record
from postproc.identification.fit import Fit, LinearEquations, Prior, Regression, learn, linearise, prior_of
from postproc.identification.joint_springs import UNCERTAIN_SHARE, has_possible_compensator, unloaded_joints
from postproc.identification.measurement_model import (
    Placement,
    Structure,
    joint_torques,
    levels_of,
    predict,
    unwhiten,
    whitening,
)
from postproc.identification.readings import Measurements
from postproc.program import Bools, Ints
from postproc.robot import (
    BASE,
    COMPENSATOR,
    JOINT_COMPLIANCES,
    JOINTS,
    LINK_AXES,
    Backlash,
    CompensatorSize,
    CompensatorStiffness,
    FadingPart,
    JointCompliance,
    Knee,
    LinkMass,
    LinkSpring,
    LostMotion,
    Parameter,
    PoseWave,
    RobotModel,
)

JOINT, COMPENSATOR_SPRING, LINK, END, AT_REST = "joint", "compensator", "link", "end", "at rest"
COUPLING, OVER_POSE = "coupling", "over the pose"
FADING, KNEE, BACKLASH, LOST_MOTION = "fading", "breakpoint", "backlash", "lost motion"
"""Kinds of parameters that form structures."""
GEARS = (FADING, KNEE, BACKLASH, LOST_MOTION)
"""Kinds of gears whose deflection is not proportional to the torque."""

_FADE_AT = (0.2, 0.6, 2.0)
"""Torque at which parts of a gear fade, over the largest measured on its joint."""
_BREAKPOINTS_AT = (0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28)
"""Breakpoints of a gear, over the largest torque: milling torques are some hundredths of those of an experiment."""
_FLANK_CHANGE_AT = (0.01,)
"""Torque that moves a gear with backlash to its other flank, over the largest (assumed)."""
_COINCIDENCE_DISTANCE = 1e-3
"""Distance [m] between axes that count as one line (assumed)."""
_LEAST_TORQUE = 1.0
"""Largest torque [N·m] on a joint below which its gear has no parameters of its own."""


def link_springs(robot: RobotModel, with_ends: bool) -> tuple[LinkSpring, ...]:
    """Return the candidate springs of the links, without those that equal the spring of a joint.

    :param with_ends: include springs where links end, and under the base.
    """
    joint_springs = _springs_about_joint_axes(robot)
    links = (BASE, *JOINTS) if with_ends else JOINTS
    springs = (LinkSpring(link, axis) for link in links for axis in LINK_AXES)
    return tuple(spring for spring in springs if spring not in joint_springs and (with_ends or not spring.at_end))


def _springs_about_joint_axes(robot: RobotModel) -> set[LinkSpring]:
    """Return the rotational springs of links about a joint axis: they equal the spring of the joint.

    For each joint these are a spring at the beginning of its own link, and a spring at the end of its parent link. If
    the parent link begins on the axis of the joint, a spring at the beginning of the parent link is a third. An axis
    counts as X, Y or Z of a link's frame, whichever is nearest.
    """
    begin_rotations, end_rotations = LINK_AXES[3:6], LINK_AXES[6:9]  # about X, Y, Z
    springs = set()
    for index, joint in enumerate(JOINTS):
        joint_axis = robot.nominal.axis[index]
        parent_axis = robot.nominal.placement[index, :3, :3] @ joint_axis
        springs.add(LinkSpring(joint, begin_rotations[int(np.argmax(np.abs(joint_axis)))]))
        parent_link, axis = (BASE, *JOINTS)[index], int(np.argmax(np.abs(parent_axis)))
        springs.add(LinkSpring(parent_link, end_rotations[axis]))
        # distance of the origin of the parent link from the axis of the joint
        if np.linalg.norm(np.cross(parent_axis, robot.nominal.placement[index, :3, 3])) < _COINCIDENCE_DISTANCE:
            springs.add(LinkSpring(parent_link, begin_rotations[axis]))
    return springs


def _gear_parameters(
    parameter_type: type[FadingPart | Backlash],
    shares: Sequence[float],
    joints: Sequence[JointCompliance],
    largest_torque: Array,
) -> Iterator[Parameter]:
    """Yield candidate parameters of gears: one per joint and share, for joints with more than `_LEAST_TORQUE`.

    :param shares: torques of the parameters, over the largest torque on the joint.
    :param largest_torque: (6,) on each joint in the readings [N·m].
    """
    for joint in joints:
        if largest_torque[joint.index] > _LEAST_TORQUE:
            for share in shares:
                torque = float(f"{share * largest_torque[joint.index]:.2g}")  # two digits: the parameter's name has it
                yield parameter_type(joint.joint, torque)


def full_structure(
    robot: RobotModel, data: Measurements, carries_weight: bool, compensator: bool
) -> tuple[Structure, tuple[str, ...]]:
    """Return the structure with all candidate parameters, and the kind of each parameter.

    :param carries_weight: whether weights and compensator load the gears at rest, which matters if they are not linear.
    :param compensator: whether stiffness K_c and free length s₀ of the compensator's spring are parameters.
    """
    idle_joints = unloaded_joints(robot, data)
    loaded_joints = [joint for joint in JOINT_COMPLIANCES if joint not in idle_joints]
    largest_torque = np.abs(joint_torques(robot, data)).max(axis=0)
    springs, springs_with_ends = link_springs(robot, with_ends=False), link_springs(robot, with_ends=True)
    parameters_by_kind: dict[str, Iterable[Parameter]] = {
        JOINT: JOINT_COMPLIANCES,
        COMPENSATOR_SPRING: COMPENSATOR if compensator else (),
        LINK: springs,
        END: (spring for spring in springs_with_ends if spring not in springs),
        FADING: _gear_parameters(FadingPart, _FADE_AT, loaded_joints, largest_torque),
        KNEE: _gear_parameters(Knee, _BREAKPOINTS_AT, loaded_joints, largest_torque),
        BACKLASH: _gear_parameters(Backlash, _FLANK_CHANGE_AT, loaded_joints, largest_torque),
        # if the load alone acts on the gears, backlash is lost motion
        LOST_MOTION: _gear_parameters(LostMotion, _FLANK_CHANGE_AT, loaded_joints, largest_torque)
        if carries_weight
        else (),
        # masses are seen if they load the gears at rest, or if the geometry is that of the weightless robot; a free
        # compensator replaces the weights on joint 2, so that they are not identifiable with it
        AT_REST: _gravity_parameters(robot)
        if not compensator and (carries_weight or not robot.subtract_reference)
        else (),
    }
    pairs = [(parameter, kind) for kind, parameters in parameters_by_kind.items() for parameter in parameters]
    structure = Structure(tuple(parameter for parameter, _ in pairs), robot, carries_weight=carries_weight)
    return structure, tuple(kind for _, kind in pairs)


def _gravity_parameters(robot: RobotModel) -> Iterator[Parameter]:
    """Yield the sources of torque on the gears at rest whose values the prior states as uncertain.

    These are the masses of links 2 to 6, and the size of the compensator's torque.
    """
    sources: list[Parameter] = [LinkMass(joint) for joint in JOINTS[1:]]
    if robot.compensator is not None:
        sources.append(CompensatorSize())
    return (parameter for parameter in sources if robot.prior_sigma(parameter) > 0.0)


def can_identify_compensator(robot: RobotModel, data: Measurements) -> bool:
    """Return whether K_c and s₀ can be identified: a compensator exists, and readings at three levels of q2 or more."""
    return robot.compensator is not None and int(levels_of(data).max()) >= 2


class KindsOfStructure(NamedTuple):
    """Kinds of parameters that form a structure, or a part of one; `name` for the user."""

    name: str
    kinds: tuple[str, ...]


_GEAR_PARTS = (
    KindsOfStructure("", ()),
    KindsOfStructure(", gears stiffen", (FADING,)),
    KindsOfStructure(", gears with breakpoints", (KNEE,)),
    KindsOfStructure(", gears stiffen, with breakpoints", (FADING, KNEE)),
    KindsOfStructure(", gears stiffen, with backlash", (FADING, BACKLASH)),
    KindsOfStructure(", gears with breakpoints and backlash", (KNEE, BACKLASH)),
    KindsOfStructure(", gears stiffen, with breakpoints and backlash", (FADING, KNEE, BACKLASH)),
    KindsOfStructure(", gears stiffen, with lost motion", (FADING, LOST_MOTION)),
    KindsOfStructure(", gears with breakpoints and lost motion", (KNEE, LOST_MOTION)),
    KindsOfStructure(", gears stiffen, with breakpoints and lost motion", (FADING, KNEE, LOST_MOTION)),
)
"""Gears that are tried with link springs, from linear ones to rich."""


def candidates(compensator: bool) -> list[KindsOfStructure]:
    """Return the structures to try, from simple to rich.

    The kind `AT_REST` is not listed: it belongs to every structure whose gears are not linear.

    :param compensator: whether K_c and s₀ are parameters of all structures.
    """
    # next to joint springs alone, gears are linear or stiffen
    simple_gears = [gear for gear in _GEAR_PARTS if set(gear.kinds) <= {FADING}]
    # next to the many springs of link ends, backlash and lost motion are tried with all parts of the gears only
    few_gears = [
        gear
        for gear in _GEAR_PARTS
        if set(gear.kinds).isdisjoint({BACKLASH, LOST_MOTION}) or {FADING, KNEE} < set(gear.kinds)
    ]
    arms_and_gears = (
        (KindsOfStructure("joint springs", (JOINT,)), simple_gears),
        (KindsOfStructure("link springs", (JOINT, LINK)), _GEAR_PARTS),
        (KindsOfStructure("link springs, link ends and base", (JOINT, LINK, END)), few_gears),
    )
    spring = KindsOfStructure(", compensator", (COMPENSATOR_SPRING,)) if compensator else KindsOfStructure("", ())
    return [
        KindsOfStructure(arm.name + spring.name + gear.name, (*arm.kinds, *spring.kinds, *gear.kinds))
        for arm, gears in arms_and_gears
        for gear in gears
    ]


_FOLDS = 10
"""Parts of the cross-validation: the usual number (Hastie, Tibshirani and Friedman 2009, section 7.10)."""
_LEAST_WEIGHT = 0.02
"""Structures that weigh less are left out of the mean (assumed)."""
CLEAR_GAIN = 3.0
"""Gain of log evidence (odds of one in twenty) from which the evidence for a richer model is clear."""
_PRIOR_SHARE = 0.9
"""Least ratio of posterior to prior standard deviation of a parameter that only its prior determines (assumed)."""
_LINEARISATIONS = 3
"""Number of linearisations in the fit of all parameters together (assumed)."""


class Candidate(Struct, frozen=True):
    """A structure that was tried.

    :param name: for the user.
    :param parameters: number of parameters.
    :param active: number of parameters that are not zero.
    :param rms_sigma: RMS of the whitened residuals of the fit.
    :param held_out: mean square of the whitened residuals of configurations left out; noise alone gives 1.
    :param error: standard error of the difference between `held_out` and the error of the mean of structures.
    :param weight: of the structure in the mean.
    :param chosen: whether its weight is the largest.
    """

    name: str
    parameters: int
    active: int
    rms_sigma: float
    held_out: float
    error: float
    weight: float
    chosen: bool = False

    @property
    def as_record(self) -> record.TriedStructure:
        """The structure as `identification.json` contains it."""
        return record.TriedStructure(
            structure=self.name,
            parameters=self.parameters,
            active=self.active,
            rms_sigma=self.rms_sigma,
            held_out_sigma2=self.held_out,
            standard_error=self.error,
            weight=self.weight,
            chosen=self.chosen,
        )


class Choice(Struct, frozen=True, eq=False):
    """The mean of structures, and its errors.

    :param fit: the mean, with its posterior covariance.
    :param bound_covariance: (p, p) of its parameters, for the bound; wider than the posterior.
    :param candidates: all structures tried, simple to rich.
    :param reason: of the choice, one sentence.
    :param held_out: (C,) mean square whitened residual of each configuration when it was left out.
    :param left_out: (L, P, 3) measured − predicted displacements, each when its configuration was left out [m].
    :param influence: (p, rows) derivatives of the parameters by the whitened readings.
    :param effective_parameters: effective number of parameters of the mean, which the readings determine.
    :param held_by_prior: parameters that the readings do not narrow.
    :param evidence: log evidence of the structure with all parameters.
    """

    fit: Fit
    bound_covariance: Array
    candidates: tuple[Candidate, ...]
    reason: str
    held_out: Array
    left_out: Array
    influence: Array
    effective_parameters: float
    held_by_prior: tuple[Parameter, ...]
    evidence: float


class Member(Struct, frozen=True, eq=False):
    """A structure of the mean.

    :param name: for the user.
    :param nonlinear: whether its gears do not deflect in proportion to the torque.
    :param regression: of all readings.
    :param held_out_residual: (rows,) whitened residual of each reading when its fold was left out.
    """

    name: str
    nonlinear: bool
    regression: Regression
    held_out_residual: Array

    @classmethod
    def of(
        cls, name: str, nonlinear: bool, *, equations: LinearEquations, prior: Prior, columns: Ints, fold: Ints
    ) -> Member:
        """Return a structure with its regression on the readings and its cross-validation residuals.

        :param nonlinear: whether its gears do not deflect in proportion to the torque.
        :param columns: (n,) indices of its parameters among those of the equations.
        :param fold: (C,) number of the fold of each configuration.
        """
        regression = learn(equations, prior, columns)
        return cls(name, nonlinear, regression, _fold_residuals(regression, equations, fold))


class Mean(Struct, frozen=True, eq=False):
    """Structures and their weights (m,), which sum to one, on one set of linear equations."""

    structure: Structure
    equations: LinearEquations
    members: tuple[Member, ...]
    weights: Array

    @property
    def mean_square_errors(self) -> Array:
        """Mean square cross-validation errors (C,) of the mean of structures, by configuration [σ²]."""
        residual = sum(
            weight * member.held_out_residual for weight, member in zip(self.weights, self.members, strict=True)
        )
        return self.equations.mean_squares(np.asarray(residual))

    @property
    def weighted_members(self) -> list[tuple[float, Member]]:
        """The structures with a weight, each with its weight."""
        pairs = zip(self.weights, self.members, strict=True)
        return [(float(weight), member) for weight, member in pairs if weight > 0.0]

    def solve(self, excluded_configs: Ints | None = None) -> Array:
        """Return the parameters (p,) of the mean, SI.

        :param excluded_configs: configurations whose readings are left out; None: none.
        """
        weighted_values = (
            weight * member.regression.solve(self.equations, excluded_configs)
            for weight, member in self.weighted_members
        )
        return np.asarray(sum(weighted_values))

    def covariance(self) -> Array:
        """Return the posterior covariance (p, p), within the structures and between them, SI."""
        mean, total = self.solve(), np.zeros((len(self.structure.parameters),) * 2)
        for weight, member in self.weighted_members:
            difference = member.regression.solve(self.equations) - mean
            total += weight * (member.regression.covariance(self.equations) + np.outer(difference, difference))
        return total

    def spread(self) -> Array:
        """Return the prior standard deviations (p,), SI; zero for parameters of no structure."""
        variance = np.zeros(len(self.structure.parameters))
        for weight, member in self.weighted_members:
            variance[member.regression.columns] += weight * member.regression.spread**2
        return np.asarray(np.sqrt(variance))


class _CandidateEquations(Struct, frozen=True, eq=False):
    """The structure with all candidate parameters.

    :param kinds: kind of each parameter.
    :param prior: of the parameters.
    :param equations: linearised near the values of the fit.
    :param full_regression: on all parameters.
    """

    structure: Structure
    kinds: tuple[str, ...]
    prior: Prior
    equations: LinearEquations
    full_regression: Regression


def choose(robot: RobotModel, data: Measurements, placement: Placement) -> Choice:
    """Fit all structures, and return their mean with the least cross-validation error.

    Structures with a free compensator are returned only if the evidence for them is clear, the readings determine the
    compensator, and it could be built. Else the compensator has the values of the robot.

    :raises PostprocError: not even joint springs can be fitted.
    """
    solution = _equations_with_weights_or_without(robot, data, placement)
    if can_identify_compensator(robot, data):
        with suppress(PostprocError):  # the structures without a free compensator remain
            free = _candidate_equations(robot, data, placement, solution.structure.carries_weight, compensator=True)
            if free.full_regression.evidence > solution.full_regression.evidence + CLEAR_GAIN:
                choice = _choice_among(free, data, placement, compensator=True)
                if has_possible_compensator(choice.fit) and not _has_uncertain_compensator(choice):
                    return choice
    return _choice_among(solution, data, placement, compensator=False)


def _choice_among(solution: _CandidateEquations, data: Measurements, placement: Placement, compensator: bool) -> Choice:
    """Return the mean of the candidate structures, extended by couplings and waves if the evidence is for them.

    :param solution: the structure with all candidate parameters.
    :param compensator: whether K_c and s₀ are parameters of all structures.
    """
    mean, solution = _add_couplings_and_waves(_mean_of_structures(solution, compensator), solution, data, placement)
    return _choice_of_mean(mean, solution, data, placement)


def _equations_with_weights_or_without(
    robot: RobotModel, data: Measurements, placement: Placement
) -> _CandidateEquations:
    """Return the fit of all parameters, with gears that follow the load alone, or weights and compensator too.

    Weights and compensator load the gears if the evidence for it is clear, or if no fit without them exists.

    :raises PostprocError: neither can be fitted.
    """
    # if the geometry is a weightless robot's, weights and compensator act on the gears like a load: nothing to choose
    has_gravity_torque = robot.subtract_reference and (robot.has_weight or robot.compensator is not None)
    solutions: list[_CandidateEquations] = []
    for carries_weight in (False, True) if has_gravity_torque else (False,):
        try:
            solutions.append(_candidate_equations(robot, data, placement, carries_weight, compensator=False))
        except PostprocError:
            if not solutions and carries_weight == has_gravity_torque:  # this was the last one
                raise
    # with one solution alone, first and last are the same
    first, last = solutions[0], solutions[-1]
    return last if last.full_regression.evidence > first.full_regression.evidence + CLEAR_GAIN else first


def evidence_of(structure: Structure, values: Array, data: Measurements, placement: Placement) -> float:
    """Return the log evidence of a structure near some values (p,) of its parameters, SI.

    :raises PostprocError: the springs have no equilibrium under a measured load.
    """
    prior, columns = prior_of(structure), np.arange(len(structure.parameters))
    return learn(linearise(structure, values, data, placement), prior, columns).evidence


def _has_uncertain_compensator(choice: Choice) -> bool:
    """Return whether the readings do not determine the stiffness of a free compensator; False without one."""
    fit, k_c = choice.fit, CompensatorStiffness()
    if k_c not in fit.parameter_values:  # the compensator has the values of the robot
        return False
    index = fit.structure.parameters.index(k_c)
    half_width, stiffness = fit.ci95[index], fit.values[index]
    return bool(half_width > UNCERTAIN_SHARE * stiffness)


def _candidate_equations(
    robot: RobotModel, data: Measurements, placement: Placement, carries_weight: bool, compensator: bool
) -> _CandidateEquations:
    """Return the structure with all candidate parameters, fitted in `_LINEARISATIONS`, and its last equations.

    :param carries_weight: whether weights and compensator load the gears at rest.
    :param compensator: whether K_c and s₀ are parameters.
    :raises PostprocError: the springs have no equilibrium under a measured load.
    """
    structure, kinds = full_structure(robot, data, carries_weight, compensator)
    prior, values, columns = prior_of(structure), structure.start_values(), np.arange(len(structure.parameters))
    for _ in range(_LINEARISATIONS):
        equations = linearise(structure, values, data, placement)
        full_regression = learn(equations, prior, columns)
        values = full_regression.solve(equations)
    return _CandidateEquations(structure, kinds, prior, equations, full_regression)


def _mean_of_structures(solution: _CandidateEquations, compensator: bool) -> Mean:
    """Return the candidate structures, with the weights of the mean that has the least cross-validation error.

    Structures whose gears are not linear have a weight only if the evidence for one of them is clear.

    :param solution: the structure with all candidate parameters.
    :param compensator: whether K_c and s₀ are parameters of all structures.
    """
    equations, kinds, fold = solution.equations, np.array(solution.kinds), folds(solution.equations)
    members = []
    for name, member_kinds in candidates(compensator):
        if not set(member_kinds) <= set(solution.kinds):  # this robot has no parameter of one of the kinds
            continue
        nonlinear = not set(member_kinds).isdisjoint(GEARS)
        columns = np.flatnonzero(np.isin(kinds, [*member_kinds, AT_REST] if nonlinear else member_kinds))
        members.append(
            Member.of(name, nonlinear, equations=equations, prior=solution.prior, columns=columns, fold=fold)
        )
    evidence = np.array([member.regression.evidence for member in members])
    is_linear = np.array([not member.nonlinear for member in members])
    has_clear_gears = evidence.max() >= evidence[is_linear].max() + CLEAR_GAIN
    is_candidate = np.ones(len(members), dtype=bool) if has_clear_gears else is_linear
    weights = _stacking_weights(equations, members, np.flatnonzero(is_candidate))
    return Mean(solution.structure, equations, tuple(members), weights)


def folds(equations: LinearEquations) -> Ints:
    """Return the number of the cross-validation fold of each configuration (C,), drawn with a fixed seed."""
    return np.random.default_rng(0).permutation(equations.config_count) % min(_FOLDS, equations.config_count)


def _add_couplings_and_waves(
    mean: Mean, solution: _CandidateEquations, data: Measurements, placement: Placement
) -> tuple[Mean, _CandidateEquations]:
    """Return the mean with further structures, if the evidence for them is clear.

    Tried are couplings of joints (each deflects by the torque on the other), then waves of the compliances over the
    joint angles, on the structure with the most evidence.

    :param solution: the structure with all candidate parameters.
    :returns: the mean, and `solution` with the new parameters; both unchanged without clear evidence.
    """
    idle_joints = unloaded_joints(mean.structure.prior, data)
    loaded_joints = [joint for joint in JOINT_COMPLIANCES if joint not in idle_joints]
    couplings, waves = over_pose.couplings(loaded_joints), over_pose.waves(loaded_joints)
    parameters = (*mean.structure.parameters, *couplings, *waves)
    structure = replace(mean.structure, parameters=parameters)
    prior, old_count = prior_of(structure), len(mean.structure.parameters)
    values = np.concatenate([mean.solve(), np.zeros(len(parameters) - old_count)])
    equations = linearise(structure, values, data, placement)
    coupling_columns, wave_columns = np.split(np.arange(old_count, len(parameters)), [len(couplings)])
    additions = {", coupled wrist": coupling_columns, ", over the pose": wave_columns}
    extensions = _supported_extensions(mean, equations, prior, additions)
    if not extensions:
        return mean, solution
    # the structures of the mean have the new parameters too, at zero
    old_members = [
        replace(member, regression=replace(member.regression, size=len(parameters))) for member in mean.members
    ]
    members = (*old_members, *extensions)
    # structures without a weight in the mean get none in the extended mean
    stacked_rows = np.flatnonzero([*(mean.weights > 0.0), *(True for _ in extensions)])
    weights = _stacking_weights(equations, members, stacked_rows)
    kinds = (*solution.kinds, *(COUPLING for _ in couplings), *(OVER_POSE for _ in waves))
    solution = replace(
        solution,
        structure=structure,
        kinds=kinds,
        prior=prior,
        equations=equations,
        full_regression=extensions[-1].regression,
    )
    return Mean(structure, equations, members, weights), solution


def _supported_extensions(
    mean: Mean, equations: LinearEquations, prior: Prior, additions: Mapping[str, Ints]
) -> list[Member]:
    """Return structures with further parameters, each with clear evidence over the structure before it.

    The first is compared with the structure of the mean that has the most evidence. Empty if no evidence is clear.

    :param equations: of all parameters, further ones included, and `prior` of all.
    :param additions: suffix of the structure's name → columns of the further parameters, in the order of the trials.
    """
    fold = folds(equations)
    best = max((member for _, member in mean.weighted_members), key=lambda member: member.regression.evidence)
    base = Member.of(
        best.name, best.nonlinear, equations=equations, prior=prior, columns=best.regression.columns, fold=fold
    )
    extensions = []
    for label, new_columns in additions.items():
        if len(new_columns) > 0:
            columns = np.concatenate([base.regression.columns, new_columns])
            name = base.name + label
            member = Member.of(name, base.nonlinear, equations=equations, prior=prior, columns=columns, fold=fold)
            if member.regression.evidence > base.regression.evidence + CLEAR_GAIN:
                base = member
                extensions.append(member)
    return extensions


def _fold_residuals(regression: Regression, equations: LinearEquations, fold: Ints) -> Array:
    """Return the cross-validation residuals (rows,): whitened, of each reading from the fit to the other folds.

    :param fold: (C,) number of the fold of each configuration.
    """
    residual = np.empty(len(equations.target))
    for number in np.unique(fold):
        is_left_out = fold[equations.config] == number
        values = regression.solve(equations, excluded_configs=np.flatnonzero(fold == number))
        residual[is_left_out] = equations.residual(values, is_left_out)
    return residual


def _stacking_weights(equations: LinearEquations, members: Sequence[Member], candidate_rows: Ints) -> Array:
    """Return the stacking weights (m,) of the mean with the least cross-validation error: ≥ 0, with sum one.

    Weights below `_LEAST_WEIGHT` are set to zero.

    :param members: m structures.
    :param candidate_rows: indices of the structures that may have a weight; the others have zero.
    """
    from scipy.optimize import nnls  # takes long to import

    residual = np.array([members[index].held_out_residual for index in candidate_rows]) * np.sqrt(equations.weight)
    # the mean square error is wᵀ S w = |Lᵀ w|² with S = L Lᵀ; 1e-9 of its size makes S positive definite
    square = residual @ residual.T / residual.shape[1]
    size = np.trace(square) / len(square)
    rows = np.linalg.cholesky(square + 1e-9 * size * np.eye(len(square))).T
    # an equation "sum of the weights = 1", a thousand times as heavy as the errors; the sum is set to one afterwards
    sum_weight = np.sqrt(1e3 * size)
    matrix = np.vstack([rows, np.full(len(rows), sum_weight)])
    solution, _ = nnls(matrix, np.append(np.zeros(len(rows)), sum_weight), maxiter=1000)
    solution = np.where(solution > _LEAST_WEIGHT * solution.sum(), solution, 0.0)
    weights = np.zeros(len(members))
    weights[candidate_rows] = solution / solution.sum()
    return weights


def _choice_of_mean(mean: Mean, solution: _CandidateEquations, data: Measurements, placement: Placement) -> Choice:
    """Return the mean of the candidate structures as one fit, with its posterior, its bound, and held-out errors.

    Parameters that change nothing are omitted: springs of links that are zero, waves of a compliance that is constant.

    :param mean: the structures, weighed by their evidence.
    :param solution: the equations of all candidate parameters, for their evidence.
    """
    # once more at the mean: the effect of nonlinear parameters depends on it a little
    mean = replace(mean, equations=linearise(mean.structure, mean.solve(), data, placement))
    equations, parameters = mean.equations, mean.structure.parameters
    values, posterior, spread = mean.solve(), mean.covariance(), mean.spread()
    jackknife, held_out_residual = _jackknife(mean)
    # each spring of a link is a coordinate of the model, which costs time: springs that are zero are left out, and the
    # other parameters take over their effect (`projection`)
    is_link = np.array([isinstance(parameter, LinkSpring) for parameter in parameters])
    is_constant = _is_constant_over_pose(mean.structure, spread)
    columns = np.flatnonzero((spread > 0.0) & ((values != 0.0) | ~is_link) & ~is_constant)
    transform = projection(equations, columns, spread)
    parameter_number, influence = _effective_parameters(mean)
    # twice the posterior times the design effect, and the jackknife: the bound then holds for nearly every simulated
    # robot (see the module)
    bound_covariance = 2.0 * design_effect(equations, influence, held_out_residual) * posterior + jackknife
    fit = _fit_of(mean, columns, transform @ posterior @ transform.T, parameter_number, data, placement)
    square_errors, table = equations.mean_squares(held_out_residual), _candidate_table(mean)
    is_narrower = np.sqrt(np.diag(posterior)) < _PRIOR_SHARE * spread
    held_out_by_state = held_out_residual.reshape(len(data.loaded_states), len(data.points), 3)
    return Choice(
        fit=fit,
        bound_covariance=transform @ bound_covariance @ transform.T,
        candidates=table,
        reason=_choice_reason(table, float(square_errors.mean())),
        held_out=square_errors,
        left_out=unwhiten(whitening(data), held_out_by_state),
        influence=transform @ influence,
        effective_parameters=parameter_number,
        held_by_prior=tuple(parameters[index] for index in np.flatnonzero((spread > 0.0) & ~is_narrower)),
        evidence=solution.full_regression.evidence,
    )


def _effective_parameters(mean: Mean) -> tuple[float, Array]:
    """Return the effective number of parameters of a mean, and its derivatives (p, rows) by the whitened readings.

    Both are means over the structures by their weights.
    """
    equations = mean.equations
    weighted_fits = [
        (weight, member.regression, member.regression.solve(equations)) for weight, member in mean.weighted_members
    ]
    number = sum(
        weight * regression.degrees_of_freedom(equations, values) for weight, regression, values in weighted_fits
    )
    influence = sum(weight * regression.influence(equations, values) for weight, regression, values in weighted_fits)
    return float(number), np.asarray(influence)


def _fit_of(
    mean: Mean, columns: Ints, covariance: Array, parameter_number: float, data: Measurements, placement: Placement
) -> Fit:
    """Return a mean as a fit of k of its parameters; the other parameters are zero in the fit.

    :param columns: (k,) indices of the parameters that remain.
    :param covariance: (k, k) of these parameters, SI.
    :param parameter_number: effective number of parameters.
    """
    equations, values = mean.equations, mean.solve()[columns]
    structure = replace(mean.structure, parameters=tuple(mean.structure.parameters[index] for index in columns))
    prediction, _ = predict(structure, values, data, placement)
    return Fit.of(
        structure,
        values,
        data,
        placement,
        covariance=covariance,
        dof=max(1, round(equations.reading_count - parameter_number)),
        prediction=prediction,
        design=equations.design[:, columns],
        target=equations.target,
    )


def _jackknife(mean: Mean) -> tuple[Array, Array]:
    """Return the jackknife covariance (p, p) of the parameters, SI, and whitened residuals (rows,) of the readings.

    One configuration is left out at a time; the residuals of its readings are those of the fit to all others.
    """
    equations = mean.equations
    values = np.array([mean.solve(np.array([index])) for index in range(equations.config_count)])
    residual = np.empty(len(equations.target))
    for index in range(equations.config_count):
        rows = equations.config == index
        residual[rows] = equations.residual(values[index], rows)
    deviation = values - values.mean(axis=0)
    return (len(deviation) - 1) / len(deviation) * deviation.T @ deviation, residual


_CONSTANT_SHARE = 0.005
"""Standard deviation of a compliance over the pose, as a share of the compliance, below which it is constant."""


def _is_constant_over_pose(structure: Structure, spread: Array) -> Bools:
    """Return True for parameters (p,) that are waves of a joint whose compliance is constant over the pose.

    It counts as constant if the prior's standard deviations of its waves are small together, see `_CONSTANT_SHARE`.

    :param spread: (p,) prior standard deviations, SI.
    """
    is_constant = np.zeros(len(spread), dtype=bool)
    for joint in JOINT_COMPLIANCES:
        rows = [
            index
            for index, parameter in enumerate(structure.parameters)
            if isinstance(parameter, PoseWave) and parameter.joint == joint.joint
        ]
        compliance = structure.prior.compliance[structure.prior.row(joint)]
        # the mean square of a sine or cosine is a half
        is_constant[rows] = np.sqrt(np.sum(spread[rows] ** 2) / 2.0) < _CONSTANT_SHARE * compliance
    return is_constant


def design_effect(equations: LinearEquations, influence: Array, residual: Array) -> float:
    """Return the design effect of configurations (Kish 1965), at least 1: the factor on the variance of a fit.

    Residuals r of one configuration c have a common error. The design effect is Σ_c r_cᵀ H_c r_c / Σ_i H_ii r_i²: the
    variance with this error over the variance with independent residuals. H is design times influence, H_c its block of
    configuration c. It is 1 if the denominator is not positive.

    :param influence: (p, rows) derivatives of the parameters by the whitened readings.
    :param residual: (rows,) whitened residuals of configurations left out.
    """
    clustered_variance, independent_variance = 0.0, 0.0
    for config in range(equations.config_count):
        rows = np.flatnonzero(equations.config == config)
        effect = (equations.design[rows] @ influence[:, rows]) * np.outer(residual[rows], residual[rows])
        clustered_variance += float(effect.sum())
        independent_variance += float(np.trace(effect))
    return max(1.0, clustered_variance / independent_variance) if independent_variance > 0.0 else 1.0


def projection(equations: LinearEquations, columns: Ints, spread: Array) -> Array:
    """Return the matrix (k, p) that maps values of p parameters to values of k of them with the same effect.

    The effect on the readings is the same in least squares; the prior of the k parameters is a ridge. The k parameters
    keep their values, and take over the effect of the others: for them the matrix is (D_kᵀD_k + S_k⁻²)⁻¹ D_kᵀD, with
    the whitened design D and prior standard deviations S, computed in units of S.

    :param columns: (k,) indices of the k parameters.
    :param spread: (p,) prior standard deviations, which limit the changes of the k parameters.
    """
    square = spread[columns, None] * equations.normal_equations(np.arange(len(spread))).square[columns]
    normal = square[:, columns] * spread[columns] + np.eye(len(columns))
    matrix = spread[columns, None] * np.linalg.solve(normal, square)
    matrix[:, columns] = np.eye(len(columns))
    return np.asarray(matrix)


def _candidate_table(mean: Mean) -> tuple[Candidate, ...]:
    """Return the results of each structure that was tried, simple to rich; `chosen` marks the largest weight."""
    equations, mean_errors = mean.equations, mean.mean_square_errors
    rows = []
    for weight, member in zip(mean.weights, mean.members, strict=True):
        squares = equations.mean_squares(member.held_out_residual)
        difference, values = squares - mean_errors, member.regression.solve(equations)
        rows.append(
            Candidate(
                name=member.name
                + (" with load and weights" if mean.structure.carries_weight and member.nonlinear else ""),
                parameters=len(member.regression.columns),
                active=int(np.count_nonzero(values)),
                rms_sigma=float(np.sqrt(np.mean(equations.residual(values) ** 2))),
                held_out=float(squares.mean()),
                error=float(difference.std(ddof=1) / np.sqrt(len(difference))),
                weight=float(weight),
            )
        )
    heaviest = int(np.argmax(mean.weights))
    return tuple(replace(row, chosen=index == heaviest) for index, row in enumerate(rows))


def _choice_reason(table: Sequence[Candidate], square_error: float) -> str:
    """Return a sentence with the structures of the mean, the heaviest first, and the mean square error.

    :param table: all structures tried; the first has joint springs alone.
    :param square_error: mean square cross-validation error of the mean [σ²].
    """
    rows = sorted((row for row in table if row.weight > 0.0), key=lambda row: -row.weight)
    parts = "; ".join(f"{row.weight:.0%} {row.name}" for row in rows)
    return (
        f"chosen: {parts}: cross-validation error {square_error:.2f} σ² (noise alone: 1; joint springs alone: "
        f"{table[0].held_out:.2f} σ²)"
    )
