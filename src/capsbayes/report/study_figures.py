"""Figures and page of a study: the residuals along the outline, the candidates, the trends of G_s, what is held out."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from capsbayes.arrays import Floats
from capsbayes.diagnosis import AlongOutline, Comparison, Finding, Study, Verification
from capsbayes.diagnosis.finding import TRENDS
from capsbayes.diagnosis.scores import REGIONS, region_displacements
from capsbayes.parameters import PARAMETERS
from capsbayes.profile import arc_share
from capsbayes.report import study as texts
from capsbayes.report import style
from capsbayes.report.page import page
from capsbayes.report.style import ACCENT, INK, PALE, WALL, closed, draw_walls, framed, new_figure, new_plot

_MODULUS, _VELOCITY, _SIZE = (PARAMETERS[name] for name in ("surface_shear_modulus", "capsule_velocity", "size_ratio"))
_OTHER = "#b8c4cb"  # candidates that are not in question
_WIDTH = 5.0  # inch: small enough for its letters to be read on a phone
_LOOKS: Any = {"before": {"color": ACCENT, "linestyle": "--"}, "after": {"color": INK, "linestyle": "-"}}
_COUNT = 3  # capsules that are shown one by one
_LABELS = {"nose": (0.76, -1.5), "flanks": (0.76, 1.5), "rear rim": (0.24, 1.5), "rear on the axis": (0.24, -1.5)}
"""Place of the name of each region: share of the picture's width, and y over l."""


def candidate_ratios(study: Study) -> Figure:
    """Draw the log-likelihood ratio of every candidate, those in question in a colour."""
    figure, ax = new_plot(_WIDTH, 0.9 + 0.32 * len(study.scores))
    ratios = [scores.log_likelihood_ratio for scores in study.scores.values()]
    names = [scores.effect.name for scores in study.scores.values()]
    bars = ax.barh(names, ratios, color=[INK if name in study.names else _OTHER for name in study.scores], height=0.65)
    ax.bar_label(bars, [f"{ratio:.1f}" for ratio in ratios], padding=4)
    ax.margins(x=0.2)
    ax.invert_yaxis()
    framed(ax).set_xlabel("log-likelihood ratio of the effect\nat its best size to no effect")
    return figure


def moduli(verification: Verification) -> Figure:
    """Draw G_s of each capsule with its error before and after an effect is added, and the medians."""
    figure, ax = new_plot(_WIDTH, 3.6)
    order = np.argsort(verification.comparisons[0].modulus)  # NaN last
    places = np.arange(1, len(order) + 1)
    styles = (("before", ACCENT, -0.14, "o", "white"), ("after", INK, 0.14, "s", INK))
    for compared, (when, colour, shift, marker, face) in zip(verification.comparisons, styles, strict=True):
        values, errors = (_MODULUS.scale * each[order] for each in (compared.modulus, compared.modulus_error))
        median = _MODULUS.shown(compared.median_modulus)
        look = {"fmt": marker, "color": colour, "markerfacecolor": face, "markersize": 5, "elinewidth": 1.0}
        label = f"{when}, median {median:.1f} {_MODULUS.shown_unit}"
        ax.axhline(median, color=colour, linewidth=1.0, linestyle="--")
        ax.errorbar(places + shift, values, errors, label=label, **look)  # type: ignore[arg-type]
    ax.set(xlabel="capsule, in the order of $G_\\mathrm{s}$ before", ylabel=_MODULUS.axis_label)
    ax.set_xlim(0.4, len(order) + 0.6)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.legend(frameon=False, loc="upper left")
    return figure


def misfits(compared: Comparison) -> Figure | None:
    """Draw the misfit of each capsule over its degrees of freedom at its best Ca and a/l; None if none is known."""
    ca, size, misfit = np.exp(compared.fits.theta[:, 0]), compared.fits.theta[:, 1], compared.misfit
    known, ill = np.isfinite(misfit), compared.fits.ill
    if not known.any():
        return None
    figure, ax = new_plot(_WIDTH, 3.6)
    largest = max(2.0, float(misfit[known].max()))
    colours: dict[str, Any] = {"c": misfit[known], "cmap": "RdBu_r", "norm": TwoSlopeNorm(1.0, 0.0, largest)}
    shown = ax.scatter(ca[known], size[known], s=60, edgecolors=INK, linewidths=0.6, **colours)
    ax.plot(ca[ill], size[ill], "x", color=INK, markersize=10)
    ax.set_xscale("log")
    style.plain_numbers(ax.xaxis)
    ax.set(xlabel=PARAMETERS["capillary_number"].axis_label, ylabel=_SIZE.axis_label)
    figure.colorbar(shown, ax=ax, label="misfit over degrees of freedom")
    return figure


def trends(compared: Comparison, finding: Finding) -> Figure:
    """Draw the apparent G_s of each capsule against velocity and size, with the slopes of the finding."""
    figure = new_figure(_WIDTH, 6.6)
    left, right = figure.subplots(2, 1, sharey=True)
    slopes = {deviation.name: deviation for deviation in finding.deviations}
    done = compared.fits.settled
    values, errors = (_MODULUS.scale * each[done] for each in (compared.modulus, compared.modulus_error))
    velocity, size = compared.session.circumstances["capsule_velocity"][done], compared.fits.size[done]
    bars = {"fmt": "o", "markersize": 4, "color": INK, "ecolor": PALE, "elinewidth": 1.0, "label": "capsules"}
    for ax, places, shown, trend, symbol in (
        (left, np.log(velocity), _VELOCITY.scale * velocity, "velocity", r"\ln v_\mathrm{o}"),
        (right, size, size, "size", r"(a/\ell)"),
    ):
        ax.errorbar(shown, values, errors, **bars)
        slope = slopes.get(TRENDS[trend])
        if slope is None:
            ax.set_title("too few values to see a trend", fontsize=10)
            continue
        ends = np.linspace(places.min(), places.max(), 50)
        centre, low, high = _MODULUS.scale * compared.trend_line(slope, places, ends)
        line = _VELOCITY.scale * np.exp(ends) if ax is left else ends
        ax.fill_between(line, low, high, color=ACCENT, alpha=0.2, linewidth=0)
        ax.plot(line, centre, color=ACCENT, linewidth=1.5, label="fitted slope ± standard error")
        fitted = f"{slope.size:+.2f} ± {slope.error:.2f} ({slope.sigma:+.1f} σ)"
        ax.set_title(rf"$d \ln G_\mathrm{{s}} / d {symbol}$ = {fitted}", fontsize=10)
        ax.legend(frameon=False)
    left.set(xlabel=_VELOCITY.axis_label, ylabel=f"apparent {_MODULUS.axis_label}")
    right.set(xlabel=_SIZE.axis_label, ylabel=f"apparent {_MODULUS.axis_label}")
    return figure


def outline_finding(along: AlongOutline, finding: Finding) -> Figure:
    """Draw the mean outline coloured by the mean residual in um and in standard errors, and unrolled; name regions."""
    figure = new_figure(10.0, 8.2)
    axes = figure.subplot_mosaic([["um", "sigma"], ["unrolled", "unrolled"]], height_ratios=(2.3, 1.0))
    micrometres = 1e6 * along.displacement
    _coloured(axes["um"], along.outline, micrometres, "mean residual [µm]")
    _coloured(axes["sigma"], along.outline, along.displacement / along.error, "mean residual [standard errors]")
    _name_regions(axes["um"], along.outline, finding)
    axes["um"].set_title("outside (red) or inside (blue) the prediction, in µm")
    axes["sigma"].set_title("the same over its standard error")
    _unroll(axes["unrolled"], along)
    return figure


def _coloured(ax: Axes, outline: Floats, values: Floats, label: str) -> None:
    ends = outline[:, 0].min() - 0.65, outline[:, 0].max() + 0.65
    draw_walls(ax, ends, 1.1, color="#e2e2e2")
    for side in (-1.0, 1.0):
        ax.plot(ends, [side, side], color=WALL, linewidth=1.0)
    following = np.roll(outline, -1, axis=0)
    largest = float(np.max(np.abs(values))) or 1.0
    segments, norm = list(np.stack([outline, following], axis=1)), Normalize(-largest, largest)
    lines = LineCollection(segments, cmap="RdBu_r", norm=norm, linewidths=7.0, capstyle="round")
    lines.set_array(0.5 * (values + np.roll(values, -1)))
    ax.plot(*closed(outline).T, color="#444444", linewidth=8.6, solid_joinstyle="round")
    ax.add_collection(lines)
    ax.set(xlim=ends, ylim=(-1.85, 1.85), aspect="equal", xlabel=r"$z/\ell$ (flow to the right)", ylabel=r"$y/\ell$")
    ax.set_yticks([-1.0, 0.0, 1.0])
    ax.figure.colorbar(lines, ax=ax, label=label, orientation="horizontal", shrink=0.75, aspect=30)


def _places(outline: Floats) -> dict[str, int]:
    """Middle vertex of each region, on the upper side."""
    upper = outline[:, 1] > -1e-3
    shapes = dict(zip(REGIONS, region_displacements(outline), strict=True))
    middles = {name: int(np.argmax(np.where(upper, shapes[name], 0.0))) for name in _LABELS}
    return middles | {"flanks": int(np.median(np.flatnonzero(upper & (shapes["flanks"] > 0.5))))}


def _name_regions(ax: Axes, outline: Floats, finding: Finding) -> None:
    words = {deviation.name: texts.deviation_words(deviation) for deviation in finding.deviations}
    look = {
        "arrowprops": {"arrowstyle": "-", "color": "#444444", "linewidth": 0.8},
        "bbox": {"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "#bbbbbb", "linewidth": 0.6},
    }
    for name, place in _places(outline).items():
        if name in words:
            share, height = _LABELS[name]
            at = ax.get_xlim()[0] + share * np.ptp(ax.get_xlim()), height
            said = words[name].replace(" (", "\n(")
            ax.annotate(f"{name}\n{said}", outline[place], at, ha="center", va="center", **look)  # type: ignore[arg-type]


def _unroll(ax: Axes, along: AlongOutline) -> None:
    share = np.append(arc_share(along.outline), 100.0)
    mean, error = (1e6 * np.append(values, values[0]) for values in (along.displacement, along.error))
    ax.axhline(0.0, color=WALL, linewidth=0.8)
    ax.fill_between(share, mean - error, mean + error, color=INK, alpha=0.25, linewidth=0, label="± standard error")
    ax.plot(share, mean, color=INK, label="mean over the capsules")
    for name, place in _places(along.outline).items():
        for at in {round(share[place], 3), round(100.0 - share[place], 3)}:
            ax.axvline(at, color="#bbbbbb", linewidth=0.8, linestyle=":")
            ax.text(at, 1.01, name, transform=ax.get_xaxis_transform(), ha="center", va="bottom")
    ax.set(xlim=(0.0, 100.0), xlabel="place along the edge from the nose [% of the perimeter]", ylabel="residual [µm]")
    ax.set_xticks([0, 25, 50, 75, 100])
    ax.legend(loc="upper center", frameon=False, ncols=2)
    ax.margins(y=0.15)


def chosen_capsules(verification: Verification) -> tuple[int, ...]:
    """Return the rows of a small, a middling and a large capsule with outlines and best shapes before and after."""
    before, after = verification.comparisons
    rows = np.array(sorted(set(before.edges) & set(after.edges)), dtype=int)
    if not len(rows):
        return ()
    by_size = rows[np.argsort(after.fits.size[rows])]
    places = np.linspace(0.1, 0.9, min(_COUNT, len(rows))) * (len(rows) - 1)
    return tuple(int(row) for row in by_size[np.unique(np.round(places).astype(int))])


def held_out(verification: Verification) -> Figure:
    """Draw the outlines of a few capsules, their normal distances, and the mean of the distances of all."""
    rows = chosen_capsules(verification)
    figure = new_figure(10.0, 8.6)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(2.3, 1.0))[:, 0]
    axes = above.subplots(2, len(rows), squeeze=False, sharey="row", height_ratios=(1.25, 1.0))
    for column, row in enumerate(rows):
        _predictions(axes[0, column], *verification.comparisons, row)
        _distances(axes[1, column], *verification.comparisons, row)
    axes[0, 0].set_ylabel(r"$y/\ell$")
    axes[1, 0].set_ylabel("residual [µm]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    band, name = axes[1, 0].get_legend_handles_labels()
    above.legend([*handles, *band[-1:]], [*labels, *name[-1:]], loc="outside lower center", ncols=4, frameon=False)
    _mean(below.subplots(), verification)
    return figure


def _mean(ax: Axes, verification: Verification) -> None:
    """Mean over all capsules, in which the noise is small."""
    ax.axhline(0.0, color=WALL, linewidth=0.8)
    for compared, (when, look) in zip(verification.comparisons, _LOOKS.items(), strict=True):
        along = compared.along_outline
        if along is not None:
            share = arc_share(along.outline)
            mean, error = 1e6 * along.displacement, 1e6 * along.error
            ax.fill_between(share, mean - error, mean + error, color=look["color"], alpha=0.2, linewidth=0)
            ax.plot(share, mean, label=f"{when}, mean of all capsules ± standard error", **look)
    ax.set(xlim=(0.0, 100.0), xlabel="from the nose [% of the perimeter]", ylabel="mean residual [µm]")
    ax.margins(y=0.25)
    ax.legend(frameon=False, ncols=2, loc="upper center")


def _predictions(ax: Axes, before: Comparison, after: Comparison, row: int) -> None:
    points = after.edges[row][0]
    former = _moved(before.outlines[row], before.edges[row][0], points)
    for outline, (when, look) in zip((former, after.outlines[row]), _LOOKS.items(), strict=True):
        ax.plot(*closed(outline).T, linewidth=1.3, label=f"predicted {when}", **look)
    ax.plot(*points.T, ".", color="#222222", markersize=3.5, label="measured edge")
    velocity = 1e3 * after.session.measurements[row].capsule_velocity
    ax.set_title(f"$a/\\ell$ = {after.fits.size[row]:.2f}, $v_\\mathrm{{o}}$ = {velocity:.2f} mm/s", fontsize=10)
    ax.set(aspect="equal", xlabel=r"$z/\ell$", ylim=(-1.05, 1.05), yticks=[-1.0, 0.0, 1.0])


def _distances(ax: Axes, before: Comparison, after: Comparison, row: int) -> None:
    width = 1e6 * after.session.mean("half_width")
    edge = after.session.measurements[row].outline
    assert edge is not None, "chosen for it"
    noise = width * edge.noise.scale
    ax.axhline(0.0, color=WALL, linewidth=0.8)
    for compared, look in zip((before, after), _LOOKS.values(), strict=True):
        feet = compared.edges[row][1]
        outline = compared.outlines[row]
        share = np.interp(feet.place, np.arange(len(outline) + 1), np.append(arc_share(outline), 100.0))
        order = np.argsort(share)
        ax.plot(share[order], width * feet.distance[order], linewidth=1.3, **look)
    ax.axhspan(-noise, noise, color="#dddddd", alpha=0.6, linewidth=0, zorder=0, label="± stated noise")
    ax.set(xlim=(0.0, 100.0), xlabel="from the nose [% of the perimeter]")


def _moved(outline: Floats, points: Floats, onto: Floats) -> Floats:
    """An outline moved as points (m, 2) are onto the same points of another place and tilt."""
    centre, other = points.mean(axis=0), onto.mean(axis=0)
    here, there = (points - centre) @ [1.0, 1j], (onto - other) @ [1.0, 1j]
    turn = np.vdot(here, there)
    turned = ((outline - centre) @ [1.0, 1j]) * turn / abs(turn)
    return np.stack([turned.real, turned.imag], axis=1) + other


def study_page(study: Study) -> str:
    """Return a study as a whole page in HTML, its pictures within it."""
    figures = (outline_finding, trends, misfits, candidate_ratios, held_out, moduli)
    drawn = {figure.__name__: figure for figure in figures}
    return page("study.html", study=study, texts=texts, chosen_capsules=chosen_capsules, **drawn)
