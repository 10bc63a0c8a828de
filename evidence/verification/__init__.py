"""Verification: the simulator against theory, other codes, experiments, and its own limits.

Each `Topic` has items to compute, and rows that compare them. Reference numbers
stand in `references`, all others are computed.
"""

from evidence.verification.capsules import circular_tube, paper_capsule, simple_shear, transients
from evidence.verification.closed_forms import membrane_laws, rigid_spheres, single_layer, undisturbed_flow
from evidence.verification.discretisation import (
    largest_tension,
    mesh_refinement,
    newtons_jacobian,
    wall_discretisation,
)
from evidence.verification.topic import Topic, verify

__all__ = ["TOPICS", "verify"]

TOPICS: tuple[Topic, ...] = (
    undisturbed_flow(),
    membrane_laws(),
    single_layer(),
    rigid_spheres(),
    newtons_jacobian(),
    wall_discretisation(),
    paper_capsule(),
    circular_tube(),
    mesh_refinement(),
    largest_tension(),
    transients(),
    simple_shear(),
)
"""All topics, in the order of the page."""
