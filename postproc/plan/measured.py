"""What was measured already: its information for the criterion, on its own levels of q2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from postproc.frames import Array
from postproc.identification.measurements import Measurements
from postproc.identification.observability import levels_of
from postproc.plan.criterion import Done
from postproc.plan.sensitivity import Bench


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Loaded states measured so far.

    :param q: (d, 6) configurations [rad].
    :param q2: (m,) their levels [rad].
    :param done: information and level of each.
    """

    q: Array
    q2: Array
    done: Done


def measured(data: Measurements, bench: Bench, sigma: float) -> Measured:
    """Weigh each loaded state by how often it and its unloaded state were read.

    :param bench: with the compliances looked for.
    :param sigma: noise of one coordinate of one reading [m].
    """
    level_of_config = levels_of(data)
    _, count = data.means()
    config = data.state_config[data.loaded]
    rest = data.unloaded[config]
    readings = np.maximum(1.0 / (1.0 / count[data.loaded] + 1.0 / count[rest]).mean(axis=1), 0.0)
    share = readings * (bench.noise / sigma) ** 2
    information = bench.information_of(data.q[config], data.wrench[data.loaded]) * share[:, None, None]
    level = level_of_config[config]
    q2 = np.array([data.q[level_of_config == index, 1].mean() for index in range(int(level_of_config.max()) + 1)])
    return Measured(data.q[config], q2, Done(information, level))
