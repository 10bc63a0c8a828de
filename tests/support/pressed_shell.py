"""The shell of `axisymmetric_shell` on the finite elements of the library, and how far the two differ."""

from __future__ import annotations

from functools import cache

import numpy as np
from axisymmetric_shell import AxisymmetricShell

from capsbayes.physics.load import MembraneLoad, integrals_over, rest_metric
from capsbayes.physics.membrane import NeoHookean
from capsbayes.physics.surface import C_INF_V, octasphere

SPRING, BENDING = 10.0, 1e-2


def pressed(membrane, heights):
    """Free coordinates of a shell with springs on its poles at the last of some heights."""
    mesh = membrane.mesh
    integral, area = integrals_over(mesh), rest_metric(mesh, 1.0).area
    cosine = np.einsum("qk,ek->eq", integral.shapes, mesh.nodes[integral.elements][..., 2])
    along = np.einsum("eq,qk,ql->ekl", SPRING * area * cosine**8, integral.shapes, integral.shapes)
    springs = integral.assembled(np.einsum("ekl,ij->ekilj", along, np.diag([0.0, 0.0, 1.0])).reshape(-1, 18, 18))
    free = membrane.rest
    for height in heights:
        for _ in range(30):
            elastic = membrane.elasticity(free)
            load = elastic.gradient + springs @ (free - height * membrane.rest)
            change = np.linalg.solve(elastic.tangent + springs, -load)
            free = free + change * min(1.0, 0.1 / mesh.largest(change))
            if mesh.largest(change) < 1e-9:
                break
        else:
            raise ArithmeticError("the shell does not come to rest")
    return free


@cache
def distances(refinement, bending_energy, height):
    """Distances (N,) of the nodes from their places on the axisymmetric shell, its poles pressed in to a height."""
    heights = np.arange(0.95, height - 0.01, -0.05)
    shell = AxisymmetricShell(BENDING, SPRING, degree=40)
    mesh = octasphere(refinement, C_INF_V)
    membrane = MembraneLoad(mesh, NeoHookean(), 1.0, BENDING, bending_energy=bending_energy)
    nodes = mesh.expanded(pressed(membrane, heights))
    across, along = shell.meridian(shell.pressed(heights), np.arccos(np.clip(mesh.nodes[:, 2], -1.0, 1.0)))
    return np.hypot(np.hypot(nodes[:, 0], nodes[:, 1]) - across, nodes[:, 2] - along)
