"""One capsule of a hidden session: what it is, and what of it can be seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Capsule"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Capsule:
    """A capsule in the channel.

    Parameters
    ----------
    capillary_number, size_ratio : float
        In the channel as it is where the capsule is seen.
    surface_shear_modulus : float [N/m]
    capsule_radius : float [m]
    capsule_velocity : float [m/s]
        With which it moves.
    velocity_seen : float [m/s]
        With which it is seen to move, but for chance.
    outline : (p, 2) array
        Edge in the mid-plane as it is seen, over the half width that the lab believes in; columns (z, y), from the
        nose through y > 0.
    """

    capillary_number: float
    size_ratio: float
    surface_shear_modulus: float
    capsule_radius: float
    capsule_velocity: float
    velocity_seen: float
    outline: Floats
