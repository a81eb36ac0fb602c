"""Errors of the set-up that no reading shows, as the experiment states them: of all loads, and of where they act.

A load cell that is wrong by 2 % makes every spring look 2 % softer and leaves no residual behind; a load point that is
off turns into springs what is a lever. Both go into the covariance of the parameters.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc.frames import Array
from postproc.identification.displacements import whiten, whitening
from postproc.identification.fit import NORMAL_95, Fit
from postproc.identification.measurements import Measurements
from postproc.identification.placement import Placement
from postproc.identification.prediction import predict
from postproc.robot import Backlash, CompensatorSize, CompensatorTorque, LinkMass, Parameter

_STEP = 1e-3


def with_stated_errors(fit: Fit, data: Measurements, placement: Placement, influence: Array | None) -> Fit:
    """Return the fit with a covariance that counts the stated errors of the loads and of their point.

    :param influence: (p, rows) by how much the parameters change with the whitened readings; None: least squares.
    """
    wrong = []
    if data.load_error > 0.0:
        share = np.array([_share(parameter) for parameter in fit.structure.parameters])
        wrong.append(data.load_error / NORMAL_95 * share * fit.values)
    if data.load_point_error > 0.0:
        if influence is None:
            scale = np.linalg.norm(fit.design, axis=0)
            scale[scale == 0.0] = 1.0
            influence = np.linalg.pinv(fit.design / scale, rcond=1e-9) / scale[:, None]
        w = whitening(data)
        here, _ = predict(fit.structure, fit.values, data, placement)
        for axis in np.eye(3):
            moved = replace(data, load_point=data.load_point + _STEP * axis)
            there, _ = predict(fit.structure, fit.values, moved, placement)
            wrong.append(data.load_point_error * influence @ whiten(w, (there - here) / _STEP).ravel())
    return replace(fit, covariance=fit.covariance + sum(np.outer(each, each) for each in wrong))


def _share(parameter: Parameter) -> float:
    """Return by how much of its value a parameter is wrong for each share that the loads are."""
    if isinstance(parameter, Backlash | LinkMass | CompensatorSize):  # torques; the stated values contain those at rest
        return 0.0
    return -1.0 if isinstance(parameter, CompensatorTorque) else 1.0
