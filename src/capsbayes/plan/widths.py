"""Expected width of the posterior of a capsule before it is measured.

A width depends on the noise of the measurement: next to a snap-through,
and where the posterior is wide, that of the measurement without noise is off
by a third and more. So it is averaged over the noise, on a Fibonacci lattice
of measurements: that of N points integrates a smooth function of the two
lengths as well as many more drawn at random.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, fields

import numpy as np
from scipy.special import ndtri

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, imposed_velocity
from capsbayes.infer.grid.posterior import GridPosterior
from capsbayes.infer.grid.quadrature import Quadrature
from capsbayes.infer.prior import Prior
from capsbayes.infer.verdict import leaning
from capsbayes.model import ForwardModel
from capsbayes.plan.lab_errors import LabErrors, root_of
from capsbayes.work import step_of

NOISES = 13
"""Number of measurements that a width is averaged over."""

_DRAWS = 500  # of a posterior, for its share next to the border


@dataclass(frozen=True)
class Width:
    """Width of one posterior, or the mean of those of several."""

    relative: float = np.nan  # half of the 68 % interval of G_s over its median
    sd: float = np.nan  # standard deviation of log G_s
    relative_radius: float = np.nan  # half of the 68 % interval of a over its median
    noise_free: float = np.nan  # as `relative`, of the measurement without noise
    leaning: float = np.nan  # share of that posterior next to the border of the model, as in `identify`

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of the fields."""
        return tuple(field.name for field in fields(cls))


class WidthPredictor:
    """Predictor of widths for one lab, by a model of (Ca, a/l) alone."""

    # A width is averaged over so many `noises`, zero for the measurement without noise alone. G_s [N/m] is by default
    # the middle of its prior range: only priors that cut into a posterior see it.

    def __init__(
        self,
        model: ForwardModel,
        experiment: Experiment,
        errors: LabErrors,
        *,
        prior: Prior | None = None,
        surface_shear_modulus: float | None = None,
        noises: int = NOISES,
    ) -> None:
        check_model(model, experiment)
        self.model, self.errors, self.experiment = model, errors, experiment
        self.engine = Quadrature(model, experiment, prior)
        within = self.engine.prior.surface_shear_modulus
        middle = np.sqrt(within.low * within.high) if within.is_range else within.ppf(0.5)
        self.modulus = surface_shear_modulus or float(middle)
        self.lattice = noise_lattice(noises)

    def at(self, capillary_number: float, size_ratio: float) -> Width:
        """Predict the width at one point; all NaN outside the model's domain."""
        lab = self.model, self.experiment, self.errors, self.engine.prior, self.modulus, self.lattice
        place = capillary_number, size_ratio
        return step_of(Width, ("width", *lab, *place), lambda: self._at(*place))

    def _at(self, capillary_number: float, size_ratio: float) -> Width:
        theta = {"capillary_number": np.array([capillary_number]), "size_ratio": np.array([size_ratio])}
        there = self.model(theta)
        if not there.inside[0]:
            return Width()
        flow = imposed_velocity(
            viscosity=self.engine.inputs.viscosity.value,
            capillary_number=capillary_number,
            surface_shear_modulus=self.modulus,
        )
        velocity = float(there.velocity_ratio[0] * flow)
        lengths, root = self._lengths(there.values[0, :2], there.covariance[0, :2, :2])
        plain = self._posterior(lengths, velocity)
        if plain is None:
            return Width()
        first = width_of(plain)
        found = [width_of(posterior) for posterior in self._noisy(lengths + self.lattice @ root.T, velocity)] or [first]
        return Width(
            relative=float(np.mean([width.relative for width in found])),
            sd=float(np.mean([width.sd for width in found])),
            relative_radius=float(np.mean([width.relative_radius for width in found])),
            noise_free=first.relative,
            leaning=self._leaning(plain),
        )

    def _lengths(self, mean: Floats, own: Floats) -> tuple[Floats, Floats]:
        """Return the expected lengths and a root of the covariance of their measurement, the model's error included."""
        width = self.engine.inputs.half_width
        seen = np.zeros((2, 2))
        stated = self.errors.covariance
        seen[: len(stated), : len(stated)] = stated
        if self.errors.over_half_width:
            return mean, root_of(own + seen)
        return mean * width.value, root_of(own * width.value**2 + seen + width.error**2 * np.outer(mean, mean))

    def _noisy(self, lengths: Floats, velocity: float) -> list[GridPosterior]:
        found = (self._posterior(pair, velocity) for pair in lengths)
        return [posterior for posterior in found if posterior is not None]

    def _posterior(self, lengths: Floats, velocity: float) -> GridPosterior | None:
        """Return the posterior of a measurement; None where the model has no such shape."""
        with contextlib.suppress(InputError):
            return self.engine(self.errors.measured(lengths, velocity))
        return None

    def _leaning(self, posterior: GridPosterior) -> float:
        draws = posterior.drawn(np.random.default_rng(0), _DRAWS)
        return leaning(draws, ("capillary_number", "size_ratio"), self.model.domain.contains)


def width_of(posterior: GridPosterior) -> Width:
    """Return the width of one posterior."""
    modulus, radius = (posterior.marginal(name) for name in ("surface_shear_modulus", "capsule_radius"))
    half, half_radius = (
        0.5 * (marginal.upper_68 - marginal.lower_68) / marginal.median for marginal in (modulus, radius)
    )
    return Width(half, posterior.log_marginal("surface_shear_modulus").sd, half_radius, half)


def noise_lattice(count: int) -> Floats:
    """Return a Fibonacci lattice of standard normal deviates, of mean zero and unit covariance : (count, 2) array.

    >>> points = noise_lattice(13)
    >>> np.allclose(points.T @ points / 13, np.eye(2))
    True
    """
    if count < 3:  # too few to have a covariance
        return np.zeros((count, 2))
    place = np.arange(count)
    golden = 0.5 * (np.sqrt(5.0) - 1.0)
    shares = np.stack([(place + 0.5) / count, (0.5 + place * golden) % 1.0], axis=1)
    deviates = ndtri(shares)
    deviates = deviates - deviates.mean(axis=0)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(np.cov(deviates.T, bias=True)), deviates.T).T)


def check_model(model: ForwardModel, experiment: Experiment) -> None:
    """Refuse a model of another cross-section, or one for which a point (Ca, a/l) is not a shape."""
    if model.coordinates:
        name = ", ".join(model.coordinates)
        advice = f"fix it: model.fixed({name}=value)"
        raise InputError("sensitivity", "model", "a model of (Ca, a/l)", f"one of {name} too", advice)
    model.check_experiment(experiment)
