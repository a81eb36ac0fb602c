"""process.toml: material, tools and stock of a program, or forces by operation."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from postproc import files
from postproc.cell import Box, Frame, Positive
from postproc.errors import ForceError
from postproc.frames import M_PER_MM, Array
from postproc.machining.material import CuttingLaw, MaterialTable, law
from postproc.machining.tool import Cutter
from postproc.program import ForceFrame

DEFAULT = "default"
"""Key in [tools] of the entry for all tools without one of their own."""
_NAME = re.compile(r"[^\W\d]\w*")
"""Name of data in RAPID."""
CELL_MM = 0.25
"""Cell of the map by default (assumed): `tests.benchmarks.fronts` prints the errors of forces."""
Newton = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]


class ToolTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A cutter.

    :param helix_deg: a tool table may state it; mean forces over a turn do not depend on it.
    :param rpm: spindle speed if the program does not give it (KRL) [1/min].
    :param spindle: with `rpm`: direction of rotation.
    """

    diameter_mm: Positive
    flutes: Annotated[int, msgspec.Meta(ge=1, le=100)]
    shape: Literal["flat", "ball", "bull", "drill"] = "flat"
    corner_radius_mm: Annotated[float, msgspec.Meta(ge=0, le=1e6)] = 0.0
    helix_deg: Annotated[float, msgspec.Meta(ge=0, lt=80)] = 30.0
    rpm: Positive | None = None
    spindle: Literal["M3", "M4"] = "M3"


class SpindleTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """The spindle.

    :param power_kW: that it can give continuously; None: not stated.
    """

    power_kW: Positive | None = None


class StockTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """The stock before the program: a box, or a closed mesh in mm, which `place` puts into `$BASE`.

    :param resolution_mm: cell of the map; None: `CELL_MM`, and finer where contacts need it.
    :param assumed: nobody has stated it: it is taken from what the tools sweep, and results say so.
    """

    box: Box | None = None
    file: str | None = None
    place: Frame = Frame()
    resolution_mm: Positive | None = None
    assumed: bool = False

    @property
    def cell(self) -> float:
        """Cell of the map of the stock [m]."""
        return (CELL_MM if self.resolution_mm is None else self.resolution_mm) * M_PER_MM


class OperationTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """The force of an operation or tool; N, N·m."""

    Fx: Newton = 0.0
    Fy: Newton = 0.0
    Fz: Newton = 0.0
    Mx: Newton = 0.0
    My: Newton = 0.0
    Mz: Newton = 0.0
    frame: ForceFrame = "FEED"
    sigma_percent: Annotated[float, msgspec.Meta(ge=0, le=200)] = 0.0


class ProcessFile(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Content of a process.toml."""

    material: MaterialTable | None = None
    tools: dict[str, ToolTable] = {}
    stock: StockTable = StockTable()
    spindle: SpindleTable = SpindleTable()
    operations: dict[str, OperationTable] = {}


class Process(ProcessFile, frozen=True):
    """A process; `path` is the path of its file."""

    path: str = "process.toml"

    @property
    def largest_radius(self) -> float:
        """Radius of the widest tool [m]."""
        return 0.5 * max(table.diameter_mm for table in self.tools.values()) * M_PER_MM

    def law(self) -> CuttingLaw:
        """Return the cutting law of the material.

        :raises ForceError: the process has no [material], or it is incomplete.
        """
        if self.material is None:
            advice = 'Give [material] name = "…" (postproc forces --materials lists them), or [operations] with forces.'
            raise ForceError("no [material]", file=self.path, advice=advice)
        return law(self.material, self.path)

    def key_of(self, name: str) -> str | None:
        """Return the key in [tools] of a tool by its number or name, in any case; None if it has no entry."""
        return next((key for key in self.tools if key.upper() == name.upper()), None)

    def tool(self, name: str | None) -> tuple[str, ToolTable] | None:
        """Return the key and the entry of a tool: the one of its name in [tools], else [tools.default].

        None if there is neither.

        :param name: number or name of the tool; None: unknown. Then the only tool of a file is returned if it has no
            default.
        """
        key = None if name is None else self.key_of(name)
        if key is not None:
            return key, self.tools[key]
        if DEFAULT in self.tools:
            return DEFAULT, self.tools[DEFAULT]
        if name is None and len(self.tools) == 1:
            return next(iter(self.tools.items()))
        return None

    def cutter(self, key: str) -> Cutter:
        """Return the cutter of the entry `key` of [tools]."""
        tool = self.tools[key]
        radius = 0.5 * tool.diameter_mm * M_PER_MM
        corner_radius = {"flat": 0.0, "ball": radius, "drill": 0.0}.get(tool.shape, tool.corner_radius_mm * M_PER_MM)
        return Cutter(radius, corner_radius, tool.flutes, tool.shape == "drill")


_EXAMPLE = """For example:

[material]
name = "al_6082_t6_carbide"             # postproc forces --materials lists them

[tools.1]                               # by T number or name of RAPID tooldata; [tools.default] for all others
shape = "flat"
diameter_mm = 10
flutes = 3

[stock]
box = { X = [0, 100], Y = [0, 80], Z = [-20, 0] }   # $BASE, mm; or file = "stock.stl"
"""


def load(path: str | Path, *, tools_only: bool = False) -> Process:
    """Read and check a process file.

    :param tools_only: accept a file without [material] and [operations].
    :raises ForceError: the file cannot be read, has unknown keys, wrong types, values out of range, or states no
        forces.
    """
    path = Path(path)
    content = files.read_toml(path, ProcessFile, ForceError, _EXAMPLE)
    file = str(path)
    _check_tools(content.tools, file)
    if content.stock.box is not None:
        for axis, span in zip("XYZ", (content.stock.box.X, content.stock.box.Y, content.stock.box.Z), strict=True):
            if not span[0] < span[1]:
                raise ForceError(
                    f"[stock] box {axis}: {list(span)} is not from smaller to larger",
                    file=file,
                    advice="Write the smaller number first.",
                )
    if content.material is None and not content.operations and not tools_only:
        raise ForceError("neither [material] nor [operations]", file=file, advice=_EXAMPLE)
    return Process(**{name: getattr(content, name) for name in content.__struct_fields__}, path=file)


def _check_tools(tools: dict[str, ToolTable], file: str) -> None:
    """Check the keys of [tools], and that corner radii fit the shapes of the tools.

    :raises ForceError: a key is no tool, two keys are one without regard to case, or a corner radius does not fit.
    """
    spellings = {DEFAULT.upper(): DEFAULT}  # upper case → key
    for key, tool in tools.items():
        if not (is_name(key) or key == DEFAULT or (key.isascii() and key.isdecimal())):
            problem = f"[tools.{key}]: {key!r} is not a tool number, nor a name of RAPID tooldata"
            raise ForceError(problem, file=file, advice="Or [tools.default].")
        spelling = spellings.setdefault(key.upper(), key)
        if spelling != key:
            problem = f"[tools.{key}] is another spelling of [tools.{spelling}]"
            raise ForceError(problem, file=file, advice="Case does not count: give one of them.")
        if tool.shape == "bull" and not 0.0 < 2.0 * tool.corner_radius_mm <= tool.diameter_mm:
            advice = "Give corner_radius_mm, larger than 0 and at most half the diameter."
            raise ForceError(f"[tools.{key}]: a bull tool without a corner radius that fits", file=file, advice=advice)
        if tool.shape != "bull" and tool.corner_radius_mm not in (0.0, 0.5 * tool.diameter_mm):
            advice = 'A tool with a corner radius is shape = "bull".'
            raise ForceError(f"[tools.{key}]: corner_radius_mm with shape {tool.shape!r}", file=file, advice=advice)


def is_name(key: str) -> bool:
    """Return whether a key in [tools] can be the name of RAPID tooldata.

    A tool number cannot, nor can `DEFAULT`, the key for all tools without a table of their own.
    """
    return key != DEFAULT and _NAME.fullmatch(key) is not None


def box_corners(box: Box) -> tuple[Array, Array]:
    """Return the lower and the upper corner of a box of a process, which is in mm, (3,) each [m]."""
    spans = np.array([box.X, box.Y, box.Z]) * M_PER_MM
    return spans[:, 0], spans[:, 1]
