"""Compiled evaluation of local polynomials: their weighted mean at each point, and how far they differ there."""

from __future__ import annotations

import numpy as np
from numba import njit

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
def averaged(points, places, reaches, trust, lost, cells, coefficients, width, spread, sloping):  # type: ignore[no-untyped-def]
    """Return means (n, width) at points (n, 6), covariances (n, spread, spread) and slopes (n, width, 6) if `sloping`.

    The covariances are those of the first `spread` values about their means. The slopes are those of the mean
    polynomial, whose weights are held: the derivatives of a diffuse approximation; (0, width, 6) if not `sloping`. Rows
    of points where the polynomials do not hold are NaN.
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
                    for j in range(i + 1):
                        second[i, j] += weight * (found[i] - origin[i]) * (found[j] - origin[j])
            _polynomial(terms, mixed[first:], means[n, first:])
            if sloping:
                _fill_slopes(points[n], mixed, slopes[n])
            for i in range(spread):
                for j in range(i + 1):
                    centred = second[i, j] - (means[n, i] - origin[i]) * (means[n, j] - origin[j])
                    covariances[n, i, j] = covariances[n, j, i] = centred
    return means, covariances, slopes


@njit(cache=True, nogil=True, error_model="numpy")
def each(point, places, reaches, trust, lost, cells, coefficients):  # type: ignore[no-untyped-def]
    """Return the weights (k,) of the polynomials that reach one point, and their values (k, q) there."""
    taken, weights = np.empty(len(reaches), np.int64), np.empty(len(reaches))
    some, total = _about(point, places, reaches, trust, lost, cells, taken, weights)
    values, terms = np.empty((some, coefficients.shape[1])), np.empty(coefficients.shape[2])
    _fill_terms(point, terms)
    for k in range(some):
        _polynomial(terms, coefficients[taken[k]], values[k])
    return weights[:some] / total, values
