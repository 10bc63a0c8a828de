"""The laboratory of a blind session: its channel, its liquid, its capsules, and its errors of measurement."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.experiment import Experiment
from capsbayes.quantity import Quantity


@dataclass(frozen=True)
class Noise:
    """Errors of measurement, and what the lab states of them."""

    scale: float = 0.01  # stated standard deviation of an edge's error along the normal, over l
    correlation_length: float = 0.2  # of the errors along the outline, over l; zero for independent errors
    velocity: float = 0.01  # relative standard error of a capsule's velocity
    understated: float = 1.0  # true standard deviation over the stated one
    freedom: float | None = None  # of Student's t, which scales the errors of whole capsules; None for Gaussian errors
    points: int = 48  # vertices of a measured outline
    kernel: str = "exponential"  # of the errors, as the likelihood assumes; or "squared exponential"
    longer: float = 1.0  # true correlation length over the stated one


@dataclass(frozen=True)
class Lab:
    """Channel, liquid, flow rates and population of capsules."""

    half_width: float = 25e-6  # [m]
    half_width_error: float = 0.25e-6
    viscosity: float = 0.8  # [Pa s]
    viscosity_error: float = 0.02
    mean_velocities: tuple[float, ...] = (2.6e-3, 3.2e-3, 4.0e-3, 5.0e-3)  # [m/s], one a flow rate
    surface_shear_modulus: float = 0.05  # [N/m], median in the middle of `size_ratios`
    spread: float = 0.1  # standard deviation of ln G_s between capsules
    slope: float = 0.0  # d ln G_s / d ln a
    size_ratios: tuple[float, float] = (0.79, 0.98)  # range of a/l, which is uniform there
    noise: Noise = field(default_factory=Noise)
    flow_rate_error: float | None = None  # relative, common to all; None if the lab does not state flow rates
    viscosity_stated: float = 1.0  # over the true one

    def stated_over_true_flow(self, rng: np.random.Generator) -> float | None:
        """Draw the stated flow rate over that which the nominal width and the true U give; None if not stated."""
        # Both the flow rate and the width are wrong within their errors.
        if self.flow_rate_error is None:
            return None
        width = rng.normal(1.0, self.half_width_error / self.half_width)
        return float(rng.normal(1.0, self.flow_rate_error) * width**2)

    @property
    def experiment(self) -> Experiment:
        """The channel and the liquid as the lab knows them."""
        return Experiment(
            cross_section="square",
            half_width=Quantity(self.half_width, self.half_width_error),
            viscosity=Quantity(self.viscosity * self.viscosity_stated, self.viscosity_error),
        )

    def log_density(self, surface_shear_modulus: Floats, size_ratio: Floats) -> Floats:
        """Return the log density of ln G_s at given a/l, up to a constant; -inf outside the range of sizes."""
        low, high = self.size_ratios
        deviation = (np.log(surface_shear_modulus) - self._median(size_ratio)) / self.spread
        return np.where((size_ratio >= low) & (size_ratio <= high), -0.5 * deviation**2, -np.inf)

    def drawn(self, rng: np.random.Generator, count: int) -> tuple[Floats, Floats, Floats]:
        """Draw G_s [N/m], a/l and U [m/s] of capsules : (count,) arrays."""
        low, high = self.size_ratios
        size = rng.uniform(low, high, count)
        modulus = np.exp(self._median(size) + self.spread * rng.standard_normal(count))
        return modulus, size, rng.choice(np.array(self.mean_velocities), count)

    def _median(self, size_ratio: Floats) -> Floats:
        """Return the median of ln G_s at given a/l."""
        relative = size_ratio / np.mean(self.size_ratios)
        return np.asarray(np.log(self.surface_shear_modulus) + self.slope * np.log(relative))
