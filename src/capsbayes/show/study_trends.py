"""Apparent shear modulus against velocity and size: of a right model it depends on neither."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capsbayes.diagnosis import Comparison, Finding
from capsbayes.diagnosis.finding import TRENDS
from capsbayes.parameters import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from capsbayes.diagnosis import Deviation

__all__ = ["trends"]

Floats = NDArray[np.float64]

_INK, _SEEN = "#1f5a7a", "#c8552b"
_MODULUS = PARAMETERS["surface_shear_modulus"]


def trends(compared: Comparison, finding: Finding) -> Figure:
    """Draw the apparent G_s of each capsule with its error, and the slopes that were found.

    Parameters
    ----------
    compared : Comparison
    finding : Finding

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    done = np.flatnonzero(compared.fits.settled)
    velocity = compared.session.circumstances["capsule_velocity"][done]
    size = compared.fits.size[done]
    slopes = {one.name: one for one in finding.deviations}
    _panel(left, compared, done, PARAMETERS["capsule_velocity"].shown(1.0) * velocity)
    _panel(right, compared, done, size)
    _line(
        left,
        slopes.get(TRENDS["velocity"]),
        compared,
        done,
        np.log(velocity),
        np.log(1e3),
        r"$d \ln G_\mathrm{s} / d \ln v_\mathrm{o}$",
    )
    _line(right, slopes.get(TRENDS["size"]), compared, done, size, None, r"$d \ln G_\mathrm{s} / d (a/\ell)$")
    left.set(xlabel=PARAMETERS["capsule_velocity"].axis_label, ylabel=f"apparent {_MODULUS.axis_label}")
    right.set(xlabel=PARAMETERS["size_ratio"].axis_label)
    return figure


def _panel(ax: Axes, compared: Comparison, done: NDArray[np.int64], places: Floats) -> None:
    values, errors = (_MODULUS.scale * one[done] for one in (compared.modulus, compared.modulus_error))
    ax.errorbar(
        places, values, errors, fmt="o", markersize=4, color=_INK, ecolor="#8fc1dc", elinewidth=1.0, label="capsules"
    )


def _line(
    ax: Axes,
    slope: Deviation | None,
    compared: Comparison,
    done: NDArray[np.int64],
    places: Floats,
    logarithm: float | None,
    name: str,
) -> None:
    """The slope of ln G_s through the middle of the capsules, with its standard error."""
    if slope is None:
        ax.set_title("too few values to see a trend", fontsize=10)
        return
    weight = 1.0 / compared.fits.covariance[done, 0, 0]
    middle, height = (np.average(values, weights=weight) for values in (places, compared.fits.log_modulus[done]))
    ends = np.linspace(places.min(), places.max(), 50)
    shown = ends if logarithm is None else np.exp(ends + logarithm)
    centre, low, high = (
        _MODULUS.scale * np.exp(height + (slope.size + shift * slope.error) * (ends - middle)) for shift in (0, -1, 1)
    )
    ax.fill_between(shown, low, high, color=_SEEN, alpha=0.2, linewidth=0)
    ax.plot(shown, centre, color=_SEEN, linewidth=1.5, label="fitted slope ± standard error")
    ax.set_title(f"{name} = {slope.size:+.2f} ± {slope.error:.2f} ({slope.sigma:+.1f} σ)", fontsize=10)
    ax.legend(frameon=False, fontsize=9)
