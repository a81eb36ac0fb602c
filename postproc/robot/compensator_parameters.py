"""Parameters of the compensator's spring, Eq. (3), (4): its stiffness and its preload."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Self

from postproc.compensator import Compensator
from postproc.frames import MM_PER_M, Array
from postproc.robot.model_file import ModelFile
from postproc.robot.parameter import CompensatorTorque, Parameter

if TYPE_CHECKING:
    from postproc.robot.model import RobotModel


class CompensatorStiffness(CompensatorTorque, frozen=True):
    """K_c of the compensator's spring [N/m], at a preload K_c·s₀ that does not change with it."""

    per_si: ClassVar[float] = 1.0

    @property
    def name(self) -> str:
        """Return ``K_c``."""
        return "K_c"

    @property
    def unit(self) -> str:
        """Unit in files."""
        return "N/m"

    @classmethod
    def stated(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield K_c of [compensator]."""
        if content.compensator is not None:
            yield cls(), content.compensator.stiffness_N_per_m

    def write(self, tables: dict[str, Any], value: float, half: float, source: str) -> None:
        """Write into [compensator]."""
        tables["compensator"] |= {"stiffness_N_per_m": max(value, 0.0), "source": source, "assumed": False}

    def of(self, robot: RobotModel) -> float:
        """Return K_c; zero without compensator."""
        return 0.0 if robot.compensator is None else robot.compensator.stiffness

    def partners(self) -> tuple[Parameter, ...]:
        """Return the preload: in files K_c stands beside s₀."""
        return (CompensatorPreload(),)

    def effect(self, law: Compensator, q2: Array) -> tuple[Array, Array]:
        """Return U_c′ and U_c″ of a spring of 1 N/m without free length."""
        return law.gradient_columns(q2)[..., 0], law.stiffness_columns(q2)[..., 0]


class CompensatorPreload(CompensatorTorque, frozen=True):
    """K_c·s₀ of the compensator's spring [N]; in files the free length s₀: ``s_0`` [mm]."""

    per_si: ClassVar[float] = MM_PER_M

    @property
    def name(self) -> str:
        """Return ``s_0``."""
        return "s_0"

    @property
    def unit(self) -> str:
        """Unit in files."""
        return "mm"

    @property
    def symbol(self) -> str:
        """Return what is fitted."""
        return "K_c*s_0"

    @classmethod
    def stated(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield K_c·s₀ of [compensator]."""
        if (entry := content.compensator) is not None:
            yield cls(), entry.stiffness_N_per_m * entry.free_length_mm / MM_PER_M

    def write(self, tables: dict[str, Any], value: float, half: float, source: str) -> None:
        """Write into [compensator]."""
        tables["compensator"]["free_length_mm"] = max(value, 0.0)

    def of(self, robot: RobotModel) -> float:
        """Return K_c·s₀; zero without compensator."""
        return 0.0 if robot.compensator is None else robot.compensator.stiffness * robot.compensator.free_length

    def partners(self) -> tuple[Parameter, ...]:
        """Return the stiffness, by which files divide."""
        return (CompensatorStiffness(),)

    def in_file(self, given: Mapping[Parameter, float]) -> tuple[float, dict[Parameter, float]]:
        """Return s₀ [mm]; zero where there is no spring to have one."""
        stiffness, preload = given[CompensatorStiffness()], given[self]
        if stiffness <= 0.0:
            return 0.0, {}
        slopes: dict[Parameter, float] = {
            self: MM_PER_M / stiffness,
            CompensatorStiffness(): -MM_PER_M * preload / stiffness**2,
        }
        return MM_PER_M * preload / stiffness, slopes

    def effect(self, law: Compensator, q2: Array) -> tuple[Array, Array]:
        """Return what U_c′ and U_c″ gain with each newton of preload."""
        return law.gradient_columns(q2)[..., 1], law.stiffness_columns(q2)[..., 1]
