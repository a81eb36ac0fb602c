"""Sources of forces: their common format, the comments of a program, and the readers of files by extension."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc.chunks import Columns
from postproc.errors import ForceError, Issue, PostprocError
from postproc.frames import Array, any_column
from postproc.program import FORCE_FRAMES, MOST_FORCE, Bools, Ints, Program, constant
from postproc.toolpath import Segments

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


BASE, TOOL, FEED = range(3)
"""Values of `Knots.frame`: places in `FORCE_FRAMES`."""


class LawForces(Struct, frozen=True, eq=False):
    """Motions whose forces a cutting law computes: the errors of these forces are one common factor.

    :param numbers: numbers of the law, by which two laws are compared.
    :param motion: (n,) rows of `Motions`, whose forces the law computes.
    """

    numbers: tuple[float, ...]
    motion: Ints


class StockInTime(Protocol):
    """The stock of a program over time, as an upper bound of the material."""

    @property
    def is_compared(self) -> Bools:
        """(M,) motions on which the parts of the tool along its axis were compared with the stock."""

    @property
    def removes_material(self) -> Bools:
        """(M,) motions that remove material: their cutter is in the stock."""

    @property
    def accuracy(self) -> float:
        """Largest distance by which the bound exceeds the stock [m]."""

    def mesh(self, motion: int) -> tuple[Array, NDArray[np.int64]]:
        """Return all material when a motion begins: vertices (V, 3) in the robot root [m], faces (F, 3)."""


class Knots(Columns, frozen=True, eq=False):
    """The wrench at K places along motions: linear from one to the next, constant before the first and after the last.

    The wrench is linear in the axes that `frame` names: in FEED axes it turns with the travel, in TOOL axes with the
    tool. A motion without a knot has no force.

    :param motion: (K,) row of `Motions`, never decreasing.
    :param t: (K,) position on it in [0, 1], increasing along a motion.
    :param wrench: (K, 6) Fx…Mz on the tool at its tip [N, N·m], in the axes that `frame` names.
    :param frame: (K,) `BASE`, `TOOL` or `FEED`; the same for all knots of a motion.
    :param sigma: (K, 6) standard deviations of `wrench`: components are assumed independent of each other at a knot,
        and each is assumed fully correlated with itself along the path.
    :param factor: (K,) standard deviation of one unknown factor of the whole wrench, as for a harder material or a worn
        tool: |wrench|·factor is a part of `sigma`; 0: there is no such factor.
    :param ramped: (K,) True for the only knot of a motion whose force changes from that of the motion before over its
        first `force_ramp_mm`; otherwise the force is as given from the start of the motion.
    :param issues: warnings and notes for the user.
    :param law_forces: motions whose forces a cutting law computes.
    :param stock: the stock over time, if the source knows it.
    """

    motion: Ints
    t: Array
    wrench: Array
    frame: Ints
    sigma: Array
    factor: Array
    ramped: Bools
    issues: tuple[Issue, ...] = ()
    law_forces: LawForces | None = None
    stock: StockInTime | None = None

    @classmethod
    def throughout(
        cls, motion: Ints, wrench: Array, frame: Ints, sigma: Array | None = None, factor: Array | None = None
    ) -> Knots:
        """Return one wrench (n, 6) for the whole of each motion (n,), ramped at its start.

        :param motion: (n,) rows of `Motions`, ascending.
        :param wrench: (n, 6) force and moment [N, N·m], in the axes that `frame` (n,) names.
        :param sigma: (n, 6) standard deviations of the components of the wrenches [N, N·m]; None: zero.
        :param factor: (n,) standard deviation of one factor of the whole wrench, see `Knots`; None: zero.
        """
        return replace(
            cls.along(motion, np.ones(len(motion)), wrench, frame, sigma, factor),
            ramped=np.broadcast_to(np.True_, len(motion)),
        )

    @classmethod
    def along(
        cls,
        motion: Ints,
        t: Array,
        wrench: Array,
        frame: Ints,
        sigma: Array | None = None,
        factor: Array | None = None,
    ) -> Knots:
        """Return the knots of wrenches that are known at n places along motions, without a ramp.

        :param motion: (n,) rows of `Motions`, ascending.
        :param t: (n,) places on the motions, in [0, 1], ascending on each.
        :param wrench: (n, 6) force and moment [N, N·m].
        :param frame: (n,) the axes in which the wrenches are given.
        :param sigma: (n, 6) standard deviations of the components of the wrenches [N, N·m]; None: zero.
        :param factor: (n,) standard deviation of one factor of the whole wrench, see `Knots`; None: zero.
        """
        sigma = np.broadcast_to(0.0, np.shape(wrench)) if sigma is None else sigma
        factor = constant(0.0, len(motion)) if factor is None else factor
        return cls(motion, t, wrench, frame, sigma, factor, np.zeros(len(motion), dtype=np.bool_))

    def __len__(self) -> int:
        return len(self.motion)

    def with_fallback(self, fallback: Knots) -> Knots:
        """Return these knots, and the knots of `fallback` for motions without a knot here.

        The result has no issues, law forces or stock.
        """
        extra_knots = fallback.take(~np.isin(fallback.motion, self.motion))
        # stable: the knots of one motion stay in order
        order = np.argsort(np.append(self.motion, extra_knots.motion), kind="stable")
        return replace(Knots.join([self, extra_knots], order), issues=(), law_forces=None, stock=None)

    def check(self, program: Program, name: str) -> Knots:
        """Return these knots if they can be used for a program.

        :param name: name of the source, for messages.
        :raises ForceError: arrays do not have one row per knot; or knots are not in order, name a motion that the
            program does not have, are not finite or too large, or have several frames on one motion.
        """
        count = len(self.motion)
        has_rows = all(np.shape(array) == (count,) for array in (self.t, self.frame, self.ramped, self.factor))
        if not has_rows or any(np.shape(array) != (count, 6) for array in (self.wrench, self.sigma)):
            raise ForceError(f"the arrays of the source of forces {name} do not have one row per knot")
        for is_invalid, problem in self._faults(len(program.motions)):
            if np.any(is_invalid):
                motion = int(self.motion[int(np.argmax(is_invalid))])
                line = int(program.motions.line[motion]) if 0 <= motion < len(program.motions) else None
                text = f"the source of forces {name} gives {problem}"
                raise ForceError(text, file=program.documents[0].name, line=line, advice="Report this to its author.")
        return self

    def _faults(self, motion_count: int) -> Iterator[tuple[Bools, str]]:
        """Yield each fault that knots may have: True (K,) at knots that have it, and its description.

        :param motion_count: number of motions of the program.
        """
        yield (self.motion < 0) | (self.motion >= motion_count), "a motion that does not exist"
        # ranges are negated because a comparison with NaN is False
        yield ~((self.t >= 0.0) & (self.t <= 1.0)), "a place outside a motion (t in 0…1)"
        is_wrong_wrench = any_column(~(np.abs(self.wrench) <= MOST_FORCE))
        yield is_wrong_wrench, "a force that is not finite, or larger than any robot carries"
        is_wrong_sigma = any_column(~((self.sigma >= 0.0) & (self.sigma <= MOST_FORCE)))
        is_wrong_factor = ~((self.factor >= 0.0) & (self.factor < np.inf))
        yield is_wrong_sigma | is_wrong_factor, "a standard deviation that is not finite, negative or too large"
        yield (self.frame < 0) | (self.frame >= len(FORCE_FRAMES)), "an unknown frame"
        yield from self._order_faults()

    def _order_faults(self) -> Iterator[tuple[Bools, str]]:
        """Yield each fault between a knot and the next one: True (K,) at the first of the two, and its description."""
        same_motion = np.diff(self.motion) == 0
        for is_wrong, problem in (
            (np.diff(self.motion) < 0, "motions out of order"),
            (same_motion & (np.diff(self.t) <= 0.0), "places on one motion out of order"),
            (same_motion & (np.diff(self.frame) != 0), "two frames on one motion"),
            (same_motion & (self.ramped[1:] | self.ramped[:-1]), "a ramped motion with several knots"),
        ):
            yield np.append(is_wrong, False), problem  # the last knot has no next one


class ForceSource(Protocol):
    """A source of forces: a file, the process and the stock, a measurement."""

    @property
    def name(self) -> str:
        """Name in messages, e.g. of its file."""

    def along(self, program: Program, path: Segments) -> Knots:
        """Return the forces along the motions of a program that this source covers.

        Comments in the program apply to all other motions. Forces on rapid moves are ignored.

        :param path: geometry of the motions.
        :raises ForceError: the forces do not match the motions of this program.
        """


READERS = {".csv": "postproc.forces.table:read_force_csv"}
"""Readers of `--forces` files by extension, as module:function; imported when such a file is given."""
GROUP = "postproc.forces"
"""Entry-point group in which other packages add readers; entries are named by extension, e.g. ``".xlsx"``."""


def extensions() -> list[str]:
    """Return the readable file extensions, lower case: first the built-in ones, then those that other packages add."""
    from importlib.metadata import entry_points  # slow to import, needed for this list only

    return [*READERS, *sorted({entry.name.lower() for entry in entry_points(group=GROUP)} - set(READERS))]


def read(path: Path) -> ForceSource:
    """Read a file of forces with the reader for its extension.

    A file of an extension without a reader is read as CSV.

    :raises ForceError: the file is unusable, or the reader of another package fails.
    :raises PostprocError: from the reader of another package.
    """
    extension = path.suffix.lower()
    if extension not in READERS:
        from importlib.metadata import entry_points  # slow to import, needed only for other extensions

        entry_of = {entry.name.lower(): entry for entry in entry_points(group=GROUP)}
        if extension in entry_of:
            return _read_by_package(entry_of[extension], path)
    module, _, name = READERS.get(extension, READERS[".csv"]).partition(":")
    reader: Callable[[Path], ForceSource] = getattr(import_module(module), name)
    return reader(path)


def _read_by_package(entry: EntryPoint, path: Path) -> ForceSource:
    """Read a file with the reader of another package; errors name that package.

    :raises ForceError: the reader fails with any other error than a `PostprocError`.
    :raises PostprocError: from the reader, unchanged.
    """
    package = entry.dist.name if entry.dist is not None else entry.value
    try:
        source: ForceSource = entry.load()(path)
    except PostprocError:
        raise
    except (Exception, SystemExit) as cause:
        fault = f"{type(cause).__name__}: {cause}"
        raise ForceError(
            f"the reader of {entry.name} files from {package} does not work: {fault}",
            file=str(path),
            advice=f"Update or remove {package}, or give the forces as a CSV file.",
        ) from cause
    return source
