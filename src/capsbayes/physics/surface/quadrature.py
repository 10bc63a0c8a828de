"""Quadrature rules on the unit triangle: regular, subdivided, and singular at a node.

Weights sum to the triangle's area, 1/2. The symmetric rules of degree 4 to 6
are those of Dunavant (1985, doi 10.1002/nme.1620210612); a singular rule
collapses a square onto the triangle (Duffy 1982, doi 10.1137/0719090), whose
Jacobian cancels a 1/r kernel at the collapsed corner.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.physics.surface.shape_functions import CORNERS, LOCAL_NODES


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
        np.array([corner[0], middle[0], middle[2]]),
        np.array([middle[0], corner[1], middle[1]]),
        np.array([middle[2], middle[1], corner[2]]),
        np.array([middle[1], middle[2], middle[0]]),
    ]
    return _joined([_mapped(finer, quarter) for quarter in quarters])


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
