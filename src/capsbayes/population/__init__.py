"""Populations: many capsules identified at once, what they have in common, and how they differ."""

from capsbayes.population.hierarchy import Hierarchy, hierarchy
from capsbayes.population.identify_folder import identify_folder
from capsbayes.population.population import Population

__all__ = ["Hierarchy", "Population", "hierarchy", "identify_folder"]
