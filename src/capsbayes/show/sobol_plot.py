"""Sobol indices as bars: what each input moves alone, and what together with others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from capsbayes.parameters import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from capsbayes.plan import SobolStudy

__all__ = ["sobol_figure"]

_ALONE, _TOTAL = "#1f5a7a", "#8fc1dc"
_HEIGHT = 0.36
_OVER = r"/\ell"  # lengths may be in metres


def sobol_figure(study: SobolStudy, answers: tuple[str, ...] = ("surface_shear_modulus", "capsule_radius")) -> Figure:
    """Draw the first-order and total indices of some answers, with their 95 % confidence intervals.

    Parameters
    ----------
    study : SobolStudy
    answers : tuple of str
        As in `capsbayes.parameters`.

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2 * len(answers) + 1.2, 1.9 + 0.45 * len(study.ranges)), layout="constrained")
    axes = figure.subplots(1, len(answers), sharey=True, squeeze=False)[0]
    for ax, answer in zip(axes, answers, strict=True):
        _bars(ax, study, answer)
    names = [f"${PARAMETERS[name].latex.removesuffix(_OVER)}$" for name in study.ranges]
    axes[0].set_yticks(np.arange(len(names)), names)
    axes[0].invert_yaxis()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def _bars(ax: Axes, study: SobolStudy, answer: str) -> None:
    found = list(study.indices[answer].values())
    places = np.arange(len(found), dtype=float)
    style: dict[str, Any] = {"error_kw": {"elinewidth": 1.0, "ecolor": "#333333"}, "capsize": 2.0}
    first, first_error = np.array([[one.first, one.first_error] for one in found]).T
    total, total_error = np.array([[one.total, one.total_error] for one in found]).T
    ax.barh(
        places - 0.5 * _HEIGHT, first, _HEIGHT, xerr=first_error, color=_ALONE, label="alone (first order)", **style
    )
    ax.barh(
        places + 0.5 * _HEIGHT, total, _HEIGHT, xerr=total_error, color=_TOTAL, label="with others (total)", **style
    )
    one = PARAMETERS[answer]
    relative = 100.0 * study.sd[answer] / study.mean[answer]
    ax.set_title(f"${one.latex}$: sd {relative:.2g} % over the ranges", fontsize=10)
    ax.set(xlabel="Sobol index", xlim=(min(0.0, 1.1 * float(np.min(first - first_error))), None))
    ax.axvline(0.0, color="black", linewidth=0.8)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.tick_params(axis="y", length=0)
