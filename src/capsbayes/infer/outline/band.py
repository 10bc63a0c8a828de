"""The band of predicted outlines: their mean, and 95 % of the distances along its normal."""

from __future__ import annotations

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.profile import vertex_normals


def band(outlines: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the mean outline and the 2.5 % and 97.5 % quantiles of the distance from it along its normal.

    Parameters
    ----------
    outlines : (d, p, 2) array
        Corresponding points, columns (z, y), counter-clockwise.

    Returns
    -------
    middle, inner, outer : (p, 2) arrays
    """
    middle = outlines.mean(axis=0)
    normal = vertex_normals(middle)
    distance = np.einsum("dpk,pk->dp", outlines - middle, normal)
    low, high = np.quantile(distance, [0.025, 0.975], axis=0)
    return middle, middle + low[:, None] * normal, middle + high[:, None] * normal
