"""A capsule as it is measured: its outline with errors, and the lengths read from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capsbayes.evidence.blind.capsule import Capsule
from capsbayes.evidence.blind.lab import Noise
from capsbayes.measured_outline import MeasuredOutline, OutlineNoise
from capsbayes.measurement import Measurement
from capsbayes.profile import Profile, vertex_normals

__all__ = ["measured"]

Floats = NDArray[np.float64]

_LEAST_INDEPENDENT = 1e-9  # share of the variance that keeps a covariance definite
_TILT, _SHIFT = 0.01, 0.05  # rad, l


def measured(capsule: Capsule, noise: Noise, rng: np.random.Generator, *, outline: bool, source: str) -> Measurement:
    """Measure one capsule.

    Parameters
    ----------
    capsule : Capsule
    noise : Noise
    rng : Generator
    outline : bool
        Whether to keep the outline, not the lengths alone.
    source : str
        What the measurement is called.
    """
    seen = Profile.from_outline(capsule.outline).resampled(4 * noise.points)
    start = int(rng.integers(4))
    normals = vertex_normals(seen.points)[start::4]
    errors = _errors(seen.points[start::4], noise, rng)
    edge = seen.points[start::4] + errors[:, None] * normals
    extent, length = _lengths(seen, edge, errors)
    velocity = capsule.velocity_seen * rng.normal(1.0, noise.velocity)
    return Measurement(
        extent,
        np.sqrt(2.0) * noise.scale,
        velocity,
        noise.velocity * velocity,
        length,
        np.sqrt(2.0) * noise.scale,
        length_correlation=0.5,
        outline=_posed(edge, noise, rng) if outline else None,
        source=source,
    )


def _errors(points: Floats, noise: Noise, rng: np.random.Generator) -> Floats:
    """Normal errors (m,) of vertices: a Gaussian process on the arc, its size another for each capsule."""
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0, append=points[:1]).T))])
    apart = np.abs(np.subtract.outer(arc[:-1], arc[:-1]))
    apart = np.minimum(apart, arc[-1] - apart)
    same = np.eye(len(points))
    smooth = np.exp(-apart / noise.correlation_length) if noise.correlation_length else same
    smooth = smooth + _LEAST_INDEPENDENT * same
    values, vectors = np.linalg.eigh(smooth)
    size = noise.understated * noise.scale
    if noise.freedom is not None:
        size *= np.sqrt((noise.freedom - 2.0) / rng.chisquare(noise.freedom))
    return np.asarray(size * (vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(values)))))


def _lengths(seen: Profile, edge: Floats, errors: Floats) -> tuple[float, float]:
    """L_z and L_a as read at three places of the edge: nose, farthest point at the rear, rear on the axis."""
    rear = seen.points[:, 0] < seen.points[:, 0].mean()
    places = [
        seen.points[0],
        seen.points[np.argmin(seen.points[:, 0])],
        seen.points[rear][np.argmin(np.abs(seen.points[rear, 1]))],
    ]
    nose, rim, middle = (errors[np.argmin(np.hypot(*(edge - place).T))] for place in places)
    extent = seen.axial_extent + nose + rim
    return float(extent), float(min(seen.axial_length + nose + middle, extent))


def _posed(edge: Floats, noise: Noise, rng: np.random.Generator) -> MeasuredOutline:
    """The outline as a picture has it: a little tilted and shifted."""
    angle = _TILT * rng.standard_normal()
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    placed = edge @ turn + _SHIFT * rng.standard_normal(2)
    return MeasuredOutline(placed, OutlineNoise(noise.scale, noise.correlation_length))
