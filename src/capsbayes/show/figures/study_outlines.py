"""Figures of the outlines of a study: the mean residual along the outline, and held-out capsules one by one."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from capsbayes.arrays import Floats
from capsbayes.diagnosis import AlongOutline, Comparison, Finding, Verification
from capsbayes.diagnosis.scores import REGIONS, region_displacements
from capsbayes.profile import arc_share
from capsbayes.show.figures.style import ACCENT, INK, WALL, closed, draw_walls, new_figure
from capsbayes.show.words.study import deviation_words

_SEEN = "#222222"
_COUNT = 3  # capsules that are shown one by one
_COLOURS = "RdBu_r"
_LABELS = {"nose": (0.76, -1.5), "flanks": (0.76, 1.5), "rear rim": (0.24, 1.5), "rear on the axis": (0.24, -1.5)}
"""Place of the name of each region: share of the picture's width, and y over l."""
_SHARE_TICKS = (0, 25, 50, 75, 100)


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
    lines = LineCollection(
        list(np.stack([outline, following], axis=1)),
        cmap=_COLOURS,
        norm=Normalize(-largest, largest),
        linewidths=7.0,
        capstyle="round",
    )
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
    words = {deviation.name: deviation_words(deviation) for deviation in finding.deviations}
    style = {
        "arrowprops": {"arrowstyle": "-", "color": "#444444", "linewidth": 0.8},
        "bbox": {"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "#bbbbbb", "linewidth": 0.6},
    }
    for name, place in _places(outline).items():
        if name in words:
            share, height = _LABELS[name]
            at = ax.get_xlim()[0] + share * np.ptp(ax.get_xlim()), height
            ax.annotate(f"{name}\n{words[name]}", outline[place], at, fontsize=8.5, ha="center", va="center", **style)  # type: ignore[arg-type]


def _unroll(ax: Axes, along: AlongOutline) -> None:
    share = np.append(arc_share(along.outline), 100.0)
    mean, error = (1e6 * np.append(values, values[0]) for values in (along.displacement, along.error))
    ax.axhline(0.0, color=WALL, linewidth=0.8)
    ax.fill_between(share, mean - error, mean + error, color=INK, alpha=0.25, linewidth=0, label="± standard error")
    ax.plot(share, mean, color=INK, label="mean over the capsules")
    for name, place in _places(along.outline).items():
        for at in {round(share[place], 3), round(100.0 - share[place], 3)}:
            ax.axvline(at, color="#bbbbbb", linewidth=0.8, linestyle=":")
            ax.text(at, 1.01, name, transform=ax.get_xaxis_transform(), ha="center", va="bottom", fontsize=9)
    ax.set(xlim=(0.0, 100.0), xlabel="place along the edge from the nose [% of the perimeter]", ylabel="residual [µm]")
    ax.set_xticks(_SHARE_TICKS)
    ax.legend(loc="upper center", frameon=False, fontsize=9, ncols=2)
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
    """Draw the outlines of a few held-out capsules, their normal distances, and the mean of the distances of all."""
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
    """Mean over all held-out capsules, in which the noise is small."""
    ax.axhline(0.0, color=WALL, linewidth=0.8)
    for compared, colour, style, when in zip(
        verification.comparisons, (ACCENT, INK), ("--", "-"), ("before", "after"), strict=True
    ):
        along = compared.along_outline
        if along is not None:
            share = arc_share(along.outline)
            mean, error = 1e6 * along.displacement, 1e6 * along.error
            ax.fill_between(share, mean - error, mean + error, color=colour, alpha=0.2, linewidth=0)
            ax.plot(share, mean, style, color=colour, label=f"{when}, mean of all held-out capsules ± standard error")
    ax.set(xlim=(0.0, 100.0), xlabel="from the nose [% of the perimeter]", ylabel="mean residual [µm]")
    ax.margins(y=0.25)
    ax.legend(frameon=False, ncols=2, fontsize=9, loc="upper center")


def _predictions(ax: Axes, before: Comparison, after: Comparison, row: int) -> None:
    points = after.edges[row][0]
    former = _moved(before.outlines[row], before.edges[row][0], points)
    for outline, colour, style, label in (
        (former, ACCENT, "--", "predicted before"),
        (after.outlines[row], INK, "-", "predicted after"),
    ):
        ax.plot(*closed(outline).T, style, color=colour, linewidth=1.3, label=label)
    ax.plot(*points.T, ".", color=_SEEN, markersize=3.5, label="measured edge")
    velocity = 1e3 * after.session.measurements[row].capsule_velocity
    ax.set_title(f"$a/\\ell$ = {after.fits.size[row]:.2f}, $v_\\mathrm{{o}}$ = {velocity:.2f} mm/s", fontsize=10)
    ax.set(aspect="equal", xlabel=r"$z/\ell$", ylim=(-1.05, 1.05), yticks=[-1.0, 0.0, 1.0])


def _distances(ax: Axes, before: Comparison, after: Comparison, row: int) -> None:
    width = 1e6 * after.session.mean("half_width")
    edge = after.session.measurements[row].outline
    assert edge is not None, "chosen for it"
    noise = width * edge.noise.scale
    ax.axhline(0.0, color=WALL, linewidth=0.8)
    for compared, colour, style in ((before, ACCENT, "--"), (after, INK, "-")):
        feet = compared.edges[row][1]
        outline = compared.outlines[row]
        share = np.interp(feet.place, np.arange(len(outline) + 1), np.append(arc_share(outline), 100.0))
        order = np.argsort(share)
        ax.plot(share[order], width * feet.distance[order], style, color=colour, linewidth=1.3)
    ax.axhspan(-noise, noise, color="#dddddd", alpha=0.6, linewidth=0, zorder=0, label="± stated noise")
    ax.set(xlim=(0.0, 100.0), xlabel="from the nose [% of the perimeter]")


def _moved(outline: Floats, points: Floats, onto: Floats) -> Floats:
    """An outline moved as points (m, 2) are onto the same points of another place and tilt."""
    centre, other = points.mean(axis=0), onto.mean(axis=0)
    here, there = (points - centre) @ [1.0, 1j], (onto - other) @ [1.0, 1j]
    turn = np.vdot(here, there)
    turned = ((outline - centre) @ [1.0, 1j]) * turn / abs(turn)
    return np.stack([turned.real, turned.imag], axis=1) + other
