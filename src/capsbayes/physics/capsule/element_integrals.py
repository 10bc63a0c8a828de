"""Integrals of symmetric functions over the elements of the membrane, and the geometry of its shape at rest."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from capsbayes.arrays import Floats
from capsbayes.physics.surface.octasphere import OctaSphere
from capsbayes.physics.surface.quadrature import dunavant
from capsbayes.physics.surface.shape_functions import p2, p2_gradient


class ElementIntegrals:
    """Integrals over the surface of a symmetric function: one element of each orbit, times their number."""

    def __init__(self, mesh: OctaSphere, degree: int) -> None:
        rule = dunavant(degree)
        self.elements, multiplicity = mesh.orbits
        self.weights = multiplicity[:, None] * rule.weights
        self.shapes = p2(rule.points)
        self.slopes = p2_gradient(rule.points)
        rows = (3 * self.elements[:, :, None] + np.arange(3)).ravel()
        self.scatter: sp.csr_matrix = mesh.expansion[rows]
        self.scatter_transposed: sp.csr_matrix = self.scatter.T.tocsr()

    def tangents(self, nodes: Floats) -> Floats:
        """Return the tangents (e, q, 2, 3) along both local coordinates of the surface with nodes (N, 3)."""
        return np.einsum("qka,eki->eqai", self.slopes, nodes[self.elements])

    def gathered(self, per_element: Floats) -> Floats:
        """Sum element vectors (e, 6, 3) to free coordinates (F,)."""
        return self.scatter_transposed @ per_element.ravel()

    def assembled(self, per_element: Floats) -> Floats:
        """Assemble element matrices (e, 18, 18) to a matrix (F, F)."""
        count = len(per_element)
        blocks = sp.bsr_matrix((per_element, np.arange(count), np.arange(count + 1)))
        return (self.scatter_transposed @ (blocks @ self.scatter)).toarray()


class RestMetric(NamedTuple):
    """Metric (e, q, 2, 2), its determinant (e, q) and the weighted area (e, q) of a surface at rest."""

    metric: Floats
    determinant: Floats
    area: Floats


def spheroid(mesh: OctaSphere, aspect: float) -> Floats:
    """Return the nodes (N, 3) of a spheroid about z with this ratio of axes and the volume of the unit sphere."""
    across = aspect ** (-1.0 / 3.0)
    return mesh.nodes * [across, across, aspect * across]


@lru_cache(maxsize=16)
def integrals_over(mesh: OctaSphere, degree: int = 6) -> ElementIntegrals:
    """Return the integrals over a mesh by a rule that is exact up to a degree."""
    return ElementIntegrals(mesh, degree)


@lru_cache(maxsize=16)
def rest_metric(mesh: OctaSphere, aspect: float, degree: int = 6) -> RestMetric:
    """Return the metric of a spheroid of the volume of the unit sphere, see `spheroid`."""
    integral = integrals_over(mesh, degree)
    tangents = integral.tangents(spheroid(mesh, aspect))
    metric = np.einsum("eqai,eqbi->eqab", tangents, tangents)
    determinant = np.linalg.det(metric)
    return RestMetric(metric, determinant, integral.weights * np.sqrt(determinant))
