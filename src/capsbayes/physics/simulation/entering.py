"""Capsules that are still on the way to their steady shape, as a simulator of shapes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes.errors import InputError
from capsbayes.physics.simulation.continuation import BranchEnd
from capsbayes.physics.simulation.moment import first_shape
from capsbayes.physics.simulation.simulator import Simulator, Start, SteadyState
from capsbayes.physics.simulation.steady_state import NewtonResult
from capsbayes.physics.simulation.transient import transient
from capsbayes.status import Status

__all__ = ["Entering"]


@dataclass(frozen=True)
class Entering:
    """The shape of a capsule some time after it was put at rest into the flow.

    Parameters
    ----------
    simulator : Simulator
    unsteadiness : float
        Inverse of that time, l / (U t) [-]; 0 for the steady shape.

    Raises
    ------
    InputError
        If it is negative.
    """

    simulator: Simulator = field(default_factory=Simulator)
    unsteadiness: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.unsteadiness < np.inf:
            raise InputError("Entering", "unsteadiness", "a number not below 0", str(self.unsteadiness))

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that decides its answers."""
        return {**self.simulator.settings, "unsteadiness": self.unsteadiness}

    def refined(self, refinement: int) -> Entering:
        """The same on another mesh."""
        return replace(self, simulator=self.simulator.refined(refinement))

    def restored(self, values: Mapping[str, Any]) -> SteadyState:
        """Return the steady state whose fields have these values."""
        return self.simulator.restored(values)

    def run(self, *, capillary_number: float, size_ratio: float, start: Start = "rest") -> SteadyState:
        """Shape and velocity of one case.

        Parameters
        ----------
        capillary_number, size_ratio : float
        start : SteadyState, "rest" or "parachute"
            Of the search for a steady shape; a capsule that is still on the way comes from rest.

        Returns
        -------
        SteadyState
            Its residual is the speed of the fastest node beside the centroid [U].
        """
        if self.unsteadiness == 0.0:
            return self.simulator.run(capillary_number=capillary_number, size_ratio=size_ratio, start=start)
        with threadpool_limits(limits=1):
            problem = self.simulator.problem
            first = first_shape(problem, capillary_number, size_ratio)
            *_, end = transient(problem, first, [1.0 / self.unsteadiness])
            moment = NewtonResult(end.iterate, True, end.speed, 0, np.zeros(len(end.iterate.free) + 2))
            return self.simulator.state(problem, BranchEnd(moment, Status.DONE), capillary_number, size_ratio)
