"""What a model says of the shape of a capsule, in a few numbers with the model's own error."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from capsbayes.arrays import Booleans, Floats
from capsbayes.experiment import bending
from capsbayes.infer.prior import THICKNESS
from capsbayes.surrogate import MembraneSurrogate

_ERRORS = 12  # leading modes of outlines that have a model error


class Shapes(NamedTuple):
    """Shapes at n points; rows of NaN where the model has no answer.

    Parameters
    ----------
    numbers : (n, k) array
        L_z and L_a [l], or coefficients of the modes of outlines [l], and L_a behind them.
    factors : (n, e, e) array
        Lower triangular, factors of the covariance of the model's own error in the first e numbers.
    log_ratio : (n,) array
        ln(v_o/U).
    ratio_error : (n,) array
        The model's own standard error of it.
    """

    numbers: Floats
    factors: Floats
    log_ratio: Floats
    ratio_error: Floats


@dataclass(frozen=True, eq=False)
class ShapeModel(ABC):
    """From parameters to `Shapes`.

    Parameters
    ----------
    model : MembraneSurrogate
    half_width : float [m]
    """

    model: MembraneSurrogate
    half_width: float
    errors: ClassVar[int]
    """Number of leading numbers with a model error."""

    @abstractmethod
    def __call__(self, theta: Mapping[str, Floats], *, errors: bool = True) -> Shapes:
        """Return the shapes at n points, with the model's error in them or without (factors of NaN)."""

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Smallest box about the domain, ``((ca_min, ca_max), (size_min, size_max))`` [-]."""
        return self.model.domain.bounds

    def contains(self, membranes: Mapping[str, Floats], own: Floats) -> Booleans:
        """Return whether places (d, n, 2) of ln Ca and a/l lie in the domain at d membranes : (d, n) array."""
        theta = self.theta(membranes, own)
        further = (theta[name] for name in self.model.coordinates)
        inside = self.model.domain.contains(theta["capillary_number"], theta["size_ratio"], *further)
        return inside.reshape(own.shape[:2])

    def theta(self, membranes: Mapping[str, Floats], own: Floats) -> dict[str, Floats]:
        """Return what the model reads at places (d, n, 2), by name : (d n,) arrays."""
        theta = {name: np.repeat(values, own.shape[1]) for name, values in membranes.items()}
        size = own[..., 1].ravel()
        if THICKNESS in theta:
            thickness = theta.pop(THICKNESS)
            theta["bending"] = bending(membrane_thickness=thickness, capsule_radius=size * self.half_width)
        return {"capillary_number": np.exp(own[..., 0]).ravel(), "size_ratio": size, **theta}


class Lengths(ShapeModel):
    """Shapes as their lengths L_z and L_a."""

    errors = 2

    def __call__(self, theta: Mapping[str, Floats], *, errors: bool = True) -> Shapes:
        """Return the shapes at n points."""
        seen = self.model(theta)
        numbers = np.stack([seen.axial_extent, seen.axial_length], axis=1)
        ratio_error = np.sqrt(seen.covariance[:, 2, 2]) / seen.velocity_ratio
        return Shapes(numbers, _factors(seen.covariance[:, :2, :2], errors), np.log(seen.velocity_ratio), ratio_error)


class Outlines(ShapeModel):
    """Shapes as the coefficients of the modes of their outlines, and L_a."""

    errors = _ERRORS

    def __call__(self, theta: Mapping[str, Floats], *, errors: bool = True) -> Shapes:
        """Return the shapes at n points."""
        seen, coefficients, covariances = self.model.with_coefficients(theta, self.errors if errors else 1)
        numbers = np.column_stack([coefficients, seen.axial_length])
        ratio_error = np.sqrt(seen.covariance[:, 2, 2]) / seen.velocity_ratio
        return Shapes(numbers, _factors(covariances, errors), np.log(seen.velocity_ratio), ratio_error)


def _factors(covariances: Floats, wanted: bool) -> Floats:
    """Return the Cholesky factors of covariances (n, e, e), NaN where these are or if they are not wanted."""
    factors = np.full_like(covariances, np.nan)
    if not wanted:
        return factors
    known = np.isfinite(covariances[:, 0, 0])
    diagonal = np.eye(covariances.shape[1])
    sizes = np.trace(covariances[known], axis1=1, axis2=2)
    # of few polynomials the covariance has no full rank
    factors[known] = np.linalg.cholesky(covariances[known] + (1e-6 * sizes + 1e-18)[:, None, None] * diagonal)
    return factors
