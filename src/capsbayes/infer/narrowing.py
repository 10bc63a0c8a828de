"""Expected width of G_s after one more measurement of a capsule, for a model with several further coordinates.

A number that becomes known takes away, on the average, the variance of the mean of ln G_s from one of its values to
another. What a measurement with errors takes away is estimated twice, and the narrower width counts, as neither
estimate is narrower than the truth but for chance:

- a linear estimate of ln G_s from it, over draws of the posterior, takes away c (S + E)^-1 c, with the covariance S of
  what the draws predict, that of its errors E, and its covariance c with ln G_s; it is loose where the posterior is
  wide and the model curved over it, as no nonlinear estimate is tried;
- the model linearised at single draws, with the normal scores of the priors, has the inverse of the Fisher information
  as its covariance; it is loose where the data tell little, as the borders of the model cut nothing off.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.experiment import membrane_thickness
from capsbayes.infer.importance.posterior import WeightedPosterior
from capsbayes.infer.importance.proposal import PLACE
from capsbayes.infer.outline.likelihood import outline_likelihood
from capsbayes.infer.prior import THICKNESS
from capsbayes.measured_outline import MeasuredOutline, OutlineNoise
from capsbayes.measurement import Measurement
from capsbayes.prediction import Prediction

OUTLINE_NOISE = OutlineNoise(0.005, 0.2)
"""Errors of an outline that is yet to be measured."""

THICKNESS_ERROR = 0.2
"""Relative error of a thickness of the membrane that is yet to be measured."""

FLOWS = {"half flow": 0.5, "double flow": 2.0}
"""Flow rates at which the same capsule may be measured again, over the present one."""

Theta = Mapping[str, Floats]
Data = Callable[[Theta], Floats]
"""What a measurement shows of shapes, as numbers (n, m) with independent errors of one; NaN where there is no shape."""

_DRAWS, _PLACES = 1000, 16  # of the posterior, for either estimate
_STEPS, _SCORE_STEP = (0.02, 0.003), 0.05  # of log Ca and a/l, and of a score, for differences
_LEAST_INSIDE = 0.9  # share of the posterior for which the model has a shape at another flow rate
_FREE = 1e-6  # information on log Ca and a/l that no data have


def expected_log_modulus_sds(grid: WeightedPosterior, measurement: Measurement) -> dict[str, float]:
    """Return the expected standard deviation of ln G_s after each of several measurements, the narrowest first.

    Parameters
    ----------
    grid : WeightedPosterior
    measurement : Measurement
        That it is the posterior of.

    Returns
    -------
    dict of float
        By name: a further coordinate that becomes known; ``membrane_thickness`` to `THICKNESS_ERROR` where the bending
        modulus is free; ``outline`` with `OUTLINE_NOISE`, unless there is one; one of `FLOWS`, measured like the
        present one, where the model has such shapes.
    """
    modulus = "surface_shear_modulus"
    total = grid.log_marginal(modulus).sd ** 2
    known = [name for name in grid.frame.columns if name != "bending" or not grid.density.by_thickness]
    left = {name: total - grid.variance_given(name, modulus) for name in known}
    rows = grid.resampled(np.random.default_rng([0, 5]), _DRAWS)
    theta = grid.frame.theta(grid.points[rows])
    log_modulus = _log_modulus(grid, theta)
    between = grid.variance_of_mean(modulus)  # the rest is of viscosity and velocity

    def narrower(later: Callable[[Mapping[str, float]], Data]) -> float:
        numbers = later(grid.middle)(theta)
        if np.mean(np.isfinite(numbers[:, 0])) < _LEAST_INSIDE:
            return total
        linear = between * (1.0 - _explained(log_modulus, numbers))
        local = _linearised(grid, measurement, grid.points[rows[:_PLACES]], later)
        return total - between + float(np.fmin(linear, local))

    if "bending" in left:
        left[THICKNESS] = narrower(lambda pilot: _log_thickness)
    if measurement.outline is None:
        left["outline"] = narrower(lambda pilot: _outlines(grid, pilot, OUTLINE_NOISE))
    for name, factor in FLOWS.items():
        left[name] = narrower(lambda pilot, factor=factor: _faster(grid, measurement, pilot, factor))  # type: ignore[misc]
    sds = {name: float(np.sqrt(max(part, 0.0))) for name, part in left.items() if part < total}
    return dict(sorted(sds.items(), key=lambda item: item[1]))


def _log_modulus(grid: WeightedPosterior, theta: Theta) -> Floats:
    """Return ln G_s up to what viscosity and velocity add, and NaN where there is no shape : (n,) array."""
    ratio = 1.0 if grid.density.inputs.by_flow_rate else _shapes(grid, theta).velocity_ratio
    return np.asarray(-np.log(theta["capillary_number"] * ratio))


def _explained(log_modulus: Floats, numbers: Floats) -> float:
    """Return the share of Var(ln G_s), (n,), that a linear estimate from data (n, m) explains, without rows of NaN."""
    inside = np.isfinite(numbers[:, 0])
    away = numbers[inside] - numbers[inside].mean(axis=0)
    other = log_modulus[inside] - log_modulus[inside].mean()
    both = other @ away / len(away)
    explained = both @ np.linalg.solve(away.T @ away / len(away) + np.eye(away.shape[1]), both)
    return float(explained / np.mean(other**2))


def _linearised(
    grid: WeightedPosterior,
    measurement: Measurement,
    points: Floats,
    later: Callable[[Mapping[str, float]], Data],
) -> float:
    """Return the variance of ln G_s with a later measurement, linearised at points (k, d); NaN if it cannot be."""
    dimensions = points.shape[1]
    steps = np.diag([*_STEPS, *np.full(dimensions - PLACE, _SCORE_STEP)])
    known = np.diag([_FREE] * PLACE + [1.0] * (dimensions - PLACE))
    found = []
    for point in points:
        pilot = {name: float(values[0]) for name, values in grid.frame.theta(point[None]).items()}
        pilot = {name: value for name, value in pilot.items() if name in grid.forward.names}
        theta = grid.frame.theta(np.concatenate([point + steps, point - steps]))
        now = _present(grid, measurement, pilot)
        numbers = np.column_stack([_log_modulus(grid, theta), now(theta), later(pilot)(theta)])
        slopes = (numbers[:dimensions] - numbers[dimensions:]) / (2.0 * np.diag(steps))[:, None]
        if np.all(np.isfinite(slopes)):
            wanted, data = slopes[:, 0], slopes[:, 1:]
            found.append(wanted @ np.linalg.solve(known + data @ data.T, wanted))
    return float(np.mean(found)) if found else np.nan


def _present(grid: WeightedPosterior, measurement: Measurement, pilot: Mapping[str, float]) -> Data:
    if measurement.outline is not None:
        return _outlines(grid, pilot, measurement.outline.noise)
    return _lengths(grid, pilot)


def _faster(grid: WeightedPosterior, measurement: Measurement, pilot: Mapping[str, float], factor: float) -> Data:
    """Return what the same capsules show at another flow rate, measured like the present one."""
    there = {**pilot, "capillary_number": factor * pilot["capillary_number"]}
    seen = _present(grid, measurement, there)
    return lambda theta: seen({**theta, "capillary_number": factor * theta["capillary_number"]})


def _lengths(grid: WeightedPosterior, pilot: Mapping[str, float]) -> Data:
    """Return L_z, and L_a if it was measured, with the present errors and the model's own at a pilot."""
    width = grid.density.inputs.half_width
    seen = grid.density.likelihood.with_half_width(width.value, width.error)
    count = 1 if seen.length is None else 2
    errors = np.array([[seen.zz, seen.za], [seen.za, seen.aa]])[:count, :count]
    own = _shapes(grid, {name: np.array([value]) for name, value in pilot.items()}).covariance[0, :count, :count]
    root = np.linalg.cholesky(errors + np.nan_to_num(own))
    return lambda theta: np.asarray(np.linalg.solve(root, _shapes(grid, theta).values[:, :count].T).T)


def _outlines(grid: WeightedPosterior, pilot: Mapping[str, float], noise: OutlineNoise) -> Data:
    """Return outlines with errors, the model's own at a pilot included."""
    model = grid.forward
    there = _shapes(grid, {name: np.array([value]) for name, value in pilot.items()}, outline=True).outline
    assert there is not None, "asked for"
    if not np.all(np.isfinite(there)):
        return lambda theta: np.full((len(theta["size_ratio"]), 1), np.nan)
    seen = outline_likelihood(model, MeasuredOutline(there[0], noise, view=model.view), pilot)

    def shown(theta: Theta) -> Floats:
        outlines = _shapes(grid, theta, outline=True).outline
        assert outlines is not None, "asked for"
        return seen.whitened(outlines)

    return shown


def _log_thickness(theta: Theta) -> Floats:
    log_thickness = np.log(membrane_thickness(bending=theta["bending"], capsule_radius=theta["size_ratio"]))
    return np.asarray(log_thickness[:, None] / THICKNESS_ERROR)


def _shapes(grid: WeightedPosterior, theta: Theta, *, outline: bool = False) -> Prediction:
    known = {name: theta[name] for name in grid.forward.names if name in theta}
    return grid.forward(known, outline=outline)
