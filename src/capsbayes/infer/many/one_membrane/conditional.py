"""The capsules of a batch at given membranes: their Ca and a/l found, and integrated out by Laplace's method.

At a given membrane and spread of the population each capsule has two unknowns of its own, ln Ca and a/l, and a third
where the pre-inflation varies: the logarithm of its own over the median of the batch. All have in common the means of
ln G_s and of a/l, and the errors of the scale of the lengths and of the flow rate. The differences between measurement
and prediction are nearly linear in all of these. So their best values follow from a few Gauss-Newton steps, and the
integral over them from the curvature there (integrated nested Laplace approximation: Rue, Martino, Chopin 2009,
doi:10.1111/j.1467-9868.2008.00700.x). The normal equations have the shape of an arrow, with a block for each capsule:
the work is proportional to the number of capsules.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

from capsbayes.arrays import Floats, Integers
from capsbayes.infer.many.one_membrane.measured import Batch
from capsbayes.infer.many.one_membrane.numbers import ShapeModel, Shapes

_LATTICE = 20, 10  # places along ln Ca and a/l, among which a capsule is looked for first
_UNUSUAL = 0.3  # of ln G_s, that a capsule of the lattice may differ by from the others
OWN_STEPS = (2e-3, 1e-3, 2e-2)
"""Of ln Ca, a/l and ln(alpha/median), for differences."""
STEP = 0.02
"""Of a coordinate's normal score, for differences."""
_LONGEST = np.array([0.5, 0.05, 0.3])  # step
_ITERATIONS, _SETTLED = 16, 1e-2  # largest decrease of minus twice the log density that is still expected
_WALKED = 5  # steps that may be needed until the best values are near
_SHRINKS = 0.5  # of the decrease expected before, at most where the steps are good
_STALLED = 0.99  # of the decrease expected before, above which steps lead nowhere
_HELD = 0.3  # standard deviations that are left to go, above which a capsule is held
_HALVINGS = 5
_FLAT = 1e-9  # of the diagonal, so that what the data tell nothing of has an inverse
MODULUS, SIZE, SCALE, RATE = range(4)
"""Columns of what is common."""
COMMON = 4

Membranes = Mapping[str, Floats]


class Spreads(NamedTuple):
    """Standard deviations from capsule to capsule of ln G_s, of a/l and of ln alpha, at d membranes : (d,) arrays.

    The last is None if all have the same pre-inflation.
    """

    modulus: Floats
    size: Floats
    inflation: Floats | None = None

    @property
    def own(self) -> int:
        """Number of the unknowns that each capsule has of its own."""
        return 2 if self.inflation is None else 3

    def rows(self, rows: Integers) -> Spreads:
        """Return those of some membranes."""
        inflation = None if self.inflation is None else self.inflation[rows]
        return Spreads(self.modulus[rows], self.size[rows], inflation)


class Start(NamedTuple):
    """Values at d membranes: of the capsules (d, n, o), see `Conditional`, and what is common (d, 4)."""

    own: Floats
    common: Floats


class Conditional(NamedTuple):
    """What is known at d membranes.

    Parameters
    ----------
    log_evidence : (d,) array
        Log density of the measurements, up to a constant of the batch; -inf where a capsule cannot have its shape.
    settled : (d,) array
        Share of the capsules whose best values were found; the others are held by the border of the domain.
    own : (d, n, o) array
        ln Ca, a/l and, where it varies, the logarithm of the pre-inflation over its median: the best values, or one
        draw if draws were asked for.
    common : (d, 4) array
        What is common, likewise.
    """

    log_evidence: Floats
    settled: Floats
    own: Floats
    common: Floats


class Step(NamedTuple):
    """A step along all unknowns of d membranes.

    Parameters
    ----------
    scores : (d, f) array
        Of the membranes' normal scores.
    common, own : (d, 4), (d, n, o) arrays
    decrease : (d,) array
        Of minus twice the log density, as expected.
    covariance : (d, 4 + f, 4 + f) array
        Of what is common and the normal scores, by the curvature.
    log_ratio : (d, n) array
        ln(v_o/U) before the step.
    """

    scores: Floats
    common: Floats
    own: Floats
    decrease: Floats
    covariance: Floats
    log_ratio: Floats


class _Blocks(NamedTuple):
    """Normal equations of each capsule at d membranes; c unknowns are common to all, those of the membranes last.

    own (d, n, o, o), cross (d, n, c, o), common (d, n, c, c), their right sides own_slope (d, n, o) and common_slope
    (d, n, c), and minus twice the log density (d, n).
    """

    own: Floats
    cross: Floats
    common: Floats
    own_slope: Floats
    common_slope: Floats
    square: Floats


class _Solved(NamedTuple):
    """Steps to the best values, the expected decrease (d,), log determinants (d,) and what draws are made of."""

    own_step: Floats
    common_step: Floats
    decrease: Floats
    log_volume: Floats
    factor: Floats
    inverse: Floats


class _There(NamedTuple):
    """Shapes of d n capsules as (d, n, ...) arrays, and their derivatives along what is a capsule's own."""

    shapes: Shapes
    along: Floats
    ratio_along: Floats


@dataclass(frozen=True, eq=False)
class Capsules:
    """The capsules of a batch, to be found at given membranes.

    Parameters
    ----------
    batch : Batch
    model : ShapeModel
    log_viscosity : float
        ln(mu / (Pa s)).
    """

    batch: Batch
    model: ShapeModel
    log_viscosity: float

    def at(
        self,
        membranes: Membranes,
        spreads: Spreads,
        *,
        start: Start | None = None,
        rng: np.random.Generator | None = None,
        iterations: int = _ITERATIONS,
    ) -> Conditional:
        """Find the capsules at d membranes, or draw them if a generator is given.

        Parameters
        ----------
        membranes : mapping of (d,) arrays
            The model's further coordinates by name.
        spreads : Spreads
        start : Start, optional
            Values near the best ones; default: they are looked for on a lattice.
        rng : Generator, optional
        iterations : int
            At most.
        """
        d = len(spreads.modulus)
        own, common = self._begin(membranes, spreads.own, start)
        found = Conditional(np.full(d, -np.inf), np.zeros(d), own, common)
        active = np.flatnonzero(np.isfinite(common[:, SIZE]))
        before, share = np.full(d, np.inf), np.ones(d)
        for iteration in range(iterations):
            if not len(active):
                break
            some = {name: values[active] for name, values in membranes.items()}
            near = spreads.rows(active)
            there = self._there(some, own[active])
            blocks = self._blocks(there, own[active], common[active], near)
            solved = self._solved(blocks, common[active])
            done = solved.decrease < _SETTLED
            # at the border of the domain the decrease remains
            stalled = (iteration >= _WALKED) & (solved.decrease > _STALLED * before[active])
            last = done | stalled | (iteration == iterations - 1)
            # where steps go back and forth, as between a convex and a concave rear, shorter ones end
            share[active] = np.where(solved.decrease > _SHRINKS * before[active], 0.5 * share[active], 1.0)
            rows, before[active] = active[last], solved.decrease
            found.log_evidence[rows] = self._log_evidence(blocks, solved, common[active])[last]
            left = np.abs(solved.own_step) / np.sqrt(np.diagonal(solved.inverse, axis1=2, axis2=3))
            found.settled[rows] = np.mean(np.all(left < _HELD, axis=2), axis=1)[last]
            if rng is not None:
                steps = self._drawn(blocks, solved, rng)
                solved = solved._replace(own_step=np.where(last[:, None, None], steps[0], solved.own_step))
                solved = solved._replace(common_step=np.where(last[:, None], steps[1], solved.common_step))
            moving = np.ones(len(active), dtype=bool) if rng is not None else ~last
            some = {name: values[moving] for name, values in some.items()}
            part = np.where(last, 1.0, share[active])[moving]
            own[active[moving]] = self.moved(some, own[active[moving]], part[:, None, None] * solved.own_step[moving])
            common[active[moving]] += part[:, None] * solved.common_step[moving]
            active = active[~last]
        return found

    def _begin(self, membranes: Membranes, width: int, start: Start | None) -> Start:
        """Return the start; where it leaves the domain, and where there is none, one from the lattice."""
        if start is None:
            places, log_modulus = self._first(membranes)
            own = np.concatenate([places, np.zeros((*places.shape[:2], width - 2))], axis=2)
            common = np.zeros((len(own), COMMON))
            common[:, MODULUS], common[:, SIZE] = log_modulus.mean(axis=1), own[:, :, 1].mean(axis=1)
            return Start(own, common)
        begin = Start(start.own.copy(), start.common.copy())
        outside = ~np.all(self.model.contains(membranes, begin.own), axis=1)
        if outside.any():
            some = {name: values[outside] for name, values in membranes.items()}
            begin.own[outside], begin.common[outside] = self._begin(some, width, None)
        return begin

    def step(
        self,
        membranes: Membranes,
        spreads: Spreads,
        own: Floats,
        common: Floats,
        moved: Sequence[Membranes],
        scores: Floats,
    ) -> Step:
        """Return the step towards the best membranes and capsules, from d membranes with normal scores (d, f).

        `moved` are the membranes with one score after the other larger by `STEP`.
        """
        there = self._there(membranes, own, moved)
        every = np.concatenate([common, scores], axis=1)
        blocks = self._blocks(there, own, common, spreads)
        solved = self._solved(blocks, every)
        white: Floats = np.asarray(np.linalg.inv(solved.factor), dtype=np.float64)
        covariance, c, whole = white.swapaxes(1, 2) @ white, common.shape[1], solved.common_step
        return Step(whole[:, c:], whole[:, :c], solved.own_step, solved.decrease, covariance, there.shapes.log_ratio)

    def with_model_error(self, membranes: Membranes, own: Floats) -> Capsules:
        """Return the capsules with the model's own error, as it is at one membrane (1,) and places (n, 2), in theirs.

        Those with nearly the same Ca and a/l share it: the number that share it is the sum of the correlations.
        """
        there = self.shapes(membranes, own[None], errors=True)
        scaled = own[:, :2] / self.model.error_lengths
        sharing = np.exp(-0.5 * cdist(scaled, scaled, "sqeuclidean")).sum(axis=1)
        errors = there.covariances[0], there.ratio_error[0]
        return replace(self, batch=self.batch.with_model_error(*errors, sharing))

    def misfit(self, membranes: Membranes, values: Start) -> Floats:
        """Return minus twice the log likelihood of each shape, beside the least possible one : (d, n) array."""
        batch, numbers = self.batch, self.shapes(membranes, values.own).numbers
        away = batch.target - (batch.rows @ numbers[..., None])[..., 0]
        away -= batch.scale * batch.scale_error * values.common[:, None, None, SCALE]
        return np.asarray(np.sum(away**2, axis=-1))

    def shapes(self, membranes: Membranes, own: Floats, *, errors: bool = False) -> Shapes:
        """Return the shapes at d membranes and (d, n, o) places as (d, n, ...) arrays."""
        return _by_place(self.model(self.model.theta(membranes, own), errors=errors), own)

    def _first(self, membranes: Membranes) -> tuple[Floats, Floats]:
        """Return of a lattice of places the best of each capsule, and ln G_s there : (d, n, 2), (d, n) arrays.

        Of two places that look alike, one has the modulus that others have.
        """
        (low, high), (small, large) = self.model.bounds
        axes = np.linspace(np.log(low), np.log(high), _LATTICE[0]), np.linspace(small, large, _LATTICE[1])
        places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        d, n = len(next(iter(membranes.values()))), len(self.batch)
        shapes = self.shapes(membranes, np.broadcast_to(places, (d, *places.shape)))
        lost = np.isnan(shapes.log_ratio)[..., None]
        numbers = np.where(lost, 0.0, shapes.numbers)
        capsules = zip(self.batch.rows, self.batch.target, strict=True)
        square = np.stack([np.sum((numbers @ rows.T - target) ** 2, axis=2) for rows, target in capsules], axis=2)
        square = np.where(lost, np.inf, square)
        every = np.broadcast_to(places[:, None], (len(places), n, 2))[None]
        moduli = self.log_moduli(every, np.where(lost, 0.0, shapes.log_ratio[..., None]))
        best = np.argmin(square, axis=1)[:, None]
        usual = np.median(np.take_along_axis(moduli, best, axis=1), axis=2, keepdims=True)
        best = np.argmin(square + ((moduli - usual) / _UNUSUAL) ** 2, axis=1)
        own = places[best]
        own[np.all(lost, axis=(1, 2))] = np.nan
        return own, np.take_along_axis(moduli, best[:, None], axis=1)[:, 0]

    def log_moduli(self, own: Floats, log_ratio: Floats) -> Floats:
        """Return ln(G_s / (N/m)) of the capsules, as the velocity or the flow rate says : (d, n) array."""
        batch = self.batch
        by_velocity = batch.log_velocity - log_ratio
        speed = np.where(np.isnan(batch.log_mean_velocity), by_velocity, batch.log_mean_velocity)
        return np.asarray(self.log_viscosity + speed - own[..., 0])

    def _there(self, membranes: Membranes, own: Floats, moved: Sequence[Membranes] = ()) -> _There:
        """Return the shapes of capsules with derivatives along what is their own, and to membranes moved by `STEP`."""
        width = own.shape[2]
        ahead = [self.model.theta(membranes, own + step) for step in np.diag(OWN_STEPS[:width])]
        ahead += [self.model.theta(other, own) for other in moved]
        shapes, slopes = self.model.with_slopes(self.model.theta(membranes, own), ahead)
        steps = np.array([*OWN_STEPS[:width], *[STEP] * len(moved)])
        along = np.moveaxis(slopes.numbers, 0, -1) / steps
        ratio_along = np.moveaxis(slopes.log_ratio, 0, -1) / steps
        places = own.shape[:2]
        by_place = along.reshape(*places, *along.shape[1:]), ratio_along.reshape(*places, -1)
        return _There(_by_place(shapes, own), *by_place)

    def _blocks(self, there: _There, own: Floats, common: Floats, spreads: Spreads) -> _Blocks:
        """Return the normal equations."""
        batch, shapes = self.batch, there.shapes
        (d, n, width), q = own.shape, batch.target.shape[1]
        modulus, size, scale, rate = (width + column for column in (MODULUS, SIZE, SCALE, RATE))
        columns = there.along.shape[-1] + COMMON
        matrix, right = np.zeros((d, n, q + width + 1, columns)), np.empty((d, n, q + width + 1))
        own_columns = [*range(width), *range(width + COMMON, columns)]
        # the shape
        right[:, :, :q] = batch.target - (batch.rows @ shapes.numbers[..., None])[..., 0]
        right[:, :, :q] -= batch.scale * batch.scale_error * common[:, None, None, SCALE]
        matrix[:, :, :q, own_columns] = batch.rows @ there.along
        matrix[:, :, :q, scale] = batch.scale * batch.scale_error
        # shear modulus, velocity and size
        by_rate = np.isfinite(batch.log_mean_velocity)
        variance = spreads.modulus[:, None] ** 2 + np.where(by_rate, 0.0, batch.velocity_error**2)
        sd = np.sqrt(variance)
        right[:, :, q] = (self.log_moduli(own, shapes.log_ratio) - common[:, None, MODULUS]) / sd
        right[:, :, q] += by_rate * batch.rate_error * common[:, None, RATE] / sd
        matrix[:, :, q, own_columns] = (~by_rate[:, None] * there.ratio_along) / sd[..., None]
        matrix[:, :, q, 0] += 1.0 / sd
        matrix[:, :, q, modulus] = 1.0 / sd
        matrix[:, :, q, rate] = np.where(by_rate, -batch.rate_error, 0.0) / sd
        known = np.where(by_rate, 1.0 / batch.velocity_error, 0.0)
        expected = np.nan_to_num(batch.log_velocity - batch.log_mean_velocity)
        right[:, :, q + 1] = (expected - shapes.log_ratio - batch.rate_error * common[:, None, RATE]) * known
        matrix[:, :, q + 1, own_columns] = there.ratio_along * known[..., None]
        matrix[:, :, q + 1, rate] = batch.rate_error * known
        right[:, :, q + 2] = (common[:, None, SIZE] - own[..., 1]) / spreads.size[:, None]
        matrix[:, :, q + 2, 1] = 1.0 / spreads.size[:, None]
        matrix[:, :, q + 2, size] = -1.0 / spreads.size[:, None]
        spread = np.log(variance) + 2.0 * np.log(spreads.size[:, None])
        if spreads.inflation is not None:
            right[:, :, q + 3] = -own[..., 2] / spreads.inflation[:, None]
            matrix[:, :, q + 3, 2] = 1.0 / spreads.inflation[:, None]
            spread = spread + 2.0 * np.log(spreads.inflation[:, None])
        transposed = matrix.swapaxes(-1, -2)
        normal = transposed @ matrix
        slope = (transposed @ right[..., None])[..., 0]
        square = np.sum(right**2, axis=-1) + spread
        first, then = slice(width), slice(width, None)
        blocks = normal[..., first, first], normal[..., then, first], normal[..., then, then]
        return _Blocks(*blocks, slope[..., first], slope[..., then], square)

    def _solved(self, blocks: _Blocks, common: Floats) -> _Solved:
        own = blocks.own + _FLAT * np.eye(blocks.own.shape[-1])
        inverse: Floats = np.asarray(np.linalg.inv(own), dtype=np.float64)
        carried = blocks.cross @ inverse
        schur = blocks.common - carried @ blocks.cross.swapaxes(-1, -2)
        slope = blocks.common_slope - (carried @ blocks.own_slope[..., None])[..., 0]
        matrix, right = self._gathered(schur, slope, common)
        factor: Floats = np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)
        step: Floats = np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0], dtype=np.float64)
        own_slope = blocks.own_slope - (step[:, None, None, :] @ blocks.cross)[..., 0, :]
        own_step = (inverse @ own_slope[..., None])[..., 0]
        gained = np.einsum("dna,dnab,dnb->d", blocks.own_slope, inverse, blocks.own_slope)
        decrease = gained + np.sum(right * step, axis=1)
        volume = np.log(np.linalg.det(own)).sum(axis=1)
        volume += 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        return _Solved(own_step, step, decrease, volume, factor, inverse)

    @staticmethod
    def _gathered(schur: Floats, slope: Floats, common: Floats) -> tuple[Floats, Floats]:
        """Add up the blocks of all capsules and the priors of what is common."""
        matrix, right, c = schur.sum(axis=1), slope.sum(axis=1), common.shape[1]
        precision = np.ones(c)
        precision[[MODULUS, SIZE]] = _FLAT
        matrix[:, np.arange(c), np.arange(c)] += precision
        right[:, SCALE:] -= common[:, SCALE:]
        return matrix, right

    @staticmethod
    def _log_evidence(blocks: _Blocks, solved: _Solved, common: Floats) -> Floats:
        square = blocks.square.sum(axis=1) + np.sum(common[:, SCALE:] ** 2, axis=1)
        return np.asarray(-0.5 * (square + solved.log_volume))

    def _drawn(self, blocks: _Blocks, solved: _Solved, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Draw steps from the Gaussian about the best values."""
        white = rng.standard_normal(solved.common_step.shape)
        step = np.linalg.solve(solved.factor.swapaxes(1, 2), white[..., None])[..., 0] + solved.common_step
        slope = blocks.own_slope - (step[:, None, None, :] @ blocks.cross)[..., 0, :]
        noise = np.linalg.cholesky(solved.inverse) @ rng.standard_normal((*slope.shape, 1))
        return (solved.inverse @ slope[..., None] + noise)[..., 0], step

    def moved(self, membranes: Membranes, own: Floats, step: Floats) -> Floats:
        """Return the places (d, n, o) after a step, shortened where it is too long or leaves the domain."""
        step = step / np.maximum(np.max(np.abs(step) / _LONGEST[: step.shape[-1]], axis=-1, keepdims=True), 1.0)
        rows = np.arange(len(own))  # of the membranes at which a capsule is lost
        for share in (*[0.5] * _HALVINGS, 0.0):
            some = {name: values[rows] for name, values in membranes.items()}
            lost = ~self.model.contains(some, own[rows] + step[rows])
            rows, lost = rows[lost.any(axis=1)], lost[lost.any(axis=1)]
            if not len(rows):
                break
            step[rows] = np.where(lost[..., None], share * step[rows], step[rows])
        return np.asarray(own + step)


def _by_place(shapes: Shapes, own: Floats) -> Shapes:
    """Return the shapes at (d, n, o) places, one after the other, as (d, n, ...) arrays."""
    return Shapes(*(values.reshape(*own.shape[:2], *values.shape[1:]) for values in shapes))
