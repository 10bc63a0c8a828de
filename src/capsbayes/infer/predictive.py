"""What a posterior and its prior predict of a measurement, and the log-likelihood of what was measured, for ArviZ.

The prior of the mean velocity has no limits, so that nothing can be drawn from it alone: the prior here is that given
the measured velocity (or the viscous tension), as in `capsbayes.infer.verdict`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, bending, capsule_radius, mean_velocity, surface_shear_modulus
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.importance import exact_engine
from capsbayes.infer.likelihood import ModelAtPoints
from capsbayes.infer.prior import THICKNESS, Coordinate, Inputs, Prior
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel

_CANDIDATES, _PRIOR_DRAWS = 50_000, 2000
_FEWEST = 200  # effective candidates
_LOG_ROOT = 0.5 * np.log(2.0 * np.pi)


@dataclass(frozen=True, eq=False)
class Predictive:
    """Predictions of one capsule; nothing is computed before it is asked for."""

    draws: Mapping[str, Floats]  # (chain, draw) arrays, SI
    measurement: Measurement
    experiment: Experiment
    prior: Prior
    inputs: Inputs
    model: ForwardModel
    seed: int

    def groups(self) -> dict[str, dict[str, Floats]]:
        """Return variables by name, for each group of ArviZ : (chain, draw) arrays, of the prior (1, draw) arrays."""
        shape = next(iter(self.draws.values())).shape
        before = self._prior_draws
        found = {
            "posterior_predictive": self._repeated(self._flat, self._points, 1),
            "log_likelihood": self._log_likelihood(),
            "sample_stats": {"lp": self._log_posterior()},
        }
        made = {group: {name: values.reshape(shape) for name, values in of.items()} for group, of in found.items()}
        predicted = self._repeated(before, self._at(before), 2)
        made["prior"] = {name: values[None] for name, values in before.items()}
        made["prior_predictive"] = {name: values[None] for name, values in predicted.items()}
        return made

    @cached_property
    def _flat(self) -> dict[str, Floats]:
        return {name: np.ravel(values) for name, values in self.draws.items()}

    @cached_property
    def _density(self) -> PosteriorDensity:
        return exact_engine(self.model, self.experiment, self.prior)(self.measurement).density

    @cached_property
    def _points(self) -> ModelAtPoints:
        return self._density.evaluated(self.model, self._flat)

    def _at(self, draws: Mapping[str, Floats]) -> ModelAtPoints:
        names = ("capillary_number", "size_ratio", *self.model.coordinates)
        return ModelAtPoints.of(self.model({name: draws[name] for name in names}))

    def _repeated(self, draws: Mapping[str, Floats], points: ModelAtPoints, stream: int) -> dict[str, Floats]:
        """Return measurements that might have been made of capsules with these parameters."""
        rng, seen = np.random.default_rng([self.seed, 5, stream]), self.measurement
        width = 1.0 if seen.over_half_width else draws["half_width"]
        own, stated = np.array([[points.zz, points.za], [points.za, points.aa]]), np.zeros((2, 2))
        k = len(seen.lengths)
        stated[:k, :k] = seen.covariance
        total = np.moveaxis(own * width**2, -1, 0) + stated
        root = np.linalg.cholesky(total + 1e-14 * np.trace(total, axis1=1, axis2=2)[:, None, None] * np.eye(2))
        noise = np.einsum("nij,nj->ni", root, rng.standard_normal((len(total), 2)))
        made = {"axial_extent": points.extent * width + noise[:, 0]}
        if k == 2:
            made["axial_length"] = points.length * width + noise[:, 1]
        if seen.capsule_velocity is not None and not self.inputs.viscous_tension:
            velocity = draws["capsule_velocity"]
            made["capsule_velocity"] = velocity + seen.capsule_velocity_error * rng.standard_normal(len(velocity))
        if seen.flow_rate is not None:
            error = seen.flow_rate_error or 0.0
            made["flow_rate"] = self._flow_rate(draws) + error * rng.standard_normal(len(noise))
        return made

    def _flow_rate(self, draws: Mapping[str, Floats]) -> Floats:
        area = self.inputs.area * self.model.relative_area(draws)
        return np.asarray(draws["mean_velocity"] * draws["half_width"] ** 2 * area)

    def _log_likelihood(self) -> dict[str, Floats]:
        """Return the log density of each part of the measurement; the lengths are one, as their errors correlate."""
        seen, draws, density = self.measurement, self._flat, self._density
        if self._points.outline is not None:
            found = {"outline": self._points.outline}
        else:
            width = 1.0 if seen.over_half_width else draws["half_width"]
            found = {"lengths": density.likelihood.log_density(self._points, width) - len(seen.lengths) * _LOG_ROOT}
        if seen.capsule_velocity is not None and not self.inputs.viscous_tension:
            velocity = draws["capsule_velocity"]
            found["capsule_velocity"] = _log_normal(seen.capsule_velocity, velocity, seen.capsule_velocity_error)
        if seen.flow_rate is not None and seen.flow_rate_error:
            found["flow_rate"] = _log_normal(seen.flow_rate, self._flow_rate(draws), seen.flow_rate_error)
        return found

    def _log_posterior(self) -> Floats:
        """Return the log of the posterior density, up to a constant, over log Ca, a/l and further coordinates."""
        density, draws = self._density, self._flat
        width = draws["half_width"] if density.shape_depends_on_half_width else None
        place = self._points, np.log(draws["capillary_number"]), draws["size_ratio"], width
        of_prior = [coordinate.log_density(draws[coordinate.key]) for coordinate in density.coordinates]
        return np.asarray(density.log_of_nodes(*place) + np.sum(of_prior, axis=0))

    @cached_property
    def _prior_draws(self) -> dict[str, Floats]:
        """Draw from the priors, given the velocity, within the domain of the model, by importance resampling."""
        rng, inputs = np.random.default_rng([self.seed, 4]), self.inputs
        (low, high), sizes = self.model.domain.bounds
        draws = {
            "capillary_number": np.exp(rng.uniform(np.log(low), np.log(high), _CANDIDATES)),
            "size_ratio": rng.uniform(*sizes, _CANDIDATES),
            "half_width": inputs.half_width.drawn(rng, _CANDIDATES),
            "viscosity": inputs.viscosity.drawn(rng, _CANDIDATES),
        }
        draws["capsule_radius"] = capsule_radius(size_ratio=draws["size_ratio"], half_width=draws["half_width"])
        self._draw_coordinates(draws, rng)
        points = self._at(draws)
        ratio = np.ones(_CANDIDATES) if inputs.viscous_tension else points.velocity_ratio
        if inputs.flow_rate is not None and inputs.by_flow_rate:
            area = inputs.area * self.model.relative_area(draws) * draws["half_width"] ** 2
            draws["capsule_velocity"] = inputs.flow_rate.drawn(rng, _CANDIDATES) * ratio / area
        else:
            draws["capsule_velocity"] = inputs.capsule_velocity.drawn(rng, _CANDIDATES)
        with np.errstate(invalid="ignore"):
            draws["mean_velocity"] = mean_velocity(capsule_velocity=draws["capsule_velocity"], velocity_ratio=ratio)
            draws["surface_shear_modulus"] = surface_shear_modulus(
                **{name: draws[name] for name in ("viscosity", "mean_velocity", "capillary_number")}
            )
            logs = self._log_weight(draws)
        weights = np.where(np.isfinite(logs) & np.isfinite(points.extent), np.exp(logs - np.nanmax(logs)), 0.0)
        if weights.sum() ** 2 < _FEWEST * np.sum(weights**2):
            raise InputError("prior", "", "a prior that covers some of the domain of the model", "one that hardly does")
        chosen = rng.choice(_CANDIDATES, _PRIOR_DRAWS, p=weights / weights.sum())
        draws |= {"velocity_ratio": ratio, "stretch_ratio": points.stretch_ratio}
        return {name: values[chosen] for name, values in draws.items()}

    def _draw_coordinates(self, draws: dict[str, Floats], rng: np.random.Generator) -> None:
        for coordinate in Coordinate.all_of(self.model, self.prior):
            values = coordinate.values(rng.uniform(size=_CANDIDATES))
            if coordinate.by_thickness:
                draws[THICKNESS] = values
                values = bending(membrane_thickness=values, capsule_radius=draws["capsule_radius"])
                values = np.where((values >= coordinate.low) & (values <= coordinate.high), values, np.nan)
            draws[coordinate.name] = values

    def _log_weight(self, draws: Mapping[str, Floats]) -> Floats:
        """Return the log of p(log G_s) p(a) l / v_o, see `capsbayes.infer.prior`, over the density proposed."""
        total = np.log(draws["half_width"])
        if not self.inputs.by_flow_rate:  # then v_o is not a coordinate
            total = total - np.log(draws["capsule_velocity"])
        for name, less in (("surface_shear_modulus", 0), ("capsule_radius", 1)):
            prior = getattr(self.prior, name)
            total = total + prior.log_weight(draws[name]) + (prior.power - less) * np.log(draws[name])
        return np.asarray(total)


def _log_normal(value: float, mean: Floats, sd: float) -> Floats:
    return np.asarray(-0.5 * ((value - mean) / sd) ** 2 - np.log(sd) - _LOG_ROOT)
