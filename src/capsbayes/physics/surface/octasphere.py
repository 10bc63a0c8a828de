"""P2 mesh of the unit sphere with the symmetry of a channel, and prolongation from one mesh to another.

The sphere is an octahedron with poles on the z axis; corner ring i of an octant lies
at the polar angle proportional to i and has i equal steps in azimuth, so that
elements have nearly one size everywhere. The symmetry of the problem decides
which nodes are unknowns: one of each orbit, which together make the wedge.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import CubicSpline, RBFInterpolator

from capsbayes.arrays import Floats, Integers
from capsbayes.physics.surface.symmetry import D4, Symmetry

_NEIGHBOURS = 80  # of a node, from which a field is prolonged


@dataclass(frozen=True, eq=False)
class OctaSphere:
    """Symmetric P2 mesh of the unit sphere."""

    refinement: int  # elements along the edge of an octahedron's face
    symmetry: Symmetry
    nodes: Floats  # (N, 3)
    elements: Integers  # (T, 6): corners then midsides, counterclockwise from outside; the first T/4 in x, y >= 0
    wedge: Integers  # (W,): the unknown nodes, one of each orbit: those of 0 <= y <= x under D4
    wedge_of: Integers  # (N,): position in `wedge` of the node of which each is an image
    operation: Floats  # (N, 3, 3): maps the wedge node onto the node

    @property
    def quarter(self) -> Integers:
        """Elements of the quarter x >= 0, y >= 0 (T/4, 6)."""
        return self.elements[: len(self.elements) // 4]

    @cached_property
    def orbits(self) -> tuple[Integers, Integers]:
        """One element (r, 6) of each orbit, and how many (r,) it stands for in a symmetric integral."""
        first, orbit, _ = self.symmetry.orbits(np.mean(self.nodes[self.elements[:, :3]], axis=1))
        return self.elements[first], np.bincount(orbit)

    @cached_property
    def images(self) -> Integers:
        """(g, N) int: the node that each operation maps onto each node."""
        place = {key: node for node, key in enumerate(map(tuple, np.round(self.nodes * 1e9).astype(np.int64)))}
        sources = np.round(self.nodes @ self.symmetry.operations * 1e9).astype(np.int64)
        return np.array([[place[tuple(key)] for key in keys] for keys in sources])

    @cached_property
    def basis(self) -> sp.csr_matrix:
        """(3 W, F) sparse: the wedge's vectors that symmetry leaves free, orthonormal columns."""
        if self.symmetry.axisymmetric:
            return sp.csr_matrix(_meridional(self.nodes[self.wedge], 4 * self.refinement))
        blocks = [self.symmetry.free_directions(point) for point in self.nodes[self.wedge]]
        return sp.csr_matrix(sp.block_diag([sp.coo_array(block) for block in blocks], format="csr"))

    @cached_property
    def expansion(self) -> sp.csr_matrix:
        """(3 N, F) sparse: free coordinates of the wedge to the coordinates of all nodes."""
        count = len(self.nodes)
        copies = sp.bsr_matrix(
            (self.operation, self.wedge_of, np.arange(count + 1)), shape=(3 * count, 3 * len(self.wedge))
        )
        return (copies @ self.basis).tocsr()

    def expanded(self, free: Floats) -> Floats:
        """Return the values (N, 3) at all nodes of the symmetric vector field with free coordinates (F,)."""
        return (self.expansion @ free).reshape(-1, 3)

    def reduced(self, wedge_vectors: Floats) -> Floats:
        """Return the free coordinates (F,) of the vectors (W, 3) on the wedge."""
        return self.basis.T @ wedge_vectors.ravel()

    def largest(self, free: Floats) -> float:
        """Return the largest component of the vectors at the nodes with free coordinates (F,)."""
        return float(np.max(np.abs(self.basis @ free)))


def _meridional(points: Floats, intervals: int) -> Floats:
    """Return orthonormal columns (3 W, 2 intervals): axisymmetric fields at points (W, 3) of the sphere."""
    # Their radial and axial parts are cubic splines of the polar angle, odd and even about the poles, with knots at the
    # latitudes of the mesh.
    knots = np.pi / intervals * np.arange(-intervals, intervals + 1)
    polar, azimuth = np.arccos(np.clip(points[:, 2], -1.0, 1.0)), np.arctan2(points[:, 1], points[:, 0])
    columns = []
    for parity, first, last, along in (
        (-1.0, 1, intervals, np.stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth], axis=1)),
        (1.0, 0, intervals + 1, np.tile([0.0, 0.0, 1.0], (len(points), 1))),
    ):
        values = np.array([(np.arange(len(knots)) == intervals + place) * 1.0 for place in range(first, last)]).T
        values = values + parity * values[::-1]
        splines = CubicSpline(knots, values, bc_type="periodic")(polar)
        columns.append(np.einsum("wi,wk->wik", along, splines).reshape(3 * len(points), -1))
    orthonormal: Floats = np.linalg.qr(np.hstack(columns))[0]
    return orthonormal


def _octant(refinement: int) -> tuple[Floats, Integers]:
    """Return points (p, 3) and P2 triangles (t, 6), counterclockwise seen from outside, of x, y, z >= 0."""
    points: list[Floats] = []
    index: dict[tuple[int, int], int] = {}
    for ring in range(refinement + 1):
        polar = 0.5 * np.pi * ring / refinement
        for step in range(ring + 1):
            azimuth = 0.5 * np.pi * step / ring if ring else 0.0
            index[ring, step] = len(points)
            points.append(np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]))
    middles: dict[tuple[int, int], int] = {}

    def middle(first: int, second: int) -> int:
        # The midside lies on the great circle: an arc of latitude would bend the elements near the pole within the
        # surface by as much as their size, and reduce the order of accuracy.
        edge = (min(first, second), max(first, second))
        if edge not in middles:
            middles[edge] = len(points)
            chord = points[first] + points[second]
            points.append(chord / np.linalg.norm(chord))
        return middles[edge]

    triangles = []
    for ring in range(refinement):
        for step in range(ring + 1):
            corners = [((ring, step), (ring + 1, step), (ring + 1, step + 1))]
            if step < ring:
                corners.append(((ring, step), (ring + 1, step + 1), (ring, step + 1)))
            for a, b, c in (tuple(index[corner] for corner in triple) for triple in corners):
                triangles.append([a, b, c, middle(a, b), middle(b, c), middle(c, a)])
    return np.array(points), np.array(triangles)


@lru_cache(maxsize=8)
def octasphere(refinement: int, symmetry: Symmetry = D4) -> OctaSphere:
    """Make a mesh with 8 refinement**2 elements and 16 refinement**2 + 2 nodes."""
    points, triangles = _octant(refinement)
    all_points: list[Floats] = []
    all_triangles: list[Integers] = []
    for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        for sz in (1, -1):
            flip = sx * sy * sz < 0
            block = triangles[:, [0, 2, 1, 5, 4, 3]] if flip else triangles
            all_triangles.append(block + len(points) * len(all_points))
            all_points.append(points * [sx, sy, sz])
    stacked = np.concatenate(all_points)
    keys = np.round(stacked * 1e9).astype(np.int64)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    nodes = stacked[first]
    elements = inverse.ravel()[np.concatenate(all_triangles)]
    wedge, wedge_of, operation = symmetry.orbits(nodes)
    return OctaSphere(refinement, symmetry, nodes, elements, wedge, wedge_of, symmetry.operations[operation])


def prolonged(free: Floats, coarse: OctaSphere, fine: OctaSphere) -> Floats:
    """Return the free coordinates on `fine` of the symmetric field with free coordinates `free` on `coarse`."""
    # Interpolated smoothly: the kinks of P2 interpolation at the coarse elements' edges would strain the fine ones by
    # more than Newton's iteration recovers from.
    if coarse is fine:
        return free
    field = RBFInterpolator(coarse.nodes, coarse.expanded(free), kernel="cubic", degree=1, neighbors=_NEIGHBOURS)
    return fine.reduced(field(fine.nodes[fine.wedge]))
