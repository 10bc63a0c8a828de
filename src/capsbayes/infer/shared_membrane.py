"""The membrane that the capsules of a batch share."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy import stats
from scipy.spatial.distance import cdist
from scipy.special import logsumexp, softmax
from threadpoolctl import threadpool_limits

from capsbayes import __version__
from capsbayes.arguments import checked
from capsbayes.arrays import Floats, Integers
from capsbayes.errors import InputError, NoShapeError
from capsbayes.experiment import Experiment
from capsbayes.files.output_file import write_dataset
from capsbayes.infer.checks import Gate
from capsbayes.infer.conditional import (
    COMMON,
    MODULUS,
    OWN_STEPS,
    RATE,
    SIZE,
    STEP,
    Batch,
    Capsules,
    Membranes,
    NewtonStep,
    ShapeModel,
    Start,
    Unknowns,
    batch_of,
)
from capsbayes.infer.identify import check_applies
from capsbayes.infer.log_grid import LogGrid
from capsbayes.infer.posterior import width_over_prior
from capsbayes.infer.prior import LAWS, Coordinate, Marginal, Membrane, Prior
from capsbayes.infer.proposal import (
    Draws,
    Proposal,
    Sampler,
    check_thickness,
    effective,
    fitted,
    normalised,
    quasi_random,
    rows_by_weight,
    smoothed,
    tempered,
    weight_gates,
)
from capsbayes.infer.verdict import range_leanings
from capsbayes.measurement import Measurement
from capsbayes.measurement_sets import check_comparable
from capsbayes.model import FixedParameters
from capsbayes.prediction import ERRING
from capsbayes.quantity import Quantity
from capsbayes.readable import Readable
from capsbayes.run import digest_of, keeping_steps, run_tasks, step_task
from capsbayes.status import Status
from capsbayes.surrogate import MembraneSurrogate

if TYPE_CHECKING:
    import xarray as xr


# What the model's own error makes of the posterior of a membrane.
#
# Forty outlines tell so much that an error of the model of a tenth of the noise moves their log density at a membrane
# by several units. Between membranes over which the error changes, these are different numbers: some membrane near the
# true one looks better than it is, and the posterior is narrow about it. So the posterior is averaged over what the
# error may be at each membrane: over random functions whose variance is that of the log density, and which change over
# the distance over which the model's own error does. The error of the mesh is among these where each state holds its
# own; where a factor stands for it, all membranes have it alike, and it is not

FUNCTIONS = 256  # random functions over which posteriors are averaged

_WAVES = 256  # of each function
_SEED = 5
_DEGENERATE = 1e-9  # of the largest change of the shape
_SHAPES_AT_ONCE = 1000  # capsules times membranes


class Averaged(NamedTuple):
    """Weights of d draws, averaged over random functions."""

    log_weights: Floats
    log_evidence: Floats  # (FUNCTIONS,): log of the mean weight under each function


def averaged(log_weights: Floats, places: Floats, variance: Floats) -> Averaged:
    """Average the weights of d draws over random errors of their log density."""
    if not np.ptp(places, axis=0).any():  # of one membrane there is one error
        variance = np.full(len(variance), variance[np.isfinite(log_weights)].mean())
    error = np.sqrt(variance)[:, None] * _functions(places)
    logs = log_weights[:, None] + np.where(np.isfinite(log_weights)[:, None], error, 0.0)
    evidence = logsumexp(logs, axis=0)
    return Averaged(logsumexp(logs - evidence, axis=1), evidence - np.log(len(logs)))


def _functions(places: Floats) -> Floats:
    """Return random functions at places (d, c) : (d, FUNCTIONS) array."""
    # Normal with mean 0 and variance 1; at a distance r their correlation is exp(-r^2 / 2).
    waves, sizes = _drawn_functions(places.shape[1])
    phase = places @ waves
    return np.asarray(np.concatenate([np.cos(phase), np.sin(phase)], axis=1) @ sizes)


@cache
def _drawn_functions(dimensions: int) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(_SEED)
    waves = rng.standard_normal((dimensions, _WAVES))
    return waves, rng.standard_normal((2 * _WAVES, FUNCTIONS)) / np.sqrt(_WAVES)


def log_density_variance(capsules: Capsules, membranes: Membranes, own: Floats) -> Floats:
    """Return the variance of the log density of d membranes by the model's own error : (d,) array."""
    # If e is the error of all shapes, in standard errors of what was measured, and u the noise, normal with variance 1,
    # the log density is off by e u: its variance is the mean square of e. What Ca and a/l absorb of e does not count.
    some = max(_SHAPES_AT_ONCE // own.shape[1], 1)
    parts = [slice(first, first + some) for first in range(0, len(own), some)]
    return np.concatenate(
        [_variance(capsules, {name: values[part] for name, values in membranes.items()}, own[part]) for part in parts]
    )


def _variance(capsules: Capsules, membranes: Membranes, own: Floats) -> Floats:
    """Return the variance of some membranes : (d,) array."""
    model, rows = capsules.model, capsules.batch.rows
    theta = model.theta(membranes, own)
    covariances = np.nan_to_num(model(theta).covariances, copy=False)
    covariances = covariances.reshape(*own.shape[:2], *covariances.shape[1:])
    steps = np.diag(OWN_STEPS[: own.shape[2]])
    _, slopes = model.with_slopes(theta, [model.theta(membranes, own + step) for step in steps])
    changes = np.nan_to_num(np.moveaxis(slopes.numbers, 0, -1)).reshape(*own.shape[:2], rows.shape[2], -1)
    # directions of which some may be alike, as where only a length is measured
    directions, sizes, _ = np.linalg.svd(rows @ changes, full_matrices=False)
    directions *= (sizes > _DEGENERATE * sizes[..., :1])[..., None, :]
    absorbed = rows.swapaxes(-1, -2) @ directions
    whole = np.einsum("nkl,dnkl->d", rows.swapaxes(-1, -2) @ rows, covariances)
    left = whole - np.einsum("dnka,dnka->d", absorbed, covariances @ absorbed)
    return np.asarray(np.maximum(left, 0.0))


# Where the posterior of the membrane of a batch has its modes: Gauss-Newton steps along all unknowns together

_STARTS, _BEST = 32, 4  # membranes tried, and those from which a mode is sought
_USUAL = np.log([0.2, 0.06, 0.2])  # logs of the spreads of ln G_s, of a/l and of ln alpha while modes are sought
_PILOTS = 2  # best membranes at which the model's error is read, one after the other
_STEPS, _SETTLED = 15, 1e-2
_LONGEST = 0.7  # step of a normal score
_FARTHEST = 3.0  # normal score
_HALVINGS = 4
_NARROWEST, _OF_SPREADS = np.array([0.05, 0.02, 0.05]), 0.4  # spreads at first, and standard deviation of their logs


def starting_points(capsules: Capsules, unknowns: Unknowns) -> Floats:
    """Return the best points (d, p) of some over the prior."""
    points = unknowns.wide(quasi_random(unknowns.dimensions, _STARTS, 0))
    points[:, unknowns.scores :] = _USUAL[unknowns.sought]
    tried = capsules.at(unknowns.membranes(points), unknowns.spreads_at(points), iterations=2)
    return np.asarray(points[np.argsort(-tried.log_evidence, kind="stable")[:_BEST]])


def with_model_error(capsules: Capsules, unknowns: Unknowns) -> Capsules:
    """Return the capsules with the model's own error, as it is at their best membrane, in those of the measurements."""
    # It is held there: if it changed with the membrane, membranes of which the model is sure would be preferred.
    known = capsules
    points = starting_points(capsules, unknowns) if unknowns.dimensions else np.zeros((1, 0))
    for _ in range(_PILOTS):
        tried = np.array([one.point for one in modes(known, unknowns, points)]) if unknowns.scores else points
        points = tried if len(tried) else points
        found = known.at(unknowns.membranes(points), unknowns.spreads_at(points))
        best = int(np.argmax(found.log_evidence))
        points = points[best : best + 1]
        own = found.own[best : best + 1]
        if not np.isfinite(found.log_evidence[best]):
            expected = "a membrane that gives all capsules a steady shape at some Ca and a/l of the model"
            advice = "state less of the membrane"
            raise NoShapeError("identify_membrane", "membrane", expected, "none of those that were tried", advice)
        known = capsules.with_model_error(unknowns.membranes(points), own[0])
    return known


class Mode(NamedTuple):
    """A mode (p,) and the covariance (p, p) by the curvature there."""

    point: Floats
    covariance: Floats


def modes(capsules: Capsules, unknowns: Unknowns, starts: Floats) -> list[Mode]:
    """Return the modes that Gauss-Newton steps reach from points (d, p)."""
    points, free = starts.copy(), unknowns.scores
    found = capsules.at(unknowns.membranes(points), unknowns.spreads_at(points), iterations=3)
    alive = np.isfinite(found.log_evidence)
    points, own, common = points[alive], found.own[alive], found.common[alive]
    covariance = np.zeros((len(points), free, free))
    for _ in range(_STEPS if len(points) else 0):
        step = step_of_all(capsules, unknowns, points, Start(own, common))
        covariance = step.covariance[:, COMMON:, COMMON:]
        scores = step.scores / np.maximum(np.max(np.abs(step.scores) / _LONGEST, axis=1, keepdims=True), 1.0)
        share, tried, inside = np.ones(len(points)), points, np.zeros(len(points), dtype=bool)
        for _ in range(_HALVINGS):  # a shorter step where a capsule would leave the domain
            tried = points.copy()
            tried[:, :free] = np.clip(points[:, :free] + share[:, None] * scores, -_FARTHEST, _FARTHEST)
            inside = np.all(capsules.model.contains(unknowns.membranes(tried), own), axis=1)
            if np.all(inside):
                break
            share = np.where(inside, share, 0.5 * share)
        points = np.where(inside[:, None], tried, points)
        common = common + share[:, None] * step.common
        own = capsules.moved(unknowns.membranes(points), own, share[:, None, None] * step.own)
        if np.all(step.decrease < _SETTLED):
            break
    if len(points):
        points = _with_spreads(unknowns, points, capsules, own, step.log_ratio)
    return [Mode(point, _whole(unknowns, one)) for point, one in zip(points, covariance, strict=True)]


def step_of_all(capsules: Capsules, unknowns: Unknowns, points: Floats, values: Start) -> NewtonStep:
    """Return the step towards the best membranes and capsules from points (d, p) and values of the capsules there."""
    moved = []
    for column in range(unknowns.scores):
        away = points.copy()
        away[:, column] += STEP
        moved.append(unknowns.membranes(away))
    place = unknowns.membranes(points), unknowns.spreads_at(points)
    return capsules.step(*place, *values, moved, points[:, : unknowns.scores])


def _with_spreads(unknowns: Unknowns, points: Floats, capsules: Capsules, own: Floats, log_ratio: Floats) -> Floats:
    """Return points with the spreads that the capsules have about their means."""
    moduli = capsules.log_moduli(own, log_ratio)
    spreads = np.concatenate([moduli[..., None], own[..., 1:]], axis=2).std(axis=1)
    points[:, unknowns.scores :] = np.log(np.maximum(spreads, _NARROWEST[: spreads.shape[1]]))[:, unknowns.sought]
    return points


def _whole(unknowns: Unknowns, covariance: Floats) -> Floats:
    """Return the covariance of a point, with that of the logs of spreads."""
    whole = np.zeros((unknowns.dimensions, unknowns.dimensions))
    whole[: unknowns.scores, : unknowns.scores] = covariance
    sought = np.arange(unknowns.scores, unknowns.dimensions)
    whole[sought, sought] = _OF_SPREADS**2
    return whole


# Posterior of the membrane of a batch: importance sampling of the membrane, the capsules integrated out at each

_CLOUD, _OF_MODE = 128, 128  # points over the prior and about each mode
_FREEDOM, _WIDER = 5, 1.3
_DISTINCT, _UNLIKELY = 1.0, 12.0  # least distance of modes in standard deviations; of the log density below the best
_TRIED, _ROUNDS = 256, (6, 30)  # draws of a round, rounds that suffice if its draws are alive, most rounds
_ALIVE = 0.1  # share of effective draws at which later rounds end, and along which the capsules change linearly
_RAISED = 2.0  # standard deviations of the log density by the model's own error
_GOOD = 0.35  # share of effective draws, which ends the rounds
_ENOUGH, _MOST, _REPEATS = 600.0, 4096, 3  # effective draws, draws, new proposals while a gate fails
_LEAST_EFFECTIVE = 400.0
_LEAST_WITHIN = 0.95
WITHIN = "share of the capsules that are not on the border of the model"
_WIDE = 0.3  # of the log likelihood, while the posterior is sought
_SINGULAR = 1e-3  # of the largest singular value: directions in which draws tell no slope
_AT_ONCE = 20_000  # capsules times membranes that are found together


class Found(NamedTuple):
    """The capsules at d membranes."""

    log_density: Floats  # (d,): of the posterior with the model taken as exact, up to a constant of the batch
    log_likelihood: Floats  # (d,): the part of it that the measurements have
    variance: Floats  # (d,): of the log density, by the model's own error
    places: Floats  # (d, c): of the membranes; over a distance of one the model's own error changes
    settled: Floats  # (d,): share of the capsules whose best values were found, and not on the border of the domain
    own: Floats  # (d, n, o), see `Conditional`
    common: Floats  # (d, 4)

    def joined(self, other: Found) -> Found:
        """Return those at these membranes followed by others."""
        return Found(*(np.concatenate(both) for both in zip(self, other, strict=True)))

    @property
    def likely_variance(self) -> Floats:
        """Variance of the log density, no larger than the misfit lets the model's own error be : (d,) array."""
        # If the truth is at a membrane, the misfit there exceeds that of an exact model by e^2 + 2 e u, e and u as in
        # `log_density_variance`, and in 98 % e u is above -2 |e|. The best membrane exceeds it by its own e^2 at most.
        best = np.argmax(self.log_likelihood)
        excess = self.variance[best] + 2.0 * (self.log_likelihood[best] - self.log_likelihood)
        return np.minimum(self.variance, (2.0 + np.sqrt(4.0 + excess)) ** 2)

    @classmethod
    def known(cls, values: Start) -> Found:
        """Return one of which only the values of the capsules are known."""
        one = np.zeros(1)
        return cls(one, one, one, np.zeros((1, 0)), one + 1.0, *values)


def wide_weights(draws: Draws) -> Floats:
    """Return log weights of a posterior with only a share of the log likelihood of the measurements : (d,) array."""
    # It holds all modes that the average over errors of the model may have.
    return _changed(draws, (_WIDE - 1.0) * draws.found.log_likelihood)


def _changed(draws: Draws, by: Floats) -> Floats:
    return np.where(np.isfinite(draws.log_weights), draws.log_weights + by, -np.inf)


def averaged_draws(draws: Draws) -> Averaged:
    """Return the weights of draws averaged over errors of the model."""
    return averaged(draws.log_weights, draws.found.places, draws.found.likely_variance)


class Sampled(NamedTuple):
    """Result of the sampling."""

    draws: Draws  # `found` is a `Found`
    log_weights: Floats  # (d,): of the draws, averaged over errors of the model
    log_evidence: Floats  # (FUNCTIONS,): of the mean density over the prior under each error of the model
    evidence_error: float
    gates: tuple[Gate, ...]


@dataclass(frozen=True, eq=False)
class MembraneSampling(Sampler):
    """Engine for the membrane of a batch."""

    capsules: Capsules
    unknowns: Unknowns
    scheduler: str | None = "synchronous"
    workers: int | None = None

    @property
    def dimensions(self) -> int:
        return self.unknowns.dimensions

    def __call__(self) -> Sampled:
        """Sample the posterior; there is no randomness in it but that of a fixed quasi-random sequence."""
        if not self.dimensions:
            draws = self._certain()
            return _with_gate_on_borders(Sampled(draws, *averaged_draws(draws), 0.0, ()))
        draws = self._first()
        for number in range(1, _ROUNDS[1] + 1):
            proposal = fitted(draws.points, wide_weights(draws), len(draws.points))
            draws = self.drawn(proposal, _TRIED, number, draws)
            share = effective(normalised(wide_weights(draws))) / _TRIED
            if share > (_GOOD if number < _ROUNDS[0] else _ALIVE):
                break
        proposal, seeds = self.refitted(draws, len(draws.points)), range(-1, -2 - _REPEATS, -1)
        return _with_gate_on_borders(self.sample(proposal, (_ENOUGH, 2 * _TRIED, _MOST), seeds, draws))

    def about(self, mode: Mode, values: Start) -> Draws:
        """Sample with few draws about a mode that is known, with the values of the capsules there."""
        if not self.dimensions:
            return self._certain()
        near = Draws(mode.point[None], np.zeros(1), np.zeros(1), Found.known(values))
        points = _about(mode, _TRIED, 0)
        draws = self.weighted(points, _log_about(mode, points), near)
        return self.drawn(fitted(points, draws.log_weights, _TRIED), 2 * _TRIED, 1, near)

    def weighted(self, points: Floats, log_drawn: Floats, near: Draws | None = None) -> Draws:
        found = self.found(points, near)
        return Draws(points, found.log_density, log_drawn, found)

    def log_weights(self, draws: Draws) -> Floats:
        return averaged_draws(draws).log_weights

    def refitted(self, draws: Draws, first: int) -> Proposal:
        # Where the model is unsure, some errors of it have the density so high that their share of the average rests
        # on draws there.
        raised = _changed(draws, _RAISED * np.sqrt(draws.found.likely_variance))
        return fitted(draws.points, raised, len(draws.points))

    def result(self, draws: Draws, proposal: Proposal) -> Sampled:
        log_weights, evidence = averaged_draws(draws)
        weights = normalised(log_weights)
        error = float(np.sqrt(max(1.0 / effective(weights) - 1.0 / len(weights), 0.0)))
        gates = weight_gates(log_weights, smoothed(log_weights)[1], _LEAST_EFFECTIVE)
        return Sampled(draws, log_weights, evidence, error, gates)

    def _certain(self) -> Draws:
        """Return the only draw where nothing is unknown."""
        return self.weighted(np.zeros((1, 0)), np.zeros(1))

    def found(self, points: Floats, near: Draws | None = None) -> Found:
        """Find the capsules at points (d, p), each from those at the nearest of some draws if there are such."""
        start = None if near is None else _nearest(near, points)
        tasks, size = [], max(_AT_ONCE // len(self.capsules.batch), 1)
        for first in range(0, len(points), size):
            rows = slice(first, first + size)
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

    def _first(self) -> Draws:
        """Return draws over the prior and about the modes."""
        unknowns = self.unknowns
        best = starting_points(self.capsules, unknowns)
        found = self._distinct(modes(self.capsules, unknowns, best) if unknowns.scores else [])
        count, d = _OF_MODE, self.dimensions
        parts = [unknowns.wide(quasi_random(d, _CLOUD, 1))]
        parts += [_about(one, count, 2 + number) for number, one in enumerate(found)]
        points = np.concatenate(parts)
        logs = [np.log(_CLOUD / len(points)) + unknowns.log_wide(points)]
        logs += [np.log(count / len(points)) + _log_about(one, points) for one in found]
        return self.weighted(points, logsumexp(logs, axis=0))

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


def _with_gate_on_borders(sampled: Sampled) -> Sampled:
    share = float(normalised(sampled.log_weights) @ sampled.draws.found.settled)
    return sampled._replace(gates=(Gate(WITHIN, share, least=_LEAST_WITHIN), *sampled.gates))


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
    """Return the capsules as at the nearest of some draws, carried on as they change over the draws."""
    # Distances are measured by the spread of the draws.
    possible = np.isfinite(draws.log_density)
    known, found = draws.points[possible], draws.found
    spread = np.std(known, axis=0)
    spread = np.where(spread > 0.0, spread, 1.0)
    nearest = np.argmin(cdist(points / spread, known / spread), axis=1)
    values = np.concatenate([found.own[possible].reshape(len(known), -1), found.common[possible]], axis=1)
    likely = tempered(wide_weights(draws), _ALIVE * len(draws.points))[possible]
    away, change = known - likely @ known, values - likely @ values
    slope = np.linalg.lstsq(np.sqrt(likely)[:, None] * away, np.sqrt(likely)[:, None] * change, rcond=_SINGULAR)[0]
    carried = values[nearest] + (points - known[nearest]) @ slope
    own, common = np.split(carried, [carried.shape[1] - found.common.shape[1]], axis=1)
    return Start(own.reshape(len(points), *found.own.shape[1:]), common)


# The membrane of a batch: its posterior, the capsules, and the odds of known laws

EACH = ("surface_shear_modulus", "surface_dilation_modulus", "capsule_radius", "capillary_number", "pre_inflation")
"""Quantities of each capsule: their draws, and those of what is predicted of it, are named with ``_each``."""

_POPULATION = (
    *("surface_shear_modulus", "surface_dilation_modulus", "modulus_spread"),
    *("capsule_radius", "radius_spread", "inflation_spread"),
)


@dataclass(frozen=True, eq=False)
class LawOdds:
    """What speaks for a law."""

    name: str
    probability: float  # among the laws that were tried, if all are as likely before
    over_errors: tuple[float, float]  # 5 and 95 % quantiles of it over the errors that the model may have
    log_error: float  # standard error of the logarithm of its evidence
    usable: bool  # whether its gates passed
    draws: Mapping[str, Floats]  # as of `SharedMembrane`


@dataclass(frozen=True, eq=False, repr=False)
class SharedMembrane(Readable):
    """Posterior of the membrane that the capsules of a batch share.

    Parameters
    ----------
    draws : mapping of arrays
        The parameters of the membrane by name, ``surface_shear_modulus``, ``surface_dilation_modulus`` and
        ``capsule_radius``, means of the population (of ln G_s, ln K_s and a) in SI, ``modulus_spread`` and
        ``radius_spread``, relative : (d,) arrays; and for n capsules each of `EACH` and `ERRING` with ``_each`` :
        (d, n) arrays. If the pre-inflation varies, that of the membrane is its median, and ``inflation_spread`` and
        ``pre_inflation_each`` are there too.
    names : tuple of str
        Of the capsules.
    flow : (n,) array
        Number of the flow of each capsule, slow to fast.
    speed : (n,) array [m/s]
        Mean velocity by the flow rate, or velocity of the capsule where none was given.
    lengths : (n, 2) array [l]
        L_z and L_a as measured, NaN where L_a was not.
    misfit : (n,) array
        Root mean square difference of each shape in standard errors.
    laws : tuple of LawOdds
        The general law first; empty if not asked for.
    prior : mapping of str to Quantity
        Of the parameters of the membrane that are not known.
    leaning : mapping of float
        Share of the posterior next to the ends of the model's ranges, see `capsbayes.infer.verdict`.
    experiment : Experiment
    model_name, model_sha256 : str
    seed : int
    gates : tuple of Gate
    status : Status
    refinement : mapping or None
        What was added to the model where the posterior lies, see `Refinement.as_dict`.
    """

    draws: Mapping[str, Floats]
    names: tuple[str, ...]
    flow: Integers
    speed: Floats
    lengths: Floats
    misfit: Floats
    laws: tuple[LawOdds, ...]
    prior: Mapping[str, Quantity]
    leaning: Mapping[str, float]
    experiment: Experiment
    model_name: str
    model_sha256: str
    seed: int
    gates: tuple[Gate, ...]
    status: Status
    refinement: Mapping[str, Any] | None = None

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def marginals(self) -> dict[str, Marginal]:
        """Summaries of the population and of the parameters of the membrane, by name."""
        return {name: Marginal.of_draws(self.draws[name]) for name in (*_POPULATION, *self.prior) if name in self.draws}

    def of_each(self, name: str) -> list[Marginal]:
        """Return the summaries of one of `EACH` for the capsules."""
        return [Marginal.of_draws(values) for values in self.draws[f"{name}_each"].T]

    def widths_over_prior(self) -> dict[str, float]:
        """Return the width of the 68 % interval of each parameter of the membrane over that of its prior.

        As `Posterior.widths_over_prior`.
        """
        return {name: width_over_prior(self.marginals[name], prior) for name, prior in self.prior.items()}

    def moduli_by_flow(self, draws: Mapping[str, Floats] | None = None) -> list[Marginal]:
        """Return the mean G_s [N/m] of the capsules of each flow, slow to fast: one under the right law."""
        logs = np.log((draws or self.draws)["surface_shear_modulus_each"])
        return [Marginal.of_draws(np.exp(logs[:, self.flow == k].mean(axis=1))) for k in range(self.flow.max() + 1)]

    def described(self) -> dict[str, str]:
        """Return medians and 95 % intervals in display units, and the status."""
        intervals = {name: marginal.shown(name) for name, marginal in self.marginals.items()}
        return {"capsules": str(len(self)), **intervals, "status": self.status.name}

    def as_dict(self) -> dict[str, Any]:
        """Return everything but the draws, ready for JSON."""
        each = {name: self.of_each(name) for name in EACH if f"{name}_each" in self.draws}
        return {
            "status": self.status.name,
            "sentence": str(self.status),
            "quantities": {name: marginal.as_dict() for name, marginal in self.marginals.items()},
            "widths_over_prior": self.widths_over_prior(),
            "share_next_to_border": dict(self.leaning),
            "laws": [self._of_law(law) for law in self.laws],
            "flows": [
                {
                    "speed": float(np.median(self.speed[self.flow == number])),
                    "capsules": int(np.sum(self.flow == number)),
                    "misfit": float(np.sqrt(np.mean(self.misfit[self.flow == number] ** 2))),
                    "surface_shear_modulus": marginal.as_dict(),
                }
                for number, marginal in enumerate(self.moduli_by_flow())
            ],
            "capsules": [
                {
                    "name": name,
                    "flow": int(self.flow[number]) + 1,
                    "misfit": float(self.misfit[number]),
                    **{quantity: summaries[number].as_dict() for quantity, summaries in each.items()},
                }
                for number, name in enumerate(self.names)
            ],
            "gates": [gate.as_dict() for gate in self.gates],
            "prior": {name: str(quantity) for name, quantity in self.prior.items()},
            "experiment": {name: str(text) for name, text in self.experiment.described().items()},
            "model": {"name": self.model_name, "sha256": self.model_sha256},
            **({} if self.refinement is None else {"refinement": dict(self.refinement)}),
            "seed": self.seed,
            "version": __version__,
        }

    def _of_law(self, law: LawOdds) -> dict[str, Any]:
        return {
            "name": law.name,
            "probability": law.probability,
            "probability_over_model_errors": list(law.over_errors),
            "log_error": law.log_error,
            "usable": law.usable,
            "surface_shear_modulus": Marginal.of_draws(law.draws["surface_shear_modulus"]).as_dict(),
            "by_flow": [marginal.as_dict() for marginal in self.moduli_by_flow(law.draws)],
        }

    def dataset(self) -> xr.Dataset:
        """Return draws and summary as a dataset."""
        import xarray as xr

        dims: dict[int, tuple[str, ...]] = {1: ("draw",), 2: ("draw", "capsule")}
        variables = {name: (dims[values.ndim], values) for name, values in self.draws.items()}
        capsules = {"name": list(self.names), "flow": self.flow, "speed": self.speed, "rms_misfit": self.misfit}
        along = {name: (("capsule",), values) for name, values in capsules.items()}
        return xr.Dataset({**variables, **along}, attrs={"summary": json.dumps(self.as_dict())})

    def write(self, path: str | Path) -> Path:
        """Write one NetCDF file: whole or not at all."""
        return write_dataset(Path(path), self.dataset())


# From the measurements of a batch to the membrane that its capsules share

NONE_OF_THEM = "none of them"  # the general law, beside those of `LAWS`

MISFIT = "p-value of the misfit of all shapes"

_HERE = "identify_membrane"
ONE_CAPSULE = (1e-3, 1e-4)  # spreads of ln G_s and of a/l among pictures of one capsule

_DRAWS = 1000
_DRAWS_AT_ONCE = 50  # draws whose capsules are drawn together
_NEARLY_NONE = 0.05  # of the model's errors, which a range of the probability of a law leaves out at each end
_MANY = 200  # capsules for which worker processes take less time than they need to start


@checked
def identify_membrane(
    measurements: Sequence[Measurement],
    experiment: Experiment,
    *,
    seed: int,
    model: MembraneSurrogate | None = None,
    membrane: Membrane | None = None,
    prior: Prior | None = None,
    same_capsule: bool = False,
    inflation_varies: bool = False,
    scale_error: float = 0.0,
    laws: bool = True,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Callable[[str, int, int], None] = lambda step, done, steps: None,
) -> SharedMembrane:
    """Infer the membrane that the capsules of a batch share, and the shear modulus and radius of each.

    Parameters
    ----------
    measurements : sequence of Measurement
        All with outlines, or all with lengths alone; at one flow rate or several.
    experiment : Experiment
        Channel and liquid of all.
    seed : int
        Seed of the draws of G_s, a and Ca of each capsule; stored in the result.
    model : MembraneSurrogate, optional
        Default: that which comes with the library for the channel and the view of the outlines.
    membrane : Membrane, optional
        What is known of the membrane; default: nothing.
    prior : Prior, optional
        Priors of the parameters of the membrane, by their names. Priors of G_s and a are refused, since the
        distribution of both in the batch is inferred.
    same_capsule : bool
        All measurements are of one capsule, which has one G_s and one a.
    inflation_varies : bool
        Each capsule has a pre-inflation of its own, log-normal about the median of the batch; else all have the same.
    scale_error : float
        Relative standard error that all lengths share, as from the size of a pixel.
    laws : bool
        Also compute the odds of known laws, and G_s under each. This takes three times the processor time.
    scheduler : str or None
    workers : int or None
        Where the tasks run, see `run_tasks`: one for each law if there are fewer than 200 capsules, otherwise shares of
        the capsules.
    progress : callable
        Called with the name of the work, the number of steps done, and of all.

    Returns
    -------
    SharedMembrane
        Its status tells whether the intervals can be used.

    Raises
    ------
    InputError
        If a measurement cannot be used, or the model has no membrane with which all capsules have a shape.

    References
    ----------
    Rue, Martino, Chopin 2009, J. R. Stat. Soc. B 71, 319, doi:10.1111/j.1467-9868.2008.00700.x (Laplace's method).
    Lie, Sullivan, Teckentrup 2018, SIAM/ASA J. Uncertain. Quantif. 6, 1600, doi:10.1137/18M1166523 (model error).
    """
    model = model_of(measurements, experiment, model)
    spreads = spreads_of(len(measurements), same_capsule=same_capsule, inflation_varies=inflation_varies)
    with threadpool_limits(limits=1):
        capsules = capsules_of(measurements, experiment, model, scale_error=scale_error)
        batch = capsules.batch
        unknowns = unknowns_of(model, membrane or Membrane(), prior or Prior(), experiment, spreads)
        if inflation_varies and unknowns.known.get("pre_inflation") == 0.0:
            raise InputError(_HERE, "inflation_varies", "a pre-inflation that is not 0", "0")
        capsules = with_model_error(capsules, unknowns)
        under = {NONE_OF_THEM: unknowns}
        if laws:
            free = {one.name for one in unknowns.coordinates}  # laws that what is known leaves open
            under |= {name: unknowns.fixed(fixed) for name, fixed in LAWS.items() if fixed and free.issuperset(fixed)}
        results = _under_each(under, capsules, experiment, seed, scheduler, workers, progress)
    sampled, draws = results[0]
    gates = (*sampled.gates, _misfit_gate(batch, draws["misfit"]))
    prior_of_each = {one.key: one.distribution for one in unknowns.coordinates}
    speeds = np.where(np.isnan(batch.log_mean_velocity), batch.log_velocity, batch.log_mean_velocity)
    return SharedMembrane(
        draws=draws,
        names=tuple(m.source or str(number + 1) for number, m in enumerate(measurements)),
        flow=batch.group,
        speed=np.exp(speeds),
        lengths=np.array(
            [[m.axial_extent, np.nan if m.axial_length is None else m.axial_length] for m in measurements]
        ),
        misfit=np.sqrt((np.median(draws["misfit"], axis=0) + batch.left) / np.maximum(batch.known, 1)),
        laws=with_odds([(name, *each) for name, each in zip(under, results, strict=True)]) if laws else (),
        prior=prior_of_each,
        leaning=range_leanings(draws, model.coordinates, prior_of_each),
        experiment=experiment,
        model_name=model.name,
        model_sha256=model.sha256,
        seed=seed,
        gates=gates,
        status=_status(gates),
    )


def model_of(
    measurements: Sequence[Measurement], experiment: Experiment, model: MembraneSurrogate | None
) -> MembraneSurrogate:
    """Return the model given, or that of the channel and the view; refuse measurements that it cannot hold."""
    if not measurements:
        raise InputError(_HERE, "measurements", "at least one", "none")
    for measurement in measurements:
        check_comparable(measurement, measurement.source or "measurement")
    model = model or MembraneSurrogate.open(experiment.cross_section, view=measurements[0].view)
    for measurement in measurements:
        check_applies(model, measurement, experiment)
    return model


def _under_each(
    under: Mapping[str, Unknowns],
    capsules: Capsules,
    experiment: Experiment,
    seed: int,
    scheduler: str | None,
    workers: int | None,
    progress: Callable[[str, int, int], None],
) -> list[tuple[Sampled, dict[str, Floats]]]:
    """Sample under each law: in a process each where the capsules are too few to be spread over processes."""
    few = len(capsules.batch) < _MANY
    apart = few and len(under) > 1
    inside = "synchronous" if apart or (few and scheduler is workers is None) else scheduler
    tasks = [keeping_steps(partial(_assumed, each, inside, workers, seed)) for each in under.values()]
    done = partial(progress, " and ".join(["membrane unknown", *(["known laws"] if len(under) > 1 else [])]))
    done(0, len(under))
    outside = scheduler if apart else "synchronous"
    return run_tasks(tasks, outside, workers, capsules, experiment, finished=lambda count: done(count, len(under)))


def _assumed(
    unknowns: Unknowns,
    scheduler: str | None,
    workers: int | None,
    seed: int,
    capsules: Capsules,
    experiment: Experiment,
) -> tuple[Sampled, dict[str, Floats]]:
    """Sample what is unknown, and draw the capsules."""
    sampled = MembraneSampling(capsules, unknowns, scheduler, workers)()
    return sampled, _drawn_membranes(capsules, unknowns, sampled, experiment, seed)


def spreads_of(count: int, *, same_capsule: bool, inflation_varies: bool) -> tuple[float | None, ...]:
    """Return the spreads of ln G_s, of a/l and perhaps of ln alpha, None where they are not known."""
    one = same_capsule or count == 1
    if one and inflation_varies:
        raise InputError(_HERE, "inflation_varies", "several capsules", "one")
    known = ONE_CAPSULE if one else (None, None)
    return (*known, None) if inflation_varies else known


def capsules_of(
    measurements: Sequence[Measurement], experiment: Experiment, model: MembraneSurrogate, *, scale_error: float = 0.0
) -> Capsules:
    """Return the capsules of a batch, to be found at given membranes; the model's own error is not yet in theirs."""
    batch = batch_of(measurements, experiment, model, scale_error=scale_error)
    shapes = ShapeModel(model, experiment.half_width.value, outline=measurements[0].outline is not None)
    return Capsules(batch, shapes, float(np.log(experiment.viscosity.value)))


def unknowns_of(
    model: MembraneSurrogate,
    membrane: Membrane,
    prior: Prior,
    experiment: Experiment,
    spreads: tuple[float | None, ...],
) -> Unknowns:
    """Return what is unknown of a membrane that a batch shares."""
    for name in ("surface_shear_modulus", "capsule_radius"):
        if getattr(prior, name) != getattr(Prior(), name):
            expected = "none, as the batch tells the mean of its capsules"
            raise InputError("prior", name, expected, str(getattr(prior, name)))
    fixed, believed = membrane.applied(model, prior.with_thickness(experiment))
    coordinates = Coordinate.all_of(fixed, believed)
    check_thickness(coordinates, experiment, model.domain)
    known = dict(fixed.values) if isinstance(fixed, FixedParameters) else {}
    return Unknowns.of(coordinates, known, spreads)


def _drawn_membranes(
    capsules: Capsules, unknowns: Unknowns, sampled: Sampled, experiment: Experiment, seed: int
) -> dict[str, Floats]:
    """Draw membranes by their weights, and at each of them the capsules : (d,) and (d, n) arrays by name."""
    rng = np.random.default_rng([seed, 7])
    weights = normalised(sampled.log_weights)
    rows = rows_by_weight(weights, rng, _DRAWS)
    points, found = sampled.draws.points[rows], sampled.draws.found
    parts = []
    for first in range(0, _DRAWS, _DRAWS_AT_ONCE):
        some = slice(first, first + _DRAWS_AT_ONCE)
        start = Start(found.own[rows[some]], found.common[rows[some]])
        place = unknowns.membranes(points[some]), unknowns.spreads_at(points[some])
        parts.append(capsules.at(*place, start=start, rng=rng))
    own, common = (np.concatenate([getattr(part, name) for part in parts]) for name in ("own", "common"))
    spreads, membranes = unknowns.spreads_at(points), unknowns.membranes(points)
    seen = _seen(capsules, membranes, own)
    log_moduli = drawn_log_moduli(capsules, own, np.log(seen["velocity_ratio_each"]), common, spreads.modulus, rng)
    viscosity = LogGrid.of(experiment.viscosity).drawn(rng, _DRAWS) / experiment.viscosity.value
    width = LogGrid.of(experiment.half_width).drawn(rng, _DRAWS)
    varying = {}
    if spreads.inflation is not None:
        each = membranes["pre_inflation"][:, None] * np.exp(own[..., 2])
        varying = {"inflation_spread": spreads.inflation, "pre_inflation_each": each}
    modulus, moduli = np.exp(common[:, MODULUS]) * viscosity, np.exp(log_moduli) * viscosity[:, None]
    dilation = membranes["area_dilation_modulus"]
    return {
        **membranes,
        **varying,
        "surface_shear_modulus": modulus,
        "surface_dilation_modulus": dilation * modulus,
        "capsule_radius": common[:, SIZE] * width,
        "modulus_spread": spreads.modulus,
        "radius_spread": spreads.size / common[:, SIZE],
        "surface_shear_modulus_each": moduli,
        "surface_dilation_modulus_each": dilation[:, None] * moduli,
        "capsule_radius_each": own[..., 1] * width[:, None],
        **seen,
        "misfit": capsules.misfit(membranes, Start(own, common)),
    }


def _seen(capsules: Capsules, membranes: Mapping[str, Floats], own: Floats) -> dict[str, Floats]:
    """Return Ca of the capsules, and what is predicted of them : (d, n) arrays."""
    theta = capsules.model.theta(membranes, own)
    predicted = capsules.model.model(theta)
    flat = {name: getattr(predicted, name) for name in ERRING} | {"capillary_number": theta["capillary_number"]}
    return {f"{name}_each": values.reshape(own.shape[:2]) for name, values in flat.items()}


def drawn_log_moduli(
    capsules: Capsules, own: Floats, log_ratio: Floats, common: Floats, spread: Floats, rng: np.random.Generator
) -> Floats:
    """Draw ln G_s of each capsule at central viscosity : (d, n) array; its velocity and the population both tell it."""
    batch = capsules.batch
    seen = capsules.log_moduli(own, log_ratio)
    by_rate = np.isfinite(batch.log_mean_velocity)
    seen = seen + by_rate * batch.rate_error * common[:, RATE, None]
    variance = np.where(by_rate, 0.0, batch.velocity_error**2)
    share = variance / (variance + spread[:, None] ** 2)
    middle = (1.0 - share) * seen + share * common[:, MODULUS, None]
    return np.asarray(middle + np.sqrt(share) * spread[:, None] * rng.standard_normal(seen.shape))


def with_odds(assumed: list[tuple[str, Sampled, dict[str, Floats]]]) -> tuple[LawOdds, ...]:
    """Return the laws with their probabilities, from what was sampled under each."""
    logs = np.array([sampled.log_evidence for _, sampled, _ in assumed])
    under_each_error = softmax(logs, axis=0)
    return tuple(
        LawOdds(
            name=name,
            probability=float(shares.mean()),
            over_errors=(float(np.quantile(shares, _NEARLY_NONE)), float(np.quantile(shares, 1.0 - _NEARLY_NONE))),
            log_error=sampled.evidence_error,
            usable=all(gate.passed for gate in sampled.gates),
            draws=draws,
        )
        for (name, sampled, draws), shares in zip(assumed, under_each_error, strict=True)
    )


def _misfit_gate(batch: Batch, misfit: Floats) -> Gate:
    """Return the gate on the probability of a larger misfit of all shapes together."""
    # That of what was measured is compared with that of measurements drawn at the same draws of the posterior, which is
    # chi squared with all the numbers measured: where the model is right, the probability is seldom small.
    square = misfit.sum(axis=1) + batch.left.sum()
    return Gate.of_p_value(MISFIT, float(stats.chi2.sf(square, int(batch.known.sum())).mean()))


def _status(gates: Sequence[Gate]) -> Status:
    failed = {gate.name for gate in gates if not gate.passed}
    if not failed:
        return Status.DONE
    if failed == {MISFIT}:
        return Status.SHAPES_MISFIT
    return Status.LEANS_ON_BORDER if failed == {WITHIN} else Status.TOO_FEW_DRAWS
