"""Content of `model.toml`: the values of a robot beyond its URDF, each with its source.

Structures only; `robot` turns them into a `RobotModel`. Units of the file: µrad/(N·m), µm/N, mm, deg, N·m.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import numpy as np

from postproc.compensator import Compensator
from postproc.frames import M_PER_MM, Array

JOINTS = ("A1", "A2", "A3", "A4", "A5", "A6")
BASE = "base"
FLANGE = "flange"

Positive = Annotated[float, msgspec.Meta(ge=1e-12, le=1e12)]
NotNegative = Annotated[float, msgspec.Meta(ge=0, le=1e12)]
Amplitude = Annotated[float, msgspec.Meta(ge=-1e4, le=1e4)]
Finite = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
Turns = Annotated[int, msgspec.Meta(ge=-9, le=9)]
Covariant = Annotated[float, msgspec.Meta(ge=-1e24, le=1e24)]
"""A product of two values of the file: that of K_c [N/m] by itself is some 1e10."""
"""Values beyond these are mistakes, whatever the unit."""


class SourcedEntry(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """An entry that says where its values come from."""

    source: str
    assumed: bool = False


class Stiffening(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Part of a joint's compliance that fades as the torque grows beyond `torque_Nm` (`parameters.FadingPart`)."""

    torque_Nm: Positive
    compliance_urad_per_Nm: Positive


class BacklashEntry(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Backlash or lost motion of a gear (`parameters.Backlash`, `parameters.LostMotion`).

    `angle_urad`: half the angle between its flanks; around `torque_Nm` it changes its flank.
    """

    angle_urad: Positive
    torque_Nm: Positive


class PoseWaveEntry(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Wave of a joint's compliance over the joint angles: `turns` of A1 … A6 in its angle (`parameters.PoseWave`)."""

    turns: tuple[Turns, Turns, Turns, Turns, Turns, Turns]
    cos_urad_per_Nm: Finite | None = None
    sin_urad_per_Nm: Finite | None = None


class JointSpring(SourcedEntry, frozen=True, kw_only=True):
    """Compliance of one virtual joint spring, at small torque, the spring of its link about the same axis included.

    `stiffening` says which parts of it fade with load, `knees` which end beyond a torque (`parameters.Knee`).
    `over_pose`: waves over the joint angles in addition to it. `coupling`: joint → deflection of this joint by a torque
    on that one, and of that one by a torque on this [µrad/(N·m)] (`parameters.GearCoupling`).
    `sigma_percent`: standard deviation of the whole compliance where readings on this robot give none. `scaled_from`:
    the robot whose compliance it is, scaled.
    """

    compliance_urad_per_Nm: Positive
    sigma_percent: Positive | None = None
    scaled_from: str = ""
    ci95: NotNegative | None = None
    stiffening: list[Stiffening] = []
    knees: list[Stiffening] = []
    backlash: BacklashEntry | None = None
    lost_motion: BacklashEntry | None = None
    over_pose: list[PoseWaveEntry] = []
    coupling: dict[str, Finite] = {}

    @property
    def fading_compliance(self) -> float:
        """Part of the compliance at small torque that fades at larger torques [µrad/(N·m)]."""
        return sum(part.compliance_urad_per_Nm for part in (*self.stiffening, *self.knees))


class LinkSprings(SourcedEntry, frozen=True, kw_only=True):
    """Springs of one link: translations and rotations where it begins (at its joint), rotations where it ends.

    Axes of the joint frame (those of the root at A1…A6 = 0 for the shipped robots). The link named A2 is the one that
    joint A2 carries; `base` is between the foundation and A1. A translation counts once: it is the same at both ends.
    """

    X_um_per_N: NotNegative = 0.0
    Y_um_per_N: NotNegative = 0.0
    Z_um_per_N: NotNegative = 0.0
    RX_urad_per_Nm: NotNegative = 0.0
    RY_urad_per_Nm: NotNegative = 0.0
    RZ_urad_per_Nm: NotNegative = 0.0
    end_RX_urad_per_Nm: NotNegative = 0.0
    end_RY_urad_per_Nm: NotNegative = 0.0
    end_RZ_urad_per_Nm: NotNegative = 0.0


class CompensatorEntry(SourcedEntry, frozen=True, kw_only=True):
    """Gravity compensator at joint A2, paper Eq. (3)–(4).

    `sigma_percent`: standard deviation of K_c at this free length, where readings on this robot give none; it goes
    into the bound. `spread_percent`: standard deviation of the size of its torque, about which a fit looks for K_c.
    """

    L_mm: Positive
    a_x_mm: Finite
    a_y_mm: Finite
    stiffness_N_per_m: NotNegative
    free_length_mm: NotNegative
    sigma_percent: Positive | None = None
    geometry_source: str = ""
    spread_percent: NotNegative = 15.0

    def law(self) -> Compensator:
        """Return the law of the compensator in SI units."""
        return Compensator(
            stiffness=self.stiffness_N_per_m,
            free_length=self.free_length_mm * M_PER_MM,
            L=self.L_mm * M_PER_MM,
            ax=self.a_x_mm * M_PER_MM,
            ay=self.a_y_mm * M_PER_MM,
        )


class Masses(SourcedEntry, frozen=True, kw_only=True):
    """Source of the link masses in robot.urdf, and identified masses that replace them.

    `spread_percent`: standard deviation of each mass.
    """

    spread_percent: NotNegative = 15.0
    A1_kg: NotNegative | None = None
    A2_kg: NotNegative | None = None
    A3_kg: NotNegative | None = None
    A4_kg: NotNegative | None = None
    A5_kg: NotNegative | None = None
    A6_kg: NotNegative | None = None


class Gravity(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """State that the geometry describes: the robot under its own weight, or a weightless robot.

    `in_gears`: stiffening gears feel the torque of the weights and of the compensator at rest too, not the load alone.
    """

    reference: Literal["calibrated", "rigid"] = "calibrated"
    in_gears: bool = False


class Displacement(SourcedEntry, frozen=True, kw_only=True):
    """Calibrated geometry: displacement of a joint (or the flange) from its nominal place on the previous link.

    X, Y, Z [mm] and a rotation vector RX, RY, RZ [deg], in the axes of the nominal joint frame.
    """

    X_mm: Finite = 0.0
    Y_mm: Finite = 0.0
    Z_mm: Finite = 0.0
    RX_deg: Finite = 0.0
    RY_deg: Finite = 0.0
    RZ_deg: Finite = 0.0


class TransmissionEntry(SourcedEntry, frozen=True, kw_only=True):
    """Error of transmission of a joint, once and twice a turn: amplitudes of sin q … cos 2q [µrad]."""

    sin_urad: Amplitude = 0.0
    cos_urad: Amplitude = 0.0
    sin2_urad: Amplitude = 0.0
    cos2_urad: Amplitude = 0.0


class PayloadEntry(SourcedEntry, frozen=True, kw_only=True):
    """Payload during the measurements; the payload of a cell is in addition to it.

    `mass_kg`, centre of mass X_mm, Y_mm, Z_mm in the flange frame.
    """

    mass_kg: Positive
    X_mm: float = 0.0
    Y_mm: float = 0.0
    Z_mm: float = 0.0


class CovarianceTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Covariance of identified parameters by name, in the units of the file (k1…k6 in µrad/(N·m)).

    `forces` is the factor of the forces that `ForcesEntry` computes, about 1. `matrix` is whole, or its lower triangle.
    """

    parameters: list[str]
    matrix: list[list[Covariant]]

    @classmethod
    def of(cls, names: list[str], matrix: Array) -> CovarianceTable:
        """Return the table with the lower triangle of a symmetric matrix (n, n)."""
        return cls(names, [row[: index + 1] for index, row in enumerate(matrix.tolist())])

    @property
    def square(self) -> Array | None:
        """The whole matrix (n, n); None if the rows are neither those of a square nor those of a lower triangle."""
        size = len(self.parameters)
        lengths = [len(row) for row in self.matrix]
        if lengths == [size] * size:
            return np.array(self.matrix).reshape(size, size)
        if lengths != list(range(1, size + 1)):
            return None
        lower = np.array([[*row, *[0.0] * (size - len(row))] for row in self.matrix])  # rows filled with zeros
        return np.asarray(lower + np.tril(lower, -1).T)


class ForcesEntry(SourcedEntry, frozen=True, kw_only=True):
    """Cutting law whose forces were identified together with the compliances: `forces` of [covariance] is their factor.

    `cutting_N_per_mm2`: Ktc, Krc, Kac; `edge_N_per_mm`: Kte, Kre, Kae; `mc` exponent of Kienzle's law, 0 if linear.
    """

    cutting_N_per_mm2: tuple[Finite, Finite, Finite]
    edge_N_per_mm: tuple[Finite, Finite, Finite]
    mc: NotNegative = 0.0
    sigma_percent: Positive


class DiscrepancyEntry(SourcedEntry, frozen=True, kw_only=True):
    """Unmodelled error on configurations the model was not fitted to, without noise: 95 % of |error| by load."""

    load_N: list[NotNegative]
    u95_mm: list[NotNegative]


class GeometryErrorEntry(SourcedEntry, frozen=True, kw_only=True):
    """Error of the calibrated geometry without load and without noise: 95 % of |error|.

    `angles_deg`: least and largest angle of each joint in the readings; beyond them the error is larger, up to
    `unmeasured_mm` by what the readings do not hold.
    """

    u95_mm: NotNegative
    angles_deg: dict[str, tuple[Finite, Finite]] = {}
    unmeasured_mm: NotNegative = 0.0


class MeasuredEntry(SourcedEntry, frozen=True, kw_only=True):
    """Range of the measurements: the largest torque on A1…A6; `not_trusted`: why the model should not be used."""

    configurations: int
    torque_Nm: tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]
    not_trusted: str = ""


class ModelFile(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Content of `model.toml`; `language`: dialect that the robot's controller reads, empty if not stated.

    `masses`, `geometry_nominal` (and joint limits) and `speeds`, of the joints, say where those in robot.urdf come
    from; speeds without an entry come from where the geometry does.
    """

    name: str
    joints: dict[str, JointSpring]
    date: str = ""
    language: str = ""
    gravity: Gravity = Gravity()
    compensator: CompensatorEntry | None = None
    payload: PayloadEntry | None = None
    geometry: dict[str, Displacement] = {}
    transmission: dict[str, TransmissionEntry] = {}
    links: dict[str, LinkSprings] = {}
    masses: Masses | None = None
    geometry_nominal: SourcedEntry | None = None
    speeds: SourcedEntry | None = None
    covariance: CovarianceTable | None = None
    forces: ForcesEntry | None = None
    discrepancy: DiscrepancyEntry | None = None
    geometry_error: GeometryErrorEntry | None = None
    measured: MeasuredEntry | None = None
