"""Outlines of a posterior: their band, and whether any fits the measured one within its stated errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.infer.checks import Gate
from capsbayes.infer.outline.askew import askew_size
from capsbayes.infer.outline.likelihood import aligned_with, outline_likelihood
from capsbayes.measured_outline import MeasuredOutline
from capsbayes.model import ForwardModel
from capsbayes.parameters import COORDINATES
from capsbayes.profile import vertex_normals

_MOST_ASKEW = 0.02  # of l: root mean square of the odd part up to which capsules off the axis were tried
_LARGEST = 4.0  # per degree of freedom: errors twice as large as stated
_TRIED = 50  # draws
_FITTED = 5  # Ca and a/l; place and tilt


def drawn_outlines(
    model: ForwardModel, draws: Mapping[str, Floats], count: int
) -> tuple[dict[str, Floats], Floats | None]:
    """Return the parameters of evenly spaced draws and their outlines (count, p, 2) [l], if the model has them."""
    names = [name for name in ("capillary_number", "size_ratio", *COORDINATES) if name in draws]
    some = np.linspace(0, draws[names[0]].size - 1, count).astype(int)
    theta = {name: np.ravel(draws[name])[some] for name in names}
    return theta, model(theta, outline=True).outline


def outline_misfit(measured: MeasuredOutline, model: ForwardModel, draws: Mapping[str, Floats]) -> Gate:
    """Return the squared misfit of the best of some draws per degree of freedom: one if the errors are as stated.

    Parameters
    ----------
    measured : MeasuredOutline
    model : ForwardModel
        That predicts outlines of its view.
    draws : mapping of arrays
        Of a posterior, by name.

    Returns
    -------
    Gate
    """
    theta, outlines = drawn_outlines(model, draws, _TRIED)
    assert outlines is not None, "asked for"
    off = [np.sum(aligned_with(measured.points, outline)[1].distance ** 2) for outline in outlines]
    best = int(np.nanargmin(off))
    likelihood = outline_likelihood(model, measured, {name: float(values[best]) for name, values in theta.items()})
    square = float(np.sum(likelihood.whitened(outlines[best : best + 1]) ** 2))
    freedom = max(len(measured.points) - _FITTED, 1)
    return Gate("squared misfit of the outline over its freedom", square / freedom, most=_LARGEST)


def lopsided(measured: MeasuredOutline) -> Gate | None:
    """Return the size of the odd part of an outline, which the model does not have; None where noise explains it."""
    size = askew_size(measured.points, measured.noise)
    return Gate("odd part of the outline over l", size, most=_MOST_ASKEW) if size > 0.0 else None


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
