"""One capsule of a blind session, and its measurement with errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.evidence.blind.lab import Noise
from capsbayes.measurement import MeasuredOutline, Measurement, OutlineNoise
from capsbayes.profile import Profile, arc_length, vertex_normals

_LEAST_INDEPENDENT = 1e-9  # share of the variance that keeps a covariance definite
_TILT, _SHIFT = 0.01, 0.05  # rad, l


@dataclass(frozen=True, eq=False)
class Capsule:
    """A capsule in the channel."""

    capillary_number: float  # in the true channel, at the place of the capsule
    size_ratio: float  # in the true channel
    surface_shear_modulus: float  # [N/m]
    capsule_radius: float  # [m]
    capsule_velocity: float  # [m/s], true
    velocity_seen: float  # [m/s], as the microscope shows it, without random errors
    flow_rate: float  # [m^3/s], as the pump shows it, without random errors
    outline: Floats  # (p, 2): edge in the mid-plane as seen, over the lab's half width; columns (z, y), from the nose
    row: int = 0  # of its shape among the converged ones of the database

    def measured(
        self,
        noise: Noise,
        rng: np.random.Generator,
        *,
        outline: bool,
        source: str,
        flow_rate: tuple[float, float] | None = None,
    ) -> Measurement:
        """Return the measurement of the capsule under the name `source`, with its outline or with the lengths alone."""
        # A flow rate is stated if the stated one over that of the pump is given, and its relative standard error.
        factor, relative = flow_rate or (0.0, 0.0)
        seen = Profile.from_outline(self.outline).resampled(4 * noise.points)
        start = int(rng.integers(4))
        normals = vertex_normals(seen.points)[start::4]
        errors = edge_errors(seen.points[start::4], noise, rng)
        edge = seen.points[start::4] + errors[:, None] * normals
        extent, length = _lengths(seen, edge, errors)
        velocity = self.velocity_seen * rng.normal(1.0, noise.velocity)
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
            flow_rate=factor * self.flow_rate if flow_rate else None,
            flow_rate_error=relative * factor * self.flow_rate if flow_rate else None,
        )


def edge_errors(points: Floats, noise: Noise, rng: np.random.Generator) -> Floats:
    """Draw the errors (m,) of vertices (m, 2) along their normals."""
    # They are a Gaussian process on the arc, whose scale differs from capsule to capsule where the noise has heavy
    # tails.
    arc = arc_length(points)
    apart = np.abs(np.subtract.outer(arc[:-1], arc[:-1]))
    same = np.eye(len(points))
    smooth = _correlation(apart, arc[-1], noise) if noise.correlation_length else same
    smooth = smooth + _LEAST_INDEPENDENT * same
    size = noise.understated * noise.scale
    if noise.freedom is not None:
        size *= np.sqrt((noise.freedom - 2.0) / rng.chisquare(noise.freedom))
    # along the Cholesky factor: the signs of eigenvectors depend on the processor
    return np.asarray(size * (np.linalg.cholesky(smooth) @ rng.standard_normal(len(smooth))))


def _correlation(apart: Floats, perimeter: float, noise: Noise) -> Floats:
    """Return the correlations of errors at distances along a closed arc : array of the same shape."""
    length = noise.correlation_length * noise.longer
    if noise.kernel == "exponential":
        return np.asarray(np.exp(-np.minimum(apart, perimeter - apart) / length))
    around = np.array([-1.0, 0.0, 1.0]) * perimeter  # summed over the windings it is positive definite
    summed, one = (
        np.exp(-0.5 * (np.add.outer(around, there) / length) ** 2).sum(axis=0) for there in (apart, np.zeros(()))
    )
    return np.asarray(summed / one)


def _lengths(seen: Profile, edge: Floats, errors: Floats) -> tuple[float, float]:
    """Return L_z and L_a as read at three places of the edge: nose, rearmost point, rear on the axis."""
    upper = seen.points[: len(seen.points) // 2 + 1]  # of two rearmost points always the same one
    places = upper[0], upper[np.argmin(upper[:, 0])], upper[-1]
    nose, rim, middle = (errors[np.argmin(np.hypot(*(edge - place).T))] for place in places)
    extent = seen.axial_extent + nose + rim
    return float(extent), float(min(seen.axial_length + nose + middle, extent))


def _posed(edge: Floats, noise: Noise, rng: np.random.Generator) -> MeasuredOutline:
    """Return the outline slightly tilted and shifted, as in a picture."""
    angle = _TILT * rng.standard_normal()
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    placed = edge @ turn + _SHIFT * rng.standard_normal(2)
    return MeasuredOutline(placed, OutlineNoise(noise.scale, noise.correlation_length))
