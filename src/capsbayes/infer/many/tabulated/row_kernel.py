"""Compiled rows of capsules whose lengths were measured, one after the other, from a pyramid.

The numbers are those of a `GridPosterior`, without an object for each capsule.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Floats, Integers
from capsbayes.infer.kernel import (
    NUDGE,
    Flow,
    border_steps,
    compiled,
    flow_mismatch,
    given_flow,
    p_value,
    p_values_of_lengths,
    velocity_ratio,
)
from capsbayes.infer.log_grid import (
    LogGrid,
    inverse,
    laid,
    lognormal,
    positive_normal,
    product,
    scaled,
    share_between,
    summarise,
)
from capsbayes.infer.many.tabulated.mixture import mixture
from capsbayes.infer.many.tabulated.search import FOUND, Seen, descend, differences, finer_than_tabulated, look_up
from capsbayes.infer.misfit import PREDICTED
from capsbayes.infer.posterior import REPORTED

QUANTITIES = REPORTED
"""Quantities that are summarised, in this order."""

FACTS = (
    *("end", "level", "distance", "log_evidence", "border", "two_shapes", "wrinkles", "unsure_shapes", "within"),
    *PREDICTED,
)
"""Further numbers of each row: end of the search, number of the lattice, distance of the lengths from those of the
likeliest shape in standard deviations, log evidence, shares of the posterior next to the border of the model and at the
caveats of the model, the probability that G_s and a lie well within the ranges of their prior, and the p-values of what
was measured, as those of `capsbayes.infer.misfit`."""

_NEGLIGIBLE, _MOVED = 1e-7, 1e-6  # of the largest probability
_P_VALUES = FACTS.index(PREDICTED[0])


class Shared(NamedTuple):
    """Shared by all capsules: distributions of mu [Pa s] and l [m], limits and powers of the priors, log of A/l^2."""

    viscosity: LogGrid
    half_width: LogGrid
    modulus_low: float
    modulus_high: float
    radius_low: float
    radius_high: float
    modulus_power: float
    radius_power: float
    log_area: float


@compiled
def fill_rows(
    lengths: Floats,
    velocities: Floats,
    rates: Floats,
    shifts: Floats,
    shared: Shared,
    levels: tuple[Floats, ...],
    low: Floats,
    step: Floats,
    summaries: Floats,
    facts: Floats,
    components: Floats,
) -> None:
    """Fill the rows of some capsules.

    Parameters
    ----------
    lengths : (n, 5) array [l]
        L_z, L_a (NaN where missing), and the covariance zz, za, aa.
    velocities : (n, 2) array [m/s]
        v_o and its standard error.
    rates : (n, 2) array [m^3/s]
        Flow rate (NaN where it is unknown) and its standard error.
    shifts : (n, 2) array
        Logarithms of mu and l of each capsule over those that are shared.
    shared : Shared
    levels, low, step
        Of a `Pyramid`.
    summaries : (n, 7, 7) array
        Filled with mean, sd, median and ends of the intervals of `QUANTITIES`, SI.
    facts : (n, 12) array
        Filled with `FACTS`.
    components : (n, k, 6) array
        Filled with the likelihood of (log(G_s / mu), log(a / l)), laid out by `mixture`.
    """
    shapes = _shapes(shared, levels[0], low, step)
    for n in range(len(lengths)):
        z, a, zz, za, aa = lengths[n]
        summaries[n], facts[n], components[n] = np.nan, 0.0, 0.0
        facts[n, _P_VALUES:] = np.nan
        flow = Flow(np.nan, 0.0, 0.0, 0.0)
        if not np.isnan(rates[n, 0]):
            flow = _flow(velocities[n], rates[n], shifts[n], shared)
            facts[n, _P_VALUES + 2] = _p_value_of_flow(lengths[n], flow, shared, levels, low, step)
        seen = Seen(z, a, zz, za, aa, shared.modulus_power, shared.radius_power, flow)
        end, level, distance, scale, evidence, row, column, weights = descend(seen, levels, low, step)
        facts[n, 0], facts[n, 1], facts[n, 2] = end, level, distance
        if end == FOUND:
            facts[n, _P_VALUES : _P_VALUES + 2] = _p_values_of_lengths(
                seen, velocities[n], shifts[n], shared, levels[0], shapes
            )
            kept = weights > _NEGLIGIBLE * weights.max()
            facts[n, 3] = scale + np.log(evidence)
            _fill_row(
                seen,
                velocities[n],
                shifts[n],
                shared,
                levels,
                low,
                step,
                level,
                row[kept],
                column[kept],
                weights[kept] / weights[kept].sum(),
                summaries[n],
                facts[n],
                components[n],
            )


@compiled
def _fill_row(
    seen: Seen,
    velocity: Floats,
    shift: Floats,
    shared: Shared,
    levels: tuple[Floats, ...],
    low: Floats,
    step: Floats,
    level: int,
    row: Integers,
    column: Integers,
    weights: Floats,
    summary: Floats,
    facts: Floats,
    components: Floats,
) -> None:
    lattice, finer = levels[min(level, len(levels) - 1)], finer_than_tabulated(levels, level)
    cell = step * (levels[0].shape[0] / (lattice.shape[0] * finer))
    log_ca = low[0] + cell[0] * (row + 0.5)
    log_size = np.log(low[1] + cell[1] * (column + 0.5))
    log_stretch, log_ratio = np.empty(len(row)), np.empty(len(row))
    room = np.empty(lattice.shape[2])
    variance = 0.0
    for k in range(len(row)):
        node = look_up(lattice, row[k], column[k], finer, room)
        mean, left = velocity_ratio(*differences(seen, node), node[2], node[6], node[7], node[8])
        log_ratio[k], log_stretch[k] = np.log(mean), node[9]
        variance += weights[k] * max(left, 0.0) / mean**2
        caveats = int(node[11])
        facts[5] += weights[k] * (caveats & 1)
        facts[6] += weights[k] * ((caveats >> 1) & 1)
        facts[7] += weights[k] * (caveats >> 2)
    finest = levels[len(levels) - 1]
    facts[4] = _next_to_border(finest, low, step * (levels[0].shape[0] / finest.shape[0]), log_ca, log_size, weights)

    log_modulus = -log_ca - log_ratio
    by_size = laid(log_size, weights, cell[1] / low[1])
    log_speed, spread = 0.0, 0.0
    if np.isnan(seen.flow.offset):
        softness = laid(log_modulus, weights, cell[0])
        by_ratio = laid(log_ratio, weights, 0.0)
        speed = positive_normal(velocity[0], velocity[1], shared.modulus_power - 1.0, softness.step)
        factor = lognormal(variance, softness.step)
        modulus = scaled(product(product(product(softness, factor), speed), shared.viscosity), shift[0])
        radius = scaled(product(by_size, shared.half_width), shift[1])
        ratio = product(by_ratio, lognormal(variance, by_ratio.step))
        slowness = inverse(ratio)
        speed = positive_normal(velocity[0], velocity[1], shared.modulus_power - 1.0, slowness.step)
        flow = product(slowness, speed)
    else:
        speed = _speed(velocity, shared)
        changes, variances = given_flow(log_ratio, variance, seen.flow)
        log_modulus += changes[0]
        log_speed, spread = speed.mean, variances[0]
        of_size = laid(log_size + shared.half_width.mean + shift[1] + changes[1], weights, cell[1] / low[1])
        radius = product(of_size, lognormal(variances[1], of_size.step))
        by_ratio = laid(log_ratio + changes[3], weights, 0.0)
        ratio = product(by_ratio, lognormal(variances[3], by_ratio.step))
        by_flow = laid(log_speed - log_ratio + changes[0], weights, 0.0)
        flow = product(by_flow, lognormal(spread, by_flow.step))
        softness = laid(log_modulus, weights, cell[0])
        factor = lognormal(spread, softness.step)
        modulus = scaled(product(product(softness, factor), shared.viscosity), log_speed + shift[0])
    summarise(modulus, summary[0])
    summarise(radius, summary[1])
    summarise(flow, summary[2])
    summarise(laid(log_ca, weights, cell[0]), summary[3])
    summarise(by_size, summary[4])
    summarise(ratio, summary[5])
    summarise(laid(log_stretch, weights, 0.0), summary[6])
    facts[8] = min(
        _well_within(modulus, shared.modulus_low, shared.modulus_high),
        _well_within(radius, shared.radius_low, shared.radius_high),
    )
    if np.isnan(seen.flow.offset):
        speed = positive_normal(velocity[0], velocity[1], -1.0, 1.0)
        log_speed, spread = speed.mean, speed.variance + variance
    x, y = log_modulus + log_speed + shift[0], log_size + shift[1]
    # the likelihood: the posterior without the priors of G_s and a
    flat = weights * np.exp(-seen.radius_power * y - seen.modulus_power * (x - np.max(x)))
    mixture(flat, x, y, components)
    components[:, 3] += spread


@compiled
def _next_to_border(
    finest: Floats, low: Floats, cell: Floats, log_ca: Floats, log_size: Floats, weights: Floats
) -> float:
    """Return the share of the posterior that half a standard deviation takes out of the domain."""
    mean_u, mean_s = np.sum(weights * log_ca), np.sum(weights * log_size)
    uu = np.sum(weights * (log_ca - mean_u) ** 2)
    us = np.sum(weights * (log_ca - mean_u) * (log_size - mean_s))
    ss = np.sum(weights * (log_size - mean_s) ** 2)
    steps = border_steps(np.array([[uu, us], [us, ss]]))
    rows, columns = finest.shape[:2]
    heaviest, share = weights.max(), 0.0
    largest_u, largest_s = np.abs(steps[:, 0]).max() / cell[0], np.expm1(np.abs(steps[:, 1]).max()) / cell[1]
    for k in range(len(weights)):
        if weights[k] > _MOVED * heaviest:
            size = np.exp(log_size[k])
            i, j = int((log_ca[k] - low[0]) / cell[0]), int((size - low[1]) / cell[1])
            reach_i, reach_j = largest_u + 1.0, size * largest_s + 1.0
            in_box = reach_i <= i < rows - reach_i and reach_j <= j < columns - reach_j
            if in_box and finest[i, j, 10] > max(reach_i, reach_j):
                continue
            for number in range(4):
                i = int(np.floor((log_ca[k] + steps[number, 0] - low[0]) / cell[0]))
                j = int(np.floor((size * np.exp(steps[number, 1]) - low[1]) / cell[1]))
                outside = i < 0 or j < 0 or i >= rows or j >= columns
                if outside or np.isnan(finest[i, j, 0]):
                    share += weights[k]
                    break
    return share


@compiled
def _well_within(grid: LogGrid, low: float, high: float) -> float:
    """Return the probability that log x is farther than half a standard deviation from both limits."""
    margin = NUDGE * np.sqrt(grid.variance)
    return share_between(grid, low + margin, high - margin)


@compiled
def _speed(velocity: Floats, shared: Shared) -> LogGrid:
    """Return v_o, weighted as in the factored posterior."""
    return positive_normal(velocity[0], velocity[1], shared.modulus_power - 1.0, 1.0)


@compiled
def _flow(velocity: Floats, rate: Floats, shift: Floats, shared: Shared) -> Flow:
    """Return the second source of U of one capsule."""
    speed, pumped, width = _speed(velocity, shared), positive_normal(rate[0], rate[1], -1.0, 1.0), shared.half_width
    offset = pumped.mean - shared.log_area - 2.0 * (width.mean + shift[1]) - speed.mean
    return Flow(offset, speed.variance, width.variance, pumped.variance)


@compiled
def _shapes(shared: Shared, lattice: Floats, low: Floats, step: Floats) -> Floats:
    """Return what the priors say of the shapes of a lattice, without the limits of G_s and a.

    Returns
    -------
    (n, 5) array
        Of each shape its place in the lattice, the logarithms of Ca v_o/U and of a/l, and its weight.
    """
    shapes, count = np.empty((lattice.shape[0] * lattice.shape[1], 5)), 0
    for i in range(lattice.shape[0]):
        log_ca = low[0] + step[0] * (i + 0.5)
        for j in range(lattice.shape[1]):
            if np.isnan(lattice[i, j, 0]):
                continue
            log_size = np.log(low[1] + step[1] * (j + 0.5))
            softness = log_ca + np.log(lattice[i, j, 2])
            weight = np.exp((shared.radius_power - 1.0) * log_size - shared.modulus_power * softness)
            shapes[count, 0], shapes[count, 1] = i, j
            shapes[count, 2], shapes[count, 3], shapes[count, 4] = softness, log_size, weight
            count += 1
    return shapes[:count]


@compiled
def _p_values_of_lengths(
    seen: Seen, velocity: Floats, shift: Floats, shared: Shared, lattice: Floats, shapes: Floats
) -> tuple[float, float]:
    """Return the p-values of L_z and L_a, predicted by the priors and the velocity."""
    speed, mu, width = _speed(velocity, shared), shared.viscosity, shared.half_width
    weights = np.empty(len(shapes))
    off = np.empty((5, len(weights)))
    count = 0
    for k in range(len(shapes)):
        modulus = speed.mean + mu.mean + shift[0] - shapes[k, 2]
        radius = shapes[k, 3] + width.mean + shift[1]
        weights[count] = (
            shapes[k, 4]
            * _share_within(modulus, speed.variance + mu.variance, shared.modulus_low, shared.modulus_high)
            * _share_within(radius, width.variance, shared.radius_low, shared.radius_high)
        )
        if weights[count] > 0.0:
            node = lattice[int(shapes[k, 0]), int(shapes[k, 1])]
            off[0, count], off[1, count], off[2, count], off[3, count], off[4, count] = differences(seen, node)
            count += 1
    return p_values_of_lengths(
        weights[:count], off[0, :count], off[1, :count], off[2, :count], off[3, :count], off[4, :count]
    )


@compiled
def _share_within(mean: float, variance: float, low: float, high: float) -> float:
    """Return the probability that a normal number is between two limits."""
    reach = np.sqrt(2.0 * variance)
    if mean - 6.0 * reach > low and mean + 6.0 * reach < high:
        return 1.0
    if reach == 0.0:
        return 1.0 if low <= mean <= high else 0.0
    return 0.5 * (math.erf((high - mean) / reach) - math.erf((low - mean) / reach))


@compiled
def _p_value_of_flow(
    lengths: Floats, flow: Flow, shared: Shared, levels: tuple[Floats, ...], low: Floats, step: Floats
) -> float:
    """Return the p-value of the flow rate, predicted without it; NaN where no shape is near."""
    z, a, zz, za, aa = lengths
    seen = Seen(z, a, zz, za, aa, shared.modulus_power, shared.radius_power, Flow(np.nan, 0.0, 0.0, 0.0))
    end, level, _, _, _, row, column, weights = descend(seen, levels, low, step)
    if end != FOUND:
        return np.nan
    lattice, finer = levels[min(level, len(levels) - 1)], finer_than_tabulated(levels, level)
    room, log_ratio, variance = np.empty(lattice.shape[2]), np.empty(len(row)), 0.0
    for k in range(len(row)):
        node = look_up(lattice, row[k], column[k], finer, room)
        mean, left = velocity_ratio(*differences(seen, node), node[2], node[6], node[7], node[8])
        log_ratio[k] = np.log(mean)
        variance += weights[k] * max(left, 0.0) / mean**2
    middle = np.sum(weights * log_ratio)
    mismatch, total = flow_mismatch(middle, variance + np.sum(weights * (log_ratio - middle) ** 2), flow)
    return p_value(np.ones(1), np.array([mismatch / np.sqrt(total)]))
