"""The outline of a capsule in a picture, to a fraction of a pixel.

A closed curve around the dark blob is moved to where the intensity along its normals jumps. The jump is located in
means over arcs of the curve (`edges.models`); the shift of each normal against the mean of its arc is fitted to their
difference.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, map_coordinates, spline_filter

from capsbayes.arrays import Floats
from capsbayes.image.edges.models import Model, locate
from capsbayes.image.edges.robust import robust_spread
from capsbayes.profile import arc_length, equally_spaced

_SPACING = 1.25  # px between normals
ARC = 18.0  # px: length of the arcs that share one shape of the edge
_REACH = 9  # px along a normal, to either side
_SMOOTHING = 2.0  # px: of the curve on which the normals stand
_START_WIDTH = 1.5  # px
_FURTHER_ROUNDS = 2
_CONTRAST = 0.03  # of the light: a fainter jump is no edge


@dataclass(frozen=True, eq=False)
class EdgeOutline:
    """Closed outline with the error of each of its points.

    Parameters
    ----------
    points : (n, 2) array [px]
        Columns (x, y), about a pixel apart.
    normals : (n, 2) array
        Unit vectors outwards.
    point_error : (n,) array [px]
        Standard error along the normal, independent from point to point.
    arc_error : (n,) array [px]
        Standard error along the normal that the points of one arc share.
    arc : (n,) array of int
        Number of the arc of each point.
    edge_width : (n,) array [px]
        Standard deviation of the blur at each point.
    """

    points: Floats = field(repr=False)
    normals: Floats = field(repr=False)
    point_error: Floats = field(repr=False)
    arc_error: Floats = field(repr=False)
    arc: NDArray[np.intp] = field(repr=False)
    edge_width: Floats = field(repr=False)


def pixel_noise(light: Floats) -> float:
    """Return the standard deviation of one pixel's noise, by second differences, most of which hold only noise."""
    second = light[1:-1, 1:-1] - 0.5 * (light[1:-1, :-2] + light[1:-1, 2:])
    return max(robust_spread(second) / np.sqrt(1.5), 1e-6)


def locate_edge(light: Floats, polygon: Floats, noise: float) -> EdgeOutline | None:
    """Locate the edge of a capsule, starting from an outline of a pixel's accuracy; None where there is none.

    The light (rows, columns) is over that of the empty channel, the noise the standard deviation of one pixel of it;
    the polygon (p, 2) [px] has columns (x, y) and is clockwise as seen in the picture.
    """
    first = np.maximum(np.floor(polygon.min(axis=0)).astype(int) - 2 * _REACH, 0)
    last = np.ceil(polygon.max(axis=0)).astype(int) + 2 * _REACH
    spline = spline_filter(light[first[1] : last[1], first[0] : last[0]], order=3, mode="mirror")
    outline = _moved(spline, polygon - first, np.array([_START_WIDTH]), noise)
    for _ in range(_FURTHER_ROUNDS):
        if outline is not None:
            outline = _moved(spline, outline.points, outline.edge_width, noise)
    if outline is None:
        return None
    return replace(outline, points=outline.points + first)


def _moved(spline: Floats, curve: Floats, widths: Floats, noise: float) -> EdgeOutline | None:
    """Locate the edge in the mean of each arc, along normals on the smoothed curve, and the shift of each normal.

    The windows along the normals follow the widths of the last round, given at equal distances along the curve.
    """
    base, tangent, curvature = _smoothed(curve)
    normals = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    samples = np.arange(-_REACH, _REACH + 1, dtype=float)  # positive inwards
    at = base[:, None] - samples[:, None] * normals[:, None]
    profiles = map_coordinates(spline, [at[..., 1], at[..., 0]], order=3, mode="nearest", prefilter=False)
    arcs = max(8, round(_SPACING * len(base) / ARC))
    arc = np.arange(len(base)) * arcs // len(base)
    count = np.bincount(arc, minlength=arcs)
    means = np.add.reduceat(profiles, np.flatnonzero(np.diff(arc, prepend=-1)), axis=0) / count[:, None]
    width = np.interp((np.arange(arcs) + 0.5) / arcs, (np.arange(len(widths)) + 0.5) / len(widths), widths)
    window = np.clip(2.0 * width + 1.5, 3.0, _REACH)
    used = (np.abs(samples) <= window[:, None]).astype(float)
    edge = locate(means, samples, Model.EDGE, np.zeros(arcs), width, used)
    located = edge.converged & (np.abs(edge.place) < 0.7 * window) & (edge.coefficients[:, 2] < -_CONTRAST)
    if located.sum() < arcs // 2:
        return None
    place = np.where(located, edge.place, 0.0)
    arc_width = np.where(located, edge.width, np.median(edge.width[located]))
    # further inside, a concave rear darkens only parts of an arc
    outer = used * (samples <= width[:, None])
    blur = arc_width[arc]
    across, along = _blur_at(blur, normals)
    # the samples end nearer inside than outside: a difference in width would be taken for one in place
    wider = np.log(across) - (np.bincount(arc, np.log(across)) / count)[arc]
    of_width = wider[:, None] * (samples - place[arc][:, None]) * edge.slope[arc]
    shift, shift_variance = _shifts(profiles - of_width, arc, means, edge.slope, outer)
    outward = 0.5 * curvature * along**2 - place[arc] - shift
    arc_variance = np.where(located, edge.place_variance / count, 1.0 / noise**2)
    return EdgeOutline(
        points=base + outward[:, None] * normals,
        normals=normals,
        point_error=noise * np.sqrt(shift_variance),
        arc_error=noise * np.sqrt(arc_variance[arc]),
        arc=arc,
        edge_width=blur,
    )


def _smoothed(curve: Floats) -> tuple[Floats, Floats, Floats]:
    """Return points at equal distance on the smoothed curve, unit tangents, and curvatures, positive where convex."""
    count = max(32, round(arc_length(curve)[-1] / _SPACING))
    base = gaussian_filter1d(equally_spaced(curve, count), _SMOOTHING / _SPACING, axis=0, mode="wrap")
    first = 0.5 * (np.roll(base, -1, axis=0) - np.roll(base, 1, axis=0))
    second = np.roll(base, -1, axis=0) - 2.0 * base + np.roll(base, 1, axis=0)
    speed = np.hypot(*first.T)
    curvature = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / speed**3
    return base, first / speed[:, None], np.asarray(curvature)


def _shifts(
    profiles: Floats, arc: NDArray[np.intp], means: Floats, slopes: Floats, used: Floats
) -> tuple[Floats, Floats]:
    """Return the inward shift of each profile against the mean of its arc, and its variance for noise 1.

    Differences of brightness and contrast from the mean are fitted together with the shift.
    """
    shift, variance = np.empty(len(profiles)), np.empty(len(profiles))
    _shifted(profiles, arc, means, slopes, used, shift, variance)
    return np.clip(shift, -1.5, 1.5), variance


@njit(cache=True, nogil=True, error_model="numpy")
def _shifted(profiles, arc, means, slopes, used, shift, variance):  # type: ignore[no-untyped-def]
    """Fill in the coefficient of the slope by least squares in slope, mean and 1, and its variance."""
    normal, sides = np.empty((3, 3)), np.empty((3, 2))
    for n in range(len(profiles)):
        mean, slope, share = means[arc[n]], slopes[arc[n]], used[arc[n]]
        normal[:], sides[:] = 0.0, 0.0
        sides[0, 1] = 1.0
        for i in range(len(mean)):
            row = (share[i] * slope[i], share[i] * mean[i], share[i])
            for a in range(3):
                sides[a, 0] += row[a] * (profiles[n, i] - mean[i])
                for b in range(3):
                    normal[a, b] += row[a] * row[b]
        ridge = 1e-9 * (normal[0, 0] + normal[1, 1] + normal[2, 2])
        for a in range(3):
            normal[a, a] += ridge
        solved = np.linalg.solve(normal, sides)
        shift[n], variance[n] = solved[0, 0], solved[0, 1]


def _blur_at(width: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Return the blur across and along the edge at each point : (n,) arrays [px].

    The blur is Gaussian, with the standard deviations x and y along the rows and columns: those across the edge where
    it faces that way. With X the blur along an edge of curvature c, and Y that across it, half the light is left where
    Y + c X^2 / 2 has its median. For small c this is c / 2 times the variance of X given Y = 0, which is (x y)^2 over
    the variance of Y. Its root is the blur along the edge.
    """
    streamwise = np.abs(normals[:, 0]) > 0.8
    crosswise = np.abs(normals[:, 1]) > 0.8
    x = float(np.median(width[streamwise])) if streamwise.any() else float(np.median(width))
    y = float(np.median(width[crosswise])) if crosswise.any() else x
    across = np.hypot(x * normals[:, 0], y * normals[:, 1])
    return across, x * y / across
