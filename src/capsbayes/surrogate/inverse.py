"""The deterministic inverse of the paper: Ca, a/l and v_o/U from L_z and L_a."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay

from capsbayes.arrays import Floats, Integers
from capsbayes.database import Database
from capsbayes.errors import InputError
from capsbayes.least_squares import Linearised, minimise
from capsbayes.profile import Profile

# Inversion of a map of the plane: the point at which a forward map gives wanted values

Forward = Callable[[Floats], tuple[Floats, Floats]]
"""From points (k, 2) to values (k, 2) and gradients (k, 2, 2), NaN where they are not defined."""

_UNIT = 1e-5  # of the values, which count as standard error
_EXACT = 1e-10
_LONGEST, _STEPS = 2.0, 60


def solve(forward: Forward, wanted: Floats, starts: Floats) -> Floats:
    """Return the point (2,) at which a map gives values (2,), else the nearest one; NaN where it is not defined.

    >>> def forward(x):
    ...     slope = np.stack([np.stack([2 * x[:, 0], 0 * x[:, 0]], 1), np.ones_like(x)], 1)
    ...     return np.stack([x[:, 0] ** 2, x[:, 0] + x[:, 1]], 1), slope
    >>> solve(forward, np.array([4.0, 5.0]), np.ones((1, 2))).round(9).tolist()
    [2.0, 3.0]
    """
    # Of `starts` (s, 2), the best first, the next is tried where the last led to no exact solution.

    def evaluate(points: Floats, rows: Integers) -> Linearised:
        del rows
        values, gradients = forward(points)
        return Linearised(points, (values - wanted) / _UNIT, gradients / _UNIT)

    only = np.zeros(1, dtype=int)
    nearest = Linearised(*(np.full(shape, np.nan) for shape in ((1, 2), (1, 2), (1, 2, 2))))
    for start in starts[:, None]:
        nearest.take_better(only, minimise(evaluate, evaluate(start, only), only, _LONGEST, _STEPS))
        if _UNIT * np.abs(nearest.residuals).max() < _EXACT:
            break
    return nearest.points[0]


# Inverse procedure of the paper: from (L_z, L_a) to (Ca, a/l), v_o/U and a contour, by diffuse approximation.
#
# Every step is the paper's: the lengths are rotated by -45 degrees; the cases in an elliptical neighbourhood of N = 14
# are weighted by 2 D^3 - 3 D^2 + 1; the rotated lengths are fitted as linear functions of (Ca, a/l) by weighted least
# squares; the fit is inverted by a pseudo-inverse. v_o/U comes from the Delaunay triangle around the answer, the
# contour from the weighted mean of the neighbours' contours.
#
# The text's order of the two weights of the distance, 1 and 0.05, is ambiguous. The ellipse must be long along the
# cloud's long axis, which the rotation turns onto the first coordinate, hence (0.05, 1): measured on trial cases, the
# other order doubles the error of Ca.
#
# Quesada, Dupont, Villon, Salsac, "Diffuse approximation for the identification of the mechanical properties of
# microcapsules", section "Inverse analysis approach"

DISTANCE_WEIGHTS = (0.05, 1.0)
FEWEST_NEIGHBOURS = 5  # three unknowns, and the farthest neighbour has no weight


class VelocityTriangulation:
    """Piecewise linear v_o/U over the Delaunay triangles of the cases, as in "Interpolation" of the paper.

    >>> corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    >>> plane = VelocityTriangulation(corners, np.array([1.0, 2.0, 4.0]))
    >>> float(plane(0.25, 0.25))
    2.0
    """

    # Of values (c,) at columns (Ca, a/l), unscaled as in the paper.

    def __init__(self, parameters: Floats, velocity_ratio: Floats) -> None:
        self.parameters, self.velocity_ratio = parameters, velocity_ratio
        triangles = Delaunay(parameters)
        self._hull = triangles.convex_hull
        self._within = LinearNDInterpolator(triangles, velocity_ratio)

    def __call__(self, capillary_number: float, size_ratio: float) -> float:
        """Return the weighted mean of v_o/U at the vertices of the triangle that contains the point."""
        # Outside every triangle it is that of the nearest point of the hull, so that nothing is extrapolated.
        point = np.array([capillary_number, size_ratio])
        within = float(self._within(point[None])[0])
        return self._on_the_hull(point) if np.isnan(within) else within

    def _on_the_hull(self, point: Floats) -> float:
        start, stop = self.parameters[self._hull].swapaxes(0, 1)
        along = stop - start
        share = np.clip(np.sum((point - start) * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
        nearest = int(np.argmin(np.sum((start + share[:, None] * along - point) ** 2, axis=1)))
        ends = self.velocity_ratio[self._hull[nearest]]
        return float((1 - share[nearest]) * ends[0] + share[nearest] * ends[1])


@dataclass(frozen=True, eq=False)
class InverseResult:
    """Answer of the procedure for one capsule.

    Parameters
    ----------
    capillary_number, size_ratio, velocity_ratio : float
        Ca [-], a/l [-] and v_o/U [-].
    contour : (p, 2) array [l]
        Weighted mean of the neighbours' contours, columns (z, y).
    neighbours : (N,) int array
        Rows of the database in the neighbourhood, nearest first.
    """

    capillary_number: float
    size_ratio: float
    velocity_ratio: float
    contour: Floats = field(repr=False)
    neighbours: Integers = field(repr=False)

    @property
    def profile(self) -> Profile:
        """The contour as a profile, over l."""
        return Profile(self.contour)

    def hausdorff(self, observed: Profile) -> float:
        """Return the Hausdorff distance of the contour to an observed profile (over l), divided by a [-].

        Both are first centred on the middle of their axial extent, since the origin of the simulation is unknown in a
        picture.
        """
        return _centred(self.profile).hausdorff(_centred(observed)) / self.size_ratio


@dataclass(eq=False)
class Inverse:
    """Inverse procedure over given cases; `inverse` makes one from a database.

    Parameters
    ----------
    parameters : (c, 2) array [-]
        Columns (Ca, a/l).
    lengths : (c, 2) array [l]
        Columns (L_z, L_a).
    velocity_ratio : (c,) array [U]
        v_o/U.
    contours : (c, p, 2) array [l]
        Mid-plane profiles with corresponding points.
    neighbours : int
        N, the number of cases in the neighbourhood.
    """

    parameters: Floats
    lengths: Floats
    velocity_ratio: Floats
    contours: Floats
    neighbours: int = 14

    def __post_init__(self) -> None:
        if not FEWEST_NEIGHBOURS <= self.neighbours <= len(self.parameters):
            expected = f"an integer from {FEWEST_NEIGHBOURS} to the number of cases, {len(self.parameters)}"
            raise InputError("inverse", "neighbours", expected, str(self.neighbours))
        self._velocity = VelocityTriangulation(self.parameters, self.velocity_ratio)

    def __call__(self, *, axial_extent: float, axial_length: float) -> InverseResult:
        """Identify one capsule.

        Parameters
        ----------
        axial_extent, axial_length : float [l]
            L_z and L_a, with 0 < L_a <= L_z.

        Raises
        ------
        InputError
            When the two lengths cannot belong to a capsule.
        """
        if not 0 < axial_length <= axial_extent < np.inf:
            got = f"L_z = {axial_extent:.6g}, L_a = {axial_length:.6g}"
            raise InputError("inverse", "axial_length", "0 < L_a <= L_z, both finite", got)
        target = rotated(np.array([axial_extent, axial_length]))
        cloud = rotated(self.lengths)
        near, weight = _neighbourhood(cloud, target, self.neighbours)
        parameters = _solve_local_fit(self.parameters[near], cloud[near], weight, target)
        return InverseResult(
            capillary_number=float(parameters[0]),
            size_ratio=float(parameters[1]),
            velocity_ratio=self._velocity(parameters[0], parameters[1]),
            contour=np.tensordot(weight / weight.sum(), self.contours[near], axes=1),
            neighbours=near,
        )


def inverse(database: Database, neighbours: int = 14) -> Inverse:
    """Return the paper's procedure over the converged cases of a database, with N neighbours.

    References
    ----------
    Quesada, Dupont, Villon & Salsac, Math. Mech. Solids (2021), doi:10.1177/1081286520977602.
    """
    cases = database.converged
    return Inverse(
        parameters=np.stack([cases["capillary_number"], cases["size_ratio"]], axis=1),
        lengths=np.stack([cases["axial_extent"], cases["axial_length"]], axis=1),
        velocity_ratio=cases["velocity_ratio"],
        contours=cases["profile"],
        neighbours=neighbours,
    )


def rotated(lengths: Floats) -> Floats:
    """Rotate lengths by -45 degrees about the origin : (..., 2) array [l].

    >>> rotated(np.array([1.0, 1.0])).round(6) + 0.0
    array([1.414214, 0.      ])
    """
    extent, length = lengths[..., 0], lengths[..., 1]
    return np.stack([extent + length, length - extent], axis=-1) / np.sqrt(2.0)


def _neighbourhood(cloud: Floats, target: Floats, count: int) -> tuple[Integers, Floats]:
    """Return the rows of the nearest cases and their weights 2 D^3 - 3 D^2 + 1, D = 1 at the farthest of them."""
    distance = np.sqrt((cloud - target) ** 2 @ np.array(DISTANCE_WEIGHTS))
    near = np.argsort(distance, kind="stable")[:count]
    share = distance[near] / distance[near[-1]]
    return near, 2 * share**3 - 3 * share**2 + 1


def _solve_local_fit(parameters: Floats, cloud: Floats, weight: Floats, target: Floats) -> Floats:
    """Fit cloud = a0 + A (Ca, a/l) by weighted least squares, then solve it for the target : (2,) array."""
    basis = np.column_stack([np.ones(len(parameters)), parameters])
    root = np.sqrt(weight)[:, None]
    coefficients = np.linalg.lstsq(root * basis, root * cloud, rcond=None)[0]
    return np.linalg.pinv(coefficients[1:].T) @ (target - coefficients[0])


def _centred(profile: Profile) -> Profile:
    z = profile.points[:, 0]
    return profile.translated(-(z.max() + z.min()) / 2)
