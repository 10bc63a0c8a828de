"""Which spot of one frame is which of the next.

Capsules in a channel move in single file, nearly all as fast, and each keeps its size: every capsule is looked for
where its own velocity takes it, or that of the last capsule before it has one of its own. The very first step of a
film is the shortest one downstream that leaves the sizes as they are; where capsules move by more than half their
distance between two frames, it needs the direction of the flow.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from capsbayes.image.spots import Spot
from capsbayes.image.wall import Walls
from capsbayes.status import Status

__all__ = ["Linker", "Way"]

Floats = NDArray[np.float64]

_SIZES = 1.3  # how many times the area of a spot that of the same spot in another frame may be
_ACROSS = 0.25  # l: how far a spot may move across the channel
_ASTRAY = 0.5  # of the spot's size: how far from the predicted place it may be
_HASTE = 0.2  # of the way between two sightings: how far besides, as a velocity known from few frames is rough
_LOST = 3  # frames without a sighting after which a way ends
_FAR = 1e9


@dataclass(eq=False)
class Way:
    """Where one spot was seen.

    Parameters
    ----------
    frames : list of int
    places : list of (2,) array [px]
        Along and across the channel.
    area, size : float
        Of the spot as last seen, in square pixels and its square root over (pi/4).
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
        """Along the channel [px per frame], None after one sighting."""
        if len(self.frames) < 2:
            return None
        return float(self.places[-1][0] - self.places[0][0]) / (self.frames[-1] - self.frames[0])


class Linker:
    """Follows all spots of a film.

    Parameters
    ----------
    walls : Walls
    flow : int
        1 to the right, -1 to the left, 0 if not known.
    """

    def __init__(self, walls: Walls, flow: int = 0) -> None:
        self.walls, self.flow = walls, flow
        self._open: list[Way] = []
        self._velocity: float | None = None

    @property
    def direction(self) -> int:
        """The flow as it was given, or as the spots were seen to move: 1, -1, or 0 before any was."""
        return self.flow or (0 if self._velocity is None else int(np.sign(self._velocity)))

    def linked(self, frame: int, spots: list[Spot]) -> list[Way | None]:
        """Add the spots of a frame.

        Parameters
        ----------
        frame : int
            Greater than that of the call before.
        spots : list of Spot

        Returns
        -------
        list of Way or None
            The way that each spot continues or begins; none for one cut by the border, whose place is not known.
        """
        self._open = [way for way in self._open if frame - way.frames[-1] <= _LOST]
        whole = [index for index, spot in enumerate(spots) if spot.status is not Status.TOUCHES_BORDER]
        places = {index: self._place(spots[index]) for index in whole}
        cost = np.array([[self._cost(way, frame, spots[i], places[i]) for i in whole] for way in self._open])
        found: list[Way | None] = [None] * len(spots)
        if cost.size:
            for row, column in zip(*linear_sum_assignment(cost), strict=True):
                if cost[row, column] < _FAR:
                    found[whole[column]] = self._open[row]
        for index in whole:
            way = found[index] or Way()
            if not way.frames:
                self._open.append(way)
            way.frames.append(frame)
            way.places.append(places[index])
            way.area = spots[index].area
            self._velocity = way.velocity or self._velocity
            found[index] = way
        return found

    def _place(self, spot: Spot) -> Floats:
        return np.array([spot.middle @ self.walls.along, spot.middle @ self.walls.across])

    def _cost(self, way: Way, frame: int, spot: Spot, place: Floats) -> float:
        """Distance from where the way leads, or `_FAR` from a spot that cannot be its own."""
        step, aside = place - way.places[-1]
        alike = max(spot.area, way.area) < _SIZES * min(spot.area, way.area)
        if not alike or abs(aside) > _ACROSS * self.walls.half_width or step * self.direction < 0.0:
            return _FAR
        passed = frame - way.frames[-1]
        velocity = self._velocity if way.velocity is None else way.velocity
        if velocity is None:
            return abs(float(step))
        apart = abs(float(step - velocity * passed))
        return apart if apart < _ASTRAY * way.size + _HASTE * abs(velocity) * passed else _FAR
