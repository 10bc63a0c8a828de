"""Draws of the posterior of a population: importance sampling from a t distribution about its mode."""

from __future__ import annotations

import numpy as np
from scipy import optimize, stats

from capsbayes.arrays import Floats
from capsbayes.infer.checks import Gate
from capsbayes.infer.importance.weights import effective, normalised, rows_by_weight, smoothed
from capsbayes.infer.many.distribution.log_posterior import SLOPES, LogPosterior
from capsbayes.infer.many.distribution.tails import NORMAL

_DRAWS, _KEPT, _FEWEST_DRAWS = 4000, 4000, 800
_DRAWS_OF_TAILS = 1000  # each costs twenty-five times as much
_BUDGET = 1e9  # Gaussians that are evaluated for the draws: some ten seconds
_STEP = 1e-3  # of the parameters, for derivatives
_TOLERANCE = 1e-18  # of the log density, still to be gained at the mode: 1e-9 of its widths
_POLISHED = 12  # steps at most that refine it
_ROUNDS = 8
_FEW = 0.1  # share of effective draws to which the proposal is fitted
_FREEDOM = 8  # of the t distribution that is drawn from
_LEAST_ESS, _MOST_PARETO = 400.0, 0.7


def drawn(
    log_posterior: LogPosterior, place: tuple[Floats, Floats], rng: np.random.Generator
) -> tuple[Floats, list[Gate]]:
    """Draw from a posterior; return the draws (d, p) and the gates on their weights.

    `place` is that of its mode, with the covariance there. Where the weights fail their gates, the proposal is fitted
    to the weighted draws and drawn from again; to draws whose weights are raised to a power below one if few of them
    have all the weight.
    """
    most = _DRAWS if log_posterior.tails == NORMAL else _DRAWS_OF_TAILS
    count = int(np.clip(_BUDGET / log_posterior.size, _FEWEST_DRAWS, most))
    centre, covariance = place
    for _ in range(_ROUNDS):
        tried = _drawn_from_t(centre, covariance, rng, count)
        proposal = stats.multivariate_t(centre, covariance, df=_FREEDOM)
        tailed, pareto = smoothed(log_posterior(tried) - proposal.logpdf(tried))
        weights = normalised(tailed)
        gates = [
            Gate("effective draws of the population", effective(weights), least=_LEAST_ESS),
            Gate("Pareto k of the weights", pareto, most=_MOST_PARETO),
        ]
        if all(gate.passed for gate in gates):
            break
        tempered, power = weights, 1.0
        while effective(tempered) < _FEW * count:
            power *= 0.7
            tempered = normalised(power * tailed)
        centre, covariance = tempered @ tried, np.cov(tried.T, aweights=tempered)
    return tried[rows_by_weight(weights, rng, _KEPT)], gates


def _drawn_from_t(centre: Floats, covariance: Floats, rng: np.random.Generator, count: int) -> Floats:
    """Draw from the proposal : (count, p) array. SciPy draws along eigenvectors, whose signs depend on the kernel."""
    normal = rng.standard_normal((count, len(centre))) @ np.linalg.cholesky(covariance).T
    return np.asarray(centre + normal / np.sqrt(rng.chisquare(_FREEDOM, (count, 1)) / _FREEDOM))


def mode(log_posterior: LogPosterior, start: Floats | None = None) -> tuple[Floats, Floats]:
    """Find the mode and the covariance by the curvature there : (p,), (p, p) arrays."""
    steps = np.eye(len(log_posterior.names)) * _STEP

    def downhill(place: Floats) -> tuple[float, Floats]:
        values = log_posterior(np.concatenate([place[None], place + steps, place - steps]))
        ahead, behind = np.split(values[1:], 2)
        return -float(values[0]), (behind - ahead) / (2.0 * _STEP)

    def curvature(place: Floats) -> Floats:
        rows = [(downhill(place + step)[1] - downhill(place - step)[1]) / (2.0 * _STEP) for step in steps]
        values, axes = np.linalg.eigh(0.5 * (np.array(rows) + np.transpose(rows)))
        # where the data do not constrain a direction, as a slope without a spread of sizes, the prior does
        return np.asarray((axes * np.maximum(values, 1.0 / SLOPES**2)) @ axes.T)

    start = log_posterior.start if start is None else start
    found = np.asarray(optimize.minimize(downhill, start, jac=True, method="BFGS", options={"gtol": 1e-3}).x)
    bend = curvature(found)
    for _ in range(_POLISHED):  # where BFGS ends, the last digits decide
        slope = downhill(found)[1]
        step = -np.linalg.solve(bend, slope)
        if -slope @ step < _TOLERANCE:
            break
        found = found + step
    return found, np.asarray(np.linalg.inv(curvature(found)))
