"""Likelihood of the lengths: Gaussian, with the measurement's covariance plus the model's own at that point.

The model's error varies over the (Ca, a/l) plane, so the determinant of the
covariance is part of the likelihood. L_a may be missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats
from capsbayes.infer.kernel import misfits, velocity_ratios
from capsbayes.measurement import Measurement
from capsbayes.prediction import Prediction


class ModelAtPoints(NamedTuple):
    """Predictions of a model as the likelihood reads them, of any batch shape.

    Parameters
    ----------
    extent, length, velocity_ratio : arrays [l], [l], [U]
        L_z, L_a, v_o/U.
    zz, za, aa : arrays
        Covariance of the model's own error in L_z and L_a.
    zr, ar, rr : arrays
        The same with v_o/U.
    stretch_ratio : array
        Lambda.
    log_area : array or None
        Log of the area of the cross-section over that of the plain one, where a flow rate is given.
    outline : array or None
        Log density of the measured outline given the model's, where there is one.
    """

    extent: Floats
    length: Floats
    velocity_ratio: Floats
    zz: Floats
    za: Floats
    aa: Floats
    zr: Floats
    ar: Floats
    rr: Floats
    stretch_ratio: Floats
    outline: Floats | None = None
    log_area: Floats | None = None

    def at_unit_velocity(self) -> ModelAtPoints:
        """Return the same with v_o/U known to be one, as where mu U is given in place of viscosity and velocity."""
        none = 0.0 * self.velocity_ratio  # NaN where the model has no answer
        return self._replace(velocity_ratio=none + 1.0, zr=none, ar=none, rr=none)

    @classmethod
    def of(cls, prediction: Prediction, *, error_scale: float = 1.0) -> ModelAtPoints:
        """Return the numbers of a prediction; `error_scale` multiplies the standard errors of the model."""
        c = prediction.covariance if error_scale == 1.0 else prediction.covariance * error_scale**2
        ratio, stretch = prediction.velocity_ratio, prediction.stretch_ratio
        of_error = (c[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))
        return cls(*(prediction.axial_extent, prediction.axial_length, ratio, *of_error, stretch))

    def rescaled(self, factor: float) -> ModelAtPoints:
        """Return the same with the standard errors of the model times a factor."""
        own = {name: factor**2 * getattr(self, name) for name in ("zz", "za", "aa", "zr", "ar", "rr")}
        return self._replace(**own)

    def taken(self, index: Any) -> ModelAtPoints:
        """Return some of the points, by a numpy index."""
        return ModelAtPoints(*(values if values is None else values[index] for values in self))  # type: ignore[arg-type]

    def joined(self, other: ModelAtPoints) -> ModelAtPoints:
        """Return these points followed by others, both with the density of an outline or neither."""
        pairs = zip(self, other, strict=True)
        return ModelAtPoints(*(mine if mine is None else np.concatenate([mine, rest]) for mine, rest in pairs))  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class LengthsLikelihood:
    """Density of the measured lengths given the model.

    Parameters
    ----------
    extent : float
        L_z as measured.
    length : float or None
        L_a as measured.
    zz, za, aa : float
        Covariance of the measurement.
    over_half_width : bool
        True if they are over l, else they are in metres.

    Examples
    --------
    >>> seen = LengthsLikelihood(2.14, None, 0.01**2, 0.0, 0.0, True)
    >>> ones, zeros = np.ones(1), np.zeros(1)
    >>> at = ModelAtPoints(2.14 * ones, ones, ones, zeros, zeros, zeros, zeros, zeros, zeros, ones)
    >>> seen.log_density(at).round(4).tolist()  # -log(0.01 sqrt(2 pi))
    [3.6862]
    """

    extent: float
    length: float | None
    zz: float
    za: float
    aa: float
    over_half_width: bool

    @classmethod
    def of(cls, measurement: Measurement) -> LengthsLikelihood:
        """Return the likelihood of one measurement."""
        c = measurement.covariance
        both = len(c) == 2
        return cls(
            measurement.axial_extent,
            measurement.axial_length,
            float(c[0, 0]),
            float(c[0, 1]) if both else 0.0,
            float(c[1, 1]) if both else 0.0,
            measurement.over_half_width,
        )

    def log_density(self, model: ModelAtPoints, half_width: ArrayLike = 1.0) -> Floats:
        """Return the log density of the measured lengths.

        Parameters
        ----------
        model : ModelAtPoints
            Of any batch shape.
        half_width : array that broadcasts with it [m]
            Read only if the lengths are in metres; the density is then one of
            lengths in metres, hence the powers of l.

        Returns
        -------
        array
            NaN where the model has no answer.
        """
        square, volume = misfits(*self.differences(model, half_width))
        log_density = -0.5 * (square + np.log(volume))
        if self.over_half_width:
            return log_density
        return log_density - (1 if self.length is None else 2) * np.log(half_width)

    def distance(self, model: ModelAtPoints, half_width: ArrayLike = 1.0) -> Floats:
        """Return the Mahalanobis distance of the lengths from the predicted ones : array."""
        return np.sqrt(misfits(*self.differences(model, half_width))[0])

    def velocity_ratio(self, model: ModelAtPoints, half_width: ArrayLike = 1.0) -> tuple[Floats, Floats]:
        """Return mean and variance of the true v_o/U given the lengths : arrays, see `kernel.velocity_ratio`."""
        differences = self.differences(model, half_width)
        return velocity_ratios(*differences, model.velocity_ratio, model.zr, model.ar, model.rr)

    def with_half_width(self, centre: float, error: float) -> LengthsLikelihood:
        """Return the same lengths over l with the error of l in their covariance: an approximation."""
        if self.over_half_width:
            return self
        z, a = self.extent / centre, None if self.length is None else self.length / centre
        share, other = (error / centre) ** 2, a or 0.0
        zz, za, aa = (value / centre**2 for value in (self.zz, self.za, self.aa))
        return LengthsLikelihood(z, a, zz + share * z * z, za + share * z * other, aa + share * other * other, True)

    def differences(self, model: ModelAtPoints, half_width: ArrayLike = 1.0) -> tuple[Floats, ...]:
        """Return measured minus predicted L_z and L_a [l], and their covariance : what `kernel.misfit` takes."""
        scale = 1.0 if self.over_half_width else np.asarray(half_width)
        square = scale * scale
        length = np.nan if self.length is None else self.length
        return (
            self.extent / scale - model.extent,
            length / scale - model.length,
            model.zz + self.zz / square,
            model.za + self.za / square,
            model.aa + self.aa / square,
        )
