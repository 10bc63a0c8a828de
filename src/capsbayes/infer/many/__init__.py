"""Many capsules: identified at once, the population they belong to, and the membrane that they share."""

from capsbayes.infer.many.distribution.hierarchy import Hierarchy, hierarchy
from capsbayes.infer.many.identify_folder import identify_folder
from capsbayes.infer.many.one_membrane.identify_membrane import identify_membrane
from capsbayes.infer.many.one_membrane.shared_membrane import SharedMembrane
from capsbayes.infer.many.population import Population

__all__ = ["Hierarchy", "Population", "SharedMembrane", "hierarchy", "identify_folder", "identify_membrane"]
