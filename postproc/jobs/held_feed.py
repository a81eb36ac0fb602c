"""Feeds that hold the tolerance of the part: as high as the program's, and as low as the force model says it needs.

The force on an edge is that of its rubbing plus a part that grows with the feed f as f^(1 − mc). mc is 0 in the linear
edge-force model, else Kienzle's exponent (see `machining.material.CuttingLaw`). The expected error is nearly linear in
that too. So its root is found by false position in f^(1 − mc), each motion for itself. Every trial is a whole
conversion: swept, corrected, written, read back and simulated.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.correction import HeldFeed, Result
from postproc.errors import InputError
from postproc.frames import MM_PER_M, Array
from postproc.program import Bools, Program

_ROUNDS = 10
"""Largest number of trials between the programmed feeds and the least ones."""
_AIM = 0.997
"""Trials are this share of the feed at which the tolerance would be reached, so that most hold it at once."""
_CLOSE = 0.01
"""A feed that could be higher by this share at most is high enough."""
_BACK = 0.99
"""Share of its feed that a motion gets if it exceeds the tolerance at a feed at which it did not before."""
_NO_HELP = 0.05
"""Where the tolerance cannot be held, the feed is lowered until the error is above that at the least feed by this."""
_ALMOST_NONE = 1e-3
"""Share of the programmed feed at which the errors are taken for those without feed."""
_STEP = 1e-6
"""Feeds are multiples of this [m/s]: that is what programs print."""
_MM_PER_MIN = 60.0 * MM_PER_M

Trial = Callable[[Program], Result]


def check(cell: Cell, *, process: bool) -> None:
    """Refuse a cell that asks for held feeds without what they need.

    :param process: whether the forces come from a process.
    :raises InputError: no tolerance of the part, or no process.
    """
    if cell.part_tolerance is None:
        advice = "Give tolerance_mm in [part] of the cell, or --part-tolerance."
        raise InputError('[output] feed = "hold" without a tolerance of the part', advice=advice)
    if not process:
        advice = 'Give --process process.toml: only it says how forces depend on the feed. Or write feed = "program".'
        raise InputError('[output] feed = "hold" without a process', advice=advice)


def held(program: Program, length: Array, cell: Cell, exponent: float, trial: Trial) -> Result:
    """Return the result with the highest feeds, at most the programmed ones, that hold the tolerance of the part.

    Where the least feed does not hold it, the feed is lowered as far as that helps: until the error is 5 % above the
    one at the least feed.

    :param length: (M,) length of the motions [m].
    :param exponent: mc of the material: chip forces grow with feed^(1 − mc).
    :param trial: converts the program with the feeds of its motions.
    :raises InputError: the model states no uncertainty, so that no error is expected.
    """
    m, least = program.motions, cell.output.min_feed_mm_per_min / _MM_PER_MIN
    result = trial(program)
    if result.failed:
        return result
    if result.expected is None or cell.part_tolerance is None:
        advice = 'Give sigma_percent or a covariance in its model.toml, or write feed = "program".'
        raise InputError('[output] feed = "hold": the robot model states no uncertainty', advice=advice)
    search = _Search(program, cell.part_tolerance, least, 1.0 - exponent, _of_motions(result))
    without = np.full(len(m), np.nan)
    if search.open.any():
        result = trial(search.program(search.least))
        if not result.failed and (missed := search.start(_of_motions(result))).any():
            result = trial(search.program(np.maximum(_ALMOST_NONE * m.feed, _STEP)))
            without[missed] = _of_motions(result)[missed]
        for _ in range(_ROUNDS):
            if result.failed:
                return result
            result = trial(search.program(search.next()))
            if search.settled(_of_motions(result)):
                break
    error = _of_motions(result)
    found = HeldFeed(cell.part_tolerance, least, m.feed, result.program.motions.feed, length, error, without)
    return replace(result, held_feed=found)


class _Search:
    """Bounds of the feed of each motion, by false position.

    :ivar open: (M,) motions whose feed may be lowered.
    :ivar limit: (M,) error to stay below; feed: (M,) of the last trial.
    :ivar low: (M,) feed that stays below it as far as is known, with error_low; high: (M,) feed that does not.
    """

    def __init__(self, program: Program, tolerance: float, least: float, power: float, error: Array) -> None:
        """Begin with the errors (M,) at the programmed feeds."""
        m = program.motions
        self.of, self.power, self.feed = program, power, m.feed
        self.limit = np.full(len(m), tolerance)
        self.high, self.error_high = m.feed.copy(), error
        self.least = np.minimum(m.feed, np.ceil(least / _STEP) * _STEP)
        self.low, self.error_low = self.least.copy(), np.zeros(len(m))
        self.open: Bools = np.asarray(~m.rapid & (error > tolerance) & (self.low < self.high))

    def program(self, feed: Array) -> Program:
        """Return the program with other feeds (M,) for open motions."""
        as_read = self.of.motions.feed
        self.feed = np.where(self.open, feed, as_read)
        return replace(self.of, motions=replace(self.of.motions, feed=self.feed), feed_as_read=as_read)

    def start(self, error: Array) -> Bools:
        """Take the errors (M,) at the least feeds; where they exceed the tolerance, aim at one that is near them.

        :returns: (M,) True there.
        """
        self.error_low = error
        missed = self.open & (error > self.limit)
        self.limit[missed] = (1.0 + _NO_HELP) * error[missed]
        useless = self.open & (self.error_high <= self.limit)
        self.low[useless], self.error_low[useless] = self.high[useless], self.error_high[useless]
        return np.asarray(missed)

    def next(self) -> Array:
        """Return the feeds (M,) to try."""
        low, high = self.low**self.power, self.high**self.power
        gap = self.error_high - self.error_low
        share = np.clip((self.limit - self.error_low) / np.where(gap > 0.0, gap, 1.0), 0.0, 1.0)
        tried = (low + share * (high - low)) ** (1.0 / self.power) * np.where(self.low < self.high, _AIM, 1.0)
        return np.asarray(np.clip(np.floor(tried / _STEP + 1e-6) * _STEP, self.low, self.high))

    def settled(self, error: Array) -> bool:
        """Take the errors (M,) at the feeds of the last trial; return whether these feeds are to be written."""
        held = error <= self.limit
        good, bad = self.open & held, self.open & ~held
        rate = (self.error_high - error) / np.maximum(self.high - self.feed, _STEP)
        more = np.minimum((self.limit - error) / np.maximum(rate, 1e-12), self.high - self.feed)
        self.low[good], self.error_low[good] = self.feed[good], error[good]
        stuck = bad & (self.feed <= self.low)  # the error depends on the motions before, too
        at_least = stuck & (self.feed <= self.least)
        self.low[stuck] = np.maximum(self.least, _BACK * self.low)[stuck]
        self.high[bad], self.error_high[bad] = self.feed[bad], error[bad]
        return bool(np.all(~self.open | (good & (more <= _CLOSE * self.feed)) | at_least))


def _of_motions(result: Result) -> Array:
    """Return the largest expected error (M,) [m] of each motion; 0 without a target or a cut."""
    out = np.zeros(len(result.program.motions))
    if result.expected is not None:
        np.maximum.at(out, result.motion, result.expected)
    return out
