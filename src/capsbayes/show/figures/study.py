"""Figures of a study: the candidates, and the shear moduli against velocity, size and effect."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from capsbayes.diagnosis import Comparison, Finding, Study, Verification
from capsbayes.diagnosis.finding import TRENDS
from capsbayes.parameters import PARAMETERS
from capsbayes.show.figures.style import ACCENT, INK, PALE, framed, new_figure

_MODULUS, _VELOCITY, _SIZE = (PARAMETERS[name] for name in ("surface_shear_modulus", "capsule_velocity", "size_ratio"))
_OTHER = "#b8c4cb"  # candidates that are not in question


def candidate_ratios(study: Study) -> Figure:
    """Draw the log-likelihood ratio of every candidate, those in question in a colour."""
    figure = new_figure(10.0, 0.9 + 0.32 * len(study.scores))
    ax = figure.subplots()
    ratios = [scores.log_likelihood_ratio for scores in study.scores.values()]
    names = [scores.effect.name for scores in study.scores.values()]
    bars = ax.barh(names, ratios, color=[INK if name in study.names else _OTHER for name in study.scores], height=0.65)
    ax.bar_label(bars, [f"{ratio:.1f}" for ratio in ratios], padding=4, fontsize=9)
    ax.margins(x=0.08)
    ax.invert_yaxis()
    framed(ax).set_xlabel("log-likelihood ratio of the model with the effect, at its best size, to the model without")
    return figure


def moduli(verification: Verification) -> Figure:
    """Draw G_s of each held-out capsule with its error before and after an effect is added, and the medians."""
    figure = new_figure(10.0, 3.8)
    ax = figure.subplots()
    order = np.argsort(verification.comparisons[0].modulus)  # NaN last
    places = np.arange(1, len(order) + 1)
    styles = (("before", ACCENT, -0.14, "o", "white"), ("after", INK, 0.14, "s", INK))
    for compared, (when, colour, shift, marker, face) in zip(verification.comparisons, styles, strict=True):
        values, errors = (_MODULUS.scale * each[order] for each in (compared.modulus, compared.modulus_error))
        median = _MODULUS.shown(compared.median_modulus)
        style = {"fmt": marker, "color": colour, "markerfacecolor": face, "markersize": 5, "elinewidth": 1.0}
        label = f"{when}, median {median:.1f} {_MODULUS.shown_unit}"
        ax.axhline(median, color=colour, linewidth=1.0, linestyle="--")
        ax.errorbar(places + shift, values, errors, label=label, **style)  # type: ignore[arg-type]
    ax.set(xlabel="held-out capsule, in the order of $G_\\mathrm{s}$ before", ylabel=_MODULUS.axis_label)
    ax.set_xlim(0.4, len(order) + 0.6)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.legend(frameon=False, loc="upper left")
    return figure


def misfits(compared: Comparison) -> Figure:
    """Draw the misfit of each capsule over its degrees of freedom at its best Ca and a/l."""
    figure = new_figure(10.0, 3.8)
    ax = figure.subplots()
    ca, size, misfit = np.exp(compared.fits.theta[:, 0]), compared.fits.theta[:, 1], compared.misfit
    known, ill = np.isfinite(misfit), compared.fits.ill
    largest = max(2.0, float(misfit[known].max()))
    shown = ax.scatter(
        ca[known],
        size[known],
        c=misfit[known],
        cmap="RdBu_r",
        norm=TwoSlopeNorm(1.0, 0.0, largest),
        s=60,
        edgecolors=INK,
        linewidths=0.6,
    )
    ax.plot(ca[ill], size[ill], "x", color=INK, markersize=10)
    ax.set_xscale("log")
    ax.set(xlabel=PARAMETERS["capillary_number"].axis_label, ylabel=_SIZE.axis_label)
    figure.colorbar(shown, ax=ax, label="misfit over degrees of freedom")
    return figure


def trends(compared: Comparison, finding: Finding) -> Figure:
    """Draw the apparent G_s of each capsule against velocity and size: that of a right model depends on neither.

    The slopes are those of the finding.
    """
    figure = new_figure(10.0, 3.8)
    left, right = figure.subplots(1, 2, sharey=True)
    slopes = {deviation.name: deviation for deviation in finding.deviations}
    done = compared.fits.settled
    values, errors = (_MODULUS.scale * each[done] for each in (compared.modulus, compared.modulus_error))
    velocity, size = compared.session.circumstances["capsule_velocity"][done], compared.fits.size[done]
    for ax, places, shown, trend, symbol in (
        (left, np.log(velocity), _VELOCITY.scale * velocity, "velocity", r"\ln v_\mathrm{o}"),
        (right, size, size, "size", r"(a/\ell)"),
    ):
        ax.errorbar(
            shown, values, errors, fmt="o", markersize=4, color=INK, ecolor=PALE, elinewidth=1.0, label="capsules"
        )
        slope = slopes.get(TRENDS[trend])
        if slope is None:
            ax.set_title("too few values to see a trend", fontsize=10)
            continue
        ends = np.linspace(places.min(), places.max(), 50)
        centre, low, high = _MODULUS.scale * compared.trend_line(slope, places, ends)
        line = _VELOCITY.scale * np.exp(ends) if ax is left else ends
        ax.fill_between(line, low, high, color=ACCENT, alpha=0.2, linewidth=0)
        ax.plot(line, centre, color=ACCENT, linewidth=1.5, label="fitted slope ± standard error")
        ax.set_title(
            rf"$d \ln G_\mathrm{{s}} / d {symbol}$ = {slope.size:+.2f} ± {slope.error:.2f} ({slope.sigma:+.1f} σ)",
            fontsize=10,
        )
        ax.legend(frameon=False, fontsize=9)
    left.set(xlabel=_VELOCITY.axis_label, ylabel=f"apparent {_MODULUS.axis_label}")
    right.set(xlabel=_SIZE.axis_label)
    return figure
