"""Where each value of a robot model comes from, for the command `robots`."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import Struct

from postproc.frames import DEG_PER_RAD
from postproc.robot.chain import Chain
from postproc.robot.model_file import JOINTS, ModelFile, Sourced
from postproc.robot.rest_parameters import LinkMass
from postproc.robot.spring_parameters import LinkSpring

WITH_LINKS = "k1 … k6, of A1 … A6, contain the spring of the link about the same axis"
"""To be said wherever their values are told: readings do not tell the two apart."""


class SourcedValue(Struct, frozen=True):
    """One value of a model and where it comes from."""

    name: str
    value: str
    source: str
    assumed: bool


def sourced_values(content: ModelFile, nominal: Chain) -> Iterator[SourcedValue]:
    """Yield the values of a model file and of its URDF with their sources."""
    for name in JOINTS:
        spring = content.joints[name]
        interval = "" if spring.ci95 is None else f" ± {spring.ci95:.3g}"
        value = f"{spring.compliance_urad_per_Nm:g}{interval} µrad/(N·m){_sigma(spring.sigma_percent)}"
        if spring.fades:
            value += f", of which {spring.fades:.3g} fade with load"
        if spring.backlash is not None:
            value += f"; backlash {spring.backlash.angle_urad:.3g} µrad"
        if spring.lost_motion is not None:
            value += f"; lost motion {spring.lost_motion.angle_urad:.3g} µrad"
        yield SourcedValue(f"compliance {name}", value, spring.source, spring.assumed)
    if (spring_law := content.compensator) is not None:
        value = f"L {spring_law.L_mm:g}, a_x {spring_law.a_x_mm:g}, a_y {spring_law.a_y_mm:g} mm"
        geometry_source = spring_law.geometry_source or spring_law.source
        assumed = spring_law.assumed and not spring_law.geometry_source
        yield SourcedValue("compensator geometry", value, geometry_source, assumed)
        stiffness = f"K_c {spring_law.stiffness_N_per_m:g} N/m{_sigma(spring_law.sigma_percent)}"
        value = f"{stiffness}, s_0 {spring_law.free_length_mm:g} mm"
        yield SourcedValue("compensator spring", value, spring_law.source, spring_law.assumed)
    if (carried := content.payload) is not None:
        value = f"{carried.mass_kg:g} kg at {carried.X_mm:g}, {carried.Y_mm:g}, {carried.Z_mm:g} mm of the flange"
        yield SourcedValue("payload when measured", value, carried.source, carried.assumed)
    for name, springs in content.links.items():
        count = sum(spring.link == name for spring, _ in LinkSpring.stated(content))
        yield SourcedValue(f"springs of link {name}", f"{count} directions", springs.source, springs.assumed)
    for name, entry in content.geometry.items():
        value = (
            f"{entry.X_mm:g}, {entry.Y_mm:g}, {entry.Z_mm:g} mm; {entry.RX_deg:g}, {entry.RY_deg:g}, {entry.RZ_deg:g}°"
        )
        yield SourcedValue(f"calibrated {name}", value, entry.source, entry.assumed)
    for name, gear in content.transmission.items():
        once, twice = (f"{gear.sin_urad:.3g}, {gear.cos_urad:.3g}", f"{gear.sin2_urad:.3g}, {gear.cos2_urad:.3g}")
        value = f"{once} µrad once a turn (sin, cos), {twice} µrad twice"
        yield SourcedValue(f"transmission {name}", value, gear.source, gear.assumed)
    if (off := content.discrepancy) is not None:
        pairs = zip(off.u95_mm, off.load_N, strict=False)
        value = ", ".join(f"{u95:.2g} mm at {load:.0f} N" for u95, load in pairs)
        yield SourcedValue("discrepancy (95 %)", value, off.source, off.assumed)
    if (apart := content.geometry_error) is not None:
        yield SourcedValue("error of the geometry (95 %)", f"{apart.u95_mm:.2g} mm", apart.source, apart.assumed)
    if (covered := content.measured) is not None:
        torques = ", ".join(f"{torque:.0f}" for torque in covered.torque_Nm)
        value = f"{covered.configurations} configurations, up to {torques} N·m on A1 … A6"
        yield SourcedValue("measured", value, covered.source, covered.assumed)
    instead = dict(LinkMass.stated(content))
    masses = ", ".join(
        f"{instead.get(LinkMass(name), mass):.4g}" for name, mass in zip(JOINTS, nominal.mass, strict=True)
    )
    speeds = ", ".join(f"{speed:.4g}" for speed in nominal.speed * DEG_PER_RAD)
    for label, value, entry_source in (
        ("link masses", f"{masses} kg", content.masses),
        ("geometry, limits", "robot.urdf", content.geometry_nominal),
        ("joint speeds", f"{speeds} °/s", content.speeds or content.geometry_nominal),
    ):
        source = entry_source or Sourced(source="not stated", assumed=True)
        yield SourcedValue(label, value, source.source, source.assumed)
    yield SourcedValue("gravity reference", content.gravity.reference, "model.toml", assumed=False)


def _sigma(percent: float | None) -> str:
    return "" if percent is None else f" (σ {percent:g} %)"
