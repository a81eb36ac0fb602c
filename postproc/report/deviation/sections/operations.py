"""Operations and tools."""

from postproc.frames import MM_PER_M
from postproc.report.deviation.content import Deviation
from postproc.report.kit import Row, Section, Table
from postproc.report.text import millimetres, rounded


def section(told: Deviation) -> Section | None:
    """Return a table of the operations."""
    if not told.operations:
        return None
    rows = []
    for number, operation in enumerate(told.operations, 1):
        cells = [
            operation.name or f"operation {number}",
            f"T{operation.tool}" if operation.tool else "-",
            str(operation.line),
            str(operation.cutting),
            f"{operation.force:.0f}",
            millimetres(operation.before.largest * MM_PER_M),
        ]
        if told.compared:
            cells.append(millimetres(operation.after.largest * MM_PER_M))
        if operation.bound is not None:
            cells.append(rounded(operation.bound.largest * MM_PER_M))
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
