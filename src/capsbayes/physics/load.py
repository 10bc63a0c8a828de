"""The load of a deformed membrane on the liquids, in its plane and by bending."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from functools import lru_cache
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from numba import njit
from scipy.sparse.linalg import splu

from capsbayes.arrays import Floats, Integers
from capsbayes.physics.channel import Channel, Flow
from capsbayes.physics.membrane import MembraneLaw
from capsbayes.physics.stokes import SingleLayer, WallDiscretisation, images_gradient, wall_operator
from capsbayes.physics.surface import LOCAL_NODES, OctaSphere, dunavant, p2, p2_gradient, subdivision, tangents
from capsbayes.profile import Profile

# The numbers that a simulator or a problem has as parameters: its own and those of its membrane law

Owner = TypeVar("Owner")


def parameters_of(owner: Any) -> dict[str, float]:
    """Return the fields of a dataclass and of its `law` that are numbers, but not whole ones."""
    return _numbers(owner) | _numbers(getattr(owner, "law", None))


def changed(owner: Owner, name: str, value: float) -> Owner:
    """Return a dataclass with another value of one of its parameters or of those of its law."""
    if name in _numbers(owner):
        return replace(owner, **{name: value})  # type: ignore[type-var]
    law = owner.law  # type: ignore[attr-defined]
    return replace(owner, law=replace(law, **{name: value}))  # type: ignore[type-var]


def _numbers(owner: Any) -> dict[str, float]:
    values = {field.name: getattr(owner, field.name) for field in fields(owner)} if is_dataclass(owner) else {}
    return {name: value for name, value in values.items() if isinstance(value, float)}


# Integrals of symmetric functions over the elements of the membrane, and the geometry of its shape at rest


class ElementIntegrals:
    """Integrals over the surface of a symmetric function: one element of each orbit, times their number."""

    def __init__(self, mesh: OctaSphere, degree: int) -> None:
        rule = dunavant(degree)
        self.elements, multiplicity = mesh.orbits
        self.weights = multiplicity[:, None] * rule.weights
        self.points, self.shapes, self.slopes = rule.points, p2(rule.points), p2_gradient(rule.points)
        rows = (3 * self.elements[:, :, None] + np.arange(3)).ravel()
        self.scatter: sp.csr_matrix = mesh.expansion[rows]
        self.scatter_transposed: sp.csr_matrix = self.scatter.T.tocsr()

    def tangents(self, nodes: Floats) -> Floats:
        """Return the tangents (e, q, 2, 3) along both local coordinates of the surface with nodes (N, 3)."""
        return tangents(nodes, self.elements, self.points)

    def gathered(self, per_element: Floats) -> Floats:
        """Sum element vectors (e, 6, 3) to free coordinates (F,)."""
        return self.scatter_transposed @ per_element.ravel()

    def assembled(self, per_element: Floats) -> Floats:
        """Assemble element matrices (e, 18, 18) to a matrix (F, F)."""
        count = len(per_element)
        blocks = sp.bsr_matrix((per_element, np.arange(count), np.arange(count + 1)))
        return (self.scatter_transposed @ (blocks @ self.scatter)).toarray()


def metric_of(along: Floats) -> Floats:
    """Return the metric (e, q, 2, 2) of a surface with tangents (e, q, 2, 3)."""
    return np.einsum("eqai,eqbi->eqab", along, along)


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
    metric = metric_of(integral.tangents(spheroid(mesh, aspect)))
    determinant = np.linalg.det(metric)
    return RestMetric(metric, determinant, integral.weights * np.sqrt(determinant))


# Energy of bending of a thin shell, from its change of curvature, with its gradient and tangent.
#
# Koiter's energy of an isotropic shell of incompressible material, over G_s l^2,
#
#     E = 1/2 B a^2 int (1 - nu) rho_ab rho^ab + nu (rho^a_a)^2 dS_0,     rho_ab = b_ab - B_ab,     nu = 1/2,
#
# where b_ab = n . x_;ab is the second fundamental form of the deformed and B_ab that of the unstressed surface, and
# indices are raised with the unstressed metric (Koiter 1966, Proc. K. Ned. Akad. Wet. B 69, 1-54; Ciarlet 2005,
# doi 10.1007/s10659-005-4738-8). A rotation changes neither. Quadratic elements have kinks at their edges: the second
# derivatives x_;ab are quadratic fields as well, projected from the weak form on the unit sphere. They are linear in x,
# so that one matrix serves every shape on a mesh; the normal n is that of the element

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
    along = tangents(mesh.nodes, mesh.elements, rule.points)
    metric = metric_of(along)
    area = dunavant(6).weights * np.sqrt(np.linalg.det(metric))
    gradients = np.einsum("qkb,eqab,eqai->eqki", rule.slopes, np.linalg.inv(metric), along, optimize=True)
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


# Elastic energy of the membrane on the P2 mesh, with its gradient and tangent, and its enclosed volume.
#
# Everything is a function of the free coordinates of the wedge (see `capsbayes.physics.surface.OctaSphere`). Energies
# are over G_s l^2, lengths over l. With tangents a_1, a_2 of the deformed and A_1, A_2 of the unstressed surface, the
# Skalak invariants are I1 = A^{ab} a_ab - 2 and I2 = det a / det A - 1 (Skalak et al. 1973,
# doi 10.1016/S0006-3495(73)85983-1)

BendingEnergy = Literal["displacement", "curvature"]
"""See `MembraneLoad`."""


class Elasticity(NamedTuple):
    """Energy over G_s l^2, gradient (F,) and tangent (F, F) in the free coordinates."""

    energy: float
    gradient: Floats
    tangent: Floats


class Enclosure(NamedTuple):
    """Volume and first axial moment inside the membrane, with gradients (F,) in the free coordinates."""

    volume: float
    volume_gradient: Floats
    moment: float
    moment_gradient: Floats


@dataclass(frozen=True)
class MembraneLoad:
    """The membrane of a capsule that is a sphere of given radius at rest, or a spheroid of the same volume."""

    mesh: OctaSphere
    law: MembraneLaw
    radius: float  # of the sphere at rest [l]; it carries density and mass matrix of a spheroid too
    bending: float  # B over G_s a^2
    pre_inflation: float = 0.0  # the shape at rest is inflated from one 1 + pre_inflation times smaller
    rest_aspect: float = 1.0  # axis of the shape at rest along the flow over that across
    bending_energy: BendingEnergy = "displacement"  # this one is 1/2 B a^2 G_s int |Lap_0 (x - X)|^2 dS_0

    @property
    def rest(self) -> Floats:
        """Free coordinates of the shape at rest."""
        return self.radius * self.mesh.reduced(spheroid(self.mesh, self.rest_aspect)[self.mesh.wedge])

    @property
    def mass(self) -> Floats:
        """Mass matrix (F, F) of the rest surface, over l^2."""
        return self.radius**2 * _scalar_forms(self.mesh)[0]

    def mass_solve(self, load: Floats) -> Floats:
        """Return the density per rest area whose virtual work is that of the nodal forces `load` (F,) or (F, m)."""
        return scipy.linalg.cho_solve(_mass_factor(self.mesh), load) / self.radius**2

    def elasticity(self, free: Floats) -> Elasticity:
        """Compute the stretching and bending energy and its derivatives at a shape (F,)."""
        stretched = self._stretched(free)
        if self.bending_energy == "curvature":
            bent, scale = self._bent(free), self.bending * self.radius**2
            bending = Elasticity(scale * bent.energy, scale * bent.gradient, scale * bent.tangent)
        else:
            force, form = self._held(free), self.bending * _bending_form(self.mesh)
            bending = Elasticity(float(0.5 * (free - self.rest) @ force), force, form)
        return Elasticity(
            stretched.energy + bending.energy,
            stretched.gradient + bending.gradient,
            stretched.tangent + bending.tangent,
        )

    def gradient(self, free: Floats) -> Floats:
        """Compute the gradient (F,) of the energy alone, which is faster."""
        stretched = self._stretched(free).gradient
        if self.bending_energy == "curvature":
            return stretched + self.bending * self.radius**2 * self._bent(free).gradient
        return stretched + self._held(free)

    def smoothed(self, free: Floats, degree: int) -> Floats:
        """Return a shape (F,) after a Newton step that takes the forces from displacements beyond a degree."""
        fine, elastic = _displacements_beyond(self.mesh, degree), self.elasticity(free)
        force, stiffness = fine.T @ elastic.gradient, fine.T @ elastic.tangent @ fine
        step: Floats = fine @ scipy.linalg.solve(stiffness, force, assume_a="sym")
        return free - step

    def _bent(self, free: Floats) -> BentShell:
        return BentShell(self.mesh, free, self.radius / (1.0 + self.pre_inflation), self.rest_aspect)

    def _held(self, free: Floats) -> Floats:
        """Return the force (F,) that resists a displacement from rest."""
        force: Floats = (self.bending * _bending_form(self.mesh)) @ (free - self.rest)
        return force

    def _stretched(self, free: Floats) -> Elasticity:
        """Compute the energy of the law and its derivatives."""
        integral, rest = integrals_over(self.mesh), rest_metric(self.mesh, self.rest_aspect)
        unstressed = self.radius / (1.0 + self.pre_inflation)
        metric, determinant = rest.metric * unstressed**2, rest.determinant * unstressed**4
        inverse = np.linalg.inv(metric).astype(float)
        along = integral.tangents(self.mesh.expanded(free))
        m = metric_of(along)
        area_ratio = (m[..., 0, 0] * m[..., 1, 1] - m[..., 0, 1] ** 2) / determinant
        w, w1, w2, w11, w12, w22 = self.law.derivatives(np.einsum("eqab,eqab->eq", inverse, m) - 2, area_ratio - 1)
        weight = rest.area * unstressed**2
        # variations of the metric: h_ab[k, i] = d a_ab / d x_ki
        slope_s, slope_t = integral.slopes[..., 0], integral.slopes[..., 1]
        a_s, a_t = along[:, :, 0], along[:, :, 1]

        def outer(slope: Floats, vector: Floats) -> Floats:
            return np.einsum("qk,eqi->eqki", slope, vector).reshape(*vector.shape[:2], 18)

        h_ss, h_tt = 2 * outer(slope_s, a_s), 2 * outer(slope_t, a_t)
        h_st = outer(slope_s, a_t) + outer(slope_t, a_s)

        def combined(c_ss: Floats, c_tt: Floats, c_st: Floats) -> Floats:
            return c_ss[..., None] * h_ss + c_tt[..., None] * h_tt + c_st[..., None] * h_st

        c1 = inverse[..., 0, 0], inverse[..., 1, 1], 2 * inverse[..., 0, 1]
        c2 = m[..., 1, 1] / determinant, m[..., 0, 0] / determinant, -2 * m[..., 0, 1] / determinant
        g1, g2 = combined(*c1), combined(*c2)
        gradient = np.einsum("eq,eqk->ek", weight * w1, g1) + np.einsum("eq,eqk->ek", weight * w2, g2)
        # second variations of the invariants that come from that of the metric, (e, 6, 6) times the identity
        k_ss, k_tt, k_st = (weight * (w1 * x + w2 * y) for x, y in zip(c1, c2, strict=True))
        scalar = 2 * np.einsum("eq,qk,ql->ekl", k_ss, slope_s, slope_s, optimize=True)
        scalar += 2 * np.einsum("eq,qk,ql->ekl", k_tt, slope_t, slope_t, optimize=True)
        mixed = np.einsum("eq,qk,ql->ekl", k_st, slope_s, slope_t, optimize=True)
        scalar += mixed + mixed.transpose(0, 2, 1)
        tangent = np.einsum("ekl,ij->ekilj", scalar, np.eye(3)).reshape(-1, 18, 18)

        def product(coefficient: Floats, left: Floats, right: Floats) -> Floats:
            return np.matmul((coefficient[..., None] * left).transpose(0, 2, 1), right)

        tangent += product(weight * w11, g1, g1) + product(weight * w22, g2, g2)
        cross = product(weight * w12, g1, g2) + product(weight * w2 / determinant, h_ss, h_tt)
        tangent += cross + cross.transpose(0, 2, 1) - product(2 * weight * w2 / determinant, h_st, h_st)
        return Elasticity(float(np.sum(weight * w)), integral.gathered(gradient), integral.assembled(tangent))

    def enclosure(self, free: Floats) -> Enclosure:
        """Compute the volume inside the membrane and its first moment along z."""
        integral = integrals_over(self.mesh)
        nodes = self.mesh.expanded(free)
        along = integral.tangents(nodes)
        points = np.einsum("qk,eki->eqi", integral.shapes, nodes[integral.elements])
        normal = np.cross(along[:, :, 0], along[:, :, 1]) * integral.weights[..., None]
        z = points[..., 2]

        def gradient(weight: Floats) -> Floats:
            return integral.gathered(np.einsum("eq,qk,eqi->eki", weight, integral.shapes, normal, optimize=True))

        return Enclosure(
            float(np.sum(z * normal[..., 2])),
            gradient(np.ones_like(z)),
            float(np.sum(z**2 * normal[..., 2]) / 2),
            gradient(z),
        )

    def principal_tensions(self, free: Floats) -> Floats:
        """Compute the principal Cauchy tensions (N, 2) over G_s at the nodes, larger first, element averages."""
        nodes, elements = self.mesh.expanded(free), self.mesh.elements
        unstressed = self.radius / (1.0 + self.pre_inflation)
        at_rest = tangents(spheroid(self.mesh, self.rest_aspect), elements, LOCAL_NODES)
        deformed = tangents(nodes, elements, LOCAL_NODES)
        strain = np.linalg.solve(metric_of(at_rest) * unstressed**2, metric_of(deformed))
        half = np.trace(strain, axis1=-2, axis2=-1) / 2
        spread = np.sqrt(np.maximum(half**2 - np.linalg.det(strain), 0.0))
        stretch = np.sqrt(np.stack([half + spread, half - spread], axis=-1))
        tensions = np.sort(self.law.principal_tensions(stretch), axis=-1)[..., ::-1]
        total, count = np.zeros((len(nodes), 2)), np.zeros(len(nodes))
        np.add.at(total, elements, tensions)
        np.add.at(count, elements, 1.0)
        return total / count[:, None]


@lru_cache(maxsize=8)
def _scalar_forms(mesh: OctaSphere) -> tuple[Floats, Floats]:
    """Assemble mass and stiffness (F, F) of the Laplacian on the unit sphere, for each Cartesian component."""
    integral, sphere = integrals_over(mesh), rest_metric(mesh, 1.0)
    inverse = np.linalg.inv(sphere.metric)
    mass = np.einsum("eq,qk,ql->ekl", sphere.area, integral.shapes, integral.shapes, optimize=True)
    stiffness = np.einsum("eq,qka,eqab,qlb->ekl", sphere.area, integral.slopes, inverse, integral.slopes, optimize=True)

    def assembled(form: Floats) -> Floats:
        return integral.assembled(np.einsum("ekl,ij->ekilj", form, np.eye(3)).reshape(-1, 18, 18))

    return assembled(mass), assembled(stiffness)


@lru_cache(maxsize=8)
def _mass_factor(mesh: OctaSphere) -> tuple[Floats, bool]:
    factor: tuple[Floats, bool] = scipy.linalg.cho_factor(_scalar_forms(mesh)[0])
    return factor


@lru_cache(maxsize=8)
def _displacements_beyond(mesh: OctaSphere, degree: int) -> Floats:
    """Return the displacements (F, m) that vary like spherical harmonics beyond a degree."""
    mass, stiffness = _scalar_forms(mesh)
    between = (degree + 1.0) ** 2  # eigenvalues of the Laplacian: degree (degree + 1)
    modes: Floats = scipy.linalg.eigh(stiffness, mass, subset_by_value=(between, np.inf))[1]
    return modes


@lru_cache(maxsize=8)
def _bending_form(mesh: OctaSphere) -> Floats:
    """Assemble int |Lap_0 u|^2 dS_0 (F, F): on P2, Lap_0 u is the mass-weighted projection of the weak Laplacian."""
    stiffness = _scalar_forms(mesh)[1]
    form = stiffness @ scipy.linalg.cho_solve(_mass_factor(mesh), stiffness)
    symmetric: Floats = (form + form.T) / 2
    return symmetric


# Velocity of the membrane in the two liquids: undisturbed flow, single layer and response of the walls.
#
#     v(x) = v_inf(x) + (single layer of f)(x) + (response of the walls)(x)
#
# The liquids have equal viscosities, so the density f alone, the force of the membrane on them per rest area, decides
# their motion (Pozrikidis 1992, doi 10.1017/CBO9780511624124). Vectors are free coordinates (F,) of the mesh's wedge


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


# Outlines of a deformed shape: its profile in the plane x = 0 and its silhouette seen along x

_POINTS_PER_EDGE = 16
_PARTS_PER_EDGE = 6
_DIRECTIONS = 721


def profile(mesh: OctaSphere, nodes: Floats) -> Profile:
    """Return the outline in the plane x = 0, on the curved edges of the elements, in the unit of the nodes (N, 3)."""
    meridian = np.flatnonzero((np.abs(mesh.nodes[:, 0]) < 1e-12) & (mesh.nodes[:, 1] > -1e-12))
    meridian = meridian[np.argsort(-mesh.nodes[meridian, 2])]  # corner, midside, corner, ... from nose to rear
    along = np.arange(_POINTS_PER_EDGE) / _POINTS_PER_EDGE
    shapes = np.stack([(1 - along) * (1 - 2 * along), 4 * along * (1 - along), along * (2 * along - 1)])
    curve = nodes[meridian][:, [2, 1]]
    edges = np.stack([curve[0:-2:2], curve[1:-1:2], curve[2::2]])
    points = np.einsum("kq,kei->eqi", shapes, edges).reshape(-1, 2)
    return Profile.from_half(np.concatenate([points, curve[-1:]]))


def silhouette(mesh: OctaSphere, nodes: Floats) -> Profile:
    """Return the outline of the shape seen along x: the farthest point in every direction, in the unit of the nodes."""
    # The rear rim lies further back along the diagonals of the cross-section than in the plane x = 0, so the silhouette
    # is longer than the profile and hides a concave rear.
    starts, ends = _edges(mesh, nodes)
    middle = 0.5 * (np.max(starts[:, 0]) + np.min(starts[:, 0]))
    angles = np.linspace(0.0, np.pi, _DIRECTIONS)
    radii = _farthest(starts - [middle, 0.0], ends - [middle, 0.0], angles)
    half = np.column_stack([middle + radii * np.cos(angles), radii * np.sin(angles)])
    half[[0, -1], 1] = 0.0
    return Profile.from_half(half)


def _edges(mesh: OctaSphere, nodes: Floats) -> tuple[Floats, Floats]:
    """Return the edges ((m, 2), (m, 2)), columns (z, y), of the finely divided elements on y >= 0."""
    grid, triangles = subdivision(_PARTS_PER_EDGE)
    oriented = triangles[: _PARTS_PER_EDGE * (_PARTS_PER_EDGE + 1) // 2]
    first, second = oriented[:, [0, 0, 1]].ravel(), oriented[:, [1, 2, 2]].ravel()
    points = (p2(grid) @ nodes[mesh.quarter])[..., [2, 1]]
    return points[:, first].reshape(-1, 2), points[:, second].reshape(-1, 2)


@njit(cache=True, nogil=True, error_model="numpy")
def _farthest(starts, ends, angles):  # type: ignore[no-untyped-def]
    """Return the largest distance from the origin at which the ray of each rising angle meets one of the edges."""
    cosines, sines, radii = np.cos(angles), np.sin(angles), np.zeros(len(angles))
    step = angles[1] - angles[0]
    for edge in range(len(starts)):
        (z, y), (z_end, y_end) = starts[edge], ends[edge]
        angle, angle_end = np.arctan2(y, z), np.arctan2(y_end, z_end)
        first = int(max(np.floor((min(angle, angle_end) - angles[0]) / step), 0.0))
        last = int(min(np.ceil((max(angle, angle_end) - angles[0]) / step), len(angles) - 1.0))
        for ray in range(first, last + 1):
            offset = cosines[ray] * y - sines[ray] * z
            offset_end = cosines[ray] * y_end - sines[ray] * z_end
            if offset * offset_end <= 0.0:
                across = offset - offset_end
                share = min(max(offset / across, 0.0), 1.0) if across != 0.0 else 0.0
                ahead = cosines[ray] * (z + share * (z_end - z)) + sines[ray] * (y + share * (y_end - y))
                radii[ray] = max(radii[ray], ahead)
    return radii
