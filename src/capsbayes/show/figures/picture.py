"""The picture of a capsule with the outline over it that its posterior predicts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from capsbayes.arrays import Floats
from capsbayes.infer import Posterior
from capsbayes.infer.outline import band
from capsbayes.show.figures.style import closed, new_figure

if TYPE_CHECKING:
    from capsbayes.image.detect import Detection

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
