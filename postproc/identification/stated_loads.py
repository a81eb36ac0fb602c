"""Loads that are stated in other axes than those of the robot root, or at another point than the one that they pull.

Links and gears that no joint spring describes leave a tenth of the displacements, whatever the set-up is. So forces in
wrong axes pass for a soft robot with a wide bound. But a turn of the forces has three parameters alone, and so has a
point: if joint springs leave much less with them, the set-up is stated wrong.
"""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.errors import MeasurementError, PostprocError
from postproc.frames import DEG_PER_RAD, RAD_PER_DEG, Array, angle_between, norm, rotation_vector
from postproc.identification.fit import Fit, gauss_newton, solve
from postproc.identification.measurement_model import (
    Placement,
    Structure,
    displacement_residuals,
    measured_displacements,
    predict,
    unloaded_flange,
    visible_points,
    whiten,
    whitened_derivatives,
    whitening,
)
from postproc.identification.readings import Measurements
from postproc.identification.stated_points import coordinates_text, displaced_points
from postproc.robot import JOINT_COMPLIANCES, RobotModel

_ROUNDS = 2
"""Turns of the forces and fits of the springs in turn: the second moves the angle by half a degree."""
DOUBTFUL_RATIO, CERTAIN_RATIO = 0.75, 0.5
"""Ratios of the residuals with turned forces to those as stated. Of 601 simulated robots with springs of links,
backlash and couplings, whose forces were stated right, one is below 0.8 and none below 0.75."""
_DOUBTFUL_POINT_RATIO = 0.6
"""Ratio of the residuals with another load point to those as stated. Springs of links imitate a load point more than a
turn: two of 137 such robots are at 0.7."""
_EXPLAINED_CHI2 = 2.0
"""χ² per degree of freedom up to which joint springs explain the readings: a turn by 5° leaves two tenths of a
millimetre of displacements of 2 mm, more than three times the noise of a tracker."""
_MIN_LOADS = 3
"""Loaded states from which a turn can be told from other springs."""
_MIN_DISTANCE = 0.05
"""Distance [m] of another load point that is no inexact measurement (assumed)."""
_MIN_SPREAD = 0.1
"""Least singular value of the directions of the forces, over the largest, by which all three axes can be told."""
_ALIGNED_ANGLE, _NAMED_ANGLE = 5.0 * RAD_PER_DEG, 12.0 * RAD_PER_DEG
"""Angles up to which axes are those of the root (assumed: no rig is aligned much better), and up to which a turn is one
with a name: springs of links mislead the angle by some degrees."""
_OPPOSITE_ANGLE = 30.0 * RAD_PER_DEG
"""Angle to a mirror at the origin up to which forces are of the other sign, as `plausibility.check_loads` says."""


class _Hypothesis(NamedTuple):
    """Other axes or another point of the loads than stated.

    :param ratio: RMS of the residuals with the hypothesis over RMS with the loads as stated.
    :param clause: the hypothesis as the end of a sentence, for the user.
    :param advice: what to check.
    """

    ratio: float
    clause: str
    advice: str


_STATED_LOADS = _Hypothesis(1.0, "", "")
"""The loads as stated."""


class _Turn(Struct, frozen=True, eq=False):
    """Forces in other axes.

    :param matrix: (3, 3) orthogonal matrix from stated forces to forces in root axes; determinant −1 if it mirrors.
    :param ratio: RMS of the residuals with turned forces over RMS with the forces as stated.
    """

    matrix: Array
    ratio: float


def doubt_of_loads(prior: RobotModel, data: Measurements, placement: Placement) -> str:
    """Return, as a clause, in which other axes or at which other point the loads fit better.

    Empty if they fit as stated: joint springs explain the readings, or no hypothesis leaves less than `DOUBTFUL_RATIO`
    of the residuals. Empty too with fewer than `_MIN_LOADS` loads, and without an equilibrium.

    :raises MeasurementError: a hypothesis leaves less than `CERTAIN_RATIO` of the residuals.
    """
    try:
        stated_fit = _joint_springs(prior, data, placement)
    except PostprocError:  # no equilibrium: other checks name the cause
        return ""
    if len(data.loaded_states) < _MIN_LOADS or stated_fit.chi2 < _EXPLAINED_CHI2 * stated_fit.dof:
        return ""
    hypotheses = [_STATED_LOADS]
    for best_hypothesis in (_axes_hypothesis, _point_hypothesis):
        with suppress(PostprocError):  # no equilibrium: it does not explain the readings
            hypotheses.append(best_hypothesis(prior, data, placement, stated_fit))
    best = min(hypotheses)  # by ratio, the first field
    if best.ratio > DOUBTFUL_RATIO:
        return ""
    text = f"the loads fit {1.0 / best.ratio:.1f} times better {best.clause}"
    if best.ratio < CERTAIN_RATIO:
        raise MeasurementError(
            "; ".join(filter(None, (text, displaced_points(data, placement)))), file=data.file, advice=best.advice
        )
    return f"{text}. {best.advice.removesuffix('.')}"


def _axes_hypothesis(prior: RobotModel, data: Measurements, placement: Placement, stated: Fit) -> _Hypothesis:
    """Return the axes in which the forces fit best.

    `_STATED_LOADS` if the directions of the forces do not show all axes, or if the best turn has no name.

    :param stated: fit of the joint springs with the loads as stated.
    """
    force = data.wrench[data.loaded_states, :3]
    # 1e-9 N keeps zero out of the denominator
    spread = np.linalg.svd(force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-9), compute_uv=False)
    if spread[2] < _MIN_SPREAD * spread[0]:
        return _STATED_LOADS
    advice = (
        "F and M are in the axes of the robot root ($ROBROOT), whatever the axes of load cell or tracker are. Turn or "
        "exchange them."
    )
    flange_ratio = _joint_springs(prior, _loads_in_flange_axes(prior, data), placement).rms / stated.rms
    turn = _best_turn(prior, data, placement, stated.rms)
    if flange_ratio < turn.ratio:
        return _Hypothesis(flange_ratio, "if they are in flange axes", advice)
    axes = _turn_description(turn.matrix, placement)
    return _Hypothesis(turn.ratio, axes, advice) if axes else _STATED_LOADS


def _point_hypothesis(prior: RobotModel, data: Measurements, placement: Placement, stated: Fit) -> _Hypothesis:
    """Return the point at which the loads fit best; `_STATED_LOADS` if that is near the stated point or fits no better.

    :param stated: fit of the joint springs with the loads as stated.
    """
    point, ratio = _best_point(data, placement, stated)
    distance = float(norm(point - data.load_point))
    if distance < _MIN_DISTANCE or ratio > _DOUBTFUL_POINT_RATIO:
        return _STATED_LOADS
    clause = (
        f"if they pull at {coordinates_text(point)} mm in the flange frame, not at {coordinates_text(data.load_point)}"
    )
    advice = "Check [load_point]: its unit (mm), its signs, and that it is in the flange frame."
    return _Hypothesis(ratio, clause, advice)


class _LoadPoint(NamedTuple):
    """A load point.

    :param position: (3,) in the flange frame [m].
    :param ratio: RMS of the residuals with this point over RMS with the stated point.
    """

    position: Array
    ratio: float


def _best_point(data: Measurements, placement: Placement, stated: Fit) -> _LoadPoint:
    """Return the load point that joint springs fit best; the stated point if no other fits better.

    Gauss-Newton steps for springs and point together, with difference quotients by the point; after each step the
    springs are fitted anew.

    :param stated: fit of the joint springs with the loads as stated.
    """
    structure, whitening_matrix = stated.structure, whitening(data)
    point, values, best = data.load_point, stated.values, _LoadPoint(data.load_point, 1.0)
    for _ in range(_ROUNDS):
        prediction, slopes = predict(structure, values, replace(data, load_point=point), placement)
        by_point = [
            predict(structure, values, replace(data, load_point=point + step), placement)[0] - prediction
            for step in _POINT_STEP * np.eye(3)
        ]
        columns = np.concatenate([slopes, np.stack(by_point, axis=-1) / _POINT_STEP], axis=-1)
        design = whitened_derivatives(whitening_matrix, columns, data)
        target = whiten(whitening_matrix, displacement_residuals(prediction, data, placement)).ravel()
        point = point + solve(design, target)[-3:]  # the last three unknowns, after the springs
        fit = gauss_newton(structure, replace(data, load_point=point), placement)
        values = np.maximum(fit.values, _LEAST_COMPLIANCE)
        if fit.rms / stated.rms < best.ratio:
            best = _LoadPoint(point, fit.rms / stated.rms)
    return best


_POINT_STEP = 0.01
"""Step of the load point [m] for differences: torques are linear in it."""


def _joint_springs(prior: RobotModel, data: Measurements, placement: Placement) -> Fit:
    """Return the fit of the joint compliances alone, from a prior model."""
    return gauss_newton(Structure(JOINT_COMPLIANCES, prior), data, placement)


def _best_turn(prior: RobotModel, data: Measurements, placement: Placement, stated_rms: float) -> _Turn:
    """Return the turn of the forces that joint springs fit best; no turn (identity, ratio 1) if none fits better.

    The turn and the springs are fitted alternately, `_ROUNDS` times.

    :param stated_rms: RMS of the residuals [m] with the forces as stated.
    """
    structure, whitening_matrix = Structure(JOINT_COMPLIANCES, prior), whitening(data)
    target = whiten(whitening_matrix, measured_displacements(data, placement)).ravel()
    values, best = structure.start_values(), _Turn(np.eye(3), 1.0)
    for _ in range(_ROUNDS):
        design = _force_derivatives(structure, values, data, placement, whitening_matrix)
        free_matrix = np.linalg.lstsq(design, target, rcond=None)[0].reshape(3, 3)  # on the forces, with any entries
        u, _, vt = np.linalg.svd(free_matrix)
        matrix = u @ vt  # the nearest orthogonal matrix (Higham 2008, section 8.1)
        fit = gauss_newton(structure, _turned_loads(data, matrix), placement)
        values = np.maximum(fit.values, _LEAST_COMPLIANCE)
        if fit.rms / stated_rms < best.ratio:
            best = _Turn(matrix, fit.rms / stated_rms)
    return best


_LEAST_COMPLIANCE = 1e-8
"""Compliance [rad/(N·m)] below that of any joint: a fit in wrong axes may make it negative."""
_PROBE_FORCE = 1000.0
"""Force [N] for displacements per newton: they are linear in the force up to there, to a per cent."""


def _force_derivatives(
    structure: Structure, values: Array, data: Measurements, placement: Placement, whitening_matrix: Array
) -> Array:
    """Return the derivatives (n, 9) of the whitened displacements by a matrix (3, 3) that multiplies the forces.

    The columns are by the entries of the matrix, row by row: a row gives a component of the force in root axes.

    :param values: (p,) of the parameters of the structure, SI.
    :param whitening_matrix: (P, L, L), see `measurement_model.whitening`.
    """
    columns, force = [], data.wrench[data.loaded_states, :3]
    for axis in range(3):
        wrench = np.zeros_like(data.wrench)
        wrench[:, axis] = _PROBE_FORCE
        prediction, _ = predict(structure, values, replace(data, wrench=wrench), placement)
        motion = prediction * visible_points(data) / _PROBE_FORCE  # per newton along the axis
        columns += [whiten(whitening_matrix, motion * force[:, None, None, j]).ravel() for j in range(3)]
    return np.stack(columns, axis=1)


def _turned_loads(data: Measurements, matrix: Array) -> Measurements:
    """Return the readings with forces and moments multiplied by (3, 3) or (S, 3, 3) orthogonal matrices.

    A mirror turns moments the other way (they are axial vectors).
    """
    force = np.einsum("...ij,...j->...i", matrix, data.wrench[:, :3])
    moment = np.einsum("...ij,...j->...i", matrix, data.wrench[:, 3:]) * np.linalg.det(matrix)[..., None]
    return replace(data, wrench=np.concatenate([force, moment], axis=1))


def _loads_in_flange_axes(prior: RobotModel, data: Measurements) -> Measurements:
    """Return the readings with their stated forces and moments taken as in flange axes, and turned into root axes."""
    return _turned_loads(data, unloaded_flange(prior, data.q)[data.state_config, :3, :3])


def _turn_description(matrix: Array, placement: Placement) -> str:
    """Return a turn or a mirror of the forces as the end of a sentence.

    Empty if the turn is small, or if it only changes the sign of all forces.

    :param matrix: (3, 3) orthogonal matrix from stated forces to forces in root axes.
    """
    if _angle(matrix, np.eye(3)) < _ALIGNED_ANGLE or _angle(matrix, -np.eye(3)) < _OPPOSITE_ANGLE:
        return ""
    # nearest exchange of axes: each row has the sign of its largest entry, in the column of this entry
    column = np.argmax(np.abs(matrix), axis=1)
    sign = np.sign(matrix[range(3), column])
    exchange = np.eye(3)[column] * sign[:, None]
    is_exchange = len(set(column.tolist())) == 3 and not np.array_equal(exchange, np.eye(3))
    if is_exchange and _angle(matrix, exchange) < _NAMED_ANGLE:
        parts = ", ".join(f"{'-' if sign[row] < 0.0 else ''}F{'xyz'[column[row]]}" for row in range(3))
        return f"if Fx, Fy, Fz of the root are the columns {parts}"
    if np.linalg.det(matrix) < 0.0:
        return "mirrored"
    if _angle(matrix, placement.root_in_device[:3, :3].T) < _NAMED_ANGLE:
        return "if they are in the axes of the measuring device"
    turn = rotation_vector(matrix)
    angle, main_axis = float(norm(turn)), int(np.argmax(np.abs(turn)))
    if norm(np.delete(turn, main_axis)) < np.sin(_NAMED_ANGLE) * angle:
        return f"turned by {turn[main_axis] * DEG_PER_RAD:.1f}° about {'XYZ'[main_axis]} of the root"
    direction = ", ".join(f"{part:.2f}" for part in turn / angle)
    return f"turned by {angle * DEG_PER_RAD:.1f}° about ({direction}) of the root"


def _angle(matrix: Array, other_matrix: Array) -> float:
    """Return the angle [rad] between two rotation matrices (3, 3)."""
    return float(angle_between(matrix[None], other_matrix[None])[0])
