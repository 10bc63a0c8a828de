"""Figures and page of one capsule: corner plot, outline in the channel, and outline over the picture."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter1d

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.files.input_file import PICTURES
from capsbayes.image.detect import Detection
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect
from capsbayes.image.overlay import overlay, png, png_of
from capsbayes.infer import Marginal, Posterior
from capsbayes.infer.outline import aligned_with, band
from capsbayes.infer.posterior import Resimulation
from capsbayes.infer.tension import membrane_tension
from capsbayes.measurement import MID_PLANE, SILHOUETTE, Measurement
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import ERRING
from capsbayes.report import posterior as texts
from capsbayes.report import style
from capsbayes.report.numbers import two_digits, unit_of, value_words
from capsbayes.report.page import image, page, picture
from capsbayes.report.style import ACCENT, FILL, INK, PALE, WALL, closed, draw_walls, framed, new_figure, new_plot

SHOWN = ("surface_shear_modulus", "capsule_radius", "mean_velocity", "capillary_number", "size_ratio")

_MOST_DRAWS = 20_000  # more make the corner plot no smoother
_CORNER = {
    "bins": 36,
    "smooth": 0.8,
    "smooth1d": 0.8,
    "color": INK,
    "levels": (0.68, 0.95),
    "plot_datapoints": False,
    "no_fill_contours": True,
    "fill_contours": True,
    "contourf_kwargs": {"colors": ["white", FILL, PALE]},
    "label_kwargs": {"fontsize": 12},
    "labelpad": 0.04,
    "max_n_ticks": 4,
    "quiet": True,
}
_THICKNESS = 0.14  # of the walls, over l
_DIMENSION_LINE = 1.36  # height of the arrow of L_z, over l
_TOP = 1.8  # of the picture of the outline, over l
_OVERLAY = "overlay.png"  # as capsbayes measure and identify name it
_WIDEST = 1200  # px, of a picture
_LINES = ("-", "--", ":", "-.")  # of capsules next to each other, whose colours differ too
_WIDTH = 5.0  # inch: small enough for its letters to be read on a phone


def corner_plot(posterior: Posterior, names: Sequence[str] = SHOWN) -> Figure:
    """Draw every pair of quantities with 68 % and 95 % contours, and each alone with median and 68 % interval."""
    # The published procedure's answer is marked if it is known; quantities that the posterior lacks are omitted. The
    # label of each axes is the name of its quantity, or of the two of its pair, that on the y axis first.
    import corner  # it imports arviz, a second

    shown = [PARAMETERS[name] for name in names if name in posterior.draws]
    draws = np.stack([parameter.scale * np.ravel(posterior.draws[parameter.name]) for parameter in shown], axis=1)
    draws = draws[:: max(1, len(draws) // _MOST_DRAWS)]
    lows, highs = draws.min(axis=0), draws.max(axis=0)
    margins = np.where(lows < highs, 0.0, 0.5)  # of a quantity without spread
    ends = list(zip(lows - margins, highs + margins, strict=True))
    answer = posterior.deterministic and posterior.deterministic.as_dict()
    figure = new_figure(2.1 * len(shown) + 1.3, 2.1 * len(shown) + 1.3, layout=None)
    corner.corner(draws, fig=figure, range=ends, labels=[parameter.axis_label for parameter in shown], **_CORNER)
    for place, ax in enumerate(figure.axes):
        row, column = divmod(place, len(shown))
        up, across = shown[row], shown[column]
        if column > row:
            ax.remove()
        elif column < row:
            ax.set_label(f"{up.name} {across.name}")
            if answer:
                ax.plot(across.shown(answer[across.name]), up.shown(answer[up.name]), "D", color=ACCENT, markersize=5)
        else:
            ax.set_label(up.name)
            marginal = posterior.marginals[up.name]
            ax.set_title(_title(up, marginal), fontsize=11)
            lines = [up.shown(end) for end in (marginal.lower_68, marginal.median, marginal.upper_68)]
            ax.vlines(lines, 0.0, 1.0, transform=ax.get_xaxis_transform(), colors=INK, linestyles="dashed")
            if answer:
                line = ax.axvline(up.shown(answer[up.name]), color=ACCENT, linewidth=1.4)
    if answer:
        words = "published procedure (Quesada et al. 2021)"
        figure.legend([line], [words], loc="upper right", fontsize=12, frameon=False)
    return figure


def corner_of_few(posterior: Posterior) -> Figure:
    """Draw the corner plot of at most five: G_s, a, further coordinates, then the others."""
    names = (*SHOWN[:2], *posterior.prior.uncertain, *SHOWN[2:])
    return corner_plot(posterior, [name for name in names if name in posterior.draws][: len(SHOWN)])


def corner_of_all(posterior: Posterior) -> Figure:
    """Draw the corner plot with all further coordinates too."""
    return corner_plot(posterior, (*SHOWN, *posterior.prior.uncertain))


def density_figure(posterior: Posterior, name: str, *, width: float = 3.6) -> Figure:
    """Draw the density of a quantity with its median, and its 68 and 95 % intervals shaded."""
    parameter, marginal = PARAMETERS[name], posterior.marginals[name]
    places, heights = _density(posterior, name)
    figure, ax = new_plot(width, 0.45 * width)
    framed(ax)
    for level, colour in ((95, FILL), (68, PALE)):
        low, high = map(parameter.shown, marginal.ends(level))
        fine = np.linspace(low, high, 200)
        ax.fill_between(fine, np.interp(fine, places, heights), color=colour, linewidth=0, label=f"{level} %")
    ax.plot(places, heights, color=INK, linewidth=1.4)
    ax.axvline(parameter.shown(marginal.median), color=INK, linestyle="dashed", linewidth=1.0, label="median")
    ax.set(xlabel=parameter.axis_label, yticks=[], ylim=(0.0, None))
    ax.legend(frameon=False, fontsize=8, loc="upper right", handlelength=1.2)
    return figure


def densities_figure(posteriors: Mapping[str, Posterior], name: str, *, width: float = 4.0) -> Figure:
    """Draw the densities of a quantity of several capsules, by their names, each as high as the others."""
    figure, ax = new_plot(width, 0.5 * width)
    for number, (capsule, posterior) in enumerate(posteriors.items()):
        places, heights = _density(posterior, name)
        ax.plot(places, heights / heights.max(), _LINES[number % len(_LINES)], linewidth=1.4, label=capsule)
    framed(ax).set(xlabel=PARAMETERS[name].axis_label, yticks=[], ylim=(0.0, None))
    style.legend_below(figure, ax, 2, fontsize=8)
    return figure


def _density(posterior: Posterior, name: str) -> tuple[Floats, Floats]:
    """Return places in the display unit, and the smoothed density of a quantity there."""
    draws = PARAMETERS[name].scale * np.ravel(posterior.draws[name])
    heights, edges = np.histogram(draws, bins=80, density=True)
    return 0.5 * (edges[1:] + edges[:-1]), gaussian_filter1d(heights, 2.0)


def _title(parameter: Parameter, marginal: Marginal) -> str:
    """Median and the distances to the ends of the 68 % interval, to two digits of the smaller."""
    middle, low, high = map(parameter.shown, (marginal.median, marginal.lower_68, marginal.upper_68))
    digits = two_digits(max(min(middle - low, high - middle), 1e-12 * abs(middle)))
    errors = f"_{{-{middle - low:.{digits}f}}}^{{+{high - middle:.{digits}f}}}"
    return f"${parameter.latex} = {middle:.{digits}f}{errors}${unit_of(parameter)}"


def outline_figure(posterior: Posterior, *, width: float = _WIDTH) -> Figure:
    """Draw `outline_plot` alone on a figure of a width [inch]."""
    figure, ax = new_plot(width, 1.06 * width)
    outline_plot(posterior, ax)
    return figure


def outline_plot(posterior: Posterior, ax: Axes) -> Axes:
    """Draw the mean predicted outline between the walls with its 95 % band along the normal, all over l."""
    # The points of a measured outline are shifted and turned onto it. The measured lengths are arrows that start at the
    # predicted nose; their ends are shaded over two standard errors either side.
    if posterior.outlines is None:
        raise InputError("outline_plot", "posterior", "a posterior with outlines", f"none from {posterior.model_name}")
    middle, inner, outer = band(posterior.outlines)
    nose = float(middle[:, 0].max())
    ends = (float(middle[:, 0].min()) - 0.55, nose + 0.55)
    draw_walls(ax, ends, 1.0 + _THICKNESS, color=None, facecolor="#e6e6e6", edgecolor=WALL, hatch="////")
    for side in (-1.0, 1.0):
        ax.plot(ends, [side, side], color="#555555", linewidth=1.2)
    seen = posterior.measurement.outline
    shown = "outline" if seen is None or seen.view == MID_PLANE else seen.view
    ax.plot(*closed(middle).T, color=INK, linewidth=1.6, label=f"predicted {shown}", zorder=3)
    ax.fill(*closed(outer).T, color=PALE, linewidth=0, label="95 % of the posterior", zorder=2)
    ax.fill(*closed(inner).T, color="#f3f8fb", linewidth=0, zorder=2.1)
    if seen is not None:
        measured, _ = aligned_with(seen.points, middle)
        ax.plot(*measured.T, ".", color=ACCENT, markersize=2.0, label="measured outline", zorder=4)
    _draw_lengths(ax, posterior, nose, hidden=shown == SILHOUETTE)
    _label_outline(ax, posterior, ends)
    return ax


def _draw_lengths(ax: Axes, posterior: Posterior, nose: float, *, hidden: bool) -> None:
    """Arrows of the measured lengths; the rear on the axis is marked where the view hides it."""
    measured = posterior.measurement
    scale = 1.0 if measured.over_half_width else posterior.inputs.half_width.value
    lines = [("z", measured.axial_extent, measured.axial_extent_error, _DIMENSION_LINE)]
    if measured.axial_length is not None and measured.axial_length_error is not None:
        lines.append(("a", measured.axial_length, measured.axial_length_error, 0.0))
    arrow = {"arrowstyle": "<|-|>", "color": ACCENT, "linewidth": 1.3, "shrinkA": 0, "shrinkB": 0}
    for symbol, length, error, height in lines:
        length, error = length / scale, error / scale
        rear, ends = nose - length, [height - 0.09, height + 0.09]
        ax.annotate("", (rear, height), (nose, height), arrowprops=arrow, zorder=5)
        label = "measured, ±2 standard errors" if height else None
        sides = rear - 2 * error, rear + 2 * error
        ax.fill_betweenx(ends, *sides, color=ACCENT, alpha=0.3, linewidth=0, zorder=4, label=label)
        text = rf"$L_{symbol}/\ell = {length:.3f} \pm {error:.3f}$"
        middle = nose - 0.5 * length, height + 0.05
        ax.text(*middle, text, color=ACCENT, ha="center", va="bottom", fontsize=11, zorder=6)
        if hidden and not height:
            ax.plot([rear, rear], [-0.2, 0.2], color=ACCENT, linewidth=1.3, zorder=5)
            ax.text(rear, -0.24, "rear on the axis", color=ACCENT, va="top", zorder=6)
    for z, low in ((nose, 0.0), (nose - measured.axial_extent / scale, -0.2)):
        ax.plot([z, z], [low, _DIMENSION_LINE + 0.06], ":", color=ACCENT, linewidth=1.0, zorder=1.5)


def _label_outline(ax: Axes, posterior: Posterior, ends: tuple[float, float]) -> None:
    """Label the axes and say the direction of the flow and the medians."""
    micrometres = 1e6 * posterior.inputs.half_width.value
    flow: dict[str, Any] = {"va": "center", "ha": "right", "color": "#555555"}
    arrow = {"arrowstyle": "-|>", "color": "#555555"}
    ax.annotate("flow", (ends[1] - 0.1, -0.72), (ends[1] - 0.5, -0.72), arrowprops=arrow, **flow)
    ax.set(xlim=ends, ylim=(-1.0 - _THICKNESS, _TOP), aspect="equal", xlabel=r"$z/\ell$", ylabel=r"$y/\ell$")
    ax.set_yticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    style.second_scale(ax, micrometres).set_xlabel(rf"$z$ [µm], for $\ell$ = {micrometres:.3g} µm")
    framed(ax, ("right",))
    ca, size = posterior.marginals["capillary_number"], posterior.marginals["size_ratio"]
    text = rf"medians: $\mathrm{{Ca}} = {ca.median:.4f}$, $a/\ell = {size.median:.3f}$"
    ax.text(ends[0] + 0.05, _TOP - 0.05, text, va="top")
    look: dict[str, Any] = {"ncols": 2, "columnspacing": 1.0, "handlelength": 1.2, "frameon": False}
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), **look)


def resimulation_figure(seen: Resimulation, *, width: float = 7.4) -> Figure:
    """Draw what simulated shapes differ by from the predicted ones: along the outline, and in three numbers."""
    figure = new_figure(width, 0.5 * width)
    along, numbers = figure.subplots(1, 2, width_ratios=(2.2, 1.0), sharey=True)
    share = np.linspace(0.0, 1.0, seen.outlines.shape[1] + 1)
    off, stated = (1e3 * np.hstack([each, each[:, :1]]) for each in (seen.outlines, seen.outlines_stated))
    error = np.sqrt(np.mean(np.square(stated), axis=0))
    along.fill_between(share, -error, error, color=FILL, linewidth=0, label="standard error that the model states")
    each = along.plot(share, off.T, color=PALE, linewidth=0.6)
    each[0].set_label("each shape")
    along.plot(share, off.mean(axis=0), color=ACCENT, linewidth=1.6, label="mean")
    along.set(xlim=(0.0, 1.0), xlabel="round the outline", ylabel=r"simulated − predicted [0.001 $\ell$]")
    along.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["nose", "side", "rear", "side", "nose"])
    for place, (column, errors) in enumerate(zip(seen.differences.T, seen.stated.T, strict=True)):
        reach = 1e3 * float(np.sqrt(np.mean(np.square(errors))))
        numbers.fill_between([place - 0.4, place + 0.4], -reach, reach, color=FILL, linewidth=0)
        numbers.plot(place + np.linspace(-0.25, 0.25, len(column)), 1e3 * column, ".", color=INK, markersize=4)
        numbers.hlines(1e3 * column.mean(), place - 0.4, place + 0.4, colors=ACCENT, linewidth=1.6)
    numbers.set_xticks(range(len(ERRING)), [f"${style.without_l(name)}$" for name in ERRING])
    for ax in (framed(along), framed(numbers)):
        ax.axhline(0.0, color=WALL, linewidth=0.8, zorder=0.5)
    style.legend_below(figure, along, 3)
    return figure


def on_picture(outline: Floats, detection: Detection) -> Floats:
    """Lay an outline (z, y) on a capsule found in a picture, nose on nose, z along the flow : (p, 2) [l] to [px]."""
    walls, nose = detection.located()[0], detection.nose
    assert nose is not None, "of a capsule that was measured"
    downstream = (detection.flow or 1) * walls.along
    behind = outline[:, 0] - outline[:, 0].max()
    tip = detection.axis + nose.distance * downstream
    return np.asarray(tip + walls.half_width * (behind[:, None] * downstream + outline[:, 1:] * walls.across))


def posterior_page(posterior: Posterior, *, capsule: str | Path | None = None, folder: Path | None = None) -> str:
    """Return a posterior as a whole page in HTML, with the pictures of `capsule_pictures` within it."""
    source = posterior.measurement.source
    return page(
        "posterior.html",
        posterior=posterior,
        texts=texts,
        name=Path(source).name if source else "without a name",
        headlines=[value_words(name, posterior.marginals[name]) for name in SHOWN if name in posterior.marginals],
        pictures=list(capsule_pictures(posterior, capsule, folder)),
        corner=corner_of_few(posterior),
        tension=membrane_tension(posterior),
        resimulated=None if posterior.resimulation is None else resimulation_figure(posterior.resimulation),
    )


def capsule_pictures(
    posterior: Posterior, capsule: str | Path | None = None, folder: Path | None = None
) -> Iterator[Markup]:
    """Yield the pictures of a capsule; the folder is that of the ``overlay.png`` of its measurement."""
    known, measured = _measured_in(posterior) if capsule is None else Path(capsule), posterior.measurement
    predicted = None if posterior.outlines is None else band(posterior.outlines)[0]
    what = "picture of the capsule with what was found in it"
    # in a picture with stated walls, others would be found
    seen, name = (None, "") if known is None or measured.walls else (Picture.read(known), known.name)
    given, camera = capsule is not None, posterior.experiment.camera
    found = None if seen is None else detect(seen, camera=camera)
    if seen is not None and found is not None and found.status.ok and (given or _as_measured(found, measured)):
        laid = None if predicted is None else on_picture(predicted, found)
        drawn = png(overlay(seen, found, posterior.inputs.half_width.value, laid), widest=_WIDEST)
        caption = ": the measured edge" + ", and the predicted outline laid nose on nose" * (laid is not None)
        yield image(drawn, "png", what, f"{name}{caption}.")
    elif seen is not None and given:
        caption = f"{name}: no single capsule between two walls was found in it again."
        yield image(png_of(seen, widest=_WIDEST), "png", "picture of the capsule", caption)
    else:
        places = (folder, Path(measured.source).parent if measured.source else None)
        for place in [place for place in places if place is not None and (place / _OVERLAY).is_file()][:1]:
            caption = "What was found in the picture."
            caption += " Dashed walls and a dotted axis were stated by hand." * bool(measured.walls)
            yield image((place / _OVERLAY).read_bytes(), "png", what, caption)
    if predicted is not None:
        caption = "Predicted outline with its 95 % band between the walls of the channel, and the measured lengths."
        yield picture(outline_figure(posterior), "predicted outline and measured lengths in the channel", caption)


def _as_measured(detection: Detection, measured: Measurement) -> bool:
    """Return whether the measured length was found again, without what was stated of the picture then."""
    extent, _, _, half_width = detection.lengths
    return bool(abs(extent / half_width - measured.axial_extent) < 2.0 * measured.axial_extent_error)


def _measured_in(posterior: Posterior) -> Path | None:
    """The picture that the capsule was measured in, if it is still there unchanged."""
    source = Path(posterior.measurement.source)
    if source.suffix.lower() not in PICTURES or not source.is_file():
        return None
    same = hashlib.sha256(source.read_bytes()).hexdigest() == posterior.measurement.sha256
    return source if same else None
