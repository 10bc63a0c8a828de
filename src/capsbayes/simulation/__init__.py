"""The forward problem: membrane, liquids and walls at steady state, branches, databases."""

from capsbayes.simulation.build import build_database
from capsbayes.simulation.entering import Entering
from capsbayes.simulation.simulator import Simulator, SteadyState

__all__ = ["Entering", "Simulator", "SteadyState", "build_database"]
