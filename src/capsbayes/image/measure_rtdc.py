"""From the events of an .rtdc file to measurements: the mask says which object it is, the picture where its edge is.

Contours through the pixel centres of a mask lie half a pixel inside; they are only where the edge is looked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.background import temporal_median, transmission
from capsbayes.image.contour import pixel_noise
from capsbayes.image.frames import Picture
from capsbayes.image.measure import check_flow, measurement_of_lengths
from capsbayes.image.rtdc import RtdcFile
from capsbayes.image.sighting import Sighting, sighted
from capsbayes.image.spots import Spot, judged
from capsbayes.image.wall import Walls
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity
from capsbayes.status import Status

__all__ = ["Event", "measure_rtdc"]

Floats = NDArray[np.float64]

_SAMPLED = 101  # events that the background is the median of
_WIDTHS = 0.1  # by how much the channel's width may differ between file and experiment
_SLOPES = np.linspace(-0.12, 0.12, 121)  # of the channel to the rows
_LINES = 2.0  # px: standard deviation of a wall's bundle of lines
_PIECE = 0.02  # of the largest piece of a mask: smaller ones are ignored


@dataclass(frozen=True, eq=False)
class Event:
    """What came of one event.

    Parameters
    ----------
    number : int
        From 0, as in the file.
    picture : Picture
    sighting : Sighting
        In pixels; its walls lie as far apart as the file says.
    measurement : Measurement
        Lengths in metres; refused unless the sighting's status is ``DONE``.
    """

    number: int
    picture: Picture
    sighting: Sighting
    measurement: Measurement


def measure_rtdc(
    file: RtdcFile | str | Path,
    experiment: Experiment,
    *,
    capsule_velocity: Quantity,
    pixel_size: Quantity,
    flow: str | None = None,
) -> Iterator[Event]:
    """Measure event after event.

    Parameters
    ----------
    file : RtdcFile or path
    experiment : Experiment
        Its channel is checked against that of the file; the liquid's viscosity is not in the file.
    capsule_velocity : Quantity [m/s]
        v_o with its standard error, which the file does not hold.
    pixel_size : Quantity [m]
        With its standard error, which the file does not hold; checked against the file's.
    flow : str, optional
        ``"right"`` or ``"left"``, which the file does not hold; found from the shape by default.

    Yields
    ------
    Event

    Raises
    ------
    InputError
        If the file cannot be used, or its channel or pixels are not those of the experiment.
    """
    file = file if isinstance(file, RtdcFile) else RtdcFile.open(file)
    direction = check_flow(flow)
    _check_channel(file, experiment, pixel_size)
    sampled = set(np.unique(np.linspace(0, file.events - 1, _SAMPLED).round().astype(int)).tolist())
    empty = temporal_median(
        [image.astype(float) for index, (image, _) in enumerate(file.pictures()) if index in sampled]
    )
    walls = _walls(empty, 0.5 * file.channel_width / pixel_size.value)
    gain = transmission(np.ones_like(empty), empty)
    named = Path(experiment.source) if experiment.source else None
    for number, (image, mask) in enumerate(file.pictures()):
        picture = replace(Picture.from_array(image), source=f"{file.path}, event {number}", sha256=file.sha256)
        light = picture.grey * gain
        found = sighted(light, pixel_noise(light), walls, spot_of(mask, walls), direction)
        if found.status.ok:
            measured = measurement_of_lengths(found.lengths, found.covariance, capsule_velocity, pixel_size=pixel_size)
        else:
            measured = Measurement.refused(found.status)
        measured = replace(measured, source=picture.source, sha256=file.sha256, experiment_file=named)
        yield Event(number, picture, found, measured)


def spot_of(mask: NDArray[np.bool_], walls: Walls) -> Spot:
    """The object a mask shows; one that falls into pieces is refused.

    Parameters
    ----------
    mask : (rows, columns) array of bool
    walls : Walls

    Returns
    -------
    Spot
    """
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return Spot(np.zeros((1, 2)), 0.0, Status.NO_CAPSULE)
    pieces = sorted(contours, key=cv2.contourArea)
    areas = [cv2.contourArea(piece) for piece in pieces]
    spot = judged(np.asarray(pieces[-1]), mask.shape, walls.half_width)
    if len(areas) > 1 and areas[-2] > _PIECE * areas[-1]:
        return replace(spot, status=Status.BROKEN_MASK)
    return spot


def _check_channel(file: RtdcFile, experiment: Experiment, pixel_size: Quantity) -> None:
    wide = 2.0 * experiment.half_width.mean
    where = experiment.source or "experiment"
    if abs(wide / file.channel_width - 1.0) > _WIDTHS:
        expected = f"half of the {1e6 * file.channel_width:g} um of the channel in {file.path}"
        raise InputError(where, "half_width", expected, f"{0.5e6 * wide:g} um")
    if abs(pixel_size.value / file.pixel_size - 1.0) > _WIDTHS:
        expected = f"about the {1e6 * file.pixel_size:.4g} um of {file.path}, with an error"
        raise InputError("pixel size", "", expected, f"{1e6 * pixel_size.value:g} um")
    if file.events < 3:
        raise InputError(str(file.path), "events", "at least three", str(file.events))


def _walls(empty: Floats, half_width: float) -> Walls:
    """Walls as far apart as the file says, where the empty channel is darkest.

    At this magnification a wall is a bundle of dark lines, of which none alone is the wall.
    """
    rows, columns = empty.shape
    middle = 0.5 * (columns - 1)
    best = (-np.inf, 0.0, empty.mean(axis=1))
    for slope in _SLOPES:
        shear = np.array([[1.0, 0.0, 0.0], [-slope, 1.0, slope * middle]])
        level = cv2.warpAffine(empty, shear, (columns, rows), borderMode=cv2.BORDER_REPLICATE).mean(axis=1)
        best = max(best, (float(level.var()), float(slope), level), key=lambda one: one[0])
    _, slope, level = best
    apart = half_width * np.hypot(1.0, slope)  # between the walls, down a column
    heights = np.arange(apart, rows - 1.0 - apart, 0.25)
    if not len(heights):
        return Walls(0.5 * (rows - 1), middle, float(np.arctan(slope)), half_width, 0.0, _LINES)
    blurred = gaussian_filter1d(level, _LINES)
    dark = sum(np.interp(heights + side * apart, np.arange(rows), blurred) for side in (-1.0, 1.0))
    height = float(heights[np.argmin(dark)])
    return Walls(height, middle, float(np.arctan(slope)), half_width, 0.0, _LINES)
