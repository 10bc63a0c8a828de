"""Shape and velocity of a capsule as a model predicts them, with the own error of the model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Booleans, Floats

ERRING = ("axial_extent", "axial_length", "velocity_ratio")
NUMBERS = (*ERRING, "stretch_ratio")
"""Names of the numbers of a prediction, and of those that have a covariance."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Steady shapes and velocities for a batch of n parameter points.

    Rows where ``inside`` is False hold NaN: the model has no answer there.

    Parameters
    ----------
    axial_extent : (n,) array [l]
        Maximum extension along the flow, L_z.
    axial_length : (n,) array [l]
        Length on the axis, L_a.
    velocity_ratio : (n,) array [U]
        Velocity of the capsule, v_o/U.
    stretch_ratio : (n,) array [-]
        Perimeter of the mid-plane profile over that of the sphere at rest, Lambda.
    covariance : (n, 3, 3) array
        Covariance of the own error of the model in (axial_extent, axial_length, velocity_ratio).
    inside : (n,) bool array
        Whether the point lies in the model's domain.
    outline : (n, p, 2) array [l], optional
        Closed outline, columns (z, y), ordered from the nose.

    Examples
    --------
    >>> prediction = Prediction(
    ...     axial_extent=np.array([2.14]), axial_length=np.array([1.81]), velocity_ratio=np.array([1.29]),
    ...     stretch_ratio=np.array([1.15]), covariance=np.zeros((1, 3, 3)), inside=np.array([True]))
    >>> len(prediction), prediction.parachute_depth.round(2)
    (1, array([0.33]))
    """

    axial_extent: Floats
    axial_length: Floats
    velocity_ratio: Floats
    stretch_ratio: Floats
    covariance: Floats
    inside: Booleans
    outline: Floats | None = None

    def __post_init__(self) -> None:
        n = np.shape(self.axial_extent)
        if len(n) != 1:
            raise ValueError(f"axial_extent: expected shape (n,), got {n}")
        for name in ("axial_length", "velocity_ratio", "stretch_ratio", "inside"):
            if np.shape(getattr(self, name)) != n:
                raise ValueError(f"{name}: expected shape {n}, got {np.shape(getattr(self, name))}")
        if np.shape(self.covariance) != (*n, 3, 3):
            raise ValueError(f"covariance: expected shape {(*n, 3, 3)}, got {np.shape(self.covariance)}")
        if self.outline is not None:
            shape = np.shape(self.outline)
            if len(shape) != 3 or shape[0] != n[0] or shape[2] != 2:
                raise ValueError(f"outline: expected shape ({n[0]}, p, 2), got {shape}")

    def __len__(self) -> int:
        return len(self.axial_extent)

    @property
    def parachute_depth(self) -> Floats:
        """Depth of the concave rear, L_p = L_z - L_a : (n,) array [l]."""
        return self.axial_extent - self.axial_length

    @property
    def values(self) -> Floats:
        """Columns (axial_extent, axial_length, velocity_ratio) in the order of the covariance : (n, 3) array."""
        return np.stack([self.axial_extent, self.axial_length, self.velocity_ratio], axis=-1)
