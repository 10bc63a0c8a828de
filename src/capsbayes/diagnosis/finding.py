"""Deviations from a model that all capsules of a session have in common after each was fitted.

A deviation is an amplitude that the capsules have in common: of a displacement
of one region of the outline, after the best Ca and a/l of each capsule have
absorbed what they can, or of a trend of the apparent shear modulus with velocity
or size. Each capsule contributes one number. Their scatter, not the stated noise,
says how surprising their sum is, so that noise that is correlated along the
outline, heavy-tailed or wrongly stated makes no claims; and since under a right
model each contribution is as likely positive as negative, changing their signs
at random gives the distribution of the largest of all deviations.

The model's own error is not independent from capsule to capsule. It is taken as
common to all of them, in the direction that hurts most.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy.stats import beta, binom, norm

from capsbayes.arrays import Floats, Integers
from capsbayes.diagnosis.discrepancy import Discrepancy
from capsbayes.diagnosis.fits import Fits, fitted
from capsbayes.diagnosis.noise import whitening
from capsbayes.diagnosis.regions import REGIONS, Displaced, displaced_regions
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.whitening import Whitening
from capsbayes.model import ForwardModel

_FLIPS = 4999
_WITHOUT = 0.05  # of the capsules that a right model leaves without a shape, at most: debris, gross errors
_SHAPELESS = "share of capsules without a shape"
_FEWEST = 4  # contributions, up to which a deviation is not judged
FLOW = "v_o over that of the flow rate"
TRENDS = {"velocity": "trend of ln G_s with ln v_o", "size": "trend of ln G_s with a/l"}


@dataclass(frozen=True)
class Deviation:
    """Deviation from the model that the capsules have in common.

    Parameters
    ----------
    name : str
        A region of the outline, or a trend.
    size, error : float
        Amplitude and its standard error [unit].
    unit : str
    p_value : float
        Probability that under a right model the largest of all deviations is as large.
    """

    name: str
    size: float
    error: float
    unit: str
    p_value: float

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
    """Deviations of a session from a model.

    Parameters
    ----------
    deviations : tuple of Deviation
        The most surprising first.
    noise : float
        Root of the misfit over its degrees of freedom: the noise over that assumed; NaN without any.
    capsules : int
        How many were fitted.
    discrepancy : Discrepancy
        Evidence of the capsules for a deviation that no known effect describes.
    further_noise : float [l]
        Noise of single outlines that was assumed beyond what is stated.
    """

    deviations: tuple[Deviation, ...]
    noise: float
    capsules: int
    discrepancy: Discrepancy = field(default_factory=Discrepancy, repr=False)
    further_noise: float = 0.0

    def table(self) -> pd.DataFrame:
        """Return a row for each deviation: ``size`` and ``error`` [``unit``], ``sigma``, ``p_value``."""
        columns = ("size", "error", "unit", "sigma", "p_value")
        rows = {deviation.name: [getattr(deviation, column) for column in columns] for deviation in self.deviations}
        return pd.DataFrame.from_dict(rows, orient="index", columns=columns)

    @property
    def p_value(self) -> float:
        """Probability under a right model of a deviation at least as large as the largest."""
        return min((deviation.p_value for deviation in self.deviations), default=1.0)

    def leaves_nothing(self, level: float, at_most: float) -> bool:
        """Tell whether no deviation is significant at a level, and the log evidence of something else is small."""
        return self.p_value >= level and self.discrepancy.evidence <= at_most

    def combined_p_value(self, other: Finding, among: float) -> float:
        """Return the p-value of the largest deviation of this and of other capsules together.

        Only deviations with a p-value of at most `among` here count. Those of the other are looked for by name and
        direction, so that they need no correction for the number of deviations; the two p-values are combined by
        Stouffer's method.
        """
        there = {deviation.name: deviation for deviation in other.deviations}
        both = (
            _together(deviation, there[deviation.name])
            for deviation in self.deviations
            if deviation.p_value <= among and deviation.name in there
        )
        return min(both, default=1.0)

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
    """Test a session for deviations from a model.

    Parameters
    ----------
    model : ForwardModel
    session : Session
        Its outlines are tested region by region; without outlines, only the trends are tested.
    seed : int
        Of the random signs.
    white : Whitening, optional
        Whitening of the outlines, made with the model without its effects; by default with `model`.
    fits : Fits, optional
        Of the model, if they have been computed.

    Returns
    -------
    Finding
    """
    white = whitening(model, session) if white is None else white
    fits = fitted(model, session, white) if fits is None else fits
    done = np.flatnonzero(fits.settled)
    rest = {name: values[done] for name, values in session.circumstances.items()}
    own = _own_error_of_modulus(model, rest, fits.theta[done])
    displaced = displaced_regions(white, fits)
    table = [*_of_regions(session, fits, displaced), *_of_trends(session, fits, done, own)]
    table = [test for test in table if len(test.contributions) > _FEWEST]
    freedom = int(fits.freedom[done].sum())
    noise = float(np.sqrt(fits.misfit[done].sum() / freedom)) if freedom else float("nan")
    p_values = _by_signs(table, np.random.default_rng([seed, len(done)]))
    by_surprise = sorted(zip(table, p_values, strict=True), key=lambda pair: (pair[1], -abs(pair[0].statistic)))
    found = [
        Deviation(test.name, test.size * test.scale, test.error * test.scale, test.unit, float(p_value))
        for test, p_value in by_surprise
    ]
    found += [*_of_flow(fits, len(table)), *_without_a_shape(fits)]
    return Finding(
        tuple(sorted(found, key=lambda deviation: deviation.p_value)),
        noise,
        len(done),
        Discrepancy.of(session, white, fits),
        white.further,
    )


def _without_a_shape(fits: Fits) -> list[Deviation]:
    """Return the deviation that too many capsules have no shape of the model, if they are too many."""
    ill, count = int(fits.ill.sum()), len(fits.ill)
    if ill <= _WITHOUT * count:
        return []
    p_value = float(binom.sf(ill - 1, count, _WITHOUT))
    share, error = beta(ill + 1, count - ill + 1).stats()
    return [Deviation(_SHAPELESS, float(share), float(np.sqrt(error)), "", p_value)]


def _together(first: Deviation, second: Deviation) -> float:
    """Return the p-value of a deviation in both halves, by Stouffer's method."""
    # That of the velocities from the flow rates has an error common to both, which the second half does not test again.
    if first.name == FLOW:
        return first.p_value
    return float(norm.sf((norm.isf(first.p_value) + _standing(first, second)) / np.sqrt(2.0)))


def _standing(first: Deviation, second: Deviation) -> float:
    """Return the standard normal deviate of a deviation in the direction of an earlier one."""
    if first.name == _SHAPELESS:
        return float(norm.isf(second.p_value))
    return float(second.sigma * np.sign(first.size))


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


def _of_regions(session: Session, fits: Fits, displaced: list[Displaced]) -> list[_Test]:
    """Return the tests for a common displacement of each region."""
    rows: list[tuple[Floats, Floats, Floats]] = []
    for i, seen, pattern in displaced:
        own = np.linalg.norm(pattern @ seen.common_errors().T, axis=1)
        rows.append((pattern @ fits.residuals[i], np.sum(pattern**2, axis=1), own))
    if not rows:
        return []
    contributions, weights, own = (np.array(column).T for column in zip(*rows, strict=True))
    width = 1e6 * session.mean("half_width")
    return [_Test(name, "um", width, *each) for name, *each in zip(REGIONS, contributions, weights, own, strict=True)]


def _of_trends(session: Session, fits: Fits, done: Integers, own: Floats) -> list[_Test]:
    """Return the tests for slopes of the apparent ln G_s, corrected for errors that both variables share."""
    if not len(done):
        return []
    velocity = np.log(session.circumstances["capsule_velocity"][done])
    columns = {"velocity": velocity, "size": fits.size[done]}
    together = {"velocity": np.square(session.velocity_errors[done]), "size": fits.covariance[done, 0, 1]}
    columns = {name: values for name, values in columns.items() if np.ptp(values) > 1e-3}
    if len(done) <= _FEWEST + len(columns):
        return []
    weight = 1.0 / (fits.covariance[done, 0, 0] + _scatter(fits, done))
    design = np.stack([np.ones(len(done)), *columns.values()], axis=1)
    tests = []
    for number, name in enumerate(columns, start=1):
        others = np.delete(design, number, axis=1)
        across = design[:, number] - others @ _solved(others, design[:, number], weight)
        about = fits.log_modulus[done] - others @ _solved(others, fits.log_modulus[done], weight)
        contributions = weight * (across * about - together[name])
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
