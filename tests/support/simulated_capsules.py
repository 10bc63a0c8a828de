"""Capsules whose truth is known: drawn from the prior, seen with errors, forgotten, and identified."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.special import ndtri

from capsbayes.experiment import AREAS
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity


@dataclass(frozen=True)
class SimulatedCapsule:
    """What was seen, and what was true."""

    seen: Measurement
    surface_shear_modulus: float
    capsule_radius: float
    mean_velocity: float


def simulated_capsules(
    model, experiment, count, rng, *, errors=(0.01, 0.01), speed_error=0.01, rate_error=None, modulus=None
) -> Iterator:
    """Draw capsules from the default prior within the model's domain and measure them.

    A prior of G_s that is no range over many decades is given as a scipy distribution; the velocity is any.
    The flow rate is measured if it has an error. The model is wrong by as much as it says it is: its own error is drawn
    too.
    """
    (ca_low, ca_high), (size_low, size_high) = model.domain.bounds
    while count > 0:
        ca, size = np.exp(rng.uniform(np.log(ca_low), np.log(ca_high))), rng.uniform(size_low, size_high)
        if not model.domain.contains(ca, size)[0]:
            continue
        prediction = model({"capillary_number": np.array([ca]), "size_ratio": np.array([size])})
        extent, length, ratio = rng.multivariate_normal(prediction.values[0], prediction.covariance[0])
        shape = extent, length, ratio
        capsule = measured_capsule(experiment, shape, (ca, size), rng, errors, speed_error, rate_error, modulus)
        if capsule is not None:
            count -= 1
            yield capsule


def measured_capsule(
    experiment, shape, theta, rng, errors, speed_error, rate_error=None, modulus=None
) -> SimulatedCapsule | None:
    """Measure a capsule of given true shape (L_z, L_a, v_o/U); None where noise makes L_a > L_z."""
    viscosity, width = float(experiment.viscosity.distribution.rvs(random_state=rng)), _half_width(experiment, rng)
    velocity = np.exp(rng.uniform(np.log(1e-3), np.log(20e-3)))
    if modulus is not None:
        velocity = shape[2] * theta[0] * modulus.rvs(random_state=rng) / viscosity
    flow = velocity / shape[2]
    seen = rng.normal(shape[:2], errors)
    if seen[1] > seen[0]:
        return None
    rate = None
    if rate_error is not None:
        truth = AREAS[experiment.cross_section] * width**2 * flow
        rate = Quantity(rng.normal(truth, rate_error * truth), rate_error * truth)
    return SimulatedCapsule(
        Measurement(
            axial_extent=seen[0],
            axial_extent_error=errors[0],
            axial_length=seen[1],
            axial_length_error=errors[1],
            capsule_velocity=rng.normal(velocity, speed_error * velocity),
            capsule_velocity_error=speed_error * velocity,
            flow_rate=rate,
        ),
        mean_velocity=flow,
        surface_shear_modulus=viscosity * flow / theta[0],
        capsule_radius=width * theta[1],
    )


def _half_width(experiment, rng) -> float:
    """Half width of the channel a capsule is found in: a uniform in a leaves more room for a/l in a wide one."""
    while True:
        width = float(experiment.half_width.distribution.rvs(random_state=rng))
        if rng.uniform() < width / (1.2 * experiment.half_width.mean):
            return width


LEVELS = (0.5, 0.9, 0.95)


def mistakes(ranks) -> list[str]:
    """Judge posterior probabilities below the truth, which an honest engine makes uniform.

    Coverage of the central 50, 90 and 95 % outside its binomial band of 99.9 %, a histogram of the ranks whose
    chi-squared is beyond 99.9 %, and normal scores whose spread is outside its band of 99.9 % are mistakes.
    """
    found, count = [], len(ranks)
    for level in LEVELS:
        covered = np.count_nonzero(np.abs(ranks - 0.5) <= 0.5 * level)
        low, high = stats.binom.interval(0.999, count, level)
        if not low <= covered <= high:
            found.append(f"the {level:.0%} interval covers {covered} of {count}, not {low:.0f} to {high:.0f}")
    histogram = np.histogram(ranks, bins=20, range=(0.0, 1.0))[0]
    square = float(np.sum((histogram - count / 20) ** 2) / (count / 20))
    if square > stats.chi2.ppf(0.999, 19):
        found.append(f"the ranks are not uniform: chi-squared {square:.0f} with 19 degrees of freedom")
    scores = ndtri(np.clip(ranks, 1e-9, 1.0 - 1e-9))
    low, high = np.sqrt(np.array(stats.chi2.interval(0.999, count)) / count)
    spread = float(np.sqrt(np.mean(scores**2)))
    if not low <= spread <= high:
        found.append(f"errors are {spread:.3f} of what the posteriors say, not {low:.3f} to {high:.3f}")
    return found
