"""The surrogate over (log Ca, a/l): branches, domain, its own error, and its validation."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.ndimage import binary_dilation, binary_erosion
from scipy.spatial import KDTree

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.database import LIMIT_OF_EXISTENCE, LOST_FROM_REST, SNAP_THROUGH, Database
from capsbayes.errors import DatabaseError, InputError
from capsbayes.measurement import MID_PLANE, SILHOUETTE, check_view
from capsbayes.model import TWO_SHAPES, UNSURE, UNSURE_SHAPES, WRINKLES, Domain, ForwardModel
from capsbayes.prediction import ERRING, NUMBERS, Prediction
from capsbayes.profile import vertex_normals
from capsbayes.surrogate.diffuse import (
    DiffuseApproximation,
    HermiteTable,
    PlaneScaling,
    each_left_out,
    hermite,
    leave_one_out,
)
from capsbayes.surrogate.inverse import DISTANCE_WEIGHTS, Inverse, inverse, rotated, solve

# Domain of existence: the part of the (Ca, a/l) plane that the steady shapes of a database cover.
#
# It is the union of one region for each branch of steady shapes, each between two polygonal lines over a/l. Outside,
# the approximation has no answer: nothing is extrapolated


def aligned(*values: ArrayLike) -> list[Floats]:
    """Return numbers and arrays as new arrays (n,) of one length."""
    return [np.array(each, np.float64) for each in np.broadcast_arrays(*map(np.atleast_1d, values))]


@dataclass(frozen=True, eq=False)
class Region:
    """Region between a lowest and a highest Ca, both given at columns of a/l and linear between them."""

    size_ratio: Floats  # (k,): of the columns, rising, k > 1
    lowest: Floats  # (k,): border in Ca
    highest: Floats  # (k,): border in Ca
    limit: Booleans  # (k,): True where the upper border is a limit of existence, False where the database ends

    def contains(self, capillary_number: Floats, size_ratio: Floats) -> Booleans:
        """Return whether each point lies in the region, borders included : (n,) bool array; NaN is outside."""
        return _contains(capillary_number, size_ratio, self.size_ratio, self.lowest, self.highest)

    def borders(self, size_ratio: float) -> tuple[float, float]:
        """Return the lowest and the highest Ca at one a/l."""
        return (
            float(np.interp(size_ratio, self.size_ratio, self.lowest)),
            float(np.interp(size_ratio, self.size_ratio, self.highest)),
        )


@dataclass(frozen=True, eq=False)
class DomainOfExistence(Domain):
    """Points (Ca, a/l) for which a surrogate has an answer: the union of the regions of its branches.

    Parameters
    ----------
    regions : tuple of Region
        One for each branch, without overlap.

    Examples
    --------
    >>> region = Region(np.array([0.8, 1.0]), np.array([0.01, 0.02]), np.array([0.15, 0.11]), np.array([False, True]))
    >>> DomainOfExistence((region,)).contains([0.05, 0.14, np.nan], [0.9, 0.9, 0.9]).tolist()
    [True, False, False]
    """

    regions: tuple[Region, ...]

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        lowest = min(float(region.lowest.min()) for region in self.regions)
        highest = max(float(region.highest.max()) for region in self.regions)
        first = min(float(region.size_ratio[0]) for region in self.regions)
        last = max(float(region.size_ratio[-1]) for region in self.regions)
        return (lowest, highest), (first, last)

    def contains(self, capillary_number: ArrayLike, size_ratio: ArrayLike, *coordinates: ArrayLike) -> Booleans:
        del coordinates
        ca, size = aligned(capillary_number, size_ratio)
        inside = np.zeros(len(ca), dtype=np.bool_)
        for region in self.regions:
            inside |= region.contains(ca, size)
        return inside

    def is_limit_of_existence(self, size_ratio: float) -> bool:
        top = max(self._at(size_ratio), key=lambda region: region.borders(size_ratio)[1], default=None)
        return top is not None and bool(top.limit[int(np.argmin(np.abs(top.size_ratio - size_ratio)))])

    def reason(self, capillary_number: float, size_ratio: float, **coordinates: float) -> str:
        del coordinates
        first, last = self.bounds[1]
        if not (np.isfinite(capillary_number) and np.isfinite(size_ratio)):
            return "expected finite numbers"
        if not first <= size_ratio <= last:
            return f"a/l runs from {first:.4g} to {last:.4g}"
        lowest = min(region.borders(size_ratio)[0] for region in self._at(size_ratio))
        if capillary_number < lowest:
            return f"the lowest Ca computed at this a/l is {lowest:.4g}"
        highest = max(region.borders(size_ratio)[1] for region in self._at(size_ratio))
        if capillary_number <= highest:
            return "it lies between two branches of steady shapes"
        end = "no steady shape is known above" if self.is_limit_of_existence(size_ratio) else "the database ends at"
        return f"at this a/l {end} Ca = {highest:.4g}"

    def _at(self, size_ratio: float) -> list[Region]:
        return [region for region in self.regions if region.size_ratio[0] <= size_ratio <= region.size_ratio[-1]]


@njit(cache=True, nogil=True)
def inside_borders(ca, size, columns, lowest, highest):  # type: ignore[no-untyped-def]
    """Return whether one point lies between the polygonal borders (compiled; NaN is outside)."""
    if not (columns[0] <= size <= columns[-1]):
        return False
    left, share = between_columns(size, columns)
    below = (1.0 - share) * lowest[left] + share * lowest[left + 1]
    above = (1.0 - share) * highest[left] + share * highest[left + 1]
    return below <= ca <= above


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def between_columns(size, columns):  # type: ignore[no-untyped-def]
    """Return the column at or below an a/l within the columns, and the share of the way to the next."""
    left, right = 0, len(columns) - 1
    while right - left > 1:
        middle = (left + right) // 2
        if columns[middle] <= size:
            left = middle
        else:
            right = middle
    return left, (size - columns[left]) / (columns[right] - columns[left])


@njit(cache=True, nogil=True)
def _contains(ca, size, columns, lowest, highest):  # type: ignore[no-untyped-def]
    inside = np.empty(len(ca), np.bool_)
    for i in range(len(ca)):
        inside[i] = inside_borders(ca[i], size[i], columns, lowest, highest)
    return inside


# Branches of steady shapes: parachutes (concave rear) and, at low Ca in a narrow channel, convex shapes.
#
# From one branch to the other the shape jumps, or changes with a kink, so no smooth approximation may average over
# both. The parachute depth of a case decides its branch. In each column of a/l the border between the branches lies
# between the highest convex case and the lowest parachute: at the snap-through if the database names one; where the
# rear turns concave smoothly, at the onset; else half way in sqrt(Ca). Between those two cases the branch of a capsule
# is unknown: this gap is stored with the branches. Elsewhere a branch ends at its own last converged case

CONVEX = 1e-4  # L_p/l below which a rear counts as convex; the cases have 0, or 0.02 and more
FEWEST_CASES = 9
SAME_COLUMN = 1e-6


@dataclass(frozen=True, eq=False)
class Branch:
    """Branch of steady shapes, ``"parachute"`` or ``"convex"``."""

    name: str
    rows: Integers  # (c,): its rows among the converged cases
    region: Region  # where the steady shape is of this branch
    gap: Region | None  # where it may be of this branch or of the other


def branches_of(database: Database) -> tuple[Branch, ...]:
    """Sort the converged cases into branches; omit one that is too small to approximate, refuse if none is left."""
    # A branch needs two columns of a/l with two cases each and nine cases in all.
    cases = database.converged
    ca, size = cases["capillary_number"], np.round(cases["size_ratio"], 6)
    convex = cases["parachute_depth"] < CONVEX
    columns = np.unique(size)
    low, high = np.array([_gap(ca[(size == s) & convex], ca[(size == s) & ~convex]) for s in columns]).T
    division = np.array([_division(cases, *ends) for ends in zip(columns, low, high, strict=True)])
    limit = _is_limit(cases, columns)
    split = np.isfinite(division)
    gap = _gap_region(columns, low, high, np.array([ca[size == s].min() for s in columns]))
    below = ca < division[np.searchsorted(columns, size)]
    branches = []
    for name, member in (("parachute", ~convex & ~below), ("convex", convex)):
        rows = np.flatnonzero(member)
        kept = np.array([np.count_nonzero(size[rows] == s) > 1 for s in columns], dtype=bool)
        if np.count_nonzero(kept) < 2 or len(rows) < FEWEST_CASES:
            continue
        lowest = np.array([ca[rows][size[rows] == s].min() for s in columns[kept]])
        highest = np.array([ca[rows][size[rows] == s].max() for s in columns[kept]])
        if name == "parachute":
            lowest = np.where(split[kept], division[kept], lowest)
        else:
            highest = division[kept]
        branches.append(Branch(name, rows, Region(columns[kept], lowest, highest, limit[kept]), gap))
    if not branches:
        raise DatabaseError(
            f"expected at least {FEWEST_CASES} converged cases of one kind, and two columns of a/l with two each, "
            f"got {len(ca)} cases in {len(columns)} columns"
        )
    return tuple(branches)


def _gap(convex: Floats, parachute: Floats) -> tuple[float, float]:
    """Return the highest convex and the lowest parachute Ca of one column; ignore parachutes below a convex case."""
    if not convex.size:
        return np.nan, np.nan
    above = parachute[parachute > convex.max()]
    return float(convex.max()), float(above.min() if above.size else convex.max())


def _division(cases: Database, column: float, low: float, high: float) -> float:
    """Return the border between the branches in the gap of one column, NaN without a convex case."""
    named = (np.abs(cases["border_size_ratio"] - column) < SAME_COLUMN) & (cases["border_kind"] == SNAP_THROUGH)
    candidates = list(cases["border_capillary_number"][named])
    above = (np.abs(cases["size_ratio"] - column) < SAME_COLUMN) & (cases["capillary_number"] >= high)
    ca = cases["capillary_number"][above]
    first = np.argsort(ca)[:2]
    ca, root = ca[first], np.sqrt(cases["parachute_depth"][above][first])
    if len(ca) == 2 and root[0] < root[1]:  # where a rear turns concave smoothly, its depth grows as a square
        candidates.append(ca[0] - root[0] * (ca[1] - ca[0]) / (root[1] - root[0]))
    return next((float(border) for border in candidates if low <= border <= high), (low**0.5 + high**0.5) ** 2 / 4)


def _gap_region(columns: Floats, low: Floats, high: Floats, lowest: Floats) -> Region | None:
    """Return the gap over the columns that have one; it closes at the lowest case of the neighbouring columns."""
    split = np.isfinite(low)
    if not split.any() or len(columns) < 2:
        return None
    next_to = binary_dilation(split) & ~split
    low, high, kept = np.where(next_to, lowest, low), np.where(next_to, lowest, high), split | next_to
    return Region(columns[kept], low[kept], high[kept], np.zeros(np.count_nonzero(kept), dtype=bool))


def _is_limit(cases: Database, columns: Floats) -> Booleans:
    upper = ~np.isin(cases["border_kind"], (SNAP_THROUGH, LOST_FROM_REST))
    if not upper.any():
        return np.zeros(len(columns), dtype=np.bool_)
    nearest = np.argmin(np.abs(cases["border_size_ratio"][upper] - columns[:, None]), axis=1)
    return cases["border_kind"][upper][nearest] == LIMIT_OF_EXISTENCE


# The surrogate's own error: covariance of (L_z, L_a, v_o/U) at every point of the domain.
#
# It derives from leave-one-out residuals: the difference between each case and the prediction from all others. The
# products of the three residuals of a case are averaged with smooth positive weights over the cases around the query
# (moving least squares of degree zero), so that the error does not vanish where one residual happens to, and the
# covariance is positive everywhere. Without a case its neighbourhood is sparser than that of any query, and on the
# border an interpolation becomes an extrapolation: a residual counts with the share `OF_LEFT_OUT`. With every second
# inner case of the shipped databases held out, the errors there are 0.58 of what the residuals of the others state (rms
# of 2041 cases, 0.14 to 0.83 by branch); with every second column of a/l held out, 0.34 to 0.84

NEIGHBOURS = 12
DILATION = 1.3
OF_LEFT_OUT = 0.7  # error next to a case over that where the case is left out
SOFTENING = 1.0  # a case counts about a fifth of the mean at its own place


class OwnError:
    """Covariance as a function of the point in the plane of the approximation, derived from residuals."""

    # `nodes` (m, 2) are the places of the cases, `residuals` (m, 3) the leave-one-out ones of (L_z, L_a, v_o/U); NaN
    # counts as the largest of all.

    def __init__(self, nodes: Floats, residuals: Floats) -> None:
        known = np.isfinite(residuals)
        largest = np.where(known, np.abs(residuals), 0.0).max(axis=0)
        residuals = np.where(known, residuals, largest)
        products = residuals[:, :, None] * residuals[:, None, :]
        self._field = DiffuseApproximation(
            nodes,
            products.reshape(len(products), 9),
            degree=0,
            neighbours=min(NEIGHBOURS, len(nodes) - 1),
            dilation=DILATION,
            softening=SOFTENING,
        )

    def shares(self, queries: Floats) -> Floats:
        """Return the non-negative share of each case in the mean at points of the plane : (n, 2) -> (n, m) array."""
        return self._field.shape_functions(queries)

    def covariance(self, queries: Floats) -> Floats:
        """Return the covariance at points of the plane : (n, 2) -> (n, 3, 3) array."""
        return self._field(queries).reshape(len(queries), 3, 3)


def mesh_error_of(attributes: Mapping[Any, Any]) -> Floats:
    """Return the relative errors of (L_z, L_a, v_o/U) due to the mesh from the attributes of a database, else zero.

    >>> mesh_error_of({"mesh_error": '{"axial_extent": 0.002, "axial_length": 0.001, "velocity_ratio": 0.0005}'})
    array([0.002 , 0.001 , 0.0005])
    """
    stated = attributes.get("mesh_error")
    if stated is None:
        return np.zeros(3)
    errors = json.loads(stated)
    return np.array([float(errors[name]) for name in ERRING])


# Points of the plane where the shape of a database need not be that of every capsule


@dataclass(frozen=True, eq=False)
class Caveats:
    """Caveats that the cases of a database imply."""

    two_shapes: Region | None  # where the shape reached from rest is unknown, or another is stable too
    scaling: PlaneScaling  # of the plane in which the nearest case is sought
    cases: Floats  # (c, 2): positions in that plane
    wrinkled: Booleans  # (c,): whether the axisymmetric shape is unstable to wrinkles

    @classmethod
    def of(cls, cases: Database, scaling: PlaneScaling) -> Caveats:
        """Derive the caveats from converged cases."""
        places = scaling.to_plane(cases["capillary_number"], cases["size_ratio"])
        return cls(_two_shapes(cases), scaling, places, np.asarray(cases["wrinkling_rate"] > 0.0))

    def __call__(self, capillary_number: Floats, size_ratio: Floats) -> dict[str, Booleans]:
        """Return by kind whether a caveat concerns each point : (n,) arrays."""
        caveats = {}
        if self.two_shapes is not None:
            caveats[TWO_SHAPES] = self.two_shapes.contains(capillary_number, size_ratio)
        if self.wrinkled.any():
            places = self.scaling.to_plane(capillary_number, size_ratio)
            known: Booleans = np.asarray(np.isfinite(places).all(axis=1))
            nearest = np.asarray(KDTree(self.cases).query(np.where(known[:, None], places, 0.0))[1])
            caveats[WRINKLES] = np.logical_and(known, self.wrinkled[nearest])
        return caveats


def _two_shapes(database: Database) -> Region | None:
    """Return the region below the highest snap-through of a column and its neighbours, None without two columns."""
    # At which Ca the membrane buckles varies at random. In a column where the branch from rest was lost before any
    # snap-through, the region reaches up to the highest snap-through of all columns.
    size, ca, kind = (database[f"border_{name}"] for name in ("size_ratio", "capillary_number", "kind"))
    marked = (kind == SNAP_THROUGH) | (kind == LOST_FROM_REST)
    if np.count_nonzero(marked) < 2:
        return None
    order = np.flatnonzero(marked)[np.argsort(size[marked])]
    highest = np.where(kind[order] == LOST_FROM_REST, ca[marked].max(), ca[order])
    highest = np.max([highest, np.append(highest[1:], 0.0), np.append(0.0, highest[:-1])], axis=0)
    lowest = np.full(len(order), database["capillary_number"].min())
    return Region(size[order], lowest, highest, np.zeros(len(order), dtype=np.bool_))


# Surrogate of one branch of steady shapes: a smooth map (Ca, a/l) -> (L_z, L_a, v_o/U, Lambda, outline).
#
# Moving least squares define the map, a fine table evaluates it fast, and leave-one-out residuals give its own error

CELLS = (160, 120)
OUTLINES = {MID_PLANE: "profile", SILHOUETTE: "silhouette"}  # variable of the database, by view
SAME_CASE = 1e-6  # of Ca and a/l
LARGEST_WEIGHTS, SURE_WEIGHTS = 25.0, 5.0  # sums of the sizes of the weights of the cases
FLOOR = 1e-5  # of each standard deviation: several times the table's own error
BASES = ((60, 4, 20), (15, 3, 12), (9, 2, 8), (0, 1, 5))  # from how many cases on (in more columns than), degree, k


class BranchSurrogate:
    """Forward map of one branch, from the converged cases that belong to it."""

    # `scaling` is that of the plane of the approximation, `rival` the approximation of the other branch: in the gap
    # their difference is part of the error. `cells` are those of the table along sqrt(Ca) and a/l.

    def __init__(
        self,
        cases: Database,
        branch: Branch,
        scaling: PlaneScaling,
        rival: DiffuseApproximation | None = None,
        cells: tuple[int, int] = CELLS,
        view: str = MID_PLANE,
    ) -> None:
        self.branch, self.scaling, self.view = branch, scaling, view
        self.cases = Database(cases.dataset.drop_vars(list(OUTLINES.values())))  # the outlines take most memory
        region, rows = branch.region, branch.rows
        self._lattice, self._wanted = _lattice(region, scaling, cells)
        probes = self._wanted & ~binary_erosion(self._wanted)  # where too sparse cases show first: the rim, some inside
        probes[::8, ::8] |= self._wanted[::8, ::8]
        try:
            approximation = approximation_of(cases, branch, scaling).covering(self._lattice[probes])
            self.approximation = approximation.covering(_within(self._lattice, region, scaling), LARGEST_WEIGHTS)
        except ValueError as error:
            raise DatabaseError(f"the {branch.name} cases cannot be approximated: {error}") from error
        self._outlines = replace(self.approximation, values=cases[OUTLINES[view]][rows].reshape(len(rows), -1))
        self.table = HermiteTable.of(self.approximation.with_gradient, self._lattice, self._wanted)
        steps = scaling.ca_step, scaling.size_step, *self.table.origin, *self.table.step
        self.frame = tuple(float(step) for step in steps)
        self._borders = region.size_ratio, region.lowest, region.highest
        self.lattice_jump = self._jumps(rival)
        own = self._with_mesh_error(self.on_lattice(self._own_error))
        self.lattice_covariance = own + self.lattice_jump

    def _with_mesh_error(self, covariance: Floats) -> Floats:
        """Add the error of the mesh to a covariance on the table's lattice."""
        values = self.table.coefficients[:, :, 0, :3]
        covariance[..., range(3), range(3)] += (mesh_error_of(self.cases.dataset.attrs) * values) ** 2
        return covariance

    def _jumps(self, rival: DiffuseApproximation | None) -> Floats:
        """Return the error in the gap of the branch on the table's lattice, zero elsewhere."""
        lattice, wanted = self._lattice, self._wanted
        covariance = np.zeros((*wanted.shape, 3, 3))
        if rival is not None and self.branch.gap is not None:
            ca, size = self.scaling.from_plane(lattice.reshape(-1, 2)).T.copy()
            in_gap = self.branch.gap.contains(ca, size).reshape(wanted.shape) & wanted
            jump = _jump(rival, lattice[in_gap], self.table.coefficients[in_gap][:, 0, :3])
            covariance[in_gap] = jump[:, :, None] * jump[:, None, :] / 2  # either branch with the same probability
        return covariance

    def difference_covariance(self, null: BranchSurrogate) -> Floats:
        """Return on the table's lattice the own error of the difference from the null slice of an effect."""
        # Two slices have the same cases, and much of their errors is the same.
        residuals = self._residuals - self._at_same_cases(null, null._residuals)
        covariance = self.on_lattice(OwnError(self.approximation.nodes, residuals))
        return covariance if null is self else self._with_mesh_error(covariance)

    def on_lattice(self, error: OwnError) -> Floats:
        """Return an error on the table's lattice : (i, j, 3, 3) array."""
        covariance = np.full((*self._wanted.shape, 3, 3), np.nan)
        covariance[self._wanted] = error.covariance(self._lattice[self._wanted])
        covariance[..., range(3), range(3)] += FLOOR**2
        return covariance

    def values_at(self, ca: Floats, size: Floats) -> Floats:
        """Return (L_z, L_a, v_o/U) at points of the region : (n, 3) array."""
        values: Floats = self.approximation(self.scaling.to_plane(ca, size))[:, :3]
        return values

    def predict(self, ca: Floats, size: Floats, values: Floats, covariance: Floats, inside: Booleans) -> None:
        """Fill in values (n, 4), covariance (n, 3, 3) and inside (n,) at the points that lie in the region."""
        frame = *self._borders, *self.frame
        _predict(ca, size, frame, self.table.coefficients, self.lattice_covariance, values, covariance, inside)

    def slopes(self, ca: Floats, size: Floats) -> Floats:
        """Return the derivatives of (L_z, L_a, v_o/U) by (Ca, a/l) at points of the region : (n, 3, 2) array."""
        by_plane = self.table.with_gradient(self.scaling.to_plane(ca, size))[1][:, :3]
        return by_plane * self.scaling.slopes(ca)[:, None, :]

    def outlines(self, ca: Floats, size: Floats) -> Floats:
        """Return the outlines at points of the region : (n, p, 2) array [l]."""
        return self._outlines(self.scaling.to_plane(ca, size)).reshape(len(ca), self._outlines.values.shape[1] // 2, 2)

    def outline_modes(self, ca: float, size: float, null: BranchSurrogate | None = None) -> Floats:
        """Return the own error of the outline at one point, as displacements along its normals : (k, p) array [l]."""
        # Independent of each other, each one standard deviation: those of the left-out cases, weighted by their shares
        # at the point, and those of the mesh: shifts of the rear rim and of the rear on the axis, or a stretch of a
        # silhouette. Given a null slice, those of the left-out cases in the difference from it.
        place = self.scaling.to_plane(np.array([ca]), np.array([size]))
        outline = self.outlines(np.array([ca]), np.array([size]))[0]
        normal = vertex_normals(outline)
        shares = self._own_error.shares(place)[0]
        near = shares > 1e-6
        residuals = self._outline_residuals
        if null is not None:
            residuals = residuals - self._at_same_cases(null, null._outline_residuals)
        left_out = np.sqrt(shares[near, None]) * residuals[near]
        if null is self:
            return left_out
        extent, length, _ = mesh_error_of(self.cases.dataset.attrs)
        if self.view == SILHOUETTE:  # which shows the rim, not the rear on the axis
            return np.stack([*left_out, extent * outline[:, 0] * normal[:, 0]])
        to_rear = np.clip(-normal[:, 0], 0.0, None)
        on_axis = np.abs(outline[:, 1]) < 0.5 * outline[:, 1].max()
        shift = np.ptp(outline[:, 0]) * to_rear
        return np.stack([*left_out, extent * shift * ~on_axis, length * shift * on_axis])

    @cached_property
    def _own_error(self) -> OwnError:
        return OwnError(self.approximation.nodes, self._residuals)

    @cached_property
    def _residuals(self) -> Floats:
        """Error (m, 3) next to each case."""
        return OF_LEFT_OUT * (leave_one_out(self.approximation) - self.approximation.values)[:, :3]

    @cached_property
    def _outline_residuals(self) -> Floats:
        """Normal displacement of the outline next to each case (m, p); zero if unknown."""
        own = self._outlines.values.reshape(len(self._outlines.values), -1, 2)
        away = leave_one_out(self._outlines).reshape(own.shape) - own
        normals = np.stack([vertex_normals(outline) for outline in own])
        return np.asarray(OF_LEFT_OUT * np.nan_to_num(np.sum(away * normals, axis=-1)))

    def _at_same_cases(self, null: BranchSurrogate, residuals: Floats) -> Floats:
        """Return the residuals (m, q) of a null slice at the cases (Ca, a/l) that it has too, zero at others."""
        rows, its = self.branch.rows, null.branch.rows
        mine = np.stack([self.cases["capillary_number"][rows], self.cases["size_ratio"][rows]], axis=1)
        theirs = np.stack([null.cases["capillary_number"][its], null.cases["size_ratio"][its]], axis=1)
        distance, row = KDTree(theirs).query(mine)
        return np.where(np.asarray(distance)[:, None] < SAME_CASE, residuals[row], 0.0)


def approximation_of(cases: Database, branch: Branch, scaling: PlaneScaling) -> DiffuseApproximation:
    """Approximate (L_z, L_a, v_o/U, Lambda) of a branch by moving least squares of a degree that its cases support."""
    rows = branch.rows
    nodes = scaling.to_plane(cases["capillary_number"][rows], cases["size_ratio"][rows])
    values = np.stack([cases[name][rows] for name in NUMBERS], axis=1)
    columns = len(branch.region.size_ratio)
    degree, neighbours = next((d, k) for fewest, d, k in BASES if len(rows) >= fewest and columns > d)
    return DiffuseApproximation(nodes, values, degree=degree, neighbours=min(neighbours, len(rows) - 2))


def _lattice(region: Region, scaling: PlaneScaling, cells: tuple[int, int]) -> tuple[Floats, Booleans]:
    """Return the table's lattice points (i, j, 2), and which of them lie in the region or within two cells of it."""
    ends = region.lowest.min(), region.highest.max()
    low, high = scaling.to_plane(np.array(ends), region.size_ratio[[0, -1]])
    axes = [np.linspace(low[k], high[k], cells[k] + 1) for k in range(2)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    ca, size = scaling.from_plane(lattice.reshape(-1, 2)).T
    size = np.clip(size, region.size_ratio[0], region.size_ratio[-1])  # rounding must not push the outer rows out
    inside = region.contains(np.ascontiguousarray(ca), size).reshape(lattice.shape[:2])
    return lattice, binary_dilation(inside, np.ones((5, 5), dtype=bool))


def _jump(rival: DiffuseApproximation, points: Floats, values: Floats) -> Floats:
    """Return the differences (n, 3) of the other branch from given values at points of the gap."""
    # None is larger in L_a than the largest where the other branch is well determined: elsewhere it is extrapolated.
    weights = rival.shape_functions(points)
    jump: Floats = rival(points)[:, :3] - values
    size, spread = np.nan_to_num(np.abs(jump[:, 1]), nan=np.inf), np.abs(weights).sum(axis=1)
    sure = np.flatnonzero(spread < SURE_WEIGHTS if (spread < SURE_WEIGHTS).any() else np.isfinite(size))
    if len(sure):
        largest = sure[np.argmax(size[sure])]
        jump[size > size[largest]] = jump[largest]
    return np.nan_to_num(jump)


def _within(lattice: Floats, region: Region, scaling: PlaneScaling) -> Floats:
    """Return every fourth lattice point in both directions that lies in the region : (n, 2) array."""
    points = lattice[::4, ::4].reshape(-1, 2)
    ca, size = scaling.from_plane(points).T.copy()
    return points[region.contains(ca, size)]


@njit(cache=True, nogil=True)
def _predict(ca, size, frame, coefficients, errors, values, covariance, inside):  # type: ignore[no-untyped-def]
    columns, lowest, highest, ca_step, size_step, x_origin, y_origin, x_step, y_step = frame
    predicted, no_slopes = np.empty(coefficients.shape[3]), np.empty((0, 2))
    for n in range(len(ca)):
        if not inside_borders(ca[n], size[n], columns, lowest, highest):
            continue
        inside[n] = True
        x = (np.sqrt(ca[n]) / ca_step - x_origin) / x_step
        y = (size[n] / size_step - y_origin) / y_step
        hermite(x, y, coefficients, predicted, no_slopes)
        for k in range(len(predicted)):  # numba takes seconds to compile an assignment of arrays
            values[n, k] = predicted[k]
        values[n, 0] = max(predicted[0], predicted[1])  # approximated separately, but equal where the rear is convex
        bilinear(x, y, errors, covariance[n])


@njit(cache=True, nogil=True)
def bilinear(x, y, lattice, out):  # type: ignore[no-untyped-def]
    """Fill in the bilinear mean of the matrices at the four lattice points around, which stays a covariance."""
    i = min(max(int(x), 0), lattice.shape[0] - 2)
    j = min(max(int(y), 0), lattice.shape[1] - 2)
    s, t = x - i, y - j
    for k in range(3):
        for m in range(3):
            left = (1.0 - t) * lattice[i, j, k, m] + t * lattice[i, j + 1, k, m]
            right = (1.0 - t) * lattice[i + 1, j, k, m] + t * lattice[i + 1, j + 1, k, m]
            out[k, m] = (1.0 - s) * left + s * right


# Surrogate of a database of steady shapes over the (Ca, a/l) plane, with its own error.
#
# Each branch of steady shapes has a smooth approximation over its part of the plane. A query is answered by the branch
# whose region it lies in; outside all regions there is no answer


class DatabaseModel(ForwardModel):
    """Forward model made of stored shapes, which says of its own error where it is large."""

    def caveats(self, theta: Mapping[str, ArrayLike]) -> dict[str, Booleans]:
        points = {name: np.atleast_1d(np.asarray(theta[name], np.float64)) for name in self.names if name in theta}
        caveats, predicted = self.case_caveats(points), self(points)
        variances = np.diagonal(predicted.covariance, axis1=1, axis2=2)[:, :2]
        unsure: Booleans = np.asarray((variances > (UNSURE * predicted.values[:, :2]) ** 2).any(axis=1))
        return caveats | {UNSURE_SHAPES: unsure} if unsure.any() else caveats

    def case_caveats(self, points: Mapping[str, Floats]) -> dict[str, Booleans]:
        """Return by kind whether a caveat of the stored shapes concerns each point : (n,) arrays."""
        del points
        return {}


class PlaneSurrogate(DatabaseModel):
    """Forward model (Ca, a/l) -> (L_z, L_a, v_o/U, Lambda, outline) over a database; parameters as of `Surrogate`."""

    domain: DomainOfExistence
    database: Database

    def __init__(self, database: Database, cells: tuple[int, int] = CELLS, view: str = MID_PLANE) -> None:
        self.cells, self.view = cells, check_view(view, "Surrogate", "view")
        if not isinstance(database, Database):
            advice = "open it first: Database.open(...)"
            raise InputError("Surrogate", "database", "a Database", repr(database)[:60], advice)
        cases, attributes = database.converged, database.dataset.attrs
        branches = branches_of(database)
        scaling = PlaneScaling.of(cases["capillary_number"], cases["size_ratio"])
        smooth = [approximation_of(cases, branch, scaling) for branch in branches]
        rivals = smooth[::-1] if len(branches) == 2 else [None]

        def smoothed(branch: Branch, rival: DiffuseApproximation | None) -> BranchSurrogate:
            return BranchSurrogate(cases, branch, scaling, rival, cells, view)

        with ThreadPoolExecutor() as pool:  # most of it is compiled, and runs on one core for each branch
            self.branches = tuple(pool.map(smoothed, branches, rivals))
        name = re.sub(r"[^a-z0-9]+", "-", f"{attributes['cross_section']}-{attributes['law']}".lower())
        self.name = name if view == MID_PLANE else f"{name} ({view}s)"
        self.database, self.sha256, self.cross_section = database, database.sha256, attributes["cross_section"]
        self.domain = DomainOfExistence(tuple(branch.region for branch in branches))
        self._caveats = Caveats.of(cases, scaling)

    def __call__(self, theta: Mapping[str, Floats], *, outline: bool = False) -> Prediction:
        self.check_names(theta)
        ca, size = aligned(theta["capillary_number"], theta["size_ratio"])
        values, covariance = np.full((len(NUMBERS), len(ca)), np.nan), np.full((len(ca), 3, 3), np.nan)
        inside = np.zeros(len(ca), dtype=np.bool_)
        for part in self.branches:
            part.predict(ca, size, values.T, covariance, inside)
        shapes = self._outlines(ca, size) if outline else None
        extent, length, velocity, stretch = values
        return Prediction(extent, length, velocity, stretch, covariance, inside, shapes)

    def case_caveats(self, points: Mapping[str, Floats]) -> dict[str, Booleans]:
        return self._caveats(*aligned(points["capillary_number"], points["size_ratio"]))

    def outline_modes(self, **theta: float) -> Floats:
        self.check_names(theta)
        point = theta["capillary_number"], theta["size_ratio"]
        for part in self.branches:
            if part.branch.region.contains(np.array(point[:1]), np.array(point[1:]))[0]:
                return part.outline_modes(*point)
        raise self._outside(theta)

    def gradient(self, *, capillary_number: ArrayLike, size_ratio: ArrayLike) -> Floats:
        """Derivatives of (L_z, L_a, v_o/U) by (Ca, a/l) : (n, 3, 2) array, NaN outside the domain."""
        ca, size = aligned(capillary_number, size_ratio)
        gradient = np.full((len(ca), 3, 2), np.nan)
        for part in self.branches:
            here = part.branch.region.contains(ca, size)
            gradient[here] = part.slopes(ca[here], size[here])
        return gradient

    def _outlines(self, ca: Floats, size: Floats) -> Floats:
        outlines = np.full((len(ca), self.database.dataset.sizes["point"], 2), np.nan)
        for part in self.branches:
            here = np.flatnonzero(part.branch.region.contains(ca, size))
            if len(here):
                outlines[here] = part.outlines(ca[here], size[here])
        return outlines


# Leave-one-out over a database: errors of (Ca, a/l, v_o/U) identified from (L_z, L_a) of a case left out.
#
# Two methods are compared: the inverse procedure of the paper, and the inversion of the forward map (`inversion`). The
# relative errors are those of the paper, |theta - theta_i| / theta_i

PARAMETERS = ("capillary_number", "size_ratio", "velocity_ratio")
STRETCH_LIMIT = 1.04  # of the profile, above which the paper recommends its method
PAPER_CASES = 137
PAPER_ERRORS = {"mean": (0.027, 0.002, 0.002), "sd": (0.041, 0.001, 0.002)}
CHOICES = {
    "all": "all",
    "stretched": f"Λ > {STRETCH_LIMIT}",
    "parachute": "and L_p > 0",  # a convex shape has one length, not two
}
STARTS = 4


@dataclass(frozen=True, eq=False)
class Summary:
    """Mean, standard deviation and median of the relative errors of (Ca, a/l, v_o/U); number of cases and failures."""

    mean: Floats
    sd: Floats
    median: Floats
    cases: int
    failed: int


@dataclass(frozen=True, eq=False)
class LeaveOneOut:
    """Relative errors of one method at every case."""

    method: str  # its name in tables
    truth: Floats  # (c, 3): (Ca, a/l, v_o/U) of the cases
    stretch_ratio: Floats  # (c,): Lambda
    parachute_depth: Floats  # (c,): L_p [l]
    errors: Floats  # (c, 3): NaN where the method has no answer

    def chosen(self, which: str) -> Booleans:
        """Return the cases of one of `CHOICES` : (c,) bool array."""
        chosen = np.ones(len(self.errors), dtype=np.bool_)
        if which != "all":
            chosen &= self.stretch_ratio > STRETCH_LIMIT
        if which == "parachute":
            chosen &= self.parachute_depth > CONVEX
        return chosen

    def summary(self, which: str = "all") -> Summary:
        """Return the statistics over the cases of one of `CHOICES`."""
        errors = self.errors[self.chosen(which)]
        good = errors[np.isfinite(errors).all(axis=1)]
        mean, sd, median = good.mean(axis=0), good.std(axis=0), np.median(good, axis=0)
        return Summary(mean, sd, median, len(errors), len(errors) - len(good))


def validate_inverse(database: Database) -> LeaveOneOut:
    """Validate the inverse procedure of the paper by leave-one-out."""
    whole = inverse(database)

    def answer_without(i: int) -> Floats:
        keep = np.arange(len(whole.parameters)) != i
        rest = Inverse(
            whole.parameters[keep],
            whole.lengths[keep],
            whole.velocity_ratio[keep],
            whole.contours[keep],
            whole.neighbours,
        )
        answer = rest(axial_extent=whole.lengths[i, 0], axial_length=whole.lengths[i, 1])
        return np.array([answer.capillary_number, answer.size_ratio, answer.velocity_ratio])

    return _errors_of("paper's inverse", database, np.array([answer_without(i) for i in range(len(whole.parameters))]))


def validate_forward_map(database: Database) -> LeaveOneOut:
    """Validate the forward map, inverted for (Ca, a/l) from (L_z, L_a), by leave-one-out."""
    # The two lengths determine whether the rear is concave, and so the branch. The inversion starts at the cases of
    # that branch whose lengths are nearest, so that it does not use the answer; where no point gives both lengths
    # exactly, the nearest one in least squares is the answer.
    cases = database.converged
    scaling = PlaneScaling.of(cases["capillary_number"], cases["size_ratio"])
    answers = np.full((len(cases), 3), np.nan)
    for branch in branches_of(database):
        whole = approximation_of(cases, branch, scaling)
        for row, i, rest in zip(branch.rows, range(len(branch.rows)), each_left_out(whole), strict=True):
            point = _searched(rest, whole.values[i, :2])
            answers[row, :2] = scaling.from_plane(point)
            answers[row, 2] = rest(point[None])[0, 2]
    return _errors_of("forward map", database, answers)


def _searched(rest: DiffuseApproximation, lengths: Floats) -> Floats:
    """Return the point of the plane at which the approximation gives the lengths."""
    distance = (rotated(rest.values[:, :2]) - rotated(lengths)) ** 2 @ np.array(DISTANCE_WEIGHTS)
    starts = rest.nodes[np.argsort(distance, kind="stable")[:STARTS]]

    def forward(points: Floats) -> tuple[Floats, Floats]:
        values, gradients = rest.with_gradient(points)
        return values[:, :2], gradients[:, :2]

    return solve(forward, lengths, starts)


def even_subset(database: Database, count: int = PAPER_CASES) -> Database:
    """Choose cases spread evenly over the domain: each next one is the farthest from those already chosen."""
    # Distances are in (Ca, a/l), each over its range; the first case is the nearest to the middle.
    cases = database.converged
    points = np.stack([cases["capillary_number"], cases["size_ratio"]], axis=1)
    points = (points - points.min(axis=0)) / np.ptp(points, axis=0)
    chosen = [int(np.argmin(np.sum((points - 0.5) ** 2, axis=1)))]
    distance = np.sum((points - points[chosen[0]]) ** 2, axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.sum((points - points[chosen[-1]]) ** 2, axis=1))
    return Database(cases.dataset.isel(case=np.sort(chosen)))


def _errors_of(method: str, database: Database, answers: Floats) -> LeaveOneOut:
    cases = database.converged
    truth = np.stack([cases[name] for name in PARAMETERS], axis=1)
    errors = np.abs(answers - truth) / truth
    return LeaveOneOut(method, truth, cases["stretch_ratio"], cases["parachute_depth"], errors)
