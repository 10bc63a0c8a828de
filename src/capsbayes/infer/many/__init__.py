"""Many capsules: identified at once, and the population they belong to."""

from capsbayes.infer.many.distribution.hierarchy import Hierarchy, hierarchy
from capsbayes.infer.many.identify_folder import identify_folder
from capsbayes.infer.many.population import Population

__all__ = ["Hierarchy", "Population", "hierarchy", "identify_folder"]
