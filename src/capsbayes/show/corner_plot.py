"""Corner plot of a posterior: every pair of quantities, and each alone."""

from __future__ import annotations

import functools
import sys
from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from capsbayes.infer import Marginal, Posterior
from capsbayes.parameters import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["corner_plot"]

SHOWN = ("surface_shear_modulus", "capsule_radius", "mean_velocity", "capillary_number", "size_ratio")

_INK, _PAPER = "#1f5a7a", "#c8552b"
_MOST_DRAWS = 20_000  # more make the picture no smoother


def corner_plot(posterior: Posterior, names: Sequence[str] = SHOWN) -> Figure:
    """Draw the corner plot.

    Contours hold 68 % and 95 % of the probability; dashed lines are the median
    and the equal-tailed 68 % interval, which the titles give in numbers. The
    paper's deterministic answer is marked where there is one.

    Parameters
    ----------
    posterior : Posterior
    names : sequence of str
        Quantities, as in `capsbayes.parameters`.

    Returns
    -------
    Figure
    """
    shown = [PARAMETERS[name] for name in names]
    draws = np.stack([one.scale * np.ravel(posterior.draws[one.name]) for one in shown], axis=1)
    draws = draws[:: max(1, len(draws) // _MOST_DRAWS)]
    figure: Figure = _corner().corner(
        draws,
        bins=36,
        smooth=0.8,
        smooth1d=0.8,
        color=_INK,
        labels=[one.axis_label for one in shown],
        levels=(0.68, 0.95),
        plot_datapoints=False,
        plot_density=False,
        fill_contours=True,
        quantiles=(0.16, 0.5, 0.84),
        label_kwargs={"fontsize": 12},
        labelpad=0.04,
        max_n_ticks=4,
        hist_kwargs={"linewidth": 1.5},
    )
    axes = np.array(figure.axes).reshape(len(shown), len(shown))
    for k, one in enumerate(shown):
        axes[k, k].set_title(_title(one.latex, posterior.marginals[one.name], one.scale, one.shown_unit), fontsize=11)
    _mark_deterministic(axes, posterior, names)
    figure.subplots_adjust(left=0.09, bottom=0.09, right=0.98, top=0.95, wspace=0.06, hspace=0.06)
    return figure


def _mark_deterministic(axes: Any, posterior: Posterior, names: Sequence[str]) -> None:
    if posterior.deterministic is None:
        return
    answer = posterior.deterministic.as_dict()
    for row, first in enumerate(names):
        for column, second in enumerate(names[: row + 1]):
            x = PARAMETERS[second].shown(answer[second])
            if row == column:
                line = axes[row, row].axvline(x, color=_PAPER, linewidth=1.4)
            else:
                axes[row, column].plot(x, PARAMETERS[first].shown(answer[first]), "D", color=_PAPER, markersize=5)
    axes[0, -1].figure.legend(
        [line], ["deterministic answer (diffuse approximation)"], loc="upper right", fontsize=12, frameon=False
    )


def _title(latex: str, marginal: Marginal, scale: float, unit: str) -> str:
    """Median and the distances to the ends of the 68 % interval, to two digits of the smaller."""
    middle, low, high = (scale * value for value in (marginal.median, marginal.lower_68, marginal.upper_68))
    least = max(min(middle - low, high - middle), 1e-12 * abs(middle))
    digits = max(0, 1 - int(np.floor(np.log10(least))))
    unit = "" if unit in ("", "-") else f" {unit.replace('um', 'µm')}"
    return f"${latex} = {middle:.{digits}f}_{{-{middle - low:.{digits}f}}}^{{+{high - middle:.{digits}f}}}${unit}"


@functools.cache
def _corner() -> ModuleType:
    """The corner library, imported without ArviZ: it wants that only to read InferenceData, and waits for it."""
    if "corner" in sys.modules or "arviz" in sys.modules:
        import corner

        return corner
    sys.modules["arviz"] = None  # type: ignore[assignment]
    try:
        import corner
    finally:
        del sys.modules["arviz"]
        for name in [name for name in sys.modules if name.split(".")[0] == "corner"]:
            del sys.modules[name]  # so that others import it whole
    return corner
