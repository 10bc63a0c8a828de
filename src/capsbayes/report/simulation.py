"""Figures of simulated capsules: a steady shape in its channel, and a capsule on its way to it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from scipy.spatial import ConvexHull

from capsbayes.arrays import Floats, Integers
from capsbayes.parameters import PARAMETERS
from capsbayes.physics.surface import facets, p2, subdivision
from capsbayes.report.style import ACCENT, FILL, INK, WALL, closed, draw_walls, new_figure

if TYPE_CHECKING:
    from capsbayes.physics.simulator import Snapshot, SteadyState


_MEMBRANE, _PLASTER, _EDGE = np.array([0.36, 0.65, 0.83]), np.array([0.91, 0.91, 0.90]), "#6e6e6e"
_VELOCITY = PARAMETERS["velocity_ratio"].latex
_AZIMUTH, _ELEVATION = np.radians(32.0), np.radians(16.0)
_LIGHT = np.array([-0.42, 0.60, 0.68])  # right, up, towards the eye
_CORNER = 0.94  # cosine between two neighbouring pieces of wall, below which the channel has an edge there
_BEHIND, _CAPSULE, _BEFORE = 2.0, 3.0, 4.0
_PARTS = 6  # of an edge of an element
_LOOKS: Any = ({"zorder": _BEHIND, "alpha": 1.0}, {"zorder": _BEFORE, "alpha": 0.5})  # of edges behind and before


def _draw_shape(ax: Axes, state: SteadyState) -> None:
    """Profile, silhouette, walls and the lengths L_z and L_a, all over l."""
    profile, silhouette = (closed(outline.points) for outline in (state.profile, state.silhouette))
    ax.fill(silhouette[:, 0], silhouette[:, 1], color=FILL, linewidth=0)
    ax.plot(silhouette[:, 0], silhouette[:, 1], color=ACCENT, linewidth=1, linestyle=(0, (4, 2)), label="silhouette")
    ax.plot(profile[:, 0], profile[:, 1], color=INK, linewidth=1.8, label="profile, plane x = 0")
    ends = profile[:, 0].min() - 0.4, profile[:, 0].max() + 0.4
    draw_walls(ax, ends, 1.12)
    nose, rear = profile[:, 0].max(), profile[:, 0].min()
    axial = state.profile.axial_length
    for y, start, name, value in ((1.28, rear, "L_z", nose - rear), (0.0, nose - axial, "L_a", axial)):
        ax.annotate("", (start, y), (nose, y), arrowprops={"arrowstyle": "<->", "color": "black", "linewidth": 0.8})
        ax.text((start + nose) / 2, y + 0.04, f"${name}/\\ell = {value:.3f}$", ha="center", va="bottom")
    ax.set(xlim=ends, ylim=(-1.2, 1.55), aspect="equal", xlabel=r"$z/\ell$", ylabel=r"$y/\ell$")
    numbers = f"Ca = {state.capillary_number:g}, $a/\\ell$ = {state.size_ratio:g}"
    ax.set_title(f"{numbers}, ${_VELOCITY}$ = {state.velocity_ratio:.3f}")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, frameon=False)


def _draw_section(ax: Axes, state: SteadyState) -> None:
    """The capsule seen along the flow in the square cross-section, all over l."""
    points = state.surface_nodes[:, :2]
    hull = points[ConvexHull(points).vertices]
    ax.fill(hull[:, 0], hull[:, 1], facecolor=FILL, edgecolor=INK, linewidth=1.8)
    ax.plot([-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1], color=WALL, linewidth=4)
    ax.set(xlim=(-1.15, 1.15), ylim=(-1.15, 1.15), aspect="equal", xlabel=r"$x/\ell$", ylabel=r"$y/\ell$")
    ax.set_title("seen along the flow")


def _draw_tensions(ax: Axes, state: SteadyState) -> None:
    """The membrane seen obliquely, coloured by its larger principal tension; the flow goes right and away."""
    corners, _ = facets(state.mesh.elements, state.surface_nodes, _PARTS)
    grid, triangles = subdivision(_PARTS)
    tensions = (p2(grid) @ state.principal_tensions[state.mesh.elements, 0].T).T[:, triangles].mean(axis=-1).ravel()
    points = corners @ _camera().T
    seen = _facing(points)
    membrane = PolyCollection(list(points[seen][..., :2]), array=tensions[seen], edgecolors="face", linewidths=0.3)
    membrane.set_clim(min(float(tensions.min()), 0.0), float(state.principal_tensions.max()))
    ax.add_collection(membrane)
    ax.autoscale_view()
    ax.set(aspect="equal")
    ax.axis("off")
    ax.set_title(rf"tensions, at most {state.principal_tensions.max():.3f} $G_\mathrm{{s}}$")
    ax.figure.colorbar(membrane, ax=ax, orientation="horizontal", shrink=0.8, label=r"$\tau_1 / G_\mathrm{s}$")


def shape_figure(state: SteadyState) -> Figure:
    """Draw two views and the tensions."""
    figure = new_figure(13.0, 4.6)
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.55, 1.0, 1.0))
    _draw_shape(left, state)
    _draw_section(middle, state)
    _draw_tensions(right, state)
    return figure


def transient_figure(snapshots: Sequence[Snapshot]) -> Figure:
    """Draw one view for each snapshot, in two columns."""
    rows = -(-len(snapshots) // 2)
    figure = new_figure(9.4, 0.4 + 3.6 * rows, layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.08))
    reach = 0.35 + max(float(np.max(np.abs(snapshot.nodes[:, 2]))) for snapshot in snapshots)
    axes = figure.subplots(rows, 2, squeeze=False).flat
    for letter, snapshot, ax in zip("abcdefghijklmnopqrstuvwxyz", snapshots, axes, strict=False):
        _draw_view(ax, snapshot, reach)
        ax.set_title(rf"({letter})   $Ut/\ell = {snapshot.time:.3g}$", fontsize=13)
    for ax in figure.axes[len(snapshots) :]:
        ax.remove()
    first = snapshots[0]
    figure.suptitle(rf"$\mathrm{{Ca}} = {first.capillary_number:g}$,   $a/\ell = {first.size_ratio:g}$", fontsize=14)
    return figure


def _draw_view(ax: Axes, snapshot: Snapshot, reach: float) -> None:
    """The capsule in a piece of its channel of half length `reach` [l]; the flow goes right and away."""
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
    text = rf"$L_z/\ell = {snapshot.profile.axial_extent:.2f}$,   ${_VELOCITY} = {snapshot.velocity_ratio:.2f}$"
    ax.text(0.5, -0.01, text, transform=ax.transAxes, ha="center", va="top", fontsize=11)


def _camera() -> Floats:
    """Rows (3, 3): to the right, up and towards the eye."""
    right = np.array([-np.sin(_AZIMUTH), 0.0, np.cos(_AZIMUTH)])
    level = np.array([-np.cos(_AZIMUTH), 0.0, -np.sin(_AZIMUTH)])
    up = np.array([0.0, 1.0, 0.0])
    sine, cosine = np.sin(_ELEVATION), np.cos(_ELEVATION)
    return np.stack([right, cosine * up - sine * level, cosine * level + sine * up])


def _section(snapshot: Snapshot) -> Floats:
    """Outline (p, 2) of the cross-section, columns (x, y), counterclockwise."""
    wedge, _ = snapshot.channel.outline(0.005, 0.0)
    points = np.concatenate([wedge @ turn[:2, :2].T for turn in snapshot.channel.symmetry.operations])
    return points[np.argsort(np.arctan2(points[:, 1], points[:, 0]))]


def _draw_channel(ax: Axes, edge: Floats, camera: Floats, reach: float) -> Floats:
    """Draw the walls behind the capsule and all edges; the points (m, 2) of both ends."""
    ends = [np.column_stack([edge, np.full(len(edge), z)]) @ camera.T for z in (-reach, reach)]
    following = [np.roll(end, -1, axis=0) for end in ends]
    walls = np.stack([ends[0], following[0], following[1], ends[1]], axis=1)
    outward = np.cross(walls[:, 1] - walls[:, 0], walls[:, 3] - walls[:, 0])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    away = outward[:, 2] < 0.0
    tone = _PLASTER * (0.94 + 0.06 * np.abs(outward[away] @ [0.0, 0.0, 1.0]))[:, None]
    ax.add_collection(PolyCollection(list(walls[away][..., :2]), facecolors=tone, edgecolors=tone, zorder=1.0))
    before = np.roll(outward, 1, axis=0)
    for point in np.flatnonzero((np.einsum("pi,pi->p", before, outward) < _CORNER) | (away != np.roll(away, 1))):
        nearest = not (away[point] or away[point - 1])
        line = np.stack([end[point, :2] for end in ends])
        ax.plot(line[:, 0], line[:, 1], color=_EDGE, linewidth=0.8, **_LOOKS[nearest])
    for end, look in zip(ends, reversed(_LOOKS), strict=True):
        ax.fill(end[:, 0], end[:, 1], facecolor="none", edgecolor=_EDGE, linewidth=0.8, **look)
    return np.concatenate(ends)[:, :2]


def _facing(points: Floats) -> Integers:
    """Return the numbers of the triangles (t, 3, 3) that face the eye, the farthest first."""
    facing = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])[:, 2] > 0.0
    order = np.argsort(points[..., 2].mean(axis=1))
    return np.asarray(order[facing[order]])


def _shaded(snapshot: Snapshot, camera: Floats) -> tuple[Floats, Floats]:
    """Triangles (t, 3, 2) of the membrane that face the eye, the farthest first, and their colours (t, 3)."""
    corners, outward = facets(snapshot.mesh.elements, snapshot.surface_nodes)
    points, normals = corners @ camera.T, outward @ camera.T
    seen = _facing(points)
    light = _LIGHT / np.linalg.norm(_LIGHT)
    halfway = light + np.array([0.0, 0.0, 1.0])
    halfway /= np.linalg.norm(halfway)
    diffuse, gloss = (np.clip(normals[seen] @ direction, 0.0, 1.0)[:, None] for direction in (light, halfway))
    colours = _MEMBRANE * (0.45 + 0.55 * diffuse) + 0.3 * gloss**40
    return points[seen][..., :2], np.clip(colours, 0.0, 1.0)
