"""Velocity of each capsule over that which its flow rate gives: a second source of the mean velocity U.

The flow rate Q gives U = Q / A without the capsule, its own shape gives v_o/U. The logarithm of the measured v_o over
the predicted one is zero within the errors under a right model. Those of the velocities and of the shapes are
independent from capsule to capsule; those of Q and of the half width, and the model's own, are common to all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Booleans, Floats
from capsbayes.diagnosis.session import Session
from capsbayes.experiment import AREAS
from capsbayes.model import ForwardModel

LEAST_SHARED = 1e-4
"""Relative error of a flow rate that is taken as known, so that a common error always has a scale."""


@dataclass(frozen=True, eq=False)
class FlowOffsets:
    """ln of the velocities of n capsules over those that the flow rates and their best shapes give."""

    offset: Floats  # (n,): NaN where no flow rate is known, or the model has no shape
    variance: Floats  # (n,): by the errors of the velocity and of the shape
    with_modulus: Floats  # (n,): covariance with ln G_s
    shared: Floats  # (n,): sd by the errors common to all: of the flow rate, the half width and the model

    @property
    def known(self) -> Booleans:
        """Where there is an offset : (n,) bool array."""
        return np.isfinite(self.offset)

    def log_likelihood(self, log_modulus: Floats, total: Floats, mean: float) -> Floats:
        """Return the log likelihood of each offset given ln G_s, with the likeliest common error : (n,) array."""
        # ln G_s (n,) has the variances `total` (n,) about its mean among the capsules. Zero where there is no offset.
        found, known = np.zeros(len(self.offset)), self.known
        if not known.any():
            return found
        slope = self.with_modulus[known] / total[known]
        away = self.offset[known] - slope * (log_modulus[known] - mean)
        variance = self.variance[known] - slope * self.with_modulus[known]
        shared = self.shared[known]
        common = np.sum(away * shared / variance) / (1.0 + np.sum(shared**2 / variance))
        rest = np.square(away - common * shared) / variance + np.log(2.0 * np.pi * variance)
        found[known] = -0.5 * (rest + common**2 / known.sum())
        return found


def flow_offsets(
    model: ForwardModel,
    session: Session,
    rest: Mapping[str, Floats],
    points: Floats,
    ratio: Floats,
    ratio_slopes: Floats,
    covariance: Floats,
) -> FlowOffsets:
    """Compare the velocities of a session with its flow rates, at the best shapes, points (n, 2) of ln Ca and a/l."""
    # `rest` holds circumstances and sizes of effects; `ratio` (n,) is v_o/U; the covariance (n, 2, 2) of the points is
    # NaN where the model has no shape.
    nothing = np.full(len(ratio), np.nan)
    if not np.isfinite(session.flow_rates).any():
        return FlowOffsets(nothing, nothing, nothing, nothing)
    theta = {**rest, "capillary_number": np.exp(points[:, 0]), "size_ratio": points[:, 1]}
    area = AREAS[session.experiment.cross_section] * session.circumstances["half_width"] ** 2
    speed = session.flow_rates / (area * model.relative_area(theta))
    slopes = ratio_slopes / ratio[:, None]
    spread = np.einsum("nij,nj->ni", covariance, slopes)
    velocity = np.square(session.velocity_errors)
    variance = velocity + np.sum(slopes * spread, axis=1)
    own = np.sqrt(model(theta).covariance[:, 2, 2]) / ratio
    return FlowOffsets(
        np.where(np.isfinite(variance), np.log(session.circumstances["capsule_velocity"] / (speed * ratio)), np.nan),
        variance,
        variance + spread[:, 0],
        np.sqrt(session.flow_rate_errors**2 + own**2 + LEAST_SHARED**2),
    )
