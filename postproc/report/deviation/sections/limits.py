"""Tolerance and limits."""

from postproc.report.deviation.content import Deviation
from postproc.report.digits import millimetres
from postproc.report.kit import Cell, Facts, Section
from postproc.report.text import number

_HELD = {None: ("held but for approximation", "warning"), True: ("held", "good"), False: ("exceeded", "error")}


def section(told: Deviation) -> Section | None:
    """Return what the path keeps to, and by how much."""
    content = told.content
    if not content["targets"]:
        return None
    between = content["between_max_mm"]
    rows: list[tuple[str, Cell | str]] = [
        ("Deviation between targets too, at most", f"{'-' if between is None else millimetres(between)} mm")
    ]
    if content["tolerance_mm"] is not None:
        text, kind = _HELD[content["tolerance_held"]]
        rows.append(("Tolerance", Cell(f"{content['tolerance_mm']:g} mm: {text}", kind)))  # type: ignore[arg-type]
    blending = content["blending"]
    if blending["source_line"] is not None:
        told_at = f"{number(blending['max_mm'], 3)} mm, line {blending['source_line']}"
        rows.append((f"{blending['by'][:1].upper()}{blending['by'][1:]} rounds corners by up to", told_at))
    if content["mode"] == "convert":
        rows.append(("Largest correction", f"{number(content['max_correction_mm'], 3)} mm"))
    if content["tool_deflection"] is not None:
        share = f"{number(content['tool_deflection']['max_mm'], 3)} mm"
        rows.append(("Holder, spindle and tool give way by up to", share))
    rows.append(("Largest force", f"{content['max_force_N']:.0f} N"))
    limits = content["limits"]
    rows.append(("Smallest joint margin", f"{number(limits['min_joint_margin_deg'], 1)}°"))
    rows.append(("Smallest singular value of the Jacobian", f"{number(limits['min_singular_value'], 3)} m/rad"))
    return Section("limits", "Tolerance and limits", (Facts(tuple(rows)),), "half")
