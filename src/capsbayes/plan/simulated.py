"""Identification of simulated measurements, to check predicted widths."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer.grid.quadrature import Quadrature
from capsbayes.infer.prior import Prior
from capsbayes.model import ForwardModel
from capsbayes.plan.expectation import Draws, Expectation
from capsbayes.plan.lab_errors import LabErrors, root_of
from capsbayes.plan.widths import check_model, width_of
from capsbayes.quantity import Given

_LOST = 20  # capsules without a shape for each that has one, beyond which the search is given up


@dataclass(frozen=True, eq=False)
class SimulatedWidths:
    """Posteriors of simulated capsules."""

    relative: Floats  # (n,): half of the 68 % interval of G_s over its median
    sd: Floats  # (n,): standard deviation of log G_s
    within: Booleans  # (n,): whether the 68 % interval holds the true G_s
    without_shape: int  # further capsules that were drawn and for which the model has no shape
    refused: int  # further capsules whose measurement no shape of the model has
    seed: int

    @property
    def mean(self) -> float:
        """Mean width."""
        return float(np.mean(self.relative))

    @property
    def standard_error(self) -> float:
        """Standard error of the mean width; NaN for a single capsule."""
        count = len(self.relative)
        return float(np.std(self.relative, ddof=1) / np.sqrt(count)) if count > 1 else float("nan")

    def as_dict(self) -> dict[str, float | int | None]:
        """Return a summary for files."""
        return {
            "capsules": len(self.relative),
            "relative": self.mean,
            "standard_error": self.standard_error if len(self.relative) > 1 else None,
            "within_68": float(self.within.mean()),
            "without_shape": self.without_shape,
            "refused": self.refused,
            "seed": self.seed,
        }


def simulated_widths(
    surface_shear_modulus: Given,
    capsule_radius: Given,
    experiment: Experiment,
    errors: LabErrors,
    model: ForwardModel,
    *,
    mean_velocity: float,
    count: int,
    seed: int,
    prior: Prior | None = None,
) -> SimulatedWidths:
    """Draw capsules at one velocity of the flow, measure them with errors, and identify them by quadrature."""
    # Capsules, liquid and channel are drawn as they are expected. The model is wrong by as much as it says: its own
    # error is drawn too.
    check_model(model, experiment)
    expectation, rng = Expectation.of(surface_shear_modulus, capsule_radius, experiment), np.random.default_rng(seed)
    engine = Quadrature(model, experiment, prior)
    found: list[tuple[float, float, bool]] = []
    without_shape = refused = 0
    with threadpool_limits(limits=1):
        while len(found) < count:
            if without_shape + refused > _LOST * (len(found) + 10):
                expected = f"a velocity at which {model.name} has a shape of such capsules"
                raise InputError("simulated_widths", "mean_velocity", expected, f"{mean_velocity:g} m/s")
            drawn = expectation.drawn(rng, 1)
            lengths = _lengths(drawn, model, mean_velocity, errors, rng)
            if lengths is None:
                without_shape += 1
                continue
            with contextlib.suppress(InputError):
                posterior = engine(errors.measured(*lengths))
                width, interval = width_of(posterior), posterior.marginal("surface_shear_modulus")
                truth = float(drawn.surface_shear_modulus[0])
                found.append((width.relative, width.sd, interval.contains(truth, level=68)))
                continue
            refused += 1
    relative, sd, within = (np.array(column) for column in zip(*found, strict=True))
    return SimulatedWidths(relative, sd, within, without_shape, refused, seed)


def _lengths(
    capsule: Draws, model: ForwardModel, mean_velocity: float, errors: LabErrors, rng: np.random.Generator
) -> tuple[Floats, float] | None:
    """Draw lengths and velocity as measured; None where the model has no such capsule."""
    there = model({"capillary_number": capsule.capillary_number(mean_velocity), "size_ratio": capsule.size_ratio})
    if not there.inside[0]:
        return None
    extent, length, ratio = there.values[0, :3] + root_of(there.covariance[0]) @ rng.standard_normal(3)
    seen = np.array([extent, length]) * (1.0 if errors.over_half_width else capsule.half_width[0])
    noise = errors.covariance
    seen[: len(noise)] += root_of(noise) @ rng.standard_normal(len(noise))
    return seen, float(ratio * mean_velocity * (1.0 + errors.capsule_velocity * rng.standard_normal()))
