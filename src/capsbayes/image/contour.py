"""The outline of a capsule in a picture, to a fraction of a pixel.

A closed curve is laid around the dark spot that the capsule is, then moved to where the intensity along its normals
jumps. The jump is located in means over arcs of the curve (`edge_models`), and from there in each normal by the
shift that explains its difference from the mean of its arc.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, map_coordinates, spline_filter

from capsbayes.image.edge_models import Model, locate

__all__ = ["ARC", "Outline", "pixel_noise", "sharpened"]

Floats = NDArray[np.float64]

_SPACING = 1.25  # px between normals
ARC = 18.0  # px: length of the arcs over which the edge's shape is taken as one
_REACH = 9  # px along a normal to either side
_SMOOTHING = 2.0  # px: of the curve on which the normals stand
_START_WIDTH = 1.5  # px
_CONTRAST = 0.03  # of the light: a fainter jump is no edge


@dataclass(frozen=True, eq=False)
class Outline:
    """Closed outline with the error of each of its points.

    Parameters
    ----------
    points : (n, 2) array [px]
        Columns (x, y), a pixel or so apart.
    normals : (n, 2) array
        Unit vectors outwards.
    point_error : (n,) array [px]
        Standard error along the normal of each point by itself.
    arc_error : (n,) array [px]
        Standard error along the normal that the points of one arc share.
    arc : (n,) array of int
        Which arc each point belongs to.
    edge_width : (n,) array [px]
        Standard deviation of the blur at each place.
    """

    points: Floats = field(repr=False)
    normals: Floats = field(repr=False)
    point_error: Floats = field(repr=False)
    arc_error: Floats = field(repr=False)
    arc: NDArray[np.intp] = field(repr=False)
    edge_width: Floats = field(repr=False)


def pixel_noise(light: Floats) -> float:
    """Standard deviation of the noise of one pixel, from second differences, most of which see nothing else."""
    second = light[1:-1, 1:-1] - 0.5 * (light[1:-1, :-2] + light[1:-1, 2:])
    return max(float(np.median(np.abs(second))) / 0.6745 / np.sqrt(1.5), 1e-6)


def sharpened(light: Floats, polygon: Floats, noise: float) -> Outline | None:
    """Move an outline of a pixel's accuracy to the edge.

    Parameters
    ----------
    light : (rows, columns) array
        Share of the light of the empty channel.
    polygon : (p, 2) array [px]
        Where to start, columns (x, y), clockwise as seen in the picture.
    noise : float
        Standard deviation of one pixel of `light`.

    Returns
    -------
    Outline or None
        None where no edge can be located.
    """
    first = np.maximum(np.floor(polygon.min(axis=0)).astype(int) - 2 * _REACH, 0)
    last = np.ceil(polygon.max(axis=0)).astype(int) + 2 * _REACH
    spline = spline_filter(light[first[1] : last[1], first[0] : last[0]], order=3, mode="mirror")
    curve, width = polygon - first, np.array([_START_WIDTH])
    outline = None
    for _ in range(3):
        outline = _moved(spline, curve, width, noise)
        if outline is None:
            return None
        curve, width = outline.points, outline.edge_width
    if outline is None:
        return None
    return replace(outline, points=outline.points + first)


def _moved(spline: Floats, curve: Floats, widths: Floats, noise: float) -> Outline | None:
    """One step: normals on the smoothed curve, the edge in the mean of each arc, the shift of each normal.

    The windows along the normals are as wide as the edges were found, at equal shares of the curve's length.
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
    found = locate(means, samples, Model.EDGE, np.zeros(arcs), width, used)
    sound = found.converged & (np.abs(found.place) < 0.7 * window) & (found.coefficients[:, 2] < -_CONTRAST)
    if sound.sum() < arcs // 2:
        return None
    place = np.where(sound, found.place, 0.0)
    arc_width = np.where(sound, found.width, np.median(found.width[sound]))
    # further inside, a concave rear darkens some places of an arc and not others
    outer = used * (samples <= width[:, None])
    shift, shift_variance = _shifts(profiles, arc, means, found.slope, outer)
    blur = arc_width[arc]
    outward = 0.5 * curvature * _blur_along(blur, normals) ** 2 - place[arc] - shift
    arc_variance = np.where(sound, found.place_variance / count, 1.0 / noise**2)
    return Outline(
        points=base + outward[:, None] * normals,
        normals=normals,
        point_error=noise * np.sqrt(shift_variance),
        arc_error=noise * np.sqrt(arc_variance[arc]),
        arc=arc,
        edge_width=blur,
    )


def _smoothed(curve: Floats) -> tuple[Floats, Floats, Floats]:
    """Points at equal distance on a smoothed curve, unit tangents, and curvatures, positive where convex."""
    closed = np.concatenate([curve, curve[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    count = max(32, round(length[-1] / _SPACING))
    even = np.stack([np.interp(np.arange(count) * length[-1] / count, length, closed[:, axis]) for axis in (0, 1)], 1)
    base = gaussian_filter1d(even, _SMOOTHING / _SPACING, axis=0, mode="wrap")
    first = 0.5 * (np.roll(base, -1, axis=0) - np.roll(base, 1, axis=0))
    second = np.roll(base, -1, axis=0) - 2.0 * base + np.roll(base, 1, axis=0)
    speed = np.hypot(*first.T)
    curvature = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / speed**3
    return base, first / speed[:, None], np.asarray(curvature)


def _shifts(
    profiles: Floats, arc: NDArray[np.intp], means: Floats, slopes: Floats, used: Floats
) -> tuple[Floats, Floats]:
    """Shift inwards of each profile against the mean of its arc, and its variance for noise 1.

    The mean may be brighter or of more contrast besides: those are fitted with the shift.
    """
    shift, variance = np.empty(len(profiles)), np.empty(len(profiles))
    _shifted(profiles, arc, means, slopes, used, shift, variance)
    return np.clip(shift, -1.5, 1.5), variance


@njit(cache=True, nogil=True, error_model="numpy")
def _shifted(profiles, arc, means, slopes, used, shift, variance):  # type: ignore[no-untyped-def]
    """Fill in the first unknown of least squares in slope, mean and 1, and its variance."""
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


def _blur_along(width: Floats, normals: Floats) -> Floats:
    """Blur along the tangent of each place: that which the places whose normal points there see across."""
    streamwise = np.abs(normals[:, 0]) > 0.8
    crosswise = np.abs(normals[:, 1]) > 0.8
    x = float(np.median(width[streamwise])) if streamwise.any() else float(np.median(width))
    y = float(np.median(width[crosswise])) if crosswise.any() else x
    return np.hypot(x * normals[:, 1], y * normals[:, 0])
