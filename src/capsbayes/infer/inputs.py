"""The inputs that carry an error besides the lengths: viscosity, half width and velocity of the capsule.

Each is positive. ``mean +/- error`` is a normal distribution cut at zero;
any other frozen distribution is tabulated once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer.log_grid import CELLS_PER_SD, LogGrid
from capsbayes.measurement import Measurement

__all__ = ["LOOSEST_VELOCITY", "Input", "Inputs"]

Floats = NDArray[np.float64]

_REACH = 8.0  # standard deviations on either side that a grid covers
_TAIL = 1e-9  # mass beyond either end of the table of a general distribution
_TABLE = 4001
LOOSEST_VELOCITY = 0.25


@dataclass(frozen=True, eq=False)
class Input:
    """One positive input.

    Parameters
    ----------
    name : str
        As in `capsbayes.parameters`.
    centre : float
        The value if known, else the mean.
    error : float
        Standard deviation, zero if known.
    table : tuple of two (k,) arrays, optional
        Values and log density of a distribution that is not normal.
    """

    name: str
    centre: float
    error: float
    table: tuple[Floats, Floats] | None = None

    @classmethod
    def of(cls, name: str, value: Any) -> Input:
        """Read a number (known) or a frozen distribution of `scipy.stats` (uncertain)."""
        if not hasattr(value, "logpdf"):
            return cls(name, float(value), 0.0)
        if _is_cut_normal(value):
            return cls(name, float(value.kwds["loc"]), float(value.kwds["scale"]))
        low, high = max(value.ppf(_TAIL), np.finfo(float).tiny), value.isf(_TAIL)
        grid = np.linspace(low, high, _TABLE)
        return cls(name, float(value.mean()), float(value.std()), (grid, value.logpdf(grid)))

    @property
    def known(self) -> bool:
        """True for a number without error."""
        return self.error == 0.0

    def narrowed(self, factor: float) -> Input:
        """The same input with its error multiplied by a factor below one, about the same mean."""
        table = self.table
        if table is not None:
            table = (self.centre + factor * (table[0] - self.centre), table[1])
        return replace(self, error=factor * self.error, table=table)

    def log_density(self, values: Floats) -> Floats:
        """Log of the density up to a constant, -inf where it vanishes : (n,) array."""
        if self.table is not None:
            return np.interp(values, *self.table, left=-np.inf, right=-np.inf)
        with np.errstate(invalid="ignore"):
            return np.where(values > 0.0, -0.5 * ((values - self.centre) / self.error) ** 2, -np.inf)

    def on_log_grid(self, power: int) -> LogGrid:
        """Distribution with its density multiplied by x^power, on a grid of log x."""
        if power not in self._laid_out:
            self._laid_out[power] = self._lay_out(power)
        return self._laid_out[power]

    @cached_property
    def _laid_out(self) -> dict[int, LogGrid]:
        return {}

    def _lay_out(self, power: int) -> LogGrid:
        if self.known:
            return LogGrid.known(self.centre)
        low, high = self._range()
        wide = float(np.log(high / low))
        cells = int(np.ceil(max(wide * self.centre / self.error, 2.0 * _REACH) * CELLS_PER_SD))
        step = wide / cells
        logs = np.log(low) + step * (np.arange(cells) + 0.5)
        values = np.exp(logs)
        density = self.log_density(values) + (power + 1.0) * logs  # one power more from dx = x dlog x
        masses = np.exp(density - density.max())
        masses /= masses.sum()
        mean = float(masses @ logs)
        return LogGrid(float(logs[0]), step, masses, mean, float(masses @ (logs - mean) ** 2))

    def _range(self) -> tuple[float, float]:
        if self.table is not None:
            return float(self.table[0][0]), float(self.table[0][-1])
        high = self.centre + _REACH * self.error
        return max(self.centre - _REACH * self.error, 1e-4 * self.centre), high


@dataclass(frozen=True, eq=False)
class Inputs:
    """The inputs of one capsule beside its lengths."""

    viscosity: Input
    half_width: Input
    capsule_velocity: Input

    @classmethod
    def of(cls, measurement: Measurement, experiment: Experiment) -> Inputs:
        """Gather them from what was measured and what is known of the experiment."""
        return cls.of_experiment(experiment).with_velocity_of(measurement)

    @classmethod
    def of_experiment(cls, experiment: Experiment) -> Inputs:
        """Those that many capsules share; the velocity is still that of none."""
        viscosity, width = Input.of("viscosity", experiment.viscosity), Input.of("half_width", experiment.half_width)
        return cls(viscosity, width, Input("capsule_velocity", np.nan, 0.0))

    def with_velocity_of(self, measurement: Measurement) -> Inputs:
        """The same viscosity and half width with the velocity of a capsule.

        Raises
        ------
        InputError
            If nothing was measured, or the velocity hardly: its flow could then be arbitrarily slow.
        """
        if not measurement.status.ok:
            where = measurement.source or "measurement"
            raise InputError(where, "status", "a measurement that ended as it should", str(measurement.status))
        if measurement.capsule_velocity_error > LOOSEST_VELOCITY * measurement.capsule_velocity:
            where, share = measurement.source or "measurement", LOOSEST_VELOCITY
            got = f"{measurement.capsule_velocity_error / measurement.capsule_velocity:.0%}"
            raise InputError(where, "capsule_velocity", f"a standard error below {share:.0%} of the velocity", got)
        velocity = Input("capsule_velocity", measurement.capsule_velocity, measurement.capsule_velocity_error)
        return replace(self, capsule_velocity=velocity)


def _is_cut_normal(value: Any) -> bool:
    """Whether a frozen distribution is a normal cut at zero and nowhere else."""
    if value.dist.name != "truncnorm" or len(value.args) != 2 or set(value.kwds) != {"loc", "scale"}:
        return False
    (low, high), centre, error = value.args, value.kwds["loc"], value.kwds["scale"]
    return bool(high == np.inf and abs(centre + low * error) <= 1e-9 * abs(centre))
