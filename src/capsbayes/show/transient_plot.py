"""A capsule on its way to the steady state, seen in its channel from behind at a few times."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capsbayes.physics.surface.shape_functions import LOCAL_NODES, p2, p2_gradient

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from capsbayes.physics.simulation.snapshot import Snapshot

__all__ = ["transient_figure", "view_plot", "write_transient_figure"]

Floats = NDArray[np.float64]

_MEMBRANE, _WALL, _EDGE = np.array([0.36, 0.65, 0.83]), np.array([0.91, 0.91, 0.90]), "#6e6e6e"
_AZIMUTH, _ELEVATION = np.radians(32.0), np.radians(16.0)
_LIGHT = np.array([-0.42, 0.60, 0.68])  # right, up, towards the eye
_CORNER = 0.94  # cosine between two neighbouring pieces of wall, below which the channel has an edge there
_PARTS = 6  # of an element's edge
_BEHIND, _CAPSULE, _BEFORE = 2.0, 3.0, 4.0
_FAINT = (1.0, 0.5)  # an edge behind the capsule, and one before it


def transient_figure(snapshots: Sequence[Snapshot]) -> Figure:
    """Draw one view for each snapshot, in two columns.

    Parameters
    ----------
    snapshots : sequence of Snapshot

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    rows = -(-len(snapshots) // 2)
    figure = Figure(figsize=(9.4, 0.4 + 3.6 * rows), layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.08))
    reach = 0.35 + max(float(np.max(np.abs(snapshot.nodes[:, 2]))) for snapshot in snapshots)
    axes = figure.subplots(rows, 2, squeeze=False).flat
    for letter, snapshot, ax in zip("abcdefghijklmnopqrstuvwxyz", snapshots, axes, strict=False):
        view_plot(snapshot, ax, reach)
        ax.set_title(rf"({letter})   $Ut/\ell = {snapshot.time:.3g}$", fontsize=13)
    for ax in figure.axes[len(snapshots) :]:
        ax.remove()
    first = snapshots[0]
    figure.suptitle(rf"$\mathrm{{Ca}} = {first.capillary_number:g}$,   $a/\ell = {first.size_ratio:g}$", fontsize=14)
    return figure


def view_plot(snapshot: Snapshot, ax: Axes, reach: float) -> Axes:
    """Draw the capsule in a piece of its channel; the flow goes to the right and away from the eye.

    Parameters
    ----------
    snapshot : Snapshot
    ax : Axes
    reach : float
        Half the length of the piece over l.

    Returns
    -------
    Axes
    """
    from matplotlib.collections import PolyCollection

    camera = _camera()
    corners = _draw_channel(ax, _section(snapshot), camera, reach)
    faces, colours = _shaded(snapshot, camera)
    membrane = PolyCollection(list(faces), facecolors=colours, edgecolors=colours, linewidths=0.4, zorder=_CAPSULE)
    ax.add_collection(membrane)
    low, high = corners.min(axis=0) - 0.05, corners.max(axis=0) + 0.05
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    ax.axis("off")
    start, end = np.array([[0.0, -1.0, 0.35 - reach], [0.0, -1.0, 1.05 - reach]]) @ camera.T[:, :2]
    style = {"arrowstyle": "-|>", "color": _EDGE, "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", end, start, arrowprops=style, zorder=_BEHIND)
    text = rf"$L_z/\ell = {snapshot.profile.axial_extent:.2f}$,   $V/U = {snapshot.velocity_ratio:.2f}$"
    ax.text(0.5, -0.01, text, transform=ax.transAxes, ha="center", va="top", fontsize=11)
    return ax


def _camera() -> Floats:
    """Rows (3, 3): to the right, up and towards the eye."""
    right = np.array([-np.sin(_AZIMUTH), 0.0, np.cos(_AZIMUTH)])
    level = np.array([-np.cos(_AZIMUTH), 0.0, -np.sin(_AZIMUTH)])
    up = np.array([0.0, 1.0, 0.0])
    sine, cosine = np.sin(_ELEVATION), np.cos(_ELEVATION)
    return np.stack([right, cosine * up - sine * level, cosine * level + sine * up])


def _section(snapshot: Snapshot) -> Floats:
    """Outline (p, 2) of the channel's section, columns (x, y), counterclockwise."""
    wedge, _ = snapshot.channel.outline(0.005, 0.0)
    points = np.concatenate([wedge @ turn[:2, :2].T for turn in snapshot.channel.symmetry.operations])
    return points[np.argsort(np.arctan2(points[:, 1], points[:, 0]))]


def _draw_channel(ax: Axes, section: Floats, camera: Floats, reach: float) -> Floats:
    """Draw the walls behind the capsule and all edges; the points (m, 2) of both ends."""
    from matplotlib.collections import PolyCollection

    ends = [np.column_stack([section, np.full(len(section), z)]) @ camera.T for z in (-reach, reach)]
    following = [np.roll(end, -1, axis=0) for end in ends]
    walls = np.stack([ends[0], following[0], following[1], ends[1]], axis=1)
    outward = np.cross(walls[:, 1] - walls[:, 0], walls[:, 3] - walls[:, 0])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    away = outward[:, 2] < 0.0
    tone = _WALL * (0.94 + 0.06 * np.abs(outward[away] @ [0.0, 0.0, 1.0]))[:, None]
    ax.add_collection(PolyCollection(list(walls[away][..., :2]), facecolors=tone, edgecolors=tone, zorder=1.0))
    before = np.roll(outward, 1, axis=0)
    for point in np.flatnonzero((np.einsum("pi,pi->p", before, outward) < _CORNER) | (away != np.roll(away, 1))):
        nearest = not (away[point] or away[point - 1])
        line = np.stack([end[point, :2] for end in ends])
        order, alpha = (_BEFORE if nearest else _BEHIND), _FAINT[nearest]
        ax.plot(line[:, 0], line[:, 1], color=_EDGE, linewidth=0.8, zorder=order, alpha=alpha)
    for end, nearest in zip(ends, (True, False), strict=True):
        order, alpha = (_BEFORE if nearest else _BEHIND), _FAINT[nearest]
        ax.fill(end[:, 0], end[:, 1], facecolor="none", edgecolor=_EDGE, linewidth=0.8, zorder=order, alpha=alpha)
    return np.concatenate(ends)[:, :2]


def _shaded(snapshot: Snapshot, camera: Floats) -> tuple[Floats, Floats]:
    """Triangles (t, 3, 2) of the membrane that face the eye, the farthest first, and their colours (t, 3)."""
    elements = snapshot.mesh.elements
    nodes = snapshot.surface_nodes @ camera.T
    grid, parts = _subdivision()
    shapes = p2(grid)
    points = (shapes @ nodes[elements])[:, parts].reshape(-1, 3, 3)
    normals = (shapes @ _normals(nodes, elements)[elements])[:, parts].reshape(-1, 3, 3).mean(axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    facing = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])[:, 2] > 0.0
    order = np.argsort(points[..., 2].mean(axis=1))
    seen = order[facing[order]]
    light = _LIGHT / np.linalg.norm(_LIGHT)
    halfway = light + np.array([0.0, 0.0, 1.0])
    halfway /= np.linalg.norm(halfway)
    diffuse, gloss = (np.clip(normals[seen] @ direction, 0.0, 1.0)[:, None] for direction in (light, halfway))
    colours = _MEMBRANE * (0.45 + 0.55 * diffuse) + 0.3 * gloss**40
    return points[seen][..., :2], np.clip(colours, 0.0, 1.0)


def _subdivision() -> tuple[Floats, NDArray[np.int64]]:
    """Points (p, 2) of a grid on the unit triangle, and the corners (t, 3) of its small triangles."""
    index = [(i, j) for i in range(_PARTS + 1) for j in range(_PARTS + 1 - i)]
    place = {key: k for k, key in enumerate(index)}
    parts = [(place[i, j], place[i + 1, j], place[i, j + 1]) for i, j in index if i + j < _PARTS]
    parts += [(place[i + 1, j], place[i + 1, j + 1], place[i, j + 1]) for i, j in index if i + j < _PARTS - 1]
    return np.array(index) / _PARTS, np.array(parts)


def _normals(nodes: Floats, elements: NDArray[np.int64]) -> Floats:
    """Outward normals (N, 3) at the nodes, averaged over the elements there: they leave no seams."""
    tangents = np.einsum("qka,eki->eqai", p2_gradient(LOCAL_NODES), nodes[elements])
    total = np.zeros_like(nodes)
    np.add.at(total, elements, np.cross(tangents[:, :, 0], tangents[:, :, 1]))
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def write_transient_figure(snapshots: Sequence[Snapshot], path: str | os.PathLike[str]) -> Path:
    """Draw the views into one picture file; the ending chooses the format."""
    path = Path(path)
    partial = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    transient_figure(snapshots).savefig(partial, dpi=160)
    os.replace(partial, path)
    return path
