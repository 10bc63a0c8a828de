"""The surrogate over flow, size and membrane, made of local polynomials about scattered states."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, product
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.errors import DatabaseError
from capsbayes.measurement import MID_PLANE, check_view
from capsbayes.membrane_database import FREE_PARAMETERS, NULL_VALUES, RANGES, THICK, MembraneDatabase, covered
from capsbayes.model import CoordinateRange, Domain
from capsbayes.prediction import Prediction
from capsbayes.profile import vertex_normals
from capsbayes.surrogate.plane import OUTLINES, DatabaseModel, aligned

# Coordinates in which what is seen of a capsule depends smoothly on the parameters of flow and membrane.
#
# The tension of an inflated sphere is 2 K alpha to first order: inflation counts by it, on a scale that is fine where
# the dimple ends and coarse beyond. Ca and K count by their logarithm, bending by its root, the width of a rim

_FINE = 0.04  # tension over G_s up to which inflation counts about evenly
_COUNTS = np.array([0.6, 0.6, 0.8, 1.5, 1.0, 2.5])  # change of each coordinate, over its spread, that counts as one


def coordinates(values: Floats) -> Floats:
    """Return the coordinates (n, 6) of parameters (n, 6) in the order of `FREE_PARAMETERS`."""
    ca, size, inflation, modulus, hardening, bending = values.T
    columns = np.log(ca), size, np.log(2.0 * modulus * inflation + _FINE), np.log(modulus), hardening, np.sqrt(bending)
    return np.stack(columns, axis=1)


def along_coordinates(values: Floats, along: Floats) -> Floats:
    """Turn derivatives (n, q, 6) along the parameters into derivatives (n, q, 6) along the coordinates."""
    ca, _, inflation, modulus, _, bending = values.T[:, :, None]
    turned = along.copy()
    turned[..., 0] *= ca
    per_tension = along[..., 2] / (2.0 * modulus)  # at constant K
    turned[..., 2] = per_tension * (2.0 * modulus * inflation + _FINE)
    turned[..., 3] = modulus * along[..., 3] - 2.0 * modulus * inflation * per_tension  # at constant tension
    turned[..., 5] *= 2.0 * np.sqrt(bending)
    return turned


@dataclass(frozen=True, eq=False)
class StateCoordinates:
    """Coordinates about the middle (6,) of a set of states, scaled (6,) so that one counts as much as another."""

    middle: Floats
    scale: Floats

    @classmethod
    def of(cls, values: Floats) -> StateCoordinates:
        """Return that of states with parameters (n, 6): by their thin membranes, where most of the states are."""
        raw = coordinates(values[values[:, -1] <= THICK])
        return cls(raw.mean(axis=0), _COUNTS * raw.std(axis=0))

    def points(self, values: Floats) -> Floats:
        """Return the scaled coordinates (n, 6) of parameters (n, 6)."""
        return (coordinates(values) - self.middle) / self.scale

    def slopes(self, values: Floats, along: Floats) -> Floats:
        """Turn derivatives (n, q, 6) along the parameters into those along the scaled coordinates."""
        return along_coordinates(values, along) * self.scale


# Compiled evaluation of local polynomials: their weighted mean at each point, and how far they differ there

_DECAY = 4.0  # of the weights exp(-decay s^2) (1 - s^2)^2 at the share s of a reach
_FEWEST = 4  # polynomials whose differences tell an error
_SUMS = {"reassoc", "contract", "nsz"}  # sums in any order, so that they are vectors to the processor


@njit(cache=True, nogil=True, error_model="numpy")
def _square(point, place):  # type: ignore[no-untyped-def]
    square = 0.0
    for axis in range(6):
        square += (point[axis] - place[axis]) ** 2
    return square


@njit(cache=True, nogil=True, error_model="numpy")
def _cell(point, edges):  # type: ignore[no-untyped-def]
    """Return the number of the cell of a point; `edges` (6, c - 1) lie between the c cells of each axis."""
    cell = 0
    for axis in range(6):
        here = 0
        for edge in edges[axis]:
            here += point[axis] > edge
        cell = cell * (edges.shape[1] + 1) + here
    return cell


@njit(cache=True, nogil=True, error_model="numpy")
def _about(point, places, reaches, trust, lost, cells, taken, weights):  # type: ignore[no-untyped-def]
    """Fill in the states that reach a point and their weights; return how many there are and the sum of the weights.

    None if they are too few, or if a place without a state is nearer than all of them. `places` are (n, 6), `lost`
    (m, 6), `trust` (n,) is a factor of the weights, `cells` are those of `LocalFits`.
    """
    edges, starts, members = cells
    count, total, nearest = 0, 0.0, np.inf
    cell = _cell(point, edges)
    for state in members[starts[cell] : starts[cell + 1]]:
        square = _square(point, places[state])
        share = square / reaches[state] ** 2
        if share < 1.0:
            taken[count] = state
            weights[count] = trust[state] * np.exp(-_DECAY * share) * (1.0 - share) ** 2
            total += weights[count]
            nearest = min(nearest, square)
            count += 1
    if count < _FEWEST:
        return 0, 0.0
    for place in lost:
        if _square(point, place) < nearest:
            return 0, 0.0
    return count, total


@njit(cache=True, nogil=True, error_model="numpy")
def reached(points, places, reaches, trust, lost, cells):  # type: ignore[no-untyped-def]
    """Return whether the polynomials hold at each point : (n,) bool array."""
    taken, weights = np.empty(len(reaches), np.int64), np.empty(len(reaches))
    enough = np.empty(len(points), np.bool_)
    for n in range(len(points)):
        enough[n] = _about(points[n], places, reaches, trust, lost, cells, taken, weights)[0] > 0
    return enough


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_terms(point, terms):  # type: ignore[no-untyped-def]
    """Fill in the terms (28,) of the polynomials at a point."""
    terms[0] = 1.0
    terms[1:7] = point
    term = 7
    for i in range(6):
        for j in range(i, 6):
            terms[term] = point[i] * point[j]
            term += 1


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_SUMS)
def _polynomial(terms, coefficients, found):  # type: ignore[no-untyped-def]
    """Fill in the values (q,) of a polynomial with coefficients (q, 28)."""
    for q in range(len(found)):
        value = 0.0
        for term in range(len(terms)):
            value += terms[term] * coefficients[q, term]
        found[q] = value


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_SUMS)
def _add(weight, coefficients, mixed):  # type: ignore[no-untyped-def]
    """Add weighted coefficients (q, 28) of a polynomial."""
    for q in range(len(mixed)):
        for term in range(mixed.shape[1]):
            mixed[q, term] += weight * coefficients[q, term]


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_slopes(point, mixed, slopes):  # type: ignore[no-untyped-def]
    """Fill in the derivatives (q, 6) of a polynomial with coefficients (q, 28)."""
    for q in range(len(mixed)):
        slopes[q] = mixed[q, 1:7]
        term = 7
        for i in range(6):
            for j in range(i, 6):
                slopes[q, i] += mixed[q, term] * point[j]
                slopes[q, j] += mixed[q, term] * point[i]
                term += 1


@njit(cache=True, nogil=True, error_model="numpy")
def averaged(points, places, reaches, trust, lost, cells, coefficients, errors, width, spread, sloping):  # type: ignore[no-untyped-def]
    """Return means (n, width) at points (n, 6), covariances (n, spread, spread) and slopes (n, width, 6) if `sloping`.

    The covariances are those of the first `spread` values about their means, and of the errors of the states. The
    slopes are those of the mean polynomial, whose weights are held: the derivatives of a diffuse approximation; (0,
    width, 6) if not `sloping`. Rows of points where the polynomials do not hold are NaN.
    """
    count = len(points)
    means, covariances = np.full((count, width), np.nan), np.full((count, spread, spread), np.nan)
    slopes = np.full((count if sloping else 0, width, 6), np.nan)
    first = 0 if sloping else spread  # below it, means of values take less time than a mean polynomial
    taken, weights = np.empty(len(reaches), np.int64), np.empty(len(reaches))
    terms, found, origin = np.empty(coefficients.shape[2]), np.empty(spread), np.empty(spread)
    mixed, second = np.empty((width, coefficients.shape[2])), np.empty((spread, spread))
    for n in range(count):
        some, total = _about(points[n], places, reaches, trust, lost, cells, taken, weights)
        if some:
            _fill_terms(points[n], terms)
            mixed[:], second[:], means[n] = 0.0, 0.0, 0.0
            for k in range(some):
                weight = weights[k] / total
                _add(weight, coefficients[taken[k], first:], mixed[first:])
                _polynomial(terms, coefficients[taken[k]], found)
                if k == 0:
                    origin[:] = found  # differences to it lose no digits
                for i in range(spread):
                    means[n, i] += weight * found[i]
                    error = weight * errors[taken[k], i]
                    for j in range(i + 1):
                        second[i, j] += weight * (found[i] - origin[i]) * (found[j] - origin[j])
                        second[i, j] += error * errors[taken[k], j]
            _polynomial(terms, mixed[first:], means[n, first:])
            if sloping:
                _fill_slopes(points[n], mixed, slopes[n])
            for i in range(spread):
                for j in range(i + 1):
                    centred = second[i, j] - (means[n, i] - origin[i]) * (means[n, j] - origin[j])
                    covariances[n, i, j] = covariances[n, j, i] = centred
    return means, covariances, slopes


@njit(cache=True, nogil=True, error_model="numpy")
def each(point, places, reaches, trust, lost, cells, coefficients, errors):  # type: ignore[no-untyped-def]
    """Return the weights (k,) of the polynomials that reach one point, their values there and errors, (k, q) each."""
    taken, weights = np.empty(len(reaches), np.int64), np.empty(len(reaches))
    some, total = _about(point, places, reaches, trust, lost, cells, taken, weights)
    values, terms = np.empty((some, coefficients.shape[1])), np.empty(coefficients.shape[2])
    _fill_terms(point, terms)
    for k in range(some):
        _polynomial(terms, coefficients[taken[k]], values[k])
    return weights[:some] / total, values, errors[taken[:some]]


# Quadratic polynomials about each state, fitted to the values and the derivatives of its neighbours.
#
# A diffuse approximation whose weights are those of the states, so that its polynomials are computed once; a prediction
# is the mean of those about it, with weights that fall smoothly to zero

_NEIGHBOURS = 30  # of a fit, the state itself included
_FIT_DECAY = 4.0  # of the weights exp(-decay (r/R)^2) of a fit
_SLOPES = 0.5  # weight of a derivative over the radius of the fit, beside a value
_RIDGE = 1e-6
_FLOOR = 0.3  # of the median misfit of the polynomials, below which a smaller one counts for little
_REACH = 20  # a state takes part in predictions up to its neighbour of this rank
_CHUNK = 200
_CELLS = 4  # of the lattice along each axis

PAIRS = tuple(combinations_with_replacement(range(6), 2))
TERMS = 1 + 6 + len(PAIRS)


class Cells(NamedTuple):
    """Cells of a lattice over the coordinates, and the states that reach some point of each."""

    edges: Floats  # (6, c - 1): between the c cells of each axis; the outer ones have no end
    starts: Integers  # (c^6 + 1,): where the members of each cell begin, the last axis running fastest
    members: Integers  # (k,): numbers of states

    @classmethod
    def of(cls, places: Floats, reaches: Floats) -> Cells:
        """Return those of states at places (n, 6)."""
        edges = np.quantile(places, np.arange(1, _CELLS) / _CELLS, axis=0).T
        ends = np.pad(edges, ((0, 0), (1, 1)), constant_values=((0, 0), (-np.inf, np.inf)))
        low, high = ends[:, :-1, None], ends[:, 1:, None]
        apart = np.maximum(np.maximum(low - places.T[:, None], places.T[:, None] - high), 0.0) ** 2
        members, counts = [], []
        for first in product(range(_CELLS), repeat=3):
            square = sum(apart[axis, cell] for axis, cell in enumerate(first)) - reaches**2
            for axis in (3, 4, 5):
                square = square[..., None, :] + apart[axis]
            reached = np.reshape(square < 0.0, (-1, len(places)))
            members.append(np.nonzero(reached)[1])
            counts.append(reached.sum(axis=1))
        starts = np.concatenate([[0], np.cumsum(np.concatenate(counts))])
        return cls(edges, starts, np.concatenate(members).astype(np.int32))


class LocalFits(NamedTuple):
    """Polynomials about n states in scaled coordinates."""

    # Next to a limit of existence, or where a feature comes or goes, a polynomial does not fit its own neighbours. None
    # holds nearer to a lost place than to a state that reaches it.

    places: Floats  # (n, 6)
    reaches: Floats  # (n,): distance up to which each takes part in predictions
    trust: Floats  # (n,): factor of the weight in predictions
    lost: Floats  # (m, 6): places without a state
    cells: Cells  # which of them may reach a point
    coefficients: Floats  # (n, q, 28): of 1, the six coordinates and their products in the order of `PAIRS`
    errors: Floats  # (n, q): of the values of each state, over the factor of the differences between polynomials


def local_fits(places: Floats, values: Floats, along: Floats, lost: Floats, errors: Floats) -> LocalFits:
    """Fit the polynomials to values (n, q), with errors (n, q), and derivatives (n, q, 6) at scaled places (n, 6)."""
    distances, neighbours = map(np.asarray, KDTree(places).query(places, max(_NEIGHBOURS, _REACH)))
    radii = 1.05 * distances[:, _NEIGHBOURS - 1]
    coefficients, misfit = np.empty((len(places), values.shape[1], TERMS)), np.empty(len(places))
    for start in range(0, len(places), _CHUNK):
        some = slice(start, start + _CHUNK)
        fitted, misfit[some] = _fitted(places, values, along, neighbours[some, :_NEIGHBOURS], radii[some])
        coefficients[some] = _about_zero(fitted, places[some], radii[some]).swapaxes(1, 2)
    usual = max(float(np.median(misfit)), np.finfo(np.float64).tiny)
    trust = 1.0 / (misfit / usual + _FLOOR**2)
    reaches = np.ascontiguousarray(distances[:, _REACH - 1])
    cells = Cells.of(places, reaches)
    return LocalFits(places, reaches, trust, lost, cells, coefficients, errors)


def _fitted(
    places: Floats, values: Floats, along: Floats, neighbours: Integers, radii: Floats
) -> tuple[Floats, Floats]:
    """Fit states with neighbours (c, k), themselves first: coefficients (c, 28, q), mean squares (c,) of the misfit."""
    away = (places[neighbours] - places[neighbours[:, :1]]) / radii[:, None, None]
    weights = np.exp(-_FIT_DECAY * np.sum(away**2, axis=-1))[..., None]
    rows = [weights * _terms(away)]
    wanted = [weights * values[neighbours]]
    for axis, slopes in enumerate(_slopes(away)):
        rows.append(_SLOPES * weights * slopes)
        wanted.append(_SLOPES * weights * radii[:, None, None] * along[neighbours, :, axis])
    matrix, right = np.concatenate(rows, axis=1), np.concatenate(wanted, axis=1)
    sizes = np.sqrt(np.sum(matrix**2, axis=1))[:, None]
    matrix /= sizes
    transposed = matrix.swapaxes(1, 2)
    solved = np.linalg.solve(transposed @ matrix + _RIDGE * np.eye(TERMS), transposed @ right)
    of_values = slice(neighbours.shape[1])
    square = np.sum((matrix[:, of_values] @ solved - right[:, of_values]) ** 2, axis=(1, 2))
    misfit = square / np.sum(weights**2, axis=(1, 2))
    return np.asarray(solved / sizes.swapaxes(1, 2)), misfit


def _about_zero(coefficients: Floats, places: Floats, radii: Floats) -> Floats:
    """Turn polynomials (n, 28, q) in distances from a state over its radius into such in the coordinates."""
    lines, columns = np.triu_indices(6)
    squares = np.zeros((len(places), 6, 6, coefficients.shape[-1]))
    squares[:, lines, columns] = coefficients[:, 7:] / radii[:, None, None] ** 2
    slopes = coefficients[:, 1:7] / radii[:, None, None]
    both = np.einsum("nijq,nj->niq", squares + squares.swapaxes(1, 2), places)
    moved = np.empty_like(coefficients)
    moved[:, 0] = coefficients[:, 0] + np.einsum("niq,ni->nq", 0.5 * both - slopes, places)
    moved[:, 1:7] = slopes - both
    moved[:, 7:] = squares[:, lines, columns]
    return moved


def _terms(away: Floats) -> Floats:
    """Return the 28 terms (..., 28) at distances (..., 6)."""
    products = [away[..., i] * away[..., j] for i, j in PAIRS]
    return np.concatenate([np.ones((*away.shape[:-1], 1)), away, np.stack(products, axis=-1)], axis=-1)


def _slopes(away: Floats) -> Floats:
    """Return the derivatives of the terms along each coordinate : (6, ..., 28) array."""
    slopes = np.zeros((6, *away.shape[:-1], TERMS))
    for axis in range(6):
        slopes[axis, ..., 1 + axis] = 1.0
    for place, (i, j) in enumerate(PAIRS, start=7):
        slopes[i, ..., place] += away[..., j]
        slopes[j, ..., place] += away[..., i]
    return slopes


# Domain of existence of the surrogate over the membrane's parameters

_PLAIN = dict(zip(FREE_PARAMETERS, NULL_VALUES, strict=True))


@dataclass(frozen=True, eq=False)
class MembraneDomain(Domain):
    """Points that enough polynomials reach, and that are nearer to a state than to a lost one."""

    frame: StateCoordinates
    fits: LocalFits
    cross_section: str

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        return RANGES[0], RANGES[1]

    def contains(self, capillary_number: ArrayLike, size_ratio: ArrayLike, *further: ArrayLike) -> Booleans:
        columns = (capillary_number, size_ratio, *further, *NULL_VALUES[2 + len(further) :])
        values = np.stack(aligned(*columns), axis=1)
        inside = covered(values, self.cross_section)
        inside[inside] = reached(self.frame.points(values[inside]), *self.fits[:5])
        return inside

    def at(self, values: Mapping[str, float]) -> Domain:
        return FixedMembraneDomain(self, dict(values))

    def reason(self, capillary_number: float, size_ratio: float, **further: float) -> str:
        known = _PLAIN | further | {"capillary_number": capillary_number, "size_ratio": size_ratio}
        for name, (low, high) in zip(FREE_PARAMETERS, RANGES, strict=True):
            if not low <= known[name] <= high:
                return f"{name} = {known[name]:.4g} lies outside {low:.4g} to {high:.4g}"
        return "no steady shape is stored there"


@dataclass(frozen=True, eq=False)
class FixedMembraneDomain(Domain):
    """Part of the domain at given values, by name, of some of the membrane's parameters."""

    whole: Domain
    held: Mapping[str, float]

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        return self.whole.bounds

    def contains(self, capillary_number: ArrayLike, size_ratio: ArrayLike, *further: ArrayLike) -> Booleans:
        others = [name for name in FREE_PARAMETERS[2:] if name not in self.held]
        known = _PLAIN | dict(self.held) | dict(zip(others, further, strict=False))
        return self.whole.contains(capillary_number, size_ratio, *(known[name] for name in FREE_PARAMETERS[2:]))

    def at(self, values: Mapping[str, float]) -> Domain:
        return FixedMembraneDomain(self.whole, {**self.held, **values})

    def reason(self, capillary_number: float, size_ratio: float, **further: float) -> str:
        return self.whole.reason(capillary_number, size_ratio, **{**self.held, **further})


# The surrogate over flow and membrane: (Ca, a/l, alpha, K, h, B) to what is seen of a capsule

_NUMBERS, _ERRING = 4, 3  # L_z, L_a, v_o/U and Lambda, of which the first have a covariance; then follow the modes
_LENGTH = 1  # of the numbers, L_a
_LOGARITHMIC = ("area_dilation_modulus", "bending")  # of which the order of magnitude is not known
_CHANGES = 0.3  # of the distance up to which states take part in predictions: over it the error changes
_ERROR = 0.8  # standard deviations of the error for one of the differences between local polynomials


class MembraneSurrogate(DatabaseModel):
    """Forward model over six parameters, by diffuse approximation of scattered states with their derivatives.

    Parameters
    ----------
    membrane_database : MembraneDatabase
    view : str
        Outlines that it predicts: ``"mid-plane"`` or ``"silhouette"``.

    Examples
    --------
    >>> model = MembraneSurrogate.open("square")
    >>> soft = model.at(capillary_number=0.05, size_ratio=0.9)
    >>> hard = model.at(capillary_number=0.05, size_ratio=0.9, strain_hardening=0.8, pre_inflation=0.03)
    >>> bool(hard.parachute_depth[0] < soft.parachute_depth[0])
    True
    """

    def __init__(self, membrane_database: MembraneDatabase, view: str = MID_PLANE) -> None:
        self.membrane_database, self.view = membrane_database, check_view(view, "MembraneSurrogate", "view")
        states, kind = membrane_database, OUTLINES[view]
        self.name = f"{states.cross_section}-membrane"
        self.sha256, self.cross_section = states.sha256, states.cross_section
        self.coordinates = {
            name: CoordinateRange(*ends, null, name in _LOGARITHMIC)
            for name, ends, null in zip(FREE_PARAMETERS[2:], RANGES[2:], NULL_VALUES[2:], strict=True)
        }
        self.stored_coefficients = states[kind]  # (states, k) [l]: of the modes of each stored outline
        self.mode_shapes, self._mean = states[f"{kind}_modes"], states[f"{kind}_mean"]  # (k, p, 2), (p, 2) [l]
        self._frame = StateCoordinates.of(states["values"])
        numbers = np.concatenate([states["numbers"], self.stored_coefficients], axis=1)
        if not states.has_mesh_error:
            raise DatabaseError("membrane database: expected states with the error of their mesh, got none with it")
        of_mesh = np.concatenate([states["numbers_mesh_error"], states[f"{kind}_mesh_error"]], axis=1)
        along = np.concatenate([states["numbers_along"], states[f"{kind}_along"]], axis=1)
        places, slopes = self._frame.points(states["values"]), self._frame.slopes(states["values"], along)
        self._fits = local_fits(places, numbers, slopes, self._frame.points(states["lost"]), of_mesh / _ERROR)
        self._variance = _ERROR**2  # of the error, over that of the local polynomials
        self._width = numbers.shape[1]
        self._change = _CHANGES * float(np.median(self._fits.reaches))  # over it its own error changes
        self.domain = MembraneDomain(self._frame, self._fits, states.cross_section)

    @classmethod
    def open(cls, source: str | os.PathLike[str], *, view: str = MID_PLANE) -> MembraneSurrogate:
        """Make a surrogate of a shipped database, as ``"square"``, or of a file, by path with its ending .nc.

        Raises
        ------
        DatabaseError
            If the database cannot be read, or its states have no error of their mesh.
        InputError
            On an unknown view.
        """
        return cls(MembraneDatabase.open(source), view)

    def __call__(self, theta: Mapping[str, Floats], *, outline: bool = False) -> Prediction:
        means, covariances, _ = self._averaged(theta, self._width if outline else _NUMBERS, _ERRING)
        return self._prediction(means, covariances, outline=outline)

    def outline_modes(self, **theta: float) -> Floats:
        # Two for each local polynomial that contributes at the point: the difference of its prediction from the mean,
        # and the error of its state.
        self.check_names(theta)
        values = parameter_columns({name: np.array([value]) for name, value in theta.items()})
        if not self.domain.contains(*values.T)[0]:
            raise self._outside(theta)
        weights, numbers, errors = each(self._frame.points(values)[0], *self._fits)
        mean = weights @ numbers
        away = np.concatenate([numbers - mean, errors])[:, _NUMBERS:]
        shape = self.outlines_of(mean[None, _NUMBERS:])[0]
        along = np.einsum("km,mpi,pi->kp", away, self.mode_shapes, vertex_normals(shape), optimize=True)
        return np.asarray(np.sqrt(self._variance * np.tile(weights, 2))[:, None] * along)

    def with_coefficients(self, theta: Mapping[str, Floats], *, errors: bool) -> tuple[Prediction, Floats, Floats]:
        """Predict a batch, its outlines as coefficients (n, k) [l] of their modes; NaN outside the domain.

        Third is the covariance (n, k + 1, k + 1) of the errors of coefficients and L_a, of size 0 without `errors`.
        """
        means, covariances, _ = self._averaged(theta, self._width, self._width if errors else _NUMBERS)
        count = self._width - _NUMBERS
        covariance = np.empty((len(means), count + 1, count + 1) if errors else (len(means), 0, 0))
        if errors:
            covariance[:, :count, :count] = covariances[:, _NUMBERS:, _NUMBERS:]
            covariance[:, :count, count] = covariance[:, count, :count] = covariances[:, _NUMBERS:, _LENGTH]
            covariance[:, count, count] = covariances[:, _LENGTH, _LENGTH]
            covariance *= self._variance
        return self._prediction(means, covariances, outline=False), means[:, _NUMBERS:], covariance

    def with_changes(
        self, theta: Mapping[str, Floats], moved: Sequence[Mapping[str, Floats]], *, outline: bool
    ) -> tuple[Prediction, Floats, Floats]:
        """Predict a batch, and to first order its changes with the parameters towards m sets of others.

        Second are the coefficients of the outlines (n, k) [l], k = 0 without `outline`; third the changes (m, n, 4 + k)
        of L_z, L_a, v_o/U, the largest stretch and the coefficients. They are those of the local polynomials that are
        averaged there, at constant weights, also beyond the border: up to twice as near to the derivatives of simulated
        shapes as differences of predictions are.
        """
        width = self._width if outline else _NUMBERS
        means, covariances, slopes = self._averaged(theta, width, _ERRING, slopes=True)
        begin = self._frame.points(parameter_columns(theta))
        away = np.array([self._frame.points(parameter_columns(other)) - begin for other in moved])
        changes = np.einsum("nqa,mna->mnq", slopes, away)
        return self._prediction(means, covariances, outline=False), means[:, _NUMBERS:], changes

    def outlines_of(self, coefficients: Floats) -> Floats:
        """Return the outlines (n, p, 2) [l] with given coefficients (n, k) [l] of the modes."""
        flat = coefficients @ self.mode_shapes.reshape(coefficients.shape[1], -1)
        return self._mean + flat.reshape(-1, *self._mean.shape)

    @property
    def error_lengths(self) -> Floats:
        """Distances in ln Ca and a/l over which its own error changes : (2,) array.

        Between simulated capsules of one membrane the correlation of the error falls as exp(-r^2 / 2), r in these.
        """
        return self._change * self._frame.scale[:2]

    def error_places(self, theta: Mapping[str, Floats]) -> Floats:
        """Return (n, 6) coordinates of a batch, scaled so that the model's own error changes over about one."""
        return np.asarray(self._frame.points(parameter_columns(theta)) / self._change)

    def membrane_places(self, theta: Mapping[str, Floats]) -> Floats:
        """Return the same of the membranes alone : (n, 4) array."""
        return self.error_places(theta)[:, 2:]

    def distances_from_plain(self, name: str, values: Floats) -> Floats:
        """Return how far values (n,) of a parameter are from the plain one, in the unit of `error_places` : (n,)."""
        places = np.tile(np.array(NULL_VALUES), (len(values) + 1, 1))
        column = FREE_PARAMETERS.index(name)
        places[1:, column] = values
        along = self._frame.points(places)[:, column]
        return np.asarray(np.abs(along[1:] - along[0]) / self._change)

    def _averaged(
        self, theta: Mapping[str, Floats], width: int, spread: int, *, slopes: bool = False
    ) -> tuple[Floats, Floats, Floats]:
        """Return values (n, width), the covariance (n, spread, spread) of the differences, and slopes (n, width, 6)."""
        # The slopes are along the scaled coordinates; (0, width, 6) if they are not wanted.
        self.check_names(theta)
        values = parameter_columns(theta)
        inside = covered(values, self.membrane_database.cross_section)
        points = self._frame.points(values[inside])
        means, covariances, along = averaged(points, *self._fits, width, spread, slopes)
        if slopes:
            along = _spread_out(along, inside)
        return _spread_out(means, inside), _spread_out(covariances, inside), along

    def _prediction(self, means: Floats, covariances: Floats, *, outline: bool) -> Prediction:
        inside = np.isfinite(means[:, 0])
        shapes = self.outlines_of(means[:, _NUMBERS:]) if outline else None
        covariance = self._variance * covariances[:, :_ERRING, :_ERRING]
        extent, length, velocity, stretch = means.T[:_NUMBERS]
        return Prediction(extent, length, velocity, stretch, covariance, inside, shapes)


def _spread_out(rows: Floats, inside: Booleans) -> Floats:
    """Return rows at the places of a mask (n,), and NaN elsewhere : (n, ...) array."""
    every = np.full((len(inside), *rows.shape[1:]), np.nan)
    every[inside] = rows
    return every


def parameter_columns(theta: Mapping[str, ArrayLike]) -> Floats:
    """Return the parameters (n, 6) of a batch, at their null values where they are not given."""
    count = np.shape(theta["capillary_number"])
    columns = (np.asarray(theta.get(name, null), np.float64) for name, null in _PLAIN.items())
    return np.stack([np.broadcast_to(column, count) for column in columns], axis=1)
