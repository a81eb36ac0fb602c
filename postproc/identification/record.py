"""The content of `identification.json`, typed. Fields that are None, but for values and intervals, are left out."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from postproc import files
from postproc.errors import MeasurementError
from postproc.files import FileEntry
from postproc.frames import RAD_PER_DEG, Array

NAME = "identification.json"
ABOUT_THE_PRIOR = "about the prior"
"""Source of values that were fitted with the prior's value as their mean."""


class Record(Struct, frozen=True):
    """Content of an `identification.json`."""

    def as_json(self) -> bytes:
        """Return the content of the file."""
        return msgspec.json.format(msgspec.json.encode(self), indent=2)


RESERVATION = ", with a reservation: "
"""Begins the reservation in the line of a verdict."""


class Verdict(Struct, frozen=True):
    """Whether the model may be used, and in one line why not."""

    refused: bool
    line: str


class Parameter(Struct, frozen=True, omit_defaults=True):
    """A value with the half width of its 95 % interval, which is None for a value of the prior.

    `determined`: whether the half width is at most the value. `source`: "prior" for a value of the prior,
    `ABOUT_THE_PRIOR` for a value that was fitted about the prior's, None for other identified values.
    """

    value: float | None
    ci95: float | None
    unit: str
    observable: bool
    determined: bool | None = None
    prior: float | None = None
    source: str | None = None

    @property
    def share(self) -> float | None:
        """Half width of the interval over the value; None without an interval, or with a value of zero or None."""
        return None if self.ci95 is None or not self.value else abs(self.ci95 / self.value)


class Level(Struct, frozen=True):
    """Compliance of joint 2 at a level of q2."""

    q2_deg: float
    value: float
    ci95: float | None


class FromLevels(Struct, frozen=True):
    """A value of the compensator's spring by Eq. (9), (10)."""

    value: float
    ci95: float


class OfConfiguration(Struct, frozen=True):
    """RMS over the points of a configuration."""

    config: float
    before_mm: float
    after_mm: float


class Residual(Struct, frozen=True):
    """Residuals of the model."""

    rms_mm: float
    max_mm: float
    before_rms_mm: float
    chi2: float
    degrees_of_freedom: int
    per_configuration: list[OfConfiguration]


class CrossValidation(Struct, frozen=True):
    """Cross-validation errors at a level of loads: RMS distances, and a bound of 95 % on the unmodelled error."""

    load_N: float
    held_out_mm: float
    noise_mm: float
    own_mm: float
    u95_mm: float

    @property
    def line(self) -> str:
        """Return the cross-validation error at this load, as a sentence."""
        return (
            f"cross-validation error at {self.load_N:.0f} N: {self.held_out_mm:.3f} mm RMS of the mean of the points; "
            f"measurement noise {self.noise_mm:.3f}, parameter uncertainty {self.own_mm:.3f}, unmodelled error below "
            f"{self.u95_mm:.3f} mm (95 %)"
        )


class InWorkspace(Struct, frozen=True):
    """Median deflection and bound in the workspace at a load, and the 95 % quantile of bound over deflection.

    `chance`: that correction makes a place better, which 95 % of the poses are above.
    """

    load_N: float
    deflection_mm: float
    bound_mm: float
    worst_share: float
    chance: float


class MissingParameter(Struct, frozen=True):
    """A parameter that the readings do not determine."""

    name: str
    reason: str
    advice: str


class TriedStructure(Struct, frozen=True):
    """A structure that was tried."""

    structure: str
    parameters: int
    active: int
    rms_sigma: float
    held_out_sigma2: float
    standard_error: float
    weight: float
    chosen: bool


class Structure(Struct, frozen=True):
    """The structures tried and why one was taken."""

    reason: str
    tried: list[TriedStructure]


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

    parameters: dict[str, Parameter]
    sag: bool
    chosen: str
    variants: dict[str, Variant]
    u95_mm: float


class State(Struct, frozen=True):
    """A configuration and a load of it that the model was identified from: degrees; N and N·m at the load point."""

    joints_deg: tuple[float, float, float, float, float, float]
    load: tuple[float, float, float, float, float, float]


class TorqueRange(Struct, frozen=True):
    """Torques that the loads put on a joint: the largest of each sign (0: none), and how many configurations had it."""

    joint: str
    negative_Nm: float
    positive_Nm: float
    negative_configurations: int
    positive_configurations: int


class IdentificationRecord(Record, frozen=True, omit_defaults=True, kw_only=True):
    """Content of `identification.json`; without loads there is only geometry."""

    verdict: Verdict | None = None
    method: str
    robot: str
    parameters: dict[str, Parameter] | None = None
    k2_levels: list[Level] | None = None
    k2_curve: list[tuple[float, float]] | None = None
    from_levels: dict[str, FromLevels] | None = None
    residual: Residual | None = None
    discrepancy: list[CrossValidation] | None = None
    return_u95_mm: float | None = None
    workspace: list[InWorkspace] | None = None
    workspace_line: str | None = None
    structure: Structure | None = None
    geometry: Geometry | None = None
    sigma_mm: float
    base: dict[str, float]
    points: dict[str, dict[str, float]]
    unloaded_rms_mm: float
    not_observable: list[MissingParameter] | None = None
    held_by_prior: list[str] | None = None
    outliers: list[str]
    warnings: list[str]
    assumptions: list[str] | None = None
    correlation: Correlation | None = None
    states: list[State] | None = None
    torque_Nm: list[float] | None = None
    torques: list[TorqueRange] | None = None
    files: list[FileEntry] | None = None

    @property
    def error_lines(self) -> list[str]:
        """The cross-validation error at each load, and how well the unloaded tool returns, as sentences."""
        lines = [level.line for level in self.discrepancy or ()]
        if self.return_u95_mm is not None:
            lines.append(
                f"from repeat to repeat the unloaded tool comes back to within {self.return_u95_mm:.3f} mm (95 %): the "
                "unmodelled error is at least that"
            )
        return lines


class MeasuredStates(Struct, frozen=True):
    """States and torques that a model was identified with; empty if the folder does not record them."""

    states: list[State] = []
    torques: list[TorqueRange] = []

    def as_array(self) -> Array:
        """Return the m states as rows (m, 12): six joint angles [rad], then the load [N, N·m]."""
        rows = [(*np.multiply(state.joints_deg, RAD_PER_DEG), *state.load) for state in self.states]
        return np.array(rows).reshape(-1, 12)  # (0, 12) without states


def measured_states(folder: Path) -> MeasuredStates:
    """Return states and torques that the model of a folder was identified with; empty without `identification.json`.

    :raises MeasurementError: the file is damaged.
    """
    path = folder / NAME
    if not path.is_file():
        return MeasuredStates()
    try:
        return msgspec.json.decode(files.read_text(path, MeasurementError).encode(), type=MeasuredStates)
    except msgspec.MsgspecError as error:
        raise MeasurementError(
            str(error), file=str(path), advice="Identify the model anew, or restore the file."
        ) from None
