"""Likelihood of an outline interpolated on a grid around its posterior, for the sampling engine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import binary_erosion

from capsbayes.arrays import Booleans, Floats
from capsbayes.infer.outline.likelihood import OutlineLikelihood
from capsbayes.model import ForwardModel

_AROUND = 2  # nodes that must be known on every side of a point


@dataclass(frozen=True, eq=False)
class TabulatedOutline:
    """Log density of a measured outline by bicubic interpolation away from the border of the domain, exact elsewhere.

    Parameters
    ----------
    exact : OutlineLikelihood
    log_ca, size : (i,), (j,) arrays
        Nodes, evenly spaced.
    values : (i, j) array
        Log density there, NaN outside the model's domain.
    """

    exact: OutlineLikelihood
    log_ca: Floats
    size: Floats
    values: Floats
    _spline: RectBivariateSpline = field(init=False, repr=False)
    _sure: Booleans = field(init=False, repr=False)

    def __post_init__(self) -> None:
        known = np.isfinite(self.values)
        filled = np.where(known, self.values, np.min(self.values, where=known, initial=0.0))
        around = np.ones((2 * _AROUND + 1, 2 * _AROUND + 1), dtype=bool)
        object.__setattr__(self, "_spline", RectBivariateSpline(self.log_ca, self.size, filled))
        object.__setattr__(self, "_sure", binary_erosion(known, around))

    def at(self, model: ForwardModel, theta: Mapping[str, Floats]) -> Floats:
        """Return the log density at n points : (n,) array, NaN outside the domain of the model."""
        log_ca, size = np.log(theta["capillary_number"]), np.asarray(theta["size_ratio"])
        rows, columns = (
            np.round((place - nodes[0]) / (nodes[1] - nodes[0]))
            for place, nodes in ((log_ca, self.log_ca), (size, self.size))
        )
        within = (rows >= 0) & (rows < len(self.log_ca)) & (columns >= 0) & (columns < len(self.size))
        within[within] = self._sure[rows[within].astype(int), columns[within].astype(int)]
        density = np.empty(len(log_ca))
        density[within] = self._spline.ev(log_ca[within], size[within])
        if not within.all():
            density[~within] = self.exact.at(
                model, {name: np.asarray(values)[~within] for name, values in theta.items()}
            )
        return density

    def error(self, model: ForwardModel, theta: Mapping[str, Floats]) -> float:
        """Return the largest difference from the exact log density at n points."""
        return float(np.nanmax(np.abs(self.at(model, theta) - self.exact.at(model, theta))))


AnyOutline = OutlineLikelihood | TabulatedOutline
