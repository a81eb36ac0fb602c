"""Springs of a real robot: which structures the readings support, and what the readings leave open of them.

Every structure (`candidates`) is fitted with priors of physical size (`priors`, `evidence`), and predicts
configurations that it was not fitted to. The result is no single structure but their mean, weighted so that together
they predict best what they have not seen (stacking: Breiman, Machine Learning 24, 1996): one bad fold does not decide
between two that are alike, and as the model is linear in its parameters the mean is a model of the same kind. Gears
that are not linear enter only where the evidence is for them.

The posterior covariance is that within the structures and between them. What the bound is made of is wider: twice the
posterior, and the jackknife over configurations. An error of the parameters is one and the same at all places where a
robot works: of robots whose intervals hold in 95 %, one in twenty would be outside its bound at nearly all of them.
Doubled, the bound holds for nearly every robot. The jackknife adds what configurations disagree on: errors that the
readings of one state share, of which the posterior knows nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.errors import PostprocError
from postproc.frames import Array
from postproc.identification import record
from postproc.identification.candidates import AT_REST, GEARS, candidates, everything, has_compensator
from postproc.identification.displacements import measured_displacements, unwhiten, visible, whiten, whitening
from postproc.identification.evidence import Regression, learn
from postproc.identification.fit import Fit
from postproc.identification.linearised import Linearised, linearise
from postproc.identification.measurements import Measurements
from postproc.identification.observability import UNCERTAIN, is_physical
from postproc.identification.placement import Placement
from postproc.identification.prediction import predict
from postproc.identification.priors import Prior, prior_of
from postproc.identification.structure import Structure
from postproc.program import Ints
from postproc.robot import CompensatorStiffness, LinkSpring, Parameter, RobotModel

_FOLDS = 10
_LEAST_WEIGHT = 0.02
"""Structures that weigh less are left out of the mean."""
CLEAR = 3.0
"""Gain of log evidence (odds of one in twenty) that a richer model must show."""
_NOT_NARROWED = 0.9
"""Posterior over prior standard deviation of a parameter that its prior holds, not the readings."""
_ROUNDS = 3
"""Linearisations on the way to the fit of all parameters together."""


class Candidate(Struct, frozen=True):
    """A structure that was tried.

    :param name: for the user.
    :param parameters: number of parameters.
    :param active: how many of them are not zero.
    :param rms_sigma: RMS of the whitened residuals of the fit.
    :param held_out: mean square of the whitened residuals of configurations left out; 1 would be noise alone.
    :param error: standard error of the difference of `held_out` to that of the mean.
    :param weight: its share in the mean.
    :param chosen: the one that weighs most.
    """

    name: str
    parameters: int
    active: int
    rms_sigma: float
    held_out: float
    error: float
    weight: float
    chosen: bool = False

    @property
    def recorded(self) -> record.Tried:
        """The structure as `identification.json` holds it."""
        return record.Tried(
            structure=self.name,
            parameters=self.parameters,
            active=self.active,
            rms_sigma=self.rms_sigma,
            held_out_sigma2=self.held_out,
            standard_error=self.error,
            weight=self.weight,
            chosen=self.chosen,
        )


class Choice(Struct, frozen=True, eq=False):
    """The mean of structures, and how it came about.

    :param fit: the mean, with its posterior covariance.
    :param wider: (p, p) covariance of its parameters that the bound is made of.
    :param candidates: all structures tried, simple to rich.
    :param reason: one sentence.
    :param held_out: (C,) mean square whitened residual of each configuration when it was left out.
    :param left_out: (L, P, 3) measured − predicted displacement of each when its configuration was left out [m].
    :param influence: (p, rows) derivatives of the parameters by the whitened readings.
    :param determined: how many numbers the readings determine: effective degrees of freedom of the mean.
    :param held_by_prior: parameters that the readings do not narrow.
    :param evidence: log evidence of the structure with all parameters.
    """

    fit: Fit
    wider: Array
    candidates: tuple[Candidate, ...]
    reason: str
    held_out: Array
    left_out: Array
    influence: Array
    determined: float
    held_by_prior: tuple[Parameter, ...]
    evidence: float


class Member(Struct, frozen=True, eq=False):
    """A structure: its regression, and what it leaves (rows,) of configurations left out.

    `nonlinear`: its gears do not deflect in proportion to the torque.
    """

    name: str
    nonlinear: bool
    regression: Regression
    left: Array


class Mean(Struct, frozen=True, eq=False):
    """Structures and their weights (m,), which sum to one, on one set of linear equations."""

    structure: Structure
    equations: Linearised
    members: tuple[Member, ...]
    weights: Array

    @property
    def by_configuration(self) -> Array:
        """Mean squares (C,) of what the mean leaves of configurations left out."""
        left = sum(weight * member.left for weight, member in zip(self.weights, self.members, strict=True))
        return self.equations.mean_squares(np.asarray(left))

    @property
    def taken(self) -> list[tuple[float, Member]]:
        """Weights and structures that are part of the mean."""
        return [(float(w), m) for w, m in zip(self.weights, self.members, strict=True) if w > 0.0]

    def solve(self, without: Ints | None = None) -> Array:
        """Return the parameters (p,) of the mean, SI."""
        return np.asarray(sum(w * m.regression.solve(self.equations, without) for w, m in self.taken))

    def covariance(self) -> Array:
        """Return the posterior covariance (p, p), within the structures and between them, SI."""
        mean, out = self.solve(), np.zeros((len(self.structure.parameters),) * 2)
        for weight, member in self.taken:
            apart = member.regression.solve(self.equations) - mean
            out += weight * (member.regression.covariance(self.equations) + np.outer(apart, apart))
        return out

    def spread(self) -> Array:
        """Return the prior standard deviations (p,), SI; zero for parameters of no structure."""
        variance = np.zeros(len(self.structure.parameters))
        for weight, member in self.taken:
            variance[member.regression.columns] += weight * member.regression.spread**2
        return np.asarray(np.sqrt(variance))


class _Settled(Struct, frozen=True, eq=False):
    """All candidate parameters together: their kinds, prior, equations near the fit, and regression."""

    structure: Structure
    kinds: tuple[str, ...]
    prior: Prior
    equations: Linearised
    whole: Regression


def choose(robot: RobotModel, data: Measurements, placement: Placement) -> Choice:
    """Fit all structures and return the mean of them that predicts best what was left out.

    :raises PostprocError: not even joint springs can be fitted.
    """
    # where the geometry is a weightless robot's, the gears carry weights and compensator as they carry a load
    weights_matter = robot.subtract_reference and (robot.has_weight or robot.compensator is not None)
    found: list[_Settled] = []
    for in_gears in (False, True) if weights_matter else (False,):
        try:
            found.append(_settled(robot, data, placement, in_gears, compensator=False))
        except PostprocError:
            if not found and in_gears == weights_matter:
                raise
    # gears that carry the load alone are the simpler model
    best = found[-1] if found[-1].whole.evidence > found[0].whole.evidence + CLEAR else found[0]
    if has_compensator(robot, data):
        try:
            other = _settled(robot, data, placement, best.structure.in_gears, compensator=True)
            if other.whole.evidence > best.whole.evidence + CLEAR:
                choice = _chosen(_mean(other, compensator=True), other, data, placement)
                if is_physical(choice.fit) and not _open(choice):
                    return choice
        except PostprocError:
            pass
    return _chosen(_mean(best, compensator=False), best, data, placement)


def evidence_of(structure: Structure, values: Array, data: Measurements, placement: Placement) -> float:
    """Return the log evidence of a structure near some values of its parameters."""
    prior, columns = prior_of(structure), np.arange(len(structure.parameters))
    return learn(linearise(structure, values, data, placement), prior, columns).evidence


def _open(choice: Choice) -> bool:
    """Return whether the stiffness of the compensator is not determined."""
    fit, spring = choice.fit, CompensatorStiffness()
    if spring not in fit.given:
        return False
    index = fit.structure.parameters.index(spring)
    return bool(fit.ci95[index] > UNCERTAIN * fit.values[index])


def _settled(
    robot: RobotModel, data: Measurements, placement: Placement, in_gears: bool, compensator: bool
) -> _Settled:
    structure, kinds = everything(robot, data, in_gears, compensator)
    prior, values, columns = prior_of(structure), structure.start(), np.arange(len(structure.parameters))
    for _ in range(_ROUNDS):
        equations = linearise(structure, values, data, placement)
        whole = learn(equations, prior, columns)
        values = whole.solve(equations)
    return _Settled(structure, kinds, prior, equations, whole)


def _mean(settled: _Settled, compensator: bool) -> Mean:
    """Return the mean of structures that predicts best what was left out."""
    equations, kinds = settled.equations, np.array(settled.kinds)
    fold = np.random.default_rng(0).permutation(equations.configs) % min(_FOLDS, equations.configs)
    members = []
    for name, wanted in candidates(compensator):
        if not set(wanted) <= set(settled.kinds):  # this robot has none of a kind
            continue
        nonlinear = not set(wanted).isdisjoint(GEARS)
        columns = np.flatnonzero(np.isin(kinds, [*wanted, AT_REST] if nonlinear else wanted))
        regression = learn(equations, settled.prior, columns)
        members.append(Member(name, nonlinear, regression, _left_out(regression, equations, fold)))
    evidence = np.array([member.regression.evidence for member in members])
    linear = np.array([not member.nonlinear for member in members])
    among = linear if evidence.max() < evidence[linear].max() + CLEAR else np.ones(len(members), dtype=bool)
    return Mean(settled.structure, equations, tuple(members), _stacked(equations, members, np.flatnonzero(among)))


def _left_out(regression: Regression, equations: Linearised, fold: Ints) -> Array:
    """Return the residuals (rows,) of each configuration from fits to the other folds; `fold` (C,)."""
    out = np.empty(len(equations.target))
    for index in np.unique(fold):
        rows = fold[equations.config] == index
        out[rows] = equations.residual(regression.solve(equations, np.flatnonzero(fold == index)), rows)
    return out


def _stacked(equations: Linearised, members: Sequence[Member], among: Ints) -> Array:
    """Return the weights, not negative, their sum one, with which some members predict best what was left out."""
    from scipy.optimize import nnls

    left = np.array([members[index].left for index in among]) * np.sqrt(equations.weight)
    square = left @ left.T / left.shape[1]
    size = np.trace(square) / len(square)
    rows = np.linalg.cholesky(square + 1e-9 * size * np.eye(len(square))).T
    firm = np.sqrt(1e3 * size)
    found, _ = nnls(np.vstack([rows, np.full(len(rows), firm)]), np.append(np.zeros(len(rows)), firm), maxiter=1000)
    found = np.where(found > _LEAST_WEIGHT * found.sum(), found, 0.0)
    weights = np.zeros(len(members))
    weights[among] = found / found.sum()
    return weights


def _chosen(mean: Mean, settled: _Settled, data: Measurements, placement: Placement) -> Choice:
    # once more at the mean: the effect of nonlinear parameters depends on it a little
    mean = replace(mean, equations=linearise(mean.structure, mean.solve(), data, placement))
    equations, parameters = mean.equations, mean.structure.parameters
    values, posterior, spread = mean.solve(), mean.covariance(), mean.spread()
    without = np.array([mean.solve(np.array([index])) for index in range(equations.configs)])
    left = np.empty(len(equations.target))
    for index in range(equations.configs):
        rows = equations.config == index
        left[rows] = equations.residual(without[index], rows)
    apart = without - without.mean(axis=0)
    wider = 2.0 * posterior + (len(apart) - 1) / len(apart) * apart.T @ apart
    # springs of links that are zero cost a coordinate each: the remaining ones take their place
    is_link = np.array([isinstance(parameter, LinkSpring) for parameter in parameters])
    keep = np.flatnonzero((spread > 0.0) & ((values != 0.0) | ~is_link))
    onto = projection(equations, keep, spread)
    structure = replace(mean.structure, parameters=tuple(parameters[index] for index in keep))
    moved, _ = predict(structure, values[keep], data, placement)
    residual = (measured_displacements(data, placement) - moved) * visible(data)
    w = whitening(data)
    white = whiten(w, residual).ravel()
    solved = [(weight, member.regression, member.regression.solve(equations)) for weight, member in mean.taken]
    determined = float(sum(w * regression.degrees_of_freedom(equations, values) for w, regression, values in solved))
    influence = sum(w * regression.influence(equations, values) for w, regression, values in solved)
    fit = Fit(
        structure,
        values[keep],
        onto @ posterior @ onto.T,
        residual,
        float(white @ white),
        max(1, round(equations.count - determined)),
        equations.design[:, keep],
        equations.target,
    )
    held_out, table = equations.mean_squares(left), _table(mean)
    narrowed = np.sqrt(np.diag(posterior)) < _NOT_NARROWED * spread
    return Choice(
        fit,
        onto @ wider @ onto.T,
        table,
        _reason(table, float(held_out.mean())),
        held_out,
        unwhiten(w, left.reshape(len(data.loaded), len(data.points), 3)),
        onto @ influence,
        determined,
        tuple(parameters[index] for index in np.flatnonzero((spread > 0.0) & ~narrowed)),
        settled.whole.evidence,
    )


def projection(equations: Linearised, keep: Ints, spread: Array) -> Array:
    """Return (kept, p) the combination of kept parameters that best replaces each of all parameters.

    :param spread: (p,) prior standard deviations: nothing is imitated by more than the prior of what imitates it.
    """
    square = spread[keep, None] * equations.normal(np.arange(len(spread)))[0][keep]
    normal = square[:, keep] * spread[keep] + np.eye(len(keep))
    out = spread[keep, None] * np.linalg.solve(normal, square)
    out[:, keep] = np.eye(len(keep))
    return np.asarray(out)


def _table(mean: Mean) -> tuple[Candidate, ...]:
    """Return a row for each structure."""
    equations, of_mean = mean.equations, mean.by_configuration
    rows = []
    for weight, member in zip(mean.weights, mean.members, strict=True):
        squares = equations.mean_squares(member.left)
        apart, values = squares - of_mean, member.regression.solve(equations)
        rows.append(
            Candidate(
                member.name + (" with load and weights" if mean.structure.in_gears and member.nonlinear else ""),
                len(member.regression.columns),
                int(np.count_nonzero(values)),
                float(np.sqrt(np.mean(equations.residual(values) ** 2))),
                float(squares.mean()),
                float(apart.std(ddof=1) / np.sqrt(len(apart))),
                float(weight),
            )
        )
    most = int(np.argmax(mean.weights))
    return tuple(replace(row, chosen=index == most) for index, row in enumerate(rows))


def _reason(table: Sequence[Candidate], held_out: float) -> str:
    taken = sorted((row for row in table if row.weight > 0.0), key=lambda row: -row.weight)
    parts = "; ".join(f"{row.weight:.0%} {row.name}" for row in taken)
    return (
        f"chosen: {parts}: cross-validation error {held_out:.2f} σ² (noise alone: 1; joint springs alone: "
        f"{table[0].held_out:.2f} σ²)"
    )
