"""Likelihood of a measured outline: normal distances with errors that are correlated along the arc.

An edge that is found too far out at one place is found too far out beside it
as well: taken as independent, the errors of neighbouring points would make the
posterior far too narrow. Where on the picture the capsule is, how it is tilted
and by how much all edges are found too far out does not belong to its shape;
these nuisances are integrated out, each with a Gaussian prior, as is the
model's own error. All of it is one covariance matrix, made at a pilot shape
near the posterior and kept for all others.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from capsbayes.errors import InputError
from capsbayes.inference.normal_distance import Footing, footing, normal_distances

__all__ = ["OutlineLikelihood", "OutlineNoise", "Pose"]

Floats = NDArray[np.float64]

_FITS = 5  # of the pose to the pilot; three suffice from half a radius away


@dataclass(frozen=True)
class OutlineNoise:
    """Errors of the points of an outline along their normals: Gaussian, correlated as exp(-distance / length).

    Parameters
    ----------
    scale : float
        Standard deviation, over l.
    correlation_length : float
        Along the arc, over l; zero for independent errors.
    white : float
        Share of the variance that is independent from point to point.
    """

    scale: float
    correlation_length: float
    white: float = 0.0

    def __post_init__(self) -> None:
        for name, good in (
            ("scale", self.scale > 0.0),
            ("correlation_length", self.correlation_length >= 0.0),
            ("white", 0.0 <= self.white <= 1.0),
        ):
            if not good:
                expected = {"scale": "a positive number", "white": "a number from 0 to 1"}
                raise InputError(
                    "OutlineNoise",
                    name,
                    expected.get(name, "a number that is not negative"),
                    f"{getattr(self, name):g}",
                )

    def covariance(self, points: Floats) -> Floats:
        """Covariance (m, m) of the errors at the vertices (m, 2) of a closed outline."""
        edges = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
        arc = np.concatenate([[0.0], np.cumsum(edges)])
        apart = np.abs(arc[:-1, None] - arc[:-1])
        apart = np.minimum(apart, arc[-1] - apart)
        same = np.eye(len(points))
        smooth = np.exp(-apart / self.correlation_length) if self.correlation_length else same
        covariance: Floats = self.scale**2 * ((1.0 - self.white) * smooth + self.white * same)
        return covariance

    def drawn(self, rng: np.random.Generator, points: Floats, count: int) -> Floats:
        """Errors drawn for the vertices (m, 2) of a closed outline : (count, m) array."""
        factor = scipy.linalg.cholesky(
            self.covariance(points) + 1e-12 * self.scale**2 * np.eye(len(points)), lower=True
        )
        return np.asarray(rng.standard_normal((count, len(points))) @ factor.T)


@dataclass(frozen=True)
class Pose:
    """Standard deviations of what an outline has besides its shape.

    Parameters
    ----------
    along, across : float
        Shift along and across the flow, over l.
    tilt : float
        Of the flow direction on the picture [rad].
    offset : float
        Of all edges along their normals, over l: how far too far out a halo or a threshold puts them.
    """

    along: float = 1.0
    across: float = 1.0
    tilt: float = 0.05
    offset: float = 0.0

    def directions(self, points: Floats, normal: Floats) -> Floats:
        """Change of the normal distances by one standard deviation of each : (m, 4) array."""
        turned = points[:, 0] * normal[:, 1] - points[:, 1] * normal[:, 0]
        each = [self.along * normal[:, 0], self.across * normal[:, 1], self.tilt * turned]
        return np.stack([*each, np.full(len(points), self.offset)], axis=1)


@dataclass(frozen=True, eq=False)
class OutlineLikelihood:
    """Density of a measured outline given predicted ones.

    Parameters
    ----------
    points : (m, 2) array [l]
        The measured outline, closed, consecutive vertices from anywhere, columns (z, y), counter-clockwise as in a
        `Profile`; any place and tilt.
    noise : OutlineNoise
    pilot : (p, 2) array [l]
        A predicted outline near the posterior.
    pose : Pose
    modes : (k, p) array [l], optional
        Displacements of the pilot's vertices along their normals, each one standard deviation of the model's own error.

    Examples
    --------
    >>> angle = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    >>> circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    >>> seen = OutlineLikelihood(0.9 * circle + [0.3, 0.1], OutlineNoise(0.01, 0.2), pilot=0.9 * circle)
    >>> int(np.argmax(seen.log_density(np.linspace(0.85, 0.95, 11)[:, None, None] * circle)))
    5
    """

    points: Floats
    noise: OutlineNoise
    pilot: Floats
    pose: Pose = field(default_factory=Pose)
    modes: Floats | None = None
    _aligned: Floats = field(init=False, repr=False)
    _factor: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        aligned, feet = _aligned_with(self.points, self.pilot)
        covariance = self.noise.covariance(self.points)
        spread = self.pose.directions(aligned, feet.normal)
        covariance = covariance + spread @ spread.T
        if self.modes is not None:
            own = _at_places(self.modes, feet.place)
            covariance += own.T @ own
        covariance[np.diag_indices_from(covariance)] += 1e-8 * self.noise.scale**2
        object.__setattr__(self, "_aligned", aligned)
        object.__setattr__(self, "_factor", scipy.linalg.cholesky(covariance, lower=True))

    def whitened(self, outlines: Floats) -> Floats:
        """Normal distances from predicted outlines (n, p, 2), as independent standard normal numbers : (n, m) array."""
        distances = normal_distances(self._aligned, outlines)
        known = np.isfinite(distances[:, 0])
        white = np.full_like(distances, np.nan)
        white[known] = scipy.linalg.solve_triangular(self._factor, distances[known].T, lower=True).T
        return white

    def log_density(self, outlines: Floats) -> Floats:
        """Log density given each of n outlines (n, p, 2) : (n,) array, NaN for a row of NaN."""
        square = np.sum(self.whitened(outlines) ** 2, axis=1)
        constant = np.sum(np.log(np.diag(self._factor))) + 0.5 * len(self.points) * np.log(2.0 * np.pi)
        return np.asarray(-0.5 * square - constant)


def _aligned_with(points: Floats, outline: Floats) -> tuple[Floats, Footing]:
    """The points shifted and turned onto an outline by least squares, and where they stand on it."""
    moved = points - _middle(points) + _middle(outline)
    for _ in range(_FITS):
        feet = footing(moved, outline)
        rows = Pose(1.0, 1.0, 1.0).directions(moved, feet.normal)[:, :3]
        shift_z, shift_y, turn = np.linalg.lstsq(rows, -feet.distance)[0]
        cosine, sine = np.cos(turn), np.sin(turn)
        moved = moved @ np.array([[cosine, sine], [-sine, cosine]]) + [shift_z, shift_y]
    return moved, footing(moved, outline)


def _middle(points: Floats) -> Floats:
    return 0.5 * (points.max(axis=0) + points.min(axis=0))


def _at_places(modes: Floats, place: Floats) -> Floats:
    """Values (k, m) between the vertices of those at them (k, p)."""
    count = modes.shape[1]
    before = np.floor(place).astype(int) % count
    share = place - np.floor(place)
    return np.asarray((1.0 - share) * modes[:, before] + share * modes[:, (before + 1) % count])
