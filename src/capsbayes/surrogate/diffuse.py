"""Diffuse approximation (moving least squares) of tabulated values, and its tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from capsbayes.arrays import Booleans, Floats
from capsbayes.least_squares import factorise, substitute

# Diffuse approximation (moving least squares) of scattered values in the plane, with its exact gradient.
#
# The value at a query is that of the polynomial fitted there by weighted least squares (Nayroles, Touzot and Villon,
# Comput. Mech. 10, 307 (1992), doi:10.1007/BF00364252). Each case has its own radius, a multiple of the distance to its
# k-th neighbour, and its weight is a smooth function of the distance over that radius. So the weights, the value and
# the gradient vary smoothly with the query, whether the cases are dense or sparse.
#
# Alternatives were compared by leave-one-out over the 303 parachutes of the shipped square-neo-hookean database: mean
# error of Ca [%] over the 173 with Lambda > 1.04, from the residuals of (L_z, L_a) through the inverse of their
# gradient. One choice is changed at a time.
#
# ==================  =======================================================================
# as chosen           0.27: degree 4, k = 20, dilation 2, weight (1 - s)^4 / (s + 0.03^2) with
#                     s = (distance/radius)^2, plane (sqrt(Ca), a/l), branches apart
# degree              1: 0.65, 2: 0.43, 3: 0.34, 5: 0.33 (with k = 6, 9, 13, 28)
# neighbours          k = 17: 0.30, 26: 0.31
# dilation            1.7: 0.34, 2.5: 0.34
# softening           0.003: 0.27, 0.1: 0.28, 0.3: 0.31
# weight              the paper's 2 D^3 - 3 D^2 + 1: 0.49, Wendland's C2: 0.35, (1 - s)^4 without
#                     the pole: 0.39, exponent 2 or 6 with it: 0.32, 0.29
# plane               log(Ca): 0.28, Ca: 0.32; both steps as if cases lay half as far, or twice as
#                     far apart along Ca: 0.30, 0.37
# branches together   0.39, and several per cent at low Ca, where the shape jumps
# ==================  =======================================================================
#
# With a pole in the weight the approximation nearly interpolates, which is an advantage as the cases have little noise.
# Softening by 0.03 keeps the derivatives small

DEGREE = 4
NEIGHBOURS = 20
DILATION = 2.0
SOFTENING = 0.03
SMALLEST_PIVOT = 1e-14
_PART = 1000  # queries, at most


@dataclass(eq=False)
class DiffuseApproximation:
    """Moving least squares over m nodes; a query within the radius of too few nodes gives NaN.

    Parameters
    ----------
    nodes : (m, 2) array
        Positions, in coordinates where the function varies about equally in all directions.
    values : (m, q) array
        The q quantities at the nodes.
    degree : int
        Total degree of the local polynomial.
    neighbours : int
        The k of the k-th neighbour that sets each node's radius.
    dilation : float
        Radius over the distance to the k-th neighbour.
    softening : float
        Share of the radius inside which the weight stops growing towards the node.
    radii : (m,) array, optional
        Radii of the nodes; by default they are set from their neighbours.

    Examples
    --------
    >>> nodes = np.random.default_rng(0).uniform(size=(60, 2))
    >>> plane = DiffuseApproximation(nodes, (1 + nodes @ [[2.0], [3.0]]))
    >>> value, gradient = plane.with_gradient(np.array([[0.5, 0.5]]))
    >>> value.round(9).tolist(), gradient.round(9).tolist()
    ([[3.5]], [[[2.0, 3.0]]])

    References
    ----------
    Nayroles, Touzot & Villon, Comput. Mech. 10 (1992) 307, doi:10.1007/BF00364252.
    """

    nodes: Floats
    values: Floats
    degree: int = DEGREE
    neighbours: int = NEIGHBOURS
    dilation: float = DILATION
    softening: float = SOFTENING
    radii: Floats | None = None

    def __post_init__(self) -> None:
        if self.neighbours >= len(self.nodes):
            raise ValueError(f"neighbours: expected fewer than the {len(self.nodes)} nodes, got {self.neighbours}")
        self.nodes = np.ascontiguousarray(self.nodes, dtype=np.float64)
        self.values = np.ascontiguousarray(self.values, dtype=np.float64)
        if self.radii is None:
            self.radii = self.dilation * _reach(self.nodes, self.neighbours)

    def __call__(self, queries: Floats) -> Floats:
        """Return the values at the queries : (n, 2) -> (n, q) array."""
        parts = (self.shape_functions(part) for part in _parted(queries))
        return np.concatenate([_weighted(share, self.values) for share in parts])

    def with_gradient(self, queries: Floats) -> tuple[Floats, Floats]:
        """Return the values (n, q) and gradients (n, q, 2) at the queries (n, 2)."""
        values, gradients = [], []
        for share, slope in (self._shapes(part, slopes=True) for part in _parted(queries)):
            values.append(_weighted(share, self.values))
            gradients.append(np.stack([_weighted(along, self.values) for along in slope], axis=-1))
        return np.concatenate(values), np.concatenate(gradients)

    def shape_functions(self, queries: Floats) -> Floats:
        """Return the weight of each node in the value at each query : (n, 2) -> (n, m) array, rows of sum one."""
        return self._shapes(queries, slopes=False)[0]

    def covering(self, queries: Floats, largest_weights: float = np.inf) -> DiffuseApproximation:
        """Return itself, or, where nodes are too sparse for a query (n, 2), one with just large enough radii.

        They are too sparse where the local polynomial is hardly determined, so that a value is a difference of large
        multiples of those at the nodes: the sizes of the weights add up to 1.3 in the midst of nodes, to 5 at a corner.
        A ValueError says that even radii four times as large do not suffice.
        """
        wider = self
        while not np.all(np.abs(wider.shape_functions(queries)).sum(axis=1) < largest_weights):
            wider = replace(wider, dilation=1.1 * wider.dilation, radii=None)
            if wider.dilation > 4 * self.dilation:
                raise ValueError(f"the {len(self.nodes)} nodes are too few or too unevenly spread")
        return wider

    def _shapes(self, queries: Floats, *, slopes: bool) -> tuple[Floats, Floats]:
        """Return the weights of the nodes (n, m) and, if requested, their slopes (2, n, m); NaN without a value."""
        queries = np.ascontiguousarray(queries, dtype=np.float64)
        shape = (len(queries), len(self.nodes))
        share, slope = np.zeros(shape), np.zeros((2 if slopes else 0, *shape))
        _shape_functions(queries, self.nodes, self.radii, self.degree, self.softening, share, slope)
        return share, slope


def _parted(queries: Floats) -> list[Floats]:
    """Return parts of queries of which the weights of all nodes take little memory."""
    return np.array_split(queries, 1 + len(queries) // _PART)


def each_left_out(approximation: DiffuseApproximation) -> Iterator[DiffuseApproximation]:
    """Yield the approximations without node 0, then without node 1, ..., radii included."""
    nodes, k = approximation.nodes, approximation.neighbours
    distance = np.sqrt(np.sum((nodes[:, None] - nodes[None]) ** 2, axis=-1))
    reach, next_reach = np.partition(distance, (k, k + 1), axis=1)[:, k : k + 2].T
    for i in range(len(nodes)):
        keep = np.arange(len(nodes)) != i
        radii = approximation.dilation * np.where(distance[:, i] <= reach, next_reach, reach)
        yield replace(approximation, nodes=nodes[keep], values=approximation.values[keep], radii=radii[keep])


def leave_one_out(approximation: DiffuseApproximation) -> Floats:
    """Predict each node from all others, with wider radii where its absence requires them : (m, q) array."""
    queries = approximation.nodes[:, None]
    pairs = zip(each_left_out(approximation), queries, strict=True)
    return np.concatenate([rest.covering(query)(query) for rest, query in pairs])


def _reach(nodes: Floats, neighbours: int) -> Floats:
    squared = np.sum((nodes[:, None] - nodes[None]) ** 2, axis=-1)
    return np.sqrt(np.partition(squared, neighbours, axis=1)[:, neighbours])


@njit(cache=True, nogil=True, error_model="numpy")
def _monomials(x, y, degree, out):  # type: ignore[no-untyped-def]
    out[0] = 1.0
    start = 0
    for d in range(1, degree + 1):
        for k in range(d):
            out[start + d + k] = x * out[start + k]
        out[start + 2 * d] = y * out[start + d - 1]
        start += d


@njit(cache=True, nogil=True, error_model="numpy")
def _gather(u, v, nodes, radii, softening, near, weight, slope):  # type: ignore[no-untyped-def]
    """Fill in the nodes that reach (u, v), their weights and gradients; return their number and largest distance."""
    count, farthest = 0, 0.0
    for i in range(len(nodes)):
        x, y = nodes[i, 0] - u, nodes[i, 1] - v
        reach = radii[i] ** 2
        squared = x * x + y * y
        if not squared < reach:  # NaN too
            continue
        share, soft = squared / reach, softening**2
        bump, pole = (1.0 - share) ** 4, 1.0 / (share + soft)
        weight[count] = bump * pole
        # d(weight)/d(share), then share = |node - query|^2 / reach
        rate = -pole * (4.0 * (1.0 - share) ** 3 + bump * pole) * -2.0 / reach
        slope[count, 0], slope[count, 1] = rate * x, rate * y
        near[count] = i
        farthest = max(farthest, squared)
        count += 1
    return count, np.sqrt(farthest)


@njit(cache=True, nogil=True, error_model="numpy")
def _shape_functions(queries, nodes, radii, degree, softening, share, gradient):  # type: ignore[no-untyped-def]
    """Fill share (n, m) and gradient (2 or 0, n, m).

    The shape function of node i at the query is w_i g . p_i with g = A^-1 e_0, A the moment matrix sum w p p^T and p
    the monomials centred on the query; its derivative along k is w_i g_k . p_i + d_k w_i g . p_i with
    g_k = A^-1 (d_k p(0) - sum_j d_k w_j (g . p_j) p_j).
    """
    m, terms = len(nodes), (degree + 1) * (degree + 2) // 2
    near, weight, slope = np.empty(m, np.int64), np.empty(m), np.empty((m, 2))
    basis, moment = np.empty((m, terms)), np.empty((terms, terms))
    solution = np.empty((3, terms))
    for q in range(len(queries)):
        u, v = queries[q]
        count, scale = _gather(u, v, nodes, radii, softening, near, weight, slope)
        moment[:] = 0.0
        for i in range(count):
            row = basis[i]
            _monomials((nodes[near[i], 0] - u) / scale, (nodes[near[i], 1] - v) / scale, degree, row)
            for j in range(terms):
                weighed, across = weight[i] * row[j], moment[j]
                for k in range(j + 1):
                    across[k] += weighed * row[k]
        if count < terms or not factorise(moment, SMALLEST_PIVOT):
            share[q] = np.nan
            gradient[:, q] = np.nan
            continue
        solution[:] = 0.0
        solution[0, 0] = 1.0
        substitute(moment, solution[0])
        for k in range(len(gradient)):
            if terms > 1:  # a constant has no slope of its own, only that of its weights
                solution[k + 1, k + 1] = 1.0 / scale
            for i in range(count):
                factor = slope[i, k] * _dot(solution[0], basis[i])
                for j in range(terms):
                    solution[k + 1, j] -= factor * basis[i, j]
            substitute(moment, solution[k + 1])
        for i in range(count):
            plain = _dot(solution[0], basis[i])
            share[q, near[i]] = weight[i] * plain
            for k in range(len(gradient)):
                gradient[k, q, near[i]] = weight[i] * _dot(solution[k + 1], basis[i]) + slope[i, k] * plain


@njit(cache=True, nogil=True, error_model="numpy")
def _dot(a, b):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _weighted(shares, values):  # type: ignore[no-untyped-def]
    """Return the sums (n, q) of values (m, q) with few shares (n, m); digits of BLAS depend on kernel and threads."""
    sums = np.zeros((len(shares), values.shape[1]))
    for n in range(len(shares)):
        for i in range(len(values)):
            share = shares[n, i]
            if share != 0.0:
                for k in range(values.shape[1]):
                    sums[n, k] += share * values[i, k]
    return sums


# Scaling of the plane (sqrt(Ca), a/l), in which the cases of a database lie about equally far apart


@dataclass(frozen=True)
class PlaneScaling:
    """Coordinates (sqrt(Ca) / ca_step, (a/l) / size_step).

    >>> PlaneScaling(ca_step=0.01, size_step=0.025).to_plane(0.09, 0.9).round(6)
    array([30., 36.])
    """

    ca_step: float
    size_step: float

    @classmethod
    def of(cls, capillary_number: Floats, size_ratio: Floats) -> PlaneScaling:
        """Derive the steps from columns of equal a/l: medians of 3/4 of the gaps along them and of those between."""
        sizes = np.round(size_ratio, 6)
        columns = np.unique(sizes)
        gaps = [np.diff(np.sort(np.sqrt(capillary_number[sizes == column]))) for column in columns]
        return cls(0.75 * float(np.median(np.concatenate(gaps))), float(np.median(np.diff(columns))))

    def to_plane(self, capillary_number: ArrayLike, size_ratio: ArrayLike) -> Floats:
        """Return the coordinates of (Ca, a/l) : (..., 2) array."""
        return np.stack([np.sqrt(capillary_number) / self.ca_step, np.asarray(size_ratio) / self.size_step], axis=-1)

    def from_plane(self, coordinates: Floats) -> Floats:
        """Return (Ca, a/l) of coordinates : (..., 2) array."""
        return np.stack([(coordinates[..., 0] * self.ca_step) ** 2, coordinates[..., 1] * self.size_step], axis=-1)

    def slopes(self, capillary_number: ArrayLike) -> Floats:
        """Return the derivatives of the two coordinates by Ca and by a/l, for the chain rule : (..., 2) array."""
        root = np.sqrt(np.asarray(capillary_number, dtype=np.float64))
        return np.stack([0.5 / (root * self.ca_step), np.full(root.shape, 1.0 / self.size_step)], axis=-1)


# Fine table of a smooth function of the plane: bicubic Hermite cells with a continuous gradient.
#
# A value of moving least squares takes microseconds; a table of values, gradients and cross derivatives gives it in
# tens of nanoseconds, with an error of fourth order in the size of a cell


@dataclass(frozen=True, eq=False)
class HermiteTable:
    """Table of q quantities over a regular lattice of a rectangle of the plane."""

    origin: Floats  # (2,): first lattice point
    step: Floats  # (2,)
    coefficients: Floats  # (i, j, 4, q): value, first derivatives times step, cross derivative times both

    @classmethod
    def of(cls, function: Callable[[Floats], tuple[Floats, Floats]], lattice: Floats, wanted: Booleans) -> HermiteTable:
        """Tabulate a function of points (n, 2) with values (n, q), NaN where undefined, and gradients (n, q, 2)."""
        # Points of the regular lattice (i, j, 2) that are not `wanted` (i, j) stay NaN.
        step = lattice[1, 1] - lattice[0, 0]
        value, gradient = function(lattice[wanted])
        coefficients = np.full((*wanted.shape, 4, value.shape[1]), np.nan)
        coefficients[wanted, 0] = value
        coefficients[wanted, 1] = gradient[..., 0] * step[0]
        coefficients[wanted, 2] = gradient[..., 1] * step[1]
        # both cross derivatives are second-order accurate, as the fourth order of the table requires
        ways = _differenced(coefficients[:, :, 1], axis=1), _differenced(coefficients[:, :, 2], axis=0)
        other = np.where(np.isnan(ways[1]), ways[0], sum(ways) / 2)
        coefficients[:, :, 3] = np.where(np.isnan(ways[0]), ways[1], other)
        return cls(lattice[0, 0], step, coefficients)

    def with_gradient(self, points: Floats) -> tuple[Floats, Floats]:
        """Return values (n, q) and gradients (n, q, 2) at points (n, 2); NaN next to lattice points without values."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        shape = (len(points), self.coefficients.shape[3])
        value, gradient = np.empty(shape), np.empty((*shape, 2))
        _interpolate(points, self.origin, self.step, self.coefficients, value, gradient)
        return value, gradient


def _differenced(field: Floats, axis: int) -> Floats:
    """Return the central difference per lattice step, one-sided (second order) where a neighbour is missing."""
    field = np.moveaxis(field, axis, 0)
    padded = np.pad(field, [(2, 2)] + [(0, 0)] * (field.ndim - 1), constant_values=np.nan)
    before2, before, after, after2 = padded[:-4], padded[1:-3], padded[3:-1], padded[4:]
    central = (after - before) / 2
    forward, backward = (4 * after - 3 * field - after2) / 2, (3 * field - 4 * before + before2) / 2
    one_sided = np.where(np.isnan(forward), backward, forward)
    return np.moveaxis(np.where(np.isnan(central), one_sided, central), 0, axis)


@njit(cache=True, nogil=True)
def hermite(x, y, coefficients, value, gradient):  # type: ignore[no-untyped-def]
    """Evaluate one point in lattice units into value (q,) and gradient (q or 0, 2), the latter per lattice unit."""
    i = min(max(int(np.floor(x)), 0), coefficients.shape[0] - 2)
    j = min(max(int(np.floor(y)), 0), coefficients.shape[1] - 2)
    s, t = x - i, y - j
    value[:] = 0.0
    gradient[:] = 0.0
    for di in range(2):
        a, a1, b, b1 = _cubics(s, di)
        for dj in range(2):
            c, c1, d, d1 = _cubics(t, dj)
            node = coefficients[i + di, j + dj]
            for q in range(len(value)):
                value[q] += a * c * node[0, q] + b * c * node[1, q] + a * d * node[2, q] + b * d * node[3, q]
            for q in range(len(gradient)):
                gradient[q, 0] += a1 * c * node[0, q] + b1 * c * node[1, q] + a1 * d * node[2, q] + b1 * d * node[3, q]
                gradient[q, 1] += a * c1 * node[0, q] + b * c1 * node[1, q] + a * d1 * node[2, q] + b * d1 * node[3, q]


@njit(cache=True, nogil=True)
def _cubics(s, end):  # type: ignore[no-untyped-def]
    """Return the cubics of the value and of the slope at one end of [0, 1], each followed by its derivative."""
    if end == 0:
        r = 1.0 - s
        return (1.0 + 2.0 * s) * r * r, -6.0 * s * r, s * r * r, r * (1.0 - 3.0 * s)
    return s * s * (3.0 - 2.0 * s), 6.0 * s * (1.0 - s), s * s * (s - 1.0), s * (3.0 * s - 2.0)


@njit(cache=True, nogil=True)
def _interpolate(points, origin, step, coefficients, value, gradient):  # type: ignore[no-untyped-def]
    for n in range(len(points)):
        x, y = (points[n, 0] - origin[0]) / step[0], (points[n, 1] - origin[1]) / step[1]
        hermite(x, y, coefficients, value[n], gradient[n])
        for q in range(value.shape[1]):
            gradient[n, q, 0] /= step[0]
            gradient[n, q, 1] /= step[1]
