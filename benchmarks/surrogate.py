"""Speed and leave-out accuracy of the surrogate, compared with two general interpolators on the same cases.

Run ``python benchmarks/surrogate.py [DATABASE]``. Every fifth case that is not
at the end of its column of a/l is held out; each method learns (L_z, L_a, v_o/U)
from the others in the same coordinates, and predicts the held-out cases.
All cases are parachutes: no smooth method can represent the jump to the
convex branch, which the surrogate treats separately.
The speed is that of one core, on a batch of 100 000 points of the domain (a
smaller batch where a method is slow, stated in the table).
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table
from scipy.interpolate import RBFInterpolator
from threadpoolctl import threadpool_limits

from capsbayes.database import Database
from capsbayes.surrogate import DiffuseApproximation, Surrogate
from capsbayes.surrogate.diffuse import PlaneScaling
from capsbayes.surrogate.plane import Branch

Floats = NDArray[np.float64]
Predict = Callable[[Floats], Floats]

BATCH = 100_000
SMALL_BATCH = 10_000
QUANTITIES = ("axial_extent", "axial_length", "velocity_ratio")


@dataclass(frozen=True)
class Row:
    """Relative rms and largest errors of the three quantities, points a second, points in the timed batch."""

    method: str
    rms: Floats
    largest: Floats
    speed: float
    batch: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "database", nargs="?", default="square-neo-hookean", help="name of a shipped database, or .nc file"
    )
    name = parser.parse_args().database
    database = Database.read(name) if name.endswith(".nc") else Database.open(name)
    surrogate = Surrogate(database)
    part = surrogate.branches[0]
    known, held_out = split(part.cases, part.branch)
    scaling = part.scaling
    methods: dict[str, tuple[Callable[[Database, PlaneScaling], Predict], int]] = {
        "MLS, no table": (moving_least_squares, BATCH),
        "RBF, thin plate": (radial("thin_plate_spline"), SMALL_BATCH),
        "RBF, cubic": (radial("cubic"), SMALL_BATCH),
        "RBF, quintic": (radial("quintic"), SMALL_BATCH),
        "GPR, Matern 5/2": (gaussian_process, SMALL_BATCH),
    }
    rows = [surrogate_row(surrogate, known, held_out, scaling)]
    for method, (learn, batch) in methods.items():
        predict = learn(known, scaling)
        rows.append(Row(method, *accuracy(predict, held_out, scaling), *speed(predict, surrogate, scaling, batch)))
    Console().print(table(rows, len(known), len(held_out)))


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


def surrogate_row(surrogate: Surrogate, known: Database, held_out: Database, scaling: PlaneScaling) -> Row:
    """Return the row of the surrogate as users call it, with table, mask and covariance included in the time."""
    learnt = Surrogate(known)

    def predict(points: Floats) -> Floats:
        ca, size = scaling.from_plane(points).T
        return learnt({"capillary_number": ca, "size_ratio": size}).values

    rms, largest = accuracy(predict, held_out, scaling)
    theta = dict(zip(("capillary_number", "size_ratio"), some_points(surrogate, BATCH).T, strict=True))
    return Row("surrogate", rms, largest, *timed(lambda: surrogate(theta), BATCH))


def moving_least_squares(known: Database, scaling: PlaneScaling) -> Predict:
    return DiffuseApproximation(nodes_of(known, scaling), values_of(known))


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


def accuracy(predict: Predict, held_out: Database, scaling: PlaneScaling) -> tuple[Floats, Floats]:
    truth = values_of(held_out)
    error = (predict(nodes_of(held_out, scaling)) - truth) / truth
    return np.sqrt(np.mean(error**2, axis=0)), np.abs(error).max(axis=0)


def some_points(surrogate: Surrogate, count: int) -> Floats:
    """Return random points (Ca, a/l) inside the domain, (count, 2) array."""
    (ca_low, ca_high), (size_low, size_high) = surrogate.domain.bounds
    points = np.random.default_rng(0).uniform([ca_low, size_low], [ca_high, size_high], (4 * count, 2))
    return points[surrogate.domain.contains(*points.T)][:count]


def speed(predict: Predict, surrogate: Surrogate, scaling: PlaneScaling, batch: int) -> tuple[float, int]:
    points = scaling.to_plane(*some_points(surrogate, batch).T)
    return timed(lambda: predict(points), batch)


def timed(work: Callable[[], object], batch: int, repeats: int = 5) -> tuple[float, int]:
    """Return points a second, from the median of the repeats after one that compiles."""
    work()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return batch / float(np.median(seconds)), batch


def table(rows: list[Row], known: int, held_out: int) -> Table:
    title = f"Learnt from {known} parachutes, tested on {held_out}: relative error x 1e6, rms / largest"
    made = Table(title=title, box=SIMPLE, pad_edge=False)
    made.add_column("method")
    for heading in ("L_z", "L_a", "v_o/U", "points/s", "batch"):
        made.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        errors = [f"{1e6 * rms:.0f} / {1e6 * top:.0f}" for rms, top in zip(row.rms, row.largest, strict=True)]
        made.add_row(row.method, *errors, f"{row.speed:.2g}", str(row.batch))
    return made


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
