"""One capsule in one picture: its lengths, their errors, and what they were read from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.background import along_the_channel, transmission
from capsbayes.image.contour import Outline, find_capsule, pixel_noise, sharpened
from capsbayes.image.extent import Extreme, furthest
from capsbayes.image.frames import Picture
from capsbayes.image.rear import RearBand, find_rear
from capsbayes.image.wall import Walls, find_walls
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity
from capsbayes.status import Status

__all__ = ["Sighting", "measure", "sight"]

Floats = NDArray[np.float64]

FLOWS = {"right": 1, "left": -1}
_CLIPPED = 0.02  # of the pixels between the walls that may be at the end of the camera's scale
_ASYMMETRY = 0.005  # of the length: a centroid nearer to the middle does not tell front from rear
# 1/px: how far the edge found may lie from the true one, over its width squared; at the end more, as a concave rear
# darkens what lies behind it. Both were set on drawn pictures, other ones than those that the coverage is counted on.
_NOSE_MISFIT, _END_MISFIT = 0.012, 0.033


@dataclass(frozen=True, eq=False)
class Sighting:
    """What was found in a picture, in pixels.

    Parameters
    ----------
    status : Status
        ``DONE``, or why there is nothing to measure; then what could not be found is None.
    walls : Walls, optional
    outline : Outline, optional
    flow : int
        1 to the right, -1 to the left, 0 if the shape does not tell.
    nose, end : Extreme, optional
        Furthest points downstream and upstream, as distances along the flow from the picture's origin.
    rear : RearBand, optional
        The concave rear where it is seen.
    """

    status: Status
    walls: Walls | None = None
    outline: Outline | None = None
    flow: int = 0
    nose: Extreme | None = None
    end: Extreme | None = None
    rear: RearBand | None = None

    @property
    def axis(self) -> Floats:
        """Point (x, y) of the capsule's axis nearest to the picture's origin : (2,) array [px]; NaN where missing."""
        if self.walls is None or self.outline is None:
            return np.full(2, np.nan)
        across = self.outline.points @ self.walls.across
        return np.asarray(0.5 * (across.max() + across.min()) * self.walls.across)

    @property
    def lengths(self) -> Floats:
        """L_z, L_a, L_p and l : (4,) array [px]; NaN where missing."""
        if self.walls is None or self.nose is None or self.end is None:
            return np.full(4, np.nan)
        extent = self.nose.distance + self.end.distance
        depth = np.nan if self.rear is None else self.rear.depth
        return np.array([extent, extent - depth, depth, self.walls.half_width])

    @property
    def covariance(self) -> Floats:
        """Covariance of the errors of `lengths` : (4, 4) array [px^2]."""
        if self.walls is None or self.nose is None or self.end is None:
            return np.full((4, 4), np.nan)
        # the rays that find the rear start at the end of the silhouette as found: its error is none of the rear's
        behind = np.nan if self.rear is None else self.rear.depth_error**2
        nose, end, wall = self.nose.variance, self.end.variance, self.walls.half_width_error**2
        return np.array(
            [
                [nose + end, nose, end, 0.0],
                [nose, nose + behind, -behind, 0.0],
                [end, -behind, end + behind, 0.0],
                [0.0, 0.0, 0.0, wall],
            ]
        )


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
    if flow is not None and flow not in FLOWS:
        raise InputError("flow", "", " or ".join(f'"{name}"' for name in FLOWS), repr(flow))
    if background is not None and background.shape != picture.shape:
        return Sighting(Status.BACKGROUND_DIFFERS)
    walls = find_walls((background or picture).grey)
    if walls is None:
        return Sighting(Status.NO_WALLS)
    between = np.abs(walls.offset(picture.shape)) < walls.half_width
    if np.mean(picture.clipped[between]) > _CLIPPED:
        return Sighting(Status.SATURATED, walls)
    empty = along_the_channel(picture.grey, walls) if background is None else background.grey
    light = transmission(picture.grey, empty)
    noise = pixel_noise(light[between.any(axis=1)])
    status, polygon = find_capsule(light, walls, noise)
    if polygon is None:
        return Sighting(status, walls)
    outline = sharpened(light, polygon, noise)
    if outline is None:
        return Sighting(Status.NO_EDGE, walls)
    found = _found_flow(outline, walls)
    if flow is not None and found == -FLOWS[flow]:
        return Sighting(Status.WRONG_FLOW, walls, outline, found)
    direction = FLOWS[flow] if flow is not None else found
    return _measured(light, noise, Sighting(Status.DONE, walls, outline, direction))


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
        Lengths over l, measured against the walls of the same picture. L_a is missing, with an upper bound, where the
        concave rear is not seen. Where nothing could be measured, the status says why.

    Raises
    ------
    InputError
        If a file is missing or no picture, or on another word for the flow.
    """
    seen = _picture(picture)
    sighting = sight(seen, background=None if background is None else _picture(background), flow=flow)
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
    extent, length, _, half_width = sighting.lengths
    # errors of L/l: those of the lengths, and that of l in both
    jacobian = np.array([[1.0, 0.0, 0.0, -extent / half_width], [0.0, 1.0, 0.0, -length / half_width]]) / half_width
    used = [0, 3] if sighting.rear is None else [0, 1, 3]
    jacobian = jacobian[: len(used) - 1, used]
    covariance = jacobian @ sighting.covariance[np.ix_(used, used)] @ jacobian.T
    errors = np.sqrt(np.diag(covariance))
    measured = Measurement(
        axial_extent=float(extent / half_width),
        axial_extent_error=float(errors[0]),
        capsule_velocity=capsule_velocity.value,
        capsule_velocity_error=capsule_velocity.error,
        source=picture.source,
        sha256=picture.sha256,
        experiment_file=named,
    )
    if sighting.rear is None:
        return replace(measured, axial_length_bound=float(extent / half_width + 2.0 * errors[0]))
    return replace(
        measured,
        axial_length=float(length / half_width),
        axial_length_error=float(errors[1]),
        length_correlation=float(covariance[0, 1] / (errors[0] * errors[1])),
    )


def _picture(source: str | Path | ArrayLike) -> Picture:
    return Picture.read(source) if isinstance(source, (str, Path)) else Picture.from_array(source)


def _found_flow(outline: Outline, walls: Walls) -> int:
    """Direction of the flow from the shape: the rear is blunt, so the centroid lies on its side of the middle."""
    x, y = outline.points.T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    centroid = np.array([np.sum((one + np.roll(one, -1)) * cross) for one in (x, y)]) / (3.0 * np.sum(cross))
    along = outline.points @ walls.along
    lead = (0.5 * (along.max() + along.min()) - centroid @ walls.along) / np.ptp(along)
    return 0 if abs(lead) < _ASYMMETRY else int(np.sign(lead))


def _measured(light: Floats, noise: float, sighting: Sighting) -> Sighting:
    """Add the ends and the rear; a shape that tells no direction has no concave rear to look for."""
    walls, outline = sighting.walls, sighting.outline
    assert walls is not None
    assert outline is not None
    downstream = (sighting.flow or 1) * walls.along
    nose = furthest(outline, downstream, _NOSE_MISFIT)
    end = furthest(outline, -downstream, _END_MISFIT)
    sighting = replace(sighting, nose=nose, end=end)
    if sighting.flow == 0:
        return sighting
    half_height = 0.5 * float(np.ptp(outline.points @ walls.across))
    start = sighting.axis - end.distance * downstream
    flank = np.abs(outline.normals @ walls.across) > 0.8
    blur = float(np.median(outline.edge_width[flank])) if flank.any() else float(np.median(outline.edge_width))
    rear = find_rear(light, start, downstream, nose.distance + end.distance, half_height, blur, noise)
    return replace(sighting, rear=rear)
