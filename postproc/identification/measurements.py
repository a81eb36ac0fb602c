"""Measurements of a loaded robot: readings of reference points, with and without load."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.frames import Array
from postproc.program import Bools, Ints


class Measurements(Struct, frozen=True, eq=False):
    """Readings of P reference points in S states (a configuration without load, or with one of its loads).

    :param file: name of the file.
    :param config: (C,) numbers of the configurations as in the file.
    :param q: (C, 6) joint angles [rad].
    :param state_config: (S,) row of the configuration of each state.
    :param load: (S,) number of the load; 0 without load.
    :param wrench: (S, 6) force [N] and moment [N·m] at the load point, root axes.
    :param points: names of the reference points.
    :param guess: (P, 3) where they are in the flange frame, roughly [m].
    :param load_point: (3,) in the flange frame [m].
    :param sigma: noise of one coordinate of one reading [m], as stated.
    :param state: (n,) state of each reading.
    :param point: (n,) point of each reading.
    :param repeat: (n,) number of the repeat.
    :param position: (n, 3) in the frame of the measuring device [m].
    :param line: (n,) line in the file.
    :param used: (n,) False for readings left out as outliers.
    :param load_error: 95 % bound of what all loads are wrong by together, as a share.
    :param load_point_error: standard deviation of where they act, in each direction [m].
    """

    file: str
    config: Array
    q: Array
    state_config: Ints
    load: Array
    wrench: Array
    points: tuple[str, ...]
    guess: Array
    load_point: Array
    sigma: float
    state: Ints
    point: Ints
    repeat: Array
    position: Array
    line: Array
    used: Bools
    load_error: float = 0.0
    load_point_error: float = 0.0

    @property
    def loaded(self) -> Ints:
        """States with load."""
        return np.flatnonzero(self.load != 0)

    @property
    def unloaded(self) -> Ints:
        """(C,) the state without load of each configuration."""
        rest = np.flatnonzero(self.load == 0)
        order = np.empty(len(self.q), dtype=np.int64)
        order[self.state_config[rest]] = rest
        return order

    def means(self) -> tuple[Array, Array]:
        """Return mean positions (S, P, 3) [m] of the readings used (zero if none), and how many there are (S, P)."""
        shape = (len(self.load), len(self.points))
        key = (self.state * shape[1] + self.point)[self.used]
        count = np.bincount(key, minlength=shape[0] * shape[1]).astype(float)
        total = np.stack(
            [np.bincount(key, weights=self.position[self.used, axis], minlength=len(count)) for axis in range(3)]
        )
        mean = (total / np.maximum(count, 1.0)).T
        return mean.reshape(*shape, 3), count.reshape(shape)

    def scatter(self) -> tuple[float, int]:
        """Return the sum of squares of the repeats about their means [m²] and its degrees of freedom."""
        mean, count = self.means()
        left = (self.position - mean[self.state, self.point])[self.used]
        return float(np.sum(left**2)), int(3 * np.sum(np.maximum(count - 1, 0)))

    def name(self, reading: int) -> str:
        """Return how a user finds a reading: line, configuration, load, repeat, point."""
        state = self.state[reading]
        return (
            f"line {int(self.line[reading])}: config {self.config[self.state_config[state]]:g}, "
            f"load {self.load[state]:g}, repeat {self.repeat[reading]:g}, point {self.points[self.point[reading]]}"
        )

    def without(self, readings: list[int]) -> Measurements:
        """Return the measurements with some readings left out."""
        used = self.used.copy()
        used[readings] = False
        return replace(self, used=used)

    def only(self, configurations: Ints) -> Measurements:
        """Return the measurements of some configurations (rows of `q`)."""
        new_config = np.full(len(self.q), -1)
        new_config[configurations] = np.arange(len(configurations))
        states = np.flatnonzero(new_config[self.state_config] >= 0)
        new_state = np.full(len(self.load), -1)
        new_state[states] = np.arange(len(states))
        rows = np.flatnonzero(new_state[self.state] >= 0)
        return replace(
            self,
            config=self.config[configurations],
            q=self.q[configurations],
            state_config=new_config[self.state_config[states]],
            load=self.load[states],
            wrench=self.wrench[states],
            state=new_state[self.state[rows]],
            point=self.point[rows],
            repeat=self.repeat[rows],
            position=self.position[rows],
            line=self.line[rows],
            used=self.used[rows],
        )
