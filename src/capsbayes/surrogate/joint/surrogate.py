"""Surrogate with one more coordinate, the parameter that an effect database varies.

It has one surrogate per value of the parameter, the *slices*, on a mesh that may
be coarse, and a *base* surrogate on a finer mesh at the null value. The difference
of the slices from the null slice is added to the base, so that the error of the
coarse mesh is not mistaken for physics.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.database import Database
from capsbayes.errors import DatabaseError
from capsbayes.model import CoordinateRange, ForwardModel
from capsbayes.prediction import Prediction
from capsbayes.profile import vertex_normals
from capsbayes.surrogate.branch_surrogate import COLUMNS, BranchSurrogate
from capsbayes.surrogate.caveats import with_unsure_shapes
from capsbayes.surrogate.joint.cardinal import FEWEST_KNOTS, CardinalCubics
from capsbayes.surrogate.joint.correspondence import BRANCHES, Borders, common_folds, matched, moving_borders
from capsbayes.surrogate.joint.domain import LINEAR, SCALES, EffectDomain, Scale
from capsbayes.surrogate.joint.kernel import Stack, Weighing, corresponding, evaluate, located
from capsbayes.surrogate.own_error import OwnError
from capsbayes.surrogate.plane_surrogate import PlaneSurrogate

SLICE_CELLS = (80, 60)  # a quarter of the memory of the base's tables; reading them takes most of the time


@dataclass(frozen=True, eq=False)
class EffectSurrogate(ForwardModel):
    """Forward model (Ca, a/l, effect) -> (L_z, L_a, v_o/U, Lambda, outline).

    Parameters
    ----------
    effect_database : Database
        Steady shapes at a few values of one parameter.
    slices : tuple of PlaneSurrogate
        One for each value.
    base : PlaneSurrogate
        Of a finer mesh at the null value, or the null slice itself.

    Attributes
    ----------
    domain : EffectDomain
        Where it has an answer: for parachutes and for convex shapes between the values that have them.
    """

    effect_database: Database
    slices: tuple[PlaneSurrogate, ...] = field(repr=False)
    base: PlaneSurrogate = field(repr=False)
    domain: EffectDomain = field(init=False, repr=False)
    _stack: Stack = field(init=False, repr=False)
    _base_stack: Stack = field(init=False, repr=False)

    def __post_init__(self) -> None:
        database, slices, base = self.effect_database, self.slices, self.base
        if base.cross_section != database.dataset.attrs["cross_section"]:
            expected = f"a {database.dataset.attrs['cross_section']} cross-section"
            raise DatabaseError(f"base of {database.effect!r}: expected {expected}, got {base.name}")
        values, null = database.values, int(np.searchsorted(database.values, database.null_value))
        columns = _common_columns([*slices, base])
        borders = [Borders.of(surrogate, columns) for surrogate in slices]
        base_borders, borders[null] = matched(Borders.of(base, columns), borders[null])
        scale = SCALES.get(database.effect, LINEAR)
        with np.errstate(divide="ignore"):  # a scale may be a limit at an end
            knots = scale.place(values)
        moving = moving_borders(knots, borders, null, base_borders)
        folds = common_folds(borders, base_borders)
        weighing = Weighing(knots, null, columns, moving, folds, *_cardinal(values, borders, scale))
        coordinate = database.effect
        ends = CoordinateRange(float(values[0]), float(values[-1]), database.null_value)
        made = {
            "name": f"{base.name} with {coordinate}",
            "sha256": hashlib.sha256(f"{base.sha256} {database.sha256}".encode()).hexdigest(),
            "domain": EffectDomain(weighing, scale, coordinate, ends),
            "cross_section": base.cross_section,
            "view": base.view,
            "coordinates": {coordinate: ends},
            "database": base.database,
            "_stack": _stacked(slices, borders, null),
            "_base_stack": _stacked([base], [base_borders], 0),
        }
        for name, value in made.items():
            object.__setattr__(self, name, value)
        self._base_stack.differences[:] = self._mesh_differences()

    @property
    def coordinate(self) -> str:
        """Name of the coordinate that is added to (Ca, a/l), as in `capsbayes.parameters`."""
        return self.effect_database.effect

    def __call__(self, theta: Mapping[str, Floats], *, outline: bool = False) -> Prediction:
        """Predict a batch, at the null value without the coordinate; outside the domain NaN, with ``inside`` False."""
        self.check_names(theta)
        ca, size, place = self._points(theta)
        values, covariance = np.full((len(ca), len(COLUMNS)), np.nan), np.full((len(ca), 3, 3), np.nan)
        inside = np.zeros(len(ca), dtype=np.bool_)
        tables = self._stack, self._base_stack, self.domain.weighing
        evaluate(ca, size, place, *tables, values, covariance, inside)
        shapes = self._outlines(ca, size, place) if outline else None
        columns = values.T.copy()
        return Prediction(columns[0], columns[1], columns[2], columns[3], covariance, inside, shapes)

    def outline_modes(self, **theta: float) -> Floats:
        """Return the own error of the outline at one point, as independent displacements along its normals."""
        # As in the covariance of a prediction: errors of the base, weighted errors of the slices, that of the
        # interpolation between the slices, and that of the mesh where it may change with the effect.
        self.check_names(theta)
        ca, size, effect = self._points(theta)
        weighing = self.domain.weighing
        interval, _, _, row = located(ca[0], size[0], effect[0], weighing, np.empty(4))
        if row < 0:
            raise self._outside(theta)
        branches, places, weights, apart = self._corresponding(ca, size, effect)
        normal = vertex_normals(self._outlines(ca, size, effect)[0])
        left_out, (first, last) = weighing.left_out[row, interval], weighing.ends[row, interval]
        corrected = weights[0, -1] != 0.0
        needed = (weights[0] != 0.0) | np.append(left_out.any(axis=0), [corrected, False])
        own, unlike, null = np.append(weights[0, :-2], [0.0, weights[0, -1]]), np.ones(len(needed)), None
        if corrected:
            null, unlike[:-2] = _part(self.slices[weighing.null], branches[0]), apart[0]
            own[weighing.null] += weights[0, -2] + 1.0
            own[-2] = own[:-2] @ (1.0 - unlike[:-2]) - 1.0
        modes, along = [], np.zeros((len(needed), len(normal)))
        for j in np.flatnonzero(needed):
            part = _part(self._surrogates[j], branches[0])
            along[j] = np.sum(part.outlines(places[:, j], size)[0] * normal, axis=1)
            for share, less in ((unlike[j], None), (1.0 - unlike[j], null)):
                if own[j] != 0.0 and share > 0.0:
                    modes.append(own[j] * share**0.5 * part.outline_modes(places[0, j], size[0], less))
        bump = 4.0 * (effect[0] - first) * (last - effect[0]) / (last - first) ** 2
        far = (effect[0] - weighing.knots[weighing.null]) / np.ptp(weighing.knots)
        if corrected:
            step = _part(self.base, branches[0]).scaling.ca_step
            beyond = np.abs(np.diff(np.sqrt([ca[0], places[0, -1], places[0, -2]]))).sum() / step
            far = np.hypot(far, min(beyond, 1.0))
        return np.concatenate([*modes, bump * left_out @ along[:-2], far * (along[-1] - along[-2])[None]])

    def caveats(self, theta: Mapping[str, ArrayLike]) -> dict[str, Booleans]:
        """Return the caveats of the two slices next to each point, at the points of these that correspond to it."""
        ca, size, place = self._points(theta)
        knots, points = self.domain.weighing.knots, np.arange(len(ca))
        branches, there, *_ = self._corresponding(ca, size, place)
        there[branches < 0] = ca[branches < 0, None]
        each = [surrogate.case_caveats(there[:, j], size) for j, surrogate in enumerate(self.slices)]
        below = np.clip(np.searchsorted(knots, place, side="right") - 1, 0, len(knots) - 2)
        combined = {}
        for kind in sorted({kind for caveats in each for kind in caveats}):
            of_slice = np.stack([caveats.get(kind, np.zeros(len(ca), dtype=np.bool_)) for caveats in each])
            combined[kind] = of_slice[below, points] | (of_slice[below + 1, points] & (place > knots[below]))
        return with_unsure_shapes(combined, self({name: np.asarray(values) for name, values in theta.items()}))

    def _points(self, theta: Mapping[str, ArrayLike]) -> list[Floats]:
        effect = self.domain.place(theta.get(self.coordinate, self.domain.ends.null_value))
        arrays = (np.atleast_1d(theta["capillary_number"]), np.atleast_1d(theta["size_ratio"]), effect)
        return [np.array(array, np.float64) for array in np.broadcast_arrays(*arrays)]

    @property
    def _surrogates(self) -> list[PlaneSurrogate]:
        """Slices, null slice as it is subtracted, base."""
        return [*self.slices, self.slices[self.domain.weighing.null], self.base]

    def _corresponding(self, ca: Floats, size: Floats, effect: Floats) -> tuple[Integers, Floats, Floats, Floats]:
        """Return the branch (n,), the Ca and the weight (n, k + 2) of each of `_surrogates`, see `corresponding`."""
        branches, weights = np.empty(len(ca), np.int64), np.zeros((len(ca), len(self.slices) + 2))
        places, apart = np.empty_like(weights), np.ones((len(ca), len(self.slices)))
        tables = self._stack, self._base_stack, self.domain.weighing
        corresponding(ca, size, effect, *tables, branches, places, weights, apart)
        return branches, places, weights, apart

    def _mesh_differences(self) -> Floats:
        """Return on the table's lattices of the base the mean square of its difference from the null slice."""
        null = self.slices[self.domain.weighing.null]
        covariance = np.full((len(BRANCHES), *(count + 1 for count in self.base.cells), 3, 3), np.nan)
        for part in self.base.branches:
            k, rows = BRANCHES.index(part.branch.name), part.branch.rows
            ca, size = part.cases["capillary_number"][rows], part.cases["size_ratio"][rows]
            place = np.full(len(ca), self.domain.weighing.knots[self.domain.weighing.null])
            branches, places, weights, _ = self._corresponding(ca, size, place)
            both = np.flatnonzero((branches == k) & (weights[:, -1] != 0.0))
            if len(both) > 1:
                there = _part(null, k).values_at(places[both, -2], size[both])
                of_mesh = part.values_at(places[both, -1], size[both]) - there
                covariance[k] = part.on_lattice(OwnError(part.approximation.nodes[both], of_mesh))
        return covariance.reshape(-1, *covariance.shape[2:])

    def _outlines(self, ca: Floats, size: Floats, effect: Floats) -> Floats:
        branches, places, weights, _ = self._corresponding(ca, size, effect)
        outlines = np.full((len(ca), self.effect_database.dataset.sizes["point"], 2), np.nan)
        outlines[branches >= 0] = 0.0
        for j, surrogate in enumerate(self._surrogates):
            for part in surrogate.branches:
                here = np.flatnonzero((branches == BRANCHES.index(part.branch.name)) & (weights[:, j] != 0.0))
                if len(here):
                    outlines[here] += weights[here, j, None, None] * part.outlines(places[here, j], size[here])
        return outlines


def _part(surrogate: PlaneSurrogate, branch: int) -> BranchSurrogate:
    return next(part for part in surrogate.branches if part.branch.name == BRANCHES[branch])


def check_values(database: Database) -> None:
    """Refuse an effect database whose values do not make a coordinate."""
    values = database.values
    if len(values) < FEWEST_KNOTS or database.null_value not in values:
        expected = f"at least {FEWEST_KNOTS} values of {database.effect}, {database.null_value:g} among them"
        raise DatabaseError(f"effect database: expected {expected}, got {', '.join(f'{value:g}' for value in values)}")


def _common_columns(surrogates: list[PlaneSurrogate]) -> Floats:
    """Return every column of a/l of any surrogate that lies within the columns of all of them."""
    regions = [[part.branch.region.size_ratio for part in each.branches] for each in surrogates]
    first = max(min(columns[0] for columns in several) for several in regions)
    last = min(max(columns[-1] for columns in several) for several in regions)
    every = np.unique(np.round(np.concatenate([columns for several in regions for columns in several]), 6))
    return every[(every >= first - 1e-9) & (every <= last + 1e-9)]


def _cardinal(values: Floats, borders: list[Borders], scale: Scale) -> tuple[Integers, Floats, Floats, Floats]:
    """Return the row of weights of each branch between two columns, and the weights of each set of known slices."""
    with np.errstate(divide="ignore"):  # a scale may be a limit at an end
        knots = scale.place(values)
    known = np.stack([each.known for each in borders], axis=-1)  # (branch, column, slice)
    enough = known.sum(axis=-1) >= FEWEST_KNOTS
    sets, which = np.unique(known[enough], axis=0, return_inverse=True)
    cardinal = [CardinalCubics(knots, some) for some in sets]
    rows = np.full(enough.shape, -1, dtype=np.int64)
    rows[enough] = np.ravel(which)
    cubics, left_out, ends = (
        np.stack([getattr(cubics, name) for cubics in cardinal]) for name in ("cubics", "left_out", "ends")
    )
    if scale.approximate:  # twice the difference: simulated transients differ by up to that
        middle = (knots[1:] + knots[:-1]) / 2
        linear = [CardinalCubics(values, some) for some in sets]
        other = [
            [2.0 * (plain.weights(float(scale.value(place))) - curved.weights(place)) for place in middle]
            for plain, curved in zip(linear, cardinal, strict=True)
        ]
        left_out = np.concatenate([left_out, np.nan_to_num(other)[:, :, None]], axis=2)
    return rows, cubics, left_out, ends


def _stacked(surrogates: Sequence[PlaneSurrogate], borders: Sequence[Borders], null: int) -> Stack:
    cells = tuple(count + 1 for count in surrogates[0].cells)
    shape = (len(BRANCHES), len(surrogates))
    frames = np.ones((*shape, 6))
    coefficients = np.full((*shape, *cells, 4, len(COLUMNS)), np.nan)
    errors, differences, jumps = np.full((3, *shape, *cells, 3, 3), np.nan)
    of_null = {part.branch.name: part for part in surrogates[null].branches}
    for j, surrogate in enumerate(surrogates):
        for part in surrogate.branches:
            k = BRANCHES.index(part.branch.name)
            frames[k, j], errors[k, j] = part.frame, part.lattice_covariance - part.lattice_jump
            jumps[k, j] = part.lattice_jump
            if part.branch.name in of_null:
                differences[k, j] = part.difference_covariance(of_null[part.branch.name])
            coefficients[k, j] = part.table.coefficients
    return Stack(
        frames,
        cells[0],
        coefficients.reshape(-1, *coefficients.shape[3:]),
        errors.reshape(-1, *errors.shape[3:]),
        differences.reshape(-1, *differences.shape[3:]),
        jumps.reshape(-1, *jumps.shape[3:]),
        np.stack([each.capillary_number for each in borders]),
        np.stack([each.known for each in borders], axis=1),
    )
