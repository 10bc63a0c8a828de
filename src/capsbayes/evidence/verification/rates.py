"""Rates of convergence, fitted."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.optimize
from numpy.typing import ArrayLike

__all__ = ["Limit", "fitted_limit", "fitted_rate"]


class Limit(NamedTuple):
    """The q and p of values q + c n^-p."""

    value: float
    rate: float


def fitted_rate(refinements: ArrayLike, errors: ArrayLike) -> float:
    """Exponent p of errors c n^-p, by least squares of the logarithms; NaN if an error is.

    Examples
    --------
    >>> round(fitted_rate([4, 8], [1.0, 0.125]), 6)
    3.0
    """
    x, y = np.log(refinements), np.log(np.abs(errors))
    return float(-np.sum((x - x.mean()) * (y - y.mean())) / np.sum((x - x.mean()) ** 2))


def fitted_limit(refinements: ArrayLike, values: ArrayLike) -> Limit:
    """Limit and rate of values q + c n^-p, by least squares; NaN if a value is.

    Examples
    --------
    >>> n = np.array([6.0, 8.0, 12.0, 16.0])
    >>> limit = fitted_limit(n, 2.0 + 3.0 * n**-2.5)
    >>> round(limit.value, 6), round(limit.rate, 3)
    (2.0, 2.5)
    """
    n, y = np.asarray(refinements, dtype=float), np.asarray(values, dtype=float)
    if not np.all(np.isfinite(y)):
        return Limit(np.nan, np.nan)

    def fit(rate: float) -> tuple[np.ndarray, float]:
        shapes = np.column_stack([np.ones_like(n), (n / n[0]) ** -rate])
        coefficients = np.linalg.lstsq(shapes, y, rcond=None)[0]
        return coefficients, float(np.sum((shapes @ coefficients - y) ** 2))

    grid = np.linspace(0.3, 9.0, 88)  # the misfit may have several minima
    best = grid[np.argmin([fit(rate)[1] for rate in grid])]
    end = scipy.optimize.minimize_scalar(
        lambda rate: fit(rate)[1], bounds=(best - 0.2, best + 0.2), method="bounded", options={"xatol": 1e-6}
    )
    return Limit(float(fit(end.x)[0][0]), float(end.x))
