"""Measuring errors of a lab, and the measurement that a given shape would lead to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.measurement import Measurement


@dataclass(frozen=True)
class LabErrors:
    """Standard errors of the lengths and of the velocity; those of viscosity and half width are the experiment's.

    Parameters
    ----------
    axial_extent : float [l or m]
        Of L_z.
    capsule_velocity : float [-]
        Of v_o, over v_o.
    axial_length : float or None [l or m]
        Of L_a; None where the rear is not seen.
    length_correlation : float
        Between the errors of the two lengths.
    over_half_width : bool
        True for lengths over l, False for lengths in metres.

    Raises
    ------
    InputError
        If an error is not positive and finite.

    Examples
    --------
    >>> LabErrors(axial_extent=0.02, axial_length=0.02, capsule_velocity=0.01).covariance.round(6).tolist()
    [[0.0004, 0.0], [0.0, 0.0004]]
    """

    axial_extent: float
    capsule_velocity: float
    axial_length: float | None
    length_correlation: float = 0.0
    over_half_width: bool = True

    def __post_init__(self) -> None:
        for name in ("axial_extent", "capsule_velocity", "axial_length"):
            error = getattr(self, name)
            if not (name == "axial_length" and error is None) and not (np.isfinite(error) and error > 0.0):
                raise InputError("errors", name, "a positive finite standard error", repr(error))
        if not -1.0 < self.length_correlation < 1.0:
            raise InputError("errors", "length_correlation", "between -1 and 1", repr(self.length_correlation))

    @classmethod
    def of(cls, measurement: Measurement) -> LabErrors:
        """Return the errors of a measured capsule; its outline is ignored."""
        relative = measurement.capsule_velocity_error / measurement.capsule_velocity
        return cls(
            measurement.axial_extent_error,
            relative,
            measurement.axial_length_error,
            measurement.length_correlation,
            measurement.over_half_width,
        )

    @property
    def covariance(self) -> Floats:
        """Covariance of the measured lengths, L_z or (L_z, L_a) : (k, k) array."""
        if self.axial_length is None:
            return np.array([[self.axial_extent**2]])
        cross = self.length_correlation * self.axial_extent * self.axial_length
        return np.array([[self.axial_extent**2, cross], [cross, self.axial_length**2]])

    def measured(self, lengths: Floats, capsule_velocity: float) -> Measurement:
        """Return a measurement of given lengths.

        Parameters
        ----------
        lengths : (2,) array [l or m]
            L_z and L_a; L_a is cut at L_z where noise makes it the longer.
        capsule_velocity : float [m/s]
        """
        extent = float(lengths[0])
        return Measurement(
            axial_extent=extent,
            axial_extent_error=self.axial_extent,
            capsule_velocity=capsule_velocity,
            capsule_velocity_error=self.capsule_velocity * capsule_velocity,
            axial_length=None if self.axial_length is None else min(float(lengths[1]), extent),
            axial_length_error=self.axial_length,
            length_correlation=self.length_correlation,
            over_half_width=self.over_half_width,
        )

    def as_dict(self) -> dict[str, float | str | None]:
        """Return the fields with their unit, for files."""
        unit = "l" if self.over_half_width else "m"
        return {
            "axial_extent": self.axial_extent,
            "axial_length": self.axial_length,
            "unit_of_lengths": unit,
            "length_correlation": self.length_correlation,
            "capsule_velocity_relative": self.capsule_velocity,
        }


def root_of(covariance: Floats) -> Floats:
    """Return the lower triangular root of a covariance (k, k), which may be singular.

    Eigenvectors and singular vectors would do, but their signs depend on the processor.
    """
    ridge = 1e-14 * np.diag(covariance).max() + np.finfo(np.float64).tiny
    return np.asarray(np.linalg.cholesky(covariance + ridge * np.eye(len(covariance))))
