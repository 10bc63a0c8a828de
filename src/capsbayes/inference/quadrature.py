"""The exact engine: a grid over (log Ca, a/l), refined around the posterior until it is resolved.

Viscosity and velocity of the capsule are integrated out exactly, and so is
the half width where the lengths are over l; where they are in metres it is a
third dimension of the grid. On a smooth density the sum over the centres of
the cells converges faster than any power of their size once a standard
deviation spans a cell, so a few cells suffice for the printed digits.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.inference.checks import Gate
from capsbayes.inference.grid_posterior import GridPosterior
from capsbayes.inference.inputs import Inputs
from capsbayes.inference.lattice import CoarseTable, Window
from capsbayes.inference.prior import Prior
from capsbayes.inference.target import Target
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel

__all__ = ["Quadrature"]

Floats = NDArray[np.float64]

FARTHEST = 5.0  # standard deviations from the nearest shape of the model, beyond which a measurement is refused
CELLS_PER_SD = 4.0  # of both marginals
CELLS_AT_BORDER = 224  # along each side, where the border of the domain cuts cells that matter
THINNEST = 1.0  # standard deviation of a/l at given Ca, in cells
_FIRST, _THEN, _LARGEST = 32, 56, 512
_COARSE_DROP, _DROP = 12.0, 17.0  # of the log density, within which a posterior lives
_EDGE_DROP = 12.0  # at the edge of a window: what is cut off there is below 1e-5
_ROUNDS = 12
_WIDTHS = (33, 129)  # fewest and most nodes of the half width
_WIDTH_REACH = 5.5  # standard deviations of l on either side


class Quadrature:
    """Engine for many capsules of one model and one experiment.

    Parameters
    ----------
    model : ForwardModel
    experiment : Experiment
    prior : Prior, optional

    Examples
    --------
    ``Quadrature(model, experiment)(measurement).marginal("surface_shear_modulus").median``
    """

    def __init__(self, model: ForwardModel, experiment: Experiment, prior: Prior | None = None) -> None:
        self.model, self.experiment, self.prior = model, experiment, prior or Prior()
        self.table = CoarseTable.of(model)

    def __call__(
        self, measurement: Measurement, *, inputs: Inputs | None = None, error_scale: float = 1.0
    ) -> GridPosterior:
        """Posterior of one capsule.

        Parameters
        ----------
        measurement : Measurement
        inputs : Inputs, optional
            In place of those of the measurement and the experiment.
        error_scale : float
            Factor on the model's own standard errors.

        Raises
        ------
        InputError
            If no case of the model has such a shape, or the prior excludes all that have it.
        """
        inputs = inputs or Inputs.of(measurement, self.experiment)
        target = Target.of(measurement, inputs, self.prior, error_scale)
        self.check_shape(measurement, target)
        widths = _half_widths(target) if target.shape_depends_on_half_width else None
        window = self._first_window(measurement, target)
        for _ in range(_ROUNDS):
            posterior = self._on(window, target, widths)
            better = _better_window(posterior, self.table.window)
            if better is None:
                break
            window = better
        return posterior

    @staticmethod
    def gates(posterior: GridPosterior) -> list[Gate]:
        """Whether the grid resolves the posterior."""
        *sds, thin = _resolution(posterior)
        found = {
            "cells in a standard deviation of log Ca": (sds[0], CELLS_PER_SD),
            "cells in a standard deviation of a/l": (sds[1], CELLS_PER_SD),
            "cells in a standard deviation of a/l at given Ca": (thin, THINNEST),
        }
        return [Gate(name, value, f"at least {least:g}", value >= least) for name, (value, least) in found.items()]

    def check_shape(self, measurement: Measurement, target: Target) -> None:
        """Refuse lengths that lie far from every shape of the model."""
        width = target.inputs.half_width
        distance = target.likelihood.with_half_width(width.centre, width.error).distance(self.table.model)
        nearest = np.unravel_index(np.nanargmin(distance), distance.shape)
        if distance[nearest] <= FARTHEST:
            return
        log_ca, size = self.table.window.axes
        scale = 1.0 if measurement.over_half_width else width.centre
        lengths = [("L_z", measurement.axial_extent, self.table.model.extent[nearest])]
        if measurement.axial_length is not None:
            lengths.append(("L_a", measurement.axial_length, self.table.model.length[nearest]))
        nearest_lengths = ", ".join(f"{symbol}/l = {of_model:.3f}" for symbol, _, of_model in lengths)
        raise InputError(
            measurement.source or "measurement",
            "axial_extent, axial_length" if len(lengths) > 1 else "axial_extent",
            f"a shape that a case of {self.model.name} has (nearest: {nearest_lengths}"
            f" at Ca = {np.exp(log_ca[nearest[0]]):.3g}, a/l = {size[nearest[1]]:.3g})",
            ", ".join(f"{symbol}/l = {seen / scale:.3f}" for symbol, seen, _ in lengths)
            + f", {distance[nearest]:.0f} standard errors away",
        )

    def _first_window(self, measurement: Measurement, target: Target) -> Window:
        width = target.inputs.half_width
        rough = replace(target, likelihood=target.likelihood.with_half_width(width.centre, width.error))
        log_ca, size = self.table.window.axes
        args = (self.table.model, np.broadcast_to(log_ca[:, None], (len(log_ca), len(size))), size[None, :])
        log_density = rough.log_density(*args) + rough.log_share(*args)
        if not np.isfinite(np.nanmax(log_density)):
            raise InputError(
                measurement.source or "prior", "prior", "ranges that hold G_s and a of some shape", "ranges without any"
            )
        likely = log_density > np.nanmax(log_density) - _COARSE_DROP
        return self.table.window.around(likely, (_FIRST, _FIRST), self.table.window)

    def _on(self, window: Window, target: Target, widths: tuple[Floats, Floats] | None) -> GridPosterior:
        points, stretch = window.evaluated(self.model, target.error_scale)
        log_ca, size = window.axes
        place = (np.broadcast_to(log_ca[:, None], window.shape), size[None, :])
        nodes = None if widths is None else widths[0][:, None, None]
        log_density = target.log_density(points, *place, nodes)
        if widths is not None:
            log_density = log_density + np.log(widths[1])[:, None, None]
        free = np.nan_to_num(np.exp(log_density - np.nanmax(log_density)), copy=False)
        free = free.reshape(-1, *window.shape)
        share = np.nan_to_num(np.exp(target.log_share(points, *place, nodes)))
        return GridPosterior(
            self.model, target, window, None if widths is None else widths[0], free, share, points, stretch
        )


def _half_widths(target: Target) -> tuple[Floats, Floats]:
    """Nodes of l and their probabilities: close enough that the shape moves by less than its own error between two."""
    masses, likelihood = target.half_width, target.likelihood
    sd = float(np.sqrt(masses.variance))
    relative_error = np.sqrt(likelihood.zz) / likelihood.extent
    count = int(np.clip(np.ceil(2.0 * _WIDTH_REACH * sd / relative_error), *_WIDTHS))
    masses = masses.resampled(2.0 * _WIDTH_REACH * sd / count)
    kept = masses.masses > 1e-9 * masses.masses.max()
    return np.exp(masses.logs[kept]), masses.masses[kept]


def _better_window(posterior: GridPosterior, bounds: Window) -> Window | None:
    """Window that shows the posterior better, or None if this one will do."""
    window, weights = posterior.window, posterior.weights
    both = weights.max(axis=0)
    likely = both > np.exp(-_DROP) * both.max()
    around = window.around(likely, (_THEN, _THEN), bounds)
    sd_ca, sd_size, thin = (max(found, 1e-3) for found in _resolution(posterior))
    needed = [CELLS_PER_SD / sd_ca, max(CELLS_PER_SD / sd_size, THINNEST / thin)]
    least = CELLS_AT_BORDER if _border_shows(posterior) else 0
    leaves = any(_leaves(both > np.exp(-_EDGE_DROP) * both.max(), window, bounds, k) for k in (0, 1))
    if max(needed) <= 1.0 and min(window.shape) >= least and not leaves:
        return None
    # shrinking the window already makes its cells smaller; cut it finer only as far as that does not suffice
    shape = []
    for k in (0, 1):
        shrink = (around.high[k] - around.low[k]) / (window.high[k] - window.low[k])
        cells = window.shape[k] * shrink * (1.15 * needed[k] if needed[k] > 1.0 else 1.0)
        shape.append(int(np.clip(np.ceil(cells), max(_THEN, least), _LARGEST)))
    better = Window(around.low, around.high, (shape[0], shape[1]))
    return None if better == window else better


def _resolution(posterior: GridPosterior) -> tuple[float, float, float]:
    """Standard deviations in cells: of log Ca, of a/l, and of a/l at given Ca (and half width)."""
    weights = posterior.weights
    both = weights.sum(axis=0)
    slices = weights[int(weights.sum(axis=(1, 2)).argmax())]
    return _sd_in_cells(both.sum(axis=1)), _sd_in_cells(both.sum(axis=0)), _thinnest(slices)


def _border_shows(posterior: GridPosterior) -> bool:
    """Whether cells beside the border of the domain carry density: there a cell is either in or out."""
    outside = np.pad(np.asarray(np.isnan(posterior.points.extent)), 1, mode="edge")
    beside = outside[:-2, 1:-1] | outside[2:, 1:-1] | outside[1:-1, :-2] | outside[1:-1, 2:]
    density = posterior.weights.max(axis=0)
    return bool(np.max(density, where=beside, initial=0.0) > 0.01 * density.max())


def _leaves(likely: NDArray[np.bool_], window: Window, bounds: Window, axis: int) -> bool:
    """Whether the posterior goes on beyond an end of the window that is not an end of the domain."""
    index = np.nonzero(likely)[axis]
    first, last = bool(index.min() == 0), bool(index.max() == window.shape[axis] - 1)
    return (first and window.low[axis] > bounds.low[axis]) or (last and window.high[axis] < bounds.high[axis])


def _sd_in_cells(masses: Floats) -> float:
    place = np.arange(len(masses))
    total = masses.sum()
    mean = masses @ place / total
    return float(np.sqrt(masses @ (place - mean) ** 2 / total))


def _thinnest(weights: Floats) -> float:
    """Standard deviation of a/l at given Ca in cells, averaged in square over the posterior of Ca."""
    place = np.arange(weights.shape[1])
    total = weights.sum(axis=1)
    heavy = total > 1e-3 * total.max()
    rows, total = weights[heavy], total[heavy]
    mean = rows @ place / total
    spread = rows @ place**2 / total - mean**2
    return float(np.sqrt(max(total @ spread / total.sum(), 0.0)))
