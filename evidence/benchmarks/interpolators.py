"""Two general interpolators next to the surrogate, all learnt from the same cases: what `speed` times.

Every fifth case that is not at the end of its column of a/l is held out; each method learns (L_z, L_a, v_o/U) from the
others in the same coordinates, and predicts the held-out cases. All cases are parachutes: no smooth method can
represent the jump to the convex branch, which the surrogate treats separately.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from capsbayes.database import Database
from capsbayes.surrogate import Surrogate
from capsbayes.surrogate.diffuse import PlaneScaling
from capsbayes.surrogate.plane import Branch

Floats = NDArray[np.float64]
Predict = Callable[[Floats], Floats]

QUANTITIES = ("axial_extent", "axial_length", "velocity_ratio")


def split(cases: Database, branch: Branch) -> tuple[Database, Database]:
    """Return the cases of a branch to learn from, and every fifth of those between others of its column of a/l.

    The ends of a column stay among the known cases, since they bound the region of the branch.
    """
    members = Database(cases.dataset.isel(case=branch.rows))
    ca, size = members["capillary_number"], np.round(members["size_ratio"], 6)
    inside = (size > size.min()) & (size < size.max())
    for column in np.unique(size):
        ends = ca[size == column].min(), ca[size == column].max()
        inside &= (size != column) | ((ca > ends[0]) & (ca < ends[1]))
    chosen = np.flatnonzero(inside)[::5]
    rest = np.setdiff1d(np.arange(len(ca)), chosen)
    return Database(members.dataset.isel(case=rest)), Database(members.dataset.isel(case=chosen))


def surrogate(known: Database, scaling: PlaneScaling) -> Predict:
    """Return the surrogate as users call it, with table, mask and covariance."""
    learnt = Surrogate(known)

    def predict(points: Floats) -> Floats:
        ca, size = scaling.from_plane(points).T
        return learnt({"capillary_number": ca, "size_ratio": size}).values

    return predict


def radial(kernel: str) -> Callable[[Database, PlaneScaling], Predict]:
    def learn(known: Database, scaling: PlaneScaling) -> Predict:
        return RBFInterpolator(nodes_of(known, scaling), values_of(known), kernel=kernel)

    return learn


def gaussian_process(known: Database, scaling: PlaneScaling) -> Predict:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern

    nodes, values = nodes_of(known, scaling), values_of(known)
    mean, spread = values.mean(axis=0), values.std(axis=0)
    kernel = ConstantKernel(10.0, (1e-2, 1e6)) * Matern([10.0, 10.0], (1.0, 1e4), nu=2.5)
    process = GaussianProcessRegressor(kernel, alpha=1e-10)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the length scales of smooth data run to their bounds
        process.fit(nodes, (values - mean) / spread)
    return lambda points: mean + spread * process.predict(points)


def nodes_of(cases: Database, scaling: PlaneScaling) -> Floats:
    return scaling.to_plane(cases["capillary_number"], cases["size_ratio"])


def values_of(cases: Database) -> Floats:
    return np.stack([cases[name] for name in QUANTITIES], axis=1)


def accuracy(predict: Predict, held_out: Database, scaling: PlaneScaling) -> Floats:
    """Return the relative root mean square errors of the three quantities : (3,) array."""
    truth = values_of(held_out)
    error = (predict(nodes_of(held_out, scaling)) - truth) / truth
    return np.sqrt(np.mean(error**2, axis=0))


def some_points(surrogate: Surrogate, count: int) -> Floats:
    """Return random points (Ca, a/l) inside the domain, (count, 2) array."""
    (ca_low, ca_high), (size_low, size_high) = surrogate.domain.bounds
    points = np.random.default_rng(0).uniform([ca_low, size_low], [ca_high, size_high], (4 * count, 2))
    return points[surrogate.domain.contains(*points.T)][:count]
