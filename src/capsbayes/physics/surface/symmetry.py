"""Symmetry groups of a flow, its channel and the mesh of the capsule.

Only one node of each orbit is unknown, and sums over the surface run over one
element of each orbit. All operations are signed permutations of the axes,
because the mesh has the symmetry of an octahedron. The axisymmetric group has
the operations of the square; the fields are then restricted to axisymmetric ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats, Integers


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
