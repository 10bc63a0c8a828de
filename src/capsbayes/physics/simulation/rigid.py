"""A rigid sphere that is free to move on the channel's axis: what the solver for the liquids is verified with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capsbayes.physics.simulation.problem import Problem
from capsbayes.physics.stokes.single_layer import SingleLayer
from capsbayes.physics.stokes.walls import wall_operator

__all__ = ["RigidMotion", "rigid_sphere"]


class RigidMotion(NamedTuple):
    """Velocity over U, and pressure drop added to the undisturbed one over mu U / l."""

    velocity_ratio: float
    extra_pressure_drop: float


def rigid_sphere(problem: Problem, size_ratio: float) -> RigidMotion:
    """Motion of a force-free rigid sphere on the axis.

    The traction f solves v_inf + (single layer) + (walls) = V e_z on the sphere with zero total force; its constant
    normal part, which moves nothing, is set to zero.

    Parameters
    ----------
    problem : Problem
        Only its mesh, section and walls matter.
    size_ratio : float
        Radius over the half width.

    Returns
    -------
    RigidMotion
    """
    mesh, basis, channel = problem.mesh, problem.mesh.basis, problem.channel
    nodes = size_ratio * mesh.nodes
    targets = nodes[mesh.wedge]
    layer = SingleLayer(mesh, size_ratio, nodes)
    operator = wall_operator(channel, problem.walls)
    answer = operator.answer(operator.velocity_matrix(targets))
    influence = layer.matrices(targets, target_nodes=mesh.wedge).velocity
    influence = influence - answer @ layer.matrices(operator.points).velocity
    flow = mesh.reduced(channel.undisturbed(targets)[0])
    axial = basis.T @ np.tile([0.0, 0.0, 1.0], len(targets))
    normal = mesh.reduced(mesh.nodes[mesh.wedge])
    mass = problem.membrane(size_ratio).mass
    count = len(axial)
    matrix = np.zeros((count + 2, count + 2))
    matrix[:count, :count] = basis.T @ (basis.T @ influence.T).T
    matrix[:count, count:] = np.column_stack([-axial, normal])
    matrix[count:, :count] = np.stack([mass @ axial, mass @ normal])
    solution = np.linalg.solve(matrix, np.concatenate([-flow, [0.0, 0.0]]))
    drop = -(mass @ flow) @ solution[:count] / channel.area
    return RigidMotion(float(solution[count]), float(drop))
