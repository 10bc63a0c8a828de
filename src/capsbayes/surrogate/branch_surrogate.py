"""Surrogate of one branch of steady shapes: a smooth map (Ca, a/l) -> (L_z, L_a, v_o/U, Lambda, outline).

Moving least squares define the map, a fine table evaluates it fast, and
leave-one-out residuals give its own error.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numba import njit
from scipy.ndimage import binary_dilation, binary_erosion
from scipy.spatial import KDTree

from capsbayes.arrays import Booleans, Floats
from capsbayes.database import Database
from capsbayes.errors import DatabaseError
from capsbayes.measured_outline import MID_PLANE, SILHOUETTE
from capsbayes.profile import vertex_normals
from capsbayes.surrogate.branches import Branch
from capsbayes.surrogate.diffuse import DiffuseApproximation, leave_one_out
from capsbayes.surrogate.domain import Region, inside_borders
from capsbayes.surrogate.own_error import OF_LEFT_OUT, OwnError, mesh_error_of
from capsbayes.surrogate.scaling import PlaneScaling
from capsbayes.surrogate.table import HermiteTable, hermite

COLUMNS = ("axial_extent", "axial_length", "velocity_ratio", "stretch_ratio")
CELLS = (160, 120)
OUTLINES = {MID_PLANE: "profile", SILHOUETTE: "silhouette"}  # variable of the database, by view
SAME_CASE = 1e-6  # of Ca and a/l
LARGEST_WEIGHTS, SURE_WEIGHTS = 25.0, 5.0  # sums of the sizes of the weights of the cases
FLOOR = 1e-5  # of each standard deviation: several times the table's own error
BASES = ((60, 4, 20), (15, 3, 12), (9, 2, 8), (0, 1, 5))  # from how many cases on (in more columns than), degree, k


@dataclass(frozen=True, eq=False)
class BranchSurrogate:
    """Forward map of one branch, from the converged cases that belong to it."""

    cases: Database
    branch: Branch
    scaling: PlaneScaling  # of the plane of the approximation
    rival: DiffuseApproximation | None = None  # of the other branch: in the gap their difference is part of the error
    cells: tuple[int, int] = CELLS  # of the table along sqrt(Ca) and a/l
    view: str = MID_PLANE  # one of `OUTLINES`
    approximation: DiffuseApproximation = field(init=False, repr=False)
    table: HermiteTable = field(init=False, repr=False)
    lattice_covariance: Floats = field(init=False, repr=False)
    lattice_jump: Floats = field(init=False, repr=False)
    _outlines: DiffuseApproximation = field(init=False, repr=False)
    _frame: tuple[Any, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        region, rows = self.branch.region, self.branch.rows
        lattice, wanted = _lattice(region, self.scaling, self.cells)
        try:
            approximation = approximation_of(self.cases, self.branch, self.scaling).covering(_probes(lattice, wanted))
            approximation = approximation.covering(_within(lattice, region, self.scaling), LARGEST_WEIGHTS)
        except ValueError as error:
            raise DatabaseError(f"the {self.branch.name} cases cannot be approximated: {error}") from error
        low, high = lattice[0, 0], lattice[-1, -1]
        outlines = self.cases[OUTLINES[self.view]][rows].reshape(len(rows), -1)
        table = HermiteTable.of(approximation.with_gradient, low, high, cells=self.cells, wanted=wanted)
        steps = (self.scaling.ca_step, self.scaling.size_step, *table.origin, *table.step)
        made = {
            "approximation": approximation,
            "table": table,
            "_outlines": replace(approximation, values=outlines),
            "_frame": (region.size_ratio, region.lowest, region.highest, *(float(step) for step in steps)),
        }
        for name, value in made.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "lattice_jump", self._jumps(lattice, wanted))
        own = self._with_mesh_error(self.on_lattice(self._own_error))
        object.__setattr__(self, "lattice_covariance", own + self.lattice_jump)

    def _with_mesh_error(self, covariance: Floats) -> Floats:
        """Add the error of the mesh to a covariance on the table's lattice."""
        values = self.table.coefficients[:, :, 0, :3]
        covariance[..., range(3), range(3)] += (mesh_error_of(self.cases.dataset.attrs) * values) ** 2
        return covariance

    def _jumps(self, lattice: Floats, wanted: Booleans) -> Floats:
        """Return the error in the gap of the branch on the table's lattice, zero elsewhere."""
        covariance = np.zeros((*wanted.shape, 3, 3))
        if self.rival is not None and self.branch.gap is not None:
            ca, size = self.scaling.from_plane(lattice.reshape(-1, 2)).T.copy()
            in_gap = self.branch.gap.contains(ca, size).reshape(wanted.shape) & wanted
            jump = _jump(self.rival, lattice[in_gap], self.table.coefficients[in_gap][:, 0, :3])
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
        lattice, wanted = _lattice(self.branch.region, self.scaling, self.cells)
        covariance = np.full((*wanted.shape, 3, 3), np.nan)
        covariance[wanted] = error.covariance(lattice[wanted])
        covariance[..., range(3), range(3)] += FLOOR**2
        return covariance

    def values_at(self, ca: Floats, size: Floats) -> Floats:
        """Return (L_z, L_a, v_o/U) at points of the region : (n, 3) array."""
        values: Floats = self.approximation(self.scaling.to_plane(ca, size))[:, :3]
        return values

    def predict(self, ca: Floats, size: Floats, values: Floats, covariance: Floats, inside: Booleans) -> None:
        """Fill in values (n, 4), covariance (n, 3, 3) and inside (n,) at the points that lie in the region."""
        _predict(ca, size, self._frame, self.table.coefficients, self.lattice_covariance, values, covariance, inside)

    @property
    def frame(self) -> tuple[float, ...]:
        """Steps of the scaling along sqrt(Ca) and a/l, origin of the table (2), its steps (2)."""
        return self._frame[3:]

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
    values = np.stack([cases[name][rows] for name in COLUMNS], axis=1)
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


def _probes(lattice: Floats, wanted: Booleans) -> Floats:
    """Return lattice points (n, 2) where too sparse cases show first: on the rim of the region, and some inside."""
    probes = wanted & ~binary_erosion(wanted)
    probes[::8, ::8] |= wanted[::8, ::8]
    return lattice[probes]


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
