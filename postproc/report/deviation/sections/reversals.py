"""Where joints change the direction of their torque on cutting moves."""

from postproc.report.deviation.content import Deviation
from postproc.report.digits import rounded
from postproc.report.kit import Note, Notes, Row, Section, Table


def section(told: Deviation) -> Section | None:
    """Return a table of the largest reversals; only a note where the model states no lost motion."""
    found = told.content["reversals"]
    if not found:
        return None
    if not any(entry["lost_motion_mm"] for entry in found):
        joints = ", ".join(sorted({entry["joint"] for entry in found}))
        text = (
            f"The torque of {joints} changes its direction while the tool cuts. The tool steps there by the lost "
            "motion of these gears. The robot model states none; plots along the path mark the places."
        )
        return Section("reversals", "Reversals", (Notes((Note(text),)),))
    rows = tuple(
        Row((entry["joint"], str(entry["source_line"]), rounded(entry["lost_motion_mm"])), place, entry["source_line"])
        for entry, (place, _) in zip(found, told.reversals(), strict=True)
    )
    note = (
        "The step is corrected as the model has it; where exactly the gear turns over is not known and counts in u95."
    )
    table = Table(
        ("Joint", "Source line", "Step of the tool, mm"), rows, "Largest steps by lost motion", sortable=True, note=note
    )
    return Section("reversals", "Reversals", (table,))
