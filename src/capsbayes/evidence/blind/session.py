"""A session drawn from simulated shapes, and its truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capsbayes.database import Database
from capsbayes.diagnosis import Session
from capsbayes.errors import InputError
from capsbayes.evidence.blind.camera import measured
from capsbayes.evidence.blind.capsule import Capsule
from capsbayes.evidence.blind.hideable import Hideable
from capsbayes.evidence.blind.lab import Lab

__all__ = ["HiddenSession", "assembled", "capsule_of", "drawn_session"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HiddenSession:
    """What a lab has measured, and what it does not know.

    Parameters
    ----------
    session : Session
    effect : str
        Name of what is hidden, "none" if nothing is.
    size : float
        In SI.
    seed : int
    lab : Lab
    capsules : tuple of Capsule
    shapes : str
        sha256 of the database of shapes.
    """

    session: Session
    effect: str
    size: float
    seed: int
    lab: Lab
    capsules: tuple[Capsule, ...]
    shapes: str

    @property
    def log_modulus(self) -> Floats:
        """ln G_s of the capsules [N/m] : (n,) array."""
        return np.log([one.surface_shear_modulus for one in self.capsules])

    def truth(self) -> dict[str, Any]:
        """All that is hidden, in SI, as JSON can hold it."""
        numbers = ("surface_shear_modulus", "capsule_radius", "capillary_number", "size_ratio", "capsule_velocity")
        capsules = [{name: float(getattr(one, name)) for name in numbers} for one in self.capsules]
        told = {"effect": self.effect, "size": self.size, "seed": self.seed, "shapes_sha256": self.shapes}
        return {**told, "lab": asdict(self.lab), "capsules": capsules}


def drawn_session(
    shapes: Database,
    hidden: Hideable,
    size: float,
    *,
    lab: Lab,
    capsules: int,
    seed: int,
    outline: bool = True,
) -> HiddenSession:
    """Draw a session from the shapes that there are.

    Capsules are drawn among all pairs of a simulated shape and a flow rate, with the probability that the lab's
    population has there; the pair says what G_s is.

    Parameters
    ----------
    shapes : Database
        Plain; simulated with what is hidden, if it acts on the simulation.
    hidden : Hideable
    size : float
        In SI.
    lab : Lab
    capsules : int
    seed : int
    outline : bool
        Whether outlines are measured, or lengths alone.

    Raises
    ------
    InputError
        If there are too few shapes for so many capsules.
    """
    rng = np.random.default_rng(seed)
    there = shapes.converged
    chosen = _pairs(there, hidden.lab(lab, size), capsules, rng)
    seen = [hidden.drawn(capsule_of(there, row, speed, lab), size, lab, seed) for row, speed in chosen]
    return assembled(seen, hidden, size, lab=lab, seed=seed, outline=outline, rng=rng, shapes=shapes.sha256)


def assembled(
    seen: Sequence[Capsule],
    hidden: Hideable,
    size: float,
    *,
    lab: Lab,
    seed: int,
    outline: bool,
    rng: np.random.Generator,
    shapes: str,
) -> HiddenSession:
    """Measure capsules and put them into one session."""
    each = [
        measured(one, lab.noise, rng, outline=outline, source=f"capsule {i:03d}") for i, one in enumerate(seen, start=1)
    ]
    return HiddenSession(Session(each, lab.experiment), hidden.name, size, seed, lab, tuple(seen), shapes)


def _pairs(shapes: Database, lab: Lab, count: int, rng: np.random.Generator) -> list[tuple[int, float]]:
    """Row of a shape and mean velocity of each capsule, no pair twice."""
    speeds = np.array(lab.mean_velocities)
    modulus = lab.viscosity * speeds / shapes["capillary_number"][:, None]
    density = np.exp(lab.log_density(modulus, shapes["size_ratio"][:, None])).ravel()
    possible = int(np.sum(density > np.exp(-4.5)))  # within three standard deviations
    if possible < count:
        expected = f"shapes for {count} capsules"
        raise InputError("hidden session", "shapes", expected, f"{possible} pairs of a shape and a flow rate")
    places = rng.choice(density.size, count, replace=False, p=density / density.sum())
    return [(int(place) // len(speeds), float(speeds[place % len(speeds)])) for place in places]


def capsule_of(shapes: Database, row: int, mean_velocity: float, lab: Lab) -> Capsule:
    """The capsule that has a shape (a row of the database) at a mean velocity [m/s]."""
    ca, size = float(shapes["capillary_number"][row]), float(shapes["size_ratio"][row])
    velocity = mean_velocity * float(shapes["velocity_ratio"][row])
    return Capsule(
        capillary_number=ca,
        size_ratio=size,
        surface_shear_modulus=lab.viscosity * mean_velocity / ca,
        capsule_radius=size * lab.half_width,
        capsule_velocity=velocity,
        velocity_seen=velocity,
        outline=np.array(shapes["profile"][row]),
    )
