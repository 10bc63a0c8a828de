"""What the model's own error makes of the posterior of a membrane.

Forty outlines tell so much that an error of the model of a tenth of the noise moves their log density at a membrane by
several units. Between membranes over which the error changes, these are different numbers: some membrane near the true
one looks better than it is, and the posterior is narrow about it. So the posterior is averaged over what the error may
be at each membrane: over random functions whose variance is that of the log density, and which change over the distance
over which the model's own error does. The error of the mesh, which all membranes have alike, is not among these.

References
----------
Lie, Sullivan, Teckentrup 2018, SIAM/ASA J. Uncertain. Quantif. 6, 1600, doi:10.1137/18M1166523 (random surrogates, and
the posterior averaged over them).
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from capsbayes.arrays import Floats
from capsbayes.infer.many.one_membrane.conditional import OWN_STEPS, Capsules, Membranes
from capsbayes.surrogate.membrane.surrogate import OF_THE_MESH

FUNCTIONS = 256
"""Random functions over which posteriors are averaged."""

_WAVES = 256  # of each function
_SEED = 5
_DEGENERATE = 1e-9  # of the largest change of the shape
_AT_ONCE = 1000  # capsules times membranes


class Averaged(NamedTuple):
    """Weights of d draws, averaged over random functions.

    Parameters
    ----------
    log_weights : (d,) array
    log_evidence : (FUNCTIONS,) array
        Log of the mean weight under each function.
    """

    log_weights: Floats
    log_evidence: Floats


def averaged(log_weights: Floats, places: Floats, variance: Floats) -> Averaged:
    """Average the weights of d draws over random errors of their log density.

    Parameters
    ----------
    log_weights : (d,) array
        Of a density that is taken as exact.
    places : (d, c) array
        Of the membranes; over a distance of one the error changes.
    variance : (d,) array
        Of the log density.
    """
    if not np.ptp(places, axis=0).any():  # of one membrane there is one error
        variance = np.full(len(variance), variance[np.isfinite(log_weights)].mean())
    error = np.sqrt(variance)[:, None] * _functions(places)
    logs = log_weights[:, None] + np.where(np.isfinite(log_weights)[:, None], error, 0.0)
    evidence = logsumexp(logs, axis=0)
    return Averaged(logsumexp(logs - evidence, axis=1), evidence - np.log(len(logs)))


def _functions(places: Floats) -> Floats:
    """Return random functions at places (d, c) : (d, FUNCTIONS) array.

    Normal with mean 0 and variance 1; at a distance r their correlation is exp(-r^2 / 2).
    """
    waves, sizes = _drawn(places.shape[1])
    phase = places @ waves
    return np.asarray(np.concatenate([np.cos(phase), np.sin(phase)], axis=1) @ sizes)


@cache
def _drawn(dimensions: int) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(_SEED)
    waves = rng.standard_normal((dimensions, _WAVES))
    return waves, rng.standard_normal((2 * _WAVES, FUNCTIONS)) / np.sqrt(_WAVES)


def log_density_variance(capsules: Capsules, membranes: Membranes, own: Floats) -> Floats:
    """Return the variance of the log density of d membranes by the model's own error : (d,) array.

    If e is the error of all shapes, in standard errors of what was measured, and u the noise, normal with variance 1,
    the log density is off by e u: its variance is the mean square of e. What Ca and a/l absorb of e does not count.

    Parameters
    ----------
    capsules : Capsules
    membranes : mapping of (d,) arrays
    own : (d, n, o) array
        The best values at each, see `Conditional`.
    """
    some = max(_AT_ONCE // own.shape[1], 1)
    parts = [slice(first, first + some) for first in range(0, len(own), some)]
    return np.concatenate(
        [_variance(capsules, {name: values[part] for name, values in membranes.items()}, own[part]) for part in parts]
    )


def _variance(capsules: Capsules, membranes: Membranes, own: Floats) -> Floats:
    """Return the variance of some membranes : (d,) array."""
    model, rows = capsules.model, capsules.batch.rows
    theta = model.theta(membranes, own)
    covariances = np.nan_to_num(model(theta).covariances, copy=False) / OF_THE_MESH
    covariances = covariances.reshape(*own.shape[:2], *covariances.shape[1:])
    steps = np.diag(OWN_STEPS[: own.shape[2]])
    _, slopes = model.with_slopes(theta, [model.theta(membranes, own + step) for step in steps])
    changes = np.nan_to_num(np.moveaxis(slopes.numbers, 0, -1)).reshape(*own.shape[:2], rows.shape[2], -1)
    # directions of which some may be alike, as where only a length is measured
    directions, sizes, _ = np.linalg.svd(rows @ changes, full_matrices=False)
    directions *= (sizes > _DEGENERATE * sizes[..., :1])[..., None, :]
    absorbed = rows.swapaxes(-1, -2) @ directions
    whole = np.einsum("nkl,dnkl->d", rows.swapaxes(-1, -2) @ rows, covariances)
    left = whole - np.einsum("dnka,dnka->d", absorbed, covariances @ absorbed)
    return np.asarray(np.maximum(left, 0.0))
