"""The selection of capsules by what the model can hold, and the tails of their distribution."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from capsbayes.arrays import Floats, Integers
from capsbayes.errors import InputError
from capsbayes.infer.likelihood import compiled
from capsbayes.infer.population import Population
from capsbayes.model import ForwardModel

# Tails of a population: normal, or those of Student's t distribution as a mixture of normal distributions.
#
# A t distribution of freedom nu is a normal one whose variance is divided by w, and w is gamma distributed with mean
# one and shape nu / 2: K. L. Lange, R. J. A. Little and J. M. G. Taylor, J. Am. Stat. Assoc. 84 (1989) 881. A few
# values of w, equally spaced in log w, represent it

NORMAL, STUDENT = "normal", "student"
TAILS = (NORMAL, STUDENT)
"""Of a population: normal distributions of ln G_s at given size and of ln a, or t distributions."""

NODES = 5
_BEYOND = 1e-3  # probability of w beyond the nodes, on either side
_LOWEST, _HIGHEST = np.log([0.5, 500.0])  # log freedom
_USUAL, _FACTOR = 5.0, 1.0  # median of the log-normal prior of the freedom, and standard deviation of its logarithm
_ONE_SD = 0.6826894921370859  # probability of a normal variable within one standard deviation
_HALVINGS = 40


class ScaleMixture(NamedTuple):
    """Factors of the variance and their weights, for d populations : (d, j) arrays."""

    variance: Floats
    weight: Floats

    @classmethod
    def normal(cls, count: int) -> ScaleMixture:
        """Return normal tails."""
        return cls(np.ones((count, 1)), np.ones((count, 1)))

    @classmethod
    def of_freedom(cls, log_freedom: Floats) -> ScaleMixture:
        """Return the tails of t distributions."""
        half = 0.5 * np.exp(np.clip(log_freedom, _LOWEST, _HIGHEST))[:, None]
        low, high = (np.log(special.gammaincinv(half, share) / half) for share in (_BEYOND, 1.0 - _BEYOND))
        log_w = low + (high - low) * np.linspace(0.0, 1.0, NODES)
        log_density = half * (log_w - np.exp(log_w))
        weight = np.exp(log_density - log_density.max(axis=1, keepdims=True))
        return cls(np.exp(-log_w), weight / weight.sum(axis=1, keepdims=True))

    def scaled(self, factor: Floats) -> ScaleMixture:
        """Return the mixtures of as many variables times a factor (d,)."""
        return self._replace(variance=self.variance * np.square(factor)[:, None])

    def plus(self, other: ScaleMixture) -> ScaleMixture:
        """Return the mixtures of the sums of independent variables."""
        variance, weight = self.variance[:, :, None] + other.variance[:, None], self.weight[:, :, None]
        rows = len(variance)
        return ScaleMixture(variance.reshape(rows, -1), (weight * other.weight[:, None]).reshape(rows, -1))

    def drawn(self, rng: np.random.Generator, rows: Integers) -> Floats:
        """Draw the standard deviations of members of some of the populations : (m,) rows -> (m,) array."""
        node = (np.cumsum(self.weight, axis=1)[rows, :-1] < rng.uniform(size=(len(rows), 1))).sum(axis=1)
        return np.asarray(np.sqrt(self.variance[rows, node]))


def half_width_of(variance: Floats, weight: Floats) -> Floats:
    """Return half the width of the central 68.3 % of mixtures of centred normal distributions."""
    # Of a normal distribution it is the standard deviation; of one with heavy tails, which may have none, it says how
    # far two thirds of the population lie from the middle.
    sd = np.sqrt(variance)
    if sd.shape[1] == 1:
        return np.asarray(sd[:, 0])
    low, high = np.zeros(len(sd)), sd.max(axis=1)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        inside = np.sum(weight * special.erf(middle[:, None] / (np.sqrt(2.0) * sd)), axis=1)
        low, high = np.where(inside < _ONE_SD, middle, low), np.where(inside < _ONE_SD, high, middle)
    return np.asarray(high)


def log_prior_of_freedom(log_freedom: Floats) -> Floats:
    """Return the log prior density of the logarithm of the freedom; very low beyond 0.5 and 500."""
    values = -0.5 * ((log_freedom - np.log(_USUAL)) / _FACTOR) ** 2
    return np.where((log_freedom > _LOWEST) & (log_freedom < _HIGHEST), values, -1e10)


# Selection of the capsules of a population: which of them can be in the sample at all, and which were kept.
#
# A capsule too soft for its flow has no steady shape and is never measured, and a cut on Lambda, as the published 1.04,
# keeps the soft and the large ones. If the likelihood ignores either, the population looks stiffer or softer than it
# is. Each capsule's likelihood is therefore divided by the probability that a capsule of the population in its flow is
# in the sample: T. J. Loredo (2004), https://doi.org/10.48550/arXiv.astro-ph/0409387; I. Mandel, W. M. Farr and J. R.
# Gair (2019), https://doi.org/10.1093/mnras/stz896.
#
# Both limits are limits of Ca at given a/l, so that in (log(G_s / mu), log(a / l)) they do not depend on the viscosity,
# the half width and the scale of the velocities that all capsules share: their errors shift the result as a whole

_COLUMNS = 64  # of a/l
_CAS, _LIMIT_HALVINGS = 200, 20  # of log Ca, to find the limit at each a/l
_FLOWS = 16  # groups of capsules of like velocity
_CELLS, _SLOPE = 768, 4  # of log Ca, to find a cut on Lambda; those on either side over which its rise is taken
_LEAST_SHARE = 1e-12
_LEAST_MASS = 1e-15  # of a population in a column of a/l
_NEAR = 0.05  # of Lambda from the cut: capsules whose errors give its sharpness


def limit_of(model: ForwardModel) -> tuple[Floats, Floats]:
    """Return the highest Ca of steady shapes of a model : a/l at the middle of equal columns (k,), Ca (k,) arrays."""
    (ca_low, ca_high), (first, last) = model.domain.bounds
    size = first + (last - first) * (np.arange(_COLUMNS) + 0.5) / _COLUMNS
    log_ca = np.linspace(np.log(ca_low), np.log(ca_high), _CAS)
    inside = model.domain.contains(np.exp(np.tile(log_ca, _COLUMNS)), np.repeat(size, _CAS)).reshape(_COLUMNS, _CAS)
    below = log_ca[_CAS - 1 - np.argmax(inside[:, ::-1], axis=1)]
    above = np.minimum(below + (log_ca[1] - log_ca[0]), log_ca[-1])
    for _ in range(_LIMIT_HALVINGS):
        middle = 0.5 * (below + above)
        within = model.domain.contains(np.exp(middle), size)
        below, above = np.where(within, middle, below), np.where(within, above, middle)
    return size, np.exp(below)


def kept_rows(population: Population, least: float) -> NDArray[np.bool_]:
    """Return where the median Lambda is above the cut : (n,) array, False for capsules without a result."""
    with np.errstate(invalid="ignore"):
        return population["stretch_ratio_median"] > least


@dataclass(frozen=True, eq=False)
class Selection:
    """Capsules in the sample: Ca between that of a cut on Lambda, if there is one, and the limit of steady shapes."""

    flow: Floats  # (n,): log(mu U) of each capsule of the sample
    half_width: Floats  # (n,): log l of each
    edges: Floats  # (k - 1,): between columns of log(a/l), the first and the last of which are open
    limit: Floats  # (k,): log Ca of the limit in each column
    cut: Floats  # (k,): log Ca of the cut, -inf without one
    cut_error: Floats  # (k,)

    @classmethod
    def of(
        cls,
        population: Population,
        kept: NDArray[np.bool_],
        limit: tuple[Floats, Floats],
        *,
        viscosity: float,
        half_width: float,
        least_stretch: float | None = None,
        model: ForwardModel | None = None,
    ) -> Selection:
        """Return the selection with the flows and errors of a population."""
        if not kept.any():
            raise InputError("selection", "least_stretch", "a Lambda that some capsule exceeds", f"{least_stretch}")
        size, highest = limit
        cut, error = np.full(len(size), -np.inf), np.ones(len(size))
        if least_stretch is not None and model is not None:
            cut, error = _cut(population, least_stretch, model, size)
        own = {"viscosity": viscosity, "half_width": half_width}
        logs = {name: _own(population, name, common)[kept] for name, common in own.items()}
        return cls(
            np.log(population["mean_velocity_median"][kept]) + logs["viscosity"],
            logs["half_width"],
            np.log(0.5 * (size[1:] + size[:-1])),
            np.log(highest),
            cut,
            error,
        )

    def _members(self) -> list[Integers]:
        """Return the numbers of the capsules of each group of capsules in like flow."""
        order = np.argsort(self.flow, kind="stable")
        return np.array_split(order, min(_FLOWS, len(order)))

    def _groups(self) -> tuple[Floats, Floats, Floats]:
        """Return groups of capsules in like flow: log(mu U), log l, number : (f,) arrays."""
        groups = self._members()
        means = [np.array([values[group].mean() for group in groups]) for values in (self.flow, self.half_width)]
        return means[0], means[1], np.array([len(group) for group in groups], dtype=np.float64)

    def shares(self, parameters: Floats, modulus: ScaleMixture, radius: ScaleMixture) -> tuple[Floats, Floats, Floats]:
        """Return which shares of some populations are in the sample, in each group of capsules in like flow."""
        flow, half_width, number = self._groups()
        kept, lost = (np.empty((len(parameters), len(number))) for _ in range(2))
        columns = self.edges, self.limit, self.cut, self.cut_error
        _fill_shares(parameters, *modulus, *radius, flow, half_width, *columns, kept, lost)
        return kept, lost, number

    def log_probability(self, parameters: Floats, modulus: ScaleMixture, radius: ScaleMixture) -> Floats:
        """Return the log probability that all capsules are in the sample, for some populations : (d,) array."""
        kept, _, number = self.shares(parameters, modulus, radius)
        return np.asarray(np.sum(np.log(np.maximum(kept, _LEAST_SHARE)) * number, axis=1))

    def log_probabilities(self, parameters: Floats, modulus: ScaleMixture, radius: ScaleMixture) -> Floats:
        """Return the log probability that each capsule is in the sample, for some populations : (d, n) array."""
        kept, _, _ = self.shares(parameters, modulus, radius)
        found = np.empty((len(parameters), len(self.flow)))
        for group, members in enumerate(self._members()):
            found[:, members] = np.log(np.maximum(kept[:, group], _LEAST_SHARE))[:, None]
        return found

    def holds(self, modulus: Floats, radius: Floats, of: Integers, rng: np.random.Generator) -> NDArray[np.bool_]:
        """Return whether capsules in the flows of the sample would be in it : (m,) array."""
        log_size, log_ca = radius - self.half_width[of], self.flow[of] - modulus
        column = np.searchsorted(self.edges, log_size, side="right")
        seen = log_ca + self.cut_error[column] * rng.standard_normal(len(column))
        return np.asarray((log_ca <= self.limit[column]) & (seen >= self.cut[column]))


def _own(population: Population, name: str, common: float) -> Floats:
    """Return the logarithm of a condition of each capsule, the common one where it has none of its own : (n,) array."""
    own = population[name] if name in population.dataset else np.full(len(population), np.nan)
    return np.log(np.where(np.isnan(own), common, own))


def _cut(population: Population, least: float, model: ForwardModel, size: Floats) -> tuple[Floats, Floats]:
    """Return log Ca of a cut on the median Lambda and its standard error at some a/l : (k,), (k,) arrays."""
    low, high = np.log(model.domain.bounds[0])
    step = (high - low) / _CELLS
    log_ca = low + step * (np.arange(_CELLS) + 0.5)
    theta = {"capillary_number": np.tile(np.exp(log_ca), len(size)), "size_ratio": np.repeat(size, _CELLS)}
    table = model(theta).stretch_ratio.reshape(len(size), _CELLS)
    known = np.isfinite(population["stretch_ratio_median"])
    away = np.abs(population["stretch_ratio_median"][known] - least)
    sd = float(np.median(population["stretch_ratio_sd"][known][away <= max(_NEAR, float(away.min()))]))
    cut, error = np.full(len(size), np.inf), np.ones(len(size))
    for k, stretch in enumerate(table):
        answered = np.flatnonzero(np.isfinite(stretch))
        above = answered[stretch[answered] > least]
        if not len(above):
            continue
        first = int(above[0])
        cut[k] = log_ca[first] - 0.5 * step
        ahead, behind = min(first + _SLOPE, int(answered[-1])), max(first - _SLOPE, int(answered[0]))
        rise = (stretch[ahead] - stretch[behind]) / max((ahead - behind) * step, step)
        error[k] = np.clip(sd / max(rise, 1e-6), 0.5 * step, 1.0)
    return cut, error


@compiled
def _below(value, mean, sd):  # type: ignore[no-untyped-def]
    """Return the probability that a normal variable lies below a value."""
    return 0.5 * math.erfc((mean - value) / (sd * math.sqrt(2.0)))


@compiled
def _fill_shares(
    parameters: Floats,
    modulus_variance: Floats,
    modulus_weight: Floats,
    radius_variance: Floats,
    radius_weight: Floats,
    flow: Floats,
    half_width: Floats,
    edges: Floats,
    limit: Floats,
    cut: Floats,
    cut_error: Floats,
    kept: Floats,
    lost: Floats,
) -> None:
    nodes, columns = modulus_variance.shape[1], len(limit)
    mass = np.empty(columns)
    for d in range(len(parameters)):
        x, y, log_spread, log_radius_spread, slope = parameters[d, :5]
        spread, of_radius = np.exp(log_spread), np.exp(log_radius_spread)
        for f in range(len(flow)):
            if f == 0 or half_width[f] != half_width[f - 1]:
                mass[:] = 0.0
                for j in range(nodes):
                    sd = of_radius * math.sqrt(radius_variance[d, j])
                    smaller = 0.0
                    for k in range(columns):
                        larger = _below(edges[k] + half_width[f], y, sd) if k < columns - 1 else 1.0
                        mass[k] += radius_weight[d, j] * (larger - smaller)
                        smaller = larger
            kept[d, f] = lost[d, f] = 0.0
            for k in range(columns):
                if mass[k] < _LEAST_MASS:
                    continue
                size = 0.5 * (edges[max(k - 1, 0)] + edges[min(k, columns - 2)])
                mean = x + slope * (size + half_width[f] - y)
                for j in range(nodes):
                    sd = spread * math.sqrt(modulus_variance[d, j])
                    share = mass[k] * modulus_weight[d, j]
                    softest, stiffest = _below(flow[f] - limit[k], mean, sd), 1.0
                    if cut[k] > -np.inf:
                        stiffest = _below(flow[f] - cut[k], mean, math.hypot(sd, cut_error[k]))
                    kept[d, f] += share * max(stiffest - softest, 0.0)
                    lost[d, f] += share * softest
