"""A simulator of capsules that are not yet steady."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes.errors import InputError
from capsbayes.physics.capsule.steady_state import NewtonResult
from capsbayes.physics.capsule.transient import transient
from capsbayes.physics.continuation.branches import BranchEnd
from capsbayes.physics.simulation.simulator import Simulator, Start, SteadyState
from capsbayes.status import Status


@dataclass(frozen=True)
class UnsteadySimulator:
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
            raise InputError("UnsteadySimulator", "unsteadiness", "a number not below 0", str(self.unsteadiness))

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that decides its answers."""
        return {**self.simulator.settings, "unsteadiness": self.unsteadiness}

    def refined(self, refinement: int) -> UnsteadySimulator:
        """Return the same simulator on another mesh."""
        return replace(self, simulator=self.simulator.refined(refinement))

    def restored(self, values: Mapping[str, Any]) -> SteadyState:
        """Return the steady state whose fields have these values."""
        return self.simulator.restored(values)

    def run(self, *, capillary_number: float, size_ratio: float, start: Start = "rest") -> SteadyState:
        """Compute the shape and velocity of one case.

        Parameters
        ----------
        capillary_number, size_ratio : float
        start : SteadyState, "rest" or "parachute"
            Start of the search for a steady shape; a capsule that is not yet steady comes from rest.

        Returns
        -------
        SteadyState
            Its residual is the speed of the fastest node relative to the centroid [U].
        """
        if self.unsteadiness == 0.0:
            return self.simulator.run(capillary_number=capillary_number, size_ratio=size_ratio, start=start)
        with threadpool_limits(limits=1):
            problem = self.simulator.problem
            first = problem.at_rest_in_channel(capillary_number, size_ratio)
            *_, end = transient(problem, first, [1.0 / self.unsteadiness])
            reached = NewtonResult(end.iterate, True, end.speed, 0, np.zeros(len(end.iterate.free) + 2))
            return self.simulator.state(problem, BranchEnd(reached, Status.DONE), capillary_number, size_ratio)
