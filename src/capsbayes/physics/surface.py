"""The rest sphere: symmetric mesh, shape functions and quadrature."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import CubicSpline, RBFInterpolator

from capsbayes.arrays import Floats, Integers

# Quadratic (P2) shape functions on the unit triangle.
#
# Local nodes: three corners (0,0), (1,0), (0,1), then the midsides of the edges 0-1, 1-2 and 2-0

LOCAL_NODES = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5]])
"""Positions of the six local nodes on the unit triangle (6, 2)."""

CORNERS = LOCAL_NODES[:3]


def p2(points: Floats) -> Floats:
    """Compute the shape functions at positions (..., 2) on the unit triangle : (..., 6) array [-]."""
    s, t = points[..., 0], points[..., 1]
    r = 1.0 - s - t
    return np.stack([r * (2 * r - 1), s * (2 * s - 1), t * (2 * t - 1), 4 * r * s, 4 * s * t, 4 * t * r], axis=-1)


def p2_gradient(points: Floats) -> Floats:
    """Compute the derivatives of the shape functions along both local coordinates : (..., 6, 2) array [-]."""
    s, t = points[..., 0], points[..., 1]
    r = 1.0 - s - t
    zero = np.zeros_like(s)
    along_s = np.stack([1 - 4 * r, 4 * s - 1, zero, 4 * (r - s), 4 * t, -4 * t], axis=-1)
    along_t = np.stack([1 - 4 * r, zero, 4 * t - 1, -4 * s, 4 * s, 4 * (r - t)], axis=-1)
    return np.stack([along_s, along_t], axis=-1)


def tangents(nodes: Floats, elements: Integers, points: Floats) -> Floats:
    """Return the tangents (e, q, 2, 3) of elements (e, 6) along both local coordinates at points (q, 2)."""
    return np.einsum("qka,eki->eqai", p2_gradient(points), nodes[elements])


# Small flat triangles in place of curved elements, to draw a surface without seams


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
    along_s, along_t = np.moveaxis(tangents(nodes, elements, LOCAL_NODES), 2, 0)
    total = np.zeros_like(nodes)
    np.add.at(total, elements, np.cross(along_s, along_t))
    return total / np.linalg.norm(total, axis=1, keepdims=True)


# Symmetry groups of a flow, its channel and the mesh of the capsule.
#
# Only one node of each orbit is unknown, and sums over the surface run over one element of each orbit. All operations
# are signed permutations of the axes, because the mesh has the symmetry of an octahedron. The axisymmetric group has
# the operations of the square; the fields are then restricted to axisymmetric ones


@dataclass(frozen=True, eq=False)
class Symmetry:
    """A group of rotations and mirrors."""

    name: str  # Schoenflies symbol, also the name of the object in this file
    operations: Floats  # (g, 3, 3): orthogonal matrices, the identity first
    axisymmetric: bool = False  # also every rotation about z, which does not map the mesh onto itself

    def __reduce__(self) -> str:
        return self.name  # one object in every process, so that what is cached by it is found

    def orbits(self, points: Floats) -> tuple[Integers, Integers, Integers]:
        """Find the orbits of points (p, 3): representatives (r,), and of each point its orbit and operation (p,)."""
        # The representative has the largest x, of these the largest y, then z; the operation is the first that maps it
        # there.
        keys = np.round(points * 1e9).astype(np.int64)
        place = {tuple(key): index for index, key in enumerate(keys)}
        images = np.round(np.einsum("gij,pj->pgi", self.operations, points) * 1e9).astype(np.int64)
        leaders = np.array([place[max(map(tuple, orbit))] for orbit in images])
        representatives, orbit = np.unique(leaders, return_inverse=True)
        operation = np.empty(len(points), np.int64)
        for leader in representatives:
            for index in reversed(range(len(self.operations))):  # the first operation wins
                operation[place[tuple(images[leader, index])]] = index
        return representatives, orbit, operation

    def free_directions(self, point: Floats) -> Floats:
        """Return orthonormal columns (3, f): the vectors at `point` (3,) that its stabiliser leaves unchanged."""
        keeping = np.linalg.norm(self.operations @ point - point, axis=1) < 1e-9
        columns: list[Floats] = []
        for column in np.mean(self.operations[keeping], axis=0).T:
            rest = column - sum(((column @ other) * other for other in columns), np.zeros(3))
            if np.linalg.norm(rest) > 1e-9:
                columns.append(rest / np.linalg.norm(rest))
        return np.array(columns).T


_SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_MIRRORS = [np.diag([sx, sy, 1.0]) for sx in (1.0, -1.0) for sy in (1.0, -1.0)]

D4 = Symmetry("D4", np.array([mirror @ other for other in (np.eye(3), _SWAP) for mirror in _MIRRORS]))
"""Group of the square about z: four quarter rotations with mirrors; representatives have 0 <= y <= x."""

C_INF_V = Symmetry("C_INF_V", D4.operations, axisymmetric=True)
"""Group of the circle about z: every rotation, with mirrors."""

D2 = Symmetry("D2", np.array(_MIRRORS))
"""Group of the rectangle about z: a half rotation with mirrors; representatives have 0 <= x, y."""

C2H = Symmetry("C2H", np.array([np.diag([sx, s, s]) for sx in (1.0, -1.0) for s in (1.0, -1.0)]))
"""Group of a shear flow along z in the plane x = 0: the half rotation about x and the mirror x -> -x."""


# P2 mesh of the unit sphere with the symmetry of a channel, and prolongation from one mesh to another.
#
# The sphere is an octahedron with poles on the z axis; corner ring i of an octant lies at the polar angle proportional
# to i and has i equal steps in azimuth, so that elements have nearly one size everywhere. The symmetry of the problem
# decides which nodes are unknowns: one of each orbit, which together make the wedge

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


# Quadrature rules on the unit triangle: regular, subdivided, and singular at a node.
#
# Weights sum to the triangle's area, 1/2. The symmetric rules of degree 4 to 6 are those of Dunavant (1985,
# doi 10.1002/nme.1620210612); a singular rule collapses a square onto the triangle (Duffy 1982, doi 10.1137/0719090),
# whose Jacobian cancels a 1/r kernel at the collapsed corner


class Rule(NamedTuple):
    """Points (q, 2) and weights (q,) on the unit triangle."""

    points: Floats
    weights: Floats


_ORBITS: dict[int, list[tuple[float, ...]]] = {
    2: [(1 / 3, 1 / 6)],
    4: [(0.223381589678011, 0.445948490915965), (0.109951743655322, 0.091576213509771)],
    5: [(0.225, 1 / 3), (0.132394152788506, 0.470142064105115), (0.125939180544827, 0.101286507323456)],
    6: [
        (0.116786275726379, 0.249286745170910),
        (0.050844906370207, 0.063089014491502),
        (0.082851075618374, 0.053145049844817, 0.310352451033784),
    ],
}


def dunavant(degree: int) -> Rule:
    """Return the symmetric rule exact for polynomials up to `degree` (2, 4, 5 or 6)."""
    points: list[tuple[float, float]] = []
    weights: list[float] = []
    for weight, *barycentric in _ORBITS[degree]:
        if len(barycentric) == 1:
            b = barycentric[0]
            orbit = [(b, b), (1 - 2 * b, b), (b, 1 - 2 * b)] if abs(b - 1 / 3) > 1e-12 else [(b, b)]
        else:
            b, c = barycentric
            d = 1 - b - c
            orbit = [(b, c), (c, b), (b, d), (d, b), (c, d), (d, c)]
        points += orbit
        weights += [weight / 2] * len(orbit)
    return Rule(np.array(points), np.array(weights) / (2 * np.sum(weights)))


def _mapped(rule: Rule, triangle: Floats) -> Rule:
    """Map `rule` to a sub-triangle (3, 2) of the unit triangle."""
    origin, edges = triangle[0], triangle[1:] - triangle[0]
    return Rule(origin + rule.points @ edges, rule.weights * abs(np.linalg.det(edges)))


def _joined(rules: list[Rule]) -> Rule:
    return Rule(np.concatenate([r.points for r in rules]), np.concatenate([r.weights for r in rules]))


def subdivided(rule: Rule, times: int) -> Rule:
    """Apply `rule` on each of the 4**times similar triangles that halving the edges makes."""
    if times == 0:
        return rule
    finer = subdivided(rule, times - 1)
    corner, middle = CORNERS, LOCAL_NODES[3:]
    quarters = [
        [corner[0], middle[0], middle[2]],
        [middle[0], corner[1], middle[1]],
        [middle[2], middle[1], corner[2]],
        [middle[1], middle[2], middle[0]],
    ]
    return _joined([_mapped(finer, np.array(quarter)) for quarter in quarters])


def _duffy(order: int) -> Rule:
    """Return the rule for a kernel that is singular like 1/r at the corner (0, 0)."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    nodes, weights = (nodes + 1) / 2, weights / 2
    radius, side = (array.ravel() for array in np.meshgrid(nodes, nodes, indexing="ij"))
    weight = np.outer(weights * nodes, weights).ravel()
    return Rule(np.column_stack([radius * (1 - side), radius * side]), weight)


def singular(local_node: int, order: int) -> Rule:
    """Return the rule for a kernel singular like 1/r at one of the six local nodes."""
    # A corner is collapsed once; a midside node splits the triangle in two, each collapsed at that node. All six rules
    # have ``2 * order**2`` points so that they stack.
    node = LOCAL_NODES[local_node]
    if local_node < 3:
        others = [CORNERS[(local_node + 1) % 3], CORNERS[(local_node + 2) % 3]]
        middle = (others[0] + others[1]) / 2
        fans = [(others[0], middle), (middle, others[1])]
    else:
        opposite = CORNERS[(local_node - 3 + 2) % 3]
        fans = [(CORNERS[(local_node - 3) % 3], opposite), (opposite, CORNERS[(local_node - 3 + 1) % 3])]
    duffy = _duffy(order)
    return _joined([_mapped(duffy, np.array([node, first, second])) for first, second in fans])
