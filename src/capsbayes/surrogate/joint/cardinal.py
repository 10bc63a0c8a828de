"""Interpolation along one coordinate as weights of the values at its knots.

Between two knots a cubic has at either end the value there and the slope of
the parabola through the knot and its neighbours: smooth, exact for parabolas,
and with small weights however uneven the knots. It is linear in the values,
so one set of weights serves every quantity. Knots without a value are omitted.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import factorial

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from capsbayes.arrays import Booleans, Floats

FEWEST_KNOTS = 3  # without one of them, two still give a slope


@dataclass(frozen=True, eq=False)
class CardinalCubics:
    """Weights of the values at k rising knots, cubics in each of the k - 1 intervals.

    >>> cubics = CardinalCubics(np.array([0.0, 1.0, 2.0, 4.0]), np.ones(4, dtype=bool))
    >>> cubics.weights(1.5).round(4).tolist()
    [-0.0625, 0.5833, 0.5, -0.0208]
    """

    # `cubics` are coefficients, from the constant on, of the weights as polynomials of the distance from the lower
    # knot; NaN beyond the known knots. `left_out` are, for the known knots at the two ends of an interval, the weights
    # that give the value there from all other known knots less the value itself, over the root of the number of such
    # knots: the mean square of the two is the sum of squares. Zero at the first and the last known knot, which others
    # cannot give.

    knots: Floats  # (k,)
    known: Booleans  # (k,): whether there is a value, at least `FEWEST_KNOTS` of them
    cubics: Floats = field(init=False, repr=False)  # (k - 1, 4, k)
    left_out: Floats = field(init=False, repr=False)  # (k - 1, 2, k)
    ends: Floats = field(init=False, repr=False)  # (k - 1, 2): the known knots next to each interval

    def __post_init__(self) -> None:
        count, rows = len(self.knots), np.flatnonzero(self.known)
        if len(rows) < FEWEST_KNOTS:
            raise ValueError(f"known: expected at least {FEWEST_KNOTS} knots with a value, got {len(rows)}")
        cubics, ends = np.full((count - 1, 4, count), np.nan), np.full((count - 1, 2), np.nan)
        left_out = np.zeros((count - 1, 2, count))
        spline = _through(self.knots[rows], np.eye(count)[rows])
        for i in range(rows[0], rows[-1]):
            for power in range(4):
                cubics[i, power] = spline(self.knots[i], nu=power) / factorial(power)
            around = rows[rows <= i][-1], rows[rows > i][0]
            ends[i] = self.knots[list(around)]
            inner = [rows[0] < end < rows[-1] for end in around]
            for side, end in enumerate(around):
                if inner[side]:
                    others = rows[rows != end]
                    rest = _through(self.knots[others], np.eye(count)[others])
                    left_out[i, side] = (rest(self.knots[end]) - np.eye(count)[end]) / np.sqrt(sum(inner))
        for name, value in {"cubics": cubics, "left_out": left_out, "ends": ends}.items():
            object.__setattr__(self, name, value)

    def weights(self, place: float) -> Floats:
        """Return the weights of the values at the knots in the value at a place : (k,) array, NaN beyond the known."""
        interval = int(np.clip(np.searchsorted(self.knots, place, side="right") - 1, 0, len(self.knots) - 2))
        powers = (place - self.knots[interval]) ** np.arange(4)
        return np.asarray(powers @ self.cubics[interval])


def _through(knots: Floats, values: Floats) -> CubicHermiteSpline:
    slopes = np.gradient(values, knots, axis=0, edge_order=2 if len(knots) > 2 else 1)
    return CubicHermiteSpline(knots, values, slopes)
