"""The exact engine for a model with further coordinates: importance sampling from a fitted mixture."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats, Integers
from capsbayes.experiment import Experiment
from capsbayes.infer.checks import Gate
from capsbayes.infer.density import PosteriorDensity, dilation_of
from capsbayes.infer.grid import ExactPosterior, Nodes
from capsbayes.infer.likelihood import ModelAtPoints
from capsbayes.infer.outline import outline_likelihood
from capsbayes.infer.prior import THICKNESS, Coordinate, Inputs, Marginal, Prior
from capsbayes.infer.proposal import (
    PLACE,
    Draws,
    Frame,
    Polynomial,
    Proposal,
    Sampler,
    check_thickness,
    effective,
    fitted,
    normalised,
    quasi_random,
    rows_by_weight,
    smoothed,
    weight_gates,
)
from capsbayes.infer.quadrature import UNSEEN, Quadrature, check_shape, log_density_in, with_error_of_half_width
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel
from capsbayes.quantity import Quantity
from capsbayes.status import Status

# Posterior of one capsule at weighted points, and the distributions of all quantities that follow from them


@dataclass(frozen=True, eq=False)
class WeightedPosterior(ExactPosterior):
    """Posterior of one capsule over (log Ca, a/l) and further coordinates."""

    forward: ForwardModel
    density: PosteriorDensity
    frame: Frame
    proposal: Proposal  # what the points were drawn from
    points: Floats  # (n, d): in the frame, of finite density
    log_density: Floats  # (n,): of the posterior in the frame, up to a constant
    weights: Floats  # (n,): probability of each point
    nodes: Nodes
    gates: tuple[Gate, ...]
    unresolved: ClassVar[Status] = Status.TOO_FEW_DRAWS

    @property
    def likeliest(self) -> dict[str, float]:
        """The point of largest density, each coordinate measured by its prior: its names and values."""
        best = int(np.argmax(self.log_density))
        return {name: float(values[best]) for name, values in self._theta.items() if name in self.forward.names}

    @cached_property
    def middle(self) -> dict[str, float]:
        """The one of the points that is nearest to their mean along the sheet, as `likeliest`."""
        there = self.frame.theta(self.proposal.middle(self.points, self.weights)[None])
        return {name: float(values[0]) for name, values in there.items() if name in self.forward.names}

    @cached_property
    def cut(self) -> bool:
        if self.density.prior.is_general:
            return True
        place = self.nodes.model, self.nodes.log_ca, self.nodes.size, self._theta.get("half_width")
        return bool(np.min(self.density.log_share(*place)) < -1e-6)

    def marginal(self, name: str) -> Marginal:
        return self._summary(self._theta[name]) if name in self._own else super().marginal(name)

    def log_marginal(self, name: str) -> Marginal:
        if name in self._coordinates:
            return self._summary(self._theta[name])
        return self._summary(np.log(self._theta[name])) if name in self._own else super().log_marginal(name)

    def probability_below(self, name: str, value: float) -> float:
        if name in self._own:
            return float(self.weights @ (self._theta[name] <= value))
        return super().probability_below(name, value)

    def drawn(self, rng: np.random.Generator, count: int) -> dict[str, Floats]:
        rows = self.resampled(rng, count)
        names = ("capillary_number", "size_ratio", *self._coordinates)
        width = ("half_width",) if "half_width" in self._theta else ()
        nodes = {name: self._theta[name][rows] for name in (*names, *width)}
        return self.density.completed(rng, nodes, self.nodes.model.taken(rows))

    def resampled(self, rng: np.random.Generator, count: int) -> Integers:
        """Return rows of the points, in random order, as often as their weights say : (count,) array."""
        return np.asarray(rng.permutation(rows_by_weight(self.weights, rng, count)))

    def variance_of_mean(self, name: str) -> float:
        """Return the variance of the mean of the logarithm of a quantity over the shapes and membranes."""
        logs = self._mean_logs[name]
        return float(self.weights @ (logs - self.weights @ logs) ** 2)

    def variance_given(self, coordinate: str, name: str) -> float:
        """Return the variance of the mean of the logarithm of a quantity over the values of a coordinate."""
        # The mean at given value is a cubic polynomial of its normal score under the prior, by least squares. One of a
        # known thickness adds none.
        if coordinate not in self.frame.columns:
            return 0.0
        logs = self._mean_logs[name]
        column = self.points[:, self.frame.column(coordinate)]
        away = column - self.weights @ column
        away /= np.sqrt(self.weights @ away**2)
        root = np.sqrt(self.weights)
        basis = np.stack([np.ones(len(away)), away, away**2, away**3], axis=1)
        fit = basis @ np.linalg.lstsq(root[:, None] * basis, root * logs, rcond=None)[0]
        return float(self.weights @ (fit - self.weights @ fit) ** 2)

    def variance_given_all(self, name: str) -> float:
        """Return the variance of the mean of the logarithm of a quantity over the values of all coordinates."""
        # The mean is a cubic polynomial of their normal scores, as in `variance_given`.
        scores = self.points[:, PLACE : PLACE + len(self.frame.columns)]
        fit = Polynomial.fitted(scores, self._mean_logs[name], self.weights)(scores)
        return float(self.weights @ (fit - self.weights @ fit) ** 2)

    @property
    def log_dilation(self) -> Floats | float | None:
        """Log of K = K_s / G_s at each point (n,), or of the known one; None for a model without it."""
        drawn = self._theta.get("area_dilation_modulus")
        return super().log_dilation if drawn is None else np.log(drawn)

    @property
    def _coordinates(self) -> tuple[str, ...]:
        return tuple(coordinate.name for coordinate in self.density.coordinates)

    @property
    def _own(self) -> tuple[str, ...]:
        return (*self._coordinates, THICKNESS) if self.density.by_thickness else self._coordinates

    @cached_property
    def _theta(self) -> Mapping[str, Floats]:
        return self.frame.theta(self.points)

    @cached_property
    def _mean_logs(self) -> dict[str, Floats]:
        """Means of log G_s and log a at each point, up to a constant : (n,) arrays."""
        width = self._theta.get("half_width")
        radius = np.log(self.nodes.size) + (0.0 if width is None else np.log(width))
        ratio = 0.0 if self.density.inputs.by_flow_rate else self._ratio[0]
        return {"surface_shear_modulus": -self.nodes.log_ca - ratio, "capsule_radius": radius}

    @property
    def kept(self) -> tuple[Floats, Nodes, Floats | None]:
        return self.weights, self.nodes, self._theta.get("half_width")

    @property
    def _spacing(self) -> tuple[float, float, float]:
        return 0.0, 0.0, 0.0

    def _summary(self, values: Floats) -> Marginal:
        order = np.argsort(values)
        middles = np.cumsum(self.weights[order]) - 0.5 * self.weights[order]
        mean = float(self.weights @ values)
        sd = float(np.sqrt(self.weights @ (values - mean) ** 2))
        return Marginal(mean, sd, *np.interp(Marginal.LEVELS, middles, values[order]).tolist())


# The engine: a mixture fitted to the posterior, drawn and weighted.
#
# A cloud over the whole prior is weighted by a power of the posterior that keeps enough of its points alive, a mixture
# is fitted to them and drawn from, and so on until the power is one. The draws are a quasi-random sequence, so that
# sums over them converge faster than those over random ones

_CLOUD = 2**14  # points over the prior
_TRIED = 2**12  # draws of a round
_ROUNDS = 8  # at most, of each number of draws
_GOOD = 0.25  # share of effective draws, below which rounds of more draws follow
_ALIVE = 0.1  # share of effective draws, up to which rounds go on without a gain
_GAIN = 1.15  # of the share of effective draws by a round that leads to another one
_FITS = 0.4  # share of effective draws that suffices
_SHAPES = 2**13  # draws of what the priors predict
# effective draws that are enough, first and most draws
_LENGTHS = 10_000.0, 2**13, 2**16
_ONE_COORDINATE = (40_000.0, 2**15, 2**18)  # and lengths: an end of an interval may lie on a flat tail
_OUTLINE = 15_000.0, 2**14, 2**15
_NEXT = 1_500.0, 2**12, 2**14  # from a posterior that is nearly the same
_LEAST_EFFECTIVE = 1000.0
_REPEATS = 3  # of the last draws from a proposal fitted to them, while a gate fails
_PILOTS = 2, 5  # fewest and most shapes at which the covariance of an outline is computed, one after the other
_SETTLED = 1.0  # standard deviations between pilot and centre of the posterior, up to which it suffices
_OTHERS = 31  # further shapes over which the model's own error is averaged
_NEAR = 0.02  # share of effective draws at which the first pilot is left for one in their middle
_SEARCHED = 50  # points of an outline, as many or up to twice as many, while a proposal is sought


@dataclass(frozen=True, eq=False)
class Target(Sampler):
    """The posterior of one capsule, to be drawn from in the coordinates of a frame."""

    model: ForwardModel
    frame: Frame
    density: PosteriorDensity

    @property
    def dimensions(self) -> int:
        return self.frame.dimensions

    def weighted(self, points: Floats, log_drawn: Floats, near: Draws | None = None) -> Draws:
        nodes, log_density = self.frame.evaluated(self.model, self.density, points)
        return Draws(points, log_density, log_drawn, nodes)

    def result(self, draws: Draws, proposal: Proposal) -> WeightedPosterior:
        log_weights, shape = smoothed(draws.log_weights)
        weights = normalised(log_weights)
        gates = weight_gates(draws.log_weights, shape, _LEAST_EFFECTIVE)
        kept = weights > 0.0
        known = draws.points[kept], draws.log_density[kept], weights[kept], draws.found.taken(kept), gates
        return WeightedPosterior(self.model, self.density, self.frame, proposal, *known)

    def finished(self, proposal: Proposal, numbers: tuple[float, int, int]) -> WeightedPosterior:
        """Draw and weigh; while a gate fails, fit a proposal to the draws and repeat."""
        posterior: WeightedPosterior = self.sample(proposal, numbers, [-1] * (_REPEATS + 1))
        return posterior

    def over_prior(self) -> Draws:
        """Return draws of the prior; the likelihood of an outline is left out, as it needs a pilot."""
        frame = self.frame
        points = frame.of_prior(quasi_random(frame.dimensions, _CLOUD, 0))
        # of a half width that is a dimension, the density contains the very prior that it is drawn by
        drawn = frame.log_prior(points)
        if frame.half_width is not None:
            drawn = drawn + frame.half_width.log_shape(frame.theta(points)["half_width"])
        return self.weighted(points, drawn)

    def approached(self, draws: Draws, enough: float = _FITS) -> tuple[Proposal, Draws]:
        """Return a proposal fitted to the posterior and the last draws before it, from draws that are wider."""
        # There are rounds until a share of the draws is effective that is enough. Where rounds of some draws gain no
        # more and few of them are effective, there are more draws in each.
        proposal, number = fitted(draws.points, draws.log_weights, _TRIED), 0
        for count in (_TRIED, 4 * _TRIED):
            before = 0.0
            for _ in range(_ROUNDS):
                number += 1
                draws = self.drawn(proposal, count, number)
                share = effective(normalised(draws.log_weights)) / count
                if share < _GAIN * before and before > _ALIVE:
                    break
                before = share
                proposal = fitted(draws.points, draws.log_weights, count)
                if share >= enough:
                    break
            if share > min(_GOOD, enough):
                break
        return proposal, draws

    def seen_from(self, measurement: Measurement, there: Floats, others: Floats) -> Target:
        """Return the same with the likelihood of an outline whose pilot is the shape at a point (d,)."""
        # The model's own error is averaged over this and other points (k, d): it may change much from place to place.
        assert measurement.outline is not None, "an outline"
        values = self.frame.theta(np.concatenate([there[None], others]))
        theta, *rest = (
            {name: float(column[row]) for name, column in values.items() if name in self.model.names}
            for row in range(1 + len(others))
        )
        length, scale = measurement.length_with_outline, self.density.error_scale
        pilot = outline_likelihood(self.model, measurement.outline, theta, scale, length=length, others=rest)
        return replace(self, density=replace(self.density, outline=pilot))


class ImportanceSampling:
    """Engine for many capsules of one experiment and one model with further coordinates."""

    def __init__(self, model: ForwardModel, experiment: Experiment, prior: Prior | None = None) -> None:
        self.model, self.experiment = model, experiment
        stated = (prior or Prior()).with_thickness(experiment)
        self.coordinates = Coordinate.all_of(model, stated)
        check_thickness(self.coordinates, experiment, model.domain)
        known = {each.key: each.distribution for each in self.coordinates}
        self.prior = replace(stated, coordinates=known)
        self.inputs = Inputs.of_experiment(experiment)

    def __call__(
        self,
        measurement: Measurement,
        *,
        inputs: Inputs | None = None,
        error_scale: float = 1.0,
        near: WeightedPosterior | None = None,
    ) -> WeightedPosterior:
        """Compute the posterior of one capsule."""
        inputs = inputs or self.inputs.with_velocity_of(measurement)
        density = PosteriorDensity.of(
            measurement, inputs, self.prior, error_scale, self.coordinates, dilation_of(self.model)
        )
        target = self._target(density)
        if near is not None:
            return _next_to(near, target, measurement)
        wide = target.over_prior()
        log_density_in(self.prior, with_error_of_half_width(density), wide.found, measurement.source or "prior")
        proposal, draws = target.approached(wide)
        check_shape(self.model, measurement, with_error_of_half_width(density), wide.joined(draws).found)
        if measurement.outline is None:
            return target.finished(proposal, _LENGTHS if len(self.coordinates) > 1 else _ONE_COORDINATE)
        return _of_outline(target, proposal, draws, measurement)

    def predicted_shapes(self, density: PosteriorDensity) -> tuple[ModelAtPoints, Floats]:
        """Return shapes that the priors and the velocity of a capsule predict, and the logs of their probabilities."""
        # Half of them are drawn where L_z is as measured, which the p-value of L_a is predicted from; the weights undo
        # that choice.
        inputs, rough = density.inputs.first_source, with_error_of_half_width(density)
        if density.by_thickness:
            inputs = replace(inputs, half_width=Quantity(inputs.half_width.value, unit="m"))
        extent = replace(rough, likelihood=replace(rough.likelihood, length=None), outline=None, inputs=inputs)
        unseen = replace(extent, likelihood=UNSEEN)
        target = self._target(extent)
        frame, wide = target.frame, target.over_prior()
        proposal, _ = target.approached(wide)
        tried = target.drawn(proposal, _SHAPES)
        both = wide.joined(tried)
        shares = np.log([[len(wide.points)], [len(tried.points)]])
        drawn = np.logaddexp(*(shares + np.stack([frame.log_of_prior(both.points), proposal.log_density(both.points)])))
        logs = frame.log_density(unseen, both.points, both.found) - drawn
        inside = np.isfinite(logs)
        return both.found.model.taken(inside), logs[inside]

    def _target(self, density: PosteriorDensity) -> Target:
        width = density.inputs.half_width if density.shape_depends_on_half_width else None
        frame = Frame(self.model.domain, self.coordinates, width, density.inputs.half_width.value)
        return Target(self.model, frame, density)


def _of_outline(target: Target, proposal: Proposal, draws: Draws, measurement: Measurement) -> WeightedPosterior:
    """Compute the posterior given an outline, from draws near it; its covariance is that at a pilot shape."""
    # While it is sought, some points of the outline stand for all.
    assert measurement.outline is not None, "an outline"
    every = max(1, len(measurement.outline.points) // _SEARCHED)
    sparse = replace(measurement, outline=replace(measurement.outline, points=measurement.outline.points[::every]))
    least, most = _PILOTS
    weights = normalised(draws.log_weights)
    there = proposal.middle(draws.points, weights)
    for number in range(1, most + 1):
        rough = target.seen_from(sparse, there, draws.points[_spread(weights)])
        proposal, draws = rough.approached(rough.drawn(proposal, _TRIED), _NEAR if number < least else _FITS)
        weights = normalised(draws.log_weights)
        before, there = there, proposal.middle(draws.points, weights)
        sds = np.sqrt(weights @ (draws.points - weights @ draws.points) ** 2)
        if number >= least and np.all(np.abs(there - before) <= _SETTLED * sds):
            break
    target = target.seen_from(measurement, there, draws.points[_spread(weights)])
    proposal, _ = target.approached(target.drawn(proposal, _TRIED))
    return target.finished(proposal, _OUTLINE)


def _next_to(near: WeightedPosterior, target: Target, measurement: Measurement) -> WeightedPosterior:
    """Compute a posterior that is nearly the same as another one, less precisely."""
    if measurement.outline is None:
        posterior = _reweighted(near, target)
        if all(gate.passed for gate in posterior.gates):
            return posterior
    else:
        there = near.proposal.middle(near.points, near.weights)
        target = target.seen_from(measurement, there, near.points[_spread(near.weights)])
    draws = target.drawn(near.proposal, _TRIED)
    return target.finished(fitted(draws.points, draws.log_weights, _TRIED), _NEXT)


def _reweighted(near: WeightedPosterior, target: Target) -> WeightedPosterior:
    """Return the posterior of lengths at the points of another one, where the model is known."""
    density, factor = target.density, target.density.error_scale / near.density.error_scale
    nodes = replace(near.nodes, model=near.nodes.model.rescaled(factor))
    log_density = near.frame.log_density(density, near.points, nodes, near.frame.theta(near.points).get("half_width"))
    draws = Draws(near.points, log_density, near.log_density - np.log(near.weights), nodes)
    return replace(target, frame=near.frame).result(draws, near.proposal)


def _spread(weights: Floats) -> Integers:
    """Return rows (k,) of points spread evenly over the probability."""
    shares = (np.arange(_OTHERS) + 0.5) / _OTHERS
    return np.searchsorted(np.cumsum(weights), shares * weights.sum())


# The engine whose posterior needs no chains

ExactEngine = Quadrature | ImportanceSampling


def exact_engine(model: ForwardModel, experiment: Experiment, prior: Prior | None = None) -> ExactEngine:
    """Return the grid engine, or importance sampling for a model with further coordinates."""
    prior = (prior or Prior()).with_thickness(experiment)
    engine = ImportanceSampling if model.coordinates else Quadrature
    return engine(model, experiment, prior)


def engine_near(engine: ExactEngine, posterior: ExactPosterior) -> Callable[..., ExactPosterior]:
    """Return the engine for a measurement nearly that of a posterior, from whose draws it begins if it draws."""
    if isinstance(engine, ImportanceSampling) and isinstance(posterior, WeightedPosterior):
        return functools.partial(engine, near=posterior)
    return engine
