"""The exact engine for a model with a further coordinate: a grid of `Quadrature` at each of several values of it.

At each value the posterior over (log Ca, a/l) is narrow, but from value to value
it moves far: a capsule may be softer, or less inflated. So each value has a grid
of its own, and the grids are weighted by their evidence. The values are the
middles of cells of equal prior probability, halved where the posterior is likely
until the cells resolve it, and until the grids of neighbouring values overlap.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator

from capsbayes.arrays import Floats, Integers
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer.checks import Gate
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.grid import ExactPosterior, GridPosterior
from capsbayes.infer.likelihood import ModelAtPoints
from capsbayes.infer.log_grid import LogGrid
from capsbayes.infer.outline import AnyOutline
from capsbayes.infer.prior import Coordinate, Inputs, Marginal, Prior
from capsbayes.infer.quadrature import Quadrature
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel

CELLS_PER_SD = 3.0  # of the coordinate's marginal
SDS_PER_SHIFT = 1.0  # of log Ca at given coordinate over its shift to the next cell
_FIRST, _LAST = 4, 7  # halvings of the prior
_DROP = 14.0  # of the log probability of a cell, within which cells are halved again
_PILOTS = (0.5, 0.25, 0.75, 0.1, 0.9)  # shares of the prior below values whose likeliest shape may be a pilot
_COUNTS = 1e-4  # probability of a cell whose gates count
_FINE = 64  # points in a cell for the moments of the coordinate


@dataclass(frozen=True, eq=False)
class MixedPosterior(ExactPosterior):
    """Posterior of one capsule over (log Ca, a/l) and one more coordinate."""

    # The range of the prior of the coordinate is cut into cells of equal probability; in the middle of each the
    # posterior over (log Ca, a/l) is known on a grid of its own.

    forward: ForwardModel
    density: PosteriorDensity  # with the coordinate
    shares: Floats  # (n,): middles of n cells, as shares of the prior below
    width: float  # of a cell
    parts: Sequence[GridPosterior]
    gates: tuple[Gate, ...] = ()

    @property
    def coordinate(self) -> Coordinate:
        """The further coordinate and its prior."""
        return self.density.coordinates[0]

    @cached_property
    def weights(self) -> Floats:
        """Posterior probability of each cell : (n,) array."""
        logs = np.array([part.log_evidence for part in self.parts])
        weights = np.exp(logs - logs.max())
        return np.asarray(weights / weights.sum())

    def marginal(self, name: str) -> Marginal:
        """See `ExactPosterior`."""
        return self._of_coordinate if name == self.coordinate.name else super().marginal(name)

    def log_marginal(self, name: str) -> Marginal:
        """See `ExactPosterior`; of the coordinate, which may vanish, the summary of itself."""
        return self._of_coordinate if name == self.coordinate.name else super().log_marginal(name)

    def probability_below(self, name: str, value: float) -> float:
        """See `ExactPosterior`."""
        if name == self.coordinate.name:
            values, below = self._distribution
            return float(np.interp(value, values, below, left=0.0, right=1.0))
        return float(self.weights @ np.array([part.probability_below(name, value) for part in self.parts]))

    def variance_between(self, name: str) -> float:
        """Return the variance of the mean of the logarithm of a quantity from cell to cell."""
        means = np.array([part.log_marginal(name).mean for part in self.parts])
        return float(self.weights @ (means - self.weights @ means) ** 2)

    def drawn(self, rng: np.random.Generator, count: int) -> dict[str, Floats]:
        """See `ExactPosterior`; the coordinate is spread within its cells too."""
        numbers = rng.multinomial(count, self.weights)
        drawn = [part.drawn(rng, number) for part, number in zip(self.parts, numbers, strict=True) if number]
        draws = {name: np.concatenate([part[name] for part in drawn]) for name in drawn[0]}
        shares = np.repeat(self.shares, numbers) + self.width * rng.uniform(-0.5, 0.5, count)
        draws[self.coordinate.name] = self.coordinate.values(shares)
        order = rng.permutation(count)
        return {name: values[order] for name, values in draws.items()}

    def is_exact(self, name: str) -> bool:
        """See `ExactPosterior`."""
        return all(part.is_exact(name) for part in self.parts)

    def distribution(self, name: str) -> LogGrid:
        """See `ExactPosterior`."""
        return LogGrid.mixed([part.distribution(name) for part in self.parts], self.weights)

    @cached_property
    def _distribution(self) -> tuple[Floats, Floats]:
        """Values of the coordinate and the posterior probability below each, smooth from edge to edge of the cells."""
        ends = self.shares[:, None] + self.width * np.array([-0.5, 0.5])
        edges = np.unique(ends)
        reached = np.array([self.weights[ends[:, 1] <= edge].sum() for edge in edges])
        shares = np.linspace(edges[0], edges[-1], _FINE * len(self.shares) + 1)
        below = PchipInterpolator(edges, reached / reached[-1])(shares)
        return self.coordinate.values(shares), np.asarray(below)

    @cached_property
    def _of_coordinate(self) -> Marginal:
        values, below = self._distribution
        masses, middles = np.diff(below), (values[1:] + values[:-1]) / 2
        mean = float(masses @ middles)
        sd = float(np.sqrt(masses @ (middles - mean) ** 2))
        return Marginal(mean, sd, *(float(value) for value in np.interp(Marginal.LEVELS, below, values)))


class MixedQuadrature:
    """Engine for many capsules of one experiment and one model with a further coordinate."""

    def __init__(self, model: ForwardModel, experiment: Experiment, prior: Prior | None = None) -> None:
        (coordinate,) = Coordinate.all_of(model, prior or Prior())
        self.model, self.experiment, self.coordinate = model, experiment, coordinate
        self.prior = replace(prior or Prior(), coordinates={coordinate.name: coordinate.distribution})
        self.inputs = Inputs.of_experiment(experiment)
        self._engines: dict[float, Quadrature] = {}

    def __call__(
        self, measurement: Measurement, *, inputs: Inputs | None = None, error_scale: float = 1.0
    ) -> MixedPosterior:
        """Compute the posterior of one capsule."""
        inputs = inputs or self.inputs.with_velocity_of(measurement)
        density = PosteriorDensity.of(measurement, inputs, self.prior, error_scale, (self.coordinate,))
        if measurement.outline is not None:  # one covariance for all values, so that their evidences can be compared
            density = replace(density, outline=self._outline(measurement, density))
        cells = np.arange(2**_FIRST)
        for halvings in range(_FIRST, _LAST + 1):
            posterior = self._on(cells, 0.5**halvings, measurement, density)
            gates = _resolution(posterior)
            if all(gate.passed for gate in gates):
                break
            likely = posterior.weights > np.exp(-_DROP) * posterior.weights.max()
            kept = np.flatnonzero(likely)[[0, -1]]
            first, last = (round(float(posterior.shares[end]) * 2**halvings - 0.5) for end in kept)
            cells = np.arange(max(2 * first - 2, 0), min(2 * last + 4, 2 ** (halvings + 1)))
        return replace(posterior, gates=(*_of_parts(posterior), *gates))

    def predicted_shapes(self, density: PosteriorDensity) -> tuple[ModelAtPoints, Floats]:
        """See `Quadrature.predicted_shapes`; of all values of the coordinate."""
        shares = (np.arange(2**_FIRST) + 0.5) * 0.5**_FIRST
        models, logs = zip(*(self._engine(share).predicted_shapes(density) for share in shares.tolist()), strict=True)
        return functools.reduce(ModelAtPoints.joined, models), np.concatenate(logs)

    def _on(self, cells: Integers, width: float, measurement: Measurement, density: PosteriorDensity) -> MixedPosterior:
        """Compute the posterior on given cells of the prior."""
        shares, parts, refused = [], [], None
        for share in (cells + 0.5) * width:
            try:
                parts.append(self._part(float(share), measurement, density))
                shares.append(float(share))
            except InputError as error:  # no such shape at this value of the coordinate
                refused = error
        if refused is not None and not parts:
            raise refused
        return MixedPosterior(self.model, density, np.array(shares), width, parts)

    def _outline(self, measurement: Measurement, density: PosteriorDensity) -> AnyOutline | None:
        """Return the likelihood of the outline with the likeliest shape near the middle of the prior as its pilot."""
        for share in _PILOTS:
            with contextlib.suppress(InputError):
                return self._part(share, measurement, density).density.outline
        return None

    def _part(self, share: float, measurement: Measurement, density: PosteriorDensity) -> GridPosterior:
        return self._engine(share)(
            measurement, inputs=density.inputs, error_scale=density.error_scale, outline=density.outline
        )

    def _engine(self, share: float) -> Quadrature:
        if share not in self._engines:
            value = float(self.coordinate.values(share))
            plain = replace(self.prior, coordinates={})
            self._engines[share] = Quadrature(self.model.fixed(**{self.coordinate.name: value}), self.experiment, plain)
        return self._engines[share]


def _resolution(posterior: MixedPosterior) -> tuple[Gate, Gate]:
    """Return the gates on the resolution of the coordinate and on the overlap of the grids of neighbouring cells."""
    name, weights = posterior.coordinate.name, posterior.weights
    place = np.round(posterior.shares / posterior.width)
    spread = float(np.sqrt(weights @ (place - weights @ place) ** 2))
    logs = [part.log_marginal("capillary_number") for part in posterior.parts]
    means, sds = (np.array([getattr(summary, what) for summary in logs]) for what in ("mean", "sd"))
    pairs = np.minimum(weights[1:], weights[:-1]) > _COUNTS
    shift = np.abs(np.diff(means)) / np.minimum(sds[1:], sds[:-1])
    widest = float(np.max(shift, where=pairs, initial=1e-9))
    return (
        Gate(f"cells in a standard deviation of {name}", spread, least=CELLS_PER_SD),
        Gate(f"standard deviations of log Ca over its shift to the next {name}", 1.0 / widest, least=SDS_PER_SHIFT),
    )


def _of_parts(posterior: MixedPosterior) -> list[Gate]:
    """Return the gates of the grids, of each the worst."""
    counting = [part for part, weight in zip(posterior.parts, posterior.weights, strict=True) if weight > _COUNTS]
    together = zip(*(part.gates for part in counting), strict=True)
    return [min(gates, key=lambda gate: gate.value) for gates in together]
