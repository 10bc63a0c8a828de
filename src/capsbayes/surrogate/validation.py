"""Leave-one-out over a database: errors of (Ca, a/l, v_o/U) identified from (L_z, L_a) of a case left out.

Two methods are compared: the inverse procedure of the paper, and the inversion
of the forward map (`inversion`). The relative errors are those of the paper,
|theta - theta_i| / theta_i.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.database import Database
from capsbayes.surrogate.branch_surrogate import approximation_of
from capsbayes.surrogate.branches import CONVEX, branches_of
from capsbayes.surrogate.diffuse import DiffuseApproximation, each_left_out
from capsbayes.surrogate.inverse import DISTANCE_WEIGHTS, Inverse, inverse, rotated
from capsbayes.surrogate.inversion import solve
from capsbayes.surrogate.scaling import PlaneScaling

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


def validate_inverse(database: Database, *, neighbours: int = 14) -> LeaveOneOut:
    """Validate the inverse procedure of the paper by leave-one-out."""
    whole = inverse(database, neighbours)

    def answer_without(i: int) -> Floats:
        keep = np.arange(len(whole.parameters)) != i
        rest = Inverse(
            whole.parameters[keep], whole.lengths[keep], whole.velocity_ratio[keep], whole.contours[keep], neighbours
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

    def forward(points: Floats, rows: Integers) -> tuple[Floats, Floats]:
        del rows
        values, gradients = rest.with_gradient(points)
        return values[:, :2], gradients[:, :2]

    return solve(forward, lengths[None], starts[:, None]).points[0]


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
