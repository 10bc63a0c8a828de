"""Initial points of the walkers: of finite density, spread somewhat wider than the posterior.

Points are drawn over the whole domain, weighted by a power of their density
that keeps enough of them alive, and the cloud they describe is drawn from
again; a few rounds lead from the domain to the posterior wherever it is.
"""

from __future__ import annotations

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.infer.sampling.log_density import LogDensity

_CLOUD = 4096
_ALIVE = 1024
_ROUNDS = 24
_WIDENING = 1.5


def starting_points(
    log_density: LogDensity, ensembles: int, walkers: int, rng: np.random.Generator, cloud: Floats | None = None
) -> Floats:
    """Draw initial points for several ensembles.

    Parameters
    ----------
    log_density : LogDensity
    ensembles, walkers : int
    rng : Generator
    cloud : (n, d) array, optional
        Points of the posterior; by default they are sought over the whole domain.

    Returns
    -------
    (ensembles, walkers, d) array
        All different, all of finite density.

    Raises
    ------
    ValueError
        If no point of finite density was found.
    """
    if cloud is not None:
        return _finite(log_density, cloud, (ensembles, walkers), rng)
    cloud = _over_domain(log_density, rng)
    for _ in range(_ROUNDS):
        values = log_density(cloud)
        alive = np.isfinite(values)
        if np.count_nonzero(alive) < 4:
            raise ValueError("no point of the model's domain has a finite posterior density")
        cloud, values = cloud[alive], values[alive]
        power = _power_that_keeps(values, min(_ALIVE, len(values) // 2))
        weights = np.exp(power * (values - values.max()))
        weights /= weights.sum()
        kept = cloud[rng.choice(len(cloud), size=_CLOUD, p=weights)]
        if power == 1.0:
            break
        cloud = _jittered(kept, rng, 0.4)
    return _finite(log_density, kept, (ensembles, walkers), rng)


def _over_domain(log_density: LogDensity, rng: np.random.Generator) -> Floats:
    (ca_low, ca_high), (size_low, size_high) = log_density.model.domain.bounds
    columns = [rng.uniform(np.log(ca_low), np.log(ca_high), _CLOUD), rng.uniform(size_low, size_high, _CLOUD)]
    columns += [each.values(rng.uniform(size=_CLOUD)) for each in log_density.density.coordinates]
    columns += [getattr(log_density.density, name).drawn(rng, _CLOUD) for name in log_density.sampled]
    return np.stack(columns, axis=1)


def _power_that_keeps(values: Floats, count: int) -> float:
    """Return the largest power, at most one, at which the weights have an effective number of `count` points."""

    def worth(power: float) -> float:
        weights = np.exp(power * (values - values.max()))
        return float(weights.sum() ** 2 / (weights @ weights))

    if worth(1.0) >= count:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if worth(middle) >= count else (low, middle)
    return low


def _jittered(points: Floats, rng: np.random.Generator, factor: float) -> Floats:
    """Move points by a share of their own spread, so that no two coincide.

    The points are rounded to a millionth of the spread: walkers amplify a difference in the last digit until their
    chains have nothing in common, and that digit depends on the processor.
    """
    away = points - points.mean(axis=0)
    spread = np.linalg.cholesky(np.einsum("ni,nj->ij", away, away) / (len(points) - 1) + 1e-18 * np.eye(away.shape[1]))
    moved = points + factor * np.einsum("nj,ij->ni", rng.standard_normal(points.shape), spread)
    grain = 2.0 ** np.floor(np.log2(1e-6 * np.sqrt(np.sum(spread**2, axis=1))))
    return np.asarray(grain * np.round(moved / grain))


def _finite(log_density: LogDensity, points: Floats, shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    """Draw initial points around the points until every one has a finite density."""
    count = shape[0] * shape[1]
    centre = points.mean(axis=0)
    starts = np.empty((0, points.shape[1]))
    while len(starts) < count:
        drawn = points[rng.choice(len(points), size=2 * count)]
        wide = _jittered(centre + _WIDENING * (drawn - centre), rng, 0.1)
        both = np.concatenate([wide, _jittered(drawn, rng, 1e-3)])  # the latter where the former leaves the domain
        good = np.isfinite(log_density(both))
        starts = np.concatenate([starts, both[: len(wide)][good[: len(wide)]], both[len(wide) :][good[len(wide) :]]])
    return starts[:count].reshape(*shape, -1)
