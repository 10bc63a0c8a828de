"""Corner plot of a posterior: every pair of quantities, and each alone.

The capsule in its channel: predicted outline with its band, and the lengths that were measured.

The picture of a capsule with the outline over it that its posterior predicts.

The page of one capsule's posterior.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import gaussian_filter

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.files.input_file import PICTURES
from capsbayes.infer import Marginal, Posterior
from capsbayes.infer.outline import aligned_with, band
from capsbayes.measurement import MID_PLANE
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.report import posterior as texts
from capsbayes.report.numbers import two_digits, unit_of, value_words
from capsbayes.report.page import image, page, picture
from capsbayes.report.style import ACCENT, FILL, INK, PALE, WALL, closed, draw_walls, framed, new_figure
from capsbayes.report.tables import html_table, typeset

if TYPE_CHECKING:
    from capsbayes.image.detect import Detection


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


_INSIDE = "#f3f8fb"
_THICKNESS = 0.14
_DIMENSION_LINE = 1.36  # height of the arrow of L_z, over l
_TOP = 1.8  # of the picture, over l


def outline_figure(posterior: Posterior, *, width: float = 7.4) -> Figure:
    """Draw `outline_plot` alone on a figure of a width [inch] that fits it."""
    left, right, bottom, top = 0.75, 0.2, 1.0, 0.7
    figure = new_figure(width, width, layout=None)
    ax = outline_plot(posterior, figure.add_axes((0.1, 0.1, 0.8, 0.8)))
    (z_low, z_high), (y_low, y_high) = ax.get_xlim(), ax.get_ylim()
    wide = width - left - right
    high = wide * (y_high - y_low) / (z_high - z_low)
    height = high + bottom + top
    figure.set_size_inches(width, height)
    ax.set_position((left / width, bottom / height, wide / width, high / height))
    return figure


def outline_plot(posterior: Posterior, ax: Axes) -> Axes:
    """Draw the predicted outline between the walls, lengths over l, with a scale in micrometres.

    The line is the mean outline, the band holds 95 % of the posterior along
    the normal. The points of a measured outline are shifted and turned onto
    it. The measured lengths are arrows that start at the predicted
    nose; their ends are shaded over two standard errors either side.

    Raises
    ------
    InputError
        If the model predicts no outlines.
    """
    if posterior.outlines is None:
        raise InputError("outline_plot", "posterior", "a posterior with outlines", f"none from {posterior.model_name}")
    middle, inner, outer = band(posterior.outlines)
    nose = float(middle[:, 0].max())
    ends = (float(middle[:, 0].min()) - 0.55, nose + 0.55)
    draw_walls(ax, ends, 1.0 + _THICKNESS, color=None, facecolor="#e6e6e6", edgecolor=WALL, hatch="////")
    for side in (-1.0, 1.0):
        ax.plot(ends, [side, side], color="#555555", linewidth=1.2)
    ax.fill(*closed(outer).T, color=PALE, linewidth=0, label="95 % of the posterior", zorder=2)
    ax.fill(*closed(inner).T, color=_INSIDE, linewidth=0, zorder=2.1)
    seen = posterior.measurement.outline
    shown = "outline" if seen is None or seen.view == MID_PLANE else seen.view
    ax.plot(*closed(middle).T, color=INK, linewidth=1.6, label=f"predicted {shown}", zorder=3)
    if seen is not None:
        measured, _ = aligned_with(seen.points, middle)
        ax.plot(*measured.T, ".", color=ACCENT, markersize=2.0, label="measured outline", zorder=4)
    _draw_lengths(ax, posterior, nose)
    _finish(ax, posterior, ends)
    return ax


def _draw_lengths(ax: Axes, posterior: Posterior, nose: float) -> None:
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
        shade: dict[str, Any] = {"color": ACCENT, "alpha": 0.3, "linewidth": 0, "zorder": 4, "label": label}
        ax.fill_betweenx(ends, rear - 2 * error, rear + 2 * error, **shade)
        text = rf"$L_{{\mathrm{{{symbol}}}}}/\ell = {length:.3f} \pm {error:.3f}$"
        middle = nose - 0.5 * length, height + 0.05
        ax.text(*middle, text, color=ACCENT, ha="center", va="bottom", fontsize=12, zorder=6)
    for z, low in ((nose, 0.0), (nose - measured.axial_extent / scale, -0.2)):
        ax.plot([z, z], [low, _DIMENSION_LINE + 0.06], ":", color=ACCENT, linewidth=1.0, zorder=1.5)


def _finish(ax: Axes, posterior: Posterior, ends: tuple[float, float]) -> None:
    """Label the axes and say the direction of the flow and the medians."""
    micrometres = 1e6 * posterior.inputs.half_width.value
    arrow = {"arrowstyle": "-|>", "color": "#555555"}
    flow = {"va": "center", "ha": "right", "fontsize": 11, "color": "#555555", "arrowprops": arrow}
    ax.annotate("flow", (ends[1] - 0.1, -0.72), (ends[1] - 0.5, -0.72), **flow)  # type: ignore[arg-type]
    ax.set(xlim=ends, ylim=(-1.0 - _THICKNESS, _TOP), aspect="equal", xlabel=r"$z/\ell$", ylabel=r"$y/\ell$")
    ax.set_yticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    to_micrometres = partial(np.multiply, micrometres), partial(np.multiply, 1.0 / micrometres)
    top = ax.secondary_xaxis("top", functions=to_micrometres)
    top.set_xlabel(rf"$z$ [µm], for $\ell$ = {micrometres:.3g} µm")
    framed(ax, ("right",))
    ca, size = posterior.marginals["capillary_number"], posterior.marginals["size_ratio"]
    text = rf"medians: $\mathrm{{Ca}} = {ca.median:.4f}$, $a/\ell = {size.median:.3f}$"
    ax.text(ends[0] + 0.05, _TOP - 0.05, text, va="top", fontsize=11)
    handles, labels = ax.get_legend_handles_labels()
    order = [1, 0, *range(2, len(handles))]  # the line before its band
    spacing, handle, size_of_text = (1.5, 1.6, 10) if len(order) < 4 else (1.0, 1.2, 8.5)
    ax.legend(
        [handles[k] for k in order],
        [labels[k] for k in order],
        loc="upper center",
        bbox_to_anchor=(0.5, -0.075),
        ncols=len(order),
        frameon=False,
        columnspacing=spacing,
        handlelength=handle,
        fontsize=size_of_text,
    )


_PREDICTED, _MEASURED = "#35b5ff", "#ff7a3d"
_AROUND = 1.25  # of the picture that is shown, either side of the axis, over l
_BAR = 0.25  # of the picture's width, at most


def picture_figure(posterior: Posterior, picture: str | Path, *, width: float = 7.4) -> Figure | None:
    """Draw the predicted outline over the picture that the capsule was measured in.

    Walls and capsule are found in the picture again; the predicted nose is laid on the measured nose. Returns None if
    no single capsule between two walls is found, or the model predicts no outlines. The width is in inches.

    Raises
    ------
    InputError
        If the file is missing or no picture.
    """
    from capsbayes.image.files import Picture
    from capsbayes.image.measure import detect

    seen = Picture.read(picture)
    detection = detect(seen)
    if posterior.outlines is None or not detection.status.ok or detection.walls is None or detection.outline is None:
        return None
    rows, columns = seen.shape
    walls = detection.walls
    top, bottom = (walls.centre_row + side * _AROUND * walls.half_width for side in (-1.0, 1.0))
    top, bottom = max(top, 0.0), min(bottom, rows - 1.0)
    figure = new_figure(width, width * (bottom - top) / columns + 0.4, layout=None)
    ax = figure.add_axes((0.0, 0.4 / figure.get_figheight(), 1.0, 1.0 - 0.4 / figure.get_figheight()))
    ax.imshow(seen.grey, cmap="gray", interpolation="nearest")
    predicted = on_picture(band(posterior.outlines)[0], detection)
    ax.plot(*closed(predicted).T, color=_PREDICTED, linewidth=3.2, alpha=0.75, label="predicted outline")
    ax.plot(*closed(detection.outline.points).T, color=_MEASURED, linewidth=0.9, label="measured edge")
    _draw_bar(ax, walls.half_width / posterior.inputs.half_width.value, columns, bottom)
    ax.set(xlim=(-0.5, columns - 0.5), ylim=(bottom, top))
    ax.set_axis_off()
    figure.legend(loc="lower center", ncols=2, frameon=False, fontsize=10)
    return figure


def bare_figure(picture: str | Path, *, width: float = 7.4) -> Figure:
    """Draw a picture alone, in grey, at a width in inches.

    Raises
    ------
    InputError
        If the file is missing or no picture.
    """
    from capsbayes.image.files import Picture

    grey = Picture.read(picture).grey
    figure = new_figure(width, width * grey.shape[0] / grey.shape[1], layout=None)
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.imshow(grey, cmap="gray", interpolation="nearest")
    ax.set_axis_off()
    return figure


def on_picture(outline: Floats, detection: Detection) -> Floats:
    """Lay an outline (z, y) on the capsule that was detected in a picture, nose on nose : (p, 2) array [l] to [px].

    The detection has walls, outline and nose; the flow is towards rising z.
    """
    walls, nose = detection.walls, detection.nose
    assert walls is not None, "of a capsule that was measured"
    assert nose is not None, "of a capsule that was measured"
    downstream = (detection.flow or 1) * walls.along
    behind = outline[:, 0] - outline[:, 0].max()
    tip = detection.axis + nose.distance * downstream
    return np.asarray(tip + walls.half_width * (behind[:, None] * downstream + outline[:, 1:] * walls.across))


def _draw_bar(ax: Axes, pixels: float, columns: int, bottom: float) -> None:
    """A bar of a round length in the corner, dark around so that it shows on any picture; `pixels` make a metre."""
    most = _BAR * columns / pixels
    size = 10.0 ** np.floor(np.log10(most))
    size *= max(factor for factor in (1.0, 2.0, 5.0) if factor * size <= most)
    length = size * pixels
    start, height = 0.03 * columns, bottom - 0.03 * columns
    ax.plot([start, start + length], [height, height], color="black", linewidth=5.0, solid_capstyle="butt")
    ax.plot([start, start + length], [height, height], color="white", linewidth=2.5, solid_capstyle="butt")
    text = ax.text(start + 0.5 * length, height - 0.012 * columns, f"{1e6 * size:g} µm", color="white", ha="center")
    text.set_bbox({"facecolor": "black", "alpha": 0.6, "pad": 1.5, "linewidth": 0})


_OVERLAY = "overlay.png"  # as capsbayes measure and identify name it
_WIDTH = 6.2  # inch: small enough for its letters to be read on a phone


def posterior_page(posterior: Posterior, *, capsule: str | Path | None = None, folder: Path | None = None) -> str:
    """Return a posterior as a whole page in HTML, with the pictures of `capsule_pictures` within it."""
    shown = [typeset(value_words(name, posterior.marginals[name])) for name in SHOWN if name in posterior.marginals]
    names = (*SHOWN, *posterior.prior.uncertain)
    caption = "Every pair: contours hold 68 % and 95 % of the probability. Each alone: median and 68 % interval."
    source = posterior.measurement.source
    name = Path(source).name if source else "without a name"
    return page(
        "posterior.html",
        title=f"Capsule {name}",
        name=name,
        headlines=shown,
        status=texts.status_words(posterior),
        ok=posterior.status.ok,
        caveats=[typeset(sentence) for sentence in texts.caveats(posterior)],
        pictures=list(capsule_pictures(posterior, capsule, folder)),
        quantities=html_table(texts.quantity_table(posterior)),
        agreement=texts.agreement_words(posterior),
        deterministic=posterior.deterministic is not None,
        corner=picture(corner_plot(posterior, names), "corner plot of the posterior", caption, fit="scroll"),
        budget_sentence=typeset(texts.budget_sentence(posterior)),
        budget="" if (budget := texts.budget_table(posterior)) is None else html_table(budget),
        modulus=typeset("G_s"),
        narrowing=html_table(texts.narrowing_table(posterior)) if posterior.expected_log_modulus_sds else "",
        inputs=html_table(texts.input_table(posterior)),
        priors=html_table(texts.prior_table(posterior)),
        gates=html_table(texts.check_table(posterior)),
        origin=html_table(texts.origin_table(posterior)),
    )


def capsule_pictures(
    posterior: Posterior, capsule: str | Path | None = None, folder: Path | None = None
) -> Iterator[Markup]:
    """Yield the pictures of a capsule, as many as there are.

    The photograph is by default that of the measurement, if it is still there unchanged; the folder is that with the
    ``overlay.png`` that was drawn when the capsule was measured, if there is one. Where the walls were stated by hand,
    only that shows them.
    """
    yield from _photograph(posterior, capsule, folder)
    if posterior.outlines is not None:
        caption = "Predicted outline with its 95 % band between the walls of the channel, and the measured lengths."
        alternative = "predicted outline and measured lengths in the channel"
        yield picture(outline_figure(posterior), alternative, caption, fit="narrow")


def _photograph(posterior: Posterior, capsule: str | Path | None, folder: Path | None) -> Iterator[Markup]:
    """The predicted outline over the picture; where that cannot be drawn, what was drawn when it was measured."""
    if posterior.measurement.walls:  # they would be sought in the picture again, and others found
        yield from _overlay(posterior, folder)
        return
    known = _measured_in(posterior) if capsule is None else Path(capsule)
    figure = None if known is None else picture_figure(posterior, known, width=_WIDTH)
    if known is not None and figure is not None:
        caption = f"{known.name}: the measured edge, and the predicted outline laid nose on nose."
        alternative = "picture of the capsule with measured and predicted outline"
        yield picture(figure, alternative, caption, png=True, fit="narrow")
    elif capsule is not None:
        caption = f"{Path(capsule).name}: no single capsule between two walls was found in it again."
        yield picture(bare_figure(capsule, width=_WIDTH), "picture of the capsule", caption, png=True, fit="narrow")
    else:
        yield from _overlay(posterior, folder)


def _overlay(posterior: Posterior, folder: Path | None) -> Iterator[Markup]:
    """The picture with the detected capsule, from the folder of the result or of the measurement."""
    source = posterior.measurement.source
    folders = [place for place in (folder, Path(source).parent if source else None) if place is not None]
    for place in filter(Path.is_file, (place / _OVERLAY for place in folders)):
        caption = "What was found in the picture: walls blue, edge red, length along the flow violet."
        if posterior.measurement.walls:
            caption += " Dashed walls and a dotted axis were stated by hand."
        alternative = "picture of the capsule with what was found in it"
        yield image(place.read_bytes(), "png", alternative, caption, fit="narrow")
        return


def _measured_in(posterior: Posterior) -> Path | None:
    """The picture that the capsule was measured in, if it is still there unchanged."""
    source = Path(posterior.measurement.source)
    if source.suffix.lower() not in PICTURES or not source.is_file():
        return None
    same = hashlib.sha256(source.read_bytes()).hexdigest() == posterior.measurement.sha256
    return source if same else None
