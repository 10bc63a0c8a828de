"""Measured and predicted outlines of a few held-out capsules before and after an effect is added."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capsbayes.diagnosis import Comparison, Verification
from capsbayes.show.study_outline import arc_share

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["chosen_capsules", "held_out"]

Floats = NDArray[np.float64]

_BEFORE, _AFTER, _SEEN = "#c8552b", "#1f5a7a", "#222222"
_COUNT = 3


def chosen_capsules(verification: Verification) -> tuple[int, ...]:
    """Rows of a small, a middling and a large capsule that have outlines and best shapes before and after."""
    before, after = verification.comparisons
    rows = np.array(sorted(set(before.edges) & set(after.edges)), dtype=int)
    if not len(rows):
        return ()
    by_size = rows[np.argsort(after.fits.size[rows])]
    places = np.linspace(0.1, 0.9, min(_COUNT, len(rows))) * (len(rows) - 1)
    return tuple(int(row) for row in by_size[np.unique(np.round(places).astype(int))])


def held_out(verification: Verification) -> Figure:
    """Draw the outlines of a few, their normal distances, and the mean of the distances of all.

    Parameters
    ----------
    verification : Verification
        Of capsules with outlines.

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure

    rows = chosen_capsules(verification)
    figure = Figure(figsize=(10.0, 8.6), layout="constrained")
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(2.3, 1.0))[:, 0]
    axes = above.subplots(2, len(rows), squeeze=False, sharey="row", height_ratios=(1.25, 1.0))
    for column, row in enumerate(rows):
        _outlines(axes[0, column], *verification.comparisons, row)
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
    ax.axhline(0.0, color="#9a9a9a", linewidth=0.8)
    for compared, colour, style, when in zip(
        verification.comparisons, (_BEFORE, _AFTER), ("--", "-"), ("before", "after"), strict=True
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


def _outlines(ax: Axes, before: Comparison, after: Comparison, row: int) -> None:
    points = after.edges[row][0]
    former = _moved(before.outlines[row], before.edges[row][0], points)
    for outline, colour, style, label in (
        (former, _BEFORE, "--", "predicted before"),
        (after.outlines[row], _AFTER, "-", "predicted after"),
    ):
        ax.plot(*np.vstack([outline, outline[:1]]).T, style, color=colour, linewidth=1.3, label=label)
    ax.plot(*points.T, ".", color=_SEEN, markersize=3.5, label="measured edge")
    velocity = 1e3 * after.session.measurements[row].capsule_velocity
    ax.set_title(f"$a/\\ell$ = {after.fits.size[row]:.2f}, $v_\\mathrm{{o}}$ = {velocity:.2f} mm/s", fontsize=10)
    ax.set(aspect="equal", xlabel=r"$z/\ell$", ylim=(-1.05, 1.05), yticks=[-1.0, 0.0, 1.0])


def _distances(ax: Axes, before: Comparison, after: Comparison, row: int) -> None:
    width = 1e6 * after.session.mean("half_width")
    edge = after.session.measurements[row].outline
    assert edge is not None, "chosen for it"
    noise = width * edge.noise.scale
    ax.axhline(0.0, color="#9a9a9a", linewidth=0.8)
    for compared, colour, style in ((before, _BEFORE, "--"), (after, _AFTER, "-")):
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
