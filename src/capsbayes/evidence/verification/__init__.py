"""Verification: the simulator against theory, other codes, experiments, and its own limits.

Each `Topic` has items to compute, and rows that compare them. Reference numbers
stand in `references`, all others are computed.
"""

from capsbayes.evidence.verification.capsules import circular_tube, paper_capsule
from capsbayes.evidence.verification.closed_forms import membrane_laws, single_layer, undisturbed_flow
from capsbayes.evidence.verification.discretisation import mesh_refinement, newtons_jacobian, wall_discretisation
from capsbayes.evidence.verification.rigid_sphere import rigid_spheres
from capsbayes.evidence.verification.simple_shear import simple_shear
from capsbayes.evidence.verification.topic import Topic
from capsbayes.evidence.verification.transients import transients
from capsbayes.evidence.verification.verify import verify

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
    transients(),
    simple_shear(),
)
"""All topics, in the order of the page."""
