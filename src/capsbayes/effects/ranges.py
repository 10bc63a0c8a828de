"""Distributions for the priors of effects; scipy.stats is imported on first use."""

from __future__ import annotations

from typing import Any


def normal(mean: float, spread: float) -> Any:
    """Return a normal distribution."""
    from scipy.stats import norm  # half a second to import

    return norm(mean, spread)


def uniform(low: float, high: float) -> Any:
    """Return a uniform distribution between two ends."""
    from scipy.stats import uniform as distribution

    return distribution(low, high - low)


def log_uniform(low: float, high: float) -> Any:
    """Return a distribution whose logarithm is uniform between two ends."""
    from scipy.stats import loguniform

    return loguniform(low, high)
