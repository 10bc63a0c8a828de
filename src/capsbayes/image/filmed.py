"""One capsule of a film: what was seen of it in each frame, its velocity, and the measurement that follows."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capsbayes.experiment import Experiment
from capsbayes.image.frames import Picture
from capsbayes.image.integrals import centroid, centroid_variance
from capsbayes.image.measure import measurement_of_lengths
from capsbayes.image.motion import Drift, Velocity, drift, velocity
from capsbayes.image.sighting import Sighting
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity
from capsbayes.status import Status

__all__ = ["FilmedCapsule", "Moment", "Record"]

Floats = NDArray[np.float64]

_FEWEST = 3  # frames that give a velocity and its error
_SAMPLING = 0.005  # px: no centroid is placed better than that in a picture sampled at whole pixels


@dataclass(frozen=True, eq=False)
class Moment:
    """What was seen of a capsule in one frame.

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
    covariance, lasting : (4, 4) array [px^2]
        Of their errors, and the part of it that is the same in all frames.
    """

    frame: int
    place: Floats
    place_variance: float
    lengths: Floats
    covariance: Floats
    lasting: Floats


@dataclass(eq=False)
class Record:
    """Sightings of one spot while the film runs.

    Parameters
    ----------
    statuses : Counter of Status
        Over the frames.
    moments : list of Moment
        Where it was measured.
    picture, sighting, frame
        Of these, that nearest to the middle of the picture.
    """

    statuses: Counter[Status] = field(default_factory=Counter)
    moments: list[Moment] = field(default_factory=list)
    picture: Picture | None = None
    sighting: Sighting | None = None
    frame: int = 0

    def add(self, frame: int, picture: Picture, sighting: Sighting) -> None:
        """Enter what was seen in one more frame."""
        self.statuses[sighting.status] += 1
        if not sighting.status.ok:
            if self.picture is None:
                self.picture, self.sighting, self.frame = picture, sighting, frame
            return
        walls, outline = sighting.walls, sighting.outline
        assert walls is not None
        assert outline is not None
        middle = centroid(outline.points)
        place = np.array([middle @ walls.along, middle @ walls.across])
        variance = centroid_variance(outline, walls.along) + _SAMPLING**2
        moment = Moment(frame, place, variance, sighting.lengths, sighting.covariance, sighting.lasting_covariance)
        off = [abs(float(one.place[0]) - walls.middle) for one in (*self.moments, moment)]
        if off[-1] <= min(off):
            self.picture, self.sighting, self.frame = picture, sighting, frame
        self.moments.append(moment)


@dataclass(frozen=True, eq=False)
class FilmedCapsule:
    """A capsule followed through a film.

    Parameters
    ----------
    status : Status
        ``DONE``, or why it was refused.
    statuses : Counter of Status
        Of the frames it was seen in.
    moments : tuple of Moment
        Of those in which it was measured.
    velocity : Velocity, optional
    drifts : dict of str to Drift
        Of ``"L_z"``, ``"L_a"`` and ``"v_o"`` along the channel.
    repeat_error : (4,) array [px]
        Scatter of L_z, L_a, L_p and l from frame to frame.
    measurement : Measurement
        The mean over the frames; refused unless the status is ``DONE``.
    picture, sighting, frame
        One of the frames, and what was found in it.
    """

    status: Status
    statuses: Counter[Status]
    moments: tuple[Moment, ...] = field(repr=False)
    velocity: Velocity | None
    drifts: dict[str, Drift]
    repeat_error: Floats
    measurement: Measurement
    picture: Picture | None = field(repr=False)
    sighting: Sighting | None = field(repr=False)
    frame: int

    @classmethod
    def of(cls, record: Record, experiment: Experiment, frame_rate: Quantity, film: Path, sha256: str) -> FilmedCapsule:
        """The mean of a record, and the tests of it.

        Parameters
        ----------
        record : Record
        experiment : Experiment
            Its half width is the length of a pixel.
        frame_rate : Quantity [1/s]
        film : Path
        sha256 : str
            Of the film.

        Returns
        -------
        FilmedCapsule
        """
        moments = tuple(record.moments)
        named = Path(experiment.source) if experiment.source else None
        if len(moments) < _FEWEST:
            refused = [one for one in record.statuses.most_common() if not one[0].ok]
            status = refused[0][0] if refused and refused[0][1] > len(moments) else Status.FEW_FRAMES
            nothing = Measurement.refused(status, source=str(film), sha256=sha256, experiment_file=named)
            return cls(status, record.statuses, moments, None, {}, np.full(4, np.nan), nothing, *_shown(record))
        speed, drifts = _motion(moments)
        status = Status.UNSTEADY if any(one.unsteady for one in drifts.values()) else Status.DONE
        lengths, covariance, repeat = _mean(moments, drifts)
        if status.ok:
            measured = measurement_of_lengths(
                lengths,
                covariance,
                _in_si(speed, lengths[3], covariance[3, 3], experiment, frame_rate),
                source=str(film),
                sha256=sha256,
                experiment_file=named,
            )
        else:
            measured = Measurement.refused(status, source=str(film), sha256=sha256, experiment_file=named)
        return cls(status, record.statuses, moments, speed, drifts, repeat, measured, *_shown(record))


def _shown(record: Record) -> tuple[Picture | None, Sighting | None, int]:
    return record.picture, record.sighting, record.frame


def _motion(moments: tuple[Moment, ...]) -> tuple[Velocity, dict[str, Drift]]:
    frames = np.array([float(one.frame) for one in moments])
    along = np.array([one.place[0] for one in moments])
    speed = velocity(frames, along, np.array([one.place_variance for one in moments]))
    drifts = {} if speed.drift is None else {"v_o": speed.drift}
    lengths = np.array([one.lengths for one in moments])
    alone = np.array([np.diag(one.covariance - one.lasting) for one in moments])
    for index, name in enumerate(("L_z", "L_a")):
        seen = np.isfinite(lengths[:, index])
        if seen.sum() >= _FEWEST:
            drifts[name] = drift(along[seen], lengths[seen, index], alone[seen, index])
    return speed, drifts


def _mean(moments: tuple[Moment, ...], drifts: dict[str, Drift]) -> tuple[Floats, Floats, Floats]:
    """Mean lengths, covariance of their errors, and scatter from frame to frame [px, px^2, px].

    The mean over frames has the error of their scatter, or of the noise if this is larger, and that which all frames
    share: misfit of the edge's model, walls, and a change along the channel that is significant but negligible.
    Where the rear is seen in half of the frames, all lengths are taken from these.
    """
    with_rear = [one for one in moments if np.isfinite(one.lengths[1])]
    used = with_rear if 2 * len(with_rear) >= len(moments) and len(with_rear) >= _FEWEST else list(moments)
    lengths = np.array([one.lengths for one in used])
    if used is not with_rear:
        lengths[:, 1:3] = np.nan
    mean = lengths.mean(axis=0)
    lasting = np.mean([one.lasting for one in used], axis=0)
    alone = np.mean([one.covariance for one in used], axis=0) - lasting
    expected = np.sqrt(np.diag(alone))
    scatter = lengths.std(axis=0, ddof=1)
    raised = np.where(scatter > expected, scatter / np.where(expected > 0.0, expected, 1.0), 1.0)
    on_the_way = np.array([_unnoticed(drifts.get(name)) for name in ("L_z", "L_a")] + [0.0, 0.0]) * mean
    covariance = alone * np.outer(raised, raised) / len(used) + lasting + np.diag(np.nan_to_num(on_the_way) ** 2)
    return mean, covariance, scatter


def _unnoticed(one: Drift | None) -> float:
    """Standard deviation, over the mean, of a quantity that changes evenly on the way."""
    return abs(one.change) / np.sqrt(12.0) if one is not None and one.significant else 0.0


def _in_si(speed: Velocity, l_px: float, l_variance: float, experiment: Experiment, frame_rate: Quantity) -> Quantity:
    """Velocity in metres a second, with the errors of the length of a pixel and of the frame rate."""
    metres, spread = experiment.half_width.mean, experiment.half_width.sd
    value = abs(speed.value) * metres / l_px * frame_rate.value
    change = 0.0 if speed.drift is None else _unnoticed(speed.drift)
    shares = (
        speed.error / speed.value,
        np.sqrt(l_variance) / l_px,
        spread / metres,
        frame_rate.error / frame_rate.value,
        change,
    )
    return Quantity(float(value), float(value * np.sqrt(np.sum(np.square(shares)))), "m/s")
