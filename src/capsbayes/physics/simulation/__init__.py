"""The forward problem: membrane, liquids and walls at steady state, branches, databases."""

from capsbayes.physics.simulation.build import build_database
from capsbayes.physics.simulation.entering import Entering
from capsbayes.physics.simulation.simulator import Simulator, SteadyState

__all__ = ["Entering", "Simulator", "SteadyState", "build_database"]
