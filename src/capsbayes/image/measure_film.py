"""From a film to one measurement for each capsule in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.background import estimate_background, flatten, temporal_median, transmission
from capsbayes.image.blobs import find_blobs
from capsbayes.image.by_hand import ByHand
from capsbayes.image.contrast import Contrast
from capsbayes.image.detection import analyse_blob
from capsbayes.image.edges.outline import pixel_noise
from capsbayes.image.files.film import Film
from capsbayes.image.files.picture import Picture, Pixels, packed
from capsbayes.image.film_capsule import FilmCapsule, FrameRecord
from capsbayes.image.measure import CLIPPED, check_flow, read_picture
from capsbayes.image.smoothing import edge_shift
from capsbayes.image.tracking import Linker, Track
from capsbayes.image.wall_bands import compared_with_bands
from capsbayes.image.walls import WallLines
from capsbayes.quantity import Given, Quantity
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd

_SAMPLED = 41  # frames in the median that is the background
_TELLING = 9  # frames that tell contrast and smoothing, where the background is given
_COLUMNS = {  # of the table of capsules, and the attributes of their measurements
    "axial_extent_over_l": "axial_extent",
    "axial_extent_error_over_l": "axial_extent_error",
    "axial_length_over_l": "axial_length",
    "axial_length_error_over_l": "axial_length_error",
    "velocity_m_s": "capsule_velocity",
    "velocity_error_m_s": "capsule_velocity_error",
    "axial_length_bound_over_l": "axial_length_bound",
}
_DRIFTS = ("L_z", "L_a", "v_o")


@dataclass(frozen=True, eq=False)
class FilmMeasurement:
    """Measurements of the capsules of a film.

    Parameters
    ----------
    status : Status
        ``DONE``, or why no capsules could be sought in the film.
    capsules : tuple of FilmCapsule
        In the order in which they appear, including the refused ones.
    statuses : Counter of Status
        Of all blobs in all frames.
    frames, unreadable, saturated : int
        Number of all frames, of those that could not be read, and of those clipped between the walls.
    """

    status: Status
    capsules: tuple[FilmCapsule, ...] = ()
    statuses: Counter[Status] | None = None
    frames: int = 0
    unreadable: int = 0
    saturated: int = 0

    def table(self) -> pd.DataFrame:
        """Tabulate the capsules.

        Returns
        -------
        DataFrame
            One row a capsule: ``capsule`` (from 1), ``status``, ``frames`` in which it was measured and ``alike``, how
            many of them agree; lengths over l and velocity in m/s with their standard errors, NaN where missing;
            ``axial_length_bound_over_l``; and for L_z, L_a and v_o the change along the channel over the mean, with its
            standard error (``L_z_change``, ``L_z_change_error``).
        """
        import pandas as pd

        rows = []
        for number, capsule in enumerate(self.capsules, start=1):
            measured, drifts = capsule.measurement, (capsule.drifts.get(name) for name in _DRIFTS)
            changes = [pair for drift in drifts for pair in ((drift.change, drift.error) if drift else (None, None))]
            values = [getattr(measured, name) for name in _COLUMNS.values()]
            frames = len(capsule.record.measured), int(np.count_nonzero(capsule.alike))
            rows.append((number, capsule.status.name, *frames, *values, *changes))
        of_changes = [f"{name}_{what}" for name in _DRIFTS for what in ("change", "change_error")]
        table = pd.DataFrame(rows, columns=["capsule", "status", "frames", "alike", *_COLUMNS, *of_changes])
        return table.astype(dict.fromkeys([*_COLUMNS, *of_changes], float))


def measure_film(
    film: Film | str | Path,
    experiment: Experiment,
    *,
    frame_rate: Given | None = None,
    background: str | Path | ArrayLike | None = None,
    flow: str | None = None,
    by_hand: ByHand | None = None,
    watch: Callable[[int], None] | None = None,
) -> FilmMeasurement:
    """Measure every capsule in a film.

    Parameters
    ----------
    film : Film or path
        Folder of pictures, TIFF, AVI or MP4, of a channel along the rows, to 7 degrees.
    experiment : Experiment
        Its half width sets the length of a pixel.
    frame_rate : Quantity, optional [1/s]
        In any form that `Quantity.of` reads; by default that of the experiment.
    background : path or array, optional
        The empty channel; by default the median of 41 frames.
    flow : str, optional
        ``"right"`` or ``"left"``; by default the direction in which the nearest blobs of one size move.
    by_hand : ByHand, optional
        What is stated of walls, scale and the part to analyse; by default they are found in the empty channel.
    watch : function, optional
        Called with the number of frames done.

    Returns
    -------
    FilmMeasurement

    Raises
    ------
    InputError
        If a file is missing or not a film, `flow` is another word, the film has fewer than three frames, or what is
        stated by hand does not suit its frames.
    """
    given = experiment.frame_rate if frame_rate is None else frame_rate
    rate = Quantity.of(given, "frame_rate", where=experiment.source or "measure_film")
    film = film if isinstance(film, Film) else Film.open(film)
    direction, by_hand = check_flow(flow), by_hand or ByHand()
    if by_hand.erase is not None:
        raise InputError("erase", "", "nothing for a film: its capsules move past what is wrong", "boxes")
    given = background is not None
    # they tell the background, the contrast, and whether the film was smoothed
    sampled: list[Pixels] = [packed(picture.grey) for picture in _sample(film, by_hand, given=given)]
    empty = read_picture(background).grey if background is not None else _background(film, sampled)
    view = _view(film, empty, sampled, by_hand, experiment, given=given)
    if isinstance(view, Status):
        return FilmMeasurement(view)
    del sampled, empty  # hundreds of megabytes, which the frames do not need
    linker = Linker(view.walls, direction)
    records: dict[Track, FrameRecord] = {}
    statuses: Counter[Status] = Counter()
    frames = unreadable = saturated = 0
    for frames, picture in enumerate(film.frames(view.part), start=1):
        if picture is None:
            unreadable += 1
        elif view.is_clipped(view.contrast.shown(picture)):
            saturated += 1
        else:
            _measure_frame(picture, frames - 1, view, linker, records, statuses)
        if watch is not None:
            watch(frames)
    sha256 = film.sha256
    size = by_hand.pixel_size
    capsules = [FilmCapsule.of(record, experiment, rate, size, film.source, sha256) for record in records.values()]
    return FilmMeasurement(Status.DONE, tuple(capsules), statuses, frames, unreadable, saturated)


@dataclass(frozen=True, eq=False)
class _View:
    """Part of the frames that is analysed, as rows and columns; the walls in it, and the factor from grey to light.

    The shift is that of `Detection`.
    """

    part: tuple[slice, slice]
    walls: WallLines
    gain: Floats
    between: Booleans
    contrast: Contrast
    shift: float

    def is_clipped(self, picture: Picture) -> bool:
        return bool(np.count_nonzero(picture.clipped & self.between) > CLIPPED * np.count_nonzero(self.between))


def _measure_frame(
    picture: Picture,
    frame: int,
    view: _View,
    linker: Linker,
    records: dict[Track, FrameRecord],
    statuses: Counter[Status],
) -> None:
    """Find the blobs of one frame, link them and measure each."""
    light = view.contrast.shown(picture).grey * view.gain
    noise = pixel_noise(light)
    blobs = find_blobs(light, view.walls, noise)
    for blob, track in zip(blobs, linker.link(frame, blobs), strict=True):
        if track is None:
            statuses[blob.status] += 1
            continue
        detection = analyse_blob(light, noise, view.walls, blob, linker.direction, view.shift)
        statuses[detection.status] += 1
        records.setdefault(track, FrameRecord()).add(frame, picture, detection)


def _sample(film: Film, by_hand: ByHand, *, given: bool) -> Iterable[Picture]:
    """Return some frames; where background and contrast are given, the first ones: a video is decoded up to the last.

    For a background they are spread over the film, and for the contrast, as capsules have to be in them.
    """
    if given and by_hand.contrast is not None:
        return islice((picture for picture in film.frames() if picture is not None), _TELLING)
    return film.spread(_TELLING if given else _SAMPLED)


def _background(film: Film, sampled: list[Pixels]) -> Floats:
    if len(sampled) < 3:
        raise InputError(
            str(film.source), "", "at least three readable frames", f"{len(sampled)}", "or give a background"
        )
    return temporal_median(sampled)


def _view(
    film: Film, empty: Floats, sampled: list[Pixels], by_hand: ByHand, experiment: Experiment, *, given: bool
) -> _View | Status:
    first = next((picture for picture in film.frames() if picture is not None), None)
    if first is None:
        raise InputError(str(film.source), "", "frames that can be read", "none")
    if first.shape != empty.shape:
        return Status.BACKGROUND_DIFFERS
    rows, columns = part = by_hand.part(first.shape)
    stated = by_hand.lines_in_part(first.shape, experiment.half_width)
    empty, sampled = empty[part], [frame[part] for frame in sampled if frame.shape == empty.shape]
    contrast = Contrast.of(sampled, empty, stated, by_hand.contrast)
    empty = empty if contrast.mirror is None else contrast.mirror - empty
    walls = contrast.walls
    if walls is None:
        return Status.NO_WALLS
    if stated is not None:
        walls = compared_with_bands(walls, empty)
    if not given:
        light = flatten(transmission(empty, estimate_background(empty, walls)), walls)
        if find_blobs(light, walls, pixel_noise(light)):
            return Status.COVERED
    near = walls.rows_around((empty.shape[0], empty.shape[1]))
    walls = walls.moved(0, -near.start)
    shown = empty[near]
    between = np.abs(walls.offset((len(shown), shown.shape[1]))) < walls.half_width
    read = slice(rows.start + near.start, rows.start + near.stop), columns
    gain = transmission(np.ones_like(shown), shown)
    shift = _shift([frame[near] for frame in sampled], contrast, walls, gain)
    return _View(read, walls, gain, between, contrast, shift)


def _shift(sampled: list[Pixels], contrast: Contrast, walls: WallLines, gain: Floats) -> float:
    """Return the median of the shifts of some frames that follow from smoothing [px]."""
    shifts = []
    for frame in sampled[:: max(1, len(sampled) // _TELLING)]:
        light = contrast.shown(Picture.from_array(frame)).grey * gain
        shifts.append(edge_shift(light, walls, find_blobs(light, walls, pixel_noise(light))))
    return float(np.median(shifts)) if shifts else 0.0
