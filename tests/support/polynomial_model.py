"""A manufactured forward model: smooth, invertible and cheap, with the look of the real one but none of its physics."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from capsbayes.model import Domain, ForwardModel
from capsbayes.prediction import Prediction


@dataclass(frozen=True)
class PolynomialDomain(Domain):
    """Ca from 0.005 to 0.15, less above a/l = 0.9; a/l from 0.70 to 1.15."""

    lowest: float = 0.005
    highest: float = 0.15

    @property
    def bounds(self):
        return (self.lowest, self.highest), (0.70, 1.15)

    def limit(self, size_ratio):
        return self.highest - 0.2 * np.maximum(np.asarray(size_ratio) - 0.9, 0.0)

    def contains(self, capillary_number, size_ratio, *coordinates):
        ca, size = np.broadcast_arrays(np.atleast_1d(capillary_number), np.atleast_1d(size_ratio))
        with np.errstate(invalid="ignore"):
            return (ca >= self.lowest) & (ca <= self.limit(size)) & (size >= 0.70) & (size <= 1.15)


@dataclass(frozen=True)
class PolynomialModel(ForwardModel):
    """Polynomials in x = log(Ca / 0.082) and y = a/l - 0.96; at x = y = 0 the lengths of the paper's capsule."""

    error: float = 0.003
    domain: PolynomialDomain = field(default_factory=PolynomialDomain)
    name: str = "manufactured polynomial"
    sha256: str = "0" * 64

    def __call__(self, theta, *, outline=False):
        self.check_names(theta)
        ca, size = np.asarray(theta["capillary_number"]), np.asarray(theta["size_ratio"])
        inside = self.domain.contains(ca, size)
        x, y = np.log(np.where(inside, ca, 0.082) / 0.082), np.where(inside, size, 0.96) - 0.96
        depth = 0.33 * np.exp(0.9 * x) * (1.0 + 0.5 * y)
        extent = 2.14 + 0.08 * x + 3.9 * y + 0.2 * x * y + 1.5 * y**2
        velocity = 1.29 + 0.03 * x - 1.2 * y + 0.4 * y**2
        stretch = 1.12 + 0.04 * x + 0.5 * y
        covariance = self._covariance(x, y)
        values = [np.where(inside, v, np.nan) for v in (extent, extent - depth, velocity, stretch)]
        covariance[~inside] = np.nan
        return Prediction(
            *values, covariance=covariance, inside=inside, outline=self._outline(values) if outline else None
        )

    def _covariance(self, x, y):
        """Larger towards low Ca, and correlated."""
        scale = self.error * np.exp(-0.3 * x) * (1.0 + y**2)
        correlation = np.array([[1.0, 0.3, 0.2], [0.3, 1.0, 0.1], [0.2, 0.1, 1.0]]) * np.outer([1, 1, 0.4], [1, 1, 0.4])
        return scale[:, None, None] ** 2 * correlation

    @staticmethod
    def _outline(values, points=256):
        """An egg with a hollow rear of the predicted lengths."""
        extent, length, _, _ = values
        angle = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
        z = 0.5 * extent[:, None] * np.cos(angle)
        rear = np.exp(-(((angle - np.pi) / 0.5) ** 2))
        z = z + (extent - length)[:, None] * rear
        y = np.broadcast_to(0.8 * np.sin(angle), z.shape)
        return np.stack([z, y], axis=-1)


@dataclass(frozen=True)
class FoldedModel(PolynomialModel):
    """Two capillary numbers for one shape: the depth of the rear has its least at Ca = 0.03."""

    name: str = "manufactured fold"

    def __call__(self, theta, *, outline=False):
        self.check_names(theta)
        ca, size = np.asarray(theta["capillary_number"]), np.asarray(theta["size_ratio"])
        inside = self.domain.contains(ca, size)
        x, y = np.log(np.where(inside, ca, 0.03) / 0.03), np.where(inside, size, 0.96) - 0.96
        extent = 2.10 + 0.02 * x + 3.9 * y
        values = [
            np.where(inside, v, np.nan) for v in (extent, extent - 0.2 - 0.2 * x**2, 1.29 - 1.2 * y, 1.1 + 0.0 * x)
        ]
        covariance = np.where(inside[:, None, None], self._covariance(0.0 * x, y), np.nan)
        return Prediction(*values, covariance=covariance, inside=inside)
