"""Velocity of the membrane in the two liquids: undisturbed flow, single layer and response of the walls.

    v(x) = v_inf(x) + (single layer of f)(x) + (response of the walls)(x)

The liquids have equal viscosities, so the density f alone, the force of the membrane on them per rest area, decides
their motion (Pozrikidis 1992, doi 10.1017/CBO9780511624124). Vectors are free coordinates (F,) of the mesh's wedge.
"""

from __future__ import annotations

import scipy.sparse as sp

from capsbayes.arrays import Floats
from capsbayes.physics.stokes.channel import Channel, Flow
from capsbayes.physics.stokes.single_layer import SingleLayer
from capsbayes.physics.stokes.stokeslet import images_gradient
from capsbayes.physics.stokes.walls import WallDiscretisation, wall_operator
from capsbayes.physics.surface.octasphere import OctaSphere


def membrane_velocity(
    flow: Flow, walls: WallDiscretisation, mesh: OctaSphere, radius: float, free: Floats, density: Floats
) -> Floats:
    """Compute the velocity (F,) of the membrane in the frame of the walls, from shape (F,) and density (F,)."""
    # The density [mu U / l] is the force on the liquids per area of the sphere of this radius [l].
    basis, nodes = mesh.basis, mesh.expanded(free)
    targets, wedge_density = nodes[mesh.wedge], basis @ density
    layer = SingleLayer(mesh, radius, nodes)
    velocity = layer.matrices(targets, target_nodes=mesh.wedge).velocity @ wedge_density
    velocity += flow.undisturbed(targets)[0].ravel()
    if isinstance(flow, Channel):
        operator = wall_operator(flow, walls)
        strengths = operator.strengths(layer.matrices(operator.points).velocity @ wedge_density)
        velocity += operator.velocity_matrix(targets) @ strengths.ravel()
    return basis.T @ velocity


def membrane_response(
    flow: Flow, walls: WallDiscretisation, mesh: OctaSphere, radius: float, free: Floats, density: Floats
) -> tuple[Floats, Floats, Floats]:
    """Compute the velocity (F,) of the membrane and its exact derivatives (F, F) along density and shape."""
    basis, nodes = mesh.basis, mesh.expanded(free)
    targets, wedge_density = nodes[mesh.wedge], basis @ density
    layer = SingleLayer(mesh, radius, nodes, mesh.expanded(density))
    near = layer.matrices(targets, target_nodes=mesh.wedge)
    undisturbed, along_target = flow.undisturbed(targets)
    velocity = near.velocity @ wedge_density + undisturbed.ravel()
    along_target = along_target + near.target_slope
    along_density = _both_reduced(mesh, near.velocity)
    along_shape = _both_reduced(mesh, -near.source_slope)
    if isinstance(flow, Channel):
        operator = wall_operator(flow, walls)
        far = layer.matrices(operator.points)
        strengths = operator.strengths(far.velocity @ wedge_density)
        to_membrane = operator.velocity_matrix(targets)
        velocity += to_membrane @ strengths.ravel()
        response = operator.response(basis.T @ to_membrane)
        along_density -= response @ (basis.T @ far.velocity.T).T
        along_shape += response @ (basis.T @ far.source_slope.T).T
        along_target += images_gradient(targets, operator.sources, flow.symmetry.operations, strengths)
    moved = (basis.T @ sp.block_diag([sp.coo_array(block) for block in along_target], format="csr") @ basis).toarray()
    return basis.T @ velocity, along_density, along_shape + moved


def _both_reduced(mesh: OctaSphere, matrix: Floats) -> Floats:
    """Reduce a matrix (3 W, 3 W) between vectors of the wedge to one (F, F) between free coordinates."""
    return mesh.basis.T @ (mesh.basis.T @ matrix.T).T
