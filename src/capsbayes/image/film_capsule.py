"""One capsule of a film: its measurement in each frame, its velocity, and the measurement that follows from all."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from capsbayes.arrays import Booleans, Floats
from capsbayes.experiment import Experiment
from capsbayes.image.detection import Detection
from capsbayes.image.edges.integrals import centroid, centroid_variance
from capsbayes.image.files.picture import Picture
from capsbayes.image.film_silhouette import AlignedOutlines, FrameOutline
from capsbayes.image.measure import measurement_of_lengths
from capsbayes.image.motion import Drift, Velocity, drift, smeared, times_of, velocity
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd

_LENGTHS = "L_z", "L_a"
_FEWEST = 3  # frames that give a velocity and its error
_UNLIKE = 0.2  # of the frames: more that disagree with the others are no chance, but another shape
_SAMPLING = 0.005  # px: no centroid is located better than that in a picture sampled at whole pixels


@dataclass(frozen=True, eq=False)
class FrameMeasurement:
    """Place and lengths of a capsule in one frame.

    Parameters
    ----------
    frame : int
        From 0.
    place : (2,) array [px]
        Of the centroid, along and across the channel.
    place_variance : float [px^2]
        Of its error along.
    lengths : (4,) array [px]
        L_z, L_a, L_p and l; NaN where missing.
    covariance, systematic : (4, 4) array [px^2]
        Of their errors, and the part of it that is the same in all frames.
    outline : FrameOutline
    """

    frame: int
    place: Floats
    place_variance: float
    lengths: Floats
    covariance: Floats
    systematic: Floats
    outline: FrameOutline = field(repr=False)


@dataclass(eq=False)
class FrameRecord:
    """Detections of one capsule in the frames of a film.

    Parameters
    ----------
    statuses : Counter of Status
        Of the frames that show it.
    measured : list of FrameMeasurement
        Of those in which it was measured.
    picture, detection, frame
        The one of these that shows it nearest to the middle of the picture, or the first that shows it.
    """

    statuses: Counter[Status] = field(default_factory=Counter)
    measured: list[FrameMeasurement] = field(default_factory=list)
    picture: Picture | None = field(default=None, repr=False)
    detection: Detection | None = field(default=None, repr=False)
    frame: int = 0
    _nearest: float = field(default=math.inf, repr=False)

    def add(self, frame: int, picture: Picture, detection: Detection) -> None:
        """Add the detection in one more frame."""
        self.statuses[detection.status] += 1
        if not detection.status.ok:
            if self.picture is None:
                self.picture, self.detection, self.frame = picture.packed(), detection, frame
            return
        walls, outline = detection.walls, detection.outline
        assert walls is not None
        assert outline is not None
        middle = centroid(outline.points)
        place = np.array([middle @ walls.along, middle @ walls.across])
        variance = centroid_variance(outline, walls.along) + _SAMPLING**2
        self.measured.append(
            FrameMeasurement(
                frame,
                place,
                variance,
                detection.lengths,
                detection.covariance,
                detection.systematic_covariance,
                FrameOutline.of(detection),
            )
        )
        distance = abs(float(place[0]) - walls.centre_column)
        if distance <= self._nearest:
            self.picture, self.detection, self.frame, self._nearest = picture, detection, frame, distance
        elif self.picture is not None and self.picture.grey.dtype == np.float64:  # it has passed the middle
            self.picture = self.picture.packed()


@dataclass(frozen=True, eq=False)
class FilmCapsule:
    """A capsule followed through a film.

    Parameters
    ----------
    status : Status
        ``DONE``, or why it was refused.
    record : FrameRecord
    velocity : Velocity, optional
    drifts : dict of str to Drift
        Of ``"L_z"``, ``"L_a"`` and ``"v_o"`` along the channel.
    repeat_error : (4,) array [px]
        Scatter of L_z, L_a, L_p and l from frame to frame.
    measurement : Measurement
        The means of lengths and outline over the frames that agree; refused unless the status is ``DONE``.
    alike : (n,) array of bool
        Which of the frames in which it was measured agree with the others.
    """

    status: Status
    record: FrameRecord = field(repr=False)
    velocity: Velocity | None
    drifts: dict[str, Drift]
    repeat_error: Floats
    measurement: Measurement
    alike: Booleans

    @classmethod
    def of(
        cls,
        record: FrameRecord,
        experiment: Experiment,
        frame_rate: Quantity,
        pixel_size: Quantity | None,
        film: Path,
        sha256: str,
    ) -> FilmCapsule:
        """Return the mean of a record, refused unless it is steady; the frame rate is in 1/s.

        The size of a pixel [m] is that stated by hand; by default it follows from the walls and the half width.
        """
        frames = record.measured
        speed, drifts, outlines = None, dict[str, Drift](), None
        lengths, covariance, repeat = np.full(4, np.nan), np.full((4, 4), np.nan), np.full(4, np.nan)
        alike = np.ones(len(frames), dtype=bool)
        capsule_velocity = Quantity(np.nan, np.nan, "m/s")
        if len(frames) < _FEWEST:
            reasons = [(status, count) for status, count in record.statuses.most_common() if not status.ok]
            status = reasons[0][0] if reasons and reasons[0][1] > len(frames) else Status.FEW_FRAMES
        else:
            speed, drifts = _motion(frames)
            outlines = AlignedOutlines.of([measured.outline for measured in frames])
            alike = outlines.alike
            status = _steady(alike, drifts)
            used = [measured for measured, kept in zip(frames, alike, strict=True) if kept] if status.ok else frames
            lengths, covariance, repeat = _mean(used, drifts)
            size = pixel_size or _pixel_size(lengths[3], covariance[3, 3], experiment)
            capsule_velocity = _in_si(speed, size, frame_rate)
            if status.ok and smeared(experiment.exposure, capsule_velocity.value, size.value):
                status = Status.SMEARED
        walls = None if record.detection is None else record.detection.walls
        measured = measurement_of_lengths(
            lengths,
            covariance,
            capsule_velocity,
            experiment,
            status=status,
            walls="" if walls is None else walls.stated,
            doubt="" if walls is None else walls.doubt,
            source=str(film),
            sha256=sha256,
        )
        if status.ok and outlines is not None and speed is not None and walls is not None:
            change = 0.5 * lengths[0] * _unmodelled_error(drifts, "L_z")  # of either end
            silhouette = outlines.taken(alike).sharpest().silhouette(walls, int(np.sign(speed.value)), change)
            measured = replace(measured, outline=silhouette)
        return cls(status, record, speed, drifts, repeat, measured, alike)

    def table(self) -> pd.DataFrame:
        """Tabulate the frames in which the capsule was measured.

        Returns
        -------
        DataFrame
            One row a frame: ``frame``; in pixels ``along_px``, ``across_px``, ``axial_extent_px``, ``axial_length_px``
            and ``half_width_px``; and ``alike``, whether its outline agrees with those of the other frames.
        """
        import pandas as pd

        columns = ("frame", "along_px", "across_px", "axial_extent_px", "axial_length_px", "half_width_px", "alike")
        rows = [
            (measured.frame, *measured.place, *measured.lengths[[0, 1, 3]], bool(alike))
            for measured, alike in zip(self.record.measured, self.alike, strict=True)
        ]
        return pd.DataFrame(rows, columns=columns)


def _steady(alike: Booleans, drifts: dict[str, Drift]) -> Status:
    """Return whether a capsule is steady by its changes along the channel, and enough of its frames agree."""
    unlike = np.count_nonzero(~alike)
    if any(drift.unsteady for drift in drifts.values()) or unlike > max(1.0, _UNLIKE * len(alike)):
        return Status.UNSTEADY
    return Status.DONE if len(alike) - unlike >= _FEWEST else Status.FEW_FRAMES


def _motion(frames: list[FrameMeasurement]) -> tuple[Velocity, dict[str, Drift]]:
    numbers = np.array([float(measured.frame) for measured in frames])
    along = np.array([measured.place[0] for measured in frames])
    variance = np.array([measured.place_variance for measured in frames])
    speed = velocity(times_of(numbers, along, variance), along, variance)
    drifts = {} if speed.drift is None else {"v_o": speed.drift}
    lengths = np.array([measured.lengths for measured in frames])
    random = np.array([np.diag(measured.covariance - measured.systematic) for measured in frames])
    for index, name in enumerate(_LENGTHS):
        seen = np.isfinite(lengths[:, index])
        if seen.sum() >= _FEWEST:
            drifts[name] = drift(along[seen], lengths[seen, index], random[seen, index])
    return speed, drifts


def _mean(frames: list[FrameMeasurement], drifts: dict[str, Drift]) -> tuple[Floats, Floats, Floats]:
    """Return mean lengths, covariance of their errors, and scatter from frame to frame [px, px^2, px].

    The error of the mean is that of the scatter, or of the noise if this is larger, and the part that all frames share:
    misfit of the edge's model, walls, and the changes along the channel if one is significant but negligible. If the
    rear is seen in half of the frames, all lengths are taken from these.
    """
    with_rear = [measured for measured in frames if np.isfinite(measured.lengths[1])]
    used = with_rear if 2 * len(with_rear) >= len(frames) and len(with_rear) >= _FEWEST else frames
    lengths = np.array([measured.lengths for measured in used])
    if used is not with_rear:
        lengths[:, 1:3] = np.nan
    mean = lengths.mean(axis=0)
    systematic = np.mean([measured.systematic for measured in used], axis=0)
    random = np.mean([measured.covariance for measured in used], axis=0) - systematic
    expected = np.sqrt(np.diag(random))
    scatter = lengths.std(axis=0, ddof=1)
    raised = np.where(scatter > expected, scatter / np.where(expected > 0.0, expected, 1.0), 1.0)
    covariance = random * np.outer(raised, raised) / len(used) + systematic
    for index, name in enumerate(_LENGTHS):
        covariance[index, index] += np.nan_to_num(_unmodelled_error(drifts, name) * mean[index]) ** 2
    return mean, covariance, scatter


def _unmodelled_error(drifts: dict[str, Drift], name: str) -> float:
    """Return the error of a length, over its mean, for its change along the channel, if one of them is significant."""
    significant = any(drifts[each].significant for each in _LENGTHS if each in drifts)
    return abs(drifts[name].change) if significant and name in drifts else 0.0


def _pixel_size(l_px: float, l_variance: float, experiment: Experiment) -> Quantity:
    """Return the size of a pixel [m]: the half width in metres over that between the walls."""
    width = experiment.half_width
    size = width.mean / l_px
    return Quantity(float(size), float(size * np.hypot(np.sqrt(l_variance) / l_px, width.sd / width.mean)), "m")


def _in_si(speed: Velocity, pixel_size: Quantity, frame_rate: Quantity) -> Quantity:
    """Return the velocity in m/s, with the errors of the size of a pixel and of the frame rate."""
    value = abs(speed.value) * pixel_size.value * frame_rate.value
    relative_errors = (
        speed.error / speed.value,
        pixel_size.error / pixel_size.value,
        frame_rate.error / frame_rate.value,
        0.0 if speed.drift is None else speed.drift.unmodelled_error,
    )
    return Quantity(float(value), float(value * np.sqrt(np.sum(np.square(relative_errors)))), "m/s")
