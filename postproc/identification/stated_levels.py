"""Loads of one level that are stated wrong, while those of the others are right: a scale, a mass or a pulley.

The gears then seem to stiffen or to soften, and the model explains the readings by gears that are not linear. But a
wrong load moves all joints and links by the same factor, and a gear by the torque on its joint, which differs from pose
to pose. So both are fitted together: all candidate parameters of the choice, gears of either sign, and the logarithm of
a factor on the loads of a level. The evidence with and without the factor, and its jackknife over the configurations,
say whether the readings ask for it. A factor that all loads have in common leaves no trace: every compliance has it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from postproc.frames import Array, norm
from postproc.identification.choice import full_structure
from postproc.identification.fit import Fit, LinearEquations, Prior, Regression, learn, linearise, prior_of
from postproc.identification.measurement_model import Placement, Structure, predict, visible_points, whiten, whitening
from postproc.identification.readings import Measurements
from postproc.identification.uncertainty import levels
from postproc.kinematics.forward import GRAVITY
from postproc.program import Ints
from postproc.robot import CompensatorStiffness

_LOG_SIGMA = 0.2
"""Standard deviation of the logarithm of the factor on a level that is stated wrong (assumed)."""
_LOG_STEP = 0.02
"""Logarithm of the factor for its difference quotient: displacements are linear in the load to some per cent."""
_SMALLEST_LOG = 0.05
"""Smallest logarithm of a factor that is no error of load cells and scales (assumed)."""
_SIGMAS = 2.0
"""Jackknife standard deviations that the factor must be beyond `_SMALLEST_LOG`."""
_MIN_EVIDENCE = 10.0
"""Gain of log evidence from which a factor is reported."""
_EVIDENCE_MARGIN = 10.0
"""Difference of log evidence below which it is not known which of two levels is wrong."""


class _Factor(NamedTuple):
    """Factor on the loads of a level.

    :param level: number of the level, as `uncertainty.levels` has it.
    :param log: natural logarithm of the factor.
    :param sigma: jackknife standard deviation of the logarithm.
    :param gain: log evidence with the factor less log evidence without.
    """

    level: int
    log: float
    sigma: float
    gain: float

    @property
    def is_clear(self) -> bool:
        """Whether the evidence for the factor is clear, and the factor clearly larger than errors of load cells."""
        return self.gain > _MIN_EVIDENCE and abs(self.log) - _SIGMAS * self.sigma > _SMALLEST_LOG


def doubt_of_levels(fit: Fit, data: Measurements, placement: Placement) -> str:
    """Return, as a clause, the level of loads that fits better with a factor, and what to check.

    Several levels are named if their evidence is alike. Empty if no factor is clear, or if there is one level alone.

    :param fit: of the springs that were chosen.
    """
    load = norm(data.wrench[data.loaded_states])
    level = levels(load)
    if level.max() == 0:
        return ""
    factors = sorted(_level_factors(fit, data, placement, level), key=lambda factor: -factor.gain)
    if not factors[0].is_clear:
        return ""
    parts = [
        _level_text(factor, float(np.median(load[level == factor.level])))
        for factor in factors
        if factor.is_clear and factor.gain > factors[0].gain - _EVIDENCE_MARGIN
    ]
    return f"the loads near {', or those near '.join(parts)}: check their scale, mass or pulley"


def _level_text(factor: _Factor, load: float) -> str:
    """Return a text with a level of loads, the load that fits better, and the factor.

    :param load: median of the stated loads of the level [N].
    """
    ratio = float(np.exp(factor.log))
    return (
        f"{load:.0f} N ({load / GRAVITY:.3g} kg) fit the others as about {ratio * load:.0f} N "
        f"({ratio * load / GRAVITY:.3g} kg), {ratio:.2f} times as large"
    )


def _level_factors(fit: Fit, data: Measurements, placement: Placement, level: Ints) -> list[_Factor]:
    """Return the factor on each level, each fitted alone together with all candidate parameters.

    :param fit: of the springs that were chosen.
    :param level: (L,) level of each loaded state.
    """
    structure, values = _all_parameters(fit, data)
    equations, prior = linearise(structure, values, data, placement), prior_of(structure)
    size = len(values)
    plain_evidence = learn(equations, prior, np.arange(size)).evidence
    prior = _prior_with_factor(prior)
    factors = []
    for number in range(int(level.max()) + 1):
        column = _factor_derivatives(structure, values, data, placement, data.loaded_states[level == number])
        extended_equations = replace(equations, design=np.column_stack([equations.design, column]))
        regression = learn(extended_equations, prior, np.arange(size + 1))
        log = float(regression.unbounded_values(extended_equations)[-1])  # the factor is the last parameter
        factors.append(
            _Factor(number, log, _jackknife_sigma(regression, extended_equations), regression.evidence - plain_evidence)
        )
    return factors


def _all_parameters(fit: Fit, data: Measurements) -> tuple[Structure, Array]:
    """Return the structure with all candidate parameters and all parameters of a fit, and their values (p,) [SI].

    Parameters that are not in the fit have their start values.
    """
    has_free_compensator = CompensatorStiffness() in fit.parameter_values
    structure, _ = full_structure(fit.structure.prior, data, fit.structure.carries_weight, has_free_compensator)
    parameters = tuple(dict.fromkeys((*structure.parameters, *fit.structure.parameters)))
    structure = replace(structure, parameters=parameters)
    values_at_start = dict(zip(parameters, structure.start_values().tolist(), strict=True))
    return structure, np.array([(values_at_start | fit.parameter_values)[parameter] for parameter in parameters])


def _prior_with_factor(prior: Prior) -> Prior:
    """Return the prior with the logarithm of a factor on loads as a further, last parameter."""
    return replace(
        prior,
        mean=np.append(prior.mean, 0.0),
        size=np.append(prior.size, _LOG_SIGMA),
        kind_index=np.append(prior.kind_index, -1),  # −1: the size is stated, without a factor
        signed=np.append(prior.signed, True),
    )


def _factor_derivatives(
    structure: Structure, values: Array, data: Measurements, placement: Placement, states: Ints
) -> Array:
    """Return the derivatives (rows,) of the whitened displacements by the logarithm of a factor on some loads.

    :param values: (p,) of the parameters of the structure, SI.
    :param states: indices of the loaded states whose loads have the factor.
    """
    wrench = data.wrench.copy()
    wrench[states] *= np.exp(_LOG_STEP)
    prediction, _ = predict(structure, values, data, placement)
    scaled_prediction, _ = predict(structure, values, replace(data, wrench=wrench), placement)
    return whiten(whitening(data), (scaled_prediction - prediction) * visible_points(data) / _LOG_STEP).ravel()


def _jackknife_sigma(regression: Regression, equations: LinearEquations) -> float:
    """Return the jackknife standard deviation of the last parameter, with one configuration left out at a time."""
    count = equations.config_count
    values = np.array([regression.unbounded_values(equations, np.array([index]))[-1] for index in range(count)])
    return float(np.sqrt((count - 1) / count * np.sum((values - values.mean()) ** 2)))
