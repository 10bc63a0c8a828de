"""The capsules of a batch at given membranes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from scipy.spatial.distance import cdist
from scipy.special import ndtr, ndtri

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.errors import InputError
from capsbayes.experiment import AREAS, Experiment, bending
from capsbayes.footing import normal_distances
from capsbayes.infer.outline import OutlineLikelihood, SilhouetteLength
from capsbayes.infer.prior import THICKNESS, Coordinate
from capsbayes.measurement import MeasuredOutline, Measurement
from capsbayes.prediction import Prediction
from capsbayes.surrogate import MembraneSurrogate

# The measurements of a batch, reduced to what depends on the shape: a few numbers of each capsule

_UNSEEN = 1e3  # [l] standard error of a length that was not measured
_SAME_FLOW = 0.25  # of ln U, within which capsules are of one flow
_TRIED = 20  # stored shapes of the size of an outline, of which the nearest is the first pilot
_PILOTS = 2  # shapes about which the distances of an outline are linear, one after the other


class Reduced(NamedTuple):
    """One measured shape: up to a constant, minus twice its log likelihood is |target - rows numbers|^2."""

    rows: Floats  # (q, k)
    target: Floats  # (q,)
    scale: Floats  # (q,): change of rows numbers if the capsule is larger, relative
    left: float  # misfit that no shape takes away
    known: int  # measured numbers


@dataclass(frozen=True, eq=False)
class Batch:
    """Measured capsules that share a membrane."""

    rows: Floats  # (n, q, k), see `Reduced`
    target: Floats  # (n, q)
    scale: Floats  # (n, q)
    left: Floats  # (n,)
    known: Integers  # (n,)
    log_velocity: Floats  # (n,): ln(v_o / (m/s)), of U where the flow rate alone was measured
    velocity_error: Floats  # (n,): relative, with the model's own once this is known; infinite without a velocity
    log_mean_velocity: Floats  # (n,): ln(U / (m/s)) by the flow rate, NaN where none was given
    group: Integers  # (n,): number of the flow, slow to fast
    scale_error: float  # relative, of the lengths of all alike
    rate_error: float  # relative, of U by the flow rate of all alike

    def __len__(self) -> int:
        return len(self.target)

    def taken(self, rows: Integers) -> Batch:
        """Return some of the capsules, each as often as its row is named."""
        each: dict[str, Any] = {
            name: value[rows] for name, value in vars(self).items() if isinstance(value, np.ndarray)
        }
        return replace(self, **each)

    def with_model_error(self, covariances: Floats, ratio_error: Floats, sharing: Floats) -> Batch:
        """Return the same with the model's own error in the errors of the measurements."""
        # The error is nearly the same for capsules that have nearly the same Ca and a/l, and must not be averaged away
        # over them: its variance counts as often as capsules share it. Then the mean over them is as uncertain as it
        # is.
        own = sharing[:, None, None] * (self.rows @ covariances @ self.rows.swapaxes(1, 2))
        factor: Floats = np.asarray(np.linalg.cholesky(own + np.eye(own.shape[1])), dtype=np.float64)
        columns = np.concatenate([self.rows, self.target[..., None], self.scale[..., None]], axis=-1)
        white: Floats = np.asarray(np.linalg.solve(factor, columns), dtype=np.float64)
        velocity_error = np.hypot(self.velocity_error, np.sqrt(sharing) * ratio_error)
        rows, target, scale = white[..., :-2], white[..., -2], white[..., -1]
        return replace(self, rows=rows, target=target, scale=scale, velocity_error=velocity_error)


def batch_of(
    measurements: Sequence[Measurement], experiment: Experiment, model: MembraneSurrogate, *, scale_error: float = 0.0
) -> Batch:
    """Reduce the measurements of a batch."""
    with_outline = [measurement.outline is not None for measurement in measurements]
    if any(with_outline) and not all(with_outline):
        odd = measurements[with_outline.index(not with_outline[0])]
        expected = "outlines of all capsules of a batch, or of none"
        raise InputError(odd.source or "measurement", "outline", expected, "some with and some without")
    if all(with_outline):
        coefficients = model.stored_coefficients
        shapes = model.outlines_of(coefficients)
        reduced = [_of_outline(measurement, model, coefficients, shapes) for measurement in measurements]
    else:
        reduced = [_of_lengths(measurement) for measurement in measurements]
    width = experiment.half_width
    rates = [measurement.flow_rate or np.nan for measurement in measurements]
    rate_errors = [(m.flow_rate_error or 0.0) / m.flow_rate for m in measurements if m.flow_rate]
    area = AREAS[experiment.cross_section] * width.value**2
    mean_velocity = np.log(np.array(rates) / area)
    missing = [m.capsule_velocity is None and bool(m.flow_rate) for m in measurements]
    speeds = [None if none else m.known_velocity for none, m in zip(missing, measurements, strict=True)]
    velocity = np.array([u if v is None else v.value for u, v in zip(np.exp(mean_velocity), speeds, strict=True)])
    errors = np.array([np.inf if speed is None else speed.error for speed in speeds])
    rows, target, scale, left, known = map(np.array, zip(*reduced, strict=True))
    return Batch(
        rows=rows,
        target=target,
        scale=scale,
        left=left,
        known=known,
        log_velocity=np.log(velocity),
        velocity_error=errors / velocity,
        log_mean_velocity=mean_velocity,
        group=_groups(np.where(np.isnan(mean_velocity), np.log(velocity), mean_velocity)),
        scale_error=scale_error,
        rate_error=float(np.hypot(max(rate_errors, default=0.0), 2.0 * width.error / width.value)),
    )


def _groups(log_speed: Floats) -> Integers:
    """Return the number of the flow of each capsule, by gaps and steps in the logarithm of its speed : (n,) array."""
    order = np.argsort(log_speed, kind="stable")
    group, begin = np.zeros(len(order), dtype=np.int64), log_speed[order[0]]
    for before, here in pairwise(order):
        step = log_speed[here] - begin > _SAME_FLOW
        begin = log_speed[here] if step else begin
        group[here] = group[before] + step
    return group


def _of_lengths(measurement: Measurement) -> Reduced:
    extent, length, seen = measurement.axial_extent, measurement.axial_length, measurement.covariance
    covariance = np.diag([0.0, _UNSEEN**2])
    covariance[: len(seen), : len(seen)] = seen
    rows: Floats = np.asarray(np.linalg.cholesky(np.linalg.inv(covariance)).T, dtype=np.float64)
    target = rows @ np.array([extent, extent if length is None else length])
    return Reduced(rows, target, target, 0.0, len(seen))


def _of_outline(measurement: Measurement, model: MembraneSurrogate, coefficients: Floats, shapes: Floats) -> Reduced:
    """Reduce an outline: its distances are linear in the coefficients of the modes about a pilot that is near it."""
    # `coefficients` (s, k) and `shapes` (s, p, 2) are those of the stored states.
    assert measurement.outline is not None
    found = coefficients[_nearest(measurement.outline, shapes)]
    length = measurement.length_with_outline
    reduced = _linear(measurement.outline, length, model, found)
    for _ in range(_PILOTS):
        # of the shapes that the states have, the nearest to what was measured
        spread = coefficients.std(axis=0)
        ridge = np.column_stack([np.diag(1.0 / spread), np.zeros(len(spread))])
        rows, right = np.concatenate([reduced.rows, ridge]), np.concatenate([reduced.target, found / spread])
        found = np.linalg.lstsq(rows, right, rcond=None)[0][:-1]
        reduced = _linear(measurement.outline, length, model, found)
    return reduced


def _nearest(outline: MeasuredOutline, shapes: Floats) -> int:
    """Return the number of the shape (s, p, 2) that is nearest to an outline, of some that have its size."""
    sizes, measured = np.ptp(shapes, axis=1), np.ptp(outline.points, axis=0)
    some = np.argsort(np.sum((sizes - measured) ** 2, axis=1), kind="stable")[:_TRIED]
    distances = normal_distances(outline.points, shapes[some], posed=True)
    return int(some[np.argmin(np.sum(distances**2, axis=1))])


def _linear(
    outline: MeasuredOutline, length: tuple[float, float] | None, model: MembraneSurrogate, pilot: Floats
) -> Reduced:
    """Return a measured outline linear about a pilot, whose coefficients (k,) these are."""
    shape = model.outlines_of(pilot[None])[0]
    silhouette = None if length is None else SilhouetteLength(*length)
    likelihood = OutlineLikelihood(outline.points, outline.noise, shape, outline.pose, length=silhouette)
    axial = np.zeros(1) if length is not None else None
    begin = likelihood.whitened(shape[None], axial)[0]
    columns = likelihood.whitened_prediction(np.concatenate([model.mode_shapes, shape[None]]))
    own = np.zeros((1, len(begin))) if length is None else likelihood.whitened_length()[None]
    every = np.concatenate([columns[:-1], own, columns[-1:]]).T  # modes, L_a, scale
    target = begin + columns[:-1].T @ pilot
    lacking = max(every.shape[1] - len(every), 0)  # an outline of few points: as many rows for all, the others of zeros
    every, target = np.pad(every, ((0, lacking), (0, 0))), np.pad(target, (0, lacking))
    q, r = scipy.linalg.qr(every, mode="economic")
    reduced = q.T @ target
    left = float(target @ target - reduced @ reduced)
    scale = r[:, -1] + (0.0 if length is None else length[0]) * r[:, -2]
    return Reduced(r[:, :-1], reduced, scale, max(left, 0.0), len(begin))


# What a model says of the shape of a capsule, in a few numbers with the model's own error


class Shapes(NamedTuple):
    """Shapes at n points; rows of NaN where the model has no answer."""

    numbers: Floats  # (n, k): L_z and L_a [l], or coefficients of the modes of outlines [l], and L_a behind them
    covariances: Floats  # (n, k, k): of the model's own error in the numbers; (n, 0, 0) if it was not asked for
    log_ratio: Floats  # (n,): ln(v_o/U)
    ratio_error: Floats  # (n,): the model's own standard error of it


class ShapeSlopes(NamedTuple):
    """To first order, m times the changes of shapes at n points; rows of NaN where the model has no answer."""

    numbers: Floats  # (m, n, k)
    log_ratio: Floats  # (m, n)


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """From parameters to `Shapes`: the lengths L_z and L_a, or the modes of outlines and L_a."""

    model: MembraneSurrogate
    half_width: float  # [m]
    outline: bool = False

    def __call__(self, theta: Mapping[str, Floats], *, errors: bool = True) -> Shapes:
        """Return the shapes at n points, with the model's error or perhaps without."""
        if self.outline:
            seen, coefficients, covariances = self.model.with_coefficients(theta, errors=errors)
            return _shapes(seen, np.column_stack([coefficients, seen.axial_length]), covariances)
        seen = self.model(theta)
        return _shapes(seen, seen.values[:, :2], seen.covariance[:, :2, :2])

    def with_slopes(
        self, theta: Mapping[str, Floats], moved: Sequence[Mapping[str, Floats]]
    ) -> tuple[Shapes, ShapeSlopes]:
        """Return the shapes at n points without the error of their numbers, and how they change if the points move."""
        # `moved` are further n points each. Changes are those of L_z, L_a, v_o/U, Lambda and of the modes.
        seen, coefficients, changes = self.model.with_changes(theta, moved, outline=self.outline)
        numbers, of_numbers = seen.values[:, :2], changes[..., :2]
        if self.outline:
            numbers = np.column_stack([coefficients, seen.axial_length])
            of_numbers = np.concatenate([changes[..., 4:], changes[..., 1:2]], axis=-1)
        shapes = _shapes(seen, numbers, seen.covariance[:, :0, :0])
        return shapes, ShapeSlopes(of_numbers, changes[..., 2] / seen.velocity_ratio)

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Smallest box about the domain, ``((ca_min, ca_max), (size_min, size_max))`` [-]."""
        return self.model.domain.bounds

    @property
    def error_lengths(self) -> Floats:
        """Distances in ln Ca and a/l over which the model's own error changes : (2,) array."""
        return self.model.error_lengths

    def places(self, membranes: Mapping[str, Floats], own: Floats) -> Floats:
        """Return places of d membranes, the capsules at (d, n, o) : (d, 4) array."""
        # Over a distance of one the model's own error changes.
        middle = own[..., :2].mean(axis=1, keepdims=True)
        return self.model.membrane_places(self.theta(membranes, middle))

    def contains(self, membranes: Mapping[str, Floats], own: Floats) -> Booleans:
        """Return whether places (d, n, o), as of `theta`, lie in the domain at d membranes : (d, n) array."""
        theta = self.theta(membranes, own)
        further = (theta[name] for name in self.model.coordinates)
        inside = self.model.domain.contains(theta["capillary_number"], theta["size_ratio"], *further)
        return inside.reshape(own.shape[:2])

    def theta(self, membranes: Mapping[str, Floats], own: Floats) -> dict[str, Floats]:
        """Return what the model reads at places (d, n, o), by name : (d n,) arrays."""
        # A place is ln Ca and a/l, and perhaps the logarithm of the pre-inflation over that of the membrane.
        theta = {name: np.repeat(values, own.shape[1]) for name, values in membranes.items()}
        size = own[..., 1].ravel()
        if own.shape[2] > 2:
            theta["pre_inflation"] = theta["pre_inflation"] * np.exp(own[..., 2]).ravel()
        if THICKNESS in theta:
            thickness = theta.pop(THICKNESS)
            theta["bending"] = bending(membrane_thickness=thickness, capsule_radius=size * self.half_width)
        return {"capillary_number": np.exp(own[..., 0]).ravel(), "size_ratio": size, **theta}


def _shapes(seen: Prediction, numbers: Floats, covariances: Floats) -> Shapes:
    ratio_error = np.sqrt(seen.covariance[:, 2, 2]) / seen.velocity_ratio
    return Shapes(numbers, covariances, np.log(seen.velocity_ratio), ratio_error)


# The capsules of a batch at given membranes: their Ca and a/l found, and integrated out by Laplace's method.
#
# At a given membrane and spread of the population each capsule has two unknowns of its own, ln Ca and a/l, and a third
# where the pre-inflation varies: the logarithm of its own over the median of the batch. All have in common the means of
# ln G_s and of a/l, and the errors of the scale of the lengths and of the flow rate. The differences between
# measurement and prediction are nearly linear in all of these. So their best values follow from a few Gauss-Newton
# steps, and the integral over them from the curvature there (integrated nested Laplace approximation: Rue, Martino,
# Chopin 2009, doi:10.1111/j.1467-9868.2008.00700.x). The normal equations have the shape of an arrow, with a block for
# each capsule: the work is proportional to the number of capsules

_LATTICE = 20, 10  # places along ln Ca and a/l, among which a capsule is looked for first
_UNUSUAL = 0.3  # of ln G_s, that a capsule of the lattice may differ by from the others
OWN_STEPS = (2e-3, 1e-3, 2e-2)  # of ln Ca, a/l and ln(alpha/median), for differences
STEP = 0.02  # of a coordinate's normal score, for differences
_LONGEST = np.array([0.5, 0.05, 0.3])  # step
_ITERATIONS, _SETTLED = 16, 1e-2  # largest decrease of minus twice the log density that is still expected
_WALKED = 5  # steps that may be needed until the best values are near
_SHRINKS = 0.5  # of the decrease expected before, at most where the steps are good
_STALLED = 0.99  # of the decrease expected before, above which steps lead nowhere
_HELD = 0.3  # standard deviations that are left to go, above which a capsule is held
_HALVINGS = 5
_FLAT = 1e-9  # of the diagonal, so that what the data tell nothing of has an inverse
MODULUS, SIZE, SCALE, RATE = range(4)  # columns of what is common
COMMON = 4

Membranes = Mapping[str, Floats]


class Spreads(NamedTuple):
    """Standard deviations from capsule to capsule of ln G_s, of a/l and of ln alpha, at d membranes : (d,) arrays."""

    # The last is None if all have the same pre-inflation.

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
    """What is known at d membranes."""

    log_evidence: Floats  # (d,): of the measurements, up to a constant of the batch; -inf where a capsule has no shape
    settled: Floats  # (d,): share of the capsules not held by the border of the domain
    own: Floats  # (d, n, o): ln Ca, a/l, perhaps ln(alpha/median): the best values, or a draw if draws were asked for
    common: Floats  # (d, 4): what is common, likewise


class NewtonStep(NamedTuple):
    """A step along all unknowns of d membranes."""

    scores: Floats  # (d, f): of the membranes' normal scores
    common: Floats  # (d, 4)
    own: Floats  # (d, n, o)
    decrease: Floats  # (d,): of minus twice the log density, as expected
    covariance: Floats  # (d, 4 + f, 4 + f): of what is common and the normal scores, by the curvature
    log_ratio: Floats  # (d, n): ln(v_o/U) before the step


class _Blocks(NamedTuple):
    """Normal equations of each capsule at d membranes; c unknowns are common to all, those of the membranes last."""

    # own (d, n, o, o), cross (d, n, c, o), common (d, n, c, c), their right sides own_slope (d, n, o) and common_slope
    # (d, n, c), and minus twice the log density (d, n).

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
    """The capsules of a batch, to be found at given membranes."""

    batch: Batch
    model: ShapeModel
    log_viscosity: float  # ln(mu / (Pa s))

    def at(
        self,
        membranes: Membranes,
        spreads: Spreads,
        *,
        start: Start | None = None,
        rng: np.random.Generator | None = None,
        iterations: int = _ITERATIONS,
    ) -> Conditional:
        """Find the capsules at d membranes, or draw them if a generator is given."""
        d = len(spreads.modulus)
        own, common = self._begin(membranes, spreads.own, start)
        result = Conditional(np.full(d, -np.inf), np.zeros(d), own, common)
        active = np.flatnonzero(np.isfinite(common[:, SIZE]))
        before, length = np.full(d, np.inf), np.ones(d)
        for iteration in range(iterations):
            if not len(active):
                break
            shapes = self._there(_rows_of(membranes, active), own[active])
            blocks = self._blocks(shapes, own[active], common[active], spreads.rows(active))
            solved = self._solved(blocks, common[active])
            # at the border of the domain the decrease remains
            stalled = (iteration >= _WALKED) & (solved.decrease > _STALLED * before[active])
            ended = (solved.decrease < _SETTLED) | stalled | (iteration == iterations - 1)
            # where steps go back and forth, as between a convex and a concave rear, shorter ones end
            length[active] = np.where(solved.decrease > _SHRINKS * before[active], 0.5 * length[active], 1.0)
            before[active] = solved.decrease
            square = blocks.square.sum(axis=1) + np.sum(common[active, SCALE:] ** 2, axis=1)
            result.log_evidence[active[ended]] = -0.5 * (square + solved.log_volume)[ended]
            left = np.abs(solved.own_step) / np.sqrt(np.diagonal(solved.inverse, axis1=2, axis2=3))
            result.settled[active[ended]] = np.mean(np.all(left < _HELD, axis=2), axis=1)[ended]
            moving, own_step, common_step = ~ended, solved.own_step, solved.common_step
            if rng is not None:  # the last step is a draw
                own_draw, common_draw = self._drawn(blocks, solved, rng)
                own_step = np.where(ended[:, None, None], own_draw, own_step)
                common_step = np.where(ended[:, None], common_draw, common_step)
                moving = np.ones(len(active), dtype=bool)
            rows, size = active[moving], np.where(ended, 1.0, length[active])[moving]
            own[rows] = self.moved(_rows_of(membranes, rows), own[rows], size[:, None, None] * own_step[moving])
            common[rows] += size[:, None] * common_step[moving]
            active = active[~ended]
        return result

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
            begin.own[outside], begin.common[outside] = self._begin(_rows_of(membranes, outside), width, None)
        return begin

    def step(
        self,
        membranes: Membranes,
        spreads: Spreads,
        own: Floats,
        common: Floats,
        moved: Sequence[Membranes],
        scores: Floats,
    ) -> NewtonStep:
        """Return the step towards the best membranes and capsules, from d membranes with normal scores (d, f)."""
        # `moved` are the membranes with one score after the other larger by `STEP`.
        there = self._there(membranes, own, moved)
        every = np.concatenate([common, scores], axis=1)
        blocks = self._blocks(there, own, common, spreads)
        solved = self._solved(blocks, every)
        white: Floats = np.asarray(np.linalg.inv(solved.factor), dtype=np.float64)
        covariance, c, whole = white.swapaxes(1, 2) @ white, common.shape[1], solved.common_step
        return NewtonStep(
            whole[:, c:], whole[:, :c], solved.own_step, solved.decrease, covariance, there.shapes.log_ratio
        )

    def with_model_error(self, membranes: Membranes, own: Floats) -> Capsules:
        """Return the capsules with the model's own error in theirs: that at one membrane (1,) and places (n, 2)."""
        # Those with nearly the same Ca and a/l share it: the number that share it is the sum of the correlations.
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
        """Return of a lattice of places the best of each capsule, and ln G_s there : (d, n, 2), (d, n) arrays."""
        # of two places that look alike, one has the modulus that others have
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
        matrix, right = schur.sum(axis=1), slope.sum(axis=1)  # of all capsules; then the priors of what is common
        columns = np.arange(common.shape[1])
        matrix[:, columns, columns] += np.where(np.isin(columns, (MODULUS, SIZE)), _FLAT, 1.0)
        right[:, SCALE:] -= common[:, SCALE:]
        factor: Floats = np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)
        step: Floats = np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0], dtype=np.float64)
        own_slope = blocks.own_slope - (step[:, None, None, :] @ blocks.cross)[..., 0, :]
        own_step = (inverse @ own_slope[..., None])[..., 0]
        gained = np.einsum("dna,dnab,dnb->d", blocks.own_slope, inverse, blocks.own_slope)
        decrease = gained + np.sum(right * step, axis=1)
        volume = np.log(np.linalg.det(own)).sum(axis=1)
        volume += 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        return _Solved(own_step, step, decrease, volume, factor, inverse)

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
            lost = ~self.model.contains(_rows_of(membranes, rows), own[rows] + step[rows])
            rows, lost = rows[lost.any(axis=1)], lost[lost.any(axis=1)]
            if not len(rows):
                break
            step[rows] = np.where(lost[..., None], share * step[rows], step[rows])
        return np.asarray(own + step)


def _rows_of(membranes: Membranes, rows: Integers | Booleans) -> dict[str, Floats]:
    return {name: values[rows] for name, values in membranes.items()}


def _by_place(shapes: Shapes, own: Floats) -> Shapes:
    """Return the shapes at (d, n, o) places, one after the other, as (d, n, ...) arrays."""
    return Shapes(*(values.reshape(*own.shape[:2], *values.shape[1:]) for values in shapes))


# Coordinates in which the membrane of a batch and the spreads of its population are drawn

_WIDEST = np.array([1.0, 0.5, 0.5])  # scales of half-normal priors of the spreads of ln G_s, of a/l and of ln alpha
_NARROWEST = 1e-4  # below it G_s and a are the same for all; their weights would cancel to fewer digits than are needed
_USUAL, _WIDTH = np.log([0.15, 0.06, 0.2]), np.log(3.0)  # of logs: where spreads are sought


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Points (normal scores of the unknown coordinates under their priors, logs of the unknown spreads)."""

    coordinates: tuple[Coordinate, ...]  # the unknown ones
    known: Mapping[str, float] = field(default_factory=dict)
    spreads: tuple[float | None, ...] = (None, None)  # of ln G_s and a/l, and of ln alpha if it varies; None: unknown

    @classmethod
    def of(
        cls, coordinates: Iterable[Coordinate], known: Mapping[str, float], spreads: tuple[float | None, ...]
    ) -> Unknowns:
        """Return those of coordinates with their priors, of which a thickness may be known, beside known ones."""
        each = tuple(coordinates)
        free = tuple(one for one in each if not one.distribution.known)
        thickness = {one.key: one.distribution.value for one in each if one.distribution.known}
        return cls(free, {**known, **thickness}, spreads)

    def fixed(self, values: Mapping[str, float]) -> Unknowns:
        """Return the same with known values of some coordinates."""
        free = tuple(one for one in self.coordinates if one.name not in values)
        return replace(self, coordinates=free, known={**self.known, **values})

    @property
    def scores(self) -> int:
        """Number of unknown coordinates: the first columns of a point."""
        return len(self.coordinates)

    @property
    def dimensions(self) -> int:
        """Number of columns of a point."""
        return self.scores + len(self.sought)

    @property
    def sought(self) -> list[int]:
        """Which of the spreads are unknown: the last columns of a point are their logs."""
        return [which for which, spread in enumerate(self.spreads) if spread is None]

    def wide(self, uniform: Floats) -> Floats:
        """Return points (d, p) of the unit cube (d, p) as draws of the priors, spreads about what is usual."""
        points = ndtri(uniform)
        points[:, self.scores :] = _USUAL[self.sought] + _WIDTH * points[:, self.scores :]
        return np.asarray(points)

    def log_wide(self, points: Floats) -> Floats:
        """Return the log density of `wide` : (d,) array."""
        middle, width = np.zeros(self.dimensions), np.ones(self.dimensions)
        middle[self.scores :], width[self.scores :] = _USUAL[self.sought], _WIDTH
        away = (points - middle) / width
        return np.asarray(-0.5 * np.sum(away**2 + np.log(2.0 * np.pi) + 2.0 * np.log(width), axis=1))

    def membranes(self, points: Floats) -> dict[str, Floats]:
        """Return the coordinates of the model at points (d, p), by name : (d,) arrays; thickness for bending."""
        shares = ndtr(points[:, : self.scores])
        found = {one.key: one.values(share) for one, share in zip(self.coordinates, shares.T, strict=True)}
        return found | {name: np.full(len(points), value) for name, value in self.known.items()}

    def spreads_at(self, points: Floats) -> Spreads:
        """Return the spreads at points (d, p)."""
        columns = [np.full(len(points), np.nan if spread is None else spread) for spread in self.spreads]
        for column, which in enumerate(self.sought, self.scores):
            columns[which] = np.maximum(np.exp(points[:, column]), _NARROWEST)
        return Spreads(*columns)

    def log_prior(self, points: Floats) -> Floats:
        """Return the log of the prior density : (d,) array."""
        logs = -0.5 * np.sum(points[:, : self.scores] ** 2 + np.log(2.0 * np.pi), axis=1)
        for log_spread, widest in zip(points[:, self.scores :].T, _WIDEST[self.sought], strict=True):
            share = np.exp(log_spread) / widest
            logs = logs + 0.5 * np.log(2.0 / np.pi) - np.log(widest) + log_spread - 0.5 * share**2
        return np.asarray(logs)
