"""Whitened residuals of measurements: independent numbers of variance one under a right model.

The covariance that does this is made once, at a pilot, and kept for all models that are compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.diagnosis.session import Session
from capsbayes.infer.kernel import length_given_extent
from capsbayes.infer.outline.likelihood import OutlineLikelihood, outline_likelihood
from capsbayes.measured_outline import MeasuredOutline
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel
from capsbayes.prediction import Prediction

_ALL = slice(None)


class Whitener(Protocol):
    """Residuals of one capsule's measurement from predictions."""

    @property
    def placed(self) -> int:
        """Number of measured values that determine its place in the picture."""
        ...

    @property
    def count(self) -> int:
        """Number m of residuals."""
        ...

    def __call__(self, prediction: Prediction, rows: slice = _ALL) -> Floats:
        """Return the whitened differences (k, m) from k predictions, NaN outside the model's domain."""
        ...


@dataclass(frozen=True, eq=False)
class OfLengths:
    """Measured lengths (1,) or (2,) and their covariance, the model's own error included."""

    lengths: Floats
    covariance: Floats
    placed: ClassVar[int] = 0

    @classmethod
    def of(cls, measurement: Measurement, own: Floats) -> OfLengths:
        """Return the whitener of a measurement, for a model whose own error has the covariance (2, 2)."""
        count = len(measurement.lengths)
        return cls(measurement.lengths, measurement.covariance + own[:count, :count])

    @property
    def count(self) -> int:
        """See `Whitener`."""
        return len(self.lengths)

    def __call__(self, prediction: Prediction, rows: slice = _ALL) -> Floats:
        """See `Whitener`."""
        lengths = np.stack([prediction.axial_extent[rows], prediction.axial_length[rows]], axis=1)
        away = np.where(prediction.inside[rows, None], self.lengths - lengths[:, : len(self.lengths)], np.nan)
        extent, variance = away[:, 0], self.covariance[0, 0]
        white = [extent / np.sqrt(variance)]
        if len(self.lengths) == 2:
            rest, left = length_given_extent(extent, away[:, 1], variance, *self.covariance[1])
            white.append(rest / np.sqrt(left))
        return np.stack(white, axis=1)


@dataclass(frozen=True, eq=False)
class OfOutline:
    """Measured outline; its likelihood holds the covariance, in which errors shared by all capsules are wider."""

    likelihood: OutlineLikelihood
    measured: MeasuredOutline
    placed: ClassVar[int] = 3  # shifts and tilt

    @property
    def count(self) -> int:
        """See `Whitener`."""
        return len(self.likelihood.points) + (self.likelihood.length is not None)

    def __call__(self, prediction: Prediction, rows: slice = _ALL) -> Floats:
        """See `Whitener`."""
        assert prediction.outline is not None, "asked for"
        outlines = np.where(prediction.inside[rows, None, None], prediction.outline[rows], np.nan)
        return self.likelihood.whitened(outlines, prediction.axial_length[rows], posed=True)

    def common_errors(self) -> Floats:
        """Return the changes (k, m) of the residuals by errors that all capsules share: the model's and the edge's."""
        return np.concatenate([self.errors_of_model(), self.likelihood.whitened_shared(self.measured)])

    def errors_of_model(self) -> Floats:
        """Return the changes (k, m) of the residuals by the model's own error."""
        seen = self.likelihood
        return np.zeros((0, self.count)) if seen.modes is None else seen.whitened_displacement(seen.modes)


@dataclass(frozen=True, eq=False)
class Whitening:
    """Whitener of each capsule, and the point at which it was made."""

    each: tuple[Whitener, ...]
    pilots: Floats  # (n, 2): ln Ca and a/l
    outline: bool  # whether any of them reads outlines
    further: float = 0.0  # standard deviation [l] that was added to the noise of each outline


def whitened_at(
    model: ForwardModel, session: Session, pilots: Floats, *, among: int, further: float = 0.0
) -> Whitening:
    """Make the whitening at pilots (n, 2): ln Ca and a/l of a shape of the model near each capsule."""
    # The errors of the microscope are the same `among` so many capsules. A `further` standard deviation [l] is added to
    # the noise of outlines.
    places = {**session.circumstances, "capillary_number": np.exp(pilots[:, 0]), "size_ratio": pilots[:, 1]}
    own = model(places).covariance[:, :2, :2]
    each: list[Whitener] = []
    for i, measurement in enumerate(session.measurements):
        if measurement.outline is None:
            each.append(OfLengths.of(measurement, own[i]))
        else:
            place = {name: float(values[i]) for name, values in places.items()}
            seen = measurement.outline.noisier(further).shared_by(among)
            likelihood = outline_likelihood(model, seen, place, length=measurement.length_with_outline)
            each.append(OfOutline(likelihood, measurement.outline))
    outline = any(measurement.outline is not None for measurement in session.measurements)
    return Whitening(tuple(each), pilots, outline, further)
