"""Coordinates in which what is seen of a capsule depends smoothly on the parameters of flow and membrane.

The tension of an inflated sphere is 2 K alpha to first order: inflation counts by it, on a scale that is fine where
the dimple ends and coarse beyond. Ca and K count by their logarithm, bending by its root, the width of a rim.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats

_FINE = 0.04  # tension over G_s up to which inflation counts about evenly


_COUNTS = np.array([0.6, 0.6, 0.8, 1.5, 1.0, 2.5])  # change of each coordinate, over its spread, that counts as one


def coordinates(values: Floats) -> Floats:
    """Return the coordinates (n, 6) of parameters (n, 6) in the order of `FREE_PARAMETERS`."""
    ca, size, inflation, modulus, hardening, bending = values.T
    columns = np.log(ca), size, np.log(2.0 * modulus * inflation + _FINE), np.log(modulus), hardening, np.sqrt(bending)
    return np.stack(columns, axis=1)


def along_coordinates(values: Floats, along: Floats) -> Floats:
    """Turn derivatives (n, q, 6) along the parameters into derivatives (n, q, 6) along the coordinates."""
    ca, _, inflation, modulus, _, bending = values.T[:, :, None]
    turned = along.copy()
    turned[..., 0] *= ca
    per_tension = along[..., 2] / (2.0 * modulus)  # at constant K
    turned[..., 2] = per_tension * (2.0 * modulus * inflation + _FINE)
    turned[..., 3] = modulus * along[..., 3] - 2.0 * modulus * inflation * per_tension  # at constant tension
    turned[..., 5] *= 2.0 * np.sqrt(bending)
    return turned


@dataclass(frozen=True, eq=False)
class Frame:
    """Coordinates about the middle (6,) of a set of states, scaled (6,) so that one counts as much as another."""

    middle: Floats
    scale: Floats

    @classmethod
    def of(cls, values: Floats) -> Frame:
        """Return that of states with parameters (n, 6)."""
        raw = coordinates(values)
        return cls(raw.mean(axis=0), _COUNTS * raw.std(axis=0))

    def points(self, values: Floats) -> Floats:
        """Return the scaled coordinates (n, 6) of parameters (n, 6)."""
        return (coordinates(values) - self.middle) / self.scale

    def slopes(self, values: Floats, along: Floats) -> Floats:
        """Turn derivatives (n, q, 6) along the parameters into those along the scaled coordinates."""
        return along_coordinates(values, along) * self.scale
