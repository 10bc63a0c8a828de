"""The discrete equations of one capsule and Newton's method for its steady state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import scipy.linalg

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.physics.channel import Channel, Flow
from capsbayes.physics.load import (
    BendingEnergy,
    Enclosure,
    MembraneLoad,
    changed,
    membrane_response,
    membrane_velocity,
    parameters_of,
)
from capsbayes.physics.membrane import MembraneLaw
from capsbayes.physics.stokes import SingleLayer, WallDiscretisation, pressure_kernel, wall_operator
from capsbayes.physics.surface import OctaSphere, octasphere
from capsbayes.run import remembered

# The discrete equations of motion of one kind of capsule in one flow.
#
# The velocity error of a candidate is the residual of
#
#     v(x) = V e_z - s n,        M f = -(1/Ca) dE/dx,
#
# at the membrane's nodes: at steady state the liquids move every one of them with the capsule's velocity V. The flux of
# v through the membrane vanishes identically; the slack s of that redundant equation makes room for the condition of
# constant volume, and V for that of the centroid at z = 0

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


# Pressure inside a steady capsule, and the pressure drop that the capsule adds to that of the channel

_FAR = 0.9  # of the half length that is represented


def pressures(problem: Problem, iterate: Iterate) -> tuple[float, float]:
    """Compute the inner pressure and the extra pressure drop of a steady state, both over mu U / l."""
    # The inner pressure is over that of the undisturbed flow at the centroid, half way between the disturbances far up-
    # and downstream. The drop follows from the reciprocal theorem with the undisturbed flow, dP+ Q = - int f . v_inf
    # dS.
    mesh, channel = problem.mesh, problem.channel
    gradient = problem.membrane(iterate.size_ratio).gradient(iterate.free)
    nodes = mesh.expanded(iterate.free)
    flow = mesh.reduced(channel.undisturbed(nodes[mesh.wedge])[0])
    drop = gradient @ flow / (iterate.capillary_number * channel.area)
    on_axis = nodes[np.hypot(mesh.nodes[:, 0], mesh.nodes[:, 1]) < 1e-12, 2]
    middle, end = float(np.mean(on_axis)), _FAR * problem.walls.end
    here, upstream, downstream = pressure_of_disturbance(problem, iterate, np.array([middle, -end, end]))
    inside = here - channel.pressure_gradient * middle - (upstream + downstream) / 2
    return float(inside), float(drop)


def pressure_of_disturbance(problem: Problem, iterate: Iterate, z: Floats) -> Floats:
    """Compute the pressure (p,) of the disturbance by membrane and walls at points `z` of the axis."""
    mesh = problem.mesh
    density = problem.density(iterate, problem.membrane(iterate.size_ratio).gradient(iterate.free))
    layer = SingleLayer(mesh, iterate.size_ratio, mesh.expanded(iterate.free), mesh.expanded(density))
    operator = wall_operator(problem.channel, problem.walls)
    strengths = operator.strengths(layer.matrices(operator.points).velocity @ (mesh.basis @ density))
    sources = np.concatenate([operator.sources @ turn.T for turn in problem.mesh.symmetry.operations])
    forces = np.concatenate([strengths @ turn.T for turn in problem.mesh.symmetry.operations])
    points = np.column_stack([0 * z, 0 * z, z])
    walls: Floats = np.einsum("tsi,si->t", pressure_kernel(points, sources), forces)
    return layer.pressure(points) + walls


# Motion of a membrane that is not steady, relative to its centroid: dx/dt = v(x) - V e_z + s n.
#
# V keeps the centroid in place and the slack s the volume, which the flow conserves only up to the mesh's error. Where
# symmetry alone keeps the centroid in place, V is zero


class Rate(NamedTuple):
    """Rate dx/dt (F,), V and s, the directions (F, c) in which s and V act, and the speed of the fastest node."""

    change: Floats
    velocity: float
    slack: float
    across: Floats
    speed: float


class FreeMotion:
    """Motion at the capillary number and size of `start`, as a function of the shape's free coordinates (F,)."""

    def __init__(self, problem: Problem, start: Iterate) -> None:
        self.problem, self.start = problem, start
        self.membrane = problem.membrane(start.size_ratio)
        self.volume = 4.0 / 3.0 * np.pi * start.size_ratio**3
        self.drifts = bool(np.mean(problem.flow.symmetry.operations[:, 2, 2]) > 0.0)

    def rate(self, free: Floats) -> Rate:
        """Compute dx/dt of a shape."""
        return self._rate(self.problem.motion(self._in_frame_of_walls(free)), self._gaps(free)[1])

    def linearised(self, free: Floats) -> tuple[Rate, Floats]:
        """Compute dx/dt of a shape and its derivative (F, F), without the rotation of the normals."""
        motion, slopes = self.problem.linearised(self._in_frame_of_walls(free))
        along = self._gaps(free)[1]
        rate = self._rate(motion, along)
        held = rate.across @ np.linalg.solve(along @ rate.across, along @ slopes.along_shape)
        return rate, slopes.along_shape - held

    def held(self, free: Floats, across: Floats) -> Floats:
        """Return the shape after a displacement along `across` to the volume and centroid it must have."""
        gaps, along = self._gaps(free)
        return free - across @ np.linalg.solve(along @ across, gaps)

    def changes(self, free: Floats) -> Floats:
        """Return orthonormal displacements (F, F - c) that keep volume and centroid."""
        return scipy.linalg.null_space(self._gaps(free)[1])

    def _rate(self, motion: Motion, along: Floats) -> Rate:
        across = np.column_stack([motion.normal, motion.axial] if self.drifts else [motion.normal])
        pull = -np.linalg.solve(along @ across, along @ motion.error)
        change = motion.error + across @ pull
        return Rate(change, float(0.0 - np.sum(pull[1:])), float(pull[0]), across, self.problem.mesh.largest(change))

    def _in_frame_of_walls(self, free: Floats) -> Iterate:
        return replace(self.start, free=free, velocity=0.0, slack=0.0)

    def _gaps(self, free: Floats) -> tuple[Floats, Floats]:
        """Return the excess (c,) of the volume and of its axial moment, and their gradients (c, F)."""
        inside = self.membrane.enclosure(free)
        if not self.drifts:
            return np.array([inside.volume - self.volume]), inside.volume_gradient[None]
        gaps = np.array([inside.volume - self.volume, inside.moment])
        return gaps, np.stack([inside.volume_gradient, inside.moment_gradient])


# Newton's method for the steady shape of a capsule on the axis of a channel.
#
# The velocity error (see `capsbayes.physics.steady`) is bordered by the conditions of constant volume and of a centroid
# at z = 0. The Jacobian is exact: elastic tangent, motion of targets and of sources in the kernel, gradient of the
# undisturbed flow, and the response of the walls to all of these

REDUCTION = 0.1  # factor by which a step must lower the residual for its derivatives to be kept
_DIVERGED = 100.0  # times the smallest residual
_KEEP_BELOW = 1e-2  # residual above which they are never kept


class NewtonResult(NamedTuple):
    """End of Newton's iteration."""

    iterate: Iterate
    converged: bool
    residual: float
    iterations: int
    tangent: Floats  # (F + 2,): change of shape, velocity and slack per unit of Ca at the last step taken


class Bordered(NamedTuple):
    """Velocity errors with the gaps of volume and centroid, and their derivatives."""

    residual: Floats  # (F + 2,)
    matrix: Floats  # (F + 2, F + 2): along shape, velocity and slack
    along_ca: Floats  # (F + 2,)
    along_density: Floats  # (F, F): of the velocity errors


def bordered(problem: Problem, iterate: Iterate) -> Bordered:
    """Linearise the equations of a steady state at a candidate."""
    motion, slopes = problem.linearised(iterate)
    inside = problem.membrane(iterate.size_ratio).enclosure(iterate.free)
    count = len(iterate.free)
    matrix = np.zeros((count + 2, count + 2))
    matrix[:count, :count] = slopes.along_shape
    matrix[:count, count], matrix[:count, count + 1] = -motion.axial, motion.normal
    matrix[count, :count], matrix[count + 1, :count] = inside.volume_gradient, inside.moment_gradient
    along_ca = np.append(slopes.along_ca, [0.0, 0.0])
    return Bordered(_residual(motion, inside, iterate.size_ratio), matrix, along_ca, slopes.along_density)


def steady_residual(problem: Problem, iterate: Iterate) -> Floats:
    """Compute the velocity errors of a candidate with the gaps of volume and centroid (F + 2,)."""
    inside = problem.membrane(iterate.size_ratio).enclosure(iterate.free)
    return _residual(problem.motion(iterate), inside, iterate.size_ratio)


def _residual(motion: Motion, inside: Enclosure, size_ratio: float) -> Floats:
    volume = 4.0 / 3.0 * np.pi * size_ratio**3
    return np.append(motion.error, [inside.volume - volume, inside.moment])


@remembered
def steady_state(
    problem: Problem,
    start: Iterate,
    *,
    tolerance: float = 1e-7,
    max_iterations: int = 14,
    patience: int | None = None,
    offset: Floats | None = None,
) -> NewtonResult:
    """Find a steady state by Newton's iteration from `start`, at its Ca and a/l, with steps of at most 0.15 a."""
    # Derivatives cost three times as much as the error, so they are kept while a step brings it down to a tenth. Given
    # up at a hundred times the smallest residual, or above 1e-2 after `patience` steps. `offset` (F + 2,): residual
    # sought.
    iterate, count, size, smallest = start, len(start.free), np.inf, np.inf
    tangent = np.zeros(count + 2)
    factor = None
    for iteration in range(max_iterations + 1):
        before, linearised = size, None
        if factor is None:
            linearised = bordered(problem, iterate)
            residual = linearised.residual
        else:
            residual = steady_residual(problem, iterate)
        if offset is not None:
            residual = residual - offset
        size = float(np.max(np.abs(residual)))
        smallest = min(size, smallest)
        if not size <= _DIVERGED * smallest:
            break
        if size < tolerance and iteration > 0:
            return NewtonResult(iterate, True, size, iteration, tangent)
        if iteration == max_iterations or (patience is not None and iteration >= patience and size > 1e-2):
            break
        if factor is None or size > REDUCTION * before:
            linearised = linearised or bordered(problem, iterate)
            factor = scipy.linalg.lu_factor(linearised.matrix, overwrite_a=True, check_finite=False)
            tangent = scipy.linalg.lu_solve(factor, -linearised.along_ca, check_finite=False)
        if iteration == 0 and size < tolerance:
            return NewtonResult(iterate, True, size, iteration, tangent)
        step = scipy.linalg.lu_solve(factor, -residual, check_finite=False)
        length = 0.15 * start.size_ratio / problem.mesh.largest(step[:count])
        iterate = iterate.moved(min(1.0, length) * step)
        if size > _KEEP_BELOW:
            factor = None
    return NewtonResult(iterate, False, size, iteration, tangent)


# Derivatives of a steady state along its parameters: Ca, a/l and those of the membrane.
#
# Where the residual R(y; p) of shape, velocity and slack y vanishes, dy/dp = -(dR/dy)^-1 dR/dp with the exact matrix of
# Newton's method. All parameters share its factors

_STEP = 1e-5  # of parameters, for the differences of the density


def parameter_derivatives(problem: Problem, iterate: Iterate, names: Sequence[str]) -> Floats:
    """Compute the derivatives (F + 2, p) of a converged steady state along parameters of problem or law."""
    linearised = bordered(problem, iterate)
    along = np.zeros((len(iterate.free) + 2, len(names)))
    for column, name in enumerate(names):
        if name == "capillary_number":
            along[:, column] = linearised.along_ca
        else:
            along[:-2, column] = linearised.along_density @ _density_slope(problem, iterate, name)
        if name == "size_ratio":
            along[-2, column] = -4.0 * np.pi * iterate.size_ratio**2  # of the volume
    return -scipy.linalg.solve(linearised.matrix, along, overwrite_a=True, check_finite=False)


def _density_slope(problem: Problem, iterate: Iterate, name: str) -> Floats:
    """Return the derivative (F,) along a parameter, at constant shape, of the density on the sphere of radius a/l."""
    # On spheres of other radii the density counts by their area, with which the velocity is proportional to it.
    known = {"size_ratio": iterate.size_ratio, **parameters_of(problem)}
    if name not in known:
        raise InputError("parameter", "", f"one of {', '.join(known)}", repr(name))
    value = known[name]
    densities, values = [], []
    for end in (value - _STEP, value + _STEP):
        other, there = problem, iterate
        try:
            if name == "size_ratio":
                there = replace(iterate, size_ratio=end)
            else:
                other = changed(problem, name, end)
            values.append(end)
        except InputError:  # beyond the range of the parameter
            values.append(value)
        gradient = other.membrane(there.size_ratio).gradient(there.free)
        densities.append(other.density(there, gradient) * (there.size_ratio / iterate.size_ratio) ** 2)
    return (densities[1] - densities[0]) / (values[1] - values[0])
