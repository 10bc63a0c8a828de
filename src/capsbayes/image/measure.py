"""One capsule in one picture: its lengths, their errors, and what they were read from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.background import along_the_channel, transmission
from capsbayes.image.contour import pixel_noise
from capsbayes.image.edge_outline import silhouette_of
from capsbayes.image.frames import Picture
from capsbayes.image.sighting import Sighting, sighted
from capsbayes.image.spots import find_spots
from capsbayes.image.wall import find_walls
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity
from capsbayes.status import Status

__all__ = ["FLOWS", "measure", "measurement_of", "measurement_of_lengths", "sight"]

Floats = NDArray[np.float64]

FLOWS = {"right": 1, "left": -1}
CLIPPED = 0.02  # of the pixels between the walls that may be at the end of the camera's scale


def sight(picture: Picture, *, background: Picture | None = None, flow: str | None = None) -> Sighting:
    """Find walls, capsule and concave rear in a picture.

    Parameters
    ----------
    picture : Picture
        A capsule in a channel that runs along the rows, to 7 degrees.
    background : Picture, optional
        The empty channel; by default it is guessed from the picture, line by line along the channel.
    flow : str, optional
        ``"right"`` or ``"left"``; found from the shape by default.

    Returns
    -------
    Sighting
        With the status that says why where nothing could be measured.

    Raises
    ------
    InputError
        On another word for the flow.
    """
    direction = check_flow(flow)
    if background is not None and background.shape != picture.shape:
        return Sighting(Status.BACKGROUND_DIFFERS)
    walls = find_walls((background or picture).grey)
    if walls is None:
        return Sighting(Status.NO_WALLS)
    between = np.abs(walls.offset(picture.shape)) < walls.half_width
    if np.mean(picture.clipped[between]) > CLIPPED:
        return Sighting(Status.SATURATED, walls)
    empty = along_the_channel(picture.grey, walls) if background is None else background.grey
    light = transmission(picture.grey, empty)
    noise = pixel_noise(light[between.any(axis=1)])
    spots = find_spots(light, walls, noise)
    whole = [spot for spot in spots if spot.status is not Status.DEBRIS]
    if len(whole) != 1:
        return Sighting(Status.SEVERAL_CAPSULES if whole else Status.NO_CAPSULE, walls)
    return sighted(light, noise, walls, whole[0], direction)


def measure(
    picture: str | Path | ArrayLike,
    experiment: Experiment,
    *,
    capsule_velocity: Quantity,
    background: str | Path | ArrayLike | None = None,
    flow: str | None = None,
) -> Measurement:
    """Measure the capsule in a picture.

    Parameters
    ----------
    picture : path or (rows, columns[, colours]) array
        A capsule in a channel that runs along the rows, to 7 degrees.
    experiment : Experiment
        Its channel.
    capsule_velocity : Quantity [m/s]
        v_o with its standard error, which one picture does not show.
    background : path or array, optional
        The empty channel; by default it is guessed from the picture.
    flow : str, optional
        ``"right"`` or ``"left"``; found from the shape by default.

    Returns
    -------
    Measurement
        Lengths over l, measured against the walls of the same picture, and the silhouette with its noise. L_a is
        missing, with an upper bound, where the concave rear is not seen. Where nothing could be measured, the status
        says why.

    Raises
    ------
    InputError
        If a file is missing or no picture, or on another word for the flow.
    """
    seen = read_picture(picture)
    sighting = sight(seen, background=None if background is None else read_picture(background), flow=flow)
    return measurement_of(sighting, seen, experiment, capsule_velocity)


def measurement_of(
    sighting: Sighting, picture: Picture, experiment: Experiment, capsule_velocity: Quantity
) -> Measurement:
    """The measurement that follows from what was found in a picture.

    Parameters
    ----------
    sighting : Sighting
    picture : Picture
        Where it was found.
    experiment : Experiment
        Its channel.
    capsule_velocity : Quantity [m/s]

    Returns
    -------
    Measurement
    """
    named = Path(experiment.source) if experiment.source else None
    if not sighting.status.ok:
        return Measurement.refused(sighting.status, source=picture.source, sha256=picture.sha256, experiment_file=named)
    measured = measurement_of_lengths(
        sighting.lengths,
        sighting.covariance,
        capsule_velocity,
        source=picture.source,
        sha256=picture.sha256,
        experiment_file=named,
    )
    return replace(measured, outline=silhouette_of(sighting))


def measurement_of_lengths(
    lengths: Floats,
    covariance: Floats,
    capsule_velocity: Quantity,
    *,
    pixel_size: Quantity | None = None,
    source: str = "",
    sha256: str = "",
    experiment_file: Path | None = None,
) -> Measurement:
    """The measurement that follows from lengths in pixels.

    Parameters
    ----------
    lengths : (4,) array [px]
        L_z, L_a, L_p and l; L_a and L_p are NaN where the rear is not seen.
    covariance : (4, 4) array [px^2]
        Of their errors.
    capsule_velocity : Quantity [m/s]
    pixel_size : Quantity, optional [m]
        The lengths are then in metres; otherwise over l, measured in the same picture.
    source, sha256, experiment_file
        As in `Measurement`.

    Returns
    -------
    Measurement
    """
    half_width = lengths[3]
    unit, share = 1.0 / half_width, np.sqrt(covariance[3, 3]) / half_width
    if pixel_size is not None:
        unit, share = pixel_size.value, pixel_size.error / pixel_size.value
    known = [0, 1] if np.isfinite(lengths[1]) else [0]
    scaled = lengths[known] * unit
    spread = covariance[np.ix_(known, known)] * unit**2 + np.outer(scaled, scaled) * share**2
    errors = np.sqrt(np.diag(spread))
    measured = Measurement(
        axial_extent=float(scaled[0]),
        axial_extent_error=float(errors[0]),
        capsule_velocity=capsule_velocity.value,
        capsule_velocity_error=capsule_velocity.error,
        over_half_width=pixel_size is None,
        source=source,
        sha256=sha256,
        experiment_file=experiment_file,
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
    """A picture from a file or an array."""
    return Picture.read(source) if isinstance(source, (str, Path)) else Picture.from_array(source)


def check_flow(flow: str | None) -> int:
    """The flow as a sign, 0 if it is not given; another word is refused."""
    if flow is not None and flow not in FLOWS:
        raise InputError("flow", "", " or ".join(f'"{name}"' for name in FLOWS), repr(flow))
    return 0 if flow is None else FLOWS[flow]
