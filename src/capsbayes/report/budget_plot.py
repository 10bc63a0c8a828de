"""The error budget of a posterior: how much of the variance of log G_s is owed to each input."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capsbayes.inference import Posterior
from capsbayes.parameters import PARAMETERS
from capsbayes.report.posterior_words import input_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["budget_figure"]

_INK, _NEGATIVE = "#1f5a7a", "#c8552b"
_OVER_L = r"/\ell"  # of the lengths' symbols in the table of quantities


def budget_figure(posterior: Posterior) -> Figure:
    """Draw a bar for each input, the largest above.

    A bar below zero is of what is missing to one: the prior, and the model's curvature.

    Parameters
    ----------
    posterior : Posterior

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure

    ordered = sorted(posterior.shares.items(), key=lambda one: one[1])
    shares = [100.0 * share for _, share in ordered]
    figure = Figure(figsize=(7.4, 0.9 + 0.36 * len(shares)), layout="constrained")
    ax = figure.subplots()
    places = range(len(shares))
    bars = ax.barh(places, shares, color=[_INK if share >= 0.0 else _NEGATIVE for share in shares], height=0.62)
    ax.bar_label(bars, [f"{share:.1f} %" for share in shares], padding=4, fontsize=10)
    ax.set_yticks(places, [_label(name) for name, _ in ordered], fontsize=10)
    ax.axvline(0.0, color="#555555", linewidth=0.8)
    low, high = min(0.0, *shares), max(shares)
    ax.set_xlim(low - (0.16 * (high - low) if low < 0.0 else 0.0), high + 0.16 * (high - low))
    ax.set_xlabel(r"share of the variance of $\log G_\mathrm{s}$ [%]")
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.tick_params(axis="y", length=0)
    return figure


def _label(name: str) -> str:
    one = PARAMETERS.get(name)
    return f"${one.latex.removesuffix(_OVER_L)}$, {one.meaning}" if one else input_words(name)
