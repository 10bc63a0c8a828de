"""What a model says of the shape of a capsule, in a few numbers with the model's own error."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Booleans, Floats
from capsbayes.experiment import bending
from capsbayes.infer.prior import THICKNESS
from capsbayes.prediction import Prediction
from capsbayes.surrogate import MembraneSurrogate


class Shapes(NamedTuple):
    """Shapes at n points; rows of NaN where the model has no answer.

    Parameters
    ----------
    numbers : (n, k) array
        L_z and L_a [l], or coefficients of the modes of outlines [l], and L_a behind them.
    covariances : (n, k, k) array
        Of the model's own error in the numbers; (n, 0, 0) if it was not asked for.
    log_ratio : (n,) array
        ln(v_o/U).
    ratio_error : (n,) array
        The model's own standard error of it.
    """

    numbers: Floats
    covariances: Floats
    log_ratio: Floats
    ratio_error: Floats


class Slopes(NamedTuple):
    """To first order, m times the changes of shapes at n points; rows of NaN where the model has no answer.

    Parameters
    ----------
    numbers : (m, n, k) array
    log_ratio : (m, n) array
    """

    numbers: Floats
    log_ratio: Floats


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

    @abstractmethod
    def __call__(self, theta: Mapping[str, Floats], *, errors: bool = True) -> Shapes:
        """Return the shapes at n points, with the model's error or perhaps without."""

    @abstractmethod
    def with_slopes(self, theta: Mapping[str, Floats], moved: Sequence[Mapping[str, Floats]]) -> tuple[Shapes, Slopes]:
        """Return the shapes at n points without the error of their numbers, and how they change if the points move.

        `moved` are further n points each.
        """

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Smallest box about the domain, ``((ca_min, ca_max), (size_min, size_max))`` [-]."""
        return self.model.domain.bounds

    @property
    def error_lengths(self) -> Floats:
        """Distances in ln Ca and a/l over which the model's own error changes : (2,) array."""
        return self.model.error_lengths

    def places(self, membranes: Mapping[str, Floats], own: Floats) -> Floats:
        """Return places of d membranes, the capsules at (d, n, o) : (d, 4) array.

        Over a distance of one the model's own error changes.
        """
        middle = own[..., :2].mean(axis=1, keepdims=True)
        return self.model.membrane_places(self.theta(membranes, middle))

    def contains(self, membranes: Mapping[str, Floats], own: Floats) -> Booleans:
        """Return whether places (d, n, o), as of `theta`, lie in the domain at d membranes : (d, n) array."""
        theta = self.theta(membranes, own)
        further = (theta[name] for name in self.model.coordinates)
        inside = self.model.domain.contains(theta["capillary_number"], theta["size_ratio"], *further)
        return inside.reshape(own.shape[:2])

    def theta(self, membranes: Mapping[str, Floats], own: Floats) -> dict[str, Floats]:
        """Return what the model reads at places (d, n, o), by name : (d n,) arrays.

        A place is ln Ca and a/l, and perhaps the logarithm of the pre-inflation over that of the membrane.
        """
        theta = {name: np.repeat(values, own.shape[1]) for name, values in membranes.items()}
        size = own[..., 1].ravel()
        if own.shape[2] > 2:
            theta["pre_inflation"] = theta["pre_inflation"] * np.exp(own[..., 2]).ravel()
        if THICKNESS in theta:
            thickness = theta.pop(THICKNESS)
            theta["bending"] = bending(membrane_thickness=thickness, capsule_radius=size * self.half_width)
        return {"capillary_number": np.exp(own[..., 0]).ravel(), "size_ratio": size, **theta}


class Lengths(ShapeModel):
    """Shapes as their lengths L_z and L_a."""

    def __call__(self, theta: Mapping[str, Floats], *, errors: bool = True) -> Shapes:
        """Return the shapes at n points."""
        seen = self.model(theta)
        numbers = np.stack([seen.axial_extent, seen.axial_length], axis=1)
        return _shapes(seen, numbers, seen.covariance[:, :2, :2])

    def with_slopes(self, theta: Mapping[str, Floats], moved: Sequence[Mapping[str, Floats]]) -> tuple[Shapes, Slopes]:
        """Return the shapes at n points, and how they change."""
        seen, _, changes = self.model.with_changes(theta, moved, outline=False)
        numbers = np.stack([seen.axial_extent, seen.axial_length], axis=1)
        shapes = _shapes(seen, numbers, seen.covariance[:, :0, :0])
        return shapes, Slopes(changes[..., :2], changes[..., 2] / seen.velocity_ratio)


class Outlines(ShapeModel):
    """Shapes as the coefficients of the modes of their outlines, and L_a."""

    def __call__(self, theta: Mapping[str, Floats], *, errors: bool = True) -> Shapes:
        """Return the shapes at n points."""
        seen, coefficients, covariances = self.model.with_coefficients(theta, errors=errors)
        return _shapes(seen, np.column_stack([coefficients, seen.axial_length]), covariances)

    def with_slopes(self, theta: Mapping[str, Floats], moved: Sequence[Mapping[str, Floats]]) -> tuple[Shapes, Slopes]:
        """Return the shapes at n points, and how they change."""
        seen, coefficients, changes = self.model.with_changes(theta, moved, outline=True)
        shapes = _shapes(seen, np.column_stack([coefficients, seen.axial_length]), seen.covariance[:, :0, :0])
        numbers = np.concatenate([changes[..., 4:], changes[..., 1:2]], axis=-1)
        return shapes, Slopes(numbers, changes[..., 2] / seen.velocity_ratio)


def _shapes(seen: Prediction, numbers: Floats, covariances: Floats) -> Shapes:
    ratio_error = np.sqrt(seen.covariance[:, 2, 2]) / seen.velocity_ratio
    return Shapes(numbers, covariances, np.log(seen.velocity_ratio), ratio_error)
