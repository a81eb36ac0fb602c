"""The numbers: what the model leaves, what is to be expected on the part, and the paper's Table 3."""

from typing import Literal

from postproc.report.deviation.content import Deviation
from postproc.report.digits import estimate, rounded
from postproc.report.kit import Note, Notes, Part, Row, Section, Table, Tile, Tiles
from postproc.report.text import percent, times

_MEASURES: tuple[tuple[str, Literal["max_mm", "rms_mm", "mean_mm", "p95_mm"]], ...] = (
    ("Maximum", "max_mm"),
    ("RMS", "rms_mm"),
    ("Mean", "mean_mm"),
    ("95th percentile", "p95_mm"),
)


def section(told: Deviation) -> Section | None:
    """Return both numbers apart, and before, after and improvement."""
    content = told.content
    if not content["targets"]:
        return None
    if told.nothing is not None:
        return Section("numbers", "Deviation of the tool tip", (Notes((Note(told.nothing, "good"),)),))
    before, after, bound = content["before"], content["after"], content["u95"]
    u95 = None if bound is None else bound["max_mm"]
    rms = estimate(before["rms_mm"], u95)
    tiles = [Tile("As programmed, largest", estimate(before["max_mm"], u95), "mm", f"RMS {rms} mm")]
    if told.compared:
        note = f"RMS {estimate(after['rms_mm'], u95)} mm; a statement about the model, not about the part"
        tiles.append(Tile("What the model leaves, largest", estimate(after["max_mm"], u95), "mm", note))
    if bound is None:
        note = "the robot model states no uncertainty: identify the robot from measurements"
        tiles.append(Tile("Expected error on the part", "unknown", "", note, "warning"))
    else:
        note = f"95 % bound, RMS {rounded(bound['rms_mm'])} mm; {bound['basis']}"
        tiles.append(Tile("Expected error on the part, up to", rounded(bound["max_mm"]), "mm", note))
    parts: list[Part] = [Tiles(tuple(tiles)), _table(told)]
    share = content["compensated_percent"]
    if content["mode"] == "convert" and share is not None:
        parts.append(Notes((Note(f"Compensated {percent(share)} of the predicted deviation (RMS)."),)))
    return Section("numbers", "Deviation of the tool tip, mm", tuple(parts))


def _table(told: Deviation) -> Table:
    content = told.content
    u95 = None if content["u95"] is None else content["u95"]["max_mm"]
    if not told.compared:
        rows = tuple(Row((label, estimate(content["before"][key], u95))) for label, key in _MEASURES)
        return Table(("Criterion", "Predicted, mm"), rows, "Predicted deviation")
    rows = tuple(
        Row((label, estimate(before, u95), estimate(after, u95), times(before, after)))
        for label, before, after in ((label, content["before"][key], content["after"][key]) for label, key in _MEASURES)
    )
    head = ("Criterion", "Before compensation, mm", "After compensation, mm", "Improvement factor")
    return Table(head, rows, "Deviation before and after compensation", note=_ROUNDING)


_ROUNDING = "At cutting targets, as the model predicts it. “To rounding”: what remains is the rounding of the text."
