"""Pressure inside a steady capsule, and the pressure drop that it adds to the channel's."""

from __future__ import annotations

import numpy as np

from capsbayes.simulation.steady_state import Iterate, SteadyProblem
from capsbayes.stokes.single_layer import SingleLayer
from capsbayes.stokes.stokeslet import pressure_kernel
from capsbayes.stokes.walls import wall_operator
from capsbayes.surface.octasphere import D4

__all__ = ["pressures"]


def pressures(problem: SteadyProblem, iterate: Iterate) -> tuple[float, float]:
    """Inner pressure and extra pressure drop, both over mu U / l.

    The inner pressure is that of the liquid inside over the pressure that the undisturbed flow would have at the
    centroid, half way between the disturbances far up- and downstream. The extra pressure drop follows from the
    reciprocal theorem with the undisturbed flow, dP+ Q = - int f . v_inf dS.

    Parameters
    ----------
    problem : SteadyProblem
    iterate : Iterate
        A steady state.

    Returns
    -------
    inner_pressure, extra_pressure_drop : float
    """
    mesh, channel = problem.mesh, problem.channel
    elastic = problem.membrane(iterate.size_ratio).elasticity(iterate.free)
    density = problem.density(iterate, elastic)
    nodes = mesh.expanded(iterate.free)
    speed, _ = channel.undisturbed(nodes[mesh.wedge])
    flow = mesh.basis.T @ np.column_stack([0 * speed, 0 * speed, speed]).ravel()
    drop = elastic.gradient @ flow / (iterate.capillary_number * channel.area)

    layer = SingleLayer(mesh, iterate.size_ratio, nodes, mesh.expanded(density))
    operator = wall_operator(channel, problem.walls, D4)
    strengths = operator.strengths(layer.matrices(operator.points).velocity @ (mesh.basis @ density))
    sources = np.concatenate([operator.sources @ turn.T for turn in D4])
    forces = np.concatenate([strengths @ turn.T for turn in D4])
    on_axis = nodes[np.hypot(mesh.nodes[:, 0], mesh.nodes[:, 1]) < 1e-12, 2]
    z = np.array([np.mean(on_axis), -0.9 * problem.walls.end, 0.9 * problem.walls.end])
    points = np.column_stack([0 * z, 0 * z, z])
    disturbance = layer.pressure(points) + np.einsum("tsi,si->t", pressure_kernel(points, sources), forces)
    inside = disturbance[0] - channel.pressure_gradient * z[0] - np.mean(disturbance[1:])
    return float(inside), float(drop)
