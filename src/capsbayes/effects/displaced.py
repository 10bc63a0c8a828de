"""Predictions with displaced edges, and with scaled lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.prediction import Prediction
from capsbayes.profile import vertex_normals


def displaced(prediction: Prediction, across: Floats, along_flow: Floats) -> Prediction:
    """Displace the edges of a prediction outwards.

    Parameters
    ----------
    prediction : Prediction
    across : (n,) array [l]
        Displacement along the normal everywhere.
    along_flow : (n,) array [l]
        Additional displacement where the normal is along the flow, elsewhere in proportion to its component.
    """
    longer = 2.0 * (across + along_flow)
    moved = replace(
        prediction, axial_extent=prediction.axial_extent + longer, axial_length=prediction.axial_length + longer
    )
    if prediction.outline is None:
        return moved
    normals = vertex_normals(prediction.outline)
    distance = across[:, None] + along_flow[:, None] * np.abs(normals[..., 0])
    return replace(moved, outline=prediction.outline + distance[..., None] * normals)


def scaled(prediction: Prediction, lengths: Floats, velocity: Floats) -> Prediction:
    """Multiply the lengths and the velocity of a prediction by factors (n,)."""
    factors = np.stack([lengths, lengths, velocity], axis=1)
    return replace(
        prediction,
        axial_extent=prediction.axial_extent * lengths,
        axial_length=prediction.axial_length * lengths,
        velocity_ratio=prediction.velocity_ratio * velocity,
        covariance=prediction.covariance * factors[:, :, None] * factors[:, None, :],
        outline=None if prediction.outline is None else prediction.outline * lengths[:, None, None],
    )
