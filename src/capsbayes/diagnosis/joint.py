"""Joint estimate of two effects: the likeliest sizes of both, and the profile likelihood of each.

The log likelihood of both sizes is climbed by parabolas through six points, from the likeliest of a few starts: where
one effect absorbs most of the other, both may be far from the sizes found one after the other. Through the top runs,
for each of the effects, the line on which the other has its likeliest size; along these lines both are scored.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.diagnosis.fits import Fits, fitted
from capsbayes.diagnosis.scoring import REACH, Measured, Outcome, Scores, log_of_measured
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.whitening import Whitening
from capsbayes.model import FixedParameters, ForwardModel

_DESIGN = np.array([(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 1.0)])
_APART = 1.5  # of these points, in standard errors of one size at a fixed other
_CLIMBS = 4
_STARTS = (0.25, 0.5, 0.75)  # sizes of the second, over its range, at which the first is sought anew
_FARTHEST = 4.0  # in units of the design
_NEAR = 0.3  # the same
_SIGMAS = (-4.5, -2.2, -1.0, 0.0, 1.0, 2.2, 4.5)  # standard errors, at which each effect is scored


class _Top(NamedTuple):
    """Likeliest sizes (2,), and their covariance (2, 2) by a parabola."""

    sizes: Floats
    covariance: Floats


def score_jointly(
    model: ForwardModel,
    first: Scores,
    second: Scores,
    session: Session,
    white: Whitening,
    alone: Fits,
    measured: Measured,
) -> tuple[Scores, Scores]:
    """Score two effects jointly on a model without either; each is maximised over the size of the other."""
    # The first was scored alone, the second with the first at its size. `alone` are the fits of the model with the
    # first alone at its size: what the second is measured against.
    pair = _Pair(model, (first, second), session, white, alone, measured)
    top = pair.climbed()
    without_second = Outcome.of(alone), first.size
    held = FixedParameters(model + second.effect, {second.effect.parameter.name: float(top.sizes[1])})
    without_first = Outcome.of(fitted(held, session, white)), float(top.sizes[1])
    return pair.along(0, top, *without_first), pair.along(1, top, *without_second)


class _Pair:
    """Log likelihood as a function of the sizes of two effects, with a cache."""

    def __init__(
        self,
        model: ForwardModel,
        scores: tuple[Scores, Scores],
        session: Session,
        white: Whitening,
        alone: Fits,
        measured: Measured,
    ) -> None:
        self.model = model + scores[0].effect + scores[1].effect
        self.scores, self.session, self.white, self.measured = scores, session, white, measured
        self.names = [score.effect.parameter.name for score in scores]
        priors = [score.effect.prior for score in scores]
        self.low, self.high = (np.array([float(prior.ppf(end)) for prior in priors]) for end in REACH)
        self.scale = np.array([max(0.5 * np.ptp(score.interval()), 1e-6 * np.ptp(score.sizes)) for score in scores])
        self._start = alone.theta
        self._known: dict[tuple[float, ...], Outcome] = {}

    def __call__(self, sizes: Floats) -> Outcome:
        """Fit the capsules with both effects at given sizes (2,)."""
        key = tuple(sizes.tolist())
        if key not in self._known:
            named = dict(zip(self.names, key, strict=True))
            first = not self._known
            fits = fitted(self.model, self.session, self.white, named, self._start, everywhere=first)
            self._known[key] = Outcome.of(fits)
            if first:
                self._start = fits.theta
        return self._known[key]

    def total(self, sizes: Floats) -> float:
        """Return the log likelihood of all measurements."""
        return float(self(sizes).log_likelihood.sum() + self._elsewhere(sizes))

    def climbed(self) -> _Top:
        """Find the likeliest sizes of both."""
        step = np.minimum(_APART * self.scale, 0.25 * (self.high - self.low))
        centre = self._begun(step)
        covariance = np.diag(self.scale**2)
        for _ in range(_CLIMBS):
            centre = np.clip(centre, self.low + step, self.high - step)
            totals = np.array([self.total(centre + step * point) for point in _DESIGN])
            top, bend = _parabola(totals)
            away = float(np.abs(top).max())
            if np.all(np.linalg.eigvalsh(bend) < 0.0):
                covariance = np.outer(step, step) * np.linalg.inv(-bend)
                centre = centre + step * top * min(1.0, _FARTHEST / max(away, _FARTHEST))
            else:
                centre, away = centre + step * _DESIGN[np.argmax(totals)], np.inf
            if away < _NEAR:
                break
        return _Top(np.clip(centre, self.low, self.high), covariance)

    def _begun(self, step: Floats) -> Floats:
        """Return the likeliest (2,) of the sizes found one after the other, and of the first sought anew at others."""
        starts = [np.array([score.size for score in self.scores])]
        first = np.clip(starts[0][0], self.low[0] + step[0], self.high[0] - step[0])
        for share in _STARTS:
            second = self.low[1] + share * (self.high[1] - self.low[1])
            left, here, right = (self.total(np.array([first + side * step[0], second])) for side in (-1.0, 0.0, 1.0))
            bend = left - 2.0 * here + right
            away = 0.5 * (left - right) / bend if bend < 0.0 else np.sign(right - left) * _FARTHEST
            size = first + step[0] * np.clip(away, -_FARTHEST, _FARTHEST)
            starts.append(np.clip(np.array([size, second]), self.low, self.high))
        return max(starts, key=self.total)

    def along(self, which: int, top: _Top, without: Outcome, other_without: float) -> Scores:
        """Score one of the effects with the other at its likeliest size; `without` has the other alone."""
        other = 1 - which
        error = float(np.sqrt(top.covariance[which, which]))
        slope = top.covariance[which, other] / top.covariance[which, which]
        null = self.scores[which].effect.null_value
        rows: dict[float, tuple[Outcome, float]] = {}
        for sigma in _SIGMAS:
            sizes = np.array(top.sizes)
            sizes[which] = np.clip(sizes[which] + sigma * error, self.low[which], self.high[which])
            sizes[other] = np.clip(
                sizes[other] + slope * (sizes[which] - top.sizes[which]), self.low[other], self.high[other]
            )
            rows[float(sizes[which])] = self(sizes), self._elsewhere(sizes)
        at_null = np.empty(2)
        at_null[which], at_null[other] = null, other_without
        rows[null] = without, self._elsewhere(at_null)
        sizes = np.array(sorted(rows))
        tried, elsewhere = zip(*(rows[size] for size in sizes), strict=True)
        return Scores(
            self.scores[which].effect,
            sizes,
            np.array([outcome.log_likelihood for outcome in tried]),
            np.array(elsewhere),
            np.array([outcome.modulus for outcome in tried]),
        )

    def _elsewhere(self, sizes: Floats) -> float:
        return sum(
            float(log_of_measured(size, self.measured.get(name))) for name, size in zip(self.names, sizes, strict=True)
        )


def _parabola(totals: Floats) -> tuple[Floats, Floats]:
    """Return the top (2,) and the second derivatives (2, 2) of the parabola through the points of the design."""
    here, right, left, up, down, both = totals
    slope = 0.5 * np.array([right - left, up - down])
    mixed = both - right - up + here
    bend = np.array([[right + left - 2.0 * here, mixed], [mixed, up + down - 2.0 * here]])
    return np.linalg.lstsq(-bend, slope, rcond=None)[0], bend
