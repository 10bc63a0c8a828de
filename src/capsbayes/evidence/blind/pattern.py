"""Smooth random displacements of an outline."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["smooth_pattern"]

Floats = NDArray[np.float64]

_WAVES = 6  # of the arc


def smooth_pattern(outline: Floats, seed: int) -> Floats:
    """Displacements (p, 2) along the normals of an outline (p, 2): a random function of the arc, its rms one."""
    cosines, sines = np.random.default_rng([seed, _WAVES]).standard_normal((2, _WAVES))
    closed = np.concatenate([outline, outline[:1]])
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    phase = 2.0 * np.pi * np.outer(arc[:-1] / arc[-1], np.arange(1, _WAVES + 1))
    pattern = (np.cos(phase) @ cosines + np.sin(phase) @ sines) / np.sqrt(0.5 * np.sum(cosines**2 + sines**2))
    chord = np.roll(outline, -1, axis=0) - np.roll(outline, 1, axis=0)
    outward = np.stack([chord[:, 1], -chord[:, 0]], axis=1) / np.hypot(chord[:, 0], chord[:, 1])[:, None]
    return np.asarray(pattern[:, None] * outward)
