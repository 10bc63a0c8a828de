"""Outlines of ellipses, with errors of any size."""

import numpy as np

from capsbayes.image.edges import EdgeOutline


def ellipse(a, b, *, centre=(40.0, 30.0), tilt=0.0, count=240, arcs=12, point=0.0, shared=0.0, width=1.0):
    """Points of an ellipse of the half axes a and b, clockwise in a picture as the outlines of the package are."""
    angle = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    turn = np.array([[np.cos(tilt), np.sin(tilt)], [-np.sin(tilt), np.cos(tilt)]])
    normals = np.stack([np.cos(angle) / a, np.sin(angle) / b], axis=1)
    normals /= np.hypot(*normals.T)[:, None]
    points = np.stack([a * np.cos(angle), b * np.sin(angle)], axis=1)
    return EdgeOutline(
        points @ turn + centre,
        normals @ turn,
        np.full(count, point),
        np.full(count, shared),
        np.arange(count) * arcs // count,
        np.full(count, width),
        np.ones(count, dtype=bool),
        np.zeros(count, dtype=bool),
    )


def noisy(outline, rng, *, within_arcs=True):
    """Return the points with errors as the outline states them; those within an arc have no mean if asked."""
    own = outline.point_error * rng.standard_normal(len(outline.points))
    count = np.bincount(outline.arc)
    if within_arcs:
        own -= (np.bincount(outline.arc, own) / count)[outline.arc]
    errors = own + outline.arc_error * rng.standard_normal(len(count))[outline.arc]
    return outline.points + errors[:, None] * outline.normals
