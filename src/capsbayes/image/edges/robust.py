"""Straight lines and parabolas by least squares, without the points that lie off them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from scipy.special import ndtri, stdtrit

from capsbayes.arrays import Booleans, Floats
from capsbayes.image.edges.small_equations import factorise, substitute

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


def quantile(values: Floats, share: float) -> float:
    """Return the value below which a share of an array (n,) lies, linear between two; np.quantile takes longer."""
    place = share * (len(values) - 1)
    below = int(place)
    above = min(below + 1, len(values) - 1)
    ordered = np.partition(values, (below, above))
    return float(ordered[below] + (place - below) * (ordered[above] - ordered[below]))


@lru_cache
def wider_by_few(free: int) -> float:
    """Return Student's interval of 95 % with so many degrees of freedom, one at least, over that of a known variance.

    A scatter seen in few values tells their error only roughly.
    """
    return float(stdtrit(max(free, 1), 0.975) / ndtri(0.975))


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
        coefficients = _least_squares(design, values, kept)
        residuals = values - design @ coefficients
        spread = max(robust_spread(residuals[kept]), floor)
        kept = kept & (np.abs(residuals) < _OUTLIER * spread)
    used = design[kept]
    variance = np.sum(residuals[kept] ** 2) / max(len(used) - design.shape[1], 1)
    return RobustFit(coefficients, kept, spread, float(variance), used)


@njit(cache=True, nogil=True, error_model="numpy")
def _least_squares(design, values, kept):  # type: ignore[no-untyped-def]
    """Return the coefficients (k,) for which the rows that are kept of the product with a design (n, k) fit best."""
    count = design.shape[1]
    normal, side = np.zeros((count, count)), np.zeros(count)
    for n in range(len(design)):
        if not kept[n]:
            continue
        for a in range(count):
            side[a] += design[n, a] * values[n]
            for b in range(count):
                normal[a, b] += design[n, a] * design[n, b]
    factorise(normal)
    substitute(normal, side)
    return side
