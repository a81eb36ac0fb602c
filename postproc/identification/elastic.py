"""The elastic model as a function of its parameters: predicted displacements of the reference points and derivatives.

The prediction is the equilibrium of `elastostatics.deflect`, so that nothing is linearised in the load (Eq. (8) alone
is off by 0.2–0.3 % at 2.7 kN). The derivatives are those of the equilibrium θ = c(τ(θ); p), c being the compliance law:

    ∂t/∂p = J (I − C_t H)⁻¹ ∂c/∂p        with C_t = ∂c/∂τ, H = ∂τ/∂θ (load, weights, compensator)

Parameters by name, SI: ``k1``…``k6`` compliance of a joint; ``k2#3`` that of joint 2 at the fourth level of q2;
``k1@800`` the part of a gear's compliance that fades beyond 800 N·m (in addition to ``k1``); ``A2.RX`` spring of a
link; ``K_c`` and ``K_c*s_0`` of the compensator, both linear in its torque.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from postproc import elastostatics, kinematics
from postproc.compensator import Compensator
from postproc.frames import Array
from postproc.identification.measurements import Measurements
from postproc.identification.placement import Placement, in_root_axes
from postproc.program import Ints
from postproc.robot import JOINTS, GearStiffening, RobotModel, VirtualSpring, elastic_chain

JOINT_NAMES = ("k1", "k2", "k3", "k4", "k5", "k6")
STIFFNESS, PRELOAD = "K_c", "K_c*s_0"
_NOTHING = 1e-12
"""Weight of a point whose readings are all left out."""
_LEAST = 1e-12
"""Smallest joint compliance [rad/(N·m)] the equilibrium is solved with; fits may pass through zero."""


@dataclass(frozen=True, eq=False)
class Structure:
    """Which springs the model has and which of their values are looked for.

    :param names: (p,) parameters that are identified.
    :param prior: robot that gives all other values (and the geometry, masses, compensator geometry).
    :param levels: (C,) level of q2 of each configuration, for parameters ``k2#…``.
    :param in_gears: stiffening gears feel weights and compensator at rest, not the load alone.
    """

    names: tuple[str, ...]
    prior: RobotModel
    levels: Ints | None = None
    in_gears: bool = False

    @cached_property
    def springs(self) -> tuple[VirtualSpring, ...]:
        """Springs of links among the parameters, in chain order of `elastic_chain`."""
        return tuple(VirtualSpring(*name.split(".")) for name in self.names if _is_link(name))

    @cached_property
    def template(self) -> tuple[RobotModel, dict[str, int]]:
        """The robot with a coordinate for every spring, and the coordinate of each parameter that has one."""
        joints = list(range(len(JOINTS)))
        robot = self.prior
        rows: list[int] = []
        if self.springs:
            chain, actuated, rows = elastic_chain(self.prior.actual, self.springs)
            joints = list(actuated)
            stiffness = np.full(chain.nv, np.inf)
            stiffness[joints] = np.diag(self.prior.stiffness)
            robot = replace(
                self.prior, actual=chain, loaded=chain, stiffness=np.diag(stiffness), actuated=tuple(joints),
                link_springs=self.springs,
            )  # fmt: skip
        row_of = {f"{s.link}.{s.axis}": row for s, row in zip(self.springs, rows, strict=True)}
        row_of |= dict(zip(JOINT_NAMES, joints, strict=True))
        for name in self.names:
            head = name.partition("@")[0].partition("#")[0]
            if head in row_of:
                row_of[name] = row_of[head]
        return robot, row_of

    def robot(self, values: Array, level: int | None = None) -> RobotModel:
        """Return the robot with these values of the parameters.

        :param values: (p,) SI.
        :param level: which of the ``k2#…`` holds for joint 2.
        """
        template, row_of = self.template
        given = dict(zip(self.names, values, strict=True))
        compliance = template.compliance.copy()
        for name in JOINT_NAMES:
            base = given.get(name)
            if name == "k2" and level is not None:
                base = given[f"k2#{level}"]
            if base is not None:
                compliance[row_of[name]] = base
        parts = [(row_of[n], float(n.partition("@")[2]), v) for n, v in given.items() if "@" in n]
        stiffening = None
        if parts:
            row, torque, part = (np.array(column) for column in zip(*parts, strict=True))
            stiffening = GearStiffening(row.astype(np.int64), torque, part, self.in_gears)
            np.add.at(compliance, row, part)
        for name, value in given.items():
            if _is_link(name):
                compliance[row_of[name]] = value
        joint_rows = list(template.actuated)
        compliance[joint_rows] = np.maximum(compliance[joint_rows], _LEAST)
        with np.errstate(divide="ignore"):
            stiffness = np.diag(1.0 / compliance)
        law = template.compensator
        if law is not None and STIFFNESS in given:
            law = _compensator(law, given[STIFFNESS], given[PRELOAD])
        balanced = template.subtract_reference
        if level is not None:  # the levels hold the compensator's part, about the state of rest as in Eq. (4)
            law, balanced = None, True
        return replace(
            template, stiffness=stiffness, stiffening=stiffening, compensator=law, subtract_reference=balanced
        )

    def typical(self) -> Array:
        """Return usual sizes (p,) of the parameters, SI, of a robot of this class."""
        sizes = {STIFFNESS: 1e6, PRELOAD: 1e6}
        return np.array(
            [sizes.get(name) or (1e-8 if name.endswith((".X", ".Y", ".Z")) else 1e-6) for name in self.names]
        )

    def start(self, compliance: float | None = None) -> Array:
        """Return values (p,) to start from: the prior's, zero for what it does not have."""
        robot, row_of = self.template
        values = np.zeros(len(self.names))
        for index, name in enumerate(self.names):
            if name in JOINT_NAMES or "#" in name:
                values[index] = robot.compliance[row_of[name]] if compliance is None else compliance
            elif name in (STIFFNESS, PRELOAD) and robot.compensator is not None:
                law = robot.compensator
                values[index] = law.stiffness * (1.0 if name == STIFFNESS else law.free_length)
        return values


def _is_link(name: str) -> bool:
    return "." in name and "@" not in name  # not k6@6.2: a part that fades at 6.2 N·m


def _compensator(law: Compensator, stiffness: float, preload: float) -> Compensator:
    """Return the law with K_c and K_c·s₀; on its way a fit may pass through values that no spring has.

    The check of `Compensator` is therefore left out here; what is written is checked (`observability`).
    """
    stiffness = stiffness if abs(stiffness) > _LEAST else _LEAST
    made = object.__new__(Compensator)
    for name, value in (("stiffness", stiffness), ("free_length", preload / stiffness)):
        object.__setattr__(made, name, value)
    for name in ("L", "ax", "ay"):
        object.__setattr__(made, name, getattr(law, name))
    return made


def measured_displacements(data: Measurements, placement: Placement) -> Array:
    """Return loaded − unloaded mean positions (L, P, 3) [m] in root axes, L loaded states."""
    mean, _ = data.means()
    rest = data.unloaded[data.state_config[data.loaded]]
    return visible(data) * in_root_axes(placement, mean[data.loaded] - mean[rest])


def visible(data: Measurements) -> Array:
    """Return (L, P, 1) one where a loaded point and its unloaded counterpart have readings, zero elsewhere."""
    _, count = data.means()
    rest = data.unloaded[data.state_config[data.loaded]]
    return np.asarray(((count[data.loaded] > 0) & (count[rest] > 0)).astype(float)[..., None])


def whitening(data: Measurements) -> Array:
    """Return (P, L, L) that turns displacements into unit variance: W Σ Wᵀ = I.

    Loads of one configuration share its unloaded reading: Σ = σ²·(1/n_l on the diagonal, 1/n_0 added everywhere).
    """
    count = np.maximum(data.means()[1], _NOTHING)
    loaded, config = data.loaded, data.state_config[data.loaded]
    same = config[:, None] == config[None]
    rest = data.unloaded[config]
    out = np.empty((len(data.points), len(loaded), len(loaded)))
    for point in range(len(data.points)):
        covariance = np.diag(1.0 / count[loaded, point]) + same / count[rest, point][:, None]
        out[point] = np.linalg.inv(np.linalg.cholesky(covariance)) / data.sigma
    return out


def predict(structure: Structure, values: Array, data: Measurements, placement: Placement) -> tuple[Array, Array]:
    """Return displacements of the points (L, P, 3) [m] in root axes and their derivatives (L, P, 3, p)."""
    states = data.loaded
    config = data.state_config[states]
    out = np.empty((len(states), len(data.points), 3))
    slopes = np.zeros((*out.shape, len(structure.names)))
    if structure.levels is None:
        out[:], slopes[:] = _predict(structure, values, None, data.q[config], data.wrench[states], data, placement)
        return out, slopes
    level = structure.levels[config]
    for value in np.unique(level):
        rows = np.flatnonzero(level == value)
        out[rows], slopes[rows] = _predict(
            structure, values, int(value), data.q[config[rows]], data.wrench[states[rows]], data, placement
        )
    return out, slopes


def _predict(
    structure: Structure,
    values: Array,
    level: int | None,
    q: Array,
    wrench: Array,
    data: Measurements,
    placement: Placement,
) -> tuple[Array, Array]:
    robot = structure.robot(values, level)
    x0 = elastostatics.coordinates(robot, q)
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    lever = placement.points - data.load_point
    pose, twist = _equilibrium(structure, robot, level, x0, tool, wrench)
    loaded, slopes = _of_points(pose, twist, lever)
    if robot.subtract_reference:
        rest, _ = kinematics.tcp(robot.loaded, x0, tool)
        unloaded, _ = _of_points(rest, twist, lever)
    else:  # without load the robot sags by the same springs
        rest, sag = _equilibrium(structure, robot, level, x0, tool, np.zeros_like(wrench))
        unloaded, of_sag = _of_points(rest, sag, lever)
        slopes = slopes - of_sag
    return loaded - unloaded + (pose[:, :3, 3] - rest[:, :3, 3])[:, None], slopes


def _of_points(pose: Array, twist: Array, lever: Array) -> tuple[Array, Array]:
    """Return points (L, P, 3) from the load point, root axes, and how they move (L, P, 3, p) with twists (L, 6, p)."""
    points = np.einsum("lij,pj->lpi", pose[:, :3, :3], lever)
    turned = np.cross(np.swapaxes(twist[:, 3:], 1, 2)[:, None], points[:, :, None], axisa=3, axisb=3, axisc=3)
    return points, twist[:, None, :3] + turned.swapaxes(2, 3)


def _equilibrium(
    structure: Structure, robot: RobotModel, level: int | None, x0: Array, tool: Array, wrench: Array
) -> tuple[Array, Array]:
    """Return the pose (L, 4, 4) of the load point under load and its derivative (L, 6, p), a twist per parameter."""
    _, row_of = structure.template
    second = row_of["k2"]
    found = elastostatics.deflect(robot, x0[:, list(robot.actuated)], tool, wrench)
    x = x0 + found.theta
    _, jacobian = kinematics.tcp(robot.loaded, x, tool)
    torque = np.einsum("lij,li->lj", jacobian, wrench)
    hessian = kinematics.load_stiffness(jacobian, wrench)
    at_rest = np.zeros_like(torque)
    balanced = x0 if robot.subtract_reference else None
    if robot.has_weight:
        torque -= kinematics.gravity_torque(robot.loaded, x)
        hessian -= kinematics.gravity_stiffness(robot.loaded, x)
        if balanced is not None:
            at_rest -= kinematics.gravity_torque(robot.actual, x0)
    if robot.compensator is not None:
        torque[:, second] -= robot.compensator.gradient(x[:, second])
        hessian[:, second, second] -= robot.compensator.stiffness_about_joint(x[:, second])
        if balanced is not None:
            at_rest[:, second] -= robot.compensator.gradient(x0[:, second])
    torque -= at_rest
    in_gears = structure.in_gears and balanced is not None
    if not in_gears:
        at_rest[:] = 0.0
    _, slope = elastostatics.spring_deflection(robot, torque, at_rest)
    tangent = np.eye(x.shape[1]) - slope[:, :, None] * hessian
    reach = np.swapaxes(np.linalg.solve(np.swapaxes(tangent, 1, 2), np.swapaxes(jacobian, 1, 2)), 1, 2)
    amount = np.zeros((len(x), len(structure.names)))
    rows = np.zeros(len(structure.names), dtype=np.int64)
    for index, name in enumerate(structure.names):
        head, _, scale = name.partition("@")
        if name in (STIFFNESS, PRELOAD) and robot.compensator is not None:
            rows[index] = second
            amount[:, index] = -slope[:, second] * _unit_torque(robot.compensator, name, balanced, x, second)
            if in_gears:  # the torque at rest changes too
                _, before_load = elastostatics.spring_deflection(robot, 0.0 * torque, at_rest)
                held = _unit_torque(robot.compensator, name, None, x0, second)
                amount[:, index] -= (slope - before_load)[:, second] * held
        elif scale:
            rows[index] = row_of[head]
            u0 = at_rest[:, rows[index]] / float(scale)
            u = torque[:, rows[index]] / float(scale) + u0
            amount[:, index] = float(scale) * (elastostatics.fading(u) - elastostatics.fading(u0))
        elif "#" not in name or level == int(name.partition("#")[2]):
            rows[index] = row_of[name]
            amount[:, index] = torque[:, rows[index]]
    return found.pose, reach[:, :, rows] * amount[:, None]


def _unit_torque(law: Compensator, name: str, x0: Array | None, x: Array, row: int) -> Array:
    """Return U_c′ at x, less that at x0, per unit of K_c or of K_c·s₀."""
    unit, long = replace(law, stiffness=1.0, free_length=0.0), replace(law, stiffness=1.0, free_length=1.0)

    def torque(angle: Array) -> Array:
        short = unit.gradient(angle)
        return np.asarray(long.gradient(angle) - short if name == PRELOAD else short)

    return np.asarray(torque(x[:, row]) - (0.0 if x0 is None else torque(x0[:, row])))
