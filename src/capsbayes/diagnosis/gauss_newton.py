"""Least-squares fits of many capsules at once by damped Gauss-Newton steps, from shapes of nearly their lengths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.whitening import OfLengths, Whitening
from capsbayes.model import ForwardModel
from capsbayes.prediction import Prediction

LOOSE = np.array([2.0, 1.0])
"""Standard deviations of a loose prior of ln Ca and a/l about the pilots, for what the data leave open."""

_STEPS = 30
_LEAST_DAMPING = 1e-3
_RISE = 1e-4  # of the misfit, in a step that halves what is still to be gained: slopes by differences are a little off
_BETTER = 1e-3  # in misfit, by which a fit is better than another
_DIFFERENCE = (3e-4, 3e-5)  # of log Ca and a/l, for derivatives
_LONGEST = (0.3, 0.03)  # step
_SETTLED = 1e-10  # of the misfit that is still to be gained
_GUESSES = (60, 40)  # along log Ca and a/l
_BANDS = 4  # of Ca, in each of which a capsule that is not fitted is tried again


@dataclass(eq=False)
class Places:
    """Points in the plane (ln Ca, a/l) of n capsules, with the residuals and slopes of a model there.

    Parameters
    ----------
    theta : (n, 2) array
    residuals : list of n (m,) arrays
        NaN outside the model's domain.
    slopes : list of n (m, 2) arrays
    ratio : (n,) array
        v_o/U.
    ratio_slopes : (n, 2) array
    """

    theta: Floats
    residuals: list[Floats]
    slopes: list[Floats]
    ratio: Floats
    ratio_slopes: Floats

    def taken(self, rows: Integers) -> Places:
        """Return those of some rows."""
        each = [self.residuals[i] for i in rows], [self.slopes[i] for i in rows]
        return Places(self.theta[rows], *each, self.ratio[rows], self.ratio_slopes[rows])

    def put(self, rows: Integers, others: Places) -> None:
        """Replace those of some rows."""
        self.theta[rows], self.ratio[rows], self.ratio_slopes[rows] = others.theta, others.ratio, others.ratio_slopes
        for i, residual, slope in zip(rows, others.residuals, others.slopes, strict=True):
            self.residuals[i], self.slopes[i] = residual, slope

    def take_better(self, rows: Integers, others: Places, centre: Floats) -> None:
        """Replace those of some rows that fit better elsewhere by more than the convergence error.

        `centre` (n, 2) as in `penalised`.
        """
        better = others.penalised(centre[rows]) < self.penalised(centre)[rows] - _BETTER
        self.put(rows[better], others.taken(np.flatnonzero(better)))

    @property
    def inside(self) -> Booleans:
        """Capsules that have a shape of the model : (n,) array."""
        return np.array([np.isfinite(residual).all() for residual in self.residuals], dtype=bool)

    @property
    def differentiable(self) -> Booleans:
        """Capsules with finite slopes : (n,) array."""
        return np.array([np.isfinite(slope).all() for slope in self.slopes], dtype=bool)

    def penalised(self, centre: Floats) -> Floats:
        """Return the misfit with a loose prior about centres (n, 2) : (n,) array, infinite outside the domain."""
        misfit = np.array([residual @ residual for residual in self.residuals])
        found = misfit + np.sum(((self.theta - centre) / LOOSE) ** 2, axis=1)
        return np.where(np.isfinite(found), found, np.inf)

    def step(self, centre: Floats, damping: Floats) -> tuple[Floats, Floats]:
        """Return the damped step (n, 2), and the decrease of the misfit (n,) predicted for the undamped one."""
        known = np.flatnonzero(self.inside & self.differentiable)
        step, promised = np.zeros_like(self.theta), np.zeros(len(self.theta))
        if not len(known):
            return step, promised
        matrix = np.array([self.slopes[i].T @ self.slopes[i] for i in known]) + np.diag(1.0 / LOOSE**2)
        pull = np.array([self.slopes[i].T @ self.residuals[i] for i in known])
        pull += (self.theta[known] - centre[known]) / LOOSE**2
        promised[known] = np.sum(pull * _solved(matrix, pull), axis=1)
        diagonal = np.eye(2) * matrix
        step[known] = -_solved(matrix + damping[known, None, None] * diagonal, pull)
        return np.clip(step, -np.array(_LONGEST), _LONGEST), promised


def _solved(matrices: Floats, sides: Floats) -> Floats:
    return np.asarray(np.linalg.solve(matrices, sides[..., None])[..., 0])


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
            for k, row in enumerate(edge):
                found.slopes[row] = np.where(np.isfinite(found.slopes[row]), found.slopes[row], back.slopes[k])
            there = found.ratio_slopes[edge]
            found.ratio_slopes[edge] = np.where(np.isfinite(there), there, back.ratio_slopes)
        return found

    def _towards(self, theta: Floats, rows: Integers, sign: float) -> Places:
        """Evaluate with slopes by differences to one side."""
        shifts = sign * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) * _DIFFERENCE
        points = (theta[:, None] + shifts).reshape(-1, 2)
        batch = {name: np.repeat(values[rows], len(shifts)) for name, values in self.rest.items()}
        batch |= {"capillary_number": np.exp(points[:, 0]), "size_ratio": points[:, 1]}
        prediction = self.model(batch, outline=self.white.outline)
        ratio = prediction.velocity_ratio.reshape(-1, len(shifts))
        residuals, slopes = [], []
        for k, row in enumerate(rows):
            seen = self.white.each[row](prediction.taken(slice(len(shifts) * k, len(shifts) * (k + 1))))
            residuals.append(seen[0])
            slopes.append((seen[1:] - seen[0]).T / (sign * np.array(_DIFFERENCE)))
        ratio_slopes = (ratio[:, 1:] - ratio[:, :1]) / (sign * np.array(_DIFFERENCE))
        return Places(theta, residuals, slopes, ratio[:, 0], ratio_slopes)


def gauss_newton(evaluate: Evaluation, here: Places, who: Integers) -> Places:
    """Minimise the misfit of k capsules, given by their rows, by damped Gauss-Newton steps."""
    centre = evaluate.white.pilots[who]
    value, promised = here.penalised(centre), here.step(centre, np.zeros(len(who)))[1]
    damping, moving = np.full(len(value), _LEAST_DAMPING), np.isfinite(value)
    for _ in range(_STEPS):
        moving &= (promised > _SETTLED) & (damping < 1e8)
        rows = np.flatnonzero(moving)
        if not len(rows):
            break
        step = here.step(centre, damping)[0]
        there = evaluate(here.theta[rows] + step[rows], who[rows])
        reached, left = there.penalised(centre[rows]), there.step(centre[rows], np.zeros(len(rows)))[1]
        flatter = there.differentiable & (left < 0.5 * promised[rows]) & (reached < value[rows] + _RISE)
        better = (reached < value[rows] - 0.1 * promised[rows]) | flatter
        here.put(rows[better], there.taken(np.flatnonzero(better)))
        value[rows[better]], promised[rows[better]] = reached[better], left[better]
        damping[rows] = np.where(better, np.maximum(0.1 * damping[rows], _LEAST_DAMPING), 10.0 * damping[rows])
    return here


def initial_guesses(
    model: ForwardModel, session: Session, rest: Mapping[str, Floats], rows: Integers, bands: int = _BANDS
) -> Floats:
    """Return ln Ca and a/l (bands, k, 2) of the shapes of nearest lengths in each band of Ca, for k rows of capsules.

    `rest` holds the circumstances of all and the sizes of effects.
    """
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
