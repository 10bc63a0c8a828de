"""The error budget of a capsule as bars: what each input owns, and what one of its errors changes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from capsbayes.parameters import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from capsbayes.plan import BudgetRow, ErrorBudget

__all__ = ["budget_figure"]

_COLOURS = {"surface_shear_modulus": "#1f5a7a", "capsule_radius": "#c8552b"}
_HEIGHT = 0.36
_OVER = r"/\ell"  # lengths are stated with their own unit


def budget_figure(budget: ErrorBudget) -> Figure:
    """Draw the shares of the variance of G_s and a, and beside them the change of each with one standard error.

    Parameters
    ----------
    budget : ErrorBudget

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 1.6 + 0.42 * len(budget.rows)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(budget.rows), dtype=float)
    for shift, (quantity, colour) in zip((-0.5, 0.5), _COLOURS.items(), strict=True):
        shares = [100.0 * row.share.get(quantity, np.nan) for row in budget.rows]
        changes = [100.0 * row.change.get(quantity, np.nan) / budget.value[quantity] for row in budget.rows]
        for ax, lengths in ((left, shares), (right, changes)):
            bars = ax.barh(places + shift * _HEIGHT, lengths, _HEIGHT, color=colour, label=_label(budget, quantity))
            digits = "%.0f" if ax is left else "%+.1f"
            ax.bar_label(bars, [digits % one if np.isfinite(one) else "" for one in lengths], padding=2, fontsize=8)
    left.set_yticks(places, [_words(row) for row in budget.rows])
    left.invert_yaxis()
    _finish(left, "share of the variance of the logarithm [%]")
    _finish(right, "change with one standard error of the input [%]")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def _label(budget: ErrorBudget, quantity: str) -> str:
    one = PARAMETERS[quantity]
    unit = one.shown_unit.replace("um", "µm")
    return f"${one.latex}$ = {one.shown(budget.value[quantity]):.3g} {unit} ± {100.0 * budget.sd[quantity]:.2g} %"


def _words(row: BudgetRow) -> str:
    one = PARAMETERS.get(row.name)
    if one is None:
        return row.words
    latex = one.latex.removesuffix(_OVER) if row.name.startswith("axial") else one.latex
    return f"${latex}$, {one.meaning}"


def _finish(ax: Axes, label: str) -> None:
    ax.axvline(0.0, color="black", linewidth=0.8)
    ax.margins(x=0.14)
    ax.set_xlabel(label)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.tick_params(axis="y", length=0)
