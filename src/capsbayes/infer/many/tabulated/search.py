"""Search on a pyramid of lattices for the cells that carry the posterior of one capsule; compiled.

The search begins on the coarse lattice with widened covariances and goes down: at every level only the cells are
visited that are likely one level above, until the cells resolve the posterior, by the gates of
`capsbayes.infer.grid.quadrature` a little relaxed: half the time, and the same numbers to a hundredth of a standard
deviation. Below the finest lattice the model is interpolated in it, bilinearly. Spans are kept
row by row: row i of log Ca is visited from first[i] to last[i].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Floats, Integers
from capsbayes.infer.grid.lattice import COARSE_DROP
from capsbayes.infer.grid.quadrature import AT_BORDER, DROP, FARTHEST
from capsbayes.infer.kernel import Flow, compiled, feature_in_cells, flow_mismatch, misfit, sd_in_cells, velocity_ratio

FOUND, FAR, UNRESOLVED = 0, 1, 2
"""Ends of a search: resolved; no shape of the model near; not resolved on the finest lattice."""

_CELLS_PER_SD, _CELLS_PER_FEATURE, _CELLS_ACROSS = 3.0, 1.25, 0.9
_NARROWED = 0.7  # cells across a ridge, from which on the cells unlikely on a level are omitted below
_HOPELESS = 100.0  # squared distance beyond that of the nearest node so far, from which on a node is skipped
_TO_BORDER = 10  # column of the pyramid
_INTERPOLATED = 3  # levels below the finest lattice, each twice as fine as the one before


class Seen(NamedTuple):
    """Lengths of one capsule over l, their covariance, the powers of the prior of G_s and of a, and the flow rate.

    The length on the axis is NaN where it is missing.
    """

    extent: float
    length: float
    zz: float
    za: float
    aa: float
    modulus_power: float
    radius_power: float
    flow: Flow


@compiled
def differences(seen: Seen, node: Floats) -> tuple[float, float, float, float, float]:
    """Return measured minus tabulated L_z and L_a, and their covariance : what `kernel.misfit` takes."""
    covariance = seen.zz + node[3], seen.za + node[4], seen.aa + node[5]
    return seen.extent - node[0], seen.length - node[1], *covariance


@compiled
def _log_density(seen: Seen, node: Floats, log_ca: float, size: float, farthest: float) -> tuple[float, float]:
    """Return the log posterior density at a node and the squared distance of the lengths.

    The density is NaN outside the domain, -inf if far.
    """
    square, volume = misfit(*differences(seen, node))
    if square > farthest:
        return -np.inf, square
    log_density = -0.5 * (square + np.log(volume))
    if seen.modulus_power != 0.0:
        log_density -= seen.modulus_power * (log_ca + np.log(node[2]))
    if seen.radius_power != 1.0:
        log_density += (seen.radius_power - 1.0) * np.log(size)
    if not np.isnan(seen.flow.offset):
        mean, left = velocity_ratio(*differences(seen, node), node[2], node[6], node[7], node[8])
        mismatch, total = flow_mismatch(np.log(mean), max(left, 0.0) / mean**2, seen.flow)
        log_density -= 0.5 * (mismatch * mismatch / total + np.log(total))
    return log_density, square


@compiled
def finer_than_tabulated(levels: tuple[Floats, ...], level: int) -> int:
    """Return how many cells of a level lie along a side of a cell of the lattice in which it is looked up."""
    return 2 ** max(level - (len(levels) - 1), 0)


@compiled
def look_up(lattice: Floats, i: int, j: int, finer: int, room: Floats) -> Floats:
    """Return the columns at the centre of a cell of a lattice `finer` times as fine; NaN next to a node without answer.

    Interpolated columns are written into `room`.
    """
    if finer == 1:
        return lattice[i, j]
    x, y = (i + 0.5) / finer - 0.5, (j + 0.5) / finer - 0.5
    left, low = int(np.floor(x)), int(np.floor(y))
    left, low = min(max(left, 0), lattice.shape[0] - 2), min(max(low, 0), lattice.shape[1] - 2)
    x, y = min(max(x - left, 0.0), 1.0), min(max(y - low, 0.0), 1.0)
    for k in range(_TO_BORDER):
        below = (1.0 - y) * lattice[left, low, k] + y * lattice[left, low + 1, k]
        above = (1.0 - y) * lattice[left + 1, low, k] + y * lattice[left + 1, low + 1, k]
        room[k] = (1.0 - x) * below + x * above
    room[_TO_BORDER:] = lattice[i // finer, j // finer, _TO_BORDER:]
    return room


@compiled
def _widened(first: Integers, last: Integers, factor: int, columns: int) -> tuple[Integers, Integers]:
    """Return spans on a lattice `factor` times finer: those given and one cell more on every side."""
    rows = len(first)
    low, high = np.full(rows, columns), np.full(rows, -1)
    for i in range(rows):
        for k in range(max(i - 1, 0), min(i + 2, rows)):
            if last[k] >= 0:
                low[i] = min(low[i], max(first[k] - 1, 0))
                high[i] = max(high[i], min(last[k] + 1, columns - 1))
    finer_low, finer_high = np.full(factor * rows, 0), np.full(factor * rows, -1)
    for i in range(rows):
        if high[i] >= 0:
            finer_low[factor * i : factor * (i + 1)] = factor * low[i]
            finer_high[factor * i : factor * (i + 1)] = factor * high[i] + factor - 1
    return finer_low, finer_high


@compiled
def _first_spans(seen: Seen, lattice: Floats, low: Floats, step: Floats) -> tuple[float, float, Integers, Integers]:
    """Return the distance of the nearest shape, the largest log density, and the likely spans of the first lattice."""
    rows, columns = lattice.shape[:2]
    log_density = np.empty((rows, columns))
    nearest, best = np.inf, -np.inf
    for i in range(rows):
        for j in range(columns):
            log_ca, size = low[0] + step[0] * (i + 0.5), low[1] + step[1] * (j + 0.5)
            value, square = _log_density(seen, lattice[i, j], log_ca, size, nearest + _HOPELESS)
            log_density[i, j] = value
            if square < nearest:
                nearest = square
            if value > best:
                best = value
    first, last = np.full(rows, columns), np.full(rows, -1)
    for i in range(rows):
        for j in range(columns):
            if log_density[i, j] > best - COARSE_DROP:
                first[i] = min(first[i], j)
                last[i] = j
    return np.sqrt(nearest), best, first, last


@compiled
def _resolution(weights: Floats, row: Integers, column: Integers) -> tuple[bool, float]:
    """Return whether the cells resolve the posterior, and the cells in a feature of a/l at given Ca."""
    first_row, first_column = row.min(), column.min()
    rows, columns = np.zeros(row.max() - first_row + 1), np.zeros(column.max() - first_column + 1)
    squares, steps = 0.0, 0.0
    for k in range(len(weights)):
        rows[row[k] - first_row] += weights[k]
        columns[column[k] - first_column] += weights[k]
        squares += weights[k] ** 2
        if k and row[k] == row[k - 1] and column[k] == column[k - 1] + 1:
            steps += (weights[k] - weights[k - 1]) ** 2
    across = feature_in_cells(squares, steps)
    enough = across >= _CELLS_ACROSS
    for masses in (rows, columns):
        enough &= sd_in_cells(masses) >= _CELLS_PER_SD
        enough &= feature_in_cells(np.sum(masses**2), np.sum(np.diff(masses) ** 2)) >= _CELLS_PER_FEATURE
    return enough, across


@compiled
def _visited(
    seen: Seen, lattice: Floats, finer: int, low: Floats, step: Floats, first: Integers, last: Integers
) -> tuple[float, float, Integers, Integers, Floats]:
    """Return the largest log density, the squared distance there, and row, column and log density of cells in spans."""
    count = 0
    for i in range(len(first)):
        count += max(last[i] - first[i] + 1, 0)
    row, column, log_density = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count)
    best, of_best, nearest, k = -np.inf, np.inf, np.inf, 0
    room = np.empty(lattice.shape[2])
    for i in range(len(first)):
        log_ca = low[0] + step[0] * (i + 0.5)
        for j in range(first[i], last[i] + 1):
            node = look_up(lattice, i, j, finer, room)
            value, square = _log_density(seen, node, log_ca, low[1] + step[1] * (j + 0.5), nearest + _HOPELESS)
            if value > -np.inf:
                row[k], column[k], log_density[k] = i, j, value
                k += 1
                nearest = min(nearest, square)
                if value > best:
                    best, of_best = value, square
    return best, of_best, row[:k], column[:k], log_density[:k]


@compiled
def _likely_spans(
    row: Integers, column: Integers, log_density: Floats, least: float, shape: tuple[int, int]
) -> tuple[Integers, Integers]:
    first, last = np.full(shape[0], shape[1]), np.full(shape[0], -1)
    for k in range(len(row)):
        if log_density[k] > least:
            first[row[k]] = min(first[row[k]], column[k])
            last[row[k]] = max(last[row[k]], column[k])
    return first, last


@compiled
def _at_border(lattice: Floats, finer: int, row: Integers, column: Integers, weights: Floats) -> bool:
    nearest = np.inf
    for k in range(len(row)):
        if weights[k] > AT_BORDER:
            nearest = min(nearest, lattice[row[k] // finer, column[k] // finer, _TO_BORDER])
    return nearest <= 1.0


@compiled
def descend(
    seen: Seen, levels: tuple[Floats, ...], low: Floats, step: Floats
) -> tuple[int, int, float, float, float, Integers, Integers, Floats]:
    """Find the cells that carry the posterior of one capsule.

    Parameters
    ----------
    seen : Seen
    levels : tuple of (i, j, c) arrays
        Of `capsbayes.infer.many.tabulated.pyramid.Pyramid`.
    low, step : (2,) arrays
        Corner of the lattices and size of a cell of the first.

    Returns
    -------
    end : int
        FOUND, FAR or UNRESOLVED.
    level : int
        Of the cells.
    distance : float
        Of the lengths from those of the likeliest cell, or of the nearest shape if FAR, in standard deviations.
    log_scale, evidence : float
        Log density of the likeliest cell; the integral of the density over that of the likeliest cell.
    row, column : (n,) arrays
        Of the cells along log Ca and a/l.
    weights : (n,) array
        Probabilities, summing to one.
    """
    nobody, nothing = np.empty(0, np.int64), np.empty(0)
    distance, best, first, last = _first_spans(seen, levels[0], low, step)
    if not distance <= FARTHEST:
        return FAR, 0, distance, best, 0.0, nobody, nobody, nothing
    above = levels[0].shape[0]
    last_level = len(levels) - 1 + _INTERPOLATED
    for level in range(1, last_level + 1):
        finer = finer_than_tabulated(levels, level)
        lattice = levels[min(level, len(levels) - 1)]
        shape = (lattice.shape[0] * finer, lattice.shape[1] * finer)
        factor = shape[0] // above
        first, last = _widened(first, last, factor, shape[1] // factor)
        cell = step * (levels[0].shape[0] / shape[0])
        best, square, row, column, log_density = _visited(seen, lattice, finer, low, cell, first, last)
        above = shape[0]
        if not len(row):
            continue
        weights = np.exp(log_density - best)
        enough, across = _resolution(weights, row, column)
        coarse = level < len(levels) - 1 and _at_border(lattice, finer, row, column, weights)
        if enough and not coarse:
            total = weights.sum()
            return FOUND, level, np.sqrt(square), best, total * cell[0] * cell[1], row, column, weights / total
        if across >= _NARROWED:
            first, last = _likely_spans(row, column, log_density, best - DROP, shape)
    return UNRESOLVED, last_level, distance, best, 0.0, nobody, nobody, nothing
