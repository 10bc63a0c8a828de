"""Capsules of a film: measured from their frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arguments import checked
from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.background import (
    FLICKER,
    Contrast,
    are_misplaced,
    blobs_in_empty,
    brightness,
    check_light,
    check_place,
    compared_with_bands,
    edge_shift,
    find_blobs,
    runs_upright,
    take_turns,
    temporal_median,
    tiles_of,
    transmission,
)
from capsbayes.image.by_hand import ByHand
from capsbayes.image.detect import analyse_blob
from capsbayes.image.edges import pixel_noise
from capsbayes.image.files import Film, Picture, Pixels, evenly_spaced
from capsbayes.image.film_capsule import FilmCapsule, FrameRecord, Linker, Track
from capsbayes.image.measure import CLIPPED, check_flow, read_picture, turned
from capsbayes.image.walls import WallLines
from capsbayes.quantity import Given, Quantity
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd


_SAMPLED = 41  # frames in the median that is the background
_TELLING = 9  # frames that tell contrast and smoothing, where the background is given
_FIRST = 12  # frames in which it is sought whether two kinds take turns
_BARE = 0.8  # share of the frames, or of the channel, that dark capsules may cover
_AROUND = 12  # px around a capsule that its halo may reach
_FREE, _SHARE_FREE = 3, 0.25  # fewest frames, and share of them, in which each place is free of capsules
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
    """Measurements of the capsules of a film."""

    status: Status  # ``DONE``, or why no capsules could be sought in the film
    capsules: tuple[FilmCapsule, ...] = ()  # in the order in which they appear, including the refused ones
    statuses: Counter[Status] | None = None  # of all blobs in all frames
    frames: int = 0
    unreadable: int = 0
    saturated: int = 0  # frames clipped between the walls

    def table(self) -> pd.DataFrame:
        """Tabulate the capsules."""
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


@checked
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
        The empty channel; by default the median of what no capsule covers in 41 frames.
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
    if experiment.camera is not None:
        expected = "none for a film: single pictures, events and contours alone are corrected"
        raise InputError(experiment.source or "experiment", "camera", expected, experiment.camera.described())
    film = replace(film, quarters=by_hand.quarters, gamma=by_hand.gamma)
    stated = None if background is None else turned(read_picture(background), None, by_hand)[0]
    view = _view(film, stated, by_hand, experiment)
    if isinstance(view, Status):
        return FilmMeasurement(view)
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
    sha256, size = film.sha256, by_hand.pixel_size
    capsules = [FilmCapsule.of(record, experiment, rate, size, film.source, sha256) for record in records.values()]
    return FilmMeasurement(Status.DONE, tuple(capsules), statuses, frames, unreadable, saturated)


@dataclass(frozen=True, eq=False)
class _View:
    """Part of the frames that is analysed, as rows and columns; the walls and the empty channel in it."""

    part: tuple[slice, slice]
    walls: WallLines
    tiles: Floats  # of the empty channel
    gain: Floats  # from grey levels, as they are analysed, to light over that of the empty channel
    between: Booleans
    contrast: Contrast
    shift: float  # as of `Detection`
    edge_offset: Quantity | None  # as of `ByHand`

    def light(self, picture: Picture) -> Floats:
        """Return the light of a frame over that of the empty channel under the lamp of the frame."""
        level = brightness(tiles_of(picture.grey), self.tiles, _bare(self.contrast))
        grey = picture.grey if level == 1.0 else picture.grey / level
        return np.asarray(self.contrast.darkened(grey) * self.gain)

    def is_clipped(self, picture: Picture) -> bool:
        return bool(np.count_nonzero(picture.clipped & self.between) > CLIPPED * np.count_nonzero(self.between))


def _measure_frame(
    picture: Picture, frame: int, view: _View, linker: Linker, records: dict[Track, FrameRecord], found: Counter[Status]
) -> None:
    """Find the blobs of one frame, link them and measure each."""
    light = view.light(picture)
    noise = pixel_noise(light)
    blobs = find_blobs(light, view.walls, noise)
    for blob, track in zip(blobs, linker.link(frame, blobs), strict=True):
        if track is None:
            found[blob.status] += 1
            continue
        detection = analyse_blob(light, noise, view.walls, blob, linker.direction, view.shift, view.edge_offset)
        found[detection.status] += 1
        records.setdefault(track, FrameRecord()).add(frame, picture, detection)


def _sample(film: Film, by_hand: ByHand, *, given: bool) -> tuple[Picture, list[Pixels], list[Pixels]]:
    """Return the first frame, the first ones, and some that tell background, contrast and whether it was smoothed."""
    # for a background they are spread over the film, and for the contrast, as capsules have to be in them; where both
    # are given, they are the first: a video is decoded up to the last
    early = given and by_hand.contrast is not None
    spread = evenly_spaced(film.count, _TELLING if given else _SAMPLED)
    frames = enumerate(film.frames(only=None if early else spread.union(range(_FIRST))))
    readable = ((number, picture) for number, picture in frames if picture is not None)
    first, read = None, {}
    for number, picture in islice(readable, _FIRST if early else None):
        first, read[number] = first or picture, picture.packed().grey
    if first is None:
        raise InputError(str(film.source), "", "frames that can be read", "none")
    beginning = [grey for number, grey in read.items() if number < _FIRST]
    return first, beginning, beginning[:_TELLING] if early else [read[number] for number in read if number in spread]


def _view(film: Film, background: Picture | None, by_hand: ByHand, experiment: Experiment) -> _View | Status:
    """Return how the frames are seen before the empty channel, which is stated or shows between the capsules."""
    first, beginning, sampled = _sample(film, by_hand, given=background is not None)
    if background is not None and first.shape != background.shape:
        return Status.BACKGROUND_DIFFERS
    rows, columns = part = by_hand.part(first.shape)
    stated = None
    if background is not None:
        background = background.cut(part)
        check_light(first.cut(part), background, FLICKER)
        stated = background.grey
    if take_turns(frame[part] for frame in beginning):
        return Status.TAKE_TURNS
    if stated is None and len(sampled) < 3:
        got, advice = str(len(sampled)), "or give a background"
        raise InputError(str(film.source), "", "at least three readable frames", got, advice)
    lines = by_hand.lines(first.shape, experiment.half_width)
    sampled = [frame[part] for frame in sampled]
    sampled = _evenly_lit(sampled, sampled[len(sampled) // 2] if stated is None else stated)
    empty = temporal_median(sampled) if stated is None else stated
    contrast = Contrast.of(sampled, empty, lines, by_hand.contrast)
    if background is not None:
        seen = temporal_median(sampled) if len(sampled) >= 3 else sampled[0]
        check_place(contrast.darkened(seen), contrast.shown(background), contrast.walls)
    if contrast.walls is not None and stated is None:
        freed = _without_capsules(sampled, empty, contrast, contrast.walls)
        if freed is None:
            return Status.COVERED
        empty = freed
        contrast = Contrast.of(sampled, empty, lines, by_hand.contrast)
    raw, empty, walls = empty, contrast.darkened(empty), contrast.walls
    if walls is None:
        return Status.UPRIGHT if runs_upright(raw, by_hand.contrast) else Status.NO_WALLS
    if lines is not None:
        walls = compared_with_bands(walls, empty)
        if are_misplaced(walls):
            return Status.WALLS_OFF
    if stated is None and blobs_in_empty(empty, walls):
        return Status.COVERED
    near = walls.rows_around(empty.shape)
    walls, shown = walls.moved(0, -near.start), empty[near]
    read = slice(rows.start + near.start, rows.start + near.stop), columns
    gain, tiles = transmission(np.ones_like(shown), shown), tiles_of(raw[near])
    shift = _shift([frame[near] for frame in sampled], contrast, walls, gain)
    return _View(read, walls, tiles, gain, walls.between(shown.shape), contrast, shift, by_hand.edge_offset)


def _bare(contrast: Contrast) -> float:
    """Return the quantile of grey levels that shows the empty channel also where capsules cover most of it."""
    return _BARE if contrast.mirror is None else 1.0 - _BARE


def _evenly_lit(frames: list[Pixels], reference: Pixels) -> list[Pixels]:
    """Return frames in the light of another one, where the lamp flickers."""
    tiles = tiles_of(reference)
    lit = ((frame, brightness(tiles_of(frame), tiles)) for frame in frames)
    return [frame if level == 1.0 else (frame / level).astype(np.float32) for frame, level in lit]


def _without_capsules(frames: list[Pixels], empty: Floats, contrast: Contrast, walls: WallLines) -> Floats | None:
    """Return the empty channel by the frames in which no capsule covers a pixel; None where these are too few."""
    # sought before a quantile that shows the channel also where they cover a place in most of the frames
    near = walls.rows_around(empty.shape)
    walls, frames = walls.moved(0, -near.start), [frame[near] for frame in frames]
    bare = contrast.darkened(temporal_median(frames, share=_bare(contrast)))
    covered = []
    for frame in frames:
        light = transmission(contrast.darkened(frame), bare)
        mask = np.zeros(light.shape, dtype=np.uint8)
        for blob in find_blobs(light, walls, pixel_noise(light)):
            cv2.fillPoly(mask, [np.rint(blob.polygon).astype(np.int32)], 1)
        covered.append(cv2.dilate(mask, np.ones((2 * _AROUND + 1,) * 2, dtype=np.uint8)) > 0)
    free = len(frames) - np.count_nonzero(covered, axis=0)
    if free.min() < max(_FREE, _SHARE_FREE * len(frames)):
        return None
    freed = empty.copy()
    freed[near] = temporal_median(frames, covered)
    return freed


def _shift(sampled: list[Pixels], contrast: Contrast, walls: WallLines, gain: Floats) -> float:
    """Return the median of the shifts of some frames that follow from smoothing [px]."""
    lights = (contrast.darkened(frame) * gain for frame in sampled[:: max(1, len(sampled) // _TELLING)])
    shifts = [edge_shift(light, walls, find_blobs(light, walls, pixel_noise(light))) for light in lights]
    return float(np.median(shifts)) if shifts else 0.0
