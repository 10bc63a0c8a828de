"""Small flat triangles in place of curved elements, to draw a surface without seams."""

from __future__ import annotations

import numpy as np

from capsbayes.arrays import Floats, Integers
from capsbayes.physics.surface.shape_functions import LOCAL_NODES, p2, p2_gradient


def facets(elements: Integers, nodes: Floats, parts: int = 6) -> tuple[Floats, Floats]:
    """Divide quadratic elements (e, 6) into ``parts**2`` triangles: corners (t, 3, 3), outward normals (t, 3)."""
    grid, triangles = subdivision(parts)
    shapes = p2(grid)
    corners = (shapes @ nodes[elements])[:, triangles].reshape(-1, 3, 3)
    normals = (shapes @ _normals(nodes, elements)[elements])[:, triangles].reshape(-1, 3, 3).mean(axis=1)
    return corners, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def subdivision(parts: int) -> tuple[Floats, Integers]:
    """Return points (p, 2) of a grid on the unit triangle, and the corners (t, 3) of its small triangles."""
    # The first parts (parts + 1) / 2 of them have the orientation of the unit triangle; each edge is one of theirs.
    index = [(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)]
    place = {key: k for k, key in enumerate(index)}
    triangles = [(place[i, j], place[i + 1, j], place[i, j + 1]) for i, j in index if i + j < parts]
    triangles += [(place[i + 1, j], place[i + 1, j + 1], place[i, j + 1]) for i, j in index if i + j < parts - 1]
    return np.array(index) / parts, np.array(triangles)


def _normals(nodes: Floats, elements: Integers) -> Floats:
    """Outward normals (N, 3) at the nodes, averaged over the elements there: they leave no seams."""
    tangents = np.einsum("qka,eki->eqai", p2_gradient(LOCAL_NODES), nodes[elements])
    total = np.zeros_like(nodes)
    np.add.at(total, elements, np.cross(tangents[:, :, 0], tangents[:, :, 1]))
    return total / np.linalg.norm(total, axis=1, keepdims=True)
