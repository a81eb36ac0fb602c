"""The baseline: strict serial chain, full-pose displacements, no compensator.

Source: Dumas, Caro, Garnier, Furet, "Joint stiffness identification of six-revolute industrial serial robots", Robotics
and Computer-Integrated Manufacturing 27 (2011), as the paper describes it. The displacement of the flange, position and
orientation, is computed from the points; k follows by linear least squares from Δt = J diag(k) Jᵀ F, Eq. (2).
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc import elastostatics, kinematics
from postproc.errors import MeasurementError
from postproc.frames import Array, twist_between
from postproc.identification.displacements import measured_displacements, visible, whiten, whitening
from postproc.identification.fit import Fit, covariance_of
from postproc.identification.measurements import Measurements
from postproc.identification.placement import Placement, device_to_root, kabsch
from postproc.identification.prediction import predict
from postproc.identification.structure import Structure
from postproc.robot import JOINT_COMPLIANCES, RobotModel


def flange_displacements(data: Measurements, placement: Placement) -> Array:
    """Return displacements (L, 6) of the load point: position [m], rotation [rad], root axes.

    :raises MeasurementError: fewer than three points, or points on one line: no orientation.
    """
    if len(data.points) < 3 or np.linalg.matrix_rank(placement.points - placement.points.mean(axis=0), tol=5e-3) < 2:
        raise MeasurementError(
            "the serial method needs full poses: three points that are not on a line",
            file=data.file,
            advice="Measure three points, or use --method enhanced.",
        )
    mean, count = data.means()
    root = device_to_root(placement, mean)
    out = np.empty((len(data.loaded), 6))
    for row, state in enumerate(data.loaded):
        rest = data.unloaded[data.state_config[state]]
        seen = (count[state] > 0) & (count[rest] > 0)
        if np.count_nonzero(seen) < 3:
            out[row] = np.nan
            continue
        frames = [kabsch(placement.points[seen], root[index, seen]) for index in (rest, state)]
        load_point = np.eye(4)
        load_point[:3, 3] = data.load_point
        out[row] = twist_between(frames[0] @ load_point, frames[1] @ load_point)
    return out


def fit_serial(robot: RobotModel, data: Measurements, placement: Placement) -> Fit:
    """Fit k1…k6 of a strict serial chain, linear in the load, to full-pose displacements.

    Position [m] and rotation [rad] enter one sum of squares without weights, as in the source.
    """
    bare = replace(robot, compensator=None)
    displacement = flange_displacements(data, placement)
    good = np.isfinite(displacement).all(axis=1)
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    config = data.state_config[data.loaded]
    x = elastostatics.coordinates(bare, data.q[config])
    _, jacobian = kinematics.tcp(bare.actual, x, tool)
    jacobian = jacobian[:, :, list(bare.actuated)]
    torque = np.einsum("lij,li->lj", jacobian, data.wrench[data.loaded])
    design = (jacobian * torque[:, None])[good].reshape(-1, 6)
    target = displacement[good].ravel()
    if len(target) <= 6:
        raise MeasurementError(
            f"{len(target)} components of displacements for 6 compliances",
            file=data.file,
            advice="Measure more configurations.",
        )
    scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    values = np.linalg.lstsq(design / scale, target, rcond=1e-9)[0] / scale
    left = target - design @ values
    sigma2 = float(left @ left) / (len(target) - 6)
    structure = Structure(JOINT_COMPLIANCES, bare)
    deviation = np.sqrt(sigma2)
    covariance = covariance_of(design / deviation, structure.usual())
    moved, slopes = predict(structure, np.maximum(values, 1e-9), data, placement)
    residual = (measured_displacements(data, placement) - moved) * visible(data)
    w = whitening(data)
    white = whiten(w, residual).ravel()
    whole = whiten(w, slopes).reshape(-1, 6)
    return Fit(
        structure, values, covariance, residual, float(white @ white), len(white) - 6, whole, white + whole @ values
    )
