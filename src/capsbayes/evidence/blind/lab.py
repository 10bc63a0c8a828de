"""A laboratory that is drawn: its channel, its liquid, its capsules, and how well it measures."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from capsbayes.experiment import Experiment
from capsbayes.quantity import Quantity

__all__ = ["Lab", "Noise"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """Errors of what is measured, and what the lab believes of them.

    Parameters
    ----------
    scale : float
        Standard deviation of an edge's error along the normal that the lab states, over l.
    correlation_length : float
        Along the outline, over l; zero for independent errors.
    velocity : float
        Relative standard error of a capsule's velocity.
    understated : float
        True standard deviation over that stated.
    freedom : float or None
        Degrees of freedom of Student's t, by which the errors of whole capsules vary in size; None for Gaussian.
    points : int
        Vertices of a measured outline.
    """

    scale: float = 0.01
    correlation_length: float = 0.2
    velocity: float = 0.01
    understated: float = 1.0
    freedom: float | None = None
    points: int = 48


@dataclass(frozen=True)
class Lab:
    """Channel, liquid, flow rates and population of capsules.

    Parameters
    ----------
    half_width, half_width_error : float [m]
    viscosity, viscosity_error : float [Pa s]
    mean_velocities : tuple of float [m/s]
        Of the undisturbed flow at each flow rate.
    surface_shear_modulus : float [N/m]
        Median of the capsules in the middle of `size_ratios`.
    spread : float
        Standard deviation of ln G_s between capsules.
    slope : float
        d ln G_s / d ln a.
    size_ratios : (float, float)
        Range of a/l, in which it is uniform.
    noise : Noise
    """

    half_width: float = 25e-6
    half_width_error: float = 0.25e-6
    viscosity: float = 0.8
    viscosity_error: float = 0.02
    mean_velocities: tuple[float, ...] = (2.6e-3, 3.2e-3, 4.0e-3, 5.0e-3)
    surface_shear_modulus: float = 0.05
    spread: float = 0.1
    slope: float = 0.0
    size_ratios: tuple[float, float] = (0.79, 0.98)
    noise: Noise = field(default_factory=Noise)

    @property
    def experiment(self) -> Experiment:
        """What the lab knows of its channel and its liquid."""
        return Experiment(
            cross_section="square",
            half_width=Quantity(self.half_width, self.half_width_error),
            viscosity=Quantity(self.viscosity, self.viscosity_error),
        )

    def log_density(self, surface_shear_modulus: Floats, size_ratio: Floats) -> Floats:
        """Logarithm of the density of ln G_s at given a/l, but for a constant; -inf outside the range of sizes."""
        low, high = self.size_ratios
        away = (np.log(surface_shear_modulus) - self._median(size_ratio)) / self.spread
        return np.where((size_ratio >= low) & (size_ratio <= high), -0.5 * away**2, -np.inf)

    def drawn(self, rng: np.random.Generator, count: int) -> tuple[Floats, Floats, Floats]:
        """G_s [N/m], a/l and U [m/s] of capsules : (count,) arrays."""
        low, high = self.size_ratios
        size = rng.uniform(low, high, count)
        modulus = np.exp(self._median(size) + self.spread * rng.standard_normal(count))
        return modulus, size, rng.choice(np.array(self.mean_velocities), count)

    def _median(self, size_ratio: Floats) -> Floats:
        """Median of ln G_s at given a/l."""
        relative = size_ratio / np.mean(self.size_ratios)
        return np.asarray(np.log(self.surface_shear_modulus) + self.slope * np.log(relative))
