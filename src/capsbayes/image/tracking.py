"""Linking of the blobs of consecutive frames into tracks.

Capsules in a channel move in single file, at almost one velocity, and each keeps its size. Each is sought at the place
predicted by its own velocity, or by that of the last capsule until it has one. The first step of a film is the shortest
one downstream between blobs of one size; where capsules move by more than half their distance between two frames, it
needs the direction of the flow.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from capsbayes.arrays import Floats
from capsbayes.image.blobs import Blob
from capsbayes.image.walls import WallLines
from capsbayes.status import Status

_SIZES = 1.3  # largest ratio of the areas of one blob in two frames
_ACROSS = 0.25  # l: largest displacement across the channel
_ASTRAY = 0.5  # of the blob's size: largest distance from the predicted place
_UNCERTAIN = 0.2  # of the displacement since the last frame, added to it: a velocity from few frames is rough
_LOST = 3  # frames without the blob after which a track ends
_FAR = 1e9


@dataclass(eq=False)
class Track:
    """Places of one blob.

    Parameters
    ----------
    frames : list of int
    places : list of (2,) array [px]
        Along and across the channel.
    area : float [px^2]
        Of the blob in the last of these frames.
    """

    frames: list[int] = field(default_factory=list)
    places: list[Floats] = field(default_factory=list)
    area: float = 0.0

    @property
    def size(self) -> float:
        """Diameter of a circle of the area [px]."""
        return 2.0 * float(np.sqrt(self.area / np.pi))

    @property
    def velocity(self) -> float | None:
        """Velocity along the channel [px per frame], None in the first frame."""
        if len(self.frames) < 2:
            return None
        return float(self.places[-1][0] - self.places[0][0]) / (self.frames[-1] - self.frames[0])


class Linker:
    """Tracks of all blobs of a film.

    Parameters
    ----------
    walls : WallLines
    flow : int
        1 to the right, -1 to the left, 0 if not known.
    """

    def __init__(self, walls: WallLines, flow: int = 0) -> None:
        self.walls, self.flow = walls, flow
        self._open: list[Track] = []
        self._velocity: float | None = None

    @property
    def direction(self) -> int:
        """The flow as given, or else as the blobs moved: 1, -1, or 0 before any moved."""
        return self.flow or (0 if self._velocity is None else int(np.sign(self._velocity)))

    def link(self, frame: int, blobs: list[Blob]) -> list[Track | None]:
        """Add the blobs of a frame.

        Returns the track that each blob continues or begins, None for a blob cut by the border, whose place is unknown.
        """
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
        return distance if distance < _ASTRAY * track.size + _UNCERTAIN * abs(velocity) * passed else _FAR
