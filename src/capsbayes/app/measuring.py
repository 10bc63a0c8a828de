"""What the first process apart computes: pictures that are shown and measured, from names in a capsule's folder."""

from __future__ import annotations

import base64
import contextlib
from pathlib import Path
from typing import Any

import numpy as np

from capsbayes.app.archive import packed, unpacked
from capsbayes.app.stated import EVENTS, EXAMPLE, EXAMPLE_PICTURE, EXPERIMENT, Stated, page_words
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.files.recording import is_film, pixel_size_of
from capsbayes.image.by_hand import ByHand
from capsbayes.image.detect import Detection
from capsbayes.image.files import Film, Picture
from capsbayes.image.measure import detect, detected_in, turned
from capsbayes.image.overlay import png_of
from capsbayes.image.rtdc import RtdcFile
from capsbayes.report.tables import typeset

_WIDEST = 1600  # px of the picture on the page


def shown(folder: str, name: str, rotate: str = "") -> dict[str, Any]:
    """Return a picture, turned clockwise by some degrees, or the middle one of a film or of events, for the page."""
    # The size of a pixel is that which a TIFF file states, in micrometres, else 0.
    with contextlib.chdir(folder):
        seen, count, stated = _opened(Path(name))
        pixel = 1e6 * (pixel_size_of(Path(name)) or 0.0)
    if rotate:
        seen, _, _ = turned(seen, None, ByHand(rotate=rotate))
    png = base64.b64encode(png_of(seen, widest=_WIDEST)).decode()
    size = {"rows": seen.shape[0], "columns": seen.shape[1]}
    return {**size, "src": f"data:image/png;base64,{png}", "count": count, "stated": stated, "pixel": pixel}


def _opened(path: Path) -> tuple[Picture, int, dict[str, str]]:
    """Return the picture of a file, or the middle one of several, how many there are, and what is stated with them."""
    if path.suffix.lower() in EVENTS:
        events = RtdcFile.open(path)
        pixels, _ = next(events.pictures([events.events // 2]))
        lengths = {"half_width": 0.5 * events.channel_width, "pixel_size": events.pixel_size}
        stated = {name: f"{1e6 * length:.6g} um" for name, length in lengths.items()}
        if events.flow_rate is not None:
            stated["flow_rate"] = f"{6e10 * events.flow_rate:.6g} uL/min"  # as the form shows it
        return Picture.from_array(pixels), events.events, stated
    if not is_film(path):
        return Picture.read(path), 1, {}
    film = Film.open(path)
    seen = next(film.frames(only={0}), None)
    if seen is None:
        raise InputError(str(path), "", "a film", "no frame that can be read")
    return seen, film.count, {}


def measured(folder: str, stated: Stated) -> dict[str, Any]:
    """Measure the capsule in a picture; the velocity and the experiment need not be stated yet."""
    with contextlib.chdir(folder):
        experiment = Experiment.read(EXPERIMENT) if Path(EXPERIMENT).exists() else None
        seen, detection = detected(stated, experiment)
    boxes = ByHand(**stated.by_hand())
    return _drawn(detection, seen.shape[1]) | {
        "crop": boxes.crop,
        "erased": boxes.erase,
        "ok": detection.status.ok,
        "status": page_words(detection.status),
        "rows": _rows(detection),
    }


def detected(stated: Stated, experiment: Experiment | None) -> tuple[Picture, Detection]:
    """Return the picture and what is found in it as it is stated."""
    by_hand = ByHand(**stated.by_hand())
    return detected_in(stated.picture, stated.background or None, stated.flow or None, by_hand, experiment)


def _drawn(detection: Detection, columns: int) -> dict[str, Any]:
    """Return the lines of a detection in pixels of the picture; of each wall the rows at its left and right border."""
    outline, rear, rows = None, detection.rear_line(), None
    if detection.outline is not None:
        outline = detection.outline.points.tolist()
    elif detection.blob is not None:
        outline = detection.blob.polygon.tolist()
    if (walls := detection.walls) is not None:
        middle, slope = np.array([walls.centre_column, walls.centre_row]), walls.along[1] / walls.along[0]
        on_lines = [middle + side * walls.half_width * walls.across for side in (-1.0, 1.0)]
        rows = [float(y + (end - x) * slope) for x, y in on_lines for end in (0.0, columns - 1.0)]
    lines = {"outline": outline, "rear": None if rear is None else rear.tolist(), "walls": rows}
    return lines | {"flow": detection.flow}


def _rows(detection: Detection) -> list[tuple[str, str, str]]:
    """Return what was measured: name, in px, and over l."""
    if not detection.status.ok:
        return []
    rows: list[tuple[str, str, str]] = []
    for name, _, value, error, ratio, ratio_error in detection.table().itertuples():
        if name in ("L_z", "L_a", "l"):
            seen = f"{value:.2f} ± {error:.2f}" if np.isfinite(value) else "not seen"
            over = f"{ratio:.4f} ± {ratio_error:.4f}" if name != "l" and np.isfinite(value) else ""
            rows.append((typeset("ℓ" if name == "l" else name), seen, over))
    return rows


def warm() -> None:
    """Measure the example, so that all that is compiled is loaded before a person waits for it."""
    Experiment("square", EXAMPLE["half_width"], EXAMPLE["viscosity"])
    detect(Picture.read(EXAMPLE_PICTURE))


TASKS = {task.__name__: task for task in (shown, measured, packed, unpacked)}
