"""Gravity compensator: a spring between P0 (on link 1) and P1 (on link 2), acting about joint 2.

Source: Klimchik et al., "Accuracy improvement of robot-based milling using an enhanced manipulator model",
Eq. (3), (4). All angles are joint 2's, KUKA sign [rad]; lengths m, stiffness N/m.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import force_setattr

from postproc.errors import ModelError
from postproc.frames import Array, sine_and_cosine

_NO_SPRING = 1e-12
"""Stiffness [N/m] used instead of zero as a divisor."""


class _Crank(NamedTuple):
    """The crank of a compensator at n angles.

    :param area: |P0P2|·L [m²].
    :param sine: (n,) of the crank angle.
    :param cosine: (n,) of the crank angle.
    :param length: (n,) |P0P1| [m].
    """

    area: float
    sine: Array
    cosine: Array
    length: Array


class Compensator(Struct, frozen=True):
    """Spring of stiffness `stiffness` [N/m] and free length `free_length` [m]; |P2P1| = `L`, P0 at (`ax`, `ay`) [m].

    >>> law = Compensator(stiffness=1.2e5, free_length=0.458, L=0.18472, ax=0.68593, ay=0.1233)
    >>> float(law.length(np.array(0.0)).round(4))
    0.8793
    >>> [round(float(of(np.array(-1.0)))) for of in (law.energy, law.gradient, law.stiffness_about_joint)]
    [6470, 5959, -872]
    """

    stiffness: float
    free_length: float
    L: float
    ax: float
    ay: float

    def __post_init__(self) -> None:
        """Check the geometry.

        :raises ModelError: no such compensator can be built.
        """
        if not (self.L > 0 and np.hypot(self.ax, self.ay) > self.L and self.free_length >= 0 and self.stiffness >= 0):
            raise ModelError(
                "compensator geometry is impossible",
                text=str(self),
                advice="L must be positive and shorter than |P0P2|; stiffness and free length must not be negative.",
            )

    def _crank(self, q2: Array) -> _Crank:
        """Return the crank at angles q2 (n,) of joint 2 [rad]."""
        area = float(np.hypot(self.ax, self.ay)) * self.L
        angle = np.arctan2(self.ay, self.ax) - q2
        sine, cosine = sine_and_cosine(angle)
        return _Crank(area, sine, cosine, np.sqrt(self.ax**2 + self.ay**2 + self.L**2 + 2.0 * area * cosine))

    def length(self, q2: Array) -> Array:
        """Return s = |P0P1| [m], Eq. (3)."""
        return self._crank(q2).length

    def energy(self, q2: Array) -> Array:
        """Return the spring energy U_c = ½·K_c·(s − s₀)² [J]."""
        return 0.5 * self.stiffness * (self.length(q2) - self.free_length) ** 2

    def gradient(self, q2: Array) -> Array:
        """Return U_c′ [N·m]; the spring's torque about joint 2 is −U_c′."""
        area, sin, _, s = self._crank(q2)
        return self.stiffness * area * (1.0 - self.free_length / s) * sin

    def stiffness_about_joint(self, q2: Array) -> Array:
        """Return U_c″ [N·m/rad]: the term added to K⁰_θ2 in Eq. (4)."""
        area, sin, cos, s = self._crank(q2)
        return self.stiffness * area * (self.free_length / s * (area / s**2 * sin**2 + cos) - cos)

    def gradient_columns(self, q2: Array) -> Array:
        """Return U_c′ (…, 2) per unit of K_c and of K_c·s₀, in both of which it is linear."""
        area, sin, _, s = self._crank(q2)
        return np.stack([area * sin, -area / s * sin], axis=-1)

    def stiffness_columns(self, q2: Array) -> Array:
        """Return U_c″ (…, 2) per unit of K_c and of K_c·s₀: columns of the first Eq. (10), without that of ones."""
        area, sin, cos, s = self._crank(q2)
        return np.stack([-area * cos, area / s * (area / s**2 * sin**2 + cos)], axis=-1)

    def with_spring(self, stiffness: float, preload: float) -> Compensator:
        """Return the law with K_c [N/m] and K_c·s₀ [N], unchecked: a fit may pass through unphysical values."""
        compensator = Compensator(0.0, 0.0, self.L, self.ax, self.ay)
        divisor = stiffness if abs(stiffness) > _NO_SPRING else _NO_SPRING
        force_setattr(compensator, "stiffness", divisor)
        force_setattr(compensator, "free_length", preload / divisor)
        return compensator
