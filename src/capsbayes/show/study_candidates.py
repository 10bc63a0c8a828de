"""How much better each effect that was tried explains the capsules than the model without it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capsbayes.diagnosis import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["candidate_gains"]

_INK, _OTHER = "#1f5a7a", "#b8c4cb"


def candidate_gains(study: Study) -> Figure:
    """Draw the gain in log likelihood of every candidate, those in question in a colour.

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
    gains = [one.gain for one in study.scores.values()]
    bars = ax.barh(
        [one.effect.name for one in study.scores.values()],
        gains,
        color=[_INK if name in study.names else _OTHER for name in study.scores],
        height=0.65,
    )
    ax.bar_label(bars, [f"{gain:.1f}" for gain in gains], padding=4, fontsize=9)
    ax.margins(x=0.08)
    ax.invert_yaxis()
    ax.set_xlabel("gain in log likelihood over the model without it, at the best size")
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    return figure
