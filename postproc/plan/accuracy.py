"""What to expect of a plan: accuracy after compensation with its interval, intervals of the parameters.

Here the parameters are those that the identification ends with: k1…k6, and K_c, s₀K_c where they can be determined, all
readings weighted by their noise (Gauss–Markov): Cov = (Σ DᵀBᵀB D)⁻¹. The criterion, which follows the paper's two
steps, is never smaller.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.frames import Array
from postproc.identification.fit import NORMAL_95
from postproc.identification.observability import UNCERTAIN
from postproc.plan.criterion import Joint2, Measured
from postproc.plan.milling import TestPoses
from postproc.plan.sensitivity import Readings
from postproc.robot import COMPENSATOR, JOINT_COMPLIANCES, Parameter

_OPEN = 1e-9


class Accuracy(Struct, frozen=True, eq=False):
    """Expected error of the tool tip after compensation, over the test poses with their weights.

    :param rms: root of the expected mean square [m].
    :param interval: 95 % interval of the RMS that one identification with this plan reaches [m].
    :param poses: (T,) expected RMS at each test pose [m].
    :param parameters: P of them.
    :param relative: (P,) half widths of their 95 % intervals over the robot's values.
    """

    rms: float
    interval: tuple[float, float]
    poses: Array
    parameters: tuple[Parameter, ...]
    relative: Array

    @property
    def uncertain(self) -> tuple[Parameter, ...]:
        """Parameters that the identification would not take from such measurements."""
        return tuple(p for p, half in zip(self.parameters, self.relative, strict=True) if not half <= UNCERTAIN)


def expected(
    tests: TestPoses, readings: Readings, joint2: Joint2, q: Array, information: Array, measured: Measured | None = None
) -> Accuracy:
    """Return what a plan is expected to reach.

    :param q: (n, 6) poses of the plan [rad], with `information` (n, p, p).
    :param measured: what was measured already.
    """
    keep = list(readings.keep)
    if measured is not None:
        q, information = np.vstack([q, measured.q]), np.concatenate([information, measured.information])
    spread = _parameters(joint2, keep, q)
    normal = np.einsum("nia,nij,njb->ab", spread, information, spread)
    a = (tests.regressor[:, :, keep] * readings.scale[keep]) @ _parameters(joint2, keep, tests.q)
    covariance = _inverse(normal)
    each = np.einsum("tka,ab,tkb->t", a, covariance, a)
    moment = np.einsum("t,tka,tkb->ab", tests.weight, a, a)
    mean = float(tests.weight @ each)
    # the mean square error of one identification is a sum of squares of normal numbers: g·χ²_h (Satterthwaite 1946)
    product = covariance @ moment
    square = float(np.sum(product * product.T))
    h, g = mean**2 / square, square / mean
    interval = tuple(float(np.sqrt(g * _chi2(h, z))) for z in (-NORMAL_95, NORMAL_95))
    parameters = (*(JOINT_COMPLIANCES[index] for index in keep), *(COMPENSATOR if joint2.free else ()))
    half = NORMAL_95 * np.sqrt(np.diag(covariance))
    if joint2.free and joint2.compensator is not None:
        stiffness = joint2.compensator.stiffness * joint2.compliance
        half[len(keep) :] /= np.maximum([stiffness, stiffness * joint2.compensator.free_length], 1e-300)
    return Accuracy(float(np.sqrt(mean)), (interval[0], interval[1]), np.sqrt(each), parameters, half)


def not_visible(readings: Readings, information: Array, count: int) -> tuple[int, ...]:
    """Return the joints whose compliance no plan of `count` poses could determine.

    :param information: (N, 6, 6) of many poses that can be measured.
    """
    most = np.diagonal(information, axis1=1, axis2=2).max(axis=0) * count
    return tuple(int(j) for j in np.flatnonzero(most < (NORMAL_95 / UNCERTAIN) ** 2))


def _parameters(joint2: Joint2, keep: list[int], q: Array) -> Array:
    """Return D (n, p, P): how the compliances at configurations q depend on the parameters."""
    size = len(keep)
    own = joint2.parameters(q[:, 1])
    out = np.zeros((len(q), size, size + own.shape[1] - 1))
    out[:, range(size), range(size)] = 1.0
    two = keep.index(1)
    out[:, two, two] = own[:, 0]
    out[:, two, size:] = own[:, 1:]
    return out


def _inverse(normal: Array) -> Array:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal * np.outer(scale, scale) + _OPEN**2 * np.eye(len(normal))
    return np.asarray(np.linalg.inv(scaled) * np.outer(scale, scale))


def _chi2(freedom: float, z: float) -> float:
    """Return the quantile of χ² at z standard deviations."""
    from scipy.special import gammaincinv, ndtr

    return float(2.0 * gammaincinv(0.5 * freedom, ndtr(z)))
