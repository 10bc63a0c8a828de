"""Inputs with an error other than the lengths: viscosity, half width and velocity of the capsule."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity

LOOSEST_VELOCITY = 0.25
"""Largest relative standard error of a velocity: beyond it the flow could be arbitrarily slow."""


@dataclass(frozen=True, eq=False)
class Inputs:
    """Inputs of one capsule other than its lengths."""

    viscosity: Quantity
    half_width: Quantity
    capsule_velocity: Quantity

    @classmethod
    def of(cls, measurement: Measurement, experiment: Experiment) -> Inputs:
        """Gather the inputs from the measurement and the experiment."""
        return cls.of_experiment(experiment).with_velocity_of(measurement)

    @classmethod
    def of_experiment(cls, experiment: Experiment) -> Inputs:
        """Return the inputs that many capsules share, with NaN as the velocity."""
        return cls(experiment.viscosity, experiment.half_width, Quantity(np.nan, unit="m/s"))

    def with_velocity_of(self, measurement: Measurement) -> Inputs:
        """Return the same viscosity and half width with the velocity of a capsule.

        Raises
        ------
        InputError
            If the measurement failed, or its velocity is less certain than `LOOSEST_VELOCITY`.
        """
        if not measurement.status.ok:
            where = measurement.source or "measurement"
            raise InputError(where, "status", "a measurement that ended as it should", str(measurement.status))
        if measurement.capsule_velocity_error > LOOSEST_VELOCITY * measurement.capsule_velocity:
            where, share = measurement.source or "measurement", LOOSEST_VELOCITY
            got = f"{measurement.capsule_velocity_error / measurement.capsule_velocity:.0%}"
            raise InputError(where, "capsule_velocity", f"a standard error below {share:.0%} of the velocity", got)
        velocity = Quantity(measurement.capsule_velocity, measurement.capsule_velocity_error, "m/s")
        return replace(self, capsule_velocity=velocity)
