"""Sessions of capsules drawn from a model, whose truth is known."""

from __future__ import annotations

import numpy as np

from capsbayes.diagnosis.session import Session
from capsbayes.experiment import Experiment
from capsbayes.measurement import MeasuredOutline, Measurement, OutlineNoise, Pose
from capsbayes.profile import vertex_normals
from capsbayes.quantity import Quantity

EXPERIMENT = Experiment(cross_section="square", half_width=Quantity(25e-6, 0.25e-6), viscosity=Quantity(0.8, 0.02))
POINTS = 48
MODULUS, SPREAD = 0.05, 0.1  # N/m, and standard deviation of its logarithm


def drawn_session(model, count, seed, *, outline=False, noise=0.01, sizes=None, settings=False, apart=None):
    """Capsules of like modulus and of all sizes at four velocities, and their truth by name : arrays.

    With `settings` each velocity has a flow rate, which tells nothing of the mean velocity. To ln G_s `apart` (count,)
    is added.
    """
    rng = np.random.default_rng(seed)
    measurements, truth = [], {"log_modulus": [], "size_ratio": [], "log_ca": []}
    while len(measurements) < count:
        size, log_modulus = rng.uniform(0.8, 0.95), np.log(MODULUS) + SPREAD * rng.standard_normal()
        velocity = float(rng.choice([3e-3, 4e-3, 5e-3, 6e-3]))
        theta = {"size_ratio": np.array([size])}
        theta |= {name: np.array([value]) for name, value in (sizes or {}).items()}
        theta |= {"half_width": np.array([25e-6]), "capsule_velocity": np.array([velocity])}
        ratio = 1.3
        log_modulus += 0.0 if apart is None else apart[len(measurements)]
        for _ in range(3):
            ca = 0.8 * velocity / ratio / np.exp(log_modulus)
            shape = model(theta | {"capillary_number": np.array([ca])})
            ratio = shape.velocity_ratio[0]
        if not shape.inside[0]:
            continue
        log_modulus = np.log(0.8 * velocity / shape.velocity_ratio[0] / ca)
        seen = shape.values[0, :2] + noise * rng.standard_normal(2)
        if seen[1] > seen[0] or shape.parachute_depth[0] < 0.05:
            continue
        rate = round(velocity * 50e-6**2, 15) if settings else None
        edge = None
        if outline:
            edge = _edge(rng, model(theta | {"capillary_number": np.array([ca])}, outline=True).outline[0], noise)
        lengths, speed = seen.tolist(), (velocity * rng.normal(1.0, 0.01), 0.01 * velocity)
        flow = {"flow_rate": rate, "flow_rate_error": rate}
        measurements.append(Measurement(lengths[0], noise, *speed, lengths[1], noise, outline=edge, **flow))
        truth["log_modulus"].append(log_modulus)
        truth["size_ratio"].append(size)
        truth["log_ca"].append(np.log(ca))
    return Session(measurements, EXPERIMENT), {name: np.array(values) for name, values in truth.items()}


def _edge(rng, outline, scale):
    """Points of the outline moved along their normals by correlated errors, shifted and tilted a little."""
    noise = OutlineNoise(scale, 0.2)
    chosen = outline[:: max(len(outline) // POINTS, 1)]
    moved = chosen + noise.drawn(rng, chosen, 1)[0][:, None] * vertex_normals(chosen)
    angle = 0.01 * rng.standard_normal()
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return MeasuredOutline(moved @ turn + 0.05 * rng.standard_normal(2), noise, Pose())
