"""The exact engine: a grid over (log Ca, a/l), refined around the posterior until the cells resolve it.

Viscosity and velocity of the capsule are integrated out exactly, and so is the half width where the lengths are over l;
where they are in metres it is a third dimension of the grid. On a smooth density the sum over the centres of the cells
converges faster than any power of their size once a standard deviation spans a cell, so a few cells suffice for the
printed digits.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_dilation

from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError, NoShapeError
from capsbayes.experiment import Experiment
from capsbayes.infer.checks import Gate
from capsbayes.infer.density import PosteriorDensity, dilation_of
from capsbayes.infer.grid import COARSE_DROP, CoarseTable, GridPosterior, Nodes, Window
from capsbayes.infer.likelihood import LengthsLikelihood, ModelAtPoints, resolution
from capsbayes.infer.outline import AnyOutline, outline_likelihood
from capsbayes.infer.prior import Inputs, Prior, check_coordinates
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS

Resolution = tuple[list[Gate], list[Gate]]  # along log Ca, along a/l

FARTHEST = 5.0  # standard deviations from the nearest shape of the model, beyond which a measurement is refused
CELLS_PER_SD = 4.0  # of both marginals
CELLS_PER_FEATURE = 1.5  # of both marginals: each mode of several, a steep flank
CELLS_ACROSS = 1.0  # of a/l at given Ca: across a ridge
PARTS_AT_BORDER = 4  # along each side of a cell that the border of the domain cuts
_FIRST, _THEN, _LARGEST = 32, 56, 1024
DROP = 17.0  # of the log density, within which cells of a grid finer than the coarse table carry a posterior
AT_BORDER = 1e-4  # of the largest density: cells at the border of the domain that carry more are cut smaller
_VISITED_DROP = 21.0  # within which cells are visited: nodes with 1e-9 of the largest probability are kept
_EDGE_DROP = 12.0  # at the edge of a window: less than 1e-5 is cut off there
_ROUNDS = 12
_FINER = 3.0  # at most from window to window with an outline, where each node is costly and most lie off the posterior
_CONTRADICTED = 600.0  # of the log density, by which priors lower it at every shape: near the smallest float
_TAIL = 1e-6  # of a prior that is no range, beyond either end of where it holds shapes
_PILOTS = 2, 5  # fewest and most shapes at which the covariance of an outline is computed, one after the other
_SETTLED = 1.0  # standard deviations of log Ca or a/l between pilot and likeliest shape, up to which it suffices
_NARROWINGS, _NARROWER = 3, 0.7  # of a lattice to where the priors hold shapes: at most, while its cells get this small
UNSEEN = LengthsLikelihood(1.0, None, 1e6, 0.0, 0.0, over_half_width=True)  # L_z within a thousand l: any
_WIDTHS = (33, 129)  # fewest and most nodes of the half width
_WIDTH_REACH = 5.5  # standard deviations of l on either side


class Quadrature:
    """Engine for many capsules of one model and one experiment."""

    def __init__(self, model: ForwardModel, experiment: Experiment, prior: Prior | None = None) -> None:
        self.model, self.experiment, self.prior = model, experiment, prior or Prior()
        check_coordinates(model, self.prior)
        self.table = CoarseTable.of(model)
        self.inputs = Inputs.of_experiment(experiment)
        # shapes, the same for all that no prior excludes, by whether the flow rate alone tells U
        self._predicted: dict[bool, tuple[ModelAtPoints, Floats]] = {}

    def __call__(
        self,
        measurement: Measurement,
        *,
        inputs: Inputs | None = None,
        error_scale: float = 1.0,
        outline: AnyOutline | None = None,
    ) -> GridPosterior:
        """Compute the posterior of one capsule."""
        inputs = inputs or self.inputs.with_velocity_of(measurement)
        density = PosteriorDensity.of(measurement, inputs, self.prior, error_scale, dilation=dilation_of(self.model))
        check_shape(self.model, measurement, with_error_of_half_width(density), self.table.nodes)
        window = self._first_window(measurement, density)
        if measurement.outline is None:
            return self._refined(window, density)
        if outline is not None:
            return self._refined(window, replace(density, outline=outline))
        seen, length = measurement.outline, measurement.length_with_outline
        posterior = self._on(window, window.nodes(self.model, density), density, None)
        least, most = _PILOTS
        for number in range(1, most + 1):
            there = posterior.likeliest
            theta = dict(zip(("capillary_number", "size_ratio"), there, strict=True))
            pilot = outline_likelihood(self.model, seen, theta, error_scale, length=length)
            posterior = self._refined(posterior.window, replace(density, outline=pilot))
            if number >= least and _farthest_off(posterior, there) <= _SETTLED:
                break
        return posterior

    def predicted_shapes(self, density: PosteriorDensity) -> tuple[ModelAtPoints, Floats]:
        """Return shapes that the priors and the velocity of a capsule predict, and the logs of their probabilities."""
        # Neither the lengths nor a flow rate next to a velocity are read. Covariances are widened as those of a
        # `CoarseTable`.
        by_rate = density.inputs.by_flow_rate
        if density.flow_rate is not None and not by_rate:
            density = replace(density, inputs=density.inputs.first_source)
        nodes = self.table.nodes
        everywhere = isinstance(  # no prior excludes a shape
            density.log_share(nodes.model, nodes.log_ca, nodes.size), float
        )
        if everywhere and by_rate in self._predicted:
            return self._predicted[by_rate]
        table, unseen = self.table, replace(density, likelihood=UNSEEN, outline=None)
        for _ in range(_NARROWINGS):
            narrower = table.window.around(table.carried(_log_density(table, unseen)), table.window.shape, table.window)
            if np.prod(narrower.step) > _NARROWER * np.prod(table.window.step):
                break
            table = CoarseTable.on(narrower, self.model)
        logs = _log_density(table, unseen) + np.log(np.prod(table.window.step))
        inside = np.isfinite(logs)
        found = table.nodes.model.taken(inside), logs[inside]
        if everywhere:
            self._predicted[by_rate] = found
        return found

    def _refined(self, window: Window, density: PosteriorDensity) -> GridPosterior:
        """Compute the posterior on a window that contains and resolves it."""
        widths = _half_widths(density) if density.shape_depends_on_half_width else None
        first, likely = window, None
        for _ in range(_ROUNDS):
            visited = None if likely is None else _over(likely, first, window)
            posterior = self._on(window, window.nodes(self.model, density, visited), density, widths)
            if likely is None and widths is None and density.outline is None:
                wide = CoarseTable.widened(window, posterior.nodes)
                likely = np.ones((window.shape[0] + 2, window.shape[1] + 2), dtype=bool)
                likely[1:-1, 1:-1] = _spread(wide.carried(_log_density(wide, density), _VISITED_DROP))
            along = _resolution(posterior)
            better = _better_window(posterior, along, self.table.window)
            if better is None:
                break
            window = better
        whole = _whole(posterior, self.table.window)
        cut = _cut_cells(posterior)
        if cut is not None:
            nodes = posterior.window.split(posterior.nodes, cut, PARTS_AT_BORDER, self.model, density)
            posterior = self._on(posterior.window, nodes, density, widths)
        return replace(posterior, gates=(*(gate for gates in along for gate in gates), whole))

    def _first_window(self, measurement: Measurement, density: PosteriorDensity) -> Window:
        rough = with_error_of_half_width(density)
        log_density = log_density_in(self.prior, rough, self.table.nodes, measurement.source or "prior")
        return self.table.window.around(self.table.carried(log_density), (_FIRST, _FIRST), self.table.window)

    def _on(
        self, window: Window, nodes: Nodes, density: PosteriorDensity, widths: tuple[Floats, Floats] | None
    ) -> GridPosterior:
        """Compute the posterior on given nodes."""
        points, half_width = nodes.model, None if widths is None else widths[0][:, None]
        log_density = density.log_density(points, nodes.log_ca, nodes.size, half_width)
        if widths is not None:
            log_density = log_density + np.log(widths[1])[:, None]
        free = np.exp(log_density - np.nanmax(log_density))
        free[np.isnan(free)] = 0.0  # nan_to_num takes five times as long
        free = free * nodes.side**2
        share = np.nan_to_num(np.exp(density.log_share(points, nodes.log_ca, nodes.size, half_width)))
        return GridPosterior(
            self.model,
            density,
            window,
            nodes,
            None if widths is None else widths[0],
            free.reshape(-1, len(nodes.size)),
            share,
            (),
        )


def with_error_of_half_width(density: PosteriorDensity) -> PosteriorDensity:
    """Return the density with the error of the half width in the covariance of the lengths: an approximation."""
    if density.likelihood.over_half_width:
        return density
    width = density.inputs.half_width
    return replace(density, likelihood=density.likelihood.with_half_width(width.value, width.error))


def check_shape(model: ForwardModel, measurement: Measurement, density: PosteriorDensity, nodes: Nodes) -> None:
    """Refuse lengths that lie far from those of every shape of the model."""
    distance = density.likelihood.distance(nodes.model)
    nearest = int(np.nanargmin(distance))
    if distance[nearest] <= FARTHEST:
        return
    scale = 1.0 if measurement.over_half_width else density.inputs.half_width.value
    lengths = [("L_z", measurement.axial_extent, nodes.model.extent[nearest])]
    if measurement.axial_length is not None:
        lengths.append(("L_a", measurement.axial_length, nodes.model.length[nearest]))
    nearest_lengths = ", ".join(f"{symbol}/l = {of_model:.3f}" for symbol, _, of_model in lengths)
    error = NoShapeError(
        measurement.source or "measurement",
        "axial_extent, axial_length" if len(lengths) > 1 else "axial_extent",
        f"a shape that a case of {model.name} has (nearest: {nearest_lengths}"
        f" at Ca = {np.exp(nodes.log_ca[nearest]):.3g}, a/l = {nodes.size[nearest]:.3g})",
        ", ".join(f"{symbol}/l = {seen / scale:.3f}" for symbol, seen, _ in lengths)
        + f", {distance[nearest]:.0f} standard errors away",
    )
    error.distance = float(distance[nearest])
    raise error


def log_density_in(prior: Prior, density: PosteriorDensity, nodes: Nodes, where: str) -> Floats:
    """Return the log of the posterior density at nodes; refuse priors that hold no shape with the measured lengths."""
    at = nodes.model, nodes.log_ca, nodes.size
    of_lengths = density.log_density(*at)
    both = np.asarray(of_lengths + density.log_share(*at))
    if not np.nanmax(both) > np.nanmax(of_lengths) - _CONTRADICTED:
        raise _no_shape_in(prior, density, nodes, where)
    return both


def _no_shape_in(prior: Prior, density: PosteriorDensity, nodes: Nodes, where: str) -> InputError:
    """Return the refusal of a prior that holds no shape with the measured lengths; it names the bound in the way."""
    lengths = density.likelihood.log_density(nodes.model)
    likely = lengths > np.nanmax(lengths) - COARSE_DROP
    inputs, ratio = density.inputs, nodes.model.velocity_ratio[likely]
    tension = inputs.viscosity.value * inputs.mean_velocity(ratio)
    found = {
        "surface_shear_modulus": tension / np.exp(nodes.log_ca[likely]),
        "capsule_radius": inputs.half_width.value * nodes.size[likely],
    }
    advice = "check the units of half width, viscosity and velocity, or widen the prior"
    for (name, values), limits in zip(found.items(), prior.both, strict=True):
        known = PARAMETERS[name]
        ends = (limits.low, limits.high) if limits.is_range else limits.ppf([_TAIL, 1.0 - _TAIL]).tolist()
        low, high, first, last = map(known.shown, (*ends, values.min(), values.max()))
        for end, bound, beyond in (("lower", low, last < low), ("upper", high, first > high)):
            if beyond:
                expected = (
                    f"{known.symbol} from {first:.4g} to {last:.4g} {known.shown_unit}, as shapes of these lengths have"
                )
                got = f"{bound:.4g} {known.shown_unit} as the {end} end of its prior"
                got = got if limits.is_range else f"the prior {limits.shown(name)}"
                return InputError(where, f"prior.{name}", expected, got, advice)
    expected = "priors that hold G_s and a of some shape with these lengths"
    return InputError(where, "prior", expected, "priors that hold none", advice)


def _log_density(table: CoarseTable, density: PosteriorDensity) -> Floats:
    """Return the log posterior density at the nodes of a table."""
    return density.log_of_nodes(table.nodes.model, table.nodes.log_ca, table.nodes.size)


def _over(likely: Booleans, first: Window, window: Window) -> Booleans:
    """Return the cells of a window whose middles lie in the likely cells of the first one : (i, j) array."""
    # `likely` has one more cell on each side, for what lies beyond.
    rows, columns = (
        np.clip((axis - low) / step + 1.0, 0.0, count + 1.0).astype(int)
        for axis, low, step, count in zip(window.axes, first.low, first.step, first.shape, strict=True)
    )
    return likely[rows[:, None], columns]


def _half_widths(density: PosteriorDensity) -> tuple[Floats, Floats]:
    """Return nodes of l, so close that the shape changes by less than its error between them, and their masses."""
    masses, likelihood = density.half_width, density.likelihood
    sd = float(np.sqrt(masses.variance))
    relative_error = np.sqrt(likelihood.zz) / likelihood.extent
    count = int(np.clip(np.ceil(2.0 * _WIDTH_REACH * sd / relative_error), *_WIDTHS))
    masses = masses.resampled(2.0 * _WIDTH_REACH * sd / count)
    kept = masses.masses > 1e-9 * masses.masses.max()
    return np.exp(masses.logs[kept]), masses.masses[kept]


def _better_window(posterior: GridPosterior, resolution: Resolution, bounds: Window) -> Window | None:
    """Return a window that resolves the posterior better, or None if this one suffices."""
    window = posterior.window
    both = posterior.of_cells.max(axis=0)
    likely = both > np.exp(-DROP) * both.max()
    peak = np.unravel_index(int(both.argmax()), both.shape)
    for k, index in enumerate(map(int, peak)):
        low, high = window.open_ends(bounds, k)
        if (low and index <= 1) or (high and index >= window.shape[k] - 2):
            return window.wider(bounds, (_THEN, _THEN))
    if all(gate.passed for gates in (*resolution, [_whole(posterior, bounds)]) for gate in gates):
        return None
    around = window.around(likely, (_THEN, _THEN), bounds)
    needed = [max(gate.least / max(gate.value, 1e-3) for gate in gates) for gates in resolution]
    # a narrower window has smaller cells already; more cells only as far as these do not suffice
    most = np.inf if posterior.density.outline is None else _FINER
    shape = []
    for k in (0, 1):
        shrink = (around.high[k] - around.low[k]) / (window.high[k] - window.low[k])
        cells = window.shape[k] * shrink * (min(1.15 * needed[k], most) if needed[k] > 1.0 else 1.0)
        shape.append(int(np.clip(np.ceil(cells), _THEN, _LARGEST)))
    better = Window(around.low, around.high, (shape[0], shape[1]))
    return None if better == window else better


def _resolution(posterior: GridPosterior) -> Resolution:
    """Return the gates on the size of the cells, along log Ca and along a/l, of a window that is not split."""
    ca, size = resolution(posterior.of_cells)
    return (
        [
            _gate("standard deviation of log Ca", ca[0], CELLS_PER_SD),
            _gate("feature of log Ca", ca[1], CELLS_PER_FEATURE),
        ],
        [
            _gate("standard deviation of a/l", size[0], CELLS_PER_SD),
            _gate("feature of a/l", size[1], CELLS_PER_FEATURE),
            _gate("standard deviation of a/l at given Ca", size[2], CELLS_ACROSS),
        ],
    )


def _farthest_off(posterior: GridPosterior, there: tuple[float, float]) -> float:
    """Return the distance of the likeliest shape from another, along log Ca or a/l, in standard deviations."""
    weights = posterior.weights.sum(axis=0)
    nodes, (ca, size) = posterior.nodes, posterior.likeliest
    off = []
    for values, here, other in ((nodes.log_ca, np.log(ca), np.log(there[0])), (nodes.size, size, there[1])):
        mean = weights @ values / weights.sum()
        off.append(abs(here - other) / np.sqrt(weights @ (values - mean) ** 2 / weights.sum()))
    return float(max(off))


def _gate(what: str, value: float, least: float) -> Gate:
    return Gate(f"cells in a {what}", value, least=least)


def _cut_cells(posterior: GridPosterior) -> Booleans | None:
    """Return the cells next to the border of the domain : (i, j) bool array, or None if they carry no density."""
    out = np.isnan(posterior.nodes.model.extent)
    if not out.any():
        return None
    outside, inside = np.zeros((2, *posterior.window.shape), dtype=bool)
    outside.ravel()[posterior.nodes.cell], inside.ravel()[posterior.nodes.cell] = out, ~out
    cut = _spread(outside) & _spread(inside)
    density = posterior.of_cells.max(axis=0)
    return cut if np.max(density, where=cut, initial=0.0) > AT_BORDER * density.max() else None


def _spread(cells: Booleans) -> Booleans:
    """Return the cells and their eight neighbours."""
    return binary_dilation(cells, np.ones((3, 3), dtype=bool))


def _whole(posterior: GridPosterior, bounds: Window) -> Gate:
    """Return the gate on the density at those ends of a window, not split, that are no ends of the domain."""
    window = posterior.window
    both = posterior.of_cells.max(axis=0)
    found = [0.0]
    for k in (0, 1):
        low, high = window.open_ends(bounds, k)
        found += [float(both.take(end, axis=k).max()) for end, is_open in ((0, low), (-1, high)) if is_open]
    share = max(found) / float(both.max())
    return Gate("density at an end of the grid over the largest", share, most=float(np.exp(-_EDGE_DROP)))
