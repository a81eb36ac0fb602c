"""Operations and tools."""

from postproc.frames import MM_PER_M
from postproc.report.deviation.content import Deviation
from postproc.report.digits import estimate, rounded
from postproc.report.kit import Row, Section, Table


def section(told: Deviation) -> Section | None:
    """Return a table of the operations."""
    if not told.operations:
        return None
    rows = []
    for number, operation in enumerate(told.operations, 1):
        u95 = None if operation.bound is None else operation.bound.largest * MM_PER_M
        cells = [
            operation.name or f"operation {number}",
            f"T{operation.tool}" if operation.tool else "-",
            str(operation.line),
            str(operation.cutting),
            f"{operation.force:.0f}",
            estimate(operation.before.largest * MM_PER_M, u95),
        ]
        if told.compared:
            cells.append(estimate(operation.after.largest * MM_PER_M, u95))
        if u95 is not None:
            cells.append(rounded(u95))
        rows.append(Row(tuple(cells), told.places.of(operation.first), operation.line))
    head = [
        "Operation",
        "Tool",
        "First line",
        "Cutting targets",
        "Force, N",
        "Before, mm" if told.compared else "Predicted, mm",
    ]
    head += ["After, mm"] if told.compared else []
    head += ["On the part (95 %), mm"] if told.result.bound is not None else []
    table = Table(
        tuple(head),
        tuple(rows),
        "Operations and tools, largest values",
        texts=(1,),
        sortable=True,
        note="Largest values.",
    )
    return Section("operations", "Operations and tools", (table,))
