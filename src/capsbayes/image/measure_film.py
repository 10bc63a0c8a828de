"""From a film to one measurement for each capsule in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.background import along_the_channel, evened, temporal_median, transmission
from capsbayes.image.contour import pixel_noise
from capsbayes.image.film import Film
from capsbayes.image.filmed import FilmedCapsule, Record
from capsbayes.image.frames import Picture
from capsbayes.image.measure import CLIPPED, check_flow, read_picture
from capsbayes.image.sighting import sighted
from capsbayes.image.spots import find_spots
from capsbayes.image.track import Linker, Way
from capsbayes.image.wall import Walls, find_walls
from capsbayes.quantity import Quantity
from capsbayes.status import Status

__all__ = ["FilmMeasurement", "measure_film"]

Floats = NDArray[np.float64]

_SAMPLED = 41  # frames that the background is the median of
_MARGIN = 14.0  # px beyond the walls that are looked at
_NOISE_PIXELS = 40_000  # from which the noise of a frame is estimated


@dataclass(frozen=True, eq=False)
class FilmMeasurement:
    """What came of a film.

    Parameters
    ----------
    status : Status
        ``DONE``, or why nothing could be looked for in it.
    capsules : tuple of FilmedCapsule
        In the order in which they were first seen, the refused ones too.
    statuses : Counter of Status
        Of all spots in all frames.
    frames, unreadable, saturated : int
        How many there are, could not be read, and were clipped between the walls.
    """

    status: Status
    capsules: tuple[FilmedCapsule, ...] = ()
    statuses: Counter[Status] | None = None
    frames: int = 0
    unreadable: int = 0
    saturated: int = 0


def measure_film(
    film: Film | str | Path,
    experiment: Experiment,
    *,
    frame_rate: Quantity,
    background: str | Path | ArrayLike | None = None,
    flow: str | None = None,
    watch: Callable[[int], None] | None = None,
) -> FilmMeasurement:
    """Measure every capsule in a film.

    Parameters
    ----------
    film : Film or path
        Folder of pictures, TIFF, AVI or MP4, of a channel that runs along the rows, to 7 degrees.
    experiment : Experiment
        Its channel, whose half width is the length of a pixel.
    frame_rate : Quantity [1/s]
        With its standard error, zero if it is known.
    background : path or array, optional
        The empty channel; by default the median of 41 frames.
    flow : str, optional
        ``"right"`` or ``"left"``; by default as the capsules move, which is told from the nearest of the same size.
    watch : function, optional
        Called with the number of frames done.

    Returns
    -------
    FilmMeasurement

    Raises
    ------
    InputError
        If a file is missing or no film, on another word for the flow, or a film of fewer than three frames.
    """
    film = film if isinstance(film, Film) else Film.open(film)
    direction = check_flow(flow)
    empty = _background(film) if background is None else read_picture(background).grey
    view = _view(film, empty, given=background is not None)
    if isinstance(view, Status):
        return FilmMeasurement(view)
    linker = Linker(view.walls, direction)
    records: dict[int, tuple[Way, Record]] = {}
    statuses: Counter[Status] = Counter()
    frames = unreadable = saturated = 0
    for frames, picture in enumerate(film.frames(view.rows), start=1):
        if picture is None:
            unreadable += 1
        elif view.is_clipped(picture):
            saturated += 1
        else:
            _look(picture, frames - 1, view, linker, records, statuses)
        if watch is not None:
            watch(frames)
    sha256 = film.sha256
    capsules = [FilmedCapsule.of(one, experiment, frame_rate, film.source, sha256) for _, one in records.values()]
    return FilmMeasurement(Status.DONE, tuple(capsules), statuses, frames, unreadable, saturated)


def _look(
    picture: Picture,
    frame: int,
    view: _View,
    linker: Linker,
    records: dict[int, tuple[Way, Record]],
    statuses: Counter[Status],
) -> None:
    """Find the spots of one frame, link them and measure each."""
    light = picture.grey * view.gain
    rows = max(1, light.size // _NOISE_PIXELS)
    noise = pixel_noise(light[::rows])
    spots = find_spots(light, view.walls, noise)
    ways = linker.linked(frame, spots)
    for spot, way in zip(spots, ways, strict=True):
        if way is None:
            statuses[spot.status] += 1
            continue
        seen = sighted(light, noise, view.walls, spot, linker.direction)
        statuses[seen.status] += 1
        _, record = records.setdefault(id(way), (way, Record()))
        record.add(frame, picture, seen)


@dataclass(frozen=True, eq=False)
class _View:
    """The part of the pictures that is looked at: rows, the walls in these, what makes grey levels shares of light."""

    rows: slice
    walls: Walls
    gain: Floats
    between: NDArray[np.bool_]

    def is_clipped(self, picture: Picture) -> bool:
        return bool(np.count_nonzero(picture.clipped & self.between) > CLIPPED * np.count_nonzero(self.between))


def _background(film: Film) -> Floats:
    sampled = film.spread(_SAMPLED)
    if len(sampled) < 3:
        raise InputError(
            str(film.source), "", "at least three readable frames", f"{len(sampled)}", "or give a background"
        )
    return temporal_median([picture.grey.astype(np.float32) for picture in sampled]).astype(np.float64)


def _view(film: Film, empty: Floats, *, given: bool) -> _View | Status:
    first = next((picture for picture in film.frames() if picture is not None), None)
    if first is None or first.shape != empty.shape:
        return Status.BACKGROUND_DIFFERS
    walls = find_walls(empty)
    if walls is None:
        return Status.NO_WALLS
    if not given:
        light = evened(transmission(empty, along_the_channel(empty, walls)), walls)
        if find_spots(light, walls, pixel_noise(light)):
            return Status.COVERED
    reach = walls.half_width + _MARGIN + abs(np.tan(walls.tilt)) * walls.middle
    rows = slice(max(0, int(walls.height - reach)), min(empty.shape[0], int(walls.height + reach) + 2))
    walls = replace(walls, height=walls.height - rows.start)
    shown = empty[rows]
    between = np.abs(walls.offset((len(shown), shown.shape[1]))) < walls.half_width
    return _View(rows, walls, transmission(np.ones_like(shown), shown), between)
