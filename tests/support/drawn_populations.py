"""Sessions of drawn capsules: a population of known mean, spread and slope, under one viscosity not quite known."""

from __future__ import annotations

import json

import numpy as np

from capsbayes.experiment import Experiment
from capsbayes.infer import Prior
from capsbayes.infer.batch import Run, fill_exactly
from capsbayes.infer.population import CapsuleRows, Population
from capsbayes.infer.selection import limit_of
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity

VISCOSITY, HALF_WIDTH = (0.85, 0.0425), (25e-6, 0.25e-6)
TRUTH = {
    "surface_shear_modulus": 0.05,
    "capsule_radius": 22.5e-6,
    "modulus_spread_at_given_size": 0.15,
    "radius_spread": 0.04,
    "modulus_slope": 0.8,
}
EXPERIMENT = Experiment(cross_section="square", half_width=Quantity(*HALF_WIDTH), viscosity=Quantity(*VISCOSITY))
_SHARED = {"half_width": HALF_WIDTH, "viscosity": VISCOSITY}
FLOWS = (2.5e-3, 3.5e-3, 4.5e-3, 5.5e-3)
ERROR, VELOCITY_ERROR = 0.01, 0.01


def measured(model, count, seed, *, truth=TRUTH, shared=1.0, flows=FLOWS, kind="normal", limit=1.0):
    """Lengths (n, 5) [l] and velocities (n, 2) [m/s] of the capsules of a session, measured with errors.

    The errors of the model are drawn too; those of viscosity and half width are scaled by `shared`. Capsules without a
    steady shape are never seen; its limit is that of the model times `limit`, at most one. Populations of the kind
    ``"t3"`` are t distributions of three degrees of freedom with the spreads as their scales, and of one that is
    ``"contaminated"`` one capsule in ten is from a population four times as wide.
    """
    rng = np.random.default_rng(seed)
    viscosity = VISCOSITY[0] + shared * VISCOSITY[1] * rng.standard_normal()
    half_width = HALF_WIDTH[0] + shared * HALF_WIDTH[1] * rng.standard_normal()
    log_size = truth["radius_spread"] * _standard(kind, rng, count)
    radius = truth["capsule_radius"] * np.exp(log_size)
    deviation = truth["modulus_spread_at_given_size"] * _standard(kind, rng, count)
    modulus = truth["surface_shear_modulus"] * np.exp(truth["modulus_slope"] * log_size + deviation)
    flow = rng.choice(flows, count)
    theta = {"capillary_number": viscosity * flow / modulus, "size_ratio": radius / half_width}
    shape = model(theta)
    seen = shape.inside & model.domain.contains(theta["capillary_number"] / limit, theta["size_ratio"])
    own = np.linalg.cholesky(shape.covariance[seen] + 1e-16 * np.eye(3)) @ rng.standard_normal((seen.sum(), 3, 1))
    truly = np.stack([shape.axial_extent, shape.axial_length, shape.velocity_ratio], axis=1)[seen] + own[..., 0]
    noisy = truly[:, :2] + ERROR * rng.standard_normal((len(truly), 2))
    lengths = np.column_stack([noisy, np.tile([ERROR**2, 0.0, ERROR**2], (len(truly), 1))])
    velocity = truly[:, 2] * flow[seen] * (1.0 + VELOCITY_ERROR * rng.standard_normal(len(truly)))
    return lengths, np.column_stack([velocity, VELOCITY_ERROR * velocity])


def _standard(kind, rng, count):
    """Draw deviations over their scale."""
    normal = rng.standard_normal(count)
    if kind == "t3":
        return normal / np.sqrt(rng.chisquare(3, count) / 3)
    return normal * np.where(rng.uniform(size=count) < 0.1, 4.0, 1.0) if kind == "contaminated" else normal


def drawn_population(model, count, seed, *, shared=1.0, **how):
    """A session of capsules, measured and identified."""
    lengths, velocities = measured(model, count, seed, shared=shared, **how)
    rows = rows_of(measurements(lengths, velocities), Run(model, EXPERIMENT, Prior(), 1))
    pairs = {name: (value, shared * error) for name, (value, error) in _SHARED.items()}
    stated = {name: dict(zip(("value", "error"), pair, strict=True)) for name, pair in pairs.items()}
    return Population.of(rows, {"experiment": json.dumps(stated), "seed": 1}, limit_of(model))


def measurements(lengths, velocities):
    """What `measured` returned as measurements; L_a is at most L_z."""
    return [
        Measurement(extent, np.sqrt(zz), *velocity, axial_length=min(length, extent), axial_length_error=np.sqrt(aa))
        for (extent, length, zz, _, aa), velocity in zip(lengths, velocities, strict=True)
    ]


def rows_of(seen, run):
    """Identify measurements as a batch does."""
    rows = CapsuleRows.empty([""] * len(seen), [""] * len(seen))
    for row, measurement in enumerate(seen):
        fill_exactly(rows, row, measurement, run)
    return rows
