"""Likelihood of an outline interpolated on a grid around its posterior, for the sampling engine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import binary_erosion

from capsbayes.arrays import Booleans, Floats, Integers
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
        object.__setattr__(self, "_sure", np.pad(binary_erosion(known, around), 1))

    def at(self, model: ForwardModel, theta: Mapping[str, Floats]) -> Floats:
        """Return the log density at n points : (n,) array, NaN outside the domain of the model."""
        log_ca, size = np.log(theta["capillary_number"]), np.asarray(theta["size_ratio"])
        within = self._sure[_nearest(log_ca, self.log_ca), _nearest(size, self.size)]
        if within.all():
            return np.asarray(self._spline.ev(log_ca, size))
        density = np.empty(len(log_ca))
        density[within] = self._spline.ev(log_ca[within], size[within])
        density[~within] = self.exact.at(model, {name: np.asarray(values)[~within] for name, values in theta.items()})
        return density

    def error(self, model: ForwardModel, theta: Mapping[str, Floats]) -> float:
        """Return the largest difference from the exact log density at n points."""
        return float(np.nanmax(np.abs(self.at(model, theta) - self.exact.at(model, theta))))


def _nearest(places: Floats, nodes: Floats) -> Integers:
    """Return the number of the nearest of evenly spaced nodes, from 1; 0 or one too many beyond them."""
    steps = np.rint((places - (nodes[0] - (nodes[1] - nodes[0]))) / (nodes[1] - nodes[0]))
    return np.minimum(np.maximum(steps, 0.0), len(nodes) + 1.0).astype(np.int64)


AnyOutline = OutlineLikelihood | TabulatedOutline
