"""Posterior density over (log Ca, a/l), the other inputs integrated out; draws of these inputs given the shape.

The shape depends on (Ca, a/l), on the further coordinates of the model if it has
such, and on the half width l where the lengths are in metres. Viscosity mu and velocity v_o enter only through
G_s = mu v_o / (Ca r), l only through a = l (a/l). With the prior density
p(log G_s) p(a) l / v_o of `capsbayes.infer.prior` and power-law shapes
p(log G_s) ~ G_s^g, p(log a) ~ a^k inside their ranges, everything factors:

    (Ca r)^-g (a/l)^(k-1)  *  mu^g p(mu)  *  v_o^(g-1) p(v_o)  *  l^k p(l)  *  [G_s, a within their ranges]

so the inputs integrate to the probability that G_s and a lie in their ranges,
a function of one number each, whatever the distributions of the inputs are.

A flow rate Q ties v_o, l and v_o/U together: Q r / (A v_o) = 1 with the area A of the cross-section. With log-normal
v_o, l and Q this is one more Gaussian factor in log r, and the inputs given the shape stay log-normal: `FlowRate`.
Where v_o was not measured, its variance is infinite: there is no such factor, U = Q / (A l^2), and v_o = U r is
predicted. The powers above are then (Ca A)^-g, Q^g p(Q) and l^(k - 2g) p(l).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import logsumexp

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.experiment import capsule_radius, mean_velocity, membrane_thickness, surface_shear_modulus
from capsbayes.infer.likelihood import FlowRate, LengthsLikelihood, ModelAtPoints, flow_mismatch, given_flow
from capsbayes.infer.log_grid import LogGrid
from capsbayes.infer.outline import AnyOutline
from capsbayes.infer.prior import THICKNESS, Coordinate, Inputs, Prior
from capsbayes.measurement import Measurement
from capsbayes.model import FixedParameters, ForwardModel
from capsbayes.quantity import Quantity

_ROUNDS = 13  # rounds of redrawing inputs outside the prior ranges; each round draws twice as many
_MOST_TRIES = 5e5  # in one round; what is left then is drawn from the cells of a grid
_CELLS_PER_SD, _NEGLIGIBLE, _AT_ONCE = 8.0, 1e-14, 20_000  # of that grid; draws
_SPACING = 0.005  # of the logs at which the density of a prior that is no range is tabulated

_Scaled = tuple[Quantity, LogGrid, Floats]


@dataclass(frozen=True, eq=False)
class PosteriorDensity:
    """Posterior density of one capsule, up to a constant."""

    likelihood: LengthsLikelihood
    prior: Prior
    inputs: Inputs
    error_scale: float = 1.0  # factor on the standard errors of the model, one except in sensitivity studies
    coordinates: tuple[Coordinate, ...] = ()  # further coordinates of the model, on which the shape depends too
    outline: AnyOutline | None = None  # in place of the lengths, which then only serve to find the posterior
    dilation: float | None = None  # K = K_s / G_s, where the model has it and it is known
    _tables: dict[Quantity, tuple[Floats, Floats]] = field(init=False, repr=False, default_factory=dict)

    @classmethod
    def of(
        cls,
        measurement: Measurement,
        inputs: Inputs,
        prior: Prior,
        error_scale: float = 1.0,
        coordinates: tuple[Coordinate, ...] = (),
        dilation: float | None = None,
    ) -> PosteriorDensity:
        """Return the posterior density given a measurement."""
        likelihood = LengthsLikelihood.of(measurement)
        return cls(likelihood, prior, inputs, error_scale, coordinates, dilation=dilation)

    def evaluated(self, model: ForwardModel, theta: Mapping[str, Floats], *, outline: bool = True) -> ModelAtPoints:
        """Evaluate a model at points that may have further names, Lambda included; NaN outside its domain."""
        names = ("capillary_number", "size_ratio", *(coordinate.name for coordinate in self.coordinates))
        theta = {name: theta[name] for name in names}
        prediction = model(theta)
        points = ModelAtPoints.of(prediction, error_scale=self.error_scale)
        if self.inputs.viscous_tension:
            points = points.at_unit_velocity()
        if outline and self.outline is not None:
            points = points._replace(outline=self.outline.at(model, theta))
        if self.flow_rate is not None:
            points = points._replace(log_area=np.log(model.relative_area(theta)))
        return points

    @property
    def shape_depends_on_half_width(self) -> bool:
        """True if l is a dimension: it is uncertain, and the lengths are in metres or a thickness is known."""
        over = self.likelihood.over_half_width and not self.by_thickness
        return not (over or self.inputs.half_width.known)

    @property
    def by_thickness(self) -> bool:
        """True if the prior of a coordinate is that of the thickness of the membrane."""
        return any(coordinate.by_thickness for coordinate in self.coordinates)

    def width_at(self, half_width: Floats | None) -> Floats | float:
        """Return the half width of a node: its own where l is a dimension, else the central value."""
        return self.inputs.half_width.value if half_width is None else half_width

    @cached_property
    def viscosity(self) -> LogGrid:
        """mu, weighted as in the factored posterior."""
        return LogGrid.of(self.inputs.viscosity, self.prior.surface_shear_modulus.power)

    @cached_property
    def capsule_velocity(self) -> LogGrid:
        """v_o, weighted as in the factored posterior."""
        if self.inputs.by_flow_rate:
            return LogGrid.known(1.0)._replace(variance=np.inf)
        return LogGrid.of(self.inputs.capsule_velocity, self.prior.surface_shear_modulus.power - 1)

    @cached_property
    def half_width(self) -> LogGrid:
        """l, weighted as in the factored posterior."""
        return LogGrid.of(self.inputs.half_width, self._width_power)

    @property
    def _width_power(self) -> int:
        through_flow = 2 * self.prior.surface_shear_modulus.power if self.inputs.by_flow_rate else 0
        return self.prior.capsule_radius.power - through_flow

    @cached_property
    def flow_rate(self) -> LogGrid | None:
        """Q, if it is given."""
        power = self.prior.surface_shear_modulus.power - 1 if self.inputs.by_flow_rate else -1
        return None if self.inputs.flow_rate is None else LogGrid.of(self.inputs.flow_rate, power)

    def flow(self, half_width: Floats | None, model: ModelAtPoints | None = None) -> FlowRate | None:
        """Return the second source of U, if there is one; the half width is given where it is a dimension."""
        if self.flow_rate is None:
            return None
        offset: Any = self.flow_rate.mean - self.capsule_velocity.mean - np.log(self.inputs.area)
        if model is not None and model.log_area is not None:
            offset = offset - model.log_area
        if half_width is not None:
            return FlowRate(
                offset - 2.0 * np.log(half_width), self.capsule_velocity.variance, 0.0, self.flow_rate.variance
            )
        variances = self.capsule_velocity.variance, self.half_width.variance, self.flow_rate.variance
        return FlowRate(offset - 2.0 * self.half_width.mean, *variances)

    @cached_property
    def force_scale(self) -> LogGrid:
        """Product mu v_o [N/m]."""
        return self.viscosity.times(self.capsule_velocity)

    def log_density(
        self, model: ModelAtPoints, log_ca: Floats, size: Floats, half_width: Floats | None = None
    ) -> Floats:
        """Return the log of the integrated posterior density over (log Ca, a/l), without the factor of `log_share`."""
        log_density = model.outline
        if log_density is None:
            log_density = self.likelihood.log_density(model, self.width_at(half_width))
        flow = self.flow(half_width, model)
        by_rate = self.inputs.by_flow_rate
        if flow is not None and not by_rate:
            mean, variance = self.velocity_ratio(model, half_width)
            mismatch, total = flow_mismatch(_log(mean), np.maximum(variance, 0.0) / mean**2, flow)
            log_density = log_density - 0.5 * (mismatch**2 / total + np.log(total))
        if self.prior.surface_shear_modulus.power:
            of_flow = (0.0 if model.log_area is None else model.log_area) if by_rate else _log(model.velocity_ratio)
            log_density = log_density - log_ca - of_flow
        if self.prior.capsule_radius.power != 1:
            log_density = log_density - np.log(size)
        return log_density

    def log_of_nodes(
        self, model: ModelAtPoints, log_ca: Floats, size: Floats, half_width: Floats | None = None
    ) -> Floats:
        """Return the log of the posterior density at nodes, without the priors of the further coordinates."""
        place = model, log_ca, size, half_width
        log_density = self.log_density(*place) + self.log_share(*place)
        if half_width is None:
            return log_density
        return log_density + self.inputs.half_width.log_shape(half_width) + self._width_power * np.log(half_width)

    def log_share(
        self, model: ModelAtPoints, log_ca: Floats, size: Floats, half_width: Floats | None = None
    ) -> Floats | float:
        """Return the log probability that G_s and a lie within their prior ranges, given (log Ca, a/l)."""
        # Return 0.0 if they certainly do at every point. Of a prior that is no range, it is the log of its mean
        # density.
        modulus, radius = self._scaled_factors(model, log_ca, size, half_width)
        if half_width is None:
            return self._log_mean_weight(*modulus) + self._log_mean_weight(*radius)
        return self._log_mean_weight(*modulus) + self.prior.capsule_radius.log_weight(size * half_width)

    def _log_mean_weight(self, prior: Quantity, factor: LogGrid, logs: Floats) -> Floats | float:
        """Return the log of the mean weight of exp(logs) times an independent factor by a prior; 0.0 if it is one."""
        # That of a prior that is no range is tabulated as far as it has been asked for.
        if prior.is_range:
            return _within(prior, factor, logs)
        tried, means = self._tables.get(prior, (np.array([np.inf, -np.inf]), np.empty(0)))
        least, most = np.nanmin(logs), np.nanmax(logs)
        if not tried[0] <= least <= most <= tried[-1]:
            tried = np.arange(min(least, tried[0]) - 0.5, max(most, tried[-1]) + 0.5, _SPACING)
            cells, masses = _cells(factor)
            means = logsumexp(prior.log_weight(np.exp(tried[:, None] + cells)) + masses, axis=1)
            self._tables[prior] = tried, means
        return np.interp(logs, tried, means)

    def _scaled_factors(
        self, model: ModelAtPoints, log_ca: Floats, size: Floats, half_width: Floats | None
    ) -> tuple[_Scaled, _Scaled]:
        """Return prior, factor of the inputs and log of the factor of the shape, of G_s and of a."""
        of_modulus, of_radius = -(log_ca + _log(model.velocity_ratio)), np.log(size)
        force, width, flow = self.force_scale, self.half_width, self.flow(half_width, model)
        if flow is not None:
            changes, variances = given_flow(_log(model.velocity_ratio), 0.0, flow)
            of_modulus, of_radius = of_modulus + changes[0], of_radius + changes[1]
            force = self.viscosity.times(LogGrid.normal(variances[0]).scaled(self.capsule_velocity.mean))
            width = LogGrid.normal(variances[1]).scaled(self.half_width.mean)
        return (self.prior.surface_shear_modulus, force, of_modulus), (self.prior.capsule_radius, width, of_radius)

    def velocity_ratio(self, model: ModelAtPoints, half_width: Floats | None) -> tuple[Floats, Floats]:
        """Return mean and variance of the true v_o/U, which the lengths correct and the outline does not : arrays."""
        if self.outline is not None:
            return model.velocity_ratio, model.rr
        return self.likelihood.velocity_ratio(model, self.width_at(half_width))

    def completed(
        self, rng: np.random.Generator, nodes: Mapping[str, Floats], model: ModelAtPoints
    ) -> dict[str, Floats]:
        """Draw everything else for given draws of the shape."""
        count = len(nodes["capillary_number"])
        draws = dict(nodes)
        width = nodes.get("half_width")
        mean, variance = self.velocity_ratio(model, width)
        draws["velocity_ratio"] = mean + np.sqrt(np.maximum(variance, 0.0)) * rng.standard_normal(count)
        free = {"viscosity": self.viscosity, "capsule_velocity": self.capsule_velocity}
        if width is None:
            free["half_width"] = self.half_width
        draws |= {name: masses.drawn(rng, count) for name, masses in free.items()}
        unconditioned = draws["velocity_ratio"]
        draws = self._given_flow(rng, draws, model, width)

        def redrawn(rows: Integers) -> dict[str, Floats]:
            again = {name: draws[name][rows] for name in ("capillary_number", "size_ratio", "half_width")}
            again |= {"velocity_ratio": unconditioned[rows]}
            again |= {name: masses.drawn(rng, rows.size) for name, masses in free.items()}
            if self.flow_rate is None:
                return again
            return self._given_flow(rng, again, model.taken(rows), None if width is None else width[rows])

        def accepted(again: Mapping[str, Floats], rows: Integers) -> Booleans:
            return self._in_range(again, self._ratio_of_prior(again, model.taken(rows)))

        outside = np.flatnonzero(~self._in_range(draws, self._ratio_of_prior(draws, model)))
        self._weigh(rng, draws, model, width, rejection_sample(draws, outside, redrawn, accepted))
        derived = _derived(draws)
        if self.by_thickness:
            derived[THICKNESS] = membrane_thickness(
                bending=derived["bending"], capsule_radius=derived["capsule_radius"]
            )
        dilation = derived.get("area_dilation_modulus", self.dilation)
        if dilation is not None:
            derived["surface_dilation_modulus"] = dilation * derived["surface_shear_modulus"]
        return derived | {
            "stretch_ratio": model.stretch_ratio,
            "axial_extent": model.extent,
            "axial_length": model.length,
        }

    def _given_flow(
        self, rng: np.random.Generator, draws: Mapping[str, Floats], model: ModelAtPoints, width: Floats | None
    ) -> dict[str, Floats]:
        """Return draws of the inputs moved to where they agree with a draw of the flow rate (Matheron's rule)."""
        flow, made = self.flow(width, model), dict(draws)
        if flow is None or self.flow_rate is None:
            return made
        mean, variance = self.velocity_ratio(model, width)
        variance = np.maximum(variance, 0.0) / mean**2
        total = flow_mismatch(np.log(mean), variance, flow)[1]
        rate = self.flow_rate.drawn(rng, len(mean))
        area = self.inputs.area * np.exp(0.0 if model.log_area is None else model.log_area) * made["half_width"] ** 2
        mismatch = np.log(rate * made["velocity_ratio"] / (area * made["capsule_velocity"]))
        pull = mismatch / total
        made["velocity_ratio"] = made["velocity_ratio"] * np.exp(-variance * pull)
        speed = mismatch if self.inputs.by_flow_rate else flow.velocity * pull
        made["capsule_velocity"] = made["capsule_velocity"] * np.exp(speed)
        if width is None:
            made["half_width"] = made["half_width"] * np.exp(2.0 * flow.half_width * pull)
        return made

    def _weigh(
        self,
        rng: np.random.Generator,
        draws: dict[str, Floats],
        model: ModelAtPoints,
        width: Floats | None,
        out: Integers,
    ) -> None:
        """Move the inputs of draws to where the priors of G_s and a hold them: all if they are no ranges, else some."""
        both = self._scaled_factors(model, np.log(draws["capillary_number"]), draws["size_ratio"], width)
        mu, force = self.viscosity.variance, both[0][1].variance
        share = mu / force if mu else 0.0
        kinds = {"viscosity": share, "capsule_velocity": 1.0 - share}, {"half_width": 1.0} if width is None else {}
        if self.inputs.by_flow_rate and width is None and force:
            kinds[0]["half_width"] = -2.0 * self.half_width.variance / force
        names = ("surface_shear_modulus", "capsule_radius")
        for of, (prior, factor, logs), shares in zip(names, both, kinds, strict=True):
            rows = out if prior.is_range else np.arange(len(logs))
            if len(factor.masses) > 1 and rows.size and shares:
                now = np.log(_derived({**draws, "velocity_ratio": self._ratio_of_prior(draws, model)})[of][rows])
                change = _drawn_within(rng, prior, factor, logs[rows]) + logs[rows] - now
                for name, part in shares.items():
                    draws[name][rows] *= np.exp(part * change)

    def _ratio_of_prior(self, draws: Mapping[str, Floats], model: ModelAtPoints) -> Floats:
        """Return the v_o/U by which draws of v_o tell G_s in its prior: the mean, unless v_o follows from the draw."""
        return draws["velocity_ratio"] if self.inputs.by_flow_rate else model.velocity_ratio

    def _in_range(self, draws: Mapping[str, Floats], velocity_ratio: Floats) -> Booleans:
        """Return where G_s, by a v_o/U, and a are within their ranges : (n,) bool array."""
        at_mean = _derived({**draws, "velocity_ratio": velocity_ratio})
        modulus, radius = at_mean["surface_shear_modulus"], at_mean["capsule_radius"]
        g, a = self.prior.surface_shear_modulus, self.prior.capsule_radius
        return (modulus >= g.low) & (modulus <= g.high) & (radius >= a.low) & (radius <= a.high)


def dilation_of(model: ForwardModel) -> float | None:
    """Return K = K_s / G_s of a model in which it is fixed, else None."""
    return model.values.get("area_dilation_modulus") if isinstance(model, FixedParameters) else None


def rejection_sample(
    draws: Mapping[str, Floats],
    rows: Integers,
    redrawn: Callable[[Integers], Mapping[str, Floats]],
    accepted: Callable[[Mapping[str, Floats], Integers], Booleans],
) -> Integers:
    """Draw some rows of draws anew in place, in each round twice as often, until accepted; return the rows left."""
    for tries in 2 ** np.arange(_ROUNDS):
        if not rows.size or rows.size * tries > _MOST_TRIES:
            break
        tried = np.repeat(rows, tries)
        again = redrawn(tried)
        good = np.flatnonzero(accepted(again, tried))
        done, first = np.unique(tried[good], return_index=True)
        for name, values in again.items():
            draws[name][done] = values[good[first]]
        rows = np.setdiff1d(rows, done, assume_unique=True)
    return rows


def _derived(draws: dict[str, Floats]) -> dict[str, Floats]:
    flow = mean_velocity(capsule_velocity=draws["capsule_velocity"], velocity_ratio=draws["velocity_ratio"])
    modulus = surface_shear_modulus(
        viscosity=draws["viscosity"], mean_velocity=flow, capillary_number=draws["capillary_number"]
    )
    radius = capsule_radius(size_ratio=draws["size_ratio"], half_width=draws["half_width"])
    return {"surface_shear_modulus": modulus, "capsule_radius": radius, "mean_velocity": flow, **draws}


def _log(values: Floats) -> Floats:
    """Return the logarithm, NaN where a model predicts a number that is not positive."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.log(values)


def _cells(factor: LogGrid) -> tuple[Floats, Floats]:
    """Return the logs of a factor at the cells of a coarser grid that carry it, and the logs of their probabilities."""
    coarse = factor.resampled(max(factor.step, np.sqrt(factor.variance) / _CELLS_PER_SD))
    kept = coarse.masses > _NEGLIGIBLE * coarse.masses.max()
    return coarse.logs[kept], np.log(coarse.masses[kept])


def _drawn_within(rng: np.random.Generator, prior: Quantity, factor: LogGrid, logs: Floats) -> Floats:
    """Return draws of the log of a factor, by its own probability times the weight of exp(logs) times the factor."""
    cells, masses = _cells(factor)
    tried = np.arange(logs.min() + cells[0] - _SPACING, logs.max() + cells[-1] + 2.0 * _SPACING, _SPACING)
    table = np.maximum(prior.log_weight(np.exp(tried)), -1e300)
    drawn = np.empty(len(logs))
    for first in range(0, len(logs), _AT_ONCE):
        rows = slice(first, first + _AT_ONCE)
        there = logs[rows, None] + cells
        weights = (prior.log_weight(np.exp(there)) if prior.is_range else np.interp(there, tried, table)) + masses
        weights -= np.maximum(weights.max(axis=1, keepdims=True), -1e300)
        below = np.cumsum(np.exp(weights), axis=1)
        below[below[:, -1] == 0.0] = 1.0  # the prior holds none of the cells: any, moved to its end below
        index = (below < rng.uniform(0.0, below[:, -1])[:, None]).sum(axis=1)
        drawn[rows] = cells[index] + (cells[1] - cells[0]) * rng.uniform(-0.5, 0.5, len(index))
    if prior.is_range:  # the last cell may lie across an end
        drawn = np.clip(drawn, np.log(prior.low) - logs, np.log(prior.high) - logs)
    return drawn


def _within(limits: Quantity, factor: LogGrid, logs: Floats) -> Floats | float:
    """Return the log probability that exp(logs) times an independent factor is within limits; 0.0 if it surely is."""
    low, high = np.log(limits.low), np.log(limits.high)
    first, last = factor.start - factor.step, factor.end + factor.step
    if np.fmin.reduce(logs, axis=None) + first > low and np.fmax.reduce(logs, axis=None) + last < high:
        return 0.0
    inside = np.maximum(factor.below(high - logs) - factor.below(low - logs), 0.0)  # rounding may say less
    with np.errstate(divide="ignore"):
        return np.log(inside)
