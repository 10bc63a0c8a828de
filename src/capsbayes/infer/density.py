"""Posterior density over (log Ca, a/l), the other inputs integrated out; draws of these inputs given the shape.

The shape depends on (Ca, a/l), on the further coordinate of the model if it has
one, and on the half width l where the lengths are in metres. Viscosity mu and velocity v_o enter only through
G_s = mu v_o / (Ca r), l only through a = l (a/l). With the prior density
p(log G_s) p(a) l / v_o of `capsbayes.infer.prior` and power-law shapes
p(log G_s) ~ G_s^g, p(log a) ~ a^k inside their ranges, everything factors:

    (Ca r)^-g (a/l)^(k-1)  *  mu^g p(mu)  *  v_o^(g-1) p(v_o)  *  l^k p(l)  *  [G_s, a within their ranges]

so the inputs integrate to the probability that G_s and a lie in their ranges,
a function of one number each, whatever the distributions of the inputs are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from capsbayes.arrays import Booleans, Floats
from capsbayes.experiment import capsule_radius, mean_velocity, surface_shear_modulus
from capsbayes.infer.inputs import Inputs
from capsbayes.infer.likelihood import LengthsLikelihood, ModelAtPoints
from capsbayes.infer.log_grid import LogGrid
from capsbayes.infer.outline.table import AnyOutline
from capsbayes.infer.prior import Coordinate, Prior
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel
from capsbayes.quantity import Quantity

_ROUNDS = 13  # rounds of redrawing inputs outside the prior ranges; each round draws twice as many


@dataclass(frozen=True, eq=False)
class PosteriorDensity:
    """Posterior density of one capsule, up to a constant.

    Parameters
    ----------
    likelihood : LengthsLikelihood
    prior : Prior
    inputs : Inputs
    error_scale : float
        Factor on the standard errors of the model, one except in sensitivity studies.
    coordinate : Coordinate, optional
        Further coordinate of the model, on which the shape depends too.
    outline : OutlineLikelihood or TabulatedOutline, optional
        Replaces the likelihood of the lengths, which then only serves to find the posterior.
    """

    likelihood: LengthsLikelihood
    prior: Prior
    inputs: Inputs
    error_scale: float = 1.0
    coordinate: Coordinate | None = None
    outline: AnyOutline | None = None

    @classmethod
    def of(
        cls,
        measurement: Measurement,
        inputs: Inputs,
        prior: Prior,
        error_scale: float = 1.0,
        coordinate: Coordinate | None = None,
    ) -> PosteriorDensity:
        """Return the posterior density given a measurement."""
        return cls(LengthsLikelihood.of(measurement), prior, inputs, error_scale, coordinate)

    def evaluated(
        self,
        model: ForwardModel,
        ca: Floats,
        size: Floats,
        coordinate: Mapping[str, Floats] | None = None,
        *,
        outline: bool = True,
    ) -> ModelAtPoints:
        """Evaluate a model, Lambda included; everything is NaN outside its domain.

        Parameters
        ----------
        model : ForwardModel
        ca, size : (n,) arrays [-]
        coordinate : mapping of (n,) array, optional
            The further coordinate of the model by name.
        outline : bool
            Evaluate the log density of the outline too, which costs a hundred times as much as all else.
        """
        theta = {"capillary_number": ca, "size_ratio": size, **(coordinate or {})}
        prediction = model(theta)
        points = ModelAtPoints.of(prediction, error_scale=self.error_scale)
        if outline and self.outline is not None:
            points = points._replace(outline=self.outline.at(model, theta))
        return points

    @property
    def shape_depends_on_half_width(self) -> bool:
        """True if l is a third dimension: the lengths are in metres and l is uncertain."""
        return not (self.likelihood.over_half_width or self.inputs.half_width.known)

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
        return LogGrid.of(self.inputs.capsule_velocity, self.prior.surface_shear_modulus.power - 1)

    @cached_property
    def half_width(self) -> LogGrid:
        """l, weighted as in the factored posterior."""
        return LogGrid.of(self.inputs.half_width, self.prior.capsule_radius.power)

    @cached_property
    def force_scale(self) -> LogGrid:
        """Product mu v_o [N/m]."""
        return self.viscosity.times(self.capsule_velocity)

    def log_density(
        self, model: ModelAtPoints, log_ca: Floats, size: Floats, half_width: Floats | None = None
    ) -> Floats:
        """Return the log of the integrated posterior density over (log Ca, a/l), without the factor of `log_share`.

        Parameters
        ----------
        model : ModelAtPoints
            The model there.
        log_ca, size : arrays of one shape
        half_width : array that broadcasts with them, optional [m]
            Given where l is a dimension of its own; else its central value is used.

        Returns
        -------
        array
            NaN where the model has no answer.
        """
        log_density = model.outline
        if log_density is None:
            log_density = self.likelihood.log_density(model, self.width_at(half_width))
        if self.prior.surface_shear_modulus.power:
            log_density = log_density - log_ca - _log(model.velocity_ratio)
        if self.prior.capsule_radius.power != 1:
            log_density = log_density - np.log(size)
        return log_density

    def log_share(
        self, model: ModelAtPoints, log_ca: Floats, size: Floats, half_width: Floats | None = None
    ) -> Floats | float:
        """Return the log probability that G_s and a lie within their prior ranges, given (log Ca, a/l).

        Return 0.0 if they certainly do at every point.
        """
        divisor = log_ca + _log(model.velocity_ratio)
        share = _within(self.prior.surface_shear_modulus, self.force_scale, -divisor)
        if half_width is None:
            share = share + _within(self.prior.capsule_radius, self.half_width, np.log(size))
        else:
            radius, limits = size * half_width, self.prior.capsule_radius
            share = share + np.where((radius >= limits.low) & (radius <= limits.high), 0.0, -np.inf)
        return share

    def velocity_ratio(self, model: ModelAtPoints, half_width: Floats | None) -> tuple[Floats, Floats]:
        """Return mean and variance of the true v_o/U, which the lengths correct and the outline does not : arrays."""
        if self.outline is not None:
            return model.velocity_ratio, model.rr
        return self.likelihood.velocity_ratio(model, self.width_at(half_width))

    def completed(
        self, rng: np.random.Generator, nodes: Mapping[str, Floats], model: ModelAtPoints
    ) -> dict[str, Floats]:
        """Draw everything else for given draws of the shape.

        Parameters
        ----------
        rng : Generator
        nodes : mapping
            ``capillary_number``, ``size_ratio`` and, where they are dimensions, ``half_width`` and the further
            coordinate of the model: (n,) arrays drawn from the integrated posterior.
        model : ModelAtPoints
            The model there.

        Returns
        -------
        dict of (n,) arrays
            All quantities by name, SI.
        """
        count = len(nodes["capillary_number"])
        draws = dict(nodes)
        width = nodes.get("half_width")
        mean, variance = self.velocity_ratio(model, width)
        draws["velocity_ratio"] = mean + np.sqrt(np.maximum(variance, 0.0)) * rng.standard_normal(count)
        free = {"viscosity": self.viscosity, "capsule_velocity": self.capsule_velocity}
        if width is None:
            free["half_width"] = self.half_width
        draws |= {name: masses.drawn(rng, count) for name, masses in free.items()}
        out = np.flatnonzero(~self._in_range(draws, model))
        for tries in 2 ** np.arange(_ROUNDS):
            if not out.size:
                break
            row = np.repeat(out, tries)
            again = {name: masses.drawn(rng, row.size) for name, masses in free.items()}
            good = np.flatnonzero(
                self._in_range({name: values[row] for name, values in draws.items()} | again, model.taken(row))
            )
            found, first = np.unique(row[good], return_index=True)
            for name, values in again.items():
                draws[name][found] = values[good[first]]
            out = np.setdiff1d(out, found)
        return _derived(draws) | {
            "stretch_ratio": model.stretch_ratio,
            "axial_extent": model.extent,
            "axial_length": model.length,
        }

    def _in_range(self, draws: Mapping[str, Floats], model: ModelAtPoints) -> Booleans:
        """Return where G_s, by the mean v_o/U as in the prior, and a are within their ranges : (n,) bool array."""
        at_mean = _derived({**draws, "velocity_ratio": model.velocity_ratio})
        modulus, radius = at_mean["surface_shear_modulus"], at_mean["capsule_radius"]
        g, a = self.prior.surface_shear_modulus, self.prior.capsule_radius
        return (modulus >= g.low) & (modulus <= g.high) & (radius >= a.low) & (radius <= a.high)


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


def _within(limits: Quantity, factor: LogGrid, logs: Floats) -> Floats | float:
    """Return the log probability that exp(logs) times an independent factor is within limits; 0.0 if it surely is."""
    low, high = np.log(limits.low), np.log(limits.high)
    first, last = factor.start - factor.step, factor.end + factor.step
    if np.fmin.reduce(logs, axis=None) + first > low and np.fmax.reduce(logs, axis=None) + last < high:
        return 0.0
    with np.errstate(divide="ignore"):
        return np.log(factor.below(high - logs) - factor.below(low - logs))
