"""Compiled evaluation of local polynomials: their weighted mean at each point, and how far they differ there."""

from __future__ import annotations

import numpy as np
from numba import njit

_DECAY = 4.0  # of the weights exp(-decay s^2) (1 - s^2)^2 at the share s of a reach
_FEWEST = 4  # polynomials whose differences tell an error
_SUMS = {"reassoc", "contract", "nsz"}  # sums in any order, so that they are vectors to the processor


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_SUMS | {"nnan"})
def _smallest(values):  # type: ignore[no-untyped-def]
    smallest = values[0]
    for value in values:
        smallest = min(smallest, value)
    return smallest


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_SUMS)
def _about(point, places, reaches, trust, lost, squares, taken, weights):  # type: ignore[no-untyped-def]
    """Fill in the states that reach a point and their weights; return how many there are and the sum of the weights.

    None if they are too few, or if a place without a state is nearer than all. `places` are (6, n), `lost` (6, m),
    `trust` (n,) is a factor of the weights, `squares` (n,) is room to work in.
    """
    squares[:] = 0.0
    for axis in range(6):
        here = point[axis]
        for state in range(len(squares)):
            squares[state] += (here - places[axis, state]) ** 2
    count, total = 0, 0.0
    for state in range(len(squares)):
        if squares[state] < reaches[state] ** 2:
            share = squares[state] / reaches[state] ** 2
            taken[count] = state
            weights[count] = trust[state] * np.exp(-_DECAY * share) * (1.0 - share) ** 2
            total += weights[count]
            count += 1
    if count < _FEWEST:
        return 0, 0.0
    nearest = _smallest(squares)
    for place in range(lost.shape[1]):
        square = 0.0
        for axis in range(6):
            square += (point[axis] - lost[axis, place]) ** 2
        if square < nearest:
            return 0, 0.0
    return count, total


@njit(cache=True, nogil=True, error_model="numpy")
def reached(points, places, reaches, trust, lost):  # type: ignore[no-untyped-def]
    """Return whether the polynomials hold at each point : (n,) bool array."""
    squares, taken, weights = np.empty(len(reaches)), np.empty(len(reaches), np.int64), np.empty(len(reaches))
    enough = np.empty(len(points), np.bool_)
    for n in range(len(points)):
        enough[n] = _about(points[n], places, reaches, trust, lost, squares, taken, weights)[0] > 0
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
def averaged(points, places, reaches, trust, lost, coefficients, width, spread, sloping):  # type: ignore[no-untyped-def]
    """Return means (n, width) at points (n, 6), covariances (n, spread, spread) and slopes (n, width, 6) if `sloping`.

    The covariances are those of the first `spread` values about their means. The slopes are those of the mean
    polynomial, whose weights are held: the derivatives of a diffuse approximation; (0, width, 6) if not `sloping`. Rows
    of points where the polynomials do not hold are NaN.
    """
    count = len(points)
    means, covariances = np.full((count, width), np.nan), np.full((count, spread, spread), np.nan)
    slopes = np.full((count if sloping else 0, width, 6), np.nan)
    first = 0 if sloping else spread  # below it, means of values take less time than a mean polynomial
    squares, taken, weights = np.empty(len(reaches)), np.empty(len(reaches), np.int64), np.empty(len(reaches))
    terms, found, origin = np.empty(coefficients.shape[2]), np.empty(spread), np.empty(spread)
    mixed, second = np.empty((width, coefficients.shape[2])), np.empty((spread, spread))
    for n in range(count):
        some, total = _about(points[n], places, reaches, trust, lost, squares, taken, weights)
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
def each(point, places, reaches, trust, lost, coefficients):  # type: ignore[no-untyped-def]
    """Return the weights (k,) of the polynomials that reach one point, and their values (k, q) there."""
    squares, taken, weights = np.empty(len(reaches)), np.empty(len(reaches), np.int64), np.empty(len(reaches))
    some, total = _about(point, places, reaches, trust, lost, squares, taken, weights)
    values, terms = np.empty((some, coefficients.shape[1])), np.empty(coefficients.shape[2])
    _fill_terms(point, terms)
    for k in range(some):
        _polynomial(terms, coefficients[taken[k]], values[k])
    return weights[:some] / total, values
