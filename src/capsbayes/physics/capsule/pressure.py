"""Pressure inside a steady capsule, and the pressure drop that the capsule adds to that of the channel."""

from __future__ import annotations

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.physics.capsule.problem import Iterate, Problem
from capsbayes.physics.stokes.single_layer import SingleLayer
from capsbayes.physics.stokes.stokeslet import pressure_kernel
from capsbayes.physics.stokes.walls import wall_operator

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
