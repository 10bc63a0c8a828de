"""Posterior of the membrane of a batch: importance sampling of the membrane, the capsules integrated out at each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.spatial.distance import cdist
from scipy.special import logsumexp

from capsbayes import __version__
from capsbayes.arrays import Floats
from capsbayes.infer.checks import Gate
from capsbayes.infer.importance.proposal import Proposal
from capsbayes.infer.importance.weights import effective, normalised, pareto_shape, quasi_random, tempered
from capsbayes.infer.many.one_membrane.conditional import Capsules, Start
from capsbayes.infer.many.one_membrane.model_error import Averaged, averaged, log_density_variance
from capsbayes.infer.many.one_membrane.search import Mode, modes, starting_points
from capsbayes.infer.many.one_membrane.unknowns import Unknowns
from capsbayes.work import digest_of, run_tasks, step_task

_CLOUD, _OF_MODE = 128, 128  # points over the prior and about each mode
_FREEDOM, _WIDER = 5, 1.3
_DISTINCT, _UNLIKELY = 1.0, 12.0  # least distance of modes in standard deviations; of the log density below the best
_TRIED, _ROUNDS = 256, 6  # draws of a round
_ALIVE, _GOOD = 0.1, 0.35  # share of effective draws to which a proposal is fitted, and which ends the rounds
_ENOUGH, _MOST, _REPEATS = 600.0, 4096, 3  # effective draws, draws, new proposals while a gate fails
_LEAST_EFFECTIVE, _MOST_PARETO = 400.0, 0.7
_LEAST_WITHIN = 0.95
WITHIN = "share of the capsules that are not on the border of the model"
_WIDE = 0.3  # of the log likelihood, while the posterior is sought
_SINGULAR = 1e-3  # of the largest singular value: directions in which draws tell no slope
_AT_ONCE = 20_000  # capsules times membranes that are found together


class Found(NamedTuple):
    """The capsules at d membranes.

    Parameters
    ----------
    log_density : (d,) array
        Of the posterior with the model taken as exact, up to a constant of the batch.
    log_likelihood : (d,) array
        The part of it that the measurements have.
    variance : (d,) array
        Of the log density, by the model's own error.
    places : (d, c) array
        Of the membranes; over a distance of one the model's own error changes.
    settled : (d,) array
        Share of the capsules whose best values were found, and not on the border of the domain.
    own, common : (d, n, 2), (d, c) arrays
        The best values, see `Conditional`.
    """

    log_density: Floats
    log_likelihood: Floats
    variance: Floats
    places: Floats
    settled: Floats
    own: Floats
    common: Floats

    @classmethod
    def known(cls, values: Start) -> Found:
        """Return one of which only the values of the capsules are known."""
        one = np.zeros(1)
        return cls(one, one, one, np.zeros((1, 0)), one + 1.0, *values)


class Draws(NamedTuple):
    """Weighted draws of the membrane.

    Parameters
    ----------
    points : (d, p) array
        Coordinates of `Unknowns`.
    log_weights : (d,) array
        With the model taken as exact; -inf is a weight of zero.
    found : Found
        The capsules there.
    """

    points: Floats
    log_weights: Floats
    found: Found

    def joined(self, other: Draws) -> Draws:
        """Return these draws followed by others."""
        found = Found(*(np.concatenate(both) for both in zip(self.found, other.found, strict=True)))
        points = np.concatenate([self.points, other.points])
        return Draws(points, np.concatenate([self.log_weights, other.log_weights]), found)

    @property
    def wide(self) -> Floats:
        """Log weights of a posterior to which the measurements add only a share of their log likelihood : (d,) array.

        It holds all modes that the average over errors of the model may have.
        """
        return np.where(
            np.isfinite(self.log_weights), self.log_weights - (1.0 - _WIDE) * self.found.log_likelihood, -np.inf
        )

    @property
    def averaged(self) -> Averaged:
        """Weights averaged over errors of the model."""
        return averaged(self.log_weights, self.found.places, self.found.variance)

    @property
    def effective(self) -> float:
        """Effective number of the draws with these weights."""
        return effective(normalised(self.averaged.log_weights))


class Sampled(NamedTuple):
    """Result of the sampling.

    Parameters
    ----------
    draws : Draws
    log_weights : (d,) array
        Of the draws, averaged over errors of the model.
    log_evidence : (m,) array
        Log of the mean of the posterior density over the prior under each error of the model, up to a constant of the
        batch.
    evidence_error : float
        Its standard error.
    gates : tuple of Gate
    """

    draws: Draws
    log_weights: Floats
    log_evidence: Floats
    evidence_error: float
    gates: tuple[Gate, ...]


@dataclass(frozen=True, eq=False)
class MembraneSampling:
    """Engine for the membrane of a batch.

    Parameters
    ----------
    capsules : Capsules
    unknowns : Unknowns
    scheduler : str or None
    workers : int or None
        Where the capsules are found, see `run_tasks`.
    """

    capsules: Capsules
    unknowns: Unknowns
    scheduler: str | None = "synchronous"
    workers: int | None = None

    def __call__(self) -> Sampled:
        """Sample the posterior; there is no randomness in it but that of a fixed quasi-random sequence."""
        if not self.unknowns.dimensions:
            point = np.zeros((1, 0))
            there = self.found(point)
            return _result(Draws(point, there.log_density, there), certain=True)
        draws = self._first()
        for number in range(1, _ROUNDS + 1):
            draws = self._drawn(_fitted(draws.points, draws.wide), _TRIED, number, draws)
            if effective(normalised(draws.wide)) / _TRIED > _GOOD:
                break
        for number in range(_REPEATS + 1):
            draws = self._enough(_fitted(draws.points, draws.averaged.log_weights), draws, number)
            result = _result(draws)
            if all(gate.passed for gate in result.gates if gate.name != WITHIN):
                break
        return result

    def about(self, mode: Mode, values: Start) -> Draws:
        """Sample with few draws about a mode that is known, with the values of the capsules there."""
        if not self.unknowns.dimensions:
            point = np.zeros((1, 0))
            there = self.found(point)
            return Draws(point, there.log_density, there)
        near = Draws(mode.point[None], np.zeros(1), Found.known(values))
        points = _about(mode, _TRIED, 0)
        found = self.found(points, near)
        proposal = _fitted(points, found.log_density - _log_about(mode, points))
        return self._drawn(proposal, 2 * _TRIED, 1, near)

    def _enough(self, proposal: Proposal, near: Draws, number: int) -> Draws:
        """Draw until the effective draws are enough, or the draws the most."""
        draws = self._drawn(proposal, 2 * _TRIED, -1 - number, near)
        while draws.effective < _ENOUGH and len(draws.points) < _MOST:
            draws = draws.joined(self._drawn(proposal, len(draws.points), -1 - number, near, len(draws.points)))
        return draws

    def found(self, points: Floats, near: Draws | None = None) -> Found:
        """Find the capsules at points (d, p), each from those at the nearest of some draws if there are such."""
        start = None if near is None else _nearest(near, points)
        tasks = []
        for rows in self._parts(len(points)):
            begin = None if start is None else Start(*(values[rows] for values in start))
            key = "membrane", self.fingerprint, points[rows]
            tasks.append(step_task(Found, key, partial(_found, points[rows], begin)))
        parts = run_tasks(tasks, self.scheduler, self.workers, self.capsules, self.unknowns)
        return Found(*(np.concatenate(values) for values in zip(*parts, strict=True)))

    @cached_property
    def fingerprint(self) -> str:
        """Hash of everything that decides the result."""
        capsules, unknowns = self.capsules, self.unknowns
        priors = [(one.name, one.distribution, one.by_thickness) for one in unknowns.coordinates]
        model = capsules.model.model.sha256, capsules.model.model.view, capsules.model.half_width
        return digest_of(
            __version__, model, capsules.batch, capsules.log_viscosity, priors, dict(unknowns.known), unknowns.spreads
        )

    def _parts(self, count: int) -> Iterator[slice]:
        size = max(_AT_ONCE // len(self.capsules.batch), 1)
        yield from (slice(first, first + size) for first in range(0, count, size))

    def _first(self) -> Draws:
        """Return draws over the prior and about the modes."""
        unknowns = self.unknowns
        best = starting_points(self.capsules, unknowns)
        found = self._distinct(modes(self.capsules, unknowns, best) if unknowns.scores else [])
        count, d = _OF_MODE, unknowns.dimensions
        parts = [unknowns.wide(quasi_random(d, _CLOUD, 1))]
        parts += [_about(one, count, 2 + number) for number, one in enumerate(found)]
        points = np.concatenate(parts)
        logs = [np.log(_CLOUD / len(points)) + unknowns.log_wide(points)]
        logs += [np.log(count / len(points)) + _log_about(one, points) for one in found]
        there = self.found(points)
        return Draws(points, there.log_density - logsumexp(logs, axis=0), there)

    def _distinct(self, found: list[Mode]) -> list[Mode]:
        """Return the modes that are likely and not the same."""
        if not found:
            return []
        logs = self.found(np.array([one.point for one in found])).log_density
        kept: list[Mode] = []
        for number in np.argsort(-logs, kind="stable"):
            one = found[number]
            away = [np.linalg.solve(np.linalg.cholesky(one.covariance), one.point - other.point) for other in kept]
            if logs[number] > logs.max() - _UNLIKELY and all(np.linalg.norm(each) > _DISTINCT for each in away):
                kept.append(one)
        return kept

    def _drawn(self, proposal: Proposal, count: int, seed: int, near: Draws, after: int = 0) -> Draws:
        points = proposal.drawn(quasi_random(self.unknowns.dimensions + 2, count, seed, after))
        found = self.found(points, near)
        return Draws(points, found.log_density - proposal.log_density(points), found)


def _found(points: Floats, start: Start | None, capsules: Capsules, unknowns: Unknowns) -> Found:
    membranes = unknowns.membranes(points)
    there = capsules.at(membranes, unknowns.spreads_at(points), start=start)
    log_density = there.log_evidence + unknowns.log_prior(points)
    variance, places = log_density_variance(capsules, membranes, there.own), capsules.model.places(membranes, there.own)
    return Found(log_density, there.log_evidence, variance, places, there.settled, there.own, there.common)


def _about(mode: Mode, count: int, seed: int) -> Floats:
    """Draw points (count, p) about a mode."""
    places = quasi_random(len(mode.point) + 1, count, seed)
    normal = stats.norm.ppf(places[:, 1:]) @ np.linalg.cholesky(mode.covariance).T
    stretch = np.sqrt(_FREEDOM / stats.chi2.ppf(places[:, 0], _FREEDOM))
    return np.asarray(mode.point + _WIDER * stretch[:, None] * normal)


def _log_about(mode: Mode, points: Floats) -> Floats:
    """Return the log density of `_about` : (count,) array."""
    return np.asarray(stats.multivariate_t(mode.point, _WIDER**2 * mode.covariance, df=_FREEDOM).logpdf(points))


def _nearest(draws: Draws, points: Floats) -> Start:
    """Return the capsules as at the nearest of some draws, carried on as they change over the draws.

    Distances are measured by the spread of the draws.
    """
    possible = np.isfinite(draws.found.log_density)
    known, found = draws.points[possible], draws.found
    spread = np.std(known, axis=0)
    spread = np.where(spread > 0.0, spread, 1.0)
    nearest = np.argmin(cdist(points / spread, known / spread), axis=1)
    values = np.concatenate([found.own[possible].reshape(len(known), -1), found.common[possible]], axis=1)
    likely = tempered(draws.wide, _ALIVE * len(draws.points))[possible]
    away, change = known - likely @ known, values - likely @ values
    slope = np.linalg.lstsq(np.sqrt(likely)[:, None] * away, np.sqrt(likely)[:, None] * change, rcond=_SINGULAR)[0]
    carried = values[nearest] + (points - known[nearest]) @ slope
    own, common = np.split(carried, [carried.shape[1] - found.common.shape[1]], axis=1)
    return Start(own.reshape(len(points), *found.own.shape[1:]), common)


def _fitted(points: Floats, log_weights: Floats) -> Proposal:
    return Proposal.fitted(points, tempered(log_weights, _ALIVE * len(points)))


def _result(draws: Draws, *, certain: bool = False) -> Sampled:
    """Return the result; `certain` if nothing had to be sampled."""
    log_weights, evidence = draws.averaged
    weights = normalised(log_weights)
    count = effective(weights)
    gates = [Gate(WITHIN, float(weights @ draws.found.settled), least=_LEAST_WITHIN)]
    if not certain:
        gates += [
            Gate("effective draws", count, least=_LEAST_EFFECTIVE),
            Gate("Pareto k of the weights", pareto_shape(log_weights), most=_MOST_PARETO),
        ]
    error = float(np.sqrt(max(1.0 / count - 1.0 / len(weights), 0.0)))
    return Sampled(draws, log_weights, evidence, error, tuple(gates))
