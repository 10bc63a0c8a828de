"""The mixture from which importance sampling draws, and its weights."""

from __future__ import annotations

import abc
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, reduce
from math import comb
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri, gammaln, logsumexp, ndtr, ndtri

from capsbayes.arrays import Floats, Integers
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, bending, membrane_thickness
from capsbayes.infer.checks import Gate
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.grid import Nodes
from capsbayes.infer.likelihood import compiled
from capsbayes.infer.prior import LEAST_COVERED, THICKNESS, Coordinate
from capsbayes.model import Domain, ForwardModel
from capsbayes.parameters import PARAMETERS
from capsbayes.quantity import Quantity

# Quasi-random draws and their weights: the effective number, the heaviness of the tail, rows by weight


_MOST_PARETO = 0.7  # shape of the tail of the weights


def normalised(log_weights: Floats) -> Floats:
    """Return weights that sum to one : (n,) array; a log of -inf is a weight of zero."""
    weights = np.exp(log_weights - log_weights.max())
    return np.asarray(weights / weights.sum())


def effective(weights: Floats) -> float:
    """Return the effective number of draws with weights that sum to one (Kish)."""
    return 1.0 / float(np.sum(weights**2))


def tempering(log_weights: Floats, least: float) -> float:
    """Return the largest power, at most one, at which the weights have an effective number of at least `least`."""
    if effective(normalised(log_weights)) >= least:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective(normalised(middle * log_weights)) >= least else (low, middle)
    return low


def tempered(log_weights: Floats, least: float) -> Floats:
    """Return the weights to a power that leaves an effective number of at least `least`, if there are as many."""
    return normalised(tempering(log_weights, least) * log_weights)


def rows_by_weight(weights: Floats, rng: np.random.Generator, count: int) -> Integers:
    """Return rows, each as often as its weight says, give or take one : (count,) array, rising."""
    places = (np.arange(count) + rng.uniform(size=count)) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), places), len(weights) - 1)


def quasi_random(dimensions: int, count: int, seed: int, after: int = 0) -> Floats:
    """Return a part of a quasi-random sequence in the unit cube : (count, dimensions) array."""
    from scipy.stats import qmc  # half a second to import

    sequence = qmc.Sobol(dimensions, rng=np.random.default_rng(abs(2 * seed + (seed < 0))))
    if after:
        sequence.fast_forward(after)
    return np.clip(sequence.random(count), 1e-12, 1.0 - 1e-12)


def smoothed(log_weights: Floats) -> tuple[Floats, float]:
    """Return log weights whose tail is that of a generalised Pareto distribution fitted to it, and its shape k."""
    # Means by the weights have a finite variance for k below 1/2, and a usable one up to 0.7; k is infinite where they
    # are too few.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of ArviZ itself
        import arviz  # slow to import

        found, shape = arviz.psislw(log_weights)
    return np.asarray(found), float(shape)


def weight_gates(log_weights: Floats, shape: float, least: float, draws: str = "effective draws") -> tuple[Gate, Gate]:
    """Return the gates on the effective number of draws with these weights, and on the shape k of their tail."""
    count = effective(normalised(log_weights))
    return Gate(draws, count, least=least), Gate("Pareto k of the weights", shape, most=_MOST_PARETO)


# Mixture of t distributions about a curved sheet, fitted to weighted points: what importance sampling draws from.
#
# Two lengths tell two numbers of the six or so: the posterior is a thin curved sheet. Polynomials follow it; what is
# left about it is nearly Gaussian, and a mixture of a few t distributions holds the rest

PLACE = 2  # first columns of a point: log Ca and a/l
_FREEDOM = 5.0  # of the fitted t distributions
_WIDE, _WIDENING, _WIDE_FREEDOM = 0.2, 1.5, 3.0  # share, factor and freedom of one more that holds all of them
_MOST_COMPONENTS, _LEAST_SHARE = 16, 1e-3
_POINTS_EACH, _POINTS_A_TERM = 60.0, 12.0  # effective ones
_ITERATIONS = 12
_LARGEST_DEGREE = 3
_NEGLIGIBLE = 1e-5  # of the largest weight: such points are left out of a fit
_REACH = 3.0  # standard deviations, beyond which the sheet goes on as it is there
_FLOOR = 1e-4  # of the variances of all points, least of a component
_GRAIN = 2.0**-26


class Polynomial(NamedTuple):
    """A column of points as a function of those after it."""

    centre: Floats  # (m,): of the arguments
    scale: Floats
    degree: int
    coefficients: Floats  # (terms,)

    @classmethod
    def fitted(cls, arguments: Floats, values: Floats, weights: Floats) -> Polynomial:
        """Fit it to weighted values (n,) at arguments (n, m); the degree is what their effective number allows."""
        mean: Floats = np.asarray(weights @ arguments, dtype=np.float64)
        spread: Floats = np.asarray(np.sqrt(weights @ (arguments - mean) ** 2) + 1e-9)
        centre, scale = _to_grain(mean, spread), _to_grain(spread, spread)
        allowed = effective(weights) / _POINTS_A_TERM
        degree = max(k for k in range(_LARGEST_DEGREE + 1) if comb(arguments.shape[1] + k, k) <= max(allowed, 1.0))
        blank = cls(centre, scale, degree, np.zeros(1))
        terms = blank._terms(arguments)
        weighted = weights[:, None] * terms
        normal = weighted.T @ terms + 1e-9 * np.eye(terms.shape[1])
        found: Floats = np.asarray(np.linalg.solve(normal, weighted.T @ values), dtype=np.float64)
        return blank._replace(coefficients=_to_grain(found, np.full(len(found), np.abs(found).max() + 1e-300)))

    def __call__(self, arguments: Floats) -> Floats:
        """Return the values at arguments (n, m) : (n,) array."""
        return np.asarray(_values(self._scaled(arguments), *_factors(len(self.centre), self.degree), self.coefficients))

    def _terms(self, arguments: Floats) -> Floats:
        """Return the products of arguments up to the degree : (n, terms) array."""
        return np.asarray(_products(self._scaled(arguments), *_factors(arguments.shape[1], self.degree)))

    def _scaled(self, arguments: Floats) -> Floats:
        return np.clip((arguments - self.centre) / self.scale, -_REACH, _REACH)


@cache
def _factors(number: int, degree: int) -> tuple[Integers, Integers]:
    """Return of each product of arguments the shorter product that it is a multiple of, and by which argument."""
    shorter, by, last = [0], [0], {0: 0}  # the last: products of one degree and the first argument that may follow
    for _ in range(degree):
        longer = {}
        for product, first in last.items():
            for argument in range(first, number):
                longer[len(shorter)] = argument
                shorter.append(product)
                by.append(argument)
        last = longer
    return np.array(shorter), np.array(by)


class Sheet(NamedTuple):
    """Where the posterior lies: two columns of a point, each a polynomial of those that are left."""

    columns: tuple[int, ...]  # the first is known if all others are, the second if all but the first are
    polynomials: tuple[Polynomial, ...]

    @classmethod
    def fitted(cls, points: Floats, weights: Floats) -> Sheet:
        """Fit it to weighted points (n, d), whose columns are chosen so that the least is left of them."""
        columns: list[int] = []
        polynomials = []
        for _ in range(min(PLACE, points.shape[1] - 1)):
            tried = {}
            for column in set(range(points.shape[1])) - set(columns):
                arguments, values = np.delete(points, [*columns, column], axis=1), points[:, column]
                polynomial = Polynomial.fitted(arguments, values, weights)
                left, mean = values - polynomial(arguments), weights @ values
                tried[float(weights @ left**2 / (weights @ (values - mean) ** 2))] = column, polynomial
            column, polynomial = tried[min(tried)]
            columns.append(column)
            polynomials.append(polynomial)
        return cls(tuple(columns), tuple(polynomials))

    def flattened(self, points: Floats) -> Floats:
        """Return points (n, d) relative to the sheet; volumes stay as they are."""
        flat = points.copy()
        for number, polynomial in enumerate(self.polynomials):
            given = self.columns[: number + 1]
            flat[:, given[-1]] -= polynomial(np.delete(points, given, axis=1))
        return flat

    def raised(self, flat: Floats) -> Floats:
        """Return the points of which `flattened` gave the flat ones."""
        points = flat.copy()
        for number in reversed(range(len(self.columns))):
            given = self.columns[: number + 1]
            points[:, given[-1]] += self.polynomials[number](np.delete(points, given, axis=1))
        return points


@dataclass(frozen=True, eq=False)
class Proposal:
    """Mixture of g t distributions in d dimensions, about a sheet."""

    sheet: Sheet
    shares: Floats  # (g,): probability of each
    centres: Floats  # (g, d)
    factors: Floats  # (g, d, d): lower triangular, factors of the scale matrices
    freedoms: Floats  # (g,)

    @classmethod
    def fitted(cls, points: Floats, weights: Floats) -> Proposal:
        """Fit the mixture to points (n, d) with weights (n,) that sum to one; the last component is a wide one."""
        kept = weights > _NEGLIGIBLE * weights.max()
        points, weights = points[kept], weights[kept]
        sheet = Sheet.fitted(points, weights)
        flat = sheet.flattened(points)
        centre = weights @ flat
        whole = _covariance(flat - centre, weights)
        number = int(np.clip(effective(weights) / _POINTS_EACH, 1, _MOST_COMPONENTS))
        shares, centres, covariances = _mixture(flat, weights, number, whole)
        centres = np.concatenate([centres, centre[None]])
        factors = np.linalg.cholesky(np.concatenate([covariances, _WIDENING**2 * whole[None]]))
        freedoms = np.full(len(centres), _FREEDOM)
        freedoms[-1] = _WIDE_FREEDOM
        scales = np.sqrt(np.diag(whole))
        return cls(
            sheet,
            np.append((1.0 - _WIDE) * shares, _WIDE),
            _to_grain(centres, scales),
            _to_grain(factors, scales[:, None]),
            freedoms,
        )

    def middle(self, points: Floats, weights: Floats) -> Floats:
        """Return the one of weighted points (n, d) that is nearest to their mean along the sheet : (d,) array."""
        flat = self.sheet.flattened(points)
        mean = weights @ flat
        variance = weights @ (flat - mean) ** 2 + np.finfo(float).tiny
        square = np.sum((flat - mean) ** 2 / variance, axis=1)
        return np.asarray(points[np.argmin(np.where(weights > 0.0, square, np.inf))])

    def drawn(self, uniform: Floats) -> Floats:
        """Return draws (n, d) of points of the unit cube (n, d + 2)."""
        return self.sheet.raised(self.drawn_flat(uniform))

    def log_density(self, points: Floats) -> Floats:
        """Return the log density at points (n, d) : (n,) array."""
        return self.log_density_flat(self.sheet.flattened(points))

    def drawn_flat(self, uniform: Floats) -> Floats:
        """Return draws (n, d) relative to the sheet of points of the unit cube (n, d + 2)."""
        flat = np.empty((len(uniform), uniform.shape[1] - 2))
        which = np.searchsorted(np.cumsum(self.shares)[:-1], uniform[:, 0], side="right")
        for k in range(len(self.shares)):
            rows = which == k
            squares = chdtri(self.freedoms[k], uniform[rows, 1]) / self.freedoms[k]
            normal = ndtri(uniform[rows, 2:]) / np.sqrt(squares)[:, None]
            flat[rows] = self.centres[k] + np.einsum("nj,ij->ni", normal, self.factors[k])
        return flat

    def log_density_flat(self, flat: Floats) -> Floats:
        """Return the log density at points (n, d) relative to the sheet : (n,) array."""
        d = flat.shape[1]
        constants = gammaln(0.5 * (self.freedoms + d)) - gammaln(0.5 * self.freedoms)
        constants -= 0.5 * d * np.log(np.pi * self.freedoms) + _log_volumes(self.factors)
        logs = _log_of_t(
            flat, self.centres, np.linalg.inv(self.factors), self.freedoms, constants + np.log(self.shares)
        )
        return np.asarray(logs)


def _covariance(away: Floats, weights: Floats) -> Floats:
    found = (weights[:, None] * away).T @ away
    return np.asarray(found + 1e-12 * np.diag(np.diag(found)) + 1e-18 * np.eye(len(found)))


def _log_volumes(factors: Floats) -> Floats:
    return np.asarray(np.sum(np.log(np.diagonal(factors, axis1=1, axis2=2)), axis=1))


def _mixture(flat: Floats, weights: Floats, number: int, whole: Floats) -> tuple[Floats, Floats, Floats]:
    """Fit a mixture of normal distributions to weighted points by expectation and maximisation."""
    floor = _FLOOR * np.diag(np.diag(whole))
    centres = flat[_spread_out(flat, weights, number, whole)]
    covariances = np.repeat(whole[None] / number, number, axis=0)
    shares = np.full(number, 1.0 / number)
    for _ in range(_ITERATIONS if number > 1 else 1):
        factors = np.asarray(np.linalg.cholesky(covariances), dtype=np.float64)
        constants = np.log(shares) - _log_volumes(factors)
        shares, sums, squares = _moments_of_each(flat, weights, centres, np.linalg.inv(factors), constants)
        alive = shares > _LEAST_SHARE
        shares, sums, squares = shares[alive], sums[alive], squares[alive]
        moved = sums / shares[:, None]
        covariances = squares / shares[:, None, None] - moved[:, :, None] * moved[:, None, :] + floor
        centres, shares = centres[alive] + moved, shares / shares.sum()
    return shares, centres, covariances


@compiled
def _products(x, shorter, by):  # type: ignore[no-untyped-def]
    """Return products (n, terms) of arguments (n, m), see `_factors`."""
    terms = np.empty((len(x), len(shorter)))
    for n in range(len(x)):
        terms[n, 0] = 1.0
        for term in range(1, len(shorter)):
            terms[n, term] = terms[n, shorter[term]] * x[n, by[term]]
    return terms


@compiled
def _values(x, shorter, by, coefficients):  # type: ignore[no-untyped-def]
    """Return the values (n,) of a polynomial with these coefficients of its products."""
    values, terms = np.empty(len(x)), np.empty(len(shorter))
    terms[0] = 1.0
    for n in range(len(x)):
        values[n] = coefficients[0]
        for term in range(1, len(shorter)):
            terms[term] = terms[shorter[term]] * x[n, by[term]]
            values[n] += coefficients[term] * terms[term]
    return values


@compiled
def _square(point, centre, inverse):  # type: ignore[no-untyped-def]
    """Return the squared Mahalanobis distance of a point; the inverse is that of the lower triangular factor."""
    square = 0.0
    for i in range(len(point)):
        along = 0.0
        for j in range(i + 1):
            along += inverse[i, j] * (point[j] - centre[j])
        square += along * along
    return square


@compiled
def _log_of_t(flat, centres, inverses, freedoms, constants):  # type: ignore[no-untyped-def]
    """Return the log density of a mixture of t distributions at points (n, d) : (n,) array."""
    d, logs, each = flat.shape[1], np.empty(len(flat)), np.empty(len(centres))
    for n in range(len(flat)):
        for k in range(len(centres)):
            square = _square(flat[n], centres[k], inverses[k])
            each[k] = constants[k] - 0.5 * (freedoms[k] + d) * np.log1p(square / freedoms[k])
        largest = each.max()
        logs[n] = largest + np.log(np.sum(np.exp(each - largest)))
    return logs


@compiled
def _moments_of_each(flat, weights, centres, inverses, constants):  # type: ignore[no-untyped-def]
    """Return what belongs to each normal component: its weight, and sums of distances from its centre and products."""
    (count, d), number = flat.shape, len(centres)
    shares, sums, squares = np.zeros(number), np.zeros((number, d)), np.zeros((number, d, d))
    each = np.empty(number)
    for n in range(count):
        for k in range(number):
            each[k] = constants[k] - 0.5 * _square(flat[n], centres[k], inverses[k])
        each[:] = np.exp(each - each.max())
        each *= weights[n] / each.sum()
        for k in range(number):
            if each[k] <= 1e-6 * weights[n]:
                continue
            shares[k] += each[k]
            for i in range(d):
                away = each[k] * (flat[n, i] - centres[k, i])
                sums[k, i] += away
                for j in range(d):
                    squares[k, i, j] += away * (flat[n, j] - centres[k, j])
    return shares, sums, squares


def _spread_out(flat: Floats, weights: Floats, number: int, whole: Floats) -> Integers:
    """Return points far from each other: the heaviest, then each time the one that is farthest by weight."""
    white = flat @ np.linalg.inv(np.linalg.cholesky(whole)).T
    chosen = [int(np.argmax(weights))]
    nearest = np.full(len(flat), np.inf)
    for _ in range(number - 1):
        nearest = np.minimum(nearest, np.sum((white - white[chosen[-1]]) ** 2, axis=1))
        chosen.append(int(np.argmax(weights * nearest)))
    return np.array(chosen)


def _to_grain(values: Floats, scales: Floats) -> Floats:
    """Round to a small part of scales, so that the last digits do not depend on the processor."""
    grain = 2.0 ** np.floor(np.log2(_GRAIN * scales))
    return np.asarray(grain * np.round(values / grain))


# Importance sampling: draws from a proposal, as many as are needed, and from another one while their weights fail

_ALIVE = 0.1  # share of effective draws to which a proposal is fitted


class Draws(NamedTuple):
    """Weighted draws of a posterior."""

    points: Floats  # (n, d)
    log_density: Floats  # (n,): of the posterior there, up to a constant; -inf where it vanishes
    log_drawn: Floats  # (n,): of what they are drawn by
    found: Any  # what else is known there: a named tuple or an object that `joined` others

    @property
    def log_weights(self) -> Floats:
        """Logs of the weights : (n,) array, -inf where the density vanishes."""
        return self.log_density - self.log_drawn

    def joined(self, other: Draws) -> Draws:
        """Return these draws followed by others."""
        points, log_density, log_drawn = (np.concatenate(both) for both in zip(self[:3], other[:3], strict=True))
        return Draws(points, log_density, log_drawn, self.found.joined(other.found))


def of_mixture(parts: Sequence[tuple[Proposal, Draws]]) -> Draws:
    """Return the draws of several proposals as draws of their mixture."""
    # Owen and Zhou, doi:10.1080/01621459.2000.10473909
    draws = reduce(Draws.joined, (own for _, own in parts))
    if len(parts) == 1:
        return draws
    logs = [np.log(len(own.points) / len(draws.points)) + one.log_density(draws.points) for one, own in parts]
    return draws._replace(log_drawn=logsumexp(logs, axis=0))


def fitted(points: Floats, log_weights: Floats, count: int) -> Proposal:
    """Return a proposal fitted to points with weights to a power that leaves a tenth of a number of draws effective."""
    return Proposal.fitted(points, tempered(log_weights, _ALIVE * count))


class Sampler(abc.ABC):
    """A posterior that importance sampling draws from."""

    @property
    @abc.abstractmethod
    def dimensions(self) -> int:
        """Number of columns of a point."""

    @abc.abstractmethod
    def weighted(self, points: Floats, log_drawn: Floats, near: Draws | None = None) -> Draws:
        """Evaluate the posterior at points (n, d); `near` are draws in whose neighbourhood they lie."""

    @abc.abstractmethod
    def result(self, draws: Draws, proposal: Proposal) -> Any:
        """Return what the draws of a proposal tell, with `gates` on them."""

    def log_weights(self, draws: Draws) -> Floats:
        """Return the log weights by which draws are enough : (n,) array."""
        return draws.log_weights

    def refitted(self, draws: Draws, first: int) -> Proposal:
        """Return a proposal fitted to draws, of which so many were the first."""
        return fitted(draws.points, self.log_weights(draws), first)

    def drawn(
        self, proposal: Proposal, count: int, seed: int = 0, near: Draws | None = None, *, after: int = 0
    ) -> Draws:
        """Draw from a proposal, from a place in the quasi-random sequence of a seed on."""
        points = proposal.drawn(quasi_random(self.dimensions + 2, count, seed, after))
        return self.weighted(points, proposal.log_density(points), near)

    def sample(
        self, proposal: Proposal, numbers: tuple[float, int, int], seeds: Iterable[int], near: Draws | None = None
    ) -> Any:
        """Draw until enough draws are effective; while a gate fails, fit a proposal to all and draw more, by a seed."""
        enough, first, most = numbers  # effective draws that are enough, first and most draws of a proposal
        parts: list[tuple[Proposal, Draws]] = []
        for seed in seeds:
            own = self.drawn(proposal, first, seed, near)
            draws = of_mixture([*parts, (proposal, own)])
            while effective(normalised(self.log_weights(draws))) < enough and len(own.points) < most:
                own = own.joined(self.drawn(proposal, len(own.points), seed, near, after=len(own.points)))
                draws = of_mixture([*parts, (proposal, own)])
            parts.append((proposal, own))
            result = self.result(draws, proposal)
            if all(gate.passed for gate in result.gates):
                break
            proposal, near = self.refitted(draws, first), draws
        return result


# Coordinates in which a posterior over several coordinates is nearly normal: those that importance sampling draws


@dataclass(frozen=True, eq=False)
class Frame:
    """Points (log Ca, a/l, the normal score of each further coordinate under its prior, and l in standard errors)."""

    # A coordinate that the data tell nothing of is standard normal then, and one whose range the data end at is not
    # cut.

    domain: Domain
    coordinates: tuple[Coordinate, ...]  # those by a known thickness have no column
    half_width: Quantity | None  # where it is a dimension
    central_width: float  # [m]: where it is none

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the coordinates that have a column, in their order after the place."""
        return tuple(each.name for each in self.coordinates if not each.distribution.known)

    @property
    def dimensions(self) -> int:
        """Number of columns of a point."""
        return PLACE + len(self.columns) + (self.half_width is not None)

    def column(self, name: str) -> int:
        """Return the column of a further coordinate."""
        return PLACE + self.columns.index(name)

    def of_prior(self, uniform: Floats) -> Floats:
        """Return points (n, d) of the unit cube (n, d) as draws of the priors, uniform in the box about the domain."""
        points = np.empty_like(uniform)
        low, high = self._box
        points[:, :PLACE] = low + (high - low) * uniform[:, :PLACE]
        points[:, PLACE:] = ndtri(uniform[:, PLACE:])
        if self.half_width is not None:
            known = self.half_width
            points[:, -1] = (known.ppf(uniform[:, -1]) - known.value) / known.error
        return points

    def theta(self, points: Floats) -> dict[str, Floats]:
        """Return the quantities at points (n, d), by name : (n,) arrays."""
        theta = {"capillary_number": np.exp(points[:, 0]), "size_ratio": points[:, 1]}
        if self.half_width is not None:
            theta["half_width"] = self.half_width.value + self.half_width.error * points[:, -1]
        for each in self.coordinates:
            shares = ndtr(points[:, self.column(each.name)]) if each.name in self.columns else np.ones(len(points))
            theta[each.name] = each.values(shares)
            if each.by_thickness:
                theta[THICKNESS] = theta[each.name]
                radius = theta["size_ratio"] * theta.get("half_width", self.central_width)
                theta[each.name] = bending(membrane_thickness=theta[THICKNESS], capsule_radius=radius)
        return theta

    def log_prior(self, points: Floats) -> Floats:
        """Return the log density of the coordinates' normal scores : (n,) array."""
        scores = points[:, PLACE : PLACE + len(self.columns)]
        return np.asarray(-0.5 * np.sum(scores**2 + np.log(2.0 * np.pi), axis=1))

    def log_of_prior(self, points: Floats) -> Floats:
        """Return the log density of `of_prior` where the half width is no dimension : (n,) array, -inf off the box."""
        low, high = self._box
        within = np.all((points[:, :PLACE] >= low) & (points[:, :PLACE] <= high), axis=1)
        return np.where(within, self.log_prior(points) - np.sum(np.log(high - low)), -np.inf)

    def evaluated(self, model: ForwardModel, density: PosteriorDensity, points: Floats) -> tuple[Nodes, Floats]:
        """Evaluate a model at points (n, d), and the log of the posterior density there : (n,) array, see below."""
        theta = self.theta(points)
        there = density.evaluated(model, theta)
        nodes = Nodes(points[:, 0], points[:, 1], np.ones(len(points)), there, np.empty(0, np.int64))
        return nodes, self.log_density(density, points, nodes, theta.get("half_width"))

    def log_density(
        self, density: PosteriorDensity, points: Floats, nodes: Nodes, width: Floats | None = None
    ) -> Floats:
        """Return the log of the posterior density at points (n, d) : (n,) array, -inf where it vanishes."""
        # The half width (n,) is given where it is a dimension.
        possible = np.isfinite(nodes.model.extent)
        if width is not None:
            possible &= width > 0.0
            width = width[possible]
        logs = np.full(len(points), -np.inf)
        if possible.any():
            there = nodes.taken(possible)
            found = density.log_of_nodes(there.model, there.log_ca, there.size, width)
            logs[possible] = np.where(np.isnan(found), -np.inf, found + self.log_prior(points[possible]))
        return logs

    @property
    def _box(self) -> tuple[Floats, Floats]:
        (ca_low, ca_high), (size_low, size_high) = self.domain.bounds
        return np.array([np.log(ca_low), size_low]), np.array([np.log(ca_high), size_high])


def check_thickness(coordinates: tuple[Coordinate, ...], experiment: Experiment, domain: Domain) -> None:
    """Refuse a thickness of the membrane that leaves the range of the bending modulus at every size of the model."""
    for each in coordinates:
        if not each.by_thickness:
            continue
        sizes = experiment.half_width.value * np.array(domain.bounds[1])
        ends = membrane_thickness(bending=np.array([each.low, each.high]), capsule_radius=sizes)
        stated = each.distribution
        covered = float(ends[0] <= stated.value <= ends[1]) if stated.known else float(np.diff(stated.cdf(ends))[0])
        if covered < LEAST_COVERED:
            low, high = (f"{PARAMETERS[THICKNESS].shown(end):.3g}" for end in ends)
            expected = f"a thickness from {low} to {high} um, which the bending moduli of the model stand for"
            got = f"{stated} ({covered:.0%} of it within)"
            raise InputError(experiment.source or "experiment", THICKNESS, expected, got)
