"""Selection of stretched capsules: the probability that a capsule of a population is kept.

A cut on Lambda, as the published 1.04 below which the deterministic procedure fails, keeps the soft and the large
ones. If the likelihood ignores it, a population looks softer than it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr

from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.infer.many.population import Population
from capsbayes.infer.many.tabulated.pyramid import COLUMNS, Pyramid

_FLOWS = 16  # groups of capsules of like velocity
_SLOPE = 4  # cells of log Ca on either side over which the rise of Lambda is taken
_EVERY = 8  # columns of a/l: those between them hardly differ
_LEAST_SHARE = 1e-12
_NEAR = 0.05  # of Lambda from the cut: capsules whose errors give its sharpness


def kept_rows(population: Population, least: float) -> Booleans:
    """Return where the median Lambda is above the cut : (n,) array, False for capsules without a result."""
    with np.errstate(invalid="ignore"):
        return population["stretch_ratio_median"] > least


@dataclass(frozen=True, eq=False)
class Selection:
    """A cut on the median of Lambda.

    Parameters
    ----------
    least : float
        Smallest Lambda that was kept.
    error : float
        Standard error of Lambda near the cut.
    mean_velocity : (f,) array [m/s]
        Of groups of the capsules kept.
    number : (f,) array
        Capsules in each.
    viscosity, half_width : float [Pa s], [m]
    pyramid : Pyramid
        Whose Lambda is read.
    """

    least: float
    error: float
    mean_velocity: Floats
    number: Floats
    viscosity: float
    half_width: float
    pyramid: Pyramid

    @classmethod
    def of(
        cls, population: Population, least: float, pyramid: Pyramid, viscosity: float, half_width: float
    ) -> Selection:
        """Return the selection with velocities and errors of a population.

        Raises
        ------
        InputError
            If no capsule is left.
        """
        kept = kept_rows(population, least)
        if not kept.any():
            raise InputError("selection", "least", "a Lambda that some capsule exceeds", f"{least:g}")
        velocity = np.sort(population["mean_velocity_median"][kept])
        groups = np.array_split(velocity, min(_FLOWS, len(velocity)))
        known = np.isfinite(population["stretch_ratio_median"])
        away = np.abs(population["stretch_ratio_median"][known] - least)
        errors = population["stretch_ratio_sd"][known]
        near = away <= max(_NEAR, float(away.min()))
        return cls(
            least,
            float(np.median(errors[near])),
            np.array([np.exp(np.log(group).mean()) for group in groups]),
            np.array([len(group) for group in groups], dtype=float),
            viscosity,
            half_width,
            pyramid,
        )

    @cached_property
    def _limits(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Edges of cells of log(a/l) (k + 1,), and for each cell log Ca at the cut, its error, and log Ca at the limit.

        A capsule is kept if its Ca lies between the two: Lambda grows with Ca, and beyond the limit there is no shape.
        """
        window, table = self.pyramid.window, self.pyramid.levels[-1][..., COLUMNS.index("log_stretch_ratio")]
        table = table[:, _EVERY // 2 :: _EVERY]
        rows, columns = table.shape
        step = (window.high[0] - window.low[0]) / rows
        log_ca = window.low[0] + step * (np.arange(rows) + 0.5)
        edges = np.log(np.linspace(window.low[1], window.high[1], columns + 1))
        cut, error, limit = (np.full(columns, np.inf), np.ones(columns), np.full(columns, -np.inf))
        for column, stretch in enumerate(np.exp(table.T)):
            known = np.flatnonzero(np.isfinite(stretch))
            if not len(known):
                continue
            limit[column] = log_ca[known[-1]] + 0.5 * step
            above = known[stretch[known] > self.least]
            if not len(above):
                continue
            first = int(above[0])
            cut[column] = log_ca[first] - 0.5 * step
            ahead, behind = min(first + _SLOPE, int(known[-1])), max(first - _SLOPE, int(known[0]))
            rise = (stretch[ahead] - stretch[behind]) / max((ahead - behind) * step, step)
            error[column] = np.clip(self.error / max(rise, 1e-6), 0.5 * step, 1.0)
        return edges, cut, error, limit

    def log_probability(self, parameters: Floats) -> Floats:
        """Return the log probability that all capsules are kept, for some populations : (d, 5) -> (d,) array."""
        edges, cut, error, limit = self._limits
        log_flow = np.log(self.viscosity * self.mean_velocity)[:, None]
        middle = 0.5 * (edges[1:] + edges[:-1]) + np.log(self.half_width)
        logs = np.empty(len(parameters))
        for d, (x, y, log_spread, log_radius_spread, slope) in enumerate(parameters):
            spread, of_radius = np.exp(log_spread), np.exp(log_radius_spread)
            mass = np.diff(ndtr((edges + np.log(self.half_width) - y) / of_radius))
            mean = x + slope * (middle - y)
            softest = ndtr((log_flow - limit - mean) / spread)
            kept = ndtr((log_flow - cut - mean) / np.hypot(spread, error)) - softest
            share = np.maximum(kept, 0.0) @ mass
            logs[d] = self.number @ np.log(np.maximum(share, _LEAST_SHARE))
        return logs
