"""Energy of bending of a thin shell, from its change of curvature, with its gradient and tangent.

Koiter's energy of an isotropic shell of incompressible material, over G_s l^2,

    E = 1/2 B a^2 int (1 - nu) rho_ab rho^ab + nu (rho^a_a)^2 dS_0,     rho_ab = b_ab - B_ab,     nu = 1/2,

where b_ab = n . x_;ab is the second fundamental form of the deformed and B_ab that of the unstressed surface, and
indices are raised with the unstressed metric (Koiter 1966, Proc. K. Ned. Akad. Wet. B 69, 1-54; Ciarlet 2005,
doi 10.1007/s10659-005-4738-8). A rotation changes neither. Quadratic elements have kinks at their edges: the second
derivatives x_;ab are quadratic fields as well, projected from the weak form on the unit sphere. They are linear in x,
so that one matrix serves every shape on a mesh; the normal n is that of the element.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from capsbayes.arrays import Floats, Integers
from capsbayes.physics.capsule.element_integrals import ElementIntegrals, integrals_over, rest_metric, spheroid
from capsbayes.physics.surface.octasphere import OctaSphere
from capsbayes.physics.surface.quadrature import dunavant

_POISSON_RATIO = 0.5  # of incompressible material
_MODULI = np.array([1.0 + _POISSON_RATIO, 1.0 - _POISSON_RATIO, 1.0 - _POISSON_RATIO])
_DEGREE = 4  # of the rule of quadrature: curvatures are quadratic on an element
_PAIRS = np.array([[0, 0], [1, 1], [2, 2], [0, 1], [0, 2], [1, 2]])  # components of a symmetric tensor


class _Curvature(NamedTuple):
    """Map from second derivatives to curvatures at the points of quadrature, for an unstressed unit spheroid."""

    # The three components c are (b_11 + b_22)/2^(1/2), (b_11 - b_22)/2^(1/2) and 2^(1/2) b_12 in orthonormal axes.

    derivatives: Floats  # (w, 6, 3, F): second derivatives on the unit sphere at the nodes of `elements`
    elements: Integers  # (e, 6): one element of each orbit
    parts: Floats  # (e, q, c, 6, 6): share of each node's second derivatives in the components at a point
    rest: Floats  # (e, q, c): components of the unstressed spheroid

    def vectors(self, free: Floats) -> Floats:
        """Return the components (e, q, c, 3) of the second derivatives of a shape."""
        return np.einsum("eqckp,ekpi->eqci", self.parts, (self.derivatives @ free)[self.elements], optimize=True)

    def adjoint(self, weights: Floats) -> Floats:
        """Return the gradient (F,) of the sum of `vectors` with weights (e, q, c, 3)."""
        at_nodes = np.zeros(self.derivatives.shape[:-1])
        np.add.at(at_nodes, self.elements, np.einsum("eqckp,eqci->ekpi", self.parts, weights, optimize=True))
        gradient: Floats = at_nodes.ravel() @ self.derivatives.reshape(at_nodes.size, -1)
        return gradient

    def rows(self, weights: Floats) -> Floats:
        """Return sums (e r, F) of the second derivatives at the nodes of each element, weights (e, ..., 6, 6, 3)."""
        flat = np.ascontiguousarray(weights.reshape(len(weights), -1, 108))
        count, along = flat.shape[1], self.derivatives.shape[-1]
        rows = np.empty((len(flat) * count, along))
        for place, (weight, element) in enumerate(zip(flat, self.elements, strict=True)):
            rows[place * count : (place + 1) * count] = weight @ self.derivatives[element].reshape(108, along)
        return rows


class _Normal:
    """Unit normals (e, q, 3) of the elements and their derivatives along the nodes of the element."""

    def __init__(self, integral: ElementIntegrals, tangents: Floats) -> None:
        self.slopes = integral.slopes
        area = np.cross(tangents[:, :, 0], tangents[:, :, 1])
        self.length = np.linalg.norm(area, axis=-1)
        self.unit = area / self.length[..., None]
        turning = np.einsum("qk,eqij->eqikj", self.slopes[..., 1], _cross_matrix(tangents[:, :, 0]))
        turning -= np.einsum("qk,eqij->eqikj", self.slopes[..., 0], _cross_matrix(tangents[:, :, 1]))
        self.area_slope = turning.reshape(*self.length.shape, 3, 18)
        across = (
            self.area_slope - self.unit[..., None] * np.einsum("eqi,eqik->eqk", self.unit, self.area_slope)[:, :, None]
        )
        self.slope = across / self.length[..., None, None]

    def second(self, vectors: Floats) -> Floats:
        """Return the second derivatives (e, 18, 18) of the sum over q of the normals times vectors (e, q, 3)."""
        along = np.einsum("eqi,eqi->eq", vectors, self.unit)
        tangential = (vectors - along[..., None] * self.unit) / self.length[..., None]
        mixed = np.einsum("eqi,eqj->eqij", tangential, self.unit)
        form = -(mixed + mixed.swapaxes(-1, -2)) / self.length[..., None, None]
        form -= (along / self.length**2)[..., None, None] * (
            np.eye(3) - np.einsum("eqi,eqj->eqij", self.unit, self.unit)
        )
        curved = np.einsum("eqik,eqij,eqjl->ekl", self.area_slope, form, self.area_slope, optimize=True)
        pairs = np.einsum("qk,ql->qkl", self.slopes[..., 0], self.slopes[..., 1])
        pairs = pairs - pairs.swapaxes(1, 2)
        twisted = np.einsum("qkl,eqij->ekilj", pairs, -_cross_matrix(tangential), optimize=True)
        return curved + twisted.reshape(curved.shape)


def _cross_matrix(vectors: Floats) -> Floats:
    """Return the matrices (..., 3, 3) of the cross products with vectors (..., 3) on the left."""
    return np.cross(vectors[..., None, :], np.eye(3)).swapaxes(-1, -2)


class BentShell:
    """Energy over B a^2 G_s, and its derivatives at one shape (F,), of a shell that is a spheroid when unstressed."""

    def __init__(self, mesh: OctaSphere, free: Floats, unstressed: float, aspect: float) -> None:
        self.integral, self.curvature = integrals_over(mesh, _DEGREE), _curvature(mesh, aspect)
        self.unstressed = unstressed
        self.normal = _Normal(self.integral, self.integral.tangents(mesh.expanded(free)))
        self.vectors = self.curvature.vectors(free) / unstressed**2
        self.change = np.einsum("eqci,eqi->eqc", self.vectors, self.normal.unit) - self.curvature.rest / unstressed
        self.stiffness = rest_metric(mesh, aspect, _DEGREE).area[..., None] * unstressed**2 * _MODULI
        self.moments = self.stiffness * self.change
        self.pull = np.einsum("eqc,eqci->eqi", self.moments, self.vectors)

    @property
    def energy(self) -> float:
        """Energy."""
        return 0.5 * float(np.sum(self.moments * self.change))

    @property
    def gradient(self) -> Floats:
        """Gradient (F,) in the free coordinates."""
        weights = np.einsum("eqc,eqi->eqci", self.moments, self.normal.unit) / self.unstressed**2
        of_normals = self.integral.gathered(np.einsum("eqi,eqik->ek", self.pull, self.normal.slope))
        return self.curvature.adjoint(weights) + of_normals

    @property
    def tangent(self) -> Floats:
        """Second derivatives (F, F) in the free coordinates."""
        parts, normal = self.curvature.parts / self.unstressed**2, self.normal
        rows = self.curvature.rows(np.einsum("eqckp,eqi->eqckpi", parts, normal.unit))
        rows += _blocks(np.einsum("eqci,eqik->eqck", self.vectors, normal.slope), self.integral).toarray()
        pulled = np.einsum("eqckp,eqc,ij->eqikpj", parts, self.moments, np.eye(3), optimize=True)
        crossed = _blocks(normal.slope, self.integral).T @ self.curvature.rows(pulled)
        turned = self.integral.assembled(normal.second(self.pull))
        tangent: Floats = rows.T @ (self.stiffness.reshape(-1, 1) * rows) + crossed + crossed.T + turned
        return tangent


def _blocks(local: Floats, integral: ElementIntegrals) -> sp.csr_matrix:
    """Return rows (e r, F) along the free coordinates, of rows (e, ..., 18) along those of an element."""
    count = len(local)
    dense = np.ascontiguousarray(local.reshape(count, -1, 18))
    blocks = sp.bsr_matrix((dense, np.arange(count), np.arange(count + 1)), shape=(count * dense.shape[1], 18 * count))
    return blocks.tocsr() @ integral.scatter


@lru_cache(maxsize=8)
def _curvature(mesh: OctaSphere, aspect: float) -> _Curvature:
    integral, rest = integrals_over(mesh, _DEGREE), rest_metric(mesh, aspect, _DEGREE)
    derivatives, elements = _second_derivatives(mesh)
    axes = np.linalg.solve(np.linalg.cholesky(rest.metric), integral.tangents(mesh.nodes))
    first, second = axes[:, :, 0], axes[:, :, 1]

    def component(left: Floats, right: Floats) -> Floats:
        pairs = np.einsum("eqi,eqj->eqij", left, right)
        full = (pairs + pairs.swapaxes(-1, -2))[..., _PAIRS[:, 0], _PAIRS[:, 1]]
        return full * np.where(_PAIRS[:, 0] == _PAIRS[:, 1], 0.5, 1.0)

    b11, b22, b12 = component(first, first), component(second, second), component(first, second)
    tensors = np.stack([(b11 + b22) / np.sqrt(2.0), (b11 - b22) / np.sqrt(2.0), np.sqrt(2.0) * b12], axis=2)
    parts = np.einsum("qk,eqcp->eqckp", integral.shapes, tensors)
    curvature = _Curvature(derivatives, elements, parts, np.empty(0))
    shape = spheroid(mesh, aspect)
    normal = _Normal(integral, integral.tangents(shape)).unit
    vectors = curvature.vectors(mesh.reduced(shape[mesh.wedge]))
    return curvature._replace(rest=np.einsum("eqci,eqi->eqc", vectors, normal))


@lru_cache(maxsize=8)
def _second_derivatives(mesh: OctaSphere) -> tuple[Floats, Integers]:
    """Project the second derivatives of a field on the unit sphere; return them and the elements, see `_Curvature`."""
    # Against a test function phi S with a constant symmetric tensor S, the tangential second derivatives of u are int
    # (3 phi y - grad phi) . S grad u dS at the points y of the sphere.
    rule = integrals_over(mesh)
    tangents = np.einsum("qka,eki->eqai", rule.slopes, mesh.nodes[mesh.elements])
    metric = np.einsum("eqai,eqbi->eqab", tangents, tangents)
    area = dunavant(6).weights * np.sqrt(np.linalg.det(metric))
    gradients = np.einsum("qkb,eqab,eqai->eqki", rule.slopes, np.linalg.inv(metric), tangents, optimize=True)
    points = np.einsum("qk,eki->eqi", rule.shapes, mesh.nodes[mesh.elements])
    count = len(mesh.nodes)
    rows, columns = np.repeat(mesh.elements, 6, axis=1).ravel(), np.tile(mesh.elements, 6).ravel()

    def assembled(per_element: Floats) -> sp.csc_matrix:
        return sp.csc_matrix((per_element.ravel(), (rows, columns)), shape=(count, count))

    taken, elements = np.unique(mesh.orbits[0], return_inverse=True)
    units = np.zeros((count, len(taken)))
    units[taken, np.arange(len(taken))] = 1.0
    mass = assembled(np.einsum("eq,qk,ql->ekl", area, rule.shapes, rule.shapes, optimize=True))
    projection = splu(mass).solve(units).T
    tests = 3.0 * np.einsum("qk,eqi->eqki", rule.shapes, points) - gradients
    derivatives = np.empty((len(taken), len(_PAIRS), 3, mesh.expansion.shape[1]))
    for place, (i, j) in enumerate(_PAIRS):
        weak = sum(
            0.5 * np.einsum("eq,eqk,eql->ekl", area, tests[..., p], gradients[..., q], optimize=True)
            for p, q in ((i, j), (j, i))
        )
        for axis in range(3):
            derivatives[:, place, axis] = projection @ (assembled(weak) @ mesh.expansion[axis::3]).toarray()
    return derivatives, elements.reshape(-1, 6)
