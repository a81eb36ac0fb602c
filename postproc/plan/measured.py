"""What was measured already: its information for the criterion, on its own levels of q2."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.frames import Array
from postproc.identification.measurements import Measurements
from postproc.identification.observability import levels_of
from postproc.plan.sensitivity import Readings
from postproc.program import Ints


class Measured(Struct, frozen=True, eq=False):
    """Loaded states measured so far.

    :param q: (d, 6) configurations [rad].
    :param q2: (m,) their levels [rad].
    :param information: (d, p, p) of each.
    :param level: (d,) its row among `q2`.
    """

    q: Array
    q2: Array
    information: Array
    level: Ints


def measured(data: Measurements, readings: Readings, sigma: float) -> Measured:
    """Weigh each loaded state by how often it and its unloaded state were read.

    :param readings: with the compliances looked for.
    :param sigma: noise of one coordinate of one reading [m].
    """
    level_of_config = levels_of(data)
    _, count = data.means()
    config = data.state_config[data.loaded]
    rest = data.unloaded[config]
    times = np.maximum(1.0 / (1.0 / count[data.loaded] + 1.0 / count[rest]).mean(axis=1), 0.0)
    share = times * (readings.noise / sigma) ** 2
    information = readings.information_of(data.q[config], data.wrench[data.loaded]) * share[:, None, None]
    level = level_of_config[config]
    q2 = np.array([data.q[level_of_config == index, 1].mean() for index in range(int(level_of_config.max()) + 1)])
    return Measured(data.q[config], q2, information, level)
