"""The capsule in one picture: its lengths, their errors, and the edges that they were read from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arguments import checked
from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import AREAS, Experiment
from capsbayes.image.background import estimate_background, transmission
from capsbayes.image.blobs import find_blobs, is_shadow
from capsbayes.image.by_hand import ByHand
from capsbayes.image.contrast import Contrast, runs_upright
from capsbayes.image.detection import Detection, analyse_blob
from capsbayes.image.edges.outline import pixel_noise
from capsbayes.image.empty_channel import check_light, check_place
from capsbayes.image.files.picture import Picture
from capsbayes.image.motion import smeared
from capsbayes.image.silhouette import silhouette_of
from capsbayes.image.smoothing import edge_shift
from capsbayes.image.straightened import straightened_lengths, straightened_silhouette
from capsbayes.image.vignetting import evened
from capsbayes.image.wall_bands import compared_with_bands
from capsbayes.image.walls import WallLines, find_walls
from capsbayes.measurement import Measurement
from capsbayes.quantity import Given, Quantity
from capsbayes.status import Status

FLOWS = {"right": 1, "left": -1}
_NEAR = 3.0  # px: nearer to a dead column, an end of the capsule is not located
CLIPPED = 0.02  # largest share of clipped pixels between the walls


def detect(
    picture: Picture,
    *,
    background: Picture | None = None,
    flow: str | None = None,
    by_hand: ByHand | None = None,
    half_width: Given | None = None,
) -> Detection:
    """Find the walls, the capsule and its concave rear in a picture.

    Parameters
    ----------
    picture : Picture
        A capsule in a channel along the rows, to 7 degrees.
    background : Picture, optional
        The empty channel; by default it is estimated from the picture, line by line along the channel.
    flow : str, optional
        ``"right"`` or ``"left"``; by default it follows from the shape.
    by_hand : ByHand, optional
        What is stated of walls, scale and the part to analyse; by default they are found in the picture.
    half_width : Quantity, optional [m]
        Of the channel, in any form that `Quantity.of` reads; needed with a pixel size.

    Returns
    -------
    Detection
        Where nothing could be measured, its status gives the reason.

    Raises
    ------
    InputError
        If `flow` is another word, or what is stated by hand does not suit the picture.
    """
    direction = check_flow(flow)
    picture, background, by_hand = turned(picture, background, by_hand)
    if background is not None and background.shape != picture.shape:
        return Detection(Status.BACKGROUND_DIFFERS)
    width = None if half_width is None else Quantity.of(half_width, "half_width", where="detect")
    rows, columns = part = by_hand.part(picture.shape)
    stated = by_hand.lines_in_part(picture.shape, width)
    empty = None if background is None else background.cut(part)
    seen = picture.cut(part)
    if empty is not None:
        check_light(seen, empty)
    contrast = Contrast.of([seen.grey], None if empty is None else empty.grey, stated, by_hand.contrast)
    shown, ground = contrast.shown(seen), empty and contrast.shown(empty)
    if ground is not None:
        check_place(shown.grey, ground, contrast.walls)
    if (walls := contrast.walls) is None or (stated is not None and runs_upright(seen.grey, by_hand.contrast)):
        return Detection(Status.UPRIGHT if runs_upright(seen.grey, by_hand.contrast) else Status.NO_WALLS)
    if even := evened((shown, ground) if ground else (shown,), walls):
        shown, ground = even[0], ground and even[-1]
        walls = stated or find_walls(even[-1].grey) or walls
    if stated is not None:
        walls = compared_with_bands(walls, (ground or shown).grey)
    found = _detect(shown, ground, walls, direction, by_hand.erased_in_part(picture.shape))
    return found.moved(columns.start, rows.start)


def _detect(
    picture: Picture, background: Picture | None, walls: WallLines, direction: int, erased: Floats | None
) -> Detection:
    """Find a dark capsule between the walls in the part of a picture that is analysed."""
    empty = estimate_background(picture.grey, walls) if background is None else background.grey
    near = walls.rows_around(picture.shape)
    seen = picture.cut((near, slice(None)))
    if erased is not None:
        erased = erased - np.array([0, near.start, 0, near.start])
    return _between(seen, empty[near], walls.moved(0, -near.start), direction, erased).moved(0, near.start)


def _between(picture: Picture, empty: Floats, walls: WallLines, direction: int, erased: Floats | None) -> Detection:
    """Find a dark capsule in the rows of a picture around the walls."""
    between = np.abs(walls.offset(picture.shape)) < walls.half_width
    clipped = picture.grey[picture.clipped & between]
    if len(clipped) > CLIPPED * np.count_nonzero(between):
        return Detection(Status.BLACK if np.median(clipped) <= 0.0 else Status.SATURATED, walls)
    light = transmission(picture.grey, empty)
    noise = pixel_noise(light[between.any(axis=1)])
    found = find_blobs(light, walls, noise, erased)
    blobs = [blob for blob in found if blob.status is not Status.DEBRIS]
    if len(blobs) == 1:
        detection = analyse_blob(light, noise, walls, blobs[0], direction, edge_shift(light, walls, found))
    else:
        detection = Detection(Status.SEVERAL_CAPSULES if blobs else Status.NO_CAPSULE, walls)
    if not detection.status.ok and any(is_shadow(blob, walls, light.shape[1]) for blob in found):
        return replace(detection, status=Status.SHADED)
    dead = np.flatnonzero((picture.clipped | ~between).all(axis=0))
    if len(dead) and np.abs(detection.ends[:, None] - dead).min() < _NEAR:
        return replace(detection, status=Status.DEAD_COLUMN)
    return detection


@checked
def measure(
    picture: str | Path | ArrayLike,
    experiment: Experiment,
    *,
    capsule_velocity: Given | None = None,
    flow_rate: Given | None = None,
    background: str | Path | ArrayLike | None = None,
    flow: str | None = None,
    by_hand: ByHand | None = None,
) -> Measurement:
    """Measure the capsule in a picture.

    Parameters
    ----------
    picture : path or (rows, columns[, colours]) array
        A capsule in a channel along the rows, to 7 degrees.
    experiment : Experiment
    capsule_velocity : Quantity [m/s]
        v_o with its standard error, which one picture does not show; in any form that `Quantity.of`
        reads. It is missing where the flow rate is stated, or the experiment states the viscous tension.
    flow_rate : Quantity, optional [m^3/s]
        Flow rate in the channel with its standard error.
    background : path or array, optional
        The empty channel; by default it is estimated from the picture.
    flow : str, optional
        ``"right"`` or ``"left"``; by default it follows from the shape.
    by_hand : ByHand, optional
        What is stated of walls, scale, the part to analyse and what is wrong in it, as `capsbayes.image.ByHand`; by
        default they are found in the picture.

    Returns
    -------
    Measurement
        Lengths over l, measured against the walls of the same picture, and the silhouette with its noise. L_a is
        missing, with an upper bound, where the concave rear is not seen. Where nothing could be measured, the status
        gives the reason.

    Raises
    ------
    InputError
        If a file is missing or not a picture, `flow` is another word, or what is stated by hand does not suit the
        picture.
    """
    rate = None if flow_rate is None else Quantity.of(flow_rate, "flow_rate", where="measure")
    if capsule_velocity is not None or (rate is None and experiment.viscous_tension is None):
        capsule_velocity = Quantity.of(capsule_velocity, "capsule_velocity", where="measure")
    empty = None if background is None else read_picture(background)
    seen, empty, by_hand = turned(read_picture(picture), empty, by_hand)
    detection = detect(seen, background=empty, flow=flow, by_hand=by_hand, half_width=experiment.half_width)
    return measurement_of(detection, seen, experiment, capsule_velocity, rate)


def turned(
    picture: Picture, background: Picture | None, by_hand: ByHand | None
) -> tuple[Picture, Picture | None, ByHand]:
    """Return picture and background turned as is stated by hand, and what else is stated."""
    by_hand = by_hand or ByHand()
    quarters = by_hand.quarters
    return picture.turned(quarters), background and background.turned(quarters), replace(by_hand, rotate=None)


def measurement_of(
    detection: Detection,
    picture: Picture,
    experiment: Experiment,
    capsule_velocity: Quantity | None,
    flow_rate: Quantity | None = None,
) -> Measurement:
    """Return the measurement that follows from a detection in a picture, refused unless its status is ``DONE``."""
    status = detection.status
    width = experiment.half_width.mean
    speeds = [] if capsule_velocity is None else [capsule_velocity.value]
    if flow_rate is not None:  # a capsule is not slower than the mean flow
        speeds.append(flow_rate.value / (AREAS[experiment.cross_section] * width**2))
    if status.ok and speeds:
        pixel_size = width / float(detection.lengths[3])
        status = Status.SMEARED if smeared(experiment.exposure, speeds[0], pixel_size) else status
    lengths, covariance, outline = detection.lengths, detection.covariance, silhouette_of(detection)
    if status.ok and (camera := experiment.camera) is not None:
        columns = picture.shape[1]
        lengths, covariance = straightened_lengths(detection, columns, camera)
        outline = outline and straightened_silhouette(outline, detection, columns, camera)
    measured = measurement_of_lengths(
        lengths,
        covariance,
        capsule_velocity,
        replace(experiment, camera=None),
        status=status,
        walls=detection.walls.stated if detection.walls else "",
        doubt=detection.walls.doubt if detection.walls else "",
        source=picture.source,
        sha256=picture.sha256,
    )
    return replace(measured, outline=outline).flowing(flow_rate) if status.ok else measured


def measurement_of_lengths(
    lengths: Floats,
    covariance: Floats,
    capsule_velocity: Quantity | None,
    experiment: Experiment,
    *,
    status: Status = Status.DONE,
    walls: str = "",
    doubt: str = "",
    source: str = "",
    sha256: str = "",
) -> Measurement:
    """Return the measurement that follows from lengths in pixels.

    Parameters
    ----------
    lengths : (4,) array [px]
        L_z, L_a, L_p and l; L_a and L_p are NaN where the rear is not seen.
    covariance : (4, 4) array [px^2]
        Covariance of their errors.
    capsule_velocity : Quantity, optional [m/s]
    experiment : Experiment
    status : Status
        Unless it is ``DONE``, the measurement is refused.
    walls, doubt, source, sha256
        As in `Measurement`.

    Raises
    ------
    InputError
        If the experiment states the geometry of the camera, which is for its pictures and not for lengths.
    """
    if experiment.camera is not None:
        expected = "none for a film: single pictures, events and contours alone are corrected"
        raise InputError(experiment.source or "experiment", "camera", expected, experiment.camera.described())
    file = Path(experiment.source) if experiment.source else None
    if not status.ok:
        return Measurement.refused(status, source=source, sha256=sha256, experiment_file=file)
    half_width = lengths[3]
    scale, relative_error = 1.0 / half_width, np.sqrt(covariance[3, 3]) / half_width
    known = [0, 1] if np.isfinite(lengths[1]) else [0]
    scaled = lengths[known] * scale
    spread = covariance[np.ix_(known, known)] * scale**2 + np.outer(scaled, scaled) * relative_error**2
    errors = np.sqrt(np.diag(spread))
    measured = Measurement(
        axial_extent=float(scaled[0]),
        axial_extent_error=float(errors[0]),
        capsule_velocity=None if capsule_velocity is None else capsule_velocity.value,
        capsule_velocity_error=np.nan if capsule_velocity is None else capsule_velocity.error,
        walls=walls,
        doubt=doubt,
        source=source,
        sha256=sha256,
        experiment_file=file,
    )
    if len(known) == 1:
        return replace(measured, axial_length_bound=float(scaled[0] + 2.0 * errors[0]))
    return replace(
        measured,
        axial_length=float(scaled[1]),
        axial_length_error=float(errors[1]),
        length_correlation=float(spread[0, 1] / (errors[0] * errors[1])),
    )


def read_picture(source: str | Path | ArrayLike) -> Picture:
    """Return a picture from a file or an array."""
    return Picture.read(source) if isinstance(source, (str, Path)) else Picture.from_array(source)


def check_flow(flow: str | None) -> int:
    """Return the sign of the flow, 0 if it is None; refuse another word than right or left."""
    if flow is not None and flow not in FLOWS:
        raise InputError("flow", "", " or ".join(f'"{name}"' for name in FLOWS), repr(flow))
    return 0 if flow is None else FLOWS[flow]
