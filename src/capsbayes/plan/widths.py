"""Expected widths of the intervals of G_s and a."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, fields

import numpy as np
from scipy.special import ndtri

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, capillary_number, imposed_velocity, size_ratio
from capsbayes.infer.conditional import COMMON, MODULUS, SIZE, Capsules, Start, Unknowns, key_of
from capsbayes.infer.grid import GridPosterior
from capsbayes.infer.log_grid import LogGrid
from capsbayes.infer.prior import Prior
from capsbayes.infer.proposal import normalised, quasi_random, rows_by_weight
from capsbayes.infer.quadrature import Quadrature
from capsbayes.infer.shared_membrane import MembraneDraws, MembraneSampling, Mode, drawn_log_moduli
from capsbayes.infer.verdict import leaning
from capsbayes.model import ForwardModel
from capsbayes.plan.lab import LabErrors, root_of
from capsbayes.quantity import Given, Quantity
from capsbayes.run import step_of

# Capsules expected in an experiment, and its conditions, before anything is measured


@dataclass(frozen=True, eq=False)
class Draws:
    """Independent draws of capsules, of the liquid and of the channel : (n,) arrays, SI."""

    surface_shear_modulus: Floats
    capsule_radius: Floats
    viscosity: Floats
    half_width: Floats

    @property
    def size_ratio(self) -> Floats:
        """a/l of each : (n,) array."""
        return size_ratio(capsule_radius=self.capsule_radius, half_width=self.half_width)

    def capillary_number(self, mean_velocity: float) -> Floats:
        """Return Ca of each at one mean velocity of the flow [m/s] : (n,) array."""
        return capillary_number(
            viscosity=self.viscosity, mean_velocity=mean_velocity, surface_shear_modulus=self.surface_shear_modulus
        )


@dataclass(frozen=True, eq=False)
class Expectation:
    """Expected G_s and a, with what is known of liquid and channel.

    >>> lab = Experiment(cross_section="square", half_width=25e-6, viscosity=0.8)
    >>> soon = Expectation.of("50 +/- 10 mN/m", 24e-6, lab)
    >>> soon.known, round(soon.centre.size_ratio.item(), 3)
    (False, 0.96)
    """

    surface_shear_modulus: Quantity
    capsule_radius: Quantity
    viscosity: Quantity
    half_width: Quantity

    @classmethod
    def of(cls, surface_shear_modulus: Given, capsule_radius: Given, experiment: Experiment) -> Expectation:
        """Return what is expected under the conditions of an experiment; refuse a G_s or a that is not positive."""
        return cls(
            Quantity.of(surface_shear_modulus, "surface_shear_modulus", where="expected"),
            Quantity.of(capsule_radius, "capsule_radius", where="expected"),
            experiment.viscosity,
            experiment.half_width,
        )

    @property
    def known(self) -> bool:
        """True if all values are known without error."""
        return all(quantity.known for quantity in self._all.values())

    @property
    def centre(self) -> Draws:
        """Capsule with the expected values."""
        return Draws(**{name: np.array([quantity.value]) for name, quantity in self._all.items()})

    def drawn(self, rng: np.random.Generator, count: int) -> Draws:
        """Draw independently; one draw if all is known."""
        if self.known:
            return self.centre
        return Draws(**{name: LogGrid.of(quantity).drawn(rng, count) for name, quantity in self._all.items()})

    def as_dict(self) -> dict[str, dict[str, float]]:
        """Return mean and standard deviation of each, SI."""
        return {name: {"value": quantity.value, "error": quantity.error} for name, quantity in self._all.items()}

    @property
    def _all(self) -> dict[str, Quantity]:
        return {name: getattr(self, name) for name in Draws.__dataclass_fields__}


# What a batch is expected to tell of its membrane.
#
# The information of the measurements is the curvature of the likelihood at the membrane that is expected, as the engine
# for batches has it, with G_s and a of each capsule and all errors that capsules share integrated out: it compares many
# sets of flow rates in little time. The widths of one set are those of the posterior that the same engine samples from
# measurements without noise, so that the limits of priors and the curvature of the model count

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
        weights = normalised(draws.averaged.log_weights)
        common, given = draws.found.common, self.given_membrane
        shown = shown_parameters(self.unknowns, draws.points)
        columns = np.column_stack([common[:, MODULUS], common[:, SIZE], *shown.values()])
        variances = weights @ (columns - weights @ columns) ** 2
        variances[:2] += given[[MODULUS, SIZE], [MODULUS, SIZE]]
        sds = dict(zip(("surface_shear_modulus", "capsule_radius", *shown), np.sqrt(variances).tolist(), strict=True))
        sds["capsule_radius"] /= float(self.values.common[0, SIZE])
        return {EACH: self._sd_of_each(draws, weights), **sds}

    def _sd_of_each(self, draws: MembraneDraws, weights: Floats) -> float:
        """Return the standard deviation of ln G_s of a capsule, root mean square over the capsules."""
        rng = np.random.default_rng(0)
        rows = rows_by_weight(weights, rng, _DRAWN)
        membranes, spreads = self.unknowns.membranes(draws.points[rows]), self.unknowns.spreads_at(draws.points[rows])
        start = Start(draws.found.own[rows], draws.found.common[rows])
        there = self.capsules.at(membranes, spreads, start=start, rng=rng)
        log_ratio = self.capsules.shapes(membranes, there.own).log_ratio
        logs = drawn_log_moduli(self.capsules, there.own, log_ratio, there.common, spreads.modulus, rng)
        return float(np.sqrt(np.mean(np.var(logs, axis=0))))

    def _columns(self, *names: str) -> list[int]:
        return [COMMON + k for k, one in enumerate(self.unknowns.coordinates) if key_of(one) in names]


def prior_widths(unknowns: Unknowns) -> dict[str, float]:
    """Return the standard deviations of the unknown parameters under their priors, of `LOGARITHMIC` by logarithms."""
    if not unknowns.scores:
        return {}
    points = ndtri(quasi_random(unknowns.scores, _PRIOR_DRAWS, 0))
    return {name: float(np.std(values)) for name, values in shown_parameters(unknowns, points).items()}


def shown_parameters(unknowns: Unknowns, points: Floats) -> dict[str, Floats]:
    """Return the unknown parameters at points (d, p) as widths of them are stated : (d,) arrays by name."""
    membranes = unknowns.membranes(points)
    names = [key_of(one) for one in unknowns.coordinates]
    return {name: np.log(membranes[name]) if name in LOGARITHMIC else membranes[name] for name in names}


# Expected width of the posterior of a capsule before it is measured.
#
# A width depends on the noise of the measurement: next to a snap-through,
# and where the posterior is wide, that of the measurement without noise is off
# by a third and more. So it is averaged over the noise, on a Fibonacci lattice
# of measurements: that of N points integrates a smooth function of the two
# lengths as well as many more drawn at random

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
