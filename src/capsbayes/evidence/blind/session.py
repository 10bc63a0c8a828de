"""Blind sessions drawn from stored shapes, or simulated capsule by capsule, with their truth."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.database import Database
from capsbayes.diagnosis import Session
from capsbayes.errors import InputError
from capsbayes.evidence.blind.capsule import Capsule
from capsbayes.evidence.blind.effects import TrueEffect
from capsbayes.evidence.blind.lab import Lab
from capsbayes.evidence.blind.pools import simulator_with
from capsbayes.experiment import capillary_number, capsule_radius, surface_shear_modulus
from capsbayes.physics.build import build_database
from capsbayes.profile import with_extent

_TYPICAL = -4.5  # log density relative to its maximum: three standard deviations
_SPARE = 1.15  # simulated capsules for each one wanted, since some have no steady shape
_DIGITS = 6  # of Ca and a/l, so that a case can be found again
_LOWEST = 0.02  # Ca, below which two shapes may be stable


@dataclass(frozen=True, eq=False)
class BlindSession:
    """The measurements of a lab, and the truth that it does not know."""

    session: Session
    effect: str  # name of the true effect, "none" if there is none
    size: float  # of the effect, in SI
    seed: int
    lab: Lab
    capsules: tuple[Capsule, ...]
    shapes: str  # sha256 of the database of shapes
    log_modulus_of_batch: float  # ln of the median G_s [N/m] of the capsules among which these were drawn

    @property
    def log_modulus(self) -> Floats:
        """ln G_s of the capsules [N/m] : (n,) array."""
        return np.log([capsule.surface_shear_modulus for capsule in self.capsules])

    def truth(self) -> dict[str, Any]:
        """Return the whole truth in SI, as JSON can hold it."""
        numbers = ("surface_shear_modulus", "capsule_radius", "capillary_number", "size_ratio", "capsule_velocity")
        capsules = [{name: float(getattr(capsule, name)) for name in numbers} for capsule in self.capsules]
        known = {"effect": self.effect, "size": self.size, "seed": self.seed, "shapes_sha256": self.shapes}
        return {**known, "lab": asdict(self.lab), "capsules": capsules}


def draw_session(
    shapes: Database, effect: TrueEffect, size: float, *, lab: Lab, capsules: int, seed: int, outline: bool = True
) -> BlindSession:
    """Draw a session of some capsules from stored shapes, measured with their outlines or by the lengths alone."""
    # Capsules are drawn among all pairs of a shape and a flow rate, with the probability density of the lab's
    # population there; the pair determines G_s. The shapes were simulated with the effect if it acts on the simulation;
    # its size is in SI.
    rng = np.random.default_rng(seed)
    pairs, median = _pairs(shapes.converged, effect.lab(lab, size), capsules, rng)
    return _measured(shapes, pairs, effect, size, lab, seed, outline, rng, median)


def simulate_session(
    effect: TrueEffect,
    size: float,
    *,
    lab: Lab,
    capsules: int,
    seed: int,
    shapes: str | os.PathLike[str],
    outline: bool = True,
    refinement: int | None = None,
    workers: int | None = None,
) -> BlindSession:
    """Draw some capsules from a lab's population, simulate each at its own Ca and size, and measure them."""
    # The database at the path `shapes` keeps the shapes: the same call repeated continues from those that are finished.
    # The size of the effect is in SI; without `outline`, lengths alone are measured.
    rng = np.random.default_rng(seed)
    modulus, size_ratio, speed = effect.lab(lab, size).drawn(rng, int(np.ceil(_SPARE * capsules)))
    ca = capillary_number(viscosity=lab.viscosity, mean_velocity=speed, surface_shear_modulus=modulus)
    cases = list(zip(np.round(np.maximum(ca, _LOWEST), _DIGITS), np.round(size_ratio, _DIGITS), strict=True))
    simulator = simulator_with(effect, size) if refinement is None else simulator_with(effect, size, refinement)
    built = build_database(simulator, cases, out=shapes, workers=workers).converged
    rows = [_row(built, *case) for case in cases]
    pairs = [(row, float(velocity)) for row, velocity in zip(rows, speed, strict=True) if row is not None][:capsules]
    if len(pairs) < capsules:
        advice = "let them be softer or smaller"
        raise InputError("blind session", "capsules", f"{capsules} with a steady shape", f"{len(pairs)}", advice)
    median = float(np.log(lab.surface_shear_modulus))
    return _measured(built, pairs, effect, size, lab, seed, outline, rng, median)


def _measured(
    shapes: Database,
    pairs: Sequence[tuple[int, float]],
    effect: TrueEffect,
    size: float,
    lab: Lab,
    seed: int,
    outline: bool,
    rng: np.random.Generator,
    median: float,
) -> BlindSession:
    """Return the session of capsules with converged shapes, given by their rows, each at a mean velocity."""
    converged = shapes.converged
    capsules = [effect.drawn(_capsule(converged, row, speed, lab), size, lab, seed) for row, speed in pairs]
    factor = lab.stated_over_true_flow(rng)
    stated = None if factor is None else (factor, lab.flow_rate_error or 0.0)
    measurements = [
        capsule.measured(lab.noise, rng, outline=outline, source=f"capsule {number:03d}", flow_rate=stated)
        for number, capsule in enumerate(capsules, start=1)
    ]
    session = Session(measurements, lab.experiment)
    return BlindSession(session, effect.name, size, seed, lab, tuple(capsules), shapes.sha256, median)


def _pairs(shapes: Database, lab: Lab, count: int, rng: np.random.Generator) -> tuple[list[tuple[int, float]], float]:
    """Draw the row of a shape and the mean velocity of each capsule, no pair twice; return the median ln G_s of all."""
    speeds = np.array(lab.mean_velocities)
    modulus = surface_shear_modulus(
        viscosity=lab.viscosity, mean_velocity=speeds, capillary_number=shapes["capillary_number"][:, None]
    )
    density = np.exp(lab.log_density(modulus, shapes["size_ratio"][:, None])).ravel()
    possible = int(np.sum(density > np.exp(_TYPICAL)))
    if possible < count:
        expected = f"shapes for {count} capsules"
        raise InputError("blind session", "shapes", expected, f"{possible} pairs of a shape and a flow rate")
    places = rng.choice(density.size, count, replace=False, p=density / density.sum())
    order = np.argsort(modulus, axis=None)
    below = np.cumsum(density[order])
    median = float(np.log(modulus.ravel()[order][np.searchsorted(below, 0.5 * below[-1])]))
    return [(int(place) // len(speeds), float(speeds[place % len(speeds)])) for place in places], median


def _row(shapes: Database, capillary_number: float, size_ratio: float) -> int | None:
    """Return the row of a case, None if it has no steady shape."""
    same = np.isclose(shapes["capillary_number"], capillary_number) & np.isclose(shapes["size_ratio"], size_ratio)
    rows = np.flatnonzero(same)
    return int(rows[0]) if len(rows) else None


def _capsule(shapes: Database, row: int, mean_velocity: float, lab: Lab) -> Capsule:
    """Return the capsule that has the shape in a row of the database at a mean velocity [m/s]."""
    ca, size_ratio = float(shapes["capillary_number"][row]), float(shapes["size_ratio"][row])
    modulus = surface_shear_modulus(viscosity=lab.viscosity, mean_velocity=mean_velocity, capillary_number=ca)
    velocity = mean_velocity * float(shapes["velocity_ratio"][row])
    return Capsule(
        capillary_number=ca,
        size_ratio=size_ratio,
        surface_shear_modulus=float(modulus),
        capsule_radius=float(capsule_radius(size_ratio=size_ratio, half_width=lab.half_width)),
        capsule_velocity=velocity,
        velocity_seen=velocity,
        flow_rate=mean_velocity * lab.half_width**2 * _area(shapes),
        outline=with_extent(shapes["profile"][row], float(shapes["axial_extent"][row])),
        row=row,
    )


def _area(shapes: Database) -> float:
    """Return the area of the cross-section in which the shapes were simulated, over l^2."""
    settings = shapes.settings
    aspect, radius = (
        float(settings.get(name, null)) for name, null in (("section_aspect", 1.0), ("corner_radius", 0.0))
    )
    return 4.0 * aspect - (4.0 - np.pi) * radius**2
