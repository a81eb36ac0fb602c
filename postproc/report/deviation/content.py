"""What the sections of the page of a program are made from, and what its scripts are told."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from msgspec import Struct

from postproc.correction import Result
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array
from postproc.program import Ints
from postproc.report.deviation.operations import Operation, operations
from postproc.report.deviation.places import Places, places
from postproc.report.kit import Columns
from postproc.report.summary import Summary, nothing_to_correct, summary
from postproc.report.verdict import Verdict, verdict
from postproc.robot import JOINTS

if TYPE_CHECKING:
    from postproc.machining import ProcessForces
    from postproc.report.surface import Surface

_BINS = 60
_MOST_FACES = 200_000


class Histogram(msgspec.Struct, frozen=True):
    """How many cutting targets deviate by how much: counts between edges [mm]."""

    edges: list[float]
    counts: list[int]


class Facts(msgspec.Struct, frozen=True):
    """What the scripts of the page are told beside the columns. Lengths mm, angles degrees.

    :param mode: see `postproc.correction.Mode`.
    :param frame: of the path drawn: "$BASE", or "robot root" where the program has several.
    :param tolerance_mm: stated, or None.
    :param worst: places of the largest deviation before and after.
    :param lower: limits of the joints, `upper` too [deg].
    :param bases: each `$BASE` in the root, tools each `$TOOL` in the flange: 4×4 by rows [mm].
    :param placement: of each joint on the link before it, 4×4 by rows [mm]; `axis` about which it turns; `flange`.
    :param histograms: by column name.
    :param reversals: place and joint of the largest changes of direction of a torque.
    """

    mode: str
    frame: str
    tolerance_mm: float | None
    bounded: bool
    worst: dict[str, int]
    lower: list[float]
    upper: list[float]
    bases: list[list[float]]
    tools: list[list[float]]
    placement: list[list[float]]
    axis: list[list[float]]
    flange: list[float]
    histograms: dict[str, Histogram]
    reversals: list[tuple[int, str]]


class Deviation(Struct, frozen=True, dict=True):
    """A result and what the sections of its page say of it.

    :param result: of one program.
    :param tolerance: what the tip may leave the nominal path by [m]; None = not stated.
    :param surface: of the part, or None.
    :param process: what a process made of the program, where the forces are from one.
    :param part_tolerance: what the part may be off [m], 95 %; None = not stated.
    """

    result: Result
    tolerance: float | None
    surface: Surface | None = None
    process: ProcessForces | None = None
    part_tolerance: float | None = None

    @cached_property
    def content(self) -> Summary:
        """Content of `report.json`."""
        return summary(self.result, self.tolerance, self.part_tolerance)

    @cached_property
    def verdict(self) -> Verdict:
        """What to think of it."""
        return verdict(self.result, self.content)

    @cached_property
    def nothing(self) -> str | None:
        """A sentence where there is nothing to correct, or None."""
        return nothing_to_correct(self.content)

    @property
    def compared(self) -> bool:
        """True if there is a program as written, to be compared with the one as programmed."""
        return self.result.mode != "predict"

    @cached_property
    def places(self) -> Places:
        """The places that the page shows; only where there are targets."""
        return places(self.result)

    @cached_property
    def operations(self) -> list[Operation]:
        """The operations of the program."""
        return operations(self.result)

    @cached_property
    def stock(self) -> tuple[Array, Ints] | None:
        """What is left of the stock: vertices (V, 3) [m] and faces (F, 3); None where a page cannot hold it."""
        if self.process is None:
            return None
        points, faces = self.process.mesh()
        return (points, faces) if 0 < len(faces) <= _MOST_FACES else None

    def columns(self) -> dict[str, Columns]:
        """Return the numbers of the page."""
        out = {"places": self.places.columns, "drawn": self.places.drawn}
        if self.stock is not None:
            points, faces = self.stock
            out["stock_points"] = Columns.of(dict(zip("xyz", points.T * MM_PER_M, strict=True)))
            out["stock_faces"] = Columns.of(dict(zip("ijk", faces.T, strict=True)))
        if self.surface is not None:
            corners = self.surface.corners.reshape(-1, 3) * MM_PER_M
            out["corners"] = Columns.of(dict(zip("xyz", corners.T, strict=True)))
            last = len(self.places.row) - 1
            place = np.minimum(np.searchsorted(self.places.row, self.surface.row), last)
            bound = np.full(len(place), np.nan) if self.surface.bound is None else self.surface.bound
            values = {"before": self.surface.before, "after": self.surface.after, "u95": bound}
            facets = {name: value * MM_PER_M for name, value in values.items()}
            out["facets"] = Columns.of({**facets, "place": np.where(self.surface.row < 0, -1, place)})
        return out

    def facts(self) -> Facts:
        """Return what the scripts are told."""
        result = self.result
        nominal, program = result.robot.nominal, result.program
        measures = {"before": result.before, "after": result.after} if self.compared else {"before": result.before}
        cutting = ~result.rapid
        worst = {
            name: self.places.of(int(np.argmax(np.where(cutting, values, -1.0)))) for name, values in measures.items()
        }
        return Facts(
            mode=result.mode,
            frame="$BASE" if len(program.bases) == 1 else "robot root",
            tolerance_mm=self.content["tolerance_mm"],
            bounded=result.bound is not None,
            worst=worst,
            lower=(result.robot.lower * DEG_PER_RAD).tolist(),
            upper=(result.robot.upper * DEG_PER_RAD).tolist(),
            bases=[_in_mm(base) for base in program.bases],
            tools=[_in_mm(tool) for tool in program.tools],
            placement=[_in_mm(joint) for joint in nominal.placement],
            axis=nominal.axis.tolist(),
            flange=_in_mm(nominal.flange),
            reversals=self.reversals(),
            histograms={name: _histogram(values[cutting] * MM_PER_M) for name, values in measures.items()},
        )

    def reversals(self) -> list[tuple[int, str]]:
        """Return place and joint of the reversals that are listed."""
        turned = self.result.reversals
        if turned is None:
            return []
        listed = self.result.largest_reversals.tolist()
        return [(self.places.of(int(turned.row[each])), JOINTS[turned.joint[each]]) for each in listed]


def _histogram(values: Array) -> Histogram:
    top = float(values.max(initial=0.0)) or 1.0
    counts, edges = np.histogram(values, bins=_BINS, range=(0.0, top))
    return Histogram(edges.tolist(), counts.tolist())


def _in_mm(pose: Array) -> list[float]:
    scaled = pose.copy()
    scaled[:3, 3] *= MM_PER_M
    return [float(value) for value in scaled.ravel()]
