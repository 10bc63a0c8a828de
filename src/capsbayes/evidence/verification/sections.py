"""All sections, in the order of the page."""

from __future__ import annotations

from capsbayes.evidence.verification import (
    circular_tube,
    jacobian,
    membrane_laws,
    paper_capsule,
    refinement,
    rigid_sphere,
    simple_shear,
    single_layer,
    transients,
    undisturbed_flow,
    walls,
)
from capsbayes.evidence.verification.section import Section

__all__ = ["SECTIONS"]

SECTIONS: tuple[Section, ...] = (
    undisturbed_flow.section(),
    membrane_laws.section(),
    single_layer.section(),
    rigid_sphere.section(),
    jacobian.section(),
    walls.section(),
    paper_capsule.section(),
    circular_tube.section(),
    refinement.section(),
    transients.section(),
    simple_shear.section(),
)
