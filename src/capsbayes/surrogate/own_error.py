"""The surrogate's own error: covariance of (L_z, L_a, v_o/U) at every point of the domain.

Its source are the leave-one-out residuals: the difference between each case
and what all the others say of it. The products of a case's three residuals are
averaged with smooth positive weights over the cases around the query (moving
least squares of degree zero), so that a residual that happens to vanish does
not pass for certainty, and the covariance is positive everywhere. It errs on
the safe side: with a case left out its surroundings are emptier than any query
finds them, and on the border leaving out turns an interpolation into an
extrapolation.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capsbayes.surrogate.diffuse import DiffuseApproximation

__all__ = ["QUANTITIES", "OwnError", "mesh_error_of"]

Floats = NDArray[np.float64]

QUANTITIES = ("axial_extent", "axial_length", "velocity_ratio")
NEIGHBOURS = 12
DILATION = 1.3
SOFTENING = 1.0  # a case counts about a fifth of the mean at its own place


@dataclass(frozen=True, eq=False)
class OwnError:
    """Covariance field made of residuals.

    Parameters
    ----------
    nodes : (m, 2) array
        Positions of the cases in the plane of the approximation.
    residuals : (m, 3) array
        Leave-one-out residuals of (L_z, L_a, v_o/U); a NaN row counts as the largest of all.
    """

    nodes: Floats
    residuals: Floats
    _field: DiffuseApproximation = field(init=False, repr=False)

    def __post_init__(self) -> None:
        known = np.isfinite(self.residuals)
        largest = np.where(known, np.abs(self.residuals), 0.0).max(axis=0)
        residuals = np.where(known, self.residuals, largest)
        products = residuals[:, :, None] * residuals[:, None, :]
        smooth = DiffuseApproximation(
            self.nodes,
            products.reshape(len(products), 9),
            degree=0,
            neighbours=min(NEIGHBOURS, len(self.nodes) - 1),
            dilation=DILATION,
            softening=SOFTENING,
        )
        object.__setattr__(self, "_field", smooth)

    def shares(self, queries: Floats) -> Floats:
        """Share of each case in the mean at points of the plane : (n, 2) -> (n, m) array, none negative."""
        return self._field.shape_functions(queries)

    def covariance(self, queries: Floats) -> Floats:
        """Covariance at points of the plane : (n, 2) -> (n, 3, 3) array."""
        return self._field(queries).reshape(len(queries), 3, 3)


def mesh_error_of(attributes: Mapping[Any, Any]) -> Floats:
    """Relative errors of (L_z, L_a, v_o/U) owed to the mesh, from a database's attributes; zero when not stated.

    Examples
    --------
    >>> mesh_error_of({"mesh_error": '{"axial_extent": 0.002, "axial_length": 0.001, "velocity_ratio": 0.0005}'})
    array([0.002 , 0.001 , 0.0005])
    """
    stated = attributes.get("mesh_error")
    if stated is None:
        return np.zeros(3)
    errors = json.loads(stated)
    return np.array([float(errors[name]) for name in QUANTITIES])
