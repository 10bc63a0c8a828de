"""One capsule in the frames of a film: followed, its lengths, velocity and mean outline."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from capsbayes.arrays import Booleans, Floats
from capsbayes.experiment import Experiment
from capsbayes.image.background import Blob
from capsbayes.image.detect import Detection
from capsbayes.image.edge_models import robust_spread
from capsbayes.image.edges import ARC, AVERAGED, centroid, centroid_variance, scatter_left
from capsbayes.image.files import Picture
from capsbayes.image.measure import EdgeErrors, asymmetry_of, measurement_of_lengths, over_l
from capsbayes.image.motion import Drift, Velocity, drift, repeated, smeared, times_of, velocity
from capsbayes.image.walls import WallLines
from capsbayes.measurement import MeasuredOutline, Measurement
from capsbayes.profile import arc_length, signed_area, vertex_normals
from capsbayes.quantity import Quantity
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd


# Capsules move in single file at almost one velocity and keep their size: each is sought at the place predicted by its
# own velocity, or by that of the last capsule. The first step is the shortest one downstream between blobs of one size;
# where capsules move by more than half their distance between two frames, it needs the direction of the flow

_SIZES = 1.3  # largest ratio of the areas of one blob in two frames
_ACROSS = 0.25  # l: largest displacement across the channel
_ASTRAY = 0.5  # of the blob's size: largest distance from the predicted place
_UNCERTAIN = 0.2  # of the displacement since the last frame, added to it: a velocity from few frames is rough
_LOST = 3  # frames without the blob after which a track ends
_FAR = 1e9


@dataclass(eq=False)
class Track:
    """Places of one blob."""

    frames: list[int] = field(default_factory=list)
    places: list[Floats] = field(default_factory=list)  # (2,) [px]: along and across the channel
    area: float = 0.0  # [px^2]: of the blob in the last of these frames

    @property
    def velocity(self) -> float | None:
        """Velocity along the channel [px per frame], None in the first frame."""
        if len(self.frames) < 2:
            return None
        return float(self.places[-1][0] - self.places[0][0]) / (self.frames[-1] - self.frames[0])


class Linker:
    """Tracks of all blobs of a film."""

    def __init__(self, walls: WallLines, flow: int = 0) -> None:
        self.walls, self.flow = walls, flow
        self._open: list[Track] = []
        self._velocity: float | None = None

    @property
    def direction(self) -> int:
        """The flow as given, or else as the blobs moved: 1, -1, or 0 before any moved."""
        return self.flow or (0 if self._velocity is None else int(np.sign(self._velocity)))

    def link(self, frame: int, blobs: list[Blob]) -> list[Track | None]:
        """Add the blobs of a frame; return the track of each, None for one that the border cuts."""
        self._open = [track for track in self._open if frame - track.frames[-1] <= _LOST]
        whole = [index for index, blob in enumerate(blobs) if blob.status is not Status.TOUCHES_BORDER]
        places = {index: self._place(blobs[index]) for index in whole}
        cost = np.array([[self._cost(track, frame, blobs[i], places[i]) for i in whole] for track in self._open])
        linked: list[Track | None] = [None] * len(blobs)
        if cost.size:
            for row, column in zip(*linear_sum_assignment(cost), strict=True):
                if cost[row, column] < _FAR:
                    linked[whole[column]] = self._open[row]
        for index in whole:
            track = linked[index] or Track()
            if not track.frames:
                self._open.append(track)
            track.frames.append(frame)
            track.places.append(places[index])
            track.area = blobs[index].area
            self._velocity = track.velocity or self._velocity
            linked[index] = track
        return linked

    def _place(self, blob: Blob) -> Floats:
        return np.array([blob.middle @ self.walls.along, blob.middle @ self.walls.across])

    def _cost(self, track: Track, frame: int, blob: Blob, place: Floats) -> float:
        """Return the distance from the predicted place, `_FAR` if the blob cannot belong to the track."""
        step, sideways = place - track.places[-1]
        alike = max(blob.area, track.area) < _SIZES * min(blob.area, track.area)
        if not alike or abs(sideways) > _ACROSS * self.walls.half_width or step * self.direction < 0.0:
            return _FAR
        passed = frame - track.frames[-1]
        velocity = self._velocity if track.velocity is None else track.velocity
        if velocity is None:
            return abs(float(step))
        distance = abs(float(step - velocity * passed))
        size = 2.0 * float(np.sqrt(track.area / np.pi))
        return distance if distance < _ASTRAY * size + _UNCERTAIN * abs(velocity) * passed else _FAR


# Outlines of frames are laid onto each other by least squares, as the likelihood leaves place and tilt open too. The
# mean has less noise; the misfit of the edge's model, the pixels and the walls do the same in all frames, and stay

_PARABOLA = np.array([-3.0, 12.0, 17.0, 12.0, -3.0]) / 35.0  # weights of five points in the middle of their parabola
# of an arc's error, the same in all frames: noise biases fits, as L_z by 0.13 px where 5 % of it scatter it by 0.19 px
_BIAS = 0.5
_SAMPLING = 0.005  # px: no centroid is located better than that in a picture sampled at whole pixels
_ROUNDS = 3  # of laying outlines onto each other; the third changes nothing that is seen
_FEWEST_ARCS = 8
_UNLIKE_ARC = 6.0  # robust standard deviations of an arc: of 2,000 frames without a fault no arc is that far off


@dataclass(frozen=True, eq=False)
class FrameMeasurement:
    """Place, lengths and outline of a capsule in one frame."""

    frame: int  # from 0
    place: Floats  # (2,) [px]: of the centroid, along and across the channel
    place_variance: float  # [px^2]: of its error along
    lengths: Floats  # (4,) [px]: L_z, L_a, L_p and l; NaN where missing
    covariance: Floats  # (4, 4) [px^2]: of their errors
    systematic: Floats  # (4, 4) [px^2]: the part of it that is the same in all frames
    points: Floats = field(repr=False)  # (n, 2) [px]: along and across the channel, the latter from its middle
    errors: EdgeErrors  # of the points

    @classmethod
    def of(cls, frame: int, detection: Detection) -> FrameMeasurement:
        """Return what a detection that is done measured."""
        walls, outline = detection.located()
        axes = np.stack([walls.along, walls.across], axis=1)
        points = (outline.points - walls.middle) @ axes
        points = points if signed_area(points) > 0.0 else points[::-1]  # counter-clockwise
        middle = centroid(outline.points)
        return cls(
            frame,
            np.array([middle @ walls.along, middle @ walls.across]),
            centroid_variance(outline, walls.along) + _SAMPLING**2,
            detection.lengths,
            detection.covariance,
            detection.systematic_covariance,
            points.astype(np.float32),
            EdgeErrors.of(detection),
        )


@dataclass(frozen=True, eq=False)
class AlignedOutlines:
    """Outlines of a capsule in several frames on common directions, laid onto each other."""

    radii: Floats  # (n, m) [px]: of each frame, in each direction from the middle of the capsule
    directions: Floats  # (m, 2): unit vectors
    farthest: Floats  # (m,) [px]: largest distance of the points in each direction from the middle of the channel
    errors: tuple[EdgeErrors, ...]  # of each frame

    @classmethod
    def of(cls, frames: Sequence[FrameMeasurement]) -> AlignedOutlines:
        """Lay the outlines of frames onto each other, in the directions of the points of one of them."""
        middles = np.array([centroid(frame.points.astype(np.float64)) for frame in frames])
        local = [frame.points - middle for frame, middle in zip(frames, middles, strict=True)]
        angles = np.arctan2(local[0][:, 1], local[0][:, 0])
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        for _ in range(_ROUNDS):
            polar = [(np.arctan2(points[:, 1], points[:, 0]), np.hypot(*points.T)) for points in local]
            radii = np.array([np.interp(angles, *curve, period=2.0 * np.pi) for curve in polar])
            away, poses = _distances(radii, directions)
            steps = np.linalg.lstsq(poses, away.T, rcond=None)[0].T
            local = [_moved(points, -step) for points, step in zip(local, steps, strict=True)]
        across = middles[:, 1:] + radii * directions[:, 1]
        return cls(radii, directions, np.abs(across).max(axis=0), tuple(frame.errors for frame in frames))

    def __len__(self) -> int:
        return len(self.radii)

    def taken(self, frames: Any) -> AlignedOutlines:
        """Return some of the frames, by an array of their numbers or of true and false."""
        numbers = np.arange(len(self))[frames]
        return replace(self, radii=self.radii[numbers], errors=tuple(self.errors[number] for number in numbers))

    @property
    def alike(self) -> Booleans:
        """Whether the outline of each frame agrees with the others to within what they scatter : (n,) array."""
        arcs = max(_FEWEST_ARCS, round(arc_length(self._median)[-1] / ARC))
        starts = np.arange(arcs) * self.radii.shape[1] // arcs
        away = np.abs(np.add.reduceat(self._distances, starts, axis=1) / np.diff(starts, append=self.radii.shape[1]))
        spread = np.maximum(robust_spread(away), np.median(away, axis=0) / 0.6745)
        return np.asarray(np.all(away < _UNLIKE_ARC * spread, axis=1))

    def sharpest(self) -> AlignedOutlines:
        """Return the frames whose mean has the smallest error."""
        # all frames unless some are less sharp: the mean would keep their larger misfit. The offset grows with the
        # width of the edge as the misfit does, but its part by the fringe may be misjudged in some
        misfit, offset, passing = np.array(
            [(each.misfit**2, each.offset**2, each.scatter**2 + each.arc**2) for each in self.errors]
        ).T
        lasting = misfit * (1.0 + np.median(offset / misfit))
        order = np.argsort(lasting, kind="stable")
        count = np.arange(1, len(self) + 1)
        variance = np.cumsum(lasting[order]) / count + np.cumsum(passing[order]) / count**2
        return self.taken(order[: np.argmin(variance) + 1])

    def silhouette(self, walls: WallLines, flow: int, change: float = 0.0) -> MeasuredOutline | None:
        """Return the mean as a measured silhouette; None if too few points are clear of the walls."""
        # Errors that differ from frame to frame are those seen between the frames, or those stated if larger, over the
        # root of their number. What all frames share stays: misfit, offset, walls and a part of the errors of arcs.
        mean = self.radii.mean(axis=0)[:, None] * self.directions
        clear = walls.is_clear(walls.half_width - _thinned(self.farthest))
        points, errors = _thinned(mean)[clear] * [flow, 1.0], self._errors(mean, change)
        return over_l(points, errors, walls.half_width, walls.half_width_error)

    def _errors(self, mean: Floats, change: float) -> EdgeErrors:
        """Return the errors of the mean of the outlines, which change along the channel by so much at their ends."""
        count, around = len(self), arc_length(mean)[-1]
        left = self._distances - self._distances.mean(axis=0)
        offset = left.mean(axis=1)
        means = _thinned((left - offset[:, None]).T).T
        freedom = max(count - 1, 1)
        variance, neighbours = (
            float(np.mean(means * np.roll(means, shift, axis=1))) * count / freedom for shift in (0, 1)
        )
        stated, misfit, lasting, rear, alike = np.median(  # a fringe may be misjudged in one of the frames
            [(each.arc**2, each.misfit, each.offset, each.rear, each.alike) for each in self.errors], axis=0
        )
        arc = max(neighbours * np.exp(around / means.shape[1] / alike), stated)
        scatter = max(
            (variance - max(neighbours, 0.0)) / count, scatter_left(_thinned(mean), _thinned(vertex_normals(mean))) ** 2
        )
        # each arc has an error of its own, and so has their mean: what is more is a change of the light
        flicker = max(float(np.sum(offset**2)) / freedom - arc * 2.0 * alike / around, 0.0)
        return EdgeErrors(
            scatter=float(np.sqrt(scatter)),
            arc=float(np.sqrt(arc / count)),
            misfit=float(np.sqrt(misfit**2 + _BIAS**2 * stated + change**2)),
            offset=float(np.sqrt(lasting**2 + flicker / count)),
            rear=float(rear),
            alike=float(alike),
        )

    @property
    def _median(self) -> Floats:
        return np.asarray(np.median(self.radii, axis=0)[:, None] * self.directions)

    @property
    def _distances(self) -> Floats:
        """Distances of the outlines from their median along its normal : (n, m) array [px]."""
        return _distances(self.radii, self.directions)[0]


def _thinned(values: Floats) -> Floats:
    """Return every third of the values (m, ...) around an outline, each that of a parabola through five of them."""
    # a mean of three points lies inside a tight corner: little next to the noise of one frame, but alike in all
    smooth = sum(weight * np.roll(values, shift, axis=0) for weight, shift in zip(_PARABOLA, range(-2, 3), strict=True))
    return np.asarray(smooth)[1::AVERAGED][: len(values) // AVERAGED]


def _distances(radii: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """Return the normal distances from the median (n, m), and how shifts and a turn change them (m, 3)."""
    median = np.median(radii, axis=0)
    points = median[:, None] * directions
    normal = vertex_normals(points)
    turned = points[:, 0] * normal[:, 1] - points[:, 1] * normal[:, 0]
    away = (radii - median) * np.sum(normal * directions, axis=1)
    return away, np.column_stack([normal, turned])


def _moved(points: Floats, step: Floats) -> Floats:
    """Return points turned about the origin and shifted."""
    cosine, sine = np.cos(step[2]), np.sin(step[2])
    return np.asarray(points @ np.array([[cosine, sine], [-sine, cosine]]) + step[:2])


# The capsule in each frame, and in all

_LENGTHS = "L_z", "L_a"
_FEWEST = 3  # frames that give a velocity and its error
_UNLIKE = 0.2  # of the frames: more that disagree with the others are no chance, but another shape
_NOTCHED = 0.25  # of the frames: more to which something sticks are another shape, too


@dataclass(eq=False)
class FrameRecord:
    """Detections of one capsule in the frames of a film."""

    statuses: Counter[Status] = field(default_factory=Counter)  # of the frames that show it
    measured: list[FrameMeasurement] = field(default_factory=list)  # of those in which it was measured
    picture: Picture | None = field(default=None, repr=False)
    detection: Detection | None = field(default=None, repr=False)
    frame: int = 0  # the one that shows it nearest to the middle of the picture, or the first
    _nearest: float = field(default=math.inf, repr=False)

    def add(self, frame: int, picture: Picture, detection: Detection) -> None:
        """Add the detection in one more frame."""
        self.statuses[detection.status] += 1
        if not detection.status.ok:
            if self.picture is None:
                self.picture, self.detection, self.frame = picture.packed(), detection, frame
            return
        self.measured.append(FrameMeasurement.of(frame, detection))
        distance = abs(float(self.measured[-1].place[0]) - detection.located()[0].centre_column)
        if distance <= self._nearest:
            self.picture, self.detection, self.frame, self._nearest = picture, detection, frame, distance
        elif self.picture is not None and self.picture.grey.dtype == np.float64:  # it has passed the middle
            self.picture = self.picture.packed()


@dataclass(frozen=True, eq=False)
class FilmCapsule:
    """A capsule followed through a film."""

    status: Status  # ``DONE``, or why it was refused
    record: FrameRecord = field(repr=False)
    velocity: Velocity | None
    drifts: dict[str, Drift]  # of ``"L_z"``, ``"L_a"`` and ``"v_o"`` along the channel
    measurement: Measurement
    alike: Booleans  # (n,): which of the frames in which it was measured agree with the others

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
        """Return the mean of a record, refused unless it is steady; the frame rate is in 1/s."""
        frames = record.measured
        if len(frames) < _FEWEST or record.detection is None:
            reasons = [(status, count) for status, count in record.statuses.most_common() if not status.ok]
            status = reasons[0][0] if reasons and reasons[0][1] > len(frames) else Status.FEW_FRAMES
            file = Path(experiment.source) if experiment.source else None
            refused = Measurement.refused(status, source=str(film), sha256=sha256, experiment_file=file)
            return cls(status, record, None, {}, refused, np.ones(len(frames), dtype=bool))
        speed, drifts = _motion(frames)
        outlines = AlignedOutlines.of(frames)
        alike = outlines.alike
        status = Status.REPEATED if repeated(*_places(frames)) else _steady(record, alike, drifts)
        used = [measured for measured, kept in zip(frames, alike, strict=True) if kept] if status.ok else frames
        lengths, covariance = _mean(used, drifts)
        size = pixel_size or _pixel_size(lengths[3], covariance[3, 3], experiment)
        capsule_velocity = _in_si(speed, size, frame_rate)
        if status.ok and smeared(experiment.exposure, capsule_velocity.value, size.value):
            status = Status.SMEARED
        walls, silhouette = record.detection.located()[0], None
        if status.ok:
            change = 0.5 * lengths[0] * _unmodelled_error(drifts, "L_z")  # of either end
            silhouette = outlines.taken(alike).sharpest().silhouette(walls, int(np.sign(speed.value)), change)
            status, further = asymmetry_of(silhouette, lengths[3])
            covariance[:2, :2] += further
        measured = measurement_of_lengths(
            lengths,
            covariance,
            capsule_velocity,
            experiment,
            outline=silhouette,
            status=status,
            walls=walls,
            source=str(film),
            sha256=sha256,
            gamma=None if record.picture is None else record.picture.gamma,
            fringe=record.detection.fringe,
        )
        return cls(status, record, speed, drifts, measured, alike)

    def table(self) -> pd.DataFrame:
        """Tabulate the frames in which the capsule was measured."""
        import pandas as pd

        columns = ("frame", "along_px", "across_px", "axial_extent_px", "axial_length_px", "half_width_px", "alike")
        rows = [
            (measured.frame, *measured.place, *measured.lengths[[0, 1, 3]], bool(alike))
            for measured, alike in zip(self.record.measured, self.alike, strict=True)
        ]
        return pd.DataFrame(rows, columns=columns)


def _steady(record: FrameRecord, alike: Booleans, drifts: dict[str, Drift]) -> Status:
    """Return whether a capsule is steady by its changes along the channel, and enough of its frames agree."""
    unlike, notched = np.count_nonzero(~alike), record.statuses[Status.DOUBLET]
    many = unlike > max(1.0, _UNLIKE * len(alike)) or notched > max(1.0, _NOTCHED * (notched + len(alike)))
    if many or any(drift.unsteady for drift in drifts.values()):
        return Status.UNSTEADY
    return Status.DONE if np.count_nonzero(alike) >= _FEWEST else Status.FEW_FRAMES


def _motion(frames: list[FrameMeasurement]) -> tuple[Velocity, dict[str, Drift]]:
    numbers, along, variance = _places(frames)
    speed = velocity(times_of(numbers, along, variance), along, variance)
    drifts = {} if speed.drift is None else {"v_o": speed.drift}
    lengths = np.array([measured.lengths for measured in frames])
    random = np.array([np.diag(measured.covariance - measured.systematic) for measured in frames])
    for index, name in enumerate(_LENGTHS):
        seen = np.isfinite(lengths[:, index])
        if seen.sum() >= _FEWEST:
            drifts[name] = drift(along[seen], lengths[seen, index], random[seen, index])
    return speed, drifts


def _places(frames: list[FrameMeasurement]) -> tuple[Floats, Floats, Floats]:
    """Return the numbers of frames, the places along the channel, and the variance of their errors : (n,) arrays."""
    rows = [(float(measured.frame), measured.place[0], measured.place_variance) for measured in frames]
    numbers, along, variance = np.array(rows).T
    return numbers, along, variance


def _mean(frames: list[FrameMeasurement], drifts: dict[str, Drift]) -> tuple[Floats, Floats]:
    """Return mean lengths [px] and the covariance of their errors [px^2]."""
    # The error is that of the scatter, or of the noise if this is larger, and the part that all frames share: misfit of
    # the edge's model, walls, and changes along the channel that are significant but negligible. If the rear is seen in
    # half of the frames, all lengths are taken from these.
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
    return mean, covariance


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
