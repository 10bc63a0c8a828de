"""Motion of a membrane that is not steady, relative to its centroid: dx/dt = v(x) - V e_z + s n.

V keeps the centroid in place and the slack s the volume, which the flow conserves only up to the mesh's error. Where
symmetry alone keeps the centroid in place, V is zero.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.linalg

from capsbayes.arrays import Floats
from capsbayes.physics.capsule.problem import Iterate, Motion, Problem


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
