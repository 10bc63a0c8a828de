"""The best shape of a model for each capsule, and what is left over.

Each capsule has its own Ca and a/l; they are found by Gauss-Newton steps, for
all capsules together, so that many models can be compared. What is left over is
*whitened*: of independent numbers with variance one if the model is right. The
covariance that does this is made once, at a pilot, and kept for all models that
are compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from capsbayes.discrepancy.session import Session
from capsbayes.effect import circumstances_of
from capsbayes.inference.outline_likelihood import OutlineLikelihood, outline_likelihood
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel
from capsbayes.prediction import Prediction

__all__ = ["Fits", "Whitening", "fitted", "whitening"]

Floats = NDArray[np.float64]

_STEPS = 12
_DIFFERENCE = (3e-4, 3e-5)  # of log Ca and a/l, for derivatives
_LONGEST = (0.3, 0.03)  # step
_LOOSE = np.array([2.0, 1.0])  # standard deviations of a prior about the start: it holds what the data leave open
_SETTLED = 1e-4  # of the misfit that is still to be gained
_NEAR = 0.1  # of the misfit still to be gained, from which a capsule counts as not fitted
_ILL = 4.0  # misfit over its freedom, from which a capsule has no shape of the model: twice the stated noise
_AGAIN = 2.0  # misfit over its freedom, from which a fit is sought from elsewhere too
_SCOUTS = (60, 40)  # along log Ca and a/l
_BANDS = 4  # of Ca, in each of which a capsule that is not fitted is tried again


class Whitener(Protocol):
    """What is left of one capsule's measurement beside predictions."""

    @property
    def placed(self) -> int:
        """How many numbers its place in the picture has taken up already."""
        ...

    def __call__(self, prediction: Prediction) -> Floats:
        """Whitened differences (k, m) from k predictions, NaN outside the model's domain."""
        ...


@dataclass(frozen=True, eq=False)
class OfLengths:
    """Measured lengths (1,) or (2,) with the factor of their covariance, the model's own error included."""

    lengths: Floats
    factor: Floats
    placed: ClassVar[int] = 0

    def __call__(self, prediction: Prediction) -> Floats:
        """See `Whitener`."""
        away = self.lengths - prediction.values[:, : len(self.lengths)]
        white = np.full_like(away, np.nan)
        known = prediction.inside
        white[known] = scipy.linalg.solve_triangular(self.factor, away[known].T, lower=True).T
        return white


@dataclass(frozen=True, eq=False)
class OfOutline:
    """A measured outline; its likelihood holds the covariance."""

    likelihood: OutlineLikelihood
    placed: ClassVar[int] = 3  # shifts and tilt

    def __call__(self, prediction: Prediction) -> Floats:
        """See `Whitener`."""
        assert prediction.outline is not None, "asked for"
        outlines = np.where(prediction.inside[:, None, None], prediction.outline, np.nan)
        return self.likelihood.whitened(outlines, prediction.axial_length, posed=True)


@dataclass(frozen=True, eq=False)
class Whitening:
    """One whitener for each capsule, and where it was made.

    Parameters
    ----------
    each : tuple of n Whitener
    pilots : (n, 2) array
        log Ca and a/l.
    outline : bool
        Whether any of them reads outlines.
    """

    each: tuple[Whitener, ...]
    pilots: Floats
    outline: bool


@dataclass(frozen=True, eq=False)
class Fits:
    """The best shapes of a model for n capsules.

    Parameters
    ----------
    theta : (n, 2) array
        log Ca and a/l.
    residuals : tuple of n (m,) arrays
        Whitened.
    slopes : tuple of n (m, 2) arrays
        Their derivatives along log Ca and a/l.
    log_modulus, size : (n,) arrays
        ln G_s [N/m] at the mean viscosity, and a/l.
    covariance : (n, 2, 2) array
        Of ln G_s and a/l.
    known : (n,) bool array
        Whether the model has any shape for it.
    settled : (n,) bool array
        Whether the steps came to the least misfit, and not to the border of the model's domain.
    freedom : (n,) array
        Numbers measured of each capsule less those that are fitted: Ca, a/l, and place and tilt of an outline.
    """

    theta: Floats
    residuals: tuple[Floats, ...]
    slopes: tuple[Floats, ...]
    log_modulus: Floats
    size: Floats
    covariance: Floats
    known: NDArray[np.bool_]
    settled: NDArray[np.bool_]
    freedom: NDArray[np.int64]

    @property
    def ill(self) -> NDArray[np.bool_]:
        """Which have no shape of the model: none at all, none but at its border, or a misfit far beyond the noise."""
        return ~(self.settled & (self.misfit < _ILL * np.maximum(self.freedom, 1)))

    @property
    def misfit(self) -> Floats:
        """Sum of the squares of what is left of each capsule : (n,) array."""
        return np.array([residual @ residual for residual in self.residuals])


def whitening(model: ForwardModel, session: Session) -> Whitening:
    """The covariance of each capsule's measurement and of the model's own error there.

    It is made at the shape that the lengths have, and once more at that which fits the outline.

    Raises
    ------
    InputError
        If a capsule has a shape that the model has not.
    """
    pilots = _scouts(model, session, session.circumstances, np.arange(len(session)), bands=1)[0]
    outline = any(one.outline is not None for one in session.measurements)
    made = Whitening(_whiteners(model, session, pilots), pilots, outline)
    if not outline:
        return made
    better = fitted(model, session, made)
    pilots = np.where(better.settled[:, None], better.theta, pilots)
    return Whitening(_whiteners(model, session, pilots), pilots, outline)


def fitted(
    model: ForwardModel,
    session: Session,
    white: Whitening,
    sizes: Mapping[str, ArrayLike] | None = None,
    start: Floats | None = None,
    *,
    everywhere: bool = True,
) -> Fits:
    """Fit a model to every capsule.

    Parameters
    ----------
    model : ForwardModel
    session : Session
    white : Whitening
        Made with the model without effects.
    sizes : mapping of str to float or (n,) array, optional
        Parameters of effects of the model.
    start : (n, 2) array, optional
        log Ca and a/l to begin at, in place of the pilots; outside the model's domain the pilots take its place.
    everywhere : bool
        Whether a capsule that is not fitted from there is tried again from elsewhere.
    """
    rest = {name: np.broadcast_to(np.asarray(value, float), len(session)) for name, value in (sizes or {}).items()}
    rest = {**session.circumstances, **rest}
    evaluate = _Evaluation(model, white, rest)
    centre = white.pilots
    here = _descended(evaluate, _begun(evaluate, start), np.arange(len(centre)))
    freedom = np.array([len(left) - 2 - seen.placed for left, seen in zip(here.residuals, white.each, strict=True)])
    ill = np.flatnonzero(~(here.penalised(centre) < _AGAIN * np.maximum(freedom, 1)))
    if everywhere and len(ill):
        scouts = [evaluate(one, ill) for one in _scouts(model, session, rest, ill)]
        if start is not None:  # which was sought from everywhere before: the likeliest is enough
            for scout in scouts[1:]:
                _take_better(scouts[0], scout, centre[ill])
            scouts = scouts[:1]
        for scout in scouts:
            _take_better(here, _descended(evaluate, scout, ill), centre, ill)
    known = here.inside & here.differentiable
    settled = known & (here.step(centre, np.zeros(len(centre)))[1] < _NEAR)
    return _made(session, here, known, settled, freedom)


def _take_better(here: _Places, there: _Places, centre: Floats, rows: NDArray[np.int64] | None = None) -> None:
    """Replace those of some rows, by default all, that fit better elsewhere."""
    rows = np.arange(len(centre)) if rows is None else rows
    better = there.penalised(centre[rows]) < here.penalised(centre)[rows]
    here.put(rows[better], there.taken(np.flatnonzero(better)))


def _descended(evaluate: _Evaluation, here: _Places, who: NDArray[np.int64]) -> _Places:
    """Gauss-Newton steps of k capsules, given by their rows, down to where they fit best."""
    centre = evaluate.white.pilots[who]
    value = here.penalised(centre)
    damping, moving = np.full(len(value), 1e-3), np.isfinite(value)
    for _ in range(_STEPS):
        step, promised = here.step(centre, damping)
        moving &= promised > _SETTLED
        rows = np.flatnonzero(moving)
        if not len(rows):
            break
        there = evaluate(here.theta[rows] + step[rows], who[rows])
        reached = there.penalised(centre[rows])
        better = reached < value[rows] + 1e-9
        here.put(rows[better], there.taken(np.flatnonzero(better)))
        value[rows[better]] = reached[better]
        damping[rows] *= np.where(better, 0.1, 10.0)
        moving &= damping < 1e8
    return here


@dataclass(eq=False)
class _Places:
    """Where n capsules are, and what a model makes of them there.

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

    def taken(self, rows: NDArray[np.int64]) -> _Places:
        """Some of them."""
        each = [self.residuals[i] for i in rows], [self.slopes[i] for i in rows]
        return _Places(self.theta[rows], *each, self.ratio[rows], self.ratio_slopes[rows])

    def put(self, rows: NDArray[np.int64], others: _Places) -> None:
        """Replace some."""
        self.theta[rows], self.ratio[rows], self.ratio_slopes[rows] = others.theta, others.ratio, others.ratio_slopes
        for i, residual, slope in zip(rows, others.residuals, others.slopes, strict=True):
            self.residuals[i], self.slopes[i] = residual, slope

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Which have a shape of the model : (n,) array."""
        return np.array([np.isfinite(residual).all() for residual in self.residuals], dtype=bool)

    @property
    def differentiable(self) -> NDArray[np.bool_]:
        """Which have slopes : (n,) array."""
        return np.array([np.isfinite(slope).all() for slope in self.slopes], dtype=bool)

    def penalised(self, centre: Floats) -> Floats:
        """What is minimised, with a loose prior about centres (n, 2) : (n,) array, infinite outside the domain."""
        misfit = np.array([residual @ residual for residual in self.residuals])
        found = misfit + np.sum(((self.theta - centre) / _LOOSE) ** 2, axis=1)
        return np.where(np.isfinite(found), found, np.inf)

    def step(self, centre: Floats, damping: Floats) -> tuple[Floats, Floats]:
        """Damped Gauss-Newton step (n, 2), and by how much the whole one would lower what is minimised (n,)."""
        known = np.flatnonzero(self.inside & self.differentiable)
        step, promised = np.zeros_like(self.theta), np.zeros(len(self.theta))
        if not len(known):
            return step, promised
        matrix = np.array([self.slopes[i].T @ self.slopes[i] for i in known]) + np.diag(1.0 / _LOOSE**2)
        pull = np.array([self.slopes[i].T @ self.residuals[i] for i in known])
        pull += (self.theta[known] - centre[known]) / _LOOSE**2
        promised[known] = np.sum(pull * _solved(matrix, pull), axis=1)
        diagonal = np.eye(2) * matrix
        step[known] = -_solved(matrix + damping[known, None, None] * diagonal, pull)
        return np.clip(step, -np.array(_LONGEST), _LONGEST), promised


def _solved(matrices: Floats, sides: Floats) -> Floats:
    return np.asarray(np.linalg.solve(matrices, sides[..., None])[..., 0])


@dataclass(frozen=True, eq=False)
class _Evaluation:
    """What a model makes of some of the capsules somewhere; `rest` holds the circumstances and sizes of all."""

    model: ForwardModel
    white: Whitening
    rest: Mapping[str, Floats]

    def __call__(self, theta: Floats, rows: NDArray[np.int64]) -> _Places:
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

    def _towards(self, theta: Floats, rows: NDArray[np.int64], sign: float) -> _Places:
        """With slopes by differences to one side."""
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
        return _Places(theta, residuals, slopes, ratio[:, 0], ratio_slopes)


def _begun(evaluate: _Evaluation, start: Floats | None) -> _Places:
    """The capsules at a start (n, 2); at their pilots where the model has no shape there, or if there is none."""
    pilots = evaluate.white.pilots
    found = evaluate(np.array(pilots if start is None else start), np.arange(len(pilots)))
    outside = np.flatnonzero(~found.inside)
    if start is not None and len(outside):
        found.put(outside, evaluate(pilots[outside], outside))
    return found


def _made(
    session: Session,
    places: _Places,
    known: NDArray[np.bool_],
    settled: NDArray[np.bool_],
    freedom: NDArray[np.int64],
) -> Fits:
    speed = session.circumstances["capsule_velocity"] / places.ratio
    log_modulus = np.log(session.mean("viscosity") * speed) - places.theta[:, 0]
    covariance = np.full((len(settled), 2, 2), np.nan)
    for i in np.flatnonzero(known):
        slope = places.slopes[i]
        spread = np.linalg.inv(slope.T @ slope + np.diag(1.0 / _LOOSE**2))
        by_ca, by_size = -places.ratio_slopes[i] / places.ratio[i]
        along = np.array([[by_ca - 1.0, by_size], [0.0, 1.0]])
        covariance[i] = along @ spread @ along.T
    covariance[:, 0, 0] += np.square(session.velocity_errors)
    each = tuple(places.residuals), tuple(places.slopes)
    return Fits(places.theta, *each, log_modulus, places.theta[:, 1], covariance, known, settled, freedom)


def _scouts(
    model: ForwardModel, session: Session, rest: Mapping[str, Floats], rows: NDArray[np.int64], bands: int = _BANDS
) -> Floats:
    """log Ca and a/l (bands, k, 2) of the shapes nearest by their lengths in each band of Ca, for k rows of capsules.

    `rest` holds the circumstances of all and the sizes of effects.
    """
    (ca_low, ca_high), (size_low, size_high) = model.domain.bounds
    columns = np.linspace(size_low, size_high, _SCOUTS[1] + 2)[1:-1]
    ca, size = (one.ravel() for one in np.meshgrid(np.geomspace(ca_low, ca_high, _SCOUTS[0] + 2)[1:-1], columns))
    band = np.digitize(ca, np.geomspace(ca_low, ca_high, bands + 1)[1:-1])
    found = np.empty((bands, len(rows), 2))
    acting = [name for name in rest if name not in session.circumstances or name in circumstances_of(model)]
    alike: dict[tuple[float, ...], Prediction] = {}
    for k, row in enumerate(rows):
        here = tuple(float(rest[name][row]) for name in acting)
        if here not in alike:
            given = {name: np.full(ca.size, value) for name, value in zip(acting, here, strict=True)}
            alike[here] = model({**given, "capillary_number": ca, "size_ratio": size})
        seen = alike[here]
        lengths, factor = _lengths(session.measurements[row], np.zeros((2, 2)))
        away = np.full(ca.size, np.inf)
        away[seen.inside] = np.sum(np.square(OfLengths(lengths, factor)(seen))[seen.inside], axis=1)
        for j in range(bands):
            place = int(np.argmin(np.where(band == j, away, np.inf)))
            found[j, k] = np.log(ca[place]), size[place]
    return found


def _lengths(measurement: Measurement, own: Floats) -> tuple[Floats, Floats]:
    """Measured lengths (k,) and the factor (k, k) of their covariance with the model's `own` (2, 2)."""
    lengths = measurement.lengths
    covariance = measurement.covariance + own[: len(lengths), : len(lengths)]
    return lengths, scipy.linalg.cholesky(covariance, lower=True)


def _whiteners(model: ForwardModel, session: Session, pilots: Floats) -> tuple[Whitener, ...]:
    places = {**session.circumstances, "capillary_number": np.exp(pilots[:, 0]), "size_ratio": pilots[:, 1]}
    own = model(places).covariance[:, :2, :2]
    each: list[Whitener] = []
    for i, one in enumerate(session.measurements):
        if one.outline is None:
            each.append(OfLengths(*_lengths(one, own[i])))
        else:
            place = {name: float(values[i]) for name, values in places.items()}
            each.append(OfOutline(outline_likelihood(model, one.outline, place, length=one.length_beside_outline)))
    return tuple(each)
