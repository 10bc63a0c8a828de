"""Where the posterior of the membrane of a batch has its modes: Gauss-Newton steps along all unknowns together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import NoShapeError
from capsbayes.infer.importance.weights import quasi_random
from capsbayes.infer.many.one_membrane.conditional import COMMON, STEP, Capsules, Start, Step
from capsbayes.infer.many.one_membrane.unknowns import Unknowns

_STARTS, _BEST = 32, 4  # membranes tried, and those from which a mode is sought
_USUAL = (0.2, 0.06, 0.2)  # spreads of ln G_s, of a/l and of ln alpha while modes are sought
_PILOTS = 2  # best membranes at which the model's error is read, one after the other
_STEPS, _SETTLED = 15, 1e-2
_LONGEST = 0.7  # step of a normal score
_FARTHEST = 3.0  # normal score
_HALVINGS = 4
_NARROWEST, _OF_SPREADS = (0.05, 0.02, 0.05), 0.4  # spreads at first, and standard deviation of their logs


def starting_points(capsules: Capsules, unknowns: Unknowns) -> Floats:
    """Return the best points (d, p) of some over the prior."""
    points = unknowns.wide(quasi_random(unknowns.dimensions, _STARTS, 0))
    for column, which in enumerate(unknowns.sought, unknowns.scores):
        points[:, column] = np.log(_USUAL[which])
    tried = capsules.at(unknowns.membranes(points), unknowns.spreads_at(points), iterations=2)
    return np.asarray(points[np.argsort(-tried.log_evidence, kind="stable")[:_BEST]])


def with_model_error(capsules: Capsules, unknowns: Unknowns) -> Capsules:
    """Return the capsules with the model's own error, as it is at their best membrane, in those of the measurements.

    It is held there: if it changed with the membrane, membranes of which the model is sure would be preferred.

    Raises
    ------
    NoShapeError
        If the capsules have no shape at any membrane.
    """
    known = capsules
    points = starting_points(capsules, unknowns) if unknowns.dimensions else np.zeros((1, 0))
    for _ in range(_PILOTS):
        tried = np.array([one.point for one in modes(known, unknowns, points)]) if unknowns.scores else points
        points = tried if len(tried) else points
        found = known.at(unknowns.membranes(points), unknowns.spreads_at(points))
        best = int(np.argmax(found.log_evidence))
        points = points[best : best + 1]
        own = found.own[best : best + 1]
        if not np.isfinite(found.log_evidence[best]):
            expected = "a membrane that gives all capsules a steady shape at some Ca and a/l of the model"
            advice = "state less of the membrane"
            raise NoShapeError("identify_membrane", "membrane", expected, "none of those that were tried", advice)
        known = capsules.with_model_error(unknowns.membranes(points), own[0])
    return known


class Mode(NamedTuple):
    """A mode (p,) and the covariance (p, p) by the curvature there."""

    point: Floats
    covariance: Floats


def modes(capsules: Capsules, unknowns: Unknowns, starts: Floats) -> list[Mode]:
    """Return the modes that Gauss-Newton steps reach from points (d, p)."""
    points, free = starts.copy(), unknowns.scores
    found = capsules.at(unknowns.membranes(points), unknowns.spreads_at(points), iterations=3)
    alive = np.isfinite(found.log_evidence)
    points, own, common = points[alive], found.own[alive], found.common[alive]
    covariance = np.zeros((len(points), free, free))
    for _ in range(_STEPS if len(points) else 0):
        step = step_of_all(capsules, unknowns, points, Start(own, common))
        covariance = step.covariance[:, COMMON:, COMMON:]
        scores = step.scores / np.maximum(np.max(np.abs(step.scores) / _LONGEST, axis=1, keepdims=True), 1.0)
        share, tried, inside = np.ones(len(points)), points, np.zeros(len(points), dtype=bool)
        for _ in range(_HALVINGS):  # a shorter step where a capsule would leave the domain
            tried = points.copy()
            tried[:, :free] = np.clip(points[:, :free] + share[:, None] * scores, -_FARTHEST, _FARTHEST)
            inside = np.all(capsules.model.contains(unknowns.membranes(tried), own), axis=1)
            if np.all(inside):
                break
            share = np.where(inside, share, 0.5 * share)
        points = np.where(inside[:, None], tried, points)
        common = common + share[:, None] * step.common
        own = capsules.moved(unknowns.membranes(points), own, share[:, None, None] * step.own)
        if np.all(step.decrease < _SETTLED):
            break
    if len(points):
        points = _with_spreads(unknowns, points, capsules, own, step.log_ratio)
    return [Mode(point, _whole(unknowns, one)) for point, one in zip(points, covariance, strict=True)]


def step_of_all(capsules: Capsules, unknowns: Unknowns, points: Floats, values: Start) -> Step:
    """Return the step towards the best membranes and capsules from points (d, p) and values of the capsules there."""
    moved = []
    for column in range(unknowns.scores):
        away = points.copy()
        away[:, column] += STEP
        moved.append(unknowns.membranes(away))
    place = unknowns.membranes(points), unknowns.spreads_at(points)
    return capsules.step(*place, *values, moved, points[:, : unknowns.scores])


def _with_spreads(unknowns: Unknowns, points: Floats, capsules: Capsules, own: Floats, log_ratio: Floats) -> Floats:
    """Return points with the spreads that the capsules have about their means."""
    moduli = capsules.log_moduli(own, log_ratio)
    spreads = np.concatenate([moduli[..., None], own[..., 1:]], axis=2).std(axis=1).T
    for column, which in enumerate(unknowns.sought, unknowns.scores):
        points[:, column] = np.log(np.maximum(spreads[which], _NARROWEST[which]))
    return points


def _whole(unknowns: Unknowns, covariance: Floats) -> Floats:
    """Return the covariance of a point, with that of the logs of spreads."""
    whole = np.zeros((unknowns.dimensions, unknowns.dimensions))
    whole[: unknowns.scores, : unknowns.scores] = covariance
    sought = np.arange(unknowns.scores, unknowns.dimensions)
    whole[sought, sought] = _OF_SPREADS**2
    return whole
