"""Newton's method for the steady shape of a capsule on the axis of a channel.

In the capsule's frame nothing moves at steady state, so the liquids' velocity
at every membrane node is the capsule's, V e_z:

    v_inf(x) + (single layer of f)(x) + (walls' answer)(x) = V e_z - s n,
    M f = -(1/Ca) dE/dx.

The flux of the left side through the membrane vanishes identically; the slack
s of that one redundant equation makes room for the condition of constant
volume, and a fourth unknown, V, for the centroid at z = 0. The Jacobian is
exact: elastic tangent, motion of targets and of sources in the kernel, gradient
of the undisturbed flow, and the walls' answer to all of these.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from capsbayes.membrane.law import MembraneLaw
from capsbayes.simulation.membrane_load import MembraneLoad
from capsbayes.stokes.channel import Channel
from capsbayes.stokes.single_layer import SingleLayer
from capsbayes.stokes.stokeslet import images_gradient
from capsbayes.stokes.walls import Walls, wall_operator
from capsbayes.surface.octasphere import D4, OctaSphere, octasphere

__all__ = ["Iterate", "Linearisation", "NewtonResult", "SteadyProblem"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Iterate:
    """A candidate: free coordinates (F,) of the wedge, velocity V/U, slack s and Ca."""

    free: Array
    velocity: float
    slack: float
    capillary_number: float
    size_ratio: float


class Linearisation(NamedTuple):
    """Velocity error at the free coordinates (F,) and its derivatives along them (F, F) and along 1/Ca (F,)."""

    error: Array
    jacobian: Array
    along_inverse_ca: Array
    normal: Array
    axial: Array
    density: Array


class NewtonResult(NamedTuple):
    """Where Newton's iteration ended."""

    iterate: Iterate
    converged: bool
    residual: float
    iterations: int
    density: Array


@dataclass(frozen=True)
class SteadyProblem:
    """The discrete equations for one membrane law, section and mesh."""

    law: MembraneLaw
    channel: Channel
    refinement: int
    bending: float
    pre_inflation: float = 0.0
    walls: Walls = field(default_factory=Walls)

    @property
    def mesh(self) -> OctaSphere:
        """The mesh of the rest sphere."""
        return octasphere(self.refinement)

    def membrane(self, size_ratio: float) -> MembraneLoad:
        """The membrane of a capsule of radius `size_ratio`."""
        return MembraneLoad(self.mesh, self.law, size_ratio, self.bending, self.pre_inflation)

    def at_rest(self, capillary_number: float, size_ratio: float) -> Iterate:
        """The sphere at rest, moving with about the velocity of a rigid sphere."""
        free = self.membrane(size_ratio).rest
        velocity = max(2.0963 - 1.1856 * size_ratio**2 * (1 - 0.3 * size_ratio**2), 1.05)
        return Iterate(free, velocity, 0.0, capillary_number, size_ratio)

    def linearised(self, iterate: Iterate) -> Linearisation:
        """Velocity error of the equations of motion at `iterate`, with its exact derivatives."""
        mesh, membrane = self.mesh, self.membrane(iterate.size_ratio)
        elastic = membrane.elasticity(iterate.free)
        density = -membrane.mass_solve(elastic.gradient) / iterate.capillary_number
        nodes = mesh.expanded(iterate.free)
        targets = nodes[mesh.wedge]
        layer = SingleLayer(mesh, iterate.size_ratio, nodes, mesh.expanded(density))
        near = layer.matrices(targets, target_nodes=mesh.wedge)
        operator = wall_operator(self.channel, self.walls, D4)
        far = layer.matrices(operator.points)
        wedge_density = mesh.basis @ density
        strengths = -operator.inverse @ (far.velocity @ wedge_density)
        to_membrane = operator.velocity_matrix(targets)
        answer = to_membrane @ operator.inverse  # walls' answer at the membrane per wall velocity
        influence = near.velocity - answer @ far.velocity
        speed, shear = self.channel.undisturbed(targets)
        velocity = near.velocity @ wedge_density + to_membrane @ strengths
        velocity[2::3] += speed
        along_target = near.target_slope + images_gradient(
            targets, operator.sources, D4, strengths.reshape(-1, 3)
        )
        along_target[:, 2, :] += shear
        jacobian = -near.source_slope + answer @ far.source_slope
        for node, block in enumerate(along_target):
            jacobian[3 * node : 3 * node + 3, 3 * node : 3 * node + 3] += block
        basis = mesh.basis
        influence = basis.T @ (basis.T @ influence.T).T
        jacobian = basis.T @ (basis.T @ jacobian.T).T
        compliance = influence @ membrane.mass_solve(elastic.tangent)
        axial = basis.T @ np.tile([0.0, 0.0, 1.0], len(targets))
        normal = basis.T @ self._normals(nodes)[mesh.wedge].ravel()
        error = basis.T @ velocity - iterate.velocity * axial + iterate.slack * normal
        return Linearisation(
            error,
            jacobian - compliance / iterate.capillary_number,
            influence @ density * iterate.capillary_number,
            normal,
            axial,
            density,
        )

    def _normals(self, nodes: Array) -> Array:
        """Outward unit normals (N, 3) at the nodes, from the averaged area vectors of their elements."""
        corners = nodes[self.mesh.elements]
        edge_s, edge_t = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        total = np.zeros_like(nodes)
        np.add.at(total, self.mesh.elements, np.cross(edge_s, edge_t)[:, None])
        return total / np.linalg.norm(total, axis=1, keepdims=True)

    def solve(
        self,
        start: Iterate,
        *,
        tolerance: float = 1e-8,
        max_iterations: int = 14,
        report: Callable[[int, float, Iterate], None] | None = None,
    ) -> NewtonResult:
        """Newton's iteration with halved steps from `start`, at its Ca and a/l."""
        iterate = start
        volume = 4.0 / 3.0 * np.pi * start.size_ratio**3
        membrane = self.membrane(start.size_ratio)
        residual, damping = np.inf, 1.0
        count = len(start.free)
        for iteration in range(max_iterations + 1):
            system = self.linearised(iterate)
            inside = membrane.enclosure(iterate.free)
            gaps = np.array([inside.volume - volume, inside.moment])
            residual = float(max(np.max(np.abs(system.error)), np.max(np.abs(gaps))))
            if report is not None:
                report(iteration, residual, iterate)
            if not np.isfinite(residual):
                break
            if residual < tolerance:
                return NewtonResult(iterate, True, residual, iteration, system.density)
            if iteration == max_iterations:
                break
            matrix = np.zeros((count + 2, count + 2))
            matrix[:count, :count] = system.jacobian
            matrix[:count, count], matrix[:count, count + 1] = -system.axial, system.normal
            matrix[count, :count], matrix[count + 1, :count] = inside.volume_gradient, inside.moment_gradient
            step = scipy.linalg.solve(matrix, -np.concatenate([system.error, gaps]), check_finite=False)
            damping = min(1.0, 0.15 * start.size_ratio / np.max(np.abs(step[:count])))
            iterate = Iterate(
                iterate.free + damping * step[:count],
                iterate.velocity + damping * step[count],
                iterate.slack + damping * step[count + 1],
                iterate.capillary_number,
                iterate.size_ratio,
            )
        return NewtonResult(iterate, False, residual, iteration, system.density)
