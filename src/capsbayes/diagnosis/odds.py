"""Odds of what may explain a session: each candidate, what is like it, something else, and nothing."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.diagnosis.fits import Fits
from capsbayes.diagnosis.scores import Discrepancy, left_of_modes, standardised
from capsbayes.diagnosis.session import Session, Whitening

# What is not in the catalogue often resembles something that is: motion blur lengthens a capsule as oblong pixels do.
# Next to each candidate there is therefore what is like it: the same change of the outlines, but for a part of it that
# differs along the arc or between capsules, or whose size grows with the velocity, with a/l or with Ca. A candidate
# that explains the capsules is named only if it is far likelier than that, than all others and than a process without a
# likeness (cf. node splitting, Presanis et al. 2013, doi:10.1214/13-STS426)

Names = tuple[str, ...]
"""Names of the parameters of the effects that act together in an explanation."""

NOTHING, UNKNOWN = "none", "unknown"
"""Names of no effect, and of an effect that is not in the catalogue, next to those of the effects."""

_NOTHING, _ONE, _TWO, _ELSE = 0.5, 0.3, 0.05, 0.15  # prior probabilities; half of the last is like a candidate
_GROWTHS = (0.15, 0.4)  # of the size with velocity, a/l or Ca, per standard deviation among the capsules
_ALIKE = 0.97  # cosine of the angle between changes from which two candidates are one
_LEAST_SEEN = 1.0  # standard errors: visibility below which a change is not seen


class Change(NamedTuple):
    """Visible changes of n capsules by an explanation, after Ca and a/l have absorbed what they can."""

    seen: Mapping[int, Floats]  # by row: (m,) whitened, towards what was measured
    left: Mapping[int, Floats]  # what is left of the residuals with it
    common: Mapping[int, Floats]  # (k, m): errors that all capsules have in common

    @classmethod
    def of(cls, white: Whitening, without: Fits, fits: Fits) -> Change:
        """Compare the fits with an explanation with those without."""
        seen: dict[int, Floats] = {}
        left: dict[int, Floats] = {}
        common: dict[int, Floats] = {}
        for row, whitener in white.outlines(without.settled & fits.settled):
            seen[row] = fits.left_of(row, without.residuals[row] - fits.residuals[row])
            left[row] = fits.left_of(row, fits.residuals[row])
            common[row] = fits.left_of(row, whitener.common_errors())
        return cls(seen, left, common)

    @property
    def visibility(self) -> float:
        """Size of the change in standard errors."""
        return float(np.sqrt(sum(seen @ seen for seen in self.seen.values())))

    def cosine(self, other: Change) -> float:
        """Return the cosine of the angle between two changes, over the capsules that have both."""
        rows = self.seen.keys() & other.seen.keys()
        own, size = (_inner(seen, seen, rows) for seen in (self.seen, other.seen))
        return _inner(self.seen, other.seen, rows) / np.sqrt(own * size) if min(own, size) > 0.0 else 0.0

    def beside(self, other: Change) -> float:
        """Return how clearly another change shows in what this one leaves, in standard errors."""
        rows = self.seen.keys() & other.seen.keys()
        left, along = (_inner(other.seen, mine, rows) for mine in (self.left, self.seen))
        own, size = (_inner(seen, seen, rows) for seen in (self.seen, other.seen))
        apart = size - along**2 / own if own > 0.0 else size
        return left / np.sqrt(apart) if apart > (1.0 - _ALIKE**2) * size > 0.0 else 0.0

    def growth(self, along: Floats) -> tuple[float, float]:
        """Return how the size grows with a number (n,) of the capsules, over its error, and the information on it."""
        # The size is relative to the likeliest, the number in standard deviations.
        rows = sorted(self.seen)
        weights = np.array([self.seen[row] @ self.seen[row] for row in rows])
        away = standardised(along[rows], weights)
        score = sum(float(by * (self.seen[row] @ self.left[row])) for by, row in zip(away, rows, strict=True))
        own = np.zeros(max(len(self.common[row]) for row in rows))
        for by, row in zip(away, rows, strict=True):  # the last errors are those that all capsules share
            own[len(own) - len(self.common[row]) :] += by * (self.common[row] @ self.seen[row])
        information = float(weights @ away**2)
        error = information + float(np.sum(np.square(own)))
        return score / np.sqrt(error), information**2 / error


def _inner(one: Mapping[int, Floats], two: Mapping[int, Floats], rows: Collection[int]) -> float:
    """Return the inner product of numbers (m,) by row over some of the rows."""
    return sum(float(one[row] @ two[row]) for row in rows)


def log_mean(logs: Floats, axis: int = 0) -> Floats:
    """Return the logarithm of the mean of numbers whose logarithms are given."""
    return np.asarray(logsumexp(logs, axis=axis) - np.log(logs.shape[axis]))


def _of_growth(deviate: Floats, information: Floats) -> Floats:
    """Return the log evidences (g, ...) of growing sizes, from the growth over its error and its information."""
    variances = np.square(_GROWTHS).reshape(-1, *np.ones(np.ndim(deviate), int)) * information
    return np.asarray(-0.5 * np.log1p(variances) + 0.5 * deviate**2 * variances / (1.0 + variances))


@dataclass(frozen=True, eq=False)
class Explanation:
    """Effects that act together, with what they leave."""

    log_evidence: float  # relative to no effect
    change: Change
    left: Discrepancy

    def log_likeness(self, session: Session, without: Fits, scale: float) -> float:
        """Return the log evidence of what is like it, relative to it; `scale` is the visibility of a unit process."""
        if not len(self.left.places):
            return self.left.trend.evidence
        if self.change.visibility < _LEAST_SEEN:
            return -np.inf
        along = np.log(session.circumstances["capsule_velocity"]), without.size, without.theta[:, 0]
        growth = [_of_growth(*map(np.asarray, self.change.growth(numbers))) for numbers in along]
        grown = float(log_mean(np.concatenate(growth)))
        return float(log_mean(np.array([*self.left.like(self.change.visibility / scale), grown])))


@dataclass(frozen=True, eq=False)
class Odds:
    """Log probabilities of all explanations of a session, up to a constant."""

    exact: Mapping[Names, float]  # the likeliest first
    like: Mapping[Names, float]  # of what is like each of them
    other: float  # of something else without a likeness
    nothing: float
    alike: Mapping[Names, frozenset[Names]]  # those that change the outlines in the same way, itself among them
    visibility: Mapping[Names, float]

    @classmethod
    def of(
        cls, explanations: Mapping[Names, Explanation], something_else: Discrepancy, session: Session, without: Fits
    ) -> Odds:
        """Weigh single effects and pairs of them, something else, and nothing."""
        single = sum(len(names) == 1 for names in explanations)
        prior = {1: np.log(_ONE / max(single, 1)), 2: np.log(_TWO / max(single * (single - 1) / 2.0, 1.0))}
        scale = something_else.scale if len(something_else.places) else 1.0
        exact = {names: prior[len(names)] + each.log_evidence for names, each in explanations.items()}
        share = np.log(0.5 * _ELSE / max(single, 1)) - prior[1]
        like = {
            names: exact[names] + share + each.log_likeness(session, without, scale)
            for names, each in explanations.items()
        }
        alike = {
            names: frozenset(
                other
                for other, compared in explanations.items()
                if other == names or abs(each.change.cosine(compared.change)) > _ALIKE
            )
            for names, each in explanations.items()
        }
        return cls(
            exact=dict(sorted(exact.items(), key=lambda item: -item[1])),
            like=like,
            other=float(np.log(0.5 * _ELSE) + something_else.evidence),
            nothing=float(np.log(_NOTHING)),
            alike=alike,
            visibility={names: each.change.visibility for names, each in explanations.items()},
        )

    @property
    def something_else(self) -> float:
        """Log probability of what is in no candidate."""
        return float(logsumexp([self.other, *self.like.values()]))

    @property
    def whole(self) -> float:
        """Log of the sum of all probabilities."""
        return float(logsumexp([self.nothing, self.something_else, *self.exact.values()]))

    @property
    def against_nothing(self) -> float:
        """Log odds of any explanation over none."""
        return float(logsumexp([self.something_else, *self.exact.values()])) - self.nothing

    @property
    def best(self) -> Names:
        """The likeliest effect or effects."""
        return next(iter(self.exact), ())

    def margin(self, names: Names) -> float:
        """Return the log odds of an explanation, or others that change the same, over everything else."""
        same = [self.exact[each] for each in self.alike[names]]
        rest = [log for each, log in self.exact.items() if each not in self.alike[names]]
        return float(logsumexp(same) - logsumexp([self.nothing, self.something_else, *rest]))

    def least_visibility(self, names: Names) -> float:
        """Return the visibility of an effect, of two that of what the second adds to the clearer one."""
        alone = max(self.visibility[(name,)] for name in names)
        together = self.visibility[names]
        return together if len(names) == 1 else float(np.sqrt(max(together**2 - alone**2, 0.0)))

    def in_question(self, lag: float) -> tuple[tuple[Names, ...], bool]:
        """Return what lags behind the likeliest by no more than so much, and whether something else does."""
        most = max(self.nothing, self.something_else, *self.exact.values()) if self.exact else self.something_else
        names = tuple(each for each, log in self.exact.items() if log > most - lag)
        return names, bool(self.something_else > most - lag)

    @property
    def probabilities(self) -> dict[str, float]:
        """Probability of each effect alone, of two together, of "unknown" and of "none", the most probable first."""
        logs = {" and ".join(names): log for names, log in self.exact.items()}
        logs |= {UNKNOWN: self.something_else, NOTHING: self.nothing}
        whole = self.whole
        return {name: float(np.exp(log - whole)) for name, log in sorted(logs.items(), key=lambda item: -item[1])}


# How often a name is wrong: each candidate in turn is the truth, at the visibility that is seen, and not among those
# that are tried. The capsules' residuals are drawn with its change and the noise, and judged by the same odds, with
# changes proportional to the sizes

_DRAWS = 40
_WRONG = 0.01  # share of wrong names at the threshold
_LEAST_MARGIN = 1.0  # log odds of a name, at least
_USUAL_MARGIN = 3.0  # of a name where too few effects are tried to leave one out


class Calibration(NamedTuple):
    """Log odds from which a name is given, and how often one so given is wrong, and right, in sessions like these."""

    threshold: float
    wrong: float
    power: float

    @classmethod
    def of(
        cls,
        changes: Mapping[Names, Change],
        visibility: float,
        something_else: Discrepancy,
        white: Whitening,
        without: Fits,
        session: Session,
        seed: int,
    ) -> Calibration:
        """Draw sessions in which one of the candidates is the truth."""
        seen = {names: each for names, each in changes.items() if each.visibility > 0.5 * _LEAST_SEEN}
        if visibility < _LEAST_SEEN:
            return cls(np.inf, np.nan, np.nan)
        if len(seen) < _FEWEST:
            return cls(_USUAL_MARGIN, np.nan, np.nan)
        drawn = _Drawn.of(seen, something_else, white, without, session)
        rng = np.random.default_rng([seed, len(session)])
        noise = drawn.free(rng.standard_normal((len(drawn.units.T), _DRAWS)))
        wrong, right = [], []
        for number, unit in enumerate(drawn.units):
            residuals = visibility * unit[:, None] + noise
            same = drawn.alike[number]
            wrong.append(drawn.margins(residuals, visibility, ~same)[0])
            margins, best = drawn.margins(residuals, visibility, np.ones_like(same))
            right.append(np.where(same[best], margins, -np.inf))
        threshold = max(float(np.quantile(wrong, 1.0 - _WRONG)), _LEAST_MARGIN)
        return cls(threshold, float(np.mean(np.array(wrong) > threshold)), float(np.mean(np.array(right) > threshold)))


_FEWEST = 3  # candidates of which one is left out


@dataclass(frozen=True, eq=False)
class _Drawn:
    """What decides the odds of drawn residuals (D,) of all capsules with outlines."""

    units: Floats  # (K, D): changes by the candidates, of length one
    growing: Floats  # (K, 3, D): the same, growing with velocity, a/l and Ca
    alike: Floats  # (K, K): whether two change the same
    bases: tuple[Floats, ...]  # (m, 2) of each capsule: what Ca and a/l absorb
    modes: tuple[Floats, ...]  # (q, m) of each capsule
    something_else: Discrepancy

    @classmethod
    def of(
        cls,
        changes: Mapping[Names, Change],
        something_else: Discrepancy,
        white: Whitening,
        without: Fits,
        session: Session,
    ) -> _Drawn:
        rows = sorted(set.intersection(*({*change.seen} for change in changes.values())))
        outlines = dict(white.outlines(without.settled))
        speed = np.log(session.circumstances["capsule_velocity"])
        along = np.stack([speed, without.size, without.theta[:, 0]])[:, rows]
        units, growing = [], []
        for change in changes.values():
            seen = [change.seen[row] for row in rows]
            weights = np.array([each @ each for each in seen])
            length = np.sqrt(weights.sum())
            units.append(np.concatenate(seen) / length)
            sizes = [standardised(one, weights) for one in along]
            grown = [[by * each for by, each in zip(size, seen, strict=True)] for size in sizes]
            growing.append([np.concatenate(each) / length for each in grown])
        own = np.array(units)
        return cls(
            units=own,
            growing=np.array(growing),
            alike=np.abs(own @ own.T) > _ALIKE,
            bases=tuple(map(without.absorbed, rows)),
            modes=tuple(left_of_modes(outlines[row], without, row) for row in rows),
            something_else=something_else.taken([[*outlines].index(row) for row in rows]),
        )

    def free(self, residuals: Floats) -> Floats:
        """Return residuals (D, N) without what Ca and a/l of each capsule absorb."""
        parts = np.split(residuals, np.cumsum([len(basis) for basis in self.bases])[:-1])
        return np.concatenate([part - basis @ (basis.T @ part) for part, basis in zip(parts, self.bases, strict=True)])

    def margins(self, residuals: Floats, visibility: float, tried: Booleans) -> tuple[Floats, Integers]:
        """Return the margin (N,) of the likeliest of the candidates that are tried (K,), and which it is (N,)."""
        count, columns = len(self.units), np.arange(residuals.shape[1])
        size = self.units @ residuals
        exact = np.where(tried[:, None], 0.5 * size**2 - np.log(visibility) - 1.0, -np.inf)
        best = np.argmax(exact, axis=0)
        left = residuals - self.units[best].T * size[best, columns]
        growth = np.einsum("NgD,DN->gN", self.growing[best], left)
        likeness = self.something_else.like_shifts(self._shifts(left), visibility / self.something_else.scale)
        grown = log_mean(np.concatenate(_of_growth(growth, np.maximum(size[best, columns], 1.0) ** 2)))
        like = exact[best, columns] + log_mean(np.concatenate([likeness, grown[None]]))
        same = self.alike[best].T
        one, beside = np.log(_ONE / count), np.log(0.5 * _ELSE)
        other = self.something_else.of_shifts(self._shifts(residuals))
        rest = [np.where(same, -np.inf, one + exact), (beside + other)[None]]
        rest += [(beside - np.log(count) + like)[None], np.full((1, len(columns)), np.log(_NOTHING))]
        named = logsumexp(np.where(same, one + exact, -np.inf), axis=0)
        return named - logsumexp(np.concatenate(rest), axis=0), best

    def _shifts(self, residuals: Floats) -> Floats:
        """Return the information times the likeliest amplitudes of the displacement modes : (n, q, N) array."""
        parts = np.split(residuals, np.cumsum([len(basis) for basis in self.bases])[:-1])
        return np.array([modes @ part for modes, part in zip(self.modes, parts, strict=True)])
