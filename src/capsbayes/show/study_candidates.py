"""How much better each effect that was tried explains the capsules than the model without it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capsbayes.diagnosis import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["candidate_ratios"]

_INK, _OTHER = "#1f5a7a", "#b8c4cb"


def candidate_ratios(study: Study) -> Figure:
    """Draw the log-likelihood ratio of every candidate, those in question in a colour.

    Parameters
    ----------
    study : Study

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 0.9 + 0.32 * len(study.scores)), layout="constrained")
    ax = figure.subplots()
    ratios = [one.log_likelihood_ratio for one in study.scores.values()]
    bars = ax.barh(
        [one.effect.name for one in study.scores.values()],
        ratios,
        color=[_INK if name in study.names else _OTHER for name in study.scores],
        height=0.65,
    )
    ax.bar_label(bars, [f"{ratio:.1f}" for ratio in ratios], padding=4, fontsize=9)
    ax.margins(x=0.08)
    ax.invert_yaxis()
    ax.set_xlabel("log-likelihood ratio to the model without it, at the best size")
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    return figure
