"""Elastic energy of the membrane on the P2 mesh, with its gradient and tangent, and its enclosed volume.

Everything is a function of the free coordinates of the wedge (see
`capsbayes.physics.surface.OctaSphere`). Energies are over G_s l^2, lengths
over l. With tangents a_1, a_2 of the deformed and A_1, A_2 of the unstressed
surface, the Skalak invariants are I1 = A^{ab} a_ab - 2 and
I2 = det a / det A - 1 (Skalak et al. 1973, doi 10.1016/S0006-3495(73)85983-1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
import scipy.linalg

from capsbayes.arrays import Floats
from capsbayes.physics.capsule.bending import BentShell
from capsbayes.physics.capsule.element_integrals import integrals_over, rest_metric, spheroid
from capsbayes.physics.membrane.law import MembraneLaw
from capsbayes.physics.surface.octasphere import OctaSphere
from capsbayes.physics.surface.shape_functions import LOCAL_NODES, p2_gradient

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
        tangents = integral.tangents(self.mesh.expanded(free))
        m = np.einsum("eqai,eqbi->eqab", tangents, tangents)
        area_ratio = (m[..., 0, 0] * m[..., 1, 1] - m[..., 0, 1] ** 2) / determinant
        w, w1, w2, w11, w12, w22 = self.law.derivatives(np.einsum("eqab,eqab->eq", inverse, m) - 2, area_ratio - 1)
        weight = rest.area * unstressed**2
        # variations of the metric: h_ab[k, i] = d a_ab / d x_ki
        slope_s, slope_t = integral.slopes[..., 0], integral.slopes[..., 1]
        a_s, a_t = tangents[:, :, 0], tangents[:, :, 1]

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
        tangents = integral.tangents(nodes)
        points = np.einsum("qk,eki->eqi", integral.shapes, nodes[integral.elements])
        normal = np.cross(tangents[:, :, 0], tangents[:, :, 1]) * integral.weights[..., None]
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
        slopes = p2_gradient(LOCAL_NODES)
        nodes, elements = self.mesh.expanded(free), self.mesh.elements

        def metric(positions: Floats) -> Floats:
            tangents = np.einsum("qka,eki->eqai", slopes, positions[elements])
            return np.einsum("eqai,eqbi->eqab", tangents, tangents)

        unstressed = self.radius / (1.0 + self.pre_inflation)
        rest = metric(spheroid(self.mesh, self.rest_aspect)) * unstressed**2
        strain = np.linalg.solve(rest, metric(nodes))
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
def _bending_form(mesh: OctaSphere) -> Floats:
    """Assemble int |Lap_0 u|^2 dS_0 (F, F): on P2, Lap_0 u is the mass-weighted projection of the weak Laplacian."""
    stiffness = _scalar_forms(mesh)[1]
    form = stiffness @ scipy.linalg.cho_solve(_mass_factor(mesh), stiffness)
    symmetric: Floats = (form + form.T) / 2
    return symmetric
