"""Corner plot of a posterior: every pair of quantities, and each alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import gaussian_filter

from capsbayes.arrays import Floats
from capsbayes.infer import Marginal, Posterior
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.show.figures.style import ACCENT, FILL, INK, PALE, new_figure
from capsbayes.show.words.rounding import two_digits, unit_of

SHOWN = ("surface_shear_modulus", "capsule_radius", "mean_velocity", "capillary_number", "size_ratio")
LEVELS = (0.68, 0.95)

_MOST_DRAWS = 20_000  # more make the picture no smoother
_BINS, _SMOOTHED = 36, 0.8  # of a quantity; bins over which the densities are smoothed
_PANEL, _GAP = 2.0, 0.1  # inches
_BELOW, _ABOVE = 1.05, 0.45  # inches, of the labels of the axes and of the titles


def corner_plot(posterior: Posterior, names: Sequence[str] = SHOWN) -> Figure:
    """Draw the corner plot.

    Contours hold 68 % and 95 % of the probability; dashed lines are the median
    and the equal-tailed 68 % interval, which the titles give in numbers. The
    paper's deterministic answer is marked if it is known. The label of each axes
    is the name of its quantity, or of the two of its pair, that on the y axis first.

    Parameters
    ----------
    posterior : Posterior
    names : sequence of str
        Quantities, as in `capsbayes.parameters`; those that the posterior lacks are omitted.
    """
    shown = [PARAMETERS[name] for name in names if name in posterior.draws]
    draws = [parameter.scale * np.ravel(posterior.draws[parameter.name]) for parameter in shown]
    draws = [values[:: max(1, len(values) // _MOST_DRAWS)] for values in draws]
    size = len(shown) * (_PANEL + _GAP) - _GAP + _BELOW + _ABOVE
    figure = new_figure(size, size, layout=None)
    places = figure.add_gridspec(
        len(shown),
        len(shown),
        left=_BELOW / size,
        bottom=_BELOW / size,
        right=1.0 - _ABOVE / size,
        top=1.0 - _ABOVE / size,
        wspace=_GAP / _PANEL,
        hspace=_GAP / _PANEL,
    )
    for row, first in enumerate(shown):
        for column, second in enumerate(shown[:row]):
            ax = figure.add_subplot(places[row, column], label=f"{first.name} {second.name}")
            _draw_pair(ax, draws[column], draws[row])
            _label_axes(ax, second, first, left=column == 0, bottom=row == len(shown) - 1)
        ax = figure.add_subplot(places[row, row], label=first.name)
        marginal = posterior.marginals[first.name]
        ends = marginal.lower_68, marginal.median, marginal.upper_68
        _draw_alone(ax, draws[row], [first.shown(end) for end in ends])
        _label_axes(ax, first, None, left=False, bottom=row == len(shown) - 1)
        ax.set_title(_title(first, marginal), fontsize=11)
    if posterior.deterministic is not None:
        _mark_deterministic(figure, posterior.deterministic.as_dict())
    return figure


def density_levels(density: Floats, shares: Sequence[float] = LEVELS) -> Floats:
    """Return the densities above which cells hold shares of the probability, the largest share first.

    Parameters
    ----------
    density : array
        Of equal cells; need not sum to one.
    shares : sequence of float
        Increasing, each between 0 and 1.
    """
    ordered = np.sort(density, axis=None)[::-1]
    held = np.cumsum(ordered) / ordered.sum()
    return np.asarray(ordered[np.searchsorted(held, shares)[::-1]])


def _draw_pair(ax: Axes, x: Floats, y: Floats) -> None:
    edges = [np.histogram_bin_edges(values, _BINS) for values in (x, y)]  # from the smallest draw to the largest
    density = gaussian_filter(np.histogram2d(x, y, bins=edges)[0], _SMOOTHED).T
    levels = np.unique([*density_levels(density), 1.001 * density.max()])
    # a contour ends at the frame where a limit of the model or of a prior cuts the density off
    middles = [0.5 * (of[1:] + of[:-1]) for of in edges]
    ax.contourf(*middles, density, levels, colors=[FILL, PALE])
    ax.contour(*middles, density, levels[:-1], colors=INK, linewidths=1.2)
    ax.set(xlim=edges[0][[0, -1]], ylim=edges[1][[0, -1]])


def _draw_alone(ax: Axes, values: Floats, lines: Sequence[float]) -> None:
    counts, edges = np.histogram(values, bins=_BINS)
    density = gaussian_filter(counts.astype(float), _SMOOTHED)
    ax.stairs(density, edges, color=INK, linewidth=1.5)
    ax.vlines(lines, 0.0, 1.0, transform=ax.get_xaxis_transform(), colors=INK, linestyles="dashed", linewidths=1.2)
    ax.set(xlim=edges[[0, -1]], ylim=(0.0, 1.08 * density.max()), yticks=[])


def _label_axes(ax: Axes, across: Parameter, up: Parameter | None, *, left: bool, bottom: bool) -> None:
    """Give axes few ticks, with numbers and labels at the left and the lower side of the whole figure only."""
    ax.xaxis.set_major_locator(MaxNLocator(4, prune="lower"))
    ax.tick_params("x", rotation=45, labelbottom=bottom)
    if bottom:
        ax.set_xlabel(across.axis_label, fontsize=12)
        ax.xaxis.set_label_coords(0.5, -0.34)
    if up is None:
        return
    ax.yaxis.set_major_locator(MaxNLocator(4, prune="lower"))
    ax.tick_params("y", rotation=45, labelleft=left)
    if left:
        ax.set_ylabel(up.axis_label, fontsize=12)
        ax.yaxis.set_label_coords(-0.34, 0.5)


def _mark_deterministic(figure: Figure, answer: Mapping[str, float]) -> None:
    for ax in figure.axes:
        match str(ax.get_label()).split():
            case [name]:
                line = ax.axvline(PARAMETERS[name].shown(answer[name]), color=ACCENT, linewidth=1.4)
            case [first, second]:
                x, y = PARAMETERS[second].shown(answer[second]), PARAMETERS[first].shown(answer[first])
                ax.plot(x, y, "D", color=ACCENT, markersize=5)
    words = "deterministic answer (diffuse approximation)"
    figure.legend([line], [words], loc="upper right", fontsize=12, frameon=False)


def _title(parameter: Parameter, marginal: Marginal) -> str:
    """Median and the distances to the ends of the 68 % interval, to two digits of the smaller."""
    middle, low, high = map(parameter.shown, (marginal.median, marginal.lower_68, marginal.upper_68))
    digits = two_digits(max(min(middle - low, high - middle), 1e-12 * abs(middle)))
    errors = f"_{{-{middle - low:.{digits}f}}}^{{+{high - middle:.{digits}f}}}"
    return f"${parameter.latex} = {middle:.{digits}f}{errors}${unit_of(parameter)}"
