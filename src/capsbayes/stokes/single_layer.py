"""Velocity of a single layer of Stokeslets on the membrane.

    v(x) = 1/(8 pi) int G(x, y) f(y) dS_0(y)

The density f is per area of the rest sphere and lies in the P2 space of the
mesh, so the integral runs over the fixed rest surface while y moves with the
membrane (Pozrikidis 1992, doi 10.1017/CBO9780511624124).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from capsbayes.stokes.stokeslet import layer_matrices, pressure_kernel
from capsbayes.surface.octasphere import OctaSphere
from capsbayes.surface.quadrature import Rule, dunavant, singular, subdivided
from capsbayes.surface.shape_functions import p2, p2_gradient

__all__ = ["LayerMatrices", "SingleLayer"]

Array = NDArray[np.float64]


class LayerMatrices(NamedTuple):
    """Velocity, and its derivatives, from the wedge's density (see `layer_matrices`)."""

    velocity: Array
    source_slope: Array
    target_slope: Array


@dataclass(frozen=True)
class QuadratureChoice:
    """Which rule serves which distance from an element, in units of the element's radius."""

    levels: tuple[float, ...] = (8.0, 3.5, 1.8)
    rules: tuple[tuple[int, int], ...] = ((2, 0), (5, 0), (6, 1), (5, 2))
    singular_order: int = 8


class _Tables(NamedTuple):
    """Everything about the rules that does not move with the membrane."""

    offsets: NDArray[np.int64]
    shapes: Array
    weights: Array
    corner_shapes: Array
    corner_weights: Array
    levels: Array


def _rest_area(nodes: Array, elements: NDArray[np.int64], points: Array) -> Array:
    """Area of the rest surface per area of the unit triangle, (e, q)."""
    tangents = np.einsum("qka,eki->eqai", p2_gradient(points), nodes[elements])
    return np.linalg.norm(np.cross(tangents[:, :, 0], tangents[:, :, 1]), axis=-1)


@lru_cache(maxsize=8)
def _tables(mesh: OctaSphere, choice: QuadratureChoice) -> _Tables:
    rules = [subdivided(dunavant(degree), times) for degree, times in choice.rules]
    corners = [singular(node, choice.singular_order) for node in range(6)]
    points = np.concatenate([rule.points for rule in rules])
    weights = np.concatenate([rule.weights for rule in rules])

    def corner_weight(rule: Rule) -> Array:
        return rule.weights * _rest_area(mesh.nodes, mesh.elements, rule.points)

    return _Tables(
        offsets=np.cumsum([0] + [len(rule.weights) for rule in rules]),
        shapes=p2(points),
        weights=weights * _rest_area(mesh.nodes, mesh.elements, points),
        corner_shapes=np.stack([p2(rule.points) for rule in corners]),
        corner_weights=np.stack([corner_weight(rule) for rule in corners], axis=1),
        levels=np.array(choice.levels),
    )


class SingleLayer:
    """Single layer on one deformed shape.

    Parameters
    ----------
    mesh : OctaSphere
    radius : float
        Radius of the rest sphere, whose area carries the density.
    nodes : (N, 3) array
        Where the mesh's nodes are now.
    density : (N, 3) array, optional
        Force on the liquid per rest area at the nodes; only derivatives need it.
    """

    def __init__(
        self,
        mesh: OctaSphere,
        radius: float,
        nodes: Array,
        density: Array | None = None,
        *,
        choice: QuadratureChoice | None = None,
    ) -> None:
        self.mesh, self.radius, self.nodes = mesh, radius, nodes
        self.density = density
        tables = self._tables = _tables(mesh, choice or QuadratureChoice())
        placed = nodes[mesh.elements]
        loads = (np.zeros_like(nodes) if density is None else density)[mesh.elements]
        self._points, self._loads = tables.shapes @ placed, tables.shapes @ loads
        self._corner_points = tables.corner_shapes @ placed[:, None]
        self._corner_loads = tables.corner_shapes @ loads[:, None]
        self._centres = np.mean(placed, axis=1)
        self._radii = np.max(np.linalg.norm(placed - self._centres[:, None], axis=-1), axis=1)

    def matrices(self, targets: Array, *, target_nodes: NDArray[np.int64] | None = None) -> LayerMatrices:
        """Matrices from the wedge's density to the velocity at `targets` (t, 3), with the factor 1/(8 pi)."""
        tables, mesh = self._tables, self.mesh
        scale = self.radius**2 / (8 * np.pi)
        result = layer_matrices(
            np.ascontiguousarray(targets),
            np.full(len(targets), -1) if target_nodes is None else target_nodes,
            mesh.elements,
            mesh.wedge_of,
            mesh.operation,
            self._centres,
            self._radii,
            tables.levels,
            tables.offsets,
            self._points,
            self._loads,
            scale * tables.weights,
            tables.shapes,
            self._corner_points,
            self._corner_loads,
            scale * tables.corner_weights,
            tables.corner_shapes,
            len(mesh.wedge),
            self.density is not None,
        )
        return LayerMatrices(*result)

    def pressure(self, targets: Array) -> Array:
        """Pressure (t,) of the layer at points away from the membrane, over mu U/l."""
        first, last = self._tables.offsets[2:4]
        kernel = pressure_kernel(targets, self._points[:, first:last].reshape(-1, 3))
        weighted = self._loads[:, first:last] * self._tables.weights[:, first:last, None]
        return self.radius**2 / (8 * np.pi) * np.einsum("tsi,si->t", kernel, weighted.reshape(-1, 3))
