"""Error of transmission: joints stand elsewhere than the angle that the controller holds, once and twice a turn.

Gear wheels that run out of true, and mounted encoders, turn a joint by q + s₁·sin q + c₁·cos q + s₂·sin 2q + c₂·cos 2q
where the controller says q. Springs, weights and geometry see the actual angle.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from msgspec import Struct

from postproc.frames import Array
from postproc.robot.model_file import JOINTS, TransmissionEntry
from postproc.robot.parameter import PER_URAD

GEAR_TERMS = ("sin", "cos", "sin2", "cos2")
"""Terms of a joint, in the order of `Transmission.amplitude`."""
_ROUNDS = 60
_SAME = 1e-14


class Transmission(Struct, frozen=True, eq=False):
    """Errors of transmission of six joints; `amplitude` (6, 4) of sin q, cos q, sin 2q, cos 2q [rad]."""

    amplitude: Array

    @classmethod
    def of(cls, entries: Mapping[str, TransmissionEntry]) -> Transmission | None:
        """Return what a model file states, or None."""
        amplitude = np.array(
            [
                [getattr(entries[joint], f"{term}_urad") / PER_URAD if joint in entries else 0.0 for term in GEAR_TERMS]
                for joint in JOINTS
            ]
        )
        return cls(amplitude) if amplitude.any() else None

    def actual(self, q: Array) -> Array:
        """Return where joints stand (6, n) for angles (6, n) that the controller holds [rad]."""
        return np.asarray(q + np.einsum("jk,kjn->jn", self.amplitude, waves(q)))

    def commanded(self, actual: Array) -> Array:
        """Return the angles (6, n) that the controller holds for joints to stand at angles (6, n) [rad].

        By fixed point: an error of hundredths at most shrinks the rest by as much each time.
        """
        q = actual
        for _ in range(_ROUNDS):
            q, before = actual - (self.actual(q) - q), q
            if np.abs(q - before).max(initial=0.0) <= _SAME:
                break
        return q


def waves(q: Array) -> Array:
    """Return sin q, cos q, sin 2q, cos 2q (4, ...) of angles [rad]."""
    return np.stack([np.sin(q), np.cos(q), np.sin(2.0 * q), np.cos(2.0 * q)])
