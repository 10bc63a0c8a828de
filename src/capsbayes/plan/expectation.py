"""Capsules expected in an experiment, and its conditions, before anything is measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.experiment import Experiment, capillary_number, size_ratio
from capsbayes.infer.log_grid import LogGrid
from capsbayes.quantity import Given, Quantity


@dataclass(frozen=True, eq=False)
class Draws:
    """Independent draws of capsules, of the liquid and of the channel : (n,) arrays, SI."""

    surface_shear_modulus: Floats
    capsule_radius: Floats
    viscosity: Floats
    half_width: Floats

    @property
    def size_ratio(self) -> Floats:
        """a/l of each : (n,) array."""
        return size_ratio(capsule_radius=self.capsule_radius, half_width=self.half_width)

    def capillary_number(self, mean_velocity: float) -> Floats:
        """Return Ca of each at one mean velocity of the flow [m/s] : (n,) array."""
        return capillary_number(
            viscosity=self.viscosity, mean_velocity=mean_velocity, surface_shear_modulus=self.surface_shear_modulus
        )


@dataclass(frozen=True, eq=False)
class Expectation:
    """Expected G_s and a, with what is known of liquid and channel.

    >>> lab = Experiment(cross_section="square", half_width=25e-6, viscosity=0.8)
    >>> soon = Expectation.of("50 +/- 10 mN/m", 24e-6, lab)
    >>> soon.known, round(soon.centre.size_ratio.item(), 3)
    (False, 0.96)
    """

    surface_shear_modulus: Quantity
    capsule_radius: Quantity
    viscosity: Quantity
    half_width: Quantity

    @classmethod
    def of(cls, surface_shear_modulus: Given, capsule_radius: Given, experiment: Experiment) -> Expectation:
        """Return what is expected under the conditions of an experiment; refuse a G_s or a that is not positive."""
        return cls(
            Quantity.of(surface_shear_modulus, "surface_shear_modulus", where="expected"),
            Quantity.of(capsule_radius, "capsule_radius", where="expected"),
            experiment.viscosity,
            experiment.half_width,
        )

    @property
    def known(self) -> bool:
        """True if all values are known without error."""
        return all(quantity.known for quantity in self._all.values())

    @property
    def centre(self) -> Draws:
        """Capsule with the expected values."""
        return Draws(**{name: np.array([quantity.value]) for name, quantity in self._all.items()})

    def drawn(self, rng: np.random.Generator, count: int) -> Draws:
        """Draw independently; one draw if all is known."""
        if self.known:
            return self.centre
        return Draws(**{name: LogGrid.of(quantity).drawn(rng, count) for name, quantity in self._all.items()})

    def as_dict(self) -> dict[str, dict[str, float]]:
        """Return mean and standard deviation of each, SI."""
        return {name: {"value": quantity.value, "error": quantity.error} for name, quantity in self._all.items()}

    @property
    def _all(self) -> dict[str, Quantity]:
        return {name: getattr(self, name) for name in Draws.__dataclass_fields__}
