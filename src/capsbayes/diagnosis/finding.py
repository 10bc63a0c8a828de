"""Where the capsules of a session disagree with a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import beta, binom, norm

from capsbayes.arrays import Floats, Integers
from capsbayes.diagnosis.fits import Fits, fitted
from capsbayes.diagnosis.scores import (
    REACH,
    REGIONS,
    Discrepancy,
    Measured,
    Outcome,
    Scores,
    log_of_measured,
    region_displacements,
    whitening,
)
from capsbayes.diagnosis.session import Session, Whitening
from capsbayes.model import FixedParameters, ForwardModel

# Joint estimate of two effects. The log likelihood of both sizes is climbed by parabolas through six points, from the
# likeliest of a few starts: where one effect absorbs most of the other, both may be far from the sizes found one after
# the other. Through the top runs, for each of the effects, the line on which the other has its likeliest size; along
# these lines both are scored

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


class Pair(NamedTuple):
    """Scores of two effects jointly, each maximised over the size of the other, and the fits at the likeliest sizes."""

    first: Scores
    second: Scores
    fits: Fits
    log_evidence: float  # relative to neither

    @property
    def turned(self) -> Pair:
        """The same with the second first."""
        return self._replace(first=self.second, second=self.first)


def score_jointly(
    model: ForwardModel,
    first: Scores,
    second: Scores,
    session: Session,
    white: Whitening,
    alone: Fits,
    measured: Measured,
) -> Pair:
    """Score two effects jointly on a model without either."""
    # The first was scored alone, the second with the first at its size. `alone` are the fits of the model with the
    # first alone at its size: what the second is measured against.
    pair = _Pair(model, (first, second), session, white, alone, measured)
    top = pair.climbed()
    without_second = Outcome.of(alone), first.size
    held = FixedParameters(model + second.effect, {second.effect.parameter.name: float(top.sizes[1])})
    without_first = Outcome.of(fitted(held, session, white)), float(top.sizes[1])
    along = pair.along(1, top, *without_second)
    return Pair(pair.along(0, top, *without_first), along, pair(top.sizes).fits, first.evidence + along.evidence)


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
        sizes = np.array(top.sizes)
        for sigma in _SIGMAS:
            sizes[which] = np.clip(top.sizes[which] + sigma * error, self.low[which], self.high[which])
            along = top.sizes[other] + slope * (sizes[which] - top.sizes[which])
            sizes[other] = np.clip(along, self.low[other], self.high[other])
            rows[float(sizes[which])] = self(sizes), self._elsewhere(sizes)
        sizes[which], sizes[other] = null, other_without
        rows[null] = without, self._elsewhere(sizes)
        tried = sorted(rows)
        outcomes, elsewhere = zip(*(rows[size] for size in tried), strict=True)
        return Scores.of(self.scores[which].effect, tried, outcomes, elsewhere)

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


# Error of an effect's size by the model's own error, which all capsules of a session share

_STEP = 0.5  # of the half width of the 68 % interval


def own_size_error(model: ForwardModel, scores: Scores, session: Session) -> float:
    """Return the standard error of an effect's size by the model's own error, if that is the same in all capsules."""
    # Where an outline changes with the size, after Ca and a/l have absorbed what they can, the own error of each
    # capsule is taken in the direction that changes the size; zero without outlines.
    name = scores.effect.parameter.name
    extended = model + scores.effect
    low, high = scores.profile_interval()
    away = _STEP * max(0.5 * (high - low), 1e-4 * float(np.ptp(scores.sizes)))
    step = away if scores.size + away <= scores.sizes[-1] else -away
    white = whitening(FixedParameters(extended, {name: scores.size}), session)
    here = fitted(extended, session, white, {name: scores.size})
    there = fitted(extended, session, white, {name: scores.size + step}, here.theta, everywhere=False)
    moved, weight = 0.0, (2.0 / (high - low)) ** 2 if high > low else 0.0
    seen_change = 0.0
    for row, seen in white.outlines(here.settled & there.settled):
        change = (there.residuals[row] - here.residuals[row]) / step
        moved += float(np.linalg.norm(seen.errors_of_model() @ change))
        seen_change += float(change @ change)
    weight = max(weight, seen_change)  # the former counts the scatter of G_s too
    return moved / weight if weight > 0.0 else 0.0


# Effects that could hide in a session: how large each may be without contradicting the capsules

TWO_SIGMA = 1.92
"""Fall of the log likelihood at the ends of a 95 % interval."""


def limits_table(scores: Mapping[str, Scores]) -> pd.DataFrame:
    """Return a row for each effect, that which could change G_s most first, indexed by the name of its parameter."""
    rows = {}
    for name, found in scores.items():
        low, high = found.interval(TWO_SIGMA)
        changes = np.exp(found.log_modulus_change((low, high)))
        if np.isnan(changes).any() or not np.isfinite(found.modulus[found.null]):
            continue
        least, most = (float(found.effect.prior.ppf(share)) for share in REACH)
        null = found.effect.null_value
        rows[name] = {
            "effect": found.effect.name,
            "low": low,
            "high": high,
            "unit": found.effect.parameter.unit,
            **dict(zip(("modulus_at_low", "modulus_at_high"), map(float, changes), strict=True)),
            "unbounded": bool(low <= least < null or high >= most > null),
        }
    table = pd.DataFrame.from_dict(rows, orient="index")
    if table.empty:
        return table
    change = np.abs(np.log(table[["modulus_at_low", "modulus_at_high"]])).max(axis=1)
    return table.loc[change.sort_values(ascending=False).index]


# Shear modulus of a session, with what is not known of the effect, of its size, and of the viscosity

_DRAWS = 4000
_FEWEST_CAPSULES = 3  # capsules, whose scatter tells the error of their median
_OF_MEDIAN = 1.2533  # standard error of a median of normal values over that of their mean


_STEEPNESS, _STEEPNESS_SPREAD = 20.0, 1.25  # |d ln G_s| per l of visible displacement by effects: median, sd of its log
_LARGEST_CHANGE = 0.8  # standard deviation of ln G_s by anything that is not known


@dataclass(frozen=True, eq=False)
class UnknownChange:
    """Change of G_s by what is not known, which displaces the outlines by amplitudes (k,) [l] of probabilities (k,)."""

    amplitudes: Floats
    probabilities: Floats

    def log_modulus_changes(self, rng: np.random.Generator, count: int) -> Floats:
        """Draw changes of ln G_s : (count,) array."""
        # Effects of the catalogue change ln G_s by 2 to 120 per half width of visible displacement, either way.
        amplitude = rng.choice(self.amplitudes, count, p=self.probabilities)
        steepness = _STEEPNESS * np.exp(_STEEPNESS_SPREAD * rng.standard_normal(count))
        return np.asarray(rng.choice([-1.0, 1.0], count) * steepness * amplitude)


Changes = Sequence[Scores | UnknownChange]
"""What acts together; empty for nothing."""


@dataclass(frozen=True)
class SessionModulus:
    """Median G_s of the capsules of a session [N/m], and its 95 % interval."""

    median: float
    low: float
    high: float


def session_modulus(
    explanations: Sequence[tuple[float, Changes]],
    without: Floats,
    scatter: float,
    viscosity_error: float,
    seed: int,
) -> SessionModulus:
    """Return the median G_s, averaged over explanations of given weights."""
    # `without` (n,) [N/m] are the apparent G_s without an effect, and `scatter` is the standard deviation of ln G_s of
    # the capsules with the likeliest; the relative error of the viscosity is common to all capsules. Changes are
    # weighted by a normal prior.
    rng = np.random.default_rng([seed, len(without)])
    weights = np.array([weight for weight, _ in explanations])
    logs = np.log(without[np.isfinite(without)])
    if len(logs) < _FEWEST_CAPSULES:
        return SessionModulus(*(3 * [float("nan")]))
    counts = rng.multinomial(_DRAWS, weights / weights.sum())
    drawn = np.concatenate(
        [
            sum((change.log_modulus_changes(rng, count) for change in changes), start=np.zeros(count))
            for count, (_, changes) in zip(counts, explanations, strict=True)
        ]
    )
    likely = np.exp(-0.5 * np.square(drawn / _LARGEST_CHANGE))
    drawn = np.median(logs) + rng.choice(drawn, _DRAWS, p=likely / likely.sum())
    drawn += _OF_MEDIAN * scatter / np.sqrt(len(logs)) * rng.standard_t(len(logs) - 1, _DRAWS)
    drawn += viscosity_error * rng.standard_normal(_DRAWS)
    low, median, high = np.exp(np.quantile(drawn, (0.025, 0.5, 0.975)))
    return SessionModulus(float(median), float(low), float(high))


# A deviation is an amplitude that the capsules have in common: of a displacement of one region of the outline, after
# the best Ca and a/l of each capsule have absorbed what they can, or of a trend of the apparent shear modulus with
# velocity or size. Each capsule contributes one number. Their scatter, not the stated noise, says how surprising their
# sum is, so that noise that is correlated along the outline, heavy-tailed or wrongly stated makes no claims; and since
# under a right model each contribution is as likely positive as negative, changing their signs at random gives the
# distribution of the largest of all deviations. The model's own error is taken as common to all capsules, in the
# direction that hurts most

_FLIPS = 4999
_WITHOUT = 0.05  # of the capsules that a right model leaves without a shape, at most: debris, gross errors
_SHAPELESS = "share of capsules without a shape"
_FOLLOWS = 1e-3  # of its variance, with less of which a circumstance follows from others
_FEWEST = 4  # contributions, up to which a deviation is not judged
FLOW = "v_o over that of the flow rate"
TRENDS = {
    "velocity": "trend of ln G_s with ln v_o",
    "size": "trend of ln G_s with a/l",
    "viscosity": "trend of ln G_s with ln mu",
    "order": "drift of ln G_s with time",
}
_KINDS = "two kinds of capsules by ln G_s"
_ONE_MODULUS = ("velocity", "size", "viscosity")  # trends of a modulus that is not the same in all circumstances


@dataclass(frozen=True)
class Deviation:
    """Deviation from the model that the capsules have in common."""

    name: str  # a region of the outline, or a trend
    size: float  # amplitude [unit]
    error: float  # its standard error
    unit: str
    p_value: float  # probability that under a right model the largest of all deviations is as large

    @property
    def sigma(self) -> float:
        """Size over standard error."""
        return self.size / self.error

    def __str__(self) -> str:
        """Return the name, the amplitude and its significance."""
        unit = f" {self.unit}" if self.unit else ""
        words = f"{self.size:+.3g} ± {self.error:.2g}{unit}, {self.sigma:+.1f} σ, p-value {self.p_value:.2g}"
        return f"{self.name}: {words}"


@dataclass(frozen=True)
class Finding:
    """Deviations of a session from a model."""

    deviations: tuple[Deviation, ...]  # the most surprising first
    noise: float  # root of the misfit over its degrees of freedom: the noise over that assumed; NaN without any
    capsules: int  # that were fitted
    discrepancy: Discrepancy = field(default_factory=Discrepancy, repr=False)  # evidence for what no effect describes
    further_noise: float = 0.0  # [l], of single outlines, that was assumed beyond what is stated
    one_modulus: float = np.nan  # p-value of one G_s at every velocity, size and viscosity

    def table(self) -> pd.DataFrame:
        """Return a row for each deviation: ``size`` and ``error`` [``unit``], ``sigma``, ``p_value``."""
        columns = ("size", "error", "unit", "sigma", "p_value")
        rows = {deviation.name: [getattr(deviation, column) for column in columns] for deviation in self.deviations}
        return pd.DataFrame.from_dict(rows, orient="index", columns=columns)

    @property
    def p_value(self) -> float:
        """Probability under a right model of a deviation at least as large as the largest."""
        return min((deviation.p_value for deviation in self.deviations), default=1.0)

    def __str__(self) -> str:
        """Return the largest deviation in one line."""
        if not self.deviations:
            return f"{self.capsules} capsules, too few to compare"
        return f"{self.deviations[0]} in {self.capsules} capsules"


def find(
    model: ForwardModel,
    session: Session,
    *,
    seed: int,
    white: Whitening | None = None,
    fits: Fits | None = None,
) -> Finding:
    """Test a session for deviations from a model: the outlines region by region, without outlines the trends alone."""
    # The whitening is made with the model without its effects, by default with `model`; the fits are those of `model`.
    # The seed is that of the random signs.
    white = whitening(model, session) if white is None else white
    fits = fitted(model, session, white) if fits is None else fits
    done = np.flatnonzero(fits.settled)
    rest = {name: values[done] for name, values in session.circumstances.items()}
    own = _own_error_of_modulus(model, rest, fits.theta[done])
    trends = _of_trends(session, fits, done, own)
    table = [test for test in (*_of_regions(session, white, fits), *trends) if len(test.contributions) > _FEWEST]
    freedom = int(fits.freedom[done].sum())
    noise = float(np.sqrt(fits.misfit[done].sum() / freedom)) if freedom else float("nan")
    p_values = _by_signs(table, np.random.default_rng([seed, len(done)]))
    by_surprise = sorted(zip(table, p_values, strict=True), key=lambda pair: (pair[1], -abs(pair[0].statistic)))
    deviations = [
        Deviation(test.name, test.size * test.scale, test.error * test.scale, test.unit, float(p_value))
        for test, p_value in by_surprise
    ]
    discrepancy = Discrepancy.of(session, white, fits)
    deviations += [*_of_flow(fits, len(table)), *_without_a_shape(fits), *_of_kinds(discrepancy, len(table))]
    one_modulus = [test for test in trends if test.name in {TRENDS[name] for name in _ONE_MODULUS}]
    return Finding(
        tuple(sorted(deviations, key=lambda deviation: deviation.p_value)),
        noise,
        len(done),
        discrepancy,
        white.further,
        float(min(_by_signs(one_modulus, np.random.default_rng([seed, len(done)])), default=np.nan)),
    )


def _without_a_shape(fits: Fits) -> list[Deviation]:
    """Return the deviation that too many capsules have no shape of the model, if they are too many."""
    ill, count = int(fits.ill.sum()), len(fits.ill)
    if ill <= _WITHOUT * count:
        return []
    p_value = float(binom.sf(ill - 1, count, _WITHOUT))
    share, error = beta(ill + 1, count - ill + 1).stats()
    return [Deviation(_SHAPELESS, float(share), float(np.sqrt(error)), "", p_value)]


def _of_kinds(discrepancy: Discrepancy, others: int) -> list[Deviation]:
    """Return how far two kinds of capsules lie apart; by Markov's inequality the odds of two bound the p-value."""
    kinds = discrepancy.trend.kinds
    if not np.isfinite(kinds.apart):
        return []
    return [Deviation(_KINDS, kinds.apart, kinds.error, "", float(min(1.0, (others + 1) * np.exp(-kinds.evidence))))]


@dataclass(frozen=True, eq=False)
class _Test:
    """Contributions (c,) of the capsules to an amplitude, their weights (c,) and the model's own error `own` (c,)."""

    name: str
    unit: str
    scale: float
    contributions: Floats
    weights: Floats
    own: Floats

    @property
    def size(self) -> float:
        return float(self.contributions.sum() / self.weights.sum())

    @property
    def spread(self) -> float:
        """Variance of the sum of the contributions if their mean is zero, and the model's error common to all."""
        return float(np.sum(self.contributions**2) + np.sum(self.own) ** 2)

    @property
    def error(self) -> float:
        away = self.contributions - self.size * self.weights
        return float(np.sqrt(np.sum(away**2) + np.sum(self.own) ** 2) / self.weights.sum())

    @property
    def statistic(self) -> float:
        """Statistic that is compared under random signs; at most the root of the number of capsules."""
        return float(self.contributions.sum() / np.sqrt(self.spread))


def _by_signs(table: list[_Test], rng: np.random.Generator) -> Floats:
    """Return the p-value of each test: the probability that the largest statistic under random signs is as large."""
    # The signs as they are count among those drawn, so that no p-value is zero (Phipson & Smyth 2010, Stat. Appl.
    # Genet. Mol. Biol. 9, 39, doi:10.2202/1544-6115.1585).
    if not table:
        return np.empty(0)
    capsules = max(len(test.contributions) for test in table)
    signs = rng.choice([-1.0, 1.0], (_FLIPS, capsules))
    largest = np.zeros(_FLIPS)
    for test in table:
        count = len(test.contributions)
        own = rng.standard_normal(_FLIPS) * test.own.sum()
        drawn = (signs[:, :count] @ test.contributions + own) / np.sqrt(test.spread)
        largest = np.maximum(largest, np.abs(drawn))
    least = [(1.0 - 1e-9) * abs(test.statistic) for test in table]  # those drawn may repeat the signs as they are
    return np.array([(1 + np.sum(largest >= statistic)) / (_FLIPS + 1) for statistic in least])


def _of_regions(session: Session, white: Whitening, fits: Fits) -> list[_Test]:
    """Return the tests for a common displacement of each region, once ln Ca and a/l have absorbed what they can."""
    rows: list[tuple[Floats, Floats, Floats]] = []
    for row, seen in white.outlines(fits.settled):
        whole = seen.likelihood.whitened_displacement(region_displacements(seen.likelihood.pilot))
        pattern = fits.left_of(row, whole)
        own = np.linalg.norm(pattern @ seen.common_errors().T, axis=1)
        rows.append((pattern @ fits.residuals[row], np.sum(pattern**2, axis=1), own))
    if not rows:
        return []
    contributions, weights, own = (np.array(column).T for column in zip(*rows, strict=True))
    in_um = 1e6 * session.mean("half_width")
    return [_Test(name, "um", in_um, *each) for name, *each in zip(REGIONS, contributions, weights, own, strict=True)]


def _of_trends(session: Session, fits: Fits, done: Integers, own: Floats) -> list[_Test]:
    """Return the tests for slopes of the apparent ln G_s, corrected for errors that both variables share."""
    if not len(done):
        return []
    velocity, viscosity = (np.log(session.circumstances[name][done]) for name in ("capsule_velocity", "viscosity"))
    columns = {"velocity": velocity, "size": fits.size[done], "viscosity": viscosity, "order": session.order[done]}
    together = {"velocity": np.square(session.velocity_errors[done]), "size": fits.covariance[done, 0, 1]}
    columns = {name: values for name, values in columns.items() if np.ptp(values) > 1e-3}
    if len(done) <= _FEWEST + len(columns):
        return []
    weight = 1.0 / (fits.covariance[done, 0, 0] + _scatter(fits, done))
    tests = []
    for name, values in columns.items():  # viscosity and order may follow the others, and come after them
        before = [*columns][: max([*columns].index(name), 2)]
        others = np.stack([np.ones(len(done)), *(columns[other] for other in before if other != name)], axis=1)
        across = values - others @ _solved(others, values, weight)
        if weight @ across**2 < _FOLLOWS * (weight @ (values - np.average(values, weights=weight)) ** 2):
            continue
        about = fits.log_modulus[done] - others @ _solved(others, fits.log_modulus[done], weight)
        contributions = weight * (across * about - together.get(name, 0.0))
        tests.append(_Test(TRENDS[name], "", 1.0, contributions, weight * across**2, weight * np.abs(across) * own))
    return tests


def _of_flow(fits: Fits, others: int) -> list[Deviation]:
    """Return the mean of the velocities over those of the flow rates, if these are known."""
    # Its error is mostly that of the flow rate and the half width, which is stated and common to all; the scatter is
    # taken about the mean, where a clear offset does not count as scatter. The p-value allows for the number of other
    # tests, whose own p-values it leaves as they are.
    known = fits.settled & fits.flow.known
    count = int(known.sum())
    if count <= _FEWEST:
        return []
    weight = 1.0 / fits.flow.variance[known]
    weight /= weight.sum()
    offset, shared = fits.flow.offset[known], fits.flow.shared[known]
    mean = float(weight @ offset)
    scatter = np.sum(np.square(weight * (offset - mean))) * count / (count - 1.0)
    error = float(np.sqrt(scatter + (weight @ shared) ** 2))
    p_value = min(1.0, (others + 1) * 2.0 * float(norm.sf(abs(mean) / error)))
    return [Deviation(FLOW, 100.0 * mean, 100.0 * error, "%", p_value)]


def _solved(design: Floats, values: Floats, weight: Floats) -> Floats:
    root = np.sqrt(weight)[:, None]
    return np.asarray(np.linalg.lstsq(design * root, values * root[:, 0])[0])


def _scatter(fits: Fits, done: Integers) -> float:
    """Return the variance of ln G_s between capsules in excess of their errors, by moments."""
    beyond = np.var(fits.log_modulus[done]) - np.median(fits.covariance[done, 0, 0])
    return float(max(beyond, 1e-6))


def _own_error_of_modulus(model: ForwardModel, rest: Mapping[str, Floats], theta: Floats) -> Floats:
    """Return the standard deviation of ln G_s due to the model's own error in the lengths : (c,) array."""
    if not len(theta):
        return np.empty(0)
    step = 1e-3
    here, there = (
        model({**rest, "capillary_number": np.exp(theta[:, 0] + shift), "size_ratio": theta[:, 1]})
        for shift in (0.0, step)
    )
    slope = (there.parachute_depth - here.parachute_depth) / step
    depth = here.covariance[:, 0, 0] + here.covariance[:, 1, 1] - 2.0 * here.covariance[:, 0, 1]
    error = np.sqrt(np.maximum(depth, 0.0)) / np.maximum(np.abs(slope), 1e-6)
    return np.asarray(np.nan_to_num(np.minimum(error, 1.0), nan=1.0))
