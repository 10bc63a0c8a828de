"""Corner plot of a posterior: every pair of quantities, and each alone."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from capsbayes.infer import Marginal, Posterior
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.show.figures.style import ACCENT, INK
from capsbayes.show.words.rounding import two_digits, unit_of

SHOWN = ("surface_shear_modulus", "capsule_radius", "mean_velocity", "capillary_number", "size_ratio")

_MOST_DRAWS = 20_000  # more make the picture no smoother


def corner_plot(posterior: Posterior, names: Sequence[str] = SHOWN) -> Figure:
    """Draw the corner plot.

    Contours hold 68 % and 95 % of the probability; dashed lines are the median
    and the equal-tailed 68 % interval, which the titles give in numbers. The
    paper's deterministic answer is marked if it is known.

    Parameters
    ----------
    posterior : Posterior
    names : sequence of str
        Quantities, as in `capsbayes.parameters`; those that the posterior lacks are omitted.
    """
    shown = [PARAMETERS[name] for name in names if name in posterior.draws]
    draws = np.stack([parameter.scale * np.ravel(posterior.draws[parameter.name]) for parameter in shown], axis=1)
    draws = draws[:: max(1, len(draws) // _MOST_DRAWS)]
    figure: Figure = _corner()(
        draws,
        bins=36,
        smooth=0.8,
        smooth1d=0.8,
        color=INK,
        labels=[parameter.axis_label for parameter in shown],
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
    for k, parameter in enumerate(shown):
        axes[k, k].set_title(_title(parameter, posterior.marginals[parameter.name]), fontsize=11)
    _mark_deterministic(axes, posterior, [parameter.name for parameter in shown])
    figure.subplots_adjust(left=0.09, bottom=0.09, right=0.98, top=0.95, wspace=0.06, hspace=0.06)
    return figure


@cache
def _corner() -> Callable[..., Figure]:
    """Return what draws an array in the library corner, whose other half imports ArviZ: half a second of a command."""
    package = importlib.util.find_spec("corner")
    if package is None or not package.submodule_search_locations:
        raise ModuleNotFoundError("corner")
    core = Path(package.submodule_search_locations[0]) / "core.py"
    spec = importlib.util.spec_from_file_location("corner_core", core)
    if spec is None or spec.loader is None:
        raise ModuleNotFoundError("corner.core")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    draw: Callable[..., Figure] = module.corner_impl
    return draw


def _mark_deterministic(axes: Any, posterior: Posterior, names: Sequence[str]) -> None:
    if posterior.deterministic is None:
        return
    answer = posterior.deterministic.as_dict()
    for row, first in enumerate(names):
        for column, second in enumerate(names[: row + 1]):
            x = PARAMETERS[second].shown(answer[second])
            if row == column:
                line = axes[row, row].axvline(x, color=ACCENT, linewidth=1.4)
            else:
                axes[row, column].plot(x, PARAMETERS[first].shown(answer[first]), "D", color=ACCENT, markersize=5)
    axes[0, -1].figure.legend(
        [line], ["deterministic answer (diffuse approximation)"], loc="upper right", fontsize=12, frameon=False
    )


def _title(parameter: Parameter, marginal: Marginal) -> str:
    """Median and the distances to the ends of the 68 % interval, to two digits of the smaller."""
    middle, low, high = map(parameter.shown, (marginal.median, marginal.lower_68, marginal.upper_68))
    digits = two_digits(max(min(middle - low, high - middle), 1e-12 * abs(middle)))
    errors = f"_{{-{middle - low:.{digits}f}}}^{{+{high - middle:.{digits}f}}}"
    return f"${parameter.latex} = {middle:.{digits}f}{errors}${unit_of(parameter)}"
