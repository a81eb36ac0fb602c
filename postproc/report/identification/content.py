"""The content of `identification.json`, typed; keys that the page does not show are left out."""

from __future__ import annotations

from msgspec import Struct


class Parameter(Struct, frozen=True):
    """A value with the half width of its 95 % interval; None where it is the prior one."""

    value: float | None
    ci95: float | None
    unit: str
    observable: bool = True
    prior: float | None = None

    @property
    def share(self) -> float | None:
        """Half width as a share of the value, or None."""
        return None if self.ci95 is None or not self.value else abs(self.ci95 / self.value)


class Level(Struct, frozen=True):
    """Compliance of joint 2 at a level of q2."""

    q2_deg: float
    value: float
    ci95: float | None


class OfConfiguration(Struct, frozen=True):
    """RMS over the points of a configuration."""

    config: float
    before_mm: float
    after_mm: float


class Residual(Struct, frozen=True):
    """What the model leaves of the readings."""

    rms_mm: float
    before_rms_mm: float
    per_configuration: list[OfConfiguration]


class Missing(Struct, frozen=True):
    """A parameter that the readings do not show."""

    name: str
    reason: str
    advice: str


class Tried(Struct, frozen=True):
    """A structure that was tried."""

    structure: str
    active: int
    held_out_sigma2: float
    chosen: bool


class Structure(Struct, frozen=True):
    """The structures tried and why one was taken."""

    reason: str
    tried: list[Tried]


class Correlation(Struct, frozen=True):
    """Correlations of the parameters found."""

    names: list[str]
    matrix: list[list[float]]


class Variant(Struct, frozen=True):
    """A variant of the geometry."""

    rms_mm: float
    held_out_rms_mm: float


class Geometry(Struct, frozen=True):
    """The calibrated geometry."""

    variants: dict[str, Variant]
    chosen: str
    parameters: dict[str, Parameter]


class Identified(Struct, frozen=True):
    """Content of `identification.json`; without loads there is only geometry."""

    method: str
    robot: str
    sigma_mm: float
    base: dict[str, float]
    points: dict[str, dict[str, float]]
    unloaded_rms_mm: float
    warnings: list[str] = []
    parameters: dict[str, Parameter] = {}
    k2_levels: list[Level] = []
    k2_curve: list[tuple[float, float]] = []
    residual: Residual | None = None
    not_observable: list[Missing] = []
    structure: Structure | None = None
    correlation: Correlation | None = None
    geometry: Geometry | None = None
