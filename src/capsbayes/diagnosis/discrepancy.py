"""Something else: a smooth deformation of the outlines that depends on the capsule, or a trend of the apparent G_s.

An effect that is not in the catalogue is modelled by a Gaussian process of normal displacements over the arc, ln Ca and
a/l, together with affine and radial distortions of the picture. Its covariance is
separable: squared exponentials on the closed arc, expanded in Fourier modes, and on ln Ca and a/l, expanded about a
lattice of inducing points. The amplitude and the length scales are integrated over a grid of priors, so that the
process pays for its freedom by its marginal likelihood (Kennedy & O'Hagan 2001, doi:10.1111/1467-9868.00294; MacKay
1992, doi:10.1162/neco.1992.4.3.415). Lengths alone leave the apparent G_s, whose dependence on velocity and a/l is
modelled likewise.

The model's own error counts as such a process too, of the amplitude that the model states, with something else and
without it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy.linalg
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp

from capsbayes.arrays import Floats
from capsbayes.diagnosis.fits import Fits
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.smooth_features import smooth_features
from capsbayes.diagnosis.trend import Trend
from capsbayes.diagnosis.whitening import OfOutline, Whitening
from capsbayes.profile import edge_lengths, vertex_normals

_EVEN, _ODD = 8, 3  # Fourier modes of the arc that are alike above and below the axis, and that are opposite
_ARC = (0.05, 0.12)  # length scales, over the perimeter
_PLACE = (1.0, 0.15)  # length scales of ln Ca and of a/l
_SHARED = 0.5  # of the variance: displacement that all capsules have in common, where it depends on the capsule
_AMPLITUDES = (0.0, 0.001, 0.002, 0.004, 0.008, 0.016, 0.032)  # standard deviations of the displacement, over l
_NOISES = (*_AMPLITUDES, 0.064)  # of one capsule alone, along arcs, over l
_FINELY = 1e-5  # l, to which the likeliest noise is found
_CAMERA = (0.0, 0.01)  # standard deviations of each distortion
_CAMERA_MODES = 5
_COUNT = _EVEN + 1 + _ODD + _CAMERA_MODES


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
    """What n capsules with outlines, and the G_s of those that have a shape, say of something else; halves add up."""

    # `information` (n, q, q) is that of the amplitudes of the `displacement_modes` [1/l^2], after Ca and a/l have
    # absorbed what they can; `shift` (n, q) is the information times the likeliest amplitudes; `response` (n, q) [1/l]
    # is the change of ln G_s with the amplitudes, by the Ca and a/l that make up for a displacement.

    places: Floats = field(default_factory=lambda: np.zeros((0, 2)))  # (n, 2): ln Ca and a/l
    information: Floats = field(default_factory=lambda: np.zeros((0, _COUNT, _COUNT)), repr=False)
    shift: Floats = field(default_factory=lambda: np.zeros((0, _COUNT)), repr=False)
    response: Floats = field(default_factory=lambda: np.zeros((0, _COUNT)), repr=False)
    own: Floats = field(default_factory=lambda: np.zeros(0))  # (n,) [l]: rms of the own error along each outline
    trend: Trend = field(default_factory=Trend, repr=False)

    @classmethod
    def of(cls, session: Session, white: Whitening, fits: Fits) -> Discrepancy:
        """Collect it from the fits of a session."""
        rows, information, shift, response, own = [], [], [], [], []
        for row in np.flatnonzero(fits.settled):
            whitener = white.each[row]
            if isinstance(whitener, OfOutline):
                seen = whitener.likelihood
                whole = seen.whitened_displacement(displacement_modes(seen.pilot))
                basis, triangle = np.linalg.qr(fits.slopes[row])
                along = whole @ basis
                left = whole - along @ basis.T
                rows.append(row)
                information.append(left @ left.T)
                shift.append(left @ fits.residuals[row])
                response.append(along @ np.linalg.solve(triangle.T, fits.modulus_slopes[row]))
                own.append(_own_error(whitener))
        trend = Trend.of(session, fits)
        if not rows:
            return cls(trend=trend)
        return cls(fits.theta[rows], np.array(information), np.array(shift), np.array(response), np.array(own), trend)

    def __add__(self, other: Discrepancy) -> Discrepancy:
        """Return that of the capsules of both."""
        return Discrepancy(
            np.concatenate([self.places, other.places]),
            np.concatenate([self.information, other.information]),
            np.concatenate([self.shift, other.shift]),
            np.concatenate([self.response, other.response]),
            np.concatenate([self.own, other.own]),
            self.trend + other.trend,
        )

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
        either = [process.log_evidence for some in (False, True) for process in rest._processes(something_else=some)]
        return float(of_noise + logsumexp(either))

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

    @property
    def of_outlines(self) -> float:
        """Log evidence of displaced outlines relative to the model's own error; zero without outlines."""
        if not len(self.places):
            return 0.0
        without = [process.log_evidence for process in self._processes(something_else=False)]
        with_it = [process.log_evidence for process in self._processes(something_else=True)]
        return float(logsumexp(with_it) - np.log(len(with_it)) - logsumexp(without) + np.log(len(without)))

    def log_modulus_changes(self, rng: np.random.Generator, count: int) -> Floats:
        """Draw changes (count,) of the mean ln G_s if something else displaces the outlines, or makes a trend."""
        # A trend alone changes nothing of it.
        if not len(self.places):
            return np.zeros(count)
        outlines, trend = self.of_outlines, self.trend.evidence
        displaced = rng.random(count) < 1.0 / (1.0 + np.exp(trend - outlines - np.logaddexp(0.0, trend)))
        processes = list(self._processes(something_else=True))
        logs = np.array([process.log_evidence for process in processes])
        chosen = rng.choice(len(processes), count, p=np.exp(logs - logsumexp(logs)))
        mean, variance = (np.array([getattr(each, name) for each in processes]) for name in ("change", "variance"))
        return np.asarray(displaced * (mean[chosen] + np.sqrt(variance[chosen]) * rng.standard_normal(count)))

    def _processes(self, *, something_else: bool) -> Iterator[_Process]:
        """Yield the model's own error with something else, or without it."""
        own = float(np.mean(self.own**2))
        kinds = [kind for kind in product(_AMPLITUDES, _CAMERA) if any(kind) == something_else]
        for features in self._dependences():
            information, shift = self._summed(features)
            response = (features.T @ self.response).ravel() / len(features)
            for length, (amplitude, camera) in product(_ARC, kinds):
                each = np.concatenate([(amplitude**2 + own) * _spectrum(length), np.full(_CAMERA_MODES, camera**2)])
                yield _Process.of(information, shift, response, np.tile(each, features.shape[1]))

    def _dependences(self) -> tuple[Floats, Floats]:
        """Return features (n, r) of processes over the capsules: the same in all, and depending on ln Ca and a/l."""
        same = np.ones((len(self.places), 1))
        smooth = smooth_features(self.places, np.array(_PLACE))
        return same, np.hstack([_SHARED**0.5 * same, (1.0 - _SHARED) ** 0.5 * smooth])

    def _summed(self, features: Floats) -> tuple[Floats, Floats]:
        """Return information (r q, r q) and shift (r q,) of the amplitudes of all modes along all features."""
        size = features.shape[1] * _COUNT
        information = np.einsum("na,nb,nij->aibj", features, features, self.information, optimize=True)
        return information.reshape(size, size), (features.T @ self.shift).reshape(size)


def _own_error(seen: OfOutline) -> float:
    """Return the error of the model and of the edge that all capsules share, over l."""
    modes = seen.likelihood.modes
    of_model = 0.0 if modes is None else np.sqrt(np.mean(np.sum(modes**2, axis=0)))
    return float(np.hypot(of_model, seen.measured.pose.offset))


class _Process(NamedTuple):
    """Normal amplitudes once the outlines were seen."""

    log_evidence: float  # relative to no amplitudes
    change: float  # mean of the change of ln G_s
    variance: float  # of that change

    @classmethod
    def of(cls, information: Floats, shift: Floats, response: Floats, variances: Floats) -> _Process:
        """Infer amplitudes of given variances from what the outlines say, and what they change by their response."""
        used = variances > 0.0
        root = np.sqrt(variances[used])
        if not used.any():
            return cls(0.0, 0.0, 0.0)
        factor = np.linalg.cholesky(np.eye(len(root)) + root[:, None] * information[np.ix_(used, used)] * root)
        both = np.stack([root * shift[used], root * response[used]], axis=1)
        seen, moved = scipy.linalg.solve_triangular(factor, both, lower=True).T
        log_evidence = float(0.5 * seen @ seen - np.sum(np.log(np.diag(factor))))
        return cls(log_evidence, float(seen @ moved), float(moved @ moved))
