"""The discrete equations of motion of one kind of capsule in one flow.

The velocity error of a candidate is the residual of

    v(x) = V e_z - s n,        M f = -(1/Ca) dE/dx,

at the membrane's nodes: at steady state the liquids move every one of them
with the capsule's velocity V. The flux of v through the membrane vanishes
identically; the slack s of that redundant equation makes room for the condition
of constant volume, and V for that of the centroid at z = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.physics.capsule.liquids import membrane_response, membrane_velocity
from capsbayes.physics.capsule.membrane_load import BendingEnergy, MembraneLoad
from capsbayes.physics.membrane.law import MembraneLaw
from capsbayes.physics.stokes.channel import Channel, Flow
from capsbayes.physics.stokes.walls import WallDiscretisation
from capsbayes.physics.surface.octasphere import OctaSphere, octasphere

_CLEARANCE = 0.95  # of the narrower half width of the channel, for a capsule at rest


@dataclass(frozen=True)
class Iterate:
    """A candidate: free coordinates (F,) of the wedge, velocity V/U, slack s and Ca."""

    free: Floats
    velocity: float
    slack: float
    capillary_number: float
    size_ratio: float

    def moved(self, step: Floats) -> Iterate:
        """Return the iterate after a change (F + 2,) of shape, velocity and slack."""
        return replace(
            self,
            free=self.free + step[:-2],
            velocity=self.velocity + float(step[-2]),
            slack=self.slack + float(step[-1]),
        )


class Motion(NamedTuple):
    """Velocity error at the free coordinates (F,), and the density, axis and normals (F,) that enter it."""

    error: Floats
    density: Floats
    axial: Floats
    normal: Floats


class Slopes(NamedTuple):
    """Derivatives of the velocity error along the free coordinates (F, F), Ca (F,) and the density (F, F)."""

    along_shape: Floats
    along_ca: Floats
    along_density: Floats


@dataclass(frozen=True)
class Problem:
    """Membrane law, flow and mesh, and the parameters of the shape at rest (see `MembraneLoad`)."""

    law: MembraneLaw
    flow: Flow
    refinement: int
    bending: float
    pre_inflation: float = 0.0
    rest_aspect: float = 1.0
    walls: WallDiscretisation = field(default_factory=WallDiscretisation)
    bending_energy: BendingEnergy = "displacement"

    @property
    def channel(self) -> Channel:
        """The flow, if it is that of a channel."""
        if not isinstance(self.flow, Channel):
            raise TypeError(f"{type(self.flow).__name__} has no walls")
        return self.flow

    @property
    def mesh(self) -> OctaSphere:
        """The mesh of the rest sphere."""
        return octasphere(self.refinement, self.flow.symmetry)

    def membrane(self, size_ratio: float) -> MembraneLoad:
        """Return the membrane of a capsule of radius `size_ratio`."""
        rest = self.pre_inflation, self.rest_aspect
        return MembraneLoad(self.mesh, self.law, size_ratio, self.bending, *rest, self.bending_energy)

    def at_rest(self, capillary_number: float, size_ratio: float) -> Iterate:
        """Return the shape at rest, with about the velocity of a small rigid sphere by Faxen's law."""
        centre = float(self.flow.undisturbed(np.zeros((1, 3)))[0][0, 2])
        velocity = max(centre - self.flow.pressure_gradient * size_ratio**2 / 6.0, 1.05)
        return Iterate(self.membrane(size_ratio).rest, velocity, 0.0, capillary_number, size_ratio)

    def at_rest_in_channel(self, capillary_number: float, size_ratio: float) -> Iterate:
        """Return the shape at rest; one wider than 0.95 of the channel is made longer and narrower at its volume."""
        at_rest = self.at_rest(capillary_number, size_ratio)
        nodes = self.mesh.expanded(at_rest.free)[self.mesh.wedge]
        wall, _ = self.channel.outline(0.05, 0.0)
        factor = min(1.0, _CLEARANCE * float(np.min(np.hypot(*wall.T)) / np.max(np.abs(nodes[:, 0]))))
        return replace(at_rest, free=self.mesh.reduced(nodes * [factor, factor, factor**-2]))

    def density(self, iterate: Iterate, gradient: Floats) -> Floats:
        """Return the force on the liquid per rest area (F,) over mu U/l, from the gradient (F,) of the energy."""
        return -self.membrane(iterate.size_ratio).mass_solve(gradient) / iterate.capillary_number

    def motion(self, iterate: Iterate) -> Motion:
        """Compute the velocity error, without derivatives."""
        membrane = self.membrane(iterate.size_ratio)
        density = self.density(iterate, membrane.gradient(iterate.free))
        velocity = membrane_velocity(self.flow, self.walls, self.mesh, iterate.size_ratio, iterate.free, density)
        return self._motion(iterate, velocity, density)

    def linearised(self, iterate: Iterate) -> tuple[Motion, Slopes]:
        """Compute the velocity error with its exact derivatives."""
        membrane = self.membrane(iterate.size_ratio)
        elastic = membrane.elasticity(iterate.free)
        density = self.density(iterate, elastic.gradient)
        velocity, along_density, along_shape = membrane_response(
            self.flow, self.walls, self.mesh, iterate.size_ratio, iterate.free, density
        )
        compliance = membrane.mass_solve(elastic.tangent) / iterate.capillary_number
        along_ca = -along_density @ density / iterate.capillary_number
        slopes = Slopes(along_shape - along_density @ compliance, along_ca, along_density)
        return self._motion(iterate, velocity, density), slopes

    def _motion(self, iterate: Iterate, velocity: Floats, density: Floats) -> Motion:
        mesh = self.mesh
        axial = mesh.basis.T @ np.tile([0.0, 0.0, 1.0], len(mesh.wedge))
        normal = mesh.reduced(self._normals(mesh.expanded(iterate.free))[mesh.wedge])
        error = velocity - iterate.velocity * axial + iterate.slack * normal
        return Motion(error, density, axial, normal)

    def _normals(self, nodes: Floats) -> Floats:
        """Return the outward unit normals (N, 3) at the nodes, from the averaged area vectors of their elements."""
        corners = nodes[self.mesh.elements]
        edge_s, edge_t = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        total = np.zeros_like(nodes)
        np.add.at(total, self.mesh.elements, np.cross(edge_s, edge_t)[:, None])
        return total / np.linalg.norm(total, axis=1, keepdims=True)
