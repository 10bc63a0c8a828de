"""How far the located edges lie from the true ones in a microscope, from a round target of known size."""

from __future__ import annotations

import numpy as np

from capsbayes.errors import InputError
from capsbayes.image.background import Contrast, estimate_background, find_blobs, transmission
from capsbayes.image.by_hand import ByHand, length
from capsbayes.image.edges import EDGE_FLOOR, EdgeOutline, locate_edge, pixel_noise, points_variance
from capsbayes.image.files import Picture
from capsbayes.image.walls import WallLines
from capsbayes.profile import signed_area
from capsbayes.quantity import Given, Quantity
from capsbayes.status import Status

_ROUND = 0.02  # of the radius: rms distance of the outline from the circle


def edge_offset_of(picture: Picture, diameter: Given, pixel_size: Given, *, by_hand: ByHand | None = None) -> Quantity:
    """Measure how far outside the located edge of a bead or disc the true one lies.

    Parameters
    ----------
    picture : Picture
        One round target, with the optics and the light of the pictures of capsules.
    diameter : Quantity [m]
        Of the target, with its standard error.
    pixel_size : Quantity [m]
        With its standard error, from another source, as the period of a grating.
    by_hand : ByHand, optional
        Its `crop`, `contrast` and `gamma` count.

    Returns
    -------
    Quantity [px]
        As `ByHand.edge_offset`, with its standard error.

    Raises
    ------
    InputError
        If no round target is found, or several.
    """
    by_hand = by_hand or ByHand()
    size = length(pixel_size, "pixel size", "0.340 +/- 0.003 um")
    across = length(diameter, "target", "20.0 +/- 0.1 um")
    outline = _round_edge(picture.linear(by_hand.gamma).cut(by_hand.part(picture.shape)), by_hand.contrast)
    area = abs(signed_area(outline.points))
    found, true = float(np.sqrt(area / np.pi)), 0.5 * across.value / size.value
    relative = np.hypot(across.error / across.value, size.error / size.value)
    weights = np.full(len(outline.points), 1.0 / len(outline.points))
    error = float(np.sqrt((true * relative) ** 2 + points_variance(outline, weights) + EDGE_FLOOR**2))
    return Quantity(true - found, error, "px")


def _round_edge(picture: Picture, contrast: str | None) -> EdgeOutline:
    """Return the outline of the one round object in a picture without walls."""
    rows, columns = picture.shape
    whole = WallLines(0.5 * (rows - 1), 0.5 * (columns - 1), 0.0, 0.5 * rows, 0.0, 0.0)
    shown = Contrast.of([picture.grey], None, whole, contrast).shown(picture)
    light = transmission(shown.grey, estimate_background(shown.grey, whole))
    noise = pixel_noise(light)
    blobs = [blob for blob in find_blobs(light, whole, noise) if blob.status is not Status.DEBRIS]
    outline = locate_edge(light, blobs[0].polygon, noise) if len(blobs) == 1 and blobs[0].status.ok else None
    if outline is None:
        got = str(blobs[0].status) if len(blobs) == 1 else f"{len(blobs) or 'no'} dark objects"
        raise InputError(picture.source or "picture", "", "one round target in its middle", got, "crop it")
    radii = np.hypot(*(outline.points - outline.points.mean(axis=0)).T)
    if (away := float(radii.std() / radii.mean())) > _ROUND:
        raise InputError(picture.source or "picture", "", "a round target", f"an outline {away:.1%} off a circle")
    return outline
