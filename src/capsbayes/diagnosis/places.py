"""Best shapes of many capsules at once, from shapes of nearly their lengths: residuals and slopes of a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats, Integers
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.whitening import OfLengths, Whitening
from capsbayes.least_squares import Linearised, minimise
from capsbayes.model import ForwardModel
from capsbayes.prediction import Prediction

LOOSE = np.array([2.0, 1.0])
"""Standard deviations of a loose prior of ln Ca and a/l about the pilots, for what the data leave open."""

_DIFFERENCE = np.array([3e-4, 3e-5])  # of log Ca and a/l, for derivatives
_LONGEST = np.array([0.3, 0.03])  # step
_STEPS = 20  # at most: what is not fitted then lies at the border, or where the misfit has a crease
_GUESSES = (60, 40)  # along log Ca and a/l
_BANDS = 4  # of Ca, in each of which a capsule that is not fitted is tried again


@dataclass(eq=False)
class Places(Linearised):
    """Points in the plane (ln Ca, a/l) of n capsules, with the residuals and slopes of a model there."""

    # The first two residuals are those of the loose prior about the pilots.

    ratio: Floats  # (n,): v_o/U
    ratio_slopes: Floats  # (n, 2)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Evaluation of a model for some of the capsules; `rest` holds the circumstances of all, and sizes of effects."""

    model: ForwardModel
    white: Whitening
    rest: Mapping[str, Floats]

    def __call__(self, theta: Floats, rows: Integers) -> Places:
        """Evaluate at theta (k, 2) the capsules of k rows."""
        found = self._towards(theta, rows, 1.0)
        edge = np.flatnonzero(found.inside & ~found.differentiable)  # of the domain: look the other way
        if len(edge):
            back = self._towards(theta[edge], rows[edge], -1.0)
            for here, there in ((found.slopes, back.slopes), (found.ratio_slopes, back.ratio_slopes)):
                here[edge] = np.where(np.isfinite(here[edge]), here[edge], there)
        return found

    def fitted(self, here: Places, rows: Integers) -> Places:
        """Minimise the misfit of capsules, given by their rows, from some places on."""
        return minimise(self, here, rows, _LONGEST, _STEPS)

    def _towards(self, theta: Floats, rows: Integers, sign: float) -> Places:
        """Evaluate with slopes by differences to one side."""
        difference = sign * _DIFFERENCE
        shifts = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) * difference
        points = (theta[:, None] + shifts).reshape(-1, 2)
        batch = {name: np.repeat(values[rows], len(shifts)) for name, values in self.rest.items()}
        batch |= {"capillary_number": np.exp(points[:, 0]), "size_ratio": points[:, 1]}
        prediction = self.model(batch, outline=self.white.outline)
        ratio = prediction.velocity_ratio.reshape(-1, len(shifts))
        seen = np.zeros((len(rows), len(shifts), 2 + max(white.count for white in self.white.each)))
        seen[:, :, :2] = (theta[:, None] + shifts - self.white.pilots[rows, None]) / LOOSE
        for k, row in enumerate(rows):
            white = self.white.each[row]
            seen[k, :, 2 : 2 + white.count] = white(prediction, slice(len(shifts) * k, len(shifts) * (k + 1)))
        slopes = np.swapaxes(seen[:, 1:] - seen[:, :1], 1, 2) / difference
        return Places(theta, seen[:, 0], slopes, ratio[:, 0], (ratio[:, 1:] - ratio[:, :1]) / difference)


def initial_guesses(
    model: ForwardModel, session: Session, rest: Mapping[str, Floats], rows: Integers, bands: int = _BANDS
) -> Floats:
    """Return ln Ca and a/l (bands, k, 2) of the shapes of nearest lengths in each band of Ca, for k capsules."""
    # `rest` holds the circumstances of all and the sizes of effects.
    (ca_low, ca_high), (size_low, size_high) = model.domain.bounds
    columns = np.linspace(size_low, size_high, _GUESSES[1] + 2)[1:-1]
    ca, size = (axis.ravel() for axis in np.meshgrid(np.geomspace(ca_low, ca_high, _GUESSES[0] + 2)[1:-1], columns))
    band = np.digitize(ca, np.geomspace(ca_low, ca_high, bands + 1)[1:-1])
    guesses = np.empty((bands, len(rows), 2))
    acting = [name for name in rest if name not in session.circumstances or name in model.circumstances]
    predictions: dict[tuple[float, ...], Prediction] = {}
    for k, row in enumerate(rows):
        conditions = tuple(float(rest[name][row]) for name in acting)
        if conditions not in predictions:
            given = {name: np.full(ca.size, value) for name, value in zip(acting, conditions, strict=True)}
            predictions[conditions] = model({**given, "capillary_number": ca, "size_ratio": size})
        prediction = predictions[conditions]
        whitener = OfLengths.of(session.measurements[row], np.zeros((2, 2)))
        away = np.full(ca.size, np.inf)
        away[prediction.inside] = np.sum(np.square(whitener(prediction))[prediction.inside], axis=1)
        for j in range(bands):
            place = int(np.argmin(np.where(band == j, away, np.inf)))
            guesses[j, k] = np.log(ca[place]), size[place]
    return guesses
