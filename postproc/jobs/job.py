"""One program to work on: what it reads, and how the files are called that it writes."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from postproc.correction import Mode


@dataclass(frozen=True, slots=True)
class Job:
    """One program to work on.

    :param program: its file.
    :param dialect: ``"gcode"`` or ``"krl"``.
    :param output: folder to write into.
    :param forces: CSV file with its forces, or None.
    :param name: of the written program, and of the files beside it; None = that of the file.
    """

    program: Path
    dialect: str
    output: Path
    forces: Path | None = None
    name: str | None = None

    @property
    def stem(self) -> str:
        """Return what the written files are called, without extension."""
        return self.program.stem if self.name is None else self.name

    def reads(self) -> list[Path]:
        """Return the files that are read for this program, beside the cell."""
        data = data_beside(self.program) if self.dialect == "krl" else []
        return [self.program, *data, *([] if self.forces is None else [self.forces])]

    def report(self, mode: Mode) -> str:
        """Return the name of the report that says what was written (`report.json`)."""
        return f"{self.program.stem}.predict.report.json" if mode == "predict" else f"{self.stem}.report.json"

    def writes(self, mode: Mode) -> list[str]:
        """Return the names of the files that may be written: programs, then reports."""
        report = self.report(mode).removesuffix("report.json")
        reports = [f"{report}{kind}" for kind in ("report.json", "targets.csv", "report.html")]
        if mode == "predict":
            return reports
        if self.forces is not None:
            reports.insert(1, f"{report}forces.csv")
        if self.dialect == "krl":
            files = [self.program, *data_beside(self.program)[:1]]
            return [*(path.name if self.name is None else f"{self.name}{path.suffix}" for path in files), *reports]
        return [f"{self.stem}.src", *reports]


def data_beside(path: Path) -> list[Path]:
    """Return the `.dat` files beside a KRL program, letters of any case; the one that belongs to it first."""
    try:
        names = os.listdir(path.parent)  # noqa: PTH208 - a folder may hold thousands of programs
    except OSError:
        return []
    wanted = f"{path.stem}.dat".lower()
    found = [path.with_name(name) for name in names if name.lower() == wanted]
    return sorted(found, key=lambda other: (other.stem != path.stem, other.name))
