"""Expected widths of the intervals of G_s, a and the membrane: of one capsule, and of a batch."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, imposed_velocity
from capsbayes.infer.conditional import COMMON, MODULUS, SIZE, Capsules, Start, Unknowns
from capsbayes.infer.grid import ExactPosterior, GridPosterior
from capsbayes.infer.importance import exact_engine
from capsbayes.infer.prior import Prior
from capsbayes.infer.proposal import Draws, normalised, quasi_random, rows_by_weight
from capsbayes.infer.shared_membrane import MembraneSampling, Mode, averaged_draws, drawn_log_moduli
from capsbayes.infer.verdict import leaning
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel
from capsbayes.plan.lab import LabErrors, flow_rate, root_of
from capsbayes.run import step_of

# Expected width of the posterior of a capsule before it is measured. It depends on the noise of the measurement: next
# to a snap-through, and where the posterior is wide, that of the measurement without noise is off by a third and more.
# So it is averaged over the noise, on a Fibonacci lattice, which integrates a smooth function of the two lengths as
# well as many more measurements drawn at random

NOISES = 13
"""Number of measurements that a width is averaged over."""

EVERY = 4
"""Vertices of a predicted outline for one that is measured."""

_DRAWS = 500  # of a posterior, for its share next to the border


@dataclass(frozen=True)
class Width:
    """Width of one posterior, or the mean of those of several."""

    relative: float = np.nan  # half of the 68 % interval of G_s over its median
    sd: float = np.nan  # standard deviation of log G_s
    relative_radius: float = np.nan  # half of the 68 % interval of a over its median
    noise_free: float = np.nan  # as `relative`, of the measurement without noise
    leaning: float = np.nan  # share of that posterior next to the border of the model, as in `identify`


class WidthPredictor:
    """Predictor of the posterior of a capsule for one lab, by the engine that identifies single capsules."""

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
        self.model, self.errors, self.experiment = model, errors, experiment
        self.engine = exact_engine(model, experiment, prior)
        within = self.engine.prior.surface_shear_modulus
        middle = np.sqrt(within.low * within.high) if within.is_range else within.ppf(0.5)
        self.modulus = surface_shear_modulus or float(middle)
        self.lattice = noise_lattice(noises)

    def at(self, capillary_number: float, size_ratio: float) -> Width:
        """Predict the width at one point of a model of (Ca, a/l) alone; all NaN outside the model's domain."""
        lab = self.model, self.experiment, self.errors, self.engine.prior, self.modulus, self.lattice
        place = capillary_number, size_ratio
        return step_of(Width, ("width", *lab, *place), self._at, *place)

    def mean_velocity(self, capillary_number: float) -> float:
        """Return U [m/s] of a capsule of the expected G_s."""
        viscosity, modulus = self.experiment.viscosity.value, self.modulus
        return float(
            imposed_velocity(viscosity=viscosity, capillary_number=capillary_number, surface_shear_modulus=modulus)
        )

    def without_noise(self, capillary_number: float, size_ratio: float, *, outline: bool) -> Measurement:
        """Return what is measured of a capsule without noise: its lengths, flow rate and, where wanted, its outline."""
        shape = self.model.at(capillary_number=capillary_number, size_ratio=size_ratio, outline=outline)
        edge = None if shape.outline is None else shape.outline[0, ::EVERY]
        flow = self.mean_velocity(capillary_number)
        rate = flow_rate(flow, self.experiment.half_width.value, self.experiment.cross_section)
        return self.errors.measured(shape.values[0, :2], flow * float(shape.velocity_ratio[0]), edge, rate)

    def log_modulus_sd(self, seen: Measurement) -> float:
        """Return the standard deviation of ln G_s by a measurement; NaN where it has no posterior."""

        def compute() -> Width:
            with contextlib.suppress(InputError):
                return Width(sd=self.engine(seen).log_marginal("surface_shear_modulus").sd)
            return Width()

        engine = self.engine
        key = "membrane map", engine.model.sha256, engine.prior, engine.experiment, seen
        return step_of(Width, key, compute).sd

    def _at(self, capillary_number: float, size_ratio: float) -> Width:
        shape = self.model({"capillary_number": np.array([capillary_number]), "size_ratio": np.array([size_ratio])})
        if not shape.inside[0]:
            return Width()
        velocity = float(shape.velocity_ratio[0] * self.mean_velocity(capillary_number))
        lengths, root = self._lengths(shape.values[0, :2], shape.covariance[0, :2, :2])
        plain = self._posterior(lengths, velocity)
        if plain is None:
            return Width()
        assert isinstance(plain, GridPosterior), "a model of (Ca, a/l) alone"
        first = width_of(plain)
        noisy = [self._posterior(pair, velocity) for pair in lengths + self.lattice @ root.T]
        widths = [width_of(posterior) for posterior in noisy if posterior is not None] or [first]
        draws = plain.drawn(np.random.default_rng(0), _DRAWS)
        names = "relative", "sd", "relative_radius"
        return Width(
            **{name: float(np.mean([getattr(width, name) for width in widths])) for name in names},
            noise_free=first.relative,
            leaning=leaning(draws, ("capillary_number", "size_ratio"), self.model.domain.contains),
        )

    def _lengths(self, mean: Floats, own: Floats) -> tuple[Floats, Floats]:
        """Return the expected lengths and a root of the covariance of their measurement, the model's error included."""
        width = self.engine.inputs.half_width
        stated = self.errors.covariance
        seen = np.zeros((2, 2))
        seen[: len(stated), : len(stated)] = stated
        if self.errors.over_half_width:
            return mean, root_of(own + seen)
        return mean * width.value, root_of(own * width.value**2 + seen + width.error**2 * np.outer(mean, mean))

    def _posterior(self, lengths: Floats, velocity: float) -> ExactPosterior | None:
        """Return the posterior of a measurement; None where the model has no such shape."""
        with contextlib.suppress(InputError):
            return self.engine(self.errors.measured(lengths, velocity))
        return None


def width_of(posterior: ExactPosterior) -> Width:
    """Return the width of one posterior."""
    both = map(posterior.marginal, ("surface_shear_modulus", "capsule_radius"))
    half, half_radius = (0.5 * (marginal.upper_68 - marginal.lower_68) / marginal.median for marginal in both)
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


# What a batch is expected to tell of its membrane. The information of the measurements is the curvature of the
# likelihood at the membrane that is expected, with G_s and a of each capsule and all errors that capsules share
# integrated out: it compares many sets of flow rates in little time. The widths of one set are those of the posterior
# that the engine for batches samples from measurements without noise, so that the limits of priors count

LOGARITHMIC = ("area_dilation_modulus", "bending", "membrane_thickness")
"""Parameters of the membrane of which the width of the logarithm is expected."""

EACH = "surface_shear_modulus_each"
"""Name of the width of G_s of one of the capsules."""

_PRIOR_DRAWS, _DRAWN = 4096, 256  # of a prior, and of the capsules


@dataclass(frozen=True, eq=False)
class ExpectedMembrane:
    """What measurements of a batch tell of a membrane that is expected."""

    capsules: Capsules  # as they would be measured without noise, with the model's own error
    unknowns: Unknowns  # with known spreads
    scores: Floats  # (f,): normal scores of the membrane
    values: Start  # the capsules there
    covariance: Floats  # (4 + f, 4 + f): of what the capsules share and of the scores, priors included

    def log_volume(self, *names: str) -> float:
        """Return the log of the determinant of the covariance of some normal scores; zero if none is unknown."""
        columns = self._columns(*names)
        return float(np.linalg.slogdet(self.covariance[np.ix_(columns, columns)])[1])

    def seeks(self, *names: str) -> bool:
        """Return whether one of some parameters is unknown."""
        return bool(self._columns(*names))

    @property
    def log_modulus_variance(self) -> float:
        """Variance of the mean of ln G_s at known viscosity, by the curvature."""
        return float(self.covariance[MODULUS, MODULUS])

    @property
    def given_membrane(self) -> Floats:
        """Covariance (4, 4) of what is common, were the membrane known."""
        precision = np.linalg.inv(self.covariance)
        return np.asarray(np.linalg.inv(precision[:COMMON, :COMMON]))

    def widths(self) -> dict[str, float]:
        """Return the expected standard deviations by name."""
        # Those of ``surface_shear_modulus`` and ``capsule_radius`` are of the logarithms of the means of the population
        # at known viscosity and half width; that of `EACH` of the logarithm of G_s of one of the capsules; the others
        # of each unknown parameter, of the logarithm of `LOGARITHMIC`.
        mode = Mode(self.scores, self.covariance[COMMON:, COMMON:])
        draws = MembraneSampling(self.capsules, self.unknowns).about(mode, self.values)
        weights = normalised(averaged_draws(draws).log_weights)
        common, given = draws.found.common, self.given_membrane
        shown = shown_parameters(self.unknowns, draws.points)
        columns = np.column_stack([common[:, MODULUS], common[:, SIZE], *shown.values()])
        variances = weights @ (columns - weights @ columns) ** 2
        variances[:2] += given[[MODULUS, SIZE], [MODULUS, SIZE]]
        sds = dict(zip(("surface_shear_modulus", "capsule_radius", *shown), np.sqrt(variances).tolist(), strict=True))
        sds["capsule_radius"] /= float(self.values.common[0, SIZE])
        return {EACH: self._sd_of_each(draws, weights), **sds}

    def _sd_of_each(self, draws: Draws, weights: Floats) -> float:
        """Return the standard deviation of ln G_s of a capsule, root mean square over the capsules."""
        rng = np.random.default_rng(0)
        rows = rows_by_weight(weights, rng, _DRAWN)
        membranes, spreads = self.unknowns.membranes(draws.points[rows]), self.unknowns.spreads_at(draws.points[rows])
        start = Start(draws.found.own[rows], draws.found.common[rows])
        capsules = self.capsules.at(membranes, spreads, start=start, rng=rng)
        log_ratio = self.capsules.shapes(membranes, capsules.own).log_ratio
        logs = drawn_log_moduli(self.capsules, capsules.own, log_ratio, capsules.common, spreads.modulus, rng)
        return float(np.sqrt(np.mean(np.var(logs, axis=0))))

    def _columns(self, *names: str) -> list[int]:
        return [COMMON + k for k, coordinate in enumerate(self.unknowns.coordinates) if coordinate.key in names]


def prior_widths(unknowns: Unknowns) -> dict[str, float]:
    """Return the standard deviations of the unknown parameters under their priors, of `LOGARITHMIC` by logarithms."""
    if not unknowns.scores:
        return {}
    points = ndtri(quasi_random(unknowns.scores, _PRIOR_DRAWS, 0))
    return {name: float(np.std(values)) for name, values in shown_parameters(unknowns, points).items()}


def shown_parameters(unknowns: Unknowns, points: Floats) -> dict[str, Floats]:
    """Return the unknown parameters at points (d, p) as widths of them are stated : (d,) arrays by name."""
    membranes = unknowns.membranes(points)
    names = (coordinate.key for coordinate in unknowns.coordinates)
    return {name: np.log(membranes[name]) if name in LOGARITHMIC else membranes[name] for name in names}
