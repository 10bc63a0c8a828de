"""Capsules off the axis and what their silhouettes tell: ``python -m evidence.benchmarks.off_axis``.

A steady capsule is shifted off the axis and followed in time, on a mesh with one mirror plane. To its silhouettes is
added what the surrogate's shape is next to the steady one of this mesh, so that what is left of Ca and a/l is due to
the offset.

``evidence/results/off_axis.json`` keeps each capsule when it is done. ``--write`` renews the table in
``evidence/results/pictures.md``.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar
from unittest.mock import patch

import numpy as np

from capsbayes import Experiment, Measurement, Surrogate, identify
from capsbayes.infer import outline as of_outline
from capsbayes.measurement import SILHOUETTE, MeasuredOutline, OutlineNoise, Pose, askew_size
from capsbayes.physics.channel import FourfoldTube, SquareChannel
from capsbayes.physics.membrane import NeoHookean
from capsbayes.physics.simulator import Simulator
from capsbayes.physics.steady import Iterate, Problem
from capsbayes.physics.stokes import WallDiscretisation
from capsbayes.physics.surface import D4, Symmetry, p2, subdivision
from capsbayes.physics.transient import transient
from capsbayes.profile import equally_spaced, vertex_normals
from evidence.benchmarks.stored import Stored, with_write
from evidence.markdown import table

CAPSULES = (  # cross-section, Ca, a/l, and the shift off the axis at the beginning over l
    ("circular", 0.08, 0.77, 0.05),
    ("square", 0.05, 0.85, 0.04),
    ("circular", 0.03, 0.80, 0.06),
    ("square", 0.08, 0.80, 0.05),
    ("circular", 0.05, 0.85, 0.04),
    ("square", 0.03, 0.75, 0.07),
    ("circular", 0.10, 0.75, 0.06),
    ("square", 0.02, 0.80, 0.06),
    ("circular", 0.05, 0.90, 0.03),
    ("square", 0.06, 0.90, 0.03),
)
TIMES = (0.4, 0.8, 1.2, 1.6, 2.4)  # U t / l
SHOWN = (0.4, 1.2, 2.4)
VIEWS = ("across the offset", "along the offset")
REFINEMENT, BENDING = 6, 2e-4
WALLS = WallDiscretisation(spacing=0.2, far_spacing=0.3)
NOISE, POINTS, RAYS, PARTS = OutlineNoise(0.003, 0.2, 0.5), 120, 720, 6
CS = Symmetry("CS", np.array([np.eye(3), np.diag([-1.0, 1.0, 1.0])]))  # one mirror plane, x = 0
HEAD = ("seen", "U t/l", "n", "odd part, l/1000", "without: held", "usable", "with: held", "usable", "Ca off by, %")


def unfolded(points, weights):
    """Return the points on half of a cross-section, of those on an eighth."""
    halves = [operation[:2, :2] for operation in D4.operations if operation[0, :2] @ [1.0, 0.4] > 0.0]
    return np.concatenate([points @ half.T for half in halves]), np.tile(weights, len(halves))


class Half:
    """Cross-section in which a capsule may be off the axis along y."""

    symmetry: ClassVar[Symmetry] = CS

    def outline(self, spacing, outwards):
        return unfolded(*super().outline(spacing, outwards))

    def filling(self, spacing, outwards):
        return unfolded(*super().filling(spacing, outwards))


@dataclass(frozen=True)
class HalfTube(Half, FourfoldTube):
    """Circular tube."""


@dataclass(frozen=True)
class HalfSquare(Half, SquareChannel):
    """Square channel."""


def followed(cross_section, ca, size, offset):
    """Return the elements, and the nodes [l] of the steady shape and at each time (1 + t, N, 3)."""
    state = Simulator(refinement=REFINEMENT, cross_section=cross_section, bending=BENDING).run(
        capillary_number=ca, size_ratio=size
    )
    half = HalfTube() if cross_section == "circular" else HalfSquare()
    problem = Problem(NeoHookean(), half, REFINEMENT, BENDING, walls=WALLS)
    mesh = problem.mesh
    start = Iterate(mesh.reduced(state.surface_nodes[mesh.wedge]), float(state.velocity_ratio), 0.0, ca, size)
    shift = mesh.reduced(np.tile([0.0, offset, 0.0], (len(mesh.wedge), 1)))
    shapes = [mesh.expanded(start.free)]
    for instant in transient(problem, replace(start, free=start.free + shift), TIMES, tolerance=3e-3):
        shapes.append(mesh.expanded(instant.iterate.free))
    return mesh.elements, np.array(shapes)


def radii(elements, nodes, view):
    """Return the distances of the silhouette from its middle in even directions : (RAYS,) array [l]."""
    grid, triangles = subdivision(PARTS)
    seen = (p2(grid) @ nodes[elements])[..., [2, 1 if view == VIEWS[0] else 0]]
    ends = [seen[:, triangles[:, corner]].reshape(-1, 2) for corner in (0, 1, 2, 0)]
    middle = np.array([0.5 * (ends[0][:, 0].max() + ends[0][:, 0].min()), 0.0])
    farthest = np.zeros(RAYS)
    for first, last in itertools.pairwise(ends):
        reach(first - middle, last - middle, farthest)
    return farthest


def reach(starts, ends, farthest):
    """Raise the farthest distances to those at which the ray of each angle meets the edges."""
    step = 2.0 * np.pi / RAYS
    angles = [np.arctan2(points[:, 1], points[:, 0]) for points in (starts, ends)]
    turn = np.angle(np.exp(1j * (angles[1] - angles[0])))
    low = np.minimum(angles[0], angles[0] + turn)
    first = np.floor(low / step).astype(int)
    for more in range(int(np.abs(turn).max() / step) + 3):
        ray = first + more
        along = np.stack([np.cos(ray * step), np.sin(ray * step)], axis=1)
        off = [along[:, 0] * points[:, 1] - along[:, 1] * points[:, 0] for points in (starts, ends)]
        meets = (off[0] * off[1] <= 0.0) & (off[0] != off[1])
        share = off[0][meets] / (off[0] - off[1])[meets]
        point = starts[meets] + share[:, None] * (ends - starts)[meets]
        np.maximum.at(farthest, ray[meets] % RAYS, np.sum(point * along[meets], axis=1))


def rows(number):
    """Return what the silhouettes of a capsule tell, one row for each view and time."""
    cross_section, ca, size, offset = CAPSULES[number]
    elements, nodes = followed(cross_section, ca, size, offset)
    model = Surrogate.open(f"{cross_section}-neo-hookean", view=SILHOUETTE)
    truth = {"capillary_number": ca, "size_ratio": size}
    return [
        row(model, truth, elements, nodes[[0, 1 + TIMES.index(time)]], view, time, [number, round(10 * time)])
        for view in VIEWS
        for time in SHOWN
    ]


def row(model, truth, elements, nodes, view, time, seed):
    """Return what the silhouette of a shape tells with the odd part as a nuisance, and without."""
    points = outline(model, truth, *(radii(elements, each, view) for each in nodes))
    points = points + NOISE.drawn(np.random.default_rng(seed), points, 1)[0][:, None] * vertex_normals(points)
    found = {"view": view, "time": time, "askew": askew_size(points, NOISE)}
    found["with"] = answer(model, truth, points)
    with patch.object(of_outline, "askew_size", return_value=0.0):
        found["without"] = answer(model, truth, points)
    return found


def outline(model, truth, steady, there):
    """Return a silhouette (POINTS, 2), without the difference of the steady shape from that of the surrogate."""
    seen = model({name: np.array([value]) for name, value in truth.items()}, outline=True).outline[0]
    seen = seen - [0.5 * (seen[:, 0].max() + seen[:, 0].min()), 0.0]
    angle = 2.0 * np.pi * np.arange(RAYS) / RAYS
    of_model = np.interp(angle, np.arctan2(seen[:, 1], seen[:, 0]), np.hypot(*seen.T), period=2.0 * np.pi)
    size = there + of_model - steady
    return equally_spaced(size[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1), POINTS)


def answer(model, truth, points):
    """Return the status of a posterior, whether its 95 % intervals hold the truth, and its median Ca over that."""
    experiment = Experiment(cross_section=model.cross_section, half_width=1e-3, viscous_tension="0.01 +/- 0.0001 N/m")
    measured = Measurement(
        axial_extent=float(np.ptp(points[:, 0])),
        axial_extent_error=0.01,
        outline=MeasuredOutline(points, NOISE, Pose(offset=0.001), SILHOUETTE),
    )
    found = identify(measured, model, experiment, seed=1, engine="quadrature")
    held = {
        name: found.marginals[name].lower_95 < value < found.marginals[name].upper_95 for name, value in truth.items()
    }
    misfit = next(gate.value for gate in found.gates if "misfit of the outline" in gate.name)
    ca = found.marginals["capillary_number"].median / truth["capillary_number"]
    return {"status": found.status.name, "misfit": misfit, "held": bool(all(held.values())), "ca": ca}


def usable(answered):
    return answered["status"] not in ("OUTLINE_MISFIT", "LOPSIDED")


def tables(done):
    """Return the table of a dictionary of rows."""
    every = list(itertools.chain.from_iterable(done.values()))
    lines = []
    for view, time in itertools.product(VIEWS, SHOWN):
        mine = [each for each in every if (each["view"], each["time"]) == (view, time)]
        odd = 1e3 * np.median([each["askew"] for each in mine])
        off = [100.0 * abs(each["with"]["ca"] - 1.0) for each in mine]
        counts = [
            str(sum(count(each[which]) for each in mine))
            for which in ("without", "with")
            for count in (lambda answered: answered["held"], usable)
        ]
        ca_off = f"{np.median(off):.1f} (at most {max(off):.0f})"
        lines.append((view, str(time), str(len(mine)), f"{odd:.0f}", *counts, ca_off))
    return {"off the axis": table(HEAD, lines)}


STORED = Stored("off_axis.json", "evidence/results/pictures.md", tables)


def main():
    given = with_write(__doc__).parse_args()
    STORED.show(STORED.completed((str(n), partial(rows, n)) for n in range(len(CAPSULES))), write=given.write)


if __name__ == "__main__":
    main()
