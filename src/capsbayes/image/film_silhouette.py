"""The silhouette that the frames of a film show together: the mean of their outlines, with what its errors are.

A capsule is shifted from frame to frame, and may be turned a little: each outline is laid onto the others by least
squares, as the likelihood of a silhouette leaves place and tilt open too. Noise differs from frame to frame, and the
mean has less of it. The misfit of the edge's model, the pixels and the walls do the same in all frames, and stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from capsbayes.arrays import Booleans, Floats
from capsbayes.image.detection import Detection
from capsbayes.image.edges.integrals import centroid
from capsbayes.image.edges.outline import ARC, AVERAGED, scatter_left
from capsbayes.image.edges.robust import robust_spread
from capsbayes.image.silhouette import EdgeErrors, over_l
from capsbayes.image.walls import WallLines
from capsbayes.measured_outline import MeasuredOutline
from capsbayes.profile import arc_length, signed_area, vertex_normals

_PARABOLA = np.array([-3.0, 12.0, 17.0, 12.0, -3.0]) / 35.0  # weights of five points in the middle of their parabola
# of an arc's error, the same in all frames: noise biases fits, as L_z by 0.13 px where 5 % of it scatter it by 0.19 px
_BIAS = 0.5
_ROUNDS = 3  # of laying outlines onto each other; the third changes nothing that is seen
_FEWEST_ARCS = 8
_UNLIKE = 6.0  # robust standard deviations of an arc: of 2,000 frames without a fault no arc is that far off


@dataclass(frozen=True, eq=False)
class FrameOutline:
    """Outline of a capsule in one frame.

    Parameters
    ----------
    points : (n, 2) array [px]
        Along and across the channel, the latter from its middle; counter-clockwise. In single precision, as there are
        many frames.
    errors : EdgeErrors
    """

    points: Floats
    errors: EdgeErrors

    @classmethod
    def of(cls, detection: Detection) -> FrameOutline:
        """Return the outline of a detection that is done."""
        walls, outline = detection.walls, detection.outline
        assert walls is not None
        assert outline is not None
        middle = np.array([walls.centre_column, walls.centre_row])
        points = (outline.points - middle) @ np.stack([walls.along, walls.across], axis=1)
        points = points if signed_area(points) > 0.0 else points[::-1]
        return cls(points.astype(np.float32), EdgeErrors.of(detection))


@dataclass(frozen=True, eq=False)
class AlignedOutlines:
    """Outlines of a capsule in several frames on common directions, laid onto each other.

    Parameters
    ----------
    radii : (n, m) array [px]
        Of each frame, in each direction from the middle of the capsule.
    directions : (m, 2) array
        Unit vectors.
    farthest : (m,) array [px]
        Largest distance of the points in each direction from the middle of the channel.
    errors : tuple of EdgeErrors
        Of each frame.
    """

    radii: Floats
    directions: Floats
    farthest: Floats
    errors: tuple[EdgeErrors, ...]

    @classmethod
    def of(cls, outlines: Sequence[FrameOutline]) -> AlignedOutlines:
        """Lay outlines onto each other, in the directions of the points of one of them."""
        middles = np.array([centroid(outline.points.astype(np.float64)) for outline in outlines])
        local = [outline.points - middle for outline, middle in zip(outlines, middles, strict=True)]
        angles = np.arctan2(local[0][:, 1], local[0][:, 0])
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        for _ in range(_ROUNDS):
            radii = np.array([_radii(points, angles) for points in local])
            away, poses = _distances(radii, directions)
            steps = np.linalg.lstsq(poses, away.T, rcond=None)[0].T
            local = [_moved(points, -step) for points, step in zip(local, steps, strict=True)]
        across = middles[:, 1:] + radii * directions[:, 1]
        return cls(radii, directions, np.abs(across).max(axis=0), tuple(outline.errors for outline in outlines))

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
        return np.asarray(np.all(away < _UNLIKE * spread, axis=1))

    def sharpest(self) -> AlignedOutlines:
        """Return the frames whose mean has the smallest error.

        Those are all frames unless some are less sharp: the mean would keep their larger misfit.
        """
        lasting, passing = np.array(
            [(each.misfit**2 + each.offset**2, each.scatter**2 + each.arc**2) for each in self.errors]
        ).T
        order = np.argsort(lasting, kind="stable")
        count = np.arange(1, len(self) + 1)
        variance = np.cumsum(lasting[order]) / count + np.cumsum(passing[order]) / count**2
        return self.taken(order[: np.argmin(variance) + 1])

    def silhouette(self, walls: WallLines, flow: int, change: float = 0.0) -> MeasuredOutline | None:
        """Return the mean as a measured silhouette; None if too few points are clear of the walls.

        The flow is 1 to the right, -1 to the left; the change [px] is that of the ends along the channel.

        The errors that differ from frame to frame are those seen between the frames, or those stated for each if they
        are larger, over the root of their number; the scatter is no smaller than that which is left in the mean, as of
        pixels that a flank crosses at the same places in all frames. What all frames share stays: misfit, offset, walls
        and a part of the errors of arcs.
        """
        mean = self.radii.mean(axis=0)[:, None] * self.directions
        clear = walls.is_clear(walls.half_width - _thinned(self.farthest))
        return over_l(_thinned(mean)[clear] * [flow, 1.0], self._errors(mean, change), walls)

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
        stated, misfit, lasting, rear = np.mean(
            [(each.arc**2, each.misfit, each.offset, each.rear) for each in self.errors], axis=0
        )
        arc = max(neighbours * np.exp(around / means.shape[1] / ARC), stated)
        scatter = max(
            (variance - max(neighbours, 0.0)) / count, scatter_left(_thinned(mean), _thinned(vertex_normals(mean))) ** 2
        )
        # each arc has an error of its own, and so has their mean: what is more is a change of the light
        flicker = max(float(np.sum(offset**2)) / freedom - arc * 2.0 * ARC / around, 0.0)
        return EdgeErrors(
            scatter=float(np.sqrt(scatter)),
            arc=float(np.sqrt(arc / count)),
            misfit=float(np.sqrt(misfit**2 + _BIAS**2 * stated + change**2)),
            offset=float(np.sqrt(lasting**2 + flicker / count)),
            rear=float(rear),
        )

    @property
    def _median(self) -> Floats:
        return np.asarray(np.median(self.radii, axis=0)[:, None] * self.directions)

    @property
    def _distances(self) -> Floats:
        """Distances of the outlines from their median along its normal : (n, m) array [px]."""
        return _distances(self.radii, self.directions)[0]


def _thinned(values: Floats) -> Floats:
    """Return every third of the values (m, ...) around an outline, each that of a parabola through five of them.

    A mean of three points lies inside a tight corner, by a tenth of a pixel at a radius of 5 px: little next to the
    noise of one frame, but the same in all.
    """
    smooth = sum(weight * np.roll(values, shift, axis=0) for weight, shift in zip(_PARABOLA, range(-2, 3), strict=True))
    return np.asarray(smooth)[1::AVERAGED][: len(values) // AVERAGED]


def _radii(points: Floats, angles: Floats) -> Floats:
    """Return the distances of a closed curve (p, 2) around the origin in some directions."""
    return np.interp(angles, np.arctan2(points[:, 1], points[:, 0]), np.hypot(*points.T), period=2.0 * np.pi)


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
