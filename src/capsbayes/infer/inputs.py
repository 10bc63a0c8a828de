"""Inputs with an error other than the lengths: viscosity, half width, velocity of the capsule and flow rate."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import AREAS, Experiment, mean_velocity
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity

LOOSEST_VELOCITY = 0.25
"""Largest relative standard error of a velocity or flow rate: beyond it the flow could be arbitrarily slow."""


@dataclass(frozen=True, eq=False)
class Inputs:
    """Inputs of one capsule other than its lengths; `area` is that of the cross-section over l^2.

    Where only the product mu U is known, `viscous_tension` is True: the viscosity is that product over 1 m/s, the
    velocity is 1 m/s, and the posterior density takes v_o/U as one, so that G_s = mu U / Ca. Where the velocity was not
    measured, it is NaN, and the flow rate alone tells U.
    """

    viscosity: Quantity
    half_width: Quantity
    capsule_velocity: Quantity
    flow_rate: Quantity | None = None
    area: float = 4.0
    viscous_tension: bool = False

    @classmethod
    def of(cls, measurement: Measurement, experiment: Experiment) -> Inputs:
        """Gather the inputs from the measurement and the experiment."""
        return cls.of_experiment(experiment).with_velocity_of(measurement)

    @property
    def by_flow_rate(self) -> bool:
        """True if the flow rate is the only source of U."""
        return self.flow_rate is not None and bool(np.isnan(self.capsule_velocity.value))

    @property
    def first_source(self) -> Inputs:
        """The same without a flow rate that is a second source of U."""
        return self if self.by_flow_rate else replace(self, flow_rate=None)

    def mean_velocity(self, velocity_ratio: ArrayLike) -> Floats:
        """Return U [m/s] by the central values of the inputs: of the flow rate alone if the velocity is missing."""
        if self.flow_rate is not None and self.by_flow_rate:
            return np.full(np.shape(velocity_ratio), self.flow_rate.value / (self.area * self.half_width.value**2))
        ratio = np.ones(np.shape(velocity_ratio)) if self.viscous_tension else velocity_ratio
        return mean_velocity(capsule_velocity=self.capsule_velocity.value, velocity_ratio=ratio)

    @classmethod
    def of_experiment(cls, experiment: Experiment) -> Inputs:
        """Return the inputs that many capsules share, with NaN as the velocity."""
        velocity, area = Quantity(np.nan, unit="m/s"), AREAS[experiment.cross_section]
        if experiment.viscous_tension is not None:
            velocity = Quantity(1.0, unit="m/s")
            return cls(experiment.viscous_tension, experiment.half_width, velocity, area=area, viscous_tension=True)
        return cls(experiment.viscosity, experiment.half_width, velocity, area=area)

    def with_velocity_of(self, measurement: Measurement) -> Inputs:
        """Return the same viscosity and half width with the velocity of a capsule and the flow rate.

        Raises
        ------
        InputError
            If the measurement failed, has neither velocity nor flow rate, one of them is less certain than
            `LOOSEST_VELOCITY`, a flow rate alone has no error, or it contradicts a viscous tension.
        """
        if not measurement.status.ok:
            where = measurement.source or "measurement"
            raise InputError(where, "status", "a measurement that ended as it should", str(measurement.status))
        if self.viscous_tension:
            if measurement.flow_rate is not None:
                where = measurement.source or "measurement"
                raise InputError(where, "flow_rate", "none: the experiment states viscous_tension", "one")
            return self
        rate = measurement.flow_rate and Quantity(measurement.flow_rate, measurement.flow_rate_error or 0.0, "m^3/s")
        by_rate = rate is not None and measurement.capsule_velocity is None
        if by_rate and not measurement.flow_rate_error:
            expected = "a standard error, as no velocity is stated"
            raise InputError(measurement.source or "measurement", "flow_rate", expected, "none")
        velocity = self.capsule_velocity if by_rate else measurement.known_velocity
        for key, seen in (("capsule_velocity", velocity), ("flow_rate", rate)):
            if seen is not None and seen.error > LOOSEST_VELOCITY * seen.value:
                where, what = measurement.source or "measurement", key.rpartition("_")[2]
                expected = f"a standard error below {LOOSEST_VELOCITY:.0%} of the {what}"
                raise InputError(where, key, expected, f"{seen.error / seen.value:.0%}")
        return replace(self, capsule_velocity=velocity, flow_rate=rate)
