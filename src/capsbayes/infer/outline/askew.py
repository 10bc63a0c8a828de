"""Capsules askew: what of a measured outline no symmetric shape of a model explains, and what it does to the rest.

The shapes of a model are symmetric about the flow, and so is what an outline tells of them. The odd part of a measured
outline is therefore known apart from them: by half its distance from its own mirror image. Where it is larger than its
noise explains, it is a nuisance of the likelihood: displacements of the outline that are smooth along it, as those of a
capsule off the axis are in simulations, with amplitudes that are normally distributed about zero. Their size is that of
the odd part.

What makes a capsule askew changes the even part as well, which is not known apart. An offset along the line of sight
tilts the rim, of which a silhouette shows the side that is further back: in simulations the rear is seen further back
by about the size of the odd part that is seen at a right angle. An offset across it changes the even part in second
order, by a twentieth to a fifth of the odd part, and sharply at the rim: an error along arcs has that size.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from capsbayes.arrays import Floats
from capsbayes.infer.outline.normal_distance import posed_on
from capsbayes.measured_outline import OutlineNoise
from capsbayes.profile import arc_length, edge_lengths

EVEN, EVEN_LENGTH = 0.2, 0.2
"""Error of the even part over the size of the odd one, and the length [l] along the outline over which it is alike."""

_WAVES = 4  # along an outline: capsules followed on their way to the axis are odd by less than a twentieth besides
_CHANCE = 1e-3  # that noise alone has an odd part as large: a larger one is none
_OF_POSE = 2.0  # odd degrees of freedom that a shift and a turn take away
_LAID = 3  # times that an outline with a gap is laid onto its mirror image
_GAP = 3.0  # median distances of points: behind a longer edge, a wall hid the outline


def odd_part(points: Floats) -> Floats:
    """Return the odd part of an outline about its own axis, at its points along their normals.

    Parameters
    ----------
    points : (m, 2) array [l]
        Closed outline of any place and tilt, columns (z, y), counter-clockwise.

    Returns
    -------
    (m,) array [l]
        NaN where the mirror image was not seen.
    """
    mirrored = points[::-1] * [1.0, -1.0]
    near = points - 0.5 * (points.max(axis=0) + points.min(axis=0)) * [0.0, 2.0]
    edges = edge_lengths(mirrored)
    hidden = edges > _GAP * np.median(edges)
    seen = np.ones(len(points), dtype=bool)
    for _ in range(_LAID if hidden.any() else 1):  # points whose image is hidden would pull it aside
        _, feet = posed_on(near[seen], mirrored)
        distance = np.full(len(points), np.nan)
        distance[seen] = np.where(hidden[feet.place.astype(int) % len(mirrored)], np.nan, feet.distance)
        seen = np.isfinite(distance)
    return 0.5 * distance


def askew_size(points: Floats, noise: OutlineNoise) -> float:
    """Return the root mean square [l] of the odd part of an outline (m, 2) without its noise; 0 where that explains it.

    The noise of the odd part is half of two independent errors, its degrees of freedom are half of those of the noise
    after Satterthwaite.
    """
    square, of_noise = float(np.nanmean(odd_part(points) ** 2)), 0.5 * noise.scale**2
    if square <= of_noise:
        return 0.0
    covariance = noise.covariance(points)
    freedom = max(0.5 * np.trace(covariance) ** 2 / np.sum(covariance**2) - _OF_POSE, 1.0)
    most = float(chdtri(freedom, _CHANCE)) / freedom * of_noise
    return float(np.sqrt(square - of_noise)) if square > most else 0.0


def odd_directions(outline: Floats, place: Floats, normal: Floats) -> Floats:
    """Return how smooth odd displacements of an outline change the normal distances from it.

    Parameters
    ----------
    outline : (p, 2) array [l]
        Symmetric about the flow, the first vertex at the nose.
    place : (m,) array
        Number of the vertex before a point, and the share of the edge from there on.
    normal : (m, 2) array
        Outward unit normal there.

    Returns
    -------
    (m, 8) array
        Of displacements along the flow as sin(2 pi k s) and across it as cos(2 pi k s), with the share s of the
        perimeter from the nose on and k = 1 to 4, each over k; all together have a mean square of about one.
    """
    arc = arc_length(outline)
    phase = 2.0 * np.pi * np.interp(place, np.arange(len(arc)), arc / arc[-1])
    waves = np.arange(1, _WAVES + 1)
    size = 1.0 / (waves * np.sqrt(0.5 * np.sum(1.0 / waves**2)))
    along, across = (size * turn(waves * phase[:, None]) for turn in (np.sin, np.cos))
    return np.concatenate([normal[:, :1] * along, normal[:, 1:] * across], axis=1)


def rear_direction(outline: Floats, place: Floats, normal: Floats) -> Floats:
    """Return how the normal distances from an outline change if its rear is seen further back between the rims.

    Parameters
    ----------
    outline, place, normal
        As in `odd_directions`.

    Returns
    -------
    (m,) array
        One in the middle of the rear, and less towards its rim, as in half an ellipse.
    """
    y = np.interp(place, np.arange(len(outline) + 1), np.append(outline[:, 1], outline[0, 1]))
    share = np.clip(1.0 - np.square(y / np.abs(outline[:, 1]).max()), 0.0, None)
    return np.maximum(-normal[:, 0], 0.0) * np.sqrt(share)
