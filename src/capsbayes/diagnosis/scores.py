"""Scores of a model and of candidate effects, with the discrepancy that is left."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp

from capsbayes.arrays import Floats
from capsbayes.diagnosis.fits import Fits, Trend, fitted, log_evidences, smooth_features
from capsbayes.diagnosis.session import OfOutline, Session, Whitening, initial_guesses, whitened_at
from capsbayes.model import Effect, ForwardModel, Unseen
from capsbayes.profile import edge_lengths, vertex_normals

# Something else: an effect that is not in the catalogue is modelled by a Gaussian process of normal displacements over
# the arc, ln Ca and a/l, together with affine and radial distortions of the picture. Its covariance is separable:
# squared exponentials on the closed arc, expanded in Fourier modes, and on ln Ca and a/l, expanded about a lattice of
# inducing points. The amplitude and the length scales are integrated over a grid of priors, so that the process pays
# for its freedom by its marginal likelihood (Kennedy & O'Hagan 2001, doi:10.1111/1467-9868.00294; MacKay 1992,
# doi:10.1162/neco.1992.4.3.415). Lengths alone leave the apparent G_s, whose dependence on velocity and a/l is modelled
# likewise. The model's own error counts as such a process too, of the amplitude that the model states

_EVEN, _ODD = 8, 3  # Fourier modes of the arc that are alike above and below the axis, and that are opposite
_ARC = (0.05, 0.12)  # length scales, over the perimeter
_PLACE = (1.0, 0.15)  # length scales of ln Ca and of a/l
_SHARED = 0.5  # of the variance: displacement that all capsules have in common, where it depends on the capsule
_AMPLITUDES = (0.0, 0.001, 0.002, 0.004, 0.008, 0.016, 0.032)  # standard deviations of the displacement, over l
_NOISES = (*_AMPLITUDES, 0.064)  # of one capsule alone, along arcs, over l
_FINELY = 1e-5  # l, to which the likeliest noise is found
_CAMERA = (0.0, 0.01, 0.03, 0.06)  # standard deviations of each distortion
_FEW_CAMERAS = 2  # of these, while the noise is sought
_CAMERA_MODES = 5
_COUNT = _EVEN + 1 + _ODD + _CAMERA_MODES
_OF_CAPSULES = ("places", "information", "shift", "own", "speed")  # arrays of a discrepancy


LIKENESS = (0.15, 0.3, 0.6)
"""Amplitudes of what is like a change of the outlines, over that of the change."""


def displacement_modes(outline: Floats) -> Floats:
    """Return normal displacements of a closed outline (p, 2) from the nose : (q, p) array [l]."""
    # Fourier modes of the arc, even ones from the constant on, then odd ones; then what distortions of the picture do:
    # stretches along and across the flow, a shear, a radial one, and one that grows along the flow.
    lengths = edge_lengths(outline)
    arc = 2.0 * np.pi * np.concatenate([[0.0], np.cumsum(lengths[:-1])]) / lengths.sum()
    even = np.cos(np.outer(np.arange(_EVEN + 1), arc))
    odd = np.sin(np.outer(np.arange(1, _ODD + 1), arc))
    z, y = (outline - [0.5 * (outline[:, 0].max() + outline[:, 0].min()), 0.0]).T
    nothing, square = np.zeros_like(z), z**2 + y**2
    fields = ((z, nothing), (nothing, y), (y, nothing), (square * z, square * y), (z * z, z * y))
    across, up = vertex_normals(outline).T
    camera = np.stack([along * across + sideways * up for along, sideways in fields])
    return np.concatenate([even, odd, camera])


def _spectrum(length: float) -> Floats:
    """Return the variances of the Fourier modes of a process of mean variance one on the arc."""
    orders = np.concatenate([np.arange(_EVEN + 1), np.arange(1, _ODD + 1)])
    weights = np.exp(-0.5 * (2.0 * np.pi * length * orders) ** 2)
    return np.asarray(weights / np.sum(weights * np.where(orders == 0, 1.0, 0.5)))


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """What n capsules with outlines, and the G_s of those that have a shape, say of something else."""

    # `information` (n, q, q) is that of the amplitudes of the `displacement_modes` [1/l^2], after Ca and a/l have
    # absorbed what they can; `shift` (n, q) is the information times the likeliest amplitudes.

    places: Floats = field(default_factory=lambda: np.zeros((0, 2)))  # (n, 2): ln Ca and a/l
    information: Floats = field(default_factory=lambda: np.zeros((0, _COUNT, _COUNT)), repr=False)
    shift: Floats = field(default_factory=lambda: np.zeros((0, _COUNT)), repr=False)
    own: Floats = field(default_factory=lambda: np.zeros(0))  # (n,) [l]: rms of the own error along each outline
    speed: Floats = field(default_factory=lambda: np.zeros(0))  # (n,): ln v_o
    trend: Trend = field(default_factory=Trend, repr=False)

    @classmethod
    def of(cls, session: Session, white: Whitening, fits: Fits) -> Discrepancy:
        """Collect it from the fits of a session."""
        columns = []
        speed = np.log(session.circumstances["capsule_velocity"])
        for row, whitener in white.outlines(fits.settled):
            left = left_of_modes(whitener, fits, row)
            seen = left @ left.T, left @ fits.residuals[row]
            columns.append((fits.theta[row], *seen, _own_error(whitener), speed[row]))
        trend = Trend.of(session, fits)
        if not columns:
            return cls(trend=trend)
        arrays = map(np.array, zip(*columns, strict=True))
        return cls(**dict(zip(_OF_CAPSULES, arrays, strict=True)), trend=trend)

    @property
    def noise(self) -> float:
        """Standard deviation of the likeliest displacements of single capsules, each for itself [l]."""
        # A displacement that all have, or that depends smoothly on the capsule, is none of these, whatever its reason.
        if not len(self.places):
            return 0.0
        best = int(np.argmax([self._of_noise(noise) for noise in _NOISES[:-1]]))
        around = _NOISES[max(best - 1, 0)], _NOISES[best + 1]
        found = minimize_scalar(
            lambda noise: -self._of_noise(noise), bounds=around, method="bounded", options={"xatol": _FINELY}
        )
        return 0.0 if best == 0 and found.x < 2.0 * _FINELY else float(found.x)

    def _of_noise(self, noise: float) -> float:
        """Return the log likelihood of displacements of single capsules, with something else or without it."""
        rest, of_noise = self._without(noise)
        return of_noise + float(rest._evidences(rest.shift[..., None], product(_AMPLITUDES, _CAMERA[:_FEW_CAMERAS]))[0])

    def _without(self, noise: float) -> tuple[Discrepancy, float]:
        """Integrate over displacements of single capsules, and return the rest and their log evidence."""
        variances = np.concatenate([noise**2 * _spectrum(_ARC[0]), np.zeros(_CAMERA_MODES)])
        kept = np.eye(_COUNT) + self.information * variances
        information = np.linalg.solve(kept, self.information)
        shift = np.linalg.solve(kept, self.shift[..., None])[..., 0]
        log_evidence = 0.5 * np.sum(self.shift * variances * shift) - 0.5 * np.sum(np.linalg.slogdet(kept)[1])
        return replace(self, information=information, shift=shift), float(log_evidence)

    @property
    def evidence(self) -> float:
        """Log evidence of something else relative to nothing: in the outlines, in the trend of G_s, or in both."""
        trend = self.trend.evidence
        if not len(self.places):
            return trend
        outlines = self.of_outlines
        return float(logsumexp([outlines, trend, outlines + trend]) - np.log(3.0))

    @cached_property
    def of_outlines(self) -> float:
        """Log evidence of displaced outlines relative to the model's own error; zero without outlines."""
        return float(self.of_shifts(self.shift[..., None])[0]) if len(self.places) else 0.0

    @property
    def scale(self) -> float:
        """Visibility of a process of displacements of amplitude one, in standard errors over l."""
        modes = np.concatenate([_spectrum(_ARC[-1]), np.zeros(_CAMERA_MODES)])
        return float(np.sqrt(np.einsum("nii,i->", self.information, modes)))

    def like(self, amplitude: float) -> Floats:
        """Return the log evidence of displacements a part as large as an amplitude [l], for each of some parts."""
        return self.like_shifts(self.shift[..., None], amplitude)[:, 0]

    def like_shifts(self, shifts: Floats, amplitude: float) -> Floats:
        """Return that for other shifts (n, q, N) : (parts, N) array."""
        own = self._evidences(shifts, _NOTHING_ELSE)
        return np.array([self._evidences(shifts, [(share * amplitude, 0.0)]) - own for share in LIKENESS])

    def of_shifts(self, shifts: Floats) -> Floats:
        """Return `of_outlines` for other shifts (n, q, N) : (N,) array."""
        return self._evidences(shifts, _SOMETHING) - self._evidences(shifts, _NOTHING_ELSE)

    def _evidences(self, shifts: Floats, kinds: Iterable[tuple[float, float]]) -> Floats:
        """Return the mean log evidence (N,) of the model's own error with displacements and distortions."""
        logs, lengths = [], list(product(_ARC, kinds))
        for features in self._dependences():
            information = self._summed(features)
            summed = np.einsum("na,nqN->aqN", features, shifts).reshape(len(information), -1)
            each = (np.tile(self._variances(length, kind), features.shape[1]) for length, kind in lengths)
            logs += [log_evidences(information, summed, variances) for variances in each]
        return np.asarray(logsumexp(logs, axis=0) - np.log(len(logs)))

    def _variances(self, length: float, kind: tuple[float, float]) -> Floats:
        """Return the variances (q,) of the modes."""
        amplitude, camera = kind
        of_arc = (amplitude**2 + float(np.mean(self.own**2))) * _spectrum(length)
        return np.concatenate([of_arc, np.full(_CAMERA_MODES, camera**2)])

    def taken(self, rows: Sequence[int]) -> Discrepancy:
        """Return that of some capsules, without the trend."""
        return Discrepancy(**{name: getattr(self, name)[list(rows)] for name in _OF_CAPSULES})

    @property
    def amplitudes(self) -> tuple[Floats, Floats]:
        """Amplitudes (k,) [l] of displacements by something else, and their probabilities (k,)."""
        if not len(self.places):
            return np.zeros(1), np.ones(1)
        logs = np.array([self._evidences(self.shift[..., None], [kind])[0] for kind in _SOMETHING])
        sizes = np.array([np.hypot(amplitude, 0.5 * camera) for amplitude, camera in _SOMETHING])
        return sizes, np.exp(logs - logsumexp(logs))

    def _dependences(self) -> tuple[Floats, ...]:
        """Return features (n, r) of processes: the same in all, depending on ln Ca and a/l, and growing with ln v_o."""
        same = np.ones((len(self.places), 1))
        further = smooth_features(self.places, np.array(_PLACE)), standardised(self.speed)[:, None]
        return same, *(np.hstack([_SHARED**0.5 * same, (1.0 - _SHARED) ** 0.5 * each]) for each in further)

    def _summed(self, features: Floats) -> Floats:
        """Return the information (r q, r q) on the amplitudes of all modes along all features."""
        size = features.shape[1] * _COUNT
        information = np.einsum("na,nb,nij->aibj", features, features, self.information, optimize=True)
        return np.asarray(information.reshape(size, size))


_NOTHING_ELSE = [(0.0, 0.0)]
_SOMETHING = [kind for kind in product(_AMPLITUDES, _CAMERA) if any(kind)]


def standardised(values: Floats, weights: Floats | None = None) -> Floats:
    """Return values (n,) less their mean and over their standard deviation, both with weights (n,)."""
    away = values - np.average(values, weights=weights)
    spread = np.sqrt(np.average(away**2, weights=weights))
    return np.asarray(away / spread if spread > 0.0 else away)


def left_of_modes(whitener: OfOutline, fits: Fits, row: int) -> Floats:
    """Return the whitened displacement modes (q, m) of a capsule once Ca and a/l absorb what they can."""
    likelihood = whitener.likelihood
    return fits.left_of(row, likelihood.whitened_displacement(displacement_modes(likelihood.pilot)))


def _own_error(seen: OfOutline) -> float:
    """Return the error of the model and of the edge that all capsules share, over l."""
    modes = seen.likelihood.modes
    of_model = 0.0 if modes is None else np.sqrt(np.mean(np.sum(modes**2, axis=0)))
    return float(np.hypot(of_model, seen.measured.pose.offset))


# Displacements of regions of the outline that all capsules of a session have in common

REGIONS = ("nose", "flanks", "rear rim", "rear on the axis", "top against bottom")
_WIDTH = 0.06  # of the perimeter: standard deviation of a region's bump


def region_displacements(outline: Floats) -> Floats:
    """Return bumps of height one at each of the `REGIONS` of a closed outline (p, 2) from the nose : (5, p) array."""
    lengths = edge_lengths(outline)
    arc = np.concatenate([[0.0], np.cumsum(lengths[:-1])]) / lengths.sum()
    z, y = outline.T
    upper = y > 0.0
    rims = [np.argmin(np.where(side, z, np.inf)) for side in (upper, ~upper)]
    normal = vertex_normals(outline)
    flank = np.clip(normal[:, 1] * np.sign(outline[:, 1]), 0.0, 1.0) ** 4  # not the inner wall of the dimple
    rim = sum(_bump(arc, arc[place]) for place in rims)
    on_axis = np.argmin(np.where(z < z.mean(), np.abs(y), np.inf))
    rear = _bump(arc, arc[on_axis])
    return np.stack([_bump(arc, 0.0), flank, np.minimum(rim, 1.0), rear, flank * np.sign(normal[:, 1])])


def _bump(arc: Floats, place: float) -> Floats:
    away = np.abs(arc - place)
    away = np.minimum(away, 1.0 - away)
    return np.asarray(np.exp(-0.5 * (away / _WIDTH) ** 2))


# Likelihood of a session under a model with an effect of a given size. The misfit of its best shape says how well the
# picture of a capsule is met; how far the apparent shear moduli of all lie apart, whether one membrane can have made
# them. With G_s normal in its logarithm among the capsules and a/l free, that of capsule i is, but for a constant,
#
#     exp(-misfit_i / 2) (det C_i)^(1/2) N(ln G_i; mean, C_i[G, G] + s_i^2 + spread^2),
#
# C_i the covariance of ln G_i and a/l by the picture, s_i the relative error of the velocity

Measured = Mapping[str, tuple[float, float]]
"""Size of an effect measured independently of the capsules, and its standard error, by name of the parameter."""

REACH = (0.001, 0.999)
"""Quantiles of the prior between which sizes are tried."""

_QUANTILES = (REACH[0], 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, REACH[1])  # of the prior, at which an effect is tried first
_REFINED = 2  # times that sizes about the best are added
_FAR = 50.0  # log likelihood below the best, beyond which no size further away is tried
_NEXT = 0.02  # of the distance of its neighbours, from the best size
_FINE = 20_001
_EQUAL = 1e-6  # log likelihoods that differ by less are the same
_LARGEST_SPREAD = 3.0
_LOST = 15.0  # log likelihood of a capsule of which the model knows no shape, below that of the least likely other
_NOTHING = -1e6  # log likelihood of each where hardly one can have been made


class MeanAndSpread(NamedTuple):
    """Mean of ln G_s of the capsules, and standard deviation in excess of their errors."""

    mean: float
    spread: float


@dataclass(frozen=True, eq=False)
class Scores:
    """Log likelihood of each capsule at a few sizes of an effect."""

    effect: Effect
    sizes: Floats  # (J,): rising; the null value among them, for which the model without the effect stands
    log_likelihood: Floats = field(repr=False)  # (J, n): with the population that is most likely at each size
    elsewhere: Floats = field(repr=False)  # (J,): of measurements that do not involve the capsules
    modulus: Floats = field(repr=False)  # (J,): median of the apparent G_s of the capsules [N/m]
    own_error: float = 0.0  # standard error of the size by the model's own error, which all capsules share
    without: float | None = None  # median G_s [N/m] from which changes count; default: at the null value

    @classmethod
    def of(
        cls, effect: Effect, sizes: Sequence[float], outcomes: Sequence[Outcome], elsewhere: Sequence[float]
    ) -> Self:
        """Score what came of rising sizes."""
        likelihoods = np.array([each.log_likelihood for each in outcomes])
        moduli = np.array([each.fits.median_modulus for each in outcomes])
        return cls(effect, np.array(sizes), likelihoods, np.array(elsewhere), moduli)

    @property
    def total(self) -> Floats:
        """Log likelihood of all measurements at each size : (J,) array."""
        return np.asarray(self.log_likelihood.sum(axis=1) + self.elsewhere)

    @property
    def log_likelihood_ratio(self) -> float:
        """Log-likelihood ratio of all measurements, at the best size to the null value."""
        return float(self.total[self.best] - self.total[self.null])

    @property
    def null(self) -> int:
        """Row of the null value."""
        return int(np.argmin(np.abs(self.sizes - self.effect.null_value)))

    @property
    def best(self) -> int:
        """Row of the most probable size; among those equal up to rounding, the nearest to the null value."""
        return _likeliest(self.sizes - self.effect.null_value, self.total)

    @property
    def size(self) -> float:
        """The likeliest size."""
        return float(self.sizes[self.best])

    @property
    def log_likelihood_ratios(self) -> Floats:
        """Log-likelihood ratio of each capsule, at the best size to the null value : (n,) array."""
        return np.asarray(self.log_likelihood[self.best] - self.log_likelihood[self.null])

    @property
    def evidence(self) -> float:
        """Log of the likelihood averaged over the prior of the size, relative to that at the null value."""
        # Sizes beyond those that were tried count as impossible.
        fine = np.linspace(self.sizes[0], self.sizes[-1], _FINE)
        total = PchipInterpolator(self.sizes, self.total)(fine)
        prior = self.effect.prior.pdf(fine)
        most = float(total.max())
        mean = np.trapezoid(prior * np.exp(total - most), fine)
        return most + float(np.log(mean)) - float(self.total[self.null])

    def log_modulus_change(self, sizes: ArrayLike) -> Floats:
        """Return the change (k,) of the median ln G_s by the effect, at sizes (k,) or the nearest with a shape."""
        # NaN where fewer than two of the sizes that were tried have one.
        known = np.isfinite(self.modulus)
        if known.sum() < 2:
            return np.full(np.shape(sizes), np.nan)
        tried = self.sizes[known]
        log_modulus = PchipInterpolator(tried, np.log(self.modulus[known]))
        at_sizes, null = (log_modulus(np.clip(size, tried[0], tried[-1])) for size in (sizes, self.effect.null_value))
        return np.asarray(at_sizes - (null if self.without is None else np.log(self.without)))

    def log_modulus_changes(self, rng: np.random.Generator, count: int) -> Floats:
        """Draw changes of ln G_s due to the effect, with sizes from their posterior : (count,) array."""
        # The log likelihood is flattened, and the own error added, as in `interval`.
        fine = np.linspace(self.sizes[0], self.sizes[-1], _FINE)
        total = PchipInterpolator(self.sizes, self.total)(fine)
        density = self.effect.prior.pdf(fine) * np.exp((total - total.max()) / self.sandwich)
        below = cumulative_trapezoid(density, fine, initial=0)
        sizes = np.interp(rng.random(count) * below[-1], below, fine) + self.own_error * rng.standard_normal(count)
        return np.nan_to_num(self.log_modulus_change(sizes))

    def __str__(self) -> str:
        """Return the effect, its size and 68 % interval."""
        parameter = self.effect.parameter
        low, best, high = (parameter.shown(size) for size in (self.interval()[0], self.size, self.interval()[1]))
        unit = "" if parameter.shown_unit in ("", "-") else f" {parameter.shown_unit}"
        return f"{self.effect.name}, {parameter.symbol} = {best:.3g}{unit} [{low:.3g}, {high:.3g}]"

    def interval(self, drop: float = 0.5) -> tuple[float, float]:
        """Return the interval of the size : 68 % for a `drop` of the log likelihood by 0.5, 95 % for 1.92."""
        # It is widened where the capsules scatter more than their stated errors, and by the model's own error.
        low, high = self.profile_interval(drop)
        own = np.sqrt(2.0 * drop) * self.own_error
        wider = [np.sqrt(self.sandwich * (end - self.size) ** 2 + own**2) for end in (low, high)]
        least, most = self._reach
        low = least if low <= self.sizes[0] else max(self.size - float(wider[0]), least)
        return low, most if high >= self.sizes[-1] else min(self.size + float(wider[1]), most)

    @property
    def _reach(self) -> tuple[float, float]:
        """Ends of what an interval may hold: those of the prior, if sizes were tried nearly up to them."""
        low, high, prior = float(self.sizes[0]), float(self.sizes[-1]), self.effect.prior
        if np.isfinite(prior.low) and low <= prior.ppf(_QUANTILES[0]):
            low = min(prior.low, low)
        if np.isfinite(prior.high) and high >= prior.ppf(_QUANTILES[-1]):
            high = max(prior.high, high)
        return low, high

    @property
    def sandwich(self) -> float:
        """Variance of the size by the scatter of the capsules over that by the log likelihood's bend, at least 1."""
        # By the sandwich formula (Huber 1967, Proc. 5th Berkeley Symp. 1, 221; White 1982, doi:10.2307/1912526).
        if self.best in (0, len(self.sizes) - 1):
            return 1.0
        rows = slice(self.best - 1, self.best + 2)
        x = self.sizes[rows] - self.size
        curves = np.column_stack([self.log_likelihood[rows], self.elsewhere[rows]])
        bends, slopes = np.linalg.solve(np.stack([0.5 * x**2, x, np.ones(3)], axis=1), curves)[:2]
        bend = float(-bends.sum())
        if bend <= 0.0:
            return 1.0
        count = len(slopes) - 1
        return max((count * float(np.var(slopes[:-1], ddof=1)) - float(bends[-1])) / bend, 1.0)

    def profile_interval(self, drop: float = 0.5) -> tuple[float, float]:
        """Return the sizes at which the log likelihood is `drop` below its maximum."""
        # Between the sizes that were tried it is a monotone cubic (Fritsch & Butland 1984, doi:10.1137/0905021).
        least = float(self.total.max()) - drop
        ends = PchipInterpolator(self.sizes, self.total).solve(least, extrapolate=False)
        low = self.sizes[0] if self.total[0] >= least else ends.min(initial=self.size)
        high = self.sizes[-1] if self.total[-1] >= least else ends.max(initial=self.size)
        return float(low), float(high)


class Outcome(NamedTuple):
    """Fits with an effect at one size, or with two effects."""

    log_likelihood: Floats
    fits: Fits

    @classmethod
    def of(cls, fits: Fits) -> Outcome:
        """Score the fits with it."""
        return cls(log_likelihood(fits), fits)


class Trial:
    """Profile likelihood of an effect on a session, at the null value and at sizes that are added."""

    # `model` is without the effect and made the whitening; `without` are its fits, what every effect is measured
    # against; `measured` is a size measured apart from the capsules and its standard error; `known`, what came of some
    # sizes.

    def __init__(
        self,
        model: ForwardModel,
        effect: Effect,
        session: Session,
        white: Whitening,
        without: Fits,
        measured: tuple[float, float] | None = None,
        known: Mapping[float, Outcome] | None = None,
    ) -> None:
        self.model, self.effect, self.session, self.white, self.without = model, effect, session, white, without
        self.measured = measured
        self._outcomes = {effect.null_value: Outcome.of(without), **(known or {})}

    @property
    def unseen(self) -> bool:
        """Whether the effect leaves no trace in what is measured."""
        return isinstance(self.effect, Unseen)

    @property
    def scores(self) -> Scores:
        """Scores at all sizes tried so far."""
        sizes = sorted(self._outcomes)
        elsewhere = [log_of_measured(size, self.measured) for size in sizes]
        return Scores.of(self.effect, sizes, [self._outcomes[size] for size in sizes], elsewhere)

    @property
    def fits(self) -> Fits:
        """Fits at the likeliest size."""
        return self._outcomes[self.scores.size].fits

    def explored(self) -> Trial:
        """Try sizes from the null value on, as far as they are likely, and some around the best."""
        null, first = self.effect.null_value, np.array(_first_sizes(self.effect, self.measured))
        for side in (-1.0, 1.0):
            for away in np.sort(side * (first - null)[side * (first - null) > 0.0]):
                self.add(null + side * float(away), everywhere=True)
                scores = self.scores
                if scores.total[0 if side < 0.0 else -1] < scores.total.max() - _FAR:
                    break
        self.refine(1)
        return self

    def refine(self, times: int = _REFINED) -> None:
        """Add sizes around the best."""
        for _ in range(times):
            known = self.scores
            for size in _about_the_best(known.sizes.tolist(), known.total.tolist(), self.effect.null_value):
                self.add(size)

    def add(self, size: float, *, everywhere: bool = False) -> None:
        """Fit the capsules with the effect at a size, from the fits at the nearest one; see `fitted`."""
        if size in self._outcomes:
            return
        start = self._outcomes[min(self._outcomes, key=lambda other: abs(other - size))].fits.theta
        sizes = {self.effect.parameter.name: size}
        fits = fitted(self.model + self.effect, self.session, self.white, sizes, start, everywhere=everywhere)
        outcome = Outcome.of(fits)
        if self.unseen:  # what it seems to gain is but another reach of the model's domain
            outcome = outcome._replace(log_likelihood=self._outcomes[self.effect.null_value].log_likelihood)
        self._outcomes[size] = outcome

    def with_measured(self, measured: tuple[float, float] | None) -> Trial:
        """Return the trial with an independent measurement of the effect."""
        if measured == self.measured:
            return self
        made = (self.model, self.effect, self.session, self.white, self.without)
        return Trial(*made, measured, self._outcomes).explored()


def log_of_measured(size: float, measured: tuple[float, float] | None) -> float:
    """Return the log likelihood of a size by an independent measurement of it; zero if there is none."""
    return 0.0 if measured is None else -0.5 * ((size - measured[0]) / measured[1]) ** 2


def _first_sizes(effect: Effect, measured: tuple[float, float] | None) -> list[float]:
    """Return the sizes to try first: quantiles of the prior, and sizes around an independent measurement."""
    low, high = effect.prior.low, effect.prior.high
    about = [] if measured is None else [measured[0] + sigma * measured[1] for sigma in (-2.0, -1.0, 0.0, 1.0, 2.0)]
    return [*(float(size) for size in effect.prior.ppf(_QUANTILES)), *(size for size in about if low <= size <= high)]


def _likeliest(away: Floats, totals: Floats) -> int:
    """Return the row of the highest total (J,); of those equal but for rounding, that which is least away (J,)."""
    return int(np.argmin(np.where(totals >= totals.max() - _EQUAL, np.abs(away), np.inf)))


def _about_the_best(sizes: list[float], totals: list[float], null: float = 0.0) -> list[float]:
    """Return sizes to try next: the top of a parabola through the best three, and two standard errors either side."""
    # Those close to a known size are omitted.
    best = _likeliest(np.array(sizes) - null, np.array(totals))
    if best in (0, len(sizes) - 1):
        neighbour = sizes[1] if best == 0 else sizes[-2]
        return [0.5 * (sizes[best] + neighbour)]
    low, high = sizes[best - 1], sizes[best + 1]
    (x0, x1, x2), (y0, y1, y2) = sizes[best - 1 : best + 2], totals[best - 1 : best + 2]
    left, right = (y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1)
    bend = (right - left) / (0.5 * (x2 - x0))
    if bend * (high - low) ** 2 > -_EQUAL:  # an effect that leaves no trace
        return []
    top = 0.5 * (x0 + x1) - left / bend
    error = 1.0 / np.sqrt(-bend)
    wanted = [min(max(guess, low), high) for guess in (top, top - 2.0 * error, top + 2.0 * error)]
    return [guess for guess in wanted if min(abs(guess - size) for size in sizes) > _NEXT * (high - low)]


def population(values: Floats, variances: Floats) -> MeanAndSpread:
    """Estimate mean and spread of normal values (n,) that are known with errors of given variances (n,)."""

    def mean(spread: float) -> float:
        weight = 1.0 / (variances + spread**2)
        return float(np.sum(weight * values) / np.sum(weight))

    def surprise(spread: float) -> float:
        total = variances + spread**2
        return float(np.sum((values - mean(spread)) ** 2 / total + np.log(total)))

    found = minimize_scalar(surprise, bounds=(0.0, _LARGEST_SPREAD), method="bounded")
    spread = float(found.x) if found.fun < surprise(0.0) else 0.0
    return MeanAndSpread(mean(spread), spread)


def log_likelihood(fits: Fits) -> Floats:
    """Return the log likelihood of each capsule : (n,) array; one without a shape of the model is very unlikely."""
    done, values, variances = fits.known, fits.log_modulus, fits.covariance[:, 0, 0]
    logs = np.full(len(done), _NOTHING)
    if done.sum() > 1:
        people = population(values[done], variances[done])
        total = variances + people.spread**2
        apart = (values - people.mean) ** 2 / total + np.log(2.0 * np.pi * total)
        by_picture = -0.5 * fits.misfit + 0.5 * fits.log_volume - 0.5 * apart
        logs[done] = (by_picture + fits.flow.log_likelihood(values, total, people.mean))[done]
        logs[~done] = logs[done].min() - _LOST
    return logs


# Errors of a session's measurements as they are stated, and the noise of its outlines beyond that


def whitening(model: ForwardModel, session: Session) -> Whitening:
    """Compute the covariance of each capsule's measurement and of the model's own error there."""
    # Evaluated at the shape that fits the lengths, then again at that which fits the outline. If single outlines
    # scatter by more than is stated, their noise is larger by that much (`Discrepancy.noise`). All have the errors of
    # the microscope in common.
    among = len(session)
    pilots = initial_guesses(model, session, session.circumstances, np.arange(len(session)), bands=1)[0]
    made = whitened_at(model, session, pilots, among=among)
    if not made.outline:
        return made
    better = fitted(model, session, made)
    further = Discrepancy.of(session, made, better).noise
    nearer = np.where(better.settled[:, None], better.theta, pilots)
    return whitened_at(model, session, nearer, among=among, further=further)
