"""The smooth curve through the points of an outline: its low harmonics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Booleans, Floats

_KEPT = 0.1  # of the number of points: harmonics up to there; noise would lengthen and bend the curve

Complex = NDArray[np.complex128]


def low_harmonics(points: Floats) -> tuple[Floats, Complex]:
    """Return the numbers of the low harmonics of a closed outline (n, 2), and their coefficients in x + iy."""
    order, coefficients, kept = _harmonics(points)
    return order[kept], coefficients[kept] / len(points)


def smooth_curve(points: Floats) -> Floats:
    """Return the points (n, 2) of the smooth curve at the places of those of an outline."""
    _, coefficients, kept = _harmonics(points)
    smooth = np.fft.ifft(np.where(kept, coefficients, 0.0))
    return np.stack([smooth.real, smooth.imag], axis=1)


def waves(order: Floats, count: int) -> Complex:
    """Return harmonics at so many equal steps around : (count, k) array."""
    return np.asarray(np.exp(2j * np.pi * np.arange(count)[:, None] / count * order))


def _harmonics(points: Floats) -> tuple[Floats, Complex, Booleans]:
    order: Floats = np.fft.fftfreq(len(points), 1.0 / len(points)).astype(np.float64)
    kept: Booleans = np.abs(order) <= _KEPT * len(points)
    return order, np.fft.fft(points @ np.array([1.0, 1j])), kept
