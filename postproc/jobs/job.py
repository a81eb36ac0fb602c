"""One program to work on: what it reads, and how the files are called that it writes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from msgspec import Struct

from postproc.correction import Mode
from postproc.dialects import Writer, registry

_PROCESS = ".toml"
"""The extension by which a process is told from other files of forces."""


class Job(Struct, frozen=True):
    """One program to work on.

    :param program: its file.
    :param dialect: name of the format to read it in.
    :param output: folder to write into.
    :param forces: CSV file with its forces, or process.toml from which they are computed, or None.
    :param name: of the written program, and of the files beside it; None = that of the file.
    :param to: name of the format to write it in; None = its own if that is written, else KRL.
    :param named: whether the user named the file, and not only its folder or a pattern.
    :param callers: programs of the same run that call it, which is then corrected with them and not by itself.
    :param others: what the programs are called that are written into the same folder in the same run, lower case.
    :param earlier: reports of programs of this run that stood in that folder before it, and when each was written [ns].
    """

    program: Path
    dialect: str
    output: Path
    forces: Path | None = None
    name: str | None = None
    to: str | None = None
    named: bool = True
    callers: tuple[Path, ...] = ()
    others: frozenset[str] = frozenset()
    earlier: Mapping[str, int] = {}

    @property
    def keeps_text(self) -> bool:
        """Whether the program is written as it was but for its numbers, see `Program.keeps_text`."""
        return registry.written_in(self.dialect, self.to)[0] == self.dialect

    @property
    def stem(self) -> str:
        """Return what the written files are called, without extension."""
        return self.program.stem if self.name is None else self.name

    @property
    def process(self) -> Path | None:
        """The process.toml from which its forces are computed."""
        return self.forces if self.forces is not None and self.forces.suffix.lower() == _PROCESS else None

    def reads(self) -> list[Path]:
        """Return the files that are read for this program, beside the cell."""
        beside = registry.by_name(self.dialect).companions(self.program)
        return [self.program, *beside, *([] if self.forces is None else [self.forces])]

    def report(self, mode: Mode) -> str:
        """Return the name of the report that says what was written (`report.json`)."""
        return f"{self.program.stem}.predict.report.json" if mode == "predict" else f"{self.stem}.report.json"

    def writes(self, mode: Mode) -> list[str]:
        """Return the names of the files that may be written: programs, then reports."""
        report = self.report(mode).removesuffix("report.json")
        reports = [f"{report}{kind}" for kind in ("report.json", "targets.csv", "report.html")]
        if self.process is not None:
            reports.append(f"{report}stock.glb")
        if mode == "predict":
            return reports
        if self.forces is not None:
            reports.insert(1, f"{report}forces.csv")
        if self.keeps_text:
            files = [self.program, *registry.by_name(self.dialect).companions(self.program)]
            if self.name is not None:
                files = [path.with_stem(self.name) for path in files if path.stem.lower() == self.program.stem.lower()]
            return [*(path.name for path in files), *reports]
        return [f"{self.stem}{self.writer.extension}", *reports]

    def mains(self, mode: Mode) -> list[str]:
        """Return the names that the main file may have, the likelier first."""
        first = Path(self.writes(mode)[0])
        return [first.name, *([f"{first.stem}Main{first.suffix}"] if mode != "predict" else [])]

    @property
    def writer(self) -> Writer:
        """What writes the program."""
        return registry.written_in(self.dialect, self.to)[1]
