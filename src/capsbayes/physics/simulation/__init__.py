"""The simulator: steady shapes and transients of one capsule in a channel."""

from capsbayes.physics.simulation.simulator import Simulator, SteadyState
from capsbayes.physics.simulation.unsteady import UnsteadySimulator

__all__ = ["Simulator", "SteadyState", "UnsteadySimulator"]
