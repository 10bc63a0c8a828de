"""Shear moduli of the held-out capsules before and after an effect is added."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from capsbayes.diagnosis import Verification
from capsbayes.parameters import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["moduli"]

_MODULUS = PARAMETERS["surface_shear_modulus"]
_STYLES = (("before", "#c8552b", -0.14, "o", "white"), ("after", "#1f5a7a", 0.14, "s", "#1f5a7a"))


def moduli(verification: Verification) -> Figure:
    """Draw G_s of each capsule with its error before and after, and the medians.

    Parameters
    ----------
    verification : Verification

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(10.0, 3.8), layout="constrained")
    ax = figure.subplots()
    first = verification.comparisons[0]
    order = np.argsort(first.modulus)  # NaN last
    places = np.arange(1, len(order) + 1)
    for compared, (when, colour, shift, marker, face) in zip(verification.comparisons, _STYLES, strict=True):
        values, errors = (_MODULUS.scale * one[order] for one in (compared.modulus, compared.modulus_error))
        median = _MODULUS.shown(compared.median_modulus)
        ax.axhline(median, color=colour, linewidth=1.0, linestyle="--")
        ax.errorbar(
            places + shift,
            values,
            errors,
            fmt=marker,
            color=colour,
            markerfacecolor=face,
            markersize=5,
            elinewidth=1.0,
            label=f"{when}, median {median:.1f} {_MODULUS.shown_unit}",
        )
    ax.set(xlabel="held-out capsule, in the order of $G_\\mathrm{s}$ before", ylabel=_MODULUS.axis_label)
    ax.set_xlim(0.4, len(order) + 0.6)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.legend(frameon=False, loc="upper left")
    return figure
