"""Quadratic polynomials about each state, fitted to the values and the derivatives of its neighbours.

A diffuse approximation whose weights are those of the states, so that its polynomials are computed once; a prediction
is the mean of those about it, with weights that fall smoothly to zero.
"""

from __future__ import annotations

from itertools import combinations_with_replacement, product
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from capsbayes.arrays import Floats, Integers

_NEIGHBOURS = 30  # of a fit, the state itself included
_DECAY = 4.0  # of the weights exp(-decay (r/R)^2) of a fit
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


def local_fits(places: Floats, values: Floats, along: Floats, lost: Floats) -> LocalFits:
    """Fit the polynomials to values (n, q) and their derivatives (n, q, 6) at scaled places (n, 6)."""
    distances, neighbours = map(np.asarray, KDTree(places).query(places, max(_NEIGHBOURS, _REACH)))
    radii = 1.05 * distances[:, _NEIGHBOURS - 1]
    fitted, misfits = [], []
    for start in range(0, len(places), _CHUNK):
        some = slice(start, start + _CHUNK)
        coefficients, misfit = _fitted(places, values, along, neighbours[some, :_NEIGHBOURS], radii[some])
        fitted.append(coefficients)
        misfits.append(misfit)
    coefficients, misfit = _about_zero(np.concatenate(fitted), places, radii), np.concatenate(misfits)
    usual = max(float(np.median(misfit)), np.finfo(np.float64).tiny)
    trust = 1.0 / (misfit / usual + _FLOOR**2)
    reaches = np.ascontiguousarray(distances[:, _REACH - 1])
    cells = Cells.of(places, reaches)
    return LocalFits(places, reaches, trust, lost, cells, np.ascontiguousarray(coefficients.swapaxes(1, 2)))


def _fitted(
    places: Floats, values: Floats, along: Floats, neighbours: Integers, radii: Floats
) -> tuple[Floats, Floats]:
    """Fit states with neighbours (c, k), themselves first: coefficients (c, 28, q), mean squares (c,) of the misfit."""
    away = (places[neighbours] - places[neighbours[:, :1]]) / radii[:, None, None]
    weights = np.exp(-_DECAY * np.sum(away**2, axis=-1))[..., None]
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
