"""The lattice over (log Ca, a/l) and the posterior on it."""

from __future__ import annotations

import abc
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.infer.checks import Gate
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.likelihood import ModelAtPoints, given_flow
from capsbayes.infer.log_grid import LogGrid, laid
from capsbayes.infer.prior import Marginal
from capsbayes.model import ForwardModel
from capsbayes.status import Status

# Lattices over (log Ca, a/l): the coarse one of a model, which is kept, and the fine one around a posterior.
#
# A window is a rectangle of that plane, cut into cells; the model is evaluated at nodes, the centres of the cells

COARSE_DROP = 12.0  # of the log density, within which cells of a coarse table carry it
_COARSE = (48, 72)


@dataclass(frozen=True, eq=False)
class Nodes:
    """Nodes of the (log Ca, a/l) plane, each the centre of a piece of it, and the predictions of a model there."""

    log_ca: Floats  # (n,): centres
    size: Floats
    side: Floats  # (n,): sides of a piece over those of a cell
    model: ModelAtPoints  # of (n,) arrays, NaN outside the model's domain
    cell: Integers  # (n,): number of the cell of a window, row by row of log Ca; empty without a window

    @classmethod
    def at(
        cls,
        forward: ForwardModel,
        log_ca: Floats,
        size: Floats,
        side: Floats,
        cell: Integers,
        density: PosteriorDensity | None,
    ) -> Nodes:
        """Evaluate a model at centres of pieces: all that a posterior density reads, by default the lengths."""
        theta = {"capillary_number": np.exp(log_ca), "size_ratio": size}
        points = ModelAtPoints.of(forward(theta)) if density is None else density.evaluated(forward, theta)
        return cls(log_ca, size, side, points, cell)

    def taken(self, index: NDArray[np.intp] | Booleans) -> Nodes:
        """Return some of the nodes."""
        cell = self.cell[index] if len(self.cell) else self.cell
        return Nodes(self.log_ca[index], self.size[index], self.side[index], self.model.taken(index), cell)

    def joined(self, other: Nodes) -> Nodes:
        """Return these nodes followed by others."""
        return Nodes(
            np.concatenate([self.log_ca, other.log_ca]),
            np.concatenate([self.size, other.size]),
            np.concatenate([self.side, other.side]),
            self.model.joined(other.model),
            np.concatenate([self.cell, other.cell]),
        )


@dataclass(frozen=True)
class Window:
    """A rectangle of (log Ca, a/l) cut into cells, with a node at the centre of each."""

    low: tuple[float, float]  # (log Ca, a/l)
    high: tuple[float, float]
    shape: tuple[int, int]  # cells along each

    @property
    def step(self) -> tuple[float, float]:
        """Size of a cell."""
        return ((self.high[0] - self.low[0]) / self.shape[0], (self.high[1] - self.low[1]) / self.shape[1])

    @property
    def axes(self) -> tuple[Floats, Floats]:
        """Centres of the cells along log Ca and along a/l."""
        steps = self.step
        return tuple(self.low[k] + steps[k] * (np.arange(self.shape[k]) + 0.5) for k in (0, 1))  # type: ignore[return-value]

    def nodes(
        self, forward: ForwardModel, density: PosteriorDensity | None = None, visited: Booleans | None = None
    ) -> Nodes:
        """Return one node for each cell, or for each of those visited (i, j), row by row of log Ca."""
        log_ca, size = self.axes
        cell = np.arange(len(log_ca) * len(size)) if visited is None else np.flatnonzero(visited)
        row, column = np.divmod(cell, len(size))
        return Nodes.at(forward, log_ca[row], size[column], np.ones(len(cell)), cell, density)

    def split(
        self, nodes: Nodes, cut: Booleans, parts: int, forward: ForwardModel, density: PosteriorDensity | None = None
    ) -> Nodes:
        """Replace the nodes of some cells by those of smaller pieces inside the model's domain."""
        chosen = cut.ravel()[nodes.cell]
        offsets = (np.arange(parts) + 0.5) / parts - 0.5
        log_ca = nodes.log_ca[chosen, None, None] + self.step[0] * offsets[:, None]
        size = nodes.size[chosen, None, None] + self.step[1] * offsets
        log_ca, size = (grid.ravel() for grid in np.broadcast_arrays(log_ca, size))
        sides, cell = np.full(log_ca.size, 1.0 / parts), np.repeat(nodes.cell[chosen], parts**2)
        pieces = Nodes.at(forward, log_ca, size, sides, cell, density)
        return nodes.taken(~chosen).joined(pieces.taken(np.isfinite(pieces.model.extent)))

    def around(self, likely: Booleans, shape: tuple[int, int], bounds: Window) -> Window:
        """Return a window around the likely cells, within bounds, cut anew."""
        # One more cell is added on each side, or a quarter of this window where the likely cells reach its edge and may
        # go on beyond it.
        low, high = [], []
        for k in (0, 1):
            cells = self.shape[k]
            first, last = np.flatnonzero(likely.any(axis=1 - k))[[0, -1]].tolist()
            before = 1 if first > 0 else max(1, cells // 4)
            after = 1 if last < cells - 1 else max(1, cells // 4)
            low.append(float(max(self.low[k] + self.step[k] * (first - before), bounds.low[k])))
            high.append(float(min(self.low[k] + self.step[k] * (last + 1 + after), bounds.high[k])))
        return Window((low[0], low[1]), (high[0], high[1]), shape)

    def open_ends(self, bounds: Window, axis: int) -> tuple[bool, bool]:
        """Return whether the low and the high end of an axis lie inside `bounds`."""
        return self.low[axis] > bounds.low[axis], self.high[axis] < bounds.high[axis]

    def wider(self, bounds: Window, shape: tuple[int, int]) -> Window:
        """Return a window three times as wide along both axes, within bounds, cut anew."""
        width = [self.high[k] - self.low[k] for k in (0, 1)]
        low = [max(self.low[k] - width[k], bounds.low[k]) for k in (0, 1)]
        high = [min(self.high[k] + width[k], bounds.high[k]) for k in (0, 1)]
        return Window((low[0], low[1]), (high[0], high[1]), shape)


@dataclass(frozen=True, eq=False)
class CoarseTable:
    """A model on a coarse lattice, by default over its whole domain: there the search for a posterior begins."""

    window: Window
    nodes: Nodes  # one a cell, covariances widened by the change of the lengths across it

    @classmethod
    def of(cls, forward: ForwardModel) -> CoarseTable:
        """Tabulate a model, once for many capsules."""
        (ca_low, ca_high), (size_low, size_high) = forward.domain.bounds
        return cls.on(Window((float(np.log(ca_low)), size_low), (float(np.log(ca_high)), size_high), _COARSE), forward)

    def carried(self, log_density: Floats, drop: float = COARSE_DROP) -> Booleans:
        """Return the cells that carry a log density (n,) : (i, j) array."""
        return (log_density > np.nanmax(log_density) - drop).reshape(self.window.shape)

    @classmethod
    def on(cls, window: Window, forward: ForwardModel) -> CoarseTable:
        """Tabulate a model on a window."""
        return cls.widened(window, window.nodes(forward))

    @classmethod
    def widened(cls, window: Window, nodes: Nodes) -> CoarseTable:
        """Return the table of nodes that are known, one for each cell of a window."""
        model = nodes.model
        (z_u, z_s), (a_u, a_s) = (_changes(lengths.reshape(window.shape)) for lengths in (model.extent, model.length))
        wide = model._replace(
            zz=model.zz + (z_u**2 + z_s**2).ravel(),
            za=model.za + (z_u * a_u + z_s * a_s).ravel(),
            aa=model.aa + (a_u**2 + a_s**2).ravel(),
        )
        return cls(window, replace(nodes, model=wide))


def _changes(values: Floats) -> tuple[Floats, Floats]:
    """Return half of the larger change to a neighbour along each axis, zero where no neighbour has a value."""
    halves = []
    for axis in (0, 1):
        step = np.nan_to_num(np.diff(values, axis=axis))
        none = np.zeros_like(values[:1] if axis == 0 else values[:, :1])
        ahead, behind = np.concatenate([step, none], axis), np.concatenate([none, step], axis)
        halves.append(0.5 * np.where(np.abs(ahead) > np.abs(behind), ahead, behind))
    return halves[0], halves[1]


# Posterior of one capsule on a grid of (log Ca, a/l), and the distributions of all quantities that follow from it.
#
# A quantity is a function of the node times independent inputs, so its distribution is a product of `LogGrid`: exact,
# without draws

_NEGLIGIBLE = 1e-9  # of the largest probability of a node
_MODULI = ("surface_shear_modulus", "surface_dilation_modulus")
_DRAWS = 200_000  # where a prior range cuts, so that the inputs are no longer independent of the shape


class ExactPosterior(abc.ABC):
    """Posterior of one capsule at weighted nodes, with the distributions of what these and independent inputs tell."""

    forward: ForwardModel
    density: PosteriorDensity
    gates: tuple[Gate, ...]  # whether it resolves the posterior
    unresolved: ClassVar[Status] = Status.GRID_TOO_COARSE  # if it does not

    @property
    @abc.abstractmethod
    def cut(self) -> bool:
        """True if a prior range of G_s or a cuts off part of the posterior, or a prior is no range."""

    @property
    @abc.abstractmethod
    def kept(self) -> tuple[Floats, Nodes, Floats | None]:
        """Nodes that carry the posterior: probabilities (m,), nodes and l (m,) where it is a dimension."""

    @property
    def log_dilation(self) -> Floats | float | None:
        """Log of K = K_s / G_s; None for a model without it."""
        return None if self.density.dilation is None else float(np.log(self.density.dilation))

    @property
    @abc.abstractmethod
    def _spacing(self) -> tuple[float, float, float]:
        """Distance of neighbouring nodes in log Ca, in log(a/l) and in log l; zero if they are scattered."""

    @abc.abstractmethod
    def drawn(self, rng: np.random.Generator, count: int) -> dict[str, Floats]:
        """Return independent draws of all quantities [SI], spread within the cells of the grid : (count,) arrays."""

    def marginal(self, name: str) -> Marginal:
        """Return the summary of one quantity, named as in `capsbayes.parameters`."""
        return self.distribution(name).marginal() if self.is_exact(name) else Marginal.of_draws(self._many_draws[name])

    def log_marginal(self, name: str) -> Marginal:
        """Return the summary of the logarithm of one quantity."""
        if self.is_exact(name):
            return self.distribution(name).log_marginal()
        return Marginal.of_draws(np.log(self._many_draws[name]))

    def probability_below(self, name: str, value: float) -> float:
        """Return the probability that a quantity is below a value [SI]: uniform over capsules if value is the truth."""
        if not self.is_exact(name):
            return float(np.mean(self._many_draws[name] <= value))
        return float(self.distribution(name).below(np.array([np.log(value)]))[0])

    @cached_property
    def _many_draws(self) -> dict[str, Floats]:
        return self.drawn(np.random.default_rng(0), _DRAWS // 5 if self.density.prior.is_general else _DRAWS)

    @cached_property
    def _ratio(self) -> tuple[Floats, float]:
        """Log of the mean v_o/U given the lengths at the kept nodes : (m,) array, and its mean relative variance."""
        weights, nodes, width = self.kept
        mean, variance = self.density.velocity_ratio(nodes.model, width)
        return np.log(mean), float(weights @ (np.maximum(variance, 0.0) / mean**2))

    @cached_property
    def _node_logs(self) -> dict[str, tuple[Floats, float]]:
        """Logs of the quantities the node alone determines (m,), and the distance of their neighbours."""
        nodes, (du, ds, _) = self.kept[1], self._spacing
        return {
            "capillary_number": (nodes.log_ca, du),
            "size_ratio": (np.log(nodes.size), ds),
            "axial_extent": (np.log(nodes.model.extent), 0.0),
            "axial_length": (np.log(nodes.model.length), 0.0),
            "stretch_ratio": (np.log(nodes.model.stretch_ratio), 0.0),
        }

    def is_exact(self, name: str) -> bool:
        """Return whether `distribution` holds for a quantity: no prior range cuts it, or the node determines it."""
        return not self.cut or name in self._node_logs

    def distribution(self, name: str) -> LogGrid:
        """Return the distribution of a quantity as a product of a function of the node and independent inputs."""
        density = self.density
        if name in self._node_logs:
            return self._binned(*self._node_logs[name])
        if density.flow_rate is not None and name != "viscosity":
            return self._given_flow(name)
        if name in ("viscosity", "capsule_velocity"):
            return getattr(density, name)
        if name in ("half_width", "capsule_radius"):
            return self._length(name)
        log_ratio, variance = self._ratio
        if name == "velocity_ratio":
            return self._binned(log_ratio, 0.0).times(LogGrid.normal(variance))
        log_ca, du = self._node_logs["capillary_number"]
        if name == "mean_velocity":
            slower = self._binned(-log_ratio, 0.0).times(LogGrid.normal(variance))
            return slower.times(density.capsule_velocity)
        if name in _MODULI:
            divided = self._binned(self._log_dilation_of(name) - log_ca - log_ratio, du)
            return divided.times(LogGrid.normal(variance)).times(density.force_scale)
        raise KeyError(name)

    def _given_flow(self, name: str) -> LogGrid:
        """Return the distribution of a quantity that the flow rate changes."""
        density, (_, nodes, width) = self.density, self.kept
        log_ratio, variance = self._ratio
        flow = density.flow(width, nodes.model)
        assert flow is not None
        (flow_change, width_change, speed_change, ratio_change), variances = given_flow(log_ratio, variance, flow)
        log_speed = np.full(len(log_ratio), density.capsule_velocity.mean)
        log_width = np.full(len(log_ratio), density.half_width.mean) if width is None else np.log(width)
        (log_ca, du), (log_size, ds) = (self._node_logs[key] for key in ("capillary_number", "size_ratio"))
        log_flow = log_speed - log_ratio + flow_change
        logs, least, spread = {
            "mean_velocity": (log_flow, 0.0, variances[0]),
            **dict.fromkeys(_MODULI, (log_flow - log_ca + self._log_dilation_of(name), du, variances[0])),
            "half_width": (log_width + width_change, 0.0, variances[1]),
            "capsule_radius": (log_width + width_change + log_size, ds if width is None else 0.0, variances[1]),
            "capsule_velocity": (log_speed + speed_change, 0.0, variances[2]),
            "velocity_ratio": (log_ratio + ratio_change, 0.0, variances[3]),
        }[name]
        found = self._binned(logs, least).times(LogGrid.normal(float(spread)))
        return found.times(density.viscosity) if name in _MODULI else found

    def _log_dilation_of(self, name: str) -> Floats | float:
        """Return ln(K_s / G_s) for K_s, and zero for any other quantity."""
        log_dilation = self.log_dilation if name == "surface_dilation_modulus" else None
        return 0.0 if log_dilation is None else log_dilation

    def _length(self, name: str) -> LogGrid:
        width = self.kept[2]
        log_size, ds = self._node_logs["size_ratio"]
        if width is None:
            only = self.density.half_width
            return only if name == "half_width" else self._binned(log_size, ds).times(only)
        if name == "half_width":
            return self._binned(np.log(width), self._spacing[2])
        return self._binned(np.log(width) + log_size, 0.0)

    def _binned(self, logs: Floats, least: float) -> LogGrid:
        return laid(logs, self.kept[0], least)


@dataclass(frozen=True, eq=False)
class GridPosterior(ExactPosterior):
    """Posterior of one capsule on a grid."""

    forward: ForwardModel
    density: PosteriorDensity
    window: Window  # cells of (log Ca, a/l)
    nodes: Nodes  # of the cells that are visited and of their pieces
    half_width: Floats | None  # (k,) [m]: nodes of l, where it is a dimension
    free: Floats  # (k or 1, n): probabilities over the largest, before the ranges of G_s and a cut
    share: Floats | float  # probability that G_s and a lie within their ranges there
    gates: tuple[Gate, ...]

    @cached_property
    def weights(self) -> Floats:
        """Posterior probability of each node : (k or 1, n) array."""
        weights = self.free * self.share
        return weights / weights.sum()

    @cached_property
    def of_cells(self) -> Floats:
        """Posterior probability of each cell of the window, none of which is split : (k or 1, i, j) array."""
        cells = np.zeros((len(self.weights), self.window.shape[0] * self.window.shape[1]))
        cells[:, self.nodes.cell] = self.weights
        return cells.reshape(-1, *self.window.shape)

    @cached_property
    def _likeliest(self) -> int:
        """Number of the node with the largest probability in its piece."""
        return int(np.argmax(self.weights.sum(axis=0) / self.nodes.side**2))

    @property
    def likeliest(self) -> tuple[float, float]:
        """Ca and a/l of the likeliest node."""
        return float(np.exp(self.nodes.log_ca[self._likeliest])), float(self.nodes.size[self._likeliest])

    @property
    def distance(self) -> float:
        """Distance of the measured lengths from those of the likeliest node, in standard deviations; l is known."""
        there = self.nodes.model.taken(self._likeliest)
        return float(self.density.likelihood.distance(there, self.density.width_at(None)))

    @property
    def likelihood(self) -> tuple[Floats, Floats, Floats, float]:
        """The posterior without the priors of G_s and a, where l is no dimension."""
        # Probabilities (m,) of nodes, log(G_s / mu) and log(a / l) there (m,), and the variance of the former at each.
        density = self.density
        modulus, radius = density.prior.both
        kept = self.free[0] > _NEGLIGIBLE * self.free.max()
        nodes, log_size = self.nodes.taken(kept), np.log(self.nodes.size[kept])
        if density.inputs.by_flow_rate:  # U is shared, too
            area = 0.0 if nodes.model.log_area is None else nodes.model.log_area
            softness, spread, log_flow = -nodes.log_ca - area, 0.0, float(np.log(density.inputs.mean_velocity(1.0)))
        else:
            softness, spread, log_flow = self._softness(nodes, self.free[0, kept])
        flat = self.free[0, kept] * np.exp(-radius.power * log_size - modulus.power * (softness - softness.max()))
        return flat, softness + log_flow, log_size, spread

    def _softness(self, nodes: Nodes, weights: Floats) -> tuple[Floats, float, float]:
        """Return log(G_s / mu v_o) at nodes, its variance at each, and the log of v_o."""
        density = self.density
        mean, variances = density.velocity_ratio(nodes.model, None)
        variance = float(np.average(np.maximum(variances, 0.0) / mean**2, weights=weights))
        log_ratio, velocity = np.log(mean), LogGrid.of(density.inputs.capsule_velocity, -1)
        flow = density.flow(None, nodes.model)
        if flow is None:
            return -nodes.log_ca - log_ratio, velocity.variance + variance, velocity.mean
        (change, *_), (spread, *_) = given_flow(log_ratio, variance, flow)
        return -nodes.log_ca - log_ratio + change, float(spread), density.capsule_velocity.mean

    @cached_property
    def cut(self) -> bool:
        if self.density.prior.is_general:
            return True
        share = np.broadcast_to(self.share, self.free.shape)[self.free > _NEGLIGIBLE * self.free.max()]
        return bool(share.min() < 1.0 - 1e-6)

    def drawn(self, rng: np.random.Generator, count: int) -> dict[str, Floats]:
        width, node = np.unravel_index(
            rng.choice(self.weights.size, size=count, p=self.weights.ravel()), self.weights.shape
        )
        place = np.stack([self.nodes.log_ca[node], self.nodes.size[node]])
        cell = np.array(self.window.step)[:, None] * self.nodes.side[node]
        moved = place + cell * rng.uniform(-0.5, 0.5, place.shape)
        change = np.ones(count)
        if self.half_width is not None:
            # lengths in metres fix a = l (a/l) rather than either factor: l moves within its cell at constant a
            change = np.exp(np.log(self.half_width[1] / self.half_width[0]) * rng.uniform(-0.5, 0.5, count))
            moved[1] /= change
        inside = self.forward.domain.contains(np.exp(moved[0]), moved[1])
        place = np.where(inside, moved, place)
        nodes = {"capillary_number": np.exp(place[0]), "size_ratio": place[1]}
        if self.half_width is not None:
            nodes["half_width"] = self.half_width[width] * np.where(inside, change, 1.0)
        points = self.density.evaluated(self.forward, nodes, outline=False)
        return self.density.completed(rng, nodes, points)

    @cached_property
    def kept(self) -> tuple[Floats, Nodes, Floats | None]:
        width, node = np.nonzero(self.weights > _NEGLIGIBLE * self.weights.max())
        weights = self.weights[width, node]
        return (
            weights / weights.sum(),
            self.nodes.taken(node),
            None if self.half_width is None else self.half_width[width],
        )

    @property
    def _spacing(self) -> tuple[float, float, float]:
        step = self.window.step
        gap = 0.0 if self.half_width is None else float(np.max(np.diff(np.log(self.half_width))))
        return step[0], step[1] / self.window.low[1], gap
