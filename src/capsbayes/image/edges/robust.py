"""Straight lines and parabolas by least squares, without the points that lie off them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Booleans, Floats

_OUTLIER = 4.0  # robust standard deviations


@dataclass(frozen=True, eq=False)
class RobustFit:
    """Least-squares fit to the points that were kept.

    Parameters
    ----------
    coefficients : (k,) array
    kept : (n,) array of bool
    spread : float
        Robust standard deviation of the residuals, before the last outliers were removed.
    variance : float
        Variance of the residuals of the points that were kept.
    design : (n, k) array
        Rows of the points that were kept.
    """

    coefficients: Floats
    kept: Booleans
    spread: float
    variance: float
    design: Floats

    @property
    def cofactor(self) -> Floats:
        """Covariance of the coefficients over the variance of a point : (k, k) array."""
        return np.asarray(np.linalg.inv(self.design.T @ self.design))


def median(values: Floats) -> float:
    """Return the median of an array without NaN, NaN if it is empty; np.median takes five times as long."""
    values = values.ravel()
    middle = len(values) // 2
    if not len(values):
        return np.nan
    ordered = np.partition(values, middle)
    upper = float(ordered[middle])
    return upper if len(values) % 2 else 0.5 * (float(ordered[:middle].max()) + upper)


def robust_spread(residuals: Floats) -> float:
    """Return the standard deviation of normal errors that have this median absolute value."""
    return median(np.abs(residuals)) / 0.6745


def fit_without_outliers(
    design: Floats,
    values: Floats,
    kept: Booleans,
    *,
    rounds: int,
    floor: float,
    enough: Callable[[Booleans], bool],
) -> RobustFit | None:
    """Fit a linear model again and again, each time without the points that are off by four standard deviations.

    The model is the product of design (n, k) and coefficients; `kept` (n,) marks the points to begin with, `floor` is
    the smallest standard deviation for judging outliers. Returns None where the points left are not `enough`.
    """
    for _ in range(rounds):
        if not enough(kept):
            return None
        coefficients, *_ = np.linalg.lstsq(design[kept], values[kept], rcond=None)
        residuals = values - design @ coefficients
        spread = max(robust_spread(residuals[kept]), floor)
        kept = kept & (np.abs(residuals) < _OUTLIER * spread)
    used = design[kept]
    variance = np.sum(residuals[kept] ** 2) / max(len(used) - design.shape[1], 1)
    return RobustFit(np.asarray(coefficients, dtype=np.float64), kept, spread, float(variance), used)
