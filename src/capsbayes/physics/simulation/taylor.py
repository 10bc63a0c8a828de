"""Taylor's deformation of a capsule in a shear flow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capsbayes.physics.surface.octasphere import OctaSphere
from capsbayes.physics.surface.quadrature import dunavant
from capsbayes.physics.surface.shape_functions import p2, p2_gradient

__all__ = ["taylor_deformation"]


def taylor_deformation(mesh: OctaSphere, nodes: NDArray[np.float64]) -> float:
    """D = (L - B) / (L + B) of the ellipsoid with the capsule's inertia.

    Parameters
    ----------
    mesh : OctaSphere
    nodes : (N, 3) array
        Where the mesh's nodes are now, in any unit, the centroid at the origin.

    Returns
    -------
    float
        With L and B the longest and shortest axis in the plane of shear x = 0.

    Examples
    --------
    >>> from capsbayes.physics.surface.octasphere import octasphere
    >>> sphere = octasphere(8)
    >>> round(taylor_deformation(sphere, sphere.nodes * [1.0, 0.9, 1.1]), 4)
    0.1
    """
    rule = dunavant(6)
    points = p2(rule.points) @ nodes[mesh.elements]
    tangents = np.einsum("qka,eki->eqai", p2_gradient(rule.points), nodes[mesh.elements])
    flux = rule.weights * np.einsum("eqi,eqi->eq", points, np.cross(tangents[:, :, 0], tangents[:, :, 1]))
    inertia = np.einsum("eq,eqi,eqj->ij", flux, points[..., 1:], points[..., 1:])
    shortest, longest = np.sqrt(np.linalg.eigvalsh(inertia))
    return float((longest - shortest) / (longest + shortest))
