"""Velocity of a single layer of Stokeslets on the membrane.

    v(x) = 1/(8 pi) int G(x, y) f(y) dS_0(y)

The density f is per area of the rest sphere and lies in the P2 space of the
mesh, so the integral runs over the fixed rest surface while y moves with the
membrane (Pozrikidis 1992, doi 10.1017/CBO9780511624124).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Floats, Integers
from capsbayes.physics.stokes.layer_kernel import POINT_ROWS, TILE, Elements, Tiles, layer_matrices
from capsbayes.physics.stokes.stokeslet import pressure_kernel
from capsbayes.physics.surface.octasphere import OctaSphere
from capsbayes.physics.surface.quadrature import Rule, dunavant, singular, subdivided
from capsbayes.physics.surface.shape_functions import p2, p2_gradient


class LayerMatrices(NamedTuple):
    """Velocity and its derivatives from the density of the wedge (see `layer_matrices`)."""

    velocity: Floats
    source_slope: Floats
    target_slope: Floats


@dataclass(frozen=True)
class QuadratureChoice:
    """Quadrature rules by distance from an element, in units of the radius of the element."""

    levels: tuple[float, ...] = (3.5, 1.8)
    rules: tuple[tuple[int, int], ...] = ((5, 0), (6, 1), (5, 2))
    singular_order: int = 8


class _Tables(NamedTuple):
    """Parts of the rules that do not move with the membrane: shapes (q, 6) and weights (e, q)."""

    coarse_shapes: Floats
    coarse_weights: Floats
    fine_shapes: Floats
    fine_weights: Floats
    first: Integers  # first tile of each of the finer rules
    counts: Integers  # number of their points


def _rest_area(nodes: Floats, elements: Integers, points: Floats) -> Floats:
    """Return the area (e, q) of the rest surface per area of the unit triangle."""
    tangents = np.einsum("qka,eki->eqai", p2_gradient(points), nodes[elements])
    return np.linalg.norm(np.cross(tangents[:, :, 0], tangents[:, :, 1]), axis=-1)


@lru_cache(maxsize=8)
def _tables(mesh: OctaSphere, choice: QuadratureChoice) -> _Tables:
    elements, multiplicity = mesh.orbits
    share = multiplicity[:, None] / len(mesh.symmetry.operations)

    def weights(rule: Rule) -> Floats:
        return share * rule.weights * _rest_area(mesh.nodes, elements, rule.points)

    coarse, *regular = [subdivided(dunavant(degree), times) for degree, times in choice.rules]
    finer = regular + [singular(node, choice.singular_order) for node in range(6)]
    counts = np.array([len(rule.weights) for rule in finer])
    tiles = -(-counts // TILE)
    first = np.concatenate([[0], np.cumsum(tiles)])
    fine_shapes, fine_weights = np.zeros((first[-1] * TILE, 6)), np.zeros((len(elements), first[-1] * TILE))
    for start, rule in zip(first * TILE, finer, strict=False):
        here = slice(start, start + len(rule.weights))
        fine_shapes[here], fine_weights[:, here] = p2(rule.points), weights(rule)
    return _Tables(p2(coarse.points), weights(coarse), fine_shapes, fine_weights, first, counts)


_ELSEWHERE = 1e3  # position of points without weight, far from every target


class SingleLayer:
    """Single layer on one deformed shape, nodes (N, 3); its density (N, 3) is needed for derivatives only."""

    # The density is the force on the liquid per area of the sphere at rest, of this radius.

    def __init__(
        self,
        mesh: OctaSphere,
        radius: float,
        nodes: Floats,
        density: Floats | None = None,
        *,
        choice: QuadratureChoice = QuadratureChoice(),
    ) -> None:
        self.mesh, self.radius, self.density, self._nodes, self._choice = mesh, radius, density, nodes, choice
        elements, _ = mesh.orbits
        self._placed = nodes[elements]
        self._loads = np.zeros_like(self._placed) if density is None else density[elements]
        centres = np.mean(self._placed, axis=1)
        self._elements = Elements(
            nodes=elements,
            wedge_of=mesh.wedge_of,
            operation=mesh.operation,
            images=mesh.images,
            turns=mesh.symmetry.operations,
            centres=centres,
            radii=np.max(np.linalg.norm(self._placed - centres[:, None], axis=-1), axis=1),
        )

    @cached_property
    def _tiles(self) -> Tiles:
        tables = _tables(self.mesh, self._choice)
        scale = self.radius**2 / (8 * np.pi)
        points, count = len(tables.coarse_shapes), len(self._placed)
        fitting = TILE // points
        blocks = -(-count // fitting)
        coarse = np.zeros((blocks * fitting, points, POINT_ROWS))
        coarse[:count, :, :3] = tables.coarse_shapes @ self._placed
        coarse[:count, :, 3] = scale * tables.coarse_weights
        coarse[:count, :, 4:] = tables.coarse_shapes @ self._loads
        padded = np.zeros((blocks, TILE, POINT_ROWS))
        padded[:, : fitting * points] = coarse.reshape(blocks, -1, POINT_ROWS)
        padded[..., :3] += _ELSEWHERE * (padded[..., 3:4] == 0.0)
        shapes, weights = tables.fine_shapes, scale * tables.fine_weights
        fine = np.concatenate([shapes @ self._placed, weights[..., None], shapes @ self._loads], axis=-1)
        return Tiles(
            levels=np.array(self._choice.levels),
            coarse=padded.transpose(0, 2, 1).ravel(),
            coarse_shapes=np.pad(tables.coarse_shapes, ((0, 0), (0, 2))),
            fine=fine.reshape(-1, TILE, POINT_ROWS).transpose(0, 2, 1).ravel(),
            fine_shapes=shapes.reshape(-1, TILE, 6).transpose(0, 2, 1).ravel(),
            first=tables.first,
            counts=tables.counts,
        )

    def matrices(self, targets: Floats, *, target_nodes: Integers | None = None) -> LayerMatrices:
        """Compute the matrices from the density of the wedge to the velocity at `targets` (t, 3), with 1/(8 pi)."""
        on_nodes = np.full(len(targets), -1) if target_nodes is None else target_nodes
        unknown = len(self.mesh.wedge)
        placed = np.ascontiguousarray(targets)
        return LayerMatrices(
            *layer_matrices(placed, on_nodes, self._elements, self._tiles, unknown, self.density is not None)
        )

    def pressure(self, targets: Floats) -> Floats:
        """Compute the pressure (t,) of the layer at points away from the membrane, over mu U/l."""
        assert self.density is not None, "the pressure is that of a density"
        rule = dunavant(6)
        elements = self.mesh.elements
        shapes = p2(rule.points)
        weights = rule.weights * _rest_area(self.mesh.nodes, elements, rule.points)
        kernel = pressure_kernel(targets, (shapes @ self._nodes[elements]).reshape(-1, 3))
        loads = (shapes @ self.density[elements]) * weights[..., None]
        return self.radius**2 / (8 * np.pi) * np.einsum("tsi,si->t", kernel, loads.reshape(-1, 3))
