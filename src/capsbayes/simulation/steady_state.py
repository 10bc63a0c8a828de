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
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from capsbayes.membrane.law import MembraneLaw
from capsbayes.simulation.membrane_load import Elasticity, MembraneLoad
from capsbayes.stokes.channel import Channel
from capsbayes.stokes.single_layer import SingleLayer
from capsbayes.stokes.stokeslet import images_gradient
from capsbayes.stokes.walls import Walls, wall_operator
from capsbayes.surface.octasphere import D4, OctaSphere, octasphere

__all__ = ["Iterate", "NewtonResult", "SteadyProblem"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Iterate:
    """A candidate: free coordinates (F,) of the wedge, velocity V/U, slack s and Ca."""

    free: Array
    velocity: float
    slack: float
    capillary_number: float
    size_ratio: float

    def moved(self, step: Array) -> Iterate:
        """The iterate after a change (F + 2,) of shape, velocity and slack."""
        return replace(
            self,
            free=self.free + step[:-2],
            velocity=self.velocity + float(step[-2]),
            slack=self.slack + float(step[-1]),
        )


class Motion(NamedTuple):
    """Velocity error at the free coordinates (F,), and what it was made of."""

    error: Array
    density: Array
    axial: Array
    normal: Array


class Slopes(NamedTuple):
    """Derivatives of the velocity error along the free coordinates (F, F) and along Ca (F,)."""

    along_shape: Array
    along_ca: Array


class NewtonResult(NamedTuple):
    """Where Newton's iteration ended.

    `tangent` is the change (F + 2,) of shape, velocity and slack per unit of Ca at the last step taken.
    """

    iterate: Iterate
    converged: bool
    residual: float
    iterations: int
    tangent: Array


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

    def density(self, iterate: Iterate, elastic: Elasticity) -> Array:
        """Force on the liquid per rest area (F,) over mu U/l."""
        return -self.membrane(iterate.size_ratio).mass_solve(elastic.gradient) / iterate.capillary_number

    def motion(self, iterate: Iterate) -> Motion:
        """Velocity error of the equations of motion, without derivatives."""
        return self._evaluated(iterate, self.membrane(iterate.size_ratio).elasticity(iterate.free), slopes=False)[0]

    def linearised(self, iterate: Iterate) -> tuple[Motion, Slopes]:
        """Velocity error of the equations of motion, with its exact derivatives."""
        elastic = self.membrane(iterate.size_ratio).elasticity(iterate.free)
        motion, slopes = self._evaluated(iterate, elastic, slopes=True)
        assert slopes is not None
        return motion, slopes

    def _evaluated(self, iterate: Iterate, elastic: Elasticity, *, slopes: bool) -> tuple[Motion, Slopes | None]:
        mesh, basis = self.mesh, self.mesh.basis
        density = self.density(iterate, elastic)
        nodes = mesh.expanded(iterate.free)
        targets = nodes[mesh.wedge]
        layer = SingleLayer(mesh, iterate.size_ratio, nodes, mesh.expanded(density) if slopes else None)
        near = layer.matrices(targets, target_nodes=mesh.wedge)
        operator = wall_operator(self.channel, self.walls, D4)
        far = layer.matrices(operator.points)
        wedge_density = basis @ density
        strengths = operator.strengths(far.velocity @ wedge_density)
        to_membrane = operator.velocity_matrix(targets)
        speed, shear = self.channel.undisturbed(targets)
        velocity = near.velocity @ wedge_density + to_membrane @ strengths.ravel()
        velocity[2::3] += speed
        axial = basis.T @ np.tile([0.0, 0.0, 1.0], len(targets))
        normal = basis.T @ self._normals(nodes)[mesh.wedge].ravel()
        error = basis.T @ velocity - iterate.velocity * axial + iterate.slack * normal
        motion = Motion(error, density, axial, normal)
        if not slopes:
            return motion, None
        answer = operator.answer(basis.T @ to_membrane)
        influence = basis.T @ (basis.T @ near.velocity.T).T - answer @ (basis.T @ far.velocity.T).T
        along_target = near.target_slope + images_gradient(targets, operator.sources, D4, strengths)
        along_target[:, 2, :] += shear
        moving = -near.source_slope
        for node, block in enumerate(along_target):
            moving[3 * node : 3 * node + 3, 3 * node : 3 * node + 3] += block
        along_shape = basis.T @ (basis.T @ moving.T).T + answer @ (basis.T @ far.source_slope.T).T
        compliance = self.membrane(iterate.size_ratio).mass_solve(elastic.tangent) / iterate.capillary_number
        along_ca = -influence @ density / iterate.capillary_number
        return motion, Slopes(along_shape - influence @ compliance, along_ca)

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
        tolerance: float = 1e-7,
        max_iterations: int = 14,
        patience: int | None = None,
        report: Callable[[int, float, Iterate], None] | None = None,
    ) -> NewtonResult:
        """Newton's iteration, each step at most 0.15 a long, from `start` at its Ca and a/l.

        Close to the solution the residual alone is computed first, because it costs a third of the derivatives.
        With `patience`, the iteration is given up when that many steps have not brought the residual to 1e-2.
        """
        iterate, membrane = start, self.membrane(start.size_ratio)
        volume = 4.0 / 3.0 * np.pi * start.size_ratio**3
        count, residual = len(start.free), np.inf
        tangent = np.zeros(count + 2)
        for iteration in range(max_iterations + 1):
            inside = membrane.enclosure(iterate.free)
            gaps = np.array([inside.volume - volume, inside.moment])
            slopes = None
            if residual < 1e-3:
                motion = self.motion(iterate)
            else:
                motion, slopes = self.linearised(iterate)
            residual = float(max(np.max(np.abs(motion.error)), np.max(np.abs(gaps))))
            if report is not None:
                report(iteration, residual, iterate)
            if not np.isfinite(residual):
                break
            if residual < tolerance and iteration > 0:
                return NewtonResult(iterate, True, residual, iteration, tangent)
            if iteration == max_iterations or (patience is not None and iteration >= patience and residual > 1e-2):
                break
            if slopes is None:
                motion, slopes = self.linearised(iterate)
            matrix = np.zeros((count + 2, count + 2))
            matrix[:count, :count] = slopes.along_shape
            matrix[:count, count], matrix[:count, count + 1] = -motion.axial, motion.normal
            matrix[count, :count], matrix[count + 1, :count] = inside.volume_gradient, inside.moment_gradient
            right = np.zeros((count + 2, 2))
            right[:count, 0], right[count:, 0], right[:count, 1] = -motion.error, -gaps, -slopes.along_ca
            step, tangent = scipy.linalg.solve(matrix, right, check_finite=False).T
            if iteration == 0 and residual < tolerance:
                return NewtonResult(iterate, True, residual, iteration, tangent)
            iterate = iterate.moved(min(1.0, 0.15 * start.size_ratio / np.max(np.abs(step[:count]))) * step)
        return NewtonResult(iterate, False, residual, iteration, tangent)
