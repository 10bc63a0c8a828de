"""Laboratories of the exam: each session has one of its own, drawn at random."""

from __future__ import annotations

import numpy as np

from capsbayes.evidence.blind.lab import Lab, Noise

_HALF_WIDTHS, _HALF_WIDTH_ERRORS = (15e-6, 30e-6), (0.004, 0.015)
_VISCOSITIES, _VISCOSITY_ERRORS = (0.3, 1.5), (0.01, 0.04)
_VELOCITIES, _FLOW_RATES, _REACH = (2.5e-3, 6e-3), (3, 6), (1.6, 2.2)
_FLOW_RATE_ERRORS, _STATED = (0.005, 0.02), 0.5  # and the share of the labs that state flow rates
_SPREADS, _CAPSULES = (0.08, 0.2), (24, 48)
_MIDDLE = 0.058  # Ca of the median capsule at the middle flow rate, in the middle of the simulated ones
_SCALES, _LENGTHS, _POINTS = (0.006, 0.015), (0.1, 0.3), (32, 64)
_MISSTATED = (0.5, 2.0)  # true over stated amplitude, and likewise of the correlation length
_TAILS = (None, None, 5.0)  # degrees of freedom of the errors of whole capsules, as likely each


def in_words() -> str:
    """Say between which ends the laboratories are drawn."""
    microns, percent = ([scale * end for end in ends] for scale, ends in ((1e6, _HALF_WIDTHS), (100.0, _SPREADS)))
    return (
        f"half widths of {microns[0]:g} to {microns[1]:g} um, {_FLOW_RATES[0]} to {_FLOW_RATES[1] - 1} flow rates, "
        f"{_CAPSULES[0]} to {_CAPSULES[1] - 1} capsules, G_s that scatters by {percent[0]:.0f} to {percent[1]:.0f} %, "
        f"and stated errors of the edges of {_SCALES[0]:g} to {_SCALES[1]:g} l"
    )


def drawn_lab(rng: np.random.Generator, *, flow_rates: bool | None = None) -> tuple[Lab, int]:
    """Draw a laboratory and the number of its capsules; half of the labs state flow rates, or all, or none."""
    # The kernel of the errors along the outline, their amplitude and their correlation length are not those that the
    # lab states, and of a third of the labs they have heavy tails.
    half_width, viscosity, middle = (_log_uniform(rng, ends) for ends in (_HALF_WIDTHS, _VISCOSITIES, _VELOCITIES))
    reach = rng.uniform(*_REACH)
    velocities = np.geomspace(middle / np.sqrt(reach), middle * np.sqrt(reach), int(rng.integers(*_FLOW_RATES)))
    stated = bool(rng.random() < _STATED) if flow_rates is None else flow_rates
    flow_rate_error = float(rng.uniform(*_FLOW_RATE_ERRORS))
    viscosity_error = float(rng.uniform(*_VISCOSITY_ERRORS))
    lab = Lab(
        half_width=half_width,
        half_width_error=half_width * float(rng.uniform(*_HALF_WIDTH_ERRORS)),
        viscosity=viscosity,
        viscosity_error=viscosity * viscosity_error,
        viscosity_stated=float(rng.normal(1.0, viscosity_error)),
        mean_velocities=tuple(float(velocity) for velocity in velocities),
        surface_shear_modulus=viscosity * middle / _MIDDLE,
        spread=float(rng.uniform(*_SPREADS)),
        noise=drawn_noise(rng),
        flow_rate_error=flow_rate_error if stated else None,
    )
    return lab, int(rng.integers(*_CAPSULES))


def drawn_noise(rng: np.random.Generator) -> Noise:
    """Draw errors of measurement that differ from what is stated of them."""
    return Noise(
        scale=float(rng.uniform(*_SCALES)),
        correlation_length=float(rng.uniform(*_LENGTHS)),
        velocity=float(rng.uniform(*_FLOW_RATE_ERRORS)),
        understated=_log_uniform(rng, _MISSTATED),
        freedom=_TAILS[int(rng.integers(len(_TAILS)))],
        points=int(rng.integers(*_POINTS)),
        kernel=("exponential", "squared exponential")[int(rng.integers(2))],
        longer=_log_uniform(rng, _MISSTATED),
    )


def _log_uniform(rng: np.random.Generator, ends: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(ends))))
